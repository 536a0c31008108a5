"""A log of several topics becomes a recording, by the configured columns or by the topics that its format knows."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from quasi.airframe import DEFAULT_POLES
from quasi.importing.clocks.filter_delays import USUAL_ACCELEROMETER, USUAL_GYRO, delay
from quasi.importing.readers.known_topics import Known, plan_known
from quasi.importing.readers.reader import Reader, Request
from quasi.importing.readers.signals import LogFile
from quasi.importing.readers.table_mapping import read_mapping
from quasi.importing.readers.table_reader import read_signals
from quasi.importing.series import Recording
from quasi.project import configuration


def topics_reader(
    name: str,
    kinds: tuple[str, ...],
    opens: Callable[[Path, list[str]], LogFile],
    known: Sequence[Known],
    controller: str,
    delays: Callable[[Any, Mapping[str, Any]], dict[str, Any]] | None = None,
) -> Reader:
    """A format whose logs are read by the configured columns, or by the topics that it knows.

    opens   (path, notes) -> the open log; controller  value of 'Flight controller'
    delays  (log, mapping in use) -> how late sensors were filtered on board
    """

    def read(request: Request) -> Recording:
        """Units, axes and clocks as a table's. Raises ConfigError or ReadError for a topic that is absent or wrong."""
        notes: list[str] = []
        log = opens(request.path, notes)
        mapping = request.quadrotor.get("table columns")
        if not isinstance(mapping, Mapping):
            # `quasi decode` takes a file that nothing has checked
            given = request.quadrotor.get("log topics") or {}
            chosen, _ = configuration.check(given, "quadrotor", "log topics", "properties", "log topics")
            mapping = plan_known(log.topics, known, chosen, request.path, notes)
        plan = read_mapping(mapping, request.poles or DEFAULT_POLES, "table columns", log_has_clock=True)
        signals = log.samples_of(plan.names, notes)
        known_names = [column for topic in log.topics.values() for column in topic.columns]
        electrical = "eRPM" in str(mapping)
        late = {} if delays is None else delays(log, mapping)
        gyro_late = late["gyro"]["value"] if late else 0.0
        recording = read_signals(request.path, signals, plan, request.poles, electrical, notes, known_names, gyro_late)
        recording.metadata.update(log.facts)
        if late:
            recording.metadata["filter delays"] = late
        return recording

    return Reader(name, kinds, read, (controller,))


def low_pass_delays(
    mapping: Mapping[str, Any], parameters: Mapping[str, Any], filters: Mapping[str, tuple[str, str, bool]]
) -> dict[str, dict[str, Any]]:
    """Delays, s, of gyro and accelerometer by second-order low-passes on board, as `header_delays` gives them.

    filters  {sensor: (pattern of the columns that come after the filter, parameter of its cut-off in Hz, whether
             further filters of unknown delay are on)}
    """
    found = {}
    for sensor, (pattern, cutoff, more) in filters.items():
        about: dict[str, Any] = {"value": 0.0, "std": 0.0, "unit": "s", "known": True, "filters": []}
        if re.search(pattern, str(mapping)):
            hertz = float(parameters.get(cutoff, 0.0))
            if hertz > 0:
                about |= {"value": delay("biquad", hertz), "filters": [f"low-pass {hertz:g} Hz"]}
            if cutoff not in parameters or more:
                about |= {"known": False, "std": USUAL_GYRO if sensor == "gyro" else USUAL_ACCELEROMETER}
        found[sensor] = about
    return found
