"""What a study file may say, as a JSON schema, and the check of values against it: what editors are told is what holds.

The check knows the part of JSON Schema (draft 2020-12) that `STUDY` is written in.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from math import isfinite
from reprlib import repr as short
from typing import Any, NoReturn

from driftplan.errors import StudyError

Schema = dict[str, Any]


# The keys


def _number(said: str, least: float | None = None, *, above: float | None = None, most: float | None = None) -> Schema:
    bounds = {"minimum": least, "exclusiveMinimum": above, "maximum": most}
    return {"description": said, "type": "number", **{k: v for k, v in bounds.items() if v is not None}}


def _whole(said: str, least: int) -> Schema:
    return {"description": said, "type": "integer", "minimum": least}


def _text(said: str, *choices: str) -> Schema:
    return {"description": said, "type": "string", **({"enum": list(choices)} if choices else {})}


def _flag(said: str) -> Schema:
    return {"description": said, "type": "boolean"}


def _list(said: str, items: Schema, least: int = 1, most: int | None = None) -> Schema:
    bound = {} if most is None else {"maxItems": most}
    return {"description": said, "type": "array", "items": items, "minItems": least, **bound}


def _keys(said: str, required: Sequence[str] = (), /, **properties: Schema) -> Schema:
    more: Schema = {"required": list(required)} if required else {}
    return {
        "description": said,
        "type": "object",
        "properties": properties,
        "additionalProperties": False,
        **more,
    }


def _one_of(said: str, *kinds: Schema) -> Schema:
    return {"description": said, "anyOf": list(kinds)}


_POINT = _list("x, y in metres", _number("metres"), 2, 2)
_BEACON = _keys(
    "what a beacon measures, and from how far",
    ("kind", "range_m"),
    kind=_text("what it measures", "rfid", "landmark", "heading", "range_only", "bearing"),
    range_m=_number("range, metres", above=0),
    position_std_m=_number("accuracy of a position per axis, metres", 0),
    heading_std_deg=_number("accuracy of a heading, degrees", 0),
    range_std_m=_number("accuracy of a distance, metres", 0),
    bearing_std_deg=_number("accuracy of a direction, degrees", 0),
    std_per_m=_number("what accuracy worsens by per metre of distance", 0),
    detection_probability=_number("that a pass is noticed", above=0, most=1),
    line_of_sight=_flag("whether walls block it"),
    view_angle_deg=_number("from within how many degrees it is seen", above=0, most=360),
    sensor_view_deg=_number("field of view of the sensor that reads it, degrees", above=0, most=360),
    reading_spacing_m=_number("between readings on a long pass, metres", above=0),
    cost=_number("of one, in any unit", above=0),
)
SPREAD = ("heading_deg", "distance_m", "after_m", "heading_deg_per_full_turn")  # of `OdometryNoise.from_std`
_NOISE = _keys(
    "spreads after straight drives, or rates by the names of OdometryNoise; a file or preset to begin with",
    **{"from": _text("a noise file or a preset, of which the other keys change rates")},
    heading_deg=_number("standard deviation of the heading after after_m, degrees", 0),
    distance_m=_number("standard deviation of the distance after after_m, metres", 0),
    after_m=_number("length of those drives, metres", above=0),
    heading_deg_per_full_turn=_number("standard deviation of the heading after a full turn, degrees", 0),
    heading_var_per_m=_number("rad²/m", 0),
    distance_var_per_m=_number("m²/m", 0),
    lateral_var_per_m=_number("m²/m", 0),
    heading_var_per_rad=_number("rad²/rad", 0),
    distance_var_per_rad=_number("m²/rad", 0),
    heading_distance_corr=_number("correlation of heading and distance errors", -1, most=1),
    heading_bias_per_m=_number("systematic heading error, rad/m"),
    heading_bias_per_rad=_number("systematic relative error of turns"),
    distance_scale_error=_number("systematic relative error of distances"),
    heading_bias_std_per_m=_number("its standard deviation between drives, rad/m", 0),
    heading_bias_std_per_rad=_number("its standard deviation between drives", 0),
    distance_scale_std=_number("its standard deviation between drives", 0),
)
_TRIPS = _one_of(
    "drives from start to goal, for which routes are planned",
    _text("a file as `driftplan design` reads it"),
    _list("start and goal of each, metres; with a graph two ids of nodes", _one_of(
        "a trip", _list("start and goal", _POINT, 2, 2), _list("ids of nodes", _whole("id of a node", 0), 2, 2)
    )),
    _keys("made by chance, from the seed", ("random",), random=_whole("how many", 1),
          stops=_whole("places that each goes to, one after the other (default: 2)", 2)),
)  # fmt: skip
_SCENARIO: dict[str, Schema] = {
    "map": _text("a map file, or the name of a map that comes along"),
    "robot_radius_m": _number("radius of the robot, metres (default: 0.3)", 0),
    "unknown_is_free": _flag("take unknown cells of a ROS map for free"),
    "cell_size_m": _number("cell size of a MovingAI map, metres", above=0),
    "level": _text("level of an Open-RMF building"),
    "keepout": _text("keepout mask of nav2's, a file"),
    "zones": _text("floors with a noise of their own, a file"),
    "noise": _one_of("odometry noise", _text("a noise file, or the name of a preset"), _NOISE),
    "routes": _one_of("routes that are there", _text("a file of waypoints"), _list("several", _one_of(
        "a route", _text("a file of waypoints"), _list("waypoints", _POINT, 2)))),
    "trips": _TRIPS,
    "graph": _text("a route graph, GeoJSON, whose nodes trips lead to"),
    "minimise": _text("what routes of trips are chosen for (default: length)", "length", "drift"),
    "beacon": _one_of("what may be placed", _BEACON, _list("several kinds", _BEACON)),
    "existing": _text("beacons that are there already, a GeoJSON file"),
    "sites": _keys(
        "where beacons may go (default: a grid, as far apart as their range)",
        spacing_m=_number("of generated sites, metres", above=0),
        along=_text("what is generated (default: grid)", "grid", "walls", "routes"),
        file=_text("sites x,y, or beacons with kinds of their own (.geojson), instead"),
        min_spacing_m=_number("least distance between beacons, metres", 0),
        forbidden=_list("areas without sites", _list("corners", _POINT, 3)),
    ),
    "limit_m": _number("what the drift must not exceed, metres", above=0),
    "confidence": _number("the limit is on the radius that holds the estimate so surely", 0.75, most=0.999999),
    "redundancy": _whole("the limit holds with one less than so many beacons dead (default: 1)", 1),
    "estimator": _text("what the robot does with a reading (default: reset)", "reset", "filter"),
    "max_beacons": _whole("at most so many new beacons", 0),
    "budget": _number("new beacons cost at most this", above=0),
    "start": _keys("how well the start is known (default: exactly)",
                   position_std_m=_number("per axis, metres", 0), heading_std_deg=_number("degrees", 0)),
    "seed": _whole("of random trips and of simulated drives (default: 0)", 0),
    "time_limit_s": _number("for a cell, seconds (default: 60)", above=0),
    "simulated_drives": _whole("so many drives on every route, to check what is predicted (default: 0)", 0),
}  # fmt: skip


def at(path: str) -> Schema:
    """The schema of a key of a scenario, ``noise.heading_deg`` the one inside another."""
    name, _, rest = path.partition(".")
    found = _SCENARIO[name]
    for part in filter(None, rest.split(".")):
        kinds = found.get("anyOf", [found])
        found = next(kind["properties"][part] for kind in kinds if part in kind.get("properties", ()))
    return found


def _paths() -> Iterable[str]:
    for name, kind in _SCENARIO.items():
        yield name
        for one in kind.get("anyOf", [kind]):
            yield from (f"{name}.{part}" for part in one.get("properties", ()))


def _varied(path: str) -> Schema:
    kind = at(path)
    ways = [_list("these values", kind)]
    if kind.get("type") in ("number", "integer"):
        ends = {end: {**kind, "description": f"the {said} value"} for end, said in (("from", "first"), ("to", "last"))}
        ways.append(_keys("a range", ("from", "to"), **ends, count=_whole("how many values", 2),
                          step=_number("between values", above=0), log=_flag("equal ratios, not differences")))  # fmt: skip
    else:
        named = _keys("values by names of your own")
        ways.append({**named, "additionalProperties": kind, "minProperties": 1})
    return _one_of(kind["description"], *ways)


_RANDOM = _keys("so many cells drawn by chance", ("random",), random=_whole("cells", 1), seed=_whole("of the draw", 0))
STUDY: Schema = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "driftplan study",
    **_keys(
        "a scenario, and what of it is varied",
        title=_text("what is asked, in words"),
        **_SCENARIO,
        vary=_keys("what differs from cell to cell", **{path: _varied(path) for path in _paths()}),
        design=_one_of("how values are combined (default: grid)",
                       _text("every one with every other, or the first ones, the second ones, …", "grid", "zip"), _RANDOM),
    ),
}  # fmt: skip


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

    def refuse(self, said: str) -> NoReturn:
        raise StudyError(f"{self}: {said}")


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
    for rule, sign, kept in (
        ("minimum", ">=", lambda bound: value >= bound),
        ("exclusiveMinimum", ">", lambda bound: value > bound),
        ("maximum", "<=", lambda bound: value <= bound),
    ):
        if rule in schema and not kept(schema[rule]):
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
