"""What is hidden in flights of foreign simulators: one parameter of a simulator each, a fault of a sensor, or two."""

import importlib
from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import foreign_drone_models
import numpy as np
from foreign_vehicles import VEHICLES, of

PAIRS = (
    ("mass x 1.08", "wind 3 m/s"), ("rotor 3 x 0.93", "body drag x 6"), ("cg moved", "torque x 1.2"),
    ("inertia x 1.2", "motor lag x 2"), ("rotor drag x 2", "markers 10 mm ahead"), ("gyro x 1.04", "mass x 1.08"),
    ("thrust fades", "wind 3 m/s"), ("inflow x 2", "rotor 2 x 0.92, its torque too"),
    ("attitude 8 ms late", "rotor drag x 2"), ("torque x 1.2", "rotor 3 x 0.93"),
)  # fmt: skip


class Case(NamedTuple):
    """One hidden cause, or two.

    right   ids of which one must be named or stand in a tie; empty where the catalogue has none: nothing may be named
    second  likewise, of a second cause
    also    ids that are true as well, or that import settles; they are no wrong names
    value   {parameter: true value} of the first right id
    change  keywords of the simulator's `fly`; sensors  of `Sensors`
    may_miss  whether `agrees` is right too: import or filter takes the cause off, or it is below what flights show
    """

    right: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    value: Mapping[str, float] = {}
    change: Mapping[str, Any] = {}
    sensors: Mapping[str, Any] = {}
    may_miss: bool = False
    unexplained: bool = False
    second: tuple[str, ...] = ()


def scaled(**factors: float) -> dict[str, Any]:
    """Parameters of RotorPy times factors."""

    def change(p: dict[str, Any]) -> None:
        for key, factor in factors.items():
            p[key] = p[key] * factor

    return {"change": change}


def other_cases(name: str) -> dict[str, Case]:
    """As the Hummingbird; those of a few grams have a smaller shift, and no load that is of its size."""
    light = name != "sih"
    cases = rotorpy_cases(name, (0.003, -0.002, 0.0) if light else (0.006, -0.004, 0.0))
    lacking = {"lift x 3"} if name == "crazyflie" else set()
    return {k: case for k, case in cases.items() if k not in lacking and not (light and case.unexplained)}


def rotorpy_cases(name: str = "rotorpy", shift: tuple[float, float, float] = (0.006, -0.004, 0.0)) -> dict[str, Case]:
    """One parameter of RotorPy each, and faults of sensors. shift  of the cg, m, forward and to the left

    A vehicle without one of the terms gets, as a change, that of the Hummingbird.
    """
    from foreign_rotorpy import moved
    from foreign_rotorpy import parameters as hummingbird

    p = vehicle_of(name).parameters()
    usual = {key: p[key] or hummingbird()[key] for key in ("k_d", "k_z", "k_h")}

    def more(key: str, times: float) -> dict[str, Any]:
        def change(document: dict[str, Any]) -> None:
            document[key] += times * usual[key]

        return {"change": change}

    def shifted(document: dict[str, Any]) -> None:
        moved(document, shift)

    # what sits on the frame moves backwards against the cg
    frame = {"imu": (-shift[0], -shift[1], 0.0), "markers": (-shift[0], -shift[1], 0.03)}
    cases = {
        "clean": Case(may_miss=True),
        "mass x 1.08": Case(("mass",), value={"mass": 1.08 * p["mass"]}, change=scaled(mass=1.08)),
        "rotor 3 x 0.93": Case(("rotor_effectiveness",), value={"rotor3": 0.93}, change={"weak": {3: (0.93, 1.0)}}),
        "thrust x 0.95": Case(("thrust_factor",), value={"factor": 0.95}, change=scaled(k_eta=0.95)),
        "torque x 1.2": Case(("torque_factor",), value={"factor": 1.2}, change=scaled(k_m=1.2)),
        "inertia x 1.2": Case(("inertia",), value={"Ixx": 1.2 * p["Ixx"], "Iyy": 1.2 * p["Iyy"], "Izz": 1.2 * p["Izz"]},
                              change=scaled(Ixx=1.2, Iyy=1.2, Izz=1.2)),
        "cg moved": Case(("cg_offset",), ("imu_lever_arm", "marker_offset"), {"x": shift[0], "y": -shift[1]},
                         {"change": shifted}, frame),
        "rotor drag x 2": Case(("rotor_drag",), value={"k": usual["k_d"]}, change=more("k_d", 1.0)),
        "body drag x 6": Case(("body_drag",), value={"c": 5 * p["c_Dx"]}, change=scaled(c_Dx=6.0, c_Dy=6.0, c_Dz=6.0)),
        "wind 3 m/s": Case(("wind",), value={"north": 2.4, "east": -1.8}, change={"wind": (2.4, 1.8, 0.0)}),
        "motor lag x 2": Case(("motor_lag",), value={"time_constant": 2 * p["tau_m"]}, change=scaled(tau_m=2.0)),
        **sensor_cases(),
        "inflow x 2": Case(("axial_inflow",), value={"k": usual["k_z"]}, change=more("k_z", 1.0)),
        "lift x 3": Case(("translational_lift",), value={"k": 8 * usual["k_h"]}, change=more("k_h", 2.0)),
        # thinner air: all that the rotors do, in proportion
        "air x 0.93": Case(("thrust_factor",), ("torque_factor", "rotor_drag", "axial_inflow"), {"factor": 0.93},
                           scaled(k_eta=0.93, k_m=0.93, k_d=0.93, k_z=0.93, k_h=0.93)),
        "rotor 2 x 0.92, its torque too": Case(("rotor_effectiveness",), value={"rotor2": 0.92, "torque2": 0.92},
                                               change={"weak": {2: (0.92, 0.92)}}),
        "rotors 2 and 3 exchanged": Case(("rotor_order",), value={"rotor2": 3, "rotor3": 2},
                                         sensors={"rotors": (0, 2, 1, 3)}),
        # commands against measured speeds: forces hold with the speeds that were measured
        "motor of rotor 2 slower": Case(("motor_lag",), value={"rotor2": 2.0},
                                        change=scaled(tau_m=np.array([1.0, 2.0, 1.0, 1.0]))),
        "thrust fades": Case(("thrust_drift",), value={"rate": -0.002}, change={"fading": 0.002}),
        **unlisted_cases(),
    }  # fmt: skip
    return cases | {f"{a} and {b}": together(cases[a], cases[b]) for a, b in PAIRS}


def together(first: Case, second: Case) -> Case:
    """Both causes in the same flights."""
    changes = [case.change["change"] for case in (first, second) if "change" in case.change]

    def change(document: dict[str, Any]) -> None:
        for one in changes:
            one(document)

    return Case(
        first.right, (*first.also, *second.also), {**second.value, **first.value},
        {**first.change, **second.change, "change": change}, {**first.sensors, **second.sensors}, second=second.right,
    )  # fmt: skip


def drone_models_cases(name: str) -> dict[str, Case]:
    """One parameter of drone-models each, and faults of sensors."""
    from foreign_drone_models import TO_RPM, moved

    p = vehicle_of(name).parameters()
    shift = (0.0015, -0.001, 0.0)
    moments = np.diag(p["J"])
    linear = -float(p["rpm2thrust"][1]) * TO_RPM

    def shifted(document: dict[str, Any]) -> None:
        moved(document, shift)

    cases = {
        "clean": Case(may_miss=True),
        "mass x 1.08": Case(("mass",), value={"mass": 1.08 * p["mass"]}, change=scaled(mass=1.08)),
        "rotor 3 x 0.93": Case(("rotor_effectiveness",), value={"rotor3": 0.93}, change={"weak": {3: 0.93}}),
        "thrust x 0.95": Case(("thrust_factor",), value={"factor": 0.95}, change=scaled(rpm2thrust=0.95)),
        "torque x 1.2": Case(("torque_factor",), value={"factor": 1.2}, change=scaled(rpm2torque=1.2)),
        "inertia x 1.2": Case(("inertia",), value=dict(zip(("Ixx", "Iyy", "Izz"), 1.2 * moments)),
                              change=scaled(J=1.2)),
        # the frame keeps its rotors, sensors and markers
        "cg moved": Case(
            ("cg_offset",), ("imu_lever_arm", "marker_offset"), {"x": shift[0], "y": -shift[1]}, {"change": shifted},
            {"imu": (-shift[0], -shift[1], 0.0), "markers": (-shift[0], -shift[1], 0.03)},
        ),
        # of all axes, and of no rotor: the catalogue's drags depend on rotors or on the square of speed
        "drag x 2": Case(("rotor_drag", "body_drag"), ("axial_inflow",), change=scaled(drag_matrix=2.0)),
        "wind 3 m/s": Case(("wind",), value={"north": 2.4, "east": -1.8}, change={"wind": (2.4, 1.8, 0.0)}),
        "motor lag x 2": Case(("motor_lag",), change=scaled(rotor_dyn_coef=0.5)),
        "rotor inertia x 4": Case(("rotor_acceleration_torque",), ("rotor_gyroscopic",),
                                  change=scaled(prop_inertia=4.0)),
        "thrust as the square": Case(("thrust_curve", "thrust_factor"), value={"c1": linear},
                                     change=scaled(rpm2thrust=np.array([1.0, 0.0, 1.0]))),
        "thrust fades": Case(("thrust_drift",), value={"rate": -0.002}, change={"fading": 0.002}),
        **unlisted_cases(0.1),
        **sensor_cases(),
    }  # fmt: skip
    if name != "brushless_500":
        del cases["motor lag x 2"]  # brushed motors are slow: with more lag the course ends on the floor
    return cases | {"mass x 1.08 and wind 3 m/s": together(cases["mass x 1.08"], cases["wind 3 m/s"])}


def unlisted_cases(size: float = 1.0) -> dict[str, Case]:
    """Forces and moments that no cause of the catalogue describes. size  of the forces, by the vehicle's weight"""

    def cubic(_: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return -0.03 * size * float(velocity @ velocity) * velocity, np.zeros(3)  # N s3/m3

    def layered(position: np.ndarray, _: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([0.0, 0.0, 0.3 * size * np.sin(2 * np.pi * position[2] / 0.4)]), np.zeros(3)  # N, m

    def sideways(_: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([0.0, 0.05 * size * velocity[0] * abs(velocity[0]), 0.0]), np.zeros(3)  # N s2/m2

    # a drag with the cube of speed differs from body drag by its form alone
    near = {"cubic drag": ("body_drag",)}
    loads = {"cubic drag": cubic, "lift in layers of height": layered, "side force of forward speed": sideways}
    return {
        name: Case(also=near.get(name, ()), change={"load": load}, unexplained=True) for name, load in loads.items()
    }


def sensor_cases() -> dict[str, Case]:
    """Faults made when the logs are written."""
    scale = dict.fromkeys("xyz", 1.04)
    late = ("mocap_delay",)  # as a whole it equals the offset of two clocks, which import takes off
    bias = (0.4, -0.3, 0.3)
    return {
        "gyro x 1.04": Case(("gyro_scale",), value=scale, sensors={"gyro_scale": 1.04}),
        "capture 8 ms late": Case(late, sensors={"capture_delay": 0.012}, may_miss=True),
        "attitude 8 ms late": Case(late, value={"delay": 0.008}, sensors={"attitude_delay": 0.008}),
        "accelerometer bias": Case(("accelerometer_bias",), value={"x": bias[0], "y": -bias[1], "z": -bias[2]},
                                   sensors={"accelerometer_bias": bias}),
        "markers 10 mm ahead": Case(("marker_offset",), value={"x": 0.01}, sensors={"markers": (0.01, 0.0, 0.03)}),
    }  # fmt: skip


def mujoco_cases() -> dict[str, Case]:
    """One value of MuJoCo's compiled model each, and faults of sensors."""
    from foreign_mujoco import INERTIA, MASS

    def multiplied(field: str, factor: float) -> dict[str, Any]:
        def change(model: Any) -> None:
            setattr(model, field, getattr(model, field) * factor)

        return {"change": change}

    def blowing(model: Any) -> None:
        model.opt.wind[:] = (2.4, 1.8, 0.0)

    def dense(model: Any) -> None:
        model.opt.density *= 3.0

    return {
        "clean": Case(may_miss=True),
        "mass x 1.08": Case(("mass",), value={"mass": 1.08 * MASS}, change=multiplied("body_mass", 1.08)),
        "inertia x 1.2": Case(("inertia",), value=dict(zip(("Ixx", "Iyy", "Izz"), 1.2 * np.array(INERTIA))),
                              change=multiplied("body_inertia", 1.2)),
        # the frame's sensors stay, so the IMU and the markers are away from the cg as well
        "cg moved": Case(("cg_offset",), ("imu_lever_arm", "marker_offset"), {"x": 0.006, "y": 0.004},
                         {"cg": (0.006, -0.004, 0.0)}),
        "wind 3 m/s": Case(("wind",), value={"north": 2.4, "east": -1.8}, change={"change": blowing}),
        "density x 3": Case(("body_drag",), ("translational_lift",), change={"change": dense}),
        **sensor_cases(),
    }  # fmt: skip


def pyflyt_cases() -> dict[str, Case]:
    """One value of PyFlyt's drone each, and faults of sensors."""
    from foreign_pyflyt import DRAG, INERTIA, MASS

    shift = (0.0015, -0.001, 0.0)

    def heavier(mass: float, inertia: float) -> dict[str, Any]:
        def change(drone: Any) -> None:
            moments = [inertia * value for value in INERTIA]
            drone.p.changeDynamics(drone.Id, -1, mass=mass * MASS, localInertiaDiagonal=moments)

        return {"change": change}

    def multiplied(part: str, **factors: Any) -> dict[str, Any]:
        def change(drone: Any) -> None:
            for key, factor in factors.items():
                held = getattr(drone, part)
                setattr(held, key, (getattr(held, key).T * factor).T)

        return {"change": change}

    cases = {
        "clean": Case(may_miss=True),
        "mass x 1.08": Case(("mass",), value={"mass": 1.08 * MASS}, change=heavier(1.08, 1.0)),
        "inertia x 1.2": Case(("inertia",), value=dict(zip(("Ixx", "Iyy", "Izz"), 1.2 * np.array(INERTIA))),
                              change=heavier(1.0, 1.2)),
        "rotor 3 x 0.93": Case(("rotor_effectiveness",), value={"rotor3": 0.93},
                               change=multiplied("motors", thrust_coef=np.array([1.0, 1.0, 0.93, 1.0]))),
        "thrust x 0.95": Case(("thrust_factor",), value={"factor": 0.95},
                              change=multiplied("motors", thrust_coef=0.95)),
        "torque x 1.2": Case(("torque_factor",), value={"factor": 1.2}, change=multiplied("motors", torque_coef=1.2)),
        # the frame keeps its rotors, sensors and markers
        "cg moved": Case(
            ("cg_offset",), ("imu_lever_arm", "marker_offset"), {"x": shift[0], "y": -shift[1]}, {"shift": shift},
            {"imu": (-shift[0], -shift[1], 0.0), "markers": (-shift[0], -shift[1], 0.03)},
        ),
        "body drag x 6": Case(("body_drag",), value={"c": 5 * DRAG}, change=multiplied("body", drag_consts=6.0)),
        "wind 3 m/s": Case(("wind",), value={"north": 2.4, "east": -1.8}, change={"wind": (2.4, 1.8, 0.0)}),
        "motor lag x 2": Case(("motor_lag",), change=multiplied("motors", tau=2.0)),
        "rotor 2 x 0.92, its torque too": Case(
            ("rotor_effectiveness",), value={"rotor2": 0.92, "torque2": 0.92},
            change=multiplied("motors", **dict.fromkeys(("thrust_coef", "torque_coef"), np.array([1, 0.92, 1, 1]))),
        ),
        "thrust fades": Case(("thrust_drift",), value={"rate": -0.002}, change={"fading": 0.002}),
        **unlisted_cases(0.1),
        **sensor_cases(),
    }  # fmt: skip
    pairs = (("mass x 1.08", "wind 3 m/s"), ("rotor 3 x 0.93", "body drag x 6"), ("torque x 1.2", "rotor 3 x 0.93"))
    return cases | {f"{a} and {b}": together(cases[a], cases[b]) for a, b in pairs}


def jsbsim_cases() -> dict[str, Case]:
    """One value of JSBSim's aircraft, motors, propellers or air each, and faults of sensors."""
    from foreign_jsbsim import ALL, DRAG, INERTIA, MASS, resisting, scaled, shifted

    shift = (0.006, -0.004, 0.0)

    def inertia(documents: Any) -> None:
        for what in ("ixx", "iyy", "izz"):
            scaled(what, 1.2)(documents)

    def all_of_rotor_2(documents: Any) -> None:
        for what in ("C_THRUST", "C_POWER"):
            scaled(what, 0.92, (2,))(documents)

    turbulence = {"atmosphere/turb-type": 3, "atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps": 15.0,
                  "atmosphere/turbulence/milspec/severity": 3}  # fmt: skip
    # 25 K: all that air does, in proportion
    warm = {"properties": {"atmosphere/delta-T": 45.0}}
    cases = {
        "clean": Case(may_miss=True),
        "mass x 1.08": Case(("mass",), value={"mass": 1.08 * MASS}, change={"change": scaled("emptywt", 1.08)}),
        "inertia x 1.2": Case(("inertia",), value=dict(zip(("Ixx", "Iyy", "Izz"), 1.2 * np.array(INERTIA))),
                              change={"change": inertia}),
        "rotor 3 x 0.93": Case(("rotor_effectiveness",), value={"rotor3": 0.93},
                               change={"change": scaled("C_THRUST", 0.93, (3,))}),
        "thrust x 0.95": Case(("thrust_factor",), value={"factor": 0.95},
                              change={"change": scaled("C_THRUST", 0.95, ALL)}),
        "torque x 1.2": Case(("torque_factor",), value={"factor": 1.2}, change={"change": scaled("C_POWER", 1.2, ALL)}),
        # the frame keeps its rotors, sensors and markers
        "cg moved": Case(
            ("cg_offset",), ("imu_lever_arm", "marker_offset"), {"x": shift[0], "y": -shift[1]},
            {"change": shifted(shift)}, {"imu": (-shift[0], -shift[1], 0.0), "markers": (-shift[0], -shift[1], 0.03)},
        ),
        "body drag x 6": Case(("body_drag",), value={"c": 5 * DRAG}, change={"change": resisting(6.0)}),
        "wind 6 m/s": Case(("wind",), value={"north": 4.8, "east": -3.6}, change={"wind": (4.8, 3.6, 0.0)}),
        "rotor 2 x 0.92, its torque too": Case(("rotor_effectiveness",), value={"rotor2": 0.92, "torque2": 0.92},
                                               change={"change": all_of_rotor_2}),
        # a heavier propeller: a slower drive, and more reaction of its acceleration
        "propellers' inertia x 1.4": Case(("motor_lag",), ("rotor_acceleration_torque", "rotor_gyroscopic"),
                                        change={"change": scaled("ixx", 1.4, ALL)}),
        "air warmer by 25 K": Case(("thrust_factor",), ("torque_factor", "axial_inflow", "body_drag"),
                                   {"factor": 0.92}, warm),
        # of the catalogue's causes none: measured speeds hold, and a weaker motor is a finding
        "volts x 0.93": Case(may_miss=True, change={"change": scaled("maxvolts", 0.93, ALL)}),
        "resistance of motor 2 x 1.5": Case(("motor_lag",), may_miss=True,
                                            change={"change": scaled("coilresistance", 1.5, (2,))}),
        # drag with the square of airspeed is steeper in gusts
        "turbulence": Case(also=("body_drag", "rotor_drag"), may_miss=True, unexplained=True,
                           change={"properties": turbulence}),
        **unlisted_cases(2.0),
        **sensor_cases(),
    }  # fmt: skip
    pairs = (("mass x 1.08", "wind 6 m/s"), ("rotor 3 x 0.93", "body drag x 6"), ("torque x 1.2", "rotor 3 x 0.93"))
    return cases | {f"{a} and {b}": together(cases[a], cases[b]) for a, b in pairs}


SIMULATORS = {
    "rotorpy": rotorpy_cases, "mujoco": mujoco_cases, "pyflyt": pyflyt_cases, "jsbsim": jsbsim_cases,
    **{name: partial(other_cases, name) for name in VEHICLES},
    **{name: partial(drone_models_cases, name) for name in foreign_drone_models.VEHICLES},
}  # fmt: skip


def vehicle_of(simulator: str) -> Any:
    """How a simulator flies: a module, or what `foreign_vehicles` and `foreign_drone_models` make of their vehicles."""
    if simulator in foreign_drone_models.VEHICLES:
        return foreign_drone_models.of(simulator)
    return of(simulator) if simulator in VEHICLES else importlib.import_module(f"foreign_{simulator}")
