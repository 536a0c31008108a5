"""A cable that pulls."""

from quasi.gap.effect import Effect, Parameter, Terms, Vehicle

_R = {  # rows of the rotation from body to earth, 3-2-1 angles
    "x": ("cos[pitch]*cos[yaw]", "(sin[roll]*sin[pitch]*cos[yaw] - cos[roll]*sin[yaw])",
          "(cos[roll]*sin[pitch]*cos[yaw] + sin[roll]*sin[yaw])"),
    "y": ("cos[pitch]*sin[yaw]", "(sin[roll]*sin[pitch]*sin[yaw] + cos[roll]*cos[yaw])",
          "(cos[roll]*sin[pitch]*sin[yaw] - sin[roll]*cos[yaw])"),
    "z": ("(-sin[pitch])", "(sin[roll]*cos[pitch])", "(cos[roll]*cos[pitch])"),
}  # fmt: skip


def _terms(_: Vehicle) -> dict[str, Terms]:
    axes = ("Fx", "Fy", "Fz")
    return {"k": {axis: " + ".join(f"-{e}*{_R[e][k]}" for e in "xyz") for k, axis in enumerate(axes)}}


EFFECT = Effect(
    id="tether",
    level="W",
    sentence="a cable pulls towards the place where it is fixed, the origin of the room",
    equation="F = -k (x, y, z) in earth axes",
    source="Hooke's law",
    parameters={"k": Parameter("N/m", 0.0, "s", 0.0, 5.0)},
    channels=("Fx", "Fy", "Fz"),
    rivals=("ground_effect", "wind", "mass"),
    tie_breaker="slow climbs to several heights, at several places",
    terms=_terms,
)
