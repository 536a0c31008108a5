"""The catalogue of causes: every file of quasi/gap/causes, and those of a project's own folder."""

import importlib
import pkgutil
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from quasi.errors import ConfigError, DataError, QuasiError, nearest
from quasi.gap import causes
from quasi.gap.effect import Effect, Room, Terms, Values, Vehicle, as_flown
from quasi.gap.flights.evidence import Evidence
from quasi.gap.own_effect import effect_of
from quasi.model.model import AXES
from quasi.terms.expressions import Program, parse
from quasi.terms.variables import Variables


def catalogue(own: Iterable[str | Path] = ()) -> dict[str, Effect]:
    """{id: cause}, the built-in ones and those that the user's Python files define.

    own  paths of files that the user asks for by name; each is run, as any module is
    Raises ConfigError naming the file for one that cannot be run or defines no sound EFFECT, or an id given twice.
    """
    found: dict[str, Effect] = {}
    source: dict[str, str] = {}
    for module in sorted(m.name for m in pkgutil.iter_modules(causes.__path__)):
        effect = importlib.import_module(f"{causes.__name__}.{module}").EFFECT
        found[effect.id] = effect
    for path in map(Path, own):
        effect = effect_of(path)
        if effect.id in found:
            by = source.get(effect.id, "a built-in cause")
            raise ConfigError(f"effect file {path}: the id '{effect.id}' is taken by {by}; choose another")
        found[effect.id], source[effect.id] = effect, str(path)
    for name, path in source.items():
        for rival in (*found[name].rivals, *found[name].always_tied_with):
            if rival not in found:
                raise ConfigError(
                    f"effect file {path}: effect '{name}' names the rival '{rival}', which no cause has as its id"
                    f"{nearest(rival, found)}; correct the file"
                )
    return found


def chosen(wanted: str | Iterable[str], offered: Mapping[str, Effect], where: str) -> dict[str, Effect]:
    """The causes that a configuration asks for: "all" or ids. Raises ConfigError naming file and unknown id."""
    if wanted == "all":
        return dict(offered)
    for name in wanted:
        if name not in offered:
            raise ConfigError(f"{where}: effect '{name}' is not in the catalogue{nearest(name, offered)}")
    return {name: offered[name] for name in wanted}


def in_room(effects: Mapping[str, Effect], room: Room | None) -> dict[str, Effect]:
    """The causes as far as a room has what they need: without its height nothing is known of a ceiling."""
    found = dict(effects)
    if room is not None and room.height is None and "proximity" in found:
        walls = {n: p for n, p in found["proximity"].parameters.items() if n != "ceiling"}
        found["proximity"] = replace(found["proximity"], parameters=walls)
    return found


def columns_of(effect: Effect, evidence: Evidence, vehicle: Vehicle, values: Values) -> dict[str, np.ndarray]:
    """Slope of the residual by each fitted parameter, {parameter: (n, 6)}; of an effect with starts its chord.

    values  deviations from neutral to linearise at; only curved effects ask for them
    Raises DataError or ExpressionError where the flight lacks a column, or the cause makes no numbers of it.
    """
    values = dict.fromkeys(effect.parameters, 0.0) | dict(values)
    try:
        if effect.starts and any(values.values()):
            columns = {name: whole_of(effect, evidence, vehicle, values) / size for name, size in values.items()}
        elif effect.is_nonlinear and any(values.values()):
            columns = {name: _slope(effect, evidence, vehicle, values, name) for name in effect.fitted}
        elif effect.columns is not None:
            columns = effect.columns(evidence, values)
        else:
            columns = {name: wrench_of(terms, evidence) for name, terms in effect.terms(vehicle).items()}
        if effect.sized_by:
            asked = [axis in effect.sized_by for axis in AXES]
            columns = {name: np.where(asked, column, 0.0) for name, column in columns.items()}
        shapes = {name: np.shape(column) for name, column in columns.items()}
    except QuasiError:
        raise
    except Exception as error:  # whatever a user's file does wrong
        raise DataError(
            f"effect '{effect.id}' on flight {evidence.key}: {type(error).__name__}: {error}; correct its file"
        ) from error
    expected = dict.fromkeys(effect.fitted or columns, (len(evidence), 6))
    if shapes != expected:
        raise DataError(
            f"effect '{effect.id}' on flight {evidence.key} gives columns of the shapes {shapes}, expected {expected}; "
            "correct its file"
        )
    for name, column in columns.items():
        bad = np.flatnonzero(~np.isfinite(column).all(axis=1))
        if len(bad):
            raise DataError(
                f"effect '{effect.id}', parameter '{name}', is no finite number at t = {evidence.t[bad[0]]:.2f} s of "
                f"flight {evidence.key}; correct what it divides by or takes a root of, or leave it out of 'effects'"
            )
    return columns


def corrected(evidence: Evidence, effects: Mapping[str, Effect], values: Mapping[str, Values]) -> Evidence:
    """The flight as right instruments would have shown it.

    effects  by id; values {id: deviations} of the causes that are taken to be there
    """
    for name, at in values.items():
        effect = effects.get(name)
        if effect is not None and effect.corrected is not None and any(at.values()):
            evidence = effect.corrected(evidence, dict.fromkeys(effect.parameters, 0.0) | dict(at))
    return evidence


def in_columns(effect: Effect, values: Values, flown: Vehicle) -> Values:
    """What the columns of a cause are multiplied by where it has these deviations. flown  see `effect.as_flown`"""
    return effect.apparent(values, flown) if effect.apparent and values else values


def whole_of(effect: Effect, evidence: Evidence, vehicle: Vehicle, values: Values) -> np.ndarray:
    """All that a cause of these deviations adds to the residual (n, 6)."""
    full = dict.fromkeys(effect.parameters, 0.0) | dict(values)
    if effect.is_nonlinear:
        if effect.full_effect is not None:
            made = effect.full_effect(evidence, vehicle, full)
        else:
            made = wrench_of(effect.nonlinear_terms(vehicle, full), evidence)
        if not np.isfinite(made).all():
            raise DataError(
                f"effect '{effect.id}' with {', '.join(f'{n} = {v:.3g}' for n, v in full.items())} is no finite number "
                f"on flight {evidence.key}; correct what it divides by or takes a root of"
            )
        return made
    columns = columns_of(effect, evidence, vehicle, dict.fromkeys(effect.parameters, 0.0))
    values = in_columns(effect, values, as_flown(vehicle, [evidence]) if effect.apparent else vehicle)
    return sum((columns[name] * value for name, value in values.items()), np.zeros((len(evidence), 6)))


def _slope(effect: Effect, evidence: Evidence, vehicle: Vehicle, values: Values, name: str) -> np.ndarray:
    """Slope of a bending effect at `values` by one parameter, by central differences."""
    step = 1e-3 * max(abs(values[name]), 1e-2 * (effect.parameters[name].high - effect.parameters[name].low))
    sides = [whole_of(effect, evidence, vehicle, {**values, name: values[name] + s * step}) for s in (1, -1)]
    return (sides[0] - sides[1]) / (2.0 * step)


def beyond_slope(
    effect: Effect, evidence: Evidence, vehicle: Vehicle, values: Values, slopes: Mapping[str, np.ndarray]
) -> np.ndarray:
    """What a bending effect at `values` is more than its slopes there, `columns_of`, times the values (n, 6); 0 for
    straight ones."""
    if not effect.is_nonlinear or not any(values.get(n, 0.0) for n in effect.parameters):
        return np.zeros((len(evidence), 6))
    return whole_of(effect, evidence, vehicle, values) - sum(slopes[n] * values[n] for n in values)


def wrench_of(terms: Terms, evidence: Evidence) -> np.ndarray:
    """Wrench (n, 6) of expressions on a flight."""
    variables = Variables(evidence.columns, evidence.airframe, evidence.model.hover_speed)
    result = np.zeros((len(evidence), 6))
    for axis, text in terms.items():
        program = Program([parse(text)])
        values = {name: variables[name] for name in program.names}
        result[:, AXES.index(axis)] = program.run(values, len(evidence))[0]
    return result
