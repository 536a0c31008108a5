"""A flight's own trim and parameters: told by its first half, judged on its second, where the truth is known."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from plain_plant import made_model, with_simple_model

from quasi.gap.catalogue import catalogue
from quasi.gap.effect import vehicle_of
from quasi.gap.extension import extend
from quasi.gap.flights.gathering import gather
from quasi.gap.levels.rollouts import split_flights
from quasi.model.model import AXES, Model
from quasi.simulation.tools.rollout import rollout

RATE, SECONDS = 200.0, 24.0
LEARNED, TRUE = 0.04, 0.01  # share by which all rotors are stronger: in the other flights, in this one


def flown(truth, base, noise=0.002, seed=0):
    """A flight that a model flew open loop with slow common changes of rotor speed; forces as instruments see them."""
    t = np.arange(int(RATE * SECONDS)) / RATE
    rng = np.random.default_rng(seed)
    speeds = 1500.0 + 15.0 * np.sin(2.1 * t)[:, None] + 2.0 * np.sin(5.0 * t)[:, None] * np.array([1, -1, 1, -1])
    states = rollout(truth, t, np.zeros((len(t), 12)), speeds, np.array([0]), t[-1] - 0.5 / RATE)[0]
    t, speeds = t[: len(states)], speeds[: len(states)]
    names = ("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z")
    table = pd.DataFrame({"t": t, **dict(zip(names, states.T)), **{f"w{i + 1}": speeds[:, i] for i in range(4)}})
    table = table.assign(**{f"w{i}_dot": np.gradient(table[f"w{i}"], t) for i in range(1, 5)})
    wrench = truth.predict_columns(table)
    scale = np.array([1, 1, 1, 0.01, 0.01, 0.01]) * noise
    seen = {a: wrench[a] + scale[k] * rng.standard_normal(len(t)) for k, a in enumerate(AXES)}
    table = table.assign(**seen, valid=1.0)
    return table, gather("a", table, {}, base.airframe, base, 100.0)


def stronger(base, share):
    pairs = [(catalogue()["thrust_factor"], {"factor": share})]
    return Model(extend(base, pairs, vehicle_of(base), "stronger", "test"), "stronger")


@pytest.fixture(scope="module")
def base():
    return with_simple_model(made_model(reaction=0.0), 0.012)


def test_a_flights_own_thrust_is_told_by_its_first_half_and_cures_the_second(base):
    table, evidence = flown(stronger(base, TRUE), base)
    _, other = flown(stronger(base, LEARNED), base, seed=1)
    causes = [(catalogue()["thrust_factor"], {"factor": LEARNED})]
    found = split_flights.judge(
        [evidence], {"a": table}, [other], base, stronger(base, LEARNED), causes, vehicle_of(base), [0.5]
    )
    about = found["flights"]["a"]
    assert about["until"] == pytest.approx(SECONDS / 2, abs=0.1)
    whole = about["parameters"]["thrust_factor"]["factor"]["value"]
    # what its nuisances (1 % of mass and of thrust) may hold of the difference from the other flights
    assert TRUE - 0.001 < whole < LEARNED
    error = {who: e["velocity"]["0.5"] for who, e in found["errors"].items()}
    assert error["after"] > 2.0 * error["before"]  # 3 % off against 1 %
    assert error["after, own parameters"] < 0.8 * error["after"]
    assert error["after, trimmed"] < 0.1 * error["before"]
    assert error["before, trimmed"] < 0.5 * error["before"]  # less is believed where the other flights fit badly
    row = next(r for r in found["fell"]["after, trimmed"] if r["quantity"] == "velocity")
    assert row["value"] == pytest.approx(1.0 - error["after, trimmed"] / error["before"])


def test_a_cause_gains_where_it_is_there_and_loses_where_it_is_not(base):
    _, other = flown(stronger(base, LEARNED), base, seed=1)
    causes = [(catalogue()["thrust_factor"], {"factor": LEARNED})]
    learned, vehicle = stronger(base, LEARNED), vehicle_of(base)
    for truth, there in ((stronger(base, 0.05), True), (base, False)):
        table, evidence = flown(truth, base)
        share = split_flights.gain(
            [evidence], {"a": table}, [other], base, [(base, []), (learned, causes)], vehicle, "velocity", 0.5
        )
        assert (share > 0.9) if there else (share < 0.0), share


def test_the_second_half_tells_nothing(base):
    truth = stronger(base, TRUE)
    _, evidence = flown(truth, base)
    level = np.full(6, 1e-4)
    found = split_flights.own(evidence, base, base, (), vehicle_of(base), level)
    late = evidence.t > found.until + split_flights.FILTER_REACH
    spoiled = evidence.measured.copy()
    spoiled[late] += 1.0
    other = split_flights.own(replace(evidence, measured=spoiled), base, base, (), vehicle_of(base), level)
    np.testing.assert_allclose(other.trim, found.trim, rtol=1e-6)  # the filter works by Fourier transforms


def test_the_trim_is_the_ridge_solution_worked_out_by_hand_for_a_constant_force(base, monkeypatch):
    _, evidence = flown(base, base, noise=0.0)
    pushed = replace(evidence, measured=evidence.measured + [0, 0.02, 0, 0, 0, 0])
    monkeypatch.setattr(split_flights, "nuisances", lambda e: [("constant Fy", e.only("Fy", 1.0), 0.01)])
    level = np.full(6, 4e-4)
    found = split_flights.own(pushed, base, base, (), vehicle_of(base), level)
    part = split_flights.thin(
        pushed.only("Fy", 1.0)[:, :, None], pushed.breaks, pushed.t, split_flights.BAND, 2 * split_flights.ORDER
    )
    n = np.count_nonzero(pushed.t[part.rows] <= found.until)
    information = n / (split_flights.ROW_MEMORY * 4e-4)
    assert found.trim[1] == pytest.approx(0.02 * information / (information + 0.01**-2), rel=1e-6)
    assert found.trim_std[1] == pytest.approx((information + 0.01**-2) ** -0.5, rel=1e-6)
    np.testing.assert_allclose(np.delete(found.trim, 1), 0.0, atol=1e-12)


def test_a_flight_too_short_for_two_halves_tells_nothing(base):
    table, evidence = flown(base, base)
    short = gather("a", table[table["t"] < 8.0], {}, base.airframe, base, 100.0)
    vehicle = vehicle_of(base)
    assert (
        split_flights.judge([short], {"a": table[table["t"] < 8.0]}, [evidence], base, base, (), vehicle, [0.5]) == {}
    )


def test_windows_that_diverge_under_one_model_are_no_smaller_there(base, monkeypatch):
    """What diverged counted with the largest of the rest, as if the model did well where it does worst."""
    table, evidence = flown(base, base)
    worse, vectors = stronger(base, 0.02), split_flights.open_loop.vectors

    def diverging(run, flight, starts, lags):
        found = vectors(run, flight, starts, lags) * (0.5 if run.worse else 1.0)
        found[::2] = np.nan if run.worse else 10.0
        return found

    class Run:
        def __init__(self, model, run):
            self.worse, self.run = model is worse, run

        def __getitem__(self, at):
            return self.run[at]

    simulated = split_flights.open_loop.simulated
    monkeypatch.setattr(split_flights.open_loop, "simulated", lambda model, *args: Run(model, simulated(model, *args)))
    monkeypatch.setattr(split_flights.open_loop, "vectors", diverging)
    sides = [(base, ()), (worse, ())]
    gone = split_flights.gain([evidence], {"a": table}, [evidence], base, sides, vehicle_of(base), "velocity", 0.5)
    assert abs(gone) < 0.01  # where both are known, the errors are small


def test_a_trim_acts_on_the_mass_and_inertia_that_a_model_has(base, monkeypatch):
    """What instruments of a vehicle show that is a fifth heavier than configured pushes it with a fifth more force."""
    vehicle, given = vehicle_of(base), {}
    heavier = [(catalogue()["mass"], {"mass": 0.2 * vehicle.mass})]
    heavier.append((catalogue()["inertia"], {"Ixx": 0.5 * vehicle.inertia[0, 0]}))
    extended = Model(extend(base, heavier, vehicle, "heavier", "test"), "heavier")
    table, evidence = flown(base, base)
    trim, simulated = np.array([0.01, 0.0, 0.02, 1e-4, 1e-4, 0.0]), split_flights.open_loop.simulated
    found = split_flights.Own(float(np.median(evidence.t)), {}, {}, trim, np.zeros(6))
    monkeypatch.setattr(split_flights, "own", lambda *args: found)

    def seen(model, flight, starts, horizon, commands=None, offsets=None):
        given.setdefault(model.id, []).append(offsets)
        return simulated(model, flight, starts, horizon, commands, offsets)

    monkeypatch.setattr(split_flights.open_loop, "simulated", seen)
    split_flights.judge([evidence], {"a": table}, [evidence], base, extended, heavier, vehicle, [0.5])
    (last,) = [offsets[0] for offsets in given["heavier"] if offsets is not None]
    assert last == pytest.approx(trim * [1.2, 1.2, 1.2, 1.5, 1.0, 1.0], rel=0.02)
    (first,) = [offsets[0] for offsets in given[base.id] if offsets is not None]
    assert first == pytest.approx(trim)
