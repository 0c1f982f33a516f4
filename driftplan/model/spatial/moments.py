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

Exact; associative as an identity of polynomials. The blocks of X that are not zero are kept apart: E[G] - I and
E[G Y Gᵀ] - Y (which leaves traces alone), the cross moments of e and G, E[e] and E[e eᵀ]. Where the noise prefers no
direction the first two are multiples of the identity, and are kept as one number each: the same formulas then cost a
fraction. Motions stand along the last axis of every array, so that numpy works on long rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import factorial
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyval

from driftplan.arrays import Floats
from driftplan.model.spatial.rotations import RotationNoise

Arrays = Sequence[Floats]

# Symmetric 3x3 matrices as six numbers in an orthonormal basis, in which rotations act by orthogonal matrices: the
# trace first, then two numbers of the diagonal and three beside it.
_ROW, _COLUMN = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
_WEIGHT = np.array([1, 1, 1, np.sqrt(2), np.sqrt(2), np.sqrt(2)])
_DIAGONAL = np.array([[2, 2, 2], [6**0.5, -(6**0.5), 0], [2**0.5, 2**0.5, -(8**0.5)]]) / 12**0.5
_BASIS = np.zeros((6, 3, 3))
_BASIS[:3, [0, 1, 2], [0, 1, 2]] = _DIAGONAL
_BASIS[[3, 4, 5], _ROW[3:], _COLUMN[3:]] = _BASIS[[3, 4, 5], _COLUMN[3:], _ROW[3:]] = 0.5**0.5

# power series of the closed forms of `_straight_integrals`, which cancel for small x
_SLIP = [(-1) ** k / factorial(k) for k in range(2, 28)]
_BALL = [(-1) ** k * (1 - 3.0 ** (k - 2)) / factorial(k) for k in range(3, 28)]
_LINE = [(-1) ** k * (3.0**k / 3 - 2 * k - 1) / factorial(k) for k in range(3, 28)]


class SpatialMoments(NamedTuple):
    """Moments of m motions; arrays of one motion fit any number."""

    p: Floats  # (3, m) true displacement
    M: Floats  # (3, 3, m) E[G] - I, or (1, 1, m) where it is a multiple of the identity
    W: Floats  # (5, 5, m) Y -> E[G Y Gᵀ] - Y of symmetric Y without trace, or (1, 1, m) likewise
    C: Floats  # (6, 3, m) v -> E[e (G v)ᵀ] + its transpose
    e: Floats  # (3, m) E[e]
    Q: Floats  # (6, m) E[e eᵀ]

    @classmethod
    def of_step(cls, noise: RotationNoise, bias: Floats, cov: Floats) -> SpatialMoments:
        """Noise of one step at rest: attitude error R̃, then translation error with the given mean and covariance;
        all with one leading axis or none."""
        if noise.is_isotropic:
            M, W = (-np.reshape(lost, (1, 1, -1)) for lost in noise.decay)
        else:
            m, square, eye = noise.mean_offset, noise.square_offset, np.eye(3)
            square = square + np.einsum("...ij,kl->...ijkl", m, eye) + np.einsum("ij,...kl->...ijkl", eye, m)
            W = np.einsum("aik,bjl,...ijkl->ab...", _BASIS[1:], _BASIS[1:], square, optimize=True).reshape(5, 5, -1)
            M = _last(m, 2)
        e, Q = _last(bias, 1), _as_six(_last(cov + bias[..., :, None] * bias[..., None, :], 2))
        C, none = _symmetric_product(e), np.zeros(M.shape[-1])  # as often as M is there
        return cls(np.zeros((3, 1)), M, W, _plus(C + none, W, C), e + _act(M, e), _plus(Q + none, W, Q))

    @classmethod
    def of_straight_runs(cls, z: Floats, rotation_rate: Floats, along: Floats, across: Floats) -> SpatialMoments:
        """Runs with continuous noise: Brownian attitude error, white translation error.

        The attitude error prefers no direction: with l1 = exp(-x) and l2 = exp(-3x), x its variance about each axis,
        E[G] = l1 I and E[G Y Gᵀ] = l2 Y for symmetric Y without trace; E[e (G v)ᵀ] + its transpose is (f·v) I + g vᵀ +
        v gᵀ with f and g along the run.

        Parameters
        ----------
        z : (3, m), displacements, metres
        rotation_rate : (m,), variance of the attitude error about each axis per metre, rad²/m
        along, across : (m,), variance of the position per metre, m²/m, in the estimated direction of flight and in
            each across it
        """
        length = np.linalg.norm(z, axis=0)
        u = z / np.where(length > 0, length, 1.0)
        x = rotation_rate * length
        lost1, lost2 = -np.expm1(-x), -np.expm1(-3 * x)
        slip, bend, ball, line = _straight_integrals(x, lost1)
        f = length * bend * (2 - 2 / 3 * lost1)
        g = -length * (1 - lost1) * (slip + bend)
        area = length * length
        skewed = (along - across) * length * np.where(x > 0, lost2 / np.where(x > 0, 3 * x, 1.0), 1.0)
        C, Q = _symmetric_product(g * u), (area * line + skewed) * _square(u)
        C[0] += np.sqrt(3) * f * u
        Q[0] += np.sqrt(3) * (area * ball + length * (across + (along - across) / 3) - skewed / 3)
        return cls(z, -lost1[None, None], -lost2[None, None], C, -z * slip, Q)

    @property
    def square(self) -> Floats:
        """E[e eᵀ], (m, 3, 3)."""
        return np.asarray(self.Q.T @ _BASIS.reshape(6, 9)).reshape(-1, 3, 3)

    def append(self, B: SpatialMoments, /) -> SpatialMoments:
        """These motions, then B, in the same axes."""
        A = self.moved(B.p)
        M, W = _both(A[1:3], B[1:3])
        C = _plus(A.C + B.C + _act_right(A.C, B.M), A.W, B.C)
        Q = _plus(A.Q + B.Q + times(A.C, B.e), A.W, B.Q)
        return SpatialMoments(A.p, M, W, C, A.e + B.e + _act(A.M, B.e), Q)

    def moved(self, z: Floats, /) -> SpatialMoments:
        """These motions, then a translation by z (3, m) that errs only through the attitude: Sym²(T)⁻¹ X Sym²(T)."""
        e = self.e + _act(self.M, z)
        Q = _plus(self.Q + times(self.C, z) - _product(z, e), self.W, _square(z))
        return SpatialMoments(self.p + z, self.M, self.W, self.C + _swung(self.M, self.W, z), e, Q)

    def rotated(self, S: Floats, /) -> SpatialMoments:
        """The same seen from axes in which the motions' own are S (3, 3, m)."""
        P = _six_by_six(S)
        M, W = self.M, self.W
        if len(M) > 1:
            M = times(times(S, M), S.swapaxes(0, 1))
            W = times(times(P[1:, 1:], W), P[1:, 1:].swapaxes(0, 1))
        C = times(times(P, self.C), S.swapaxes(0, 1))
        return SpatialMoments(times(S, self.p), M, W, C, times(S, self.e), times(P, self.Q))

    def prefixes(self) -> SpatialMoments:
        """Moments of the first, the first two, ... of these motions, in the same axes: recurrences, block by block."""
        B = self.spread(max(x.shape[-1] for x in self))
        M, W = scan(_both, B[1:3])
        M_A, W_A = _before(M), _before(W)
        swung = _swung(M_A, W_A, B.p)
        _, C = scan(_fade_and_add, [B.M, _plus(swung + B.C + _act_right(swung, B.M), W_A, B.C)])
        gain = _act(M_A, B.p)
        e = np.cumsum(gain + B.e + _act(M_A, B.e), axis=-1)
        Q = B.Q + times(_before(C), B.p + B.e) + times(swung, B.e) - _product(B.p, _before(e) + gain)
        Q = np.cumsum(_plus(Q, W_A, B.Q + _square(B.p)), axis=-1)
        return SpatialMoments(np.cumsum(B.p, axis=-1), M, W, C, e, Q)

    def spread(self, count: int) -> SpatialMoments:
        """The same ``count`` times, where there is one."""
        return SpatialMoments(*(np.broadcast_to(x, (*x.shape[:-1], count)) for x in self))

    def part(self, index: Any) -> SpatialMoments:
        """Some of the motions."""
        return SpatialMoments(*(x[..., index] for x in self))


def scan(operation: Callable[[Arrays, Arrays], Arrays], pieces: Arrays) -> Arrays:
    """All prefixes of an associative operation along the last axis, in about 2n vectorised operations.

    Pairs first, then the same for the half as many pairs: rounding grows with the logarithm of n, and numpy is called
    a few times per halving, not per piece.
    """
    count = pieces[0].shape[-1]
    if count == 1:
        return pieces
    whole = count - count % 2
    odd = scan(operation, operation([x[..., 0:whole:2] for x in pieces], [x[..., 1:whole:2] for x in pieces]))
    prefixes = [np.empty(x.shape) for x in pieces]
    for result, x, at_odd in zip(prefixes, pieces, odd, strict=True):
        result[..., 0], result[..., 1::2] = x[..., 0], at_odd
    if count > 2:
        even = operation([x[..., : (count - 1) // 2] for x in odd], [x[..., 2::2] for x in pieces])
        for result, at_even in zip(prefixes, even, strict=True):
            result[..., 2::2] = at_even
    return prefixes


def _both(A: Arrays, B: Arrays) -> Arrays:
    """Offsets from the identity of two linear maps after another, of each kind."""
    return [a + b + _act(a, b) for a, b in zip(A, B, strict=True)]


def _fade_and_add(A: Arrays, B: Arrays) -> Arrays:
    """Two steps of C -> C (I + M) + gain as one."""
    (M, gain), (M_B, gain_B) = A, B
    return [M + M_B + _act(M, M_B), gain + gain_B + _act_right(gain, M_B)]


def _before(x: Floats) -> Floats:
    """Values before each motion of prefixes, which are the values after it."""
    shifted = np.empty(x.shape)
    shifted[..., 0], shifted[..., 1:] = 0.0, x[..., :-1]
    return shifted


def times(A: Floats, B: Floats) -> Floats:
    """Products of matrices (i, j, m) with matrices (j, k, m) or vectors (j, m)."""
    if A.shape[-1] == B.shape[-1] == 1:
        return np.asarray(A[..., 0] @ B[..., 0])[..., None]
    return np.asarray(np.einsum("ij...,j...->i..." if B.ndim == 2 else "ij...,jk...->ik...", A, B))


def _act(A: Floats, B: Floats) -> Floats:
    """A on the left of B, where (1, 1, m) is a multiple of the identity."""
    return A[0] * B if len(A) == 1 else times(A, B)


def _act_right(A: Floats, B: Floats) -> Floats:
    """B on the right of A (i, j, m), likewise."""
    return A * B if len(B) == 1 else times(A, B)


def _plus(x: Floats, W: Floats, y: Floats) -> Floats:
    """x + W y in the place of x, of six numbers of which W leaves out the first."""
    x[1:] += _act(W, y[1:])
    return x


def _swung(M: Floats, W: Floats, z: Floats) -> Floats:
    """What a translation by z after attitude errors adds to their cross moments."""
    arm = _symmetric_product(z)
    return _plus(-_act_right(arm, M), W, arm)


def _symmetric_product(z: Floats) -> Floats:
    """The map v -> z vᵀ + v zᵀ, (6, 3, m)."""
    return np.asarray(2 * (_BASIS.reshape(18, 3) @ z)).reshape(6, 3, -1)


def _product(v: Floats, w: Floats) -> Floats:
    """v wᵀ + w vᵀ, (6, m)."""
    return 2 * _as_six(v[:, None] * w)


def _square(z: Floats) -> Floats:
    """z zᵀ, (6, m)."""
    return _as_six(z[:, None] * z)


def _as_six(Y: Floats) -> Floats:
    """The symmetric part of matrices (3, 3, m)."""
    return np.asarray(_BASIS.reshape(6, 9) @ Y.reshape(9, -1))


def _six_by_six(S: Floats) -> Floats:
    """The map Y -> S Y Sᵀ of symmetric matrices, (6, 6, m)."""
    first, second = S[:, _ROW], S[:, _COLUMN]  # column a of the map: first_a second_aᵀ, made symmetric
    P = first[_ROW] * second[_COLUMN] + first[_COLUMN] * second[_ROW]
    P *= (0.5 * _WEIGHT[:, None] * _WEIGHT)[..., None]
    P[:, :3] = _DIAGONAL @ P[:, :3]
    P[:3] = (_DIAGONAL @ P[:3].reshape(3, -1)).reshape(3, 6, -1)
    return np.asarray(P)


def _last(x: Floats, axes: int) -> Floats:
    """An array whose last ``axes`` stand first, with one axis, of length one perhaps, after them."""
    return np.ascontiguousarray(np.moveaxis(x.reshape(-1, *x.shape[x.ndim - axes :]), 0, -1))


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
