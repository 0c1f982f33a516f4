"""RotationNoise: how one attitude increment in space goes wrong.

A step's attitude error is a random rotation R̃ near the identity, applied in the body frame after the true increment:
the odometry reports R R̃. All laws here are symmetric (R̃ and its inverse are equally likely), so that two moments of
the vector part v = axis · sin(angle/2) of R̃'s unit quaternion, E[v v] and E[v v v v], say all that exact first and
second moments of the drift depend on. They are sums of positive terms: nothing cancels, however small the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, finite

RotationLaw = Literal["gaussian", "brownian", "von_mises_fisher", "anisotropic_gaussian"]

_EYE = np.eye(3)
_CROSS = np.zeros((3, 3, 3))  # [v]× = _CROSS @ v
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _CROSS[_i, _j, _k], _CROSS[_j, _i, _k] = -1.0, 1.0

_PAIRED = np.zeros((3, 3, 3, 3, 3, 3))  # E[v_a² v_b²] -> E[v v v v] where odd powers vanish
for _i in range(3):
    for _j in range(3):
        for _pattern in {(_i, _i, _j, _j), (_i, _j, _i, _j), (_i, _j, _j, _i)}:
            _PAIRED[(_i, _j, *_pattern)] = 1.0

_NODES_AT_ONCE = 1_000_000  # quadrature nodes times covariances held in memory


@dataclass(frozen=True, eq=False)
class RotationNoise:
    """Law of a step's attitude error; build it with one of the named constructors.

    The parameter may carry a leading axis: then each step of a motion has its own (see `predict_drift_3d`).

    Attributes
    ----------
    law : "gaussian", "brownian", "von_mises_fisher" (isotropic) or "anisotropic_gaussian"
    parameter : (...) or (..., 3, 3), standard deviation in rad per axis, concentration, or covariance in rad²

    >>> noise = RotationNoise.isotropic(0.1)
    >>> noise.mean_offset.diagonal().round(6)  # E[R̃] - I
    array([-0.009958, -0.009958, -0.009958])
    """

    law: RotationLaw
    parameter: Floats

    def __post_init__(self) -> None:
        private = np.array(finite("parameter", self.parameter, most=np.inf))
        private.setflags(write=False)
        object.__setattr__(self, "parameter", private)

    @classmethod
    def isotropic(cls, std_rad: ArrayLike) -> RotationNoise:
        """Rotation vector normal with standard deviation ``std_rad`` (rad, >= 0) about each axis.

        >>> RotationNoise.isotropic(0.3).decay[0].round(16).item()  # 1 - E[tr R̃]/3
        0.0866948610212527
        """
        return cls("gaussian", _checked("std_rad", std_rad, "a standard deviation >= 0, in rad"))

    @classmethod
    def brownian(cls, std_rad: ArrayLike) -> RotationNoise:
        """Brownian motion on the rotations, of variance ``std_rad``² (rad², >= 0) about each axis.

        What infinitely many infinitely small independent errors add up to: the law of continuous heading noise, and
        the only isotropic one here that stays in its family when steps are merged.
        """
        return cls("brownian", _checked("std_rad", std_rad, "a standard deviation >= 0, in rad"))

    @classmethod
    def von_mises_fisher(cls, kappa: ArrayLike) -> RotationNoise:
        """Unit quaternion von Mises-Fisher on S³ about the identity with concentration ``kappa`` > 0.

        The law of J. Knuth and P. Barooah for attitude from cameras. For large kappa the angle about each axis has
        variance 4/kappa.

        >>> RotationNoise.von_mises_fisher(1e4).decay[0].round(16).item()
        0.0003999400015002
        """
        checked = _checked("kappa", kappa, "a concentration > 0", most=np.inf)  # of tiny noise it is huge
        if (checked <= 0).any():
            raise ValueError(f"expected kappa > 0, got {kappa!r}")
        return cls("von_mises_fisher", checked)

    @classmethod
    def anisotropic(cls, cov_rad2: ArrayLike) -> RotationNoise:
        """Rotation vector normal with covariance ``cov_rad2`` (rad², body frame, (..., 3, 3)).

        Variances along the principal axes may be zero (a vehicle that errs in heading only), and at most (π rad)².

        Raises ValueError for wrong shapes, values that are not finite, not symmetric or with a negative eigenvalue.
        """
        cov = checked_covariance("cov_rad2", cov_rad2)
        largest = float(np.linalg.eigvalsh(cov).max(initial=0.0))
        if largest > np.pi**2 * (1 + 1e-12):
            raise ValueError(
                f"expected principal standard deviations of cov_rad2 of at most π rad, got {largest**0.5:.6g} rad: a "
                "step with such noise loses the attitude altogether; say so with RotationNoise.brownian"
            )
        return cls("anisotropic_gaussian", cov)

    @property
    def batch(self) -> tuple[int, ...]:
        """Leading axes of the parameter."""
        return self.parameter.shape[: -2 if self.law == "anisotropic_gaussian" else None]

    @property
    def is_isotropic(self) -> bool:
        """Whether no axis is preferred."""
        return self.law != "anisotropic_gaussian"

    def of_steps(self, k: int | slice) -> RotationNoise:
        """Noise of step or steps ``k``: the same for all unless the parameter has a leading axis."""
        return RotationNoise(self.law, self.parameter[k]) if self.batch else self

    @cached_property
    def _sines(self) -> tuple[Floats, Floats]:
        """E[sin²(angle/2)] and E[sin⁴(angle/2)] of an isotropic law."""
        x = self.parameter
        if self.law == "gaussian":
            return _gaussian_sines(x * x)
        if self.law == "brownian":
            lost = -np.expm1(-x * x)
            return 0.75 * lost, 5 / 16 * lost * lost * (3 - lost)
        second, third = _bessel_ratios(x)
        return 3 * second, 15 * second * third

    @cached_property
    def decay(self) -> tuple[Floats, Floats]:
        """1 - l1 and 1 - l2 of an isotropic law, exact to rounding for the smallest noise.

        E[R̃] = l1 I; X -> E[R̃ X R̃ᵀ] multiplies symmetric traceless X by l2, antisymmetric ones by l1. Steps multiply:
        after n of them l1ⁿ and l2ⁿ remain.

        Raises ValueError for an anisotropic law, which has no such numbers.
        """
        if not self.is_isotropic:
            raise ValueError("expected an isotropic law, got anisotropic_gaussian: use mean_offset and square_offset")
        s2, s4 = self._sines
        return 4 / 3 * s2, 4 * s2 - 16 / 5 * s4

    @cached_property
    def _vector_moments(self) -> tuple[Floats, Floats]:
        """E[v v], (..., 3, 3), and E[v v v v], (..., 3, 3, 3, 3), v the vector part of the unit quaternion."""
        if not self.is_isotropic:
            return _anisotropic_vector_moments(self.parameter)
        s2, s4 = self._sines
        pairs = np.einsum("ij,kl->ijkl", _EYE, _EYE)
        pairs = pairs + pairs.transpose(0, 2, 1, 3) + pairs.transpose(0, 3, 2, 1)
        return s2[..., None, None] / 3 * _EYE, s4[..., None, None, None, None] / 15 * pairs

    @cached_property
    def mean_offset(self) -> Floats:
        """E[R̃] - I, (..., 3, 3)."""
        vv, _ = self._vector_moments
        return np.asarray(2 * (vv - np.einsum("...aa->...", vv)[..., None, None] * _EYE))

    @cached_property
    def square_offset(self) -> Floats:
        """E[(R̃ - I) ⊗ (R̃ - I)], entry ijkl that of (R̃ - I)_ij (R̃ - I)_kl, (..., 3, 3, 3, 3)."""
        vv, v4 = self._vector_moments
        v4_trace = np.einsum("...ijaa->...ij", v4)
        axes = _CROSS.reshape(9, 3)
        turn = (axes @ (vv - v4_trace) @ axes.T).reshape(v4.shape)
        left, right = v4_trace[..., None, None] * _EYE, _EYE[:, :, None, None] * v4_trace[..., None, None, :, :]
        both = np.einsum("...aa->...", v4_trace)[..., None, None, None, None] * (_EYE[:, :, None, None] * _EYE)
        return np.asarray(4 * (turn + v4 - left - right + both))

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """``size`` independent R̃ as matrices, (size, ..., 3, 3), straight from the law's definition.

        >>> RotationNoise.isotropic(0.1).sample(np.random.default_rng(0), 5).shape
        (5, 3, 3)
        """
        shape = (size, *self.batch)
        if self.law == "von_mises_fisher":
            return _matrix_from_quaternion(*_sample_von_mises_fisher(rng, self.parameter, shape))
        if self.law == "brownian":
            return _sample_brownian(rng, self.parameter, shape)
        normal = rng.standard_normal((*shape, 3))
        if self.law == "gaussian":
            vectors = self.parameter[..., None] * normal
        else:
            values, axes = np.linalg.eigh(self.parameter)
            vectors = np.einsum("...ij,...j->...i", axes, np.sqrt(np.maximum(values, 0.0)) * normal)
        half = 0.5 * np.linalg.norm(vectors, axis=-1)
        return _matrix_from_quaternion(np.cos(half), 0.5 * np.sinc(half / np.pi)[..., None] * vectors)


def _checked(name: str, value: ArrayLike, what: str, **limits: float) -> Floats:
    array = finite(name, value, what, **limits)
    if array.ndim > 1:
        raise ValueError(f"expected {name} to be {what}, or one per step, got an array of shape {array.shape}")
    if (array < 0).any():
        raise ValueError(f"expected {name} to be {what}, got {value!r}")
    return array


def checked_covariance(name: str, value: ArrayLike) -> Floats:
    """A checked covariance, (3, 3) or one per step (n, 3, 3)."""
    cov = finite(name, value, "a 3x3 covariance")
    if cov.ndim not in (2, 3) or cov.shape[-2:] != (3, 3):
        raise ValueError(f"expected {name} of shape (3, 3), or (n, 3, 3) for one per step, got {cov.shape}")
    mirrored = np.swapaxes(cov, -1, -2)
    size = np.abs(cov).max(axis=(-1, -2), keepdims=True, initial=0.0)
    if (np.abs(cov - mirrored) > 1e-9 * size).any():
        raise ValueError(f"expected {name} symmetric, got {value!r}")
    cov = np.asarray(0.5 * (cov + mirrored))
    smallest = np.linalg.eigvalsh(cov)[..., 0]
    if (smallest < -1e-9 * size[..., 0, 0]).any():
        raise ValueError(f"expected {name} without negative eigenvalues, got {smallest.min():.6g}")
    return cov


def _gaussian_sines(x: Floats) -> tuple[Floats, Floats]:
    """E[sin²(φ/2)] and E[sin⁴(φ/2)] for a rotation vector of length φ ~ N(0, x I).

    1 - E[cos kφ] = H(k²x), H(y) = 1 - (1 - y) exp(-y/2); sin⁴ needs 4 H(x) - H(4x), whose leading terms cancel, so
    below x = 0.25 the power series of H is summed term by term.
    """

    def h(y: Floats) -> Floats:
        return np.asarray(-np.expm1(-0.5 * y) + y * np.exp(-0.5 * y))

    near = np.where(x < 0.25, x, 0.0)
    fourth, term = np.zeros_like(x), np.ones_like(x)
    for k in range(1, 20):
        term = term * near / (-2 * k)
        fourth = fourth + (2 * k + 1) * (4.0**k - 4) * term
    far = 4 * h(x) - h(4 * x)
    return 0.5 * h(x), np.where(x < 0.25, fourth, far) / 8


def _bessel_ratios(kappa: Floats) -> tuple[Floats, Floats]:
    """I₂/(κ I₁) and I₃/(κ I₂) of the modified Bessel functions, with which E|v|² = 3 I₂/(κ I₁), E|v|⁴ = 15 I₃/(κ² I₁).

    Up to κ = 100 the three-term recurrence run downwards, beyond it Hankel's expansion (DLMF 10.29.1, 10.40.1): all
    terms of the former are positive, and the latter has converged before its terms begin to grow.
    """
    low = np.minimum(kappa, 100.0)
    ratio = np.zeros_like(low)
    ratios = []
    for order in range(110, 0, -1):
        ratio = 1 / (2 * (order + 1) + low * low * ratio)
        ratios.append(ratio)
    high = np.maximum(kappa, 100.0)

    def hankel(order: int) -> Floats:
        total, term = np.ones_like(high), np.ones_like(high)
        for k in range(1, 16):
            term = -term * (4 * order * order - (2 * k - 1) ** 2) / (8 * k * high)
            total = total + term
        return total

    first, second, third = (hankel(order) for order in (1, 2, 3))
    near = kappa < 100
    return np.where(near, ratios[-1], second / first / high), np.where(near, ratios[-2], third / second / high)


def _anisotropic_vector_moments(cov: Floats) -> tuple[Floats, Floats]:
    """E[v v] and E[v v v v] of v = ω/|ω| sin(|ω|/2), ω ~ N(0, cov): Gauss-Hermite quadrature in the principal axes.

    By symmetry one octant of the product grid suffices, and only even powers of each component survive.
    """
    values, axes = np.linalg.eigh(cov.reshape(-1, 3, 3))
    std = np.sqrt(np.maximum(values, 0.0))
    x, weights = _half_hermite(_nodes_for(float(std.max(initial=0.0))))
    grid = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
    weight = (weights[:, None, None] * weights[:, None] * weights).ravel()
    second = np.empty((len(std), 3))
    fourth = np.empty((len(std), 3, 3))
    at_once = max(1, _NODES_AT_ONCE // len(weight))
    for begin in range(0, len(std), at_once):
        part = slice(begin, begin + at_once)
        squares = (std[part, None, :] * grid) ** 2  # (covariances, nodes, 3)
        half = 0.5 * np.sqrt(squares.sum(axis=-1))
        squares *= (0.5 * np.sinc(half / np.pi))[..., None] ** 2
        second[part] = weight @ squares
        fourth[part] = np.swapaxes(weight[:, None] * squares, -1, -2) @ squares
    v2 = axes * second[:, None, :] @ np.swapaxes(axes, -1, -2)
    local = (fourth.reshape(-1, 9) @ _PAIRED.reshape(9, 81)).reshape(-1, 9, 9)
    both = (axes[:, :, None, :, None] * axes[:, None, :, None, :]).reshape(-1, 9, 9)
    v4 = both @ local @ np.swapaxes(both, -1, -2)
    return v2.reshape(cov.shape), v4.reshape(*cov.shape, 3, 3)


def _nodes_for(std_rad: float) -> int:
    """Gauss-Hermite nodes per axis for integrands like cos(2 · std · x) to rounding: even, so that zero is no node."""
    y = 4 * std_rad**2
    nodes = 8
    while (np.e * y / (4 * nodes)) ** nodes > 1e-22:  # n-point error y^n n!/(2n)! by Stirling, with room to spare
        nodes += 2
    return nodes


@cache
def _half_hermite(nodes: int) -> tuple[Floats, Floats]:
    """Positive nodes and doubled weights of the Gauss-Hermite rule for the standard normal law."""
    x, w = np.polynomial.hermite_e.hermegauss(nodes)
    return x[nodes // 2 :], 2 * w[nodes // 2 :] / w.sum()


def orthonormal(R: Floats) -> Floats:
    """Rotation matrices nearest to R, which must be close: one step of Newton's iteration for the polar factor."""
    return np.asarray(1.5 * R - 0.5 * R @ np.einsum("...ij,...ik->...jk", R, R))


def _matrix_from_quaternion(w: Floats, v: Floats) -> Floats:
    """Rotation matrices of unit quaternions with scalar part w, (...), and vector part v, (..., 3)."""
    cross = np.einsum("ija,...a->...ij", _CROSS, v)
    return np.asarray(_EYE + 2 * (w[..., None, None] * cross + cross @ cross))


def _sample_von_mises_fisher(rng: np.random.Generator, kappa: Floats, shape: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Scalar part w and vector part: y = 1 - w of density ∝ √(y (2 - y)) exp(-κy) by rejection, direction uniform."""
    k = np.broadcast_to(kappa, shape).ravel()
    y = np.empty(k.size)
    todo = np.arange(k.size)
    while todo.size:
        gamma = k[todo] > 1.0  # propose from the tail's Gamma law when it fits in [0, 2], else uniformly on the sphere
        flat = rng.standard_normal((todo.size, 4))
        draw = np.where(gamma, rng.gamma(1.5, 1 / k[todo]), 1 - flat[:, 0] / np.linalg.norm(flat, axis=1))
        chance = np.where(gamma, np.sqrt(np.maximum(1 - 0.5 * draw, 0.0)), np.exp(-k[todo] * draw))
        good = rng.random(todo.size) < chance
        y[todo[good]] = draw[good]
        todo = todo[~good]
    y = y.reshape(shape)
    direction = rng.standard_normal((*shape, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return 1 - y, np.sqrt(y * (2 - y))[..., None] * direction


def _sample_brownian(rng: np.random.Generator, std: Floats, shape: tuple[int, ...]) -> Floats:
    """Products of independent parts, each of so little variance that the heat kernel of the sphere S³,

    density of the half angle θ ∝ θ sin θ exp(-θ²/2t), t = variance/4, has no other visible winding.
    """
    parts = max(1, int(np.ceil(4 * np.max(std, initial=0.0) ** 2)))
    spread = np.broadcast_to(0.5 * std / np.sqrt(parts), shape).ravel()
    total = np.broadcast_to(_EYE, (*shape, 3, 3))
    for _ in range(parts):
        u = np.empty((spread.size, 3))
        todo = np.arange(spread.size)
        while todo.size:
            draw = spread[todo, None] * rng.standard_normal((todo.size, 3))
            theta = np.linalg.norm(draw, axis=1)
            good = (rng.random(todo.size) < np.sinc(theta / np.pi)) & (theta < np.pi)
            u[todo[good]] = draw[good]
            todo = todo[~good]
        theta = np.linalg.norm(u, axis=1)
        v = np.sinc(theta / np.pi)[:, None] * u
        total = total @ _matrix_from_quaternion(np.cos(theta), v).reshape(*shape, 3, 3)
    return np.asarray(total)
