"""A model as one C99 file and its header, without dependencies: float64, or float32 when QUASI_FLOAT32 is defined.

    files = c_files(model)                     {"quasi_example.h": text, "quasi_example.c": text}

The arithmetic is that of `Model.predict`, operation by operation. A compiler that joins a product and a sum into one
operation (-ffp-contract=fast) gives other last digits; -ffp-contract=off keeps them.
"""

import math
from collections.abc import Sequence

import numpy as np

from quasi.export.command_map import c_map
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
from quasi.export.listing import Listing, Output, Writer, of_derivatives, of_model, of_region, weighted
from quasi.export.naming import local, shown
from quasi.model.extensions import actuators_of
from quasi.model.model import AXES, Model
from quasi.terms.differential import RATES
from quasi.terms.kernel import INPUTS

_MATHS = {"abs": "fabs", "sqrt": "sqrt", "sin": "sin", "cos": "cos", "log": "log", "power": "pow", "rint": "rint",
          "exp": "exp", "floor": "floor"}  # fmt: skip
_SHORTEST = 0.0005  # s, the shortest time step for which the delay line has room by default
_ARGUMENTS = (
    "const {real} state[12], const {real} rotor_speeds[4],\n    const {real} *rotor_accelerations, const {real} *extra"
)


def number(value: float) -> str:
    """A number of the chosen precision."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return f"N({value!r})"


def _call(function: str, parts: Sequence[str]) -> str:
    if function in ("sign", "wrap"):
        return f"{function}_of({parts[0]})"
    return f"{_MATHS[function].upper()}({', '.join(parts)})"


WRITER = Writer(number, _call, local)


def c_files(model: Model) -> dict[str, str]:
    """Header and source of a model, by file name. Raises ConfigError for what cannot be carried, by name."""
    check_exportable(model)
    p = name_in_source(model)
    return {f"{p}.h": _header(model, p), f"{p}.c": _source(model, p)}


def _comment(lines: Sequence[str]) -> str:
    return "/*\n" + "".join(f" * {line}".rstrip() + "\n" for line in lines) + " */\n"


def _header(model: Model, p: str) -> str:
    guard = f"{p}_H"  # not in capitals throughout: IDs that differ by the case of letters are two models
    extras, u = extras_of(model), differential_inputs(model)
    parts = [
        _comment(
            [
                *head(model),
                "",
                f"Compile {p}.c with any C99 compiler and link the mathematics library (-lm). Numbers are",
                "double; define QUASI_FLOAT32, everywhere alike, for float. Nothing is allocated, and nothing is kept",
                "between calls.",
            ]
        ),
        f'#ifndef {guard}\n#define {guard}\n\n#ifdef __cplusplus\nextern "C" {{\n#endif\n',
        f"#ifdef QUASI_FLOAT32\ntypedef float {p}_real;\n#else\ntypedef double {p}_real;\n#endif\n",
        f"#define {p}_EXTRA_INPUTS {len(extras)}",
    ]
    if extras:
        parts.append(_comment(["extra[] holds", *(f"  {i}  {shown(name)}" for i, name in enumerate(extras))]))
    for name, value in constants_of(model).items():
        size = f"[{len(value)}]" if isinstance(value, list) else ""
        parts.append(f"extern const {p}_real {p}_{name}{size}; /* {MEANINGS[name]} */")
    arguments = _ARGUMENTS.format(real=f"{p}_real")
    parts += [
        "",
        _comment(
            [
                "Forces, N, and moments, N m, in body axes. rotor_accelerations may be NULL: zero, the quasi-steady",
                "model. extra may be NULL where there are no extra inputs.",
            ]
        )
        + f"void {p}_forces_and_moments(\n    {arguments},\n    {p}_real forces[3], {p}_real moments[3]);\n",
    ]
    if u:
        held = model.held_constant(u)
        parts.append(
            _comment(
                [
                    "Differential form of the rotation: d/dt (dx/dt) = A dx/dt + B du/dt, x = (p, q, r), row by row.",
                    f"u = {', '.join(u)}.",
                    *([f"Kept constant in B: {', '.join(held)}."] if held else []),
                ]
            )
            + f"void {p}_differential_form(\n    {arguments},\n    {p}_real A[9], {p}_real B[{3 * len(u)}]);\n"
        )
    if has_region(model):
        parts.append(
            _comment(
                [
                    "How far outside the region of the training data: 0 inside, 0.5 for half of a covered range beyond",
                    "its end, NaN for inputs that are none. *worst (may be NULL): -1 inside, else the number of",
                    *(f"  {i}  {shown(name)}" for i, name in enumerate(model.region_names)),
                ]
            )
            + f"{p}_real {p}_distance(\n    {arguments}, int *worst);\n"
        )
    parts.append(_rotors_header(model, p))
    if mapped := c_map(model, p):
        parts.append(mapped[0])
    parts.append("#ifdef __cplusplus\n}\n#endif\n\n#endif")
    return "\n".join(parts) + "\n"


def _rotors_header(model: Model, p: str) -> str:
    rows = math.ceil(actuators_of(model).delay / _SHORTEST) + 2
    note = [f"Assumed: {note}." for note in actuators_of(model).notes]
    return (
        _comment(
            [
                "The rotors: a delay, limits, then a first-order lag. start: 0, or 1 for a time step (s) that is not",
                "positive or for which the delay line is too short (define a greater ..._DELAY_ROWS then). step: the",
                "speeds at its end, rad/s.",
                *note,
            ]
        )
        + f"#ifndef {p}_DELAY_ROWS\n#define {p}_DELAY_ROWS {rows}\n#endif\n"
        f"typedef struct {{\n    {p}_real time_step, speeds[4], commands[{p}_DELAY_ROWS][4];\n"
        f"    int latest;\n}} {p}_rotors;\n"
        f"int {p}_rotors_start({p}_rotors *rotors, {p}_real time_step, const {p}_real speeds[4]);\n"
        f"void {p}_rotors_step({p}_rotors *rotors, const {p}_real commanded[4], {p}_real speeds[4]);\n"
    )


def _source(model: Model, p: str) -> str:
    forces = of_model(model)
    u = differential_inputs(model)
    derivatives = of_derivatives(model, (*RATES, *u)) if u else None
    region = of_region(model) if has_region(model) else None
    used = set().union(*(part.functions for part in (forces, derivatives, region) if part is not None))
    mapped = c_map(model, p)
    used |= {"sqrt", "power"} if mapped else set()
    used |= {"exp", "floor"} | ({"rint"} if "wrap" in used else set()) | ({"sqrt"} if region else set())
    maths = sorted(_MATHS[f] for f in used if f in _MATHS)
    parts = [
        f"/* Aerodynamic model {shown(model.id)}: see {p}.h. Made by quasi; do not edit. */",
        f'#include "{p}.h"\n\n#include <math.h>\n#include <stddef.h>\n',
        f"typedef {p}_real real;\n#define N(number) ((real)(number))\n#ifdef QUASI_FLOAT32",
        *(f"#define {name.upper()} {name}f" for name in maths),
        "#else",
        *(f"#define {name.upper()} {name}" for name in maths),
        "#endif\n",
    ]
    for name, value in constants_of(model).items():
        rows = isinstance(value, list)
        written = "{" + ", ".join(number(v) for v in value) + "}" if rows else number(value)
        parts.append(f"const real {p}_{name}{f'[{len(value)}]' if rows else ''} = {written};")
    parts.append("")
    if "sign" in used:
        parts.append("static real sign_of(real a)\n{\n    return a > 0 ? N(1) : a < 0 ? N(-1) : a;\n}\n")
    if "wrap" in used:
        parts.append(
            "/* an angle brought to -pi .. pi */\nstatic real wrap_of(real a)\n{\n"
            "    return a - N(6.283185307179586)*RINT(a/N(6.283185307179586));\n}\n"
        )
    arguments = _ARGUMENTS.format(real="real")
    body = [*_loads(forces, extras_of(model)), *_steps(forces)]
    for m, axis in enumerate(AXES):
        body.append("")
        body.append(f"    /* {axis}, {'N' if m < 3 else 'N m'}:")
        body += [f"     *   {line}" for line in terms_of(model, axis)]
        body.append("     */")
        body += _sum(forces.outputs[m], axis)
    body.append("")
    body += [f"    forces[{m}] = {axis};" for m, axis in enumerate(AXES[:3])]
    body += [f"    moments[{m}] = {axis};" for m, axis in enumerate(AXES[3:])]
    results = "real forces[3], real moments[3]"
    parts.append(_function(f"void {p}_forces_and_moments", f"{arguments},\n    {results}", body))
    if derivatives is not None:
        parts.append(_differential_form(model, derivatives, u, p, arguments))
    if region is not None:
        parts.append(_distance(model, region, p, arguments))
    parts.append(_ROTORS_SOURCE.replace("@ROWS@", f"{p}_DELAY_ROWS").replace("@", p))
    if mapped:
        parts.append(mapped[1])
    return "\n".join(parts)


def _function(name: str, arguments: str, body: Sequence[str]) -> str:
    return f"{name}(\n    {arguments})\n{{\n" + "\n".join(body) + "\n}\n"


def _loads(listing: Listing, extras: Sequence[str]) -> list[str]:
    """Statements that name the inputs which a listing reads."""
    lines, unused = [], {"state", "rotor_speeds", "rotor_accelerations", "extra"}
    for name in listing.inputs:
        if name not in INPUTS:
            source = f"extra[{extras.index(name)}]"
        else:
            at = INPUTS.index(name)
            source = f"state[{at}]" if at < 12 else f"rotor_speeds[{at - 12}]"
            if at >= 16:
                source = f"rotor_accelerations != NULL ? rotor_accelerations[{at - 16}] : N(0)"
        unused.discard(source.split("[")[0].split(" ")[0])
        lines.append(f"    const real {local(name)} = {source};")
    return [*lines, *(f"    (void){name};" for name in sorted(unused))]


def _steps(listing: Listing) -> list[str]:
    return [f"    const real {name} = {WRITER.text(expression)};" for name, expression in listing.steps]


def _sum(output: Output, name: str) -> list[str]:
    lines = [f"    real {name} = {number(output.offset)};"]
    return lines + [f"    {name} += {weighted(WRITER, weight, e)};" for weight, e in output.terms]


def _differential_form(model: Model, listing: Listing, u: Sequence[str], p: str, arguments: str) -> str:
    width = 3 + len(u)
    names = [f"{axis} by {v}" for axis in AXES[3:] for v in (*RATES, *u)]
    inertia = np.asarray(model.airframe.inertia, float)
    body = [
        *_loads(listing, extras_of(model)),
        *_steps(listing),
        f"    static const real I[9] = {_row(inertia.ravel())};",
        f"    static const real inverse[9] = {_row(np.linalg.inv(inertia).ravel())};",
        f"    real d[{3 * width}]; /* derivatives of Mx My Mz by p q r and u, row by row */",
        "    const real turn[3] = {state[6], state[7], state[8]};",
        "    real h[3], gyroscopic[9]; /* angular momentum I w, and what it adds to the derivatives */",
        "    int i, k, j;",
        "",
    ]
    for m, (output, name) in enumerate(zip(listing.outputs, names, strict=True)):
        terms = [weighted(WRITER, w, e) for w, e in output.terms]
        first = [] if output.offset == 0.0 and terms else [number(output.offset)]
        body.append(f"    d[{m}] = {' + '.join([*first, *terms])}; /* {name} */")
    body.append(
        f"""
    for (i = 0; i < 3; i++) {{
        h[i] = I[3*i]*turn[0] + I[3*i + 1]*turn[1] + I[3*i + 2]*turn[2];
    }}
    /* less d(w cross I w)/dw = [w cross] I - [(I w) cross] */
    for (k = 0; k < 3; k++) {{
        gyroscopic[k] = turn[1]*I[6 + k] - turn[2]*I[3 + k];
        gyroscopic[3 + k] = turn[2]*I[k] - turn[0]*I[6 + k];
        gyroscopic[6 + k] = turn[0]*I[3 + k] - turn[1]*I[k];
    }}
    gyroscopic[1] += h[2];
    gyroscopic[2] -= h[1];
    gyroscopic[3] -= h[2];
    gyroscopic[5] += h[0];
    gyroscopic[6] += h[1];
    gyroscopic[7] -= h[0];
    for (i = 0; i < 3; i++) {{
        for (k = 0; k < 3; k++) {{
            d[{width}*i + k] -= gyroscopic[3*i + k];
        }}
    }}
    for (i = 0; i < 3; i++) {{
        for (k = 0; k < {width}; k++) {{
            real sum = 0;
            for (j = 0; j < 3; j++) {{
                sum += inverse[3*i + j]*d[{width}*j + k];
            }}
            if (k < 3) {{
                A[3*i + k] = sum;
            }} else {{
                B[{len(u)}*i + k - 3] = sum;
            }}
        }}
    }}"""
    )
    return _function(f"void {p}_differential_form", f"{arguments},\n    real A[9], real B[{3 * len(u)}]", body)


def _row(values: Sequence[float]) -> str:
    return "{" + ", ".join(number(float(v)) for v in values) + "}"


def _distance(model: Model, listing: Listing, p: str, arguments: str) -> str:
    limits = model.region.limits
    v, j = len(limits.low), len(limits.whitening)
    body = [
        *_loads(listing, extras_of(model)),
        *_steps(listing),
        f"    static const real low[{max(v, 1)}] = {_row(limits.low) if v else '{0}'};",
        f"    static const real high[{max(v, 1)}] = {_row(limits.high) if v else '{0}'};",
    ]
    if j:
        triangle = [float(limits.whitening[i, k]) for i in range(j) for k in range(i + 1)]
        body.append("    /* the lower triangle that turns the columns together into independent ones, row by row */")
        body.append(f"    static const real whitening[{len(triangle)}] = {_row(triangle)};")
    body += [
        f"    real value[{max(v + j, 1)}], farthest = 0, total = 0, square = 0;",
        f"    int {'i, ' if j else ''}k, {'at = 0, ' if j else ''}found = -1;",
        "",
    ]
    for m, output in enumerate(listing.outputs):
        terms = [weighted(WRITER, w, e) for w, e in output.terms]
        first = [] if output.offset == 0.0 and terms else [number(output.offset)]
        body.append(f"    value[{m}] = {' + '.join([*first, *terms])};")
    body.append(
        f"""
    for (k = 0; k < {v}; k++) {{
        const real under = low[k] - value[k], over = value[k] - high[k];
        const real beyond = under > over ? under : over;
        total += value[k];
        if (beyond > 0 && beyond > farthest*(high[k] - low[k])) {{
            farthest = beyond/(high[k] - low[k]);
            found = k;
        }}
    }}"""
    )
    if j:
        body.append(
            f"""    for (i = 0; i < {j}; i++) {{
        real part = 0;
        for (k = 0; k <= i; k++) {{
            part += whitening[at++]*value[{v} + k];
        }}
        square += part*part;
    }}
    if (N(0.5)*(SQRT(square)/{number(float(limits.limit[0]))} - 1) > farthest) {{
        farthest = N(0.5)*(SQRT(square)/{number(float(limits.limit[0]))} - 1);
        found = {v};
    }}"""
        )
    body.append(
        """    if (total + square != total + square) {
        farthest = NAN;
        found = -1;
    }
    if (worst != NULL) {
        *worst = found;
    }
    return farthest;"""
    )
    return _function(f"real {p}_distance", f"{arguments}, int *worst", body)


_ROTORS_SOURCE = """\
int @_rotors_start(@_rotors *rotors, real time_step, const real speeds[4])
{
    int i, k;
    if (!(time_step > 0) || FLOOR(@_delay/time_step) + 2 > @ROWS@) {
        return 1;
    }
    rotors->time_step = time_step;
    rotors->latest = 0;
    for (i = 0; i < 4; i++) {
        rotors->speeds[i] = speeds[i];
        for (k = 0; k < @ROWS@; k++) {
            rotors->commands[k][i] = speeds[i];
        }
    }
    return 0;
}

void @_rotors_step(@_rotors *rotors, const real commanded[4], real speeds[4])
{
    const real whole = @_delay/rotors->time_step;
    const int late = (int)FLOOR(whole + (sizeof(real) == 4 ? N(1e-4) : N(1e-9)));
    const real share = whole > (real)late ? whole - (real)late : N(0); /* of the command before, within this step */
    int i, now, before;
    rotors->latest = (rotors->latest + 1) % @ROWS@;
    now = (rotors->latest - late + @ROWS@) % @ROWS@;
    before = (now - 1 + @ROWS@) % @ROWS@;
    for (i = 0; i < 4; i++) {
        real target, lag;
        rotors->commands[rotors->latest][i] = commanded[i];
        target = (1 - share)*rotors->commands[now][i] + share*rotors->commands[before][i];
        target = target > @_lowest_speed ? target : @_lowest_speed;
        target = target < @_highest_speed ? target : @_highest_speed;
        lag = target > rotors->speeds[i] ? @_time_constants_up[i] : @_time_constants_down[i];
        rotors->speeds[i] += (target - rotors->speeds[i])*(1 - EXP(-rotors->time_step/lag));
        speeds[i] = rotors->speeds[i];
    }
}
"""
