"""Configuration files under the names that QuaSI gives them: where they belong in a project folder."""

from pathlib import Path

from quasi.errors import QuasiError
from quasi.tables import read_json

# QuaSI's name: (place in a project folder, keys of its first level that identify it among JSON files)
PLACES = {
    "processConfig.json": ("config/processing.json", {"data importing", "data filtering"}),
    "identificationConfig.json": ("config/models/<model ID>.json", {"identification parameters"}),
    "standaloneConfig.json": (
        "section 'standalone' of config/models/<model ID>.json",
        {"make moment DiffSys", "DiffSys u"},
    ),
    "droneSimConfig.json": ("config/simulations/<name>.json", {"controller", "references"}),
}
SEARCHED = (".", "config", "configs", "configuration", "src", "data")  # folders of a project that are looked into


def misplaced_files(folder: str | Path) -> str:
    """A clause on QuaSI's configuration files in a folder and the place of each; "" where there is none.

    A file is known by its name, in any case of letters, or by what it holds.
    """
    found = []
    for place in SEARCHED:
        for path in sorted((Path(folder) / place).glob("*.json")):
            if target := _target_of(path):
                found.append(f"{path.relative_to(folder)} belongs in {target}")
    if not found:
        return ""
    plural = "files" if len(found) > 1 else "file"
    return f"; QuaSI's {plural} found: {', '.join(found)} (same keys; copy {'them' if len(found) > 1 else 'it'} there)"


def _target_of(path: Path) -> str | None:
    """Where a file of QuaSI belongs, None for any other; a model's or simulation's name is taken from the file."""
    known = next((place for name, place in PLACES.items() if name.lower() == path.name.lower()), None)
    if path.parent.name == "config" and path.name == "processing.json":
        return None
    try:
        document = read_json(path)
    except (QuasiError, OSError):
        document = {}
    document = document if isinstance(document, dict) else {}
    if known is None:
        known = next((place for place in PLACES.values() if len(place[1] & set(document)) == len(place[1])), None)
    if known is None:
        return None
    section = document.get("saving models")
    ident = section.get("model ID") if isinstance(section, dict) else None
    return known[0].replace("<model ID>", ident) if isinstance(ident, str) and ident else known[0]
