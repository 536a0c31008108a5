"""What a plan expects against what made flights measure: raw logs, synchronisation, filters, gusts and all."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from conftest import SECONDS
from hidden import affected, healthy_model, processed, references

from quasi.gap.catalogue import catalogue
from quasi.gap.effect import vehicle_of
from quasi.gap.flights.gathering import gather
from quasi.gap.levels.forces.design import gather_design
from quasi.gap.planning import plan
from quasi.gap.statistics.candidates import Candidate

CAUSE, PARAMETER = "tether", "k"


@pytest.mark.workflow
def test_a_made_flight_with_a_cause_of_expected_t_10_measures_about_10(healthy, tmp_path):
    """Expected from four healthy flights with another four beside them; measured on four flights with the cause."""
    model = healthy_model(healthy)
    others = [f for _, f in references(healthy, 50_010)]  # those of a case of hide and seek
    effects = {n: e for n, e in catalogue().items() if e.level == "forces" and n != "proximity"}
    flights = [plan.read_flight(f.filtered, model, f.key) for f in others]
    card = plan.examine(flights, model, effects, 4, 4, propose=False)
    sight = next(r.sight for r in card.rows if r.effect.id == CAUSE)
    size = sight.size * 10.0 / sight.t
    planted = [processed(r, True) for r in affected(tmp_path, 7, {CAUSE: {PARAMETER: size}}, SECONDS)]
    vehicle = vehicle_of(model)
    evidence = [gather(f.key, f.filtered, f.filtered_metadata, f.airframe, model, 100.0) for f in [*planted, *others]]
    study = gather_design(evidence, effects, vehicle)
    flags = np.array([True] * 4 + [False] * 4)
    mixed = study.mixed(range(8), flags)
    test = mixed.test(Candidate(CAUSE, "changed", (0,)), (), mixed.pooled("changed"))
    found = f"{test.value[0]:.3g} +- {test.std[0]:.2g}"
    assert 5.0 < test.wald**0.5 < 20.0, f"expected 10, measured {test.wald**0.5:.1f}; size {size:.3g}, found {found}"
