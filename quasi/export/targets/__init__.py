"""Exports to simulators, one file a target; `quasi.export.registry` reads them all.

The names stand here so that the rules know them without importing the targets.
"""

SIMULATOR_NAMES = ("gazebo", "px4", "crazyflow", "mjcf", "urdf")
