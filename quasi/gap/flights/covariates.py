"""Where a residual may live, and the smooth functions of it that are offered to what no cause explains."""

import itertools
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from quasi.attitude import from_euler, rotate_inverse
from quasi.gap.flights.evidence import Evidence
from quasi.model.columns import ROTORS

CONSTANT_SPREAD = 0.02  # a variable whose scaled spread is smaller is as good as constant
HEADING, ROOM_PLACE, EVERYWHERE = "heading", "room place", "everywhere"
UNPLACED = "no place"  # where an error lives that no place orders
IN_TIME = "frequency"  # where one lives that repeats in time
IN_WORDS = {EVERYWHERE: EVERYWHERE, UNPLACED: "beyond what the reference flights leave", IN_TIME: "as a vibration does"}
DIRECTED = ("forward speed", "sideways speed", "downward speed")  # along the body's axes
# what a model's terms depend on; the voltage falls with what the rotors draw
OWN_COVARIATES = ("speed", *DIRECTED, "rotor speed", "descent ratio", "roll rate", "pitch rate", "yaw rate", "volts")
# in which functions of them are offered
COVARIATES = ("speed", *DIRECTED, HEADING, "time", "rotor speed", "descent ratio", "roll rate", "pitch rate",
              "yaw rate", "height", "room x", "room y", "volts")  # fmt: skip
COLUMN_OF = {
    HEADING: "yaw",
    "time": "t",
    "roll rate": "p",
    "pitch rate": "q",
    "yaw rate": "r",
    "room x": "x",
    "room y": "y",
    "volts": "battery_voltage",
}  # columns that are a place as they are
SPOTS = (1.0, 2.0)  # m, width of a bump over the room's floor: a fan, a rotor's wake returning, a corner
APART_SPOTS = 0.8  # of the width
TIME_PARTS = 6  # parts of a flight between which something may come loose
VISITED_SHARE = 0.02  # share of the time that must be spent near a place of the room
UNITS_AT = {
    "speed": "m/s", "height": "m", HEADING: "rad", ROOM_PLACE: "m", "room x": "m", "room y": "m", "time": "s",
    "volts": "V", "rotor speed": "rad/s", "descent ratio": "", "roll rate": "rad/s", "pitch rate": "rad/s",
    "yaw rate": "rad/s", **dict.fromkeys(DIRECTED, "m/s"),
    "frequency": "Hz",
}  # fmt: skip


def where_in_words(where: str) -> str:
    """Where an error lives, in words that follow "differs"."""
    return IN_WORDS.get(where) or f"along the {where}"


def along(columns: Mapping[str, np.ndarray], hover: float, down: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Where a flight is, row by row, {name: (n,)}, as far as its columns allow: SI units, heading rad.

    hover  induced velocity in hover, m/s, which the descent ratio counts in; down (n, 3) the earth's down direction in
    body axes, None takes it from the attitude. Speeds are through the air where the wind is known.
    """

    def has(*names: str) -> bool:
        return all(n in columns for n in names)

    def take(*names: str) -> np.ndarray:
        return np.stack([np.asarray(columns[n], float) for n in names], axis=1)

    found = {name: np.asarray(columns[own], float) for name, own in COLUMN_OF.items() if own in columns}
    velocity = [f"{c}_air" if f"{c}_air" in columns else c for c in "uvw"]
    angles = ("roll", "pitch", "yaw")
    if has(*velocity):
        found |= dict(zip(DIRECTED, take(*velocity).T))
        found["speed"] = np.linalg.norm(take(*velocity), axis=1)
    if has(*velocity) and (down is not None or has(*angles)):
        down = rotate_inverse(from_euler(*take(*angles).T), np.array([0.0, 0.0, 1.0])) if down is None else down
        sinking = np.einsum("ni,ni->n", take(*velocity), down)
        found["descent ratio"] = np.maximum(sinking, 0.0) / hover
    if has(*ROTORS):
        found["rotor speed"] = take(*ROTORS).mean(axis=1)
    if has("z"):
        found["height"] = -np.asarray(columns["z"], float)
    return found


def places(flight: Evidence) -> dict[str, np.ndarray]:
    """Where a residual may live, {name: (n,)}: SI units, heading rad, the descent ratio without unit."""
    found = along(flight.columns, flight.hover_induced, flight.down)
    return {name: found[name] for name in COVARIATES if name in found and np.isfinite(found[name]).all()}


class Choice(NamedTuple):
    """One way to depend on a place: which of the functions; of a bump where it is (x, y, m), of a step when (s)."""

    where: str
    which: tuple[int, ...]
    at: tuple[float, ...] = ()


class Basis(NamedTuple):
    """Functions of the places that all flights know.

    scales {place: (low, high)}; choices  what is offered; spots  places x, y of the room with a width, m; steps  times
    mean (L,)  of the functions over the flights, taken off: a constant belongs to no place
    """

    scales: dict[str, tuple[float, float]]
    choices: list[Choice]
    spots: list[tuple[float, float, float]]
    steps: list[float]
    mean: np.ndarray | float = 0.0

    def functions(self, flight: Evidence, which: Sequence[int] | None = None) -> np.ndarray:
        """(n, L) values of all functions on a flight, or (n, m) of those in `which` (m,)."""
        known, made = places(flight), [lambda: np.ones(len(flight))]
        scaled = {}
        for where, (low, high) in self.scales.items():
            if where == HEADING:
                yaw = known[where]
                made += [partial(wave, k * yaw) for k in (1, 2) for wave in (np.sin, np.cos)]
                continue
            x = scaled[where] = np.clip(2.0 * (known[where] - low) / (high - low) - 1.0, -1.0, 1.0)
            made += [partial(np.copy, x), lambda x=x: 1.5 * x**2 - 0.5, lambda x=x: 2.5 * x**3 - 1.5 * x]
        if {"room x", "room y"} <= set(scaled):
            made.append(lambda: scaled["room x"] * scaled["room y"])
            x, y = known["room x"], known["room y"]
            made += [lambda a=a, b=b, s=s: np.exp(-((x - a) ** 2 + (y - b) ** 2) / s**2) for a, b, s in self.spots]
        made += [lambda step=step: flight.t > step for step in self.steps]
        use = range(len(made)) if which is None else which
        values = np.empty((len(flight), len(use)))
        for column, k in zip(values.T, use):
            column[:] = made[k]()
        return values - np.broadcast_to(self.mean, len(made))[list(use)]


def basis_of(flights: Sequence[Evidence], judges: Sequence[Evidence] = ()) -> Basis:
    """The functions to offer on these flights: along each place that all know and that varies.

    judges  further flights that have to know a place, as held-out ones, which choose no function
    Everywhere alike. Along an ordinary place: a straight line, or Legendre polynomials to the third degree. Along the
    heading: one wave a turn, two, or both. Over the room's floor: polynomials of x and y to the second degree, or one
    bump at a place. In time a step, too.
    """
    known, others = [places(f) for f in flights], [places(f) for f in judges]
    scales: dict[str, tuple[float, float]] = {}
    choices, at, first = [Choice(EVERYWHERE, (0,))], 1, {}
    for where in known[0]:
        if not all(where in k for k in (*known, *others)):
            continue
        # to the very ends: a flip lasts a hundredth of a flight, and a line that bends there is no term of the model's
        low, high = min(float(k[where].min()) for k in known), max(float(k[where].max()) for k in known)
        # a heading comes round again, and time begins when the log did
        varies = high - low > CONSTANT_SPREAD * max(abs(high), abs(low), 1e-9)
        if where not in (HEADING, "time") and not varies:
            continue
        scales[where], first[where] = (low, high), at
        if where == HEADING:
            options = [(0, 1), (2, 3), (0, 1, 2, 3)]
        else:
            options = [(0,), (0, 1, 2)]
        choices += [Choice(where, tuple(at + k for k in option)) for option in options]
        at += max(max(option) for option in options) + 1
    spots: list[tuple[float, float, float]] = []
    if {"room x", "room y"} <= set(scales):
        x, y = first["room x"], first["room y"]
        choices.append(Choice(ROOM_PLACE, (x, x + 1, y, y + 1, at)))
        flown = [np.concatenate([k[f"room {a}"] for k in known]) for a in "xy"]
        for width in SPOTS:
            sides = [np.arange(*(q + 0.5 * s * width for q, s in zip(scales[f"room {a}"], (1, -1))),
                               APART_SPOTS * width) for a in "xy"]  # fmt: skip
            for a, b in itertools.product(*sides):
                near = np.hypot(flown[0] - a, flown[1] - b) < width
                if VISITED_SHARE < near.mean() < 1.0 - VISITED_SHARE:
                    spots.append((float(a), float(b), width))
                    choices.append(Choice(ROOM_PLACE, (at + len(spots),), (float(a), float(b))))
        at += 1 + len(spots)
    low, high = scales["time"]
    steps = [low + k / TIME_PARTS * (high - low) for k in range(1, TIME_PARTS)]
    choices += [Choice("time", (at + k,), (step,)) for k, step in enumerate(steps)]
    basis = Basis(scales, choices, spots, steps)
    mean = np.mean([basis.functions(f).mean(axis=0) for f in flights], axis=0)
    mean[0] = 0.0
    return basis._replace(mean=mean)
