"""Find the forces and moments of a model that are not finite in a state, and the terms that cause it."""

import numpy as np

from quasi.errors import QuasiError
from quasi.model.document import AXES
from quasi.model.model import Model
from quasi.terms.expressions import evaluate


def describe_undefined_loads(model: Model, inputs: np.ndarray, loads: np.ndarray) -> tuple[str, str] | None:
    """Describe the axis and term that are not finite at these inputs, and the remedy; None where all are finite.

    inputs (20 + E,): roll .. yaw, u .. w, p .. r, x .. z, rotor speeds (rad/s) and accelerations, extras; loads (6,)
    """
    lost = [axis for axis, value in zip(AXES, loads) if not np.isfinite(value)]
    if not lost:
        return None
    speeds = ", ".join(f"{w:.4g}" for w in inputs[12:16])
    columns = {name: np.array([value]) for name, value in zip(model.inputs, inputs)}
    lookup = model.variables(columns).__getitem__
    term = ""
    terms = model.document["axes"].get(lost[0], {}).get("terms", ())
    for about, tree in zip(terms, model.trees.get(lost[0], ())):
        try:
            with np.errstate(all="ignore"):
                value = evaluate(tree, lookup)
        except QuasiError:
            continue  # a term of an extension, whose variables no table holds
        if not np.isfinite(value).all():
            term = f" (term {about['name']})"
            break
    what = f"the model's {lost[0]} is not a finite number{term} at rotor speeds of {speeds} rad/s"
    if np.any(inputs[12:16] == 0.0):
        return what, "identify the model without terms that divide by rotor speeds, which are zero there"
    return what, "keep the flight within the region of the model's data"
