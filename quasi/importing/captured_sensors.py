"""Sensors that a log lacks, made from a motion capture: specific force of its position, body rates of its attitude.

The capture is tied to the log's clock by what the log still holds, body rates or an attitude. A capture that the log
itself stamps needs no tie, so that even a log of rotors and capture alone can be used.
Source: f = R^T (d2x/dt2 - g); errors as in `quasi.importing.reconstruction`.
"""

from dataclasses import dataclass

import numpy as np

from quasi.attitude import GRAVITY, body_rates, continuous, rotate_inverse, to_euler
from quasi.errors import DataError
from quasi.importing.clocks.synchronisation import Motion, synchronise
from quasi.importing.derivatives import derivative_error, origin_of
from quasi.importing.resampling import grid, low_pass, resample_attitude, velocity
from quasi.importing.series import Series, Track

QUATERNION, POSITION_COLUMNS = ("qw", "qx", "qy", "qz"), ("x", "y", "z")


@dataclass(frozen=True)
class Captured:
    """A motion capture from which sensors may be made.

    series       x y z (m, earth NED) and qw qx qy qz, on the capture's clock
    same_clock   whether the log stamps it, so that its times are the log's
    longest_lag  s, of the search for its clock; None leaves the clocks apart, where only rates are asked for
    gyro_delay   s, by which the log's own filters make its body rates late
    """

    series: Series
    same_clock: bool
    longest_lag: float | None = None
    gyro_delay: float = 0.0

    @property
    def complete(self) -> bool:
        """Whether position and attitude were captured."""
        return all(name in self.series.values for name in (*POSITION_COLUMNS, *QUATERNION))

    def times(self, gyro: Track | None, where: str) -> np.ndarray:
        """Times (n,) s of the capture on the log's clock. Raises DataError where nothing ties the two clocks.

        gyro  body rates (m, 3), rad/s, logged or of a logged attitude
        """
        if self.same_clock:
            return self.series.t
        if gyro is None:
            raise DataError(
                f"{where}: the log holds neither body rates nor an attitude, so that nothing ties the capture to it; "
                "log the gyro, or write rotors and capture into one table with one clock"
            )
        if self.longest_lag is None:
            return self.series.t
        onboard = Motion(gyro.t - self.gyro_delay, gyro.values)
        seen = Motion(
            self.series.t, quaternion=self.series.matrix(QUATERNION), position=self.series.matrix(POSITION_COLUMNS)
        )
        return synchronise(onboard, seen, (), self.longest_lag, where).to_onboard(self.series.t)


def force_and_rates(captured: Captured, t: np.ndarray, bandwidth: float) -> dict[str, tuple[Track, dict]]:
    """Specific force (m, 3), m/s2, and body rates (m, 3), rad/s, of a capture; rows near its gaps are left out.

    t          (n,) s, times of the capture on the log's clock; bandwidth  Hz of derivatives (-3 dB)
    Returns    {"accelerometer" | "gyro": (Track, how it was made)}
    """
    place, turned = captured.series.matrix(POSITION_COLUMNS), captured.series.matrix(QUATERNION)
    seen = np.isfinite(place).all(axis=1) & np.isfinite(turned).all(axis=1)
    t, place, turned = t[seen], place[seen], turned[seen]
    rate = 1.0 / float(np.median(np.diff(t)))
    at = grid(t[0], t[-1], rate)
    speed, trusted = velocity(t, place, at, bandwidth)
    acceleration, _ = velocity(at, speed, at, bandwidth)
    attitude = resample_attitude(t, turned, at)
    known = trusted & attitude.covered
    force = rotate_inverse(attitude.values, acceleration - np.array([0.0, 0.0, GRAVITY]))
    rates = low_pass(body_rates(attitude.values, at), rate, bandwidth)
    angles = Track(t, np.unwrap(to_euler(continuous(turned)), axis=0))
    tilted = GRAVITY * derivative_error(angles, rate, bandwidth, 0)
    error = float(np.hypot(derivative_error(Track(t, place), rate, bandwidth, 2), tilted))
    turning = derivative_error(angles, rate, bandwidth, 1)
    return {
        "accelerometer": (
            Track(at[known], force[known]),
            origin_of("the captured position and attitude", bandwidth, rate, error, "m/s2"),
        ),
        "gyro": (Track(at[known], rates[known]), origin_of("the captured attitude", bandwidth, rate, turning, "rad/s")),
    }
