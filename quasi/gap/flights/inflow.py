"""Thrust of rotors whose inflow follows late: the whole response, where first order is not enough."""

import numpy as np
from scipy.signal import lfilter

from quasi.gap.flights.evidence import Evidence
from quasi.gap.statistics.whitening import stretches

SHORTEST_LAG = 5e-4  # s: a shorter lag is over within a step of any simulation, and its first order is all of it


def overshoot(evidence: Evidence, gain: float, lag: float) -> np.ndarray:
    """Wrench (n, 6) of thrust beyond that of an inflow in equilibrium, N and N m.

    gain  N s2/rad2 of one rotor: to first order thrust is off by gain W dW/dt lag; lag  s
    The induced velocity goes with W and follows with a first-order lag: half the gain times W^2 less its low-passed
    value, exact for squares that change linearly between samples.
    """
    if lag < SHORTEST_LAG:  # also below nothing, where slopes are taken
        return evidence.upward(gain * lag * evidence.speeds * evidence.spin_up)
    step = float(np.median(np.diff(evidence.t)))
    keep = np.exp(-step / lag)
    now = 1.0 - lag / step * (1.0 - keep)
    weights = [now, 1.0 - keep - now]
    squares = evidence.speeds**2
    late = np.empty_like(squares)
    for part in stretches(evidence.breaks):
        # the filter has seen the first value for long
        begin = ((weights[1] + keep) * squares[part][0])[None, :]
        late[part] = lfilter(weights, [1.0, -keep], squares[part], axis=0, zi=begin)[0]
    return evidence.upward(0.5 * gain * (squares - late))
