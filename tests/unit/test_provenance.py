"""Digest of the code a script reaches."""

import pytest

from quasi.running.provenance import compute_code_digest, list_reached_files


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


def digest(house):
    compute_code_digest.cache_clear()
    from quasi.running import provenance

    provenance._parse_file.cache_clear()
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
