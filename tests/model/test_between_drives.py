"""Systematic errors that differ from one drive to the next: predictions average over drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.model.simulation import simulate_drift

VARYING = OdometryNoise(
    heading_var_per_m=2e-4,
    distance_var_per_m=1e-3,
    heading_bias_per_m=2e-3,
    heading_bias_std_per_m=8e-3,
    heading_bias_std_per_rad=0.04,
    distance_scale_std=0.03,
)
PATH = [(0, 0), (12, 0), (12, 9), (3, 9), (3, 2)]


@pytest.mark.parametrize("fixes", [(), (Fix.full(17.0, position_std_m=0.1, heading_std=0.02),)])
def test_the_average_over_drives_is_that_of_simulated_drives(fixes):
    runs = 20_000
    drift = predict_drift(PATH, VARYING, fixes=fixes)
    errors = simulate_drift(PATH, VARYING, fixes=fixes, runs=runs, rng=5)
    square = (errors**2).sum(axis=-1)
    error = square.std(axis=0) / np.sqrt(runs)
    assert (np.abs(square.mean(axis=0) - drift.rms**2) < 4 * error + 1e-12).all()
    assert np.abs(errors.mean(axis=0) - drift.bias).max() < 4 * (errors.std(axis=0) / np.sqrt(runs)).max()
    assert np.cov(errors[:, -1].T) == pytest.approx(drift.end.cov, abs=0.05 * float(drift.end.rms) ** 2)


def test_a_straight_drive_has_the_closed_form():
    """Scale alone, and a bias alone: E|e|² = (σ L)², and that of E exp(jβs) = exp(-σ²s²/2) for β ~ N(0, σ²)."""
    length, sigma = 10.0, 0.02
    scale = predict_drift([(0, 0), (length, 0)], OdometryNoise(distance_scale_std=sigma)).end
    assert scale.rms == pytest.approx(sigma * length, rel=1e-12)
    assert scale.bias == pytest.approx([0, 0], abs=1e-15)
    bent = predict_drift([(0, 0), (length, 0)], OdometryNoise(heading_bias_std_per_m=sigma)).end
    s = np.linspace(0, length, 20_001)
    assert bent.bias[0] == pytest.approx(np.trapezoid(np.exp(-0.5 * (sigma * s) ** 2) - 1, s), rel=1e-6)
    assert np.abs(bent.moments.d1 + 1) == pytest.approx(np.exp(-0.5 * (sigma * length) ** 2), rel=1e-9)


def test_what_is_asked_between_waypoints_is_averaged_too():
    drift = predict_drift(PATH, VARYING)
    longer = predict_drift([(0, 0), (12, 0), (12, 4)], VARYING).end
    assert drift.at(16.0).rms == pytest.approx(longer.rms, rel=1e-12)
    assert drift.on_arrival(16.0).cov[-1] == pytest.approx(longer.cov, rel=1e-9, abs=1e-15)
    assert drift.profile().rms.max() >= drift.rms.max()
    assert np.isfinite(drift.departures().N).all()


def test_one_robot_has_one_deviation_on_all_floors():
    same = predict_drift(PATH, [VARYING, replace(VARYING, distance_var_per_m=2e-3), VARYING, VARYING]).end
    alike = predict_drift(PATH, [VARYING, VARYING, VARYING, VARYING]).end
    assert alike.rms == pytest.approx(predict_drift(PATH, VARYING).end.rms, rel=1e-12)
    assert float(same.rms) == pytest.approx(float(alike.rms), rel=0.05)
    assert same.rms > alike.rms


def test_without_spread_nothing_changes_and_negative_spread_is_refused():
    fixed = replace(VARYING, heading_bias_std_per_m=0.0, heading_bias_std_per_rad=0.0, distance_scale_std=0.0)
    assert predict_drift(PATH, fixed)._drives == ()
    assert VARYING.scaled(2.0).distance_scale_std == pytest.approx(0.06)
    with pytest.raises(ValueError, match="expected distance_scale_std >= 0"):
        OdometryNoise(distance_scale_std=-0.1)


def test_a_filter_knows_one_spread_on_all_floors_and_gains_by_it():
    fixes = [Fix.position(9.0, position_std_m=0.1), Fix.position(21.0, position_std_m=0.1)]
    constant = VARYING.on_drive((0, 0, 0))
    rms = [predict_drift(PATH, noise, fixes=fixes, estimator="filter").end.rms for noise in (constant, VARYING)]
    assert rms[0] < rms[1] < predict_drift(PATH, VARYING, fixes=fixes).end.rms
    floors = [VARYING, VARYING, constant, constant]
    with pytest.raises(ValueError, match="got several spreads"):
        predict_drift(PATH, floors, fixes=fixes, estimator="filter")
