"""Interval moments: the element between any two breakpoints of a route, at once, from sums along the route.

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

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Complexes, Floats, Ints
from driftplan.layouts.placement.route_table import RouteTable
from driftplan.model.moments import Moments, compose, identity

_FORGOTTEN = 1e-3  # E r² under which the sums lose digits


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
