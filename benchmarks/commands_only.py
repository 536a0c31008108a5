"""Rotor speeds estimated from commands: against telemetry that was withheld, and on real flights without any.

    python benchmarks/commands_only.py withheld [--flights 1 2 3] [--record]   the bundled example, in this folder
    python benchmarks/commands_only.py nanobench PATH [--record]               PATH holds nanobench/ as published

`withheld` filters imported flights of the example again without their rotor speeds, estimates these from commands and
battery voltage, and prints: ratio of torque to thrust factors and time constants against those from telemetry, rms
error of the speeds after one common scale, and rms error of Fz and moments by the simple rotor model of either speeds.
Estimated speeds have the lag of thrust. The errors are printed as well for speeds with the rotors' own lag, by the yaw
moment, as telemetry has it. Then least squares of the measured Fz and moments on squared speeds, damping and airspeed,
with and without W dW/dt: thrust leads the rotor speed, because the air through the rotor follows late. Printed are R2
of the measurement, and the rms error against the truth below the low-pass, over the rms of the truth about its mean.
`nanobench` makes the model of examples/crazyflie through the workflow and prints its scores on held-out flights, arms,
the mean error of roll-outs of 0.1, 0.2 and 0.5 s over that of holding the last state, the same with the trim of the 2 s
before each start (less the look-ahead of the low-pass), and the difference of held-out flights from the moment factors
of the training flights over the standard error that is stated for one flight.
Both write results/benchmarks/commands_only_*.json.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from measured_table import record
from plain_rollout import hold_states, trim_before
from scipy.signal import butter, sosfiltfilt

from quasi.airframe import Airframe, read_airframe
from quasi.filtering.flight import filter_flight
from quasi.filtering.rotor_speeds import add_estimated_speeds, read_flight
from quasi.identification.flight_scatter import flight_factor
from quasi.identification.joint_fit import JOINT_AXES, JointFit, prepare_flight
from quasi.identification.partition import partition, usable
from quasi.identification.rotor_rows import rows_within_limits
from quasi.identification.rotor_speeds import rotor_speeds_of
from quasi.identification.shared import shared
from quasi.model.model import read_model
from quasi.simulation.tools.rollout import compute_errors, count_steps, rollout
from quasi.tables import read_json, read_made, read_table, write_json
from quasi.terms.rotor_map import SPEEDS, WARM_UP_NAMES, used_rows

ROOT = Path(__file__).parents[1]
STATE = ["roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z"]
HORIZONS, EVERY = (0.1, 0.2, 0.5), 0.1  # s
TRIM = 2.0  # s of the trim before each start, as in nanodrone.py


def thrusts_and_moments(table, airframe, factors) -> np.ndarray:
    """Fz, Mx, My, Mz (N, 4) of the simple rotor model, with the factors given."""
    squares = table[list(SPEEDS)].to_numpy(float) ** 2
    signs = np.stack([-np.ones(4), airframe.left, airframe.front, airframe.spin])
    kappa = [factors[f"kappa{axis}"]["value"] for axis in JOINT_AXES]
    return np.stack([k * squares @ s for k, s in zip(kappa, signs)], axis=1)


def withheld(numbers: list[int]) -> dict:
    """Print and return what estimation from commands makes of flights whose telemetry is known."""
    options = {**read_json(ROOT / "config/processing.json")["data filtering"]}
    quadrotor = read_json(ROOT / "data/MadeBeetleConfig.json")
    keys, measured, blind, masses = [f"example-{n:02d}" for n in numbers], {}, {}, {}
    targets = [f"results/filtered/MadeBeetle/withGravity/{key}.parquet" for key in keys]
    subprocess.run([sys.executable, "-m", "snakemake", "-j2", "--", *targets], cwd=ROOT, check=True)
    airframe = None
    for key, path in zip(keys, targets):
        measured[key], about = read_table(ROOT / path), read_made(ROOT / path)
        masses[key] = about["mass"]
        airframe = read_airframe(quadrotor, "example", about["mass"])
        imported = ROOT / f"results/imported/MadeBeetle/{key}"
        table, metadata = read_table(imported.with_suffix(".parquet")), read_json(imported.with_suffix(".json"))
        table = table.drop(columns=[c for c in table if c[0] == "w" and c[1:2].isdigit()])
        found = filter_flight(table, metadata, airframe, {**about["options"], **options})
        blind[key] = found.with_gravity, found.metadata
    tables = {key: table for key, (table, _) in blind.items()}
    whole = {"random partition": False, "usable data ratio": 0.9}
    drive, notes = rotor_speeds_of(tables, airframe, masses, {}, partition(tables, options=whole))
    print("\n".join(notes))
    estimated = {key: add_estimated_speeds(table, made, drive) for key, (table, made) in blind.items()}
    truth = shared(measured, partition(measured, options=whole), airframe, masses=masses)
    own = shared(estimated, partition(estimated, options=whole), airframe, masses=masses, drive=drive)
    report = {"drive": {k: drive[k] for k in ("form", "time constant", "delay", "voltage exponent", "relative error")}}
    tau = float(np.mean(truth["actuators"]["time constants"]["value"]))
    report["time constant"] = {"telemetry": tau, "ratio": drive["time constant"]["value"] / tau}
    if drive["yaw"]:
        report["time constant"]["ratio by yaw moment"] = drive["yaw"]["time constant"]["value"] / tau
    base = {name: f["simple model"]["kappaFz"]["value"] for name, f in (("telemetry", truth), ("commands", own))}
    report["factors"] = {
        axis: own["simple model"][f"kappa{axis}"]["value"]
        / base["commands"]
        / (truth["simple model"][f"kappa{axis}"]["value"] / base["telemetry"])
        for axis in JOINT_AXES[1:]
    }
    kinds = {"lag of thrust": estimated}
    if drive["yaw"]:
        turning = drive | {name: drive["yaw"][name] for name in ("time constant", "delay")}
        kinds["lag of the rotors"] = {k: add_estimated_speeds(t, made, turning) for k, (t, made) in blind.items()}
    truth_of_axes = {key: true_axes(key, table, options) for key, table in measured.items()}
    for name, tables in kinds.items():
        report[name] = compared(measured, tables, airframe, (truth["simple model"], own["simple model"]))
    fits = {"telemetry": measured, **kinds}
    report["fits"] = {
        f"{name}{', with W dW/dt' if lead else ''}": fitted(measured, tables, airframe, truth_of_axes, lead)
        for name, tables in fits.items()
        for lead in (False, True)
    }
    return report


def true_axes(key: str, table: pd.DataFrame, options: dict) -> dict[str, np.ndarray]:
    """True Fz and moments (N,) of a made flight at the times of its filtered table, below the same low-pass."""
    start = read_json(ROOT / f"results/imported/MadeBeetle/{key}.json")["start"]["value"]
    whole = read_table(ROOT / f"results/synthesis/example/truth/{key}.parquet")
    t = whole["t"].to_numpy(float)
    low = butter(4, options.get("low-pass cutoff Hz", 40.0), fs=1.0 / float(np.median(np.diff(t))), output="sos")
    at = table["t"].to_numpy(float) + start
    return {axis: np.interp(at, t, sosfiltfilt(low, whole[axis].to_numpy(float))) for axis in JOINT_AXES}


def compared(measured: dict, estimated: dict, airframe: Airframe, models: tuple[dict, dict]) -> dict:
    """Errors of estimated speeds against measured ones. models  simple models of telemetry and of commands"""
    speeds, loads, size = [], [], []
    for key, a in measured.items():
        b = estimated[key]
        rows = used_together(a, b)
        w, v = a[list(SPEEDS)].to_numpy(float)[rows], b[list(SPEEDS)].to_numpy(float)[rows]
        v = v * float(np.sum(w * v) / np.sum(v * v))
        speeds.append(((v - w) / w.mean()).ravel())
        by_telemetry = thrusts_and_moments(a[rows], airframe, models[0])
        loads.append(thrusts_and_moments(b[rows], airframe, models[1]) - by_telemetry)
        size.append(by_telemetry)
    error, scale = (np.sqrt(np.mean(np.concatenate(x) ** 2, axis=0)) for x in (loads, size))
    speed = float(np.sqrt(np.mean(np.concatenate(speeds) ** 2)))
    return {"speed rms": speed, "rms over rms": dict(zip(JOINT_AXES, (error / scale).tolist()))}


def used_together(a: pd.DataFrame, b: pd.DataFrame) -> np.ndarray:
    """True (N,) in the middle rows of a flight that are used in both of its tables."""
    rows = np.zeros(len(a), bool)
    rows[usable(len(a), 0.9)] = True
    return rows & used_rows(a) & used_rows(b)


def fitted(measured: dict, speeds: dict, airframe: Airframe, truth: dict, lead: bool) -> dict[str, dict[str, float]]:
    """R2 of measured Fz and moments by least squares on squared speeds, damping, airspeed and rotor acceleration, and
    the error against the truth. lead  with the term in W dW/dt, whose coefficient is a time by which thrust leads"""
    signs = np.stack([-np.ones(4), airframe.left, airframe.front, airframe.spin])
    found = {}
    for axis, sign in zip(JOINT_AXES, signs):
        y, x, true = [], [], []
        for key, table in measured.items():
            rows = used_together(table, speeds[key])
            a, b = table[rows], speeds[key][rows]
            w, faster = b[list(SPEEDS)].to_numpy(float), b[[f"{s}_dot" for s in SPEEDS]].to_numpy(float)
            further = {
                "Fz": (a["w"] * w.sum(axis=1), a["u"] ** 2 + a["v"] ** 2),
                "Mx": (a["p"], a["v"] * w.sum(axis=1)),
                "My": (a["q"], a["u"] * w.sum(axis=1)),
                "Mz": (a["r"], faster @ airframe.spin),
            }[axis]
            further = (*further, (2.0 * w * faster) @ sign) if lead else further
            y.append(a[axis].to_numpy(float))
            x.append(np.column_stack([w**2 @ sign, *further, np.ones(len(a))]))
            true.append(truth[key][axis][rows])
        target, columns, true = np.concatenate(y), np.concatenate(x), np.concatenate(true)
        size = np.linalg.norm(columns, axis=0)
        theta = np.linalg.lstsq(columns / size, target, rcond=None)[0] / size
        left = target - columns @ theta
        found[axis] = {
            "R2": float(1.0 - np.var(left) / np.var(target)),
            "error": float(np.std(columns @ theta - true) / np.std(true)),
        }
        if lead:
            found[axis]["lead"] = float(theta[-2] / theta[0])
    return found


def spread_of_factors(tables: dict, drive: dict, airframe: Airframe, masses: dict) -> dict[str, float]:
    """Root mean square, over held-out flights, of the difference of their moment factors from those of the model over
    its standard error: that of the flight, of the model, and the deviation between flights. About 1 where all hold."""
    chosen = {}
    for key, table in tables.items():
        chosen[key] = np.zeros(len(table), bool)
        chosen[key][usable(len(table), 0.7)] = used_rows(table)[usable(len(table), 0.7)]
    rows = rows_within_limits(tables, chosen, [])
    point = drive["operating command"], drive["reference voltage"]
    flights = [prepare_flight(t, rows[k], airframe, masses[k], drive["input"], point) for k, t in tables.items()]
    warming = drive["warm-up drop"] is not None
    fit = JointFit(drive["form"], flights, airframe, drive["voltage exponent"] is not None, warming=warming)
    entries = {**drive["parameters"], **{n: drive[n] for n in ("time constant", "delay", "voltage exponent")}}
    entries |= {n: drive[n] for n in WARM_UP_NAMES}
    fit.x = np.array([entries[n]["value"] for n in fit.names])
    fit.colour = {axis: np.array(colour) for axis, colour in drive["disturbance"].items()}
    found = {}
    for axis in ("Mx", "My"):
        factor = drive["factors"][axis]
        ones = [one for one in (flight_factor(fit, f, axis) for f in flights) if one is not None]
        variances = [std**2 + factor["std"] ** 2 + factor["between flights"] ** 2 for _, std, _ in ones]
        shifts = [(value - factor["value"]) ** 2 / v for (value, _, _), v in zip(ones, variances)]
        found[axis] = float(np.sqrt(np.mean(shifts)))
        plain = [(value - factor["value"]) ** 2 / std**2 for value, std, _ in ones]
        found[f"{axis}, within flights alone"] = float(np.sqrt(np.mean(plain)))
    return found


def roll_outs(model, flight, look_ahead: int) -> dict[str, np.ndarray]:
    """Mean error norms (3, H) after HORIZONS of the model, of the model with the trim before each start, and of holding
    the last state. look_ahead  rows by which the flight's low-pass looks ahead"""
    t, states = flight["t"].to_numpy(float), flight[STATE].to_numpy(float)
    good, steps = np.zeros(len(flight), bool), count_steps(t, HORIZONS[-1])
    good[usable(len(flight), 0.7)] = True
    good &= used_rows(flight)
    dt = float(np.median(np.diff(t)))
    starts = np.arange(0, len(t) - steps - 1, max(round(EVERY / dt), 1))
    starts = starts[[bool(good[s : s + steps + 1].all()) for s in starts]]
    predicted = model.predict_columns(flight)
    missing = flight[list(predicted)].to_numpy(float) - predicted.to_numpy(float)
    missing[~used_rows(flight)] = np.nan
    trim = trim_before(missing, starts, round(TRIM / dt), look_ahead)
    speeds, at = flight[list(SPEEDS)].to_numpy(float), [count_steps(t, horizon) for horizon in HORIZONS]
    runs = [rollout(model, t, states, speeds, starts, HORIZONS[-1], offsets=offsets) for offsets in (None, trim)]
    errors = [compute_errors(run, states, starts) for run in (*runs, hold_states(states, starts, steps))]
    return {kind: np.array([np.nanmean(one[kind][:, at], axis=0) for one in errors]) for kind in errors[0]}


def nanobench(path: str) -> dict:
    """Print and return scores, arms and roll-outs of the model of examples/crazyflie."""
    folder = ROOT / "examples/crazyflie"
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(folder), "-j2"]
    subprocess.run([*command, "--config", f"data={path}", "--", "models/nanobench/standalone"], check=True)
    model = read_model(folder / "models/nanobench/standalone")
    drive = model.document["rotor speeds"]
    report = {"arms over configured": {axis: drive["factors"][axis] for axis in JOINT_AXES[1:3]}}
    report |= {
        k: drive[k] for k in ("form", "time constant", "delay", "relative error", "voltage exponent", *WARM_UP_NAMES)
    }
    errors: dict[str, list] = {}
    pooled: dict[str, list] = {}
    held_out, masses = {}, {}
    for key in model.document["flights"]["validation"]:
        place = folder / f"results/filtered/Nano/withGravity/{key}.parquet"
        flight = read_flight(place, drive)
        held_out[key], about = read_table(place), read_made(place)
        masses[key] = about["mass"]
        for kind, values in roll_outs(model, flight, about["filters"]["half length samples"]).items():
            errors.setdefault(kind, []).append(values)
        rows = partition({key: flight}, {key}, {"usable data ratio": 0.7})[key] > 0
        part = flight[rows]
        found = model.predict_columns(part)
        for axis in JOINT_AXES:
            pooled.setdefault(axis, []).append((part[axis].to_numpy(float), found[axis].to_numpy(float)))
    report["R2 of held-out flights"] = {}
    for axis, pairs in pooled.items():
        y, f = (np.concatenate(x) for x in zip(*pairs))
        level = [1.0 - np.var(a - b) / np.var(a) for a, b in pairs]
        report["R2 of held-out flights"][axis] = {
            "pooled": float(1.0 - np.mean((y - f) ** 2) / np.var(y)),
            "each without its mean": [float(x) for x in level],
        }
    for row, name in enumerate(("roll-outs over holding", "roll-outs with trim over holding")):
        report[name] = {
            kind: dict(zip(map(str, HORIZONS), (np.mean(values, axis=0)[row] / np.mean(values, axis=0)[2]).tolist()))
            for kind, values in errors.items()
        }
    airframe = read_airframe(read_json(folder / "config/Nano.json"), "Nano", float(np.mean(list(masses.values()))))
    report["held-out factors over stated errors"] = spread_of_factors(held_out, drive, airframe, masses)
    return report


def figures_of(what: str, report: dict) -> dict[str, float]:
    """The values of benchmarks/results/commands_only.json that a report holds."""
    if what == "withheld":
        names = {"telemetry": "telemetry", "lag of thrust": "commands", "telemetry, with W dW/dt": "lead",
                 "lag of the rotors, with W dW/dt": "commands_lead"}  # fmt: skip
        found = {
            f"{short}_{axis}": part["error"] for k, short in names.items() for axis, part in report["fits"][k].items()
        }
        return found | {"lead_time": report["fits"]["telemetry, with W dW/dt"]["Mx"]["lead"]}
    found = {f"R2_{axis}": part["pooled"] for axis, part in report["R2 of held-out flights"].items()}
    found |= {f"arm_{axis}": part["value"] for axis, part in report["arms over configured"].items()}
    found |= {f"arm_std_{axis}": part["std"] for axis, part in report["arms over configured"].items()}
    found |= {f"between_{axis}": part["between flights"] for axis, part in report["arms over configured"].items()}
    found |= {
        f"{kind}{ending}_{horizon}": value
        for name, ending in (("roll-outs over holding", ""), ("roll-outs with trim over holding", "_trim"))
        for kind, part in report[name].items()
        for horizon, value in zip(("first", "second", "last"), part.values())
    }
    spread = report["held-out factors over stated errors"]
    return found | {f"spread_{axis}": spread[axis] for axis in ("Mx", "My")} | {
        f"spread_within_{axis}": spread[f"{axis}, within flights alone"] for axis in ("Mx", "My")
    }  # fmt: skip


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("withheld", "nanobench"))
    parser.add_argument("path", nargs="?", help="folder that holds nanobench/")
    parser.add_argument("--flights", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--record", action="store_true", help="store the figures in benchmarks/results")
    chosen = parser.parse_args()
    if chosen.what == "nanobench" and not chosen.path:
        parser.error("nanobench needs the folder that holds nanobench/")
    report = withheld(chosen.flights) if chosen.what == "withheld" else nanobench(chosen.path)
    write_json(ROOT / f"results/benchmarks/commands_only_{chosen.what}.json", report)
    for name, value in report.items():
        print(f"{name}: {value}")
    if chosen.record:
        record("commands_only", figures_of(chosen.what, report))


if __name__ == "__main__":
    main()
