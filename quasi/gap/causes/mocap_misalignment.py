"""A marker frame turned against the body."""

import math

from quasi.gap.effect import Effect, Parameter, Sensor

EFFECT = Effect(
    id="mocap_misalignment",
    level="sensors",
    sentence="the markers' frame is turned against the body",
    equation="captured attitude = true attitude exp(misalignment)",
    source="rigid-body kinematics",
    parameters={axis: Parameter("rad", 0.0, "s", -0.5, 0.5, 0.0175) for axis in ("roll", "pitch", "yaw")},
    channels=("p", "q", "r", "ax", "ay", "az"),
    rivals=("imu_misalignment", "room_tilt"),
    tie_breaker="correct either ('sensor calibration' of the quadrotor's configuration) and compare what the model "
    "leaves of forces and moments",
    parts="all",
    sensor=Sensor(spread=math.radians(0.3), linear=0.01, needs_attitude=True),  # seating of the markers
    corrects=("capture", "misalignment"),
)
