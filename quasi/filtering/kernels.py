"""The kernels that filter a flight, compiled ahead of the jobs (`quasi.running.job_server`)."""

import numpy as np

from quasi.filtering import ekf
from quasi.filtering.smoother import smooth

FILTERED_SAMPLES, SAMPLE_RATE = 500, 500.0  # samples and Hz


def compile_kernels() -> None:
    """Call every kernel with the argument types of a real flight; compiled ones are loaded from the cache."""
    vectors, upright = np.zeros((FILTERED_SAMPLES, 3)), np.array([1.0, 0.0, 0.0, 0.0])
    inputs = ekf.Inputs(
        dt=1.0 / SAMPLE_RATE,
        gyro=vectors,
        accel=vectors,
        noise=np.ones((FILTERED_SAMPLES, 6)),
        bias_random_walk=np.zeros(6),
        used=np.ones((FILTERED_SAMPLES, 3), np.int8),
        attitude=np.tile(upright, (FILTERED_SAMPLES, 1)),
        position=vectors,
        velocity=vectors,
        body=False,
        std=np.ones((3, 3)),
        gate=10.0,
        max_rejections=np.full(3, 3),
        quaternion=upright,
        state=np.zeros(15),
        covariance=np.eye(ekf.STATES),
    )
    smooth(inputs, ekf.forward(inputs))
