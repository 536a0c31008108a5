"""Evaluation of a model: scores, diagnostics, verdict and their figures."""
