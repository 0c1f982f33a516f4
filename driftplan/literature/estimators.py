"""The bias-reduced estimator of Knuth & Barooah (Section 6): its exact mean and covariance, and where it stops paying.

The estimator divides every measured rotation by its mean μ = E exp(jθ̃) and takes the bias off every measured
translation, so that E e = 0 on every path. The price: dividing by |μ| < 1 amplifies the noise of all later steps, and
the mean square error grows like |μ|⁻²ⁿ in the end.

Sharper than the paper:

* If rotation errors are symmetric about zero and translation errors unbiased, the bias-reduced estimate has the greater
  variance *and* the greater mean square error, on every path after every number of steps.
* It gains only what removing the deterministic parts gains, the mean angle of the rotations and the bias of the
  translations. Removing just these (`de_meaning`) never does worse in the mean square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftplan.arrays import Floats, as_covariance, as_plane, finite, number, plane, shaped
from driftplan.literature.relative_pose import StepNoise, checked_steps, moments_of_noise, step_moments
from driftplan.model.moments import power

_TRY_ALL = 4096  # step numbers tried one by one


@dataclass(frozen=True, slots=True, kw_only=True)
class Correction:
    """What is done to a measured step before dead reckoning: the factor of the measured rotation exp(jθ) (of a length
    other than 1 it also scales all that follows), and what is subtracted from the measured translation, metres."""

    rotation: complex = 1 + 0j
    translation_m: complex = 0j


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossovers:
    """Numbers of steps from which on, for good, an estimator is worse than plain dead reckoning, None for never: in the
    trace of the covariance, and in E|e|² (later, as long as there is a bias to remove)."""

    variance_steps: int | None
    mean_square_steps: int | None


def bias_reduction(noise: StepNoise) -> Correction:
    """The estimator of Section 6: rotations over their mean μ, translations less ρ/μ.

    For rotation and translation errors independent of each other, as in the paper, ρ/μ is the bias b that it subtracts;
    for dependent errors subtracting b would leave a bias.

    >>> bias_reduction(StepNoise.additive(heading_std_rad=0.1, translation_bias_m=(0.02, 0.0)))
    Correction(rotation=(1.005012520859401+0j), translation_m=(0.02+0j))
    """
    mean = 1 + _checked(noise).d1
    if mean == 0:
        raise ValueError("expected rotation errors with a mean E exp(jθ̃) other than zero: nothing can be divided by it")
    return Correction(rotation=1 / mean, translation_m=noise.s1 / mean)


def de_meaning(noise: StepNoise) -> Correction:
    """Only the deterministic parts removed: the mean angle of the rotation errors and the bias of the translations.

    >>> noise = StepNoise.additive(heading_std_rad=0.1, heading_mean_rad=0.3)
    >>> round(float(np.angle(de_meaning(noise).rotation)), 9)
    -0.3
    """
    mean = 1 + _checked(noise).d1
    return Correction(rotation=complex(np.exp(-1j * np.angle(mean))), translation_m=noise.translation_mean)


def corrected(noise: StepNoise, correction: Correction) -> StepNoise:
    """Errors that a correction leaves, for `dead_reckoning` and `step_moments`; rotations need not have length 1.

    >>> noise = StepNoise.additive(heading_std_rad=0.1)
    >>> corrected(noise, bias_reduction(noise)).d1
    0j
    """
    f, beta = correction.rotation, correction.translation_m
    g = f - 1
    d1 = f * noise.d1 + g
    if abs(d1) < 1e-15:  # what rounding leaves of a mean that was divided out
        d1 = 0j
    s_r_conj = noise.a + noise.s1 - beta * (1 + 2 * noise.d1.real + noise.D)  # E[s conj r] - β E|r|²
    s_r = noise.b + noise.s1 - beta * (1 + 2 * noise.d1 + noise.d2)  # E[s r] - β E r²
    s1 = f * (noise.s1 - beta * (1 + noise.d1))
    return StepNoise(
        d1=d1,
        d2=f**2 * noise.d2 + 2 * f * g * noise.d1 + g**2,
        D=abs(f) ** 2 * noise.D + 2 * (f * g.conjugate() * noise.d1).real + abs(g) ** 2,
        s1=s1,
        S=abs(f) ** 2 * (noise.S - (beta.conjugate() * (noise.a + noise.s1 + s_r_conj)).real),
        s2=f**2 * (noise.s2 - beta * (noise.b + noise.s1 + s_r)),
        a=abs(f) ** 2 * s_r_conj - s1,
        b=f**2 * s_r - s1,
    )


def estimate_positions(
    measured_turns_rad: ArrayLike, measured_translations_m: ArrayLike, correction: Correction | None = None
) -> Floats:
    """Positions by dead reckoning from corrected measurements: the estimator itself.

    Parameters
    ----------
    measured_turns_rad : array, shape (..., n)
    measured_translations_m : (..., n, 2), each in the frame after its turn, metres
    correction : default: none

    Returns positions (..., n + 1, 2) at the start and after every step, metres, in the frame of the start.

    >>> estimate_positions([0.0, np.pi / 2], [(1.0, 0.0), (1.0, 0.0)]).round(9)
    array([[0., 0.],
           [1., 0.],
           [1., 1.]])
    """
    turns = finite("measured_turns_rad", measured_turns_rad)
    t = plane("measured_translations_m", measured_translations_m)
    if turns.shape != t.shape or turns.ndim < 1:
        raise ValueError(f"expected turns (..., n) and translations (..., n, 2), got {turns.shape} and {(*t.shape, 2)}")
    correction = correction or Correction()
    moves = np.cumprod(correction.rotation * np.exp(1j * turns), axis=-1) * (t - correction.translation_m)
    return as_plane(np.concatenate([np.zeros((*t.shape[:-1], 1)), np.cumsum(moves, axis=-1)], axis=-1))


def bias_reduced_cov(turns_rad: ArrayLike, translations_m: ArrayLike, noise: StepNoise | Sequence[StepNoise]) -> Floats:
    """Covariance of the bias-reduced estimate after the last step, in closed form; its mean is the truth.

    The error is a sum of martingale differences. With w_i from the position before step i to the end, and c = |μ|, ::

        E|e|² = Σ c^(-2(i-1)) (c^-2 - 1) |w_i|² + Σ c^(-2i) Tr P_i

    for independent errors, and for any E|e|² = Σ_i Π_{l<i} E|r'_l|² · E|(r'_i - 1) w_i + U_i s'_i|²; E e² alike.

    Parameters
    ----------
    turns_rad : array, shape (n,)
    translations_m : array, shape (n, 2), or (2,) for all steps
    noise : StepNoise, or one per step: of the measurements, before the correction

    Returns a covariance (2, 2), m², in the frame of the start.

    >>> bias_reduced_cov([0.0] * 3, (1.0, 0.0), StepNoise.additive(heading_std_rad=0.1)).round(5)
    array([[0.0013 , 0.     ],
           [0.     , 0.14001]])
    """
    turns, t = checked_steps(turns_rad, translations_m)
    if isinstance(noise, StepNoise):
        left: StepNoise | list[StepNoise] = corrected(noise, bias_reduction(noise))
    else:
        left = [corrected(one, bias_reduction(one)) for one in noise]
    _, d2, D, _, S, s2, a, b = moments_of_noise(left, turns.shape)
    U = np.cumprod(np.exp(1j * turns))
    moves = U * t
    w = np.cumsum(moves[::-1])[::-1]
    grown, grown2 = (np.concatenate([[1.0], np.cumprod(1 + x[:-1])]) for x in (D, d2))
    N = np.sum(grown * (D * np.abs(w) ** 2 + S + 2 * (np.conj(w) * U * a).real))
    e2 = np.sum(grown2 * (d2 * w**2 + U**2 * s2 + 2 * w * U * b))
    return as_covariance(np.zeros((), complex), N, e2)


def crossovers(
    turn_rad: float, translation_m: ArrayLike, noise: StepNoise, correction: Correction | None = None
) -> Crossovers:
    """How many equal steps until the corrected estimate is worse than the uncorrected one, and stays worse.

    A grid of step numbers, two per cent apart, is searched up to 25/(-ln|E r|) steps, where the bias-reduced estimate
    has grown beyond any help; between the last grid point where it still pays and the next, every number is tried.
    Worse means by more than 10⁻⁹ E|e|².

    Parameters
    ----------
    turn_rad : turn before every step: 0 for a straight line
    translation_m : (2,), true translation of every step, metres, in the frame after its turn
    noise : StepNoise
    correction : default: `bias_reduction` of the noise

    >>> noise = StepNoise.additive(
    ...     heading_std_rad=0.0026**0.5, heading_mean_rad=0.0068, translation_bias_m=(0.05, 0.02),
    ...     translation_cov_m2=[[0.05, 0.0], [0.0, 0.05]],
    ... )
    >>> crossovers(0.0, (1.0, 0.0), noise)  # the noise of Section 6, straight ahead in steps of 1 m
    Crossovers(variance_steps=54, mean_square_steps=775)
    """
    turn, t = number("turn_rad", turn_rad), shaped("translation_m", translation_m, (2,))
    changed = corrected(_checked(noise), correction or bias_reduction(noise))
    raw, new = step_moments(turn, t, noise), step_moments(turn, t, changed)
    loss = -0.5 * np.log1p(2 * noise.d1.real + abs(noise.d1) ** 2)  # -ln|E r|
    if loss <= 0:
        return Crossovers(variance_steps=None, mean_square_steps=None)

    def worse(counts: NDArray[np.int64]) -> tuple[Any, Any]:
        R, C = power(raw, counts), power(new, counts)
        before, after = np.real(R.N) * (1 + 1e-9), np.real(C.N)
        return after - np.abs(C.e1) ** 2 > before - np.abs(R.e1) ** 2, after > before

    last = ceil(25 / loss)
    grid = np.unique(np.concatenate([np.arange(1, 101), np.geomspace(1, last, 2000).round()]).astype(int))
    found: list[int | None] = []
    for which in (0, 1):
        pays = np.flatnonzero(~worse(grid)[which])
        if len(pays) == 0:
            found.append(1)
        elif pays[-1] == len(grid) - 1:
            found.append(None)
        else:
            low, high = (int(n) for n in grid[pays[-1] : pays[-1] + 2])
            while high - low > _TRY_ALL:
                middle = (low + high) // 2
                low, high = (low, middle) if worse(np.array([middle]))[which][0] else (middle, high)
            between = np.arange(low, high)
            found.append(int(between[np.flatnonzero(~worse(between)[which])[-1]]) + 1)
    return Crossovers(variance_steps=found[0], mean_square_steps=found[1])


def _checked(noise: StepNoise) -> StepNoise:
    if not isinstance(noise, StepNoise):
        raise ValueError(f"expected a StepNoise, got {type(noise).__name__}")
    return noise
