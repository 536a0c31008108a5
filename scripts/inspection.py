"""Read the raw files of a model, a gap or all processed flights; stop where they show that it cannot be made."""

from quasi.comparisons import recorded_twice, same_recordings
from quasi.errors import DataError
from quasi.importing.inspection import MEMORY, Inspector, refusals
from quasi.joblog import LOG, job, progress, tell
from quasi.tables import write_json


def main(asked: dict, version: str, target: str) -> None:
    """Write what each flight holds. Raises DataError with the last of the refusals, after reporting the others."""
    inspector = Inspector(MEMORY, version)
    flights = progress(asked["flights"].items(), "reading raw files")
    found = {key: inspector.inspect(about["settings"]) for key, about in flights}
    refused = refusals(asked, found) + _repeated(asked)
    for sentence in refused[:-1]:
        LOG.error("%s", sentence)
        tell(sentence, "errors")
    if refused:
        raise DataError(refused[-1])
    write_json(target, {"name": asked["name"], "flights": found})


def _repeated(asked: dict) -> list[str]:
    """Sentences on recordings of a gap that have two roles."""
    sentences = []
    if twice := same_recordings(asked.get("held", {}), asked.get("trained", {})):
        sentences.append(
            f"{asked['name']}: held-out {twice[0]} has the recording of {twice[1]}, which trained its model; hold out "
            "a flight that the model has never seen"
        )
    if twice := recorded_twice(asked.get("recordings", {})):
        sentences.append(
            f"{asked['name']}: {twice[0]} and {twice[1]} have the same recording, but each flight counts once and has "
            "one role; leave one out, or give each its own 'Log number' if the file holds several logs"
        )
    return sentences


if __name__ == "__main__":
    with job(snakemake.log[0], f"inspection of {snakemake.params.asked['name']}"):
        main(snakemake.params.asked, snakemake.params.code, snakemake.output[0])
