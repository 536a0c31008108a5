"""Speed of the simulator: one drone compiled, with a Python hook, a batch, roll-outs; identified model, INDI, noise.

    python benchmarks/simulation.py [MODEL_FOLDER] [--drones N]

MODEL_FOLDER  models/example/standalone by default. Figures are the best of several short runs, so that a busy machine
shows what the program can do. The reference (QuaSI, on a machine with two cores): 807 steps/s with Euler, 277 with
Runge-Kutta; rotorpy: about 1,280 steps/s in open loop, 631 in closed loop.
"""

import argparse
import os
import time

import numpy as np
from measured_table import record
from stopwatch import best

from quasi.model.model import read_model
from quasi.simulation.loop.closed_loop import FULL_LOG_SIZE, run_loop
from quasi.simulation.loop.run import simulate, simulate_many
from quasi.simulation.loop.setup import make_setup
from quasi.simulation.tools.replay import replay
from quasi.simulation.vehicle.dynamics import make_scratch


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", nargs="?", default="models/example/standalone")
    parser.add_argument("--drones", type=int, default=1000)
    parser.add_argument("--record", action="store_true", help="store the figures for docs/measured.md")
    options = parser.parse_args()
    figures: dict[str, float] = {}
    model = read_model(options.model)
    terms = sum(len(part["terms"]) for part in model.document["axes"].values())
    print(f"model {model.id}: {terms} terms on {len(model.axes)} axes; {os.cpu_count()} cores")

    def setup_of(controller: str, integrator: str, duration: float):
        return make_setup(
            {
                "model": {"model ID": model.id},
                "controller": {"controller": controller},
                "simulation": {"duration": duration, "integrator": integrator},
                "references": {"kind": "figure eight"},
                "noise": {"add": True, "specific force": 0.1, "rotor speeds": 5.0},
            },
            model,
        )

    for controller in ("drone_INDI", "drone_NDI", "drone_PID"):
        for integrator in ("rk4", "euler"):
            setup = setup_of(controller, integrator, 8.0)
            log = np.empty((setup.steps + 1, FULL_LOG_SIZE))

            def closed(setup=setup, log=log):
                run_loop(
                    setup.loop_parameters,
                    setup.make_loop_state(),
                    make_scratch(model.kernel),
                    0,
                    setup.steps,
                    1,
                    log,
                    True,
                )

            closed()
            speed = setup.steps / best(closed, 60)
            if (controller, integrator) == ("drone_INDI", "rk4"):
                figures["closed loop steps/s"] = speed
            print(f"{controller}, {integrator}, everything logged: {speed:,.0f} steps/s")
    setup = setup_of("drone_INDI", "rk4", 4.0)
    result = simulate(setup)  # compiles what is left
    print(f"whole simulation of {setup.steps} steps as a table: {1e3 * best(lambda: simulate(setup), 20):.1f} ms")
    assert result.stopped is None
    for what, arguments in (
        ("a hook that only looks", {"between": {"controller": lambda bus: None}}),
        ("a controller of the user's own", {"steps": {"controller": lambda bus: bus.controller(bus)}}),
        ("forces and moments of the user's own", {"steps": {"forces_and_moments": lambda b: b.forces_and_moments(b)}}),
    ):
        simulate(setup, **arguments)
        speed = setup.steps / best(lambda a=arguments: simulate(setup, **a), 4)
        figures["Python steps/s"] = max(figures.get("Python steps/s", speed), speed)
        figures["Python steps/s, slow"] = min(figures.get("Python steps/s, slow", speed), speed)
        print(f"in Python with {what}: {speed:,.0f} steps/s")
    simulate_many(setup, 4)
    spent = best(lambda: simulate_many(setup, options.drones), 3)
    figures["drone-steps/s"] = options.drones * setup.steps / spent
    core = best(lambda: simulate_many(setup, options.drones), 3, time.process_time)
    figures["drone-steps per core-second"] = options.drones * setup.steps / core
    print(f"the same per second of processor time: {figures['drone-steps per core-second']:,.0f} steps")
    print(
        f"batch of {options.drones} drones x {setup.steps} steps: {options.drones * setup.steps / spent:,.0f} steps/s"
    )

    n, dt = 5000, 0.002
    t = dt * np.arange(n)
    speeds = setup.start[13:] + 60 * np.column_stack([np.sin((3 + k) * t + k) for k in range(4)])
    states = 0.2 * np.random.default_rng(0).standard_normal((n, 12))
    starts = np.arange(0, n - 251, 10)
    for what, commands in (("measured speeds", None), ("commands", speeds)):
        replay(model, t, states, speeds, starts[:8], 0.1, commands)
        spent = best(lambda c=commands: replay(model, t, states, speeds, starts, 0.5, c), 5)
        figures["roll-out steps/s"] = max(figures.get("roll-out steps/s", 0.0), len(starts) * 250 / spent)
        print(f"roll-outs with {what}: {len(starts)} windows of 250 steps, {len(starts) * 250 / spent:,.0f} steps/s")
    if options.record:
        record("simulation", figures)


if __name__ == "__main__":
    main()
