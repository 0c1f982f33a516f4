"""Inflation: obstacles grown by the robot's radius, and fast answers to whether its centre would be inside them."""

from __future__ import annotations

from functools import cached_property
from math import cos, pi, sqrt
from typing import Any

import numpy as np
import shapely
from shapely import MultiPolygon

from driftplan.arrays import Bools, Floats
from driftplan.world.shapes import PreparedArea

Bounds = tuple[float, float, float, float]

_QUAD_SEGS = 8
# A buffer replaces arcs by chords of at most 1.5 * 90°/quad_segs (GEOS rounds the number of chords of an arc to the
# nearest integer), which pass inside the circle. Growing the radius by 1/cos(half a chord) puts them outside.
_CHORD_FACTOR = 1 / cos(0.75 * (pi / 2) / _QUAD_SEGS) + 1e-9
_CELLS = 20_000  # of the reach table: some 50 ms to fill, more among many obstacles,
_FIRST_ASKED = 10_000  # so not before so many questions
_MAX_RINGS = 40  # of cells looked at around a free one
_UNSURE, _BLOCKED = -1.0, -2.0  # cells with an outline in them, cells inside an obstacle


class Inflation:
    """The obstacles of a map grown by a disc, and the frame of that width inside the map's edge.

    The disc's arcs are replaced by chords outside the true circle, so the grown obstacles contain the exact ones. GEOS
    also fills concave dents of less than 1 % of the radius. A point of contact counts as a collision.

    Every answer comes from one GEOS predicate on one geometry, prepared for each thread that asks. The scalar methods,
    once they are asked often, first look into a table of cells, which answers only with a margin that is far above
    round-off; so they agree with the vectorised ones.
    """

    def __init__(self, obstacles: MultiPolygon, bounds: Bounds, radius: float) -> None:
        if radius > 0:  # part by part, then those merged that touch: many times faster than all at once
            parts = shapely.buffer(shapely.get_parts(obstacles), radius * _CHORD_FACTOR, quad_segs=_QUAD_SEGS)
            self.obstacles: Any = shapely.disjoint_subset_union_all(parts)
        else:
            self.obstacles = obstacles
        self._obstacles = PreparedArea(self.obstacles)
        self._asked = 0
        xmin, ymin, xmax, ymax = bounds
        self.bounds = (xmin + radius, ymin + radius, xmax - radius, ymax - radius)

    def points_free(self, xy: Floats) -> Bools:
        """Whether the centre may be at ``xy`` (..., 2)."""
        x, y = xy[..., 0], xy[..., 1]
        return np.asarray(self._inside(x, y) & ~shapely.intersects_xy(self._obstacles.prepared, x, y))

    def segments_free(self, a: Floats, b: Floats) -> Bools:
        """Whether the centre may move straight from ``a`` to ``b``, (..., 2) of the same shape."""
        # The frame is convex, so its ends tell whether a segment stays within.
        free = np.asarray(self._inside(a[..., 0], a[..., 1]) & self._inside(b[..., 0], b[..., 1]))
        lines = shapely.linestrings(np.stack([a[free], b[free]], axis=-2))
        free[free] = ~shapely.intersects(self._obstacles.prepared, lines)
        return free

    def point_free(self, x: float, y: float) -> bool:
        """`points_free` for one point."""
        xmin, ymin, xmax, ymax = self.bounds
        if not (xmin < x < xmax and ymin < y < ymax):
            return False
        if self._asked < _FIRST_ASKED:
            self._asked += 1
            return not shapely.intersects_xy(self._obstacles.prepared, x, y)
        reach, width, per_m = self._reach
        step = reach[int((y - ymin) * per_m) * width + int((x - xmin) * per_m)]
        if step != _UNSURE:
            return step >= 0
        return not shapely.intersects_xy(self._obstacles.prepared, x, y)

    def segment_free(self, x0: float, y0: float, x1: float, y1: float) -> bool:
        """`segments_free` for one segment."""
        xmin, ymin, xmax, ymax = self.bounds
        if not (xmin < x0 < xmax and xmin < x1 < xmax and ymin < y0 < ymax and ymin < y1 < ymax):
            return False
        if self._asked < _FIRST_ASKED:
            self._asked += 1
            return not shapely.intersects(self._obstacles.prepared, shapely.linestrings(((x0, y0), (x1, y1))))
        reach, width, per_m = self._reach
        if reach[int((y1 - ymin) * per_m) * width + int((x1 - xmin) * per_m)] == _BLOCKED:
            return False
        x, y = x0, y0
        while True:  # step from free square to free square, each step at least the size of a cell
            step = reach[int((y - ymin) * per_m) * width + int((x - xmin) * per_m)]
            dx, dy = x1 - x, y1 - y
            left = max(abs(dx), abs(dy))
            if left <= step:
                return True
            if step <= 0:
                if step == _BLOCKED:
                    return False
                break
            x += dx * (step / left)
            y += dy * (step / left)
        return not shapely.intersects(self._obstacles.prepared, shapely.linestrings(((x0, y0), (x1, y1))))

    @cached_property
    def _reach(self) -> tuple[list[float], int, float]:
        """How far one can go from any point of a cell, along both axes at once, and stay free; or UNSURE, or BLOCKED.

        A flat list of cells, row by row from the lower left, the number of cells in a row, and cells per metre.
        """
        from scipy.spatial import cKDTree

        xmin, ymin, xmax, ymax = self.bounds
        width_m, height_m = max(xmax - xmin, 0.0), max(ymax - ymin, 0.0)
        cell = max(sqrt(width_m * height_m / _CELLS), max(width_m, height_m) / _CELLS) or 1.0
        # One cell more than needed: points on the edge round either way.
        x = xmin + cell * np.arange(int(width_m / cell) + 2)
        y = ymin + cell * np.arange(int(height_m / cell) + 2)
        # Cells overlap a little, so that a point that rounds into the neighbour is still right about both.
        extent = max(abs(v) for v in self.bounds) + cell
        margin = 1e-6 * cell + 1e-12 * extent
        grid_x, grid_y = np.meshgrid(x, y)
        cells = shapely.box(grid_x - margin, grid_y - margin, grid_x + cell + margin, grid_y + cell + margin)
        free = ~shapely.intersects(self._obstacles.prepared, cells)
        reach = np.zeros(free.shape)
        reach[~free] = np.where(shapely.contains_properly(self._obstacles.prepared, cells[~free]), _BLOCKED, _UNSURE)
        # beyond the frame no segment goes: both its ends are inside
        rings, _ = cKDTree(np.argwhere(~free)).query(np.argwhere(free), p=np.inf, distance_upper_bound=_MAX_RINGS)
        reach[free] = cell * (np.minimum(rings, _MAX_RINGS) - 1)
        return reach.ravel().tolist(), len(x), 1 / cell

    def _inside(self, x: Floats, y: Floats) -> Bools:
        xmin, ymin, xmax, ymax = self.bounds
        return (x > xmin) & (x < xmax) & (y > ymin) & (y < ymax)
