"""The engine of the estimator ``filter``: a fusing robot's error along a path, in the words of the exact moments.

Within a filter the error is a Gaussian with the covariance of `driftplan.model.filter_state`; to everyone else it is
shown as the `Moments` of this Gaussian, so that scores, profiles, figures and limits need not ask which robot it is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from driftplan.arrays import Array, Floats, Ints, as_covariance, as_plane
from driftplan.model.covariance import legs, path_legs
from driftplan.model.drive import Driven, start_and_order
from driftplan.model.filter_state import LINEAR_SWING_SHARE, FilterState, states_along
from driftplan.model.moments import Moments
from driftplan.model.noise import NO_SPREAD, OdometryNoise, SystematicSpread
from driftplan.model.paths import Runs
from driftplan.model.readings import Fix, Readings, start_errors

if TYPE_CHECKING:
    from driftplan.model.point_drift import PointDrift

_PERFECT_VAR = 1e-12  # m² or rad²: more accurate is nothing that is measured


class Beliefs(NamedTuple):
    """A fusing robot's states on leaving every leg border of a path, (..., m + 1), and what its odometry is like."""

    states: FilterState
    noises: tuple[OdometryNoise, ...]
    spread: SystematicSpread

    def onward(self, begin: Moments, border: Ints, legs_driven: tuple[Floats, Floats, Floats, Ints]) -> Moments:
        """Moments after driving on from ``border`` (..., k), where the moments are ``begin`` (..., k): the turns (rad),
        lengths (m), curvatures (1/m) and noises of what is driven."""
        turns, lengths, curvatures, which = legs_driven
        part = legs(np.angle(begin.u), turns, lengths, curvatures, self.noises, which, self.spread)
        mean = self.states.mean
        state = FilterState(_picked(self.states.P, border), None if mean is None else _picked(mean, border))
        u = begin.u * np.exp(1j * (turns + curvatures * lengths))
        return _as_moments(u, begin.p + part.moves, state.driven(part.column))


def fuse(
    runs: Runs,
    which: Ints,
    noises: tuple[OdometryNoise, ...],
    spread: SystematicSpread,
    start: Moments,
    readings: Readings | None = None,
    at: Ints | None = None,
) -> tuple[Driven, Beliefs]:
    """A fusing robot along a path, or along a batch of paths without readings; see `driftplan.model.drive.drive`."""
    path = path_legs(runs, noises, which, spread)
    turned = np.cumsum(runs.turns + runs.curvatures * runs.lengths, axis=-1)
    u = np.concatenate([start.u[..., None], start.u[..., None] * np.exp(1j * turned)], axis=-1)
    p = np.cumsum(np.concatenate([start.p[..., None], path.moves], axis=-1), axis=-1)
    rows: dict[int, list[Any]] = {}
    if readings is not None and at is not None:
        start, order = start_and_order(start, readings, at)
        for border, row in zip(at[order].tolist(), readings[order].rows(p[at[order]]), strict=True):
            rows.setdefault(border, []).append(row)
    before, after = states_along(_of_moments(start, spread), path.columns(), rows)
    return Driven(_as_moments(u, p, before), _as_moments(u, p, after)), Beliefs(after, noises, spread)


def belief_at_start(start_fix: Fix | None, spread: SystematicSpread = NO_SPREAD) -> FilterState:
    """What a fusing robot knows at the start of a path: all of it, or what a fix says; but for the constants."""
    return _of_moments(start_errors(start_fix), spread)


def misused_from(sighted: Readings, before: PointDrift) -> float:
    """Where the first of these ranges and bearings is read that a linear filter misuses, given the drift on arrival at
    each; metres driven, inf if none is."""
    towards = as_plane(sighted.anchor) - before.xy
    rho = np.maximum(np.hypot(*towards.T), 1e-9)
    along = towards / rho[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    var_along, var_across = (np.einsum("ki,kij,kj->k", g, before.cov, g) for g in (along, across))
    swing_var = var_along * var_across / rho**2  # m² that a range is off to second order
    range_var, bearing_var = (np.maximum(var, _PERFECT_VAR) for var in (sighted.range_var, sighted.bearing_var))
    off = np.fmax(swing_var / range_var, swing_var / rho**2 / bearing_var)
    return float(np.min(sighted.s_m[off > LINEAR_SWING_SHARE**2], initial=np.inf))


def _as_moments(u: Array, p: Array, state: FilterState) -> Moments:
    """The moments of a Gaussian error."""
    P, mean = state.P, state.mean or (0.0,) * state.size
    row = state.size
    xx, xy, xt, yy, yt, tt = P[0], P[1], P[2], P[row], P[row + 1], P[2 * row - 1]
    m, theta = mean[0] + 1j * np.asarray(mean[1]), mean[2]
    d1 = np.expm1(1j * np.asarray(theta) - tt / 2)
    d2 = np.expm1(2j * np.asarray(theta) - 2 * tt) - 2 * d1
    swung = 1j * (1 + d1) * (xt + 1j * np.asarray(yt))
    square, conj_swung = np.abs(m) ** 2, -1j * np.conj(1 + d1) * (xt + 1j * np.asarray(yt))
    N, e2 = xx + yy + square, xx - yy + 2j * np.asarray(xy) + m * m
    e1 = np.broadcast_to(m, N.shape)
    return Moments(u, p, d1, d2, -2 * d1.real, e1, N, e2, np.conj(d1) * m + conj_swung, d1 * m + swung)


def _of_moments(start: Moments, spread: SystematicSpread) -> FilterState:
    """The Gaussian error that has these moments, to first order in the correlation of position and heading."""
    size = 3 + len(spread.names)
    P, mean = np.zeros((*start.shape, size, size)), np.zeros((*start.shape, size))
    length = np.maximum(2 * np.real(start.d1) + np.abs(start.d1) ** 2, 1e-15 - 1)  # |r|² - 1: any heading from 6 rad on
    r = np.where(length > 1e-15 - 1, 1 + np.asarray(start.d1), 1e-7)
    mean[..., :2], mean[..., 2] = as_plane(start.e1), np.angle(r)
    P[..., :2, :2] = as_covariance(start.e1, start.N, start.e2)
    P[..., 2, 2] = np.maximum(-np.log1p(length), 0.0)
    P[..., :2, 2] = P[..., 2, :2] = as_plane(((start.b + start.e1) / r - start.e1) / 1j)
    P[..., range(3, size), range(3, size)] = spread.variances
    return FilterState.from_matrix(P, mean if mean.any() else None)


def _picked(columns: tuple[Any, ...], border: Ints) -> tuple[Any, ...]:
    shape = (*border.shape[:-1], columns[0].shape[-1])
    return tuple(np.take_along_axis(np.broadcast_to(x, shape), border, axis=-1) for x in columns)
