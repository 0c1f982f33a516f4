"""Zones: floors on which odometry is noisier or better, and where straight segments enter and leave them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon

from driftplan.arrays import Floats, Ints, instance
from driftplan.model.noise import OdometryNoise
from driftplan.world.shapes import PreparedArea, polygon_of

_FEW_BOXES = 16  # to look at each is faster than to search
_MOST_CELLS = 64  # along each axis


class ZoneBoxes:
    """Boxes ``(n, 4)`` of (xmin, ymin, xmax, ymax), and which of them are met: each once, the last first.

    For one point or motion at a time they are listed by the cells of a grid.
    """

    def __init__(self, boxes: Floats) -> None:
        self._boxes = [tuple(box) for box in boxes.tolist()]
        self._low, self._high = boxes[:, None, :2], boxes[:, None, 2:]
        self._tree = shapely.STRtree(shapely.box(*boxes.T))
        low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
        self._side = side = min(int(np.ceil(np.sqrt(len(boxes)))), _MOST_CELLS)
        extent = np.maximum(high - low, 1e-12 * np.abs([low, high]).max() + 1e-300)
        (self._x, self._y), (self._per_x, self._per_y) = low.tolist(), (side / extent).tolist()
        slack = 1e-6 + 1e-9 * np.abs([low, high]).max() / extent * side  # of a cell: rounding leaves none out
        first = np.clip((boxes[:, :2] - low) / extent * side - slack, 0, side - 1).astype(int)
        last = np.clip((boxes[:, 2:] - low) / extent * side + slack, 0, side - 1).astype(int)
        self._columns: list[list[list[int]]] = [[[] for _ in range(side)] for _ in range(side)]
        for k in range(len(boxes) - 1, -1, -1):
            (i0, j0), (i1, j1) = first[k].tolist(), last[k].tolist()
            for column in self._columns[i0 : i1 + 1]:
                for cell in column[j0 : j1 + 1]:
                    cell.append(k)

    def at_point(self, x: float, y: float) -> list[int]:
        """At a point."""
        return self.on_box(x, y, x, y)

    def at_points(self, xy: Floats) -> tuple[Ints, Ints]:
        """Pairs of a point of (n, 2) and a box that it is in, boxes in their order."""
        if len(self._boxes) <= _FEW_BOXES:
            box, point = np.nonzero(((xy >= self._low) & (xy <= self._high)).all(axis=2))
            return point, box
        point, box = self._tree.query(shapely.points(xy))
        order = np.argsort(box, kind="stable")
        return point[order], box[order]

    def on_box(self, xmin: float, ymin: float, xmax: float, ymax: float) -> list[int]:
        """On a box."""
        j0, j1 = self._row(ymin), self._row(ymax)
        columns = self._columns[self._column(xmin) : self._column(xmax) + 1]
        return self._meeting([cell for column in columns for cell in column[j0 : j1 + 1]], xmin, ymin, xmax, ymax)

    def on_segment(self, x0: float, y0: float, x1: float, y1: float) -> list[int]:
        """On a straight segment, and perhaps some that it touches but for rounding."""
        if x0 > x1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        low, high = (y0, y1) if y0 <= y1 else (y1, y0)
        first, last, j, j1 = self._column(x0), self._column(x1), self._row(y0), self._row(y1)
        dx, dy = x1 - x0, y1 - y0
        if first == last:
            cells = self._columns[first][j : j1 + 1] if j <= j1 else self._columns[first][j1 : j + 1]
            if len(cells) == 1 and not cells[0]:
                return []
        else:
            cells, slope = [], dy / dx
            for i in range(first, last + 1):
                end = y1 if i == last else y0 + (self._x + (i + 1) / self._per_x - x0) * slope
                to = self._row(min(max(end, low), high))
                cells += self._columns[i][j : to + 1] if j <= to else self._columns[i][to : j + 1]
                j = to
        slack = 1e-9 * (dx + high - low) * (abs(x0) + abs(x1) + high - low + abs(y0))
        return [
            k
            for k in self._meeting(cells, x0, low, x1, high)
            for left, below, right, above in (self._boxes[k],)
            if abs(dx * (below + above - 2 * y0) - dy * (left + right - 2 * x0))
            <= dx * (above - below) + (high - low) * (right - left) + slack
        ]

    def _column(self, x: float) -> int:
        i = (x - self._x) * self._per_x
        return int(i) if 0 <= i < self._side else self._side - 1 if i > 0 else 0  # of nan, which is in no box, too

    def _row(self, y: float) -> int:
        j = (y - self._y) * self._per_y
        return int(j) if 0 <= j < self._side else self._side - 1 if j > 0 else 0

    def _meeting(self, cells: Sequence[Sequence[int]], xmin: float, ymin: float, xmax: float, ymax: float) -> list[int]:
        return [
            k
            for k in (cells[0] if len(cells) == 1 else sorted(set().union(*cells), reverse=True))
            for left, low, right, high in (self._boxes[k],)
            if xmin <= right and xmax >= left and ymin <= high and ymax >= low
        ]


_FEW_SIDES = 32  # of all zones: then arithmetic on all pairs of sides and segments beats searching
_SHARE_SIDES, _MOST_SHARES = 2.0, 64  # a segment is looked up in shares as long as so many sides, at most so many
_PAST_CORNER = 1e-9  # of a side's length: rounding must not let a segment slip through a corner


@dataclass(frozen=True, eq=False)
class Zone:
    """A polygon in which odometry is noisier or better: wet floor, carpet, gravel, a featureless corridor.

    Parameters
    ----------
    polygon : shapely Polygon or MultiPolygon, or (n, 2) array of its corners in metres
    noise : replaces, inside the polygon, the noise that holds elsewhere

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


def noises_on(world: Any, noise: OdometryNoise) -> tuple[OdometryNoise, ...]:
    """The noise, and that of every zone of a world, if there is one."""
    return (noise, *(zone.noise for zone in (() if world is None else world.zones)))


class ZonePieces(NamedTuple):
    """Straight segments cut where they enter or leave zones: ``n`` pieces, in order along each segment."""

    segment: Ints  # (n,) which segment the piece belongs to
    start: Floats  # (n,) where on it the piece starts and
    end: Floats  # (n,) ends, as fractions of the segment's length
    zone: Ints  # (n,) index of the zone in `World.zones`, -1 outside all

    def cut(self, path: Floats) -> Floats:
        """The path (m, 2) of whose legs these are the pieces, with a waypoint where each of them ends."""
        start, end = path[:-1][self.segment], path[1:][self.segment]
        cuts = np.where((self.end < 1)[:, None], start + self.end[:, None] * (end - start), end)
        return np.concatenate([path[:1], cuts])


class ZoneIndex:
    """The zones of a world, to be asked about many points and segments, from any number of threads."""

    def __init__(self, zones: Sequence[Zone]) -> None:
        self.areas = tuple(PreparedArea(zone.polygon) for zone in zones)
        self._sides = np.concatenate([np.zeros((0, 2, 2)), *(zone.sides for zone in zones)])
        self._side_m = np.abs(self._sides[:, 1] - self._sides[:, 0]).max(axis=1)

    @cached_property
    def boxes(self) -> ZoneBoxes:
        """Those of the zones, of which there must be some."""
        return ZoneBoxes(shapely.bounds([area.area for area in self.areas]))

    @cached_property
    def _tree(self) -> shapely.STRtree:
        return shapely.STRtree(shapely.linestrings(self._sides))

    @cached_property
    def _share_m(self) -> float:
        return _SHARE_SIDES * float(np.median(self._side_m))

    def at(self, xy: Floats) -> Ints:
        """Index of the zone that holds at each of the points (..., 2): the last of those it is in; -1 outside all."""
        points, index = xy.reshape(-1, 2), np.full(xy.size // 2, -1, dtype=np.int64)
        if len(self.areas) and len(points):
            point, zone = self.boxes.at_points(points)
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
        near = _PAST_CORNER * float(self._side_m.max())
        # The box of a long segment meets many sides far from it; those of its shares do not.
        shares = np.ceil(np.abs(along).max(axis=1) / self._share_m).clip(1, _MOST_SHARES).astype(int)
        whole = np.repeat(np.arange(len(a)), shares)
        step = (along / shares[:, None])[whole]
        begun = a[whole] + (np.arange(len(whole)) - np.repeat(np.cumsum(shares) - shares, shares))[:, None] * step
        low, high = np.minimum(begun, begun + step) - near, np.maximum(begun, begun + step) + near
        share, k = self._tree.query(shapely.linestrings(np.stack([low, high], axis=1)))  # by their boxes
        which, k = np.divmod(np.unique(whole[share] * len(side) + k), len(side))
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
