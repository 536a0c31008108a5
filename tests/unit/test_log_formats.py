"""One made flight in every format that is read gives one flight; what is wrong with a log is named."""

import numpy as np
import pytest
from log_formats import NEEDS, RESOLUTION, TABLE_COLUMNS, WRITERS, made_flight

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
    recording = read_onboard(flown, quadrotor, None)
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
