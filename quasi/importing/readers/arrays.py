"""Variables of MATLAB files (version 5) and NumPy archives as named columns. Nothing in them is run.

Structures become "flight.imu.gyro"; a matrix becomes "gyro[0]", "gyro[1]", ... along its shorter side. Variables of as
many samples were sampled together, and share a column of time of that length.
"""

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from quasi.errors import ReadError
from quasi.importing.readers.mat5 import Damaged, read_variables
from quasi.importing.readers.signals import Signals
from quasi.input_limits import MAX_UNPACKED_BYTES, check_size
from quasi.project.recognition import recognise
from quasi.tables import read_bytes

MOST_COLUMNS = 64  # of a matrix; a wider one is an image, not a vector
LEAST_SAMPLES = 20  # of a variable, as of a table


def read_arrays(path: Path, notes: list[str]) -> Signals:
    """All variables of numbers, in groups of as many samples.

    Raises ReadError where the file is damaged or holds none.
    """
    data = read_bytes(path)
    kind = recognise(data)
    columns: dict[str, np.ndarray] = {}
    left_out: list[str] = []
    for name, values in (_npz if kind is not None and kind.kind == "npz" else _mat)(path, data, left_out):
        columns |= _columns(name, values)
    if left_out:
        notes.append(f"{path}: {', '.join(left_out[:6])} hold no plain numbers; left out")
    lengths = sorted({len(values) for values in columns.values() if len(values) >= LEAST_SAMPLES})
    if not lengths:
        raise ReadError(
            f"{path} holds no variable of {LEAST_SAMPLES} or more numbers; save each signal as an array of its samples"
        )
    return Signals({f"{n} samples": pd.DataFrame({c: v for c, v in columns.items() if len(v) == n}) for n in lengths})


def _npz(path: Path, data: bytes, left_out: list[str]) -> Iterator[tuple[str, np.ndarray]]:
    try:
        archive = np.load(io.BytesIO(data), allow_pickle=False)
        names = archive.files
    except Exception as error:  # zipfile and numpy raise their own kinds for a damaged archive
        reason = " ".join(str(error).split())[:120] or "damaged"
        raise ReadError(f"{path} is no readable NumPy archive ({reason}); save it by numpy.savez") from None
    size = sum(member.file_size for member in archive.zip.infolist())
    check_size(path, size, MAX_UNPACKED_BYTES, "the unpacked archive", "save only the signals that are used")
    for name in names:
        try:
            values = archive[name]
        except Exception:  # an array of Python objects, which is never unpickled, or a damaged one
            left_out.append(name)
            continue
        for field in values.dtype.names or ():
            yield f"{name}.{field}", values[field]
        if values.dtype.names is None:
            yield name, values


def _mat(path: Path, data: bytes, left_out: list[str]) -> Iterator[tuple[str, np.ndarray]]:
    try:
        yield from read_variables(data, left_out)
    except Damaged as error:
        raise ReadError(f"{path} is no readable MATLAB file ({error}); save it again with -v7") from None


def _columns(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """{column: (n,)} of a variable, samples along its longest side."""
    values = np.squeeze(np.asarray(values))
    if values.dtype.kind not in "biuf" or values.ndim not in (1, 2):
        return {}
    if values.ndim == 1:
        return {name: values.astype(float)}
    if values.shape[0] < values.shape[1]:
        values = values.T
    if values.shape[1] > MOST_COLUMNS:
        return {}
    return {f"{name}[{k}]": values[:, k].astype(float) for k in range(values.shape[1])}
