"""A fusing robot's error at one place, and what driving and readings do to it, drive by drive or thousands at once.

The mathematics is that of `driftplan.model.covariance`; here the covariance travels as its entries.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import Floats

LINEAR_HEADING_STD_RAD = 0.15  # between readings; above, the linear model and the filter go wrong by tens of per cent
_KNOWN_VARIANCE_SHARE = 1e-14  # a direction with less than this share of its parts' variance is known already


class Row(NamedTuple):
    """One number that is measured: coefficients of (e_x, e_y, θ) and the variance of its error (m², rad²).

    Coefficients and variance may be arrays, one per drive. A single coefficient of 1 is read without losing digits.
    """

    coefficients: tuple[Any, Any, Any]
    variance: Any

    def vector(self, size: int) -> Floats:
        """The coefficients as an array (..., size)."""
        columns = np.stack(np.broadcast_arrays(*(np.asarray(c, dtype=float) for c in self.coefficients)), axis=-1)
        return np.concatenate([columns, np.zeros((*columns.shape[:-1], size - 3))], axis=-1)


X_AXIS, Y_AXIS, HEADING_AXIS = _AXES = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def position_rows(cov: Floats) -> tuple[Row, ...]:
    """A measured position with the error covariance ``cov``, m², (2, 2): along its principal axes."""
    if cov[0, 1] == 0:
        return Row(X_AXIS, float(cov[0, 0])), Row(Y_AXIS, float(cov[1, 1]))
    variances, axes = np.linalg.eigh(cov)
    return tuple(
        Row((float(axis[0]), float(axis[1]), 0.0), max(float(v), 0.0))
        for v, axis in zip(variances, axes.T, strict=True)
    )


def heading_row(heading_var: float) -> Row:
    """A measured heading, rad²."""
    return Row(HEADING_AXIS, heading_var)


def range_row(towards: Floats, std_m: float) -> Row:
    """A measured distance to an anchor; ``towards`` is the vector from the true position to it, metres, (2,)."""
    g = towards / _distance(towards)
    return Row((-float(g[0]), -float(g[1]), 0.0), std_m**2)


def bearing_row(towards: Floats, std_rad: float) -> Row:
    """A measured direction of an anchor in the robot's frame; ``towards`` as for `range_row`."""
    rho = _distance(towards)
    g = towards / rho
    return Row((float(g[1]) / rho, -float(g[0]) / rho, -1.0), std_rad**2)


def _distance(towards: Floats) -> float:
    distance = float(np.hypot(towards[0], towards[1]))
    if distance == 0:
        raise ValueError("expected an anchor away from the path: at the anchor itself no direction is defined")
    return distance


class LegColumns(NamedTuple):
    """One leg for `FilterState`: what of A is not the identity, the upper triangle of C, the shift."""

    links: tuple[tuple[int, int, Any], ...]
    gain: tuple[Any, ...]
    shift: tuple[Any, ...] | None


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """The error of a fusing robot at one place, of one drive (Python numbers) or of many (arrays of one shape).

    Entry by entry: on thousands of drives ten times as fast as stacked matrices, on one drive too.

    Attributes
    ----------
    P : tuple of columns
        Upper triangle of the covariance, row by row.
    mean : tuple of columns, or None where nothing is systematic
    """

    P: tuple[Any, ...]
    mean: tuple[Any, ...] | None = None

    @classmethod
    def from_matrix(cls, P: Floats, mean: Floats | None = None) -> FilterState:
        """From (..., d, d) and (..., d); of one drive as Python numbers."""
        columns = tuple(_column(P[..., i, j]) for i, j in upper_triangle(P.shape[-1]))
        return cls(columns, None if mean is None else tuple(_column(mean[..., i]) for i in range(mean.shape[-1])))

    @classmethod
    def at_start(cls, pose_cov: Floats | None = None, constants_var: Sequence[float] = ()) -> FilterState:
        """A pose known with the covariance ``pose_cov`` (3, 3), default exactly, and the variances of the constants."""
        size = 3 + len(constants_var)
        P = np.zeros((size, size))
        P[:3, :3] = 0.0 if pose_cov is None else pose_cov
        P[range(3, size), range(3, size)] = constants_var
        return cls.from_matrix(P)

    @property
    def size(self) -> int:
        return _size(len(self.P))

    @property
    def trace(self) -> Any:
        """Of the position's covariance, m²."""
        return self.P[0] + self.P[self.size]

    @property
    def square(self) -> Any:
        """E|e|², m²."""
        return self.trace if self.mean is None else self.trace + self.mean[0] ** 2 + self.mean[1] ** 2

    @property
    def matrix(self) -> Floats:
        """(..., d, d)"""
        at, size = _index(self.size), self.size
        columns = np.broadcast_arrays(*self.P)
        return np.stack([np.stack([columns[at[i][j]] for j in range(size)], -1) for i in range(size)], -2)

    def driven(self, leg: LegColumns) -> FilterState:
        """After a leg."""
        P, at = list(self.P), _index(self.size)
        mean = None if self.mean is None and leg.shift is None else list(self.mean or [0.0] * self.size)
        for i, k, a in leg.links:  # position first: its rows use the heading before the leg
            row_i, row_k = at[i], at[k]
            old = P[row_i[k]]
            for j in range(self.size):
                if j != i:
                    P[row_i[j]] = P[row_i[j]] + a * P[row_k[j]]
            P[row_i[i]] = P[row_i[i]] + a * (old + P[row_i[k]])
            if mean is not None:
                mean[i] = mean[i] + a * mean[k]
        if mean is not None and leg.shift is not None:
            mean = [m + b for m, b in zip(mean, leg.shift, strict=True)]
        return FilterState(
            tuple(p + c for p, c in zip(P, leg.gain, strict=True)), None if mean is None else tuple(mean)
        )

    def read(self, rows: Sequence[Row], share: Any = None) -> FilterState:
        """After a reading.

        Parameters
        ----------
        rows : sequence of Row
        share : number or array in [0, 1], or None for 1
            Which of the drives read it (0 or 1), or the probability p that it is read: then ``p g(P) + (1 - p) P`` is
            an *upper bound* of the expected covariance of a filter that knows whether it read (g is operator-concave:
            Jensen), a few per cent above it in rms. A mean error that a missed reading leaves adds its spread to the
            covariance.
        """
        P, mean = list(self.P), None if self.mean is None else list(self.mean)
        for row in rows:
            _read_row(P, mean, row, _index(self.size))
        if share is None:
            return FilterState(tuple(P), None if mean is None else tuple(mean))
        rest = 1 - share
        P = [share * new + rest * old for new, old in zip(P, self.P, strict=True)]
        if mean is None or self.mean is None:
            return FilterState(tuple(P))
        jump = [new - old for new, old in zip(mean, self.mean, strict=True)]
        P = [p + share * rest * jump[i] * jump[j] for p, (i, j) in zip(P, upper_triangle(self.size), strict=True)]
        return FilterState(tuple(P), tuple(old + share * step for old, step in zip(self.mean, jump, strict=True)))


def _read_row(P: list[Any], mean: list[Any] | None, row: Row, at: tuple[tuple[int, ...], ...]) -> None:
    """One scalar reading, in place: P ← P - g gᵀ/s with g = P h, s = h·g + variance."""
    size, h = len(at), row.coefficients
    i = next((k for k, axis in enumerate(_AXES) if h is axis), -1)
    kept: Any = None
    if i >= 0:
        g = [P[at[i][j]] for j in range(size)]
        weight = _inverse(g[i] + row.variance, 0.0)
        kept = row.variance * weight
    else:
        g = [h[0] * P[at[0][j]] + h[1] * P[at[1][j]] + h[2] * P[at[2][j]] for j in range(size)]
        parts = h[0] * h[0] * P[at[0][0]] + h[1] * h[1] * P[at[1][1]] + h[2] * h[2] * P[at[2][2]]
        s = h[0] * g[0] + h[1] * g[1] + h[2] * g[2] + row.variance
        weight = _inverse(s, _KNOWN_VARIANCE_SHARE * parts)
    if mean is not None:
        measured = (mean[i] if i >= 0 else h[0] * mean[0] + h[1] * mean[1] + h[2] * mean[2]) * weight
        for j in range(size):
            mean[j] = mean[j] - g[j] * measured
    for j in range(size):
        for k in range(j, size):
            if i in (j, k):  # the row that is measured shrinks by a factor: no digit is lost
                P[at[j][k]] = P[at[j][k]] * kept
            else:
                P[at[j][k]] = P[at[j][k]] - g[j] * g[k] * weight


def _inverse(s: Any, floor: Any) -> Any:
    """1/s, or 0 where s is not above the floor."""
    if isinstance(s, float):
        return 1.0 / s if s > floor else 0.0
    return np.divide(1.0, s, out=np.zeros(np.shape(s)), where=s > floor)


def _column(x: Floats) -> Any:
    return x.item() if x.ndim == 0 else x


@cache
def upper_triangle(size: int) -> tuple[tuple[int, int], ...]:
    """Row by row."""
    return tuple((i, j) for i in range(size) for j in range(i, size))


@cache
def links_of(size: int) -> tuple[tuple[int, int], ...]:
    """Where the transition of a leg differs from the identity, in the order in which `FilterState.driven` needs it."""
    return tuple((i, k) for i in range(2) for k in range(2, size)) + tuple((2, k) for k in range(3, size))


@cache
def _index(size: int) -> tuple[tuple[int, ...], ...]:
    """Where the entry i, j is among the columns."""
    place = {pair: n for n, pair in enumerate(upper_triangle(size))}
    return tuple(tuple(place[min(i, j), max(i, j)] for j in range(size)) for i in range(size))


@cache
def _size(columns: int) -> int:
    return int(((8 * columns + 1) ** 0.5 - 1) / 2)
