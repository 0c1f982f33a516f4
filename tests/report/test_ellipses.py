"""Error ellipses against their definition, and marks and scales against what they promise."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.patches import Ellipse

from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.report.figures.maps import error_ellipse, magnification, mark_distances, mark_spacing

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.1, after_m=10.0)
PATH = [(3, 3), (3, 19), (37, 19), (37, 27)]


@given(
    angle=st.floats(-np.pi, np.pi),
    stds=st.tuples(st.floats(0.01, 10), st.floats(0.01, 10)),
    confidence=st.floats(0.05, 0.999),
)
def test_an_error_ellipse_is_where_the_squared_mahalanobis_distance_is_the_quantile(angle, stds, confidence):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    cov = turn @ np.diag(np.square(stds)) @ turn.T
    width, height, tilt = error_ellipse(cov, confidence)
    drawn = Ellipse((0, 0), width, height, angle=tilt)
    outline = drawn.get_patch_transform().transform(Ellipse((0, 0), 1, 1).get_path().vertices)
    joints = outline[:24:3]  # of its eight Bezier arcs: they lie on the ellipse exactly
    squared = np.einsum("ni,ij,nj->n", joints, np.linalg.inv(cov), joints)
    # chi-squared of two degrees of freedom; round-off grows with the ratio of the variances, up to 1e6
    np.testing.assert_allclose(squared, -2 * np.log1p(-confidence), rtol=1e-8)
    assert width >= height
    assert -90 <= tilt <= 90


def test_as_many_gaussian_errors_fall_into_the_ellipse_as_it_promises():
    cov = np.array([[2.0, 1.2], [1.2, 1.0]])
    width, height, tilt = error_ellipse(cov, 0.95)
    errors = np.random.default_rng(1).multivariate_normal([0, 0], cov, size=20_000)
    turn = np.radians(tilt)
    along = errors @ [np.cos(turn), np.sin(turn)]
    across = errors @ [-np.sin(turn), np.cos(turn)]
    inside = np.mean((2 * along / width) ** 2 + (2 * across / height) ** 2 <= 1)
    assert abs(inside - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 20_000)  # four standard errors


@given(length=st.floats(1e-3, 1e6))
def test_marks_are_a_round_number_of_metres_apart(length):
    spacing = mark_spacing(length)
    assert f"{spacing:.0e}"[0] in "125"
    assert f"{spacing:g}" == f"{float(f'{spacing:.0e}'):g}"
    assert 4 <= length / spacing <= 13  # 1, 2, 5: off from 8 by at most a factor of sqrt(2.5)


@given(length=st.floats(0.01, 1e4), spacing=st.floats(0.05, 1e3))
def test_marks_end_at_the_end_and_do_not_crowd_there(length, spacing):
    if length / spacing > 1e4:
        return
    marks = mark_distances(length, spacing)
    assert marks[-1] == length
    assert (np.diff(marks) >= 0.4 * spacing * (1 - 1e-9)).all()


def test_ellipses_are_magnified_only_as_far_as_it_takes_to_see_them():
    drift = predict_drift(PATH, NOISE)
    width = float(error_ellipse(drift.cov)[0].max())
    for extent in (width / 100, width, 5 * width, 20 * width, 26 * width, 400 * width, 1e6 * width):
        factor = magnification([drift], extent)
        assert 0.016 <= factor * width / extent <= 0.4
        assert f"{factor:.0e}"[0] in "125"
    assert magnification([drift], 5 * width) == 1.0
    assert magnification([predict_drift(PATH, OdometryNoise())], 50.0) == 1.0
