"""Why there is no layout: an `InfeasibleError` in words for someone who has to do something about it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from driftplan.arrays import Bools
from driftplan.errors import InfeasibleError, Stretch
from driftplan.layouts.placement.covering import Cover
from driftplan.layouts.placement.cut_pool import Cut
from driftplan.layouts.placement.drives import failures, worst_drifts
from driftplan.layouts.placement.fused_requirements import FusedRequirements
from driftplan.layouts.placement.problem import LeastFactor, LimitSearch, PlacementProblem
from driftplan.layouts.placement.requirements import DriftRequirements
from driftplan.planning.request import format_least
from driftplan.planning.status import Status

_MAX_NEAREST_SITES = 3  # sites that are named
_MAX_NAMED_BEACONS = 6  # beacons of the layout that comes nearest
_MAX_LOOKED = 50  # slots of a stretch: each takes as long as its route has slots before it
_FACTOR_TOLERANCE = 0.005  # relative: to which the least factor is found


class Obstacle(NamedTuple):
    """A stretch of a route on which no site's reading lasts."""

    stretch: Stretch
    least_drift: float  # rms that can be reached at the worst point of the stretch; a lower bound, exact for one kind
    sites: tuple[int, ...]  # those that come nearest to it, best first


def infeasible(
    search: LimitSearch, limits: Sequence[float], cover: Cover, *, even_for_the_mean: bool = False
) -> InfeasibleError:
    """What to tell the user when ``cover`` has no layout: why, whether a robot that fuses its readings has one, and the
    stretch that this is about."""
    problem, stretch = search.problem, None
    if cover.status is not Status.INFEASIBLE:
        ruled_out = f" (one would cost at least {cover.lower_bound:g})" if cover.lower_bound > 0 else ""
        to_do = "raise time_limit, or begin with a higher max_drift"
        why = f"no layout was found in time, nor was it proven that there is none{ruled_out}: {to_do}"
    elif cover.hopeless is not None and cover.hopeless.where[0] == -2:
        why = f"group {cover.hopeless.where[1]} demands more beacons than it has sites outside the forbidden areas"
    elif cover.hopeless is not None:
        needs = search.requirements(limits)
        if isinstance(needs, FusedRequirements):
            found = fused_obstacle(problem, needs, cover.hopeless)
        else:
            found = obstacle(problem, needs, cover.hopeless)
        limit, stretch = limits[found.stretch.route], found.stretch
        why = _about_obstacle(problem, found, limit)
    elif problem.rules and (free := search.cover(limits, ruled=False)).chosen is not None:
        number = int((free.chosen & ~problem.fixed).sum())
        why = (
            f"no layout keeps the limit together with {', '.join(problem.rules)}; without them it takes {number} "
            f"beacons of cost {free.cost:g} (proven: at least {free.lower_bound:g})"
        )
    else:
        nearest = search.least_factor(limits, problem.fixed, 1.0, _FACTOR_TOLERANCE)
        why, stretch = _about_nearest(problem, limits, nearest)
    if cover.status is Status.INFEASIBLE:
        why += _if_fused(problem, limits)
    mean = "systematic errors differ between drives, and no layout was found that keeps the limits for all: even for "
    return InfeasibleError(f"{mean}their mean {why}" if even_for_the_mean else why, stretch)


def _if_fused(problem: PlacementProblem, limits: Sequence[float]) -> str:
    """Whether all sites together keep the limits of a robot that fuses its readings: then some layout does."""
    if problem.scenario.estimator == "filter" or problem.scenario.confidence is not None:
        return ""
    try:
        routes = problem.stations.fused_routes(problem.scenario)
    except ValueError:  # its odometry has a known systematic error
        return ""
    if not FusedRequirements(routes, limits, problem.scenario.redundancy).cuts(np.ones(len(problem.sites), dtype=bool)):
        return '; a robot that fuses its readings keeps the limit with these sites: estimator="filter"'
    return "; nor can a robot that fuses its readings"


def _about_obstacle(problem: PlacementProblem, found: Obstacle, limit: float) -> str:
    """About a stretch that no site holds, and what beacons, or what spacing, might."""
    scenario, named = problem.scenario, _named(problem, found.sites)
    helped = f"; closest sites: {named}" if named else "; no site's range is met before it"
    spare = "" if scenario.redundancy == 1 else f" with any {scenario.redundancy - 1} dead"
    confidence = scenario.confidence
    score, least = ("drift", "least") if confidence is None else (f"{100 * confidence:g} % radius", "least rms")
    std_m = min(beacon.kind.position_std_m or 0.0 for beacon in problem.sites)
    xy, to_try = np.unique([beacon.xy for beacon in problem.sites], axis=0), ""
    if scenario.estimator == "reset" and confidence is None and limit <= 2**0.5 * std_m:
        own = f"{std_m:g} m per axis, an rms of sqrt(2) x {std_m:g} = {2**0.5 * std_m:.3g} m"
        to_try = f"; right after a reading the drift is that of the beacon itself, {own}: take more accurate ones"
    elif len(xy) > 1:
        apart = float(np.median(KDTree(xy).query(xy, k=2)[0][:, 1]))
        to_try = f"; sites are {apart:.3g} m apart here: try {apart / 2:.3g} m"
    return (
        f"{_said(found.stretch)}: no sites keep the {score} under {limit:g} m there{spare}, the {least} that can be "
        f"reached is {format_least(found.least_drift)}{helped}{to_try}"
    )


def _said(stretch: Stretch) -> str:
    return f"route {stretch.route}, from {stretch.from_m:.2f} m to {stretch.to_m:.2f} m"


def _about_nearest(problem: PlacementProblem, limits: Sequence[float], nearest: LeastFactor) -> tuple[str, Stretch]:
    """About the layout that comes nearest: where it breaks, by how much, and on which beacons."""
    scenario, chosen = problem.scenario, np.flatnonzero(nearest.chosen).tolist()
    beacons = [problem.sites[i] for i in chosen]
    cases = failures(scenario, beacons)
    worst = worst_drifts(scenario, beacons, cases)
    k = int(np.argmax(worst / np.array([limits[r] for r, _ in cases])))
    r, dead = cases[k]
    profile = scenario.drift(r, [b for i, b in enumerate(beacons) if i not in dead]).profile()
    score = scenario.score(profile)
    where = profile.distance[score > min(limits[r], score.max() * (1 - 1e-12))]
    met = [chosen[i] for i in scenario.beacons_in_range(r, beacons)]
    lost = f" with {' and '.join(beacons[i].id for i in dead)} dead" if dead else ""
    helped = f", with {_named(problem, met[:_MAX_NAMED_BEACONS])} on this route" if met else ""
    reached = "the least that can be reached" if nearest.proven else "the best found"
    stretch = Stretch(r, float(where[0]), float(where[-1]))
    return (
        f"{_said(stretch)}: no combination of the sites keeps all limits; {reached} is {format_least(worst[k])} "
        f"there{lost} against a limit of {limits[r]:g} m{helped}",
        stretch,
    )


def _named(problem: PlacementProblem, sites: Iterable[int]) -> str:
    return ", ".join(f"{problem.sites[i].id} at ({problem.sites[i].x:g}, {problem.sites[i].y:g})" for i in sites)


def obstacle(problem: PlacementProblem, requirements: DriftRequirements, hopeless: Cut) -> Obstacle:
    """The stretch around a slot that too few sites can hold, and what comes nearest to holding it."""
    (route, slot), redundancy = hopeless.where, problem.scenario.redundancy
    short = requirements.able(route) < redundancy
    short[: int(requirements.last_slot_of_start[route]) + 1] = False
    short[slot] = True
    begin, end = _around(slot, short)
    distance = requirements.table.distances_of(route)
    last = min(end + 1, len(distance) - 1)
    looked = np.unique([slot, *np.linspace(begin, end, _MAX_LOOKED).astype(int).tolist()]).tolist()
    best = (_nearest(requirements, route, j, redundancy) for j in looked)
    least, sites = max(best, key=lambda pair: pair[0])
    return Obstacle(Stretch(route, float(distance[begin]), float(distance[last])), least, sites)


def fused_obstacle(problem: PlacementProblem, requirements: FusedRequirements, hopeless: Cut) -> Obstacle:
    """The stretch that all sites together cannot hold, but for those that may be dead, and the last ones before it."""
    r, border = hopeless.where
    route, scenario = requirements.routes[r], problem.scenario
    alive = sorted(route.sites.difference(hopeless.columns.tolist()))
    drift = scenario.drift(r, [problem.sites[i] for i in alive])
    profile = drift.profile()
    beyond = profile.rms > requirements.limits_m[r]
    places = np.flatnonzero(beyond & (profile.distance <= route.distance[border]))
    if not len(places):  # broken by a turn on the spot, after which the profile looks
        places = np.array([min(np.searchsorted(profile.distance, route.distance[border]), len(beyond) - 1)])
        beyond[places] = True
    first, last = _around(int(places[-1]), beyond)
    before = dict.fromkeys(reading.site for here in route.readings[:border][::-1] for reading in here)
    stretch = Stretch(r, *profile.distance[[first, last]].tolist())
    least_m = float(profile.rms[first : last + 1].max())
    least_m = least_m if least_m > requirements.limits_m[r] else scenario.worst(drift)
    return Obstacle(stretch, least_m, tuple(before)[:_MAX_NEAREST_SITES])


def _around(k: int, which: Bools) -> tuple[int, int]:
    """First and last place of the stretch around place ``k`` in which all are of those."""
    others = np.flatnonzero(~which)
    return int(others[others < k].max(initial=-1)) + 1, int(others[others > k].min(initial=len(which))) - 1


def _nearest(requirements: DriftRequirements, route: int, slot: int, redundancy: int) -> tuple[float, tuple[int, ...]]:
    """Least rms at a slot's end that survives the deaths allowed, and the sites whose readings give the least."""
    site, square, at_start = requirements.least_squares(route, slot)
    order = np.lexsort((site, square))
    ranked = square[order]
    least = ranked[redundancy - 1] if len(ranked) >= redundancy else np.inf
    return float(np.sqrt(min(at_start, least))), tuple(site[order][:_MAX_NEAREST_SITES].tolist())
