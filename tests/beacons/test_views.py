"""Beacons that face somewhere, robots that look ahead, accuracy that falls with distance, ranges and bearings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan import Beacon, BeaconKind, OdometryNoise, beacon_passes, drift_with_beacons
from driftplan.beacons.readings import BeaconColumns, beacon_fixes, readings_on, waypoints_of

NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)


def tag(view_angle_deg=360.0, sensor_view_deg=360.0, range_m=4.0):
    return BeaconKind(
        name="tag",
        range_m=range_m,
        position_std_m=0.1,
        view_angle_deg=view_angle_deg,
        sensor_view_deg=sensor_view_deg,
    )


def test_a_tag_on_a_shelf_is_seen_from_its_front_only():
    front = Beacon(tag(180.0), x=5.0, y=0.0, facing_deg=90.0)
    assert beacon_passes([(0, 1), (10, 1)], front).tolist() == pytest.approx(
        np.array([[5 - np.sqrt(15), 5 + np.sqrt(15)]]), abs=1e-6
    )
    assert beacon_passes([(0, -1), (10, -1)], front).size == 0
    narrow = Beacon(tag(90.0), x=5.0, y=0.0, facing_deg=90.0)
    np.testing.assert_allclose(beacon_passes([(0, 1), (10, 1)], narrow), [[4.0, 6.0]], atol=1e-6)


def test_a_wide_view_may_be_left_and_entered_again():
    behind = Beacon(tag(270.0), x=5.0, y=0.0, facing_deg=90.0)
    reach = np.sqrt(15)
    np.testing.assert_allclose(
        beacon_passes([(0, -1), (10, -1)], behind), [[5 - reach, 4.0], [6.0, 5 + reach]], atol=1e-6
    )


def test_a_camera_that_looks_ahead_reads_what_is_ahead():
    ahead = Beacon(tag(sensor_view_deg=180.0), x=5.0, y=0.0)
    reach = np.sqrt(15)
    np.testing.assert_allclose(beacon_passes([(0, 1), (10, 1)], ahead), [[5 - reach, 5.0]], atol=1e-6)
    np.testing.assert_allclose(beacon_passes([(10, 1), (0, 1)], ahead), [[5 - reach, 5.0]], atol=1e-6)


def test_two_sides_of_a_wide_view_that_meet_in_a_point_are_one_pass():
    # through the beacon itself, from behind and out in front: at the beacon it is seen from everywhere
    wide = Beacon(tag(200.0), x=5.0, y=0.0, facing_deg=0.0)
    np.testing.assert_allclose(beacon_passes([(0, 0), (10, 0)], wide), [[5.0, 9.0]], atol=1e-6)
    np.testing.assert_allclose(beacon_passes([(10, 0), (0, 0)], wide), [[1.0, 5.0]], atol=1e-6)


def test_on_the_border_of_a_view_it_is_seen_and_at_the_beacon_itself_always():
    views = BeaconColumns.of([Beacon(tag(90.0, 90.0), x=0.0, y=0.0, facing_deg=0.0)]).views
    away = np.array([(1.0, 1.0), (1.0, 1.0 + 1e-9), (0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 0.0)])
    # towards the beacon, but the last: 45 degrees off, and just beyond
    heading = np.array([np.pi * 5 / 4, np.pi * 5 / 4, 0.0, -np.pi / 2, np.pi * 3 / 4, np.pi * 3 / 4 - 1e-9])
    assert views.at(np.zeros(6, dtype=int), away, heading).tolist() == [True, False, True, False, True, False]


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_passes_are_where_the_beacon_is_seen(seed):
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(size=(6, 2)) * 2, axis=0)
    beacon = Beacon(
        tag(rng.uniform(5, 360), rng.uniform(5, 360)), *rng.normal(size=2) * 2, facing_deg=rng.uniform(-400, 400)
    )
    columns = BeaconColumns.of([beacon])
    steps = np.diff(path, axis=0)
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*steps.T))])
    s = rng.uniform(0, driven[-1], 300)
    leg = np.searchsorted(driven, s, side="right") - 1
    places = np.stack([np.interp(s, driven, path[:, k]) for k in (0, 1)], axis=-1)
    headings = np.arctan2(steps[leg, 1], steps[leg, 0])
    away = places - beacon.xy
    seen = (np.hypot(*away.T) <= beacon.kind.range_m) & columns.views.at(np.zeros(300, dtype=int), away, headings)
    passes = beacon_passes(path, beacon)
    inside = ((passes[:, :1] - 1e-5 <= s) & (s <= passes[:, 1:] + 1e-5)).any(axis=0)
    clear = ~((np.abs(passes[:, :, None] - s) < 1e-4).any(axis=(0, 1)))
    assert (inside == seen)[clear].all()


def test_a_beacon_seen_from_somewhere_needs_to_face_somewhere():
    with pytest.raises(ValueError, match="facing_deg"):
        Beacon(tag(180.0), x=0.0, y=0.0)
    with pytest.raises(ValueError, match=r"view_angle_deg in \(0, 360\]"):
        tag(400.0)
    with pytest.raises(ValueError, match="sensor_view_deg > 0"):
        tag(sensor_view_deg=0.0)


def test_accuracy_falls_with_distance():
    kind = BeaconKind(name="far", range_m=20.0, position_std_m=0.1, std_per_m=0.02, reading_spacing_m=1.0)
    path = [(0, 3), (30, 3)]
    for fix in beacon_fixes(path, [Beacon(kind, x=10.0, y=0.0)]):
        distance = np.hypot(fix.s_m - 10.0, 3.0)
        np.testing.assert_allclose(np.sqrt(np.diag(fix.position_cov)), 0.1 + 0.02 * distance, rtol=1e-6)
    with pytest.raises(ValueError, match="std_per_m"):
        BeaconKind(name="compass", range_m=2.0, heading_std=0.1, std_per_m=0.1)


def test_ranges_and_bearings_are_for_robots_with_a_filter():
    path = [(0, 0), (30, 0), (30, 20)]
    radios = [Beacon(BeaconKind.range_only(range_m=40.0, range_std_m=0.1), x=x, y=y) for x, y in ((5, 8), (20, -6))]
    lights = [Beacon(BeaconKind.bearing(range_m=40.0, bearing_std=0.02), x=x, y=y) for x, y in ((5, 8), (20, -6))]
    alone = drift_with_beacons(path, NOISE, [], estimator="filter").end.rms
    for beacons in (radios, lights):
        assert drift_with_beacons(path, NOISE, beacons, estimator="filter").end.rms < 0.5 * alone
        with pytest.raises(ValueError, match="estimator='filter'"):
            drift_with_beacons(path, NOISE, beacons)
    assert radios[0].kind.needs_filter
    assert not tag().needs_filter


def test_fixes_say_what_readings_do():
    path = waypoints_of([(0, 0), (30, 0), (30, 20)])
    kind = BeaconKind(
        name="all", range_m=9.0, position_std_m=0.2, heading_std=0.1, range_std_m=0.1, bearing_std=0.05, std_per_m=0.01
    )
    beacons = [Beacon(kind, x=5.0, y=8.0), Beacon(BeaconKind.range_only(range_m=9.0, range_std_m=0.1), x=28.0, y=4.0)]
    listed = drift_with_beacons(path, NOISE, [], fixes=beacon_fixes(path, beacons), estimator="filter")
    np.testing.assert_allclose(listed.rms, drift_with_beacons(path, NOISE, beacons, estimator="filter").rms, rtol=1e-12)


def test_a_radio_on_the_path_itself_does_no_harm():
    kind = BeaconKind.range_only(range_m=6.0, range_std_m=0.1)
    beacons = [Beacon(kind, x=6.0, y=0.0)]
    places = readings_on(waypoints_of([(0, 0), (30, 0)]), BeaconColumns.of(beacons), None).s_m
    assert 6.0 in places
    drift = drift_with_beacons([(0, 0), (30, 0)], NOISE, beacons, estimator="filter")
    assert drift.end.rms < drift_with_beacons([(0, 0), (30, 0)], NOISE, []).end.rms
