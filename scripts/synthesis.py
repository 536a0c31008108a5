"""Make one flight of a campaign and write it as a raw on-board log, a capture export and the truth."""

from quasi.running.job_log import job
from quasi_synthesis.campaign import flight_of, make_flight, read_campaign, write_flight


def main(campaign: str, flight: str, settings: dict, onboard: str, capture: str, truth: str) -> None:
    """Make the flight `flight` of the campaign's settings and write its three files."""
    checked = read_campaign(settings, campaign)
    write_flight(make_flight(checked, flight_of(checked, flight)), onboard, capture, truth)


if __name__ == "__main__":
    with job(snakemake.log[0], f"synthesis of {snakemake.wildcards.flight}"):
        main(**snakemake.params.campaign, **dict(snakemake.output.items()))
