"""The Motive export: axes against the composed frame rotation, layout against the printed structure."""

import numpy as np
import pytest

from quasi import attitude
from quasi_synthesis import motive_writer, nuisance, sensors

# rotation of the capture frame G onto earth E: conjugate of q_x(90 deg) q_z(90 deg) = (0.5, -0.5, 0.5, -0.5)
FRAME = attitude.conjugate(
    attitude.multiply(attitude.exponential([np.pi / 2, 0, 0]), attitude.exponential([0, 0, np.pi / 2]))
)


@pytest.mark.parametrize(
    ("earth", "capture"), [([1, 0, 0], [0, 0, 1]), ([0, 1, 0], [-1, 0, 0]), ([0, 0, 1], [0, -1, 0])]
)
def test_north_is_z_east_is_minus_x_and_down_is_minus_y(earth, capture):
    np.testing.assert_array_equal(motive_writer.to_motive(np.array(earth, float)), capture)


def test_positions_and_attitudes_return_through_the_frame_rotation_of_quaternions():
    rng = np.random.default_rng(1)
    v, q = rng.normal(size=(20, 3)), attitude.normalise(rng.normal(size=(20, 4)))
    np.testing.assert_allclose(attitude.rotate(FRAME, motive_writer.to_motive(v)), v, atol=1e-12)
    x, y, z, w = motive_writer.quaternion_to_motive(q).T
    back = attitude.multiply(attitude.multiply(FRAME, np.column_stack([w, x, y, z])), attitude.conjugate(FRAME))
    np.testing.assert_allclose(back, q, atol=1e-12)


@pytest.mark.parametrize(("axis", "euler"), [(2, (0.2, 0, 0)), (0, (0, -0.2, 0)), (1, (0, 0, -0.2))])
def test_turns_about_motives_axes_are_roll_minus_pitch_and_minus_yaw(axis, euler):
    xyzw = motive_writer.quaternion_to_motive(attitude.from_euler(*euler))
    expected = np.zeros(4)
    expected[axis], expected[3] = np.sin(0.1), np.cos(0.1)
    np.testing.assert_allclose(xyzw, expected, atol=1e-12)


def still_take(seconds: float = 12.0, noise: float = 1.0, **errors) -> sensors.Capture:
    t = np.arange(0, seconds, 0.001)
    position = np.column_stack([np.sin(t), 0.5 * t, -1.0 - 0.1 * t])
    quaternion = attitude.from_euler(0.1 * np.sin(2 * t), 0.05 * t, 0.3 * t)
    settings = nuisance.nominal(120.0, noise).capture._replace(**errors)
    return sensors.capture(t, position, quaternion, settings, np.random.default_rng(3))


def test_markers_stand_where_pose_and_offset_put_them():
    take = still_take(noise=0.0, start=0.5)
    t = 0.5 + take.time
    body = attitude.from_euler(0.1 * np.sin(2 * t), 0.05 * t, 0.3 * t)
    cg = np.column_stack([np.sin(t), 0.5 * t, -1.0 - 0.1 * t])
    inside = t < 11.99
    marker = cg + attitude.rotate(body, np.array([0.0, -0.01, -0.048]))
    np.testing.assert_allclose(take.position[inside], marker[inside], atol=2e-6)
    np.testing.assert_allclose(take.markers.mean(axis=1)[inside], marker[inside], atol=2e-6)
    above = attitude.rotate_inverse(body, take.position - cg)[inside]
    assert (above[:, 2] < -0.04).all()  # a negative offset lies above the cg


def test_clock_skew_latency_and_late_rotation_move_what_they_name():
    plain = still_take(noise=0.0, start=0.0)
    fast = still_take(noise=0.0, start=0.0, skew=1e-3)
    i = 1000
    # the fast clock shows 1e-3 more at the same moment, so at the same reading less has happened
    np.testing.assert_allclose(fast.position[i, 1] - plain.position[i, 1], -0.5 * plain.time[i] * 1e-3, rtol=0.1)
    late = still_take(noise=0.0, start=0.0, rotation_delay=0.02)
    np.testing.assert_array_equal(late.position, plain.position)
    yaw = attitude.to_euler(late.quaternion)[i, 2] - attitude.to_euler(plain.quaternion)[i, 2]
    assert yaw == pytest.approx(-0.3 * 0.02, rel=0.2)


def test_misalignments_carry_the_assumed_axes_onto_the_true_ones():
    plain = still_take(noise=0.0, start=0.0)
    turned = still_take(noise=0.0, start=0.0, body_turn=np.array([0.02, 0, 0]))
    extra = attitude.logarithm(attitude.multiply(attitude.conjugate(plain.quaternion), turned.quaternion))
    np.testing.assert_allclose(extra, np.tile([0.02, 0, 0], (len(extra), 1)), atol=1e-9)
    # capture axes tilted by +roll: earth's down seen in them leans to +y
    tilted = still_take(noise=0.0, start=0.0, room_turn=np.array([0.02, 0, 0]))
    down = attitude.rotate(attitude.conjugate(attitude.exponential([0.02, 0, 0])), np.array([0.0, 0, 1]))
    assert down[1] > 0
    np.testing.assert_allclose(
        tilted.position, attitude.rotate(attitude.conjugate(attitude.exponential([0.02, 0, 0])), plain.position)
    )


def test_the_file_has_motives_rows_and_blank_cells_where_the_body_was_lost():
    take = still_take(drop_outs=6, swaps=2)
    lines = motive_writer.motive_csv(take, "Beetle", "take 1", "2026-03-14 10.21.33.412 AM").split("\n")
    first = lines[0].split(",")
    assert first[:2] == ["Format Version", "1.23"] and first[7] == "120.000000" and first[11].endswith("AM")
    assert lines[1] == ""
    kinds, names, ids, what, axes = (line.split(",") for line in lines[2:7])
    assert kinds[1:3] == ["Type", "Rigid Body"] and names[2] == '"Beetle"' and ids[1] == "ID"
    assert what[2:10] == ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
    assert axes[:9] == ["Frame", "Time (Seconds)", "X", "Y", "Z", "W", "X", "Y", "Z"]
    assert {"Rigid Body", "Rigid Body Marker", "Marker"} == set(kinds[2:])
    rows = [line.split(",") for line in lines[7:] if line]
    assert len(rows) == len(take.time) and {len(r) for r in rows} == {len(axes)}
    empty = np.array([r[2] == "" for r in rows])
    np.testing.assert_array_equal(empty, np.isnan(take.error))
    assert empty.any() and all(r[2:10] == [""] * 8 for r, e in zip(rows, empty) if e)
    good = [r for r, e in zip(rows, empty) if not e]
    xyzw = np.array([r[2:6] for r in good], float)
    np.testing.assert_allclose(np.linalg.norm(xyzw, axis=1), 1, atol=1e-5)
    assert [r[1] for r in rows[:3]] == ["0.000000", "0.008333", "0.016667"]
    assert len(take.faults["drop-outs"]) == 6 and len(take.faults["swaps"]) == 2
