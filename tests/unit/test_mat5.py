"""MATLAB files against scipy's writer and reader: arrays of every type, structures, packed or not."""

import io

import numpy as np
import pytest
from scipy.io import savemat

from quasi.importing.readers.mat5 import Damaged, read_variables

ARRAYS = {
    "a": np.arange(30.0),
    "single": np.arange(24, dtype=np.float32).reshape(4, 6),
    "whole": np.arange(-7, 7, dtype=np.int16),
    "large": np.array([2**60, -5], np.int64),
    "bytes": np.arange(200, dtype=np.uint8),
    "true": np.array([True, False, True]),
    "flight": {"t": np.linspace(0, 1, 20), "imu": {"gyro": np.arange(60.0).reshape(20, 3), "x": 3.5}},
}


def flat(values, prefix=""):
    for name, value in values.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", np.asarray(value)


def saved(values, **options):
    buffer = io.BytesIO()
    savemat(buffer, values, **options)
    return buffer.getvalue()


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("side", ["row", "column"])
def test_variables_come_out_as_they_were_saved(packed, side):
    left_out = []
    found = dict(read_variables(saved(ARRAYS, do_compression=packed, oned_as=side), left_out))
    expected = dict(flat(ARRAYS))
    assert set(found) == set(expected) and not left_out
    for name, values in expected.items():
        assert found[name].ndim == 2
        np.testing.assert_array_equal(np.squeeze(found[name]), np.squeeze(values))
        if values.ndim == 2:
            assert found[name].shape == values.shape


def test_other_classes_are_named_and_left_out():
    cells = np.empty(2, object)
    cells[:] = [np.arange(3.0), "b"]
    left_out = []
    values = {"text": "made", "cells": cells, "n": np.arange(3.0), "many": [{"a": 1.0}, {"a": 2.0}]}
    assert list(dict(read_variables(saved(values), left_out))) == ["n"]
    assert {"text", "cells"} <= set(left_out)


def test_damaged_bytes_raise_one_error():
    rng = np.random.default_rng(0)
    for packed in (False, True):
        data = saved(ARRAYS, do_compression=packed)
        for _ in range(3000):
            broken = bytearray(data)
            for at in rng.integers(124, len(data), int(rng.integers(1, 8))):
                broken[at] = rng.integers(0, 256)
            if rng.random() < 0.3:
                del broken[int(rng.integers(0, len(data))) :]
            try:
                for name, values in read_variables(bytes(broken), []):
                    assert isinstance(name, str) and values.size < 10**6
            except Damaged as error:
                assert str(error)
