"""The covariances of a robot that fuses its readings: an extended Kalman filter, linearised about the true path.

The state error is x = (e_x, e_y, θ, constants): estimated minus true position in metres, heading error in rad, world
frame, and the unknown constants of the odometry (`SystematicSpread`), if any. P is its covariance.

* Driving: ``P ← A P Aᵀ + C``. A and C of a turn, a run or an arc are the limit of `driftplan.model.elements` for small
  noise, taken at a millionth of the noise, where it is exact to rounding: whatever noise the exact model knows
  (per metre, per radian, per step, lateral, correlated), the filter knows, from one set of formulas. Cutting a leg of
  the continuous model changes nothing.
* Reading z = Hx + v, v ~ N(0, R): ``P ← P (I + J P)⁻¹`` with the information J = Hᵀ R⁻¹ H. A reading of position,
  heading, range or bearing is one to three `Row` objects, one after the other: nothing is inverted, variance 0 exact.
* Whole stretches, ``P ↦ A (I + P J)⁻¹ P Aᵀ + C``, are one element each and compose (`compose`).
  Source: S. Särkkä, Á. García-Fernández, Temporal parallelization of Bayesian smoothers, IEEE Trans. Automatic Control
  66(1), 2021; the use for routes: S. Prentice, N. Roy, The belief roadmap, IJRR 28(11-12), 2009.

Both are monotone: P₁ ⪯ P₂ stays so through every leg and reading, and a reading never hurts. Valid while the heading's
standard deviation between readings stays below `filter_state.LINEAR_HEADING_STD_RAD`: beyond, the filter goes wrong.

**Systematic errors.** A filter does not know the known biases of an `OdometryNoise` (else they would have been
corrected): they do not enter P, they shift the mean error, which is carried along with the filter's own gains and
reported as `bias`. Neither is monotone then. Biases that change from drive to drive belong into the noise's spread:
the filter estimates them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from driftplan.arrays import Array, Columns, Complexes, Floats, Ints, as_covariance, as_plane
from driftplan.model import moments
from driftplan.model.elements import run_moments, turn_moments
from driftplan.model.filter_state import LegColumns, Row, transition_entries, upper_triangle
from driftplan.model.moments import Moments
from driftplan.model.noise import NO_SPREAD, SYSTEMATIC, OdometryNoise, SystematicSpread
from driftplan.model.paths import Runs

SMALL_NOISE_FACTOR = 2.0**-20  # on standard deviations: the neglected terms are 1e-12 of what is kept
_PERFECT_READING_VARIANCE = 1e-12  # m² or rad²: of a perfect reading of what a stretch began with, in an element only


@dataclass(frozen=True, slots=True, eq=False)
class CovarianceMap(Columns):
    """What driving and reading do to the covariance: ``P ↦ A (I + P J)⁻¹ P Aᵀ + C``, over any leading axes."""

    A: Floats  # (..., d, d) transition, d = 3 + constants
    C: Floats  # (..., d, d) covariance gained
    J: Floats  # (..., d, d) information gained about the state at the beginning

    def __call__(self, P: Floats) -> Floats:
        """The covariance at the end of the stretch, given that at its beginning, (..., d, d)."""
        inner = np.linalg.solve(np.eye(P.shape[-1]) + P @ self.J, P)
        return _symmetric(self.A @ inner @ self.A.mT + self.C)

    def read(self, rows: Sequence[Row]) -> CovarianceMap:
        """The same stretch with a reading at its end; nothing is inverted. A perfect reading of something on which the
        stretch put no noise would be infinite information: it counts as one of a micrometre or microradian."""
        A, C, J = self.A, self.C, self.J
        for row in rows:
            h = row.vector(A.shape[-1])
            g, back = (np.squeeze(x @ h[..., None], -1) for x in (C, A.mT))
            s = np.maximum((h * g).sum(-1) + row.variance, _PERFECT_READING_VARIANCE * (h * h).sum(-1))[..., None, None]
            gain = g[..., :, None] / s
            A, C = A - gain * back[..., None, :], _symmetric(C - gain * g[..., None, :])
            J = J + back[..., :, None] * back[..., None, :] / s
        return CovarianceMap(A, C, J)


def identity(shape: tuple[int, ...] = (), size: int = 3) -> CovarianceMap:
    """The stretch in which nothing happens: neutral for `compose`."""
    eye = np.broadcast_to(np.eye(size), (*shape, size, size))
    return CovarianceMap(eye, np.zeros(eye.shape), np.zeros(eye.shape))


def compose(first: CovarianceMap, second: CovarianceMap) -> CovarianceMap:
    """The stretch that is ``first`` followed by ``second``; associative.

    >>> compose(identity(), identity()).A.trace().item()
    3.0
    """
    M: Floats = np.asarray(np.linalg.inv(np.eye(first.A.shape[-1]) + first.C @ second.J), dtype=float)
    onward, back = second.A @ M, first.A.mT @ M.mT @ second.J
    return CovarianceMap(
        onward @ first.A, _symmetric(onward @ first.C @ second.A.mT + second.C), _symmetric(back @ first.A + first.J)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """What driving does to the error: ``x ← A x + shift + noise of covariance C``, any leading axes."""

    A: Floats  # (..., d, d)
    C: Floats  # (..., d, d)
    shift: Floats  # (..., d) what known systematic errors add to the mean; the filter does not know of it

    @property
    def maps(self) -> CovarianceMap:
        """As elements, without the shift of the mean."""
        return CovarianceMap(self.A, self.C, np.zeros(self.C.shape))

    @property
    def moves(self) -> Complexes:
        """True displacements, metres, world frame: the lever on which a heading error acts."""
        return np.asarray(self.A[..., 1, 2] - 1j * self.A[..., 0, 2])

    @property
    def column(self) -> LegColumns:
        """For as many drives as there are legs: one leg each."""
        size = self.A.shape[-1]
        return LegColumns(
            tuple(self.A[..., i, k] for i, k in transition_entries(size)),
            tuple(self.C[..., i, j] for i, j in upper_triangle(size)),
            tuple(self.shift[..., i] for i in range(size)) if self.shift.any() else None,
        )

    def columns(self) -> list[LegColumns]:
        """One after the other along the last of the leading axes: Python numbers, or arrays over the other axes."""
        transition, gain, shift = self.column
        shifts = [None] * self.A.shape[-3] if shift is None else _in_turn(shift)
        return [LegColumns(*leg) for leg in zip(_in_turn(transition), _in_turn(gain), shifts, strict=True)]


def path_legs(
    runs: Runs, noises: Sequence[OdometryNoise], which: Ints | None = None, spread: SystematicSpread = NO_SPREAD
) -> Legs:
    """All legs of a path, world frame, shape (..., m); ``which`` of the noises each has, (m,), default the first.

    >>> from driftplan.model.paths import read_path
    >>> noise = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-3)
    >>> path_legs(read_path([(0, 0), (30, 0)]), [noise]).C[0].diagonal().round(6)  # L q_d, q_h L³/3, q_h L
    array([0.03 , 0.9  , 0.003])
    """
    turned = runs.turns + runs.curvatures * runs.lengths
    headings = np.asarray(runs.heading)[..., None] + np.cumsum(turned, axis=-1) - turned
    return legs(headings, runs.turns, runs.lengths, runs.curvatures, noises, which, spread)


def legs(
    headings: Floats,
    turns: Floats,
    lengths: Floats,
    curvatures: Floats,
    noises: Sequence[OdometryNoise],
    which: Ints | None = None,
    spread: SystematicSpread = NO_SPREAD,
) -> Legs:
    """Turns on the spot (rad) followed by runs (m) of constant curvature (1/m), by the true heading before the turn,
    the noises and the index of each leg's, all (...); the constants of ``spread`` are further states."""
    headings, turns, lengths, curvatures, index = np.broadcast_arrays(
        headings, turns, lengths, curvatures, np.zeros((), int) if which is None else which
    )
    names, size = spread.names, 3 + len(spread.names)
    A = np.tile(np.eye(size), (*lengths.shape, 1, 1))
    C, shift = np.zeros(A.shape), np.zeros(A.shape[:-1])
    for k, noise in enumerate(noises):
        here = index == k
        facing, driven = np.exp(1j * headings[here]), (turns[here], lengths[here], curvatures[here])
        small = _leg_moments(*driven, noise.corrected().scaled(SMALL_NOISE_FACTOR))
        A[here, :2, 2] = as_plane(1j * facing * small.p)
        C[here, :2, :2] = as_covariance(np.zeros(()), small.N, small.e2, facing)
        C[here, :2, 2] = C[here, 2, :2] = as_plane(facing * (small.b - small.a) / 2j)  # E[e θ]: δ = jθ in this limit
        C[here, 2, 2] = small.D
        for name in SYSTEMATIC:
            value = getattr(noise, name)
            if name in names or value:
                per_unit = _sensitivity(facing, *driven, noise.step_m, name)
                shift[here, :3] += value * per_unit
                if name in names:
                    A[here, :3, 3 + names.index(name)] = per_unit
    return Legs(A, C / SMALL_NOISE_FACTOR**2, shift)


def _leg_moments(turns: Floats, lengths: Floats, curvatures: Floats, noise: OdometryNoise) -> Moments:
    return moments.compose(turn_moments(turns, noise), run_moments(lengths, curvatures, noise))


def _sensitivity(
    facing: Array, turns: Floats, lengths: Floats, curvatures: Floats, step_m: float | None, name: str
) -> Floats:
    """Position and heading error per unit of a systematic error, (..., 3): a central difference at tiny errors."""
    changes: list[dict[str, Any]] = [{name: sign * SMALL_NOISE_FACTOR} for sign in (1.0, -1.0)]
    up, down = (_leg_moments(turns, lengths, curvatures, OdometryNoise(step_m=step_m, **x)) for x in changes)
    position, heading = as_plane(facing * (up.e1 - down.e1)), np.imag(up.d1 - down.d1)
    return np.concatenate([position, heading[..., None]], axis=-1) / (2 * SMALL_NOISE_FACTOR)


def _in_turn(columns: tuple[Any, ...]) -> list[tuple[Any, ...]]:
    """Entry by entry along the last axis."""
    return list(zip(*(x.tolist() if x.ndim == 1 else list(np.moveaxis(x, -1, 0)) for x in columns), strict=True))


def _symmetric(x: Floats) -> Floats:
    return np.asarray(0.5 * (x + x.mT))
