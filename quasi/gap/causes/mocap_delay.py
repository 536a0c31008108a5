"""A captured rotation late behind the captured position.

Rotations are compared with the gyro and positions with the accelerometer: one of these filtered later, by more than
filters that no header states, looks much the same.
"""

from quasi.gap.effect import Effect, Parameter, Sensor

EFFECT = Effect(
    id="mocap_delay",
    level="sensors",
    sentence="the capture's rotation is late behind its position, or the accelerometer is filtered later than the gyro",
    opposite="the capture's rotation runs ahead of its position, or the gyro is filtered later than the accelerometer",
    equation="captured attitude(t) = true attitude(t - delay)",
    source="definition",
    parameters={"delay": Parameter("s", 0.0, "s", -0.1, 0.1, 0.01)},
    channels=("p", "q", "r", "ax", "ay", "az"),
    rivals=("clock_drift",),
    tie_breaker="sharp turns about all axes",
    parts="all",
    sensor=Sensor(
        spread=3e-4,  # s: an undeclared filter is 0 to 1 ms late, uniform: 1 ms / sqrt(12)
        common=5e-4,  # s: filters and decimation of the sensors, which no header states
        linear=0.003,
        needs_attitude=True,
        without_attitude=0.02,
    ),
    corrects=("capture", "rotation delay"),
)
