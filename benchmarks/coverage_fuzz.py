"""Coverage-guided search of readers and parsers: inputs that reach new lines are kept and changed further.

    python benchmarks/coverage_fuzz.py NAME [--seconds 600] [--keep 20000]

NAME is a reader of `reader_inputs.py`, or one of the parsers: expression, logbook, json. Needs the package atheris
(`pip install atheris`, Linux), which is no dependency of quasi. The search begins with benchmarks/corpus/NAME and the
reader's own sound files. Inputs that reach new lines and have at most --keep bytes are added to that folder: commit the
ones worth keeping. Compiled kernels check their bounds, but atheris does not see their lines.
An error that is not quasi's own ends the search; atheris leaves the input in the working folder.
"""

import argparse
import contextlib
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CORPUS = ROOT / "benchmarks/corpus"
sys.path[:0] = [str(ROOT / "tests/unit"), str(ROOT / "benchmarks")]
PARSERS = ("expression", "logbook", "json")


def target_of(name: str, path: Path) -> Callable[[bytes], None]:
    """What reads one input; its own errors are suppressed, every other one ends the search."""
    from fuzz_readers import check
    from reader_inputs import READERS

    from quasi import tables
    from quasi.errors import QuasiError
    from quasi.project.logbook import read_logbook
    from quasi.terms.canonical import canonicalise
    from quasi.terms.expressions import parse, text

    def read(data: bytes) -> None:
        with contextlib.suppress(QuasiError):
            if name == "expression":
                tree = parse(data.decode("latin-1"))
                assert parse(text(tree)) == tree, "the canonical text is another expression"
                canonicalise(tree)
                return
            path.write_bytes(data)
            if name == "logbook":
                read_logbook(path)
            elif name == "json":
                tables.read_json(path)
            else:
                check(READERS[name][0](path))

    return read


def seeds_of(name: str) -> list[bytes]:
    """Sound inputs of a reader; parsers begin with the files of the corpus alone."""
    import numpy as np
    from reader_inputs import READERS

    return READERS[name][1](np.random.default_rng(0)) if name in READERS else []


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("name")
    arguments.add_argument("--seconds", type=int, default=600)
    arguments.add_argument("--keep", type=int, default=20_000, help="bytes of the largest input that is kept")
    given = arguments.parse_args()
    try:
        import atheris
    except ImportError:
        sys.exit("this search needs the package atheris; install it with `pip install atheris`, or use fuzz_readers.py")
    with atheris.instrument_imports(include=["quasi"]):
        import quasi.importing.onboard_log
        import quasi.project.logbook
        import quasi.terms.canonical  # noqa: F401
    kept = CORPUS / given.name
    kept.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        sound = Path(folder) / "sound"
        sound.mkdir()
        for k, data in enumerate(seeds_of(given.name)):
            (sound / str(k)).write_bytes(data)
        read = target_of(given.name, Path(folder) / "input.raw")
        options = [f"-max_total_time={given.seconds}", f"-max_len={given.keep}", "-timeout=60", "-rss_limit_mb=6000"]
        atheris.Setup([sys.argv[0], *options, str(kept), str(sound)], read)
        atheris.Fuzz()


if __name__ == "__main__":
    os.environ.setdefault("NUMBA_BOUNDSCHECK", "1")
    main()
