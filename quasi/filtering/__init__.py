"""Imported flights become states, biases, forces and moments."""
