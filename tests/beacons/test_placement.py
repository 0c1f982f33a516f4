"""place_beacons against brute force, against a second formulation, against Monte Carlo, and on what users ask of it."""

from itertools import combinations, pairwise

import numpy as np
import pytest
import shapely

from driftplan.beacons.beacon import Beacon, BeaconKind, beacon_fixes, drift_with_beacons, passes
from driftplan.beacons.covering import Outcome
from driftplan.beacons.placement import place_beacons
from driftplan.beacons.placement_problem import SiteGroup
from driftplan.errors import InfeasibleError
from driftplan.model.fixes import Fix
from driftplan.model.noise import OdometryNoise
from driftplan.model.simulation import simulate_drift

NAMES = ["tags", "perfect", "coarse", "two full", "mixed", "with compass", "unsure", "everything"]
NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
TAG = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
SIGN = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01, line_of_sight=False)


# Brute force


def place(instance, **options):
    """The layout, or None if it is said that there is none."""
    existing = [instance.sites[i] for i in instance.members(instance.fixed)]
    new = [i for i in range(len(instance.sites)) if i not in instance.members(instance.fixed)]
    try:
        return place_beacons(
            None,
            instance.paths,
            instance.noise,
            max_drift=instance.limit,
            candidates=[instance.sites[i] for i in new],
            costs=instance.cost[new],
            existing=existing,
            redundancy=instance.redundancy,
            **options,
        )
    except InfeasibleError:
        return None


def check_against_brute_force(instance, allowed=lambda subset: True, **options):
    layout, best = place(instance, **options), instance.cheapest(allowed)
    if not np.isfinite(best):
        assert layout is None
        return
    assert layout is not None, f"brute force finds cost {best}"
    assert layout.proven
    assert layout.status is Outcome.OPTIMAL
    assert layout.cost == layout.lower_bound == best
    subset = sum(1 << i for i, site in enumerate(instance.sites) if site in layout.beacons) | instance.fixed
    assert instance.acceptable(subset)
    assert allowed(subset)
    assert layout.worst_drift == pytest.approx(instance.worst(subset))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(200, 202))
def test_the_optimum_is_that_of_brute_force(name, seed, make_instance, kinds_named):
    check_against_brute_force(make_instance(seed, kinds_named[name], sites=(4, 5), existing=seed % 2 == 0))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(300, 325))
def test_the_optimum_is_that_of_brute_force_on_200_instances(name, seed, make_instance, kinds_named):
    check_against_brute_force(make_instance(seed, kinds_named[name], existing=seed % 3 == 0))


@pytest.mark.parametrize("seed", range(400, 403))
def test_groups_caps_and_spacing_are_those_of_brute_force(seed, make_instance, kinds_named):
    instance = make_instance(seed, kinds_named["mixed"], sites=(5, 6))
    instance.redundancy = 1
    n = len(instance.sites)
    crowd, pair = [0, 1, 2], [n - 2, n - 1]
    apart = 3.0

    def allowed(subset):
        members = instance.members(subset)
        near = any(
            np.hypot(*(instance.sites[i].xy - instance.sites[j].xy)) < apart for i, j in combinations(members, 2)
        )
        return (
            len(members) <= 4
            and sum(i in crowd for i in members) <= 1
            and sum(i in pair for i in members) >= 1
            and instance.cost_of(subset) <= 6
            and not near
        )

    check_against_brute_force(
        instance,
        allowed,
        max_beacons=4,
        budget=6.0,
        min_spacing_m=apart,
        groups=[SiteGroup(crowd, at_most=1), SiteGroup([f"b{i}" for i in pair], at_least=1)],
    )


# Counterexamples: a later fix is worse than an earlier one


def test_a_later_imperfect_full_fix_may_be_worse_and_is_not_taken_for_better():
    # Out 5 m and back 6 m. The heading error of a fix at the start acts on a lever of at most 5 m, half-way and 1 m at
    # the end; that of a fix at the far end on 6 m at the end.
    noise = OdometryNoise(heading_var_per_m=0.02**2 / 500, distance_var_per_m=1e-6)
    path = np.array([(0, 0), (5, 0), (5, 0.4), (-1, 0.4)])
    sign = BeaconKind.landmark(0.2, 0.0, 0.1, line_of_sight=False)
    near, far = Beacon(sign, 0.0, -0.15, "near"), Beacon(sign, 5.0, -0.15, "far")
    lost = Fix.full(0.0, position_std_m=0.2, heading_std=0.3)
    first, last = (drift_with_beacons(path, noise, [b], fixes=[lost]).end.rms for b in (near, far))
    assert last > 3 * first
    limit = 0.55
    layout = place_beacons(None, path, noise, max_drift=limit, candidates=[far, near], start_fix=lost)
    assert [b.id for b in layout.beacons] == ["near"]
    assert layout.proven
    with pytest.raises(InfeasibleError):
        place_beacons(None, path, noise, max_drift=limit, candidates=[near], existing=[far], start_fix=lost)


def test_a_coarse_beacon_too_many_spoils_a_layout_and_the_search_knows():
    path = [(0, 0), (30, 0)]
    fine, coarse = BeaconKind.rfid(1.0, 0.02), BeaconKind.rfid(1.0, 0.4)
    good, bad = Beacon(fine, 15.0, 0.0, "good"), Beacon(coarse, 18.0, 0.0, "bad")
    with_good, with_both = (drift_with_beacons(path, NOISE, b).profile().rms.max() for b in ([good], [good, bad]))
    assert with_both > with_good
    limit = float(with_good + with_both) / 2
    layout = place_beacons(None, path, NOISE, max_drift=limit, candidates=[good, bad])
    assert [b.id for b in layout.beacons] == ["good"]
    with pytest.raises(InfeasibleError):  # existing beacons cannot be ignored
        place_beacons(None, path, NOISE, max_drift=limit, candidates=[good], existing=[bad])


def test_a_perfect_fix_that_comes_later_may_be_worse_when_the_heading_is_all_but_lost():
    # Steps 0, +1, -1.324 with heading errors of 1 rad, the smallest random walk that shows it, as runs out and back.
    noise = OdometryNoise(heading_var_per_m=1.0)
    path = np.array([(0, 0), (1, 0), (0, 0), (-0.324361, 0)])
    perfect = BeaconKind.landmark(1e-3, 0.0, 0.0, line_of_sight=False)
    sites = [Beacon(perfect, x, 0.0, f"at {x}") for x in (0.25, 0.5, 0.75, 1.0, -0.1)]
    drifts = {}
    for size in range(len(sites) + 1):
        for some in combinations(sites, size):
            drifts[some] = float(drift_with_beacons(path, noise, some).profile().rms.max())
    levels = np.unique(np.round(list(drifts.values()), 9))
    for low, high in pairwise(levels):
        if high - low < 1e-3:
            continue
        limit = (low + high) / 2
        fewest = min(len(some) for some, drift in drifts.items() if drift <= limit)
        layout = place_beacons(None, path, noise, max_drift=limit, candidates=sites)
        assert (len(layout.beacons), layout.proven) == (fewest, True)


# Other methods


def hop_reaches(path, noise, sites, limit):
    """For perfect full fixes at points: which site is within the limit of which, the start and the end included."""
    length = float(shapely.LineString(path).length)
    visits = sorted((float(s), i) for i, site in enumerate(sites) for s in np.unique(passes(path, site)))
    visits = [(0.0, -1), *visits, (length, -2)]
    arcs = []
    for a, (s, _) in enumerate(visits[:-1]):
        fresh = [Fix.full(s, position_std_m=0.0, heading_std=0.0)]
        drift = drift_with_beacons(path, noise, [], fixes=fresh if a else [])
        for b in range(a + 1, len(visits)):
            inside = np.linspace(s, visits[b][0], 25)
            if drift.at(inside).rms.max() > limit:
                break
            arcs.append((a, b))
    return visits, arcs


def flow_optimum(paths, noise, sites, limit):
    """Fewest stations by a flow formulation: each route is a path of hops through chosen sites (flow refuelling)."""
    from scipy.optimize import Bounds, LinearConstraint, milp

    n, rows, least, most = len(sites), [], [], []
    graphs = [hop_reaches(path, noise, sites, limit) for path in paths]
    total = n + sum(len(arcs) for _, arcs in graphs)
    first = n
    for visits, arcs in graphs:
        for v in range(len(visits)):
            balance = np.zeros(total)
            for k, (a, b) in enumerate(arcs):
                balance[first + k] += (b == v) - (a == v)
            net = 1.0 if v == len(visits) - 1 else -1.0 if v == 0 else 0.0
            rows.append(balance), least.append(net), most.append(net)
            if visits[v][1] >= 0:
                use = np.zeros(total)
                use[visits[v][1]] = 1.0
                for k, (_, b) in enumerate(arcs):
                    use[first + k] -= b == v
                rows.append(use), least.append(0.0), most.append(np.inf)
        first += len(arcs)
    found = milp(
        np.concatenate([np.ones(n), np.zeros(total - n)]),
        integrality=np.concatenate([np.ones(n), np.zeros(total - n)]),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(np.array(rows), np.array(least), np.array(most)),
    )
    return round(found.fun) if found.status == 0 else None


def street_routes(rng, number):
    """Routes along the streets of a 5 x 5 grid, 10 m apart."""
    routes = []
    for _ in range(number):
        at, path = rng.integers(0, 5, 2), []
        path.append(at * 10.0)
        for _ in range(int(rng.integers(3, 6))):
            axis = rng.integers(2)
            to = at.copy()
            to[axis] = rng.choice([x for x in range(5) if x != at[axis]])
            path.append(to * 10.0)
            at = to
        routes.append(np.array(path))
    return routes


@pytest.mark.parametrize("seed", range(2))
def test_perfect_full_fixes_cost_what_a_flow_formulation_finds(seed):
    rng = np.random.default_rng(seed)
    paths = street_routes(rng, 5)
    point_sign = BeaconKind.landmark(0.05, 0.0, 0.0, line_of_sight=False)
    sites = [
        Beacon(point_sign, x, y)
        for x in np.arange(0, 41, 5.0)
        for y in np.arange(0, 41, 5.0)
        if x % 10 == 0 or y % 10 == 0
    ]
    limit = 0.5
    layout = place_beacons(None, paths, NOISE, max_drift=limit, candidates=sites)
    assert layout.proven
    assert len(layout.beacons) == flow_optimum(paths, NOISE, sites, limit)


@pytest.mark.parametrize("seed", range(4))
def test_on_one_route_with_perfect_fixes_going_as_far_as_possible_is_as_good(seed):
    rng = np.random.default_rng(seed)
    path = np.cumsum(np.concatenate([[[0, 0]], rng.uniform(2, 12, (6, 2))]), axis=0)  # to the upper right: never back
    point_sign = BeaconKind.landmark(0.01, 0.0, 0.0, line_of_sight=False)
    spots = np.linspace(0, 1, 41)[1:-1]
    sites = [Beacon(point_sign, *shapely.LineString(path).interpolate(t, normalized=True).coords[0]) for t in spots]
    limit = 0.6
    count, fixes = 0, []
    while drift_with_beacons(path, NOISE, fixes).profile().rms.max() > limit:
        able = [s for s in sites if s not in fixes and _holds_until(path, [*fixes, s], s, limit)]
        fixes.append(max(able, key=lambda s: passes(path, s)[0, 0]))
        count += 1
    layout = place_beacons(None, path, NOISE, max_drift=limit, candidates=sites)
    assert (len(layout.beacons), layout.proven) == (count, True)


def _holds_until(path, fixes, site, limit):
    drift = drift_with_beacons(path, NOISE, fixes)
    return drift.at(np.linspace(0, passes(path, site)[0, 0] - 1e-6, 200)).rms.max() <= limit


def test_monte_carlo_finds_the_limit_kept_everywhere():
    path = np.array([(0, 0), (25, 0), (25, 15), (5, 15), (5, 5)], dtype=float)
    limit = 0.5
    layout = place_beacons(None, path, NOISE, max_drift=limit, kind=SIGN, spacing_m=2.0)
    dense = _with_corners(path, 90)
    errors = simulate_drift(dense, NOISE, runs=4000, rng=3, fixes=beacon_fixes(path, layout.beacons), substep_m=0.5)
    square = (errors**2).sum(-1)
    standard_error = square.std(0) / np.sqrt(len(square))
    assert (square.mean(0) <= limit**2 + 4 * standard_error).all()
    assert square.mean(0).max() > (0.8 * limit) ** 2  # the fewest beacons leave little to spare


def _with_corners(path, count):
    line = shapely.LineString(path)
    corners = [line.project(shapely.Point(p)) for p in path]
    places = np.unique(np.concatenate([np.linspace(0, line.length, count), corners]))
    return shapely.get_coordinates(shapely.line_interpolate_point(line, places))
