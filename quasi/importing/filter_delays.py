"""How late a flight controller's own filters make gyro and accelerometer, from the settings in the log's header.

Constant group delays far below the cut-off: of a first-order lag 1/(2 pi f); of PTn (n equal lags in a row, each with
its cut-off raised by 1/sqrt(2^(1/n) - 1) so that the whole has -3 dB at f) n times that of one; of a second-order
Butterworth sqrt(2)/(2 pi f). Notches are left out: with their usual narrow bands they add a few tenths of a
millisecond.

Source: Oppenheim & Schafer, Discrete-Time Signal Processing, 3rd ed., 2010, section 5.1.2 (group delay).
"""

import math
from collections.abc import Mapping
from typing import Any

KINDS = {0: "PT1", 1: "biquad", 2: "PT2", 3: "PT3"}
# static cut-off, dynamic range, type of each low-pass on the gyro, under the names up to version 4.2 and since 4.3
STAGES = (
    ("gyro_lowpass_hz", "gyro_lowpass_dyn_hz", "gyro_lowpass_type"),
    ("gyro_lowpass2_hz", "", "gyro_lowpass2_type"),
    ("gyro_lpf1_static_hz", "gyro_lpf1_dyn_hz", "gyro_lpf1_type"),
    ("gyro_lpf2_static_hz", "", "gyro_lpf2_type"),
)


def delay(kind: str, cutoff: float) -> float:
    """Group delay at low frequency, s, of a low-pass "PT1", "PT2", "PT3" or "biquad" with -3 dB at `cutoff` Hz."""
    lag = 1.0 / (2 * math.pi * cutoff)
    if kind == "biquad":
        return math.sqrt(2.0) * lag
    order = int(kind[2])
    return order * lag * math.sqrt(2.0 ** (1.0 / order) - 1.0)


def header_delays(header: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """{"gyro" | "accelerometer": {"value" s, "unit", "filters"}} from a blackbox header; what it lacks counts as off.

    A dynamic low-pass is taken at its lowest cut-off, where it sits at low throttle; the true delay is then smaller.
    """
    gyro: list[str] = []
    total = 0.0
    for static, moving, kind_key in STAGES:
        dynamic = header.get(moving)
        low = _number(dynamic[0]) if isinstance(dynamic, list | tuple) and dynamic else 0.0
        cutoff = low or _number(header.get(static))
        if cutoff:
            kind = KINDS.get(int(_number(header.get(kind_key))), "PT1")
            gyro.append(f"{kind} {cutoff:g} Hz" + (" (dynamic, lowest)" if low else ""))
            total += delay(kind, cutoff)
    cutoff = _number(header.get("acc_lpf_hz"))
    cutoff = cutoff / 100 if cutoff > 500 else cutoff  # until version 4.2 the header holds hundredths of a hertz
    return {
        "gyro": {"value": total, "unit": "s", "filters": gyro},
        "accelerometer": {
            "value": delay("PT2", cutoff) if cutoff else 0.0,
            "unit": "s",
            "filters": [f"PT2 {cutoff:g} Hz"] if cutoff else [],
        },
    }


def _number(value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        return 0.0
    return number if math.isfinite(number) and number > 0 else 0.0
