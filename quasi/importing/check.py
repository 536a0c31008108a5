"""`quasi check`: every raw file that the configuration of a project folder names is opened."""

from contextlib import chdir
from pathlib import Path

from quasi.importing.inspection import INSPECTION_MEMORY, Inspector, empty_result, refusals
from quasi.importing.inspection_report import report
from quasi.project.folder import check_project, read_settings
from quasi.project.same_recordings import repeated_recordings
from quasi.project.workflow import Folder
from quasi.running.provenance import compute_code_digest


def check_folder(directory: Path, library: Path, data: str | None = None) -> tuple[str, int]:
    """What the raw files of a project folder hold and what can be made of them; exit code 1 where something is broken.

    library  the folder of quasi's Snakefile; data  replaces the prefix `data/` of raw paths, else config.yaml says
    Raises ConfigError where the folder is no project's.
    """
    check_project(directory)
    with chdir(directory):  # as a run sees the paths of configuration and logbook
        folder = Folder(".", data=data or read_settings("config/config.yaml").get("data"), library=library)
        asked, faults, untouched = folder.configured_work()
        inspector = Inspector(INSPECTION_MEMORY, compute_code_digest(library / "scripts/inspection.py", library))
        flights = {key: about["settings"] for work in asked.values() for key, about in work["flights"].items()}
        pending = {key for key, settings in flights.items() if folder.recordings.to_be_made(settings)}
        found = {
            key: empty_result(settings) if key in pending else inspector.inspect(settings)
            for key, settings in flights.items()
        }
        refused = {name: [fault] for name, fault in faults.items()}
        for name, work in asked.items():
            made = all(Path(path).is_file() for path, _ in work.get("trained", {}).values())
            ready = made and not pending & set(work["flights"])
            repeated = repeated_recordings(work, folder.logbooks.row_names()) if ready else []
            refused[name] = refusals(work, found) + repeated if ready else []
    broken = any(refused.values()) or any(about["problem"] for about in found.values())
    return report(found, refused, pending, untouched, folder.places.notices), int(broken)
