r"""Error-moment algebra in space: what one step, run or flight does to the first two moments of the drift.

A motion is a pose (S, p); its estimate (G S, p + e) is wrong by a rotation G and a displacement e, both in axes
parallel to those in which the motion starts. Written as the 4x4 matrix E = [[G, e], [0, 1]], two motions, B already in
A's starting axes, compose as

    E_AB = T⁻¹ E_A T E_B,   T = translation by p_B,

and so does every representation of these matrices. The smallest that holds all second moments is the symmetric
square: E X Eᵀ for symmetric 4x4 X, ten numbers (X's upper left 3x3 block, its last column v, its corner). Its
expectation is multiplicative because steps are independent. Kept as the deviation from the identity, nothing
cancels for small noise:

    X_AB = X' + X_B + X' X_B,   X' = Sym²(T)⁻¹ X_A Sym²(T).

Exact; associative as an identity of polynomials.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyval

from driftplan.arrays import Floats
from driftplan.model.spatial.rotations import RotationNoise

Arrays = Sequence[Floats]

# Symmetric 3x3 matrices as six numbers, in an orthonormal basis so that rotations act by orthogonal matrices.
_ROW, _COLUMN = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
_WEIGHT = np.array([1, 1, 1, np.sqrt(2), np.sqrt(2), np.sqrt(2)])
_BASIS = np.zeros((6, 3, 3))
for _a in range(6):
    _BASIS[_a, _ROW[_a], _COLUMN[_a]] += 0.5 * _WEIGHT[_a]
    _BASIS[_a, _COLUMN[_a], _ROW[_a]] += 0.5 * _WEIGHT[_a]
_SYMMETRIC_PRODUCT = np.einsum("aij->iaj", 2 * _BASIS).reshape(3, 18)  # p -> (v -> p vᵀ + v pᵀ), six numbers by three
_EYE = np.eye(3)
_ROUND = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])  # the unit matrix

# power series of the closed forms of `_straight_integrals`, which cancel for small x
_SLIP = [(-1) ** k / factorial(k) for k in range(2, 28)]
_BALL = [(-1) ** k * (1 - 3.0 ** (k - 2)) / factorial(k) for k in range(3, 28)]
_LINE = [(-1) ** k * (3.0**k / 3 - 2 * k - 1) / factorial(k) for k in range(3, 28)]


class SpatialMoments(NamedTuple):
    """Moments of motions, over any leading axes."""

    p: Floats  # (..., 3) true displacement
    X: Floats  # (..., 9, 10) E[Sym²] - I without its last row, which is zero

    @classmethod
    def of_step(cls, noise: RotationNoise, bias: Floats, cov: Floats) -> SpatialMoments:
        """Noise of one step at rest: attitude error R̃, then translation error with the given mean and covariance."""
        m = noise.mean_offset
        square = noise.square_offset + np.einsum("...ij,kl->...ijkl", m, _EYE) + np.einsum("ij,...kl->...ijkl", _EYE, m)
        X = np.zeros((*m.shape[:-2], 9, 10))
        X[..., :6, :6] = np.einsum("aik,bjl,...ijkl->...ab", _BASIS, _BASIS, square, optimize=True)
        X[..., 6:, 6:9] = m
        jitter = np.zeros((*np.broadcast_shapes(bias.shape[:-1], cov.shape[:-2]), 9, 10))
        jitter[..., :6, 6:9] = _symmetric_product(bias)
        jitter[..., :6, 9] = _as_six(cov + bias[..., :, None] * bias[..., None, :])
        jitter[..., 6:, 9] = bias
        return cls(np.zeros(3), X).append(cls(np.zeros(3), jitter))

    @classmethod
    def of_straight_runs(cls, z: Floats, rotation_rate: Floats, along: Floats, across: Floats) -> SpatialMoments:
        """Runs with continuous noise: Brownian attitude error, white translation error.

        The attitude error prefers no direction: with l1 = exp(-x) and l2 = exp(-3x), x its variance about each axis,
        E[G] = l1 I and E[G Y Gᵀ] = l2 Y for symmetric Y without trace; E[e (G v)ᵀ] + its transpose is (f·v) I + g vᵀ +
        v gᵀ with f and g along the run.

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
        area = length * length
        skewed = (along - across) * length * np.where(x > 0, lost2 / np.where(x > 0, 3 * x, 1.0), 1.0)
        round_part = area * ball + length * (across + (along - across) / 3) - skewed / 3
        uu = u[..., :, None] * u[..., None, :]
        square = round_part[..., None, None] * _EYE + (area * line + skewed)[..., None, None] * uu
        X = np.zeros((*length.shape, 9, 10))
        X[..., :6, :6] = -lost2[..., None, None] * (np.eye(6) - np.outer(_ROUND, _ROUND) / 3)
        X[..., :6, 6:9] = _ROUND[:, None] * (f[..., None] * u)[..., None, :] + _symmetric_product(g[..., None] * u)
        X[..., :6, 9] = _as_six(square)
        X[..., 6:, 6:9] = -lost1[..., None, None] * _EYE
        X[..., 6:, 9] = -z * slip[..., None]
        return cls(z, X)

    @property
    def bias(self) -> Floats:
        """E[e], (..., 3)."""
        return self.X[..., 6:, 9]

    @property
    def square(self) -> Floats:
        """E[e eᵀ], (..., 3, 3)."""
        return np.asarray(np.einsum("...a,aij->...ij", self.X[..., :6, 9], _BASIS))

    def append(self, B: SpatialMoments, /) -> SpatialMoments:
        """This motion, then B, in the same axes."""
        A = self.moved(B.p)
        X = A.X[..., :9] @ B.X
        X += A.X
        X += B.X
        return SpatialMoments(A.p, X)

    def moved(self, z: Floats, /) -> SpatialMoments:
        """This motion, then a translation by z that errs only through the attitude: Sym²(T)⁻¹ X Sym²(T)."""
        product = _symmetric_product(z)
        column = z[..., None]
        old = self.X
        X = np.array(np.broadcast_to(old, (*np.broadcast_shapes(old.shape[:-2], z.shape[:-1]), 9, 10)))
        X[..., 9:] += old[..., 6:9] @ column
        X[..., :6, 6:] += old[..., :6, :6] @ np.concatenate([product, product @ (0.5 * column)], axis=-1)
        X[..., :6, 6:] -= product @ X[..., 6:, 6:]
        return SpatialMoments(self.p + z, X)

    def rotated(self, S: Floats, /) -> SpatialMoments:
        """The same seen from axes in which the motion's own are S."""
        P = np.zeros((*S.shape[:-2], 9, 9))
        P[..., :6, :6] = _six_by_six(S)
        P[..., 6:, 6:] = S
        X = P @ self.X
        X[..., :9] = X[..., :9] @ np.swapaxes(P, -1, -2)
        return SpatialMoments(rotate(S, self.p), X)

    def prefixes(self) -> SpatialMoments:
        """Moments of the first, the first two, ... of these motions (n,), in the same axes: an associative scan."""
        return SpatialMoments(*scan(lambda A, B: SpatialMoments(*A).append(SpatialMoments(*B)), self))

    def spread(self, count: int) -> SpatialMoments:
        """The same ``count`` times: one leading axis on each array that has none yet."""
        p, X = self
        return SpatialMoments(np.broadcast_to(p, (count, 3)), np.broadcast_to(X, (count, 9, 10)))

    def part(self, index: int | slice) -> SpatialMoments:
        """By the leading axis."""
        return SpatialMoments(self.p[index], self.X[index])


def scan(operation: Callable[[Arrays, Arrays], Arrays], pieces: Arrays) -> Arrays:
    """All prefixes of an associative operation along the first axis, in about 2n vectorised operations.

    Pairs first, then the same for the half as many pairs: rounding grows with the logarithm of n, and numpy is called
    a few times per halving, not per piece.
    """
    count = len(pieces[0])
    if count == 1:
        return pieces
    whole = count - count % 2
    odd = scan(operation, operation([x[0:whole:2] for x in pieces], [x[1:whole:2] for x in pieces]))
    prefixes = [np.empty(x.shape) for x in pieces]
    for result, x, at_odd in zip(prefixes, pieces, odd, strict=True):
        result[0], result[1::2] = x[0], at_odd
    if count > 2:
        even = operation([x[: (count - 1) // 2] for x in odd], [x[2::2] for x in pieces])
        for result, at_even in zip(prefixes, even, strict=True):
            result[2::2] = at_even
    return prefixes


def _symmetric_product(p: Floats) -> Floats:
    """The map v -> p vᵀ + v pᵀ, (..., 6, 3)."""
    return np.asarray(p @ _SYMMETRIC_PRODUCT).reshape(*p.shape[:-1], 6, 3)


def _as_six(Y: Floats) -> Floats:
    return np.asarray(Y[..., _ROW, _COLUMN] * _WEIGHT)


def _six_by_six(R: Floats) -> Floats:
    """The map Y -> R Y Rᵀ of symmetric matrices."""
    first, second = R[..., :, _ROW], R[..., :, _COLUMN]  # column a of the map: first_a second_aᵀ, made symmetric
    mixed = first[..., _ROW, :] * second[..., _COLUMN, :] + first[..., _COLUMN, :] * second[..., _ROW, :]
    return np.asarray(0.5 * _WEIGHT[:, None] * _WEIGHT * mixed)


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


def rotate(S: Floats, v: Floats) -> Floats:
    """S v, over any leading axes."""
    return np.asarray((S @ v[..., None])[..., 0])
