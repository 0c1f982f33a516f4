"""Motions in space as odometry sees them: steps, each a rotation and a translation in the body frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, finite, positive
from driftplan.model.noise import steps_in
from driftplan.model.spatial.rotations import RotationNoise, checked_covariance, orthonormal

_MAX_STEPS = 50_000_000  # of flight_steps: 5 GB of rotations
_LEAST_ROUGH = 1e-6  # how far from orthonormal a rotation matrix may be before it is called a mistake


def flight_steps(waypoints: ArrayLike, step_m: float) -> tuple[Floats, Floats]:
    """A path in space cut into odometry steps: arguments for `predict_drift_3d` and `simulate_drift_3d`.

    A run of length L becomes ceil(L/step_m - 1e-9) equal steps along the body's x axis, which points where the vehicle
    flies. At a waypoint it turns the shortest way, without rolling; straight back, about the world's z axis (about x
    when flying vertically). The turn belongs to the first step of the run.

    Parameters
    ----------
    waypoints : (n, 3), metres, n >= 2. Runs of no length give no step.
    step_m : greatest length of a step, metres

    Returns rotations (steps, 3, 3) and translations (steps, 3). Raises ValueError for wrong shapes, values that are not
    finite, a path of no length, a step so short that memory would not do.

    >>> rotations, translations = flight_steps([(0, 0, 0), (2, 0, 0), (2, 0, 1)], step_m=1.0)
    >>> translations
    array([[1., 0., 0.],
           [1., 0., 0.],
           [1., 0., 0.]])
    """
    path = checked_array("waypoints", waypoints, (None, 3), "n waypoints in metres, shape (n, 3)")
    step_m = positive("step_m", step_m)
    legs = np.diff(path, axis=0)
    lengths = np.linalg.norm(legs, axis=-1)
    legs, lengths = legs[lengths > 0], lengths[lengths > 0]
    if len(legs) == 0:
        raise ValueError("expected waypoints at two different places at least, got a path of no length")
    counts = steps_in(lengths, step_m)
    if counts.sum() > _MAX_STEPS:
        raise ValueError(
            f"expected at most {_MAX_STEPS} steps, got {counts.sum():.3g}: use a longer step_m, or the repeats of "
            "predict_drift_3d"
        )
    steps = np.maximum(counts, 1).astype(np.int64)
    course = np.vstack([[1.0, 0.0, 0.0], legs / lengths[:, None]])
    S = np.empty((len(course), 3, 3))
    S[0] = np.eye(3)
    for k, turn in enumerate(_shortest_turns(course[:-1], course[1:])):  # in the world frame
        S[k + 1] = turn @ S[k]
    rotations = np.tile(np.eye(3), (int(steps.sum()), 1, 1))
    rotations[np.concatenate([[0], np.cumsum(steps)[:-1]])] = np.swapaxes(S[:-1], -1, -2) @ S[1:]
    translations = np.zeros((len(rotations), 3))
    translations[:, 0] = np.repeat(lengths / steps, steps)
    return rotations, translations


def read_steps(
    rotations: ArrayLike,
    translations: ArrayLike,
    rotation_noise: RotationNoise,
    translation_cov: ArrayLike | None,
    translation_bias: ArrayLike | None,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Checked rotations (n, 3, 3), translations (n, 3), covariance (3, 3) or (n, 3, 3), bias (3,) or (n, 3)."""
    R = checked_array("rotations", rotations, (None, 3, 3), "n rotation matrices, shape (n, 3, 3)")
    count = len(R)
    if count == 0:
        raise ValueError("expected at least one step, got none")
    t = checked_array("translations", translations, (None, 3), "n displacements in metres, shape (n, 3)")
    if len(t) != count:
        raise ValueError(f"expected as many translations as rotations, {count}, got {len(t)}")
    rough = np.abs(np.einsum("nij,nik->njk", R, R) - np.eye(3)).max(axis=(-1, -2))
    wrong = (rough > _LEAST_ROUGH) | (np.linalg.det(R) < 0)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise ValueError(
            f"expected rotation matrices, orthonormal within {_LEAST_ROUGH:g} and of determinant 1; rotations[{k}] has "
            f"determinant {np.linalg.det(R[k]):.6g} and is off by {rough[k]:.3g}"
        )
    if not isinstance(rotation_noise, RotationNoise):
        raise ValueError(f"expected rotation_noise to be a RotationNoise, got {type(rotation_noise).__name__}")
    if rotation_noise.batch not in ((), (count,)):
        raise ValueError(
            f"expected rotation_noise for all steps or one for each of {count}, got a batch of shape "
            f"{rotation_noise.batch}"
        )
    cov = np.zeros((3, 3)) if translation_cov is None else checked_covariance("translation_cov", translation_cov)
    if cov.ndim == 3 and len(cov) != count:
        raise ValueError(f"expected translation_cov for all steps or one for each of {count}, got {len(cov)}")
    bias = np.zeros(3)
    if translation_bias is not None:
        shape = (None, 3) if np.ndim(translation_bias) == 2 else (3,)
        bias = checked_array("translation_bias", translation_bias, shape, f"shape (3,) or ({count}, 3), in metres")
        if bias.ndim == 2 and len(bias) != count:
            raise ValueError(f"expected translation_bias for all steps or one for each of {count}, got {len(bias)}")
    if rough.max() > 1e-14:
        R = orthonormal(orthonormal(R))
    return R, t, cov, bias


def checked_array(name: str, value: ArrayLike, shape: tuple[int | None, ...], what: str) -> Floats:
    """The value as an array of that shape (None: any length), finite, or a ValueError that says what it should be."""
    array = finite(name, value, what)
    if array.ndim != len(shape) or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True)):
        raise ValueError(f"expected {name} to be {what}, got an array of shape {array.shape}")
    return array


def _shortest_turns(a: Floats, b: Floats) -> Floats:
    """Rotations about a x b that take unit vectors a to b, (n, 3, 3)."""
    cosine = np.einsum("ni,ni->n", a, b)[:, None, None]
    back = cosine[:, 0, 0] < -1 + 1e-12
    axis = np.cross(a, b)
    cross = np.cross(np.eye(3), axis[:, None, :])  # row i: e_i x axis, so that cross = [axis]×
    turns = np.eye(3) + cross + cross @ cross / np.where(back[:, None, None], 1.0, 1 + cosine)
    if back.any():
        upright = np.abs(a[back, 2:]) > 1 - 1e-9
        helper = np.where(upright, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
        axis = helper - np.einsum("ni,ni->n", helper, a[back])[:, None] * a[back]
        axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
        turns[back] = 2 * axis[:, :, None] * axis[:, None, :] - np.eye(3)
    return turns
