"""co_design: never dearer than shortest routes and then beacons, as cheap as brute force, and safe by Monte Carlo."""

import inspect
import itertools
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from driftplan import Sites
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.readings import beacon_fixes, drift_with_beacons
from driftplan.errors import GoalError, InfeasibleError, NoPathError, StartError
from driftplan.layouts.co_design.co_design import co_design
from driftplan.layouts.co_design.design import Trip
from driftplan.layouts.place import place_beacons
from driftplan.layouts.scenario import SiteGroup
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.model.simulation import simulate_drift
from driftplan.planning.request import DriftLimit, Reliance
from driftplan.planning.roadmap.beacon_search import BeaconSearch
from driftplan.planning.status import Status
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
SIGN = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01, cost=100.0)
SHELVES = [[(8, y), (32, y), (32, y + 4), (8, y + 4)] for y in (4, 12)]
WORLD = World.from_polygons(SHELVES, bounds=(0, 0, 40, 20), robot_radius=0.5)
AISLES = (2.0, 10.0, 18.0)
TRIPS = [Trip((2, 2), (38, 2)), Trip((2, 10), (38, 10), 2.0), Trip((2, 18), (38, 18))]
LIMIT = 1.2
LONG = {"max_nodes": 120, "time_limit": 600.0}  # a clock that never decides


def greatest(path, beacons, noise=NOISE, world=WORLD, fixes=()):
    return float(drift_with_beacons(path, noise, beacons, world, fixes=fixes).profile(0.1).rms.max())


def designed(trips=TRIPS, limit=LIMIT, min_capture=0.0, **options):
    """All readings count, unless asked otherwise, as in brute force."""
    allowed = {key: options.pop(key) for key in inspect.signature(Sites).parameters if key in options}
    sites = Sites(**{"kind": SIGN, **({} if "points" in allowed else {"spacing_m": 4.0}), **allowed})
    limit = replace(DriftLimit.of(limit), min_capture=min_capture)
    return co_design(WORLD, trips, NOISE, limit, sites, **{"price_per_m": 1.0, **LONG, **options})


@cache
def design_of(trips=3, price_per_m=1.0, rounds=10):
    """Some of the trips with nothing special: made once for several tests."""
    return designed(TRIPS[:trips], price_per_m=price_per_m, rounds=rounds)


# Laws


@pytest.mark.slow
@pytest.mark.parametrize("price", [0.2, 50.0])
def test_it_is_never_dearer_than_shortest_routes_and_then_beacons(price):
    found = design_of(price_per_m=price)
    shortest = [
        BeaconSearch(WORLD, WORLD, np.array([trip.start, trip.goal]), NOISE, Reliance(), max_nodes=120).shortest
        for trip in TRIPS
    ]
    layout = place_beacons(WORLD, shortest, NOISE, LIMIT, Sites(SIGN, spacing_m=4.0))
    assert layout.proven
    driven = sum(
        t.weight * np.linalg.norm(np.diff(p, axis=0), axis=1).sum() for t, p in zip(TRIPS, shortest, strict=True)
    )
    assert found.baseline.cost == pytest.approx(layout.cost + price * driven)
    assert found.cost <= found.baseline.cost
    assert found.gain == pytest.approx(found.baseline.cost - found.cost)
    assert found.cost == pytest.approx(
        100 * len(found.beacons) + price * sum(t.weight * n for t, n in zip(TRIPS, found.lengths, strict=True))
    )
    assert list(found.history) == sorted(found.history, reverse=True)
    assert found.status is Status.LOCAL_OPTIMUM


@pytest.mark.slow
def test_the_cheaper_driving_is_the_fewer_beacons_are_worth_their_price():
    beacons = [len(design_of(price_per_m=price).beacons) for price in (0.2, 50.0)]
    assert beacons[0] < beacons[1] == 3


@pytest.mark.slow
def test_every_route_keeps_the_limit_by_the_exact_model_and_is_free():
    found = design_of()
    assert len(found.beacons) < len(found.baseline.beacons)
    for trip, path, route in zip(found.trips, found.paths, found.routes, strict=True):
        assert greatest(path, found.beacons) <= LIMIT * (1 + 1e-6)
        assert WORLD.segments_free(path[:-1], path[1:]).all()
        assert (tuple(path[0]), tuple(path[-1])) == (trip.start, trip.goal)
        assert route.path is path
        assert route.worst_drift == pytest.approx(greatest(path, found.beacons), rel=1e-3)
    assert [drift.length for drift in found.layout.drifts] == pytest.approx(found.lengths)


@pytest.mark.slow
def test_with_any_one_beacon_dead_the_limit_still_holds():
    found = designed(TRIPS[:2], limit=DriftLimit(1.5, redundancy=2))
    for path in found.paths:
        for dead in found.beacons:
            assert greatest(path, [b for b in found.beacons if b is not dead]) <= 1.5 * (1 + 1e-6)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_design():
    first, second = design_of(2), designed(TRIPS[:2])
    assert [b.id for b in first.beacons] == [b.id for b in second.beacons]
    for a, b in zip(first.paths, second.paths, strict=True):
        np.testing.assert_array_equal(a, b)


def test_no_route_is_looked_for_twice(monkeypatch):
    asked, look = [], BeaconSearch.shortest_within

    def shortest_within(self, limit, longest, *, thorough=True):
        asked.append((self.ends.tobytes(), self.beacons, limit, longest))
        return look(self, limit, longest, thorough=thorough)

    monkeypatch.setattr(BeaconSearch, "shortest_within", shortest_within)
    co_design(WORLD, TRIPS, NOISE, LIMIT, Sites(SIGN, spacing_m=4.0), price_per_m=1.0, max_nodes=40, time_limit=600.0)
    assert len(asked) == len(set(asked)) > 10


def test_a_robot_that_fuses_needs_no_more_and_keeps_the_limit():
    tag = BeaconKind.rfid(range_m=2.0, position_std_m=0.05, cost=100.0)
    reset, fused = (designed(kind=tag, rounds=0, estimator=estimator) for estimator in ("reset", "filter"))
    assert fused.baseline.layout.proven
    assert len(fused.baseline.beacons) <= len(reset.baseline.beacons)
    assert fused.cost <= fused.baseline.cost
    for path, route in zip(fused.paths, fused.routes, strict=True):
        drift = drift_with_beacons(path, NOISE, fused.beacons, WORLD, estimator="filter")
        assert drift.profile(0.1).rms.max() <= LIMIT * (1 + 1e-6)
        np.testing.assert_allclose(route.drift.end.rms, drift.end.rms, rtol=1e-9)


def test_beacons_that_are_there_already_are_used_for_nothing():
    there = [Beacon(SIGN, 20, 10, id="old")]
    found = designed(TRIPS[:2], existing=there)
    assert "old" not in {b.id for b in found.beacons}
    assert found.beacon_cost < design_of(2).beacon_cost
    assert any(there[0] in route.beacons for route in found.routes)


def test_no_beacons_go_where_they_are_forbidden():
    forbidden = [[(12, 0), (28, 0), (28, 11), (12, 11)]]
    found = designed(TRIPS[:1], forbidden=forbidden, limit=1.6, rounds=1)
    assert found.beacons
    assert all(not (12 < b.x < 28 and b.y < 11) for b in found.beacons)


def test_no_rounds_are_the_baseline():
    found = design_of(rounds=0)
    assert list(found.to_pandas()["length_m"]) == list(found.lengths)
    assert "chosen together" in found._repr_html_()
    assert found.status is Status.ROUNDS_DONE
    assert found.cost == found.baseline.cost
    assert found.tried == 0


def test_where_the_shortest_routes_cannot_be_held_others_are_found():
    candidates = np.array([(x, y) for x in (12.0, 20.0, 28.0) for y in (10.0, 18.0)])
    found = designed(TRIPS[:1], limit=0.8, points=candidates, max_detour=1.6)
    assert found.baseline is None
    assert found.gain == math.inf
    assert greatest(found.paths[0], found.beacons) <= 0.8 * (1 + 1e-6)
    assert "No layout keeps the limit on the shortest routes" in str(found)


def test_an_uncertain_start_is_taken_into_account():
    unsure = Fix.full(0.0, position_std_m=0.3, heading_std=0.12)
    found = designed(TRIPS[:1], start_fix=unsure)
    assert len(found.beacons) > len(design_of(1).beacons)
    assert greatest(found.paths[0], found.beacons, fixes=[unsure]) <= LIMIT * (1 + 1e-6)


@pytest.mark.parametrize("min_capture", [0.0, 0.9])
def test_the_limit_holds_without_readings_less_sure_than_asked(min_capture):
    aside, on_route = (20.0, 3.8), (20.0, 2.0)  # a robot that has drifted passes the one out of its range
    points, costs = [aside, on_route], [100.0, 150.0]
    found = designed(TRIPS[:1], points=points, costs=costs, min_capture=min_capture, max_detour=1.0)
    assert found.beacon_cost == (100.0 if min_capture == 0 else 150.0)
    (chance,) = found.routes[0].captures
    assert (chance.probability >= 0.9) == (min_capture > 0)
    assert found.routes[0].worst_drift <= LIMIT


def test_where_no_reading_is_sure_enough_that_is_said():
    with pytest.raises(InfeasibleError, match=r"trip 0: no route no longer than .* at least 0\.9 sure"):
        designed(TRIPS[:1], points=[(20.0, 3.8)], min_capture=0.9, max_detour=1.0)


def test_limits_groups_and_spacing_of_sites_hold_in_designs_too():
    sites = np.array([(x, y) for y in AISLES[:2] for x in (14.0, 20.0, 26.0)])
    options = {"points": sites, "price_per_m": 50.0, "rounds": 1}
    plain = designed(TRIPS[:2], [LIMIT, 5.0], **options)
    assert all(b.y == 2 for b in plain.beacons)
    assert len(plain.beacons) == 1
    forced = designed(
        TRIPS[:2], [LIMIT, 5.0], groups=[SiteGroup([4], at_least=1), SiteGroup(["S2"], at_most=0)], **options
    )
    assert "S5" in {b.id for b in forced.beacons}
    assert "S2" not in {b.id for b in forced.beacons}
    tight = designed(TRIPS[:1], 0.5, min_spacing_m=10.0, **options)
    places = np.array([b.xy for b in tight.beacons])
    assert len(places) > 1
    assert np.ptp(places[:, 0]) >= 10.0


# Oracles


def brute_force(trips, limit, candidates, price):
    """Least cost over all sets of beacons, each trip by the shortest route that keeps the limit among them."""
    beacons = [Beacon(SIGN, x, y) for x, y in candidates]
    best = math.inf
    for size in range(len(beacons) + 1):
        for chosen in itertools.combinations(beacons, size):
            cost = 100.0 * size
            for trip in trips:
                if cost < best:
                    ends = np.array([trip.start, trip.goal])
                    search = BeaconSearch(
                        WORLD, WORLD, ends, NOISE, Reliance(beacons=tuple(chosen), min_capture=0.0), max_nodes=120
                    )
                    path = search.shortest_within(
                        limit, 1.5 * np.linalg.norm(np.diff(search.shortest, axis=0), axis=1).sum()
                    )
                    cost += (
                        math.inf
                        if path is None
                        else price * trip.weight * np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
                    )
            best = min(best, cost)
    return best


@pytest.mark.parametrize(
    ("seed", "abreast"), [(0, 1), *(pytest.param(seed, 2, marks=pytest.mark.slow) for seed in range(7))]
)
def test_tiny_instances_cost_what_brute_force_finds(seed, abreast):
    rng = np.random.default_rng(seed)
    trips = [Trip((2, float(a)), (38, float(b)), float(rng.integers(1, 4))) for a, b in rng.choice(AISLES, (2, 2))]
    candidates = np.array([(x, y) for y in AISLES for x in (14.0, 26.0)]) + rng.uniform(-1, 1, (6, 2))
    candidates = candidates[:: 3 - abreast]
    price = float(rng.uniform(0.5, 6.0))
    limit = float(rng.uniform(0.9, 1.5))
    least = brute_force(trips, limit, candidates, price)
    if least == math.inf:
        with pytest.raises(InfeasibleError):
            designed(trips, limit, points=candidates, price_per_m=price)
        return
    found = designed(trips, limit, points=candidates, price_per_m=price)
    # shortening stops at local optima: lengths agree to within a few per mille
    assert found.cost == pytest.approx(least, rel=3e-3)


def test_robots_that_drive_the_routes_drift_as_predicted():
    found = design_of(2)
    for path, drift in zip(found.paths, found.layout.drifts, strict=True):
        fixes = beacon_fixes(path, found.beacons, WORLD)
        errors = simulate_drift(path, NOISE, runs=5_000, fixes=fixes, rng=7)
        square = (errors**2).sum(axis=2)
        mean, std = square.mean(axis=0), square.std(axis=0, ddof=1) / np.sqrt(len(errors))
        np.testing.assert_array_less(np.abs(mean - drift.at(drift_of(path)).rms ** 2), 4.5 * std + 1e-12)


def drift_of(path):
    """Driven distance at every waypoint, metres."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])


# Refusals


def test_a_trip_that_nothing_can_hold_is_named():
    with pytest.raises(InfeasibleError, match=r"trip 1 \(far\): no route .* even with beacons at all"):
        designed(
            [TRIPS[0], Trip((2, 18), (38, 18), name="far")],
            limit=1.0,
            points=[(20.0, 2.0)],
            max_detour=1.0,
        )


def test_ends_that_cannot_be_reached_name_the_trip():
    wall = [(19, 0), (21, 0), (21, 20), (19, 20)]
    parted = World.from_polygons([wall], bounds=(0, 0, 40, 20), robot_radius=0.5)
    asked = {"price_per_m": 1.0}
    for world, ends, error in (
        (WORLD, ((10, 6), (38, 2)), StartError),
        (WORLD, ((2, 2), (10, 6)), GoalError),
        (parted, ((2, 2), (38, 2)), NoPathError),
        (WORLD, ((2, 2), (2, 2)), ValueError),
    ):
        with pytest.raises(error, match=r"^trip 1: "):
            co_design(world, [((2, 3), (2, 5)), ends], NOISE, LIMIT, SIGN, **asked)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"trips": []}, "trips to be a sequence"),
        ({"trips": [((0, 0),)]}, "trip 0: expected a Trip or"),
        ({"trips": [((2, 2), (38, 2), -1.0)]}, "weight > 0"),
        ({"trips": [((2, 2), (38, float("nan")))]}, "finite"),
        ({"limit": -1.0}, "max_drift finite and > 0"),
        ({"price_per_m": 0.0}, "price_per_m > 0"),
        ({"kind": "tag"}, "kind to be a BeaconKind"),
        ({"points": [(1.0, 2.0, 3.0)]}, "points \\(n, 2\\)"),
        ({"points": [(1.0, 2.0)], "spacing_m": 1.0}, "spacing_m only for generated"),
        ({"forbidden": [[(0, 0), (40, 0), (40, 20), (0, 20)]]}, "at least one site"),
        ({"limit": DriftLimit(1.0, redundancy=3)}, "redundancy"),
        ({"limit": DriftLimit(1.0, confidence=0.9)}, "without a confidence"),
        ({"limit": DriftLimit()}, "expected a limit"),
        ({"max_detour": 0.5}, "max_detour >= 1"),
        ({"rounds": -1}, "rounds"),
        ({"time_limit": 0.0}, "time_limit > 0"),
        ({"existing": ["A"]}, "Beacon objects"),
    ],
)
def test_input_that_makes_no_sense_is_refused(change, said):
    with pytest.raises(ValueError, match=said):
        designed(**change)


def test_a_clock_that_runs_out_is_said_and_the_design_still_holds():
    found = designed(time_limit=1e-3)
    assert found.status is Status.TIME_LIMIT
    assert found.cost == found.baseline.cost
    assert all(greatest(path, found.beacons) <= LIMIT * (1 + 1e-6) for path in found.paths)
