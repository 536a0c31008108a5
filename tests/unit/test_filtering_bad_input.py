"""Input that no sensor or body gives: each kind is a sentence, and no column of the result is silently empty."""

from dataclasses import replace

import numpy as np
import pytest
from programs import script
from rigid_body import measure, move, quadrotor

from quasi import attitude
from quasi.errors import Caution, ConfigError, DataError, cautions, cautions_first
from quasi.filtering import estimation, flight, forces
from quasi.filtering.flight import filter_flight
from quasi.filtering.noise import beyond
from quasi.running.job_log import RUN_VARIABLE, job, read_outcome
from quasi.sensor_limits import describe_impossible_inertia
from quasi.tables import write_json, write_table

AIRFRAME = quadrotor()
HIT = slice(3000, 3500)


@pytest.fixture(scope="module")
def motion():
    return move(seconds=12.0, seed=4)


@pytest.fixture
def made(motion):
    return measure(motion)


def about(result, words):
    return [note for note in result.metadata["notes"] if words in note]


def spoil(frame, columns, value):
    frame.loc[HIT.start : HIT.stop, columns] = value


def attitude_error(result, motion):
    q = attitude.from_euler(*result.with_gravity[["roll", "pitch", "yaw"]].to_numpy().T)
    turn = attitude.logarithm(attitude.multiply(attitude.conjugate(q), motion.q))
    return np.degrees(np.abs(turn[600:]).max())


@pytest.mark.parametrize(
    ("columns", "value", "words"),
    [
        ("p", np.inf, "'p' is missing in 501 samples"),
        ("q", 1e30, "'q' is 1e+30 at t = 6.000 s, more than any sensor measures"),
        ("az", -1e6, "'az' is -1e+06 at t = 6.000 s"),
        (["p", "q", "r"], 0.3, "the gyro repeats its values from t = 6.00 s to 7.00 s"),
        (["ax", "ay", "az"], [0.1, 0.2, -9.0], "the accelerometer repeats its values from t = 6.00 s to 7.00 s"),
        ("x", np.nan, "samples of position are not finite"),
        ("y", 1e30, "samples of position are not finite or beyond all reason"),
        ("yaw", np.nan, "samples of attitude are not finite"),
        (["w1", "w3"], np.inf, "'w3' is missing in 501 samples"),
    ],
)
def test_impossible_spans_are_said_bridged_and_marked(motion, made, columns, value, words):
    frame, metadata = made
    spoil(frame, columns, value)
    result = filter_flight(frame, metadata, AIRFRAME, {})
    assert about(result, words)
    table = result.with_gravity
    assert np.isfinite(table.to_numpy()).all()
    assert table["valid"][HIT].iloc[20:-20].max() == 0 and table["valid"].mean() > 0.5
    after = slice(HIT.stop + 300, None)
    assert np.abs(table[["x", "y", "z"]].to_numpy()[after] - motion.p[after]).max() < 0.01
    if columns != "yaw":
        assert attitude_error(result, motion) < 3.0


def test_coarse_gyro_at_rest_is_not_called_stuck(made):
    frame, metadata = made
    step = np.radians(4.0)
    frame[["p", "q", "r"]] = step * np.round(frame[["p", "q", "r"]] / step)
    assert (np.diff(frame["p"][:1000]) == 0).mean() > 0.5
    assert not about(filter_flight(frame, metadata, AIRFRAME, {}), "repeats its values")


def test_capture_without_a_single_number_leaves_nothing_valid(made):
    frame, metadata = made
    frame[["x", "y", "z", "roll", "pitch", "yaw", "u", "v", "w"]] = np.nan
    result = filter_flight(frame, metadata, AIRFRAME, {})
    assert about(result, "no attitude source") and about(result, "no row of this flight is valid")
    assert np.isfinite(result.with_gravity.to_numpy()).all()


def test_log_lost_all_through_is_said(made):
    frame, metadata = made
    result = filter_flight(frame.assign(onboard_valid=0.0), metadata, AIRFRAME, {})
    assert about(result, "the on-board log lost") and about(result, "no row of this flight is valid")
    assert result.metadata["phases"]["none valid because"].startswith("sensors or rotor speeds are lost (100 %")


def test_a_flight_without_any_valid_row_is_called_so_in_its_jobs_own_line(made, tmp_path, monkeypatch):
    frame, metadata = made
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(RUN_VARIABLE, str(tmp_path / "run"))
    write_table("f.parquet", frame.assign(onboard_valid=0.0))
    write_json("f.json", {**metadata, "position source": "none", "velocity source": "none"})
    names = ("with_gravity", "no_gravity", "with_gravity_metadata", "no_gravity_metadata", "convergence")
    settings = {"problem": None, "quadrotor": {"file": "q"}, "mass": None}
    settings["options"] = {"save kalman filter convergence results": False}
    program = script("filtering")
    monkeypatch.setattr(program, "read_airframe", lambda *_: AIRFRAME)
    with job("f.log"):
        program.main(settings, "f.parquet", "f.json", {n: f"{n}.out" for n in names})
    told = read_outcome(tmp_path / "run", "f.log")
    assert told["verdict"].startswith("unusable (unusable for identification: neither position nor velocity; ")
    assert "no row is valid for identification: sensors or rotor speeds are lost" in told["verdict"]
    assert not any("no row of this flight" in note for note in told["notes"])
    assert cautions(["a", Caution("b")]) == cautions_first(["a", Caution("b")])[:1]


def test_what_spoils_rows_is_told_with_its_share_and_what_hardly_does_is_not():
    spoiling = {"a": np.arange(100) < 30, "b": np.arange(100) < 90, "c": np.arange(100) < 2}
    assert flight._spoilt(spoiling) == "b (90 % of the flight); a (30 % of the flight)"
    nowhere = {"position source": "none", "velocity source": "none"}
    assert flight._unsure_words(nowhere).endswith("for neither position nor velocity was measured")
    assert "measured" not in flight._unsure_words({})


def test_a_rotor_without_values_is_said_once(made):
    frame, metadata = made
    result = filter_flight(frame.assign(w1=np.nan), metadata, AIRFRAME, {})
    assert len(about(result, "'w1' holds no value")) == 1 and "w1" not in result.with_gravity


def test_inertia_that_no_body_has_is_said(made):
    result = filter_flight(*made, replace(AIRFRAME, inertia=np.diag([1e-3, 1e-3, 3e-3])), {})
    assert about(result, "the greatest exceeds the sum of the others, which is impossible")


def test_inertia_that_measurements_may_have_is_a_note_and_no_contradiction(made):
    """A published Crazyflie has 1.43e-5, 1.43e-5 and 2.89e-5 kg m2, 1 % beyond a flat plate; it was not judged."""
    inertia = np.diag([1.43e-3, 1.43e-3, 2.89e-3])
    result = filter_flight(*made, replace(AIRFRAME, inertia=inertia), {})
    assert about(result, "exceeds the sum of the others by 1.0 %")
    assert describe_impossible_inertia(inertia, beyond_errors=True) is None
    assert "impossible" in describe_impossible_inertia(np.diag([1e-3, 1e-3, 2.3e-3]), beyond_errors=True)
    assert describe_impossible_inertia(np.diag([1e-3, 1e-3, 2e-3])) is None


def test_noise_statistics_that_are_no_numbers_give_way_to_defaults(made):
    broken = replace(AIRFRAME, noise={"p": {"mean": 0.0, "std": float("nan")}, "q": {"mean": 0.0, "std": 0.0}})
    result = filter_flight(*made, broken, {})
    assert len(about(result, "which no sensor has")) >= 2
    assert result.metadata["noise"]["at rest"]["p"] >= 0.015


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"gyro bias random walk": -1.0}, "-1.0 is less than the minimum of 0"),
        ({"low-pass cutoff Hz": float("nan")}, "expected a finite number"),
        ({"low-pass cutoff Hz": float("inf")}, "expected a finite number"),
        ({"capture gap limit s": 0}, "less than or equal to the minimum of 0"),
    ],
)
def test_options_that_are_no_such_numbers_are_errors(made, options, words):
    with pytest.raises(ConfigError, match=words):
        filter_flight(*made, AIRFRAME, options)


def test_units_mixed_up_are_called_inconsistent(made):
    frame, metadata = made
    frame[["p", "q", "r"]] = np.degrees(frame[["p", "q", "r"]])
    result = filter_flight(frame, metadata, AIRFRAME, {})
    assert result.metadata["consistent"] is False
    assert about(result, "more than any sensor measures (150)") and about(result, "is not consistent in attitude")


def test_a_filter_that_is_not_consistent_names_the_figure_beyond_its_limit():
    fine = {"measurements": 900, "gated": 0.035, "forced": 0, "mean": 1.01, "whiteness": 0.03}
    assert beyond(fine) == []
    [said] = beyond({**fine, "forced": 3})
    assert said.startswith("3 times a measurement had to be taken after a second of rejections in a row (limit 0)")
    said = beyond({**fine, "mean": 0.12, "whiteness": 0.998, "gated": 0.062})
    assert "smaller than" in said[0] and "0.12, expected 1, limits 0.6 to 1.6" in said[0]
    assert said[1:] == [
        "neighbouring ones go together (correlation 1.00, limit 0.5)",
        "6.2 % of the measurements are rejected (limit 5 %)",
    ]
    assert beyond({"measurements": 40, "gated": 1.0, "forced": 0}) == ["at most two of 40 measurements are accepted"]


def test_shares_of_a_flight_have_no_exponent():
    notes = []
    unsure = estimation._unsure(np.full((500, 18), 9.0), np.arange(500) > 0, notes)
    assert unsure.all() and "in 99.8 % of the flight" in notes[0]
    estimation._unsure(np.full((500, 18), 9.0), np.ones(500, bool), notes)
    assert "in 100 % of the flight" in notes[1]


def test_a_column_that_is_no_number_is_never_handed_on(made, monkeypatch):
    def broken(specific, mass):
        force = forces.forces(specific, mass)
        force[77, 1] = np.nan
        return force

    monkeypatch.setattr(flight, "forces", type("F", (), {**vars(forces), "forces": staticmethod(broken)}))
    with pytest.raises(DataError, match=r"'Fy' is no number in 1 samples, first at t = 0\.154 s"):
        filter_flight(*made, AIRFRAME, {})


def test_lifted_by_hand_while_no_rotor_turns_is_no_flight(made):
    """Rows of it would be compared with a model that divides by rotor speeds of nothing."""
    frame, metadata = made
    frame = frame.copy()
    still = frame.index[frame["t"] < 2.5]
    frame.loc[still, [f"w{i}" for i in range(1, 5)]] = 0.0
    s = np.clip((frame["t"] - 0.5) / 1.5, 0.0, 1.0).to_numpy()
    height = 0.4 * np.sin(np.pi * s) ** 4
    frame["z"] -= height
    frame["w"] -= np.gradient(height, frame["t"])
    frame["az"] -= np.gradient(np.gradient(height, frame["t"]), frame["t"])
    table = filter_flight(frame, metadata, AIRFRAME, {}).with_gravity
    lifted = table["t"].between(1.0, 1.5)
    assert (table.loc[lifted, "in_flight"] > 0.5).any()  # the IMU and the capture would have it fly
    assert not (table.loc[table["t"] < 2.0, "valid"] > 0.5).any()
    assert (table["valid"] > 0.5).mean() > 0.5
