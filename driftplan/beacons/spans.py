"""Spans: E|e|² at one border of a route after a fresh fix at any border before it, all at once.

With a fresh position error of E|e|² = T and a heading error r_0 (unit complex, independent of what follows) at border
e, the error at border j is e = r_0 q - p and the fresh part, q the way from e to j as odometry has it and p as it is:

    E|e|² = T + E|q|² + |p|² - 2 Re[(1 + d1_0) conj(p) E q],        d1_0 = E r_0 - 1.

E q and E|q|² come from sums along the route once and for all. With u_k the true heading at border k, c_k the product of
1 + d1 over the pieces before k, and q1_k, Q_k, κ_k = E q, E|q|², E[q conj r] of piece k (`driftplan.model.moments`)

    S_k = Σ_{l<k} c_l u_l q1_l         K_k = Σ_{l<k} u_l κ_l / conj(c_{l+1})
    A_k = Σ_{l<k} Q_l + 2 Re[c_l conj(K_l) u_l q1_l]
    E q = (S_j - S_e)/c_e              E|q|² = A_j - A_e - 2 Re[conj(K_e)(S_j - S_e)].

The differences cancel to about 1e-16 of the route's extent squared, and lose more where the heading is all but
forgotten; there the pieces are composed one by one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from driftplan.beacons.tracks import Tracks
from driftplan.model.moments import compose, identity
from driftplan.model.paths import Floats

_FORGOTTEN = 1e-3  # coherence under which the sums lose digits


class RouteSpans:
    """Spans of one route of `Tracks`."""

    def __init__(self, tracks: Tracks, route: int):
        B = tracks.pieces[np.arange(*tracks.pieces_of(route).indices(len(tracks.length)))]
        self.pieces = B
        self.translation = np.concatenate([[0.0], np.cumsum(tracks.translation[tracks.pieces_of(route)])])
        u = np.concatenate([[1.0], np.cumprod(B.u)])
        self.coherence = np.concatenate([[1.0], np.cumprod(1 + B.d1)])
        self.position = _sums(u[:-1] * B.p)
        q1 = B.p + B.e1
        square = np.abs(B.p) ** 2 + 2 * (np.conj(B.p) * B.e1).real + B.N
        step = self.coherence[:-1] * u[:-1] * q1
        self.S = _sums(step)
        self.forgets = bool(np.abs(self.coherence).min() < _FORGOTTEN)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            self.K = _sums(u[:-1] * (q1 + B.p * np.conj(B.d1) + B.a) / np.conj(self.coherence[1:]))
            self.A = _sums(square + 2 * (np.conj(self.K[:-1]) * step).real)

    def to(self, border: int) -> tuple[Floats, NDArray[np.complex128]]:
        """``base`` and ``lever`` for fixes at borders 0 … ``border``: E|e|² = T + base - 2 Re[(1 + d1_0) lever]."""
        if self.forgets:
            return self._composed(border)
        fixes = slice(0, border + 1)
        way = self.position[border] - self.position[fixes]
        moved = self.S[border] - self.S[fixes]
        square = self.A[border] - self.A[fixes] - 2 * (np.conj(self.K[fixes]) * moved).real
        return square + np.abs(way) ** 2, np.conj(way) * moved / self.coherence[fixes]

    def _composed(self, border: int) -> tuple[Floats, NDArray[np.complex128]]:
        base, lever = np.zeros(border + 1), np.zeros(border + 1, dtype=complex)
        rest = identity(())
        for k in range(border - 1, -1, -1):
            rest = compose(self.pieces[np.intp(k)], rest)
            q1 = rest.p + rest.e1
            square = (np.conj(rest.p) * (2 * rest.e1 + rest.p)).real + rest.N
            base[k], lever[k] = square + np.abs(rest.p) ** 2, np.conj(rest.p) * q1
        return base, lever


def _sums(x: NDArray[np.complex128]) -> NDArray[np.complex128]:
    return np.concatenate([[0.0], np.cumsum(x)])
