"""How late a flight controller's own filters make gyro and accelerometer, from the settings in the log's header.

Constant group delays far below the cut-off: of a first-order lag 1/(2 pi f); of PTn (n equal lags in a row, each with
its cut-off raised by 1/sqrt(2^(1/n) - 1) so that the whole has -3 dB at f) n times that of one; of a second-order
Butterworth sqrt(2)/(2 pi f); of a notch of quality Q 1/(2 pi f Q). What moves in flight is known roughly: a dynamic
low-pass between its two ends, notches that follow the rotors or the spectrum from where they may move. Their doubt
is the standard error of the delay. 0 switches a filter off. A number that firmware never writes (negative, or beyond
what it accepts) leaves the filter unknown: no delay, and the standard error of usual settings.

Source: Oppenheim & Schafer, Discrete-Time Signal Processing, 3rd ed., 2010, section 5.1.2 (group delay).
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from quasi.errors import quoted
from quasi.importing.readers.blackbox_header import is_other_firmware, version

LOWPASS_KINDS = {0: "PT1", 1: "biquad", 2: "PT2", 3: "PT3"}
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
# Hz, of any filter on the gyro; larger numbers are hundredths of a hertz, as old firmware writes them
HIGHEST_CORNER = 4000.0
# the most that firmware accepts (Betaflight 4.5 settings: gyro filters 1000 Hz and older ones 4000 Hz, in hundredths
# then; dyn_notch_count 7 with older 5, rpm_filter_harmonics 3, quality 10 as 1000 hundredths of the spectrum's notches
# and 30 as 3000 of the rotors'); a larger or a negative number is no setting
LARGEST_CUTOFF, MOST_NOTCHES, MOST_HARMONICS, LARGEST_QUALITY = 400_000.0, 8, 8, 3000.0
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


def header_delays(header: Mapping[str, Any], complete: bool = True) -> dict[str, dict[str, Any]]:
    """{"gyro" | "accelerometer": {"value" s, "std" s, "unit", "known", "filters"}} from a blackbox header.

    header    as `plain_header` gives it; complete  False where lines of it are lost: what it lacks may have been on
    A dynamic low-pass is taken at its lowest cut-off, where it sits at low throttle; the true delay is then smaller.
    A filter that a complete header lacks while it lists others is off. Where a header lists no filter of a sensor,
    holds a setting that no firmware writes, or comes from another firmware, the delay is not known: what is stated,
    with what the filters of usual settings add up to as its standard error. No setting raises an error.
    """
    strange: list[str] = []
    gyro: list[str] = []
    total = doubt = 0.0
    for name, late, unsure in (*_lowpasses(header, strange), *_notches(header, strange)):
        gyro.append(name)
        total, doubt = total + late, doubt + unsure
    named = {name for stage in (*STAGES, *RPM_NOTCHES) for name in stage} | {"gyro_notch_hz", "dyn_notch_min_hz"}
    understood = complete and not is_other_firmware(header)
    gyro_known = understood and not strange and not named.isdisjoint(header)
    strange_force: list[str] = []
    cutoff = _setting(header, "acc_lpf_hz", LARGEST_CUTOFF, strange_force)
    cutoff = cutoff / 100 if cutoff > 500 else cutoff  # the header holds hundredths of a hertz
    force_known = understood and not strange_force and "acc_lpf_hz" in header
    kind = "biquad" if (version(header) or (4, 3)) < (4, 3) else "PT2"
    return {
        "gyro": {
            "value": total,
            "std": doubt if gyro_known else math.hypot(doubt, USUAL_GYRO),
            "unit": "s",
            "known": gyro_known,
            "filters": [*gyro, *strange],
        },
        "accelerometer": {
            "value": delay(kind, cutoff) if cutoff else 0.0,
            "std": 0.0 if force_known else USUAL_ACCELEROMETER,
            "unit": "s",
            "known": force_known,
            "filters": [f"{kind} {cutoff:g} Hz"] * bool(cutoff) + strange_force,
        },
    }


def _lowpasses(header: Mapping[str, Any], strange: list[str]) -> Iterator[tuple[str, float, float]]:
    """Name, delay s and its standard error s of the low-passes on the gyro."""
    for static, moving, kind_key in STAGES:
        low = _hertz(_setting(header, moving, LARGEST_CUTOFF, strange, place=0)) if moving else 0.0
        high = _hertz(_setting(header, moving, LARGEST_CUTOFF, strange, place=-1)) if moving else 0.0
        # a dynamic range from 0 is off, and the static filter counts
        cutoff = low or _hertz(_setting(header, static, LARGEST_CUTOFF, strange))
        if not cutoff:
            continue
        number = header.get(kind_key, 0)
        kind = LOWPASS_KINDS.get(number if isinstance(number, int) else -1)
        if kind is None:
            strange.append(f"{kind_key} {quoted(number)} is no type")
            kind = "PT1"
        unsure = 0.5 * (delay(kind, low) - delay(kind, high)) if high > low > 0 else 0.0
        yield f"{kind} {cutoff:g} Hz" + (" (dynamic, lowest)" if low else ""), delay(kind, cutoff), unsure


def _notches(header: Mapping[str, Any], strange: list[str]) -> Iterator[tuple[str, float, float]]:
    """Name, delay s and its standard error s of the notches on the gyro: fixed, on the spectrum's peaks, on rotors."""
    # one number where the firmware has one such notch
    for place in range(2):
        centre, edge = (
            _hertz(_setting(header, key, LARGEST_CUTOFF, strange, place))
            for key in ("gyro_notch_hz", "gyro_notch_cutoff")
        )
        if centre > edge > 0:
            yield f"notch {centre:g} Hz", notch_delay(centre, centre * edge / (centre**2 - edge**2)), 0.0
    low = _setting(header, "dyn_notch_min_hz", LARGEST_CUTOFF, strange)
    high = _setting(header, "dyn_notch_max_hz", LARGEST_CUTOFF, strange)
    quality = _setting(header, "dyn_notch_q", LARGEST_QUALITY, strange) / 100  # the header holds hundredths
    count = int(_setting({"dyn_notch_count": 1, **header}, "dyn_notch_count", MOST_NOTCHES, strange))
    if count and low and high > low and quality:
        least, most = (count * notch_delay(f, quality) for f in (high, low))
        yield f"{count} dynamic notches {low:g} to {high:g} Hz", 0.5 * (least + most), 0.5 * (most - least)
    for count_key, quality_key, least_key in RPM_NOTCHES:
        harmonics = int(_setting(header, count_key, MOST_HARMONICS, strange))
        quality = _setting(header, quality_key, LARGEST_QUALITY, strange) / 100
        low = _setting(header, least_key, LARGEST_CUTOFF, strange)
        if harmonics and quality and low and _setting({"dshot_bidir": 1, **header}, "dshot_bidir", 1, strange):
            # the rotors' frequency in flight lies between the least and some four times it
            late = 4 * sum(notch_delay(k * low, quality) for k in range(1, harmonics + 1))
            yield f"4 x {harmonics} notches on the rotors above {low:g} Hz", 0.625 * late, 0.375 * late


def _setting(header: Mapping[str, Any], key: str, largest: float, strange: list[str], place: int = 0) -> float:
    """A setting, or one entry of it; 0 where it is off, absent or no setting, and then named in `strange`."""
    value = header.get(key, 0)
    if isinstance(value, list | tuple):
        value = value[place] if -len(value) <= place < len(value) else 0
    elif place > 0:
        return 0.0
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    # a positive cut-off below 1 Hz would delay by more than any flight bears
    if number == 0 or 1 <= number <= largest:
        return number
    sentence = f"{key} {quoted(value)} is no setting"
    if sentence not in strange:
        strange.append(sentence)
    return 0.0


def _hertz(number: float) -> float:
    return number / 100 if number > HIGHEST_CORNER else number
