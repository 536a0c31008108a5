"""Flights for the search for causes: compared with a model, read with what it knows, and where they went."""
