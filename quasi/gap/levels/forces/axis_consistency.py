"""Whether the axes of force and moment agree on a cause.

A cause acts on several axes with one value. Something else that resembles it on one axis wants another value, or the
other sign, on the next: what a name made of it explains here it spoils there.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from quasi.gap.levels.forces.design import Design
from quasi.gap.statistics.candidates import Candidate, Test
from quasi.gap.statistics.clustered import ClusteredMixedModel
from quasi.model.model import AXES

AXIS_T = 3.0  # |t| of an axis that speaks against a cause, and that it must show of the cause to have a say
OPPOSITE = 0.3  # of what the cause is taken to be, with the other sign, that contradicts it


class Voice(NamedTuple):
    """The estimate of one axis alone: how much of the cause is there, 1 for all of it, with its standard error.

    turned  standard deviation of the amount for want of the direction of a cause with several parameters: an axis that
            shows a parameter of which little is known may want many times what the others made of it
    """

    axis: str
    amount: float
    std: float
    turned: float = 0.0

    @property
    def error(self) -> float:
        """Standard deviation of the amount where all axes have one cause."""
        return float(np.hypot(self.std, self.turned))


def voices(
    study: Design, compared: Sequence[bool], test: Test, pooled: Sequence[str], given: Sequence[Candidate] = (),
    channels: Sequence[str] = AXES,
) -> list[Voice]:  # fmt: skip
    """The estimate of each axis alone of a cause as a test found it, with others given: by segments, with the larger of
    the standard errors by segments and by whole flights.

    Every axis has an amount of its own at the same time: what another axis shows of the cause would else be put into
    the base, where all flights have it alike, and be missed from this one. Of a change, what all flights have alike on
    an axis belongs to the base as well, as much of it as healthy flights may have of the cause: it would else count as
    a spread between the flights.
    pooled  causes whose columns belong to the base, as in `MixedModel.test`; channels  axes that have a say: on others
    a cause only takes up what the model makes of its signals
    """
    own = [study.columns.causes[test.offer.cause][k] for k in test.offer.which]
    size = len(study.names)
    grams = [_with_axes(part, own, test.value) for part in study.channels]
    there = sum(np.einsum("kii->i", gram[:, size:, size:]) for gram in grams) > 0.0
    names: Mapping[str, list[int]] = {a: [size + k] for k, a in enumerate(AXES) if there[k]}
    usual = study.columns.bounds.get(test.offer.cause, np.full(len(own), np.inf))
    amount = np.min(np.asarray(usual)[list(test.offer.which)] / np.maximum(np.abs(test.value), 1e-300))
    bounds = {**study.columns.bounds, **{axis: np.array([amount]) for axis in names}}
    layout = study.columns._replace(causes=study.columns.causes | names, bounds=bounds)
    mixed = ClusteredMixedModel(grams, compared, layout, sessions=[f.session for f in study.flights])
    offers = [Candidate(axis, test.offer.since, (0,)) for axis in names]
    base = [*pooled, *names] if test.offer.since == "changed" else list(pooled)
    alike = 1.0 / max(test.value @ np.linalg.solve(test.covariance, test.value), 1e-300)  # variance that all axes share
    seen = sum(part.sum(axis=0) for part, flag in zip(study.channels, mixed.offered(test.offer.since)) if flag)
    result = []
    for axis, offer in zip(names, offers):
        if axis not in channels:
            continue
        slopes = seen[AXES.index(axis)][np.ix_(own, own)] @ test.value
        slopes = slopes / max(test.value @ slopes, 1e-300)  # of the amount, by the parameters
        turned = max(slopes @ test.covariance @ slopes - alike, 0.0) ** 0.5
        others = [*given, *(o for o in offers if o != offer)]
        found, between = mixed.test(offer, others, base), mixed.between(offer, others, base)
        result.append(Voice(axis, float(found.value[0]), float(max(found.std[0], between.std[0])), float(turned)))
    return result


def _with_axes(channels: np.ndarray, own: Sequence[int], value: np.ndarray) -> np.ndarray:
    """Cross-products (K, P + 6, P + 6) of stretches with what a cause of a value adds to each axis by itself."""
    count, axes, size, _ = channels.shape
    grams = np.zeros((count, size + axes, size + axes))
    grams[:, :size, :size] = channels.sum(axis=1)
    cross = channels[:, :, :, own] @ value  # (K, 6, P)
    grams[:, size:, :size] = cross
    grams[:, :size, size:] = np.swapaxes(cross, 1, 2)
    each = size + np.arange(axes)
    grams[:, each, each] = cross[:, :, own] @ value
    return grams


def disagreement(heard: Sequence[Voice], wald: float) -> float:
    """Factor by which a cause's standard errors grow where its axes are further apart than their own say, 1 where they
    are not: an axis has a form of its own, and the mean of a few such forms is known as well as they agree.

    wald  of the test of all axes together. Axes that hardly show the cause are left out, which would hide that the
    others differ, unless they surely differ.
    Source: DerSimonian & Laird, Meta-analysis in clinical trials, Controlled Clinical Trials 7, 1986, equation 8.
    """
    if len(heard) < 2:
        return 1.0
    whole = sum(1.0 / v.error**2 for v in heard) ** -0.5
    mean = sum(v.amount / v.error**2 for v in heard) * whole**2
    sharp = [
        v for v in heard
        if v.error < 3.0 * len(heard) ** 0.5 * whole or abs(v.amount - mean) > AXIS_T * np.hypot(v.error, whole)
    ]  # fmt: skip
    if len(sharp) < 2:
        return 1.0
    amounts, variances = np.array([(v.amount, v.error**2) for v in sharp]).T
    weights = 1.0 / variances
    scatter = weights @ (amounts - weights @ amounts / weights.sum()) ** 2 - (len(sharp) - 1)
    between = max(scatter, 0.0) / (weights.sum() - (weights**2).sum() / weights.sum())
    more = 1.0 / (1.0 / (variances + between)).sum() - 1.0 / weights.sum()
    return float(np.sqrt(1.0 + wald * more))


def hear(
    study: Design, compared: Sequence[bool], test: Test, pooled: Sequence[str], given: Sequence[Candidate],
    channels: Sequence[str],
) -> tuple[float, float]:  # fmt: skip
    """p-value of a cause on the axes where its form holds, and `disagreement` of these; arguments as for `voices`.

    Where the cause adds to further axes, these do not make it significant.
    """
    everywhere = voices(study, compared, test, pooled, given)
    heard = [v for v in everywhere if v.axis in channels]
    p = test.p if len(heard) == len(everywhere) else max(test.p, p_together(heard, len(test.offer.which)))
    return p, disagreement(heard, test.wald)


def p_together(heard: Sequence[Voice], parameters: int) -> float:
    """p-value of the axes' weighted mean, 1 where none is heard; parameters  that the cause was fitted with."""
    weights = np.array([v.std**-2.0 for v in heard])
    amounts = np.array([v.amount for v in heard])
    return float(chi2.sf((weights @ amounts) ** 2 / weights.sum(), parameters)) if heard else 1.0


def contradiction(heard: Sequence[Voice]) -> str:
    """Why the axes contradict one cause, or nothing: one wants it, another its opposite, both surely."""
    wanted = [v for v in heard if v.amount > AXIS_T * v.error]
    against = [v for v in heard if v.amount < min(-OPPOSITE, -AXIS_T * v.error) and AXIS_T * v.error < 1.0]
    if not wanted or not against:
        return ""
    first, last = max(wanted, key=lambda v: v.amount / v.error), min(against, key=lambda v: v.amount / v.error)
    return (
        f"{first.axis} shows {first.amount:.2f} +- {first.error:.2f} of it and {last.axis} {last.amount:.2f} +- "
        f"{last.error:.2f}: one cause acts on both alike"
    )
