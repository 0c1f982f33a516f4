"""The check of what a file holds against a JSON schema, as far as the project's own schemas make use of it (draft
2020-12)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from math import isfinite
from operator import ge, gt, le
from reprlib import repr as short
from typing import Any, NamedTuple, NoReturn

from driftplan.files import FileError

Schema = Mapping[str, Any]


class Place(NamedTuple):
    """Where something stands: the file, if there is one, the line as far as known, and the key; what is wrong is an
    ``error``."""

    source: str
    error: FileError
    key: str = ""
    line: int | None = None

    def inside(self, key: str | int, lines: Mapping[Any, int]) -> Place:
        return Place(self.source, self.error, f"{self.key}.{key}" if self.key else str(key), lines.get(key, self.line))

    def __str__(self) -> str:
        line = "" if self.line is None else f", line {self.line}"
        return f"{self.source}{line}{': ' if self.key else ''}{self.key}"

    def refuse(self, message: str) -> NoReturn:
        raise self.error(f"{self}: {message}")


_TYPES: dict[str, tuple[tuple[type, ...], str]] = {
    "number": ((int, float), "a number"),
    "integer": ((int,), "a whole number"),
    "string": ((str,), "text"),
    "boolean": ((bool,), "true or false"),
    "array": ((list, tuple), "a list"),
    "object": ((dict, Mapping), "keys and values"),
}


def _is(value: Any, schema: Schema) -> bool:
    classes, _ = _TYPES[schema["type"]]
    return isinstance(value, classes) and isinstance(value, bool) == (schema["type"] == "boolean")


def referred(kind: Schema, defs: Schema) -> Schema:
    """A schema, or what it refers to."""
    found: Schema = defs[kind["$ref"].rpartition("/")[2]] if "$ref" in kind else kind
    return found


def check(value: Any, schema: Schema, place: Place) -> None:
    """Refuse a value that the schema does not allow, with the place's error, naming the key and the line."""
    _check(value, schema, place, schema.get("$defs", {}))


def _check(value: Any, schema: Schema, place: Place, defs: Schema) -> None:
    schema = referred(schema, defs)
    if "anyOf" in schema:
        return _check_one_of(value, schema["anyOf"], place, defs)
    if not _is(value, schema):
        place.refuse(f"expected {_TYPES[schema['type']][1]} ({schema['description']}), got {short(value)}")
    if schema["type"] == "object":
        _check_keys(value, schema, place, defs)
    elif schema["type"] == "array":
        least, most = schema.get("minItems", 0), schema.get("maxItems", len(value))
        if not least <= len(value) <= most:
            place.refuse(f"expected {least}{'' if least == most else ' or more'} values, got {len(value)}")
        for k, item in enumerate(value):
            _check(item, schema["items"], place.inside(k, {}), defs)
    elif schema["type"] in ("number", "integer"):
        _check_number(value, schema, place)
    elif value not in schema.get("enum", [value]):
        place.refuse(f"expected one of {', '.join(schema['enum'])}, got {value!r}{_meant(value, schema['enum'])}")
    return None


def _check_one_of(value: Any, kinds: Sequence[Schema], place: Place, defs: Schema) -> None:
    """What is of the type of several is refused in the words of the last of these."""
    error: Exception | None = None
    kinds = [referred(kind, defs) for kind in kinds]
    for kind in kinds:
        if "anyOf" in kind or _is(value, kind):
            try:
                return _check(value, kind, place, defs)
            except place.error as err:
                error = err
    wanted = " or ".join(dict.fromkeys(_TYPES[k["type"]][1] + f" ({k['description']})" for k in kinds if "type" in k))
    raise error or place.error(f"{place}: expected {wanted}, got {short(value)}")


def _check_number(value: float, schema: Schema, place: Place) -> None:
    if not isfinite(value):
        place.refuse(f"expected a finite number, got {value!r}")
    for rule, sign, kept in (("minimum", ">=", ge), ("exclusiveMinimum", ">", gt), ("maximum", "<=", le)):
        if rule in schema and not kept(value, schema[rule]):
            place.refuse(f"expected {sign} {schema[rule]:g} ({schema['description']}), got {value!r}")


def _check_keys(value: Mapping[Any, Any], schema: Schema, place: Place, defs: Schema) -> None:
    known, others = schema["properties"], schema.get("additionalProperties", True)
    lines = getattr(value, "lines", {})
    for key, item in value.items():
        if not isinstance(key, str) or (key not in known and not others):
            place.inside(key, lines).refuse(f"no such key{_meant(str(key), known)}; known are {', '.join(known)}")
        if key in known or others is not True:
            _check(item, known.get(key, others), place.inside(key, lines), defs)
    for key in schema.get("required", ()):
        if key not in value:
            meant = referred(known[key], defs)["description"]
            place.refuse(f"expected the key {key} ({meant}), it is missing")
    if len(value) < schema.get("minProperties", 0):
        place.refuse("expected at least one value, got none")


def _meant(word: str, known: Iterable[str]) -> str:
    near = get_close_matches(word, list(known), 1)
    return f": did you mean {near[0]}?" if near else ""
