"""A gyro that reads in proportion too much."""

from quasi.gap.effect import Effect, Parameter, Sensor

EFFECT = Effect(
    id="gyro_scale",
    level="sensors",
    sentence="the gyro reads too much or too little, in proportion",
    equation="measured_i = scale_i true_i, body axes",
    source="Titterton & Weston, 2nd ed., 2004, section 4.4",
    parameters={axis: Parameter("1", 1.0, "a", 0.7, 1.3, 0.01) for axis in ("x", "y", "z")},
    channels=("p", "q", "r"),
    rivals=("inertia", "clock_drift"),
    tie_breaker="sharp turns about all axes",
    parts="all",
    sensor=Sensor(spread=5e-4, linear=0.01, needs_attitude=True),
    corrects=("imu", "gyro scale"),
)
