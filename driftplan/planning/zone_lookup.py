"""Zones one motion at a time: what a planner's callback needs, at the least cost per call.

The answers are those of `World.zone_pieces`, which does the same in bulk.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import ceil
from typing import Generic, TypeVar

import shapely

from driftplan.planning.curves import after_arc
from driftplan.world.world import Zone

T = TypeVar("T")  # of what each zone has its own: rates, or noise

_CHORD_RAD = 0.1  # of an arc, when it is searched for zone borders


class ZoneLookup(Generic[T]):
    """What holds along a segment. Where zones overlap, the later one holds."""

    def __init__(self, zones: Sequence[Zone], values: Sequence[T], elsewhere: T) -> None:
        self._elsewhere = elsewhere
        self._borders = shapely.union_all([zone.polygon.boundary for zone in zones])
        shapely.prepare(self._borders)
        self._zones = [(zone.polygon, zone.polygon.bounds, v) for zone, v in zip(zones, values, strict=True)][::-1]
        for polygon, _, _ in self._zones:
            shapely.prepare(polygon)

    def touches(self, xmin: float, ymin: float, xmax: float, ymax: float) -> bool:
        """Whether a box comes near any zone."""
        for _, (left, low, right, high), _ in self._zones:
            if xmin <= right and xmax >= left and ymin <= high and ymax >= low:
                return True
        return False

    def at(self, x: float, y: float) -> T:
        """What holds at a point."""
        for polygon, (left, low, right, high), value in self._zones:
            if left <= x <= right and low <= y <= high and shapely.intersects_xy(polygon, x, y):
                return value
        return self._elsewhere

    def pieces(self, x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float, T]]:
        """The segment from (x0, y0) to (x1, y1), cut where zones begin and end: from and to, as fractions, and what
        holds between."""
        box = (min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1))
        if not self.touches(*box):
            return [(0.0, 1.0, self._elsewhere)]
        line = shapely.linestrings(((x0, y0), (x1, y1)))
        dx, dy = x1 - x0, y1 - y0
        squared = dx * dx + dy * dy
        cuts = [0.0, 1.0]
        if squared > 0 and shapely.intersects(self._borders, line):
            for x, y in shapely.get_coordinates(shapely.intersection(self._borders, line)).tolist():
                cuts.append(min(max(((x - x0) * dx + (y - y0) * dy) / squared, 0.0), 1.0))
            cuts.sort()
        pieces = []
        for begin, end in pairwise(cuts):
            if end - begin > 1e-12:
                middle = 0.5 * (begin + end)
                pieces.append((begin, end, self.at(x0 + middle * dx, y0 + middle * dy)))
        return pieces

    def arc_pieces(
        self, x: float, y: float, yaw: float, length: float, curvature: float
    ) -> Iterator[tuple[float, float, float, float, T]]:
        """An arc of signed length, cut likewise: where each piece begins (x, y, heading), its signed length and what
        holds on it. Borders are sought on chords of at most 0.1 rad."""
        chords = ceil(abs(curvature * length) / _CHORD_RAD) or 1
        step = length / chords
        for _ in range(chords):
            end = after_arc(x, y, yaw, step, curvature)
            for begin, stop, value in self.pieces(x, y, end[0], end[1]):
                yield (*after_arc(x, y, yaw, begin * step, curvature), (stop - begin) * step, value)
            x, y, yaw = end
