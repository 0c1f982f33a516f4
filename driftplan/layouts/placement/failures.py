"""What dead beacons do: the greatest drift on routes without them, many routes and failures at once."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.layouts.placement.drives import ReadingSets, worst_squares
from driftplan.layouts.placement.fused_routes import fused_routes
from driftplan.layouts.placement.interval_moments import IntervalMoments
from driftplan.layouts.placement.route_table import route_table
from driftplan.layouts.scenario import Scenario

Failure = tuple[int, tuple[int, ...]]  # a route, and the beacons that are dead, by position


def failures(scenario: Scenario, beacons: Sequence[Beacon]) -> list[Failure]:
    """Every route with every set of at most redundancy - 1 dead beacons of those it comes within range of."""
    routes = range(len(scenario.routes))
    numbers = range(scenario.redundancy)
    in_range = [scenario.beacons_in_range(r, beacons) if scenario.redundancy > 1 else () for r in routes]
    return [(r, dead) for r in routes for number in numbers for dead in combinations(in_range[r], number)]


def worst_drifts(scenario: Scenario, beacons: Sequence[Beacon], cases: Sequence[Failure]) -> Floats:
    """Greatest score anywhere in each case, metres."""
    if scenario.confidence is not None or not cases:
        alive = [(r, [b for k, b in enumerate(beacons) if k not in dead]) for r, dead in cases]
        return np.array([scenario.worst(scenario.drift(r, living)) for r, living in alive])
    if scenario.estimator == "filter":
        routes, everyone = fused_routes(scenario, beacons), frozenset(range(len(beacons)))
        return np.array([routes[r].worst(everyone.difference(dead)) for r, dead in cases])
    table = route_table(scenario, beacons)
    readings = [np.arange(len(table.site))[table.readings_of(r)] for r, _ in cases]
    readings = [e[~np.isin(table.site[e], dead)] for e, (_, dead) in zip(readings, cases, strict=True)]
    drive = np.repeat(np.arange(len(cases)), [len(e) for e in readings])
    drives = ReadingSets(np.array([r for r, _ in cases]), drive, np.concatenate(readings).astype(np.intp))
    return np.sqrt(worst_squares(IntervalMoments(table), drives))


def worst_of_failures(scenario: Scenario, beacons: Sequence[Beacon]) -> Floats:
    """Greatest score on every route with the worst set of at most redundancy - 1 dead beacons, metres, (routes,)."""
    cases, worst = failures(scenario, beacons), np.zeros(len(scenario.routes))
    np.maximum.at(worst, [r for r, _ in cases], worst_drifts(scenario, beacons, cases))
    return worst
