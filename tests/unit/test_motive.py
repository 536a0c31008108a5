"""The Motive reader against poses known in Motive's own axes."""

import numpy as np
import pytest
from made_motion import at_times, body, motive_text
from scipy.spatial.transform import Rotation
from spreadsheets import FORMS, saved_anew

from quasi.attitude import to_euler
from quasi.doubt import doubts
from quasi.errors import ReadError
from quasi.importing.motive import read_motive

RATE = 120.0


@pytest.fixture(scope="module")
def take():
    truth = body(12.0)
    frame = np.arange(int(11.5 * RATE))
    return frame, np.round(frame / RATE, 3), *at_times(truth, frame / RATE)


def written(folder, text, name="take.csv"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def pose(recording):
    values = recording.series["capture"].values
    return (
        np.stack([values[n] for n in "xyz"], axis=-1),
        np.stack([values[n] for n in ("qw", "qx", "qy", "qz")], axis=-1),
    )


def angle_between(a, b):
    return (Rotation.from_quat(a, scalar_first=True).inv() * Rotation.from_quat(b, scalar_first=True)).magnitude()


@pytest.mark.parametrize(
    "style",
    [
        {},
        {"blank": False},
        {"labels": True, "parent": True},
        {"unit": "Millimeters", "other": "Quad2"},
        {"unit": "Centimeters", "labels": True},
        {"angles": "XYZ"},
        {"angles": "ZYX", "parent": True},
    ],
)
def test_every_form_of_export_gives_the_same_pose(tmp_path, take, style):
    frame, time, position, quaternion = take
    recording = read_motive(written(tmp_path, motive_text(frame, time, position, quaternion, **style)), "Quad")
    x, q = pose(recording)
    assert np.max(np.abs(x - position)) < 2e-6
    assert np.max(angle_between(q, quaternion)) < 1e-5
    assert recording.series["capture"].t == pytest.approx(frame / RATE, abs=1e-12)
    assert recording.metadata["frames removed"] == 0


@pytest.mark.parametrize(("axis", "expected"), [("z", (1, 0, 0)), ("x", (0, -1, 0)), ("y", (0, 0, -1))])
def test_turns_about_motives_axes_are_roll_minus_pitch_minus_yaw(tmp_path, axis, expected):
    q = Rotation.from_rotvec(0.3 * np.eye(3)["xyz".index(axis)]).as_quat()
    rows = "\n".join(f"{i},{i / 100:.6f}," + ",".join(f"{v:.7f}" for v in (*q, 0.1, 0.2, 0.3)) for i in range(10))
    text = (
        "Format Version,1.21,Export Frame Rate,100\n,,"
        + ",".join(["Rigid Body"] * 7)
        + "\n,,"
        + ",".join(["B"] * 7)
        + "\n,,"
        + ",".join(["1"] * 7)
        + "\n,,"
        + ",".join(["Rotation"] * 4 + ["Position"] * 3)
        + "\nFrame,Time,X,Y,Z,W,X,Y,Z\n"
        + rows
        + "\n"
    )
    x, q = pose(read_motive(written(tmp_path, text), "B"))
    assert to_euler(q)[4] == pytest.approx(0.3 * np.array(expected), abs=1e-6)
    assert x[4] == pytest.approx([0.3, -0.1, -0.2])


def test_identity_rotation_is_zero_attitude(tmp_path, take):
    frame, time, position, _ = take
    level = np.tile([1.0, 0, 0, 0], (len(frame), 1))
    _, q = pose(read_motive(written(tmp_path, motive_text(frame, time, position, level)), "Quad"))
    assert np.max(np.abs(to_euler(q))) == 0.0


def test_marker_offset_is_taken_off_in_body_axes(tmp_path, take):
    frame, time, position, quaternion = take
    offset = np.array([0.01, -0.02, -0.05])
    seen = position + Rotation.from_quat(quaternion, scalar_first=True).apply(offset)
    x, _ = pose(read_motive(written(tmp_path, motive_text(frame, time, seen, quaternion)), "Quad", offset))
    assert np.max(np.abs(x - position)) < 3e-6


def test_swaps_and_reflections_become_gaps_and_nothing_else_does(tmp_path, take):
    frame, time, position, quaternion = take
    rng = np.random.default_rng(3)
    x, q = position + rng.normal(0, 2e-4, position.shape), quaternion.copy()
    noise = Rotation.from_rotvec(rng.normal(0, 1e-3, position.shape))
    q = (Rotation.from_quat(q, scalar_first=True) * noise).as_quat(scalar_first=True)
    bad = np.zeros(len(frame), bool)
    for start, length, turn, shift in (
        (200, 1, 0.6, 0.0),
        (400, 5, 1.2, 0.03),
        (700, 60, 1.6, 0.05),
        (1000, 3, 0.0, 0.2),
    ):
        span = slice(start, start + length)
        bad[span] = True
        q[span] = (Rotation.from_quat(q[span], scalar_first=True) * Rotation.from_rotvec([0, turn, 0])).as_quat(
            scalar_first=True
        )
        x[span] += shift
    q[900:] *= -1
    x[300:305] = np.nan
    q[300:305] = np.nan
    recording = read_motive(written(tmp_path, motive_text(frame, time, x, q)), "Quad")
    seen, turned = pose(recording)
    lost = ~np.isfinite(seen).all(axis=1)
    expected = bad.copy()
    expected[300:305] = True
    assert lost.tolist() == expected.tolist()
    assert recording.metadata["frames lost"] == 5
    assert recording.metadata["frames removed"] == bad.sum()
    assert recording.metadata["quaternion sign flips"] == 1
    good = turned[~lost]
    assert np.min(np.sum(good[1:] * good[:-1], axis=1)) > 0
    kept = read_motive(tmp_path / "take.csv", "Quad", remove_outliers=False)
    assert kept.metadata["frames removed"] == 0


def test_wrong_name_is_refused_with_the_near_one_and_case_is_forgiven(tmp_path, take):
    frame, time, position, quaternion = take
    path = written(tmp_path, motive_text(frame, time, position, quaternion, name="Meta Beetle"))
    with pytest.raises(ReadError, match="did you mean 'Meta Beetle'"):
        read_motive(path, "MetaBeatle")
    assert read_motive(path, "meta_beetle").metadata["rigid body"] == "Meta Beetle"


def test_absent_rotation_is_said_and_position_still_read(tmp_path, take):
    frame, time, position, _ = take
    recording = read_motive(written(tmp_path, motive_text(frame, time, position, None)), "Quad")
    assert "qw" not in recording.series["capture"].values
    assert any("no rotation" in note for note in recording.notes)


def test_frames_counted_at_the_capture_rate_keep_the_right_time(tmp_path, take):
    frame, _, position, quaternion = take
    text = motive_text(frame[::2], frame[::2] / RATE, position[::2], quaternion[::2])
    text = text.replace("Export Frame Rate,120", "Export Frame Rate,60")
    recording = read_motive(written(tmp_path, text), "Quad")
    assert recording.series["capture"].t == pytest.approx(frame[::2] / RATE)
    assert recording.metadata["export rate"] == pytest.approx(60.0)


def test_text_cells_count_as_not_seen(tmp_path, take):
    frame, time, position, quaternion = take
    lines = motive_text(frame, time, position, quaternion).split("\n")
    lines[100] = lines[100].rsplit(",", 30)[0] + ",lost" * 30
    recording = read_motive(written(tmp_path, "\n".join(lines)), "Quad")
    assert recording.metadata["frames lost"] == 1
    assert any("text" in note for note in recording.notes)


@pytest.mark.parametrize("cut", [1, 30, 250, 420, 700, 1100, 5000])
def test_a_file_cut_anywhere_is_read_or_refused_in_a_sentence(tmp_path, take, cut):
    frame, time, position, quaternion = take
    text = motive_text(frame, time, position, quaternion)
    path = written(tmp_path, text[:cut])
    try:
        recording = read_motive(path, "Quad")
    except ReadError as error:
        assert "take.csv" in str(error)
    else:
        assert len(recording.series["capture"].t) >= 2


@pytest.mark.parametrize(("top", "separator", "decimal", "encoding"), FORMS)
@pytest.mark.parametrize("style", [{"labels": True}, {"angles": "XYZ", "unit": "Millimeters"}])
def test_what_a_spreadsheet_saved_reads_as_what_motive_wrote(tmp_path, take, style, top, separator, decimal, encoding):
    frame, time, position, quaternion = (a[:300] for a in take)
    text = motive_text(frame, time, position, quaternion, **style)
    plain = read_motive(written(tmp_path, text), "Quad")
    path = tmp_path / "saved.csv"
    path.write_text(top + saved_anew(text, separator, decimal), encoding=encoding, newline="")
    saved = read_motive(path, "Quad")
    np.testing.assert_array_equal(saved.series["capture"].t, plain.series["capture"].t)
    np.testing.assert_array_equal(np.hstack(pose(saved)), np.hstack(pose(plain)))
    assert saved.metadata["frame rate"] == plain.metadata["frame rate"]
    assert len(saved.notes) == 1 and "has been through a spreadsheet" in doubts(saved.notes)[0]
    assert not plain.notes


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        (lambda text: text.replace(".", ""), "have no decimals; a spreadsheet took their points for thousands separat"),
        (lambda text: "1.234" if text.startswith("0.0") else text.replace(".", ","), "may be decimal points or stand"),
        (lambda text: text if text.startswith("-0.") else text.replace(".", ","), "expected one of them throughout"),
    ],
)
def test_what_a_spreadsheet_spoilt_is_refused(tmp_path, take, cell, words):
    text = motive_text(*(a[:300] for a in take))
    lines = saved_anew(text, ";", ".").splitlines()
    changed = [
        ";".join([r[0], r[1].replace(".", ","), *map(cell, r[2:])]) for r in (line.split(";") for line in lines[7:])
    ]
    with pytest.raises(ReadError, match=words) as error:
        read_motive(written(tmp_path, "\n".join(lines[:7] + changed)), "Quad")
    assert "take.csv" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("above", ["# our lab, last version\n\n", "% x\n" * 50])
def test_comments_above_the_header_say_nothing(tmp_path, take, above):
    text = motive_text(*(a[:300] for a in take))
    plain = read_motive(written(tmp_path, text), "Quad")
    found = read_motive(written(tmp_path, above + text), "Quad")
    assert found.metadata == plain.metadata
    np.testing.assert_array_equal(np.hstack(pose(found)), np.hstack(pose(plain)))
