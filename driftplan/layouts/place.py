"""place_beacons: the fewest, or cheapest, beacons that keep the drift of every route under a limit, proven."""

from __future__ import annotations

import time
from collections.abc import Sequence
from math import inf
from typing import Any

import numpy as np

from driftplan.arrays import Bools, listener, seconds, whole
from driftplan.beacons.beacon import BeaconKind
from driftplan.errors import InfeasibleError
from driftplan.layouts.layout import Layout
from driftplan.layouts.placement.covering import Progress
from driftplan.layouts.placement.drives import worst_of_failures
from driftplan.layouts.placement.placement_diagnosis import infeasible
from driftplan.layouts.placement.problem import LimitSearch, PlacementProblem, Stations, placement_problem
from driftplan.layouts.scenario import Scenario, Sites
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Estimator, Fix
from driftplan.planning.request import DriftLimit
from driftplan.planning.status import Status
from driftplan.world.world import World

_RMS_ROUNDING = 1e-6  # relative: the final check adds the same numbers in another order
_RADIUS_ROUNDING = 1e-5  # relative: and integrates radii to that
_TIGHTER = 0.995  # of the limits tried before: what the next try keeps at most
_CHECK_S_PER_ROUTE = 0.03  # seconds kept for the final check, but at most a quarter of the time


def place_beacons(
    world: World | None,
    routes: Any,
    noise: OdometryNoise,
    limit: float | Sequence[float] | DriftLimit | None,
    sites: BeaconKind | Sequence[BeaconKind] | Sites,
    *,
    max_beacons: int | None = None,
    budget: float | None = None,
    estimator: Estimator = "reset",
    start_fix: Fix | None = None,
    drift_tolerance: float = 0.005,
    time_limit: float = 60.0,
    progress: Progress | None = None,
) -> Layout:
    """The cheapest layout that keeps the drift under a limit everywhere on every route, with a proof; or, without a
    limit, the layout within a budget whose worst drift is least.

    What the robot makes of a reading decides how many beacons it needs. Under ``estimator="reset"``, the default,
    readings replace the error they measure: exact second moments, no fusion. A coarse or late reading may then be worse
    than none, so a further beacon can break a layout that holds. A robot with a Kalman filter, "filter", needs up to
    four times fewer. For it a further beacon never hurts, readings that may be missed count by an upper bound, and the
    drift is that of the linear model (`Drift` says where that stops being right).

    "Everywhere" is meant: on arrival and after every reading and every turn on the spot, and between the computed
    points, where the rms is bounded to a ten-billionth (see `driftplan.model.worst`); a radius, at a ``confidence``,
    has no such bound and is looked at closely wherever it comes near the limit.

    Parameters
    ----------
    world : its walls block sight, its zones have their own noise, and sites are generated in its free space
    routes : one route or many, each waypoints (n, 2) in metres or an object with such a ``path``
    noise : of the continuous kind (no ``step_m``)
    limit : metres (one number or one per route), DriftLimit or None
        None, or a `DriftLimit` without ``max_drift``: the least worst drift within ``max_beacons`` and ``budget`` is
        sought.
    sites : where beacons may go; kinds alone: sites are generated, as `Sites` says
    max_beacons, budget : at most so many new beacons; they cost at most this
    estimator : what the robot does with a reading; "filter" takes no ``confidence`` and no known systematic errors
    start_fix : uncertainty at the start of every route, at 0; default: the start is known
    drift_tolerance : without a limit: the worst drift is within this share of the least
    time_limit : seconds. The best layout so far is returned when they are over, and ``status`` says so. The tables of
        the search are made and the layout is verified whatever the limit: a second for 60 routes and 1250 sites, a
        dozen for 500 and 5000.
    progress : called with seconds, cost of the best layout and lower bound when one changes

    Where systematic errors differ between drives (`OdometryNoise.heading_bias_std_per_m` and its like), limits are
    about what `predict_drift` says, which averages over drives or has a filter estimate what is constant; the search
    looks at the drive with the mean errors, under limits tightened as far as it takes. ``lower_bound`` is then that
    drive's, and a layout for which limits had to be tightened is not ``proven``.

    Returns
    -------
    Layout
        Verified by `drift_with_beacons`, dead beacons included. Of layouts equally cheap it is one in which no beacon
        can be exchanged for a site listed earlier; the same input gives the same layout, unless the search or a
        part of it ran out of time.

    Raises
    ------
    InfeasibleError : if no layout will do: the message names route and stretch, the least drift reachable there and the
        sites that come closest. Also if none was found in time.
    ValueError : for input that makes no sense

    >>> noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    >>> tag = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01)
    >>> layout = place_beacons(None, [(0, 0), (60, 0), (60, 30)], noise, 0.6, Sites(tag, spacing_m=2.0))
    >>> len(layout.beacons), layout.proven, layout.worst_drift < 0.6
    (3, True, True)
    """
    began, asked, time_limit = time.monotonic(), DriftLimit.of(limit), seconds("time_limit", time_limit)
    scenario = Scenario.of(world, routes, noise, asked, start_fix, estimator)
    return place_at(
        Sites.of(sites), scenario, asked, began=began, max_beacons=max_beacons, budget=budget,
        drift_tolerance=drift_tolerance, time_limit=time_limit, progress=progress,
    )  # fmt: skip


def place_at(
    sites: Sites | Stations,
    scenario: Scenario,
    asked: DriftLimit,
    *,
    began: float,
    max_beacons: int | None = None,
    budget: float | None = None,
    drift_tolerance: float = 0.005,
    time_limit: float = 60.0,
    progress: Progress | None = None,
) -> Layout:
    """`place_beacons`, ``began`` then by the monotonic clock, at stations that several placements may share."""
    problem = placement_problem(scenario, sites, max_beacons=max_beacons, budget=budget)
    told = listener("progress", progress, "with seconds, the cost of the best layout and the lower bound")
    limits = None if asked.max_drift is None else asked.per_route(len(scenario.routes))
    if limits is None and max_beacons is None and budget is None:
        raise ValueError("expected a limit: max_drift, or max_beacons or budget for the least drift, got none")
    tell, deadline = lambda _, *found: told(time.monotonic() - began, *found), _deadline(began, time_limit, scenario)
    search = LimitSearch.of(problem, min(limits) if limits else None, deadline, tell)
    return _least_drift(search, drift_tolerance, began) if limits is None else _cheapest(search, limits, began)


def beacon_tradeoff(
    world: World | None,
    routes: Any,
    noise: OdometryNoise,
    sites: BeaconKind | Sequence[BeaconKind] | Sites,
    *,
    max_beacons: int = 20,
    budget: float | None = None,
    redundancy: int = 1,
    confidence: float | None = None,
    estimator: Estimator = "reset",
    start_fix: Fix | None = None,
    drift_tolerance: float = 0.005,
    time_limit: float = 60.0,
) -> tuple[Layout, ...]:
    """The trade-off curve: for 0, 1, 2, … beacons the layout with the least worst drift.

    Parameters
    ----------
    world, routes, noise, sites, budget, estimator, start_fix, drift_tolerance : see `place_beacons`
    max_beacons : where the curve ends
    redundancy, confidence : of the drift that is made least; see `DriftLimit`
    time_limit : seconds for the whole curve

    Returns
    -------
    tuple of Layout
        Fewest beacons first, worst drift falling; numbers of beacons that do not lower it are left out. The curve ends
        where a further beacon no longer helps by more than the tolerance, at ``max_beacons``, or when time is over.

    >>> noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    >>> tag = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01)
    >>> curve = beacon_tradeoff(None, [(0, 0), (60, 0)], noise, Sites(tag, spacing_m=2.0), max_beacons=2)
    >>> [(len(layout.beacons), round(layout.worst_drift, 2)) for layout in curve]
    [(0, 2.96), (1, 0.99), (2, 0.53)]
    """
    whole("max_beacons", max_beacons, least=0)
    began, time_limit = time.monotonic(), seconds("time_limit", time_limit)
    limit = DriftLimit(redundancy=redundancy, confidence=confidence)
    scenario = Scenario.of(world, routes, noise, limit, start_fix, estimator)
    stations = Stations(scenario, Sites.of(sites))
    curve: list[Layout] = []
    search: LimitSearch | None = None
    for count in range(max_beacons + 1):
        left = time_limit - (time.monotonic() - began)
        if left <= 0 and curve:
            break
        problem = placement_problem(scenario, stations, max_beacons=count, budget=budget)
        start = time.monotonic()
        deadline = _deadline(start, max(left, 0.1), scenario)
        search = search.like(problem, deadline) if search else LimitSearch.of(problem, None, deadline)
        try:
            layout = _least_drift(search, drift_tolerance, start, known=curve[-1] if curve else None)
        except InfeasibleError:  # groups may demand more beacons than these
            continue
        if not curve or layout.worst_drift < curve[-1].worst_drift * (1 - drift_tolerance):
            curve.append(layout)
    if not curve:
        raise InfeasibleError(f"no layout of up to {max_beacons} beacons satisfies the groups and spacing asked for")
    return tuple(curve)


def _deadline(began: float, time_limit: float, scenario: Scenario) -> float:
    """When to stop searching, by the monotonic clock."""
    return began + max(time_limit - _CHECK_S_PER_ROUTE * len(scenario.routes), 0.75 * time_limit)


def _cheapest(search: LimitSearch, limits: tuple[float, ...], began: float) -> Layout:
    cover = search.cover(limits)
    if cover.chosen is None:
        raise infeasible(search, limits, cover)
    chosen, status = cover.chosen, cover.status
    if search.problem.scenario.drives_differ:
        chosen, tightened = _kept_on_other_drives(search, chosen, limits)
        status = Status.GOOD_ENOUGH if tightened else status
    return _checked_layout(search.problem, chosen, cover.lower_bound, status, limits, 0.0, began)


def _kept_on_other_drives(search: LimitSearch, chosen: Bools, limits: tuple[float, ...]) -> tuple[Bools, bool]:
    """A layout that keeps the limits although drives differ, and whether another than the mean drive's was needed."""
    tightened_m, worst_m, asked_m = np.array(limits), search.worst(chosen), np.array(limits)
    while (worst_m > asked_m).any():
        tightened_m = np.where(worst_m > asked_m, tightened_m * np.minimum(asked_m / worst_m, _TIGHTER), tightened_m)
        search = LimitSearch.of(search.problem, float(tightened_m.min()), search.deadline, search.progress)
        cover = search.cover(tightened_m.tolist())
        if cover.chosen is None:
            raise infeasible(search, tightened_m.tolist(), cover, even_for_the_mean=True)
        chosen, worst_m = cover.chosen, search.worst(cover.chosen)
    return chosen, bool((tightened_m < asked_m).any())


def _least_drift(search: LimitSearch, tolerance: float, began: float, known: Layout | None = None) -> Layout:
    """The layout with the least worst drift; ``known`` is one to start from."""
    if not 0 < tolerance < 1:
        raise ValueError(f"expected drift_tolerance in (0, 1), got {tolerance!r}")
    problem, a_metre = search.problem, (1.0,) * len(search.problem.scenario.routes)
    start = search.cover([inf for _ in a_metre]).chosen
    if start is None:
        raise InfeasibleError("no layout satisfies the groups together with " + ", ".join(problem.rules))
    if known is not None:
        ids = {b.id for b in known.beacons}
        hint = np.array([b.id in ids for b in problem.sites]) | problem.fixed
        start = min(hint, start, key=lambda chosen: search.excess(a_metre, chosen))
    least = search.least_factor(a_metre, start, 0.0, tolerance)
    limits = tuple(least.factor * (1 + _RMS_ROUNDING) for _ in a_metre)
    status = Status.OPTIMAL if least.proven else Status.TIME_LIMIT
    return _checked_layout(problem, least.chosen, 0.0, status, limits, least.ruled_out, began)


def _checked_layout(
    problem: PlacementProblem,
    chosen: Bools,
    lower_bound: float,
    status: Status,
    limits: tuple[float, ...],
    drift_bound: float,
    began: float,
) -> Layout:
    """The layout, once the exact model has agreed that it keeps the limits.

    With all beacons alive that is `drift_with_beacons`; with some dead, drives on tables laid for this layout only.
    """
    scenario = problem.scenario
    everyone = (*problem.existing, *problem.chosen(chosen))
    drifts = tuple(scenario.drift(r, everyone) for r in range(len(limits)))
    worst = np.array([scenario.worst(drift) for drift in drifts])
    if scenario.redundancy > 1:
        worst = np.maximum(worst, worst_of_failures(scenario, everyone))
    rounding = _RMS_ROUNDING if scenario.confidence is None else _RADIUS_ROUNDING
    over = worst / np.array(limits)
    r = int(np.argmax(over))
    if over[r] > 1 + rounding:
        dead = f"with {scenario.redundancy - 1} of {[b.id for b in everyone]} dead"
        what = f"a layout whose drift on route {r} is {worst[r]:.9g} m, above {limits[r]:.9g} m, {dead}"
        raise RuntimeError(f"the search accepted {what}: a bug in driftplan, please report it")
    return Layout(
        beacons=problem.chosen(chosen),
        existing=problem.existing,
        cost=float(problem.cost @ chosen),
        lower_bound=lower_bound,
        proven=status is Status.OPTIMAL,
        status=status,
        max_drift=limits,
        drift_bound=drift_bound,
        drifts=drifts,
        seconds=time.monotonic() - began,
        scenario=scenario,
    )
