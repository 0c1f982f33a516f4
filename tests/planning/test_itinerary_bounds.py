"""Bounds of itineraries: below every path that there is; and the search against every simple path of small roadmaps."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.model.noise import OdometryNoise
from driftplan.planning.bounds import least_end_drift, least_length, least_worst_drift
from driftplan.planning.request import Reliance
from driftplan.planning.roadmap import beacon_walks
from driftplan.planning.roadmap.beacon_search import BeaconSearch
from driftplan.planning.roadmap.graph import Roadmap
from driftplan.planning.roadmap.itinerary_check import ItineraryCheck
from driftplan.planning.roadmap.prices import AdditiveCost, length_of
from driftplan.world.world import World
from driftplan.world.zones import Zone

HALL = World.from_polygons([], bounds=(0, 0, 40, 40), robot_radius=0.1)
TAG = BeaconKind.rfid(range_m=2.0, position_std_m=0.1)
SIGN = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
RADIO = BeaconKind.range_only(range_m=5.0, range_std_m=0.1)
KINDS = [
    TAG,
    SIGN,
    BeaconKind.heading(range_m=4.0, heading_std=0.02),
    BeaconKind.rfid(range_m=3.0, position_std_m=0.2, detection_probability=0.7),
]
NOISES = [
    OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0),
    OdometryNoise(heading_var_per_m=1e-2, distance_var_per_m=1e-3, heading_var_per_rad=1e-3),
    OdometryNoise(heading_var_per_m=1e-3, heading_bias_per_m=0.01, distance_scale_error=0.02),
    OdometryNoise(distance_var_per_m=1e-2, lateral_var_per_m=1e-3),
]
coordinate = st.floats(1, 39).map(lambda x: round(x, 3))
point = st.tuples(coordinate, coordinate)


@settings(deadline=None, max_examples=60)
@given(
    st.lists(point, min_size=2, max_size=6, unique=True),
    st.lists(st.tuples(st.sampled_from(KINDS), point), max_size=5),
    st.sampled_from(NOISES),
    st.booleans(),
    st.booleans(),
)
def test_no_path_is_better_than_the_bounds(path, placed, noise, zoned, fuses):
    path = np.array(path)
    if np.linalg.norm(path[0] - path[-1]) < 1e-6:
        return
    zones = [Zone([(5, 5), (20, 5), (20, 20), (5, 20)], noise.scaled(0.5))] if zoned else []
    world = World.from_polygons([], bounds=(0, 0, 40, 40), robot_radius=0.1, zones=zones)
    beacons = tuple(Beacon(RADIO if fuses and kind is SIGN else kind, *xy) for kind, xy in placed)
    reliance = Reliance(beacons=beacons, min_capture=0.0, estimator="filter" if fuses else "reset")
    verdict = ItineraryCheck(world, noise, reliance).verdict(path)
    given_ = path[[0, -1]], (noise, *(zone.noise for zone in zones)), reliance.bounding
    assert least_length(*given_, verdict.worst * (1 + 1e-9)) <= length_of(path) * (1 + 1e-9)
    # told of a worse one, so that this path and not the one found is what bounds it
    assert least_end_drift(*given_, 2 * verdict.end + 1.0) <= verdict.end * (1 + 1e-9)
    assert least_worst_drift(*given_, 2 * verdict.worst + 1.0) <= verdict.worst * (1 + 1e-9)


def test_chains_of_ranges_are_refuelling_stations():
    ends = np.array([(0.0, 0.0), (30.0, 0.0)])
    noise = OdometryNoise(distance_var_per_m=0.01)  # 1 m² after 100 m: 10 m take 0.316 m
    beacons = [Beacon(BeaconKind.rfid(range_m=1.0, position_std_m=0.0), x, 3.0) for x in (9.0, 20.0)]
    hops = np.hypot(9.0, 3.0) - 1, 11.0 - 2, np.hypot(10.0, 3.0) - 1
    least = least_worst_drift(ends, [noise], beacons, 1.0)
    assert least == pytest.approx(math.sqrt(0.01 * max(hops)))
    assert least_length(ends, [noise], beacons, least * 1.001) == pytest.approx(30.0)  # the straight line is longer
    assert least_length(ends, [noise], beacons, least * 0.999) == math.inf
    assert least_end_drift(ends, [noise], beacons, 1.0) == pytest.approx(math.sqrt(0.01 * hops[2]))


def test_a_bound_is_attained_where_the_last_reading_is_not_perfect():
    path, noise = np.array([(0.0, 0.0), (30.0, 0.0)]), OdometryNoise(distance_var_per_m=0.01)
    beacons = (Beacon(BeaconKind.rfid(range_m=1.0, position_std_m=0.2), 20.0, 0.0),)
    arrives = ItineraryCheck(HALL, noise, Reliance(beacons=beacons, min_capture=0.0)).verdict(path).end
    assert arrives == pytest.approx(math.sqrt(2 * 0.2**2 + 0.01 * 9.0))
    assert least_end_drift(path, [noise], beacons, 1.0) == pytest.approx(arrives)


# The search, against every simple path of a small roadmap, by the exact model


@pytest.fixture
def small_roadmap(monkeypatch):
    """Makes the search use a roadmap of so many random nodes, every node joined to the nearest five."""

    def use(count, seed):
        def roadmap(space, world, ends, noise, beacons, *, known, longest, max_nodes, seed=seed):
            found = Roadmap(AdditiveCost(space, ends[1], noise, "length"), ends[0])
            rng = np.random.default_rng(seed)
            points = np.concatenate([[b.xy for b in beacons], rng.uniform(2, 38, (count - len(beacons), 2))])
            found.add(points, 5, math.inf)
            return found

        monkeypatch.setattr(beacon_walks, "roadmap_among_beacons", roadmap)
        monkeypatch.setattr(BeaconSearch, "_grown", lambda self, cost: self.ends)  # the hall is empty

    return use


def simple_paths(roadmap):
    """All paths from start to goal that pass no node twice."""
    near = {k: set() for k in range(len(roadmap.xy))}
    for a, b in roadmap.edges.tolist():
        near[a].add(b)
        near[b].add(a)
    stack = [(0,)]
    while stack:
        nodes = stack.pop()
        if nodes[-1] == 1:
            yield roadmap.xy[list(nodes)]
            continue
        stack += [(*nodes, k) for k in near[nodes[-1]] if k not in nodes]


EVERY_KIND = [(TAG, "reset"), (SIGN, "reset"), (TAG, "filter"), (RADIO, "filter")]


@pytest.mark.parametrize(
    ("seed", "kind", "estimator"),
    [
        *[(0, *of) for of in EVERY_KIND[::3]],
        *[pytest.param(0, *of, marks=pytest.mark.slow) for of in EVERY_KIND[1:3]],
        *[pytest.param(k, *of, marks=pytest.mark.slow) for k in range(1, 8) for of in EVERY_KIND],
    ],
)
def test_every_objective_finds_what_enumeration_finds_or_better(small_roadmap, seed, kind, estimator):
    rng = np.random.default_rng(100 + seed)
    small_roadmap(7, seed)
    ends = np.array([(3.0, 3.0), (37.0, 37.0)])
    beacons = tuple(Beacon(kind, *xy) for xy in rng.uniform(8, 32, (3, 2)))
    reliance = Reliance(beacons=beacons, min_capture=0.0, estimator=estimator)
    search = BeaconSearch(HALL, HALL, ends, NOISES[0], reliance, seed=seed)
    search.graph(0.0)
    check, longest = search.check, 2.0 * length_of(ends)
    scored = []
    for path in simple_paths(search.roadmap):
        if length_of(path) <= longest:
            verdict = check.verdict(path)
            scored.append((length_of(path), verdict.end, verdict.worst))
    scored = np.array(scored)
    assert len(scored) > 5
    for limit in (math.inf, *np.quantile(scored[:, 2], (0.5, 0.1))):
        fitting = scored[scored[:, 2] <= limit * (1 + 1e-9)]
        limit *= 1.01  # readings on edges are spaced a little differently from those on whole paths
        found = [
            search.shortest_within(limit, longest),
            search.least_end_drift(limit, longest),
            search.least_worst_drift(limit, longest),
        ]
        verdicts = [check.verdict(path) for path in found]
        assert all(v.worst <= limit * (1 + 1e-9) for v in verdicts)
        assert all(length_of(path) <= longest * (1 + 1e-9) for path in found)
        # Labels are dropped for a slack of 1.5 % of the square of the limit, of the worst drift where there is none
        slack = 0.015 * min(limit, check.verdict(ends).worst) ** 2
        assert length_of(found[0]) <= fitting[:, 0].min() * (1 + 1e-9)
        assert verdicts[1].end ** 2 <= fitting[:, 1].min() ** 2 * (1 + 1e-9) + slack
        assert verdicts[2].worst <= fitting[:, 2].min() * 1.02
        bound = least_length(ends, search.noises, reliance.bounding, None if limit == math.inf else limit)
        assert bound <= length_of(found[0])
