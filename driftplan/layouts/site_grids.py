"""Where beacons could go: grids over free space, spots along walls and along routes, off forbidden areas."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from driftplan.arrays import Floats, arguments_checked, bounded, positive
from driftplan.beacons.readings import waypoints_of
from driftplan.world.world import World

_MAX_SITES = 1e6  # far more than can be chosen from
_PLACES = 9  # of metres: sums of spacings are printed as people write them, 9.6 and not 9.600000000000001


@arguments_checked()
def grid_sites(world: World, spacing_m: float, *, forbidden: Sequence[Any] = ()) -> Floats:
    """Points of a square grid, ``spacing_m`` apart, where the robot's centre may be: (n, 2), row by row from below.

    Examples
    --------
    >>> world = World.from_polygons([[(2, 0), (3, 0), (3, 4), (2, 4)]], bounds=(0, 0, 5, 4), robot_radius=0.4)
    >>> grid_sites(world, 1.0).shape
    (16, 2)
    """
    spacing = positive("spacing_m", spacing_m)
    xmin, ymin, xmax, ymax = world.bounds
    bounded("sites of a grid", (xmax - xmin) * (ymax - ymin) / spacing**2, _MAX_SITES, "use a larger spacing_m")
    x, y = (
        low + spacing / 2 + spacing * np.arange(int((high - low) / spacing))
        for low, high in ((xmin, xmax), (ymin, ymax))
    )
    xy = np.round(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), _PLACES)
    return allowed(xy[world.is_free(xy)], forbidden)


@arguments_checked()
def wall_sites(world: World, spacing_m: float, *, forbidden: Sequence[Any] = ()) -> Floats:
    """Points on the outlines of the obstacles, at most ``spacing_m`` apart: (n, 2), outline by outline."""
    found = [np.zeros((0, 2))]
    for ring in shapely.get_rings(shapely.get_parts(world.obstacles)):
        found.append(_along(ring, positive("spacing_m", spacing_m))[:-1])
    return allowed(np.concatenate(found), forbidden)


def route_sites(routes: Sequence[Any], spacing_m: float, *, forbidden: Sequence[Any] = ()) -> Floats:
    """Points on the routes, at most ``spacing_m`` apart, ends included: (n, 2), route by route, none twice.

    Examples
    --------
    >>> route_sites([[(0, 0), (4, 0)]], 2.0).tolist()
    [[0.0, 0.0], [2.0, 0.0], [4.0, 0.0]]
    """
    spacing = positive("spacing_m", spacing_m)
    xy = np.concatenate([_along(shapely.LineString(waypoints_of(route)), spacing) for route in routes])
    _, first = np.unique(np.round(xy, 6), axis=0, return_index=True)
    return allowed(xy[np.sort(first)], forbidden)


def allowed(xy: Floats, forbidden: Sequence[Any]) -> Floats:
    """The points outside all ``forbidden`` areas: shapely polygons, or (n, 2) arrays of corners."""
    for area in forbidden:
        polygon = area if isinstance(area, shapely.Geometry) else shapely.Polygon(np.asarray(area, dtype=float))
        xy = xy[~shapely.intersects_xy(polygon, xy[:, 0], xy[:, 1])]
    return xy


def _along(line: Any, spacing: float) -> Floats:
    """Evenly spaced points of a line, both ends included."""
    bounded("sites along a line", line.length / spacing, _MAX_SITES, "use a larger spacing_m")
    parts = max(1, int(np.ceil(line.length / spacing - 1e-9)))
    places = np.linspace(0.0, line.length, parts + 1)
    return np.asarray(np.round(shapely.get_coordinates(shapely.line_interpolate_point(line, places)), _PLACES))
