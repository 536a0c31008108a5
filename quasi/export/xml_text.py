"""XML of simulator files: numbers as text, comments that cannot end early, elements read back."""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Sequence
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from quasi.errors import DataError

# control characters, half pairs and non-characters (XML 1.0, production 2)
_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def number(value: float) -> str:
    """Nine significant digits, which a float32 reader and the check both accept."""
    return f"{float(value) + 0.0:.9g}"  # the sum turns -0 into 0


def numbers(values: Iterable[float]) -> str:
    """Numbers with spaces between."""
    return " ".join(number(v) for v in np.ravel(list(values)))


def attribute(text: str) -> str:
    """Text as the value of an attribute, in quotes; characters that XML cannot hold become full stops."""
    return quoteattr(_FORBIDDEN.sub(".", text))


def comment(lines: Sequence[str]) -> list[str]:
    """Lines of one comment; of hyphens in a row, which would end it, each gets a space."""
    safe = [re.sub(r"-(?=-)", "- ", escape(_FORBIDDEN.sub(".", line))) for line in lines]
    return ["<!--", *(f"  {line}" for line in safe), "-->"]


def parsed(text: str, file: str) -> ElementTree.Element:
    """The root of a file that quasi wrote. Raises DataError where it is not well-formed."""
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise DataError(f"the exported {file} is not well-formed XML ({error}); please report this") from None


def inertia_of(element: ElementTree.Element) -> np.ndarray:
    """(3, 3) tensor of an <inertia> element with ixx ixy ixz iyy iyz izz as attributes (URDF) or children (SDF)."""

    def read(name: str) -> float:
        found = element.get(name)
        return float(element.findtext(name) if found is None else found)

    xx, xy, xz, yy, yz, zz = (read(f"i{n}") for n in ("xx", "xy", "xz", "yy", "yz", "zz"))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
