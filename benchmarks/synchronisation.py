"""Lag and clock rate found on made flights, against the truth and against their own standard errors.

    python benchmarks/synchronisation.py [--seeds 20] [--first 1] [--duration 60 90] [--profiles mixed aggressive ...]
                                         [--capture-rate 120] [--noise 1] [--nuisance 1]
                                         [--out results/benchmarks/synchronisation]

Each seed makes one flight (raw log and capture export, durations spread between the two given, profiles in turn),
imports it and leaves one JSON in --out. A study that was stopped goes on where it was; a draw made by other code or
with other settings is made anew. Printed: rms of the errors and of error / standard error over all draws.
"""

import argparse
from pathlib import Path

import numpy as np
from measured_table import record
from study import ROOT, fly, rms, run

from quasi.errors import QuasiError

LARGEST_LAG, LARGEST_RATE, HONEST = 1e-3, 5e-6, (0.7, 1.4)


def draw(settings: dict) -> dict:
    """Make and import one flight; errors of lag (s, at the middle of the capture) and clock rate (s/s)."""
    names = ("profile", "seed", "duration", "capture rate", "noise", "nuisance")
    try:
        made, _, about, _ = fly(f"seed-{settings['seed']}", **{k: settings[k] for k in names})
    except QuasiError as error:
        return {"refused": str(error)}
    sync, clock = about["synchronisation"], made.metadata["clock"]
    lag, rate = sync["lag"], sync["clock rate"]
    at = lag["at capture time"]
    truth = {"lag": (at - clock["capture offset"]) / clock["capture rate"] - at, "rate": 1 / clock["capture rate"] - 1}
    return {
        "lag error": lag["value"] - truth["lag"],
        "lag std": lag["std"],
        "rate error": rate["value"] - truth["rate"],
        "rate std": rate["std"],
        "explained": sync["explained variance"],
    }


def table(results: list[dict], keep: bool = False) -> bool:
    """Print every draw and the whole, keep the figures on request; True where all figures are reached."""
    good = [r for r in results if "refused" not in r]
    for r in results:
        s = r["settings"]
        name = f"{s['seed']:5d} {s['profile']:<11}{s['duration']:4.0f} s {s['capture rate']:4.0f} Hz"
        if "refused" in r:
            print(f"{name}  refused: {r['refused']}")
            continue
        print(
            f"{name}  lag {1e6 * r['lag error']:+8.1f} us ({1e6 * r['lag std']:6.1f})   "
            f"rate {1e6 * r['rate error']:+7.3f} ppm ({1e6 * r['rate std']:6.3f})"
        )
    if not good:
        return False
    lag, rate = (np.array([r[f"{k} error"] for r in good]) for k in ("lag", "rate"))
    ratios = [rms(np.array([r[f"{k} error"] / r[f"{k} std"] for r in good])) for k in ("lag", "rate")]
    print(f"{len(good)} of {len(results)} flights aligned; rms over these:")
    print(f"lag error        {1e3 * rms(lag):.4f} ms (at most {1e3 * LARGEST_LAG:g}), mean {1e3 * lag.mean():+.4f}")
    print(f"clock-rate error {1e6 * rms(rate):.3f} ppm (at most {1e6 * LARGEST_RATE:g})")
    for name, ratio in zip(("lag", "clock rate"), ratios):
        print(f"{name + ' error / standard error':<35}{ratio:.2f} (from {HONEST[0]} to {HONEST[1]})")
    if keep:
        figures = {"lag s": rms(lag), "rate": rms(rate), "lag ratio": ratios[0], "rate ratio": ratios[1]}
        record("synchronisation", figures)
    honest = all(HONEST[0] <= r <= HONEST[1] for r in ratios)
    return len(good) == len(results) and rms(lag) <= LARGEST_LAG and rms(rate) <= LARGEST_RATE and honest


def main() -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--duration", type=float, nargs=2, default=[60.0, 90.0])
    parser.add_argument("--profiles", nargs="+", default=["mixed"])
    parser.add_argument("--capture-rate", type=float, default=120.0)
    parser.add_argument("--noise", type=float, default=1.0)
    parser.add_argument("--nuisance", type=float, default=1.0)
    parser.add_argument("--out", type=Path, default=ROOT / "results/benchmarks/synchronisation")
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    a = parser.parse_args()
    many = [
        {
            "seed": a.first + i,
            "profile": a.profiles[i % len(a.profiles)],
            "duration": float(round(np.interp(i, [0, max(a.seeds - 1, 1)], a.duration))),
            "capture rate": a.capture_rate,
            "noise": a.noise,
            "nuisance": a.nuisance,
        }
        for i in range(a.seeds)
    ]
    results = run(many, draw, a.out, Path(__file__))
    return 0 if table(results, a.record) else 1


if __name__ == "__main__":
    raise SystemExit(main())
