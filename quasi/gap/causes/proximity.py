"""Walls and a ceiling close by."""

from quasi.errors import DataError
from quasi.gap.effect import Effect, Parameter, Terms, Vehicle, hub_position, least, most, number, thrust_wrench

WALL_REACH = 1.0  # m, over which the air that a wall throws back dies away
NEAREST = 0.2  # rotor radii: below, the formula of the ceiling is not used


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    if vehicle.room is None:
        raise DataError(
            "the walls are unknown; give the room as 'room' in the gap's configuration "
            '({"north": [low, high], "east": [low, high], "height": ...}, m)'
        )
    room = vehicle.room
    walls, ceiling = [], []
    for i in range(4):
        north, east, down = hub_position(vehicle, i)
        along = [
            least(f"({place} - {number(low)})", f"({number(high)} - {place})")
            for place, (low, high) in ((north, room.north), (east, room.east))
        ]
        wall = most(least(*along), "0")
        thrust = f"{number(vehicle.thrust)}*w{i + 1}^2"
        walls.append(f"-{thrust}*2.718281828459045^(-({wall}/{number(WALL_REACH)})^2)")
        if room.height is not None:
            below = most(f"({number(room.height)} + {down})", number(NEAREST * vehicle.radius))
            ceiling.append(f"{thrust}*({number(vehicle.radius)}/(4*{below}))^2")
    terms = {"gain": thrust_wrench(vehicle, walls)}
    return terms | ({"ceiling": thrust_wrench(vehicle, ceiling)} if ceiling else {})


EFFECT = Effect(
    id="proximity",
    level="forces",
    sentence="the rotors lose thrust near a wall, in the air that it throws back, or gain thrust below a ceiling",
    opposite="the rotors gain thrust near a wall or below a ceiling",
    equation="T = T0 (1 - gain exp(-(d/1 m)^2) + ceiling (R/4h)^2), d to the nearest wall, h to the ceiling, each hub",
    source="ceiling: Hsiao & Chirarattananon, Ceiling effects for hybrid aerial-surface locomotion of small "
    "rotorcraft, IEEE/ASME T-Mech 24(5), 2019; the wall's form is empirical",
    parameters={"gain": Parameter("1", 0.0, "s", -0.9, 0.9, 0.1), "ceiling": Parameter("1", 0.0, "s", 0.0, 20.0)},
    channels=("Fz", "Mx", "My"),
    rivals=("ground_effect", "tether"),
    tie_breaker="hover at the same height in the middle of the room and at its walls",
    terms=_terms,
    absent_when_healthy=True,
)
