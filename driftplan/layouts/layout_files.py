"""Layouts as files: GeoJSON that driftplan reads back, and what whoever installs the beacons needs to know.

Coordinates are metres of the map's frame, not longitude and latitude, and the files say so.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from dataclasses import asdict, fields
from math import hypot, isfinite, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from driftplan.arrays import arguments_checked
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.errors import MapError
from driftplan.layouts.layout import Layout
from driftplan.world.geojson_map import feature_collection, read_features

_KIND = tuple(f.name for f in fields(BeaconKind))


class InstallerRow(NamedTuple):
    """One beacon, for whoever puts it up."""

    id: str
    kind: str
    x_m: float
    y_m: float
    facing_deg: float  # which way it looks, counter-clockwise from +x; nan where that does not matter
    new: bool
    nearest_wall_m: float  # nan without a map, or without walls
    wall_x_m: float
    wall_y_m: float
    routes: tuple[int, ...]  # that come within range, by their place in the list, from 0
    worst_drift_if_dead_m: float  # nan if no route does
    worst_route_if_dead: int  # -1 if no route does


@arguments_checked()
def installer_table(layout: Layout) -> tuple[InstallerRow, ...]:
    """All beacons of a layout, the ones whose failure hurts most first."""
    world = layout.scenario.world
    places = shapely.points(np.array([beacon.xy for beacon, *_ in layout.importance]).reshape(-1, 2))
    walls = np.full((len(places), 2), nan)
    if world is not None and not world.obstacles.is_empty:
        walls = shapely.get_coordinates(shapely.shortest_line(world.obstacles.boundary, places))[::2]
    rows = [
        InstallerRow(
            id=beacon.id,
            kind=beacon.kind.name,
            x_m=beacon.x,
            y_m=beacon.y,
            facing_deg=nan if beacon.facing_deg is None else beacon.facing_deg,
            new=beacon in layout.beacons,
            nearest_wall_m=hypot(wall_x - beacon.x, wall_y - beacon.y),
            wall_x_m=wall_x,
            wall_y_m=wall_y,
            routes=routes,
            worst_drift_if_dead_m=worst,
            worst_route_if_dead=worst_route,
        )
        for (beacon, routes, worst, worst_route), (wall_x, wall_y) in zip(
            layout.importance, walls.tolist(), strict=True
        )
    ]
    return tuple(sorted(rows, key=lambda row: -row.worst_drift_if_dead_m if row.routes else 0.0))


@arguments_checked()
def layout_csv(layout: Layout) -> bytes:
    """The installers' table as CSV, to a tenth of a millimetre, with a header that names units.

    Numbers of routes are separated by spaces; a cell without a number is empty.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(InstallerRow._fields)
    for row in installer_table(layout):
        writer.writerow([_cell(value) for value in row])
    return text.getvalue().encode()


def _cell(value: Any) -> Any:
    if isinstance(value, tuple):
        return " ".join(map(str, value))
    if isinstance(value, float):
        return round(value, 4) if isfinite(value) else ""
    return value


@arguments_checked()
def layout_geojson(layout: Layout) -> bytes:
    """Beacons as points with all that `load_beacons` needs, and what their failure does."""
    features = [
        _feature(
            beacon,
            new=beacon in layout.beacons,
            routes=routes,
            worst_drift_if_dead_m=round(worst, 6) if routes else None,
        )
        for beacon, routes, worst, _ in layout.importance
    ]
    summary = {
        "version": 1,
        "cost": layout.cost,
        "lower_bound": layout.lower_bound,
        "proven": layout.proven,
        "worst_drift_m": round(layout.worst_drift, 6),
    }
    return feature_collection(features, driftplan=summary)


def beacons_geojson(beacons: Sequence[Beacon]) -> bytes:
    """Beacons as points that `load_beacons` reads back.

    Examples
    --------
    >>> import tempfile
    >>> tag = Beacon(BeaconKind.rfid(range_m=1.5, position_std_m=0.1), x=3.0, y=4.0, id="A7")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "beacons.geojson")
    ...     _ = file.write_bytes(beacons_geojson([tag]))
    ...     load_beacons(file) == (tag,)
    True
    """
    return feature_collection([_feature(beacon) for beacon in beacons])


def load_beacons(path: str | os.PathLike[str]) -> tuple[Beacon, ...]:
    """Beacons of a GeoJSON file, as `layout_geojson` and `beacons_geojson` write it.

    Point features in metres; properties by the names of `BeaconKind` (``range_m`` and a ``position_std_m``,
    ``heading_std``, ``range_std_m`` or ``bearing_std`` at least, ``kind`` for its name), ``facing_deg`` and ``id``.
    Features that are no points are passed over, so a map and its beacons may share a file; other properties are too. A
    file without features holds no beacons.

    Raises
    ------
    MapError : if the file cannot be read or a point is no beacon: the message names the file and the feature
    """
    path = Path(path)
    try:
        features = read_features(path)
    except OSError as err:
        raise MapError(f"{path}: cannot be read: {err.strerror or err}") from err
    found = []
    for number, feature in enumerate(features, start=1):
        where = f"{path}, feature {number}"
        geometry = feature.get("geometry") if isinstance(feature, dict) else None
        if not isinstance(geometry, dict) or geometry.get("type") != "Point":
            continue
        properties = feature.get("properties")
        if not isinstance(properties, dict):
            raise MapError(f"{where}: expected properties such as range_m and position_std_m, got none")
        values = {"name": properties.get("kind", "beacon")} | {k: properties[k] for k in _KIND[1:] if k in properties}
        try:
            x, y = geometry["coordinates"][:2]
            facing, name = properties.get("facing_deg"), str(properties.get("id", ""))
            found.append(Beacon(BeaconKind(**values), x, y, id=name, facing_deg=facing))
        except (KeyError, TypeError, ValueError) as err:
            raise MapError(f"{where}: expected a beacon: {err}") from err
    if features and not found:
        raise MapError(f"{path}: expected at least one Point feature with the properties of a beacon, got none")
    return tuple(found)


def _feature(beacon: Beacon, **more: Any) -> dict[str, Any]:
    kind = {name: value for name, value in asdict(beacon.kind).items() if name != "name" and value is not None}
    facing = {} if beacon.facing_deg is None else {"facing_deg": beacon.facing_deg}
    return {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [beacon.x, beacon.y]},
        "properties": {"id": beacon.id, "kind": beacon.kind.name, **kind, **facing, **more},
    }
