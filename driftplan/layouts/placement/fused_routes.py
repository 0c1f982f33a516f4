"""Routes as a fusing robot drives them: legs and possible readings in order, and where a set of living sites fails.

A route is cut where anything can be read, where it turns, and between a turn and the run after it; before all there is
a leg of no length, so that what is read at the start counts before the limit does. Along a straight run tr P is a
convex function of the metres driven (its second derivative is 2 P_θθ + 2 q_h s), and it only grows in a turn on the
spot: its maximum lies at an end of a leg. A limit that holds on arrival at every border, before the readings there,
holds everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import BeaconColumns, floor_of, readings_on
from driftplan.layouts.scenario import Scenario
from driftplan.model.covariance import Legs, legs
from driftplan.model.filter_state import FilterState, LegColumns, Row
from driftplan.model.fusion import belief_at_start
from driftplan.model.noise import Noises, noise_of_legs
from driftplan.model.paths import read_path
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
    def lever(self) -> Floats:
        """Transition of position by heading from the start to every border, (m + 1, 2)."""
        return np.concatenate([np.zeros((1, 2)), np.cumsum(self.legs.A[:, :2, 2], axis=0)])

    @cached_property
    def _unaided(self) -> list[tuple[float, ...]]:
        """The covariance at every border when a perfectly known robot drives there and reads nothing."""
        state, found = FilterState.at_start(), []
        for leg in self.legs.columns():
            found.append(state.P)
            state = state.driven(leg)
        return [*found, state.P]

    @cached_property
    def unaided(self) -> Floats:
        """The same as upper triangles, (m + 1, 6)."""
        return np.array(self._unaided)

    @cached_property
    def _unaided_trace(self) -> Floats:
        return np.asarray(self.unaided[:, 0] + self.unaided[:, 3])

    @cached_property
    def _levers(self) -> list[tuple[float, float]]:
        return [(x, y) for x, y in self.lever.tolist()]

    def driven(self, state: FilterState, first: int, last: int) -> FilterState:
        """On arrival at border ``last``, from ``state`` after the readings at ``first``, with none in between.

        With U the covariances of a drive without readings, P grows to A (P - U_first) Aᵀ + U_last.
        """
        excess = tuple(p - u for p, u in zip(state.P, self._unaided[first], strict=True))
        (x0, y0), (x1, y1) = self._levers[first], self._levers[last]
        return FilterState(excess).driven(LegColumns((x1 - x0, y1 - y0), self._unaided[last], None))

    def read(self, state: FilterState, border: int, alive: AbstractSet[int]) -> FilterState:
        """After the readings at a border."""
        for reading in self.readings[border]:
            if reading.site in alive:
                state = state.read(reading.rows, reading.chance)
        return state

    def stops(self, alive: AbstractSet[int], first: int, last: int) -> list[int]:
        """Borders after ``first`` and before ``last`` where one of these sites is read."""
        borders = (border for site in alive & self.sites for border in self.borders_of[site])
        return sorted({border for border in borders if first < border < last})

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
        return self.breach_from(self.read(self.start, 0, alive), 0, alive, limit)

    def breach_from(self, state: FilterState, first: int, alive: AbstractSet[int], limit: float) -> int:
        """The same from ``state`` after the readings at border ``first``."""
        here = first
        for stop in [*self.stops(alive, first, self.end), self.end]:
            over = np.flatnonzero(self._traces(state, here, stop) > limit)
            if len(over):
                return here + 1 + int(over[0])
            state, here = self.read(self.driven(state, here, stop), stop, alive), stop
        return NEVER

    def arriving(self, state: FilterState, first: int, last: int, alive: AbstractSet[int]) -> FilterState:
        """On arrival at ``last``, from ``state`` after the readings at ``first``, with these sites alive."""
        here = first
        for stop in self.stops(alive, first, last):
            state, here = self.read(self.driven(state, here, stop), stop, alive), stop
        return self.driven(state, here, last)

    def worst(self, alive: AbstractSet[int]) -> float:
        """Greatest rms anywhere, metres."""
        square, state, here = 0.0, self.read(self.start, 0, alive), 0
        for stop in [*self.stops(alive, 0, self.end), self.end]:
            square = max(square, float(self._traces(state, here, stop).max(initial=0.0)))
            state, here = self.read(self.driven(state, here, stop), stop, alive), stop
        return float(np.sqrt(square))

    def _traces(self, state: FilterState, first: int, last: int) -> Floats:
        """tr P at the borders after ``first`` up to ``last`` when nothing is read between, (last - first,)."""
        Dxx, Dxt, Dyy, Dyt, Dtt = (state.P[k] - self._unaided[first][k] for k in (0, 2, 3, 4, 5))
        x, y = (self.lever[first + 1 : last + 1] - self.lever[first]).T
        turned = 2 * (Dxt * x + Dyt * y) + Dtt * (x * x + y * y)
        return np.asarray(self._unaided_trace[first + 1 : last + 1] + (Dxx + Dyy) + turned)

    def unread(self, limit: float) -> list[tuple[int, int]]:
        """Stretches that fail in the best of cases when nothing is read inside them, as short as they come.

        Returns
        -------
        list of first, last : int
            Borders: something has to be read at one of first … last - 1, or the limit fails at last.
        """
        until = []
        for state, border in [(self.start, 0), *((state, border) for border, state in enumerate(self.best[:-1]))]:
            over = np.flatnonzero(self._traces(state, border, self.end) > limit)
            until.append(border + 1 + int(over[0]) if len(over) else NEVER)
        later = [*until[1:], NEVER]
        return [
            (first, last)
            for first, (last, next_) in enumerate(zip(until, later, strict=True))
            if last not in (NEVER, next_)
        ]


def fused_routes(scenario: Scenario, sites: Sequence[Beacon]) -> tuple[FusedRoute, ...]:
    """The routes of a scenario with the readings of all ``sites``.

    Raises
    ------
    ValueError
        For odometry with a known systematic error: a filter does not correct it, and then more beacons may be worse.
    """
    columns, start = BeaconColumns.of(sites), belief_at_start(scenario.start_fix)
    found = []
    for path in scenario.routes:
        readings = readings_on(path, columns, scenario.world)
        route = _route(*floor_of(path, scenario.noise, scenario.world), readings, start)
        if route.legs.shift.any():
            raise ValueError(
                "expected odometry without a known systematic error (heading_bias_per_m, heading_bias_per_rad, "
                "distance_scale_error) for estimator='filter': calibrate it away, or place with estimator='reset'"
            )
        found.append(route)
    return tuple(found)


def _route(path: Floats, noise: Noises, readings: Readings, start: FilterState) -> FusedRoute:
    runs = read_path(path)
    noises, which = noise_of_legs(noise, len(runs.lengths), 1)
    runs, at, old = runs.cut(readings.s_m)
    turns = runs.turns != 0
    parts = 1 + turns  # of a leg: its turn, its run
    first = 1 + np.concatenate([[0], np.cumsum(parts)])  # of a leg's parts, and the border where it begins
    turned, lengths = np.zeros(first[-1]), np.append(0.0, np.repeat(runs.lengths, parts))
    turned[first[:-1][turns]], lengths[first[:-1][turns]] = runs.turns[turns], 0.0
    headings = float(runs.heading) + np.cumsum(turned) - turned
    which = np.append(which[:1], np.repeat(np.repeat(which, np.diff(old)), parts))
    driven = legs(headings, turned, lengths, np.zeros(first[-1]), noises, which)
    positions = np.concatenate([[0.0], np.cumsum(driven.moves)]) + complex(runs.start)
    here: list[list[FusedReading]] = [[] for _ in positions]
    for k in np.lexsort((readings.source, readings.rank, at)).tolist():
        border = int(first[at[k]]) if at[k] else 0
        here[border].append(FusedReading(int(readings.source[k]), *readings.rows(k, complex(positions[border]))))
    distance = np.concatenate([[0.0], np.cumsum(lengths)])
    return FusedRoute(start, driven, tuple(tuple(some) for some in here), distance)
