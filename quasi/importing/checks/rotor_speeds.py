"""Rotor speeds that no rotor has: impossible numbers, spikes, rotors that stand still or are constant in flight."""

import re
from collections.abc import Mapping

import numpy as np

from quasi.importing.artefacts import spikes
from quasi.importing.checks.spans import InvalidSpan, constant_runs, is_quiet, log_step
from quasi.importing.contradictions import FASTEST_ROTOR
from quasi.sensor_limits import runs_of

LARGEST_STEP = 0.3  # of a rotor's largest speed, from the median of seven samples; as `artefacts.spikes` needs it
FLYING_SHARE = 0.35  # of the 90 % quantile of the rotors' median speed, above which a quadrotor flies; as `rotor_age`
STANDING = 0.02  # of the same, below which a rotor stands still; idle speeds of electric rotors lie above 0.05
SHORTEST_STOP = 0.1  # s; rotors start and stop staggered by less, and telemetry drops out for less
# s: equal speeds last 0.19 s at most in healthy flight of the recordings that the tests read (eRPM of a Betaflight log;
# 0.016 s INDIflight, 0.073 s nano-drone)
SHORTEST_ROTOR_FREEZE = 0.5
MANY_HOLDS = 20  # times a rotor's usual time between changes; a log of held set-points is not frozen
MOST_IMPOSSIBLE = 0.2  # share of impossible samples from which none of the rotor's samples is believed


def rotor_names(values: Mapping[str, np.ndarray]) -> list[str]:
    """The measured rotor speeds among quantities, in order."""
    return sorted(name for name in values if re.fullmatch(r"w[1-8]", name))


def clean_rotor_speeds(
    t: np.ndarray, values: Mapping[str, np.ndarray], where: str, notes: list[str]
) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    """Rotor speeds (n,), rad/s, without samples that no rotor reaches or follows (NaN), and how many were removed.

    t (n,) s. Zeros in flight go where they are shorter than SHORTEST_STOP: so does telemetry that drops out.

    Speeds with the sign of the turning direction become sizes. A rotor with too many impossible samples stays as
    logged, for `unreliable_spans`. notes gains sentences that begin with `where`.
    """
    cleaned, removed, signed = {}, {}, []
    for name in rotor_names(values):
        speeds = values[name].copy()
        if not np.isfinite(speeds).any():
            continue
        if -np.nanquantile(speeds, 0.01) > np.nanquantile(speeds, 0.99):
            # written with the sign of the turning direction, which the quadrotor configuration states
            speeds = -speeds
            signed.append(name)
        bad = (speeds > FASTEST_ROTOR) | (speeds < 0)
        if impossible_share(speeds) <= MOST_IMPOSSIBLE:
            speeds[bad] = np.nan
            largest = float(np.nanquantile(speeds, 0.99)) if np.isfinite(speeds).any() else 0.0
            spiky = spikes(speeds, max(LARGEST_STEP * largest, 1e-9))
            speeds[spiky] = np.nan
            count = int(np.count_nonzero(bad | spiky))
            if count:
                removed[name] = count
        cleaned[name] = speeds
    for name, standing in standing_rows(cleaned).items():
        short = np.zeros(len(t), bool)
        for a, b in runs_of(standing):
            short[a:b] = t[b - 1] - t[a] < SHORTEST_STOP
        if short.any() and impossible_share(cleaned[name]) <= MOST_IMPOSSIBLE:
            cleaned[name][short] = np.nan
            removed[name] = removed.get(name, 0) + int(np.count_nonzero(short))
    if signed:
        notes.append(f"{where}: the speeds of {', '.join(signed)} are negative; their size is taken")
    if removed:
        listed = ", ".join(f"{name}: {count}" for name, count in removed.items())
        notes.append(f"{where}: spikes in the rotor speeds were removed ({listed})")
    return cleaned, removed


def impossible_share(speeds: np.ndarray) -> float:
    """Share of the finite speeds (n,), rad/s, that no rotor reaches."""
    known = speeds[np.isfinite(speeds)]
    return float(np.mean(known > FASTEST_ROTOR)) if len(known) else 0.0


def flying_rows(values: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """True (n,) where the rotors turn as in flight, without rotors where they are commanded to; None if neither."""
    names = rotor_names(values)
    if len(names) < 3:
        names = [f"command{i}" for i in range(1, 5) if f"command{i}" in values]
    if len(names) < 3:
        return None
    return _flying(np.stack([values[name] for name in names]))[0]


def standing_rows(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """{rotor: (n,) bool} where it stands still while the others turn as in flight; empty for less than three rotors."""
    return {name: standing for name, (_, standing) in _each_rotor(values).items()}


def _each_rotor(values: Mapping[str, np.ndarray]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """{rotor: (n,) bool where the others turn as in flight, (n,) bool where it stands meanwhile}."""
    names = rotor_names(values)
    found = {}
    for name in names if len(names) >= 3 else ():
        flying, level = _flying(np.stack([values[other] for other in names if other != name]))
        found[name] = flying, flying & (values[name] <= STANDING * level)
    return found


def unreliable_spans(t: np.ndarray, values: Mapping[str, np.ndarray]) -> list[InvalidSpan]:
    """Spans in which a rotor stands still or keeps one speed in flight, or its speeds are mostly impossible.

    t (n,) s; values {quantity: (n,)}, rad/s; fewer than three rotors cannot show that the quadrotor flies.
    """
    names = rotor_names(values)
    spans = []
    absurd = [name for name in names if impossible_share(values[name]) > MOST_IMPOSSIBLE]
    if absurd:
        share = max(impossible_share(values[name]) for name in absurd)
        reason = (
            f"{', '.join(absurd)} exceed {FASTEST_ROTOR:g} rad/s, which no rotor reaches, in up to {100 * share:.0f} % "
            "of the samples (a wrong unit, wrong motor poles or broken telemetry)"
        )
        spans.append(InvalidSpan(float(t[0]), float(t[-1]), reason))
    if len(names) < 3 or spans:
        return spans
    changes = {name: np.append(0, np.cumsum(np.diff(np.nan_to_num(values[name])) != 0)) for name in names}
    for name, (flying, standing) in _each_rotor(values).items():
        speeds = values[name]
        for a, b in runs_of(standing):
            if t[b - 1] - t[a] >= SHORTEST_STOP:
                spans.append(
                    InvalidSpan(float(t[a]), float(t[b - 1]), f"rotor {name[1:]} ({name}) stands at 0 in flight")
                )
        step = log_step(speeds)
        changing = float(np.count_nonzero(flying[1:] & (np.diff(np.nan_to_num(speeds)) != 0)))
        usual = float(np.sum(np.diff(t)[flying[1:]])) / changing if changing else np.inf
        for a, b in constant_runs(t, np.where(flying & ~standing, speeds, np.nan), SHORTEST_ROTOR_FREEZE):
            if is_quiet(speeds, a, b, step):
                continue
            varies = any(changes[other][b - 1] > changes[other][a] for other in names if other != name)
            if varies or t[b - 1] - t[a] >= MANY_HOLDS * usual:
                spans.append(
                    InvalidSpan(float(t[a]), float(t[b - 1]), f"rotor {name[1:]} ({name}) is constant in flight")
                )
    return spans


def _flying(speeds: np.ndarray) -> tuple[np.ndarray, float]:
    """True (n,) where the median of rotors (rotors, n) is that of a flight; its level there.

    The level is the 90 % quantile of the median while they turn; infinite where they never do.
    """
    middle = np.median(np.nan_to_num(speeds), axis=0)
    level = float(np.quantile(middle[middle > 0], 0.9)) if (middle > 0).any() else np.inf
    return middle > FLYING_SHARE * level, level
