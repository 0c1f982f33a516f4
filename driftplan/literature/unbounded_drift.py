r"""Propositions 1 and 2 of the unbounded-drift paper with its Tables I and II, corrected, in O(n) instead of O(n²).
What was corrected is listed in the guide, under misprints.

Model: step i turns by θ_i and drives d_i. The odometry reports both with independent Gaussian errors, of deviation δ_θ
for the turn (drawn before the step moves) and δ_d for the distance. Letters as in the paper: T_i is the heading after i
turns, η_i the sum of their errors, and ::

    h_i = E cos η_i = exp(-i δ_θ²/2)       g_i = E cos 2η_i = exp(-2 i δ_θ²)       k = exp(-(p - i) δ_θ²/2)
    α = E (cos η_i - 1)(cos η_p - 1)       β = E sin η_i sin η_p                    for i <= p

Writing a_i = 1 - h_i and b_i = h_i - g_i, both small and free of cancellation, the kernels separate, ::

    α + β = a_i (1 + k)        α - β = a_i - k b_i

so that every double sum of the paper becomes a running sum whose past fades by exp(-δ_θ²/2) per step.

Frame: the paper measures headings from its y axis, so that its y is the cosine coordinate and its x the sine
coordinate. The tables keep the paper's coordinates; everything else is in driftplan's frame (x forward at heading 0,
y to the left), in which the paper's (x, y) is (y, x).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Array, Complexes, Floats, as_covariance, as_plane, finite, not_negative


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """The entries of Table I (or II: A1 … F1) in m², paper coordinates, over any leading axes.

    ``A + B + C`` is the second moment of the error in the paper's x (sine) and ``D + E + F`` in its y (cosine): A and D
    come from single steps, B and E from pairs of steps, C and F from the distance errors.
    """

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    E: Floats
    F: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposition1:
    """Mean and covariance of the odometry error e = estimate - truth of a known path, over any leading axes (...).

    Attributes
    ----------
    bias : (..., 2), E[e], metres
    cov : (..., 2, 2), covariance of e, m², with the x-y entry that the paper leaves out
    table : table I, corrected
    """

    bias: Floats
    cov: Floats
    table: Table

    @property
    def rms(self) -> Floats:
        """sqrt(E|e|²), metres, (...)."""
        return np.asarray(np.sqrt((self.bias**2).sum(-1) + self.cov[..., 0, 0] + self.cov[..., 1, 1]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposition2:
    """What is known of the odometry error when only the measurements are, over any leading axes (...).

    Attributes
    ----------
    bias : (..., 2), E[e | measurements], metres: e is the error of fresh measurements of the unknown true path
    total_cov : (..., 2, 2), covariance of e given the measurements, m². This is what the sums of Table II give.
    average_true_cov : (..., 2, 2), covariance of e for a known path, averaged over the true paths, m². This is what
        equation (6) announces; it is smaller by the spread of the bias over the true paths.
    measured_path_bias : (..., 2), E[measured end - true end | measurements], metres: the posterior mean of the error
        that *has been* made. Not the same as ``bias``; at first order it has the opposite sign.
    table : table II, corrected
    """

    bias: Floats
    total_cov: Floats
    average_true_cov: Floats
    measured_path_bias: Floats
    table: Table


def proposition_1(
    distances_m: ArrayLike, turns_rad: ArrayLike, *, heading_std_rad: float, distance_std_m: float
) -> Proposition1:
    """Bias and covariance of the odometry error at the end of a known path (Proposition 1, Table I).

    Parameters
    ----------
    distances_m, turns_rad : (..., n), true distance (metres) of each step and the turn before it (rad, left positive)
    heading_std_rad, distance_std_m : δ_θ and δ_d: deviations of each turn's and each distance's error

    Raises ValueError for arrays of different or empty shape, values that are not finite, negative deviations.

    >>> found = proposition_1([1.0, 1.2, 0.8], [0.3, -0.2, 0.5], heading_std_rad=0.1, distance_std_m=0.1)
    >>> found.cov.diagonal().round(6)
    array([0.038969, 0.119953])
    """
    path = _Path(distances_m, turns_rad, heading_std_rad, distance_std_m, measured=False)
    mean, N, e2 = _error_moments(path)
    return Proposition1(bias=as_plane(mean), cov=as_covariance(mean, N, e2), table=_table(path))


def proposition_2(
    distances_m: ArrayLike, turns_rad: ArrayLike, *, heading_std_rad: float, distance_std_m: float
) -> Proposition2:
    """Bias and covariance of the odometry error when only measurements are known (Proposition 2, Table II).

    The true path is taken to be the measured one minus errors of the same law (flat prior), and the odometry error e is
    that of fresh measurements of it. After D. Lerro and Y. Bar-Shalom, IEEE Trans. Aerospace and Electronic Systems
    29(3), 1993, pp. 1015-1022, doi:10.1109/7.220948, whose average true moments are the case of one step.

    The sums of the table, less the squared mean, are the *total* covariance, not the average true one of equation (6).

    Parameters
    ----------
    distances_m, turns_rad : (..., n), measured distance (metres) of each step and the measured turn before it (rad)
    heading_std_rad, distance_std_m : δ_θ and δ_d

    >>> found = proposition_2([1.0, 1.2, 0.8], [0.3, -0.2, 0.5], heading_std_rad=0.1, distance_std_m=0.1)
    >>> found.total_cov.diagonal().round(6), found.average_true_cov.diagonal().round(6)
    (array([0.040357, 0.118745]), array([0.040352, 0.118732]))
    """
    path = _Path(distances_m, turns_rad, heading_std_rad, distance_std_m, measured=True)
    mean, N, e2 = _error_moments(path)
    # μ = E[e | true path] is linear in the true steps: its own second moments
    z, a, c = path.z, path.a, path.c
    mu_N = (path.square * a**2).sum(-1) + 2 * _pairs(np.conj(z * a), z * a, c).real
    mu_e2 = (path.square2 * a**2).sum(-1) + 2 * _pairs(z * path.open2 * a, z * a, c)
    return Proposition2(
        bias=as_plane(mean),
        total_cov=as_covariance(mean, N, e2),
        average_true_cov=as_covariance(np.zeros_like(mean), N - mu_N, e2 - mu_e2),
        measured_path_bias=as_plane((z * a).sum(-1)),
        table=_table(path),
    )


class _Path:
    """A path and its noise in the letters of the module's docstring, arrays of shape (..., n) or (n,).

    The truth is the path itself or, if that is measured, differs from it by errors of the same law: its heading after i
    turns by one of E cos ``open1``, its distances by one of variance ``open_var``.
    """

    def __init__(
        self, distances_m: ArrayLike, turns_rad: ArrayLike, heading_std: float, distance_std: float, *, measured: bool
    ) -> None:
        d, turns = finite("distances_m", distances_m), finite("turns_rad", turns_rad)
        if d.shape != turns.shape or d.ndim < 1 or d.shape[-1] < 1:
            raise ValueError(
                f"expected distances_m and turns_rad of one shape (..., n), n >= 1, got {d.shape} and {turns.shape}"
            )
        var = not_negative("heading_std_rad", heading_std) ** 2
        self.d, self.u = d, np.exp(1j * np.cumsum(turns, axis=-1))  # the latter is exp(j T_i)
        self.z = self.d * self.u
        self.distance_var = not_negative("distance_std_m", distance_std) ** 2
        i = np.arange(1, d.shape[-1] + 1)
        self.c, h, self.g = exp(-0.5 * var), np.exp(-0.5 * i * var), np.exp(-2 * i * var)  # c = exp(-δ_θ²/2)
        self.a, self.b = -np.expm1(-0.5 * i * var), -h * np.expm1(-1.5 * i * var)
        self.open1: Floats = h if measured else np.ones(i.shape)
        self.open2: Floats = self.g if measured else np.ones(i.shape)  # E cos of twice that error
        self.open_var, self.fade = (self.distance_var, self.c) if measured else (0.0, 1.0)  # fade: of open1 per step
        self.square = d**2 + self.open_var  # E of the true distance squared
        self.square2 = self.u**2 * self.square * self.open2  # E of the true step squared, as a complex number


def _error_moments(path: _Path) -> tuple[Complexes, Floats, Complexes]:
    """E e, E|e|² and E e² at the end of the path."""
    z, a, b, open2, late = path.z, path.a, path.b, path.open2, path.fade * path.c
    weighted = np.conj(z * a)
    N = 2 * (path.square * a).sum(-1) + 2 * (_pairs(weighted, z, path.fade) + _pairs(weighted, z, late)).real
    e2 = (path.square2 * (a - b)).sum(-1) + 2 * (_pairs(z * open2 * a, z, path.fade) - _pairs(z * open2 * b, z, late))
    of_distances = path.distance_var * path.d.shape[-1], path.distance_var * (path.u**2 * path.g * open2).sum(-1)
    return -(z * path.open1 * a).sum(-1), N + of_distances[0], e2 + of_distances[1]


def _table(path: _Path) -> Table:
    """Table I or, of a measured path, Table II: sin², cos² and sin·cos averaged over what the headings leave open."""
    d, a, b, g, c = path.d, path.a, path.b, path.g, path.c
    forward, left = path.u.real, path.u.imag  # cos T, sin T: the paper's y and x
    half = 0.5 * (1 - path.open2)
    mean_left2 = half + path.open2 * left**2  # E sin² T̄: the paper's S
    mean_forward2 = half + path.open2 * forward**2  # E cos² T̄: the paper's K
    mixed = path.open2 * left * forward  # E sin T̄ cos T̄

    def entries(own: Floats, other: Floats, own2: Floats, other2: Floats) -> tuple[Floats, Floats, Floats]:
        single = (path.square * (own2 * (a + 0.5 * (a - b)) + other2 * 0.5 * (a + b))).sum(-1)
        pairs: Floats = np.zeros(single.shape)
        # k α and k β, split by their power of k; the later heading is written out about the earlier one
        for fade, alpha, beta in ((path.fade, a, 0.0), (path.fade * c, 0.5 * (a - b), 0.5 * (a + b))):
            from_own = own2 * own * alpha + mixed * other * (alpha - beta) + other2 * own * beta
            from_other = own2 * other * alpha - mixed * own * (alpha - beta) + other2 * other * beta
            pairs = pairs + 2 * (_pairs(d * from_own, d * own, fade) + _pairs(d * from_other, d * other, fade))
        return single, pairs, path.distance_var * (0.5 * (1 + g) * own2 + 0.5 * (a + b) * other2).sum(-1)

    A, B, C = entries(left, forward, mean_left2, mean_forward2)
    D, E, F = entries(forward, left, mean_forward2, mean_left2)
    return Table(A=A, B=B, C=C, D=D, E=E, F=F)


def _pairs(earlier: Array, later: Array, fade: float) -> Array:
    """Σ_{i<p} earlier_i later_p fade^(p-i) along the last axis, in O(n)."""
    from scipy.signal import lfilter

    past = lfilter([fade], [1.0, -fade], earlier)  # Σ_{i<=p} earlier_i fade^(p+1-i)
    return np.asarray((past[..., :-1] * later[..., 1:]).sum(axis=-1))
