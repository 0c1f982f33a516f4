"""YAML and JSON from anybody: plain values of bounded size, no key twice, or a message with the line at fault; held
against a JSON schema, as far as the project's own schemas make use of that (draft 2020-12)."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from math import isfinite
from operator import ge, gt, le
from pathlib import Path
from reprlib import repr as short
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import yaml

from driftplan.errors import MapError
from driftplan.files import FileError, read_bytes

Schema = Mapping[str, Any]
MAX_YAML_BYTES, MAX_JSON_BYTES = 5_000_000, 50_000_000  # of each a minute's reading at most


def read_yaml(path: Path, error: FileError, *, max_bytes: int = MAX_YAML_BYTES) -> Any:
    """What a YAML file holds, mappings as `Lined`. ``1e-4`` is a number, as in YAML 1.2 and for people."""
    text = read_bytes(path, error, max_bytes=max_bytes)
    try:
        return yaml.load(text, _PlainLoader)
    except yaml.MarkedYAMLError as err:
        line = err.problem_mark.line + 1 if err.problem_mark else "?"
        raise error(f"{path}, line {line}: not plain YAML: {err.problem}") from err
    except (yaml.YAMLError, ValueError, RecursionError) as err:
        raise error(f"{path}: not plain YAML: {' '.join(str(err).split())[:200]}") from err


def read_json(path: Path) -> Any:
    """What a JSON file holds."""
    return json_of(path, read_bytes(path, MapError, max_bytes=MAX_JSON_BYTES))


def json_of(path: Path, text: bytes) -> Any:
    """What JSON text from the file holds."""
    try:
        return json.loads(text.removeprefix(b"\xef\xbb\xbf"), parse_constant=_refuse, object_pairs_hook=_without_twice)
    except json.JSONDecodeError as err:
        raise MapError(f"{path}, line {err.lineno}: not JSON: {err.msg}") from err
    except (ValueError, RecursionError) as err:
        raise MapError(f"{path}: not JSON: {str(err)[:200]}") from err


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")


def _without_twice(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    known = dict(pairs)
    if len(known) < len(pairs):
        raise ValueError(f"a key occurs twice in {short([key for key, _ in pairs])}")
    return known


class Lined(dict[Any, Any]):
    """A mapping of a file, with the line of every key."""

    lines: dict[Any, int]


if TYPE_CHECKING or not hasattr(yaml, "CSafeLoader"):
    _Loader = yaml.SafeLoader
else:  # libyaml finds the words, three times as fast; PyYAML's own composer still says no where it should

    class _Loader(yaml.composer.Composer, yaml.CSafeLoader):
        def __init__(self, stream):
            yaml.CSafeLoader.__init__(self, stream)
            yaml.composer.Composer.__init__(self)


class _PlainLoader(_Loader):
    """The safe loader without aliases, of which a few hundred bytes can stand for more than memory holds, and without
    keys given twice, of which parsers take the one or the other."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "aliases have no place in plain YAML", event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    problem = f"the key {key.value!r} occurs twice"
                    raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_lined(self, node: Any) -> Iterator[Lined]:
        data = Lined()
        yield data
        data.update(self.construct_mapping(node))
        data.lines = {key: n.start_mark.line + 1 for key, (n, _) in zip(data, node.value, strict=False)}


_PlainLoader.add_constructor("tag:yaml.org,2002:map", _PlainLoader.construct_lined)
_PlainLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+$"), list("-+0123456789.")
)


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
