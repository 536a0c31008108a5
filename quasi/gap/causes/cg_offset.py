"""A centre of gravity away from the configured one."""

import numpy as np

from quasi.gap.effect import Effect, Extension, Parameter, Values, Vehicle
from quasi.gap.flights.evidence import Evidence
from quasi.model.model import Model


def _columns(evidence: Evidence, values: Values) -> dict[str, np.ndarray]:
    result, rates, offset = {}, evidence.rates, np.array([values.get(n, 0.0) for n in "xyz"])
    # the model turns the vehicle as if its cg were the configured one: a light vehicle by much more than it turns
    missing = -np.cross(offset, evidence.force)
    turning = evidence.angular_acceleration + np.linalg.solve(evidence.inertia, missing.T).T
    turning = turning - turning.mean(axis=0)  # rates stay bounded
    for k, name in enumerate("xyz"):
        arm = np.eye(3)[k]
        # the accelerometer was carried over to the configured cg
        carried = np.cross(turning, arm) + np.cross(rates, np.cross(rates, arm))
        result[name] = np.hstack([-evidence.mass * carried, -np.cross(arm, evidence.force)])
    return result


def _extension(values: Values, _: Vehicle, __: Model) -> Extension:
    return Extension(airframe={"cg offset": [values[name] for name in "xyz"]})


EFFECT = Effect(
    id="cg_offset",
    level="forces",
    sentence="the centre of gravity is not where it is configured (battery moved)",
    equation="dM = -r x F, r = true minus configured cg",
    source="statics",
    parameters={
        name: Parameter("m", 0.0, "s", -0.04, 0.04, None if name == "z" else lambda v: 0.026 * v.arm) for name in "xyz"
    },
    channels=("Mx", "My"),
    rivals=("rotor_effectiveness", "imu_lever_arm"),
    tie_breaker="heave with a large range of thrust; must agree with the lever arm",
    columns=_columns,
    extension=_extension,
    parts="all",
    absent_when_healthy=True,
)
