"""Hover speed, simple model, actuator constants from flights whose truth is known."""

import numpy as np
import pytest
from flights import AIRFRAME, HOVER, PITCH, ROLL, THRUST, YAW, flight

from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.identification.partition import partition
from quasi.identification.shared import actuator_constants, hover_speed, shared


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


def lagged(tau, rate=500.0, seconds=20, seed=3):
    r = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    steps = np.repeat(r.uniform(0.2, 0.8, int(seconds * 5)), int(rate / 5))
    return t, steps, tau


def follow(command, tau, rate=500.0):
    speed = np.empty_like(command)
    speed[0] = command[0]
    for k in range(len(command) - 1):  # exact for a command held over the step
        speed[k + 1] = command[k] + (speed[k] - command[k]) * np.exp(-1 / (rate * tau))
    return speed


def test_time_constants_are_recovered_from_commanded_speeds(flights):
    t, steps, _ = lagged(0.03)
    data = {"t": t}
    for i, tau in enumerate((0.02, 0.03, 0.04, 0.03), 1):
        data[f"w{i}_CMD"] = 500 + 1000 * steps
        data[f"w{i}"] = follow(data[f"w{i}_CMD"], tau)
    found = actuator_constants(_frame(data), np.ones(len(t), bool))
    assert found["time constants"] == pytest.approx([0.02, 0.03, 0.04, 0.03], rel=0.06)
    assert found["command map"] is None


def test_the_map_from_command_to_speed_is_recovered_with_the_time_constant():
    t, steps, tau = lagged(0.03)
    speed = follow(200 + 1500 * steps - 300 * steps**2, tau)
    data = {"t": t} | {f"w{i}": speed for i in range(1, 5)} | {f"command{i}": steps for i in range(1, 5)}
    found = actuator_constants(_frame(data), np.ones(len(t), bool))
    assert found["time constants"] == pytest.approx([tau] * 4, rel=0.1)
    at = np.array([0.3, 0.5, 0.7])
    mapped = np.polyval(found["command map"][::-1], at)
    np.testing.assert_allclose(mapped, 200 + 1500 * at - 300 * at**2, rtol=0.02)


def test_flights_without_commands_are_a_note(flights):
    found = shared(flights, partition(flights), AIRFRAME)
    assert found["actuators"] is None
    assert any("logs no rotor command" in n for n in found["notes"])


def test_a_missing_column_is_an_error(flights):
    broken = {"a": flights["a"].drop(columns="Mz")}
    with pytest.raises(DataError, match="flight a has no column 'Mz'"):
        shared(broken, partition(broken), AIRFRAME)


def _frame(data):
    import pandas as pd

    return pd.DataFrame(data)
