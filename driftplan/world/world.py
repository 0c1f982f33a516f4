"""World: where a disc-shaped robot can drive on a map, what it can see there, and where its odometry is worse.

All coordinates are metres in the map's frame, x to the right, y up (REP-103).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, isfinite, pi
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPolygon, Polygon

from driftplan.model.noise import OdometryNoise

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_QUAD_SEGS = 8
# A buffer replaces arcs by chords of at most 1.5 * 90°/quad_segs (GEOS rounds the number of chords of an arc to the
# nearest integer), which pass inside the circle. Growing the radius by 1/cos(half a chord) puts them outside.
_CHORD_FACTOR = 1 / cos(0.75 * (pi / 2) / _QUAD_SEGS) + 1e-9
_WALL_DEPTH = 1e-6  # m: a line of sight may graze a wall this deep, so that a beacon mounted on a wall can be seen
_STEP_IN = 1e-6  # m: points moved into free space are moved this far past its boundary


@dataclass(frozen=True, eq=False)
class Zone:
    """A polygon in which odometry is noisier or better: wet floor, carpet, gravel, a featureless corridor.

    Parameters
    ----------
    polygon : shapely Polygon or MultiPolygon, or (n, 2) array of its corners in metres
    noise : OdometryNoise
        Replaces, inside the polygon, the noise that holds elsewhere.

    Examples
    --------
    >>> Zone([(0, 0), (4, 0), (4, 3)], OdometryNoise(heading_var_per_m=1e-3)).polygon.area
    6.0
    """

    polygon: Polygon | MultiPolygon
    noise: OdometryNoise

    def __post_init__(self) -> None:
        object.__setattr__(self, "polygon", _polygon("zone polygon", self.polygon))
        if not isinstance(self.noise, OdometryNoise):
            raise ValueError(f"expected the noise of a zone to be an OdometryNoise, got {self.noise!r}")


@dataclass(frozen=True, eq=False, kw_only=True)
class World:
    """A map as one robot sees it: a disc of ``robot_radius`` that must not touch obstacles nor leave the map.

    The inflation is conservative: whatever ``is_free`` and ``segments_free`` accept keeps the robot's centre at least
    ``robot_radius`` away from every obstacle and from the edge of the map, and they refuse nothing that is farther away
    than 1.012 times that.

    Parameters
    ----------
    obstacles : shapely geometry of polygons
        Walls as drawn, not inflated.
    bounds : (xmin, ymin, xmax, ymax)
        The map's extent in metres; the outside counts as an obstacle for driving, and as air for seeing.
    robot_radius : float
        Metres, >= 0.
    zones : sequence of Zone
        Where zones overlap, the later one holds.

    Raises
    ------
    ValueError
        If the bounds are empty, the radius is negative, or anything is not finite.

    Examples
    --------
    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> world.is_free([[2, 2], [5, 5]]).tolist()
    [True, False]
    >>> world.segments_free([[2, 2], [2, 2]], [[2, 9], [8, 2]]).tolist()
    [True, False]
    """

    obstacles: MultiPolygon
    bounds: tuple[float, float, float, float]
    robot_radius: float
    zones: tuple[Zone, ...] = ()

    def __post_init__(self) -> None:
        parts = [_polygon("obstacle", part) for part in shapely.get_parts(self.obstacles)]
        object.__setattr__(self, "obstacles", MultiPolygon([p for part in parts for p in shapely.get_parts(part)]))
        object.__setattr__(self, "bounds", _bounds(self.bounds))
        radius = float(self.robot_radius)
        if not (isfinite(radius) and radius >= 0):
            raise ValueError(f"expected robot_radius finite and >= 0 m, got {self.robot_radius!r}")
        object.__setattr__(self, "robot_radius", radius)
        zones = tuple(self.zones)
        for zone in zones:
            if not isinstance(zone, Zone):
                raise ValueError(f"expected zones to be Zone(polygon, noise), got {zone!r}")
        object.__setattr__(self, "zones", zones)

    @classmethod
    def from_polygons(
        cls,
        obstacles: Iterable[Polygon | MultiPolygon | ArrayLike],
        *,
        bounds: Sequence[float],
        robot_radius: float,
        zones: Iterable[Zone] = (),
    ) -> World:
        """A world from obstacle polygons (shapely, or (n, 2) arrays of corners), which may overlap.

        Examples
        --------
        >>> World.from_polygons([], bounds=(0, 0, 4, 3), robot_radius=0.5).free.area
        6.0
        """
        drawn = [_polygon(f"obstacle {i}", obstacle) for i, obstacle in enumerate(obstacles)]
        merged = MultiPolygon(list(shapely.get_parts(shapely.union_all(drawn)))) if drawn else MultiPolygon()
        return cls(obstacles=merged, bounds=_bounds(bounds), robot_radius=robot_radius, zones=tuple(zones))

    @cached_property
    def free(self) -> Polygon | MultiPolygon:
        """Where the robot's centre may be, as a shapely area."""
        xmin, ymin, xmax, ymax = self._inner_bounds
        if xmin >= xmax or ymin >= ymax:
            return Polygon()
        return shapely.box(xmin, ymin, xmax, ymax).difference(self._inflated)

    @cached_property
    def free_parts(self) -> tuple[Polygon, ...]:
        """The connected parts of free space, largest first."""
        return tuple(sorted(shapely.get_parts(self.free), key=lambda part: -part.area))

    def is_free(self, xy: ArrayLike) -> Bools:
        """Whether the robot's centre may be at each of the points ``(..., 2)``; shape ``(...)``."""
        xy = _points("xy", xy)
        x, y = xy[..., 0], xy[..., 1]
        return np.asarray(self._inside(x, y) & ~shapely.intersects_xy(self._inflated, x, y))

    def segments_free(self, a: ArrayLike, b: ArrayLike) -> Bools:
        """Whether the robot can drive straight from ``a`` to ``b``, ``(..., 2)`` each, broadcast; shape ``(...)``.

        This is the one test that decides whether a straight motion is free of collisions.
        """
        a, b = np.broadcast_arrays(_points("a", a), _points("b", b))
        inside = np.asarray(self._inside(a[..., 0], a[..., 1]) & self._inside(b[..., 0], b[..., 1]))
        lines = shapely.linestrings(np.stack([a[inside], b[inside]], axis=-2))
        free = inside.copy()
        free[inside] = ~shapely.intersects(self._inflated, lines)
        return free

    def point_free(self, x: float, y: float) -> bool:
        """`is_free` for one point, at the least cost per call."""
        xmin, ymin, xmax, ymax = self._inner_bounds
        return xmin < x < xmax and ymin < y < ymax and not shapely.intersects_xy(self._inflated, x, y)

    def segment_free(self, x0: float, y0: float, x1: float, y1: float) -> bool:
        """`segments_free` for one segment, at the least cost per call."""
        xmin, ymin, xmax, ymax = self._inner_bounds
        if not (xmin < x0 < xmax and xmin < x1 < xmax and ymin < y0 < ymax and ymin < y1 < ymax):
            return False
        return not shapely.intersects(self._inflated, shapely.linestrings([x0, x1], [y0, y1]))

    def line_of_sight(self, a: ArrayLike, b: ArrayLike) -> Bools:
        """Whether ``b`` can be seen from ``a``, ``(..., 2)`` each, broadcast: no (uninflated) obstacle in between.

        Rays may graze a wall and end on one, so that a beacon mounted on a wall can be seen.
        """
        a, b = np.broadcast_arrays(_points("a", a), _points("b", b))
        lines = shapely.linestrings(np.stack([a, b], axis=-2))
        return np.asarray(~shapely.intersects(self._opaque, lines))

    def nearest_free(self, xy: ArrayLike) -> Floats:
        """The free point nearest to ``xy`` (2,), up to micrometres; ``xy`` itself where that is free.

        Raises
        ------
        ValueError
            If no place of the map is free for this robot.
        """
        x, y = _point("xy", xy)
        if self.point_free(x, y):
            return np.array([x, y])
        here = shapely.Point(x, y)
        for margin in (_STEP_IN, 100 * _STEP_IN, 1e4 * _STEP_IN):  # slivers thinner than the last one do not count
            roomy = self.free.buffer(-margin, join_style="mitre")
            if roomy.is_empty:
                break
            nearest = shapely.shortest_line(roomy, here).coords[0]
            if self.point_free(*nearest):
                return np.array(nearest)
        raise ValueError(f"no place of this map is free for a robot of radius {self.robot_radius} m")

    @cached_property
    def _inner_bounds(self) -> tuple[float, float, float, float]:
        xmin, ymin, xmax, ymax = self.bounds
        return xmin + self.robot_radius, ymin + self.robot_radius, xmax - self.robot_radius, ymax - self.robot_radius

    @cached_property
    def _inflated(self) -> Any:
        """Where the robot's centre would hit an obstacle, prepared; a little more than that, never less."""
        if self.robot_radius > 0:  # part by part, then merged: several times faster than all at once
            grown = shapely.buffer(
                shapely.get_parts(self.obstacles), self.robot_radius * _CHORD_FACTOR, quad_segs=_QUAD_SEGS
            )
            inflated = shapely.union_all(grown)
        else:
            inflated = self.obstacles
        shapely.prepare(inflated)
        return inflated

    @cached_property
    def _opaque(self) -> Any:
        opaque = self.obstacles.buffer(-_WALL_DEPTH, join_style="mitre")
        shapely.prepare(opaque)
        return opaque

    def _inside(self, x: Floats, y: Floats) -> Bools:
        xmin, ymin, xmax, ymax = self._inner_bounds
        return (x > xmin) & (x < xmax) & (y > ymin) & (y < ymax)


def _points(name: str, value: ArrayLike) -> Floats:
    try:
        points = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as err:
        raise ValueError(f"expected {name} to be an array of points (..., 2) in metres, got {value!r}") from err
    if points.ndim < 1 or points.shape[-1] != 2:
        raise ValueError(f"expected {name} to be points (..., 2) in metres, got an array of shape {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(f"expected {name} finite, got NaN or infinite coordinates")
    return points


def _point(name: str, value: ArrayLike) -> tuple[float, float]:
    point = _points(name, value)
    if point.shape != (2,):
        raise ValueError(f"expected {name} to be one point (2,), got an array of shape {point.shape}")
    return float(point[0]), float(point[1])


def _bounds(value: Sequence[float]) -> tuple[float, float, float, float]:
    bounds = tuple(float(v) for v in value)
    if len(bounds) != 4 or not all(isfinite(v) for v in bounds) or bounds[0] >= bounds[2] or bounds[1] >= bounds[3]:
        raise ValueError(f"expected bounds (xmin, ymin, xmax, ymax), finite and not empty, got {bounds!r}")
    return bounds


def _polygon(name: str, value: Any) -> Polygon | MultiPolygon:
    """A valid polygon or multipolygon of finite coordinates."""
    if not isinstance(value, (Polygon, MultiPolygon)):
        corners = _points(name, value)
        if corners.ndim != 2 or len(corners) < 3:
            raise ValueError(
                f"expected {name} to have at least 3 corners (n, 2), got an array of shape {corners.shape}"
            )
        value = Polygon(corners)
    if value.is_empty or not np.isfinite(shapely.get_coordinates(value)).all():
        raise ValueError(f"expected {name} to be finite and not empty, got {value.wkt[:80]}")
    if not value.is_valid:
        raise ValueError(f"expected {name} to be a valid polygon, got {shapely.is_valid_reason(value)}")
    return value
