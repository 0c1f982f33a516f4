"""Distributions of one step's heading error, each by its exact characteristic function φ(k) = E[exp(jkθ)].

All laws here are symmetric about zero; a mean is added by `shifted`. What the algebra needs of a law is small: the
moments of r = exp(jθ) up to the second, as deviations from 1 so that no digit is lost when the noise is tiny, and,
for translation errors correlated with θ, E[θ r], E[θ r²] and E[θ² r²].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from driftplan.arrays import Array
from driftplan.model.noise import HeadingLaw

_CIRCLE = 256  # nodes on the circle


class LawMoments(NamedTuple):
    """Moments of a symmetric heading error θ with r = exp(jθ); arrays of the variance's shape."""

    d1: Array  # E[r] - 1, real
    d2: Array  # E[(r - 1)²], real
    theta_r: Array  # Im E[θ r] (its real part vanishes)
    theta_r2: Array  # Im E[θ r²]
    theta2_r2: Array  # E[θ² r²], real


def law_moments(law: HeadingLaw, variance: Array) -> LawMoments:
    """Moments of ``law`` with the given variance (rad², any shape).

    For ``"von_mises"`` the concentration is 1/variance and the moments with θ are not available (NaN).

    >>> law_moments("gaussian", np.array(0.04)).d1.round(6).item()  # exp(-0.02) - 1
    -0.019801
    """
    return _LAWS[law](np.asarray(variance, dtype=float))


def shifted(d1: Array, d2: Array, mean: Array) -> tuple[Array, Array]:
    """E[r] - 1 and E[(r - 1)²] after adding a ``mean`` (rad) to the heading error; complex unless the mean is zero."""
    mean = np.asarray(mean)
    if not mean.any():
        return d1, d2
    g = -2 * np.sin(mean / 2) ** 2 + 1j * np.sin(mean)
    w = 1 + g
    return g + w * d1, g * g + 2 * g * w * d1 + w * w * d2


def _gaussian(v: Array) -> LawMoments:
    d1 = np.expm1(-v / 2)
    m2 = np.exp(-2 * v)
    return LawMoments(d1, np.expm1(-2 * v) - 2 * d1, v * np.exp(-v / 2), 2 * v * m2, (v - 4 * v * v) * m2)


def _laplace(v: Array) -> LawMoments:
    s = v / 2  # the scale squared
    k1, k2 = 1 + s, 1 + 4 * s
    d1 = -s / k1
    return LawMoments(d1, -4 * s / k2 - 2 * d1, 2 * s / k1**2, 4 * s / k2**2, 2 * s / k2**2 - 32 * s * s / k2**3)


def _uniform(v: Array) -> LawMoments:
    w = np.sqrt(3 * v)  # half-width
    f1, g1, _ = _sinc_derivatives(w)
    f2, g2, h2 = _sinc_derivatives(2 * w)
    return LawMoments(f1, f2 - 2 * f1, -w * g1, -w * g2, -w * w * h2)


def _sinc_derivatives(x: Array) -> tuple[Array, Array, Array]:
    """sinc - 1, sinc' and sinc'' at x, sinc = sin(x)/x: series below 0.5, where the quotients cancel."""
    near = np.abs(x) < 0.5
    y = np.where(near, 1.0, x)
    far0 = np.sin(y) / y
    far1 = (np.cos(y) - far0) / y
    far2 = -far0 - 2 * far1 / y
    z = np.where(near, x, 0.0) ** 2
    s0, s1, s2, term = np.zeros_like(z), np.zeros_like(z), np.zeros_like(z), np.ones_like(z)
    for k in range(1, 10):  # term = (-1)^k x^(2k-2) / (2k+1)!
        term = -term / (2 * k * (2 * k + 1)) * (z if k > 1 else 1.0)
        s0, s1, s2 = s0 + term * z, s1 + 2 * k * term, s2 + 2 * k * (2 * k - 1) * term
    return np.where(near, s0, far0 - 1), np.where(near, s1 * x, far1), np.where(near, s2, far2)


def _von_mises(v: Array) -> LawMoments:
    # 1 - I1(κ)/I0(κ) = E(1 - cos θ): above κ = 500 by its asymptotic series, below by the trapezoidal rule over the
    # circle, which converges like exp(-_CIRCLE²/2κ) and adds positive numbers only
    concentrated = v < 1 / 500
    x = np.where(concentrated, v, 0.0)
    near = x * (0.5 + x * (1 / 8 + x * (1 / 8 + x * (25 / 128 + x * (13 / 32 + x * (1073 / 1024 + x * 103 / 32))))))
    spread, back = np.unique(np.where(concentrated, 1.0, v), return_inverse=True)
    fall = 2 * np.sin(np.pi * np.arange(_CIRCLE) / _CIRCLE) ** 2  # 1 - cos θ
    weight = np.exp(-fall / spread[:, None])
    far = (weight @ fall / weight.sum(axis=1))[back].reshape(v.shape)
    d1 = -np.where(concentrated, near, far)
    nan = np.full_like(v, np.nan)
    return LawMoments(d1, -2 * d1 - 2 * (1 + d1) * v, nan, nan, nan)


_LAWS = {"gaussian": _gaussian, "laplace": _laplace, "uniform": _uniform, "von_mises": _von_mises}
