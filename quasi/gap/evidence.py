"""One flight as the search for causes sees it: measured wrench beside the model's, at the rate of the analysis.

Forces and angular accelerations that a cause is proportional to are taken from the model, not from the measurement:
the measurement is the regression's target, and a regressor that shares its noise would explain it (errors in
variables).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from quasi import attitude
from quasi.airframe import Airframe
from quasi.attitude import AIR_DENSITY, GRAVITY
from quasi.errors import ConfigError, DataError, ExpressionError
from quasi.gap.instruments import shown
from quasi.standalone.extensions import put_right
from quasi.standalone.model import AXES, ROTORS, Model

NEEDED = (*ROTORS, *(f"{w}_dot" for w in ROTORS), "p", "q", "r", "roll", "pitch", "yaw", "u", "v", "w", *AXES)
STEPS = {"u": 0.2, "v": 0.2, "w": 0.2, "p": 0.05, "q": 0.05, "r": 0.05, **dict.fromkeys(ROTORS, 5.0)}  # of gradients
HEAVIER = 2.0  # a factor of mass that no load explains
ELSEWHERE = 0.5  # of the arm: rotors are numbered otherwise, or it is another frame
SECOND = 1.0  # s: what low-pass filters and whiteners leave of less is nothing
APART = 1.5  # samples: a longer step of time is a gap
SENSELESS = 1e4  # times the weight, and the weight at the arm: no model of a quadrotor means that
UNTOLD = ("none", "standing still")  # sources of a flight's velocity or position that tell nothing of it in flight
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

    def __len__(self) -> int:
        return len(self.predicted)

    @property
    def residual(self) -> np.ndarray:
        """What the model leaves of the measured wrench (n, 6)."""
        return self.measured - self.predicted

    @property
    def t(self) -> np.ndarray:
        """Time, s (n,)."""
        return self.columns["t"]

    @cached_property
    def breaks(self) -> np.ndarray:
        """(n,) bool: the first row, and each row that does not follow its predecessor without a gap."""
        steps = np.diff(self.t)
        return np.concatenate([[True], steps > APART * np.median(steps)])

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
    def hub_velocity(self) -> np.ndarray:
        """Velocity of each hub through the air, body axes, m/s (n, 4, 3)."""
        return self.velocity[:, None] + np.cross(self.rates[:, None], self.hubs[None])

    @cached_property
    def hub_height(self) -> np.ndarray:
        """Height of each hub above the floor (earth z = 0), m (n, 4)."""
        turned = attitude.rotate(self.quaternion[:, None], np.broadcast_to(self.hubs, (len(self), 4, 3)))
        return -(self.position[:, 2:3] + turned[..., 2])

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

    def predicted_with(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Wrench of the model (n, 6) with some of the flight's columns replaced."""
        return self.with_columns(columns).predicted

    def with_columns(self, columns: Mapping[str, np.ndarray]) -> "Evidence":
        """The flight with some of its columns replaced, and what the model makes of them."""
        merged = {**self.columns, **columns}
        return _as_shown(replace(self, columns=merged, predicted=_predict(self.model, merged)))

    def _slope(self, name: str) -> np.ndarray:
        cache = self.__dict__.setdefault("_slopes", {})
        if name not in cache:
            here = f"{name}_air" if f"{name}_air" in self.columns else name
            step = STEPS[name]
            sides = [_predict(self.model, {**self.columns, here: self.columns[here] + s * step}) for s in (1, -1)]
            cache[name] = (sides[0] - sides[1]) / (2.0 * step)
        return cache[name]


def _as_shown(flight: Evidence) -> Evidence:
    """The flight with the wrench that its instruments would show, where the model was extended before."""
    if not flight.model.document.get("extensions"):
        return flight
    return replace(flight, predicted=shown(flight.model, flight.model, flight))


def _predict(model: Model, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    predicted = model.predict_columns(columns)
    return predicted[list(AXES)].to_numpy()


def refuse_another_vehicle(where: str, airframe: Airframe, model: Model) -> None:
    """Raise ConfigError where a flight cannot be of the quadrotor that the model describes.

    Loads, batteries and shifted rotors are what a comparison looks for; this is about mistaken configurations.
    """
    ours, head = model.airframe, f"{where} is not of the quadrotor that model {model.id} describes"
    remedy = "compare it with its own model, or correct the quadrotor's configuration or 'Mass' in the logbook"
    if ours.mass and airframe.mass and not 1.0 / HEAVIER < airframe.mass / ours.mass < HEAVIER:
        raise ConfigError(
            f"{head}: its mass is {airframe.mass:g} kg, the model's {ours.mass:g} kg, expected less than a factor of "
            f"{HEAVIER:g} between them; {remedy}"
        )
    far = np.linalg.norm(np.asarray(airframe.hubs) - np.asarray(ours.hubs), axis=1)
    rotor = int(np.argmax(far))
    if far[rotor] > ELSEWHERE * ours.arm:
        raise ConfigError(
            f"{head}: rotor {rotor + 1} lies {far[rotor]:.3f} m from where the model has it, expected less than "
            f"{ELSEWHERE * ours.arm:.3f} m; {remedy}"
        )
    if not np.array_equal(np.sign(airframe.spin), np.sign(ours.spin)):
        raise ConfigError(f"{head}: its rotors turn the other way; {remedy}")


def measured_motion(metadata: Mapping[str, Any]) -> tuple[bool, bool]:
    """Whether something but the accelerometer told a filtered flight's velocity, and its position.

    metadata  of the flight; what it does not say is taken for measured
    """
    used = (metadata.get("noise") or {}).get("measurements")
    if used is None:  # the Kalman filter was not run: states are those imported, and what was not imported is zero
        imported = metadata.get("imported") or {}
        return imported.get("velocity source") not in UNTOLD, imported.get("position source") not in UNTOLD
    speed, place = (used.get(kind, {}).get("source", "none") not in UNTOLD for kind in ("velocity", "position"))
    return speed or place, place


def gather_all(
    flights: Mapping[str, tuple[pd.DataFrame, Mapping[str, Any], Airframe]], model: Model, rate: float
) -> tuple[dict[str, Evidence], list[str]]:
    """Evidence of the flights that can be compared, by key, and a sentence on each that cannot; see `gather`.

    flights  {key: filtered flight, its metadata, airframe}
    Where some flight's position was not measured it is used of none: a height that drifts is no height, and what only
    some flights know cannot be asked of all. Raises DataError when no flight can be compared, unless it is for want of
    a velocity: then nothing is wrong with model and flights, and the levels below can be asked.
    """
    found, lost, drifting, nowhere = {}, [], False, []
    for key, (table, metadata, airframe) in flights.items():
        speed, place = measured_motion(metadata)
        if not speed:
            drifting = True
            lost.append(
                f"flight {key} has no source of velocity but the accelerometer, which drifts, and forces and moments "
                "depend on it; fly it with motion capture, or bring velocity or position in its log"
            )
            continue
        try:
            known = table if place else table.drop(columns=list(PLACE), errors="ignore")
            found[key] = gather(key, known, metadata, airframe, model, rate)
            nowhere += [] if place else [key]
        except DataError as error:
            lost.append(str(error))
    if not found and not drifting:
        raise DataError(f"no flight can be compared with model {model.id}: {lost[0]}")
    lost = [f"{said}; it is left out of the comparison of forces and moments" for said in lost]
    if nowhere:
        found = {
            key: replace(one, columns={n: v for n, v in one.columns.items() if n not in PLACE})
            for key, one in found.items()
        }
        lost.append(
            f"flight {nowhere[0]} has no source of position (what its velocity adds up to drifts); what depends on "
            "height or place is not asked"
        )
    return found, lost


def gather(
    key: str, flight: pd.DataFrame, metadata: Mapping[str, object], airframe: Airframe, model: Model, rate: float
) -> Evidence:
    """Evidence of a filtered flight, thinned to about `rate` Hz.

    flight  filtered, of the kind (with or without gravity) that the model predicts; its forces are band-limited, so
            that thinning to 2.5 times their cut-off loses nothing
    Rows that are not valid or hold missing values are left out. Raises DataError when a column is missing or less than
    a second is left, ConfigError for a model without some of the six axes.
    """
    unknown = [a for a in AXES if a not in model.axes]
    if unknown:
        raise ConfigError(
            f"model {model.id} says nothing of {', '.join(unknown)}, which a comparison with flights needs; identify "
            "all six axes"
        )
    if model.normalisation:
        raise ConfigError(
            f"model {model.id} is normalised; a comparison with flights needs one that was identified with 'normalize "
            "data' false"
        )
    missing = [c for c in NEEDED if c not in flight]
    if missing:
        raise DataError(f"flight {key} has no column '{missing[0]}', which a comparison with a model needs")
    sampling = 1.0 / float(np.median(np.diff(flight["t"].to_numpy())))
    every = max(int(sampling // rate), 1)
    good = np.isfinite(flight[list(NEEDED)].to_numpy()).all(axis=1)
    if "valid" in flight:
        good &= flight["valid"].to_numpy() > 0.5
    rows = np.flatnonzero(good)
    rows = rows[rows % every == 0]
    if len(rows) * every < SECOND * sampling:
        raise DataError(f"flight {key} has {len(rows) * every / sampling:.1f} s of valid data, expected more than 1 s")
    ends = np.flatnonzero(np.append(np.diff(rows) > APART * every, True))
    longest = int(np.max(np.diff(ends, prepend=-1))) * every / sampling
    if longest < SECOND:
        raise DataError(
            f"flight {key} has {longest:.1f} s of valid data without a gap, expected more than {SECOND:g} s; fly longer"
        )
    columns = {
        name: flight[name].to_numpy(float)[rows] for name in flight if pd.api.types.is_numeric_dtype(flight[name])
    }
    columns = put_right(model, columns)
    try:
        predicted = _predict(model, columns)
    except ExpressionError as error:
        raise DataError(f"flight {key} cannot be compared with model {model.id}: {error}") from None
    still = [name for name in ROTORS if not np.ptp(columns[name])]
    if still:
        raise DataError(
            f"flight {key} holds {columns[still[0]][0]:g} rad/s as the speed of rotor {still[0][1:]} throughout, where "
            "that of a flying rotor changes; check its telemetry"
        )
    weight = GRAVITY * (model.airframe.mass or 1.0)
    most = np.array([SENSELESS * weight] * 3 + [SENSELESS * weight * max(model.airframe.arm, 0.1)] * 3)
    worst = np.abs(predicted).max(axis=0) / most
    if np.isfinite(predicted).all() and worst.max() > 1.0:
        k = int(np.argmax(worst))
        raise DataError(
            f"flight {key} cannot be compared with model {model.id}: it predicts {AXES[k]} up to "
            f"{np.abs(predicted[:, k]).max():.3g} {'N' if k < 3 else 'N m'}, which no quadrotor makes; correct the "
            f"coefficients of {AXES[k]} in its model.json, or make the model anew"
        )
    if not np.isfinite(predicted).all():
        lacking = [a for k, a in enumerate(AXES) if not np.isfinite(predicted[:, k]).all()]
        raise DataError(f"model {model.id} has no value for {', '.join(lacking)} on flight {key}")
    found = Evidence(
        key,
        airframe,
        model,
        float(metadata.get("mass") or airframe.mass or np.nan),
        np.asarray(metadata.get("inertia", airframe.inertia), float),
        columns,
        np.stack([columns[a] for a in AXES], axis=1),
        predicted,
        metadata,
    )
    return _as_shown(found)
