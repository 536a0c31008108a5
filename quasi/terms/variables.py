"""Candidate variables: what a polynomial may be made of, from the columns of a flight or the state of a simulation.

The manual's Table 2 under its own names and under the spellings of published models, and what it lacks:

    w1..w4, w2_1..w2_4, w1_CMD..        rotor speeds (mechanical rad/s), their squares, commanded speeds
    w_tot (wtot), w_avg (wavg)          sum; root of the mean square
    u_p u_q u_r, U_p U_q U_r            sums weighted by left, front and spin sign of the speeds, of their squares
    d_w1.., d_w_tot (d_wtot)            difference from the hover speed
    u v w (u_air v_air w_air)           velocity through the air (over ground where no wind is known)
    mu_x mu_y mu_z mu_vin               u, v, w, v_in over the tip speed w_avg_flown R
    w_avg_flown, w_tot_flown, w1_flown  the speed, not below the lowest of the training flights: in denominators
    roll pitch yaw p q r x y z          attitude wrapped to +-pi, body rates, position
    w1_dot.., w_tot_dot, u_p_dot ..     rotor accelerations, rad/s2, their sum and weighted sums
    battery_voltage, v_in, ...          any further column under its own name
    F_den M_den                         N and N b of a non-dimensional model, see `quasi.terms.normalisation`
    |name|  sin[name]  cos[name]        of every one of these

Source: QuaSI user manual V1.0.a, Table 2, equations (13) and (15).
"""

import re
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from quasi.airframe import Airframe
from quasi.errors import ConfigError, ExpressionError, nearest
from quasi.tables import COLUMNS
from quasi.terms.expressions import Tree, evaluate, names, parse
from quasi.terms.normalisation import Normalisation
from quasi.terms.singularities import ADVANCE_RATIOS, FLOWN_SPEEDS, find_speed_limits

# name: (expression of other variables, meaning). A line here is all that a variable needs: flights, compiled models,
# derivatives, units, exports and the legend of a model's page are made from it
FORMULAS: dict[str, tuple[str, str]] = {
    f"w2_{i}": (f"w{i}^2", f"square of the speed of rotor {i}") for i in range(1, 5)
}
SYNONYMS: dict[str, Tree] = {
    "wtot": ("name", "w_tot"),
    "wavg": ("name", "w_avg"),
    "d_wtot": ("name", "d_w_tot"),
    **{name: parse(formula) for name, (formula, _) in FORMULAS.items()},
    # u v w are velocities through the air already: the columns of that name take their place in `Variables.column`
    **{f"{v}_air": ("name", v) for v in "uvw"},
}
_ROTORS = tuple(f"w{i}" for i in range(1, 5))
_DOTS = tuple(f"w{i}_dot" for i in range(1, 5))
_STATES = ("roll", "pitch", "yaw", *"uvwpqrxyz")
_AIR = {"u": "u_air", "v": "v_air", "w": "w_air"}
_FUNCTION_PATTERN = re.compile(r"^(?:\|(?P<abs>.+)\||(?P<function>sin|cos)\[(?P<of>.+)\])$")

# name: the columns it is made from; hover speed, radius and signs come from elsewhere
_SOURCE_COLUMNS: dict[str, tuple[str, ...]] = {
    **{f"d_w{i}": (f"w{i}",) for i in range(1, 5)},
    **dict.fromkeys(("w_tot", "w_avg", "d_w_tot", "u_p", "u_q", "u_r", "U_p", "U_q", "U_r"), _ROTORS),
    **dict.fromkeys(("w_tot_dot", "u_p_dot", "u_q_dot", "u_r_dot"), _DOTS),
    **{ratio: (*_ROTORS, v) for ratio, v in ADVANCE_RATIOS.items()},
    **{name: _ROTORS if speed in ("w_avg", "w_tot") else (speed,) for name, speed in FLOWN_SPEEDS.items()},
}

# base dimensions: length, mass, time, angle, voltage; powers
_DIMENSIONS: dict[str, tuple[float, ...]] = {}
for _unit, _members in {
    (0, 0, -1, 1, 0): (*_ROTORS, *(f"w{i}_CMD" for i in range(1, 5)), *(f"d_w{i}" for i in range(1, 5)),
                       "w_tot", "w_avg", "d_w_tot", *FLOWN_SPEEDS, "u_p", "u_q", "u_r", "p", "q", "r"),
    (0, 0, -2, 2, 0): ("U_p", "U_q", "U_r"),
    (0, 0, -2, 1, 0): (*_DOTS, "w_tot_dot", "u_p_dot", "u_q_dot", "u_r_dot", "p_dot", "q_dot", "r_dot"),
    (1, 0, -1, 0, 0): ("u", "v", "w", "v_in"),
    (0, 0, 0, -1, 0): ("mu_x", "mu_y", "mu_z", "mu_vin"),
    (0, 0, 0, 1, 0): ("roll", "pitch", "yaw"),
    (1, 0, 0, 0, 0): ("x", "y", "z"),
    (0, 0, 0, 0, 1): ("battery_voltage",),
    (0, 0, 0, 0, 0): ("throttle", *(f"command{i}" for i in range(1, 5))),
}.items():  # fmt: skip
    _DIMENSIONS.update(dict.fromkeys(_members, _unit))
_SCALES = ("F_den", "M_den")  # of forces and moments, in the non-dimensional scheme alone
_TARGETS = {
    **dict.fromkeys(("Fx", "Fy", "Fz"), (1, 1, -2, 0, 0)),
    **dict.fromkeys(("Mx", "My", "Mz"), (2, 1, -2, 0, 0)),
}


def columns_of(tree: Tree, normalisation: Normalisation | None = None) -> set[str]:
    """Base columns that an expression needs. Velocities stand as u, v, w, whether through the air or over ground."""
    return set().union(*(base_columns(name, normalisation) for name in names(tree)), set())


def base_columns(name: str, normalisation: Normalisation | None = None) -> set[str]:
    """Base columns that a variable is made from; a name outside the table is a column of its own."""
    name = SYNONYMS[name][1] if name in SYNONYMS and SYNONYMS[name][0] == "name" else name
    match = _FUNCTION_PATTERN.match(name)
    if match:
        return base_columns(match["abs"] or match["of"], normalisation)
    if normalisation and name in normalisation.trees:
        return columns_of(normalisation.trees[name])
    if name in SYNONYMS:
        return columns_of(SYNONYMS[name], normalisation)
    return set(_SOURCE_COLUMNS.get(name, (name,)))


def split_function(name: str) -> tuple[str | None, str]:
    """("abs", "sin" or "cos", name inside) of |name|, sin[name], cos[name]; (None, name) of any other."""
    match = _FUNCTION_PATTERN.match(name)
    if not match:
        return None, name
    return ("abs", match["abs"]) if match["abs"] else (match["function"], match["of"])


def plain_name(name: str) -> str:
    """The variable inside |..|, sin[..], cos[..], under one spelling (wtot is w_tot)."""
    function, name = split_function(name)
    while function:
        function, name = split_function(name)
    return SYNONYMS[name][1] if name in SYNONYMS and SYNONYMS[name][0] == "name" else name


def known_names(columns: Mapping[str, object] | set[str]) -> list[str]:
    """Names that these columns make possible, without |..|, sin[..] and cos[..], which every name allows."""
    have = {*columns, *(v for v, air in _AIR.items() if air in columns)}
    made = [name for name in FORMULAS if have.issuperset(base_columns(name))]
    made += [name for name, needs in _SOURCE_COLUMNS.items() if have.issuperset(needs)]
    return [*made, *(n for n in _AIR if n in have and n not in columns), *(n for n in columns if n not in made)]


def check_expression(text: str, place: str, normalised: bool = False) -> None:
    """Refuse an expression that cannot be read, or names a variable that no flight can hold.

    normalised  whether the scales of the non-dimensional scheme, F_den and M_den, may stand in it
    Whether the flights at hand hold it shows only once they are read. Raises ExpressionError beginning with `place`.
    """
    known = {*_SOURCE_COLUMNS, *_DIMENSIONS, *SYNONYMS, *COLUMNS, *(_SCALES if normalised else ())}
    try:
        found = names(parse(text))
    except ExpressionError as error:
        raise ExpressionError(f"{place}: {error}") from None
    for name in found:
        if plain_name(name) in _SCALES and not normalised:
            raise ExpressionError(
                f"{place}: '{name}' is a scale of non-dimensional models ('normalize data' true), expected variables "
                "in SI units; leave it out"
            )
        if plain_name(name) not in known:
            raise ExpressionError(f"{place}: unknown variable '{name}'{nearest(plain_name(name), known)}")


def check_terms(document: object, where: str) -> None:
    """Refuse a model's plain data with a term that means nothing; damaged data is left to whoever reads it whole.

    Raises ExpressionError naming `where`, axis and term.
    """
    axes = document.get("axes") if isinstance(document, Mapping) else None
    normalised = isinstance(axes, Mapping) and document.get("normalisation") is not None
    for axis, part in axes.items() if isinstance(axes, Mapping) else ():
        terms = part.get("terms") if isinstance(part, Mapping) else None
        for term in terms if isinstance(terms, list) else ():
            text = term.get("expression") if isinstance(term, Mapping) else None
            if isinstance(text, str):
                check_expression(text, f"{where}, {axis}, term '{text}'", normalised)


def check_system_inputs(u: Iterable[str], where: str) -> tuple[str, ...]:
    """The inputs of a differential form under one spelling.

    Raises ConfigError for what cannot be one: a rate, |..|, sin[..], a squared speed, an unknown name, the same twice,
    or a variable together with one of its parts.
    """
    found: list[str] = []
    logged = [n for n in COLUMNS if n.startswith(("command", "battery", "v_in", "throttle"))]
    known = [n for n in known_names({*_STATES, *_ROTORS, *_DOTS, *logged}) if n not in FORMULAS]
    cannot = "cannot be an input of the differential form"
    for name in u:
        if not isinstance(name, str):
            raise ConfigError(f"{where}: {name!r} {cannot}, expected the name of a variable such as U_p")
        inner = split_function(name)[1]
        if inner != name:
            raise ConfigError(f"{where}: '{name}' {cannot}; name '{inner}'")
        if name in FORMULAS:
            columns = "', '".join(sorted(base_columns(name)))
            raise ConfigError(f"{where}: '{name}' {cannot}; name '{columns}'")
        plain = SYNONYMS[name][1] if name in SYNONYMS else name
        if plain in ("p", "q", "r"):
            raise ConfigError(f"{where}: '{name}' {cannot}, for it is part of x = (p, q, r); leave it out")
        if plain not in known:
            raise ConfigError(f"{where}: unknown input '{name}' of the differential form{nearest(name, known)}")
        if plain in found:
            raise ConfigError(f"{where}: '{name}' stands twice among the inputs of the differential form; name it once")
        found.append(plain)
    for name in found:
        both = sorted((base_columns(name) - {name}) & set(found))
        if both:
            raise ConfigError(
                f"{where}: '{name}' is made of '{both[0]}', so that they cannot both be inputs of the differential "
                "form; name one of them"
            )
    if not found:
        raise ConfigError(f"{where}: the differential form needs at least one input, such as U_p")
    return tuple(found)


class Variables:
    """Candidate variables by name, each computed on first access.

    columns      {name: (n,)} base columns in SI units: w1..w4, u v w, p q r, roll pitch yaw, and what else there is
    airframe     signs of the rotors and the rotor radius
    hover_speed  rad/s, one rotor's speed in hover; None when unknown (then d_w... cannot be asked)
    normalisation  the non-dimensional scheme, under which names stand for other quantities; None for SI
    slowest      (4,) rad/s, lowest speed of each rotor in the training flights; None where unknown
    """

    def __init__(
        self,
        columns: Mapping[str, np.ndarray],
        airframe: Airframe,
        hover_speed: float | None,
        normalisation: Normalisation | None = None,
        slowest: Iterable[float] | None = None,
    ) -> None:
        self._lowest = find_speed_limits(slowest)
        self._columns = columns
        self._airframe = airframe
        self._hover = hover_speed
        self._values: dict[str, np.ndarray] = {}
        self._trees = normalisation.trees if normalisation else {}
        self._plain = Variables(columns, airframe, hover_speed) if normalisation else self

    def known(self) -> list[str]:
        """Names that can be asked, without |..|, sin[..] and cos[..], which every name allows."""
        listed = known_names(self._columns)
        return listed if self._hover is not None else [n for n in listed if not n.startswith("d_w")]

    def __getitem__(self, name: str) -> np.ndarray:
        """Values (n,) of a variable. Raises ExpressionError for an unknown name or one whose columns are missing."""
        if name not in self._values:
            self._values[name] = self._make(name)
        return self._values[name]

    def column(self, name: str, of: str | None = None) -> np.ndarray:
        """A base column, for the variable `of`. Raises ExpressionError when it is missing."""
        name = _AIR[name] if name in _AIR and _AIR[name] in self._columns else name
        if name not in self._columns:
            raise ExpressionError(
                f"variable '{of or name}' needs the column '{name}', which this data lacks; leave it out or log it"
            )
        return np.asarray(self._columns[name], float)

    def _make(self, name: str) -> np.ndarray:
        match = _FUNCTION_PATTERN.match(name)
        if match:
            if match["abs"]:
                return np.abs(self[match["abs"]])
            return (np.sin if match["function"] == "sin" else np.cos)(self[match["of"]])
        if name in self._trees:
            return evaluate(self._trees[name], self._plain.__getitem__)
        if name in SYNONYMS:
            tree = SYNONYMS[name]
            return self[tree[1]] if tree[0] == "name" else evaluate(tree, self._of(name))
        if name in _SOURCE_COLUMNS:
            return self._derived(name)
        if name in ("roll", "pitch", "yaw"):
            angle = self.column(name, name)
            return angle - 2 * np.pi * np.round(angle / (2 * np.pi))
        if name in _DIMENSIONS or name in self._columns:
            return self.column(name, name)
        raise ExpressionError(f"unknown variable '{name}'{nearest(name, self.known())}")

    def _of(self, name: str) -> Callable[[str], np.ndarray]:
        """Lookup of the variables in the formula of `name`; a missing column is reported for `name`."""
        base = set() if self._trees else {*_ROTORS, *_DOTS}
        return lambda inner: self.column(inner, name) if inner in base else self[inner]

    def _derived(self, name: str) -> np.ndarray:
        if name.startswith("mu_"):
            return self.column(ADVANCE_RATIOS[name], name) / (self["w_avg_flown"] * self._airframe.radius)
        if name in FLOWN_SPEEDS:
            return np.maximum(self[FLOWN_SPEEDS[name]], self._lowest[FLOWN_SPEEDS[name]])
        if name.endswith("_dot"):
            speeds = [self.column(c, name) for c in _DOTS]
            return self._weighted(name.removesuffix("_dot"), speeds)
        if name.startswith("d_w"):
            if self._hover is None:
                raise ExpressionError(
                    f"variable '{name}' needs the hover speed, which is unknown; give a flight that hovers"
                )
            return self["w_tot"] - 4 * self._hover if name == "d_w_tot" else self.column(name[2:], name) - self._hover
        speeds = [self.column(c, name) for c in _ROTORS]
        if name == "w_avg":
            return np.sqrt(sum(w * w for w in speeds) / 4.0)
        if name[0] == "U":
            return self._weighted(name.lower(), [w * w for w in speeds])
        return self._weighted(name, speeds)

    def _weighted(self, name: str, values: list[np.ndarray]) -> np.ndarray:
        frame = self._airframe
        signs = {"w_tot": np.ones(4), "u_p": frame.left, "u_q": frame.front, "u_r": frame.spin}[name]
        return sum(s * v for s, v in zip(signs, values))


def derive_unit(tree: Tree, target: str) -> str:
    """Unit of the coefficient that turns an expression into the target ("Fx" .. "Mz"), e.g. "N s2/rad2".

    "mixed" stands for those without one: sums of unlike quantities and for powers that vary.
    """
    dimension = _dimension(tree)
    if dimension is None:
        return "mixed"
    length, mass, time, angle, voltage = (t - d for t, d in zip(_TARGETS[target], dimension))
    return _unit_text(length, mass, time, angle, voltage)


def derive_variable_unit(name: str) -> str:
    """Unit of a variable, e.g. "rad2/s2"; "mixed" where its formula adds unlike quantities, "" where unknown."""
    dimension = _unit_of_name(name)
    return ("mixed" if name in FORMULAS else "") if dimension is None else _unit_text(*dimension)


def _unit_text(length: float, mass: float, time: float, angle: float, voltage: float) -> str:
    # newtons take the mass; what is left over is written in base units
    parts = {"N": mass, "kg": 0.0, "m": length - mass, "s": time + 2 * mass, "rad": angle, "V": voltage}
    shown = {True: [], False: []}
    for unit, power in parts.items():
        if power:
            size = abs(power)
            shown[power > 0].append(unit + ("" if size == 1 else f"{size:g}"))
    over = " ".join(shown[True]) or "1"
    under = " ".join(shown[False])
    if not under:
        return over
    return f"{over}/{under}" if len(shown[False]) == 1 else f"{over}/({under})"


def _unit_of_name(name: str) -> tuple | None:
    match = _FUNCTION_PATTERN.match(name)
    if match:
        return _unit_of_name(match["abs"]) if match["abs"] else (0,) * 5
    if name in SYNONYMS:
        return _dimension(SYNONYMS[name])
    return _DIMENSIONS.get(name)


def _dimension(tree: Tree) -> tuple | None:
    kind = tree[0]
    if kind == "number":
        return (0,) * 5
    if kind == "name":
        return _unit_of_name(tree[1])
    if kind == "negative":
        return _dimension(tree[1])
    if kind == "power":
        base = _dimension(tree[1])
        power = tree[2]
        sign = -1.0 if power[0] == "negative" else 1.0
        power = power[1] if power[0] == "negative" else power
        if base is None or power[0] != "number":
            return base if base == (0,) * 5 else None
        return tuple(b * sign * power[1] for b in base)
    parts = [(sign, _dimension(part)) for sign, part in tree[1]]
    if any(d is None for _, d in parts):
        return None
    if kind == "sum":
        return parts[0][1] if len({d for _, d in parts}) == 1 else None
    return tuple(sum(sign * d[i] for sign, d in parts) for i in range(5))
