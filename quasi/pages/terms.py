"""Terms of a model in mathematical notation, and the legend of their variables."""

from collections.abc import Iterable

from quasi.errors import ExpressionError
from quasi.tables import COLUMNS
from quasi.terms.expressions import Tree, names, parse
from quasi.terms.singularities import FLOWN_SPEEDS
from quasi.terms.variables import FORMULAS, derive_variable_unit, plain_name

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_AXIS_MEANINGS = {"p": "roll, left minus right", "q": "pitch, front minus rear", "r": "yaw, by direction of rotation"}
# name: (unit, meaning), of the manual's Table 2; columns of flights stand in quasi.tables
VARIABLES: dict[str, tuple[str, str]] = {
    **{f"d_w{i}": ("rad/s", f"speed of rotor {i} minus the hover speed") for i in range(1, 5)},
    "w_tot": ("rad/s", "sum of the four rotor speeds"),
    "w_avg": ("rad/s", "root mean square of the four rotor speeds"),
    "d_w_tot": ("rad/s", "sum of the rotor speeds minus four times the hover speed"),
    **{f"u_{a}": ("rad/s", f"rotor speeds weighted for {axis_text}") for a, axis_text in _AXIS_MEANINGS.items()},
    **{
        f"U_{a}": ("rad²/s²", f"squared rotor speeds weighted for {axis_text}")
        for a, axis_text in _AXIS_MEANINGS.items()
    },
    "w_tot_dot": ("rad/s²", "sum of the rotor accelerations"),
    **{
        f"u_{a}_dot": ("rad/s²", f"rotor accelerations weighted for {axis_text}")
        for a, axis_text in _AXIS_MEANINGS.items()
    },
    "u": ("m/s", "velocity through the air, forward"),
    "v": ("m/s", "velocity through the air, to the right"),
    "w": ("m/s", "velocity through the air, down"),
    "mu_x": ("1/rad", "advance ratio u / (w_avg_flown R), R the rotor radius"),
    "mu_y": ("1/rad", "advance ratio v / (w_avg_flown R)"),
    "mu_z": ("1/rad", "advance ratio w / (w_avg_flown R)"),
    "mu_vin": ("1/rad", "induced velocity v_in / (w_avg_flown R)"),
    **{
        name: ("rad/s", f"{speed}, at least its lowest value in the training flights")
        for name, speed in FLOWN_SPEEDS.items()
    },
    "F_den": ("N", "scale of non-dimensional forces"),
    "M_den": ("N m", "scale of non-dimensional moments"),
}


def show_expression(text: str) -> str:
    """Format an expression without needless brackets and powers of one: (w_avg^2)*(mu_x^(1.0)) is w_avg² · mu_x.

    Text that is no expression is returned unchanged.
    """
    try:
        return _show(parse(text))[0]
    except ExpressionError:
        return text


def _show(tree: Tree) -> tuple[str, int]:
    """Return text and operator precedence: 0 sum, 1 product, 2 sign, 3 power, 4 atom."""
    kind = tree[0]

    def within(node: Tree, least: int) -> str:
        shown, binds = _show(node)
        return shown if binds >= least else f"({shown})"

    if kind == "number":
        return (f"{tree[1]:g}".replace("-", "−"), 4 if tree[1] >= 0 else 2)
    if kind == "name":
        return tree[1], 4
    if kind == "negative":
        return f"−{within(tree[1], 3)}", 2
    if kind == "power":
        return _show_power(tree, within)
    parts = []
    if kind == "sum":
        for sign, node in tree[1]:
            parts.append((" − " if sign < 0 else " + ") + within(node, 1 if sign > 0 else 2))
        first = parts[0].removeprefix(" + ").replace(" − ", "−", 1) if parts[0].startswith(" −") else parts[0][3:]
        return "".join([first, *parts[1:]]), 0
    for sign, node in tree[1]:
        parts.append((" · " if sign > 0 else " / ") + within(node, 1 if sign > 0 and not parts else 3))
    return "".join(["1" if tree[1][0][0] < 0 else "", parts[0][3:] if tree[1][0][0] > 0 else parts[0], *parts[1:]]), 1


def _show_power(tree: Tree, within) -> tuple[str, int]:
    base, exponent = tree[1], tree[2]
    if exponent[0] == "number":
        if exponent[1] == 1.0:
            return _show(base)
        if exponent[1] == 0.5:
            return f"√{_show(base)[0]}" if base[0] in ("name", "number") else f"√({_show(base)[0]})", 4
        if float(exponent[1]).is_integer():
            return within(base, 4) + f"{exponent[1]:.0f}".translate(RAISED), 3
    return f"{within(base, 4)}^{within(exponent, 4)}", 3


def describe_variable(name: str) -> tuple[str, str]:
    """Return unit and meaning of a variable; ("", "a column of the flights") for an unknown one."""
    if name in VARIABLES:
        return VARIABLES[name]
    if name in FORMULAS:
        formula, meaning = FORMULAS[name]
        return derive_variable_unit(name).replace("2", "²"), f"{meaning}, {show_expression(formula)}"
    if name in COLUMNS:
        unit, _, meaning = COLUMNS[name]
        return ("" if unit == "1" else unit.replace("s2", "s²")), meaning
    return "", "a column of the flights"


def list_variables(expressions: Iterable[str]) -> list[tuple[str, str, str]]:
    """List (name, unit, meaning) of every variable in the expressions, in alphabetic order; |u| counts as u."""
    found: set[str] = set()
    for text in expressions:
        try:
            found |= {plain_name(name) for name in names(parse(text))}
        except ExpressionError:
            continue
    return [(name, *describe_variable(name)) for name in sorted(found - {"bias"}, key=str.lower)]
