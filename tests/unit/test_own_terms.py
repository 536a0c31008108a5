"""Whether a model's own terms are fitted anew to corrected flights is decided first: its worth follows from it."""

from dataclasses import replace

import pytest
from plain_plant import made_model, with_simple_model
from test_constant_loads import worthy_flights
from test_gap_halves import flown, stronger
from test_gap_of_references import SETTINGS

from quasi.gap import base_model, diagnosis, preparation
from quasi.gap.base_model import faked_axes, refit_loses
from quasi.gap.catalogue import catalogue
from quasi.gap.effect import vehicle_of
from quasi.gap.losses import Loss
from quasi.model.model import AXES


def refitted(true):
    """Whether terms fitted to thrust of 4 % more do worse where it is `true` more."""
    base = with_simple_model(made_model(reaction=0.0), 0.012)
    made = {k: flown(stronger(base, share), base, seed=n) for n, (k, share) in
            enumerate({"f0": 0.04, "f1": 0.04, "f2": true}.items())}  # fmt: skip
    evidence = {k: replace(e, key=k) for k, (_, e) in made.items()}
    groups = {"reference": [evidence["f0"]], "compared": [evidence["f1"]], "held out": [evidence["f2"]]}
    tables = {k: table for k, (table, _) in made.items()}
    return refit_loses(base, groups, tables, vehicle_of(base), SETTINGS, AXES)


@pytest.mark.parametrize(("true", "loses"), [(0.04, False), (0.0, True)])
def test_terms_fitted_anew_lose_where_held_out_flights_do_not_have_what_they_took_up(true, loses):
    assert refitted(true) is loses


@pytest.mark.parametrize(("grows", "of_trim", "loses"), [(1.05, False, False), (1e3, False, True), (1e3, True, False)])
def test_a_loss_counts_where_no_axis_gains_more(grows, of_trim, loses, monkeypatch):
    """4 % of the pitch rate had kept terms that left twenty times the error of forces."""
    monkeypatch.setattr(base_model, "losses", lambda *_, **__: [Loss("rollouts", "rate y", 0.5, 1.0, grows, of_trim)])
    assert refitted(0.04) is loses


@pytest.mark.parametrize(("loses", "excluded"), [(False, []), (True, ["Fy"])])
def test_a_model_that_keeps_its_terms_is_judged_by_them(loses, excluded, monkeypatch):
    """Terms that doubled the sideward force had counted as fitted anew, and what they left of it as unexplained."""
    model, flights = worthy_flights()
    evidence = {
        key: replace(e, key=key, measured=e.predicted, predicted=e.predicted + 2.0 * e.only("Fy", e.predicted[:, 1]))
        for key, e in zip(("f0", "f1"), flights)
    }
    monkeypatch.setattr(preparation, "made_of", lambda *_: True)
    monkeypatch.setattr(preparation, "refit_loses", lambda *_: loses)
    level = {n: [] for n in ("effects", "ties", "findings", "candidates", "cannot_be_asked", "notes")}
    level |= {"found on": {"channels": list("pqr"), "healthy": {}, "worth": {}}}
    calibration = {"levels": {"sensors": level, "drive": level}, "causes": [{"id": "imu_lever_arm", "since": "always"}]}
    roles = {"f0": "reference", "f1": "compared"}
    made = diagnosis.diagnose(model, calibration, evidence, {}, roles, {}, SETTINGS, ([], []), "g").document
    assert made["base model"]["excluded"] == excluded
    assert any("keeps its terms" in note for note in made["notes"]) is loses


@pytest.mark.parametrize(
    ("causes", "axes"),
    [
        ([("imu_lever_arm", "always")], AXES[:3]),
        ([("imu_lever_arm", "always"), ("gyro_scale", "changed")], AXES[:3]),
        ([("imu_lever_arm", "always"), ("gyro_scale", "always")], AXES),
        ([("telemetry_delay", "always")], AXES),
        ([("imu_lever_arm", "changed")], ()),
    ],
)
def test_what_the_accelerometer_shows_alone_leaves_the_moments_terms(causes, axes):
    """A pitch moment fitted anew to flights that had changed made held-out ones worse, and all terms were kept."""
    assert faked_axes([{"id": i, "since": since} for i, since in causes], catalogue()) == axes
