"""What is written is read back, whatever it is: maps, zones, beacons, graphs and recordings, in every format.

Formats that are only read (IMDF, buildings, recordings) are written here, from their specifications. Noises, routes and
tags come back in `test_noise_files`, `test_route_files` and `test_tag_files`.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import asdict
from itertools import pairwise

import numpy as np
import pytest
import shapely
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan import (
    Beacon,
    BeaconKind,
    OdometryNoise,
    RouteGraph,
    World,
    Zone,
    graph_lif,
    load_beacons,
    load_graph,
    load_world,
    load_zones,
    read_odometry,
    read_truth,
    save_world,
)
from driftplan.beacons.beacon_files import beacons_geojson
from driftplan.world.building_map import building_marks, building_with_marks
from driftplan.world.dxf_map import drawing_of, read_dxf_marks
from driftplan.world.formats import Mark

SOME = settings(max_examples=25, deadline=None)
FINE = st.integers(0, 2000).map(lambda k: k / 100)  # centimetres
NAMES = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=8)
MARKS = st.lists(
    st.builds(Mark, NAMES, FINE, FINE, st.none() | st.floats(-180, 180)), max_size=5, unique_by=lambda mark: mark.name
)
RATES = st.floats(0, 0.1)


@st.composite
def rooms(draw, zones: bool = False) -> World:
    """Pillars of 1 m and more that do not touch, in a hall of 24 x 24 m, and floors of other noise."""
    places = draw(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=8, unique=True))
    walls = []
    for column, row in places:
        x, y, w, h = (draw(st.integers(0, 100)) / 100 for _ in range(4))
        walls.append(shapely.box(4 * column + 1 + x, 4 * row + 1 + y, 4 * column + 3 + w, 4 * row + 3 + h))
    noises = draw(st.lists(st.builds(OdometryNoise, heading_var_per_m=RATES, distance_var_per_m=RATES), max_size=3))
    floors = [
        Zone(shapely.box(k, k, k + 3, k + 2.5), noise) for k, noise in enumerate(noises) if noise != OdometryNoise()
    ]
    return World.from_polygons(walls, bounds=(0, 0, 24, 24), robot_radius=0.2, zones=floors if zones else ())


def same_area(a, b, less: float = 1e-6) -> bool:
    return a.symmetric_difference(b).area < less


@given(world=rooms(zones=True))
@SOME
def test_geojson_keeps_everything(world, tmp_path_factory):
    file = tmp_path_factory.mktemp("map") / "a.geojson"
    save_world(world, file)
    again = load_world(file, robot_radius=0.2)
    assert again.bounds == world.bounds
    assert again.obstacles.normalize().equals_exact(world.obstacles.normalize(), 1e-13)  # 9.6, not 9.600000000000001
    for zone, other in zip(again.zones, world.zones, strict=True):
        for rate in ("heading_var_per_m", "distance_var_per_m"):
            assert getattr(zone.noise, rate) == pytest.approx(getattr(other.noise, rate), rel=1e-14)
        assert zone.polygon == other.polygon
    if world.zones:
        assert [zone.noise for zone in load_zones(file)] == [zone.noise for zone in again.zones]


@given(grid=st.integers(0, 2**32 - 1), size=st.sampled_from([0.05, 0.1, 0.25, 1.0]), height=st.integers(1, 12))
@SOME
def test_cells_are_the_same_cells(grid, size, height, tmp_path_factory):
    """Of ROS and MovingAI maps, whose cells have the world's own size."""
    folder = tmp_path_factory.mktemp("map")
    occupied = np.random.default_rng(grid).random((height, 9)) < 0.3
    boxes = [shapely.box(c * size, r * size, (c + 1) * size, (r + 1) * size) for r, c in np.argwhere(occupied)]
    world = World.from_polygons(boxes, bounds=(0, 0, 9 * size, height * size), robot_radius=0.0)
    for name, option in (("a.yaml", {}), ("a.map", {"cell_size_m": size})):
        save_world(world, folder / name, cell_size_m=size)
        again = load_world(folder / name, robot_radius=0.0, **option)
        assert again.bounds == pytest.approx(world.bounds)
        assert same_area(again.obstacles, world.obstacles)


@given(world=rooms(), marks=MARKS, unit=st.sampled_from([1, 2, 4, 5, 6, 14]))
@settings(max_examples=6, deadline=None)
def test_drawings_keep_walls_and_marks(world, marks, unit, tmp_path_factory):
    """In metres as they are written, and scaled to any unit as other programs save them; ezdxf finds no fault."""
    ezdxf = pytest.importorskip("ezdxf")
    file = tmp_path_factory.mktemp("map") / "a.dxf"
    file.write_bytes(drawing_of(world, [np.array([[0.0, 0.0], [3.0, 3.0]])], marks))
    drawing = ezdxf.readfile(file)
    assert not drawing.audit().has_errors
    assert drawing.header.custom_vars.get("DRIFTPLAN") == "driftplan file version 1, frame map, metres"
    assert [(m.name, m.facing_deg) for m in read_dxf_marks(file)] == [
        (m.name, pytest.approx(m.facing_deg)) for m in marks
    ]
    np.testing.assert_allclose([m[1:3] for m in read_dxf_marks(file)], [m[1:3] for m in marks], atol=1e-9)
    for entity in [e for e in drawing.modelspace() if e.dxf.layer != "WALLS"]:
        drawing.modelspace().delete_entity(entity)
    metres = {1: 0.0254, 2: 0.3048, 4: 1e-3, 5: 1e-2, 6: 1.0, 14: 0.1}[unit]
    drawing.units = unit
    for entity in drawing.modelspace():
        entity.scale(1 / metres, 1 / metres, 1)
    drawing.saveas(file)
    again = load_world(file, robot_radius=0.2)
    assert same_area(again.obstacles, world.obstacles.buffer(0.025, join_style="mitre"))


@given(world=rooms(), pixel=st.floats(0.01, 0.2), marks=MARKS, both=st.lists(st.booleans(), min_size=1, max_size=4))
@SOME
def test_buildings_keep_floors_walls_lanes_and_marks(world, pixel, marks, both, tmp_path_factory):
    file = tmp_path_factory.mktemp("map") / "a.building.yaml"
    corners = [(0, 0), (24, 0), (24, 24), (0, 24), *(p for w in world.obstacles.geoms for p in w.exterior.coords[:-1])]
    nodes = [(2.0 + k, 0.5) for k in range(len(both) + 1)]
    vertices = [[float(x / pixel), float((24 - y) / pixel), 0, ""] for x, y in [*corners, *nodes]]
    walls = [[4 + 4 * k + a, 4 + 4 * k + (a + 1) % 4, {}] for k in range(len(world.obstacles.geoms)) for a in range(4)]
    lanes = [[len(corners) + k, len(corners) + k + 1, {"bidirectional": [4, way]}] for k, way in enumerate(both)]
    level = {
        "vertices": vertices, "walls": walls, "lanes": lanes, "floors": [{"vertices": [0, 1, 2, 3], "parameters": {}}],
        "measurements": [[0, 1, {"distance": [3, 24.0]}]],
    }  # fmt: skip
    file.write_text(yaml.safe_dump({"coordinate_system": "reference_image", "levels": {"L1": level}}))
    again = load_world(file, robot_radius=0.2)
    assert again.bounds == pytest.approx((0, -24, 24, 0))
    rings = shapely.union_all([w.exterior.buffer(0.05, cap_style="square") for w in world.obstacles.geoms])
    drawn = shapely.transform(again.obstacles, lambda xy: xy + np.array([0, 24]))
    assert same_area(shapely.union(drawn, rings), drawn, 0.2)
    graph = load_graph(file)
    ways = zip(pairwise(nodes), both, strict=True)
    expected = [e for (a, b), back in ways for e in ([(a, b), (b, a)] if back else [(a, b)])]
    np.testing.assert_allclose(np.array(graph.routes()) + np.array([0, 24]), expected, atol=1e-9)
    file.write_bytes(building_with_marks(file, marks))
    found = building_marks(file)
    assert [mark.name for mark in found] == [mark.name for mark in marks]
    for mark, other in zip(found, marks, strict=True):
        assert mark[1:3] == pytest.approx(other[1:3], abs=1e-6)
        assert mark.facing_deg == pytest.approx(other.facing_deg)
    np.testing.assert_allclose(np.array(load_graph(file).routes()), graph.routes())


@given(world=rooms(), longitude=st.floats(-170, 170), latitude=st.floats(-70, 70))
@SOME
def test_venues_keep_their_rooms(world, longitude, latitude, tmp_path_factory):
    """Rooms are free but for 5 cm along their walls; what no room covers is not."""
    flat = 0.00669437999014
    bend = 1 - flat * np.sin(np.radians(latitude)) ** 2
    metres = 6378137.0 * np.radians(1) * np.array(
        [np.cos(np.radians(latitude)) / np.sqrt(bend), (1 - flat) / bend**1.5]
    )  # fmt: skip

    def part(kind, shapes):
        features = []
        for k, shape in enumerate(shapes):
            there = shapely.transform(shape, lambda xy: xy / metres + (longitude, latitude))
            held = {"ordinal": 0} if kind == "level" else {"level_id": "level-0", "category": "room"}
            held = {"feature_type": kind, "properties": held, "geometry": json.loads(shapely.to_geojson(there))}
            features.append({"type": "Feature", "id": f"{kind}-{k}", **held})
        return json.dumps({"type": "FeatureCollection", "features": features})

    file = tmp_path_factory.mktemp("map") / "a.imdf"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("level.geojson", part("level", [shapely.box(*world.bounds)]))
        archive.writestr("unit.geojson", part("unit", list(world.obstacles.geoms)))
    again = load_world(file, robot_radius=0.0, origin=(longitude, latitude))
    assert again.bounds == pytest.approx(world.bounds, abs=1e-2)
    free = shapely.box(*again.bounds).difference(again.obstacles)
    assert same_area(free, world.obstacles.buffer(-0.05, join_style="mitre"), 0.5)


@st.composite
def kinds(draw) -> BeaconKind:
    std = st.floats(0.001, 0.5)
    measured = draw(st.dictionaries(
        st.sampled_from(["position_std_m", "heading_std", "range_std_m", "bearing_std"]), std, min_size=1
    ))  # fmt: skip
    return BeaconKind(
        name=draw(NAMES), range_m=draw(st.floats(0.5, 20)), detection_probability=draw(st.floats(0.1, 1)),
        line_of_sight=draw(st.booleans()), cost=draw(st.floats(0.1, 50)), view_angle_deg=draw(st.floats(10, 360)),
        sensor_view_deg=draw(st.floats(10, 360)), reading_spacing_m=draw(st.floats(0.1, 5)), **measured,
    )  # fmt: skip


@given(st.lists(st.builds(Beacon, kinds(), FINE, FINE, NAMES, st.floats(-360, 360)), max_size=4))
@SOME
def test_beacons_are_the_same_beacons(tmp_path_factory, beacons):
    file = tmp_path_factory.mktemp("beacons") / "a.geojson"
    file.write_bytes(beacons_geojson(beacons))
    for again, beacon in zip(load_beacons(file), beacons, strict=True):
        assert again.id == beacon.id
        assert [again.x, again.y, again.facing_deg] == pytest.approx([beacon.x, beacon.y, beacon.facing_deg], rel=1e-14)
        for name, value in asdict(beacon.kind).items():
            found = getattr(again.kind, name)
            assert found == (pytest.approx(value, rel=1e-14) if isinstance(value, float) else value)


@given(seed=st.integers(0, 10**6))
@SOME
def test_graphs_are_the_same_graphs(seed, tmp_path_factory):
    rng = np.random.default_rng(seed)
    count, edges = int(rng.integers(2, 8)), int(rng.integers(1, 12))
    graph = RouteGraph.numbered(rng.uniform(-99, 99, (count, 2)).round(3), rng.integers(0, count, (edges, 2)))
    file = tmp_path_factory.mktemp("graph") / "a.lif"
    file.write_bytes(graph_lif(graph))
    again = load_graph(file)
    assert again.node_ids == tuple(map(str, graph.node_ids))
    assert again.edge_ids == tuple(map(str, graph.edge_ids))
    assert again.xy.tolist() == graph.xy.tolist()
    assert again.edges.tolist() == graph.edges.tolist()


def rows_of(kind: str, times, xy, heading) -> str:
    if kind == "tum":
        half = heading / 2
        table = np.column_stack([times, xy, 0 * times, 0 * times, 0 * times, np.sin(half), np.cos(half)])
    elif kind == "kitti":  # z ahead, x to the right
        c, s, o, i = np.cos(heading), np.sin(heading), 0 * times, 0 * times + 1
        table = np.column_stack([c, o, -s, -xy[:, 1], o, i, o, o, s, o, c, xy[:, 0]])
    else:
        table = np.column_stack([times, xy, heading])
    rows = ["time,x,y,heading"] * (kind == "csv")
    rows += [(", " if kind == "csv" else " ").join(map(repr, row)) for row in table.tolist()]
    if kind == "carmen":
        return "".join(
            f"ODOM {x!r} {y!r} {h!r} 0 0 0 {t!r} host {t!r}\n"
            for t, (x, y), h in zip(times.tolist(), xy.tolist(), heading.tolist(), strict=True)
        )
    if kind == "g2o":
        return "".join(
            f"VERTEX_SE2 {k} {x!r} {y!r} {h!r}\n"
            for k, ((x, y), h) in enumerate(zip(xy.tolist(), heading.tolist(), strict=True))
        )
    return "\n".join([*rows, ""])


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("csv", "a.csv"),
        ("tum", "a.txt"),
        ("kitti", "b.txt"),
        ("carmen", "a.log"),
        ("g2o", "a.g2o"),
        ("mrclam", "a.dat"),
    ],
)
@given(seed=st.integers(0, 10**6))
@settings(max_examples=10, deadline=None)
def test_recordings_are_the_same_drives(kind, name, seed, tmp_path_factory):
    """Drives that look where they go, ten poses a second (g2o has no times: one a second)."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(20, 60))
    heading = np.cumsum(rng.normal(0, 0.05, count))
    steps = 0.1 * np.exp(1j * heading)
    place = np.concatenate([[0], np.cumsum(steps[:-1])]) + rng.uniform(-50, 50)
    times = np.arange(count) / (1.0 if kind == "g2o" else 10.0)
    xy = np.column_stack([place.real, place.imag])
    file = tmp_path_factory.mktemp("log") / name
    file.write_text(rows_of(kind, times, xy, heading))
    if kind == "carmen":
        log = read_odometry(file)
        np.testing.assert_allclose(log.times, times)
        away = (place - place[0]) * np.exp(-1j * heading[0])
        turned = (log.positions - log.positions[0]) * np.exp(-1j * log.headings[0])
        np.testing.assert_allclose(turned, away, atol=1e-9)
        return
    truth = read_truth(file)
    np.testing.assert_allclose(truth.times, times, atol=1e-9)
    np.testing.assert_allclose(truth.xy, xy, atol=1e-9)
    np.testing.assert_allclose(np.cos(truth.heading - heading), 1)
