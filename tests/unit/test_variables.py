"""Candidate variables against the printed definitions of the reference layout."""

import numpy as np
import pytest
from airframes import BEETLE

from quasi.airframe import read_airframe
from quasi.errors import ExpressionError
from quasi.terms.expressions import parse
from quasi.terms.variables import Variables, base_columns, derive_unit, known_names

CONFIG = {**BEETLE, "mass": 0.433}
HDBEETLE = read_airframe(CONFIG, "HDBeetle")
SPEEDS = {f"w{i}": np.array([700.0 + 31 * i, 900.0 - 7 * i**2]) for i in range(1, 5)}
MOTION = {"u": np.array([2.0, -1.0]), "v": np.array([-0.5, 0.4]), "w": np.array([0.1, -0.3])}


def variables(**more):
    return Variables({**SPEEDS, **MOTION, **more}, HDBEETLE, 880.0)


@pytest.mark.parametrize(("letter", "power"), [("u", 1), ("U", 2)])
def test_differential_thrusts_are_those_printed_for_the_hdbeetle(letter, power):
    fl, fr, al, ar = (SPEEDS[f"w{n}"] ** power for n in (4, 2, 3, 1))
    v = variables()
    np.testing.assert_allclose(v[f"{letter}_p"], (fl + al) - (fr + ar))
    np.testing.assert_allclose(v[f"{letter}_q"], (fl + fr) - (al + ar))
    np.testing.assert_allclose(v[f"{letter}_r"], (fl + ar) - (fr + al))  # rotor 1 turns clockwise: s = +1


def test_another_layout_moves_the_signs_with_the_rotors():
    layout = {"front left": 1, "front right": 2, "aft right": 3, "aft left": 4}
    frame = read_airframe({**CONFIG, "rotor config": layout, "rotor1 rotation direction": "CCW"}, "other")
    w1, w2, w3, w4 = (SPEEDS[f"w{i}"] for i in range(1, 5))
    v = Variables(SPEEDS, frame, None)
    np.testing.assert_allclose(v["u_p"], w1 + w4 - w2 - w3)
    np.testing.assert_allclose(v["u_q"], w1 + w2 - w3 - w4)
    np.testing.assert_allclose(v["u_r"], w2 + w4 - w1 - w3)


def test_sums_means_and_differences_follow_the_manual():
    v = variables()
    total = sum(SPEEDS.values())
    np.testing.assert_allclose(v["w_tot"], total)
    np.testing.assert_allclose(v["w_avg"], np.sqrt(np.mean([w**2 for w in SPEEDS.values()], axis=0)))
    np.testing.assert_allclose(v["d_w2"], SPEEDS["w2"] - 880.0)
    np.testing.assert_allclose(v["d_w_tot"], total - 4 * 880.0)
    np.testing.assert_allclose(v["w2_3"], SPEEDS["w3"] ** 2)
    np.testing.assert_allclose(v["mu_x"], MOTION["u"] / (v["w_avg"] * 0.0381))
    for one, other in (("wtot", "w_tot"), ("wavg", "w_avg"), ("d_wtot", "d_w_tot")):
        assert v[one] is v[other]


def test_bars_sines_and_cosines_of_every_name():
    v = variables(roll=np.array([0.3, -0.2]))
    np.testing.assert_allclose(v["|mu_y|"], np.abs(v["mu_y"]))
    np.testing.assert_allclose(v["|U_r|"], np.abs(v["U_r"]))
    np.testing.assert_allclose(v["sin[roll]"], np.sin([0.3, -0.2]))
    np.testing.assert_allclose(v["cos[roll]"], np.cos([0.3, -0.2]))


def test_angles_are_wrapped():
    turns = np.array([0.1 + 4 * np.pi, -0.2 - 2 * np.pi])
    np.testing.assert_allclose(variables(yaw=turns)["yaw"], [0.1, -0.2], atol=1e-12)


def test_velocity_through_the_air_takes_the_place_of_velocity_over_ground():
    v = variables(u_air=np.array([5.0, 6.0]))
    np.testing.assert_allclose(v["u"], [5.0, 6.0])
    np.testing.assert_allclose(v["mu_x"], np.array([5.0, 6.0]) / (v["w_avg"] * 0.0381))
    np.testing.assert_allclose(v["v"], MOTION["v"])
    # named outright they are the same variables, and where no wind is known over ground as well
    np.testing.assert_array_equal(v["|u_air|"], [5.0, 6.0])
    np.testing.assert_array_equal(v["v_air"], MOTION["v"])
    assert base_columns("|u_air|") == {"u"}


def test_rotor_accelerations_are_weighted_like_the_speeds():
    dots = {f"w{i}_dot": np.array([float(i), -2.0 * i]) for i in range(1, 5)}
    v = variables(**dots)
    np.testing.assert_allclose(v["u_r_dot"], sum(s * d for s, d in zip(HDBEETLE.spin, dots.values())))
    np.testing.assert_allclose(v["w_tot_dot"], sum(dots.values()))
    np.testing.assert_allclose(v["w3_dot"], dots["w3_dot"])


def test_further_columns_go_by_their_own_names():
    v = variables(battery_voltage=np.array([16.0, 15.0]), my_sensor=np.array([1.0, -2.0]))
    np.testing.assert_allclose(v["battery_voltage"], [16.0, 15.0])
    np.testing.assert_allclose(v["|my_sensor|"], [1.0, 2.0])


def test_an_unknown_name_and_a_missing_column_are_told_apart():
    with pytest.raises(ExpressionError, match=r"unknown variable 'U_x'.*did you mean '"):
        variables()["U_x"]
    with pytest.raises(ExpressionError, match="'mu_vin' needs the column 'v_in'"):
        variables()["mu_vin"]
    with pytest.raises(ExpressionError, match="hover speed"):
        Variables(SPEEDS, HDBEETLE, None)["d_w_tot"]


def test_known_lists_what_can_be_asked():
    known = variables().known()
    assert {"U_p", "w_tot", "mu_x", "u", "d_w1"} <= set(known)
    assert "mu_vin" not in known
    assert "u_r_dot" not in known
    v = variables()
    for name in known:
        assert len(v[name]) == 2
    assert "u" in known_names({"u_air": 0})


def test_base_columns_of_derived_names():
    assert base_columns("|mu_x|") == {"w1", "w2", "w3", "w4", "u"}
    assert base_columns("sin[roll]") == {"roll"}
    assert base_columns("wtot") == {"w1", "w2", "w3", "w4"}


@pytest.mark.parametrize(
    ("axis", "expression", "unit"),
    [
        ("Fx", "1", "N"),
        ("Fx", "u", "N s/m"),
        ("Fx", "(w_tot)*(u^(1.0))", "N s2/(m rad)"),
        ("Fz", "(w2_1 + w2_2 + w2_3 + w2_4)", "N s2/rad2"),
        ("Mx", "U_p", "N m s2/rad2"),
        ("Mz", "u_r_dot", "N m s2/rad"),
        ("Fx", "u*(u^2 + v^2)^0.5", "N s2/m2"),
        ("My", "u + p", "mixed"),
        ("Fx", "u^u", "mixed"),
        ("Fz", "cos[roll]", "N"),
    ],
)
def test_units_of_coefficients(axis, expression, unit):
    assert derive_unit(parse(expression), axis) == unit
