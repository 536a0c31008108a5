"""The physical constants of an identified quadrotor: what a simulator asks for, with standard errors.

A polynomial model holds no thrust coefficient: each constant is a sum of the model's own predictions about hover with
fixed weights (a value, a secant or a central difference). Predictions are linear in the coefficients, so that the
standard error of each constant follows from the coefficients' covariance without an approximation.

Body axes: x forward, y right, z down. Rotor i at (x, y, z) with thrust T upwards gives Mx = -y T, My = x T, and
Mz = -spin Q, spin being +1 for a rotor that turns clockwise seen from above.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.export.contents import check_exportable
from quasi.model.extensions import Actuators, actuators_of, drive_of
from quasi.model.hover import find_hover_position, find_hover_speed, list_usual_inputs
from quasi.model.model import AXES, Model
from quasi.terms.kernel import INPUTS

SCHEMA = "quasi.constants/1"
ROTOR_STEP = 1e-3  # of the hover speed, for central differences; Fz is smooth on that scale
SPEED = 1.0  # m/s, secants of drag between -SPEED and SPEED: the range of slow indoor flight
DAMPING_RATE = 1.0  # rad/s, secants of rate damping
TURN = 100.0  # rad/s2, central difference by rotor acceleration; terms in it are linear
HIGHEST_DRAG = 2.0  # arms: beyond it a moment by velocity is no drag above the rotors (nanodrone, blade flapping: 1.2)
SMALL = 1e-9  # of the thrust and torque in hover: what is less counts as zero


class Estimate(NamedTuple):
    """A constant and its standard error, which is NaN where the coefficients came without data."""

    value: float
    std: float


class Physical(NamedTuple):
    """Physical constants of a quadrotor about hover, SI, body axes x forward, y right, z down.

    mass kg; inertia (3, 3) kg m2; hover rad/s; hubs (4, 3) m as measured; spin (4,) +1 clockwise from above; radius m
    thrust        k_T, N/(rad/s)^2: thrust = k_T w^2 carries the weight at the hover speed
    torque        k_Q, N m/(rad/s)^2 of one rotor, about hover
    thrust_slope  dFz/d(w^2) about hover over k_T: 1 where thrust goes with the square of the speed
    roll, pitch   factors by which roll and pitch moments exceed those of k_T at the hubs as measured
    drag          (3,) N s/m, forces against u, v, w; damping (3,) N m s, moments against p, q, r
    rolling       N s, moments against the velocity: -dMx/du and -dMy/dv, their mean
    pitching      (2,) N s, moments across the velocity: dMy/du and -dMx/dv
    rotor_inertia kg m2, of the yaw moment by rotor acceleration; None where the model has no such term
    offsets       (3,) N m, moments at equal rotor speeds in hover
    rotors        time constants, delay, speed limits
    time_std      {"up", "down", "delay": standard errors (4,) s or None}
    command_map   {"coefficients", ...}: rotor speed over command 0..1, or None
    notes         what was assumed
    """

    name: str
    airframe: str
    mass: float
    inertia: np.ndarray
    hover: float
    hubs: np.ndarray
    spin: np.ndarray
    radius: float
    thrust: Estimate
    torque: Estimate
    thrust_slope: Estimate
    roll: Estimate
    pitch: Estimate
    drag: tuple[Estimate, ...]
    damping: tuple[Estimate, ...]
    rolling: Estimate
    pitching: tuple[Estimate, ...]
    rotor_inertia: Estimate | None
    offsets: np.ndarray
    rotors: Actuators
    time_std: Mapping[str, Any]
    command_map: Mapping[str, Any] | None
    notes: tuple[str, ...]

    @property
    def positions(self) -> np.ndarray:
        """(4, 3) m: where rotors of thrust k_T w^2 give the model's roll and pitch moments."""
        return self.hubs * np.array([self.pitch.value, self.roll.value, 1.0])

    @property
    def drag_heights(self) -> np.ndarray | None:
        """(2,) m above the centre of gravity where drag along x and y acts so that it gives the model's moments.

        None where there is no drag, or a height would be beyond HIGHEST_DRAG arms.
        """
        drag = np.array([d.value for d in self.drag[:2]])
        moment = np.array([m.value for m in self.pitching])
        if np.min(drag) <= 0.0 or np.any(np.abs(moment) > HIGHEST_DRAG * self.arm * drag):
            return None
        return moment / drag

    @property
    def drag_height(self) -> float | None:
        """The one height, m, that gives both moments in the mean where drag is the same along x and y; or None."""
        if self.drag_heights is None:
            return None
        return sum(m.value for m in self.pitching) / (self.drag[0].value + self.drag[1].value)

    @property
    def arm(self) -> float:
        """m, mean distance of the effective rotor positions from the centre of gravity, in the rotor plane."""
        return float(np.mean(np.hypot(*self.positions[:, :2].T)))

    @property
    def moment_ratio(self) -> float:
        """k_Q / k_T, m."""
        return self.torque.value / self.thrust.value

    @property
    def rotor_drag(self) -> float:
        """N s^2/m per rotor: horizontal drag = this x rotor speed x velocity, about hover; mean of both axes."""
        return 0.5 * (self.drag[0].value + self.drag[1].value) / (4.0 * self.hover)

    @property
    def rotor_rolling(self) -> float:
        """N s^2 per rotor: moment against the velocity = this x rotor speed x velocity, about hover."""
        return self.rolling.value / (4.0 * self.hover)

    @property
    def highest(self) -> float | None:
        """rad/s, or None where the airframe does not say."""
        return self.rotors.highest if math.isfinite(self.rotors.highest) else None


class Fact(NamedTuple):
    """One line of the table of constants: key, what it means, values, standard errors (None: unknown), unit."""

    key: str
    meaning: str
    values: tuple[float, ...]
    std: tuple[float | None, ...]
    unit: str


def physical_constants(model: Model) -> Physical:
    """Read a model about hover; see the head of the module.

    Raises ConfigError for a model that no export can carry, DataError for one that lacks its mass or an axis, cannot
    hover, or whose moments contradict the configured rotor positions or directions.
    """
    check_exportable(model)
    frame = model.airframe
    lacking = [axis for axis in AXES if axis not in model.axes]
    if frame.mass is None or lacking:
        what = "mass" if frame.mass is None else f"axis {lacking[0]}"
        remedy = "fill in 'Mass' in the logbook" if frame.mass is None else "identify all six axes"
        raise DataError(f"model {model.id} has no {what}, which a simulator needs; {remedy} and make the model anew")
    rotors = actuators_of(model)
    highest = rotors.highest if math.isfinite(rotors.highest) else None
    about = _Hover(model, find_hover_speed(model, highest))
    hover, hubs, spin = about.speed, np.asarray(frame.hubs, float), np.asarray(frame.spin, float)
    weight = float(frame.mass) * GRAVITY
    lift = about.level("Fz")
    upward = (weight if not model.with_gravity else 0.0) - lift.value
    thrust = Estimate(upward / (4.0 * hover**2), lift.std / (4.0 * hover**2))
    slope = about.by_squares("Fz", -0.25 * np.ones(4))
    torque = about.by_squares("Mz", -0.25 * spin)
    x, y = hubs[:, 0], hubs[:, 1]
    roll = about.by_squares("Mx", -y / float(y @ y))
    pitch = about.by_squares("My", x / float(x @ x))
    for what, found, keys in (
        ("roll", roll, "'rotor config'"),
        ("pitch", pitch, "'rotor config'"),
        ("yaw", torque, "'rotor1 rotation direction'"),
    ):
        if not found.value > SMALL * thrust.value:
            raise DataError(
                f"model {model.id}: its {what} moment by the rotor speeds is {found.value:.3g} per (rad/s)^2 where the "
                f"configured geometry expects a positive value; correct {keys} of the quadrotor configuration"
            )
    reaction = about.by_accelerations(0.25 * -spin)
    return Physical(
        name=model.id,
        airframe=frame.name,
        mass=float(frame.mass),
        inertia=np.asarray(frame.inertia, float),
        hover=hover,
        hubs=hubs,
        spin=spin,
        radius=float(frame.radius),
        thrust=thrust,
        torque=torque,
        thrust_slope=_scaled(slope, 1.0 / thrust.value),
        roll=_scaled(roll, 1.0 / thrust.value),
        pitch=_scaled(pitch, 1.0 / thrust.value),
        drag=tuple(about.secant(axis, name, SPEED, -1.0) for axis, name in zip(("Fx", "Fy", "Fz"), "uvw")),
        damping=tuple(about.secant(axis, name, DAMPING_RATE, -1.0) for axis, name in zip(("Mx", "My", "Mz"), "pqr")),
        rolling=_mean(about.secant("Mx", "u", SPEED, -1.0), about.secant("My", "v", SPEED, -1.0)),
        pitching=(about.secant("My", "u", SPEED, 1.0), about.secant("Mx", "v", SPEED, -1.0)),
        rotor_inertia=reaction if abs(reaction.value) > 0.0 else None,
        offsets=np.array([about.level(axis).value for axis in AXES[3:]]),
        rotors=rotors,
        time_std=_time_std(model),
        command_map=drive_of(model.document).get("command map"),
        notes=rotors.notes,
    )


class _Hover:
    """Weighted sums of a model's predictions about hover, with standard errors."""

    def __init__(self, model: Model, speed: float) -> None:
        self.model, self.speed = model, speed
        place = dict(zip("xyz", find_hover_position(model)))
        self.base = dict.fromkeys(INPUTS, 0.0) | place | dict(zip(model.inputs[20:], list_usual_inputs(model)))
        self.base |= {f"w{i}": speed for i in range(1, 5)}

    def level(self, axis: str) -> Estimate:
        """The prediction itself."""
        return self._sum(axis, [({}, 1.0)])

    def secant(self, axis: str, name: str, step: float, sign: float) -> Estimate:
        """sign x (prediction at +step less that at -step) / (2 step)."""
        return self._sum(axis, [({name: step}, 0.5 * sign / step), ({name: -step}, -0.5 * sign / step)])

    def by_squares(self, axis: str, weights: np.ndarray) -> Estimate:
        """Sum over rotors of weight x derivative by the square of the rotor's speed."""
        step = ROTOR_STEP * self.speed
        points = []
        for i, weight in enumerate(weights, 1):
            share = float(weight) / (4.0 * self.speed * step)
            points += [({f"w{i}": self.speed + step}, share), ({f"w{i}": self.speed - step}, -share)]
        return self._sum(axis, points)

    def by_accelerations(self, weights: np.ndarray) -> Estimate:
        """Sum over rotors of weight x derivative of Mz by the rotor's acceleration."""
        points = []
        for i, weight in enumerate(weights, 1):
            share = float(weight) / (2.0 * TURN)
            points += [({f"w{i}_dot": TURN}, share), ({f"w{i}_dot": -TURN}, -share)]
        return self._sum("Mz", points)

    def _sum(self, axis: str, points: list[tuple[dict[str, float], float]]) -> Estimate:
        columns = {n: np.array([change.get(n, value) for change, _ in points]) for n, value in self.base.items()}
        weights = np.array([weight for _, weight in points])
        part = self.model.document["axes"][axis]
        slopes = self.model.term_values(axis, columns) @ weights
        value = float(np.array([t["coefficient"] for t in part["terms"]]) @ slopes)
        estimated = slopes[[not t.get("given", False) for t in part["terms"]]]
        covariance = np.array(part["covariance"], float).reshape(len(estimated), len(estimated))
        variance = float(estimated @ covariance @ estimated)
        return Estimate(value, math.sqrt(max(variance, 0.0)) if part["n"] else math.nan)


def _scaled(estimate: Estimate, factor: float) -> Estimate:
    return Estimate(estimate.value * factor, estimate.std * abs(factor))


def _mean(a: Estimate, b: Estimate) -> Estimate:
    return Estimate(0.5 * (a.value + b.value), 0.5 * math.hypot(a.std, b.std))


def _time_std(model: Model) -> dict[str, Any]:
    known = drive_of(model.document)
    found = {}
    for name, keys in (
        ("up", ("time constants up", "time constants")),
        ("down", ("time constants down", "time constants up", "time constants")),
        ("delay", ("delay",)),
    ):
        section = next((known[k] for k in keys if isinstance(known.get(k), Mapping)), {})
        std = section.get("std")
        found[name] = None if std is None else np.broadcast_to(np.asarray(std, float), 4)
    return found


def facts(physical: Physical) -> list[Fact]:
    """The table of constants, in the order in which it is printed."""
    p = physical

    def one(key: str, meaning: str, estimate: Estimate, unit: str) -> Fact:
        return Fact(key, meaning, (estimate.value,), (_known(estimate.std),), unit)

    def exact(key: str, meaning: str, values: Any, unit: str) -> Fact:
        flat = tuple(float(v) for v in np.ravel(values))
        return Fact(key, meaning, flat, (None,) * len(flat), unit)

    def timed(key: str, meaning: str, values: np.ndarray, std: Any) -> Fact:
        return Fact(key, meaning, tuple(map(float, values)), _errors(std, len(values)), "s")

    ratio = p.torque.std / p.thrust.value  # the weight fixes k_T far better than the fit of Mz fixes k_Q
    rows = [
        exact("mass", "mass", p.mass, "kg"),
        exact("inertia", "inertia Ixx Iyy Izz", np.diag(p.inertia), "kg m2"),
        exact("products of inertia", "tensor entries Ixy Ixz Iyz", p.inertia[[0, 0, 1], [1, 2, 2]], "kg m2"),
        exact("hover speed", "rotor speed in hover", p.hover, "rad/s"),
        one("thrust coefficient", "k_T, thrust / speed^2 in hover", p.thrust, "N/(rad/s)^2"),
        one("torque coefficient", "k_Q, torque by speed^2 about hover", p.torque, "N m/(rad/s)^2"),
        one("moment ratio", "k_Q / k_T", Estimate(p.moment_ratio, ratio), "m"),
        one("thrust slope", "slope of thrust by speed^2 over k_T", p.thrust_slope, "-"),
        exact("arm", "effective distance rotor to centre of gravity", p.arm, "m"),
        one("roll lever", "roll moment over that of k_T at the hubs", p.roll, "-"),
        one("pitch lever", "pitch moment over that of k_T at the hubs", p.pitch, "-"),
        timed("time constants up", "rotors 1 to 4 speeding up", p.rotors.up, p.time_std["up"]),
        timed("time constants down", "rotors 1 to 4 slowing down", p.rotors.down, p.time_std["down"]),
        Fact("delay", "from command to rotor", (p.rotors.delay,), _errors(_mean_of(p.time_std["delay"]), 1), "s"),
        exact("speed limits", "lowest and highest commanded speed", (p.rotors.lowest, p.rotors.highest), "rad/s"),
        Fact("horizontal drag", "force against u v, secant at 1 m/s", *_columns(p.drag[:2]), "N/(m/s)"),
        Fact("vertical drag", "force against w, secant at 1 m/s", *_columns(p.drag[2:]), "N/(m/s)"),
        one("rotor drag", "horizontal drag of a rotor / (speed x velocity)",
            Estimate(p.rotor_drag, 0.5 * math.hypot(p.drag[0].std, p.drag[1].std) / (4.0 * p.hover)), "N s2/m"),
        Fact("rate damping", "moment against p q r, secant at 1 rad/s", *_columns(p.damping), "N m/(rad/s)"),
        one("rolling moment", "moment against the velocity, secant at 1 m/s", p.rolling, "N m/(m/s)"),
        Fact("pitching moment", "dMy/du and -dMx/dv, secant at 1 m/s", *_columns(p.pitching), "N m/(m/s)"),
    ]  # fmt: skip
    if p.rotor_inertia is not None:
        rows.append(one("rotor inertia", "yaw moment by rotor acceleration", p.rotor_inertia, "kg m2"))
    rows.append(exact("constant moments", "Mx My Mz at equal rotor speeds in hover", p.offsets, "N m"))
    return rows


def uncertain_constants(physical: Physical) -> dict[str, tuple[float, float, str]]:
    """{constant: (value, standard error, unit)} of those with a standard error; rotors one by one."""
    found = {}
    for fact in facts(physical):
        places = (
            ("x", "y", "z")
            if any(w in fact.key for w in ("drag", "damping", "pitching"))
            else range(1, len(fact.values) + 1)
        )
        for place, value, std in zip(places, fact.values, fact.std):
            if std is not None and std > 0.0:
                name = fact.key if len(fact.values) == 1 else f"{fact.key} {place}"
                found[name] = (value, std, fact.unit)
    return found


def constants_text(physical: Physical) -> str:
    """The table of constants as text."""
    lines = [
        f"Physical constants of model {physical.name} about hover; body axes x forward, y right, z down",
        f"{'constant':<22}{'value':<47}{'std. error':<36}{'unit':<16}meaning",
    ]
    for fact in facts(physical):
        values = " ".join(f"{v:.5g}" for v in fact.values)
        std = " ".join("-" if s is None else f"{s:.2g}" for s in fact.std)
        std = "-" if set(std.split()) == {"-"} else std
        lines.append(f"{fact.key:<22}{values:<47}{std:<36}{fact.unit:<16}{fact.meaning}")
    lines.append("rotor  x        y        z (m, as measured)     x        y (m, effective)   turns seen from above")
    for i, (hub, at, spin) in enumerate(zip(physical.hubs, physical.positions, physical.spin), 1):
        turn = "clockwise" if spin > 0 else "counter-clockwise"
        lines.append(f"{i:<7}" + "".join(f"{v:<+9.4f}" for v in hub) + f"{'':<14}{at[0]:<+9.4f}{at[1]:<+19.4f}{turn}")
    return "\n".join([*lines, *(f"note: {note}" for note in physical.notes)])


def constants_plain(physical: Physical) -> dict[str, Any]:
    """The table of constants as plain data ("quasi.constants/1"); unknown and infinite numbers are null."""

    def plain(value: float | None) -> float | None:
        return None if value is None or not math.isfinite(value) else value

    return {
        "schema": SCHEMA,
        "model": physical.name,
        "axes": "x forward, y right, z down",
        "constants": {
            f.key: {"value": [plain(v) for v in f.values], "std": [plain(s) for s in f.std], "unit": f.unit,
                    "meaning": f.meaning}
            for f in facts(physical)
        },
        "hubs": physical.hubs.tolist(),
        "effective positions": physical.positions.tolist(),
        "clockwise from above": [bool(s > 0) for s in physical.spin],
        "notes": list(physical.notes),
    }  # fmt: skip


def not_carried(physical: Physical, carried: frozenset[str]) -> list[str]:
    """What a format leaves out of a model, one line each with its numbers; zeros and unknown values are no loss."""
    neutral: dict[str, Callable[[float], bool]] = {
        "thrust slope": lambda v: abs(v - 1.0) < 1e-6,
        "speed limits": lambda v: v == 0.0 or not math.isfinite(v),
    }
    derived = {"moment ratio", "arm", "roll lever", "pitch lever", "hover speed", "rotor drag"}
    lines = []
    for fact in facts(physical):
        if fact.key in carried or fact.key in derived:
            continue
        is_neutral = neutral.get(fact.key, lambda v: abs(v) < 1e-15 or not math.isfinite(v))
        if not all(is_neutral(v) for v in fact.values):
            lines.append(f"{fact.key}: {' '.join(f'{v:.5g}' for v in fact.values)} {fact.unit} ({fact.meaning})")
    return [*lines, "terms of the model beyond these constants (see model.json)"]


def _known(std: float) -> float | None:
    return std if math.isfinite(std) else None


def _errors(std: Any, count: int) -> tuple[float | None, ...]:
    return (None,) * count if std is None else tuple(_known(float(s)) for s in np.ravel(std)[:count])


def _mean_of(std: Any) -> Any:
    return None if std is None else [float(np.mean(std))]


def _columns(estimates: tuple[Estimate, ...]) -> tuple[tuple[float, ...], tuple[float | None, ...]]:
    return tuple(e.value for e in estimates), tuple(_known(e.std) for e in estimates)
