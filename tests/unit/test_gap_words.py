"""What a diagnosis says in sentences: verdict, summary, what to do next."""

import html
import re
from types import SimpleNamespace

import numpy as np
import pytest
from gap_documents import (
    EFFECT,
    GAIN,
    KNOWN,
    LAG,
    LEAN,
    LEFT,
    TIE,
    TOO_FEW,
    TURN,
    document,
    not_judged,
)

from quasi.gap.effect import Vehicle, as_flown
from quasi.gap.entries import truth
from quasi.gap.report.names import alternatives, value_of
from quasi.gap.report.next_steps import steps
from quasi.gap.report.page import page
from quasi.gap.report.wording import left_sentence, summary, words_of


@pytest.mark.parametrize(
    "parts, verdict",
    [
        ({}, "agrees"),
        ({"effects": [EFFECT]}, "explained"),
        ({"effects": [EFFECT], "ties": [TIE]}, "partly explained"),
        ({"effects": [EFFECT], "left": [LEFT]}, "partly explained"),
        ({"ties": [TIE]}, "partly explained"),
        ({"left": [LEFT]}, "unexplained"),
    ],
)
def test_the_verdict_says_what_there_is(parts, verdict):
    assert document(**parts)["verdict"] == verdict


def test_a_cause_that_held_out_flights_do_not_show_is_told_as_not_judged():
    said = document([{**EFFECT, "judged": False}])
    assert "it is hardly shown by the held-out flight and so not judged there" in said["summary"]
    assert "explains" not in said["summary"]
    assert "not judged: held-out flights hardly show it" in page(said, KNOWN, None, {})


def test_an_unexplained_residual_is_told_with_its_size_and_where_it_lives():
    left = {"channel": "Fz", "judged": True, "share": 0.5, "size": 0.123, "unit": "N", "since": "changed"}
    refused = {"looks like": "mass", "why not": "the trim shows none"}
    stated = left_sentence({**left, "where": "everywhere", "judged": False, "share": None, "evidence": refused})
    assert "It looks like mass, which is refused: the trim shows none. No cause explains this." in stated
    assert "held-out" not in stated
    at = left_sentence({**left, "where": "heading", "mostly": [[0.7, 1.05], [2.0, 2.1]]})
    assert "is off by 0.12 N rms in the compared flights along the heading, mostly at 40 to 60 and 114.6 to 120.3" in at
    assert "deg, with 50 % of its removable error on the held-out flights. No cause explains this." in at
    place = left_sentence({**left, "where": "room place", "mostly": [[1.2, -0.8]]})
    assert "along the room place, mostly near x = 1.2 m, y = -0.8 m" in place
    assert "rms in time, at 0.38 to 0.42 Hz" in left_sentence({**left, "where": "frequency", "mostly": [[0.38, 0.42]]})
    whole = left_sentence({**left, "where": "time", "mostly": [[0.0, 20.0]], "share": None})
    assert whole.endswith("along the time, mostly at 0 to 20 s, on the held-out flights too. No cause explains this.")
    nowhere = left_sentence({**left, "where": "everywhere", "mostly": [], "judged": False, "share": None})
    assert "rms in the compared flights everywhere; the held-out flights do not go there" in nowhere


def test_the_summary_names_cause_size_share_rivals_ties_and_what_is_left():
    text = document([EFFECT], [TIE], [LEFT])["summary"]
    for words in (
        "Ground effect: this is new since the reference flights. It explains 30 % of the removable error of the "
        "simulated velocity. Named again in 98 % of resamples; the probability that it is there is 0.97.",
        "the velocity error goes from 0.5 to 0.4 m/s. Removable error of forces, moments and motion is what lies "
        "(squared) above the best fit of the model's terms and all causes together",
        "Mass or thrust factor: this data cannot decide which (separability 1.3 standard errors); to settle it: weigh",
        "The yaw moment (Mz) is off along the heading, with 40 % of its removable error on the held-out flights. No "
        "cause explains this.",
    ):
        assert words in text
    assert "sensors and rotor speeds" not in text
    assert "agree" in document()["summary"] and "5 %" in document()["summary"]


def test_the_box_begins_with_one_sentence_that_says_it_all():
    """What happens and how much, what of the error it explains, what lost, what is open; the details are a list."""
    made = document([EFFECT], [TIE], [LEFT])
    text = page(made, KNOWN, None, {})
    first = re.search(r'class="verdict.*?<strong>(.*?)</strong></p>', text)[1]
    assert first == (
        "The rotors make more thrust near the floor (ground effect: c = 5.64 ± 0.48); it explains 86 % (95 %: 70 to "
        "95) of the removable vertical force error (Fz) on the held-out flight; tether was tested in place of ground "
        "effect and lost (tether: p = 0.69); the data cannot decide whether mass or thrust factor is there; something "
        "in yaw moment stays unexplained."
    )
    rest = [html.unescape(item) for item in re.search(r"<ul.*?>(.*?)</ul>", text, re.S)[1].split("<li>")[1:]]
    rest = [re.sub(r"</li>\s*", "", item) for item in rest]
    assert " ".join([html.unescape(first), *rest]) == made["summary"]
    assert len(rest) > 3 and rest[0].startswith("Ground effect: this is new")
    alone = re.search(
        r'class="verdict.*?<span class="more">(.*?)</span></p>', page(document([EFFECT]), KNOWN, None, {})
    )
    assert alone[1].startswith("This is new")
    none = re.search(r'class="verdict.*?<strong>(.*?)</strong></p>', page(document(), KNOWN, None, {}))[1]
    assert none == html.escape(document()["summary"])


def test_the_summary_adds_which_rotor_follows_later_where_a_lag_is_named():
    odd = {"id": "motor_lag", "text": "rotor 2 follows its commands with 1.95 times the time constant of the others"}
    named = summary(document([LAG]) | {"findings": [odd]}, KNOWN)
    assert f" R{odd['text'][1:]}." in named
    assert odd["text"][1:] not in summary(document([EFFECT]) | {"findings": [odd]}, KNOWN)


def test_the_summary_says_how_sure_a_cause_is_and_what_stays_as_it_is():
    sure = {
        **EFFECT, "gains": {"Fz": {"value": 1.0, "low": -1.233, "high": 1.0}}, "gain": {"wrench": 1.0, "rollout": None},
        "confirmation": {"outcome": "confirmed", "amplitude": {"value": 1.046, "std": 0.238}, "why": ""},
    }  # fmt: skip
    made = document([sure])
    made["rollouts"]["rollouts"] = [
        {"horizon": 1.0, "quantity": q, "before": before, "after": 1.01 * before}
        for q, before in (("velocity", 1.515), ("rate", 0.683))
    ]
    text = summary(made, KNOWN)
    for words in (
        "vertical force error (Fz) down to the noise floor (95 %: below -100 to 100)",
        "Confirmed in simulation: 1.05 ± 0.24 of the motion it should make is there; named again in 98 % of resamples; "
        "the probability that it is there is 0.97.",
        "Simulated for 1 s, velocity (1.51 m/s) and body rate (0.683 rad/s) errors stay as they are. Removable error",
    ):
        assert words in text
    assert "goes from" not in text and text.count("Removable error") == 1


@pytest.mark.parametrize("floor, told", [(0.99, True), (0.9, False), (None, False)])
def test_an_error_that_stays_is_told_beside_the_best_fit_of_all(floor, told):
    """No cause is said to be missing: where the floor is as high, nothing that could be fitted takes it away."""
    made = document([EFFECT])
    made["rollouts"]["rollouts"] = [{"horizon": 1.0, "quantity": "rate", "before": 0.5, "after": 0.5}]
    made["rollouts"]["rollouts"][0] |= {"noise_floor": 0.5 * floor} if floor else {}
    stays = "the error of body rate (0.5 rad/s) stays as it is"
    assert f"{stays}{', even with the best fit of all causes' * told}." in summary(made, KNOWN)


def test_what_was_corrected_at_import_is_not_told_as_a_gain_of_the_simulation():
    text = document([TURN])["summary"]
    assert "it takes 80 % of the removable error away on the held-out flight, corrected at import" in text
    assert "Simulated" not in text and "  " not in text
    assert "Removable error of sensors and rotor speeds" in text and "forces, moments" not in text


def test_a_leaning_attitude_is_told_as_not_corrected_and_what_to_do():
    made = document([LEAN])
    text = page(made, KNOWN, None, {})
    for words in ("is not corrected: the flights hold it", "Nothing corrects it in these flights", "and fly again"):
        assert words in text
    for words in ("Corrected at import", "corrected already", "Make the extended model", "processed anew"):
        assert words not in text
    assert "Nothing was added: X-low is X." in text and "is not corrected" in made["summary"]


@pytest.mark.parametrize("why", [TOO_FEW, "no held-out flight could be used, as the notes say; hold out another one"])
def test_a_diagnosis_without_judged_forces_says_why_and_is_never_green(why):
    made = not_judged(why)
    assert made["summary"] == (
        "Nothing is wrong with sensors, clocks and the rotor drive as far as this data shows; forces and moments could "
        f"not be asked: {why}."
    )
    text = page(made, KNOWN, None, {})
    assert '<p class="verdict care"><b>not judged:' in text and "Forces and moments are not judged yet" in text
    assert "Nothing has to be done" not in text
    assert not_judged(why, unable="all flights are torn")["summary"].endswith("asked: all flights are torn.")


def test_causes_that_the_gap_names_and_that_could_not_be_asked_are_told():
    made = document() | {"effects asked": ["battery_sag", "wind"]}
    assert summary(made, KNOWN) == (
        "Battery sag could not be asked: no voltage & no commands. Nothing else that was asked, and nothing outside "
        "it, is both significant and at least 5 % of the error that could be removed."
    )
    assert "could not" not in summary(document() | {"effects asked": "all"}, KNOWN)


def test_mass_and_inertia_grown_alike_are_one_answer_of_a_tie():
    """Weaker rotors look like both in proportion; each alone is not an answer that the data allows."""
    assert alternatives(["thrust_factor", "inertia", "mass"]) == "thrust factor or both mass and inertia"
    assert alternatives(["mass", "inertia"]) == "mass or inertia"
    assert alternatives(["mass", "thrust_factor", "wind"]) == "mass, thrust factor or wind"


@pytest.mark.parametrize(
    "parts, words",
    [
        ({"effects": [EFFECT]}, ["snakemake models/X-low/standalone", "X with ground effect"]),
        ({"effects": [LAG]}, ["X with motor lag: snakemake models/X-low/standalone"]),
        ({"effects": [TURN]}, ["(x = 0.0120 ± 0.0010 m): add it to 'optitrack marker cg offset'", "corrected already"]),
        ({"ties": [TIE]}, ["To find out whether it is mass or thrust factor: weigh it"]),
        ({"left": [{**LEFT, "mostly": [[0.7, 1.05]]}]}, ["along the heading, mostly at 40 to 60 deg", "gaps.md"]),
        ({"left": [{**LEFT, "where": "frequency", "mostly": [[1.2, 1.4]]}]}, ["swings at 1.20 to 1.40 Hz"]),
        ({"left": [{**LEFT, "where": "everywhere"}]}, ["off everywhere"]),
        ({"left": [{**LEFT, "where": "time", "mostly": [[3.0, 9.0]]}]}, ["changes in time, mostly at 3 to 9 s"]),
        ({}, ["Nothing has to be done", "quasi plan X FLIGHT --gap low"]),
    ],
)
def test_the_page_says_what_to_do_next(parts, words):
    made = document(**parts)
    said = " ".join(steps(made, KNOWN))
    for word in [*words, "Not asked: battery sag. No voltage & no commands."]:
        assert word in said
    assert ("Nothing has to be done" in said) == (not parts)
    assert ("standalone" in said) == any(e["level"] != "sensors" for e in parts.get("effects", ()))
    text = page(made, KNOWN, None, {})
    assert text.index('class="verdict') < text.index("What to do next") < text.index("What is wrong")


def test_every_cause_of_sensors_has_its_remedy():
    made = document()
    for ident, effect in KNOWN.items():
        if effect.level == "sensors" and effect.parameters:
            made["effects"] = [{**TURN, "id": ident}]
            assert "set it right where it arises" not in " ".join(steps(made, KNOWN)), ident


def test_ids_are_words_but_not_within_longer_names():
    assert words_of("beside ground_effect, not in X-ground_effect or my/ground_effect", KNOWN) == (
        "beside ground effect, not in X-ground_effect or my/ground_effect"
    )


@pytest.mark.parametrize("left, named, told", [(10.8, [], True), (7.0, [], False), (10.8, [LAG], False)])
def test_drive_errors_far_above_their_floor_are_told_where_nothing_is_named(left, named, told):
    made = document(named)
    for key, value in (("before", 10.8), ("after", left), ("noise_floor", 2.48)):
        made["gap"][key] = {**made["gap"][key], "drive": {"w1": {"0": value}}}
    text = page(made, KNOWN, None, {})
    assert "speed of rotor 1 (w1), rad/s" in text and "roll rate (p), rad/s" in text
    assert ("w1 4.4 times (10.8 against 2.48 rad/s)" in text) == told


def test_the_page_shows_two_lengths_of_the_simulation_and_folds_the_others():
    made = document([EFFECT])
    row = {"quantity": "velocity", "before": 0.5, "after": 0.4, **GAIN}
    made["rollouts"]["rollouts"] = [{**row, "horizon": h} for h in (0.1, 0.25, 0.5, 1.0)]
    text = page(made, KNOWN, None, {"overlays": b"PNG"})
    seen, folded = text.split("<details>")
    assert "after 0.5 s" in seen and "after 1 s" in seen and "after 0.25 s" not in seen
    assert "after 0.1 s" in folded and "after 0.25 s" in folded
    assert text.index("data:image") < text.index("velocity, m/s, after 0.5 s")


@pytest.mark.parametrize(
    "parameter, words",
    [
        ({"value": 5.644, "std": 0.48, "unit": "1"}, "5.64 ± 0.48"),
        ({"value": 1.56e-05, "std": 9e-07, "unit": "N m"}, "(1.560 ± 0.090)e-5 N m"),
        ({"value": -0.4503, "std": 0.012, "unit": "kg"}, "-0.450 ± 0.012 kg"),
        ({"value": 25.0, "std": 0.0, "unit": "s"}, "25 s"),
    ],
)
def test_a_value_goes_as_far_as_its_standard_error(parameter, words):
    assert value_of(parameter) == words


def test_parameters_are_stated_as_they_are_not_as_deviations():
    vehicle = Vehicle(np.zeros((4, 3)), np.ones(4), 0.04, 1e-7, 1e-9, 0.43, np.diag([1e-3, 2e-3, 3e-3]), 9.7, 0.0, 0.0)
    assert truth(KNOWN["mass"], "mass", 0.02, vehicle) == pytest.approx(0.45)
    model = SimpleNamespace(airframe=SimpleNamespace(mass=0.43, inertia=vehicle.inertia), document={})
    heavier = as_flown(
        vehicle, [SimpleNamespace(mass=m, inertia=vehicle.inertia, model=model) for m in (0.44, 0.46)]
    )  # as the logbook says
    assert truth(KNOWN["mass"], "mass", 0.02, heavier) == pytest.approx(0.47)
    assert as_flown(vehicle, []) is vehicle
    assert truth(KNOWN["inertia"], "Iyy", 1e-4, vehicle) == pytest.approx(2.1e-3)
    tensor = np.array([[1e-3, -1e-5, 0.0], [-1e-5, 2e-3, 0.0], [0.0, 0.0, 3e-3]])  # a product Ixy of +1e-5
    assert truth(KNOWN["inertia"], "Ixy", 2e-6, vehicle._replace(inertia=tensor)) == pytest.approx(1.2e-5)
    assert truth(KNOWN["thrust_factor"], "factor", -0.03, vehicle) == pytest.approx(0.97)
    assert truth(KNOWN["wind"], "north", 1.5, vehicle) == 1.5


def test_a_sensor_finding_that_changes_nothing_explains_nothing_and_says_so():
    idle = {**TURN, "explains": False}
    found = document([idle])
    assert found["verdict"] == "agrees"
    assert "changes neither forces nor simulations" in found["summary"]
    assert "changes neither forces nor simulations" not in document([TURN])["summary"]


def test_a_tie_of_sensors_that_changes_nothing_follows_the_agreement():
    tie = {
        "ids": ["mocap_misalignment", "imu_misalignment"], "since": "always", "separability": 0.1, "tie_breaker": "",
        "parameters": {"mocap_misalignment": {}, "imu_misalignment": {}},
    }  # fmt: skip
    assert document(ties=[tie])["verdict"] == "partly explained"
    found = document(ties=[{**tie, "explains": False}])
    assert found["verdict"] == "agrees" and document(ties=[tie])["summary"].startswith("Mocap misalignment or")
    first, second = "Simulation and flights agree", "Mocap misalignment or imu misalignment: this data cannot decide"
    assert found["summary"].startswith(first) and second in found["summary"]
    assert "Correcting it changes neither forces nor simulations" in found["summary"]
    named = document([TURN], ties=[{**tie, "explains": False}])
    assert named["verdict"] == "explained"
    assert "correcting mocap misalignment or imu misalignment changes neither" in named["summary"]


def test_the_lag_of_one_rotor_is_said_of_that_rotor():
    lag = KNOWN["motor_lag"]
    one, two = (lag.happens(dict.fromkeys(names, 1.4)) for names in (["rotor2"], ["rotor2", "rotor4"]))
    assert one.replace("rotor 2", "rotor 2 and rotor 4") == two  # a sentence for one and for several
    assert " its " not in two
    assert lag.happens({"time_constant": 0.04, "rotor2": 1.4}).startswith("the rotors follow their commands")
