"""Fits of how rotors follow commands, made once for all tests of a file that compare the same flights."""

import contextlib
from collections import OrderedDict

import numpy as np
import pytest

from quasi.gap.levels.drive import identify

MOST_KEPT = 60  # fits, of some 4 MB each


@contextlib.contextmanager
def fitted_once():
    """Within it, `identify` fits each flight once for the same start; what it takes twice cannot be changed."""
    kept, fit = OrderedDict(), identify.fit_drive

    def fit_once(flown, kind, start, has_own_lags=False):
        # the flight is kept too, so that no other can have its number
        key = (id(flown), kind, start.values.tobytes(), start.voltage, has_own_lags)
        if key not in kept:
            found = fit(flown, kind, start, has_own_lags=has_own_lags)
            for part in (p for p in found if isinstance(p, np.ndarray)):
                part.setflags(write=False)
            kept[key] = (flown, found)
        kept.move_to_end(key)
        if len(kept) > MOST_KEPT:
            kept.popitem(last=False)
        return kept[key][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identify, "fit_drive", fit_once)
        yield
