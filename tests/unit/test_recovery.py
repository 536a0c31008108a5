"""Known terms are found again in a large pool; a few seeds, looser than the study (benchmarks/recovery.py)."""

from pathlib import Path

import numpy as np
import pytest
import recovery

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def draws():
    return [recovery.draw({"seed": k, "pool": recovery.POOL}) for k in range(1, 4)]


def test_strong_terms_are_found_and_nearly_nothing_else(draws):
    strong = [t for r in draws for t in r["terms"] if abs(t["t"]) > recovery.STRONG]
    assert len(strong) > 10
    assert np.mean([t["found"] for t in strong]) >= 0.9
    false = [sum(c["false"] for c in r["chosen"]) for r in draws]
    assert sum(false) <= 3


def test_standard_errors_and_intervals_hold_what_they_promise(draws):
    errors = np.concatenate([r["errors in standard errors"] for r in draws])
    assert np.mean(np.abs(errors) < 2) > 0.8
    assert np.mean([r["coverage"] for r in draws]) == pytest.approx(0.95, abs=0.015)


def test_the_true_force_is_that_of_the_stated_terms():
    # by hand: bias 0, drag and thrust as fixed, noise of the stated size
    from quasi.identification.candidates import read_specification
    from quasi.tables import read_json

    document = read_json(ROOT / f"config/polynomials/{recovery.POOL}.json")
    flights, about, names, truth = recovery.make(3, read_specification(document, "Fz", "pool"))
    assert names[:2] == ["w", "(w2_1 + w2_2 + w2_3 + w2_4)"]
    assert 3 <= len(names) - 2 <= 6
    flight = flights["flight-0"]
    clean = truth @ recovery.values(recovery.Program([recovery.parse(n) for n in names]), flight)
    left = flight["Fz"] - clean
    assert left.std() == pytest.approx(about["size"], rel=0.15)
    assert np.corrcoef(left[1:], left[:-1])[0, 1] > 0.3


def test_wilson_interval_equals_the_printed_one():
    # Newcombe, Statistics in Medicine 17, 1998, table I: 81 of 263, 0.2553 to 0.3662; 0 of 20, 0 to 0.1611
    assert recovery.wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert recovery.wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
