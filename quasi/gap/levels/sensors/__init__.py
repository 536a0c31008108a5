"""Sensors, mounting, frames and clocks: inertial sensors against motion capture."""
