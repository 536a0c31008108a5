"""One rotor weaker than the others.

A rotor of effectiveness e acts as one whose squared speed is e times the logged one, in the fit and in the extended
model. Levers of hover are only the mean of that: terms such as the change of all rotors times a difference let them
differ by a third from row to row. With levers of hover the deviations of rotors planted in real recordings came out 10
to 18 % too small, with the slopes of each row within 5 %.

The model's yaw moment may hold differences of thrust as well, alone or next to body rates. They are those of the thrust
that acts. Where they were left as logged, a weak rotor was balanced by the others, and left errors along the rates that
looked like a tilted rotor (PyFlyt, docs/other-vehicles.md). Next to a velocity they stand for drag at the hubs, which
follows the logged speeds.

How much torque a rotor takes with another thrust depends on why: a speed that is logged wrong changes both by one
factor, a twisted blade hardly the torque. Torque is therefore a parameter of its own, asked where the thrust differs.
"""

from collections.abc import Mapping

import numpy as np

from quasi.airframe import Airframe
from quasi.gap.effect import (
    Effect,
    Extension,
    Parameter,
    Terms,
    Values,
    Vehicle,
    number,
    thrust_wrench,
)
from quasi.gap.flights.evidence import Evidence
from quasi.model.model import AXES, ROTORS, Model
from quasi.terms.expressions import Program, Tree, names, parse, text
from quasi.terms.variables import SYNONYMS, Variables, plain_name, split_function

SLOPES_KNOWN = 0.05  # share, from rotors planted in real recordings: docs/measured.md
THRUST_DIFFERENCES = frozenset({"u_p", "u_q", "U_p", "U_q"})  # of thrust, in the yaw moment; its rest is the shaft's
VELOCITIES = frozenset({"u", "v", "w", "u_air", "v_air", "w_air", "mu_x", "mu_y", "mu_z"})
STEP = 0.01  # of a rotor's share, for slopes of what is nearly straight
NUMBERS = range(1, 5)
LOWEST, HIGHEST = 0.3, 2.0  # physical: a rotor without two thirds of its thrust does not fly


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    result: dict[str, Terms] = {}
    for i in NUMBERS:
        thrusts = ["", "", "", ""]
        thrusts[i - 1] = f"{number(vehicle.thrust)}*w{i}^2"
        result[f"rotor{i}"] = thrust_wrench(vehicle, thrusts)
    for i, spin in zip(NUMBERS, vehicle.spin):
        result[f"torque{i}"] = {"Mz": f"{number(-spin * vehicle.torque)}*w{i}^2"}
    return result


def _columns(evidence: Evidence, _: Values) -> dict[str, np.ndarray]:
    slopes = evidence.gradient(*ROTORS) * (0.5 * evidence.speeds)[:, None, :]  # by the logarithm of squared speed
    slopes[:, AXES.index("Mz")] = _yaw_slopes(evidence)
    torques = -evidence.spin * evidence.torque
    return {f"rotor{i}": slopes[:, :, i - 1] for i in NUMBERS} | {
        f"torque{i}": evidence.only("Mz", torques[:, i - 1]) for i in NUMBERS
    }


def _yaw_slopes(evidence: Evidence) -> np.ndarray:
    """Slopes (n, 4) of the yaw moment by the rotors' shares, through the differences of thrust that it holds."""
    terms = [t for t in _terms_of(evidence.model, "Mz") if holds_thrust(t[0])]
    result = np.zeros((len(evidence), 4))
    if not terms:
        return result
    variables = Variables(evidence.columns, evidence.model.airframe, evidence.model.hover_speed)
    for i in range(4):
        for sign in (1.0, -1.0):
            shares = np.ones(4)
            shares[i] += sign * STEP
            acting = _effective_speeds(evidence.model.airframe, shares)
            program = Program([_replace(tree, _differences(acting)) for tree, _ in terms])
            values = program.run({name: variables[name] for name in program.names}, len(evidence))
            result[:, i] += sign / (2.0 * STEP) * sum(c * v for (_, c), v in zip(terms, values))
    return result


def _terms_of(model: Model, axis: str) -> list[tuple[Tree, float]]:
    """An axis' terms and coefficients, without those that stand in for a part with states of its own."""
    terms = model.document["axes"].get(axis, {"terms": []})["terms"]
    return [(parse(t["expression"]), t["coefficient"]) for t in terms if t["coefficient"] and not t.get("stands for")]


def holds_thrust(tree: Tree) -> bool:
    """Whether a term of the yaw moment holds a difference of thrust, and no velocity."""
    held = {plain_name(name) for name in names(tree)}
    return bool(held & THRUST_DIFFERENCES) and not held & VELOCITIES


def _differences(acting: Mapping[str, Tree]) -> dict[str, Tree]:
    return {name: tree for name, tree in acting.items() if name in THRUST_DIFFERENCES}


def _extension(values: Values, vehicle: Vehicle, model: Model) -> Extension:
    """The model's own terms of thrust at the speeds that the rotors act with, in place of those at logged speeds.

    A trial beyond what is physical acts as its limit: no speed has a square below zero."""
    shares = np.maximum([1.0 + values.get(f"rotor{i}", 0.0) for i in NUMBERS], LOWEST)
    effective = _effective_speeds(model.airframe, shares)
    terms: dict[str, list[tuple[str, float]]] = {}
    for i in NUMBERS:
        if share := values.get(f"torque{i}", 0.0):
            terms.setdefault("Mz", []).append((_terms(vehicle)[f"torque{i}"]["Mz"], share))
    for axis in AXES:
        for tree, coefficient in _terms_of(model, axis):
            if axis == "Mz" and not holds_thrust(tree):
                continue
            acting = _replace(tree, _differences(effective) if axis == "Mz" else effective)
            if acting != tree:
                terms.setdefault(axis, []).extend([(text(acting), coefficient), (text(tree), -coefficient)])
    return Extension(terms=terms)


def _effective_speeds(frame: Airframe, e: np.ndarray) -> dict[str, Tree]:
    """{variable: its expression in logged speeds}, of squared speeds that act e times as large, (4,)."""
    weights = {"w_tot": (1.0,) * 4, "u_p": frame.left, "u_q": frame.front, "u_r": frame.spin}
    each = {f"w{i}": np.eye(4)[i - 1] for i in range(1, 5)}

    def beyond(weight: np.ndarray, gain: np.ndarray, power: int) -> str:
        parts = [
            f" + {number(w * g)}*w{i}^{power}" for i, w, g in zip(range(1, 5), np.asarray(weight, float), gain) if w * g
        ]
        return "".join(parts)

    speed, square = np.sqrt(e) - 1.0, e - 1.0
    found = {name: name + beyond(weight, speed, 1) for name, weight in {**weights, **each}.items()}
    found |= {
        f"d_{name}": f"d_{name}" + beyond(weights.get(name, each.get(name)), speed, 1) for name in (*each, "w_tot")
    }
    found |= {f"w2_{i}": f"w2_{i}" + beyond(each[f"w{i}"], square, 2) for i in range(1, 5)}
    found |= {f"U_{a}": f"U_{a}" + beyond(weights[f"u_{a}"], square, 2) for a in "pqr"}
    average = f"(w_avg^2{beyond(np.full(4, 0.25), square, 2)})^0.5"
    found["w_avg"] = average
    found |= {name: f"{name}*w_avg/{average}" for name in ("mu_x", "mu_y", "mu_z", "mu_vin")}
    return {name: parse(f"({expression})") for name, expression in found.items() if expression != name}


def _replace(tree: Tree, by: Mapping[str, Tree]) -> Tree:
    """A tree with names replaced; |a| becomes the root of its square, sines and cosines stay."""
    kind = tree[0]
    if kind == "name":
        function, inner = split_function(tree[1])
        synonym = SYNONYMS.get(inner, ("", ""))
        inner = synonym[1] if synonym[0] == "name" else inner
        if inner not in by or function not in (None, "abs"):
            return tree
        if function is None:
            return by[inner]
        return ("power", ("power", by[inner], ("number", 2.0)), ("number", 0.5))
    if kind in ("sum", "product"):
        return (kind, tuple((sign, _replace(part, by)) for sign, part in tree[1]))
    if kind in ("negative", "power"):
        return (kind, *(_replace(part, by) for part in tree[1:]))
    return tree


EFFECT = Effect(
    id="rotor_effectiveness",
    level="forces",
    sentence="one rotor makes less or more thrust than its speed says (chipped or wrong propeller)",
    equation="T_i = e_i T0_i: dFz : dMx : dMy in the ratio of the hub's place; Q_i = torque_i Q0_i",
    source="definition",
    parameters={f"rotor{i}": Parameter("1", 1.0, "s", LOWEST, HIGHEST, 0.1) for i in NUMBERS}
    | {f"torque{i}": Parameter("1", 1.0, "s", LOWEST, HIGHEST, None) for i in NUMBERS},
    channels=("Fz", "Mx", "My"),
    rivals=("cg_offset", "rotor_tilt"),
    tie_breaker="heave with a large range of thrust, and steps of each axis",
    terms=_terms,
    columns=_columns,
    extension=_extension,
    parts="paired",
    absent_when_healthy=True,
    form_uncertainty=SLOPES_KNOWN,
)
