"""Read the raw files of a model, a gap or all processed flights; stop where they show that it cannot be made."""

from quasi.errors import DataError
from quasi.importing.inspection import INSPECTION_MEMORY, Inspector, refusals
from quasi.project.same_recordings import repeated_recordings
from quasi.running.job_log import LOG, job, print_at_end, show_progress
from quasi.tables import write_json


def main(asked: dict, names: dict[str, str], version: str, target: str) -> None:
    """Write what each flight holds. Raises DataError with the last of the refusals, after reporting the others.

    names  {"quadrotor/flight": its row}, for messages
    """
    inspector = Inspector(INSPECTION_MEMORY, version)
    flights = show_progress(asked["flights"].items(), "reading raw files")
    found = {key: inspector.inspect(about["settings"]) for key, about in flights}
    trained = {key: inspector.inspect(settings) for key, settings in asked.get("trained flights", {}).items()}
    refused = list(dict.fromkeys(refusals(asked, trained | found) + repeated_recordings(asked, names)))
    for sentence in refused[:-1]:
        LOG.error("%s", sentence)
        print_at_end(sentence, "errors")
    if refused:
        raise DataError(refused[-1])
    write_json(target, {"name": asked["name"], "flights": found})


if __name__ == "__main__":
    with job(snakemake.log[0], f"inspection of {snakemake.params.asked['name']}"):
        main(snakemake.params.asked, snakemake.params.names, snakemake.params.code, snakemake.output[0])
