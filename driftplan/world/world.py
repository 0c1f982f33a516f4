"""World: where a disc-shaped robot can drive on a map, what it can see there, and where its odometry is worse.

All coordinates are metres in the map's frame, x to the right, y up (REP-103).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from html import escape
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely import MultiPolygon, Polygon

from driftplan import arrays
from driftplan.arrays import Bools, Floats, Ints, bounds_of, instance, not_negative, point_of, points_of, positive
from driftplan.model.noise import OdometryNoise
from driftplan.world.inflation import Inflation
from driftplan.world.shapes import PreparedArea, polygon_of
from driftplan.world.zones import Zone, ZoneIndex, ZonePieces

_WALL_DEPTH = 1e-6  # m: a line of sight may graze a wall this deep, so that a beacon mounted on a wall can be seen
_STEP_IN = 1e-6  # m: a point moved into free space is moved this far past its boundary


@dataclass(frozen=True, eq=False, kw_only=True)
class World:
    """A map as one robot sees it: a disc of ``robot_radius`` that must not touch obstacles nor leave the map.

    The inflation is conservative: whatever `is_free` and `segments_free` accept keeps the robot's centre at least
    ``robot_radius`` away from every obstacle and from the edge of the map. What is more than 1.03 times that far away
    is accepted.

    Threads may share a world, processes may be forked while they do, and a world can be pickled (it derives again what
    it needs), as routes, layouts and noises can.

    Parameters
    ----------
    obstacles : shapely MultiPolygon, walls as drawn, not inflated
    bounds : (xmin, ymin, xmax, ymax), the map's extent in metres. The outside is an obstacle to driving, not to seeing.
    robot_radius : metres, >= 0
    zones : where zones overlap, the later one holds
    notes : what a person might not expect of the map's file

    Raises ValueError if the bounds are empty, the radius is negative, a polygon is invalid, or anything is not finite.

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
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        instance("obstacles", self.obstacles, MultiPolygon, Polygon)
        parts = shapely.get_parts(polygon_of("obstacles", self.obstacles)) if not self.obstacles.is_empty else []
        for zone in (zones := tuple(self.zones)):
            instance("a zone", zone, Zone)
        object.__setattr__(self, "obstacles", MultiPolygon(list(parts)))
        object.__setattr__(self, "bounds", bounds_of(self.bounds))
        object.__setattr__(self, "robot_radius", not_negative("robot_radius", self.robot_radius))
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

        >>> World.from_polygons([], bounds=(0, 0, 4, 3), robot_radius=0.5).free.area
        6.0
        """
        drawn = [polygon_of(f"obstacle {i}", obstacle) for i, obstacle in enumerate(obstacles)]
        merged = MultiPolygon(list(shapely.get_parts(shapely.union_all(drawn)))) if drawn else MultiPolygon()
        return cls(obstacles=merged, bounds=bounds_of(bounds), robot_radius=robot_radius, zones=tuple(zones))

    @classmethod
    def within(
        cls,
        ground: Polygon | MultiPolygon,
        obstacles: Sequence[Polygon | MultiPolygon],
        *,
        robot_radius: float,
        zones: Iterable[Zone] = (),
    ) -> World:
        """A world whose bounds are those of the ``ground``, outside of which everything is an obstacle."""
        instance("ground", ground, Polygon, MultiPolygon)
        outside = shapely.box(*ground.bounds).difference(ground)
        walls = [*obstacles, *([] if outside.is_empty else [outside])]
        return cls.from_polygons(walls, bounds=ground.bounds, robot_radius=robot_radius, zones=zones)

    # Driving

    @cached_property
    def free(self) -> Polygon | MultiPolygon:
        """Where the robot's centre may be, as a shapely area (its boundary belongs to the obstacles)."""
        xmin, ymin, xmax, ymax = self._inflation.bounds
        room = Polygon() if xmin >= xmax or ymin >= ymax else shapely.box(xmin, ymin, xmax, ymax)
        return room.difference(self._inflation.obstacles)

    @cached_property
    def free_parts(self) -> tuple[Polygon, ...]:
        """The connected parts of free space, largest first: no route leads from one to another."""
        parts = (part for part in shapely.get_parts(self.free) if not part.is_empty)
        return tuple(sorted(parts, key=lambda part: -part.area))

    @cached_property
    def _prepared_parts(self) -> tuple[PreparedArea, ...]:
        return tuple(map(PreparedArea, self.free_parts))

    def is_free(self, xy: ArrayLike) -> Bools:
        """Whether the robot's centre may be at each of the points ``(..., 2)``; shape ``(...)``."""
        return self._inflation.points_free(points_of("xy", xy))

    def segments_free(self, a: ArrayLike, b: ArrayLike) -> Bools:
        """Whether the robot can drive straight from ``a`` to ``b``, ``(..., 2)`` each, broadcast; shape ``(...)``.

        The one test that decides whether a straight motion is free of collisions.
        """
        return self._inflation.segments_free(*np.broadcast_arrays(points_of("a", a), points_of("b", b)))

    def point_free(self, x: float, y: float) -> bool:
        """The answer of `is_free` for one point, at the least cost per call."""
        try:
            return self._inflation.point_free(x, y)
        except (TypeError, ValueError):
            return self._inflation.point_free(arrays.number("x", x), arrays.number("y", y))

    def segment_free(self, x0: float, y0: float, x1: float, y1: float) -> bool:
        """The answer of `segments_free` for one segment, at the least cost per call."""
        try:
            return self._inflation.segment_free(x0, y0, x1, y1)
        except (TypeError, ValueError):
            return self._inflation.segment_free(*point_of("x0, y0", (x0, y0)), *point_of("x1, y1", (x1, y1)))

    def free_part(self, xy: ArrayLike) -> Ints:
        """Index into `free_parts` of the part that each of the points ``(..., 2)`` is in; -1 where not free.

        >>> wall = [(4, 0), (6, 0), (6, 10), (4, 10)]
        >>> world = World.from_polygons([wall], bounds=(0, 0, 12, 10), robot_radius=0.5)
        >>> world.free_part([[2, 5], [9, 5], [5, 5]]).tolist(), round(world.free_parts[0].area, 1)
        ([1, 0, -1], 45.0)
        """
        xy = points_of("xy", xy)
        part = np.full(xy.shape[:-1], -1, dtype=np.int64)
        free = np.asarray(self.is_free(xy))
        for i, polygon in enumerate(self._prepared_parts):
            if not (left := free & (part < 0)).any():
                break
            part[left] = np.where(shapely.intersects_xy(polygon.prepared, xy[left]), i, -1)
        if (left := free & (part < 0)).any():  # free, yet a round-off outside of all parts
            part[left] = shapely.STRtree(self.free_parts).nearest(shapely.points(xy[left]))
        return part

    def nearest_free(self, xy: ArrayLike) -> Floats:
        """The free point nearest to ``xy`` (2,), up to micrometres; ``xy`` itself where that is free.

        Raises ValueError if no place of the map is free for this robot.
        """
        x, y = point_of("xy", xy)
        if self.point_free(x, y):
            return np.array([x, y])
        here = shapely.Point(x, y)
        for margin in (_STEP_IN, 100 * _STEP_IN, 1e4 * _STEP_IN):  # the larger ones for coordinates of many digits
            roomy = self.free.buffer(-margin, join_style="mitre")
            if roomy.is_empty:
                break
            nearest = np.array(shapely.shortest_line(roomy, here).coords[0])
            if self.is_free(nearest):
                return nearest
        raise ValueError(f"no place of this map is free for a robot of radius {self.robot_radius} m")

    def corners(self, tolerance_m: float | None = None) -> Floats:
        """Free points just off the convex corners of the inflated obstacles, (n, 2): where shortest paths bend.

        The outline of the inflated obstacles is moved out by 1.5 tolerances and thinned out by Douglas and Peucker's
        method, to the tolerance where it bulges. Dents may be as deep as the shortest edge of a wall before they count,
        so that the stairs of a grid map give no corners. What remains are vertices of the moved outline that are free.

        Parameters
        ----------
        tolerance_m : default: a twentieth of the robot's radius, at least 1e-5 m. Paths round these corners are longer
            than the shortest by a few tolerances per corner; passages narrower than 3 tolerances get no corners.

        >>> pillar = [(4, 4), (6, 4), (6, 6), (4, 6)]
        >>> corners = World.from_polygons([pillar], bounds=(0, 0, 10, 10), robot_radius=0.5).corners()
        >>> corners.shape, corners.min(axis=0).round(2).tolist()
        ((16, 2), [3.46, 3.46])
        """
        tolerance = max(self.robot_radius / 20, 1e-5) if tolerance_m is None else positive("tolerance_m", tolerance_m)
        if tolerance not in self._corners:
            self._corners[tolerance] = self._found_corners(tolerance)
        return self._corners[tolerance].copy()

    def _found_corners(self, tolerance: float) -> Floats:
        walls = [np.diff(shapely.get_coordinates(ring), axis=0) for ring in shapely.get_rings(self.obstacles.geoms)]
        if not walls:
            return np.zeros((0, 2))
        dent = max(tolerance, float(np.min(np.hypot(*np.concatenate(walls).T))))
        outline = shapely.orient_polygons(self._inflation.obstacles.buffer(1.5 * tolerance, join_style="mitre"))
        found = []
        for ring in shapely.get_rings(shapely.get_parts(outline)):  # obstacles lie to the left of every ring
            corner = _thin_out(shapely.get_coordinates(ring), bulge_m=tolerance, dent_m=dent)[:-1]
            before, after = corner - np.roll(corner, 1, axis=0), np.roll(corner, -1, axis=0) - corner
            found.append(corner[before[:, 0] * after[:, 1] > before[:, 1] * after[:, 0]])
        corners = np.concatenate(found)
        return corners[self.is_free(corners)]

    @cached_property
    def _corners(self) -> dict[float, Floats]:
        return {}  # by tolerance: every search for a route asks for the same ones

    # Seeing

    def line_of_sight(self, a: ArrayLike, b: ArrayLike) -> Bools:
        """Whether ``b`` can be seen from ``a``, ``(..., 2)`` each, broadcast: no (uninflated) obstacle in between.

        A ray may graze a wall and end on one, so that a beacon mounted on a wall can be seen.
        """
        a, b = np.broadcast_arrays(points_of("a", a), points_of("b", b))
        sight = shapely.linestrings(np.stack([a, b], axis=-2))
        return np.asarray(~shapely.intersects(self.opaque.prepared, sight))

    # Zones

    @cached_property
    def zone_index(self) -> ZoneIndex:
        """What answers questions about zones."""
        return ZoneIndex(self.zones)

    def zone_at(self, xy: ArrayLike) -> Ints:
        """Index into `zones` of the zone that holds at each of the points ``(..., 2)``; -1 outside all of them."""
        return self.zone_index.at(points_of("xy", xy))

    def noise_at(self, xy: ArrayLike, elsewhere: OdometryNoise) -> OdometryNoise:
        """The noise that holds at one point (2,): its zone's, or ``elsewhere``."""
        index = int(self.zone_at(point_of("xy", xy)))
        return elsewhere if index < 0 else self.zones[index].noise

    def zone_pieces(self, a: ArrayLike, b: ArrayLike) -> ZonePieces:
        """Cut the segments from ``a`` to ``b``, (n, 2) each, where the zone that holds changes.

        >>> wet = Zone([(2, -1), (4, -1), (4, 1), (2, 1)], OdometryNoise(heading_var_per_m=1e-3))
        >>> world = World.from_polygons([], bounds=(-1, -1, 9, 1), robot_radius=0.1, zones=[wet])
        >>> pieces = world.zone_pieces([[0, 0]], [[8, 0]])
        >>> pieces.start.tolist(), pieces.end.tolist(), pieces.zone.tolist()
        ([0.0, 0.25, 0.5], [0.25, 0.5, 1.0], [-1, 0, -1])
        """
        a, b = np.broadcast_arrays(points_of("a", a), points_of("b", b))
        if a.ndim != 2:
            raise ValueError(f"expected segments (n, 2), got ends of shape {a.shape}")
        return self.zone_index.pieces(a, b)

    def cut_at_zones(self, path: ArrayLike) -> tuple[Floats, Ints]:
        """The same path (n, 2) with waypoints added where the zone changes, and the zone of each of its legs.

        Returns
        -------
        path : (m, 2) array
        zone : (m - 1,) array, index into `zones`, -1 outside all of them

        >>> wet = Zone([(2, -1), (4, -1), (4, 1), (2, 1)], OdometryNoise(heading_var_per_m=1e-3))
        >>> world = World.from_polygons([], bounds=(-1, -1, 9, 9), robot_radius=0.1, zones=[wet])
        >>> path, zone = world.cut_at_zones([[0, 0], [3, 0], [3, 5]])
        >>> path.tolist(), zone.tolist()
        ([[0.0, 0.0], [2.0, 0.0], [3.0, 0.0], [3.0, 1.0], [3.0, 5.0]], [-1, 0, 0, -1])
        """
        path = points_of("path", path)
        if path.ndim != 2 or len(path) < 2:
            raise ValueError(f"expected a path (n, 2) of 2 or more waypoints, got an array of shape {path.shape}")
        pieces = self.zone_pieces(path[:-1], path[1:])
        return pieces.cut(path), pieces.zone

    # Derived once, never copied: a pickled world is its map, and derives again.

    @cached_property
    def _inflation(self) -> Inflation:
        return Inflation(self.obstacles, self.bounds, self.robot_radius)

    @cached_property
    def opaque(self) -> PreparedArea:
        """What blocks `line_of_sight`: the obstacles without their outermost micrometre."""
        return PreparedArea(self.obstacles.buffer(-_WALL_DEPTH, join_style="mitre"))

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __repr__(self) -> str:
        """What a person would want to know, not a page of coordinates."""
        return (
            f"World(bounds={self.bounds}, robot_radius={self.robot_radius}, {len(self.obstacles.geoms)} obstacles, "
            f"{len(self.zones)} zones{''.join(f'; {note}' for note in self.notes)})"
        )

    def _repr_html_(self) -> str:
        """In notebooks: a small map under the words."""
        xmin, ymin, xmax, ymax = self.bounds
        width, height = xmax - xmin, ymax - ymin
        line = max(width, height) / 400
        drawn = "".join(zone.polygon.svg(line, "#e69f00") for zone in self.zones) + self.obstacles.svg(line, "#888888")
        frame = f'viewBox="{xmin} {-ymax} {width} {height}" width="480" height="{480 * height / width:.0f}"'
        return f'<p>{escape(repr(self))}</p><svg {frame}><g transform="scale(1, -1)">{drawn}</g></svg>'


def _thin_out(ring: Floats, *, bulge_m: float, dent_m: float) -> Floats:
    """A closed ring (n, 2) with fewer vertices: none left out bulges more, to the right, or dents more than allowed.

    Douglas and Peucker's method (1973), with one tolerance for each side of a chord.
    """
    # The first vertex stays: make it one that no chord passes outside of.
    start = np.lexsort((ring[:-1, 1], ring[:-1, 0]))[0]
    ring = np.concatenate([ring[start:-1], ring[: start + 1]])
    keep = np.zeros(len(ring), dtype=bool)
    far = int(np.argmax(np.hypot(*(ring - ring[0]).T)))
    keep[[0, far, -1]] = True
    chords = [(0, far), (far, len(ring) - 1)]
    while chords:
        first, last = chords.pop()
        if last - first < 2:
            continue
        along, to = ring[last] - ring[first], ring[first + 1 : last] - ring[first]
        foot = np.clip(to @ along / max(along @ along, 1e-300), 0.0, 1.0)
        off = np.hypot(*(to - foot[:, None] * along).T)
        left = along[0] * to[:, 1] > along[1] * to[:, 0]
        excess = off / np.where(left, dent_m, bulge_m)
        worst = int(np.argmax(excess))
        if excess[worst] > 1:
            middle = first + 1 + worst
            keep[middle] = True
            chords += [(first, middle), (middle, last)]
    return ring[keep]
