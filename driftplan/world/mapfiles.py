"""Map files: load_world, save_world, and the maps that come along. The name of a file tells its format: `FORMATS`."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import shapely

from driftplan.arrays import positive
from driftplan.errors import MapError
from driftplan.files import write_files
from driftplan.world.building_map import read_building_map
from driftplan.world.dxf_map import read_dxf_map
from driftplan.world.formats import Format, format_of, own_options
from driftplan.world.geojson_map import geojson_map_files, read_geojson_map
from driftplan.world.imdf_map import read_imdf_map
from driftplan.world.movingai_map import movingai_map_files, read_movingai_map
from driftplan.world.ros_map import read_ros_map, ros_map_files
from driftplan.world.world import World
from driftplan.world.zone_files import load_zones

_CELLS = ("coarsen", "despeckle_m")
FORMATS = (
    Format("Open-RMF", (".building.yaml",), read_building_map, options=("level",)),  # before those that it ends like
    Format("ROS", (".yaml", ".yml"), read_ros_map, ros_map_files, ("unknown_is_free", *_CELLS), 0.05),
    Format("MovingAI", (".map",), read_movingai_map, movingai_map_files, ("cell_size_m", *_CELLS), 1.0),
    Format("DXF", (".dxf",), read_dxf_map),
    Format("GeoJSON", (".geojson", ".json"), read_geojson_map, geojson_map_files, ("origin",)),
    Format("IMDF", (".imdf", ".zip"), read_imdf_map, options=("origin", "level")),
)


def load_world(
    path: str | os.PathLike[str],
    *,
    robot_radius: float,
    unknown_is_free: bool = False,
    cell_size_m: float | None = None,
    level: str | None = None,
    origin: tuple[float, float] | None = None,
    coarsen: int | None = None,
    despeckle_m: float | None = None,
    keepout: str | os.PathLike[str] | None = None,
    zones: str | os.PathLike[str] | None = None,
) -> World:
    """The world that a map file shows to a robot.

    Parameters
    ----------
    path : path of a ``.yaml``, ``.building.yaml``, ``.map``, ``.dxf``, ``.geojson`` or ``.imdf`` file
    robot_radius : metres, >= 0
    unknown_is_free : take unknown cells of a ROS map for free ones; they are obstacles otherwise
    cell_size_m : size of a cell of a MovingAI map (default 1 m), which does not say; the other formats do
    level : which level of an Open-RMF building or an IMDF venue that has several
    origin : (longitude, latitude) in degrees, for GeoJSON and IMDF in degrees
        Where x = y = 0 is to be: coordinates become metres east and north of it, in the plane that touches the Earth
        (WGS 84) there. Degrees are refused without.
    coarsen : take so many by so many cells of a large map for one, which is an obstacle if one of them is
    despeckle_m : groups of occupied cells that are no wider and no higher are taken for noise of the sensor, not walls
    keepout : path of a keepout mask of nav2's, a ROS map: what it marks is an obstacle too, also to sight
    zones : path of a zone file, optional
        Floors of other noise, for maps of any format (`driftplan.world.zone_files`); they cover the map's own.

    Raises MapError if the file is missing, broken, too large or not a map: the message names file and line, key or
    feature; ValueError if an argument is out of range or means nothing for this format.

    >>> world = load_world(bundled_map("office"), robot_radius=0.3)
    >>> len(world.zones)
    1
    """
    path = Path(path)
    form = format_of(path, FORMATS, "a map")
    cells = {"cell_size_m": cell_size_m, "coarsen": coarsen, "despeckle_m": despeckle_m}
    given = {"unknown_is_free": unknown_is_free or None, "level": level, "origin": origin, **cells}
    world: World = form.read(path, robot_radius=robot_radius, **own_options(path, form, FORMATS, given))
    if keepout is not None:
        mask = read_ros_map(Path(keepout), robot_radius=robot_radius, unknown_is_free=True)
        if not mask.obstacles.intersects(shapely.box(*world.bounds)):
            raise MapError(f"{keepout}: nothing that is marked lies on the map: is the origin right?")
        walls = shapely.get_parts(shapely.union(world.obstacles, mask.obstacles))
        world = replace(world, obstacles=shapely.MultiPolygon([part for part in walls if part.area > 0]))
    if zones is not None:
        added = load_zones(zones, origin=origin)
        if not any(zone.polygon.intersects(shapely.box(*world.bounds)) for zone in added):
            raise MapError(f"{zones}: no zone touches the map, whose bounds are {world.bounds}: is the origin right?")
        world = replace(world, zones=(*world.zones, *added))
    return world


def save_world(world: World, path: str | os.PathLike[str], *, cell_size_m: float | None = None) -> None:
    """Write a world's map to a file (and, for ROS, a picture ``.pgm`` beside it), in the format of the suffix.

    GeoJSON keeps everything but the robot's radius. ROS and MovingAI maps are made of cells: a cell that an obstacle
    reaches into becomes an obstacle. Files get a temporary name first, so that none is ever half written.

    Parameters
    ----------
    cell_size_m : size of a cell: 0.05 m for ROS and 1 m for MovingAI maps unless given; GeoJSON has no cells.

    Raises ValueError if the format cannot hold the world's zones or origin, or an argument is out of range: nothing is
    written.

    >>> import tempfile
    >>> world = World.from_polygons([[(2, 0), (3, 0), (3, 4), (2, 4)]], bounds=(0, 0, 5, 4), robot_radius=0.4)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_world(world, Path(folder, "room.geojson"))
    ...     load_world(Path(folder, "room.geojson"), robot_radius=0.4).bounds
    (0.0, 0.0, 5.0, 4.0)
    """
    path = Path(path)
    form = format_of(path, FORMATS, "a map")
    if form.write is None:
        raise ValueError(f"{form.name} maps are read only: save it as .geojson")
    if form.cell_size_m is None:
        if cell_size_m is not None:
            raise ValueError(f"cell_size_m is for maps made of cells, which {form.name} maps are not")
        return write_files(form.write(world, path))
    if world.zones:
        raise ValueError(f"{form.name} maps have no zones, and this world has {len(world.zones)}: save it as .geojson")
    size = positive("cell_size_m", form.cell_size_m if cell_size_m is None else cell_size_m)
    return write_files(form.write(world, path, cell_size_m=size))


def bundled_maps() -> tuple[str, ...]:
    """Names of the maps that come with driftplan.

    >>> bundled_maps()
    ('office', 'warehouse')
    """
    return tuple(sorted(_bundled()))


def bundled_map(name: str) -> Path:
    """Path of a map that comes with driftplan, for `load_world`.

    >>> bundled_map("warehouse").name
    'warehouse.yaml'
    """
    if name not in bundled_maps():
        raise ValueError(f"expected one of the maps {', '.join(bundled_maps())}, got {name!r}")
    return _bundled()[name]


def _bundled() -> dict[str, Path]:
    folder = Path(__file__).parents[1] / "maps"
    return {path.stem: path for path in folder.iterdir() if path.suffix in (".yaml", ".geojson")}
