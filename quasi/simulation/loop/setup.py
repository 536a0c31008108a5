"""From a model and a configuration to a closed loop that is ready to run.

    setup = make_setup({"model": {"model ID": "example"}, "references": {"do circle track": True}}, model)
    result = simulate(setup)

The configuration is the manual's droneSimConfig.json with what it lacks, see config/schemas/simulation.schema.json.
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
from quasi.model.extensions import drive_of, said_of_rotors, wind_of
from quasi.model.model import Model
from quasi.project import configuration
from quasi.simulation.control.control_model import DEFAULT_LAG, hover_speed
from quasi.simulation.control.controllers import make_controller
from quasi.simulation.control.references import make_reference
from quasi.simulation.loop.closed_loop import Battery, Drive, Live, Machine, live_of
from quasi.simulation.loop.setup_tables import table_of, wind_rows
from quasi.simulation.loop.stability import check_step
from quasi.simulation.vehicle.dynamics import INTEGRATORS, RK4, body_of, loads_at, scratch_of, with_rest
from quasi.simulation.vehicle.layout import (
    CAP,
    GRAVITY_ADDED,
    HELD,
    MASS,
    OFFSET,
    OWN,
    POSITION,
    ROTORS,
    SHARE,
    STATES,
    TARGET,
)
from quasi.simulation.vehicle.payload_and_inflow import put
from quasi.simulation.vehicle.sensors_and_wind import Sensors
from quasi.simulation.vehicle.undefined_loads import describe_undefined_loads
from quasi.simulation.vehicle.variants import extended, parts_of, simple_model, with_parts

STATE_NAMES = ("qw", "qx", "qy", "qz", "u", "v", "w", "p", "q", "r", "x", "y", "z", "w1", "w2", "w3", "w4")
# beyond these no polynomial means anything: m/s, rad/s, m, rad/s of a rotor
_LIMITS = np.array([2.0] * 4 + [300.0] * 3 + [300.0] * 3 + [1e5] * 3 + [2e4] * 4)
_V1_RATE = 5e4  # logged units (eRPM/100) per second: the rate limit of the manual's rotorDynamicsV1
LARGEST_LOG = 5_000_000  # rows, of some 700 bytes each


@dataclass(frozen=True)
class Setup:
    """A closed loop with where it begins and how long it runs.

    model        what is flown, extensions and simplifications included
    machine      the compiled loop's constants; memory: the size of the controller's
    start        (17 + own,) initial state, the parts that have states of their own at rest
    seeds        of noise and of gusts
    steps        of machine.dt; every: how many of them between two logged rows
    settings     the checked configuration; notes: what was assumed
    """

    name: str
    model: Model
    machine: Machine
    memory: int
    start: np.ndarray
    seeds: tuple[int, int]
    steps: int
    every: int
    settings: dict[str, Any]
    notes: tuple[str, ...]

    @property
    def airframe(self) -> Airframe:
        """Geometry and mass properties of what is flown."""
        return self.model.airframe

    @property
    def dt(self) -> float:
        """s, between two commands."""
        return self.machine.dt

    @property
    def own(self) -> int:
        """Number of states beyond the seventeen."""
        return int(self.machine.body[OWN])

    def held(self) -> np.ndarray:
        """What is held over a step at the beginning: rotors in balance with their speeds, in still air."""
        held = still(int(self.machine.kernel.code[6]), 0.0)
        held[TARGET : TARGET + 4] = self.start[ROTORS:STATES]
        if self.machine.battery.place >= 0:
            held[HELD + self.machine.battery.place] = self.machine.battery.start
        return held

    def live(self) -> Live:
        """What changes during the simulation, at its beginning."""
        return live_of(self.machine, self.start, self.memory, *map(np.uint64, self.seeds))


def make_setup(
    settings: Mapping[str, Any],
    model: Model,
    wind: pd.DataFrame | Mapping[str, np.ndarray] | None = None,
    reference: pd.DataFrame | Mapping[str, np.ndarray] | None = None,
    name: str = "simulation",
    directory: str | Path = ".",
) -> Setup:
    """Put a closed loop together.

    settings   the configuration, checked here; what it leaves out takes its default
    model      the model that it names
    wind       t (s), wind_north, wind_east, wind_down (m/s); None reads the table that "wind" / "file" names
    reference  see `references.make_reference`; None reads the table that "references" / "file" names
    directory  folder to which relative "file" paths belong
    Raises ConfigError naming the key, DataError for a model that cannot fly, ReadError for a table that cannot be read.
    """
    settings, _ = configuration.check(settings, "simulation", name)
    notes: list[str] = []
    wind = table_of(settings, "wind", directory, name) if wind is None else wind
    reference = table_of(settings, "references", directory, name) if reference is None else reference
    asked = settings["model"]
    model = extended(model) if asked["use identified model"] else simple_model(model)
    if len(model.axes) < 6:
        lacking = [a for a in ("Fx", "Fy", "Fz", "Mx", "My", "Mz") if a not in model.axes]
        raise DataError(f"model {model.id} lacks {', '.join(lacking)}; a simulation needs all six axes")
    airframe = model.airframe
    if airframe.mass is None:
        raise DataError(f"model {model.id} knows no mass; fill in 'Mass' in the logbook and make it anew")
    dt, substeps = float(settings["simulation"]["time step"]), int(settings["simulation"]["substeps"])
    steps = round(settings["simulation"]["duration"] / dt)
    if steps < 1:
        raise ConfigError(
            f"{name}: 'duration' {settings['simulation']['duration']:g} s is shorter than the 'time step' {dt:g} s"
        )
    if steps // settings["simulation"]["log every"] > LARGEST_LOG:
        raise ConfigError(
            f"{name}: {steps:,} steps are more rows than memory holds ({LARGEST_LOG:,}); use a longer 'time step' or "
            "'log every', or a shorter 'duration'"
        )
    parts = parts_of(model)
    flown = with_parts(model)
    drive, up, down, rate = _actuator(settings["actuator"], model, notes, name)
    hover = hover_speed(model, drive.high if math.isfinite(drive.high) else None)
    if not drive.low <= hover <= drive.high:
        raise ConfigError(
            f"{name}: hover takes rotor speeds of {hover:.0f} rad/s, but the actuator allows {drive.low:.0f} to "
            f"{drive.high:.0f}; correct 'lowest speed' and 'highest speed', or the airframe's 'idle RPM', 'max RPM' "
            "and 'motor poles'"
        )
    battery, clock = _battery(settings["battery"], flown, hover, notes, name)
    kernel = flown.kernel
    gravity = GRAVITY if model.with_gravity else 0.0
    body = body_of(airframe.mass, airframe.inertia, kernel, gravity, up, down, rate)
    put(parts, airframe.hubs, body)
    held = still(len(flown.inputs), hover)
    if battery.place >= 0:
        held[HELD + battery.place] = battery.start
    place = np.array(settings["initial state conditions"]["position"], float)
    if battery.place >= 0 or parts.states or kernel.used[9:12].any():
        volts = f" at {battery.start:g} V" if battery.place >= 0 else ""
        hover = _hover_at(kernel, body, held, hover, place, f"{name}: model {model.id}{volts}")
        battery = battery._replace(hover=hover)
        held[TARGET : TARGET + 4] = hover
    offset = np.zeros(6)
    if asked["correct for moment asymmetries"]:
        offset = asymmetry(kernel, body, held, hover, place)
        body[OFFSET : OFFSET + 6] = offset
    start = _start(settings["initial state conditions"], hover)
    _check_start(start, flown, body, held, name)
    start = with_rest(start, held, kernel, body)
    if parts.load_mass:
        notes.append(f"a load of {parts.load_mass:.3g} kg swings {parts.load_length:.3g} m below the centre of gravity")
    method = settings["simulation"]["integrator"]
    if method not in INTEGRATORS and substeps > 1:
        raise ConfigError(f"{name}: '{method}' finds its own steps; leave 'substeps' out")
    check_step(body, kernel, held, hovering(hover, place), dt / substeps, method, notes, name)

    asked = settings["controller"]
    actuators = {"time constants": np.maximum(up, 1e-4), "delay": drive.delay, "lowest": drive.low,
                 "highest": drive.high if math.isfinite(drive.high) else None}  # fmt: skip
    with _within(name):
        kind, gains, memory = make_controller({**asked, "time step": dt}, model, actuators, offset)
    wanted = dict(settings["references"])
    if not any(wanted.get(k) for k in ("do position track", "do circle track", "kind")):
        here, yaw = [float(c) for c in start[10:13]], float(attitude.to_euler(start[:4])[2])
        wanted = {"position": here, "yaw": yaw} | wanted | {"kind": "hover"}
    with _within(name if reference is None else f"{name}, {wanted.get('file', 'table handed over')}"):
        aim, path, table = make_reference(wanted, reference)
    noise = settings["noise"]
    names = ("attitude", "velocity", "rates", "position", "rotor speeds", "specific force")
    sensors = Sensors(*(float(noise[n]) if noise["add"] else 0.0 for n in names))
    air = settings["wind"]
    steady = np.array(air["steady"], float) + wind_of(model)
    if np.any(wind_of(model)):
        notes.append("the wind that the model's extensions found in its flights blows, too")
    machine = Machine(
        kernel, body, drive, battery, _fault(settings["faults"], drive, steps * dt, notes, name), sensors,
        np.array([*steady, *air["gusts"], *[air["correlation time"]] * 3], float), wind_rows(wind, air, name),
        kind, gains, aim, path, table, dt, substeps, INTEGRATORS.get(method, RK4), _LIMITS.copy(), clock,
    )  # fmt: skip
    seeds = (noise["seed"], noise["seed"] if air["seed"] is None else air["seed"])
    every = settings["simulation"]["log every"]
    return Setup(name, model, machine, memory, start, seeds, steps, every, settings, tuple(notes))


@contextmanager
def _within(where: str) -> Iterator[None]:
    """Faults that are found inside begin with where they stand."""
    try:
        yield
    except (ConfigError, DataError) as error:
        raise type(error)(f"{where}: {error}") from None


def still(inputs: int, speed: float) -> np.ndarray:
    """What is held over a step in still air with whole rotors that keep a speed, rad/s; `inputs` of the model."""
    held = np.zeros(HELD + inputs - 20)
    held[TARGET : TARGET + 4], held[SHARE : SHARE + 4], held[CAP : CAP + 4] = speed, 1.0, np.inf
    return held


def hovering(speed: float, place: np.ndarray) -> np.ndarray:
    """State (17,) of a level vehicle that keeps its place, m, all rotors at one speed, rad/s."""
    x = np.zeros(STATES)
    x[0], x[POSITION : POSITION + 3], x[ROTORS:] = 1.0, place, speed
    return x


def _hover_at(kernel: Any, body: np.ndarray, held: np.ndarray, guess: float, place: np.ndarray, what: str) -> float:
    """Common rotor speed, rad/s, that carries the weight there, with what is held: the battery's voltage among it."""
    scratch, found = scratch_of(kernel), np.zeros(6)

    def lack(speed: float) -> float:
        x = with_rest(hovering(speed, place), held, kernel, body)
        loads_at(x, held, kernel, body, scratch.inputs, scratch.work, found)
        return float(found[2] + body[MASS] * body[GRAVITY_ADDED])

    if lack(0.3 * guess) <= 0.0 or lack(2.0 * guess) >= 0.0:
        raise ConfigError(f"{what} carries its weight at no common rotor speed; correct the voltage, or the load")
    return float(brentq(lack, 0.3 * guess, 2.0 * guess, xtol=1e-9))


def asymmetry(kernel: Any, body: np.ndarray, held: np.ndarray, hover: float, place: np.ndarray) -> np.ndarray:
    """Forces and moments (6,) in hover there with four equal rotor speeds, beyond the force that carries the weight."""
    x = with_rest(hovering(hover, place), held, kernel, body)
    scratch = scratch_of(kernel)
    found = np.zeros(6)
    loads_at(x, held, kernel, body, scratch.inputs, scratch.work, found)
    # where gravity is part of the forces they balance in hover
    found[2] += body[MASS] * body[GRAVITY_ADDED]
    return found


def _actuator(
    asked: Mapping[str, Any], model: Model, notes: list[str], name: str
) -> tuple[Drive, np.ndarray, np.ndarray, float]:
    kind, airframe = asked["actuator"], model.airframe
    known = drive_of(model.document)

    def of_model(*keys: str) -> Any:
        for key in keys:
            about = known.get(key) or {}
            try:
                value = about.get("value")
                if value is None:
                    continue
                # an identified delay may come out a little below zero
                least = np.min(np.broadcast_to(np.asarray(value, float), 4))
                if least > 0.0 or (key == "delay" and np.isfinite(least)):
                    return value
            except (AttributeError, TypeError, ValueError):
                pass
            raise DataError(
                f"model {model.id}: 'actuators' / '{key}' is {about!r:.60}, expected seconds under 'value'; "
                "make the model anew"
            )
        return None

    up = down = np.zeros(4)
    if kind != "rotorDynamicsV2" and not (asked["time constants"] is None and asked["time constants down"] is None):
        notes.append(f"'actuator' / 'time constants' plays no part: '{kind}' has no lag")
    if kind == "rotorDynamicsV2":
        first = asked["time constants"]
        if first is None:
            first = of_model("time constants up", "time constants")
            if first is None:
                first = DEFAULT_LAG
                notes.append(f"the model knows no time constants of the rotors; {DEFAULT_LAG:.4f} s is taken")
        second = asked["time constants down"]
        if second is None:
            second = of_model("time constants down") if asked["time constants"] is None else None
        up = np.broadcast_to(np.asarray(first, float), 4).copy()
        down = up.copy() if second is None else np.broadcast_to(np.asarray(second, float), 4).copy()
    factor = airframe.logged_to_rad_s or model.document.get("logged to rad/s")
    rate = asked["rate limit"]
    if rate is None and kind == "rotorDynamicsV1":
        if factor is None:
            raise ConfigError(
                f"{name}: the manual's rate limit is in logged units, and the airframe's 'motor poles' are unknown; "
                "give 'rate limit' in rad/s2"
            )
        rate = _V1_RATE * factor
    bounds = []
    for key, logged, free in (("lowest speed", airframe.idle_rpm, 0.0), ("highest speed", airframe.max_rpm, math.inf)):
        value = asked[key]
        if value is None and logged is not None and factor is not None:
            value = logged * factor
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
        late = of_model("delay")
        late = 0.0 if late is None or kind == "none" else max(float(np.mean(late)), 0.0)
    return Drive(bounds[0], bounds[1], float(late)), up, down, math.inf if rate is None else float(rate)


def _battery(asked: Mapping[str, Any], model: Model, hover: float, notes: list[str], name: str) -> tuple[Battery, int]:
    """The battery, and the place of the time among the model's extra inputs."""
    extras = list(model.inputs[20:])
    unknown = [n for n in extras if n not in ("battery_voltage", "t")]
    if unknown:
        raise ConfigError(
            f"{name}: model {model.id} has terms in '{unknown[0]}', which a simulation cannot know; "
            "identify it without that variable"
        )
    place, clock = (extras.index(n) if n in extras else -1 for n in ("battery_voltage", "t"))
    start = asked["voltage"]
    if start is None and place >= 0:
        covered = (model.document.get("envelope") or {}).get("battery_voltage", {})
        start = covered.get("percentiles", {}).get("50")
        if start is None:
            raise ConfigError(f"{name}: model {model.id} has terms in the battery voltage; give 'battery' / 'voltage'")
        notes.append(f"the battery begins at {start:.2f} V, the median of the model's training flights")
    if start is None:
        if asked["exponent"] or asked["drain"] or asked["sag"]:
            raise ConfigError(f"{name}: 'battery' names 'exponent', 'drain' or 'sag' but no 'voltage'; add it")
        start = 0.0
    exponent, reference = asked["exponent"], asked["reference voltage"]
    of_causes = said_of_rotors(model)
    if not exponent and "voltage exponent" in of_causes:
        if start:
            exponent = of_causes["voltage exponent"]
            if reference is None and (reference := of_causes.get("reference voltage")):
                notes.append(
                    f"rotors turn as fast as commanded at {reference:.2f} V, the voltage that the model's extensions "
                    "tell; give 'battery' / 'reference voltage' for another one"
                )
        else:
            notes.append(
                "rotor speeds follow the battery's voltage by the model's extensions, but no voltage is given: the "
                "battery stays as it was; give 'battery' / 'voltage'"
            )
    if {"telemetry delay", "rotor speed scale"} & set(of_causes):
        notes.append("what the model's extensions say of recorded rotor speeds plays no part here: nothing is recorded")
    reference = start if reference is None else reference
    return Battery(
        float(start), float(asked["drain"]), float(asked["sag"]), hover, float(reference), float(exponent), place,
    ), clock  # fmt: skip


def _fault(asked: Mapping[str, Any], drive: Drive, duration: float, notes: list[str], name: str) -> np.ndarray:
    health, effectiveness = asked["rotor health after failure"], asked["rotor effectiveness after failure"]
    whole = min(health) == min(effectiveness) == 1.0
    if not asked["inject failure"]:
        if not whole:
            notes.append("'faults' names rotors, but 'inject failure' is false: nothing fails")
        return np.array([math.inf, *[1.0] * 4, *[math.inf] * 4])
    if whole:
        notes.append("'inject failure' is true, but every rotor keeps its health and effectiveness: nothing fails")
    elif asked["time of failure"] >= duration:
        notes.append(f"the failure at {asked['time of failure']:g} s comes after the end at {duration:g} s")
    if min(health) < 1.0 and not math.isfinite(drive.high):
        raise ConfigError(
            f"{name}: 'rotor health after failure' is a share of the highest rotor speed, which is unknown; "
            "give 'actuator' / 'highest speed'"
        )
    caps = [h * drive.high if h < 1.0 else math.inf for h in health]
    return np.array([asked["time of failure"], *effectiveness, *caps], float)


def _start(asked: Mapping[str, Any], hover: float) -> np.ndarray:
    x = np.zeros(STATES)
    x[:4] = attitude.from_euler(*asked["attitude"])
    x[4:7] = attitude.rotate_inverse(x[:4], np.array(asked["velocity"], float))
    x[7:10], x[10:13] = asked["rates"], asked["position"]
    x[ROTORS:] = hover if asked["rotor speeds"] is None else asked["rotor speeds"]
    return x


def _check_start(x: np.ndarray, model: Model, body: np.ndarray, held: np.ndarray, name: str) -> None:
    kernel = model.kernel
    scratch, found = scratch_of(kernel), np.zeros(6)
    loads_at(with_rest(x, held, kernel, body), held, kernel, body, scratch.inputs, scratch.work, found)
    lost = describe_undefined_loads(model, scratch.inputs, found)
    if lost:
        raise ConfigError(f"{name}: in the initial state {lost[0]}; correct 'initial state conditions', or {lost[1]}")
