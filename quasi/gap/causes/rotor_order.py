"""Rotor columns of the log in another order."""

from quasi.gap.effect import Effect, Parameter

EFFECT = Effect(
    id="rotor_order",
    level="sensors",
    sentence="the log's rotor columns stand in another order",
    equation="rotor i is logged in column n_i: moments follow from the columns in the right order alone",
    source="definition",
    parameters={f"rotor{i}": Parameter("1", float(i), "s", 1.0, 4.0) for i in range(1, 5)},
    channels=("Mx", "My", "Mz"),
    rivals=("inertia",),
    tie_breaker="run one motor at a time on the bench, without propellers, and look at which column moves",
    corrects=("rotors", "order of speeds"),
)
