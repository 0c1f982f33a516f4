"""Theorems 1 to 3 of Knuth & Barooah, corrected: bounds for the error on any motion, and the exact error after equal,
and after repeated, steps. What was corrected is listed in the guide, under misprints.

J. Knuth, P. Barooah, "Error growth in position estimation from noisy relative pose measurements", Robotics and
Autonomous Systems, 2013.

Letters, for step k with rotation error R̃ and translation error t̃: γ or c the size of E R̃, b = E t̃, P the
covariance of t̃, ρ = E[R̃ t̃], r the true translation. In the plane R̃ is the complex number exp(jθ̃), see
`relative_pose`. Errors here are estimate minus truth; the paper's e(n) is the negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Array, Floats, as_covariance, as_plane, finite, not_negative, number, shaped, whole
from driftplan.literature.relative_pose import StepNoise, step_moments
from driftplan.model.moments import compose, identity, power, scan


@dataclass(frozen=True, slots=True, kw_only=True)
class Theorem1:
    """Bounds for the error after n steps of any motion: |E e| lies between ``bias_lower_m`` and ``bias_upper_m`` (it
    grows no faster than the true displacement, plus a constant), the trace of the covariance of e is at most
    ``variance_upper_m2`` (it grows no faster than linearly)."""

    bias_lower_m: float
    bias_upper_m: float
    variance_upper_m2: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeanNoise:
    """What Theorem 2 needs to know of the errors of a step, in 2 or 3 dimensions: means only, no second moments of R̃.

    Attributes
    ----------
    rotation_loss : (d, d), I - E R̃: the deviation from the identity is kept, so that tiny noise loses no digits
    translation_bias_m : (d,), b = E t̃, metres
    bias_loss_m : (d,), b - ρ, ρ = E[R̃ t̃], metres
    translation_var_m2 : trace of the covariance P of t̃, m²
    """

    rotation_loss: Floats
    translation_bias_m: Floats
    bias_loss_m: Floats
    translation_var_m2: float

    @classmethod
    def independent(
        cls, *, rotation_mean: ArrayLike, translation_bias_m: ArrayLike, translation_var_m2: float
    ) -> MeanNoise:
        """Rotation and translation errors of a step independent: ρ = E[R̃] b.

        >>> noise = MeanNoise.independent(
        ...     rotation_mean=0.99 * np.eye(3), translation_bias_m=(0.1, 0, 0), translation_var_m2=0.01
        ... )
        >>> noise.bias_loss_m.round(6)
        array([0.001, 0.   , 0.   ])
        """
        M = finite("rotation_mean", rotation_mean)
        if M.shape not in ((2, 2), (3, 3)):
            raise ValueError(f"expected rotation_mean of shape (2, 2) or (3, 3), got {M.shape}")
        if np.linalg.norm(M, 2) > 1 + 1e-12:
            raise ValueError(f"expected the mean of rotations, no longer than 1, got norm {np.linalg.norm(M, 2):.6g}")
        b = shaped("translation_bias_m", translation_bias_m, M.shape[:1])
        var = not_negative("translation_var_m2", translation_var_m2)
        loss = np.eye(len(M)) - M
        return cls(rotation_loss=loss, translation_bias_m=b, bias_loss_m=loss @ b, translation_var_m2=var)

    @classmethod
    def planar(cls, noise: StepNoise) -> MeanNoise:
        """The means of a planar `StepNoise`."""
        return cls(
            rotation_loss=_as_matrix(-noise.d1),
            translation_bias_m=as_plane(noise.translation_mean),
            bias_loss_m=as_plane(noise.a),
            translation_var_m2=noise.translation_var_m2,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Theorem2:
    """Error after n equal steps, in d dimensions.

    Attributes
    ----------
    bias_m : (d,), E[estimate - truth], metres, in the frame of the start
    variance_m2 : trace of the covariance, m²: ``psi_m2 * steps + omega_m2``, summed so that no digits cancel
    psi_m2, omega_m2 : ψ, the rate at which the variance grows in the long run, and ω(n), which tends to a constant, m²
    """

    bias_m: Floats
    variance_m2: float
    psi_m2: float
    omega_m2: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Theorem3:
    """Error after n steps of a motion that repeats itself.

    ``bias_m`` (2,), E[estimate - truth], metres, in the frame of the start, and ``cov_m2`` (2, 2), covariance, m².
    """

    bias_m: Floats
    cov_m2: Floats

    @property
    def variance_m2(self) -> float:
        """Trace of the covariance, m²."""
        return float(np.trace(self.cov_m2))


def theorem_1(
    steps: int,
    *,
    displacement_m: float,
    longest_step_m: float,
    coherence: float,
    translation_error_m: float,
    translation_bias_m: float = 0.0,
    rotated_bias_m: float | None = None,
    translation_var_m2: float | None = None,
) -> Theorem1:
    """Bounds on bias and variance for any motion in the plane or in space (Theorem 1), with α₀ of Lemma 1 as it is
    right. The theorem's condition (10) on the motion is not needed: see `second_moment_lower_bound`.

    Parameters
    ----------
    steps : n >= 1
    displacement_m : true distance |t| between the first and the last position
    longest_step_m : τ, an upper bound of the true translations
    coherence : γ in (0, 1], an upper bound of the spectral norm of E R̃; in the plane |E exp(jθ̃)|
    translation_error_m : β, an upper bound of E|t̃|
    translation_bias_m, rotated_bias_m : b and ρ, upper bounds of |E t̃| and |E[R̃ t̃]|; ρ defaults to b, which always
        holds for independent errors
    translation_var_m2 : upper bound of the trace of the covariance of t̃; default β²

    Raises ValueError for negative bounds, a coherence outside (0, 1].

    >>> bounds = theorem_1(1000, displacement_m=100.0, longest_step_m=0.1, coherence=0.999, translation_error_m=0.01)
    >>> round(bounds.bias_lower_m, 2), round(bounds.bias_upper_m, 2), round(bounds.variance_upper_m2, 2)
    (30.51, 169.49, 12762.45)
    """
    n = whole("steps", steps, least=1)
    tau = not_negative("longest_step_m", longest_step_m)
    gamma = number("coherence", coherence)
    if not 0 < gamma <= 1:
        raise ValueError(f"expected coherence in (0, 1], got {coherence!r}")
    beta = not_negative("translation_error_m", translation_error_m)
    b = not_negative("translation_bias_m", translation_bias_m)
    rho = b if rotated_bias_m is None else not_negative("rotated_bias_m", rotated_bias_m)
    P = beta**2 if translation_var_m2 is None else not_negative("translation_var_m2", translation_var_m2)
    displacement = not_negative("displacement_m", displacement_m)
    fading = float(n) if gamma == 1 else float(np.expm1(n * log(gamma)) / np.expm1(log(gamma)))  # Σ γᵏ for k < n
    reach = fading * (gamma * tau + beta)  # |E t̂| is at most this
    alpha = max(tau**2 + 2 * tau * b + P + b**2, (tau + rho / gamma) * (tau + b))
    return Theorem1(
        bias_lower_m=max(0.0, displacement - reach),
        bias_upper_m=displacement + reach,
        variance_upper_m2=alpha * (2 * fading - 1) * n,
    )


def second_moment_lower_bound(
    *, steps: int, coherence: float, shortest_step_m: float, translation_var_m2: float = 0.0
) -> float:
    """Least E|t̂|² of the estimated displacement t̂ after n steps of *any* motion, m²; sharper than Theorem 1.

    E|t̂|² >= (1 - c)/(1 + c) · Σ|r_k + b_k|² + Σ Tr P_k, for rotation and translation errors independent of each other
    and rotation errors symmetric about their mean (in the plane; isotropic in space). As |E t̂| stays bounded, the
    variance grows linearly with the number of steps that move, whatever the motion: condition (10) of Theorem 1 is not
    needed. Turning about at every step comes as near to the bound as one likes. What the variance grows with is the
    distance travelled, contrary to a remark in the paper: turning in place for ever adds nothing.

    Parameters
    ----------
    steps : n >= 1
    coherence : c, the lower bound of |E exp(jθ̃)| over the steps, in [0, 1]
    shortest_step_m : lower bound of |r_k + b_k|, metres
    translation_var_m2 : lower bound of Tr P_k, m²

    >>> round(second_moment_lower_bound(steps=1000, coherence=0.99, shortest_step_m=1.0), 4)
    5.0251
    """
    n, c = whole("steps", steps, least=1), number("coherence", coherence)
    if not 0 <= c <= 1:
        raise ValueError(f"expected coherence in [0, 1], got {coherence!r}")
    step = not_negative("shortest_step_m", shortest_step_m)
    return n * ((1 - c) / (1 + c) * step**2 + not_negative("translation_var_m2", translation_var_m2))


def theorem_2(
    steps: int, translation_m: ArrayLike, noise: StepNoise | MeanNoise, *, turn: float | ArrayLike = 0.0
) -> Theorem2:
    """Exact bias and variance after n equal steps: straight lines (Theorem 2), and circles and helices beyond it.

    With x = E R̃, w = r + b and v = x r + ρ::

        E t̂ = (I - x)⁻¹ (I - xⁿ) v                                     as printed
        ψ    = |w|² + Tr P + 2 wᵀ (I - x)⁻¹ v
        ω(n) = -2 wᵀ (I - x)⁻² (I - xⁿ) v - |E t̂|²                      Tr Cov = ψ n + ω(n)

    Expanded for the symmetric x of the paper: ψ = rᵀ(I-x)⁻¹(I+x)r + Tr[P+bbᵀ] + 2(b+r)ᵀ(I-x)⁻¹ρ + 2bᵀ(I-x)⁻¹r.

    For a motion that turns by R at every step x becomes R x and v becomes R v: circles and helices have a variance
    formula too. (Printed are other ψ and ω: a variance negative for few steps, three times too large after 10⁵.)

    Parameters
    ----------
    steps : n >= 1
    translation_m : (d,), r, the true translation of every step, metres, in the frame after its rotation; d is 2 or 3
    noise : StepNoise (plane), MeanNoise (plane or space)
    turn : float, or (d, d) rotation matrix
        True rotation before every translation; a number is an angle in rad, in the plane.

    Raises ValueError without rotation noise on a straight line: the variance then is n Tr P; ψ and ω do not exist.

    >>> noise = StepNoise.polar(
    ...     translation_m=(0.064, 0.0), heading_std_rad=3.6e-3 * 2**0.5, direction_std_rad=0.0307**0.5,
    ...     distance_std_m=8.5467e-5**0.5,
    ... )
    >>> found = theorem_2(100_000, (0.064, 0.0), noise)  # the straight line of Section 4.2
    >>> found.bias_m.round(2), round(found.variance_m2)
    (array([-2867.2,     0. ]), 14468028)
    """
    n = whole("steps", steps, least=1)
    means = MeanNoise.planar(noise) if isinstance(noise, StepNoise) else noise
    if not isinstance(means, MeanNoise):
        raise ValueError(f"expected a StepNoise or MeanNoise, got {type(noise).__name__}")
    d = len(means.translation_bias_m)
    r, R = shaped("translation_m", translation_m, (d,)), _rotation(turn, d)
    P, b, L = means.translation_var_m2, means.translation_bias_m, R @ means.rotation_loss
    x = R - L
    D = np.eye(d) - R + L
    w = r + b
    gain = R @ (b - means.bias_loss_m) - L @ r  # v - R r
    v = R @ r + gain
    once, twice, thrice = _chains(x, n)
    # Tr Cov = n (|w|² + Tr P) + 2 wᵀ twice v - |once v|². Nearly straight it is a small difference of large terms; with
    # once = n I - D twice and twice = C(n, 2) I - D thrice, what cancels is taken out.
    if n * np.linalg.norm(D) < 1:
        less = (R - np.eye(d)) @ (r + b) - R @ means.bias_loss_m - L @ r  # v - w
        same = 2 * w @ D @ (n * twice - thrice) @ w - _square(D @ twice @ w)
        variance = n * P + same + 2 * w @ twice @ less - 2 * (once @ w) @ (once @ less) - _square(once @ less)
    else:
        variance = n * (P + _square(w)) + 2 * w @ twice @ v - _square(once @ v)
    try:
        gained = np.linalg.solve(D, v)
        settled = np.linalg.solve(D, once @ v)
    except np.linalg.LinAlgError:
        raise ValueError(
            "expected rotation noise: Theorem 2 has no finite ψ and ω without it; the variance is then "
            "steps * translation_var_m2"
        ) from None
    return Theorem2(
        bias_m=once @ gain + _chain_of_differences(x, -L, R, n) @ (R @ r),
        variance_m2=float(variance),
        psi_m2=float(_square(w) + P + 2 * w @ gained),
        omega_m2=float(-2 * w @ settled - _square(once @ v)),
    )


def theorem_3(
    steps: int, turns_rad: ArrayLike, translations_m: ArrayLike, noise: StepNoise | Sequence[StepNoise]
) -> Theorem3:
    """Bias (Theorem 3) and covariance after n steps of a planar motion that repeats itself every p steps.

    Equation (19), with n = ηp + q and x = E exp(jθ̃)::

        E t̂ = (1 - Yᵑ)/(1 - Y) w(p) + Yᵑ w(q),   w(j) = Σ_{i<j} xⁱ U_{i+1} (x t_{i+1} + ρ_{i+1}),   Y = xᵖ U_p

    U_i being the true heading after i turns, as a unit complex number. In the paper a period ends where and as it
    began (U_p = 1); here it need not. The covariance is that of the period's element of the error-moment algebra
    raised to the power η: O(p + log η).

    Parameters
    ----------
    steps : n >= 1
    turns_rad : (p,), turns of one period, each before its translation
    translations_m : (p, 2), or (2,), translations of one period, each in the frame after its turn
    noise : StepNoise, or one per step of the period
        Rotation errors must have one mean: an assumption the paper makes without listing it.

    Raises ValueError for wrong shapes, or rotation errors of different means.

    >>> found = theorem_3(4000, [np.pi / 2] * 4, (1.0, 0.0), StepNoise.additive(heading_std_rad=0.05))
    >>> round(found.variance_m2, 4)  # a square, a thousand times round
    5.5006
    """
    n = whole("steps", steps, least=1)
    turns = finite("turns_rad", turns_rad)
    if turns.ndim != 1 or not len(turns):
        raise ValueError(f"expected turns_rad of shape (p,), p >= 1, got {turns.shape}")
    pieces = step_moments(turns, translations_m, noise)
    losses = np.ravel(pieces.d1)
    loss = complex(losses[0])
    if not np.allclose(losses, loss, rtol=1e-12, atol=1e-15):
        raise ValueError(
            "expected rotation errors of one mean E exp(jθ̃) at all steps, as Theorem 3 assumes, got several: use "
            "dead_reckoning"
        )
    p = len(turns)
    rounds, rest = divmod(n, p)
    states = scan(pieces, identity())
    before, U = states.u[:-1], states.u[-1]
    log_fade = np.arange(p) * complex(np.log1p(loss))
    true = before * pieces.p  # U_{i+1} t_{i+1}
    error = before * (np.expm1(log_fade) * pieces.p + np.exp(log_fade) * pieces.e1)  # terms of w(j), less the truth
    less = U * np.expm1(p * np.log1p(loss))
    Y = U + less
    # Σ Yᵏ w - Σ Uᵏ t, in differences; chains are of 1 x 1 matrices
    Y1, less1, U1 = (np.array([[z]]) for z in (Y, less, U))
    bias = (
        _chain_of_differences(Y1, less1, U1, rounds)[0, 0] * true.sum()
        + _chains(Y1, rounds)[0][0, 0] * error.sum()
        + U**rounds * np.expm1(rounds * p * np.log1p(loss)) * true[:rest].sum()
        + Y**rounds * error[:rest].sum()
    )
    end = compose(power(states[p], rounds), states[rest])
    return Theorem3(bias_m=as_plane(bias), cov_m2=as_covariance(end.e1, end.N, end.e2))


def _chains(x: Array, n: int) -> tuple[Array, Array, Array]:
    """Σ xᵏ, Σ (n-1-k) xᵏ and Σ C(n-1-k, 2) xᵏ over k < n: sums of equal signs, so no digits cancel for x near I."""
    d = len(x)
    chain = (np.kron(np.eye(4), np.eye(d)) + np.kron(np.eye(4, k=1), np.eye(d))).astype(x.dtype)
    chain[:d, :d] = x
    top = np.linalg.matrix_power(chain, n)[:d]
    return top[:, d : 2 * d], top[:, 2 * d : 3 * d], top[:, 3 * d :]


def _chain_of_differences(x: Array, less: Array, R: Array, n: int) -> Array:
    """Σ (xᵏ - Rᵏ) over k < n, given less = x - R, without cancellation."""
    d = len(x)
    chain = np.zeros((3 * d, 3 * d), np.result_type(x, R))
    chain[:d, :d], chain[:d, d : 2 * d] = x, less
    chain[d : 2 * d, d : 2 * d], chain[d : 2 * d, 2 * d :] = R, np.eye(d)
    chain[2 * d :, 2 * d :] = np.eye(d)
    return np.asarray(np.linalg.matrix_power(chain, n)[:d, 2 * d :])


def _rotation(turn: float | ArrayLike, d: int) -> Floats:
    if np.ndim(turn) == 0:
        angle = number("turn", turn)
        if d == 3 and angle != 0:
            raise ValueError(f"expected turn as a (3, 3) rotation matrix in space, got {turn!r}")
        return np.eye(d) if angle == 0 else _as_matrix(np.exp(1j * angle))
    R = shaped("turn", turn, (d, d))
    if not np.allclose(R @ R.T, np.eye(d), atol=1e-9) or np.linalg.det(R) < 0:
        raise ValueError(f"expected turn a rotation matrix, got {R.tolist()}")
    return R


def _as_matrix(x: complex) -> Floats:
    return np.array([[x.real, -x.imag], [x.imag, x.real]])


def _square(vector: Floats) -> float:
    return float(vector @ vector)
