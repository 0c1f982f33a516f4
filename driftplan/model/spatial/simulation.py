"""simulate_drift_3d: Monte Carlo dead reckoning in space, the oracle of `predict_drift_3d`; knows no moments."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, bounded, generator, whole
from driftplan.model.spatial.rotations import RotationNoise
from driftplan.model.spatial.steps import read_steps


def simulate_drift_3d(
    rotations: ArrayLike,
    translations: ArrayLike,
    rotation_noise: RotationNoise,
    translation_cov: ArrayLike | None = None,
    *,
    translation_bias: ArrayLike | None = None,
    runs: int = 1000,
    rng: np.random.Generator | int = 0,
) -> Floats:
    """Errors of a simulated dead reckoner: the steps are flown ``runs`` times with fresh noise.

    Same model, frames and arguments as `driftplan.predict_drift_3d`; translation errors are normal.

    Parameters
    ----------
    rotations, translations, rotation_noise, translation_cov, translation_bias : as for `predict_drift_3d`
    runs : number of flights, >= 1
    rng : Generator or seed: same seed, same answer

    Returns estimated minus true positions (runs, n + 1, 3), metres, world frame, at the start and after every step.
    Raises ValueError as `predict_drift_3d`, and for runs < 1.

    >>> noise = RotationNoise.isotropic(0.1)
    >>> errors = simulate_drift_3d([np.eye(3)] * 10, [[1.0, 0.0, 0.0]] * 10, noise, runs=4000)
    >>> errors.shape, np.sqrt((errors[:, -1] ** 2).sum(axis=-1).mean()).round(1).item()
    ((4000, 11, 3), 2.7)
    """
    R, t, cov, bias = read_steps(rotations, translations, rotation_noise, translation_cov, translation_bias)
    bounded("errors to simulate", whole("runs", runs, least=1) * (len(R) + 1), 3e8, "use fewer runs")
    rng = generator(rng)
    values, axes = np.linalg.eigh(cov)
    spread = axes * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    errors = np.zeros((runs, len(R) + 1, 3))
    attitude, position = np.eye(3), np.zeros(3)
    believed = np.broadcast_to(np.eye(3), (runs, 3, 3))
    place = np.zeros((runs, 3))
    for k in range(len(R)):
        attitude = attitude @ R[k]
        position = position + attitude @ t[k]
        believed = believed @ R[k] @ rotation_noise.of_steps(k).sample(rng, runs)
        jitter = rng.standard_normal((runs, 3)) @ (spread[k] if spread.ndim == 3 else spread).T
        moved = t[k] + (bias[k] if bias.ndim == 2 else bias) + jitter
        place = place + (believed @ moved[:, :, None])[:, :, 0]
        errors[:, k + 1] = place - position
    return errors
