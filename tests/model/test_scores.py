"""Distance quantities of a Gaussian error, against closed forms, published digits and sampling."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import fixed_quad
from scipy.special import ellipe, ndtr

from driftplan import OdometryNoise, predict_drift
from driftplan.model.scores import mean_distance, probability_within, radius_at

COV = np.array([[4.0, 1.0], [1.0, 0.5]])


def test_published_digits():
    zero, mean = np.zeros(2), np.array([1.0, -2.0])
    assert mean_distance(zero, COV) == pytest.approx(1.75540445219454, rel=1e-12)
    assert mean_distance(mean, COV) == pytest.approx(2.93620359, rel=1e-8)
    assert radius_at(0.95, mean, COV) == pytest.approx(4.74869746, rel=1e-8)


@given(st.floats(0.01, 100), st.floats(0.0, 1.0))
def test_mean_distance_of_a_centred_error_is_the_elliptic_integral(variance, flatness):
    cov = np.diag([variance, variance * flatness])
    assert mean_distance(np.zeros(2), cov) == pytest.approx(
        float(np.sqrt(2 * variance / np.pi) * ellipe(1 - flatness)), rel=1e-10
    )


@settings(max_examples=40)
@given(
    confidence=st.floats(0.05, 0.99),
    mean=st.tuples(st.floats(-3, 3), st.floats(-3, 3)).map(np.array),
    flatness=st.floats(0.0, 1.0),
    scale=st.sampled_from([1e-6, 1.0, 1e3]),
)
def test_radius_and_probability_are_inverse(confidence, mean, flatness, scale):
    cov = np.diag([1.0, flatness])
    radius = radius_at(confidence, scale * mean, scale**2 * cov)
    # 1e-6: where a flat error's line touches the circle the probability jumps within rounding of the radius
    assert probability_within(radius, scale * mean, scale**2 * cov) == pytest.approx(confidence, abs=1e-6)
    rms = scale * np.sqrt(np.trace(cov) + mean @ mean)
    assert radius <= rms / np.sqrt(1 - confidence) * (1 + 1e-9)
    assert mean_distance(scale * mean, scale**2 * cov) <= rms * (1 + 1e-9)


def test_isotropic_and_flat_errors_have_textbook_radii():
    assert radius_at(0.95, np.zeros(2), np.eye(2)) == pytest.approx(np.sqrt(-2 * np.log(0.05)), rel=1e-10)
    assert radius_at(0.95, np.zeros(2), np.diag([1.0, 0.0])) == pytest.approx(1.959963984540, rel=1e-8)
    assert radius_at(0.95, np.array([3.0, 4.0]), np.zeros((2, 2))) == pytest.approx(5.0)


@settings(max_examples=40)
@example(radius=2.0, mean=np.array([0.0, 2.0]), minor_std=1e-5)  # the line of the error is a tangent
@example(radius=4.0, mean=np.array([3.0, 2.0]), minor_std=1e-3)
@given(
    radius=st.floats(0.1, 5.0),
    mean=st.tuples(st.floats(-3, 3), st.floats(-3, 3)).map(np.array),
    minor_std=st.sampled_from([1e-9, 1e-5, 1e-3, 1e-2, 0.1, 1.0]),
)
def test_probability_against_quadrature_cut_where_strips_change(radius, mean, minor_std):
    """Flat errors off the origin are what odometry with a scale error has; a circle may just touch their line."""

    def density(angle):
        y, half = radius * np.sin(angle), radius * np.cos(angle)
        strip = ndtr((half - mean[1]) / minor_std) - ndtr((-half - mean[1]) / minor_std)
        return half * np.exp(-0.5 * (y - mean[0]) ** 2) / np.sqrt(2 * np.pi) * strip

    edges = np.abs(mean[1]) + minor_std * np.linspace(-10, 10, 11)
    cuts = np.arccos(edges[(edges > 0) & (edges < radius)] / radius)
    cuts = np.unique([-np.pi / 2, *-cuts, 0.0, *cuts, np.pi / 2])
    expected = sum(fixed_quad(density, *ends, n=100)[0] for ends in pairwise(cuts))  # smooth between the cuts
    assert probability_within(radius, mean, np.diag([1.0, minor_std**2])) == pytest.approx(expected, abs=1e-9)


def test_sampling_agrees():
    mean, rng = np.array([1.0, -2.0]), np.random.default_rng(0)
    length = np.linalg.norm(rng.multivariate_normal(mean, COV, 400_000), axis=1)
    assert abs(length.mean() - mean_distance(mean, COV)) < 4 * length.std() / np.sqrt(len(length))
    for r in (0.5, 2.0, 5.0):
        p = probability_within(r, mean, COV)
        assert abs((length <= r).mean() - p) < 4 * np.sqrt(p * (1 - p) / len(length))


def test_scores_of_a_published_table():
    """L-shaped drives of 100 m: rms, expected distance and 95 % radius at 0.05, 0.2, 0.5, 1 rad of heading error."""
    path = [(0, 0), (50, 0), (50, 50)]
    table = {
        0.05: (2.2816, 1.9079, 4.346),
        0.2: (9.0946, 7.6502, 17.215),
        0.5: (22.298, 19.196, 40.926),
        1: (41.698, 36.996, 72.038),
    }
    for heading_std, (rms, mean, radius) in table.items():
        end = predict_drift(path, OdometryNoise(heading_var_per_m=heading_std**2 / 100)).end
        np.testing.assert_allclose([end.rms, end.mean_distance, end.radius(0.95)], [rms, mean, radius], rtol=2e-4)


def test_scores_take_whole_paths():
    drift = predict_drift([(0, 0), (50, 0), (50, 50)], OdometryNoise(heading_var_per_m=1e-3))
    assert drift.radius(0.5).shape == drift.mean_distance.shape == drift.probability_within(3.0).shape == (3,)
    assert drift.probability_within(0.0)[0] == 1  # known exactly at the start
    assert (np.diff(drift.radius(0.95)) > 0).all()


@pytest.mark.parametrize("confidence", [0.0, 1.0, -1.0, float("nan")])
def test_bad_confidence_is_refused(confidence):
    with pytest.raises(ValueError, match=r"confidence in \(0, 1\)"):
        radius_at(confidence, np.zeros(2), np.eye(2))


def test_bad_radius_is_refused():
    with pytest.raises(ValueError, match="radius >= 0"):
        probability_within(-1.0, np.zeros(2), np.eye(2))
