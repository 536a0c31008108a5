"""Comparisons of what a project folder holds: flights and models by key or path."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from quasi.errors import ConfigError, ReadError, nearest
from quasi.gap.comparing.differences import Difference, Estimate, differences
from quasi.gap.comparing.flight_comparison import compare_flights, flights_plain, flights_text
from quasi.gap.comparing.model_comparison import compare_models, models_plain, models_text
from quasi.model.model import Model
from quasi.tables import read_made, read_table

MODEL_FREEDOM = 1e6  # degrees of freedom of a standard error that comes from a whole model
Constants = Mapping[str, tuple[float, float, str]]


def filtered_flight(name: str, directory: Path, gravity: str = "withGravity", required: bool = True) -> Path | None:
    """The file of a filtered flight given by path or key. Raises ReadError or ConfigError where it is none or several.

    required  whether None is returned for what is no flight
    """
    path = directory / name
    if path.suffix.lower() == ".parquet":
        if not path.is_file():
            raise ReadError(f"{path} does not exist; give a filtered flight of results/filtered")
        if path.parent.name in ("noGravity", "withGravity") and path.parent.name != gravity:
            raise ConfigError(f"{path} holds forces {path.parent.name}; give that of the folder {gravity}")
        return path
    found = sorted(directory.glob(f"results/filtered/*/{gravity}/{name}.parquet")) if "/" not in name else []
    if len(found) > 1:
        raise ConfigError(f"flight '{name}' is of {' and '.join(p.parts[-3] for p in found)}; give the path of one")
    if not found and required:
        known = [p.stem for p in directory.glob(f"results/filtered/*/{gravity}/*.parquet")]
        raise ReadError(
            f"no flight '{name}' in {directory / 'results/filtered'}{nearest(name, known)}; "
            "make it with `snakemake -j2 processing`"
        )
    return found[0] if found else None


def compare_flight_files(a: str, b: str, directory: Path, repeats: Sequence[str] = ()) -> tuple[dict[str, Any], str]:
    """Two flights as plain data and as text; see `flight_comparison`."""
    paths = [filtered_flight(name, directory) for name in (a, b)]
    names = tuple(path.stem for path in paths) if paths[0].stem != paths[1].stem else (a, b)
    again = {str(path): read_table(path) for path in (filtered_flight(n, directory) for n in repeats)}
    rows = compare_flights(*((name, read_table(path)) for name, path in zip(names, paths)), again)
    return flights_plain(rows, names, len(again)), flights_text(rows, names, len(again))


def compare_model_files(
    a: Model, b: Model, constants_a: Constants, constants_b: Constants, directory: Path, flights: Sequence[str] = ()
) -> tuple[dict[str, Any], str]:
    """Two models on the same flights as plain data and as text; see `model_comparison`.

    constants_a, _b  {constant: (value, standard error, unit)} of the models
    Raises ConfigError for models of different forces, or without a flight that neither was trained on.
    """
    if a.gravity != b.gravity:
        raise ConfigError(f"model {a.id} is {a.gravity}, model {b.id} {b.gravity}; compare models of the same forces")
    if not flights:
        flights = held_out_of_both(a, b)
    paths = dict.fromkeys(filtered_flight(name, directory, a.gravity) for name in flights)
    stems = [path.stem for path in paths]
    keys = {path: path.stem if stems.count(path.stem) == 1 else str(path) for path in paths}
    tables = {key: read_table(path) for path, key in keys.items()}
    rows = compare_models(a, b, tables, {key: read_made(path).get("mass") for path, key in keys.items()})
    names = (a.id, b.id) if a.id != b.id else (f"{a.id} (A)", f"{b.id} (B)")
    constants = constant_differences(constants_a, constants_b)
    plain, text = models_plain(rows, constants, names, list(tables)), models_text(rows, constants, names, list(tables))
    for model in (a, b):
        if shared := [key for key in tables if key in trained_on(model)]:
            text += f"\nnote: {model.id} was trained on {', '.join(shared)}; its errors there are optimistic"
    return plain, text


def held_out_of_both(a: Model, b: Model) -> list[str]:
    """Validation flights that neither model was trained on. Raises ConfigError without any."""
    known = dict.fromkeys(k for m in (a, b) for k in (m.document.get("flights") or {}).get("validation") or ())
    found = [key for key in known if key not in trained_on(a) and key not in trained_on(b)]
    if not found:
        raise ConfigError(f"models {a.id} and {b.id} have no flight held out of both; name flights with --flights")
    return found


def trained_on(model: Model) -> list[str]:
    """Keys of a model's training flights."""
    return list((model.document.get("flights") or {}).get("training") or ())


def constant_differences(a: Constants, b: Constants) -> list[Difference]:
    """Constants of two models with their standard errors."""
    sides = [{n: Estimate(value, std, MODEL_FREEDOM) for n, (value, std, _) in side.items()} for side in (a, b)]
    return differences(*sides, {n: unit for n, (_, _, unit) in a.items()})
