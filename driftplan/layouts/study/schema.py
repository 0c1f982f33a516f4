"""What a study file may say, as a JSON schema (`schema.yaml`): what editors are told is what `driftplan.world.schema`
checks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from driftplan.errors import StudyError
from driftplan.world.plain_data import read_yaml
from driftplan.world.schema import Schema, referred


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
        for one in kind.get("anyOf", [kind]):
            inside = referred(one, _file()["$defs"]).get("properties", {})
            yield from ((f"{name}.{part}", inner) for part, inner in inside.items())


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
