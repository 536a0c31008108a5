"""Make one flight of a campaign and write it as a raw on-board log, a capture export and the truth."""

from quasi.joblog import job
from quasi.synthesis.campaign import make_flight, write_flight


def main(campaign: str, flight: str, settings: dict, onboard: str, capture: str, truth: str) -> None:
    """Make the flight `flight` of the campaign's settings and write its three files."""
    write_flight(make_flight(settings, flight), onboard, capture, truth)


if __name__ == "__main__":
    with job(snakemake.log[0], f"synthesis of {snakemake.wildcards.flight}"):
        main(**snakemake.params.campaign, **dict(snakemake.output.items()))
