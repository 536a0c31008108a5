"""Recordings that are the same by content: held out and trained, or in two rows."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from quasi.errors import ConfigError, QuasiError
from quasi.project.folder import is_file
from quasi.tables import sha256_of


def same_recordings(held: Mapping[str, list[str]], trained: Mapping[str, list[str]]) -> tuple[str, str] | None:
    """The first held-out flight whose recording also trained, by content, and that flight; None where there is none.

    held, trained  {"quadrotor/flight": [path of its on-board log, number of the log in it]}
    """
    return _first_alike(held, {flight: _content(*log) for flight, log in trained.items()})


def refuse_trained(asked: Mapping[str, Any], document: Mapping[str, Any], names: Mapping[str, str]) -> None:
    """Raise ConfigError where a held-out recording trained the model.

    asked  of `Folder.gap`; document  the model's; names  {"quadrotor/flight": its row}, for messages
    Recordings are compared by content. An older model without recordings is compared by flight keys, where the
    quadrotor's configuration has the same name. For a model of this folder the rows are known (`same_recordings`).
    """
    recordings = list_model_recordings(document)
    known = {key: (about["sha256"], str(about.get("log") or ""), "") for key, about in recordings.items()}
    head = f"{asked['file']}: held-out"
    if twice := _first_alike(asked["held"], known):
        raise ConfigError(
            f"{head} {names[twice[0]]} has the recording of flight {twice[1]}, which trained model {document['id']} by "
            "its model.json; hold out a flight that the model has never seen"
        )
    if not asked["put there"] or (document.get("airframe") or {}).get("name") != asked["quadrotor"]["file"]:
        return
    without_recording = set(_trained(document)) - set(recordings)
    for flight, key in asked["held keys"].items():
        if key in without_recording:
            raise ConfigError(
                f"{head} {names[flight]} is flight {key}, and a flight of that name trained model {document['id']}, "
                "whose model.json does not list recordings; hold out another one, or, if it is not that flight, give "
                "it a name of its own in the logbook's column 'Flight key'"
            )


def unchecked(asked: Mapping[str, Any], document: Mapping[str, Any]) -> list[str]:
    """A note where it cannot be known by content whether a held-out flight trained the model. Arguments as above."""
    trained, recordings = _trained(document), list_model_recordings(document)
    if not asked["put there"] or not asked["held"] or (trained and set(trained) <= set(recordings)):
        return []
    return [
        f"whether a held-out flight trained model {document['id']} could not be checked by content: its model.json "
        "does not list the recordings of all training flights; build it again where possible"
    ]


def _trained(document: Mapping[str, Any]) -> list[str]:
    """Keys of the training flights that a model.json names, as far as they can be used."""
    given = document.get("flights")
    named = given.get("training") if isinstance(given, Mapping) else None
    return [k for k in named if isinstance(k, str)] if isinstance(named, Sequence) else []


def list_model_recordings(document: Mapping[str, Any]) -> dict[str, Mapping[str, str]]:
    """List the usable flights and recordings of a model.json, which may come from anybody."""
    given = document.get("recordings")
    given = given if isinstance(given, Mapping) else {}
    return {k: about for k, about in given.items() if isinstance(about, Mapping) and about.get("sha256")}


def _first_alike(held: Mapping[str, list[str]], known: Mapping[str, tuple[str, ...]]) -> tuple[str, str] | None:
    for flight, log in held.items():
        content = _content(*log)
        for other, its in known.items():
            if _alike(content, its):
                return flight, other
    return None


def recorded_twice(flights: Mapping[str, list[str]]) -> tuple[str, str] | None:
    """The first two flights that have one recording, by content; None where all differ. flights  as above

    A file that is absent, to be made or empty is known by its path.
    """
    sizes = {path: Path(path).stat().st_size if is_file(Path(path)) else 0 for path, _ in flights.values()}
    often = Counter(sizes.values())
    # files of unlike sizes differ: only the others are read
    contents = {
        flight: _content(path, number) if sizes[path] and often[sizes[path]] > 1 else (path, _plain(number), path)
        for flight, (path, number) in flights.items()
    }
    groups, order = defaultdict(list), {flight: number for number, flight in enumerate(contents)}
    for flight, content in contents.items():
        groups[content[0]].append(flight)  # flights of unlike content are no pair, and there may be thousands
    pairs = (pair for group in groups.values() for pair in combinations(group, 2))
    found = [(a, b) for a, b in pairs if _alike(contents[a], contents[b])]
    return min(found, key=lambda pair: (order[pair[0]], order[pair[1]]), default=None)


def repeated_recordings(asked: Mapping[str, Any], names: Mapping[str, str]) -> list[str]:
    """Sentences on recordings that have two roles, by content, or that cannot be read.

    asked  "name", and of a gap "held", "trained" and "recordings", each {"quadrotor/flight": [path of its on-board log,
           number of the log in it]}; names  {"quadrotor/flight": its row}, for messages
    """
    try:
        trained = same_recordings(asked.get("held", {}), asked.get("trained", {}))
        twice = recorded_twice(asked.get("recordings", {}))
    except QuasiError as fault:
        return [str(fault)]
    sentences = []
    if trained:
        sentences.append(
            f"{asked['name']}: held-out {names[trained[0]]} has the recording of {names[trained[1]]}, which trained "
            "its model; hold out a flight that the model has never seen"
        )
    if twice:
        sentences.append(
            f"{asked['name']}: {names[twice[0]]} and {names[twice[1]]} have the same recording, but each flight counts "
            "once and has one role; leave one out, or give each its own 'Log number' if the file holds several logs"
        )
    return sentences


def _content(path: str, number: str) -> tuple[str, str, str]:
    return sha256_of(path), _plain(number), path


def _plain(number: str) -> str:
    """The number of a log without leading zeros; what is no number as it stands."""
    return number.lstrip("0") or number


def _alike(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
    """Whether two logs (content, number, path) may be one; without a number it is the longest of its file."""
    return one[0] == other[0] and (one[1] == other[1] or "" in (one[1], other[1]))
