"""Reading paths: whatever describes them, the turns and runs come out as a robot would drive them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from driftplan import OdometryNoise, Run, Runs, predict_drift
from driftplan.model.paths import read_path, wrap

coordinate = st.floats(-50, 50).map(lambda x: round(x, 2))
waypoints = st.lists(st.tuples(coordinate, coordinate), min_size=2, max_size=8).map(np.array)


@given(waypoints)
def test_driving_the_runs_leads_through_the_waypoints(path):
    drift = predict_drift(path, OdometryNoise())
    np.testing.assert_allclose(drift.xy, path, atol=1e-10)
    np.testing.assert_allclose(np.diff(drift.distance), np.linalg.norm(np.diff(path, axis=0), axis=1), atol=1e-9)


@given(waypoints, st.lists(st.floats(-3.1, 3.1), min_size=8, max_size=8))
def test_poses_are_reached_with_their_headings(path, headings):
    poses = np.column_stack([path, headings[: len(path)]])
    drift = predict_drift(poses, OdometryNoise())
    np.testing.assert_allclose(drift.xy, path, atol=1e-10)
    np.testing.assert_allclose(wrap(drift.heading - poses[:, 2]), 0, atol=1e-10)
    runs = read_path(poses)
    assert (np.abs(runs.turns) <= np.pi + 1e-12).all()


@given(st.floats(-100, 100))
def test_wrapping_keeps_the_direction(angle):
    wrapped = wrap(np.array(angle))
    assert -np.pi < wrapped <= np.pi + 1e-6  # a half turn goes to the left
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle), abs=1e-12)


def test_a_robot_that_must_turn_before_it_starts_pays_for_the_turn():
    noise = OdometryNoise(heading_var_per_rad=0.01)
    facing, away = (predict_drift([(0, 0), (10, 0)], noise, start_heading=h).end.rms for h in (0.0, np.pi / 2))
    assert facing == 0
    assert away == pytest.approx(10 * np.sqrt(2 * (1 - np.exp(-0.01 * np.pi / 4))), rel=1e-12)


def test_a_start_heading_also_serves_logs_and_runs():
    for path in (Runs.from_odometry([1.0], [0.0]), [Run(length_m=1.0)]):
        np.testing.assert_allclose(
            predict_drift(path, OdometryNoise(), start_heading=np.pi / 2).end.xy, [0, 1], atol=1e-15
        )


def test_arcs_end_where_circles_say():
    end = predict_drift([Run(length_m=np.pi, curvature_per_m=1.0)], OdometryNoise()).end
    np.testing.assert_allclose(end.xy, [0, 2], atol=1e-15)


def test_cutting_keeps_the_path_and_says_where_the_cuts_lie():
    runs = read_path([(0, 0), (4, 0), (4, 3)])
    cut, at, borders = runs.cut(np.array([0.0, 1.0, 4.0, 5.5, 7.0]))
    np.testing.assert_allclose(cut.lengths, [1, 3, 1.5, 1.5])
    np.testing.assert_allclose(cut.turns, [0, 0, np.pi / 2, 0])
    np.testing.assert_array_equal(at, [0, 1, 2, 3, 4])
    np.testing.assert_array_equal(borders, [0, 2, 4])


def test_a_cut_at_a_pause_lies_on_arrival_before_the_pause():
    runs = read_path([(0, 0), (4, 0), (4, 0), (4, 3)])
    _, at, borders = runs.cut(np.array([4.0]))
    np.testing.assert_array_equal(borders, [0, 1, 2, 3])
    assert at.tolist() == [1]
