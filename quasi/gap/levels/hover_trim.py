"""Trim in steady flight as evidence: the mean thrust that each rotor is asked for, against what sessions differ by.

In the mean over a steady flight the rotors carry the weight and no moment is left:

    sum F_i = m g,    sum y_i F_i = m g y_cg,    sum x_i F_i = m g x_cg,    sum s_i F_i = 0 (equal torque factors).

With logarithms of what the rotors are asked for (squared speed, or squared command times voltage), a change of trim is
a vector of four numbers, and each cause moves it along directions of its own: a weak rotor along its own axis, another
mass along (1, 1, 1, 1), a moved centre of gravity along two, a weight that hangs somewhere along these three. The
hypotheses are compared by their marginal likelihoods under

    y = mean + cause (compared flights) + session + flight + voltage,

with independent spreads of sessions and of flights, all with priors and integrated out numerically. Flights differ in
what all rotors are asked for (climb, air, what a battery weighs) apart from what single rotors are: a vehicle that is
trimmed alike to a thousandth may well differ by some hundredths in all of it.
Source: statics; Gelman et al., Bayesian Data Analysis, 3rd ed., 2013, chapters 5 (hierarchical models) and 7.4 (Bayes
factors); MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter 28 (Occam factor).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from quasi.gap.flights.sessions import SESSION_THRUST, SESSION_YAW, seating_spread

N_ROTORS = 4
# Prior medians of the spreads of log thrust that one rotor is asked for between flights, by each rotor and by all of
# them alike: measured on the healthy flights of CrazyPAD and its flights with tape, `benchmarks/real_causes.py`. For
# sessions see `quasi.gap.flights.sessions`. The factors are one standard deviation: of sessions, of which there are
# few, by weight and place alike and about yaw; of flights, whose spreads differ by 10 between three vehicles.
FLIGHT_SPREAD, LIFT_SPREAD = 0.009, 0.008
SPREAD_FACTORS = np.array([1.5, 1.5, 2.5, 2.5])
SPREAD_GRID = np.linspace(-2.0, 2.0, 5)  # of each spread, in standard deviations of its prior
NUMBERS_AT_ONCE = 4_000_000  # of covariance matrices, 32 MB
MEAN_STD = 10.0  # of log thrust: nothing is known of the trim itself
VOLTAGE_STD = (
    0.5  # exponent by which the assumed map from command and voltage to thrust may be wrong, standard deviation
)
# Standard deviations of the causes' sizes: each moves a rotor's thrust by some 10 to 15 %, what a chipped propeller, a
# payload or a displaced battery do (0.07 arms are 3 mm on a 46 mm arm).
ROTOR_STD, SHARE_STD, ARM_STD, YAW_STD = 0.15, 0.1, 0.07, 0.1
FREE_STD = 0.1  # of each rotor by itself, where no hypothesis fits: as large as the largest of the others
# Prior probabilities: of a healthy vehicle, and the shares in which the causes divide the rest. A damaged or wrong
# propeller is the most frequent fault, and it may be any of four.
PRIOR_HEALTHY = 0.4
PRIOR_SHARES = {"rotor": 1.0, "mass": 1.0, "cg": 1.0, "weight": 1.0, "yaw": 0.25, "unexplained": 0.25}
NAMED = 0.9  # probability from which a cause has a name: of such names one in ten may be wrong
MAX_TIED = 3  # hypotheses in a tie
# Times that what has a name is more probable than a change that fits none: "positive" evidence (Kass & Raftery, Bayes
# factors, JASA 90, 1995)
OVER_UNEXPLAINED = 3.0


class Flight(NamedTuple):
    """Trim of one flight: key; thrust (4,) mean of each rotor, any unit; volts, mean, or NaN; session; is_compared."""

    key: str
    thrust: np.ndarray
    volts: float
    session: str
    is_compared: bool


class Hypothesis(NamedTuple):
    """What may have changed the trim: name; ids of the catalogue's causes that it stands for; directions (4, k) of log
    thrust per unit of its parameters; std (k,) of the parameters' priors; prior probability."""

    name: str
    ids: tuple[str, ...]
    directions: np.ndarray
    parameters: tuple[str, ...]
    std: tuple[float, ...]
    prior: float


@dataclass
class Comparison:
    """probability {hypothesis: posterior}; parameters {hypothesis: {parameter: (mean, std)}}; change (4,) of log thrust
    of the compared flights and its covariance (4, 4); spread {"weight", "seating" (in arms), "yaw", "flight", "lift"}
    posterior means."""

    probability: dict[str, float]
    parameters: dict[str, dict[str, tuple[float, float]]]
    change: np.ndarray
    covariance: np.ndarray
    spread: dict[str, float] = field(default_factory=dict)


class Geometry(NamedTuple):
    """relative (4, 4): log thrust of each rotor per unit of weight, of cg right and cg forward in arms, and of yaw."""

    arm: float
    relative: np.ndarray

    @property
    def session_spreads(self) -> np.ndarray:
        """Standard deviations (4,) of these between healthy sessions."""
        place = seating_spread(self.arm)
        return np.array([SESSION_THRUST, place, place, SESSION_YAW])


def geometry_of(positions: np.ndarray, spins: np.ndarray) -> Geometry:
    """The balance of a quadrotor about its configured cg.

    positions  (4, 2) x and y of the hubs from it, m, body FRD; spins (4,) +1 or -1, sense of rotation
    """
    x, y = positions[:, 0], positions[:, 1]
    arm = float(np.mean(np.hypot(x, y)))
    balance = np.stack([np.ones(N_ROTORS), y / arm, x / arm, spins])
    carried = np.linalg.solve(balance, np.eye(N_ROTORS))  # thrusts (4,) that make a unit of each row alone
    return Geometry(arm, carried / carried[:, :1])


def hypotheses(geometry: Geometry) -> list[Hypothesis]:
    """What the trim of a quadrotor is compared under."""
    relative = geometry.relative
    shares = {"mass": relative[:, :1], "cg": relative[:, [2, 1]], "yaw": relative[:, 3:]}
    weight = np.hstack([shares["mass"], shares["cg"]])
    found = [
        Hypothesis(f"rotor {i + 1}", ("rotor_effectiveness",), -np.eye(N_ROTORS)[:, i : i + 1], (f"rotor{i + 1}",),
                   (ROTOR_STD,), PRIOR_SHARES["rotor"])
        for i in range(N_ROTORS)
    ]  # fmt: skip
    cg = tuple(f"{a}_cg" for a in "xy")
    found += [
        Hypothesis("mass", ("mass", "thrust_factor"), shares["mass"], ("mass",), (SHARE_STD,), PRIOR_SHARES["mass"]),
        Hypothesis("cg", ("cg_offset",), shares["cg"], cg, (ARM_STD,) * 2, PRIOR_SHARES["cg"]),
        Hypothesis("weight", ("mass", "cg_offset"), weight, ("mass", *cg), (SHARE_STD, ARM_STD, ARM_STD),
                   PRIOR_SHARES["weight"]),
        Hypothesis("yaw", ("rotor_tilt",), shares["yaw"], ("yaw",), (YAW_STD,), PRIOR_SHARES["yaw"]),
        Hypothesis("unexplained", (), np.eye(N_ROTORS), tuple(f"free{i}" for i in range(1, 5)), (FREE_STD,) * 4,
                   PRIOR_SHARES["unexplained"]),
    ]  # fmt: skip
    total = sum(h.prior for h in found)
    found = [h._replace(prior=(1.0 - PRIOR_HEALTHY) * h.prior / total) for h in found]
    return [Hypothesis("healthy", (), np.zeros((N_ROTORS, 0)), (), (), PRIOR_HEALTHY), *found]


def compare(flights: Sequence[Flight], candidates: Sequence[Hypothesis], geometry: Geometry) -> Comparison:
    """Posterior of the hypotheses. At least one reference and one compared flight are needed (ValueError)."""
    compared = np.array([f.is_compared for f in flights])
    if not compared.any() or compared.all():
        raise ValueError("hover trim needs reference flights and compared flights")
    acting = np.kron(compared[:, None].astype(float), np.eye(N_ROTORS))
    sides = [acting @ (h.directions * np.array(h.std)) for h in candidates]
    gram, base, sizes = _over_spreads(flights, np.column_stack([*sides, acting]), geometry)
    ends = np.cumsum([1, *(h.directions.shape[1] for h in candidates)])
    found = [_marginal(gram, slice(i, j)) for i, j in itertools.pairwise(ends)]
    log_posterior = np.stack([np.log(h.prior) + base + gain for h, (gain, *_) in zip(candidates, found)], axis=1)
    weight = np.exp(log_posterior - np.max(log_posterior))
    sizes = np.hstack([sizes[:, :1] * geometry.session_spreads[[0, 1]], sizes[:, 1:2] * SESSION_YAW, sizes[:, 2:]])
    covariance = np.linalg.inv(gram[:, ends[-1] :, ends[-1] :])
    change = (covariance @ gram[:, ends[-1] :, :1])[:, :, 0]
    return _summary(candidates, weight / weight.sum(), [fit for _, *fit in found], (change, covariance), sizes)


def session_scales(flights: Sequence[Flight], geometry: Geometry) -> tuple[float, float]:
    """How many times as far as usual the sessions of reference flights lie apart, by weight and place, and about yaw.

    The root of the mean square over the posterior, as a multiple of that over the prior; 1 where there is one session.
    """
    if len({f.session for f in flights}) < 2:
        return 1.0, 1.0
    _, base, sizes = _over_spreads(flights, np.zeros((N_ROTORS * len(flights), 0)), geometry)
    squares, weight = sizes[:, :2] ** 2, np.exp(base - base.max())
    prior = np.exp(-0.5 * np.sum((np.log(sizes[:, :2]) / np.log(SPREAD_FACTORS[:2])) ** 2, axis=1))
    place, yaw = np.sqrt(np.average(squares, axis=0, weights=weight) / np.average(squares, axis=0, weights=prior))
    return float(place), float(yaw)


def _over_spreads(
    flights: Sequence[Flight], columns: np.ndarray, geometry: Geometry
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Products (g, 1 + k, 1 + k) of log thrust and columns (4n, k), whitened; log of prior times likelihood (g,)
    without the columns; and sizes (g, s), those of sessions as multiples of the usual ones; each over all spreads."""
    sides = np.column_stack([np.log(np.stack([f.thrust for f in flights])).ravel(), columns])
    fixed = _fixed_covariance(flights)
    # compared flights never share a session's effect with reference flights: trim also jumps within a session (battery
    # seated anew, a propeller changed), so that a change counts only beyond what sessions differ by
    sessions = np.array([f"{f.is_compared}/{f.session}" for f in flights])
    shared = (sessions[:, None] == sessions[None, :]).astype(float)
    usual = geometry.relative * geometry.session_spreads
    seating, yaw = (np.kron(shared, part @ part.T) for part in (usual[:, :3], usual[:, 3:]))
    lift = np.kron(np.eye(len(flights)), np.ones((N_ROTORS, N_ROTORS)))
    away = np.array(list(itertools.product(SPREAD_GRID, repeat=len(SPREAD_FACTORS))))
    sizes = SPREAD_FACTORS**away * (1.0, 1.0, FLIGHT_SPREAD, LIFT_SPREAD)
    grams, base = [], []
    for part in np.array_split(np.arange(len(away)), -(-len(away) * len(sides) ** 2 // NUMBERS_AT_ONCE)):
        scales = sizes[part, :, None, None] ** 2
        spread = sum(scales[:, k] * m for k, m in enumerate((seating, yaw, np.eye(len(sides)), lift)))
        factor = np.linalg.cholesky(fixed + spread)
        white = np.linalg.solve(factor, np.broadcast_to(sides, (len(part), *sides.shape)))
        grams.append(np.swapaxes(white, 1, 2) @ white)
        base.append(-np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1))
    gram = np.concatenate(grams)
    return gram, np.concatenate(base) - 0.5 * gram[:, 0, 0] - 0.5 * np.sum(away**2, axis=1), sizes


def _fixed_covariance(flights: Sequence[Flight]) -> np.ndarray:
    """Covariance (4n, 4n) of log thrust by the unknown mean and by the unknown exponent of the voltage."""
    n = len(flights)
    volts = np.array([f.volts for f in flights])
    known = np.isfinite(volts) & (volts > 0)
    level = np.where(known, np.log(np.where(known, volts, 1.0)), 0.0)
    if known.any():
        level = np.where(known, level - level[known].mean(), 0.0)
    common = np.outer(level, level) * VOLTAGE_STD**2
    return np.kron(np.ones((n, n)), np.eye(N_ROTORS)) * MEAN_STD**2 + np.kron(common, np.ones((N_ROTORS, N_ROTORS)))


def _marginal(gram: np.ndarray, own: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log marginal likelihood (g,) over that without some columns, mean (g, k) and covariance (g, k, k) of their
    unit-normal factors.

    gram  (g, z, z) products of whitened columns, the first of them the data
    """
    precision = np.eye(own.stop - own.start) + gram[:, own, own]
    pull = gram[:, own, 0]
    mean = np.linalg.solve(precision, pull[:, :, None])[:, :, 0]
    gain = 0.5 * np.sum(pull * mean, axis=1) - 0.5 * np.linalg.slogdet(precision)[1]
    return gain, mean, np.linalg.inv(precision)


def _summary(
    candidates: Sequence[Hypothesis], weight: np.ndarray, fits: Sequence[Sequence[np.ndarray]],
    changes: tuple[np.ndarray, np.ndarray], sizes: np.ndarray,
) -> Comparison:  # fmt: skip
    """weight (g, h) posterior of spreads and hypothesis, sum 1; fits (mean, covariance) by hypothesis and changes, all
    by spreads, whose sizes (g, s) are."""
    probability = {h.name: float(p) for h, p in zip(candidates, weight.sum(axis=0))}
    parameters: dict[str, dict[str, tuple[float, float]]] = {}
    for h, w, (means, covariances) in zip(candidates, weight.T, fits):
        w = w / max(w.sum(), 1e-300)
        mean = w @ means
        second = w @ (np.diagonal(covariances, axis1=1, axis2=2) + means**2)
        std = np.sqrt(np.maximum(second - mean**2, 0.0))
        parameters[h.name] = {n: (float(s * m), float(s * d)) for n, s, m, d in zip(h.parameters, h.std, mean, std)}
    each, (values, covariances) = weight.sum(axis=1), changes
    change = each @ values
    off = values - change
    covariance = np.tensordot(each, covariances + off[:, :, None] * off[:, None, :], 1)
    spread = dict(zip(("weight", "seating", "yaw", "flight", "lift"), (each @ sizes).tolist()))
    return Comparison(probability, parameters, change, covariance, spread)


def conclude(comparison: Comparison) -> tuple[str, list[str]]:
    """What the trim says, in a word, and the names of the hypotheses that it is about.

    "named" one hypothesis has the probability NAMED, a change that fits none left aside; "tied" up to MAX_TIED have it
    together; "changed" something did, without a name; "healthy" nothing did; "open" neither is sure.
    What has a name is OVER_UNEXPLAINED times as probable as a change that fits none: vehicles differ in all rotors.
    """
    probability = dict(comparison.probability)
    unexplained = probability.pop("unexplained", 0.0)
    total = sum(probability.values())
    ranked = sorted((n for n in probability if n != "healthy"), key=lambda n: -probability[n])
    together = 0.0
    for count, name in enumerate(ranked[:MAX_TIED], 1):
        together += probability[name]
        if together >= NAMED * total and together >= OVER_UNEXPLAINED * unexplained:
            return ("named" if count == 1 else "tied"), ranked[:count]
    healthy = probability.get("healthy", 0.0)
    if healthy <= 1.0 - NAMED:
        return "changed", []
    return ("healthy" if healthy >= NAMED else "open"), []
