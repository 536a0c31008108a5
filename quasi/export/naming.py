"""Names and text of a model as another language takes them: nothing in a model can leave its place in made source.

A name becomes an identifier by a reversible map: letters, digits and _ stay, any other character becomes _xHH.., the
hexadecimal digits of its code; an _ that would read as such a mark is marked itself. `name_of` gives the name back.
"""

import re

from quasi.terms.kernel import INPUTS

_MARK = re.compile(r"_x([0-9a-f]{2,6})_")


def identifier(name: str, prefix: str = "") -> str:
    """Legal identifier (letters, digits, _) for a name: `prefix`, which begins with a letter, and the mapped name.

    "HDBeetle-14" gives "HDBeetle_x2d_14", "my_model" stays. With a prefix it is no keyword of any language and does not
    begin with a digit.
    """
    marked = re.sub(r"_(?=x[0-9a-f])", "_x5f_", name)
    return prefix + re.sub(r"[^A-Za-z0-9_]", lambda found: f"_x{ord(found.group()):02x}_", marked)


def local(name: str) -> str:
    """Identifier of an input inside a function."""
    return name if name in INPUTS else identifier(name, "extra_")


def name_of(mapped: str, prefix: str = "") -> str:
    """The name that `identifier` was given."""
    return _MARK.sub(lambda found: chr(int(found.group(1), 16)), mapped.removeprefix(prefix))


def shown(text: str, most: int = 200) -> str:
    """Text for a comment or a string of made source: one line of harmless characters, others as a full stop.

    Without quotes, backslashes, percent signs, question marks and line breaks, and without the marks that end a comment
    in C, Python or MATLAB, it stays inside whatever it is written into.
    """
    plain = re.sub(r"[^A-Za-z0-9 _.,:;()\[\]|^*/+=<>-]", ".", " ".join(str(text).split()))
    plain = re.sub(r"/(?=[*/])", "/ ", re.sub(r"\*(?=/)", "* ", plain))
    return plain if len(plain) <= most else f"{plain[: most - 3]}..."
