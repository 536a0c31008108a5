"""Campaigns of synthetic flights: from a seed to raw logs in the real formats, with their truth."""

import csv
import io
import json
import math
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi import attitude
from quasi.errors import ConfigError, nearest
from quasi.tables import write_bytes, write_table, write_text
from quasi_synthesis import vehicle as made
from quasi_synthesis.conditions import CONDITION_KEYS as CONDITIONS
from quasi_synthesis.conditions import apply_conditions, packet_faults, read_conditions
from quasi_synthesis.controller import control_of
from quasi_synthesis.effects import check, plant
from quasi_synthesis.flight import AIR_RATE, LOGGED_SIGNALS, LOOP, TRUTH, fly
from quasi_synthesis.motive_writer import motive_csv
from quasi_synthesis.nuisance import Session, Setup, air, nominal, vary
from quasi_synthesis.pilot import OFF_TIME, PROFILES, REST_BEFORE, pilot
from quasi_synthesis.recorder import record
from quasi_synthesis.sensors import Capture, capture

CAMPAIGN_NAME = re.compile(r"[A-Za-z0-9_+-][A-Za-z0-9._+-]*")
BODY = "MadeBeetle"
FLIGHT_DATE = "2026-03-14"


class Flight(NamedTuple):
    """One flight of a campaign: its key, its piloting, its own seed and effects (the campaign's included)."""

    key: str
    profile: str
    seed: int
    effects: dict[str, dict[str, float | None]]
    duration: float
    nuisance: float
    noise: float
    session: str = ""


class Campaign(NamedTuple):
    """A checked campaign."""

    name: str
    quadrotor: str
    seed: int
    log_rate: int
    capture_rate: float
    flights: tuple[Flight, ...]
    conditions: dict[str, Any]


class Made(NamedTuple):
    """One made flight: raw files as bytes and text, the truth, and how it was made."""

    onboard: bytes
    capture: str
    truth: pd.DataFrame
    metadata: dict[str, Any]


# key: (default, check, what is expected)
CAMPAIGN_KEYS: dict[str, tuple[Any, Any, str]] = {
    "quadrotor": ("MadeBeetle", lambda v: isinstance(v, str) and CAMPAIGN_NAME.fullmatch(v), "a name"),
    "seed": (1, lambda v: isinstance(v, int) and not isinstance(v, bool) and v >= 0, "a whole number from 0"),
    "flights": (None, lambda v: isinstance(v, list) and v, "a list of flights"),
    "duration": (90.0, lambda v: _number(v, 5.0, 1200.0), "seconds from 5 to 1200"),
    "nuisance": (1.0, lambda v: _number(v, 0.0, 5.0), "a scale from 0 to 5"),
    "noise": (1.0, lambda v: _number(v, 0.0, 10.0), "a scale from 0 to 10"),
    "log rate": (1000, lambda v: v in (4000, 2000, 1000, 500, 250), "4000, 2000, 1000, 500 or 250 Hz"),
    "capture rate": (120.0, lambda v: _number(v, 30.0, 360.0), "Hz from 30 to 360"),
    "effects": ({}, lambda v: isinstance(v, Mapping), "effects by id"),
}
FLIGHT_KEYS = ("key", "profile", "seed", "effects", "duration", "nuisance", "noise", "session")


def _number(value: Any, low: float, high: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high


def _valid(name: str, value: Any, where: str) -> Any:
    if not CAMPAIGN_KEYS[name][1](value):
        raise ConfigError(f"{where}: '{name}' is {value!r}, expected {CAMPAIGN_KEYS[name][2]}; correct it")
    return value


def read_campaign(config: Mapping[str, Any], name: str = "campaign") -> Campaign:
    """Check a campaign.

    config  {"quadrotor", "seed", "flights": [{"key", "profile", "effects", ...}], "duration" s, "nuisance" and "noise"
    scales, "log rate" and "capture rate" Hz, "effects"}; a flight may replace seed, duration, nuisance and noise, and
    adds its effects to the campaign's (its own parameters win). A flight's seed follows from campaign seed and key
    unless given, so that adding or moving flights changes no other. Further keys state the conditions, see
    `quasi_synthesis.conditions`; a flight's "session" names the flights that share their session's part of them.
    Raises ConfigError naming the campaign, flight and key, with the nearest known one.
    """
    where = f"campaign '{name}'"
    for key in config:
        if key not in (*CAMPAIGN_KEYS, *CONDITIONS):
            raise ConfigError(f"{where} has an unknown key '{key}'{nearest(key, (*CAMPAIGN_KEYS, *CONDITIONS))}")
    whole = {k: _valid(k, config.get(k, default), where) for k, (default, _, _) in CAMPAIGN_KEYS.items()}
    flights, seen = [], set()
    for i, row in enumerate(whole["flights"]):
        here = f"{where}, flight {i + 1}"
        if not isinstance(row, Mapping) or "key" not in row:
            raise ConfigError(f'{here} is {row!r}, expected at least a \'key\' such as {{"key": "{name}-{i + 1:02d}"}}')
        for key in row:
            if key not in FLIGHT_KEYS:
                raise ConfigError(f"{here} has an unknown key '{key}'{nearest(key, FLIGHT_KEYS)}")
        flight_key, profile = row["key"], row.get("profile", "mixed")
        if not isinstance(flight_key, str) or not CAMPAIGN_NAME.fullmatch(flight_key):
            raise ConfigError(
                f"{here}: 'key' is {flight_key!r}, expected letters, digits and . _ + -, not beginning with a dot"
            )
        if flight_key in seen:
            raise ConfigError(f"{here}: the key '{flight_key}' is taken by an earlier flight; give each its own")
        seen.add(flight_key)
        if profile not in PROFILES:
            raise ConfigError(f"{here}: profile '{profile}' is unknown{nearest(profile, PROFILES)}")
        own = row.get("effects", {})
        _valid("effects", own, here)
        both = {k: dict(v) if isinstance(v, Mapping) else v for k, v in whole["effects"].items()}
        for effect, values in own.items():
            merge = isinstance(values, Mapping) and isinstance(both.get(effect), Mapping)
            both[effect] = {**both[effect], **values} if merge else values
        seed = row.get("seed", (whole["seed"] * 1_000_003 + zlib.crc32(flight_key.encode())) % 2**32)
        numbers = [float(_valid(k, row.get(k, whole[k]), here)) for k in ("duration", "nuisance", "noise")]
        session = row.get("session", "")
        if not isinstance(session, str) or (session and not CAMPAIGN_NAME.fullmatch(session)):
            raise ConfigError(f"{here}: 'session' is {session!r}, expected a name of letters and digits; correct it")
        flights.append(Flight(flight_key, profile, _valid("seed", seed, here), check(both, here), *numbers, session))
    conditions = read_conditions(config, where)
    rates = int(whole["log rate"]), float(whole["capture rate"])
    return Campaign(name, whole["quadrotor"], whole["seed"], *rates, tuple(flights), conditions)


def flight_of(campaign: Campaign, key: str) -> Flight:
    """The flight of that key. Raises ConfigError with the nearest key."""
    for flight in campaign.flights:
        if flight.key == key:
            return flight
    raise ConfigError(
        f"campaign '{campaign.name}' has no flight '{key}'{nearest(key, [f.key for f in campaign.flights])}"
    )


class _Flown(NamedTuple):
    setup: Setup
    drawn: dict[str, object]
    truth: np.ndarray
    log: np.ndarray
    take: Capture
    onboard: bytes
    found: dict[str, Any]


def _fly(campaign: Campaign, flight: Flight) -> _Flown:
    """Everything random and compiled of one flight; see `make_flight`."""
    # one stream of random numbers for each purpose, so that one argument changes nothing but its own part
    purposes = ("vary", "pilot", "air", "noise", "capture", "log", "modes", "telemetry")
    streams = dict(zip(purposes, np.random.default_rng(flight.seed).spawn(len(purposes))))
    conditions = campaign.conditions
    setup = apply_conditions(nominal(campaign.capture_rate, flight.noise), conditions)
    setup, drawn = vary(setup, flight.nuisance, streams["vary"], _session_of(campaign, flight))
    setup = plant(setup, flight.effects)
    table = pilot(flight.profile, flight.duration, streams["pilot"], conditions.get("fixed heading", False))
    steps, every = int(flight.duration * LOOP), int(LOOP) // campaign.log_rate
    modes = np.zeros((steps, 3))
    if setup.inertial.mode_frequency.any():
        modes = streams["modes"].standard_normal((steps, 3))
    telemetry = setup.telemetry
    if "telemetry" in conditions:
        reports = steps // telemetry.interval + 1
        faults = packet_faults(reports, conditions["telemetry"], streams["telemetry"])
        telemetry = telemetry._replace(faults=faults)
    truth = np.empty((-(-steps // every), len(TRUTH)))
    log = np.empty((len(truth), len(LOGGED_SIGNALS)))
    _, tilt = fly(
        steps,
        every,
        table,
        air(flight.duration, AIR_RATE, setup.gust, streams["air"]),
        np.hstack([streams["noise"].standard_normal((steps, 6)), modes]),
        setup.vehicle.physics,
        setup.vehicle.drive,
        control_of(made.base_vehicle()),
        setup.inertial,
        telemetry,
        truth,
        log,
    )
    take = capture(truth[:, 0], truth[:, 1:4], truth[:, 7:11], setup.capture, streams["capture"])
    onboard, lost = record(log, truth[:, 0], campaign.quadrotor, campaign.log_rate, setup, streams["log"])
    return _Flown(setup, drawn, truth, log, take, onboard, {"lost spans": lost, "largest tilt": float(tilt)})


def _session_of(campaign: Campaign, flight: Flight) -> Session | None:
    """The session of a flight, whose numbers follow from the campaign's seed and the session's name."""
    spread = campaign.conditions.get("sessions")
    if spread is None:
        return None
    seed = [campaign.seed, zlib.crc32(flight.session.encode())]
    return Session(spread["between"], spread["within"], np.random.default_rng(seed))


def make_flight(campaign: Campaign, flight: Flight) -> Made:
    """Fly one flight and write down what sensors and systems would have recorded. Deterministic in the flight's seed.

    The truth's columns are those of a filtered flight where both have them (F = specific force x mass, M the total
    moment about the true cg), on the on-board clock; its metadata holds the true parameters.
    """
    flown = _fly(campaign, flight)
    metadata = {**_metadata(campaign, flight, flown.setup, flown.drawn, flown.take), **flown.found}
    metadata["verdict"] = "flown" if flown.found["largest tilt"] < math.radians(85.0) else "tumbled"
    started = f"{FLIGHT_DATE} {9 + zlib.crc32(flight.key.encode()) % 3:02d}.21.33.412 AM"
    text = motive_csv(flown.take, BODY, flight.key, started)
    return Made(flown.onboard, text, _truth(flown.truth, flown.setup), metadata)


def write_flight(made_flight: Made, onboard: str | Path, capture_path: str | Path, truth: str | Path) -> None:
    """Write the raw files and the truth; the folders are made."""
    write_bytes(onboard, made_flight.onboard)
    write_text(capture_path, made_flight.capture)
    write_table(truth, made_flight.truth, units=TRUTH_UNITS, made=made_flight.metadata)


def raw_paths(campaign: Campaign, key: str) -> dict[str, str]:
    """Where a flight's raw files and truth lie, relative to the project's folder."""
    root = f"results/synthesis/{campaign.name}"
    return {
        "onboard": f"{root}/onboard/{key}.bbl",
        "capture": f"{root}/optitrack/{key}.csv",
        "truth": f"{root}/truth/{key}.parquet",
    }


TRUTH_UNITS: dict[str, tuple[str, str, str]] = {
    **{f"q{c}": ("1", "body to earth", f"attitude quaternion, {c}") for c in "wxyz"},
    **{f"thrust{i}": ("N", "", f"rotor {i}, thrust") for i in range(1, 5)},
    **{f"torque{i}": ("N m", "", f"rotor {i}, shaft torque") for i in range(1, 5)},
    **{f"v_in{i}": ("m/s", "", f"rotor {i}, induced velocity") for i in range(1, 5)},
    **{f"gust_{d}": ("m/s", "earth NED", f"gust towards {d}") for d in ("north", "east", "down")},
}


def _truth(rows: np.ndarray, setup: Setup) -> pd.DataFrame:
    """The true quantities on the on-board clock, s since the log's first frame."""
    frame = pd.DataFrame(rows, columns=list(TRUTH))
    quaternion = attitude.continuous(frame[["qw", "qx", "qy", "qz"]].to_numpy())
    frame[["qw", "qx", "qy", "qz"]] = quaternion
    earth = frame[["vx", "vy", "vz"]].to_numpy()
    p = setup.vehicle.physics
    frame[["roll", "pitch", "yaw"]] = attitude.to_euler(quaternion)
    frame["yaw"] = np.unwrap(frame["yaw"])
    frame[["u", "v", "w"]] = attitude.rotate_inverse(quaternion, earth)
    gust = frame[["gust_north", "gust_east", "gust_down"]].to_numpy()
    frame[["u_air", "v_air", "w_air"]] = attitude.rotate_inverse(quaternion, earth - gust - p.wind)
    frame[["ax", "ay", "az"]] = frame[["Fx", "Fy", "Fz"]] / p.mass
    frame["t"] *= 1.0 + setup.clock_rate
    return frame


def _metadata(
    campaign: Campaign, flight: Flight, setup: Setup, drawn: dict[str, object], take: Capture
) -> dict[str, Any]:
    """What is true of the flight, as plain data."""
    p, d, s = setup.vehicle.physics, setup.vehicle.drive, setup.inertial
    hover = made.hover_factors(p, float(np.mean(p.thrust_gain)))
    rate = 1.0 + setup.clock_rate
    return {
        "schema": "quasi.truth/1",
        "campaign": campaign.name,
        "flight": flight._asdict(),
        "effects": flight.effects,
        "conditions": campaign.conditions,
        "session": flight.session,
        "nuisance": drawn,
        "physics": p._asdict(),
        "drive": d._asdict(),
        "cg offset": setup.vehicle.cg_offset,
        "hover factors": {
            **hover,
            "thrust unit": "N s2",
            "torque unit": "N m s2",
        },
        "inertial": {**s._asdict(), "axes": s.axes},
        "telemetry": {k: v for k, v in setup.telemetry._asdict().items() if k != "faults"},
        "capture": {**setup.capture._asdict(), "faults": take.faults},
        # a moment that the log puts at t (s since its first frame) the capture puts at offset + rate t
        "clock": {
            "capture offset": -setup.capture.start * (1.0 + setup.capture.skew),
            "capture rate": (1.0 + setup.capture.skew) / rate,
            "on-board rate": setup.clock_rate,
            "boot": setup.boot,
        },
        "gust": setup.gust,
        "rest": {"rotors off until": OFF_TIME, "idle until": REST_BEFORE},
        "frames": "earth NED, body FRD, SI; F = specific force x mass at the cg; t on the on-board clock",
    }


def logbook(campaign: Campaign, data: str = "data") -> list[dict[str, str]]:
    """The campaign's flights as rows of the manual's Table 1; `data` is the folder of the quadrotor configuration."""
    p = made.base_vehicle().physics
    rows = []
    for number, flight in enumerate(campaign.flights, start=1):
        paths = {k: Path(v) for k, v in raw_paths(campaign, flight.key).items()}
        rows.append(
            {
                "Flight ID": str(number),
                "Rigid Body Name": BODY,
                "Quadrotor": campaign.quadrotor,
                "Has OT data": "Y",
                "OptiTrack time offset (s)": "",
                "Raw OptiTrack Name": paths["capture"].stem,
                "Raw OT Path": paths["capture"].parent.as_posix(),
                "Onboard Name": paths["onboard"].stem,
                "OB Path": paths["onboard"].parent.as_posix(),
                "OB row skip": "",
                "OB num columns": "",
                "Has OJF data": "N",
                "OJF path": "",
                "OJF name": "",
                "Static wind (m/s)": "",
                "Indoor or Outdoor": "Indoor",
                "Flight controller": "betaflight",
                "Batteries": "4S",
                "Mode": "LOS",
                "Mass": f"{1000.0 * p.mass:g}",
                "Drone Config File": f"{campaign.quadrotor}Config",
                "Drone Config Path": data,
                "Video": "",
                "Video Path": "",
                "Comments": f"made flight, profile {flight.profile}",
            }
        )
        if any(f.session for f in campaign.flights):
            rows[-1]["Session"] = flight.session
    return rows


def logbook_csv(campaign: Campaign, data: str = "data") -> str:
    """The logbook as the text of a CSV file."""
    out = io.StringIO()
    rows = logbook(campaign, data)
    writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def quadrotor_configuration(campaign: Campaign) -> dict[str, Any]:
    """The quadrotor configuration (the manual's listing 1, and "motor poles") as its lab would write it.

    The noise statistics are what a rest log of 20 s with idling rotors gives, never finer than the log's own steps.
    """
    p = made.base_vehicle().physics
    inertia = "; ".join(", ".join(f"{x:g}" for x in row) for row in p.inertia)
    return {
        "rotor config": dict(made.ROTOR_CONFIG),
        "rotor1 rotation direction": made.ROTOR_1,
        "rotor radius": f"{made.RADIUS:g}",
        "b": f"{made.ARM:g}",
        "rotor hub height": f"{made.HUB_HEIGHT:g}",
        "optitrack marker cg offset": {k: f"{v:g}" for k, v in zip("xyz", made.MARKER_OFFSET)},
        "idle RPM": "250",
        "max RPM": "2500",
        "motor poles": str(made.POLES),
        "moment of inertia": f"[{inertia}]",
        "betaflight raw acceleration correction factor": "2048",
        "flight controller": "betaflight",
        "mass": f"{p.mass:g}",
        "(estimated) imu sensor noise statistics": _rest_noise(campaign),
    }


def _rest_noise(campaign: Campaign) -> dict[str, dict[str, str]]:
    noise = campaign.flights[0].noise
    rest = Flight("rest", "rest", campaign.seed, {}, 20.0, 0.0, noise)
    flown = _fly(campaign, rest)
    log, take = flown.log, flown.take
    idle = flown.truth[:, 0] > OFF_TIME + 1.0
    degree, count = math.radians(1.0), attitude.GRAVITY / 2048.0
    angles = attitude.to_euler(take.quaternion[np.isfinite(take.error)])
    angles = angles[np.all(np.abs(angles - np.median(angles, axis=0)) < 0.02, axis=1)]  # without marker swaps
    columns = {
        **{
            a: (degree * np.rint(log[idle, LOGGED_SIGNALS.index(f"gyro{k}")] / degree), degree)
            for k, a in enumerate("pqr")
        },
        **{
            f"a{a}": (count * np.rint(log[idle, LOGGED_SIGNALS.index(f"acc{k}")] / count), count)
            for k, a in enumerate("xyz")
        },
        **{a: (angles[:, k], 2e-4) for k, a in enumerate(("roll", "pitch", "yaw"))},
    }
    return {
        name: {"mean": "0", "std": f"{max(float(np.std(x)), step / math.sqrt(12.0)):.5g}"}
        for name, (x, step) in columns.items()
    }


def project_files(campaign: Campaign) -> dict[str, str]:
    """{path: text} of the files a user's folder needs for the campaign: logbook and quadrotor configuration."""
    configuration = json.dumps(quadrotor_configuration(campaign), indent=1)
    return {
        f"data/{campaign.name}_file_log.csv": logbook_csv(campaign),
        f"data/{campaign.quadrotor}Config.json": configuration + "\n",
    }
