"""Write a Betaflight 4.5 blackbox log (data version 2): text headers, then I, P, S and E frames, compiled.

Logged axes are x forward, y left, z up: gyroADC and accSmooth of y and z are minus ours. Rates are whole deg/s,
acceleration 2048 counts a g, rotor speed eRPM/100, voltage and current hundredths. An I frame every 32 ms holds whole
values, the P frames between hold differences to predictions.
Source: the format's public description (Sherlock, "Blackbox logging internals") and the crate blackbox-log (MIT).
"""

import numpy as np
from numba import njit

# predictors and encodings by their numbers in the format
ZERO, PREVIOUS, STRAIGHT_LINE, AVERAGE, MOTOR_0, INCREMENT, VOLTAGE_REFERENCE, LOWEST_MOTOR = 0, 1, 2, 3, 5, 6, 9, 11
SIGNED_VB, UNSIGNED_VB, NEGATIVE_14, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NOTHING = 0, 1, 3, 6, 7, 8, 9


def _fields() -> list[tuple[str, int, int, int, int, int]]:
    """(name, signed, I predictor, I encoding, P predictor, P encoding) of the main frames, in order."""
    rows: list[tuple[str, int, int, int, int, int]] = [
        ("loopIteration", 0, ZERO, UNSIGNED_VB, INCREMENT, NOTHING),
        ("time", 0, ZERO, UNSIGNED_VB, STRAIGHT_LINE, SIGNED_VB),
    ]

    def several(name: str, count: int, *rest: int) -> None:
        rows.extend((f"{name}[{k}]", *rest) for k in range(count))

    several("axisP", 3, 1, ZERO, SIGNED_VB, PREVIOUS, SIGNED_VB)
    several("axisI", 3, 1, ZERO, SIGNED_VB, PREVIOUS, TAG2_3S32)
    several("axisD", 2, 1, ZERO, SIGNED_VB, PREVIOUS, SIGNED_VB)
    several("axisF", 3, 1, ZERO, SIGNED_VB, PREVIOUS, SIGNED_VB)
    several("rcCommand", 3, 1, ZERO, SIGNED_VB, PREVIOUS, TAG8_4S16)
    rows.append(("rcCommand[3]", 0, ZERO, UNSIGNED_VB, PREVIOUS, TAG8_4S16))
    several("setpoint", 4, 1, ZERO, SIGNED_VB, PREVIOUS, TAG8_4S16)
    rows.append(("vbatLatest", 0, VOLTAGE_REFERENCE, NEGATIVE_14, PREVIOUS, TAG8_8SVB))
    rows.append(("amperageLatest", 1, ZERO, SIGNED_VB, PREVIOUS, TAG8_8SVB))
    rows.append(("rssi", 0, ZERO, UNSIGNED_VB, PREVIOUS, TAG8_8SVB))
    several("gyroADC", 3, 1, ZERO, SIGNED_VB, AVERAGE, SIGNED_VB)
    several("gyroUnfilt", 3, 1, ZERO, SIGNED_VB, AVERAGE, SIGNED_VB)
    several("accSmooth", 3, 1, ZERO, SIGNED_VB, AVERAGE, SIGNED_VB)
    rows.append(("motor[0]", 0, LOWEST_MOTOR, UNSIGNED_VB, AVERAGE, SIGNED_VB))
    rows.extend((f"motor[{k}]", 0, MOTOR_0, SIGNED_VB, AVERAGE, SIGNED_VB) for k in (1, 2, 3))
    several("eRPM", 4, 0, ZERO, UNSIGNED_VB, PREVIOUS, SIGNED_VB)
    return rows


BLACKBOX_FIELDS = _fields()
FIELD_NAMES = tuple(row[0] for row in BLACKBOX_FIELDS)
_TABLE = np.array([row[1:] for row in BLACKBOX_FIELDS], dtype=np.int64)
SLOW_NAMES = ("flightModeFlags", "stateFlags", "failsafePhase", "rxSignalReceived", "rxFlightChannelsValid")
ARMED, ANGLE_MODE = 1, 2
DISARM_SWITCH = 4


FIRMWARE = "4.5.1"


def headers(settings: dict[str, str | None]) -> bytes:
    """The text before the frames; `settings` are added or replaced by name (`H name:value`), removed where None."""
    column = {k: ",".join(str(row[k]) for row in BLACKBOX_FIELDS) for k in range(6)}
    lines: dict[str, str | None] = {
        "Product": "Blackbox flight data recorder by Nicholas Sherlock",
        "Data version": "2",
        "Field I name": column[0],
        "Field I signed": column[1],
        "Field I predictor": column[2],
        "Field I encoding": column[3],
        "Field P predictor": column[4],
        "Field P encoding": column[5],
        "Field S name": ",".join(SLOW_NAMES),
        "Field S signed": "0,0,0,0,0",
        "Field S predictor": "0,0,0,0,0",
        "Field S encoding": f"{UNSIGNED_VB},{UNSIGNED_VB},{TAG2_3S32},{TAG2_3S32},{TAG2_3S32}",
        "Firmware type": "Cleanflight",
        "Firmware revision": f"Betaflight {FIRMWARE} (77d01ba3b) STM32F7X2",
        "Firmware date": "Jul 27 2024 08:36:31",
        "Board information": "MADE SYNTHETIC",
        "Log start datetime": "0000-01-01T00:00:00.000",
        "Craft name": "MadeBeetle",
        "I interval": "128",
        "P interval": "4",
        "P ratio": "32",
        "minthrottle": "1070",
        "maxthrottle": "2000",
        "gyro_scale": "0x3f800000",
        "motorOutput": "158,2047",
        "motor_kv": "3600",
        "acc_1G": "2048",
        "vbat_scale": "110",
        "vbatcellvoltage": "330,350,430",
        "vbatref": "1640",
        "currentSensor": "0,250",
        "looptime": "125",
        "gyro_sync_denom": "1",
        "pid_process_denom": "2",
        "rollPID": "45,80,30",
        "pitchPID": "47,84,34",
        "yawPID": "45,80,0",
        "gyro_hardware_lpf": "0",
        "gyro_lpf1_type": "0",
        "gyro_lpf1_static_hz": "250",
        "gyro_lpf1_dyn_hz": "0,0",
        "gyro_lpf2_type": "0",
        "gyro_lpf2_static_hz": "500",
        "gyro_notch_hz": "0,0",
        "gyro_notch_cutoff": "0,0",
        "gyro_to_use": "0",
        "dyn_notch_count": "0",
        "rpm_filter_harmonics": "0",
        "acc_lpf_hz": "100",
        "acc_hardware": "0",
        "dshot_bidir": "1",
        "motor_poles": "14",
        "motor_pwm_protocol": "6",
        "motor_pwm_rate": "480",
        "dshot_idle_value": "550",
        "debug_mode": "0",
        "fields_disabled_mask": "0",
        "blackbox_high_resolution": "0",
    }
    lines.update(settings)
    return "".join(f"H {name}:{value}\n" for name, value in lines.items() if value is not None).encode()


def _unsigned(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)


def slow_frame(flags: int, state: int) -> bytes:
    """An S frame: flight mode flags, state flags, no failsafe, signal and channels good (2 bits each in one byte)."""
    return b"S" + _unsigned(flags) + _unsigned(state) + bytes([0b00_00_01_01])


def event(kind: str, *values: int) -> bytes:
    """An E frame: "sync beep" (us), "resume" (iteration, us), "disarm" (reason), "flight mode" (now, before), "end"."""
    number = {"sync beep": 0, "resume": 14, "disarm": 15, "flight mode": 30, "end": 255}[kind]
    body = b"End of log\0" if kind == "end" else b"".join(_unsigned(v) for v in values)
    return b"E" + bytes([number]) + body


@njit(cache=True)
def _put_unsigned(out, at, value):
    value = value & 0xFFFFFFFF
    while value > 127:
        out[at] = (value & 127) | 128
        value >>= 7
        at += 1
    out[at] = value
    return at + 1


@njit(cache=True)
def _put_signed(out, at, value):
    zigzag = 2 * value if value >= 0 else -2 * value - 1
    return _put_unsigned(out, at, zigzag)


@njit(cache=True)
def _put_three(out, at, a, b, c):
    """TAG2_3S32: three values in 2, 4 or 6 bits each, or whole bytes chosen for each."""
    low, high = min(a, b, c), max(a, b, c)
    if low >= -2 and high < 2:
        out[at] = ((a & 3) << 4) | ((b & 3) << 2) | (c & 3)
        return at + 1
    if low >= -8 and high < 8:
        out[at] = 0x40 | (a & 15)
        out[at + 1] = ((b & 15) << 4) | (c & 15)
        return at + 2
    if low >= -32 and high < 32:
        out[at] = 0x80 | (a & 63)
        out[at + 1], out[at + 2] = b & 63, c & 63
        return at + 3
    tag, place = 0xC0, at
    at += 1
    for k in range(3):
        value = a if k == 0 else (b if k == 1 else c)
        size = 0
        if value < -8388608 or value > 8388607:
            size = 3
        elif value < -32768 or value > 32767:
            size = 2
        elif value < -128 or value > 127:
            size = 1
        tag |= size << (2 * k)
        for byte in range(size + 1):
            out[at] = (value >> (8 * byte)) & 255
            at += 1
    out[place] = tag
    return at


@njit(cache=True)
def _put_four(out, at, values, first):
    """TAG8_4S16: four values of 0, 4, 8 or 16 bits, packed by nibbles, high part first."""
    place, tag = at, 0
    at += 1
    nibbles, pending = 0, 0
    for k in range(4):
        value = values[first + k]
        size = 0
        if value < -128 or value > 127:
            size = 3
        elif value < -8 or value > 7:
            size = 2
        elif value != 0:
            size = 1
        tag |= size << (2 * k)
        count = 4 if size == 3 else size
        for n in range(count - 1, -1, -1):
            nibble = (value >> (4 * n)) & 15
            if nibbles == 0:
                pending, nibbles = nibble, 1
            else:
                out[at] = (pending << 4) | nibble
                at += 1
                nibbles = 0
    if nibbles:
        out[at] = pending << 4
        at += 1
    out[place] = tag
    return at


@njit(cache=True)
def _put_tagged(out, at, values, first, count):
    """TAG8_8SVB: a byte marks which of up to eight values differ from 0, then these; a single value stands alone."""
    if count == 1:
        return _put_signed(out, at, values[first])
    tag = 0
    for k in range(count):
        if values[first + k] != 0:
            tag |= 1 << k
    out[at] = tag
    at += 1
    for k in range(count):
        if values[first + k] != 0:
            at = _put_signed(out, at, values[first + k])
    return at


@njit(cache=True)
def _halved(total):
    """total / 2 towards zero, as C divides."""
    return total // 2 if total >= 0 else -((-total) // 2)


@njit(cache=True)
def _encode(values, table, whole_every, step, reference, lowest, motor, places, blobs, ends, out):
    """Frames of rows values (N, F), int64, into out (uint8).

    Blob k, blobs[ends[k-1]:ends[k]], comes before row places[k].
    A row whose iteration does not follow the one before by `step` waits for the next I frame, as a recorder that lost
    time does. Returns the number of bytes and of rows written.
    """
    n, f = values.shape
    diff = np.zeros(f, np.int64)
    last, older = np.zeros(f, np.int64), np.zeros(f, np.int64)
    at, rows, blob, begun = 0, 0, 0, False
    for i in range(n):
        while blob < len(places) and places[blob] <= i:
            start = ends[blob - 1] if blob > 0 else 0
            for k in range(start, ends[blob]):
                out[at] = blobs[k]
                at += 1
            blob += 1
        row = values[i]
        whole = row[0] % whole_every == 0
        if not whole and (not begun or row[0] != last[0] + step):
            begun = False
            continue
        out[at] = 73 if whole else 80  # I or P
        at += 1
        for k in range(f):
            predictor = table[k, 1] if whole else table[k, 3]
            guess = 0
            if predictor == 1:
                guess = last[k]
            elif predictor == 2:
                guess = 2 * last[k] - older[k]
            elif predictor == 3:
                guess = _halved(last[k] + older[k])
            elif predictor == 5:
                guess = row[motor]
            elif predictor == 9:
                guess = reference
            elif predictor == 11:
                guess = lowest
            diff[k] = row[k] - guess
        k = np.int64(0)  # as a literal it would be a type of its own, for which the functions are compiled again
        while k < f:
            encoding = table[k, 2] if whole else table[k, 4]
            if encoding == 0:
                at = _put_signed(out, at, diff[k])
                k += 1
            elif encoding == 1:
                at = _put_unsigned(out, at, diff[k])
                k += 1
            elif encoding == 3:
                at = _put_unsigned(out, at, (-diff[k]) & 0x3FFF)
                k += 1
            elif encoding == 6:
                count = 1
                while count < 8 and k + count < f and (table[k + count, 2] if whole else table[k + count, 4]) == 6:
                    count += 1
                at = _put_tagged(out, at, diff, k, count)
                k += count
            elif encoding == 7:
                at = _put_three(out, at, diff[k], diff[k + 1], diff[k + 2])
                k += 3
            elif encoding == 8:
                at = _put_four(out, at, diff, k)
                k += 4
            else:
                k += 1
        for k in range(f):
            # after a whole frame there is no older history: both are that frame
            older[k] = row[k] if whole else last[k]
            last[k] = row[k]
        begun = True
        rows += 1
    while blob < len(places):
        start = ends[blob - 1] if blob > 0 else 0
        for k in range(start, ends[blob]):
            out[at] = blobs[k]
            at += 1
        blob += 1
    return at, rows


def encode_log(
    values: np.ndarray,
    others: list[tuple[int, bytes]],
    settings: dict[str, str | None] | None = None,
    whole_every: int = 128,
    step: int = 4,
    reference: int = 1640,
) -> tuple[bytes, int]:
    """A whole log file, and how many rows of it were written.

    values  (N, fields) whole numbers by FIELD_NAMES; loopIteration counts loops, rows lie `step` loops apart and
    an I frame comes whenever it is a multiple of `whole_every`;
    others  (row, bytes) frames of other kinds, in order, each put before that row;
    settings  further or other headers; reference  hundredths of a volt, the header's vbatref.
    """
    text = {"I interval": str(whole_every), "P interval": str(step), "P ratio": str(whole_every // step)}
    head = headers({**text, "vbatref": str(reference), **(settings or {})})
    blobs = np.frombuffer(b"".join(b for _, b in others) or b"\0", np.uint8)
    ends = np.cumsum([len(b) for _, b in others], dtype=np.int64)
    places = np.array([row for row, _ in others], np.int64)
    out = np.empty(len(values) * (len(FIELD_NAMES) * 5 + 8) + len(blobs) + 16, np.uint8)
    data = np.ascontiguousarray(values, np.int64)
    motor = FIELD_NAMES.index("motor[0]")
    size, rows = _encode(data, _TABLE, whole_every, step, reference, 158, motor, places, blobs, ends, out)
    return head + out[:size].tobytes(), rows
