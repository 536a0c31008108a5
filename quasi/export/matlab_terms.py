"""A model's terms and the derivatives of its moments as MATLAB statements, for MATLAB and GNU Octave alike.

Only plain numbers, operators and identifiers that are made here come out: every name is a known variable or goes
through `identifier`, and text of the model stands in comments only, as `shown` leaves it.
"""

import re
from collections.abc import Mapping

import numpy as np

from quasi.errors import ConfigError
from quasi.export.contents import head
from quasi.export.naming import identifier, shown
from quasi.model.model import AXES, Model
from quasi.tables import COLUMNS
from quasi.terms.differential import list_held_inputs
from quasi.terms.expressions import Tree, names
from quasi.terms.graph import ONE, Graph
from quasi.terms.kernel import INPUTS
from quasi.terms.variables import FORMULAS, SYNONYMS, known_names, plain_name, split_function

EXTRA = "x_"  # before the identifiers of columns that are not known
_LONGEST_NAME = 63  # characters by which MATLAB distinguishes names
_WHOLE = 32  # the largest power that is not left to powerOf
_DEEPEST = 28  # brackets within brackets: MATLAB reads 32, and a line adds some
_MATLAB_NAMES = frozenset({*known_names({*INPUTS, "v_in"}), *INPUTS, "F_den", "M_den", *COLUMNS} - {"t", *AXES})
_COMPUTED = frozenset(f"w2_{i}" for i in range(1, 5))  # formulas that getDroneInputs.m computes; others are written out
_CALLS = {"abs": "abs", "sign": "sign", "sqrt": "rootOf", "sin": "sin", "cos": "cos", "log": "logOf",
          "wrap": "wrapAngle"}  # fmt: skip


def matlab_name(name: str) -> str:
    """Identifier of a variable: a known one under its own name, another one under a marked name.

    Raises ConfigError where it is longer than MATLAB allows.
    """
    if name in _MATLAB_NAMES:
        return name
    made = identifier(name, EXTRA)
    if len(made) > _LONGEST_NAME:
        raise ConfigError(
            f"variable '{shown(name, 60)}' becomes a MATLAB name of {len(made)} characters, of which {_LONGEST_NAME} "
            "are allowed; give the column a shorter name and make the model anew"
        )
    return made


def number(value: float) -> str:
    """A number with all its digits; Inf and NaN as MATLAB writes them."""
    value = float(value)
    if not np.isfinite(value):
        return "NaN" if np.isnan(value) else "Inf" if value > 0 else "-Inf"
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)


def expression(tree: Tree) -> str:
    """MATLAB text of an expression, elementwise, its variables under their `matlab_name`."""
    kind = tree[0]
    if kind == "number":
        return number(tree[1])
    if kind == "name":
        return _variable(tree[1])
    if kind == "negative":
        return f"-{_atom(tree[1])}"
    if kind == "power":
        return _power(tree[1], tree[2])
    if kind == "sum":
        text = _atom(tree[1][0][1])
        for sign, part in tree[1][1:]:
            text += (" + " if sign > 0 else " - ") + _atom(part)
        return text
    text = _atom(tree[1][0][1])
    for sign, part in tree[1][1:]:
        text += (".*" if sign > 0 else "./") + _atom(part)
    return text


def _atom(tree: Tree) -> str:
    text = expression(tree)
    bare = tree[0] == "name" or (tree[0] == "number" and tree[1] >= 0.0 and not text.startswith("-"))
    return text if bare or re.fullmatch(r"\w+\.\^\d+|(rootOf|powerOf)\([^()]*\)", text) else f"({text})"


def _power(base: Tree, exponent: Tree) -> str:
    if exponent[0] == "number":
        n = exponent[1]
        if n == 0.0:
            return "1"
        if n == 0.5:
            return f"rootOf({expression(base)})"
        if n == int(n) and abs(n) <= _WHOLE:
            text = _atom(base)
            text = f"({text})" if ".^" in text and not text.startswith("(") else text
            raised = text if abs(n) == 1 else f"{text}.^{abs(int(n))}"
            return raised if n > 0 else f"1./({raised})"
    return f"powerOf({expression(base)}, {expression(exponent)})"


def _variable(name: str) -> str:
    function, inner = split_function(name)
    if not function and plain_name(name) in FORMULAS.keys() - _COMPUTED:
        return f"({expression(SYNONYMS[plain_name(name)])})"
    return f"{_CALLS[function]}({_variable(inner)})" if function else matlab_name(plain_name(name))


def variables_of(model: Model, axis: str) -> list[str]:
    """Variables of an axis without |..|, sin[..], cos[..], each once, in order of appearance."""
    return list(dict.fromkeys(name for tree in model.trees[axis] for name in _variables_in(tree)))


def _variables_in(tree: Tree) -> list[str]:
    found: list[str] = []
    for name in map(plain_name, names(tree)):
        found += _variables_in(SYNONYMS[name]) if name in FORMULAS.keys() - _COMPUTED else [name]
    return found


def axis_file(model: Model, axis: str) -> str:
    """get_Fx.m .. get_Mz.m: one axis as a function of its variables."""
    part = model.document["axes"][axis]
    unit = "N" if axis[0] == "F" else "N m"
    what = f"{'force along' if axis[0] == 'F' else 'moment about'} the body's {axis[1]} axis"
    scale = "F_den" if axis[0] == "F" else "M_den"
    if model.normalisation:
        unit = f"1: in {unit} once multiplied by {scale}"
    arguments = [matlab_name(v) for v in variables_of(model, axis)]
    lines = [
        f"function {axis} = get_{axis}({', '.join(arguments)})",
        f"%GET_{axis.upper()}  Model {model.id}: {what}, {unit}.",
        "%",
        "%   Arguments are fields of getDroneInputs, N x 1 (rotor speeds in mechanical rad/s, SI units, body axes x",
        "%   forward, y right, z down); a model of a constant alone gives one number. getFM calls this function.",
        *_gravity_lines(model, axis),
        "",
        f"{axis} = 0;",
    ]
    for term, tree in zip(part["terms"], model.trees[axis]):
        value, text = number(term["coefficient"]), expression(tree)
        if _depth(text) > _DEEPEST:
            raise ConfigError(
                f"model {model.id}, {axis}: term '{shown(term['expression'], 60)}' nests brackets deeper than "
                f"MATLAB reads ({_DEEPEST}); split it into several terms, or write it with fewer brackets"
            )
        added = value if text == "1" else f"{value}*{_atom(tree)}"
        lines.append(f"{axis} = {axis} + ({added});  % {shown(term['name'], 80)}, {shown(term['unit'], 40)}")
    return "\n".join([*lines, "end", ""])


def _depth(text: str) -> int:
    deepest = depth = 0
    for character in text:
        depth += (character == "(") - (character == ")")
        deepest = max(deepest, depth)
    return deepest


def _gravity_lines(model: Model, axis: str) -> list[str]:
    if axis[0] != "F":
        return []
    if model.with_gravity:
        return ["%   Mass times specific force: in hover Fz = -mass*9.81; a simulation adds gravity."]
    return ["%   Net force: in hover Fz = 0; gravity is part of it."]


def wrench_file(model: Model) -> str:
    """getFM.m: forces and moments of states and rotor speeds."""
    lines = [
        "function [F, M, d] = getFM(state, inputs, modelParams, droneParams, extra)",
        f"%GETFM  Forces and moments of model {model.id}.",
        "%",
        "%   [F, M] = getFM(state, inputs, modelParams, droneParams)",
        "%   [F, M] = getFM(state, inputs, modelParams, droneParams, extra)",
        "%",
        "%   state   N x 12 (or N x 9 without x y z), inputs N x 4: rotor speeds 1 to 4, mechanical rad/s; see below",
        "%   extra   optional struct of further columns, see getDroneInputs",
        "%   F, M    N x 3; 3 x 1 where state is a column",
        "%   d       the variables, see getDroneInputs",
        "%",
        *(f"%   {line}".rstrip() for line in head(model)),
        "",
        "if nargin < 5",
        "    extra = struct();",
        "end",
        "d = getDroneInputs(state, inputs, modelParams, droneParams, extra);",
        "F = zeros(d.n, 3);",
        "M = zeros(d.n, 3);",
    ]
    for k, axis in enumerate(("Fx", "Fy", "Fz", "Mx", "My", "Mz")):
        where = f"{axis[0]}(:, {k % 3 + 1})"
        if axis not in model.axes:
            lines.append(f"{where} = NaN;  % {axis} was not identified")
            continue
        arguments = ", ".join(f"d.{matlab_name(v)}" for v in variables_of(model, axis))
        scale = (".*d.F_den" if axis[0] == "F" else ".*d.M_den") if model.normalisation else ""
        lines.append(f"{where} = get_{axis}({arguments}){scale};")
    lines += ["if size(state, 2) == 1 && size(state, 1) > 1", "    F = F.';", "    M = M.';", "end", "end", ""]
    return "\n".join(lines)


def differential_file(model: Model, u: tuple[str, ...]) -> str:
    """get_PQRDiffSys.m: A and B of d/dt (dx/dt) = A dx/dt + B du/dt, x = (p, q, r), see `quasi.terms.differential`."""
    graph, terms = model.graph(list_held_inputs(u))
    by = ("p", "q", "r", *u)
    wrt = [graph.independent(name) for name in by]
    outputs = [graph.combine(axis, node) for axis in terms[3:] for node in wrt]
    shown_u = ", ".join(shown(name, 60) for name in u)
    lines = [
        "function [A, B, dMdx, dMdu] = get_PQRDiffSys(d)",
        f"%GET_PQRDIFFSYS  Rotational dynamics of model {model.id} in differential form.",
        "%",
        "%   d/dt (dx/dt) = A dx/dt + B du/dt,  x = [p q r]' (rad/s),",
        f"%   u = [{shown_u}]' (from mechanical rotor speeds, rad/s)",
        "%",
        "%   d     what getDroneInputs gives for N states",
        f"%   A     3 x 3 x N, 1/s; B 3 x {len(u)} x N, rad/s2 per unit of u; each page one state",
        "%   dMdx, dMdu  the derivatives of the moments Mx My Mz, N m",
        "%   All partial derivatives and the whole inertia take part: A = I^-1 (dM/dx - d(x X I x)/dx).",
        "%   The derivative of abs(a) is sign(a), 0 at 0.",
        "",
        "b = d.base;",
        *_statements(graph, outputs),
        f"dMdx = zeros(3, 3, d.n);\ndMdu = zeros(3, {len(u)}, d.n);",
    ]
    for m in range(3):
        for k in range(len(by)):
            text = _combination(outputs[m * len(by) + k])
            if text != "0":
                name, column = ("dMdx", k) if k < 3 else ("dMdu", k - 3)
                lines.append(f"{name}({m + 1}, {column + 1}, :) = {text};")
    lines += _dynamics(model.airframe.inertia, len(u))
    return "\n".join([*lines, "end", ""])


def _statements(graph: Graph, outputs: list[Mapping[int, float]]) -> list[str]:
    """One statement for each node of the graph, equal parts once."""
    lines = []
    for node in graph.reachable(outputs):
        kind, *given = graph.nodes[node]
        if node == ONE:
            continue
        if kind == "constant":
            text = number(given[0])
        elif kind == "input":
            text = f"b.{matlab_name(given[0])}"
        elif kind == "held":
            text = _node(given[1])
        elif kind == "product":
            text = ".*".join(_node(part) if n == 1 else f"{_node(part)}.^{n}" for part, n in given[0])
        elif kind == "quotient":
            text = f"{_node(given[0])}./{_node(given[1])}"
        elif kind == "sum":
            text = _combination(dict(given[0]))
        elif kind == "power":
            text = f"powerOf({_node(given[0])}, {_node(given[1])})"
        else:
            text = f"{_CALLS[kind]}({_node(given[0])})"
        lines.append(f"{_node(node)} = {text};")
    return lines


def _node(node: int) -> str:
    return "1" if node == ONE else f"n{node}"


def _combination(combination: Mapping[int, float]) -> str:
    parts = []
    for node, factor in combination.items():
        size = number(abs(factor)) if node == ONE else _node(node) if abs(factor) == 1.0 else (
            f"{number(abs(factor))}*{_node(node)}"
        )  # fmt: skip
        parts.append(("-" if factor < 0 else "+", size))
    if not parts:
        return "0"
    first = parts[0][1] if parts[0][0] == "+" else f"-{parts[0][1]}"
    return first + "".join(f" {sign} {size}" for sign, size in parts[1:])


def _dynamics(inertia: np.ndarray, inputs: int) -> list[str]:
    def rows(matrix: np.ndarray) -> str:
        return "; ".join(" ".join(number(value) for value in row) for row in matrix)

    return [
        f"inertia = [{rows(inertia)}];  % kg m2, body axes about the centre of gravity",
        f"inverse = [{rows(np.linalg.inv(inertia))}];",
        "x = [b.p b.q b.r];",
        "h = x*inertia.';",
        "turn = zeros(3, 3, d.n);  % d(x X I x)/dx",
        "for j = 1:3",
        "    turn(1, j, :) = x(:, 2)*inertia(3, j) - x(:, 3)*inertia(2, j);",
        "    turn(2, j, :) = x(:, 3)*inertia(1, j) - x(:, 1)*inertia(3, j);",
        "    turn(3, j, :) = x(:, 1)*inertia(2, j) - x(:, 2)*inertia(1, j);",
        "end",
        "h = reshape(h.', 1, 3, d.n);",
        "turn(1, 2:3, :) = turn(1, 2:3, :) + [h(1, 3, :) -h(1, 2, :)];",
        "turn(2, [1 3], :) = turn(2, [1 3], :) + [-h(1, 3, :) h(1, 1, :)];",
        "turn(3, 1:2, :) = turn(3, 1:2, :) + [h(1, 2, :) -h(1, 1, :)];",
        "slopes = dMdx - turn;",
        "A = zeros(3, 3, d.n);",
        f"B = zeros(3, {inputs}, d.n);",
        "for i = 1:3",
        "    for k = 1:3",
        "        A(i, :, :) = A(i, :, :) + inverse(i, k)*slopes(k, :, :);",
        "        B(i, :, :) = B(i, :, :) + inverse(i, k)*dMdu(k, :, :);",
        "    end",
        "end",
    ]
