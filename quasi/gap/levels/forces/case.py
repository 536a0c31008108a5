"""What a diagnosis works on, and the extended model that some causes make of it."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from quasi.gap.effect import Effect, Vehicle
from quasi.gap.extension import extend
from quasi.gap.flights.evidence import Evidence
from quasi.gap.levels.forces.design import Design, refit_with
from quasi.gap.levels.forces.error_reduction import after
from quasi.gap.materiality import Cause
from quasi.model.model import AXES, Model


class Case(NamedTuple):
    """A model and flights that it is compared with.

    effects    the catalogue; vehicle  what they act on
    learning   flights that choose and fit; compared (F,) bool, False for reference flights
    held       held-out flights; tables {key: filtered flight}
    drive      causes of the drive that belong in the model, with their deviations; always  ids of those that were
               always there
    corrected  axes of which flights that the model was identified from were corrected: its terms hold what their
               sensors faked, and are fitted anew
    settings   of the gap
    trim       what the trim in steady flight says (`levels.trim_evidence.TrimEvidence`), None where it was not asked
    """

    model: Model
    effects: Mapping[str, Effect]
    vehicle: Vehicle
    learning: Sequence[Evidence]
    compared: Sequence[bool]
    held: Sequence[Evidence]
    tables: Mapping[str, pd.DataFrame]
    drive: Sequence[tuple[Effect, Mapping[str, float]]]
    corrected: Collection[str]
    settings: Mapping[str, Any]
    always: Sequence[str] = ()
    trim: Any = None

    def anew(self, causes: Sequence[Cause]) -> Collection[str]:
        """Axes whose terms are fitted anew with some causes: all with those that were always there."""
        return AXES if any(c.since == "always" for c in causes) else self.corrected

    def extended(
        self, causes: Sequence[Cause], study: Design | None, where: str, anew: Collection[str], changed: bool = True
    ) -> dict[str, Any]:
        """The document of the model with some causes and the drive's.

        study    of the flights that learn; anew  axes whose terms are fitted to these, with all these causes
        changed  without: as reference flights have it, that is with what was always there alone
        """
        changes = None
        if study is not None and anew:
            changes = refit_with(study, self.compared, [(c, c.value) for c in causes], anew)
        acting = [(c.effect, c.value) for c in causes if changed or c.since == "always"]
        acting += [(effect, values) for effect, values in self.drive if changed or effect.id in self.always]
        document = extend(self.model, acting, self.vehicle, self.settings["extended model ID"], where, changes)
        document.pop("differential form", None)
        return document

    def left(
        self,
        extended: Model,
        causes: Sequence[Cause],
        study: Design | None,
        anew: Collection[str],
        roles: Mapping[str, str],
    ) -> Callable[[Evidence], np.ndarray]:
        """Residual (n, 6), N and N m, of a flight under the model extended by `causes`, whatever its role.

        A reference flight does not have what changed: there the model holds what was always there alone.
        """
        lasting = Model(self.extended(causes, study, "reference flights", anew, changed=False), "reference flights")
        of_role = {"reference": after(lasting, self.model)}
        return lambda flight: of_role.get(roles[flight.key], after(extended, self.model))(flight)
