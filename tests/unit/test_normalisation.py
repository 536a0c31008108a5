"""Non-dimensional models: the scheme by hand, SI predictions from normalised coefficients, rotors at rest."""

import copy
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from flights import AIRFRAME, HOVER, flight
from made_model import SHARED
from plain_rollout import Body, rollout_body

from quasi.errors import ConfigError, ExpressionError
from quasi.identification.candidates import read_specification
from quasi.identification.fit import fit_axis
from quasi.identification.map_error import add_map_error
from quasi.identification.partition import partition
from quasi.identification.redundancy import drop_redundant
from quasi.model.build import assemble_model
from quasi.model.document import AXES
from quasi.model.envelope import measure_coverage
from quasi.model.model import Model, read_model
from quasi.simulation.tools.rollout import rollout
from quasi.simulation.vehicle.variants import apply_extensions, make_simple_model
from quasi.tables import read_json, write_json
from quasi.terms.differential import make_differential_system
from quasi.terms.kernel import INPUTS, compute_wrench
from quasi.terms.normalisation import Normalisation, make_normalisation, read_normalisation
from quasi.terms.variables import Variables, base_columns

RADIUS, ARM, TOP, IDLE = AIRFRAME.radius, AIRFRAME.arm, 2000.0, 200.0
SCHEME = Normalisation(TOP, IDLE, RADIUS, ARM)

# what a truth is made of, in normalised variables; a bias is a force of N times a number
TRUTH = {
    "Fx": {"1": 1e-4, "mu_x": -0.02},
    "Fy": {"mu_y": -0.02, "v": 1e-4},
    "Fz": {"1": -0.02, "w_tot": -0.01, "|mu_z|*mu_z": 0.3},
    "Mx": {"U_p": 2e-3, "p": -2e-3},
    "My": {"U_q": 2e-3, "q": -2e-3, "w2_1": 1e-4},
    "Mz": {"U_r": 3e-4, "u_r_dot": 1e-3, "r*w3": -1e-3},
}


def scheme_by_hand(row):
    """Normalised variables and N of one row in plain arithmetic."""
    w = [row[f"w{i}"] for i in range(1, 5)]
    average = math.sqrt(sum(s * s for s in w) / 4)
    a, speed = max(average, IDLE), max(math.sqrt(row["u"] ** 2 + row["v"] ** 2 + row["w"] ** 2), 0.01)
    n = 0.5 * 1.225 * (4 * math.pi * RADIUS**2) * (RADIUS * TOP**2 / (TOP + average)) ** 2
    right = (1, 1, -1, -1)  # rotors 3 and 4 lie left
    made = {f"w{i}": s / a for i, s in enumerate(w, 1)}
    made |= {"w2_2": (w[1] / a) ** 2, "w_tot": sum(w) / TOP, "w_avg": average / TOP}
    made |= {"u_p": -sum(s * x for s, x in zip(right, w)) / a, "U_p": -sum(s * x * x for s, x in zip(right, w)) / a**2}
    made |= {"p": row["p"] * ARM / (a * RADIUS), "r": row["r"] * ARM / (a * RADIUS)}
    made |= {"mu_x": row["u"] / (a * RADIUS), "u": row["u"] / speed, "d_w_tot": (sum(w) - 4 * HOVER) / TOP}
    made |= {
        "u_r_dot": (row["w1_dot"] + row["w4_dot"] - row["w2_dot"] - row["w3_dot"]) / a**2,
        "w2_dot": row["w2_dot"] / a**2,
    }
    made |= {"roll": row["roll"], "z": row["z"], "F_den": n, "M_den": n * ARM}
    return made | {"|u|": abs(made["u"]), "u_air": made["u"], "sin[p]": math.sin(made["p"])}, n


@pytest.fixture(scope="module")
def flights():
    made = {key: flight(seed) for seed, key in enumerate("ab")}
    for table in made.values():
        columns = {name: table[name].to_numpy() for name in table}
        variables = Variables(columns, AIRFRAME, HOVER, SCHEME)
        for axis, terms in TRUTH.items():
            total = sum(c * (1.0 if e == "1" else value(variables, e)) for e, c in terms.items())
            table[axis] = total * SCHEME.scale_of(axis, columns)
    return made


def value(variables, expression):
    return math.prod(variables[name] for name in expression.split("*"))


def identify(flights, section, axis, scheme, bias):
    specification = read_specification({axis: section}, axis, "s.json", bias)
    shared = {"hover speed": {"value": HOVER}}
    return fit_axis(axis, flights, partition(flights, []), AIRFRAME, shared, {}, specification, scheme)


@pytest.fixture(scope="module")
def parts(flights):
    return {
        axis: identify(flights, {"fixed": [e for e in terms if e != "1"], "candidates": []}, axis, SCHEME, "1" in terms)
        for axis, terms in TRUTH.items()
    }


@pytest.fixture(scope="module")
def model(parts, flights):
    rows = {key: np.ones(len(f), bool) for key, f in flights.items()}
    region = measure_coverage(flights, rows, AIRFRAME, HOVER, parts)
    return Model(assemble_model(parts, SHARED, {"id": "m", "airframe": AIRFRAME, **region}))


def test_variables_are_those_of_the_scheme():
    table = flight(3, rows=20)
    table.loc[5, ["w1", "w2", "w3", "w4"]] = [50.0, 60.0, 70.0, 80.0]  # below idle
    table.loc[6, ["u", "v", "w"]] = [0.001, 0.002, -0.001]
    variables = Variables({n: table[n].to_numpy() for n in table}, AIRFRAME, HOVER, SCHEME)
    for k in range(20):
        expected, n = scheme_by_hand(table.iloc[k])
        for name, number in expected.items():
            assert variables[name][k] == pytest.approx(number, rel=1e-12), name
        assert SCHEME.scale_of("Fz", table)[k] == pytest.approx(n, rel=1e-12)
        assert SCHEME.scale_of("My", table)[k] == pytest.approx(n * ARM, rel=1e-12)


def test_n_lies_between_a_quarter_and_the_whole_of_its_value_at_rest():
    # the manual's remark under equation (18)
    whole = 0.5 * 1.225 * 4 * math.pi * RADIUS**2 * (RADIUS * TOP) ** 2
    speeds = {f"w{i}": np.array([0.0, TOP]) for i in range(1, 5)}
    np.testing.assert_allclose(SCHEME.scale_of("Fx", speeds), [whole, whole / 4], rtol=1e-12)


def test_a_normalised_variable_needs_the_rotor_speeds():
    assert base_columns("p", SCHEME) == {"p", "w1", "w2", "w3", "w4"}
    assert base_columns("|u|", SCHEME) == {"u", "v", "w"}
    assert base_columns("roll", SCHEME) == {"roll"}


def test_the_truth_is_recovered_and_predictions_are_in_si(model, parts, flights):
    for axis, terms in TRUTH.items():
        found = {t["expression"]: t["coefficient"] for t in parts[axis]["terms"]}
        assert found == pytest.approx(terms, rel=1e-6)
        assert {t["unit"] for t in parts[axis]["terms"]} == {"1"}
        assert parts[axis]["RMSE"] < 1e-6 * np.std(flights["a"][axis])
    table = flights["b"]
    predicted = model.predict_columns(table)
    for axis in TRUTH:
        np.testing.assert_allclose(predicted[axis], table[axis], rtol=1e-6, atol=1e-7 * table[axis].std())
    row = table.iloc[100][list(INPUTS)].to_numpy(float)
    forces, moments = model.predict(row[:12], row[12:16], row[16:])
    np.testing.assert_allclose([*forces, *moments], predicted.iloc[100], rtol=1e-12)


def test_an_equivalent_dimensional_pool_predicts_the_same(flights):
    normalised = identify(flights, {"fixed": ["U_p", "p"], "candidates": []}, "Mx", SCHEME, False)
    n = f"(1/({TOP!r} + w_avg)^2)"
    same = [f"{n}*U_p/w_avg^2", f"{n}*p/w_avg"]  # no row is below idle speed
    plain = identify(flights, {"fixed": same, "candidates": []}, "Mx", None, False)
    models = [
        Model(assemble_model({"Mx": found}, SHARED, {"id": "m", "airframe": AIRFRAME})) for found in (normalised, plain)
    ]
    table = flights["a"]
    a, b = (m.predict_columns(table)["Mx"] for m in models)
    np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-10 * b.std())


def test_scales_are_terms_and_the_model_is_read_again(flights, tmp_path):
    fixed = ["w_tot", "|mu_z|*mu_z", "F_den^0.5", "|M_den|"]
    found = {"Fz": identify(flights, {"fixed": fixed, "candidates": []}, "Fz", SCHEME, True)}
    region = measure_coverage(
        flights, {key: np.ones(len(f), bool) for key, f in flights.items()}, AIRFRAME, HOVER, found
    )
    model = Model(assemble_model(found, SHARED, {"id": "m", "airframe": AIRFRAME, **region}))
    write_json(tmp_path / "model.json", model.document)
    again, table = read_model(tmp_path), flights["a"]
    expected = model.predict_columns(table)["Fz"]
    np.testing.assert_allclose(again.predict_columns(table)["Fz"], expected, rtol=1e-12)
    np.testing.assert_allclose(expected, table["Fz"], rtol=1e-6)
    write_json(tmp_path / "model.json", {**model.document, "normalisation": None})
    with pytest.raises(ExpressionError, match=r"model.json, Fz, term 'F_den\^0.5': 'F_den' is a scale of non-dim"):
        read_model(tmp_path)


def test_intervals_are_in_si_and_hold_their_share(flights):
    r = np.random.default_rng(5)
    noisy = {key: f.copy() for key, f in flights.items()}
    for table in noisy.values():
        table["Fz"] += r.normal(size=len(table)) * 0.02 * SCHEME.scale_of("Fz", table)
    fixed = {"fixed": ["w_tot", "|mu_z|*mu_z"], "candidates": []}
    found = identify(noisy, fixed, "Fz", SCHEME, True)
    model = Model(assemble_model({"Fz": found}, SHARED, {"id": "m", "airframe": AIRFRAME}))
    table = noisy["b"]
    bands = model.interval(table)
    inside = (table["Fz"] >= bands["Fz_lower"]) & (table["Fz"] <= bands["Fz_upper"])
    assert np.mean(inside) == pytest.approx(0.95, abs=0.01)
    scale = SCHEME.scale_of("Fz", table)
    np.testing.assert_allclose((bands["Fz_upper"] - bands["Fz"]) / (0.02 * scale), 1.96, rtol=0.05)
    np.testing.assert_allclose(bands["Fz"], model.predict_columns(table)["Fz"], rtol=1e-12)
    error = table["Fz"] - bands["Fz"]
    pooled = np.concatenate([f["Fz"] - model.predict_columns(f)["Fz"] for f in noisy.values()])
    assert found["RMSE"] == pytest.approx(np.sqrt(np.mean(pooled**2)), rel=0.02)
    assert found["R2"] == pytest.approx(1 - np.var(error) / np.var(table["Fz"]), abs=0.05)


def test_derivatives_follow_the_predictions(model, flights):
    table = flights["a"].iloc[::400]
    states, speeds = table[list(INPUTS[:12])].to_numpy(), table[list(INPUTS[12:16])].to_numpy()
    jacobian = model.jacobian(states, speeds)
    r = np.random.default_rng(2)
    step = r.normal(size=(len(table), 16)) * np.r_[[1e-5] * 12, [1e-2] * 4]
    ends = [np.hstack(model.predict(states + s * step[:, :12], speeds + s * step[:, 12:])) for s in (0.5, -0.5)]
    expected = np.einsum("nij,nj->ni", jacobian.state, step[:, :12])
    expected += np.einsum("nij,nj->ni", jacobian.rotor_speeds, step[:, 12:])
    size = np.abs(expected).max(axis=0)
    np.testing.assert_allclose((ends[0] - ends[1]) / size, expected / size, atol=1e-6)
    # held variables are the dimensional ones: dMx/dU_p = N b c / a^2
    row, w = states[3], speeds[3]
    form = make_differential_system(model, row, w, ["U_p"])
    a2 = np.mean(w**2)
    n = SCHEME.scale_of("Mx", dict(zip(("w1", "w2", "w3", "w4"), w[:, None])))[0]
    assert form.moments_u[0, 0] == pytest.approx(n * 2e-3 / a2, rel=1e-6)
    assert "w_avg" in model.held_constant(["U_p"])


def test_the_summary_says_what_the_coefficients_are(model):
    assert "Coefficients are those of F / N and M / (N b)" in model.summary()


def test_rotors_at_rest_and_hover_give_finite_forces(model):
    forces, moments = model.predict(np.zeros(12), np.zeros(4))
    assert np.isfinite(forces).all()
    assert np.isfinite(moments).all()


def test_the_kernel_holds_the_scheme(model, flights):
    row = flights["b"].iloc[7][list(INPUTS)].to_numpy(float)
    kernel, out = model.kernel, np.empty(6)
    compute_wrench(kernel, row, kernel.work, out)
    np.testing.assert_allclose(out, model.predict_columns(flights["b"].iloc[7:8]).to_numpy()[0], rtol=1e-12)
    assert kernel.used[12:16].all()


def test_the_region_of_a_normalised_model_is_that_of_the_quantities_themselves(model, flights):
    assert {"u", "p", "w1", "w4", "U_p", "w_tot"} <= set(model.region_names)
    assert np.mean(model.distance_columns(flights["a"])["distance"] == 0) > 0.98


def test_axes_that_are_not_normalised_alike_make_no_model(parts, flights):
    other = copy.deepcopy(parts)
    other["Mz"]["normalisation"] = None
    with pytest.raises(ConfigError, match="differ in normalisation"):
        assemble_model(other, SHARED, {"id": "m", "airframe": AIRFRAME})


@pytest.mark.parametrize("damage", [{}, {"top": "2000"}, {"top": -1}, [], {"top": True}])
def test_a_damaged_scheme_is_refused(damage, model):
    plain = damage if not damage else SCHEME.to_plain() | damage
    with pytest.raises(ConfigError, match="'normalisation' must hold"):
        read_normalisation(plain, "model.json")
    with pytest.raises(ConfigError, match="'normalisation' must hold"):
        Model({**model.document, "normalisation": plain})


def test_what_the_quadrotor_lacks_is_named():
    full = dataclasses.replace(AIRFRAME, max_rpm=2100.0, idle_rpm=200.0, poles=14)
    assert make_normalisation(full, None, "m").top == pytest.approx(2100 * 100 / 7 * 2 * math.pi / 60)
    # with a pole count it is eRPM/100, whatever the log is written in: simulations know no log
    assert make_normalisation(full, 1.0, "m").idle == make_normalisation(full, None, "m").idle
    assert make_normalisation(dataclasses.replace(full, poles=None), 1.0, "m").idle == 200.0
    for change, said in (
        ({"max_rpm": None}, "needs 'max RPM'"),
        ({"idle_rpm": None}, "needs 'idle RPM'"),
        ({"poles": None}, "needs 'motor poles'"),
        ({"idle_rpm": 3000.0}, "not below"),
    ):
        with pytest.raises(ConfigError, match=said):
            make_normalisation(dataclasses.replace(full, **change), None, "config/models/m.json")


def test_a_simulation_flies_it_as_arithmetic_by_hand_does(model, flights):
    table = flights["a"].iloc[200:260].reset_index(drop=True)
    states, speeds = table[list(INPUTS[:12])].to_numpy(), table[list(INPUTS[12:16])].to_numpy()

    def one(row):
        _, _, _, u, v, w, p, q, r = row[:9]
        mean = math.sqrt(sum(x * x for x in row[12:16]) / 4)  # far above idle, and fast enough through the air
        _, n = scheme_by_hand(dict(zip(INPUTS, row)))
        s1, s2, s3, s4 = ((x / mean) ** 2 for x in row[12:16])
        tip, dots = mean * RADIUS, row[16:]
        forces = [
            1e-4 - 0.02 * u / tip,
            -0.02 * v / tip + 1e-4 * v / math.sqrt(u * u + v * v + w * w),
            -0.02 - 0.01 * sum(row[12:16]) / TOP + 0.3 * abs(w) * w / tip**2,
        ]
        moments = [
            2e-3 * (s3 + s4 - s1 - s2) - 2e-3 * p * ARM / tip,
            2e-3 * (s2 + s4 - s1 - s3) - 2e-3 * q * ARM / tip + 1e-4 * s1,
            3e-4 * (s1 + s4 - s2 - s3) + 1e-3 * (dots[0] + dots[3] - dots[1] - dots[2]) / mean**2
            - 1e-3 * r * ARM / tip * row[14] / mean,
        ]  # fmt: skip
        return [n * f for f in forces], [n * ARM * m for m in moments]

    def compute_wrench(rows, speeds, accelerations):
        found = [one(row) for row in np.hstack([rows, speeds, accelerations])]
        return np.array([f for f, _ in found]), np.array([m for _, m in found])

    body = Body(AIRFRAME.mass, AIRFRAME.inertia, compute_wrench, True)
    starts = np.array([0, 20])
    t = table["t"].to_numpy()
    found = rollout(model, t, states, speeds, starts, 0.05)
    expected = rollout_body(body, t, states, speeds, starts, 0.05)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7)


def test_other_models_made_of_it_are_in_si(model):
    factors = {f"kappa{a}": {"value": v} for a, v in zip(("Fz", "Mx", "My", "Mz"), (1e-6, 1e-8, 1e-8, -1e-9))}
    simple = make_simple_model(Model({**model.document, "simple model": factors}))
    assert simple.predict(np.zeros(12), np.full(4, 1000.0))[0][2] == pytest.approx(-4.0)
    terms = {"Fz": [{"expression": "u", "coefficient": 1.0}]}
    with pytest.raises(ConfigError, match="is normalised"):
        apply_extensions(Model({**model.document, "extensions": [{"id": "x", "terms": terms}]}))
    merged = copy.deepcopy(model.document)
    merged["axes"]["Fz"]["terms"][0]["extension"] = "x"
    with pytest.raises(ConfigError, match="is normalised"):
        Model(merged)


SHIPPED = sorted((Path(__file__).parents[2] / "config/polynomials").glob("*.json"))


@pytest.fixture(scope="module")
def complete():
    """Flights with every column that a shipped candidate file needs, the rotors stopped for some rows."""
    made = {}
    for seed, key in enumerate("ab"):
        table = flight(seed, rows=600)
        random = np.random.default_rng(seed)
        lacking = [c for c in ("w1_dot", "w2_dot", "w3_dot", "w4_dot", "v_in") if c not in table]
        table = table.assign(**{c: random.normal(0.0, 50.0, len(table)) for c in lacking})
        table.loc[:20, ["w1", "w2", "w3", "w4"]] = 0.0
        scale = SCHEME.scale_of("Fz", {f"w{i}": table[f"w{i}"].to_numpy() for i in range(1, 5)})
        for axis in AXES:
            table[axis] = scale * (0.1 + 0.05 * table["u"] + random.normal(0.0, 0.01, len(table)))
        made[key] = table
    return made


@pytest.mark.parametrize("file", SHIPPED, ids=lambda path: path.stem)
def test_shipped_candidate_files_are_identified_under_the_scheme(file, complete):
    for axis in AXES:
        section = read_json(file)[axis]
        found = identify(complete, section, axis, SCHEME, True)
        fixed = [t["name"] for t in found["terms"] if t["fixed"]]
        lost = [text for text in section["fixed"] if text not in fixed]
        assert lost == [t for t in section["fixed"] if t == "(w2_1 + w2_2 + w2_3 + w2_4)"], (axis, lost)
        assert all(any(text in note for note in found["notes"]) for text in lost)


def test_what_the_scheme_makes_constant_or_alike_is_derived_from_the_specification():
    section = {
        "fixed": ["w2_1 + w2_2 + w2_3 + w2_4", "u", "w2_1", "w2_2", "w2_3", "w2_4"],
        "candidates": [{"vars": ["(u^2 + v^2 + w^2)^0.5"], "degree": 1, "sets": [1, "u", "v"]}],
    }
    specification = read_specification({"Fz": section}, "Fz", "s.json", True)
    found, notes = drop_redundant(specification, SCHEME, AIRFRAME)
    # sum of w_i^2/a^2 = 4, so that the fourth square is a combination of the constant and the other three
    assert [t.expression for t in found.fixed] == ["u", "w2_1", "w2_2", "w2_3"]
    assert [of for _, of in found.duplicates] == ["bias", "u"] and len(found.candidates) == 1
    assert len(notes) == 3
    bare, _ = drop_redundant(read_specification({"Fz": section}, "Fz", "s.json", False), SCHEME, AIRFRAME)
    assert "w2_1 + w2_2 + w2_3 + w2_4" in [t.expression for t in bare.fixed]  # it takes the constant's place


def test_the_error_of_estimated_speeds_widens_intervals_as_without_the_scheme(model, flights):
    table, error = flights["b"].iloc[:50], 0.02
    drive = {"relative error": {"map": error, "total": error}}
    bands = Model({**model.document, "rotor speeds": drive}).interval(table)
    state, speeds, turning = table[list(INPUTS[:12])], table[list(INPUTS[12:16])], table[list(INPUTS[16:])]
    slopes = model.jacobian(state, speeds, turning).rotor_speeds
    added = np.sqrt(np.sum((slopes * speeds.to_numpy()[:, None] * error) ** 2, axis=2))
    for k, axis in enumerate(AXES):  # the truth holds no noise: the width is that of the speeds
        share = (bands[f"{axis}_upper"] - bands[axis]) / added[:, k]
        assert share.min() > 1.9 and share.max() == pytest.approx(share.min(), rel=1e-4)


def test_the_error_of_a_map_enters_normalised_coefficients(flights):
    section = {"fixed": ["w_tot"], "candidates": []}
    result = identify(flights, section, "Fz", SCHEME, True)
    before = np.array(result["covariance"])
    drive = {
        "form": "speed", "parameters": {}, "estimated": ["time constant"], "covariance": [[1e-6]],
        "time constant": {"value": 0.03},
    }  # fmt: skip

    def speeds(of):
        factor = 1.0 + of["time constant"]["value"] - 0.03
        return {k: f.assign(**{w: f[w] * factor for w in INPUTS[12:16]}) for k, f in flights.items()}

    roles = partition(flights, [])
    made = add_map_error(result, "Fz", drive, speeds, roles, AIRFRAME, HOVER, SCHEME)
    moved = identify(speeds({"time constant": {"value": 0.031}}), section, "Fz", SCHEME, True)
    change = [b["coefficient"] - a["coefficient"] for a, b in zip(result["terms"], moved["terms"])]
    np.testing.assert_allclose(np.array(made["covariance"]) - before, np.outer(change, change), rtol=0.1)


def test_regressors_with_a_root_of_what_is_positive_in_flight_are_no_multiples_of_each_other():
    """At random states the voltage is negative too, where its root is no number."""
    candidates = [{"vars": ["u", "v", "2*u"], "degree": 1, "sets": ["battery_voltage^0.5"]}]
    specification = read_specification({"Fx": {"candidates": candidates}}, "Fx", "s.json", True)
    found, _ = drop_redundant(specification, SCHEME, AIRFRAME)
    assert len(found.candidates) == 2
