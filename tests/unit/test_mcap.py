"""MCAP recordings opened again: topics, schemas, poses by a derivation of their own, and the PlotJuggler layout."""

import json
import sys
import xml.etree.ElementTree as ElementTree

import jsonschema
import numpy as np
import pandas as pd
import plain_plant
import pytest
from flights import AIRFRAME, flight
from scipy.spatial.transform import Rotation
from simulations import setup_of

from quasi.errors import ConfigError
from quasi.export.mcap.plotjuggler import layout_text
from quasi.export.mcap.recording import write_recording
from quasi.export.mcap.vehicles import PATH_BEFORE, Event, phases_of, reference_of, vehicle_of, with_residuals
from quasi.gap.levels.rollouts.continuous import chase, chased_table
from quasi.gap.levels.rollouts.open_loop import flight_of
from quasi.simulation.loop.run import simulate

mcap = pytest.importorskip("mcap", reason="opens recordings; pip install quasi[mcap]")


def opened(path):
    """{topic: [(time ns, message)]} and {topic: schema}, every message checked against its schema."""
    from mcap.reader import make_reader

    messages, schemas = {}, {}
    with open(path, "rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema.encoding == "jsonschema" and channel.message_encoding == "json"
            content = json.loads(message.data)
            schemas.setdefault(channel.topic, (schema.name, jsonschema.Draft202012Validator(json.loads(schema.data))))
            schemas[channel.topic][1].validate(content)
            messages.setdefault(channel.topic, []).append((message.log_time, content))
    return messages, {topic: name for topic, (name, _) in schemas.items()}


@pytest.fixture(scope="module")
def table():
    made = flight(3, rows=1500, rate=250.0)
    made["in_flight"] = (made["t"] > 1.0).astype(float)
    made["valid"] = 1.0
    made.loc[700:720, "x"] = np.nan
    return made


@pytest.fixture(scope="module")
def recorded(table, tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "flight.mcap"
    vehicle = vehicle_of("measured", table)
    count = write_recording(path, [vehicle], phases_of(table), AIRFRAME)
    return vehicle, *opened(path), count


def test_topics_carry_foxglove_s_schemas(recorded):
    _, messages, schemas, count = recorded
    assert schemas["/tf"] == "foxglove.FrameTransforms" and schemas["/scene"] == "foxglove.SceneUpdate"
    assert schemas["/measured/pose"] == "foxglove.PoseInFrame" and schemas["/events"] == "foxglove.Log"
    assert {"/measured/state", "/measured/rotors", "/measured/loads"} <= set(messages)
    assert sum(map(len, messages.values())) == count


def test_poses_are_those_of_the_flight_in_axes_with_z_up(recorded, table):
    _, messages, _, _ = recorded
    turn = np.diag([1.0, -1.0, -1.0])  # north east down to north west up, and body likewise
    for at, message in messages["/measured/pose"][::37]:
        row = table.iloc[int(np.argmin(np.abs(table["t"] - table["t"].iloc[0] - at * 1e-9)))]
        body = Rotation.from_euler("ZYX", row[["yaw", "pitch", "roll"]].to_numpy(float)).as_matrix()
        pose = message["pose"]
        found = Rotation.from_quat([pose["orientation"][c] for c in "xyzw"]).as_matrix()
        np.testing.assert_allclose(found, turn @ body @ turn, atol=1e-9)
        place = [pose["position"][c] for c in "xyz"]
        np.testing.assert_allclose(place, turn @ row[["x", "y", "z"]].to_numpy(float), atol=1e-12)
        assert message["timestamp"] == {"sec": at // 10**9, "nsec": at % 10**9}


def test_signals_have_quasi_s_axes_units_and_no_rows_of_unknown_places(recorded, table):
    vehicle, messages, _, _ = recorded
    at, state = messages["/measured/state"][10]
    row = table.iloc[int(np.argmin(np.abs(table["t"] - at * 1e-9)))]
    assert state["z"] == pytest.approx(row["z"]) and state["u"] == pytest.approx(row["u"])
    assert vehicle.units["u"] == "m/s" and vehicle.units["Mx"] == "N m"
    gap = [m for t, m in messages["/measured/state"] if 2.81 < t * 1e-9 < 2.87]
    assert gap and all("x" not in m and "y" in m for m in gap)
    assert not [t for t, _ in messages["/measured/pose"] if 2.81 < t * 1e-9 < 2.87]
    assert len(messages["/measured/state"]) <= 100.0 * 6.0 * 1.3  # at most about 100 Hz


def test_events_tell_where_the_flight_begins(recorded):
    _, messages, _, _ = recorded
    ((at, event),) = messages["/events"]
    assert event["message"] == "in flight" and at * 1e-9 == pytest.approx(1.004, abs=1e-6)


def test_a_simulation_and_its_reference_are_two_vehicles(tmp_path):
    model = plain_plant.made_model()
    steps = {"kind": "position steps", "steps": [[0, 0, 0, -1], [0.5, 1, 0, -1]]}
    result = simulate(setup_of(model, 1.0, references=steps)).table
    vehicles = [vehicle_of("simulated", result), reference_of(result)]
    write_recording(tmp_path / "s.mcap", vehicles, [Event(0.5, "step")])
    messages, _ = opened(tmp_path / "s.mcap")
    assert len(messages["/simulated/pose"]) == len(messages["/reference/pose"]) > 50
    place = messages["/reference/pose"][-1][1]["pose"]["position"]
    assert (place["x"], place["z"]) == (1.0, 1.0)
    entities = {e["id"] for e in messages["/scene"][0][1]["entities"]}
    assert {"simulated", "reference", "simulated path", "reference path"} == entities


def flown_of_model(model):
    """A flight that the model itself flew, as a filtered table."""
    references = {"kind": "figure eight", "amplitude": 1.0, "start": 0.1}
    table = simulate(setup_of(model, 6.0, references=references, noise={"add": False})).table
    return table.assign(valid=1.0, in_flight=1.0)


def test_simulations_follow_the_flight_and_restart_from_the_measured_state():
    model = plain_plant.made_model()
    table = flown_of_model(model)
    flown = flight_of("made", table)
    found = chase(model, flown, 0.5)
    assert len(found.starts) == 12 and np.all(np.diff(found.starts) == round(0.5 / 0.004))
    np.testing.assert_allclose(found.states[found.starts], flown.states[found.starts], atol=1e-12)
    inside = np.isfinite(found.states[:, 9])
    assert inside.mean() > 0.9
    # the model's own flight; rotor speeds are linear between samples, and drift grows over 0.5 s
    assert np.max(np.abs(found.states - flown.states)[inside, 9:]) < 0.02
    hole = flown._replace(valid=flown.valid & ~((flown.t > 2.0) & (flown.t < 2.3)))
    assert not np.isfinite(chase(model, hole, 0.5).states[(flown.t > 2.01) & (flown.t < 2.29), 0]).any()


def test_a_gap_is_three_vehicles_with_residuals(tmp_path):
    model = plain_plant.made_model()
    table = flown_of_model(model)
    flown = flight_of("made", table)
    vehicle = vehicle_of("before", chased_table(flown, chase(model, flown, 0.5)), PATH_BEFORE)
    vehicle = with_residuals(vehicle, model, table, model.airframe.mass)
    vehicles = [vehicle_of("measured", table), vehicle, vehicle._replace(name="after")]
    write_recording(tmp_path / "g.mcap", vehicles)
    messages, _ = opened(tmp_path / "g.mcap")
    assert {"/measured/pose", "/before/pose", "/after/pose", "/before/residuals"} <= set(messages)
    residuals = pd.DataFrame([m for _, m in messages["/before/residuals"]]).drop(columns="timestamp")
    assert list(residuals) == ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]
    # the flight is the model's own, but for the yaw moment of rotor accelerations
    assert residuals[["Fx", "Fy", "Fz", "Mx", "My"]].abs().max().max() < 1e-9
    layout = ElementTree.fromstring(layout_text(vehicles))
    curves = {curve.get("name") for curve in layout.iter("curve")}
    known = {f"{topic}/{field}" for topic, rows in messages.items() for _, m in rows[:5] for field in m}
    assert curves <= known and "/after/residuals/Fz" in curves
    tabs = [tab.get("tab_name") for tab in layout.iter("Tab")]
    assert "residuals" in tabs and "state 1" in tabs


def test_without_the_package_the_extra_is_named(monkeypatch, tmp_path, table):
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(ConfigError, match=r"quasi\[mcap\]"):
        write_recording(tmp_path / "x.mcap", [vehicle_of("measured", table)])
    assert not list(tmp_path.iterdir())
