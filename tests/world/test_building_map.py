"""Buildings of Open-RMF: walls, floors and lanes in metres, and what is wrong with a file is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from driftplan import (
    BeaconKind,
    MapError,
    OdometryNoise,
    graph_routes,
    load_beacons,
    load_graph,
    load_world,
    save_world,
)
from driftplan.world.building_map import building_marks, building_with_marks
from driftplan.world.formats import Mark

OFFICE = Path(__file__).resolve().parents[3] / "shared/data/open_rmf/office.building.yaml"
# 20 x 10 m, 10 pixels a metre, y downwards; a wall from the top to the middle; two lanes
SMALL = {
    "coordinate_system": "reference_image",
    "levels": {
        "L1": {
            "vertices": [[0, 0, 0, ""], [200, 0, 0, ""], [200, 100, 0, ""], [0, 100, 0, ""], [100, 0, 0, ""],
                         [100, 50, 0, ""], [20, 80, 0, "a"], [180, 80, 0, "b"], [180, 20, 0, "c"]],
            "measurements": [[0, 1, {"distance": [3, 20.0]}]],
            "walls": [[4, 5, {}]],
            "floors": [{"parameters": {}, "vertices": [0, 1, 2, 3]}],
            "lanes": [[6, 7, {"bidirectional": [4, True]}], [7, 8, {"bidirectional": [4, False]}]],
        }
    },
}  # fmt: skip


@pytest.fixture
def small(tmp_path):
    def write(change=lambda level: None):
        held = yaml.safe_load(yaml.safe_dump(SMALL))
        change(held["levels"]["L1"])
        file = tmp_path / "small.building.yaml"
        file.write_text(yaml.safe_dump(held))
        return file

    return write


def test_walls_floors_and_lanes_are_in_metres_with_y_upwards(small):
    world = load_world(small(), robot_radius=0.3)
    assert world.bounds == pytest.approx((0, -10, 20, 0))
    assert world.obstacles.bounds == pytest.approx((9.95, -5.05, 10.05, 0.05))
    assert world.segments_free([[9, -2], [9, -7]], [[11, -2], [11, -7]]).tolist() == [False, True]
    graph = load_graph(small())
    assert graph.xy[graph.edges].tolist() == [[[2, -8], [18, -8]], [[18, -8], [2, -8]], [[18, -8], [18, -2]]]
    assert graph_routes(graph, 6, 8, OdometryNoise(heading_var_per_m=1e-3))[0].nodes == (6, 7, 8)


def test_the_office_of_the_demos_is_as_large_as_measured_and_its_lanes_are_free():
    if not OFFICE.exists():
        pytest.skip("needs open_rmf in shared/data, made by others and not shipped")
    world, graph = load_world(OFFICE, robot_radius=0.2), load_graph(OFFICE)
    xmin, ymin, xmax, ymax = world.bounds
    assert (xmax - xmin, ymax - ymin) == pytest.approx((21.4, 10.9), abs=0.1)
    assert len(graph.edges) == 60  # 30 lanes, all both ways
    ends = graph.xy[graph.edges]
    assert world.segments_free(ends[:, 0], ends[:, 1]).all()


def test_another_level_is_chosen_by_its_name(small, tmp_path):
    held = yaml.safe_load(small().read_text())
    held["levels"]["L2"] = yaml.safe_load(yaml.safe_dump(held["levels"]["L1"])) | {"walls": []}
    (tmp_path / "two.building.yaml").write_text(yaml.safe_dump(held))
    assert load_world(tmp_path / "two.building.yaml", robot_radius=0.3, level="L2").obstacles.is_empty
    for level in (None, "L3"):
        with pytest.raises(MapError, match="expected level to be one of L1, L2, got"):
            load_world(tmp_path / "two.building.yaml", robot_radius=0.3, level=level)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda level: level.update(measurements=[]), "expected measurements"),
        (lambda level: level.update(measurements=[[0, 1, {}]]), "expected distance of a measurement"),
        (lambda level: level.update(measurements=[[0, 0, {"distance": [3, 1.0]}]]), "expected pixels of a measurement"),
        (lambda level: level.update(walls=[[0, 99]]), "expected walls from one of the 9 vertices"),
        (lambda level: level.update(walls=[["a", 1]]), "expected walls from one"),
        (lambda level: level.update(walls={"a": 1}), "expected walls to be at most"),
        (lambda level: level.update(floors=[]), "expected floors"),
        (lambda level: level.update(floors=[{"vertices": [0, 99]}]), "expected a floor with its vertices"),
        (lambda level: level.update(vertices=[["x", 0]]), "expected vertices to be positions"),
        (lambda level: level.update(vertices=[[1e300, 0], [0, 0]]), "expected vertices no greater"),
    ],
)
def test_what_is_wrong_is_named(small, change, said):
    with pytest.raises(MapError, match=rf"small\.building\.yaml: {said}"):
        load_world(small(change), robot_radius=0.3)


def test_buildings_are_read_only_and_have_options_of_their_own(small, tmp_path):
    world = load_world(small(), robot_radius=0.3)
    with pytest.raises(ValueError, match=r"Open-RMF maps are read only: save it as \.geojson"):
        save_world(world, tmp_path / "new.building.yaml")
    save_world(world, tmp_path / "new.geojson")
    with pytest.raises(ValueError, match="level is for Open-RMF and IMDF files: new\\.geojson is one of GeoJSON"):
        load_world(tmp_path / "new.geojson", robot_radius=0.3, level="L1")


def test_a_keepout_mask_adds_obstacles(small, tmp_path):
    mask = load_world(small(lambda level: level.update(walls=[[5, 2, {}]])), robot_radius=0.0)
    save_world(mask, tmp_path / "mask.yaml")
    world = load_world(small(), robot_radius=0.3, keepout=tmp_path / "mask.yaml")
    assert world.segments_free([[9, -2], [14, -9]], [[11, -2], [16, -6]]).tolist() == [False, False]
    assert load_world(small(), robot_radius=0.3).segments_free([[14, -9]], [[16, -6]]).tolist() == [True]
    save_world(load_world(small(), robot_radius=0.0), tmp_path / "far.geojson")
    (tmp_path / "mask.yaml").write_text((tmp_path / "mask.yaml").read_text().replace("origin: [", "origin: [5"))
    with pytest.raises(MapError, match="nothing that is marked lies on the map"):
        load_world(small(), robot_radius=0.3, keepout=tmp_path / "mask.yaml")


def test_lanes_that_lead_one_way_do(small):
    ends = load_graph(small()).edges.tolist()
    assert ends == [[6, 7], [7, 6], [7, 8]]
    with pytest.raises(MapError, match="expected lanes, got none"):
        load_graph(small(lambda level: level.update(lanes=[])))
    assert np.isfinite(load_graph(small()).xy).all()


@pytest.mark.parametrize("flow", [False, True])
def test_beacons_become_vertices_and_nothing_else_changes(small, flow):
    file = small()
    if flow:
        file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()), default_flow_style=True))
    before = file.read_text()
    content = building_with_marks(file, [Mark("A7", 2.0, -3.0, 90.0), Mark('"quoted" ü', 9.6, -8.1)]).decode()
    added = yaml.safe_load(content)
    vertices = added["levels"]["L1"]["vertices"]
    assert vertices[-2] == [20.0, 30.0, 0, "A7", {"driftplan_beacon": [4, True], "driftplan_facing_deg": [3, 90.0]}]
    assert vertices[-1] == [96.0, 81.0, 0, '"quoted" ü', {"driftplan_beacon": [4, True]}]
    del vertices[-2:]
    assert added == yaml.safe_load(before)
    if not flow:  # lines were added, none was touched
        assert [line for line in content.splitlines() if "driftplan" not in line] == before.splitlines()
    file.write_text(content)
    kind = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    assert [(b.id, b.x, b.y) for b in load_beacons(file, kind)] == [("A7", 2, -3), ('"quoted" ü', 9.6, -8.1)]
    assert len(load_graph(file).edges) == 3


def test_the_office_keeps_every_byte_but_the_new_vertices(tmp_path):
    if not OFFICE.exists():
        pytest.skip("needs open_rmf in shared/data, made by others and not shipped")
    content = building_with_marks(OFFICE, [Mark("A7", 2.0, -3.0)])
    old, new = OFFICE.read_bytes().splitlines(), content.splitlines()
    (added,) = [line for line in new if b"driftplan" in line]
    assert [line for line in new if line != added] == old
    (tmp_path / "a.building.yaml").write_bytes(content)
    (mark,) = building_marks(tmp_path / "a.building.yaml")
    assert (mark.name, mark.x, mark.y) == ("A7", pytest.approx(2.0), pytest.approx(-3.0))
