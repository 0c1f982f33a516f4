"""How well a fit is known: block bootstrap of the estimate, its intervals, and the spread from drive to drive."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import MAX_NUMBER, Floats
from driftplan.model.calibration.quasi_likelihood import (
    RANDOM,
    SYSTEMATIC,
    TRUTH,
    Model,
    Solution,
    drive_deviations,
    equations,
    information,
    models,
    normed,
    start_and_scale,
)
from driftplan.model.calibration.segment_sets import SegmentSet
from driftplan.model.calibration.segments import TruthNoise
from driftplan.model.noise import BETWEEN_DRIVES, OdometryNoise

_MOST_LOG = 50.0  # of a mean square over its prediction: beyond, nothing is known, and exp would overflow
_THREE_ERRORS = 0.00135  # chance of a normal value above three standard deviations
_BLOCK_SPANS = 2  # length of a bootstrap block, in longest segments
_BLOCK_STARTS = 8  # blocks begin every 1/8 of their length


def bootstrap(segments: SegmentSet, solution: Solution, resamples: int, rng: np.random.Generator) -> tuple[Floats, int]:
    """One step from the estimate for blocks of the drives drawn anew.

    Blocks, two longest segments long, may begin anywhere in steps of 1/8 of their length; the drives' end joins their
    beginning. Variances may come out negative here; what pushes one that is at its bound below zero is taken out, so
    that its replicates spread about zero. (F. Hu and J. D. Kalbfleisch, The estimating function bootstrap, Canadian
    Journal of Statistics 28 (2000) 449-481.)

    Returns replicates (resamples, k), and how many blocks make the whole.
    """
    length = _BLOCK_SPANS * segments.bins[-1].length_m
    blocks = max(int(segments.total_m / length), 2)
    slots = _BLOCK_STARTS * blocks
    slot_of = np.minimum((segments.place_m / segments.total_m * slots).astype(int), slots - 1)
    score = _blocks([solution.score[slot_of == k].sum(axis=0) for k in range(slots)])
    slope = _blocks([information(solution.root[slot_of == k]) for k in range(slots)])
    drawn = rng.multinomial(blocks, np.full(slots, 1 / slots), size=resamples).astype(float)
    push = np.where(solution.bounded & (solution.theta == 0), solution.score.sum(axis=0), 0.0)
    total, scale = normed(np.tensordot(drawn, slope, 1))
    step = np.linalg.solve(total, ((drawn @ score - push) * scale)[..., None])[..., 0] * scale
    return np.asarray(solution.theta + step), blocks


def systematic_covariance(segments: SegmentSet, solution: Solution) -> Floats:
    """Covariance (k, k) of the fitted systematic errors, by the bootstrap; 0 for the other parameters."""
    replicates, blocks = bootstrap(segments, solution, 400, np.random.default_rng(0))
    cov = _widened(blocks) ** 2 * np.atleast_2d(np.cov(replicates.T))
    return np.asarray(np.where(solution.bounded[:, None] | solution.bounded, 0.0, cov))


def spread_out(solution: Solution, replicates: Floats, blocks: int, confidence: float) -> Floats:
    """Replicates as far from the estimate as their number of blocks calls for.

    Blocks drawn anew vary (blocks - 1)/blocks times too little; segments that reach from one block into the next add
    1/(3 spans per block) of the variance that the blocks cannot show; and few blocks ask for Student's quantile.
    """
    tail = (1 - confidence) / 2
    student = student_allowance(blocks, tail)
    return np.asarray(solution.theta + _widened(blocks) * student * (replicates - solution.theta))


def student_allowance(blocks: int, tail: float) -> float:
    """Student's quantile over the normal one, for errors that so many blocks tell."""
    from scipy.special import ndtri, stdtrit

    return float(stdtrit(blocks - 1, 1 - tail) / ndtri(1 - tail))


def intervals(solution: Solution, replicates: Floats, confidence: float) -> tuple[Floats, Floats]:
    """Percentile intervals of `spread_out` replicates: they hold the estimate, and no negative variance."""
    tail = (1 - confidence) / 2
    low, high = np.quantile(replicates, [tail, 1 - tail], axis=0)
    low = np.where(solution.bounded, np.maximum(low, 0.0), low)
    return np.minimum(low, solution.theta), np.maximum(high, solution.theta)


def standard_errors(replicates: Floats, blocks: int) -> Floats:
    """Standard deviations of `bootstrap` replicates, with the same allowances, Student's apart."""
    return np.asarray(_widened(blocks) * replicates.std(axis=0))


class RmsSpread(NamedTuple):
    """How well a fit knows the rms that it predicts on every bin: intervals (bins, 2), standard errors (bins,)."""

    intervals: Floats
    std_errors: Floats


def rms_spread(
    segments: SegmentSet, solution: Solution, replicates: Floats, confidence: float, where: slice
) -> RmsSpread:
    """Spread of the predicted rms of the observed values ``where``: its logarithm to first order in the parameters."""
    noise, truth = models(solution.names, solution.theta)
    mean, cov = segments.expected(segments.windows(noise), truth)
    m, C = mean[:, where], cov[:, where, where]
    square = segments.by_bin((m**2).sum(axis=1) + np.trace(C, axis1=1, axis2=2))
    slope = 2 * (m[:, None] * solution.d_mean[:, :, where]).sum(axis=-1)
    slope = segments.by_bin(slope + np.trace(solution.d_cov[:, :, where, where], axis1=2, axis2=3))
    square = np.maximum(square, 1e-300)
    logs = (replicates - solution.theta) @ slope.T / square  # of the mean square: it is positive, and skew as few slips
    tail = (1 - confidence) / 2
    bounds = np.clip(np.quantile(logs, [tail, 1 - tail], axis=0), -_MOST_LOG, _MOST_LOG)
    low_high = np.sqrt(square * np.exp(bounds)).T
    return RmsSpread(low_high, 0.5 * np.sqrt(square) * logs.std(axis=0))


def systematic_errors(
    segments: SegmentSet, noise: OdometryNoise, truth: TruthNoise
) -> tuple[dict[str, tuple[float, float]], Floats]:
    """What the systematic errors of these drives seem to be, one step from a noise: values and a third of the
    distance that chance exceeds as seldom as three standard errors. And the slopes (n, 3, 3) of the mean errors."""
    names = (*SYSTEMATIC, *RANDOM, *TRUTH)
    theta = np.array([*(getattr(noise, name) for name in (*SYSTEMATIC, *RANDOM)), *truth])
    model = Model(segments, names, theta)
    d_mean, d_cov = model.slopes(start_and_scale(segments, names)[1])
    few = len(SYSTEMATIC)
    score, root = (x[:, :few] for x in equations(segments, model.mean, model.cov, d_mean, d_cov))
    step = np.linalg.lstsq(information(root), score.sum(axis=0))[0]
    there = score - (root @ np.swapaxes(root, 1, 2)) @ step
    here = Solution(SYSTEMATIC, theta[:few] + step, there, root, True, "", d_mean[:, :few], d_cov[:, :few])
    replicates, blocks = bootstrap(segments, here, 400, np.random.default_rng(0))
    error = standard_errors(replicates, blocks) * student_allowance(blocks, _THREE_ERRORS)
    found = {name: (float(here.theta[k]), float(error[k])) for k, name in enumerate(SYSTEMATIC)}
    return found, here.d_mean


def between_drives(segments: SegmentSet, solution: Solution, std_errors: dict[str, float]) -> dict[str, Any]:
    """Standard deviations, by the names of `OdometryNoise`, by which another drive's systematic errors differ from the
    fitted ones: the fit's own error, and the spread from drive to drive beyond what each drive leaves open. Of one
    drive that spread is unknown, and taken for as large as the fit's own error."""
    own, names = drive_deviations(segments, solution), [name for name in solution.names if name in SYSTEMATIC]
    error = np.array([std_errors[name] for name in names]) ** 2
    drives, variances = len(own), 2 * error
    if drives > 1:
        spread = np.var(own, axis=0, ddof=1)  # of which each drive's own error is no part of the next drive's
        variances = np.maximum(spread - drives * error, 0.0) + np.maximum(error, spread / drives)
    variances = np.minimum(variances, MAX_NUMBER)  # of what these drives do not tell at all
    return {BETWEEN_DRIVES[name]: sqrt(variance) for name, variance in zip(names, variances.tolist(), strict=True)}


def _widened(blocks: int) -> float:
    return sqrt(blocks / (blocks - 1) / (1 - 1 / (3 * _BLOCK_SPANS)))


def _blocks(slotted: list[Floats]) -> Floats:
    """Sums over the blocks that begin at every slot."""
    return np.asarray(np.sum([np.roll(slotted, -k, axis=0) for k in range(_BLOCK_STARTS)], axis=0))
