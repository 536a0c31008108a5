"""Constant forces beyond what flights differ by: ties, on any axis that reference flights or the model speak for."""

from dataclasses import replace

import numpy as np
import pytest
from test_gap_extension import base_of
from test_gap_extension import flight as made

from quasi.gap.catalogue import catalogue
from quasi.gap.constant_loads import LOADS, constant_force_ties, in_ties
from quasi.gap.diagnosis import _suspected
from quasi.gap.report.wording import tie_sentence
from quasi.model.model import Model


def worthy_flights():
    base = base_of("withGravity")
    axes = {a: {**content, "R2": 0.9} for a, content in base.document["axes"].items()}
    model = Model({**base.document, "axes": axes})
    return model, [replace(made(model)[0], key=f"flight {k}") for k in range(4)]


@pytest.fixture(scope="module")
def flights():
    return worthy_flights()


@pytest.mark.parametrize("share", [0.0, 0.01, 0.14])
def test_a_constant_force_far_beyond_trim_is_a_tie_and_trim_is_not(flights, share):
    evidence = [replace_attitude(e) for e in flights[1]]
    compared, reference = evidence[:2], evidence[2:]
    pushed = {e.key for e in compared}

    def left(e):
        return e.only("Fx", share * e.mass * 9.81 if e.key in pushed else 0.0)

    found = constant_force_ties(compared, reference, left, [], catalogue(), 1e-3, 0.05)
    assert constant_force_ties(compared, reference, left, ["wind"], catalogue(), 1e-3, 0.05) == []
    if share < 0.05:
        assert found == []
        return
    [tie] = found
    assert tie["ids"] == list(LOADS[0].causes)
    assert tie["constant force"]["north"]["value"] == pytest.approx(share * compared[0].mass * 9.81, rel=0.02)
    assert tie["constant force"]["east"]["value"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("references", "ties"), [(2, 1), (1, 0), (0, 0)])
def test_a_force_that_references_lack_needs_no_model_that_explains_its_axis(flights, references, ties):
    """Without references, what a model that explains nothing of an axis leaves there is its own."""
    evidence = [replace(replace_attitude(e), excluded=(0, 1)) for e in flights[1]]
    compared, reference = evidence[:2], evidence[2 : 2 + references]
    pushed = {e.key for e in compared}

    def left(e):
        return e.only("Fx", 0.14 * e.mass * 9.81 if e.key in pushed else 0.0)

    assert len(constant_force_ties(compared, reference, left, [], catalogue(), 1e-3, 0.05)) == ties


def test_a_constant_error_that_held_out_flights_show_is_a_tie_however_small(flights):
    """Some percent of the weight are less than the material share of it, and most of the error of a gentle flight."""
    evidence = [replace_attitude(e) for e in flights[1]]
    compared, reference = evidence[:2], evidence[2:]
    pushed = {e.key for e in compared}

    def ties(shown):
        def left(e):
            return e.only("Fx", 0.03 * e.mass * 9.81 if e.key in pushed else 0.0)

        return constant_force_ties(compared, reference, left, [], catalogue(), 1e-3, 0.05, shown)

    assert ties([]) == ties(["Fz", "My"]) == []
    found = ties(["Fx"])
    assert [t["ids"] for t in found] == [list(LOADS[0].causes)]
    entry = {"channel": "Fx", "where": "everywhere", "since": "changed"}
    assert in_ties(entry, found)
    for other in ({"channel": "Fz"}, {"where": "speed"}, {"since": "always"}):
        assert not in_ties(entry | other, found)


@pytest.mark.parametrize(("share", "references"), [(0.0, 2), (-0.03, 2), (-0.1, 2), (0.1, 2), (-0.1, 1)])
def test_a_constant_vertical_force_beyond_what_flights_differ_by_is_a_tie(flights, share, references):
    evidence = [replace_attitude(e) for e in flights[1]]
    compared, reference = evidence[:2], evidence[2 : 2 + references]
    pushed = {e.key for e in compared}

    def left(e):
        return e.only("Fz", share * e.mass * 9.81 if e.key in pushed else 0.0)

    found = constant_force_ties(compared, reference, left, [], catalogue(), 1e-3, 0.05)
    for named in ("mass", "rotor_effectiveness", "ground_effect"):
        assert constant_force_ties(compared, reference, left, [named], catalogue(), 1e-3, 0.05) == []
    if abs(share) < 0.05 or references < 2:  # a model is identified with whatever vertical force there is
        assert found == []
        return
    [tie] = found
    assert tie["ids"] == ["mass", "thrust_factor", "rotor_speed_scale", "accelerometer_scale"]
    assert tie["since"] == "changed"
    assert tie["constant force"]["down"]["value"] == pytest.approx(share * compared[0].mass * 9.81, rel=0.02)
    assert tie_sentence(tie).startswith("A constant vertical force of 10 % of the weight pushes the vehicle (down = ")


def test_what_is_nearly_significant_and_would_explain_a_constant_force_stands_in_its_tie(flights):
    evidence = [replace_attitude(e) for e in flights[1]]
    compared, reference = evidence[:2], evidence[2:4]
    pushed = {e.key for e in compared}

    def left(e):
        return e.only("Fz", 0.1 * e.mass * 9.81 if e.key in pushed else 0.0)

    suspected = ["thrust_drift", "body_drag"]
    [tie] = constant_force_ties(compared, reference, left, [], catalogue(), 1e-3, 0.05, (), suspected)
    assert tie["ids"] == [*LOADS[1].causes, "thrust_drift"]
    entries = [{"id": n, "since": since, "p": p} for n, since, p in (
        ("a", "changed", 0.002), ("b", "changed", 0.02), ("c", "always", 0.002), ("d", "changed", None))]  # fmt: skip
    assert _suspected(entries) == {"a"}


@pytest.mark.parametrize(("references", "sessions"), [(1, "aaaaa"), (2, "aaaabb")])
def test_healthy_flights_seldom_have_a_constant_force(flights, references, sessions):
    """What the mean of few references errs by, and what a session differs by, all compared flights have in common: at
    a thousandth, either had been called a force in one of thirty sets."""
    evidence, rng, alarms = replace_attitude(flights[1][0]), np.random.default_rng(0), 0
    named = [replace(evidence, key=f"{k}", session=s) for k, s in enumerate(sessions)]
    weight, axis = evidence.mass * 9.81, "Fx" if references == 1 else "Fz"
    own = 0.005 if axis == "Fx" else 0.015  # of force; of force, mass and thrust
    for _ in range(300):
        seat = dict(zip("ab", 0.015 * rng.standard_normal(2))) if axis == "Fz" else dict.fromkeys("ab", 0.0)
        push = {e.key: weight * (seat[e.session] + own * rng.standard_normal()) for e in named}
        shown = ["Fx"] if axis == "Fx" else []
        found = constant_force_ties(
            named[:4], named[4:], lambda e, push=push: e.only(axis, push[e.key]), [], catalogue(), 1e-3, 0.05, shown
        )
        alarms += bool(found)
    assert alarms <= 2


def test_a_force_that_drifts_is_no_constant_one(flights):
    """Thrust that fades from nothing to a fifth of the weight has a mean of a tenth, and none at first."""
    evidence = [replace_attitude(e) for e in flights[1]]
    compared, reference = evidence[:2], evidence[2:4]
    pushed = {e.key for e in compared}

    def left(e):
        return e.only("Fz", 0.2 * e.mass * 9.81 * np.linspace(0.0, 1.0, len(e)) if e.key in pushed else 0.0)

    assert constant_force_ties(compared, reference, left, [], catalogue(), 1e-3, 0.05) == []


@pytest.mark.parametrize(("turned", "on_board", "constant"), [(0.0, False, True), (np.pi, True, True),
                                                             (np.pi, False, True), (0.0, True, False)])  # fmt: skip
def test_a_constant_force_is_alike_in_the_room_or_on_the_vehicle(flights, turned, on_board, constant):
    """Pushes to either side in turn were a tie of wind, tether and bias, next to an error of unknown form."""
    evidence = [replace_attitude(e) for e in flights[1]]
    compared, reference = evidence[:2], evidence[2:]
    heading = {compared[0].key: 0.0, compared[1].key: turned}
    compared = [replace(e, columns={**e.columns, "yaw": np.full(len(e), heading[e.key])}) for e in compared]
    # north in the room, or forward on the vehicle; where it is not constant, forward and backward in turn
    side = {e.key: 1.0 if on_board and constant else np.cos(heading[e.key]) for e in compared}
    if not constant:
        side = dict(zip(side, (1.0, -0.9)))

    def left(e):
        return e.only("Fx", side.get(e.key, 0.0) * 0.14 * e.mass * 9.81)

    assert bool(constant_force_ties(compared, reference, left, [], catalogue(), 1e-3, 0.05)) is constant


@pytest.mark.parametrize("excluded", [(), (1,)])
def test_a_force_that_all_flights_have_on_the_vehicle_is_no_change_at_another_heading(flights, excluded):
    evidence = [replace(replace_attitude(e), excluded=excluded) for e in flights[1]]
    compared, reference = evidence[:2], evidence[2:3]
    compared = [replace(e, columns={**e.columns, "yaw": np.full(len(e), np.pi)}) for e in compared]
    for there, ties in (([*compared, *reference], 0), (compared, 1)):
        keys = {e.key for e in there}

        def left(e, keys=keys):
            return e.only("Fx", 0.07 * e.mass * 9.81 if e.key in keys else 0.0)

        assert len(constant_force_ties(compared, reference, left, [], catalogue(), 1e-3, 0.05)) == ties


def test_a_force_of_the_room_is_one_while_the_vehicle_turns(flights):
    """It then has no mean on the vehicle."""
    evidence = [replace_attitude(e) for e in flights[1]]
    compared, reference = evidence[:2], evidence[2:3]
    turning = {e.key: np.linspace(0.0, 4.0 * np.pi, len(e)) for e in compared}
    compared = [replace(e, columns={**e.columns, "yaw": turning[e.key]}) for e in compared]

    def left(e):
        yaw = turning.get(e.key, np.full(len(e), np.pi / 2.0))
        return 0.14 * e.mass * 9.81 * (e.only("Fx", np.cos(yaw)) - e.only("Fy", np.sin(yaw) * (e.key in turning)))

    assert len(constant_force_ties(compared, reference, left, [], catalogue(), 1e-3, 0.05)) == 1


def test_an_excluded_axis_makes_no_force_constant(flights):
    """Forward and backward in turn, and always to the right by what a model that explains nothing there leaves."""
    evidence = [replace(replace_attitude(e), excluded=(1,)) for e in flights[1]]
    compared, reference = evidence[:2], evidence[2:3]
    side = dict(zip((e.key for e in compared), (0.14, -0.13)))

    def left(e):
        size = e.mass * 9.81
        return e.only("Fx", side.get(e.key, 0.0) * size) + e.only("Fy", size)

    assert constant_force_ties(compared, reference, left, [], catalogue(), 1e-3, 0.05) == []


def replace_attitude(evidence):
    """The same flight, level and heading north."""
    level = dict.fromkeys(("roll", "pitch", "yaw"), np.zeros(len(evidence)))
    return replace(evidence, columns={**evidence.columns, **level})


def test_excluded_axes_do_not_push(flights):
    _, evidence = flights
    there = [replace(replace_attitude(e), excluded=(0, 1)) for e in evidence[:2]]

    def left(e):
        return np.full((len(e), 6), 10.0)

    assert constant_force_ties(there, [], left, [], catalogue(), 1e-3, 0.05) == []
