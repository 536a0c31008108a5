"""Checks that run on every reader's result: rotor speeds, frozen channels, body axes."""

import numpy as np
import pandas as pd
import pytest
from cases import case_file, flight_of, needs_cases
from made_motion import body
from test_indiflight import FIELDS, as_csv, flown  # noqa: F401

from quasi.errors import ConfigError, ReadError, cautions
from quasi.importing.checks import check_recording, rows_in_spans
from quasi.importing.checks.channels import frozen_sensor_spans
from quasi.importing.checks.rotor_speeds import unreliable_spans
from quasi.importing.flight import import_flight
from quasi.importing.onboard_log import read_onboard
from quasi.importing.series import Recording, Series

RATE = 500.0


def speeds(seconds=12.0, rest=2.0, seed=1):
    """Four rotors that stand for `rest` s, then turn at 900 rad/s with noise, as a 500 Hz log."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * RATE)) / RATE
    w = np.round(900 + rng.normal(0, 15, (4, len(t))))
    w[:, t < rest] = 0.0
    return t, w


def recording(t, w, **more):
    return Recording({"onboard": Series(t, {f"w{i + 1}": v for i, v in enumerate(w)} | more)}, {}, [])


def spans_of(checked):
    return checked.metadata["invalid spans"]


def test_sound_rotor_speeds_pass_untouched():
    t, w = speeds()
    checked = check_recording(recording(t, w.copy()), "f")
    assert np.array_equal(np.stack(list(checked.series["onboard"].values.values())), w)
    assert not spans_of(checked) and not checked.notes


def test_spikes_and_short_drop_outs_are_removed_and_counted():
    t, w = speeds()
    rng = np.random.default_rng(3)
    places = {k: np.sort(rng.choice(np.arange(1100, 5900, 12), 40, replace=False)) for k in range(4)}
    for k, rows in places.items():
        w[k, rows] = 98_000.0 if k < 2 else 0.0
    w[3, 3000:3030] = 0.0
    checked = check_recording(recording(t, w.copy()), "f")
    values = checked.series["onboard"].values
    for k in range(3):
        assert np.flatnonzero(np.isnan(values[f"w{k + 1}"])).tolist() == places[k].tolist()
    assert np.isnan(values["w4"][3000:3030]).all()
    assert checked.metadata["spikes removed"]["w1"] == 40
    assert any("w1: 40" in note for note in checked.notes)
    assert not spans_of(checked)


def test_a_rotor_without_a_single_possible_speed_stops_nothing():
    t, w = speeds()
    w[1] = np.nan
    w[1, ::100] = np.where(np.arange(len(t[::100])) % 10 < 2, 9e4, -3.0)
    w[1, 0] = 5.0
    w[1, w[1] == 5.0] = -1e-3
    checked = check_recording(recording(t, w), "f")
    assert np.isnan(checked.series["onboard"].values["w2"]).all()
    assert checked.metadata["spikes removed"]["w2"] == len(t[::100])


def test_a_rotor_that_stands_in_flight_makes_these_rows_invalid_and_is_named():
    t, w = speeds()
    w[1, 2500:3500] = 0.0
    checked = check_recording(recording(t, w), "f")
    (span,) = spans_of(checked)
    assert (span["begin"], span["end"]) == (pytest.approx(5.0), pytest.approx(6.998))
    assert any("rotor 2 (w2)" in note for note in cautions(checked.notes))
    inside = rows_in_spans([span], t)
    assert inside[2500:3500].all() and not inside[:2500].any() and not inside[3500:].any()


def test_a_rotor_that_is_constant_in_flight_makes_these_rows_invalid_and_is_named():
    t, w = speeds()
    w[2, 4000:5000] = 900.0
    w[0, 3000:3100] = 900.0  # 0.2 s: telemetry that comes slowly
    checked = check_recording(recording(t, w), "f")
    assert [span["reason"][:12] for span in spans_of(checked)] == ["rotor 3 (w3)"]
    assert len(cautions(checked.notes)) == 1


def test_telemetry_that_stalls_for_all_rotors_is_found_but_held_setpoints_are_not():
    t, w = speeds()
    w[:, 4000:5000] = w[:, 4000:4001]
    checked = check_recording(recording(t, w), "f")
    assert {span["reason"][:7] for span in spans_of(checked)} == {f"rotor {k}" for k in range(1, 5)}
    held = 900 + 10 * (np.arange(len(t)) // 400 % 3) * np.ones((4, 1))
    assert not spans_of(check_recording(recording(t, held), "f"))


@pytest.mark.parametrize("kind", ["times 100", "random"])
def test_speeds_that_no_rotor_reaches_make_all_rows_invalid(kind):
    t, w = speeds()
    w = 100 * w if kind == "times 100" else np.random.default_rng(5).uniform(0, 98_000, w.shape)
    checked = check_recording(recording(t, w), "f")
    assert rows_in_spans(spans_of(checked), t).all()
    assert any("w1, w2, w3, w4 exceed 8000 rad/s" in note for note in cautions(checked.notes))


def test_a_sensor_channel_that_is_constant_in_flight_makes_rows_invalid_but_not_at_rest():
    t, w = speeds()
    rng = np.random.default_rng(2)
    gyro = {n: np.round(rng.normal(0, 3, len(t))) for n in "pqr"}
    gyro["q"][:1000] = 0.0
    assert not spans_of(check_recording(recording(t, w, **gyro), "f"))
    gyro["q"][3000:4000] = 2.0
    checked = check_recording(recording(t, w, **gyro), "f")
    assert [s["reason"].split("'")[1] for s in spans_of(checked)] == ["q"]


def test_values_that_no_vehicle_has_call_for_care_whatever_the_reader():
    t, w = speeds()
    checked = check_recording(recording(t, w, battery_voltage=np.full(len(t), 4e7), command1=np.full(len(t), 3.0)), "f")
    assert len(cautions(checked.notes)) == 2


def test_tables_pass_the_same_checks(tmp_path):
    t, w = speeds()
    rng = np.random.default_rng(6)
    frame = pd.DataFrame({"t": t} | {n: rng.normal(0, 0.3, len(t)) for n in ("p", "q", "r", "ax", "ay")})
    frame["az"] = rng.normal(-9.81, 0.3, len(t))
    w[3, 2000:4000] = 0.0
    for k in range(4):
        frame[f"w{k + 1}"] = w[k]
    frame.to_csv(tmp_path / "a.csv", index=False)
    mapping = {
        "time": {"column": "t"},
        "sources": [{"name": "imu", "columns": {n: n for n in frame.columns if n != "t"}}],
    }
    found = read_onboard(flight_of(tmp_path / "a.csv", "table"), {"table columns": mapping})
    assert [s["reason"][:12] for s in spans_of(found)] == ["rotor 4 (w4)"]


TURNED = [f"{name}[{i}]" for name in ("gyroADCafterRpm", "gyroADC", "accADCafterRpm", "accSmooth") for i in (1, 2)]


def in_other_axes(flown, fields=TURNED):  # noqa: F811
    """The made INDIflight log with some of its IMU's channels negated."""
    truth, speed, rotors, table = flown
    table = table.copy()
    table[:, [FIELDS.index(f) for f in fields]] *= -1
    return truth, speed, rotors, table


def test_body_axes_are_decided_from_the_log_and_stated_in_one_note(tmp_path, flown):  # noqa: F811
    own = read_onboard(as_csv(tmp_path, flown), {})
    other = read_onboard(as_csv(tmp_path, in_other_axes(flown)), {})
    for name in ("p", "q", "r", "ax", "ay", "az"):
        assert np.array_equal(own.series["onboard"].values[name], other.series["onboard"].values[name])
    for found, axes in ((own, "z down"), (other, "z up")):
        assert found.metadata["body axes logged"].endswith(axes)
        (note,) = [n for n in found.notes if "the IMU is logged in" in n]
        assert axes in note and "specific force" in note and "gyro" in note
        assert not cautions(found.notes)


def test_body_axes_can_be_forced_and_a_contradiction_calls_for_care(tmp_path, flown):  # noqa: F811
    flight = as_csv(tmp_path, in_other_axes(flown))
    found = read_onboard(flight, {"logged body axes": "FRD"})
    assert np.median(found.series["onboard"].values["az"]) > 9.0
    assert any("contradict" in note for note in cautions(found.notes))
    assert not cautions(read_onboard(flight, {"logged body axes": "FLU"}).notes)
    with pytest.raises(ConfigError, match="logged body axes"):
        read_onboard(flight, {"logged body axes": "NED"})


@pytest.mark.parametrize(
    "fields", [[f for f in TURNED if f.startswith("gyro")], [f for f in TURNED if f.startswith("acc")]]
)
def test_body_axes_of_which_neither_kind_fits_are_refused(tmp_path, flown, fields):  # noqa: F811
    with pytest.raises(ReadError, match="neither x forward, y right, z down nor") as error:
        read_onboard(as_csv(tmp_path, in_other_axes(flown, fields)), {})
    assert "logged body axes" in str(error.value)


def test_without_an_attitude_the_specific_force_alone_turns_no_axes(tmp_path, flown):  # noqa: F811
    fields = [f for f in FIELDS if f.startswith(("gyroADC[", "accSmooth", "motor"))]
    for number, made in enumerate((flown, in_other_axes(flown))):
        flight = as_csv(tmp_path, made, fields) | {"flight controller": "betaflight"}
        found = read_onboard(flight, {})
        # Betaflight's convention: y left, z up, which the first does not keep
        assert found.metadata["body axes logged"] == "x forward, y left, z up"
        assert any("contradict" in note for note in cautions(found.notes)) == (number == 0)


def test_the_made_motion_itself_shows_which_axes_are_right():
    # independent of the reader: at rest the specific force of x forward, y right, z down is -g along z
    truth = body(10.0, rate=100.0, rest=3.0)
    assert truth.force[:200].mean(axis=0) == pytest.approx([0.0, 0.0, -9.81], abs=0.7)


@needs_cases
@pytest.mark.parametrize("name", ["indiflight_flu_mar2024", "indiflight_flu_mar2024_lpf_patched"])
def test_case_of_indiflight_axes(tmp_path, name):
    path = case_file(f"2_indiflight_axes/{name}.csv.gz", tmp_path)
    frame, about = import_flight(flight_of(path, "indiflight"), {}, {})
    assert about["sources"]["onboard"]["body axes logged"] == "x forward, y left, z up"
    assert frame["az"].median() == pytest.approx(-9.8, abs=0.3)
    assert not any("unlike the gyro" in note for note in about["notes"])
    assert (
        "PT1 100 Hz" in str(about["corrections"]["gyro filter delay"])
        or about["corrections"]["gyro filter delay"]["value"] == 0
    )


@needs_cases
@pytest.mark.parametrize(
    ("name", "valid", "named"),
    [
        ("plain", (0.99, 1.0), ""),
        ("spikes", (0.99, 1.0), ""),
        ("zeros10", (0.9, 1.0), ""),
        ("frozen", (0.5, 0.6), "rotor 3 (w3) is constant in flight"),
        ("dead", (0.4, 0.45), "rotor 2 (w2) stands at 0 in flight"),
        ("times100", (0.0, 0.0), "w1, w2, w3, w4 exceed 8000 rad/s"),
        ("garbage", (0.0, 0.0), "w1, w2, w3, w4 exceed 8000 rad/s"),
    ],
)
def test_cases_of_rotor_speeds(tmp_path, name, valid, named):
    frame, about = import_flight(flight_of(case_file(f"3_rotor_speeds/{name}.csv.gz", tmp_path)), {}, {})
    assert valid[0] <= frame["onboard_valid"].mean() <= valid[1]
    assert named in about["verdict because"]
    assert valid[1] > 0.5 or about["verdict"] == "unusable"
    removed = about["sources"]["onboard"]["spikes removed"]
    if name in ("spikes", "zeros10"):
        assert all(removed[f"w{k}"] > 100 for k in range(1, 5))
        assert frame[["w1", "w2", "w3", "w4"]].max().max() < 4000


def coarse_gyro(still):
    """Ten seconds at 200 Hz in steps of 0.02 rad/s; from 4 to 8 s nothing turns, or the sensor keeps its value."""
    t = np.arange(2000) / 200.0
    rate = np.sin(np.pi * (t - 4.0)) * np.where((t < 4.0) | (t > 8.0), 1.0, 0.0 if still else 1.0)
    logged = np.round(rate / 0.02) * 0.02
    if not still:
        logged[(t >= 4.0) & (t < 8.2)] = logged[800]
    return t, {"p": logged}


def test_a_quiet_channel_in_coarse_steps_is_not_frozen():
    t, values = coarse_gyro(still=True)
    assert frozen_sensor_spans(t, values, np.ones(len(t), bool)) == []


@pytest.mark.parametrize("still", [True, False])
def test_a_rotor_that_hovers_calmly_in_coarse_steps_is_not_frozen(still):
    # a rotor of 800 rad/s changes by less than one step of eRPM/100 for a second, while the others step now and then
    t, values = coarse_gyro(still)
    step = 100 / 7 * 2 * np.pi / 60
    other = 800.0 + step * np.round(1.2 * np.sin(2.0 * t))
    speeds = {"w1": 800.0 + step * np.round(values["p"] / 0.02), "w2": other, "w3": other[::-1], "w4": other + step}
    found = [s for s in unreliable_spans(t, speeds) if "w1" in s.reason]
    assert bool(found) is not still
    assert all("constant in flight" in s.reason for s in found)


def test_a_channel_that_jumps_after_it_kept_its_value_is_frozen():
    t, values = coarse_gyro(still=False)
    (span,) = frozen_sensor_spans(t, values, np.ones(len(t), bool))
    assert (span.begin, span.end) == (pytest.approx(4.0, abs=0.02), pytest.approx(8.2, abs=0.02))
    assert "gyro channel 'p' is constant in flight" in span.reason


def test_a_channel_that_never_changes_is_frozen():
    t = np.arange(2000) / 200.0
    assert len(frozen_sensor_spans(t, {"r": np.zeros(2000)}, np.ones(2000, bool))) == 1
