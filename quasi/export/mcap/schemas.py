"""JSON schemas of the messages: Foxglove's well-known ones by their names, and signals of quasi.

Source of names and fields: Foxglove's documentation of its message schemas (FrameTransforms, PoseInFrame, SceneUpdate,
Log), JSON encoding. A viewer knows them by name; the schema in the file lets any other reader check a message.
"""

from collections.abc import Mapping
from typing import Any


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _array(items: Any) -> dict[str, Any]:
    return {"type": "array", "items": items}


NUMBER, INTEGER, TEXT, FLAG = ({"type": kind} for kind in ("number", "integer", "string", "boolean"))
TIME_SCHEMA = _object(
    sec={"type": "integer", "minimum": 0}, nsec={"type": "integer", "minimum": 0, "maximum": 999999999}
)
VECTOR = _object(x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION_SCHEMA = _object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
POSE = _object(position=VECTOR, orientation=QUATERNION_SCHEMA)
COLOR = _object(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
_CYLINDER = _object(pose=POSE, size=VECTOR, bottom_scale=NUMBER, top_scale=NUMBER, color=COLOR)
_LINE = _object(type=INTEGER, pose=POSE, thickness=NUMBER, scale_invariant=FLAG, points=_array(VECTOR), color=COLOR,
                colors=_array(COLOR), indices=_array(INTEGER))  # fmt: skip
_ENTITY = _object(
    timestamp=TIME_SCHEMA, frame_id=TEXT, id=TEXT, lifetime=TIME_SCHEMA, frame_locked=FLAG,
    metadata=_array(_object(key=TEXT, value=TEXT)), cylinders=_array(_CYLINDER), lines=_array(_LINE),
    **{name: _array({"type": "object"}) for name in ("arrows", "cubes", "spheres", "triangles", "texts", "models")},
)  # fmt: skip
_TRANSFORM = _object(
    timestamp=TIME_SCHEMA, parent_frame_id=TEXT, child_frame_id=TEXT, translation=VECTOR, rotation=QUATERNION_SCHEMA
)

WELL_KNOWN: dict[str, dict[str, Any]] = {
    "foxglove.FrameTransforms": _object(transforms=_array(_TRANSFORM)),
    "foxglove.PoseInFrame": _object(timestamp=TIME_SCHEMA, frame_id=TEXT, pose=POSE),
    "foxglove.SceneUpdate": _object(
        deletions=_array(_object(timestamp=TIME_SCHEMA, type=INTEGER, id=TEXT)), entities=_array(_ENTITY)
    ),
    "foxglove.Log": _object(timestamp=TIME_SCHEMA, level=INTEGER, message=TEXT, name=TEXT, file=TEXT, line=INTEGER),
}
LOG_INFO = 2  # level of foxglove.Log


def signals_schema(units: Mapping[str, str]) -> dict[str, Any]:
    """The schema of one topic of signals, each a number with its unit."""
    return {"title": "quasi.Signals", **_object(timestamp=TIME_SCHEMA, **{
        name: {"type": "number", "description": unit} for name, unit in units.items()
    })}  # fmt: skip
