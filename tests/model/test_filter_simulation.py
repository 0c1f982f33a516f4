"""A real extended Kalman filter, at its own estimates, against the predicted covariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from driftplan import Beacon, BeaconKind, Fix, OdometryNoise, Run, drift_with_beacons, predict_drift, simulate_drift
from driftplan.beacons.readings import beacon_fixes

DRIVES = 4000
EVERYTHING = OdometryNoise(
    heading_var_per_m=2e-5,
    distance_var_per_m=4e-4,
    lateral_var_per_m=1e-4,
    heading_var_per_rad=1e-4,
    distance_var_per_rad=1e-4,
    heading_distance_corr=0.5,
)


def predicted_rms(path, noise, fixes):
    drift = predict_drift(path, noise, fixes=fixes, estimator="filter")
    assert drift.profile().heading_std.max() < 0.1
    return drift.rms


def simulated_rms(path, noise, fixes, **options):
    options = {"substep_m": 0.5, **options}
    errors = simulate_drift(path, noise, fixes=fixes, estimator="filter", runs=DRIVES, **options)
    square = (errors**2).sum(axis=-1)
    rms = np.sqrt(square.mean(axis=0))
    return rms, square.std(axis=0) / np.sqrt(DRIVES) / np.maximum(2 * rms, 1e-12)


def assert_agrees(path, noise, fixes, **options):
    expected = predicted_rms(path, noise, fixes)
    rms, error = simulated_rms(path, noise, fixes, **options)
    assert (np.abs(rms - expected) <= 0.03 * expected + 4 * error).all(), (rms, expected, error)


def random_path(rng):
    return [
        Run(
            length_m=rng.uniform(3, 12),
            curvature_per_m=rng.uniform(-0.5, 0.5) * (rng.random() < 0.4),
            turn_rad=rng.uniform(-2.5, 2.5),
        )
        for _ in range(6)
    ]


def random_fixes(rng, length):
    fixes = []
    for s in np.sort(rng.uniform(0, length, rng.integers(2, 8))).tolist():
        root = rng.normal(size=(2, 2)) * 0.1
        both = rng.integers(4)
        fixes.append(
            Fix(
                s_m=s,
                position_cov=root @ root.T if both else None,
                heading_std=rng.uniform(0.01, 0.05) if both in (0, 3) else None,
            )
        )
    return fixes


@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(k, marks=pytest.mark.slow) for k in range(3, 20))])
def test_predictions_are_what_a_real_filter_does(seed):
    rng = np.random.default_rng(seed)
    path = random_path(rng)
    fixes = random_fixes(rng, sum(run.length_m for run in path))
    assert_agrees(path, EVERYTHING, fixes, rng=seed)


def test_ranges_and_bearings():
    path = [(0, 0), (12, 0), (12, 8), (0, 8), (0, 0)]
    places = np.arange(1.0, 40.0, 3.0)
    ranges = [Fix.range(s, anchor=(5.0, 3.0), range_std_m=0.1) for s in places]
    assert_agrees(path, EVERYTHING, ranges)
    both = [Fix(s_m=s, anchor=np.array([-4.0, 13.0]), range_std_m=0.1, bearing_std=0.05) for s in places]
    assert_agrees(path, EVERYTHING, [*both, Fix.position(20.0, position_std_m=0.1)])
    assert_agrees(path, EVERYTHING, [Fix.bearing(s, anchor=(6.0, 15.0), bearing_std=0.03) for s in places])


def test_it_is_said_where_a_lone_radio_may_be_taken_for_its_mirror_image():
    noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    path, lone = [(0, 0), (60, 0)], [Fix.range(s, anchor=(40.0, 2.0), range_std_m=0.05) for s in range(34, 47, 2)]
    drift = predict_drift(path, noise, fixes=lone, estimator="filter")
    errors = simulate_drift(path, noise, fixes=lone, estimator="filter", runs=4000, rng=0)
    assert np.sqrt((errors[:, -1] ** 2).sum(axis=-1).mean()) > 2 * drift.end.rms
    np.testing.assert_allclose(drift.beyond_linear[-1, 1], 60.0)
    helped = [*lone, *(Fix.position(s, position_std_m=0.1) for s in (10.0, 20.0, 28.0))]
    assert not len(predict_drift(path, noise, fixes=helped, estimator="filter").beyond_linear)
    assert_agrees(path, noise, helped)


@pytest.mark.parametrize(
    "fix", [Fix.range(5.0, anchor=(5.0, 2.0), range_std_m=0.0), Fix.bearing(5.0, anchor=(5.0, 2.0), bearing_std=0.0)]
)
def test_perfect_ranges_and_bearings_are_misused_unless_the_robot_is_not_lost(fix):
    path = [(0, 0), (10, 0)]
    lost = predict_drift(path, EVERYTHING, fixes=[fix], estimator="filter")
    np.testing.assert_allclose(lost.beyond_linear, [[5.0, 10.0]])
    assert not len(predict_drift(path, OdometryNoise(), fixes=[fix], estimator="filter").beyond_linear)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
def test_where_nothing_is_said_radios_alone_are_predicted_to_six_per_cent(seed):
    """And four standard errors, on random paths past one to four radios."""
    rng = np.random.default_rng(seed)
    noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    path = np.cumsum(rng.uniform(-20, 20, (rng.integers(3, 6), 2)), axis=0)
    radio = BeaconKind.range_only(range_m=8.0, range_std_m=float(rng.choice([0.05, 0.1, 0.3])))
    legs = rng.integers(len(path) - 1, size=rng.integers(1, 5))
    beside = (
        path[legs] + rng.random((len(legs), 1)) * (path[legs + 1] - path[legs]) + rng.uniform(-4, 4, (len(legs), 2))
    )
    beacons = [Beacon(radio, *place) for place in beside]
    drift = drift_with_beacons(path, noise, beacons, estimator="filter")
    fixes = beacon_fixes(path, beacons)
    square = (simulate_drift(path, noise, fixes=fixes, estimator="filter", runs=1500, rng=seed)[:, 1:] ** 2).sum(
        axis=-1
    )
    trusted = drift.distance[1:] <= min(drift.beyond_linear[:, 0], default=np.inf)
    spare = 4 * square.std(axis=0) / 1500**0.5
    assert (square.mean(axis=0) <= 1.06**2 * drift.rms[1:] ** 2 + spare)[trusted].all()


def test_an_uncertain_start():
    path = [(0, 0), (12, 0), (12, 8)]
    start = Fix.full(0.0, position_std_m=0.2, heading_std=0.04)
    assert_agrees(path, EVERYTHING, [start, Fix.position(6.0, position_std_m=0.1)])


def test_ranges_read_at_the_start_are_fused_with_what_is_known_of_it():
    ranges = [
        Fix.range(0.0, anchor=(3.0, 4.0), range_std_m=0.05),
        Fix.bearing(0.0, anchor=(5.0, 1.0), bearing_std=0.01),
    ]
    start = Fix.full(0.0, position_std_m=0.4, heading_std=0.05)
    path = [(0, 0), (10, 0)]
    assert_agrees(path, EVERYTHING, [*ranges, start])
    assert predicted_rms(path, EVERYTHING, [start, *ranges])[-1] < 0.9 * predicted_rms(path, EVERYTHING, [start])[-1]
    np.testing.assert_allclose(predicted_rms(path, EVERYTHING, ranges), predicted_rms(path, EVERYTHING, []), rtol=1e-9)


def test_in_the_step_model():
    noise = OdometryNoise.per_step(heading_std=0.01, distance_std=0.03, step_m=0.5, heading_distance_corr=-0.4)
    path = [(0, 0), (12, 0), (12, 8), (0, 8), (0, 0)]
    assert_agrees(path, noise, [Fix.position(s, position_std_m=0.05) for s in (12.0, 20.0, 32.0)])


@pytest.mark.slow
def test_constants_are_estimated_on_the_way():
    noise = replace(EVERYTHING, heading_bias_std_per_m=0.003, heading_bias_std_per_rad=0.01, distance_scale_std=0.02)
    path = [(0, 0), (12, 0), (12, 8), (0, 8), (0, 0), (12, 0), (12, 8)]
    fixes = [Fix.position(s, position_std_m=0.05) for s in np.arange(4.0, 60.0, 6.0)]
    assert_agrees(path, noise, fixes)
    unlearnt = np.sqrt((simulate_drift(path, noise, fixes=fixes, runs=2000) ** 2).sum(-1).mean(0))
    learnt, _ = simulated_rms(path, noise, fixes)
    assert learnt[-1] < 0.7 * unlearnt[-1]


def test_known_systematic_errors_are_not_corrected_by_a_filter_that_does_not_know_them():
    noise = replace(EVERYTHING, heading_bias_per_m=0.002, heading_bias_per_rad=0.005, distance_scale_error=0.01)
    path = [(0, 0), (12, 0), (12, 8), (0, 8)]
    fixes = [Fix.position(s, position_std_m=0.05) for s in (6.0, 12.0, 20.0, 28.0)]
    assert_agrees(path, noise, fixes)


def test_missed_readings_are_bounded():
    path = [(0, 0), (12, 0), (12, 8), (0, 8), (0, 0)]
    fixes = [Fix.position(s, position_std_m=0.05, detection_probability=0.7) for s in np.arange(3.0, 40.0, 6.0)]
    expected = predicted_rms(path, EVERYTHING, fixes)
    rms, error = simulated_rms(path, EVERYTHING, fixes)
    assert (rms <= expected + 4 * error).all()
    assert (rms >= 0.85 * expected - 4 * error).all()


def test_a_filter_is_not_worse_than_resets_and_perfect_fixes_are_perfect():
    path = [(0, 0), (12, 0), (12, 8), (0, 8)]
    fixes = [Fix.position(s, position_std_m=0.0) for s in (6.0, 12.0, 20.0)]
    filtered, _ = simulated_rms(path, EVERYTHING, fixes)
    resets = np.sqrt((simulate_drift(path, EVERYTHING, fixes=fixes, runs=DRIVES) ** 2).sum(-1).mean(0))
    np.testing.assert_allclose(filtered[1:3], 0, atol=1e-9)
    assert filtered[3] < 0.9 * resets[3]


def test_a_range_cannot_replace_anything():
    with pytest.raises(ValueError, match="estimator='filter'"):
        simulate_drift([(0, 0), (9, 0)], EVERYTHING, fixes=[Fix.range(5.0, anchor=(1.0, 1.0), range_std_m=0.1)])


def test_unknown_estimators_are_refused():
    with pytest.raises(ValueError, match="reset"):
        simulate_drift([(0, 0), (1, 0)], EVERYTHING, estimator="kalman")
