"""The search of a roadmap against all of its simple paths.

The oracle lists every simple path of small random roadmaps and prices it.
"""

import itertools
import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from driftplan.model.noise import OdometryNoise
from driftplan.planning.roadmap.graph import GOAL, START, Roadmap
from driftplan.planning.roadmap.polish import AdditivePathCost, polished, without_needless
from driftplan.planning.roadmap.prices import AdditiveCost
from driftplan.world.world import World
from driftplan.world.zones import Zone

KINDS = ("heading", "turning", "systematic", "steps")
PLAIN = KINDS[:2]


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
    roadmap = Roadmap(AdditiveCost(world, points[GOAL], noise), points[START], heading)
    roadmap.add(points[2:], nodes, math.inf)
    kept = rng.random(len(roadmap.edges)) < 0.6
    kept[0] = True  # the straight run, so that there is a path
    roadmap.edges, roadmap.prices = roadmap.edges[kept], roadmap.prices.pick(kept)
    paths = simple_paths(nodes, roadmap.edges.tolist())
    prices = np.array([roadmap.pricing.path(roadmap.xy[path], heading) for path in paths])
    return Case(roadmap, noise, paths, prices)


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


# Polishing


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_the_judge_foresees_what_a_moved_waypoint_changes(kind, seed):
    case = random_case(kind, seed)
    path = case.roadmap.xy[[START, *range(2, 6), GOAL]]
    additively = AdditivePathCost(case.roadmap.pricing, case.roadmap.start_heading)
    rng = np.random.default_rng(seed)
    for moved in range(1, 5):
        tried = path[moved] + rng.normal(0, 1, (3, 2))
        others = np.repeat(path[None], 3, axis=0)
        others[:, moved] = tried
        foreseen = additively.prices(path, np.full(3, moved), tried)
        prices = np.array([additively.price(other) for other in others])
        np.testing.assert_allclose(np.diff(foreseen), np.diff(prices), rtol=1e-7, atol=1e-9 * prices.max())


@pytest.mark.parametrize("kind", PLAIN)
def test_polishing_keeps_the_ends_stays_free_and_never_costs_more(kind):
    world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    noise = random_noise(kind, np.random.default_rng(1))
    rough = np.array([(2, 2), (1, 5), (3, 7), (3, 9), (7, 8), (8, 6), (7, 4), (8, 2)], dtype=float)
    assert world.segments_free(rough[:-1], rough[1:]).all()
    pricing = AdditiveCost(world, rough[-1], noise)
    smooth = polished(pricing, rough)
    swept = []
    polished(pricing, rough, tell=swept.append)
    looks = itertools.count()
    cut_short = polished(pricing, rough, stop=lambda: next(looks) == 2)  # after two sweeps
    np.testing.assert_array_equal(cut_short, without_needless(pricing, swept[1]))
    prices = [pricing.path(path) for path in swept]
    assert prices == sorted(prices, reverse=True)
    np.testing.assert_array_equal(smooth[[0, -1]], rough[[0, -1]])
    assert world.segments_free(smooth[:-1], smooth[1:]).all()
    assert pricing.path(smooth) < 0.9 * pricing.path(rough)
    # A polished path is as good as polished: twice is hardly better than once (0.1 % is left to the tolerances).
    assert pricing.path(polished(pricing, smooth)) > pricing.path(smooth) * (1 - 1e-2)
