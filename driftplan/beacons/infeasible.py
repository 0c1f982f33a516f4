"""Why there is no layout: the words of an `InfeasibleError`, for someone who has to do something about it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftplan.beacons.covering import Cover, Outcome, cheapest_cover
from driftplan.beacons.placement_problem import PlacementProblem
from driftplan.beacons.requirements import DriftRequirements
from driftplan.beacons.tracks import Tracks

Bools = NDArray[np.bool_]

_NEAREST = 3  # candidates that are named


class Obstacle(NamedTuple):
    """A stretch of a route on which no candidate's reading lasts."""

    route: int
    start_m: float
    end_m: float
    least_drift: float  # rms that can be reached at the worst point of the stretch; a lower bound, exact for one kind
    sites: tuple[int, ...]  # those that come nearest to it, best first


def explain(problem: PlacementProblem, tracks: Tracks, limits: Sequence[float], cover: Cover, time_limit: float) -> str:
    """What to tell the user when ``cover`` has no layout."""
    if cover.outcome is not Outcome.INFEASIBLE:
        return (
            f"no layout was found in time, nor was it proven that there is none (costs below {cover.lower_bound:g} are "
            "ruled out): raise time_limit, or begin with a higher max_drift"
        )
    if cover.hopeless is not None and cover.hopeless.where[0] == -2:
        return (
            f"group {cover.hopeless.where[1]} demands more beacons than it has candidates outside the forbidden areas"
        )
    requirements = problem.requirements(tracks, limits)
    if cover.hopeless is not None:
        found = obstacle(problem, requirements, *cover.hopeless.where)
        named = ", ".join(
            f"{problem.sites[i].id} at ({problem.sites[i].x:g}, {problem.sites[i].y:g})" for i in found.sites
        )
        helped = f"; closest candidates: {named}" if named else "; no candidate's range is met before it"
        spare = "" if problem.task.redundancy == 1 else f" with any {problem.task.redundancy - 1} dead"
        return (
            f"route {found.route}, from {found.start_m:.2f} m to {found.end_m:.2f} m: no candidates keep the drift "
            f"under {limits[found.route]:g} m there{spare}, the least that can be reached is "
            f"{found.least_drift:.3g} m{helped}"
        )
    if problem.rules:
        free = cheapest_cover(
            problem.cost,
            requirements,
            demands=[*problem.demands, *requirements.rows()],
            fixed=problem.fixed,
            time_limit=time_limit,
        )
        if free.chosen is not None:
            number = int((free.chosen & ~problem.fixed).sum())
            return (
                f"no layout keeps the limit together with {', '.join(problem.rules)}; without them it takes {number} "
                f"beacons of cost {free.cost:g} (proven: at least {free.lower_bound:g})"
            )
    return f"no combination of the candidates keeps the limit; with all of them {_worst_with_all(problem, limits)}"


def obstacle(problem: PlacementProblem, requirements: DriftRequirements, route: int, slot: int) -> Obstacle:
    """The stretch around a slot that too few sites can hold, and what comes nearest to holding it."""
    tracks = requirements.tracks
    able = requirements.able(route)
    short = able < problem.task.redundancy
    short[: int(requirements.reach_of_start[route]) + 1] = False
    short[slot] = True
    begin = end = slot
    while begin > 0 and short[begin - 1]:
        begin -= 1
    while end + 1 < len(short) and short[end + 1]:
        end += 1
    distance = tracks.distances_of(route)
    last = min(end + 1, len(distance) - 1)
    best = [_nearest(requirements, route, j, problem.task.redundancy) for j in range(begin, end + 1)]
    least, sites = max(best, key=lambda pair: pair[0])
    return Obstacle(route, float(distance[begin]), float(distance[last]), least, sites)


def _nearest(requirements: DriftRequirements, route: int, slot: int, redundancy: int) -> tuple[float, tuple[int, ...]]:
    """Least rms at a slot's end that survives the deaths allowed, and the sites whose readings give the least."""
    site, square, at_start = requirements.least_squares(route, slot)
    order = np.lexsort((site, square))
    ranked = square[order]
    least = ranked[redundancy - 1] if len(ranked) >= redundancy else np.inf
    return float(np.sqrt(min(at_start, least))), tuple(site[order][:_NEAREST].tolist())


def _worst_with_all(problem: PlacementProblem, limits: Sequence[float]) -> str:
    task = problem.task
    worst = [task.worst(task.drift(r, problem.sites)) for r in range(len(task.routes))]
    over = [w / limit for w, limit in zip(worst, limits, strict=True)]
    r = int(np.argmax(over))
    return f"the greatest drift is {worst[r]:.3g} m on route {r}, whose limit is {limits[r]:g} m"
