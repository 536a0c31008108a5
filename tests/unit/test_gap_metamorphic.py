"""Metamorphic relations: flights that are written down differently name the same causes."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from made_model import simple_model
from test_unexplained import flight, ground  # noqa: F401

from quasi.airframe import read_airframe
from quasi.gap.catalogue import catalogue, whole_of
from quasi.gap.effect import vehicle_of
from quasi.gap.levels.forces.design import gather_design
from quasi.gap.levels.forces.identify import examine
from quasi.gap.statistics.candidates import Candidate
from quasi.model.model import AXES, Model
from quasi_synthesis.campaign import quadrotor_configuration, read_campaign

NAMES = ("wind", "rotor_effectiveness", "cg_offset", "mass")
EFFECTS = {n: catalogue()[n] for n in NAMES}
PLANTED = {"wind": {"north": 0.8, "east": -0.5, "down": 0.0}, "rotor_effectiveness": {"rotor2": -0.06}}
WIND, ROTOR = Candidate("wind", "changed", (0, 1, 2)), Candidate("rotor_effectiveness", "changed", (1,))
HEADING = 1.1  # rad
LENGTH = 2400  # rows
ROTORS = ("w1", "w2", "w3", "w4")


def faulty(ground, seed):  # noqa: F811
    plain = flight(ground, seed, rows=LENGTH)
    added = sum(whole_of(EFFECTS[n], plain, vehicle_of(ground[1]), values) for n, values in PLANTED.items())
    return dataclasses.replace(plain, measured=plain.measured + added)


@pytest.fixture(scope="module")
def made(ground):  # noqa: F811
    """Reference flights, compared flights, held-out flights with and without the causes."""
    some = [faulty(ground, k) for k in range(3, 6)]
    healthy = [flight(ground, k, rows=LENGTH) for k in (0, 1, 2, 91)]
    return healthy[:3], some, faulty(ground, 90), healthy[3]


def diagnosed(model, reference, compared, held):
    """{cause: {parameter: (deviation, standard error)}} that are named."""
    flags = [False] * len(reference) + [True] * len(compared)
    vehicle = vehicle_of(model)
    found = examine([*reference, *compared], flags, [held], model, EFFECTS, vehicle, 0.01, 0.05, "more", "test")
    assert not found.ties
    return {c.effect.id: {n: (v, c.std[n]) for n, v in c.value.items()} for c in found.causes}


@pytest.fixture(scope="module")
def plain(ground, made):  # noqa: F811
    found = diagnosed(Model(ground[1].document, "test"), *made[:3])
    assert set(found) == set(PLANTED)
    return found


def rewritten(evidence, columns, measured, airframe=None, model=None):
    """A flight with other columns; the model predicts anew."""
    model = model or evidence.model
    predicted = model.predict_columns(pd.DataFrame(columns))[list(AXES)].to_numpy()
    new = dataclasses.replace(
        evidence, columns=columns, measured=measured, predicted=predicted, model=model,
        airframe=airframe or evidence.airframe,
    )  # fmt: skip
    new.__dict__.pop("_slopes", None)
    return new


def matched(found, expected, errors):
    """Names are equal, and parameters within some standard errors."""
    assert set(found) == set(expected)
    for cause, values in expected.items():
        assert set(found[cause]) == set(values)
        for name, (value, std) in values.items():
            assert found[cause][name][0] == pytest.approx(value, abs=errors * std), (cause, name)


def renumbered(columns, order):
    """Columns in which rotor k is what rotor order[k] was."""
    moved = {f"{w}{end}": columns[f"{ROTORS[k]}{end}"] for w, k in zip(ROTORS, order) for end in ("", "_dot")}
    return {**columns, **moved}


def mirror_order(airframe):
    mirrored = airframe.hubs * [1.0, -1.0, 1.0]
    return [int(np.argmin(np.linalg.norm(airframe.hubs - hub, axis=1))) for hub in mirrored]


def mirrored(evidence):
    """Left becomes right: east, y, roll and yaw change their signs; the airframe is its own mirror image."""
    columns = renumbered(evidence.columns, mirror_order(evidence.airframe))
    columns |= {name: -columns[name] for name in ("v", "p", "r", "roll", "yaw", "y")}
    return rewritten(evidence, columns, evidence.measured * [1, -1, 1, -1, 1, -1])


def turned(evidence):
    """The room turned by HEADING."""
    columns, (c, s) = dict(evidence.columns), (np.cos(HEADING), np.sin(HEADING))
    columns["yaw"] = columns["yaw"] + HEADING
    columns |= {"x": c * columns["x"] - s * columns["y"], "y": s * columns["x"] + c * columns["y"]}
    return rewritten(evidence, columns, evidence.measured)


def with_values(plain, **changes):
    """{cause: {parameter: (value, error)}} with some values changed and the standard errors as they were."""
    wind, rotor = dict(plain["wind"]), plain["rotor_effectiveness"]
    for name, value in changes.get("wind", {}).items():
        wind[name] = value, max(std for _, std in plain["wind"].values())
    return {"wind": wind, "rotor_effectiveness": changes.get("rotor", rotor)}


def test_the_planted_causes_are_estimated_right(plain):
    for cause, values in PLANTED.items():
        for name, value in values.items():
            if value:
                found, std = plain[cause][name]
                assert abs(found - value) < 3.0 * std and found == pytest.approx(value, rel=0.2)


def test_mirrored_left_right(ground, made, plain):  # noqa: F811
    model = Model(ground[1].document, "test")
    sides = [[mirrored(e) for e in group] for group in made[:2]]
    found = diagnosed(model, *sides, mirrored(made[2]))
    [(name, size)] = plain["rotor_effectiveness"].items()
    other = f"rotor{mirror_order(ground[0]).index(int(name[-1]) - 1) + 1}"
    east = -plain["wind"]["east"][0]
    matched(found, with_values(plain, wind={"east": east}, rotor={other: size}), 0.1)


def test_room_turned_by_a_heading(ground, made, plain):  # noqa: F811
    model = Model(ground[1].document, "test")
    found = diagnosed(model, *[[turned(e) for e in group] for group in made[:2]], turned(made[2]))
    (north, _), (east, _) = plain["wind"]["north"], plain["wind"]["east"]
    c, s = np.cos(HEADING), np.sin(HEADING)
    matched(found, with_values(plain, wind={"north": c * north - s * east, "east": s * north + c * east}), 0.1)


def test_rotors_renumbered(ground, made, plain):  # noqa: F811
    campaign = read_campaign({"flights": [{"key": "a"}]}, "t")
    config = quadrotor_configuration(campaign)
    order = [2, 0, 3, 1]  # new rotor k is the old rotor order[k]
    config["rotor config"] = {place: order.index(old - 1) + 1 for place, old in config["rotor config"].items()}
    first = "CW" if ground[0].spin[order[0]] > 0 else "CCW"
    airframe = read_airframe({**config, "rotor1 rotation direction": first}, "made", 0.433)
    np.testing.assert_allclose(airframe.hubs, ground[0].hubs[order])
    np.testing.assert_allclose(airframe.spin, ground[0].spin[order])
    simple = ground[1].document["simple model"]
    model = simple_model(airframe, simple["kappaFz"]["value"], -simple["kappaMz"]["value"])

    def moved(e):
        return rewritten(e, renumbered(e.columns, order), e.measured, airframe, model)

    found = diagnosed(model, *[[moved(e) for e in group] for group in made[:2]], moved(made[2]))
    [(name, size)] = plain["rotor_effectiveness"].items()
    matched(found, with_values(plain, rotor={f"rotor{order.index(int(name[-1]) - 1) + 1}": size}), 0.1)


def test_flights_in_another_order(ground, made, plain):  # noqa: F811
    found = diagnosed(Model(ground[1].document, "test"), made[0][::-1], made[1][::-1], made[2])
    matched(found, plain, 0.1)


def test_one_flight_cut_in_two(ground, made, plain):  # noqa: F811
    def part(e, rows, end):
        columns = {n: c[rows] for n, c in e.columns.items()}
        return dataclasses.replace(rewritten(e, columns, e.measured[rows]), key=e.key + end)

    half = len(made[1][0]) // 2
    cut = [part(made[1][0], slice(half), "a"), part(made[1][0], slice(half, None), "b")]
    found = diagnosed(Model(ground[1].document, "test"), made[0], [*cut, *made[1][1:]], made[2])
    matched(found, plain, 1.0)


def test_reference_and_compared_swapped(ground, made):  # noqa: F811
    """The estimates change their signs; a name also needs a model of the flights that are the reference then."""
    flights, flags = [*made[0], *made[1]], np.repeat([False, True], [len(made[0]), len(made[1])])
    study = gather_design(flights, EFFECTS, vehicle_of(ground[1]))
    for offer, other in ((WIND, ROTOR), (ROTOR, WIND)):
        sides = [study.witnessed(range(len(flights)), f) for f in (flags, ~flags)]
        one, two = (mixed.test(offer, [other], mixed.pooled("changed")) for mixed in sides)
        np.testing.assert_array_less(np.abs(one.value + two.value), one.std)
        assert max(one.p, two.p) < 1e-4


def test_the_same_flights_on_both_sides_agree(ground, made):  # noqa: F811
    again = [dataclasses.replace(e, key=f"{e.key} again") for e in made[0]]
    assert diagnosed(Model(ground[1].document, "test"), made[0], again, made[3]) == {}
