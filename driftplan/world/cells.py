"""Cells: from the occupied cells of a grid map to polygons with exactly their outline, and back."""

from __future__ import annotations

from math import ceil, cos, sin
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import MultiPolygon

Bools = NDArray[np.bool_]

MAX_CELLS = 25_000_000  # 5000 x 5000: a map of 250 m at 0.05 m
MAX_RECTANGLES = 200_000  # walls need thousands; more is noise, and would take minutes to merge


def outline_of_cells(
    occupied: Bools, *, cell_size_m: float, origin: tuple[float, float, float]
) -> tuple[MultiPolygon, tuple[float, float, float, float]]:
    """Obstacles and bounds of a grid, row 0 at the bottom, whose lower left corner is at ``origin`` (x, y, yaw).

    The cells are merged in whole numbers, so the polygons have exactly the cells' outline. With yaw, what the bounds
    hold beside the turned grid is an obstacle too.

    Raises
    ------
    ValueError
        If the cells fall into more than `MAX_RECTANGLES` rectangles.
    """
    height, width = occupied.shape
    bottom, top, left, right = _rectangles(occupied)
    if len(bottom) > MAX_RECTANGLES:
        raise ValueError(
            f"the occupied cells make more than {MAX_RECTANGLES} rectangles; this looks like noise, not walls"
        )
    # simplify(0) drops the vertices that the union leaves on straight walls.
    merged = shapely.simplify(shapely.union_all(shapely.box(left, bottom, right, top)), 0)
    x, y, yaw = origin
    turn = cell_size_m * np.array([[cos(yaw), sin(yaw)], [-sin(yaw), cos(yaw)]])

    def placed(geometry: Any) -> Any:
        return shapely.transform(geometry, lambda cells: cells @ turn + (x, y))

    obstacles, frame = placed(merged), placed(shapely.box(0, 0, width, height))
    bounds = tuple(float(v) for v in frame.bounds)
    if yaw != 0:
        obstacles = shapely.union_all([obstacles, shapely.box(*bounds).difference(frame)])
    return MultiPolygon([part for part in shapely.get_parts(obstacles) if not part.is_empty]), bounds  # type: ignore[return-value]


def cells_of_outline(obstacles: MultiPolygon, bounds: tuple[float, float, float, float], cell_size_m: float) -> Bools:
    """The cells that obstacles reach into, or that reach out of the bounds, by more than a millionth of a cell.

    Row 0 is at the bottom; the first cell's corner is that of the bounds.

    Raises
    ------
    ValueError
        If there would be more than `MAX_CELLS` cells.
    """
    xmin, ymin, xmax, ymax = bounds
    width, height = (max(ceil(extent / cell_size_m - 1e-6), 1) for extent in (xmax - xmin, ymax - ymin))
    if width * height > MAX_CELLS:
        raise ValueError(f"expected at most {MAX_CELLS} cells, got {width} x {height}: use a larger cell_size_m")
    shapely.prepare(obstacles)
    occupied = np.zeros((height, width), dtype=bool)
    size = (
        4096  # look at large blocks of cells, then at the eighths of those that an outline crosses, down to the cells
    )
    blocks = size * np.argwhere(np.ones((ceil(height / size), ceil(width / size))))
    while len(blocks):
        low = np.array([xmin, ymin]) + (blocks[:, ::-1] + 1e-6) * cell_size_m
        high = np.array([xmin, ymin]) + (blocks[:, ::-1] + (size - 1e-6)) * cell_size_m
        boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
        touched = shapely.intersects(obstacles, boxes)
        if size == 1:
            occupied[tuple(blocks[touched].T)] = True
            break
        filled = touched & shapely.contains_properly(obstacles, boxes)
        for row, column in blocks[filled]:
            occupied[row : row + size, column : column + size] = True
        eighths = size // 8 * np.argwhere(np.ones((8, 8)))
        blocks, size = (blocks[touched & ~filled][:, None] + eighths).reshape(-1, 2), size // 8
        blocks = blocks[(blocks[:, 0] < height) & (blocks[:, 1] < width)]
    if ymin + (height - 1e-6) * cell_size_m > ymax:
        occupied[-1] = True
    if xmin + (width - 1e-6) * cell_size_m > xmax:
        occupied[:, -1] = True
    return occupied


def _rectangles(occupied: Bools) -> tuple[NDArray[np.int64], ...]:
    """Runs of occupied cells along the rows, equal runs of neighbouring rows merged: bottom, top, left, right."""
    edges = np.diff(np.pad(occupied, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, left = np.nonzero(edges == 1)
    right = np.nonzero(edges == -1)[1]
    order = np.lexsort((row, right, left))
    row, left, right = row[order], left[order], right[order]
    starts = np.ones(len(row), dtype=bool)
    starts[1:] = (left[1:] != left[:-1]) | (right[1:] != right[:-1]) | (row[1:] != row[:-1] + 1)
    first = np.flatnonzero(starts)
    last = np.append(first[1:], len(row))[: len(first)] - 1
    return row[first], row[last] + 1, left[first], right[first]
