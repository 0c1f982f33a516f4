"""The bidirectional square test: exact on drives of known systematic errors, the paper's formulas to first order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model.calibration.umbmark import umbmark
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Run


def driven(noise, way, side=4.0):
    """Measured minus reported position after a square that the odometry takes for perfect, by predict_drift: without
    random errors the estimate's bias on the true path is reported minus true."""
    turn = way * (np.pi / 2) / (1 + noise.heading_bias_per_rad)
    bend = -noise.heading_bias_per_m / (1 + noise.heading_bias_per_rad)  # reported straight
    legs = [Run(length_m=side, curvature_per_m=bend, turn_rad=turn if k else 0.0) for k in range(4)]
    return -predict_drift(legs, noise).end.bias


@given(per_rad=st.floats(-0.1, 0.1), per_m=st.floats(-0.05, 0.05), side=st.floats(1, 10))
@settings(deadline=None, max_examples=30)
def test_the_errors_that_made_the_squares_are_found(per_rad, per_m, side):
    noise = OdometryNoise(heading_bias_per_rad=per_rad, heading_bias_per_m=per_m / side)
    found = umbmark([driven(noise, -1, side)], [driven(noise, 1, side)], side_m=side).noise
    assert found.heading_bias_per_rad == pytest.approx(per_rad, abs=1e-9)
    assert found.heading_bias_per_m == pytest.approx(per_m / side, abs=1e-9)


@given(per_rad=st.floats(-2e-3, 2e-3), per_m=st.floats(-5e-4, 5e-4))
@settings(deadline=None, max_examples=30)
def test_the_formulas_of_the_paper_hold_to_first_order(per_rad, per_m):
    noise = OdometryNoise(heading_bias_per_rad=per_rad, heading_bias_per_m=per_m)
    result = umbmark([driven(noise, -1)], [driven(noise, 1)])
    small = (np.pi / 2 * abs(per_rad) + 4 * abs(per_m)) ** 2
    assert result.alpha == pytest.approx(np.pi / 2 * per_rad, abs=3 * small + 1e-12)
    assert result.beta == pytest.approx(-4 * per_m, abs=3 * small + 1e-12)
    assert result.wheelbase_ratio == pytest.approx(np.pi / 2 / (np.pi / 2 - result.alpha), abs=3 * small + 1e-12)


def test_a_larger_right_wheel_bends_sides_to_the_left():
    ratio, wheelbase, side = 1.01, 0.5, 4.0
    # with wheels r and ratio·r the same number of turns gives arcs r φ and ratio r φ: curvature 2(ratio-1)/(b(ratio+1))
    curvature = 2 * (ratio - 1) / (wheelbase * (ratio + 1))
    noise = OdometryNoise(heading_bias_per_m=-curvature)
    result = umbmark([driven(noise, -1, side)], [driven(noise, 1, side)], side_m=side)
    assert result.wheel_diameter_ratio(wheelbase) == pytest.approx(ratio, rel=1e-9)
    assert result.beta > 0


def test_runs_are_averaged_and_the_worst_direction_is_reported():
    noise = OdometryNoise(heading_bias_per_rad=0.01)
    cw, ccw = driven(noise, -1), driven(noise, 1)
    scatter = np.array([[0.01, -0.02], [-0.01, 0.02]])
    result = umbmark(cw + scatter, ccw + 2 * scatter)
    assert result.noise.heading_bias_per_rad == pytest.approx(0.01, abs=1e-9)
    assert result.worst_systematic_m == pytest.approx(max(np.hypot(*cw), np.hypot(*ccw)))


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match=r"expected clockwise of shape \(n, 2\), a row per run, got \(2,\)"):
        umbmark((0.1, 0.2), [(0.1, 0.2)])
    with pytest.raises(ValueError, match="expected side_m > 0"):
        umbmark([(0.1, 0.2)], [(0.1, 0.2)], side_m=0.0)
    with pytest.raises(ValueError, match="smaller than the square's side of 4 m"):
        umbmark([(5.0, 0.2)], [(0.1, 0.2)])
    with pytest.raises(ValueError, match="expected counterclockwise finite"):
        umbmark([(0.1, 0.2)], [(0.1, np.nan)])
