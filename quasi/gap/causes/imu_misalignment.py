"""An IMU turned against the body."""

import math

from quasi.gap.effect import Effect, Parameter, Sensor

EFFECT = Effect(
    id="imu_misalignment",
    level="sensors",
    sentence="accelerometer and gyro are turned against the body",
    equation="measured = exp(misalignment)' true",
    source="Titterton & Weston, 2nd ed., 2004, section 4.4",
    parameters={axis: Parameter("rad", 0.0, "s", -0.5, 0.5, 0.0175) for axis in ("roll", "pitch", "yaw")},
    channels=("p", "q", "r", "ax", "ay", "az"),
    rivals=("mocap_misalignment", "rotor_tilt"),
    tie_breaker="correct either ('sensor calibration' of the quadrotor's configuration) and compare what the model "
    "leaves of forces and moments",
    parts="all",
    sensor=Sensor(spread=math.radians(0.2), linear=0.01, needs_attitude=True),  # seating of the IMU
    corrects=("imu", "misalignment"),
)
