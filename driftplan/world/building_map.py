"""Buildings of Open-RMF's traffic editor (``.building.yaml``): walls, floors and lanes of a level, in metres.

Vertices are pixels of a drawing, y downwards; measurements of known length give the scale. What no floor covers is an
obstacle, walls are 0.1 m thick as RMF builds them, doors are open.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from reprlib import repr as short
from typing import Any

import numpy as np
import shapely

from driftplan.arrays import Floats, finite, positive
from driftplan.errors import MapError, naming
from driftplan.world.plain_data import read_yaml
from driftplan.world.world import World

_MAX_BYTES = 5_000_000
_MAX_THINGS = 20_000  # vertices, walls, lanes
_WALL_M = 0.1


def read_building_map(path: Path, *, robot_radius: float, level: str | None = None) -> World:
    """World of one level; it must be named where there are several."""
    held, xy = _level(path, level)
    walls = [shapely.LineString(xy[pair]) for pair in _pairs(path, held, "walls", len(xy))]
    with naming(path, MapError):
        floors = [_floor(floor, xy) for floor in held.get("floors") or []]
        if not floors:
            raise ValueError("expected floors, outside of which nothing drives, got none")
        ground = shapely.union_all(floors)
        outside = shapely.box(*ground.bounds).difference(ground)
        obstacles = [*shapely.buffer(walls, _WALL_M / 2, cap_style="square"), *([] if outside.is_empty else [outside])]
        return World.from_polygons(obstacles, bounds=ground.bounds, robot_radius=robot_radius)


def building_lanes(path: Path, level: str | None = None) -> tuple[Floats, list[tuple[int, int]]]:
    """The vertices of a level, (n, 2) in metres, and its lanes between them; one that leads both ways is two."""
    held, xy = _level(path, level)
    lanes = []
    for lane, (a, b) in zip(held.get("lanes") or [], _pairs(path, held, "lanes", len(xy)), strict=True):
        both = lane[2].get("bidirectional") if len(lane) > 2 and isinstance(lane[2], dict) else None
        lanes += [(a, b), (b, a)] if isinstance(both, list) and both[-1:] == [True] else [(a, b)]
    return xy, lanes


def _level(path: Path, name: str | None) -> tuple[dict[str, Any], Floats]:
    """What is said about a level, and its vertices in metres."""
    held = read_yaml(path, MapError, max_bytes=_MAX_BYTES)
    levels = held.get("levels") if isinstance(held, dict) else None
    if not (isinstance(levels, dict) and levels and all(isinstance(level, dict) for level in levels.values())):
        raise MapError(f"{path}: expected a building of Open-RMF, with levels by their names, got {short(held)}")
    if held.get("coordinate_system", "reference_image") not in ("reference_image", "cartesian_meters"):
        raise MapError(f"{path}: expected coordinates of a reference_image or cartesian_meters: export it so")
    if (name is None and len(levels) > 1) or (name is not None and name not in levels):
        raise MapError(f"{path}: expected level to be one of {', '.join(map(str, levels))}, got {name!r}")
    level = levels[next(iter(levels)) if name is None else name]
    with naming(path, MapError):
        vertices = [vertex[:2] for vertex in _listed(level, "vertices")]
        xy = finite("vertices", vertices, "positions x, y").reshape(-1, 2)
        if held.get("coordinate_system") == "cartesian_meters":
            return level, xy
        scales = []
        pairs = list(_pairs(path, level, "measurements", len(xy)))
        for measured, (a, b) in zip(level.get("measurements") or [], pairs, strict=True):
            said = measured[2].get("distance") if len(measured) > 2 and isinstance(measured[2], dict) else None
            length = positive("distance of a measurement", said[1] if isinstance(said, list) and said[1:] else None)
            scales.append(length / positive("pixels of a measurement", float(np.hypot(*(xy[b] - xy[a])))))
        if not scales:
            raise ValueError("expected measurements, which say how many metres a pixel has, got none")
        return level, xy * (np.mean(scales) * np.array([1.0, -1.0]))


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
