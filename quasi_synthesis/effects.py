"""Effects that can be planted in a made flight: what a healthy vehicle and its base do not have.

A planted value is the truth: what the flight has beyond the vehicle's own physics where the neutral value is 0 (added)
or 1 (multiplied); absolute for those marked so. Signs and references: mass and inertia absolute; cg_offset = true minus
configured cg; lever arm = IMU minus configured cg; misalignments = the small rotation vector that carries the assumed
axes onto the true ones (sensor and marker in body axes, room in earth axes); bias = measured minus true; scale =
measured / true; delay positive when the named signal is late; clock rate positive when the on-board clock runs fast;
wind = velocity of the air.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from quasi import attitude
from quasi.errors import ConfigError, nearest
from quasi_synthesis.nuisance import Setup
from quasi_synthesis.vehicle import hover_factors


class Parameter(NamedTuple):
    """One parameter of an effect: unit, what an absent one means, range, and whether it replaces the vehicle's own."""

    unit: str
    neutral: float | None
    low: float
    high: float
    absolute: bool = False


Values = dict[str, float | None]
Change = Callable[[Setup, Values], Setup]


def _physics(setup: Setup, **changes: object) -> Setup:
    vehicle = setup.vehicle
    return setup._replace(vehicle=vehicle._replace(physics=vehicle.physics._replace(**changes)))


def _torque_factor(setup: Setup, v: Mapping[str, float]) -> Setup:
    """More profile drag of the blades, until a hovering rotor takes that torque."""
    rotor = setup.vehicle.physics
    whole, bare = (hover_factors(p)["torque"] for p in (rotor, rotor._replace(profile_drag=0.0)))
    return _physics(setup, profile_drag=rotor.profile_drag * (1.0 + (v["factor"] - 1.0) * whole / (whole - bare)))


def _drive(setup: Setup, **changes: object) -> Setup:
    vehicle = setup.vehicle
    return setup._replace(vehicle=vehicle._replace(drive=vehicle.drive._replace(**changes)))


def _adding(field: str, name: str) -> Change:
    """Add the parameter to one number of the physics."""
    return lambda s, v: _physics(s, **{field: getattr(s.vehicle.physics, field) + v[name]})


def _vector(values: Values, names: str = "x y z") -> np.ndarray:
    return np.array([values[n] for n in names.split()])


def _turn(axes: np.ndarray, values: Values) -> np.ndarray:
    return axes @ attitude.matrix(attitude.exponential(_vector(values, "roll pitch yaw")))


def _four(values: Values) -> np.ndarray:
    return np.array([values[f"rotor{i}"] for i in range(1, 5)])


def _tilt(setup: Setup, values: Values) -> Setup:
    """Turn each thrust axis about its arm's outward direction; a positive angle makes thrust yaw right (Mz > 0)."""
    p = setup.vehicle.physics
    arms = (p.hubs + setup.vehicle.cg_offset) * [1.0, 1.0, 0.0]
    arms /= np.linalg.norm(arms, axis=1, keepdims=True)
    return _physics(
        setup, thrust_axis=attitude.rotate(attitude.exponential(arms * _four(values)[:, None]), p.thrust_axis)
    )


def _mass(setup: Setup, values: Values) -> Setup:
    return _physics(setup, mass=values["mass"])


def _inertia(setup: Setup, values: Values) -> Setup:
    """Absolute moments Ixx.. and products Ixy.. = integral of x y dm (the tensor's entries are minus these)."""
    own = setup.vehicle.physics.inertia
    tensor = own.copy()
    for k, axis in enumerate("xyz"):
        if values[f"I{axis}{axis}"] is not None:
            tensor[k, k] = values[f"I{axis}{axis}"]
    for name, i, j in (("Ixy", 0, 1), ("Ixz", 0, 2), ("Iyz", 1, 2)):
        if values[name] is not None:
            tensor[i, j] = tensor[j, i] = -values[name]
    if np.min(np.linalg.eigvalsh(tensor)) <= 0:
        raise ConfigError(
            f"effect 'inertia' makes a tensor that is not positive definite ({tensor.tolist()}); lower the products"
        )
    return _physics(setup, inertia=tensor, inverse_inertia=np.linalg.inv(tensor))


def _cg(setup: Setup, values: Values) -> Setup:
    shift = _vector(values)
    p = setup.vehicle.physics
    setup = _physics(setup, hubs=p.hubs - shift, drag_centre=p.drag_centre - shift, leg=p.leg - [0.0, 0.0, shift[2]])
    return setup._replace(
        vehicle=setup.vehicle._replace(cg_offset=setup.vehicle.cg_offset + shift),
        inertial=setup.inertial._replace(position=setup.inertial.position - shift),
        capture=setup.capture._replace(offset=setup.capture.offset - shift),
    )


def _inertial(setup: Setup, **changes: object) -> Setup:
    return setup._replace(inertial=setup.inertial._replace(**changes))


def _body_drag(setup: Setup, values: Values) -> Setup:
    return _physics(setup, body_drag=setup.vehicle.physics.body_drag + values["c"])


def _motor_lag(setup: Setup, values: Values) -> Setup:
    return _physics(setup, lag_up=values["time_constant"], lag_down=values["time_constant"])


def _wind(setup: Setup, values: Values) -> Setup:
    return _physics(setup, wind=setup.vehicle.physics.wind + _vector(values, "north east down"))


def _payload(setup: Setup, values: Values) -> Setup:
    return _physics(setup, load_mass=values["mass"], load_length=values["length"])


def _capture(setup: Setup, **changes: object) -> Setup:
    return setup._replace(capture=setup.capture._replace(**changes))


def _thrust_curve(setup: Setup, values: Values) -> Setup:
    p = setup.vehicle.physics
    return _physics(
        setup, thrust_per_speed=p.thrust_per_speed + values["c1"], thrust_constant=p.thrust_constant + values["c0"]
    )


def _command_delay(setup: Setup, values: Values) -> Setup:
    return _drive(setup, command_delay=setup.vehicle.drive.command_delay + values["delay"])


def _shake(setup: Setup, values: Values) -> Setup:
    s = setup.inertial
    return _inertial(
        setup, gyro_vibration=s.gyro_vibration * values["level"], acc_vibration=s.acc_vibration * values["level"]
    )


def _unlisted(place: int) -> Change:
    """Set one of the effects that belong to no known cause."""

    def change(setup: Setup, values: Values) -> Setup:
        sizes = setup.vehicle.physics.unlisted.copy()
        sizes[place] += values["size"]
        return _physics(setup, unlisted=sizes)

    return change


def _rotors(unit: str, neutral: float, low: float, high: float) -> dict[str, Parameter]:
    return {f"rotor{i}": Parameter(unit, neutral, low, high) for i in range(1, 5)}


def _axes(names: str, unit: str, neutral: float, low: float, high: float) -> dict[str, Parameter]:
    return {n: Parameter(unit, neutral, low, high) for n in names.split()}


_INERTIA = {n: Parameter("kg m2", None, 1e-5, 0.05, True) for n in ("Ixx", "Iyy", "Izz")}
_INERTIA |= {n: Parameter("kg m2", None, -0.01, 0.01, True) for n in ("Ixy", "Ixz", "Iyz")}

OFFERED: dict[str, tuple[dict[str, Parameter], Change]] = {
    "rotor_drag": ({"k": Parameter("N s2/(m rad)", 0.0, -1e-3, 1e-3)}, _adding("h_force", "k")),
    "body_drag": ({"c": Parameter("N s2/m2", 0.0, -0.1, 0.5)}, _body_drag),
    "blade_flapping": ({"k": Parameter("N m s2/(m rad)", 0.0, -1e-5, 1e-5)}, _adding("flapping_moment", "k")),
    "translational_lift": ({"k": Parameter("N s2/m2", 0.0, -0.1, 0.1)}, _adding("translational_gain", "k")),
    "axial_inflow": ({"k": Parameter("N s2/(m rad)", 0.0, -1e-3, 1e-3)}, _adding("axial_gain", "k")),
    "vortex_ring": ({"depth": Parameter("1", 0.0, -1.0, 1.0)}, _adding("vortex_depth", "depth")),
    "ground_effect": ({"c": Parameter("1", 0.0, 0.0, 20.0)}, _adding("ground_gain", "c")),
    "proximity": ({"gain": Parameter("1", 0.0, -0.9, 0.9)}, _adding("proximity_gain", "gain")),
    "rotor_interference": ({"k": Parameter("1", 0.0, -0.5, 0.8)}, _adding("interference", "k")),
    "thrust_curve": (
        {"c1": Parameter("N s/rad", 0.0, -1e-3, 1e-3), "c0": Parameter("N", 0.0, -1.0, 1.0)},
        _thrust_curve,
    ),
    "thrust_factor": (
        {"factor": Parameter("1", 1.0, 0.3, 3.0)},
        lambda s, v: _physics(s, thrust_gain=s.vehicle.physics.thrust_gain * v["factor"]),
    ),
    "torque_factor": ({"factor": Parameter("1", 1.0, 0.3, 3.0)}, _torque_factor),
    "inflow_lag": ({"tau": Parameter("s", None, 0.0005, 0.1, True)}, lambda s, v: _physics(s, inflow_lag=v["tau"])),
    "battery_sag": (
        {"exponent": Parameter("1", None, 0.0, 3.0, True)},
        lambda s, v: _drive(s, sag_exponent=v["exponent"]),
    ),
    "motor_lag": ({"time_constant": Parameter("s", None, 0.002, 0.2, True)}, _motor_lag),
    "command_delay": ({"delay": Parameter("s", 0.0, 0.0, 0.1)}, _command_delay),
    "telemetry_delay": (
        {"delay": Parameter("s", 0.0, 0.0, 0.1)},
        lambda s, v: s._replace(telemetry=s.telemetry._replace(age=s.telemetry.age + v["delay"])),
    ),
    "actuator_saturation": (
        {"limit": Parameter("1", 1.0, 0.3, 1.0)},
        lambda s, v: _drive(s, command_limit=min(s.vehicle.drive.command_limit, v["limit"])),
    ),
    "rotor_speed_scale": (
        {"scale": Parameter("1", 1.0, 0.2, 5.0)},
        lambda s, v: s._replace(telemetry=s.telemetry._replace(scale=s.telemetry.scale * v["scale"])),
    ),
    "thrust_drift": ({"rate": Parameter("1/s", 0.0, -0.01, 0.01)}, _adding("thrust_drift", "rate")),
    "rotor_effectiveness": (
        _rotors("1", 1.0, 0.3, 2.0),
        lambda s, v: _physics(s, thrust_gain=s.vehicle.physics.thrust_gain * _four(v)),
    ),
    "rotor_tilt": (_rotors("rad", 0.0, -0.3, 0.3), _tilt),
    "rotor_gyroscopic": ({"inertia": Parameter("kg m2", 0.0, -1e-4, 1e-4)}, _adding("gyroscopic_inertia", "inertia")),
    "rotor_acceleration_torque": (
        {"inertia": Parameter("kg m2", 0.0, -1e-4, 1e-4)},
        _adding("rotor_inertia", "inertia"),
    ),
    "mass": ({"mass": Parameter("kg", None, 0.1, 2.0, True)}, _mass),
    "inertia": (_INERTIA, _inertia),
    "cg_offset": (_axes("x y z", "m", 0.0, -0.04, 0.04), _cg),
    "imu_lever_arm": (
        _axes("x y z", "m", 0.0, -0.1, 0.1),
        lambda s, v: _inertial(s, position=s.inertial.position + _vector(v)),
    ),
    "marker_offset": (
        _axes("x y z", "m", 0.0, -0.1, 0.1),
        lambda s, v: _capture(s, offset=s.capture.offset + _vector(v)),
    ),
    "imu_misalignment": (
        _axes("roll pitch yaw", "rad", 0.0, -0.5, 0.5),
        lambda s, v: _inertial(s, axes=_turn(s.inertial.axes, v)),
    ),
    "accelerometer_bias": (
        _axes("x y z", "m/s2", 0.0, -5.0, 5.0),
        lambda s, v: _inertial(s, acc_bias=s.inertial.acc_bias + _vector(v)),
    ),
    "accelerometer_scale": (
        _axes("x y z", "1", 1.0, 0.5, 2.0),
        lambda s, v: _inertial(s, acc_scale=s.inertial.acc_scale * _vector(v)),
    ),
    "gyro_bias": (
        _axes("x y z", "rad/s", 0.0, -1.0, 1.0),
        lambda s, v: _inertial(s, gyro_bias=s.inertial.gyro_bias + _vector(v)),
    ),
    "gyro_scale": (
        _axes("x y z", "1", 1.0, 0.5, 2.0),
        lambda s, v: _inertial(s, gyro_scale=s.inertial.gyro_scale * _vector(v)),
    ),
    "mocap_misalignment": (
        _axes("roll pitch yaw", "rad", 0.0, -0.5, 0.5),
        lambda s, v: _capture(s, body_turn=s.capture.body_turn + _vector(v, "roll pitch yaw")),
    ),
    "room_tilt": (
        _axes("roll pitch", "rad", 0.0, -0.3, 0.3),
        lambda s, v: _capture(s, room_turn=s.capture.room_turn + [v["roll"], v["pitch"], 0.0]),
    ),
    "mocap_delay": (
        {"delay": Parameter("s", 0.0, -0.05, 0.1)},
        lambda s, v: _capture(s, rotation_delay=s.capture.rotation_delay + v["delay"]),
    ),
    "clock_drift": (
        {"rate": Parameter("s/s", 0.0, -0.05, 0.05)},
        lambda s, v: s._replace(clock_rate=s.clock_rate + v["rate"]),
    ),
    "timestamp_fault": (
        {"gaps": Parameter("1", 0.0, 0.0, 50.0)},
        lambda s, v: s._replace(log_gaps=s.log_gaps + int(v["gaps"])),
    ),
    "wind": (_axes("north east down", "m/s", 0.0, -15.0, 15.0), _wind),
    "gusts": (
        {"std": Parameter("m/s", 0.0, 0.0, 5.0)},
        lambda s, v: s._replace(gust=float(np.hypot(s.gust, v["std"]))),
    ),
    "payload_swing": (
        {"mass": Parameter("kg", None, 0.002, 0.2, True), "length": Parameter("m", None, 0.05, 2.0, True)},
        _payload,
    ),
    "tether": ({"k": Parameter("N/m", 0.0, 0.0, 5.0)}, _adding("tether", "k")),
    "vibration": ({"level": Parameter("1", 1.0, 0.0, 20.0)}, _shake),
}


# What belongs to no known cause, to see that nothing is called by a wrong name. Not offered to campaigns by message.
UNLISTED: dict[str, tuple[dict[str, Parameter], Change]] = {
    "unlisted_heading": ({"size": Parameter("1", 0.0, -0.5, 0.5)}, _unlisted(0)),
    "unlisted_height": ({"size": Parameter("N/m", 0.0, -2.0, 2.0)}, _unlisted(1)),
    "unlisted_beat": ({"size": Parameter("N", 0.0, -2.0, 2.0)}, _unlisted(2)),
    "unlisted_fan": ({"size": Parameter("N", 0.0, -4.0, 4.0)}, _unlisted(3)),
    "unlisted_twist": ({"size": Parameter("N m/m", 0.0, -0.05, 0.05)}, _unlisted(4)),
    "unlisted_brake": ({"size": Parameter("N m s3/rad3", 0.0, -0.002, 0.002)}, _unlisted(5)),
    "unlisted_shift": ({"size": Parameter("N m", 0.0, -0.1, 0.1)}, _unlisted(6)),
}
_ALL = OFFERED | UNLISTED


def check(effects: Mapping[str, Mapping[str, float]], where: str) -> dict[str, Values]:
    """Effects with every parameter filled in.

    effects  {id: {parameter: value}}; where  the campaign and flight, for messages.
    Raises ConfigError naming an unknown id or parameter and the nearest known one, or a value out of its range.
    """
    whole: dict[str, Values] = {}
    for name, given in effects.items():
        if name not in _ALL:
            raise ConfigError(f"{where}: effect '{name}' is not offered by made flights{nearest(name, OFFERED)}")
        parameters = _ALL[name][0]
        if not isinstance(given, Mapping):
            raise ConfigError(
                f"{where}: effect '{name}' is {given!r}, expected parameters such as "
                f'{{"{next(iter(parameters))}": 0.1}}'
            )
        for key, value in given.items():
            if key not in parameters:
                raise ConfigError(f"{where}: effect '{name}' has no parameter '{key}'{nearest(key, parameters)}")
            p = parameters[key]
            if isinstance(value, bool) or not isinstance(value, int | float) or not p.low <= value <= p.high:
                raise ConfigError(
                    f"{where}: parameter '{key}' of effect '{name}' is {value!r}, "
                    f"expected a number from {p.low:g} to {p.high:g} {p.unit}"
                )
        missing = [k for k, p in parameters.items() if p.neutral is None and k not in given and name != "inertia"]
        if missing:
            raise ConfigError(
                f"{where}: effect '{name}' lacks its parameter '{missing[0]}' ({parameters[missing[0]].unit})"
            )
        whole[name] = {k: float(given[k]) if k in given else p.neutral for k, p in parameters.items()}
    return whole


def plant(setup: Setup, effects: Mapping[str, Values]) -> Setup:
    """Apply checked effects to one flight's set-up."""
    for name, values in effects.items():
        setup = _ALL[name][1](setup, dict(values))
    return setup
