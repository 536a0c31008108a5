"""What a model can be exported to: one entry a target; rules and the table in the docs are made from it."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from quasi.export.agreement import Check
from quasi.export.physical_constants import Physical, physical_constants
from quasi.export.simulator_check import Recovered, check_recovered
from quasi.export.targets import crazyflow, gazebo, mjcf, px4, urdf
from quasi.model.model import Model
from quasi.tables import write_text


class Simulator(NamedTuple):
    """An export of physical constants: models/<model>/<name>.

    title, needs  what it is, and what it needs at the other end
    write         physical constants -> {file: text}; recover  {file: text} -> what the files say
    """

    name: str
    title: str
    needs: str
    write: Callable[[Physical], dict[str, str]]
    recover: Callable[[Mapping[str, str], Physical], Recovered]


SIMULATORS = {
    module.NAME: Simulator(module.NAME, module.TITLE, module.NEEDS, module.write, module.recover)
    for module in (gazebo, px4, crazyflow, mjcf, urdf)
}


def export_to_simulator(model: Model, name: str, folder: str | Path) -> tuple[list[Check], list[str], list[str]]:
    """Write a model's physical constants for a simulator and compare the files with the model.

    Returns the comparisons, notes, and the names of the files. Raises a QuasiError for a model that the target cannot
    carry.
    """
    target, physical = SIMULATORS[name], physical_constants(model)
    files = target.write(physical)
    for file, text in files.items():
        write_text(Path(folder) / file, text)
    checks = check_recovered(model, target.recover(files, physical))
    return checks, list(physical.notes), list(files)
