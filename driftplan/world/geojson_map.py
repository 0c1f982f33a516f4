"""GeoJSON maps: a FeatureCollection of polygons in metres, each with a "kind".

The one feature of kind "boundary" is the map's area; outside of it everything is an obstacle. Features of kind
"obstacle" are walls. Features of kind "zone" carry their noise as properties named like the fields of OdometryNoise; a
later zone covers an earlier one. Coordinates are metres in the map's frame, not the degrees of RFC 7946.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from reprlib import repr as short
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon

from driftplan.arrays import Floats, point_of
from driftplan.errors import MapError, naming
from driftplan.files import VERSION, plain_numbers
from driftplan.model.noise import OdometryNoise
from driftplan.world.plain_data import json_of, read_json
from driftplan.world.world import World
from driftplan.world.zones import Zone

_MEANINGS = ("boundary", "obstacle", "zone")
_NOISE_KEYS = tuple(field.name for field in fields(OdometryNoise))
_LOCAL_METRES = {"type": "name", "properties": {"name": 'LOCAL_CS["map frame",UNIT["metre",1]]'}}
_NOT_METRES = re.compile(
    r"CRS:?:?8[34]|EPSG:+(?:4326|4258|4269|3857|3395|900913)\b|WGS ?84\b(?! / UTM)|[Mm]ercator|GEOGCS"
)
_STRETCHED = re.compile("3857|3395|900913|ercator")
_PROJECT = (
    "project the map first, say to UTM (ogr2ogr -t_srs EPSG:32632), or give degrees an origin=(lon, lat) (--origin)"
)
_LEAST_EXTENT_M = 0.5  # of a map: no robot drives on less
_MAX_COORDINATE = 1e9
_TEXT = json.JSONEncoder(allow_nan=False)
Area: TypeAlias = Polygon | MultiPolygon
Origin = tuple[float, float] | None
KINDS = ("Point", "MultiPoint", "LineString", "MultiLineString", "Polygon", "MultiPolygon")
# Beyond these, merging the walls and growing them would take minutes; plans of buildings stay far below.
_MAX_POSITIONS = 50_000
_MAX_CROSSINGS = 20_000
_MAX_NEAR = 2_000_000  # pairs of edges that might cross


def read_geojson_map(path: Path, *, robot_radius: float, origin: tuple[float, float] | None = None) -> World:
    """World of a GeoJSON file; coordinates in degrees take the ``origin`` (longitude, latitude) of the map."""
    boundary, obstacles, zones = list[Area](), list[Area](), list[Zone]()
    for feature in read_features(path, origin=origin):
        where, properties = feature.where, feature.properties
        kind = properties.get("kind")
        if kind not in _MEANINGS:
            raise MapError(f'{where}: expected a property "kind" out of {", ".join(_MEANINGS)}, got {short(kind)}')
        area = area_of(where, feature)
        if kind == "zone":
            noise = {key: value for key, value in properties.items() if key not in ("kind", "name")}
            zones.append(Zone(area, zone_noise(where, noise)))
            continue
        if noisy := [key for key in properties if key in _NOISE_KEYS]:
            raise MapError(f"{where}: only zones have noise, but this {kind} has {noisy[0]!r}")
        (boundary if kind == "boundary" else obstacles).append(area)
    if len(boundary) != 1:
        raise MapError(f'{path}: expected one feature of "kind": "boundary", the area of the map, got {len(boundary)}')
    refuse_tangles(path, [*boundary, *obstacles])
    return World.within(boundary[0], obstacles, robot_radius=robot_radius, zones=zones)


def geojson_map_files(world: World, path: Path) -> dict[Path, bytes]:
    """Contents of the file to write: nothing is lost but the robot's radius."""
    features = [_feature(shapely.box(*world.bounds), kind="boundary")]
    features += [_feature(part, kind="obstacle") for part in world.obstacles.geoms]
    features += [_feature(zone.polygon, kind="zone", **zone.noise.given()) for zone in world.zones]
    return {path: feature_collection(features)}


def feature_collection(features: Sequence[dict[str, Any]], **members: Any) -> bytes:
    """A GeoJSON FeatureCollection, a feature per line, that says that its coordinates are metres of a local frame, and
    in its member ``driftplan`` the version, the frame and what else there is to say.

    RFC 7946 has longitudes and latitudes only. GDAL, and so QGIS and geopandas, reads the member ``crs`` of the older
    standard and takes this one for an engineering frame: nothing is drawn off the coast of Africa.
    """
    about = {"version": VERSION, "frame": "map", **members}
    head = json.dumps({"type": "FeatureCollection", "crs": _LOCAL_METRES, "driftplan": about}, allow_nan=False)
    lines = ",\n".join(json.dumps(plain_numbers(feature), allow_nan=False) for feature in features)
    return f'{head[:-1]}, "features": [\n{lines}\n]}}\n'.encode()


def _feature(area: Any, **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": json.loads(shapely.to_geojson(area))}


class Feature(NamedTuple):
    """A feature of a FeatureCollection."""

    where: str  # in the file, for messages
    id: Any
    properties: dict[str, Any]
    kind: str  # of the geometry
    geometry: Any  # of shapely, in metres, without heights, not empty; None if its kind was not asked for


def read_features(
    path: Path, kinds: Sequence[str] = KINDS, *, text: bytes | None = None, metres: bool = False, origin: Origin = None
) -> list[Feature]:
    """The features of a GeoJSON FeatureCollection in metres, as they are whatever ``crs`` is said if ``metres``, else
    degrees about the ``origin``; a file that is none is a `MapError`. ``text`` is what it holds, if that was read."""
    held = read_json(path) if text is None else json_of(path, text)
    is_one = isinstance(held, dict) and held.get("type") == "FeatureCollection"
    if not (is_one and isinstance(held.get("features"), list)):
        raise MapError(f"{path}: expected a GeoJSON FeatureCollection with a list of features")
    declared = json.dumps(held.get("crs"))
    features = []
    for k, one in enumerate(held["features"], start=1):
        where = f"{path}, feature {k}"
        if not isinstance(one, dict):
            raise MapError(f"{where}: expected a Feature, got {short(one)}")
        said, shape = (part if isinstance(part, dict) else {} for part in map(one.get, ("properties", "geometry")))
        kind = str(shape.get("type"))
        features.append(Feature(where, one.get("id"), said, kind, _shape(where, shape) if kind in kinds else None))
    if metres or "LOCAL_CS" in declared:
        return features
    name, shapes = _NOT_METRES.search(declared), np.array([feature.geometry for feature in features], dtype=object)
    if origin is not None and (name is None or not _STRETCHED.search(name[0])):
        with naming(path, MapError):
            placed = zip(features, projected(shapes, origin), strict=True)
            return [feature._replace(geometry=shape) for feature, shape in placed]
    if name:
        stretched = "in degrees, or in metres that the latitude stretches"
        raise MapError(f"{path}: coordinates are {stretched} (crs {name[0]}); expected metres: {_PROJECT}")
    xy = shapely.get_coordinates(shapes)
    if len(xy) and (np.abs(xy) <= (180.0, 90.0)).all() and 0 < np.ptp(xy, axis=0).max() < _LEAST_EXTENT_M:
        seems = f"less than {_LEAST_EXTENT_M} m wide, these look like longitudes and latitudes"
        raise MapError(f"{path}: {seems}; expected metres: {_PROJECT}")
    return features


def _shape(where: str, held: dict[str, Any]) -> Any:
    try:
        shape = shapely.from_geojson(_TEXT.encode(held))
        if not all(abs(bound) < _MAX_COORDINATE for bound in shape.bounds):  # nan if there are none
            raise ValueError(f"none, or one beyond {_MAX_COORDINATE:g}")
    except (shapely.GEOSException, ValueError, RecursionError) as err:
        fault, listed = re.split(r"[:\]] ", str(err))[-1].strip("'\n"), short(held.get("coordinates"))
        raise MapError(
            f"{where}: expected positions [x, y] in metres, the last of a ring like its first, got {listed} ({fault})"
        ) from err
    return shapely.force_2d(shape)


def projected(shapes: NDArray[Any], origin: tuple[float, float]) -> NDArray[Any]:
    """Geometries in degrees of longitude and latitude, in metres east and north of the ``origin``.

    On the plane that touches the ellipsoid of WGS 84 there: a kilometre away distances are right to 0.1 mm.
    """
    longitude, latitude = point_of("origin", origin)
    degrees = shapely.get_coordinates(shapes)
    if not (abs(longitude) <= 180 and abs(latitude) < 90):
        raise ValueError(f"expected origin to be a longitude and a latitude in degrees, got {tuple(origin)}")
    if len(far := degrees[(np.abs(degrees) > (180, 90)).any(axis=1)]):
        raise ValueError(f"expected longitudes and latitudes, since an origin is given, got {far[0].tolist()}")
    along, up = np.radians([longitude, latitude])
    east = [-np.sin(along), np.cos(along), 0.0]
    north = [-np.sin(up) * np.cos(along), -np.sin(up) * np.sin(along), np.cos(up)]
    metres = (_on_earth(degrees) - _on_earth(np.array([[longitude, latitude]]))) @ np.transpose([east, north])
    return np.asarray(shapely.set_coordinates(shapes.copy(), metres))


def _on_earth(degrees: Floats) -> Floats:
    """Where longitudes and latitudes (n, 2) are, in metres from the middle of the Earth, (n, 3)."""
    (along, up), flat = np.radians(degrees).T, 0.00669437999014
    radius = 6378137.0 / np.sqrt(1 - flat * np.sin(up) ** 2)
    across = radius * np.cos(up)
    return np.stack([across * np.cos(along), across * np.sin(along), (1 - flat) * radius * np.sin(up)], axis=1)


def area_of(where: str, feature: Feature) -> Area:
    """The polygons of a feature."""
    area = feature.geometry
    if not isinstance(area, (Polygon, MultiPolygon)):
        raise MapError(f"{where}: expected a Polygon or MultiPolygon, got {feature.kind}")
    if not area.is_valid:
        raise MapError(f"{where}: not a valid polygon: {shapely.is_valid_reason(area)}")
    return area


def refuse_tangles(path: Path, areas: list[Area]) -> None:
    """Raise MapError for so many positions, or crossings of edges, that they cannot be merged in bounded time."""
    count = int(np.sum(shapely.get_num_coordinates(areas)))
    if count > _MAX_POSITIONS:
        raise MapError(f"{path}: expected at most {_MAX_POSITIONS} positions of walls, got {count}")
    rings = [shapely.get_coordinates(ring) for ring in shapely.get_rings(shapely.get_parts(areas))]
    edges = shapely.linestrings(np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings]))
    tree, near, crossing = shapely.STRtree(edges), 0, 0
    for first in range(0, len(edges), 100):
        some, others = tree.query(edges[first : first + 100])
        near += len(some)
        if near <= _MAX_NEAR:
            crossing += int(np.sum(shapely.crosses(edges[first + some], edges[others])))
        if near > _MAX_NEAR or crossing > 2 * _MAX_CROSSINGS:  # every pair is met twice
            crossed = f"the walls cross each other more than {_MAX_CROSSINGS} times"
            raise MapError(f"{path}: {crossed}; merge or simplify them")


def zone_noise(where: str, said: dict[Any, Any]) -> OdometryNoise:
    """The noise of a zone, from values named like the fields of OdometryNoise."""
    if unknown := [key for key in said if key not in _NOISE_KEYS]:
        raise MapError(f"{where}: unknown noise {short(unknown[0])}; known are {', '.join(_NOISE_KEYS)}")
    if not said:
        raise MapError(f"{where}: expected the zone's noise, such as heading_var_per_m, got none")
    with naming(where, MapError):
        return OdometryNoise(**said)
