"""The only module that opens files: Parquet tables with units, JSON documents, raw bytes and text.

Writes are atomic: a temporary file in the folder of the target, fsync, then a rename.
Every column of a flight carries its unit and its frame in the Parquet field metadata; the file metadata records how it
was made. pandas and pyarrow are imported where a table is touched: Snakemake's own process reads documents only.
"""

import codecs
import gzip
import hashlib
import io
import json
import math
import os
import shutil
import tempfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from quasi.errors import ConfigError, DataError, ReadError, nearest, quoted
from quasi.input_limits import MAX_DIGITS, MAX_FILE_BYTES, MAX_JSON_BYTES, MAX_UNPACKED_BYTES, check_lines, check_size

if TYPE_CHECKING:
    import pandas as pd

# name: (unit, frame, meaning). Columns outside this list name their own unit when written.
COLUMNS: dict[str, tuple[str, str, str]] = {
    "t": ("s", "", "time since the first fused sample"),
    **{f"w{i}": ("rad/s", "", f"rotor {i}, mechanical speed as measured") for i in range(1, 9)},
    **{f"w{i}_dot": ("rad/s2", "", f"rotor {i}, acceleration") for i in range(1, 9)},
    **{f"command{i}": ("1", "", f"rotor {i}, commanded share of the motor output range") for i in range(1, 9)},
    **{f"w{i}_CMD": ("rad/s", "", f"rotor {i}, commanded speed") for i in range(1, 9)},
    **{
        f"a{axis}": ("m/s2", "body FRD", f"specific force along {word}")
        for axis, word in zip("xyz", ("x, forward", "y, right", "z, down"))
    },
    "p": ("rad/s", "body FRD", "roll rate"),
    "q": ("rad/s", "body FRD", "pitch rate"),
    "r": ("rad/s", "body FRD", "yaw rate"),
    **{f"{axis}_dot": ("rad/s2", "body FRD", f"time derivative of {axis}") for axis in "pqr"},
    "roll": ("rad", "body to earth, 3-2-1", "roll angle"),
    "pitch": ("rad", "body to earth, 3-2-1", "pitch angle"),
    "yaw": ("rad", "body to earth, 3-2-1", "yaw angle"),
    "x": ("m", "earth NED", "position north/forward"),
    "y": ("m", "earth NED", "position east/right"),
    "z": ("m", "earth NED", "position down"),
    "vx": ("m/s", "earth NED", "velocity north/forward, over ground"),
    "vy": ("m/s", "earth NED", "velocity east/right, over ground"),
    "vz": ("m/s", "earth NED", "velocity down, over ground"),
    "u": ("m/s", "body FRD", "velocity forward, over ground"),
    "v": ("m/s", "body FRD", "velocity right, over ground"),
    "w": ("m/s", "body FRD", "velocity down, over ground"),
    "u_air": ("m/s", "body FRD", "velocity forward, through the air"),
    "v_air": ("m/s", "body FRD", "velocity right, through the air"),
    "w_air": ("m/s", "body FRD", "velocity down, through the air"),
    "wind_north": ("m/s", "earth NED", "velocity of the air north/forward, over ground"),
    "wind_east": ("m/s", "earth NED", "velocity of the air east/right, over ground"),
    "wind_down": ("m/s", "earth NED", "velocity of the air down, over ground"),
    "Fx": ("N", "body FRD", "force along x"),
    "Fy": ("N", "body FRD", "force along y"),
    "Fz": ("N", "body FRD", "force along z"),
    "Mx": ("N m", "body FRD", "moment about x"),
    "My": ("N m", "body FRD", "moment about y"),
    "Mz": ("N m", "body FRD", "moment about z"),
    "v_in": ("m/s", "", "induced velocity"),
    "battery_voltage": ("V", "", "battery voltage"),
    "battery_current": ("A", "", "battery current"),
    "throttle": ("1", "", "throttle"),
    "setpoint_p": ("rad/s", "body FRD", "roll rate asked for"),
    "setpoint_q": ("rad/s", "body FRD", "pitch rate asked for"),
    "setpoint_r": ("rad/s", "body FRD", "yaw rate asked for"),
    "attitude_sample": ("1", "", "1 where an attitude was measured within half a step, else interpolated"),
    "position_sample": ("1", "", "1 where a position was measured within half a step, else interpolated"),
    "velocity_sample": ("1", "", "1 where a velocity follows from a measurement within half a step, else interpolated"),
    "onboard_valid": ("1", "", "0 inside spans that the on-board log lost"),
    "imu_clipped": ("1", "", "1 where gyro or accelerometer was clipped"),
    "onboard_roll": ("rad", "body to earth, 3-2-1", "roll angle of the on-board attitude"),
    "onboard_pitch": ("rad", "body to earth, 3-2-1", "pitch angle of the on-board attitude"),
    "onboard_yaw": ("rad", "body to earth, 3-2-1", "yaw angle of the on-board attitude, tied to the capture"),
    "in_flight": ("1", "", "1 between take-off and landing, else 0"),
    "valid": ("1", "", "1 where a row may be used for identification, else 0"),
    # kept where rotor speeds are to be estimated from commands (quasi.terms.rotor_map): no low-pass
    **{f"command{i}_raw": ("1", "", f"rotor {i}, commanded share, before the low-pass") for i in range(1, 9)},
    **{f"w{i}_CMD_raw": ("rad/s", "", f"rotor {i}, commanded speed, before the low-pass") for i in range(1, 9)},
    **{f"{n}_raw": ("rad/s", "body FRD", f"{n} before the low-pass, bias removed") for n in "pqr"},
    **{f"a{n}_raw": ("m/s2", "body FRD", f"specific force along {n} before the low-pass, bias removed") for n in "xyz"},
}

_MADE = b"quasi"
UNPACK_STEP = 1 << 20  # bytes that are unpacked at a time
SHORTEN = "cut it into shorter recordings, or keep only what is used"
ANY_PREFIX = "any of "  # before an axis: the row of a coverage table for all variables of the axis
# of a delay in a model; otherwise it may include the delay of logged rotor speeds
TELEMETRY_AGE_REMOVED = "telemetry age taken off"
IDENTIFIED_MAP = "map identified on the flight"  # source of w1_CMD .. in the metadata of an import


@contextmanager
def replace_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path that replaces `path` when the block succeeds and is removed otherwise."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        with temporary.open("rb") as written:  # on the disk before the name: a power cut leaves the old or the new file
            os.fsync(written.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def copy_file(source: str | Path, path: str | Path) -> None:
    """Copy a readable table or JSON document. Raises ReadError naming the source where it is damaged."""
    _ = read_table(source) if str(source).endswith(".parquet") else read_json(source)
    with replace_file(path) as temporary:
        shutil.copyfile(source, temporary)


def write_table(
    path: str | Path,
    frame: "pd.DataFrame",
    units: Mapping[str, tuple[str, str] | tuple[str, str, str]] | None = None,
    made: Mapping[str, Any] | None = None,
) -> None:
    """Write columns as Parquet with unit, frame and meaning on each field.

    frame  one column per quantity; units  {column: (unit, frame[, meaning])} for columns outside COLUMNS;
    made   how the table was made (plain data), stored in the file's metadata.
    Raises DataError for a column without a known unit.
    """
    import pyarrow.parquet

    units = dict(units or {})
    fields, arrays = [], []
    for name in frame.columns:
        about = units.get(name, COLUMNS.get(name))
        if about is None:
            raise DataError(f"column '{name}' of {path} has no unit; name it in `units`")
        array = pyarrow.array(frame[name].to_numpy())
        about = {"unit": about[0], "frame": about[1], "meaning": about[2] if len(about) > 2 else ""}
        fields.append(pyarrow.field(name, array.type, metadata={k: v for k, v in about.items() if v}))
        arrays.append(array)
    schema = pyarrow.schema(fields, metadata={_MADE: _dumps(dict(made or {})).encode()})
    with replace_file(path) as part:
        # measured values hardly repeat: a dictionary makes writing four times as long and files a quarter larger; their
        # first bytes do, so bytes of one place stand together: reading takes half the time, files are a sixth smaller
        measured = [field.name for field in fields if pyarrow.types.is_floating(field.type)]
        repeating = [field.name for field in fields if field.name not in measured]
        table = pyarrow.Table.from_arrays(arrays, schema=schema)
        pyarrow.parquet.write_table(
            table, part, compression="zstd", use_dictionary=repeating, use_byte_stream_split=measured
        )


def read_table(path: str | Path, columns: Sequence[str] | None = None) -> "pd.DataFrame":
    """Read a Parquet table; `columns` limits what is read. Raises ReadError or DataError naming file and column."""
    import pyarrow.parquet

    path = Path(path)
    try:
        with pyarrow.parquet.ParquetFile(path) as source:
            names = source.schema_arrow.names
            missing = [c for c in columns or () if c not in names]
            if missing:
                raise DataError(f"{path} has no column '{missing[0]}'{nearest(missing[0], names)}")
            _check_unpacked_size(path, source, columns)
            found = source.read(columns=list(columns) if columns is not None else None)
            # the index metadata of pandas may be damaged and is not needed
            return found.to_pandas(ignore_metadata=True)
    except FileNotFoundError:
        raise ReadError(f"{path} does not exist; make it first, or correct the path") from None
    except (DataError, ReadError):
        raise
    except (pyarrow.ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ReadError(
            f"{path} is not a readable Parquet file ({reason}); copy it anew, or, where a run made it, delete it and "
            "run again"
        ) from None


def _check_unpacked_size(path: Path, source: Any, columns: Sequence[str] | None) -> None:
    """Raise ReadError where the footer announces more than MAX_UNPACKED_BYTES for the columns that are read.

    A column of equal values has a few bytes in the file and 8 bytes per row in memory: the larger of both counts.
    """
    footer = source.metadata
    size = 0
    for k in range(footer.num_columns):
        name = footer.schema.column(k).path.partition(".")[0]
        if columns is None or name in columns:
            stored = sum(footer.row_group(g).column(k).total_uncompressed_size for g in range(footer.num_row_groups))
            size += max(stored, 8 * footer.num_rows)
    check_size(path, size, MAX_UNPACKED_BYTES, "the unpacked table", SHORTEN)


def read_numbers(path: str | Path) -> "pd.DataFrame":
    """Read a table of numbers: Parquet, or CSV (comma or semicolon) whose first line names the columns.

    Raises ReadError or DataError.
    """
    import pandas as pd

    path = Path(path)
    if path.suffix.lower() != ".csv":
        return read_table(path)
    try:
        text = read_table_text(path)
        head = text.partition("\n")[0]
        # spreadsheets write it so where the comma is the decimal sign
        marks = {"sep": ";", "decimal": ","} if ";" in head and "," not in head else {}
        table = pd.read_csv(io.StringIO(text), skipinitialspace=True, **marks)
    except ReadError:
        raise
    except (ValueError, pd.errors.ParserError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ReadError(f"{path} is not a readable CSV table ({reason}); correct it") from None
    table.columns = [str(name).strip() for name in table.columns]
    for name in table.columns:
        values = pd.to_numeric(table[name], errors="coerce")
        bad = np.flatnonzero(values.isna() & table[name].notna())
        if len(bad):
            lines = [n for n, line in enumerate(io.StringIO(text, newline=None), 1) if line.strip()]  # as pandas
            raise DataError(
                f"{path}, column '{name}', line {lines[bad[0] + 1]}: {str(table[name].iloc[bad[0]])[:40]!r} is no "
                "number; correct it"
            )
        table[name] = values
    return table


def read_fields(path: str | Path) -> dict[str, dict[str, str]]:
    """Read {column: {"unit", "frame", "meaning"}} of the Parquet fields."""
    import pyarrow.parquet

    schema = pyarrow.parquet.read_schema(path)
    return {f.name: {k.decode(): v.decode() for k, v in (f.metadata or {}).items()} for f in schema}


def read_made(path: str | Path) -> dict[str, Any]:
    """Read how a table was made, as given to `write_table`."""
    import pyarrow.parquet

    return json.loads((pyarrow.parquet.read_schema(path).metadata or {}).get(_MADE, b"{}"))


def list_recordings(flights: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, str]]:
    """List {flight: {"sha256", "log"}}, which identifies the recordings of filtered flights.

    flights  {key: how the filtered flight was made}; flights of imports without this record are omitted
    "sha256" is that of its on-board file, "log" the number of the log in it, "" for a file with one log
    """
    found = {}
    for key, made in flights.items():
        onboard = ((made.get("imported") or {}).get("sources") or {}).get("onboard") or {}
        if onboard.get("sha256"):
            found[key] = {"sha256": onboard["sha256"], "log": str(onboard.get("log") or "")}
    return found


def list_masses(flights: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """List {flight: mass of its processing, kg} of {key: how the filtered flight was made}, where it is recorded."""
    return {key: float(made["mass"]) for key, made in flights.items() if made.get("mass")}


def list_telemetry_corrections(flights: Mapping[str, Mapping[str, Any]]) -> dict[str, bool]:
    """List {flight: whether import removed the telemetry delay from its times}, of flights that record it.

    flights  {key: how the filtered flight was made}; flights of imports without this record are omitted
    """
    imported = {key: made.get("imported") or {} for key, made in flights.items()}
    return {k: bool((a["rotor telemetry"] or {}).get("applied")) for k, a in imported.items() if "rotor telemetry" in a}


def drop_identified_commands(table: "pd.DataFrame", imported: Mapping[str, Any] | None) -> "pd.DataFrame":
    """The flight without w1_CMD .. w4_CMD where import made them by a map identified on the flight itself.

    imported  metadata of the import. Such speeds are made from the flight's rotor speeds, so they cannot judge them.
    """
    made = (imported or {}).get("commanded speeds")
    if not isinstance(made, Mapping) or made.get("source") != IDENTIFIED_MAP:
        return table
    return table.drop(columns=[c for c in table if c.endswith("_CMD")])


def sha256_of(path: str | Path) -> str:
    """SHA-256 of a raw file, hexadecimal. Raises ReadError as `read_bytes`."""
    return hashlib.sha256(read_bytes(path)).hexdigest()


def _plain(value: Any) -> Any:
    """Plain JSON data: numpy becomes Python, NaN and infinities become null (JSON has no such numbers)."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple | set):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


def _dumps(document: Any, indent: int | None = None) -> str:
    return json.dumps(_plain(document), indent=indent, ensure_ascii=False, allow_nan=False)


def write_json(path: str | Path, document: Any) -> None:
    """Write plain data as JSON; NaN and infinities become null. Floats keep every digit."""
    with replace_file(path) as part:
        part.write_text(_dumps(document, indent=1) + "\n", encoding="utf-8")


def read_json(path: str | Path) -> Any:
    """Read JSON. Raises ConfigError naming file, line and column; a key that stands twice is an error.

    NaN and infinities are rejected: JSON has none, and they would pass every range check.
    """
    path = Path(path)
    text = read_text(path, MAX_JSON_BYTES)

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        seen: dict[str, Any] = {}
        for key, value in pairs:
            if key in seen:
                raise ConfigError(f"{path} names the key {quoted(key)} twice in one section; remove one")
            seen[key] = value
        return seen

    def finite(written: str) -> float:
        value = float(written) if len(written) < MAX_DIGITS else math.inf
        if not math.isfinite(value):
            raise ConfigError(f"{path} holds the number {written[:40]}, which is not finite; correct it")
        return int(written) if written.lstrip("-").isdigit() else value

    try:
        return json.loads(text, object_pairs_hook=unique, parse_float=finite, parse_int=finite, parse_constant=finite)
    except json.JSONDecodeError as error:
        raise ConfigError(
            f"{path} is not valid JSON at line {error.lineno}, column {error.colno} ({error.msg}); "
            "JSON has no comments, no trailing commas, and wants double quotes"
        ) from None
    except RecursionError:
        raise ConfigError(f"{path} is nested too deeply to be a configuration; correct it") from None


def read_text(path: str | Path, limit: int = MAX_UNPACKED_BYTES) -> str:
    """Read a text file, packed by gzip or not (UTF-8, with or without a byte order mark; UTF-16 with one;
    or Latin-1). limit  bytes that it may have, packed and unpacked."""
    data = read_unpacked(path, limit)
    try:
        if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return data.decode("utf-16")
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_table_text(path: str | Path) -> str:
    """Read the text of a table as `read_text`. Raises ReadError where a line is too long for a row."""
    check_lines(path, read_unpacked(path))
    return read_text(path)


def read_bytes(path: str | Path, limit: int = MAX_FILE_BYTES) -> bytes:
    """Read a raw file whole. Raises ReadError when it is absent, a folder, unreadable, empty or above `limit` bytes."""
    path = Path(path)
    try:
        check_size(path, path.stat().st_size, limit, "the file", SHORTEN)
        data = path.read_bytes()
    except FileNotFoundError:
        raise ReadError(
            f"{path} does not exist; correct the name or path in the logbook, or copy the file there"
        ) from None
    except ReadError:
        raise
    except ValueError:
        raise ReadError(f"{str(path)!r} is no path; correct it") from None
    except OSError as error:
        raise ReadError(
            f"{path} cannot be read ({error.strerror}); check that it is a file and its permissions"
        ) from None
    if not data:
        raise ReadError(f"{path} is empty (0 bytes); copy it from its source again")
    return data


def read_unpacked(path: str | Path, limit: int = MAX_UNPACKED_BYTES) -> bytes:
    """Read a raw file whole, and unpack it where gzip packed it.

    Raises ReadError where the packing is damaged, or the file has more than `limit` bytes, packed or unpacked.
    """
    data = read_bytes(path, limit)
    if not data.startswith(b"\x1f\x8b"):
        return data
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as packed:
            # the size at the end of a gzip file is modulo 4 GiB and of its last part: only unpacking shows the true one
            unpacked = bytearray()
            while len(unpacked) <= limit and (part := packed.read(UNPACK_STEP)):
                unpacked += part
    except (OSError, EOFError, zlib.error) as error:
        raise ReadError(
            f"{path} is packed by gzip, but damaged ({str(error)[:80]}); copy it again, or unpack it and give the file "
            "in it"
        ) from None
    check_size(path, len(unpacked), limit, "the unpacked file", SHORTEN)
    return bytes(unpacked)


def read_head(path: str | Path, count: int) -> bytes:
    """Read the first bytes of a file, fewer for a shorter file, none for an unreadable one."""
    try:
        with Path(path).open("rb") as file:
            return file.read(count)
    except OSError:
        return b""


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write bytes atomically."""
    with replace_file(path) as part:
        part.write_bytes(data)


def write_text(path: str | Path, text: str) -> None:
    """Write text (UTF-8) atomically."""
    write_bytes(path, text.encode("utf-8"))


def fingerprint(document: Any) -> str:
    """Compute a short digest of plain data, equal for equal content."""
    return hashlib.sha256(json.dumps(_plain(document), sort_keys=True).encode()).hexdigest()[:16]
