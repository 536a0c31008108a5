"""A model for MATLAB (R2021b or later) and GNU Octave: forces, moments and their differential form, parameters.

    write_matlab(model, "models/X/matlab", u=["U_p", "U_q", "U_r"])

makes what chapter 8.2 of the manual lists: get_Fx.m .. get_Mz.m, getFM.m, getDroneInputs.m, get_PQRDiffSys.m,
model_init.m, droneParams.mat, modelParams.mat and the quaternion helpers; reference.mat and check_model.m compare the
functions with `Model.predict` wherever they run. Rotor speeds are mechanical rad/s in every function; droneParams keeps
minRPM and maxRPM in the unit that the flight controller logs, with the factor to rad/s.

Source: QuaSI user manual V1.0.a, chapter 8.
"""

import io
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.io import savemat

from quasi.attitude import AIR_DENSITY, GRAVITY
from quasi.export.agreement import states_of
from quasi.export.command_map import matlab_map
from quasi.export.contents import check_exportable
from quasi.export.matlab_simulation import write_simulation
from quasi.export.matlab_terms import axis_file, differential_file, matlab_name, wrench_file
from quasi.model.extensions import drive_of
from quasi.model.model import AXES, Model
from quasi.tables import read_text, write_bytes, write_text
from quasi.terms.differential import make_differential_system
from quasi.terms.kernel import INPUTS
from quasi.terms.normalisation import MIN_AIRSPEED
from quasi.terms.singularities import find_speed_limits
from quasi.terms.variables import check_system_inputs

FILES = Path(__file__).parent / "matlab_files"
_UNKNOWN = float("nan")


class Written(NamedTuple):
    """What was written: inputs of the differential form, None without one, and notes on what was left out."""

    u: tuple[str, ...] | None
    notes: tuple[str, ...]


def write_matlab(
    model: Model, folder: str | Path, u: Iterable[str] | None = None, loop: Mapping[str, Any] | None = None
) -> Written:
    """Write the folder.

    u     inputs of the differential form; None leaves get_PQRDiffSys.m out
    loop  constants of a closed loop (`quasi.simulation.tools.portable.loop_constants`); None leaves the simulation out
    Raises ConfigError for what cannot be exported, by name.
    """
    folder, notes = Path(folder), []
    check_exportable(model)
    u = check_system_inputs(u, f"model {model.id}") if u is not None else None
    lacking = [axis for axis in AXES[3:] if axis not in model.axes]
    if u is not None and lacking:
        notes.append(f"get_PQRDiffSys.m is left out: model {model.id} lacks {', '.join(lacking)}")
        u = None
    texts = {f"get_{axis}.m": axis_file(model, axis) for axis in model.axes}
    texts["getFM.m"] = wrench_file(model)
    if mapped := matlab_map(model):
        texts["steadySpeeds.m"] = mapped
    if u is not None:
        texts["get_PQRDiffSys.m"] = differential_file(model, u)
    for path in sorted(FILES.glob("*.m")):
        texts[path.name] = read_text(path)
    for name, text in texts.items():
        write_text(folder / name, text)
    write_mat(folder / "modelParams.mat", {"modelParams": model_parameters(model, u)})
    write_mat(folder / "droneParams.mat", {"droneParams": drone_parameters(model)})
    write_mat(folder / "reference.mat", {"reference": reference_rows(model, u)})
    if loop is not None:
        write_simulation(model, folder, loop, FILES)
    return Written(u, tuple(notes))


def model_parameters(model: Model, u: Iterable[str] | None) -> dict[str, Any]:
    """modelParams: what getFM and getDroneInputs need to know of the model."""
    scheme = model.normalisation
    extra = list(model.inputs[len(INPUTS) :])
    found = {
        "modelID": model.id,
        "isNormalized": bool(scheme),
        "hasGravity": model.with_gravity,
        "VINFLAG": "v_in" in model.columns,
        "g": GRAVITY,
        "rho": AIR_DENSITY,
        "extraInputs": cells([[name, matlab_name(name)] for name in extra], 2),
        "usesPosition": any(c in model.columns for c in "xyz"),
        "usesRotorAccelerations": model.uses_rotor_accelerations,
        "axes": cells([[axis] for axis in model.axes], 1),
        "lowestSpeeds": np.array([list(find_speed_limits(model.slowest).values())]),
        "DiffSysInputs": cells([[name] for name in u or ()], 1),
    }
    if scheme:
        scale = 0.5 * AIR_DENSITY * 4 * np.pi * scheme.radius**2 * (scheme.radius * scheme.top**2) ** 2
        found |= {
            "topSpeed": scheme.top, "idleSpeed": scheme.idle, "rotorRadius": scheme.radius,
            "armOverRadius": scheme.arm / scheme.radius, "leastAirspeed": MIN_AIRSPEED,
            "forceScale": scale, "momentScale": scale * scheme.arm,
        }  # fmt: skip
    found["units"] = {
        "hasGravity": "1: forces are mass times specific force, a simulation adds gravity; 0: net forces",
        "g": "m/s2", "rho": "kg/m3", "topSpeed": "rad/s", "idleSpeed": "rad/s",
        "lowestSpeeds": "rad/s, limits of w_avg, w_tot, w1, w2, w3, w4 where they stand in a denominator",
    }  # fmt: skip
    return found


def drone_parameters(model: Model) -> dict[str, Any]:
    """droneParams: geometry, mass properties and rotors of the quadrotor, under the names of the manual's tool."""
    frame = model.airframe
    factor = frame.logged_to_rad_s or model.document.get("logged to rad/s")
    simple = model.document.get("simple model") or {}
    kappa = {axis: _number((simple.get(f"kappa{axis}") or {}).get("value")) for axis in ("Fz", "Mx", "My", "Mz")}
    masks = np.array([frame.left, frame.front, frame.spin])
    lags = (drive_of(model.document).get("time constants") or {}).get("value")
    hover = _number(model.hover_speed)
    units = {
        "R": "m", "b": "m, hub to centre of gravity", "Iv": "kg m2, body axes", "mass": "kg", "hubs": "m, body axes",
        "minRPM": "as logged (Betaflight: eRPM/100)", "maxRPM": "as logged (Betaflight: eRPM/100)",
        "loggedToRadS": "rad/s per logged unit, mechanical", "wHover": "rad/s", "wHoverERPM": "as logged",
        "taus": "s", "kappaFz": "N per (rad/s)^2, thrust upwards positive", "M2OmegaMapping": "N m per (rad/s)^2",
        "signMask": "rows left, front, spin; columns rotors", "spin": "1 clockwise seen from above",
        "r1Dir": "1 clockwise seen from above",
    }  # fmt: skip
    return {
        "R": frame.radius,
        "b": frame.arm,
        "Iv": np.asarray(frame.inertia, float),
        "mass": _number(frame.mass),
        "hubs": np.asarray(frame.hubs, float),
        "rotorConfig": {place.replace(" ", "_"): float(n) for place, n in frame.positions.items()} or {"unknown": 0.0},
        "nRotors": 4.0,
        "r1Sign": float(frame.spin[0]),
        "r1Dir": 1.0 if frame.rotor1_clockwise else -1.0,
        "left": masks[0][None],
        "front": masks[1][None],
        "spin": masks[2][None],
        "signMask": masks,
        "minRPM": _number(frame.idle_rpm),
        "maxRPM": _number(frame.max_rpm),
        "loggedToRadS": _number(factor),
        "wHover": hover,
        "wHoverERPM": hover / factor if factor else _UNKNOWN,
        "taus": np.broadcast_to(np.asarray(_UNKNOWN if lags is None else lags, float), 4).reshape(1, 4),
        "simpleModel": {f"kappa{axis}": value for axis, value in kappa.items()},
        "kappaFz": kappa["Fz"],
        "M2OmegaMapping": np.array([[kappa["Mx"]], [kappa["My"]], [kappa["Mz"]]]) * masks,
        "units": units,
    }


def reference_rows(model: Model, u: Iterable[str] | None) -> dict[str, Any]:
    """States, rotor speeds and what `predict` (and the differential form) gives for them, for check_model.m."""
    at = states_of(model, 200)
    forces, moments = model.predict(at.state, at.speeds, at.accelerations, at.extra)
    columns = {matlab_name(name): values[:, None] for name, values in at.extra.items()}
    columns |= {f"w{i + 1}_dot": at.accelerations[:, i : i + 1] for i in range(4)}
    found = {"state": at.state, "inputs": at.speeds, "extra": columns, "F": forces, "M": moments}
    if u is not None:
        form = make_differential_system(model, at.state, at.speeds, u, at.accelerations, at.extra)
        found |= {"A": np.moveaxis(form.A, 0, 2), "B": np.moveaxis(form.B, 0, 2)}
    return found


def cells(rows: list[list[str]], columns: int) -> np.ndarray:
    """A cell array of texts, one row for each of `rows`."""
    found = np.empty((len(rows), columns), object)
    for k, row in enumerate(rows):
        found[k] = row
    return found


def _number(value: float | None) -> float:
    return _UNKNOWN if value is None else float(value)


def write_mat(path: Path, content: dict[str, Any]) -> None:
    """Write a .mat file (version 5, compressed)."""
    buffer = io.BytesIO()
    savemat(buffer, content, oned_as="row", do_compression=True, long_field_names=True)
    write_bytes(path, buffer.getvalue())
