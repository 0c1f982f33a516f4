"""Zone files: greys become floors where they lie, and whatever is wrong with a file is named."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image

from driftplan import MapError, OdometryNoise, World, Zone, load_world, load_zones, save_world

WET, ROUGH = OdometryNoise(heading_var_per_m=1e-3), OdometryNoise(distance_var_per_m=0.02)
RASTER = """image: floor.png
resolution: 0.5
origin: [-1.0, 2.0, {yaw}]
zones:
  100: {{heading_var_per_m: 1.0e-3}}
  7: {{distance_var_per_m: 0.02}}
"""
STRAIGHT = RASTER.format(yaw=0.0)


@pytest.fixture
def raster(tmp_path):
    """Writes a raster zone file; pixels with row 0 at the top."""

    def write(pixels, text=STRAIGHT, dtype=np.uint8):
        Image.fromarray(np.array(pixels, dtype=dtype)).save(tmp_path / "floor.png")
        (tmp_path / "floor.yaml").write_text(text)
        return tmp_path / "floor.yaml"

    return write


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    greys=arrays(int, array_shapes(min_dims=2, max_dims=2, max_side=8), elements=st.sampled_from([0, 7, 100, 255])),
    yaw=st.floats(-3, 3),
)
def test_every_pixel_has_the_noise_of_its_grey(raster, greys, yaw):
    greys = np.vstack([greys, np.zeros(greys.shape[1], int)])
    greys[-1, 0], greys[0, -1] = 100, 7  # both occur
    zones = load_zones(raster(greys, RASTER.format(yaw=yaw)))
    assert [zone.noise for zone in zones] == [WET, ROUGH]
    world = World.from_polygons([], bounds=(-90, -90, 90, 90), robot_radius=0.1, zones=zones)
    row, column = np.indices(greys.shape)
    east, north = (column + 0.5) * 0.5, (len(greys) - 0.5 - row) * 0.5
    x = -1 + east * np.cos(yaw) - north * np.sin(yaw)
    y = 2 + east * np.sin(yaw) + north * np.cos(yaw)
    expected = np.select([greys == 100, greys == 7], [0, 1], -1)
    assert (world.zone_at(np.stack([x, y], axis=-1)) == expected).all()


def test_sixteen_bits_of_grey_are_more_greys(raster):
    text = STRAIGHT.replace("  7:", "  4000:")
    assert [z.polygon.area for z in load_zones(raster([[100, 4000, 4000]], text, np.uint16))] == [0.25, 0.5]


def test_a_geojson_map_lends_its_zones(tmp_path):
    zone = Zone([(1, 1), (3, 1), (3, 2)], WET)
    save_world(World.from_polygons([], bounds=(0, 0, 9, 9), robot_radius=0.1, zones=[zone]), tmp_path / "floor.geojson")
    (found,) = load_zones(tmp_path / "floor.geojson")
    assert found.noise == WET
    assert found.polygon.equals(zone.polygon)


def test_zones_of_a_file_cover_those_of_the_map(tmp_path, raster):
    own = Zone([(-1, 2), (5, 2), (5, 5), (-1, 5)], OdometryNoise(heading_var_per_m=5e-4))
    save_world(World.from_polygons([], bounds=(-5, 0, 9, 9), robot_radius=0.1, zones=[own]), tmp_path / "map.geojson")
    world = load_world(tmp_path / "map.geojson", robot_radius=0.1, zones=raster([[100, 0, 7]]))
    seen = [world.noise_at(point, WET).heading_var_per_m for point in ((-0.75, 2.25), (-0.25, 2.25), (0.25, 2.25))]
    assert seen == [1e-3, 5e-4, 0.0]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("  7:", "  8:", "zone 8: no pixel of floor.png has this value"),
        ("  7:", "  wet:", "zone 'wet': expected a grey, a whole number"),
        ("  7:", "  true:", "zone True: expected a grey"),
        ("{distance_var_per_m: 0.02}", "0.02", "zone 7: expected its noise, such as"),
        ("{distance_var_per_m: 0.02}", "{}", "zone 7: expected the zone's noise"),
        ("distance_var_per_m", "distanse_var_per_m", "zone 7: unknown noise 'distanse_var_per_m'"),
        ("0.02", "-0.02", "zone 7: expected distance_var_per_m >= 0, got -0.02"),
        ("zones:", "zoness:", "unknown key 'zoness'; known are .*zones"),
        ("resolution: 0.5", "resolution: 0", "expected resolution > 0 m per cell"),
        ("floor.png", "../floor.png", "lies outside the map's folder"),
        ("floor.png", "wall.png", "is not a file"),
    ],
)
def test_what_is_wrong_with_a_raster_is_named(raster, old, new, match):
    with pytest.raises(MapError, match=match):
        load_zones(raster([[100, 0, 7]], STRAIGHT.replace(old, new)))


def test_a_list_of_zones_is_refused(raster):
    with pytest.raises(MapError, match="expected zones to give 1 to 64 greys a noise, got"):
        load_zones(raster([[100]], STRAIGHT.split("zones:")[0] + "zones: [1, 2]\n"))


def test_a_picture_of_colours_is_refused(raster, tmp_path):
    file = raster([[100]])
    Image.new("RGB", (3, 3)).save(tmp_path / "floor.png")
    with pytest.raises(MapError, match="expected a picture of greys, got one of mode RGB"):
        load_zones(file)


def test_files_that_are_missing_without_zones_or_of_another_kind_are_refused(tmp_path):
    with pytest.raises(MapError, match="cannot be read: No such file"):
        load_zones(tmp_path / "floor.yaml")
    with pytest.raises(MapError, match=r"expected zones called .geojson or .json .*, .yaml or .yml .*, got .csv"):
        load_zones(tmp_path / "floor.csv")
    save_world(World.from_polygons([], bounds=(0, 0, 9, 9), robot_radius=0.1), tmp_path / "plain.geojson")
    with pytest.raises(MapError, match="expected at least one zone, got none"):
        load_zones(tmp_path / "plain.geojson")


def test_a_speed_mask_of_nav2_becomes_zones_when_its_greys_are_given_a_noise(tmp_path):
    Image.fromarray(np.array([[254, 100], [254, 100]], dtype=np.uint8)).save(tmp_path / "speed.pgm")
    mask = "image: speed.pgm\nmode: scale\nresolution: 0.5\norigin: [0, 0, 0]\n"
    mask += "negate: 0\noccupied_thresh: 1.0\nfree_thresh: 0\n"
    (tmp_path / "speed.yaml").write_text(mask)
    with pytest.raises(MapError, match=r"got None: add, say, zones: .*; the greys of speed\.pgm are \[100, 254\]"):
        load_zones(tmp_path / "speed.yaml")
    (tmp_path / "speed.yaml").write_text(mask + "zones:\n  100: {heading_var_per_m: 1e-3}\n")
    (zone,) = load_zones(tmp_path / "speed.yaml")
    assert zone.polygon.bounds == (0.5, 0, 1, 1)
