"""Files like those that people really have: read rightly, or refused with the cause; and what other projects ship."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from driftplan import (
    MapError,
    TrajectoryError,
    graph_lif,
    load_graph,
    load_noise,
    load_trips,
    load_world,
    load_zones,
    read_odometry,
    read_path,
    read_truth,
)
from driftplan.report.cli import main

SHARED = Path(__file__).resolve().parents[3] / "shared"
CASES, DATA = SHARED / "cases", SHARED / "data"
WORLDS = {  # share of free ground and what is said, or why it is refused
    "maps/ascii.yaml": (0.484, ""),
    "maps/extra_key.yaml": (0.484, ""),
    "maps/free_thresh_025.yaml": (0.921, "grey 205, .* is free by its free_thresh of 0.25, .*: 0.196 keeps it unknown"),
    "maps/grey.yaml": (0.484, ""),
    "maps/grey_alpha.yaml": (0.484, ""),
    "maps/indexed.yaml": (0.484, ""),
    "maps/keys_twice.yaml": (MapError, "line 7: .* 'resolution' occurs twice"),
    "maps/mode_capital.yaml": (0.484, ""),
    "maps/scale_0_1.yaml": (0.484, ""),
    "maps/stale_absolute_path.yaml": (0.484, "is not here; grey.pgm beside the map is taken"),
    "geojson/degrees_no_crs.geojson": (MapError, "look like longitudes and latitudes; .*: project the map first"),
    "geojson/metres.geojson": (0.96, ""),
    "geojson/web_mercator.geojson": (
        MapError,
        "EPSG::3857.*; expected metres: project the map first.*, or give degrees an origin",
    ),
}
OTHERS = {
    "zones/ok.yaml": (load_zones, None),
    "zones/scientific.yaml": (load_zones, None),
    "noise/key_twice.yaml": (load_noise, "'heading_var_per_m' occurs twice"),
    "routes/decimal_commas.csv": (read_path, "comma and semicolon in one line"),
    "routes/heading_in_degrees.csv": (read_path, r"call the column heading \[deg\]"),
    "routes/trips_bom.csv": (load_trips, None),
}
REAL_MAPS = {
    "nav2_depot/depot.yaml": (30.2, 15.35, "grey 205"),
    "nav2_depot/depot_keepout.yaml": (30.2, 15.35, "grey 205"),
    "nav2_depot/depot_speed.yaml": (30.2, 15.35, ""),
    "movingai/Berlin_1_256.map": (256.0, 256.0, ""),
    "movingai/room-64-64-8.map": (64.0, 64.0, ""),
}


def shared(file: Path) -> Path:
    if not file.exists():
        pytest.skip(f"{file} is not here")
    return file


@pytest.mark.parametrize("name", WORLDS)
def test_maps_as_people_have_them(name):
    right, said = WORLDS[name]
    file = shared(CASES / name)
    if not isinstance(right, float):
        with pytest.raises(right, match=said):
            load_world(file, robot_radius=0.0)
        return
    world = load_world(file, robot_radius=0.0)
    xmin, ymin, xmax, ymax = world.bounds
    assert 1 - world.obstacles.area / ((xmax - xmin) * (ymax - ymin)) == pytest.approx(right, abs=1e-3)
    assert len(world.notes) == bool(said)
    assert re.search(said, "".join(world.notes))


@pytest.mark.parametrize("name", OTHERS)
def test_zones_noises_and_routes_as_people_have_them(name):
    reader, wrong = OTHERS[name]
    file = shared(CASES / name)
    if wrong is None:
        assert len(reader(file)) > 0
    else:
        with pytest.raises((MapError, TrajectoryError), match=wrong):
            reader(file)


LOGS = {  # moments and what is said, or why it is refused; other readers than those named refuse it by its columns
    "kitti_camera_frame.txt": (read_truth, 2401, ""),
    "kitti_lidar_frame.txt": (read_truth, TrajectoryError, "a frame with z upwards"),
    "odometry.csv": (read_odometry, 2401, ""),
    "odometry_clock_back.csv": (read_odometry, 1200, "the clock is set back by 99.9 s in row 1201"),
    "odometry_degrees.csv": (read_odometry, 2401, ""),
    "pose_and_command.csv": (read_odometry, TrajectoryError, "velocities and poses: say by kind which of them"),
    "ros_echo.csv": (read_odometry, 2401, "nanoseconds since 1970"),
    "truth.csv": (read_truth, 2401, ""),
    "truth_ns.csv": (read_truth, 2401, "nanoseconds since 1970"),
    "truth_wxyz.txt": (read_truth, TrajectoryError, "w first, qw qx qy qz, would fit"),
    "truth_x_y_yaw.txt": (read_truth, TrajectoryError, "times fall in 1544 of 2401 rows"),
    "velocities.csv": (read_odometry, 2400, ""),
    "velocities_kmh.csv": (read_odometry, 2400, ""),
    "velocities_ns.csv": (read_odometry, 2400, "nanoseconds since 1970"),
    "velocities_out_of_order.csv": (read_odometry, 2400, "840 rows were not in the order of their times"),
}


@pytest.mark.parametrize("name", LOGS)
def test_recordings_as_people_have_them(name):
    reader, right, said = LOGS[name]
    file = shared(CASES / "logs" / name)
    if right is TrajectoryError:
        with pytest.raises(right, match=said):
            reader(file)
        return
    log = reader(file)
    assert len(log.times) == right
    assert bool(log.notes) == bool(said)
    assert said in "".join(log.notes)


NO_INPUTS = ("README.md", "cases/scripts/*", "data/orlib/*")  # programs, and problems for a solver of coverings
OTHER_TABLES = {"data/mrclam7/Landmark_Groundtruth.dat": "5 columns do not say what they are"}


@pytest.mark.parametrize("name", OTHER_TABLES)
def test_tables_that_are_no_recordings_are_refused(name):
    for reader in (read_odometry, read_truth):
        with pytest.raises(TrajectoryError, match=OTHER_TABLES[name]):
            reader(shared(SHARED / name))


def test_every_file_is_tried():
    """Each that is there is read or refused by a test above or below, or named by a map that is."""
    claimed = {f"cases/{name}" for name in (*WORLDS, *OTHERS)} | {f"cases/logs/{name}" for name in LOGS}
    claimed |= {f"data/{name.partition(':')[0]}" for name in (*REAL_MAPS, *DRIVES, *GRAPHS)} | {*OTHER_TABLES}
    there = [file for folder in (CASES, DATA) for file in shared(folder).rglob("*") if file.is_file()]
    named = {file.parent / word for file in there if file.suffix == ".yaml" for word in file.read_text().split()}
    for file in there:
        name = str(file.relative_to(SHARED))
        known = name in claimed or file in named or any(file.match(pattern) for pattern in NO_INPUTS)
        assert known, f"{name} is read by no test"


@pytest.mark.parametrize("name", REAL_MAPS)
def test_maps_that_others_ship(name):
    width, height, said = REAL_MAPS[name]
    world = load_world(shared(DATA / name), robot_radius=0.0)
    assert world.bounds == pytest.approx((0.0, 0.0, width, height))
    assert 0.1 < 1 - world.obstacles.area / (width * height) < 1
    assert (said in world.notes[0]) if said else not world.notes


DRIVES = {  # how many moments they have; None: as many as lines
    "euroc_v1_02/stamped_groundtruth.txt.gz": (read_truth, 16702),
    "euroc_v1_02/stamped_traj_estimate0.txt.gz": (read_truth, 1355),
    **{f"euroc_v1_02/stamped_traj_estimate{k}.txt.gz": (read_truth, None) for k in range(1, 6)},
    "kitti_00/KITTI_00_gt.txt.gz": (read_truth, 4541),
    "mrclam7/Robot1_Groundtruth.dat.gz": (read_truth, 58389),
    "mrclam7/Robot1_Odometry.dat.gz": (read_odometry, 58598),
    **{f"mrclam7/Robot{k}_Groundtruth.dat.gz": (read_truth, None) for k in (2, 3)},
    **{f"mrclam7/Robot{k}_Odometry.dat.gz": (read_odometry, None) for k in (2, 3)},
    "plaza1/Plaza1_.mat:GT": (read_truth, 9658),
    "plaza1/Plaza1_.mat:DR": (read_odometry, 9658),
}
GRAPHS = {  # nodes and edges
    "nav2_depot/depot_graph.geojson": (34, 78),
    "nav2_route/aws_graph.geojson": (40, 84),
    "open_rmf/office.building.yaml": (73, 60),
}


@pytest.mark.parametrize("name", DRIVES)
def test_drives_that_others_ship(name):
    read, moments = DRIVES[name]
    file, _, variable = name.partition(":")
    said = {"variable": variable} if variable else {}
    said |= {"kind": "increments"} if variable == "DR" else {}
    log = read(shared(DATA / file), **said)
    if moments is None:
        lines = gzip.decompress((DATA / file).read_bytes()).splitlines()
        moments = sum(line[:1] not in b"#%" for line in lines) - getattr(log, "repeated", 0)
    assert len(log.times) == moments


@pytest.mark.parametrize("name", GRAPHS)
def test_graphs_that_others_ship_keep_every_edge_in_lif(name, tmp_path):
    graph = load_graph(shared(DATA / name))
    assert (len(graph.xy), len(graph.edges)) == GRAPHS[name]
    (tmp_path / "a.lif").write_bytes(graph_lif(graph))
    again = load_graph(tmp_path / "a.lif")
    np.testing.assert_allclose(again.routes(), graph.routes(), rtol=1e-12)


def small(folder: Path, pixels: Image.Image, name: str = "map.png", **keys: object) -> Path:
    """A map of 0.5 m per pixel."""
    pixels.save(folder / name)
    values = {"image": name, "resolution": 0.5, "origin": [0, 0, 0], "negate": 0, "occupied_thresh": 0.65} | keys
    values.setdefault("free_thresh", 0.196)
    (folder / "map.yaml").write_text("".join(f"{key}: {value}\n" for key, value in values.items()))
    return folder / "map.yaml"


GREYS = Image.fromarray(np.array([[254, 150, 0]], dtype=np.uint8))


@pytest.mark.parametrize("mode", ["L", "LA", "RGB", "RGBA", "P"])
@pytest.mark.parametrize("rule", ["trinary", "scale", "Trinary", "SCALE"])
def test_a_picture_saved_again_is_the_same_map(tmp_path, mode, rule):
    world = load_world(small(tmp_path, GREYS.convert(mode), mode=rule, map_type="occupancy"), robot_radius=0.0)
    assert world.obstacles.bounds == (0.5, 0.0, 1.5, 0.5)
    assert world.notes == ()


def test_the_command_says_what_a_map_is_taken_for(tmp_path, capsys):
    path = small(tmp_path, Image.fromarray(np.array([[205] * 9] * 9, dtype=np.uint8)), free_thresh=0.25)
    assert main(["compare", str(path), "--start", "1,1", "--goal", "3,3", "--iterations", "1"]) == 0
    assert "is free by its free_thresh of 0.25, as map_server has it" in capsys.readouterr().err


def test_what_is_not_opaque_is_unknown(tmp_path):
    picture = Image.fromarray(np.array([[[254, 254, 254, 255], [254, 254, 254, 254], [0, 0, 0, 0]]], dtype=np.uint8))
    path = small(tmp_path, picture)
    assert load_world(path, robot_radius=0.0).obstacles.bounds == (0.5, 0.0, 1.5, 0.5)
    assert load_world(path, robot_radius=0.0, unknown_is_free=True).obstacles.is_empty


def test_scientific_notation_is_a_number_everywhere(tmp_path):
    assert load_world(small(tmp_path, GREYS, resolution="5e-1"), robot_radius=0.0).bounds == (0, 0, 1.5, 0.5)
    (tmp_path / "noise.yaml").write_text("heading_var_per_m: 1e-4\n")
    assert load_noise(tmp_path / "noise.yaml").heading_var_per_m == 1e-4


@pytest.mark.parametrize("resolution", ["1e-320", "0", "-1", ".inf", "9" * 400, "yes"])
def test_a_resolution_is_a_length_of_cells(tmp_path, resolution):
    with pytest.raises(MapError, match=r"map\.yaml: expected resolution"):
        load_world(small(tmp_path, GREYS, resolution=resolution), robot_radius=0.0)


def test_zones_that_touch_nothing_are_refused(tmp_path):
    Image.fromarray(np.array([[100]], dtype=np.uint8)).save(tmp_path / "floor.png")
    zones = tmp_path / "floor.yaml"
    zones.write_text("image: floor.png\nresolution: 1\norigin: [50, 0, 0]\nzones:\n  100: {heading_var_per_m: 1e-3}\n")
    with pytest.raises(MapError, match=r"floor\.yaml: no zone touches the map"):
        load_world(small(tmp_path, GREYS), robot_radius=0.0, zones=zones)
