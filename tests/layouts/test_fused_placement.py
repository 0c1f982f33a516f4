"""Placement for robots that fuse: what the requirements are made of, against the prediction and a real filter."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import shapely

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.readings import beacon_fixes
from driftplan.errors import InfeasibleError
from driftplan.layouts.place import beacon_tradeoff, place_beacons
from driftplan.layouts.placement.fused_requirements import FusedRequirements
from driftplan.layouts.placement.fused_routes import NEVER, fused_routes
from driftplan.layouts.scenario import Scenario, Sites
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.model.simulation import simulate_drift
from driftplan.model.worst import worst_rms
from driftplan.planning.request import DriftLimit

NAMES = ["tags", "perfect", "two full", "mixed", "with compass", "unsure", "everything"]
NAMES += ["ranges", "lights", "seen from in front"]
NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
TAG = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)


def scenario_of(instance, start_fix=None):
    return Scenario.of(
        None, instance.paths, instance.noise, DriftLimit(1.0, redundancy=instance.redundancy), start_fix, "filter"
    )


def fused(instance):
    scenario = scenario_of(instance)
    return fused_routes(scenario, scenario.readings(instance.sites))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [600, pytest.param(601, marks=pytest.mark.slow)])
def test_the_greatest_drift_of_a_set_of_sites_is_that_of_the_prediction(name, seed, one_of_them):
    instance, start_fix = one_of_them(name, seed), Fix.full(0.0, position_std_m=0.2, heading_std=0.03)
    scenario, rng = scenario_of(instance, start_fix), np.random.default_rng(seed)
    routes = fused_routes(scenario, scenario.readings(instance.sites))
    for _ in range(6):
        chosen = set(np.flatnonzero(rng.random(len(instance.sites)) < 0.5).tolist())
        for r, route in enumerate(routes):
            worst = worst_rms(scenario.drift(r, [instance.sites[i] for i in sorted(chosen)]))
            assert route.worst(chosen) == pytest.approx(worst, rel=1e-9)
            assert route.breach(chosen, worst**2 * (1 + 1e-6)) == NEVER
            border = route.breach(chosen, worst**2 * (1 - 1e-6))
            arriving = route.arriving(route.read(route.start, 0, chosen), 0, border, chosen)
            assert arriving.trace > worst**2 * (1 - 1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [610, pytest.param(611, marks=pytest.mark.slow)])
def test_a_site_more_never_hurts(name, seed, one_of_them):
    instance = one_of_them(name, seed)
    for route in fused(instance):
        worst = {s: route.worst(set(instance.members(s))) for s in range(2 ** len(instance.sites))}
        for s, drift in worst.items():
            for i in range(len(instance.sites)):
                assert worst[s | 1 << i] <= drift * (1 + 1e-9)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [620, pytest.param(621, marks=pytest.mark.slow)])
def test_every_cut_is_kept_by_every_layout_that_holds_and_missed_by_the_one_asked_about(name, seed, one_of_them):
    instance = replace(one_of_them(name, seed), estimator="filter")
    routes, limits = fused(instance), [instance.limit] * len(instance.paths)
    requirements, n = FusedRequirements(routes, limits, instance.redundancy), len(instance.sites)
    layouts = np.array([[s >> i & 1 for i in range(n)] for s in range(2**n)], dtype=bool)
    good = layouts[[instance.acceptable(s) for s in range(2**n)]]
    found = [(None, cut) for cut in requirements.rows()]
    for y in (np.zeros(n), *np.random.default_rng(seed).uniform(0, 0.5, (3, n))):
        beyond = requirements.cuts_beyond(y)
        assert all(y[cut.columns] @ cut.weights < cut.least for cut in beyond)
        found += [(None, cut) for cut in beyond]
    for chosen in layouts:
        cuts = requirements.cuts(chosen)
        assert bool(cuts) == (not any((chosen == other).all() for other in good))
        found += [(chosen, cut) for cut in cuts]
    for chosen, cut in found:
        assert (good[:, cut.columns] @ cut.weights >= cut.least - 1e-9).all()
        assert chosen is None or chosen[cut.columns] @ cut.weights < cut.least


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_real_filter_keeps_the_limit_with_the_layout(seed):
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.uniform(-15, 15, (6, 2)), axis=0)
    layout = place_beacons(None, path, NOISE, 0.5, Sites(TAG, spacing_m=2.0), estimator="filter")
    assert layout.proven
    fixes = beacon_fixes(path, layout.beacons)
    line = shapely.LineString(path)
    corners = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    just_before = [fix.s_m - 0.01 for fix in fixes if fix.s_m > 0.01]  # where the drift is greatest
    stops = np.unique(np.concatenate([corners, just_before, np.arange(0.0, line.length, 2.0)]))
    points = shapely.get_coordinates(shapely.line_interpolate_point(line, stops))
    errors = simulate_drift(points, NOISE, fixes=fixes, estimator="filter", runs=2000, rng=rng)
    rms = np.sqrt((errors**2).sum(axis=-1).mean(axis=0))
    assert 0.45 < rms.max() <= 0.5 * 1.03


def test_a_fusing_robot_needs_fewer_and_what_holds_with_resets_holds_for_it():
    path = [(0, 0), (60, 0), (60, 30)]
    reset = place_beacons(None, path, NOISE, 0.5, Sites(TAG, spacing_m=2.0))
    fused = place_beacons(None, path, NOISE, 0.5, Sites(TAG, spacing_m=2.0), estimator="filter")
    assert fused.proven
    assert len(fused.beacons) < len(reset.beacons)
    scenario = replace(reset.scenario, estimator="filter")
    assert scenario.worst(scenario.drift(0, reset.beacons)) <= 0.5


def test_the_trade_off_falls_and_is_that_of_brute_force():
    path = np.array([(0.0, 0.0), (40.0, 0.0)])
    curve = beacon_tradeoff(None, path, NOISE, Sites(TAG, spacing_m=4.0), max_beacons=3, estimator="filter")
    sites = [Beacon(TAG, x, 0.0) for x in np.arange(0.0, 41.0, 4.0)]
    (route,) = fused_routes(curve[0].scenario, curve[0].scenario.readings(sites))
    for layout in curve:
        least = min(route.worst(set(some)) for some in combinations(range(len(sites)), len(layout.beacons)))
        assert least * (1 - 1e-9) <= layout.worst_drift <= least * 1.006


def test_what_cannot_be_held_is_told_with_the_stretch_and_the_least_drift():
    sites = [Beacon(TAG, x, 0.0, f"s{x:g}") for x in (5.0, 50.0)]
    with pytest.raises(
        InfeasibleError, match=r"route 0, from [12][0-9.]+ m to 4[0-9.]+ m.*least that can be reached.*s5 at \(5, 0\)"
    ):
        place_beacons(None, [(0, 0), (60, 0)], NOISE, 0.8, Sites(points=sites), estimator="filter")
    with pytest.raises(InfeasibleError, match=r"with any 1 dead"):
        place_beacons(
            None, [(0, 0), (60, 0)], NOISE, DriftLimit(1.2, redundancy=2), Sites(points=sites), estimator="filter"
        )


@pytest.mark.parametrize(
    ("noise", "limit", "what"),
    [
        (replace(NOISE, heading_bias_per_m=1e-3), 0.5, "systematic error"),
        (NOISE, DriftLimit(0.5, confidence=0.9), "confidence only for"),
    ],
)
def test_what_a_filter_cannot_promise_is_refused(noise, limit, what):
    with pytest.raises(ValueError, match=what):
        place_beacons(None, [(0, 0), (20, 0)], noise, limit, Sites(TAG, spacing_m=2.0), estimator="filter")


def test_under_reset_it_is_said_what_a_fusing_robot_would_have():
    layout = place_beacons(None, [(0, 0), (60, 0)], NOISE, 0.6, Sites(TAG, spacing_m=2.0))
    scenario = replace(layout.scenario, estimator="filter")
    fused = worst_rms(scenario.drift(0, layout.beacons))
    assert layout.worst_drift_if_fused == pytest.approx(fused)
    assert f"at most {fused:.3g} m" in layout.note
    assert place_beacons(None, [(0, 0), (60, 0)], NOISE, 0.6, Sites(TAG, spacing_m=2.0), estimator="filter").note == ""
    sites = [Beacon(TAG, x, 0.0) for x in np.arange(0.0, 61.0, 10.0)]
    with pytest.raises(InfeasibleError, match=r'a robot that fuses its readings keeps the limit.*estimator="filter"'):
        place_beacons(None, [(0, 0), (60, 0)], NOISE, 0.4, Sites(points=sites))
    with pytest.raises(InfeasibleError, match=r"nor can a robot that fuses its readings"):
        place_beacons(None, [(0, 0), (60, 0)], NOISE, 0.1, Sites(points=sites))


def test_where_the_heading_is_too_uncertain_for_a_filter_the_layout_says_so():
    rough = OdometryNoise.from_std(heading_deg=20.0, distance_m=0.05, after_m=10.0)
    sites = [Beacon(TAG, x, 0.0) for x in (0.0, 20.0)]
    layout = place_beacons(None, [(0, 0), (30, 0)], rough, 8.0, Sites(points=sites), estimator="filter")
    assert "On 1 of 1 routes, the first of them route 0" in layout.note


@pytest.mark.parametrize("seed", range(640, 642))
def test_the_layout_that_the_search_starts_from_holds_wherever_one_does(seed, one_of_them):
    instance = replace(one_of_them("mixed", seed), estimator="filter", redundancy=1)
    limits, n = [instance.limit] * len(instance.paths), len(instance.sites)
    requirements = FusedRequirements(fused(instance), limits)
    start = requirements.driven_along(np.zeros(n, dtype=bool))
    assert (not requirements.cuts(start)) == instance.acceptable(2**n - 1)
