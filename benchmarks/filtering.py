"""Speed of the filter: samples per second on one core, and the time a whole flight takes.

    python benchmarks/filtering.py [--seconds 90] [--repeats 5] [--skip-filterpy] [--record]

A made flight of 90 s (raw log and capture, imported at 500 Hz) is filtered. Printed, as figure and as share of its
target: samples per second of the forward filter and of filter and smoother together (18 states, attitude and position
captured at 120 Hz), the same through filterpy, and the process time of the whole filtering stage beyond imports and
compilation. The best of the repeats counts; written to results/benchmarks/filtering.json.
"""

import argparse
import sys
import time

import numpy as np
import pandas as pd
from measured_table import record
from stopwatch import best
from study import ROOT, fly

from quasi.airframe import read_airframe
from quasi.filtering import bias, ekf, filterpy_engine, measurements, noise
from quasi.filtering.flight import filter_flight
from quasi.filtering.smoother import smooth
from quasi.tables import write_json

FORWARD, BOTH, STAGE = 1_000_000.0, 500_000.0, 2.0  # targets: samples/s, samples/s, s
PLAIN = 4_065.0  # samples/s of the published pipeline's filter, interpreted


def inputs_of(frame: pd.DataFrame, about: dict) -> ekf.Inputs:
    """Inputs of one pass, noise levels as they begin."""
    dt = measurements.time_step(frame["t"].to_numpy())
    imu = measurements.read_imu(frame)
    ground = bias.find_ground(imu.gyro, imu.accel, frame[["w1", "w2", "w3", "w4"]].to_numpy(), None, dt)
    measured = measurements.collect(frame, about, {}, ground, dt)
    quaternion, state, covariance = measurements.start(frame, measured, imu, dt, True, True)
    return ekf.Inputs(
        dt,
        imu.gyro,
        imu.accel,
        np.tile([0.02] * 3 + [0.3] * 3, (len(frame), 1)),
        np.array([1e-5] * 3 + [1e-4] * 3),
        measured.used,
        measured.attitude,
        np.ascontiguousarray(np.nan_to_num(measured.position)),
        np.ascontiguousarray(np.nan_to_num(measured.velocity)),
        measured.body,
        measured.std,
        noise.GATE,
        np.array([100, 100, 100]),
        quaternion,
        state,
        covariance,
    )


def main() -> int:
    """Run the benchmark; 0 where the targets are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--skip-filterpy", action="store_true")
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    options = parser.parse_args()
    _, frame, about, quadrotor = fly("a", profile="mixed", seed=7, duration=options.seconds)
    airframe = read_airframe(quadrotor, "made")
    inputs, n = inputs_of(frame, about), len(frame)
    print(f"{n} samples, {inputs.dt * n:.1f} s, {int(inputs.used.sum())} measurements of three numbers")
    forward = n / best(lambda: ekf.forward(inputs), options.repeats, time.process_time)
    both = n / best(lambda: smooth(inputs, ekf.forward(inputs)), options.repeats, time.process_time)
    stage = best(lambda: filter_flight(frame, about, airframe, {}), min(options.repeats, 3), time.process_time)
    result = {"forward": forward, "forward and smoother": both, "stage s": stage}
    rows = [
        ("forward filter", forward, "samples/s", FORWARD, forward / FORWARD),
        ("forward filter and smoother", both, "samples/s", BOTH, both / BOTH),
        ("filtering stage, whole flight", stage, "s", STAGE, STAGE / stage),
    ]
    for name, figure, unit, target, ratio in rows:
        print(f"{name:32}{figure:>12,.4g} {unit:<10} target {target:>9,.6g}: {ratio:.2f} times as good")
    print(f"{'forward filter':32}{forward / PLAIN:>12.0f} times the published pipeline's {PLAIN:,.0f} samples/s")
    if not options.skip_filterpy:
        slow = n / best(lambda: filterpy_engine.forward(inputs), 1, time.process_time)
        staged = best(lambda: filter_flight(frame, about, airframe, {"engine": "filterpy"}), 1, time.process_time)
        result |= {"filterpy forward": slow, "filterpy stage s": staged}
        print(f"{'engine filterpy, forward':32}{slow:>12,.4g} samples/s, 1/{forward / slow:.0f} of the compiled")
        print(f"{'engine filterpy, stage':32}{staged:>12.3g} s, {staged / stage:.1f} times the compiled")
    write_json(ROOT / "results/benchmarks/filtering.json", result)
    if options.record:
        record("filtering", result)
    return 0 if all(row[-1] >= 1 for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
