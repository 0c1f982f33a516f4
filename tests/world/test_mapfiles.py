"""Map files: what is saved loads again, nothing is half written, and the bundled maps are what the script draws."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
import shapely

from driftplan.errors import MapError
from driftplan.model.noise import OdometryNoise
from driftplan.world.mapfiles import bundled_map, bundled_maps, load_world, save_world
from driftplan.world.world import World
from driftplan.world.zones import Zone

MAPS = Path(__file__).resolve().parents[2] / "maps"
ROOM = World.from_polygons(
    [shapely.box(2, 0, 3, 4), shapely.box(6, 2, 7, 6).difference(shapely.box(6.25, 2.25, 6.75, 5.5))],
    bounds=(0, 0, 10, 6),
    robot_radius=0.25,
)
EMPTY = World.from_polygons([], bounds=(0, 0, 3, 3), robot_radius=0.1)


def with_zones() -> World:
    slippery = OdometryNoise(heading_var_per_step=1e-3, step_m=0.5, heading_law="laplace", distance_scale_error=0.1 / 3)
    zones = (
        Zone(shapely.box(0, 0, 1, 1 / 3), OdometryNoise(heading_var_per_m=0.1 / 3)),
        Zone(shapely.box(4, 0, 5, 6), slippery),
    )
    return World.from_polygons(
        [shapely.Point(5, 3).buffer(1 / 3)], bounds=(-1 / 3, 0, 10, 6), robot_radius=0.1, zones=zones
    )


@pytest.mark.parametrize("name", ["room.yaml", "room.yml", "room.geojson", "room.json"])
def test_saving_and_loading_changes_nothing(tmp_path, name):
    save_world(ROOM, tmp_path / name)
    again = load_world(tmp_path / name, robot_radius=0.25)
    assert again.bounds == pytest.approx(ROOM.bounds, abs=1e-12)
    assert again.obstacles.symmetric_difference(ROOM.obstacles).area < 1e-9
    xy = np.random.default_rng(0).uniform((0, 0), (10, 6), (500, 2))
    assert (again.is_free(xy) == ROOM.is_free(xy)).all()


def test_a_movingai_map_keeps_whole_cells(tmp_path):
    save_world(ROOM, tmp_path / "room.map", cell_size_m=0.25)
    again = load_world(tmp_path / "room.map", robot_radius=0.25, cell_size_m=0.25)
    assert again.obstacles.equals(ROOM.obstacles)
    save_world(ROOM, tmp_path / "room.map")  # cells of 1 m: an obstacle where one reaches in
    coarse = load_world(tmp_path / "room.map", robot_radius=0.25)
    assert coarse.obstacles.equals(shapely.union(shapely.box(2, 0, 3, 4), shapely.box(6, 2, 7, 6)))


def test_geojson_keeps_every_digit_and_the_zones(tmp_path):
    world = with_zones()
    save_world(world, tmp_path / "a.geojson")
    again = load_world(tmp_path / "a.geojson", robot_radius=0.1)
    assert again.bounds == world.bounds
    assert again.obstacles.normalize() == world.obstacles.normalize()
    assert [zone.noise for zone in again.zones] == [zone.noise for zone in world.zones]
    assert [zone.polygon.normalize() for zone in again.zones] == [zone.polygon.normalize() for zone in world.zones]
    save_world(again, tmp_path / "b.geojson")
    save_world(load_world(tmp_path / "b.geojson", robot_radius=0.1), tmp_path / "c.geojson")
    assert (tmp_path / "b.geojson").read_bytes() == (tmp_path / "c.geojson").read_bytes()


def test_saving_to_cells_never_loses_an_obstacle(tmp_path):
    round_pillars = World.from_polygons(
        [shapely.Point(x, y).buffer(0.23) for x, y in np.random.default_rng(1).uniform(1, 9, (20, 2))],
        bounds=(0.1, -0.2, 10.0, 9.97),
        robot_radius=0.1,
    )
    save_world(round_pillars, tmp_path / "pillars.yaml", cell_size_m=0.1)
    again = load_world(tmp_path / "pillars.yaml", robot_radius=0.1)
    assert again.obstacles.buffer(1e-6).covers(round_pillars.obstacles)
    # and adds no more than the cells it is in: a cell's diagonal
    assert (
        round_pillars.obstacles.buffer(0.1 * np.sqrt(2) + 1e-6)
        .union(shapely.box(9.9, -1, 11, 11))
        .union(shapely.box(0, 9.9, 11, 11))
        .covers(again.obstacles)
    )


def test_what_a_format_cannot_hold_is_refused_and_nothing_is_written(tmp_path):
    for name in ("a.yaml", "a.map"):
        with pytest.raises(ValueError, match=r"maps have no zones, and this world has 2: save it as \.geojson"):
            save_world(with_zones(), tmp_path / name)
    elsewhere = World.from_polygons([], bounds=(1, 0, 2, 2), robot_radius=0.1)
    with pytest.raises(ValueError, match=r"a \.map file has no origin: expected bounds that start at \(0, 0\)"):
        save_world(elsewhere, tmp_path / "a.map")
    with pytest.raises(ValueError, match="cell_size_m is for maps made of cells"):
        save_world(ROOM, tmp_path / "a.geojson", cell_size_m=0.1)
    with pytest.raises(ValueError, match="cell_size_m > 0, got -1"):
        save_world(ROOM, tmp_path / "a.yaml", cell_size_m=-1)
    with pytest.raises(ValueError, match="use a larger cell_size_m"):
        save_world(ROOM, tmp_path / "a.yaml", cell_size_m=1e-4)
    with pytest.raises(MapError, match=r"expected a map called .*\.yaml .* got \.svg"):
        save_world(ROOM, tmp_path / "a.svg")
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_old_map_and_no_litter(tmp_path, monkeypatch):
    save_world(ROOM, tmp_path / "room.yaml")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    calls = []
    write = Path.write_bytes

    def full_disk(path: Path, content: bytes) -> int:
        calls.append(path)
        if len(calls) == 2:
            write(path, content[:10])
            raise OSError("No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(OSError, match="No space left"):
        save_world(EMPTY, tmp_path / "room.yaml")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_options_that_mean_nothing_for_a_format_are_refused(tmp_path):
    save_world(ROOM, tmp_path / "room.yaml")
    save_world(ROOM, tmp_path / "room.map", cell_size_m=0.25)
    with pytest.raises(ValueError, match=r"cell_size_m is for MovingAI files: room\.yaml is one of ROS"):
        load_world(tmp_path / "room.yaml", robot_radius=0.1, cell_size_m=1.0)
    with pytest.raises(ValueError, match=r"unknown_is_free is for ROS files: room\.map is one of MovingAI"):
        load_world(tmp_path / "room.map", robot_radius=0.1, unknown_is_free=True)
    with pytest.raises(ValueError, match="cell_size_m > 0, got 0"):
        load_world(tmp_path / "room.map", robot_radius=0.1, cell_size_m=0)
    with pytest.raises(ValueError, match="robot_radius >= 0, got -1"):
        load_world(tmp_path / "room.yaml", robot_radius=-1)


def test_missing_files_folders_and_other_suffixes_are_refused(tmp_path):
    with pytest.raises(MapError, match=r"gone\.yaml: cannot be read: No such file"):
        load_world(tmp_path / "gone.yaml", robot_radius=0.3)
    (tmp_path / "folder.map").mkdir()
    with pytest.raises(MapError, match="Is a directory"):
        load_world(tmp_path / "folder.map", robot_radius=0.3)
    with pytest.raises(MapError, match=r"got \.png"):
        load_world(tmp_path / "plan.png", robot_radius=0.3)
    with pytest.raises(MapError, match="got no suffix"):
        load_world(tmp_path / "plan", robot_radius=0.3)


def test_the_bundled_maps_are_what_the_script_draws(tmp_path):
    runpy.run_path(str(MAPS / "draw_maps.py"))["draw"](tmp_path)
    drawn = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert drawn == {name: bundled_map("office").with_name(name).read_bytes() for name in drawn}
    assert sorted(path.stem for path in tmp_path.iterdir() if path.suffix != ".pgm") == list(bundled_maps())
    assert sum(map(len, drawn.values())) < 300_000


def test_one_can_drive_between_opposite_corners_of_the_bundled_maps():
    corners = {"warehouse": [(3, 3), (57, 3), (57, 37), (3, 37)], "office": [(2, 3), (38, 3), (29, 20), (3, 20)]}
    for name, places in corners.items():
        world = load_world(bundled_map(name), robot_radius=0.3)
        assert (world.free_part(places) == 0).all()
        assert not world.segments_free(places, np.roll(places, 2, axis=0)).any()  # nor is it trivial


def test_an_unknown_bundled_map_is_refused():
    with pytest.raises(ValueError, match="expected one of the maps office, warehouse, got 'castle'"):
        bundled_map("castle")
