"""Where the models of a project folder are."""

from pathlib import Path

from quasi.errors import ReadError, nearest


def model_place(model: str, directory: Path) -> Path:
    """Where a model given by ID or path is. Raises ReadError when it is nowhere."""
    named = directory / "models" / model / "standalone"
    path = named if named.is_dir() else directory / model
    if not path.exists():
        made = [p.parent.name for p in directory.glob("models/*/standalone")]
        raise ReadError(
            f"no model '{model}': neither {named} nor {directory / model} exists{nearest(model, made)}; "
            f"make it with `snakemake -j2 models/{model}/standalone`"
        )
    return path
