"""Itineraries: safe, within the limit by the exact model, short, and plain about what cannot be done."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.readings import beacon_fixes, detection_chances, drift_with_beacons, readings_on
from driftplan.errors import GoalError, InfeasibleError, NoPathError, StartError
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.model.simulation import simulate_drift
from driftplan.planning.bounds import least_length
from driftplan.planning.comparison import compare_routes
from driftplan.planning.request import DriftLimit, Planner, Reliance
from driftplan.planning.roadmap.beacon_search import BeaconSearch
from driftplan.planning.roadmap.itinerary_check import ItineraryCheck
from driftplan.planning.routes import Route, plan_route
from driftplan.world.mapfiles import bundled_map, load_world
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)
BETTER = NOISE.scaled(0.6)
TAG = BeaconKind.rfid(range_m=2.0, position_std_m=0.1)
SIGN = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
HALL = World.from_polygons([], bounds=(0, 0, 80, 40), robot_radius=0.5)
START, GOAL = (3.0, 10.0), (77.0, 10.0)
QUICK = {"max_nodes": 120, "time_limit": 600.0}  # a clock that never decides


def planned(*where, max_drift=None, redundancy=1, min_capture=None, max_nodes=1000, **asked):
    """The shortest route unless something else is to be least."""
    limit = DriftLimit(max_drift, redundancy=redundancy, min_capture=min_capture)
    planner = Planner(max_nodes=max_nodes)
    return plan_route(*where, **{"minimise": "length", "max_drift": limit, "planner": planner, **asked})


def greatest(path, beacons, world=HALL, noise=NOISE, fixes=()):
    """Greatest rms on a path, by the exact model on a fine grid."""
    return float(drift_with_beacons(path, noise, beacons, world, fixes=fixes).profile(0.05).rms.max())


def length_of(path):
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


# The exact check

coordinate = st.floats(1, 30).map(lambda x: round(x, 3))
point = st.tuples(coordinate, coordinate)
kinds = st.sampled_from(
    [
        TAG,
        SIGN,
        BeaconKind.heading(range_m=4.0, heading_std=0.02),
        BeaconKind.rfid(range_m=3.0, position_std_m=0.2, detection_probability=0.7),
        BeaconKind.landmark(range_m=5.0, position_std_m=0.3, heading_std=0.1, detection_probability=0.9),
    ]
)
noises = st.sampled_from(
    [
        NOISE,
        OdometryNoise(heading_var_per_m=1e-2, distance_var_per_m=1e-3, heading_var_per_rad=1e-3),
        OdometryNoise(heading_var_per_m=1e-3, heading_bias_per_m=0.01, distance_scale_error=0.02),
    ]
)


@settings(deadline=None, max_examples=20)
@given(
    st.lists(point, min_size=2, max_size=6, unique=True),
    st.lists(st.tuples(kinds, point), max_size=5),
    noises,
    st.booleans(),
    st.sampled_from([None, Fix.full(0.0, position_std_m=0.5, heading_std=0.05)]),
)
def test_the_check_finds_what_the_exact_model_finds(path, placed, noise, zoned, initial):
    path = np.array(path)
    zones = [Zone([(5, 5), (20, 5), (20, 20), (5, 20)], NOISE.scaled(2.0))] if zoned else []
    world = World.from_polygons([], bounds=(0, 0, 31, 31), robot_radius=0.1, zones=zones)
    beacons = tuple(Beacon(kind, *xy) for kind, xy in placed)
    check = ItineraryCheck(world, noise, Reliance(beacons=beacons, start_fix=initial, min_capture=0.0))
    verdict = check.verdict(path)
    fixes = () if initial is None else (initial,)
    exact = drift_with_beacons(path, noise, beacons, world, fixes=fixes)
    # two ways to sum the same numbers; places are rounded to the micrometre and the grid misses the very top
    assert verdict.end == pytest.approx(float(exact.end.rms), rel=1e-6, abs=1e-9)
    assert verdict.worst == pytest.approx(float(exact.profile(0.1).rms.max()), rel=1e-4, abs=1e-9)
    np.testing.assert_allclose(check.drift(path).rms, exact.rms, rtol=1e-9, atol=1e-12)


def test_a_start_heading_makes_the_first_turn_count():
    noise = OdometryNoise(heading_var_per_m=1e-4, heading_var_per_rad=1e-2)
    path = np.array([(1.0, 1.0), (20.0, 1.0)])
    ahead, back = (
        ItineraryCheck(HALL, noise, Reliance(start_heading=heading)).verdict(path).end for heading in (0.0, np.pi)
    )
    assert back > 2 * ahead


def test_captures_are_those_of_the_reference():
    beacons = (Beacon(TAG, 10, 11), Beacon(SIGN, 30, 12.5), Beacon(TAG, 60, 8.2))
    path = np.array([(3.0, 10.0), (40.0, 10.5), (77.0, 10.0)])
    ours = ItineraryCheck(HALL, NOISE, Reliance(beacons=beacons, min_capture=0.0)).captures(path)
    theirs = detection_chances(path, NOISE, beacons, HALL)
    assert [c.beacon for c in ours] == [c.beacon for c in theirs]
    # a grid of 24 quantiles per axis against one of 128
    np.testing.assert_allclose([c.probability for c in ours], [c.probability for c in theirs], atol=0.03)


def test_what_is_probably_missed_does_not_count():
    beacons = (Beacon(TAG, 40.0, 11.9),)  # the path grazes the range, after 37 m of drift
    path = np.array([START, GOAL])
    counted, not_counted = (ItineraryCheck(HALL, NOISE, Reliance(beacons=beacons, min_capture=p)) for p in (0.0, 0.9))
    assert len(readings_on(path, counted._columns, HALL))
    assert counted.met(path) == [0]
    assert not_counted.met(path) == []
    assert not_counted.verdict(path).end == pytest.approx(greatest(path, ()))


# Shortest within a limit

ON_THE_WAY = [Beacon(SIGN, 28, 11), Beacon(SIGN, 52, 9)]


def test_the_shortest_path_is_taken_when_it_keeps_the_limit():
    found = planned(HALL, START, GOAL, NOISE, beacons=ON_THE_WAY, max_drift=2.0, **QUICK)
    assert found.length == pytest.approx(74.0)
    assert found.status.name == "OPTIMAL"
    assert found.bound == pytest.approx(74.0)
    assert found.beacons == tuple(ON_THE_WAY)


def test_a_detour_by_beacons_wins_where_the_shortest_path_gets_lost():
    beacons = [Beacon(SIGN, 22, 20), Beacon(SIGN, 40, 22), Beacon(SIGN, 58, 20)]
    limit = 1.5
    assert greatest(np.array([START, GOAL]), beacons) > 2 * limit
    found = planned(HALL, START, GOAL, NOISE, beacons=beacons, max_drift=limit, **QUICK)
    assert found.worst_drift <= limit
    assert greatest(found.path, beacons) <= limit * (1 + 1e-6)
    assert 74.0 < found.length < 82.0
    assert found.bound <= found.length
    assert HALL.segments_free(found.path[:-1], found.path[1:]).all()
    assert len(found.beacons) >= 2
    assert isinstance(found, Route)
    table = str(compare_routes([found])).splitlines()
    assert dict(zip(table[0].replace(" m", "_m").split(), table[1].split(), strict=True))["beacons"] == str(
        len(found.beacons)
    )


def test_a_short_detour_is_not_far_from_the_best_there_is():
    # One sign beside the way: no path is shorter than one that touches its range, by symmetry half-way.
    sign = Beacon(SIGN, 40, 18)
    found = planned(HALL, START, GOAL, NOISE, beacons=[sign], max_drift=2.7, min_capture=0.0, **QUICK)
    touching = 2 * float(np.hypot(37.0, 8.0 - SIGN.range_m))
    assert touching - 1e-6 <= found.length <= 1.003 * touching
    assert found.bound <= touching


def test_fewer_restrictions_never_make_a_route_longer():
    beacons = [Beacon(SIGN, 22, 18), Beacon(SIGN, 40, 20), Beacon(SIGN, 58, 17), Beacon(TAG, 30, 6)]
    lengths = [
        planned(HALL, START, GOAL, NOISE, beacons=beacons, max_drift=limit, min_capture=0.0, **QUICK).length
        for limit in (1.5, 1.8, 2.5)
    ]
    assert lengths[0] >= lengths[1] - 0.2 >= lengths[2] - 0.4  # shortening stops at a local best


def test_without_beacons_the_limit_must_hold_alone():
    found = planned(HALL, START, (13.0, 10.0), NOISE, beacons=[], max_drift=0.5, **QUICK)
    assert found.beacons == ()
    assert found.worst_drift == pytest.approx(greatest(np.array([START, (13.0, 10.0)]), ()))


@pytest.mark.parametrize(("limit", "said"), [(0.4, r'can keep it: estimator="filter"'), (0.1, "not found to keep it")])
def test_when_no_route_will_do_it_is_said_whether_one_would_for_a_robot_that_fuses(limit, said):
    noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    corridor = World.from_polygons([], bounds=(-1, -1, 61, 1), robot_radius=0.3)
    asked = {"beacons": [Beacon(TAG, x, 0.0) for x in range(0, 61, 10)], "max_drift": limit, **QUICK, "max_nodes": 60}
    with pytest.raises(InfeasibleError, match="a robot that fuses its readings .*" + said):
        planned(corridor, (0.0, 0.0), (60.0, 0.0), noise, **asked)
    if limit == 0.4:
        assert planned(corridor, (0.0, 0.0), (60.0, 0.0), noise, estimator="filter", **asked).worst_drift <= limit


def test_position_fixes_alone_cannot_hold_a_limit_when_the_heading_is_never_fixed():
    rough = OdometryNoise.from_std(heading_deg=8.0, distance_m=0.1, after_m=10.0)
    spots = [(x, 10.0) for x in range(7, 78, 7)]
    tags = [Beacon(TAG, *xy) for xy in spots]
    with pytest.raises(InfeasibleError, match=r"heading is never fixed.*heading the limit could be kept"):
        planned(HALL, START, GOAL, rough, beacons=tags, max_drift=0.7, max_nodes=60, time_limit=600.0)
    signs = [Beacon(SIGN, *xy) for xy in spots]
    found = planned(HALL, START, GOAL, rough, beacons=signs, max_drift=0.7, **QUICK)
    assert found.worst_drift <= 0.7


@pytest.mark.slow
def test_an_itinerary_out_of_reach_says_how_near_it_gets():
    with pytest.raises(InfeasibleError, match=r"short of the goal; the beacon nearest to that place, A at .* m away"):
        planned(
            HALL,
            START,
            GOAL,
            NOISE,
            beacons=[Beacon(SIGN, 10, 10, id="A")],
            max_drift=0.5,
            max_nodes=40,
            time_limit=600.0,
        )
    with pytest.raises(InfeasibleError, match=r"would be missed: .*min_capture=0\.9"):
        planned(HALL, START, GOAL, NOISE, beacons=[Beacon(SIGN, 40, 18)], max_drift=2.7, max_nodes=60, time_limit=600.0)
    with pytest.raises(InfeasibleError, match=r"most accurate beacon leaves an rms error of 0\.141"):
        planned(HALL, START, GOAL, NOISE, beacons=[Beacon(TAG, 10, 10)], max_drift=0.1, max_nodes=40, time_limit=600.0)
    with pytest.raises(InfeasibleError, match="no beacon gives a position"):
        planned(HALL, START, GOAL, NOISE, beacons=[], max_drift=0.5, max_nodes=40, time_limit=600.0)
    unsure = Fix.full(0.0, position_std_m=1.0, heading_std=0.1)
    with pytest.raises(InfeasibleError, match="drift at the start is above it"):
        planned(
            HALL,
            START,
            GOAL,
            NOISE,
            beacons=[Beacon(SIGN, 40, 10)],
            max_drift=1.0,
            start_fix=unsure,
            max_nodes=40,
            time_limit=600.0,
        )


def test_walls_block_the_sight_of_landmarks():
    wall = [(5, 12), (75, 12), (75, 13), (5, 13)]
    world = World.from_polygons([wall], bounds=(0, 0, 80, 40), robot_radius=0.5)
    hidden = [Beacon(SIGN, x, 14.0) for x in (20, 40, 60)]  # within range of the direct way, behind the wall
    found = planned(world, START, GOAL, NOISE, beacons=hidden, max_drift=2.2, **QUICK)
    assert found.length > 75
    assert greatest(found.path, hidden, world) <= 2.2 * (1 + 1e-6)
    assert found.path[:, 1].max() > 13


def test_an_uncertain_start_is_taken_into_account():
    beacons = [Beacon(SIGN, 10, 12), *ON_THE_WAY]
    unsure = Fix.full(0.0, position_std_m=0.2, heading_std=0.1)
    found = planned(HALL, START, GOAL, NOISE, beacons=beacons, max_drift=1.3, start_fix=unsure, **QUICK)
    assert float(found.drift.rms[0]) == pytest.approx(0.2 * 2**0.5)
    assert greatest(found.path, found.beacons, fixes=[unsure]) <= 1.3 * (1 + 1e-6)


# Dead beacons

SPARE = [Beacon(SIGN, x, y) for x in (18, 32, 46, 60) for y in (11.0, 20.0)]


def test_with_any_one_beacon_dead_the_limit_still_holds():
    beacons = [*SPARE, Beacon(TAG, 25, 9), Beacon(TAG, 53, 9)]
    limit = 1.9
    found = planned(HALL, START, GOAL, NOISE, beacons=beacons, max_drift=limit, redundancy=2, **QUICK)
    assert found.worst_drift <= found.worst_guaranteed <= limit
    for beacon in found.beacons:
        rest = [b for b in found.beacons if b is not beacon]
        assert greatest(found.path, rest) <= limit * (1 + 1e-6)


@pytest.mark.slow
def test_one_beacon_that_everything_hangs_on_is_not_enough():
    one, sure = [Beacon(SIGN, 40, 10)], 0.85  # read with 0.888 on the straight way
    asked = {"beacons": one, "max_drift": 2.5, "min_capture": sure}
    planned(HALL, START, GOAL, NOISE, **asked, **QUICK)
    with pytest.raises(InfeasibleError, match="with any one beacon dead"):
        planned(HALL, START, GOAL, NOISE, **asked, redundancy=2, max_nodes=40, time_limit=600.0)


# Other objectives


def test_the_beacon_next_to_the_goal_is_worth_a_detour_only_within_max_detour():
    beside = [Beacon(SIGN, 66, 26)]  # 16 m aside
    opened = {"max_nodes": 80, "time_limit": 600.0, "min_capture": 0.0}
    near = planned(HALL, START, GOAL, NOISE, beacons=beside, minimise="drift", max_detour=1.05, **opened)
    far = planned(HALL, START, GOAL, NOISE, beacons=beside, minimise="drift", max_detour=1.5, **opened)
    assert near.beacons == ()
    assert near.length <= 1.05 * 74 * (1 + 1e-9)
    assert far.beacons == tuple(beside)
    assert far.length <= 1.5 * 74 * (1 + 1e-9)
    assert far.bound <= far.rms < 0.6 * near.rms


def test_the_least_worst_drift_is_below_that_of_the_shortest_path_and_cannot_be_kept_below():
    beacons = [Beacon(SIGN, 22, 20), Beacon(SIGN, 40, 22), Beacon(SIGN, 58, 20)]
    found = planned(HALL, START, GOAL, NOISE, beacons=beacons, minimise="worst_drift", **QUICK)
    assert found.worst_drift < 0.4 * greatest(np.array([START, GOAL]), beacons)
    assert found.bound <= found.worst_drift
    with pytest.raises(InfeasibleError):
        planned(HALL, START, GOAL, NOISE, beacons=beacons, max_drift=0.85 * found.worst_drift, max_detour=1.5, **QUICK)


def test_shortening_a_path_loses_no_reading_that_its_low_drift_at_the_end_hangs_on():
    x = [15.44, 10.32, 9.28, 8.84, 5.81, 5.08, 4.2, 2.5, 2.13, 4.01, 5.78, 5.59]  # back from the second sign
    path = np.column_stack([x, [10.39, 11.58, 10.34, 10.18, 9.03, 8.19, 8.18, 7.99, 8.46, 7.66, 8.53, 1.46]])
    sign = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.02)
    office, signs = (
        load_world(bundled_map("office"), robot_radius=0.3),
        (Beacon(sign, 13.52, 9.79), Beacon(sign, 2.13, 10.56)),
    )
    noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    ends, reliance = path[[0, -1]], Reliance(signs)
    search = BeaconSearch(office, office, ends, noise, reliance, max_nodes=50, stop=lambda: False, shortest=path)
    at_end = search.check.verdict(path).end
    shorter = search.shorter(path, np.inf, at_end)
    assert length_of(shorter) < length_of(path)
    assert search.check.verdict(shorter).end <= at_end * (1 + 1e-9)


# Oracle: drive it


@pytest.mark.parametrize("kind", [SIGN, TAG], ids=["full", "position"])
def test_robots_that_drive_the_itinerary_drift_as_predicted(kind):
    beacons = [Beacon(kind, x, 13 + x % 3) for x in (14, 26, 38, 50, 62)]
    found = planned(HALL, START, GOAL, BETTER, beacons=beacons, max_drift=1.2, min_capture=0.0, **QUICK)
    assert len(found.beacons) >= 2
    fixes = beacon_fixes(found.path, found.beacons, HALL)
    errors = simulate_drift(found.path, BETTER, runs=15_000, fixes=fixes, rng=5)
    square = (errors**2).sum(axis=2)
    mean, std = square.mean(axis=0), square.std(axis=0, ddof=1) / np.sqrt(len(errors))
    np.testing.assert_array_less(np.abs(mean - found.drift.rms**2), 4 * std + 1e-12)


# Promises


@pytest.mark.parametrize(
    "minimise", ["length", *(pytest.param(name, marks=pytest.mark.slow) for name in ("drift", "worst_drift"))]
)
def test_the_same_seed_gives_the_same_route_whatever_the_clock(minimise):
    beacons = [Beacon(SIGN, 22, 20), Beacon(SIGN, 40, 22), Beacon(SIGN, 58, 20)]
    asked = {"beacons": beacons, "max_drift": 1.6, "minimise": minimise, "max_nodes": 60, "seed": 3}
    first, second = (planned(HALL, START, GOAL, NOISE, **asked, time_limit=limit) for limit in (600.0, 5000.0))
    assert first.status.name == "SEARCH_DONE"
    np.testing.assert_array_equal(first.path, second.path)
    assert first.labels == second.labels


def test_a_clock_that_runs_out_is_said():
    beacons = [Beacon(SIGN, 22, 20), Beacon(SIGN, 40, 22), Beacon(SIGN, 58, 20)]
    found = planned(HALL, START, GOAL, NOISE, beacons=beacons, max_drift=9.0, minimise="drift", time_limit=1e-3)
    assert found.status.name == "TIME_LIMIT"
    assert found.worst_drift <= 9.0
    with pytest.raises(InfeasibleError, match=r"was found in time, nor was it ruled out: raise time_limit"):
        planned(HALL, START, GOAL, NOISE, beacons=beacons, max_drift=1.6, time_limit=1e-3)


def test_no_route_that_keeps_the_limit_is_shorter_than_the_bound():
    ends = np.array([START, GOAL])
    beacons = [Beacon(SIGN, 40, 30)]
    assert least_length(ends, [NOISE], beacons, None) == pytest.approx(74)
    by_beacon = least_length(ends, [NOISE], beacons, 2.5)
    assert by_beacon == pytest.approx(2 * (np.hypot(37, 20) - 3))
    assert least_length(ends, [NOISE], beacons, 100.0) == pytest.approx(74)
    assert least_length(ends, [NOISE], [], 1.0) == np.inf
    assert least_length(ends, [NOISE], beacons, 2.0) == np.inf  # the beacon is too far from both ends
    compass = [*beacons, Beacon(BeaconKind.heading(range_m=4.0, heading_std=0.0), 20, 10)]
    assert least_length(ends, [NOISE], compass, 2.0) == pytest.approx(74)  # headings might be fixed all the way


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"max_drift": 0.0}, "max_drift finite and > 0"),
        ({"max_drift": float("nan")}, "max_drift"),
        ({"minimise": "time"}, "minimise one of"),
        ({"max_detour": 0.9}, "max_detour >= 1"),
        ({"redundancy": 3}, "redundancy 1"),
        ({"min_capture": 1.0}, "min_capture in"),
        ({"start_fix": Fix.full(1.0, position_std_m=0.1, heading_std=0.1)}, "Fix at s_m=0"),
        ({"max_nodes": 3}, "nodes a whole number"),
        ({"seed": -1}, "seed a whole number"),
        ({"time_limit": 0}, "time_limit > 0"),
        ({"noise": OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.0)}, "continuous kind"),
    ],
)
def test_input_that_makes_no_sense_is_refused(change, said):
    given = {"noise": NOISE, "beacons": ON_THE_WAY, **change}
    noise = given.pop("noise")
    with pytest.raises(ValueError, match=said):
        planned(HALL, START, GOAL, noise, **given)


def test_ends_that_cannot_be_reached_are_refused():
    wall = [(30, 0), (31, 0), (31, 40), (30, 40)]
    world = World.from_polygons([wall], bounds=(0, 0, 80, 40), robot_radius=0.5)
    with pytest.raises(StartError):
        planned(world, (30.5, 5), GOAL, NOISE, beacons=[])
    with pytest.raises(GoalError):
        planned(world, START, (90, 5), NOISE, beacons=[])
    with pytest.raises(NoPathError):
        planned(world, START, GOAL, NOISE, beacons=[])
    with pytest.raises(ValueError, match="start and goal apart"):
        planned(world, START, START, NOISE, max_drift=1.0)


# A real map


def test_tags_in_the_warehouse_hold_a_limit_that_the_shortest_route_breaks():
    world = load_world(bundled_map("warehouse"), robot_radius=0.3)
    rng = np.random.default_rng(1)
    xy = rng.uniform((0, 0), (60, 40), (500, 2))
    xy = xy[world.is_free(xy)][:50]
    beacons = [Beacon(SIGN if k % 4 == 0 else TAG, *p) for k, p in enumerate(xy)]
    free = planned(world, (51.0, 33.0), (23.5, 18.7), NOISE, beacons=beacons, max_nodes=200, time_limit=600)
    limit = 0.7 * free.worst_drift
    found = planned(
        world, (51.0, 33.0), (23.5, 18.7), NOISE, beacons=beacons, max_drift=limit, max_nodes=200, time_limit=600
    )
    assert found.length >= free.length * (1 - 1e-9)
    assert found.worst_drift <= limit
    assert world.segments_free(found.path[:-1], found.path[1:]).all()
    assert Path(bundled_map("warehouse")).exists()
