"""Levels K and A: sensors, frames, clocks and the rotors' drive, and what import corrects of them."""
