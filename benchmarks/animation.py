"""Speed of animations: frames per second, and the time that 10 s of flight at 25 frames/s take as GIF and as MP4.

    python benchmarks/animation.py [--drones 1]

A made figure eight is drawn at 720 x 576. Compared with drawing every frame whole, which is what a limit that follows
the drone costs, and what matplotlib's own FuncAnimation does when it writes a file. Written to
results/benchmarks/animation.json.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from measured_table import record

from quasi.airframe import read_airframe
from quasi.attitude import from_euler
from quasi.pages.animation import animate, can_write_mp4, follow_drone, render_frames
from quasi.pages.drawing import Motion
from quasi.tables import read_json, write_json

ROOT = Path(__file__).parent.parent
SECONDS, FPS, TARGET = 10.0, 25.0, 5.0  # s of flight, frames/s, s that a file may take


def figure_eight(number: int) -> Motion:
    """A drone on a figure eight, sampled at 500 Hz."""
    path = ROOT / "data" / "MadeBeetleConfig.json"
    t = np.linspace(0.0, SECONDS, round(500 * SECONDS) + 1)
    phase = t + 0.4 * number
    where = np.stack([3 * np.cos(phase), 3 * np.sin(phase) * np.cos(phase), -2.0 - 0.2 * number + 0 * t], axis=1)
    attitude = from_euler(0.3 * np.sin(2 * phase), 0.2 * np.cos(phase), 0 * t)
    speeds = 2000.0 + 500.0 * np.sin(phase[:, None] + np.arange(4))
    return Motion(read_airframe(read_json(path), str(path)), t, where, attitude, speeds)


def main() -> None:
    """Print and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drones", type=int, default=1)
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    options = parser.parse_args()
    drones = options.drones
    motions = [figure_eight(k) for k in range(drones)]
    next(iter(render_frames(motions)))  # imports and fonts
    found: dict[str, float] = {"drones": drones}

    # of the processor's time, so that other work on the computer does not count
    began = time.process_time()
    count = sum(1 for _ in render_frames(motions, FPS))
    found["frames per second"] = count / (time.process_time() - began)
    began = time.process_time()
    count = sum(1 for _ in render_frames(motions, 0.2 * FPS, limits=follow_drone(motions[0])))
    found["frames per second, each drawn whole"] = count / (time.process_time() - began)
    with tempfile.TemporaryDirectory() as folder:
        for suffix in ("gif", "mp4") if can_write_mp4() else ("gif",):
            file = Path(folder) / f"flight.{suffix}"
            began = time.perf_counter()
            animate(motions, file, FPS)
            found[f"{suffix}, s"] = time.perf_counter() - began
            found[f"{suffix}, kB"] = file.stat().st_size / 1e3

    print(f"{drones} drone(s), {SECONDS:g} s of flight at {FPS:g} frames/s, 720 x 576")
    print(f"frames drawn        {found['frames per second']:8.0f} /s")
    print(f"  each drawn whole  {found['frames per second, each drawn whole']:8.0f} /s")
    for suffix in ("gif", "mp4"):
        if f"{suffix}, s" in found:
            took = found[f"{suffix}, s"]
            print(f"{suffix} {took:20.1f} s, {found[f'{suffix}, kB']:.0f} kB ({took / TARGET:.2f} of {TARGET:g} s)")
    write_json(ROOT / "results" / "benchmarks" / "animation.json", found)
    if options.record:
        record("animation", found)


if __name__ == "__main__":
    main()
