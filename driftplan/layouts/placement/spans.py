"""Spans: the element between any two borders of a route, at once, from sums along the route.

With u_k the true heading at border k, p_k its position, c_k and m_k the products of E r and E r² over the pieces before
k, and q1_k, Q_k, Q2_k, κ_k, λ_k = E q, E|q|², E q², E[q conj r], E[q r] of piece k (q the way as odometry has it, r the
heading error it adds; `driftplan.model.moments`), the sums

    S_k = Σ c_l u_l q1_l        K_k = Σ u_l κ_l / conj(c_{l+1})      A_k = Σ Q_l + 2 Re[c_l conj(K_l) u_l q1_l]
                                L_k = Σ u_l m_l λ_l / c_{l+1}        P_k = Σ u_l² m_l Q2_l + 2 c_l L_l u_l q1_l

over l < k give, for the way from border e to border j, in the frame in which the route starts,

    E q = (S_j - S_e)/c_e         E|q|² = A_j - A_e - 2 Re[conj(K_e)(S_j - S_e)]      E[q conj r] = conj(c_j)(K_j - K_e)
                                  E q² = (P_j - P_e - 2 L_e (S_j - S_e))/m_e          E[q r] = c_j (L_j - L_e)/m_e.

The differences cancel to about 1e-16 of the route's extent squared, and lose more where the heading is all but
forgotten; such routes are marked, and what uses spans goes piece by piece on them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Complexes, Floats, Ints
from driftplan.layouts.placement.tracks import Tracks
from driftplan.model.moments import Moments, compose, identity

_FORGOTTEN = 1e-3  # E r² under which the sums lose digits


class Spans:
    """Spans of all routes of `Tracks`. Borders are counted through: route r's begin at ``first[r]``."""

    def __init__(self, tracks: Tracks):
        self.tracks = tracks
        self.first = tracks.first_piece[:-1] + np.arange(tracks.routes)
        n = len(tracks.distance)
        self.translation = np.zeros(n)
        self.u, self.way, self.c, self.m, self.S, self.K, self.L, self.P = (
            np.zeros(n, dtype=complex) for _ in range(8)
        )
        self.A = np.zeros(n)
        self.forgets = np.zeros(tracks.routes, dtype=bool)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for route in range(tracks.routes):
                self._sum(route)

    def _sum(self, route: int) -> None:
        pieces = self.tracks.pieces_of(route)
        B = Moments(*(x[pieces] for x in self.tracks.pieces.arrays()))
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
        self.translation[here] = _sums(self.tracks.translation[pieces]).real
        self.forgets[route] = bool(np.abs(m).min() < _FORGOTTEN)

    def between(self, e: Ints, j: Ints) -> Moments:
        """Elements from borders ``e`` to borders ``j`` of routes that do not forget, in the robot's frame at e."""
        back = np.conj(self.u[e])
        moved = self.S[j] - self.S[e]
        p, q1 = back * (self.way[j] - self.way[e]), back * moved / self.c[e]
        square = self.A[j] - self.A[e] - 2 * (np.conj(self.K[e]) * moved).real
        square2 = back * back * (self.P[j] - self.P[e] - 2 * self.L[e] * moved) / self.m[e]
        d1 = self.c[j] / self.c[e] - 1
        return Moments(
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

    def squares(self, state: Moments, e: Ints, j: Ints) -> Floats:
        """E|e|² at borders ``j`` of drives in ``state`` (in the frame of the route's start) at borders ``e``."""
        moved = self.S[j] - self.S[e]
        q1, way = moved / self.c[e], self.way[j] - self.way[e]
        square = self.A[j] - self.A[e] - 2 * (np.conj(self.K[e]) * moved).real + np.abs(way) ** 2
        square = square - 2 * ((1 + state.d1) * np.conj(way) * q1).real
        return np.asarray(state.N.real + square + 2 * (np.conj(state.e1 + state.a) * q1 - np.conj(state.e1) * way).real)

    def to(self, route: int, border: int) -> tuple[Floats, Complexes]:
        """``base`` and ``lever`` for fresh fixes of E|e|² = T and heading d1 at borders 0 … ``border`` of a route.

        At ``border`` then E|e|² = T + base - 2 Re[(1 + d1) lever].
        """
        if self.forgets[route]:
            return self._composed(route, border)
        e = self.first[route] + np.arange(border + 1)
        moved = self.S[e[-1]] - self.S[e]
        way = self.way[e[-1]] - self.way[e]
        square = self.A[e[-1]] - self.A[e] - 2 * (np.conj(self.K[e]) * moved).real
        return square + np.abs(way) ** 2, np.conj(way) * moved / self.c[e]

    def _composed(self, route: int, border: int) -> tuple[Floats, Complexes]:
        base, lever = np.zeros(border + 1), np.zeros(border + 1, dtype=complex)
        rest = identity(())
        for k in range(border - 1, -1, -1):
            rest = compose(self.tracks.pieces[self.tracks.first_piece[route] + k], rest)
            q1 = rest.p + rest.e1
            square = (np.conj(rest.p) * (q1 + rest.e1)).real + rest.N
            base[k], lever[k] = square + np.abs(rest.p) ** 2, np.conj(rest.p) * q1
        return base, lever


def _sums(x: NDArray[Any]) -> Complexes:
    return np.concatenate([[0.0], np.cumsum(x)])


def _products(x: NDArray[Any]) -> Complexes:
    return np.concatenate([[1.0 + 0j], np.cumprod(x)])
