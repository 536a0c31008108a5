"""Made flights as raw logs: per-rotor physics, a flying controller, a pilot, sensors, writers of the real formats."""

import quasi  # noqa: F401 - it sets the folder of compiled kernels
