"""What a log format declares: the kinds of files that it reads, the flight controllers it serves, how it reads them."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from quasi.errors import ReadError
from quasi.importing.series import Recording

TEXT = "text"  # kind of a file that `quasi.project.recognition` finds no binary format in


@dataclass(frozen=True)
class Request:
    """One raw file to be read.

    controller     value of 'Flight controller' in lower case, for an on-board log
    quadrotor      its configuration; poles  magnets of a motor, or None where it does not say
    log_number     which log of a file that holds several, from 1, or None
    rigid_body     name of the vehicle in a capture, None for the only one
    marker_offset  (3,) m, of the marker centroid from the cg, body FRD
    remove_outliers  whether captured frames that no vehicle can fly become gaps
    """

    path: Path
    controller: str = ""
    quadrotor: Mapping[str, Any] = field(default_factory=dict)
    poles: int | None = None
    log_number: int | None = None
    rigid_body: str | None = ""
    marker_offset: np.ndarray | None = None
    remove_outliers: bool = True

    @classmethod
    def of_capture(
        cls, flight: Mapping[str, Any], marker_offset: np.ndarray | None = None, remove_outliers: bool = False
    ) -> "Request":
        """The request for the "capture" of a flight."""
        return cls(
            Path(flight["capture"]),
            rigid_body=str(flight.get("rigid body") or ""),
            marker_offset=marker_offset,
            remove_outliers=remove_outliers,
        )


@dataclass(frozen=True)
class Reader:
    """One format.

    name         of the format, for messages: "a PX4 ULog"
    kinds        of files by content, as `quasi.project.recognition` names them, or TEXT
    controllers  values of 'Flight controller' under which it reads on-board logs; none for a capture
    read         returns the Recording of a Request: series "onboard" (and "onboard ...", "capture"), or "capture"
                 alone; raises ReadError, DataError or ConfigError
    """

    name: str
    kinds: tuple[str, ...]
    read: Callable[[Request], Recording]
    controllers: tuple[str, ...] = ()


@contextmanager
def needs_extra(extra: str, path: Path, what: str) -> Iterator[None]:
    """Turn the absence of an optional package into a ReadError that names the command which installs it."""
    try:
        yield
    except ImportError as error:
        raise ReadError(
            f"{path} is {what}, which needs the package '{error.name}'; install it with pip install 'quasi[{extra}]'"
        ) from None
