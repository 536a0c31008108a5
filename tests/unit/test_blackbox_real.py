"""Real blackbox logs, frame by frame against the decode of an independent C program."""

import gzip
import math

import numpy as np
import pytest
from recordings import SHARED, needs_real

from quasi.importing.readers.blackbox import decode, read_blackbox
from quasi.importing.readers.blackbox_header import find_logs

REAL = "betaflight-4.2.11-stm32f7"


def reference(number, name=REAL):
    """Column names and {column: numbers} of a decode by the independent C program."""
    lines = gzip.decompress((SHARED / f"{name}.{number:02d}.csv.gz").read_bytes()).decode().splitlines()
    names = [column.strip() for column in lines[0].split(",")]
    rows = [line.split(",")[:35] for line in lines[1:] if line.lstrip()[:1].isdigit()]
    return names[:35], dict(zip(names, np.array(rows, float).T))


@needs_real
@pytest.mark.parametrize(("number", "more"), [(1, 11), (2, 1)])
def test_every_frame_of_a_real_log_equals_the_reference_decode(number, more):
    """The reference drops the P frames between a flight-mode event and the next I frame; these are `more` here."""
    data = (SHARED / f"{REAL}.bbl").read_bytes()
    frames = decode(data, find_logs(data, REAL)[number - 1])
    names, expected = reference(number)
    time = np.round(expected["time (s)"] * 1e6).astype(np.int64)
    assert len(frames.time) == len(time) + more
    at = np.searchsorted(frames.time, time)
    np.testing.assert_array_equal(frames.time[at], time)
    scales = {"gyroADC": math.pi / 180, "accSmooth": 9.80665 / 2048, "vbatLatest": 0.1, "amperageLatest": 0.01}
    for name in names[2:]:
        field = name.split(" ")[0]
        scale = scales.get(field.split("[")[0])
        got = frames.values[field][at]
        if scale is None:
            np.testing.assert_array_equal(got, expected[name], err_msg=name)
        else:
            # printed with two decimals; half a unit of the last, plus the float32 arithmetic of the printer
            np.testing.assert_allclose(got * scale, expected[name], atol=0.00501, err_msg=name)


@needs_real
def test_frames_that_only_this_reader_keeps_continue_the_log():
    data = (SHARED / f"{REAL}.bbl").read_bytes()
    for number in (1, 2):
        frames = decode(data, find_logs(data, REAL)[number - 1])
        # iterations run on without a jump into the next I frame, which states them itself
        assert set(np.diff(frames.values["loopIteration"])) == {16.0}
        assert np.all((np.diff(frames.time) > 1500) & (np.diff(frames.time) < 10_000))


@needs_real
def test_damaged_real_log_gives_the_two_frames_and_says_what_was_lost():
    recording = read_blackbox(SHARED / "damaged.bbl")
    _, expected = reference(1, "damaged")
    np.testing.assert_allclose(recording.series["onboard"].t, expected["time (s)"], atol=1e-9)
    (span,) = recording.metadata["corrupt spans"]
    assert span["end"] - span["start"] == pytest.approx(0.032079, abs=1e-6)
    assert recording.metadata["frames"]["P after damage"] == 5
