"""From one file to a folder that can be run: geometry, columns and logbook as the log tells; logs written in SI."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from log_formats import WRITERS, columns_of, dataflash_of, made_flight, ulog_of, write_csv, write_dataflash
from recordings import SHARED

from quasi.airframe import read_airframe
from quasi.command import main
from quasi.importing.decode import _mcap
from quasi.importing.readers.guess_columns import guess_columns
from quasi.importing.series import Series
from quasi.tables import read_fields, read_json

DATA = SHARED.parent
EXAMPLE = Path(__file__).parents[2] / "examples/nanodrone/config/NanoDroneConfig.json"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"real recordings are not at {DATA}")


@pytest.fixture(scope="module")
def flight():
    return made_flight(seconds=4.5)


def made(folder, log, capsys):
    """The quadrotor's configuration and the logbook's row of a folder laid from a log, and what was printed."""
    assert main(["init", str(folder), "--from", str(log)]) == 0
    (row,) = csv.DictReader((folder / "data/logbook.csv").read_text().splitlines())
    return read_json(folder / "data/my_quadrotor.json"), row, capsys.readouterr().out


@pytest.mark.parametrize("name", ["csv", "lists", "mat", "npz", "ulog", "dataflash", "ros2 mcap"])
def test_a_folder_laid_from_a_log_is_ready(tmp_path, flight, name, capsys):
    pytest.importorskip({"ulog": "pyulog", "ros2 mcap": "rosbags"}.get(name, "numpy"))
    controller, write = WRITERS[name]
    log = write(tmp_path, flight)
    quadrotor, row, printed = made(tmp_path / "lab", log, capsys)
    assert quadrotor["flight controller"] == row["Flight controller"] == controller
    assert (row["Onboard Name"], row["OB Path"]) == (log.name, str(log.parent))
    assert "usable for: models and gaps" in printed
    assert main(["check", str(tmp_path / "lab")]) == 0
    assert capsys.readouterr().out.startswith("READY: 1 flight can be read")


def test_geometry_comes_from_the_rotor_parameters_of_px4(tmp_path, flight, capsys):
    pytest.importorskip("pyulog")
    # motor 1 aft right counter-clockwise, then round by the front: no default of PX4
    hubs = [(-0.1, 0.12), (0.1, 0.12), (0.1, -0.12), (-0.1, -0.12)]
    parameters = {f"CA_ROTOR{i}_P{a}": v for i, hub in enumerate(hubs) for a, v in zip("XY", hub)}
    parameters |= {f"CA_ROTOR{i}_KM": km for i, km in enumerate((0.05, -0.05, 0.05, -0.05))}
    (tmp_path / "flight.ulg").write_bytes(ulog_of(flight, parameters=parameters).bytes())
    quadrotor, _, _ = made(tmp_path / "lab", tmp_path / "flight.ulg", capsys)
    assert quadrotor["rotor config"] == {"front left": 3, "front right": 2, "aft right": 1, "aft left": 4}
    airframe = read_airframe(quadrotor, "laid", mass=1.0)
    assert airframe.spin.tolist() == [-1, 1, -1, 1]
    np.testing.assert_allclose(airframe.hubs[:, :2], hubs, atol=1e-6)


def test_geometry_comes_from_the_frame_of_ardupilot(tmp_path, flight, capsys):
    log = dataflash_of(flight)
    for name, value in ((b"FRAME_CLASS", 1), (b"FRAME_TYPE", 12)):
        log.write("PARM", 5_000_000, name, value, value)
    (tmp_path / "flight.bin").write_bytes(log.bytes())
    quadrotor, _, _ = made(tmp_path / "lab", tmp_path / "flight.bin", capsys)
    assert quadrotor["rotor config"] == {"front left": 4, "front right": 2, "aft right": 1, "aft left": 3}
    assert quadrotor["rotor1 rotation direction"] == "CW"


def test_units_and_axes_of_a_table_are_guessed(flight):
    flip = np.array([1.0, -1.0, -1.0])
    columns = {"time_us": 1e6 * flight.t}
    columns |= dict(zip(("gyro.x", "gyro.y", "gyro.z"), np.degrees(40 * flight.rates * flip).T))
    columns |= dict(zip(("acc.x", "acc.y", "acc.z"), (flight.force * flip / 9.80665).T))
    columns |= dict(zip(("pos_x", "pos_y", "pos_z"), (flight.p * flip + [0, 0, 3]).T))
    columns |= {f"motor{i + 1}_rpm": flight.rotors[:, i] * 30 / np.pi for i in range(4)}
    columns |= {"setpoint_x": flight.t, "vbat_mV": 1000 * flight.battery}
    mapping = guess_columns({"": pd.DataFrame(columns)}).mapping
    assert mapping["time"] == {"column": "time_us", "unit": "us"}
    found = {q: (e["column"], e["unit"]) for s in mapping["sources"] for q, e in s["columns"].items()}
    assert found["p"] == ("gyro.x", "deg/s") and found["az"] == ("acc.z", "g") and found["z"] == ("pos_z", "m")
    assert found["w4"] == ("motor4_rpm", "rpm") and found["battery_voltage"] == ("vbat_mV", "mV")
    assert {s["frame"] for s in mapping["sources"]} == {"FLU"}


@needs_data
def test_the_guess_for_a_real_table_is_its_configuration():
    guess = guess_columns({"": pd.read_csv(DATA / "nanodrone/square_run1.csv")})
    found = {q: e["column"] for s in guess.mapping["sources"] for q, e in s["columns"].items()}
    example = json.loads(EXAMPLE.read_text())["table columns"]
    entries = {q: e for s in example["sources"] if not s.get("motion capture") for q, e in s["columns"].items()}
    expected = {q: e if isinstance(e, str) else e["column"] for q, e in entries.items()}
    assert found == {q: c for q, c in expected.items() if q in found}
    assert {"p", "az", "qw", "z", "vz", "w4", "command4", "battery_voltage"} <= set(found)


def test_a_table_without_body_rates_is_refused_with_its_columns(tmp_path, flight, capsys):
    pd.DataFrame({"t": flight.t, "speed": flight.t}).to_csv(tmp_path / "a.csv", index=False)
    assert main(["init", str(tmp_path / "lab"), "--from", str(tmp_path / "a.csv")]) == 1
    assert "t, speed" in capsys.readouterr().err
    assert not (tmp_path / "lab").exists()


# decode


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_decoded_log_is_the_flight_in_si_with_units(tmp_path, flight, suffix):
    out = tmp_path / f"out.{suffix}"
    assert main(["decode", str(write_dataflash(tmp_path, flight)), "-o", str(out)]) == 0
    if suffix == "csv":
        table = pd.read_csv(out)
        assert {"t (s)", "p (rad/s)", "ax (m/s2)", "w1 (rad/s)", "battery_voltage (V)"} <= set(table.columns)
        table.columns = [c.partition(" ")[0] for c in table.columns]
    else:
        table = pq.read_table(out).to_pandas()
        assert read_fields(out)["w1"]["unit"] == "rad/s" and read_fields(out)["qw"]["frame"] == "body to earth"
    assert len(table) == len(flight.t)
    assert np.abs(table["p"] - flight.rates[:, 0]).max() < 1e-5
    rotor = table["w1"].dropna()
    assert len(rotor) == len(flight.t[::4])
    assert np.abs(rotor.to_numpy() - flight.rotors[::4, 0]).max() < 1e-3


def test_a_decoded_log_in_mcap_is_read_by_its_library(tmp_path, flight):
    pytest.importorskip("mcap")
    from mcap.reader import make_reader

    out = tmp_path / "out.mcap"
    assert main(["decode", str(write_dataflash(tmp_path, flight)), "-o", str(out)]) == 0
    with out.open("rb") as file:
        reader = make_reader(file)
        schemas = reader.get_summary().schemas.values()
        units = {n: f["description"] for s in schemas for n, f in json.loads(s.data)["properties"].items()}
        rates = [json.loads(m.data)["p"] for _, c, m in reader.iter_messages(topics=["/onboard"])]
    assert units["p"] == "rad/s body FRD" and units["w1"] == "rad/s"
    np.testing.assert_allclose(rates, flight.rates[:, 0], atol=1e-6)


def test_a_series_of_stamps_alone_is_left_out_of_mcap(tmp_path):
    pytest.importorskip("mcap")
    from mcap.reader import make_reader

    t = np.arange(3) / 10.0
    data = _mcap({"onboard": Series(t, {"p": t}), "onboard (stamps)": Series(t, {})}, tmp_path / "log")
    topics = {channel.topic for _, channel, _ in make_reader(io.BytesIO(data)).iter_messages()}
    assert topics == {"/onboard"}


def test_a_decoded_log_never_replaces_the_log(tmp_path, flight, capsys):
    path = write_csv(tmp_path, flight)
    before = path.read_bytes()
    assert main(["decode", str(path), "-o", str(path)]) == 1
    assert path.read_bytes() == before and "is the log itself" in capsys.readouterr().err
    assert main(["decode", str(path), "-o", str(tmp_path / "a.xlsx")]) == 1
    assert set(columns_of(flight)) <= set(pd.read_csv(path).columns)
