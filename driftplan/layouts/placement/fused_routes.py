"""Routes as a fusing robot drives them: legs and possible readings in order, and where a set of living sites fails.

A route is cut where anything can be read and where it turns. Along a straight run tr P is a convex function of the
metres driven (its second derivative is 2 P_θθ + 2 q_h s), and it only grows in a turn on the spot: its maximum lies at
an end of a leg. A limit that holds on arrival at every border, before the readings there, holds everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.layouts.placement.tracks import Tracks
from driftplan.model.covariance import Legs, legs
from driftplan.model.filter_state import FilterState, LegColumns, Row, heading_row, position_rows
from driftplan.model.fixes import Fix

NEVER = -1  # stands for a border at which a limit fails where none does
_ROUNDING = 1e-9  # relative, of tr P


@dataclass(frozen=True, slots=True)
class FusedReading:
    """What is measured when a site is read, and the chance that it is (None: certain)."""

    site: int
    rows: tuple[Row, ...]
    chance: float | None


@dataclass(frozen=True, eq=False)
class FusedRoute:
    """One route with all that could be read on it.

    Attributes
    ----------
    start : FilterState
    legs : Legs, shape (m,)
    readings : for every border, m + 1 of them, the readings there in order
    distance : (m + 1,), metres driven
    most : float
        The limit on tr P, m².
    """

    start: FilterState
    legs: Legs
    readings: tuple[tuple[FusedReading, ...], ...]
    distance: Floats
    most: float

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
    def _lever(self) -> Floats:
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
    def _unaided_trace(self) -> Floats:
        return np.array([P[0] + P[3] for P in self._unaided])

    @cached_property
    def _levers(self) -> list[tuple[float, float]]:
        return [(x, y) for x, y in self._lever.tolist()]

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

    def breach(self, alive: AbstractSet[int]) -> int:
        """The first border at which the limit fails with these sites alive, or `NEVER`."""
        if self.start.trace > self.most:
            return 0
        state, here = self.read(self.start, 0, alive), 0
        for stop in [*self.stops(alive, 0, self.end), self.end]:
            over = np.flatnonzero(self._traces(state, here, stop) > self.most)
            if len(over):
                return here + 1 + int(over[0])
            state, here = self.read(self.driven(state, here, stop), stop, alive), stop
        return NEVER

    def fails_at(self, state: FilterState, first: int, last: int, alive: AbstractSet[int]) -> bool:
        """Whether the limit fails at ``last``, from ``state`` after the readings at ``first``, whatever is between."""
        here = first
        for stop in self.stops(alive, first, last):
            state, here = self.read(self.driven(state, here, stop), stop, alive), stop
        return bool(self.driven(state, here, last).trace > self.most)

    def worst(self, alive: AbstractSet[int]) -> float:
        """Greatest rms anywhere, metres."""
        square, state, here = float(self.start.trace), self.read(self.start, 0, alive), 0
        for stop in [*self.stops(alive, 0, self.end), self.end]:
            square = max(square, float(self._traces(state, here, stop).max(initial=0.0)))
            state, here = self.read(self.driven(state, here, stop), stop, alive), stop
        return float(np.sqrt(square))

    def _traces(self, state: FilterState, first: int, last: int) -> Floats:
        """tr P at the borders after ``first`` up to ``last`` when nothing is read between, (last - first,)."""
        Dxx, Dxt, Dyy, Dyt, Dtt = (state.P[k] - self._unaided[first][k] for k in (0, 2, 3, 4, 5))
        x, y = (self._lever[first + 1 : last + 1] - self._lever[first]).T
        turned = 2 * (Dxt * x + Dyt * y) + Dtt * (x * x + y * y)
        return np.asarray(self._unaided_trace[first + 1 : last + 1] + (Dxx + Dyy) + turned)

    def unread(self) -> list[tuple[int, int]]:
        """Stretches that fail in the best of cases when nothing is read inside them, as short as they come.

        Returns
        -------
        list of first, last : int
            Borders: something has to be read at one of first … last - 1, or the limit fails at last.
        """
        starts = [(self.start, 0), *((state, border) for border, state in enumerate(self.best[:-1]))]
        until = [0] if self.start.trace > self.most else []
        for state, border in starts[len(until) :]:
            over = np.flatnonzero(self._traces(state, border, self.end) > self.most)
            until.append(border + 1 + int(over[0]) if len(over) else NEVER)
        later = [*until[1:], NEVER]
        return [(first, last) for first, (last, next_) in enumerate(zip(until, later, strict=True)) if last not in (NEVER, next_)]


def fused_routes(
    tracks: Tracks, sites: Sequence[Beacon], start_fix: Fix | None, headings: Floats, limits_m: Sequence[float]
) -> tuple[FusedRoute, ...]:
    """The routes of ``tracks``; ``headings`` at their starts, rad, ``limits_m`` on their rms."""
    rows = [_rows_of(beacon) for beacon in sites]
    found = []
    for r, limit in enumerate(limits_m):
        pieces, events = tracks.pieces_of(r), tracks.events_of(r)
        turns = np.angle(tracks.pieces.u[pieces])
        before = headings[r] + np.cumsum(turns) - turns
        length = tracks.length[pieces]
        at: list[list[FusedReading]] = [[] for _ in range(len(length) + 1)]
        for border, site, chance in zip(
            *(x[events].tolist() for x in (tracks.border, tracks.site, tracks.chance)), strict=True
        ):
            at[border].append(FusedReading(site, rows[site], None if chance == 1 else chance))
        found.append(
            FusedRoute(
                start=_start(start_fix),
                legs=legs(before, turns, length, np.zeros(len(length)), tracks.noises, tracks.noise_of[pieces]),
                readings=tuple(tuple(here) for here in at),
                distance=tracks.distances_of(r),
                most=float(limit) ** 2 * (1 + _ROUNDING),
            )
        )
    return tuple(found)


def _rows_of(beacon: Beacon) -> tuple[Row, ...]:
    kind = beacon.kind
    rows: tuple[Row, ...] = ()
    if kind.position_std_m is not None:
        rows += position_rows(kind.position_std_m**2 * np.eye(2))
    if kind.heading_std is not None:
        rows += (heading_row(kind.heading_std**2),)
    return rows


def _start(fix: Fix | None) -> FilterState:
    pose = np.zeros((3, 3))
    if fix is not None:
        pose[:2, :2] = 0.0 if fix.position_cov is None else fix.position_cov
        pose[2, 2] = 0.0 if fix.heading_std is None else fix.heading_std**2
    return FilterState.at_start(pose)
