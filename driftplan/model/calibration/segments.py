"""Errors of odometry over segments of a drive, and what a noise model expects of them: moments to compare.

The error of a segment can only be stated once estimate and truth are aligned at its start:

* With a measured true heading: by it. The observation is (e_x, e_y, sin φ), the position error in metres in the robot's
  true frame at the start, φ the heading error gained. Mean and covariance follow exactly from the moment algebra.
* With positions alone: by the chord over a first part as long as the rest. The observation is (excess length of the
  first chord, error of the second chord along and across), in the frame of the first chord. Both chords begin in the
  middle, one of them driven backwards, so that their errors x and y are independent and as small as can be; mean and
  covariance are those of the second-order expansion in x and y, whose moments are exact.

Errors of the truth itself (white, of each coordinate and of the heading) enter at both ends and through the alignment.

Everything is done in world coordinates with rotations left out (u = 1): planar rotations commute, so the errors do not
care, and the true heading is needed only at the start of a segment.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Complexes, Floats, Ints, as_covariance, as_plane
from driftplan.model.calibration.resampling import ResampledDrive
from driftplan.model.moments import Moments, compose
from driftplan.model.noise import OdometryNoise

_LEAST_CHORD = 1e-3  # of the true chord
_SHORTEST_CHORD = 0.25  # of its path: below, the chord's direction says too little to align by


class TruthNoise(NamedTuple):
    """Variances of the reference: of each position coordinate (m²) and of the heading (rad²), white."""

    position_var: float
    heading_var: float


class Observations(NamedTuple):
    """Observed segments of one length in one part."""

    starts: Ints  # (n,), first knot of each
    values: Floats  # (n, 3)
    frame: Complexes  # (n,), direction of the frame's x axis in the world
    chord: (
        Complexes  # (n,), true displacement over it (with positions alone: its first part) there, m: an error's lever
    )


def observe(part: ResampledDrive, steps: int, stride: int) -> Observations:
    """Errors of all segments of ``steps`` pieces (with positions alone: two such parts), every ``stride`` knots."""
    if part.truth_heading is not None:
        starts = np.arange(0, len(part.truth) - steps, stride)
        frame = np.exp(1j * part.truth_heading[starts])
        chord = (part.truth[starts + steps] - part.truth[starts]) / frame
        return Observations(starts, errors_of(part, starts, steps), frame, chord)
    starts = np.arange(0, len(part.truth) - 2 * steps, stride)
    first, estimated = (np.abs(x[starts + steps] - x[starts]) for x in (part.truth, part.estimate))
    driven = part.driven[starts + steps] - part.driven[starts]
    starts = starts[np.minimum(first, estimated) >= _SHORTEST_CHORD * driven]
    chord = part.truth[starts + steps] - part.truth[starts]
    return Observations(starts, errors_of(part, starts, steps), chord / np.abs(chord), np.abs(chord).astype(complex))


def errors_of(part: ResampledDrive, starts: Ints, steps: int) -> Floats:
    """Observed values (..., n, 3) of the segments that begin at these knots; estimate and truth may be (..., K)."""
    ends = starts + steps
    first, estimated = (x[..., ends] - x[..., starts] for x in (part.truth, part.estimate))
    if part.truth_heading is not None:
        at_start = part.truth_heading[..., starts]
        gained = part.estimate_heading[..., ends] - part.estimate_heading[..., starts]
        gained = gained - (part.truth_heading[..., ends] - at_start)
        e = estimated * np.exp(-1j * part.estimate_heading[..., starts]) - first * np.exp(-1j * at_start)
        return np.stack([e.real, e.imag, np.sin(gained)], axis=-1)
    second, estimated_second = (x[..., ends + steps] - x[..., ends] for x in (part.truth, part.estimate))
    true_m, estimated_m = np.abs(first), np.abs(estimated)
    e = estimated_second * np.conj(estimated) / np.maximum(estimated_m, 1e-300) - second * np.conj(first) / true_m
    return np.stack([estimated_m - true_m, e.real, e.imag], axis=-1)


def repeated(
    part: ResampledDrive, noise: OdometryNoise, truth: TruthNoise, rng: np.random.Generator, deviations: Floats
) -> ResampledDrive:
    """The drive many times over, with Gaussian errors of the odometry as `pieces` has them, and of the truth: estimate
    and truth are (runs, K). ``deviations`` (3, runs) are those of the drives' systematic errors, in their stds."""
    runs = deviations.shape[1]
    bias_per_m, bias_per_rad, scale = np.array(noise.spread)[:, None, None] * deviations[..., None]
    random = _increments(part, noise)
    shape = (runs, len(part.turns))
    halves = np.sqrt(random.heading_var / 2) * rng.standard_normal((2, *shape)) + random.heading_mean / 2
    halves = halves + 0.5 * (bias_per_m * np.diff(part.driven) + bias_per_rad * part.turns)
    gained = np.concatenate([np.zeros((runs, 1)), np.cumsum(halves.sum(axis=0), axis=1)], axis=1)
    # a complex Gaussian with E|z|² = s and E z² = p lies along arg(p)/2, with variances (s ± |p|)/2
    size = np.abs(random.elongation)
    major, minor = (np.sqrt(np.maximum(random.square + sign * size, 0.0) / 2) for sign in (1, -1))
    axis = np.exp(0.5j * np.angle(random.elongation))
    error = axis * (major * rng.standard_normal(shape) + 1j * minor * rng.standard_normal(shape))
    moves = ((1 + noise.distance_scale_error + scale) * np.diff(part.truth) + error) * np.exp(
        1j * (gained[:, :-1] + halves[0])
    )
    estimate = part.truth[0] + np.concatenate([np.zeros((runs, 1)), np.cumsum(moves, axis=1)], axis=1)
    white = rng.standard_normal((2, runs, len(part.truth)))
    seen = part.truth + np.sqrt(truth.position_var) * (white[0] + 1j * white[1])
    heading = np.concatenate([[0.0], np.cumsum(part.turns)])
    seen_heading = part.truth_heading
    if seen_heading is not None:
        heading = seen_heading
        seen_heading = heading + np.sqrt(truth.heading_var) * rng.standard_normal(seen.shape)
    return part._replace(estimate=estimate, estimate_heading=heading + gained, truth=seen, truth_heading=seen_heading)


def expect(
    part: ResampledDrive, seen: Observations, found: WindowMoments, steps: int, truth: TruthNoise
) -> tuple[Floats, Floats]:
    """Mean (n, 3) and covariance (n, 3, 3) of the observations, from the moments of all windows of ``steps`` pieces."""
    ahead = found.ahead[steps]
    if found.back is None:
        return _expect_with_heading(seen, ahead[seen.starts], truth)
    middle = seen.starts + steps
    return _expect_positions(seen, found.back[steps][len(part.turns) - middle], ahead[middle], truth)


class WindowMoments(NamedTuple):
    """Moments of runs of consecutive pieces, by their number: driven ahead from every knot, and where segments are
    aligned by chords also back from every knot, last first."""

    ahead: dict[int, Moments]
    back: dict[int, Moments] | None


def windows_of(part: ResampledDrive, noise: OdometryNoise, steps: Sequence[int]) -> WindowMoments:
    """The moments that `expect` needs for segments of these numbers of pieces."""
    ahead = windows(pieces(part, noise), steps)
    return WindowMoments(ahead, None if part.truth_heading is not None else windows(_back(part, noise), steps))


def _back(part: ResampledDrive, noise: OdometryNoise) -> Moments:
    """Moments of the odometry from knot to knot when the drive is driven back: what `pieces` says of it, inverted."""
    reverse = part._replace(
        driven=-part.driven[::-1],
        truth=part.truth[::-1],
        turns=-part.turns[::-1],
        angles=part.angles[::-1],
        travel_axes=part.travel_axes[::-1],
        turn_axes=part.turn_axes[::-1],
    )
    return pieces(reverse, noise, way=-1)


def pieces(part: ResampledDrive, noise: OdometryNoise, way: int = 1) -> Moments:
    """Moments of the odometry between knots, in world coordinates: half of the heading error, the move, the other half.

    The random errors grow with the true distance between knots and the angle turned. Relative error of E|e|² over n
    pieces: 1/(2n²). On the ``way`` back (-1), a heading bias per metre turns the other way.
    """
    random = _increments(part, noise, way)
    move = np.diff(part.truth)
    shift, one, zero = noise.distance_scale_error * move, np.ones(move.shape), np.zeros(move.shape)
    d1 = np.expm1(-random.heading_var / 4 + 0.5j * random.heading_mean)
    d2 = np.expm1(-random.heading_var + 1j * random.heading_mean) - 2 * d1
    half = Moments(one, zero, d1, d2, -2 * d1.real, zero, zero, zero, zero, zero)
    square, skew = np.abs(shift) ** 2 + random.square, shift**2 + random.elongation
    moved = Moments(one, move, zero, zero, zero, shift, square, skew, zero, zero)
    return compose(compose(half, moved), half)


class _Increments(NamedTuple):
    """Errors between knots: variance and mean of the heading's, E|z|² and E z² of the move's random part z."""

    heading_var: Floats
    heading_mean: Floats
    square: Floats
    elongation: Complexes


def _increments(part: ResampledDrive, noise: OdometryNoise, way: int = 1) -> _Increments:
    length, angle = np.diff(part.driven), part.angles
    along, across = noise.distance_var_per_m, noise.lateral_var_per_m
    return _Increments(
        noise.heading_var_per_m * length + noise.heading_var_per_rad * angle,
        way * noise.heading_bias_per_m * length + noise.heading_bias_per_rad * part.turns,
        (along + across) * length + noise.distance_var_per_rad * angle,
        (along - across) * part.travel_axes + noise.distance_var_per_rad * part.turn_axes,
    )


def windows(pieces: Moments, steps: Sequence[int]) -> dict[int, Moments]:
    """Moments of every run of n consecutive pieces, for each n in ``steps``: (m - n + 1,) each, from its halves."""
    known, count = {1: pieces}, pieces.shape[0]

    def of(n: int) -> Moments:
        if n not in known:
            half = n // 2
            known[n] = compose(of(half)[: count - n + 1], of(n - half)[half:])
        return known[n]

    return {n: of(n) for n in steps}


def _expect_with_heading(seen: Observations, w: Moments, truth: TruthNoise) -> tuple[Floats, Floats]:
    e1, e2 = w.e1 / seen.frame, w.e2 / seen.frame**2
    sine = w.d1.imag
    sine_square = -0.5 * (2 * w.d1 + w.d2).real
    e_sine = (w.b - w.a) / (2j * seen.frame)
    mean = np.stack([e1.real, e1.imag, sine], axis=-1)
    cross = e_sine - e1 * sine
    cov = np.empty((len(sine), 3, 3))
    cov[:, :2, :2] = as_covariance(e1, w.N, e2)
    cov[:, :2, 2] = cov[:, 2, :2] = as_plane(cross)
    cov[:, 2, 2] = sine_square - sine**2
    # a heading error η of the truth at the start turns the estimate by η, and adds η to the heading gained
    lever = 1j * seen.chord
    eta = np.stack([lever.real, lever.imag, np.ones(len(sine))], axis=-1)
    cov += truth.heading_var * eta[:, :, None] * eta[:, None, :]
    cov += np.diag([2 * truth.position_var, 2 * truth.position_var, truth.heading_var])
    return mean, cov


def _expect_positions(seen: Observations, back: Moments, ahead: Moments, truth: TruthNoise) -> tuple[Floats, Floats]:
    # chords as estimated: first + x, second + y, in the heading of the middle; errors of the truth are minus theirs
    x1, x2, X = -back.e1, back.e2, back.N
    y1, y2, Y = ahead.e1, ahead.e2, ahead.N
    mean_first = seen.chord.real + x1 / seen.frame
    # where so much noise is tried that nothing is left of the mean chord, the expansion only has to stay finite
    mean_first = np.where(np.abs(mean_first) > _LEAST_CHORD * seen.chord.real, mean_first, _LEAST_CHORD * seen.chord)
    c1 = np.abs(mean_first)
    g = seen.frame * mean_first / c1  # the frame of the mean estimated first chord
    second = ahead.p / seen.frame
    c2 = (ahead.p + y1) / g
    v = truth.position_var
    cov, none = np.zeros((len(c1), 4, 4)), np.zeros(())  # of Re x, Im x, Re y, Im y there
    cov[:, :2, :2] = as_covariance(none, X - np.abs(x1) ** 2 + 4 * v, (x2 - x1**2) / g**2)
    cov[:, 2:, 2:] = as_covariance(none, Y - np.abs(y1) ** 2 + 4 * v, (y2 - y1**2) / g**2)
    for k in (0, 1):
        cov[:, k, 2 + k] = cov[:, 2 + k, k] = -v

    # observed: |c1 + x| - first, and z - second with z = (c2 + y) exp(-jψ), ψ = arg(c1 + x) = Im x/c1 - Re x Im x/c1²
    # up to second order: z = c2 + y - jψ(c2 + y) - ψ² c2/2
    linear = np.zeros((len(c1), 3, 4))
    linear[:, 0, 0] = linear[:, 1, 2] = linear[:, 2, 3] = 1.0
    linear[:, 1, 1], linear[:, 2, 1] = c2.imag / c1, -c2.real / c1
    form = np.zeros((len(c1), 3, 4, 4))  # symmetric: the second order is v' form v, v as in cov
    form[:, 0, 1, 1] = 0.5 / c1
    form[:, 1, 1, 1], form[:, 2, 1, 1] = -0.5 * c2.real / c1**2, -0.5 * c2.imag / c1**2
    form[:, 1, 1, 3] = form[:, 1, 3, 1] = 0.5 / c1
    form[:, 2, 1, 2] = form[:, 2, 2, 1] = -0.5 / c1
    form[:, 1, 0, 1] = form[:, 1, 1, 0] = -0.5 * c2.imag / c1**2
    form[:, 2, 0, 1] = form[:, 2, 1, 0] = 0.5 * c2.real / c1**2
    spread = form @ cov[:, None]
    base = np.stack([c1 - seen.chord.real, (c2 - second).real, (c2 - second).imag], axis=-1)
    mean = base + np.trace(spread, axis1=2, axis2=3)
    spread[:, 0] = 0.0  # |c1 + x| varies no more than Re x: what one has of Im x², the other has with the other sign
    return mean, linear @ cov @ np.swapaxes(linear, 1, 2) + 2 * np.einsum("niab,njba->nij", spread, spread)
