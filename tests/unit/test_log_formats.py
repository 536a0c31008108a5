"""One made flight in every format that is read gives one flight; what is wrong with a log is named."""

import numpy as np
import pytest
from log_formats import EPOCH, FLIP, NEEDS, RESOLUTION, TABLE_COLUMNS, WRITERS, made_flight, write_bag

from quasi.importing.flight import import_flight
from quasi.importing.onboard_log import read_onboard

GROUPS = {
    "rates": ("p", "q", "r"),
    "force": ("ax", "ay", "az"),
    "turn": ("qw", "qx", "qy", "qz"),
    "place": ("x", "y", "z"),
    "rotors": ("w1", "w2", "w3", "w4"),
    "share": ("command1", "command2", "command3", "command4"),
}


@pytest.fixture(scope="module")
def flight():
    return made_flight()


@pytest.fixture(scope="module")
def logs(flight, tmp_path_factory):
    """{format: (path, logbook's flight, quadrotor)}, each written once."""
    written = {}

    def log(name):
        if name in NEEDS:
            pytest.importorskip(NEEDS[name])
        if name not in written:
            controller, write = WRITERS[name]
            path = write(tmp_path_factory.mktemp("log"), flight)
            flown = {"flight": name.replace(" ", "_"), "quadrotor": "Q", "flight controller": controller,
                     "onboard": str(path), "capture": None, "log number": None}  # fmt: skip
            written[name] = (path, flown, {"table columns": TABLE_COLUMNS} if controller == "table" else {})
        return written[name]

    return log


def truth_of(flight):
    return {"rates": flight.rates, "force": flight.force, "turn": flight.q, "place": flight.p, "rotors": flight.rotors,
            "share": flight.commands}  # fmt: skip


@pytest.mark.parametrize("name", WRITERS)
def test_each_format_is_read_to_its_resolution(logs, flight, name):
    _, flown, quadrotor = logs(name)
    recording = read_onboard(flown, quadrotor)
    limits = RESOLUTION.get(name, RESOLUTION["default"])
    truth = truth_of(flight)
    for group, names in GROUPS.items():
        parts = [s for s in recording.series.values() if any(n in s.values for n in names)]
        found = {n: (s.t, s.values[n]) for s in parts for n in names if n in s.values}
        assert set(found) == set(names), f"{group}: {sorted(found)}"
        for column, n in enumerate(names):
            t, values = found[n]
            at = np.rint((t - t[0]) * 250).astype(int)
            assert np.abs((t - t[0]) - flight.t[at]).max() < 2e-6
            there = truth[group][at, column]
            if group == "turn":  # a quaternion and its negative are one attitude
                there = there * np.where(flight.q[at, 0] < 0, -1.0, 1.0)
            assert np.abs(values - there).max() < limits[group], f"{group} {n}"


@pytest.mark.parametrize("name", [n for n in WRITERS if n != "csv"])
def test_each_format_imports_as_the_table_does(logs, name):
    _, flown, quadrotor = logs("csv")
    expected, _ = import_flight(flown, quadrotor, {})
    _, flown, quadrotor = logs(name)
    found, about = import_flight(flown, quadrotor, {})
    assert about["verdict"] == "good", about["verdict because"]
    # the slower sources of the other formats end up to four samples earlier
    assert 0 <= len(expected) - len(found) <= 8
    rows = slice(200, min(len(found), len(expected)) - 200)
    for names, limit in ((("p", "q", "r"), 2e-3), (("ax", "ay", "az"), 0.02), (("x", "y", "z"), 2e-3),
                         (("u", "v", "w"), 0.02), (("roll", "pitch", "yaw"), 2e-3), (GROUPS["rotors"], 1.0),
                         (GROUPS["share"], 2e-3)):  # fmt: skip
        for n in names:
            assert np.abs(found[n].to_numpy()[rows] - expected[n].to_numpy()[rows]).max() < limit, n


def test_a_capture_in_a_bag_with_the_clock_of_another_host_is_tied_by_its_motion(tmp_path, flight):
    pytest.importorskip("rosbags")
    late = 8  # samples, 32 ms from the pose to its recording

    def poses(store, writer):
        kind = "geometry_msgs/msg/PoseStamped"
        connection = writer.add_connection("/vrpn/quad/pose", kind, typestore=store)
        kinds = store.types
        for k in range(late, len(flight.t), 2):
            stamp = EPOCH + round(1e9 * (flight.t[k - late] + 1800.3))
            time = kinds["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
            place, q = FLIP * flight.p[k - late], flight.q[k - late] * [1, 1, -1, -1]
            pose = kinds["geometry_msgs/msg/Pose"](
                position=kinds["geometry_msgs/msg/Point"](**dict(zip("xyz", place))),
                orientation=kinds["geometry_msgs/msg/Quaternion"](**dict(zip("wxyz", q))),
            )
            header = kinds["std_msgs/msg/Header"](stamp=time, frame_id="room")
            yield connection, k, store.serialize_cdr(kinds[kind](header=header, pose=pose), kind)

    path = write_bag(tmp_path, flight, extra=poses)
    flown = {"flight": "a", "quadrotor": "Q", "flight controller": "rosbag", "onboard": str(path), "capture": None,
             "log number": None}  # fmt: skip
    found, about = import_flight(flown, {}, {})
    assert any("/vrpn/quad/pose" in n and "ahead of the recorder's" in n for n in about["notes"])
    lag = about["synchronisation"]["lag"]
    assert abs(lag["value"]) == pytest.approx(late / 250, abs=5e-4)
    at = (found["t"] + about["start"]["value"]).to_numpy()
    true = np.interp(at, flight.t, flight.p[:, 0])
    assert np.abs(found["x"].to_numpy() - true)[300:-300].max() < 5e-3
