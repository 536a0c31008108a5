"""A sample of what the fuzzer of the readers does: damaged files raise nothing but the readers' own error."""

from pathlib import Path

import fuzz_readers as fuzzer
import numpy as np
import planted_faults
import pytest
from reader_round_trips import ROUND_TRIPS, round_trip

from quasi.errors import QuasiError
from quasi.importing import wind
from quasi.project.logbook import read_logbook
from quasi.tables import read_json
from quasi.terms.canonical import canonicalise
from quasi.terms.expressions import parse, text


@pytest.mark.parametrize("name", list(fuzzer.READERS))
def test_sound_files_are_read(tmp_path, name):
    read, seeds = fuzzer.READERS[name]
    for number, content in enumerate(seeds(np.random.default_rng(1))):
        path = tmp_path / f"{number}.raw"
        path.write_bytes(content)
        if name == "blackbox" and number == 2:
            with pytest.raises(QuasiError, match="5 logs, none with a readable frame"):
                read(path)
        else:
            fuzzer.check(read(path))


@pytest.mark.parametrize("name", list(fuzzer.READERS))
def test_damaged_files_raise_nothing_but_the_readers_own_error(tmp_path, name, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    inputs = 12 if name == "table" else 40  # a table takes 70 ms, a log of another format 10 ms
    assert fuzzer.fuzz(name, inputs, 7, 10.0), capsys.readouterr().out
    assert f"{inputs} inputs" in capsys.readouterr().out


@pytest.mark.parametrize("name", list(fuzzer.READERS))
def test_a_file_cut_at_any_byte_is_read_or_refused_in_one_sentence(tmp_path, name):
    read, seeds = fuzzer.READERS[name]
    content = seeds(np.random.default_rng(2))[0]
    path = tmp_path / "cut.raw"
    for cut in np.unique(np.linspace(0, len(content) - 1, 15).astype(int)):
        path.write_bytes(content[:cut])
        try:
            fuzzer.check(read(path))
        except QuasiError as error:
            assert "cut." in str(error)
            assert "\n" not in str(error)
            assert "Error" not in str(error)


@pytest.mark.parametrize("name", list(fuzzer.READERS))
def test_what_a_writer_wrote_is_what_a_reader_yields(name):
    assert set(ROUND_TRIPS) == set(fuzzer.READERS)
    for seed in range(2):
        round_trip(name, np.random.default_rng(seed))


@pytest.mark.parametrize("cut", [slice(1, None), slice(None, -1), slice(None, None, -1)])
def test_a_sample_that_is_lost_or_moved_is_seen(monkeypatch, cut):
    sound = wind._samples
    monkeypatch.setattr(wind, "_samples", lambda *given: tuple(part[cut] for part in sound(*given)))
    with pytest.raises(AssertionError):
        round_trip("lvm", np.random.default_rng(0))


@pytest.mark.parametrize("fault", planted_faults.FAULTS, ids=lambda fault: fault.name)
def test_the_text_of_a_planted_fault_stands_once_in_its_file(fault):
    source = (planted_faults.ROOT / fault.file).read_text(encoding="utf-8")
    assert source.count(fault.sound) == 1 and fault.reader in fuzzer.READERS
    compile(source.replace(fault.sound, fault.faulty), fault.file, "exec")


def test_the_corpus_of_the_parsers_raises_nothing_but_their_own_errors():
    corpus = sorted((Path(planted_faults.ROOT) / "benchmarks/corpus").glob("*/*"))
    readers = {"json": read_json, "logbook": read_logbook}
    read = 0
    for path in corpus:
        assert path.stat().st_size < 20_000
        try:
            if path.parent.name == "expression":
                tree = parse(path.read_bytes().decode("latin-1"))
                canonicalise(tree)
                assert parse(text(tree)) == tree
            else:
                readers[path.parent.name](path)
            read += 1
        except QuasiError as error:
            assert str(error).replace("\t", " ").replace("\n", " ").isprintable()
    assert read >= 3
