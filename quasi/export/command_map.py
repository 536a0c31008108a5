"""The map from commands to rotor speeds in other languages: `rotor_map.steady_speeds`, from the same constants.

Delay and lag are not in it: exports carry them with their rotors. The speeds are those of warm motors; the Python
module's `predict_from_commands` adds the surplus of cold ones. An export of a model without a map has none of this.
"""

from collections.abc import Mapping
from typing import Any

from quasi.model.commands import extended_map
from quasi.model.model import Model
from quasi.terms.rotor_map import FORMS, WARM_UP_NAMES

# f of rotor_map.shape by form: x command over the operating command, v = (volts / reference)^n, b and d parameters.
# MAX, SQRT and N(number) are replaced by what a language calls them
_SHAPES = {
    "speed": "MAX(v*x, N(0))",
    "linear": "v*MAX(N(1) + b*(x - N(1)), N(0))",
    "square root": "v*SQRT(MAX(N(1) + b*(x - N(1)), N(0)))",
    "polynomial": "v*MAX(N(1) + b*(x - N(1)) + d*(x - N(1))*(x - N(1)), N(0))",
    "quadratic": "MAX(N(1) + b*(v*x - N(1)) + d*(v*x - N(1))*(v*x - N(1)), N(0))",
    "thrust map": "SQRT((N(1) - SQRT(MAX(N(1) - b*v*x, N(0))))/(N(1) - SQRT(N(1) - b)))",
}


def constants_of_map(drive: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers of a map: speeds (4,) rad/s, operating command, exponent and reference V (0 and 1 for none), b, d."""
    parameters = [float(drive["parameters"][n]["value"]) for n in FORMS[drive["form"]].names]
    exponent = drive["voltage exponent"]
    return {
        "speeds": [float(s) for s in drive["speeds"]["value"]],
        "operating": float(drive["operating command"]),
        "exponent": float(exponent["value"]) if exponent else 0.0,
        "reference": float(drive["reference voltage"]) if exponent else 1.0,
        "b": parameters[0] if parameters else 0.0,
        "d": parameters[1] if len(parameters) > 1 else 0.0,
        "highest": 1.0 if drive["input"] == "share" else float("inf"),
        "warm-up": tuple(float(drive[n]["value"]) for n in WARM_UP_NAMES)
        if drive.get(WARM_UP_NAMES[0])
        else (0.0, 1.0),
    }


def _shape(drive: Mapping[str, Any], largest: str, root: str, number: str) -> str:
    text = _SHAPES[drive["form"]].replace("MAX(", f"{largest}(").replace("SQRT(", f"{root}(")
    return text.replace("N(0)", number.format("0")).replace("N(1)", number.format("1"))


def _input_words(drive: Mapping[str, Any]) -> str:
    return "shares of the motor output range" if drive["input"] == "share" else "rad/s"


def python_map(model: Model) -> str | None:
    """Functions steady_speeds, rotor_speeds and predict_from_commands of the Python module; None without a map."""
    drive = extended_map(model.document)
    if drive is None:
        return None
    c = constants_of_map(drive)
    drop, warming = c["warm-up"]
    lower, upper = ("-np.inf", "np.inf") if c["highest"] > 1.0 else ("0.0", "1.0")
    return f'''\
def steady_speeds(commands, volts={c["reference"]!r}):
    """Rotor speeds (N, 4), rad/s, for constant commands (N, 4), {_input_words(drive)}; volts (N,) or one number."""
    x = np.clip(np.atleast_2d(np.asarray(commands, float)), 0.0, {"np.inf" if c["highest"] > 1.0 else "1.0"})
    x = x / {c["operating"]!r}
    v = np.maximum(np.reshape(np.asarray(volts, float), (-1, 1)) / {c["reference"]!r}, 0.0) ** {c["exponent"]!r}
    b, d = {c["b"]!r}, {c["d"]!r}
    return np.array({c["speeds"]!r}) * ({_shape(drive, "np.maximum", "np.sqrt", "{}.0")})


def _lagged(wanted, time_step, lag):
    keep, share = np.exp(-time_step / lag), time_step / lag
    last = 1.0 - (1.0 - keep) / share
    first = (1.0 - keep) / share - keep
    behind = np.empty_like(wanted)
    behind[0] = wanted[0]
    for i in range(1, len(wanted)):
        behind[i] = keep * behind[i - 1] + first * wanted[i - 1] + last * wanted[i]
    return behind


def rotor_speeds(commands, volts, time_step):
    """Speeds (N, 4), rad/s, and accelerations (N, 4), rad/s2, of rotors behind their commands in steps of s.

    Motors that begin at rest begin cold.
    """
    wanted = steady_speeds(commands, volts)
    heat = np.clip(np.atleast_2d(np.asarray(commands, float)), {lower}, {upper})
    wanted = wanted * (1.0 + {drop!r} * (1.0 - _lagged(heat / {c["operating"]!r}, time_step, {warming!r})))
    late = {float(drive["delay"]["value"])!r} / time_step
    whole = int(np.floor(late))
    part = late - whole
    at = np.arange(len(wanted)) - whole
    weights = (
        (-1, -part * (part - 1.0) * (part - 2.0) / 6.0), (0, (part + 1.0) * (part - 1.0) * (part - 2.0) / 2.0),
        (1, -(part + 1.0) * part * (part - 2.0) / 2.0), (2, (part + 1.0) * part * (part - 1.0) / 6.0),
    )
    wanted = sum(w * wanted[np.clip(at - k, 0, len(wanted) - 1)] for k, w in weights)
    lag = np.array({drive["time constant"]["value"]!r})
    speeds = _lagged(wanted, time_step, lag)
    return speeds, (wanted - speeds) / lag


def predict_from_commands(state, commands, volts, time_step, extra=None):
    """Forces (N, 3), N, and moments (N, 3), N m, from commands (N, 4) in even steps; rows as of `predict`."""
    speeds, accelerations = rotor_speeds(commands, volts, time_step)
    return predict(state, speeds, accelerations, extra)
'''


def c_map(model: Model, p: str) -> tuple[str, str] | None:
    """Declaration and definition of <model>_steady_speeds in C; None for a model without a map."""
    drive = extended_map(model.document)
    if drive is None:
        return None
    c = constants_of_map(drive)
    comment = (
        f"/*\n * Speeds, rad/s, at which the rotors settle for constant commands, {_input_words(drive)}, at a battery\n"
        " * voltage, V; what ..._rotors_step takes as commanded.\n */\n"
    )
    arguments = "const {0} commands[4], {0} volts, {0} speeds[4]"
    declared = f"{comment}void {p}_steady_speeds({arguments.format(f'{p}_real')});\n"
    speeds = ", ".join(f"N({s!r})" for s in c["speeds"])
    upper = "" if c["highest"] > 1.0 else "        x = x < N(1) ? x : N(1);\n"
    shaped = _shape(drive, "LARGER", "SQRT", "N({})")
    power = f"POW(LARGER(volts/N({c['reference']!r}), N(0)), N({c['exponent']!r}))" if c["exponent"] else "N(1)"
    defined = (
        f"#define LARGER(a, b) ((a) > (b) ? (a) : (b))\n\nvoid {p}_steady_speeds({arguments.format('real')})\n{{\n"
        f"    static const real operating[4] = {{{speeds}}};\n"
        f"    const real b = N({c['b']!r}), d = N({c['d']!r}), v = {power};\n    int i;\n"
        "    for (i = 0; i < 4; i++) {\n        real x = LARGER(commands[i], N(0));\n"
        f"{upper}        x = x/N({c['operating']!r});\n        speeds[i] = operating[i]*({shaped});\n    }}\n"
        "    (void)b;\n    (void)d;\n    (void)volts;\n}\n"
    )
    return declared, defined


def matlab_map(model: Model) -> str | None:
    """The function steadySpeeds.m of MATLAB; None for a model without a map."""
    drive = extended_map(model.document)
    if drive is None:
        return None
    c = constants_of_map(drive)
    shaped = _shape(drive, "max", "sqrt", "{}").replace("*", ".*").replace("/", "./")
    return (
        "function speeds = steadySpeeds(commands, volts)\n"
        f"% Rotor speeds (N x 4), rad/s, at which the rotors settle for commands (N x 4), {_input_words(drive)}.\n"
        "% volts (N x 1), V. Delay and lag are not in it.\n"
        f"x = min(max(commands, 0), {'inf' if c['highest'] > 1.0 else '1'}) / {c['operating']!r};\n"
        f"v = max(volts(:) / {c['reference']!r}, 0) .^ {c['exponent']!r};\n"
        f"b = {c['b']!r};\nd = {c['d']!r};\n"
        f"speeds = [{', '.join(map(repr, c['speeds']))}] .* ({shaped});\nend\n"
    )
