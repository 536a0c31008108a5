"""A rotor that is elsewhere, or turns the other way, than configured shows in what its speed does to the moments."""

import dataclasses

import numpy as np
import pytest
from flights import AIRFRAME, flight

from quasi.identification.geometry import contradicting_places
from quasi.identification.partition import partition
from quasi.identification.shared import shared

FLIGHTS = {key: flight(seed, rows=6000) for seed, key in enumerate("ab")}
# where the made flights' moments put the rotors, and how they turn: drag against the sense
TRUE = dataclasses.replace(
    AIRFRAME, hubs=AIRFRAME.hubs * np.array([1.0, 1.0, 0.0]), spin=np.array([-1.0, 1.0, 1.0, -1.0])
)


def told(airframe):
    notes = shared(FLIGHTS, partition(FLIGHTS), airframe)["notes"]
    return [n for n in notes if "rotor" in n and "configuration" in n]


def test_rotors_that_are_where_they_are_said_to_be_are_not_remarked():
    assert told(TRUE) == []


def test_moments_that_do_not_hold_the_answer_to_the_rotors_contradict_no_place():
    """Rates made of slow attitudes leave next to no slope; that is no sign of rotors at the centre."""
    turns = -1e-3 * TRUE.spin, np.full(4, 1e-4)

    def seen(share, std):
        x, y = share * TRUE.hubs[:, 0], share * TRUE.hubs[:, 1]
        errors = np.full(4, std * TRUE.arm)
        return contradicting_places({"Mx": (-y, errors), "My": (x, errors), "Mz": turns}, TRUE, 1.0)

    assert seen(1.0, 0.01) == []
    assert seen(0.0, 0.01) == []
    [note] = seen(-1.0, 0.01)
    assert "numbers or places" in note
    [note] = seen(0.1, 0.01)  # in the right directions: a unit or an inertia
    assert "10 times shorter" in note


@pytest.mark.parametrize("pair", [(0, 3), (0, 1), (2, 3)])
def test_exchanged_rotors_are_told_with_both_places(pair):
    order = list(range(4))
    order[pair[0]], order[pair[1]] = pair[1], pair[0]
    [note] = told(dataclasses.replace(TRUE, hubs=TRUE.hubs[order]))
    assert all(f"rotor {k + 1} pushes as if it were" in note for k in pair)
    assert all(f"rotor {k + 1} " not in note for k in range(4) if k not in pair)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"Fz": 10.0}, "6.8 times shorter than configured: check the mass"),
        ({"Mx": 57.3, "My": 57.3, "Mz": 57.3}, "85 times longer than configured: check"),
        ({"Mx": 1.2, "My": 20.0}, "times longer than configured in pitch: check the mass"),
    ],
)
def test_arms_off_by_one_factor_are_a_matter_of_mass_inertia_or_units(change, said):
    # the made flights' torques are those of arms 1.5 times as long
    flights = {key: f.assign(**{name: by * f[name] for name, by in change.items()}) for key, f in FLIGHTS.items()}
    [note] = [n for n in shared(flights, partition(flights), TRUE)["notes"] if "configur" in n and "rotor" in n]
    assert note.startswith("all rotors push from the directions in which the configuration has them")
    assert said in note and "numbers or places" not in note


def test_the_wrong_sense_of_one_rotor_or_of_all_is_told():
    [note] = told(dataclasses.replace(TRUE, spin=-TRUE.spin))
    assert note.startswith("the faster rotors 1, 2, 3, 4, the more the body turns")
    [note] = told(dataclasses.replace(TRUE, spin=TRUE.spin * np.array([1.0, -1.0, 1.0, 1.0])))
    assert note.startswith("the faster rotor 2, the more")


def test_an_impossible_inertia_and_a_thrust_that_falls_with_speed_contradict_the_configuration():
    found = shared(FLIGHTS, partition(FLIGHTS), dataclasses.replace(TRUE, inertia=np.diag([1e-3, 1e-3, 3e-3])))
    assert any("'moment of inertia'" in c for c in found["contradictions"])
    upside = {key: f.assign(Fz=-f["Fz"]) for key, f in FLIGHTS.items()}
    [sentence] = shared(upside, partition(upside), TRUE)["contradictions"]
    assert "thrust factor -" in sentence
