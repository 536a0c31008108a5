"""The quadrotor configuration: geometry, spins and faults."""

import math

import numpy as np
import pytest

from quasi.airframe import erpm100_to_rad_s, from_plain, read_airframe, to_plain
from quasi.errors import ConfigError

BEETLE = {
    "rotor config": {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3},
    "rotor1 rotation direction": "CW",
    "rotor radius": "0.0381",
    "b": "0.077",
    "optitrack marker cg offset": {"x": "0", "y": "-0.01", "z": "-0.048"},
    "idle RPM": "200",
    "max RPM": "2100",
    "moment of inertia": "[0.000865, 0, 0; 0, 0.00107, 0; 0, 0, 0.00171]",
    "mass": "0.433",
}


def test_sign_mask_is_that_of_the_reference_quadrotor():
    """The 4 x 3 mask of the reference code: left, front, and rotor-1 sense x (1, -1, -1, 1)."""
    frame = read_airframe(BEETLE, "beetle")
    np.testing.assert_array_equal(frame.left, [-1, -1, 1, 1])
    np.testing.assert_array_equal(frame.front, [-1, 1, -1, 1])
    np.testing.assert_array_equal(frame.spin, [1, -1, -1, 1])


def test_hubs_stand_at_the_arm_under_45_degrees():
    frame = read_airframe(BEETLE, "beetle")
    np.testing.assert_allclose(np.linalg.norm(frame.hubs, axis=1), 0.077)
    np.testing.assert_allclose(frame.hubs[3], 0.077 / math.sqrt(2) * np.array([1, -1, 0]))  # rotor 4: front left
    assert np.all(np.sign(frame.hubs[:, 0]) == frame.front)
    assert np.all(np.sign(-frame.hubs[:, 1]) == frame.left)


def test_hubs_stand_as_high_above_the_cg_as_configured():
    frame = read_airframe({**BEETLE, "rotor hub height": "0.012"}, "beetle")
    np.testing.assert_array_equal(frame.hubs[:, 2], -0.012)  # z points down
    np.testing.assert_array_equal(frame.hubs[:, :2], read_airframe(BEETLE, "beetle").hubs[:, :2])
    placed = {"rotor positions": {"1": [-0.05, 0.06, 0.002]}, "rotor hub height": 0.01}
    np.testing.assert_array_equal(read_airframe({**BEETLE, **placed}, "beetle").hubs[0], [-0.05, 0.06, 0.002])
    with pytest.raises(ConfigError, match="'rotor hub height' is 12 m, farther from the cg than the arms"):
        read_airframe({**BEETLE, "rotor hub height": 12}, "beetle")
    with pytest.raises(ConfigError, match="'rotor hub height' is 'high', expected a number"):
        read_airframe({**BEETLE, "rotor hub height": "high"}, "beetle")


def test_four_places_of_hubs_need_no_arm():
    places = {"1": [-0.08, 0.06, 0.01], "2": [0.06, 0.08, 0], "3": [-0.05, -0.12, 0], "4": [0.05, -0.12, 0]}
    without = {key: value for key, value in BEETLE.items() if key != "b"}
    assert read_airframe({**without, "rotor positions": places}, "x").arm == pytest.approx(0.115)  # 0.1 0.1 0.13 0.13
    assert read_airframe({**BEETLE, "rotor positions": places}, "x").arm == 0.077
    for few in ({}, {"rotor positions": {"1": places["1"]}}):
        with pytest.raises(ConfigError, match="x lacks the key .b. .* or each hub's place in 'rotor positions'"):
            read_airframe({**without, **few}, "x")


def test_spin_of_every_layout_is_alike_on_diagonals_and_opposite_beside():
    places = ["front left", "front right", "aft right", "aft left"]
    for turn in range(4):
        numbers = dict(zip(places, np.roll([1, 2, 3, 4], turn).tolist()))
        frame = read_airframe({**BEETLE, "rotor config": numbers, "rotor1 rotation direction": "CCW"}, "x")
        at = {p: frame.spin[n - 1] for p, n in numbers.items()}
        assert frame.spin[0] == -1
        assert at["front left"] == at["aft right"] == -at["front right"] == -at["aft left"]


def test_mass_of_the_logbook_takes_priority_and_plain_data_comes_back():
    frame = read_airframe(BEETLE, "beetle", mass=0.5)
    assert frame.mass == 0.5
    again = from_plain(to_plain(frame))
    assert to_plain(again) == to_plain(frame)


def test_logged_speed_of_14_poles():
    """1000 eRPM/100 of a 14-pole motor are 100000/7 rpm."""
    assert 1000 * erpm100_to_rad_s(14) == pytest.approx(100_000 / 7 * 2 * math.pi / 60)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rotor config": {"front left": 1}}, "'rotor config' must name a rotor"),
        ({"rotor config": dict.fromkeys(BEETLE["rotor config"], 1)}, "each of 1, 2, 3, 4 once"),
        ({"rotor1 rotation direction": "left"}, "expected 'CW' or 'CCW'"),
        ({"b": "long"}, "'b' is 'long', expected a number"),
        ({"b": "-0.1"}, "'b' must be a positive length"),
        ({"moment of inertia": "[1, 2; 3, 4]"}, "3 rows of 3 numbers"),
        ({"moment of inertia": "[1e-3, 0, 0; 0, -1e-3, 0; 0, 0, 1e-3]"}, "not positive definite"),
        ({"moment of inertia": "[1e-3, 1e-4, 0; 0, 1e-3, 0; 0, 0, 1e-3]"}, "not symmetric"),
        ({"motor poles": 7}, "even number of magnets"),
        ({"mass": "0"}, "positive number of kg"),
        ({"mass": "433"}, "radii of gyration of .* but the rotors reach 0.12 m"),
        ({"moment of inertia": "[865, 0, 0; 0, 1070, 0; 0, 0, 1710]"}, "'moment of inertia' and the mass of 0.433 kg"),
        ({"b": "77"}, "radii of gyration"),
        ({"rotor radius": "38.1"}, "'rotor radius' is 38.1 m, but the hubs are 0.077 m"),
        ({"optitrack marker cg offset": {"z": "-48"}}, "'optitrack marker cg offset' is 48 m from the cg"),
        ({"imu position": [0.0, 10.0, 0.0]}, "'imu position' is 10 m from the cg"),
        ({"idle RPM": "2100", "max RPM": "200"}, "'idle RPM' 2100 is not below 'max RPM' 200"),
    ],
)
def test_faults_name_file_and_key(change, message):
    with pytest.raises(ConfigError, match=message) as error:
        read_airframe({**BEETLE, **change}, "config/beetle.json")
    assert str(error.value).startswith("config/beetle.json")


def test_a_mass_that_is_known_elsewhere_is_not_held_against_the_inertia():
    light = {**BEETLE, "moment of inertia": "[1.4e-5, 0, 0; 0, 1.4e-5, 0; 0, 0, 2.2e-5]", "mass": "0.027"}
    assert np.isnan(read_airframe(light, "light", np.nan).mass)
    assert read_airframe(light, "light").mass == 0.027
    with pytest.raises(ConfigError, match="mass of 1 kg give radii of gyration"):
        read_airframe(light, "light", 1.0)
