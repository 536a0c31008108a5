"""The region that a model's data covered: distances against plain arithmetic, and against scipy for the ellipsoid."""

import copy

import numpy as np
import pytest
from flights import AIRFRAME, HOVER, flight
from made_model import SHARED, TERMS, part
from scipy.spatial.distance import mahalanobis

from quasi.errors import ConfigError
from quasi.model.build import assemble_model
from quasi.model.columns import ACCELERATIONS, ROTORS, STATE
from quasi.model.envelope import measure_coverage
from quasi.model.model import Model

READ = ["u", "v", "w", "p", "q", *ROTORS, *ACCELERATIONS]  # base columns of TERMS


def parts():
    return {axis: part(axis, terms) for axis, terms in TERMS.items()}


@pytest.fixture(scope="module")
def training():
    # enough rows that 0.01 % are some; yaw and position are read by no term
    return flight(1, rows=20000)


@pytest.fixture(scope="module")
def model(training):
    rows = {"a": np.ones(len(training), bool)}
    region = measure_coverage({"a": training}, rows, AIRFRAME, HOVER, parts())
    return Model(assemble_model(parts(), SHARED, {"id": "m", "airframe": AIRFRAME, **region}))


def arrays(table):
    return table[list(STATE)].to_numpy(), table[list(ROTORS)].to_numpy(), table[list(ACCELERATIONS)].to_numpy()


def centre(model):
    middle = {name: model.document["envelope"][name]["percentiles"]["50"] for name in STATE}
    return np.array([middle[name] for name in STATE]), np.full(4, HOVER)


def test_training_rows_lie_inside_but_for_the_share_that_is_cut(model, training):
    distance, worst = model.distance(*arrays(training))
    limits = len(model.region_names)
    assert 0.99 < np.mean(distance == 0.0) < 1.0
    # every limit leaves out 0.01 % at either end
    assert np.mean(distance > 0) <= 0.0002 * limits
    assert set(worst[distance == 0]) == {""}
    assert set(worst[distance > 0]) <= set(model.region_names)


@pytest.mark.parametrize("name", ["u", "q"])
@pytest.mark.parametrize("side", [-1, 1])
def test_the_distance_is_the_overshoot_in_units_of_the_covered_range(model, name, side):
    state, speeds = centre(model)
    shares = model.document["envelope"][name]["percentiles"]
    low, high = shares["0.01"], shares["99.99"]
    state[STATE.index(name)] = high + 0.75 * (high - low) if side > 0 else low - 0.75 * (high - low)
    distance, worst = model.distance(state, speeds)
    joint = model.document["joint envelope"]
    x = dict(zip(STATE, state)) | dict.fromkeys(ROTORS, HOVER) | dict.fromkeys(ACCELERATIONS, 0.0)
    white = np.array(joint["whitening"]) @ (np.array([x[n] for n in joint["names"]]) - joint["mean"])
    others = {name: 0.75, "all together": 0.5 * (np.linalg.norm(white) / joint["limit"] - 1)}
    assert worst == max(others, key=others.get)
    assert distance == pytest.approx(max(others.values()), rel=1e-12)


def test_what_no_term_reads_is_not_limited(model):
    state, speeds = centre(model)
    before = model.distance(state, speeds)
    state[STATE.index("yaw")] += 3.0
    state[STATE.index("x")] += 1e6
    state[STATE.index("r")] += 1e3
    assert model.distance(state, speeds) == before == (0.0, "")


def test_a_combination_may_be_new_where_each_part_is_not():
    r = np.random.default_rng(3)
    table = flight(2, rows=20000)
    table["v"] = table["u"] + 0.05 * r.normal(size=len(table))
    terms = {"Fx": {"u": -0.1, "v": 0.02}}
    region = measure_coverage(
        {"a": table}, {"a": np.ones(len(table), bool)}, AIRFRAME, HOVER, {"Fx": part("Fx", terms["Fx"])}
    )
    model = Model(assemble_model({"Fx": part("Fx", terms["Fx"])}, SHARED, {"id": "m", "airframe": AIRFRAME, **region}))
    state = np.zeros(12)
    state[3], state[4] = 3.0, 3.0
    assert model.distance(state, np.full(4, HOVER)) == (0.0, "")
    state[4] = -3.0
    distance, worst = model.distance(state, np.full(4, HOVER))
    assert worst == "all together"
    # the plain formula, with the covariance of the rows
    data = table[["u", "v"]].to_numpy()
    inverse = np.linalg.inv(np.cov(data.T, bias=True) + 1e-4 * np.diag(data.var(axis=0)))
    sizes = [mahalanobis(row, data.mean(axis=0), inverse) for row in data]
    expected = 0.5 * (mahalanobis([3.0, -3.0], data.mean(axis=0), inverse) / np.percentile(sizes, 99.99) - 1)
    assert distance == pytest.approx(expected, rel=1e-9)


def test_a_table_and_arrays_agree_and_nan_gives_nan(model, training):
    table = training.iloc[:50].copy()
    table.loc[table.index[3], "u"] = np.nan
    found = model.distance_columns(table)
    distance, worst = model.distance(*arrays(table))
    np.testing.assert_array_equal(found["distance"], distance)
    assert list(found["worst"]) == list(worst)
    assert np.isnan(distance[3])
    assert worst[3] == ""
    assert np.isfinite(np.delete(distance, 3)).all()


def test_a_model_without_its_region_says_so(model):
    bare = copy.deepcopy(model.document) | {"envelope": {}}
    with pytest.raises(ConfigError, match="no region"):
        Model(bare).distance(np.zeros(12), np.full(4, HOVER))
    damaged = copy.deepcopy(model.document)
    damaged["joint envelope"]["whitening"] = [[1.0]]
    with pytest.raises(ConfigError, match="damaged"):
        Model(damaged).distance(np.zeros(12), np.full(4, HOVER))
    # models made before the finer percentiles existed are limited by their extremes
    older = copy.deepcopy(model.document)
    del older["joint envelope"]
    for entry in older["envelope"].values():
        del entry["percentiles"]["0.01"], entry["percentiles"]["99.99"]
    state, speeds = centre(model)
    top = older["envelope"]["u"]
    state[3] = top["max"] + 0.25 * (top["max"] - top["min"])
    assert Model(older).distance(state, speeds)[0] == pytest.approx(0.25)


def test_every_base_column_of_the_terms_is_limited(model):
    assert set(READ) <= set(model.region_names)
    assert {"w_tot", "d_w_tot", "mu_z", "U_p", "u_r", "U_q", "U_r", "u_r_dot"} <= set(model.region_names)


def test_a_model_that_reads_less_keeps_the_shadow_of_the_ellipsoid(model):
    # without yaw moments nothing reads the rotors' accelerations
    document = copy.deepcopy(model.document)
    del document["axes"]["Mz"]
    less = Model(document)
    assert not less.uses_rotor_accelerations
    joint = document["joint envelope"]
    state, speeds = centre(model)
    state[3] += 30.0
    found, worst = less.distance(state, speeds)
    kept = [k for k, name in enumerate(joint["names"]) if not name.endswith("_dot")]
    x = dict(zip(STATE, state)) | dict.fromkeys(ROTORS, HOVER)
    covariance = np.linalg.inv(np.array(joint["whitening"]).T @ np.array(joint["whitening"]))[np.ix_(kept, kept)]
    away = np.array([x[joint["names"][k]] - joint["mean"][k] for k in kept])
    together = 0.5 * (np.sqrt(away @ np.linalg.solve(covariance, away)) / joint["limit"] - 1)
    shares = document["envelope"]["u"]["percentiles"]
    alone = (state[3] - shares["99.99"]) / (shares["99.99"] - shares["0.01"])
    assert found == pytest.approx(max(together, alone), rel=1e-9)
    assert worst == ("u" if alone > together else "all together")
