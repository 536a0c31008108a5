"""How well do models of few flights do on other flights, by which rule their terms were chosen?

    python benchmarks/few_flights.py [--draws 12] [--flights 3 5 8 16]

Made flights of 30 s without hidden causes, sixteen to learn from and eight others to judge, as `hide_and_seek.py` has
them. Of each number of flights some draws are identified with the bundled example's settings, once as they are and once
by significance alone; printed are root mean square errors on the other flights as ratios of the two (geometric mean
over the draws, and the worst draw), and how many terms there are.
"""

import argparse
import os
from contextlib import contextmanager
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from hidden import LEARNED, REFERENCE, healthy, identified
from hide_and_seek import OUT, SAMPLING

from quasi.gap.flights.gathering import gather
from quasi.gap.flights.level import Flown
from quasi.model.model import AXES, Model


def main() -> None:
    """Identify, judge and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--flights", type=int, nargs="+", default=[3, 5, 8, 16])
    arguments = parser.parse_args()
    learned, others = ([healthy(OUT / "healthy", s)[1] for s in seeds] for seeds in (LEARNED, REFERENCE))
    print(f"{'flights':8s}{'':22s}" + "".join(f"{axis:>8s}" for axis in AXES))
    for count in arguments.flights:
        # of all flights there is one draw
        ratios, terms = zip(*(compared(learned, others, count, k) for k in range(arguments.draws if count < 16 else 1)))
        rows = {
            "error, of that before": np.exp(np.mean(np.log(ratios), axis=0)),
            "the same, worst draw": np.max(ratios, axis=0),
            "terms before": np.mean(terms, axis=0)[0],
            "terms": np.mean(terms, axis=0)[1],
        }
        for name, values in rows.items():
            print(f"{count:<8d}{name:22s}" + "".join(f"{v:8.2f}" for v in values), flush=True)


def compared(learned: list[Flown], others: list[Flown], count: int, draw: int) -> tuple[np.ndarray, np.ndarray]:
    """Ratios (6,) of the errors with and without the flights that are left out, and numbers of terms (2, 6)."""
    some = np.sort(np.random.default_rng([draw, 3]).choice(len(learned), count, replace=False))
    chosen = [learned[k] for k in some]
    with significance_alone():
        before = identified(chosen)
    models = [before, identified(chosen)]
    errors = [error(Model(document), others) for document in models]
    return errors[1] / errors[0], np.array([[len(d["axes"][a]["terms"]) for a in AXES] for d in models])


@contextmanager
def significance_alone():
    """Without the terms that left-out flights speak for."""
    with patch("quasi.identification.stepwise.LEAST", np.inf):
        yield


def error(model: Model, flights: list[Flown]) -> np.ndarray:
    """Root mean square (6,) of what a model leaves of the forces and moments of flights, each flight counted alike."""
    left = [gather(f.key, f.filtered, f.filtered_metadata, f.airframe, model, SAMPLING).residual for f in flights]
    return np.sqrt(np.mean([np.mean(rows**2, axis=0) for rows in left], axis=0))


if __name__ == "__main__":
    main()
