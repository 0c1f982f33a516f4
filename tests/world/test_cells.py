"""Cells: polygons have exactly the outline of the cells, wherever the grid lies, and cells come back."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from driftplan.world.cells import cells_of_outline, outline_of_cells

grids = arrays(bool, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=12))
some = settings(max_examples=80, deadline=None)


@some
@example(grid=np.array([[False], [True], [False], [False]]), x=0.0, y=0.0, yaw=1.5e-59, size=0.05)
@given(
    grid=grids,
    x=st.floats(-1e3, 1e3),
    y=st.floats(-1e3, 1e3),
    yaw=st.floats(-4, 4),
    size=st.sampled_from([0.05, 1.0, 3.7]),
)
def test_the_middle_of_a_cell_is_in_an_obstacle_when_the_cell_is(grid, x, y, yaw, size):
    obstacles, bounds = outline_of_cells(grid, cell_size_m=size, origin=(x, y, yaw))
    assert obstacles.is_valid
    row, column = np.indices(grid.shape)
    east, north = (column + 0.5) * size, (row + 0.5) * size
    middle_x = x + east * np.cos(yaw) - north * np.sin(yaw)
    middle_y = y + east * np.sin(yaw) + north * np.cos(yaw)
    assert (shapely.intersects_xy(obstacles, middle_x, middle_y) == grid).all()
    xmin, ymin, xmax, ymax = bounds
    beside = (xmax - xmin) * (ymax - ymin) - grid.size * size**2  # what the turned grid leaves of its bounds
    assert obstacles.area == pytest.approx(
        grid.sum() * size**2 + beside, rel=1e-9, abs=1e-9 * (abs(x) + abs(y) + 1) ** 2
    )


@some
@given(grid=grids, size=st.sampled_from([0.05, 1.0, 3.7]), x=st.integers(-50, 50))
def test_cells_survive_the_way_to_polygons_and_back(grid, size, x):
    obstacles, bounds = outline_of_cells(grid, cell_size_m=size, origin=(x, -x, 0.0))
    assert (cells_of_outline(obstacles, bounds, size) == grid).all()


def test_large_grids_come_back_too():
    rng = np.random.default_rng(0)
    grid = np.zeros((700, 3000), dtype=bool)
    for row, column in rng.integers(0, (700, 3000), (20, 2)):
        grid[row : row + rng.integers(1, 200), column : column + rng.integers(1, 900)] = True
    obstacles, bounds = outline_of_cells(grid, cell_size_m=0.05, origin=(0.0, 0.0, 0.0))
    assert (cells_of_outline(obstacles, bounds, 0.05) == grid).all()


def test_a_cell_that_an_obstacle_reaches_into_is_occupied_and_one_that_it_touches_is_not():
    obstacles = shapely.MultiPolygon([shapely.box(1.0, 1.0, 2.0, 2.5)])
    cells = cells_of_outline(obstacles, (0.0, 0.0, 4.0, 4.0), 1.0)
    assert np.argwhere(cells).tolist() == [[1, 1], [2, 1]]


def test_cells_that_stick_out_of_the_bounds_are_occupied():
    cells = cells_of_outline(shapely.MultiPolygon(), (0.0, 0.0, 2.5, 2.0), 1.0)
    assert cells.tolist() == [[False, False, True], [False, False, True]]


def test_noise_and_giant_grids_are_refused():
    board = np.indices((300, 300)).sum(axis=0) % 2 == 0
    with pytest.raises(ValueError, match="more than 20000 outlines; this looks like noise"):
        outline_of_cells(board, cell_size_m=1.0, origin=(0.0, 0.0, 0.0))
    stripes = np.zeros((1500, 1500), dtype=bool)
    stripes[::2] = True
    with pytest.raises(ValueError, match="more than 2000000 free sides; this looks like noise"):
        outline_of_cells(stripes, cell_size_m=1.0, origin=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="at most 25000000 cells, got 100000 x 100000: use a larger cell_size_m"):
        cells_of_outline(shapely.MultiPolygon(), (0.0, 0.0, 1000.0, 1000.0), 0.01)


@some
@given(grid=grids)
def test_polygons_are_the_groups_of_cells_that_share_sides(grid):
    obstacles, _ = outline_of_cells(grid, cell_size_m=1.0, origin=(0.0, 0.0, 0.0))
    row, column = np.nonzero(grid)
    merged = shapely.union_all(shapely.box(column, row, column + 1, row + 1))  # GEOS, another way to the same outline
    assert obstacles.is_valid
    assert obstacles.equals(merged) or (obstacles.is_empty and merged.is_empty)
    assert len(obstacles.geoms) == len([part for part in shapely.get_parts(merged) if not part.is_empty])
    for ring in shapely.get_rings(obstacles.geoms):  # every vertex is a corner
        along = np.diff(shapely.get_coordinates(ring), axis=0)
        assert (np.sign(along) != np.sign(np.roll(along, 1, axis=0))).any(axis=1).all()


def test_a_ring_of_cells_in_a_hole_of_another_is_a_polygon_of_its_own():
    grid = np.ones((9, 9), dtype=bool)
    grid[1:8, 1:8] = False
    grid[2:7, 2:7] = True
    grid[3:6, 3:6] = False
    grid[4, 4] = True
    obstacles, _ = outline_of_cells(grid, cell_size_m=1.0, origin=(0.0, 0.0, 0.0))
    assert sorted((part.area, len(part.interiors)) for part in obstacles.geoms) == [(1.0, 0), (16.0, 1), (32.0, 1)]
