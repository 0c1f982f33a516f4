"""The moments of one turn and of one run under an `OdometryNoise`: the elements that `moments.compose` joins.

A run of any length, straight or of constant curvature, and a turn on the spot are ONE element each.

* Continuous model: the moments of a stretch obey a linear differential equation in the distance s. With the noise-free
  rotation U = exp(jκs), heading variance rate q, heading bias rate β, μ = jβ - q/2, distance and lateral variance rates
  q_d and q_l, scale error ε, covariance rate c of heading and distance error, γ = ε + jc/2 and m2 = 1 + 2 d1 + d2::

      d1' = μ(1 + d1)              d2' = (2jβ - 2q) m2 - 2μ(1 + d1)      D' = -2 Re[μ(1 + d1)]
      e1' = U(d1 + γ(1 + d1))      N' = 2 Re[conj(U)(a + conj(γ)(e1 + a))] + q_d + q_l
      e2' = 2U(b + γ(e1 + b)) + (q_d - q_l) U² m2
      a'  = U(D + γ(conj(d1) + D)) + conj(μ)(e1 + a) - jcU
      b'  = U(d2 + γ(d1 + d2)) + μ(e1 + b) + jcU m2

  It is solved by a Taylor series on a short piece, which is then composed with itself: exact to rounding from 1e-12 to
  10 rad, where the closed form in exponentials loses every digit to cancellation. A turn on the spot is the same
  equation in the angle, without the terms of driving.
* Step model: the element of one step, from the characteristic function of its heading error, raised to a power.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, reduce
from math import factorial

import numpy as np

from driftplan.arrays import Array
from driftplan.model.heading_laws import law_moments, shifted
from driftplan.model.moments import Moments, compose, doubled, power
from driftplan.model.noise import HeadingLaw, OdometryNoise, steps_in

_ORDER = 12  # of the Taylor series
_BLOCK = 8192  # pieces solved at once
_PIECE_RAD = 0.125  # greatest rotation or heading variance on one piece: its truncation error is below 1e-17


def run_moments(length_m: Array, curvature_per_m: Array, noise: OdometryNoise) -> Moments:
    """Moments of runs of ``length_m`` >= 0 metres at constant ``curvature_per_m`` (1/m, left positive), broadcast.

    >>> noise = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-3)
    >>> run_moments(np.array(100.0), np.array(0.0), noise).N.round(6).item()  # E|e|² in m²
    33.370917
    """
    length, curvature = np.broadcast_arrays(np.asarray(length_m, dtype=float), np.asarray(curvature_per_m, dtype=float))
    if noise.step_m is None:
        return _stretch(length, curvature, noise, speed=1.0)
    steps = steps_in(length, noise.step_m)
    step_m = length / np.maximum(steps, 1)
    return power(_step(curvature * step_m, step_m, noise, speed=1.0), steps)


def turn_moments(turn_rad: Array, noise: OdometryNoise) -> Moments:
    """Moments of turns on the spot by ``turn_rad`` (rad, positive to the left), shape (...)."""
    turn = np.asarray(turn_rad, dtype=float)
    zero = np.zeros(turn.shape)
    if noise.distance_var_per_rad > 0 and noise.step_m is not None:
        return _step(turn, zero, noise, speed=0.0)
    if noise.distance_var_per_rad > 0 and noise.heading_distance_corr != 0:
        return _stretch(np.abs(turn), np.sign(turn), noise, speed=0.0)
    heading_var, distance_var = noise.heading_var_per_rad * np.abs(turn), noise.distance_var_per_rad * np.abs(turn)
    mean = noise.heading_bias_per_rad * turn
    law = law_moments(noise.heading_law, heading_var)
    d1, d2 = shifted(law.d1, law.d2, mean)
    e2 = zero
    if noise.distance_var_per_rad > 0:  # it points wherever the robot faces while it turns
        e2 = distance_var * _phi(2j * (turn + mean) - 2 * heading_var)
    return Moments(np.exp(1j * turn), zero, d1, d2, -2 * d1.real, zero, distance_var, e2, zero, zero)


def of_legs(turns: Array, lengths: Array, curvatures: Array, which: Array, noises: Sequence[OdometryNoise]) -> Moments:
    """Moments of legs (...), each a turn on the spot (rad) and then a run (metres, 1/m), with the noise of its own,
    ``which`` of the ``noises``; all broadcast against each other.

    >>> calm, wild = OdometryNoise(distance_var_per_m=1e-4), OdometryNoise(distance_var_per_m=1e-2)
    >>> of_legs(np.zeros(2), np.ones(2), np.zeros(2), np.array([0, 1]), [calm, wild]).N.round(6).tolist()
    [0.0001, 0.01]
    """
    if len(noises) == 1:
        return _legs(turns, lengths, curvatures, noises[0])
    turns, lengths, curvatures, which = np.broadcast_arrays(turns, lengths, curvatures, which)
    order = np.argsort(which, axis=None, kind="stable")
    ends = np.cumsum(np.bincount(which.ravel(), minlength=len(noises)))
    parts = [
        _legs(turns.ravel()[some], lengths.ravel()[some], curvatures.ravel()[some], noise)
        for some, noise in zip(np.split(order, ends[:-1]), noises, strict=True)
    ]
    inverse = np.empty(len(order), dtype=np.intp)
    inverse[order] = np.arange(len(order))
    return Moments.concatenate(parts)[inverse.reshape(which.shape)]


def _legs(turns: Array, lengths: Array, curvatures: Array, noise: OdometryNoise) -> Moments:
    runs = run_moments(lengths, curvatures, noise)
    if not np.any(turns):
        return runs
    return compose(turn_moments(turns, noise), runs) if noise.turns_matter else runs.rotated(np.exp(1j * turns))


def _stretch(length: Array, curvature: Array, noise: OdometryNoise, *, speed: float) -> Moments:
    """The module's differential equation, driven at ``speed`` 1; or 0: turns on the spot, whose lengths are angles."""
    if length.size > _BLOCK:  # a dense log: the dozens of Taylor coefficients of each piece must fit the cache
        cuts = range(_BLOCK, length.size, _BLOCK)
        blocks = zip(*(np.array_split(x.reshape(-1), cuts) for x in (length, curvature)), strict=True)
        parts = [_stretch(some, bends, noise, speed=speed) for some, bends in blocks]
        return Moments(*(x.reshape(length.shape) for x in Moments.concatenate(parts).arrays()))
    bent = np.abs(curvature)
    heading_rate = speed * noise.heading_var_per_m + noise.heading_var_per_rad * bent
    distance_rate = speed * noise.distance_var_per_m + noise.distance_var_per_rad * bent
    lateral_rate = speed * noise.lateral_var_per_m
    bias_rate = speed * noise.heading_bias_per_m + noise.heading_bias_per_rad * curvature
    fastest = np.maximum(np.maximum(bent, heading_rate), np.abs(bias_rate))
    with np.errstate(divide="ignore"):
        halvings = np.maximum(0, np.ceil(np.log2(fastest * length / _PIECE_RAD))).astype(int)
    h = length / 2.0**halvings
    covariance = noise.heading_distance_corr * np.sqrt(heading_rate * distance_rate)
    turning, biased, correlated = bool(bent.any()), bias_rate.any(), covariance.any()
    along, across = distance_rate + lateral_rate, distance_rate - lateral_rate
    if speed == 1.0 and not (turning or biased or correlated or noise.distance_scale_error):
        piece = _straight(h, heading_rate, along, across)
    else:
        mu: Array = -heading_rate / 2 + (1j * bias_rate if biased else 0.0)
        gamma: Array = np.asarray(speed * noise.distance_scale_error + (0.5j * covariance if correlated else 0.0))
        bend = np.asarray(1j * curvature * h) if turning else np.zeros(())
        series = _taylor(h, bend, speed, mu, gamma, along, across)
        sums = (reduce(np.add, reversed(terms)) for terms in series)  # the smallest first
        piece = Moments(np.exp(bend), speed * h * _phi(bend) if turning else speed * h, *sums)
    whole = doubled(piece, halvings)
    if not turning:
        return replace(whole, u=np.ones(length.shape), p=speed * length)
    bend = np.asarray(1j * curvature * length)
    return replace(whole, u=np.exp(bend), p=speed * length * _phi(bend))


def _straight(h: Array, heading_rate: Array, along: Array, across: Array) -> Moments:
    """A straight, unbiased piece: its series run in x = heading_rate·h alone, so their coefficients are numbers."""
    x = heading_rate * h
    d1 = np.expm1(-x / 2)
    e1, N, e2, a, b = (_horner(coefficients, x) for coefficients in _straight_coefficients())
    hx = h * x
    spread = h * (1 + _horner(_PHI_COEFFICIENTS, -2 * x))  # ∫ E[r²] ds
    d2, N, e2 = np.expm1(-2 * x) - 2 * d1, h * hx * N + along * h, h * hx * e2 + across * spread
    return Moments(np.ones(np.shape(h)), h, d1, d2, -2 * d1, hx * e1, N, e2, hx * a, hx * b)


_PHI_COEFFICIENTS = (0.0, *(1 / factorial(k + 1) for k in range(1, _ORDER)))  # of (exp(z) - 1)/z - 1


@cache
def _straight_coefficients() -> tuple[tuple[float, ...], ...]:
    """Coefficients in x of e1/(h x), N/(h² x), e2/(h² x), a/(h x), b/(h x) for a straight run, no distance noise."""
    one, none = np.ones(()), np.zeros(())
    series = _taylor(one, none, 1.0, -one / 2, none, none, none)
    first = (2, 3, 3, 2, 2)  # the order in s at which each begins
    return tuple(tuple(float(c) for c in x[k:]) for k, x in zip(first, series[3:], strict=True))


def _taylor(
    h: Array, bend: Array, speed: float, mu: Array, gamma: Array, along: Array, across: Array
) -> tuple[list[Array], ...]:
    """Taylor coefficients in s/h of d1, d2, D, e1, N, e2, a, b: the differential equation, order by order."""
    turning = bool(bend.any())
    double_mu = 2 * (mu + mu.real)
    cross = 2j * gamma.imag if np.iscomplexobj(gamma) else 0.0
    U = [bend**k / factorial(k) for k in range(_ORDER + 1)]
    UU = [(2 * bend) ** k / factorial(k) for k in range(_ORDER + 1)]
    conj_U = [np.conj(c) for c in U]

    def times(series: list[Array], x: list[Array], k: int) -> Array:
        """Coefficient k of the product of two series; a straight run's rotation is the series 1."""
        if not turning:
            return x[k]
        return np.asarray(sum(series[k - i] * x[i] for i in range(k + 1)))

    zero = np.zeros(np.shape(h))
    d1, d2, D, e1, N, e2, a, b = ([zero] for _ in range(8))
    m2, in_e1, in_N, in_e2, in_a, in_b = ([] for _ in range(6))  # what U multiplies in e1', N', e2', a', b'
    for k in range(_ORDER):
        one = 1.0 if k == 0 else 0.0
        r = one + d1[k]
        m2.append(one + 2 * d1[k] + d2[k])
        in_e1.append(speed * d1[k] + gamma * r)
        in_N.append(speed * a[k] + np.conj(gamma) * (e1[k] + a[k]))
        in_e2.append(speed * b[k] + gamma * (e1[k] + b[k]))
        in_a.append(speed * D[k] + gamma * (np.conj(d1[k]) + D[k]) - cross * one)
        in_b.append(speed * d2[k] + gamma * (d1[k] + d2[k]) + cross * m2[k])
        step = h / (k + 1)
        d1.append(step * mu * r)
        d2.append(step * (double_mu * m2[k] - 2 * mu * r))
        D.append(step * -2 * (mu * r).real)
        e1.append(step * times(U, in_e1, k))
        N.append(step * (2 * times(conj_U, in_N, k).real + one * along))
        e2.append(step * (2 * times(U, in_e2, k) + across * times(UU, m2, k)))
        a.append(step * (times(U, in_a, k) + np.conj(mu) * (e1[k] + a[k])))
        b.append(step * (times(U, in_b, k) + mu * (e1[k] + b[k])))
    return d1, d2, D, e1, N, e2, a, b


def _step(turn: Array, length: Array, noise: OdometryNoise, *, speed: float) -> Moments:
    """One step, of a run at ``speed`` 1, or a turn on the spot at 0."""
    angle = np.abs(turn)
    heading_var, distance_var, lateral_var = (
        speed * per_step + per_m * length + per_rad * angle
        for per_step, per_m, per_rad in (
            (noise.heading_var_per_step, noise.heading_var_per_m, noise.heading_var_per_rad),
            (noise.distance_var_per_step, noise.distance_var_per_m, noise.distance_var_per_rad),
            (noise.lateral_var_per_step, noise.lateral_var_per_m, 0.0),
        )
    )
    heading_mean = noise.heading_bias_per_m * length + noise.heading_bias_per_rad * turn
    share = noise.heading_distance_corr
    slope = share * np.sqrt(distance_var / np.maximum(heading_var, 1e-300)) if share else np.zeros(())
    rest_var = distance_var - slope**2 * heading_var
    mean, square, skew = noise.distance_scale_error * length, rest_var + lateral_var, rest_var - lateral_var
    errors = step_errors(noise.heading_law, heading_var, heading_mean, mean, square, skew, slope)
    turning = turn.any()
    u = np.exp(1j * turn) if turning else np.ones(turn.shape)
    p = length * _phi(1j * turn) if turning and speed else length
    reach = np.abs(p)
    along = np.where(reach > 0, p / np.where(reach > 0, reach, 1.0), u)  # on the spot: where the turn leaves it facing
    return step_element(u, along, reach, *errors)


def step_errors(
    law: HeadingLaw, heading_var: Array, heading_mean: Array, mean: Array, square: Array, skew: Array, slope: Array
) -> tuple[Array, ...]:
    """E δ, E δ², E|δ|², E s, E|s|², E s², E[s conj δ] and E[s δ] of a step that draws its heading error, r = exp(jθ) =
    1 + δ, first, and turns its translation error τ by it: s = rτ.

    θ has a ``heading_mean`` and the variance and law of what it is about that, τ is ``mean`` + ``slope`` (θ - E θ) and
    an independent rest of mean 0 with E|rest|² = ``square`` and E rest² = ``skew``, complex, x along the step.
    """
    of_law = law_moments(law, heading_var)
    d1, d2 = shifted(of_law.d1, of_law.d2, heading_mean)
    s1, s2 = mean * (1 + d1), (1 + 2 * d1 + d2) * (mean**2 + skew)
    a, b = -mean * d1, mean * (d1 + d2)
    if np.any(slope):
        w = np.exp(1j * heading_mean)
        theta_r, theta_r2, theta2_r2 = 1j * of_law.theta_r * w, 1j * of_law.theta_r2 * w * w, of_law.theta2_r2 * w * w
        s1, s2 = s1 + slope * theta_r, s2 + 2 * mean * slope * theta_r2 + slope**2 * theta2_r2
        a, b = a - slope * theta_r, b + slope * (theta_r2 - theta_r)
    return d1, d2, -2 * d1.real, s1, np.abs(mean) ** 2 + np.abs(slope) ** 2 * heading_var + square, s2, a, b


def step_element(
    u: Array, v: Array, t: Array, d1: Array, d2: Array, D: Array, s1: Array, S: Array, s2: Array, a: Array, b: Array
) -> Moments:
    """Element of a step that turns by ``u``, moves by ``t`` along ``v`` and errs by v(δt + s) as of `step_errors`."""
    e1, e2 = v * (t * d1 + s1), v * v * (t * t * d2 + 2 * t * b + s2)
    N = np.abs(t) ** 2 * D + S + 2 * np.real(np.conj(t) * a)
    return Moments(u, v * t, d1, d2, D, e1, N, e2, v * (t * D + a), v * (t * d2 + b))


def _phi(z: Array) -> Array:
    """(exp(z) - 1)/z, exact near zero."""
    tiny = np.abs(z) < 1e-100  # where dividing would overflow on the way
    safe = np.where(tiny, 1.0, z)
    return np.asarray(np.where(tiny, 1.0, np.expm1(safe) / safe))


def _horner(coefficients: tuple[float, ...], x: Array) -> Array:
    """Σ coefficients[k] x^k."""
    total = np.full(np.shape(x), coefficients[-1])
    for c in coefficients[-2::-1]:
        total *= x
        total += c
    return total
