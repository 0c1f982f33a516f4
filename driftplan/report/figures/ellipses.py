"""Error ellipses: their shape, where along a path they stand, and how much they are enlarged to be seen."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, log, log10

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats
from driftplan.model.drift import Drift


def error_ellipse(cov: ArrayLike, confidence: float = 0.95) -> tuple[Floats, Floats, Floats]:
    """Width, height and tilt of the ellipse that holds a Gaussian error of covariance ``cov`` with this confidence.

    Parameters
    ----------
    cov : (..., 2, 2) array, m²
    confidence : float in (0, 1)

    Returns
    -------
    width_m, height_m, angle_deg : (...), full axes, the longer one first, and the angle from +x to it,
        counter-clockwise, in degrees, as matplotlib has it

    >>> [round(float(x), 3) for x in error_ellipse([[4.0, 0.0], [0.0, 1.0]])]
    [9.791, 4.895, 0.0]
    """
    if not 0 < confidence < 1:
        raise ValueError(f"expected a confidence in (0, 1), got {confidence!r}")
    values, axes = np.linalg.eigh(np.asarray(cov, dtype=float))
    full = 2 * np.sqrt(-2 * np.log1p(-confidence) * np.maximum(values, 0.0))  # |e|² / σ² is chi-squared, 2 degrees
    # an axis has no direction: tilts in (-90°, 90°]
    x, y = axes[..., 0, 1], axes[..., 1, 1]
    return full[..., 1], full[..., 0], np.degrees(np.arctan2(np.where(x < 0, -y, y), np.abs(x)))


def mark_spacing(length_m: float, marks: int = 8) -> float:
    """A round distance (1, 2 or 5 times a power of ten, metres) that divides ``length_m`` into about ``marks`` pieces.

    >>> mark_spacing(62.0)
    10.0
    """
    if not length_m > 0:
        return 1.0
    wanted = length_m / marks
    return min(_round_numbers_about(wanted), key=lambda step: abs(log(step / wanted)))


def mark_distances(length_m: float, spacing_m: float) -> Floats:
    """Distances along a path to mark, metres: every ``spacing_m``, and the end.

    >>> mark_distances(33.0, 10.0)
    array([10., 20., 33.])
    """
    every = spacing_m * np.arange(1, floor(length_m / spacing_m) + 1)
    return np.append(every[every < length_m - 0.4 * spacing_m], length_m)


def magnification(drifts: Sequence[Drift], extent_m: float, confidence: float = 0.95) -> float:
    """How much to enlarge (or shrink) error ellipses on a map of diagonal ``extent_m``: ..., 0.5, 1, 2, 5, 10, 20, ...

    1 where the greatest ellipse at a waypoint takes 4 to 40 % of the diagonal, else the least change to get there.
    """
    widths = np.concatenate([np.ravel(error_ellipse(drift.cov, confidence)[0]) for drift in drifts])
    share = float(widths.max()) / extent_m
    if share < 1e-9 or 0.04 <= share <= 0.4:  # without noise there is nothing to see
        return 1.0
    if share < 0.04:
        return next(factor for factor in _round_numbers_about(0.04 / share) if factor >= 0.04 / share)
    return max(factor for factor in _round_numbers_about(0.4 / share) if factor <= 0.4 / share)


def _round_numbers_about(value: float) -> list[float]:
    """1, 2, 5 and 10 times the power of ten below ``value``, increasing."""
    exponent = floor(log10(value))
    return [float(f"{digit}e{exponent}") for digit in (1, 2, 5, 10)]
