"""What the pilot of a made flight wants: a table of references and stick doublets from a seed.

Rows at REFERENCE_RATE Hz, columns: 0:3 position, 3:6 velocity, 6:9 acceleration (earth NED); 9 yaw; 10 yaw rate;
11:14 rates added to the attitude loop's (rad/s, doublets); 14 share of hover thrust added; 15 mode.
"""

from collections.abc import Callable

import numpy as np

from quasi.errors import ConfigError, nearest

REFERENCE_RATE = 200.0
REFERENCE_COLUMNS = 16
OFF, IDLE, IN_FLIGHT = 0.0, 1.0, 2.0
REST_BEFORE = 6.0  # s on the ground before take-off
OFF_TIME = 3.5  # s of it with the rotors off
TAKE_OFF = 3.0
LANDING = 6.0
GROUND = -0.03  # m, height of the cg on its feet
REACH = np.array([3.6, 3.6])  # m, half size of the space flown
LOW, HIGH = 0.7, 4.0  # m above the floor

Piece = tuple[np.ndarray, np.ndarray, np.ndarray]


def smooth(n: int) -> np.ndarray:
    """Quintic from 0 to 1 with zero first and second derivatives at both ends, n samples."""
    s = np.linspace(0.0, 1.0, n)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def _samples(seconds: float) -> int:
    return max(round(seconds * REFERENCE_RATE), 2)


def _move(here: np.ndarray, there: np.ndarray, speed: float, least: float = 0.5) -> np.ndarray:
    """Positions (n, 3) of a smooth move whose highest speed is `speed` m/s."""
    seconds = max(1.875 * float(np.linalg.norm(there - here)) / speed, least)
    return here + smooth(_samples(seconds))[:, None] * (there - here)


def _still(position: np.ndarray, yaw: np.ndarray | None, at: float) -> Piece:
    n = len(position)
    return position, np.full(n, at) if yaw is None else yaw, np.zeros((n, 4))


def _hold(here: np.ndarray, seconds: float) -> np.ndarray:
    return np.repeat(here[None, :], _samples(seconds), axis=0)


def _place(rng: np.random.Generator) -> np.ndarray:
    return np.array([*rng.uniform(-1, 1, 2) * REACH, -rng.uniform(LOW + 0.4, HIGH - 0.8)])


def hover(rng: np.random.Generator, here: np.ndarray, yaw: float, vigour: float) -> Piece:
    """Hold a place."""
    return _still(_hold(here, rng.uniform(1.5, 3.0)), None, yaw)


def dash(rng: np.random.Generator, here: np.ndarray, yaw: float, vigour: float) -> Piece:
    """Out and back fast: a velocity doublet forward, sideways or diagonal in body axes."""
    speed = rng.uniform(4.0, 7.0) * vigour
    angle = yaw + rng.choice([0.0, np.pi / 2, np.pi / 4, -np.pi / 4]) + rng.normal(0, 0.1)
    way = np.array([np.cos(angle), np.sin(angle), 0.0])
    # as far as the room allows on either side of the place
    limits = [((REACH[k] * np.sign(way[k]) - here[k]) / way[k]) for k in (0, 1) if abs(way[k]) > 1e-3]
    backs = [((-REACH[k] * np.sign(way[k]) - here[k]) / way[k]) for k in (0, 1) if abs(way[k]) > 1e-3]
    ahead, behind = here + way * max(min(limits), 0.0), here + way * min(max(backs), 0.0)
    parts = [_move(here, behind, 0.6 * speed, 1.0), _move(behind, ahead, speed), _move(ahead, behind, speed)]
    return _still(np.concatenate(parts), None, yaw)


def yaw_sweep(rng: np.random.Generator, here: np.ndarray, yaw: float, vigour: float) -> Piece:
    """Turn by half a circle to a full one, there and back or on, drifting to another place."""
    turn = rng.choice([-1.0, 1.0]) * rng.uniform(np.pi, 2 * np.pi)
    seconds = 1.875 * abs(turn) / (rng.uniform(2.0, 4.0) * vigour)
    n = _samples(seconds)
    return _still(here + smooth(n)[:, None] * (_place(rng) - here) * 0.6, yaw + turn * smooth(n), yaw)


def stick_doublets(rng: np.random.Generator, here: np.ndarray, yaw: float, vigour: float) -> Piece:
    """Sharp rate doublets on roll, pitch and yaw while holding a place."""
    position = _hold(here, 4.2)
    overlay = np.zeros((len(position), 4))
    for k, start in enumerate(rng.permutation([0.4, 1.2, 2.0, 2.8])):
        axis = k if k < 3 else rng.integers(0, 2)
        width = _samples(rng.uniform(0.07, 0.13) * (2.2 if axis == 2 else 1.0))
        height = rng.choice([-1, 1]) * rng.uniform(4.0, 6.5) * vigour * (0.7 if axis == 2 else 1.0)
        i = _samples(start)
        overlay[i : i + width, axis] = height
        overlay[i + width : i + 3 * width, axis] = -height
        overlay[i + 3 * width : i + 4 * width, axis] = height
    return position, np.full(len(position), yaw), overlay


def throttle_steps(rng: np.random.Generator, here: np.ndarray, yaw: float, vigour: float) -> Piece:
    """Collective doublets: short sharp changes of thrust."""
    position = _hold(here, 3.0)
    overlay = np.zeros((len(position), 4))
    for start in (0.3, 1.3, 2.2):
        width = _samples(rng.uniform(0.12, 0.25))
        height = rng.choice([-1, 1]) * rng.uniform(0.25, 0.6) * vigour
        i = _samples(start)
        overlay[i : i + width, 3] = height
        overlay[i + width : i + 2 * width, 3] = -height
    return position, np.full(len(position), yaw), overlay


def heave(rng: np.random.Generator, here: np.ndarray, yaw: float, vigour: float) -> Piece:
    """Climb and sink between low and high at two speeds."""
    low, high = here.copy(), here.copy()
    low[2], high[2] = -LOW - 0.2, -HIGH + 0.1
    parts = [_move(here, low, 1.5, 1.0)]
    for speed in rng.permutation([2.0, 4.0]) * vigour:
        parts += [_move(low, high, speed), _move(high, low, 0.9 * speed)]
    return _still(np.concatenate(parts), None, yaw)


def circle(rng: np.random.Generator, here: np.ndarray, yaw: float, vigour: float) -> Piece:
    """Circles with the nose along the path or held."""
    radius, speed = rng.uniform(1.8, 3.0), rng.uniform(3.0, 5.5) * vigour
    turns, sense = rng.uniform(1.2, 2.0), rng.choice([-1.0, 1.0])
    n = _samples(turns * 2 * np.pi * radius / speed * 1.6)
    s = smooth(n)
    angle = sense * turns * 2 * np.pi * s
    centre = np.array([0.0, 0.0, min(here[2], -LOW - 0.6)])
    start = centre + [radius, 0.0, 0.0]
    height = 0.5 * np.sin(2 * np.pi * 2 * s) * rng.uniform(0, 1)
    path = centre + np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    lead = _move(here, start, 3.0 * vigour, 1.0)
    follow = rng.random() < 0.5
    heading = yaw + (angle if follow else 0.0 * angle)
    return _still(np.concatenate([lead, path]), np.concatenate([np.full(len(lead), yaw), heading]), yaw)


def figure_eight(rng: np.random.Generator, here: np.ndarray, yaw: float, vigour: float) -> Piece:
    """A lying eight across the room, nose held or swinging."""
    size, speed = rng.uniform(2.4, 3.3), rng.uniform(3.5, 5.5) * vigour
    n = _samples(6.1 * size / speed * 2 * 1.5)
    angle = 4 * np.pi * smooth(n)
    centre = np.array([0.0, 0.0, min(here[2], -LOW - 0.6)])
    path = centre + np.column_stack([size * np.sin(angle), size * np.sin(angle) * np.cos(angle), 0.3 * np.sin(angle)])
    lead = _move(here, centre, 3.0 * vigour, 1.0)
    swing = rng.choice([0.0, 0.9]) * np.sin(angle / 2) ** 2
    return _still(np.concatenate([lead, path]), np.concatenate([np.full(len(lead), yaw), yaw + swing]), yaw)


def wander(rng: np.random.Generator, here: np.ndarray, yaw: float, vigour: float) -> Piece:
    """To another place, turning on the way."""
    path = _move(here, _place(rng), rng.uniform(2.0, 5.0) * vigour, 1.0)
    return _still(path, yaw + rng.uniform(-1.5, 1.5) * smooth(len(path)), yaw)


MANOEUVRES: dict[str, Callable[..., Piece]] = {
    f.__name__: f for f in (hover, dash, yaw_sweep, stick_doublets, throttle_steps, heave, circle, figure_eight, wander)
}
# profile: (vigour, manoeuvres flown in shuffled rounds)
PROFILES: dict[str, tuple[float, tuple[str, ...]]] = {
    "mixed": (1.0, (*MANOEUVRES, "dash", "stick_doublets")),
    "aggressive": (
        1.25,
        ("dash", "dash", "dash", "heave", "circle", "figure_eight", "stick_doublets", "throttle_steps"),
    ),
    "hover": (0.6, ("hover", "hover", "wander", "stick_doublets", "throttle_steps", "yaw_sweep")),
    "heave": (1.0, ("heave", "throttle_steps", "heave", "wander", "stick_doublets")),
    "speed": (1.1, ("dash", "dash", "circle", "figure_eight", "yaw_sweep")),
    "rest": (0.0, ()),
}


def pilot(profile: str, duration: float, rng: np.random.Generator, is_heading_fixed: bool = False) -> np.ndarray:
    """The pilot's table (n, 16) of a flight of `duration` s; rest, take-off, manoeuvres, landing.

    is_heading_fixed  the nose points north throughout, and there are no yaw doublets
    Raises ConfigError for an unknown profile or a duration too short to take off and land.
    """
    if profile not in PROFILES:
        raise ConfigError(f"profile '{profile}' of a made flight is unknown{nearest(profile, PROFILES)}")
    vigour, names = PROFILES[profile]
    n = int(np.ceil(duration * REFERENCE_RATE)) + 2
    table = np.zeros((n, REFERENCE_COLUMNS))
    table[:, 2] = GROUND
    table[_samples(OFF_TIME) :, 15] = IDLE
    if not names:
        return table
    least = REST_BEFORE + TAKE_OFF + LANDING + 3.0
    if duration < least:
        raise ConfigError(f"'duration' of a made flight is {duration:g} s, expected at least {least:g} s; fly longer")
    start = np.array([0.0, 0.0, GROUND])
    here, yaw = np.array([0.0, 0.0, -1.5]), 0.0
    lift = start + smooth(_samples(TAKE_OFF))[:, None] * (here - start)
    pieces = [_still(lift, None, yaw)]
    left = int(n - (REST_BEFORE + TAKE_OFF + LANDING) * REFERENCE_RATE)
    order: list[str] = []
    while left > 0:
        order = order or list(rng.permutation(names))
        piece = MANOEUVRES[str(order.pop())](rng, here, yaw, vigour)
        pieces.append(piece)
        left -= len(piece[0])
        here, yaw = piece[0][-1], float(piece[1][-1])
    position, angle, overlay = (np.concatenate([p[k] for p in pieces]) for k in range(3))
    # the last manoeuvre is cut short where the landing must begin, and the way home starts from there
    stop = int(n - (REST_BEFORE + LANDING) * REFERENCE_RATE)
    position, angle, overlay = position[:stop], angle[:stop], overlay[:stop]
    if is_heading_fixed:
        angle, overlay = np.zeros_like(angle), overlay * [1.0, 1.0, 0.0, 1.0]
    first = _samples(REST_BEFORE)
    used = slice(first, first + stop)
    table[used, :3], table[used, 9], table[used, 11:15] = position, angle, overlay
    table[first:, 15] = IN_FLIGHT
    above = np.array([0.0, 0.0, -0.5])
    home = _samples(0.55 * LANDING)
    down = n - first - stop - home
    s = smooth(home)[:, None]
    table[first + stop : first + stop + home, :3] = position[-1] * (1 - s) + above * s
    touch = int(0.75 * down)
    table[first + stop + home :, :3] = [0.0, 0.0, GROUND]
    table[first + stop + home : first + stop + home + touch, 2] = above[2] + smooth(touch) * (GROUND - above[2])
    table[first + stop + home + touch :, 15] = IDLE
    table[first + stop :, 9] = angle[-1]
    table[:, :3] = _rounded(table[:, :3])
    table[:, 3:6] = np.gradient(table[:, :3], 1.0 / REFERENCE_RATE, axis=0)
    table[:, 6:9] = np.gradient(table[:, 3:6], 1.0 / REFERENCE_RATE, axis=0)
    table[:, 10] = np.gradient(table[:, 9], 1.0 / REFERENCE_RATE)
    return table


def _rounded(position: np.ndarray) -> np.ndarray:
    """Round off what corners the joints of pieces leave (0.1 s), so that no acceleration spikes are asked for."""
    window = np.hanning(23)[1:-1]
    window /= window.sum()
    padded = np.pad(position, ((10, 10), (0, 0)), mode="edge")
    return np.column_stack([np.convolve(padded[:, k], window, mode="valid") for k in range(position.shape[1])])
