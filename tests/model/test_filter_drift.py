"""predict_drift for a robot with a filter: the same Drift, from the covariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan import Beacon, BeaconKind, Fix, OdometryNoise, Run, drift_with_beacons, predict_drift
from driftplan.model import filter_state
from driftplan.model.covariance import path_legs
from driftplan.model.filter_state import FilterState, position_rows
from driftplan.model.fusion import belief_at_start
from driftplan.model.paths import read_path
from driftplan.model.readings import Readings
from driftplan.model.worst import worst_rms

NOISE = OdometryNoise(
    heading_var_per_m=3e-5, distance_var_per_m=3e-4, heading_var_per_rad=2e-4, distance_var_per_rad=1e-4
)
PATH = [(0, 0), (14, 0), (14, 9), (2, 9), (2, 2)]
TAGS = [Fix.position(s, position_std_m=0.1) for s in (6.0, 14.0, 21.5, 30.0)]
SPREAD = replace(NOISE, heading_bias_std_per_m=0.002, distance_scale_std=0.01)
BIASED = replace(NOISE, heading_bias_per_m=0.01, distance_scale_error=-0.02, heading_bias_per_rad=0.01)


def filtered(path=PATH, noise=NOISE, fixes=TAGS, **options):
    return predict_drift(path, noise, fixes=fixes, estimator="filter", **options)


def test_it_is_the_filters_covariance():
    leg = path_legs(read_path([(0, 0), (10, 0)]), [NOISE]).columns()[0]
    state = FilterState.at_start().driven(leg).read(position_rows(0.01 * np.eye(2)))
    drift = filtered([(0, 0), (10, 0)], fixes=[Fix.position(10.0, position_std_m=0.1)])
    np.testing.assert_allclose(drift.end.cov, state.matrix[:2, :2], rtol=1e-12)
    assert drift.end.heading_std == pytest.approx(np.sqrt(state.matrix[2, 2]), rel=1e-12)
    assert drift.end.rms == pytest.approx(np.sqrt(state.trace), rel=1e-12)
    np.testing.assert_allclose(drift.bias, 0)


def test_with_little_noise_and_no_fixes_it_is_the_exact_drift():
    noise = replace(BIASED.scaled(1e-4), lateral_var_per_m=1e-12, heading_distance_corr=0.3)
    path = [Run(length_m=5.0, curvature_per_m=0.2), Run(length_m=4.0, turn_rad=2.0), Run(length_m=3.0, turn_rad=-1.0)]
    exact, linear = predict_drift(path, noise), filtered(path, noise, ())
    np.testing.assert_allclose(linear.rms, exact.rms, rtol=1e-5)
    np.testing.assert_allclose(linear.cov, exact.cov, atol=1e-4 * exact.cov.max())
    np.testing.assert_allclose(linear.bias, exact.bias, atol=1e-5 * np.abs(exact.bias).max())
    np.testing.assert_allclose(linear.xy, exact.xy, atol=1e-12)
    np.testing.assert_allclose(linear.heading, exact.heading, atol=1e-12)
    np.testing.assert_allclose(linear.at([2.0, 7.0]).heading, exact.at([2.0, 7.0]).heading, atol=1e-12)
    np.testing.assert_allclose(linear.at([2.0, 7.0]).moments.a, exact.at([2.0, 7.0]).moments.a, atol=1e-11)


@pytest.mark.parametrize("options", [{}, {"noise": BIASED}, {"noise": SPREAD}], ids=["white", "biased", "spread"])
def test_everywhere_it_is_as_if_the_path_ended_there(options):
    drift = filtered(**options)
    for s in (3.0, 8.5, 14.0, 17.0, 26.0, 34.0):
        line = [(0, 0), (14, 0), (14, 9), (2, 9), (2, 2)]
        xy = drift.at(s).xy
        corners = [p for p, there in zip(line, (0, 14, 23, 35), strict=False) if there < s - 1e-9]
        cut = filtered([*corners, xy], **{**options, "fixes": [fix for fix in TAGS if fix.s_m <= s]})
        assert drift.at(s).rms == pytest.approx(cut.end.rms, rel=1e-9)
        np.testing.assert_allclose(drift.at(s).cov, cut.end.cov, atol=1e-12)


def test_one_place_says_what_a_reading_does(monkeypatch):
    nothing_read = filtered(fixes=()).rms
    monkeypatch.setattr(filter_state, "_read_row", lambda P, mean, row: None)
    np.testing.assert_allclose(filtered().rms, nothing_read, rtol=1e-12)
    beacons = [Beacon(BeaconKind.rfid(range_m=1.5, position_std_m=0.1), x=8.0, y=0.0)]
    np.testing.assert_allclose(
        drift_with_beacons(PATH, NOISE, beacons, estimator="filter").rms, nothing_read, rtol=1e-12
    )


def test_readings_of_all_kinds_together_are_what_each_is_alone():
    cov = np.array([[0.01, 0.004], [0.004, 0.03]])
    anchor = {"anchor": (3.0, 4.0)}
    fixes = [
        Fix.position(1.0, position_std_m=0.1),
        Fix.range(2.0, range_std_m=0.1, **anchor),
        Fix(s_m=3.0, position_cov=cov, heading_std=0.02, detection_probability=0.9),
        Fix.heading(4.0, heading_std=0.03),
        Fix(s_m=5.0, position_cov=np.diag([0.01, 0.02]), range_std_m=0.2, bearing_std=0.01, **anchor),
        Fix.bearing(6.0, bearing_std=0.01, **anchor),
        Fix.range(7.0, anchor=(7.0, 0.0), range_std_m=0.1),  # at its anchor no direction is defined: nothing is read
    ]
    places = np.arange(1.0, 8.0) + 0j
    together = Readings.of(fixes).rows(places)
    assert together == [Readings.of([fix]).rows(place)[0] for fix, place in zip(fixes, places[:, None], strict=True)]
    assert [len(rows) for rows, _ in together] == [2, 1, 3, 1, 4, 1, 0]
    assert [chance for _, chance in together] == [None, None, 0.9, None, None, None, None]
    information = sum(np.outer(row.vector(3), row.vector(3)) / row.variance for row in together[2][0])
    np.testing.assert_allclose(information[:2, :2], np.linalg.inv(cov), rtol=1e-12)
    assert information[2, 2] == pytest.approx(0.02**-2)
    (one_range, *_), _ = together[1]
    towards = np.array([3.0 - 2.0, 4.0])
    np.testing.assert_allclose(one_range.vector(3), [*(-towards / np.hypot(*towards)), 0.0], rtol=1e-12)


def test_both_sides_of_a_fix_and_profiles():
    drift = filtered()
    assert drift.on_arrival([6.0]).rms[0] > drift.at(6.0).rms
    profile = drift.profile()
    assert (np.diff(profile.distance) >= 0).all()
    assert profile.rms.max() == pytest.approx(worst_rms(drift), rel=2e-2)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_the_greatest_drift_is_that_of_a_dense_look(seed):
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(size=(5, 2)) * 6, axis=0)
    length = np.hypot(*np.diff(path, axis=0).T).sum()
    fixes = [Fix.position(s, position_std_m=0.1) for s in rng.uniform(0, length, 3)]
    options = [{}, {"noise": BIASED}, {"noise": replace(NOISE, heading_bias_std_per_m=0.05, distance_scale_std=0.1)}]
    drift = filtered(path, **{"fixes": fixes, **options[rng.integers(3)]})
    dense = drift.profile(length / 3000).rms.max()
    assert dense <= worst_rms(drift) * (1 + 1e-9)
    assert worst_rms(drift) <= dense * (1 + 1e-3)


def test_a_peak_between_waypoints_is_found():
    noise = OdometryNoise(heading_var_per_m=1e-6, heading_bias_per_rad=0.1, heading_bias_per_m=-0.01)
    drift = filtered([(0, 0), (1, 0), (1, 20)], noise, ())  # turns too far left, then bends to the right
    assert worst_rms(drift) > 1.1 * drift.rms.max()
    assert worst_rms(drift) == pytest.approx(drift.profile(0.001).rms.max(), rel=1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_a_peak_that_would_come_before_a_run_or_after_it_does_not_count(seed):
    rng = np.random.default_rng(seed)
    noise = OdometryNoise(heading_var_per_m=1e-6, heading_bias_per_rad=0.1, heading_bias_per_m=-0.02)
    path = np.cumsum(rng.normal(size=(4, 2)) * 4, axis=0)
    drift = filtered(path, noise, ())
    dense = drift.profile(float(drift.length) / 1000).rms.max()
    assert dense * (1 - 1e-12) <= worst_rms(drift) <= dense * (1 + 1e-5)


def test_a_filter_is_never_worse_than_resets():
    resets = predict_drift(PATH, NOISE, fixes=TAGS)
    s = np.linspace(0, 42, 400)
    assert (filtered().at(s).rms <= resets.at(s).rms * (1 + 1e-3)).all()
    assert filtered().end.rms < 0.8 * resets.end.rms


def test_it_says_where_the_linear_model_stops_being_right():
    noise = OdometryNoise(heading_var_per_m=0.15**2 / 10)
    drift = filtered([(0, 0), (8, 0), (30, 0)], noise, [Fix.heading(14.0, heading_std=0.01)])
    np.testing.assert_allclose(
        drift.beyond_linear, [[10.0, 14.0], [14.0 + 10.0 * (1 - (0.01 / 0.15) ** 2), 30.0]], atol=0.1
    )
    assert len(filtered().beyond_linear) == 0
    assert len(predict_drift([(0, 0), (99, 0)], noise).beyond_linear) == 0  # exact: right anywhere


def test_ranges_and_bearings_alone_keep_a_robot_found():
    ranges = [Fix.range(s, anchor=(7.0, 4.0), range_std_m=0.1) for s in np.arange(1.0, 42.0, 2.0)]
    bearings = [Fix.bearing(s, anchor=(7.0, 4.0), bearing_std=0.02) for s in np.arange(1.0, 42.0, 2.0)]
    lost = filtered(fixes=()).end.rms
    assert filtered(fixes=ranges).end.rms < 0.5 * lost
    assert filtered(fixes=bearings).end.rms < 0.5 * lost
    assert filtered(fixes=[*ranges, *bearings]).end.rms < min(filtered(fixes=f).end.rms for f in (ranges, bearings))


def test_ranges_are_refused_without_a_filter():
    with pytest.raises(ValueError, match="estimator='filter'"):
        predict_drift(PATH, NOISE, fixes=[Fix.range(5.0, anchor=(1.0, 1.0), range_std_m=0.1)])
    with pytest.raises(ValueError, match="estimator"):
        predict_drift(PATH, NOISE, estimator="kalman")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"range_std_m": 0.1}, "anchor"),
        ({"anchor": (1.0, 2.0), "heading_std": 0.1}, "anchor"),
        ({"anchor": (1.0, np.nan), "range_std_m": 0.1}, "finite"),
        ({"anchor": (1.0, 2.0), "range_std_m": -0.1}, "range_std_m >= 0"),
        ({"anchor": (1.0, 2.0), "bearing_std": np.inf}, "bearing_std finite"),
    ],
)
def test_fixes_are_checked(fields, message):
    with pytest.raises(ValueError, match=message):
        Fix(s_m=1.0, **fields)


def test_a_start_known_with_an_error_and_missed_fixes():
    start = Fix.full(0.0, position_std_m=0.2, heading_std=0.03)
    drift = filtered(fixes=[start])
    assert drift.at(0.0).rms == pytest.approx(0.2 * np.sqrt(2))
    assert drift.at(0.0).heading_std == pytest.approx(0.03)
    chances = [filtered(fixes=[replace(fix, detection_probability=p) for fix in TAGS]).end.rms for p in (0.0, 0.5, 1.0)]
    assert chances[0] == pytest.approx(filtered(fixes=()).end.rms)
    assert chances[0] > chances[1] > chances[2] == pytest.approx(filtered().end.rms)


@pytest.mark.parametrize("options", [{}, {"noise": BIASED}, {"noise": SPREAD}], ids=["white", "biased", "spread"])
def test_many_paths_at_once(options):
    paths = np.random.default_rng(4).normal(size=(6, 5, 2)) * 5
    together = filtered(paths, fixes=(), **options)
    for k, path in enumerate(paths):
        alone = filtered(path, fixes=(), **options)
        np.testing.assert_allclose(together.rms[k], alone.rms, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(together.at([0.5, 1.0]).rms[k], alone.at([0.5, 1.0]).rms, rtol=1e-9)


@pytest.mark.parametrize("heading_std", [5.0, 9.0, 40.0, 1e9])
def test_a_heading_of_which_nothing_is_known_at_the_start_is_a_wide_spread_and_no_infinity(heading_std):
    state = belief_at_start(Fix(s_m=0.0, position_cov=0.01 * np.eye(2), heading_std=heading_std))
    std = min(heading_std, 5.88)  # of 6 rad on all are alike: any direction
    np.testing.assert_allclose(state.matrix, np.diag([0.01, 0.01, std**2]), rtol=0.01, atol=1e-9)
