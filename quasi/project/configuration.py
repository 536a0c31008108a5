"""Configuration files: read, checked against a schema, defaults filled in, notices collected.

The schemas (config/schemas/*.schema.json) are the reference of every key: type, unit, range, default, one sentence.
Keys that begin with "//" are comments. A key marked "x-notice" in its schema is accepted for the sake of files written
for QuaSI, and the notice says what happens instead; NAME in it stands for the file's name. "x-switch" names the key
that a section needs before its other keys have an effect; a section without it gets a notice.
"""

import difflib
import functools
import json
import math
import operator
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jsonschema

from quasi.errors import ConfigError, nearest
from quasi.tables import read_json

SLIP = 0.87  # likeness from which an unknown key is a known one misspelt
SCHEMAS = Path(__file__).parents[2] / "config" / "schemas"

_WORDS = {
    "object": "a section { ... }",
    "array": "a list [ ... ]",
    "string": "text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "null": "null",
}


@functools.cache
def schema(name: str) -> dict[str, Any]:
    """The schema of a kind of configuration: "processing", "model", "quadrotor", "synthesis", "polynomials"."""
    path = SCHEMAS / f"{name}.schema.json"
    if not path.is_file():
        raise ConfigError(f"{path} is missing; quasi runs from its checkout, install it with `pip install -e .` there")
    return read_json(path)


def check(document: Any, name: str, where: str, *part: str) -> tuple[dict[str, Any], list[str]]:
    """Check a configuration and fill in its defaults.

    document  the file's content; name  its schema; where  its path, for messages; part  keys of the schema that lead
    to the rules of the document, where it is a section.
    Returns (document with defaults and without comments, notices). Raises ConfigError naming file and key.
    """
    rules = functools.reduce(operator.getitem, part, schema(name))
    try:
        document = _uncomment(document)
        errors = sorted(
            jsonschema.Draft202012Validator(rules).iter_errors(document),
            # a mistyped key is both unknown and missing: the unknown one names the remedy
            key=lambda e: (e.validator != "additionalProperties", len(e.absolute_path), str(e.message)),
        )
    except RecursionError:
        raise ConfigError(f"{where} is nested too deeply to be a configuration; correct it") from None
    if errors:
        raise ConfigError(_sentence(errors[0], where, whole=where if part else f"{where}: the file"))
    odd = _not_finite(document)
    if odd:
        raise ConfigError(f"{where}: {_place(odd[0])} is {odd[1]}, expected a finite number; correct it")
    for key in document:
        # keys of one's own are free, a slip of the pen would leave the default in force
        if key not in rules.get("properties", {}) and (meant := _slip(key, rules["properties"])):
            raise ConfigError(
                f"{where}: '{key}' is not a key of quasi (did you mean '{meant}'?); correct it, or give a key of your "
                "own another name"
            )
    notices = [
        f"{where}: '{key}' is not a key of quasi{near}"
        for key in document
        if key not in rules.get("properties", {}) and (near := nearest(key, rules["properties"])).endswith("?)")
    ]
    filled = _fill(document, rules, rules, where, notices)
    return filled, notices


def _slip(key: str, known: Iterable[str]) -> str | None:
    """The known key that another one is but a letter or two away from."""
    return next(iter(difflib.get_close_matches(key.lower(), list(known), n=1, cutoff=SLIP)), None)


def read(path: str | Path, name: str, where: str | None = None) -> tuple[dict[str, Any], list[str]]:
    """Read a configuration file and check it; see `check`."""
    return check(read_json(path), name, where or str(path))


def with_section(text: str, key: str, value: Mapping[str, Any]) -> str:
    """A configuration's text with one section put in or replaced; every other character stays.

    text  JSON, one object; key  of the section. New lines are indented as the first key of the file is.
    """
    decoder, space = json.JSONDecoder(), re.compile(r"[ \t\r\n]*")

    def skip(at: int) -> int:
        return space.match(text, at).end()

    begin = skip(text.startswith("\ufeff"))
    at, end = skip(begin + 1), begin + 1
    before = text[end:at]
    indent = before.rpartition("\n")[2] if "\n" in before else None
    found: tuple[int, int] | None = None
    while text[at] != "}":
        name, at = decoder.raw_decode(text, at)
        at = skip(skip(at) + 1)  # the colon
        _, end = decoder.raw_decode(text, at)
        if name == key:
            found = (at, end)
        at = skip(end)
        if text[at] == ",":
            at = skip(at + 1)
    if indent is None:
        written = json.dumps(value, ensure_ascii=False)
    else:
        newline = "\r\n" if "\r\n" in text else "\n"
        rows = ",\n".join(f"{indent * 2}{json.dumps(k)}: {json.dumps(v, ensure_ascii=False)}" for k, v in value.items())
        written = ("{\n" + rows + "\n" + indent + "}").replace("\n", newline)
    if found:
        return text[: found[0]] + written + text[found[1] :]
    comma = "," if end > begin + 1 else ""
    gap = " " if indent is None else newline + indent
    return f"{text[:end]}{comma}{gap}{json.dumps(key)}: {written}{text[end:]}"


def _uncomment(document: Any) -> Any:
    if isinstance(document, Mapping):
        return {k: _uncomment(v) for k, v in document.items() if not k.startswith("//")}
    if isinstance(document, list | tuple):
        return [_uncomment(v) for v in document]
    return document


def _not_finite(document: Any, path: tuple = ()) -> tuple[tuple, float] | None:
    """Place and value of the first number that is not finite: no file holds one, but settings made in Python may."""
    if isinstance(document, float):
        return None if math.isfinite(document) else (path, document)
    inside = document.items() if isinstance(document, Mapping) else ()
    inside = enumerate(document) if isinstance(document, list) else inside
    return next(filter(None, (_not_finite(value, (*path, key)) for key, value in inside)), None)


def _resolve(rules: Mapping[str, Any], root: Mapping[str, Any]) -> Mapping[str, Any]:
    reference = rules.get("$ref")
    if not reference:
        return rules
    target: Any = root
    for part in reference.removeprefix("#/").split("/"):
        target = target[part]
    return {**target, **{k: v for k, v in rules.items() if k != "$ref"}}


def _fill(document: Any, rules: Mapping[str, Any], root: Mapping[str, Any], where: str, notices: list[str]) -> Any:
    rules = _resolve(rules, root)
    if not isinstance(document, Mapping):
        return document
    filled = dict(document)
    for key, about in rules.get("properties", {}).items():
        about = _resolve(about, root)
        if key in filled:
            if "x-notice" in about:
                notice = about["x-notice"].replace("NAME", Path(where).stem)
                notices.append(f"{where}: '{key}' is accepted but not used: {notice}")
            switch = about.get("x-switch")
            if switch and isinstance(filled[key], Mapping) and filled[key] and switch not in filled[key]:
                given = next(iter(filled[key]))
                notices.append(
                    f"{where}: '{key}' gives '{given}' but not '{switch}', which is false by default: nothing fails; "
                    f"add \"{switch}\": true to '{key}', or remove the section"
                )
            filled[key] = _fill(filled[key], about, root, where, notices)
        elif "default" in about:
            default = about["default"]
            filled[key] = _fill(default, about, root, where, notices) if isinstance(default, Mapping) else default
    return filled


def _place(path: Any) -> str:
    return " / ".join(f"'{p}'" if isinstance(p, str) else f"entry {p + 1}" for p in path)


def _sentence(error: jsonschema.ValidationError, where: str, whole: str) -> str:
    place = _place(error.absolute_path)
    head = f"{where}: {place}" if place else whole
    if error.validator == "additionalProperties":
        known = error.schema.get("properties", {})
        patterns = error.schema.get("patternProperties", {})
        unknown = sorted(k for k in error.instance if k not in known and not any(re.search(p, k) for p in patterns))[0]
        inside = f" in {place}" if place else ""
        near = nearest(unknown, known)
        return f"{where}: unknown key '{unknown}'{inside}" + (near if near.endswith("?)") else f"{near}; remove it")
    if error.validator == "required":
        missing = next(k for k in error.validator_value if k not in error.instance)
        others = {k.lower(): k for k in error.instance if k not in error.schema.get("properties", {})}
        written = others.get(_slip(missing, others) or "")
        found = f", found '{written}': correct the name" if written is not None else "; add it"
        return f"{head} lacks the key '{missing}'{found} ({_about(error.schema, missing)})"
    value = error.instance
    shown = json.dumps(value) if value is None or isinstance(value, bool) else repr(value)
    shown = shown if len(shown) < 60 else shown[:57] + "..."
    if error.validator == "type":
        kinds = error.validator_value if isinstance(error.validator_value, list) else [error.validator_value]
        wanted = " or ".join(_WORDS.get(k, k) for k in kinds)
        return f"{head} is {shown}, expected {wanted}; {_say(error.schema)}"
    if error.validator == "enum":
        wanted = ", ".join(map(repr, error.validator_value))
        return f"{head} is {shown}, expected one of {wanted}; {_say(error.schema)}"
    if error.validator == "pattern" and {"number", "integer"} & set(error.schema.get("type", ())):
        return f"{head} is {shown}, expected a number; {_say(error.schema)}"
    return f"{head} is {shown}, which does not fit ({error.message.splitlines()[0][:120]}); {_say(error.schema)}"


def _say(rules: Mapping[str, Any]) -> str:
    description = str(rules.get("description", "")).rstrip(".")
    return f"it means: {description}" if description else "correct it"


def _about(rules: Mapping[str, Any], key: str) -> str:
    return str(rules.get("properties", {}).get(key, {}).get("description", "see the schema")).rstrip(".")
