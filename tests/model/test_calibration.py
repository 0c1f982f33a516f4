"""fit_noise on simulated drives: it finds the noise it was given, and says so when it cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model.calibration.fit import PARAMETERS, estimated, fit_noise
from driftplan.model.calibration.noise_check import (
    CLEAR_CHANCE,
    HEAVY_TAILS_CHANCE,
    check_noise,
    check_segments,
    growth_note,
    repetitions,
)
from driftplan.model.calibration.quasi_likelihood import bootstrap, bounded_step, equations, models, solve
from driftplan.model.calibration.recordings import OdometryLog, Trajectory, simulate_log
from driftplan.model.calibration.segment_sets import drives_of, segment_set
from driftplan.model.calibration.segments import TruthNoise
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Run

NOISE = OdometryNoise(
    heading_var_per_m=1e-3,
    heading_var_per_rad=2e-3,
    distance_var_per_m=4e-4,
    heading_bias_per_m=2e-3,
    heading_bias_per_rad=0.02,
    distance_scale_error=0.01,
)
FITTED = tuple(name for name in PARAMETERS if getattr(NOISE, name) != 0)
QUICK = {"parameters": FITTED, "lengths_m": [2, 4, 8], "resamples": 100, "time_offset_s": 0.0}


def winding(length_m, seed=0):
    """Arcs of 1 to 3 m, bent either way or straight, and a turn on the spot now and then."""
    rng = np.random.default_rng(seed)
    path, driven = [], 0.0
    while driven < length_m:
        run = Run(
            length_m=rng.uniform(1, 3),
            curvature_per_m=rng.choice([0.0, 0.0, 1.0]) * rng.uniform(-0.8, 0.8),
            turn_rad=rng.choice([0, 0, 0, 1]) * rng.uniform(-2, 2),
        )
        path.append(run)
        driven += run.length_m
    return path


def recorded(noise=NOISE, length_m=300.0, seed=0, **options):
    return simulate_log(winding(length_m, seed), noise, rng=seed, truth_position_std_m=0.004, **options)


@pytest.fixture(scope="module")
def fit():
    return fit_noise(*recorded(length_m=1500), parameters=FITTED, lengths_m=[2, 4, 8, 16])


def test_the_noise_that_made_a_drive_is_found_in_it(fit):
    for name in FITTED:
        # four standard errors: one parameter in 16 000 would be farther off
        assert getattr(fit.noise, name) == pytest.approx(getattr(NOISE, name), abs=4 * fit.std_errors[name]), name
        low, high = fit.intervals[name]
        assert low <= getattr(fit.noise, name) <= high
    assert fit.std_errors["heading_bias_per_rad"] < 0.005  # and the errors are worth something
    assert fit.std_errors["heading_var_per_rad"] < 5e-4
    assert fit.truth_position_std_m == pytest.approx(0.004, abs=0.004)


def test_a_right_model_is_said_to_fit(fit):
    assert fit.check.fits
    assert fit.notes == ()
    for row in fit.check.lengths:
        assert row.measured_rms_m == pytest.approx(row.predicted_rms_m, rel=0.3)
        for share, level, error in zip(row.coverage, (0.5, 0.9, 0.95), row.coverage_error, strict=True):
            assert share == pytest.approx(level, abs=4 * error)
    drive = recorded(length_m=800, seed=5)
    assert fit.check_on(*drive).fits
    assert check_noise(NOISE, *drive, truth_position_std_m=0.004).fits


def test_a_wrong_model_is_said_not_to_fit(fit):
    drive = recorded(length_m=800, seed=5)
    assert any("The random-walk model does not fit" in note for note in check_noise(NOISE.scaled(0.5), *drive).notes)
    timid = check_noise(replace(NOISE.scaled(0.6), distance_scale_error=0.01), *drive, truth_position_std_m=0.004)
    assert any("The regions are too small" in note for note in timid.notes)


@pytest.mark.slow
def test_each_drive_is_predicted_from_the_others():
    drives = [recorded(seed=k, length_m=300) for k in (1, 2)]
    odd = recorded(replace(NOISE, distance_scale_error=0.2), seed=3, length_m=300)
    few = ("distance_scale_error", "heading_var_per_m", "distance_var_per_m")
    options = {"parameters": few, "lengths_m": [2, 4, 8], "time_offset_s": 0.0, "resamples": 100}
    alike = fit_noise(*zip(*drives, recorded(seed=3, length_m=300), strict=True), **options)
    for row in alike.held_out.lengths:
        assert row.coverage[2] == pytest.approx(0.95, abs=4 * row.coverage_error[2])
    mixed = fit_noise(*zip(*drives, odd, strict=True), **options)
    two = fit_noise(*zip(*drives, strict=True), **options)
    given = {"lengths_m": [2, 4, 8], "time_offset_s": 0.0, "truth_position_std_m": two.truth_position_std_m}
    without = check_noise(two.noise.on_drive((0, 0, 0)), *odd, truth_heading_std=two.truth_heading_std, **given)
    # the odd drive, a third of all, is predicted as badly as by a fit of the other two
    for whole, row, other in zip(mixed.check.lengths, mixed.held_out.lengths, without.lengths, strict=True):
        assert other.mean_nees > 20 * whole.mean_nees
        assert row.mean_nees == pytest.approx(other.mean_nees / 3, rel=0.3)
    assert "each drive predicted from the others" in str(mixed)


@pytest.mark.slow
def test_what_a_fit_does_not_know_is_allowed_for_when_it_is_checked_elsewhere():
    drive, other = recorded(length_m=150, seed=3), recorded(length_m=800, seed=4)
    options = {"parameters": FITTED, "lengths_m": [2, 4, 8], "time_offset_s": 0.0}
    fit = fit_noise(*drive, **options)
    check = fit.check_on(*other, lengths_m=[2, 4, 8], time_offset_s=0.0)
    given = check_noise(fit.noise, *other, lengths_m=[2, 4, 8], time_offset_s=0.0)
    exact = check_noise(NOISE, *other, lengths_m=[2, 4, 8], time_offset_s=0.0, truth_position_std_m=0.004)
    for row, same, true in zip(check.lengths, given.lengths, exact.lengths, strict=True):
        low, high = row.predicted_rms_interval_m
        assert low < row.predicted_rms_m < high
        assert low < true.predicted_rms_m < high  # 95 % intervals, one seed
        assert same.predicted_rms_interval_m == (same.predicted_rms_m, same.predicted_rms_m)
    assert check.fits


def test_a_wandering_bias_is_said_to_be_no_random_walk():
    """A gyro whose bias wanders over 30 m: heading errors of neighbouring resampled are alike."""
    log, truth = recorded(OdometryNoise(heading_var_per_m=1e-5, distance_var_per_m=1e-4), length_m=1500, seed=3)
    rng = np.random.default_rng(0)
    moved = np.abs(log.moves)
    keep = np.exp(-moved / 30.0)
    bias, turns = 0.0, []
    for k, shock in zip(keep, rng.standard_normal(len(keep)), strict=True):
        bias = k * bias + 0.02 * np.sqrt(1 - k * k) * shock
        turns.append(bias)
    fit = fit_noise(
        OdometryLog(log.times, log.moves, log.turns + turns * moved),
        truth,
        time_offset_s=0.0,
        parameters=FITTED[:4],
        lengths_m=[4, 8, 16, 32],
    )
    assert any("errors grow faster with length than a random walk's" in note for note in fit.notes), fit


def test_positions_alone_are_enough():
    log, truth = recorded(length_m=600, seed=2)
    fit = fit_noise(log, truth.without_heading(), parameters=FITTED, lengths_m=[4, 8, 16], resamples=100)
    for name in FITTED:
        assert getattr(fit.noise, name) == pytest.approx(getattr(NOISE, name), abs=4 * fit.std_errors[name]), name
    assert not fit.check.has_heading
    assert np.isnan(fit.check.lengths[0].measured_heading_rms)
    assert " deg" not in str(fit)


def test_headings_that_only_repeat_the_odometry_are_not_taken_for_a_measurement():
    log, truth = recorded(length_m=100)
    copied = Trajectory(truth.times, truth.xy, log.headings + 0.7)
    few = {"parameters": FITTED[:3], "lengths_m": [4, 8], "resamples": 100}
    fit = fit_noise(log, copied, **few)
    assert not fit.check.has_heading
    assert fit_noise(log, truth.without_heading(), **few).noise == fit.noise


def test_a_reference_mounted_askew_changes_no_rate():
    log, truth = recorded(length_m=300)
    askew = Trajectory(truth.times, truth.xy, truth.heading + 0.3)
    plain, found = fit_noise(log, truth, **QUICK), fit_noise(log, askew, **QUICK)
    for name in FITTED:
        assert getattr(found.noise, name) == pytest.approx(getattr(plain.noise, name), abs=0.2 * plain.std_errors[name])
    assert found.heading_offsets == pytest.approx((0.3,), abs=0.01)
    assert "mounted askew, and was turned back: +17." in str(found)
    assert plain.heading_offsets == (0.0,)
    assert "askew" not in str(plain)


def test_frames_and_clocks_do_not_matter():
    turn, x, late = -2.2, 731.0, 3e4
    log, truth = recorded(length_m=150)
    here = fit_noise(log, truth, **QUICK)
    z = truth.positions * np.exp(1j * turn) + x
    moved = Trajectory(truth.times + late, np.column_stack([z.real, z.imag]), truth.heading + turn)
    there = fit_noise(OdometryLog(log.times + late, log.moves, log.turns), moved, **QUICK)
    for name in FITTED:
        assert getattr(there.noise, name) == pytest.approx(
            getattr(here.noise, name), rel=1e-3, abs=1e-3 * here.std_errors[name]
        )


def test_scaling_the_world_scales_the_rates():
    log, truth = recorded(length_m=200)
    few = {"parameters": FITTED, "resamples": 100}
    fit = fit_noise(log, truth, lengths_m=[2, 4, 8], **few)
    big = fit_noise(
        OdometryLog(log.times, 10 * log.moves, log.turns),
        Trajectory(truth.times, 10 * truth.xy, truth.heading),
        lengths_m=[20, 40, 80],
        **few,
    )
    powers = {"heading_var_per_m": -1, "distance_var_per_m": 1, "heading_bias_per_m": -1}
    for name in FITTED:
        expected = getattr(fit.noise, name) * 10.0 ** powers.get(name, 0)
        assert getattr(big.noise, name) == pytest.approx(expected, rel=1e-3, abs=1e-9)


def test_a_straight_drive_teaches_nothing_about_turning():
    log, truth = simulate_log([(0, 0), (400, 0)], OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-3))
    fit = fit_noise(log, truth, resamples=100)
    assert any("hardly turned" in note for note in fit.notes)
    assert "heading_var_per_rad" not in fit.intervals
    low, high = fit.intervals["heading_var_per_m"]
    assert low < 1e-4 < high


def test_even_turning_cannot_be_told_from_driving():
    circle = [Run(length_m=200.0, curvature_per_m=0.3)]
    log, truth = simulate_log(circle, OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3))
    fit = fit_noise(log, truth, resamples=100)
    assert any("These drives turn evenly: heading_bias_per_rad" in note for note in fit.notes)
    assert fit.noise.heading_bias_per_rad == 0
    low, high = fit.intervals["heading_var_per_m"]
    assert low < 1e-3 < high


def test_drives_of_different_robots_are_told_apart():
    same = [recorded(seed=1, length_m=300), recorded(seed=2, length_m=300)]
    other = recorded(replace(NOISE, distance_scale_error=-0.05), seed=2, length_m=300)
    assert not any("drives differ" in n for n in fit_noise(*zip(*same, strict=True), **QUICK).notes)
    mixed = fit_noise(*zip(same[0], other, strict=True), **QUICK)
    assert any("The drives differ: distance_scale_error varies by 0.04" in note for note in mixed.notes)


@pytest.mark.slow
def test_the_spread_between_drives_is_told_from_that_within(fit):
    spread = {"distance_scale_error": 0.03, "heading_bias_per_m": 0.02}
    rng = np.random.default_rng(1)
    few = (*spread, "heading_var_per_m", "distance_var_per_m")
    base = OdometryNoise(heading_var_per_m=5e-4, distance_var_per_m=4e-4)

    def day(seed, size):
        own = {name: float(size * std * rng.standard_normal()) for name, std in spread.items()}
        return recorded(replace(base, **own), length_m=150, seed=seed, step_m=0.2)

    options = {"parameters": few, "lengths_m": [4, 8], "time_offset_s": 0.0, "resamples": 100}
    varied = fit_noise(*zip(*(day(k, 1.0) for k in range(8)), strict=True), **options)
    alike = fit_noise(*zip(*(day(k, 0.0) for k in range(8)), strict=True), **options)
    # a standard deviation from eight drives is known to 1/4; three of these
    assert 0.25 * 0.03 < varied.noise.distance_scale_std < 1.75 * 0.03
    assert 0.25 * 0.02 < varied.noise.heading_bias_std_per_m < 1.75 * 0.02
    assert alike.noise.distance_scale_std < 0.3 * varied.noise.distance_scale_std
    assert alike.noise.heading_bias_std_per_m < 0.5 * varied.noise.heading_bias_std_per_m
    # on other days the regions hold; those of the same fit without the spread do not
    hold = {"with": [], "without": []}
    constant = varied.noise.on_drive((0, 0, 0))
    for k in range(10, 18):
        drive = day(k, 1.0)
        given = {"lengths_m": [8], "time_offset_s": 0.0, "truth_position_std_m": 0.004}
        hold["with"].append(varied.check_on(*drive, lengths_m=[8], time_offset_s=0.0).lengths[0].coverage[1])
        hold["without"].append(check_noise(constant, *drive, **given).lengths[0].coverage[1])
    # each day is nearly one draw, all of its segments astray alike: a standard error of 0.1 for eight of them
    assert np.mean(hold["with"]) > 0.9 - 3 * 0.1
    assert np.mean(hold["without"]) < np.mean(hold["with"]) - 0.05


def test_one_drive_leaves_the_spread_between_drives_to_a_stated_guess(fit):
    for name, std in fit.between_drives.items():
        error = fit.std_errors[name.replace("bias_std", "bias").replace("scale_std", "scale_error")]
        assert std == pytest.approx(np.sqrt(2) * error)
        assert getattr(fit.noise, name) == std
    assert "a guess after one drive" in str(fit)


def test_slips_are_said_to_be_no_random_walk():
    calm = OdometryNoise(heading_var_per_m=1e-5, distance_var_per_m=1e-5)
    log, truth = recorded(calm, length_m=600, seed=3)
    moves = log.moves.copy()
    moves[np.random.default_rng(0).choice(len(moves), 12)] += 0.8
    fit = fit_noise(OdometryLog(log.times, moves, log.turns), truth, **QUICK)
    assert any("not Gaussian" in note for note in fit.notes)


def test_errors_that_do_not_add_up_are_said_to_be_no_random_walk():
    rng = np.random.default_rng(0)
    calm = OdometryNoise(distance_var_per_m=1e-6)
    log, truth = recorded(calm, length_m=600, seed=3)
    wobble = np.convolve(rng.standard_normal(len(truth.times) + 200), np.ones(201) / 15, "valid")  # over 20 m
    xy = truth.xy + 0.2 * np.column_stack([wobble, np.roll(wobble, 500)])
    fit = fit_noise(log, Trajectory(truth.times, xy, truth.heading), time_offset_s=0.0, lengths_m=[5, 10, 20, 40, 80])
    assert any("errors grow slower with length" in note for note in fit.notes)


@pytest.mark.parametrize("heading", [True, False])
def test_a_truth_that_has_nothing_to_do_with_the_odometry_is_said_to_be_none(heading):
    log, _ = recorded(length_m=40)
    rng = np.random.default_rng(0)
    n = len(log.times)
    random = Trajectory(log.times, 100 * rng.standard_normal((n, 2)), rng.standard_normal(n) if heading else None)
    fit = fit_noise(log, random, parameters=FITTED[-3:], lengths_m=[2, 4, 8], resamples=100)
    assert any("are odometry and truth of the same drive?" in note for note in fit.faults)
    assert np.isfinite([row.predicted_rms_m for row in fit.check.lengths]).all()


def test_a_reference_too_coarse_to_see_the_drift_is_said_to_be_so():
    log, truth = simulate_log(winding(60), OdometryNoise(heading_var_per_m=1e-5), truth_position_std_m=0.2)
    options = {"parameters": FITTED[-3:], "lengths_m": [2, 4, 8], "resamples": 100}
    coarse = fit_noise(log, truth.without_heading(), **options)
    assert any("most of the error does not grow with the distance" in note for note in coarse.notes)


def test_odometry_that_drives_the_wrong_way_is_said_not_to_fit():
    log, truth = recorded(length_m=80)
    fit = fit_noise(OdometryLog(log.times, -log.moves, log.turns), truth, parameters=FITTED, resamples=100)
    assert fit.noise.distance_scale_error > -1
    assert any("turned by 180 deg against the direction in which the odometry drives" in n for n in fit.notes)


def test_plain_arrays_of_poses_will_do():
    log, truth = recorded(length_m=80)
    poses = np.column_stack([log.positions.real, log.positions.imag, log.headings])
    truths = np.column_stack([truth.xy, truth.heading])
    from_arrays = fit_noise(poses, truths, **QUICK)
    from_lists = fit_noise([poses.tolist()], [truths.tolist()], **QUICK)
    assert from_arrays.noise == from_lists.noise
    index = np.arange(len(poses))
    from_logs = fit_noise(
        OdometryLog(1.0 * index, log.moves, log.turns), Trajectory(1.0 * index, truth.xy, truth.heading), **QUICK
    )
    for name in FITTED:
        assert getattr(from_arrays.noise, name) == pytest.approx(getattr(from_logs.noise, name), rel=1e-6, abs=1e-12)


def test_the_same_seed_gives_the_same_intervals():
    drive = recorded(length_m=80)
    first, second, other = (fit_noise(*drive, seed=seed, **QUICK).intervals for seed in (1, 1, 2))
    assert first == second
    assert first != other


def test_more_confidence_asks_for_wider_intervals():
    drive = recorded(length_m=100)
    narrow, wide = (fit_noise(*drive, confidence=c, **QUICK).intervals for c in (0.5, 0.99))
    for name in FITTED:
        assert wide[name][0] <= narrow[name][0] <= narrow[name][1] <= wide[name][1]
        assert wide[name] != narrow[name]


def test_a_variance_fitted_as_zero_still_has_an_upper_limit():
    fit = fit_noise(*recorded(length_m=200, seed=6))  # whose lateral and per-radian distance noise are zero
    at_zero = [name for name in fit.intervals if "var" in name and getattr(fit.noise, name) == 0]
    assert at_zero
    for name in at_zero:
        low, high = fit.intervals[name]
        assert low == 0
        assert 0.5 * fit.std_errors[name] < high < 6 * fit.std_errors[name], name
    predicted = np.array([row.predicted_rms_m for row in fit.check.lengths])
    low, high = np.transpose([row.predicted_rms_interval_m for row in fit.check.lengths])
    assert (low < predicted).all()
    assert (predicted < high).all()


def test_what_pushes_a_variance_below_zero_does_not_narrow_its_interval():
    segments, _ = segment_set([recorded(length_m=100)])
    solution = solve(segments, (*FITTED, "lateral_var_per_m"), 20)
    k = solution.names.index("lateral_var_per_m")
    theta, score = solution.theta.copy(), solution.score.copy()
    theta[k] = 0.0
    score[:, k] -= score[:, k].mean()
    pushed = score.copy()
    pushed[:, k] -= 10 * np.abs(score[:, k]).mean()
    found = [
        bootstrap(segments, solution._replace(theta=theta, score=s), 400, np.random.default_rng(0))[0][:, k]
        for s in (score, pushed)
    ]
    assert abs(found[0].mean()) < 0.2 * found[0].std()
    assert abs(found[1].mean()) < 0.2 * found[1].std()
    assert np.quantile(found[1], 0.975) > 0.8 * np.quantile(found[0], 0.975)


def test_what_is_printed_holds_what_was_found(fit):
    text = str(fit)
    for name in FITTED:
        assert f"{getattr(fit.noise, name):.4g}" in text
    assert "95 % interval" in text
    assert f"{fit.counts.used_m:.1f} m used (the odometry counted {fit.counts.driven_m:.1f} m" in text
    assert str(fit.held_out) in text
    assert str(fit.relative_errors) in text


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40)
def test_bounded_steps_meet_the_conditions_of_optimality(seed):
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 7))
    root = rng.standard_normal((k, 2 * k))
    information, score = root @ root.T, 3 * rng.standard_normal(k)
    lowest = np.where(rng.random(k) < 0.5, -rng.random(k), -np.inf)
    d = bounded_step(information, score, lowest)
    slope = information @ d - score
    scale = 1e-5 * (1 + np.abs(score))
    assert (d >= lowest - 1e-9).all()
    free = d > lowest + 1e-7
    assert (np.abs(slope[free]) < scale[free]).all()
    assert (slope[~free] > -scale[~free]).all()


def room(seed=0):
    """Straight runs and turns on the spot, as a vacuum cleaner drives: 30 places in a room of 6 m."""
    return np.random.default_rng(seed).uniform(0, 6, (30, 2))


TURNING = OdometryNoise(heading_var_per_rad=7e-3, distance_var_per_rad=4e-3, heading_var_per_m=1e-3)


@pytest.mark.parametrize("known_heading", [True, False])
def test_errors_of_turns_on_the_spot_lie_where_the_turn_sweeps(known_heading):
    """With the true noise, mean normalised squares are 1 at every length (0.1 drives of it: 31, 8.5, 2.7, 1.3, 1.0)."""
    found = []
    for seed in range(6):
        log, truth = simulate_log(room(), TURNING, rng=seed, truth_position_std_m=0.002)
        truth = truth if known_heading else truth.without_heading()
        check = check_noise(TURNING, log, truth, truth_position_std_m=0.002, time_offset_s=0.0)
        found.append([row.mean_nees for row in check.lengths])
    # 600 m with 180 turns; the 0.4 m segments alone are 1500 side by side
    assert np.mean(found, axis=0) == pytest.approx(np.ones(len(found[0])), abs=0.3)
    assert np.mean(found, axis=0)[:2] == pytest.approx(np.ones(2), abs=0.2)


def test_a_turn_on_the_spot_is_not_fitted_as_lateral_noise():
    drives = [simulate_log(room(k), TURNING, rng=k, truth_position_std_m=0.002) for k in range(3)]
    fit = fit_noise(*zip(*drives, strict=True), lengths_m=[1, 2, 4], resamples=100)
    assert fit.noise.distance_var_per_rad == pytest.approx(4e-3, abs=4 * fit.std_errors["distance_var_per_rad"])
    assert fit.noise.distance_var_per_rad > 3e-3
    assert fit.noise.lateral_var_per_m < 5e-4


EVERY_RATE = replace(TURNING, distance_var_per_m=1e-3, lateral_var_per_m=5e-4, distance_scale_error=0.01)
LOOPS = [Run(length_m=2.0, curvature_per_m=c, turn_rad=t) for c, t in ((1.5, 0), (-1.0, 0), (0, 1.5), (0, -2.5))]
PATHS = {
    "room": lambda seed: np.concatenate([room(seed), room(seed + 1000)]),
    "winding": lambda seed: winding(250, seed),
    "loops": lambda seed: 30 * LOOPS,
}


def share_held(drives, noise, names, **options):
    """How often 95 % intervals hold the truth, by parameter; what the drives cannot tell is not asked."""
    held = {name: [] for name in names}
    for seed, drive in enumerate(drives):
        found, _ = estimated(segment_set([drive], **options)[0], names, 0.95, 300, seed)
        for name, (low, high) in found.intervals.items():
            held[name].append(low <= getattr(noise, name) <= high)
    return {name: float(np.mean(some)) for name, some in held.items()}


@pytest.mark.slow
@pytest.mark.parametrize("path", PATHS)
def test_every_rate_is_recovered_within_its_interval(path):
    """Eight rates in 24 drives of each kind of path: binomially, 77 % of each are held at four standard errors."""
    repetitions = 24
    drives = (simulate_log(PATHS[path](k), EVERY_RATE, rng=k, truth_position_std_m=0.002) for k in range(repetitions))
    shares = share_held(drives, EVERY_RATE, PARAMETERS)
    assert min(shares.values()) > 0.95 - 4 * np.sqrt(0.95 * 0.05 / repetitions), shares
    # the rates of one drive go together by halves at most: as if there were four of them
    assert np.mean(list(shares.values())) > 0.95 - 4 * np.sqrt(0.95 * 0.05 / (4 * repetitions)), shares


def false_alarms(seeds):
    """How often drives that obey the model, with and without true headings, are said not to be Gaussian, and with the
    true noise not to be a random walk."""
    alarms = {"not Gaussian": 0, "random-walk model does not fit": 0}
    for seed in seeds:
        log, truth = simulate_log(room(seed), TURNING, rng=seed, truth_position_std_m=0.003)
        for seen in (truth, truth.without_heading()):
            segments, _ = segment_set([(log, seen)])
            solution = estimated(segments, PARAMETERS, 0.95, 100, seed)[0].solution
            fitted, true = models(solution.names, solution.theta), (TURNING, TruthNoise(0.003**2, 0.0))
            for words, noise_and_truth in zip(alarms, (fitted, true), strict=True):
                moments = segments.expected(segments.windows(noise_and_truth[0]), noise_and_truth[1])
                notes = check_segments(segments, moments, repetitions(segments, *noise_and_truth)).notes
                alarms[words] += any(words in note for note in notes)
    return alarms


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_stated():
    """5 % and 1 %: binomially, at most 5 and 2 of 24 at four standard errors (in a longer run: 14 and 2 of 200)."""
    repetitions = 12
    for rate, found in zip((HEAVY_TAILS_CHANCE, CLEAR_CHANCE), false_alarms(range(repetitions)).values(), strict=True):
        assert found < 2 * repetitions * rate + 4 * np.sqrt(2 * repetitions * rate * (1 - rate))


@pytest.mark.parametrize("up", [False, True])
def test_a_ratio_as_far_off_as_chance_makes_it_is_no_alarm(fit, up):
    """Chance is measured of logarithms: half of the prediction is as far off as twice of it, and so is judged alike."""
    error = 0.24
    row = fit.check.lengths[0]

    def note_at(shift):
        rms = row.predicted_rms_m * np.exp((shift if up else -shift) * error - error**2)
        rows = [row._replace(measured_rms_m=rms, measured_rms_error_m=error * rms)] * 2
        return growth_note(rows, 3.0)

    assert note_at(2.9) == ""
    assert "random-walk" in note_at(3.1)


@pytest.mark.parametrize(
    ("ratios", "said"),
    [
        ((1.0, 1.2, 0.8), "is within 35 % of the predicted one at 2, 4, 8 m; the 90 % regions hold"),
        ((1.1, 1.5, 0.5), "is within 35 % of the predicted one at 2 m and 1.50, 0.50 times it at 4, 8 m; the"),
        ((2.0, 3.0, 4.0), "is 2.00, 3.00, 4.00 times the predicted one at 2, 4, 8 m; the 90 % regions hold"),
    ],
)
def test_a_sentence_says_at_which_lengths_to_trust_a_fit(fit, ratios, said):
    rows = [
        row._replace(length_m=length, measured_rms_m=ratio * row.predicted_rms_m)
        for row, length, ratio in zip(fit.check.lengths, (2.0, 4.0, 8.0), ratios, strict=False)
    ]
    assert said in replace(fit.check, lengths=tuple(rows)).trust


@pytest.mark.slow
def test_slips_are_found_among_turns_on_the_spot():
    """A wheel that slips by 10 cm once in 10 m: seen in nearly every drive of 100 m, where a right model is not."""
    alarms = 0
    for seed in range(5):
        log, truth = simulate_log(room(), TURNING, rng=seed, truth_position_std_m=0.003)
        moves, driving = log.moves.copy(), np.flatnonzero(np.abs(log.moves) > 0.05)
        moves[np.random.default_rng(seed).choice(driving, 10)] += 0.3
        few = ("heading_var_per_rad", "distance_var_per_rad", "heading_var_per_m")
        fit = fit_noise(OdometryLog(log.times, moves, log.turns), truth, parameters=few, resamples=100)
        alarms += any("not Gaussian" in note for note in fit.notes)
    assert alarms >= 4


def test_a_robot_that_stands_between_two_cuts_is_fitted_all_the_same():
    """The truth is set anew while the robot stands, before the drive begins."""
    log, truth = recorded(length_m=100)
    wait = np.arange(0, 20, 0.1)
    times = np.concatenate([wait, 20 + log.times])
    still = np.zeros(len(wait))
    xy = np.concatenate([np.tile(truth.xy[0], (len(wait), 1)), truth.xy])
    xy[times < 10] += [3.0, 0.0]
    heading = np.concatenate([np.full(len(wait), truth.heading[0]), truth.heading])
    waiting = OdometryLog(times, np.concatenate([still, log.moves]), np.concatenate([still, log.turns]))
    fit = fit_noise(waiting, Trajectory(times, xy, heading), parameters=FITTED, resamples=100)
    assert fit.counts.breaks == 1
    low, high = fit.intervals["heading_var_per_m"]
    assert low < NOISE.heading_var_per_m < high


def test_a_log_from_one_room_is_cut_into_segments_of_the_room():
    times = np.arange(0, 8000, 0.1)
    turn = 0.02 * np.sin(times / 7) + 0.03
    log = OdometryLog.from_increments(np.full(len(times) - 1, 0.05), turn[:-1], times)
    rng = np.random.default_rng(0)
    xy = np.column_stack([log.positions.real, log.positions.imag]) + 0.002 * rng.standard_normal((len(times), 2))
    area = np.hypot(*np.ptp(xy, axis=0))
    segments, _ = segment_set([(log, Trajectory(times, xy, log.headings + 0.001 * rng.standard_normal(len(times))))])
    assert log.travelled[-1] / 16 > 4 * area  # what the longest would be otherwise
    assert segments.bins[-1].length_m <= 4.1 * area


def test_a_robot_that_only_comes_back_on_itself_is_told_what_to_do():
    t = np.arange(0, 2000, 0.1)
    z = 0.5 * np.exp(1j * t)
    log = OdometryLog.from_increments(np.full(len(t) - 1, 0.0502), np.full(len(t) - 1, 0.1), t)
    with pytest.raises(ValueError, match="a robot that comes back on itself before: give shorter lengths_m, or true"):
        fit_noise(log, Trajectory(t, np.column_stack([z.real, z.imag])), lengths_m=[4 * np.pi])


def test_odometry_as_its_own_truth_is_noticed():
    log, _ = recorded(length_m=100)
    truth = Trajectory(log.times, np.column_stack([log.positions.real, log.positions.imag]), log.headings)
    with pytest.raises(ValueError, match="no error at all: are odometry and truth the same file"):
        fit_noise(log, truth)


def test_a_fit_that_is_not_to_be_used_says_why(fit, monkeypatch):
    assert fit.faults == ()
    monkeypatch.setattr("driftplan.model.calibration.fit._MOST_STEPS", 1)
    monkeypatch.setattr("driftplan.model.calibration.fit._FIRST_LOOK", 1)
    hasty = fit_noise(*recorded(length_m=100), **QUICK)
    assert any("did not converge: its last step still moved" in fault for fault in hasty.faults)
    assert set(hasty.faults) <= set(hasty.notes)
    log, truth = recorded(length_m=100)
    for factor, words in ((3.6, "km/h or m/s"), (1e-3, "millimetres or metres"), (7.0, "check its units")):
        odd = fit_noise(OdometryLog(log.times, factor * log.moves, log.turns), truth, **{**QUICK, "lengths_m": None})
        assert any(f"times the true distance: {words}" in fault for fault in odd.faults), odd.faults


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("distances", "turns", "heading", "said"),
    [
        (1e-5, 1.0, True, r"truth of one drive, got odometry that counts [\d.]+e-0\d times the true distance"),
        (1e6, 1.0, True, r"truth of one drive, got odometry that counts [\d.]+e\+0\d times the true distance"),
        (0.1, 1e-4, False, ""),
        pytest.param(0.02, 1.5, True, "", marks=pytest.mark.slow),
        pytest.param(0.3, 1e2, False, "", marks=pytest.mark.slow),
        pytest.param(0.1, 3e3, True, "", marks=pytest.mark.slow),
    ],
)
def test_absurd_speeds_are_refused_in_plain_words_or_fitted_with_faults(distances, turns, heading, said):
    rng = np.random.default_rng(0)
    turned, moved = 0.1 * rng.standard_normal(300), 1 + 0.1 * rng.standard_normal(300)
    places = np.cumsum(moved * np.exp(1j * np.cumsum(turned)))
    times = np.arange(300.0)
    log = OdometryLog.from_velocities(times, distances * moved, turns * rng.standard_normal(300))
    truth = Trajectory(times, np.column_stack([places.real, places.imag]), np.cumsum(turned) if heading else None)
    if said:
        with pytest.raises(ValueError, match=said):
            fit_noise(log, truth, resamples=100)
        return
    assert fit_noise(log, truth, resamples=100).faults


def test_errors_that_no_noise_explains_are_refused_in_plain_words():
    segments, _ = segment_set(drives_of(*recorded(length_m=60)))
    n = len(segments.values)
    cov, none = np.tile(np.diag([1.0, 1.0, -1.0]), (n, 1, 1)), np.zeros((n, 1, 3))
    with pytest.raises(ValueError, match="expected errors that some noise explains, got odometry that counts"):
        equations(segments, np.zeros((n, 3)), cov, none, np.zeros((n, 1, 3, 3)))


def test_a_truth_that_begins_at_the_origin_where_odometry_does_not_is_noticed():
    log, truth = recorded(length_m=60)
    moved = Trajectory(truth.times, truth.xy - truth.xy[0], truth.heading)
    away = replace(log, start=2 + 1j)
    few = {"parameters": FITTED[-1:], "resamples": 100}
    assert any("are the two swapped?" in note for note in fit_noise(away, moved, **few).notes)
    assert not any("are the two swapped?" in note for note in fit_noise(log, moved, **few).notes)


def test_arguments_out_of_range_are_refused():
    log, truth = recorded(length_m=60)
    for wrong in (("wheel_slip",), (), "heading_var_per_m"):
        with pytest.raises(ValueError, match="expected parameters from"):
            fit_noise(log, truth, parameters=wrong)
    with pytest.raises(ValueError, match=r"expected confidence from 0\.01 to 0\.9999, got 95"):
        fit_noise(log, truth, confidence=95)
    with pytest.raises(ValueError, match="expected resamples a whole number >= 100, got 10"):
        fit_noise(log, truth, resamples=10)
    with pytest.raises(ValueError, match="expected lengths_m > 0"):
        fit_noise(log, truth, lengths_m=[0.0, 1.0])
    with pytest.raises(ValueError, match=r"longer than a segment of 500 m, got drives of at most 6"):
        fit_noise(log, truth, lengths_m=[500.0])
    with pytest.raises(ValueError, match="one truth per estimate, got 2 and 1"):
        fit_noise([log, log], truth)
    with pytest.raises(ValueError, match="got positions only"):
        fit_noise(log, truth.without_heading(), use_heading=True)
    with pytest.raises(ValueError, match=r"expected a Trajectory, or an array of shape \(\d+, 2 or 3\)"):
        fit_noise(log, np.zeros((5, 2)))
    with pytest.raises(ValueError, match="expected OdometryLog, an array or a sequence of these, got int"):
        fit_noise(7, truth)
    with pytest.raises(ValueError, match="at least as many segments as there are rates to fit, 8, got 1"):
        fit_noise([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 0), (1, 0), (2, 0.1)])
    with pytest.raises(ValueError, match="robot moves"):
        fit_noise(OdometryLog(log.times, 0 * log.moves, log.turns), truth)
    with pytest.raises(ValueError, match="expected a noise of the continuous model"):
        check_noise(OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.0), log, truth)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say_with_positions_alone():
    """Six rates of 24 drives: binomially, 77 % of each are held at four standard errors, and 87 to 100 % of all."""
    repetitions = 24
    drives = (recorded(length_m=400, seed=seed) for seed in range(repetitions))
    drives = ((log, truth.without_heading()) for log, truth in drives)
    shares = share_held(drives, NOISE, FITTED, lengths_m=[2, 4, 8, 16], time_offset_s=0.0)
    assert min(shares.values()) > 0.95 - 4 * np.sqrt(0.95 * 0.05 / repetitions), shares
    assert np.mean(list(shares.values())) > 0.95 - 4 * np.sqrt(0.95 * 0.05 / (4 * repetitions)), shares
