"""Checks of what a reader returns: the same for every format, in one place, before anything is fused."""

from dataclasses import replace
from typing import Any

import numpy as np

from quasi.errors import add_caution
from quasi.importing.checks.channels import frozen_sensor_spans
from quasi.importing.checks.rotor_speeds import clean_rotor_speeds, flying_rows, rotor_names, unreliable_spans
from quasi.importing.checks.spans import InvalidSpan, merge_spans
from quasi.importing.contradictions import doubtful_values
from quasi.importing.series import Recording, Series


def check_recording(recording: Recording, where: str) -> Recording:
    """A recording without spikes, with its unusable spans in metadata "invalid spans", each named in a note for care.

    Rotor speeds that no rotor reaches or follows become NaN and are counted; where a rotor stands still or is constant
    in flight, where its speeds are mostly impossible, and where a sensor channel is frozen in flight, the rows are
    invalid. A table's spikes were removed before its clocks were settled, for the lags rest on rotor speeds.

    where   begins the notes
    """
    from_table = bool(recording.metadata.get("mapped"))
    notes = list(recording.notes)
    series = dict(recording.series)
    removed: dict[str, int] = {}
    spans: list[InvalidSpan] = []
    for name, one in recording.series.items():
        if not name.startswith("onboard") or len(one.t) < 2:
            continue
        values = dict(one.values)
        if not from_table:
            cleaned, counts = clean_rotor_speeds(one.t, values, where, notes)
            values |= cleaned
            removed |= counts
        series[name] = Series(one.t, values)
        spans += unreliable_spans(one.t, values)
        spans += frozen_sensor_spans(one.t, values, flying_rows(values))
    if not from_table:
        # rotor speeds that no rotor reaches make rows invalid above
        values = {n: v for one in series.values() for n, v in one.values.items() if n not in rotor_names(one.values)}
        for end in doubtful_values(values):
            add_caution(notes, f"{where}: {end}")
    spans = merge_spans(spans)
    for reason in dict.fromkeys(span.reason for span in spans):
        own = [span for span in spans if span.reason == reason]
        seconds = sum(span.end - span.begin for span in own)
        start = min(float(one.t[0]) for one in series.values() if len(one.t))
        add_caution(
            notes,
            f"{where}: {reason} for {seconds:.2f} s, first from {own[0].begin - start:.2f} s; these rows are invalid "
            "and serve no identification: check the sensor, its wiring and its telemetry",
        )
    found: dict[str, Any] = {"invalid spans": [{"begin": s.begin, "end": s.end, "reason": s.reason} for s in spans]}
    if not from_table:
        found["spikes removed"] = removed
    return replace(recording, series=series, metadata={**recording.metadata, **found}, notes=notes)


def rows_in_spans(spans: list[dict[str, Any]], at: np.ndarray) -> np.ndarray:
    """True (m,) at times at (m,), s, that lie within spans with "begin" and "end", s, on the same clock."""
    inside = np.zeros(len(at), bool)
    for span in spans:
        inside |= (at >= span["begin"]) & (at <= span["end"])
    return inside
