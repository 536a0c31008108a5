"""The project folder that a command works in."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from quasi.project.workflow import Folder

LIBRARY = Path(__file__).parents[2]


def folder_of(directory: Path) -> "Folder":
    """The project folder as Snakemake sees it: raw data lies where config/config.yaml says."""
    from quasi.project.folder import read_settings
    from quasi.project.workflow import Folder

    return Folder(directory, data=read_settings(directory / "config/config.yaml").get("data"))
