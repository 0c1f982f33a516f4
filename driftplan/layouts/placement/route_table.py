"""Route tables: routes as rows of segments of odometry and readings of possible beacons, in plain arrays.

A route is cut at every place where something can happen: at its waypoints, where the noise changes, where a beacon of
any site would be read, and wherever a segment would be too long for the drift between its ends to be bounded sharply.
What is left are *breakpoints* 0 … m and, between breakpoints t and t + 1, *segment* t: a turn on the spot or a straight
run. *Slot* t is what happens from breakpoint t, once its readings are done, to the arrival at breakpoint t + 1; slot m
is the end. An *interval* is the way from one reading to another.

Segments are so short that what E|e|² may rise above its chord between their ends (`driftplan.model.worst`) is at most
a ten-thousandth of the limit squared.

`IntervalMoments` has the element between any two breakpoints of a route at once, from sums along the route.

With u_k the true heading at breakpoint k, p_k its position, c_k and m_k the products of E r and E r² over the segments
before k, and q1_k, Q_k, Q2_k, κ_k, λ_k = E q, E|q|², E q², E[q conj r], E[q r] of segment k (q the way as odometry has
it, r the heading error it adds; `driftplan.model.moments`), the sums

    S_k = Σ c_l u_l q1_l        K_k = Σ u_l κ_l / conj(c_{l+1})      A_k = Σ Q_l + 2 Re[c_l conj(K_l) u_l q1_l]
                                L_k = Σ u_l m_l λ_l / c_{l+1}        P_k = Σ u_l² m_l Q2_l + 2 c_l L_l u_l q1_l

over l < k give, for the way from breakpoint e to breakpoint j, in the frame in which the route starts,

    E q = (S_j - S_e)/c_e         E|q|² = A_j - A_e - 2 Re[conj(K_e)(S_j - S_e)]      E[q conj r] = conj(c_j)(K_j - K_e)
                                  E q² = (P_j - P_e - 2 L_e (S_j - S_e))/m_e          E[q r] = c_j (L_j - L_e)/m_e.

The differences cancel to about 1e-16 of the route's extent squared, and lose more where the heading is all but
forgotten. On such routes the elements are composed instead, of those of 1, 2, 4, … segments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Complexes, Floats, Ints, bounded
from driftplan.beacons.readings import floor_of
from driftplan.layouts.scenario import Scenario
from driftplan.model.elements import of_legs
from driftplan.model.heading_laws import law_moments
from driftplan.model.moments import Moments, compose, identity
from driftplan.model.noise import Noises, OdometryNoise, noise_of_legs
from driftplan.model.paths import read_path
from driftplan.model.readings import Fix, Readings, Resets
from driftplan.model.worst import bend_rates

_MAX_SEGMENTS = 1e7
_SAG_SHARE = 1e-4  # greatest margin, as a share of the limit squared
_FORGOTTEN = 1e-3  # E r² under which the sums lose digits


@dataclass(frozen=True, slots=True, eq=False)
class RouteTable:
    """Routes and the readings of all sites on them. Sorted by route, breakpoint and, at one breakpoint, by accuracy."""

    first_segment: Ints  # (routes + 1,) where each route's segments begin; m segments have breakpoints 0 … m
    segments: Moments  # (segments,)
    bend: Floats  # (segments,) -(E|e|²)'' is at most ``bend * sqrt(E|e|²) + bend_fixed`` on the segment
    bend_fixed: Floats  # (segments,)
    length: Floats  # (segments,) metres
    noise_of: Ints  # (segments,) index into `noises`
    noises: tuple[OdometryNoise, ...]
    translation: Floats  # (segments,) E|e|² that a segment adds however good the heading is, m²
    distance: Floats  # (segments + routes,) metres driven at breakpoints; route r's begin at first_segment[r] + r
    start: Moments  # (routes,) errors at the start, in the robot's own frame
    first_reading: Ints  # (routes + 1,) where each route's readings begin
    breakpoint: Ints  # (events,) where a reading happens
    readings: Readings  # (events,) what is read, and what it makes of the errors; a source is a site
    resets: Resets
    heading_d1: Floats  # (events,) moments of the heading a reading gives; NaN where it gives none
    heading_d2: Floats

    @property
    def routes(self) -> int:
        return len(self.first_segment) - 1

    @property
    def site(self) -> Ints:
        """The site that gives each reading, (events,)."""
        return self.readings.source

    @property
    def slots(self) -> Ints:
        """Number of segments of each route, hence its last breakpoint and slot, (routes,)."""
        return np.diff(self.first_segment)

    @property
    def route(self) -> Ints:
        """Route of every event, (events,)."""
        return np.repeat(np.arange(self.routes), np.diff(self.first_reading))

    def readings_of(self, route: int) -> slice:
        return slice(*self.first_reading[route : route + 2].tolist())

    def segments_of(self, route: int) -> slice:
        return slice(*self.first_segment[route : route + 2].tolist())

    def distances_of(self, route: int) -> Floats:
        """Metres driven at the breakpoints of a route, (m + 1,)."""
        begin = int(self.first_segment[route]) + route
        return self.distance[begin : begin + int(self.slots[route]) + 1]

    def sags(self, segment: Ints) -> tuple[Floats, Floats]:
        """``bend`` and ``fixed`` of segments as `driftplan.model.worst.ceiling` takes them."""
        square = self.length[segment] ** 2 / 8
        return self.bend[segment] * square, self.bend_fixed[segment] * square

    def within(self, segment: Ints, parts: int) -> Moments:
        """Elements from the beginning of runs to ``parts`` - 1 evenly spaced points inside, (k, parts - 1)."""
        lengths = self.length[segment, None] * (np.arange(1, parts) / parts)
        turn = np.zeros(lengths.shape)
        return of_legs(turn, lengths, turn, self.noise_of[segment, None], self.noises)


def route_table(scenario: Scenario, readings: Sequence[Readings], least_limit_m: float = np.inf) -> RouteTable:
    """The routes of a scenario with the readings on each (`Scenario.readings`), for limits of at least so many m."""
    floors = (floor_of(path, scenario.noise, scenario.world) for path in scenario.routes)
    rows = [SegmentedRoute(*floor, here, least_limit_m) for floor, here in zip(floors, readings, strict=True)]
    return _joined(rows, scenario.start_fix)


class SegmentedRoute:
    """One route, cut; its readings sorted by breakpoint and, at one breakpoint, by accuracy."""

    def __init__(self, path: Floats, noise: Noises, readings: Readings, least_limit_m: float = np.inf) -> None:
        runs = read_path(path)
        self.heading = float(runs.heading)
        self.noises, which = noise_of_legs(noise, len(runs.lengths), 1)
        runs, at, old = runs.cut(readings.s_m)
        which = np.repeat(which, np.diff(old))
        bends = np.array([bend_rates(noise) for noise in self.noises])[which]
        share = (bends[:, 0] / least_limit_m + bends[:, 1] / least_limit_m**2) / 8  # of the limit², per metre squared
        pieces = np.maximum(1, np.ceil(runs.lengths * np.sqrt(share / _SAG_SHARE)))  # so that each one's sag is small
        bounded("segments of a route", float(pieces.sum()), _MAX_SEGMENTS, f"raise max_drift, here {least_limit_m:g} m")
        count, turns = pieces.astype(np.intp), runs.turns != 0
        first = np.concatenate([[0], np.cumsum(turns + count)])  # of a leg's segments: its turn, the parts of its run
        self.turn, self.length = np.zeros(first[-1]), np.repeat(runs.lengths / count, turns + count)
        self.turn[first[:-1][turns]] = runs.turns[turns]
        self.length[first[:-1][turns]] = 0.0
        self.noise_of = np.repeat(which, turns + count)
        self.distance = np.concatenate([[0.0], np.cumsum(self.length)])
        breakpoint = first[at]
        order = np.lexsort((readings.source, readings.rank, breakpoint))
        self.breakpoint, self.readings = breakpoint[order], readings[order]


def _joined(rows: list[SegmentedRoute], start_fix: Fix | None) -> RouteTable:
    """All routes in one set of arrays."""
    noises = list(dict.fromkeys(noise for row in rows for noise in row.noises))
    which = np.concatenate([np.array([noises.index(n) for n in row.noises])[row.noise_of] for row in rows])
    turn, length = (np.concatenate([getattr(row, name) for row in rows]) for name in ("turn", "length"))
    bends = np.array([bend_rates(noise) for noise in noises])[which]
    rates = ([noise.distance_var_per_m + noise.lateral_var_per_m, noise.distance_var_per_rad] for noise in noises)
    free = [not noise.heading_distance_corr for noise in noises]  # of the heading
    spreads = (np.array(list(rates)) * np.array(free)[:, None])[which]
    readings = sum((row.readings for row in rows), Readings.of([]))
    law, zero = law_moments("gaussian", readings.heading_var), np.zeros(len(rows))
    u = np.exp(1j * np.array([row.heading for row in rows]))
    start = Moments(u, zero, *([zero] * 8))  # no errors, or those of a fix, turned into the robot's own frame
    if start_fix is not None:
        start = Readings.of([start_fix]).resets()[0].apply(start)
    return RouteTable(
        first_segment=np.concatenate([[0], np.cumsum([len(row.length) for row in rows])]).astype(np.intp),
        segments=of_legs(turn, length, np.zeros(len(turn)), which, noises),
        bend=bends[:, 0] * (length > 0),
        bend_fixed=bends[:, 1] * (length > 0),
        length=length,
        noise_of=which,
        noises=tuple(noises),
        translation=spreads[:, 0] * length + spreads[:, 1] * np.abs(turn),
        distance=np.concatenate([row.distance for row in rows]),
        start=start.rotated(np.conj(u)),
        first_reading=np.concatenate([[0], np.cumsum([len(row.breakpoint) for row in rows])]).astype(np.intp),
        breakpoint=np.concatenate([row.breakpoint for row in rows]),
        readings=readings,
        resets=readings.resets(),
        heading_d1=law.d1,
        heading_d2=law.d2,
    )


class IntervalMoments:
    """Elements of all intervals of a `RouteTable`. Breakpoints are counted through: route r's begin at ``first[r]``."""

    def __init__(self, table: RouteTable):
        self.table = table
        self.first = table.first_segment[:-1] + np.arange(table.routes)
        n = len(table.distance)
        self.u, self.way, self.c, self.m, self.S, self.K, self.L, self.P = np.zeros((8, n), dtype=complex)
        self.translation, self.A = np.zeros((2, n))
        self.forgets = np.zeros(table.routes, dtype=bool)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for route in range(table.routes):
                self._sum(route)

    def _sum(self, route: int) -> None:
        segments = self.table.segments_of(route)
        B = self.table.segments[segments]
        here = slice(int(self.first[route]), int(self.first[route]) + len(B.p) + 1)
        u, c = _products(B.u), _products(1 + B.d1)
        m = _products(1 + 2 * B.d1 + B.d2)
        q1 = B.p + B.e1
        square = (np.conj(B.p) * (q1 + B.e1)).real + B.N
        square2 = B.p * (q1 + B.e1) + B.e2
        step = c[:-1] * u[:-1] * q1
        K = _sums(u[:-1] * (q1 + B.p * np.conj(B.d1) + B.a) / np.conj(c[1:]))
        L = _sums(u[:-1] * m[:-1] * (q1 + B.p * B.d1 + B.b) / c[1:])
        self.u[here], self.way[here], self.c[here], self.m[here] = u, _sums(u[:-1] * B.p), c, m
        self.S[here], self.K[here], self.L[here] = _sums(step), K, L
        self.A[here] = _sums(square + 2 * (np.conj(K[:-1]) * step).real).real
        self.P[here] = _sums(u[:-1] ** 2 * m[:-1] * square2 + 2 * L[:-1] * step)
        self.translation[here] = _sums(self.table.translation[segments]).real
        self.forgets[route] = bool(np.abs(m).min() < _FORGOTTEN)

    def between(self, e: Ints, j: Ints) -> Moments:
        """Elements from breakpoints ``e`` to breakpoints ``j`` of one route each, in the robot's frame at e."""
        composed = self._composed_on(e)
        if 0 < len(e) == len(composed):
            return self._composed(e, j)
        back, moved = np.conj(self.u[e]), self.S[j] - self.S[e]
        way, q1, square = self._from_sums(e, j)
        p, q1 = back * way, back * q1
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            square2 = back * back * (self.P[j] - self.P[e] - 2 * self.L[e] * moved) / self.m[e]
            d1 = self.c[j] / self.c[e] - 1
            found = Moments(
                self.u[j] * back,
                p,
                d1,
                self.m[j] / self.m[e] - 1 - 2 * d1,
                -2 * d1.real,
                q1 - p,
                square - (np.conj(p) * (2 * q1 - p)).real,
                square2 - p * (2 * q1 - p),
                back * np.conj(self.c[j]) * (self.K[j] - self.K[e]) - q1 - p * np.conj(d1),
                back * self.c[j] * (self.L[j] - self.L[e]) / self.m[e] - q1 - p * d1,
            )
        if len(composed):
            for array, exact in zip(found.arrays(), self._composed(e[composed], j[composed]).arrays(), strict=True):
                array[composed] = exact
        return found

    def squares(self, state: Moments, e: Ints, j: Ints) -> Floats:
        """E|e|² at breakpoints ``j`` of drives in ``state`` (frame of the route's start) at breakpoints ``e``."""
        way, q1, square = self._levers(e, j)
        square = square + np.abs(way) ** 2 - 2 * ((1 + state.d1) * np.conj(way) * q1).real
        return np.asarray(state.N.real + square + 2 * (np.conj(state.e1 + state.a) * q1 - np.conj(state.e1) * way).real)

    def to(self, route: int, breakpoint_: int) -> tuple[Floats, Complexes]:
        """``base`` and ``lever`` for fresh fixes of E|e|² = T and heading d1 at the breakpoints 0 … of a route.

        At ``breakpoint_`` then E|e|² = T + base - 2 Re[(1 + d1) lever].
        """
        e = self.first[route] + np.arange(breakpoint_ + 1)
        way, q1, square = self._levers(e, np.broadcast_to(e[-1], e.shape))
        return square + np.abs(way) ** 2, np.conj(way) * q1

    def _levers(self, e: Ints, j: Ints) -> tuple[Complexes, Complexes, Floats]:
        """The way from ``e`` to ``j``, E q and E|q|², in the frame of the route's start."""
        way, q1, square = self._from_sums(e, j)
        composed = self._composed_on(e)
        if len(composed):
            exact = self._composed(e[composed], j[composed])
            q = exact.p + exact.e1
            q1[composed] = self.u[e[composed]] * q
            square[composed] = (np.conj(exact.p) * (q + exact.e1)).real + exact.N.real
        return way, q1, square

    def _from_sums(self, e: Ints, j: Ints) -> tuple[Complexes, Complexes, Floats]:
        """The same where the heading is not forgotten."""
        moved = self.S[j] - self.S[e]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            square = np.asarray(self.A[j] - self.A[e] - 2 * (np.conj(self.K[e]) * moved).real)
            return np.asarray(self.way[j] - self.way[e]), np.asarray(moved / self.c[e]), square

    def _composed_on(self, e: Ints) -> Ints:
        """Which of the intervals from ``e`` on lie on a route that forgets."""
        if not self.forgets.any():
            return np.zeros(0, dtype=np.intp)
        return np.flatnonzero(self.forgets[np.searchsorted(self.first, e, side="right") - 1])

    def _composed(self, e: Ints, j: Ints) -> Moments:
        """`between`, composed."""
        length, at = j - e, e - np.searchsorted(self.first, e, side="right") + 1  # every route has a breakpoint more
        found = identity(e.shape)
        for level, elements in enumerate(self._elements):
            here = np.flatnonzero(length >> level & 1)
            if len(here):
                after = Moments.concatenate([found, compose(found[here], elements[at[here]])])
                index = np.arange(len(e))
                index[here] = len(e) + np.arange(len(here))
                found = after[index]
                at[here] += 1 << level
        return found

    @cached_property
    def _elements(self) -> list[Moments]:
        """The elements of 1, 2, 4, … segments, from every segment on (across routes too: those are never asked for)."""
        levels = [self.table.segments]
        longest = int(self.table.slots[self.forgets].max())
        while 2 << (len(levels) - 1) <= longest:
            half = 1 << (len(levels) - 1)
            levels.append(compose(levels[-1][:-half], levels[-1][half:]))
        return levels


def _sums(x: NDArray[Any]) -> Complexes:
    return np.concatenate([[0.0], np.cumsum(x)])


def _products(x: NDArray[Any]) -> Complexes:
    return np.concatenate([[1.0 + 0j], np.cumprod(x)])
