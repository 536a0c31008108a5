"""What `quasi plan` reads: flown flights, simulations or planned trajectories, and the noise that a gap found."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from quasi.errors import ConfigError, DataError, ReadError, nearest
from quasi.gap.flights.evidence import PLACE
from quasi.gap.flights.gathering import refuse_another_vehicle
from quasi.gap.planning import plan_noise
from quasi.gap.planning.plan import Flight, read_flight
from quasi.gap.statistics.whitening import Whitener
from quasi.model.model import Model
from quasi.sensor_limits import check_measured_motion
from quasi.tables import read_json, read_numbers, read_table

TABLES = (".csv", ".parquet")


def flights_of(names: Sequence[str], model: Model, directory: Path) -> tuple[list[Flight], dict[str, Any]]:
    """Flights by path, or by name of a simulation, and what their processing says of the vehicle.

    Raises a QuasiError naming the file for what is none of them, was processed for models of another kind, or is a
    flight whose velocity nothing measured. A position that nothing measured is left out.
    """
    flights, about = [], {}
    for name in names:
        path, simulated = _place(name, directory)
        companion = path.with_suffix(".json")
        metadata = read_json(companion) if path.suffix == ".parquet" and companion.is_file() else {}
        table, unknown = read_numbers(path), []
        if metadata.get("schema") == "quasi.filtered/1":
            _same_kind(metadata, model, path)
            if metadata.get("mass"):
                refuse_another_vehicle(path.as_posix(), replace(model.airframe, mass=float(metadata["mass"])), model)
            about = about or {k: metadata[k] for k in ("mass", "inertia") if metadata.get(k) is not None}
            speed, place = check_measured_motion(metadata)
            if not speed:
                raise DataError(
                    f"{path} has no source of velocity but the accelerometer, which drifts, and forces and moments "
                    "depend on it; name a flight with motion capture, or with velocity or position in its log"
                )
            unknown = [] if place else list(PLACE)
        table = table.drop(columns=unknown, errors="ignore")
        flights.append(read_flight(table, model, path.as_posix(), simulated))
    return flights, about


def _place(name: str, directory: Path) -> tuple[Path, bool]:
    """Path of the table and whether it is a simulation's."""
    places = [directory / name, directory / "results/simulations" / name]
    for path in places:
        if path.is_dir() and (path / "flight.parquet").is_file():
            return path / "flight.parquet", True
        if path.is_file() and path.suffix.lower() not in TABLES:
            raise ReadError(
                f"trajectory {path} is no table: its name ends in '{path.suffix}', expected {' or '.join(TABLES)}; a "
                "raw log has to be imported and filtered first"
            )
        if path.is_file():
            return path, _simulated(path)
    made = [p.parent.name for p in directory.glob("results/simulations/*/flight.parquet")]
    raise ReadError(
        f"no trajectory '{name}': neither {places[0]} nor {places[1]} exists{nearest(name, made)}; name a filtered "
        "flight, a table with t, x, y, z and yaw, or a simulation"
    )


def _simulated(path: Path) -> bool:
    summary = path.parent / "summary.json"
    return summary.is_file() and str(read_json(summary).get("schema", "")).startswith("quasi.simulation/")


def _same_kind(metadata: Mapping[str, Any], model: Model, path: Path) -> None:
    forces = metadata.get("forces")
    if forces in ("withGravity", "noGravity") and forces != model.gravity:
        raise ConfigError(
            f"{path} holds forces {forces}, but model {model.id} gives them {model.gravity}; name the flight in the "
            f"folder {model.gravity}"
        )


def noise_of(gap: str, directory: Path) -> tuple[Whitener, str]:
    """Noise as a finished gap left it. Raises ReadError where there is none."""
    path = directory / "results/gaps" / gap / "tables/forces_residuals.parquet"
    if not path.is_file():
        made = [p.name for p in directory.glob("results/gaps/*") if p.is_dir()]
        raise ReadError(f"no gap '{gap}': {path} does not exist{nearest(gap, made)}; make it with "
                        f"`snakemake -j2 results/gaps/{gap}`, or leave --gap out")  # fmt: skip
    return plan_noise.of_residuals(read_table(path), str(path)), f"what gap {gap} left of forces and moments"
