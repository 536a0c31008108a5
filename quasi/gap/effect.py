"""What a cause is: one file of quasi/gap/causes defines one EFFECT made of the parts here.

A cause that acts on the vehicle as a force or a moment is given as expressions, the same language as a candidate file:
for each parameter, what one unit of it adds to each axis. The search evaluates them on the flights, the extended model
keeps them as regressors, and so every simulation and export carries them. Causes of another kind (mass, wind, a
swinging load) give arrays and say themselves how they extend a model.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from quasi.attitude import AIR_DENSITY, GRAVITY
from quasi.errors import ConfigError
from quasi.gap.flights.evidence import Evidence, induced_in_hover, rotor_levers
from quasi.model.extensions import compute_flight_inertia, compute_flight_mass
from quasi.model.model import Model
from quasi.project.logbook import NAME_RULE, VALID_NAME

LEVELS = ("sensors", "drive", "forces")
PARTS_OF = ("any", "all", "alike", "first", "one", "led", "paired")
SCOPES = {"a": "airframe", "s": "session", "f": "flight"}
Terms = dict[str, str]  # axis: expression, N or N m per unit of a parameter


class Parameter(NamedTuple):
    """unit; neutral value, None where it is the model's own (mass, time constant); scope a, s or f; physical range.

    typical  deviation from neutral that a flight should be able to show, a number or made of a Vehicle; None where the
             parameter only accompanies others
    """

    unit: str
    neutral: float | None
    scope: str
    low: float
    high: float
    typical: "float | Callable[[Vehicle], float] | None" = None


class Sensor(NamedTuple):
    """What is known of a fault of a sensor, a mounting, a frame or a clock.

    spread   standard deviation of the parameters between healthy flights, None where healthy flights have none of it
    common   of what healthy set-ups have in all flights alike
    linear   size up to which its columns hold; a larger fault is corrected and looked at again. None: exact
    needs_attitude     whether only a captured attitude shows it
    without_attitude   spread where the attitude is estimated on board, None where it stays the same
    """

    spread: float | None = None
    common: float = 0.0
    linear: float | None = None
    needs_attitude: bool = False
    without_attitude: float | None = None


class Limits(NamedTuple):
    """What is physical of the deviations of a cause's fitted parameters.

    ranges  (low, high) of each; sums  (weights (m,), least): weighted sums of them that cannot be less
    """

    ranges: list[tuple[float, float]]
    sums: tuple[tuple[np.ndarray, float], ...] = ()


class Size(NamedTuple):
    """A figure as it is reported: value and standard error in a unit."""

    value: float
    std: float
    unit: str


class Room(NamedTuple):
    """Where walls and ceiling are: lowest and highest earth x and y, m; height of the ceiling, m, None without one."""

    north: tuple[float, float]
    east: tuple[float, float]
    height: float | None


def room_of(config: Mapping[str, Any] | None) -> Room | None:
    """The room of a configuration: {"north": [low, high], "east": [low, high], "height": m or left out}.

    Raises ConfigError for anything else.
    """
    if config is None:
        return None
    try:
        sides = [tuple(map(float, config[key])) for key in ("north", "east")]
        height = None if config.get("height") is None else float(config["height"])
        good = all(len(s) == 2 and -np.inf < s[0] < s[1] < np.inf for s in sides)
        good &= set(config) <= {"north", "east", "height"} and (height is None or 0.0 < height < np.inf)
    except (KeyError, TypeError, ValueError, AttributeError):
        good = False
    if not good:
        raise ConfigError(
            f"'room' is {config!r}, expected walls in m such as "
            '{"north": [-5, 5], "east": [-4, 4], "height": 6}; measure them from the origin of the motion capture'
        )
    return Room(sides[0], sides[1], height)


class Vehicle(NamedTuple):
    """Numbers that a cause's expressions are made of: SI units, hubs (4, 3) from the cg, spin (4,) as in Airframe."""

    hubs: np.ndarray
    spin: np.ndarray
    radius: float
    thrust: float  # N s2, of one rotor: T = thrust W^2
    torque: float  # N m s2, positive: Q = torque W^2 against the spin
    mass: float
    inertia: np.ndarray
    hover_induced: float  # m/s
    drawn: float  # N m s2: the part of the torque that goes into the flow and falls with the thrust, dQ = dT v/W
    inflow: float  # N s2/rad2: one rotor's thrust is off by inflow W dW/dt tau when its inflow lags by tau
    room: Room | None = None
    levers: np.ndarray | None = None  # (4, 3) Fz, Mx, My of 1 N of each rotor, see `rotor_levers`; geometry without

    @property
    def thrust_levers(self) -> np.ndarray:
        """Fz, Mx, My (4, 3) of 1 N of thrust of each rotor: the model's, else those of the hubs."""
        if self.levers is not None:
            return self.levers
        return np.column_stack([-np.ones(4), -self.hubs[:, 1], self.hubs[:, 0]])

    @property
    def weight(self) -> float:
        """N."""
        return self.mass * GRAVITY

    @property
    def hover_speed(self) -> float:
        """Of each rotor by the simple model, rad/s."""
        return float(np.sqrt(self.weight / (4.0 * self.thrust)))

    @property
    def arm(self) -> float:
        """Mean distance of a hub from the vertical through the cg, m."""
        return float(np.hypot(self.hubs[:, 0], self.hubs[:, 1]).mean())

    @property
    def flow(self) -> float:
        """Airspeed times the sum of rotor speeds in forward flight at half the hover's induced speed, m rad/s2."""
        return 2.0 * self.hover_induced * self.hover_speed


@dataclass(frozen=True)
class Extension:
    """What a cause with its parameters adds to a model.

    terms        {axis: [(expression, coefficient)]}
    airframe     constants replaced: "mass", "inertia", "cg offset"
    actuators    constants of rotors and their logs, see `quasi.model.extensions.read_rotor_constants`
    environment  "wind" (north, east, down), m/s
    states       parts with states of their own: "swinging load" (mass kg, length m), "inflow lag" (time constant s,
                 gain N s2); terms of the cause stand in for such a part where its states are not carried
    """

    terms: dict[str, list[tuple[str, float]]] = field(default_factory=dict)
    airframe: dict[str, object] = field(default_factory=dict)
    actuators: dict[str, object] = field(default_factory=dict)
    environment: dict[str, object] = field(default_factory=dict)
    states: dict[str, object] = field(default_factory=dict)


Values = Mapping[str, float]


@dataclass(frozen=True)
class Effect:
    """One cause.

    id, level ("sensors", "drive", "forces"), sentence (what happens, for a pilot), equation, source
    opposite      the sentence where the leading parameter is below neutral, if it is another one
    partial       the sentence where the leading parameter is not among those found, with {} for them, if it is another
    parameters    {name: Parameter}
    channels      axes or signals where it shows
    rivals        ids that it is confused with; tie_breaker  the manoeuvre that distinguishes them
    terms         vehicle -> {parameter: {axis: expression}} at the neutral values; or
    columns       (evidence, values) -> {parameter: (n, 6)}: slope of the measured minus modelled wrench by each
                  parameter at `values`; of a cause with terms as well, the fit takes these and the extension the terms
    nonlinear_terms  (vehicle, values) -> {axis: expression}, the whole effect where it is not in proportion to its
                  parameter; or
    full_effect   (evidence, vehicle, values) -> (n, 6), the same where no expression can say it
    corrected     (evidence, values) -> evidence as right instruments would have shown it, for a cause that makes them
                  err: what other causes do follows from the truth; it must be nonlinear
    extension     (values, vehicle, model) -> Extension, where terms do not say it
    parts         how parameters may be found: "any" one alone or all; "all" only together; "alike" together, with
                  one value or each its own; "first" the first few;
                  "one" a single one, the likeliest; "led" the first, and where that is there each other;
                  "paired" as "any" of the first half, each of the second half only where its partner is there
    exact         (deviations of the linear fit, vehicle as flown) -> deviations, where the cause divides by its own
                  parameter: the true mass or inertia would have turned the model's wrench into other accelerations
    apparent      its inverse: what the columns are multiplied by
    reported      (deviations, standard errors) -> {name: Size} to report instead of the parameters that are fitted
    starts        sizes of the one parameter of a cause whose slope at nothing hardly shows it: it is looked for by the
                  whole effect of the likeliest, see `quasi.gap.levels.forces.nonlinear`
    sized_by      axes whose measured wrench sizes it, where a model knows the others too badly; all where empty
    sums          vehicle -> [({parameter: weight}, least)]: weighted sums of the deviations that cannot be less
    always_tied_with     ids that differ from it by less than the errors of a model: always a tie with them
    absorbed_by_model    whether the model's own terms can mimic it exactly: only a change between flights shows it
    absent_when_healthy  whether a sound vehicle in still air, far from obstacles, has none of it: what a model's terms
                  lack of such a vehicle does not look like it
    form_uncertainty  share to which sizes are known at best, for its form follows what happens only roughly
    sensor        what is known of a fault of a sensor; only of sensors
    corrects      (part, quantity) of a calibration that import corrects it by, in the order of its parameters; finding
                  is stated, never fitted
    """

    id: str
    level: str
    sentence: str
    equation: str
    source: str
    parameters: dict[str, Parameter] = field(default_factory=dict)
    channels: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()
    tie_breaker: str = ""
    terms: Callable[[Vehicle], dict[str, Terms]] | None = None
    columns: Callable[[Evidence, Values], dict[str, np.ndarray]] | None = None
    nonlinear_terms: Callable[[Vehicle, Values], Terms] | None = None
    full_effect: Callable[[Evidence, Vehicle, Values], np.ndarray] | None = None
    corrected: Callable[[Evidence, Values], Evidence] | None = None
    extension: Callable[[Values, Vehicle, Model], Extension] | None = None
    exact: Callable[[Values, Vehicle], Values] | None = None
    apparent: Callable[[Values, Vehicle], Values] | None = None
    reported: Callable[[Values, Values], dict[str, Size]] | None = None
    starts: tuple[float, ...] = ()
    sized_by: tuple[str, ...] = ()
    sums: Callable[[Vehicle], list[tuple[Values, float]]] | None = None
    opposite: str = ""
    partial: str = ""
    parts: str = "any"
    always_tied_with: tuple[str, ...] = ()
    absorbed_by_model: bool = False
    absent_when_healthy: bool = False
    form_uncertainty: float = 0.0
    sensor: Sensor | None = None
    corrects: tuple[str, str] | None = None
    finding: bool = False

    def __post_init__(self) -> None:
        where = f"effect {self.id!r}"
        if not isinstance(self.id, str) or not VALID_NAME.fullmatch(self.id):
            raise ConfigError(f"{where}: the id may hold {NAME_RULE}, and no path; choose another")
        for word in ("sentence", "equation", "source", "opposite"):
            if not isinstance(getattr(self, word), str):
                raise ConfigError(f"{where}: {word} is {getattr(self, word)!r}, expected text")
        if self.level not in LEVELS:
            raise ConfigError(f"{where}: level is {self.level!r}, expected one of {', '.join(LEVELS)}")
        if self.parts not in PARTS_OF:
            raise ConfigError(f"{where}: parts is {self.parts!r}, expected one of {', '.join(PARTS_OF)}")
        for name, parameter in self.parameters.items():
            if not isinstance(parameter, Parameter):
                raise ConfigError(
                    f"{where}, parameter '{name}' is {parameter!r}, expected Parameter(unit, neutral, ...)"
                )
            if parameter.scope not in SCOPES or not parameter.low < parameter.high:
                raise ConfigError(
                    f"{where}, parameter '{name}': expected a scope of {', '.join(SCOPES)} and a range from low to "
                    f"high, got {parameter}"
                )
            neutral = parameter.neutral
            if neutral is not None and not parameter.low <= neutral <= parameter.high:
                raise ConfigError(
                    f"{where}, parameter '{name}': neutral is {neutral}, expected a value from {parameter.low} to "
                    f"{parameter.high}; a cause that is not there lies in its range too"
                )
        if self.starts and (not self.is_nonlinear or len(self.parameters) != 1 or not all(self.starts)):
            raise ConfigError(
                f"{where}: starts = {self.starts}, expected sizes other than 0 of its only parameter, and the whole "
                "effect ('full_effect' or 'nonlinear_terms')"
            )

    @property
    def is_nonlinear(self) -> bool:
        """Whether the effect is not in proportion to its parameters."""
        return self.nonlinear_terms is not None or self.full_effect is not None

    def happens(self, parameters: Values) -> str:
        """The sentence of parameters as they are reported: {name: value}, the first of them leading."""
        name = next(iter(self.parameters), None)
        if self.partial and name not in parameters:
            return self.partial.format(" and ".join(n.replace("rotor", "rotor ") for n in parameters))
        below = name in parameters and parameters[name] < (self.parameters[name].neutral or 0.0)
        return self.opposite if below and self.opposite else self.sentence

    @property
    def fitted(self) -> list[str]:
        """Parameters that a linear fit finds."""
        return list(self.parameters)

    def typical(self, vehicle: Vehicle) -> dict[str, float]:
        """{parameter: typical deviation from neutral} of the parameters that have one."""
        sizes = {name: p.typical for name, p in self.parameters.items() if p.typical is not None}
        return {name: float(size(vehicle) if callable(size) else size) for name, size in sizes.items()}

    def limits(self, vehicle: Vehicle) -> Limits:
        """What is physical of the fitted parameters' deviations; of masses and inertias, from the configured ones."""
        own = {"mass": vehicle.mass}
        own |= {f"I{a}{a}": float(vehicle.inertia[k, k]) for k, a in enumerate("xyz")}
        result = []
        for name in self.fitted:
            p = self.parameters[name]
            neutral = p.neutral if p.neutral is not None else 0.0
            low = p.low - neutral
            # nothing weighs less than nothing
            result.append((max(low, -own[name]) if p.neutral is None and name in own else low, p.high - neutral))
        sums = self.sums(vehicle) if self.sums else []
        return Limits(result, tuple((np.array([w.get(n, 0.0) for n in self.fitted]), least) for w, least in sums))


def vehicle_of(
    model: Model, mass: float | None = None, inertia: np.ndarray | None = None, room: Room | None = None
) -> Vehicle:
    """The numbers of a model's airframe and simple model. Raises ConfigError when the simple model is missing."""
    frame, simple = model.airframe, model.document.get("simple model", {})
    if "kappaFz" not in simple or "kappaMz" not in simple:
        raise ConfigError(f"model {model.id} has no simple model, which the search for causes needs; identify it anew")
    mass = frame.mass if mass is None else mass
    induced = float(np.sqrt(mass * GRAVITY / (8.0 * AIR_DENSITY * (np.pi * frame.radius**2))))
    return Vehicle(
        np.asarray(frame.hubs, float),
        np.asarray(frame.spin, float),
        float(frame.radius),
        float(simple["kappaFz"]["value"]),
        abs(float(simple["kappaMz"]["value"])),
        float(mass),
        np.asarray(frame.inertia if inertia is None else inertia, float),
        induced,
        _drawn(simple, mass, frame.radius),
        _inflow(model, mass, induced),
        room,
        rotor_levers(model, mass),
    )


def as_flown(vehicle: Vehicle, flights: Sequence[Evidence]) -> Vehicle:
    """The vehicle with its mass and inertia in these flights, as far as they are known: residuals may show others."""
    if not flights:
        return vehicle
    known = [mass for e in flights if (mass := compute_flight_mass(e.model, e.mass)) is not None]
    vehicle = vehicle._replace(inertia=np.mean([compute_flight_inertia(e.model, e.inertia) for e in flights], axis=0))
    return vehicle._replace(mass=float(np.mean(known))) if known else vehicle


def _drawn(simple: Mapping[str, Mapping[str, float]], mass: float, radius: float) -> float:
    thrust, torque = simple["kappaFz"]["value"], abs(simple["kappaMz"]["value"])
    return float(min(thrust * induced_in_hover(mass, radius) / np.sqrt(mass * GRAVITY / (4.0 * thrust)), torque))


def _inflow(model: Model, mass: float, induced: float) -> float:
    """What a lag of the inflow makes of a change of rotor speed, from the model's own response to climbing.

    Blade-element momentum theory of one hovering rotor: T = g (c W - V_climb - v) = 2 rho A v (v + V_climb). In
    equilibrium thrust falls with climb by s = g b/(2 (b + g)), b = 4 rho A v, so g = 2 s b/(b - 2 s); at an inflow that
    lags by tau, dT = g tau dv/dt with v in proportion to W. Source: Leishman, 2nd ed., 2006, sections 2.13 and 3.3.
    """
    speed = np.sqrt(mass * GRAVITY / (4.0 * float(model.document["simple model"]["kappaFz"]["value"])))
    state = np.zeros((2, 12))
    state[:, 5] = -0.3, 0.3
    forces, _ = model.predict(state, np.full((2, 4), speed))
    slope = float(forces[0, 2] - forces[1, 2]) / 0.6 / 4.0  # climbing makes Fz less negative
    stiff = 4.0 * AIR_DENSITY * (np.pi * model.airframe.radius**2) * induced
    slope = float(np.clip(slope, 0.05 * stiff, 0.4 * stiff))
    gain = 2.0 * slope * stiff / (stiff - 2.0 * slope)
    return float(gain * induced / speed**2)


def number(value: float) -> str:
    """A number as text of an expression, in brackets when negative."""
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


def hub_velocity(vehicle: Vehicle, rotor: int) -> tuple[str, str, str]:
    """Velocity of a hub through the air along body x, y, z, as expressions. rotor  0..3."""
    x, y, z = (number(v) for v in vehicle.hubs[rotor])
    return f"(u + q*{z} - r*{y})", f"(v + r*{x} - p*{z})", f"(w + p*{y} - q*{x})"


EARTH = {  # rows of the rotation from body to earth, 3-2-1 angles
    "x": ("cos[pitch]*cos[yaw]", "(sin[roll]*sin[pitch]*cos[yaw] - cos[roll]*sin[yaw])",
          "(cos[roll]*sin[pitch]*cos[yaw] + sin[roll]*sin[yaw])"),
    "y": ("cos[pitch]*sin[yaw]", "(sin[roll]*sin[pitch]*sin[yaw] + cos[roll]*cos[yaw])",
          "(cos[roll]*sin[pitch]*sin[yaw] - sin[roll]*cos[yaw])"),
    "z": ("(-sin[pitch])", "(sin[roll]*cos[pitch])", "(cos[roll]*cos[pitch])"),
}  # fmt: skip


def hub_position(vehicle: Vehicle, rotor: int) -> tuple[str, str, str]:
    """Place of a hub in the room, earth NED, m, as expressions."""
    arms = [number(v) for v in vehicle.hubs[rotor]]
    rows = [" + ".join(f"{part}*{arm}" for part, arm in zip(EARTH[axis], arms)) for axis in "xyz"]
    return tuple(f"({row} + {axis})" for row, axis in zip(rows, "xyz"))


def at_hubs(vehicle: Vehicle, forces: Sequence[tuple[str, str, str]]) -> Terms:
    """Expressions of the wrench about the cg of forces at the four hubs, each (x, y, z), "" for none."""
    parts: dict[str, list[str]] = {axis: [] for axis in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")}
    for (x, y, z), (fx, fy, fz) in zip(vehicle.hubs, forces):
        for axis, force in zip(("Fx", "Fy", "Fz"), (fx, fy, fz)):
            if force:
                parts[axis].append(f"({force})")
        for axis, pairs in {
            "Mx": ((y, fz), (-z, fy)),
            "My": ((z, fx), (-x, fz)),
            "Mz": ((x, fy), (-y, fx)),
        }.items():
            parts[axis] += [f"{number(arm)}*({force})" for arm, force in pairs if force and arm]
    return {axis: " + ".join(texts) for axis, texts in parts.items() if texts}


def thrust_wrench(vehicle: Vehicle, thrusts: Sequence[str]) -> Terms:
    """Expressions of the wrench of additional thrusts of the rotors, N, by the model's levers; "" for none."""
    parts: dict[str, list[str]] = {}
    for lever, thrust in zip(vehicle.thrust_levers, thrusts):
        for axis, arm in zip(("Fz", "Mx", "My"), lever):
            if thrust and arm:
                parts.setdefault(axis, []).append(f"{number(arm)}*({thrust})")
    return {axis: " + ".join(texts) for axis, texts in parts.items()}


def total(parts: Sequence[Terms]) -> Terms:
    """Sum of wrenches."""
    summed: dict[str, list[str]] = {}
    for part in parts:
        for axis, text in part.items():
            summed.setdefault(axis, []).append(text)
    return {axis: " + ".join(texts) for axis, texts in summed.items()}


def least(a: str, b: str) -> str:
    """min(a, b)."""
    return f"(0.5*({a} + {b} - (({a} - {b})^2)^0.5))"


def most(a: str, b: str) -> str:
    """max(a, b)."""
    return f"(0.5*({a} + {b} + (({a} - {b})^2)^0.5))"


def positive(text: str) -> str:
    """max(text, 0)."""
    return f"(0.5*(({text}) + (({text})^2)^0.5))"
