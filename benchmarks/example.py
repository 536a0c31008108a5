"""The made example against its truth: forces, thrust and torque factors, and whether the fit is a tautology.

    python benchmarks/example.py

1. Runs models/example/standalone if it is stale. Compares the model's Fz on the validation flight with the true one
   (relative rms), and every other axis too; the same for the measured forces and moments that it was fitted to. Both
   are also compared with the truth in the band that the pipeline keeps: true moments reach far above it.
2. Thrust and torque factors of the simple model against the truth in hover (dT/dW2, dQ/dW2 of one rotor).
3. With sensor noise, nuisance and gusts off, fits the full candidate pool of the manual's listing 17 and the physical
   pool to the true Fz on true states of all flights by least squares: the share of the Fz rms that no coefficients
   can explain.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from measured_table import record
from scipy.signal import butter, sosfiltfilt

from quasi.airframe import read_airframe
from quasi.attitude import interpolate, to_euler
from quasi.identification.candidates import read_specification
from quasi.model.model import read_model
from quasi.tables import read_json, read_made, read_table, write_json
from quasi.terms.expressions import Program
from quasi.terms.variables import Variables
from quasi_synthesis.campaign import flight_of, make_flight, read_campaign

ROOT = Path(__file__).parents[1]
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
POOLS = ("manual_listing_17", "polyCands_DiffSys_quadraticU_symmetric_SIMPLE_FM", "physical")


def rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def on_grid(truth: pd.DataFrame, t: np.ndarray) -> pd.DataFrame:
    """The truth at other times (s, on-board clock)."""
    columns = {c: np.interp(t, truth["t"], truth[c]) for c in truth.columns if c != "t"}
    q = interpolate(truth[["qw", "qx", "qy", "qz"]].to_numpy(), truth["t"].to_numpy(), t)
    columns |= dict(zip(("roll", "pitch", "yaw"), to_euler(q).T))
    return pd.DataFrame({"t": t, **columns})


def compare(model_id: str = "example") -> dict:
    """Relative rms errors of model and measurement against the truth on the validation flights."""
    model = read_model(ROOT / "models" / model_id / "standalone")
    result = {}
    for flight in model.document["flights"]["validation"]:
        filtered = read_table(ROOT / f"results/filtered/MadeBeetle/withGravity/{flight}.parquet")
        start = read_json(ROOT / f"results/imported/MadeBeetle/{flight}.json")["start"]["value"]
        truth_path = ROOT / f"results/synthesis/example/truth/{flight}.parquet"
        whole = read_table(truth_path)
        cutoff = read_json(ROOT / "config/processing.json")["data filtering"].get("low-pass cutoff Hz", 40.0)
        low = butter(4, cutoff, fs=1 / float(np.median(np.diff(whole["t"]))), output="sos")
        band = whole.assign(**{a: sosfiltfilt(low, whole[a]) for a in AXES})
        truth, in_band = (on_grid(w, filtered["t"].to_numpy() + start) for w in (whole, band))
        rows = (filtered["valid"] > 0.5) & (filtered["in_flight"] > 0.5)
        predicted = model.predict_columns(filtered)
        result[flight] = {
            "model": {a: rms((predicted[a] - truth[a])[rows]) / rms(truth[a][rows]) for a in AXES},
            "measured": {a: rms((filtered[a] - truth[a])[rows]) / rms(truth[a][rows]) for a in AXES},
            "model, in band": {a: rms((predicted[a] - in_band[a])[rows]) / rms(in_band[a][rows]) for a in AXES},
            "measured, in band": {a: rms((filtered[a] - in_band[a])[rows]) / rms(in_band[a][rows]) for a in AXES},
        }
    return result


def factors_of_training(model_id: str = "example") -> dict:
    """Simple model against the mean truth of the training flights."""
    model = read_model(ROOT / "models" / model_id / "standalone")
    made = [
        read_made(ROOT / f"results/synthesis/example/truth/{f}.parquet")["hover factors"]
        for f in model.document["flights"]["training"]
    ]
    simple = model.document["simple model"]
    thrust, torque = (float(np.mean([m[k] for m in made])) for k in ("thrust", "torque"))
    return {
        "thrust factor": {
            "identified": simple["kappaFz"]["value"], "truth": thrust, "error": simple["kappaFz"]["value"] / thrust - 1,
        },
        "torque factor": {
            "identified": -simple["kappaMz"]["value"], "truth": torque,
            "error": -simple["kappaMz"]["value"] / torque - 1,
        },
    }  # fmt: skip


def unexplained() -> dict:
    """Share of the true Fz rms that a full pool leaves over all flights, noise, nuisance and gusts off."""
    config = {**read_json(ROOT / "config/synthesis/example.json"), "noise": 0.0, "nuisance": 0.0}
    campaign = read_campaign(config, "example")
    airframe = read_airframe(read_json(ROOT / "data/MadeBeetleConfig.json"), "MadeBeetleConfig.json")
    parts = []
    for flight in campaign.flights:
        truth = make_flight(campaign, flight_of(campaign, flight.key)).truth
        parts.append(truth[truth["t"].between(truth["t"].iloc[-1] * 0.1, truth["t"].iloc[-1] * 0.9)].iloc[::5])
    truth = pd.concat(parts, ignore_index=True)
    squares = sum(truth[f"w{i}"] ** 2 for i in range(1, 5))
    hover = float(np.sqrt(airframe.mass * 9.81 * squares.mean() / (4 * -truth["Fz"].mean())))
    variables = Variables({c: truth[c].to_numpy() for c in truth.columns}, airframe, hover)
    target = truth["Fz"].to_numpy()
    result = {}
    for pool in POOLS:
        specification = read_specification(read_json(ROOT / f"config/polynomials/{pool}.json"), "Fz", pool)
        trees = [t.tree for t in (*specification.fixed, *specification.candidates)]
        design = np.column_stack([*Program(trees).run(variables.__getitem__, len(target)), np.ones(len(target))])
        design /= np.maximum(np.abs(design).max(axis=0), 1e-300)
        # rank-revealing: hundreds of nearly alike columns
        fit = design @ np.linalg.lstsq(design, target, rcond=1e-12)[0]
        result[pool] = {"terms": len(trees) + 1, "rows": len(target), "left": rms(target - fit) / rms(target)}
    return result


def main() -> None:
    command = [sys.executable, "-m", "snakemake", "-j2", "--quiet", "all", "--", "models/example/standalone"]
    subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    result = {"validation": compare(), "factors": factors_of_training(), "unexplained": unexplained()}
    for flight, found in result["validation"].items():
        print(f"{flight}: error over rms of the truth, in flight")
        print(f"  {'':18}" + "".join(f"{a:>9}" for a in AXES))
        for kind in found:
            print(f"  {kind:18}" + "".join(f"{100 * found[kind][a]:>8.2f}%" for a in AXES))
    for name, found in result["factors"].items():
        print(
            f"{name}: identified {found['identified']:.4e}, truth {found['truth']:.4e}, "
            f"off by {100 * found['error']:+.2f} %"
        )
    for pool, left in result["unexplained"].items():
        print(f"{pool}: {left['terms']} terms leave {100 * left['left']:.2f} % of the Fz rms, noise and nuisance off")
    write_json(ROOT / "results/benchmarks/example.json", result)
    if "--record" in sys.argv:
        (validation,) = result["validation"].values()
        figures = {name: found["error"] for name, found in result["factors"].items()}
        pool = "polyCands_DiffSys_quadraticU_symmetric_SIMPLE_FM"
        figures |= {"Fz error": validation["model"]["Fz"], "unexplained": result["unexplained"][pool]["left"]}
        record("example", figures)


if __name__ == "__main__":
    main()
