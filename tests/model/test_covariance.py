"""The filter's covariances: against the sheet's formulas and filters with plain matrices, and the laws they obey."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model.covariance import CovarianceMap, compose, identity, path_legs
from driftplan.model.filter_state import FilterState, bearing_row, heading_row, position_rows, range_row
from driftplan.model.noise import OdometryNoise, SystematicSpread
from driftplan.model.paths import Run, read_path

QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
EVERYTHING = OdometryNoise(
    heading_var_per_m=1e-4,
    distance_var_per_m=1e-3,
    lateral_var_per_m=3e-4,
    heading_var_per_rad=2e-3,
    distance_var_per_rad=5e-4,
    heading_distance_corr=0.4,
)


def sheet_leg(d, q_h=0.0, q_d=0.0, q_l=0.0):
    """A straight leg as the formula sheet gives it."""
    length = np.hypot(*d)
    u = d / length
    n = QUARTER_TURN @ u
    A, C = np.eye(3), np.zeros((3, 3))
    A[:2, 2] = QUARTER_TURN @ d
    C[2, 2] = q_h * length
    C[:2, 2] = C[2, :2] = q_h * length**2 / 2 * n
    C[:2, :2] = q_h * length**3 / 3 * np.outer(n, n) + length * (q_d * np.outer(u, u) + q_l * np.outer(n, n))
    return A, C


def plain_reading(P, H, R):
    """A Kalman update in Joseph's form, with plain matrices."""
    K = P @ H.T @ np.linalg.pinv(H @ P @ H.T + R)
    rest = np.eye(len(P)) - K @ H
    return rest @ P @ rest.T + K @ R @ K.T


def random_position_cov(rng):
    root = rng.normal(size=(2, 2)) * 0.1
    return root @ root.T


def random_reading(rng):
    """Rows, and the same as H and R."""
    kind = rng.integers(5)
    if kind == 0:
        R = random_position_cov(rng)
        return position_rows(R), np.eye(3)[:2], R
    if kind == 1:
        variance = rng.uniform(1e-6, 1e-2)
        return (heading_row(variance),), np.eye(3)[2:], np.array([[variance]])
    if kind == 2:
        R = np.diag(rng.uniform(1e-4, 1e-1, 2))
        full = np.zeros((3, 3))
        full[:2, :2], full[2, 2] = R, 1e-3
        return (*position_rows(R), heading_row(1e-3)), np.eye(3), full
    towards, std = rng.normal(size=2) * 5, rng.uniform(0.01, 0.3)
    rho = np.hypot(*towards)
    if kind == 3:
        return (range_row(towards, std**2),), np.append(-towards / rho, 0.0)[None], np.array([[std**2]])
    H = np.append(QUARTER_TURN @ -towards / rho**2, -1.0)[None]
    return (bearing_row(towards, std**2),), H, np.array([[std**2]])


def random_run(rng):
    return Run(
        length_m=rng.uniform(0, 8) * (rng.random() < 0.9),
        curvature_per_m=rng.uniform(-2, 2) * (rng.random() < 0.5),
        turn_rad=rng.uniform(-4, 4) * (rng.random() < 0.7),
    )


def random_elements(rng, count):
    path = path_legs(read_path([random_run(rng) for _ in range(count)]), [EVERYTHING]).maps
    return [path[k].read(random_reading(rng)[0] if rng.random() < 0.5 else ()) for k in range(count)]


def scaled_difference(X: CovarianceMap, Y: CovarianceMap) -> float:
    return max(np.abs(x - y).max() / max(np.abs(x).max(), 1e-300) for x, y in zip(X.arrays(), Y.arrays(), strict=True))


def test_straight_legs_are_those_of_the_sheet():
    rng = np.random.default_rng(1)
    noise = OdometryNoise(heading_var_per_m=2e-4, distance_var_per_m=3e-3, lateral_var_per_m=5e-4)
    points = np.cumsum(rng.normal(size=(20, 2)) * 8, axis=0)
    found = path_legs(read_path(points), [noise])
    for k, d in enumerate(np.diff(points, axis=0)):
        A, C = sheet_leg(d, 2e-4, 3e-3, 5e-4)
        np.testing.assert_allclose(found.A[k], A, atol=1e-12 * np.abs(A).max())
        np.testing.assert_allclose(found.C[k], C, atol=1e-11 * np.abs(C).max())


def test_arcs_and_turns_are_the_sum_of_their_increments():
    """Noise enters on every millimetre and hundredth of a degree, and turns what is driven after it."""
    n, length, curvature, turn, q_h, q_d, q_l, q_r, q_t = 20000, 5.0, 0.4, -2.0, 1e-4, 2e-3, 3e-4, 1e-3, 4e-4
    noise = OdometryNoise(
        heading_var_per_m=q_h,
        distance_var_per_m=q_d,
        lateral_var_per_m=q_l,
        heading_var_per_rad=q_r,
        distance_var_per_rad=q_t,
    )
    start, middle = 0.7, (np.arange(n) + 0.5) / n
    along_turn, along_run = start + turn * middle, start + turn + curvature * length * middle
    driven = np.cumsum(np.exp(1j * along_run)) * length / n
    end = driven[-1]
    lever = 1j * (end - (driven - 0.5 * np.exp(1j * along_run) * length / n))
    heading = np.r_[np.full(n, q_r * 2.0), np.full(n, (q_h + 0.4 * q_r) * length)] / n
    distance = np.r_[np.full(n, q_t * 2.0), np.full(n, (q_d + 0.4 * q_t) * length)] / n
    lateral = np.r_[np.zeros(n), np.full(n, q_l * length)] / n
    levers, facing = np.r_[np.full(n, 1j * end), lever], np.exp(1j * np.r_[along_turn, along_run])
    C, none = np.zeros((3, 3)), np.zeros(2 * n)
    for z, theta, variance in ((levers, none + 1, heading), (facing, none, distance), (1j * facing, none, lateral)):
        x = np.stack([z.real, z.imag, theta])
        C += (x * variance) @ x.T
    found = path_legs(read_path([Run(length_m=length, curvature_per_m=curvature, turn_rad=turn)], start), [noise])
    np.testing.assert_allclose(found.C[0], C, atol=1e-7 * np.abs(C).max())
    np.testing.assert_allclose(found.A[0][:2, 2], [(1j * end).real, (1j * end).imag], atol=1e-7)


def test_noise_per_step_draws_the_heading_first():
    noise = OdometryNoise.per_step(heading_std=0.02, distance_std=0.03, step_m=1.0, heading_distance_corr=0.5)
    C = path_legs(read_path([(0, 0), (4, 0)]), [noise]).C[0]
    levers = np.array([4.0, 3.0, 2.0, 1.0])
    expected = np.diag([4 * 0.03**2, 0.02**2 * (levers**2).sum(), 4 * 0.02**2])
    expected[1, 2] = expected[2, 1] = 0.02**2 * levers.sum()
    expected[0, 2] = expected[2, 0] = 4 * 0.5 * 0.02 * 0.03
    expected[0, 1] = expected[1, 0] = 0.5 * 0.02 * 0.03 * levers.sum()
    np.testing.assert_allclose(C, expected, atol=1e-12)


@pytest.mark.parametrize("law", ["laplace", "uniform", "von_mises"])
def test_the_law_of_a_steps_heading_error_does_not_matter_to_a_linear_filter(law):
    noise = OdometryNoise.per_step(heading_std=0.02, distance_std=0.03, step_m=0.5)
    path = read_path([(0, 0), (4, 0), (4, 3)])
    np.testing.assert_allclose(
        path_legs(path, [replace(noise, heading_law=law)]).C, path_legs(path, [noise]).C, rtol=1e-6, atol=1e-14
    )


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.99))
@settings(max_examples=30)
def test_cutting_a_leg_changes_nothing(seed, share):
    rng = np.random.default_rng(seed)
    run = replace(random_run(rng), length_m=rng.uniform(0.1, 8))
    first = replace(run, length_m=run.length_m * share)
    second = Run(length_m=run.length_m * (1 - share), curvature_per_m=run.curvature_per_m)
    noise = replace(EVERYTHING, heading_bias_per_m=0.01, heading_bias_per_rad=0.02, distance_scale_error=0.03)
    spread = SystematicSpread(heading_bias_per_m=0.01, heading_bias_per_rad=0.02, distance_scale_error=0.03)
    whole, parts = (path_legs(read_path(runs), [noise], None, spread) for runs in ([run], [first, second]))
    a, b = parts.maps[0], parts.maps[1]
    assert scaled_difference(whole.maps[0], compose(a, b)) < 1e-9
    np.testing.assert_allclose(parts.A[1] @ parts.shift[0] + parts.shift[1], whole.shift[0], atol=1e-9)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_composition_is_associative_and_has_an_identity(seed):
    a, b, c = random_elements(np.random.default_rng(seed), 3)
    assert scaled_difference(compose(compose(a, b), c), compose(a, compose(b, c))) < 1e-9
    assert scaled_difference(compose(a, identity()), a) < 1e-13
    assert scaled_difference(compose(identity(), a), a) < 1e-13


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_elements_states_and_plain_matrices_agree(seed):
    rng = np.random.default_rng(seed)
    count = 25
    path = path_legs(read_path([random_run(rng) for _ in range(count)]), [EVERYTHING])
    readings = [random_reading(rng) for _ in range(count)]
    P = np.diag([*rng.uniform(0, 0.1, 2), 0.01])
    plain, state = P, FilterState.from_matrix(P)
    upto = identity()
    for k, (leg, (rows, H, R)) in enumerate(zip(path.columns(), readings, strict=True)):
        plain = path.A[k] @ plain @ path.A[k].T + path.C[k]
        plain = plain_reading(plain, H, R)
        state = state.driven(leg).read(rows)
        scale = np.sqrt(np.outer(plain.diagonal(), plain.diagonal())) + 1e-12
        assert (np.abs(state.matrix - plain) / scale).max() < 1e-7
        upto = compose(upto, path.maps[k].read(rows))
        assert (np.abs(upto(P) - plain) / scale).max() < 1e-5


@given(st.integers(0, 10**9))
def test_a_mean_error_of_nothing_changes_no_bit_of_the_covariance(seed):
    rng, noise = np.random.default_rng(seed), OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    legs = path_legs(read_path(np.cumsum(rng.normal(size=(8, 2)), axis=0)), [noise]).columns()
    plain = systematic = FilterState.at_start()
    systematic = replace(systematic, mean=(0.0, 0.0, 0.0))
    for leg in legs:
        plain, systematic = (s.driven(leg).read(position_rows(0.01 * np.eye(2))) for s in (plain, systematic))
        assert plain.P == systematic.P


def test_thousands_of_drives_at_once_are_each_as_if_alone():
    rng = np.random.default_rng(5)
    path = path_legs(read_path(np.cumsum(rng.normal(size=(12, 2)) * 5, axis=0)), [EVERYTHING])
    rows = [random_reading(rng)[0] for _ in range(11)]
    asked = rng.random((50, 11)) < 0.5
    many = FilterState.from_matrix(np.zeros((50, 3, 3)))
    for k, leg in enumerate(path.columns()):
        many = many.driven(leg).read(rows[k], asked[:, k].astype(float))
    for drive in range(50):
        one = FilterState.at_start()
        for k, leg in enumerate(path.columns()):
            one = one.driven(leg)
            one = one.read(rows[k]) if asked[drive, k] else one
        np.testing.assert_allclose(many.matrix[drive], one.matrix, rtol=1e-12, atol=1e-15)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_a_further_reading_never_hurts_and_order_is_kept(seed):
    rng = np.random.default_rng(seed)
    path = path_legs(read_path([random_run(rng) for _ in range(12)]), [EVERYTHING])
    root = rng.normal(size=(3, 3)) * 0.1
    fewer, more = FilterState.from_matrix(root @ root.T), FilterState.from_matrix(root @ np.diag([1, 0.5, 0]) @ root.T)
    for leg in path.columns():
        rows = random_reading(rng)[0]
        read, also = rng.random() < 0.4, rng.random() < 0.3
        chance = rng.uniform(0, 1)
        fewer, more = fewer.driven(leg), more.driven(leg)
        fewer = fewer.read(rows, chance * 0.7 if not read else None) if read or chance < 0.5 else fewer
        more = more.read(rows, None if read or also else chance) if read or also or chance < 0.5 else more
        gap = np.linalg.eigvalsh(fewer.matrix - more.matrix).min()
        assert gap >= -1e-9 * np.trace(fewer.matrix) - 1e-13


@pytest.mark.parametrize("apart_m", [5.0, 10.0, 20.0])
def test_two_position_fixes_tell_the_heading(apart_m):
    R = 0.01 * np.eye(2)
    leg = path_legs(read_path([(0, 0), (apart_m, 0)]), [OdometryNoise()]).columns()[0]
    state = (
        FilterState.from_matrix(np.diag([100.0, 100.0, 1.0])).read(position_rows(R)).driven(leg).read(position_rows(R))
    )
    assert np.sqrt(state.matrix[2, 2]) == pytest.approx(np.sqrt(2 * 0.01) / apart_m, rel=3e-3)


def test_perfect_readings_leave_nothing_and_need_no_inverse():
    cov = np.array([[0.3, 0.1, 0.05], [0.1, 0.2, -0.03], [0.05, -0.03, 0.04]])
    state = FilterState.from_matrix(cov)
    exact = state.read(position_rows(np.zeros((2, 2))))
    assert (exact.matrix[:2] == 0).all()
    assert exact.matrix[2, 2] > 0
    given_position = cov[2, 2] - cov[2, :2] @ np.linalg.solve(cov[:2, :2], cov[:2, 2])
    assert exact.matrix[2, 2] == pytest.approx(given_position, rel=1e-12)
    assert (exact.read(position_rows(np.zeros((2, 2)))).matrix == exact.matrix).all()
    assert (exact.read((heading_row(0.0),)).matrix == 0).all()
    along = range_row(np.array([3.0, 4.0]), 0.0)
    ranged = state.read((along,)).read((along,))
    assert abs(np.array([0.6, 0.8]) @ ranged.matrix[:2, :2] @ [0.6, 0.8]) < 1e-15
    assert np.linalg.eigvalsh(ranged.matrix).min() > -1e-15


def test_a_perfect_reading_in_an_element_is_exact_once_noise_has_entered():
    leg = path_legs(read_path([(0, 0), (5, 2)]), [EVERYTHING])
    P = np.diag([0.1, 0.2, 0.01])
    rows = position_rows(np.zeros((2, 2)))
    after = FilterState.from_matrix(P).driven(leg.columns()[0]).read(rows)
    np.testing.assert_allclose(leg.maps[0].read(rows)(P), after.matrix, atol=1e-12)
    floored = identity().read(rows)(P)  # infinite information: counts as a micrometre
    assert 0 < floored[0, 0] < 2e-12
    assert floored[2, 2] == pytest.approx(0.01)


def test_a_reading_far_better_than_the_estimate_keeps_its_digits():
    state = FilterState.from_matrix(np.diag([1e8, 1e8, 1.0])).read(position_rows(1e-10 * np.eye(2)))
    assert state.trace == pytest.approx(2e-10, rel=1e-12)


def test_missed_readings_are_bounded_from_above():
    p, R = 0.8, position_rows(0.01 * np.eye(2))
    path = path_legs(read_path([(0, 0), (10, 0), (10, 10), (20, 10), (20, 20)]), [EVERYTHING]).columns()
    bound = FilterState.at_start()
    drives, rng = FilterState.from_matrix(np.zeros((4000, 3, 3))), np.random.default_rng(3)
    for leg in path:
        bound, drives = bound.driven(leg), drives.driven(leg)
        mean = drives.trace.mean()
        assert mean * 0.97 < bound.trace < mean * 1.25
        bound, drives = bound.read(R, p), drives.read(R, (rng.random(4000) < p).astype(float))


def test_an_unknown_constant_is_learnt_from_readings_and_a_known_bias_is_not():
    path = read_path([(4.0 * k, 0.0) for k in range(60)])
    R = position_rows(1e-4 * np.eye(2))
    spread = SystematicSpread(heading_bias_per_m=0.005, distance_scale_error=0.02)
    learning = FilterState.at_start(constants_var=spread.variances)
    for leg in path_legs(path, [EVERYTHING], None, spread).columns():
        learning = learning.driven(leg).read(R)
    assert np.sqrt(learning.matrix[3, 3]) < 0.002
    assert np.sqrt(learning.matrix[4, 4]) < 0.006
    biased = replace(EVERYTHING, heading_bias_per_m=0.005)
    believing = FilterState.at_start()
    for leg in path_legs(path, [biased]).columns():
        believing = believing.driven(leg)
        before = believing.mean
        believing = believing.read(R)
    assert before[1] > 0.02
    assert believing.mean[1] < before[1]


def test_known_biases_shift_the_mean_as_one_drives():
    path = read_path([Run(length_m=6.0), Run(length_m=3.0, turn_rad=1.0)])
    noise = OdometryNoise(heading_bias_per_m=1e-5, heading_bias_per_rad=2e-5, distance_scale_error=3e-5)
    state = FilterState.at_start()
    for leg in path_legs(path, [noise]).columns():
        state = state.driven(leg)
    heading = np.cumsum(np.full(600000, 1e-5 * 1e-5)) - 0.5e-10
    first = np.exp(1j * heading).sum() * 1e-5 * (1 + 3e-5)
    then = 6e-5 + 1.0 + 2e-5 + (np.arange(300000) + 0.5) * 1e-5 * 1e-5
    end = first + np.exp(1j * then).sum() * 1e-5 * (1 + 3e-5)
    e = end - (6 + 3 * np.exp(1j))
    np.testing.assert_allclose(state.mean[:2], [e.real, e.imag], atol=1e-7)
    assert state.mean[2] == pytest.approx(9e-5 + 2e-5)


def test_zones_have_their_own_noise():
    other = replace(EVERYTHING, heading_var_per_m=5e-4)
    path = read_path([(0, 0), (5, 0), (5, 5), (9, 5)])
    mixed = path_legs(path, [EVERYTHING, other], np.array([0, 1, 0]))
    for k, noise in enumerate((EVERYTHING, other, EVERYTHING)):
        np.testing.assert_array_equal(mixed.C[k], path_legs(path, [noise]).C[k])


def test_many_paths_at_once():
    paths = np.random.default_rng(2).normal(size=(7, 5, 2))
    together = path_legs(read_path(paths), [EVERYTHING])
    assert together.C.shape == (7, 4, 3, 3)
    np.testing.assert_allclose(together.C[3], path_legs(read_path(paths[3]), [EVERYTHING]).C, atol=1e-16)


def test_anchors_on_the_path_are_refused():
    with pytest.raises(ValueError, match="away from the path"):
        range_row(np.zeros(2), 0.1)
    with pytest.raises(ValueError, match="away from the path"):
        bearing_row(np.zeros(2), 0.1)


def test_an_independent_kalman_filter_agrees():
    kalman = pytest.importorskip("filterpy.kalman", reason="filterpy is not installed")
    rng = np.random.default_rng(11)
    path = path_legs(read_path([random_run(rng) for _ in range(15)]), [EVERYTHING])
    peer = kalman.KalmanFilter(dim_x=3, dim_z=2)
    peer.P, peer.H, peer.R = np.zeros((3, 3)), np.eye(3)[:2], 0.01 * np.eye(2)
    state = FilterState.at_start()
    for k, leg in enumerate(path.columns()):
        peer.predict(F=path.A[k], Q=path.C[k])
        peer.update(np.zeros(2))
        state = state.driven(leg).read(position_rows(peer.R))
        np.testing.assert_allclose(state.matrix, peer.P, atol=1e-13)
