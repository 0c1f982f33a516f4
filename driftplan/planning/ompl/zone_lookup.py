"""Zones one motion at a time: what a planner's callback needs, at the least cost per call.

The answers are those of `World.zone_pieces`, which does the same in bulk, and for arcs, which it does not do.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import atan2, cos, sin, sqrt, tau
from typing import Generic, TypeVar

import numpy as np
import shapely
from numpy.typing import NDArray

from driftplan.planning.ompl.curves import after_arc
from driftplan.world.zones import Zone, ZoneIndex

T = TypeVar("T")  # of what each zone has its own: rates, or noise

_FEW = 60  # edges of a zone: a Python loop over so many is faster than numpy
_NO_PIECE = 1e-12  # of a motion
_ON_SIDE = 1e-9  # of an edge: nearer than that a point may be on it


class ZoneLookup(Generic[T]):
    """What holds along a segment or an arc, cut exactly where zones begin and end. Of overlapping zones the later one
    holds."""

    def __init__(self, zones: Sequence[Zone], values: Sequence[T], elsewhere: T) -> None:
        self._elsewhere = elsewhere
        self._values = tuple(values)
        self._outlines = [_Outline(zone) for zone in zones]
        self._index = ZoneIndex(zones)

    def at(self, x: float, y: float) -> T:
        """What holds at a point."""
        for k in self._index.boxes.at_point(x, y) if self._values else ():  # the last first
            if self._is_inside(k, x, y):
                return self._values[k]
        return self._elsewhere

    def pieces(self, x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float, T]]:
        """The segment from (x0, y0) to (x1, y1) in pieces: from and to, as fractions, and what holds between."""
        near = self._index.boxes.on_segment(x0, y0, x1, y1) if self._values else ()
        dx, dy = x1 - x0, y1 - y0
        spans = []
        for k in near:
            outline = self._outlines[k]
            cuts = outline.crossings(x0, y0, dx, dy)
            if len(cuts) == 2 and outline.is_convex and abs(cuts[1] - cuts[0]) > _ON_SIDE:  # no corner: a chord
                spans.append((min(cuts), max(cuts), k))
                continue
            if not cuts and not outline.may_hold(x0, y0):
                continue
            for begin, end in _between([0.0, 1.0, *cuts]):
                share = 0.5 * (begin + end)
                if self._is_inside(k, x0 + share * dx, y0 + share * dy):
                    spans.append((begin, end, k))
        return self._over(spans)

    def _is_inside(self, k: int, x: float, y: float) -> bool:
        inside = self._outlines[k].surrounds(x, y)
        return bool(shapely.intersects_xy(self._index.areas[k].prepared, x, y)) if inside is None else inside

    def _over(self, spans: list[tuple[float, float, int]]) -> list[tuple[float, float, T]]:
        """The whole, from 0 to 1, in pieces: where spans of zones overlap the later zone holds."""
        spans.sort()
        pieces, at = [], 0.0
        for begin, end, k in spans:
            if begin < at - _NO_PIECE:
                return self._overlapping(spans)
            if begin - at > _NO_PIECE:
                pieces.append((at, begin, self._elsewhere))
            pieces.append((begin, end, self._values[k]))
            at = end
        if 1.0 - at > _NO_PIECE or not pieces:
            pieces.append((at, 1.0, self._elsewhere))
        return pieces

    def _overlapping(self, spans: list[tuple[float, float, int]]) -> list[tuple[float, float, T]]:
        """Cut at all ends of spans."""
        found = []
        for begin, end in _between([0.0, 1.0, *(cut for span in spans for cut in span[:2])]):
            middle = 0.5 * (begin + end)
            k = max((k for first, last, k in spans if first < middle < last), default=-1)
            found.append((begin, end, self._elsewhere if k < 0 else self._values[k]))
        return found

    def arc_pieces(
        self, x: float, y: float, yaw: float, length: float, curvature: float
    ) -> list[tuple[float, float, float, float, T]]:
        """An arc of signed length, at most a full turn, in pieces: where each begins (x, y, heading), its signed length
        and what holds on it."""
        if curvature == 0:
            end = after_arc(x, y, yaw, length, 0.0)
            return [
                (*after_arc(x, y, yaw, begin * length, 0.0), (stop - begin) * length, value)
                for begin, stop, value in self.pieces(x, y, end[0], end[1])
            ]
        radius = 1 / abs(curvature)
        cx, cy = x - sin(yaw) / curvature, y + cos(yaw) / curvature
        box = cx - radius, cy - radius, cx + radius, cy + radius
        near = self._index.boxes.on_box(*box) if self._values else ()
        if not near:
            return [(x, y, yaw, length, self._elsewhere)]
        turn, spans = curvature * length, []
        for k in near:
            cuts = [0.0, 1.0]
            for px, py in self._outlines[k].circle_crossings(cx, cy, radius):
                turned = atan2((px - cx) * curvature, (cy - py) * curvature) - yaw
                turned = turned % tau if turn > 0 else -turned % tau
                if turned < abs(turn):
                    cuts.append(turned / abs(turn))
            for begin, stop in _between(cuts):
                middle = after_arc(x, y, yaw, 0.5 * (begin + stop) * length, curvature)
                if self._is_inside(k, middle[0], middle[1]):
                    spans.append((begin, stop, k))
        return [
            (*after_arc(x, y, yaw, begin * length, curvature), (stop - begin) * length, value)
            for begin, stop, value in self._over(spans)
        ]


class _Outline:
    """The border of a zone as edges: a corner and the step to the next."""

    def __init__(self, zone: Zone) -> None:
        edges = np.c_[zone.sides[:, 0], zone.sides[:, 1] - zone.sides[:, 0]]
        edges = edges[(edges[:, 2:] != 0).any(axis=1)]  # corners may be repeated
        self._box: tuple[float, float, float, float] = zone.polygon.bounds
        self.is_convex = zone.polygon.convex_hull.area <= zone.polygon.area * (1 + 1e-12)
        self._edges = edges.T.copy()  # (4, n): x, y, step x, step y
        self._few = [tuple(edge) for edge in edges.tolist()] if len(edges) <= _FEW else None

    def may_hold(self, x: float, y: float) -> bool:
        """Whether a point is in the box around the zone."""
        xmin, ymin, xmax, ymax = self._box
        return xmin <= x <= xmax and ymin <= y <= ymax

    def surrounds(self, x: float, y: float) -> bool | None:
        """Whether a point is inside, by the sides that a ray to the right meets; None where it takes GEOS to say."""
        if self._few is None:
            return None
        inside = False
        for ax, ay, ex, ey in self._few:
            below, above = ay - y, ay + ey - y
            near = _ON_SIDE * (abs(ex) + abs(ey))
            if abs(below) <= near or abs(above) <= near:
                return None  # as high as a corner
            if (below < 0) is not (above < 0):
                side = (x - ax) * ey + below * ex
                if abs(side) <= near * abs(ey):
                    return None
                inside ^= (side < 0) is (ey > 0)
        return inside

    def crossings(self, x: float, y: float, dx: float, dy: float) -> list[float]:
        """Fractions of the segment from (x, y) by (dx, dy) at which it meets the border. Edges that it runs along do
        not count: their neighbours do."""
        squared = dx * dx + dy * dy
        if squared == 0:
            return []
        found = []
        for ax, ay, ex, ey in self._few if self._few is not None else self._across_line(x, y, dx, dy):
            side = (ax - x) * dy - (ay - y) * dx
            other = side + ex * dy - ey * dx
            if side * other <= 0 and side != other:
                u = side / (side - other)
                t = ((ax + u * ex - x) * dx + (ay + u * ey - y) * dy) / squared
                if 0 < t < 1:
                    found.append(t)
        return found

    def circle_crossings(self, cx: float, cy: float, radius: float) -> list[tuple[float, float]]:
        """Where a circle meets the border."""
        found = []
        for ax, ay, ex, ey in self._few if self._few is not None else self._across_circle(cx, cy, radius):
            fx, fy = ax - cx, ay - cy
            a, b, c = ex * ex + ey * ey, fx * ex + fy * ey, fx * fx + fy * fy - radius * radius
            d = b * b - a * c
            if d >= 0:
                root = sqrt(d)
                for u in ((-b - root) / a, (-b + root) / a):
                    if 0 <= u <= 1:
                        found.append((ax + u * ex, ay + u * ey))
        return found

    def _across_line(self, x: float, y: float, dx: float, dy: float) -> list[list[float]]:
        """Of many edges those that meet a line."""
        ax, ay, ex, ey = self._edges
        side = (ax - x) * dy - (ay - y) * dx
        return self._some(side * (side + ex * dy - ey * dx) <= 0)

    def _across_circle(self, cx: float, cy: float, radius: float) -> list[list[float]]:
        """Of many edges those whose line meets a circle."""
        ax, ay, ex, ey = self._edges
        fx, fy = ax - cx, ay - cy
        a, b, c = ex * ex + ey * ey, fx * ex + fy * ey, fx * fx + fy * fy - radius * radius
        nearest = np.clip(-b / a, 0.0, 1.0)
        return self._some((b * b >= a * c) & (c + nearest * (2 * b + nearest * a) <= 1e-9 * radius * radius))

    def _some(self, which: NDArray[np.bool_]) -> list[list[float]]:
        edges: list[list[float]] = self._edges[:, which].T.tolist()
        return edges


def _between(cuts: list[float]) -> list[tuple[float, float]]:
    """The stretches between cuts."""
    cuts.sort()
    return [(begin, end) for begin, end in pairwise(cuts) if end - begin > _NO_PIECE]
