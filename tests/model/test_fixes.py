"""What a fix keeps and what it wipes, and the sawtooth it makes of the drift."""

from __future__ import annotations

import numpy as np
import pytest

from driftplan import Fix, OdometryNoise, predict_drift

LINE = [(0.0, 0.0), (40.0, 0.0)]
NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3)


def test_a_full_fix_wipes_the_past():
    fixed = predict_drift(LINE, NOISE, fixes=[Fix.full(30.0, position_std_m=0.0, heading_std=0.0)])
    fresh = predict_drift([(30.0, 0.0), (40.0, 0.0)], NOISE)
    np.testing.assert_allclose(fixed.end.cov, fresh.end.cov, rtol=1e-12)
    assert fixed.at(30.0).rms == 0


def test_a_position_fix_keeps_the_heading_error():
    fixed = predict_drift(LINE, NOISE, fixes=[Fix.position(30.0, position_std_m=0.2)])
    assert fixed.at(30.0).rms == pytest.approx(0.2 * 2**0.5)
    assert fixed.at(30.0).heading_std == pytest.approx(predict_drift(LINE, NOISE).at(30.0).heading_std, rel=1e-12)
    perfect = predict_drift(LINE, NOISE, fixes=[Fix.full(30.0, position_std_m=0.2, heading_std=0.0)])
    assert fixed.end.rms > perfect.end.rms


def test_a_heading_fix_keeps_the_position_error():
    free = predict_drift(LINE, NOISE)
    fixed = predict_drift(LINE, NOISE, fixes=[Fix.heading(20.0, heading_std=0.0)])
    assert fixed.at(20.0).rms == pytest.approx(float(free.at(20.0).rms), rel=1e-12)
    assert fixed.end.rms < free.end.rms


def test_a_fix_that_is_never_detected_changes_nothing():
    fix = Fix.full(20.0, position_std_m=0.1, heading_std=0.1, detection_probability=0.0)
    np.testing.assert_allclose(
        predict_drift(LINE, NOISE, fixes=[fix]).end.cov, predict_drift(LINE, NOISE).end.cov, rtol=1e-12
    )


def test_a_fix_at_the_start_is_the_uncertainty_of_the_start():
    start = Fix.full(0.0, position_std_m=0.3, heading_std=0.1)
    drift = predict_drift(LINE, OdometryNoise(), fixes=[start])
    assert drift.rms[0] == pytest.approx(0.3 * 2**0.5)
    # E|e|² at the end: start position, plus 2(1 - E cos θ) L²
    assert drift.end.rms**2 == pytest.approx(0.18 + 2 * (1 - np.exp(-0.005)) * 1600, rel=1e-12)


def test_published_digits_after_a_reset():
    """Fix with covariance diag(.04, .01) and .02 rad, then 100 steps of 0.5 m with .005 rad and diag(1e-4, 0)."""
    noise = OdometryNoise(heading_var_per_step=2.5e-5, distance_var_per_step=1e-4, step_m=0.5)
    fix = Fix(s_m=0.0, position_cov=np.diag([0.04, 0.01]), heading_std=0.02)
    end = predict_drift([(0, 0), (50, 0)], noise, fixes=[fix]).end
    np.testing.assert_allclose(end.moments.e1, -0.04154197819301633, rtol=1e-12)
    np.testing.assert_allclose(end.moments.N, 3.1729607262332, rtol=1e-12)
    np.testing.assert_allclose(end.moments.e2, -3.0648036370211, rtol=1e-12)
    np.testing.assert_allclose(end.moments.d1, -0.0014489492579200, rtol=1e-12)


def test_a_later_fix_can_be_worse_than_an_earlier_one():
    """With a heading fix of 0.1 rad and steps +5, -5, +0.5: resetting at the start beats resetting after step one."""
    noise = OdometryNoise.per_step(heading_std=0.02, distance_std=0.0, step_m=5.0)
    path = [(0, 0), (5, 0), (0, 0), (0.5, 0)]
    early, late = (
        float(predict_drift(path, noise, fixes=[Fix.full(s, position_std_m=0.0, heading_std=0.1)]).end.rms ** 2)
        for s in (0.0, 5.0)
    )
    assert early == pytest.approx(0.010797, abs=5e-7)
    assert late == pytest.approx(0.210158, abs=5e-7)


def test_the_profile_shows_both_sides_of_a_fix():
    fixes = [Fix.full(10.0, position_std_m=0.05, heading_std=0.01), Fix.position(25.0, position_std_m=0.05)]
    profile = predict_drift(LINE, NOISE, fixes=fixes).profile(0.5)
    assert (np.diff(profile.distance) >= 0).all()
    for s in (10.0, 25.0):
        before, after = profile.rms[np.isclose(profile.distance, s)][[0, -1]]
        assert after == pytest.approx(0.05 * 2**0.5)
        assert before > 2 * after


def test_just_after_a_fix_means_just_after_it_whatever_the_rounding():
    rng = np.random.default_rng(1)
    for _ in range(300):  # cutting a leg and adding its parts up again may end one rounding off
        path = np.cumsum(rng.normal(0, 10, (5, 2)), axis=0)
        length = float(predict_drift(path, NOISE).length)
        fix = Fix.full(float(rng.uniform(0, length)), position_std_m=0.0, heading_std=0.0)
        assert predict_drift(path, NOISE, fixes=[fix]).at(fix.s_m).rms < 1e-4


def test_in_steps_a_fix_ends_a_step():
    noise = OdometryNoise.per_step(heading_std=0.05, distance_std=0.1, step_m=1.0)
    unread = Fix.full(20.5, position_std_m=0.0, heading_std=0.0, detection_probability=0.0)
    cut = predict_drift(LINE, noise, fixes=[unread]).end
    # 21 steps and 20, where the line alone has 40
    assert cut.heading_std**2 == pytest.approx(41 * 0.05**2, rel=1e-9)
    np.testing.assert_allclose(cut.cov, predict_drift([(0, 0), (20.5, 0), (40, 0)], noise).end.cov, rtol=1e-12)


def test_fixes_are_taken_in_order_of_distance():
    fixes = [Fix.position(s, position_std_m=0.1) for s in (30.0, 10.0, 20.0)]
    one, two = (predict_drift(LINE, NOISE, fixes=f).end.rms for f in (fixes, sorted(fixes, key=lambda f: f.s_m)))
    assert one == two


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"s_m": -1.0, "heading_std": 0.1}, "s_m >= 0, got -1"),
        ({"s_m": "3", "heading_std": 0.1}, "s_m to be a number, got '3'"),
        ({"s_m": 1.0}, "position_cov, heading_std or both, got neither"),
        ({"s_m": 1.0, "heading_std": -0.1}, "heading_std >= 0, got -0.1"),
        ({"s_m": 1.0, "heading_std": 0.1, "detection_probability": 1.5}, r"in \[0, 1\], got 1.5"),
        ({"s_m": 1.0, "position_cov": [[1, 0]]}, r"position_cov a square matrix of dimension 2, got \(1, 2\)"),
        ({"s_m": 1.0, "position_cov": [[1, 2], [2, 1]]}, "positive semi-definite"),
    ],
)
def test_bad_fixes_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Fix(**arguments)


def test_bad_position_std_is_refused():
    with pytest.raises(ValueError, match="position_std_m finite, got nan"):
        Fix.position(1.0, position_std_m=float("nan"))


@pytest.mark.parametrize("chance", [1.0, 0.6])
def test_leg_by_leg_and_hop_by_hop_find_the_same(chance, monkeypatch):
    path = np.random.default_rng(2).uniform(0, 30, (12, 2))
    noise = OdometryNoise(heading_var_per_m=1e-2, distance_var_per_m=1e-3, heading_bias_per_m=0.01)
    fixes = [
        Fix.full(0.0, position_std_m=0.1, heading_std=0.05),
        *(Fix.position(s, position_std_m=0.2, detection_probability=chance) for s in (3.0, 40.0, 40.0, 90.0)),
        Fix.heading(40.0, heading_std=0.1, detection_probability=chance),
    ]
    short = predict_drift(path, noise, fixes=fixes)
    monkeypatch.setattr("driftplan.model.drive._SHORT_HOP_LEGS", 0)
    long = predict_drift(path, noise, fixes=fixes)
    for x, y in zip(short.profile().moments.arrays(), long.profile().moments.arrays(), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-11, atol=1e-13)
