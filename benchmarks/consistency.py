"""Filter and smoother against the truth of made flights, and against their own standard errors.

    python benchmarks/consistency.py [--seeds 20] [--first 1] [--seconds 60] [--profiles mixed aggressive]
                                     [--nuisance 0] [--record] [--out results/benchmarks/consistency]

Each seed makes one flight (raw log and capture export, profiles in turn), imports and filters it with default options
and leaves one JSON in --out. A study that was stopped goes on where it was; a draw made by other code or with other
settings is made anew. --nuisance 0 leaves out what no filter can know (how IMU and markers are seated, biases, gusts,
clock rates); 1 is usual.

The filter estimates the attitude of the IMU's axes, and the position of the point that the configured marker offset
names; "body" errors are those of the true body axes, seating included.
NEES is the normalised estimation error squared of attitude, velocity and position together (9 degrees of freedom) at
one moment, the middle of the flight; its 95 % bounds hold 95 of 100 seeds if standard errors are right.
Source: Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4.
"""

import argparse
from pathlib import Path

import numpy as np
from measured_table import record
from scipy.stats import chi2
from study import ROOT, fly, rms, run

from quasi import attitude
from quasi.airframe import read_airframe
from quasi.errors import QuasiError
from quasi.filtering import capture_doubt, ekf, estimation
from quasi.filtering.flight import filter_flight

LARGEST_ATTITUDE, LARGEST_VELOCITY, HONEST, INSIDE = 0.4, 0.03, (0.7, 1.4), 0.9
BETTER_VELOCITY, BETTER_ATTITUDE = 0.7, 0.8
PARTS = {"attitude": slice(0, 3), "velocity": slice(3, 6), "position": slice(6, 9)}
SENSORS = estimation.SENSORS


def passes_of(frame, about, airframe, options):
    """A filtered flight, and the forward and the smoothed pass behind it with their whole covariances."""
    kept, widen = [], capture_doubt.widen

    def keep(*arguments):
        kept.append(widen(*arguments))
        return kept[-1]

    capture_doubt.widen = keep
    try:
        result = filter_flight(frame, about, airframe, options)
    finally:
        capture_doubt.widen = widen
    return result, kept[0], kept[1]


def errors_of(run: ekf.FilterResult, truth: dict[str, np.ndarray]) -> np.ndarray:
    """Errors (N, 9) of attitude (rad, about the IMU's axes), velocity and position."""
    turn = attitude.logarithm(attitude.multiply(attitude.conjugate(run.quaternion), truth["imu"]))
    return np.hstack([turn, truth["v"] - run.state[:, :3], truth["p"] - run.state[:, 3:6]])


def truth_of(made, frame, about, airframe) -> dict[str, np.ndarray]:
    """True attitude of body and IMU (N, 4), velocity and position (N, 3) at the import's samples."""
    at = frame["t"].to_numpy() + about["start"]["value"]
    t = made.truth["t"].to_numpy()
    body = attitude.interpolate(made.truth[["qw", "qx", "qy", "qz"]].to_numpy(), t, at)
    seat = attitude.from_matrix(np.array(made.metadata["inertial"]["axes"]))
    # with the markers' axes turned against the body's, taking the marker offset off leaves a point beside the cg
    taken = made.metadata["capture"]
    offset = np.array(taken["offset"])
    beside = offset - attitude.rotate(attitude.exponential(np.array(taken["body_turn"])), airframe.marker_offset)
    return {
        "body": body,
        "imu": attitude.multiply(body, seat),
        "v": np.stack([np.interp(at, t, made.truth[f"v{a}"]) for a in "xyz"], axis=1),
        "p": np.stack([np.interp(at, t, made.truth[a]) for a in "xyz"], axis=1) + attitude.rotate(body, beside),
    }


def draw(settings: dict) -> dict:
    """Make, import and filter one flight; errors and their standard errors."""
    try:
        made, frame, about, quadrotor = fly(
            "a", **{k: settings[k] for k in ("profile", "seed", "nuisance")}, duration=settings["seconds"]
        )
        airframe = read_airframe(quadrotor, "made")
        result, forward, final = passes_of(frame, about, airframe, {})
    except QuasiError as error:
        return {"refused": str(error)}
    truth = truth_of(made, frame, about, airframe)
    valid = result.with_gravity["valid"].to_numpy() > 0.5
    inertial, b = made.metadata["inertial"], result.metadata["biases"]
    true_bias = np.concatenate([inertial["gyro_bias"], inertial["acc_bias"]])
    found = [np.concatenate([b["gyro"][k], b["accelerometer"][k]]) for k in ("value", "std")]
    flying = np.flatnonzero(valid)
    middle = int(flying[len(flying) // 2])
    out: dict = {
        "bias error": (found[0] - true_bias).tolist(),
        "bias std": found[1].tolist(),
        "valid": float(valid.mean()),
        "consistent": result.metadata["consistent"],
        "NIS": {k: v.get("mean") for k, v in result.metadata["NIS"].items()},
        "noise": result.metadata["noise"]["in flight"],
        "notes": result.metadata["notes"],
    }
    for name, one in (("smoother", final), ("filter", forward)):
        error = errors_of(one, truth)
        out[name] = {k: rms(error[valid, s]) for k, s in PARTS.items()}
        every = flying[::250]
        covariance = ekf.unpack(one.covariance[every])[:, :9, :9]
        out[name]["NEES along"] = {
            k: float(np.mean([e[s] @ np.linalg.solve(c[s, s], e[s]) for e, c in zip(error[every], covariance)]) / 3)
            for k, s in PARTS.items()
        }
        c = ekf.unpack(one.covariance[middle])[:9, :9]
        out[name]["NEES"] = float(error[middle] @ np.linalg.solve(c, error[middle]))
        out[name]["NEES of motion"] = float(error[middle, :6] @ np.linalg.solve(c[:6, :6], error[middle, :6]))
    seated = attitude.logarithm(attitude.multiply(attitude.conjugate(final.quaternion), truth["body"]))
    out["body attitude"] = rms(seated[valid])
    return out


def table(results: list[dict], note: str | None) -> bool:
    """Print every draw and the whole; True where all figures are reached. note  after names of recorded ones"""
    good = [r for r in results if "refused" not in r]
    for r in results:
        s = r["settings"]
        name = f"{s['seed']:5d} {s['profile']:<11}"
        if "refused" in r:
            print(f"{name}  refused: {r['refused']}")
            continue
        ratio = np.array(r["bias error"]) / np.array(r["bias std"])
        along = r["smoother"]["NEES along"]
        print(
            f"{name} attitude {np.degrees(r['smoother']['attitude']):.4f} deg  velocity "
            f"{1e3 * r['smoother']['velocity']:5.2f} mm/s  NEES {r['smoother']['NEES']:6.1f}  "
            f"along {' '.join(f'{along[k]:5.2f}' for k in PARTS)}  bias / std {' '.join(f'{x:+5.1f}' for x in ratio)}"
        )
    if not good:
        return False
    print(f"{len(good)} of {len(results)} flights filtered; rms over these:")
    both = {k: {p: rms(np.array([r[k][p] for r in good])) for p in PARTS} for k in ("smoother", "filter")}
    ratio = np.array([r["bias error"] for r in good]) / np.array([r["bias std"] for r in good])
    bounds = chi2.ppf([0.025, 0.975], 9)
    inside = np.mean([bounds[0] < r["smoother"]["NEES"] < bounds[1] for r in good])
    six = chi2.ppf([0.025, 0.975], 6)
    moving = np.mean([six[0] < r["smoother"]["NEES of motion"] < six[1] for r in good])
    median = np.median([[r["smoother"]["NEES along"][p] for p in PARTS] for r in good], axis=0)
    better = {p: both["smoother"][p] / both["filter"][p] for p in PARTS}
    figures = [
        ("attitude error, IMU axes, deg", np.degrees(both["smoother"]["attitude"]), 0.0, LARGEST_ATTITUDE),
        ("velocity error, m/s", both["smoother"]["velocity"], 0.0, LARGEST_VELOCITY),
        ("velocity error / forward filter's", better["velocity"], 0.0, BETTER_VELOCITY),
        ("attitude error / forward filter's", better["attitude"], 0.0, BETTER_ATTITUDE),
        ("gyro bias error / standard error", rms(ratio[:, :3]), *HONEST),
        ("share of seeds with NEES in bounds", float(inside), INSIDE, 1.0),
    ]
    for name, value, low, high in figures:
        print(f"{name:38}{value:8.4f}  ({low:g} to {high:g}) {'' if low <= value <= high else 'MISSED'}")
    if note is not None:
        found = {"attitude deg": figures[0][1], "velocity m/s": figures[1][1], "NEES inside": float(inside)}
        record("consistency", {f"{k}{note}": v for k, v in {**found, "seeds": len(good)}.items()})
    body = np.degrees(rms(np.array([r["body attitude"] for r in good])))
    print(f"{'attitude error, body axes, deg':38}{body:8.4f}")
    print(f"{'position error, mm':38}{1e3 * both['smoother']['position']:8.4f}")
    print(f"{'accelerometer bias error / std error':38}{rms(ratio[:, 3:]):8.4f}")
    print(f"{'share with NEES without position':38}{moving:8.4f}")
    print(f"{'median NEES / 3 along the flight':38}" + " ".join(f"{p} {m:.2f}" for p, m in zip(PARTS, median)))
    print(f"{'called consistent by itself':38}{np.mean([bool(r['consistent']) for r in good]):8.4f}")
    return len(good) == len(results) and all(low <= value <= high for _, value, low, high in figures)


def main() -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--profiles", nargs="+", default=["mixed", "aggressive"])
    parser.add_argument("--nuisance", type=float, default=0.0)
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    parser.add_argument("--out", type=Path, default=ROOT / "results/benchmarks/consistency")
    a = parser.parse_args()
    many = [
        {
            "seed": a.first + i,
            "profile": a.profiles[i % len(a.profiles)],
            "seconds": a.seconds,
            "nuisance": a.nuisance,
        }
        for i in range(a.seeds)
    ]
    results = run(many, draw, a.out, Path(__file__))
    note = ", nuisance" if a.nuisance else ""
    return 0 if table(results, note if a.record else None) else 1


if __name__ == "__main__":
    raise SystemExit(main())
