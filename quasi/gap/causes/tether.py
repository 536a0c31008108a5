"""A cable that pulls."""

from quasi.gap.effect import EARTH, Effect, Parameter, Terms, Vehicle


def _terms(_: Vehicle) -> dict[str, Terms]:
    axes = ("Fx", "Fy", "Fz")
    return {"k": {axis: " + ".join(f"-{e}*{EARTH[e][k]}" for e in "xyz") for k, axis in enumerate(axes)}}


EFFECT = Effect(
    id="tether",
    level="forces",
    sentence="a cable pulls towards the place where it is fixed, the origin of the room",
    equation="F = -k (x, y, z) in earth axes",
    source="Hooke's law",
    parameters={"k": Parameter("N/m", 0.0, "s", 0.0, 5.0, lambda v: 0.047 * v.weight)},
    channels=("Fx", "Fy", "Fz"),
    rivals=("ground_effect", "wind", "mass"),
    tie_breaker="slow climbs to several heights, at several places",
    terms=_terms,
    absent_when_healthy=True,
)
