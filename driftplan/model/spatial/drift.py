"""predict_drift_3d: the drift of dead reckoning in space, in closed form.

Frames: translations and their noise are in the body frame (after the step's rotation), results in the world frame, in
which the motion starts at the origin with the identity attitude. Metres and radians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftplan.arrays import Floats, finite
from driftplan.model.spatial.moments import SpatialMoments, scan, times
from driftplan.model.spatial.rotations import RotationNoise
from driftplan.model.spatial.steps import checked_array, read_steps
from driftplan.tables import Tabular, numbers, rows_of

_AT_ONCE = 8192  # steps per scan: a few megabytes


@dataclass(frozen=True, slots=True, eq=False)
class SpatialDrift(Tabular):
    """Drift e = estimated minus true position in space; made by `predict_drift_3d`.

    Attributes
    ----------
    position : (n + 1, 3), true position, metres, world frame
    distance : (n + 1,), metres flown
    bias : (n + 1, 3), E[e], metres, world frame
    cov : (n + 1, 3, 3), covariance of e, m², world frame. Its smallest eigenvalue is known to about 1e-15 rms² only.

    >>> flight = predict_drift_3d(100 * [np.eye(3)], 100 * [(1.0, 0.0, 0.0)], RotationNoise.isotropic(0.01))
    >>> flight.end.position, round(float(flight.end.rms), 2)
    (array([100.,   0.,   0.]), 8.21)
    """

    position: Floats
    distance: Floats
    bias: Floats
    cov: Floats

    def __repr__(self) -> str:
        return f"SpatialDrift(shape={self.rms.shape}, greatest rms={np.max(self.rms):.4g} m)"

    __str__ = words = __repr__

    def to_dicts(self) -> list[dict[str, Any]]:
        """One row per point, metres and m², by the names of the plane and ``z``."""
        axes = "xyz"
        columns = {
            "distance_m": self.distance,
            **{f"{axis}_m": self.position[..., k] for k, axis in enumerate(axes)},
            "rms_m": self.rms,
            **{f"bias_{axis}_m": self.bias[..., k] for k, axis in enumerate(axes)},
            **{f"cov_{axes[j]}{axes[k]}_m2": self.cov[..., j, k] for j in range(3) for k in range(j, 3)},
        }
        return rows_of(columns)

    def columns(self) -> dict[str, list[str]]:
        """In at most about twenty rows."""
        rows = self.to_dicts()
        return numbers(rows[:: max(len(rows) // 20, 1)], 3, "distance_m", "x_m", "y_m", "z_m", "rms_m")

    @property
    def trace(self) -> Floats:
        """Trace of the covariance, m², (n + 1,)."""
        return np.asarray(np.maximum(np.trace(self.cov, axis1=-2, axis2=-1), 0.0))

    @property
    def rms(self) -> Floats:
        """sqrt(E|e|²), metres, (n + 1,): the default score."""
        return np.asarray(np.sqrt(self.trace + (self.bias**2).sum(axis=-1)))

    @property
    def bias_norm(self) -> Floats:
        """|E[e]|, metres, (n + 1,). Reported for comparison only: a detour can cancel it while the error grows."""
        return np.asarray(np.linalg.norm(self.bias, axis=-1))

    @property
    def largest_eigenvalue(self) -> Floats:
        """Largest eigenvalue of the covariance, m², (n + 1,): variance in the worst direction."""
        return np.asarray(np.linalg.eigvalsh(self.cov)[..., -1])

    @property
    def end(self) -> SpatialDrift:
        """Drift at the end, without the leading axis."""
        return SpatialDrift(self.position[-1], self.distance[-1], self.bias[-1], self.cov[-1])


def predict_drift_3d(
    rotations: ArrayLike,
    translations: ArrayLike,
    rotation_noise: RotationNoise,
    translation_cov: ArrayLike | None = None,
    *,
    translation_bias: ArrayLike | None = None,
    repeats: ArrayLike | None = None,
) -> SpatialDrift:
    """Bias and covariance of the position of a dead reckoner in space, after every step.

    Step k turns the vehicle by ``rotations[k]`` and moves it by ``translations[k]`` in the new body frame. Its odometry
    reports ``rotations[k] @ R̃`` and ``translations[k] + t̃`` with R̃ drawn from ``rotation_noise`` and t̃ of the given
    mean and covariance, all independent. First and second moments are exact for any amount of noise.

    Parameters
    ----------
    rotations : (n, 3, 3), true attitude increments, body frame. Matrices orthonormal within 1e-6 are made so to
        rounding.
    translations : (n, 3), true displacements, metres, body frame
    rotation_noise : one for all steps, or with a leading axis of length n
    translation_cov : (3, 3) or (n, 3, 3), optional
        Covariance of the displacement error, m², body frame. Default: none.
    translation_bias : (3,) or (n, 3), optional: mean of the displacement error, metres, body frame. Default: none.
    repeats : int or (n,) ints, optional
        How often each step is done in a row, >= 0, by repeated squaring: 10⁹ equal steps take milliseconds. Results are
        then for the ends of the rows of equal steps.

    Returns the drift at n + 1 points; the first is the start, where nothing has drifted yet. Raises ValueError for
    wrong shapes, values that are not finite, matrices that are no rotations or no covariances.

    Model of J. Knuth and P. Barooah, Error growth in position estimation from noisy relative pose measurements,
    Robotics and Autonomous Systems 61 (2013), with independent rotation and translation noise; their bounds follow from
    these moments. See `driftplan.model.spatial.moments`.

    A helix, 16 turns to the left and 20 m up:

    >>> c, s = np.cos(0.1), np.sin(0.1)
    >>> turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    >>> noise = RotationNoise.isotropic(0.01)
    >>> drift = predict_drift_3d([turn], [[0.1, 0, 0.02]], noise, 1e-4 * np.eye(3), repeats=1000)
    >>> drift.end.position.round(3), drift.end.rms.round(4).item()
    (array([-0.513,  0.112, 20.   ]), 5.1404)
    """
    R, t, cov, bias = read_steps(rotations, translations, rotation_noise, translation_cov, translation_bias)
    many, count = _repeats(repeats, len(R)), len(R)

    def at_rest(where: slice) -> SpatialMoments:
        return SpatialMoments.of_step(rotation_noise.of_steps(where), _part(bias, 2, where), _part(cov, 3, where))

    same = at_rest(slice(None)) if not rotation_noise.batch and bias.ndim == 1 and cov.ndim == 2 else None
    distance = np.linalg.norm(t, axis=-1)
    R, t = (np.ascontiguousarray(np.moveaxis(x, 0, -1)) for x in (R, t))
    if many is None:
        S = attitudes(R)

        def pieces(where: slice) -> SpatialMoments:
            step = same if same is not None else at_rest(where)
            return step.rotated(S[..., where]).moved(times(S[..., where], t[..., where]))
    else:
        step = same if same is not None else at_rest(slice(None))
        gained, rows = power(R, step.rotated(R).moved(times(R, t)).spread(count), many)
        S = np.concatenate([np.eye(3)[..., None], attitudes(gained)[..., :-1]], axis=-1)
        distance = distance * many

        def pieces(where: slice) -> SpatialMoments:
            return rows.part(where).rotated(S[..., where])

    return _drift(distance, *chain(pieces, count))


def predict_flight_drift(
    waypoints: ArrayLike,
    *,
    rotation_var_per_m: ArrayLike,
    distance_var_per_m: ArrayLike = 0.0,
    lateral_var_per_m: ArrayLike = 0.0,
) -> SpatialDrift:
    """Drift at the waypoints of a path in space, flown in straight runs with noise that is white along the path.

    The attitude error is Brownian about all three axes alike, so that the vehicle's attitude, roll included, does not
    matter; turning at a waypoint costs nothing. Exact, consistent under subdivision, O(waypoints). For noise per step
    or a preferred axis: `flight_steps` and `predict_drift_3d`.

    Parameters
    ----------
    waypoints : (n, 3), metres, world frame, n >= 2
    rotation_var_per_m : float or (n - 1,)
        Variance of the attitude error about each axis gained per metre, rad²/m; one for all runs or one per run.
    distance_var_per_m, lateral_var_per_m : float or (n - 1,)
        Variance of the position error along, and in each direction across, the direction of flight per metre, m²/m.

    Returns the drift at n points, the first of which is the start. Raises ValueError for wrong shapes, values that are
    not finite, negative variances.

    E|e|² is that of a planar robot whose heading variance per metre is twice ``rotation_var_per_m``: two axes out of
    three bend a run.

    >>> drift = predict_flight_drift([(0, 0, 0), (100, 0, 0), (100, 0, 20)], rotation_var_per_m=1e-5)
    >>> drift.rms.round(3)
    array([0.   , 2.582, 2.742])
    """
    path = checked_array("waypoints", waypoints, (None, 3), "n waypoints in metres, shape (n, 3)")
    if len(path) < 2:
        raise ValueError(f"expected at least 2 waypoints, got {len(path)}")
    legs = np.diff(path, axis=0)
    turn = _rate("rotation_var_per_m", rotation_var_per_m, len(legs))
    along = _rate("distance_var_per_m", distance_var_per_m, len(legs))
    across = _rate("lateral_var_per_m", lateral_var_per_m, len(legs))

    def pieces(where: slice) -> SpatialMoments:
        return SpatialMoments.of_straight_runs(legs[where].T, turn[where], along[where], across[where])

    position, mean, square = chain(pieces, len(legs))
    return _drift(np.linalg.norm(legs, axis=-1), path[0] + position, mean, square)


def chain(pieces: Callable[[slice], SpatialMoments], count: int) -> tuple[Floats, Floats, Floats]:
    """True position and E[e], (count + 1, 3), and E[e eᵀ], (count + 1, 3, 3), after pieces flown one after the other.

    ``pieces`` gives those of a slice of 0..count, in world axes; it is asked in order.
    """
    position, bias, square = np.zeros((count + 1, 3)), np.zeros((count + 1, 3)), np.zeros((count + 1, 3, 3))
    last: SpatialMoments | None = None
    for begin in range(0, count, _AT_ONCE):
        end = min(begin + _AT_ONCE, count)
        state = pieces(slice(begin, end)).spread(end - begin)
        if last is not None:
            state = SpatialMoments(*(np.concatenate(pair, axis=-1) for pair in zip(last, state, strict=True)))
        state = state.prefixes()
        new, last = state.part(slice(begin - end, None)), state.part(slice(-1, None))
        position[begin + 1 : end + 1], bias[begin + 1 : end + 1] = new.p.T, new.e.T
        square[begin + 1 : end + 1] = new.square
    return position, bias, square


def attitudes(rotations: Floats) -> Floats:
    """Products R_1, R_1 R_2, ... of rotation matrices (3, 3, n)."""
    products = np.empty(rotations.shape)
    last = np.eye(3)[..., None]
    for begin in range(0, rotations.shape[-1], _AT_ONCE):
        part = np.concatenate([last, rotations[..., begin : begin + _AT_ONCE]], axis=-1)
        part = scan(lambda A, B: [times(A[0], B[0])], [part])[0]
        products[..., begin : begin + _AT_ONCE] = part[..., 1:]
        last = _orthonormal(part[..., -1:])
    return products


def power(R: Floats, piece: SpatialMoments, count: NDArray[np.int64]) -> tuple[Floats, SpatialMoments]:
    """Attitude gained, (3, 3, n), and moments, when piece k (in the axes in which it starts), which turns by R[..., k],
    is flown count[k] >= 0 times: by squaring."""
    left, gained = count.copy(), np.broadcast_to(np.eye(3)[..., None], R.shape)
    total = SpatialMoments(*(np.zeros_like(x) for x in piece))
    while True:
        odd = left % 2 == 1
        if odd.any():
            more = total.append(piece.rotated(gained))
            total = SpatialMoments(*(np.where(odd, x, y) for x, y in zip(more, total, strict=True)))
            gained = np.where(odd, _orthonormal(times(gained, R)), gained)
        left //= 2
        if not left.any():
            return gained, total
        piece = piece.append(piece.rotated(R))
        R = _orthonormal(times(R, R))


def _orthonormal(R: Floats) -> Floats:
    """As `driftplan.model.spatial.rotations.orthonormal`, of matrices (3, 3, n)."""
    return np.asarray(1.5 * R - 0.5 * times(R, times(R.swapaxes(0, 1), R)))


def _repeats(repeats: ArrayLike | None, count: int) -> NDArray[np.int64] | None:
    if repeats is None:
        return None
    try:
        times = np.asarray(repeats)
    except ValueError:
        times = np.zeros(0)  # of no shape
    if times.dtype.kind not in "iu" or times.shape not in ((), (count,)) or (times < 0).any():
        raise ValueError(f"expected repeats to be an int >= 0 or {count} of them, got {repeats!r}")
    return np.broadcast_to(times.astype(np.int64), (count,))


def _rate(name: str, value: ArrayLike, runs: int) -> Floats:
    rate = finite(name, value, "a number, or one per run")
    if rate.shape not in ((), (runs,)):
        raise ValueError(f"expected {name} for all runs or one for each of {runs}, got an array of shape {rate.shape}")
    if (rate < 0).any():
        raise ValueError(f"expected {name} finite and >= 0, got {value!r}")
    return np.broadcast_to(rate, (runs,))


def _part(x: Floats, batched: int, where: slice) -> Floats:
    return x[where] if x.ndim == batched else x


def _drift(distances: Floats, position: Floats, mean: Floats, square: Floats) -> SpatialDrift:
    cov = square - mean[:, :, None] * mean[:, None, :]
    arrays = position, np.concatenate([[0.0], np.cumsum(distances)]), mean, cov
    for array in arrays:
        array.setflags(write=False)
    return SpatialDrift(*arrays)
