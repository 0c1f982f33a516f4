"""Motions in space as odometry sees them: steps, each a rotation and a translation in the body frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, finite
from driftplan.model.spatial.rotations import RotationNoise, checked_covariance, orthonormal

_LEAST_ROUGH = 1e-6  # how far from orthonormal a rotation matrix may be before it is called a mistake


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
