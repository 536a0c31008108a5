"""The portable model: plain data in model.json, forces and moments from states and rotor speeds.

Reading a model runs nothing: its expressions go through the same parser as a candidate file; there is no code in it.
"""

from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtri, stdtrit

from quasi import tables
from quasi.airframe import Airframe
from quasi.errors import ConfigError, ReadError, ShapeError, nearest
from quasi.model.columns import ACCELERATIONS, ROTORS, columns_from_state, columns_from_table, read_slowest_speeds
from quasi.model.commands import relative_speed_error, rotor_speeds
from quasi.model.document import AXES, airframe_of, check_document, trees_of
from quasi.model.envelope import JOINT_LIMIT, Region, compute_distances, make_region
from quasi.pages.causes import describe_effects
from quasi.terms.differential import Jacobian, list_held_inputs, list_held_variables, split_jacobian
from quasi.terms.expressions import Program, names
from quasi.terms.graph import Graph, Value
from quasi.terms.kernel import INPUTS, Kernel, compile_outputs, compute_wrench, compute_wrench_rows
from quasi.terms.normalisation import read_normalisation as normalisation_from_plain
from quasi.terms.rotor_map import describe_map
from quasi.terms.singularities import remove_singularities
from quasi.terms.variables import Variables, base_columns, check_terms, plain_name


class Model:
    """A polynomial model of forces (N) and moments (N m) in body axes.

    id        model ID
    document  the whole model as plain data
    airframe  geometry, signs, mass properties
    gravity   "withGravity": forces are mass x specific force (hover Fz = -m g), gravity is to be added in a simulation;
              "noGravity": forces are net forces
    axes      identified axes, a selection of Fx Fy Fz Mx My Mz; the others are NaN in every prediction
    trees     {axis: expressions of its terms as they are evaluated, without singularities at stopped rotors}
    slowest   (4,) rad/s, lowest speed of each rotor in the training flights, or the idle speed; None where unknown
    """

    def __init__(self, document: Mapping[str, Any], where: str = "model") -> None:
        check_document(document, where)
        self.document = dict(document)
        self.id: str = document["id"]
        self.gravity: str = document["gravity"]
        self.airframe: Airframe = airframe_of(document["airframe"], where)
        self.hover_speed: float | None = document["hover speed"]["value"]
        self.axes = tuple(a for a in AXES if a in document["axes"])
        written = {a: trees_of(document["axes"][a], a, where) for a in self.axes}
        distinct = list(dict.fromkeys(tree for trees in written.values() for tree in trees))
        self._names = Program(distinct).names
        self._lacking = [k for k, axis in enumerate(AXES) if axis not in self.axes]
        self.normalisation = normalisation_from_plain(document.get("normalisation"), where)
        self._moment_names = [n for axis in AXES[3:] for tree in written.get(axis, ()) for n in names(tree)]
        scheme, radius = self.normalisation, self.airframe.radius
        self.trees = {
            a: [t if scheme else remove_singularities(t, radius) for t in some] for a, some in written.items()
        }
        self.slowest = read_slowest_speeds(document, self.airframe)
        needed = set().union(*(base_columns(n, scheme) for n in self._names), set(ROTORS) if scheme else set())
        self.columns = tuple(sorted(needed))
        self._derivatives: dict[tuple[str, ...], Kernel] = {}
        self.inputs = (*INPUTS, *(c for c in self.columns if c not in INPUTS))

    def graph(self, held: Iterable[str] = ()) -> tuple[Graph, list[list[tuple[float, Value]]]]:
        """The terms of Fx .. Mz as (coefficient, value) on one graph; `held` variables are independent in derivatives.

        An axis that was not identified has no terms. Raises ExpressionError for d_w... without a hover speed.
        """
        graph = Graph(self.airframe, self.hover_speed, held, self.normalisation, self.slowest)
        found = []
        for axis in AXES:
            terms = self.document["axes"].get(axis, {}).get("terms", ())
            values = [graph.value(tree) for tree in self.trees.get(axis, ())]
            if self.normalisation:
                scale = graph.in_si(self.normalisation.scale(axis))
                values = [graph.times(value, scale) for value in values]
            found.append([(term["coefficient"], value) for term, value in zip(terms, values)])
        return graph, found

    @cached_property
    def kernel(self) -> Kernel:
        """The model for compiled loops, see `quasi.terms.kernel`; its inputs are named by `inputs`."""
        graph, terms = self.graph()
        return compile_outputs(graph, [graph.combine(axis) for axis in terms], self.inputs, self._lacking)

    @property
    def with_gravity(self) -> bool:
        """Whether a simulation has to add gravity."""
        return self.gravity == "withGravity"

    @property
    def uses_rotor_accelerations(self) -> bool:
        """Whether a term asks for the rotors' accelerations."""
        return any(c in ACCELERATIONS for c in self.columns)

    def variables(self, columns: Mapping[str, np.ndarray]) -> Variables:
        """The candidate variables of some columns as the model's terms take them."""
        return Variables(columns, self.airframe, self.hover_speed, self.normalisation, self.slowest)

    def predict(
        self,
        state: np.ndarray,
        rotor_speeds: np.ndarray,
        rotor_accelerations: np.ndarray | None = None,
        extra: Mapping[str, np.ndarray] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces (N, 3), N, and moments (N, 3), N m, in body axes: the quasi-steady part of the model.

        Parts with states of their own (payload, inflow, rotor lag and delay) move in the simulator only. Here a payload
        is at rest along the apparent vertical, and the rotors have the given speeds.

        state                (N, 12) roll pitch yaw (rad), u v w (m/s, through the air), p q r (rad/s), x y z (m);
                             or (N, 9) without the position where no term needs it
        rotor_speeds         (N, 4) mechanical rad/s
        rotor_accelerations  (N, 4) rad/s2; without them terms that use them take zero: the quasi-steady prediction
        extra                further columns that terms name (battery_voltage, v_in, ...), each (N,); u_air v_air w_air
                             take the place of u v w
        One row, (12,) or (9,) with (4,), gives (3,) and (3,).
        Raises ShapeError, or ExpressionError for a missing column.
        """
        state, speeds = np.asarray(state, float), np.asarray(rotor_speeds, float)
        if state.ndim == 1 and not extra:
            return self._predict_row(state, speeds, rotor_accelerations)
        result = self.run(self.kernel, state, speeds, rotor_accelerations, extra)
        forces, moments = result[:3].T, result[3:].T
        return (forces[0], moments[0]) if state.ndim == 1 else (forces, moments)

    def predict_from_commands(
        self,
        t: np.ndarray,
        state: np.ndarray,
        commands: np.ndarray,
        volts: np.ndarray | None = None,
        extra: Mapping[str, np.ndarray] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces (N, 3), N, and moments (N, 3), N m, from commands by the model's map, delay and lag of the rotors.

        t         (N,) s, evenly spaced; the rotors start in the steady state of the first command
        commands  (N, 4) shares of the motor output range, or rad/s where the model's map takes speeds
        volts     (N,) V of the battery; None takes the reference voltage of the map
        state, extra  as for `predict`, N rows
        Raises ShapeError, DataError for numbers that are not finite, ConfigError for a model without a command map.
        """
        speeds, accelerations = rotor_speeds(self.document, t, commands, volts)
        return self.predict(np.atleast_2d(np.asarray(state, float)), speeds, accelerations, extra)

    def predict_columns(self, flight: pd.DataFrame | Mapping[str, np.ndarray]) -> pd.DataFrame:
        """Predictions of the identified axes, one column each, of a table with roll .. z, w1 .. w4 and so on."""
        columns, rows = columns_from_table(flight)
        result = self._run(self.kernel, columns, rows)
        index = flight.index if isinstance(flight, pd.DataFrame) else None
        return pd.DataFrame({axis: result[AXES.index(axis)] for axis in self.axes}, index=index)

    def jacobian(
        self,
        state: np.ndarray,
        rotor_speeds: np.ndarray,
        rotor_accelerations: np.ndarray | None = None,
        extra: Mapping[str, np.ndarray] | None = None,
    ) -> Jacobian:
        """Exact derivatives of forces and moments by the state, the rotor speeds and the rotor accelerations.

        Arguments as for `predict`. Returns arrays (N, 6, 12), (N, 6, 4) and (N, 6, 4), rows Fx .. Mz; one row drops the
        leading axis. An axis that the model lacks is NaN. Raises ShapeError or ExpressionError.
        """
        kernel = self.derivative_kernel(INPUTS)
        found = split_jacobian(self.run(kernel, state, rotor_speeds, rotor_accelerations, extra))
        return Jacobian(*(part[0] for part in found)) if np.ndim(state) == 1 else found

    def run(
        self,
        kernel: Kernel,
        state: np.ndarray,
        rotor_speeds: np.ndarray,
        rotor_accelerations: np.ndarray | None = None,
        extra: Mapping[str, np.ndarray] | None = None,
    ) -> np.ndarray:
        """Outputs (M, N) of one of the model's kernels; the other arguments as for `predict`."""
        state, speeds = np.asarray(state, float), np.asarray(rotor_speeds, float)
        return self._run(kernel, *columns_from_state(state, speeds, rotor_accelerations, extra))

    def held_constant(self, u: Iterable[str]) -> list[str]:
        """Variables of the moments that move with the inputs u of a differential form but are kept constant in it."""
        found = self._moment_names
        if self.normalisation:
            trees = [self.normalisation.trees.get(plain_name(n), ("name", n)) for n in found]
            found = [n for tree in [*trees, self.normalisation.scale("Mx")] for n in names(tree)]
        return list_held_variables(found, u)

    def derivative_kernel(self, by: Iterable[str]) -> Kernel:
        """Derivatives of Fx .. Mz by some variables for compiled loops: outputs (6, len(by)), axis after axis.

        by  base columns, or variables such as U_p, by which derivatives treat everything else as constant
        """
        by = tuple(by)
        if by not in self._derivatives:
            graph, terms = self.graph(list_held_inputs(by))
            wrt = [graph.independent(name) for name in by]
            outputs = [graph.combine(axis, node) for axis in terms for node in wrt]
            lacking = [len(by) * m + k for m in self._lacking for k in range(len(by))]
            self._derivatives[by] = compile_outputs(graph, outputs, self.inputs, lacking)
        return self._derivatives[by]

    def distance(
        self,
        state: np.ndarray,
        rotor_speeds: np.ndarray,
        rotor_accelerations: np.ndarray | None = None,
        extra: Mapping[str, np.ndarray] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the distance outside the region of the training data, and the worst variable.

        Arguments as for `predict`. Returns (N,) distances, 0 inside, in units of the covered range (0.5: half of that
        range beyond its end), and (N,) names of the worst variable, "" inside; see `quasi.model.envelope`.
        One row gives a number and a name. A row that holds NaN has the distance NaN.
        Raises ShapeError, ExpressionError, or ConfigError for a model that carries no region.
        """
        state = np.asarray(state, float)
        columns, rows = columns_from_state(state, np.asarray(rotor_speeds, float), rotor_accelerations, extra)
        found, worst = self._distances(columns, rows)
        return (found[0], worst[0]) if state.ndim == 1 else (found, worst)

    def distance_columns(self, flight: pd.DataFrame | Mapping[str, np.ndarray]) -> pd.DataFrame:
        """Compute columns "distance" and "worst" of `distance` for a table with roll .. z, w1 .. w4 and so on."""
        found, worst = self._distances(*columns_from_table(flight))
        index = flight.index if isinstance(flight, pd.DataFrame) else None
        return pd.DataFrame({"distance": found, "worst": worst}, index=index)

    @property
    def region(self) -> Region:
        """The region that the training data covered, for compiled loops, see `quasi.model.envelope`."""
        return self._region[0]

    @property
    def region_names(self) -> tuple[str, ...]:
        """Names of the numbers of worst variables; the last is the joint ellipsoid."""
        return (*self._region[1], JOINT_LIMIT)

    @cached_property
    def _region(self) -> tuple[Region, tuple[str, ...]]:
        if not self.document.get("envelope"):
            raise ConfigError(f"model {self.id} has no region of its training data; build the model again")
        graph = Graph(self.airframe, self.hover_speed, slowest=self.slowest)
        try:
            return make_region(self.document, graph, self.inputs, self.kernel.used, self._names)
        except (LookupError, TypeError, ValueError, AttributeError, np.linalg.LinAlgError) as error:
            raise ConfigError(
                f"model {self.id}: the region of its training data is damaged ({error}); build the model again"
            ) from None

    def _distances(self, columns: Mapping[str, np.ndarray], rows: int) -> tuple[np.ndarray, np.ndarray]:
        region = self.region
        columns = self._inputs_of(columns, rows)
        found, worst = compute_distances(*region, self._gathered(region.kernel, columns, rows))
        return found, np.array([*self.region_names, ""])[worst]

    def interval(
        self, flight: pd.DataFrame | Mapping[str, np.ndarray], level: float | None = None, trimmed: bool = True
    ) -> pd.DataFrame:
        """Prediction intervals: columns <axis>, <axis>_lower, <axis>_upper for each identified axis.

        level    share of measurements that should fall inside; None takes the model's own
        trimmed  of rotor speeds that are estimated from commands: whether each flight's were scaled to balance its mean
                 force and moments; False adds the scatter between flights
        An axis whose coefficients came without data has NaN bounds.
        Variance = residual variance + a C a', C being the coefficients' covariance robust to autocorrelation, + the
        error of rotor speeds that are estimated from commands, by the model's derivatives (delta method);
        quantile of Student's t with the effective number of rows less the number of terms.
        """
        columns, rows = columns_from_table(flight)
        lookup = self._lookup(columns, rows)
        by_speeds = self._variance_by_speeds(columns, rows, trimmed)
        result = {}
        for axis in self.axes:
            part = self.document["axes"][axis]
            confidence = part["confidence level"] if level is None else level
            trees = self.trees[axis]
            values = Program(trees).run(lookup, rows)
            coefficients = np.array([t["coefficient"] for t in part["terms"]])
            a = values[[not t.get("given", False) for t in part["terms"]]]
            covariance = np.array(part["covariance"], float).reshape(len(a), len(a))
            scale = self.normalisation.scale_of(axis, columns) if self.normalisation else 1.0
            with np.errstate(invalid="ignore", over="ignore"):
                variance = (part["sigma2"] + np.einsum("in,in->n", a, covariance @ a)) * scale**2
                deviation = np.sqrt(variance + by_speeds[AXES.index(axis)])
                centre = coefficients @ values * scale
            freedom = part["effective rows"] - len(part["covariance"])
            share = 0.5 * (1.0 + confidence)
            width = (stdtrit(freedom, share) if freedom >= 1 else ndtri(share)) * deviation
            if not part["n"]:  # coefficients without data have no known errors
                width = np.full(rows, np.nan)
            result |= {axis: centre, f"{axis}_lower": centre - width, f"{axis}_upper": centre + width}
        return pd.DataFrame(result, index=flight.index if isinstance(flight, pd.DataFrame) else None)

    def _variance_by_speeds(self, columns: Mapping[str, np.ndarray], rows: int, trimmed: bool) -> np.ndarray:
        """(6, rows) variance of the predictions from estimated rotor speeds; zeros where speeds are measured."""
        error = relative_speed_error(self.document, trimmed)
        if not error:
            return np.zeros((len(AXES), rows))
        speeds = np.stack([np.asarray(columns[w], float) for w in ROTORS])
        slopes = self._run(self.derivative_kernel(ROTORS), columns, rows).reshape(len(AXES), 4, rows)
        return np.sum((slopes * speeds * error) ** 2, axis=1)

    def term_values(self, axis: str, flight: pd.DataFrame | Mapping[str, np.ndarray]) -> np.ndarray:
        """(terms, N) the terms of an identified axis with coefficients of 1, N or N m, over N rows of a flight.

        The coefficients times these is the prediction, so that its derivative by the coefficients is exact.
        """
        columns, rows = columns_from_table(flight)
        values = Program(self.trees[axis]).run(self._lookup(columns, rows), rows)
        return values * self.normalisation.scale_of(axis, columns) if self.normalisation else values

    def summary(self, axes: Iterable[str] | None = None) -> str:
        """The model as text: terms, coefficients, standard errors, units, per axis."""
        lines = [f"Model {self.id} ({self.gravity}, airframe {self.airframe.name})"]
        if self.hover_speed is not None:
            lines.append(f"Hover speed {self.hover_speed:.1f} rad/s")
        lines += describe_map(self.document)
        if self.normalisation:
            lines.append("Coefficients are those of F / N and M / (N b); predictions are in N and N m")
        for extension in self.document.get("extensions") or []:
            lines.append(f"Extended by {extension.get('id')}: {describe_effects(extension)}")
        for axis in self.axes if axes is None else axes:
            if axis not in self.axes:
                raise ConfigError(f"model {self.id} has no axis '{axis}'{nearest(axis, self.axes)}")
            part = self.document["axes"][axis]
            width = max(len("Regressor"), *(len(t["name"]) for t in part["terms"]))
            lines += ["", "#" * (width + 48), f"{axis}  technique: stepwise regression", "-" * (width + 48)]
            lines.append(f"{'Regressor':<{width}}  {'Value':>12}  {'Std':>10}  {'|t|':>8}  Unit")
            for term in part["terms"]:
                t = f"{abs(term['t']):.1f}" if term.get("t") is not None else "given" if term.get("given") else "-"
                lines.append(
                    f"{term['name']:<{width}}  {term['coefficient']:>12.4e}  {term['std']:>10.1e}  {t:>8}  "
                    f"{term['unit']}"
                )
            lines.append("-" * (width + 48))
            lines.append(f"Total number of terms {len(part['terms'])}")
            if part["n"]:
                lines.append(f"R2 {part['R2']:.4f}, RMSE {part['RMSE']:.4g} {part['unit']} on the training rows")
                lines.append(f"{part['n']} training rows, {part['effective rows']:.0f} effective independent rows")
            else:
                lines.append("Coefficients as given, without standard errors")
        return "\n".join(lines)

    def _predict_row(
        self, state: np.ndarray, speeds: np.ndarray, accelerations: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        kernel, size = self.kernel, len(state)
        if size not in (9, 12):
            raise ShapeError(f"state must be (12,) or (9,), roll pitch yaw u v w p q r [x y z], got {state.shape}")
        if speeds.shape not in ((4,), (1, 4)):
            raise ShapeError(f"rotor_speeds must be (4,) like the one row of the state, got {speeds.shape}")
        row = np.zeros(len(INPUTS))
        row[:size] = state
        row[12:16] = speeds.reshape(4)
        if accelerations is not None:
            accelerations = np.asarray(accelerations, float)
            if accelerations.shape not in ((4,), (1, 4)):
                raise ShapeError(f"rotor_accelerations must be (4,) like rotor_speeds, got {accelerations.shape}")
            row[16:] = accelerations.reshape(4)
        if len(self.inputs) > len(INPUTS) or (size == 9 and kernel.used[9:12].any()):
            self._say_what_lacks(dict(zip(INPUTS[: 9 if size == 9 else 12], state)) | dict.fromkeys(INPUTS[12:], 0.0))
        out = np.empty(len(AXES))
        compute_wrench(kernel, row, kernel.work, out)
        return out[:3], out[3:]

    def _columns(self, columns: Mapping[str, np.ndarray], rows: int) -> dict[str, np.ndarray]:
        """The columns as the terms' variables take them."""
        if self.uses_rotor_accelerations and not any(c in columns for c in ACCELERATIONS):
            return {**columns, **dict.fromkeys(ACCELERATIONS, np.zeros(rows))}
        return dict(columns)

    def _lookup(self, columns: Mapping[str, np.ndarray], rows: int):
        found = self._columns(columns, rows)
        return self.variables(found).__getitem__

    def _say_what_lacks(self, columns: Mapping[str, Any]) -> None:
        zeros = {name: np.zeros(1) for name in columns}
        variables = self.variables(zeros)
        with np.errstate(all="ignore"):
            for name in self._names:
                variables[name]

    def _inputs_of(self, columns: Mapping[str, np.ndarray], rows: int) -> dict[str, np.ndarray]:
        """The columns under the names of the kernel's inputs. Raises ExpressionError for one that is missing."""
        columns = self._columns(columns, rows)
        columns |= {name: columns[f"{name}_air"] for name in "uvw" if f"{name}_air" in columns}
        if not all(self.inputs[k] in columns for k in self.kernel.gather.tolist()):
            self._say_what_lacks(columns)
        return columns

    def _run(self, kernel: Kernel, columns: Mapping[str, np.ndarray], rows: int) -> np.ndarray:
        """(outputs, rows) of one of the model's kernels. Raises ExpressionError for a missing column."""
        result = np.empty((kernel.outputs, rows))
        table = self._gathered(kernel, self._inputs_of(columns, rows), rows)
        if rows == 1:  # the machine for many rows works on blocks of them
            inputs = np.zeros(len(self.inputs))
            inputs[kernel.gather] = table[:, 0]
            compute_wrench(kernel, inputs, kernel.work, result[:, 0])
        else:
            compute_wrench_rows(kernel, table, result)
        return result

    def _gathered(self, kernel: Kernel, columns: Mapping[str, np.ndarray], rows: int) -> np.ndarray:
        """(G, rows) what a kernel gathers."""
        table = np.empty((len(kernel.gather), rows))
        for k, position in enumerate(kernel.gather.tolist()):
            table[k] = columns[self.inputs[position]]
        return table


def read_model(path: str | Path) -> Model:
    """Read a model from its folder or its model.json.

    Raises ReadError when there is none, ConfigError or ExpressionError naming file and key when it was damaged, or a
    term names a variable that no flight holds.
    """
    path = Path(path)
    file = path / "model.json" if path.is_dir() else path
    if not file.is_file():
        raise ReadError(f"{path} holds no model.json; make the model first, or give its folder")
    document = tables.read_json(file)
    model = Model(document, str(file))
    check_terms(document, str(file))
    return model
