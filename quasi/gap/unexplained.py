"""What no cause explains: significant, material, and where it lives; never forced into a name.

After the named causes, smooth functions of the state are offered to each channel with the same tests that causes have
to pass. One that passes is not a cause; it says that the model is wrong there, and along what.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from quasi.gap.effect import Effect, Parameter, Vehicle
from quasi.gap.evidence import Evidence
from quasi.gap.gain import wrench_score
from quasi.gap.mixed import Columns, Mixed, Offer, Test
from quasi.gap.study import gather_study
from quasi.standalone.model import AXES

MOST = 6
EDGES = (0.01, 0.99)  # quantiles between which a variable is scaled; beyond, the functions are constant
APART = 0.02  # a variable whose scaled spread is smaller is as good as constant
PERIODIC = ("heading",)


def places(flight: Evidence) -> dict[str, np.ndarray]:
    """Where a residual may live, {name: (n,)}: SI units, heading rad, the descent ratio without unit."""
    down = np.einsum("ni,ni->n", flight.velocity, flight.down)
    found = {
        "speed": np.linalg.norm(flight.velocity, axis=1),
        "heading": flight.columns["yaw"],
        "time": flight.t,
        "rotor speed": flight.speeds.mean(axis=1),
        "descent ratio": np.maximum(down, 0.0) / flight.hover_induced,
    }
    if "z" in flight.columns:
        x, y, z = flight.position.T
        found |= {"height": -z, "room x": x, "room y": y}
    if "battery_voltage" in flight.columns:
        found["volts"] = flight.columns["battery_voltage"]
    return {name: values for name, values in found.items() if np.isfinite(values).all()}


def search(
    flights: Sequence[Evidence],
    compared: Sequence[bool],
    held: Sequence[Evidence],
    causes: Sequence[tuple[Effect, Offer, Mapping[str, float]]],
    left: Callable[[Evidence], np.ndarray],
    floor: np.ndarray,
    vehicle: Vehicle,
    rate: float,
    share: float,
) -> tuple[list[dict[str, Any]], np.ndarray]:
    """What stays unexplained, as the diagnosis says it, and the mean squares (6,) that it leaves on held-out flights.

    causes  accepted ones and those of ties: effect, offer, values to linearise at; left  flight -> (n, 6), the residual
    of the extended model; floor (6,) mean squares; rate  family-wise false alarm rate; share  least material one
    """
    offered = _pseudo([*flights, *held])
    effects = {e.id: e for e, *_ in causes} | offered
    study = gather_study(flights, effects, vehicle, {e.id: v for e, _, v in causes if e.curved is not None})
    parts = [b.sum(axis=0) for b in study.blocks]
    given = [offer for _, offer, _ in causes]
    stages = ["always"] if all(compared) else ["changed", "always"]
    level = rate / (len(stages) * max(len(offered), 1))
    found: list[Offer] = []

    def tested(offer: Offer, others: Sequence[Offer]) -> Test:
        # of all the columns only those of this test, which is then a matter of small matrices
        layout = study.columns
        names = dict.fromkeys([*(g.cause for g in given), *(o.cause for o in others), offer.cause])
        use = [0, *layout.shared, *layout.nuisance, *(c for n in names for c in layout.causes[n])]
        place = {c: i for i, c in enumerate(use)}
        own = Columns(
            [place[c] for c in layout.shared],
            [place[c] for c in layout.nuisance],
            layout.spread,
            {n: [place[c] for c in layout.causes[n]] for n in names},
        )
        mixed = Mixed([g[np.ix_(use, use)] for g in parts], compared, own)
        return mixed.test(offer, [*given, *others], [offer.cause] if offer.since == "changed" else [])

    for since in stages:
        while len(found) < MOST:
            taken = {o.cause for o in found}
            offers = [Offer(n, since, tuple(range(len(e.fitted)))) for n, e in offered.items() if n not in taken]
            best = min((tested(o, found) for o in offers), key=lambda t: t.p, default=None)
            if best is None or best.p >= level:
                break
            found.append(best.offer)
    tests = [tested(o, [f for f in found if f != o]) for o in found]

    def score(kept: Sequence[Test]) -> np.ndarray:
        def residual(flight: Evidence) -> np.ndarray:
            values = left(flight)
            for test in kept:
                columns = list(offered[test.offer.cause].columns(flight, {}).values())
                values = values - sum(c * v for c, v in zip(columns, test.value))
            return values

        return wrench_score(held, residual).mean()

    whole = score(tests)
    before = score([])
    floor = np.minimum(np.minimum(floor, whole), before)
    said = []
    for test in tests:
        channel, where = test.offer.cause.split(" along ")
        k = AXES.index(channel)
        gone = score([t for t in tests if t is not test])[k] - whole[k]
        removable = before[k] - floor[k]
        part = gone / removable if removable > 0.1 * before[k] else 0.0
        if part >= share:
            said.append(
                {"channel": channel, "where": where, "share": float(part), "since": test.offer.since,
                 "evidence": {"p": test.p, "wald": test.wald}}
            )  # fmt: skip
    return sorted(said, key=lambda u: -u["share"]), whole


def _pseudo(flights: Sequence[Evidence]) -> dict[str, Effect]:
    """One offer per channel and variable that every flight has."""
    known = [places(f) for f in flights]
    found = {}
    for where in known[0]:
        if not all(where in k for k in known):
            continue
        low, high = np.quantile(np.concatenate([k[where] for k in known]), EDGES)
        if where not in PERIODIC and not high - low > APART * max(abs(high), abs(low), 1e-9):
            continue
        for channel in AXES:
            name = f"{channel} along {where}"
            labels = ("sin", "cos", "sin2", "cos2") if where in PERIODIC else ("first", "second", "third")
            found[name] = Effect(
                id=name, level="W", sentence="", equation="", source="",
                parameters={label: Parameter("", 0.0, "s", -1e9, 1e9) for label in labels},
                columns=_columns(channel, where, float(low), float(high), labels), parts="all",
            )  # fmt: skip
    return found


def _columns(channel: str, where: str, low: float, high: float, labels: Sequence[str]) -> Callable:
    def columns(flight: Evidence, _: Mapping[str, float]) -> dict[str, np.ndarray]:
        x = places(flight)[where]
        if where in PERIODIC:
            parts = [np.sin(x), np.cos(x), np.sin(2 * x), np.cos(2 * x)]
        else:
            x = np.clip(2.0 * (x - low) / (high - low) - 1.0, -1.0, 1.0)
            parts = [x, 1.5 * x**2 - 0.5, 2.5 * x**3 - 1.5 * x]
        return {label: flight.only(channel, part) for label, part in zip(labels, parts)}

    return columns
