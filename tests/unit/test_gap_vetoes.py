"""What rejects or limits a diagnosis: losses on held-out flights, a base model without worth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_constant_loads import worthy_flights

from quasi.filtering.forces import low_pass
from quasi.gap import diagnosis, verdict
from quasi.gap.base_model import Worth, worth_of
from quasi.gap.catalogue import catalogue
from quasi.gap.diagnosis import verdict_of
from quasi.gap.effect import vehicle_of
from quasi.gap.levels.forces.design import with_own_terms_anew
from quasi.gap.levels.forces.effect_size import drowned
from quasi.gap.levels.rollouts.confirmation import UNJUDGED, Confirmation, Settled
from quasi.gap.levels.trim_evidence import is_unanswered
from quasi.gap.losses import Loss, correcting_others, drive_losses, only_loss, reject_losing_causes, trim_is_usual
from quasi.gap.statistics.candidates import Candidate
from quasi.model.model import AXES, Model


def cause(name):
    return SimpleNamespace(name=name, effect=SimpleNamespace(channels=("Fx", "My")))


def test_a_cause_that_makes_held_out_flights_worse_is_rejected_and_the_others_stand():
    good, bad = cause("good"), cause("bad")
    grown = Loss("rollouts", "velocity x", 0.5, 1.0, 4.0)
    kept, rejected, left = reject_losing_causes([good, bad], list, lambda of: [grown] if bad in of else [])
    assert kept == [good]
    assert rejected == [(bad, grown)]
    assert left == []


@pytest.mark.parametrize(
    "loss",
    [Loss("rollouts", "velocity y", 0.5, 1.0, 1.2), Loss("rollouts with trim", "rate y", 0.5, 1.0, 1.2)],
    ids=["beyond the cause's axes", "without the cause too"],
)
def test_what_a_cause_does_not_answer_for_rejects_nothing(loss):
    one = cause("one")
    anyway = [loss] if loss.line == "rollouts with trim" else []
    kept, rejected, left = reject_losing_causes([one], list, lambda of: [loss] if of else anyway)
    assert (kept, rejected, left) == ([one], [], [loss])


@pytest.mark.parametrize("line", ["rollouts", "rollouts with trim", "forces"])
@pytest.mark.parametrize(("channels", "stands"), [(("Fx", "My"), False), (("Fx", "Mx", "My"), True), (("Mx",), True)])
def test_one_axis_of_a_vector_rejects_only_causes_that_act_on_that_axis_alone(line, channels, stands):
    one = SimpleNamespace(name="one", effect=SimpleNamespace(channels=channels))
    grown = Loss(line, "My" if line == "forces" else "rate y", 0.5, 1.0, 1.5, one_axis=True)
    kept, _, left = reject_losing_causes([one], list, lambda of: [grown] if of else [])
    assert (kept, left) == (([one], [grown]) if stands else ([], []))


@pytest.mark.parametrize("of_trim", [True, False])
def test_the_trim_of_a_flight_limits_the_verdict_and_rejects_nothing(of_trim):
    one = cause("one")
    grown = Loss("rollouts", "rate y", 0.5, 1.0, 1.5, of_trim)
    kept, _, left = reject_losing_causes([one], list, lambda of: [grown] if of else [])
    assert (kept, left) == (([one], [grown]) if of_trim else ([], []))


@pytest.mark.parametrize(("better", "stands"), [(3.0, True), (1.2, False)])
def test_a_cause_that_makes_more_better_than_worse_limits_the_verdict_and_stands(better, stands):
    one = cause("one")
    grown = Loss("rollouts", "rate y", 0.5, 1.0, 1.5)
    found = reject_losing_causes(
        [one], list, lambda of: [grown] if of else [],
        lambda of: np.array([1.0, 1.0, 1.0 if of else better, 1.0, 1.1, 1.0]),
    )  # fmt: skip
    assert found == (([one], [], [grown]) if stands else ([], [(one, grown)], []))


@pytest.mark.parametrize(
    ("shares", "simulated", "lost"),
    [
        ([(-0.05, -0.4, 0.3)], [(-0.5, -0.1), (-0.2, 0.4)], True),
        ([(0.1, -0.4, 0.3), (-0.2, -0.6, 0.3)], [(-0.5, -0.1)], True),
        ([(-0.05, -0.4, 0.3)], [(-0.5, -0.1), (0.01, 0.4)], False),  # another axis or horizon surely gains
        ([(0.1, 0.02, 0.3), (-0.2, -0.6, 0.3)], [(-0.5, -0.1)], False),  # a force does
        ([(0.2, -0.4, 0.3), (-0.1, -0.6, 0.3)], [(-0.5, -0.1)], False),  # forces and moments gain, not surely
        ([(-0.35, -0.4, -0.3)], [(-0.5, 0.1)], False),  # no simulation surely loses
        ([], [], False),
    ],
)
def test_a_cause_that_improves_nothing_and_makes_a_simulation_worse_is_none(shares, simulated, lost):
    rows = [{"quantity": "velocity z", "horizon": 0.5, "low": low, "high": high, "value": 0.5 * (low + high),
             "before": 1.0, "after": 1.0 - 0.5 * (low + high)} for low, high in simulated]  # fmt: skip
    loss = only_loss(shares, rows)
    assert (loss is not None) == lost
    assert loss is None or loss.sentence() == ("the error of velocity z after 0.5 s of simulation grows from 1 to 1.3")


def test_a_loss_that_no_rejection_ends_stays_and_rejects_nothing():
    one = cause("one")
    grown = Loss("forces", "Fz", 0.0, 1.0, 2.0)
    kept, rejected, left = reject_losing_causes([one], list, lambda of: [grown])
    assert (kept, rejected, left) == ([one], [], [grown])


def test_losses_and_excluded_axes_leave_nothing_fully_explained():
    named = [{"id": "wind"}]
    assert verdict_of(named, [], []) == "explained"
    assert verdict_of(named, [], [], limited=True) == "partly explained"
    assert verdict_of([{"id": "mocap_delay", "explains": False}], [], []) == "agrees"


@pytest.mark.parametrize("matters", [True, False])
def test_a_tie_of_sensors_whose_correction_changes_nothing_explains_nothing(monkeypatch, matters):
    pair = {"since": "always", "parameters": {}}
    turned = {"ids": ["mocap_misalignment", "imu_misalignment"], **pair}
    slow = {"ids": ["motor_lag", "command_delay"], **pair}  # of the drive, which import does not correct
    given = SimpleNamespace(
        levels={"sensors": {"effects": [], "ties": [turned]}, "drive": {"effects": [], "ties": [slow]}},
        base=SimpleNamespace(excluded=()), case=SimpleNamespace(model=None, settings={}), lower=([], []), order=None,
    )  # fmt: skip
    monkeypatch.setattr(diagnosis, "_correction_matters", lambda *_: matters)
    diagnosis._of_levels_below(given, {})
    assert turned.get("explains", True) == matters and "explains" not in slow
    assert verdict_of([], [turned], []) == ("partly explained" if matters else "agrees")
    assert verdict_of([], [turned, slow], []) == "partly explained"
    word = {"word": "open", "probability": {"healthy": 0.2, "cg_offset": 0.8}}
    assert is_unanswered({"hover trim": word, "effects": [], "ties": [turned]}) != matters


@pytest.fixture(scope="module")
def flights():
    return worthy_flights()


def test_an_axis_that_the_base_model_does_not_explain_is_excluded(flights):
    model, evidence = flights
    assert worth_of(model, evidence).excluded == ()
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(len(evidence[0]))
    spoiled = []
    for e in evidence:
        measured = e.measured.copy()
        measured[:, 3] = 10.0 * np.std(e.predicted[:, 3]) * noise[: len(e)] + 0.1 * noise[: len(e)]
        spoiled.append(replace(e, measured=measured))
    worth = worth_of(model, spoiled)
    assert worth.excluded == ("Mx",)
    assert "Mx" in worth.sentence()


@pytest.mark.parametrize(
    ("cutoff", "swing", "counts"), [(40.0, 0.0, True), (40.0, 5.0, False), (10.0, 0.0, False), (None, 0.0, False)]
)
def test_an_axis_of_which_noise_is_all_that_is_left_counts(flights, cutoff, swing, counts):
    """Noise ten times what the model explains has no memory beyond the low-pass; a swing of half of it has."""
    model, evidence = flights
    noisy, rng = [], np.random.default_rng(0)
    for e in evidence:
        noise = low_pass(rng.standard_normal(len(e)), 40.0, 1.0 / np.median(np.diff(e.t)))
        error = 10.0 * noise / np.std(noise) + swing * np.sin(2.0 * np.pi * 1.5 * e.t)
        measured = e.measured.copy()
        measured[:, 0] = e.predicted[:, 0] + np.std(e.predicted[:, 0]) * error
        noisy.append(replace(e, measured=measured, metadata={"filters": {"low-pass cutoff Hz": cutoff}}))
    assert worth_of(model, noisy).excluded == (() if counts else ("Fx",))


def test_an_axis_that_measures_nothing_is_excluded(flights):
    """Roll and pitch that are made of the specific force leave no sideward force but rounding."""
    model, evidence = flights
    rng, filters = np.random.default_rng(0), {"filters": {"low-pass cutoff Hz": 40.0}}
    empty = [
        replace(e, measured=e.predicted + e.only("Fx", 1e-18 * rng.standard_normal(len(e)) - e.predicted[:, 0]),
                predicted=e.predicted - e.only("Fx", e.predicted[:, 0]), metadata=filters)
        for e in evidence
    ]  # fmt: skip
    assert worth_of(model, empty).excluded == ("Fx",)


def test_terms_that_hold_what_sensors_faked_count_as_fitted_anew(flights):
    """An IMU away from the cg had doubled the sideward force; the flights are corrected since."""
    model, evidence = flights
    faked = [
        replace(e, measured=e.predicted, predicted=e.predicted + 2.0 * e.only("Fy", e.predicted[:, 1]))
        for e in evidence
    ]
    assert worth_of(model, faked).excluded == ("Fy",)
    assert worth_of(model, with_own_terms_anew(faked)).excluded == ()
    # what the terms cannot explain, they cannot explain anew either
    rng = np.random.default_rng(0)
    foreign = [replace(e, measured=e.measured + e.only("Fy", np.cumsum(rng.standard_normal(len(e))))) for e in evidence]
    assert worth_of(model, with_own_terms_anew(foreign)).excluded == ("Fy",)


@pytest.mark.parametrize(("share", "usual"), [(0.005, True), (0.2, False)])
def test_a_constant_error_is_a_trim_up_to_what_healthy_flights_differ_by(flights, share, usual):
    _, evidence = flights
    pushed = evidence[0].only("My", share * evidence[0].mass * 9.81 * evidence[0].airframe.arm)
    flat = [replace(e, measured=e.predicted) for e in evidence[:1]]
    assert trim_is_usual(flat, lambda e: pushed) is usual
    # nor has an axis that does not count a say
    assert trim_is_usual([replace(e, excluded=(4,)) for e in flat], lambda e: pushed)
    # an error that was there before the extension is none that it makes
    there = [replace(e, measured=e.predicted + pushed) for e in flat]
    assert trim_is_usual(there, lambda e: pushed)


def test_rotors_that_contradict_the_configuration_make_the_base_model_unusable(flights):
    model, evidence = flights
    wrong = Model({**model.document, "contradictions": ["rotor 1 pushes as if it were aft left"]})
    assert "unusable" in worth_of(wrong, evidence).sentence()


def test_a_share_just_below_nothing_is_no_negative_zero():
    worth = Worth({"Fx": -0.0003, "Fy": -0.06}, ("Fx", "Fy"), "")
    assert "Fx 0 %, Fy -6 %" in worth.sentence()


def test_a_lag_for_all_rotors_that_makes_three_of_them_worse_is_a_loss():
    """One slow motor: the speed of its rotor gains, those of the others lose."""
    sides = {
        "before": {"w1": 0.9, "w2": 21.0, "w3": 0.88, "w4": 0.8},
        "after": {"w1": 8.1, "w2": 13.0, "w3": 0.9, "w4": 6.9},
    }
    gap = {side: {"drive": {w: {"0": x} for w, x in errors.items()}} for side, errors in sides.items()}
    lost = drive_losses(gap)
    assert [loss.quantity for loss in lost] == ["w1", "w4"]
    assert lost[0].sentence() == "the error of the speed of rotor 1 on the held-out flights grows from 0.9 to 8.1"
    assert not drive_losses({side: {} for side in sides})


@pytest.mark.parametrize(
    ("made", "unknown", "gives_way"),
    [({"Fz": 0.016}, {"Fz": 0.12}, True),
     ({"Fz": 0.05}, {"Fz": 0.12}, False),  # a good part of what is unknown
     ({"Fz": 0.016}, {"Fx": 0.12}, False),  # unknown elsewhere
     ({"Fz": 0.016, "My": 3e-3}, {"Fz": 0.12}, False),  # it shows most in another axis
     ({"Fz": 0.016, "My": 3e-5}, {"Fz": 0.12}, True)],
)  # fmt: skip
def test_a_cause_far_below_an_unknown_error_of_its_axes_gives_way(made, unknown, gives_way):
    """Sizes in N and N m rms, of flights whose errors are 0.1 N and 1e-3 N m."""
    own, there = (np.array([sizes.get(a, 0.0) ** 2 for a in AXES]) for sizes in (made, unknown))
    assert drowned(own, np.array([0.1] * 3 + [1e-3] * 3) ** 2, there) is gives_way


def shown_by(name, p, axis, since="changed", apart=1.0):
    test = SimpleNamespace(p=p, offer=Candidate(name, since, (0,)))
    effect = SimpleNamespace(id=name, channels=("Fz", "Mz"))
    return SimpleNamespace(effect=effect, since=since, test=test, axis=axis, apart=apart)


@pytest.mark.parametrize(
    ("channel", "p", "since", "apart", "gives_way"),
    [("Mz", 1e-20, "changed", 1.0, True), ("Mz", 1e-3, "changed", 1.0, False),  # the unknown is fainter
     ("Fz", 1e-20, "changed", 1.0, False), ("Mz", 1e-20, "always", 1.0, False),
     # axes that disagree show a form that is not the cause's: each of them may be the unknown's
     ("Fz", 1e-20, "changed", 2.5, True), ("Fx", 1e-20, "changed", 2.5, False)],
)  # fmt: skip
def test_a_name_or_tie_gives_way_to_something_clearer_on_its_axis_that_no_cause_explains(
    monkeypatch, channel, p, since, apart, gives_way
):
    """Rotors that drag at their hubs damp yaw; what a function of the rate left of that had been a tilted rotor."""
    named, first = shown_by("rotor_tilt", 1e-9, 5, apart=apart), shown_by("torque_factor", 1e-7, 5)
    tie = SimpleNamespace(tests=[first.test, shown_by("inertia", 1e-7, 5).test], apart=apart)
    found = SimpleNamespace(ties=[("changed", tie)], stand_ins=[first], contradicted={}, study=None)
    monkeypatch.setattr(verdict, "gusts", lambda *given: [{"id": "gusts"}])
    confirmation = Confirmation(verdict.CONFIRMED, 1.0, 0.1, 5.0)
    settled = SimpleNamespace(causes=[named], confirmations={("rotor_tilt", "changed"): confirmation}, dropped=[])
    settled._replace = lambda **new: SimpleNamespace(**{**vars(settled), **new})
    monkeypatch.setattr(verdict, "_power", lambda c, case: (np.eye(6)[c.axis], np.ones(6)))
    case = SimpleNamespace(compared=[])
    entry = {"channel": channel, "where": "yaw rate", "since": since, "evidence": {"p": p}, "size": 1.0}
    result = verdict._fainter_than_unknown(case, settled, found, SimpleNamespace(entries=[entry]))
    assert bool(result.causes) is bool(found.ties) is bool(found.stand_ins) is not gives_way
    if gives_way:
        why = f"{channel} differs along the yaw rate in a way that no cause explains, and more clearly (p = 1e-20)"
        assert [c.why for _, c in result.dropped] == [why] and result.dropped[0][1].outcome == verdict.REFUTED
        assert {name: text for name, (_, text) in found.contradicted.items()} == dict.fromkeys(
            ("torque_factor", "inertia"), why
        )


@pytest.mark.parametrize(
    ("channels", "outcome", "stands"),
    [(("Mz",), UNJUDGED, False), (("Mz",), verdict.CONFIRMED, True), (("Fz", "Mz"), UNJUDGED, True)],
)
def test_a_moment_that_no_roll_out_confirms_gives_way_to_what_is_clearer_on_another_axis(
    monkeypatch, channels, outcome, stands
):
    """A guard that takes thrust from one rotor in fast flight had been a rotor with more inertia as well."""
    named = shown_by("rotor_acceleration_torque", 1e-4, 5)
    named.effect.channels = channels
    settled = Settled([named], [], {(named.effect.id, "changed"): Confirmation(outcome, 1.0, 0.1, 5.0)}, {}, [])
    monkeypatch.setattr(verdict, "_power", lambda c, case: (np.eye(6)[c.axis], np.ones(6)))
    entry = {"channel": "Mx", "where": "forward speed", "since": "changed", "evidence": {"p": 1e-36}, "size": 1.0}
    left, found = SimpleNamespace(entries=[entry]), SimpleNamespace(ties=[], stand_ins=[])
    assert bool(verdict._fainter_than_unknown(None, settled, found, left).causes) is stands


@pytest.mark.parametrize(("size", "stands"), [(0.1, True), (0.5, False)])
def test_a_name_gives_not_way_to_what_may_be_the_error_of_its_form(monkeypatch, size, stands):
    """A rotor with a seventh less thrust damps a seventh less as well, which leaves a roll moment along the pitch rate:
    clearer than the name, which has to exceed differences between sessions, and a hundredth of its square."""
    named = shown_by("rotor_effectiveness", 3e-5, 3)
    confirmation = Confirmation(verdict.CONFIRMED, 1.0, 0.1, 5.0)
    settled = SimpleNamespace(causes=[named], confirmations={(named.effect.id, "changed"): confirmation}, dropped=[])
    settled._replace = lambda **new: SimpleNamespace(**{**vars(settled), **new})
    monkeypatch.setattr(verdict, "_power", lambda c, case: (np.eye(6)[c.axis], np.ones(6)))
    entry = {"channel": "Mx", "where": "pitch rate", "since": "changed", "evidence": {"p": 2e-9}, "size": size}
    found = SimpleNamespace(ties=[], stand_ins=[], contradicted={})
    result = verdict._fainter_than_unknown(None, settled, found, SimpleNamespace(entries=[entry]))
    assert bool(result.causes) is stands


@pytest.mark.parametrize(
    ("where", "words"),
    [("no place", "beyond what the reference flights leave"), ("frequency", "as a vibration does"),
     ("everywhere", "everywhere"), ("height", "along the height")],
)  # fmt: skip
def test_what_is_clearer_is_said_with_where_it_lives(monkeypatch, where, words):
    """It had been "along the no place"."""
    named, found = shown_by("rotor_tilt", 1e-9, 5), SimpleNamespace(ties=[], stand_ins=[])
    settled = Settled([named], [], {("rotor_tilt", "changed"): Confirmation("", 1.0, 0.1, 5.0)}, {}, [])
    monkeypatch.setattr(verdict, "_power", lambda c, case: (np.eye(6)[c.axis], np.ones(6)))
    left = SimpleNamespace(
        entries=[{"channel": "Mz", "where": where, "since": "changed", "evidence": {"p": 1e-20}, "size": 1.0}]
    )
    ((_, confirmation),) = verdict._fainter_than_unknown(None, settled, found, left).dropped
    assert confirmation.why.startswith(f"Mz differs {words} in a way that no cause explains")


@pytest.mark.parametrize(("left", "gone"), [((1.2, 1.5), ["blade_flapping"]), ((0.7, 1.2), []), ((0.9, 0.9), [])])
def test_a_cause_that_leaves_its_axes_no_better_than_without_any_corrects_another(left, gone):
    """Wind turned a model's moments the wrong way; what blade flapping took off of that was named."""
    wind, other = shown_by("wind", 1e-30, 0), shown_by("blade_flapping", 1e-9, 3)
    for cause, wald, channels in ((wind, 1000.0, ("Fx", "Fy", "Mx", "My")), (other, 60.0, ("Mx", "My"))):
        cause.test.wald, cause.effect.channels = wald, channels
    both = np.array([0.1, 0.1, 1.0, *left, 1.0])
    errors = {(): np.ones(6), ("wind", "blade_flapping"): both, ("wind",): np.array([0.1, 0.1, 1.0, 1.3, 1.6, 1.0])}
    found = correcting_others([other, wind], lambda of: tuple(c.effect.id for c in of), lambda model: errors[model])
    assert [c.effect.id for c in found] == gone


def test_a_cause_that_held_out_flights_do_not_show_corrects_no_other():
    """Flights away from the floor: ground effect left its axes exactly as they were, and lost its name."""
    torque, ground = shown_by("torque_factor", 1e-30, 5), shown_by("ground_effect", 1e-9, 2)
    for cause, wald, channels in ((torque, 400.0, ("Mz",)), (ground, 90.0, ("Fz", "Mx", "My"))):
        cause.test.wald, cause.effect.channels = wald, channels

    def errors(of):
        return np.array([1.0] * 5 + [0.5 if "torque_factor" in of else 1.0])

    both = [torque, ground]
    assert correcting_others(both, lambda of: [c.effect.id for c in of], errors) == [ground]
    assert correcting_others(both, lambda of: [c.effect.id for c in of], errors, [ground]) == []


@pytest.mark.parametrize("gone", [[], ["flapping"], ["flapping", "wind"]])
def test_losses_are_those_of_the_causes_that_stand_in_the_end(monkeypatch, gone):
    """A cause that gave way to the unknown left its loss behind: "partly explained", by a loss that is not there."""
    causes, empty = [cause("wind"), cause("flapping")], Settled([], [], {}, {}, [])
    lost = {"flapping": Loss("rollouts", "rate y", 0.5, 1.0, 2.0, of_trim=True)}
    for step in ("_of_flights", "_borne_out", "_against_trim", "_of_use"):
        monkeypatch.setattr(verdict, step, lambda *given: next(g for g in given if isinstance(g, Settled)))
    for step in ("_drop_needless_ties", "_drop_ties_in_part"):
        monkeypatch.setattr(verdict, step, lambda *given: None)
    for step in ("_next_to_unknown", "_fainter_than_unknown"):
        monkeypatch.setattr(verdict, step, lambda case, settled, *given: settled)
    monkeypatch.setattr(verdict, "_significant_next_to_rotor", lambda case, found, causes: causes)
    monkeypatch.setattr(verdict, "_settled", lambda *given: empty._replace(causes=causes))
    monkeypatch.setattr(verdict, "Model", lambda document, where: document)
    monkeypatch.setattr(verdict, "losses", lambda base, model, *given, **asked: [lost[n] for n in model if n in lost])
    monkeypatch.setattr(verdict, "correcting_others", lambda *given: [])
    monkeypatch.setattr(verdict, "_outdone", lambda case, settled, found, left_by: (
        settled._replace(causes=[c for c in settled.causes if c.name not in gone]), "left"
    ))  # fmt: skip
    case = SimpleNamespace(
        compared=[True, False], held=["h"], model="base", tables={}, anew=lambda causes: False,
        settings={"horizons": [0.5], "material share": 0.05},
        extended=lambda causes, study, where, anew: [c.name for c in causes],
    )  # fmt: skip
    found = SimpleNamespace(causes=[], stand_ins=[], ties=[], unjudged=[], study=None, level={})
    settled, _ = verdict.judge_causes(case, found)
    assert list(settled.losses) == ([] if gone else [lost["flapping"]])


@pytest.mark.parametrize("excluded", [(), (3,)])
def test_the_axis_that_shows_a_cause_most_is_one_that_counts(flights, excluded):
    """Roll of which the model explains nothing showed the rotor most, and kept all that is unknown elsewhere away."""
    model, evidence = flights
    noise = np.random.default_rng(0).standard_normal((len(evidence[0]), 6)) * [0.0, 0.0, 0.05, 1e-4, 1e-3, 0.0]
    flight = replace(evidence[0], measured=evidence[0].predicted + noise, excluded=excluded)
    rotor = SimpleNamespace(effect=catalogue()["rotor_effectiveness"], value={"rotor1": -0.1})
    case = SimpleNamespace(learning=[flight], compared=[True], vehicle=vehicle_of(model))
    own, usual = verdict._power(rotor, case)
    assert AXES[int(np.argmax(own / np.maximum(usual, 1e-300)))] == ("My" if excluded else "Mx")
    assert drowned(own, usual, np.array([0.0, 0.0, 4.0, 0.0, 0.1, 0.0])) is bool(excluded)
