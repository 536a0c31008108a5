"""The flight card: what is proposed, the same as text, page and data, and the command that prints it."""

import json

import numpy as np
import pytest
from made_plan import CATALOGUE, MODEL, card_of, eight, follow, rows_of

from quasi import tables
from quasi.command import main
from quasi.errors import ConfigError, DataError
from quasi.gap.planning import flight_card, plan
from quasi.gap.planning.manoeuvres import library
from quasi.gap.planning.plan_input import flights_of
from quasi.model.model import AXES

FEW = ("doublets", "staircase near the floor")


@pytest.fixture(scope="module")
def few():
    """Two manoeuvres of the library."""
    return [m for m in library(MODEL, [0.0, 0.0, -1.5]) if m.name in FEW]


@pytest.fixture(scope="module")
def card(few):
    # slow and straight: much is hidden
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "library", lambda *_: few)
        return plan.examine([plan.read_flight(eight(30.0, size=0.4), MODEL, "slow.csv")], MODEL, CATALOGUE, reference=2)


def test_what_is_proposed_raises_what_was_hidden(card):
    raised = {n: (a, b) for p in card.proposals for n, (a, b) in p.raises.items()}
    assert {p.manoeuvre.name for p in card.proposals} == set(FEW)
    for before, after in raised.values():
        assert before.verdict != "seen"
        assert min(after.t, after.with_rival) / after.needed > 1.2 * min(before.t, before.with_rival) / before.needed
    by = {n: p.manoeuvre.name for p in card.proposals for n in p.raises}
    assert by["ground_effect"] == "staircase near the floor"
    assert raised["ground_effect"][1].verdict == "seen"
    assert by["imu_lever_arm"] == "doublets" and raised["imu_lever_arm"][1].verdict == "seen"
    # what no manoeuvre shows is told as such, and what one shows is not
    told = " ".join(flight_card.hopeless(card))
    for name, sight in card.best.items():
        assert (f"{name.replace('_', ' ')}: " in told) == (sight.verdict != "seen")


def test_a_flight_may_excite_what_no_manoeuvre_does(few):
    """What climbs all along never meets its own wake."""
    climbing = [m._replace(flight=m.flight.assign(w=-0.5, w_air=-0.5)) for m in few]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "library", lambda *_: climbing)
        found = plan.examine([plan.read_flight(eight(30.0), MODEL, "eight.csv")], MODEL, CATALOGUE, reference=2)
    assert "vortex_ring" in {row.effect.id for row in found.rows}
    assert {p.manoeuvre.name for p in found.proposals} <= set(FEW)


def test_the_card_reads_the_same_as_text_page_and_data(card):
    text, page, data = flight_card.text(card), flight_card.page(card), flight_card.data(card)
    assert text.startswith(flight_card.headline(card)) and flight_card.headline(card) in page
    plain = json.loads(json.dumps(data))
    assert plain["schema"] == "quasi.plan/2" and len(plain["causes"]) == len(card.rows)
    for row in plain["causes"]:
        assert row["id"].replace("_", " ") in text and row["id"].replace("_", " ") in page
    assert "from" in text and "staircase near the floor" in page
    assert "<script" not in page and "http" not in page
    tied = [r for r in card.rows if r.sight.verdict == "tie"]
    assert all(f"only as a tie with {r.sight.rival.replace('_', ' ')}" in text for r in tied)


def test_the_number_of_flights_that_would_show_a_cause_does():
    table = eight(30.0)
    few = card_of(table, reference=4)
    sight = rows_of(few)["gyro_bias"]
    count = flight_card.more_flights(few, sight)
    assert sight.verdict == "not seen" and 5 < count < 20
    assert rows_of(card_of(table, compared=count, reference=count))["gyro_bias"].verdict == "seen"
    assert flight_card.more_flights(few, sight._replace(t=0.1, with_rival=0.1)) is None


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("project")
    tables.write_json(place / "models/small/standalone/model.json", MODEL.document)
    eight(15.0).to_csv(place / "eight.csv", index=False)
    return place


def test_the_command_prints_and_writes_the_card(folder, capsys, few, monkeypatch):
    monkeypatch.setattr(plan, "library", lambda *_: few[:1])
    assert main(["plan", "small", "eight.csv", "-d", str(folder), "--references", "2", "--out", "card"]) == 0
    printed = capsys.readouterr().out
    assert "causes would be seen" in printed and "4 flights of 15 s and 2 reference flights" in printed
    assert tables.read_json(folder / "card/plan.json")["reference"] == 2
    assert (folder / "card/plan.html").is_file()


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["smal", "eight.csv"], "no model 'smal'"),
        (["small", "eigth.csv"], "no trajectory 'eigth.csv'"),
        (["small", "eight.csv", "--gap", "low"], "low"),
        (["small", "eight.csv", "--flights", "1"], "expected at least 2"),
    ],
)
def test_the_command_says_what_is_wrong(folder, capsys, arguments, said):
    assert main(["plan", *arguments, "-d", str(folder)]) == 1
    told = capsys.readouterr().err
    assert said in told and told.startswith("[ERROR]") and len(told.strip().splitlines()) == 1


def test_a_flown_flight_is_judged_by_its_own_residual(folder):
    flight = follow(eight(30.0))
    rng = np.random.default_rng(2)
    loud, calm = (
        flight.assign(**{a: flight[a] + s * rng.standard_normal(len(flight)) for a in AXES}) for s in (0.05, 0.005)
    )
    sights = [rows_of(card_of(f)) for f in (loud, calm)]
    assert sights[1]["tether"].t > 3.0 * sights[0]["tether"].t
    assert plan.read_flight(loud, MODEL, "a").measured and not plan.read_flight(loud, MODEL, "a", True).measured
    with pytest.raises(DataError, match="times do not grow"):
        plan.read_flight(loud.assign(t=0.0), MODEL, "a")


def test_flights_of_the_other_kind_of_forces_are_refused(folder):
    flight = follow(eight(15.0))
    tables.write_table(folder / "flown.parquet", flight, dict.fromkeys(flight, ("", "")))
    tables.write_json(folder / "flown.json", {"schema": "quasi.filtered/1", "forces": "noGravity", "mass": 0.43})
    with pytest.raises(ConfigError, match="holds forces noGravity, but model small gives them withGravity"):
        flights_of(["flown.parquet"], MODEL, folder)
    tables.write_json(folder / "flown.json", {"schema": "quasi.filtered/1", "forces": "withGravity", "mass": 0.43})
    found, about = flights_of(["flown.parquet"], MODEL, folder)
    assert about == {"mass": 0.43} and found[0].measured
