"""RoadmapSearch: laws of every answer, then cases whose best path is known, then errors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.errors import GoalError, NoPathError, StartError
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.planning.request import PlanRequest
from driftplan.planning.roadmap import growth
from driftplan.planning.roadmap.growth import RoadmapSearch
from driftplan.planning.roadmap.prices import AdditiveCost, exact_drift
from driftplan.planning.routes import plan_route
from driftplan.planning.status import Status
from driftplan.world.mapfiles import bundled_map, load_world
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3)
TURNING = OdometryNoise(heading_var_per_m=1e-4, heading_var_per_rad=5e-3, distance_var_per_rad=1e-4)


def box(x0, y0, x1, y1):
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


ROOM = World.from_polygons(
    [box(4, 2, 5, 9), box(8, 0, 9, 6), box(12, 4, 13, 10)], bounds=(0, 0, 16, 10), robot_radius=0.3
)
ACROSS = np.array([(1.0, 9.0), (15.0, 9.0)])
EMPTY = World.from_polygons([], bounds=(0, 0, 20, 20), robot_radius=0.2)


@st.composite
def free_points(draw, world=ROOM):
    coordinate = st.floats(0.5, 9.5)
    return draw(
        st.tuples(st.floats(0.5, 15.5), coordinate).map(np.array).filter(lambda xy: bool(world.is_free(xy))),
    )


def searched(world, ends, noise, *, minimise="drift", batches=4, seed=0, start_heading=None):
    """The search after so many batches."""
    cost = AdditiveCost(world, ends[1], noise, minimise)
    search = RoadmapSearch(cost, ends[0], seed=seed, start_heading=start_heading)
    while search.batches < batches and not search.is_optimal:
        search.grow()
    return search


# Laws


@settings(max_examples=10, deadline=None)
@given(free_points(), free_points(), st.sampled_from([NOISE, TURNING]), st.sampled_from(["drift", "length"]))
def test_a_path_is_free_joins_its_ends_and_costs_what_it_says(start, goal, noise, minimise):
    found = searched(ROOM, np.array([start, goal]), noise, minimise=minimise, batches=1)
    np.testing.assert_array_equal(found.path[[0, -1]], [start, goal])
    assert ROOM.segments_free(found.path[:-1], found.path[1:]).all()
    if minimise == "drift":
        assert found.cost == pytest.approx(predict_drift(found.path, noise).end.rms ** 2, rel=1e-12)
        assert found.additive_cost == pytest.approx(found.pricing.path(found.path), rel=1e-12)
    else:
        assert found.cost == pytest.approx(np.linalg.norm(np.diff(found.path, axis=0), axis=1).sum(), rel=1e-12)


@settings(max_examples=10, deadline=None)
@given(free_points(), free_points(), st.sampled_from([NOISE, TURNING]))
def test_a_path_is_never_worse_than_a_free_straight_run(start, goal, noise):
    if not (start != goal).any() or not ROOM.segments_free(start, goal):
        return
    found = searched(ROOM, np.array([start, goal]), noise, batches=1)
    assert found.cost <= predict_drift([start, goal], noise).end.rms ** 2


@pytest.mark.parametrize("time_left", [True, False])
def test_a_path_on_the_way_to_the_polished_one_is_kept_if_it_drifts_less(monkeypatch, time_left):
    """A search that is cut short may be left with it, and a longer one must not be worse."""
    zigzag, straight = np.array([(2.0, 2.0), (8.0, 9.0), (18.0, 2.0)]), np.array([(2.0, 2.0), (9.0, 2.0), (18.0, 2.0)])
    late = []

    def polishing(pricing, path, start_heading, stop, *, tell):
        tell(straight)
        late.append(not time_left)
        return zigzag

    search = RoadmapSearch(AdditiveCost(EMPTY, straight[-1], NOISE), straight[0])
    search.path, search.cost = None, np.inf
    monkeypatch.setattr(growth, "polished", polishing)
    search.consider(zigzag, lambda: late == [True])
    assert search.cost == pytest.approx(exact_drift(EMPTY, straight, NOISE, None).end.rms ** 2)
    assert len(search.path) == (2 if time_left else 3)  # without waypoints that it does not need


@pytest.mark.parametrize("minimise", ["drift", "length"])
def test_more_batches_never_cost_more(minimise):
    costs = [searched(ROOM, ACROSS, NOISE, minimise=minimise, batches=n).cost for n in (1, 2, 3, 4)]
    assert costs == sorted(costs, reverse=True)


def test_a_path_that_is_found_again_is_not_polished_again(monkeypatch):
    search, polishings = searched(ROOM, ACROSS, NOISE, batches=3), []
    monkeypatch.setattr(growth, "polished", lambda *args: polishings.append(args) or args[1])
    monkeypatch.setattr(search.roadmap, "shortest", lambda limit: search.roadmap._priced(best_nodes(search)))
    search.grow()
    assert search.batches == 4
    assert not polishings


def best_nodes(search):
    """Those of the best path, which is part of the roadmap."""
    return np.array([np.flatnonzero((search.roadmap.xy == place).all(axis=1))[0] for place in search.path])


def test_among_zones_a_search_that_has_all_corners_ends_when_a_batch_brought_next_to_nothing(monkeypatch):
    bad = Zone([(5, 0), (12, 0), (12, 10), (5, 10)], NOISE.scaled(3.0))  # keeps the bound apart
    world = World.from_polygons(
        [box(4, 2, 5, 9), box(8, 0, 9, 6), box(12, 4, 13, 10)], bounds=(0, 0, 16, 10), robot_radius=0.3, zones=[bad]
    )
    seen, grow = [], RoadmapSearch.grow
    monkeypatch.setattr(RoadmapSearch, "grow", lambda search, stop: (seen.append(idle(search)), grow(search, stop))[1])
    monkeypatch.setattr(PlanRequest, "left_s", lambda *_: 1e3)
    route = plan_route(world, *ACROSS, NOISE)
    assert route.status is Status.NOTHING_GAINED
    drift = [(batches, has_all, idle) for minimise, batches, has_all, idle in seen if minimise == "drift"]
    assert [batches for batches, *_ in drift[:3]] == [0, 1, 2]
    assert all(idle == 0 for batches, has_all, idle in drift if has_all and batches > 2)
    assert all(idle < 2 for batches, _, idle in drift if batches > 2)


def idle(search):
    return search.pricing.minimise, search.batches, search.has_all_corners, search.idle_batches


@pytest.mark.parametrize(("start", "goal"), [((33.9, 1.4), (28.9, 4.6)), ((27.3, 9.5), (5.8, 17.0))])
def test_a_search_that_ends_by_itself_is_within_a_thousandth_of_a_long_one(start, goal):
    world = load_world(bundled_map("office"), robot_radius=0.3)
    noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    assert plan_route(world, start, goal, noise).rms <= 1.001 * plan_route(world, start, goal, noise, iterations=6).rms


def test_when_it_is_late_a_search_that_has_a_path_begins_nothing():
    search = searched(ROOM, ACROSS, NOISE, batches=1)
    nodes, path = search.roadmap.xy, search.path
    search.grow(lambda: True)
    assert search.roadmap.xy is nodes
    assert search.path is path


def test_the_same_seed_gives_the_same_path_and_another_seed_one_as_good():
    one, again, other = (searched(ROOM, ACROSS, NOISE, batches=2, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(one.path, again.path)
    np.testing.assert_array_equal(one.roadmap.xy, again.roadmap.xy)
    assert not np.array_equal(one.roadmap.xy, other.roadmap.xy)
    assert other.cost == pytest.approx(one.cost, rel=3e-3)  # both near the same optimum


# Known best paths


def test_a_straight_run_in_the_open_is_known_to_be_optimal_at_once():
    found = searched(EMPTY, np.array([(1, 1), (19, 15)], dtype=float), NOISE)
    assert found.is_optimal
    assert found.batches == 0
    np.testing.assert_array_equal(found.path, [[1, 1], [19, 15]])


def test_the_shortest_way_round_a_wall_touches_its_corner():
    world = World.from_polygons([box(4, 0, 6, 7)], bounds=(0, 0, 10, 10), robot_radius=0.0)
    found = searched(world, np.array([(1, 7), (9, 7)]), NOISE, minimise="length", batches=2)
    assert found.cost == pytest.approx(8.0, abs=1e-3)
    found = searched(world, np.array([(1, 4), (9, 4)]), NOISE, minimise="length", batches=2)
    assert found.cost == pytest.approx(2 * np.hypot(3, 3) + 2, rel=1e-3)


def test_the_path_of_least_drift_bends_where_the_flat_metric_says():
    # Round the corner c of a thin screen the best path is two geodesics of w -> w³/3, one on each side of c.
    corner, start, goal = np.array([10.0, 8.0]), np.array([3.0, 3.0]), np.array([16.0, 4.0])
    screen = [(9.999, 0), (10.001, 0), (10.001, 8), (9.999, 8)]
    world = World.from_polygons([screen], bounds=(0, 0, 20, 20), robot_radius=0.0)
    noise = OdometryNoise(heading_var_per_m=1e-4)
    w0, w1 = (complex(*(goal - point)) for point in (start, corner))
    best = 1e-4 / 3 * (abs(w0**3 - w1**3) + abs(w1) ** 3)
    found = searched(world, np.array([start, goal], dtype=float), noise, batches=2)
    assert found.additive_cost >= best * (1 - 1e-9)
    assert found.additive_cost == pytest.approx(best, rel=2e-3)  # straight legs in place of curves


def test_bad_floor_is_driven_around_far_from_the_goal_and_crossed_near_it():
    """A corridor of bad floor across an open hall, with a way round at its end. What it costs to cross grows with the
    square of the distance to the goal, so the same corridor is avoided by the robot that has far to go."""
    bad = OdometryNoise(heading_var_per_m=1e-3)
    corridor = Zone([(14, 4), (16, 4), (16, 21), (14, 21)], bad)
    world = World.from_polygons([], bounds=(0, 0, 60, 20), robot_radius=0.2, zones=[corridor])
    noise = OdometryNoise(heading_var_per_m=1e-4)

    def crosses(path):
        return bool((world.cut_at_zones(path)[1] >= 0).any())

    far = searched(world, np.array([(2, 10), (58, 10)], dtype=float), noise, batches=2)
    assert not crosses(far.path)
    near = searched(world, np.array([(2, 10), (18, 10)], dtype=float), noise, batches=2)
    assert crosses(near.path)
    for found, start, goal in ((far, (2, 10), (58, 10)), (near, (2, 10), (18, 10))):
        end = exact_drift(world, found.path, noise).end
        assert found.cost == pytest.approx(float(end.rms) ** 2, rel=1e-12)
        straight = float(exact_drift(world, np.array([start, goal], dtype=float), noise).end.rms) ** 2
        assert found.cost <= straight
    around = np.array([(2, 10), (13.9, 3.9), (16.1, 3.9), (18, 10)])
    assert near.cost < float(exact_drift(world, around, noise).end.rms) ** 2


def test_turns_are_avoided_where_they_cost():
    world = World.from_polygons(
        [box(3, 3, 7, 7), box(9, 3, 13, 7), box(3, 9, 13, 13)], bounds=(0, 0, 16, 16), robot_radius=0.4
    )
    start, goal = (1, 1), (8, 8)
    turns_cost = OdometryNoise(heading_var_per_m=1e-5, heading_var_per_rad=1e-2)
    turns_are_free = OdometryNoise(heading_var_per_m=1e-5)

    def plan(noise, **options):
        return searched(world, np.array([start, goal], dtype=float), noise, batches=1, **options)

    few, many = plan(turns_cost), plan(turns_are_free)
    assert few.pricing.path(few.path) < few.pricing.path(many.path)
    # Starting the wrong way round costs at least the turn towards the goal's half of the map.
    back = plan(turns_cost, start_heading=-np.pi * 3 / 4)
    assert back.additive_cost == pytest.approx(back.pricing.path(back.path, -np.pi * 3 / 4))
    assert back.additive_cost > few.additive_cost + 1e-2 * np.pi / 2 * 98


# Errors


def test_start_and_goal_must_be_free():
    with pytest.raises(StartError, match=r"start \(4.5, 5\) is not free; the nearest free point is \("):
        plan_route(ROOM, (4.5, 5), (15, 9), NOISE)
    with pytest.raises(GoalError, match=r"goal \(4.5, 5\) is not free; the nearest free point is \("):
        plan_route(ROOM, (15, 9), (4.5, 5), NOISE)


def test_what_cannot_be_reached_is_said_with_what_can():
    world = World.from_polygons([box(4, 0, 5, 10)], bounds=(0, 0, 10, 10), robot_radius=0.3)
    with pytest.raises(NoPathError, match=r"reaches only 31\.\d* m², x 0.30..3.70, y 0.30..9.70"):
        plan_route(world, (1, 1), (9, 9), NOISE)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"start": (1, np.nan)}, "expected start"),
        ({"goal": (1, 2, 3)}, "expected goal"),
        ({"noise": None}, "expected noise to be an OdometryNoise"),
        ({"minimise": "time"}, "expected minimise one of .*, got 'time'"),
        ({"time_limit": 0.0}, "expected time_limit > 0"),
        ({"time_limit": np.nan}, "expected time_limit finite"),
        ({"iterations": 0}, "expected iterations a whole number >= 1"),
        ({"start": (1, 1, np.inf)}, "expected start finite"),
    ],
)
def test_bad_arguments_are_named(changed, message):
    arguments = {"start": (1, 1), "goal": (15, 9), "noise": NOISE} | changed
    with pytest.raises(ValueError, match=message):
        plan_route(ROOM, **arguments)


def test_standing_still_costs_nothing():
    for minimise in ("drift", "length"):
        found = plan_route(ROOM, (1, 1), (1, 1), NOISE, minimise=minimise)
        assert (found.rms, found.length) == (0.0, 0.0)
        assert found.status is Status.OPTIMAL
