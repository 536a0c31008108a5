"""What a flight's raw files hold, from reading them alone: nothing is synchronised, resampled or estimated.

The readers are those of the import: what they refuse is refused here in the same words. A flight's result is plain
data. It is remembered while its settings, its files and the code stay the same.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from quasi.errors import DataError, QuasiError, cautions
from quasi.importing.captured_sensors import Captured
from quasi.importing.onboard_log import (
    BODY_VELOCITY,
    POSITION_COLUMNS,
    VELOCITY_COLUMNS,
    read_onboard,
    require_motion,
)
from quasi.importing.readers.reader import Request
from quasi.importing.readers.registry import read_capture
from quasi.importing.reconstruction import Completed
from quasi.importing.same_samples import find_same_flights, sketches_of
from quasi.importing.series import Recording, Series
from quasi.importing.wind import read_lvm
from quasi.project.gaps import HELD
from quasi.running.checksums import read_identity
from quasi.sensor_limits import find_silent_rotors
from quasi.tables import read_json, write_json

Read = tuple[dict[str, Any], list[Series], list[str]]  # facts on a source, its series, the notes of its reader
INSPECTION_MEMORY = ".snakemake/quasi/inspected"  # results of inspections, in the project folder
SCHEMA = "quasi.inspection/2"
ROTORS = ("w1", "w2", "w3", "w4")
COMMANDS = tuple(f"command{i}" for i in range(1, 5))
ALL_STOPPED = "the speeds of all rotors are 0 throughout: bidirectional DShot is off"
QUATERNION = ("qw", "qx", "qy", "qz")
# what a flight may hold: name, and the groups of quantities of which one is enough
HOLDINGS = {
    "rotor speeds": (ROTORS,),
    "commands": (COMMANDS, tuple(f"{w}_CMD" for w in ROTORS)),
    "battery": (("battery_voltage",),),
    "attitude": (QUATERNION,),
    "position": (POSITION_COLUMNS,),
    "velocity": (VELOCITY_COLUMNS, BODY_VELOCITY),
}


def empty_result(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The result of inspect_flight before any file is read."""
    flight = settings["flight"]
    found: dict[str, Any] = {"schema": SCHEMA, "flight": flight["flight"], "quadrotor": flight["quadrotor"]}
    return (
        found
        | {"problem": settings["problem"], "onboard": None, "capture": None, "holds": {}}
        | {"remarks": list(flight.get("unread", ()))}
    )


def inspect_flight(settings: Mapping[str, Any]) -> dict[str, Any]:
    """What the raw files of one flight hold.

    settings  of its import: "flight" (paths, flight controller, rigid body, log number), "quadrotor", "problem"
    Returns   plain data: "flight", "problem" (a sentence or None), "onboard" and "capture" (format, rate in Hz,
              duration in s), "holds" {name of HOLDINGS: {"rate": Hz, "from": "onboard" or "capture"}}, "lacks" (names),
              "remarks" (sentences that call for care: what the readers doubt, and channels that hold nothing)
    """
    flight, found = settings["flight"], empty_result(settings)
    sources: dict[str, list[Series]] = {}
    for source, read in (("onboard", _read_onboard), ("capture", _read_capture), ("wind", _read_wind)):
        try:
            if read_now := read(flight, settings["quadrotor"]):
                found[source], sources[source], notes = read_now
                found["remarks"] += cautions(notes)
        except QuasiError as error:
            found["problem"] = found["problem"] or str(error)
    for name, groups in HOLDINGS.items():
        for source in ("capture", "onboard"):  # where both measure it, import takes the capture's
            rates = [r for g in groups for s in sources.get(source, ()) if (r := _rate_of(s, g)) is not None]
            rates += [r for g in groups if (r := _rate_apart(sources.get(source, ()), g)) is not None]
            if rates:
                found["holds"].setdefault(name, {"rate": max(rates), "from": source})
    stopped = _stopped_rotors(sources.get("onboard", []))
    if len(stopped) == len(ROTORS):
        found["holds"].pop("rotor speeds", None)
        stopped = [ALL_STOPPED]
    found["remarks"] += stopped
    found["silent rotors"] = find_silent_rotors(
        {n for s in sources.get("onboard", ()) for n in s.values if np.nan_to_num(s.values[n]).any()}
    )
    found["lacks"] = [name for name in HOLDINGS if name not in found["holds"]]
    return found


def _read_onboard(flight: Mapping[str, Any], quadrotor: Mapping[str, Any]) -> Read | None:
    if not flight.get("onboard"):
        return None
    recording = read_onboard(flight, quadrotor)
    notes = list(recording.notes)
    gyro = _motion(recording, flight, notes).gyro
    about = recording.metadata
    facts = {
        "file": str(flight["onboard"]),
        "format": about.get("format") or about.get("reader"),
        "firmware": (about.get("firmware") or {}).get("revision", ""),
        "log": about.get("log"),
        "logs": len(about["logs"]) if about.get("logs") else None,
        "samples": sketches_of(gyro, recording.series),
        **_sampling(gyro.t),
    }
    return facts, list(recording.series.values()), notes


def _motion(recording: Recording, flight: Mapping[str, Any], notes: list[str]) -> Completed:
    """The log's motion, by its capture where it needs one; the clocks are left as they are, which changes no rate."""
    try:
        return require_motion(recording, str(flight["flight"]), notes)
    except DataError:
        capture = recording.series.get("capture")
        if flight.get("capture"):
            capture = read_capture(Request.of_capture(flight)).series["capture"]
        if capture is None:
            raise
    in_log = not flight.get("capture")
    return require_motion(recording, str(flight["flight"]), notes, captured=Captured(capture, in_log))


def _read_capture(flight: Mapping[str, Any], quadrotor: Mapping[str, Any]) -> Read | None:
    if not flight.get("capture"):
        return None
    recording = read_capture(Request.of_capture(flight))
    series = recording.series["capture"]
    lost = float(np.mean(~np.isfinite(series.values["x"])))
    facts = {"file": str(flight["capture"]), "rigid body": recording.metadata["rigid body"], "lost share": lost}
    return facts | _sampling(series.t), [series], recording.notes


def _read_wind(flight: Mapping[str, Any], quadrotor: Mapping[str, Any]) -> Read | None:
    wind = flight.get("wind") or {}
    if not wind.get("file"):
        return None
    try:
        series = read_lvm(wind["file"]).series["wind"]
    except QuasiError:
        if wind.get("static") is None:
            raise
        return None  # import takes the static wind in place of a damaged record
    return {"file": str(wind["file"]), **_sampling(series.t)}, [series], []


def _sampling(t: np.ndarray) -> dict[str, float | None]:
    """Rate, Hz, and duration, s, of sample times t (n,) s."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    return {"rate": 1.0 / step if step > 0 else None, "duration": float(t[-1] - t[0]) if len(t) else 0.0}


def _rate_of(series: Series, names: Sequence[str]) -> float | None:
    """Mean rate, Hz, of the samples of a series that hold all the quantities; None where fewer than two do."""
    if not all(name in series.values for name in names):
        return None
    complete = np.isfinite(np.stack([series.values[name] for name in names])).all(axis=0)
    t = series.t[complete]
    return float((len(t) - 1) / (t[-1] - t[0])) if len(t) > 1 and t[-1] > t[0] else None


def _rate_apart(series: Iterable[Series], names: Sequence[str]) -> float | None:
    """Rate, Hz, of quantities that a log samples apart, such as rotors whose controllers report in turn: the lowest."""
    best = [max((r for s in series if (r := _rate_of(s, (name,))) is not None), default=None) for name in names]
    return None if None in best or names[0] not in ROTORS else min(best)


def _stopped_rotors(series: Iterable[Series]) -> list[str]:
    """A sentence for each rotor that is logged, but with speed 0 alone."""
    stopped = []
    for one in series:
        for name in ROTORS:
            values = one.values.get(name, np.zeros(0))
            if np.isfinite(values).any() and not np.nanmax(np.abs(values)) > 0:
                stopped.append(f"the speed of rotor {name[1:]} is 0 throughout")
    return stopped


def usable_for(found: Mapping[str, Any]) -> str:
    """What an inspected flight will be good for, in a few words."""
    if found["problem"]:
        return "nothing: broken"
    driven = {"rotor speeds", "commands"} & set(found["holds"])
    lacking = [] if driven else ["rotor speeds"]
    lacking += [] if _has_motion(found) else ["position or velocity"]
    if not lacking:
        estimated = "" if "rotor speeds" in driven else ", rotor speeds estimated from commands"
        return f"models and gaps{estimated}{', with care' if found['remarks'] else ''}"
    return f"its page only: no {' and no '.join(lacking)}"


def _has_motion(found: Mapping[str, Any]) -> bool:
    return "position" in found["holds"] or "velocity" in found["holds"]


def refusals(asked: Mapping[str, Any], inspected: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Sentences on why what is asked for cannot be made of its flights; [] where it can.

    asked      "name" for messages, "identifies" (whether forces and moments are identified or compared), "flights"
               {"quadrotor/flight": {"role", "problem"}}
    inspected  {"quadrotor/flight": result of inspect_flight}; of a gap also of asked["trained flights"], where known
    """
    flights = asked["flights"]
    sentences = [p for key in flights if (p := inspected[key]["problem"] or flights[key]["problem"])]
    if not asked["identifies"]:
        return list(dict.fromkeys(sentences))
    sound = [key for key in flights if not inspected[key]["problem"]]
    sentences += _same_flights(asked, inspected)
    if silent := [key for key in sound if not {"rotor speeds", "commands"} & set(inspected[key]["holds"])]:
        several = len(silent) > 1
        because = dict.fromkeys(r for key in silent for r in inspected[key]["remarks"] if r == ALL_STOPPED)
        because |= {
            f"{key.rpartition('/')[2]} logs no command of rotor {', '.join(map(str, rotors))}": None
            for key in silent
            if len(rotors := inspected[key].get("silent rotors") or []) in (1, 2, 3)
        }
        sentences.append(
            f"{asked['name']}: {'flights' if several else 'flight'} {_listed(silent)} hold{'' if several else 's'} no "
            "rotor speeds and no commands of all four rotors to estimate them from"
            f"{''.join(f' ({b})' for b in because)}; log either (docs/your-own-data.md, section 4), or leave "
            f"{'these flights' if several else 'this flight'} out"
        )
    learning = [key for key in flights if flights[key]["role"] in ("training", "compared")]
    if learning and all(key in sound and not _has_motion(inspected[key]) for key in learning):
        sentences.append(
            f"{asked['name']}: none of the flights {_listed(learning)} holds position or velocity, without which "
            "forces are not known well enough; add a motion capture ('Has OT data'), or flights whose log holds either"
        )
    return list(dict.fromkeys(sentences))


def _same_flights(asked: Mapping[str, Any], inspected: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Sentences on logs of one flight in files that differ: in two rows, or held out and in training of the model."""
    sketches = {key: about["onboard"]["samples"] for key, about in inspected.items() if about["onboard"]}
    own = [key for key in asked["flights"] if key in sketches]
    held = [key for key in own if asked["flights"][key]["role"] == HELD]
    trained = [key for key in asked.get("trained flights", ()) if key in sketches and key not in asked["flights"]]
    found = []
    for one, other in find_same_flights({key: sketches[key] for key in (*own, *(trained if held else ()))}):
        alike = f"{asked['name']}: the logs of {_listed([one])} and {_listed([other])} hold the same flight"
        if one in own and other in own:
            found.append(f"{alike}, although the files differ; each flight counts once and has one role: leave one out")
        elif one in held and other in trained:
            found.append(f"{alike}; the first is held out, and the second trained the model: hold out another flight")
    return found


def _listed(keys: Iterable[str]) -> str:
    return ", ".join(key.rpartition("/")[2] for key in keys)


class Inspector:
    """Inspects flights; remembers each result.

    memory  folder of what is remembered, which may vanish at any time; version  digest of the code in use
    """

    def __init__(self, memory: str | Path, version: str):
        self.memory, self.version = Path(memory), version

    def inspect(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """The result of inspect_flight, from memory where settings and files are those on record."""
        flight = settings["flight"]
        files = [flight.get("onboard"), flight.get("capture"), (flight.get("wind") or {}).get("file")]
        basis = [self.version, settings, [read_identity(path) if path else None for path in files]]
        key = hashlib.sha256(json.dumps(basis, sort_keys=True).encode()).hexdigest()
        place = self.memory / flight["quadrotor"] / f"{flight['flight']}.json"
        with suppress(QuasiError, OSError, KeyError, TypeError):
            if place.is_file() and (known := read_json(place))["key"] == key:
                return known["found"]
        found = inspect_flight(settings)
        with suppress(QuasiError, OSError):
            write_json(place, {"key": key, "found": found})
        return found
