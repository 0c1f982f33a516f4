"""The scene that the page is given: everything it computes with, and nothing that JSON cannot carry."""

from __future__ import annotations

import json

import numpy as np
import pytest

from driftplan import Beacon, BeaconKind, OdometryNoise, World, Zone
from driftplan.page.scene import beacon_of, scene_of, zones_of

NOISE = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-3)
ROUTE = [np.array([[1.0, 1.0], [8.0, 1.0]])]


def test_beacons_and_noise_come_back_as_they_went():
    tag = Beacon(BeaconKind.landmark(range_m=3, position_std_m=0.1, heading_std=0.02, view_angle_deg=90), 2, 3, "a", 45)
    radio = Beacon(BeaconKind.range_only(range_m=9, range_std_m=0.2), 4, 5, "b")
    scene = json.loads(json.dumps(scene_of(None, ROUTE, NOISE, beacons=[tag], existing=[radio]), allow_nan=False))
    assert [beacon_of(one) for one in scene["beacons"]] == [radio, tag]
    assert [one["existing"] for one in scene["beacons"]] == [True, False]
    assert OdometryNoise(**scene["noise"]) == NOISE


def test_walls_are_what_blocks_sight_and_zones_keep_their_order():
    zones = [Zone([(0, 0), (4, 0), (4, 3)], NOISE.scaled(k)) for k in (2.0, 3.0)]
    world = World.from_polygons([[(4, 4), (6, 4), (6, 6)]], bounds=(0, 0, 9, 9), robot_radius=0.3, zones=zones)
    scene = scene_of(world, ROUTE, NOISE)
    assert scene["bounds"] == [0, 0, 9, 9]
    (ring,) = scene["walls"][0]
    assert np.allclose(sorted(ring[:-1]), [(4, 4), (6, 4), (6, 6)], atol=1e-5)
    assert [zone["noise"]["heading_var_per_m"] for zone in scene["zones"]] == pytest.approx([4e-4, 9e-4])
    assert [(zone.polygon.area, zone.noise) for zone in zones_of(scene)] == [(6.0, zone.noise) for zone in zones]


def test_noise_per_step_is_refused():
    with pytest.raises(ValueError, match="noise of the continuous kind"):
        scene_of(None, ROUTE, OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.0))
