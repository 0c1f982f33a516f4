"""Recordings of simulated drives have the errors they were asked to have."""

from __future__ import annotations

import numpy as np
import pytest

from driftplan.model.calibration.recordings import simulate_log
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Run

NOISE = OdometryNoise(
    heading_var_per_m=2e-3,
    heading_var_per_rad=4e-3,
    distance_var_per_m=2e-3,
    distance_var_per_rad=3e-3,
    lateral_var_per_m=1e-3,
    heading_bias_per_m=0.01,
    heading_bias_per_rad=-0.05,
    distance_scale_error=0.03,
)
PATH = [(1, 2), (5, 2), (5, 5), (3, 5)]


def test_many_recordings_end_where_the_prediction_says():
    rng = np.random.default_rng(4)
    runs = 1200
    errors = np.empty((runs, 2))
    for k in range(runs):
        log, truth = simulate_log(PATH, NOISE, rng=rng)
        end = log.positions[-1] * np.exp(1j * truth.heading[0]) + truth.positions[0] - truth.positions[-1]
        errors[k] = end.real, end.imag
    drift = predict_drift(PATH, NOISE).end
    mean, cov = errors.mean(axis=0), np.cov(errors.T)
    # four standard errors; those of a variance with few runs in the tails: sqrt(2/runs), with margin for kurtosis.
    # Steps of 10 cm along 9 m change the moments by their square, 1e-4.
    assert (np.abs(mean - drift.bias) < 4 * np.sqrt(np.diag(cov) / runs)).all()
    size = np.sqrt(np.outer(np.diag(drift.cov), np.diag(drift.cov)))
    assert (np.abs(cov - drift.cov) < 4 * np.sqrt(2.5 / runs) * size).all()


def test_without_noise_odometry_repeats_the_truth():
    log, truth = simulate_log(
        [Run(length_m=3.0, curvature_per_m=0.4), Run(length_m=2.0, turn_rad=-1.0)], OdometryNoise()
    )
    assert log.positions == pytest.approx(truth.positions, abs=1e-12)
    assert log.headings == pytest.approx(truth.heading, abs=1e-12)
    assert truth.heading[-1] == pytest.approx(0.2)
    assert log.times[-1] == pytest.approx(6.0)  # 5 m and 1 rad


def test_errors_of_the_truth_are_white_and_as_large_as_said():
    _, exact = simulate_log([(0, 0), (200, 0)], OdometryNoise())
    _, seen = simulate_log([(0, 0), (200, 0)], OdometryNoise(), truth_position_std_m=0.02, truth_heading_std=0.01)
    off = np.column_stack([seen.xy - exact.xy, seen.heading - exact.heading])
    assert off.std(axis=0) == pytest.approx([0.02, 0.02, 0.01], rel=0.07)  # 2001 samples: three standard errors
    assert np.abs(np.corrcoef(off[1:, 0], off[:-1, 0])[0, 1]) < 0.09


def test_what_cannot_be_simulated_is_refused():
    with pytest.raises(ValueError, match="expected a noise of the continuous model"):
        simulate_log(PATH, OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.0))
    with pytest.raises(ValueError, match="expected step_m > 0"):
        simulate_log(PATH, NOISE, step_m=0.0)
    with pytest.raises(ValueError, match="expected one path"):
        simulate_log(np.zeros((2, 3, 2)), NOISE)
