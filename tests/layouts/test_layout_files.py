"""Layouts as files: what is written is read back, and installers are told what is true."""

import csv
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import shapely

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.beacon_files import beacons_geojson, fiducial_map, load_beacons, tags_yaml
from driftplan.beacons.readings import beacon_passes, drift_with_beacons
from driftplan.errors import MapError
from driftplan.layouts.layout_files import (
    installer_columns,
    installer_table,
    layout_building,
    layout_csv,
    layout_dxf,
    layout_geojson,
    layout_html,
    layout_lif,
)
from driftplan.layouts.place import place_beacons
from driftplan.layouts.scenario import Sites
from driftplan.model.noise import OdometryNoise
from driftplan.report.figures.sheet import layout_pdf, layout_sheet
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
SIGN = BeaconKind.landmark(2.5, 0.05, 0.01, detection_probability=0.95, reading_spacing_m=2.0, cost=4.0)
WORLD = World.from_polygons([[(5, 3), (35, 3), (35, 7), (5, 7)]], bounds=(0, 0, 40, 10), robot_radius=0.4)
ROUTES = [np.array([(1, 1.5), (39, 1.5)]), np.array([(39, 8.5), (1, 8.5)])]
OLD = Beacon(BeaconKind.rfid(1.5, 0.1), 20.0, 1.5, "old")


@pytest.fixture(scope="module")
def layout():
    return place_beacons(WORLD, ROUTES, NOISE, 0.9, Sites(SIGN, spacing_m=2.0, existing=[OLD]))


def test_a_layout_written_as_geojson_is_read_back_exactly(layout, tmp_path):
    file = tmp_path / "layout.geojson"
    file.write_bytes(layout_geojson(layout))
    assert load_beacons(file) == (*layout.existing, *layout.beacons)
    said = json.loads(file.read_text())
    assert said["driftplan"]["cost"] == layout.cost
    assert [f["properties"]["new"] for f in said["features"]] == [False] + [True] * len(layout.beacons)


def test_every_kind_of_beacon_survives_a_file(tmp_path):
    kinds = [SIGN, BeaconKind.rfid(1.0, 0.0), BeaconKind.heading(3.0, 0.1, line_of_sight=True)]
    kinds += [BeaconKind.range_only(30.0, 0.1, std_per_m=0.01), BeaconKind.bearing(9.0, 0.02, sensor_view_deg=70.0)]
    kinds += [BeaconKind(name="tag", range_m=2.0, position_std_m=0.1, view_angle_deg=150.0)]
    beacons = tuple(Beacon(kind, 1.0 / 3.0, -k, f"id {k}", facing_deg=30.0 * k) for k, kind in enumerate(kinds))
    file = tmp_path / "beacons.geojson"
    file.write_bytes(beacons_geojson(beacons))
    assert load_beacons(file) == beacons


def test_a_layout_of_no_beacons_is_read_back_as_none(tmp_path):
    file = tmp_path / "none.geojson"
    file.write_bytes(beacons_geojson([]))
    assert load_beacons(file) == ()


def test_installers_learn_the_nearest_wall_and_which_failure_hurts_most(layout):
    rows = installer_table(layout)
    assert {row.id for row in rows} == {b.id for b in (*layout.existing, *layout.beacons)}
    hurts = [row.worst_drift_if_dead_m for row in rows]
    assert hurts == sorted(hurts, reverse=True)
    beacons = {b.id: b for b in (*layout.existing, *layout.beacons)}
    for row in rows:
        assert (row.x_m, row.y_m) == (beacons[row.id].x, beacons[row.id].y)
        distance = shapely.distance(WORLD.obstacles, shapely.Point(row.x_m, row.y_m))
        assert row.nearest_wall_m == pytest.approx(distance)
        assert shapely.distance(WORLD.obstacles, shapely.Point(row.wall_x_m, row.wall_y_m)) == pytest.approx(
            0.0, abs=1e-12
        )
        rest = [b for b in beacons.values() if b.id != row.id]
        worst = [drift_with_beacons(r, NOISE, rest, WORLD).profile().rms.max() for r in ROUTES]
        assert row.worst_drift_if_dead_m == pytest.approx(worst[row.worst_route_if_dead])
        assert row.new == (row.id != "old")
        assert row.routes == tuple(k for k, r in enumerate(ROUTES) if len(beacon_passes(r, beacons[row.id], WORLD)))


def test_the_csv_has_a_header_with_units_and_a_line_per_beacon(layout):
    rows = list(csv.DictReader(io.StringIO(layout_csv(layout).decode())))
    assert len(rows) == len(layout.existing) + len(layout.beacons)
    assert float(rows[0]["worst_drift_if_dead_m"]) == round(installer_table(layout)[0].worst_drift_if_dead_m, 4)
    assert {"id", "kind", "x_m", "y_m", "nearest_wall_m", "routes"} <= set(rows[0])
    assert [row["routes"].split() for row in rows] == [[str(r) for r in row.routes] for row in installer_table(layout)]


def test_without_a_map_walls_are_left_empty():
    layout = place_beacons(None, ROUTES, NOISE, 0.9, BeaconKind.rfid(1.5, 0.1))
    rows = list(csv.DictReader(io.StringIO(layout_csv(layout).decode())))
    assert {row["nearest_wall_m"] for row in rows} == {""}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "line 1: not JSON"),
        ("[]", "expected a GeoJSON FeatureCollection"),
        ('{"type": "FeatureCollection", "features": [{}]}', "at least one Point feature"),
        (
            '{"type": "FeatureCollection", "features": [{"geometry": {"type": "Point", "coordinates": [1, 2]}}]}',
            "feature 1: expected properties",
        ),
        (
            '{"type": "FeatureCollection", "features": [{"geometry": {"type": "Point", "coordinates": [1, 2]}, '
            '"properties": {"range_m": -1, "position_std_m": 0.1}}]}',
            "feature 1: expected a beacon: expected range_m > 0",
        ),
        (
            '{"type": "FeatureCollection", "features": [{"geometry": {"type": "Point", "coordinates": ["a", 2]}, '
            '"properties": {"range_m": 1, "position_std_m": 0.1}}]}',
            r"feature 1: expected positions \[x, y\] in metres.*got \['a', 2\]",
        ),
    ],
)
def test_a_file_of_no_beacons_is_refused_by_name_and_feature(text, said, tmp_path):
    file = tmp_path / "beacons.geojson"
    file.write_text(text)
    with pytest.raises(MapError, match=said) as caught:
        load_beacons(file)
    assert str(file) in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(MapError, match=r"nowhere\.geojson: cannot be read"):
        load_beacons(tmp_path / "nowhere.geojson")


def test_installers_learn_which_way_a_tag_looks():
    front = BeaconKind(name="tag", range_m=2.5, position_std_m=0.05, heading_std=0.01, view_angle_deg=180.0)
    points = [(x, y) for x in (8, 16, 24, 32) for y in (1, 2)]
    layout = place_beacons(WORLD, ROUTES[:1], NOISE, 0.9, Sites(front, points))
    facing = {b.id: b.facing_deg for b in layout.beacons}
    assert {row.id: row.facing_deg for row in installer_table(layout)} == facing
    assert set(facing.values()) <= {0.0, 90.0, 180.0, 270.0}
    row = next(csv.DictReader(io.StringIO(layout_csv(layout).decode())))
    assert float(row["facing_deg"]) == facing[row["id"]]
    old = place_beacons(WORLD, ROUTES[:1], NOISE, 9.0, Sites(front, points, existing=[OLD]))
    assert [np.isnan(row.facing_deg) for row in installer_table(old)] == [True]


def test_a_layout_of_no_beacons_has_an_empty_table():
    assert installer_table(place_beacons(WORLD, ROUTES[:1], NOISE, 9.0, SIGN)) == ()


def test_files_print_numbers_as_people_write_them_and_say_that_they_are_local_metres():
    layout = place_beacons(WORLD, ROUTES, NOISE, 0.9, Sites(SIGN, spacing_m=1.2))
    numbers = re.findall(r"\d+\.\d+", layout_csv(layout).decode())
    assert max(len(number.split(".")[1]) for number in numbers) <= 4
    text = layout_geojson(layout).decode()
    coordinates = [x for f in json.loads(text)["features"] for x in f["geometry"]["coordinates"]]
    assert all(x == round(x, 9) for x in coordinates)
    assert json.loads(text)["crs"]["properties"]["name"].startswith("LOCAL_CS[")
    assert "longitude" not in text


BUILDING = """\
name: hall
levels:
  L1:
    measurements:
      - [0, 1, {distance: [3, 40]}]
    vertices:
      - [0, 0, 0, ""]
      - [400, 0, 0, ""]
    walls: []
"""


def test_a_layout_reads_back_the_same_from_every_file_that_has_places(tmp_path):
    """Places to a nanometre, ids and directions; what beacons measure is asked for."""
    pytest.importorskip("ezdxf")
    front = replace(SIGN, view_angle_deg=150.0)
    layout = place_beacons(WORLD, ROUTES, NOISE, 0.9, Sites(front, spacing_m=2.0))
    assert layout.beacons
    (tmp_path / "hall.building.yaml").write_text(BUILDING)
    files = {
        "a.dxf": layout_dxf(layout),
        "a.lif": layout_lif(layout),
        "a.building.yaml": layout_building(layout, tmp_path / "hall.building.yaml"),
        "tags.yaml": tags_yaml(layout.beacons, size_m=0.2),
        "map.txt": fiducial_map(layout.beacons),
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        again = load_beacons(tmp_path / name, front)
        if name.startswith("a."):
            assert [beacon.id for beacon in again] == [beacon.id for beacon in layout.beacons]
        np.testing.assert_allclose([b.xy for b in again], [b.xy for b in layout.beacons], atol=1e-6)
        turned = np.radians([a.facing_deg - b.facing_deg for a, b in zip(again, layout.beacons, strict=True)])
        np.testing.assert_allclose(np.cos(turned), 1)
        with pytest.raises(MapError, match="says nothing of what beacons measure: load them with a kind"):
            load_beacons(tmp_path / name)


def test_installers_measure_from_the_nearest_wall(layout):
    ezdxf = pytest.importorskip("ezdxf")
    drawing = ezdxf.read(io.StringIO(layout_dxf(layout).decode()))
    assert drawing.audit().errors == []
    measured = [dimension.get_measurement() for dimension in drawing.modelspace().query("DIMENSION")]
    rows = [row.nearest_wall_m for row in installer_table(layout) if row.nearest_wall_m > 1e-3]
    assert sorted(measured) == pytest.approx(sorted(rows))


def test_the_table_as_a_page_says_what_the_csv_says(layout):
    page = layout_html(layout).decode()
    rows = [re.findall(r"<td[^>]*>([^<]*)</td>", line) for line in page.split("<tr>")[2:]]
    said = list(csv.DictReader(io.StringIO(layout_csv(layout).decode())))
    assert [row[0] for row in rows] == [line["id"] for line in said]
    assert [float(row[2]) for row in rows] == pytest.approx([float(line["x_m"]) for line in said], abs=0.006)
    assert page.startswith("<!DOCTYPE html>")
    assert "Metres in the frame map" in page


def test_installers_learn_the_side_of_the_wall(layout):
    row = installer_table(layout)[0]._replace(x_m=1.0, y_m=1.0, nearest_wall_m=1.0, wall_x_m=1.0, wall_y_m=1.0)
    cases = {
        "above wall": row._replace(wall_y_m=0.0),
        "below wall": row._replace(wall_y_m=2.0),
        "right of wall": row._replace(wall_x_m=0.1),
        "left of wall": row._replace(wall_x_m=2.0),
        "on the wall": row._replace(nearest_wall_m=0.0),
        "faces 90°": row._replace(facing_deg=90.0),
        "-": row._replace(nearest_wall_m=np.nan),
    }
    assert installer_columns([*cases.values()])["mounted"] == [*cases]


@pytest.mark.parametrize("count", [1, pytest.param(120, marks=pytest.mark.slow)])
def test_the_sheet_is_one_page_a3_to_a_round_scale(count):
    tags = tuple(Beacon(BeaconKind.rfid(1.5, 0.1), 0.3 * k, 1.5 + k % 3, f"T{k}", facing_deg=k) for k in range(count))
    layout = place_beacons(WORLD, ROUTES, NOISE, 9.0, Sites(SIGN, spacing_m=2.0, existing=tags))
    page = layout_pdf(layout)
    (box,) = re.findall(rb"/MediaBox \[ ?([\d. ]+)\]", page)
    assert [float(v) / 72 * 25.4 for v in box.split()] == pytest.approx([0, 0, 420, 297], abs=0.5)
    assert page == layout_pdf(layout)
    figure = layout_sheet(layout)
    plan, table, bar = figure.axes
    width_m, width_mm = np.diff(plan.get_xlim())[0], plan.get_position().width * 420
    (scale,) = (int(text.get_text().split()[3]) for text in figure.texts if text.get_text().startswith("scale"))
    assert width_m / (width_mm / 1000) == pytest.approx(scale)
    assert plan.get_position().height * 297 / 1000 * scale == pytest.approx(np.diff(plan.get_ylim())[0])
    bar_m = float(next(text.get_text() for text in figure.texts if text.get_text().endswith(" m")).split()[0])
    assert bar.get_position().width * 420 / 1000 * scale == pytest.approx(bar_m)
    listed = {text.get_text() for text in table.texts}
    shown = listed & {tag.id for tag in tags}
    assert len(shown) == count or f"and {count - len(shown)} more, in the CSV table" in listed
    drawn = {text.get_text() for text in plan.texts}
    assert {tag.id for tag in tags} <= drawn
