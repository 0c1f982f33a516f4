"""GeoJSON maps: kinds of features, noise of zones, and which feature of a broken file is at fault."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from driftplan import Beacon, BeaconKind, World, predict_drift
from driftplan.beacons.beacon_files import beacons_geojson
from driftplan.errors import MapError
from driftplan.model.noise import OdometryNoise
from driftplan.report.records import drift_geojson
from driftplan.world.geojson_map import geojson_map_files
from driftplan.world.mapfiles import load_world

SQUARE = [[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]


def feature(ring: list[Any] = SQUARE, *, geometry: Any = None, **properties: Any) -> dict[str, Any]:
    geometry = {"type": "Polygon", "coordinates": [ring]} if geometry is None else geometry
    return {"type": "Feature", "properties": properties, "geometry": geometry}


BOUNDARY = feature(kind="boundary")


def load(folder: Path, *features: Any, **more: Any) -> Any:
    path = folder / "some.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features), **more}))
    return load_world(path, robot_radius=0.5)


def test_walls_zones_and_the_outside_of_the_boundary(tmp_path):
    ell = [[0, 0], [10, 0], [10, 5], [5, 5], [5, 10], [0, 10], [0, 0]]
    world = load(
        tmp_path,
        feature([[1, 1], [2, 1], [2, 2], [1, 2], [1, 1]], kind="obstacle", name="pillar"),
        feature(ell, kind="boundary"),
        feature([[6, 1], [9, 1], [9, 4], [6, 1]], kind="zone", heading_var_per_m=1e-3, name="wet floor"),
    )
    assert world.bounds == (0, 0, 10, 10)
    assert world.obstacles.area == 1 + 25
    assert world.is_free([[3, 3], [1.5, 1.5], [8, 8]]).tolist() == [True, False, False]
    assert not world.line_of_sight([9, 4], [4, 9])  # the building's corner is in between
    assert world.zones[0].noise == OdometryNoise(heading_var_per_m=1e-3)


def test_many_polygons_holes_heights_and_foreign_members_are_fine(tmp_path):
    hole = [[4, 4], [4, 6], [6, 6], [6, 4], [4, 4]]
    two = [[[[1, 1, 0], [2, 1, 0], [2, 2, 0], [1, 1, 0]]], [[[3, 1], [4, 1], [4, 2], [3, 1]]]]
    world = load(
        tmp_path,
        feature(kind="boundary", geometry={"type": "Polygon", "coordinates": [SQUARE, hole]}),
        feature(kind="obstacle", geometry={"type": "MultiPolygon", "coordinates": two}, layer=3),
        name="a plan",
        bbox=[0, 0, 10, 10],
    )
    assert world.obstacles.area == 4 + 2 * 0.5


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ("text", "feature 2: expected a Feature, got 'text'"),
        ({"type": "Feature", "properties": None, "geometry": None}, 'feature 2: expected a property "kind" out of'),
        (feature(kind="wall"), "feature 2: expected a property \"kind\" out of boundary, obstacle, zone, got 'wall'"),
        (feature(kind=["zone"]), 'expected a property "kind"'),
        (feature(kind="boundary"), 'expected one feature of "kind": "boundary", the area of the map, got 2'),
        (
            feature(kind="obstacle", geometry={"type": "Point", "coordinates": [1, 2]}),
            "feature 2: expected a Polygon or Multi",
        ),
        (feature(kind="obstacle", geometry={"type": "Polygon"}), "feature 2: expected positions .*, got None"),
        (feature(kind="obstacle", geometry={"type": "Polygon", "coordinates": [[]]}), r"positions .*, got \[\[\]\]"),
        (feature(kind="obstacle", geometry={"type": "MultiPolygon", "coordinates": [[]]}), "none, or one beyond"),
        (
            feature(SQUARE[:-1], kind="obstacle"),
            "feature 2: expected positions .*, the last of a ring like its first, got",
        ),
        (
            feature([[0, 0], [1, 1], [1, 0], [0, 1], [0, 0]], kind="obstacle"),
            "feature 2: not a valid polygon: Self-inter",
        ),
        (
            feature([[0, 0], [1, "1"], [1, 0], [0, 0]], kind="obstacle"),
            r"expected positions \[x, y\] in metres.*, got .*\[1, '1'\]",
        ),
        (feature([[0, 0], [1, True], [1, 0], [0, 0]], kind="obstacle"), r"expected positions \[x, y\]"),
        (feature([[0, 0], [1, 1e300], [1, 0], [0, 0]], kind="obstacle"), r"expected positions \[x, y\]"),
        (feature([[0, 0], [1, 10**400], [1, 0], [0, 0]], kind="obstacle"), r"expected positions \[x, y\]"),
        (feature(kind="zone"), "feature 2: expected the zone's noise, such as heading_var_per_m, got none"),
        (feature(kind="zone", heading_var=1), "feature 2: unknown noise 'heading_var'; known are heading_var_per_m"),
        (feature(kind="zone", heading_var_per_m=-1), "feature 2: expected heading_var_per_m >= 0, got -1.0"),
        (feature(kind="zone", heading_var_per_m="much"), "feature 2: .*heading_var_per_m to be a number, got 'much'"),
        (feature(kind="zone", heading_law=[1], step_m=1), "feature 2: expected heading_law one of"),
        (feature(kind="obstacle", heading_var_per_m=1), "feature 2: only zones have noise, but this obstacle has"),
    ],
    ids=range(21),
)
def test_the_feature_at_fault_is_named(tmp_path, bad, message):
    with pytest.raises(MapError, match=message) as caught:
        load(tmp_path, BOUNDARY, bad)
    assert "some.geojson" in str(caught.value)


def test_walls_that_would_take_minutes_to_merge_are_refused(tmp_path):
    combs = []
    for turn in (1, -1):  # 200 teeth of 200 m each way: 4 x 40 000 crossings
        comb = [[x, y][::turn] for i in range(200) for x, y in ((i, 0), (i, 200), (i + 0.5, 200), (i + 0.5, 0))]
        combs.append(feature([*comb, [199.5, -1][::turn], [0, -1][::turn], comb[0]], kind="obstacle"))
    with pytest.raises(MapError, match=r"some.geojson: the walls cross each other more than 20000 times"):
        load(tmp_path, BOUNDARY, *combs)
    angle = np.linspace(0, 2 * np.pi, 50_001)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    circle[-1] = circle[0]
    with pytest.raises(MapError, match="at most 50000 positions of walls, got 50006"):
        load(tmp_path, BOUNDARY, feature(circle.tolist(), kind="obstacle"))


def test_a_map_needs_a_boundary(tmp_path):
    with pytest.raises(MapError, match='expected one feature of "kind": "boundary", the area of the map, got 0'):
        load(tmp_path, feature(kind="obstacle"))


def test_degrees_are_not_metres(tmp_path):
    degrees = {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}
    with pytest.raises(MapError, match="coordinates are in degrees"):
        load(tmp_path, BOUNDARY, crs=degrees)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "some.geojson, line 1: not JSON"),
        ('{"type": "FeatureCollection",\n "features": [}', "some.geojson, line 2: not JSON"),
        ("[1, 2]", "expected a GeoJSON FeatureCollection with a list of features"),
        ('{"type": "FeatureCollection", "features": {}}', "expected a GeoJSON FeatureCollection"),
        ('{"type": "FeatureCollection", "features": [NaN]}', "not JSON: NaN is not a number"),
        ('{"type": "FeatureCollection", "features": [' + "9" * 5000 + "]}", "not JSON: Exceeds the limit"),
        ('{"type": 1, "type": "FeatureCollection", "features": []}', "a key occurs twice"),
        ("[" * 100_000, "not JSON"),
        (np.random.default_rng(0).bytes(4000), "not JSON"),
    ],
    ids=range(9),
)
def test_what_is_no_geojson_is_refused(tmp_path, text, message):
    path = tmp_path / "some.geojson"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(MapError, match=message):
        load_world(path, robot_radius=0.5)


@pytest.mark.parametrize("written", ["map", "beacons", "drift"])
def test_geopandas_and_qgis_place_local_metres_nowhere_on_earth(tmp_path, written):
    """Both read through GDAL: the frame is an engineering one, in metres, from which nothing leads to longitudes."""
    geopandas = pytest.importorskip("geopandas")
    pyproj = pytest.importorskip("pyproj")
    world = World.from_polygons([shapely.box(2, 1, 3, 4)], bounds=(0, 0, 10, 6), robot_radius=0.3)
    tag = Beacon(BeaconKind.rfid(1.5, 0.1), 9.6, 2.0, id="A7")
    drift = predict_drift([(0, 0), (5, 0)], OdometryNoise(heading_var_per_m=1e-4))
    made = {
        "map": lambda: geojson_map_files(world, tmp_path)[tmp_path],
        "beacons": lambda: beacons_geojson([tag]),
        "drift": lambda: drift_geojson(drift, {"name": "way"}),
    }
    (tmp_path / "a.geojson").write_bytes(made[written]())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        frame = geopandas.read_file(tmp_path / "a.geojson")
    assert frame.crs.name == "map frame"
    assert frame.crs.is_engineering
    assert {axis.unit_name for axis in frame.crs.axis_info} == {"metre"}
    with pytest.raises(pyproj.exceptions.ProjError):
        frame.to_crs(4326)
    held = json.loads((tmp_path / "a.geojson").read_text())["features"]
    shapes = [shapely.from_geojson(json.dumps(feature["geometry"])) for feature in held]
    assert frame.total_bounds.tolist() == shapely.total_bounds(shapes).tolist()
