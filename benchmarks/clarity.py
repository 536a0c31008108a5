"""How clearly what was hidden in flights shows, computed from the truth: detectability and separability.

Detectability is the |t| that the true size has, given the noise of the flights, once the model's own terms, what
flights differ by and the spread of the cause between manoeuvres are projected out; separability is the same with the
nearest other cause of its level projected out as well.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from hidden import DRIVE, SENSORS, STRANGE, deviation

from quasi import attitude
from quasi.gap.effect import Effect, Parameter, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.gap.flights.level import Level, SensorMixedModel, offers_of
from quasi.gap.levels.forces.design import Design, gather_design
from quasi.gap.levels.sensors import identify as sensor_level
from quasi.gap.statistics.blocks import BLOCK
from quasi.gap.statistics.candidates import Candidate
from quasi_synthesis.physics import BEAT, FAN, FAN_WIDTH, SHIFT
from quasi_synthesis.vehicle import base_vehicle

_P = base_vehicle().physics
HEALTHY = {"up": _P.lag_up, "down": _P.lag_down, "exponent": 1.0}  # the made vehicle's drive
LENGTHS = (10.0, 15.0, 20.0)  # s, of the beginnings of flights
NOTHING = {"detectability": 0.0, "separability": 0.0, "nearest": None, "of the error": None}


class Asked(NamedTuple):
    """What the search worked on: columns and flights of forces and moments, which flights are compared, sensors and
    drive.

    own  whether the model was made of the compared flights: then it holds their drive as it was
    """

    study: Design
    vehicle: Vehicle
    compared: np.ndarray
    effects: Mapping[str, Effect]
    levels: Sequence[Level]
    own: bool


def clarity(name: str, values: Mapping[str, float], asked: Asked) -> dict[str, Any]:
    """{"detectability", "separability", "nearest", "of the error"} of a planted cause.

    separability None for what has no name; of the error, see `of_the_error`, None for sensors and drive
    """
    since = "always" if asked.compared.all() else "changed"
    if name in DRIVE and asked.own:
        return NOTHING
    if name in SENSORS or name in DRIVE:
        return _lower(name, values, asked.levels, since)
    if name in STRANGE:
        study = _strange(name, asked)
        offer, size = Candidate(name, since, (0,)), np.array([values["size"]])
        return {"detectability": _shown(study, offer, size, asked, []), "separability": None, "nearest": None,
                "of the error": of_the_error(study, offer, size, asked)}  # fmt: skip
    effect, columns = asked.effects.get(name), asked.study.columns
    if effect is None or name not in columns.causes or (effect.absorbed_by_model and since == "always"):
        return NOTHING
    true = deviation(name, values)
    which = tuple(effect.fitted.index(k) for k in true if k in effect.fitted)
    theta = np.array([true[effect.fitted[k]] for k in which])

    def shown(given: Sequence[Candidate], study: Design) -> float:
        return _shown(study, Candidate(name, since, which), theta, asked, given)

    beside = {
        other: shown([Candidate(other, since, tuple(range(len(own))))], asked.study)
        for other, own in columns.causes.items()
        if other != name and not (asked.effects[other].absorbed_by_model and since == "always")
    }
    nearest = min(beside, key=beside.get)
    shorter = {f"{t:g}": shown([], _begun(asked.study, t)) for t in LENGTHS}
    return {"detectability": shown([], asked.study), "separability": beside[nearest], "nearest": nearest,
            "of shorter flights": shorter,
            "of the error": of_the_error(asked.study, Candidate(name, since, which), theta, asked)}  # fmt: skip


def _shown(study: Design, offer: Candidate, theta: np.ndarray, asked: Asked, given: Sequence[Candidate]) -> float:
    """|t| of the true deviations theta of an offer, beside others that are given."""
    mixed = study.mixed(range(len(asked.compared)), asked.compared)
    test = mixed.test(offer, given, mixed.pooled(offer.since))
    return float(np.sqrt(max(theta @ np.linalg.solve(test.covariance, theta), 0.0)))


def of_the_error(study: Design, offer: Candidate, theta: np.ndarray, asked: Asked) -> float:
    """Share of the compared flights' squared error that the true deviations make, of the channel where it is largest.

    What a model made of these flights could take up by its own terms is taken off by least squares.
    """
    own = [study.columns.causes[offer.cause][k] for k in offer.which]
    parts = [part.columns for part, flag in zip(study.thinned, asked.compared) if flag]
    made = np.concatenate([part[:, :, own] @ theta for part in parts])
    if asked.own:
        terms = np.concatenate([part[:, :, study.columns.shared] for part in parts])
        made = made - terms @ np.linalg.lstsq(terms.reshape(made.size, -1), made.ravel(), rcond=1e-10)[0]
    error = np.concatenate([part[:, :, 0] for part in parts])
    squares = np.mean(made**2, axis=0), np.mean(error**2, axis=0)
    # an axis that is left out has no error
    return float(np.divide(*squares, out=np.zeros_like(squares[0]), where=squares[1] > 0.0).max())


def _begun(study: Design, seconds: float) -> Design:
    """The study of the beginnings of its flights."""
    return study._replace(blocks=[b[: round(seconds / BLOCK)] for b in study.blocks])


def _lower(name: str, values: Mapping[str, float], levels: Sequence[Level], since: str) -> dict[str, Any]:
    """Of a cause of sensors or drive, by the tests of that level."""
    if name == "marker_offset":
        # the comparison of sensors sees the distance between markers and IMU; which of the two is off, only forces tell
        turned = _lower("imu_lever_arm", {k: -v for k, v in values.items()}, levels, since)
        return {**turned, "separability": 0.0, "nearest": "imu_lever_arm"}
    level = next(x for x in levels if x.level == ("sensors" if name in SENSORS else "drive"))
    if level.tests is None or name not in level.tests.columns.causes:
        return NOTHING
    size = sensor_level.size_of(name, values) if name in SENSORS else drive_size(name, values)
    shown = clear(level.tests, name, since, size)
    return {"detectability": shown.detectability, "separability": shown.separability, "nearest": shown.nearest,
            "of the error": None}  # fmt: skip


class Clear(NamedTuple):
    """Standard errors by which a cause of some size stands out: alone, and with each rival given."""

    detectability: float
    with_rival: dict[str, float]

    @property
    def nearest(self) -> str | None:
        """The rival with which it stands out least."""
        return min(self.with_rival, key=self.with_rival.get, default=None)

    @property
    def separability(self) -> float:
        """Standard errors with the nearest rival given."""
        return self.with_rival[self.nearest] if self.with_rival else self.detectability


def clear(mixed: SensorMixedModel, cause: str, since: str, size: np.ndarray) -> Clear:
    """How clearly a cause of a given size (m,) shows in the flights: sqrt(size' covariance^-1 size).

    size  deviation from healthy in the units of the cause's columns. The covariance is that of the cause's parameters
    once base, nuisances and the spread between flights are projected out, then the rival too.
    """
    offer = next(o for o in offers_of(mixed, since) if o.cause == cause)
    pooled = mixed.pooled(since)

    def shown(given: Sequence[Candidate]) -> float:
        covariance = mixed.test(offer, given, pooled).covariance
        return float(np.sqrt(max(size @ np.linalg.solve(covariance, size), 0.0)))

    return Clear(shown([]), {o.cause: shown([o]) for o in offers_of(mixed, since) if o.cause != cause})


def drive_size(cause: str, values: Mapping[str, float], healthy: Mapping[str, float] = HEALTHY) -> np.ndarray:
    """Deviation from healthy (m,) of parameters of the drive, in the units of the cause's columns.

    healthy  {"up", "down": s, "exponent": 1} of the reference that flights are compared with
    """
    if cause == "motor_lag":
        usual = 0.5 * (healthy["up"] + healthy["down"])
        return np.log([values.get("time_constant", usual) / usual * values.get(f"rotor{i}", 1.0) for i in range(1, 5)])
    if cause == "battery_sag":
        return np.array([values["exponent"] - healthy["exponent"]])
    return np.array([values["delay"]])


def _strange(name: str, asked: Asked) -> Design:
    """The study with an effect that has no name as a cause of its true form, as were it in the catalogue."""
    form = Effect(
        name, "forces", "", "", "", {"size": Parameter("1", 0.0, "a", -np.inf, np.inf)},
        columns=lambda flight, _: {"size": strange_force(name, 1.0, flight)},
    )  # fmt: skip
    known = {n: asked.effects[n] for n in asked.study.columns.causes}
    return gather_design(asked.study.flights, {**known, name: form}, asked.vehicle, asked.study.values)


def strange_force(name: str, size: float, flight: Evidence) -> np.ndarray:
    """Wrench (n, 6) of an effect without a name, as `quasi_synthesis.physics` has it."""
    c = flight.columns
    if name == "unlisted_heading":
        return flight.forces_only(np.outer(size * np.sin(2.0 * c["yaw"]) * flight.force[:, 2], [0.0, 0.0, 1.0]))
    if name == "unlisted_height":
        return flight.only("Fy", -size * c["z"])
    if name == "unlisted_twist":
        return flight.only("Mz", size * c["x"])
    if name == "unlisted_brake":
        return flight.only("My", -size * c["q"] ** 3)
    if name == "unlisted_shift":
        return flight.only("Mx", np.where(c["t"] - c["t"][0] > SHIFT, size, 0.0))
    earth = np.zeros((len(flight), 3))
    if name == "unlisted_beat":
        earth[:, 0] = size * np.sin(2.0 * np.pi * BEAT * c["t"])
    else:
        earth[:, 2] = -size * np.exp(-((c["x"] - FAN[0]) ** 2 + (c["y"] - FAN[1]) ** 2) / FAN_WIDTH**2)
    return flight.forces_only(attitude.rotate_inverse(flight.quaternion, earth))
