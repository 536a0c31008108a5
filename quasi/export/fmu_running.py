"""FMUs at work: their binaries against the model, and against equations of motion written plainly with numpy.

The binary is called directly through its FMI functions, so that an export can be compared wherever it can be compiled.
"""

import ctypes
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import numpy as np

from quasi import attitude
from quasi.attitude import GRAVITY
from quasi.errors import DataError
from quasi.export.agreement import Check, States, compare, states_of, wrench_of
from quasi.export.fmu_source import LONGEST_FMU_STEP, STATE_NAMES, Fmu
from quasi.model.commands import extended_map
from quasi.model.extensions import actuators_of, wind_of
from quasi.model.model import AXES, Model
from quasi.terms.kernel import INPUTS
from quasi.terms.rotor_map import steady_speeds

MODEL_EXCHANGE, CO_SIMULATION = 0, 1
_STEPS = 50
_FAR = 100.0  # m/s, rad/s: beyond these the run stops, the model is no longer valid
_REFERENCES = ctypes.POINTER(ctypes.c_uint)
_REALS = ctypes.POINTER(ctypes.c_double)


class Instance:
    """A running FMU after initialisation.

    library  its binary; kind  MODEL_EXCHANGE or CO_SIMULATION; start  values in place of its start values
    Use it in a `with` block; raises DataError when a function fails.
    """

    def __init__(self, fmu: Fmu, library: str | Path, kind: int, start: dict[str, float] | None = None) -> None:
        self._fmu = fmu
        self._at = {variable.name: variable.at for variable in fmu.variables}
        self._library = ctypes.CDLL(str(library))
        self._library.fmi2Instantiate.restype = ctypes.c_void_p
        made = self._library.fmi2Instantiate(b"check", kind, fmu.guid.encode(), b"", None, 0, 0)
        self._instance = ctypes.c_void_p(made)
        if not made:
            raise DataError(f"the FMU {fmu.identifier} cannot be instantiated; please report this")
        self._call("fmi2SetupExperiment", 0, ctypes.c_double(0.0), ctypes.c_double(0.0), 0, ctypes.c_double(0.0))
        self._call("fmi2EnterInitializationMode")
        self.set(list(start or {}), list((start or {}).values()))
        self._call("fmi2ExitInitializationMode")

    def __enter__(self) -> "Instance":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._library.fmi2FreeInstance(self._instance)

    def set(self, names: Sequence[str], values: Sequence[float] | np.ndarray) -> None:
        """Set variables."""
        self._call("fmi2SetReal", *self._reals(names, values))

    def get(self, names: Sequence[str]) -> np.ndarray:
        """Values of variables."""
        values = np.zeros(len(names))
        self._call("fmi2GetReal", *self._reals(names, values))
        return values

    def step(self, time: float, step: float) -> None:
        """Co-simulation: one communication step."""
        self._call("fmi2DoStep", ctypes.c_double(time), ctypes.c_double(step), 1)

    def slope(self, time: float, x: np.ndarray) -> np.ndarray:
        """Model exchange: derivatives of the states x."""
        found, x = np.zeros(len(x)), np.ascontiguousarray(x, float)
        size = ctypes.c_size_t(len(x))
        self._call("fmi2SetTime", ctypes.c_double(time))
        self._call("fmi2SetContinuousStates", x.ctypes.data_as(_REALS), size)
        self._call("fmi2GetDerivatives", found.ctypes.data_as(_REALS), size)
        return found

    def _reals(self, names: Sequence[str], values: Sequence[float] | np.ndarray) -> tuple:
        at = np.array([self._at[name] for name in names], np.uint32)
        values = np.ascontiguousarray(values, float)
        # the arrays live on through the pointers made of them
        return at.ctypes.data_as(_REFERENCES), ctypes.c_size_t(len(at)), values.ctypes.data_as(_REALS)

    def _call(self, function: str, *arguments: object) -> None:
        if getattr(self._library, function)(self._instance, *arguments):
            raise DataError(f"{function} of the FMU {self._fmu.identifier} fails; please report this")


def check_forces(model: Model, fmu: Fmu, library: str | Path) -> list[Check]:
    """Compare a force-and-moment FMU with its model."""
    at = states_of(model, 2000)
    names = [v.name for v in fmu.variables if v.causality == "input"]
    columns = [i for i, name in enumerate(model.inputs) if name in names]
    axes = [axis for axis in AXES if axis in model.axes]
    table, found = at.table[:, columns], np.empty((len(at.state), len(axes)))
    with Instance(fmu, library, CO_SIMULATION) as instance:
        for k, row in enumerate(table):
            instance.set(names, row)
            found[k] = instance.get(axes)
    reference = wrench_of(model, at)[:, [AXES.index(axis) for axis in axes]]
    return [compare("FMU, forces and moments", found, reference, axes)]


def check_vehicle(model: Model, fmu: Fmu, library: str | Path) -> list[Check]:
    """Compare a vehicle's derivatives and its flight with numpy's."""
    at = states_of(model, 1000)
    x, commands, wind = _states(at)
    found = np.empty((len(x), 17))
    inputs = [f"w{i}_CMD" for i in range(1, 5)] + ["wind_north", "wind_east", "wind_down", *at.extra]
    table = np.column_stack([commands, wind, *at.extra.values()])
    with Instance(fmu, library, MODEL_EXCHANGE, _plain_rotors(fmu)) as instance:
        for k, row in enumerate(table):
            instance.set(inputs, row)
            found[k] = instance.slope(0.0, x[k])
    reference = slopes(model, x, limited(model, commands), wind, at.extra)
    names = [f"der({name})" for name in STATE_NAMES]
    checks = [compare("FMU, derivatives of the vehicle", found, reference, names)]
    if any(v.name == "takes_commands" for v in fmu.variables):
        checks.append(check_commands(model, fmu, library))
    flown, expected = _fly(model, fmu, library)
    return [*checks, compare(f"FMU, flight of {len(flown) * LONGEST_FMU_STEP:g} s", flown, expected, STATE_NAMES)]


def check_commands(model: Model, fmu: Fmu, library: str | Path) -> Check:
    """Compare the derivatives of a vehicle that commands and battery voltage drive with the model's map and numpy."""
    drive, at = extended_map(model.document), states_of(model, 200)
    x, _, wind = _states(at)
    random = np.random.default_rng(7)
    commands = drive["operating command"] * random.uniform(0.5, 1.5, (len(x), 4))
    volts = fmu_start(fmu, "battery_voltage") * random.uniform(0.9, 1.05, len(x))
    extra = at.extra | ({"battery_voltage": volts} if "battery_voltage" in at.extra else {})
    inputs = [f"command{i}" for i in range(1, 5)] + ["wind_north", "wind_east", "wind_down", "battery_voltage"]
    table, found = np.column_stack([commands, wind, volts]), np.empty((len(x), 17))
    with Instance(fmu, library, MODEL_EXCHANGE, _plain_rotors(fmu) | {"takes_commands": 1.0}) as instance:
        for k, row in enumerate(table):
            instance.set(inputs, row)
            found[k] = instance.slope(0.0, x[k])
    reference = slopes(model, x, limited(model, steady_speeds(drive, commands, volts)), wind, extra)
    return compare("FMU, derivatives by commands and volts", found, reference, [f"der({n})" for n in STATE_NAMES])


def _states(at: States) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(5)
    quaternion = random.normal(size=(len(at.state), 4))
    quaternion /= np.linalg.norm(quaternion, axis=1)[:, None]
    x = np.hstack([quaternion, at.state[:, 3:], at.speeds])
    return x, at.speeds * random.uniform(0.8, 1.2, at.speeds.shape), random.normal(0.0, 3.0, (len(x), 3))


def _fly(model: Model, fmu: Fmu, library: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """States (N, 17) of a flight with given commands without delay: co-simulation's, and numpy's."""
    random = np.random.default_rng(6)
    speed = fmu_start(fmu, "w1_CMD")
    commands = speed * (1.0 + np.repeat(random.normal(0.0, 0.02, (_STEPS // 10, 4)), 10, axis=0))
    wind = wind_of(model) + np.array([1.5, -0.7, 0.3])
    extra = {name: np.array([fmu_start(fmu, name)]) for name in model.inputs[len(INPUTS) :]}
    flown, expected = [], []
    x = np.array([[1.0, *[0.0] * 12, *[speed] * 4]])
    inputs = ["w1_CMD", "w2_CMD", "w3_CMD", "w4_CMD", "wind_north", "wind_east", "wind_down"]
    with Instance(fmu, library, CO_SIMULATION, _plain_rotors(fmu)) as instance:
        for k, command in enumerate(commands):
            x = runge_kutta(model, x, limited(model, command[None]), wind[None], extra, LONGEST_FMU_STEP)
            if not np.abs(x[0, 4:10]).max() < _FAR:
                break
            instance.set(inputs, [*command, *wind])
            instance.step(k * LONGEST_FMU_STEP, LONGEST_FMU_STEP)
            expected.append(x[0])
            flown.append(instance.get(STATE_NAMES))
    return np.reshape(flown, (-1, 17)), np.reshape(expected, (-1, 17))


def _plain_rotors(fmu: Fmu) -> dict[str, float]:
    """Start values that leave delay and battery out of the comparison."""
    return {v.name: 0.0 for v in fmu.variables if v.name in ("delay", "voltage_exponent")}


def fmu_start(fmu: Fmu, name: str) -> float:
    """Start value of a variable."""
    return next(v.start for v in fmu.variables if v.name == name)


def limited(model: Model, commands: np.ndarray) -> np.ndarray:
    """Rotor speeds that commands (N, 4), rad/s, let the rotors settle at."""
    rotors = actuators_of(model)
    return np.clip(commands, rotors.lowest, rotors.highest)


def slopes(
    model: Model, x: np.ndarray, target: np.ndarray, wind: np.ndarray, extra: dict[str, np.ndarray] | None = None
) -> np.ndarray:
    """Derivatives (N, 17) of a vehicle's states, written plainly.

    x (N, 17) as STATE_NAMES; target (N, 4) rad/s; wind (N, 3) m/s, earth axes; extra {name: (N,)}
    """
    q, v, omega, speeds = x[:, :4], x[:, 4:7], x[:, 7:10], x[:, 13:]
    rotors, inertia, mass = actuators_of(model), np.asarray(model.airframe.inertia, float), model.airframe.mass
    spin_up = np.where(target > speeds, rotors.up, rotors.down)
    acceleration = (target - speeds) / spin_up
    air = v - attitude.rotate_inverse(q, wind)
    angles = np.column_stack([np.broadcast_to(a, len(x)) for a in np.moveaxis(attitude.to_euler(q), -1, 0)])
    forces, moments = model.predict(np.hstack([angles, air, omega, x[:, 10:13]]), speeds, acceleration, extra)
    linear = forces / mass - np.cross(omega, v)
    if model.with_gravity:
        linear = linear + attitude.rotate_inverse(q, np.array([0.0, 0.0, GRAVITY]))
    angular = (moments - np.cross(omega, omega @ inertia.T)) @ np.linalg.inv(inertia).T
    turning = 0.5 * attitude.multiply(q, np.hstack([np.zeros((len(x), 1)), omega]))
    return np.hstack([turning, linear, angular, attitude.rotate(q, v), acceleration])


def runge_kutta(
    model: Model, x: np.ndarray, target: np.ndarray, wind: np.ndarray, extra: dict[str, np.ndarray], dt: float
) -> np.ndarray:
    """States (N, 17) dt later, by one classical Runge-Kutta step; the quaternion is kept at unit length."""
    a = slopes(model, x, target, wind, extra)
    b = slopes(model, x + 0.5 * dt * a, target, wind, extra)
    c = slopes(model, x + 0.5 * dt * b, target, wind, extra)
    d = slopes(model, x + dt * c, target, wind, extra)
    x = x + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return np.hstack([x[:, :4] / np.linalg.norm(x[:, :4], axis=1)[:, None], x[:, 4:]])
