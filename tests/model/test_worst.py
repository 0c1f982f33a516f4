"""The greatest drift anywhere on a path against looking everywhere, and against what is known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model import worst
from driftplan.model.drift import predict_drift
from driftplan.model.elements import run_moments
from driftplan.model.moments import Moments
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Run
from driftplan.model.point_drift import PointDrift
from driftplan.model.readings import Fix
from driftplan.model.worst import (
    Departures,
    _greatest_of_mixture,
    _greatest_radius,
    bend_rates,
    ceiling,
    cone,
    exceeds_between,
    greatest_between,
    slope_rates,
    worst_radius,
    worst_rms,
)

PATH = np.array([(0, 0), (6, 4), (1, -6), (1, -6), (9, -6)], dtype=float)
CIRCLING = OdometryNoise(heading_var_per_m=1e-6, heading_bias_per_m=0.5)
STEPS = OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.0)
FIXES = [
    Fix.full(0.0, position_std_m=0.05, heading_std=0.2),
    Fix.position(9.0, position_std_m=0.3),
    Fix.full(15.0, position_std_m=0.1, heading_std=0.05, detection_probability=0.7),
]


@settings(deadline=None, max_examples=25)
@given(
    st.floats(1e-6, 0.5),
    st.floats(-0.6, 0.6),
    st.floats(-0.3, 0.3),
    st.floats(-0.9, 0.9),
    st.integers(0, 3),
    st.sampled_from([0.0, 0.05, 0.3]),
)
def test_no_point_of_a_path_is_worse_and_some_point_is_as_bad(q, bias, scale, corr, fixes, spread):
    noise = OdometryNoise(
        heading_var_per_m=q,
        distance_var_per_m=1e-2,
        heading_bias_per_m=bias,
        distance_scale_error=scale,
        heading_distance_corr=corr,
        heading_bias_std_per_m=spread,
    )
    drift = predict_drift(PATH, noise, fixes=FIXES[:fixes])
    everywhere = float(drift.profile(4e-3).rms.max())
    # Between points 4 mm apart E|e|² rises by at most (2 |1+γ| |μ| rms + c²) h²/8, in rms half of that over the rms;
    # drives differ by at most 2.86 deviations.
    missed = (2 * 1.35 * 1.6 * everywhere + 0.01) * 16e-6 / 8 / everywhere
    assert everywhere * (1 - 1e-12) <= worst_rms(drift) <= everywhere + missed


def test_a_peak_between_waypoints_is_found_to_ten_digits():
    drift = predict_drift(PATH[:3], CIRCLING)
    profile = drift.profile(0.01)
    at_peak = float(profile.distance[np.argmax(profile.rms)])
    assert min(abs(at_peak - s) for s in drift.distance) > 1.0
    peak = float(drift.at(np.linspace(at_peak - 0.01, at_peak + 0.01, 20001)).rms.max())
    assert worst_rms(drift) == pytest.approx(peak, rel=1e-10)
    assert worst_rms(drift) > drift.profile().rms.max()


def test_where_drives_differ_the_greatest_average_counts_and_not_that_of_the_mean_drive():
    drift = predict_drift(PATH[:3], replace(CIRCLING, heading_bias_std_per_m=0.08))
    everywhere = float(drift.profile(1e-3).rms.max())
    assert worst_rms(drift) == pytest.approx(everywhere, rel=1e-6)
    assert worst_rms(drift) > 1.05 * drift.rms.max()
    assert worst_rms(drift) < 0.98 * worst_rms(predict_drift(PATH[:3], CIRCLING))


@pytest.mark.parametrize("estimator", ["reset", "filter"])
def test_a_turn_on_the_spot_counts_though_the_way_on_takes_the_robot_back(estimator):
    # Out with a wrong heading, about face, and back: the lever shrinks from the turn on, but the turn's noise is there.
    noise = OdometryNoise(heading_var_per_m=1e-6, distance_var_per_rad=1e-3)
    drift = predict_drift([(0, 0), (10, 0), (0, 0)], noise, fixes=FIXES[:1], estimator=estimator)
    far_end = float(drift.rms[1])
    assert worst_rms(drift) == pytest.approx(np.sqrt(far_end**2 + np.pi * 1e-3), rel=1e-12)
    assert worst_rms(drift) > drift.profile().rms.max() * 1.00001


def test_how_fast_a_run_may_bend_in_numbers_worked_out_by_hand():
    noise = OdometryNoise(
        heading_var_per_m=0.04,
        distance_var_per_m=0.01,
        heading_distance_corr=0.5,
        heading_bias_per_m=0.3,
        distance_scale_error=0.1,
    )
    # c = 0.5 sqrt(0.04 0.01) = 0.01, γ = 0.1 + 0.005 j, μ = -0.02 + 0.3 j
    rms_rate, fixed = bend_rates(noise)
    assert rms_rate == pytest.approx(2 * np.sqrt(1.1**2 + 0.005**2) * np.sqrt(0.02**2 + 0.3**2), rel=1e-14)
    assert fixed == pytest.approx(1e-4, rel=1e-14)
    steepest = 2 * (np.sqrt(1.1**2 + 0.005**2) + 1)
    assert slope_rates(replace(noise, lateral_var_per_m=0.03)) == pytest.approx((steepest, 0.04), rel=1e-14)


@given(
    q=st.floats(1e-6, 0.5),
    bias=st.floats(-0.6, 0.6),
    scale=st.floats(-0.3, 0.3),
    corr=st.floats(-0.9, 0.9),
    length=st.floats(0.1, 20.0),
)
@settings(max_examples=25)
def test_no_run_bends_faster_nor_rises_above_the_ceiling_of_its_ends(q, bias, scale, corr, length):
    noise = OdometryNoise(
        heading_var_per_m=q,
        distance_var_per_m=0.02,
        heading_bias_per_m=bias,
        distance_scale_error=scale,
        heading_distance_corr=corr,
    )
    step = length / 400
    N = run_moments(np.arange(401) * step, 0.0, noise).N.real
    rms_rate, fixed = bend_rates(noise)
    second = np.diff(N, 2) / step**2
    assert (-second <= (rms_rate * np.sqrt(N.max()) + fixed) * (1 + 1e-6) + 1e-7).all()
    ends, bend = N[[0, 200, 400]], np.array([rms_rate, fixed]) * (length / 2) ** 2 / 8
    above = ceiling(ends[:-1], ends[1:], *np.repeat(bend, 2).reshape(2, 2))
    assert (above >= [N[:201].max() * (1 - 1e-12), N[200:].max() * (1 - 1e-12)]).all()
    rms_rate, fixed = slope_rates(noise)
    assert (np.abs(np.diff(N)) / step <= (rms_rate * np.sqrt(N.max()) + fixed) * (1 + 1e-9)).all()
    above = cone(ends[:-1], ends[1:], *np.repeat([rms_rate * length / 4, fixed * length / 4], 2).reshape(2, 2))
    assert (above >= [N[:201].max() * (1 - 1e-12), N[200:].max() * (1 - 1e-12)]).all()


@pytest.mark.parametrize("heading_var_per_m", [1e3, 1e13])
def test_a_heading_that_is_lost_at_once_is_no_endless_search(heading_var_per_m):
    """Then E|e|² bends within nanometres; a bound on its slope ends what that on its bend would cut ever finer."""
    noise = OdometryNoise(heading_var_per_m=heading_var_per_m, distance_var_per_m=2e-4, distance_scale_error=-0.01)
    drift = predict_drift([(1, 1), (8, 1.5), (8, 8)], noise)
    assert worst_rms(drift) == pytest.approx(drift.profile(0.001).rms.max(), rel=1e-6)


def test_a_ceiling_is_that_of_a_parabola_that_sags_as_much_as_it_may():
    # Without a bend that grows with the rms: between 1 and 1 it rises by the sag, and not above 5 beside 1.
    one, ends = np.ones(4), np.array([1, 5, 2, 9])
    np.testing.assert_allclose(ceiling(one, ends, 0 * one, one), [2.0, 5.0, 1.5 + 1 + 1 / 16, 9.0], rtol=1e-12)
    # With one, between two that are level, the sag is that of the rms it is lifted to.
    lifted = ceiling(4 * np.ones(3), 4 * np.ones(3), np.array([2.0, 0.5, 0.0]), np.array([1.0, 3.0, 2.0]))
    np.testing.assert_allclose(lifted, 4 + np.array([2.0, 0.5, 0.0]) * np.sqrt(lifted) + [1.0, 3.0, 2.0], rtol=1e-12)


@pytest.mark.parametrize("scale", [0.1, 100.0])
def test_the_greatest_radius_may_be_where_the_rms_is_not_the_greatest(scale):
    # A line spreads 1.96 rms at 95 %, a disc of the same rms 1.73: a disc a little larger holds its estimate better.
    zero, disc = np.zeros(32), np.arange(32) < 16
    N, e2 = scale**2 * np.where(disc, 1.01, 1.0), scale**2 * np.where(disc, 0.0, 1.0)
    points = PointDrift(np.arange(32.0), Moments(zero + 1, zero, zero, zero, zero, zero, N, e2, zero, zero))
    radius, place = _greatest_radius(points, 0.95)
    assert radius == pytest.approx(1.959964 * scale, rel=1e-4)
    assert place >= 16


def test_a_group_of_points_is_passed_over_only_if_its_greatest_cannot_matter():
    # Of the second sixteen points by rms the first, a line, has the greatest radius of all, the rest has almost none.
    zero, one = np.zeros(32), np.arange(32) == 16
    N = np.where(np.arange(32) < 16, 1.01, np.where(one, 1.0, 1e-6))
    points = PointDrift(np.arange(32.0), Moments(zero + 1, zero, zero, zero, zero, zero, N, 1.0 * one, zero, zero))
    radius, place = _greatest_radius(points, 0.95)
    assert radius == pytest.approx(1.959964, rel=1e-4)
    assert place == 16


def test_the_drift_before_a_fix_counts():
    fix = Fix.full(10.0, position_std_m=0.01, heading_std=0.01)
    noise = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3)
    drift = predict_drift([(0, 0), (15, 0)], noise, fixes=[fix])
    before = predict_drift([(0, 0), (10, 0)], noise).end.rms
    assert worst_rms(drift) == pytest.approx(float(before), rel=1e-12)


@pytest.mark.parametrize("s_m", [0.0, 4.0, 15.0])
def test_a_fix_that_makes_matters_worse_counts_wherever_it_is(s_m):
    coarse = Fix.position(s_m, position_std_m=9.0)
    drift = predict_drift([(0, 0), (15, 0)], OdometryNoise(distance_var_per_m=1e-3), fixes=[coarse])
    assert worst_rms(drift) == pytest.approx(np.sqrt(2 * 81 + 1e-3 * (15 - s_m)), rel=1e-12)


def test_every_leg_has_its_own_noise():
    calm, wild = OdometryNoise(distance_var_per_m=1e-6), CIRCLING
    drift = predict_drift([(0, 0), (5, 0), (11, 4), (12, 4)], [calm, wild, calm])
    assert worst_rms(drift) == pytest.approx(float(drift.profile(1e-3).rms.max()), rel=1e-7)


def test_without_noise_nothing_is_worse_than_nothing():
    assert worst_rms(predict_drift(PATH, OdometryNoise())) == 0.0


@pytest.mark.parametrize(
    ("confidence", "noise"),
    [
        (0.5, CIRCLING),
        (0.95, CIRCLING),
        (0.95, OdometryNoise(heading_var_per_m=1e-3)),
        (0.95, OdometryNoise(heading_var_per_m=1e-6)),
    ],
)
def test_the_greatest_radius_is_that_of_looking_everywhere(confidence, noise):
    for fixes in ([], FIXES[1:]):
        drift = predict_drift(PATH, noise, fixes=fixes)
        everywhere = float(drift.profile(0.05).radius(confidence).max())
        found = worst_radius(drift, confidence)
        assert everywhere * (1 - 1e-9) <= found <= everywhere * (1 + 5e-4)  # points 5 cm apart miss a peak's tip


@pytest.mark.parametrize("bias", [0.5, 0.47, 0.44])
def test_a_peak_of_the_radius_between_waypoints_is_found_to_nine_digits(bias):
    drift = predict_drift(PATH[:3], replace(CIRCLING, heading_bias_per_m=bias))
    coarse = np.linspace(0.0, float(drift.length), 60)[1:-1]
    near = coarse[np.argmax(drift.at(coarse).radius(0.9))] + np.linspace(-0.25, 0.25, 201)
    assert worst_radius(drift, 0.9) >= drift.at(near).radius(0.9).max() * (1 - 1e-9)


@pytest.mark.parametrize(
    ("drift", "said"),
    [
        (predict_drift(np.stack([PATH, PATH]), CIRCLING), "one path, got a batch"),
        (predict_drift(PATH, STEPS), "continuous kind"),
        (predict_drift(PATH[:3], [CIRCLING, STEPS]), "continuous kind"),
        (predict_drift([Run(length_m=3.0, curvature_per_m=0.2), Run(length_m=2.0)], CIRCLING), "straight runs"),
    ],
)
def test_what_has_no_bound_is_refused(drift, said):
    for ask in (worst_rms, lambda d: worst_radius(d, 0.9)):
        with pytest.raises(ValueError, match=said):
            ask(drift)


def test_a_stretch_is_looked_into_as_long_as_its_sag_could_lift_it_above_the_greatest():
    """One leg with its peak inside: told of nearly as much elsewhere, the search must still find more in it."""
    drift = predict_drift(PATH[:3], CIRCLING)
    leg = int(np.searchsorted(drift.distance, drift.profile(0.01).distance[np.argmax(drift.profile(0.01).rms)])) - 1
    begun, ends = drift.departures()[leg : leg + 1], drift.moments.N.real[leg + 1]
    peak = worst_rms(drift) ** 2
    assert peak > 1.2 * ends
    for share in (0.9, 0.99, 0.9999):
        found = greatest_between(
            begun,
            drift.runs.lengths[leg : leg + 1],
            np.zeros(1, dtype=np.intp),
            [CIRCLING],
            np.array([ends]),
            np.zeros(1, dtype=np.intp),
            np.array([share * peak]),
        )
        assert found == pytest.approx(peak, rel=1e-9)


def lost(position: complex, heading: float) -> Moments:
    """Moments of an error that is known, of one stretch."""
    e, d = position, np.exp(1j * heading) - 1
    values = (1.0, 0.0, d, d * d, abs(d) ** 2, e, abs(e) ** 2, e * e, e * np.conj(d), e * d)
    return Moments(*(np.array([value]) for value in values))


def test_the_bound_on_the_bend_is_attained_and_no_stretch_is_looked_into_in_vain(monkeypatch):
    """Far from where it believes itself to be, a robot's |e|² bends by 2 |μ| |e|, and drives that bend in proportion to
    their rms bend as much on average as is allowed. So the peak between two level ends is all but at their ceiling:
    told of 99 % of the rise, the search must find the rest; told of 102 %, it need not look."""
    length, biases = 0.5, (0.05, 0.1)
    noises = [OdometryNoise(heading_bias_per_m=bias) for bias in biases]
    begun = [lost(-1e6j * bias, -bias * length / 2) for bias in biases]
    drives = [Departures(w, moments, [noise]) for w, moments, noise in zip((0.3, 0.7), begun, noises, strict=True)]

    def square(s):
        """E|e|² after s metres, from geometry: each drive's estimate goes round a circle."""
        sums = 0.0
        for w, bias in zip((0.3, 0.7), biases, strict=True):
            believed = np.exp(-0.5j * bias * length) * (np.exp(1j * bias * s) - 1) / (1j * bias)
            sums = sums + w * np.abs(-1e6j * bias + believed - s) ** 2
        return sums

    s = np.linspace(0.0, length, 2001)
    ends, peak = square(length), square(s).max()
    assert ends == pytest.approx(square(0.0), rel=1e-9)
    for share in (0.99, 1.02):
        told = np.array([ends + share * (peak - ends)])
        if share > 1:
            monkeypatch.setattr(worst, "of_legs", None)
        found = _greatest_of_mixture(
            drives, np.array([length]), np.zeros(1, int), np.array([ends]), np.zeros(1, int), told
        )
        assert found == pytest.approx(max(peak, told[0]), rel=1e-9)


def test_bend_and_slope_of_an_average_are_the_root_mean_squares_of_those_of_the_drives(monkeypatch):
    asked, asked_of_slope = [], []
    monkeypatch.setattr(worst, "ceiling", lambda *given: asked.append(given) or np.zeros(len(given[0])))
    monkeypatch.setattr(worst, "cone", lambda *given: asked_of_slope.append(given) or np.zeros(len(given[0])))
    noises = [
        replace(OdometryNoise(heading_var_per_m=q, distance_var_per_m=0.3, heading_distance_corr=0.8), **more)
        for q, more in (
            (0.2, {"distance_scale_error": 0.3}),
            (0.1, {"heading_bias_per_m": 0.4, "lateral_var_per_m": 0.2}),
        )
    ]
    start, none = lost(2.0, 0.1), np.zeros(1, int)
    drives = [Departures(w, start, [noise]) for w, noise in zip((0.25, 0.75), noises, strict=True)]
    _greatest_of_mixture(drives, np.array([6.0]), none, np.array([3.0]), none, np.array([5.0]))
    (begin, end, bend, fixed), rates = asked[0], np.array([bend_rates(noise) for noise in noises])
    assert (begin, end) == (pytest.approx(4.0), 3.0)
    assert bend == pytest.approx(np.sqrt(0.25 * rates[0, 0] ** 2 + 0.75 * rates[1, 0] ** 2) * 36 / 8, rel=1e-12)
    assert fixed == pytest.approx((0.25 * rates[0, 1] + 0.75 * rates[1, 1]) * 36 / 8, rel=1e-12)
    (begin, end, slope, fixed), rates = asked_of_slope[0], np.array([slope_rates(noise) for noise in noises])
    assert (begin, end) == (pytest.approx(4.0), 3.0)
    assert slope == pytest.approx(np.sqrt(0.25 * rates[0, 0] ** 2 + 0.75 * rates[1, 0] ** 2) * 3.0, rel=1e-12)
    assert fixed == pytest.approx((0.25 * 0.3 + 0.75 * 0.5) * 3.0, rel=1e-12)


def test_a_limit_is_exceeded_inside_a_stretch_if_its_peak_is_above_it():
    drift = predict_drift(PATH[:3], CIRCLING)
    leg = int(np.argmax(drift.at(np.array([6.0, 14.0])).rms))
    peak, end = worst_rms(drift) ** 2, drift.moments.N.real[leg + 1]
    begun, length = drift.departures()[[leg] * 4], np.repeat(drift.runs.lengths[leg], 4)
    limits = peak * np.array([0.9, 1 - 1e-6, 1 + 1e-6, 2.0])
    assert end < limits[0]
    found = exceeds_between(begun, length, np.zeros(4, int), [CIRCLING], np.full(4, end), limits)
    assert found.tolist() == [True, True, False, False]
