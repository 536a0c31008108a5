"""Made flights as raw files, and what import and filter make of them."""

from quasi.airframe import read_airframe
from quasi.filtering.flight import filter_flight
from quasi.gap.flights.level import Flown
from quasi.importing.flight import import_flight
from quasi.tables import write_bytes, write_text
from quasi_synthesis.campaign import make_flight, quadrotor_configuration, read_campaign


def written(folder, key, made):
    """Write a made flight's raw files into a folder; what an import job is told of them."""
    onboard, capture = folder / f"{key}.bbl", folder / f"{key}.csv"
    write_bytes(onboard, made.onboard)
    write_text(capture, made.capture)
    return {
        "flight": key, "quadrotor": "Made", "flight controller": "betaflight", "rigid body": "MadeBeetle",
        "onboard": str(onboard), "capture": str(capture), "log number": None,
    }  # fmt: skip


def planted(folder, effects, seed, seconds):
    """Raw files of a mixed and an aggressive flight with these effects.

    Returns process(calibration), which imports and filters them as [Flown], and the airframe.
    """
    sources = []
    for k, profile in enumerate(("mixed", "aggressive")):
        flight = {"key": f"a{k}", "profile": profile, "seed": seed + k, "effects": effects}
        campaign = read_campaign({"flights": [flight], "duration": seconds, "nuisance": 0.3}, "test")
        sources.append(written(folder, f"a{k}", make_flight(campaign, campaign.flights[0])))
    quadrotor = quadrotor_configuration(campaign)
    airframe = read_airframe(quadrotor, "made")

    def process(calibration):
        flights = []
        for source in sources:
            imported, about = import_flight(source, quadrotor, {}, calibration)
            filtered = filter_flight(imported, about, airframe, {})
            flights.append(
                Flown(source["flight"], True, imported, about, filtered.with_gravity, filtered.metadata, airframe)
            )
        return flights

    return process, airframe
