"""Digest of the code a script reaches."""

import pytest

from quasi.running import provenance
from quasi.running.provenance import compute_code_digest, list_reached_files, save_parsed


@pytest.fixture
def house(tmp_path):
    files = {
        "quasi/__init__.py": '"""Package."""\n',
        "quasi/deep.py": "def f():\n    return 1\n",
        "quasi/room/__init__.py": "",
        "quasi/room/near.py": "import numpy\nfrom quasi.deep import f\n",
        "quasi/other.py": "x = 1\n",
        "scripts/a.py": "from quasi.room.near import f\n",
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


def forget():
    """As a new process begins."""
    for cached in ("compute_code_digest", "_list_imported_files", "_find_file", "_parse_file", "_read_parsed"):
        getattr(provenance, cached).cache_clear()
    provenance.PARSED.clear()
    provenance._NEW.clear()


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    yield tmp_path / provenance._parsed_cache().name
    forget()


def digest(house):
    forget()
    return compute_code_digest(house / "scripts/a.py", house)


def test_imports_are_followed_however_deep_with_their_packages(house):
    names = {str(p.relative_to(house)) for p in list_reached_files(house / "scripts/a.py", house)}
    expected = {"scripts/a.py", "quasi/__init__.py", "quasi/room/__init__.py", "quasi/room/near.py", "quasi/deep.py"}
    assert names == expected


def test_only_code_that_is_reached_changes_the_digest(house):
    before = digest(house)
    (house / "quasi/other.py").write_text("x = 2\n")
    assert digest(house) == before
    (house / "quasi/deep.py").write_text('# why\ndef f():\n    """Say one."""\n    return 1\n')
    assert digest(house) == before, "comments and docstrings do not count"
    (house / "quasi/deep.py").write_text("def f():\n    return 2\n")
    assert digest(house) != before


def test_a_file_is_parsed_once_for_all_runs_and_again_when_its_content_changes(house, own_cache, monkeypatch):
    first = digest(house)
    save_parsed()
    parsed, parse = [], provenance._parse
    monkeypatch.setattr(provenance, "_parse", lambda content, path: parsed.append(path.name) or parse(content, path))
    assert digest(house) == first and not parsed
    (house / "quasi/deep.py").write_text("def f():\n    return 3\n")
    assert digest(house) != first and parsed == ["deep.py"]
    save_parsed()
    (house / "quasi/deep.py").write_text("def f():\n    return 1\n")
    assert digest(house) == first and parsed == ["deep.py"], "what was parsed before is kept"
    for damaged in ("{", "[]", '{"a": 1}'):
        own_cache.write_text(damaged)
        assert digest(house) == first
    assert parsed.count("a.py") == 3
