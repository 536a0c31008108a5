"""One flight as the search for causes sees it: measured and modelled wrench at the rate of the analysis.

Forces and angular accelerations that a cause is proportional to are taken from the model, not from the measurement:
the measurement is the regression's target, and a regressor that shares its noise would explain it (errors in
variables).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from quasi import attitude
from quasi.airframe import Airframe
from quasi.attitude import AIR_DENSITY, GRAVITY
from quasi.errors import DataError
from quasi.model.columns import ROTORS
from quasi.model.model import AXES, Model

RATE = 100.0  # Hz of the comparison of forces and moments, of drive residuals and of planned flights
REQUIRED = (*ROTORS, *(f"{w}_dot" for w in ROTORS), "p", "q", "r", "roll", "pitch", "yaw", "u", "v", "w", *AXES)
DELTAS = {"u": 0.2, "v": 0.2, "w": 0.2, "p": 0.05, "q": 0.05, "r": 0.05, **dict.fromkeys(ROTORS, 5.0)}  # of gradients
GAP_SAMPLES = 1.5  # samples: a longer step of time is a gap
PLACE = ("x", "y", "z")


def induced_in_hover(mass: float, radius: float) -> float:
    """Induced velocity of four rotors in hover by momentum theory, m/s; kg, m."""
    return float(np.sqrt(mass * GRAVITY / (2.0 * AIR_DENSITY * 4.0 * np.pi * radius**2)))


@dataclass(frozen=True)
class Evidence:
    """Valid rows of one filtered flight with what the model says about them. Body axes FRD, SI units.

    key, airframe, model, mass (kg, as the flight was processed), inertia (3, 3)
    columns   {name: (n,)} of the filtered flight
    measured  (n, 6) forces (N) and moments (N m); predicted  (n, 6) the model's, alike
    session   of the flight, see `quasi.gap.flights.sessions`; session_scales  how many times as far as usual healthy
              sessions of the vehicle lie apart, by weight and its place, and about yaw
    excluded  positions of axes on which the model explains nothing: they neither name causes nor judge them
    """

    key: str
    airframe: Airframe
    model: Model
    mass: float
    inertia: np.ndarray
    columns: Mapping[str, np.ndarray]
    measured: np.ndarray
    predicted: np.ndarray
    metadata: Mapping[str, object] = field(default_factory=dict)
    excluded: tuple[int, ...] = ()
    session: str = ""
    session_scales: tuple[float, float] = (1.0, 1.0)

    def __len__(self) -> int:
        return len(self.predicted)

    @property
    def residual(self) -> np.ndarray:
        """What the model leaves of the measured wrench (n, 6)."""
        return self.measured - self.predicted

    def heard(self, wrench: np.ndarray) -> np.ndarray:
        """A wrench (n, 6) or its columns (n, 6, P) without the excluded axes, which are 0."""
        return np.where(np.isin(np.arange(6), self.excluded).reshape(6, *[1] * (wrench.ndim - 2)), 0.0, wrench)

    @property
    def t(self) -> np.ndarray:
        """Time, s (n,)."""
        return self.columns["t"]

    @cached_property
    def breaks(self) -> np.ndarray:
        """(n,) bool: the first row, and each row that does not follow its predecessor without a gap."""
        steps = np.diff(self.t)
        return np.concatenate([[True], steps > GAP_SAMPLES * np.median(steps)])

    def take(self, *names: str) -> np.ndarray:
        """Columns side by side (n, len(names)). Raises DataError naming the missing one."""
        for name in names:
            if name not in self.columns:
                raise DataError(f"flight {self.key} has no column '{name}'")
        return np.stack([self.columns[name] for name in names], axis=1)

    @cached_property
    def speeds(self) -> np.ndarray:
        """Rotor speeds, rad/s (n, 4)."""
        return self.take(*ROTORS)

    @cached_property
    def spin_up(self) -> np.ndarray:
        """Rotor accelerations, rad/s2 (n, 4)."""
        return self.take(*(f"{w}_dot" for w in ROTORS))

    @cached_property
    def rates(self) -> np.ndarray:
        """Body rates, rad/s (n, 3)."""
        return self.take("p", "q", "r")

    @cached_property
    def velocity(self) -> np.ndarray:
        """Velocity through the air where the wind is known, over ground otherwise; body axes, m/s (n, 3)."""
        names = [f"{c}_air" if f"{c}_air" in self.columns else c for c in "uvw"]
        return self.take(*names)

    @cached_property
    def position(self) -> np.ndarray:
        """Earth NED, m (n, 3)."""
        return self.take(*PLACE)

    @cached_property
    def quaternion(self) -> np.ndarray:
        """Body to earth (n, 4)."""
        return attitude.from_euler(*(self.columns[c] for c in ("roll", "pitch", "yaw")))

    @cached_property
    def force(self) -> np.ndarray:
        """Aerodynamic force of the model, N (n, 3): mass x specific force."""
        if self.model.with_gravity:
            return self.predicted[:, :3]
        return self.predicted[:, :3] - self.mass * GRAVITY * self.down

    @cached_property
    def down(self) -> np.ndarray:
        """The earth's down direction in body axes (n, 3)."""
        return attitude.rotate_inverse(self.quaternion, np.array([0.0, 0.0, 1.0]))

    @cached_property
    def angular_acceleration(self) -> np.ndarray:
        """Of the model at the measured rates, rad/s2 (n, 3)."""
        return np.linalg.solve(self.inertia, (self.predicted[:, 3:] - self.gyroscopic(self.inertia)).T).T

    def gyroscopic(self, inertia: np.ndarray) -> np.ndarray:
        """omega x I omega, N m (n, 3)."""
        return np.cross(self.rates, self.rates @ inertia.T)

    @property
    def hubs(self) -> np.ndarray:
        """Rotor hubs from the cg, m (4, 3)."""
        return np.asarray(self.airframe.hubs, float)

    @property
    def spin(self) -> np.ndarray:
        """+1 for rotors that turn clockwise seen from above (4,)."""
        return np.asarray(self.airframe.spin, float)

    @cached_property
    def thrust(self) -> np.ndarray:
        """Thrust of each rotor by the simple model k W^2, N (n, 4)."""
        return self.model.document["simple model"]["kappaFz"]["value"] * self.speeds**2

    @cached_property
    def torque(self) -> np.ndarray:
        """Shaft torque of each rotor by the simple model, N m (n, 4), positive against its spin."""
        return abs(self.model.document["simple model"]["kappaMz"]["value"]) * self.speeds**2

    @property
    def hover_induced(self) -> float:
        """Induced velocity in hover by momentum theory, m/s."""
        return induced_in_hover(self.mass, self.airframe.radius)

    def at_hubs(self, forces: np.ndarray) -> np.ndarray:
        """Wrench (n, 6) about the cg of forces at the hubs (n, 4, 3), N, body axes."""
        return np.hstack([forces.sum(axis=1), np.cross(self.hubs[None], forces).sum(axis=1)])

    def upward(self, thrust: np.ndarray) -> np.ndarray:
        """Wrench (n, 6) of thrusts (n, 4), N, along -z at the hubs."""
        forces = np.zeros((len(self), 4, 3))
        forces[:, :, 2] = -thrust
        return self.at_hubs(forces)

    @cached_property
    def levers(self) -> np.ndarray:
        """Fz, Mx, My (4, 3) of 1 N of thrust of each rotor in the model, see `rotor_levers`."""
        return rotor_levers(self.model, self.mass)

    def thrust_wrench(self, thrust: np.ndarray) -> np.ndarray:
        """Wrench (n, 6) of additional thrusts (n, 4), N, by the levers of the model."""
        wrench = np.zeros((len(self), 6))
        wrench[:, 2:5] = thrust @ self.levers
        return wrench

    def only(self, axis: str, values: np.ndarray | float) -> np.ndarray:
        """Wrench (n, 6) with one component."""
        wrench = np.zeros((len(self), 6))
        wrench[:, AXES.index(axis)] = values
        return wrench

    def forces_only(self, forces: np.ndarray) -> np.ndarray:
        """Wrench (n, 6) of forces at the cg (n, 3)."""
        return np.hstack([forces, np.zeros((len(self), 3))])

    def moments_only(self, moments: np.ndarray) -> np.ndarray:
        """Wrench (n, 6) of pure moments (n, 3)."""
        return np.hstack([np.zeros((len(self), 3)), moments])

    def gradient(self, *names: str) -> np.ndarray:
        """Slope of the model's wrench by columns (n, 6, len(names)), by central differences."""
        return np.stack([self._slope(name) for name in names], axis=2)

    def _slope(self, name: str) -> np.ndarray:
        cache = self.__dict__.setdefault("_slopes", {})
        if name not in cache:
            here = f"{name}_air" if f"{name}_air" in self.columns else name
            step = DELTAS[name]
            sides = [model_wrench(self.model, {**self.columns, here: self.columns[here] + s * step}) for s in (1, -1)]
            cache[name] = (sides[0] - sides[1]) / (2.0 * step)
        return cache[name]


def rotor_levers(model: Model, mass: float) -> np.ndarray:
    """Fz, Mx and My (4, 3) that the model adds in hover where one rotor makes 1 N more thrust by its simple model.

    Units 1, m, m. A simple model with exact hub positions has (-1, -y, x). An identified model differs from that: an
    inertia that is configured too small shrinks all its moments, and noise of the rotor speeds shrinks its
    coefficients. A rotor that fails is balanced by the others, so that the residual holds what the *model* makes of
    the speeds. A cause that acts through thrust must therefore use the lever of the model.
    Fx and Fy are left out: terms of rotor speeds there come from an IMU away from the configured place, and are fitted
    anew once that is corrected.
    """
    thrust = float(model.document["simple model"]["kappaFz"]["value"])
    hover = float(np.sqrt(mass * GRAVITY / (4.0 * thrust)))
    speeds = np.full((8, 4), hover)
    speeds[range(4), range(4)] += DELTAS["w1"]
    speeds[range(4, 8), range(4)] -= DELTAS["w1"]
    forces, moments = model.predict(np.zeros((8, 12)), speeds)
    wrench = np.column_stack([forces[:, 2], moments[:, :2]])
    return (wrench[:4] - wrench[4:]) / (4.0 * hover * DELTAS["w1"] * thrust)


def model_wrench(model: Model, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """A model's forces and moments (n, 6) on a flight's columns, N and N m."""
    return model.predict_columns(columns)[list(AXES)].to_numpy()
