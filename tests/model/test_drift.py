"""predict_drift: laws, Monte Carlo, published numbers, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from driftplan import Fix, OdometryNoise, Run, Runs, predict_drift, simulate_drift

coordinate = st.floats(-50, 50).map(lambda x: round(x, 3))
paths = st.lists(st.tuples(coordinate, coordinate), min_size=2, max_size=7, unique=True).map(np.array)
noises = st.builds(
    OdometryNoise,
    heading_var_per_m=st.sampled_from([1e-6, 1e-3, 0.05]),
    distance_var_per_m=st.sampled_from([0.0, 0.01]),
    lateral_var_per_m=st.sampled_from([0.0, 0.02]),
    heading_var_per_rad=st.sampled_from([0.0, 0.01]),
    heading_bias_per_m=st.sampled_from([0.0, 0.01]),
    distance_scale_error=st.sampled_from([0.0, 0.02]),
)
ALL_ON = {
    "heading_var_per_m": 0.004,
    "distance_var_per_m": 0.01,
    "lateral_var_per_m": 0.005,
    "heading_var_per_rad": 0.02,
    "distance_var_per_rad": 0.02,
    "heading_bias_per_m": 0.01,
    "heading_bias_per_rad": 0.05,
    "distance_scale_error": 0.03,
}
ZIGZAG = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (3.0, 8.0)])


@settings(max_examples=40)
@given(path=paths, noise=noises, cut=st.floats(0.01, 0.99), leg=st.integers(0, 5))
def test_cutting_a_run_changes_nothing(path, noise, cut, leg):
    leg = min(leg, len(path) - 2)
    between = path[leg] + cut * (path[leg + 1] - path[leg])
    assume(np.linalg.norm(path[leg + 1] - path[leg]) > 0.1)  # shorter legs have no well-defined heading at rounding
    whole, halves = predict_drift(path, noise).end, predict_drift(np.insert(path, leg + 1, between, axis=0), noise).end
    scale = whole.rms**2 + 1e-12
    # a cut leg turns by rounding only, about 1e-15 rad, which turn noise sees as variance per radian
    np.testing.assert_allclose(halves.cov, whole.cov, rtol=1e-8, atol=1e-9 * scale)
    np.testing.assert_allclose(halves.bias, whole.bias, rtol=1e-8, atol=1e-9 * scale**0.5)


@settings(max_examples=40)
@given(path=paths, noise=noises, angle=st.floats(-3, 3))
def test_turning_the_world_turns_bias_and_covariance(path, noise, angle):
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    here, there = predict_drift(path, noise), predict_drift(path @ R.T, noise)
    scale = here.rms.max() ** 2
    np.testing.assert_allclose(there.bias, here.bias @ R.T, atol=1e-9 * scale**0.5)
    np.testing.assert_allclose(there.cov, R @ here.cov @ R.T, atol=1e-9 * scale)
    np.testing.assert_allclose(there.cov_body, here.cov_body, atol=1e-9 * scale)
    np.testing.assert_allclose(there.rms, here.rms, rtol=1e-9)


@settings(max_examples=40)
@given(path=paths, noise=noises, shift=st.tuples(coordinate, coordinate))
def test_moving_the_world_changes_nothing(path, noise, shift):
    np.testing.assert_allclose(
        predict_drift(path + shift, noise).rms, predict_drift(path, noise).rms, rtol=1e-8, atol=1e-12
    )


@settings(max_examples=30)
@given(path=paths)
def test_no_noise_no_drift(path):
    drift = predict_drift(path, OdometryNoise())
    assert (drift.rms == 0).all()
    assert (drift.cov == 0).all()
    assert (drift.bias == 0).all()
    assert drift.end.radius(0.95) == 0
    assert drift.end.mean_distance == 0


@settings(max_examples=40)
@given(path=paths, noise=noises)
def test_covariance_is_positive_semi_definite_and_rms_is_its_sum(path, noise):
    drift = predict_drift(path, noise)
    values = np.linalg.eigvalsh(drift.cov)
    scale = drift.rms**2
    assert (values[..., 0] >= -1e-13 * (scale + 1)).all()
    np.testing.assert_allclose(values[..., 1], drift.largest_eigenvalue, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(drift.trace + drift.bias_norm**2, scale, rtol=1e-9, atol=1e-15)


@settings(max_examples=30)
@given(path=paths)
def test_there_and_back_ends_where_it_began(path):
    loop = np.concatenate([path, path[-2::-1]])
    end = predict_drift(loop, OdometryNoise()).end
    np.testing.assert_allclose(end.xy, path[0], atol=1e-11)
    assert end.rms == 0
    # and a scale error, which shifts the far end by a tenth of its distance, cancels on the way back
    there = predict_drift(path, OdometryNoise(distance_scale_error=0.1)).end
    back = predict_drift(loop, OdometryNoise(distance_scale_error=0.1)).end
    assert there.bias_norm == pytest.approx(0.1 * np.linalg.norm(path[-1] - path[0]), abs=1e-9)
    assert back.bias_norm == pytest.approx(0.0, abs=1e-9)


@settings(max_examples=40)
@given(path=paths, noise=noises)
def test_at_is_the_drift_of_the_path_that_ends_there(path, noise):
    drift = predict_drift(path, noise)
    s = np.linspace(0, float(drift.length), 9)
    inside = drift.at(s)
    np.testing.assert_allclose(drift.at(drift.distance).rms, drift.rms, rtol=1e-9, atol=1e-12)
    k = 4
    leg = min(int(np.searchsorted(drift.distance, s[k], side="right")) - 1, len(path) - 2)
    shorter = np.concatenate([path[: leg + 1], inside.xy[None, k]])
    np.testing.assert_allclose(inside.rms[k], predict_drift(shorter, noise).end.rms, rtol=1e-7, atol=1e-9)


def test_a_batch_is_its_paths_one_by_one():
    rng = np.random.default_rng(0)
    noise = OdometryNoise(**ALL_ON)
    batch = rng.normal(0, 10, (2, 3, 6, 2))
    together = predict_drift(batch, noise)
    assert together.rms.shape == (2, 3, 6)
    assert together.cov.shape == (2, 3, 6, 2, 2)
    one = predict_drift(batch[1, 2], noise)
    np.testing.assert_allclose(together.rms[1, 2], one.rms, rtol=1e-12)
    s = np.array([0.0, 3.0, 7.5])
    np.testing.assert_allclose(together.at(s).rms[1, 2], one.at(s).rms, rtol=1e-12)


def test_a_ragged_batch_is_its_paths_one_by_one():
    paths = [ZIGZAG, ZIGZAG[:2], ZIGZAG[:3] + 1.0]
    noise = OdometryNoise(**ALL_ON)
    together = predict_drift(paths, noise)
    for k, path in enumerate(paths):
        one = predict_drift(path, noise)
        np.testing.assert_allclose(together.end.rms[k], one.end.rms, rtol=1e-12)
        np.testing.assert_allclose(together.end.cov[k], one.end.cov, rtol=1e-12)
        assert together.length[k] == pytest.approx(one.length)


def test_standing_still_on_the_way_costs_nothing():
    noise = OdometryNoise(**ALL_ON)
    paused = ZIGZAG[[0, 0, 1, 1, 1, 2, 3, 3]]
    np.testing.assert_allclose(predict_drift(paused, noise).end.cov, predict_drift(ZIGZAG, noise).end.cov, rtol=1e-12)


def test_a_noise_for_each_leg_is_the_paths_joined():
    quiet, loud = OdometryNoise(heading_var_per_m=1e-4), OdometryNoise(**ALL_ON)
    drift = predict_drift(ZIGZAG, [quiet, loud, quiet])
    assert worst_z(ZIGZAG, [quiet, loud, quiet], runs=10_000, seed=12) < 4
    poses = np.column_stack([ZIGZAG, [0.0, 0.5, 1.0, 0.0]])
    assert worst_z(poses, [quiet, loud, quiet], runs=10_000, seed=13) < 4
    assert drift.at(10.0).rms == pytest.approx(float(predict_drift(ZIGZAG[:2], quiet).end.rms), rel=1e-12)
    np.testing.assert_allclose(predict_drift(ZIGZAG, [loud] * 3).cov, predict_drift(ZIGZAG, loud).cov, rtol=1e-12)
    assert predict_drift(ZIGZAG, quiet).end.rms < drift.end.rms < predict_drift(ZIGZAG, loud).end.rms


def test_an_odometry_log_is_the_polyline_it_draws():
    noise = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-2, heading_var_per_rad=1e-2)
    rng = np.random.default_rng(2)
    distances, turns = rng.uniform(0.1, 1, 50), rng.normal(0, 0.3, 50)
    headings = np.cumsum(turns)
    xy = np.cumsum(distances[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=1), axis=0)
    log = predict_drift(Runs.from_odometry(distances, turns), noise)
    drawn = predict_drift(np.concatenate([[[0, 0]], xy]), noise, start_heading=0.0)
    np.testing.assert_allclose(log.cov, drawn.cov, rtol=1e-9, atol=1e-14)


# --- Monte Carlo: every moment within four standard errors -----------------------------------------------------------


def worst_z(path, noise, *, runs, fixes=(), seed=0):
    """Greatest distance, in standard errors, of bias, covariance and E|e|² from those of simulated drives."""
    drift = predict_drift(path, noise, fixes=fixes)
    errors = simulate_drift(path, noise, runs=runs, rng=seed, fixes=fixes)
    bias, cov, rms = (np.atleast_2d(drift.bias), drift.cov, drift.rms)
    z = []
    for k in range(1, errors.shape[1]):
        e = errors[:, k]
        centred = e - bias[k]
        found = [
            *(e - bias[k]).T,
            (e**2).sum(axis=1) - rms[k] ** 2,
            *(centred[:, i] * centred[:, j] - cov[k, i, j] for i, j in ((0, 0), (0, 1), (1, 1))),
        ]
        z += [abs(x.mean()) / (x.std() / np.sqrt(runs) + 1e-15) for x in found]
    return max(z)


@pytest.mark.parametrize("end_heading_std", [0.01, 0.1, 0.4, 1.2, 2.5])
def test_monte_carlo_agrees_at_every_noise_level(end_heading_std):
    length = np.linalg.norm(np.diff(ZIGZAG, axis=0), axis=1).sum()
    noise = OdometryNoise(heading_var_per_m=end_heading_std**2 / length, distance_var_per_m=0.002)
    assert predict_drift(ZIGZAG, noise).end.heading_std == pytest.approx(end_heading_std, rel=1e-9)
    assert worst_z(ZIGZAG, noise, runs=20_000, seed=1) < 4


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_monte_carlo_agrees_with_every_rate_switched_on(correlation):
    assert worst_z(ZIGZAG, OdometryNoise(**ALL_ON, heading_distance_corr=correlation), runs=20_000, seed=2) < 4


def test_monte_carlo_agrees_on_poses_and_arcs():
    noise = OdometryNoise(**ALL_ON, heading_distance_corr=-0.5)
    poses = np.column_stack([ZIGZAG, [1.0, 0.0, 2.0, -1.0]])
    assert worst_z(poses, noise, runs=20_000, seed=3) < 4
    arcs = [Run(length_m=5, curvature_per_m=0.4), Run(length_m=3, turn_rad=-1, curvature_per_m=-0.2)]
    assert worst_z(arcs, noise, runs=20_000, seed=4) < 4


@pytest.mark.parametrize("law", ["gaussian", "laplace", "uniform", "von_mises"])
def test_monte_carlo_agrees_for_every_heading_law_in_steps(law):
    noise = OdometryNoise(
        **ALL_ON,
        step_m=0.5,
        heading_var_per_step=0.04,
        distance_var_per_step=0.01,
        lateral_var_per_step=0.005,
        heading_law=law,
        heading_distance_corr=0.0 if law == "von_mises" else 0.7,
    )
    path = [Run(length_m=5, curvature_per_m=0.4), Run(length_m=3, turn_rad=-1), Run(length_m=4.3, turn_rad=1)]
    assert worst_z(path, noise, runs=40_000, seed=5) < 4


FIXES = [
    Fix.position(0.0, position_std_m=0.2),
    Fix.position(4.0, position_std_m=0.1),
    Fix.full(10.0, position_std_m=0.1, heading_std=0.05, detection_probability=0.7),
    Fix.heading(12.0, heading_std=0.1),
    Fix(s_m=14.0, position_cov=np.array([[0.05, 0.02], [0.02, 0.03]])),
    Fix.position(float(15 + np.hypot(7, 3)), position_std_m=0.3),
]


def test_monte_carlo_agrees_across_fixes_of_every_kind():
    noise = OdometryNoise(**ALL_ON)
    assert worst_z(ZIGZAG, noise, runs=20_000, fixes=FIXES, seed=6) < 4
    # between the waypoints as well: the same path with more of them
    s = np.arange(0.5, 22, 1.5)
    finer = predict_drift(ZIGZAG, noise, fixes=FIXES).at(s)
    dense = np.concatenate([ZIGZAG[:1], finer.xy, ZIGZAG[-1:]])
    order = np.argsort(np.concatenate([[0], s, [99]]))
    assert worst_z(_with_waypoints(dense[order]), noise, runs=20_000, fixes=FIXES, seed=7) < 4


def _with_waypoints(points):
    """The zigzag through extra points on it."""
    s = predict_drift(ZIGZAG, OdometryNoise()).distance
    along = np.concatenate([s, np.arange(0.5, 22, 1.5)])
    xy = np.concatenate([ZIGZAG, points[1:-1]])
    return xy[np.argsort(along, kind="stable")]


@pytest.mark.slow
@pytest.mark.parametrize("end_heading_std", [0.01, 0.1, 0.4, 1.2, 2.5])
def test_monte_carlo_with_many_runs(end_heading_std):
    noise = OdometryNoise(
        heading_var_per_m=end_heading_std**2 / 22.6, distance_var_per_m=0.002, heading_var_per_rad=0.01
    )
    drift = predict_drift(ZIGZAG, noise)
    assert drift.end.rms > 0
    errors = simulate_drift(ZIGZAG, noise, runs=400_000, rng=11, substep_m=0.02)
    squared = (errors[:, -1] ** 2).sum(axis=1)
    assert abs(squared.mean() - drift.end.rms**2) < 4 * squared.std() / np.sqrt(len(squared))


# --- published numbers ---------------------------------------------------------------------------------------------


def test_first_order_variance_of_a_long_straight_drive():
    """Cross-track variance q L³/3, the textbook value, to first order in q L."""
    drift = predict_drift([(0, 0), (100, 0)], OdometryNoise(heading_var_per_m=1e-9))
    assert drift.end.cov[1, 1] == pytest.approx(1e-9 * 100**3 / 3, rel=1e-6)


def test_the_published_double_sum_corrected():
    """Proposition 1 with the mended Table I: turns (.3, -.2, .5), d = (1, 1.2, .8), 0.1 rad and 0.1 m a step."""
    noise = OdometryNoise(heading_var_per_step=0.01, distance_var_per_step=0.01, step_m=2.0)
    path = [Run(length_m=1.0, turn_rad=0.3), Run(length_m=1.2, turn_rad=-0.2), Run(length_m=0.8, turn_rad=0.5)]
    end = predict_drift(path, noise).end
    # x is the paper's sine coordinate, y its cosine coordinate
    np.testing.assert_allclose(end.bias[::-1], [-0.00939108908860077, -0.0264754260412627], rtol=1e-12)
    np.testing.assert_allclose(np.diag(end.cov)[::-1], [0.119952998509868, 0.0389694730344741], rtol=1e-12)


def double_sum_variances(T, d, heading_var, distance_var):
    """Proposition 1 with the mended Table I, O(n²): variances of Σ d sin and of Σ d cos."""
    n = len(d)
    i = np.arange(1, n + 1)
    h, g = np.exp(-i * heading_var / 2), np.exp(-2 * i * heading_var)
    out = []
    for s, c in ((np.sin(T), np.cos(T)), (np.cos(T), np.sin(T))):
        a = np.sum(d**2 * (s**2 * (g / 2 + 1.5 - 2 * h) + 0.5 * c**2 * (1 - g)))
        b = 0.0
        for k in range(n):
            decay = np.exp(-(i[k + 1 :] - i[k]) * heading_var / 2)
            alpha = 1 - h[k] - h[k] * decay + 0.5 * (1 + g[k]) * decay
            beta = 0.5 * (1 - g[k]) * decay
            b += 2 * d[k] * np.sum(d[k + 1 :] * (s[k] * s[k + 1 :] * alpha + c[k] * c[k + 1 :] * beta))
        spread = distance_var * np.sum(0.5 * s**2 * (1 + g) + 0.5 * c**2 * (1 - g))
        mean = np.sum(d * s * (h - 1))
        out.append(a + b + spread - mean**2)
    return out


@pytest.mark.parametrize("heading_std", [0.01, 0.1, 0.5])
def test_the_double_sum_agrees_on_long_paths(heading_std):
    rng = np.random.default_rng(8)
    turns, d = rng.normal(0, 0.4, 300), rng.uniform(0.5, 1.0, 300)
    noise = OdometryNoise.per_step(heading_std=heading_std, distance_std=0.1, step_m=1.0)
    end = predict_drift(Runs.from_odometry(d, turns), noise).end
    expected = double_sum_variances(np.cumsum(turns), d, heading_std**2, 0.01)
    np.testing.assert_allclose(np.diag(end.cov)[::-1], expected, rtol=1e-9)


def test_a_detour_can_cancel_the_bias_while_the_error_grows():
    """Straight 10 m against overshooting by 10/√2 and coming back: why |E e| is never the score."""
    noise = OdometryNoise(heading_var_per_m=1e-3)
    straight = predict_drift([(0, 0), (10, 0)], noise).end
    detour = predict_drift([(0, 0), (10 + 10 / 2**0.5, 0), (10, 0)], noise).end
    assert straight.bias_norm == pytest.approx(0.02496, abs=5e-6)
    assert detour.bias_norm == pytest.approx(0.00017, abs=5e-6)
    assert straight.rms == pytest.approx(0.577, abs=5e-4)
    assert detour.rms == pytest.approx(0.754, abs=5e-4)


# --- bad input -----------------------------------------------------------------------------------------------------

NOISE = OdometryNoise(heading_var_per_m=1e-4)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ([(0, 0)], r"at least 2 waypoints.*got shape \(1, 2\)"),
        ([(0, 0, 0, 0), (1, 0, 0, 0)], r"shape \(\.\.\., n, 2\)"),
        ([(0, 0), (np.nan, 0)], r"path finite, got nan at index \(1, 0\)"),
        ([(0, 0), (np.inf, 0)], "path finite, got inf"),
        ([(0, 0), (1,)], "path to be numbers"),
        ("path.csv", "path to be numbers, got str"),
        (None, "path finite|path to be numbers|shape"),
        ([ZIGZAG, np.column_stack([ZIGZAG[:2], [0, 0]])], r"all paths of a batch to be \(n, 2\), or all \(n, 3\)"),
        ([], "shape"),
    ],
)
def test_bad_paths_are_refused(path, message):
    with pytest.raises(ValueError, match=message):
        predict_drift(path, NOISE)


@pytest.mark.parametrize(
    ("length", "message"), [(-1.0, "length_m >= 0, got -1"), (np.nan, "length_m finite"), ("1", "a number")]
)
def test_bad_runs_are_refused(length, message):
    with pytest.raises(ValueError, match=message):
        Run(length_m=length)


def test_bad_noise_and_bad_places_are_refused():
    with pytest.raises(ValueError, match="expected an OdometryNoise or one per run, got float"):
        predict_drift(ZIGZAG, 0.1)
    with pytest.raises(ValueError, match="one OdometryNoise per run, 3 in all, got 2"):
        predict_drift(ZIGZAG, [NOISE, NOISE])
    with pytest.raises(ValueError, match=r"distances on the path, in \[0, 22\.6\d+\] m, got 40\.0"):
        predict_drift(ZIGZAG, NOISE).at(40.0)
    with pytest.raises(ValueError, match="s finite, got nan"):
        predict_drift(ZIGZAG, NOISE).at([1.0, np.nan])
    with pytest.raises(ValueError, match=r"shape \(\) or \(k,\) for one path"):
        predict_drift(ZIGZAG, NOISE).at([[1.0], [2.0]])
    with pytest.raises(ValueError, match="no start_heading with a path of poses"):
        predict_drift(np.column_stack([ZIGZAG, np.zeros(4)]), NOISE, start_heading=1.0)
    with pytest.raises(ValueError, match=r"fixes on the path, at 0 to 22\.\d+ m, got one at s_m=30"):
        simulate_drift(ZIGZAG, NOISE, fixes=[Fix.position(30.0, position_std_m=0.1)])
    with pytest.raises(ValueError, match=r"fixes on the path, at 0 to 22\.\d+ m, got one at s_m=30"):
        predict_drift(ZIGZAG, NOISE, fixes=[Fix.position(30.0, position_std_m=0.1)])
    with pytest.raises(ValueError, match="one path with fixes, got a batch"):
        predict_drift(np.stack([ZIGZAG, ZIGZAG]), NOISE, fixes=[Fix.position(3.0, position_std_m=0.1)])
    with pytest.raises(ValueError, match="runs a whole number >= 1"):
        simulate_drift(ZIGZAG, NOISE, runs=0)
    with pytest.raises(ValueError, match="one path, got a batch"):
        simulate_drift(np.stack([ZIGZAG, ZIGZAG]), NOISE)
    with pytest.raises(ValueError, match="one shape"):
        Runs.from_odometry([1.0], [0.0, 1.0])
    with pytest.raises(ValueError, match="distances_m >= 0"):
        Runs.from_odometry([-1.0], [0.0])
    with pytest.raises(ValueError, match="spacing_m > 0"):
        predict_drift(ZIGZAG, NOISE).profile(0.0)


def test_results_cannot_be_changed():
    drift = predict_drift(ZIGZAG, NOISE)
    for array in (drift.distance, drift.moments.N, drift.moments.e1):
        with pytest.raises(ValueError, match="read-only"):
            array[1] = 99.0


def test_a_log_can_be_changed_after_it_was_read():
    distances = np.ones(3)
    log = Runs.from_odometry(distances, np.zeros(3))
    distances[:] = 5.0
    assert predict_drift(log, NOISE).length == 3.0


def test_same_seed_same_drives():
    one, two = (simulate_drift(ZIGZAG, NOISE, runs=5, rng=3) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, simulate_drift(ZIGZAG, NOISE, runs=5, rng=4))


def test_a_drift_prints_in_one_line():
    drift = predict_drift([(0, 0), (30, 0), (30, 10)], OdometryNoise.from_std(heading_deg=1, distance_m=0, after_m=10))
    assert repr(drift) == f"Drift(shape=(3,), greatest rms={drift.rms.max():.4g} m)"
    assert repr(drift.end) == f"PointDrift(distance=40 m, rms={drift.end.rms:.4g} m)"
