"""What chance alone does to a check: the same segments, cut from drives that are simulated under the model.

Segments overlap, share turns and have errors of very different sizes, so that textbook standard errors of their mean
squares and shares are wrong by factors. Here the drive is repeated at its own knots with Gaussian errors of the model,
and whatever a check computes is computed of every repetition.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from driftplan.arrays import Floats
from driftplan.model.calibration.segment_sets import SegmentSet
from driftplan.model.calibration.segments import TruthNoise, errors_of, repeated
from driftplan.model.noise import OdometryNoise

LEVELS = (0.5, 0.9, 0.95)
LIMITS = tuple(float(-2 * np.log1p(-level)) for level in LEVELS)  # of χ² with two degrees of freedom
CLEAR_CHANCE = 0.01  # that a right model is said not to fit
_RUNS = 199
_NUMBERS_AT_ONCE = 4_000_000


class Chance(NamedTuple):
    """What a check measures on repetitions of the drives, if the model is right."""

    log_rms: Floats  # (runs, lengths) logarithms of the rms position error
    shares: Floats  # (runs, lengths, levels) shares inside the regions
    tails: Floats  # (runs, lengths) `tail_weight`

    @property
    def clear_rms_errors(self) -> float:
        """Standard errors that the rms of no length exceeds but for `CLEAR_CHANCE` of all checks, and at least 3."""
        return max(3.0, float(np.quantile(np.abs(_standard(self.log_rms)).max(axis=1), 1 - CLEAR_CHANCE)))

    @property
    def clear_share_errors(self) -> float:
        """The same for a share inside the widest region that is too small."""
        return max(3.0, float(np.quantile(-_standard(self.shares[..., -1]).min(axis=1), 1 - CLEAR_CHANCE)))

    def heavy_tails(self, tails: Floats) -> tuple[int, float]:
        """The length at which measured tails (lengths,) are heaviest, and the chance that some length's are as heavy
        under the model: false alarms at a level p are p of all."""
        standard = (tails - self.tails.mean(axis=0)) / np.maximum(self.tails.std(axis=0), 1e-12)
        heaviest = _standard(self.tails).min(axis=1)
        return int(np.argmin(standard)), float((1 + (heaviest <= standard.min()).sum()) / (1 + len(heaviest)))


def _standard(values: Floats) -> Floats:
    return np.asarray((values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1e-12))


def tail_weight(nees: Floats) -> Floats:
    """Logarithm of median over mean of normalised squares (..., n): -0.37 if Gaussian, lower where few hold most."""
    return np.asarray(np.log(np.maximum(np.median(nees, axis=-1), 1e-300) / np.maximum(nees.mean(axis=-1), 1e-300)))


def normalised_squares(segments: SegmentSet, values: Floats, mean: Floats, cov: Floats) -> Floats:
    """(y - m)' C⁻¹ (y - m) of the position errors in values (..., n, 3)."""
    where = segments.position
    surplus = values[..., where] - mean[:, where]
    return np.asarray(np.einsum("...ni,nij,...nj->...n", surplus, np.linalg.inv(cov[:, where, where]), surplus))


def repetitions(segments: SegmentSet, noise: OdometryNoise, truth: TruthNoise) -> Floats:
    """The observed values of all segments, (runs, n, 3), if the drives are driven again under a noise."""
    rng = np.random.default_rng(0)
    knots = sum(len(part.driven) for part in segments.resampled)
    chunk = int(np.clip(_NUMBERS_AT_ONCE // (knots + len(segments.values)), 1, _RUNS))
    found = []
    for begin in range(0, _RUNS, chunk):
        runs = min(chunk, _RUNS - begin)
        deviations = rng.standard_normal((3, runs)) if noise.varies_between_drives else np.zeros((3, runs))
        drives = [repeated(part, noise, truth, rng, deviations) for part in segments.resampled]
        observed = [(drives[i], seen.starts, length.steps) for length in segments.bins for i, seen in length.observed]
        found.append(np.concatenate([errors_of(*one) for one in observed], axis=-2))
    return np.concatenate(found)


def by_chance(segments: SegmentSet, repeated_values: Floats, mean: Floats, cov: Floats) -> Chance:
    """Spread of a check's figures for segments with these moments (n, 3), (n, 3, 3), in `repetitions`."""
    nees = normalised_squares(segments, repeated_values, mean, cov)
    square = (repeated_values[..., segments.position] ** 2).sum(axis=-1)
    squares, shares, tails = [], [], []
    for k in range(len(segments.bins)):
        mine = segments.bin_of == k
        squares.append(square[:, mine].mean(axis=1))
        shares.append(np.stack([(nees[:, mine] < limit).mean(axis=1) for limit in LIMITS], axis=1))
        tails.append(tail_weight(nees[:, mine]))
    log_rms = 0.5 * np.log(np.maximum(np.stack(squares, axis=1), 1e-300))
    return Chance(log_rms, np.stack(shares, axis=1), np.stack(tails, axis=1))
