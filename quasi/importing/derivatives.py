"""The error of band-limited derivatives, and the entry that states how a signal was made of others.

Source: noise of a band-limited derivative: integral of (2 pi f)^2 times a white spectrum up to the bandwidth.
"""

from typing import Any

import numpy as np

from quasi.importing.resampling import low_pass
from quasi.importing.series import Track

ONE_SIGMA = 1.2816  # 80 % of normal errors are smaller than this many standard deviations
NOISE = "noise above the bandwidth alone"


def typical_size(error: np.ndarray) -> float:
    """The size below which 80 % of errors lie: 1.28 standard deviations of normal ones, so that it bounds one also
    where a third of a flight is rest without any error; single jolts do not count."""
    return float(np.quantile(np.abs(error), 0.8))


def derivative_error(signal: Track, rate: float, bandwidth: float, order: int) -> float:
    """Standard error of a derivative of a signal whose noise is white, low-passed at `bandwidth`.

    The noise is what lies above the bandwidth. Where the samples hold nothing above it, the noise is that of the upper
    half of their band, and motion there counts as noise. order  of the derivative; rate  Hz of the samples
    """
    edge, bandwidth = bandwidth, min(bandwidth, 0.5 * rate)
    rest = signal.values - low_pass(signal.values, rate, edge)
    if not rest.any():
        edge = 0.25 * rate
        rest = signal.values - low_pass(signal.values, rate, edge)
    share = max(1.0 - 2.0 * edge / rate, 0.1)  # of white noise that lies above the edge
    density = 2.0 * (typical_size(rest) / ONE_SIGMA) ** 2 / share / rate
    power = density * (2.0 * np.pi) ** (2 * order) * bandwidth ** (2 * order + 1) / (2 * order + 1)
    return float(np.sqrt(power))


def origin_of(
    source: str, bandwidth: float, rate: float, error: float, unit: str, covers: str = NOISE
) -> dict[str, Any]:
    """How a signal was made: source, bandwidth (Hz, of samples at `rate` Hz), standard error, and what that covers."""
    return {
        "from": source,
        "bandwidth": {"value": min(bandwidth, 0.5 * rate), "unit": "Hz"},
        "std": {"value": error, "unit": unit},
        "covers": covers,
    }
