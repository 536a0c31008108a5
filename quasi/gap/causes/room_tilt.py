"""A room whose axes are tilted against gravity."""

from quasi.gap.effect import Effect, Parameter, Sensor

EFFECT = Effect(
    id="room_tilt",
    level="sensors",
    sentence="the capture's axes are tilted against gravity",
    equation="captured = exp(-tilt) true, earth axes",
    source="rigid-body kinematics",
    parameters={axis: Parameter("rad", 0.0, "s", -0.3, 0.3, 0.0175) for axis in ("roll", "pitch")},
    channels=("ax", "ay"),
    rivals=("accelerometer_bias", "wind", "mocap_misalignment"),
    tie_breaker="turn through all headings in hover",
    parts="all",
    sensor=Sensor(spread=5e-4, linear=0.02, needs_attitude=True, without_attitude=0.02),
    corrects=("capture", "room tilt"),
)
