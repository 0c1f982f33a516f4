"""Routes as a fusing robot drives them: legs and possible readings in order, and where a set of living sites fails.

A route is cut where anything can be read, where it turns, and between a turn and the run after it; before all there is
a leg of no length, so that what is read at the start counts before the limit does. Along a straight run tr P is a
convex function of the metres driven (its second derivative is 2 P_θθ + 2 q_h s), and it only grows in a turn on the
spot: its maximum lies at an end of a leg. A limit that holds on arrival at every border, before the readings there,
holds everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.readings import floor_of
from driftplan.layouts.placement.route_table import SegmentedRoute
from driftplan.layouts.scenario import Scenario
from driftplan.model.covariance import Legs, legs
from driftplan.model.filter_state import FilterState, LegColumns, Row
from driftplan.model.fusion import belief_at_start
from driftplan.model.readings import Readings

NEVER = -1  # stands for a border at which a limit fails where none does


@dataclass(frozen=True, slots=True)
class FusedReading:
    """What is measured when a site is read, and the chance that it is (None: certain)."""

    site: int
    rows: tuple[Row, ...]
    chance: float | None


@dataclass(frozen=True, eq=False)
class FusedRoute:
    """One route with all that could be read on it."""

    start: FilterState
    legs: Legs  # (m,)
    readings: tuple[tuple[FusedReading, ...], ...]  # for every border, m + 1 of them, the readings there in order
    distance: Floats  # (m + 1,), metres driven

    @cached_property
    def sites(self) -> frozenset[int]:
        """All that could be read."""
        return frozenset(self.borders_of)

    @cached_property
    def borders_of(self) -> dict[int, list[int]]:
        """Where each site is read."""
        found: dict[int, list[int]] = {}
        for border, here in enumerate(self.readings):
            for site in {reading.site for reading in here}:
                found.setdefault(site, []).append(border)
        return found

    @property
    def end(self) -> int:
        """The last border."""
        return len(self.readings) - 1

    @cached_property
    def _unaided(self) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
        """At every border, when a perfectly known robot drives there and reads nothing, the covariance, and the
        transition of position by heading."""
        state = FilterState.at_start()
        found: list[tuple[tuple[float, ...], tuple[float, ...]]] = []
        lever = np.concatenate([np.zeros((1, 2)), np.cumsum(self.legs.A[:, :2, 2], axis=0)]).tolist()
        for (x, y), leg in zip(lever, [*self.legs.columns(), None], strict=True):
            found.append((state.P, (x, y)))
            state = state if leg is None else state.driven(leg)
        return found

    @cached_property
    def _unaided_columns(self) -> Floats:
        """The same as arrays, six rows and two, (8, m + 1)."""
        return np.array([(*P, *lever) for P, lever in self._unaided]).T

    def _at(self, border: Any) -> tuple[Any, Any]:
        """The same at one border in Python's numbers, or at an array of them."""
        if isinstance(border, int):
            return self._unaided[border]
        columns = self._unaided_columns[:, border]
        return columns[:6], columns[6:]

    def driven(self, state: FilterState, first: Any, last: Any) -> FilterState:
        """On arrival at border ``last``, from ``state`` after the readings at ``first``, with none in between.

        With U the covariances of a drive without readings, P grows to A (P - U_first) Aᵀ + U_last. Of many drives at
        once where the borders are arrays.
        """
        (before, (x0, y0)), (after, (x1, y1)) = self._at(first), self._at(last)
        excess = tuple(p - u for p, u in zip(state.P, before, strict=True))
        return FilterState(excess).driven(LegColumns((x1 - x0, y1 - y0), tuple(after), None))

    def traces(self, state: FilterState, first: Any, ends: Any) -> Floats:
        """tr P at borders ``ends`` when nothing is read between ``first`` and these; columns (n, 1) of states and
        borders give (n, ends)."""
        before, (x0, y0) = self._at(first)
        xx, _, xt, yy, yt, tt = (p - u for p, u in zip(state.P, before, strict=True))
        (ux, _, _, uy, _, _), (x, y) = self._at(ends)
        x, y = x - x0, y - y0
        return np.asarray(ux + uy + (xx + yy) + 2 * (xt * x + yt * y) + tt * (x * x + y * y))

    def first_over(self, state: FilterState, first: int, limit: float, last: int | None = None) -> int:
        """The first border at which tr P exceeds ``limit`` (m²) when nothing is read after ``first``, or `NEVER`."""
        last = self.end if last is None else last
        over = np.flatnonzero(self.traces(state, first, slice(first + 1, last + 1)) > limit)
        return first + 1 + int(over[0]) if len(over) else NEVER

    def read(self, state: FilterState, border: int, alive: AbstractSet[int]) -> FilterState:
        """After the readings at a border."""
        for reading in self.readings[border]:
            if reading.site in alive:
                state = state.read(reading.rows, reading.chance)
        return state

    def hops(
        self, state: FilterState, first: int, last: int, alive: AbstractSet[int]
    ) -> Iterator[tuple[FilterState, int, int]]:
        """The way from border to border at which one of these sites is read, from ``state`` after the readings at
        ``first``: the states after the readings where hops begin, and the borders where they begin and end."""
        borders = (border for site in alive & self.sites for border in self.borders_of[site])
        for stop in sorted({border for border in borders if first < border < last}):
            yield state, first, stop
            state, first = self.read(self.driven(state, first, stop), stop, alive), stop
        yield state, first, last

    @cached_property
    def best(self) -> list[FilterState]:
        """The state after the readings at every border when all sites live: no set of sites gives a better one."""
        state = self.read(self.start, 0, self.sites)
        found = [state]
        for border in range(1, self.end + 1):
            state = self.read(self.driven(state, border - 1, border), border, self.sites)
            found.append(state)
        return found

    def breach(self, alive: AbstractSet[int], limit: float) -> int:
        """The first border at which tr P exceeds ``limit`` (m²) with these sites alive, or `NEVER`."""
        for hop in self.hops(self.read(self.start, 0, alive), 0, self.end, alive):
            border = self.first_over(*hop[:2], limit, hop[2])
            if border != NEVER:
                return border
        return NEVER

    def arriving(self, state: FilterState, first: int, last: int, alive: AbstractSet[int]) -> FilterState:
        """On arrival at ``last``, from ``state`` after the readings at ``first``, with these sites alive."""
        *_, hop = self.hops(state, first, last, alive)
        return self.driven(*hop)

    def worst(self, alive: AbstractSet[int]) -> float:
        """Greatest rms anywhere, metres."""
        hops = self.hops(self.read(self.start, 0, alive), 0, self.end, alive)
        squares = (self.traces(state, here, slice(here + 1, stop + 1)) for state, here, stop in hops)
        return float(np.sqrt(max(square.max(initial=0.0) for square in squares)))

    def unread(self, limit: float) -> list[tuple[int, int]]:
        """Stretches that fail in the best of cases when nothing is read inside them, as short as they come: borders
        (first, last), and something has to be read at one of first … last - 1, or the limit fails at last."""
        until = [self.first_over(self.start, 0, limit)]
        until += [self.first_over(state, border, limit) for border, state in enumerate(self.best[:-1])]
        later = [*until[1:], NEVER]
        stretches = enumerate(zip(until, later, strict=True))
        return [(first, last) for first, (last, next_) in stretches if last not in (NEVER, next_)]


def fused_routes(scenario: Scenario, readings: Sequence[Readings]) -> tuple[FusedRoute, ...]:
    """The routes of a scenario with the readings on each (`Scenario.readings`); no odometry with a known systematic
    error, which a filter does not correct: then more beacons may be worse."""
    start, found = belief_at_start(scenario.start_fix), []
    for path, here in zip(scenario.routes, readings, strict=True):
        segmented = SegmentedRoute(*floor_of(path, scenario.noise, scenario.world), here)
        route = _route(segmented, complex(*path[0]), start)
        if route.legs.shift.any():
            raise ValueError(
                "expected odometry without a known systematic error (heading_bias_per_m, heading_bias_per_rad, "
                "distance_scale_error) for estimator='filter': calibrate it away, or place with estimator='reset'"
            )
        found.append(route)
    return tuple(found)


def _route(route: SegmentedRoute, begin: complex, start: FilterState) -> FusedRoute:
    turn, length = np.append(0.0, route.turn), np.append(0.0, route.length)
    which = np.append(route.noise_of[:1], route.noise_of)
    driven = legs(route.heading + np.cumsum(turn) - turn, turn, length, np.zeros(len(turn)), route.noises, which)
    position = begin + np.concatenate([[0.0], np.cumsum(driven.moves)])
    here: list[list[FusedReading]] = [[] for _ in position]
    borders = route.breakpoint + (route.breakpoint > 0)
    read = route.readings.rows(position[borders])
    for border, source, (rows, chance) in zip(borders.tolist(), route.readings.source.tolist(), read, strict=True):
        here[border].append(FusedReading(source, rows, chance))
    return FusedRoute(start, driven, tuple(map(tuple, here)), np.concatenate([[0.0], np.cumsum(length)]))
