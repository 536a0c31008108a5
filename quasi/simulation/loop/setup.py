"""Set up a closed loop from a model and a configuration.

    setup = make_setup({"model": {"model ID": "example"}, "references": {"do circle track": True}}, model)
    result = simulate(setup)

The configuration is the manual's droneSimConfig.json with additional keys, see config/schemas/simulation.schema.json.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from quasi import attitude
from quasi.airframe import Airframe
from quasi.attitude import GRAVITY
from quasi.errors import ConfigError, DataError
from quasi.model.extensions import actuators_of, read_rotor_constants, read_speed_limits, wind_of
from quasi.model.hover import check_flyable, find_hover_speed, find_training_median
from quasi.model.model import Model
from quasi.project import configuration
from quasi.simulation.control.controllers import make_controller
from quasi.simulation.control.references import make_reference
from quasi.simulation.loop.closed_loop import ActuatorLimits, Battery, LoopParameters, LoopState, make_loop_state
from quasi.simulation.loop.setup_tables import check_wind_table, read_table
from quasi.simulation.loop.stability import check_step
from quasi.simulation.vehicle.dynamics import (
    INTEGRATORS,
    RK4,
    append_extra_states,
    compute_loads,
    make_body_constants,
    make_scratch,
)
from quasi.simulation.vehicle.layout import (
    ADDED_GRAVITY,
    EXTRA_STATES,
    LOADS_OFFSET,
    MASS,
    POSITION,
    ROOT_EFFECTIVENESS,
    ROTOR_SPEEDS,
    SPEED_CAP,
    STATE_SIZE,
    STEP_INPUTS_SIZE,
    TARGET_SPEED,
)
from quasi.simulation.vehicle.payload_and_inflow import write_payload_and_inflow
from quasi.simulation.vehicle.sensors_and_wind import Sensors
from quasi.simulation.vehicle.undefined_loads import describe_undefined_loads
from quasi.simulation.vehicle.variants import (
    apply_extensions,
    drop_quasi_steady_terms,
    make_simple_model,
    read_payload_and_inflow,
)

STATE_NAMES = ("qw", "qx", "qy", "qz", "u", "v", "w", "p", "q", "r", "x", "y", "z", "w1", "w2", "w3", "w4")
# limits of plausible states, far beyond any quadrotor: quaternion, m/s, rad/s, m, rad/s of a rotor
_STATE_LIMITS = np.array([2.0] * 4 + [300.0] * 3 + [300.0] * 3 + [1e5] * 3 + [2e4] * 4)
_MANUAL_RATE_LIMIT = 5e4  # logged units (eRPM/100) per second: the rate limit of the manual's rotorDynamicsV1
MAX_LOG_ROWS = 5_000_000  # rows, of some 700 bytes each


@dataclass(frozen=True)
class Setup:
    """A closed loop with its initial state and duration.

    model        the simulated model, with extensions or simplified
    loop_parameters  parameters of the compiled loop; memory: size of the controller's memory
    start        (17 + own,) initial state, payload and inflow trimmed
    seeds        of noise and of gusts
    steps        of dt; every: number of them between two logged rows
    settings     the checked configuration; notes: assumptions
    """

    name: str
    model: Model
    loop_parameters: LoopParameters
    memory: int
    start: np.ndarray
    seeds: tuple[int, int]
    steps: int
    every: int
    settings: dict[str, Any]
    notes: tuple[str, ...]

    @property
    def airframe(self) -> Airframe:
        """Geometry and mass properties of the model."""
        return self.model.airframe

    @property
    def dt(self) -> float:
        """s, between two commands."""
        return self.loop_parameters.dt

    @property
    def extra_states(self) -> int:
        """Number of states beyond the seventeen."""
        return int(self.loop_parameters.body[EXTRA_STATES])

    def make_first_step_inputs(self) -> np.ndarray:
        """Make the first step inputs: rotors in equilibrium at their speeds, in still air."""
        step_inputs = make_step_inputs(int(self.loop_parameters.kernel.code[6]), 0.0)
        step_inputs[TARGET_SPEED : TARGET_SPEED + 4] = self.start[ROTOR_SPEEDS:STATE_SIZE]
        if self.loop_parameters.battery.place >= 0:
            step_inputs[STEP_INPUTS_SIZE + self.loop_parameters.battery.place] = self.loop_parameters.battery.start
        return step_inputs

    def make_loop_state(self) -> LoopState:
        """Make the initial state of the loop."""
        return make_loop_state(self.loop_parameters, self.start, self.memory, *map(np.uint64, self.seeds))


def make_setup(
    settings: Mapping[str, Any],
    model: Model,
    wind: pd.DataFrame | Mapping[str, np.ndarray] | None = None,
    reference: pd.DataFrame | Mapping[str, np.ndarray] | None = None,
    name: str = "simulation",
    directory: str | Path = ".",
) -> Setup:
    """Set up a closed loop.

    settings   the configuration, checked here; missing keys take their defaults
    model      the model that the configuration names
    wind       t (s), wind_north, wind_east, wind_down (m/s); None reads the table that "wind" / "file" names
    reference  see `references.make_reference`; None reads the table that "references" / "file" names
    directory  base folder of relative "file" paths
    Raises ConfigError naming the key, DataError for a model that cannot fly, ReadError for an unreadable table.
    """
    settings, _ = configuration.check(settings, "simulation", name)
    notes: list[str] = []
    wind = read_table(settings, "wind", directory, name) if wind is None else wind
    reference = read_table(settings, "references", directory, name) if reference is None else reference
    asked = settings["model"]
    model = apply_extensions(model) if asked["use identified model"] else make_simple_model(model)
    check_flyable(model, "a simulation")
    airframe = model.airframe
    dt, substeps = float(settings["simulation"]["time step"]), int(settings["simulation"]["substeps"])
    steps = round(settings["simulation"]["duration"] / dt)
    if steps < 1:
        raise ConfigError(
            f"{name}: 'duration' {settings['simulation']['duration']:g} s is shorter than the 'time step' {dt:g} s"
        )
    if steps // settings["simulation"]["log every"] > MAX_LOG_ROWS:
        raise ConfigError(
            f"{name}: {steps:,} steps exceed the {MAX_LOG_ROWS:,} rows that fit in memory; use a longer 'time step' or "
            "'log every', or a shorter 'duration'"
        )
    parts = read_payload_and_inflow(model)
    flown = drop_quasi_steady_terms(model)
    drive, up, down, rate = _make_actuator(settings["actuator"], model, notes, name)
    hover = find_hover_speed(model, drive.high if math.isfinite(drive.high) else None)
    if not drive.low <= hover <= drive.high:
        raise ConfigError(
            f"{name}: hover takes rotor speeds of {hover:.0f} rad/s, but the actuator allows {drive.low:.0f} to "
            f"{drive.high:.0f}; correct 'lowest speed' and 'highest speed', or the airframe's 'idle RPM', 'max RPM' "
            "and 'motor poles'"
        )
    battery, clock = _make_battery(settings["battery"], flown, hover, notes, name)
    kernel = flown.kernel
    gravity = GRAVITY if model.with_gravity else 0.0
    body = make_body_constants(airframe.mass, airframe.inertia, kernel, gravity, up, down, rate)
    write_payload_and_inflow(parts, airframe.hubs, body)
    step_inputs = make_step_inputs(len(flown.inputs), hover)
    if battery.place >= 0:
        step_inputs[STEP_INPUTS_SIZE + battery.place] = battery.start
    place = np.array(settings["initial state conditions"]["position"], float)
    if battery.place >= 0 or parts.states or kernel.used[9:12].any():
        volts = f" at {battery.start:g} V" if battery.place >= 0 else ""
        hover = _find_hover_speed(kernel, body, step_inputs, hover, place, f"{name}: model {model.id}{volts}")
        battery = battery._replace(hover=hover)
        step_inputs[TARGET_SPEED : TARGET_SPEED + 4] = hover
    offset = np.zeros(6)
    if asked["correct for moment asymmetries"]:
        offset = compute_asymmetry(kernel, body, step_inputs, hover, place)
        body[LOADS_OFFSET : LOADS_OFFSET + 6] = offset
    start = _make_start(settings["initial state conditions"], hover)
    _check_start(start, flown, body, step_inputs, name)
    start = append_extra_states(start, step_inputs, kernel, body)
    if parts.load_mass:
        notes.append(f"a load of {parts.load_mass:.3g} kg swings {parts.load_length:.3g} m below the centre of gravity")
    method = settings["simulation"]["integrator"]
    if method not in INTEGRATORS and substeps > 1:
        raise ConfigError(f"{name}: '{method}' chooses its step size itself; remove 'substeps'")
    check_step(body, kernel, step_inputs, make_hover_state(hover, place), dt / substeps, method, notes, name)

    asked = settings["controller"]
    with _prefix_errors(name):
        kind, gains, memory = make_controller({**asked, "time step": dt}, model, list_actuators(up, drive), offset)
    wanted = dict(settings["references"])
    if not any(wanted.get(k) for k in ("do position track", "do circle track", "kind")):
        here, yaw = [float(c) for c in start[10:13]], float(attitude.to_euler(start[:4])[2])
        wanted = {"position": here, "yaw": yaw} | wanted | {"kind": "hover"}
    with _prefix_errors(name if reference is None else f"{name}, {wanted.get('file', 'table handed over')}"):
        aim, path, table = make_reference(wanted, reference)
    noise = settings["noise"]
    names = ("attitude", "velocity", "rates", "position", "rotor speeds", "specific force")
    sensors = Sensors(*(float(noise[n]) if noise["add"] else 0.0 for n in names))
    air = settings["wind"]
    steady = np.array(air["steady"], float) + wind_of(model)
    if np.any(wind_of(model)):
        notes.append("the wind of the model's extensions is added")
    loop_parameters = LoopParameters(
        kernel, body, drive, battery, _make_fault(settings["faults"], drive, steps * dt, notes, name), sensors,
        np.array([*steady, *air["gusts"], *[air["correlation time"]] * 3], float), check_wind_table(wind, air, name),
        kind, gains, aim, path, table, dt, substeps, INTEGRATORS.get(method, RK4), _STATE_LIMITS.copy(), clock,
    )  # fmt: skip
    seeds = (noise["seed"], noise["seed"] if air["seed"] is None else air["seed"])
    every = settings["simulation"]["log every"]
    return Setup(name, model, loop_parameters, memory, start, seeds, steps, every, settings, tuple(notes))


def list_actuators(lag: np.ndarray, drive: ActuatorLimits) -> dict[str, Any]:
    """List lag, delay and limits of the rotors as `controllers.make_controller` takes them. lag (4,) s"""
    highest = drive.high if math.isfinite(drive.high) else None
    return {"time constants": np.maximum(lag, 1e-4), "delay": drive.delay, "lowest": drive.low, "highest": highest}


@contextmanager
def _prefix_errors(where: str) -> Iterator[None]:
    """Prefix the errors raised in this context with their location."""
    try:
        yield
    except (ConfigError, DataError) as error:
        raise type(error)(f"{where}: {error}") from None


def make_step_inputs(inputs: int, speed: float) -> np.ndarray:
    """Make step inputs for still air and healthy rotors at a constant speed, rad/s; `inputs` of the model."""
    step_inputs = np.zeros(STEP_INPUTS_SIZE + inputs - 20)
    (
        step_inputs[TARGET_SPEED : TARGET_SPEED + 4],
        step_inputs[ROOT_EFFECTIVENESS : ROOT_EFFECTIVENESS + 4],
        step_inputs[SPEED_CAP : SPEED_CAP + 4],
    ) = speed, 1.0, np.inf
    return step_inputs


def make_hover_state(speed: float, place: np.ndarray) -> np.ndarray:
    """Make the state (17,) of a level vehicle at rest at a position, m, with all rotors at one speed, rad/s."""
    x = np.zeros(STATE_SIZE)
    x[0], x[POSITION : POSITION + 3], x[ROTOR_SPEEDS:] = 1.0, place, speed
    return x


def _find_hover_speed(
    kernel: Any, body: np.ndarray, step_inputs: np.ndarray, guess: float, place: np.ndarray, what: str
) -> float:
    """Find the common rotor speed, rad/s, that carries the weight with these step inputs (battery voltage included)."""
    scratch, found = make_scratch(kernel), np.zeros(6)

    def residual(speed: float) -> float:
        x = append_extra_states(make_hover_state(speed, place), step_inputs, kernel, body)
        compute_loads(x, step_inputs, kernel, body, scratch.inputs, scratch.work, found)
        return float(found[2] + body[MASS] * body[ADDED_GRAVITY])

    if residual(0.3 * guess) <= 0.0 or residual(2.0 * guess) >= 0.0:
        raise ConfigError(f"{what} has no common rotor speed that carries its weight; correct the voltage, or the load")
    return float(brentq(residual, 0.3 * guess, 2.0 * guess, xtol=1e-9))


def compute_asymmetry(
    kernel: Any, body: np.ndarray, step_inputs: np.ndarray, hover: float, place: np.ndarray
) -> np.ndarray:
    """Compute forces and moments (6,) in hover at equal rotor speeds, without the force that carries the weight."""
    x = append_extra_states(make_hover_state(hover, place), step_inputs, kernel, body)
    scratch = make_scratch(kernel)
    found = np.zeros(6)
    compute_loads(x, step_inputs, kernel, body, scratch.inputs, scratch.work, found)
    # forces that include gravity sum to zero in hover
    found[2] += body[MASS] * body[ADDED_GRAVITY]
    return found


def _make_actuator(
    asked: Mapping[str, Any], model: Model, notes: list[str], name: str
) -> tuple[ActuatorLimits, np.ndarray, np.ndarray, float]:
    kind, airframe, known = asked["actuator"], model.airframe, actuators_of(model)
    first, second = asked["time constants"], asked["time constants down"]
    up = down = np.zeros(4)
    if kind == "rotorDynamicsV2":
        if first is None:
            notes += [note for note in known.notes if "time constants" in note]
        up = known.up if first is None else np.broadcast_to(np.asarray(first, float), 4).copy()
        down = known.down if first is None else up.copy()
        down = down if second is None else np.broadcast_to(np.asarray(second, float), 4).copy()
    elif first is not None or second is not None:
        notes.append(f"'actuator' / 'time constants' is not used: '{kind}' has no lag")
    factor = airframe.logged_to_rad_s or model.document.get("logged to rad/s")
    rate = asked["rate limit"]
    if rate is None and kind == "rotorDynamicsV1":
        if factor is None:
            raise ConfigError(
                f"{name}: the manual's rate limit is in logged units, and the airframe's 'motor poles' are unknown; "
                "give 'rate limit' in rad/s2"
            )
        rate = _MANUAL_RATE_LIMIT * factor
    bounds = []
    limits = zip(("lowest speed", "highest speed"), read_speed_limits(model), (0.0, math.inf))
    for key, limit, free in limits:
        value = limit if asked[key] is None else asked[key]
        if value is None and kind != "none":
            what = "idle RPM" if key == "lowest speed" else "max RPM"
            notes.append(f"the airframe's '{what}' or 'motor poles' is unknown: commands have no {key}")
        bounds.append(free if value is None or kind == "none" else float(value))
    if bounds[0] >= bounds[1]:
        raise ConfigError(
            f"{name}: the rotors' lowest speed {bounds[0]:g} rad/s is not below the highest {bounds[1]:g}; correct them"
        )
    late = asked["delay"]
    if late is None:
        late = 0.0 if kind == "none" else known.delay
    return ActuatorLimits(bounds[0], bounds[1], float(late)), up, down, math.inf if rate is None else float(rate)


def _make_battery(
    asked: Mapping[str, Any], model: Model, hover: float, notes: list[str], name: str
) -> tuple[Battery, int]:
    """Make the battery; find the index of the time among the model's extra inputs."""
    extras = list(model.inputs[20:])
    unknown = [n for n in extras if n not in ("battery_voltage", "t")]
    if unknown:
        raise ConfigError(
            f"{name}: model {model.id} has terms in '{unknown[0]}', which a simulation cannot provide; "
            "identify it without that variable"
        )
    place, clock = (extras.index(n) if n in extras else -1 for n in ("battery_voltage", "t"))
    start = asked["voltage"]
    if start is None and place >= 0:
        start = find_training_median(model, "battery_voltage")
        if start is None:
            raise ConfigError(f"{name}: model {model.id} has terms in the battery voltage; give 'battery' / 'voltage'")
        notes.append(f"the battery begins at {start:.2f} V, the median of the model's training flights")
    if start is None:
        if asked["exponent"] or asked["drain"] or asked["sag"]:
            raise ConfigError(f"{name}: 'battery' names 'exponent', 'drain' or 'sag' but no 'voltage'; add it")
        start = 0.0
    exponent, reference = asked["exponent"], asked["reference voltage"]
    of_causes = read_rotor_constants(model)
    if not exponent and "voltage exponent" in of_causes:
        if start:
            exponent = of_causes["voltage exponent"]
            if reference is None and (reference := of_causes.get("reference voltage")):
                notes.append(
                    f"commanded rotor speeds are reached at {reference:.2f} V, the reference voltage of the model's "
                    "extensions; change it with 'battery' / 'reference voltage'"
                )
        else:
            notes.append(
                "the model's extensions scale rotor speeds with the battery voltage, but no voltage is given, so the "
                "scale is constant; give 'battery' / 'voltage'"
            )
    if {"telemetry delay", "rotor speed scale"} & set(of_causes):
        notes.append("corrections of recorded rotor speeds in the model's extensions are not used: nothing is recorded")
    reference = start if reference is None else reference
    return Battery(
        float(start), float(asked["drain"]), float(asked["sag"]), hover, float(reference), float(exponent), place,
    ), clock  # fmt: skip


def _make_fault(
    asked: Mapping[str, Any], drive: ActuatorLimits, duration: float, notes: list[str], name: str
) -> np.ndarray:
    health, effectiveness = asked["rotor health after failure"], asked["rotor effectiveness after failure"]
    whole = min(health) == min(effectiveness) == 1.0
    if not asked["inject failure"]:
        if not whole:
            notes.append("'faults' names rotors, but 'inject failure' is false: no rotor fails")
        return np.array([math.inf, *[1.0] * 4, *[math.inf] * 4])
    if whole:
        notes.append("'inject failure' is true, but every rotor keeps its health and effectiveness: no rotor fails")
    elif asked["time of failure"] >= duration:
        notes.append(f"the failure at {asked['time of failure']:g} s comes after the end at {duration:g} s")
    if min(health) < 1.0 and not math.isfinite(drive.high):
        raise ConfigError(
            f"{name}: 'rotor health after failure' is a share of the highest rotor speed, which is unknown; "
            "give 'actuator' / 'highest speed'"
        )
    caps = [h * drive.high if h < 1.0 else math.inf for h in health]
    return np.array([asked["time of failure"], *effectiveness, *caps], float)


def _make_start(asked: Mapping[str, Any], hover: float) -> np.ndarray:
    x = np.zeros(STATE_SIZE)
    x[:4] = attitude.from_euler(*asked["attitude"])
    x[4:7] = attitude.rotate_inverse(x[:4], np.array(asked["velocity"], float))
    x[7:10], x[10:13] = asked["rates"], asked["position"]
    x[ROTOR_SPEEDS:] = hover if asked["rotor speeds"] is None else asked["rotor speeds"]
    return x


def _check_start(x: np.ndarray, model: Model, body: np.ndarray, step_inputs: np.ndarray, name: str) -> None:
    kernel = model.kernel
    scratch, found = make_scratch(kernel), np.zeros(6)
    compute_loads(
        append_extra_states(x, step_inputs, kernel, body),
        step_inputs,
        kernel,
        body,
        scratch.inputs,
        scratch.work,
        found,
    )
    lost = describe_undefined_loads(model, scratch.inputs, found)
    if lost:
        raise ConfigError(f"{name}: in the initial state {lost[0]}; correct 'initial state conditions', or {lost[1]}")
