"""Beacons: where a path meets them, in sight and out of it, what their fixes do to drift, and who is captured."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.special import ndtr

import driftplan
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.readings import beacon_fixes, beacon_passes, detection_chances, drift_with_beacons
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.model.simulation import simulate_drift
from driftplan.planning.request import Reliance
from driftplan.planning.roadmap.itinerary_check import ItineraryCheck
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise(heading_var_per_m=4e-4, distance_var_per_m=1e-3)
TAG = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
SIGN = BeaconKind.landmark(range_m=4.0, position_std_m=0.05, heading_std=0.02)

coordinate = st.floats(-8, 8).map(lambda x: round(x, 3))


def along(path, s):
    """Points of a polyline at distances s, by shapely."""
    return shapely.get_coordinates(shapely.line_interpolate_point(shapely.LineString(path), s))


def covered(found, s):
    return ((found[:, :1] <= s) & (s <= found[:, 1:])).any(axis=0)


# Passes: laws

waypoints = st.integers(2, 6).flatmap(lambda n: arrays(float, (n, 2), elements=coordinate))


@given(waypoints, arrays(float, 2, elements=coordinate), st.floats(0.1, 5))
def test_a_point_of_the_path_is_in_a_pass_exactly_when_it_is_in_range(path, centre, reach):
    length = shapely.LineString(path).length
    found = beacon_passes(path, Beacon(BeaconKind.rfid(reach, 0.1), *centre))
    s = np.linspace(0, length, 402)[1:-1]
    distance = np.hypot(*(along(path, s) - centre).T)
    clear = np.abs(distance - reach) > 1e-5  # nearer the rim rounding to micrometres decides
    np.testing.assert_array_equal(covered(found, s)[clear], (distance <= reach)[clear])


@given(waypoints, arrays(float, 2, elements=coordinate), st.floats(0.1, 5))
def test_passes_are_ordered_and_apart_and_on_the_path(path, centre, reach):
    found = beacon_passes(path, Beacon(BeaconKind.rfid(reach, 0.1), *centre))
    flat = found.ravel()
    assert (np.diff(flat) >= 0).all()
    assert (found[1:, 0] > found[:-1, 1]).all()
    assert len(flat) == 0 or (flat[0] >= 0 and flat[-1] <= shapely.LineString(path).length + 1e-9)


@given(waypoints, arrays(float, 2, elements=coordinate), st.floats(0.1, 5))
def test_driving_back_mirrors_the_passes(path, centre, reach):
    beacon = Beacon(BeaconKind.rfid(reach, 0.1), *centre)
    length = shapely.LineString(path).length
    there, back = beacon_passes(path, beacon), beacon_passes(path[::-1], beacon)
    np.testing.assert_allclose(length - back[::-1, ::-1], there, atol=2e-6)  # both rounded to micrometres


# Passes: examples


def test_a_path_that_comes_back_passes_twice():
    assert beacon_passes([(0, 0), (10, 0), (10, 1), (0, 1)], Beacon(BeaconKind.rfid(1.0, 0.1), 5.0, 0.5)).tolist() == [
        [pytest.approx(5 - 0.75**0.5, abs=1e-6), pytest.approx(5 + 0.75**0.5, abs=1e-6)],
        [pytest.approx(16 - 0.75**0.5, abs=1e-6), pytest.approx(16 + 0.75**0.5, abs=1e-6)],
    ]


def test_a_graze_is_one_pass_of_no_length_and_one_reading():
    tag = BeaconKind.rfid(1.5, 0.1, detection_probability=0.9)
    assert beacon_passes([(0, 0), (10, 0)], Beacon(tag, 4.0, 1.5)).tolist() == [[4.0, 4.0]]
    (fix,) = beacon_fixes([(0, 0), (10, 0)], [Beacon(tag, 4.0, 1.5)])
    assert (fix.s_m, fix.detection_probability) == (4.0, 0.9)


def test_touching_the_range_with_a_waypoint_is_one_pass():
    assert beacon_passes([(0, 0), (3, 0), (0, 1)], Beacon(BeaconKind.rfid(1.0, 0.1), 4.0, 0.0)).tolist() == [[3.0, 3.0]]


def test_just_outside_the_range_there_is_no_pass():
    assert beacon_passes([(0, 0), (10, 0)], Beacon(TAG, 4.0, 1.5001)).shape == (0, 2)


def test_a_path_inside_the_range_is_one_pass_from_start_to_end():
    found = beacon_passes([(0, 0), (1, 0), (1, 1)], Beacon(BeaconKind.rfid(5.0, 0.1), 0.5, 0.5))
    assert found.tolist() == [[0.0, 2.0]]


def test_a_waypoint_repeated_changes_no_pass():
    beacon = Beacon(TAG, 3.0, 0.5)
    np.testing.assert_array_equal(
        beacon_passes([(0, 0), (3, 0), (3, 0), (9, 0)], beacon), beacon_passes([(0, 0), (3, 0), (9, 0)], beacon)
    )


# Sight


@settings(deadline=None)
@given(st.lists(arrays(float, (3, 2), elements=coordinate), min_size=1, max_size=4), waypoints, coordinate, coordinate)
def test_passes_in_sight_agree_with_the_world_point_by_point(walls, path, x, y):
    walls = [w for w in walls if shapely.Polygon(w).is_valid and shapely.Polygon(w).area > 0.01]
    world = World.from_polygons(walls, bounds=(-9, -9, 9, 9), robot_radius=0.0)
    found = beacon_passes(path, Beacon(SIGN, x, y), world)
    s = np.linspace(0, shapely.LineString(path).length, 302)[1:-1]
    points = along(path, s)
    seen = world.line_of_sight(points, (x, y)) & (np.hypot(*(points - (x, y)).T) <= SIGN.range_m)
    wrong = np.flatnonzero(covered(found, s) != seen)
    # They may differ only where the answer changes: within rounding of a border of a pass or of a shadow.
    for k in wrong.tolist():
        around = along(path, s[k] + np.array([-1e-4, 1e-4]))
        both = world.line_of_sight(around, (x, y)) & (np.hypot(*(around - (x, y)).T) <= SIGN.range_m)
        assert both[0] != both[1] or abs(both.mean() - covered(found, s[k : k + 1])[0]) < 1e-9


def test_a_pole_splits_a_pass_and_a_wall_ends_it():
    pole = World.from_polygons(
        [[(4.9, 0.9), (5.1, 0.9), (5.1, 1.1), (4.9, 1.1)]], bounds=(0, -1, 12, 5), robot_radius=0.1
    )
    behind_the_pole = Beacon(SIGN, 5.0, 2.0)
    found = beacon_passes([(0, 0), (12, 0)], behind_the_pole, pole)
    # Rays through the pole's near corners, 0.9 below and 0.1 beside the beacon, have spread to 0.2/0.9 at the path.
    half = 4 * np.sqrt(0.75)
    np.testing.assert_allclose(found, [[5 - half, 5 - 0.2 / 0.9], [5 + 0.2 / 0.9, 5 + half]], atol=5e-6)


def test_walls_do_not_block_tags_nor_beacons_without_a_world():
    wall = World.from_polygons([[(0, 0.4), (12, 0.4), (12, 0.6), (0, 0.6)]], bounds=(0, -1, 12, 5), robot_radius=0.1)
    path = [(0, 0), (12, 0)]
    assert len(beacon_passes(path, Beacon(TAG, 5.0, 1.0), wall)) == 1
    assert len(beacon_passes(path, Beacon(SIGN, 5.0, 1.0))) == 1
    assert len(beacon_passes(path, Beacon(SIGN, 5.0, 1.0), wall)) == 0


def test_a_beacon_on_a_wall_is_seen_from_its_side_only():
    wall = World.from_polygons([[(0, 1), (12, 1), (12, 2), (0, 2)]], bounds=(0, -1, 12, 5), robot_radius=0.1)
    on_the_wall = Beacon(SIGN, 5.0, 1.0)
    assert len(beacon_passes([(0, 0), (12, 0)], on_the_wall, wall)) == 1
    assert len(beacon_passes([(0, 3), (12, 3)], on_the_wall, wall)) == 0


def test_a_beacon_straight_ahead_is_hidden_behind_a_wall_across_the_path():
    wall = World.from_polygons([[(5, -1), (6, -1), (6, 1), (5, 1)]], bounds=(0, -2, 12, 2), robot_radius=0.1)
    assert beacon_passes([(0, 0), (12, 0)], Beacon(SIGN, 8.0, 0.0), wall).tolist() == [
        [pytest.approx(6.0, abs=2e-6), 12.0]
    ]


# Readings and drift


@pytest.mark.parametrize("p", [0.2, 0.9, 1.0])
@pytest.mark.parametrize("length", [0.0, 2.0, 7.0])
def test_a_whole_pass_is_missed_with_the_stated_probability(p, length):
    kind = BeaconKind.landmark(5.0, 0.1, 0.01, detection_probability=p, reading_spacing_m=2.5)
    off_line = (5.0**2 - (length / 2) ** 2) ** 0.5
    readings = beacon_fixes([(0, 0), (30, 0)], [Beacon(kind, 10.0 + length / 2, off_line)])
    assert np.prod([1 - fix.detection_probability for fix in readings]) == pytest.approx(1 - p)
    assert readings[0].s_m == pytest.approx(10.0, abs=1e-6)
    assert readings[-1].s_m == pytest.approx(10.0 + length, abs=1e-6)
    assert max(np.diff([fix.s_m for fix in readings]), default=0.0) <= 2.5


def test_drift_in_range_is_the_fix_and_grows_from_where_the_range_ends():
    drift = drift_with_beacons([(0, 0), (40, 0)], NOISE, [Beacon(SIGN, 20.0, 0.0)])
    assert drift.at(24.0).rms == pytest.approx(0.05 * 2**0.5)
    after = predict_drift([(0, 0), (16, 0)], NOISE, fixes=[Fix.full(0.0, position_std_m=0.05, heading_std=0.02)])
    assert drift.end.rms == pytest.approx(float(after.end.rms), rel=1e-9)
    assert float(drift.at(16.0).rms) < float(drift.at(15.99).rms)


def test_of_simultaneous_readings_the_more_accurate_counts_in_any_order():
    coarse, fine = BeaconKind.rfid(1.0, 0.5), BeaconKind.rfid(1.0, 0.02)
    for order in ([coarse, fine], [fine, coarse]):
        beacons = [Beacon(kind, 5.0, side) for kind, side in zip(order, (0.5, -0.5), strict=True)]
        drift = drift_with_beacons([(0, 0), (10, 0)], NOISE, beacons)
        assert drift.at(5 + 0.75**0.5).rms == pytest.approx(0.02 * 2**0.5, rel=1e-3)


def test_one_more_beacon_can_make_matters_worse():
    good, coarse = Beacon(BeaconKind.rfid(1.0, 0.02), 10.0, 0.0), Beacon(BeaconKind.rfid(1.0, 0.5), 12.5, 0.0)
    path = [(0, 0), (20, 0)]
    alone, both = (drift_with_beacons(path, NOISE, b).end.rms for b in ([good], [good, coarse]))
    assert both > alone


def test_zones_have_their_own_noise_and_add_waypoints():
    wet = Zone([(5, -1), (10, -1), (10, 1), (5, 1)], OdometryNoise(heading_var_per_m=4e-3))
    world = World.from_polygons([], bounds=(-1, -1, 21, 1), robot_radius=0.1, zones=[wet])
    drift = drift_with_beacons([(0, 0), (20, 0)], NOISE, [Beacon(TAG, 12.0, 0.0)], world)
    assert drift.distance.tolist() == [0.0, 5.0, 10.0, 20.0]
    assert drift.end.rms > drift_with_beacons([(0, 0), (20, 0)], NOISE, [Beacon(TAG, 12.0, 0.0)]).end.rms


def test_drift_with_beacons_matches_monte_carlo_with_all_kinds():
    path = np.array([(0, 0), (12, 0), (12, 9), (2, 9), (2, 2)], dtype=float)
    compass = BeaconKind.heading(2.0, 0.03, detection_probability=0.8)
    beacons = [
        Beacon(BeaconKind.rfid(1.5, 0.1, detection_probability=0.7), 6.0, 0.5),
        Beacon(compass, 12.0, 4.0),
        Beacon(SIGN, 8.0, 11.0),
    ]
    noise = OdometryNoise(heading_var_per_m=2e-3, distance_var_per_m=4e-3, heading_var_per_rad=1e-3)
    drift = drift_with_beacons(path, noise, beacons)
    errors = simulate_drift(path, noise, runs=20_000, rng=7, fixes=beacon_fixes(path, beacons), substep_m=0.2)
    square = (errors**2).sum(-1)
    z = (square.mean(0) - drift.rms**2)[1:] / (square.std(0)[1:] / np.sqrt(len(square)))
    assert np.abs(z).max() < 4  # four standard errors of the sample


# Capture


@pytest.mark.parametrize("offset", [-1.2, 0.0, 0.7])
def test_capture_on_a_straight_path_is_the_chance_of_the_sideways_error(offset):
    noise = OdometryNoise(heading_var_per_m=1e-3)
    beacon = Beacon(TAG, 20.0, offset)
    (found,) = detection_chances([(0, 0), (40, 0)], noise, [beacon])
    arrival = predict_drift([(0, 0), (40, 0)], noise).at(found.enter_m)
    sideways = float(arrival.cov[1, 1]) ** 0.5
    expected = ndtr((1.5 - offset) / sideways) - ndtr((-1.5 - offset) / sideways)
    assert found.probability == pytest.approx(expected, abs=0.01)  # the grid of quantiles


PAST_AND_BACK = np.array([(0, 0), (24, 0), (24, -3), (0, -3)], dtype=float)


def test_a_later_pass_does_not_stand_in_for_the_one_asked_for():
    """A robot that steers by its estimate, simulated: passing a tag at the edge of its range, then right beside it."""
    noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    tag = Beacon(BeaconKind.rfid(3.0, 0.1), 20.0, -2.9)
    first, second = detection_chances(PAST_AND_BACK, noise, [tag])
    rng, count, step = np.random.default_rng(0), 20_000, 0.1
    until = (first.leave_m + second.enter_m) / 2
    wrong, place, met = np.zeros(count), np.zeros(count, complex), np.zeros(count, bool)
    for k in range(int(until / step)):
        wrong += rng.normal(0, np.sqrt(noise.heading_var_per_m * step), count)
        driven = step - rng.normal(0, np.sqrt(noise.distance_var_per_m * step), count)
        place += driven * (1.0 if (k + 0.5) * step < 24 else -1j) * np.exp(-1j * wrong)
        met |= np.abs(place - (20 - 2.9j)) <= 3.0
    assert first.probability == pytest.approx(met.mean(), abs=0.015)
    assert second.probability > 0.99
    surely, likely = (
        ItineraryCheck(None, noise, Reliance(beacons=(tag,), min_capture=p)).captures(PAST_AND_BACK) for p in (0.9, 0.0)
    )
    assert [c.probability for c in surely] == pytest.approx([first.probability, 1.0], abs=0.01)
    assert likely == [first, second]


def test_without_noise_every_pass_is_captured_even_a_graze():
    found = detection_chances([(0, 0), (10, 0)], OdometryNoise(), [Beacon(TAG, 4.0, 1.5), Beacon(TAG, 8.0, 0.0)])
    assert [c.probability for c in found] == [1.0, 1.0]


def test_an_earlier_fix_makes_a_later_capture_likelier():
    noise, path = OdometryNoise(heading_var_per_m=2e-3), [(0, 0), (40, 0)]
    last = Beacon(TAG, 36.0, 0.5)
    alone = detection_chances(path, noise, [last])[-1].probability
    helped = detection_chances(path, noise, [Beacon(SIGN, 20.0, 0.0), last])[-1].probability
    assert helped > alone + 0.1


# Bad input


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: BeaconKind.rfid(range_m=0.0, position_std_m=0.1), "expected range_m > 0, got 0.0"),
        (lambda: BeaconKind.rfid(range_m=1.0, position_std_m=-0.1), "position_std_m >= 0, got -0.1"),
        (lambda: BeaconKind.rfid(range_m=float("nan"), position_std_m=0.1), "range_m finite"),
        (lambda: BeaconKind.heading(range_m=1.0, heading_std=float("inf")), "heading_std finite"),
        (lambda: BeaconKind(name="nothing", range_m=1.0), "position_std_m, heading_std or both, got neither"),
        (lambda: BeaconKind.rfid(1.0, 0.1, detection_probability=1.5), r"detection_probability in \(0, 1\], got 1.5"),
        (lambda: BeaconKind.rfid(1.0, 0.1, detection_probability=0.0), "detection_probability > 0"),
        (lambda: BeaconKind.rfid("1", 0.1), "expected range_m to be a number, got '1'"),
        (lambda: driftplan.Beacon("rfid", 0.0, 0.0), "expected kind to be a BeaconKind, got 'rfid'"),
        (lambda: Beacon(TAG, float("nan"), 0.0), "expected x finite, got nan"),
        (
            lambda: beacon_passes([(0, 0)], Beacon(TAG, 0.0, 0.0)),
            r"at least 2 waypoints in metres, got an array of shape \(1, 2\)",
        ),
        (lambda: beacon_passes([(0, 0), (1, float("nan"))], Beacon(TAG, 0.0, 0.0)), "finite coordinates"),
        (lambda: beacon_passes("abc", Beacon(TAG, 0.0, 0.0)), "expected a path of numbers"),
        (
            lambda: driftplan.drift_with_beacons([(0, 0), (1, 0)], NOISE, ["A7"]),
            "expected beacons to be Beacon objects, got 'A7'",
        ),
    ],
)
def test_bad_input_is_refused_saying_what_was_expected(make, said):
    with pytest.raises(ValueError, match=said):
        make()
