"""Regressor terms: expressions, variables, normalisation, compiled kernels and their derivatives."""
