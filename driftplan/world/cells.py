"""Cells: from the occupied cells of a grid map to polygons with exactly their outline, and back."""

from __future__ import annotations

from math import ceil, cos, sin, sqrt
from typing import Any

import numpy as np
import shapely
from shapely import MultiPolygon

from driftplan.arrays import Bools, Ints, positive, whole
from driftplan.world.shapes import PreparedArea

MAX_CELLS = 25_000_000  # 5000 x 5000: a map of 250 m at 0.05 m
MAX_SIDES = 2_000_000  # between occupied and other cells
MAX_RINGS = 20_000  # walls need hundreds; more is noise, and would take minutes to inflate
_NO_TURN = 1e-6  # cells: a yaw that moves no corner farther is none
MAX_COARSENED = 150_000_000  # of which memory holds a few bytes each
_NOISE = (
    "this looks like noise, not walls: despeckle_m=0.1 (--despeckle-m) drops groups of cells no wider, coarsen=2 "
    "(--coarsen) takes 2 x 2 cells for one"
)


def refuse_too_many(width: int, height: int, coarsen: int | None = None) -> None:
    """Refuse more cells than can be worked with, saying how to take fewer."""
    whole("coarsen", coarsen or 1, least=1)
    if width * height > MAX_COARSENED:
        raise ValueError(f"expected at most {MAX_COARSENED} cells, got {width} x {height}")
    if width * height > MAX_CELLS * (coarsen or 1) ** 2:
        enough = ceil(sqrt(width * height / MAX_CELLS))
        raise ValueError(
            f"expected at most {MAX_CELLS} cells, got {width} x {height}: coarsen={enough} (--coarsen {enough}) takes "
            f"{enough} x {enough} of them for one"
        )


def fewer_cells(
    occupied: Bools, cell_size_m: float, *, coarsen: int | None = None, despeckle_m: float | None = None
) -> tuple[Bools, float, tuple[str, ...]]:
    """Cells without specks, then so many by so many taken for one: the cells, their size, and what is to be said.

    A speck is a group of occupied cells, by sides or corners, no wider and no higher than ``despeckle_m``. A coarse
    cell is occupied if one of its cells is, or if it reaches beyond the map.
    """
    notes: tuple[str, ...] = ()
    if despeckle_m is not None:
        most = positive("despeckle_m", despeckle_m) / cell_size_m * (1 + 1e-9)
        from scipy.ndimage import find_objects, label

        groups, count = label(occupied, np.ones((3, 3), dtype=bool))
        sizes = [max(rows.stop - rows.start, columns.stop - columns.start) for rows, columns in find_objects(groups)]
        speck = np.array([False, *(size <= most for size in sizes)])
        occupied = occupied & ~speck[groups]
        notes = (f"{speck.sum()} of {count} groups of occupied cells are no larger than {despeckle_m:g} m: dropped",)
    if coarsen is not None and whole("coarsen", coarsen, least=1) > 1:
        height, width = (ceil(n / coarsen) for n in occupied.shape)
        spare = [(0, n * coarsen - had) for n, had in zip((height, width), occupied.shape, strict=True)]
        blocks = np.pad(occupied, spare, constant_values=True).reshape(height, coarsen, width, coarsen)
        occupied, cell_size_m = np.asarray(blocks.any(axis=(1, 3))), coarsen * cell_size_m
        notes += (f"{coarsen} x {coarsen} cells are taken for one of {cell_size_m:g} m, free if all of them are",)
    return occupied, cell_size_m, notes


def outline_of_cells(
    occupied: Bools, *, cell_size_m: float, origin: tuple[float, float, float]
) -> tuple[MultiPolygon, tuple[float, float, float, float]]:
    """Obstacles and bounds of a grid, row 0 at the bottom, whose lower left corner is at ``origin`` (x, y, yaw).

    The cells are traced in whole numbers, so the polygons have exactly the cells' outline. With yaw, what the bounds
    hold beside the turned grid is an obstacle too; a yaw that moves no corner by a millionth of a cell is none.

    Raises
    ------
    ValueError : if the cells have more than `MAX_SIDES` free sides, or `MAX_RINGS` outlines
    """
    x, y, yaw = origin
    if abs(yaw) * max(occupied.shape) < _NO_TURN:
        yaw = 0.0  # slivers thinner than rounding beside the grid would make the polygons invalid
    obstacles = area_of_cells(occupied, cell_size_m=cell_size_m, origin=(x, y, yaw))
    frame = _placed(shapely.box(0, 0, occupied.shape[1], occupied.shape[0]), cell_size_m, (x, y, yaw))
    bounds = tuple(float(v) for v in frame.bounds)
    if yaw != 0:
        parts = shapely.get_parts(shapely.union(obstacles, shapely.box(*bounds).difference(frame)))
        obstacles = MultiPolygon(list(parts[shapely.area(parts) > 0]))
    return obstacles, bounds  # type: ignore[return-value]


def area_of_cells(chosen: Bools, *, cell_size_m: float, origin: tuple[float, float, float]) -> MultiPolygon:
    """Polygons with exactly the outline of the chosen cells; arguments and errors as for `outline_of_cells`."""
    return MultiPolygon(list(_placed(_polygons(chosen), cell_size_m, origin)))


def cells_of_outline(obstacles: MultiPolygon, bounds: tuple[float, float, float, float], cell_size_m: float) -> Bools:
    """The cells that obstacles reach into, or that reach out of the bounds, by more than a millionth of a cell.

    Row 0 is at the bottom; the first cell's corner is that of the bounds.

    Raises
    ------
    ValueError : if there would be more than `MAX_CELLS` cells
    """
    xmin, ymin, xmax, ymax = bounds
    width, height = (max(ceil(extent / cell_size_m - 1e-6), 1) for extent in (xmax - xmin, ymax - ymin))
    if width * height > MAX_CELLS:
        raise ValueError(f"expected at most {MAX_CELLS} cells, got {width} x {height}: use a larger cell_size_m")
    area = PreparedArea(obstacles).prepared
    occupied = np.zeros((height, width), dtype=bool)
    size = 4096  # large blocks first, then the eighths of those that an outline crosses, down to the cells
    blocks = size * np.argwhere(np.ones((ceil(height / size), ceil(width / size))))
    while len(blocks):
        low = np.array([xmin, ymin]) + (blocks[:, ::-1] + 1e-6) * cell_size_m
        high = np.array([xmin, ymin]) + (blocks[:, ::-1] + (size - 1e-6)) * cell_size_m
        boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
        touched = shapely.intersects(area, boxes)
        if size == 1:
            occupied[tuple(blocks[touched].T)] = True
            break
        filled = touched & shapely.contains_properly(area, boxes)
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


def _placed(geometry: Any, cell_size_m: float, origin: tuple[float, float, float]) -> Any:
    """Geometry in units of cells, put where the grid lies."""
    x, y, yaw = origin
    turn = cell_size_m * np.array([[cos(yaw), sin(yaw)], [-sin(yaw), cos(yaw)]])
    return shapely.transform(geometry, lambda cells: cells @ turn + (x, y))


def _polygons(occupied: Bools) -> Any:
    """Polygons around the occupied cells, in units of cells: one for each group of cells that share sides.

    The sides between occupied and other cells, in runs from corner to corner, cut the plane into polygons; the cell in
    the lower left corner of each tells whether it is occupied.
    """
    padded = np.pad(occupied, 1)
    level, upright = padded[1:, 1:-1] != padded[:-1, 1:-1], padded[1:-1, 1:] != padded[1:-1, :-1]
    _refuse_noise(occupied, int(level.sum() + upright.sum()))
    runs = np.concatenate([_runs(level, upright), _runs(upright.T, level.T)[..., ::-1]])  # of row, column
    parts = shapely.normalize(shapely.get_parts(shapely.polygonize(shapely.linestrings(runs))))
    corners, part = shapely.get_coordinates(parts, return_index=True)
    row, column = corners[np.diff(part, prepend=-1) > 0].astype(int).T
    order = np.lexsort((column, row))
    return shapely.transform(parts[order[occupied[row, column][order]]], lambda corners: corners[:, ::-1])


def _runs(sides: Bools, across: Bools) -> Ints:
    """Runs of sides along rows, (n, 2, 2): as long as no side ``across`` meets them."""
    beside, meeting = np.pad(sides, ((0, 0), (1, 1))), np.pad(across, ((1, 1), (0, 0)))
    corner = meeting[1:] | meeting[:-1]
    start = np.argwhere(sides & (~beside[:, :-2] | corner[:, :-1]))
    end = np.argwhere(sides & (~beside[:, 2:] | corner[:, 1:]))
    end[:, 1] += 1
    return np.stack([start, end], axis=1)


def _refuse_noise(occupied: Bools, sides: int) -> None:
    """Refuse what would take minutes to inflate."""
    if sides > MAX_SIDES:
        raise ValueError(f"the occupied cells have more than {MAX_SIDES} free sides; {_NOISE}")
    if sides <= 4 * MAX_RINGS:
        return
    from scipy.ndimage import label

    # Outlines are around groups by sides, and around holes: groups of other cells by sides or corners, but the outside.
    outlines = label(occupied)[1] + label(np.pad(~occupied, 1, constant_values=True), np.ones((3, 3)))[1] - 1
    if outlines > MAX_RINGS:
        raise ValueError(f"the occupied cells make more than {MAX_RINGS} outlines; {_NOISE}")
