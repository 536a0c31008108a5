"""The documentation: its words, its sentences' length, its links, and tables that equal their files."""

import re
from pathlib import Path

import measured_table
import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*(ROOT / "docs").glob("*.md"), *ROOT.glob("*.md"), *(ROOT / "examples").rglob("*.md")])
NAMED = pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
WORDS = re.compile(r"\b(told|tells?|beside|said|mend(?:ed|s)?|untold|whereabouts)\b", re.I)
LONGEST_SENTENCE = 25  # words, by the rules of the house
LONGEST_PAGE = 2000  # words, likewise
# a catalogue of 45 entries; a list of every corrected error; all requirements of a name, in tables
LONG_PAGES = {"causes.md", "differences-from-quasi.md", "gaps.md"}


def read(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def prose(text: str) -> str:
    """Paragraphs and lists alone: no code, tables, quotations, pictures; a word for each piece of code or link."""
    text = re.sub(r"```.*?```", "\n", text, flags=re.S)
    text = re.sub(r"!\[.*?\]\(.*?\)", "", text, flags=re.S)
    lines = [line for line in text.splitlines() if not re.match(r"\s*\||>|    \S|<!--|#", line)]
    text = re.sub(r"`[^`]+`", "code", "\n".join(lines))
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)


def sentences(text: str) -> list[str]:
    text = re.sub(r"\n\s*(?:[-*]|\d+\.)\s", "\n\n", prose(text))
    found = []
    for paragraph in re.split(r"\n\s*\n", text):
        joined = re.sub(r"\s+", " ", paragraph).strip()
        found += re.split(r"(?<=[.:;!?])\s+(?=\S)", joined)
    return [s for s in found if s]


@NAMED
def test_no_word_of_the_old_dialect(page):
    assert not WORDS.findall(re.sub(r"`[^`]*`|```.*?```", "", read(page), flags=re.S))


@pytest.mark.parametrize("folder", ["scripts", "rules", "config", "examples", "profiles"])
def test_no_word_of_the_old_dialect_around_the_library(folder):
    endings = {".py", ".smk", ".json", ".yaml", ".csv", ".md"}
    made = {"results", "models", "logs", ".snakemake"}  # of runs in a folder of examples
    files = [p for p in (ROOT / folder).rglob("*") if p.suffix in endings]
    files = [p for p in files if not made & set(p.relative_to(ROOT / folder).parts[1:2])]
    found = {str(p): words for p in files if (words := WORDS.findall(read(p)))}
    assert files and not found


@NAMED
def test_sentences_are_short(page):
    long = [s for s in sentences(read(page)) if len(re.findall(r"[\w'.%/-]*\w[\w'.%/-]*", s)) > LONGEST_SENTENCE]
    assert not long


@NAMED
def test_pages_are_short(page):
    assert page.name in LONG_PAGES or len(re.findall(r"\S*\w\S*", read(page))) <= LONGEST_PAGE


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as GitHub and mkdocs make them."""
    found = set()
    for title in re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", read(page), flags=re.S), flags=re.M):
        found.add(re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-"))
    return found


@NAMED
def test_every_link_leads_somewhere(page):
    text = re.sub(r"```.*?```", "", read(page), flags=re.S)
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith("http"):
            continue
        path, _, anchor = target.partition("#")
        goal = (page.parent / path).resolve() if path else page
        if not goal.exists() or (anchor and anchor not in anchors(goal)):
            broken.append(target)
    assert not broken


def test_every_page_is_in_the_navigation_and_every_picture_on_a_page():
    nav = read(ROOT / "mkdocs.yml")
    assert {p.name for p in (ROOT / "docs").glob("*.md")} <= set(re.findall(r": ([\w-]+\.md)", nav))
    used = set(re.findall(r"images/([\w.-]+)", "".join(map(read, PAGES))))
    assert used == {p.name for p in (ROOT / "docs/images").iterdir()}


def test_the_readme_is_one_sitting():
    text = read(ROOT / "README.md")
    assert len(text.splitlines()) <= 120
    assert text.count("![") == 1


@pytest.mark.parametrize("page", measured_table.PAGES)
def test_tables_of_figures_equal_their_files(page):
    text = read(ROOT / page)
    assert text.count("<!-- table ") >= 1
    assert measured_table.rendered(text) == text, "run python benchmarks/measured_table.py"


def test_every_measured_row_states_when_where_and_by_what():
    for document in measured_table.documents():
        assert document["schema"] == "quasi.measured/1"
        for row in document.get("rows", [document]):
            assert re.fullmatch(r"\d{4}-\d\d-\d\d", row["date"])
            assert re.fullmatch(r"[0-9a-f]{7,}", row["commit"]) and row["machine"]
        program = re.match(r"`(\w+\.py)", document["program"])
        assert not program or (ROOT / "benchmarks" / program[1]).is_file()


def test_figures_are_filled_with_their_values():
    assert measured_table.fill("{a, s*1e3:.1f} ms of {n}", {"a, s": 0.0221, "n": 4}) == "22.1 ms of 4"
    with pytest.raises(KeyError):
        measured_table.fill("{missing}", {})


def test_recording_changes_the_rows_that_use_a_value_alone(tmp_path, monkeypatch):
    row = {"order": 1, "what": "a", "figure": "{s:.1f} s", "date": "2000-01-01", "commit": "0000000", "machine": "m"}
    monkeypatch.setattr(measured_table, "RESULTS", tmp_path)
    other = row | {"values": {"other": 1.0}}
    document = {"schema": "quasi.measured/1", "program": "`a.py`", "rows": [row | {"values": {"s": 1.0}}, other]}
    measured_table.write_json(tmp_path / "a.json", document)
    measured_table.record("a", {"s": 2.5, "not in the table": 3.0})
    first, second = measured_table.read_json(tmp_path / "a.json")["rows"]
    assert first["values"] == {"s": 2.5} and first["date"] > "2020"
    assert second == other
