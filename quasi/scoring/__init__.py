"""How well a model does: scores, diagnostics, verdict and their figures."""
