"""Hover speed, simple model, actuator constants from flights whose truth is known."""

import dataclasses

import numpy as np
import pytest
from flights import AIRFRAME, HOVER, PITCH, ROLL, THRUST, YAW, flight

from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.identification.partition import partition
from quasi.identification.shared import hover_speed, refuse_speedless, shared


@pytest.fixture(scope="module")
def flights():
    return {key: flight(seed, rows=6000) for seed, key in enumerate("ab")}


def test_hover_speed_is_where_thrust_carries_the_weight(flights):
    found = shared(flights, partition(flights), AIRFRAME)
    assert found["hover speed"]["value"] == pytest.approx(HOVER, rel=0.02)  # the made flights gain lift with speed
    assert set(found["hover speed"]["per flight"]) == {"a", "b"}


def test_net_forces_give_the_same_hover_speed(flights):
    net = {key: f.copy() for key, f in flights.items()}
    for f in net.values():
        f["Fz"] += AIRFRAME.mass * GRAVITY * np.cos(f["roll"]) * np.cos(f["pitch"])
    roles = partition(flights)
    felt, other = shared(flights, roles, AIRFRAME), shared(net, roles, AIRFRAME, gravity="noGravity")
    assert other["hover speed"]["value"] == pytest.approx(felt["hover speed"]["value"], rel=1e-9)
    kappa = felt["simple model"]["kappaFz"]["value"]
    assert other["simple model"]["kappaFz"]["value"] == pytest.approx(kappa, rel=1e-9)


def test_hover_speed_equals_the_printed_formula():
    n = 100
    values = {f"w{i}": np.full(n, 900.0) for i in range(1, 5)} | {"Fz": np.full(n, -5.0), "upright": np.ones(n)}
    assert hover_speed(values, 0.4) == pytest.approx(np.sqrt(0.4 * 9.81 / (4 * 5.0 / (4 * 900.0**2))))
    assert hover_speed({**values, "upright": np.zeros(n)}, 0.4) is None
    assert hover_speed({**values, "Fz": np.full(n, 5.0)}, 0.4) is None


def test_the_simple_model_goes_through_the_origin_and_carries_the_weight(flights):
    simple = shared(flights, partition(flights), AIRFRAME)["simple model"]
    assert simple["kappaFz"]["value"] == pytest.approx(THRUST, rel=0.03)
    for name, truth in (("kappaMx", ROLL), ("kappaMy", PITCH), ("kappaMz", YAW)):
        assert simple[name]["value"] == pytest.approx(truth, abs=4 * simple[name]["std"])
        assert 0 < simple[name]["std"] < 0.1 * truth
    speeds = sum(f[f"w{i}"].to_numpy() for f in flights.values() for i in range(1, 5))
    assert simple["kappaFz_w"]["value"] > 0
    assert np.isfinite(speeds).all()


def test_factors_are_not_centred_about_their_means():
    made = flight(5, rows=3000)
    still = made.assign(u=0.0, v=0.0, w=0.0)
    squares = sum(still[f"w{i}"] ** 2 for i in range(1, 5)).to_numpy()
    still["Fz"] = -(THRUST * squares + 0.8)  # a line that misses the origin
    simple = shared({"a": still}, {"a": np.ones(3000, int)}, AIRFRAME)["simple model"]["kappaFz"]
    origin = float(squares @ -still["Fz"]) / float(squares @ squares)
    centred = np.polyfit(squares, -still["Fz"], 1)[0]
    assert simple["value"] == pytest.approx(origin, rel=1e-9)
    assert centred == pytest.approx(THRUST, rel=1e-6)
    assert simple["value"] > 1.1 * centred  # what centring loses of the weight carried in hover
    assert simple["fitted together with"] == []


def test_flights_without_commands_are_a_note(flights):
    found = shared(flights, partition(flights), AIRFRAME)
    assert found["actuators"] is None
    assert any("logs no rotor command" in n for n in found["notes"])


def test_a_missing_column_is_an_error(flights):
    broken = {"a": flights["a"].drop(columns="Mz")}
    with pytest.raises(DataError, match="flight a has no column 'Mz'"):
        shared(broken, partition(broken), AIRFRAME)


def test_flights_without_rotor_speeds_are_refused_by_name(flights):
    refuse_speedless(flights)
    names = [f"w{i}" for i in range(1, 5)]
    with pytest.raises(
        DataError, match=r"flight a: the log holds no rotor speeds \(w1, w2, w3, w4\).*leave this flight"
    ):
        refuse_speedless({**flights, "a": flights["a"].drop(columns=names)})


def test_rotors_that_differ_leave_the_torque_factors_of_a_balanced_flight():
    """Thrust and yaw turn an airframe with a weak rotor and a displaced cg; the controller balances them at once."""
    rng, made = np.random.default_rng(4), flight(6, rows=6000)
    smooth = np.cumsum(rng.normal(size=(6000, 4)), axis=0)
    total, yaw, pitch, moment = ((smooth - smooth.mean(axis=0)) / smooth.std(axis=0)).T
    slopes = -THRUST * (AIRFRAME.hubs[:, 1] + 0.01) * np.array([1.0, 0.9, 1.0, 1.0])
    square = HOVER**2 * (1.0 + 0.1 * total[:, None] + 0.1 * yaw[:, None] * AIRFRAME.spin)
    square = square + HOVER**2 * 0.05 * pitch[:, None] * AIRFRAME.front
    wanted = 0.01 * THRUST * HOVER**2 * AIRFRAME.arm * moment
    square = square + ((wanted - square @ slopes) / (slopes @ AIRFRAME.left))[:, None] * AIRFRAME.left
    balanced = made.assign(**{f"w{i + 1}": np.sqrt(square[:, i]) for i in range(4)})
    balanced["Mx"] = wanted + rng.normal(scale=0.2 * wanted.std(), size=6000)
    found = shared({"a": balanced}, {"a": np.ones(6000, int)}, AIRFRAME)["simple model"]["kappaMx"]
    assert found["value"] == pytest.approx(slopes @ AIRFRAME.left / 4.0, rel=0.02)
    assert found["std"] < 0.02 * found["value"]


def test_a_plus_configuration_is_no_case_for_the_simple_model(flights):
    turned = AIRFRAME.hubs @ np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) / np.sqrt(2.0)
    plus = dataclasses.replace(AIRFRAME, hubs=np.where(np.abs(turned) < 0.5 * AIRFRAME.arm, 0.0, turned))
    for airframe, expected in ((AIRFRAME, 0), (plus, 1)):
        notes = shared(flights, partition(flights), airframe)["notes"]
        assert sum("plus configuration" in note for note in notes) == expected
