"""The page of causes: complete, as the catalogue has it, and with the sizes of the vehicle that is asked about."""

from pathlib import Path

import numpy as np
import pytest

from quasi.command import main
from quasi.commands.models import made_vehicle
from quasi.gap import causes_page
from quasi.gap.catalogue import catalogue

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_is_what_the_catalogue_says(capsys):
    assert main(["causes"]) == 0
    page = capsys.readouterr().out
    assert page == (DOCS / "causes.md").read_text(encoding="utf-8"), "make it anew: quasi causes > docs/causes.md"
    for name, effect in catalogue().items():
        assert page.count(f"### {name}\n") == 1
        assert all(f"`{parameter}`" in page for parameter in effect.parameters)


def test_typical_sizes_are_those_of_the_vehicle():
    vehicle = made_vehicle()
    assert vehicle.hover_induced == pytest.approx(
        (vehicle.weight / (8 * np.pi * 1.225 * vehicle.radius**2)) ** 0.5, rel=1e-3
    )
    known = {"tether": catalogue()["tether"]}
    heavier = vehicle._replace(mass=2 * vehicle.mass)
    told = causes_page.text(known, heavier, "another")
    assert f"typically {0.047 * heavier.weight:.3g} N/m off" in told and "those of another" in told
    assert f"typically {0.047 * vehicle.weight:.3g} N/m off" not in told


def test_a_model_that_is_not_there_is_told(tmp_path, capsys):
    assert main(["causes", "nothing", "-d", str(tmp_path)]) == 1
    assert "nothing" in capsys.readouterr().err
