"""Recordings as they go wrong: each fault ends in one sentence with a remedy, or in a note that says what was lost."""

import numpy as np
import pandas as pd
import pytest
from made_motion import at_times, body, motive_text
from made_recordings import written
from spreadsheets import saved_anew

from quasi.errors import QuasiError
from quasi.importing.flight import import_flight
from quasi.tables import read_bytes, write_bytes, write_text
from quasi_synthesis.campaign import make_flight, read_campaign

RATE = 120.0


@pytest.fixture(scope="module")
def made():
    campaign = read_campaign({"seed": 6, "duration": 18.0, "flights": [{"key": "bad-1"}]})
    return make_flight(campaign, campaign.flights[0])


@pytest.fixture
def asked(tmp_path, made):
    """The flight's settings; both files are fresh copies."""
    return written(tmp_path, "bad-1", made)


def load(asked, **options):
    return import_flight(asked, {"motor poles": "14"}, options)


def refused(asked, words, **options):
    with pytest.raises(QuasiError) as error:
        load(asked, **options)
    message = str(error.value)
    assert words in message
    assert "\n" not in message
    assert ";" in message  # the remedy


def edit(asked, change):
    """Rewrite the lines of the capture; frames begin with line 7."""
    path = asked["capture"]
    lines = read_bytes(path).decode().split("\n")
    write_text(path, "\n".join(change(lines)))


@pytest.mark.parametrize("which", ["onboard", "capture"])
@pytest.mark.parametrize(("content", "words"), [(b"", "is empty (0 bytes)"), (None, "does not exist")])
def test_zero_length_and_absent_files(asked, which, content, words):
    if content is None:
        asked[which] += ".lost"
    else:
        write_bytes(asked[which], content)
    refused(asked, words)


def test_headers_with_forty_four_empty_logs(asked, made):
    header = made.onboard[: made.onboard.rfind(b"\nH ")]
    header += b"\n" + made.onboard[len(header) + 1 :].split(b"\n", 1)[0] + b"\n"
    write_bytes(asked["onboard"], header * 44)
    with pytest.raises(QuasiError, match="44 logs, none with a readable frame; it was written without flying"):
        load(asked)
    # the flight among them is found
    write_bytes(asked["onboard"], header * 43 + made.onboard)
    _, about = load(asked)
    assert any("holds 44 logs; the longest, number 44" in n for n in about["notes"])


@pytest.mark.parametrize("share", [0.001, 0.01, 0.05, 0.3, 0.6, 0.9])
def test_a_log_cut_at_any_byte(asked, made, share):
    write_bytes(asked["onboard"], made.onboard[: int(share * len(made.onboard))])
    try:
        frame, about = load(asked)
    except QuasiError as error:
        assert share < 0.5
        assert "bad-1" in str(error)
    else:
        assert share > 0.2
        assert np.isfinite(frame.to_numpy()).all()
        assert any("no end-of-log event" in n for n in about["notes"])
        assert any("the rest is left out" in n for n in about["notes"]) == (share < 0.2)


def test_a_log_of_which_hardly_a_frame_is_readable_is_not_said_to_lack_the_gyro(asked, made):
    first = made.onboard.index(b"\n", made.onboard.rindex(b"\nH ") + 1) + 1
    garbage = np.random.default_rng(3).bytes(3000)
    write_bytes(asked["onboard"], made.onboard[: first + 200] + garbage)
    refused(asked, "the log lists body rates (gyro), but fewer than 20 samples of it are readable")
    refused(asked, "bytes of the log are damaged), at least 20 are needed; copy the log from the controller again")


def test_garbage_in_the_middle_of_a_log(asked, made):
    middle = int(0.6 * len(made.onboard))
    rng = np.random.default_rng(3)
    write_bytes(asked["onboard"], made.onboard[:middle] + rng.bytes(6000) + made.onboard[middle + 6000 :])
    frame, about = load(asked)
    assert any("damaged stretches" in n for n in about["notes"])
    assert 0.001 < (frame["onboard_valid"] == 0).mean() < 0.1
    assert np.isfinite(frame.to_numpy()).all()
    assert any(g["cause"] == "damage" for g in about["sources"]["onboard"]["time gaps"])


@pytest.mark.parametrize(
    ("name", "words"), [("MadeBeatle", "did you mean 'MadeBeetle'?"), ("", "known are 'MadeBeetle'")]
)
def test_a_wrong_name_of_the_rigid_body(asked, name, words):
    refused(asked | {"rigid body": name}, words)


def test_a_capture_shorter_than_the_flight(asked):
    edit(asked, lambda lines: lines[:7] + lines[7 + 9 * 120 : 7 + 17 * 120])
    frame, about = load(asked)
    assert frame["t"].iloc[-1] < 8.1
    said = next(n for n in about["notes"] if "the sources share" in n)
    assert "left out are" in said and "before the capture begins and" in said and "after the capture ends" in said


def test_a_capture_that_ended_before_the_flight_began(asked):
    edit(asked, lambda lines: lines[: 7 + int(2.5 * 120)])
    refused(asked, "bad-1")


def test_a_capture_beyond_the_permitted_lag(asked, made):
    # the part of the capture from 12 s on, as if it were the beginning of another take
    def change(lines):
        later = [line.split(",", 2) for line in lines[7 + 12 * 120 :] if line]
        return lines[:7] + [f"{i},{i / RATE:.6f},{cells}" for i, (_, _, cells) in enumerate(later)]

    edit(asked, change)
    refused(asked, "bad-1", **{"max permitted lag for optitrack": 3.0})
    _, about = load(asked, **{"max permitted lag for optitrack": 25.0})
    assert 8.0 < about["synchronisation"]["lag"]["value"] < 13.0


def test_a_capture_without_motion(asked):
    def change(lines):
        first = lines[7].split(",", 2)[2]
        return lines[:7] + [",".join([*line.split(",", 2)[:2], first]) for line in lines[7:] if line]

    edit(asked, change)
    refused(asked, "shows no motion")


def test_a_capture_that_never_saw_the_body(asked):
    edit(asked, lambda lines: lines[:7] + [",".join(line.split(",", 2)[:2]) + "," * 30 for line in lines[7:] if line])
    refused(asked, "never saw rigid body 'MadeBeetle'")


def test_text_in_columns_of_the_capture(asked):
    def change(lines):
        return [line.replace(".", "x") if 2000 <= i < 2100 else line for i, line in enumerate(lines)]

    edit(asked, change)
    frame, about = load(asked)
    assert any("hold text where numbers belong" in n for n in about["notes"])
    assert np.isfinite(frame.to_numpy()).all()
    edit(asked, lambda lines: lines[:7] + [line.replace(".", "x") for line in lines[7:]])
    refused(asked, "never saw rigid body")


def test_frames_of_the_capture_out_of_order(asked):
    plain, _ = load(asked)
    edit(asked, lambda lines: lines[:1000] + lines[1200:1300] + lines[1000:1200] + lines[1000:])
    frame, about = load(asked)
    assert any("frames out of order were left out" in n for n in about["notes"])
    assert frame["x"].to_numpy() == pytest.approx(plain["x"].to_numpy(), abs=0.02)


def test_a_run_of_missing_frames_is_flagged_and_not_filled_as_measured(asked):
    def change(lines):
        return [
            ",".join(line.split(",", 2)[:2]) + "," * 30 if 1400 <= i < 1640 else line for i, line in enumerate(lines)
        ]

    edit(asked, change)
    frame, about = load(asked)
    gap = frame["position_sample"].rolling(500).max() == 0
    assert gap.sum() > 400
    assert any("was not seen in" in n for n in about["notes"])
    assert np.isfinite(frame.to_numpy()).all()


def test_a_stream_that_stalls_in_flight_is_flagged_as_missing_frames_are(asked):
    def change(lines):
        held = lines[1400].split(",", 2)[2]
        return [",".join([*line.split(",", 2)[:2], held]) if 1400 < i < 1640 else line for i, line in enumerate(lines)]

    plain, _ = load(asked)
    edit(asked, change)
    frame, about = load(asked)
    assert about["sources"]["capture"]["frames held"] == 239
    assert (frame["position_sample"].rolling(500).max() == 0).sum() > 400
    assert any(
        "keeps one pose to the last digit in 239 of" in n and "(1.99 s, in 1 stretches" in n for n in about["notes"]
    )
    kept = (frame["position_sample"] > 0).to_numpy()
    assert frame["x"].to_numpy()[kept] == pytest.approx(plain["x"].to_numpy()[kept], abs=0.02)


def test_a_capture_that_a_spreadsheet_saved_calls_for_care(asked):
    plain, _ = load(asked)
    write_text(asked["capture"], saved_anew(read_bytes(asked["capture"]).decode()))
    frame, about = load(asked)
    pd.testing.assert_frame_equal(frame, plain)
    assert about["verdict"] == "usable with care"
    assert "has been through a spreadsheet (decimal commas)" in about["verdict because"]


@pytest.mark.parametrize(
    ("stated", "words"),
    [("Millimeters", "stated in Millimeters are in another unit"), ("Inches", "gives lengths in 'Inches', expected")],
)
def test_lengths_that_contradict_the_header(asked, stated, words):
    edit(asked, lambda lines: [lines[0].replace("Length Units,Meters", f"Length Units,{stated}"), *lines[1:]])
    refused(asked, words)


def test_lengths_in_millimetres_under_a_header_of_metres(tmp_path, asked):
    truth = body(12.0)
    tau = np.arange(1200) / RATE
    text = motive_text(np.arange(1200), tau, *at_times(truth, tau), unit="Millimeters")
    write_text(asked["capture"], text.replace("Length Units,Millimeters", "Length Units,Meters"))
    refused(asked | {"rigid body": "Quad"}, "more than any room; correct 'Length Units'")


@pytest.mark.parametrize(("stated", "words"), [("XYZ", ""), ("ABC", "")])
def test_a_stated_rotation_type_gives_way_to_the_columns(asked, stated, words):
    plain, _ = load(asked)
    edit(asked, lambda lines: [lines[0].replace("Rotation Type,Quaternion", f"Rotation Type,{stated}"), *lines[1:]])
    frame, _ = load(asked)
    assert frame["roll"].to_numpy() == pytest.approx(plain["roll"].to_numpy())


def test_a_frame_rate_that_contradicts_the_printed_times(asked):
    plain, _ = load(asked)
    edit(asked, lambda lines: [lines[0].replace("Frame Rate,120", "Frame Rate,100"), *lines[1:]])
    frame, about = load(asked)
    assert any("the times are believed" in n for n in about["notes"])
    assert frame["x"].to_numpy()[:5000] == pytest.approx(plain["x"].to_numpy()[:5000], abs=0.01)


def test_a_gyro_scale_that_contradicts_the_capture(asked, made):
    scale = made.onboard.split(b"H gyro_scale:", 1)[1].split(b"\n", 1)[0]
    write_bytes(asked["onboard"], made.onboard.replace(b"gyro_scale:" + scale, b"gyro_scale:0x41200000"))
    refused(asked, "nowhere like the on-board log's")


def table(folder, change, unit="m/s2"):
    """A table flight whose columns `change` has spoilt."""
    truth = body(12.0, rate=200.0)
    columns = {"t": truth.t} | dict(zip("pqr", truth.rates.T)) | dict(zip(("ax", "ay", "az"), truth.force.T))
    frame = change(pd.DataFrame(columns))
    (folder / "log.csv").write_text(frame.to_csv(index=False))
    names = {n: n for n in "pqr"} | {n: {"column": n, "unit": unit} for n in ("ax", "ay", "az")}
    plan = {"time": "t", "sources": [{"name": "imu", "columns": names}]}
    flight = {"flight": "f", "quadrotor": "q", "flight controller": "table", "onboard": str(folder / "log.csv")}
    return import_flight(flight, {"table columns": plan}, {"resampling rate": 200})


def test_a_run_of_nan_in_a_table_is_a_lost_span(tmp_path):
    def change(frame):
        frame.loc[1000:1200, ["p", "q", "r"]] = np.nan
        return frame

    frame, about = table(tmp_path, change)
    lost = frame["t"][frame["onboard_valid"] == 0]
    assert (lost.min(), lost.max()) == pytest.approx((5.0, 6.0), abs=0.02)
    assert "lost" in about["verdict because"]


def test_time_of_a_table_that_steps_back_or_does_not_run(tmp_path):
    def back(frame):
        frame.loc[1000:1020, "t"] -= 3.0
        return frame.assign(t=frame["t"] + 1.7e9)  # since 1970

    _, about = table(tmp_path, back)
    assert any("step back (first in row 1002, by 2.995 s)" in n for n in about["notes"])
    for spoilt, words in ((lambda f: f.assign(t=0.0), "samples of its own"), (lambda f: f.assign(t="x"), "holds text")):
        with pytest.raises(QuasiError, match=words):
            table(tmp_path, spoilt)
    with pytest.raises(QuasiError, match="step back in .* rows; they are no clock"):
        table(tmp_path, lambda f: f.assign(t=np.random.default_rng(1).permutation(f["t"])))


def test_a_column_of_text_and_one_of_nothing(tmp_path):
    with pytest.raises(QuasiError, match="column 'q' holds text"):
        table(tmp_path, lambda f: f.assign(q="fast"))
    with pytest.raises(QuasiError, match="mapped to az is empty"):
        table(tmp_path, lambda f: f.assign(az=np.nan))


def test_units_that_contradict_the_numbers_of_a_table_are_noted(tmp_path):
    _, about = table(tmp_path, lambda f: f, unit="g")
    assert any("specific force is typically" in n and "check its unit" in n for n in about["notes"])
    assert about["verdict"] == "unusable"
    _, about = table(tmp_path, lambda f: f.assign(p=np.degrees(f["p"]) * 3))
    assert any("beyond any gyro" in n for n in about["notes"])
    _, about = table(tmp_path, lambda f: f.assign(az=-f["az"]))
    assert any("points down as it does upside down" in n and "check its sign" in n for n in about["notes"])
    assert about["verdict"] == "unusable"
    _, about = table(tmp_path, lambda f: f.assign(ax=-f["az"], az=f["ax"], p=-f["r"], r=f["p"]))  # mounted nose up
    assert any("90 deg away from up, to the front" in n and "check the body axes" in n for n in about["notes"])
    assert about["verdict"] == "unusable"
    half = lambda f: f.assign(az=np.where(np.arange(len(f)) > 0.4 * len(f), -f["az"], f["az"]))  # noqa: E731
    assert not any("points down" in n for n in table(tmp_path, half)[1]["notes"])  # it landed on its back


def test_time_of_a_table_in_another_unit_than_stated_is_refused(tmp_path):
    with pytest.raises(QuasiError, match="a sample every 5 s if its time is in the unit"):
        table(tmp_path, lambda f: f.assign(t=1e3 * f["t"]))


@pytest.mark.parametrize("still", [False, True])
def test_a_pose_that_is_kept_to_the_end_in_hover_is_lost_where_the_gyro_turns(asked, still):
    """Its reader cannot see it: the body neither stops dead nor jumps. `still`: the last pose is another one each."""
    first = 1500  # frame, 12.5 s of 20

    def freeze(lines):
        kept = lines[6 + first].split(",")[2:]
        for k in range(7 + first, len(lines) - 1):
            cells = lines[k].split(",")
            lines[k] = ",".join([*cells[:2], *(cells[2:] if still else kept)])
        return lines

    edit(asked, freeze)
    frame, about = load(asked)
    notes = [note for note in about["notes"] if "while the gyro turns" in note]
    late = frame["t"] + about["start"]["value"] > 13.0
    assert len(notes) == (not still)
    assert frame["position_sample"][late].any() == still
