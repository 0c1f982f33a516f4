"""The odometry step of a car-like vehicle, exact, with the cross-covariance that its authors left open.

J. M. Mirats Tur, J. L. Gordillo, C. Albores, "A closed-form expression for the uncertainty in odometry position
estimate of an autonomous vehicle", IEEE Transactions on Robotics, 2005, and its erratum. Convention of the erratum: a
step first turns, then moves, ::

    Δθ = Δd tan(φ)/L        Δx = Δd cos(θ + Δθ)        Δy = Δd sin(θ + Δθ)

from the measured distance Δd and steering angle φ, with independent Gaussian errors ε_d, ε_φ; L is the wheelbase. The
distance error enters the turn and the move, so that rotation and translation errors of a step depend on each other.

The erratum adds up Cov(P_t) = Cov(P_{t-1}) + Cov(ΔP_t) and leaves the covariance of P_{t-1} and ΔP_t out: on a
straight line it makes the variance grow with the cube of the number of steps instead of its square. Here it comes with
the result (`AckermannDrift.cross_cov`), so that the recursion closes exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Array, Floats, as_covariance, as_plane, finite, not_negative, positive
from driftplan.model.elements import step_element
from driftplan.model.moments import Moments, identity, scan

_NODES = 16  # Gauss-Hermite, over the steering error; to rounding, as long as
_RESERVE = 8.0  # so many deviations of it stay short of 90°


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AckermannDrift:
    """Odometry error of a car after every step, exact to second order; world frame, x along the first heading.

    Attributes
    ----------
    xy : (n + 1, 2), true positions, metres, from the origin
    bias : (n + 1, 2), E[estimate - truth], metres
    cov : (n + 1, 2, 2), Cov(P_t), m²
    increment_cov : (n, 2, 2), Cov(ΔP_t), m², of a step's measured displacement: all headings' errors before are in it
    cross_cov : (n, 2, 2), Cov(P_{t-1}, ΔP_t), m²:
        ``cov[t] = cov[t-1] + increment_cov[t-1] + cross_cov[t-1] + cross_cov[t-1]ᵀ``
    """

    xy: Floats
    bias: Floats
    cov: Floats
    increment_cov: Floats
    cross_cov: Floats

    @property
    def rms(self) -> Floats:
        """sqrt(E|e|²), metres, (n + 1,)."""
        return np.asarray(np.sqrt((self.bias**2).sum(-1) + self.cov[..., 0, 0] + self.cov[..., 1, 1]))


def ackermann_step(
    distances_m: ArrayLike,
    steering_rad: ArrayLike,
    *,
    wheelbase_m: float,
    distance_std_m: float,
    steering_std_rad: float,
) -> Moments:
    """Elements of the error-moment algebra for Ackermann steps, shape (...), without linearisation.

    Given ε_φ, with g = tan(φ + ε_φ)/L and v = σ_d², the rotation error is Gaussian and ::

        E r^k = exp(j k Δd (g - g₀) - k² g² v/2)      E[r^k τ] = j k g v E r^k      E[r² τ²] = (v - 4 g² v²) E r²

    which Gauss-Hermite quadrature averages over ε_φ, g - g₀ = sec² φ tan ε_φ / (L (1 - tan φ tan ε_φ)).

    Parameters
    ----------
    distances_m, steering_rad : (...), true distance of each step, metres, and steering angle, rad, positive to the left
    wheelbase_m : float
    distance_std_m, steering_std_rad : deviations of each step's ε_d and ε_φ

    Raises ValueError for values that are not finite, negative deviations, or steering that with its noise reaches ±90°.

    >>> step = ackermann_step(0.5, 0.2, wheelbase_m=2.5, distance_std_m=0.02, steering_std_rad=0.02)
    >>> float(step.N) > 0.02**2  # the steering error adds to the distance error
    True
    """
    d, phi = finite("distances_m", distances_m), finite("steering_rad", steering_rad)
    if d.shape != phi.shape:
        raise ValueError(f"expected distances_m and steering_rad of one shape, got {d.shape} and {phi.shape}")
    L = positive("wheelbase_m", wheelbase_m)
    v = not_negative("distance_std_m", distance_std_m) ** 2
    std = not_negative("steering_std_rad", steering_std_rad)
    x, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    weights = weights / weights.sum()
    widest = float(np.abs(phi).max(initial=0.0) + _RESERVE * std)
    if widest >= np.pi / 2:
        raise ValueError(
            f"expected steering within ±90° whatever its error, got up to {np.degrees(widest):.3g}° at {_RESERVE:g} "
            "deviations: lower steering_rad or steering_std_rad"
        )
    t0 = np.tan(phi)[..., None]
    te = np.tan(std * x)
    change = te * (1 + t0**2) / (1 - t0 * te) / L  # g - g₀
    g = t0 / L + change

    def mean(f: Array) -> Array:
        return np.asarray(f @ weights)

    turned1, turned2 = (np.expm1(1j * k * change * d[..., None] - 0.5 * k * k * g**2 * v) for k in (1, 2))  # E r^k - 1
    d1, d2 = mean(turned1), mean(turned2 - 2 * turned1)
    r_tau, r2_tau = mean(1j * g * v * (1 + turned1)), mean(2j * g * v * (1 + turned2))  # E τ = 0
    s2 = mean((v - 4 * g**2 * v**2) * (1 + turned2))
    a, b = -r_tau, r2_tau - r_tau  # E[s conj δ], E[s δ] for s = rτ, |r| = 1
    u = np.exp(1j * d * t0[..., 0] / L)
    return step_element(u, u, d, d1, d2, -2 * d1.real, r_tau, np.full(d.shape, v), s2, a, b)


def ackermann_drift(
    distances_m: ArrayLike,
    steering_rad: ArrayLike,
    *,
    wheelbase_m: float,
    distance_std_m: float,
    steering_std_rad: float,
) -> AckermannDrift:
    """Odometry error of a car along a drive, with all that the recursion of the erratum needs.

    Parameters
    ----------
    distances_m, steering_rad : (n,), these, the rest and the errors as in `ackermann_step`

    >>> found = ackermann_drift(
    ...     [0.5] * 100, [0.2] * 100, wheelbase_m=2.5, distance_std_m=0.02, steering_std_rad=0.02
    ... )
    >>> found.bias[-1].round(5), found.rms[-1].round(5).item()
    (array([ 0.00522, -0.03061]), 0.8229)
    """
    d = finite("distances_m", distances_m)
    if d.ndim != 1 or not len(d):
        raise ValueError(f"expected distances_m of shape (n,), n >= 1, got {d.shape}")
    steps = ackermann_step(
        d, steering_rad, wheelbase_m=wheelbase_m, distance_std_m=distance_std_m, steering_std_rad=steering_std_rad
    )
    states = scan(steps, identity())
    return AckermannDrift(
        xy=as_plane(states.p),
        bias=as_plane(states.e1),
        cov=as_covariance(states.e1, states.N, states.e2),
        increment_cov=_increment_cov(states[:-1], steps),
        cross_cov=_cross_cov(states[:-1], steps),
    )


def _increment_cov(before: Moments, step: Moments) -> Floats:
    """Covariance of the step's measured displacement u(1 + δ)q, q = p + e of the step, in the frame of the start."""
    q1 = step.p + step.e1
    q2 = step.p**2 + 2 * step.p * step.e1 + step.e2
    # E|q|² - |E(1 + δ)|² |E q|², in differences: the squared displacement itself cancels out
    lost = 2 * np.real(before.d1) + np.abs(before.d1) ** 2
    spread = np.real(step.N) - np.abs(step.e1) ** 2 - lost * np.abs(q1) ** 2
    skew = before.u**2 * ((1 + before.d1) ** 2 * (step.e2 - step.e1**2) + (before.d2 - before.d1**2) * q2)
    return as_covariance(np.zeros(spread.shape), spread, skew)


def _cross_cov(before: Moments, step: Moments) -> Floats:
    """Cov(P_{t-1}, ΔP_t) = Cov(X, Y), from Cov(X, conj Y) = conj(u)(a - E e conj d1) conj(E q) and its pseudo-part."""
    q1 = step.p + step.e1
    hermitian = np.conj(before.u) * (before.a - before.e1 * np.conj(before.d1)) * np.conj(q1)
    pseudo = before.u * (before.b - before.e1 * before.d1) * q1
    total, difference = (hermitian + pseudo) / 2, (pseudo - hermitian) / 2
    return np.stack([as_plane(total), np.stack([difference.imag, -difference.real], axis=-1)], axis=-1)
