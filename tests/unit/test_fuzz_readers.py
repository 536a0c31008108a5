"""A sample of what the fuzzer of the readers does: damaged files raise nothing but the readers' own error."""

import fuzz_readers as fuzzer
import numpy as np
import pytest

from quasi.errors import QuasiError


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
    inputs = 50 if name == "table" else 200  # a table takes 70 ms, a log of another format 10 ms
    assert fuzzer.fuzz(name, inputs, 7, 10.0), capsys.readouterr().out
    assert f"{inputs} inputs" in capsys.readouterr().out


@pytest.mark.parametrize("name", list(fuzzer.READERS))
def test_a_file_cut_at_any_byte_is_read_or_refused_in_one_sentence(tmp_path, name):
    read, seeds = fuzzer.READERS[name]
    content = seeds(np.random.default_rng(2))[0]
    path = tmp_path / "cut.raw"
    for cut in np.unique(np.linspace(0, len(content) - 1, 60).astype(int)):
        path.write_bytes(content[:cut])
        try:
            fuzzer.check(read(path))
        except QuasiError as error:
            assert "cut." in str(error)
            assert "\n" not in str(error)
            assert "Error" not in str(error)
