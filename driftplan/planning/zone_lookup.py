"""Zones one motion at a time: what a planner's callback needs, at the least cost per call.

The answers are those of `World.zone_pieces`, which does the same in bulk.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import atan2, ceil, cos, sin, tau
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
        if not self.touches(min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)):
            return [(0.0, 1.0, self._elsewhere)]
        dx, dy = x1 - x0, y1 - y0
        squared = dx * dx + dy * dy
        cuts = [0.0, 1.0]
        if squared > 0:
            for x, y in self._crossings(((x0, y0), (x1, y1))):
                cuts.append(min(max(((x - x0) * dx + (y - y0) * dy) / squared, 0.0), 1.0))
        return [
            (begin, end, self.at(x0 + 0.5 * (begin + end) * dx, y0 + 0.5 * (begin + end) * dy))
            for begin, end in _between(cuts)
        ]

    def arc_pieces(
        self, x: float, y: float, yaw: float, length: float, curvature: float
    ) -> list[tuple[float, float, float, float, T]]:
        """An arc of signed length and at most a full turn, cut likewise: where each piece begins (x, y, heading), its
        signed length and what holds on it. Borders are met where they meet chords of at most 0.1 rad."""
        if curvature == 0:
            end = after_arc(x, y, yaw, length, 0.0)
            return [
                (*after_arc(x, y, yaw, begin * length, 0.0), (stop - begin) * length, value)
                for begin, stop, value in self.pieces(x, y, end[0], end[1])
            ]
        radius = 1 / abs(curvature)
        cx, cy = x - sin(yaw) / curvature, y + cos(yaw) / curvature
        if not self.touches(cx - radius, cy - radius, cx + radius, cy + radius):
            return [(x, y, yaw, length, self._elsewhere)]
        turn = curvature * length
        chords = ceil(abs(turn) / _CHORD_RAD) or 1
        headings = [yaw + turn * k / chords for k in range(chords + 1)]
        cuts = [0.0, 1.0]
        for px, py in self._crossings([(cx + sin(h) / curvature, cy - cos(h) / curvature) for h in headings]):
            turned = atan2((px - cx) * curvature, (cy - py) * curvature) - yaw
            turned = turned % tau if turn > 0 else -turned % tau
            if turned > abs(turn):  # by rounding: before the start, or beyond the end
                turned = 0.0 if tau - turned < turned - abs(turn) else abs(turn)
            cuts.append(turned / abs(turn))
        found = []
        for begin, stop in _between(cuts):
            middle = after_arc(x, y, yaw, 0.5 * (begin + stop) * length, curvature)
            start = after_arc(x, y, yaw, begin * length, curvature)
            found.append((*start, (stop - begin) * length, self.at(middle[0], middle[1])))
        return found

    def _crossings(self, points: Sequence[tuple[float, float]]) -> list[list[float]]:
        """Where a polyline meets the borders of zones; the ends, where it runs along one."""
        line = shapely.linestrings(points)
        if not shapely.intersects(self._borders, line):
            return []
        return list(shapely.get_coordinates(shapely.intersection(self._borders, line)).tolist())


def _between(cuts: list[float]) -> list[tuple[float, float]]:
    """The stretches between cuts."""
    cuts.sort()
    return [(begin, end) for begin, end in pairwise(cuts) if end - begin > 1e-12]
