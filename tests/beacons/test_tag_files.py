"""Beacons as ROS's detectors know them: what is written is read back."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan import Beacon, BeaconKind, MapError, fiducial_map, load_beacons, static_transforms, tags_yaml

ROUND = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
SEEN = BeaconKind.landmark(3.0, 0.05, 0.01, view_angle_deg=120.0)
coordinates = st.floats(-1e4, 1e4)


@given(
    places=st.lists(st.tuples(coordinates, coordinates, st.floats(-179, 179)), min_size=1, max_size=9),
    faces=st.booleans(),
    numbered=st.booleans(),
)
@settings(max_examples=30, deadline=None)
def test_tags_and_fiducials_are_read_back_where_they_are(places, faces, numbered, tmp_path_factory):
    kind = SEEN if faces else ROUND
    beacons = [
        Beacon(kind, x, y, id=f"T{3 * k + 1}" if numbered else "", facing_deg=facing if faces else None)
        for k, (x, y, facing) in enumerate(places)
    ]
    folder = tmp_path_factory.mktemp("tags")
    (folder / "tags.yaml").write_bytes(tags_yaml(beacons, size_m=0.2))
    (folder / "map.txt").write_bytes(fiducial_map(beacons))
    for name in ("tags.yaml", "map.txt"):
        again = load_beacons(folder / name, kind)
        assert [beacon.id for beacon in again] == [str(3 * k + 1 if numbered else k) for k in range(len(places))]
        np.testing.assert_allclose([b.xy for b in again], [b.xy for b in beacons], atol=1e-6)
        if faces:
            ahead, was = (np.radians([b.facing_deg for b in some]) for some in (again, beacons))
            np.testing.assert_allclose(np.exp(1j * ahead), np.exp(1j * was), atol=1e-5)


def test_yaml_has_the_keys_of_apriltag_ros_and_transforms_name_every_tag():
    beacons = [Beacon(SEEN, 1.0, 2.0, id="A5", facing_deg=90.0), Beacon(SEEN, 3.0, 4.0, id="A7", facing_deg=-90.0)]
    (bundle,) = yaml.safe_load(tags_yaml(beacons, size_m=0.2))["tag_bundles"]
    assert bundle["name"] == "map"
    assert bundle["layout"][0].keys() == {"id", "size", "x", "y", "z", "qw", "qx", "qy", "qz"}
    assert static_transforms(beacons).decode().splitlines()[2] == (
        "ros2 run tf2_ros static_transform_publisher --x 1.0 --y 2.0 --yaw 1.570796 "
        "--frame-id map --child-frame-id tag_5 &"
    )


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("tags.yaml", "standalone_tags: [{id: 1, size: 0.1}]", "expected tag_bundles"),
        ("tags.yaml", "tag_bundles: [{layout: [{id: a}]}]", "expected a tag with an id"),
        ("tags.yaml", "tag_bundles: [{layout: [{id: 1, x: far}]}]", "tag 1: expected x to be a number"),
        ("tags.yaml", "tag_bundles: []", "expected tags with places, got none"),
        ("map.txt", "1 2 3\n", "line 1: expected id, x, y"),
        ("map.txt", "1 2 nan 0 0 0 0 0 1\n", "line 1: expected y finite"),
        ("map.txt", "1 2 x 0 0 0 0 0 1\n", "line 1: could not convert"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(MapError, match=said):
        load_beacons(tmp_path / name, ROUND)
    with pytest.raises(MapError, match="load them with a kind"):
        load_beacons(tmp_path / name)
