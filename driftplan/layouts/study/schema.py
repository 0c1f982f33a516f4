"""What a study file may say, as a JSON schema (`schema.yaml`), and the check of values against it: what editors are
told is what holds. The check knows the part of JSON Schema (draft 2020-12) that the schema is written in.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from math import isfinite
from operator import ge, gt, le
from pathlib import Path
from reprlib import repr as short
from typing import Any, NoReturn

from driftplan.errors import StudyError
from driftplan.world.plain_data import read_yaml

Schema = Mapping[str, Any]


@cache
def study_schema() -> dict[str, Any]:
    """The schema of a study file."""
    known = _file()["properties"]
    varied = {path: _varied(kind) for path, kind in _paths(known) if path not in ("title", "design")}
    return {**_file(), "properties": {**known, "vary": _keys("what differs from cell to cell", varied)}}


@cache
def _file() -> dict[str, Any]:
    held: dict[str, Any] = read_yaml(Path(__file__).with_suffix(".yaml"), StudyError, max_bytes=1 << 20)
    return held


def _paths(known: Mapping[str, Schema]) -> Iterator[tuple[str, Schema]]:
    """The keys of a scenario, ``noise.heading_deg`` for one inside another, and what they may be."""
    for name, kind in known.items():
        yield name, kind
        for one in map(_referred, kind.get("anyOf", [kind])):
            yield from ((f"{name}.{part}", inner) for part, inner in one.get("properties", {}).items())


def _varied(kind: Schema) -> Schema:
    """The values of a key: a list, a range of numbers, or values by names of the user's own."""
    ways: list[Schema] = [{"description": "these values", "type": "array", "items": kind, "minItems": 1}]
    if kind.get("type") in ("number", "integer"):
        numbers = {"from": "the first value", "to": "the last value"}
        whole: Schema = {"type": "integer", "minimum": 2}
        step: Schema = {"type": "number", "exclusiveMinimum": 0}
        ends = {name: {**kind, "description": description} for name, description in numbers.items()}
        how: dict[str, Schema] = {
            "count": {"description": "how many values", **whole},
            "step": {"description": "between values", **step},
            "log": {"description": "equal ratios, not differences", "type": "boolean"},
        }
        ways.append({**_keys("a range", {**ends, **how}), "required": list(ends)})
    else:
        named = {"description": "values by names of your own", "type": "object", "properties": {}, "minProperties": 1}
        ways.append({**named, "additionalProperties": kind})
    return {"description": kind["description"], "anyOf": ways}


def _keys(description: str, properties: Mapping[str, Schema]) -> dict[str, Any]:
    return {"description": description, "type": "object", "properties": properties, "additionalProperties": False}


def _referred(kind: Schema) -> Schema:
    """A schema, or what it refers to."""
    return _file()["$defs"][kind["$ref"].rpartition("/")[2]] if "$ref" in kind else kind


# The check


@dataclass(frozen=True)
class Place:
    """Where in a study something stands: the file, if there is one, the line as far as known, and the key."""

    source: str
    key: str = ""
    line: int | None = None

    def inside(self, key: str | int, lines: Mapping[Any, int]) -> Place:
        return Place(self.source, f"{self.key}.{key}".lstrip("."), lines.get(key, self.line))

    def __str__(self) -> str:
        line = "" if self.line is None else f", line {self.line}"
        return f"{self.source}{line}{': ' if self.key else ''}{self.key}"

    def refuse(self, message: str) -> NoReturn:
        raise StudyError(f"{self}: {message}")


_TYPES: dict[str, tuple[tuple[type, ...], str]] = {
    "number": ((int, float), "a number"),
    "integer": ((int,), "a whole number"),
    "string": ((str,), "text"),
    "boolean": ((bool,), "true or false"),
    "array": ((list, tuple), "a list"),
    "object": ((Mapping,), "keys and values"),
}


def _is(value: Any, schema: Schema) -> bool:
    classes, _ = _TYPES[schema["type"]]
    return isinstance(value, classes) and isinstance(value, bool) == (schema["type"] == "boolean")


def check(value: Any, schema: Schema, place: Place) -> None:
    """Refuse a value that the schema does not allow, naming the key and the line.

    Raises
    ------
    StudyError
    """
    schema = _referred(schema)
    if "anyOf" in schema:
        return _check_one_of(value, schema["anyOf"], place)
    if not _is(value, schema):
        place.refuse(f"expected {_TYPES[schema['type']][1]} ({schema['description']}), got {short(value)}")
    if isinstance(value, str) and value not in schema.get("enum", [value]):
        place.refuse(f"expected one of {', '.join(schema['enum'])}, got {value!r}{_meant(value, schema['enum'])}")
    if isinstance(value, (int, float)):
        _check_number(value, schema, place)
    elif isinstance(value, Mapping):
        _check_keys(value, schema, place)
    elif not isinstance(value, str):
        least, most = schema["minItems"], schema.get("maxItems", len(value))
        if not least <= len(value) <= most:
            place.refuse(f"expected {least}{'' if least == most else ' or more'} values, got {len(value)}")
        for k, item in enumerate(value):
            check(item, schema["items"], place.inside(k, {}))
    return None


def _check_one_of(value: Any, kinds: Sequence[Schema], place: Place) -> None:
    """What is of the type of several is refused in the words of the last of these."""
    error: StudyError | None = None
    kinds = [_referred(kind) for kind in kinds]
    for kind in kinds:
        if "anyOf" in kind or _is(value, kind):
            try:
                return check(value, kind, place)
            except StudyError as err:
                error = err
    wanted = " or ".join(dict.fromkeys(_TYPES[k["type"]][1] + f" ({k['description']})" for k in kinds if "type" in k))
    raise error or StudyError(f"{place}: expected {wanted}, got {short(value)}")


def _check_number(value: float, schema: Schema, place: Place) -> None:
    if not isfinite(value):
        place.refuse(f"expected a finite number, got {value!r}")
    for rule, sign, kept in (("minimum", ">=", ge), ("exclusiveMinimum", ">", gt), ("maximum", "<=", le)):
        if rule in schema and not kept(value, schema[rule]):
            place.refuse(f"expected {sign} {schema[rule]:g} ({schema['description']}), got {value!r}")


def _check_keys(value: Mapping[Any, Any], schema: Schema, place: Place) -> None:
    known, others = schema["properties"], schema["additionalProperties"]
    lines = getattr(value, "lines", {})
    for key, item in value.items():
        here = place.inside(key, lines)
        if not isinstance(key, str) or (key not in known and not others):
            here.refuse(f"no such key{_meant(str(key), known)}; known are {', '.join(known)}")
        check(item, known.get(key, others), here)
    for key in schema.get("required", ()):
        if key not in value:
            place.refuse(f"expected the key {key} ({known[key]['description']}), it is missing")
    if len(value) < schema.get("minProperties", 0):
        place.refuse("expected at least one value, got none")


def _meant(word: str, known: Iterable[str]) -> str:
    near = get_close_matches(word, list(known), 1)
    return f": did you mean {near[0]}?" if near else ""
