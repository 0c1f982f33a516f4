"""A layout in the files of installers, robots and fleets."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from math import atan2, hypot, isfinite, nan, pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from driftplan.beacons.beacon_files import beacon_feature, marks_of
from driftplan.files import VERSION, head
from driftplan.layouts.layout import Layout
from driftplan.tables import NONE, decimals, html_table, numbers
from driftplan.world.building_map import building_with_marks
from driftplan.world.dxf_map import drawing_of
from driftplan.world.geojson_map import feature_collection
from driftplan.world.route_graphs import RouteGraph, graph_lif

_MAX_NUMBERS = 6  # of routes that a beacon serves, for people
_NEAR_M = 1e-3  # what is no farther from a wall is on it


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


def installer_table(layout: Layout) -> tuple[InstallerRow, ...]:
    """All beacons of a layout, the ones whose failure hurts most first.

    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> [(row.id, row.x_m, round(row.worst_drift_if_dead_m, 3)) for row in installer_table(layout)]
    [('S3', 2.857142857, 0.577)]
    """
    return tuple(sorted(installer_rows(layout), key=lambda row: -row.worst_drift_if_dead_m if row.routes else 0.0))


def installer_columns(rows: Sequence[InstallerRow], what: str = "drift") -> dict[str, list[str]]:
    """The table as people read it: headings and cells."""
    return {
        "id": [row.id for row in rows],
        "kind": [row.kind if row.new else f"{row.kind} (existing)" for row in rows],
        **numbers([row._asdict() for row in rows], 2, "x_m", "y_m", "nearest_wall_m"),
        "mounted": [_mounted(row) for row in rows],
        "routes served": [_numbers(row.routes) for row in rows],
        f"{what} if dead m": decimals([row.worst_drift_if_dead_m for row in rows], 3),
        "on route": [NONE if row.worst_route_if_dead < 0 else str(row.worst_route_if_dead) for row in rows],
    }


def _mounted(row: InstallerRow) -> str:
    """Which way it looks, or on which side of its wall it is, seen from above."""
    if isfinite(row.facing_deg):
        return f"faces {row.facing_deg:.0f}°"
    if not isfinite(row.nearest_wall_m):
        return NONE
    if row.nearest_wall_m <= _NEAR_M:
        return "on the wall"
    ahead = atan2(row.y_m - row.wall_y_m, row.x_m - row.wall_x_m)
    return f"{('right of', 'above', 'left of', 'below')[round(ahead / (pi / 2)) % 4]} wall"


def _numbers(routes: tuple[int, ...]) -> str:
    """Numbers of routes, the first few of many."""
    text = ", ".join(map(str, routes[:_MAX_NUMBERS]))
    return f"{text}, … ({len(routes)})" if len(routes) > _MAX_NUMBERS else text or NONE


def layout_html(layout: Layout) -> bytes:
    """The installers' table as a page of HTML, which spreadsheets open too.

    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> layout_html(layout).count(b"<tr>")
    2
    """
    columns = installer_columns(installer_table(layout))
    body = html_table(columns, f"{layout!r}. Metres in the frame map; directions counter-clockwise from +x.")
    look = "table{border-collapse:collapse;font:14px sans-serif}td,th{border:1px solid #999;padding:2px 8px}"
    about = f'<meta charset="utf-8"><meta name="description" content="{head("map")[2:-1]}">'
    top = f"{about}<title>Beacon layout</title><style>{look}</style>"
    return f"<!DOCTYPE html>\n<html><head>{top}</head><body>{body}</body></html>\n".encode()


def installer_rows(layout: Layout) -> list[InstallerRow]:
    """All beacons of a layout, in their order, old ones first."""
    world, everyone = layout.scenario.world, layout.importance
    walls = np.full((len(everyone), 2), nan)
    if world is not None and not world.obstacles.is_empty:
        places = shapely.points(np.array([beacon.xy for beacon, *_ in everyone]).reshape(-1, 2))
        walls = shapely.get_coordinates(shapely.shortest_line(world.obstacles.boundary, places))[::2]
    rows = []
    for (beacon, routes, worst, worst_route), (wall_x, wall_y) in zip(everyone, walls.tolist(), strict=True):
        facing_deg = nan if beacon.facing_deg is None else beacon.facing_deg
        wall = hypot(wall_x - beacon.x, wall_y - beacon.y), wall_x, wall_y
        place = beacon.id, beacon.kind.name, beacon.x, beacon.y, facing_deg, beacon in layout.beacons
        rows.append(InstallerRow(*place, *wall, routes, worst, worst_route))
    return rows


def layout_csv(layout: Layout) -> bytes:
    """The installers' table as CSV, to a tenth of a millimetre, with a header that names units.

    Numbers of routes are separated by spaces; a cell without a number is empty. The last columns are the frame of the
    places and the version of the file.

    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> layout_csv(layout).decode().splitlines()[1]
    'S3,rfid,2.8571,0.0,,True,,,,0,0.5768,0,map,1'
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*InstallerRow._fields, "frame", "version"])
    for row in installer_table(layout):
        writer.writerow([*map(_cell, row), "map", VERSION])
    return text.getvalue().encode()


def _cell(value: Any) -> Any:
    if isinstance(value, tuple):
        return " ".join(map(str, value))
    if isinstance(value, float):
        return round(value, 4) if isfinite(value) else ""
    return value


def layout_geojson(layout: Layout) -> bytes:
    """Beacons as points with all that `load_beacons` needs, and what their failure does.

    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> layout_geojson(layout).count(b'"Feature"')
    1
    """
    features = [
        beacon_feature(beacon, new=beacon in layout.beacons, routes=routes, worst_drift_if_dead_m=dead_m)
        for beacon, routes, worst, _ in layout.importance
        for dead_m in [round(worst, 6) if routes else None]
    ]
    summary = {name: getattr(layout, name) for name in ("cost", "lower_bound", "proven")}
    worst_m = round(layout.worst_drift, 6)
    return feature_collection(features, **summary, worst_drift_m=worst_m)


def layout_dxf(layout: Layout) -> bytes:
    """A DXF drawing for installers, in metres: walls, routes, beacons with ids, coordinates, ranges and directions, and
    dimensions to the nearest walls; `load_beacons` reads it back.

    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> b"S3" in layout_dxf(layout)
    True
    """
    beacons = layout.everyone
    rows = (row for row in installer_rows(layout) if row.nearest_wall_m > _NEAR_M)
    walls = [((row.wall_x_m, row.wall_y_m), (row.x_m, row.y_m)) for row in rows]
    ranges = [(beacon.x, beacon.y, beacon.kind.range_m) for beacon in beacons]
    return drawing_of(layout.scenario.world, layout.scenario.routes, marks_of(beacons), ranges, walls)


def layout_lif(layout: Layout) -> bytes:
    """A layout in LIF for fleets: the routes as nodes and edges, beacons as stations; `load_beacons` reads it back.

    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> layout_lif(layout).count(b'"stationId"')
    1
    """
    return graph_lif(RouteGraph.of_routes(layout.scenario.routes), marks=marks_of(layout.everyone))


def layout_building(layout: Layout, building: str | os.PathLike[str], *, level: str | None = None) -> bytes:
    """An Open-RMF ``.building.yaml`` with the beacons as vertices of a level; `load_beacons` reads it back.

    >>> import tempfile
    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "site.building.yaml")
    ...     _ = file.write_text("levels: {L1: {vertices: [[0, 0, 0, a], [9, 0, 0, b]], "
    ...                         "measurements: [[0, 1, {distance: [3, 9.0]}]]}}")
    ...     layout_building(layout, file).count(b"driftplan_beacon")
    1
    """
    return building_with_marks(Path(building), marks_of(layout.everyone), level)
