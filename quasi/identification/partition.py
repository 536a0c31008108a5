"""Which rows train, which test, which validate.

The manual draws single samples at random. Neighbours of a 500 Hz log are nearly copies of each other, so that such a
test set says little about new flights; drawing blocks, and whole validation flights, are the honest figures.

Source: QuaSI user manual V1.0.a, listing 4 ("data partitioning").
"""

import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from quasi.errors import DataError

UNUSED, TRAINING, TEST, VALIDATION = 0, 1, 2, 3
ROLES = {"training": TRAINING, "test": TEST, "validation": VALIDATION}
UNITS = {"flight": ("", "", "flight key"), "row": ("", "", "row of the filtered flight"), "role": ("", "", "role code")}


def usable(rows: int, ratio: float) -> slice:
    """The middle part of a flight: int((rows - int(ratio rows)) / 2) rows are cut from each end."""
    cut = (rows - int(ratio * rows)) // 2
    return slice(cut, rows - cut)


def partition(
    flights: Mapping[str, pd.DataFrame], validation: Iterable[str] = (), options: Mapping[str, Any] | None = None
) -> dict[str, np.ndarray]:
    """Role of every row of every flight: {flight: (n,) int8 of UNUSED, TRAINING, TEST, VALIDATION}.

    flights     filtered flights; rows whose column valid or in_flight is 0 are not used
    validation  flights that are kept whole for validation
    options     "usable data ratio", "random partition", "partition ratio", "partition by" ("samples" or "blocks"),
                "block length" (s), "seed"; the draw of a flight depends on the seed and its key alone
    Raises DataError when no training row is left.
    """
    options = dict(options or {})
    ratio = float(options.get("usable data ratio", 0.9))
    validation = set(validation)
    roles = {}
    for key, flight in flights.items():
        codes = np.zeros(len(flight), np.int8)
        rows = np.zeros(len(flight), bool)
        rows[usable(len(flight), ratio)] = True
        for flag in ("valid", "in_flight"):
            if flag in flight:
                rows &= flight[flag].to_numpy() > 0.5
        if key in validation:
            codes[rows] = VALIDATION
        elif options.get("random partition", True):
            train = _draw(flight, rows, options, key)
            codes[rows] = TEST
            codes[rows & train] = TRAINING
        else:
            codes[rows] = TRAINING
        roles[key] = codes
    learning = [key for key in roles if key not in validation]
    if learning and not any((roles[key] == TRAINING).any() for key in learning):
        raise DataError(
            f"no training rows are left in the flights {', '.join(map(str, learning))}; "
            "raise 'usable data ratio' or 'partition ratio', or name fewer validation flights"
        )
    return roles


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


def to_table(roles: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """The partition as a table with columns flight, row, role (codes), unused rows left out."""
    parts = []
    for key, codes in roles.items():
        rows = np.flatnonzero(codes)
        parts.append(pd.DataFrame({"flight": key, "row": rows.astype(np.int32), "role": codes[rows]}))
    return pd.concat(parts, ignore_index=True)


def from_table(table: pd.DataFrame, rows: Mapping[str, int]) -> dict[str, np.ndarray]:
    """Inverse of `to_table` for flights with the given numbers of rows. Raises DataError when a flight is shorter."""
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
