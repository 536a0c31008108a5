"""The filter on made flights, from raw files on, against the truth and its own standard errors; looser than the study.

The study itself is benchmarks/consistency.py.
"""

import consistency
import numpy as np
import pytest
from scipy.stats import chi2


@pytest.fixture(scope="module")
def draws():
    seeds = ((1, "mixed", 0.0), (2, "aggressive", 0.0), (3, "mixed", 0.0), (1, "mixed", 1.0), (2, "aggressive", 1.0))
    return [
        consistency.draw({"seed": seed, "profile": profile, "seconds": 20.0, "nuisance": nuisance})
        for seed, profile, nuisance in seeds
    ]


def test_errors_are_small_and_smaller_than_the_forward_filters(draws):
    for draw in draws:
        assert np.degrees(draw["smoother"]["attitude"]) < 0.1 and draw["smoother"]["velocity"] < 0.005
        assert draw["smoother"]["velocity"] < 0.8 * draw["filter"]["velocity"]
        assert draw["smoother"]["attitude"] < 0.9 * draw["filter"]["attitude"]
        assert draw["consistent"] is True


def test_standard_errors_of_biases_are_honest(draws):
    ratio = np.array([np.array(d["bias error"]) / np.array(d["bias std"]) for d in draws])
    # 15 draws: 1 +- 0.36 at 95 %, and a made gyro's rounding errs longer than a sample
    assert 0.4 < np.sqrt(np.mean(ratio[:, :3] ** 2)) < 1.8
    assert 0.4 < np.sqrt(np.mean(ratio[:, 3:] ** 2)) < 1.8
    assert np.abs(ratio).max() < 4.5


def test_errors_agree_with_their_covariance(draws):
    inside = [chi2.ppf(0.0005, 9) < d["smoother"]["NEES"] < chi2.ppf(0.9995, 9) for d in draws]
    assert sum(inside) >= 4
    along = np.array([list(d["smoother"]["NEES along"].values()) for d in draws])
    assert np.all((np.median(along, axis=0) > 0.4) & (np.median(along, axis=0) < 2.0))
