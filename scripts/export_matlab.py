"""Write a model for MATLAB and GNU Octave with its simulation environment, and compare it with the model in Octave."""

from pathlib import Path

from quasi.errors import QuasiError
from quasi.export.agreement import hand_over
from quasi.export.contents import configured_inputs
from quasi.export.matlab import write_matlab
from quasi.export.matlab_check import NO_OCTAVE, check_matlab, find_octave
from quasi.model.model import read_model
from quasi.running.job_log import job, print_at_end
from quasi.simulation.tools.portable import loop_constants, portable_setup


def main(model: str, settings: dict, folder: str) -> None:
    """Read the model; write functions, parameters, simulation and agreement report."""
    portable = read_model(model)
    notes, loop = [], None
    try:
        setup = portable_setup(portable)
        loop = loop_constants(setup)
        notes += setup.notes
    except QuasiError as reason:
        notes.append(f"the simulation environment is left out: {reason}")
    u = settings["u"]
    if settings["file"] is None:  # no configuration says otherwise than the model itself
        u = configured_inputs(portable) or u
    written = write_matlab(portable, folder, u, loop)
    notes += written.notes
    checks = []
    if find_octave():
        checks = check_matlab(portable, folder, written.u)
    else:
        notes.append(f"not compared: {NO_OCTAVE}")
    files = sorted({p.relative_to(folder).parts[0] for p in Path(folder).rglob("*.m*")})
    print_at_end(hand_over(folder, portable, "MATLAB", checks, notes, files))


if __name__ == "__main__":
    with job(snakemake.log[0], f"MATLAB export of {snakemake.wildcards.model}"):
        main(snakemake.input.model, snakemake.params.settings, snakemake.output.folder)
