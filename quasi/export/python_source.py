"""A model as one Python file that needs numpy alone: the same `predict`, the differential form, the covered region.

name, text = python_file(model)            "quasi_example.py" and what stands in it
"""

import math
from collections.abc import Sequence

import numpy as np

from quasi.export.command_map import python_map
from quasi.export.contents import (
    MEANINGS,
    check_exportable,
    constants_of,
    differential_inputs,
    extras_of,
    has_region,
    head,
    name_in_source,
    terms_of,
)
from quasi.export.listing import Expression, Listing, Output, Writer, of_derivatives, of_model, of_region, weighted
from quasi.export.naming import local, shown
from quasi.model.model import AXES, Model
from quasi.terms.differential import RATES

_NUMPY_FUNCTIONS = {"abs": "np.abs", "sqrt": "np.sqrt", "sin": "np.sin", "cos": "np.cos", "log": "np.log",
              "power": "np.power", "divide": "np.divide", "sign": "np.sign", "wrap": "_wrap"}  # fmt: skip


def number(value: float) -> str:
    """A number as Python reads it back, digit by digit."""
    if math.isnan(value):
        return "np.nan"
    if math.isinf(value):
        return "np.inf" if value > 0 else "(-np.inf)"
    return repr(value) if math.copysign(1.0, value) > 0 else f"({value!r})"


WRITER = Writer(number, lambda function, parts: f"{_NUMPY_FUNCTIONS[function]}({', '.join(parts)})", local)


def python_file(model: Model) -> tuple[str, str]:
    """File name and text of the module. Raises ConfigError for what cannot be carried, by name."""
    check_exportable(model)
    extras, u = extras_of(model), differential_inputs(model)
    constants = constants_of(model)
    example = name_in_source(model)
    lines = [
        *head(model),
        "",
        f"    import {example}",
        f"    forces, moments = {example}.predict(state, rotor_speeds)",
        "",
        "state (N, 12) or (12,), rotor_speeds (N, 4) or (4,); numpy is all that is needed.",
    ]
    parts = [
        '"""' + "\n".join(lines) + '\n"""\n\nimport numpy as np\n',
        f'MODEL = "{shown(model.id)}"',
        f"EXTRA_INPUTS = {_names(extras)}  # columns that the argument `extra` must hold",
        f"NEEDS_POSITION = {bool(model.kernel.used[9:12].any())}",
    ]
    for name, value in constants.items():
        written = _shaped(name, value) if isinstance(value, list) else number(value)
        parts.append(f"# {MEANINGS[name]}\n{name.upper()} = {written}")
    parts.append("")
    parts.append(_PREDICT)
    if mapped := python_map(model):
        parts += [f"{part}\n" for part in mapped.split("\n\n\n")]
    parts.append(_body("_forces_and_moments", "Fx, Fy, Fz, Mx, My, Mz of columns.", of_model(model), _by_axis(model)))
    if u:
        parts.append(f"DIFFERENTIAL_INPUTS = {_names(u)}\n")
        parts.append(_DIFFERENTIAL.replace("@K@", str(len(u))))
        listing = of_derivatives(model, (*RATES, *u))
        labels = [
            (f"d{m}", [f"{axis} by {v}"]) for m, (axis, v) in enumerate((a, v) for a in AXES[3:] for v in (*RATES, *u))
        ]
        parts.append(
            _body("_derivatives", "Derivatives of Mx, My, Mz by p, q, r and u, axis after axis.", listing, labels)
        )
    if has_region(model):
        parts.append(_region(model))
    parts.append(_COLUMNS)
    if "_wrap(" in "".join(parts):
        parts.append(_WRAP)
    return f"{example}.py", "\n\n".join(_spaced(parts))


def _spaced(parts: Sequence[str]) -> list[str]:
    """Definitions two lines apart, plain statements one below the other."""
    result: list[str] = []
    for part in parts:
        plain = not part.startswith(("def ", '"""'))
        if plain and result and not result[-1].startswith(("def ", '"""')):
            result[-1] += "\n" + part
        else:
            result.append(part)
    return [part.strip("\n") + "\n" for part in result]


def _names(names: Sequence[str]) -> str:
    """A tuple of names as they are: they come from the grammar of expressions, which holds no quote."""
    return "(" + "".join(f'"{name}", ' for name in names).rstrip() + ")" if names else "()"


def _shaped(name: str, values: Sequence[float]) -> str:
    if name == "inertia" or name == "hubs":
        rows = [values[i : i + 3] for i in range(0, len(values), 3)]
        return "np.array([" + ", ".join("[" + ", ".join(map(number, row)) + "]" for row in rows) + "])"
    return "np.array([" + ", ".join(map(number, values)) + "])"


def _by_axis(model: Model) -> list[tuple[str, list[str]]]:
    return [(axis, [f"{axis}, {'N' if m < 3 else 'N m'}", *(f"  {t}" for t in terms_of(model, axis))])
            for m, axis in enumerate(AXES)]  # fmt: skip


def _guarded(listing: Listing) -> Listing:
    """The listing with every division by a constant as numpy's: Python's own raises an error for 0."""
    constants: set[str] = set()

    def fixed(e: Expression) -> bool:
        if e[0] in ("input", "number", "step"):
            return e[0] == "number" or e[1] in constants
        return all(fixed(part) for part in e[1:])

    def visit(e: Expression) -> Expression:
        if e[0] in ("input", "number", "step"):
            return e
        kind = "divide" if e[0] == "/" and fixed(e[2]) else e[0]
        return (kind, *(visit(part) for part in e[1:]))

    steps = []
    for name, expression in listing.steps:
        if fixed(expression):
            constants.add(name)
        steps.append((name, visit(expression)))
    outputs = [Output(o.offset, tuple((weight, visit(e)) for weight, e in o.terms)) for o in listing.outputs]
    return Listing(listing.inputs, tuple(steps), tuple(outputs))


def _body(name: str, what: str, listing: Listing, outputs: Sequence[tuple[str, Sequence[str]]]) -> str:
    """A function of columns (a dict of arrays) that returns the outputs, each under its name and comment."""
    listing = _guarded(listing)
    lines = [f"def {name}(columns):", f'    """{what}"""']
    lines += [f'    {local(n)} = columns["{n}"]' for n in listing.inputs]
    lines += [f"    {step} = {WRITER.text(e)}" for step, e in listing.steps]
    for (result, comments), output in zip(outputs, listing.outputs, strict=True):
        lines += [f"    # {comment}" for comment in comments] + _sum(result, output)
    lines.append("    return (\n        " + ",\n        ".join(result for result, _ in outputs) + ",\n    )")
    return "\n".join(lines) + "\n"


def _sum(name: str, output: Output) -> list[str]:
    lines = [f"    {name} = {number(output.offset)}"]
    return lines + [f"    {name} = {name} + {weighted(WRITER, weight, e)}" for weight, e in output.terms]


def _region(model: Model) -> str:
    listing, limits = of_region(model), model.region.limits
    body = _body("_limited", "The limited variables, then the columns of the ellipsoid less their mean.", listing,
                 [(f"value{m}", []) for m in range(len(listing.outputs))])  # fmt: skip

    def array(values: np.ndarray) -> str:
        return "np.array([" + ", ".join(number(float(v)) for v in values) + "])"

    rows = ",\n    ".join("[" + ", ".join(number(float(v)) for v in row) + "]" for row in limits.whitening)
    size = len(limits.whitening)
    return "\n".join(
        [
            f"LIMITED = ({''.join(f'{shown(n)!r}, ' for n in model.region_names)})",
            f"LOW = {array(limits.low)}",
            f"HIGH = {array(limits.high)}",
            f"WHITENING = np.array([\n    {rows}\n]).reshape({size}, {size})",
            f"JOINT_LIMIT = {number(float(limits.limit[0]))}",
            "\n",
            _DISTANCE,
            "\n" + body,
        ]
    )


_PREDICT = '''\
def predict(state, rotor_speeds, rotor_accelerations=None, extra=None):
    """Forces (N, 3), N, and moments (N, 3), N m, in body axes.

    state                (N, 12) roll pitch yaw (rad), u v w (m/s, through the air), p q r (rad/s), x y z (m);
                         or (N, 9) without the position where no term needs it
    rotor_speeds         (N, 4) mechanical rad/s
    rotor_accelerations  (N, 4) rad/s2; zero where left out: the quasi-steady prediction
    extra                {name: (N,)} of the EXTRA_INPUTS
    One row, (12,) or (9,) with (4,), gives (3,) and (3,). Raises ValueError for wrong shapes and missing columns.
    """
    columns, rows = _columns(state, rotor_speeds, rotor_accelerations, extra)
    with np.errstate(all="ignore"):
        found = np.column_stack([np.broadcast_to(axis, rows) for axis in _forces_and_moments(columns)])
    return (found[0, :3], found[0, 3:]) if np.ndim(state) == 1 else (found[:, :3], found[:, 3:])
'''

_DIFFERENTIAL = '''\
def differential_form(state, rotor_speeds, rotor_accelerations=None, extra=None):
    """A (N, 3, 3) and B (N, 3, K) of d/dt (dx/dt) = A dx/dt + B du/dt, x = (p, q, r), u = DIFFERENTIAL_INPUTS.

    Arguments as for `predict`; one row gives (3, 3) and (3, K).
    """
    columns, rows = _columns(state, rotor_speeds, rotor_accelerations, extra)
    with np.errstate(all="ignore"):
        d = np.column_stack([np.broadcast_to(value, rows) for value in _derivatives(columns)])
        d = d.reshape(rows, 3, 3 + @K@)
        x = np.column_stack([columns["p"], columns["q"], columns["r"]])
        h = x @ INERTIA.T
        inverse = np.linalg.inv(INERTIA)
        a = inverse @ (d[:, :, :3] - (_cross(x) @ INERTIA - _cross(h)))
        b = inverse @ d[:, :, 3:]
    return (a[0], b[0]) if np.ndim(state) == 1 else (a, b)


def _cross(vectors):
    """Matrices (N, 3, 3) with [a x] b = a x b, of vectors (N, 3)."""
    found = np.zeros((len(vectors), 3, 3))
    found[:, 0, 1], found[:, 0, 2], found[:, 1, 2] = -vectors[:, 2], vectors[:, 1], -vectors[:, 0]
    return found - found.transpose(0, 2, 1)
'''

_DISTANCE = '''\
def distance(state, rotor_speeds, rotor_accelerations=None, extra=None):
    """How far outside the region of the training data, (N,), and in which variable most, (N,) names.

    0 and "" inside; 0.5 for half of a covered range beyond its end; NaN for a row that holds NaN. One row gives a
    number and a name. Arguments as for `predict`.
    """
    columns, rows = _columns(state, rotor_speeds, rotor_accelerations, extra)
    with np.errstate(all="ignore"):
        values = np.column_stack([np.broadcast_to(value, rows) for value in _limited(columns)])
        limited, together = values[:, : len(LOW)], values[:, len(LOW) :]
        beyond = np.maximum(np.maximum(LOW - limited, limited - HIGH), 0.0)/(HIGH - LOW)
        joint = np.maximum(0.5*(np.sqrt(np.sum((together @ WHITENING.T)**2, axis=1))/JOINT_LIMIT - 1.0), 0.0)
    every = np.column_stack([beyond, joint])
    found = every.max(axis=1)
    worst = np.where(found > 0.0, np.array(LIMITED)[np.argmax(np.nan_to_num(every), axis=1)], "")
    return (found[0], worst[0]) if np.ndim(state) == 1 else (found, worst)
'''

_COLUMNS = '''\
def _columns(state, rotor_speeds, rotor_accelerations, extra):
    """Columns by name, and their length, of what `predict` is given."""
    state, speeds = np.atleast_2d(np.asarray(state, float)), np.atleast_2d(np.asarray(rotor_speeds, float))
    if state.ndim != 2 or state.shape[1] not in (9, 12) or (state.shape[1] == 9 and NEEDS_POSITION):
        wanted = "(N, 12)" if NEEDS_POSITION else "(N, 12) or (N, 9)"
        raise ValueError(f"state must be {wanted}, roll pitch yaw u v w p q r [x y z], got {state.shape}")
    rows = len(state)
    slopes = np.zeros((rows, 4)) if rotor_accelerations is None else np.atleast_2d(rotor_accelerations).astype(float)
    for name, values in (("rotor_speeds", speeds), ("rotor_accelerations", slopes)):
        if values.shape != (rows, 4):
            raise ValueError(f"{name} must be ({rows}, 4) like the state's rows, got {values.shape}")
    names = ("roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z")[: state.shape[1]]
    columns = {name: state[:, k] for k, name in enumerate(names)}
    columns.update({f"w{k + 1}": speeds[:, k] for k in range(4)})
    columns.update({f"w{k + 1}_dot": slopes[:, k] for k in range(4)})
    for name in EXTRA_INPUTS:
        if name not in (extra or {}):
            raise ValueError(f"this model needs the column {name!r}; give it in `extra`")
        columns[name] = np.broadcast_to(np.asarray(extra[name], float), (rows,))
    return columns, rows
'''

_WRAP = '''\
def _wrap(a):
    """An angle brought to -pi .. pi."""
    return a - 6.283185307179586*np.rint(a/6.283185307179586)
'''
