"""Searches of a roadmap against all of its simple paths: the additive one, the exact one, and the bounds they prove.

The oracle lists every simple path of small random roadmaps and prices it by `predict_drift`.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from driftplan.model.noise import OdometryNoise
from driftplan.planning.roadmap.exact_cost import identity, run_maps, turn_maps
from driftplan.planning.roadmap.exact_polish import ExactJudge
from driftplan.planning.roadmap.exact_roadmap import (
    additive_bound,
    bracketed,
    exactly_best,
    probably_best,
    search_graph,
)
from driftplan.planning.roadmap.exact_search import _Search, least_exact_cost
from driftplan.planning.roadmap.graph import GOAL, START, Roadmap
from driftplan.planning.roadmap.polish import AdditiveJudge, polished, refined
from driftplan.planning.roadmap.prices import Pricing, exact_drift, turn_angles
from driftplan.world.world import World
from driftplan.world.zones import Zone

KINDS = ("heading", "turning", "systematic", "steps")
PLAIN = KINDS[:2]
ANYWHERE = np.zeros(0, dtype=np.int64)  # remember no node: paths may cross themselves
ROUND_OFF = 1e-9


def random_noise(kind, rng):
    """From headings that are hardly off to headings that are off by more than a radian."""
    rate = 10 ** rng.uniform(-3, 0.5)
    if kind == "heading":
        return OdometryNoise(heading_var_per_m=rate)
    if kind == "turning":
        return OdometryNoise(
            heading_var_per_m=rate,
            distance_var_per_m=10 ** rng.uniform(-3, 0),
            lateral_var_per_m=1e-3,
            heading_var_per_rad=10 ** rng.uniform(-3, 0),
            distance_var_per_rad=1e-3,
        )
    if kind == "systematic":
        return OdometryNoise(
            heading_var_per_m=rate,
            distance_var_per_m=1e-2,
            heading_bias_per_m=0.05,
            heading_bias_per_rad=0.02,
            distance_scale_error=0.02,
            heading_distance_corr=0.3,
        )
    return OdometryNoise.per_step(heading_std=min(rate, 1.0) ** 0.5, distance_std=0.1, step_m=0.7)


@dataclass
class Case:
    """A random roadmap without obstacles, and what its simple paths cost."""

    roadmap: Roadmap
    noise: OdometryNoise
    paths: list
    additive: np.ndarray
    exact: np.ndarray
    heading_var: np.ndarray


@cache
def random_case(kind, seed, nodes=6):
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    noise = random_noise(kind, rng)
    zones = []
    if rng.random() < 0.4:
        corners = [(3, -20), (6, -20), (6, 20), (3, 20)]
        zones = [Zone(corners, OdometryNoise(heading_var_per_m=10 ** rng.uniform(-2, 1), heading_var_per_rad=0.1))]
    world = World.from_polygons([], bounds=(-50, -50, 50, 50), robot_radius=0.1, zones=zones)
    heading = rng.uniform(-3, 3) if rng.random() < 0.5 else None
    points = rng.uniform(-5, 8, (nodes, 2))
    roadmap = Roadmap(Pricing(world, points[GOAL], noise), points[START], heading)
    roadmap.add(points[2:], nodes, math.inf)
    kept = rng.random(len(roadmap.edges)) < 0.6
    kept[0] = True  # the straight run, so that there is a path
    roadmap.edges, roadmap.prices = roadmap.edges[kept], roadmap.prices.pick(kept)
    paths = simple_paths(nodes, roadmap.edges.tolist())
    ends = [exact_drift(world, roadmap.xy[path], noise, heading).end for path in paths]
    return Case(
        roadmap,
        noise,
        paths,
        np.array([roadmap.pricing.path(roadmap.xy[path], heading) for path in paths]),
        np.array([float(end.rms) ** 2 for end in ends]),
        np.array([float(end.heading_std) ** 2 for end in ends]),
    )


def simple_paths(nodes, edges):
    """Every path from START to GOAL that visits no node twice."""
    neighbours = [set() for _ in range(nodes)]
    for i, j in edges:
        neighbours[i].add(j)
        neighbours[j].add(i)
    found = []

    def extend(path):
        if path[-1] == GOAL:
            found.append(path)
            return
        for following in sorted(neighbours[path[-1]] - set(path)):
            extend([*path, following])

    extend([START])
    return found


# The exact cost


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("zoned", [False, True])
def test_prepending_leg_by_leg_gives_what_predict_drift_gives(kind, zoned):
    rng = np.random.default_rng(5)
    noise = random_noise(kind, rng)
    wet = Zone([(3, -20), (6, -20), (6, 20), (3, 20)], OdometryNoise(heading_var_per_m=0.05, heading_var_per_rad=0.02))
    world = World.from_polygons([], bounds=(-50, -50, 50, 50), robot_radius=0.1, zones=[wet] if zoned else [])
    path = rng.normal(0, 5, (7, 2))
    pieces = world.zone_pieces(path[:-1], path[1:])
    leaving = pieces.zone[np.searchsorted(pieces.segment, np.arange(6))]
    step = np.diff(path @ [1, 1j])
    facing = np.concatenate([[np.exp(0.7j)], step[:-1] / np.abs(step[:-1])])
    runs = run_maps(world, noise, path[-1], path[:-1], path[1:])
    turns = turn_maps(world, noise, path[-1], path[:-1], facing, turn_angles(path, 0.7), leaving)
    mean_square, bias, whole = np.zeros(1), np.zeros(1, complex), identity(1)
    for k in reversed(range(6)):
        mean_square, bias = runs.pick([k])(mean_square, bias)
        mean_square, bias = turns.pick([k])(mean_square, bias)
    for k in range(6):
        whole = whole.after(turns.pick([k])).after(runs.pick([k]))
    end = exact_drift(world, path, noise, 0.7).end
    # The same numbers by another order of operations: round-off of sums of a dozen terms of one size.
    assert mean_square[0] == pytest.approx(float(end.rms) ** 2, rel=1e-10)
    np.testing.assert_allclose([-bias[0].real, -bias[0].imag], end.bias, rtol=1e-9)
    np.testing.assert_allclose(whole.gain, mean_square, rtol=1e-9)
    np.testing.assert_allclose(whole.shift, bias, rtol=1e-9)


# Searches against the list of all simple paths


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(8))
def test_the_additive_search_finds_the_cheapest_path_turns_and_zones_included(kind, seed):
    case = random_case(kind, seed)
    found = case.roadmap.shortest()
    assert found.cost == pytest.approx(case.additive.min(), rel=1e-9)
    assert found.nodes.tolist() == case.paths[case.additive.argmin()]
    # What is left out for being dearer than a limit does not change the answer.
    assert case.roadmap.shortest(found.cost * 1.01).nodes.tolist() == found.nodes.tolist()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(8))
def test_the_exact_search_finds_the_best_of_all_simple_paths(kind, seed):
    case = random_case(kind, seed)
    found = least_exact_cost(search_graph(case.roadmap, case.noise, math.inf), gap=0.0)
    assert found.finished
    assert found.cost == pytest.approx(case.exact.min(), rel=ROUND_OFF)
    assert found.bound == pytest.approx(case.exact.min(), rel=ROUND_OFF)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("times", [1.0, 4.0, math.inf])
@pytest.mark.parametrize("memory", [None, ANYWHERE], ids=["simple", "crossing"])
def test_no_bound_is_above_the_best_path_it_covers(kind, seed, times, memory):
    case = random_case(kind, seed)
    known = float(case.exact[case.additive.argmin()])
    most = times * case.heading_var[case.exact.argmin()]
    # Systematic errors and steps know no limit on heading variance; otherwise only paths below it are covered.
    covered = case.exact[case.heading_var <= most * (1 + ROUND_OFF)] if kind in PLAIN else case.exact
    graph = search_graph(case.roadmap, case.noise, most, known)
    for gap, labels in ((1e-3, 1000), (0.2, 1000), (1e-3, 5)):  # the last one is stopped early
        found = least_exact_cost(graph, upper=known, gap=gap, memory=memory, most_labels=labels)
        assert found.bound <= covered.min() * (1 + ROUND_OFF)
        if found.finished:
            assert found.bound >= found.cost - gap * known * (1 + ROUND_OFF)


# Where headings are lost by a radian or more a bound that is a little too bold, or a label dropped without reason, can
# lose the best path. In most random roadmaps it does not; in each of these it does for one of the facts the search
# rests on.
LOST = [("heading", 36), ("turning", 20), ("turning", 34), ("turning", 39), ("turning", 40)]


@pytest.mark.parametrize(("kind", "seed"), LOST)
@pytest.mark.parametrize("memory", [None, ANYWHERE], ids=["simple", "crossing"])
def test_every_fact_the_search_rests_on_is_needed(kind, seed, memory):
    case = random_case(kind, seed)
    for most in (math.inf, float(case.heading_var[case.exact.argmin()])):
        covered = case.exact[case.heading_var <= most * (1 + ROUND_OFF)].min()
        most *= 1 + 1e-5  # the variance of a heading that is lost altogether comes from the logarithm of a tiny number
        graph = search_graph(case.roadmap, case.noise, most)
        found = least_exact_cost(graph, gap=0.0, memory=memory, most_labels=1500)
        assert found.bound <= covered * (1 + ROUND_OFF)
        if memory is None:
            assert found.finished
            assert found.cost <= covered * (1 + ROUND_OFF)


@pytest.mark.parametrize("seed", range(30))
def test_what_follows_a_label_costs_and_pulls_no_less_than_the_search_believes(seed):
    case = random_case("heading", seed)
    graph = search_graph(case.roadmap, case.noise, 1.001 * float(case.heading_var.max()))
    if graph.source != START:  # with turn noise in a zone states are edges
        return
    judge = ExactJudge(case.roadmap.pricing.space, case.noise, case.roadmap.xy[GOAL], None)
    for path, cost in zip(case.paths, case.exact, strict=True):
        search = _Search(graph, float(cost) * (1 + ROUND_OFF), 0.0, None)
        gains, levers = judge._beginnings(case.roadmap.xy[path])
        _, biases = judge._ends(case.roadmap.xy[path])
        for node, gain, lever, bias in list(zip(path, gains, levers, biases, strict=True))[1:-1]:
            assert search.bound(node, gain, abs(lever)) <= cost * (1 + ROUND_OFF)
            assert 2 * abs(bias) <= search.reach(node, gain, abs(lever)) * (1 + ROUND_OFF)


def test_a_label_does_not_stand_for_one_that_can_still_go_where_it_has_been():
    """Far from the goal a strip loses the heading, near it a floor adds some noise, which is welcome: a heading that is
    wrong for certain is worse than one that is only uncertain. So going round a loop there pays. From v the way leads
    on through x only. Reaching v by way of x is the better beginning, but no simple path goes on from there.
    """
    strip = Zone([(15, -9), (19, -9), (19, 9), (15, 9)], OdometryNoise(heading_var_per_m=2.0))
    floor = Zone([(-1, -9), (3, -9), (3, 9), (-1, 9)], OdometryNoise(heading_var_per_m=0.02))
    world = World.from_polygons([], bounds=(-30, -30, 30, 30), robot_radius=0.1, zones=[strip, floor])
    noise = OdometryNoise(heading_var_per_m=1e-6)
    roadmap = Roadmap(Pricing(world, np.array([0.0, 0.0]), noise), np.array([20.0, 0.0]))
    x, v = 2, 3
    roadmap.add(np.array([[2.9, 0.1], [2.9, -1.0]]), 4, math.inf)
    usable = np.isin(roadmap.edges @ [10, 1], [2, 3, 23, 12])  # all but those from v and the start to the goal
    roadmap.edges, roadmap.prices = roadmap.edges[usable], roadmap.prices.pick(usable)

    def cost(*path):
        return float(exact_drift(world, roadmap.xy[list(path)], noise).end.rms) ** 2

    assert cost(START, x, v, x, GOAL) < cost(START, v, x, GOAL) < cost(START, x, GOAL)
    heading_var = float(exact_drift(world, roadmap.xy[[START, v, x, GOAL]], noise).end.heading_std) ** 2
    found = least_exact_cost(
        search_graph(roadmap, noise, 1.001 * heading_var), upper=cost(START, x, GOAL) * 1.0001, gap=0.0
    )
    assert found.states.tolist() == [START, v, x, GOAL]


@pytest.mark.parametrize("kind", PLAIN)
@pytest.mark.parametrize("seed", range(8))
def test_what_the_additive_cost_proves_is_below_the_best_path(kind, seed):
    case = random_case(kind, seed)
    assert additive_bound(case.roadmap, case.noise, 0.0, math.inf) <= case.exact.min()
    middle = float(np.median(case.heading_var))
    few = case.heading_var <= middle
    assert additive_bound(case.roadmap, case.noise, 0.0, middle) <= case.exact[few].min()
    assert additive_bound(case.roadmap, case.noise, middle, math.inf) <= case.exact[~few].min(initial=math.inf)
    bound = bracketed(case.roadmap, case.noise, case.heading_var[case.exact.argmin()] ** 0.5)
    covered = case.heading_var <= bound.heading_std**2 * (1 + ROUND_OFF)
    assert 0 < bound.mean_square <= case.exact[covered].min()


def test_noise_that_the_additive_cost_cannot_price_gets_no_bound_from_it():
    case = random_case("systematic", 0)
    assert additive_bound(case.roadmap, case.noise, 0.0, 1.0) == 0.0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(6))
def test_the_best_simple_path_is_returned_even_where_circling_would_pay(kind, seed):
    case = random_case(kind, seed)
    known = float(case.exact.max()) * 1.01
    path, bound, finished = exactly_best(case.roadmap, case.noise, known, case.heading_var.max() ** 0.5)
    assert finished
    assert path is not None
    heading = case.roadmap.start_heading
    cost = float(exact_drift(case.roadmap.pricing.space, path, case.noise, heading).end.rms) ** 2
    assert len(np.unique(path, axis=0)) == len(path)
    assert cost <= case.exact.min() + 1e-3 * known
    assert bound.mean_square <= case.exact.min() * (1 + ROUND_OFF)
    assert bound.heading_std == math.inf or kind in PLAIN


def test_the_additive_cost_misleads_where_headings_are_lost_and_the_exact_search_does_not():
    """Two ways to the goal. One crosses a strip that loses the heading altogether: J grows without end there, while
    E|e|² cannot exceed twice the square of the lever, plus what was before. The other takes a floor of middling noise.
    """
    strip = Zone([(11, -1), (12, -1), (12, 1), (11, 1)], OdometryNoise(heading_var_per_m=12.0))
    floor = Zone([(-1, 2), (21, 2), (21, 9), (-1, 9)], OdometryNoise(heading_var_per_m=0.12))
    world = World.from_polygons([], bounds=(-5, -5, 25, 25), robot_radius=0.1, zones=[strip, floor])
    noise = OdometryNoise(heading_var_per_m=1e-3)
    roadmap = Roadmap(Pricing(world, np.array([20.0, 0.0]), noise), np.array([0.0, 0.0]))
    roadmap.add(np.array([[0.0, 5.0], [20.0, 5.0]]), 4, math.inf)
    usable = np.isin(roadmap.edges @ [10, 1], [1, 2, 23, 13])  # no diagonals
    roadmap.edges, roadmap.prices = roadmap.edges[usable], roadmap.prices.pick(usable)
    direct, round_about = [START, GOAL], [START, 2, 3, GOAL]
    additive = [roadmap.pricing.path(roadmap.xy[path]) for path in (direct, round_about)]
    ends = [exact_drift(world, roadmap.xy[path], noise).end for path in (direct, round_about)]
    exact = [float(end.rms) ** 2 for end in ends]
    assert min(float(end.heading_std) for end in ends) > 1.0
    assert additive[0] > 1.5 * additive[1]  # by the additive cost the detour is far better,
    assert exact[0] < 0.8 * exact[1]  # in truth far worse
    assert roadmap.shortest().nodes.tolist() == round_about
    np.testing.assert_array_equal(probably_best(roadmap, noise), roadmap.xy[direct])
    path, bound, finished = exactly_best(roadmap, noise, exact[1], float(ends[1].heading_std))
    np.testing.assert_array_equal(path, roadmap.xy[direct])
    assert finished
    assert bound.mean_square == pytest.approx(exact[0], rel=1e-2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(6))
def test_the_quick_path_by_the_exact_cost_is_a_path_and_near_the_best(kind, seed):
    case = random_case(kind, seed)
    path = probably_best(case.roadmap, case.noise)
    assert path is not None
    np.testing.assert_array_equal(path[[0, -1]], case.roadmap.xy[[START, GOAL]])
    assert len(np.unique(path, axis=0)) == len(path)
    pairs = {frozenset(map(tuple, case.roadmap.xy[edge].tolist())) for edge in case.roadmap.edges}
    assert all(frozenset(map(tuple, leg.tolist())) in pairs for leg in np.stack([path[:-1], path[1:]], axis=1))
    cost = float(exact_drift(case.roadmap.pricing.space, path, case.noise, case.roadmap.start_heading).end.rms) ** 2
    assert case.exact.min() * (1 - 1e-9) <= cost <= 1.5 * case.exact.min()


# Polishing


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_judges_foresee_what_a_moved_waypoint_changes(kind, seed):
    case = random_case(kind, seed)
    space, heading = case.roadmap.pricing.space, case.roadmap.start_heading
    path = case.roadmap.xy[[START, *range(2, 6), GOAL]]
    exactly = ExactJudge(space, case.noise, path[-1], heading)
    additively = AdditiveJudge(case.roadmap.pricing, heading)
    rng = np.random.default_rng(seed)
    for moved in range(1, 5):
        tried = path[moved] + rng.normal(0, 1, (3, 2))
        others = np.repeat(path[None], 3, axis=0)
        others[:, moved] = tried
        foreseen = exactly.prices(path, np.full(3, moved), tried)
        np.testing.assert_allclose(foreseen, [exactly.price(other) for other in others], rtol=1e-9)
        foreseen = additively.prices(path, np.full(3, moved), tried)
        prices = np.array([additively.price(other) for other in others])
        np.testing.assert_allclose(np.diff(foreseen), np.diff(prices), rtol=1e-7, atol=1e-9 * prices.max())


@pytest.mark.parametrize("kind", PLAIN)
def test_polishing_keeps_the_ends_stays_free_and_never_costs_more(kind):
    world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    noise = random_noise(kind, np.random.default_rng(1))
    rough = np.array([(2, 2), (1, 5), (3, 7), (3, 9), (7, 8), (8, 6), (7, 4), (8, 2)], dtype=float)
    assert world.segments_free(rough[:-1], rough[1:]).all()
    pricing = Pricing(world, rough[-1], noise)
    judge = ExactJudge(world, noise, rough[-1], None)
    by_cost, by_drift = polished(pricing, rough), refined(judge, world, rough)
    for smooth in (by_cost, by_drift):
        np.testing.assert_array_equal(smooth[[0, -1]], rough[[0, -1]])
        assert world.segments_free(smooth[:-1], smooth[1:]).all()
    assert pricing.path(by_cost) < 0.9 * pricing.path(rough)
    assert judge.price(by_drift) < 0.9 * judge.price(rough)
    # A polished path is as good as polished: twice is hardly better than once (0.1 % is left to the tolerances).
    assert pricing.path(polished(pricing, by_cost)) > pricing.path(by_cost) * (1 - 1e-2)
