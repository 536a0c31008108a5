"""Cross-products of the kinematic columns of one flight: whitened by its own noise, block by block."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from quasi.errors import DataError
from quasi.gap.levels.sensors.columns import KEPT_RATE, SLOPE_OF, XYZ, Weak
from quasi.gap.statistics.blocks import BLOCK
from quasi.gap.statistics.mixed import RIDGE
from quasi.gap.statistics.whitening import Whitener, autoregression, block_grams

AR_ORDER = 8  # of the autoregression: what correlates over 0.4 s
LEAST_SENSOR_NOISE = np.array([1e-5] * 3 + [1e-4] * 3)  # rad/s, m/s2: no averaged residual is known better


def least_squares(columns: np.ndarray) -> np.ndarray:
    """Least squares of the residual on all other columns, channels weighted alike; coefficients (P - 1,)."""
    weight = columns[:, :, 0].std(axis=0)
    flat = (columns / np.where(weight > 0, weight, 1.0)[None, :, None]).reshape(-1, columns.shape[2])
    gram = flat.T @ flat
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inner = (gram / np.outer(scale, scale))[1:, 1:] + RIDGE * np.eye(len(gram) - 1)
    return np.linalg.solve(inner, gram[1:, 0] / scale[1:]) / scale[1:]


def whitener_of(weak: Weak) -> Whitener:
    """Each flight has a noise of its own: vibration, captures of different quality."""
    left = weak.columns[:, :, 0] - weak.columns[:, :, 1:] @ least_squares(weak.columns)
    found = autoregression([left], [weak.breaks], AR_ORDER)
    return found._replace(scale=np.fmax(found.scale, LEAST_SENSOR_NOISE))


def blocks_of(weak: Weak, whitener: Whitener) -> np.ndarray:
    blocks = block_grams(weak.columns, weak.breaks, whitener, weak.t, BLOCK)
    if not len(blocks):
        raise DataError(f"flight {weak.key} has no {AR_ORDER / KEPT_RATE:.1f} s without gaps in sensors and capture")
    return blocks


def alone(gram: np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """One flight's own values of the columns (P,), and standard errors, 0 where left out.

    A turned IMU and turned markers look alike in one flight; they are stated as the markers' turn.
    """
    single, found, covariance = _solved(gram, names)
    values, std = np.zeros(len(names)), np.zeros(len(names))
    values[single], std[single] = found, np.sqrt(np.diag(covariance))
    return values, std


def _solved(gram: np.ndarray, names: Sequence[str]) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Columns that one flight distinguishes, their values and the covariance of these."""
    gone = ("imu_misalignment", "drawn", *(f"{SLOPE_OF}{a}" for a in XYZ))
    single = [i for i, n in enumerate(names) if i > 0 and n.split(".")[0] not in gone]
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-280))[single]  # squares of an empty column must not overflow
    inverse = np.linalg.inv(gram[np.ix_(single, single)] / np.outer(scale, scale) + RIDGE * np.eye(len(single)))
    return single, inverse @ (gram[single, 0] / scale) / scale, inverse / np.outer(scale, scale)


def dispersion(blocks: Sequence[np.ndarray], names: Sequence[str], rate: float) -> dict[str, float]:
    """{cause: how many times its variance exceeds that of white noise}, by what each block adds to it, where that is
    too much for chance.

    blocks  (B, P, P) per flight; rate  of chance. Vibration that a slow log folds into the motion is a line whose
    frequency follows the rotors: no autoregression makes it white, and it remembers as long as they keep their speed.
    Source: White, A heteroskedasticity-consistent covariance matrix estimator, Econometrica 48, 1980; Liang & Zeger,
    Longitudinal data analysis using generalized linear models, Biometrika 73, 1986 (sums over blocks).
    """
    ratios: dict[str, list[float]] = {}
    freedom = sum(len(own) - 1 for own in blocks)
    for own in blocks:
        if len(own) < 2:
            continue
        whole = own.sum(axis=0)
        single, values, covariance = _solved(whole, names)
        scores = own[:, single, 0] - own[:, single][:, :, single] @ values
        variance = ((scores @ covariance) ** 2).sum(axis=0) * len(own) / (len(own) - 1)
        for k, column in enumerate(single):
            if whole[column, column] > 0.0:
                ratios.setdefault(names[column].split(".")[0], []).append(float(variance[k] / covariance[k, k]))
    found = {cause: float(np.mean(of)) for cause, of in ratios.items()}
    found = {cause: ratio for cause, ratio in found.items() if chi2.sf(ratio * freedom, freedom) < rate}
    return found | {"imu_misalignment": found["mocap_misalignment"]} if "mocap_misalignment" in found else found


def spread_of_slopes(
    grams: Sequence[np.ndarray], names: Sequence[str], compared: np.ndarray, rate: float
) -> dict[str, float]:
    """Standard deviation by axis, {name: share}, by which flights' own scales of the accelerometer scatter too much.

    A scale shows by its mean, which a bias makes too, and by how the residual grows with the specific force within a
    flight. Late, smoothed or resampled signals change that slope, flight by flight, where noise alone counts as known.
    Compared flights and others have a mean of their own. rate  chance at which an axis counts that scatters as its
    standard errors say
    Source: DerSimonian & Laird, Meta-analysis in clinical trials, Controlled Clinical Trials 7, 1986.
    """
    own = [alone(gram, names) for gram in grams]
    found = {}
    for axis in XYZ:
        place = names.index(f"accelerometer_scale.{axis}")
        value, std = (np.array([one[k][place] for one in own]) for k in (0, 1))
        scatter = freedom = total = 0.0
        for group in (compared, ~compared):
            known = group & (std > 0.0)
            if not known.any():
                continue
            weight, inside = std[known] ** -2.0, value[known]
            scatter += weight @ (inside - np.average(inside, weights=weight)) ** 2
            freedom += len(inside) - 1
            total += weight.sum() - weight @ weight / weight.sum()
        if freedom and chi2.sf(scatter, freedom) < rate:
            found[f"{SLOPE_OF}{axis}"] = float(np.sqrt((scatter - freedom) / total))
    return found


def added(blocks: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Cross-products with the residual raised by known values of the columns."""
    change = np.eye(len(values))
    change[:, 0] += values
    return change.T @ blocks @ change
