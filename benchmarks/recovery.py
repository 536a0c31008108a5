"""Are known terms found again, in a large pool, with noise that remembers itself?

    python benchmarks/recovery.py [--seeds 100] [--first 1] [--pool NAME] [--out results/benchmarks/recovery]

Each seed makes eight flights of smooth motion and a vertical force of 3 to 6 terms drawn from the Fz pool of the
manual's FM file (623 candidates), beside its fixed terms, with noise that is half white and half remembers itself for
50 to 300 ms. Six flights train, two judge. A term counts as strong when its t exceeds 6 in the fit of the true terms
alone, the noise's memory counted; as found when it was chosen, or is named as interchangeable with a chosen one; a
chosen term is false when neither it nor one it is interchangeable with is true. Each seed leaves one JSON in --out; a
study that was stopped goes on where it was.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import butter, lfilter, sosfiltfilt
from scipy.special import stdtrit

from quasi.airframe import Airframe, read_airframe
from quasi.identification.candidates import Specification, read_specification
from quasi.identification.fit import fit_axis
from quasi.identification.partition import TRAINING
from quasi.identification.regression import least_squares
from quasi.tables import read_json
from quasi.terms.expressions import Program, parse
from quasi.terms.variables import Variables

ROOT = Path(__file__).resolve().parents[1]
POOL = "polyCands_DiffSys_quadraticU_symmetric_SIMPLE_FM"
RATE, SECONDS, FLIGHTS, HELD_OUT = 100.0, 60.0, 8, 2
HOVER, STRONG = 1100.0, 6.0
MOST, HONEST, COVERED = (0.95, 1.0), (0.90, 0.98), (0.935, 0.965)
THRUST, DRAG = 3.0e-7, -0.05
# size and bandwidth (Hz) of the motion; tanh keeps it inside an envelope, as a pilot does
MOTION = {"u": (5.0, 0.4), "v": (5.0, 0.4), "w": (2.5, 0.4), "p": (3.0, 1.5), "q": (3.0, 1.5), "r": (2.0, 0.8)}
SHARED = {"hover speed": {"value": HOVER}}
CONFIG = {"regressor cap": 12, "bootstrap": 0}


def airframe() -> Airframe:
    """The made quadrotor of the bundled example."""
    return read_airframe(read_json(ROOT / "data/MadeBeetleConfig.json"), "MadeBeetleConfig.json")


def motion(generator: np.random.Generator, rows: int) -> pd.DataFrame:
    """One flight without its force."""

    def smooth(size: float, band: float) -> np.ndarray:
        x = sosfiltfilt(butter(2, band, fs=RATE, output="sos"), generator.standard_normal(rows + 2000))[1000:-1000]
        return size * np.tanh(x / x.std())

    columns = {"t": np.arange(rows) / RATE}
    common = smooth(160.0, 0.6)
    columns |= {f"w{i}": HOVER + common + smooth(90.0, 2.0) for i in range(1, 5)}
    return pd.DataFrame(columns | {name: smooth(*how) for name, how in MOTION.items()})


def noise(generator: np.random.Generator, rows: int, memory: float) -> np.ndarray:
    """Noise of unit variance: half white, half a first order process that remembers itself for `memory` seconds."""
    keep = np.exp(-1.0 / (RATE * memory))
    slow = lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], generator.standard_normal(rows + 1000))[1000:]
    return np.sqrt(0.5) * (slow + generator.standard_normal(rows))


def make(seed: int, specification: Specification) -> tuple[dict, dict, list[str], np.ndarray]:
    """Flights with their force, the size of the noise, names and coefficients of the true terms beside the constant."""
    generator = np.random.default_rng(seed)
    rows = int(SECONDS * RATE)
    flights = {f"flight-{i}": motion(generator, rows) for i in range(FLIGHTS)}
    count = int(generator.integers(3, 7))
    pool = [t.expression for t in specification.candidates]
    names = [t.expression for t in specification.fixed] + list(generator.choice(pool, count, replace=False))
    program = Program([parse(n) for n in names])
    columns = {k: values(program, f) for k, f in flights.items()}
    spread = np.concatenate(list(columns.values()), axis=1).std(axis=1)
    size = generator.uniform(0.2, 1.0)
    # each term's own rms, in units of the noise's
    share = generator.uniform(0.3, 1.5, count) * generator.choice([-1.0, 1.0], count)
    truth = np.concatenate([[DRAG, -THRUST], share * size / spread[2:]])
    memory = generator.uniform(0.05, 0.3)
    for key, flight in flights.items():
        flight["Fz"] = truth @ columns[key] + size * noise(generator, rows, memory)
    return flights, {"size": size, "memory": memory}, names, truth


def values(program: Program, flight: pd.DataFrame) -> np.ndarray:
    """Values (terms, n) of expressions on a flight."""
    variables = Variables({c: flight[c].to_numpy() for c in flight}, airframe(), HOVER)
    return program.run(variables.__getitem__, len(flight))


def draw(settings: dict) -> dict:
    """Make the flights of one seed, identify them, compare with the truth."""
    specification = read_specification(read_json(ROOT / f"config/polynomials/{settings['pool']}.json"), "Fz", "pool")
    flights, about, names, truth = make(settings["seed"], specification)
    train = dict(list(flights.items())[:-HELD_OUT])
    program = Program([parse(n) for n in names])
    design = np.vstack([np.column_stack([np.ones(len(f)), values(program, f).T]) for f in train.values()])
    series = [np.arange(len(f)) for f in train.values()]
    alone = least_squares(design, np.concatenate([f["Fz"] for f in train.values()]), series)
    t = dict(zip(names, truth / np.sqrt(np.diag(alone.covariance))[1:]))

    roles = {key: np.full(len(f), TRAINING, np.int8) for key, f in train.items()}
    begin = time.perf_counter()
    found = fit_axis("Fz", train, roles, airframe(), SHARED, CONFIG, specification)
    took = time.perf_counter() - begin
    chosen = {e["name"]: e for e in found["terms"] if not e["fixed"]}
    alike = {name: {r["expression"] for r in e["interchangeable with"]} for name, e in chosen.items()}
    candidates = names[2:]
    named = set(chosen).union(*alike.values())
    true = {n for n in chosen if n in candidates}
    exact = [n for n in found["estimated"] if n in names]
    index = [found["estimated"].index(n) for n in exact]
    std = np.sqrt(np.diag(found["covariance"]))[index]
    error = (np.array([found["terms"][i]["coefficient"] for i in index]) - [truth[names.index(n)] for n in exact]) / std
    return {
        **about,
        "terms": [
            {"name": n, "t": float(t[n]), "chosen": n in chosen, "found": n in named} for n in candidates
        ],
        "chosen": [{"name": n, "true": n in true, "false": not ({n, *alike[n]} & set(candidates)),
                    "t": e["t"], "alike": e["rivals"]} for n, e in chosen.items()],
        "right structure": set(chosen) == set(candidates),
        "errors in standard errors": error.tolist(),
        "coverage": coverage(found, list(flights.values())[-HELD_OUT:]),
        "coverage of training": coverage(found, list(train.values())),
        "reason": found["stop reason"],
        "seconds": took,
    }  # fmt: skip


def coverage(found: dict, flights: list[pd.DataFrame]) -> float:
    """Share of a force inside the prediction intervals of an identified axis."""
    program = Program([parse(e["expression"]) for e in found["terms"]])
    level, inside = found["confidence level"], []
    quantile = stdtrit(max(found["effective rows"] - len(found["terms"]), 1.0), 0.5 + level / 2)
    for flight in flights:
        a = values(program, flight)
        centre = np.array([e["coefficient"] for e in found["terms"]]) @ a
        variance = found["sigma2"] + np.einsum("in,ij,jn->n", a, np.array(found["covariance"]), a, optimize=True)
        inside.append(np.abs(flight["Fz"] - centre) <= quantile * np.sqrt(variance))
    return float(np.mean(inside))


def wilson(hits: int, of: int, z: float = 1.96) -> tuple[float, float]:
    """Interval of a share (Wilson, Journal of the American Statistical Association 22, 1927)."""
    if not of:
        return 0.0, 1.0
    share = hits / of
    centre, half = share + z**2 / (2 * of), z * np.sqrt(share * (1 - share) / of + z**2 / (4 * of**2))
    return (centre - half) / (1 + z**2 / of), (centre + half) / (1 + z**2 / of)


def table(results: list[dict]) -> bool:
    """Print the figures; True where all are reached."""
    strong = [[t for t in r["terms"] if abs(t["t"]) > STRONG] for r in results]
    errors = np.concatenate([r["errors in standard errors"] for r in results])
    cover = np.array([r["coverage"] for r in results])
    seeds, found = len(results), [t["found"] for s in strong for t in s]
    itself = [t["chosen"] for s in strong for t in s]
    false = [[c["false"] for c in r["chosen"]] for r in results]
    every = [f for one in false for f in one]
    counts = [
        (
            "seeds in which every strong term is found",
            sum(all(t["found"] for t in s) for s in strong),
            seeds,
            (0.95, 1),
        ),
        ("seeds with at most one false term", sum(sum(f) <= 1 for f in false), seeds, MOST),
        ("true coefficients within two standard errors", sum(np.abs(errors) < 2), len(errors), HONEST),
        ("strong terms found", sum(found), len(found), None),
        ("strong terms chosen themselves", sum(itself), len(itself), None),
        ("chosen terms that are false", sum(every), len(every), None),
        ("seeds with exactly the true terms", sum(r["right structure"] for r in results), seeds, None),
    ]
    reached = True
    for name, hits, of, aimed in counts:
        share, (a, b) = hits / max(of, 1), wilson(hits, of)
        missed = aimed is not None and not aimed[0] <= share <= aimed[1]
        reached &= not missed
        aim = f"  ({aimed[0]:g} to {aimed[1]:g}) {'MISSED' if missed else ''}" if aimed else ""
        print(f"{name:46}{hits:5d} of {of:<5d}{share:7.3f}  95 % {a:.3f} to {b:.3f}{aim}")
    missed = not COVERED[0] <= cover.mean() <= COVERED[1]
    print(f"{'coverage of held-out flights, mean over seeds':46}{'':14}{cover.mean():7.3f}  +- {cover.std():.3f}"
          f"{'':12}(0.935 to 0.965) {'MISSED' if missed else ''}")  # fmt: skip
    print(f"{'seconds of a fit, median':46}{'':14}{np.median([r['seconds'] for r in results]):7.2f}")
    return reached and not missed


def main() -> int:
    """Run the study."""
    from study import run  # it reaches the readers of logs, which one draw does not need

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--pool", default=POOL)
    parser.add_argument("--out", type=Path, default=ROOT / "results/benchmarks/recovery")
    a = parser.parse_args()
    many = [{"seed": a.first + i, "pool": a.pool} for i in range(a.seeds)]
    return 0 if table(run(many, draw, a.out, Path(__file__))) else 1


if __name__ == "__main__":
    raise SystemExit(main())
