"""Taut strings: below every route, above nothing else, and met by a route as the margin shrinks."""

from __future__ import annotations

import math
from itertools import combinations, pairwise

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csgraph, csr_matrix

from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import edge_cost, geodesic_cost
from driftplan.planning.routes import plan_route
from driftplan.planning.taut_strings import LeastRoute, least_route, taut_route, tight_least_route
from driftplan.world.mapfiles import bundled_map, load_world
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=2e-3)
UNIT = OdometryNoise(heading_var_per_m=1.0)
WALL = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)


def random_world(seed, radius):
    """Turned boxes, thin walls among them, in a room of 20 m by 12 m; and two free points that hang together."""
    rng = np.random.default_rng(seed)
    boxes = []
    for _ in range(int(rng.integers(1, 14))):
        w, h = rng.uniform(0.2, 4, 2) if rng.random() < 0.6 else (rng.uniform(2, 8), 0.1)
        box = shapely.affinity.rotate(shapely.box(-w / 2, -h / 2, w / 2, h / 2), rng.uniform(0, 180))
        boxes.append(shapely.affinity.translate(box, rng.uniform(0, 20), rng.uniform(0, 12)))
    world = World.from_polygons(boxes, bounds=(0, 0, 20, 12), robot_radius=radius)
    room = world.free_parts[0]
    points = []
    while len(points) < 2:
        p = rng.uniform((0, 0), (20, 12))
        if shapely.contains_xy(room, *p) and world.is_free(p) and world.free_part(p) == 0:
            points.append(p)
    return world, *points


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), radius=st.sampled_from([0.0, 0.3]))
def test_the_bound_is_below_every_route_and_a_route_comes_near(seed, radius):
    world, start, goal = random_world(seed, radius)
    found = [taut_route(world, start, goal, 0.002, by_length=by_length) for by_length in (False, True)]
    if any(path is None for path in found):  # a passage of less than two margins, or a start at a wall
        found = [plan_route(world, start, goal, NOISE, iterations=2).path] * 2
    levers, length = (LeastRoute.of_path(path) for path in found)
    for margin in (0.2, 0.02, 0.002):
        least = least_route(world, start, goal, margin)
        assert least.squared_levers <= levers.squared_levers * (1 + 1e-9)
        assert least.length <= length.length * (1 + 1e-9)
        known = least_route(world, start, goal, margin, found[0])
        assert known.squared_levers == pytest.approx(least.squared_levers, rel=1e-9)
        assert known.length <= least.length * (1 + 1e-9)
    straight = LeastRoute.of_path(np.array([start, goal]))
    free = float(geodesic_cost(start, goal, goal, UNIT))
    assert least.squared_levers >= free * (1 - 1e-9)
    assert least.length >= straight.length * (1 - 1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_bound_and_route_meet_as_the_margin_shrinks(seed):
    world, start, goal = random_world(seed, 0.3)
    for by_length in (False, True):
        path = taut_route(world, start, goal, 0.001, by_length=by_length)
        if path is None:
            continue
        upper, lower = LeastRoute.of_path(path), least_route(world, start, goal, 0.001)
        assert upper[by_length] == pytest.approx(lower[by_length], rel=5e-3)
        assert lower[by_length] <= upper[by_length] * (1 + 1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_the_shortest_way_is_that_of_all_pairs_of_corners(seed):
    """Dijkstra's over the full visibility graph of the same polygons, by GEOS."""
    world, start, goal = random_world(seed + 100, 0.3)
    margin = 0.05
    free = shapely.simplify(shapely.buffer(world.free_parts[0], margin, quad_segs=2), 0.45 * margin)
    points = np.concatenate([[start], np.unique(shapely.get_coordinates(free), axis=0), [goal]])
    i, j = np.array(list(combinations(range(len(points)), 2))).T
    lines = shapely.linestrings(np.stack([points[i], points[j]], axis=1))
    seen = shapely.covers(shapely.buffer(free, 1e-9), lines)
    length = np.hypot(*(points[i] - points[j]).T)
    graph = csr_matrix((length[seen], (i[seen], j[seen])), shape=(len(points),) * 2)
    expected = csgraph.dijkstra(graph, directed=False, indices=0)[-1]
    assert least_route(world, start, goal, margin).length == pytest.approx(expected, rel=1e-6)


def test_round_one_corner_the_cone_is_measured_by_its_geodesics():
    """A slanting wall up to (5, 7): from (3.5, 6) to its end on a curve that bends to the goal, from there straight."""
    world = World.from_polygons([[(6.5, -1), (6.6, -1), (5.001, 7)]], bounds=(0, -1, 10, 10), robot_radius=0.0)
    start, goal, tip = np.array([3.5, 6.0]), np.array([8.0, 2.0]), np.array([5.001, 7.0])
    expected = float(geodesic_cost(start, tip, goal, UNIT) + geodesic_cost(tip, goal, goal, UNIT))
    least = least_route(world, start, goal, 1e-5).squared_levers
    assert expected * (1 - 1e-3) <= least <= expected * (1 + 1e-9)


def test_a_path_has_the_integrals_of_its_runs():
    path = np.array([(2.0, 2.0), (3.0, 8.0), (8.0, 2.0)])
    levers, length = LeastRoute.of_path(path)
    assert levers == pytest.approx(float(edge_cost(path[:-1], path[1:], path[-1], UNIT).sum()))
    assert LeastRoute(levers, length).cost([NOISE]) == pytest.approx(
        float(edge_cost(path[:-1], path[1:], path[-1], NOISE).sum())
    )


@pytest.mark.parametrize("noise", [NOISE, OdometryNoise(heading_var_per_m=3e-2, distance_var_per_m=2e-3)])
def test_no_route_found_is_below_the_bound_of_the_mean_square(noise):
    for seed in range(2):
        world, start, goal = random_world(seed + 200, 0.3)
        path = plan_route(world, start, goal, noise, iterations=2).path
        least = tight_least_route(world, path, noise)
        drift = predict_drift(path, noise).end
        heading_std = math.sqrt(noise.heading_var_per_m * LeastRoute.of_path(path).length)
        for bound in (least.mean_square([noise]), least.mean_square([noise], heading_std)):
            assert 0 < bound <= float(drift.rms) ** 2
        assert least.mean_square([noise]) <= least.mean_square([noise], heading_std) * (1 + 1e-12)
    assert least.mean_square([OdometryNoise(heading_bias_per_m=1e-3)]) == 0


def test_zones_count_with_the_best_of_them():
    good = OdometryNoise(heading_var_per_m=1e-5, distance_var_per_m=1e-4)
    world = World.from_polygons(
        [[(4, 0), (6, 0), (6, 7), (4, 7)]],
        bounds=(0, 0, 10, 10),
        robot_radius=0.5,
        zones=[Zone([(0, 8), (10, 8), (10, 10), (0, 10)], good)],
    )
    route = plan_route(world, (2, 2), (8, 2), NOISE, iterations=2)
    least = tight_least_route(world, route.path, NOISE)
    assert least.cost([NOISE, good]) < least.cost([NOISE])
    assert math.sqrt(least.mean_square([NOISE, good])) <= route.rms


def test_nowhere_to_go_and_no_way():
    here = np.array([2.0, 2.0])
    assert least_route(WALL, here, here, 0.05) == (0.0, 0.0)
    assert taut_route(WALL, here, here, 0.05) is None
    assert taut_route(WALL, here, np.array([8.0, 2.0]), 1.1) is None  # the passage above the wall is 2 m wide


@pytest.mark.parametrize(("name", "gap"), [("warehouse", 0.01), ("office", 0.02)])
@pytest.mark.slow
def test_on_the_bundled_maps_the_bound_is_near_the_route(name, gap):
    plain = load_world(bundled_map(name), robot_radius=0.3)
    world = World(obstacles=plain.obstacles, bounds=plain.bounds, robot_radius=0.3)
    rng, shares = np.random.default_rng(1), []
    room = world.free_parts[0]
    while len(shares) < 5:
        start, goal = rng.uniform(room.bounds[:2], room.bounds[2:], (2, 2))
        if not shapely.contains_xy(room, *np.array([start, goal]).T).all():
            continue
        path = plan_route(world, start, goal, NOISE, iterations=1).path
        best = min(
            LeastRoute.of_path(p).cost([NOISE]) for p in (path, taut_route(world, start, goal, 0.01)) if p is not None
        )
        shares.append(tight_least_route(world, path, NOISE).cost([NOISE]) / best)
    assert max(shares) <= 1 + 1e-9
    assert np.median(shares) > 1 - gap


def test_an_outline_that_would_take_longer_than_is_left_is_not_begun_and_one_that_is_known_is_used():
    world = World(obstacles=WALL.obstacles, bounds=WALL.bounds, robot_radius=WALL.robot_radius)
    ends, hurried = (np.array([2.0, 2.0]), np.array([8.0, 2.0])), {"left_s": lambda: 1e-6}
    assert least_route(world, *ends, 0.05, **hurried) == (6.0**3 / 3, 6.0)  # of the straight line
    assert taut_route(world, *ends, 0.05, **hurried) is None
    unhurried = least_route(world, *ends, 0.05), taut_route(world, *ends, 0.05)
    assert unhurried[0].length > 13
    assert least_route(world, *ends, 0.05, **hurried) == unhurried[0]
    np.testing.assert_array_equal(taut_route(world, *ends, 0.05, **hurried), unhurried[1])


def test_no_string_slips_through_an_obstacle_from_corner_to_corner():
    """The straight line enters and leaves the square at its corners, to the last bit; round it, it is 2 sqrt(34) m."""
    world = World.from_polygons([[(4, 4), (6, 4), (6, 6), (4, 6)]], bounds=(0, 0, 10, 10), robot_radius=0.0)
    bounds = [least_route(world, np.array([1.0, 1.0]), np.array([9.0, 9.0]), margin) for margin in (0.1, 0.04, 0.016)]
    for coarse, fine in pairwise(bounds):
        assert coarse.length < fine.length < 2 * np.sqrt(34)
        assert coarse.squared_levers < fine.squared_levers
    assert bounds[-1].length > 0.997 * 2 * np.sqrt(34)
