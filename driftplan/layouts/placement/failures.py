"""What dead beacons do: the greatest drift on every route without them, many routes and failures at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.layouts.placement.drives import ReadingSets, drives_of, worst_squares
from driftplan.layouts.placement.interval_moments import IntervalMoments
from driftplan.layouts.placement.route_table import RouteTable, route_table
from driftplan.layouts.scenario import Scenario
from driftplan.model.drift import Drift

_MAX_ROUTES_AT_ONCE = 50  # with all their failures: more would take in memory


def failures(scenario: Scenario, beacons: Sequence[Beacon], route: int) -> Iterator[tuple[tuple[Beacon, ...], Drift]]:
    """Every set of at most redundancy - 1 dead beacons on a route, and the drift without them."""
    in_range = scenario.beacons_in_range(route, beacons)
    for number in range(scenario.redundancy):
        for dead in combinations(in_range, number):
            yield dead, scenario.drift(route, [b for b in in_range if b not in dead])


def worst_of_failures(scenario: Scenario, beacons: Sequence[Beacon], least_limit_m: float) -> Floats:
    """Greatest score on every route with the worst set of at most redundancy - 1 dead beacons, metres."""
    number = len(scenario.routes)
    if scenario.confidence is not None or scenario.estimator == "filter":
        routes = range(number)
        return np.array([max(scenario.worst(drift) for _, drift in failures(scenario, beacons, r)) for r in routes])
    table, worst = table_of(scenario, beacons, least_limit_m), np.zeros(number)
    intervals, everyone = IntervalMoments(table), np.ones(len(beacons), dtype=bool)
    for some in np.array_split(np.arange(number), -(-number // _MAX_ROUTES_AT_ONCE)):
        drives = drives_of(table, everyone, some, scenario.redundancy)
        np.maximum.at(worst, drives.route, np.sqrt(worst_squares(intervals, drives)))
    return worst


def worst_without(
    scenario: Scenario, beacons: Sequence[Beacon], cases: Sequence[tuple[int, int]], least_limit_m: float
) -> list[float]:
    """Greatest score, metres, in each case of (the beacon that is dead, by position; the route)."""
    if scenario.confidence is not None or scenario.estimator == "filter":
        return [scenario.worst(scenario.drift(r, [*beacons[:k], *beacons[k + 1 :]])) for k, r in cases]
    if not cases:
        return []
    table = table_of(scenario, beacons, least_limit_m)
    readings = [np.arange(len(table.site))[table.readings_of(r)] for _, r in cases]
    readings = [e[table.site[e] != k] for e, (k, _) in zip(readings, cases, strict=True)]
    drive = np.repeat(np.arange(len(cases)), [len(e) for e in readings])
    drives = ReadingSets(np.array([r for _, r in cases]), drive, np.concatenate(readings).astype(np.intp))
    return [float(x) for x in np.sqrt(worst_squares(IntervalMoments(table), drives))]


def table_of(scenario: Scenario, beacons: Sequence[Beacon], least_limit_m: float) -> RouteTable:
    """The routes and the readings of these beacons on them."""
    return route_table(
        scenario.routes,
        scenario.noise,
        beacons,
        scenario.world,
        start_fix=scenario.start_fix,
        least_limit_m=least_limit_m,
    )
