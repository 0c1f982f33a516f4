"""Map files: load_world and save_world for ROS map_server, MovingAI and GeoJSON maps, and the maps that come along.

The suffix tells the format: ``.yaml`` or ``.yml`` (ROS, `driftplan.world.ros_map`), ``.map`` (MovingAI,
`driftplan.world.movingai_map`), ``.geojson`` or ``.json`` (`driftplan.world.geojson_map`).
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import shapely

from driftplan.arrays import arguments_checked, positive
from driftplan.errors import MapError
from driftplan.files import write_files
from driftplan.world.geojson_map import geojson_map_files, read_geojson_map
from driftplan.world.movingai_map import movingai_map_files, read_movingai_map
from driftplan.world.ros_map import read_ros_map, ros_map_files
from driftplan.world.world import World
from driftplan.world.zone_files import load_zones

_FORMATS = {".yaml": "ROS", ".yml": "ROS", ".map": "MovingAI", ".geojson": "GeoJSON", ".json": "GeoJSON"}
_BUNDLED = Path(__file__).parents[1] / "maps"


def load_world(
    path: str | os.PathLike[str],
    *,
    robot_radius: float,
    unknown_is_free: bool = False,
    cell_size_m: float | None = None,
    zones: str | os.PathLike[str] | None = None,
) -> World:
    """The world that a map file shows to a robot.

    Parameters
    ----------
    path : path of a ``.yaml``, ``.map`` or ``.geojson`` file
    robot_radius : metres, >= 0
    unknown_is_free : take unknown cells of a ROS map for free ones; they are obstacles otherwise
    cell_size_m : size of a cell of a MovingAI map (default 1 m), which does not say; the other formats do
    zones : path of a zone file, optional
        Floors of other noise, for maps of any format (`driftplan.world.zone_files`); they cover the map's own.

    Raises
    ------
    MapError : if the file is missing, broken, too large or not a map; the message names file and line, key or feature
    ValueError : if an argument is out of range or means nothing for this format

    Examples
    --------
    >>> world = load_world(bundled_map("office"), robot_radius=0.3)
    >>> len(world.zones)
    1
    """
    path, kind = _path_and_format(path)
    if unknown_is_free and kind != "ROS":
        raise ValueError(f"unknown_is_free is for ROS maps: {kind} maps have no unknown cells")
    if cell_size_m is not None and kind != "MovingAI":
        raise ValueError(f"cell_size_m is for MovingAI maps: {kind} maps say it themselves")
    cell_size_m = positive("cell_size_m", 1.0 if cell_size_m is None else cell_size_m)
    if kind == "ROS":
        world = read_ros_map(path, robot_radius=robot_radius, unknown_is_free=unknown_is_free)
    elif kind == "MovingAI":
        world = read_movingai_map(path, robot_radius=robot_radius, cell_size_m=cell_size_m)
    else:
        world = read_geojson_map(path, robot_radius=robot_radius)
    if zones is None:
        return world
    added = load_zones(zones)
    if not any(zone.polygon.intersects(shapely.box(*world.bounds)) for zone in added):
        raise MapError(f"{zones}: no zone touches the map, whose bounds are {world.bounds}: is the origin right?")
    return replace(world, zones=(*world.zones, *added))


@arguments_checked()
def save_world(world: World, path: str | os.PathLike[str], *, cell_size_m: float | None = None) -> None:
    """Write a world's map to a file (and, for ROS, a picture ``.pgm`` beside it), in the format of the suffix.

    GeoJSON keeps everything but the robot's radius. ROS and MovingAI maps are made of cells: a cell that an obstacle
    reaches into becomes an obstacle. Files get a temporary name first, so that none is ever half written.

    Parameters
    ----------
    cell_size_m : size of a cell: 0.05 m for ROS and 1 m for MovingAI maps unless given; GeoJSON has no cells.

    Raises
    ------
    ValueError : if the format cannot hold the world's zones or origin, or an argument is out of range. Nothing is
        written.
    """
    path, kind = _path_and_format(path)
    if kind == "GeoJSON":
        if cell_size_m is not None:
            raise ValueError("cell_size_m is for maps made of cells, which GeoJSON maps are not")
        files = geojson_map_files(world, path)
    elif world.zones:
        raise ValueError(f"{kind} maps have no zones, and this world has {len(world.zones)}: save it as .geojson")
    elif kind == "ROS":
        files = ros_map_files(
            world, path, cell_size_m=positive("cell_size_m", 0.05 if cell_size_m is None else cell_size_m)
        )
    else:
        files = movingai_map_files(
            world, path, cell_size_m=positive("cell_size_m", 1.0 if cell_size_m is None else cell_size_m)
        )
    write_files(files)


def bundled_maps() -> tuple[str, ...]:
    """Names of the maps that come with driftplan.

    Examples
    --------
    >>> bundled_maps()
    ('office', 'warehouse')
    """
    return tuple(sorted(path.stem for path in _BUNDLED.iterdir() if path.suffix in _FORMATS))


def bundled_map(name: str) -> Path:
    """Path of a map that comes with driftplan, for `load_world`.

    Examples
    --------
    >>> bundled_map("warehouse").name
    'warehouse.yaml'
    """
    for path in _BUNDLED.iterdir():
        if path.suffix in _FORMATS and path.stem == name:
            return path
    raise ValueError(f"expected one of the maps {', '.join(bundled_maps())}, got {name!r}")


def _path_and_format(path: str | os.PathLike[str]) -> tuple[Path, str]:
    path = Path(path)
    kind = _FORMATS.get(path.suffix.lower())
    if kind is None:
        raise MapError(
            f"{path}: expected a map called .yaml or .yml (ROS), .map (MovingAI), .geojson or .json (GeoJSON), "
            f"got {path.suffix or 'no suffix'}"
        )
    return path, kind
