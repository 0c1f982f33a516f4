"""ZoneGrid: which zones a point, a segment or a box may meet, by a grid of cells; the cost does not grow with their
number."""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil, sqrt

import numpy as np

from driftplan.arrays import Floats, Ints

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
