"""Noise rates from segment errors: a weighted regression on closed-form moments, iterated, and its block bootstrap.

The observations y_i (`driftplan.model.calibration.segments`) of segments of several lengths have, under a noise model
θ, means μ_i(θ) and covariances C_i(θ) in closed form. Maximising the Gaussian quasi-likelihood Σ w_i log N(y_i; μ_i,
C_i) over θ solves, for every parameter,

    Σ w_i [ ∂μ_i' V_i (y_i - μ_i) + ½ tr(∂C_i V_i ((y_i - μ_i)(y_i - μ_i)' - C_i) V_i) ] = 0,    V_i = C_i⁻¹,

equations that are unbiased for any weights V_i and any distribution with the right moments. Two choices make them serve
prediction even where the model is only roughly right:

* Each *length* has the same weight in all. Short segments, far more numerous, would otherwise decide alone, and at
  short range odometry errs in ways that do not last (clock offsets, antenna levers, jitter).
* V_i is the inverse of 0.8 C_i + 0.2 C̄, C̄ the average over all segments of that length: a segment from which the
  model promises next to no error must not decide either. (On the drives of a mower with slips, predicted and measured
  rms then agree at all lengths, where the maximum of the likelihood was off by a factor of two.)

* Fitted systematic errors take part of the random ones with them: residuals spread by C less the covariance of the
  fitted mean. That is added back, from the bootstrap (it is 1/8 of a rate for two biases and 16 longest segments).

A step of Fisher scoring solves ``I d = g`` (g the left side, I its expected slope, with numerical derivatives of the
exact moments), no variance negative. The same step from the estimate, blocks of the drives drawn anew, bootstraps it.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import MAX_NUMBER, Floats
from driftplan.model.calibration.segment_sets import SegmentSet
from driftplan.model.calibration.segments import TruthNoise
from driftplan.model.noise import BETWEEN_DRIVES, OdometryNoise

SYSTEMATIC = ("distance_scale_error", "heading_bias_per_m", "heading_bias_per_rad")
RANDOM = ("heading_var_per_m", "heading_var_per_rad", "distance_var_per_m", "distance_var_per_rad", "lateral_var_per_m")
TRUTH = ("truth_position_var", "truth_heading_var")
DRIVES_TO_HOLD_OUT = 3  # as many as these, and each is predicted from the others

_EVENNESS = 0.2  # share of the average covariance in the weights
_SLOWEST_SHRINK = 0.1  # a variance falls to no less than this share in one step: it may be needed to explain the rest
_MIN_RELATIVE = {"distance_scale_error": -0.9, "heading_bias_per_rad": -0.9}  # at -1 nothing would be measured
_MOST_SCALES = 1e6  # a variance above what would explain all errors so many times has no end: headings only go round
_NEGLIGIBLE = 1e-2  # standard errors: a variance below is taken for 0
_DERIVATIVE_STEP = 1e-3
_DAMPED_AFTER = 10  # steps are halved, after as many again halved again
_SETTLED = 1.0  # standard errors: steps below leave the derivatives as they are
_CONVERGED = 0.01  # standard errors
_HELD_OUT_STEPS = 4  # from the estimate of all drives to that of some
_PARTS = 5  # of the drives, each predicted from the others
_MOST_LOG = 50.0  # of a mean square over its prediction: beyond, nothing is known, and exp would overflow
_THREE_ERRORS = 0.00135  # chance of a normal value above three standard deviations
_BLOCK_SPANS = 2  # length of a bootstrap block, in longest segments
_BLOCK_STARTS = 8  # blocks begin every 1/8 of their length


class Solution(NamedTuple):
    """The estimate."""

    names: tuple[str, ...]  # parameters, k in all: fields of `OdometryNoise` and the truth's variances
    theta: Floats  # (k,)
    score: Floats  # (n, k) left side of the equations, of every observation, at the estimate
    root: Floats  # (n, k, 12) root of its expected slope, the `information`
    converged: bool
    slowest: str
    d_mean: Floats  # (n, k, 3) derivatives of the moments of the observations
    d_cov: Floats  # (n, k, 3, 3) likewise

    @property
    def bounded(self) -> NDArray[np.bool_]:
        """Which parameters are variances, (k,)."""
        return np.array([name not in SYSTEMATIC for name in self.names])

    def variance_inflation(self) -> dict[str, float]:
        """How many times larger the variance of each estimate is than were the others known; not of those at 0."""
        free = np.flatnonzero(~self.bounded | (self.theta > 0))
        total, _ = normed(information(self.root[:, free]))
        return {self.names[k]: float(v) for k, v in zip(free, np.diag(np.linalg.inv(total)), strict=True)}


def models(names: Sequence[str], theta: Floats) -> tuple[OdometryNoise, TruthNoise]:
    """The noise models that a parameter vector stands for."""
    values = dict(zip(names, theta.tolist(), strict=True))
    truth = TruthNoise(*(values.pop(name, 0.0) for name in TRUTH))
    return OdometryNoise(**values), truth


def solve(
    segments: SegmentSet,
    names: Sequence[str],
    most_steps: int,
    start: Floats | None = None,
    fitted_cov: Floats | None = None,
) -> Solution:
    """The parameters that solve the equations, or the last of ``most_steps`` steps from ``start`` towards them; with
    the covariance (k, k) of fitted systematic errors, made up for what they took."""
    names = tuple(names)
    theta, scale = start_and_scale(segments, names)
    theta = theta if start is None else start
    bounded = np.array([name not in SYSTEMATIC for name in names])
    longest = np.array([0.5 / segments.bins[-1].length_m if name == "heading_bias_per_m" else 0.2 for name in names])
    model = Model(segments, names, theta)
    size = np.inf
    for k in range(most_steps):
        if size > _SETTLED:
            slopes = model.slopes(scale)
        score, root = equations(segments, model.mean, model.cov, *slopes, fitted_cov)
        total = information(root)
        error = 1 / np.sqrt(np.maximum(np.diag(total), 1e-300))
        lowest = np.where(bounded, -(1 - _SLOWEST_SHRINK) * model.theta, -np.inf)
        lowest = np.where(bounded & (model.theta < _NEGLIGIBLE * error), -model.theta, lowest)  # may vanish
        step = bounded_step(total, score.sum(axis=0), lowest)
        step = np.where(bounded, step, np.clip(step, -longest, longest))
        slowest = int(np.argmax(np.abs(step) / error))
        size = float(np.abs(step[slowest]) / error[slowest])
        damped = 0.5 ** (k // _DAMPED_AFTER) * step  # weights that follow the estimate can make it swing
        model = Model(segments, names, np.clip(model.theta + damped, *limits(segments, names)))
        if size < _CONVERGED:
            break
    theta = np.where(bounded & (model.theta < _NEGLIGIBLE * error), 0.0, model.theta)
    found = solution_at(segments, names, theta, fitted_cov)
    return found._replace(converged=size < _CONVERGED, slowest=names[slowest])


def solution_at(
    segments: SegmentSet, names: tuple[str, ...], theta: Floats, fitted_cov: Floats | None = None
) -> Solution:
    """An estimate beside these segments: its equations and derivatives there."""
    model = Model(segments, names, theta)
    slopes = model.slopes(start_and_scale(segments, names)[1])
    score, root = equations(segments, model.mean, model.cov, *slopes, fitted_cov)
    return Solution(names, theta, score, root, True, "", *slopes)


def drive_deviations(segments: SegmentSet, solution: Solution) -> Floats:
    """By how much each drive's own systematic errors differ from the fitted ones, (drives, of them fitted)."""
    chosen = [k for k, name in enumerate(solution.names) if name in SYSTEMATIC]
    own = []
    for drive in np.unique(segments.drive_of):
        mine = segments.drive_of == drive
        total = information(solution.root[mine][:, chosen])
        own.append(np.linalg.lstsq(total, solution.score[mine].sum(axis=0)[chosen])[0])
    return np.array(own)


def bounded_step(total: Floats, score: Floats, lowest: Floats) -> Floats:
    """Minimiser d of d'Id/2 - g'd with d >= lowest, shapes (k, k), (k,), (k,).

    >>> bounded_step(np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-3.0, 0.0]), np.array([-1.0, -np.inf])).round(9)
    array([-1. ,  0.5])
    """
    from scipy.optimize import lsq_linear

    unit, scale = normed(total)
    root = np.linalg.cholesky(unit)
    bounds = (np.minimum(lowest / scale, -1e-15), np.inf)
    found = lsq_linear(root.T, np.linalg.solve(root, score * scale), bounds, method="bvls", tol=1e-12)
    return np.asarray(np.maximum(found.x * scale, lowest))


def held_out(segments: SegmentSet, solution: Solution) -> tuple[Floats, Floats]:
    """Mean (n, 3) and covariance (n, 3, 3) that each part of the drives has by the estimate from the other parts.

    A part is a drive where there are three or more, else a fifth of them laid end to end. The estimate without a part
    is a few steps from the whole one, with that one's derivatives.
    """
    part, parts = segments.drive_of, int(segments.drive_of.max()) + 1
    if parts < DRIVES_TO_HOLD_OUT:
        part, parts = np.minimum((segments.place_m / segments.total_m * _PARTS).astype(int), _PARTS - 1), _PARTS
    mean, cov = np.empty((len(part), 3)), np.empty((len(part), 3, 3))
    whole, bounds = Model(segments, solution.names, solution.theta), limits(segments, solution.names)
    for k in range(parts):
        mine, model = part == k, whole
        for _ in range(_HELD_OUT_STEPS):
            score, root = equations(segments, model.mean, model.cov, solution.d_mean, solution.d_cov)
            lowest = np.where(solution.bounded, -model.theta, -np.inf)
            step = bounded_step(information(root[~mine]), score[~mine].sum(axis=0), lowest)
            model = Model(segments, solution.names, np.clip(model.theta + step, *bounds))
        mean[mine], cov[mine] = model.mean[mine], model.cov[mine]
    return mean, cov


def limits(segments: SegmentSet, names: Sequence[str]) -> tuple[Floats, Floats]:
    """Least and greatest value of every parameter."""
    _, scale = start_and_scale(segments, names)
    least = [_MIN_RELATIVE.get(name, -np.inf) if name in SYSTEMATIC else 0.0 for name in names]
    most = np.where([name in SYSTEMATIC for name in names], np.inf, np.minimum(_MOST_SCALES * scale, 0.5 * MAX_NUMBER))
    return np.array(least), most


class Model:
    """Moments of the observations at one parameter vector."""

    def __init__(self, segments: SegmentSet, names: tuple[str, ...], theta: Floats) -> None:
        self.segments, self.names, self.theta = segments, names, theta
        noise, truth = models(names, theta)
        self.windows = segments.windows(noise)
        self.mean, self.cov = segments.expected(self.windows, truth)

    def slopes(self, scale: Floats) -> tuple[Floats, Floats]:
        """Derivatives of the moments by forward differences, (n, k, 3) and (n, k, 3, 3)."""
        means, covs = [], []
        for k, name in enumerate(self.names):
            step = _DERIVATIVE_STEP * max(abs(self.theta[k]), scale[k])
            moved = self.theta.copy()
            moved[k] += step
            noise, truth = models(self.names, moved)
            found = self.windows if name in TRUTH else self.segments.windows(noise)
            mean, cov = self.segments.expected(found, truth)
            means.append((mean - self.mean) / step)
            covs.append((cov - self.cov) / step)
        return np.stack(means, axis=1), np.stack(covs, axis=1)


def equations(
    segments: SegmentSet, mean: Floats, cov: Floats, d_mean: Floats, d_cov: Floats, fitted_cov: Floats | None = None
) -> tuple[Floats, Floats]:
    """Left side (n, k) and root (n, k, 12) of its expected slope: least squares in 3 whitened values, and 9 squares."""
    typical = (segments.by_bin(cov) + segments.floor())[segments.bin_of]
    try:
        white = np.linalg.inv(np.linalg.cholesky((1 - _EVENNESS) * cov + _EVENNESS * typical))  # white' white = V
    except np.linalg.LinAlgError:
        raise ValueError(
            f"expected errors that some noise explains, got odometry that counts {segments.counted_over_true:.3g} "
            "times the true distance and errors that none does: check units and columns of odometry and truth"
        ) from None
    transposed = np.swapaxes(white, 1, 2)
    r = (white @ (segments.values - mean)[..., None])[..., 0]
    J = d_mean @ transposed
    both = (transposed[:, :, None, :, None] * transposed[:, None, :, None, :]).reshape(-1, 9, 9)
    K = d_cov.reshape(*d_mean.shape[:2], 9) @ both  # white ∂C white'
    spread = cov if fitted_cov is None else cov - np.swapaxes(d_mean, 1, 2) @ fitted_cov @ d_mean
    surplus = (r[:, :, None] * r[:, None, :] - white @ spread @ transposed).reshape(-1, 9)
    weight = np.sqrt(segments.weight)[:, None]
    root = np.concatenate([J, np.sqrt(0.5) * K], axis=2) * weight[..., None]
    misfit = np.concatenate([r, np.sqrt(0.5) * surplus], axis=1) * weight
    return (root @ misfit[..., None])[..., 0], root


def information(root: Floats) -> Floats:
    """The expected slope (k, k) of the left side of the equations of these observations."""
    columns = np.moveaxis(root, 1, 0).reshape(root.shape[1], root.shape[0] * root.shape[2])
    return np.asarray(columns @ columns.T)


def start_and_scale(segments: SegmentSet, names: Sequence[str]) -> tuple[Floats, Floats]:
    """Where to begin, and the scale of each parameter: shares of the mean squares of the longest segments."""
    length, shortest = segments.bins[-1].length_m, segments.bins[0].length_m
    squares = segments.by_bin(segments.values**2)[-1]
    along = squares[0] / length
    heading = squares[2] / length if segments.has_heading else 12 * squares[2] / length**3
    share = {name: (heading if name.startswith("heading") else along) / 2 for name in RANDOM}
    share |= {"truth_position_var": 0.01 * along * shortest, "truth_heading_var": 0.01 * heading * shortest}
    size = {**share, **dict.fromkeys(SYSTEMATIC, 0.01), "heading_bias_per_m": np.sqrt(heading / length)}
    theta = np.array([share.get(name, 0.0) for name in names])
    return theta, np.array([max(float(size[name]), 1e-18) for name in names])


def normed(total: Floats) -> tuple[Floats, Floats]:
    """Information (..., k, k) with a unit diagonal, barely regularised, and the scales that made it so."""
    scale = 1 / np.sqrt(np.maximum(np.diagonal(total, axis1=-2, axis2=-1), 1e-60))
    normed = total * scale[..., :, None] * scale[..., None, :]
    return normed + 1e-9 * np.eye(scale.shape[-1]), scale


def bootstrap(segments: SegmentSet, solution: Solution, resamples: int, rng: np.random.Generator) -> tuple[Floats, int]:
    """One step from the estimate for blocks of the drives drawn anew.

    Blocks, two longest segments long, may begin anywhere in steps of 1/8 of their length; the drives' end joins their
    beginning. Variances may come out negative here; what pushes one that is at its bound below zero is taken out, so
    that its replicates spread about zero. (F. Hu and J. D. Kalbfleisch, The estimating function bootstrap, Canadian
    Journal of Statistics 28 (2000) 449-481.)

    Returns replicates (resamples, k), and how many blocks make the whole. They are spread as far as that number calls
    for: blocks drawn anew vary (blocks - 1)/blocks times too little, and segments that reach from one block into the
    next add 1/(3 spans per block) of the variance that the blocks cannot show.
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
    widened = sqrt(blocks / (blocks - 1) / (1 - 1 / (3 * _BLOCK_SPANS)))
    return np.asarray(solution.theta + widened * step), blocks


def systematic_covariance(segments: SegmentSet, solution: Solution) -> Floats:
    """Covariance (k, k) of the fitted systematic errors, by the bootstrap; 0 for the other parameters."""
    cov = np.atleast_2d(np.cov(bootstrap(segments, solution, 400, np.random.default_rng(0))[0].T))
    return np.asarray(np.where(solution.bounded[:, None] | solution.bounded, 0.0, cov))


def student_allowance(blocks: int, tail: float) -> float:
    """Student's quantile over the normal one, for errors that so many blocks tell."""
    from scipy.special import ndtri, stdtrit

    return float(stdtrit(blocks - 1, 1 - tail) / ndtri(1 - tail))


class RmsSpread(NamedTuple):
    """How well a fit knows the rms that it predicts on every bin: intervals (bins, 2), standard errors (bins,)."""

    intervals: Floats
    std_errors: Floats


def rms_spread(
    segments: SegmentSet, solution: Solution, replicates: Floats, confidence: float, where: slice
) -> RmsSpread:
    """Spread of the predicted rms of the observed values ``where``: its logarithm to first order in the parameters."""
    model = Model(segments, solution.names, solution.theta)
    m, C = model.mean[:, where], model.cov[:, where, where]
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
    there, few = solution_at(segments, names, theta), len(SYSTEMATIC)
    score, root, d_mean, d_cov = (x[:, :few] for x in (there.score, there.root, there.d_mean, there.d_cov))
    step = np.linalg.lstsq(information(root), score.sum(axis=0))[0]
    score = score - (root @ np.swapaxes(root, 1, 2)) @ step
    here = Solution(SYSTEMATIC, theta[:few] + step, score, root, True, "", d_mean, d_cov)
    replicates, blocks = bootstrap(segments, here, 400, np.random.default_rng(0))
    error = replicates.std(axis=0) * student_allowance(blocks, _THREE_ERRORS)
    return {name: (float(here.theta[k]), float(error[k])) for k, name in enumerate(SYSTEMATIC)}, d_mean


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


def _blocks(slotted: list[Floats]) -> Floats:
    """Sums over the blocks that begin at every slot."""
    return np.asarray(np.sum([np.roll(slotted, -k, axis=0) for k in range(_BLOCK_STARTS)], axis=0))
