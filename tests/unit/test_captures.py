"""Vicon, Qualisys and C3D exports against poses known in the room's own axes, by scipy's rotations."""

import numpy as np
import pytest
from made_motion import at_times, body
from scipy.spatial.transform import Rotation

from quasi.errors import ReadError, cautions
from quasi.importing.readers.c3d import read_c3d
from quasi.importing.readers.qualisys import read_qualisys
from quasi.importing.readers.reader import Request
from quasi.importing.readers.registry import is_capture, read_capture
from quasi.importing.readers.vicon import read_vicon

RATE = 100.0
FLIP = np.array([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def take():
    """Times, position NED m, quaternion FRD to NED; and the same in a z-up room, mm, as rotations FLU to room."""
    truth = body(8.0)
    t = np.arange(int(7.5 * RATE)) / RATE
    position, quaternion = at_times(truth, t)
    half = Rotation.from_rotvec([np.pi, 0, 0])
    # with a slow turn on top, through more than half a circle
    slow = Rotation.from_euler("z", (3.3 * np.sin(0.8 * t))[:, None])
    room = slow * half * Rotation.from_quat(quaternion, scalar_first=True) * half.inv()
    quaternion = (half.inv() * room * half).as_quat(scalar_first=True)
    return t, position, quaternion, 1000 * position * FLIP, room


def pose(recording):
    values = recording.series["capture"].values
    stack = [np.stack([values[n] for n in names], axis=-1) for names in ("xyz", ("qw", "qx", "qy", "qz"))]
    return recording.series["capture"].t, *stack


def assert_is(recording, t, position, quaternion, place=1e-5, angle=1e-4):
    found_t, x, q = pose(recording)
    assert found_t == pytest.approx(t, abs=1e-9)
    seen = np.isfinite(x).all(axis=1)
    assert seen.any() and np.abs(x - position)[seen].max() < place
    turn = Rotation.from_quat(q[seen], scalar_first=True).inv() * Rotation.from_quat(
        quaternion[seen], scalar_first=True
    )
    assert turn.magnitude().max() < angle
    return seen


# Vicon


def vicon_text(take, kind="quaternion", name="Quad:Quad", hidden=(), other=None):
    _, _, _, places, room = take
    turns = {"quaternion": room.as_quat(), "vector": room.as_rotvec(), "degrees": np.degrees(room.as_rotvec()),
             "angles": room.as_euler("XYZ")}[kind]  # fmt: skip
    turns = np.column_stack([turns, places])
    turns[list(hidden)] = 0.0
    quantities = ["RX", "RY", "RZ", *(["RW"] if kind == "quaternion" else []), "TX", "TY", "TZ"]
    unit = "deg" if kind == "degrees" else "rad"
    units = [unit] * 3 + ([""] if kind == "quaternion" else []) + ["mm"] * 3
    names, blocks = [name, *([other] if other else [])], [turns, *([turns * 0 + 1] if other else [])]
    lines = ["Objects", "100", ",," + ",".join(n + "," * (len(quantities) - 1) for n in names)]
    lines.append(",".join(["Frame", "Sub Frame", *(quantities * len(names))]))
    lines.append(",".join(["", "", *(units * len(names))]))
    for k in range(len(turns)):
        lines.append(",".join([str(k + 1), "0", *(f"{v:.7f}" for block in blocks for v in block[k])]))
    return "\r\n".join([*lines, "", "Trajectories", "100", ""])


def written(folder, text, name):
    path = folder / name
    path.write_bytes(text.encode())
    return path


@pytest.mark.parametrize("kind", ["quaternion", "vector", "degrees", "angles"])
def test_each_form_of_a_vicon_export_gives_the_same_pose(tmp_path, take, kind):
    t, position, quaternion, _, room = take
    # angles are longer than half a turn, by which they can be distinguished from a vector
    assert np.linalg.norm(room.as_euler("XYZ"), axis=1).max() > np.pi + 0.05
    path = written(tmp_path, vicon_text(take, kind), "take.csv")
    assert is_capture(path)
    recording = read_capture(Request(path, rigid_body="quad"))
    assert_is(recording, t, position, quaternion)
    assert recording.metadata["format"] == "Vicon Objects" and recording.metadata["export rate"] == RATE


def test_frames_in_which_vicon_lost_the_object_are_gaps(tmp_path, take):
    path = written(tmp_path, vicon_text(take, hidden=range(100, 130)), "take.csv")
    recording = read_vicon(path, None, remove_outliers=False)
    seen = assert_is(recording, *take[:3])
    assert not seen[100:130].any() and seen[130:].all() and recording.metadata["frames lost"] == 30


def test_of_several_vicon_objects_one_has_to_be_named(tmp_path, take):
    path = written(tmp_path, vicon_text(take, other="Wand:Wand"), "take.csv")
    with pytest.raises(ReadError, match="rigid bodies Quad, Wand"):
        read_vicon(path, None)
    with pytest.raises(ReadError, match=r"'Quat'.*did you mean 'Quad'"):
        read_vicon(path, "Quat")
    assert_is(read_vicon(path, "Quad", remove_outliers=False), *take[:3])


def test_a_rotation_that_may_be_angles_calls_for_care(tmp_path, take):
    t, position, quaternion, places, _ = take
    gentle = Rotation.from_euler("XYZ", np.column_stack([0.3 * np.sin(t), 0.2 * np.cos(t), 0.5 * t / t[-1]]))
    path = written(tmp_path, vicon_text((t, position, quaternion, places, gentle), "vector"), "take.csv")
    assert any("rotation vector" in n for n in cautions(read_vicon(path, None).notes))
    path = written(tmp_path, vicon_text((t, position, quaternion, places, gentle)), "take.csv")
    assert not cautions(read_vicon(path, None).notes)


# Qualisys


def qualisys_text(take, bodies=("Quad",), hidden=()):
    t, _, _, places, room = take
    head = [["NO_OF_FRAMES", len(t)], ["NO_OF_CAMERAS", 8], ["NO_OF_BODIES", len(bodies)], ["FREQUENCY", 100],
            ["DESCRIPTION", "--"], ["TIME_STAMP", "2026-03-01, 10:00:00", 1.0], ["DATA_INCLUDED", "6D"],
            ["BODY_NAMES", *bodies]]  # fmt: skip
    columns = ["X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{k}]" for k in range(9))]
    lines = ["\t".join(map(str, row)) for row in head]
    lines.append("\t".join(["Frame", "Time", *(c for b in bodies for c in ["", *columns])]))
    angles = np.degrees(room.as_euler("xyz"))
    matrix = room.as_matrix().transpose(0, 2, 1).reshape(-1, 9)  # column by column
    for k in range(len(t)):
        row = [*places[k], *angles[k], 0.4, *matrix[k]] if k not in hidden else [0.0] * 16
        cells = [f"{v:.7f}" for v in row]
        lines.append("\t".join([str(k + 1), f"{t[k]:.5f}", *(c for _ in bodies for c in ["", *cells])]))
    return "\r\n".join(lines)


def test_a_qualisys_export_gives_the_pose(tmp_path, take):
    path = written(tmp_path, qualisys_text(take, hidden=set(range(200, 220))), "take.tsv")
    assert is_capture(path)
    recording = read_capture(Request(path, rigid_body=None, remove_outliers=False))
    seen = assert_is(recording, *take[:3])
    assert not seen[200:220].any() and recording.metadata["frames lost"] == 20
    with pytest.raises(ReadError, match="rigid bodies A, B"):
        read_qualisys(written(tmp_path, qualisys_text(take, ("A", "B")), "two.tsv"), None)
    assert_is(read_qualisys(tmp_path / "two.tsv", "B", remove_outliers=False), *take[:3])


def test_the_matrix_of_a_real_qualisys_row_turns_as_its_angles_say(tmp_path):
    # roll -0.65630, pitch 0.09391, yaw 0.05772 degrees and the matrix that QTM wrote for them
    matrix = ["1.00000", "0.00099", "-0.00165", "-0.00101", "0.99993", "-0.01145", "0.00164", "0.01145", "0.99993"]
    row = ["-194.91974", "2.24150", "0.99661", "-0.65630", "0.09391", "0.05772", "4.98536", *matrix]
    columns = ["X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{k}]" for k in range(9))]
    lines = [
        "NO_OF_FRAMES\t30",
        "FREQUENCY\t100",
        "DATA_INCLUDED\t6D",
        "BODY_NAMES\tP",
        "\t".join(["Frame", "Time", "P", *columns]),
    ]
    lines += ["\t".join([str(k + 1), "0", "", *row]) for k in range(30)]
    _, x, q = pose(read_qualisys(written(tmp_path, "\n".join(lines), "real.tsv"), None, remove_outliers=False))
    # roll keeps its sign from FLU to FRD; the position is m, north, east, down
    roll, pitch, yaw = np.degrees(Rotation.from_quat(q[0], scalar_first=True).as_euler("ZYX"))[::-1]
    assert (roll, pitch, yaw) == pytest.approx((-0.6563, -0.0939, -0.0577), abs=2e-3)
    assert x[0] == pytest.approx([-0.19492, -0.00224, -0.00100], abs=1e-5)


def test_markers_alone_are_refused_with_what_to_export(tmp_path):
    text = "NO_OF_FRAMES\t3\r\nFREQUENCY\t100\r\nDATA_INCLUDED\t3D\r\nMARKER_NAMES\ta\r\nX\tY\tZ\r\n1\t2\t3"
    with pytest.raises(ReadError, match="3D, expected 6D"):
        read_qualisys(written(tmp_path, text, "markers.tsv"), "Quad")


# C3D


def write_c3d(path, take, hidden=(), prefix="Quad:"):
    ezc3d = pytest.importorskip("ezc3d")
    t, _, _, places, room = take
    # markers of the body in FLU, mm, whose mean is the origin
    markers = np.array([[60, 40, 10], [-60, 45, 12], [-55, -50, 15], [70, -40, -37]], float)
    markers -= markers.mean(axis=0)
    spread = np.stack([room.apply(m) + places for m in markers], axis=0)  # markers, frames, axes
    points = np.ones((4, len(markers) + 1, len(t)))
    points[:3, : len(markers)] = spread.transpose(2, 0, 1)
    points[:3, len(markers)] = 5.0  # of something else in the room
    points[:3, 0, list(hidden)] = np.nan
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [RATE]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["LABELS"]["value"] = [f"{prefix}{k + 1}" for k in range(4)] + ["Wand"]
    file["data"]["points"] = points
    file.write(str(path))
    return path


def test_a_c3d_file_gives_position_and_the_turn_since_its_first_frames(tmp_path, take):
    t, position, quaternion, places, room = take
    # the body stands level, nose along x, for the frames by which its shape is known
    still = np.arange(len(t)) < 120
    first = Rotation.from_quat(np.where(still[:, None], [0, 0, 0, 1.0], (room * room[120].inv()).as_quat()))
    stood = np.where(still[:, None], places[120], places)
    half = Rotation.from_rotvec([np.pi, 0, 0])
    expected = (half * first * half.inv()).as_quat(scalar_first=True)
    path = write_c3d(tmp_path / "take.c3d", (t, position, quaternion, stood, first), hidden=range(300, 320))
    assert is_capture(path)
    recording = read_capture(Request(path, rigid_body="Quad", remove_outliers=False))
    seen = assert_is(recording, t, stood * FLIP / 1000, expected, place=1e-5, angle=2e-4)
    assert not seen[300:320].any() and recording.metadata["markers"] == [f"Quad:{k}" for k in range(1, 5)]
    assert any("first 100 frames" in n for n in cautions(recording.notes))
    assert_is(read_c3d(path, None, remove_outliers=False), t, stood * FLIP / 1000, expected, angle=2e-4)
    with pytest.raises(ReadError, match="begins with 'Drone'"):
        read_c3d(path, "Drone")


def test_damaged_c3d_files_raise_errors_of_ours_alone(tmp_path, take):
    pytest.importorskip("ezc3d")
    rng = np.random.default_rng(2)
    data, path = write_c3d(tmp_path / "whole.c3d", take).read_bytes(), tmp_path / "c.c3d"
    for share in (0.02, 0.3, 0.9):
        broken = bytearray(data[: int(share * len(data))])
        for place in rng.integers(0, len(broken), 8):
            broken[place] = rng.integers(0, 256)
        path.write_bytes(broken)
        try:
            read_c3d(path, None)
        except ReadError as error:
            assert str(tmp_path) in str(error)
