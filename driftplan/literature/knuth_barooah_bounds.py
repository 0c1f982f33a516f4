"""Theorem 1 of Knuth & Barooah, corrected: bounds for how the error of integrated relative poses grows, on any motion.

Source and letters as in `knuth_barooah`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np

from driftplan.arrays import not_negative, number, whole


@dataclass(frozen=True, slots=True, kw_only=True)
class Theorem1:
    """Bounds for the error after n steps of any motion.

    Attributes
    ----------
    bias_lower_m, bias_upper_m : |E e| lies between them, metres. It grows no faster than the true displacement, plus a
        constant.
    variance_upper_m2 : the trace of the covariance of e is at most this, m²: it grows no faster than linearly
    """

    bias_lower_m: float
    bias_upper_m: float
    variance_upper_m2: float


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
    """Bounds on bias and variance for any motion in the plane or in space (Theorem 1).

    Corrected: α₀ in the proof of Lemma 1 is (τ + ρ/γ)(τ + b), printed τ² + τb + τρ; in (29) the product runs from i+1
    to j. The theorem's condition (10) on the motion is not needed: see `second_moment_lower_bound`.

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

    Raises
    ------
    ValueError : for negative bounds, a coherence outside (0, 1]

    Examples
    --------
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
    fading = _geometric(log(gamma), n)
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
    steps : int
    coherence : c, the lower bound of |E exp(jθ̃)| over the steps, in [0, 1]
    shortest_step_m : lower bound of |r_k + b_k|, metres
    translation_var_m2 : lower bound of Tr P_k, m²

    Examples
    --------
    >>> round(second_moment_lower_bound(steps=1000, coherence=0.99, shortest_step_m=1.0), 4)
    5.0251
    """
    n, c = whole("steps", steps, least=1), number("coherence", coherence)
    if not 0 <= c <= 1:
        raise ValueError(f"expected coherence in [0, 1], got {coherence!r}")
    step = not_negative("shortest_step_m", shortest_step_m)
    return n * ((1 - c) / (1 + c) * step**2 + not_negative("translation_var_m2", translation_var_m2))


def _geometric(log_x: float, n: int) -> float:
    """Σ xᵏ for k < n, exact for x near and at 1."""
    return float(n) if log_x == 0 else float(np.expm1(n * log_x) / np.expm1(log_x))
