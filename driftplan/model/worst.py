"""The greatest drift anywhere on a path, between the points that are computed too.

"Anywhere" means: on arrival at every leg border, after the readings there, after turning on the spot, and in every
point of every straight run. On a run E|e|² is almost convex in the distance. In the letters of
`driftplan.model.elements`

    (E|e|²)'' = 2 E|(1+γ) r - 1|² + 2 Re[(1+γ̄) μ̄ E[e r̄]] - c²  >=  -(2 |1+γ| |μ| sqrt(E|e|²) + c²),

so between two points h apart it rises above their chord by at most (2 |1+γ| |μ| M + c²) s (h - s)/2, M the greatest
rms there. Stretches on which that lets it rise above the greatest value found are cut until none is left.

For a robot with a filter E|e|² is a polynomial in the distance on a straight run: of degree three and convex, so that
it is greatest at an end, or of degree four where something systematic acts, and then known by five of its values.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Bools, Floats, Ints
from driftplan.model.drift import Drift
from driftplan.model.elements import of_legs
from driftplan.model.moments import Moments, compose
from driftplan.model.noise import OdometryNoise, check_continuous
from driftplan.model.point_drift import PointDrift

_CLOSE = 1e-10  # relative: what E|e|² may rise above the greatest value found
_PARTS = 8  # into which a stretch is cut
_QUARTERS = np.linspace(0.0, 1.0, 5)  # of a run: where a polynomial of degree four is taken
_TO_BERNSTEIN = np.linalg.inv(  # values there @ this: coefficients that no value of the polynomial exceeds
    np.array([1, 4, 6, 4, 1]) * _QUARTERS[:, None] ** np.arange(5) * (1 - _QUARTERS[:, None]) ** np.arange(4, -1, -1)
).T
_TINY = 1e-300  # m², for what is divided by
_RADIUS_POINTS = 200  # along a path at which radii are taken, beside its borders
_RADIUS_ROUNDS = 3  # of looking closer at the greatest


def worst_rms(drift: Drift) -> float:
    """The greatest rms anywhere along one path of straight runs, metres: exact to a ten-billionth of itself.

    Raises ValueError for batches of paths, curved runs and noise per step.

    A heading error that drives the estimate in circles makes the drift greatest between waypoints:

    >>> from driftplan.model.drift import predict_drift
    >>> noise = OdometryNoise(heading_var_per_m=1e-6, heading_bias_per_m=0.5)
    >>> drift = predict_drift([(0, 0), (6, 4), (1, -6)], noise)
    >>> round(worst_rms(drift) / drift.rms.max().item(), 3)
    1.243
    """
    _check(drift)
    begun, (before, after) = drift.departures(), drift._driven
    end = before.N.real[1:]
    greatest = np.array([max(after.N.real.max(), begun.N.real.max(), end.max(), 0.0)])
    if drift.is_fused:
        return float(np.sqrt(_greatest_of_quartics(drift, float(greatest[0]))))
    drives = [Departures(weight, one.departures(), one.noises) for weight, one in drift._drives]
    drives = drives or [Departures(1.0, begun, drift.noises)]
    group, which = np.zeros(len(end), dtype=np.intp), drift.leg_noises
    return float(np.sqrt(_greatest_of_mixture(drives, drift.runs.lengths, which, end, group, greatest)[0]))


def worst_radius(drift: Drift, confidence: float) -> float:
    """The greatest radius that holds the estimate with a confidence in (0, 1) along one path of straight runs, metres.

    A radius has no bound between points. It is taken at all borders, both sides of fixes and turns and 200 points along
    the path, then ever closer around the greatest: a peak narrower than a 200th and not at a border may be missed.
    """
    _check(drift)
    length = float(drift.length)
    spacing = length / _RADIUS_POINTS
    between = drift.at(np.arange(1, _RADIUS_POINTS) * spacing)
    states = [*drift._driven, drift.departures(), between.moments]
    borders = drift._border_distance
    at = np.concatenate([borders, borders, borders[:-1], between.distance])
    greatest, peak = _greatest_radius(PointDrift(at, Moments.concatenate(states)), confidence)
    for _ in range(_RADIUS_ROUNDS):
        near = np.linspace(max(peak - spacing, 0.0), min(peak + spacing, length), 2 * _PARTS + 1)
        higher, place = _greatest_radius(drift.at(near), confidence)
        if higher > greatest:
            greatest, peak = higher, place
        spacing /= _PARTS
    return greatest


def _greatest_radius(points: PointDrift, confidence: float) -> tuple[float, float]:
    """The greatest radius and where it is; most need no integral: a radius is at most rms/sqrt(1 - confidence)."""
    N = points.moments.N.real
    order = np.argsort(-N)
    greatest, place = 0.0, 0.0
    for some in np.array_split(order, max(1, len(order) // 16)):
        if N[some[0]] <= (1 - confidence) * greatest**2:
            break
        radius = PointDrift(points.distance[some], points.moments[some]).radius(confidence)
        k = int(np.argmax(radius))
        if radius[k] > greatest:
            greatest, place = float(radius[k]), float(points.distance[some[k]])
    return greatest, place


def bend_rates(noise: OdometryNoise) -> tuple[float, float]:
    """2 |1+γ| |μ| and c²: -(E|e|²)'' on a straight run is at most the first times the rms plus the second."""
    covariance, grown = _grown(noise)
    mu = complex(-noise.heading_var_per_m / 2, noise.heading_bias_per_m)
    return 2 * grown * abs(mu), covariance**2


def _grown(noise: OdometryNoise) -> tuple[float, float]:
    """c and |1+γ|."""
    covariance = noise.heading_distance_corr * (noise.heading_var_per_m * noise.distance_var_per_m) ** 0.5
    return covariance, abs(1 + complex(noise.distance_scale_error, covariance / 2))


def ceiling(begin: Floats, end: Floats, bend: Floats, fixed: Floats) -> Floats:
    """What E|e|² = x² cannot exceed between two points, m², if -(x²)'' h²/8 <= ``bend`` x + ``fixed`` on the h metres.

    With such a bound S on -(x²)'' h²/8 the chord is exceeded by at most 4 S t (1 - t) at the share t of the way, so
    that the higher point is not exceeded at all if the other is lower by 4 S or more.
    """
    higher = np.maximum(np.maximum(begin, end), 0.0)
    most = 0.25 * (bend + np.sqrt(bend**2 + 4 * (higher + fixed))) ** 2
    sag = bend * np.sqrt(most) + fixed
    apart = np.minimum(np.abs(end - begin), 4 * sag)
    return np.asarray(higher - apart / 2 + sag + apart**2 / np.maximum(16 * sag, _TINY))


def slope_rates(noise: OdometryNoise) -> tuple[float, float]:
    """|(E|e|²)'| on a straight run is at most the first times the rms plus the second: the error grows by the estimated
    direction of travel, of length 1 + γ, less the true one, and by noise."""
    return 2 * (_grown(noise)[1] + 1), noise.distance_var_per_m + noise.lateral_var_per_m


def cone(begin: Floats, end: Floats, slope: Floats, fixed: Floats) -> Floats:
    """What E|e|² = x² cannot exceed between two points, m², when |(x²)'| h/2 is at most ``slope`` x + ``fixed``."""
    return np.asarray(0.25 * (slope + np.sqrt(slope**2 + 4 * ((begin + end) / 2 + fixed))) ** 2)


def greatest_between(
    begun: Moments,
    length: Floats,
    which: Ints,
    noises: Sequence[OdometryNoise],
    end: Floats,
    group: Ints,
    greatest: Floats,
) -> Floats:
    """Raise the ``greatest`` E|e|² (m²) of each group of straight stretches, (groups,) and at least that of all ends,
    to what is found inside them: at most 1e-10 of itself below the least upper bound. Of every stretch, (n,): moments
    at its beginning, length (m), index into ``noises``, E|e|² at its end (m²) and index into ``greatest``."""
    return _greatest_of_mixture([Departures(1.0, begun, noises)], length, which, end, group, greatest)


class Departures(NamedTuple):
    """What one kind of drive contributes to the average: weight, moments where stretches begin (n,), floors' noises."""

    weight: float
    begun: Moments
    noises: Sequence[OdometryNoise]


def _greatest_of_mixture(
    drives: Sequence[Departures], length: Floats, which: Ints, end: Floats, group: Ints, greatest: Floats
) -> Floats:
    """`greatest_between` of the average over drives: E|e|² and its bound are averages too, and the mean of
    2 |1+γ| |μ| times the rms is at most the root mean square of the one times that of the other."""
    bends = [weight * np.array([bend_rates(noise) for noise in noises]) ** (2, 1) for weight, _, noises in drives]
    slopes = [weight * np.array([slope_rates(noise) for noise in noises]) ** (2, 1) for weight, _, noises in drives]
    rates, steepness = np.asarray(sum(bends)) ** (0.5, 1), np.asarray(sum(slopes)) ** (0.5, 1)
    greatest = greatest.copy()
    stretch, offset, part = np.arange(len(length)), np.zeros(len(length)), np.asarray(length, dtype=float)
    begin = np.asarray(sum(weight * begun.N.real for weight, begun, _ in drives))
    while True:
        most = ceiling(begin, end, *(rates[which[stretch]].T * part**2 / 8))
        most = np.minimum(most, cone(begin, end, *(steepness[which[stretch]].T * part / 2)))  # where it bends a lot
        open_ = np.flatnonzero(most > greatest[group[stretch]] * (1 + _CLOSE))
        if not len(open_):
            return greatest
        stretch, offset, part = stretch[open_], offset[open_], part[open_] / _PARTS
        at = offset[:, None] + part[:, None] * np.arange(_PARTS + 1)
        zero, floor = np.zeros(at.shape), which[stretch, None]
        squares = (
            weight * compose(begun[stretch[:, None]], of_legs(zero, at, zero, floor, noises)).N.real
            for weight, begun, noises in drives
        )
        square = np.asarray(sum(squares))
        np.maximum.at(greatest, group[stretch], square.max(axis=1))
        begin, end = square[:, :-1].ravel(), square[:, 1:].ravel()
        offset, stretch, part = at[:, :-1].ravel(), np.repeat(stretch, _PARTS), np.repeat(part, _PARTS)


def exceeds_between(
    begun: Moments, length: Floats, which: Ints, noises: Sequence[OdometryNoise], end: Floats, limit: Floats
) -> Bools:
    """Whether E|e|² exceeds a ``limit`` (n,), m², inside straight stretches whose ends keep it: `greatest_between`."""
    return np.asarray(greatest_between(begun, length, which, noises, end, np.arange(len(length)), limit) > limit)


def _greatest_of_quartics(drift: Drift, least: float) -> float:
    """The greatest E|e|² inside the runs of a robot with a filter, m², from five values on each, or ``least``."""
    if not drift.has_systematic:
        return least
    values = drift.inside_legs(_QUARTERS).N.real
    for five in values[(values @ _TO_BERNSTEIN).max(axis=1) > least]:
        polynomial = np.linalg.solve(np.vander(_QUARTERS), five)
        peaks = np.roots(np.polyder(polynomial))
        inside = peaks.real[(np.abs(peaks.imag) < 1e-9) & (peaks.real > 0) & (peaks.real < 1)]
        least = max(least, float(np.max(np.polyval(polynomial, inside), initial=0.0)))
    return least


def _check(drift: Drift) -> None:
    if drift.distance.ndim != 1:
        raise ValueError(f"expected the drift of one path, got a batch of shape {drift.distance.shape[:-1]}")
    if np.any(drift.runs.curvatures != 0):
        raise ValueError("expected a path of straight runs, got a curved one")
    check_continuous(drift.noises)
