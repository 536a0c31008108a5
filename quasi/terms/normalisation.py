"""Non-dimensional variables and coefficients, the manual's modified helicopter scheme (not recommended).

With a = the root mean square of the four rotor speeds, never taken below the idle speed, and

    N = 1/2 rho (4 pi R^2) (R w_max^2 / (w_max + w_avg))^2

forces become F / N and moments M / (N b), and the variables of a polynomial stand for

    w1..w4                 w / a                     u_p u_q u_r   sums of those
    w2_1.., U_p U_q U_r    squares over a^2, sums    w1_dot.., w_tot_dot, u_p_dot ..   over a^2
    w_tot, w_avg, d_w..    over w_max                w1_CMD..      over a
    p q r                  b / (a R)                 mu_x mu_y mu_z mu_vin, v_in       over a R
    u v w (u_air ..)       over the airspeed, never taken below 0.01 m/s
    F_den, M_den           N and N b themselves

Angles, positions and all else stay as they are. The two limits keep every variable finite with rotors that stand still
and in hover; the manual's text has none.

Source: QuaSI user manual V1.0.a, section 6.3, equations (13) to (18).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from quasi.airframe import Airframe
from quasi.attitude import AIR_DENSITY
from quasi.errors import ConfigError
from quasi.terms.expressions import Tree, evaluate, parse

MIN_AIRSPEED = 0.01  # m/s


@dataclass(frozen=True)
class Normalisation:
    """What the scheme needs of a quadrotor: top and idle rotor speed (rad/s), rotor radius and arm b (m)."""

    top: float
    idle: float
    radius: float
    arm: float

    @cached_property
    def trees(self) -> dict[str, Tree]:
        """{variable: expression of dimensional variables that it stands for}."""
        a, speed = _limit_below("w_avg", self.idle), _limit_below("(u^2 + v^2 + w^2)^0.5", MIN_AIRSPEED)
        texts = {f"w{i}{suffix}": f"w{i}{suffix}/{a}" for i in range(1, 5) for suffix in ("", "_CMD")}
        texts |= {f"w2_{i}": f"w{i}^2/{a}^2" for i in range(1, 5)}
        texts |= {f"w{i}_dot": f"w{i}_dot/{a}^2" for i in range(1, 5)}
        texts |= {name: f"{name}/{a}" for name in ("u_p", "u_q", "u_r")}
        squares = ("U_p", "U_q", "U_r", "w_tot_dot", "u_p_dot", "u_q_dot", "u_r_dot")
        texts |= {name: f"{name}/{a}^2" for name in squares}
        texts |= {n: f"{n}/{self.top!r}" for n in ("w_tot", "w_avg", "d_w_tot", *(f"d_w{i}" for i in range(1, 5)))}
        texts |= {rate: f"{rate}*{self.arm / self.radius!r}/{a}" for rate in "pqr"}
        texts |= {velocity: f"{velocity}/{speed}" for velocity in "uvw"}
        ratios = {"mu_x": "u", "mu_y": "v", "mu_z": "w", "mu_vin": "v_in", "v_in": "v_in"}
        texts |= {name: f"{of}/({a}*{self.radius!r})" for name, of in ratios.items()}
        texts |= {"F_den": self._scale(1.0), "M_den": self._scale(self.arm)}
        return {name: parse(text) for name, text in texts.items()}

    def scale(self, axis: str) -> Tree:
        """Expression of N for a force "Fx" .. "Fz", of N b for a moment "Mx" .. "Mz"."""
        return self.trees["F_den" if axis[0] == "F" else "M_den"]

    def scale_of(self, axis: str, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """N or N b (n,), in N or N m, from columns w1..w4 (rad/s)."""
        squares = sum(np.asarray(columns[f"w{i}"], float) ** 2 for i in range(1, 5))
        return evaluate(self.scale(axis), {"w_avg": np.sqrt(squares / 4.0)})

    def _scale(self, length: float) -> str:
        constant = 0.5 * AIR_DENSITY * 4 * np.pi * self.radius**2 * (self.radius * self.top**2) ** 2 * length
        return f"{float(constant)!r}/({self.top!r} + w_avg)^2"

    def to_plain(self) -> dict[str, float]:
        """As it stands in a model; `read_normalisation` reads it back."""
        return {"top": self.top, "idle": self.idle, "rotor radius": self.radius, "b": self.arm}


def _limit_below(text: str, least: float) -> str:
    # the larger of two numbers in the grammar's own means: (x + l + |x - l|)/2
    return f"(0.5*({text} + {least!r} + (({text} - {least!r})^2)^0.5))"


def read_normalisation(plain: Any, where: str) -> Normalisation | None:
    """Inverse of `Normalisation.to_plain`; None gives None. Raises ConfigError for damaged data."""
    if plain is None:
        return None
    keys = ("top", "idle", "rotor radius", "b")
    values = [plain.get(k) for k in keys] if isinstance(plain, Mapping) else [None]
    if not all(isinstance(v, int | float) and not isinstance(v, bool) and 0 < v < 1e9 for v in values):
        raise ConfigError(f"{where}: 'normalisation' must hold positive numbers {', '.join(keys)}; make the model anew")
    return Normalisation(*map(float, values))


def make_normalisation(airframe: Airframe, logged_to_rad_s: float | None, where: str) -> Normalisation:
    """The scheme of a quadrotor.

    logged_to_rad_s  factor from the unit of 'idle RPM' and 'max RPM' to rad/s, None takes the airframe's own
    Raises ConfigError naming what the quadrotor configuration lacks.
    """
    factor = airframe.logged_to_rad_s or logged_to_rad_s
    for key, value in (("max RPM", airframe.max_rpm), ("idle RPM", airframe.idle_rpm)):
        if not value or value <= 0:
            raise ConfigError(
                f"{where}: 'normalize data' needs '{key}' of quadrotor {airframe.name}; fill it in, or set "
                "'normalize data' to false"
            )
    if not factor:
        raise ConfigError(
            f"{where}: 'normalize data' needs 'motor poles' of quadrotor {airframe.name}, to turn 'max RPM' into "
            "rad/s; fill it in"
        )
    if airframe.idle_rpm >= airframe.max_rpm:
        raise ConfigError(
            f"{where}: 'idle RPM' {airframe.idle_rpm:g} of quadrotor {airframe.name} is not below "
            f"'max RPM' {airframe.max_rpm:g}; correct them"
        )
    return Normalisation(airframe.max_rpm * factor, airframe.idle_rpm * factor, airframe.radius, airframe.arm)
