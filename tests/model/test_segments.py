"""What a noise model expects of segment errors, against brute force: simulated drives and sums over all pairs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model.calibration.resampling import ResampledDrive
from driftplan.model.calibration.segments import TruthNoise, expect, observe, pieces, windows, windows_of
from driftplan.model.drift import predict_drift
from driftplan.model.moments import compose
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Runs

NOISE = OdometryNoise(
    heading_var_per_m=8e-4,
    heading_var_per_rad=1e-3,
    distance_var_per_m=1e-3,
    distance_var_per_rad=5e-4,
    lateral_var_per_m=6e-4,
    heading_bias_per_m=0.01,
    heading_bias_per_rad=0.03,
    distance_scale_error=0.02,
)
KNOTS, LENGTH = 33, 0.4
TURNS = 0.15 * np.sin(np.arange(KNOTS - 1) / 4)


def true_path():
    headings = np.concatenate([[0.4], 0.4 + np.cumsum(TURNS)])
    moves = LENGTH * np.exp(1j * (headings[:-1] + TURNS / 2))
    return np.concatenate([[2 - 1j], 2 - 1j + np.cumsum(moves)]), headings


def along_chords(driven, estimate, estimate_heading, truth, truth_heading, turns):
    """A drive whose robot faces along the chords between knots."""
    angles, chords = np.abs(turns), np.diff(truth)
    square = (chords / np.abs(chords)) ** 2
    axes = (square * np.diff(driven), square * angles)
    return ResampledDrive(driven, estimate, estimate_heading, truth, truth_heading, turns, angles, *axes)


def drive(estimate, estimate_heading, truth, truth_heading):
    return along_chords(LENGTH * np.arange(KNOTS), estimate, estimate_heading, truth, truth_heading, TURNS)


def simulated(runs, rng, position_std, heading_std, known_heading):
    """Recordings of the same true path: half of a piece's heading error before its move, half after."""
    truth, headings = true_path()
    angle = np.abs(TURNS)
    spread = np.sqrt((NOISE.heading_var_per_m * LENGTH + NOISE.heading_var_per_rad * angle) / 2)
    mean = (NOISE.heading_bias_per_m * LENGTH + NOISE.heading_bias_per_rad * TURNS) / 2
    along = np.sqrt(NOISE.distance_var_per_m * LENGTH + NOISE.distance_var_per_rad * angle)
    across = np.sqrt(NOISE.lateral_var_per_m * LENGTH)
    for _ in range(runs):
        halves = mean + spread * rng.standard_normal((2, KNOTS - 1))
        error = np.concatenate([[0.0], np.cumsum(halves.sum(axis=0))])
        moves = np.diff(truth) * (1 + NOISE.distance_scale_error)
        course = np.diff(truth) / np.abs(np.diff(truth))
        moves = moves + course * (along * rng.standard_normal(KNOTS - 1) + 1j * across * rng.standard_normal(KNOTS - 1))
        moves = moves * np.exp(1j * (error[:-1] + halves[0]))
        away = np.exp(1j * 1.1)  # odometry has a frame of its own
        estimate = away * np.concatenate([[0.0], np.cumsum(moves)])
        noisy = truth + position_std * (rng.standard_normal(KNOTS) + 1j * rng.standard_normal(KNOTS))
        seen = headings + heading_std * rng.standard_normal(KNOTS) if known_heading else None
        yield drive(estimate, headings + error + 1.1, noisy, seen)


@pytest.mark.parametrize("known_heading", [True, False])
def test_expected_errors_are_those_of_simulated_drives(known_heading):
    rng = np.random.default_rng(11)
    position_std, heading_std, runs = 0.1, 0.04, 5_000
    truth, headings = true_path()
    steps = KNOTS - 1 if known_heading else (KNOTS - 1) // 2
    nominal = drive(truth, headings, truth, headings if known_heading else None)
    seen = observe(nominal, steps, 1)
    found = windows_of(nominal, NOISE, [steps])
    mean, cov = expect(nominal, seen, found, steps, TruthNoise(position_std**2, heading_std**2))
    drives = simulated(runs, rng, position_std, heading_std, known_heading)
    values = np.array([observe(one, steps, 1).values[0] for one in drives])

    error = np.sqrt(np.diag(cov[0]) / runs)
    # Known heading: moments exact but for the truth's heading error, squared: 0.04² of a 10 m segment; four standard
    # errors. Positions: the alignment is expanded to second order in an angle of 0.1 rad, so the mean is off by at
    # most its cube times the 6 m chord, 5 mm, and variances by 3 %.
    allowed = 4 * error + (0 if known_heading else 5e-3)
    assert (np.abs(values.mean(axis=0) - mean[0]) < allowed).all()
    spread = (values - values.mean(axis=0))[:, :, None] * (values - values.mean(axis=0))[:, None, :]
    size = np.sqrt(np.outer(np.diag(cov[0]), np.diag(cov[0])))
    tolerance = 4 * spread.std(axis=0) / np.sqrt(runs) + (0 if known_heading else 0.03) * size
    assert (np.abs(spread.mean(axis=0) - cov[0]) < tolerance).all()


@given(
    heading=st.floats(1e-6, 0.05),
    per_rad=st.floats(0, 0.02),
    along=st.floats(0, 0.02),
    across=st.floats(0, 0.02),
    bias=st.floats(-0.05, 0.05),
    scale=st.floats(-0.1, 0.1),
)
@settings(max_examples=40)
def test_a_straight_segment_drifts_as_predict_drift_says(heading, per_rad, along, across, bias, scale):
    noise = OdometryNoise(
        heading_var_per_m=heading,
        heading_var_per_rad=per_rad,
        distance_var_per_m=along,
        lateral_var_per_m=across,
        heading_bias_per_m=bias,
        distance_scale_error=scale,
    )
    n = 64
    line = np.arange(n + 1.0) / 8
    straight = along_chords(line, line + 0j, 0 * line, line + 0j, 0 * line, np.zeros(n))
    seen = observe(straight, n, 1)
    mean, cov = expect(straight, seen, windows_of(straight, noise, [n]), n, TruthNoise(0.0, 0.0))
    drift = predict_drift([(0, 0), (line[-1], 0)], noise).end
    # halves of the heading error before and after each of n moves: 1/(2 n²) off, 1.2e-4 for 64, twice that for safety
    square = float(drift.rms**2)
    assert mean[0, :2] @ mean[0, :2] + np.trace(cov[0, :2, :2]) == pytest.approx(square, rel=2.5e-4)
    assert mean[0, :2] == pytest.approx(drift.bias, abs=3e-4 * np.sqrt(square))
    assert cov[0, :2, :2] == pytest.approx(drift.cov, abs=6e-4 * square)


def test_chords_align_rightly_where_heading_noise_outweighs_distance_noise():
    """A straight drive that loses 5 degrees on each half of its segments: the error along the second chord is then
    mostly the alignment's, squared, and so is seen only by moments of the second order."""
    noise = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=4e-4)
    knots, steps, runs = 33, 16, 20_000
    rng = np.random.default_rng(3)
    line = 0.5 * np.arange(knots) + 0j
    theta = np.cumsum(np.sqrt(noise.heading_var_per_m * 0.25) * rng.standard_normal((runs, 2 * knots)), axis=1)
    step = 0.5 + np.sqrt(noise.distance_var_per_m * 0.5) * rng.standard_normal((runs, knots - 1))
    paths = np.cumsum(np.insert(step * np.exp(1j * theta[:, 0 : 2 * knots - 2 : 2]), 0, 0, axis=1), axis=1)
    straight = along_chords(line.real, line, 0 * line.real, line, None, np.zeros(knots - 1))
    seen = observe(straight, steps, 1)
    mean, cov = expect(straight, seen, windows_of(straight, noise, [steps]), steps, TruthNoise(0.0, 0.0))
    values = np.array([observe(straight._replace(estimate=path), steps, 1).values[0] for path in paths])
    error = values.std(axis=0) / np.sqrt(runs)
    assert values.mean(axis=0) == pytest.approx(mean[0], abs=float(4 * error.max()) + 2e-3)
    spread = values.var(axis=0) / np.diag(cov[0])
    # four standard errors of a variance are 0.04; the first chord's length is 6 % too sure of itself, see the code
    assert spread == pytest.approx([0.94, 1.0, 1.0], abs=0.05)


def test_a_curved_segment_drifts_as_predict_drift_says():
    n = 400
    turns = 0.02 * np.sin(np.arange(n) / 60)
    lengths = np.full(n, 0.05)
    headings = np.concatenate([[0.0], np.cumsum(turns)])
    truth = np.concatenate([[0.0], np.cumsum(lengths * np.exp(1j * headings[1:]))])
    driven = np.concatenate([[0.0], np.cumsum(lengths)])
    curve = along_chords(driven, truth, headings, truth, headings, turns)
    seen = observe(curve, n, 1)
    mean, cov = expect(curve, seen, windows_of(curve, NOISE, [n]), n, TruthNoise(0.0, 0.0))
    drift = predict_drift(Runs.from_odometry(lengths, turns), NOISE).end
    # here a step turns, then drives; there half of each error comes before: steps of 5 cm in 20 m, first order 1/400
    assert mean[0, :2] == pytest.approx(drift.bias, abs=0.01 * float(drift.rms))
    assert cov[0, :2, :2] == pytest.approx(drift.cov, abs=0.01 * float(drift.rms) ** 2)
    assert mean[0, 2] == pytest.approx(float(drift.moments.d1.imag), rel=1e-6)


@given(count=st.integers(1, 40), steps=st.lists(st.integers(1, 40), min_size=1, max_size=4))
@settings(max_examples=40)
def test_windows_are_compositions_of_their_pieces(count, steps):
    n = KNOTS - 1
    steps = [min(s, n) for s in steps]
    truth, headings = true_path()
    element = pieces(drive(truth, headings, truth, headings), NOISE)
    found = windows(element, steps)
    for s in steps:
        start = min(count, n - s)
        joined = element[start]
        for k in range(start + 1, start + s):
            joined = compose(joined, element[k])
        for got, expected in zip(found[s][start].arrays(), joined.arrays(), strict=True):
            assert got == pytest.approx(expected, rel=1e-12, abs=1e-14)
        assert found[s].shape == (n - s + 1,)


@given(turn=st.floats(-3, 3), shift=st.complex_numbers(max_magnitude=10))
@settings(max_examples=40)
def test_observations_do_not_depend_on_the_frames_they_are_recorded_in(turn, shift):
    truth, headings = true_path()
    rng = np.random.default_rng(5)
    estimate = truth + 0.1 * (rng.standard_normal(KNOTS) + 1j * rng.standard_normal(KNOTS))
    said = headings + 0.1 * rng.standard_normal(KNOTS)
    for known in (True, False):
        here = drive(estimate, said, truth, headings if known else None)
        there = here._replace(estimate=estimate * np.exp(1j * turn) + shift, estimate_heading=said + turn)
        steps = 8
        assert observe(there, steps, 3).values == pytest.approx(observe(here, steps, 3).values, abs=1e-9)
        world = here._replace(truth=truth * np.exp(1j * turn) + shift, truth_heading=headings + turn if known else None)
        assert observe(world, steps, 3).values == pytest.approx(observe(here, steps, 3).values, abs=1e-9)


def test_segments_whose_chord_says_nothing_are_not_aligned_by_it():
    angle = np.linspace(0, 2 * np.pi, 17)
    circle = np.concatenate([np.exp(1j * angle), 1 + np.arange(1, 20)])  # once round, then straight ahead
    driven = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(circle)))])
    n = len(circle)
    loop = along_chords(driven, circle, np.zeros(n), circle, None, np.zeros(n - 1))
    assert 0 not in observe(loop, 16, 1).starts
    assert 16 in observe(loop, 8, 1).starts
