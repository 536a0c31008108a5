"""Flights in JSBSim (LGPL; Berndt, 2004): its F450 with DJI's E305 motors, under our cascade.

JSBSim gives what the other simulators lack: thrust and torque by tables of the advance ratio of a measured propeller,
brushless motors that a voltage drives through a resistance against the propeller's inertia, the reaction of their
acceleration and gyroscopic moments, an atmosphere with turbulence, and a round Earth that turns. Of its aircraft the
controller and the sensors are left out: those of the benchmark take their place.
"""

import contextlib
import io
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from foreign_flights import Motion, Vehicle
from foreign_pilot import RATE, Cascade, Course

Load = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
Parts = dict[str, ElementTree.Element]
MODEL = "F450"
MASSES, AERO, ROTORS = (f"aircraft/{MODEL}/{name}.xml" for name in ("Mass", "Aero", "Propulsion"))
STEPS = 4  # of simulation and control for one of the course
FOOT, POUND, SLUG = 0.3048, 4.4482216152605, 14.593902937  # m, N, kg
MASS, INERTIA = 1.4, (0.0190, 0.0190, 0.0252)  # kg, kg m2
# front right, aft left, front left, aft right; x forward, y left, z up, m
HUBS = 0.1651 * np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]]) + [0.0, 0.0, 0.025]
TURNS = np.array([-1.0, -1.0, 1.0, 1.0])  # torque about z up on the body; a clockwise rotor gives 1
RADIUS = 0.5 * 9.4 * 0.0254  # m
DRAG = 0.5 * 1.225 * 0.016129  # N s2/m2, of a drag coefficient of 1
ALL = (1, 2, 3, 4)
IDLE = 0.12  # of the throttle
LATITUDE = 45.0  # deg
# what its vehicle has in every flight: true where a diagnosis reports it as always there
ALWAYS = frozenset({"body_drag", "axial_inflow", "rotor_acceleration_torque", "rotor_gyroscopic"})
SENSORS: dict[str, Any] = {"hover": 516.0}
READ = (
    *(f"position/from-start-neu-{a}-ft" for a in "neu"),
    *(f"attitude/{a}-rad" for a in ("phi", "theta", "psi")),
    *(f"velocities/v-{a}-fps" for a in ("north", "east", "down")),
    *(f"velocities/{a}-rad_sec" for a in "pqr"),
    *(f"accelerations/{a}dot-rad_sec2" for a in "pqr"),
    *(f"forces/fb{a}-{what}-lbs" for what in ("aero", "prop", "gear", "external") for a in "xyz"),
)


def vehicle() -> Vehicle:
    """What the lab writes down about it."""
    places = {"front right": 1, "aft left": 2, "front left": 3, "aft right": 4}
    return Vehicle("Jess", MASS, INERTIA, HUBS, "CCW", RADIUS, speed_of(1.0), places)


def parts() -> Parts:
    """The XML of JSBSim's F450, by file, with a motor and a propeller for each rotor from 1."""
    import jsbsim

    root = Path(jsbsim.__file__).parent
    files = (MASSES, AERO, ROTORS, f"aircraft/{MODEL}/Metrics.xml", f"aircraft/{MODEL}/Gear.xml")
    found = {f: ElementTree.parse(root / f).getroot() for f in files}
    for tag, source, own in (("engine", "DJI_E305", "motor"), ("thruster", "DJI_9450", "propeller")):
        for i, rotor in enumerate(found[ROTORS].iter(tag), 1):
            rotor.set("file", f"{own}{i}")
            found[f"engine/{own}{i}.xml"] = ElementTree.parse(root / f"engine/{source}.xml").getroot()
    return found


def scaled(what: str, factor: float, rotors: Sequence[int] = ()) -> Callable[[Parts], None]:
    """A change of one value, or of one table's second column, of the frame or of the rotors (from 1) that are given."""

    def change(documents: Parts) -> None:
        files = [f"engine/{part}{i}.xml" for part in ("motor", "propeller") for i in rotors] or [MASSES]
        values = [v for name in files for v in documents[name].iter(what)]
        tables = [t for name in files for t in documents[name].iter("table") if t.get("name") == what]
        if not values + tables:
            raise KeyError(what)
        for value in values:
            value.text = repr(factor * float(value.text))
        for table in tables:
            data = table.find("tableData")
            rows = np.array(data.text.split(), float).reshape(-1, 2) * [1.0, factor]
            data.text = "\n".join(f"{a} {b!r}" for a, b in rows.tolist())

    return change


def shifted(cg: tuple[float, float, float]) -> Callable[[Parts], None]:
    """A change of the place of the centre of gravity, m in body axes x forward, y left, z up."""

    def change(documents: Parts) -> None:
        for axis, value in zip("xyz", np.array(cg) * [-1.0, -1.0, 1.0]):
            documents[MASSES].find(f"location/{axis}").text = repr(float(value))

    return change


def resisting(coefficient: float) -> Callable[[Parts], None]:
    """A change of the drag coefficient of the body, which is 1."""

    def change(documents: Parts) -> None:
        (zero,) = [f for f in documents[AERO].iter("function") if f.get("name") == "aero/coefficient/CD__zero"]
        zero.find("value").text = repr(coefficient)

    return change


def written(folder: Path, documents: Parts) -> None:
    """The files of an aircraft without JSBSim's own controller and sensors, with a force and a moment from outside."""
    for name, root in documents.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        ElementTree.ElementTree(root).write(path)
    outside = "".join(
        f'<{kind} name="{kind}-{a}" frame="BODY"><location unit="M"><x>0</x><y>0</y><z>0</z></location>'
        f"<direction>{''.join(f'<{b}>{float(a == b)}</{b}>' for b in 'xyz')}</direction></{kind}>"
        for kind in ("force", "moment")
        for a in "xyz"
    )
    (folder / f"aircraft/{MODEL}/{MODEL}.xml").write_text(
        f'<fdm_config name="{MODEL}" release="ALPHA" version="2.0"><fileheader/><metrics file="Metrics.xml"/>'
        '<mass_balance file="Mass.xml"/><ground_reactions file="Gear.xml"/><propulsion file="Propulsion.xml"/>'
        f'<external_reactions>{outside}</external_reactions><aerodynamics file="Aero.xml"/></fdm_config>'
    )
    (folder / "systems").mkdir(exist_ok=True)


def started(folder: Path, height: float = 0.16) -> Any:
    """JSBSim at rest above the ground, its motors on."""
    import jsbsim

    jsbsim.FGJSBBase().debug_lvl = 0
    plane = jsbsim.FGFDMExec(str(folder))
    plane.set_debug_level(0)
    with contextlib.redirect_stdout(io.StringIO()):
        if not plane.load_model(MODEL):
            raise RuntimeError(f"JSBSim does not load {folder}")
    plane.set_dt(1 / RATE / STEPS)
    plane["ic/lat-geod-deg"], plane["ic/long-gc-deg"], plane["ic/h-agl-ft"] = LATITUDE, 0.0, height / FOOT
    plane["ic/psi-true-deg"] = 0.0
    plane.run_ic()
    plane["propulsion/set-running"] = -1
    return plane


def engine(i: int) -> str:
    """The index of rotor i, from 0, in JSBSim's properties, which write none for the first."""
    return f"[{i}]" if i else ""


def throttles(plane: Any, values: Sequence[float]) -> None:
    """Set the throttle of each rotor, 0 to 1."""
    for i, value in enumerate(values):
        plane[f"fcs/throttle-cmd-norm{engine(i)}"] = float(value)


def speeds_of(plane: Any) -> np.ndarray:
    """Speeds of the rotors (4,), rad/s."""
    return np.array([plane[f"propulsion/engine{engine(i)}/propeller-rpm"] for i in range(4)]) * np.pi / 30


_STATIC: list[np.ndarray] = []


def static() -> np.ndarray:
    """Throttle, speed rad/s and thrust N of a rotor on a vehicle that is too heavy to leave the ground: rows (3, n)."""
    if not _STATIC:
        documents = parts()
        documents[MASSES].find("emptywt").text = "100"
        table = np.linspace(0.05, 1.0, 20)
        with tempfile.TemporaryDirectory() as name:
            written(Path(name), documents)
            plane = started(Path(name))
            rows = []
            for throttle in table:
                throttles(plane, [throttle] * 4)
                for _ in range(RATE * STEPS):
                    plane.run()
                rows.append([throttle, speeds_of(plane).mean(), -plane["forces/fbz-prop-lbs"] * POUND / 4])
        _STATIC.append(np.array(rows).T)
    return _STATIC[0]


def speed_of(throttle: float) -> float:
    """Steady speed of a rotor, rad/s."""
    return float(np.interp(throttle, static()[0], static()[1]))


def fly(
    course: Course,
    change: Callable[[Parts], None] | None = None,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    properties: Mapping[str, float] | None = None,
    load: Load | None = None,
) -> Motion:
    """One flight, of the centre of gravity.

    change      alters the XML of `parts`, which the controller does not know; wind  m/s, world x north, y west, z up
    properties  of JSBSim, set once the motors run
    load        (position m, velocity through the air m/s body) to a force N and moment N m, body, of no parameter
    """
    documents = parts()
    if change is not None:
        change(documents)
    throttle, _, thrust = static()
    control = Cascade(MASS, np.array(INERTIA), HUBS, ratio() * TURNS, (np.interp(IDLE, throttle, thrust), thrust[-1]))
    h, n = 1 / RATE / STEPS, STEPS * len(course.yaw)
    rows, speeds, commands = np.zeros((n, len(READ))), np.zeros((n, 4)), np.full((n, 4), IDLE)
    with tempfile.TemporaryDirectory() as name:
        written(Path(name), documents)
        plane = started(Path(name))
        mass = plane["inertia/mass-slugs"] * SLUG
        for what, value in (properties or {}).items():
            plane[what] = value
        for a, value in zip(("north", "east", "down"), np.array(wind) * [1.0, -1.0, -1.0]):
            plane[f"atmosphere/wind-{a}-fps"] = value / FOOT
        throttles(plane, commands[0])
        for j in range(n):
            k = j // STEPS
            speeds[j] = speeds_of(plane)  # with these the step that follows makes its forces
            plane.run()
            rows[j] = [plane[p] for p in READ]
            state = in_world(rows[j : j + 1])[0]
            if course.armed[k]:
                commands[j] = np.interp(control.thrusts(course, k, state, h), thrust, throttle)
            throttles(plane, commands[j])
            if load is not None:
                pushed(plane, state, wind, load)
    state = in_world(rows)
    force = rows[:, 15:].reshape(n, 4, 3).sum(axis=1) * POUND / mass * [1.0, -1.0, -1.0]
    swing = rows[:, 12:15] * [1.0, -1.0, -1.0]
    return Motion(
        h * np.arange(n), state[:, :3], state[:, [4, 5, 6, 3]], state[:, 10:13], swing, force, speeds, commands,
    )  # fmt: skip


def ratio() -> float:
    """N m of torque per N of thrust of a rotor at rest: C_P D / (2 pi C_T)."""
    documents = parts()
    first = {
        t.get("name"): float(t.find("tableData").text.split()[1])
        for t in documents["engine/propeller1.xml"].iter("table")
    }
    return first["C_POWER"] * 2 * RADIUS / (2 * np.pi * first["C_THRUST"])


def in_world(rows: np.ndarray) -> np.ndarray:
    """States (n, 13) of rows of `READ`: position m, quaternion w x y z, velocity m/s (world z up), rates (body)."""
    from scipy.spatial.transform import Rotation

    half_turn = np.array([1.0, -1.0, -1.0])
    position = rows[:, :3] * FOOT * [1.0, -1.0, 1.0]
    turn = Rotation.from_euler("ZYX", rows[:, [5, 4, 3]]).as_quat() * [1.0, -1.0, -1.0, 1.0]
    return np.column_stack(
        [position, turn[:, [3, 0, 1, 2]], rows[:, 6:9] * FOOT * half_turn, rows[:, 9:12] * half_turn]
    )


def pushed(plane: Any, state: np.ndarray, wind: Sequence[float], load: Load) -> None:
    """Give JSBSim the force and moment of a load for its next step."""
    from scipy.spatial.transform import Rotation

    through = Rotation.from_quat(state[3:7], scalar_first=True).inv().apply(state[7:10] - wind)
    force, moment = load(state[:3], through)
    for i, sign in enumerate((1.0, -1.0, -1.0)):
        plane[f"external_reactions/force-{'xyz'[i]}/magnitude"] = sign * force[i] / POUND
        plane[f"external_reactions/moment-{'xyz'[i]}/magnitude-lbsft"] = sign * moment[i] / POUND / FOOT
