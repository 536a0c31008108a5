"""What is wrong with a log of topics is named: where, what was found, and the remedy."""

import sqlite3

import numpy as np
import pytest
from log_formats import Ulog, dataflash_of, made_flight, ulog_of, write_bag, write_dataflash, write_ulog

from quasi.errors import ConfigError, ReadError, cautions
from quasi.importing.onboard_log import gather, read_onboard
from quasi.importing.series import Recording, Series
from quasi.project import configuration
from quasi.project.logbook import read_logbook
from quasi.project.workflow import Folder


@pytest.fixture(scope="module")
def flight():
    return made_flight(seconds=4.5)


def read(path, controller, **quadrotor):
    flown = {"onboard": str(path), "flight controller": controller, "log number": None}
    return read_onboard(flown, quadrotor)


def needs(name):
    return pytest.importorskip(name)


# topics


def test_a_missing_topic_is_named_with_what_the_log_holds(tmp_path, flight):
    needs("rosbags")
    path = write_bag(tmp_path, flight, drop={"/imu", "/odom"})
    with pytest.raises(ReadError) as error:
        read(path, "rosbag")
    for word in ("body rates", "sensor_msgs/msg/Imu", "/motor_speed (mav_msgs/msg/Actuators)", "/battery"):
        assert word in str(error.value)
    assert "did you mean" not in str(error.value)  # message types are never mistyped


def test_a_bag_without_imu_is_read_where_its_sensors_can_be_made(tmp_path, flight):
    needs("rosbags")
    recording = read(write_bag(tmp_path, flight, drop={"/imu"}), "rosbag")
    assert {"p", "qw", "x"} <= {name for series in recording.series.values() for name in series.values}


def test_an_orientation_that_the_imu_does_not_measure_is_no_attitude(tmp_path, flight):
    needs("rosbags")
    recording = read(write_bag(tmp_path, flight, drop={"/odom"}), "rosbag")  # its covariance begins with -1
    found = {name for series in recording.series.values() for name in series.values}
    assert {"p", "ax"} <= found and "qw" not in found


def test_a_mistyped_topic_is_named_with_its_neighbour(tmp_path, flight):
    needs("rosbags")
    path = write_bag(tmp_path, flight)
    with pytest.raises(ConfigError, match=r"'/inu'.*did you mean '/imu'"):
        read(path, "rosbag", **{"log topics": {"body rates": "/inu"}})
    with pytest.raises(ConfigError, match="unknown key 'rates' in 'log topics'"):
        configuration.check({"log topics": {"rates": "/imu"}}, "quadrotor", "file")
    columns = {n: f"/imu.angular_velocity.{a}" for n, a in zip("pqr", "xyq")}
    mapping = {"sources": [{"name": "imu", "frame": "FLU", "columns": columns}]}
    with pytest.raises(ReadError, match=r"'/imu.angular_velocity.q'.*did you mean '/imu.angular_velocity"):
        read(path, "rosbag", **{"table columns": mapping})


def test_columns_of_two_topics_are_two_sources(tmp_path, flight):
    needs("rosbags")
    columns = {n: f"/imu.angular_velocity.{a}" for n, a in zip("pqr", "xyz")}
    columns |= {a: f"/odom.pose.pose.position.{a}" for a in "xyz"}
    mapping = {"sources": [{"name": "all", "frame": "FLU", "columns": columns}]}
    with pytest.raises(ReadError, match="sampled apart"):
        read(write_bag(tmp_path, flight), "rosbag", **{"table columns": mapping})


@pytest.mark.parametrize(
    ("chosen", "words"),
    [(["IMU:1"], "log topics is ['IMU:1'], expected a section"),
     ({"body rates": 1}, "'body rates' is 1, expected text"),
     ({"body rate": "IMU:1"}, "log topics: unknown key 'body rate' (did you mean 'body rates'?)")],
)  # fmt: skip
def test_a_choice_of_topics_that_nothing_has_checked_is_checked_by_the_reader(tmp_path, flight, chosen, words):
    path = tmp_path / "two.bin"
    path.write_bytes(dataflash_of(flight, imus=2).bytes())
    with pytest.raises(ConfigError) as error:
        read(path, "ardupilot", **{"log topics": chosen})
    assert words in str(error.value)


def test_of_two_imus_one_is_used_the_other_listed_and_a_key_chooses(tmp_path, flight):
    path = tmp_path / "two.bin"
    path.write_bytes(dataflash_of(flight, imus=2).bytes())
    first = read(path, "ardupilot")
    note = next(n for n in first.notes if "IMU:1" in n)
    assert '"log topics": {"body rates": "IMU:1"}' in " ".join(first.notes) and "IMU:0" in note
    other = read(path, "ardupilot", **{"log topics": {"body rates": "IMU:1"}})
    # the second gyro of the made flight is off by 0.01 rad/s
    assert np.abs(other.series["onboard"].values["p"] - first.series["onboard"].values["p"] - 0.01).max() < 1e-6


def test_stamps_of_another_host_are_moved(tmp_path, flight):
    needs("rosbags")
    usual = read(write_bag(tmp_path / "a", flight), "rosbag")
    moved = read(write_bag(tmp_path / "b", flight, ahead={"/motor_speed": 3600.5}), "rosbag")
    assert any("/motor_speed" in n and "3600.500 s ahead" in n for n in moved.notes)
    one, other = (next(s for s in r.series.values() if "w1" in s.values) for r in (usual, moved))
    assert np.abs(one.t - other.t).max() < 1e-6


def test_topics_of_unknown_types_are_named_and_the_others_read(tmp_path, flight):
    needs("rosbags")
    path = write_bag(tmp_path, flight, storage="db3", extra=strange_topic)
    # as bags of ROS 2 before Iron, which hold no definitions of types
    with sqlite3.connect(path) as database:
        database.execute("delete from message_definitions")
    found = read(path, "rosbag")
    assert "p" in found.series["onboard"].values
    note = next(n for n in found.notes if "cannot be decoded" in n)
    assert "/strange (lab_msgs/msg/Strange)" in note and "/motor_speed (mav_msgs/msg/Actuators)" in note


def strange_topic(store, writer):
    from rosbags.typesys import get_types_from_msg

    store.register(get_types_from_msg("float64 value\n", "lab_msgs/msg/Strange"))
    connection = writer.add_connection("/strange", "lab_msgs/msg/Strange", typestore=store)
    message = store.types["lab_msgs/msg/Strange"](value=1.0)
    for k in range(30):
        yield connection, k, store.serialize_cdr(message, "lab_msgs/msg/Strange")


def test_a_type_whose_name_is_code_opens_nothing(tmp_path, flight):
    needs("rosbags")
    path = write_bag(tmp_path, flight)
    sprung = tmp_path / "sprung"
    code = f"a/msg/B:open({str(sprung)!r},'w')#".encode()
    kind = b"sensor_msgs/msg/BatteryState"
    data = path.read_bytes()
    assert data.count(kind)
    bad = tmp_path / "harm.mcap"
    # as long as the name that it replaces, so that the file stays whole
    bad.write_bytes(data.replace(kind, code[: len(kind)].ljust(len(kind), b"#")))
    with pytest.raises(ReadError, match="no name of a message type"):
        read(bad, "rosbag")
    assert not sprung.exists()


# files


@pytest.mark.parametrize("share", [0.5, 0.9, 0.999])
@pytest.mark.parametrize("kind", ["ulog", "dataflash", "mcap", "ros1"])
def test_a_truncated_file_is_read_up_to_its_end_or_refused(tmp_path, flight, kind, share):
    writers = {"ulog": ("px4", write_ulog), "dataflash": ("ardupilot", write_dataflash),
               "mcap": ("rosbag", write_bag), "ros1": ("rosbag", lambda f, x: write_bag(f, x, 1))}  # fmt: skip
    controller, write = writers[kind]
    if kind != "dataflash":
        needs("pyulog" if kind == "ulog" else "rosbags")
    path = write(tmp_path, flight)
    cut = tmp_path / f"cut{path.suffix}"
    data = path.read_bytes()
    cut.write_bytes(data[: int(share * len(data))])
    if kind in ("ulog", "dataflash"):
        whole, found = read(path, controller), read(cut, controller)
        n = len(found.series["onboard"].t)
        assert share - 0.1 < n / len(whole.series["onboard"].t) <= 1.0
        assert np.array_equal(found.series["onboard"].values["p"], whole.series["onboard"].values["p"][:n])
    else:
        with pytest.raises(ReadError, match=r"no readable bag.*(reindex|recover)"):
            read(cut, controller)


def test_drop_outs_of_a_ulog_are_counted(tmp_path, flight):
    needs("pyulog")
    log = ulog_of(flight)
    log.dropout(250)
    log.dropout(40)
    (tmp_path / "drop.ulg").write_bytes(log.bytes())
    found = read(tmp_path / "drop.ulg", "px4")
    assert found.metadata["drop-outs"] == {"count": 2, "lost": 0.29, "unit": "s"}
    assert any("0.29 s in 2 drop-outs" in n for n in found.notes)


def test_noise_within_a_dataflash_log_is_passed_over(tmp_path, flight):
    data = dataflash_of(flight).bytes()
    middle = data.index(b"\xa3\x95", len(data) // 2)
    path = tmp_path / "noise.bin"
    path.write_bytes(data[:middle] + bytes(range(1, 120)) + data[middle:])
    found = read(path, "ardupilot")
    assert found.metadata["lost bytes"] == 119
    assert any("119 bytes" in n for n in cautions(found.notes))
    assert len(found.series["onboard"].t) == len(flight.t)


def test_a_log_of_another_controller_is_named_with_the_right_one(tmp_path, flight):
    path = write_dataflash(tmp_path, flight)
    with pytest.raises(ReadError, match=r"ArduPilot DataFlash.*'Flight controller' to ardupilot"):
        read(path, "px4")


def test_an_absent_package_is_named_with_the_command(tmp_path, flight, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyulog", None)
    path = tmp_path / "flight.ulg"
    path.write_bytes(Ulog().bytes())
    with pytest.raises(ReadError, match=r"pyulog.*pip install 'quasi\[px4\]'"):
        read(path, "px4")


def test_a_damaged_ulog_ends(tmp_path):
    needs("pyulog")
    # a message of the definitions that claims more bytes than the file holds
    log = Ulog()
    log.define([], {})
    path = tmp_path / "endless.ulg"
    path.write_bytes(log.bytes() + b"\xff\x7f\x00" + b"F" * 200)
    with pytest.raises(ReadError, match="endless"):
        read(path, "px4")


def test_a_folder_in_place_of_a_bag_is_named_with_its_file(tmp_path, flight):
    needs("rosbags")
    write_bag(tmp_path, flight)
    (tmp_path / "config").mkdir()
    (tmp_path / "config/processing.json").write_text("{}")
    head = "Quadrotor,Onboard Name,OB Path,Flight controller,Drone Config File,Drone Config Path\n"
    (tmp_path / "logbook.csv").write_text(f"{head}Q,bag_mcap,.,rosbag,q.json,.\n")
    raw = Folder(tmp_path).recordings.raw(read_logbook(tmp_path / "logbook.csv")[2])
    assert raw["onboard"] is None and "is a folder" in raw["problem"] and "bag_mcap.mcap" in raw["problem"]


def test_a_bag_packed_by_an_unknown_codec_is_refused_with_the_remedy(tmp_path, flight):
    needs("rosbags")
    path = write_bag(tmp_path, flight, storage="db3")
    about = path.parent / "metadata.yaml"
    text = about.read_text()
    assert "compression_format: ''" in text
    about.write_text(
        text.replace("compression_format: ''", "compression_format: brotli").replace(
            "compression_mode: ''", "compression_mode: FILE"
        )
    )
    with pytest.raises(ReadError, match="brotli.*decompress it first"):
        read(path, "rosbag")


def test_a_bag_of_several_files_is_read_whole_by_one_of_them(tmp_path, flight):
    needs("rosbags")
    path = write_bag(tmp_path, flight, storage="db3")
    whole = read(path, "rosbag")
    # the same recording in two files, the second without messages of its own
    with sqlite3.connect(path) as first, sqlite3.connect(path.with_name("second.db3")) as second:
        first.backup(second)
        middle = first.execute("select timestamp from messages order by timestamp").fetchall()[1500][0]
        first.execute("delete from messages where timestamp >= ?", (middle,))
        second.execute("delete from messages where timestamp < ?", (middle,))
    about = path.parent / "metadata.yaml"
    about.write_text(about.read_text().replace(f"- {path.name}\n", f"- {path.name}\n  - second.db3\n", 1))
    found = read(path, "rosbag")
    assert np.array_equal(found.series["onboard"].t, whole.series["onboard"].t)


@pytest.mark.parametrize("every", [1, 50])
def test_a_battery_of_0_volts_was_not_measured(every):
    """Maps from commands to speeds took it for a battery that stops all rotors: an error of 740 % of the speeds."""
    t, noise = 0.002 * np.arange(5000), np.random.default_rng(0).normal(0.0, 0.01, (3, 5000))
    values = dict(zip("pqr", noise)) | {"ax": 0.0 * t, "ay": 0.0 * t, "az": -9.81 + 0.0 * t}
    values["battery_voltage"] = np.where(np.arange(5000) % every == 0, 0.0, 15.0)
    found = gather(Recording({"onboard": Series(t, values)}, {}, []), "a", []).others
    assert ("battery_voltage" in found) == (every > 1)
    if every > 1:
        known = found["battery_voltage"].values
        assert np.all(known[np.isfinite(known)] == 15.0)
