"""The error-moment algebra of `driftplan.model.spatial.moments` for rotation noise that prefers no direction.

E[G] and Y -> E[G Y Gᵀ] are then multiples of the identity, l1 on vectors and l2 on symmetric matrices without trace,
and of the cross moments of e and G two vectors remain. Prefixes are plain recurrences, and continuous noise has closed
forms.
"""

from __future__ import annotations

from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyval

from driftplan.arrays import Floats
from driftplan.model.spatial.moments import Arrays, rotate, scan
from driftplan.model.spatial.rotations import RotationNoise

_EYE = np.eye(3)
_DIAGONAL = ([0, 1, 2], [0, 1, 2])


class IsotropicMoments(NamedTuple):
    """Moments for rotation noise without a preferred direction, over any leading axes.

    E[G Y Gᵀ] - Y = -lost2 (Y - tr(Y)/3 I) for symmetric Y, and E[e (G v)ᵀ] + its transpose = (f·v) I + g vᵀ + v gᵀ.
    """

    p: Floats  # (..., 3) true displacement
    lost1: Floats  # (...) 1 - l1, E[G] = l1 I
    lost2: Floats  # (...) 1 - l2
    bias: Floats  # (..., 3) E[e]
    f: Floats  # (..., 3)
    g: Floats  # (..., 3)
    square: Floats  # (..., 3, 3) E[e eᵀ]

    @classmethod
    def of_step(cls, noise: RotationNoise, bias: Floats, cov: Floats) -> IsotropicMoments:
        """Noise of one step at rest: attitude error R̃, then translation error with the given mean and covariance."""
        lost1, lost2 = noise.decay
        jitter = _STILL._replace(bias=bias, g=bias, square=cov + bias[..., :, None] * bias[..., None, :])
        return _STILL._replace(lost1=lost1, lost2=lost2).append(jitter)

    @classmethod
    def of_straight_runs(cls, z: Floats, rotation_rate: Floats, along: Floats, across: Floats) -> IsotropicMoments:
        """Runs with continuous noise: Brownian attitude error, white translation error.

        Parameters
        ----------
        z : (..., 3), displacements, metres
        rotation_rate : (...), variance of the attitude error about each axis per metre, rad²/m
        along, across : (...), variance of the position per metre, m²/m, in the estimated direction of flight and in
            each across it
        """
        length = np.linalg.norm(z, axis=-1)
        u = z / np.where(length > 0, length, 1.0)[..., None]
        x = rotation_rate * length
        lost1, lost2 = -np.expm1(-x), -np.expm1(-3 * x)
        slip, bend, ball, line = _straight_integrals(x, lost1)
        f = length * bend * (2 - 2 / 3 * lost1)
        g = -length * (1 - lost1) * (slip + bend)
        uu = u[..., :, None] * u[..., None, :]
        area = length * length
        skewed = (along - across) * length * np.where(x > 0, lost2 / np.where(x > 0, 3 * x, 1.0), 1.0)
        round_part = area * ball + length * (across + (along - across) / 3) - skewed / 3
        Q = round_part[..., None, None] * _EYE + (area * line + skewed)[..., None, None] * uu
        return cls(z, lost1, lost2, -z * slip[..., None], f[..., None] * u, g[..., None] * u, Q)

    def append(self, B: IsotropicMoments, /) -> IsotropicMoments:
        """This motion, then B, in the same axes."""
        e, f, g = self._vectors(B)
        return IsotropicMoments(
            self.p + B.p,
            self.lost1 + B.lost1 - self.lost1 * B.lost1,
            self.lost2 + B.lost2 - self.lost2 * B.lost2,
            self.bias + e,
            self.f * (1 - B.lost1)[..., None] + f,
            self.g * (1 - B.lost1)[..., None] + g,
            self.square + self._square_gain(B),
        )

    def moved(self, z: Floats, /) -> IsotropicMoments:
        """This motion, then a translation by z that errs only through the attitude."""
        return self.append(_STILL._replace(p=z))

    def prefixes(self) -> IsotropicMoments:
        """Moments of the first, the first two, ... of these motions (n,), in the same axes: recurrences, one by one."""
        lost1, lost2 = scan(_lose, [self.lost1, self.lost2])
        before = _STILL._replace(lost1=_earlier(lost1), lost2=_earlier(lost2))
        e, f, g = before._vectors(self)
        e = np.cumsum(e, axis=0)
        _, fg = scan(_fade_and_add, [self.lost1, np.concatenate([f, g], axis=-1)])
        f, g = fg[:, :3], fg[:, 3:]
        before = before._replace(bias=_earlier(e), f=_earlier(f), g=_earlier(g))
        Q = np.cumsum(before._square_gain(self), axis=0)
        return IsotropicMoments(np.cumsum(self.p, axis=0), lost1, lost2, e, f, g, Q)

    def _vectors(self, B: IsotropicMoments) -> tuple[Floats, Floats, Floats]:
        """What B adds to e, f and g, beyond the fading of f and g."""
        lost1, lost2, keep = self.lost1[..., None], self.lost2[..., None], (1 - B.lost1)[..., None]
        return (
            B.bias - lost1 * (B.p + B.bias),
            B.f + 2 / 3 * lost2 * (keep * B.p + B.g),
            B.g - lost2 * B.g + (lost1 - lost2) * keep * B.p,
        )

    def _square_gain(self, B: IsotropicMoments) -> Floats:
        """What B adds to Q."""
        lost1, lost2 = self.lost1[..., None], self.lost2[..., None]
        f, g = self.f + 2 / 3 * lost2 * B.p, self.g + (lost1 - lost2) * B.p
        ball = _dot(self.f, B.p) + _dot(f, B.bias)
        ball += self.lost2 / 3 * (_dot(B.p, B.p) + np.trace(B.square, axis1=-2, axis2=-1))
        lever = self.g - self.bias + (lost1 - 0.5 * lost2) * B.p
        product = lever[..., :, None] * B.p[..., None, :] + g[..., :, None] * B.bias[..., None, :]
        Q = product + np.swapaxes(product, -1, -2) + (1 - lost2)[..., None] * B.square
        Q[..., *_DIAGONAL] += ball[..., None]
        return np.asarray(Q)

    def rotated(self, S: Floats, /) -> IsotropicMoments:
        """The same seen from axes in which the motion's own are S."""
        p, e, f, g = (rotate(S, x) for x in (self.p, self.bias, self.f, self.g))
        return IsotropicMoments(p, self.lost1, self.lost2, e, f, g, S @ self.square @ np.swapaxes(S, -1, -2))


_O, _NONE = np.zeros(3), np.zeros(())
_STILL = IsotropicMoments(_O, _NONE, _NONE, _O, _O, _O, np.zeros((3, 3)))  # no motion, no noise


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _earlier(x: Floats) -> Floats:
    """Values before each piece of prefixes, which are the values after it."""
    shifted = np.zeros_like(x)
    shifted[1:] = x[:-1]
    return shifted


def _lose(A: Arrays, B: Arrays) -> Arrays:
    """1 - (1 - a)(1 - b), without cancellation."""
    return [a + b - a * b for a, b in zip(A, B, strict=True)]


def _fade_and_add(A: Arrays, B: Arrays) -> Arrays:
    """Two steps of x -> (1 - lost) x + gain as one, as (lost, gain)."""
    (lost_a, gain_a), (lost_b, gain_b) = A, B
    return [lost_a + lost_b - lost_a * lost_b, gain_a - lost_b[:, None] * gain_a + gain_b]


# ε = exp(-x): power series of the closed forms below, which cancel for small x
_SLIP = [(-1) ** k / factorial(k) for k in range(2, 28)]
_BALL = [(-1) ** k * (1 - 3.0 ** (k - 2)) / factorial(k) for k in range(3, 28)]
_LINE = [(-1) ** k * (3.0**k / 3 - 2 * k - 1) / factorial(k) for k in range(3, 28)]


def _straight_integrals(x: Floats, lost1: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Shape of a straight run of attitude variance x and length L along u.

    E[e] = -slip L u and E[e eᵀ] = (ball I + line u uᵀ) L²; the cross moments consist of slip and bend = lost1²/(2x).
    """
    near, far = np.minimum(x, 0.7), np.maximum(x, 0.7)
    fade = np.exp(-far)
    slip = (far - 1 + fade) / far
    ball = (fade - fade**3 / 9 - 8 / 9 + 2 / 3 * far) / far**2
    line = 2 * ((0.5 * far - 1) * far + 1 / 3 + (far - 0.5) * fade + fade**3 / 6) / far**2
    small = x < 0.7
    return (
        np.where(small, near * polyval(near, _SLIP), slip),
        lost1**2 / (2 * np.where(x > 0, x, 1.0)),
        np.where(small, near * polyval(near, _BALL), ball),
        np.where(small, near * polyval(near, _LINE), line),
    )
