"""Topics that need no configuration: which of a log's columns are which quantities, by topic name or message type.

A format lists its `Known` topics in order of preference. For every role the first that the log holds with enough
samples is taken; "log topics" of the quadrotor configuration chooses another. The result has the form of the section
"table columns", so that units, axes, clocks and checks are those of a table.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from quasi.errors import ConfigError, ReadError, nearest
from quasi.importing.readers.signals import Topic
from quasi.importing.readers.table_mapping import EULER_ANGLES, QUATERNION, VECTOR_COLUMNS

MOTORS = 8
INSTANCE = r"(:\d+)?"  # at the end of a topic that a log holds several times
PWM_RANGE = (1000.0, 2000.0)  # us, where a log does not hold the limits of its motor outputs
LEAST_SAMPLES = 20  # of a topic, as of a table's source
ROLE_COLUMNS = {
    "body rates": ("p", "q", "r"),
    "specific force": ("ax", "ay", "az"),
    "attitude": ("qw", "qx", "qy", "qz", "roll", "pitch", "yaw"),
    "position": ("x", "y", "z"),
    "velocity": ("vx", "vy", "vz"),
    "rotor speeds": tuple(f"w{i}" for i in range(1, 9)),
    "commands": tuple(f"command{i}" for i in range(1, 9)),
    "battery": ("battery_voltage", "battery_current"),
    "capture": (),
}
# what each needed role can be made from where a log holds something else as well (see `reconstruction`)
NEEDED_ROLES = {"body rates": ("attitude", "capture"), "specific force": ("position", "velocity", "capture")}


@dataclass(frozen=True)
class Known:
    """One way in which a format logs the quantities of a role.

    role     of ROLE_COLUMNS; match  pattern of the whole topic name, or of the message type where `by_kind`
    columns  {quantity: (field, unit)}; a field is the column without "topic.". Those that the topic lacks are left out
             as whole vectors
    body     whether velocity or specific force are in body axes, None for the usual ones
    names    a pattern that the topic's name must hold as well, for message types that say nothing of their meaning
    better   wins over those before it where it has at least this many times their rate, 0 for never
    """

    role: str
    match: str
    columns: Mapping[str, tuple[str, str]]
    frame: str = "FRD"
    world: str = "NED"
    body: bool | None = None
    by_kind: bool = False
    names: str = ""
    better: float = 0.0
    clock: tuple[str, str] | None = field(default=None)  # (field, unit) of a clock of its own

    def fits(self, name: str, topic: Topic) -> bool:
        """Whether a topic is one of these and holds at least one column of it."""
        if not re.fullmatch(self.match, topic.kind if self.by_kind else name):
            return False
        if self.names and not re.search(self.names, name, re.IGNORECASE):
            return False
        present = self.present(name, topic)
        return bool(present) and (self.role != "capture" or "x" in present)  # a capture without position is none

    def present(self, name: str, topic: Topic) -> dict[str, tuple[str, str]]:
        """{quantity: (full column name, unit)} of what the topic holds."""
        held = set(topic.columns)
        found = {q: (f"{name}.{f}", unit) for q, (f, unit) in self.columns.items() if f"{name}.{f}" in held}
        for whole in (*VECTOR_COLUMNS.values(), QUATERNION, EULER_ANGLES):
            if not all(q in found for q in whole if q in self.columns):
                found = {q: about for q, about in found.items() if q not in whole}
        return found


def candidates(topics: Mapping[str, Topic], known: Sequence[Known]) -> dict[str, list[tuple[str, Known]]]:
    """{role: [(topic name, how it is logged)]} of what a log holds, best first; topics with too few samples last."""
    found: dict[str, list[tuple[str, Known]]] = {}
    for role in ROLE_COLUMNS:
        own = [
            (name, way)
            for way in known
            if way.role == role
            for name, topic in topics.items()
            if topic.samples > 0 and way.fits(name, topic)
        ]
        first: dict[str, tuple[str, Known]] = {}
        for name, way in own:
            first.setdefault(name, (name, way))
        own = list(first.values())
        own.sort(key=lambda item: topics[item[0]].samples < LEAST_SAMPLES)
        for place in range(1, len(own)):
            name, way = own[place]
            if way.better and topics[name].rate >= way.better * topics[own[0][0]].rate > 0:
                own.insert(0, own.pop(place))
        if own:
            found[role] = own
    return found


def plan_known(
    topics: Mapping[str, Topic], known: Sequence[Known], chosen: Mapping[str, str], path: Path, notes: list[str]
) -> dict[str, Any]:
    """The section "table columns" of a log whose topics are known.

    chosen   "log topics" of the quadrotor configuration, {role: topic name}
    Raises   ConfigError for an unknown topic in `chosen`, ReadError where a needed role has no topic
    """
    found = candidates(topics, known)
    for role, name in chosen.items():
        able = [item for item in found.get(role, []) if item[0] == name]
        if name and not able:
            others = [n for n, _ in found.get(role, [])] or list(topics)
            raise ConfigError(
                f"{path}: 'log topics' takes {role} from '{name}', but the log holds no such topic with "
                f"{role}{nearest(name, others)}; correct it"
            )
        found[role] = able
    several = sum(map(bool, found.values())) > 1
    for role, others in NEEDED_ROLES.items():
        if several and role not in found and any(found.get(other) for other in others):
            continue
        if not found.get(role) or topics[found[role][0][0]].samples < LEAST_SAMPLES:
            raise ReadError(_missing_role(path, role, topics, known, found.get(role, [])))
    sources: list[dict[str, Any]] = []
    for role, items in found.items():
        if not items or topics[items[0][0]].samples < LEAST_SAMPLES:
            continue
        rotors = role in ("rotor speeds", "commands")
        for name, way in _whole_set(items, topics) if rotors else items[:1]:
            sources.append(_source(role, name, way, topics[name]))
        others = [n for n, _ in items if all(n != s["// topic"] for s in sources)]
        if others:
            notes.append(
                f"{path}: {role}: '{items[0][0]}' is used, {', '.join(others[:6])} could be; choose by "
                f'"log topics": {{"{role}": "{others[0]}"}} in the quadrotor configuration'
            )
    return {"sources": _without_repeats(sources)}


def _whole_set(items: list[tuple[str, Known]], topics: Mapping[str, Topic]) -> list[tuple[str, Known]]:
    """The best topic, and those of the same kind that hold the other rotors."""
    first, way = items[0]
    taken = set(way.present(first, topics[first]))
    chosen = [items[0]]
    for name, other in items[1:]:
        quantities = set(other.present(name, topics[name]))
        if not quantities & taken and topics[name].kind == topics[first].kind:
            chosen.append((name, other))
            taken |= quantities
    return chosen


def _source(role: str, name: str, way: Known, topic: Topic) -> dict[str, Any]:
    columns: dict[str, Any] = {}
    for quantity, (column, unit) in way.present(name, topic).items():
        entry: dict[str, Any] = {"column": column, "unit": unit}
        if way.body is not None and quantity in ("vx", "vy", "vz", "ax", "ay", "az"):
            entry["frame"] = "body" if way.body else "world"
        if role not in NEEDED_ROLES:
            entry["optional"] = True
        columns[quantity] = entry
    source = {"name": f"{role} ({name})", "// topic": name, "frame": way.frame, "world": way.world}
    if role == "capture":
        source["motion capture"] = True
    if way.clock is not None and f"{name}.{way.clock[0]}" in topic.columns:
        source["time"] = {"column": f"{name}.{way.clock[0]}", "unit": way.clock[1]}
    return source | {"columns": columns}


def _without_repeats(sources: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Sources of one topic are one source; a quantity that two map stays with the first."""
    merged: list[dict[str, Any]] = []
    seen: set[tuple[str, bool]] = set()
    for source in sources:
        capture = bool(source.get("motion capture"))
        columns = {q: entry for q, entry in source["columns"].items() if (q, capture) not in seen}
        seen |= {(q, capture) for q in columns}
        same = next((m for m in merged if _sampled_alike(m, source)), None)
        if same is not None:
            same["columns"] |= columns
            same["name"] = same["name"].replace(" (", f", {source['name'].partition(' (')[0]} (", 1)
        elif columns:
            merged.append({**source, "columns": columns})
    return merged


def _sampled_alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    keys = ("// topic", "frame", "world", "motion capture", "time")
    return all(one.get(key) == other.get(key) for key in keys)


def _missing_role(
    path: Path, role: str, topics: Mapping[str, Topic], known: Sequence[Known], few: list[tuple[str, Known]]
) -> str:
    if few:
        name = few[0][0]
        return (
            f"{path}: topic '{name}' holds {topics[name].samples} samples of {role}, at least {LEAST_SAMPLES} are "
            "needed; log it faster or longer"
        )
    ways = [way for way in known if way.role == role]
    wanted = list(dict.fromkeys(re.sub(r"\\|\(.*?\)\?|\[.*?\]\?", "", way.match) for way in ways))
    by_kind = bool(ways) and ways[0].by_kind
    names = sorted(f"{name} ({topic.kind})" if by_kind else name for name, topic in topics.items())
    near = "" if by_kind else nearest(wanted[0], names)
    listed = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return (
        f"{path} holds no {role}: none of {', '.join(wanted)}{near}. Its topics "
        f"are {listed or 'none'}; log one of them, or map columns by 'table columns' in the quadrotor configuration"
    )
