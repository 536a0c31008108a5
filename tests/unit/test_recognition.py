"""What a raw file is stands in its first bytes: other formats are named, and extensions decide nothing."""

import io
import pickle
import sqlite3
import struct
import zipfile
from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from blackbox_writer import END, intra_frame, log_bytes, svb
from cases import CASES, flight_of, needs_cases
from scipy.io import savemat

from quasi.errors import ReadError
from quasi.importing.onboard_log import read_onboard
from quasi.importing.readers.motive import read_motive
from quasi.importing.wind import read_lvm
from quasi.project.logbook import read_logbook
from quasi.project.recognition import recognise
from quasi.project.workflow import Folder

MAPPING = {"time": {"column": "t"}, "sources": [{"name": "imu", "columns": {n: n for n in "pqr"}}]}


def saved(write):
    buffer = io.BytesIO()
    write(buffer)
    return buffer.getvalue()


def database(folder):
    connection = sqlite3.connect(folder / "bag.db3")
    connection.execute("create table messages(x)")
    connection.commit()
    connection.close()
    return (folder / "bag.db3").read_bytes()


def micro_sd(version):
    head = b"\xbc" + struct.pack("<HH", version, 1) + struct.pack("<H", 0) + b"fixedFrequency\0"
    return head + struct.pack("<H", 1) + b"motor.m1(H)\0" + struct.pack("<HQH", 0, 5, 7) + b"\0\0\0\0"


def zipped(name):
    return saved(lambda f: zipfile.ZipFile(f, "w").writestr(name, "x"))


FILES = {
    "ulog": lambda _: b"ULog\x01\x12\x35\x01" + bytes(60),
    "rosbag": lambda _: b"#ROSBAG V2.0\nE\0\0\0" + bytes(60),
    "mcap": lambda _: b"\x89MCAP0\r\n\x01" + bytes(60),
    "db3": database,
    "mat5": lambda _: saved(lambda f: savemat(f, {"x": np.arange(4.0)})),
    "mat73": lambda _: b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n",
    "hdf5": lambda _: b"\x89HDF\r\n\x1a\n" + bytes(60),
    "npz": lambda _: saved(lambda f: np.savez(f, x=np.arange(4.0))),
    "npy": lambda _: saved(lambda f: np.save(f, np.arange(4.0))),
    "xlsx": lambda _: zipped("xl/workbook.xml"),
    "zip": lambda _: zipped("flight.csv"),
    "crazyflie": lambda _: micro_sd(2),
    "parquet": lambda _: saved(lambda f: pq.write_table(pa.table({"t": [1.0]}), f)),
    "gzip": lambda _: b"\x1f\x8b\x08" + bytes(20),
}


@pytest.mark.parametrize("kind", FILES)
def test_files_of_other_formats_are_named_by_the_reader_that_meets_them(tmp_path, kind):
    data = FILES[kind](tmp_path)
    assert recognise(data).kind == kind
    for path in (tmp_path / "flight.bbl", tmp_path / "flight.csv"):
        path.write_bytes(data)
        readers = {
            "betaflight": partial(read_onboard, flight_of(path), {}),
            "table": partial(read_onboard, flight_of(path, "table"), {"table columns": MAPPING}),
            "motive": partial(read_motive, path, "B"),
            "wind": partial(read_lvm, path),
        }
        for name, read in readers.items():
            if name == "table" and kind in ("parquet", "npz", "mat5"):
                continue
            with pytest.raises(ReadError) as error:
                read()
            text = str(error.value)
            assert recognise(data).name in text and text.isprintable()
            # gzip is unpacked where it is not damaged
            assert recognise(data).remedy.split(" and ")[-1] in text


@pytest.mark.parametrize("protocol", range(2, 6))
def test_a_pickle_is_named_and_never_opened(tmp_path, protocol):
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "sprung"), "w"))

    for content in ({"x": 1}, [1.0], np.arange(3), Trap()):
        data = pickle.dumps(content, protocol)
        assert recognise(data).kind == "pickle"
    path = tmp_path / "flight.csv"
    path.write_bytes(data)
    with pytest.raises(ReadError, match="pickle"):
        read_onboard(flight_of(path, "table"), {"table columns": MAPPING})
    assert not (tmp_path / "sprung").exists()


def test_text_and_damaged_text_are_no_other_format():
    for data in (
        b"t,p,q\n1,2,3\n",
        "t;p\n1,5;2\n".encode("utf-16"),
        b"\xbc\x07\x00abc",
        b"\x80abc",
        b"",
        b'"Product","x"\n' + b"1,2\n" * 200,
    ):
        assert recognise(data) is None


@pytest.mark.parametrize("version", [1, 2])
def test_micro_sd_logs_of_both_versions_are_known(version):
    assert recognise(micro_sd(version)).kind == "crazyflie"


def blackbox_log():
    body = b"".join(intra_frame(i, 1000 * i, svb(1) * 3) for i in range(60))
    fields = [(f"gyroADC[{i}]", True) for i in range(3)]
    return log_bytes(fields, body + END, header="gyro_scale:0x3f800000").replace(b"I interval:32", b"I interval:1")


@pytest.mark.parametrize("name", ["LOG00012.TXT", "noext", "log.csv", "log.bbl"])
def test_content_decides_how_a_file_is_read(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(blackbox_log())
    assert read_onboard(flight_of(path), {}).metadata["reader"] == "blackbox"
    path.write_text("time (us),gyroADC[0],gyroADC[1],gyroADC[2]\n" + "".join(f"{1000 * i},1,2,3\n" for i in range(30)))
    assert read_onboard(flight_of(path), {}).metadata["reader"] == "decoded blackbox"


def test_a_near_file_is_named_with_what_it_holds(tmp_path):
    (tmp_path / "config").mkdir()
    (tmp_path / "config/processing.json").write_text("{}")
    (tmp_path / "LOG00012.TXT").write_bytes(blackbox_log())
    head = "Quadrotor,Onboard Name,OB Path,Flight controller,Drone Config File,Drone Config Path\n"
    for name, found in (("LOG00012.TXT", True), ("LOG00012", False), ("log00012.bbl", False)):
        (tmp_path / "logbook.csv").write_text(f"{head}Q,{name},.,betaflight,q.json,.\n")
        row = read_logbook(tmp_path / "logbook.csv")[2]
        raw = Folder(tmp_path).recordings.raw(row)
        assert (raw["onboard"] is not None) == found
        assert found or "LOG00012.TXT (a blackbox log)" in raw["problem"]
        assert row.key.lower() == "log00012"


@needs_cases
@pytest.mark.parametrize("name", ["LOG00012.TXT", "noext"])
def test_cases_with_odd_extensions_are_read(name):
    recording = read_onboard(flight_of(CASES / "5_exists_but_not_found" / name), {})
    assert recording.metadata["reader"] == "blackbox" and len(recording.series["onboard"].t) > 1000
