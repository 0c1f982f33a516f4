"""Maps in degrees: IMDF venues and GeoJSON, in metres about an origin that must be given."""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from driftplan import MapError, World, load_world, load_zones, save_world
from driftplan.world.geojson_map import projected

ORIGIN = (11.5, 48.1)
M_PER_DEG = np.array([74481.0, 111192.3])  # here, N cos(latitude) and M of the ellipsoid of WGS 84


def degrees(shape):
    """Metres about the origin as longitudes and latitudes, to first order: micrometres on ten metres."""
    return json.loads(shapely.to_geojson(shapely.transform(shape, lambda xy: xy / M_PER_DEG + ORIGIN)))


def feature(kind, number, shape, **properties):
    held = {"category": properties.pop("category", None), "level_id": "L0", **properties}
    return {"type": "Feature", "id": number, "feature_type": kind, "properties": held, "geometry": degrees(shape)}


def venue(tmp_path, extra=(), left_out=(), name="venue.zip"):
    """Two rooms of 8 x 6 m with a door between them, the right one with a table; stairs beyond."""
    features = [
        feature("level", "L0", shapely.box(0, 0, 20, 6), ordinal=0, name={"en": "Ground"}, short_name=None),
        feature("unit", "a", shapely.box(0, 0, 8, 6), category="room"),
        feature("unit", "b", shapely.box(8.2, 0, 16, 6), category="room"),
        feature("unit", "c", shapely.box(16, 0, 20, 6), category="stairs"),
        feature("opening", "d", shapely.LineString([(8.1, 2), (8.1, 3)]), category="pedestrian"),
        feature("fixture", "e", shapely.box(12, 2, 14, 4), category="furniture"),
        *extra,
    ]
    with zipfile.ZipFile(tmp_path / name, "w") as archive:
        for kind in ("level", "unit", "opening", "fixture"):
            held = {"type": "FeatureCollection", "features": [f for f in features if f["feature_type"] == kind]}
            if kind not in left_out:
                archive.writestr(f"venue/{kind}.geojson", json.dumps(held))
    return tmp_path / name


def test_a_venue_has_walls_doors_stairs_and_furniture(tmp_path):
    world = load_world(venue(tmp_path), robot_radius=0.2, origin=ORIGIN)
    assert world.bounds == pytest.approx((0, 0, 20, 6), abs=2e-3)
    assert world.is_free([[4, 3], [8.1, 2.5], [8.1, 5], [13, 3], [15, 3], [18, 3]]).tolist() == [
        True, True, False, False, True, False,
    ]  # fmt: skip
    assert world.segments_free([[4, 2.5]], [[11, 2.5]]).all()


def test_walkways_that_touch_are_one_and_rooms_are_not(tmp_path):
    upper = [
        feature("level", "L1", shapely.box(0, 0, 16, 4), ordinal=1, name={"en": "Upper"}),
        *(
            feature("unit", f"u{k}", shapely.box(4 * k, 0, 4 * k + 4, 4), level_id="L1", category=category)
            for k, category in enumerate(("walkway", "lobby", "office", "office"))
        ),
    ]
    file = venue(tmp_path, upper)
    for level in ("L1", "Upper", "1"):
        world = load_world(file, robot_radius=0.2, origin=ORIGIN, level=level)
        assert world.segments_free([[2, 2], [6, 2], [10, 2]], [[6, 2], [10, 2], [14, 2]]).tolist() == [
            True,
            False,
            False,
        ]
    with pytest.raises(MapError, match=r"expected level to be one of 0, 1, Ground, L0, L1, Upper, got null"):
        load_world(file, robot_radius=0.2, origin=ORIGIN)


def test_degrees_need_an_origin(tmp_path):
    file = venue(tmp_path)
    with pytest.raises(MapError, match=r"IMDF is in degrees: give the place of x = y = 0, origin=\(lon, lat\)"):
        load_world(file, robot_radius=0.2)
    for origin in ((200.0, 0.0), (0.0, 90.0), (0.0,), (np.nan, 0.0)):
        with pytest.raises(ValueError, match="origin"):
            load_world(file, robot_radius=0.2, origin=origin)


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"", "not a readable archive"), (b"PK\x03\x04" + bytes(60), "not a readable archive")],
)
def test_what_is_no_archive_is_refused(tmp_path, content, said):
    (tmp_path / "a.imdf").write_bytes(content)
    with pytest.raises(MapError, match=said):
        load_world(tmp_path / "a.imdf", robot_radius=0.2, origin=ORIGIN)


@pytest.mark.parametrize("text", ["null", "[]", "0"])
def test_a_part_that_is_no_geojson_is_refused_as_that(tmp_path, text):
    with zipfile.ZipFile(venue(tmp_path, left_out=("opening",)), "a") as archive:
        archive.writestr("venue/opening.geojson", text)
    with pytest.raises(MapError, match="expected a GeoJSON FeatureCollection with a list of features"):
        load_world(tmp_path / "venue.zip", robot_radius=0.2, origin=ORIGIN)


def test_what_a_venue_lacks_is_named(tmp_path):
    with pytest.raises(MapError, match=r"a file unit\.geojson, got none"):
        load_world(venue(tmp_path, left_out=("unit",)), robot_radius=0.2, origin=ORIGIN)
    assert load_world(venue(tmp_path, left_out=("fixture",)), robot_radius=0.2, origin=ORIGIN).is_free([13, 3])
    bad = [{"type": "Feature", "feature_type": "unit", "id": 3, "properties": {}, "geometry": {}}]
    with pytest.raises(MapError, match="expected every unit to have an id, properties and a geometry"):
        load_world(venue(tmp_path, bad), robot_radius=0.2, origin=ORIGIN)
    with pytest.raises(MapError, match="opening d2: expected a LineString"):
        load_world(venue(tmp_path, [feature("opening", "d2", shapely.Point(1, 1))]), robot_radius=0.2, origin=ORIGIN)


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for kind in ("level", "unit"):
            archive.writestr(f"{kind}.geojson", b" " * 30_000_000)
    with pytest.raises(MapError, match="expected at most 20000000 bytes unpacked, got more"):
        load_world(tmp_path / "a.zip", robot_radius=0.2, origin=ORIGIN)


def test_geojson_in_degrees_is_read_about_an_origin_and_refused_without(tmp_path):
    world = World.from_polygons([shapely.box(4, 0, 5, 6)], bounds=(0, 0, 10, 8), robot_radius=0.3)
    save_world(world, tmp_path / "metres.geojson")
    held = json.loads((tmp_path / "metres.geojson").read_text())
    del held["crs"]
    for part in held["features"]:
        part["geometry"] = degrees(shapely.from_geojson(json.dumps(part["geometry"])))
    zone = {"kind": "zone", "heading_var_per_m": 1e-3}
    zone = {"type": "Feature", "properties": zone, "geometry": degrees(shapely.box(6, 0, 7, 7))}
    held["features"] += [zone]
    (tmp_path / "degrees.geojson").write_text(json.dumps(held))
    again = load_world(tmp_path / "degrees.geojson", robot_radius=0.3, origin=ORIGIN)
    assert again.bounds == pytest.approx(world.bounds, abs=2e-3)
    assert again.obstacles.symmetric_difference(world.obstacles).area < 0.02
    assert load_zones(tmp_path / "degrees.geojson", origin=ORIGIN)[0].polygon.area == pytest.approx(7, rel=1e-3)
    with pytest.raises(MapError, match=r"look like longitudes and latitudes; .* origin=\(lon, lat\) \(--origin\)"):
        load_world(tmp_path / "degrees.geojson", robot_radius=0.3)
    held["features"][0]["geometry"]["coordinates"][0][1] = [500000.0, 10.0]
    (tmp_path / "mixed.geojson").write_text(json.dumps(held))
    with pytest.raises(MapError, match="expected longitudes and latitudes, since an origin is given, got"):
        load_world(tmp_path / "mixed.geojson", robot_radius=0.3, origin=ORIGIN)


@given(st.floats(-179, 179), st.floats(-80, 80), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01))
def test_distances_are_those_on_the_ellipsoid(longitude, latitude, east, north):
    """Against the radii of curvature in the middle of the way, right to a tenth of a millimetre on a kilometre."""
    point = shapely.points([[longitude + east, latitude + north]])
    x, y = shapely.get_coordinates(projected(point, (longitude, latitude)))[0]
    middle, flat = np.radians(latitude + north / 2), 0.00669437999014
    bend = 1 - flat * np.sin(middle) ** 2
    along = 6378137.0 / np.sqrt(bend) * np.cos(middle) * np.radians(east)
    up = 6378137.0 * (1 - flat) / bend**1.5 * np.radians(north)
    assert np.hypot(x, y) == pytest.approx(np.hypot(along, up), rel=1e-6, abs=1e-6)


def test_an_encrypted_archive_is_refused(tmp_path):
    content = bytearray(venue(tmp_path).read_bytes())
    for mark in (b"PK\x03\x04", b"PK\x01\x02"):  # the flag of encryption, in every header
        at = content.find(mark)
        while at >= 0:
            content[at + (6 if mark[3] == 4 else 8)] |= 1
            at = content.find(mark, at + 1)
    (tmp_path / "b.zip").write_bytes(content)
    assert zipfile.ZipFile(io.BytesIO(content)).infolist()[0].flag_bits & 1
    with pytest.raises(MapError, match="not a readable archive"):
        load_world(tmp_path / "b.zip", robot_radius=0.2, origin=ORIGIN)


def test_an_archive_whose_index_lies_is_refused(tmp_path):
    content = bytearray(venue(tmp_path).read_bytes())
    end = content.rfind(b"PK\x05\x06")
    content[end + 12 : end + 16] = (10**9).to_bytes(4, "little")  # a directory larger than the file
    (tmp_path / "b.zip").write_bytes(content)
    with pytest.raises(MapError, match=r"b\.zip: not a readable archive"):
        load_world(tmp_path / "b.zip", robot_radius=0.2, origin=ORIGIN)


def test_coordinates_in_lists_of_lists_of_lists_are_refused(tmp_path):
    (tmp_path / "a.geojson").write_text(
        '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {"kind": "boundary"}, '
        '"geometry": {"type": "Polygon", "coordinates": ' + "[" * 700 + "]" * 700 + "}}]}"
    )
    with pytest.raises(MapError, match=r"a\.geojson"):
        load_world(tmp_path / "a.geojson", robot_radius=0.2, origin=ORIGIN)
