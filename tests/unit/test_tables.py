"""Files: units travel with columns, writes are whole or not at all, faults are sentences."""

import numpy as np
import pandas as pd
import pytest

from quasi.errors import ConfigError, DataError, ReadError
from quasi.tables import (
    copy_file,
    read_bytes,
    read_fields,
    read_json,
    read_made,
    read_numbers,
    read_table,
    read_text,
    write_json,
    write_table,
)


def test_table_comes_back_with_values_units_frames_and_how_it_was_made(tmp_path):
    frame = pd.DataFrame({"t": [0.0, 0.1], "w1": [1.0, np.nan], "extra": [3, 4]})
    write_table(tmp_path / "a.parquet", frame, {"extra": ("furlong", "moon")}, made={"rate": 10, "bad": np.nan})
    pd.testing.assert_frame_equal(read_table(tmp_path / "a.parquet"), frame)
    fields = read_fields(tmp_path / "a.parquet")
    assert fields["w1"]["unit"] == "rad/s"
    assert fields["extra"] == {"unit": "furlong", "frame": "moon"}
    assert read_made(tmp_path / "a.parquet") == {"rate": 10, "bad": None}


def test_column_without_a_unit_is_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(DataError, match="'mystery'.*no unit"):
        write_table(tmp_path / "a.parquet", pd.DataFrame({"mystery": [1.0]}))
    assert list(tmp_path.iterdir()) == []


def test_missing_column_names_the_nearest(tmp_path):
    write_table(tmp_path / "a.parquet", pd.DataFrame({"pitch": [1.0]}))
    with pytest.raises(DataError, match="no column 'pich' .did you mean 'pitch'"):
        read_table(tmp_path / "a.parquet", ["pich"])


def test_damaged_parquet_is_a_sentence(tmp_path):
    (tmp_path / "a.parquet").write_bytes(b"PAR1 not really")
    with pytest.raises(ReadError, match=r"a\.parquet is not a readable Parquet"):
        read_table(tmp_path / "a.parquet")


def test_write_that_fails_leaves_the_old_file_and_no_remains(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"a": 1})
    with pytest.raises(TypeError):
        write_json(path, {"a": object()})
    assert read_json(path) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_json_keeps_every_digit_and_turns_nan_into_null(tmp_path):
    value = 0.1 + 0.2
    write_json(tmp_path / "a.json", {"x": np.float64(value), "n": np.array([1.0, np.nan]), "i": np.int64(3)})
    assert read_json(tmp_path / "a.json") == {"x": value, "n": [1.0, None], "i": 3}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": 1,}', "line 1, column"),
        ('{"a": 1, "a": 2}', "'a' twice"),
        ("[" * 100_000, "nested too deeply"),
    ],
)
def test_faulty_json_is_a_sentence(tmp_path, text, message):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_json(tmp_path / "a.json")


def test_absent_empty_and_unreadable_files_are_sentences(tmp_path):
    (tmp_path / "empty.bbl").touch()
    for path, message in (("empty.bbl", "is empty"), ("no.bbl", "does not exist"), (".", "cannot be read")):
        with pytest.raises(ReadError, match=message):
            read_bytes(tmp_path / path)


def test_text_with_byte_order_mark_or_latin_letters_is_read(tmp_path):
    (tmp_path / "bom.csv").write_bytes(b"\xef\xbb\xbfTime")
    (tmp_path / "latin.csv").write_bytes("Größe".encode("latin-1"))
    assert read_text(tmp_path / "bom.csv") == "Time"
    assert read_text(tmp_path / "latin.csv") == "Größe"


@pytest.mark.parametrize("number", ["NaN", "-Infinity", "1e999", "9" * 400, "9" * 5000])
def test_json_number_that_is_not_finite_is_refused(tmp_path, number):
    (tmp_path / "a.json").write_text(f'{{"a": {number}}}')
    with pytest.raises(ConfigError, match="a.json holds the number .*not finite"):
        read_json(tmp_path / "a.json")
    (tmp_path / "a.json").write_text('{"a": [-3, 2.50, 12345678901234567890]}')
    assert repr(read_json(tmp_path / "a.json")["a"]) == "[-3, 2.5, 12345678901234567890]"


def test_name_that_no_path_can_have_is_a_sentence():
    with pytest.raises(ReadError, match="is no path"):
        read_bytes("a\0b")


def test_a_csv_as_spreadsheets_write_it_where_the_comma_is_the_decimal_sign_is_read(tmp_path):
    for text in ("t;x\n0;0,5\n1;-2\n", "t;x\n0;0.5\n1;-2\n", "t, x\n0, 0.5\n1, -2\n"):
        (tmp_path / "wind.csv").write_text(text)
        table = read_numbers(tmp_path / "wind.csv")
        assert list(table) == ["t", "x"] and table["x"].tolist() == [0.5, -2.0]
    (tmp_path / "wind.csv").write_text("t;x\n0;1\n1;calm\n")
    with pytest.raises(DataError, match="column 'x', line 3: 'calm' is no number"):
        read_numbers(tmp_path / "wind.csv")


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_empty_lines_count_in_the_line_of_a_fault(tmp_path, end):
    for text, line in (("t,speed\n\n\n0,1\n1,abc\n", 5), ("\nt,speed\n  \n0,abc\n\n", 4), ("t;x\n0;a\n", 2)):
        (tmp_path / "wind.csv").write_bytes(text.replace("\n", end).encode())
        with pytest.raises(DataError, match=f", line {line}: 'a"):
            read_numbers(tmp_path / "wind.csv")


def test_a_damaged_result_is_not_copied_on_and_is_named_itself(tmp_path):
    source, target = tmp_path / "filtered.parquet", tmp_path / "copy.parquet"
    write_table(source, pd.DataFrame({"t": np.arange(50.0)}))
    copy_file(source, target)
    assert target.read_bytes() == source.read_bytes()
    source.write_bytes(source.read_bytes()[:200])
    before = target.read_bytes()
    with pytest.raises(ReadError, match=r"filtered\.parquet is not a readable Parquet file .*delete it and run again"):
        copy_file(source, target)
    assert target.read_bytes() == before
