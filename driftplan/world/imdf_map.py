"""Indoor maps in Apple's and OGC's IMDF: an archive of GeoJSON files in degrees, of which a level is taken.

What no unit covers is an obstacle, and so are units that nothing drives on, fixtures, and the borders of units but for
walkways that touch each other: walls, 0.1 m thick. Openings lead through walls up to 0.6 m thick. Levels are chosen by
id, name, short name or ordinal. (OGC 20-094, Indoor Mapping Data Format 1.0.0)
"""

from __future__ import annotations

import json
import zipfile
import zlib
from io import BytesIO
from pathlib import Path

import shapely

from driftplan.errors import MapError, naming
from driftplan.files import read_bytes
from driftplan.world.geojson_map import Feature, area_of, read_features, refuse_tangles
from driftplan.world.world import World

_MAX_BYTES = 20_000_000
_EMPTY = b'{"type": "FeatureCollection", "features": []}'
_WALL_M = 0.1
_THROUGH_M = 0.3  # to either side of an opening
_PARTS = ("level", "unit", "opening", "fixture")
_WALLS = {"brick", "column", "concrete", "drywall", "glass", "structure"}
_NO_GROUND = {"elevator", "escalator", "movingwalkway", "opentobelow", "stairs", "steps", "vegetation"}
_OPEN = {"footbridge", "lobby", "parking", "platform", "ramp", "road", "unenclosedarea", "walkway"}


def read_imdf_map(
    path: Path, *, robot_radius: float, origin: tuple[float, float] | None = None, level: str | None = None
) -> World:
    """World of a level of a venue."""
    if origin is None:
        raise MapError(f"{path}: IMDF is in degrees: give the place of x = y = 0, origin=(lon, lat) (--origin)")
    parts = _features(path, origin)
    chosen = _level(path, parts["level"], level)
    here = {part: [f for f in parts[part] if f.properties.get("level_id") == chosen.id] for part in _PARTS[1:]}
    units = [(f.properties.get("category"), area_of(f"{path}, unit {f.id}", f)) for f in here["unit"]]
    ground = area_of(f"{path}, level {chosen.id}", chosen)
    fixtures = [area_of(f"{path}, fixture {f.id}", f) for f in here["fixture"] if f.kind in ("Polygon", "MultiPolygon")]
    if not units:
        raise MapError(f"{path}: expected units on level {chosen.id}, got none")
    if no_lines := [f.id for f in here["opening"] if f.kind != "LineString"]:
        raise MapError(f"{path}, opening {no_lines[0]}: expected a LineString")
    refuse_tangles(path, [ground, *fixtures, *(area for _, area in units)])
    with naming(path, MapError):
        doors = [f.geometry.buffer(_THROUGH_M, cap_style="flat") for f in here["opening"]]
        walkways = shapely.union_all([area for category, area in units if category in _OPEN])
        rooms = [area for category, area in units if category not in (_OPEN | _WALLS | _NO_GROUND)]
        borders = shapely.union_all(shapely.boundary([*rooms, walkways]))
        walls = shapely.union(ground.difference(shapely.union_all([*rooms, walkways])), borders.buffer(_WALL_M / 2))
        kept = [area for category, area in units if category in _NO_GROUND]
        obstacles = [walls.difference(shapely.union_all(doors)), *kept, *fixtures]
        return World.within(ground, [area for area in obstacles if not area.is_empty], robot_radius=robot_radius)


def _features(path: Path, origin: tuple[float, float]) -> dict[str, list[Feature]]:
    """Features in metres, by the names of the archive's files."""
    content, left, found = read_bytes(path, MapError, max_bytes=_MAX_BYTES), _MAX_BYTES, {}
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            for part in _PARTS:
                names = [name for name in archive.namelist() if name.rpartition("/")[2] == f"{part}.geojson"]
                if not names and part in _PARTS[:2]:
                    raise MapError(f"{path}: expected an IMDF archive with a file {part}.geojson, got none")
                text = archive.open(names[0]).read(left + 1) if names else _EMPTY
                left -= len(text)
                if left < 0:
                    raise MapError(f"{path}: expected at most {_MAX_BYTES} bytes unpacked, got more")
                found[part] = read_features(path, text=text, origin=origin)
    except MapError:
        raise
    except (zipfile.BadZipFile, RuntimeError, ValueError, EOFError, OSError, zlib.error) as err:  # of broken archives
        raise MapError(f"{path}: not a readable archive ({err})") from err
    for part, features in found.items():
        for feature in features:
            if not (isinstance(feature.id, str) and feature.properties and feature.geometry):
                raise MapError(f"{path}: expected every {part} to have an id, properties and a geometry")
    return found


def _level(path: Path, levels: list[Feature], asked: str | None) -> Feature:
    """The one that is called so; it may be left out where there is only one."""
    called: dict[str, Feature] = {}
    for feature in levels:
        said = feature.properties
        names = [label for key in ("name", "short_name") for label in (said.get(key) or {}).values()]
        for name in (feature.id, said.get("ordinal"), *names):
            called[str(name)] = feature
    if asked is None and len(levels) == 1:
        return levels[0]
    if asked not in called:
        raise MapError(f"{path}: expected level to be one of {', '.join(sorted(called))}, got {json.dumps(asked)}")
    return called[asked]
