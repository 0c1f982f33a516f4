"""Covariances for messages of ROS are those of simulated odometry at the rate of the messages."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from driftplan.model.calibration.recordings import simulate_log
from driftplan.model.noise import OdometryNoise
from driftplan.model.simulation import simulate_drift
from driftplan.world.noise_files import ros_covariances

NOISE = OdometryNoise(
    heading_var_per_m=2e-3,
    distance_var_per_m=1e-3,
    lateral_var_per_m=5e-4,
    heading_bias_per_m=0.01,
    distance_scale_error=0.02,
)
XY_YAW = np.ix_([0, 1, 5], [0, 1, 5])


def matrices(noise=NOISE, **given):
    found = yaml.safe_load(ros_covariances(noise, **{"rate_hz": 5.0, "speed_m_per_s": 0.8, **given}))
    return {name: np.reshape(values, (6, 6)) for name, values in found.items()}


def test_the_twist_varies_as_that_of_a_simulated_robot():
    """16 000 messages: a variance is known to 1.1 %, and four of these standard errors are allowed."""
    log, _ = simulate_log([(0, 0), (2560, 0)], NOISE.corrected(), step_m=0.8 / 5.0, speed_m_per_s=0.8)
    dt = np.diff(log.times)
    twist = matrices()["twist_covariance"]
    along = log.moves * np.exp(-0.5j * log.turns)  # in the heading midway
    assert np.var(along.real / dt) == pytest.approx(twist[0, 0], rel=0.045)
    assert np.var(along.imag / dt) == pytest.approx(twist[1, 1], rel=0.045)
    assert np.var(log.turns / dt) == pytest.approx(twist[5, 5], rel=0.045)


def test_the_pose_is_as_uncertain_as_after_a_simulated_drive():
    pose = matrices(driven_m=6.0)["pose_covariance"]
    errors = simulate_drift([(0, 0), (6, 0)], NOISE.corrected(), runs=20_000, rng=1, substep_m=0.1)[:, -1]
    scale = np.sqrt(np.outer(*(2 * [pose[:2, :2].diagonal()])))  # variances from 20 000 drives: 1 %, four of these
    assert (np.abs(np.cov(errors.T) - pose[:2, :2]) < 0.04 * scale).all()
    assert pose[5, 5] == pytest.approx(NOISE.heading_var_per_m * 6)
    assert pose[1, 5] == pytest.approx(NOISE.heading_var_per_m * 6**2 / 2, rel=0.01)  # first order


def test_matrices_are_covariances_of_a_plane_and_biases_no_part_of_them():
    plain, biased = matrices(NOISE.corrected()), matrices()
    for name, full in biased.items():
        np.testing.assert_array_equal(full, plain[name])
        np.testing.assert_array_equal(full, full.T)
        assert np.linalg.eigvalsh(full[XY_YAW])[0] >= 0
        full[XY_YAW] = 0
        assert not full.any()
    assert "distances are measured 1.02 times too long" in ros_covariances(NOISE, rate_hz=5.0, speed_m_per_s=0.8)


def test_what_is_out_of_range_is_refused():
    for given, message in (({"rate_hz": 0.0}, "rate_hz > 0"), ({"speed_m_per_s": -1.0}, "speed_m_per_s >= 0")):
        with pytest.raises(ValueError, match=message):
            matrices(**given)
    with pytest.raises(ValueError, match="noise per step"):
        matrices(OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.0))
