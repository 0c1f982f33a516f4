"""Twenty routes through a real depot, RFID tags of 0.1 m: few enough, proven, and verified tag by tag."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import shapely

from driftplan.beacons.beacon import BeaconKind
from driftplan.beacons.readings import beacon_fixes, drift_with_beacons
from driftplan.layouts.place import place_beacons
from driftplan.layouts.scenario import Sites
from driftplan.model.noise import OdometryNoise
from driftplan.model.simulation import simulate_drift
from driftplan.model.worst import worst_rms
from driftplan.planning.request import DriftLimit
from driftplan.world.mapfiles import load_world

DEPOT = Path(__file__).resolve().parents[2] / "../shared/data/nav2_depot/depot.yaml"
NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
TAG = BeaconKind.rfid(range_m=1.0, position_std_m=0.1)


@pytest.fixture(scope="module")
def depot():
    if not DEPOT.exists():
        pytest.skip("needs nav2_depot/depot.yaml in shared/data, made by others and not shipped")
    return load_world(DEPOT, robot_radius=0.25)


def routes_in(world, number, rng):
    """Routes of at least 25 m from random place to random place, as far as one can be seen from the other."""
    hall = max(getattr(world.free, "geoms", [world.free]), key=lambda part: part.area)
    routes = []
    while len(routes) < number:
        path = []
        while len(path) < 2 or shapely.LineString(path).length < 25:
            point = rng.uniform(hall.bounds[:2], hall.bounds[2:])
            if shapely.contains_xy(hall, *point) and (not path or world.segments_free(path[-1][None], point[None])[0]):
                path.append(point)
        routes.append(np.array(path))
    return routes


@pytest.mark.slow
def test_twenty_routes_through_a_depot(depot):
    routes, limit = routes_in(depot, 20, np.random.default_rng(4)), 0.5
    layout = place_beacons(depot, routes, NOISE, limit, Sites(TAG, spacing_m=1.0))
    sturdy = place_beacons(depot, routes, NOISE, DriftLimit(limit, redundancy=2), Sites(TAG, spacing_m=1.0))
    assert layout.proven
    assert sturdy.proven
    assert 3 < len(layout.beacons) < len(sturdy.beacons) < 60
    for path in routes:
        assert worst_rms(drift_with_beacons(path, NOISE, layout.beacons, depot)) <= limit * (1 + 1e-6)
        for alive in combinations(sturdy.beacons, len(sturdy.beacons) - 1):
            assert worst_rms(drift_with_beacons(path, NOISE, alive, depot)) <= limit * (1 + 1e-6)

    path = routes[int(np.argmax(layout.worst_drifts))]
    fixes = beacon_fixes(path, layout.beacons, depot)
    errors = simulate_drift(path, NOISE, runs=4000, rng=5, fixes=fixes, substep_m=0.25)
    square = (errors**2).sum(-1)
    assert (square.mean(0) <= limit**2 + 4 * square.std(0) / np.sqrt(len(square))).all()
