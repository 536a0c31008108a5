"""What a gain stands beside: the best wrong cause and a polynomial, both where the named causes act."""

import dataclasses

import numpy as np
import pytest
from test_unexplained import NOISE, flight, ground, only  # noqa: F401
from test_wrench_level import EFFECTS, low

from quasi.gap.catalogue import catalogue, whole_of
from quasi.gap.effect import vehicle_of
from quasi.gap.levels.forces import held_out
from quasi.gap.levels.forces.case import Case
from quasi.gap.levels.forces.design import gather_design, moved
from quasi.gap.levels.forces.error_reduction import after, before, wrench_score
from quasi.gap.levels.forces.held_out import best_wrong, gain_axes
from quasi.gap.levels.forces.polynomial_baseline import polynomial
from quasi.gap.materiality import Cause
from quasi.gap.statistics.candidates import Candidate
from quasi.model.model import Model

ASKED = {n: catalogue()[n] for n in ("ground_effect", "thrust_factor", "rotor_acceleration_torque", "wind")}

WHOLE = {"c": 8.0, "levelling": 8.0}


@pytest.fixture(scope="module")
def case(ground):  # noqa: F811
    """Flights with ground effect, which is named, and with a yaw moment of rotors that speed up, which is not."""
    model = Model(ground[1].document, "test")
    vehicle = vehicle_of(model)

    def made(seed, affected):
        plain = low(ground, seed, "ground_effect", WHOLE, affected)
        if not affected:
            return plain
        turned = whole_of(ASKED["rotor_acceleration_torque"], plain, vehicle, {"inertia": 1e-6})
        return dataclasses.replace(plain, measured=plain.measured + turned)

    compared = [k >= 4 for k in range(8)]
    learning, held = [made(k, flag) for k, flag in enumerate(compared)], [made(90, True)]
    settings = {"extended model ID": "more"}
    case = Case(model, ASKED, vehicle, learning, compared, held, {}, [], (), settings)
    values = [{"ground_effect": WHOLE} if flag else {} for flag in compared]
    study = gather_design(learning, ASKED, vehicle, values)
    test = study.mixed(range(8), compared).test(Candidate("ground_effect", "changed", (0, 1)))
    named = [Cause(EFFECTS["ground_effect"], "changed", WHOLE, {"c": 0.1, "levelling": 0.1}, test, [])]
    old = wrench_score(held, before).mean()
    return case, study, named, old, wrench_score([flight(ground, 90)], before).mean()


def gone(case, found, old):
    [(name, model)] = found.items()
    return name, 1.0 - wrench_score(case.held, after(model, case.model)).mean() / old


def test_the_best_wrong_cause_is_the_best_where_the_named_ones_act(case, monkeypatch):
    case, study, named, old, floor = case
    assert [(2 in gain_axes(named, old, floor)), (5 in gain_axes(named, old, floor))] == [True, False]
    name, share = gone(case, best_wrong(case, study, named, [], old, floor), old)
    assert name == "thrust_factor" and share[2] > 0.1 and abs(share[5]) < 0.01
    # over all six axes another one is better, which mends what the named cause has no part in
    monkeypatch.setattr(held_out, "gain_axes", lambda *_: range(6))
    assert [*best_wrong(case, study, named, [], old, floor)] == ["rotor_acceleration_torque"]


def test_what_is_tied_is_no_wrong_cause_and_none_that_only_harms_is_the_best(case):
    case, study, named, old, floor = case
    assert "thrust_factor" not in best_wrong(case, study, named, ["thrust_factor"], old, floor)
    assert best_wrong(case, study, named, ["thrust_factor", "wind"], old, floor) == {}


def test_a_wrong_cause_is_fitted_to_all_that_is_there_not_to_what_the_right_one_leaves(case, monkeypatch):
    """Ground effect bends: what its slope at its size leaves of it is less than all of it."""
    case, study, named, old, floor = case

    def size(of):
        [model] = best_wrong(case, of, named, [], old, floor).values()
        [extension] = model.document["extensions"]
        return extension["parameters"]["factor"]["value"]

    unbent = size(moved(study, ASKED, case.vehicle, [{} for _ in case.learning]))
    assert size(study) == pytest.approx(unbent, rel=1e-9)
    monkeypatch.setattr(held_out, "moved", lambda study, *_: study)
    assert abs(size(study)) < 0.995 * abs(unbent)


def test_where_nothing_can_be_removed_a_gain_is_told_on_all_axes_of_the_causes(case):
    _, _, named, old, _ = case
    assert gain_axes(named, old, 0.95 * old) == [2, 3, 4]
    assert gain_axes(named, old, old * [0.1, 0.1, 0.95, 0.1, 0.95, 0.1]) == [3]


def test_a_polynomial_spends_its_terms_on_the_axes_that_it_is_given(ground):  # noqa: F811
    """A constant force that flights differ by would take the only term; the error of Fz is what it is for."""

    def planted(c):
        return only(0, np.full(len(c["u"]), 0.3)) + only(2, 0.03 * c["u"] ** 2)

    learn, held = [flight(ground, s, planted) for s in (1, 2)], flight(ground, 9, planted)
    everywhere, there = (polynomial(learn, 1, *axes)(held) for axes in ([], [[2]]))
    np.testing.assert_array_equal(everywhere[:, 2], held.residual[:, 2])
    np.testing.assert_array_equal(there[:, 0], held.residual[:, 0])
    np.testing.assert_allclose(np.std(there[:, 2]), NOISE[2], rtol=0.1)
