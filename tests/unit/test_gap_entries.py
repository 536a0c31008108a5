"""How often a cause has to come again in resamples before it is named, and the one figure of what it gains."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_gap_extension import base_of

from quasi.gap import verdict
from quasi.gap.catalogue import catalogue
from quasi.gap.effect import Effect, vehicle_of
from quasi.gap.entries import ALONE, STRONGEST, WEAKER, candidates, gain_entry, needed, of_late_telemetry, tie_entry
from quasi.gap.materiality import Cause
from quasi.gap.selection import Tie
from quasi.gap.statistics import mixed

LEVEL = 1e-3


def cause(name, p, foreign=False, since="always"):
    effect = Effect(name, "forces", "", "", "", absent_when_healthy=foreign)
    test = mixed.Test(mixed.Candidate(name, since, (0,)), np.zeros(1), np.eye(1), 1.0, 50.0, p)
    return Cause(effect, since, {}, {}, test, [])


def share(p, others=(), foreign=False, since="always", judged=True):
    own = cause("own", p, foreign, since)
    levels, unjudged = dict.fromkeys(("always", "changed"), LEVEL), [] if judged else [own]
    return needed(own, SimpleNamespace(causes=[own, *others], stand_ins=[], level=levels, unjudged=unjudged))


def test_a_cause_needs_to_come_again_more_often_beside_a_stronger_one():
    assert share(1e-4) == ALONE
    assert share(1e-4, [cause("fainter", 9e-4)]) == STRONGEST
    assert share(1e-4, [cause("stronger", 1e-9)]) == WEAKER
    assert share(1e-4, [cause("elsewhere", 1e-9, since="changed")]) == ALONE


def test_what_is_far_beyond_chance_needs_half_as_many_beside_a_stronger_one():
    stronger = [cause("stronger", 1e-12)]
    assert share(0.009 * LEVEL, stronger) == pytest.approx(0.5 * share(0.011 * LEVEL, stronger))
    for others, least in (([], ALONE), ([cause("fainter", 9e-4)], STRONGEST)):
        assert share(1e-9, others) == least  # a few seconds of flight, or what resembles it, may make all of it


@pytest.mark.parametrize("since, least", [("always", STRONGEST), ("changed", WEAKER)])
def test_what_no_sound_vehicle_has_is_no_remainder_of_what_a_model_lacks_of_its_own(since, least):
    lacking = cause("drag", 1e-20, since=since)
    assert share(1e-4, [lacking], foreign=True, since=since) == least
    assert share(1e-4, [cause("wind", 1e-20, True, since)], foreign=True, since=since) == WEAKER


def test_what_held_out_flights_cannot_judge_comes_again_more_often():
    assert share(1e-9, judged=False) == STRONGEST > ALONE
    stronger = [cause("stronger", 1e-12)]
    assert share(1e-9, stronger, judged=False) == STRONGEST > share(1e-9, stronger)
    assert share(9e-4, stronger, judged=False) == WEAKER


def test_a_cause_that_the_rotor_of_the_trim_explains_is_said_to_be_that():
    """It had been "found again in 100 % of the resamples only, expected 20 %"."""
    wind = cause("wind", 1e-9, since="changed")
    wind.probability, why = 1.0, "p = 0.3 with rotor 3 given, which the trim shows"
    empty = {name: [] for name in ("stand_ins", "ties", "immaterial", "unjudged", "ranking")}
    found = SimpleNamespace(causes=[wind], contradicted={"wind": (wind.test, why)}, level={"changed": LEVEL}, **empty)
    (entry,) = candidates(found, SimpleNamespace(causes=[], dropped=[]), 0.05)
    assert (entry["id"], entry["why_not"]) == ("wind", why)


def test_the_share_of_resamples_that_was_needed_is_the_one_that_is_said(monkeypatch):
    """A tie gave way later, and what had stood next to it was "found again in 60 % only, expected 20 %"."""

    def stop(*given):
        raise InterruptedError

    faint, first = cause("wind", 9e-4, since="changed"), cause("mass", 1e-9, since="changed")
    faint.probability, first.probability = 0.6, 1.0
    tie = SimpleNamespace(tests=[first.test])
    empty = {name: [] for name in ("immaterial", "unjudged", "ranking")}
    found = SimpleNamespace(causes=[faint], stand_ins=[first], ties=[("changed", tie)], contradicted={},
                            level={"changed": LEVEL}, **empty)  # fmt: skip
    monkeypatch.setattr(verdict, "_significant_next_to_rotor", stop)
    with pytest.raises(InterruptedError):
        verdict.judge_causes(SimpleNamespace(trim=None), found)
    verdict._drop_ties(found, first, "it gives way")
    said = {e["id"]: e["why_not"] for e in candidates(found, SimpleNamespace(causes=[], dropped=[]), 0.05)}
    assert said == {"mass": "it gives way", "wind": "found again in 60 % of the resamples only, expected 80 %"}


def delay(name, value, std=0.001, since="always"):
    return {"id": name, "since": since, "parameters": {"delay": {"value": value, "std": std, "unit": "s"}}}


def test_a_delay_that_the_model_has_from_late_telemetry_is_no_cause_of_its_own():
    late, lag = delay("telemetry_delay", 0.018), {"id": "motor_lag", "since": "always"}
    kept, found = of_late_telemetry([late, delay("command_delay", -0.0175), lag])
    assert kept == [late, lag]
    assert found[0]["id"] == "command_delay" and "it is 17.5 ± 1.0 ms shorter" in found[0]["text"]


@pytest.mark.parametrize(
    "others",
    [[], [delay("command_delay", 0.018)], [delay("command_delay", -0.012)],
     [delay("command_delay", -0.018, since="changed")]],
)  # fmt: skip
def test_other_delays_stay_causes(others):
    effects = [delay("telemetry_delay", 0.018), *others]
    assert of_late_telemetry(effects) == (effects, [])


def test_the_one_figure_of_a_cause_is_of_the_channel_where_it_removes_most_of_the_whole_error():
    wind = SimpleNamespace(effect=SimpleNamespace(channels=("Fx", "Fz")))
    gains = {"Fx": {"value": 0.994, "removable": 0.999}, "Fz": {"value": 0.9995, "removable": 0.992},
             "My": {"value": 1.0, "removable": 1.0}}  # fmt: skip
    entry = gain_entry(wind, gains)
    assert entry["gain channel"] == "Fx" and entry["gain"]["wrench"] == 0.994
    forces_alone = {axis: {"value": gain["value"]} for axis, gain in gains.items()}  # before roll-outs were scored
    assert gain_entry(wind, forces_alone)["gain channel"] == "Fz"
    assert gain_entry(wind, {"Fx": {"value": None, "removable": 0.0}})["gain channel"] is None


@pytest.mark.parametrize("share", [0.25, -0.2])
def test_a_tie_states_its_mass_as_a_name_does(share):
    """Its column's factor, which divides by the true mass, had been stated: 0.516 for 0.5375 kg."""
    vehicle, mass = vehicle_of(base_of("withGravity")), catalogue()["mass"]
    found = mass.apparent({"mass": share * vehicle.mass}, vehicle)["mass"]
    offer = mixed.Candidate("mass", "changed", (0,))
    test = mixed.Test(offer, np.array([found]), np.array([[1e-6]]), 1.0, 400.0, 1e-9)
    (stated,) = tie_entry("changed", Tie([test], 1.0), {"mass": mass}, vehicle)["parameters"]["mass"].values()
    assert stated["value"] == pytest.approx((1.0 + share) * vehicle.mass) and stated["std"] > 1e-3
