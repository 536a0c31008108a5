"""The logbook: rows, selections, keys, and faults by row and column."""

from pathlib import Path

import pytest

from quasi.errors import LogbookError
from quasi.project.logbook import NEEDED, OPTIONAL, describe_row, pick, read_logbook, select_rows

ROOT = Path(__file__).parents[2]
HEADER = [*NEEDED, "Mass", "Log number", "Flight key", "Comments"]


def write(path, *rows, header=HEADER, separator=","):
    lines = [separator.join(header)]
    for row in rows:
        lines.append(separator.join(str(row.get(c, "")) for c in header))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def flight(name, **cells):
    base = {"Quadrotor": "Beetle", "Onboard Name": name, "Flight controller": "BetaFlight", "OB Path": "data"}
    return {**base, "Drone Config File": "beetle", "Drone Config Path": "data", **cells}


def test_rows_are_numbered_as_a_spreadsheet_shows_them(tmp_path):
    book = read_logbook(write(tmp_path / "log.csv", flight("a"), {"Comments": "a pause"}, flight("b")))
    assert {n: r.key for n, r in book.items()} == {2: "a", 4: "b"}


def test_a_row_without_a_log_that_looks_like_a_flight_is_named(tmp_path):
    lost = [flight("", **{"Flight controller": ""}), {"Comments": "calm"}, flight("b"), flight(""), flight("")]
    path, notices = write(tmp_path / "log.csv", flight("a"), *lost), []
    assert {n: r.key for n, r in read_logbook(path, notices).items()} == {2: "a", 5: "b"}
    assert len(notices) == 1
    assert notices[0].startswith(f"{path}: rows 3, 6-7 have no 'Onboard Name' and are left out; fill it in")
    path, notices = write(tmp_path / "log.csv", flight("a"), {"Comments": "calm"}), []
    assert read_logbook(path, notices) and not notices


def test_a_flight_is_described_by_its_row_as_the_logbook_reads_now(tmp_path):
    path = write(tmp_path / "log.csv", flight("a"), flight("b", Comments="a gust", Mass=433))
    about = describe_row(path, "Beetle", "b")
    assert (about["path"], about["row"]) == (str(path), 3)
    assert about["cells"] == {"Log number": "", "Flight key": "", **flight("b", Comments="a gust", Mass="433")}
    write(path, flight("c"), flight("a"), flight("b", Comments="calm"))
    assert describe_row(path, "Beetle", "b")["row"] == 4
    assert describe_row(path, "Beetle", "b")["cells"]["Comments"] == "calm"
    with pytest.raises(LogbookError, match="Beetle/d"):
        describe_row(path, "Beetle", "d")


def test_row_selections_of_the_manual():
    assert select_rows([2, 3, 4, 5, 6, 8, 9, 10], "c") == select_rows(["2-6", "8-10"], "c")
    assert select_rows(["2-6", "8-10", 45], "c")[-1] == 45
    assert select_rows(["4", 4, "3-5"], "c") == [4, 3, 5]


@pytest.mark.parametrize("entry", ["a", "3-2", 1, 0, "2-", "2-1000000000", 2.5, True, "-3", None])
def test_what_is_not_a_row_is_refused(entry):
    with pytest.raises(LogbookError, match="config"):
        select_rows([entry], "config")


def test_row_outside_the_logbook_names_the_rows_that_exist(tmp_path):
    book = read_logbook(write(tmp_path / "log.csv", flight("a"), flight("b")))
    with pytest.raises(LogbookError, match=r"row 7 is selected, but data/log.csv has flights in rows 2-3"):
        pick(book, [2, 7], "config/models/x.json", "data/log.csv")


def test_missing_column_names_it_and_the_near_one(tmp_path):
    header = [c if c != "Onboard Name" else "Onbord Name" for c in HEADER]
    with pytest.raises(LogbookError, match="no column 'Onboard Name' .did you mean 'Onbord Name'"):
        read_logbook(write(tmp_path / "log.csv", header=header))


def test_a_selected_row_without_a_log_is_told_why_it_is_none(tmp_path):
    book = read_logbook(write(tmp_path / "log.csv", flight("a"), flight("")))
    with pytest.raises(LogbookError, match=r"row 3 is selected.*a row without 'Onboard Name' holds none"):
        pick(book, ["2-3"], "config/models/x.json", "data/log.csv")


@pytest.mark.parametrize("comment", ['"calm', '"calm" air'])
def test_a_quote_that_nothing_closes_swallows_no_rows(tmp_path, comment):
    rows = [flight("a"), flight("b", Comments=comment), flight("c"), flight("d")]
    with pytest.raises(LogbookError, match=r"log.csv row 3 is not CSV .*; close or remove a quote there"):
        read_logbook(write(tmp_path / "log.csv", *rows))
    book = read_logbook(write(tmp_path / "log.csv", flight("a", Comments='3" props'), flight("b")))
    assert book[2].cells["Comments"] == '3" props' and 3 in book


def test_a_row_of_more_cells_than_columns_is_a_fault_of_that_row_alone(tmp_path):
    book = read_logbook(write(tmp_path / "log.csv", flight("a"), flight("b", Comments="calm,cold")))
    assert "row 3 has 11 cells, but the first line names 10 columns; put a cell that holds ','" in book[3].problem
    assert book[2].problem is None


def test_two_rows_of_one_key_are_refused_and_flight_key_solves_it(tmp_path):
    with pytest.raises(LogbookError, match="rows 2 and 3 both mean flight 'a' of Beetle.*'Flight key'"):
        read_logbook(write(tmp_path / "log.csv", flight("a"), flight("a")))
    with pytest.raises(LogbookError, match="several logs, give each its own .*'Log number', else .* 'Flight key'"):
        read_logbook(write(tmp_path / "log.csv", flight("a"), flight("a")))
    book = read_logbook(write(tmp_path / "log.csv", flight("a"), flight("a", **{"Flight key": "a2"})))
    assert [r.key for r in book.values()] == ["a", "a2"]


def test_chosen_log_of_a_file_is_part_of_the_key(tmp_path):
    book = read_logbook(write(tmp_path / "log.csv", flight("a"), flight("a", **{"Log number": "2"})))
    assert [r.key for r in book.values()] == ["a", "a-2"]


@pytest.mark.parametrize("name", ["a b", "../a", ".a", "a/b", "ä"])
def test_name_that_cannot_be_a_file_is_a_fault_of_that_row_alone(tmp_path, name):
    book = read_logbook(write(tmp_path / "log.csv", flight(name), flight("good")))
    assert "row 2" in book[2].problem
    assert book[3].problem is None


@pytest.mark.parametrize(
    ("names", "keys"),
    [
        (["\u98db\u884c", "\u8a66\u9a13", "c"], ["_-row-2", "_-row-3", "c"]),
        (["a_b", "a b", "c d"], ["a_b", "a_b-row-3", "c_d"]),
        (["a b", "c"], ["a_b", "c"]),
    ],
)
def test_names_that_are_altered_alike_keep_their_rows_apart(tmp_path, names, keys):
    book = read_logbook(write(tmp_path / "log.csv", *[flight(name) for name in names]))
    assert [row.key for row in book.values()] == keys
    assert [bool(row.problem) for row in book.values()] == [not name.isascii() or " " in name for name in names]


def test_quadrotors_that_are_altered_alike_keep_their_rows_apart(tmp_path):
    rows = [flight("a", Quadrotor=name) for name in ("my quad", "my/quad", "my_quad")]
    book = read_logbook(write(tmp_path / "log.csv", *rows))
    assert [row.quadrotor for row in book.values()] == ["my_quad-row-2", "my_quad-row-3", "my_quad"]


def test_unknown_flight_controller_names_the_near_one(tmp_path):
    book = read_logbook(write(tmp_path / "log.csv", flight("a", **{"Flight controller": "betaflght"})))
    assert "did you mean 'betaflight'" in book[2].problem


def test_semicolons_quotes_and_comma_decimals_of_spreadsheets_are_read(tmp_path):
    path = write(tmp_path / "log.csv", flight("a", Mass="433,5", Comments='"wind; gusts"'), separator=";")
    row = read_logbook(path)[2]
    assert row.number_in("Mass") == 433.5
    assert row.cells["Comments"] == "wind; gusts"


@pytest.mark.parametrize("own", ["Ort, Datum", "Notes (a,b)", '"Ort, Datum, Zeit"', "a,b,c,d,e,f,g,h,i"])
@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_comma_in_the_name_of_a_column_is_no_separator(tmp_path, own, separator):
    path = write(tmp_path / "log.csv", {**flight("a"), own: "Delft"}, header=[own, *HEADER], separator=separator)
    row = read_logbook(path)[2]
    assert (row.key, row.cells[own.strip('"')]) == ("a", "Delft")


def test_a_quote_that_the_first_line_leaves_open_is_a_fault_of_the_logbook(tmp_path):
    path = write(tmp_path / "log.csv", *[flight(f"a{i}") for i in range(5000)], header=['"mine', *HEADER])
    with pytest.raises(LogbookError, match=r"log.csv row 1 is not CSV .*; close or remove a quote there"):
        read_logbook(path)


@pytest.mark.parametrize(("first", "separator"), [("sep=;", ";"), ("SEP=,", ","), ('"sep=;"', ";"), ("sep=;\r", ",")])
def test_the_line_that_names_the_separator_to_a_spreadsheet_is_no_header(tmp_path, first, separator):
    path = write(tmp_path / "log.csv", flight("a"), separator=separator)
    path.write_text(f"{first}\n{path.read_text()}")
    assert {n: r.key for n, r in read_logbook(path).items()} == {2: "a"}


def test_text_where_a_number_is_wanted_names_the_cell(tmp_path):
    row = read_logbook(write(tmp_path / "log.csv", flight("a", Mass="heavy")))[2]
    with pytest.raises(LogbookError, match="row 2: 'Mass' is 'heavy', expected a number"):
        row.number_in("Mass")


@pytest.mark.parametrize("name", ["Mass (grams)", "mass [g]", " MASS"])
def test_columns_are_known_however_letters_and_spaces_are_written(tmp_path, name):
    header = [{"Mass": name, "Onboard Name": "onboard  name", "Comments": "Weather"}.get(c, c) for c in HEADER]
    line = ["Beetle", "a", "raw", "betaflight", "beetle", "data", "433", "", "", "sunny"]
    path = tmp_path / "log.csv"
    path.write_text(",".join(header) + "\n" + ",".join(line) + "\n")
    row = read_logbook(path)[2]
    assert (row.key, row.number_in("Mass"), row.cells["Weather"]) == ("a", 433, "sunny")


def test_columns_that_state_a_unit_are_known_without_it(tmp_path):
    header = [*NEEDED, "Static wind", "Wind towards", "OptiTrack time offset"]
    units = ("Static wind (m/s)", "Wind towards (deg)", "OptiTrack time offset (s)")
    row = {"Static wind": "2.5", "Wind towards": "90", "OptiTrack time offset": "0.1"}
    found = read_logbook(write(tmp_path / "log.csv", {**flight("a"), **row}, header=header))[2]
    assert [found.number_in(column) for column in units] == [2.5, 90.0, 0.1]


@pytest.mark.parametrize(("word", "yes"), [("Y", True), ("x", True), ("n", False), ("", False), ("maybe", None)])
def test_a_word_that_is_neither_yes_nor_no_is_a_fault_of_its_row(tmp_path, word, yes):
    rows = flight("a", **{"Has OT data": word}), flight("b", **{"Has OT data": "N"})
    book = read_logbook(write(tmp_path / "log.csv", *rows, header=[*NEEDED, "Has OT data"]))
    assert book[3].problem is None
    if yes is None:
        assert "row 2: 'Has OT data' is 'maybe', expected Y or N" in book[2].problem
    else:
        assert book[2].problem is None and book[2].has("Has OT data") is yes


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Wind toward", "did you mean 'Wind towards"),
        ("Mass (kg)", "name it 'Mass' and write grams"),
        ("Fligth key", "did you mean 'Flight key'"),
        ("Has OT dat", "did"),
    ],
)
def test_column_whose_content_would_be_lost_by_its_spelling_is_refused(tmp_path, name, words):
    header = [c for c in HEADER if c not in ("Mass", "Flight key")] + [name]
    with pytest.raises(LogbookError, match=words):
        read_logbook(write(tmp_path / "log.csv", flight("a"), header=header))


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_every_way_a_spreadsheet_saves_text_is_read(tmp_path, separator, encoding):
    path = write(tmp_path / "log.csv", flight("a", Comments="caf\u00e9"), separator=separator)
    lines = [line + 3 * separator for line in path.read_text(encoding="utf-8").splitlines()]
    path.write_bytes("\r\n".join([*lines, "", 9 * separator, ""]).encode(encoding))
    rows = read_logbook(path)
    assert {n: (r.key, r.cells["Comments"]) for n, r in rows.items()} == {2: ("a", "caf\u00e9")}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"PK\3\4 workbook", "spreadsheet file"),
        (b"\nQuadrotor,Mass\n", "first line is empty"),
        (b",,,\n", "first line"),
    ],
)
def test_what_is_no_text_table_says_what_to_save(tmp_path, content, words):
    (tmp_path / "log.csv").write_bytes(content)
    with pytest.raises(LogbookError, match=words):
        read_logbook(tmp_path / "log.csv")


def test_the_laid_logbook_has_the_columns_that_tell_flights_of_one_file_apart():
    first = (ROOT / "config/template/data/logbook.csv").read_text().splitlines()[0].split(",")
    assert {*NEEDED, "Flight key", "Log number"} <= set(first) <= {*NEEDED, *OPTIONAL}


def test_ending_of_the_file_is_no_part_of_the_flights_name(tmp_path):
    rows = [flight(n) for n in ("a.bbl", "b.BFL", "c.v2.csv", "d.parquet", "e.1")]
    assert [r.key for r in read_logbook(write(tmp_path / "log.csv", *rows)).values()] == ["a", "b", "c.v2", "d", "e.1"]
    with pytest.raises(LogbookError, match="both mean flight 'a'"):
        read_logbook(write(tmp_path / "log.csv", flight("a"), flight("a.bbl")))
