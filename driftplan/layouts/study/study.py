"""Study: a scenario, what of it is varied, and the cells that makes; from a YAML file or a mapping. What these may say
is a JSON schema (`schema.yaml`): what editors are told is what `driftplan.world.plain_data` checks."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from driftplan.arrays import bounded
from driftplan.errors import StudyError
from driftplan.world.plain_data import Place, Schema, check, read_yaml, referred

Values = dict[str, Any]
_MAX_CELLS, _MAX_BYTES = 1_000_000, 1 << 20
_OWN = ("title", "vary", "design")  # keys that are no part of a scenario


@dataclass(frozen=True)
class Range:
    """Numbers from one to another, both included: so many, or a step apart."""

    first: float
    last: float
    count: int
    log: bool
    whole: bool

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Any]:
        return iter(self.at(np.linspace(0.0, 1.0, self.count)) if self.count > 1 else [self.first])

    def at(self, share: Any) -> list[Any]:
        """The numbers at shares in [0, 1] of the way."""
        if self.log:
            numbers = self.first * (self.last / self.first) ** share
        else:
            numbers = self.first + (self.last - self.first) * share
        rounded = np.array([float(f"{x:.12g}") for x in numbers])  # 0.3, and not 0.30000000000000004
        return [round(x) for x in rounded.tolist()] if self.whole else rounded.tolist()


@dataclass(frozen=True)
class Cell:
    """One combination of what is varied."""

    number: int  # from 0, in the order of the study
    varied: Values  # label of every varied key: its value, or the name that the study gives it
    scenario: Values  # all keys, this cell's values put in


@dataclass(frozen=True, eq=False)
class Study:
    """A study; `Study.of` reads and checks it."""

    title: str
    scenario: Values  # keys of a study file but for title, vary and design
    vary: dict[str, dict[Any, Any] | Range]  # for every varied key, its values by label, or a `Range`
    design: str | dict[str, int]  # "grid", "zip" or {"random": cells, "seed": seed}
    path: Path | None  # the file, if it comes from one
    text: str  # of that file; JSON of what was given instead of one
    _place: Place
    _lines: dict[str, Place]

    @classmethod
    def of(cls, study: str | os.PathLike[str] | Mapping[str, Any] | Study) -> Study:
        """A study from a file, or from a mapping with the same keys; a StudyError names the file, line and key at which
        something is unknown or not what it may be.

        >>> study = Study.of({"routes": [[[0, 0], [60, 0]]], "vary": {"seed": {"from": 1, "to": 3}}})
        >>> [cell.varied for cell in study.cells()]
        [{'seed': 1}, {'seed': 2}, {'seed': 3}]
        """
        if isinstance(study, Study):
            return study
        if isinstance(study, Mapping):
            return cls._checked(study, Place("study", StudyError), None, json.dumps(study, indent=2, default=str))
        path = Path(study)
        held = read_yaml(path, StudyError, max_bytes=_MAX_BYTES)
        return cls._checked(held, Place(str(path), StudyError), path, path.read_text(encoding="utf-8-sig"))

    @classmethod
    def _checked(cls, held: Any, place: Place, path: Path | None, text: str) -> Study:
        check(held, study_schema(), place)
        lines = getattr(held, "lines", {})
        places = {key: place.inside(key, lines) for key in held}
        vary_lines = getattr(held.get("vary", {}), "lines", {})
        vary = {}
        for key, values in held.get("vary", {}).items():
            here = places["vary"].inside(key, vary_lines)
            vary[key] = _values(key, values, here)
            places[f"vary.{key}"] = here
            outer, inner = key.partition(".")[0], key.partition(".")[2]
            if inner and (outer in held.get("vary", {}) or not isinstance(held.get(outer, {}), Mapping)):
                here.refuse(f"expected {outer} to be keys and values of which one is varied")
        scenario = {key: value for key, value in held.items() if key not in _OWN}
        found = cls(
            held.get("title", path.stem if path else "study"), scenario, vary, held.get("design", "grid"),
            path, text, place, places,
        )  # fmt: skip
        here = places.get("design", places.get("vary", place))
        counts = {key: len(values) for key, values in vary.items()}
        if found.design == "zip" and len(set(counts.values())) > 1:
            here.refuse(f"expected as many values of each for a zip, got {counts}")
        if not vary and isinstance(found.design, dict):
            here.refuse("expected something under vary to draw from, got nothing")
        try:
            bounded("cells", len(found), _MAX_CELLS, "vary less, or draw some of them (design: {random: 1000})")
        except ValueError as err:
            here.refuse(str(err))
        return found

    def __len__(self) -> int:
        if isinstance(self.design, dict):
            return self.design["random"]
        counts = [len(values) for values in self.vary.values()]
        return (counts or [1])[0] if self.design == "zip" else prod(counts)

    def place_of(self, key: str) -> Place:
        """Where a key of the scenario is said, or varied."""
        inside = [name for name in self._lines if name.startswith(f"vary.{key}")]
        return self._lines.get(key) or self._lines.get(next(iter(inside), ""), self._place)

    def cells(self) -> Iterator[Cell]:
        """All cells, in their order; the same study has the same ones."""
        for number, labels in enumerate(self._combinations()):
            scenario = dict(self.scenario)
            for key, label in labels.items():
                values = self.vary[key]
                value = label if isinstance(values, Range) else values[label]
                name, _, inner = key.partition(".")
                scenario[name] = {**scenario.get(name, {}), inner: value} if inner else value
            yield Cell(number, labels, scenario)

    def _combinations(self) -> Iterator[Values]:
        columns = [list(values) for values in self.vary.values()]
        if not isinstance(self.design, dict):
            rows = zip(*columns, strict=True) if self.design == "zip" and columns else product(*columns)
            return (dict(zip(self.vary, row, strict=True)) for row in rows)
        rng, count = np.random.default_rng(self.design.get("seed", 0)), self.design["random"]
        drawn = []
        for values, column in zip(self.vary.values(), columns, strict=True):
            if isinstance(values, Range) and not values.whole:
                drawn.append(values.at(rng.random(count)))
            else:
                drawn.append([column[k] for k in rng.integers(len(column), size=count).tolist()])
        return (dict(zip(self.vary, row, strict=True)) for row in zip(*drawn, strict=True))


def _values(key: str, values: Any, place: Place) -> dict[Any, Any] | Range:
    """Values by label, or a range; a list's values are labelled by themselves, or by what is theirs alone."""
    if not isinstance(values, Mapping):
        labels = [value if isinstance(value, (str, int, float, bool)) else _label(value, k)
                  for k, value in enumerate(values, start=1)]  # fmt: skip
        if len(set(labels)) < len(labels):
            place.refuse(f"expected every value once, got {next(x for x in labels if labels.count(x) > 1)!r} twice")
        return dict(zip(labels, values, strict=True))
    kind = study_schema()["properties"]["vary"]["properties"][key]["anyOf"][0]["items"].get("type")
    if kind not in ("number", "integer"):
        return dict(values)
    first, last, log = values["from"], values["to"], values.get("log", False)
    if "count" in values and "step" in values:
        place.refuse("expected count or step, got both")
    if first >= last or (log and (first <= 0 or "step" in values)):
        place.refuse("expected a range from a number to a greater one" + ", both > 0, with a count" * log)
    count = values.get("count", 0)
    if not count and kind == "number" and "step" not in values:
        place.refuse("expected the key count or step: how many values the range has")
    step = values.get("step", 1)
    if not count:
        count = int(round((last - first) / step, 9)) + 1
        last = first + (count - 1) * step
    if kind == "integer" and (last - first) % max(count - 1, 1):
        place.refuse(f"expected whole numbers evenly apart from {first} to {last}, got {count} of them")
    return Range(first, last, count, log, kind == "integer")


def _label(value: Any, number: int) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {x:g}" if isinstance(x, float) else f"{name} {x}" for name, x in value.items())
    return f"{number}"


@cache
def study_schema() -> Values:
    """The schema of a study file."""
    known = _file()["properties"]
    varied = {path: _varied(kind) for path, kind in _paths(known) if path not in ("title", "design")}
    return {**_file(), "properties": {**known, "vary": _keys("what differs from cell to cell", varied)}}


@cache
def _file() -> Values:
    held: Values = read_yaml(Path(__file__).with_name("schema.yaml"), StudyError, max_bytes=_MAX_BYTES)
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


def _keys(description: str, properties: Mapping[str, Schema]) -> Values:
    return {"description": description, "type": "object", "properties": properties, "additionalProperties": False}
