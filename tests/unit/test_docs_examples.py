"""What the pages print to be copied works as printed."""

import json
import re
from pathlib import Path

from quasi.gap.own_effect import effect_of
from quasi.importing.readers.table_mapping import read_mapping
from quasi.synthesis.campaign import read_campaign

DOCS = Path(__file__).parents[2] / "docs"


def printed(page, begin, language="json"):
    """The block of code of a page that begins so."""
    (found,) = re.findall(
        rf"```{language}\n({re.escape(begin)}.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.S
    )
    return found


def test_the_table_of_the_page_on_formats_is_a_mapping():
    section = json.loads("{" + printed("log-formats.md", '"table columns"') + "}")["table columns"]
    mapping = read_mapping(section, 14, "the page")
    assert [s.name for s in mapping.sources] == ["state", "motors", "capture"]


def test_the_cause_of_your_own_is_sound(tmp_path):
    file = tmp_path / "foam_wing.py"
    file.write_text(printed("gaps.md", "from quasi.gap.effect", "python"))
    assert effect_of(file).id == "foam_wing"


def test_the_made_flights_can_be_made():
    campaign = read_campaign(json.loads(printed("made-flights.md", '{"quadrotor"')), "the page")
    assert [f.key for f in campaign.flights] == ["ref-1", "new-1"]
