"""FMI 2.0 descriptions of a model: the force-and-moment model, and a whole vehicle that flies with it.

    fmu = forces_fmu(model)                    or vehicle_fmu(model)
    fmu.files                                  {"modelDescription.xml": text, "sources/...": text}

Each offers model exchange and co-simulation. Its C files stand in `fmu_files`; made here are modelDescription.xml, and
one C file that places the variables and takes in the others.
Source: Functional Mock-up Interface for Model Exchange and Co-Simulation, version 2.0, Modelica Association, 2014.
"""

import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from quasi.errors import ConfigError
from quasi.export.c_source import c_files
from quasi.export.command_map import constants_of_map
from quasi.export.contents import (
    check_exportable,
    check_vehicle,
    extras_of,
    head,
    name_in_source,
    voltage_of,
)
from quasi.export.naming import shown
from quasi.model.commands import extended_map
from quasi.model.extensions import actuators_of, wind_of
from quasi.model.hover import check_flyable, find_training_median
from quasi.model.model import AXES, Model
from quasi.tables import COLUMNS, read_text
from quasi.terms.kernel import INPUTS

DELAYED_COMMANDS = 4096  # commands that are remembered for a delay
NO_LIMIT = 1e9  # rad/s, where the airframe has no highest speed
LONGEST_FMU_STEP = 0.002  # s, of the integration within a communication step
STATE_NAMES = ("qw", "qx", "qy", "qz", "u", "v", "w", "p", "q", "r", "x", "y", "z", "w1", "w2", "w3", "w4")
_FMI_UNITS = {
    "m": {"m": 1}, "s": {"s": 1}, "rad": {"rad": 1}, "kg": {"kg": 1}, "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2}, "rad/s": {"rad": 1, "s": -1}, "rad/s2": {"rad": 1, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2}, "N m": {"kg": 1, "m": 2, "s": -2}, "kg m2": {"kg": 1, "m": 2}, "1/s": {"s": -1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
}  # fmt: skip


class Variable(NamedTuple):
    """One variable: where it stands among the values, name, causality, variability, unit, start, meaning.

    derivative_of  name of the state that it is the derivative of; None for others
    """

    at: int
    name: str
    causality: str
    variability: str
    unit: str
    start: float | None
    meaning: str
    derivative_of: str | None = None


class Fmu(NamedTuple):
    """An FMU: identifier, variables, all files but the binary, and the C files that a binary is made of."""

    identifier: str
    guid: str
    variables: tuple[Variable, ...]
    files: dict[str, str]
    units: tuple[str, ...]


def forces_fmu(model: Model) -> Fmu:
    """Forces and moments from states and rotor speeds: no states, every column that the model reads is an input."""
    check_exportable(model)
    extras = extras_of(model)
    variables = []
    for at, name in enumerate((*INPUTS, *extras)):
        if at >= 16 and at < 20 and not model.uses_rotor_accelerations:
            continue
        unit, frame = COLUMNS.get(name, ("1", ""))[:2]
        usual = model.hover_speed or 1.0 if 12 <= at < 16 else find_training_median(model, name) if at >= 20 else None
        start = float(usual or 0.0)
        meaning = f"velocity through the air, {frame}" if name in "uvw" else f"{name}, {frame}" if frame else name
        variables.append(Variable(at, name, "input", "continuous", unit, start, shown(meaning)))
    first = len(INPUTS) + len(extras)
    for m, axis in enumerate(AXES):
        if axis in model.axes:
            unit, what = ("N", "force") if m < 3 else ("N m", "moment about the centre of gravity")
            variables.append(Variable(first + m, axis, "output", "continuous", unit, None, f"{what}, body axes"))
    places = {
        "AT_STATE": 0, "AT_SPEEDS": 12, "AT_ACCELERATIONS": 16, "AT_EXTRA": 20, "AT_FORCES": first,
        "AT_MOMENTS": first + 3, "AT_X": 0, "AT_SLOPE": 0, "STATES": 0, "VALUES": first + 6,
        "INPUT_VALUES": first, "SETTABLE": first, "MEMORY_ROWS": 1,
    }  # fmt: skip
    return _fmu(model, "forces_and_moments", variables, places)


def vehicle_fmu(model: Model) -> Fmu:
    """A whole quadrotor: commanded rotor speeds and wind in, its motion out.

    Where the model carries a map from commands to rotor speeds, commands and battery voltage can drive it instead.
    Raises DataError for a model that lacks an axis or the mass, ConfigError for one that reads what a vehicle does not
    know, by name.
    """
    check_vehicle(model)
    check_flyable(model, "a vehicle")
    unknown = [name for name in extras_of(model) if name != "battery_voltage"]
    if unknown:
        raise ConfigError(
            f"model {model.id} has terms in '{shown(unknown[0])}', which a vehicle cannot supply; identify it without "
            "that variable, or use the force-and-moment model alone"
        )
    rotors, voltage, drive = actuators_of(model), voltage_of(model), extended_map(model.document)
    speed = float(model.hover_speed or 0.5 * (rotors.lowest + min(rotors.highest, 4000.0)))
    variables: list[Variable] = []
    places: dict[str, int] = {}

    def add(
        place: str, names: Sequence[str], kind: str, unit: str, starts: Sequence[float] | None, meaning: str
    ) -> None:
        places[place] = at = sum(sizes)
        sizes.append(len(names))
        causality, variability = kind.split()
        for k, name in enumerate(names):
            start = None if starts is None else float(starts[k])
            variables.append(Variable(at + k, name, causality, variability, unit, start, meaning))

    sizes: list[int] = []
    each = range(1, 5)
    put = "input continuous"
    add("AT_COMMANDS", [f"w{i}_CMD" for i in each], put, "rad/s", [speed] * 4, "commanded rotor speed, mechanical")
    add(
        "AT_WIND",
        ["wind_north", "wind_east", "wind_down"],
        put,
        "m/s",
        wind_of(model),
        "velocity of the air, earth axes",
    )
    if voltage:
        add("AT_VOLTAGE", ["battery_voltage"], put, "V", [voltage.start], "battery voltage")
    else:
        places |= {"AT_VOLTAGE": 0, "AT_EXPONENT": 0, "AT_REFERENCE_VOLTAGE": 0}  # nothing reads them
    if drive is not None:
        unit = "1" if drive["input"] == "share" else "rad/s"
        names, meaning = [f"command{i}" for i in each], "command, where takes_commands is 1"
        add("AT_SHARES", names, put, unit, [drive["operating command"]] * 4, meaning)
        if not voltage:
            volts = constants_of_map(drive)["reference"]
            add("AT_VOLTAGE", ["battery_voltage"], put, "V", [volts], "battery voltage, of the map of commands")
    else:
        places["AT_SHARES"] = 0  # nothing reads it
    given = "parameter fixed"
    inertia = np.asarray(model.airframe.inertia, float)
    add("AT_MASS", ["mass"], given, "kg", [model.airframe.mass], "mass")
    add("AT_INERTIA", [f"inertia_{n}" for n in ("xx", "yy", "zz", "xy", "xz", "yz")], given, "kg m2",
        inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], "entry of the inertia tensor, body axes")  # fmt: skip
    add("AT_UP", [f"time_constant_up_{i}" for i in each], given, "s", rotors.up, "of a rotor that speeds up")
    add("AT_DOWN", [f"time_constant_down_{i}" for i in each], given, "s", rotors.down, "of a rotor that slows down")
    add("AT_DELAY", ["delay"], given, "s", [rotors.delay], "before a command acts")
    highest = rotors.highest if math.isfinite(rotors.highest) else NO_LIMIT
    add("AT_LOWEST", ["lowest_speed"], given, "rad/s", [rotors.lowest], "least rotor speed that is taken")
    add("AT_HIGHEST", ["highest_speed"], given, "rad/s", [highest], "greatest rotor speed that is taken")
    if voltage:
        meaning = "rotor speeds grow with (battery_voltage / reference_voltage) ^ this"
        add("AT_EXPONENT", ["voltage_exponent"], given, "1", [voltage.exponent], meaning)
        add("AT_REFERENCE_VOLTAGE", ["reference_voltage"], given, "V", [voltage.reference], "where commands are true")
    if drive is not None:
        meaning = "1: command1 to command4 and battery_voltage drive the rotors by the model's map; 0: w1_CMD to w4_CMD"
        add("AT_TAKES", ["takes_commands"], given, "1", [0.0], meaning)
    else:
        places["AT_TAKES"] = 0
    add(
        "AT_LONGEST", ["longest_step"], given, "s", [LONGEST_FMU_STEP], "of the integration within a communication step"
    )
    start = [1.0, *[0.0] * 12, *[speed] * 4]
    add("AT_X", STATE_NAMES, "output state", "", start, "")
    add("AT_SLOPE", [f"der({name})" for name in STATE_NAMES], "local continuous", "", None, "")
    out = "output continuous"
    add("AT_ANGLES", ["roll", "pitch", "yaw"], out, "rad", None, "attitude: yaw first, then pitch, then roll")
    add("AT_LOADS", AXES, out, "N", None, "of the model, body axes")
    add("AT_FELT", ["ax", "ay", "az"], out, "m/s2", None, "specific force at the centre of gravity, body axes")
    variables = [_detailed(v) for v in variables]
    places |= {"STATES": 17, "VALUES": sum(sizes), "INPUT_VALUES": places["AT_MASS"], "SETTABLE": places["AT_SLOPE"],
               "MEMORY_ROWS": DELAYED_COMMANDS}  # fmt: skip
    return _fmu(model, "vehicle", variables, places)


_OF_STATE = [
    *[("1", "attitude, unit quaternion w x y z, body to earth")] * 4,
    *[("m/s", "velocity over ground, body axes")] * 3,
    *[("rad/s", "angular velocity, body axes")] * 3,
    *[("m", "position, earth axes: north, east, down")] * 3,
    *[("rad/s", "rotor speed, mechanical")] * 4,
]
_SLOPE_UNIT = {"1": "1/s", "m/s": "m/s2", "rad/s": "rad/s2", "m": "m/s"}


def _detailed(variable: Variable) -> Variable:
    """Units and meanings of states, their derivatives, and moments."""
    name = variable.name.removeprefix("der(").removesuffix(")")
    if variable.variability == "state":
        unit, meaning = _OF_STATE[STATE_NAMES.index(name)]
        return variable._replace(unit=unit, meaning=meaning, variability="continuous")
    if variable.causality == "local":
        unit, meaning = _OF_STATE[STATE_NAMES.index(name)]
        return variable._replace(unit=_SLOPE_UNIT[unit], meaning=f"derivative of {name}", derivative_of=name)
    return variable._replace(unit="N m") if variable.name in AXES[3:] else variable


def _fmu(model: Model, kind: str, variables: Sequence[Variable], places: dict[str, int]) -> Fmu:
    p = name_in_source(model)
    identifier = f"{p}_{kind}"
    folder = Path(__file__).with_name("fmu_files")
    files = {f"sources/{name}": text for name, text in c_files(model).items()}
    for name in ("interface.h", "instance.h", "fmu.c", f"{kind}.c"):
        files[f"sources/{name}"] = read_text(folder / name)
    starts = [0.0] * places["VALUES"]
    for variable in variables:
        if variable.start is not None:
            starts[variable.at] = variable.start
    made = [
        f"/* Model {shown(model.id)} as an FMU of FMI 2.0: the one file to compile with {p}.c. Made by quasi. */",
        "#include <math.h>\n#include <stdlib.h>\n#include <string.h>\n",
        f'#include "{p}.h"\n#include "interface.h"\n',
        f"#define MODEL(name) {p}_##name",
        f'#define BEHAVIOUR "{kind}.c"',
        f"#define GRAVITY_ADDED {int(model.with_gravity)}",
        f"#define BATTERY {int('voltage_exponent' in [v.name for v in variables])}",
        f"#define COMMAND_MAP {int('takes_commands' in [v.name for v in variables])}",
        "enum {\n" + "".join(f"    {name} = {at},\n" for name, at in places.items()).rstrip(",\n") + "\n};",
        "#define START_VALUES {" + ", ".join(repr(v) for v in starts) + "}",
    ]
    digest = hashlib.sha256("\n".join([*made, *(f"{n}\n{t}" for n, t in files.items())]).encode())
    for variable in variables:
        digest.update(repr(variable).encode())
    guid = f"{{{digest.hexdigest()[:32]}}}"
    made += [f'#define GUID "{guid}"\n', '#include "instance.h"\n', '#include "fmu.c"\n']
    files[f"sources/{identifier}.c"] = "\n".join(made)
    units = (f"{p}.c", f"{identifier}.c")
    files["modelDescription.xml"] = _description(model, identifier, guid, variables, units, places["STATES"])
    return Fmu(identifier, guid, tuple(variables), files, units)


def _description(
    model: Model, identifier: str, guid: str, variables: Sequence[Variable], units: Sequence[str], states: int
) -> str:
    order = {variable.name: number for number, variable in enumerate(variables, 1)}
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0", modelName=identifier, guid=guid, description=" ".join(line for line in head(model)[:1]),
        generationTool="quasi", variableNamingConvention="flat", numberOfEventIndicators="0",
    )  # fmt: skip
    shared = {"modelIdentifier": identifier, "canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true",
              "canNotUseMemoryManagementFunctions": "true"}  # fmt: skip
    kinds = {"ModelExchange": {}, "CoSimulation": {"canHandleVariableCommunicationStepSize": "true"}}
    for kind, more in kinds.items():
        element = ElementTree.SubElement(root, kind, {**shared, **more})
        files = ElementTree.SubElement(element, "SourceFiles")
        for name in units:
            ElementTree.SubElement(files, "File", name=name)
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in sorted({v.unit for v in variables} & set(_FMI_UNITS)):
        element = ElementTree.SubElement(definitions, "Unit", name=unit)
        ElementTree.SubElement(element, "BaseUnit", {base: str(n) for base, n in _FMI_UNITS[unit].items()})
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="1", stepSize=repr(LONGEST_FMU_STEP))
    listed = ElementTree.SubElement(root, "ModelVariables")
    for v in variables:
        about = {"name": v.name, "valueReference": str(v.at), "description": v.meaning, "causality": v.causality,
                 "variability": v.variability}  # fmt: skip
        if v.name in STATE_NAMES and states:
            about["initial"] = "exact"
        real = {"unit": v.unit} if v.unit in _FMI_UNITS else {}
        if v.start is not None:
            real["start"] = repr(v.start)
        if v.derivative_of:
            real["derivative"] = str(order[v.derivative_of])
        ElementTree.SubElement(ElementTree.SubElement(listed, "ScalarVariable", about), "Real", real)
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = [order[v.name] for v in variables if v.causality == "output"]
    derivatives = [order[v.name] for v in variables if v.derivative_of]
    computed = [order[v.name] for v in variables if v.causality == "output" and v.start is None] + derivatives
    for name, members in (("Outputs", outputs), ("Derivatives", derivatives), ("InitialUnknowns", sorted(computed))):
        if members:
            element = ElementTree.SubElement(structure, name)
            for index in members:
                ElementTree.SubElement(element, "Unknown", index=str(index))
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
