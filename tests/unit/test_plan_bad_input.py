"""Flight plans from what cannot be flown or read: too long, too fast, raw logs, another vehicle, no velocity."""

import numpy as np
import pytest
from made_plan import CATALOGUE, MODEL, eight, follow, rows_of
from test_gap_bad_input import DRIFTING, sources

from quasi.errors import ConfigError, DataError, QuasiError
from quasi.gap.planning import plan
from quasi.gap.planning.plan_input import flights_of
from quasi.tables import write_json, write_table


@pytest.fixture(scope="module")
def flight():
    """15 s that follow a planned figure, 100 Hz."""
    return follow(eight(15.0))


def test_any_number_of_trajectories_is_shared_by_the_flights(flight):
    """Three trajectories, four flights: the first is flown twice."""
    effects = {n: CATALOGUE[n] for n in ("tether", "wind", "body_drag")}
    three = [plan.read_flight(t, MODEL, n) for t, n in ((eight(15.0), "a"), (eight(12.0), "b"), (flight, "c"))]
    card = plan.examine(three, MODEL, effects, 4, propose=False)
    assert set(rows_of(card)) == set(effects) and all(np.isfinite(s.t) for s in rows_of(card).values())
    with pytest.raises(ConfigError, match="3 trajectories are planned for 2 compared and 1 reference flights"):
        plan.examine(three, MODEL, effects, 2, 1)
    with pytest.raises(ConfigError, match="100000 compared and 0 reference flights, expected at most 200 together"):
        plan.examine(three, MODEL, effects, 100_000)


def test_a_trajectory_longer_than_any_battery_is_refused_before_memory_is():
    long = eight(15.0)
    with pytest.raises(DataError, match=r"lasts 14900 s, expected 1800 s at most; times are in s"):
        plan.read_flight(long.assign(t=1000.0 * long["t"]), MODEL, "a plan")


def test_what_no_rotor_speed_can_make_is_told_without_bounds():
    wide = eight(15.0)
    with pytest.raises(DataError, match="m: no rotor speeds make its force and moments; fly it slower"):
        follow(wide.assign(x=1000.0 * wide["x"]))


@pytest.mark.parametrize("name", ["flight.bbl", "flight.json"])
def test_a_raw_log_is_no_trajectory(tmp_path, name):
    (tmp_path / name).write_text("H Product:Blackbox\n")
    with pytest.raises(QuasiError, match=r"is no table: its name ends in .*, expected \.csv or \.parquet; a raw log"):
        flights_of([name], MODEL, tmp_path)


def test_a_flown_flight_of_another_quadrotor_is_refused(tmp_path, flight):
    write_table(tmp_path / "flown.parquet", flight, dict.fromkeys(flight, ("", "")))
    write_json(tmp_path / "flown.json", {"schema": "quasi.filtered/1", "forces": "withGravity", "mass": 4.3})
    with pytest.raises(ConfigError, match=r"flown\.parquet is not of the quadrotor that model small describes"):
        flights_of(["flown.parquet"], MODEL, tmp_path)


def test_a_flown_flight_whose_velocity_nothing_measured_is_refused(tmp_path, flight):
    write_table(tmp_path / "flown.parquet", flight, dict.fromkeys(flight, ("", "")))
    about = {"schema": "quasi.filtered/1", "forces": "withGravity", **DRIFTING}
    write_json(tmp_path / "flown.json", about)
    with pytest.raises(DataError, match=r"flown\.parquet has no source of velocity but the accelerometer"):
        flights_of(["flown.parquet"], MODEL, tmp_path)
    write_json(tmp_path / "flown.json", about | sources(velocity="onboard"))
    (found,), _ = flights_of(["flown.parquet"], MODEL, tmp_path)
    assert "u" in found.columns and "z" not in found.columns
