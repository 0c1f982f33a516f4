"""fit_noise on robots that really drove: fitted on some drives, checked on others.

What fails here is asserted too, so that it stays known: the errors of the mower come in bursts, those of the
visual-inertial odometry are bounded, and robots of one type differ in their systematic errors.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from driftplan.model.calibration.fit import fit_noise
from driftplan.model.drift import predict_drift
from driftplan.model.readings import Fix
from driftplan.world.odometry_logs import read_odometry, read_truth

DATA = Path(__file__).resolve().parents[2] / "../shared/data"
PLAZA = DATA / "plaza1/Plaza1_.mat"
FIGURE_LENGTHS = 8  # segment lengths at which predicted and measured rms are compared

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the recorded drives are not here")


def ratios(check):
    """Measured over predicted rms, by length."""
    return np.array([row.measured_rms_m / row.predicted_rms_m for row in check.lengths])


def shares(check, level):
    return np.array([row.coverage[level] for row in check.lengths])


@pytest.fixture(scope="module")
def mower():
    if not PLAZA.is_file():
        pytest.skip("the recorded drives are not here")
    odometry = read_odometry(PLAZA, kind="increments", variable="DR")
    truth = read_truth(PLAZA, variable="GT")
    middle = float(odometry.times[len(odometry.times) // 2])
    first, second = odometry.between(odometry.times[0], middle), odometry.between(middle, odometry.times[-1])
    return first, second, truth, fit_noise(first, truth)


@pytest.mark.slow
def test_the_first_half_of_a_mowers_drive_predicts_the_second(mower):
    _, second, truth, fit = mower
    check = fit.check_on(second, truth, lengths_m=np.geomspace(4, 100, FIGURE_LENGTHS))
    assert len(check.lengths) == FIGURE_LENGTHS
    # From 4 to 100 m the rms grows fivefold; up to 40 m the measured one is 0.69 to 0.87 of the predicted one,
    # beyond, where ten segments have to do, above a half: the second half has fewer slips, and the prediction allows
    # for drives that differ. Nothing falls outside the 95 % region more often than it should.
    assert ratios(check)[:6].min() > 0.65
    assert ratios(check).min() > 0.45
    assert ratios(check).max() < 1.1
    assert check.lengths[0].predicted_rms_interval_m[0] > 0
    assert shares(check, 2).min() > 0.9
    # its gyro turns so little astray that two degrees in 50 m are ruled out; its truth heading is that gyro's own
    assert not fit.check.has_heading
    assert fit.intervals["heading_var_per_m"][1] < 2e-4
    assert any("not Gaussian" in note for note in fit.notes)


@pytest.mark.slow
def test_a_mowers_drift_with_and_without_beacons_is_as_predicted(mower):
    """The second half, 975 m, with odometry alone and with a position fix from the four beacons' ranges every 150 m."""
    first, second, truth, fit = mower
    from scipy.io import loadmat

    recorded = loadmat(PLAZA, variable_names=["TL", "TD"])
    beacons = {int(name): x + 1j * y for name, x, y in recorded["TL"]}
    at, who, ranges = recorded["TD"][:, 0], recorded["TD"][:, 2].astype(int), recorded["TD"][:, 3]
    sites = np.array([beacons[k] for k in who])
    where = np.interp(at, truth.times, truth.xy[:, 0]) + 1j * np.interp(at, truth.times, truth.xy[:, 1])
    early = at < second.times[0]
    surplus = ranges - np.abs(sites - where)
    offset = {k: surplus[early & (who == k)].mean() for k in beacons}
    ranges = ranges - np.array([offset[k] for k in who])

    def reckoned(log):
        """Dead-reckoned and true positions, aligned at the start by the first 30 m."""
        true = np.interp(log.times, truth.times, truth.xy[:, 0]) + 1j * np.interp(
            log.times, truth.times, truth.xy[:, 1]
        )
        k = int(np.searchsorted(log.travelled, 30.0))
        turn = (true[k] - true[0]) / log.positions[k]
        return true[0] + log.positions * turn / abs(turn), true

    def fixed(log, estimate, index):
        """Position from the ranges of the last 20 s, carried along by the odometry."""
        now = log.times[index]
        heard = (at > now - 20) & (at <= now)
        past = np.interp(at[heard], log.times, estimate.real) + 1j * np.interp(at[heard], log.times, estimate.imag)
        behind = past - estimate[index]

        def misfit(xy):
            return np.abs(complex(*xy) + behind - sites[heard]) - ranges[heard]

        found = least_squares(misfit, [estimate[index].real, estimate[index].imag], loss="soft_l1")
        return complex(*found.x)

    estimate, true = reckoned(first)
    tried = np.searchsorted(first.travelled, np.arange(40, first.travelled[-1] - 5, 10))
    fix_std = np.sqrt(np.mean([abs(fixed(first, estimate, k) - true[k]) ** 2 for k in tried]) / 2)
    assert 0.3 < fix_std < 1.5  # metres per axis, from ranges that err by one

    estimate, true = reckoned(second)
    places = np.arange(150, second.travelled[-1], 150)
    with_fixes = estimate.copy()
    for index in np.searchsorted(second.travelled, places):
        with_fixes[index:] += fixed(second, estimate, index) - with_fixes[index]

    path = np.column_stack([true.real, true.imag])[::5]
    drive = np.abs(np.diff(path[:, 0] + 1j * path[:, 1])).sum() / second.travelled[-1]
    s = np.linspace(20, second.travelled[-1] - 1, 300)
    for measured, fixes in (
        (estimate, []),
        (with_fixes, [Fix.position(p * drive, position_std_m=fix_std) for p in places]),
    ):
        drift = predict_drift(path, fit.noise, fixes=fixes).at(s * drive)
        error = np.interp(s, second.travelled, np.abs(measured - true))
        # one drive is one sample of a random walk: its rms along the way is within a factor of two of the expected one
        # with probability above 0.9 (measured: 0.81 without fixes, 0.90 with them)
        ratio = np.sqrt(np.mean(error**2) / np.mean(drift.rms**2))
        assert 0.5 < ratio < 1.5
        assert np.mean(error < drift.radius(0.95)) > 0.9
    assert np.mean(np.abs(with_fixes - true)[len(true) // 2 :]) < 0.8 * np.mean(
        np.abs(estimate - true)[len(true) // 2 :]
    )


def robots():
    return {
        k: (
            read_odometry(DATA / f"mrclam7/Robot{k}_Odometry.dat.gz"),
            read_truth(DATA / f"mrclam7/Robot{k}_Groundtruth.dat.gz"),
        )
        for k in (1, 2, 3)
    }


@needs_data
@pytest.mark.slow
def test_two_robots_predict_the_third():
    drives = robots()
    lengths = np.geomspace(0.4, 10, FIGURE_LENGTHS)
    checks = {}
    for held in drives:
        fitted = [drives[k] for k in drives if k != held]
        fit = fit_noise(*zip(*fitted, strict=True))
        checks[held] = fit.check_on(*drives[held], lengths_m=lengths)
        # odometry of commanded speeds leads the truth by the time it takes to reach them
        assert all(0.1 < offset < 0.3 for offset in fit.time_offsets_s)
        assert ratios(fit.check).min() > 0.75
        assert ratios(fit.check).max() < 1.4
    # up to 3 m all three are predicted within 30 %; beyond, robots 1 and 3 drift more than the other two, robot 2 less
    # (measured: up to 1.7, 1.45, and down to 0.61), by no more than two drives of 50 m leave open
    for check in checks.values():
        short = [row.length_m < 3 for row in check.lengths]
        assert np.abs(ratios(check)[short] - 1).max() < 0.33
        assert shares(check, 2)[short].min() > 0.8
        assert check.notes == ()
        for row in check.lengths:
            low, high = row.predicted_rms_interval_m
            assert low - 2 * row.measured_rms_error_m < row.measured_rms_m < high + 2 * row.measured_rms_error_m


@needs_data
@pytest.mark.slow
def test_regions_hold_the_drives_of_other_robots_as_often_as_they_say():
    drives = robots()
    held = {1: [], 2: []}  # share inside the 90 % regions, by how many robots were fitted
    for checked in drives:
        others = [k for k in drives if k != checked]
        for fitted in (*([k] for k in others), others):
            fit = fit_noise(*zip(*(drives[k] for k in fitted), strict=True))
            held[len(fitted)].append(shares(fit.check_on(*drives[checked]), 1).mean())
    assert 0.87 < np.mean(held[1]) < 0.93  # measured: 0.885, from 0.80 to 0.97 by pair
    assert 0.87 < np.mean(held[2]) < 0.93  # measured: 0.916, from 0.89 to 0.93


@needs_data
@pytest.mark.slow
def test_three_flights_predict_three_others_as_far_as_a_random_walk_can():
    truth = read_truth(DATA / "euroc_v1_02/stamped_groundtruth.txt.gz")
    flights = [(read_odometry(DATA / f"euroc_v1_02/stamped_traj_estimate{k}.txt.gz"), truth) for k in range(6)]
    fit = fit_noise(*zip(*flights[:3], strict=True))
    check = fit.check_on(*zip(*flights[3:], strict=True), lengths_m=np.geomspace(0.5, 15, FIGURE_LENGTHS))
    # the truth's headings are those of another axis than the estimate's: two degrees, the same in all flights
    assert np.degrees(fit.heading_offsets) == pytest.approx([-2.0] * 3, abs=0.3)
    assert np.abs(ratios(fit.check) - 1).max() < 0.2
    # the three flights that are predicted erred less than one of those fitted, at all lengths (measured: 0.58 to 0.81)
    assert ratios(check).min() > 0.5
    assert ratios(check).max() < 1.0
    assert shares(check, 2).min() > 0.88
    # its errors hardly grow beyond 4 m, those of a random walk would by the square root of 4
    rms = np.array([row.measured_rms_m for row in check.lengths])
    assert rms[-1] < 1.2 * rms[-4]
