"""Published QuaSI models: the same forces from mechanical rotor speeds, and hostile files refused."""

import copy
import json
import math

import numpy as np
import pytest

from quasi.command import main
from quasi.errors import ConfigError, ExpressionError, QuasiError, ReadError
from quasi.gap.base_model import worth_of
from quasi.model.model import read_model
from quasi.model.published import read_published

POLES = 12
LOGGED = 2 * math.pi / 60  # from eRPM/100 to the unit of the published coefficients
MECHANICAL = 100 * 2 * math.pi / 60 / (POLES / 2)

DOCUMENT = {
    "model": {
        "Fx": {
            "name": "Fx-polynomial",
            "regressors": ["bias", "u*|u|", "(w_tot)*(u^(1.0))", "(u^(1.0))"],
            "coefficients": [-0.2, 5e-4, -1.2e-3, 0.15],
            "offset": 0,
        },
        "Fy": {"regressors": ["bias", "mu_y^(2)*d_w_tot", "1/(w_tot + 1)"], "coefficients": [0.01, 0.3, -40.0]},
        "Fz": {
            "regressors": ["(w2_1 + w2_2 + w2_3 + w2_4)", "((|u| + |v|)^(2))*(w^(1.0))", "w_avg^(0.5)", "F_den*w"],
            "coefficients": [-7.5e-5, -1.3e-3, 0.01, -0.02],
        },
        "Mx": {"regressors": ["bias", "U_p", "(w_tot)*(U_p^(1.0))"], "coefficients": [5e-4, 6e-6, -6e-9]},
        "My": {"regressors": ["U_q", "(|U_q|)*(U_q^(1.0))", "u_q"], "coefficients": [1.8e-6, 3e-11, 1e-4], "offset": 0},
        "Mz": {"regressors": ["U_r", "(|r|)*(U_r^(1.0))", "|U_r|*r"], "coefficients": [5e-7, 1.5e-7, -1e-8]},
    },
    "droneParams": {
        "R": 0.0381, "b": 0.077, "Iv": [[8.65e-4, 1e-6, 0.0], [1e-6, 1.07e-3, 0.0], [0.0, 0.0, 1.71e-3]],
        "rotor configuration": {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3},
        "rotor 1 direction": "CW", "idle RPM": 200.0, "max RPM": 2100.0, "m": 0.433, "wHover (rad/s)": 114.0,
        "wHover (eRPM)": 1088.0, "g": 9.81, "rho": 1.225, "r_sign": {"CCW": -1, "CW": 1}, "number of rotors": 4,
        "taus": {"w1": 0.016, "w2": 0.017, "w3": 0.018, "w4": 0.019},
        "simpleModel": {"kappaFz_w_2": 6.6e-5, "kappaFz_w": 0.015, "kappaMx_w_2": 1.8e-6, "kappaMz_w_2": 3.2e-7},
    },
    "DiffSys": {},
    "IODs": {"Fx": {"concave": {}, "convex": {}}},
    "metadata": {
        "hasGravity": True, "model ID": "Beetle-14", "isNormalized": False, "usesVIN": False,
        "identification metadata": {"additional info": {"droneMass": 0.433}},
    },
}  # fmt: skip


def written(tmp_path, document=DOCUMENT):
    path = tmp_path / "published.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def by_hand(state, erpm100, layout=((4, 2), (3, 1)), signs=(1, -1, -1, 1)):
    """Forces and moments as the published pipeline forms them: rotor speeds are the logged number x 2 pi/60.

    layout  ((front left, front right), (aft left, aft right)) rotor numbers
    """
    _, _, _, u, v, w, _, _, r, *_ = state
    s = [e * LOGGED for e in erpm100]
    squares = [x * x for x in s]
    left, front = {layout[0][0], layout[1][0]}, set(layout[0])

    def weighted(values, chosen):
        return sum(x if k in chosen else -x for k, x in enumerate(values, 1))

    total, average = sum(s), math.sqrt(sum(squares) / 4)
    U_p, U_q = weighted(squares, left), weighted(squares, front)
    U_r = sum(a * b for a, b in zip(signs, squares))
    return [
        -0.2 + 5e-4 * u * abs(u) - 1.2e-3 * total * u + 0.15 * u,
        0.01 + 0.3 * (v / (average * 0.0381)) ** 2 * (total - 4 * 114.0) - 40.0 / (total + 1),
        -7.5e-5 * sum(squares) - 1.3e-3 * (abs(u) + abs(v)) ** 2 * w + 0.01 * math.sqrt(average) - 0.02 * w,
        5e-4 + 6e-6 * U_p - 6e-9 * total * U_p,
        1.8e-6 * U_q + 3e-11 * abs(U_q) * U_q + 1e-4 * weighted(s, front),
        5e-7 * U_r + 1.5e-7 * abs(r) * U_r - 1e-8 * abs(U_r) * r,
    ]


def rows(seed=0):
    r = np.random.default_rng(seed)
    return r.normal(size=(20, 12)), r.uniform(500, 1900, (20, 4))


def test_forces_from_mechanical_speeds_equal_the_published_arithmetic(tmp_path):
    model = read_published(written(tmp_path), "beetle", POLES)
    states, erpm100 = rows()
    found = np.hstack(model.predict(states, erpm100 * MECHANICAL))
    expected = [by_hand(s, e) for s, e in zip(states, erpm100)]
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize(
    ("scale", "number"),
    [("F_den", 1.0), ("|F_den|", 1.0), ("sin[M_den]", math.sin(1.0)), ("|cos[F_den]|^2", math.cos(1.0) ** 2)],
)
def test_scales_are_one_in_every_form(tmp_path, scale, number):
    document = copy.deepcopy(DOCUMENT)
    document["model"]["Fz"]["regressors"][-1] = f"{scale}*w"
    model = read_published(written(tmp_path, document), "beetle", POLES)
    assert not set(model.columns) & {"F_den", "M_den"}
    states, erpm100 = rows()
    expected = [by_hand(s, e)[2] + 0.02 * s[5] * (1.0 - number) for s, e in zip(states, erpm100)]
    np.testing.assert_allclose(model.predict(states, erpm100 * MECHANICAL)[0][:, 2], expected, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("direction", ["CW", "CCW"])
def test_their_yaw_signs_hold_in_every_layout(tmp_path, direction):
    # rotors 1 and 3 on one diagonal: the published signs are no longer the sense of rotation
    document = copy.deepcopy(DOCUMENT)
    drone = document["droneParams"]
    drone["rotor configuration"] = {"front left": 1, "front right": 2, "aft right": 3, "aft left": 4}
    drone["rotor 1 direction"] = direction
    model = read_published(written(tmp_path, document), "beetle", POLES)
    sign = 1 if direction == "CW" else -1
    np.testing.assert_array_equal(model.airframe.spin, np.array([1, -1, 1, -1]) * sign)
    states, erpm100 = rows(1)
    found = np.hstack(model.predict(states, erpm100 * MECHANICAL))
    expected = [by_hand(s, e, ((1, 2), (4, 3)), [sign * x for x in (1, -1, -1, 1)]) for s, e in zip(states, erpm100)]
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-13)


def test_parameters_are_mechanical_and_in_si(tmp_path):
    model = read_published(written(tmp_path), "beetle", POLES)
    assert model.id == "beetle"
    assert model.with_gravity
    assert model.airframe.mass == 0.433
    assert model.airframe.inertia[0, 1] == 1e-6
    assert model.hover_speed == pytest.approx(114.0 / LOGGED * MECHANICAL)
    assert model.document["logged to rad/s"] == pytest.approx(MECHANICAL)
    simple = model.document["simple model"]
    # the same thrust from the same logged speed
    assert simple["kappaFz"]["value"] * MECHANICAL**2 == pytest.approx(6.6e-5 * LOGGED**2)
    assert simple["kappaFz_w"]["value"] * MECHANICAL == pytest.approx(0.015 * LOGGED)
    assert model.document["actuators"]["time constants"]["value"] == [0.016, 0.017, 0.018, 0.019]
    said = " ".join(model.document["notes"])
    assert "no standard errors" in said
    assert "against their stated direction" in said
    assert "motor poles" not in said
    assert "14 are assumed" in " ".join(read_published(written(tmp_path)).document["notes"])


def test_the_simple_model_of_a_published_model_carries_what_was_reported_of_it(tmp_path):
    # HDBeetle-14: its thrust factor carries 3.44 N in hover, where the quadrotor weighs 4.25 N
    document = copy.deepcopy(DOCUMENT)
    document["droneParams"] |= {
        "wHover (rad/s)": 114.36692325451668,
        "simpleModel": {"kappaFz_w_2": 6.568989586902552e-05},
    }
    model = read_published(written(tmp_path, document), "beetle")
    thrust = 4 * model.document["simple model"]["kappaFz"]["value"] * model.hover_speed**2
    assert round(thrust, 2) == 3.44
    assert round(model.airframe.mass * 9.81, 2) == 4.25
    # 1092 in the log is hover, 14 poles
    assert model.hover_speed == pytest.approx(1092.1236697300658 * model.document["logged to rad/s"])


def test_nothing_is_known_of_its_errors(tmp_path):
    model = read_published(written(tmp_path))
    states, erpm100 = rows()
    columns = dict(zip(("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z"), states.T))
    columns |= dict(zip(("w1", "w2", "w3", "w4"), erpm100.T))
    bands = model.interval(columns)
    assert np.isfinite(bands["Fz"]).all()
    assert bands["Fz_lower"].isna().all()
    assert "without standard errors" in model.summary()
    assert "given" in model.summary()
    with pytest.raises(ConfigError, match="no region"):
        model.distance(states, erpm100)


def test_the_command_writes_a_model_that_is_read_again(tmp_path, capsys):
    path = written(tmp_path)
    assert main(["import-model", str(path), "beetle", "-d", str(tmp_path), "--motor-poles", str(POLES)]) == 0
    assert "Made" in capsys.readouterr().out
    folder = tmp_path / "models/beetle/standalone"
    states, erpm100 = rows()
    found = read_model(folder).predict(states, erpm100 * MECHANICAL)[0]
    np.testing.assert_array_equal(found, read_published(path, "beetle", POLES).predict(states, erpm100 * MECHANICAL)[0])
    before = (folder / "model.json").read_bytes()
    assert main(["import-model", str(path), "beetle", "-d", str(tmp_path)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert (folder / "model.json").read_bytes() == before


@pytest.mark.parametrize("name", ["../x", "a/b", ".hidden", "a\nb", "a'b", 'a"b', "", "a b", "x" + "/" * 3, "..", "é"])
def test_names_that_leave_their_folder_are_refused(tmp_path, name, capsys):
    path = written(tmp_path)
    with pytest.raises(ConfigError, match="no model ID"):
        read_published(path, name)
    document = copy.deepcopy(DOCUMENT)
    document["metadata"]["model ID"] = name
    with pytest.raises(ConfigError, match="no model ID"):
        read_published(written(tmp_path, document))
    assert main(["import-model", str(path), name, "-d", str(tmp_path / "p")]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert not (tmp_path / "p").exists()


@pytest.mark.parametrize(
    "regressor",
    [
        "__import__('os').system('touch /tmp/owned')", "u; import os", "exec(u)", "u\n+v'", '"u"', "lambda: 0",
        "u.__class__", "u[0]", "(" * 200 + "u" + ")" * 200, "u" * 20_000, "unknown_variable", "sin[__import__]", "F_g",
        "", "u**2", "{u}", "sin[U_p]*u + 1", 7, None, ["u"], {"a": 1},
    ],
)  # fmt: skip
def test_regressors_that_are_no_expressions_are_refused(tmp_path, regressor):
    document = copy.deepcopy(DOCUMENT)
    document["model"]["Fx"]["regressors"][1] = regressor
    with pytest.raises((ConfigError, ExpressionError)) as error:
        read_published(written(tmp_path, document))
    assert "Fx" in str(error.value)
    assert "\n" not in str(error.value)


DAMAGE = [
    (lambda d: d.pop("metadata"), "expected the keys"),
    (lambda d: d["metadata"].update(isNormalized=True), "not normalised"),
    (lambda d: d["metadata"].update(hasGravity="yes"), "'hasGravity'"),
    (lambda d: d["model"]["Fx"]["coefficients"].pop(), "4 regressors but 3 coefficients"),
    (lambda d: d["model"]["Fx"]["coefficients"].__setitem__(0, "0.1"), "expected a number"),
    (lambda d: d["model"]["Fx"]["coefficients"].__setitem__(0, True), "expected a number"),
    (lambda d: d["model"]["Fx"].update(offset=0.5), "'offset'"),
    (lambda d: d["model"]["Fx"].update(regressors="u"), "expected lists"),
    (lambda d: d["model"].update(Fx=3), "expected a section"),
    (lambda d: d.update(model={}), "holds none of"),
    (lambda d: d.update(droneParams=[]), "expected a section"),
    (lambda d: d["droneParams"].pop("b"), "lacks the key 'b'"),
    (lambda d: d["droneParams"].update(Iv=[[1, 2], [3]]), "moment of inertia"),
    (lambda d: d["droneParams"].update(m=-1), "mass"),
    (lambda d: d["droneParams"].update({"rotor 1 direction": "up"}), "rotor 1 direction"),
    (lambda d: d["droneParams"].update({"rotor 1 direction": ["CW"]}), "rotor 1 direction"),
    (lambda d: d["droneParams"].pop("rotor configuration"), "rotor config"),
    (lambda d: d["droneParams"].update({"wHover (rad/s)": "fast"}), "wHover"),
    (lambda d: d["droneParams"]["taus"].update(w1=0), "positive times"),
    (lambda d: d["droneParams"]["simpleModel"].update(kappaFz_w_2=[1]), "kappaFz_w_2"),
]


@pytest.mark.parametrize(("damage", "said"), DAMAGE)
def test_damaged_files_are_refused_with_a_sentence(tmp_path, damage, said):
    document = copy.deepcopy(DOCUMENT)
    damage(document)
    with pytest.raises(QuasiError, match=said) as error:
        read_published(written(tmp_path, document))
    assert "published.json" in str(error.value)


def test_files_that_are_no_models_are_refused(tmp_path):
    with pytest.raises(ReadError):
        read_published(tmp_path / "absent.json")
    for text in ("[]", "{}", "3", '{"model": 1e999}', "not json", '"model"'):
        path = tmp_path / "x.json"
        path.write_text(text)
        with pytest.raises(QuasiError):
            read_published(path)
    with pytest.raises(ConfigError, match="motor poles"):
        read_published(written(tmp_path), "m", 13)


def test_a_published_model_is_worth_a_comparison(tmp_path):
    """The rows that it was identified from are unknown, and counted as rows of which it explains nothing."""
    worth = worth_of(read_published(written(tmp_path), "beetle", POLES), [])
    assert worth.excluded == () and worth.sentence() == ""
