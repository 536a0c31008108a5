"""Made flights for tests of identification and models: smooth random motion and polynomial forces."""

import numpy as np
import pandas as pd
from airframes import BEETLE
from scipy.signal import butter, sosfiltfilt

from quasi.airframe import read_airframe
from quasi.attitude import GRAVITY

AIRFRAME = read_airframe({**BEETLE, "mass": 0.433}, "test")
THRUST, ROLL, PITCH, YAW = 1.3e-6, 1.0e-7, 1.1e-7, 2.0e-8
HOVER = float(np.sqrt(AIRFRAME.mass * GRAVITY / (4 * THRUST)))


def flight(seed, rows=8000, rate=500.0, noise=0.02):
    """Columns t, w1..w4, w1_dot.., motion, Fx..Mz as the accelerometer feels them; noise as a share of their spread."""
    r = np.random.default_rng(seed)
    low = butter(2, 3.0, fs=rate, output="sos")

    def smooth(size):
        x = sosfiltfilt(low, r.standard_normal(rows + 800))[400:-400]
        return size * x / x.std()

    d = {"t": np.arange(rows) / rate}
    d |= {f"w{i}": HOVER + smooth(60.0) for i in range(1, 5)}
    d |= {f"w{i}_dot": np.gradient(d[f"w{i}"], 1 / rate) for i in range(1, 5)}
    sizes = {
        "u": 3,
        "v": 3,
        "w": 1.5,
        "p": 2,
        "q": 2,
        "r": 1,
        "roll": 0.08,
        "pitch": 0.08,
        "yaw": 1,
        "x": 1,
        "y": 1,
        "z": 1,
    }
    d |= {name: smooth(size) for name, size in sizes.items()}
    w1, w2, w3, w4 = (d[f"w{i}"] for i in range(1, 5))
    total = w1 + w2 + w3 + w4
    d["Fx"] = -2e-5 * d["u"] * total - 0.01 * d["u"]
    d["Fy"] = -2e-5 * d["v"] * total - 0.01 * d["v"]
    d["Fz"] = -THRUST * (w1**2 + w2**2 + w3**2 + w4**2) + 8e-5 * d["w"] * total - 0.01 * d["u"] ** 2
    d["Mx"] = ROLL * (w4**2 + w3**2 - w2**2 - w1**2) - 5e-4 * d["p"]
    d["My"] = PITCH * (w4**2 + w2**2 - w3**2 - w1**2) - 5e-4 * d["q"]
    d["Mz"] = YAW * (w1**2 + w4**2 - w2**2 - w3**2) - 5e-4 * d["r"]
    for axis in ("Fx", "Fy", "Fz", "Mx", "My", "Mz"):
        d[axis] = d[axis] + noise * d[axis].std() * r.standard_normal(rows)
    return pd.DataFrame(d)
