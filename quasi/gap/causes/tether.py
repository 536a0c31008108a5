"""A cable that pulls."""

from quasi.gap.effect import EARTH, Effect, Parameter, Terms, Vehicle

PULLS = ("north", "east")


def _terms(_: Vehicle) -> dict[str, Terms]:
    axes = ("Fx", "Fy", "Fz")
    pull = {"k": {axis: " + ".join(f"-{e}*{EARTH[e][k]}" for e in "xyz") for k, axis in enumerate(axes)}}
    # what it pulls with at the origin: nothing where it is fixed there
    return pull | {name: {axis: EARTH[e][k] for k, axis in enumerate(axes)} for name, e in zip(PULLS, "xy")}


EFFECT = Effect(
    id="tether",
    level="forces",
    sentence="a cable pulls towards the point of the floor where it is fixed",
    equation="F = -k (x, y, z) + (north, east, 0) in earth axes: fixed at (north, east, 0) / k",
    source="Hooke's law",
    parameters={
        "k": Parameter("N/m", 0.0, "s", 0.0, 5.0, lambda v: 0.047 * v.weight),
        **{name: Parameter("N", 0.0, "s", -20.0, 20.0) for name in PULLS},
    },
    channels=("Fx", "Fy", "Fz"),
    rivals=("ground_effect", "wind", "mass"),
    tie_breaker="slow climbs to several heights, at several places",
    terms=_terms,
    parts="first",
    absent_when_healthy=True,
)
