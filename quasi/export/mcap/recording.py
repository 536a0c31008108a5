"""Writing a recording: transforms, poses, a scene, signals and events as JSON messages in an MCAP file."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from quasi.airframe import Airframe
from quasi.errors import ConfigError
from quasi.export.mcap.schemas import LOG_INFO, WELL_KNOWN, signals_schema
from quasi.export.mcap.vehicles import Event, Vehicle, rotor_places
from quasi.tables import replace_file

WORLD = "world"
PATH_POINTS = 2000  # of the line that shows where a vehicle flew


def write_recording(
    path: str | Path, vehicles: Sequence[Vehicle], events: Sequence[Event] = (), airframe: Airframe | None = None
) -> int:
    """Write an MCAP file; returns the number of messages. airframe  whose rotors are drawn

    Topics: /tf, /scene, /events, and of each vehicle /<name>/pose and /<name>/<group of signals>.
    Raises ConfigError where the package mcap is absent.
    """
    try:
        from mcap.writer import Writer
    except ImportError:
        raise ConfigError("an MCAP file needs the package 'mcap'; install it with pip install 'quasi[mcap]'") from None

    with replace_file(path) as part:
        writer = Writer(str(part))
        writer.start(profile="", library="quasi")
        schemas = {
            name: writer.register_schema(name=name, encoding="jsonschema", data=json.dumps(schema).encode())
            for name, schema in WELL_KNOWN.items()
        }

        def channel(topic: str, schema: int) -> int:
            return writer.register_channel(topic=topic, message_encoding="json", schema_id=schema)

        count = 0
        messages: list[tuple[int, int, dict[str, Any]]] = []  # ns, channel, message
        scene = channel("/scene", schemas["foxglove.SceneUpdate"])
        messages.append((0, scene, _scene(vehicles, airframe)))
        transforms = channel("/tf", schemas["foxglove.FrameTransforms"])
        for vehicle in vehicles:
            poses = channel(f"/{vehicle.name}/pose", schemas["foxglove.PoseInFrame"])
            for at, place, turn in zip(_nanoseconds(vehicle.t), vehicle.position, vehicle.quaternion):
                if not (np.isfinite(place).all() and np.isfinite(turn).all()):
                    continue
                time, position, rotation = _time(at), _vector(place), _quaternion(turn)
                messages.append((at, poses, {
                    "timestamp": time, "frame_id": WORLD, "pose": {"position": position, "orientation": rotation}
                }))  # fmt: skip
                messages.append((at, transforms, {"transforms": [{
                    "timestamp": time, "parent_frame_id": WORLD, "child_frame_id": vehicle.name,
                    "translation": position, "rotation": rotation,
                }]}))  # fmt: skip
            for group, table in vehicle.signals.items():
                data = json.dumps(signals_schema({n: vehicle.units.get(n, "") for n in table})).encode()
                name = f"quasi.Signals.{vehicle.name}.{group}"
                own = writer.register_schema(name=name, encoding="jsonschema", data=data)
                signal = channel(f"/{vehicle.name}/{group}", own)
                names, values = list(table), table.to_numpy(float)
                for at, row in zip(_nanoseconds(vehicle.t), values):
                    known = {n: float(v) for n, v in zip(names, row) if np.isfinite(v)}
                    if known:
                        messages.append((at, signal, {"timestamp": _time(at), **known}))
        if events:
            log = channel("/events", schemas["foxglove.Log"])
            for event in events:
                at = int(_nanoseconds(np.array([event.t]))[0])
                messages.append((at, log, {
                    "timestamp": _time(at), "level": LOG_INFO, "message": event.text, "name": "quasi", "file": "",
                    "line": 0,
                }))  # fmt: skip
        for at, where, message in sorted(messages, key=lambda m: m[0]):
            writer.add_message(where, log_time=at, publish_time=at, data=json.dumps(message).encode(), sequence=count)
            count += 1
        writer.finish()
    return count


def _nanoseconds(t: np.ndarray) -> list[int]:
    return np.rint(np.asarray(t, float) * 1e9).astype(np.int64).tolist()


def _time(at: int) -> dict[str, int]:
    return {"sec": at // 1_000_000_000, "nsec": at % 1_000_000_000}


def _vector(values: np.ndarray) -> dict[str, float]:
    return {axis: float(v) for axis, v in zip("xyz", values)}


def _quaternion(values: np.ndarray) -> dict[str, float]:
    return {axis: float(v) for axis, v in zip("wxyz", values)}


def _scene(vehicles: Sequence[Vehicle], airframe: Airframe | None) -> dict[str, Any]:
    """Arms and rotors of each vehicle in its own frame, and the line that it flew in the world."""
    hubs, radius = rotor_places(airframe)
    still = {"position": _vector(np.zeros(3)), "orientation": _quaternion(np.array([1.0, 0.0, 0.0, 0.0]))}
    entities = []
    for vehicle in vehicles:
        red, green, blue = vehicle.color
        color = {"r": red, "g": green, "b": blue, "a": 1.0}
        discs = [
            {"pose": {**still, "position": _vector(hub)}, "size": {"x": 2 * radius, "y": 2 * radius, "z": 0.1 * radius},
             "bottom_scale": 1.0, "top_scale": 1.0, "color": {**color, "a": 0.5}}
            for hub in hubs
        ]  # fmt: skip
        arms = [_line([np.zeros(3), hub], color, 0.2 * radius, still) for hub in hubs]
        nose = _line([np.zeros(3), np.array([1.5 * np.max(hubs[:, 0]), 0.0, 0.0])], color, 0.3 * radius, still)
        entities.append(_entity(vehicle.name, vehicle.name, True, discs, [*arms, nose]))
        seen = vehicle.position[np.isfinite(vehicle.position).all(axis=1)]
        flown = seen[:: max(len(seen) // PATH_POINTS, 1)]
        entities.append(_entity(f"{vehicle.name} path", WORLD, False, [], [_line(flown, color, 0.1 * radius, still)]))
    return {"deletions": [], "entities": entities}


def _line(points: Any, color: dict[str, float], thickness: float, pose: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": 0, "pose": pose, "thickness": thickness, "scale_invariant": False, "color": color, "colors": [],
        "points": [_vector(p) for p in points], "indices": [],
    }  # fmt: skip


def _entity(name: str, frame: str, locked: bool, cylinders: list[Any], lines: list[Any]) -> dict[str, Any]:
    empty = {key: [] for key in ("metadata", "arrows", "cubes", "spheres", "triangles", "texts", "models")}
    return {
        "timestamp": _time(0), "frame_id": frame, "id": name, "lifetime": _time(0), "frame_locked": locked, **empty,
        "cylinders": cylinders, "lines": lines,
    }  # fmt: skip
