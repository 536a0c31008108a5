"""An on-board clock that runs fast or slow."""

from quasi.gap.effect import Effect, Parameter, Sensor

EFFECT = Effect(
    id="clock_drift",
    level="sensors",
    sentence="the on-board clock runs fast",
    opposite="the on-board clock runs slow",
    equation="t_board = (1 + rate) t",
    source="definition",
    parameters={"rate": Parameter("s/s", 0.0, "f", -0.05, 0.05, 3e-4)},
    channels=("clock",),
    rivals=("gyro_scale",),
    tie_breaker="a longer flight",
    parts="all",
    sensor=Sensor(spread=3.5e-5),  # two quartz clocks of 25 ppm each
    corrects=("clock", "rate"),
)
