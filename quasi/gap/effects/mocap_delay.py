"""A captured rotation late behind the captured position."""

from quasi.gap.effect import Effect, Parameter

EFFECT = Effect(
    id="mocap_delay",
    level="K",
    sentence="the capture's rotation is late behind its position",
    opposite="the capture's rotation runs ahead of its position",
    equation="captured attitude(t) = true attitude(t - delay)",
    source="definition",
    parameters={"delay": Parameter("s", 0.0, "s", -0.1, 0.1, 0.01)},
    channels=("p", "q", "r", "ax", "ay", "az"),
    rivals=("clock_drift",),
    tie_breaker="sharp turns about all axes",
)
