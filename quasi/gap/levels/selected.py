"""Selected causes of sensors and drive as a level states them: effects, ties and candidates."""

from collections.abc import Callable, Mapping
from typing import Any

from quasi.gap.effect import Effect
from quasi.gap.flights.level import Level
from quasi.gap.selection import Selection
from quasi.gap.statistics.candidates import Candidate
from quasi.gap.statistics.mixed import MixedModel

Parameters = dict[str, dict[str, Any]]


def report_selection(
    level: Level, selection: Selection, mixed: MixedModel, reproducibility: Mapping[Candidate, float],
    effects: Mapping[str, Effect], parameters: Callable[[Candidate], Parameters],
    tie_breakers: Mapping[frozenset[str], str], more: Callable[[Candidate], Mapping[str, float]] = lambda _: {},
) -> None:  # fmt: skip
    """Fill a level's effects, ties and candidates, and the p-values that were asked of them.

    reproducibility  {offer: share of resamples that name it again}; parameters  of an offer, as they are stated
    tie_breakers     {ids: manoeuvre} where it is not that of the first cause; more  evidence of an offer
    """
    level.significance = dict(selection.level)
    for tie in selection.ties:
        offers = [t.offer for t in tie.tests]
        ids = [o.cause for o in offers]
        test = selection.test(mixed, offers[0])
        level.ties.append(
            {
                "ids": ids,
                "since": offers[0].since,
                "separability": tie.separability,
                "tie_breaker": tie_breakers.get(frozenset(ids), effects[ids[0]].tie_breaker),
                "parameters": {o.cause: parameters(o) for o in offers},
                "p": test.p,
                "wald": test.wald,
                "share of resamples": reproducibility[offers[0]],
                "evidence": dict(more(offers[0])),
            }
        )
    for offer in (named.test.offer for named in selection.named):
        test = selection.test(mixed, offer)
        level.effects.append(
            {
                "id": offer.cause,
                "since": offer.since,
                "share of resamples": reproducibility[offer],
                "channels": list(effects[offer.cause].channels),
                "parameters": parameters(offer),
                "evidence": {"p": test.p, "wald": test.wald, "between flights": test.tau, **more(offer)},
            }
        )
    level.effects.sort(key=lambda e: -e["evidence"]["wald"])
    there = {(o.cause, o.since) for o in selection.offers}
    there |= {(t.offer.cause, t.offer.since) for tie in selection.ties for t in tie.tests}
    for offer, test in selection.marginal.items():
        if (offer.cause, offer.since) not in there:
            level.candidates.append(
                {"id": offer.cause, "since": offer.since, "score": test.wald, "p": test.p,
                 "why_not": selection.why_not(offer)}
            )  # fmt: skip
