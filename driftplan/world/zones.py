"""Zones: floors on which odometry is noisier or better, and where straight segments enter and leave them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, sqrt
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon

from driftplan.arrays import Floats, Ints, instance
from driftplan.model.noise import OdometryNoise
from driftplan.world.shapes import PreparedArea, polygon_of

_FEW_BOXES = 16  # one cell holds them all: to look at each is faster than to look for it
_CELLS_PER_ZONE = 4
_ENTRIES_PER_ZONE = 64  # at most, on average: of zones that overlap a lot the cells are larger
_MARGIN_CELLS = 1e-3  # boxes are taken larger by that, far more than rounding moves a segment
_UPRIGHT_CELLS = 1e-6  # a segment that goes less far than that to the side is taken to fill its columns


class ZoneGrid:
    """Boxes ``(n, 4)`` of (xmin, ymin, xmax, ymax), and which of them are near. Answers may name a box too many, never
    one too few, each once, the last first."""

    def __init__(self, boxes: Floats) -> None:
        low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
        per_axis = ceil(sqrt(_CELLS_PER_ZONE * len(boxes))) if len(boxes) > _FEW_BOXES else 1
        while True:
            cells_per_m = per_axis / np.maximum(high - low, 1e-300)
            first = np.floor((boxes[:, :2] - low) * cells_per_m - _MARGIN_CELLS).clip(0, per_axis - 1).astype(int)
            last = np.floor((boxes[:, 2:] - low) * cells_per_m + _MARGIN_CELLS).clip(0, per_axis - 1).astype(int)
            if per_axis == 1 or (last - first + 1).prod(axis=1).mean() <= _ENTRIES_PER_ZONE:
                break
            per_axis //= 2
        cells: list[list[int]] = [[] for _ in range(per_axis**2)]
        for k, ((left, bottom), (right, top)) in reversed(
            list(enumerate(zip(first.tolist(), last.tolist(), strict=True)))
        ):
            for row in range(bottom, top + 1):
                for column in range(left, right + 1):
                    cells[row * per_axis + column].append(k)
        self._boxes = [tuple(box) for box in boxes.tolist()]
        self._per_axis = per_axis
        self._cells = [tuple(cell) for cell in cells]
        self._left, self._low = low.tolist()
        self._per_m_x, self._per_m_y = cells_per_m.tolist()
        self._edge = per_axis + _MARGIN_CELLS

    def near_point(self, x: float, y: float) -> list[int]:
        """Of one point."""
        if self._per_axis == 1:
            return self._meeting([0], x, y, x, y)
        u, v = (x - self._left) * self._per_m_x, (y - self._low) * self._per_m_y
        if not (-_MARGIN_CELLS <= u <= self._edge and -_MARGIN_CELLS <= v <= self._edge):
            return []
        end = self._per_axis - 1
        return self._meeting([min(max(int(v), 0), end) * self._per_axis + min(max(int(u), 0), end)], x, y, x, y)

    def near_points(self, xy: Floats) -> tuple[Ints, Ints]:
        """Pairs of a point of (n, 2) and a box that it may be in, boxes in their order."""
        uv = (xy - (self._left, self._low)) * (self._per_m_x, self._per_m_y)
        inside = np.flatnonzero(((uv >= -_MARGIN_CELLS) & (uv <= self._edge)).all(axis=1))
        column, row = uv[inside].astype(int).clip(0, self._per_axis - 1).T
        number = np.array([len(cell) for cell in self._cells])
        first = np.concatenate([[0], np.cumsum(number)])
        boxes = np.array([k for cell in self._cells for k in cell], dtype=int)
        cell = row * self._per_axis + column
        point = np.repeat(inside, number[cell])
        step = np.arange(len(point)) - np.repeat(np.cumsum(number[cell]) - number[cell], number[cell])
        box = boxes[np.repeat(first[cell], number[cell]) + step]
        order = np.argsort(box, kind="stable")
        return point[order], box[order]

    def near_box(self, xmin: float, ymin: float, xmax: float, ymax: float) -> list[int]:
        """Of a box."""
        if self._per_axis == 1:
            return self._meeting([0], xmin, ymin, xmax, ymax)
        left, right = self._span((xmin - self._left) * self._per_m_x, (xmax - self._left) * self._per_m_x)
        low, high = self._span((ymin - self._low) * self._per_m_y, (ymax - self._low) * self._per_m_y)
        width = self._per_axis
        cells = [row * width + column for row in range(low, high + 1) for column in range(left, right + 1)]
        return self._meeting(cells, xmin, ymin, xmax, ymax)

    def near_segment(self, x0: float, y0: float, x1: float, y1: float) -> list[int]:
        """Of a straight segment."""
        if x0 > x1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        ymin, ymax = (y0, y1) if y0 <= y1 else (y1, y0)
        if self._per_axis == 1:
            return self._meeting([0], x0, ymin, x1, ymax)
        u0, u1 = (x0 - self._left) * self._per_m_x, (x1 - self._left) * self._per_m_x
        v0, v1 = (y0 - self._low) * self._per_m_y, (y1 - self._low) * self._per_m_y
        left, right = self._span(u0, u1)
        if left >= right or u1 - u0 < _UPRIGHT_CELLS:
            return self.near_box(x0, ymin, x1, ymax)
        slope, width = (v1 - v0) / (u1 - u0), self._per_axis
        cells: list[int] = []
        for column in range(left, right + 1):
            va, vb = v0 + (max(column, u0) - u0) * slope, v0 + (min(column + 1, u1) - u0) * slope
            low, high = self._span(va, vb) if va <= vb else self._span(vb, va)
            cells += range(low * width + column, high * width + column + 1, width)
        return self._meeting(cells, x0, ymin, x1, ymax)

    def _span(self, first: float, last: float) -> tuple[int, int]:
        """The rows or columns from ``first`` to ``last``, none where they are all outside."""
        if last < -_MARGIN_CELLS or first > self._edge:
            return 0, -1
        end = self._per_axis - 1
        return min(max(int(first), 0), end), min(max(int(last), 0), end)

    def _meeting(self, cells: list[int], xmin: float, ymin: float, xmax: float, ymax: float) -> list[int]:
        """What is in any of some cells and meets a box."""
        found: Iterable[int]
        if len(cells) == 1:
            found = self._cells[cells[0]]
        else:
            found = sorted({k for cell in cells for k in self._cells[cell]}, reverse=True)
        return [
            k
            for k in found
            for left, low, right, high in (self._boxes[k],)
            if xmin <= right and xmax >= left and ymin <= high and ymax >= low
        ]


_FEW_SIDES = 32  # of all zones: then arithmetic on all pairs of sides and segments beats searching
_PAST_CORNER = 1e-9  # of a side's length: rounding must not let a segment slip through a corner


@dataclass(frozen=True, eq=False)
class Zone:
    """A polygon in which odometry is noisier or better: wet floor, carpet, gravel, a featureless corridor.

    Parameters
    ----------
    polygon : shapely Polygon or MultiPolygon, or (n, 2) array of its corners in metres
    noise : replaces, inside the polygon, the noise that holds elsewhere

    Examples
    --------
    >>> Zone([(0, 0), (4, 0), (4, 3)], OdometryNoise(heading_var_per_m=1e-3)).polygon.area
    6.0
    """

    polygon: Polygon | MultiPolygon
    noise: OdometryNoise

    def __post_init__(self) -> None:
        object.__setattr__(self, "polygon", polygon_of("zone polygon", self.polygon))
        instance("noise", self.noise, OdometryNoise)

    @cached_property
    def sides(self) -> Floats:
        """The sides of the outline, holes included, (m, 2, 2): from, to."""
        rings = [shapely.get_coordinates(ring) for ring in shapely.get_rings(shapely.get_parts(self.polygon))]
        return np.concatenate([np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings])

    def __getstate__(self) -> dict[str, Any]:
        return {"polygon": self.polygon, "noise": self.noise}


class ZonePieces(NamedTuple):
    """Straight segments cut where they enter or leave zones: ``n`` pieces, in order along each segment."""

    segment: Ints  # (n,) which segment the piece belongs to
    start: Floats  # (n,) where on it the piece starts and
    end: Floats  # (n,) ends, as fractions of the segment's length
    zone: Ints  # (n,) index of the zone in `World.zones`, -1 outside all


class ZoneIndex:
    """The zones of a world, to be asked about many points and segments, from any number of threads."""

    def __init__(self, zones: Sequence[Zone]) -> None:
        self.areas = tuple(PreparedArea(zone.polygon) for zone in zones)
        self._sides = np.concatenate([np.zeros((0, 2, 2)), *(zone.sides for zone in zones)])

    @cached_property
    def grid(self) -> ZoneGrid:
        """By the boxes of the zones, of which there must be some."""
        return ZoneGrid(shapely.bounds([area.area for area in self.areas]))

    @cached_property
    def _tree(self) -> shapely.STRtree:
        return shapely.STRtree(shapely.linestrings(self._sides))

    def at(self, xy: Floats) -> Ints:
        """Index of the zone that holds at each of the points (..., 2): the last of those it is in; -1 outside all."""
        points, index = xy.reshape(-1, 2), np.full(xy.size // 2, -1, dtype=np.int64)
        if len(self.areas) and len(points):
            point, zone = self.grid.near_points(points)
            first = np.flatnonzero(np.diff(zone, prepend=-1))
            for mine in np.split(np.arange(len(zone)), first[1:]) if len(zone) else ():
                k, asked = zone[mine[0]], point[mine]
                index[asked[shapely.intersects_xy(self.areas[k].prepared, points[asked])]] = k
        return index.reshape(xy.shape[:-1])

    def pieces(self, a: Floats, b: Floats) -> ZonePieces:
        """The segments from ``a`` to ``b``, (n, 2) each, cut where the zone that holds changes."""
        every = np.arange(len(a))
        along = b - a
        length2 = np.einsum("ij,ij->i", along, along)
        crossing, at = self._crossings(a, along)
        cut_segment = np.concatenate([every, every, crossing])
        cut_fraction = np.concatenate([np.zeros(len(a)), np.ones(len(a)), np.clip(at, 0.0, 1.0)])
        order = np.lexsort((cut_fraction, cut_segment))
        which, at = cut_segment[order], cut_fraction[order]
        # Cuts closer than 1e-12 of the segment's length bound no piece; a segment of no length is one piece.
        keep = (which[1:] == which[:-1]) & ((at[1:] - at[:-1] > 1e-12) | (length2[which[1:]] == 0))
        which, start, end = which[1:][keep], at[:-1][keep], at[1:][keep]
        zone_of = self.at(a[which] + (0.5 * (start + end))[:, None] * along[which])
        merge = np.concatenate([[True], (which[1:] != which[:-1]) | (zone_of[1:] != zone_of[:-1])])[: len(which)]
        first = np.flatnonzero(merge)
        last = np.append(first[1:], len(which)) - 1 if len(first) else first
        return ZonePieces(which[first], start[first], end[last], zone_of[first])

    def _crossings(self, a: Floats, along: Floats) -> tuple[Ints, Floats]:
        """Which segments from ``a`` (n, 2) cross sides of zones, and where, as fractions of the segment.

        A segment along a side crosses the side's neighbours, and one through a corner both that meet there. GEOS would
        cut no segment where it leaves a side that it runs along but for rounding.
        """
        begin, side = self._sides[:, 0], self._sides[:, 1] - self._sides[:, 0]
        if len(side) <= _FEW_SIDES:
            at, crossed = _crossing(a[:, None], along[:, None], begin, side)
            which, k = np.nonzero(crossed)
            return which, at[which, k]
        near = _PAST_CORNER * float(np.abs(side).max())
        lines = shapely.linestrings(np.stack([a, a + along], axis=-2))
        which, k = self._tree.query(lines, predicate="dwithin", distance=near)
        at, crossed = _crossing(a[which], along[which], begin[k], side[k])
        return which[crossed], at[crossed]


def _crossing(a: Floats, along: Floats, begin: Floats, side: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Where on segments they cross sides, as fractions; and whether they do."""
    to = begin - a
    slant = along[..., 0] * side[..., 1] - along[..., 1] * side[..., 0]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # parallel, or of no length: never a crossing
        at = (to[..., 0] * side[..., 1] - to[..., 1] * side[..., 0]) / slant
        on_side = (to[..., 0] * along[..., 1] - to[..., 1] * along[..., 0]) / slant
        return at, (at > 0) & (at < 1) & (np.abs(on_side - 0.5) <= 0.5 + _PAST_CORNER)
