"""Cells: from the occupied cells of a grid map to polygons with exactly their outline, and back."""

from __future__ import annotations

from math import ceil, cos, sin, sqrt
from typing import Any

import numpy as np
import shapely
from shapely import MultiPolygon

from driftplan.arrays import Bools, Ints, positive, whole
from driftplan.world.prepared_area import PreparedArea

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

    Follows the sides between occupied and other cells with the occupied one to the left, and turns left where two
    groups meet in a point. A walk that returns to a vertex has closed a ring: around a group, or around a hole in it.
    """
    width = occupied.shape[1] + 1  # vertices in a row
    start, direction = _sides(occupied)
    if len(start) == 0:
        return np.array([], dtype=object)
    if len(start) > MAX_SIDES:
        raise ValueError(f"the occupied cells have more than {MAX_SIDES} free sides; {_NOISE}")
    key = 4 * start + direction
    end = start + np.array([1, width, -1, -width])[direction]
    following = np.empty(len(key), dtype=np.int64)
    for turned in (3, 0, 1):  # right, straight on, left: the last that exists counts
        wanted = 4 * end + (direction + turned) % 4
        place = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        following[key[place] == wanted] = place[key[place] == wanted]
    rings = _rings(start.tolist(), following.tolist())
    side = np.concatenate([np.array(ring) for ring in rings])
    ring = np.repeat(np.arange(len(rings)), [len(sides) for sides in rings])
    first = np.flatnonzero(np.diff(ring, prepend=-1))
    before = np.roll(side, 1)
    before[first] = side[np.append(first[1:], len(side)) - 1]
    turn = (direction[side] - direction[before] + 1) % 4 - 1  # 1 to the left, -1 to the right
    hole = np.bincount(ring, turn) < 0
    ring_of_side = np.empty(len(key), dtype=np.int64)
    ring_of_side[side] = ring
    owner = _outer_rings(hole, ring_of_side, start, direction, width)

    # Keep the vertices where a ring turns, each outer ring followed by its holes.
    order = np.lexsort((np.arange(len(side)), ring, hole[ring], owner[ring]))
    order = order[turn[order] != 0]
    begins = np.diff(ring[order], prepend=-1) != 0
    row, column = np.divmod(start[side[order]], width)
    outlines = shapely.linearrings(np.stack([column, row], axis=-1), indices=np.cumsum(begins) - 1)
    group = np.unique(owner[ring[order][begins]], return_inverse=True)[1]
    return shapely.polygons(outlines, indices=group)


def _sides(occupied: Bools) -> tuple[Ints, Ints]:
    """Sides of occupied cells that face others: the vertex where each starts, counted row by row, and its direction.

    Sorted by both. Directions count from 0 for east, counter-clockwise; the occupied cell is to the left.
    """
    width = occupied.shape[1] + 1
    padded = np.pad(occupied, 1)
    east, north, west, south = padded[1:-1, 2:], padded[2:, 1:-1], padded[1:-1, :-2], padded[:-2, 1:-1]
    keys = []
    for number, (beyond, right, up) in enumerate(((south, 0, 0), (east, 1, 0), (north, 1, 1), (west, 0, 1))):
        row, column = np.nonzero(occupied & ~beyond)
        keys.append(4 * ((row + up) * width + column + right) + number)
    start, direction = np.divmod(np.sort(np.concatenate(keys)), 4)
    return start, direction


def _rings(start: list[int], following: list[int]) -> list[list[int]]:
    """Rings of sides, each visiting a vertex once, that the walks from side to following side fall into."""
    rings: list[list[int]] = []
    done = bytearray(len(start))
    for side in range(len(start)):
        walk: list[int] = []
        place: dict[int, int] = {}
        while True:
            vertex = start[side]
            if vertex in place:
                if len(rings) == MAX_RINGS:
                    raise ValueError(f"the occupied cells make more than {MAX_RINGS} outlines; {_NOISE}")
                rings.append(walk[place[vertex] :])
                del walk[place[vertex] :]
                for passed in rings[-1]:
                    del place[start[passed]]
            if done[side]:
                break
            done[side] = True
            place[vertex] = len(walk)
            walk.append(side)
            side = following[side]
    return rings


def _outer_rings(hole: Bools, ring_of_side: Ints, start: Ints, direction: Ints, width: int) -> Ints:
    """For each ring the outer ring of its group.

    A hole's westernmost wall is a run of occupied cells, and the western end of that run belongs to another ring of the
    group, farther west: the outer one, or another hole, and so on.
    """
    owner = np.arange(len(hole))
    walls = np.flatnonzero(hole[ring_of_side] & (direction == 1))  # they face a hole in their east
    walls = walls[np.lexsort((start[walls] % width, ring_of_side[walls]))]
    walls = walls[np.diff(ring_of_side[walls], prepend=-1) > 0]
    western = np.flatnonzero(direction == 3)
    # A wall starts at the lower east corner of its cell, a western side at the upper west corner: in the row above.
    end = np.searchsorted(start[western], start[walls] + width - 1, side="right") - 1
    owner[ring_of_side[walls]] = ring_of_side[western[end]]
    while (owner[owner] != owner).any():
        owner = owner[owner]
    return owner
