"""What dead beacons do: the greatest drift on every route without them, many routes and failures at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.layouts.placement.drives import Layouts, drives_of, worst_squares
from driftplan.layouts.placement.spans import Spans
from driftplan.layouts.placement.tracks import Tracks, lay_tracks
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
    tracks, worst = tracks_of(scenario, beacons, least_limit_m), np.zeros(number)
    spans, everyone = Spans(tracks), np.ones(len(beacons), dtype=bool)
    for some in np.array_split(np.arange(number), -(-number // _MAX_ROUTES_AT_ONCE)):
        drives = drives_of(tracks, everyone, some, scenario.redundancy)
        np.maximum.at(worst, drives.route, np.sqrt(worst_squares(spans, drives)))
    return worst


def worst_without(
    scenario: Scenario, beacons: Sequence[Beacon], cases: Sequence[tuple[int, int]], least_limit_m: float
) -> list[float]:
    """Greatest score, metres, in each case of (the beacon that is dead, by position; the route)."""
    if scenario.confidence is not None or scenario.estimator == "filter":
        return [scenario.worst(scenario.drift(r, [*beacons[:k], *beacons[k + 1 :]])) for k, r in cases]
    if not cases:
        return []
    tracks = tracks_of(scenario, beacons, least_limit_m)
    events = [np.arange(len(tracks.site))[tracks.events_of(r)] for _, r in cases]
    events = [e[tracks.site[e] != k] for e, (k, _) in zip(events, cases, strict=True)]
    drive = np.repeat(np.arange(len(cases)), [len(e) for e in events])
    drives = Layouts(np.array([r for _, r in cases]), drive, np.concatenate(events).astype(np.intp))
    return [float(x) for x in np.sqrt(worst_squares(Spans(tracks), drives))]


def tracks_of(scenario: Scenario, beacons: Sequence[Beacon], least_limit_m: float) -> Tracks:
    """The routes and the readings of these beacons on them."""
    return lay_tracks(
        scenario.routes,
        scenario.noise,
        beacons,
        scenario.world,
        start_fix=scenario.start_fix,
        least_limit_m=least_limit_m,
    )
