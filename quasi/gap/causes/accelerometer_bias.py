"""A constant error of the accelerometer."""

from quasi.gap.effect import Effect, Parameter, Sensor

EFFECT = Effect(
    id="accelerometer_bias",
    level="sensors",
    sentence="the accelerometer reads too much or too little, by a constant",
    equation="measured = true + bias, body axes",
    source="Titterton & Weston, 2nd ed., 2004, section 6.3",
    parameters={axis: Parameter("m/s2", 0.0, "f", -5.0, 5.0, 0.2) for axis in ("x", "y", "z")},
    channels=("ax", "ay", "az"),
    rivals=("room_tilt", "wind", "mocap_misalignment"),
    tie_breaker="turn through all headings in hover",
    parts="all",
    sensor=Sensor(spread=0.08, needs_attitude=True),  # m/s2 after turning on, data sheets of MEMS sensors
    corrects=("imu", "accelerometer bias"),
)
