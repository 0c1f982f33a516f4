"""Why there is no layout: the words of an `InfeasibleError`, for someone who has to do something about it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from driftplan.layouts.placement.covering import Cover, Outcome
from driftplan.layouts.placement.cut_pool import Cut
from driftplan.layouts.placement.failures import failures, worst_of_failures
from driftplan.layouts.placement.fused_requirements import FusedRequirements
from driftplan.layouts.placement.fused_routes import fused_routes
from driftplan.layouts.placement.limit_search import LeastFactor, LimitSearch
from driftplan.layouts.placement.problem import PlacementProblem
from driftplan.layouts.placement.requirements import DriftRequirements

_MAX_NEAREST_SITES = 3  # sites that are named
_MAX_NAMED_BEACONS = 6  # beacons of the layout that comes nearest
_FACTOR_TOLERANCE = 0.005  # relative: to which the least factor is found


class Obstacle(NamedTuple):
    """A stretch of a route on which no site's reading lasts."""

    route: int
    start_m: float
    end_m: float
    least_drift: float  # rms that can be reached at the worst point of the stretch; a lower bound, exact for one kind
    sites: tuple[int, ...]  # those that come nearest to it, best first


def explain(search: LimitSearch, limits: Sequence[float], cover: Cover) -> str:
    """What to tell the user when ``cover`` has no layout, and whether a robot that fuses its readings has one."""
    if cover.outcome is Outcome.INFEASIBLE and search.problem.scenario.estimator == "reset":
        return _why(search, limits, cover) + _if_fused(search.problem, limits)
    return _why(search, limits, cover)


def _if_fused(problem: PlacementProblem, limits: Sequence[float]) -> str:
    """Whether all sites together keep the limits of a robot that fuses its readings: then some layout does."""
    if problem.scenario.confidence is not None:
        return ""
    try:
        routes = fused_routes(problem.scenario, problem.sites)
    except ValueError:  # its odometry has a known systematic error
        return ""
    needs = FusedRequirements(routes, limits, problem.scenario.redundancy)
    if needs.holds(np.ones(len(problem.sites), dtype=bool)):
        return '; a robot that fuses its readings keeps the limit with these sites: estimator="filter"'
    return "; nor can a robot that fuses its readings"


def _why(search: LimitSearch, limits: Sequence[float], cover: Cover) -> str:
    problem = search.problem
    if cover.outcome is not Outcome.INFEASIBLE:
        ruled_out = f" (one would cost at least {cover.lower_bound:g})" if cover.lower_bound > 0 else ""
        return (
            f"no layout was found in time, nor was it proven that there is none{ruled_out}: raise time_limit, or begin "
            "with a higher max_drift"
        )
    if cover.hopeless is not None and cover.hopeless.where[0] == -2:
        return f"group {cover.hopeless.where[1]} demands more beacons than it has sites outside the forbidden areas"
    if cover.hopeless is not None:
        needs = search.requirements(limits)
        if isinstance(needs, FusedRequirements):
            found = fused_obstacle(problem, needs, cover.hopeless)
        else:
            found = obstacle(problem, needs, *cover.hopeless.where)
        named = ", ".join(
            f"{problem.sites[i].id} at ({problem.sites[i].x:g}, {problem.sites[i].y:g})" for i in found.sites
        )
        helped = f"; closest sites: {named}" if named else "; no site's range is met before it"
        spare = "" if problem.scenario.redundancy == 1 else f" with any {problem.scenario.redundancy - 1} dead"
        confidence = problem.scenario.confidence
        score, least = ("drift", "least") if confidence is None else (f"{100 * confidence:g} % radius", "least rms")
        return (
            f"route {found.route}, from {found.start_m:.2f} m to {found.end_m:.2f} m: no sites keep the {score} "
            f"under {limits[found.route]:g} m there{spare}, the {least} that can be reached is "
            f"{found.least_drift:.3g} m{helped}"
        )
    if problem.rules:
        free = search.cover(limits, ruled=False)
        if free.chosen is not None:
            number = int((free.chosen & ~problem.fixed).sum())
            return (
                f"no layout keeps the limit together with {', '.join(problem.rules)}; without them it takes {number} "
                f"beacons of cost {free.cost:g} (proven: at least {free.lower_bound:g})"
            )
    return _words_about(problem, limits, search.least_factor(limits, problem.fixed, 1.0, _FACTOR_TOLERANCE))


def obstacle(problem: PlacementProblem, requirements: DriftRequirements, route: int, slot: int) -> Obstacle:
    """The stretch around a slot that too few sites can hold, and what comes nearest to holding it."""
    table = requirements.table
    able = requirements.able(route)
    short = able < problem.scenario.redundancy
    short[: int(requirements.last_slot_of_start[route]) + 1] = False
    short[slot] = True
    begin = end = slot
    while begin > 0 and short[begin - 1]:
        begin -= 1
    while end + 1 < len(short) and short[end + 1]:
        end += 1
    distance = table.distances_of(route)
    last = min(end + 1, len(distance) - 1)
    best = [_nearest(requirements, route, j, problem.scenario.redundancy) for j in range(begin, end + 1)]
    least, sites = max(best, key=lambda pair: pair[0])
    return Obstacle(route, float(distance[begin]), float(distance[last]), least, sites)


def fused_obstacle(problem: PlacementProblem, requirements: FusedRequirements, hopeless: Cut) -> Obstacle:
    """The stretch that all sites together cannot hold, but for those that may be dead, and the last ones before it."""
    r, border = hopeless.where
    route, scenario = requirements.routes[r], problem.scenario
    alive = sorted(route.sites.difference(hopeless.columns.tolist()))
    profile = scenario.drift(r, [problem.sites[i] for i in alive]).profile()
    beyond = profile.rms > requirements.limits_m[r]
    there = int(np.flatnonzero(beyond & (profile.distance <= route.distance[border]))[-1])
    first = there + 1 - int(np.argmin(np.append(beyond[: there + 1][::-1], False)))
    last = there + int(np.argmin(np.append(beyond[there:], False))) - 1
    before = [reading.site for here in route.readings[:border][::-1] for reading in here]
    return Obstacle(
        r,
        float(profile.distance[first]),
        float(profile.distance[last]),
        float(profile.rms[first : last + 1].max()),
        tuple(dict.fromkeys(before))[:_MAX_NEAREST_SITES],
    )


def _nearest(requirements: DriftRequirements, route: int, slot: int, redundancy: int) -> tuple[float, tuple[int, ...]]:
    """Least rms at a slot's end that survives the deaths allowed, and the sites whose readings give the least."""
    site, square, at_start = requirements.least_squares(route, slot)
    order = np.lexsort((site, square))
    ranked = square[order]
    least = ranked[redundancy - 1] if len(ranked) >= redundancy else np.inf
    return float(np.sqrt(min(at_start, least))), tuple(site[order][:_MAX_NEAREST_SITES].tolist())


def _words_about(problem: PlacementProblem, limits: Sequence[float], nearest: LeastFactor) -> str:
    """The words about the layout that comes nearest: where it breaks, by how much, and on which beacons."""
    scenario, beacons = problem.scenario, [problem.sites[i] for i in np.flatnonzero(nearest.chosen)]
    over = worst_of_failures(scenario, beacons, min(limits)) / np.array(limits)
    r = int(np.argmax(over))
    dead, drift = max(failures(scenario, beacons, r), key=lambda pair: scenario.worst(pair[1]))
    profile = drift.profile()
    beyond = scenario.score(profile) > limits[r]
    where = profile.distance[beyond] if beyond.any() else profile.distance[[int(np.argmax(scenario.score(profile)))]]
    named = ", ".join(
        f"{b.id} at ({b.x:g}, {b.y:g})" for b in scenario.beacons_in_range(r, beacons)[:_MAX_NAMED_BEACONS]
    )
    lost = f" with {' and '.join(b.id for b in dead)} dead" if dead else ""
    helped = f", with {named} on this route" if named else ""
    reached = "the least that can be reached" if nearest.proven else "the best found"
    return (
        f"route {r}, from {where[0]:.2f} m to {where[-1]:.2f} m: no combination of the sites keeps all limits; "
        f"{reached} is {over[r] * limits[r]:.3g} m there{lost} against a limit of {limits[r]:g} m{helped}"
    )
