"""Quadrotor configurations of the tests: a 3-inch one by its measures, and a plain one to draw."""

from quasi.airframe import read_airframe

LAYOUT = {
    "rotor config": {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3},
    "rotor1 rotation direction": "CW",
}
BEETLE = {
    **LAYOUT,
    "b": 0.077,
    "rotor radius": 0.0381,
    "moment of inertia": "[8.65e-4, 0, 0; 0, 1.07e-3, 0; 0, 0, 1.71e-3]",
}


def to_draw(**more):
    """A plain airframe of round numbers."""
    plain = {"rotor radius": 0.04, "b": 0.08, "moment of inertia": "[1e-3, 0, 0; 0, 1e-3, 0; 0, 0, 2e-3]"}
    return read_airframe({**LAYOUT, **plain, **more}, "drone.json")
