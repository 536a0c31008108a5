"""Rotor speeds estimated from commands: against telemetry that was withheld, and on real flights without any.

    python benchmarks/commands_only.py withheld [--flights 1 2 3]     the bundled example, in this folder
    python benchmarks/commands_only.py nanobench PATH                 PATH holds nanobench/ as published

`withheld` filters imported flights of the example again without their rotor speeds, estimates these from commands and
battery voltage, and prints: ratio of torque to thrust factors and time constants against those from telemetry, rms
error of the speeds after one common scale, and rms error of Fz and moments by the simple rotor model of either speeds.
Estimated speeds have the lag of thrust. The errors are printed as well for speeds with the rotors' own lag, by the yaw
moment, as telemetry has it; and for both, R2 of the measured Fz and moments by squared speeds, damping and airspeed.
`nanobench` makes the model of examples/crazyflie through the workflow and prints its scores on held-out flights, arms,
and the mean error of roll-outs of 0.1, 0.2 and 0.5 s over that of holding the last state.
Both write results/benchmarks/commands_only_*.json.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from plain_rollout import hold_states

from quasi.airframe import Airframe, read_airframe
from quasi.filtering.flight import filter_flight
from quasi.filtering.rotor_speeds import add_estimated_speeds, read_flight
from quasi.identification.joint_fit import JOINT_AXES
from quasi.identification.partition import partition, usable
from quasi.identification.rotor_speeds import rotor_speeds_of
from quasi.identification.shared import shared
from quasi.model.model import read_model
from quasi.simulation.tools.rollout import compute_errors, count_steps, rollout
from quasi.tables import read_json, read_made, read_table, write_json
from quasi.terms.rotor_map import SPEEDS, WARM_UP_NAMES, used_rows

ROOT = Path(__file__).parents[1]
STATE = ["roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z"]
HORIZONS, EVERY = (0.1, 0.2, 0.5), 0.1  # s


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
    drive, notes = rotor_speeds_of(tables, airframe, masses, {}, 0.9)
    print("\n".join(notes))
    estimated = {key: add_estimated_speeds(table, made, drive) for key, (table, made) in blind.items()}
    whole = {"random partition": False, "usable data ratio": 0.9}
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
    report["R2 of the measurement"] = {"telemetry": explained(measured, measured, airframe)}
    for name, tables in kinds.items():
        report[name] = compared(measured, tables, airframe, (truth["simple model"], own["simple model"]))
        report["R2 of the measurement"][name] = explained(measured, tables, airframe)
    return report


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


def explained(measured: dict, speeds: dict, airframe: Airframe) -> dict[str, float]:
    """R2 of measured Fz and moments by least squares on squared speeds, damping, airspeed and rotor acceleration."""
    signs = np.stack([-np.ones(4), airframe.left, airframe.front, airframe.spin])
    found = {}
    for axis, sign in zip(JOINT_AXES, signs):
        y, x = [], []
        for key, table in measured.items():
            rows = used_together(table, speeds[key])
            a, b = table[rows], speeds[key][rows]
            w = b[list(SPEEDS)].to_numpy(float)
            faster = b[[f"{s}_dot" for s in SPEEDS]].to_numpy(float) @ airframe.spin
            further = {
                "Fz": (a["w"] * w.sum(axis=1), a["u"] ** 2 + a["v"] ** 2),
                "Mx": (a["p"], a["v"] * w.sum(axis=1)),
                "My": (a["q"], a["u"] * w.sum(axis=1)),
                "Mz": (a["r"], faster),
            }[axis]
            y.append(a[axis].to_numpy(float))
            x.append(np.column_stack([w**2 @ sign, *further, np.ones(len(a))]))
        target, columns = np.concatenate(y), np.concatenate(x)
        columns = columns / np.linalg.norm(columns, axis=0)
        left = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
        found[axis] = float(1.0 - np.var(left) / np.var(target))
    return found


def roll_outs(model, flight) -> dict[str, np.ndarray]:
    """Mean error norms (2, H) after HORIZONS of the model, and of holding the last state."""
    t, states = flight["t"].to_numpy(float), flight[STATE].to_numpy(float)
    good, steps = np.zeros(len(flight), bool), count_steps(t, HORIZONS[-1])
    good[usable(len(flight), 0.7)] = True
    good &= used_rows(flight)
    starts = np.arange(0, len(t) - steps - 1, max(round(EVERY / float(np.median(np.diff(t)))), 1))
    starts = starts[[bool(good[s : s + steps + 1].all()) for s in starts]]
    run = rollout(model, t, states, flight[list(SPEEDS)].to_numpy(float), starts, HORIZONS[-1])
    own, held = compute_errors(run, states, starts), compute_errors(hold_states(states, starts, steps), states, starts)
    at = [count_steps(t, horizon) for horizon in HORIZONS]
    return {k: np.array([np.nanmean(own[k][:, at], axis=0), np.nanmean(held[k][:, at], axis=0)]) for k in own}


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
    for key in model.document["flights"]["validation"]:
        place = folder / f"results/filtered/Nano/withGravity/{key}.parquet"
        flight = read_flight(place, drive)
        for kind, values in roll_outs(model, flight).items():
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
    report["roll-outs over holding"] = {
        kind: dict(zip(map(str, HORIZONS), (np.mean(values, axis=0)[0] / np.mean(values, axis=0)[1]).tolist()))
        for kind, values in errors.items()
    }
    return report


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("withheld", "nanobench"))
    parser.add_argument("path", nargs="?", help="folder that holds nanobench/")
    parser.add_argument("--flights", type=int, nargs="+", default=[1, 2, 3])
    chosen = parser.parse_args()
    if chosen.what == "nanobench" and not chosen.path:
        parser.error("nanobench needs the folder that holds nanobench/")
    report = withheld(chosen.flights) if chosen.what == "withheld" else nanobench(chosen.path)
    write_json(ROOT / f"results/benchmarks/commands_only_{chosen.what}.json", report)
    for name, value in report.items():
        print(f"{name}: {value}")


if __name__ == "__main__":
    main()
