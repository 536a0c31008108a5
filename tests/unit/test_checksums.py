"""Files in the place of others are noticed whatever their time stamps; unchanged ones are not read again."""

import asyncio
import os
import shutil

import pytest

from quasi.errors import ReadError
from quasi.running import checksums
from quasi.running.checksums import Checksums, read_once
from quasi.tables import sha256_of


@pytest.fixture
def reads(monkeypatch):
    """Paths that were read for their checksum, in order."""
    done = []

    def counted(path):
        done.append(str(path))
        return sha256_of(path)

    monkeypatch.setattr(checksums, "sha256_of", counted)
    return done


def replace_by_move(new, old):
    new.replace(old)


def replace_by_copy(new, old):
    shutil.copy2(new, old)  # as cp -p, rsync -a and unzip do


@pytest.mark.parametrize("replace", [replace_by_move, replace_by_copy])
def test_an_older_file_of_the_same_size_in_the_place_of_another_is_noticed(tmp_path, replace):
    log, other, memory = tmp_path / "a.bbl", tmp_path / "b.bbl", tmp_path / "kept/checksums.json"
    log.write_bytes(b"one flight")
    other.write_bytes(b"an other 1")
    os.utime(other, (1e9, 1e9))
    kept = Checksums(memory)
    before = kept.compute(log)
    kept.save()
    expected = sha256_of(other)
    replace(other, log)
    assert log.stat().st_mtime == 1e9
    assert Checksums(memory).compute(log) == expected != before


def test_the_time_of_the_directory_entry_is_compared_where_size_and_time_of_content_agree(tmp_path):
    log, other, memory = tmp_path / "a.bbl", tmp_path / "b.bbl", tmp_path / "checksums.json"
    log.write_bytes(b"one flight")
    other.write_bytes(b"an other 1")
    for path in (log, other):
        os.utime(path, (1e9, 1e9))
    kept = Checksums(memory)
    before = kept.compute(log)
    kept.save()
    other.replace(log)
    assert Checksums(memory).compute(log) == sha256_of(log) != before


def test_an_unchanged_file_is_read_once_and_a_touched_one_keeps_its_checksum(tmp_path, reads):
    log, memory = tmp_path / "a.bbl", tmp_path / "checksums.json"
    log.write_bytes(b"one flight")
    kept = Checksums(memory)
    digest = kept.compute(log)
    assert kept.compute(log) == digest
    kept.save()
    assert Checksums(memory).compute_all([log]) == {str(log): digest}
    assert len(reads) == 1
    os.utime(log, (2e9, 2e9))
    assert Checksums(memory).compute(log) == digest
    assert len(reads) == 2


def test_absent_and_empty_files_have_no_checksum_and_a_damaged_memory_is_made_anew(tmp_path):
    memory = tmp_path / "checksums.json"
    (tmp_path / "empty").touch()
    memory.write_text('{"a": [1,')
    kept = Checksums(memory)
    assert kept.compute(tmp_path / "absent") is None
    assert kept.compute(tmp_path / "empty") is None
    kept.save()
    assert Checksums(memory).compute(tmp_path / "empty") is None


def test_snakemake_reads_an_unchanged_file_once(tmp_path):
    done = []

    class File:
        is_storage = False

        def __init__(self, path):
            self.file = str(path)

        async def checksum(self, threshold=None, force=False):
            done.append(self.file)
            return sha256_of(self.file)

    read_once(File)
    path = tmp_path / "flight.parquet"
    path.write_bytes(b"one flight")
    first = [asyncio.run(File(path).checksum(1000)) for _ in range(3)]
    assert first == [sha256_of(path)] * 3 and len(done) == 1
    asyncio.run(File(path).checksum(force=True))
    assert len(done) == 2
    path.write_bytes(b"an other 1")
    assert asyncio.run(File(path).checksum(1000)) == sha256_of(path) != first[0]
    path.unlink()
    with pytest.raises(ReadError):
        asyncio.run(File(path).checksum(1000))
