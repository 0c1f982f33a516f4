"""What is read on a pass, and the chance that a pass happens: against shapely and against counting."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from shapely.ops import substring

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.passes import Passes
from driftplan.beacons.readings import (
    BeaconColumns,
    chances_listed,
    chances_of_passes,
    floor_of,
    gaussian_points,
    readings_on,
    waypoints_of,
)
from driftplan.model.noise import OdometryNoise
from driftplan.world.world import World
from driftplan.world.zones import Zone

TAG = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
ROUND_TRIP = np.array([(0, 0), (10, 0), (10, 0), (10, -3), (0, -3)], dtype=float)
BEACONS = [
    Beacon(BeaconKind.rfid(1.6, 0.1), 4.0, -1.45),
    Beacon(BeaconKind.rfid(1.6, 0.1), 8.0, -1.5),
    Beacon(BeaconKind.rfid(3.0, 0.1), 9.0, 1.0),
    Beacon(TAG, 0.0, 0.5),
]


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def drift_of(count: int, seed: int) -> SimpleNamespace:
    """Errors of about a metre, with a bias, at as many places."""
    root = np.random.default_rng(seed).normal(size=(count, 2, 2)) * 0.6
    bias = np.random.default_rng(seed + 1).normal(size=(count, 2)) * 0.3
    cov = root @ np.swapaxes(root, 1, 2)
    rms = np.sqrt(np.trace(cov, axis1=1, axis2=2) + (bias**2).sum(axis=1))
    return SimpleNamespace(bias=bias, cov=cov, rms=rms)


@pytest.mark.parametrize("scale", [1.0, 0.3])
@pytest.mark.parametrize("angle", [0.0, 0.6])
def test_a_pass_happens_for_the_errors_that_leave_the_beacon_within_range_of_its_stretch(scale, angle):
    """The same by shapely, error by error: the beacon moved by the error, against the path within four rms of the pass
    and not beyond half-way to the next of the same beacon."""
    path = turned(ROUND_TRIP, angle)
    columns = BeaconColumns.of([replace(b, x=x, y=y) for b in BEACONS for x, y in [turned(b.xy, angle).tolist()]])
    passes = columns.passes(path, None)
    assert passes.beacon.tolist() == [0, 0, 1, 1, 2, 3]
    drift = drift_of(len(passes.beacon), 3)
    drift.bias, drift.cov, drift.rms = scale * drift.bias, scale**2 * drift.cov, scale * drift.rms
    found = chances_of_passes(path, passes, columns, drift)
    line = shapely.LineString(path)
    for k, beacon in enumerate(passes.beacon.tolist()):
        begin = passes.enter[k] - BEACONS[beacon].kind.range_m - 4 * drift.rms[k]
        end = passes.leave[k] + BEACONS[beacon].kind.range_m + 4 * drift.rms[k]
        if k and passes.beacon[k - 1] == beacon:
            begin = max(begin, (passes.leave[k - 1] + passes.enter[k]) / 2)
        if k + 1 < len(passes.beacon) and passes.beacon[k + 1] == beacon:
            end = min(end, (passes.leave[k] + passes.enter[k + 1]) / 2)
        near = substring(line, max(begin, 0.0), min(end, line.length))
        errors = gaussian_points(drift.bias[k : k + 1], drift.cov[k : k + 1], 512)[0]
        places = shapely.points(columns.xy[beacon] + errors)
        expected = np.mean(shapely.distance(places, near) <= BEACONS[beacon].kind.range_m)
        assert found[k] == pytest.approx(expected, abs=1.5 / 512)  # one error may lie on the rim
    assert ((found > 0.05) & (found < 0.99)).any()
    straight = np.delete(path, 2, axis=0)  # without the waypoint that stands there twice
    np.testing.assert_allclose(chances_of_passes(straight, passes, columns, drift), found, atol=1e-12)


def test_points_of_equal_probability_have_the_mean_and_covariance_asked_for():
    for dimensions in (2, 3):
        root = np.random.default_rng(dimensions).normal(size=(4, dimensions, dimensions))
        mean, cov = np.arange(4 * dimensions).reshape(4, dimensions) * 1.0, root @ np.swapaxes(root, 1, 2)
        points = gaussian_points(mean, cov, 4096)
        assert points.shape == (4, 4096, dimensions)
        for k in range(4):
            np.testing.assert_allclose(points[k].mean(axis=0), mean[k], atol=0.02 * np.sqrt(np.trace(cov[k])))
            np.testing.assert_allclose(np.cov(points[k].T), cov[k], atol=0.02 * np.trace(cov[k]))
        # evenly spread: each half, third and corner of a standard normal distribution has its share
        standard = gaussian_points(np.zeros((1, dimensions)), np.eye(dimensions)[None], 4096)[0]
        assert (standard > 0).all(axis=1).mean() == pytest.approx(0.5**dimensions, abs=0.003)
        assert (np.abs(standard) < 1).all(axis=1).mean() == pytest.approx(0.6826895**dimensions, abs=0.004)
    known = gaussian_points(np.array([[1.0, 2.0]]), np.array([[[0.0, 0.0], [0.0, -1e-18]]]), 8)
    np.testing.assert_allclose(known, np.broadcast_to([1.0, 2.0], (1, 8, 2)), atol=1e-8)


def test_passes_are_listed_in_driving_order_and_none_have_no_chances():
    passes = Passes(np.array([0, 0, 1, 2]), np.array([5.0, 1.0, 1.0, 1.0]), np.array([6.0, 3.0, 3.0, 2.0]))
    listed = chances_listed(BEACONS, passes, np.array([0.1, 0.2, 0.3, 0.4]))
    assert [(BEACONS.index(c.beacon), c.enter_m, c.leave_m, c.probability) for c in listed] == [
        (2, 1.0, 2.0, 0.4),
        (0, 1.0, 3.0, 0.2),
        (1, 1.0, 3.0, 0.3),
        (0, 5.0, 6.0, 0.1),
    ]
    none = BeaconColumns.of([]).passes(ROUND_TRIP, None)
    assert chances_of_passes(ROUND_TRIP, none, BeaconColumns.of([]), drift_of(0, 1)).shape == (0,)


@pytest.mark.parametrize("spacing", [0.4, 1.0, 100.0])
def test_a_pass_is_read_at_both_ends_and_as_seldom_as_the_spacing_allows(spacing):
    kind = BeaconKind(
        name="all", range_m=2.0, position_std_m=0.2, heading_std=0.1, range_std_m=0.3, bearing_std=0.05,
        std_per_m=0.1, reading_spacing_m=spacing, detection_probability=0.8,
    )  # fmt: skip
    beacons = [Beacon(kind, 3.0, 1.0), Beacon(kind, 9.0, -1.0), Beacon(TAG, 5.0, 0.5)]
    columns = BeaconColumns.of(beacons)
    passes, readings = columns.passes(ROUND_TRIP, None), readings_on(ROUND_TRIP, columns, None)
    line, start = shapely.LineString(ROUND_TRIP), 0
    for beacon, enter, leave in zip(passes.beacon.tolist(), passes.enter.tolist(), passes.leave.tolist(), strict=True):
        own = beacons[beacon].kind
        parts = max(int(np.ceil((leave - enter) / own.reading_spacing_m - 1e-6)), 1) if leave > enter else 0  # a graze
        some = readings[start : start + parts + 1]
        start += parts + 1
        np.testing.assert_allclose(some.s_m, np.linspace(enter, leave, parts + 1), atol=1e-12)
        assert (some.source == beacon).all()
        np.testing.assert_allclose(1 - some.chance, (1 - own.detection_probability) ** (1 / (parts + 1)), atol=1e-12)
        places = shapely.get_coordinates(shapely.line_interpolate_point(line, some.s_m))
        away = np.hypot(*(places - columns.xy[beacon]).T)
        looser = (own.std_per_m or 0.0) * away
        np.testing.assert_allclose(some.square, 2 * (own.position_std_m + looser) ** 2, rtol=1e-9)
        if own is kind:
            np.testing.assert_allclose(some.range_var, (0.3 + looser) ** 2, rtol=1e-9)
            np.testing.assert_allclose(some.heading_var, 0.1**2)
            np.testing.assert_allclose(some.bearing_var, 0.05**2)
            assert (some.anchor == complex(*columns.xy[beacon])).all()
        else:
            assert all(np.isnan(x).all() for x in (some.range_var, some.heading_var, some.bearing_var, some.anchor))
    assert start == len(readings)


def test_a_beacon_that_tells_only_a_range_or_only_a_bearing_has_its_place_as_anchor():
    kinds = [BeaconKind.range_only(range_m=2.0, range_std_m=0.1), BeaconKind.bearing(range_m=2.0, bearing_std=0.1)]
    readings = readings_on(ROUND_TRIP, BeaconColumns.of([Beacon(kind, 5.0, 1.0) for kind in kinds]), None)
    assert set(readings.anchor.tolist()) == {5 + 1j}


def test_the_more_accurate_a_beacon_is_in_position_then_heading_the_later_it_is_read():
    kinds = [
        BeaconKind.rfid(1.0, 0.2),
        BeaconKind.landmark(1.0, 0.2, 0.1),
        BeaconKind.landmark(1.0, 0.1, 0.3),
        BeaconKind.heading(1.0, 0.01),
        BeaconKind.landmark(1.0, 0.2, 0.05),
        BeaconKind.rfid(1.0, 0.2),
    ]
    columns = BeaconColumns.of([Beacon(kind, 0.0, 0.0) for kind in kinds])
    assert columns.rank.tolist() == [1, 2, 4, 0, 3, 1]
    assert BeaconColumns.of([]).rank.shape == (0,)


def test_a_path_is_cut_at_zones_and_each_leg_has_its_floor():
    dry, wet = OdometryNoise(heading_var_per_m=1e-4), OdometryNoise(heading_var_per_m=4e-3)
    zone = Zone([(3, -1), (5, -1), (5, 1), (3, 1)], wet)
    world = World.from_polygons([], bounds=(-1, -4, 21, 1), robot_radius=0.1, zones=[zone])
    path, noises = floor_of(ROUND_TRIP[:2], dry, world)
    assert path.tolist() == [[0, 0], [3, 0], [5, 0], [10, 0]]
    assert noises == [dry, wet, dry]
    plain = World.from_polygons([], bounds=(-1, -4, 21, 1), robot_radius=0.1)
    for none in (None, plain):
        assert floor_of(ROUND_TRIP, dry, none) == (pytest.approx(ROUND_TRIP), dry)


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ([(0, 0), (1 + 2j, 0)], "complex numbers are none"),
        ([(0, 0, 0), (1, 0, 0)], r"shape \(2, 3\)"),
        ([0.0, 1.0], r"shape \(2,\)"),
        ([(0, 0)], r"shape \(1, 2\)"),
        ([(0, 0), (1, np.inf), (2, np.nan)], r"finite coordinates, got \[1.0, inf\]"),
        ([(0, 0), (1,)], "expected a path of numbers"),
    ],
)
def test_paths_that_are_none_are_refused(path, said):
    with pytest.raises(ValueError, match=said):
        waypoints_of(path)
    with pytest.raises(ValueError, match=said):
        waypoints_of(SimpleNamespace(path=path))
