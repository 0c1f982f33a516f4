"""Placement problems as the covering core wants them, and their cheapest covers for one limit after another."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import Bools, Floats, Ints, not_negative, whole
from driftplan.beacons.beacon import Beacon
from driftplan.layouts.placement.covering import Cover, Progress, cheapest_cover
from driftplan.layouts.placement.cut_pool import Cut
from driftplan.layouts.placement.drives import Limit, worst_of_failures
from driftplan.layouts.placement.fused_requirements import FusedRequirements
from driftplan.layouts.placement.fused_routes import FusedRoute, fused_routes
from driftplan.layouts.placement.requirements import DriftRequirements
from driftplan.layouts.placement.route_table import RouteTable, route_table
from driftplan.layouts.scenario import Scenario, SiteGroup, Sites
from driftplan.planning.status import Status

_MIN_LIMIT_SHARE = 0.02  # without a limit, perfect beacons: segments are cut for this share of the drift without any


class Stations:
    """Sites on routes, one by one, and what is read of them there: all that no limit and no rule changes, so that many
    placements can share it."""

    def __init__(self, scenario: Scenario, asked: Sites) -> None:
        self.asked, self.listed = asked, asked.listed(scenario.world, scenario.routes)
        self.beacons = (*self.listed.new, *self.listed.existing)
        self.readings = scenario.readings(self.beacons)  # on every route
        self._fused: tuple[tuple[Any, ...], tuple[FusedRoute, ...]] | None = None

    def fused_routes(self, scenario: Scenario) -> tuple[FusedRoute, ...]:
        """The routes for a robot that fuses; the last ones are kept."""
        key = scenario.noise, scenario.start_fix
        if self._fused is None or self._fused[0] != key:
            self._fused = key, fused_routes(scenario, self.readings)
        return self._fused[1]


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacementProblem:
    """Sites, what they cost, and which combinations are allowed."""

    scenario: Scenario
    stations: Stations
    cost: Floats  # (sites,), 0 for existing ones
    fixed: Bools  # (sites,) which exist
    demands: tuple[Cut, ...]  # as `covering.cheapest_cover` takes them
    caps: tuple[Cut, ...]  # likewise
    rules: tuple[str, ...]  # what the caps are, for messages

    @property
    def sites(self) -> tuple[Beacon, ...]:
        return self.stations.beacons

    @property
    def existing(self) -> tuple[Beacon, ...]:
        return self.stations.listed.existing

    def chosen(self, which: Bools) -> tuple[Beacon, ...]:
        """The new beacons of a layout."""
        return tuple(self.sites[i] for i in np.flatnonzero(which & ~self.fixed))


def placement_problem(
    scenario: Scenario, sites: Sites | Stations, *, max_beacons: int | None = None, budget: float | None = None
) -> PlacementProblem:
    """The problem that the arguments of `driftplan.layouts.place.place_beacons` describe."""
    stations = sites if isinstance(sites, Stations) else Stations(scenario, sites)
    listed, asked = stations.listed, stations.asked
    number = len(listed.new)
    new = np.arange(number)
    demands, caps, rules = _groups(asked.groups, listed.members)
    if max_beacons is not None:
        caps.append(Cut(new, -np.ones(number), -float(min(whole("max_beacons", max_beacons, least=0), number))))
        rules.append(f"max_beacons={max_beacons}")
    if budget is not None:
        caps.append(Cut(new, -listed.costs, -not_negative("budget", budget)))
        rules.append(f"budget={budget:g}")
    if asked.min_spacing_m > 0:
        caps += _too_close(stations.beacons, number, asked.min_spacing_m)
        rules.append(f"min_spacing_m={asked.min_spacing_m:g}")
    return PlacementProblem(
        scenario=scenario,
        stations=stations,
        cost=np.concatenate([listed.costs, np.zeros(len(listed.existing))]),
        fixed=np.arange(len(stations.beacons)) >= number,
        demands=tuple(demands),
        caps=tuple(caps),
        rules=tuple(rules),
    )


def _groups(groups: Sequence[SiteGroup], members: Sequence[Ints]) -> tuple[list[Cut], list[Cut], list[str]]:
    """Demands and caps of groups, and what they are."""
    demands, caps, rules = [], [], []
    for number, (group, columns) in enumerate(zip(groups, members, strict=True)):
        least = whole(f"group {number}: at_least", group.at_least, least=0)
        if least > 0:
            demands.append(Cut(columns, np.ones(len(columns)), float(least), (-2, number)))
        if group.at_most is not None:
            most = whole(f"group {number}: at_most", group.at_most, least=least)
            caps.append(Cut(columns, -np.ones(len(columns)), -float(most)))
            rules.append(f"group {number}: at_most={most}")
    return demands, caps, rules


def _too_close(sites: Sequence[Beacon], new: int, spacing_m: float) -> list[Cut]:
    """Caps that keep new sites apart from each other and from existing ones, as few as greedy cliques make them."""
    from scipy.spatial import cKDTree

    xy = np.array([[b.x, b.y] for b in sites])
    pairs = cKDTree(xy).query_pairs(spacing_m * (1 - 1e-9), output_type="ndarray")
    neighbours: dict[int, set[int]] = {}
    caps = []
    for i, j in pairs.tolist():
        if i < new <= j:
            caps.append(Cut(np.array([i]), -np.ones(1), 0.0))
        elif j < new:
            neighbours.setdefault(i, set()).add(j)
            neighbours.setdefault(j, set()).add(i)
    open_pairs = {i: {j for j in near if j > i} for i, near in neighbours.items()}
    for i in sorted(open_pairs):
        while open_pairs[i]:
            clique = [i, min(open_pairs[i])]
            for j in sorted(open_pairs[i]):
                if j not in clique and all(j in neighbours[c] for c in clique):
                    clique.append(j)
            for a in clique:
                open_pairs[a] -= set(clique)
            columns = np.array(sorted(clique), dtype=np.intp)
            caps.append(Cut(columns, -np.ones(len(columns)), -1.0))
    return caps


class LeastFactor(NamedTuple):
    """The layout that keeps its limits times the least factor."""

    chosen: Bools
    factor: float
    ruled_out: float  # no layout keeps its limits times this
    proven: bool  # whether the two are as near as was asked for


@dataclass(frozen=True, eq=False)
class LimitSearch:
    """Layouts of a problem that keep a limit, or come nearest to keeping it."""

    problem: PlacementProblem
    routes: RouteTable | tuple[FusedRoute, ...]  # the latter for a robot that fuses its readings
    deadline: float  # when to stop, by the monotonic clock
    progress: Progress  # called with seconds, cost and lower bound of the cover that is being looked for

    @classmethod
    def of(
        cls, problem: PlacementProblem, limit_m: float | None, deadline: float, progress: Progress = lambda *_: None
    ) -> LimitSearch:
        """On tables for the smallest limit that will be asked for (None: the smallest worth asking for)."""
        scenario = problem.scenario
        if scenario.estimator == "filter":
            return cls(problem, problem.stations.fused_routes(scenario), deadline, progress)
        if limit_m is None:  # no beacon is better than its own accuracy
            bare = max(scenario.worst(scenario.drift(r, problem.existing)) for r in range(len(scenario.routes)))
            stds = [b.kind.position_std_m or 0.0 for b in problem.sites]
            limit_m = max(min(stds) * 2**0.5, _MIN_LIMIT_SHARE * bare, 1e-6)
        return cls(problem, route_table(scenario, problem.stations.readings, limit_m), deadline, progress)

    def like(self, problem: PlacementProblem, deadline: float) -> LimitSearch:
        """The same tables for other rules."""
        return replace(self, problem=problem, deadline=deadline)

    def cover(
        self, limits: Sequence[float], *, ruled: bool = True, hint: Bools | None = None, stop_at_first: bool = False
    ) -> Cover:
        """The cheapest layout that keeps the limits and, if ``ruled``, the rules."""
        problem, needs = self.problem, self.requirements(limits)
        fused = needs if isinstance(needs, FusedRequirements) else None
        if fused and hint is None:
            hint = fused.driven_along(problem.fixed)
        return cheapest_cover(
            problem.cost,
            needs,
            demands=[*problem.demands, *needs.rows()],
            caps=problem.caps if ruled else (),
            fixed=problem.fixed,
            hint=hint,
            separate=fused.cuts_beyond if fused else None,
            stop_at_first=stop_at_first,
            time_limit=max(self.deadline - time.monotonic(), 0.01),
            progress=self.progress,
        )

    def requirements(self, limits: Sequence[float]) -> DriftRequirements | FusedRequirements:
        """What the limits, one per route, demand."""
        scenario, number = self.problem.scenario, len(self.problem.sites)
        if not isinstance(self.routes, RouteTable):
            return FusedRequirements(self.routes, limits, scenario.redundancy)
        limit = Limit(np.array(limits, dtype=float), scenario.confidence)
        return DriftRequirements(self.routes, number, limit, scenario.redundancy)

    def worst(self, chosen: Bools) -> Floats:
        """Greatest drift on every route with the beacons dead that may be, metres."""
        return worst_of_failures(self.problem.scenario, [self.problem.sites[i] for i in np.flatnonzero(chosen)])

    def excess(self, limits: Sequence[float], chosen: Bools) -> float:
        """The greatest drift over its limit, on any route."""
        return float((self.worst(chosen) / np.array(limits)).max())

    def least_factor(self, limits: Sequence[float], start: Bools, ruled_out: float, tolerance: float) -> LeastFactor:
        """By bisection: every step proves a factor out of reach or finds a layout below it."""
        best, factor = start, self.excess(limits, start)
        while factor - ruled_out > tolerance * factor:
            middle = 0.5 * (ruled_out + factor)
            cover = self.cover([middle * limit for limit in limits], hint=best, stop_at_first=True)
            if cover.chosen is not None:
                excess = self.excess(limits, cover.chosen)
                if self.problem.scenario.drives_differ and excess >= factor:  # no better on average over drives
                    return LeastFactor(best, factor, ruled_out, False)
                best = cover.chosen
                factor = excess if self.problem.scenario.drives_differ else min(excess, middle)
            elif cover.status is Status.INFEASIBLE:
                ruled_out = middle
            else:
                return LeastFactor(best, factor, ruled_out, False)
        return LeastFactor(best, factor, ruled_out, True)
