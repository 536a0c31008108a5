"""Flights as the search for causes sees them: beside a model, read with what it knows, and where they went."""
