"""Commands about recordings: a folder for them, what they hold, decoded logs, clocks, noise at rest."""

import argparse
import codecs
import json
from collections.abc import Sequence
from pathlib import Path

from quasi.commands.folder import LIBRARY
from quasi.errors import ConfigError
from quasi.project.templates import lay_folder


def add_recording_commands(commands: argparse._SubParsersAction) -> None:
    """Add `check`, `init`, `decode`, `sync` and `noise`."""
    check = commands.add_parser(
        "check",
        help="open every raw file that a project folder names: what is there, what is missing, what it is good for",
        description="Reads configuration and raw files; nothing is synchronised or filtered. The exit code is 1 where "
        "something is broken.",
    )
    check.add_argument("folder", nargs="?", default=".", help="project folder (default: here)")
    check.add_argument("--data", metavar="PATH", help="where data/ is, as `--config data=PATH` of snakemake")
    check.set_defaults(run=lambda o: check_raw_files(Path(o.folder), o.data))

    init = commands.add_parser("init", help="lay a project folder: commented configuration and a logbook")
    init.add_argument("folder", help="folder to make; it must be empty or absent")
    init.add_argument("--from", dest="log", metavar="LOG", help="write what this log says of vehicle and columns")
    init.add_argument("--capture", help="export of the motion capture of the same flight")
    init.set_defaults(run=init_folder)

    decode = commands.add_parser(
        "decode",
        help="write any log or capture that quasi reads in SI units, as Parquet, CSV or MCAP",
        description="Each quantity at its own samples, without interpolation. Columns of a table are guessed, or "
        "taken from the 'table columns' of --quadrotor.",
    )
    decode.add_argument("log", help="log or capture")
    decode.add_argument("-o", "--out", metavar="FILE", help="out.parquet, out.csv or out.mcap (default: LOG.parquet)")
    decode.add_argument("--quadrotor", metavar="JSON", help="quadrotor configuration")
    decode.add_argument("--rigid-body", help="name of the vehicle in a capture (its only one)")
    decode.add_argument("--log-number", type=int, help="which log of a file that holds several")
    decode.add_argument("--flight-controller", help="read it as of this one (default: what the file holds)")
    decode.set_defaults(run=decode_log)

    sync = commands.add_parser(
        "sync",
        help="tie a log and a motion capture of one flight: lag, clock rate, lever arm and yaw",
        description="Needs no project: prints lag, clock rate, lever arm (IMU from the captured point) and yaw with "
        "standard errors, and draws both sides as aligned.",
    )
    sync.add_argument("log", help="on-board log, of any format that quasi reads")
    sync.add_argument("capture", help="export of the motion capture")
    sync.add_argument("--quadrotor", metavar="JSON", help="quadrotor configuration; tables need its 'table columns'")
    sync.add_argument("--rigid-body", help="name of the vehicle in the capture (its only one)")
    sync.add_argument("--log-number", type=int, help="which log of a file that holds several")
    sync.add_argument("--longest-lag", type=float, default=25.0, help="s, between the beginnings of the records (25)")
    sync.add_argument("-o", "--out", metavar="PNG", help="the picture (default: sync.png here)", default="sync.png")
    sync.add_argument("--json", action="store_true", help="print JSON instead of text")
    sync.set_defaults(run=align_log)

    noise = commands.add_parser(
        "noise",
        help="noise of gyro and accelerometer from logs of a quadrotor at rest",
        description="Mean and standard deviation of p q r ax ay az (and roll pitch yaw, where logged or captured), "
        "pooled over logs of a quadrotor that stands still, best armed with idling rotors.",
    )
    noise.add_argument("quadrotor", help="quadrotor configuration, JSON")
    noise.add_argument("logs", nargs="+", metavar="LOG", help="rest log, or motion-capture export of a rest")
    noise.add_argument("--cut", type=float, default=0.1, help="share of a log left out at either end (0.1)")
    noise.add_argument("--rigid-body", help="name of the rigid body in motion-capture exports")
    noise.add_argument("--log-number", type=int, help="which log of a file that holds several")
    noise.add_argument("--write", action="store_true", help="write the statistics into the quadrotor configuration")
    noise.set_defaults(
        run=lambda o: noise_at_rest(
            Path(o.quadrotor), [Path(log) for log in o.logs], o.cut, o.rigid_body, o.log_number, o.write
        )
    )


def init_folder(options: argparse.Namespace) -> str:
    """Lay a project folder, empty or for a first log."""
    folder = Path(options.folder)
    if options.log is None and options.capture is None:
        return lay_folder(folder, LIBRARY)
    from quasi.importing.first_configuration import lay_folder_from

    if options.log is None:
        raise ConfigError("--capture needs the log of the same flight; add --from LOG")
    return lay_folder_from(folder, LIBRARY, Path(options.log), Path(options.capture) if options.capture else None)


def decode_log(options: argparse.Namespace) -> str:
    """Write a log in SI units; see `quasi.importing.decode`."""
    from quasi.importing.decode import decode_file
    from quasi.tables import read_json

    return decode_file(
        Path(options.log), Path(options.out) if options.out else None,
        read_json(options.quadrotor) if options.quadrotor else None,
        options.rigid_body, options.log_number, options.flight_controller,
    )  # fmt: skip


def check_raw_files(directory: Path, data: str | None) -> tuple[str, int]:
    """What a project folder's raw files hold, and the exit code; see `quasi.importing.check`."""
    from quasi.importing.check import check_folder

    return check_folder(directory, LIBRARY, data)


def align_log(options: argparse.Namespace) -> str:
    """Lag, clock rate, lever arm and yaw of a log and a capture as text or JSON, and the picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from quasi.importing import sync_files
    from quasi.tables import read_json, replace_file

    quadrotor = read_json(Path(options.quadrotor)) if options.quadrotor else {}  # a part of one will do
    found = sync_files.align_files(
        Path(options.log), Path(options.capture), quadrotor, options.rigid_body, options.log_number, options.longest_lag
    )
    with replace_file(Path(options.out)) as part:
        FigureCanvasAgg(sync_files.alignment_picture(found)).print_png(part)
    if options.json:
        return json.dumps(sync_files.alignment_plain(found), indent=2)
    return f"{sync_files.alignment_text(found)}\nMade {options.out}"


def noise_at_rest(
    quadrotor: Path,
    logs: Sequence[Path],
    cut: float = 0.1,
    rigid_body: str | None = None,
    log_number: int | None = None,
    write: bool = False,
) -> str:
    """Noise statistics of rest logs as a table; with `write` they go into the quadrotor configuration as well.

    Raises a QuasiError for a log that cannot be read or moves; the configuration is then left as it was.
    """
    from quasi.filtering.noise_statistics import EULER_ANGLES, RestLog, noise_statistics, section
    from quasi.importing.rest import read_rest
    from quasi.project.configuration import check, read, with_section
    from quasi.tables import read_unpacked, write_bytes

    configuration, _ = read(quadrotor, "quadrotor")
    rests = {str(path): read_rest(path, configuration, rigid_body, log_number) for path in logs}
    notes = [note for rest in rests.values() for note in rest.notes]
    # a log's own attitude is what its noise is needed for; a capture's stands in where there is none
    if any({"p", "roll"} <= set(rest.columns) for rest in rests.values()):
        for name in [name for name, rest in rests.items() if set(rest.columns) == set(EULER_ANGLES)]:
            notes.append(f"{name}: not used, the logs hold an attitude of their own")
            del rests[name]
    found = noise_statistics(
        [RestLog(name, rest.t, rest.columns, rest.speeds, rest.step) for name, rest in rests.items()], cut
    )
    lines = [f"{'':6}{'standard deviation':>20}{'mean':>14}{'samples':>10}"]
    for name, entry in found.values.items():
        unit = "rad/s" if name in "pqr" else "rad" if name in EULER_ANGLES else "m/s2"
        lines.append(f"{name:6}{entry['std']:>14.5g} {unit:<5}{entry['mean']:>14.4g}{found.samples[name]:>10}")
    lines += [f"{seconds:.1f} s of {name}" for name, seconds in found.seconds.items()]
    lines += [f"note: {note}" for note in [*notes, *found.notes]]
    if not write:
        return "\n".join([*lines, f"{quadrotor} is unchanged; --write writes them there"])
    text, encoding = _decoded(bytes(read_unpacked(quadrotor)))
    text = with_section(text, "(estimated) imu sensor noise statistics", section(found))
    check(json.loads(text.removeprefix("\ufeff")), "quadrotor", str(quadrotor))
    write_bytes(quadrotor, text.encode(encoding))
    return "\n".join([*lines, f"wrote them into {quadrotor}"])


def _decoded(data: bytes) -> tuple[str, str]:
    """Text that `read_text` would read, a byte order mark kept, and the encoding that writes the same bytes."""
    for mark, encoding in ((codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"), (b"", "utf-8")):
        if data.startswith(mark):
            try:
                return data.decode(encoding), encoding
            except UnicodeDecodeError:
                break
    return data.decode("latin-1"), "latin-1"
