"""Round trip: a model is flown, its flights are written as raw logs, and the pipeline must find the same model again.

    python benchmarks/round_trip.py [MODEL] [--flights 6] [--seconds 90] [--seed 1] [--cores 2] [--keep]

1. Simulates MODEL (default models/example/standalone) with INDI along rich references, one more flight for validation.
2. Writes each as a Betaflight log and a Motive export, with rest on the ground, sensor noise, whole-number units and
   two clocks, and lays a project folder results/round_trip for them.
3. Runs snakemake for models/round_trip/standalone there; the specification has MODEL's terms and no others.
4. Compares coefficients (share within two standard errors), forces and moments on the validation flight, and flies both
   models along the validation reference: root mean square tracking error of the one beside the other.
Writes results/benchmarks/round_trip.json. Not covered: the choice of terms, which this trip takes as known.
"""

import argparse
import math
import shutil
import subprocess
import sys
from pathlib import Path

import measured_table
import numpy as np

from quasi.model.model import Model, read_model
from quasi.simulation.control.control_model import make_control_model
from quasi.simulation.control.gains import complete_settings
from quasi.simulation.loop.run import simulate
from quasi.simulation.loop.setup import make_setup
from quasi.tables import read_json, write_bytes, write_json, write_text
from quasi_synthesis import campaign
from quasi_synthesis.controller import command_for, control_of
from quasi_synthesis.flight import LOGGED_SIGNALS, MOTOR_HIGH, MOTOR_LOW
from quasi_synthesis.motive_writer import motive_csv
from quasi_synthesis.nuisance import Setup, nominal
from quasi_synthesis.pilot import OFF_TIME, REST_BEFORE
from quasi_synthesis.recorder import record
from quasi_synthesis.sensors import capture
from quasi_synthesis.vehicle import base_vehicle

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "results/round_trip"
RATE = 1000  # Hz, of simulation and log
GYRO_NOISE, ACC_NOISE = 0.01, 0.1  # rad/s, m/s2, standard deviations of one sample


def rich_reference(seconds: float, seed: int) -> dict[str, np.ndarray]:
    """Sums of sines in position and heading that begin and end in hover, as a table for the kind "table"."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds + 0.005, 0.01)
    ramp = np.clip((t - 2.0) / 4.0, 0.0, 1.0) * np.clip((seconds - 2.0 - t) / 4.0, 0.0, 1.0)
    fade = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    table = {"t": t}
    for axis, strength in (("x", 1.8), ("y", 1.8), ("z", 1.3)):
        total = np.zeros(len(t))
        for slow, fast in ((0.09, 0.15), (0.2, 0.35), (0.4, 0.65), (0.7, 1.0), (1.0, 1.4)):
            w = 2.0 * math.pi * rng.uniform(slow, fast)
            total += strength * rng.uniform(0.6, 1.2) / w**2 * np.sin(w * t + rng.uniform(0.0, 2.0 * math.pi))
        table[axis] = fade * total
    heading = sum(
        rng.uniform(0.4, 1.0) / w * np.sin(w * t + rng.uniform(0.0, 2.0 * math.pi))
        for w in 2.0 * math.pi * np.array([rng.uniform(0.05, 0.15), rng.uniform(0.2, 0.5), rng.uniform(0.6, 1.2)])
    )
    table["yaw"] = fade * heading
    return table


def settings(model_id: str, seconds: float, seed: int, asymmetric: bool = True) -> dict:
    """The simulation of one flight."""
    return {
        "model": {"use identified model": True, "model ID": model_id, "correct for moment asymmetries": not asymmetric},
        "noise": {"add": True, "seed": seed},
        "controller": {"controller": "drone_INDI"},
        "actuator": {"actuator": "rotorDynamicsV2"},
        "simulation": {"time step": 1.0 / RATE, "duration": seconds},
        "references": {"kind": "table", "file": "round_trip"},
    }


def fly(model: Model, seconds: float, seed: int):
    """One simulated flight; raises SystemExit when it was lost."""
    made = make_setup(settings(model.id, seconds, seed), model, reference=rich_reference(seconds, seed))
    result = simulate(made)
    if result.stopped:
        sys.exit(f"flight {seed}: {result.stopped}")
    return result


def write_raw(result, key: str, seed: int, sensed: Setup) -> None:
    """A simulated flight as raw files, with its rest on the ground before it."""
    rng = np.random.default_rng(1000 + seed)
    table = result.table
    before = int(REST_BEFORE * RATE)
    t = np.arange(before + len(table)) / RATE
    drive = control_of(base_vehicle())

    def with_rest(name: str, at_rest: float = 0.0) -> np.ndarray:
        return np.concatenate([np.full(before, at_rest), table[name].to_numpy()])

    log = np.zeros((len(t), len(LOGGED_SIGNALS)))
    column = {name: k for k, name in enumerate(LOGGED_SIGNALS)}
    specific = {a: with_rest(f"F{a}") / result.setup.airframe.mass for a in "xyz"}
    specific["z"][:before] = -9.81
    idle = (t >= OFF_TIME) & (t < REST_BEFORE)
    for k, axis in enumerate("xyz"):
        rate = with_rest("pqr"[k]) + rng.normal(0.0, GYRO_NOISE, len(t))
        log[:, column[f"gyro{k}"]] = log[:, column[f"raw{k}"]] = rate
        log[:, column[f"acc{k}"]] = specific[axis] + rng.normal(0.0, ACC_NOISE, len(t))
    for i in range(4):
        speed, command = with_rest(f"w{i + 1}"), with_rest(f"w{i + 1}_CMD")
        speed[idle] = command[idle] = result.setup.loop_parameters.drive.low
        log[:, column[f"erpm{i}"]] = speed * sensed.telemetry.to_log
        share = [command_for(c, drive.idle_speed, drive.max_speed, drive.curvature) for c in command]
        log[:, column[f"motor{i}"]] = MOTOR_LOW + np.array(share) * (MOTOR_HIGH - MOTOR_LOW)
    log[:, column["voltage"]], log[:, column["current"]] = 15.6, 20.0
    position = np.column_stack([with_rest(a) for a in "xyz"])
    position[:before] = table[["x", "y", "z"]].to_numpy()[0]
    attitude = np.column_stack([with_rest(f"q{c}", float(c == "w")) for c in "wxyz"])
    attitude[:before] = attitude[before]
    take = capture(t, position, attitude, sensed.capture, rng)
    onboard, _ = record(log, t, "MadeBeetle", RATE, sensed, rng)
    paths = campaign.raw_paths(_campaign([key]), key)
    write_bytes(FOLDER / _given(paths["onboard"]), onboard)
    write_text(
        FOLDER / _given(paths["capture"]),
        motive_csv(take, campaign.BODY, key, f"{campaign.FLIGHT_DATE} 10.21.33.412 AM"),
    )


def _given(text: str) -> str:
    """Paths of raw files that no rule makes."""
    return text.replace("results/synthesis/round_trip", "data/raw")


def _campaign(keys: list[str]):
    flights = [{"key": key, "profile": "mixed"} for key in keys]
    return campaign.read_campaign({"quadrotor": "MadeBeetle", "seed": 1, "flights": flights}, "round_trip")


def sensors(seed: int) -> Setup:
    """Clocks and capture of a flight: its filters off, for the simulated sensors have none."""
    rng = np.random.default_rng(seed)
    setup = nominal(120.0, 1.0)
    return setup._replace(
        inertial=setup.inertial._replace(gyro_cut_1=0.0, gyro_cut_2=0.0, acc_cut=0.0),
        capture=setup.capture._replace(start=-rng.uniform(0.8, 2.8), skew=2.5e-5 * rng.standard_normal()),
        clock_rate=2.5e-5 * rng.standard_normal(),
        boot=rng.uniform(15.0, 90.0),
    )


def lay(model: Model, keys: list[str]) -> None:
    """The project folder: logbook, quadrotor configuration, processing, model and its specification."""
    made = _campaign(keys)
    write_text(FOLDER / "data/round_trip_file_log.csv", _given(campaign.logbook_csv(made)))
    shutil.copy(ROOT / "data/MadeBeetleConfig.json", FOLDER / "data/MadeBeetleConfig.json")
    processing = read_json(ROOT / "config/processing.json")
    rows = [f"2-{len(keys) + 1}"]
    processing["logging file"] |= {"filename": "round_trip_file_log", "rows of flights to use (all)": rows}
    identification = {
        "logging file": {
            "directory": "data",
            "filename": "round_trip_file_log",
            "rows of flights to use (all)": rows,
            "rows of flights for validation": [len(keys) + 1],
        },
        "identification parameters": {
            "polynomial specification file": "round_trip",
            "polynomial": {"regressor cap": 0, "bootstrap": 0},
        },
    }
    terms = {
        a: [t["expression"] for t in model.document["axes"][a]["terms"] if t["expression"] != "1"] for a in model.axes
    }
    specification = {a: {"candidates": [], "fixed": terms[a]} for a in model.axes}
    for name, content in (
        ("processing", processing),
        ("models/round_trip", identification),
        ("polynomials/round_trip", specification),
    ):
        write_json(FOLDER / f"config/{name}.json", content)
    shutil.copy(ROOT / "config/config.yaml", FOLDER / "config/config.yaml")


def coefficients(true: Model, found: Model) -> list[dict]:
    """Every coefficient beside its truth, in standard errors."""
    rows = []
    for axis in true.axes:
        truth = {t["expression"]: t["coefficient"] for t in true.document["axes"][axis]["terms"]}
        for term in found.document["axes"][axis]["terms"]:
            value, std = term["coefficient"], term["std"]
            error = value - truth[term["expression"]]
            rows.append({"axis": axis, "term": term["expression"], "true": truth[term["expression"]], "found": value,
                         "std": std, "errors": error / std})  # fmt: skip
    return rows


def tracking(model: Model, reference: dict[str, np.ndarray], seconds: float, seed: int, gains: dict) -> float:
    """Root mean square distance from the reference, m, after the first 6 s, with these gains of the controller."""
    asked = settings(model.id, seconds, seed)
    asked["controller"]["gains"] = gains
    table = simulate(make_setup(asked, model, reference=reference)).table
    late = table["t"].to_numpy() > 6.0
    error = table[["x", "y", "z"]].to_numpy() - table[["x_ref", "y_ref", "z_ref"]].to_numpy()
    return float(np.sqrt(np.mean(np.sum(error[late] ** 2, axis=1))))


def main() -> None:
    """Run the trip and print what it found."""
    ask = argparse.ArgumentParser()
    ask.add_argument("model", nargs="?", default="models/example/standalone")
    ask.add_argument("--flights", type=int, default=6)
    ask.add_argument("--seconds", type=float, default=90.0)
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--cores", type=int, default=2)
    ask.add_argument("--keep", action="store_true", help="compare what stands in results/round_trip, make nothing")
    ask.add_argument("--house", type=Path, default=ROOT, help="checkout whose Snakefile runs")
    ask.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    asked = ask.parse_args()
    true = read_model(asked.model)
    keys = [f"trip-{k + 1:02d}" for k in range(asked.flights + 1)]
    if not asked.keep:
        shutil.rmtree(FOLDER, ignore_errors=True)
        lay(true, keys)
        for number, key in enumerate(keys):
            result = fly(true, asked.seconds, asked.seed + number)
            write_raw(result, key, asked.seed + number, sensors(asked.seed + number))
            speed = result.table[["u", "v", "w"]].to_numpy()
            print(f"{key}: flown, fastest {np.linalg.norm(speed, axis=1).max():.1f} m/s", flush=True)
        command = [sys.executable, "-m", "snakemake", "-s", str(asked.house / "Snakefile"), "-d", str(FOLDER),
                   "-j", str(asked.cores), "models/round_trip/standalone"]  # fmt: skip
        subprocess.run(command, check=True)
    found = read_model(FOLDER / "models/round_trip/standalone")
    rows = coefficients(true, found)
    within = {a: float(np.mean([abs(r["errors"]) <= 2.0 for r in rows if r["axis"] == a])) for a in true.axes}
    share = float(np.mean([abs(r["errors"]) <= 2.0 for r in rows]))
    for row in rows:
        print(f"{row['axis']}  {row['term']:<50} {row['true']:>12.4e} {row['found']:>12.4e} {row['errors']:>7.2f}")
    print(f"within two standard errors: {100 * share:.1f} % of {len(rows)} coefficients; by axis "
          + ", ".join(f"{a} {100 * s:.0f} %" for a, s in within.items()))  # fmt: skip
    seed = asked.seed + asked.flights
    reference = rich_reference(asked.seconds, seed)
    # the same controller for both: gains derived anew from the found lag and delay would be other gains
    gains = complete_settings({"controller": "INDI", "time step": 1.0 / RATE}, make_control_model(true))["gains"]
    before, after = (tracking(m, reference, asked.seconds, 99, gains) for m in (true, found))
    change = 100 * (after / before - 1)
    print(f"tracking error {before:.4f} m with the model, {after:.4f} m with what was found: {change:+.1f} %")
    flown = simulate(make_setup(settings(true.id, asked.seconds, 99), true, reference=reference)).table
    loads = {m.id: m.predict_columns(flown) for m in (true, found)}
    difference = {
        a: float(np.std(loads[found.id][a] - loads[true.id][a]) / np.std(loads[true.id][a])) for a in true.axes
    }
    print("relative difference of the predictions: " + ", ".join(f"{a} {100 * d:.2f} %" for a, d in difference.items()))
    report = {
        "share within two standard errors": share,
        "by axis": within,
        "tracking error": {"model": before, "found": after},
        "relative difference of predictions": difference,
        "coefficients": rows,
        "flights": asked.flights,
        "seconds": asked.seconds,
        "seed": asked.seed,
    }
    write_json(ROOT / "results/benchmarks/round_trip.json", report)
    if asked.record:
        worst = {kind: max(v for a, v in difference.items() if a[0] == kind) for kind in "FM"}
        figures = {"within": share, "coefficients": len(rows), "tracking": abs(change) / 100}
        measured_table.record("round_trip", {**figures, "forces": worst["F"], "moments": worst["M"]})


if __name__ == "__main__":
    main()
