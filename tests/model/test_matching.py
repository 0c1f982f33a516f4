"""Odometry and truth of one drive, brought together: what happens to clocks, gaps, jumps, repeats and standstill."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model.calibration.matched_drive import match
from driftplan.model.calibration.recordings import OdometryLog, Trajectory, simulate_log
from driftplan.model.calibration.resampling import angle_turned
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Run

SNAKE = [(0, 0), (10, 0), (10, 2), (0, 2), (0, 4), (10, 4)]
PERFECT = OdometryNoise()


def drive(noise=PERFECT, **options):
    return simulate_log(SNAKE, noise, rng=3, **{"step_m": 0.05, **options})


def delayed(log, seconds):
    return OdometryLog(log.times + seconds, log.moves, log.turns, log.holds_velocity)


def test_perfect_odometry_agrees_with_the_truth_at_every_knot():
    log, truth = drive()
    found = match(log, truth, spacing_m=0.5)
    (part,) = found.resampled
    assert found.time_offset_s == 0.0
    np.testing.assert_allclose(np.diff(part.driven), 0.5, atol=0.06)  # knots are samples, 5 cm apart
    turn = np.exp(1j * (part.truth_heading[0] - part.estimate_heading[0]))
    np.testing.assert_allclose(part.estimate * turn + part.truth[0], part.truth, atol=1e-9)
    np.testing.assert_allclose(part.estimate_heading, part.truth_heading, atol=1e-9)
    assert found.counts.driven_m == pytest.approx(34.0)
    assert found.counts.used_m == pytest.approx(34.0, abs=0.5)
    assert found.counts.turned_rad == pytest.approx(2 * np.pi)


@given(shift=st.floats(-0.8, 0.8), heading=st.booleans())
@settings(max_examples=15)
def test_a_clock_offset_is_found_and_undone(shift, heading):
    log, truth = drive(OdometryNoise(heading_var_per_m=1e-5, distance_var_per_m=1e-5))
    truth = truth if heading else truth.without_heading()
    found = match(delayed(log, shift), truth, spacing_m=0.5)
    # the truth's clock minus the odometry's; turns last 1.6 s, the windows of the search 0.5 s
    assert found.time_offset_s == pytest.approx(-shift, abs=0.03)


@given(askew=st.floats(-3.1, 3.1).filter(lambda angle: abs(angle) > 0.02), bias=st.floats(-0.05, 0.05))
@settings(max_examples=15)
def test_a_reference_mounted_askew_is_found_and_turned_back(askew, bias):
    noise = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-5, heading_bias_per_m=bias)
    log, truth = drive(noise, truth_heading_std=0.002)
    turned = Trajectory(truth.times, truth.xy, truth.heading + askew)
    found = match(log, turned, spacing_m=0.1, time_offset_s=0.0)
    # its standard error here is 0.002 rad (0.8 m segments err by 1e-2 / sqrt(3) rad after half of it is undone, 42 of
    # them); the bias alone, not undone, would add 0.02
    assert found.heading_offset == pytest.approx(askew, abs=0.01)
    straight = match(log, truth, spacing_m=0.1, time_offset_s=0.0)
    assert straight.heading_offset == 0.0
    np.testing.assert_allclose(
        found.resampled[0].truth_heading, straight.resampled[0].truth_heading + askew - found.heading_offset, atol=1e-9
    )
    given = match(log, turned, spacing_m=0.1, time_offset_s=0.0, heading_offset=askew)
    np.testing.assert_allclose(given.resampled[0].truth_heading, straight.resampled[0].truth_heading, atol=1e-9)


def test_no_offset_is_invented_for_a_steady_drive():
    rng = np.random.default_rng(0)
    log, truth = simulate_log(
        [(0, 0), (50, 0)], OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-3), rng=rng
    )
    assert match(log, truth, spacing_m=0.5).time_offset_s == 0.0


def test_knots_are_apart_in_true_distance_whatever_the_odometry_counts():
    noise = OdometryNoise(distance_scale_error=0.25, distance_var_per_m=1e-3)
    log, truth = drive(noise)
    (part,) = match(log, truth, spacing_m=1.0, time_offset_s=0.0).resampled
    true_steps = np.abs(np.diff(part.truth))
    straight = true_steps > 0.95 * np.diff(part.driven)
    # true chords over true distances: pieces of 4 m are measured, so 1 m keeps some of its noise of 3 cm
    np.testing.assert_allclose(true_steps[straight], np.diff(part.driven)[straight], atol=0.1)
    assert np.mean(true_steps[straight]) == pytest.approx(1.0, abs=0.02)


def test_jitter_of_the_truth_does_not_lengthen_the_way():
    log, truth = drive(truth_position_std_m=0.03, step_m=0.02)
    rattling = np.abs(np.diff(truth.positions)).sum()
    found = match(log, truth, spacing_m=1.0, time_offset_s=0.0)
    assert rattling > 60.0  # of 34 m
    assert found.counts.used_m == pytest.approx(34.0, abs=1.1)


@pytest.mark.parametrize("heading", [True, False])
@pytest.mark.parametrize("error", [0.02, -0.2])
def test_the_angle_turned_is_that_of_the_robot_and_not_that_of_jitter(heading, error):
    """Within a tenth, where absolute values of the heading's changes add up to a third more (winding) or to 40 rad
    (straight); looking round and back counts, though the heading is then as before."""
    noise = OdometryNoise(heading_var_per_m=1e-3, heading_var_per_rad=1e-3, heading_bias_per_rad=error)
    winding = [Run(length_m=3.0, curvature_per_m=0.6), Run(length_m=3.0, curvature_per_m=-1.0)]
    round_and_back = [Run(length_m=0.0, turn_rad=turn) for turn in (-1.0, 2.0, -1.0)]
    drives = [(60 * winding, 60 * 4.8), ([Run(length_m=360.0)], 0.0)]
    if heading or error == 0.02:  # positions cannot tell that an odometry sees too little of what cancels
        drives.append((60 * [*winding, *round_and_back], 60 * 8.8))
    for path, angle in drives:
        log, truth = simulate_log(path, noise, rng=1, truth_heading_std=0.02, truth_position_std_m=0.004)
        found = match(log, truth if heading else truth.without_heading(), spacing_m=0.25, time_offset_s=0.0)
        assert found.counts.turned_rad == pytest.approx(angle, rel=0.1, abs=8.0)


def test_positions_tell_how_the_robot_turned_where_the_odometry_was_wrong():
    noise = OdometryNoise(heading_var_per_m=3e-3, heading_bias_per_rad=-0.1)
    path = 40 * [Run(length_m=3.0, curvature_per_m=0.6), Run(length_m=3.0, curvature_per_m=-0.8, turn_rad=1.0)]
    log, truth = simulate_log(path, noise, rng=1, truth_position_std_m=0.004)
    (true,) = match(log, truth, spacing_m=0.25, time_offset_s=0.0, heading_offset=0.0).resampled
    (found,) = match(log, truth.without_heading(), spacing_m=0.25, time_offset_s=0.0).resampled
    for knots in (16, 160):  # of 4 m and 40 m
        was, said, seen = (
            np.diff(x[::knots])
            for x in (true.truth_heading, found.estimate_heading, np.concatenate([[0.0], np.cumsum(found.turns)]))
        )
        # what chords of a metre between positions 4 mm off cannot tell, whatever the length: 0.006 rad of their own,
        # and sqrt(3e-3/3) of the wandering under one, at both ends; the odometry is off by several times that
        assert np.std(seen - was) < 0.06
        assert np.std(said - was) > 2 * np.std(seen - was)


def test_standstill_takes_time_and_no_distance():
    log, truth = drive()
    k = 200
    pause = 5.0
    times = np.concatenate([log.times[: k + 1], log.times[k] + [pause], log.times[k + 1 :] + pause])
    still = OdometryLog(times, np.insert(log.moves, k, 0), np.insert(log.turns, k, 0.0))
    at = truth.times + pause * (truth.times > truth.times[k])
    found = match(still, Trajectory(at, truth.xy, truth.heading), spacing_m=0.5)
    assert found.counts.standstill_s == pytest.approx(pause)
    assert found.counts.breaks == 0
    (part,) = found.resampled
    np.testing.assert_allclose(np.abs(np.diff(part.estimate)), np.abs(np.diff(part.truth)), atol=1e-6)


def test_jitter_at_standstill_is_no_distance():
    """A minute's rest of a visual odometry whose poses shake by a third of a millimetre, 20 times a second."""
    log, truth = drive()
    k, pause, rng = 200, 60.0, np.random.default_rng(0)
    shakes = int(20 * pause)
    poses = np.column_stack([log.positions.real, log.positions.imag, log.headings])
    resting = poses[k] + 3e-4 * rng.standard_normal((shakes, 3))
    poses = np.concatenate([poses[: k + 1], resting, poses[k + 1 :]])
    times = np.concatenate(
        [log.times[: k + 1], log.times[k] + np.arange(1, shakes + 1) / 20, log.times[k + 1 :] + pause]
    )
    shaken = OdometryLog.from_poses(poses, times)
    assert shaken.travelled[-1] > 34.5
    at = truth.times + pause * (truth.times > truth.times[k])
    found = match(shaken, Trajectory(at, truth.xy, truth.heading), spacing_m=0.5, max_gap_s=90.0)
    assert found.counts.standstill_s == pytest.approx(pause, abs=1.5)  # told within half a second at either end
    assert found.counts.used_m == pytest.approx(34.0, abs=0.5)
    assert match(log, truth, spacing_m=0.5).counts.standstill_s == 0.0  # turning on the spot is no rest


@pytest.mark.parametrize("glitch", [500.0, 0.0])
def test_a_counter_that_wraps_round_cuts_the_drive_and_is_counted(glitch):
    log, truth = drive(truth_position_std_m=0.005)
    moves, turns = log.moves.copy(), log.turns.copy()
    moves[300] += glitch
    turns[300] += 0.0 if glitch else 300.0
    found = match(OdometryLog(log.times, moves, turns), truth, spacing_m=0.5)
    assert (found.counts.odometry_outliers, found.counts.truth_outliers, found.counts.breaks) == (1, 0, 1)
    assert found.counts.driven_m == pytest.approx(34.0, abs=0.1)
    for part in found.resampled:
        turn = np.exp(1j * (part.truth_heading[0] - part.estimate_heading[0]))
        moved = (part.estimate - part.estimate[0]) * turn
        assert np.abs(moved - (part.truth - part.truth[0])).max() < 0.05
    slip = log.moves.copy()
    slip[300:310] *= 5.0
    assert match(OdometryLog(log.times, slip, log.turns), truth, spacing_m=0.5).counts.odometry_outliers == 0


def test_a_gap_of_the_truth_while_moving_cuts_the_drive():
    log, truth = drive()
    seen = (truth.times < 8) | (truth.times > 13)
    found = match(log, Trajectory(truth.times[seen], truth.xy[seen], truth.heading[seen]), spacing_m=0.5)
    assert len(found.resampled) == 2
    assert found.counts.breaks == 1
    first, second = found.resampled
    assert first.driven[-1] < 8.1
    assert second.driven[0] > 9
    whole = match(
        log, Trajectory(truth.times[seen], truth.xy[seen], truth.heading[seen]), spacing_m=0.5, max_gap_s=60.0
    )
    assert len(whole.resampled) == 1


def test_a_gap_in_velocities_cuts_the_drive_but_one_in_increments_does_not():
    log, truth = drive()
    kept = np.concatenate([np.arange(100), np.arange(160, len(log.times))])
    moved = np.diff(log.positions[kept]) * np.exp(-1j * log.headings[kept][:-1])
    turned = np.diff(log.headings[kept])
    for holds, resampled in ((False, 1), (True, 2)):
        sparse = OdometryLog(log.times[kept], moved, turned, holds_velocity=holds)
        assert len(match(sparse, truth, spacing_m=0.5, max_gap_s=2.0).resampled) == resampled


def test_outliers_of_the_truth_are_left_out_and_counted():
    log, truth = drive(truth_position_std_m=0.005)
    xy = truth.xy.copy()
    xy[[50, 300, 301, 500]] += [3.0, -2.0]
    found = match(log, Trajectory(truth.times, xy, truth.heading), spacing_m=0.5)
    assert (found.counts.truth_outliers, found.counts.breaks) == (4, 0)
    (part,) = found.resampled
    turn = np.exp(1j * (part.truth_heading[0] - part.estimate_heading[0]))
    assert np.abs(part.estimate * turn + part.truth[0] - part.truth).max() < 0.05


def test_a_truth_that_jumps_for_good_cuts_the_drive_there():
    log, truth = drive(truth_position_std_m=0.005)
    xy = truth.xy + np.where(truth.times > 20, 5.0, 0.0)[:, None]
    found = match(log, Trajectory(truth.times, xy, truth.heading), spacing_m=0.5)
    assert (found.counts.truth_outliers, found.counts.breaks, len(found.resampled)) == (0, 1, 2)


def test_repeated_samples_and_odometry_without_truth_are_counted():
    log, truth = drive()
    twice = Trajectory(np.insert(truth.times, 7, truth.times[7]), np.insert(truth.xy, 7, truth.xy[7], axis=0), None)
    found = match(log, twice.between(2.0, 30.0), spacing_m=0.5)
    assert found.counts.repeated_samples == 1
    assert found.counts.outside_truth_s == pytest.approx(2.0 + log.times[-1] - 30.0, abs=0.2)
    assert found.counts.truth_samples < found.counts.odometry_samples


def test_recordings_that_never_overlap_are_refused():
    log, truth = drive()
    with pytest.raises(ValueError, match=r"expected odometry and truth to overlap in time, got odometry from 1000"):
        match(delayed(log, 1000.0), truth, spacing_m=0.5)


def test_counts_of_several_drives_add_up():
    log, truth = drive()
    one = match(log, truth, spacing_m=0.5).counts
    both = one + one
    assert (both.odometry_samples, both.driven_m) == (2 * one.odometry_samples, 2 * one.driven_m)


@given(
    st.lists(st.integers(-20, 20) | st.floats(-3, 3), min_size=2, max_size=60),
    st.sampled_from([0.0, 0.1, 0.5, 3.0, 8.0]),
)
def test_angles_turned_are_those_of_a_pointer_dragged_with_a_play(steps, play):
    headings = np.cumsum(np.array(steps, dtype=float)) / 4
    pointer, total, dragged = headings[0], 0.0, []
    for heading in headings:
        pull = max(heading - play / 2 - pointer, 0.0) + min(heading + play / 2 - pointer, 0.0)
        pointer, total = pointer + pull, total + abs(pull)
        dragged.append(total)
    found = angle_turned(headings, play)
    np.testing.assert_allclose(found, dragged, atol=1e-12)
    assert (np.diff(found) >= 0).all()
