"""Which causes a trajectory could reveal, and which manoeuvres are missing.

Every cause has a typical size. For it, the expected |t| is worked out with the machinery that names causes, from the
trajectory's columns and from noise: that of a flown flight's own residual, or a usual one where nothing has flown yet.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.errors import ConfigError, DataError
from quasi.gap.effect import Effect, Room, Vehicle, vehicle_of
from quasi.gap.flights.evidence import RATE, REQUIRED, Evidence
from quasi.gap.flights.gathering import gather
from quasi.gap.levels.forces.design import ORDER, Design, gather_design, in_stretches
from quasi.gap.levels.sensors_and_drive import rate_of
from quasi.gap.planning import plan_noise
from quasi.gap.planning import sensors_and_drive as plan_lower
from quasi.gap.planning.flatness import planned, read_plan, with_forces
from quasi.gap.planning.manoeuvres import Manoeuvre, library
from quasi.gap.planning.outlook import Outlook, Repeated, Row, Sight
from quasi.gap.statistics.blocks import BLOCK
from quasi.gap.statistics.whitening import Whitener, block_grams
from quasi.model.columns import ROTORS
from quasi.model.model import AXES, Model

LEAST_RAISE = 1.2  # a manoeuvre is proposed where it raises what is expected by this factor at least
TRIAL_HEIGHT = 1.5  # m, at which manoeuvres are tried where the flights have no position
LIMIT = 200  # flights: what is drawn for each stands in one matrix
HALFWAY = 0.5  # of what is needed: less is no help
SEED = 0
USUAL_NOISE = "usual for made flights with gusts of 0.1-0.4 m/s, in shares of weight and of weight times arm"
OWN_NOISE = "what the model leaves of these flights' own forces and moments"


class Flight(NamedTuple):
    """A flight to be judged: columns of a filtered flight, and whether its forces were measured."""

    key: str
    columns: pd.DataFrame
    measured: bool


@dataclass(frozen=True)
class Proposal:
    """A manoeuvre to add and what it makes of causes: {id: (before, after)}."""

    manoeuvre: Manoeuvre
    raises: Mapping[str, tuple[Sight, Sight]]


@dataclass
class Card:
    """What a plan could reveal.

    seconds    of a flight; compared, reference  how many are flown; noise  where it is from
    rows       in the order of verdict and expected |t|
    best       {id: what is expected with the manoeuvre that helps most}; after  alike with all proposals flown
    not_asked  {id: why}; notes  sentences
    """

    model: str
    flights: list[str]
    seconds: float
    compared: int
    reference: int
    noise: str
    rows: list[Row]
    proposals: list[Proposal] = field(default_factory=list)
    best: dict[str, Sight] = field(default_factory=dict)
    after: dict[str, Sight] = field(default_factory=dict)
    not_asked: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


WHY_NOT_PLANNED = {
    "attitude_error": "only on flights without captured attitude, and its file gives no typical size",
    "rotor_order": "has no size: any flight with roll, pitch and yaw inputs shows it",
    "marker_offset": "looks like the imu lever arm, which represents it: forces and moments distinguish the two",
}


class Judge(NamedTuple):
    """One level: its causes, cross-products (K, ...) of each flight, those of a further manoeuvre as if flown in each,
    how they are put together within a flight, and the tests on them."""

    effects: Mapping[str, Effect]
    flights: list[np.ndarray]
    of: Callable[[Manoeuvre], list[np.ndarray]]
    joined: Callable[[Sequence[np.ndarray]], np.ndarray]
    outlook: Callable[[Sequence[Repeated]], Outlook]


def read_flight(table: pd.DataFrame, model: Model, where: str, simulated: bool = False) -> Flight:
    """A flown flight, a simulation or a planned trajectory, distinguished by their columns.

    A filtered flight holds measured forces and moments; states and rotor speeds without them, or of a simulation, are
    taken as they are, with the model's forces; t, x, y, z and yaw are followed by the model.
    Raises DataError for a table that is none of these.
    """
    states = [n for n in REQUIRED if n not in AXES and not n.endswith("_dot")]
    if not set(states) <= set(table):
        return Flight(where, planned(*read_plan(table, where), model, where), False)
    t = table["t"].to_numpy(float) if "t" in table else np.zeros(0)
    if len(t) < 2 or not np.all(np.diff(t) > 0.0):
        raise DataError(f"{where}: times do not grow from row to row; give a column 't' that does, s")
    slopes = {f"{w}_dot": np.gradient(table[w].to_numpy(float), t) for w in ROTORS if f"{w}_dot" not in table}
    table = table.assign(**slopes)
    if set(AXES) <= set(table) and not simulated:
        return Flight(where, table, True)
    return Flight(where, with_forces(table, model), False)


def examine(
    flights: Sequence[Flight],
    model: Model,
    effects: Mapping[str, Effect],
    compared: int = 4,
    reference: int = 0,
    rate: float = 0.01,
    noise: tuple[Whitener, str] | None = None,
    propose: bool = True,
    metadata: Mapping[str, Any] | None = None,
    room: Room | None = None,
) -> Card:
    """Make the card.

    flights    flown in turn until there are `compared` ones that may hold a cause, and `reference` ones believed clean
    rate       false alarm rate of the diagnosis, shared as `lower` has it
    noise      whitener of what is left of forces and moments and a sentence on it; without one, of the flights'
               own residuals where all are measured, else the usual one
    metadata   of the flights as processed: "mass", "inertia"
    Raises ConfigError for fewer than two compared flights, DataError for flights that cannot be judged.
    """
    if compared < 2 or reference < 0:
        raise ConfigError(
            f"a plan for {compared} compared and {reference} reference flights, expected at least 2 and 0: one flight "
            "cannot distinguish a cause from normal differences between flights"
        )
    if compared + reference > LIMIT:
        raise ConfigError(
            f"a plan for {compared} compared and {reference} reference flights, expected at most {LIMIT} together"
        )
    if len(flights) > max(compared, reference):
        raise ConfigError(
            f"{len(flights)} trajectories are planned for {compared} compared and {reference} reference flights, "
            "expected no more trajectories than flights; raise --flights, or leave trajectories out"
        )
    about = dict(metadata or {})
    inertia = np.asarray(about["inertia"], float) if "inertia" in about else None
    vehicle = vehicle_of(model, about.get("mass"), inertia, room)
    evidence = [gather(f.key, f.columns, about, model.airframe, model, RATE) for f in flights]
    seconds = float(np.mean([e.t[-1] - e.t[0] for e in evidence]))
    shares = [(len(range(k, compared, len(flights))), len(range(k, reference, len(flights)))) for k in
              range(len(flights))]  # fmt: skip
    asked = {n: e for n, e in effects.items() if not e.finding and e.typical(vehicle)}
    card = Card(model.id, [f.key for f in flights], seconds, compared, reference, "", [])
    card.not_asked = {
        n: WHY_NOT_PLANNED.get(n, "its file gives no typical size")
        for n, e in effects.items()
        if not e.finding and n not in asked
    }
    if len({f.measured for f in flights}) > 1:
        card.notes.append("the flown flights' own forces are not used, for the others have not flown yet")
    for one in evidence:
        if "z" not in one.columns:
            card.notes.append(f"{one.key} has no position: causes that depend on height or place are not judged")
            continue
        low = np.flatnonzero(one.columns["z"] > -model.airframe.radius)
        if len(low):
            card.notes.append(
                f"{one.key}: the vehicle is less than a rotor's radius above the floor (z = 0) at t = "
                f"{one.t[low[0]]:.1f} s; the result for ground effect is not reliable there"
            )
    rate = rate_of(rate, compared, 1)  # one more flight like these is held out
    judges = [_wrench(flights, evidence, shares, model, asked, vehicle, rate, noise, card)]
    for make in (_sensors, _drives):
        judge = make(flights, model, asked, rate, card)
        judges += [judge] if judge else []
    rows = [row for judge in judges for row in _rows(_look(judge, shares, []), judge.effects, vehicle)]
    card.rows = _sorted(plan_lower.judged_by_motion(rows))
    if propose:
        located = {"x", "y", "z"} <= set(evidence[0].columns)
        place = np.median(evidence[0].take("x", "y", "z"), axis=0) if located else np.array([0.0, 0.0, -TRIAL_HEIGHT])
        _propose(card, judges, shares, library(model, place, float(evidence[0].columns["yaw"][0])), vehicle)
    return card


def _wrench(
    flights: Sequence[Flight], evidence: Sequence[Evidence], shares: Sequence[tuple[int, int]], model: Model,
    asked: Mapping[str, Effect], vehicle: Vehicle, rate: float, noise: tuple[Whitener, str] | None, card: Card,
) -> Judge:  # fmt: skip
    effects = {n: e for n, e in asked.items() if e.level == "forces"}
    study = gather_design(evidence, effects, vehicle)
    effects = {n: effects[n] for n in study.columns.causes}
    measured = all(f.measured for f in flights)
    if noise is None and measured:
        noise = study.whitener, OWN_NOISE
    elif noise is None:
        noise = plan_noise.usual(vehicle, 1.0 / float(np.median(np.diff(evidence[0].t)))), USUAL_NOISE
    whitener, card.noise = noise
    card.not_asked |= study.lacking
    extra = {c: float(np.median(v)) for c, v in evidence[0].columns.items()}

    numbers = [plan_noise.NOISE_DRAWS * sum(share) for share in shares]
    rng = np.random.default_rng(SEED)

    def of(manoeuvre: Manoeuvre) -> list[np.ndarray]:
        flight = manoeuvre.flight
        flight = flight.assign(**{c: v for c, v in extra.items() if c not in flight})
        one = gather(manoeuvre.name, flight, evidence[0].metadata, model.airframe, model, RATE)
        own = gather_design([one], effects, vehicle, idle=True)  # with the columns of the flights
        return [_stretches(own, 0, whitener, False, model, number, rng) for number in numbers]

    return Judge(
        effects,
        [_stretches(study, k, whitener, measured, model, number, rng) for k, number in enumerate(numbers)],
        of,
        np.concatenate,
        lambda flown: Outlook(flown, study.columns, len(study.names), plan_noise.NOISE_DRAWS, effects, rate),
    )


def _stretches(
    study: Design, k: int, whitener: Whitener, measured: bool, model: Model, number: int, rng: np.random.Generator
) -> np.ndarray:
    """Cross-products of a flight's stretches with `number` residuals like its own, or drawn ones."""
    part, t, columns = study.thinned[k], study.flights[k].t, study.columns
    whole = in_stretches(block_grams(part.columns, part.breaks, whitener, t[part.rows], BLOCK))
    if measured:
        return plan_noise.repeated(whole, columns.shared, columns.nuisance, columns.spread, number, rng)
    rows = 6 * max(len(part.rows) - ORDER, 1) // len(whole)
    doubt = plan_noise.doubts(model)
    return np.array([plan_noise.drawn(gram, rows, columns.shared, doubt, number, rng) for gram in whole])


def _sensors(
    flights: Sequence[Flight], model: Model, asked: Mapping[str, Effect], rate: float, card: Card
) -> Judge | None:
    effects = {n: e for n, e in asked.items() if e.level == "sensors"}
    try:
        found = [plan_lower.sensed(f.columns, model) for f in flights]
    except DataError as error:
        card.not_asked |= dict.fromkeys(effects, str(error))
        return None
    names = found[0][1]
    there = {n.split(".")[0] for n in names}
    card.not_asked |= {n: WHY_NOT_PLANNED.get(n, "no closed form of what it shows") for n in effects if n not in there}
    effects = {n: e for n, e in effects.items() if n in there}
    return Judge(
        effects,
        [gram for gram, _ in found],
        lambda manoeuvre: [plan_lower.sensed(manoeuvre.flight, model)[0]] * len(flights),
        lambda parts: np.sum(parts, axis=0),
        lambda flown: plan_lower.sensor_outlook(flown, names, effects, rate),
    )


def _drives(
    flights: Sequence[Flight], model: Model, asked: Mapping[str, Effect], rate: float, card: Card
) -> Judge | None:
    effects = {n: e for n, e in asked.items() if n in plan_lower.DRIVES}
    card.not_asked |= {
        n: "no closed form of what it shows" for n, e in asked.items() if e.level == "drive" and n not in effects
    }
    if not all("battery_voltage" in f.columns for f in flights) and effects.pop("battery_sag", None):
        card.not_asked["battery_sag"] = "no battery voltage is known"
    if not effects:
        return None
    return Judge(
        effects,
        [plan_lower.driven(f.columns, model) for f in flights],
        lambda manoeuvre: [plan_lower.driven(manoeuvre.flight, model)] * len(flights),
        lambda parts: np.sum(parts, axis=0),
        lambda flown: plan_lower.drive_outlook(flown, model, effects, rate),
    )


def _look(judge: Judge, shares: Sequence[tuple[int, int]], extra: Sequence[Sequence[np.ndarray]]) -> Outlook:
    """The tests of a level with manoeuvres added to every flight. extra  (manoeuvre, flight)"""
    parts = [[own, *(part[k] for part in extra)] for k, own in enumerate(judge.flights)]
    return judge.outlook([Repeated(judge.joined(p), *share) for p, share in zip(parts, shares) if any(share)])


def _rows(outlook: Outlook, effects: Mapping[str, Effect], vehicle: Vehicle, only: Sequence[str] = ()) -> list[Row]:
    result = []
    for name in only or outlook.columns.causes:
        sizes = effects[name].typical(vehicle).items()
        sights = tuple(outlook.sight(name, parameter, size) for parameter, size in sizes)
        result.append(Row(effects[name], min(sights, key=_merit), sights))
    return result


def _sorted(rows: Sequence[Row]) -> list[Row]:
    order = {"seen": 0, "tie": 1, "not seen": 2}
    return sorted(rows, key=lambda r: (order[r.sight.verdict], -r.sight.t))


def _merit(sight: Sight) -> float:
    """What is expected over what is needed, alone or with the rival, whichever is less."""
    return min(sight.t, sight.with_rival) / sight.needed


def _helps(before: Sight, after: Sight) -> bool:
    return _merit(after) > max(LEAST_RAISE * _merit(before), HALFWAY)


def _propose(
    card: Card, judges: Sequence[Judge], shares: Sequence[tuple[int, int]], options: Sequence[Manoeuvre],
    vehicle: Vehicle,
) -> None:  # fmt: skip
    """Try every manoeuvre of the library after each flight, and keep those that show more."""
    open_ = {r.effect.id: r for r in card.rows if r.sight.verdict != "seen" and not r.sight.absorbed}
    if not open_ or not options:
        return
    added = [[judge.of(m) for m in options] for judge in judges]
    looks: list[dict[str, Sight]] = []
    for k in range(len(options)):
        found: list[Row] = []
        for judge, parts in zip(judges, added):
            outlook = _look(judge, shares, [parts[k]])
            # late telemetry is tested too: it decides about a late command
            names = [n for n in judge.effects if n in open_ or n in plan_lower.PAIR]
            for row in (r for r in card.rows if r.effect.id in names and not r.sight.absorbed):
                sights = tuple(
                    outlook.look(s.cause, s.parameter, s.size, [s.rival] if s.rival else []) for s in row.all
                )
                found.append(Row(row.effect, min(sights, key=_merit), sights))
        looks.append({r.effect.id: r.sight for r in plan_lower.judged_by_motion(found) if r.effect.id in open_})
    chosen = _chosen(open_, looks)
    best = {n: max(chosen, key=lambda k: _merit(looks[k][n])) for n in open_} if chosen else {}
    for k in chosen:
        names = [n for n in open_ if best[n] == k and _helps(open_[n].sight, looks[k][n])]
        # every rival is tested where one is reported
        rows = []
        for judge, parts in zip(judges, added):
            asked = [
                n for n in judge.effects if n in names or (n in plan_lower.PAIR and set(plan_lower.PAIR) & set(names))
            ]
            rows += _rows(_look(judge, shares, [parts[k]]), judge.effects, vehicle, asked) if asked else []
        looks[k] |= {r.effect.id: r.sight for r in plan_lower.judged_by_motion(rows) if r.effect.id in names}
        raises = {n: (open_[n].sight, looks[k][n]) for n in names if _helps(open_[n].sight, looks[k][n])}
        if raises:
            card.proposals.append(Proposal(options[k], raises))
    card.best = {n: max([open_[n].sight, *(looks[k][n] for k in chosen)], key=_merit) for n in open_}
    flown = [options.index(p.manoeuvre) for p in card.proposals] if card.proposals else []
    rows = []
    for judge, parts in zip(judges, added):
        names = [n for n in judge.effects if n in open_ or n in plan_lower.PAIR]
        if flown and names:
            rows += _rows(_look(judge, shares, [parts[k] for k in flown]), judge.effects, vehicle, names)
    card.after = {r.effect.id: r.sight for r in plan_lower.judged_by_motion(rows) if r.effect.id in open_}


def _chosen(open_: Mapping[str, Row], looks: Sequence[Mapping[str, Sight]]) -> list[int]:
    """Few manoeuvres that together show what any one of them shows, the one that shows most first.

    For a cause that none of them shows, the one that helps most is added, where one helps.
    """
    left, chosen = set(open_), []
    while left:
        shown = [{n for n in left if look[n].verdict == "seen"} for look in looks]
        best = max(range(len(looks)), key=lambda k: (len(shown[k]), sum(_merit(looks[k][n]) for n in sorted(left))))
        if not shown[best]:
            break
        chosen.append(best)
        left -= shown[best]
    for cause in sorted(left):
        best = max(range(len(looks)), key=lambda k: _merit(looks[k][cause]))
        if best not in chosen and _helps(open_[cause].sight, looks[best][cause]):
            chosen.append(best)
    return chosen
