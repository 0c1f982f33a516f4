"""Buildings of Open-RMF's traffic editor (``.building.yaml``): walls, floors and lanes of a level, in metres.

Vertices are pixels of a drawing, y downwards; measurements of known length give the scale. What no floor covers is an
obstacle, walls are 0.1 m thick as RMF builds them, doors are open.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from reprlib import repr as short
from typing import Any

import numpy as np
import shapely
import yaml

from driftplan.arrays import Floats, finite, number, positive
from driftplan.errors import MapError, naming
from driftplan.files import plain_numbers, read_bytes
from driftplan.world.formats import Mark
from driftplan.world.plain_data import MAX_YAML_BYTES, read_yaml
from driftplan.world.world import World

_MAX_THINGS = 20_000  # vertices, walls, lanes
_WALL_M = 0.1
_BEACON, _FACING = "driftplan_beacon", "driftplan_facing_deg"  # parameters of vertices that are beacons


def read_building_map(path: Path, *, robot_radius: float, level: str | None = None) -> World:
    """World of one level; it must be named where there are several."""
    _, held, pixels, scale = _level(path, level)
    xy = pixels * scale
    walls = [shapely.LineString(xy[pair]) for pair in _pairs(path, held, "walls", len(xy))]
    with naming(path, MapError):
        floors = [_floor(floor, xy) for floor in held.get("floors") or []]
        if not floors:
            raise ValueError("expected floors, outside of which nothing drives, got none")
        thick = shapely.buffer(walls, _WALL_M / 2, cap_style="square")
        return World.within(shapely.union_all(floors), list(thick), robot_radius=robot_radius)


def building_lanes(path: Path, level: str | None = None) -> tuple[Floats, list[tuple[int, int]]]:
    """The vertices of a level, (n, 2) in metres, and its lanes between them; one that leads both ways is two."""
    _, held, pixels, scale = _level(path, level)
    lanes = []
    for lane, (a, b) in zip(held.get("lanes") or [], _pairs(path, held, "lanes", len(pixels)), strict=True):
        both = _parameter(lane[2:], "bidirectional")
        lanes += [(a, b), (b, a)] if isinstance(both, list) and both[-1:] == [True] else [(a, b)]
    return pixels * scale, lanes


def building_marks(path: Path, level: str | None = None) -> list[Mark]:
    """The vertices of a level that are beacons, as `building_with_marks` adds them."""
    _, held, pixels, scale = _level(path, level)
    marks = []
    for vertex, (x, y) in zip(held.get("vertices") or [], (pixels * scale).round(6).tolist(), strict=True):
        if _parameter(vertex[4:], _BEACON) is not None:
            facing = _parameter(vertex[4:], _FACING)
            with naming(path, MapError):
                turned = number(_FACING, facing[-1]) if isinstance(facing, list) and facing else None
            marks.append(Mark(str(vertex[3]), x, y, turned))
    return marks


def building_with_marks(path: Path, marks: Sequence[Mark], level: str | None = None) -> bytes:
    """The file as it is, and a vertex for every mark after the other ones, which keep their numbers."""
    name, _, _, scale = _level(path, level)
    text = read_bytes(path, MapError, max_bytes=MAX_YAML_BYTES).decode("utf-8-sig")
    lines = []
    for mark in marks:
        x, y = (np.array([mark.x, mark.y]) / scale).round(9).tolist()
        facing = {} if mark.facing_deg is None else {_FACING: [3, float(mark.facing_deg)]}
        vertex = [x, y, 0, mark.name, {_BEACON: [4, True], **facing}]
        lines.append(json.dumps(plain_numbers(vertex), ensure_ascii=False))
    listed = _inside(_inside(_inside(yaml.compose(text, yaml.SafeLoader), "levels"), name), "vertices")
    start, end = listed.start_mark.index, listed.end_mark.index
    if listed.flow_style:
        between = ", " if listed.value else ""
        return f"{text[: end - 1]}{between}{', '.join(lines)}{text[end - 1 :]}".encode()
    indent = " " * listed.start_mark.column
    end = start + len(text[start:end].rstrip())
    return f"{text[:end]}{''.join(f'{chr(10)}{indent}- {line}' for line in lines)}{text[end:]}".encode()


def _inside(node: Any, key: str) -> Any:
    """The value of a key of a mapping in a YAML text."""
    return next(value for name, value in node.value if name.value == key)


def _parameter(rest: list[Any], name: str) -> Any:
    """Of what comes after the numbers of a vertex, lane or measurement, its parameters; None if it is not there."""
    return rest[0].get(name) if rest and isinstance(rest[0], dict) else None


def _level(path: Path, name: str | None) -> tuple[str, dict[str, Any], Floats, Floats]:
    """The name of a level, what is said about it, its vertices as they are, and what turns them into metres."""
    held = read_yaml(path, MapError)
    levels = held.get("levels") if isinstance(held, dict) else None
    if not (isinstance(levels, dict) and levels and all(isinstance(level, dict) for level in levels.values())):
        raise MapError(f"{path}: expected a building of Open-RMF, with levels by their names, got {short(held)}")
    if held.get("coordinate_system", "reference_image") not in ("reference_image", "cartesian_meters"):
        raise MapError(f"{path}: expected coordinates of a reference_image or cartesian_meters: export it so")
    if (name is None and len(levels) > 1) or (name is not None and name not in levels):
        raise MapError(f"{path}: expected level to be one of {', '.join(map(str, levels))}, got {name!r}")
    name = next(iter(levels)) if name is None else name
    level = levels[name]
    with naming(path, MapError):
        vertices = [vertex[:2] for vertex in _listed(level, "vertices")]
        xy = finite("vertices", vertices, "positions x, y").reshape(-1, 2)
        if held.get("coordinate_system") == "cartesian_meters":
            return str(name), level, xy, np.ones(2)
        scales = []
        pairs = list(_pairs(path, level, "measurements", len(xy)))
        for measured, (a, b) in zip(level.get("measurements") or [], pairs, strict=True):
            said = _parameter(measured[2:], "distance")
            length = positive("distance of a measurement", said[1] if isinstance(said, list) and said[1:] else None)
            scales.append(length / positive("pixels of a measurement", float(np.hypot(*(xy[b] - xy[a])))))
        if not scales:
            raise ValueError("expected measurements, which say how many metres a pixel has, got none")
        return str(name), level, xy, np.mean(scales) * np.array([1.0, -1.0])


def _listed(level: dict[str, Any], name: str) -> list[Any]:
    held = level.get(name) or []
    if not (isinstance(held, list) and len(held) <= _MAX_THINGS and all(isinstance(item, list) for item in held)):
        raise ValueError(f"expected {name} to be at most {_MAX_THINGS} lists, got {short(held)}")
    return held


def _pairs(path: Path, level: dict[str, Any], name: str, vertices: int) -> Iterator[list[int]]:
    """The two vertices of every wall, lane or measurement."""
    with naming(path, MapError):
        for item in _listed(level, name):
            if not (len(item) >= 2 and all(type(k) is int and 0 <= k < vertices for k in item[:2])):
                raise ValueError(f"expected {name} from one of the {vertices} vertices to another, got {short(item)}")
            yield item[:2]


def _floor(floor: Any, xy: Floats) -> Any:
    corners = floor.get("vertices") if isinstance(floor, dict) else None
    if not isinstance(corners, list) or not all(type(k) is int and 0 <= k < len(xy) for k in corners):
        raise ValueError(f"expected a floor with its vertices, got {short(floor)}")
    return shapely.make_valid(shapely.Polygon(xy[corners]))
