"""Write a model as two FMUs, forces and moments alone and the whole vehicle, and compare both with the model."""

import tempfile
from pathlib import Path

from quasi.errors import QuasiError
from quasi.export.agreement import hand_over
from quasi.export.compiler import NO_COMPILER
from quasi.export.fmu_archive import write_fmu
from quasi.export.fmu_running import check_forces, check_vehicle
from quasi.export.fmu_source import forces_fmu, vehicle_fmu
from quasi.model.extensions import actuators_of, wind_of
from quasi.model.model import read_model
from quasi.running.job_log import job, print_at_end


def main(model: str, folder: str) -> None:
    """Read the model; write its FMUs and their agreement report."""
    portable = read_model(model)
    notes = [*actuators_of(portable).notes]
    if wind_of(portable).any():
        notes.append("the wind that the model's extensions found in its flights is the start value of the wind inputs")
    made = [(forces_fmu(portable), check_forces)]
    try:
        made.append((vehicle_fmu(portable), check_vehicle))
    except QuasiError as error:  # the force-and-moment model is of use without it
        notes.append(f"no vehicle was made: {error}")
    checks, files = [], []
    with tempfile.TemporaryDirectory(prefix="quasi-export-") as scratch:
        for fmu, check in made:
            files.append(f"{fmu.identifier}.fmu")
            library = write_fmu(Path(folder) / files[-1], fmu, scratch)
            if library:
                checks += check(portable, fmu, library)
    if not checks:
        notes.append(f"the FMUs hold sources alone and were not compared: {NO_COMPILER}")
    print_at_end(hand_over(folder, portable, "FMU", checks, notes, files))


if __name__ == "__main__":
    with job(snakemake.log[0], f"FMU export of {snakemake.wildcards.model}"):
        main(snakemake.input.model, snakemake.output.folder)
