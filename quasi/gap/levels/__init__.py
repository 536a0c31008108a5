"""Levels of evidence of their own: the trim in steady flight."""
