"""Which runs work in a project folder: each leaves a card with its process while it is alive.

Snakemake locks the files of a run, but does not record whose lock it is. The cards say so.
"""

import getpass
import os
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil

from quasi.errors import QuasiError
from quasi.tables import read_json, write_json

CARDS = ".snakemake/quasi/runs"  # in the project folder
LOCKS = ".snakemake/locks"  # of Snakemake itself
ROUNDING = 1.0  # s between two readings of the same process' start: pids are reused, starts are not


def register(folder: str | Path, command: str) -> Path | None:
    """Leave a card of this process; None where nothing can be written. Cards of dead runs go once nothing is locked."""
    place = Path(folder) / CARDS / f"{socket.gethostname()}-{os.getpid()}.json"
    locks = Path(folder) / LOCKS
    for path, card in _cards(folder):
        if is_alive(card) is False and not (locks.is_dir() and any(locks.iterdir())):
            with suppress(OSError):
                path.unlink()
    card = {"pid": os.getpid(), "host": socket.gethostname(), "command": command, "at": time.time()}
    with suppress(KeyError, OSError, ImportError):  # no name is known for the user in some containers
        card["user"] = getpass.getuser()
    try:
        card["process started"] = psutil.Process().create_time()
        write_json(place, card)
    except (OSError, QuasiError, psutil.Error):
        return None
    return place


def withdraw(card: Path | None) -> None:
    """Remove the card of a run that ends."""
    if card is not None:
        with suppress(OSError):
            card.unlink(missing_ok=True)


def is_alive(card: dict[str, Any]) -> bool | None:
    """Whether the process of a card is still running; None for one of another computer, which cannot be asked."""
    if card.get("host") != socket.gethostname():
        return None
    try:
        return abs(psutil.Process(int(card["pid"])).create_time() - float(card["process started"])) < ROUNDING
    except (psutil.Error, KeyError, TypeError, ValueError):
        return False


def other_runs(folder: str | Path) -> list[dict[str, Any]]:
    """Cards of the other runs in a folder, alive or not, the newest first."""
    cards = [card for _, card in _cards(folder) if (card.get("host"), card.get("pid")) != _this_process()]
    return sorted(cards, key=lambda card: -float(card.get("at") or 0.0))


def remove_stale_lock(folder: str | Path) -> str | None:
    """Remove the lock of a run whose process is dead, and return the notice; None where no lock is removed.

    A lock stays while any recorded process lives, is of another computer, or where no process is recorded at all.
    Call it after `register`: of two runs that start together each then sees the other alive.
    """
    locks = [path for path in (Path(folder) / LOCKS).glob("*") if path.is_file()]
    runs = other_runs(folder)
    if not locks or not runs or any(is_alive(card) is not False for card in runs):
        return None
    for path in locks:
        path.unlink(missing_ok=True)
    return f"the lock of a dead run was removed ({_name(runs)}); what it left unfinished is made again"


def explain_lock(folder: str | Path, again: str) -> str:
    """Who holds the lock of a folder and what to do. again  command of this run's folder, such as `snakemake -d lab`"""
    runs = other_runs(folder)
    head = "this folder is locked"
    if alive := [card for card in runs if is_alive(card)]:
        return (
            f"{head}: another run is working in it, {_name(alive)}; wait for its end, or stop it with Ctrl-C where it "
            "runs, and start again"
        )
    if elsewhere := [card for card in runs if is_alive(card) is None]:
        return (
            f"{head}: a run on another computer holds it, {_name(elsewhere)}; wait for its end there; only if that "
            f"process no longer exists, remove the lock with `{again} --unlock`"
        )
    return (
        f"{head}, and no run is recorded that holds it: make sure that none is working in it, remove the lock with "
        f"`{again} --unlock` and start again"
    )


def refuse_unlocking(folder: str | Path) -> str | None:
    """A sentence where a live run works in the folder, whose lock must stay; None where there is none."""
    alive = [card for card in other_runs(folder) if is_alive(card)]
    if not alive:
        return None
    return f"the lock stays: a run is working in this folder, {_name(alive)}; wait for its end, or stop it with Ctrl-C"


def _this_process() -> tuple[str, int]:
    return socket.gethostname(), os.getpid()


def _cards(folder: str | Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    for path in sorted((Path(folder) / CARDS).glob("*.json")):
        with suppress(QuasiError, OSError):
            card = read_json(path)
            if isinstance(card, dict):
                yield path, card


def _name(cards: Sequence[dict[str, Any]]) -> str:
    """Process, user, computer, start and command of the first card, and how many more there are."""
    card = cards[0]
    since = time.strftime("%Y-%m-%d %H:%M", time.localtime(float(card.get("at") or 0.0)))
    who = f" of {card['user']}" if card.get("user") else ""
    more = f", and {len(cards) - 1} more" if len(cards) > 1 else ""
    return f"process {card.get('pid')}{who} on {card.get('host')} since {since} (`{card.get('command')}`){more}"
