"""A fusing robot's error at one place, and what driving and readings do to it, drive by drive or thousands at once.

The mathematics is that of `driftplan.model.covariance`; here the covariance travels as its entries.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from operator import add
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import Floats

LINEAR_HEADING_STD_RAD = 0.15  # between readings; above, the linear model and the filter go wrong by tens of per cent
LINEAR_SWING_SHARE = 0.15  # of a range's or bearing's std, what it is off to second order; above, likewise
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


X_AXIS, Y_AXIS, HEADING_AXIS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
AXES = {axis: axis for axis in (X_AXIS, Y_AXIS, HEADING_AXIS)}  # equal coefficients, made one


def position_rows(cov: Any) -> tuple[Row, Row]:
    """Measured positions with the error covariances ``cov``, m², (..., 2, 2): along their principal axes."""
    cov = np.asarray(cov, dtype=float)
    if not cov[..., 0, 1].any():
        return Row(X_AXIS, _column(cov[..., 0, 0])), Row(Y_AXIS, _column(cov[..., 1, 1]))
    variances, axes = np.linalg.eigh(cov)
    first, second = (
        Row((_column(axes[..., 0, k]), _column(axes[..., 1, k]), 0.0), _column(np.maximum(variances[..., k], 0.0)))
        for k in range(2)
    )
    return first, second


def heading_row(heading_var: Any) -> Row:
    """A measured heading, rad²."""
    return Row(HEADING_AXIS, heading_var)


def range_row(towards: Floats, range_var: Any) -> Row:
    """A measured distance (m²) to an anchor; ``towards`` is the vector from the true position to it, m, (..., 2)."""
    g = towards / _distance(towards)[..., None]
    return Row((_column(-g[..., 0]), _column(-g[..., 1]), 0.0), range_var)


def bearing_row(towards: Floats, bearing_var: Any) -> Row:
    """A measured direction (rad²) of an anchor in the robot's frame; ``towards`` as for `range_row`."""
    h = towards / _distance(towards)[..., None] ** 2
    return Row((_column(h[..., 1]), _column(-h[..., 0]), -1.0), bearing_var)


def _distance(towards: Floats) -> Floats:
    distance = np.asarray(np.hypot(towards[..., 0], towards[..., 1]))
    if not distance.all():
        raise ValueError("expected an anchor away from the path: at the anchor itself no direction is defined")
    return distance


class LegColumns(NamedTuple):
    """One leg for `FilterState`: Python numbers, or arrays over drives."""

    transition: tuple[Any, ...]  # what differs from the identity in A, in the order of `transition_entries`
    gain: tuple[Any, ...]  # upper triangle of C
    shift: tuple[Any, ...] | None  # of the mean


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """The error of a fusing robot at one place, of one drive (Python numbers) or of many (arrays of one shape).

    Entry by entry: on thousands of drives ten times as fast as stacked matrices, on one drive too.
    """

    P: tuple[Any, ...]  # upper triangle of the covariance, row by row
    mean: tuple[Any, ...] | None = None  # None where nothing is systematic

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
        return len(_entries(len(self.P)).rows)

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
        columns = np.broadcast_arrays(*self.P)
        return np.stack([np.stack([columns[n] for n in row], axis=-1) for row in _entries(len(columns)).rows], axis=-2)

    def driven(self, leg: LegColumns) -> FilterState:
        """After a leg."""
        P, mean = list(self.P), None if self.mean is None else list(self.mean)
        if mean is None and leg.shift is not None:
            mean = [0.0] * self.size
        _drive(P, mean, leg)
        return FilterState(tuple(P), None if mean is None else tuple(mean))

    def read(self, rows: Sequence[Row], share: Any = None) -> FilterState:
        """After a reading.

        ``share``, a number or array in [0, 1] or None for 1, says which of the drives read it (0 or 1), or is the
        probability p that it is read: then ``p g(P) + (1 - p) P`` is an *upper bound* of the expected covariance of a
        filter that knows whether it read (g is operator-concave: Jensen), a few per cent above it in rms. A mean error
        that a missed reading leaves adds its spread to the covariance.
        """
        P, mean = list(self.P), None if self.mean is None else list(self.mean)
        for row in rows:
            _read_row(P, mean, row)
        if share is None:
            return FilterState(tuple(P), None if mean is None else tuple(mean))
        rest = 1 - share
        P = [share * new + rest * old for new, old in zip(P, self.P, strict=True)]
        if mean is None or self.mean is None:
            return FilterState(tuple(P))
        jump = [new - old for new, old in zip(mean, self.mean, strict=True)]
        P = [p + share * rest * jump[i] * jump[j] for p, (i, j) in zip(P, upper_triangle(self.size), strict=True)]
        return FilterState(tuple(P), tuple(old + share * step for old, step in zip(self.mean, jump, strict=True)))


def states_along(
    start: FilterState, legs: Sequence[LegColumns], rows_at: Mapping[int, Sequence[tuple[Sequence[Row], Any]]]
) -> tuple[FilterState, FilterState]:
    """The states at every border of m legs, before and after the readings there, in columns of shape (..., m + 1): of
    one drive, or of as many as the columns of the legs have. ``rows_at`` a border (0 to m) are its readings, in order:
    rows and the chance of each, None for certainty."""
    state = start
    if state.mean is None and any(leg.shift is not None for leg in legs):
        state = FilterState(state.P, (0.0,) * state.size)
    P, mean = list(state.P), None if state.mean is None else list(state.mean)
    before: list[tuple[Any, ...]] = []
    after: list[tuple[Any, ...]] = []
    for border in range(len(legs) + 1):
        if border:
            _drive(P, mean, legs[border - 1])
        before.append((*P, *(mean or ())))
        for rows, chance in rows_at.get(border, ()):
            if chance is None:
                for row in rows:
                    _read_row(P, mean, row)
            else:
                read = FilterState(tuple(P), None if mean is None else tuple(mean)).read(rows, chance)
                P, mean = list(read.P), None if read.mean is None else list(read.mean)
        after.append((*P, *(mean or ())))
    return _stacked(before, len(P)), _stacked(after, len(P))


def _stacked(states: list[tuple[Any, ...]], columns: int) -> FilterState:
    """States one after the other, along a last axis."""
    if not all(isinstance(x, float) for x in states[-1]):
        states = [tuple(np.broadcast_arrays(*state)) for state in states]
        shape = np.shape(states[-1][0])
        states = [tuple(np.broadcast_to(x, shape) for x in state) for state in states]
    entries = tuple(np.moveaxis(np.array(states), (0, 1), (-1, 0)))
    return FilterState(entries[:columns], entries[columns:] or None)


def _drive(P: list[Any], mean: list[Any] | None, leg: LegColumns) -> None:
    """One leg, in place."""
    if len(P) == 6 and mean is None:  # what follows, in the same order, in a third of the time
        (xx, xy, xt, yy, yt, tt), (a, b), (c, d, e, f, g, h) = P, leg.transition, leg.gain
        old_xt, old_yt, xt, yt = xt, yt, xt + a * tt, yt + b * tt
        xy = xy + a * old_yt + b * xt
        P[:] = xx + a * (old_xt + xt) + c, xy + d, xt + e, yy + b * (old_yt + yt) + f, yt + g, tt + h
        return
    additions = _entries(len(P)).row_additions
    for a, (_, _, ik, ii, others) in zip(leg.transition, additions, strict=True):
        old = P[ik]
        for ij, kj in others:
            P[ij] = P[ij] + a * P[kj]
        P[ii] = P[ii] + a * (old + P[ik])
    P[:] = map(add, P, leg.gain)
    if mean is not None:
        for a, (i, k, *_) in zip(leg.transition, additions, strict=True):
            mean[i] = mean[i] + a * mean[k]
        if leg.shift is not None:
            mean[:] = map(add, mean, leg.shift)


def _read_row(P: list[Any], mean: list[Any] | None, row: Row) -> None:
    """One scalar reading, in place: P ← P - g gᵀ/s with g = P h, s = h·g + variance."""
    h, variance = row
    axis = 0 if h is X_AXIS else 1 if h is Y_AXIS else 2 if h is HEADING_AXIS else None
    if len(P) == 6 and mean is None and axis != 2:  # what follows, in a third of the time
        xx, xy, xt, yy, yt, tt = P
        if axis is None:
            a, b, c = h
            x, y, t = a * xx + b * xy + c * xt, a * xy + b * yy + c * yt, a * xt + b * yt + c * tt
            parts = a * a * xx + b * b * yy + c * c * tt
            weight = _inverse(a * x + b * y + c * t + variance, _KNOWN_VARIANCE_SHARE * parts)
            xw, yw, tw = x * weight, y * weight, t * weight
            P[:] = xx - x * xw, xy - x * yw, xt - x * tw, yy - y * yw, yt - y * tw, tt - t * tw
            return
        weight = _inverse((yy if axis else xx) + variance, 0.0)
        kept = variance * weight
        if axis:
            P[:] = xx - xy * xy * weight, xy * kept, xt - xy * yt * weight, yy * kept, yt * kept, tt - yt * yt * weight
        else:
            P[:] = xx * kept, xy * kept, xt * kept, yy - xy * xy * weight, yt - xy * xt * weight, tt - xt * xt * weight
        return
    entries = _entries(len(P))
    if axis is None:
        rows = entries.rows[:3]
        g = [h[0] * P[x] + h[1] * P[y] + h[2] * P[t] for x, y, t in zip(*rows, strict=True)]
        parts = sum(c * c * P[own[i]] for i, (c, own) in enumerate(zip(h, rows, strict=True)))
        weight = _inverse(h[0] * g[0] + h[1] * g[1] + h[2] * g[2] + variance, _KNOWN_VARIANCE_SHARE * parts)
        for n, (i, k) in enumerate(upper_triangle(len(g))):
            P[n] = P[n] - g[i] * g[k] * weight
    else:  # the row that is measured shrinks by a factor: no digit is lost
        own = entries.rows[axis]
        g = [P[n] for n in own]
        weight = _inverse(g[axis] + variance, 0.0)
        for ik, i, k in entries.besides[axis]:
            P[ik] = P[ik] - P[i] * P[k] * weight
        kept = variance * weight
        for n in own:
            P[n] = P[n] * kept
    if mean is not None:
        measured = (h[0] * mean[0] + h[1] * mean[1] + h[2] * mean[2]) * weight
        mean[:] = [m - gain * measured for m, gain in zip(mean, g, strict=True)]


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
def transition_entries(size: int) -> tuple[tuple[int, int], ...]:
    """Where the transition of a leg differs from the identity: position first, its rows use the heading before."""
    return tuple((i, k) for i in range(2) for k in range(2, size)) + tuple((2, k) for k in range(3, size))


class _Entries(NamedTuple):
    """Where among the columns the entries are that the steps need."""

    rows: tuple[tuple[int, ...], ...]
    row_additions: tuple[tuple[Any, ...], ...]  # i, k, ik, ii, (ij, kj) for j != i
    besides: tuple[tuple[tuple[int, int, int], ...], ...]  # of each axis a: jk, aj, ak for j, k != a


@cache
def _entries(columns: int) -> _Entries:
    size = int(((8 * columns + 1) ** 0.5 - 1) / 2)
    pairs = upper_triangle(size)
    rows = tuple(tuple(pairs.index((min(i, j), max(i, j))) for j in range(size)) for i in range(size))
    return _Entries(
        rows,
        tuple(
            (i, k, rows[i][k], rows[i][i], tuple((rows[i][j], rows[k][j]) for j in range(size) if j != i))
            for i, k in transition_entries(size)
        ),
        tuple(tuple((rows[j][k], rows[a][j], rows[a][k]) for j, k in pairs if a not in (j, k)) for a in range(size)),
    )
