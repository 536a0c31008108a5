"""Costly inputs are refused by their size before they cost; what is too long in one row spoils that row alone."""

import gzip
import io
import time
import zipfile
import zlib

import numpy as np
import pandas as pd
import pytest

from quasi import input_limits, tables
from quasi.errors import ConfigError, ExpressionError, QuasiError, ReadError
from quasi.identification.candidates import read_specification
from quasi.importing.readers import mat5
from quasi.importing.readers.arrays import read_arrays
from quasi.importing.readers.table_text import open_table
from quasi.project.folder import read_settings
from quasi.project.logbook import NEEDED, VALID_NAME, pick, read_logbook, select_rows
from quasi.terms.canonical import canonicalise
from quasi.terms.expressions import parse

QUICK = 5.0  # s of processor time in which a refusal comes: what is refused here costs 10 s and more where it is read


@pytest.fixture(autouse=True)
def quick():
    start = time.process_time()
    yield
    assert time.process_time() - start < QUICK


def sums(count, size=3):
    names = ["u", "v", "w", "p", "q", "r", "w1", "w2", "w3", "w4"]
    return "*".join("(" + "+".join(names[(k + j) % 10] for j in range(size)) + ")" for k in range(count))


@pytest.mark.parametrize(
    "text", [sums(10), sums(40), sums(15, 2), "+".join(["u"] * 60_000), f"({sums(5)})^6", "u" * 200_000]
)
def test_an_expression_that_expands_to_too_many_terms_is_refused_at_once(text):
    with pytest.raises(ExpressionError, match=r"(terms when its brackets|characters, expected at most).*split it"):
        parse(text)


@pytest.mark.parametrize("text", [sums(8), "(u + v + w + p)^12", sums(40, 1), f"1/{sums(3)}", "(u+v)^0.5*(p+q)^40"])
def test_what_stays_below_the_limit_is_compared_at_once(text):
    assert canonicalise(parse(text))[1] == canonicalise(parse(f"2*({text})"))[1]


def test_a_pool_of_duplicates_is_refused_by_the_number_of_its_candidates():
    section = {"Fx": {"fixed": [], "candidates": [{"vars": ["u"] * 20, "degree": 20, "sets": [1]}]}}
    with pytest.raises(ConfigError, match="20 variables at degree 20"):
        read_specification(section, "Fx", "p.json")
    section["Fx"]["candidates"][0] |= {"degree": 10**12}
    with pytest.raises(ConfigError, match="lower 'degree'"):
        read_specification(section, "Fx", "p.json")


def zeros(path, size):
    """A sparse file: its size is stated, its content takes no place."""
    with path.open("wb") as file:
        file.truncate(size)
    return path


def test_files_are_refused_by_their_size_before_they_are_read(tmp_path):
    with pytest.raises(ReadError, match=r"log.bbl: the file has 5,000.0 MB, expected at most 4,000.0 MB"):
        tables.read_bytes(zeros(tmp_path / "log.bbl", 5_000_000_000))
    with pytest.raises(ReadError, match=r"c.json: the file has 200.0 MB"):
        tables.read_json(zeros(tmp_path / "c.json", 200_000_000))
    with pytest.raises(ReadError, match=r"l.csv: the file has 100.0 MB"):
        read_logbook(zeros(tmp_path / "l.csv", 100_000_000))
    (tmp_path / "config.yaml").write_text("a: " + "[" * 90_000)
    with pytest.raises(ConfigError, match="not valid YAML"):
        read_settings(tmp_path / "config.yaml")
    (tmp_path / "config.yaml").write_text("data: " + "9" * 5000)
    with pytest.raises(ConfigError, match=r"config.yaml"):
        read_settings(tmp_path / "config.yaml")


def test_what_unpacks_to_more_than_the_limit_is_refused(tmp_path, monkeypatch):
    packed = tmp_path / "a.csv.gz"
    packed.write_bytes(gzip.compress(bytes(5_000_000)) + gzip.compress(bytes(100)))
    with pytest.raises(ReadError, match=r"the unpacked file has .* MB, expected at most 1.0 MB"):
        tables.read_unpacked(packed, 1_000_000)
    assert len(tables.read_unpacked(packed, 6_000_000)) == 5_000_100
    for module in (tables, mat5):
        monkeypatch.setattr(module, "MAX_UNPACKED_BYTES", 1_000_000)
    monkeypatch.setattr("quasi.importing.readers.arrays.MAX_UNPACKED_BYTES", 1_000_000)
    table = tmp_path / "a.parquet"
    pd.DataFrame({"t": np.zeros(200_000), "u": np.arange(200_000.0)}).to_parquet(table)
    with pytest.raises(ReadError, match=r"a.parquet: the unpacked table has 3.5 MB"):
        tables.read_table(table)
    with pytest.raises(ReadError, match="unpacked table has 1.6 MB"):
        tables.read_table(table, ["t"])  # equal values: few bytes in the file
    archive = tmp_path / "a.npz"
    np.savez_compressed(archive, t=np.zeros(200_000))
    with pytest.raises(ReadError, match=r"a.npz: the unpacked archive has 1.6 MB"):
        read_arrays(archive, [])
    body = zlib.compress(bytes(2_000_000))
    element = (15).to_bytes(4, "little") + len(body).to_bytes(4, "little") + body
    (tmp_path / "a.mat").write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + element)
    with pytest.raises(ReadError, match=r"a.mat .*unpack to more than 1 MB"):
        read_arrays(tmp_path / "a.mat", [])


def test_an_archive_that_states_a_wrong_size_gives_no_more_than_it_states(tmp_path):
    path = tmp_path / "a.npz"
    buffer = io.BytesIO()
    np.save(buffer, np.arange(1000.0))
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("t.npy", buffer.getvalue()[:4000])
    with pytest.raises(ReadError, match=r"a.npz"):
        read_arrays(path, [])


@pytest.mark.parametrize("end", ["\n", "\r", "\r\n"])
def test_a_line_longer_than_any_row_is_refused_and_long_files_of_short_lines_are_read(tmp_path, end):
    long = tmp_path / "long.csv"
    long.write_text(f"t,u{end}0,1{end}1," + "9" * 1_500_000, newline="")
    with pytest.raises(ReadError, match=r"long.csv: line \d has more than 1,000,000 bytes"):
        open_table(long, [])
    with pytest.raises(ReadError, match=r"more than 1,000,000 bytes"):
        tables.read_numbers(long)
    text = f"0.25,1{end}" * 300_000
    short = tmp_path / "short.csv"
    short.write_text(f"t,u{end}{text}", newline="")
    assert input_limits.check_lines(short, short.read_bytes()) is None


def write_book(path, **cells):
    good = {"Quadrotor": "Q", "Onboard Name": "LOG1", "Flight controller": "betaflight", "Drone Config File": "Q.json"}
    header = [*NEEDED, "Log number", "Mass", "Comments"]
    lines = [header]
    for k, changed in enumerate(({}, cells, {})):
        row = {**good, "Onboard Name": f"LOG{k}", **changed}
        lines.append([row.get(c, "") for c in header])
    path.write_text("\n".join(",".join(line) for line in lines))
    return path


@pytest.mark.parametrize(
    "cells",
    [
        {"Comments": "x" * 1_000_000},
        {"Onboard Name": "x" * 1_000_000},
        {"Quadrotor": "x" * 101},
        {"Flight controller": "x" * 5000},
        {"Log number": "9" * 5000},
        {"Log number": "²"},
    ],
    ids=lambda c: next(iter(c)),
)
def test_a_cell_too_long_spoils_its_row_and_no_other(tmp_path, cells):
    found = read_logbook(write_book(tmp_path / "l.csv", **cells))
    assert [row.problem is None for row in found.values()] == [True, False, True]
    problem = found[3].problem
    assert "row 3" in problem and len(problem) < 600
    assert VALID_NAME.fullmatch(found[3].key) and VALID_NAME.fullmatch(found[3].quadrotor)


def test_a_number_of_5000_digits_is_refused_where_it_is_used(tmp_path):
    found = read_logbook(write_book(tmp_path / "l.csv", Mass="9" * 5000))
    with pytest.raises(QuasiError, match=r"row 3: 'Mass' is '9{40}\.\.\.'"):
        found[3].number_in("Mass")
    for rows in (["9" * 5000], [f"2-{'9' * 5000}"], ["²"]):
        with pytest.raises(QuasiError, match="is not a row") as error:
            select_rows(rows, "config")
        assert len(str(error.value)) < 300
    with pytest.raises(QuasiError, match="row 999999999"):
        pick(found, ["999999999"], "config", "l.csv")
    (tmp_path / "c.json").write_text('{"a": ' + "9" * 5000 + "}")
    with pytest.raises(ConfigError, match="not finite"):
        tables.read_json(tmp_path / "c.json")


def test_names_have_a_longest_length():
    assert VALID_NAME.fullmatch("a" * 100) and not VALID_NAME.fullmatch("a" * 101)


def test_two_long_names_that_begin_alike_are_two_flights(tmp_path):
    path = tmp_path / "l.csv"
    rows = [",".join(NEEDED), *(f"Q,{'x' * 300}{k},,betaflight,Q.json," for k in range(3))]
    path.write_text("\n".join(rows))
    assert len({row.key for row in read_logbook(path).values()}) == 3
