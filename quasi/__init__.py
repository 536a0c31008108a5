"""From a logbook of quadrotor flights to aerodynamic models, simulations and exports.

Kept nearly empty on purpose: a stage reruns when a module that it imports changes, and every stage imports this one.
"""

import importlib

from quasi.running.compile_cache import use_cache_folder

use_cache_folder()

__version__ = "0.1.0"

_PUBLIC = {"read_model": "quasi.model.model"}


def __getattr__(name: str):
    """Load the public names on first use, so that importing `quasi` costs nothing."""
    if name in _PUBLIC:
        return getattr(importlib.import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'quasi' has no attribute {name!r}; public names are {', '.join(_PUBLIC)}")
