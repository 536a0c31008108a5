"""The quadrotor configuration: geometry, rotors, mass properties, IMU noise.

File format: the manual's listing 1 (values may be strings or numbers), plus optional keys of ours, each in
config/schemas/quadrotor.schema.json. Signs and numbering are fixed here and nowhere else.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from quasi.errors import ConfigError

ROTOR_POSITIONS = {"front left": (1, -1), "front right": (1, 1), "aft right": (-1, 1), "aft left": (-1, -1)}
DEFAULT_POLES = 14  # magnets of the common 12N14P motor; Betaflight's own default for motor_poles
# radii of gyration over the reach of the rotors: 0.11 to 0.54 by the configurations of data/ and examples/; grams taken
# for kilograms divide them by 30
LEAST_GYRATION = 0.05
FARTHEST = 10.0  # times that reach, of markers or IMU from the cg: no mast is longer; mm taken for m are far beyond


@dataclass(frozen=True)
class Airframe:
    """One quadrotor.

    mass kg; inertia (3, 3) kg m2 about the cg, body axes; radius m; arm m, hub to cg in the rotor plane;
    hubs (4, 3) m, rotor hubs from the cg, body FRD, in order of rotor number;
    spin (4,) +1 where the rotor turns clockwise seen from above (positive about body z), -1 otherwise;
    left, front (4,) +1 or -1: the rotor lies left / in front of the cg;
    poles: magnets of a motor, or None when the configuration does not say;
    idle_rpm, max_rpm in eRPM/100, or None;
    marker_offset (3,) m, of the marker centroid from the cg, body axes (marker = cg + R offset);
    noise {quantity: {"mean", "std"}} of the IMU at rest; positions {place: rotor number}, as configured.
    """

    name: str
    mass: float | None
    inertia: np.ndarray
    radius: float
    arm: float
    hubs: np.ndarray
    spin: np.ndarray
    poles: int | None = None
    idle_rpm: float | None = None
    max_rpm: float | None = None
    marker_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    noise: dict[str, dict[str, float]] = field(default_factory=dict)
    positions: dict[str, int] = field(default_factory=dict)
    rotor1_clockwise: bool = True

    @property
    def logged_to_rad_s(self) -> float | None:
        """Factor from the unit of idle_rpm and max_rpm (eRPM/100) to mechanical rad/s; None without a pole count."""
        return erpm100_to_rad_s(self.poles) if self.poles else None

    @property
    def left(self) -> np.ndarray:
        """+1 for rotors left of the cg, -1 for rotors right of it."""
        return np.where(self.hubs[:, 1] < 0, 1.0, -1.0)

    @property
    def front(self) -> np.ndarray:
        """+1 for rotors in front of the cg, -1 for rotors behind it."""
        return np.where(self.hubs[:, 0] > 0, 1.0, -1.0)


def number(config: Mapping[str, Any], key: str, where: str, default: float | None = None) -> float | None:
    """A number that the manual's files write as text or as a number."""
    value = config.get(key, default)
    if value is None or value == "":
        return default
    try:
        result = float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{where}: '{key}' is {value!r}, expected a number; correct it") from None
    if not math.isfinite(result):
        raise ConfigError(f"{where}: '{key}' is {value!r}, expected a finite number; correct it")
    return result


def parse_inertia(text: Any, where: str) -> np.ndarray:
    """Inertia tensor (3, 3), kg m2, from the manual's "[Ix, Ixy, Ixz; ...]" or a nested list.

    The off-diagonal entries are those of the tensor itself (minus the products of inertia).
    """
    if isinstance(text, str):
        rows = [r for r in text.strip().strip("[]").split(";") if r.strip()]
        try:
            matrix = np.array([[float(x) for x in re.split(r"[,\s]+", row.strip())] for row in rows])
        except ValueError:
            matrix = np.zeros((0, 0))
    else:
        try:
            matrix = np.array(text, float)
        except (TypeError, ValueError):
            matrix = np.zeros((0, 0))
    if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
        raise ConfigError(
            f"{where}: 'moment of inertia' is {text!r}, expected 3 rows of 3 numbers in kg m2 "
            'like "[8.65e-4, 0, 0; 0, 1.07e-3, 0; 0, 0, 1.71e-3]"'
        )
    if not np.allclose(matrix, matrix.T, atol=1e-12 + 1e-6 * abs(matrix).max()):
        raise ConfigError(
            f"{where}: 'moment of inertia' is not symmetric; entries mirrored about the diagonal must agree"
        )
    if np.min(np.linalg.eigvalsh(matrix)) <= 0:
        raise ConfigError(f"{where}: 'moment of inertia' is not positive definite; check its entries and units (kg m2)")
    return matrix


def read_airframe(config: Mapping[str, Any], where: str, mass: float | None = None) -> Airframe:
    """Build an Airframe from a quadrotor configuration.

    config  the file's content; where  its path, for messages; mass  kg, the logbook's, which takes priority, or NaN
    where it does not matter
    Raises ConfigError naming file and key.
    """
    layout = config.get("rotor config")
    if not isinstance(layout, Mapping) or set(layout) != set(ROTOR_POSITIONS):
        raise ConfigError(f"{where}: 'rotor config' must name a rotor for each of {', '.join(ROTOR_POSITIONS)}")
    try:
        numbers = {place: int(n) for place, n in layout.items()}
    except (TypeError, ValueError):
        raise ConfigError(f"{where}: 'rotor config' must hold whole numbers, found {dict(layout)}") from None
    if sorted(numbers.values()) != [1, 2, 3, 4]:
        raise ConfigError(
            f"{where}: 'rotor config' must use each of 1, 2, 3, 4 once, found {sorted(numbers.values())}; "
            "number the rotors as the flight controller does"
        )
    direction = str(config.get("rotor1 rotation direction", "")).strip().upper()
    if direction not in ("CW", "CCW"):
        raise ConfigError(f"{where}: 'rotor1 rotation direction' is {direction!r}, expected 'CW' or 'CCW'")

    positions = {int(key): [float(c) for c in place] for key, place in (config.get("rotor positions") or {}).items()}
    radii = [math.hypot(x, y) for x, y, _ in positions.values()]
    arm = number(config, "b", where, float(np.mean(radii)) if len(radii) == len(ROTOR_POSITIONS) else None)
    if arm is None:
        raise ConfigError(
            f"{where} lacks the key 'b' (distance from rotor hub to cg, in the rotor plane, m); "
            "add it, or each hub's place in 'rotor positions'"
        )
    radius = number(config, "rotor radius", where)
    for key, value in (("b", arm), ("rotor radius", radius)):
        if value is None or value <= 0:
            raise ConfigError(f"{where}: '{key}' must be a positive length in m, found {config.get(key)!r}")

    height = number(config, "rotor hub height", where, 0.0)
    if abs(height) > arm:
        raise ConfigError(
            f"{where}: 'rotor hub height' is {height:g} m, farther from the cg than the arms are long ({arm:g} m); "
            "give m, upwards positive, or each hub's place in 'rotor positions'"
        )
    hubs = np.zeros((4, 3))
    for place, (front, right) in ROTOR_POSITIONS.items():
        hubs[numbers[place] - 1] = *(arm / math.sqrt(2) * np.array([front, right])), -height
    for rotor, position in positions.items():
        hubs[rotor - 1] = position

    spin = np.zeros(4)
    diagonal = {"front left": 1, "aft right": 1, "front right": -1, "aft left": -1}
    of_rotor = {n: diagonal[place] for place, n in numbers.items()}
    for rotor in range(1, 5):
        spin[rotor - 1] = (1 if direction == "CW" else -1) * of_rotor[rotor] * of_rotor[1]
    for key, turn in (config.get("rotor rotation directions") or {}).items():
        spin[int(key) - 1] = 1.0 if str(turn).upper() == "CW" else -1.0

    offset = config.get("optitrack marker cg offset") or {}
    if mass is None:
        mass = number(config, "mass", where)
    if mass is not None and mass <= 0:
        raise ConfigError(f"{where}: 'mass' is {mass:g}, expected a positive number of kg")
    noise = {
        axis: {k: number(v, k, f"{where}, noise of {axis}", 0.0) for k in ("mean", "std")}
        for axis, v in (config.get("(estimated) imu sensor noise statistics") or {}).items()
    }
    made = Airframe(
        name=where,
        mass=mass,
        inertia=parse_inertia(config.get("moment of inertia"), where),
        radius=radius,
        arm=arm,
        hubs=hubs,
        spin=spin,
        poles=read_poles(config, where),
        idle_rpm=number(config, "idle RPM", where),
        max_rpm=number(config, "max RPM", where),
        marker_offset=np.array([number(offset, axis, f"{where}, marker offset", 0.0) for axis in "xyz"]),
        noise=noise,
        positions=numbers,
        rotor1_clockwise=direction == "CW",
    )
    _refuse_slips_of_units(made, config.get("imu position"))
    return made


def read_poles(config: Mapping[str, Any], where: str) -> int | None:
    """Magnets of a motor by a quadrotor configuration; None where it does not say. Raises ConfigError."""
    poles = number(config, "motor poles", where)
    if poles is not None and (poles < 2 or poles % 2):
        raise ConfigError(f"{where}: 'motor poles' is {poles:g}, expected an even number of magnets such as 12 or 14")
    return None if poles is None else int(poles)


def _refuse_slips_of_units(airframe: Airframe, imu: Any) -> None:
    """Raise ConfigError where lengths, mass and inertia of a quadrotor are not of one vehicle, or idle is not slow."""
    reach = float(np.max(np.linalg.norm(airframe.hubs, axis=1)))
    size = reach + airframe.radius
    if airframe.radius > 2.0 * reach:
        raise ConfigError(
            f"{airframe.name}: 'rotor radius' is {airframe.radius:g} m, but the hubs are {reach:g} m from the cg; give "
            "both in m"
        )
    places = {"optitrack marker cg offset": airframe.marker_offset, "imu position": read_triple(imu, "imu position")}
    for key, place in places.items():
        if place is not None and np.linalg.norm(place) > FARTHEST * size:
            raise ConfigError(
                f"{airframe.name}: '{key}' is {np.linalg.norm(place):g} m from the cg of a vehicle whose rotors reach "
                f"{size:.2g} m; give m"
            )
    if airframe.mass is not None and np.isfinite(airframe.mass):
        turning = np.sqrt(np.linalg.eigvalsh(airframe.inertia) / airframe.mass)
        if turning[-1] > size or turning[0] < LEAST_GYRATION * size:
            raise ConfigError(
                f"{airframe.name}: 'moment of inertia' and the mass of {airframe.mass:g} kg give radii of gyration of "
                f"{turning[0]:.2g} to {turning[-1]:.2g} m, but the rotors reach {size:.2g} m; check kg m2, kg (grams "
                "in the logbook) and m"
            )
    if airframe.idle_rpm is not None and airframe.max_rpm is not None and airframe.idle_rpm >= airframe.max_rpm:
        raise ConfigError(
            f"{airframe.name}: 'idle RPM' {airframe.idle_rpm:g} is not below 'max RPM' {airframe.max_rpm:g}; correct "
            "either"
        )


def read_triple(section: Any, key: str) -> np.ndarray | None:
    """A vector (3,), m, written as {"x", "y", "z"} or as a list."""
    if section in (None, "", {}, []):
        return None
    values = [section.get(axis, 0.0) for axis in "xyz"] if isinstance(section, Mapping) else section
    try:
        vector = np.array([float(v) for v in values])
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ConfigError(f"'{key}' is {section!r}, expected x, y and z in m")
    return vector


def erpm100_to_rad_s(poles: int) -> float:
    """Factor from a logged eRPM/100 to mechanical rad/s: 100 x 2 pi / 60 / (poles / 2)."""
    return 100.0 * 2.0 * math.pi / 60.0 / (poles / 2.0)


def to_plain(airframe: Airframe) -> dict[str, Any]:
    """The airframe as plain data, as it stands in a model; `from_plain` reads it back."""
    return {
        "name": airframe.name,
        "mass": airframe.mass,
        "inertia": airframe.inertia.tolist(),
        "rotor radius": airframe.radius,
        "b": airframe.arm,
        "hubs": airframe.hubs.tolist(),
        "spin": airframe.spin.tolist(),
        "motor poles": airframe.poles,
        "idle RPM": airframe.idle_rpm,
        "max RPM": airframe.max_rpm,
        "marker offset": airframe.marker_offset.tolist(),
        "noise": airframe.noise,
        "rotor config": airframe.positions,
        "rotor1 clockwise": airframe.rotor1_clockwise,
    }


def from_plain(plain: Mapping[str, Any]) -> Airframe:
    """Inverse of `to_plain`."""
    return Airframe(
        name=plain["name"],
        mass=plain["mass"],
        inertia=np.array(plain["inertia"], float),
        radius=plain["rotor radius"],
        arm=plain["b"],
        hubs=np.array(plain["hubs"], float),
        spin=np.array(plain["spin"], float),
        poles=plain["motor poles"],
        idle_rpm=plain["idle RPM"],
        max_rpm=plain["max RPM"],
        marker_offset=np.array(plain["marker offset"], float),
        noise=dict(plain["noise"]),
        positions=dict(plain["rotor config"]),
        rotor1_clockwise=plain["rotor1 clockwise"],
    )
