"""Which rows train, which test, which validate.

The manual draws single samples at random. Neighbours of a 500 Hz log are nearly copies of each other, so that such a
test set says little about new flights; drawing blocks or whole flights, and validation flights, are the honest figures.

Source: QuaSI user manual V1.0.a, listing 4 ("data partitioning").
"""

import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import DataError
from quasi.terms.rotor_map import used_rows

UNUSED, TRAINING, TEST, VALIDATION = 0, 1, 2, 3
ROLES = {"training": TRAINING, "test": TEST, "validation": VALIDATION}
PARTITION_UNITS = {
    "flight": ("", "", "flight key"),
    "row": ("", "", "row of the filtered flight"),
    "role": ("", "", "role code: 1 training, 2 test, 3 validation"),
}
EXCITED = "excited_"  # prefix of the columns that isolation adds, one per axis


def usable(rows: int, ratio: float) -> slice:
    """The middle part of a flight: int((rows - int(ratio rows)) / 2) rows are cut from each end."""
    cut = (rows - int(ratio * rows)) // 2
    return slice(cut, rows - cut)


def partition(
    flights: Mapping[str, pd.DataFrame],
    validation: Iterable[str] = (),
    options: Mapping[str, Any] | None = None,
    because: Mapping[str, str] | None = None,
) -> dict[str, np.ndarray]:
    """Role of every row of every flight: {flight: (n,) int8 of UNUSED, TRAINING, TEST, VALIDATION}.

    flights     filtered flights; rows whose column valid or in_flight is 0 are not used
    validation  flights that are kept whole for validation
    options     "usable data ratio", "random partition", "partition ratio", "partition by" ("samples", "blocks" or
                "flights"), "block length" (s), "seed"; the draw inside a flight depends on the seed and its key alone
    because     {flight: why none of its rows is valid}, of those of which it is known, for the message
    Raises DataError when no training row is left.
    """
    options = dict(options or {})
    ratio = float(options.get("usable data ratio", 0.9))
    validation = set(validation)
    learning = [key for key in flights if key not in validation]
    whole = None
    if options.get("random partition", True) and options.get("partition by", "samples") == "flights":
        whole = draw_flights(learning, float(options.get("partition ratio", 0.75)), int(options.get("seed", 0)))
    roles = {}
    for key, flight in flights.items():
        codes = np.zeros(len(flight), np.int8)
        rows = np.zeros(len(flight), bool)
        rows[usable(len(flight), ratio)] = True
        rows &= used_rows(flight)
        if key in validation:
            codes[rows] = VALIDATION
        elif whole is not None:
            codes[rows] = TRAINING if key in whole else TEST
        elif options.get("random partition", True):
            train = _draw(flight, rows, options, key)
            codes[rows] = TEST
            codes[rows & train] = TRAINING
        else:
            codes[rows] = TRAINING
        roles[key] = codes
    if learning and not any((roles[key] == TRAINING).any() for key in learning):
        raise DataError(_none_left({key: flights[key] for key in learning}, ratio, because or {}))
    return roles


def _none_left(flights: Mapping[str, pd.DataFrame], ratio: float, because: Mapping[str, str]) -> str:
    """Why flights that ought to train have no training row: none is valid, or the draw left none."""
    valid = {key: used_rows(flight) for key, flight in flights.items()}
    barren = [key for key, rows in valid.items() if not rows.any()]
    # a reason that several flights share is reported once
    alike: dict[str, list[str]] = {}
    for key in barren:
        alike.setdefault(because.get(key, ""), []).append(key)
    reasons = [
        f"no row of flight{'s' * (len(keys) > 1)} {', '.join(keys)} is valid for identification{': ' * bool(why)}{why}"
        for why, keys in alike.items()
    ]
    if len(barren) == len(flights):
        look = f"the pages results/reports/<quadrotor>/{barren[0] if len(barren) == 1 else '<flight>'}.html and "
        look += "logs/filtering/ say more; correct or replace the recordings"
        return f"no training rows are left: {'; '.join(reasons)}; {look}"
    inside = [key for key, rows in valid.items() if rows[usable(len(rows), ratio)].any()]
    if not inside:
        advice = "the valid rows of the others lie in the ends that 'usable data ratio' cuts off; raise it"
    else:
        advice = "raise 'partition ratio', or add flights"
    return f"no training rows are left in the flights {', '.join(flights)}; {'; '.join([*reasons, advice])}"


def draw_flights(keys: list[str], share: float, seed: int) -> set[str]:
    """Keys of the flights that train when whole flights are drawn: a share of them, at least one, and not all of them
    unless the share is 1. Each flight's place in the draw depends on the seed and its key alone.

    Raises DataError when there is one flight only, which cannot both train and test.
    """
    if len(keys) == 1 and share < 1:
        raise DataError(
            f"'partition by' is 'flights', but there is one training flight only ({', '.join(keys)}); "
            "add flights, or draw 'blocks'"
        )
    place = {key: np.random.default_rng([seed, zlib.crc32(key.encode())]).random() for key in keys}
    count = len(keys) if share >= 1 else min(max(round(share * len(keys)), 1), len(keys) - 1)
    return set(sorted(keys, key=place.__getitem__)[:count])


def _draw(flight: pd.DataFrame, rows: np.ndarray, options: Mapping[str, Any], key: str) -> np.ndarray:
    # the key enters the seed: another flight in the selection leaves this flight's draw as it was
    generator = np.random.default_rng([int(options.get("seed", 0)), zlib.crc32(key.encode())])
    share = float(options.get("partition ratio", 0.75))
    train = np.zeros(len(rows), bool)
    places = np.flatnonzero(rows)
    if options.get("partition by", "samples") == "blocks":
        t = flight["t"].to_numpy()
        blocks = ((t - t[0]) / float(options.get("block length", 1.0))).astype(int)
        present = np.unique(blocks[rows])
        chosen = generator.permutation(present)[: max(round(share * len(present)), 1)]
        return rows & np.isin(blocks, chosen)
    train[generator.permutation(places)[: int(share * len(places))]] = True
    return train


def to_table(
    roles: Mapping[str, np.ndarray], excited: Mapping[str, Mapping[str, np.ndarray]] | None = None
) -> pd.DataFrame:
    """The partition as a table with columns flight, row, role (codes), unused rows left out.

    excited  regions of excitation {axis: {flight: (n,) bool}}, one more column each
    """
    parts = []
    for key, codes in roles.items():
        rows = np.flatnonzero(codes)
        part = pd.DataFrame({"flight": key, "row": rows.astype(np.int32), "role": codes[rows]})
        for axis, regions in (excited or {}).items():
            part[f"{EXCITED}{axis}"] = regions[key][rows]
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


def isolated(table: pd.DataFrame, rows: Mapping[str, int]) -> dict[str, dict[str, np.ndarray]]:
    """Regions of excitation {axis: {flight: (n,) bool}} that a partition's table holds; {} without isolation.

    rows  {flight: number of rows}; only used rows lie in a region
    """
    found: dict[str, dict[str, np.ndarray]] = {}
    for column in (c for c in table if c.startswith(EXCITED)):
        regions = found[column.removeprefix(EXCITED)] = {key: np.zeros(count, bool) for key, count in rows.items()}
        for key, part in table.groupby("flight", sort=False):
            if key in regions:
                regions[key][part["row"].to_numpy()] = part[column].to_numpy(bool)
    return found


def judged_rows(
    table: pd.DataFrame, flights: Mapping[str, pd.DataFrame], validation: Iterable[str], options: Mapping[str, Any]
) -> tuple[dict[str, np.ndarray], dict[str, dict[str, np.ndarray]]]:
    """Roles of the rows of all flights of a model, and per axis the training rows that isolation sets aside.

    table  the partition of the training flights; flights  all of them; validation  keys of those held out
    Returns ({flight: (n,) codes}, {axis: {flight: (n,) bool}}).
    """
    held = {key: flight for key, flight in flights.items() if key in set(validation)}
    counts = {key: len(flight) for key, flight in flights.items() if key not in held}
    codes = from_table(table, counts)
    aside = {
        axis: {key: (codes[key] == TRAINING) & ~region for key, region in regions.items()}
        for axis, regions in isolated(table, counts).items()
    }
    return codes | (partition(held, validation=held, options=options) if held else {}), aside


def fitted(table: pd.DataFrame, rows: Mapping[str, int], axes: Iterable[str]) -> dict[str, np.ndarray]:
    """Rows that at least one of these axes was fitted to, {flight: (n,) bool}: training rows, where isolation applies
    those of an axis's regions only.

    table, rows  as for `from_table`, which also lists what is raised
    """
    found = {key: np.zeros(count, bool) for key, count in rows.items()}
    for axis in axes:
        for key, codes in from_table(table, rows, axis).items():
            found[key] |= codes == TRAINING
    return found


def from_table(table: pd.DataFrame, rows: Mapping[str, int], axis: str | None = None) -> dict[str, np.ndarray]:
    """Inverse of `to_table` for flights with the given numbers of rows.

    axis  whose training rows are asked for: where isolation applies, those outside its regions become unused
    Raises DataError when a flight is shorter than its rows, or isolation leaves an axis no training rows.
    """
    region = f"{EXCITED}{axis}"
    if axis is not None and region in table:
        training = table["role"] == TRAINING
        table = table[~training | table[region]]
        if training.any() and not (table["role"] == TRAINING).any():
            raise DataError(
                f"{axis}: no training rows are left after isolation to regions of excitation; lower 'excitation "
                "threshold', raise 'spread', or switch 'isolate to regions of excitation' off"
            )
    roles = {}
    for key, count in rows.items():
        part = table[table["flight"] == key]
        codes = np.zeros(count, np.int8)
        places = part["row"].to_numpy()
        if len(places) and places.max() >= count:
            raise DataError(
                f"the partition names row {places.max()} of flight {key}, which has {count} rows; make it anew"
            )
        codes[places] = part["role"].to_numpy()
        roles[key] = codes
    return roles
