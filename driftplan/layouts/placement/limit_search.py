"""Cheapest covers of one problem for one limit after another, on the same tables and against one clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from copy import copy
from functools import cached_property
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Bools
from driftplan.layouts.placement.covering import Cover, Outcome, cheapest_cover
from driftplan.layouts.placement.cut_pool import Cut
from driftplan.layouts.placement.drives import drives_of, worst_squares
from driftplan.layouts.placement.failures import worst_of_failures
from driftplan.layouts.placement.fused_requirements import FusedRequirements
from driftplan.layouts.placement.fused_routes import FusedRoute
from driftplan.layouts.placement.interval_moments import IntervalMoments
from driftplan.layouts.placement.problem import PlacementProblem
from driftplan.layouts.placement.requirements import DriftRequirements
from driftplan.layouts.placement.route_table import RouteTable

Progress = Callable[[float, float, float], None]


class LeastFactor(NamedTuple):
    """The layout that keeps its limits times the least factor."""

    chosen: Bools
    factor: float
    ruled_out: float  # no layout keeps its limits times this
    proven: bool  # whether the two are as near as was asked for


class LimitSearch:
    """Layouts of a problem that keep a limit, or come nearest to keeping it.

    Parameters
    ----------
    problem : PlacementProblem
    table : the problem's, fine enough for the limits
    deadline : when to stop, by the monotonic clock
    progress : called with seconds, cost and lower bound of the cover that is being looked for
    """

    def __init__(self, problem: PlacementProblem, table: RouteTable, deadline: float, progress: Progress | None = None):
        self.problem, self.table, self.deadline, self.progress = problem, table, deadline, progress

    def like(self, problem: PlacementProblem, deadline: float) -> LimitSearch:
        """The same tables for other rules."""
        other = copy(self)
        other.problem, other.deadline = problem, deadline
        return other

    @cached_property
    def _intervals(self) -> IntervalMoments:
        return IntervalMoments(self.table)

    def cover(
        self,
        limits: Sequence[float] | None,
        *,
        ruled: bool = True,
        hint: Bools | None = None,
        stop_at_first: bool = False,
    ) -> Cover:
        """The cheapest layout that keeps the limits (None: whatever its drift) and, if ``ruled``, the rules."""
        problem = self.problem
        requirements = None if limits is None else self.requirements(limits)
        if hint is None and isinstance(requirements, FusedRequirements):
            hint = requirements.driven_along(problem.fixed)
        return cheapest_cover(
            problem.cost,
            requirements or _Anything(),
            demands=[*problem.demands, *([] if requirements is None else requirements.rows())],
            caps=problem.caps if ruled else (),
            fixed=problem.fixed,
            hint=hint,
            separate=requirements.cuts_beyond if isinstance(requirements, FusedRequirements) else None,
            stop_at_first=stop_at_first,
            time_limit=max(self.deadline - time.monotonic(), 0.01),
            progress=self.progress,
        )

    def requirements(self, limits: Sequence[float]) -> DriftRequirements | FusedRequirements:
        """What the limits demand."""
        return self.problem.requirements(self.table, limits)

    def excess(self, limits: Sequence[float], chosen: Bools) -> float:
        """The greatest drift over its limit, on any route, with the beacons dead that may be."""
        scenario = self.problem.scenario
        if scenario.confidence is not None:
            beacons = (*self.problem.existing, *self.problem.chosen(chosen))
            return float((worst_of_failures(scenario, beacons, np.inf) / np.array(limits)).max())
        drives = drives_of(self.table, chosen, np.arange(len(limits)), scenario.redundancy)
        return float((np.sqrt(worst_squares(self._intervals, drives)) / np.array(limits)[drives.route]).max())

    def least_factor(self, limits: Sequence[float], start: Bools, ruled_out: float, tolerance: float) -> LeastFactor:
        """By bisection: every step proves a factor out of reach or finds a layout below it."""
        best, factor = start, self.excess(limits, start)
        while factor - ruled_out > tolerance * factor:
            middle = 0.5 * (ruled_out + factor)
            cover = self.cover([middle * limit for limit in limits], hint=best, stop_at_first=True)
            if cover.chosen is not None:
                best, factor = cover.chosen, min(self.excess(limits, cover.chosen), middle)
            elif cover.outcome is Outcome.INFEASIBLE:
                ruled_out = middle
            else:
                return LeastFactor(best, factor, ruled_out, False)
        return LeastFactor(best, factor, ruled_out, True)


class FusedLimitSearch(LimitSearch):
    """The same for a robot that fuses its readings."""

    def __init__(
        self,
        problem: PlacementProblem,
        routes: tuple[FusedRoute, ...],
        deadline: float,
        progress: Progress | None = None,
    ):
        self.problem, self.routes, self.deadline, self.progress = problem, routes, deadline, progress

    def requirements(self, limits: Sequence[float]) -> FusedRequirements:
        return FusedRequirements(self.routes, limits, self.problem.scenario.redundancy)

    def excess(self, limits: Sequence[float], chosen: Bools) -> float:
        return self.requirements(limits).excess(chosen)


class _Anything:
    """An oracle that accepts every layout."""

    def cuts(self, chosen: Bools, near: int | None = None) -> list[Cut]:
        return []
