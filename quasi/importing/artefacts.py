"""Samples that cannot be true: a pose that is held while the body moves, jumps that no vehicle flies, spikes.

A tracker that swaps markers or sees a reflection shows the body elsewhere or turned for some frames and then lets it
jump back. Each valid frame is compared with the motion of its neighbours; where the step between two frames cannot be
flown, and where frames are missing, the record is cut, and of the pieces the chain is kept that holds the most frames
and can be flown throughout.
"""

import numba
import numpy as np

from quasi.sensor_limits import runs_of

LARGEST_FLOWN_ACCELERATION = 200.0  # m/s2, far above any quadrotor (20 g)
MAX_ANGULAR_ACCELERATION = 1500.0  # rad/s2, above a 3-inch racer's
LARGEST_FLOWN_SPEED = 40.0  # m/s
MAX_RATE = 45.0  # rad/s
END_FRAMES = 3  # frames of an end next to a cut: glitches of one or two frames, and one that states the speed
PIECES_BACK = 121  # pieces that may be left out between two that are kept: 40 cuts, of which each makes three
LONGEST_SWAP = 2.0  # s; a piece longer than this is believed, and so is what follows it
SHORTEST_HOLD = 0.05  # s that a pose is held at least, and
FEWEST_REPEATS = 3  # how often, to be looked at
COARSEST_DIGIT = 0.015  # m; positions written more coarsely repeat in flight, too
USUAL_SCATTERS = 8.0  # times the usual scatter, beyond which a value belongs to no normal distribution
MISSING = 1.5  # usual steps: a longer one has frames missing, and a swap may end unseen in it


@numba.njit(cache=True)
def _turn(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two attitudes, rad, blind to the sign of the quaternions."""
    dot = abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3])
    return 2.0 * np.arccos(min(1.0, dot))


@numba.njit(cache=True)
def _median(values: np.ndarray, m: int) -> float:
    """Median of values[:m], which are put in order; NumPy's takes longer to compile than all of this module."""
    for i in range(1, m):
        for j in range(i, 0, -1):
            if values[j - 1] > values[j]:
                values[j - 1], values[j] = values[j], values[j - 1]
    return 0.5 * (values[(m - 1) // 2] + values[m // 2])


@numba.njit(cache=True)
def _steps(t: np.ndarray, x: np.ndarray, q: np.ndarray, turns: bool) -> tuple[np.ndarray, np.ndarray]:
    """Size of what each step (n - 1,) differs from the step that its four neighbours lead to expect: m and rad."""
    n = len(t)
    odd, turned = np.zeros(n - 1), np.zeros(n - 1)
    around = np.empty(4)
    for i in range(n - 1):
        step = t[i + 1] - t[i]
        squared = 0.0
        for c in range(3):
            m = 0
            for j in (i - 2, i - 1, i + 1, i + 2):
                if 0 <= j < n - 1:
                    around[m] = (x[j + 1, c] - x[j, c]) / (t[j + 1] - t[j])
                    m += 1
            if m:
                squared += (x[i + 1, c] - x[i, c] - _median(around, m) * step) ** 2
        odd[i] = np.sqrt(squared)
        if turns:
            m = 0
            for j in (i - 2, i - 1, i + 1, i + 2):
                if 0 <= j < n - 1:
                    around[m] = _turn(q[j], q[j + 1]) / (t[j + 1] - t[j])
                    m += 1
            if m:
                turned[i] = max(0.0, _turn(q[i], q[i + 1]) - _median(around, m) * step)
    return odd, turned


@numba.njit(cache=True)
def _chain(
    first: np.ndarray, last: np.ndarray, start: np.ndarray, end: np.ndarray, t: np.ndarray, x: np.ndarray,
    q: np.ndarray, turns: bool, floor_x: float, floor_q: float,
) -> np.ndarray:  # fmt: skip
    """Of the pieces first..last (inclusive), True for those of the flyable chain that holds the most frames.

    start, end  first and last frame between the cuts that a piece lies between. The time from the one end to the next
    start bounds what a body can do: frames that are left out next to a cut make no jump flyable.
    """
    n = len(first)
    best, before = np.zeros(n), np.full(n, -1)
    for k in range(n):
        best[k] = last[k] - first[k] + 1
        size = best[k]
        b = first[k]
        for j in range(k - 1, max(-1, k - PIECES_BACK), -1):
            a = last[j]
            gap = t[b] - t[a]
            free = gap if start[j] == start[k] else t[start[k]] - t[end[j]]
            distance = 0.0
            for c in range(3):
                # where the earlier piece would have gone, with the mean of its last and the later one's first speed
                va = (x[a, c] - x[a - 1, c]) / (t[a] - t[a - 1]) if last[j] > first[j] else 0.0
                vb = (x[b + 1, c] - x[b, c]) / (t[b + 1] - t[b]) if last[k] > first[k] else va
                if last[j] == first[j]:
                    va = vb
                mean = min(max(0.5 * (va + vb), -LARGEST_FLOWN_SPEED), LARGEST_FLOWN_SPEED)
                distance += (x[b, c] - x[a, c] - mean * gap) ** 2
            near = np.sqrt(distance) <= floor_x + min(
                0.25 * LARGEST_FLOWN_ACCELERATION * free * free, LARGEST_FLOWN_SPEED * free
            )
            if near and turns:
                # what it turns by anyway in the frames that are left out
                ra = _turn(q[a - 1], q[a]) / (t[a] - t[a - 1]) if last[j] > first[j] else 0.0
                rb = _turn(q[b], q[b + 1]) / (t[b + 1] - t[b]) if last[k] > first[k] else 0.0
                near = _turn(q[a], q[b]) <= floor_q + max(ra, rb) * (gap - free) + min(
                    0.1 + 0.5 * MAX_ANGULAR_ACCELERATION * free * free, MAX_RATE * free
                )
            # a long piece is the truth even where the next one starts elsewhere (the body was carried, unseen)
            both_long = t[end[j]] - t[start[j]] > LONGEST_SWAP and t[end[k]] - t[start[k]] > LONGEST_SWAP
            if (near or both_long) and best[j] + size > best[k]:
                best[k] = best[j] + size
                before[k] = j
    kept = np.zeros(n, np.bool_)
    k = 0
    for j in range(1, n):
        if best[j] > best[k]:
            k = j
    while k >= 0:
        kept[k] = True
        k = before[k]
    return kept


def unflyable_steps(t: np.ndarray, x: np.ndarray, q: np.ndarray, turns: bool) -> tuple[np.ndarray, float, float]:
    """True for the steps (n - 1,) of a path that cannot be flown; the noise of its positions, m, and attitudes, rad.

    t (n,) s; x (n, 3) m; q (n, 4), which counts where `turns`; contiguous and finite
    """
    odd, turned = _steps(t, x, q, turns)
    usual = np.minimum(dt := np.diff(t), 3 * np.median(dt))
    # noise of the tracker itself: six times the usual unexpected step
    floor_x = max(1e-3, 6 * 1.4826 * float(np.median(odd)))
    floor_q = max(0.02, 6 * 1.4826 * float(np.median(turned)))
    cut = odd > floor_x + 2.0 * LARGEST_FLOWN_ACCELERATION * usual**2
    if turns:
        cut |= turned > floor_q + 2.0 * MAX_ANGULAR_ACCELERATION * usual**2
    return cut, floor_x, floor_q


def flyable(t: np.ndarray, position: np.ndarray, quaternion: np.ndarray | None) -> np.ndarray:
    """True for the frames that a flying body can have shown.

    t           (n,) s, increasing; position (n, 3) m; quaternion (n, 4) or None; all finite
    Returns     (n,) bool
    """
    n = len(t)
    if n < 4:
        return np.ones(n, bool)
    turns = quaternion is not None
    q = np.ascontiguousarray(quaternion) if turns else np.zeros((1, 4))
    x, dt = np.ascontiguousarray(position), np.diff(t)
    cut, floor_x, floor_q = unflyable_steps(t, x, q, turns)
    if not cut.any():
        return np.ones(n, bool)
    edges = np.flatnonzero(cut | (dt > MISSING * np.median(dt)))
    # frames next to a cut may be outliers that are just small enough: they are pieces of their own, to be left out
    starts, ends = np.concatenate([[0], edges + 1]), np.concatenate([edges, [n - 1]])
    long = ends - starts >= 3 * END_FRAMES
    edges = np.unique(np.concatenate([edges, (starts + END_FRAMES - 1)[long], (ends - END_FRAMES)[long]]))
    first = np.concatenate([[0], edges + 1])
    last = np.concatenate([edges, [n - 1]])
    within = np.searchsorted(ends, first)
    kept = _chain(first, last, starts[within], ends[within], t, x, q, turns, floor_x, floor_q)
    return np.repeat(kept, last - first + 1)


def stalled(t: np.ndarray, written: np.ndarray, position: np.ndarray, quaternion: np.ndarray | None) -> np.ndarray:
    """True for the frames that only hold an older pose, for the stream stalled or tracking was lost.

    t           (n,) s, increasing; written (n, k) the pose's numbers as the file has them; position (n, 3) m;
                quaternion (n, 4) or None; NaN where the body was not seen
    Returns     (n,) bool; the first frame of a stretch is the pose itself, and kept where the body was seen before it

    A body at rest repeats its pose too where digits are few, so a stretch counts only where the body cannot have
    rested: it jumps from it farther than it can fly from rest and does not come back as from a marker swap, or it flies
    into it and stops dead.
    """
    seen = np.isfinite(position).all(axis=1)
    if quaternion is not None:
        seen &= np.isfinite(quaternion).all(axis=1)
    result = np.zeros(len(t), bool)
    index = np.flatnonzero(seen)
    if len(index) < 4:
        return result
    t, written, x = t[index], written[index], position[index]
    q = quaternion[index] if quaternion is not None else np.zeros((len(index), 4))

    def apart(a: slice, b: slice | int) -> tuple[np.ndarray, np.ndarray]:
        """Distance, m, and angle, rad, between poses."""
        turn = 2.0 * np.arccos(np.clip(np.abs(np.sum(q[a] * q[b], axis=-1)), 0.0, 1.0))
        return np.linalg.norm(x[a] - x[b], axis=-1), turn if quaternion is not None else 0.0 * turn

    gap = np.diff(t)
    usual = float(np.median(gap))
    together = gap < MISSING * usual
    same = (written[1:] == written[:-1]).all(axis=1) & together
    far, turn = apart(slice(1, None), slice(-1))
    digit = max((float(np.min(m[m > 1e-9])) for m in np.abs(np.diff(x, axis=0)).T if np.max(m) > 1e-9), default=0.0)
    if digit > COARSEST_DIGIT:
        return result
    # noise, and what the last digit adds to it
    near_x = 2e-3 + 3.0 * digit
    near_q = 0.02 + 3.0 * min(0.02, float(np.min(turn[turn > 1e-6], initial=0.02)))
    # beyond what a body at rest can do within a step
    flown = far > near_x + np.minimum(0.5 * LARGEST_FLOWN_ACCELERATION * gap**2, LARGEST_FLOWN_SPEED * gap)
    turned = turn > near_q + np.minimum(0.5 * MAX_ANGULAR_ACCELERATION * gap**2, MAX_RATE * gap)
    for a, b in runs_of(same):  # frames a to b are alike
        if b - a < FEWEST_REPEATS or t[b] - t[a] < SHORTEST_HOLD:
            continue
        lost = False
        if b < len(gap) and (flown[b] or turned[b]) and t[-1] - t[b + 1] > LONGEST_SWAP:
            way, angle = apart(slice(b + 1, int(np.searchsorted(t, t[b + 1] + LONGEST_SWAP))), b)
            lost = not np.any((way <= near_x) & (angle <= near_q))
        if not lost and a >= 3 and together[a - 3 : a].all():
            # on one way, for a pose that swaps to and fro comes to rest too
            way, angle = apart(slice(a, a + 1), a - 3)
            lost = bool(flown[a - 3 : a].all() and way[0] > 0.8 * far[a - 3 : a].sum())
            lost |= bool(turned[a - 3 : a].all() and angle[0] > 0.8 * turn[a - 3 : a].sum())
        if lost:
            result[index[a + 1 : b + 1]] = True
            result[index[a]] = not (a > 0 and together[a - 1])
    return result


def spikes(values: np.ndarray, largest_step: float) -> np.ndarray:
    """True for samples of one channel that leave and return by more than any real change: one to three in a row.

    values        (n,), NaN allowed; largest_step  a change between neighbours below this is never a spike
    Returns       (n,) bool

    A sample is a spike when it lies farther than `largest_step`, and than eight times the usual scatter, from the
    median of the seven finite samples around it, and outside the range of its nearest trusted neighbours.
    """
    values = np.asarray(values, float)
    result = np.zeros(len(values), bool)
    index = np.flatnonzero(np.isfinite(values))
    v = values[index]
    if len(v) < 7:
        return result
    padded = np.concatenate([v[3:0:-1], v, v[-2:-5:-1]])
    window = np.lib.stride_tricks.sliding_window_view(padded, 7)
    middle = np.median(window, axis=1)
    away = np.abs(v - middle)
    bound = np.maximum(largest_step, USUAL_SCATTERS * 1.4826 * np.median(away))
    suspect = away > bound
    for i in np.flatnonzero(suspect):
        left = next((v[j] for j in range(i - 1, max(-1, i - 5), -1) if not suspect[j]), None)
        right = next((v[j] for j in range(i + 1, min(len(v), i + 5)) if not suspect[j]), None)
        sides = [s for s in (left, right) if s is not None]
        if not sides or min(sides) - bound <= v[i] <= max(sides) + bound:
            suspect[i] = False
    result[index[suspect]] = True
    return result
