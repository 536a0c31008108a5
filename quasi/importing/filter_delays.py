"""How late a flight controller's own filters make gyro and accelerometer, from the settings in the log's header.

Constant group delays far below the cut-off: of a first-order lag 1/(2 pi f); of PTn (n equal lags in a row, each with
its cut-off raised by 1/sqrt(2^(1/n) - 1) so that the whole has -3 dB at f) n times that of one; of a second-order
Butterworth sqrt(2)/(2 pi f); of a notch of quality Q 1/(2 pi f Q). What moves in flight is known roughly: a dynamic
low-pass between its two ends, notches that follow the rotors or the spectrum from where they may move. Their doubt
is the standard error of the delay.

Source: Oppenheim & Schafer, Discrete-Time Signal Processing, 3rd ed., 2010, section 5.1.2 (group delay).
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from quasi.importing.blackbox_header import version

KINDS = {0: "PT1", 1: "biquad", 2: "PT2", 3: "PT3"}
# static cut-off, dynamic range, type of each low-pass on the gyro, under the names up to version 4.2 and since 4.3
STAGES = (
    ("gyro_lowpass_hz", "gyro_lowpass_dyn_hz", "gyro_lowpass_type"),
    ("gyro_lowpass2_hz", "", "gyro_lowpass2_type"),
    ("gyro_lpf1_static_hz", "gyro_lpf1_dyn_hz", "gyro_lpf1_type"),
    ("gyro_lpf2_static_hz", "", "gyro_lpf2_type"),
)
# number of harmonics, quality in hundredths, lowest frequency, under the names up to version 4.2 and since 4.3
RPM_NOTCHES = (
    ("gyro_rpm_notch_harmonics", "gyro_rpm_notch_q", "gyro_rpm_notch_min"),
    ("rpm_filter_harmonics", "rpm_filter_q", "rpm_filter_min_hz"),
)
HIGHEST = 4000.0  # Hz, of any filter on the gyro; larger numbers are hundredths of a hertz, as old firmware writes them
# s: what the filters of usual settings add up to, which is how wrong 0 may be where a header says nothing of them
USUAL_GYRO, USUAL_ACCELEROMETER = 2e-3, 20e-3


def delay(kind: str, cutoff: float) -> float:
    """Group delay at low frequency, s, of a low-pass "PT1", "PT2", "PT3" or "biquad" with -3 dB at `cutoff` Hz."""
    lag = 1.0 / (2 * math.pi * cutoff)
    if kind == "biquad":
        return math.sqrt(2.0) * lag
    order = int(kind[2])
    return order * lag * math.sqrt(2.0 ** (1.0 / order) - 1.0)


def notch_delay(centre: float, quality: float) -> float:
    """Group delay at low frequency, s, of a notch (s2 + w2) / (s2 + s w/Q + w2) at `centre` Hz."""
    return 1.0 / (2 * math.pi * centre * quality)


def header_delays(header: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """{"gyro" | "accelerometer": {"value" s, "std" s, "unit", "known", "filters"}} from a blackbox header.

    A dynamic low-pass is taken at its lowest cut-off, where it sits at low throttle; the true delay is then smaller.
    A filter that the header lacks beside others is off. Where it says nothing of any filter of a sensor, the delay is
    not known: 0, with what the filters of usual settings add up to as its standard error.
    """
    gyro: list[str] = []
    total = doubt = 0.0
    for static, moving, kind_key in STAGES:
        dynamic = header.get(moving)
        low, high = (
            (_number(dynamic[0]), _number(dynamic[-1])) if isinstance(dynamic, list | tuple) and dynamic else (0, 0)
        )
        cutoff = low or _hertz(header.get(static))
        if cutoff:
            kind = KINDS.get(int(_number(header.get(kind_key))), "PT1")
            gyro.append(f"{kind} {cutoff:g} Hz" + (" (dynamic, lowest)" if low else ""))
            total += delay(kind, cutoff)
            doubt += 0.5 * (delay(kind, low) - delay(kind, high)) if high > low else 0.0
    for name, late, unsure in _notches(header):
        gyro.append(name)
        total, doubt = total + late, doubt + unsure
    named = {name for stage in (*STAGES, *RPM_NOTCHES) for name in stage} | {"gyro_notch_hz", "dyn_notch_min_hz"}
    gyro_known, force_known = not named.isdisjoint(header), "acc_lpf_hz" in header
    cutoff = _number(header.get("acc_lpf_hz"))
    cutoff = cutoff / 100 if cutoff > 500 else cutoff  # until version 4.2 the header holds hundredths of a hertz
    kind = "biquad" if (version(header) or (4, 3)) < (4, 3) else "PT2"
    return {
        "gyro": {
            "value": total,
            "std": doubt if gyro_known else USUAL_GYRO,
            "unit": "s",
            "known": gyro_known,
            "filters": gyro,
        },
        "accelerometer": {
            "value": delay(kind, cutoff) if cutoff else 0.0,
            "std": 0.0 if force_known else USUAL_ACCELEROMETER,
            "unit": "s",
            "known": force_known,
            "filters": [f"{kind} {cutoff:g} Hz"] if cutoff else [],
        },
    }


def _notches(header: Mapping[str, Any]) -> Iterator[tuple[str, float, float]]:
    """Name, delay s and its doubt s of the notches on the gyro: fixed, on peaks of the spectrum, on the rotors."""
    # one number where the firmware has one such notch
    centres, edges = (
        value if isinstance(value, list | tuple) else [value]
        for value in (header.get("gyro_notch_hz"), header.get("gyro_notch_cutoff"))
    )
    for centre, edge in zip(map(_hertz, centres), map(_hertz, edges)):
        if centre > edge > 0:
            yield f"notch {centre:g} Hz", notch_delay(centre, centre * edge / (centre**2 - edge**2)), 0.0
    low, high = _number(header.get("dyn_notch_min_hz")), _number(header.get("dyn_notch_max_hz"))
    quality = _number(header.get("dyn_notch_q")) / 100  # the header holds hundredths
    count = int(_number(header.get("dyn_notch_count", 1)))
    if count and low and high > low and quality:
        least, most = (count * notch_delay(f, quality) for f in (high, low))
        yield f"{count} dynamic notches {low:g} to {high:g} Hz", 0.5 * (least + most), 0.5 * (most - least)
    for count_key, quality_key, least_key in RPM_NOTCHES:
        harmonics, quality = int(_number(header.get(count_key))), _number(header.get(quality_key)) / 100
        low = _number(header.get(least_key))
        if harmonics and quality and low and _number(header.get("dshot_bidir", 1)):
            # the rotors' frequency in flight lies between the least and some four times it
            late = 4 * sum(notch_delay(k * low, quality) for k in range(1, harmonics + 1))
            yield f"4 x {harmonics} notches on the rotors above {low:g} Hz", 0.625 * late, 0.375 * late


def _number(value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        return 0.0
    return number if math.isfinite(number) and number > 0 else 0.0


def _hertz(value: Any) -> float:
    number = _number(value)
    return number / 100 if number > HIGHEST else number
