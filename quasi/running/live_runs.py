"""Live runs of a project folder: each run has a card with its process while it is alive.

Snakemake locks the files of a run but does not record which process holds the lock. The cards record it.
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

CARDS_FOLDER = ".snakemake/quasi/runs"  # in the project folder
LOCKS_FOLDER = ".snakemake/locks"  # of Snakemake itself
MAX_START_DIFFERENCE = 1.0  # s between two readings of one process' start time; pids are reused, start times are not


def register_run(folder: str | Path, command: str) -> Path | None:
    """Write a card of this process; None where that fails. Cards of dead runs are removed once nothing is locked."""
    place = Path(folder) / CARDS_FOLDER / f"{socket.gethostname()}-{os.getpid()}.json"
    locks = Path(folder) / LOCKS_FOLDER
    for path, card in _read_cards(folder):
        if is_alive(card) is False and not (locks.is_dir() and any(locks.iterdir())):
            with suppress(OSError):
                path.unlink()
    card = {"pid": os.getpid(), "host": socket.gethostname(), "command": command, "at": time.time()}
    with suppress(KeyError, OSError, ImportError):  # some containers have no user name
        card["user"] = getpass.getuser()
    try:
        card["process started"] = psutil.Process().create_time()
        write_json(place, card)
    except (OSError, QuasiError, psutil.Error):
        return None
    return place


def withdraw_card(card: Path | None) -> None:
    """Remove the card of a run that ends."""
    if card is not None:
        with suppress(OSError):
            card.unlink(missing_ok=True)


def is_alive(card: dict[str, Any]) -> bool | None:
    """Whether the process of a card is still running; None for a process of another computer."""
    if card.get("host") != socket.gethostname():
        return None
    try:
        return (
            abs(psutil.Process(int(card["pid"])).create_time() - float(card["process started"])) < MAX_START_DIFFERENCE
        )
    except (psutil.Error, KeyError, TypeError, ValueError):
        return False


def other_runs(folder: str | Path) -> list[dict[str, Any]]:
    """Cards of the other runs in a folder, alive or not, the newest first."""
    own = socket.gethostname(), os.getpid()
    cards = [card for _, card in _read_cards(folder) if (card.get("host"), card.get("pid")) != own]
    return sorted(cards, key=lambda card: -float(card.get("at") or 0.0))


def remove_stale_lock(folder: str | Path) -> str | None:
    """Remove the lock of a run whose process is dead, and return the notice; None where no lock is removed.

    A lock stays while any recorded process lives, is of another computer, or where no process is recorded at all.
    Call it after `register_run`: of two runs that start together each then sees the other alive.
    """
    locks = [path for path in (Path(folder) / LOCKS_FOLDER).glob("*") if path.is_file()]
    runs = other_runs(folder)
    if not locks or not runs or any(is_alive(card) is not False for card in runs):
        return None
    for path in locks:
        path.unlink(missing_ok=True)
    return f"the lock of a dead run was removed ({_describe_runs(runs)}); its unfinished jobs run again"


def explain_lock(folder: str | Path, again: str) -> str:
    """Explain who holds the lock of a folder and what to do.

    again  command for this folder, such as `snakemake -d lab`
    """
    runs = other_runs(folder)
    head = "this folder is locked"
    if alive := [card for card in runs if is_alive(card)]:
        return (
            f"{head}: another run is working in it, {_describe_runs(alive)}; wait for its end, or stop it "
            "with Ctrl-C where it runs, and start again"
        )
    if elsewhere := [card for card in runs if is_alive(card) is None]:
        return (
            f"{head}: a run on another computer holds it, {_describe_runs(elsewhere)}; wait for its end there; "
            f"only if that process no longer exists, remove the lock with `{again} --unlock`"
        )
    return (
        f"{head}, and no run is recorded that holds it: make sure that none is working in it, remove the lock with "
        f"`{again} --unlock` and start again"
    )


def refuse_unlocking(folder: str | Path) -> str | None:
    """Return a sentence where a live run works in the folder and its lock must stay; else None."""
    alive = [card for card in other_runs(folder) if is_alive(card)]
    if not alive:
        return None
    return (
        f"the lock stays: a run is working in this folder, {_describe_runs(alive)}; wait for its end, or stop it with "
        "Ctrl-C"
    )


def _read_cards(folder: str | Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    for path in sorted((Path(folder) / CARDS_FOLDER).glob("*.json")):
        with suppress(QuasiError, OSError):
            card = read_json(path)
            if isinstance(card, dict):
                yield path, card


def _describe_runs(cards: Sequence[dict[str, Any]]) -> str:
    """Describe the first card (process, user, computer, start, command) and count the others."""
    card = cards[0]
    since = time.strftime("%Y-%m-%d %H:%M", time.localtime(float(card.get("at") or 0.0)))
    who = f" of {card['user']}" if card.get("user") else ""
    more = f", and {len(cards) - 1} more" if len(cards) > 1 else ""
    return f"process {card.get('pid')}{who} on {card.get('host')} since {since} (`{card.get('command')}`){more}"
