"""Models published as JSON by QuaSI (the HDBeetle models) as models of this project. Nothing from the file is run.

Such a file holds, per axis, regressors as text, coefficients and an offset; the quadrotor's parameters under
"droneParams"; and under "metadata" whether the forces hold gravity or are normalised.

Their rotor speeds are eRPM/100 x 2 pi/60, not mechanical speeds: mechanical ones are 200 / poles times theirs, and the
file does not say how many poles the motors have. A regressor of degree d in the rotor speeds keeps its text and gets
its coefficient times (poles / 200)^d; one of mixed degree gets the factor inside.

Their U_r and u_r weigh rotors 1 and 4 with one sign and 2 and 3 with the other, whatever the layout; where that is not
the sense of rotation of the layout, both are written out.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from quasi.airframe import DEFAULT_POLES, Airframe, erpm100_to_rad_s, read_airframe
from quasi.errors import ConfigError, ExpressionError, nearest, quoted
from quasi.model.build import assemble_model
from quasi.model.document import AXES, is_number
from quasi.model.model import Model
from quasi.project.logbook import NAME_RULE, VALID_NAME
from quasi.tables import fingerprint, read_json
from quasi.terms.expressions import Tree, names, parse, text
from quasi.terms.kernel import INPUTS
from quasi.terms.variables import SYNONYMS, base_columns, derive_unit, known_names, plain_name, split_function

_ROTORS = tuple(f"w{i}" for i in range(1, 5))
_DEGREE = {
    **dict.fromkeys((*_ROTORS, "w_tot", "w_avg", "u_p", "u_q", "u_r", "d_w_tot", *(f"d_{w}" for w in _ROTORS)), 1),
    **dict.fromkeys((*(f"w{i}_CMD" for i in range(1, 5)), *(f"{w}_dot" for w in _ROTORS)), 1),
    **dict.fromkeys(("w_tot_dot", "u_p_dot", "u_q_dot", "u_r_dot"), 1),
    **dict.fromkeys(("U_p", "U_q", "U_r", *(f"w2_{i}" for i in range(1, 5))), 2),
    **dict.fromkeys(("mu_x", "mu_y", "mu_z", "mu_vin"), -1),
}
_ONE = ("F_den", "M_den")  # 1 in a model that is not normalised
_PUBLISHED_FUNCTIONS = {"abs": abs, "sin": math.sin, "cos": math.cos}
_PUBLISHED_NAMES = [
    *known_names({*INPUTS, "v_in"}),
    *SYNONYMS,
    *(f"w{i}_CMD" for i in range(1, 5)),
    "battery_voltage",
    *_ONE,
]
_WRITTEN_OUT = {"U_r": "w1^2 - w2^2 - w3^2 + w4^2", "u_r": "w1 - w2 - w3 + w4"}
_LONGEST_REGRESSOR = 10_000  # characters of a regressor


def read_published(path: str | Path, name: str | None = None, poles: int | None = None) -> Model:
    """Read a published model.

    name   model ID that it gets, None for its own; poles  magnets of its motors, None for the usual 14, with a note
    Raises ConfigError, ExpressionError or ReadError naming file and entry.
    """
    where = str(path)
    document = read_json(path)
    if not isinstance(document, Mapping) or not {"model", "droneParams", "metadata"} <= set(document):
        raise ConfigError(
            f"{where} is not a published QuaSI model: expected the keys 'model', 'droneParams' and 'metadata'; "
            "give the model's own JSON file"
        )
    about = _section(document, "metadata", where)
    given = about.get("model ID")
    name = given if name is None else name
    if not isinstance(name, str) or not VALID_NAME.fullmatch(name):
        raise ConfigError(f"{where}: {quoted(name)} is no model ID; give {NAME_RULE}")
    if about.get("isNormalized") is not False:
        raise ConfigError(f"{where}: only models that are not normalised can be read; choose another model")
    if not isinstance(about.get("hasGravity"), bool):
        raise ConfigError(f"{where}: 'hasGravity' is {about.get('hasGravity')!r}, expected true or false; correct it")
    notes = [f"read from a published QuaSI model ({_shown(given)}); its coefficients carry no standard errors"]
    if poles is None:
        poles = DEFAULT_POLES
        notes.append(
            f"the file does not state the number of motor poles; {poles} are assumed, and a wrong number scales every "
            "rotor speed"
        )
    drone = _section(document, "droneParams", where)
    airframe = _airframe(drone, name, poles, where)
    reader = _Reader(where, poles / 200.0, _written_out(airframe))
    axes = _section(document, "model", where)
    parts = {axis: reader.axis(_section(axes, axis, where), axis) for axis in AXES if axis in axes}
    if not parts:
        raise ConfigError(f"{where}: 'model' holds none of {', '.join(AXES)}; give a whole model")
    extra = sorted(reader.columns - set(INPUTS))
    if extra:
        notes.append(f"predictions need the further columns {', '.join(extra)}")
    simple = _simple_model(drone, poles / 200.0, where)
    if simple.get("kappaMz", {}).get("value", 0.0) > 0:
        notes.append(
            "the yaw moment increases with the speed of clockwise rotors, although rotor drag turns the body the other "
            "way: seen from above, the rotors probably turn against their stated direction"
        )
    hover = _number(drone, "wHover (rad/s)", f"{where}, 'droneParams'")
    shared = {
        "gravity": "withGravity" if about["hasGravity"] else "noGravity",
        "hover speed": {"value": None if hover is None else hover * 200.0 / poles, "unit": "rad/s"},
        "simple model": simple,
        "actuators": _actuators(drone, where),
        "training flights": [],
        "notes": notes,
    }
    meta = {
        "id": name,
        "airframe": airframe,
        "logged to rad/s": erpm100_to_rad_s(poles),
        "provenance": {"published model": _shown(given), "fingerprint": fingerprint(document)},
    }
    return Model(assemble_model(parts, shared, meta), where)


class _Reader:
    def __init__(self, where: str, factor: float, written_out: Mapping[str, Tree]) -> None:
        self._where = where
        self._factor = factor
        self._written_out = written_out
        self.columns: set[str] = set()

    def axis(self, part: Mapping[str, Any], axis: str) -> dict[str, Any]:
        where = f"{self._where}, {axis}"
        regressors, coefficients = part.get("regressors"), part.get("coefficients")
        if not isinstance(regressors, list) or not isinstance(coefficients, list) or not regressors:
            raise ConfigError(
                f"{where}: expected lists 'regressors' and 'coefficients'; give the model's own JSON file"
            )
        if len(regressors) != len(coefficients):
            raise ConfigError(
                f"{where}: {len(regressors)} regressors but {len(coefficients)} coefficients; the file is damaged"
            )
        if part.get("offset", 0) != 0:
            raise ConfigError(f"{where}: 'offset' is {part['offset']!r}, but only 0 is understood; add it to the bias")
        terms = []
        for regressor, coefficient in zip(regressors, coefficients):
            if not is_number(coefficient):
                raise ConfigError(
                    f"{where}: the coefficient of {_shown(regressor)} is {_shown(coefficient)}, expected a number; "
                    "the file is damaged"
                )
            terms.append(self._term(regressor, float(coefficient), axis, where))
        return {
            "unit": "N" if axis[0] == "F" else "N m", "terms": terms, "covariance": [], "sigma2": 0.0, "R2": 0.0,
            "RMSE": 0.0, "n": 0, "effective rows": 0.0, "confidence level": 0.95, "notes": [],
        }  # fmt: skip

    def _term(self, regressor: Any, coefficient: float, axis: str, where: str) -> dict[str, Any]:
        if not isinstance(regressor, str) or len(regressor) > _LONGEST_REGRESSOR:
            raise ConfigError(f"{where}: the regressor {_shown(regressor)} is no expression; give the model's own file")
        if regressor == "bias":
            tree: Tree = ("number", 1.0)
        else:
            try:
                tree = parse(regressor)
            except ExpressionError as error:
                raise ExpressionError(f"{where}: {' '.join(str(error).split())}") from None
        for name in names(tree):
            if plain_name(name) not in _PUBLISHED_NAMES and name not in _PUBLISHED_NAMES:
                raise ExpressionError(
                    f"{where}, regressor {_shown(regressor)}: unknown variable '{name}'"
                    f"{nearest(name, _PUBLISHED_NAMES)}; it has no counterpart here"
                )
        tree = self._replaced(tree, where)
        degree = _degree(tree)
        if degree is None:
            tree = self._scaled(tree, where)
        else:
            coefficient *= self._factor**degree
        self.columns |= set().union(*(base_columns(n) for n in names(tree)), set())
        return {
            "name": regressor, "expression": text(tree), "coefficient": coefficient, "std": 0.0, "t": None,
            "unit": derive_unit(tree, axis), "fixed": True, "given": True,
        }  # fmt: skip

    def _replaced(self, tree: Tree, where: str) -> Tree:
        """Without F_den and M_den in any form, and with U_r and u_r written out where the layout asks for it."""

        def replace(name: str) -> Tree:
            if plain_name(name) in _ONE:
                return ("number", _of_one(name))
            function, inner = split_function(name)
            if plain_name(name) not in self._written_out:
                return ("name", name)
            if function is None:
                return self._written_out[name]
            if function == "abs" and inner in self._written_out:
                return ("power", ("power", self._written_out[inner], ("number", 2.0)), ("number", 0.5))
            raise ExpressionError(f"{where}: '{name}' cannot be written for this rotor layout; leave the term out")

        return _substitute(tree, replace)

    def _scaled(self, tree: Tree, where: str) -> Tree:
        def scale(name: str) -> Tree:
            function, inner = split_function(name)
            degree = _degree_of_name(name)
            if degree is None:
                raise ExpressionError(f"{where}: '{name}' depends on the unit of the rotor speeds; leave the term out")
            if degree == 0:
                return ("name", name)
            return ("product", ((1, ("number", self._factor**degree)), (1, ("name", name))))

        return _substitute(tree, scale)


def _of_one(name: str) -> float:
    """The number that F_den, |F_den|, sin[F_den] and so on stand for where the scale is 1."""
    function, inner = split_function(name)
    return 1.0 if function is None else _PUBLISHED_FUNCTIONS[function](_of_one(inner))


def _substitute(tree: Tree, replace: Any) -> Tree:
    kind = tree[0]
    if kind == "number":
        return tree
    if kind == "name":
        return replace(tree[1])
    if kind in ("sum", "product"):
        return (kind, tuple((sign, _substitute(part, replace)) for sign, part in tree[1]))
    return (kind, *(_substitute(part, replace) for part in tree[1:]))


def _degree_of_name(name: str) -> int | None:
    function, inner = split_function(name)
    if function is None:
        return _DEGREE.get(plain_name(name), 2 if name.startswith("w2_") else 0)
    degree = _degree_of_name(inner)
    return degree if function == "abs" or degree == 0 else None


def _degree(tree: Tree) -> float | None:
    """Degree in the rotor speeds, None where a scale of theirs does not come out as a factor."""
    kind = tree[0]
    if kind == "number":
        return 0.0
    if kind == "name":
        return _degree_of_name(tree[1])
    if kind == "negative":
        return _degree(tree[1])
    if kind == "power":
        base = _degree(tree[1])
        exponent = tree[2]
        sign = -1.0 if exponent[0] == "negative" else 1.0
        exponent = exponent[1] if exponent[0] == "negative" else exponent
        if base is not None and exponent[0] == "number":
            return base * sign * exponent[1]
        return 0.0 if base == 0.0 and _degree(exponent) == 0.0 else None
    degrees = [(sign, _degree(part)) for sign, part in tree[1]]
    if any(d is None for _, d in degrees):
        return None
    if kind == "product":
        return sum(sign * d for sign, d in degrees)
    return degrees[0][1] if len({d for _, d in degrees}) == 1 else None


def _written_out(airframe: Airframe) -> dict[str, Tree]:
    fixed = [s * airframe.spin[0] for s in (1, -1, -1, 1)]
    if list(airframe.spin) == fixed:
        return {}
    sign = "" if airframe.spin[0] > 0 else "-"
    return {name: parse(f"{sign}({written})") for name, written in _WRITTEN_OUT.items()}


def _airframe(drone: Mapping[str, Any], name: str, poles: int, where: str) -> Airframe:
    signs = drone.get("r_sign", {"CW": 1, "CCW": -1})
    direction = drone.get("rotor 1 direction")
    if not isinstance(signs, Mapping) or not isinstance(direction, str) or signs.get(direction) not in (1, -1):
        raise ConfigError(f"{where}, 'droneParams': 'rotor 1 direction' is {_shown(direction)}, expected 'CW' or 'CCW'")
    config = {
        "rotor config": drone.get("rotor configuration"),
        "rotor1 rotation direction": "CW" if signs[direction] == 1 else "CCW",
        "b": drone.get("b"), "rotor radius": drone.get("R"), "moment of inertia": drone.get("Iv"),
        "mass": drone.get("m"), "idle RPM": drone.get("idle RPM"), "max RPM": drone.get("max RPM"),
        "motor poles": poles,
    }  # fmt: skip
    frame = read_airframe(config, f"{where}, 'droneParams'")
    return Airframe(**{**frame.__dict__, "name": name})


def _simple_model(drone: Mapping[str, Any], factor: float, where: str) -> dict[str, Any]:
    found = drone.get("simpleModel") or {}
    result = {}
    for axis in ("Fz", "Mx", "My", "Mz"):
        for ending, power, suffix in (("_w_2", 2, ""), ("_w", 1, "_w")):
            value = _number(found, f"kappa{axis}{ending}", f"{where}, 'simpleModel'")
            if value is not None:
                unit = ("N" if axis == "Fz" else "N m") + (" s2/rad2" if power == 2 else " s/rad")
                result[f"kappa{axis}{suffix}"] = {"value": value * factor**power, "std": None, "unit": unit}
    return result


def _actuators(drone: Mapping[str, Any], where: str) -> dict[str, Any] | None:
    taus = drone.get("taus")
    if not isinstance(taus, Mapping) or not all(w in taus for w in _ROTORS):
        return None
    values = [_number(taus, w, f"{where}, 'taus'") for w in _ROTORS]
    if not all(v is not None and v > 0 for v in values):
        raise ConfigError(f"{where}, 'taus': expected four positive times in s, found {values}")
    return {"time constants": {"value": values, "unit": "s"}}


def _section(document: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    value = document[key]
    if not isinstance(value, Mapping):
        raise ConfigError(f"{where}: '{key}' is {_shown(value)}, expected a section {{ ... }}; the file is damaged")
    return value


def _number(section: Any, key: str, where: str) -> float | None:
    value = section.get(key) if isinstance(section, Mapping) else None
    if value is None:
        return None
    if not is_number(value):
        raise ConfigError(f"{where}: '{key}' is {_shown(value)}, expected a number; the file is damaged")
    return float(value)


def _shown(value: Any) -> str:
    shown = repr(value)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
