"""The Motive reader against poses known in Motive's own axes."""

import numpy as np
import pytest
from made_motion import at_times, body, motive_text
from scipy.spatial.transform import Rotation
from spreadsheets import FORMS, saved_anew

from quasi.attitude import to_euler
from quasi.errors import ReadError, cautions
from quasi.importing.readers.motive import read_motive

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
    assert len(saved.notes) == 1 and "has been through a spreadsheet" in cautions(saved.notes)[0]
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


def flying(seed=3, seconds=20.0, rest=4.0, noise=2e-4):
    """A take that begins at rest, with the tracker's noise."""
    truth = body(seconds, rest=rest, seed=seed)
    frame = np.arange(int((seconds - 0.5) * RATE))
    position, quaternion = at_times(truth, frame / RATE)
    rng = np.random.default_rng(seed)
    turn = Rotation.from_quat(quaternion, scalar_first=True) * Rotation.from_rotvec(
        rng.normal(0, 5 * noise, position.shape)
    )
    return frame, position + rng.normal(0, noise, position.shape), turn.as_quat(scalar_first=True)


def held_frames(folder, frame, position, quaternion, **style):
    recording = read_motive(
        written(folder, motive_text(frame, frame / RATE, position, quaternion, digits=6, **style)), "Quad"
    )
    return np.flatnonzero(~np.isfinite(recording.series["capture"].values["x"])), recording


@pytest.mark.parametrize("style", [{}, {"angles": "XYZ"}, {"unit": "Millimeters"}])
def test_a_stream_that_stalls_is_lost_where_it_holds_an_older_pose(tmp_path, style):
    frame, position, quaternion = flying()
    stretches = ((900, 912), (1200, 1320), (1500, 1507))
    for a, b in stretches:
        position[a:b], quaternion[a:b] = position[a], quaternion[a]
    lost, recording = held_frames(tmp_path, frame, position, quaternion, **style)
    # the first frame of each stretch is the pose itself
    assert lost.tolist() == [k for a, b in stretches for k in range(a + 1, b)]
    assert recording.metadata["frames held"] == len(lost)
    assert recording.metadata["frames lost"] == recording.metadata["frames removed"] == 0
    (note,) = recording.notes
    assert f"in {len(lost)} of {len(frame)} frames (1.13 s, in 3 stretches, from 7.508, 10.008, 12.508 s of" in note


def test_a_stall_that_ends_in_lost_frames_or_with_the_take_is_told_by_the_dead_stop(tmp_path):
    frame, position, quaternion = flying()
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1) * RATE
    fast = int(np.argmax(speed[900:1500])) + 900
    assert speed[fast - 3 : fast].min() > 1.3
    position[fast : fast + 60], quaternion[fast : fast + 60] = position[fast], quaternion[fast]
    position[fast + 60 : fast + 100] = np.nan
    quaternion[fast + 60 : fast + 100] = np.nan
    lost, recording = held_frames(tmp_path, frame, position, quaternion)
    assert lost.tolist() == list(range(fast + 1, fast + 100))
    assert (recording.metadata["frames held"], recording.metadata["frames lost"]) == (59, 40)
    lost, _ = held_frames(tmp_path, frame[: fast + 50], position[: fast + 50], quaternion[: fast + 50])
    assert lost.tolist() == list(range(fast + 1, fast + 50))


def test_a_pose_held_from_the_first_frame_on_is_lost_with_its_first_frame(tmp_path):
    frame, position, quaternion = flying()
    position[:900], quaternion[:900] = position[700], quaternion[700]
    lost, _ = held_frames(tmp_path, frame, position, quaternion)
    assert lost.tolist() == list(range(900))


@pytest.mark.parametrize("decimals", [6, 4, 3, 2, 1])
@pytest.mark.parametrize(("noise", "seed"), [(0.0, 1), (2e-4, 2)])
def test_rest_and_slow_flight_in_few_digits_lose_nothing(tmp_path, decimals, noise, seed):
    frame, position, quaternion = flying(seed, noise=noise)
    slow = slice(1500, None)  # then a hover that drifts by centimetres
    position[slow] = position[1500] + 0.02 * (position[slow] - position[1500])
    quaternion[slow] = quaternion[1500] + 0.02 * (quaternion[slow] - quaternion[1500])
    quaternion[slow] /= np.linalg.norm(quaternion[slow], axis=1, keepdims=True)
    lost, recording = held_frames(tmp_path, frame, position.round(decimals), quaternion.round(decimals))
    assert recording.metadata["frames held"] == 0
    assert not any("to the last digit" in note for note in recording.notes)


@pytest.mark.parametrize("end", [20.0, 4.2])
def test_a_marker_swap_out_of_rest_throws_no_rest_away(tmp_path, end):
    frame, position, quaternion = flying(noise=0.0)
    position[:500], quaternion[:500] = position[0].copy(), quaternion[0].copy()
    swapped = np.zeros(len(frame), bool)
    for start, length in ((200, 30), (300, 1), (302, 1), (304, 1), (460, 35)):
        swapped[start : start + length] = True
    position[swapped] += 0.2
    n = int(end * RATE) if end < 10 else len(frame)
    lost, _ = held_frames(tmp_path, frame[:n], position[:n], quaternion[:n])
    assert swapped[lost].all()
