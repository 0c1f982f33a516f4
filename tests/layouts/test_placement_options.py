"""What users ask of place_beacons beyond the fewest: budgets, trade-offs, failures, other scores, words that help."""

import inspect
import pickle
import re

import numpy as np
import pytest
import shapely

from driftplan import DriftLimit, Sites, beacon_tradeoff, place_beacons
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.readings import beacon_passes, drift_with_beacons
from driftplan.errors import InfeasibleError, KeywordError
from driftplan.layouts.placement import covering, placement_diagnosis
from driftplan.layouts.placement.cover_bounds import Solution
from driftplan.layouts.scenario import SiteGroup, grid_sites, route_sites, wall_sites
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.model.worst import worst_radius, worst_rms
from driftplan.planning.request import format_least
from driftplan.planning.status import Status
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
TAG = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
SIGN = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01, line_of_sight=False)
ROUTE = np.array([(0, 0), (40, 0), (40, 20)], dtype=float)
ROUTES = [ROUTE, np.array([(40, 20), (0, 20), (0, 0)], dtype=float)]


class SomeRoute:
    path = ROUTE


# Modes


def test_the_least_drift_within_a_number_of_beacons_cannot_be_had_for_less():
    layout = place_beacons(None, ROUTES, NOISE, None, Sites(SIGN, spacing_m=4.0), max_beacons=3)
    assert len(layout.beacons) <= 3
    assert repr(layout).startswith(f"Layout({len(layout.beacons)} beacons of cost ")
    assert len(repr(layout)) < 150
    assert layout.proven
    assert layout.drift_bound <= layout.worst_drift <= layout.drift_bound / (1 - 0.005)
    assert layout.worst_drift == pytest.approx(max(worst_rms(d) for d in layout.drifts))
    just_below = 0.99 * layout.drift_bound
    assert len(place_beacons(None, ROUTES, NOISE, just_below, Sites(SIGN, spacing_m=4.0)).beacons) > 3
    again = place_beacons(None, ROUTES, NOISE, 1.001 * layout.worst_drift, Sites(SIGN, spacing_m=4.0))
    assert len(again.beacons) <= 3


def test_a_budget_counts_costs_not_beacons():
    sites = route_sites(ROUTES, 4.0)
    costs = np.where(np.arange(len(sites)) % 2 == 0, 5.0, 1.0)
    layout = place_beacons(None, ROUTES, NOISE, None, Sites(SIGN, sites, costs=costs), budget=4.0)
    assert layout.cost <= 4.0
    assert all(costs[int(b.id[1:]) - 1] == 1.0 for b in layout.beacons)


def test_the_trade_off_curve_falls_and_each_point_is_the_answer_for_its_limit():
    curve = beacon_tradeoff(None, ROUTE, NOISE, Sites(SIGN, spacing_m=4.0), max_beacons=4)
    counts, drifts = [len(x.beacons) for x in curve], [x.worst_drift for x in curve]
    assert counts[0] == 0
    assert counts == sorted(set(counts))
    assert drifts == sorted(drifts, reverse=True)
    for layout in curve:
        fewest = place_beacons(None, ROUTE, NOISE, layout.worst_drift * 1.0001, Sites(SIGN, spacing_m=4.0))
        assert len(fewest.beacons) == len(layout.beacons)


def test_without_need_no_beacon_is_placed():
    layout = place_beacons(None, ROUTE, NOISE, 100.0, SIGN)
    assert (layout.beacons, layout.cost, layout.lower_bound, layout.proven, layout.gap) == ((), 0.0, 0.0, True, 0.0)


@pytest.mark.parametrize("confidence", [None, 0.9])
def test_without_need_no_beacon_is_placed_for_the_others_to_die(confidence):
    layout = place_beacons(None, ROUTE, NOISE, DriftLimit(100.0, redundancy=3, confidence=confidence), SIGN)
    assert (layout.beacons, layout.proven) == ((), True)


def test_limits_may_differ_between_routes():
    strict, loose = 0.4, 100.0
    layout = place_beacons(None, ROUTES, NOISE, [strict, loose], Sites(SIGN, spacing_m=4.0))
    alone = place_beacons(None, ROUTES[0], NOISE, strict, Sites(SIGN, route_sites(ROUTES, 4.0)))
    assert len(layout.beacons) == len(alone.beacons)
    assert layout.worst_drifts[0] <= strict < layout.worst_drifts[1]


def test_routes_may_be_objects_with_a_path():
    one, other = (place_beacons(None, r, NOISE, 0.5, Sites(SIGN, spacing_m=4.0)) for r in (ROUTE, SomeRoute()))
    assert one.beacons == other.beacons


# Options


def test_with_redundancy_two_the_limit_survives_any_one_death_and_with_one_it_does_not():
    lean = place_beacons(None, ROUTES, NOISE, 0.8, Sites(SIGN, spacing_m=4.0))
    sturdy = place_beacons(None, ROUTES, NOISE, DriftLimit(0.8, redundancy=2), Sites(SIGN, spacing_m=4.0))
    assert len(sturdy.beacons) > len(lean.beacons)
    assert sturdy.proven
    assert max(x.worst_single_failure for x in sturdy.importance) <= 0.8
    assert max(x.worst_single_failure for x in lean.importance) > 0.8


def test_importance_says_what_each_death_does():
    layout = place_beacons(None, ROUTES, NOISE, 0.8, Sites(SIGN, spacing_m=4.0))
    for said in layout.importance:
        rest = [b for b in layout.beacons if b != said.beacon]
        worst = [worst_rms(drift_with_beacons(r, NOISE, rest)) for r in ROUTES]
        assert said.routes == tuple(k for k, r in enumerate(ROUTES) if len(beacon_passes(r, said.beacon)))
        assert said.worst_single_failure == pytest.approx(max(worst[k] for k in said.routes))


def test_existing_beacons_are_used_for_nothing():
    bare = place_beacons(None, ROUTE, NOISE, 0.6, Sites(SIGN, spacing_m=4.0))
    old = [Beacon(SIGN, 20.0, 0.0, "old")]
    helped = place_beacons(None, ROUTE, NOISE, 0.6, Sites(SIGN, spacing_m=4.0, existing=old))
    assert helped.existing == tuple(old)
    assert helped.cost < bare.cost
    assert "old" not in [b.id for b in helped.beacons]


def test_a_layout_can_be_extended_though_candidates_would_have_the_same_names():
    first = place_beacons(None, ROUTE, NOISE, 1.2, Sites(SIGN, spacing_m=4.0))
    more = place_beacons(None, ROUTE, NOISE, 0.5, Sites(SIGN, spacing_m=4.0, existing=first.beacons))
    ids = [b.id for b in (*more.existing, *more.beacons)]
    assert len(ids) == len(set(ids)) > len(first.beacons) > 0


def test_forbidden_areas_get_no_beacon_and_spacing_is_kept():
    forbidden = [shapely.box(10, -5, 30, 5), [(38, -2), (42, -2), (42, 2), (38, 2)]]
    layout = place_beacons(None, ROUTES, NOISE, 1.2, Sites(SIGN, spacing_m=2.0, forbidden=forbidden, min_spacing_m=9.0))
    points = shapely.points([b.xy for b in layout.beacons])
    assert not shapely.intersects(points, shapely.box(10, -5, 30, 5)).any()
    assert not shapely.intersects(points, shapely.box(38, -2, 42, 2)).any()
    distance = shapely.distance(points[:, None], points[None])
    assert distance[~np.eye(len(points), dtype=bool)].min() >= 9.0


def test_with_a_confidence_the_radius_keeps_the_limit_and_takes_more_beacons_than_the_rms():
    by_rms = place_beacons(None, ROUTE, NOISE, 0.8, Sites(SIGN, spacing_m=2.0))
    by_radius = place_beacons(None, ROUTE, NOISE, DriftLimit(0.8, confidence=0.95), Sites(SIGN, spacing_m=2.0))
    assert len(by_radius.beacons) > len(by_rms.beacons)
    assert worst_radius(by_radius.drifts[0], 0.95) <= 0.8 * (1 + 1e-5)
    assert by_radius.proven


def test_a_lost_start_needs_a_beacon_near_it():
    lost = Fix.full(0.0, position_std_m=1.0, heading_std=0.2)
    layout = place_beacons(None, ROUTE, NOISE, 0.8, Sites(SIGN, spacing_m=2.0), start_fix=lost)
    assert any(np.hypot(b.x, b.y) <= SIGN.range_m for b in layout.beacons)


def test_position_fixes_alone_cannot_hold_a_limit_for_ever_and_full_fixes_can():
    long = [(0, 0), (400, 0)]
    with pytest.raises(InfeasibleError, match="route 0, from"):
        place_beacons(None, long, NOISE, 0.4, Sites(TAG, spacing_m=4.0))
    assert place_beacons(None, long, NOISE, 0.4, Sites(SIGN, spacing_m=4.0)).proven


def test_kinds_may_be_mixed_and_the_dear_one_is_bought_where_it_pays():
    sign = BeaconKind.landmark(2.0, 0.05, 0.01, line_of_sight=False, cost=3.0)
    layout = place_beacons(None, [(0, 0), (120, 0)], NOISE, 0.7, Sites([TAG, sign], spacing_m=5.0))
    assert {b.kind.name for b in layout.beacons} == {"rfid", "landmark"}
    assert layout.cost == sum(b.kind.cost for b in layout.beacons)
    assert layout.proven


def test_in_a_world_candidates_are_free_and_in_reach_walls_hide_and_zones_count():
    rack = [(5, 3), (35, 3), (35, 7), (5, 7)]
    wet = Zone([(10, 0), (30, 0), (30, 3), (10, 3)], NOISE.scaled(5.0))
    dry, with_zone = (
        World.from_polygons([rack], bounds=(0, 0, 40, 10), robot_radius=0.4, zones=zones) for zones in ([], [wet])
    )
    routes = [np.array([(1, 1.5), (39, 1.5)]), np.array([(1, 8.5), (39, 8.5)])]
    seen = BeaconKind.landmark(9.0, 0.05, 0.01)
    layout = place_beacons(dry, routes, NOISE, 0.6, Sites(seen, spacing_m=2.0))
    assert dry.is_free([b.xy for b in layout.beacons]).all()
    assert layout.worst_drift <= 0.6
    through_walls = BeaconKind.landmark(9.0, 0.05, 0.01, line_of_sight=False)
    assert len(place_beacons(dry, routes, NOISE, 0.6, Sites(through_walls, spacing_m=2.0)).beacons) < len(
        layout.beacons
    )
    short = BeaconKind.landmark(2.5, 0.05, 0.01)
    plain, wetter = (place_beacons(w, routes, NOISE, 0.6, Sites(short, spacing_m=2.0)) for w in (dry, with_zone))
    assert len(wetter.beacons) > len(plain.beacons)


# Laws


def test_the_same_input_gives_the_same_layout_and_another_order_the_same_cost():
    sites = route_sites(ROUTES, 3.0)
    first, second, shuffled = (
        place_beacons(None, ROUTES, NOISE, 0.7, Sites(SIGN, c))
        for c in (sites, sites, np.random.default_rng(0).permutation(sites))
    )
    assert first.beacons == second.beacons
    assert first.cost == shuffled.cost


def test_no_beacon_of_a_layout_can_be_exchanged_for_one_listed_earlier():
    sites = route_sites(ROUTE[None], 4.0)
    layout = place_beacons(None, ROUTE, NOISE, 0.6, Sites(SIGN, sites))
    chosen = [int(b.id[1:]) - 1 for b in layout.beacons]
    for k in chosen:
        for earlier in set(range(k)) - set(chosen):
            other = [Beacon(SIGN, *sites[i]) for i in {*chosen, earlier} - {k}]
            assert drift_with_beacons(ROUTE, NOISE, other).profile().rms.max() > 0.6


def test_a_tighter_limit_never_costs_less_and_more_candidates_never_more():
    costs = [place_beacons(None, ROUTES, NOISE, limit, Sites(SIGN, spacing_m=4.0)).cost for limit in (0.4, 0.7, 1.2)]
    assert costs == sorted(costs, reverse=True)
    some = route_sites(ROUTES, 4.0)
    more = np.concatenate([some, some + np.array([0.0, 1.0])])
    few, many = (place_beacons(None, ROUTES, NOISE, 0.7, Sites(SIGN, c)).cost for c in (some, more))
    assert many <= few


def test_when_time_runs_out_in_the_solver_the_greedy_layout_comes_back_and_says_so(monkeypatch):
    monkeypatch.setattr(
        covering._CoverSearch, "_relaxed", lambda self, **_: Solution(None, 1.0, False)
    )  # never gets anywhere
    told = []
    layout = place_beacons(
        None, ROUTES, NOISE, 0.5, Sites(SIGN, spacing_m=4.0), time_limit=2.0, progress=lambda *x: told.append(x)
    )
    assert layout.status is Status.TIME_LIMIT
    assert not layout.proven
    assert layout.worst_drift <= 0.5
    assert layout.lower_bound == 1.0
    assert layout.gap == (layout.cost - 1.0) / layout.cost
    assert told[-1][1:] == (layout.cost, 1.0)


def test_without_any_layout_in_time_that_is_said(monkeypatch):
    monkeypatch.setattr(covering._CoverSearch, "_relaxed", lambda self, **_: Solution(None, 1.0, False))
    monkeypatch.setattr(covering._CoverSearch, "_complete", lambda self, start, lean=None: None)
    with pytest.raises(InfeasibleError, match="no layout was found in time"):
        place_beacons(None, ROUTES, NOISE, 0.5, Sites(SIGN, spacing_m=4.0), time_limit=0.5)


# When it cannot be done


def test_an_impossible_stretch_is_named_with_what_can_be_reached_and_who_comes_closest():
    sites = np.array([(0.0, 0.0), (5.0, 0.0), (38.0, 0.0)])  # nothing between 5 and 38 m
    with pytest.raises(InfeasibleError) as caught:
        place_beacons(None, [(0, 0), (40, 0)], NOISE, 0.5, Sites(SIGN, sites))
    said = str(caught.value)
    assert said.startswith("route 0, from ")
    assert caught.value.stretch is not None
    route, start, end = caught.value.stretch  # the same as data
    assert said.startswith(f"route {route}, from {start:.2f} m to {end:.2f} m: ")
    assert 7.0 < start < end == pytest.approx(36.0, abs=0.01)
    assert pickle.loads(pickle.dumps(caught.value)).stretch == caught.value.stretch  # of a search in another process
    best = drift_with_beacons([(0, 0), (36.0, 0)], NOISE, [Beacon(SIGN, 5.0, 0.0)]).end.rms
    assert f"the least that can be reached is {format_least(best)}" in said
    assert "closest sites: S2 at (5, 0), S1 at (0, 0)" in said


def test_a_radius_out_of_reach_is_told_beside_the_least_rms():
    with pytest.raises(InfeasibleError, match=r"keep the 90 % radius under 0\.2 m there, the least rms that can be"):
        place_beacons(None, ROUTE, NOISE, DriftLimit(0.2, confidence=0.9), Sites(SIGN, spacing_m=10.0))


def test_rules_that_forbid_every_layout_are_named_with_what_it_would_take_without_them():
    with pytest.raises(
        InfeasibleError, match=r"together with max_beacons=1; without them it takes 4 beacons of cost 4"
    ) as caught:
        place_beacons(None, ROUTES, NOISE, 0.9, Sites(SIGN, spacing_m=4.0), max_beacons=1)
    assert caught.value.stretch is None


def test_a_group_that_asks_for_more_than_it_has_is_named():
    with pytest.raises(InfeasibleError, match="group 0 demands more beacons than it has"):
        place_beacons(None, ROUTE, NOISE, 5.0, Sites(SIGN, groups=[SiteGroup([0, 1], at_least=3)]))


def test_bad_fix_of_its_own_is_no_help():
    vague = BeaconKind.landmark(2.0, 1.0, 0.01, line_of_sight=False)
    with pytest.raises(InfeasibleError, match="no sites keep the drift under"):
        place_beacons(None, ROUTE, NOISE, 0.5, vague)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "expected a limit: max_drift, or max_beacons or budget"),
        ({"max_drift": 0.0}, "expected max_drift finite and > 0 m, got 0.0"),
        ({"max_drift": float("nan")}, "expected max_drift finite"),
        ({"max_drift": [0.5, 0.5]}, r"one number or one per route \(1\), got shape \(2,\)"),
        ({"max_drift": 0.5, "kind": ()}, "expected kind: what beacons may be placed"),
        ({"max_drift": 0.5, "kind": "rfid"}, "expected kind to be a BeaconKind"),
        ({"max_drift": 0.5, "points": [(0, 0, 0)]}, r"expected points \(n, 2\)"),
        ({"max_drift": 0.5, "points": np.zeros((0, 2))}, "at least one site, got none"),
        ({"max_drift": 0.5, "points": [Beacon(TAG, 0, 0)]}, "with a kind of their own, got both"),
        ({"max_drift": 0.5, "kind": (), "points": [Beacon(TAG, 0, 0, "a"), Beacon(TAG, 1, 0, "a")]}, "'a' twice"),
        ({"max_drift": 0.5, "points": [(0, 0)], "costs": [0.0]}, "finite and > 0"),
        ({"max_drift": 0.5, "points": [(0, 0)], "costs": [1.0, 2.0]}, r"expected costs of shape \(1,\)"),
        ({"max_drift": 0.5, "costs": [1.0]}, "expected costs only together with points"),
        ({"max_drift": 0.5, "points": [(0, 0)], "spacing_m": 1.0}, "expected spacing_m only for generated"),
        ({"max_drift": 0.5, "spacing_m": -1.0}, "expected spacing_m > 0"),
        ({"max_drift": 0.5, "redundancy": 0}, "expected redundancy a whole number >= 1, got 0"),
        ({"max_drift": 0.5, "redundancy": 1.5}, "expected redundancy a whole number"),
        ({"max_drift": 0.5, "confidence": 0.5}, r"expected confidence in \[0.75, 1\)"),
        ({"max_drift": 0.5, "max_beacons": -1}, "expected max_beacons a whole number >= 0"),
        ({"max_drift": 0.5, "budget": float("inf")}, "expected budget finite"),
        ({"max_drift": 0.5, "min_spacing_m": -1.0}, "expected min_spacing_m >= 0"),
        (
            {"max_drift": 0.5, "groups": [SiteGroup(["nobody"])]},
            "group 0: expected members to be sites, got 'nobody'",
        ),
        ({"max_drift": 0.5, "existing": ["E"]}, "expected existing to be Beacon objects"),
        (
            {"max_drift": 0.5, "start_fix": Fix.position(3.0, position_std_m=1.0)},
            "expected start_fix to be a Fix at s_m=0",
        ),
        ({"max_drift": 0.5, "time_limit": 0}, "expected time_limit > 0"),
        ({"max_beacons": 2, "drift_tolerance": 1.5}, r"expected drift_tolerance in \(0, 1\)"),
    ],
)
def test_bad_input_is_refused_saying_what_was_expected(options, said):
    with pytest.raises(ValueError, match=said):
        asked(**{"kind": SIGN, **options})


def asked(**options):
    """The layout that options, limit and sites among them by the names of their fields, ask for."""
    limit, sites = (
        {name: options.pop(name) for name in inspect.signature(value).parameters if name in options}
        for value in (DriftLimit, Sites)
    )
    return place_beacons(None, ROUTE, NOISE, DriftLimit(**limit), Sites(**sites), **options)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: place_beacons(None, ROUTE, NOISE, 0.5, SIGN, timelimit=1), "keyword 'timelimit': did you mean time_l"),
        (lambda: place_beacons(None, ROUTE, NOISE, max_drift=0.5, kind=SIGN), r"mean limit=DriftLimit\(max_drift=…\)"),
        (lambda: place_beacons(None, ROUTE, NOISE, 0.5, SIGN, spacing=1), r"did you mean sites=Sites\(spacing_m=…\)"),
        (
            lambda: place_beacons(None, ROUTE, NOISE, 0.5, SIGN, xyz=1),
            "expected world, routes, noise, limit, sites",
        ),
        (lambda: beacon_tradeoff(None, ROUTE, NOISE, SIGN, most_beacons=3), "did you mean max_beacons"),
        (lambda: Sites(SIGN, spacing=1.0), "did you mean spacing_m"),
        (lambda: DriftLimit(0.5, redundance=2), "did you mean redundancy"),
    ],
)
def test_a_misspelt_keyword_is_answered_with_the_nearest(call, said):
    with pytest.raises(KeywordError, match=said):
        call()


@pytest.mark.parametrize(
    ("routes", "said"),
    [
        ([], "expected routes to be one path"),
        ("depot", "expected routes to be one path"),
        ([[(0, 0), (1, 0)], [(0, 0)]], "route 1: expected a path"),
        ([(0, 0), (1, float("inf"))], "finite coordinates"),
    ],
)
def test_bad_routes_are_refused(routes, said):
    with pytest.raises(ValueError, match=said):
        place_beacons(None, routes, NOISE, 0.5, SIGN)


def test_a_step_noise_is_refused_with_the_rates_to_use_instead():
    stepped = OdometryNoise.per_step(heading_std=0.01, distance_std=0.02, step_m=0.5)
    with pytest.raises(ValueError, match=r"OdometryNoise\(heading_var_per_m=0.0002, distance_var_per_m=0.0008\)"):
        place_beacons(None, ROUTE, stepped, 0.5, SIGN)


# Candidates


def test_candidates_are_where_they_should_be():
    rack = [(2, 2), (8, 2), (8, 4), (2, 4)]
    world = World.from_polygons([rack], bounds=(0, 0, 10, 6), robot_radius=0.4)
    grid = grid_sites(world, 0.5)
    assert world.is_free(grid).all()
    assert np.diff(np.unique(grid[:, 0])).min() == pytest.approx(0.5)
    walls = wall_sites(world, 0.7)
    assert np.allclose(shapely.distance(shapely.Polygon(rack).exterior, shapely.points(walls)), 0.0)
    assert 16 / 0.7 <= len(walls) <= 16 / 0.7 + 1
    on_routes = route_sites([ROUTE, ROUTE[::-1]], 5.0)
    assert len(on_routes) == len(np.unique(on_routes, axis=0)) == 13  # 60 m in steps of 5, once though driven twice
    kept = grid_sites(world, 0.5, forbidden=[shapely.box(0, 0, 5, 6)])
    assert 0 < len(kept) < len(grid)
    assert kept[:, 0].min() > 5


@pytest.mark.parametrize(("spacing_m", "limit"), [(10.0, 0.4), (12.0, 0.5)])
def test_where_sites_are_too_far_apart_the_next_spacing_to_try_is_told(spacing_m, limit):
    noise, tag = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0), BeaconKind.rfid(1.5, 0.1)
    with pytest.raises(InfeasibleError, match="m apart here: try") as told:
        place_beacons(None, [(0, 0), (48, 0)], noise, limit, Sites(tag, spacing_m=spacing_m))
    closer = float(re.search(r"try (\S+) m", str(told.value))[1])
    assert place_beacons(None, [(0, 0), (48, 0)], noise, limit, Sites(tag, spacing_m=closer)).worst_drift <= limit


def test_a_limit_below_what_a_tag_can_tell_is_explained_by_the_tag():
    noise, tag = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0), BeaconKind.rfid(1.5, 0.1)
    with pytest.raises(InfeasibleError, match=r"sqrt\(2\) x 0.1 = 0.141 m: take more accurate ones"):
        place_beacons(None, [(0, 0), (40, 0)], noise, 0.14, tag)


def test_a_grid_too_coarse_for_any_site_in_range_is_said_to_be_that():
    world = World.from_polygons([], bounds=(0, 0, 40, 40), robot_radius=0.5)
    with pytest.raises(ValueError, match=r"got none: none of the grid is .* in range of a route; a smaller spacing_m"):
        place_beacons(world, [(0.5, 0.5), (39.5, 0.5)], NOISE, 0.5, Sites(BeaconKind.rfid(1.5, 0.1), spacing_m=20.0))


def test_what_is_said_of_a_stretch_of_ever_so_many_pieces_takes_no_longer(monkeypatch):
    looked, nearest = [], placement_diagnosis._nearest
    monkeypatch.setattr(placement_diagnosis, "_nearest", lambda *of: looked.append(of) or nearest(*of))
    noise = OdometryNoise(heading_var_per_m=1e3, distance_var_per_m=2e-4)
    with pytest.raises(InfeasibleError, match=r"no sites keep the drift under 0\.3 m"):
        place_beacons(None, [[(0, 0), (8, 0)]], noise, 0.3, Sites(TAG, spacing_m=2.0))
    assert 1 <= len(looked) <= 51


def test_more_beacons_than_there_are_sites_are_no_limit():
    layout = place_beacons(None, ROUTES, NOISE, 1.0, Sites(SIGN, spacing_m=4.0), max_beacons=10**400)
    assert layout.proven
