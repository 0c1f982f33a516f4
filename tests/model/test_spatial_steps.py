"""Steps in space: flights cut into steps, and the checks of what a caller hands in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model.spatial.drift import predict_drift_3d
from driftplan.model.spatial.rotations import RotationNoise, orthonormal
from driftplan.model.spatial.simulation import simulate_drift_3d
from driftplan.model.spatial.steps import flight_steps, read_steps

GOOD = {"rotations": [np.eye(3)] * 3, "translations": np.ones((3, 3)), "rotation_noise": RotationNoise.isotropic(0.1)}


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), step=st.floats(0.05, 2.0))
def test_steps_lead_along_the_flight(seed, step):
    path = np.random.default_rng(seed).normal(size=(6, 3))
    rotations, translations = flight_steps(path, step)
    drift = predict_drift_3d(rotations, translations, RotationNoise.isotropic(0.1))
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=-1)
    ends = np.cumsum(np.ceil(lengths / step - 1e-9)).astype(int)
    np.testing.assert_allclose(drift.position[ends], path[1:] - path[0], atol=1e-12)
    assert translations.max() <= step * (1 + 1e-9)
    assert not translations[:, 1:].any()


@pytest.mark.parametrize(
    ("out", "back"),
    [((1, 0, 0), np.diag([-1, -1, 1])), ((0, 0, 1), np.diag([-1, 1, -1])), ((-1, 0, 0), np.diag([-1, -1, 1]))],
)
def test_flying_back_turns_about_the_vertical_or_pitches_over(out, back):
    rotations, _ = flight_steps([(0, 0, 0), out, (0, 0, 0)], 1.0)
    np.testing.assert_allclose(rotations[1] @ [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(rotations[0] @ [1.0, 0.0, 0.0], out, atol=1e-15)
    world = rotations[0] @ rotations[1] @ rotations[0].T
    np.testing.assert_allclose(world, back if out != (0, 0, 1) else np.diag([1, -1, -1]), atol=1e-15)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"rotations": np.eye(3)}, r"n rotation matrices, shape \(n, 3, 3\), got an array of shape \(3, 3\)"),
        ({"rotations": np.zeros((0, 3, 3)), "translations": np.zeros((0, 3))}, "at least one step"),
        ({"rotations": [np.eye(3), 2 * np.eye(3), np.eye(3)]}, r"rotations\[1\] has determinant 8"),
        ({"rotations": [-np.eye(3)] * 3}, r"rotations\[0\] has determinant -1"),
        ({"rotations": np.full((3, 3, 3), np.nan)}, r"rotations finite, got nan at index \(0, 0, 0\)"),
        ({"rotations": "north"}, "rotation matrices"),
        ({"translations": np.ones((2, 3))}, "as many translations as rotations, 3, got 2"),
        ({"translations": np.ones((3, 2))}, r"shape \(n, 3\), got an array of shape \(3, 2\)"),
        ({"translations": [[0, 0, np.inf]] * 3}, "translations finite"),
        ({"rotation_noise": 0.1}, "RotationNoise, got float"),
        ({"rotation_noise": RotationNoise.isotropic([0.1, 0.2])}, r"one for each of 3, got a batch of shape \(2,\)"),
        ({"translation_cov": -np.eye(3)}, "translation_cov without negative eigenvalues"),
        ({"translation_cov": np.eye(2)}, r"translation_cov of shape \(3, 3\)"),
        ({"translation_cov": np.zeros((2, 3, 3))}, "translation_cov for all steps or one for each of 3, got 2"),
        ({"translation_bias": [1.0, 2.0]}, "translation_bias"),
        ({"translation_bias": np.ones((2, 3))}, "translation_bias for all steps or one for each of 3, got 2"),
        ({"translation_bias": [1.0, 2.0, np.nan]}, "translation_bias finite"),
    ],
)
def test_bad_steps_say_what_was_expected(changed, message):
    for ask in (predict_drift_3d, simulate_drift_3d):
        with pytest.raises(ValueError, match=message):
            ask(**(GOOD | changed))


@pytest.mark.parametrize(
    ("path", "step", "message"),
    [
        ([(0, 0, 0), (1, 0, 0)], 0.0, "step_m > 0, got 0.0"),
        ([(0, 0, 0), (1, 0, 0)], float("nan"), "step_m finite"),
        ([(0, 0, 0), (1, 0, 0)], 1e-12, "at most 50000000 steps, got 1e"),
        ([(0, 0, 0), (0, 0, 0)], 1.0, "two different places"),
        ([(0, 0, 0), (1, 0, np.inf)], 1.0, "waypoints finite"),
    ],
)
def test_bad_cuts_say_what_was_expected(path, step, message):
    with pytest.raises(ValueError, match=message):
        flight_steps(path, step)


def test_rounded_rotations_are_made_orthonormal():
    """Single precision is good enough for a rotation matrix, and its roundings do not pile up."""
    exact = RotationNoise.isotropic(0.6).sample(np.random.default_rng(1), 200)
    for rough in (exact.astype(np.float32).astype(float), exact * (1 + 4e-7)):
        R, *_ = read_steps(rough, np.ones((200, 3)), RotationNoise.isotropic(0.1), None, None)
        np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), rtol=0, atol=2e-15)
        np.testing.assert_allclose(R, exact, rtol=0, atol=2e-7)
    twisted = exact + 1e-4 * exact @ np.diag([1.0, -1.0, 0.5])
    np.testing.assert_allclose(orthonormal(orthonormal(twisted)), exact, rtol=0, atol=1e-14)  # error 1e-4, 1e-8, 1e-16
