"""What the flight controller records: the loop's rows as whole numbers in the log's units and axes, frame by frame."""

import math

import numpy as np

from quasi import attitude
from quasi_synthesis import blackbox_writer as blackbox
from quasi_synthesis import vehicle as made
from quasi_synthesis.controller import control_of
from quasi_synthesis.flight import LOGGED_SIGNALS, LOOP, MOTOR_HIGH, MOTOR_LOW
from quasi_synthesis.nuisance import Setup
from quasi_synthesis.pilot import OFF_TIME, REST_BEFORE
from quasi_synthesis.sensors import BIQUAD, NO_FILTER, PT1, PT2


def record(
    log: np.ndarray, t: np.ndarray, craft: str, log_rate: int, setup: Setup, rng: np.random.Generator
) -> tuple[bytes, list[list[float]]]:
    """The blackbox file, and the spans (s since its first frame) that the recorder lost.

    log (N, len(LOG)) from the flight loop at true times t (N,), s; craft  its name in the headers; log_rate Hz.
    """
    column = {name: log[:, i] for i, name in enumerate(LOGGED_SIGNALS)}
    n = len(log)
    values = {name: np.zeros(n) for name in blackbox.FIELD_NAMES}
    step = int(LOOP) // log_rate
    values["loopIteration"] = 1024 + step * np.arange(n)  # a multiple of the I interval, so that the log begins whole
    clock = (setup.boot + t * (1.0 + setup.clock_rate)) * 1e6
    late = setup.jitter * 1e6 * rng.standard_normal(n)
    late[0] = 0.0  # the log's time begins here
    values["time"] = clock + late
    degrees, counts = 180.0 / math.pi, 2048.0 / attitude.GRAVITY
    flip = (1.0, -1.0, -1.0)  # y left and z up in the log
    full = control_of(made.base_vehicle()).inertia * 400.0
    for k in range(3):
        values[f"gyroADC[{k}]"] = flip[k] * degrees * column[f"gyro{k}"]
        values[f"gyroUnfilt[{k}]"] = flip[k] * degrees * column[f"raw{k}"]
        values[f"accSmooth[{k}]"] = flip[k] * counts * column[f"acc{k}"]
        values[f"setpoint[{k}]"] = flip[k] * degrees * column[f"wish{k}"]
        values[f"rcCommand[{k}]"] = np.clip(values[f"setpoint[{k}]"] * 0.75, -500, 500)
        for term, field in (("P", "axisP"), ("I", "axisI"), ("F", "axisF")):
            values[f"{field}[{k}]"] = flip[k] * 500.0 * column[f"{term}{k}"] / full[k]
    values["setpoint[3]"] = 1000.0 * column["throttle"]
    values["rcCommand[3]"] = 1000.0 + 1000.0 * column["throttle"]
    values["vbatLatest"] = 100.0 * column["voltage"]
    values["amperageLatest"] = 100.0 * column["current"]
    values["rssi"] = np.full(n, 1023.0)
    for k in range(4):
        values[f"motor[{k}]"], values[f"eRPM[{k}]"] = column[f"motor{k}"], column[f"erpm{k}"]
    whole = np.rint(np.column_stack([values[name] for name in blackbox.FIELD_NAMES])).astype(np.int64)

    def row_at(seconds: float) -> int:
        return min(int(np.searchsorted(t, seconds)), n)

    armed = row_at(OFF_TIME)
    flags = blackbox.ANGLE_MODE
    others: list[tuple[int, bytes]] = [
        (0, blackbox.slow_frame(flags, 0)),
        (0, blackbox.event("sync beep", int(whole[0, 1]))),
        (armed, blackbox.event("flight mode", flags | blackbox.ARMED, flags)),
        (armed, blackbox.slow_frame(flags | blackbox.ARMED, 31)),
        (n, blackbox.event("disarm", blackbox.DISARM_SWITCH)),
        (n, blackbox.event("end")),
    ]
    keep, lost = np.ones(n, bool), []
    for _ in range(setup.log_gaps):
        start = float(rng.uniform(REST_BEFORE + 4.0, max(t[-1] - 2.0, REST_BEFORE + 4.5)))
        a, b = row_at(start), row_at(start + float(rng.uniform(0.05, 0.4)))
        keep[a:b] = False
        # by the log's own clock, as every time of it
        lost.append([(1.0 + setup.clock_rate) * float(t[row]) for row in (a, min(b, n - 1))])
    # a frame of another kind that was due inside a gap comes with the first row after it
    position = np.cumsum(keep) - keep
    others = [(int(position[row]) if row < n else int(keep.sum()), data) for row, data in others]
    interval = max(int(0.032 * LOOP) // step, 1) * step
    settings = {
        "Craft name": craft,
        "motorOutput": f"{MOTOR_LOW},{MOTOR_HIGH}",
        "motor_poles": str(made.POLES),
        **filter_settings(setup),
    }
    reference = int(whole[0, blackbox.FIELD_NAMES.index("vbatLatest")])
    data, _ = blackbox.encode_log(whole[keep], others, settings, whole_every=interval, step=step, reference=reference)
    return data, lost


# Betaflight's numbers of the low-pass types; before version 4.3 there are no PT2 and PT3
_TYPE_NUMBERS = {PT1: 0, BIQUAD: 1, PT2: 2}


def filter_settings(setup: Setup) -> dict[str, str | None]:
    """Headers that declare firmware and filters under the names of that version; None removes a default header."""
    s = setup.inertial
    old = setup.firmware < "4.3"
    settings: dict[str, str | None] = {"acc_lpf_hz": f"{s.acc_cut:.0f}"}
    if setup.firmware != blackbox.FIRMWARE:
        settings["Firmware revision"] = f"Betaflight {setup.firmware} (000000000) STM32F7X2"
    if old:
        settings |= {f"gyro_lpf{i}_{part}": None for i in (1, 2) for part in ("type", "static_hz")}
        settings |= {"gyro_lpf1_dyn_hz": None}
    for i, (kind, cut) in enumerate(((s.gyro_kind_1, s.gyro_cut_1), (s.gyro_kind_2, s.gyro_cut_2)), start=1):
        number = "" if i == 1 else "2"
        names = (f"gyro_lowpass{number}_type", f"gyro_lowpass{number}_hz") if old else (
            f"gyro_lpf{i}_type", f"gyro_lpf{i}_static_hz")  # fmt: skip
        settings[names[0]] = str(_TYPE_NUMBERS.get(kind, 0))
        settings[names[1]] = f"{cut:.0f}" if kind != NO_FILTER else "0"
    return settings
