"""Fewest beacons where systematic errors differ from one drive to the next: limits hold on average over drives."""

from functools import cache
from itertools import combinations

import numpy as np
import pytest

from driftplan import (
    BeaconKind,
    DriftLimit,
    InfeasibleError,
    OdometryNoise,
    Sites,
    beacon_tradeoff,
    drift_with_beacons,
    place_beacons,
)
from driftplan.model.worst import worst_rms

NOISE = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=5e-4, heading_bias_std_per_m=3e-3)
KINDS = (BeaconKind.rfid(2.0, 0.1), BeaconKind.landmark(2.0, 0.05, 0.01, line_of_sight=False))


def instance(seed):
    """Routes with a turn each, and sites along them."""
    rng = np.random.default_rng(seed)
    corner = rng.uniform(10, 20)
    routes = [np.array([(0, 0), (corner, 0), (corner, rng.uniform(5, 15))]), np.array([(corner, 0), (0, 0)])]
    points = [(rng.uniform(2, corner), 0.5) for _ in range(3)] + [(corner + 0.5, rng.uniform(1, 10)) for _ in range(2)]
    return routes, points, KINDS[seed % 2]


def worst_of(routes, beacons, redundancy=1):
    """By `drift_with_beacons`, with every set of dead beacons."""
    dead = [set(who) for number in range(redundancy) for who in combinations(range(len(beacons)), number)]
    alive = [tuple(b for k, b in enumerate(beacons) if k not in who) for who in dead]
    return max(worst_on(tuple(map(tuple, route)), some) for route in routes for some in alive)


@cache
def worst_on(route, beacons):
    return worst_rms(drift_with_beacons(np.array(route), NOISE, beacons))


@pytest.mark.parametrize(("seed", "redundancy"), [(0, 1), (1, 1), (2, 1), (3, 1), (0, 2)])
def test_the_limit_holds_on_average_and_the_bound_is_no_lie(seed, redundancy):
    routes, points, kind = instance(seed)
    bare = worst_of(routes, [])
    limit = (0.75 if redundancy == 2 else 0.55) * bare
    asked = DriftLimit(limit, redundancy=redundancy)
    everyone = Sites(kind, points=points).listed(None, routes).new
    sets = [some for number in range(len(points) + 1) for some in combinations(everyone, number)]
    fewest = next((len(some) for some in sets if worst_of(routes, some, redundancy) <= limit), None)
    try:
        layout = place_beacons(None, routes, NOISE, asked, Sites(kind, points=points))
    except InfeasibleError:
        assert fewest is None or redundancy == 2  # an infeasibility under tightened limits is not called proven
        return
    assert worst_of(routes, layout.beacons, redundancy) <= limit * (1 + 1e-6)
    assert layout.lower_bound <= fewest <= len(layout.beacons)
    assert not layout.proven or len(layout.beacons) == fewest


def test_the_least_drift_within_a_number_is_that_over_all_drives():
    routes, points, kind = instance(1)
    curve = beacon_tradeoff(None, routes, NOISE, Sites(kind, points=points), max_beacons=1)
    assert len(curve) == 2
    for layout in curve:
        assert layout.worst_drift == pytest.approx(worst_of(routes, layout.beacons))
        assert layout.drift_bound <= layout.worst_drift


def test_a_filter_has_to_estimate_how_the_drive_differs():
    routes, points, kind = instance(3)
    limit, sites = 0.45, Sites(kind, points=points)
    layout = place_beacons(None, routes, NOISE, limit, sites, estimator="filter")
    drifts = [drift_with_beacons(route, NOISE, layout.beacons, estimator="filter") for route in routes]
    assert max(map(worst_rms, drifts)) <= limit * (1 + 1e-6)
    known = place_beacons(None, routes, NOISE.on_drive((0, 0, 0)), limit, sites, estimator="filter")
    assert known.cost == layout.lower_bound < layout.cost
