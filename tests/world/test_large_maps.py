"""Maps of very many cells, and of very many specks: refused with what loads them, and then they load."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

from driftplan import MapError, load_world
from driftplan.world.cells import fewer_cells

GRIDS = arrays.arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 12)))


def ros(folder, occupied, resolution=0.05):
    Image.fromarray(np.where(occupied[::-1], 0, 254).astype(np.uint8)).save(folder / "map.png")
    (folder / "map.yaml").write_text(
        f"image: map.png\nresolution: {resolution}\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\n"
        "free_thresh: 0.196\n"
    )
    return folder / "map.yaml"


@given(GRIDS, st.integers(1, 5))
def test_a_coarse_cell_is_occupied_if_one_of_its_cells_is(grid, coarsen):
    coarse, size, notes = fewer_cells(grid, 0.1, coarsen=coarsen)
    assert size == pytest.approx(0.1 * coarsen)
    fine = np.kron(coarse, np.ones((coarsen, coarsen), dtype=bool))
    assert fine.shape >= grid.shape
    assert not (grid & ~fine[: grid.shape[0], : grid.shape[1]]).any()
    whole = tuple(n // coarsen for n in grid.shape)
    expected = [
        [grid[r * coarsen :, c * coarsen :][:coarsen, :coarsen].any() for c in range(whole[1])] for r in range(whole[0])
    ]
    assert coarse[: whole[0], : whole[1]].tolist() == expected
    assert coarse[whole[0] :].all()
    assert coarse[:, whole[1] :].all()
    assert bool(notes) == (coarsen > 1)


@given(GRIDS, st.integers(1, 6))
def test_specks_go_and_walls_stay_as_they_are(grid, cells):
    kept, _, (note,) = fewer_cells(grid, 0.1, despeckle_m=0.1 * cells)
    assert not (kept & ~grid).any()
    parts = shapely.get_parts(
        shapely.union_all(
            [shapely.box(c, r, c + 1, r + 1).buffer(1e-9, cap_style="square") for r, c in np.argwhere(grid)]
        )
    )
    extents = [max(np.array(part.bounds[2:]) - part.bounds[:2]) for part in parts]
    small = [part for part, extent in zip(parts, extents, strict=True) if extent <= cells + 0.5]
    assert int(grid.sum() - kept.sum()) == round(sum(part.area for part in small))
    assert (
        note == f"{len(small)} of {len(parts)} groups of occupied cells are no larger than {0.1 * cells:g} m: dropped"
    )


@pytest.mark.slow
def test_too_many_cells_are_refused_with_what_loads_them(tmp_path):
    occupied = np.zeros((8000, 8000), dtype=bool)
    occupied[4000:4010, 1000:7000] = True
    file = ros(tmp_path, occupied)
    with pytest.raises(MapError, match=r"got 8000 x 8000: coarsen=2 \(--coarsen 2\) takes 2 x 2 of them for one"):
        load_world(file, robot_radius=0.2)
    world = load_world(file, robot_radius=0.2, coarsen=2)
    assert world.bounds == (0, 0, 400, 400)
    assert world.obstacles.bounds == pytest.approx((50, 200, 350, 200.5))
    assert "2 x 2 cells are taken for one of 0.1 m, free if all of them are" in world.notes[0]
    (tmp_path / "a.map").write_bytes(b"type octile\nheight 5001\nwidth 5001\nmap\n" + (b"." * 5001 + b"\n") * 5001)
    with pytest.raises(MapError, match="coarsen=2"):
        load_world(tmp_path / "a.map", robot_radius=0.2)
    assert load_world(tmp_path / "a.map", robot_radius=0.2, coarsen=3).bounds == (0, 0, 5001, 5001)


@pytest.mark.slow
def test_a_map_of_8000_x_8000_cells_with_sixty_thousand_specks_is_read_as_it_is_told(tmp_path):
    rng = np.random.default_rng(0)
    occupied = np.zeros((8000, 8000), dtype=bool)
    occupied[rng.integers(0, 8000, 60_000), rng.integers(0, 8000, 60_000)] = True
    occupied[4000:4010, 1000:7000] = True
    file, asked = ros(tmp_path, occupied), {}
    for said, more in ((r"coarsen=2 \(--coarsen 2\)", {"coarsen": 2}), (r"despeckle_m=0.1", {"despeckle_m": 0.1})):
        with pytest.raises(MapError, match=said):
            load_world(file, robot_radius=0.2, **asked)
        asked |= more
    world = load_world(file, robot_radius=0.2, **asked)
    assert world.obstacles.buffer(1e-9).covers(shapely.box(50, 200, 350, 200.5))
    assert len(world.obstacles.geoms) < 20  # specks of three cells or more in a row, by chance
    assert len(world.notes) == 2


def test_sixty_thousand_specks_are_refused_with_what_loads_them(tmp_path):
    rng = np.random.default_rng(0)
    occupied = np.zeros((1600, 1600), dtype=bool)
    occupied[rng.integers(0, 400, 60_000) * 4, rng.integers(0, 400, 60_000) * 4] = True
    occupied[800:810, 100:1500] = True
    file = ros(tmp_path, occupied)
    with pytest.raises(MapError, match=r"noise, not walls: despeckle_m=0.1 \(--despeckle-m\) .*, coarsen=2"):
        load_world(file, robot_radius=0.2)
    world = load_world(file, robot_radius=0.2, despeckle_m=0.1)
    assert world.obstacles.bounds == pytest.approx((5, 40, 75, 40.5))
    assert "groups of occupied cells are no larger than 0.1 m: dropped" in world.notes[0]


@pytest.mark.parametrize("asked", [{"coarsen": 0}, {"coarsen": 1.5}, {"despeckle_m": 0}, {"despeckle_m": float("nan")}])
def test_what_makes_no_sense_is_refused(tmp_path, asked):
    with pytest.raises(ValueError, match=f"expected {next(iter(asked))}"):
        load_world(ros(tmp_path, np.zeros((3, 3), dtype=bool)), robot_radius=0.2, **asked)
