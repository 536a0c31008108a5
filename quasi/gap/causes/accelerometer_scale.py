"""An accelerometer that reads in proportion too much."""

from quasi.gap.effect import Effect, Parameter, Sensor

EFFECT = Effect(
    id="accelerometer_scale",
    level="sensors",
    sentence="the accelerometer reads too much or too little, in proportion",
    equation="measured_i = scale_i true_i, body axes; one scale where one is enough for all axes",
    source="Titterton & Weston, 2nd ed., 2004, section 6.3",
    parameters={axis: Parameter("1", 1.0, "a", 0.7, 1.3, 0.01) for axis in ("x", "y", "z")},
    channels=("ax", "ay", "az"),
    rivals=("mass", "thrust_factor", "accelerometer_bias"),
    tie_breaker="climbs and dives with a large range of thrust",
    parts="alike",
    sensor=Sensor(spread=5e-4, linear=0.01, without_attitude=0.3),
    corrects=("imu", "accelerometer scale"),
)
