"""What differs from flight to flight without anybody's doing, and the air's unrest; all from the flight's seed."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from quasi import attitude
from quasi_synthesis.sensors import CaptureErrors, Inertial, Telemetry
from quasi_synthesis.vehicle import POLES, Vehicle, base_vehicle

# standard deviations (or ranges) at scale 1
SPREAD = {
    "mass": 0.01,
    "thrust factor": 0.01,
    "motor constants": 0.05,
    "gyro bias": 0.012,
    "accelerometer bias": 0.08,
    "IMU seating": math.radians(0.2),
    "marker pose": math.radians(0.3),
    "gust": (0.1, 0.4),
    "clock": 25e-6,
    "battery charge": 0.01,
    "telemetry age": (0.001, 0.003),
}


class Setup(NamedTuple):
    """Everything that makes one flight: the true vehicle, its sensors' errors, the air, the clocks."""

    vehicle: Vehicle
    inertial: Inertial
    telemetry: Telemetry
    capture: CaptureErrors
    gust: float  # m/s, standard deviation of each component
    clock_rate: float  # on-board clock fast by this share
    boot: float  # s, on-board clock when the log begins
    jitter: float  # s, of the on-board time stamps
    log_gaps: int  # spans the recorder lost
    firmware: str = "4.5.1"  # Betaflight's version


class Session(NamedTuple):
    """What the flights of one session share: spreads as shares of thrust, and the session's own random numbers."""

    between: float
    within: float
    rng: np.random.Generator


def nominal(capture_rate: float, noise: float) -> Setup:
    """The set-up without variation; noise 0 switches all random errors of sensors off, 1 is usual."""
    vehicle = base_vehicle()
    inertial = Inertial(
        gyro_noise=math.radians(0.008) * math.sqrt(2000.0) * noise,
        acc_noise=180e-6 * attitude.GRAVITY * math.sqrt(2000.0) * noise,
        gyro_vibration=math.radians(1.5) * noise,
        acc_vibration=1.2 * noise,
    )
    to_log = 60.0 / (2.0 * math.pi) * POLES / 2.0 / 100.0
    telemetry = Telemetry(age=0.002, interval=4, scale=1.0, to_log=to_log, faults=np.zeros((0, 4), np.int8))
    capture = CaptureErrors(
        rate=capture_rate,
        position_noise=2e-4 * noise,
        attitude_noise=math.radians(0.07) * noise,
        drop_outs=round(8 * noise),
        swaps=round(3 * noise),
    )
    return Setup(vehicle, inertial, telemetry, capture, 0.0, 0.0, 0.0, 2e-6 * noise, 0)


def vary(
    setup: Setup, scale: float, rng: np.random.Generator, session: Session | None = None
) -> tuple[Setup, dict[str, object]]:
    """Draw one flight's variation at `scale` (0 none, 1 usual); returns the set-up and what was drawn.

    With a session each rotor's thrust differs by the session's part and the flight's own; mass differs by the flight's
    part; biases have the usual spread between sessions and the ratio within / between of it from flight to flight.
    All draws are made at every scale, so that a seed's flights differ in size alone. Clock offsets are drawn always.
    """
    unit = rng.standard_normal
    physics, drive = setup.vehicle.physics, setup.vehicle.drive
    low, high = SPREAD["gust"]
    early, late = SPREAD["telemetry age"]
    drawn: dict[str, object] = {
        "mass": 1.0 + scale * SPREAD["mass"] * float(np.clip(unit(), -2, 2)),
        "thrust factor": 1.0 + scale * SPREAD["thrust factor"] * float(np.clip(unit(), -2, 2)),
        "motor constants": (1.0 + scale * SPREAD["motor constants"] * np.clip(unit(2), -2, 2)).tolist(),
        "gyro bias": (scale * SPREAD["gyro bias"] * unit(3)).tolist(),
        "accelerometer bias": (scale * SPREAD["accelerometer bias"] * unit(3)).tolist(),
        "IMU seating": (scale * SPREAD["IMU seating"] * unit(3)).tolist(),
        "marker pose": (scale * SPREAD["marker pose"] * unit(3)).tolist(),
        "gust": scale * float(rng.uniform(low, high)),
        "on-board clock": scale * SPREAD["clock"] * float(unit()),
        "capture clock": scale * SPREAD["clock"] * float(unit()),
        "battery charge": 1.0 + scale * SPREAD["battery charge"] * float(unit()),
        "telemetry age": max(0.5 * (early + late) + scale * float(rng.uniform(-0.5, 0.5)) * (late - early), 0.0),
        "boot": float(rng.uniform(15.0, 90.0)),
        "capture start": -float(rng.uniform(0.8, 2.8)),
    }
    if session is not None:
        drawn |= _in_session(drawn, scale, session, rng)
    up, down = drawn["motor constants"]
    physics = physics._replace(
        mass=physics.mass * drawn["mass"],
        thrust_gain=physics.thrust_gain * drawn["thrust factor"] * np.array(drawn.get("rotor thrust", 1.0)),
        lag_up=physics.lag_up * up,
        lag_down=physics.lag_down * down,
    )
    drive = drive._replace(charge=min(drive.charge * drawn["battery charge"], drive.capacity))
    inertial = setup.inertial._replace(
        axes=np.array(attitude.matrix(attitude.exponential(np.array(drawn["IMU seating"])))),
        gyro_bias=np.array(drawn["gyro bias"]),
        acc_bias=np.array(drawn["accelerometer bias"]),
    )
    capture = setup.capture._replace(
        start=drawn["capture start"], skew=drawn["capture clock"], body_turn=np.array(drawn["marker pose"])
    )
    return (
        setup._replace(
            vehicle=setup.vehicle._replace(physics=physics, drive=drive),
            inertial=inertial,
            telemetry=setup.telemetry._replace(age=drawn["telemetry age"]),
            capture=capture,
            gust=drawn["gust"],
            clock_rate=drawn["on-board clock"],
            boot=drawn["boot"],
        ),
        drawn,
    )


def _in_session(
    drawn: Mapping[str, object], scale: float, session: Session, rng: np.random.Generator
) -> dict[str, object]:
    """What the usual draws become within a session, and each rotor's thrust ("rotor thrust", times the healthy)."""
    shared, own = session.rng.standard_normal, np.clip(rng.standard_normal(4), -2, 2)
    rotors = 1.0 + scale * (session.between * np.clip(shared(4), -2, 2) + session.within * own)
    ratio = session.within / session.between if session.between > 0.0 else 1.0
    biases = {
        name: (scale * SPREAD[name] * shared(3) + ratio * np.array(drawn[name])).tolist()
        for name in ("gyro bias", "accelerometer bias")
    }
    mass = 1.0 + (drawn["mass"] - 1.0) * session.within / SPREAD["mass"]
    return {"mass": mass, "thrust factor": 1.0, "rotor thrust": rotors.tolist(), **biases}


def air(seconds: float, rate: float, gust: float, rng: np.random.Generator) -> np.ndarray:
    """Air table (n, 7): gust north, east, down in m/s and four unit buffets of the vortex ring.

    Gusts are of first order, as Dryden's along the flow: correlation time 0.9 s, in the vertical shorter and weaker.
    Buffets are of first order with 12 ms. Source: MIL-F-8785C, section 3.7.2.
    """
    n = math.ceil(seconds * rate) + 2
    table = np.empty((n, 7))
    for k, (time, size) in enumerate([(0.9, 1.0), (0.9, 1.0), (0.5, 0.6), *[(0.012, 1.0)] * 4]):
        keep = math.exp(-1.0 / (rate * time))
        start = rng.standard_normal()
        drive = math.sqrt(1.0 - keep * keep) * rng.standard_normal(n)
        drive[0] = start
        table[:, k] = size * lfilter([1.0], [1.0, -keep], drive)
    table[:, :3] *= gust
    return table
