"""What changed since the reference flights is none of theirs: a whole diagnosis, of references that sink fast."""

from dataclasses import replace

import pytest
from plain_plant import made_model, with_simple_model
from test_gap_halves import flown

from quasi.gap import diagnosis
from quasi.gap.catalogue import catalogue
from quasi.gap.effect import vehicle_of
from quasi.gap.extension import extend
from quasi.model.model import Model

CAUSES = {n: catalogue()[n] for n in ("body_drag", "wind", "tether", "mass")}
ROLES = {"f0": "reference", "f1": "reference", "f2": "compared", "f3": "compared", "f4": "held out"}
SETTINGS = {"room": None, "material share": 0.05, "false alarm rate": 0.01, "horizons": [0.5], "model": "made",
            "extended model ID": "x", "effects": "all"}  # fmt: skip
TRIM = 0.08  # N, 2 % of the weight


@pytest.fixture(scope="module")
def said():
    """The diagnosis of flights of which all but the references drag."""
    base = with_simple_model(made_model(reaction=0.0), 0.012)
    drags = Model(extend(base, [(CAUSES["body_drag"], {"c": 0.05})], vehicle_of(base), "t", "t"), "t")
    # the held-out flight has a trim of its own
    made = {k: flown(base if role == "reference" else drags, base, seed=n) for n, (k, role) in enumerate(ROLES.items())}
    evidence, tables = {k: replace(e, key=k) for k, (_, e) in made.items()}, {k: t for k, (t, _) in made.items()}
    held = evidence["f4"]
    evidence["f4"] = replace(held, measured=held.measured + held.only("Fz", TRIM))
    lists = ("effects", "ties", "findings", "candidates", "cannot_be_asked", "notes")
    level = {n: [] for n in lists} | {"found on": {"channels": list("pqr"), "healthy": {}, "worth": {}}}
    found = diagnosis.diagnose(
        base, {"levels": {"sensors": level, "drive": level}}, evidence, tables, ROLES, CAUSES, SETTINGS, ([], []), "g"
    )
    return found.document


def test_references_feel_no_constant_force_of_a_cause_that_they_have_not(said):
    """The drag that they lack had been a force of 1.6 times the weight, and a tie of the mass."""
    assert [e["id"] for e in said["effects"]] == ["body_drag"]
    assert said["ties"] == [] and said["verdict"] == "explained"


def test_a_flights_own_trim_is_held_against_flights_that_have_what_changed(said):
    """With the references' error by the drag as noise, it had been 0 +- 1 % of the weight."""
    trim = said["halves"]["flights"]["f4"]["trim"]["Fz"]
    assert trim["after"] == pytest.approx(TRIM, rel=0.02)


def test_a_constant_error_that_held_out_flights_do_not_show_makes_no_small_force_material():
    """A change that the trim refuses is unjudged, and had let a force far below the material share be a tie."""
    entries = [("Fx", "everywhere", True), ("Fy", "heading", True), ("Fz", "everywhere", False), ("Mx", "speed", True)]
    said = [{"channel": c, "where": where, "judged": judged} for c, where, judged in entries]
    assert diagnosis._constants(said) == ["Fx", "Fy"]
