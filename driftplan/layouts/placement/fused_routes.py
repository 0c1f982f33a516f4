"""Routes as a fusing robot drives them: legs and possible readings in order, and where a set of living sites fails.

A route is cut where anything can be read and where it turns. Along a straight run tr P is a convex function of the
metres driven (its second derivative is 2 P_θθ + 2 q_h s), and it only grows in a turn on the spot: its maximum lies at
an end of a leg. A limit that holds on arrival at every border, before the readings there, holds everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from driftplan.arrays import Floats, Ints
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
    def columns(self) -> list[LegColumns]:
        """The legs one by one."""
        return self.legs.columns()

    def legs_of(self, which: Ints) -> Legs:
        """Some of the legs side by side, shape (1, k)."""
        return Legs(*(x[which][None] for x in (self.legs.A, self.legs.C, self.legs.shift)))

    @cached_property
    def sites(self) -> frozenset[int]:
        """All that could be read."""
        return frozenset(reading.site for here in self.readings for reading in here)

    @cached_property
    def borders_of(self) -> dict[int, list[int]]:
        """Where each site is read."""
        found: dict[int, list[int]] = {}
        for border, here in enumerate(self.readings):
            for reading in here:
                found.setdefault(reading.site, []).append(border)
        return found

    @cached_property
    def best(self) -> list[FilterState]:
        """The state after the readings at every border when all sites live: no set of sites gives a better one."""
        state, found = self.read(self.start, 0, self.sites), []
        for border in range(len(self.columns)):
            found.append(state)
            state = self.read(state.driven(self.columns[border]), border + 1, self.sites)
        return [*found, state]

    def read(self, state: FilterState, border: int, alive: frozenset[int] | set[int]) -> FilterState:
        """After the readings at a border."""
        for reading in self.readings[border]:
            if reading.site in alive:
                state = state.read(reading.rows, reading.chance)
        return state

    def breach(self, alive: frozenset[int] | set[int]) -> int:
        """The first border at which the limit fails with these sites alive, or `NEVER`."""
        if self.start.trace > self.most:
            return 0
        return self.breach_from(self.read(self.start, 0, alive), 0, len(self.columns), alive)

    def breach_from(self, state: FilterState, border: int, last: int, alive: frozenset[int] | set[int]) -> int:
        """The same on the way from ``border``, in ``state`` after the readings there, to ``last``."""
        columns, readings, most = self.columns, self.readings, self.most
        for here in range(border + 1, last + 1):
            state = state.driven(columns[here - 1])
            if state.trace > most:
                return here
            for reading in readings[here]:
                if reading.site in alive:
                    state = state.read(reading.rows, reading.chance)
        return NEVER

    def fails_at(self, state: FilterState, border: int, last: int, alive: frozenset[int] | set[int]) -> bool:
        """Whether the limit fails at ``last``, on the way from ``border`` in ``state``, whatever is between."""
        for here in range(border + 1, last):
            state = self.read(state.driven(self.columns[here - 1]), here, alive)
        return bool(state.driven(self.columns[last - 1]).trace > self.most)

    def worst(self, alive: frozenset[int] | set[int]) -> float:
        """Greatest rms anywhere, metres."""
        square, state = float(self.start.trace), self.read(self.start, 0, alive)
        for border, leg in enumerate(self.columns, start=1):
            state = state.driven(leg)
            square = max(square, float(state.trace))
            state = self.read(state, border, alive)
        return float(np.sqrt(square))

    def unread(self) -> Iterator[tuple[int, int]]:
        """Stretches that fail in the best of cases when nothing is read inside them, as short as they come.

        Yields
        ------
        first, last : int
            Borders: something has to be read at one of first … last - 1, or the limit fails at last.
        """
        until = [self.start_unread(), *self._farthest().tolist()]
        for first, last in enumerate(until):
            later = until[first + 1] if first + 1 < len(until) else NEVER
            if last != NEVER and last != later:
                yield first, last

    def start_unread(self) -> int:
        """Where the limit fails when nothing is ever read."""
        return 0 if self.start.trace > self.most else self.breach_from(self.start, 0, len(self.columns), frozenset())

    def _farthest(self) -> Ints:
        """For every border, in the best state there, the border at which the limit fails when nothing is read."""
        m = len(self.columns)
        found = np.full(m, NEVER)
        states = np.array([state.P for state in self.best[:m]]).reshape(m, -1)
        going = np.arange(m)
        for step in range(m):
            (leg,) = self.legs_of(going + step).columns()
            state = FilterState(tuple(states.T)).driven(leg)
            over = state.trace > self.most
            found[going[over]] = going[over] + step + 1
            on = ~over & (going + step + 1 < m)
            going, states = going[on], np.stack(state.P, axis=-1)[on]
            if not len(going):
                break
        return found


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
