"""A model extended by named causes: still plain data, so that it predicts, simulates and exports like any other.

Parameters are deviations from a cause's neutral value here: kg more than configured, a share more than 1, and so on.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from quasi.attitude import GRAVITY
from quasi.errors import ConfigError
from quasi.gap.effect import EARTH, Effect, Extension, Values, Vehicle
from quasi.model.extensions import CONFIGURED_INERTIA_KEY, CONFIGURED_MASS_KEY, read_rotor_constants, wind_of
from quasi.model.model import AXES, Model
from quasi.simulation.vehicle.variants import list_part_names, read_payload_and_inflow
from quasi.terms.rotor_map import LAG_FACTORS


def extension_of(effect: Effect, values: Values, vehicle: Vehicle, model: Model) -> Extension:
    """What a cause adds to a model. values  {parameter: deviation from neutral}; parameters left out are neutral."""
    values = dict.fromkeys(effect.parameters, 0.0) | dict(values)
    if effect.extension is not None:
        return effect.extension(values, vehicle, model)
    if effect.nonlinear_terms is not None:
        return Extension(terms={axis: [(text, 1.0)] for axis, text in effect.nonlinear_terms(vehicle, values).items()})
    terms: dict[str, list[tuple[str, float]]] = {}
    for name, parts in effect.terms(vehicle).items():
        if values[name]:
            for axis, text in parts.items():
                terms.setdefault(axis, []).append((text, float(values[name])))
    return Extension(terms=terms)


def extend(
    model: Model,
    causes: Sequence[tuple[Effect, Values]],
    vehicle: Vehicle,
    name: str,
    where: str,
    changes: np.ndarray | None = None,
) -> dict[str, Any]:
    """The extended model as plain data ("quasi.model/1").

    causes  (cause, {parameter: deviation}); name  the new model's ID; where  what found them, for provenance
    changes  (terms,) added to the coefficients of the model's own terms, axis after axis, where they were fitted anew
    A cause that is given twice, for what all flights have and for what is new, acts once, by both together.
    Raises ConfigError for a cause that this model cannot carry, by name.
    """
    causes = joined(causes)
    # what is written into below is new; the rest of the model's document is read only
    document = dict(model.document) | {"id": name, "airframe": dict(model.document["airframe"])}
    document["axes"] = {
        axis: {**part, "terms": [dict(term) for term in part["terms"]]} for axis, part in document["axes"].items()
    }
    # what an earlier gap found stays: a model that is extended already is extended further
    document["extensions"] = list(document.get("extensions") or [])
    known, first = read_rotor_constants(model), len(document["extensions"])
    lengths = {axis: len(part["terms"]) for axis, part in document["axes"].items()}
    if changes is not None:
        own = [term for axis in AXES for term in document["axes"].get(axis, {"terms": []})["terms"]]
        for term, change in zip(own, changes, strict=True):
            term["coefficient"] += float(change)
    if model.normalisation and causes:
        raise ConfigError(f"model {model.id} is normalised; identify it with 'normalize data' false to extend it")
    for effect, values in causes:
        extension = extension_of(effect, values, vehicle, model)
        refuse_second_part(effect.id, extension, model)
        terms = {axis: list(parts) for axis, parts in extension.terms.items()}
        if "cg offset" in extension.airframe:
            for axis, parts in _moments_of(model, np.asarray(extension.airframe["cg offset"]), effect.id).items():
                terms.setdefault(axis, []).extend(parts)
        stands = "inflow lag" if "inflow lag" in extension.states else None
        for axis, parts in terms.items():
            if axis not in document["axes"]:
                raise ConfigError(
                    f"cause '{effect.id}' adds to {axis}, which model {model.id} lacks; identify that axis too"
                )
            document["axes"][axis]["terms"] += [_term(effect.id, text, value, axis, stands) for text, value in parts]
        if "mass" in extension.airframe:
            document.setdefault(CONFIGURED_MASS_KEY, model.airframe.mass)
        if "inertia" in extension.airframe:
            document.setdefault(CONFIGURED_INERTIA_KEY, np.asarray(model.airframe.inertia, float).tolist())
        for key in ("mass", "inertia"):
            if key in extension.airframe:
                document["airframe"][key] = extension.airframe[key]
        document["extensions"].append(
            {
                "id": effect.id,
                "parameters": _reported(effect, values),
                "sentence": effect.happens({n: v + (effect.parameters[n].neutral or 0.0) for n, v in values.items()}),
                "airframe": extension.airframe,
                "actuators": _in_all(extension.actuators, known),
                "environment": extension.environment,
                "states": extension.states,
            }
        )
    for number, section in enumerate(document["extensions"]):
        if "swinging load" in (section.get("states") or {}):
            load = float(section["states"]["swinging load"]["mass"])
            _hang(document, load, section["id"], lengths if number < first else {})
    wind = wind_of(Model(document, f"model {name}"))  # which raises ConfigError where the whole is no model
    if wind.any():
        document["environment"] = {**document.get("environment", {}), "wind": wind.tolist()}
    ids = ", ".join(effect.id for effect, _ in causes) or "nothing"
    document["notes"] = [*document.get("notes", []), f"{where}: model {model.id} extended by {ids}"]
    document["provenance"] = {**document.get("provenance", {}), "extended from": model.id, "by": where}
    return document


def joined(causes: Sequence[tuple[Effect, Values]]) -> list[tuple[Effect, Values]]:
    """Each cause once: deviations add up; constants of the drive that are stated as they are stand for both, and its
    factors multiply."""
    found: dict[str, tuple[Effect, dict[str, float]]] = {}
    for effect, values in causes:
        _, together = found.setdefault(effect.id, (effect, {}))
        for name, value in values.items():
            neutral = effect.parameters[name].neutral if effect.level == "drive" else 0.0
            before = 0.0 if neutral is None else together.get(name, 0.0)
            together[name] = before + float(value) * (1.0 + before if neutral else 1.0)
    return list(found.values())


def _reported(effect: Effect, values: Values) -> dict[str, dict[str, Any]]:
    """{parameter: {"value", "unit"}} as a diagnosis reports them."""
    if effect.reported is not None:
        sizes = effect.reported(values, dict.fromkeys(values, 0.0))
        return {n: {"value": size.value, "unit": size.unit} for n, size in sizes.items()}
    return {n: {"value": float(v), "unit": effect.parameters[n].unit} for n, v in values.items()}


def refuse_second_part(cause: str, extension: Extension, model: Model) -> None:
    """Raise ConfigError where a model carries a part with states of its own already that a cause would add."""
    for part in list_part_names(read_payload_and_inflow(model)):
        if part in extension.states:
            raise ConfigError(
                f"cause '{cause}' adds a second {part} to model {model.id}, which has room for one; compare the "
                "flights with the model that this one was extended from"
            )


def _in_all(found: Mapping[str, float], known: Mapping[str, float]) -> dict[str, float]:
    """Constants of rotors and their logs with what an earlier extension holds: delays add up, factors multiply."""
    result = dict(found)
    factors = [found.get(n, 1.0) for n in LAG_FACTORS]
    if "time constant" in known and any(n in found for n in LAG_FACTORS):
        result.setdefault("time constant", known["time constant"] * float(np.exp(np.mean(np.log(factors)))))
    result |= {n: known.get(n, 1.0) * f for n, f in zip(LAG_FACTORS, factors) if n in found}
    if "telemetry delay" in found:
        result["telemetry delay"] += known.get("telemetry delay", 0.0)
    if "rotor speed scale" in found:
        result["rotor speed scale"] *= known.get("rotor speed scale", 1.0)
    return result


def _hang(document: dict[str, Any], load: float, cause: str, hung: Mapping[str, int]) -> None:
    """Terms for a load that hangs at rest along the apparent vertical, in predictions without its swing.

    It takes the share load/(mass + load) off the aerodynamic force: as if it were fixed at the cg.
    hung  {axis: how many terms it has been taken off already}; {} for a new load
    """
    mass, axes = document["airframe"]["mass"], document["axes"]
    if mass is None or any(axis not in axes for axis in AXES[:3]):
        lacks = "mass; fill in 'Mass' in the logbook" if mass is None else "force along x, y or z; identify all three"
        raise ConfigError(f"cause '{cause}' is a load that pulls at the vehicle, but the model knows no {lacks}")
    share = load / (mass + load)
    for axis, upright in zip(AXES[:3], EARTH["z"]):
        new = axes[axis]["terms"][hung.get(axis, 0) :]
        terms = [(t["expression"], -share * t["coefficient"]) for t in new if t["coefficient"]]
        if not hung and document["gravity"] != "withGravity":
            terms.append((upright, share * mass * GRAVITY))
        axes[axis]["terms"] += [_term(cause, text, value, axis, "swinging load") for text, value in terms]


def _term(cause: str, expression: str, coefficient: float, axis: str, stands: str | None = None) -> dict[str, Any]:
    """A term of a cause. stands  the part with states of its own that it stands in for in quasi-steady predictions."""
    unit = "N" if axis.startswith("F") else "N m"
    return {
        **({"stands for": stands} if stands else {}),
        "name": f"{cause}: {expression if len(expression) <= 40 else expression[:37] + '...'}",
        "expression": expression, "coefficient": coefficient, "std": 0.0, "plain std": 0.0, "t": None, "unit": unit,
        "fixed": True, "given": True, "extension": cause,
    }  # fmt: skip


def _moments_of(model: Model, shift: np.ndarray, cause: str) -> dict[str, list[tuple[str, float]]]:
    """-shift x F, term by term: moments about a cg at `shift` from the configured one."""
    if not model.with_gravity:
        raise ConfigError(
            f"cause '{cause}' needs a model whose forces leave gravity out; identify {model.id} withGravity"
        )
    x, y, z = shift
    result: dict[str, list[tuple[str, float]]] = {}
    for axis, pairs in {
        "Mx": (("Fz", -y), ("Fy", z)),
        "My": (("Fx", -z), ("Fz", x)),
        "Mz": (("Fy", -x), ("Fx", y)),
    }.items():
        for force, arm in pairs:
            for term in model.document["axes"][force]["terms"]:
                if arm and not term.get("stands for"):
                    result.setdefault(axis, []).append((term["expression"], arm * term["coefficient"]))
    return result
