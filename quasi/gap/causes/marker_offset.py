"""Markers that sit elsewhere than configured."""

from quasi.gap.effect import Effect, Parameter

EFFECT = Effect(
    id="marker_offset",
    level="sensors",
    sentence="the motion capture tracks a point away from where it is configured",
    equation="captured position = position of the cg + R (configured + offset)",
    source="rigid-body kinematics",
    parameters={axis: Parameter("m", 0.0, "a", -0.15, 0.15, 0.01) for axis in ("x", "y", "z")},
    channels=("ax", "ay", "az"),
    rivals=("imu_lever_arm", "cg_offset"),
    tie_breaker="sharp turns about all axes, compared with a model that was identified from other flights",
    corrects=("capture", "marker offset"),
)
