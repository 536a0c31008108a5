"""The portable model: predictions, intervals, scores, summary, and files that were tampered with."""

import copy
import math

import numpy as np
import pytest
from flights import AIRFRAME, HOVER, flight
from made_model import SHARED, TERMS, document, part

from quasi import tables
from quasi.errors import ConfigError, ExpressionError, QuasiError, ReadError, ShapeError
from quasi.model.build import assemble_model
from quasi.model.columns import STATE
from quasi.model.envelope import measure_coverage
from quasi.model.model import Model, read_model
from quasi.scoring.score import SCORE_UNITS, compare_with_measurements, score_comparisons

ROLES = {"training": 1, "test": 2, "validation": 3}


@pytest.fixture(scope="module")
def model():
    return Model(document())


@pytest.fixture(scope="module")
def data():
    f = flight(1, rows=300)
    return f, f[list(STATE)].to_numpy(), f[["w1", "w2", "w3", "w4"]].to_numpy()


def by_hand(row, speeds, accelerations):
    """The same forces and moments in plain arithmetic, one row."""
    roll, pitch, yaw, u, v, w, p, q, r, x, y, z = row
    w1, w2, w3, w4 = speeds
    squares = [s**2 for s in speeds]
    total, average = sum(speeds), math.sqrt(sum(squares) / 4)
    return (
        [
            0.02 - 2e-5 * total * u,
            -0.01 * v - 0.003 * v * math.sqrt(u * u + v * v + w * w),
            -1.3e-6 * sum(squares) + 1e-4 * (total - 4 * HOVER) + 3.0 * (w / (average * 0.0381)) ** 2,
        ],
        [
            1e-7 * (squares[3] + squares[2] - squares[1] - squares[0]) - 5e-4 * p + 1e-6 * q * (w1 + w4 - w2 - w3),
            1.1e-7 * (squares[3] + squares[1] - squares[2] - squares[0]) - 5e-4 * abs(q) * q,
            2e-8 * (squares[0] + squares[3] - squares[1] - squares[2])
            + 3e-6 * (accelerations[0] + accelerations[3] - accelerations[1] - accelerations[2]),
        ],
    )


def test_predictions_equal_plain_arithmetic(model, data):
    f, states, speeds = data
    dots = f[[f"w{i}_dot" for i in range(1, 5)]].to_numpy()
    forces, moments = model.predict(states, speeds, dots)
    assert forces.shape == moments.shape == (300, 3)
    for k in (0, 7, 299):
        force, moment = by_hand(states[k], speeds[k], dots[k])
        np.testing.assert_allclose(forces[k], force, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(moments[k], moment, rtol=1e-12, atol=1e-12)


def test_one_row_equals_the_batch_and_nine_columns_do(model, data):
    _, states, speeds = data
    forces, moments = model.predict(states, speeds)
    force, moment = model.predict(states[5], speeds[5])
    assert force.shape == moment.shape == (3,)
    np.testing.assert_allclose(force, forces[5], rtol=1e-14)
    np.testing.assert_allclose(moment, moments[5], rtol=1e-14)
    np.testing.assert_array_equal(model.predict(states[:, :9], speeds)[0], forces)


def test_without_rotor_accelerations_their_terms_are_zero(model, data):
    _, states, speeds = data
    assert model.uses_rotor_accelerations
    _, still = model.predict(states, speeds, np.zeros_like(speeds))
    np.testing.assert_array_equal(model.predict(states, speeds)[1], still)


def test_velocity_through_the_air_has_two_names_that_may_stand_together(data):
    f, states, speeds = data
    made = Model(
        assemble_model({"Fx": part("Fx", {"u": -0.1, "u_air": -0.2, "|u_air|*v_air": 0.03, "mu_x": 0.5, "w*w_air": 0.01})},  # noqa: E501
                 SHARED, {"id": "m", "airframe": AIRFRAME})
    )  # fmt: skip

    def expected(u, v, w):
        average = np.sqrt((speeds**2).sum(axis=1) / 4)
        return -0.3 * u + 0.03 * np.abs(u) * v + 0.5 * u / (average * 0.0381) + 0.01 * w**2

    ground, air = states[:, 3:6], states[:, 3:6] - [4.0, -2.0, 1.0]
    still = expected(*ground.T)  # the state of `predict` is told through the air
    np.testing.assert_allclose(made.predict(states, speeds)[0][:, 0], still, rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(made.predict(states[7], speeds[7])[0][0], still[7], rtol=1e-11)
    table = f.drop(columns=["u_air", "v_air", "w_air"], errors="ignore")
    blown = table.assign(**dict(zip(("u_air", "v_air", "w_air"), air.T)))
    for flown, found in ((table, still), (blown, expected(*air.T))):
        np.testing.assert_allclose(made.predict_columns(flown)["Fx"], found, rtol=1e-11, atol=1e-14)
        np.testing.assert_allclose(made.interval(flown)["Fx"], found, rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("rows", [0, 1, 127, 128, 129, 300])
def test_long_batches_are_cut_without_a_seam(model, data, rows):
    _, states, speeds = data
    forces, moments = model.predict(states[:rows], speeds[:rows])
    assert forces.shape == moments.shape == (rows, 3)
    for k in range(rows):
        force, moment = model.predict(states[k], speeds[k])
        np.testing.assert_allclose(forces[k], force, rtol=1e-14)
        np.testing.assert_allclose(moments[k], moment, rtol=1e-14)


def test_a_missing_axis_is_nan_never_zero(data):
    _, states, speeds = data
    only = assemble_model({"Fz": part("Fz", TERMS["Fz"])}, SHARED, {"id": "m", "airframe": AIRFRAME})
    forces, moments = Model(only).predict(states, speeds)
    assert np.isfinite(forces[:, 2]).all()
    assert np.isnan(forces[:, :2]).all()
    assert np.isnan(moments).all()


def test_extra_columns_and_position_are_asked_for_by_name(data):
    _, states, speeds = data
    needy = Model(
        assemble_model({"Fz": part("Fz", {"z*battery_voltage": 1.0})}, SHARED, {"id": "m", "airframe": AIRFRAME})
    )
    forces, _ = needy.predict(states, speeds, extra={"battery_voltage": 16.0})
    np.testing.assert_allclose(forces[:, 2], 16.0 * states[:, 11])
    with pytest.raises(ExpressionError, match="'battery_voltage'"):
        needy.predict(states, speeds)
    with pytest.raises(ExpressionError, match="'z'"):
        needy.predict(states[:, :9], speeds, extra={"battery_voltage": 16.0})


@pytest.mark.parametrize(
    ("state", "speeds"), [((5, 11), (5, 4)), ((5, 12), (4, 4)), ((5, 12), (5, 3)), ((2, 3, 12), (2, 4))]
)
def test_wrong_shapes_are_refused(model, state, speeds):
    with pytest.raises(ShapeError, match="got"):
        model.predict(np.ones(state), np.ones(speeds))


def test_intervals_equal_the_textbook_formula(model, data):
    f, _, _ = data
    bands = model.interval(f.iloc[:5], 0.9)
    from scipy.stats import t

    a = np.column_stack([np.ones(5), f[["w1", "w2", "w3", "w4"]].sum(axis=1)[:5] * f["u"][:5]])
    covariance = np.diag([(0.01 * 0.02) ** 2, (0.01 * 2e-5) ** 2])
    for k in range(5):
        width = t.ppf(0.95, 200) * np.sqrt(0.01 + a[k] @ covariance @ a[k])
        assert bands["Fx_upper"].iloc[k] - bands["Fx"].iloc[k] == pytest.approx(width, rel=1e-9)
    np.testing.assert_allclose(bands["Fx"], model.predict_columns(f.iloc[:5])["Fx"], rtol=1e-12)


def test_a_model_survives_its_file(model, data, tmp_path):
    _, states, speeds = data
    tables.write_json(tmp_path / "model.json", model.document)
    for place in (tmp_path, tmp_path / "model.json"):
        again = read_model(place)
        np.testing.assert_array_equal(again.predict(states, speeds)[0], model.predict(states, speeds)[0])
    with pytest.raises(ReadError, match="holds no model.json"):
        read_model(tmp_path / "nowhere")


TAMPERED = {
    "schema": (lambda d: d.update(schema="quasi.model/9"), "schema 'quasi.model/9'"),
    "gravity": (lambda d: d.update(gravity="maybe"), "'gravity' is 'maybe'"),
    "no axes": (lambda d: d.update(axes={}), "'axes'"),
    "unknown axis": (lambda d: d["axes"].update(Q={}), "'axes'"),
    "no airframe": (lambda d: d.pop("airframe"), "lacks the key 'airframe'"),
    "airframe text": (lambda d: d.update(airframe="fast"), "'airframe'"),
    "airframe shape": (lambda d: d["airframe"].update(hubs=[[0, 0, 0]]), "'airframe'"),
    "hover": (lambda d: d.update({"hover speed": {"value": "fast"}}), "'hover speed'"),
    "hover backwards": (lambda d: d.update({"hover speed": {"value": -2000.0}}), "'hover speed' must hold a positive"),
    "coefficient": (lambda d: d["axes"]["Fx"]["terms"][1].update(coefficient="2"), "'coefficient' is '2'"),
    "infinite": (lambda d: d["axes"]["Fx"]["terms"][1].update(coefficient=math.inf), "'coefficient' is inf"),
    "true": (lambda d: d["axes"]["Fx"]["terms"][1].update(std=True), "'std' is True"),
    "no expression": (lambda d: d["axes"]["Fx"]["terms"][1].pop("expression"), "no expression"),
    "covariance": (lambda d: d["axes"]["Fx"].update(covariance=[[1.0]]), "'covariance' must be 2 x 2"),
    "code": (lambda d: d["axes"]["Fx"]["terms"][1].update(expression="__import__('os')"), "nothing can be called"),
    "brackets": (lambda d: d["axes"]["Fx"]["terms"][1].update(expression="(" * 9999), "nested"),
    "sigma": (lambda d: d["axes"]["Fx"].update(sigma2=None), "'sigma2' is None"),
    "variable": (
        lambda d: d["axes"]["Fx"]["terms"][1].update(expression="w_tott*u"),
        "Fx, term 'w_tott*u': unknown variable 'w_tott' (did you mean 'w_tot'?)",
    ),
}


@pytest.mark.parametrize("fault", TAMPERED)
def test_a_tampered_file_is_refused_with_file_and_key(model, fault, tmp_path):
    change, hint = TAMPERED[fault]
    damaged = copy.deepcopy(model.document)
    change(damaged)
    if fault == "infinite":
        with pytest.raises(QuasiError) as caught:
            Model(damaged, "somewhere/model.json")
    else:
        tables.write_json(tmp_path / "model.json", damaged)
        with pytest.raises(QuasiError) as caught:
            read_model(tmp_path)
    assert hint in str(caught.value)
    assert "model.json" in str(caught.value)


def test_assembly_without_axes_is_refused():
    with pytest.raises(ConfigError, match="no identified axis"):
        assemble_model({}, SHARED, {"id": "m", "airframe": AIRFRAME})


def test_the_summary_names_terms_values_errors_and_units(model):
    text = model.summary()
    for word in ("Fx", "bias", "(w_tot)*(u^(1.0))", "-2.0000e-05", "2.0e-07", "Total number of terms 2", "R2 0.9900"):
        assert word in text
    assert "Mz" not in model.summary(["Fx"])
    with pytest.raises(ConfigError, match="no axis 'Fq'"):
        model.summary(["Fq"])


def test_scores_equal_their_definitions(model):
    flights = {"a": flight(1, rows=400), "b": flight(2, rows=200)}
    codes = {"a": np.repeat([0, 1, 2, 1], 100), "b": np.full(200, 3)}
    table = score_comparisons(compare_with_measurements(model, flights, codes), model, ROLES)
    assert list(table.columns) == list(SCORE_UNITS)
    assert set(zip(table["flight"], table["role"])) == {
        ("a", "training"),
        ("a", "test"),
        ("b", "validation"),
        *(("all", role) for role in (*ROLES, "full")),
    }
    used = [f[codes[key] > 0] for key, f in flights.items()]
    errors = np.concatenate([f["Fz"] - model.predict_columns(f)["Fz"] for f in used])
    full = table.query("role == 'full' and axis == 'Fz'").iloc[0]
    assert full["n"] == 500 and full["rmse"] == pytest.approx(np.sqrt(np.mean(errors**2)))
    rows = flights["a"][codes["a"] == 1]
    error = rows["Fx"] - model.predict_columns(rows)["Fx"]
    entry = table.query("flight == 'a' and role == 'training' and axis == 'Fx'").iloc[0]
    assert entry["n"] == 200
    assert entry["rmse"] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert entry["r2"] == pytest.approx(1 - np.mean(error**2) / rows["Fx"].var(ddof=0))
    assert entry["relative_rmse"] == pytest.approx(np.sqrt(np.mean(error**2) / np.mean(rows["Fx"] ** 2)))


def test_intervals_of_a_true_model_cover_what_they_promise():
    truth = {"Fx": part("Fx", {"(w_tot)*(u^(1.0))": -2e-5, "u": -0.01}, sigma=1.0)}
    f = flight(3, rows=4000, noise=0.1)
    residual = f["Fx"] + 2e-5 * f["u"] * f[["w1", "w2", "w3", "w4"]].sum(axis=1) + 0.01 * f["u"]
    truth["Fx"]["sigma2"] = float(residual.var())
    truth["Fx"]["covariance"] = [[0.0, 0.0], [0.0, 0.0]]
    model = Model(assemble_model(truth, SHARED, {"id": "m", "airframe": AIRFRAME}))
    table = score_comparisons(compare_with_measurements(model, {"a": f}, {"a": np.ones(4000, int)}), model, ROLES)
    assert table["coverage"].iloc[0] == pytest.approx(0.95, abs=0.01)


def test_the_envelope_is_that_of_the_training_rows(data):
    f, _, _ = data
    rows = {"a": np.arange(300) < 100}
    region = measure_coverage({"a": f}, rows, AIRFRAME, HOVER, {"Fz": part("Fz", TERMS["Fz"])})["envelope"]
    assert region["u"]["min"] == f["u"][:100].min()
    assert region["u"]["percentiles"]["50"] == pytest.approx(f["u"][:100].median())
    assert region["u"]["unit"] == "m/s"
    assert {"mu_z", "d_w_tot", "w3", "roll"} <= set(region)


@pytest.mark.parametrize(
    "damage",
    [
        lambda d: d.update(id="../x"),
        lambda d: d.update(id="a\nb"),
        lambda d: d.update(id=None),
        lambda d: d["axes"]["Fx"]["terms"][0].pop("name"),
        lambda d: d["axes"]["Fx"]["terms"][0].update(unit=3),
        lambda d: d["axes"]["Fx"]["terms"][0].update(t="large"),
        lambda d: d["axes"]["Fx"]["terms"][0].update(expression="u\n; import os"),
        lambda d: d["axes"]["Fx"].update(unit="lbf"),
        lambda d: d["airframe"].update({"rotor radius": "0.04"}),
        lambda d: d["airframe"].update(b=-1.0),
        lambda d: d["airframe"].update(spin=[1, 1, -1, 0]),
        lambda d: d["airframe"].update(inertia=[[0.0] * 3] * 3),
        lambda d: d["airframe"].update(mass="heavy"),
    ],
)
def test_hostile_or_impossible_entries_are_one_sentence(damage):
    tampered = copy.deepcopy(document())
    damage(tampered)
    with pytest.raises((ConfigError, ExpressionError)) as error:
        Model(tampered, "model.json")
    assert str(error.value).startswith("model.json")
    assert "\n" not in str(error.value)
