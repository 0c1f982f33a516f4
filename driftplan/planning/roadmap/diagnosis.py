"""Why no itinerary keeps a limit: the words of an `InfeasibleError`, for someone who has to do something about it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.planning.request import format_least, format_point

if TYPE_CHECKING:
    from driftplan.planning.roadmap.beacon_search import BeaconSearch

_SURE_HEADING = 1e-6  # rad
_LABELS = 5_000  # of a search that only explains,
_SLACK = 0.05  # and of its labels, as a share of the limit squared


def why_infeasible(search: BeaconSearch, limit: float, longest: float) -> str:
    """What to tell the user when ``search`` found no path."""
    asked = f"no route that keeps the drift under {limit:g} m everywhere" if math.isfinite(limit) else "no route"
    if math.isfinite(longest):
        asked += f" and is no longer than {longest:.4g} m"
    if search.reliance.redundancy > 1:
        asked += ", with any one beacon dead"
    if search.timed_out:
        return f"{asked} was found in time, nor was it ruled out: raise time_limit, or begin with a higher max_drift"
    if search.exhausted:
        return (
            f"{asked} was found among {search.labels} partial routes, nor was it ruled out: begin with a higher "
            "max_drift, or take fewer max_nodes"
        )
    search.max_labels = _LABELS
    accuracy = [b.kind.position_std_m * 2**0.5 for b in search.beacons if b.kind.position_std_m is not None]
    reasons = []
    if search.reliance.start_fix is not None and search.check.drift(search.shortest).moments.N[0].real > limit**2:
        reasons.append("the drift at the start is above it already")
    elif search.reliance.estimator == "filter":  # knows more than any one reading says
        pass
    elif not accuracy:
        reasons.append("no beacon gives a position")
    elif min(accuracy) > limit:
        reasons.append(f"the most accurate beacon leaves an rms error of {min(accuracy):.3g} m itself")
    elif _captures_would_help(search, limit, longest):
        reasons.append(
            "beacons that could hold it would be missed: having drifted, the robot comes within their ranges less "
            f"surely than min_capture={search.reliance.min_capture:g} demands; larger ranges or more beacons would help"
        )
    elif _headings_would_help(search, limit, longest):
        reasons.append(
            "position fixes alone cannot hold it because the heading is never fixed well enough: with beacons that "
            "also fix the heading the limit could be kept"
        )
    place, left = search.nearest
    if left > 0:  # else the graph had a route, which the exact model found too lost
        nearest = _nearest_beacon(search, place)
        reasons.append(
            f"the best attempt gets to {format_point(place)}, {left:.4g} m short of the goal"
            + (f"; {nearest}" if nearest else "")
        )
    if math.isfinite(limit):
        reasons.append(f"a limit of {format_least(search.worst(search.steadiest(longest)))} can be kept")
    if search.reliance.estimator == "reset" and search.beacons:
        fused = _fusing_would_help(search, limit, longest)
        can, cannot = 'can keep it: estimator="filter"', "was not found to keep it either"
        reasons.append(f"a robot that fuses its readings {can if fused else cannot}")
    return f"{asked} (roadmap of {search.max_nodes} nodes)" + (": " + "; ".join(reasons) if reasons else "")


def _captures_would_help(search: BeaconSearch, limit: float, longest: float) -> bool:
    """Whether the limit could be kept if the robot came within every range as planned."""
    if search.reliance.min_capture == 0:
        return False
    check, search.check = search.check, search.check.relying(min_capture=0.0)
    found = search.any_within(limit, longest, _SLACK)
    search.check = check
    return found is not None


def _headings_would_help(search: BeaconSearch, limit: float, longest: float) -> bool:
    """Whether the limit could be kept if every position fix were a full fix."""
    lacking = [b for b in search.beacons if b.kind.heading_std is None]
    if not lacking:
        return False
    search.graph(0.0, longest)
    assert search.roadmap is not None
    graph = search.graph_of(search.roadmap, [_full(b) for b in search.beacons])
    return search.walk(graph, limit, longest, max_labels=_LABELS).nodes is not None


def _fusing_would_help(search: BeaconSearch, limit: float, longest: float) -> bool:
    """Whether a robot that fuses its readings is soon found to keep the limit."""
    other = type(search)(
        search.space,
        search.world,
        search.ends,
        search.noise,
        replace(search.reliance, estimator="filter"),
        max_nodes=search.max_nodes,
        seed=search.seed,
        stop=search.stop,
        shortest=search.shortest,
        known=search.known,
    )
    other.max_labels = _LABELS
    return other.any_within(limit, longest, _SLACK) is not None


def _full(beacon: Beacon) -> Beacon:
    kind = beacon.kind
    if kind.heading_std is not None or kind.position_std_m is None:
        return beacon
    return replace(beacon, kind=replace(kind, heading_std=_SURE_HEADING))


def _nearest_beacon(search: BeaconSearch, place: Floats) -> str:
    if not search.beacons:
        return ""
    distance = [math.hypot(b.x - place[0], b.y - place[1]) for b in search.beacons]
    k = int(np.argmin(distance))
    name = search.beacons[k].id or f"number {k}"
    at = format_point(search.beacons[k].xy)
    return f"the beacon nearest to that place, {name} at {at}, is {distance[k]:.4g} m away"
