"""Where the models of a project folder are."""

from pathlib import Path

from quasi.errors import ReadError, nearest


def model_place(model: str, directory: Path) -> Path:
    """Where a model given by ID or path is. Raises ReadError when it is nowhere."""
    named = directory / "models" / model / "standalone"
    path = named if named.is_dir() else directory / model
    if not path.exists():
        made = [p.parent.name for p in directory.glob("models/*/standalone")]
        folder, *inside = Path(model).parts or ("",)
        if folder == "models" and inside:  # a path in the folder of models
            raise ReadError(f"{path} does not exist; make it with `snakemake -j2 models/{inside[0]}/standalone`")
        raise ReadError(
            f"no model '{model}': neither {named} nor {directory / model} exists{nearest(model, made)}; "
            f"make it with `snakemake -j2 models/{model}/standalone`"
        )
    return path
