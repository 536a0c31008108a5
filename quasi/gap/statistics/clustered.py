"""Mixed model whose tests count whole flights, or sessions, as independent units as well."""

from collections.abc import Sequence

import numpy as np

from quasi.gap.statistics.candidates import Candidate, Columns, Test
from quasi.gap.statistics.mixed import MixedModel


class ClusteredMixedModel(MixedModel):
    """Tests by stretches whose p whole flights have a say in.

    A model errs with the manoeuvre, and manoeuvres change within a flight: segments show how much a cause's apparent
    parameters deviate. Manoeuvres of one flight may err alike, though, and then are no independent witnesses. The
    geometric mean of both p is a p where these rise and fall together, as tests of the same samples do: exactly so when
    they are equal, and too large when they are independent. (Of p that may oppose each other e times as much is needed,
    Vovk & Wang, 2020.)

    units  positions of the flights of each session, where sessions and not flights are the independent witnesses. Then
           a cause has to stand out from their spread as well: flights of one sitting repeat each other
    """

    def __init__(
        self, grams: Sequence[np.ndarray], compared: Sequence[bool], columns: Columns,
        units: Sequence[Sequence[int]] | None = None, sessions: Sequence[str] = (),
    ) -> None:  # fmt: skip
        super().__init__(grams, compared, columns, sessions=sessions)
        alone = self.count == len(self.compared) and units is None
        whole = [np.asarray(g).reshape(-1, *np.shape(g)[-2:]).sum(axis=0) for g in grams]
        flags = list(compared)
        self._by_session = units is not None
        if units is not None:
            flags = [bool(compared[members[0]]) for members in units]
            whole = [sum(whole[k] for k in members) for members in units]
            sessions = [sessions[members[0]] for members in units] if len(sessions) else ()
        self._of_flights = None if alone else MixedModel(whole, flags, columns, sessions=sessions)

    def between(self, offer: Candidate, given: Sequence[Candidate] = (), pooled: Sequence[str] = ()) -> Test:
        """The same with whole flights as witnesses alone."""
        return (self._of_flights or super()).test(offer, given, pooled)

    def test(self, offer: Candidate, given: Sequence[Candidate] = (), pooled: Sequence[str] = ()) -> Test:
        """A cause with others given, see `MixedModel.test`."""
        test = super().test(offer, given, pooled)
        if self._of_flights is None:
            return test
        p = self.between(offer, given, pooled).p_known_spread
        return test._replace(p=max(test.p, p) if self._by_session else float(np.sqrt(test.p * p)))
