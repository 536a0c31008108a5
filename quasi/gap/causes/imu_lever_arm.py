"""An IMU away from the centre of gravity."""

from quasi.gap.effect import Effect, Parameter, Sensor

EFFECT = Effect(
    id="imu_lever_arm",
    level="sensors",
    sentence="the inertial sensors sit away from where the model takes the centre of gravity to be",
    equation="a = a_cg + wdot x r + w x (w x r)",
    source="rigid-body kinematics",
    parameters={axis: Parameter("m", 0.0, "a", -0.15, 0.15, 0.01) for axis in ("x", "y", "z")},
    channels=("ax", "ay", "az"),
    rivals=("cg_offset", "wind"),
    tie_breaker="sharp turns about all axes",
    parts="all",
    sensor=Sensor(spread=1e-3),  # m: a marker set that is taken off comes back to about a millimetre
    corrects=("imu", "lever arm"),
)
