"""A constant error of the gyro."""

from quasi.gap.effect import Effect, Parameter, Sensor

EFFECT = Effect(
    id="gyro_bias",
    level="sensors",
    sentence="the gyro reads too much or too little, by a constant",
    equation="measured = true + bias, body axes",
    source="Titterton & Weston, 2nd ed., 2004, section 4.4",
    parameters={axis: Parameter("rad/s", 0.0, "f", -1.0, 1.0, 0.03) for axis in ("x", "y", "z")},
    channels=("p", "q", "r"),
    rivals=("gyro_scale", "mocap_misalignment"),
    tie_breaker="some seconds of rest, and turns both ways",
    parts="all",
    sensor=Sensor(spread=0.012, needs_attitude=True),  # rad/s after turning on, data sheets of MEMS gyros
    corrects=("imu", "gyro bias"),
)
