"""Dead reckoning from relative-pose measurements with errors of any law: the setting of Knuth & Barooah.

A step rotates by a true angle, then translates by a true vector t, in the frame after the rotation. Measured are
both, with a rotation error r = exp(jθ̃) and a translation error τ that may depend on each other within a step; steps
are independent. Of their law the first two moments of (δ, s), δ = r - 1 and s = rτ, are all that the moments of the
estimated position depend on, and `StepNoise` holds these.

Plane as complex numbers, j to the left. Errors are estimate minus truth (Knuth & Barooah write truth minus estimate).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Array, as_covariance, choice, covariance, finite, not_negative, number, plane, shaped
from driftplan.model.elements import step_element, step_errors
from driftplan.model.heading_laws import law_moments
from driftplan.model.moments import Moments, identity, scan
from driftplan.model.noise import HeadingLaw
from driftplan.model.point_drift import PointDrift


@dataclass(frozen=True, slots=True, kw_only=True)
class StepNoise:
    """Moments of the errors of one relative-pose measurement; made by `additive` and `polar`.

    Attributes
    ----------
    d1, d2, D : complex, complex, float: E[δ], E[δ²], E[|δ|²] of δ = r - 1 (no unit)
    s1, S, s2 : complex, float, complex: E[s] (m), E[|s|²] (m²), E[s²] (m²) of s = rτ. E[s] is ρ in Knuth & Barooah.
    a, b : E[s conj(δ)], E[s δ] (m)
    """

    d1: complex
    d2: complex
    D: float
    s1: complex = 0j
    S: float = 0.0
    s2: complex = 0j
    a: complex = 0j
    b: complex = 0j

    @classmethod
    def additive(
        cls,
        *,
        heading_std_rad: float,
        heading_mean_rad: float = 0.0,
        heading_law: HeadingLaw = "gaussian",
        translation_bias_m: ArrayLike = (0.0, 0.0),
        translation_cov_m2: ArrayLike = ((0.0, 0.0), (0.0, 0.0)),
        gain_m_per_rad: ArrayLike = (0.0, 0.0),
    ) -> StepNoise:
        """Translation error τ = bias + gain·(θ̃ - mean) + independent rest, in the frame of the translation.

        Parameters
        ----------
        heading_std_rad, heading_mean_rad : deviation and mean of the rotation error θ̃
        heading_law : {"gaussian", "laplace", "von_mises", "uniform"}
            Its law (for "von_mises" the concentration is 1/std², and no gain is allowed).
        translation_bias_m : (2,)
        translation_cov_m2 : (2, 2), covariance of the rest
        gain_m_per_rad : (2,), what one radian of rotation error adds to τ: errors of one step that have a common cause

        >>> StepNoise.additive(heading_std_rad=0.1, translation_bias_m=(0.02, 0.0)).translation_mean
        (0.02+0j)
        """
        var = not_negative("heading_std_rad", heading_std_rad) ** 2
        mean = number("heading_mean_rad", heading_mean_rad)
        bias = complex(*shaped("translation_bias_m", translation_bias_m, (2,)))
        gain = complex(*shaped("gain_m_per_rad", gain_m_per_rad, (2,)))
        P = covariance("translation_cov_m2", translation_cov_m2)
        choice("heading_law", heading_law, HeadingLaw)
        if heading_law == "von_mises" and gain != 0:
            raise ValueError("gain_m_per_rad is not available for heading_law='von_mises': use 'gaussian', got both")
        skew = complex(P[0, 0] - P[1, 1], 2 * P[0, 1])
        given = (np.asarray(x) for x in (var, mean, bias, np.trace(P), skew, gain))
        d1, d2, D, s1, S, s2, a, b = (complex(x) for x in step_errors(heading_law, *given))
        return cls(d1=d1, d2=d2, D=D.real, s1=s1, S=S.real, s2=s2, a=a, b=b)

    @classmethod
    def polar(
        cls,
        *,
        translation_m: ArrayLike,
        heading_std_rad: float,
        direction_std_rad: float,
        distance_std_m: float,
        heading_mean_rad: float = 0.0,
        heading_law: HeadingLaw = "laplace",
        direction_law: HeadingLaw = "laplace",
    ) -> StepNoise:
        """The simulations of Knuth & Barooah: rotation, direction of the translation and its length err on their own.

        The measured translation is (|t| + d̃) exp(jφ̃) t/|t|, so that its error has the mean -(1 - E cos φ̃) t: a bias.

        Parameters
        ----------
        translation_m : (2,), the true translation t, in the frame after the rotation
        heading_std_rad, heading_mean_rad, heading_law : of the rotation error
        direction_std_rad, direction_law : of φ̃, zero mean
        distance_std_m : of d̃, zero mean, any law

        >>> noise = StepNoise.polar(
        ...     translation_m=(0.064, 0.0), heading_std_rad=0.005, direction_std_rad=0.175, distance_std_m=0.009
        ... )
        >>> round(noise.translation_mean.real, 6)
        -0.000965
        """
        t = complex(*shaped("translation_m", translation_m, (2,)))
        if t == 0:
            raise ValueError("expected translation_m other than zero: its direction is what errs, got (0, 0)")
        var = not_negative("distance_std_m", distance_std_m) ** 2
        direction_var = not_negative("direction_std_rad", direction_std_rad) ** 2
        choice("direction_law", direction_law, HeadingLaw)
        along = law_moments(direction_law, np.asarray(direction_var))
        loss, twice = float(along.d1), float(along.d2)  # E(exp(jφ̃) - 1), E(exp(jφ̃) - 1)²
        square = t**2 * twice + var * (t / abs(t)) ** 2 * (1 + 2 * loss + twice)  # E τ²
        bias = np.asarray(t * loss)
        return cls.additive(
            heading_std_rad=heading_std_rad,
            heading_mean_rad=heading_mean_rad,
            heading_law=heading_law,
            translation_bias_m=(bias.real, bias.imag),
            translation_cov_m2=as_covariance(bias, np.asarray(-2 * abs(t) ** 2 * loss + var), np.asarray(square)),
        )

    @property
    def coherence(self) -> float:
        """|E r|, in [0, 1]: 1 without rotation noise. Called c, γ in Knuth & Barooah."""
        return abs(1 + self.d1)

    @property
    def translation_mean(self) -> complex:
        """E τ, metres (for true rotations r, |r| = 1)."""
        return self.a + self.s1

    @property
    def translation_var_m2(self) -> float:
        """Trace of the covariance of τ, m² (for true rotations r, |r| = 1)."""
        return self.S - abs(self.translation_mean) ** 2


def step_moments(turns_rad: ArrayLike, translations_m: ArrayLike, noise: StepNoise | Sequence[StepNoise]) -> Moments:
    """Elements of the error-moment algebra for steps with errors of any law, shape (...).

    Parameters
    ----------
    turns_rad : (...), true rotation of each step, rad
    translations_m : (..., 2), true translation, metres, in the frame after the rotation
    noise : StepNoise, or one per step: a sequence goes with the last axis

    >>> from driftplan.model.moments import power
    >>> step = step_moments(0.0, (1.0, 0.0), StepNoise.additive(heading_std_rad=0.01))
    >>> power(step, 100).N.round(4).item()  # a straight run of 100 m; to first order 0.01² · Σk² = 33.835
    33.7713
    """
    turns, t = finite("turns_rad", turns_rad), plane("translations_m", translations_m)
    if np.broadcast_shapes(turns.shape, t.shape) != turns.shape:
        raise ValueError(f"expected one translation per turn, {(*turns.shape, 2)} in all, got {(*t.shape, 2)}")
    u = np.exp(1j * turns)
    return step_element(u, u, np.broadcast_to(t, turns.shape), *moments_of_noise(noise, turns.shape))


def dead_reckoning(
    turns_rad: ArrayLike, translations_m: ArrayLike, noise: StepNoise | Sequence[StepNoise]
) -> PointDrift:
    """Error of the position estimate after every step, exact to second order, in O(n).

    Parameters
    ----------
    turns_rad : array, shape (n,)
    translations_m : array, shape (n, 2), or (2,) for all steps
    noise : StepNoise, or one per step

    Returns the drift (n + 1,) at the start and after every step.

    >>> found = dead_reckoning([0.0, 0.0], (1.0, 0.0), StepNoise.additive(heading_std_rad=0.1))
    >>> found.rms.round(4)
    array([0.    , 0.0999, 0.2231])
    """
    turns, t = checked_steps(turns_rad, translations_m)
    states = scan(step_moments(turns, translations_m, noise), identity())
    driven = np.cumsum(np.broadcast_to(np.abs(t), turns.shape))
    return PointDrift(np.concatenate([[0.0], driven]), states)


def checked_steps(turns_rad: ArrayLike, translations_m: ArrayLike) -> tuple[Array, Array]:
    """Turns (n,) and translations, as complex numbers (n,) or, one for all steps, ()."""
    turns, t = finite("turns_rad", turns_rad), plane("translations_m", translations_m)
    if turns.ndim != 1 or not len(turns):
        raise ValueError(f"expected turns_rad of shape (n,), n >= 1, got {turns.shape}")
    if t.shape not in ((), turns.shape):
        raise ValueError(f"expected translations_m of shape (2,) or ({len(turns)}, 2), got {(*t.shape, 2)}")
    return turns, t


def moments_of_noise(noise: StepNoise | Sequence[StepNoise], shape: tuple[int, ...]) -> tuple[Array, ...]:
    """The moments of the noise in the order of `StepNoise`, each as an array of the steps' shape."""
    names = [f.name for f in fields(StepNoise)]
    if isinstance(noise, StepNoise):
        return tuple(np.full(shape, getattr(noise, name)) for name in names)
    if not (isinstance(noise, Sequence) and noise and all(isinstance(n, StepNoise) for n in noise)):
        raise ValueError(f"expected a StepNoise or one per step, got {type(noise).__name__}")
    if shape[-1:] != (len(noise),):
        raise ValueError(f"expected one StepNoise per step, {shape[-1:]} in all, got {len(noise)}")
    return tuple(np.broadcast_to([getattr(n, name) for n in noise], shape) for name in names)
