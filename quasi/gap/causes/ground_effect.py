"""More thrust near the floor."""

from quasi.gap.effect import Effect, Parameter, Terms, Values, Vehicle, hub_position, least, most, number, thrust_wrench

# Rotor radii: a choice. For one rotor (c = 1) the formula has its pole at R/4; at R/2 it gives a third more thrust.
# Below, a few rows of a take-off would decide c.
LEAST_HUB_HEIGHT = 0.5
MOST_GROUND_EFFECT = 0.6  # of c (R/4h)^2: above, the formula runs towards its pole, where no rotor has been measured


def _nearness(vehicle: Vehicle, rotor: int) -> str:
    """(R/4h)^2, h kept above its smallest value."""
    kept = most(f"(-{hub_position(vehicle, rotor)[2]})", number(LEAST_HUB_HEIGHT * vehicle.radius))
    return f"({number(vehicle.radius)}/(4*{kept}))^2"


def _split(wrench: Terms) -> dict[str, Terms]:
    # that rotors lower than others make more thrust levels the vehicle, which not every floor and frame shows
    return {"c": {"Fz": wrench["Fz"]}, "levelling": {axis: wrench[axis] for axis in ("Mx", "My")}}


def _terms(vehicle: Vehicle) -> dict[str, Terms]:
    thrusts = [f"{number(vehicle.thrust)}*w{i + 1}^2*{_nearness(vehicle, i)}" for i in range(4)]
    return _split(thrust_wrench(vehicle, thrusts))


def _curved(vehicle: Vehicle, values: Values) -> Terms:
    made: Terms = {}
    for name in ("c", "levelling"):
        thrusts = []
        for i in range(4):
            whole = f"{number(values.get(name, 0.0))}*{_nearness(vehicle, i)}"
            near = least(whole, number(MOST_GROUND_EFFECT))
            thrusts.append(f"{number(vehicle.thrust)}*w{i + 1}^2*({near}/(1 - {near}))")
        made |= _split(thrust_wrench(vehicle, thrusts))[name]
    return made


EFFECT = Effect(
    id="ground_effect",
    level="forces",
    sentence="the rotors make more thrust near the floor",
    equation="T/T0 = 1/(1 - c (R/4h)^2), h hub height, from R/2 up; levelling = c as far as lower rotors make more",
    source="Cheeseman & Bennett, The effect of the ground on a helicopter rotor in forward flight, ARC R&M 3021, 1955",
    parameters={"c": Parameter("1", 0.0, "a", 0.0, 20.0, 3.0), "levelling": Parameter("1", 0.0, "a", 0.0, 20.0)},
    channels=("Fz", "Mx", "My"),
    rivals=("tether", "proximity"),
    tie_breaker="a staircase of hovers from 2 cm to 50 cm",
    terms=_terms,
    nonlinear_terms=_curved,
    parts="first",
    absent_when_healthy=True,
)
