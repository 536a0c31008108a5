"""Real flights: roll-outs of the nano-drone on the run that was held out, beside two baselines.

    python benchmarks/nanodrone.py DATA [--runs 3 2 1] [--extended]

DATA is the folder that holds nanodrone/square_run1..3.csv (public nano-drone identification benchmark). For each run a
model is identified from the two others (examples/nanodrone, through the workflow); then it is rolled out from the
measured states with the measured rotor speeds, a start every 0.1 s above 0.4 m. Printed: the mean norm of the errors
after 0.1 s and 0.5 s, and their ratio to (a) holding the last state and (b) the authors' physics constants.

"with trim" adds what the flight itself shows before each start: the mean of measured minus predicted force and moment
over the 2 s that end 0.1 s before it (the low-pass looks 0.1 s ahead at most; the constant IMU biases and the smoothed
states rest on the whole flight, as those of every contender do). A battery put back half a millimetre off shifts the
trim of a 45 g quadrotor by that much from one flight to the next.

--extended adds the model that each run's gap (the two others compared with it) extended, on the same states: those that
the flights have once they are corrected for what the gap found of the sensors.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
from plain_rollout import Body, hold_states, make_body, rollout_body, trim_before

from quasi.model.model import read_model
from quasi.simulation.tools.rollout import compute_errors, count_steps
from quasi.tables import read_table, write_json

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "examples/nanodrone"
MODELS = {3: "nanodrone", 2: "nanodrone-13", 1: "nanodrone-23"}
STATE = ["roll", "pitch", "yaw", "u", "v", "w", "p", "q", "r", "x", "y", "z"]
ROTORS = ["w1", "w2", "w3", "w4"]
KINDS = {"position": "m", "velocity": "m/s", "attitude": "rad", "rate": "rad/s"}
HORIZONS = (0.1, 0.5)
LOWEST = 0.4  # m above ground
TRIM, MARGIN = 2.0, 0.1  # s
# the authors' constants (their repository): arm as lever in roll and pitch alike, axes x forward y left z up
ARM, THRUST, TORQUE = 0.0353, 3.72e-8, 7.74e-12
INERTIA = np.diag([2.3951e-5, 2.3951e-5, 3.2347e-6])


def authors(mass: float) -> Body:
    """Their model, turned to x forward, y right, z down."""

    def wrench(state, speeds, accelerations):
        a, b, c, d = (speeds**2).T
        force = np.zeros((len(speeds), 3))
        force[:, 2] = -THRUST * (a + b + c + d)
        roll, pitch = ARM * THRUST * (c + d - a - b), ARM * THRUST * (b + c - a - d)
        yaw = TORQUE * (a + c - b - d)
        return force, np.stack([roll, -pitch, -yaw], axis=1)

    return Body(mass, INERTIA, wrench)


def trimmed(body: Body, force: np.ndarray, moment: np.ndarray) -> Body:
    """The same body with a constant force and moment of its own in each window, (S, 3) each."""

    def wrench(state, speeds, accelerations):
        f, m = body.wrench(state, speeds, accelerations)
        return f + force, m + moment

    return Body(body.mass, body.inertia, wrench, body.with_gravity)


def starts_of(imported, steps: int) -> np.ndarray:
    """Rows at which a window starts: every 0.1 s above LOWEST, with measured data all through the window."""
    t = imported["t"].to_numpy()
    good = imported["onboard_valid"].to_numpy() > 0.5
    good &= np.isfinite(imported[STATE + ROTORS].to_numpy()).all(axis=1)
    whole = np.convolve(good, np.ones(steps + 1), "valid") > steps + 0.5
    rows = np.arange(0, len(whole), round(0.1 / float(np.median(np.diff(t)))))
    return rows[whole[rows] & (imported["z"].to_numpy()[rows] < -LOWEST)]


def trims(model, filtered, starts: np.ndarray, dt: float) -> tuple[np.ndarray, dict[str, float]]:
    """Trim (S, 6) before each start; and the mean of measured minus predicted over the whole run, by axis."""
    predicted = model.predict_columns(filtered)
    missing = filtered[list(predicted)].to_numpy() - predicted.to_numpy()
    missing[filtered["valid"].to_numpy() < 0.5] = np.nan
    trim = trim_before(missing, starts, round(TRIM / dt), round(MARGIN / dt))
    return trim, dict(zip(predicted, np.nanmean(missing, axis=0).tolist()))


def judge(run: int, against: str, extended: bool = False) -> dict:
    """Errors of every contender on one run, {contender: {horizon: {kind: mean norm}}}."""
    model = read_model(FOLDER / "models" / MODELS[run] / "standalone")
    results = FOLDER / "results" / (f"calibrated/{MODELS[run]}" if extended else "")
    imported = read_table(results / f"imported/NanoDrone/square_run{run}.parquet")
    filtered = read_table(results / f"filtered/NanoDrone/withGravity/square_run{run}.parquet")
    t, speeds = imported["t"].to_numpy(), imported[ROTORS].to_numpy()
    states = (imported if against == "imported" else filtered)[STATE].to_numpy()
    steps = count_steps(t, max(HORIZONS))
    starts = starts_of(imported, steps)

    dt = float(np.median(np.diff(t)))
    runs = {
        "holding the last state (a)": hold_states(states, starts, steps),
        "authors' constants (b)": rollout_body(
            authors(make_body(model).mass), t, states, speeds, starts, max(HORIZONS)
        ),
    }
    contenders = {"quasi": model}
    if extended:
        contenders["extended"] = read_model(FOLDER / "models" / f"{MODELS[run]}-extended" / "standalone")
    usual = {}
    for name, contender in contenders.items():
        trim, usual[name] = trims(contender, filtered, starts, dt)
        body = make_body(contender)
        runs[name] = rollout_body(body, t, states, speeds, starts, max(HORIZONS))
        own = trimmed(body, trim[:, :3], trim[:, 3:])
        runs[f"{name} with trim"] = rollout_body(own, t, states, speeds, starts, max(HORIZONS))
    result = {}
    for name, prediction in runs.items():
        norms = compute_errors(prediction, states, starts)
        result[name] = {h: {k: float(norms[k][:, count_steps(t, h)].mean()) for k in KINDS} for h in HORIZONS}
    return {
        "run": run,
        "windows": len(starts),
        "errors": result,
        "mean residual": usual,
        "notes": model.document["notes"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder that holds nanodrone/square_run1..3.csv")
    parser.add_argument("--runs", type=int, nargs="+", default=[3, 2, 1], help="runs to hold out, each in turn")
    parser.add_argument(
        "--against",
        choices=("filtered", "imported"),
        default="filtered",
        help="states that every contender starts from and is judged by: smoothed from IMU and capture, or as measured",
    )
    parser.add_argument("--extended", action="store_true", help="beside each model that which its gap extended")
    options = parser.parse_args()
    kinds = ["", "-extended"] if options.extended else [""]
    targets = [f"models/{MODELS[run]}{kind}/standalone" for run in options.runs for kind in kinds]
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(FOLDER), "-j2", "--quiet"]
    command += ["all", "--config", f"data={options.data.resolve()}", "--", *targets]
    subprocess.run(command, check=True)
    results = [judge(run, options.against, options.extended) for run in options.runs]
    for result in results:
        print(f"\nrun {result['run']} held out, {result['windows']} windows")
        print(f"{'':28}" + "".join(f"{f'{k} {h:g} s':>22}" for h in HORIZONS for k in KINDS))
        held = result["errors"]["holding the last state (a)"]
        ours = result["errors"]["authors' constants (b)"]
        for name, values in result["errors"].items():
            cells = ""
            for h in HORIZONS:
                for kind in KINDS:
                    value = values[h][kind]
                    cells += f"{value:>9.3g} {value / held[h][kind]:>5.2f}a {value / ours[h][kind]:>4.2f}b"
            print(f"{name:28}{cells}")
        for name, residual in result["mean residual"].items():
            shown = ", ".join(f"{k} {v:.2g}" for k, v in residual.items())
            print(f"mean measured - predicted over the run, {name}: {shown}")
    write_json(ROOT / "results/benchmarks/nanodrone.json", results)


if __name__ == "__main__":
    main()
