"""What the selection of causes knows of each one."""

from dataclasses import dataclass

import numpy as np

from quasi.gap.effect import Effect, Limits
from quasi.gap.statistics.candidates import Test

LIMIT_ERRORS = 3.0  # standard errors by which an estimate may lie outside its physical range


@dataclass(frozen=True)
class Profile:
    """What the selection knows of a cause.

    parts  how its parameters may be selected, see `MixedModel.best`; rivals  causes that it is confused with
    always_tied_with  causes that no data separate from it; absorbed  whether the model's own terms can mimic it exactly
    leading  (m,) whether a parameter is what the cause is about, not one that accompanies it
    limits   physical range of the parameters' deviations, None without
    """

    parts: str = "all"
    rivals: tuple[str, ...] = ()
    always_tied_with: tuple[str, ...] = ()
    absorbed: bool = False
    leading: tuple[bool, ...] = ()
    limits: Limits | None = None

    @classmethod
    def of(cls, effect: Effect, limits: Limits | None = None) -> "Profile":
        """The profile of a cause of the catalogue that acts on forces and moments."""
        leading = tuple(effect.parameters[name].typical is not None for name in effect.fitted)
        return cls(effect.parts, effect.rivals, effect.always_tied_with, effect.absorbed_by_model, leading, limits)

    def is_possible(self, test: Test) -> bool:
        """Whether the parameters are physical within LIMIT_ERRORS standard errors."""
        if self.limits is None:
            return True
        which = list(test.offer.which)
        low, high = np.array(self.limits.ranges, float)[which].T
        margin = LIMIT_ERRORS * test.std
        inside = (low - margin <= test.value) & (test.value <= high + margin)
        sums = [(w[which], least) for w, least in self.limits.sums]
        return bool(inside.all()) and all(
            w @ test.value + LIMIT_ERRORS * np.sqrt(w @ test.covariance @ w) >= least for w, least in sums
        )

    def has_leading_deviation(self, test: Test) -> bool:
        """Whether a leading parameter differs from neutral by three standard errors.

        Still air with a downdraught, or a centre of gravity that is off in height alone, stand in for another cause.
        """
        about = [self.leading[k] for k in test.offer.which] if self.leading else []
        far = [abs(value) > 3.0 * std for value, std in zip(test.value, test.std)]
        return not any(about) or any(a and f for a, f in zip(about, far))
