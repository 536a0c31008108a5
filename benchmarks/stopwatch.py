"""How long a piece of work takes at best."""

import time
from collections.abc import Callable


def best(work: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Least time of some runs, s; the first, which may compile, does not count."""
    work()
    found = []
    for _ in range(repeats):
        begin = clock()
        work()
        found.append(clock() - begin)
    return min(found)
