"""Drives over route tables: their drift is that of predict_drift, and the bound between breakpoints is a bound."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.readings import drift_with_beacons
from driftplan.layouts.placement.drives import KEPT, Limit, drives_of, first_breach, worst_squares
from driftplan.layouts.placement.problem import LimitSearch, placement_problem
from driftplan.layouts.placement.route_table import IntervalMoments
from driftplan.layouts.scenario import Scenario, Sites
from driftplan.model.drift import predict_drift
from driftplan.model.moments import Moments, compose
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.model.worst import worst_radius, worst_rms
from driftplan.planning.request import DriftLimit

NOISE = OdometryNoise(
    heading_var_per_m=1e-3,
    distance_var_per_m=2e-3,
    lateral_var_per_m=5e-4,
    heading_var_per_rad=2e-3,
    distance_var_per_rad=1e-3,
)
SYSTEMATIC = OdometryNoise(
    heading_var_per_m=2e-3,
    distance_var_per_m=1e-3,
    heading_bias_per_m=0.01,
    heading_bias_per_rad=0.02,
    distance_scale_error=0.03,
    heading_distance_corr=0.6,
)
CIRCLING = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-5, heading_bias_per_m=0.5)
WILD = OdometryNoise(heading_var_per_m=1.0, distance_var_per_m=1e-3)
PATH = np.array([(0, 0), (12, 3), (12, 3), (15, -6), (4, -6), (12, 3), (20, 9)], dtype=float)
SIGN = BeaconKind.landmark(2.0, 0.1, 0.05, line_of_sight=False)
TAG = BeaconKind.rfid(1.5, 0.1)
SITES = [Beacon(TAG, 5, 1), Beacon(SIGN, 12, 2), Beacon(TAG, 14, -4), Beacon(SIGN, 8, -6), Beacon(TAG, 18, 8)]


def table_of(noise, sites=SITES, limit=0.5, path=PATH):
    problem = placement_problem(Scenario.of(None, path, noise, DriftLimit()), Sites(points=sites))
    needs = LimitSearch.of(problem, limit, np.inf).requirements([limit])
    return needs.table, needs


@pytest.mark.parametrize("noise", [NOISE, SYSTEMATIC, WILD])
def test_the_pieces_of_a_track_make_up_the_route(noise):
    table, _ = table_of(noise)
    whole = table.segments[np.intp(0)]
    for k in range(1, len(table.length)):
        whole = compose(whole, table.segments[np.intp(k)])
    drift = predict_drift(PATH, noise).end.moments
    turned = np.exp(1j * np.arctan2(3, 12))  # a track begins in the robot's frame
    np.testing.assert_allclose([whole.N, whole.D], [drift.N, drift.D], rtol=1e-10)
    np.testing.assert_allclose([turned * whole.p + 0, turned * whole.e1], [drift.p, drift.e1], rtol=1e-9)
    np.testing.assert_allclose(table.distances_of(0)[-1], np.hypot(*np.diff(PATH, axis=0).T).sum())


@pytest.mark.parametrize("noise", [NOISE, SYSTEMATIC, WILD])
def test_spans_are_the_drift_after_a_fix(noise):
    table, _ = table_of(noise)
    intervals, distance = IntervalMoments(table), table.distances_of(0)
    position_std, heading_std = 0.07, 0.04
    run = table.length > 0
    plain = [k for k in range(1, len(run)) if run[k - 1] and run[k]]  # a turn is at one distance
    for breakpoint in (plain[len(plain) // 3], plain[len(plain) // 2], len(run)):
        base, lever = intervals.to(0, breakpoint)
        for e in [k for k in plain if k < breakpoint][:: max(1, len(plain) // 8)]:
            fix = Fix.full(float(distance[e]), position_std_m=position_std, heading_std=heading_std)
            expected = predict_drift(PATH, noise, fixes=[fix]).at(float(distance[breakpoint])).rms ** 2
            found = 2 * position_std**2 + base[e] - 2 * np.real(np.exp(-(heading_std**2) / 2) * lever[e])
            assert found == pytest.approx(expected, rel=1e-8, abs=1e-11)


def test_where_the_heading_is_forgotten_spans_are_composed():
    path = [(0, 0), (30, 0)]
    table, _ = table_of(WILD, path=path)
    assert IntervalMoments(table).forgets.all()
    base, lever = IntervalMoments(table).to(0, int(table.slots[0]))
    expected = predict_drift(path, WILD).end.rms ** 2
    assert base[0] - 2 * lever[0].real == pytest.approx(expected, rel=1e-9)


@settings(deadline=None, max_examples=25)
@given(st.floats(0.2, 3.0), st.integers(0, 4), st.sampled_from([NOISE, SYSTEMATIC]))
def test_reach_ends_where_the_drift_first_exceeds_the_limit(limit, site, noise):
    one_kind = [Beacon(SIGN, b.x, b.y) for b in SITES]
    table, needs = table_of(noise, one_kind, limit)
    distance = table.distances_of(0)
    for e in np.flatnonzero(table.site == site).tolist():
        s = float(distance[table.breakpoint[e]])
        drift = predict_drift(PATH, noise, fixes=[Fix.full(s, position_std_m=0.1, heading_std=0.05)])
        last = int(needs.last_slot_of[e])
        until = distance[min(last + 1, len(distance) - 1)]
        held = np.linspace(s, max(until - 1e-9, s), 60)
        if last >= table.breakpoint[e]:
            assert drift.at(held).rms.max() <= limit * (1 + 1e-9)
        stop = needs._before_next_own()[e]
        if last < stop and last + 2 < len(distance):
            beyond = np.linspace(distance[last + 1], distance[last + 2], 40)
            assert drift.at(beyond).rms.max() > limit * (1 - 1e-6)


@settings(deadline=None, max_examples=40)
@given(
    st.floats(1e-6, 0.5),
    st.floats(-0.2, 0.2),
    st.floats(-0.3, 0.3),
    st.floats(-0.9, 0.9),
    st.floats(0.01, 3.0),
    st.floats(-3.1, 3.1),
    st.floats(0.0, 0.5),
)
def test_between_borders_the_drift_stays_below_its_bound(q, bias, scale, corr, length, turn, before):
    noise = OdometryNoise(
        heading_var_per_m=q,
        distance_var_per_m=1e-2,
        heading_bias_per_m=bias,
        distance_scale_error=scale,
        heading_distance_corr=corr,
    )
    path = np.array([(0, 0), (2, 0), (2 + length * np.cos(turn), length * np.sin(turn))])
    drift = predict_drift(path, noise, fixes=[Fix.full(0.0, position_std_m=0.05, heading_std=before)])
    inside = drift.at(np.linspace(2.0, 2.0 + length, 200)).rms ** 2
    table, _ = table_of(noise, [Beacon(TAG, 99, 99)], 1e3, path)  # a limit so high that nothing is cut
    bend, fixed = table.bend[-1], table.bend_fixed[-1]
    sag = (bend * np.sqrt(inside.max()) + fixed) * length**2 / 8
    assert inside.max() <= max(inside[0], inside[-1]) + sag * (1 + 1e-9) + 1e-12


def test_a_limit_broken_only_inside_a_piece_is_seen():
    # A biased heading drives the estimate in a circle, off the second run and towards it again.
    noise = OdometryNoise(heading_var_per_m=1e-6, heading_bias_per_m=0.5)
    path = np.array([(0, 0), (6, 4), (1.04, -6.1)], dtype=float)  # no breakpoint of a segment at the peak
    drift = predict_drift(path, noise)
    profile = drift.profile(0.01)
    at_peak = float(profile.distance[np.argmax(profile.rms)])
    peak = float(drift.at(np.linspace(at_peak - 0.01, at_peak + 0.01, 4001)).rms.max())
    assert min(abs(at_peak - s) for s in drift.distance) > 1.0
    far = [Beacon(TAG, 99, 99)]
    for limit, holds in ((peak * (1 - 1e-7), False), (peak * (1 + 1e-7), True)):
        table, needs = table_of(noise, far, limit, path)
        assert (not needs.cuts(np.array([False]))) is holds
        for stepwise in (False, True):
            intervals = IntervalMoments(table)
            intervals.forgets[:] = stepwise
            slot, _ = first_breach(intervals, drives_of(table, np.array([False]), np.arange(1)), needs.limit)
            assert (slot[0] == KEPT) is np.bool_(holds)


def test_a_radius_is_judged_by_its_quantile():
    far = [Beacon(TAG, 99, 99)]
    path = np.array([(0, 0), (30, 0)])
    radius = float(predict_drift(path, NOISE).end.radius(0.9))
    problem = placement_problem(Scenario.of(None, path, NOISE, DriftLimit(confidence=0.9)), Sites(points=far))
    search = LimitSearch.of(problem, radius, np.inf)
    for limit, holds in ((0.999 * radius, False), (1.001 * radius, True)):
        assert (not search.requirements([limit]).cuts(np.array([False]))) is holds
    assert Limit(np.array([radius]), 0.9).confidence == 0.9
    assert KEPT < 0


def test_a_radius_beyond_the_limit_only_inside_a_piece_is_seen():
    path = np.array([(0, 0), (6, 4), (1, -6)], dtype=float)
    noise = OdometryNoise(heading_var_per_m=1e-3, heading_bias_per_m=0.5)
    peak = worst_radius(predict_drift(path, noise), 0.9)
    assert peak > predict_drift(path, noise).radius(0.9).max() * 1.01
    problem = placement_problem(
        Scenario.of(None, path, noise, DriftLimit(confidence=0.9)), Sites(points=[Beacon(TAG, 99, 99)])
    )
    search = LimitSearch.of(problem, peak, np.inf)
    table = search.routes
    at_borders = peak * (1 - 1e-5)  # segments are short: their breakpoints come that near to the peak
    assert not Limit(np.array([at_borders]), 0.9).judged(_along(table), np.zeros(len(table.length), int))[0].any()
    for limit, holds in ((at_borders, False), (peak * (1 + 1e-6), True)):
        needs = search.requirements([limit])
        assert (not needs.cuts(np.array([False]))) is holds
        stepwise = IntervalMoments(table)
        stepwise.forgets[:] = True
        slot, _ = first_breach(stepwise, drives_of(table, np.array([False]), np.arange(1)), needs.limit)
        assert (slot[0] == KEPT) is np.bool_(holds)


def _along(table):
    """The states at the ends of the segments of the first route."""
    state, states = table.start[np.intp(0)], []
    for k in range(len(table.length)):
        state = compose(state, table.segments[np.intp(k)])
        states.append(state)
    return Moments(*(np.array(x) for x in zip(*(s.arrays() for s in states), strict=True)))


SHY = BeaconKind.rfid(1.5, 0.1, detection_probability=0.7)
ALL_KINDS = [*SITES, Beacon(SHY, 10, 2.5), Beacon(BeaconKind.heading(2.0, 0.03), 13, -3), Beacon(SHY, 4, -6)]
TWO_ROUTES = [PATH, np.array([(4, -6), (12, 3), (5, 1.25), (14, -4)], dtype=float)]


def drives_on_two_routes(noise, limit):
    problem = placement_problem(Scenario.of(None, TWO_ROUTES, noise, DriftLimit(redundancy=2)), Sites(points=ALL_KINDS))
    table = LimitSearch.of(problem, limit, np.inf).routes
    rng = np.random.default_rng(5)
    chosen = [rng.random(len(ALL_KINDS)) < 0.6 for _ in range(12)]
    return table, chosen, [drives_of(table, c, np.arange(2), 2) for c in chosen]


@pytest.mark.parametrize("noise", [NOISE, SYSTEMATIC])
@pytest.mark.parametrize("limit", [0.4, 0.8, 1.5])
def test_from_reading_to_reading_and_piece_by_piece_the_same_slot_breaks(noise, limit):
    table, _, drives = drives_on_two_routes(noise, limit)
    intervals, stepwise = IntervalMoments(table), IntervalMoments(table)
    stepwise.forgets[:] = True
    for layouts in drives:
        for one, other in zip(
            first_breach(intervals, layouts, Limit(np.full(2, limit))),
            first_breach(stepwise, layouts, Limit(np.full(2, limit))),
            strict=True,
        ):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_allclose(worst_squares(intervals, layouts), worst_squares(stepwise, layouts), rtol=1e-9)


def test_drives_in_portions_are_judged_as_all_at_once(monkeypatch):
    table, _, drives = drives_on_two_routes(NOISE, 0.5)
    intervals, limit = IntervalMoments(table), Limit(np.full(2, 0.5))
    together = [(worst_squares(intervals, some), *first_breach(intervals, some, limit)) for some in drives]
    monkeypatch.setattr("driftplan.layouts.placement.drives._BREAKPOINTS_AT_ONCE", 3 * int(table.slots.max()))
    assert all(len(list(some.parts(table.slots))) > 1 for some in drives)
    for some, expected in zip(drives, together, strict=True):
        found = worst_squares(intervals, some), *first_breach(intervals, some, limit)
        for x, y in zip(found, expected, strict=True):
            np.testing.assert_array_equal(x, y)


def densely(drift, spacing_m=1e-2):
    """The greatest rms by looking everywhere: a profile so dense that nothing hides between its points."""
    return float(drift.profile(spacing_m).rms.max())


@pytest.mark.parametrize("noise", [NOISE, SYSTEMATIC, CIRCLING, WILD])
def test_the_worst_of_each_drive_is_that_of_predict_drift(noise):
    table, chosen, drives = drives_on_two_routes(noise, 0.5)
    intervals = IntervalMoments(table)
    for which, layouts in zip(chosen[:4], drives, strict=False):
        worst = np.sqrt(worst_squares(intervals, layouts))
        everyone = [site for site, there in zip(ALL_KINDS, which, strict=True) if there]
        for k, route in enumerate(layouts.route.tolist()):
            alive = {int(table.site[e]) for e in layouts.reading[layouts.drive == k]}
            drift = drift_with_beacons(TWO_ROUTES[route], noise, [b for b in everyone if ALL_KINDS.index(b) in alive])
            assert worst[k] == pytest.approx(worst_rms(drift), rel=1e-9)
            if noise.distance_var_per_rad == 0:  # else a turn on the spot makes the drift jump
                assert worst[k] == pytest.approx(densely(drift), rel=5e-5)


def test_every_route_is_driven_with_all_and_with_every_one_dead():
    table, chosen, drives = drives_on_two_routes(NOISE, 0.5)
    for which, layouts in zip(chosen, drives, strict=True):
        for r in range(2):
            met = {int(s) for s in table.site[table.readings_of(r)] if which[s]}
            alive = [
                {int(table.site[e]) for e in layouts.reading[layouts.drive == k]}
                for k in np.flatnonzero(layouts.route == r).tolist()
            ]
            assert sorted(map(sorted, alive)) == sorted(map(sorted, [met, *({*met} - {s} for s in met)]))
