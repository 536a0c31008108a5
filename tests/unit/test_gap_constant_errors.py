"""Constant errors of a held-out flight, by which flights differ anyway: they judge no cause."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_gap_extension import base_of
from test_gap_extension import flight as made

from quasi.gap import verdict
from quasi.gap.levels.rollouts.confirmation import Confirmation, Settled
from quasi.gap.losses import Loss


@pytest.mark.parametrize("loses", [False, True])
@pytest.mark.parametrize(("trim", "swing", "stands"), [(-0.05, 0.02, True), (0.0, 0.02, True), (-0.05, -0.02, False)])
def test_a_flights_own_trim_does_not_hide_what_a_cause_makes_better(monkeypatch, trim, swing, stands, loses):
    """Of a cause that is there, the constant part was hidden by the trim: without it the error had seemed less. So it
    corrected another, or a simulation that it makes worse by half took its name."""
    plain, _ = made(base_of("withGravity"))
    wave = np.sin(2.0 * plain.t)
    column = {"drag": np.outer(wave, [0.4, 0, 0, 0, 0, 0]), "lift": np.outer(0.05 + 0.02 * wave, [0, 0, 1, 0, 0, 0])}
    true = column["drag"] + np.outer(0.05 + trim + swing * wave, [0, 0, 1, 0, 0, 0])
    noise = 1e-3 * np.random.default_rng(0).standard_normal(true.shape)
    held = replace(plain, measured=plain.predicted + true + noise)

    def cause(name, wald, *channels):
        effect = SimpleNamespace(id=name, channels=channels)
        return SimpleNamespace(effect=effect, since="changed", test=SimpleNamespace(wald=wald))

    causes = [cause("drag", 900.0, "Fx"), cause("lift", 60.0, "Fz")]
    confirmations = {(c.effect.id, c.since): Confirmation("", 0.0, 0.0, 0.0) for c in causes}
    monkeypatch.setattr(
        verdict,
        "after",
        lambda model, base: lambda f: f.residual - sum((column[n] for n in model), np.zeros(true.shape)),
    )
    grown = [Loss("rollouts", "velocity z", 0.5, 1.0, 1.5)] if loses else []
    monkeypatch.setattr(verdict, "losses", lambda base, model, *given, **asked: grown if "lift" in model else [])
    case = SimpleNamespace(
        held=[held], model=None, tables={}, settings={"horizons": [0.5], "material share": 0.05}, anew=lambda of: False
    )
    settled = Settled(causes, [], confirmations, {}, [])
    left = verdict._harmless(case, settled, lambda of, anew: [c.effect.id for c in of], [])
    assert [c.effect.id for c in left.causes] == (["drag", "lift"] if stands else ["drag"])
    assert list(left.losses) == (grown if stands else [])
