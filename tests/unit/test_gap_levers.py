"""Causes that act through thrust use the levers of the model: one rotor's speed column scaled in any model."""

import numpy as np
import pytest
from flights import AIRFRAME
from made_model import simple_model

from quasi.gap.catalogue import catalogue, columns_of, wrench_of
from quasi.gap.effect import vehicle_of
from quasi.gap.extension import extend
from quasi.gap.flights.evidence import Evidence, model_wrench, rotor_levers
from quasi.model.model import AXES, Model

THRUST, TORQUE, MASS, HOVER = 2.4e-7, 3e-9, 0.43, 2100.0
SHRUNK = {
    "Mx": {"U_p": 0.75 * THRUST * abs(AIRFRAME.hubs[0, 0])},
    "My": {"U_q": 0.8 * THRUST * abs(AIRFRAME.hubs[0, 0])},
}


@pytest.fixture(scope="module")
def model():
    """A model whose roll and pitch effectiveness are smaller than thrust times arm, as noise and inertia make them."""
    return simple_model(AIRFRAME, THRUST, TORQUE, **SHRUNK)


def flown(model, columns):
    predicted = model_wrench(model, columns)
    return Evidence("a", AIRFRAME, model, MASS, np.asarray(AIRFRAME.inertia), columns, predicted, predicted)


def test_levers_of_a_model_are_its_own_and_those_of_the_hubs_where_it_has_them(model):
    arm = abs(AIRFRAME.hubs[0, 0])
    exact = rotor_levers(simple_model(AIRFRAME, THRUST, TORQUE), MASS)
    sides = np.sign(AIRFRAME.hubs[:, :2])
    geometry = np.column_stack([-np.ones(4), -sides[:, 1] * arm, sides[:, 0] * arm])
    np.testing.assert_allclose(exact, geometry, rtol=1e-6)
    np.testing.assert_allclose(rotor_levers(model, MASS) / exact, np.tile([1.0, 0.75, 0.8], (4, 1)))


@pytest.mark.parametrize("factor", [0.9, 0.95, 1.05, 1.1])
@pytest.mark.parametrize("rotor", range(4))
def test_a_scaled_speed_column_is_what_the_cause_adds(model, rotor, factor):
    rng = np.random.default_rng(rotor)
    columns = {name: np.zeros(200) for name in (*"xyzuvwpqrt", "roll", "pitch", "yaw")}
    columns |= {f"w{i}": HOVER + 150.0 * rng.standard_normal(200) for i in range(1, 5)}
    columns |= {f"w{i}_dot": np.zeros(200) for i in range(1, 5)}
    name = f"w{rotor + 1}"
    scaled = flown(model, {**columns, name: factor * columns[name]})
    residual = model_wrench(model, columns) - scaled.predicted
    column = columns_of(catalogue()["rotor_effectiveness"], scaled, vehicle_of(model, MASS), {})[f"rotor{rotor + 1}"]
    for axis in ("Fz", "Mx", "My"):
        k = AXES.index(axis)
        estimate = 1.0 + column[:, k] @ residual[:, k] / (column[:, k] @ column[:, k])
        assert estimate == pytest.approx(factor**-2.0, abs=1e-3)


def test_one_rotor_acts_by_the_model_s_slope_in_every_row_not_by_that_in_hover():
    """A roll moment that grows with the sum of the speeds: levers of hover explain its mean alone."""
    lever = THRUST * abs(AIRFRAME.hubs[0, 0])
    model = simple_model(AIRFRAME, THRUST, TORQUE, Mx={"U_p": 0.75 * lever, "d_w_tot*U_p": -1e-4 * lever})
    rng, factor = np.random.default_rng(1), 0.97
    columns = {name: np.zeros(400) for name in (*"xyzuvwpqrt", "roll", "pitch", "yaw")}
    columns |= {f"w{i}": HOVER + 150.0 * rng.standard_normal(400) for i in range(1, 5)}
    columns |= {f"w{i}_dot": np.zeros(400) for i in range(1, 5)}
    scaled, vehicle = flown(model, {**columns, "w2": factor * columns["w2"]}), vehicle_of(model, MASS)
    residual = (model_wrench(model, columns) - scaled.predicted)[:, 3]
    column = (factor**-2.0 - 1.0) * columns_of(catalogue()["rotor_effectiveness"], scaled, vehicle, {})["rotor2"][:, 3]
    hover = (factor**-2.0 - 1.0) * wrench_of(catalogue()["rotor_effectiveness"].terms(vehicle)["rotor2"], scaled)[:, 3]
    left, left_by_levers = (np.std(residual - c) / np.std(residual) for c in (column, hover))
    assert left < 0.1 < 0.5 * left_by_levers


def test_differences_of_thrust_in_the_yaw_moment_are_those_that_act_and_the_shaft_s_moment_stays():
    # differences next to a velocity are of the drag at the hubs
    shaft = {"u_r*d_w_tot": 1e-11, "r": -1e-5, "w_tot*r": -1e-9, "|v|*U_p": 2e-10}
    thrust = {"q*U_p": 4e-10, "p*U_q": -3e-10, "|p|*U_p": 2e-10}
    whole, rest = (simple_model(AIRFRAME, THRUST, TORQUE, Mz={**shaft, **more}) for more in (thrust, {}))
    rng = np.random.default_rng(4)
    columns = {name: rng.standard_normal(300) for name in (*"uvwpqr", "roll", "pitch")}
    columns |= {name: np.zeros(300) for name in (*"xyzt", "yaw")} | {f"w{i}_dot": np.zeros(300) for i in range(1, 5)}
    columns |= {f"w{i}": HOVER + 150.0 * rng.standard_normal(300) for i in range(1, 5)}
    acting = {**columns, "w2": np.sqrt(0.9) * columns["w2"]}
    of_thrust = [(model_wrench(whole, c) - model_wrench(rest, c))[:, 5] for c in (columns, acting)]
    effect, vehicle = catalogue()["rotor_effectiveness"], vehicle_of(whole, MASS)
    column = -0.1 * columns_of(effect, flown(whole, columns), vehicle, {})["rotor2"][:, 5]
    np.testing.assert_allclose(column, of_thrust[1] - of_thrust[0], rtol=0, atol=1e-3 * np.std(of_thrust[0]))
    extended = Model(extend(whole, [(effect, {"rotor2": -0.1})], vehicle, "extended", "a test"))
    change = (model_wrench(extended, columns) - model_wrench(whole, columns))[:, 5]
    np.testing.assert_allclose(change, of_thrust[1] - of_thrust[0], rtol=1e-6, atol=1e-9 * np.std(of_thrust[0]))


def test_an_extended_model_is_the_model_at_the_speeds_that_its_rotors_act_with():
    every = {"w_avg^2": 2e-7, "d_w2*|u_q|": 3e-8, "mu_x*u": 0.4, "|w_tot|*sin[roll]": 1e-5, "w2_3/w1": 1e-4, "u": -0.02}
    model = simple_model(
        AIRFRAME, THRUST, TORQUE, Fz={**every, "w1^2 + w2^2 + w3^2 + w4^2": -THRUST},
        Mx={"U_p": 1e-8, "u_r*q": 1e-6, "u_p*d_w_tot": 1e-9}, My={"U_q*mu_z": 1e-8, "d_w_tot*U_q": 1e-12},
    )  # fmt: skip
    effect, shares = catalogue()["rotor_effectiveness"], {"rotor2": -0.12, "rotor4": 0.2}
    extended = Model(extend(model, [(effect, shares)], vehicle_of(model, MASS), "extended", "a test"))
    acting = np.sqrt([1.0, 0.88, 1.0, 1.2])
    rng = np.random.default_rng(1)
    for state, speeds in zip(rng.standard_normal((20, 9)), rng.uniform(0.8, 1.2, (20, 4)) * HOVER):
        found, true = (np.concatenate(m.predict(state, w)) for m, w in ((extended, speeds), (model, acting * speeds)))
        np.testing.assert_allclose(found[2:5], true[2:5], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("factor", "airflow"), [(-0.05, 0.05), (-0.05, 0.0), (0.01, 0.004)])
def test_less_thrust_takes_its_inflow_along_or_leaves_it(factor, airflow):
    """Thinner air takes both; blades of another pitch leave what velocity makes of the rotors as it was."""
    model = simple_model(
        AIRFRAME, THRUST, TORQUE, Fz={"w1^2 + w2^2 + w3^2 + w4^2": -THRUST, "w_tot*w": -2e-5},
        Mx={"U_p": 1.7e-8, "w_tot*p": -4e-8}, My={"U_q": 1.6e-8, "w_tot*q": -5e-8}, Fx={"w_tot*u": -4e-6},
    )  # fmt: skip
    effect, vehicle = catalogue()["thrust_factor"], vehicle_of(model, MASS)
    sizes = {"factor": factor, "airflow": airflow}
    extended = Model(extend(model, [(effect, sizes)], vehicle, "extended", "a test"))
    rng = np.random.default_rng(3)
    columns = {name: rng.standard_normal(200) for name in (*"uvwpqr", "roll", "pitch")}
    columns |= {name: np.zeros(200) for name in (*"xyzt", "yaw")} | {f"w{i}_dot": np.zeros(200) for i in range(1, 5)}
    columns |= {f"w{i}": HOVER + 150.0 * rng.standard_normal(200) for i in range(1, 5)}
    flight = flown(model, columns)
    change = model_wrench(extended, columns) - flight.predicted
    made = columns_of(effect, flight, vehicle, {})
    first = sum(size * made[name] for name, size in sizes.items())
    scale = np.sqrt(np.mean(change[:, 2:5] ** 2, axis=0))
    np.testing.assert_allclose(first[:, 2:5] / scale, change[:, 2:5] / scale, atol=0.02)
    if factor == -airflow:
        np.testing.assert_allclose(change, factor * flight.thrust_wrench(flight.thrust), rtol=1e-9, atol=1e-12)
    else:
        assert np.abs(change[:, 2] - factor * flight.thrust_wrench(flight.thrust)[:, 2]).max() > 1e-3 * MASS


def test_a_trial_of_less_than_no_thrust_acts_as_the_weakest_rotor_that_is_physical():
    model = simple_model(AIRFRAME, THRUST, TORQUE, Mx={"U_p": 1e-8, "mu_x*w_avg": 0.1})
    effect = catalogue()["rotor_effectiveness"]

    def moment(share):
        extended = Model(extend(model, [(effect, {"rotor2": share})], vehicle_of(model, MASS), "extended", "a test"))
        return np.concatenate(extended.predict(np.ones(9), np.full(4, HOVER)))

    np.testing.assert_array_equal(moment(-1.4), moment(effect.parameters["rotor2"].low - 1.0))
    assert np.isfinite(moment(-1.4)).all()
