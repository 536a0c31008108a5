"""Words of a dialect that no reader of the field knows stay out: their count in each room may only shrink."""

import re
import subprocess
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SUFFIXES = {".py", ".smk", ".md", ".json", ".js"}
# as words and as parts of names, such as recordings_told or beside_base
WORDS = r"told|tells?|untold|beside|said|whereabouts"
FOUND = re.compile(rf"(?<![A-Za-z])(?:{WORDS}|mend(?:s|ed|ing)?)(?![A-Za-z])", re.IGNORECASE)
EXEMPT = re.compile(r"null-1-told")  # the name of a data set
ALLOWED: dict[str, int] = {}


def room_of(path):
    parts = Path(path).parts
    if parts[0] != "quasi":
        return parts[0]
    return "/".join(parts[:2]) if len(parts) > 2 else "quasi"


def count_words():
    command = ["git", "ls-files", "quasi", "quasi_synthesis", "scripts", "rules", "docs"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    found = Counter()
    for path in listed.stdout.splitlines():
        if (ROOT / path).suffix not in SUFFIXES or "vendor" in path or not (ROOT / path).is_file():
            continue
        text = EXEMPT.sub("", (ROOT / path).read_text(encoding="utf-8"))
        found[room_of(path)] += len(FOUND.findall(text))
    return found


def test_the_words_of_the_dialect_only_become_fewer():
    if not (ROOT / ".git").exists():
        pytest.skip("no git repository: the files of the project are not known")
    found = count_words()
    grown = {room: f"{n}, allowed {ALLOWED.get(room, 0)}" for room, n in found.items() if n > ALLOWED.get(room, 0)}
    assert not grown, "say report, estimate, know, compare, next to or correct instead"


@pytest.mark.parametrize("text", ["is told here", "beside_base", "UNTOLD = 1", "he mends it", "`tell` the user"])
def test_the_check_finds_the_words(text):
    assert FOUND.search(text)


@pytest.mark.parametrize("text", ["besides", "intellect", "recommended", "amend", "foretold", "satellite"])
def test_the_check_leaves_other_words_alone(text):
    assert not FOUND.search(text)
