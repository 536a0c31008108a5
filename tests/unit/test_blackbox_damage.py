"""Damaged blackbox logs: garbage, cuts, wrong frames, blank storage, mutations, and files that are refused."""

import numpy as np
import pytest
from blackbox_writer import END, damaged_log, frames_of, intra_frame, log_bytes, svb, uvb

from quasi.errors import ReadError
from quasi.importing.readers.blackbox import read_blackbox
from quasi.importing.readers.blackbox_header import find_logs


def test_a_long_jump_without_resume_needs_a_second_witness():
    later = [intra_frame(96000 + 32 * i, 60_000_000 + 1000 * i) for i in range(3)]
    before = intra_frame(0, 1000) + intra_frame(32, 2000)
    frames = frames_of(log_bytes([], before + b"".join(later) + END))
    assert frames.time.tolist() == [1000, 2000, 60_001_000, 60_002_000]
    assert frames.counts["rejected"] == 1
    frames = frames_of(log_bytes([], intra_frame(0, 1000) + later[0] + intra_frame(32, 2000) + END))
    assert frames.counts["rejected"] == 1
    assert frames.time.tolist() == [1000, 2000]


def test_garbage_costs_the_frames_up_to_the_next_intra_frame_and_is_reported(tmp_path):
    data, offsets = damaged_log()
    broken = bytearray(data)
    broken[offsets[100] : offsets[103]] = b"\x07" * (offsets[103] - offsets[100])
    (tmp_path / "a.bbl").write_bytes(broken)
    frames = frames_of(bytes(broken))
    # the garbage begins where a frame letter should stand, so that the frame before is suspect too
    lost = sorted(set(range(40 * 32)) - set((frames.time // 1000).tolist()))
    assert lost == list(range(99, 128))
    np.testing.assert_array_equal(frames.values["n"], frames.time // 1000)
    recording = read_blackbox(tmp_path / "a.bbl")
    (span,) = recording.metadata["corrupt spans"]
    assert (span["start"], span["end"]) == (pytest.approx(0.098), pytest.approx(0.128))
    assert span["bytes"] == offsets[128] - offsets[99]
    assert [gap["cause"] for gap in recording.metadata["time gaps"]] == ["damage"]
    assert "0.030 s" in recording.notes[0]


def test_cut_anywhere_keeps_every_frame_before_the_cut(tmp_path):
    data, offsets = damaged_log()
    rng = np.random.default_rng(0)
    for cut in rng.integers(offsets[0] + 1, len(data), 60):
        frames = frames_of(data[:cut])
        whole = np.searchsorted(offsets, cut, side="right") - 1
        # a cut through the last values can leave a shorter frame that reads well
        assert whole <= len(frames.time) <= whole + 1
        np.testing.assert_array_equal(frames.time[:whole], 1000 * np.arange(whole))
    (tmp_path / "cut.bbl").write_bytes(data[: offsets[200] + 2])
    assert any("end-of-log" in note for note in read_blackbox(tmp_path / "cut.bbl").notes)


def test_much_garbage_neither_adds_frames_nor_unsays_those_before():
    data, offsets = damaged_log()
    rng = np.random.default_rng(1)
    garbage = rng.integers(0, 256, 1_000_000, dtype=np.uint8).tobytes()
    frames = frames_of(data[: offsets[640]] + garbage + data[offsets[640] :])
    expected = [*range(639), *range(640, 1280)]  # the frame before the garbage is not followed by a letter
    assert (frames.time // 1000).tolist() in (expected, sorted({*expected, 639}))
    np.testing.assert_array_equal(frames.values["n"], frames.time // 1000)
    assert len(frames.spans) == 1


def test_a_wrong_first_frame_gives_way_to_the_two_that_follow():
    data, offsets = damaged_log()
    head = data[: offsets[0]]
    wrong = intra_frame(7, 3_000_000_000, uvb(0))
    frames = frames_of(head + wrong + data[offsets[32] :])
    assert (frames.time // 1000).tolist() == list(range(64, 1280))
    assert frames.counts["rejected"] == 2


@pytest.mark.parametrize("padding", [b"\xff" * 5000, b"\x00" * 5000])
def test_blank_storage_behind_a_cut_log_is_no_damage(padding):
    data, offsets = damaged_log()
    frames = frames_of(data[: offsets[200]] + padding)
    assert len(frames.time) == 200
    assert len(frames.spans) == 0


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty"),
        (b"not a log at all", "holds no blackbox log"),
        (log_bytes([], b"") * 44, "44 logs, none with a readable frame"),
        (log_bytes([], b""), "no readable frame"),
        (log_bytes([], b"\x00" * 40), "no readable frame"),
        (log_bytes([], intra_frame(0, 1)).replace(b"version:2", b"version:1"), "data version is '1', expected 2"),
        (log_bytes([], intra_frame(0, 1)).replace(b"encoding:1,1", b"encoding:1,4"), "encoding 4"),
        (log_bytes([], intra_frame(0, 1)).replace(b"encoding:1,1", b"encoding:1"), "1 entries, expected 2"),
        (log_bytes([], intra_frame(0, 1)).replace(b"predictor:0,0", b"predictor:0,5", 1), "motor"),
        (log_bytes([], intra_frame(0, 1)).replace(b",time", b",tame"), "no time"),
        (log_bytes([], intra_frame(0, 1)).replace(b"signed:0,0", b"signed:0,9" + b"9" * 30), "small whole numbers"),
        (b"H Product:Blackbox\n" * 1500, "1500 log headers"),
    ],
)
def test_unreadable_files_are_refused_in_a_sentence(tmp_path, content, words):
    path = tmp_path / "bad.bbl"
    path.write_bytes(content)
    with pytest.raises(ReadError, match="bad.bbl") as error:
        read_blackbox(path)
    assert words in str(error.value)


def test_absent_file_is_named(tmp_path):
    with pytest.raises(ReadError, match=r"nowhere\.bbl does not exist"):
        read_blackbox(tmp_path / "nowhere.bbl")


def test_damaged_header_line_does_not_hide_the_log():
    data = log_bytes([("a", True)], intra_frame(0, 1, svb(4)) + END, header="Craft name:x\nacc_1G:2048")
    (log,) = find_logs(data.replace(b"H Craft name:x", b"\x01\x02\xff\x00broken"), "x")
    assert log.damage == 1
    assert log.header["acc_1G"] == "2048"
