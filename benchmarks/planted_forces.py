"""Forces and moments planted in recorded flights: the recording of a vehicle that flew the same path in spite of them.

The path and its accelerations stay. A force F that acts as well is held by the rotors, so the vehicle leans otherwise
and its rotors turn at other speeds; a moment is held by their differences. Attitude, rates, specific force, rotor
speeds and commands are changed accordingly, and hold all noise, vibration and gusts of the recording.

What is planted ends at `BAND`: a lean that followed vibration would be none. The vehicle's thrust and torque
per squared speed are fitted to the recording itself.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import butter, lfilter, sosfiltfilt
from scipy.spatial.transform import Rotation

from quasi.airframe import Airframe

BAND = 20.0  # Hz: twice the band in which forces and moments are compared
LEAST_THRUST = 0.4  # of the weight: with less thrust no lean holds a force along the discs
LEAST_SQUARE = 0.1  # of the squared speed in hover, that a rotor keeps
GRAVITY = 9.81  # m/s2, of the weight that thrust is compared with
Z, ALONG = np.array([0.0, 0.0, 1.0]), np.array([1.0, 1.0, 0.0])
SPEEDS, COMMANDS, COMMANDED = ([name.format(i) for i in range(1, 5)] for name in ("w{}", "command{}", "w{}_CMD"))


class Flown(NamedTuple):
    """What a planted force may depend on, per sample, slow: time (n,) s; place (n, 3) m, earth NED; velocity (n, 3) m/s
    and rates (n, 3) rad/s, body FRD; attitude; speeds (n, 4) rad/s; thrust (n, 4) N; force (n, 3) N, of all that acts,
    body FRD; vehicle."""

    time: np.ndarray
    place: np.ndarray
    velocity: np.ndarray
    rates: np.ndarray
    attitude: Rotation
    speeds: np.ndarray
    thrust: np.ndarray
    force: np.ndarray
    airframe: Airframe

    @property
    def height(self) -> np.ndarray:
        """(n, 4) m, of each hub above the floor."""
        hubs = [self.attitude.apply(hub)[:, 2] + self.place[:, 2] for hub in self.airframe.hubs]
        return -np.stack(hubs, axis=1)

    def near(self, c: float, height: np.ndarray) -> np.ndarray:
        """Share of the thrust that rotors at a height above the floor make more."""
        nearness = (self.airframe.radius / 4.0 / np.maximum(height, 0.02)) ** 2
        return 1.0 / (1.0 - np.minimum(c * nearness, 0.6)) - 1.0

    @property
    def at_hubs(self) -> np.ndarray:
        """(n, 4, 3) m/s, velocity of each hub, body axes."""
        return self.velocity[:, None] + np.cross(self.rates[:, None], self.airframe.hubs)

    def at_the_hubs(self, forces: np.ndarray) -> "Wrench":
        """Force and moment of forces (n, 4, 3), N, at the hubs."""
        return forces.sum(axis=1), np.cross(self.airframe.hubs, forces).sum(axis=1)

    def of_thrusts(self, more: np.ndarray) -> "Wrench":
        """Force and moment of more thrust (n, 4), N, at each rotor."""
        return self.at_the_hubs(-more[:, :, None] * Z)


Wrench = tuple[np.ndarray, np.ndarray]  # force (n, 3), N, and moment (n, 3), N m, body FRD
Acting = Callable[[Flown], Wrench]


def force(of: Callable[[Flown], np.ndarray]) -> Acting:
    """A force at the centre of gravity, body axes."""
    return lambda flown: (made := of(flown), np.zeros_like(made))


def moment(of: Callable[[Flown], np.ndarray]) -> Acting:
    """A moment, body axes."""
    return lambda flown: (np.zeros_like(made := of(flown)), made)


def thrust(of: Callable[[Flown], np.ndarray]) -> Acting:
    """Share (n, 4) of its thrust that each rotor makes more."""
    return lambda flown: flown.of_thrusts(flown.thrust * of(flown))


def in_room(vector: Callable[[Flown], np.ndarray]) -> Acting:
    """A force of earth axes."""
    return force(lambda flown: flown.attitude.inv().apply(vector(flown)))


def slow(values: np.ndarray, rate: float) -> np.ndarray:
    """(n, k) without what is faster than BAND."""
    return sosfiltfilt(butter(2, BAND, fs=rate, output="sos"), values, axis=0)


def plant(imported: pd.DataFrame, filtered: pd.DataFrame, airframe: Airframe, acting: Acting) -> pd.DataFrame:
    """An imported flight as it would be if `acting` had acted; filtered  the same flight, unchanged, row by row."""
    filtered = filtered.iloc[np.minimum(np.arange(len(imported)), len(filtered) - 1)]
    time = imported["t"].to_numpy()
    rate = 1.0 / float(np.median(np.diff(time)))
    attitude = Rotation.from_euler("ZYX", filtered[["yaw", "pitch", "roll"]].to_numpy())
    rates, speeds = slow(filtered[["p", "q", "r"]].to_numpy(), rate), filtered[SPEEDS].to_numpy()
    squares = slow(speeds**2, rate)
    there, hubs, spin = filtered["valid"].to_numpy() > 0.5, airframe.hubs, airframe.spin
    one, velocity = -filtered["Fz"][there].mean() / squares[there].sum(axis=1).mean(), filtered[["v", "u"]].to_numpy()
    spun = -np.gradient(slow(speeds, rate), time, axis=0) @ spin
    roll, pitch, yaw = (
        _per_square(squares @ shape, other, filtered[moment].to_numpy(), there, rate)
        for shape, other, moment in (
            (-hubs[:, 1], (rates[:, 0], velocity[:, 0]), "Mx"), (hubs[:, 0], (rates[:, 1], velocity[:, 1]), "My"),
            (-spin, (spun, rates[:, 2]), "Mz"),
        )
    )  # fmt: skip
    per_square = np.array([-one * np.ones(4), -roll[0] * hubs[:, 1], pitch[0] * hubs[:, 0], -yaw[0] * spin])
    total = slow(filtered[["Fx", "Fy", "Fz"]].to_numpy(), rate)
    flown = Flown(
        time, filtered[["x", "y", "z"]].to_numpy(), slow(filtered[["u", "v", "w"]].to_numpy(), rate), rates, attitude,
        slow(speeds, rate), one * squares, total, airframe,
    )  # fmt: skip
    pushed, turned = (slow(values, rate) for values in acting(flown))
    # what acts besides the thrust keeps its share along the body's axes, and the sum of all its direction in the room
    wanted = total - pushed
    along = -np.sqrt(np.maximum((wanted**2).sum(axis=1) - (total[:, :2] ** 2).sum(axis=1), 0.0))
    least = np.maximum(LEAST_THRUST * airframe.mass * GRAVITY + total[:, 2], 0.0)[:, None] * -Z
    lean = _lean(slow(np.column_stack([total[:, :2], along]) + least, rate), slow(wanted + least, rate))
    turn = _rates(lean, rate)
    after = lean.inv().apply(rates) + turn
    more = _moment(after, airframe.inertia, rate) - _moment(rates, airframe.inertia, rate) - turned
    # a change of yaw moment begins with what spins the rotors up
    more[:, 2] = _lagged(more[:, 2], rate * yaw[1] / yaw[0] / (2.0 * speeds[there].mean()))
    change = np.column_stack([along - total[:, 2], more])
    square = speeds**2 + np.linalg.solve(per_square, change.T).T
    hover = airframe.mass * GRAVITY / (4.0 * one)
    made = imported.copy()
    factor = np.sqrt(np.maximum(square, LEAST_SQUARE * hover) / np.maximum(speeds**2, LEAST_SQUARE * hover))
    if set(SPEEDS) <= set(imported):
        made[SPEEDS] = imported[SPEEDS].to_numpy() * factor
    for names in (COMMANDS, COMMANDED):
        if set(names) <= set(imported):
            made[names] = _commands(imported[names].to_numpy(), speeds, speeds * factor, rate)
    made[["ax", "ay", "az"]] = lean.inv().apply(imported[["ax", "ay", "az"]].to_numpy(copy=True))
    made[["p", "q", "r"]] = lean.inv().apply(imported[["p", "q", "r"]].to_numpy(copy=True)) + turn
    made[["u", "v", "w"]] = lean.inv().apply(imported[["u", "v", "w"]].to_numpy(copy=True))
    for names in (["yaw", "pitch", "roll"], ["onboard_yaw", "onboard_pitch", "onboard_roll"]):
        if set(names) <= set(imported):
            made[names] = (Rotation.from_euler("ZYX", imported[names].to_numpy(copy=True)) * lean).as_euler("ZYX")
    return made


def _per_square(
    cause: np.ndarray, others: tuple[np.ndarray, ...], moment: np.ndarray, there: np.ndarray, rate: float
) -> np.ndarray:  # fmt: skip
    """Moment per squared speed, and per unit of the others, as this recording has them."""
    columns = slow(np.column_stack([cause, *others, moment]), rate)[there]
    return np.linalg.lstsq(np.column_stack([columns[:, :-1], np.ones(len(columns))]), columns[:, -1], rcond=None)[0]


def _lagged(values: np.ndarray, samples: float) -> np.ndarray:
    """First-order lag of a time constant in samples; none where it is not positive."""
    kept = float(np.exp(-1.0 / samples)) if samples > 0.0 else 0.0
    return lfilter([1.0 - kept], [1.0, -kept], values, zi=[kept * values[0]])[0]


def _lean(before: np.ndarray, after: np.ndarray) -> Rotation:
    """The smallest turns that bring forces (n, 3) along others."""
    first, last = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (before, after))
    axis, cosine = np.cross(first, last), np.sum(first * last, axis=1, keepdims=True)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    return Rotation.from_rotvec(axis / np.maximum(sine, 1e-12) * np.arctan2(sine, cosine))


def _rates(lean: Rotation, rate: float) -> np.ndarray:
    """Rates (n, 3) of a turning frame, in itself."""
    steps = (lean[:-1].inv() * lean[1:]).as_rotvec() * rate
    steps = np.concatenate([steps[:1], steps, steps[-1:]])
    return 0.5 * (steps[:-1] + steps[1:])


def _moment(rates: np.ndarray, inertia: np.ndarray, rate: float) -> np.ndarray:
    return np.gradient(rates, 1.0 / rate, axis=0) @ inertia + np.cross(rates, rates @ inertia)


def _commands(commands: np.ndarray, before: np.ndarray, after: np.ndarray, rate: float) -> np.ndarray:
    """Commands that make rotors follow other speeds: those that a first-order motor needs, as the recording has it."""
    made, change = commands.copy(), after - before
    for k in range(4):
        there = np.isfinite(commands[:, k]) & np.isfinite(before[:, k])
        slow_speed, slow_command = slow(before[there, k], rate), slow(commands[there, k], rate)
        columns = np.column_stack([slow_speed, slow_command, np.ones(there.sum())])
        per_lag, gain, _ = np.linalg.lstsq(columns, rate * np.gradient(slow_speed), rcond=None)[0]
        made[:, k] += (change[:, k] * -per_lag + rate * np.gradient(change[:, k])) / gain
    return made


def _lost(flown: Flown) -> np.ndarray:
    """Share (n, 4) of the thrust that rotors lose behind others, at most."""
    hubs, (u, v, _) = flown.airframe.hubs, flown.velocity.T
    speed, hover = u**2 + v**2, flown.airframe.mass * GRAVITY / (8.0 * 1.225 * np.pi * flown.airframe.radius**2)
    inflow = speed / hover
    behind = -(np.outer(u, hubs[:, 0]) + np.outer(v, hubs[:, 1])) / np.hypot(hubs[:, 0], hubs[:, 1])
    return -(inflow / (0.16 + inflow))[:, None] * np.maximum(behind, 0.0) ** 2 / (speed[:, None] + 1e-6)


def _carried(flown: Flown, arm: np.ndarray) -> Wrench:
    """What a centre of gravity adds that stands `arm` from the point that flew the path: its own acceleration, and the
    moment of all forces about it."""
    rates = flown.rates
    turning = np.gradient(rates, flown.time, axis=0)
    accelerated = np.cross(turning, arm) + np.cross(rates, np.cross(rates, arm))
    return -flown.airframe.mass * accelerated, -np.cross(arm, flown.force)


ANCHOR = np.array([1.5, -1.0, 0.0])  # m, earth axes, where a cable is fixed aside of the origin
# id: what acts, for a size; docs/causes.md has the equations
ACTING: Mapping[str, Callable[[float], Acting]] = {
    "wind": lambda n: in_room(lambda f: np.tile([n, 0.0, 0.0], (len(f.time), 1))),
    "tether": lambda k: in_room(lambda f: -k * f.place),
    "tether_aside": lambda k: in_room(lambda f: -k * (f.place - ANCHOR)),
    "body_drag": lambda c: force(lambda f: -c * np.linalg.norm(f.velocity, axis=1, keepdims=True) * f.velocity),
    "rotor_drag": lambda k: lambda f: f.at_the_hubs(-k * f.speeds[:, :, None] * f.at_hubs * ALONG),
    "drag_at_centre": lambda k: force(lambda f: -k * f.speeds.sum(axis=1, keepdims=True) * f.velocity * ALONG),
    "translational_lift": lambda k: lambda f: f.of_thrusts(0.25 * k * np.sum(f.at_hubs**2 * ALONG, axis=2)),
    "axial_inflow": lambda k: lambda f: f.of_thrusts(k * f.speeds * f.at_hubs[:, :, 2]),
    "lift_at_centre": lambda k: force(lambda f: -k * np.sum(f.velocity**2 * ALONG, axis=1, keepdims=True) * Z),
    "ground_at_centre": lambda c: force(
        lambda f: -f.thrust.sum(axis=1, keepdims=True) * f.near(c, -f.place[:, 2:]) * Z
    ),
    "inflow_at_centre": lambda k: force(lambda f: -k * f.speeds.sum(axis=1, keepdims=True) * f.velocity * Z),
    "ground_effect": lambda c: thrust(lambda f: f.near(c, f.height)),
    "thrust_drift": lambda rate: thrust(lambda f: rate * np.tile(f.time[:, None], 4)),
    "thrust_factor": lambda share: thrust(lambda f: np.full((len(f.time), 4), share)),
    "rotor_interference": lambda k: thrust(lambda f: k * _lost(f)),
    "blade_flapping": lambda k: moment(
        lambda f: k * (f.speeds[:, :, None] * np.cross(Z, f.at_hubs)).sum(axis=1)
    ),
    "rotor_gyroscopic": lambda j: moment(
        lambda f: -j * (f.speeds @ f.airframe.spin)[:, None] * np.cross(f.rates, Z)
    ),
    "cg_offset": lambda x: lambda f: _carried(f, np.array([x, 0.0, 0.0])),
}  # fmt: skip


def planted(flights: Mapping[str, Any], name: str, size: float) -> Callable[[pd.DataFrame, str], pd.DataFrame]:
    """What a cause of some size makes of the imported table of one of the flights {key: flight as it was processed}."""
    acting = ACTING[name](size)

    def change(imported: pd.DataFrame, key: str) -> pd.DataFrame:
        flight = flights[key]
        return plant(imported, flight.filtered, flight.airframe, acting)

    return change
