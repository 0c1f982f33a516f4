"""Drift in space: laws, then high-precision brute force, published numbers, the planar model and Monte Carlo."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.spatial.drift import predict_drift_3d, predict_flight_drift
from driftplan.model.spatial.rotations import RotationNoise
from driftplan.model.spatial.simulation import simulate_drift_3d
from driftplan.model.spatial.steps import flight_steps

COV = np.array([[0.03, 0.01, 0.0], [0.01, 0.02, 0.005], [0.0, 0.005, 0.01]])
BIAS = np.array([0.02, -0.01, 0.03])
TILTED = 0.3 * np.array([[0.05, 0.02, 0.0], [0.02, 0.04, 0.01], [0.0, 0.01, 0.09]])
NOISES = {
    "gaussian": RotationNoise.isotropic(0.12),
    "brownian": RotationNoise.brownian(0.2),
    "von Mises-Fisher": RotationNoise.von_mises_fisher(60.0),
    "anisotropic": RotationNoise.anisotropic(TILTED),
    "wide": RotationNoise.isotropic(2.0),
}
noises = st.sampled_from(list(NOISES))
seeds = st.integers(0, 10**6)


def motion(seed, n, turn=0.6):
    rng = np.random.default_rng(seed)
    return RotationNoise.isotropic(turn).sample(rng, n), rng.normal(size=(n, 3))


def about_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def assert_same(one, two, rtol=1e-12):
    """Equal to rounding of the largest value."""
    for name in ("position", "distance", "bias", "cov"):
        a, b = getattr(one, name), getattr(two, name)
        np.testing.assert_allclose(a, b, rtol=0, atol=rtol * max(np.abs(b).max(), 1e-300), err_msg=name)


# Laws


@settings(max_examples=30)
@given(seed=seeds, name=noises)
def test_rotating_the_world_rotates_bias_and_covariance(seed, name):
    R, t = motion(seed, 20)
    A = RotationNoise.isotropic(2.0).sample(np.random.default_rng(seed), 1)[0]
    turned = R.copy()
    turned[0] = A @ R[0]
    one, two = (predict_drift_3d(x, t, NOISES[name], COV, translation_bias=BIAS) for x in (R, turned))
    np.testing.assert_allclose(two.bias, one.bias @ A.T, rtol=0, atol=1e-12 * np.abs(one.bias).max())
    np.testing.assert_allclose(two.cov, A @ one.cov @ A.T, rtol=0, atol=1e-12 * np.abs(one.cov).max())


@settings(max_examples=30)
@given(seed=seeds, name=noises)
def test_what_happens_later_changes_nothing_earlier(seed, name):
    R, t = motion(seed, 20)
    whole, part = predict_drift_3d(R, t, NOISES[name], COV), predict_drift_3d(R[:9], t[:9], NOISES[name], COV)
    np.testing.assert_allclose(whole.bias[:10], part.bias, rtol=0, atol=1e-13 * np.abs(part.bias).max())
    np.testing.assert_allclose(whole.cov[:10], part.cov, rtol=0, atol=1e-13 * np.abs(part.cov).max())


@settings(max_examples=30)
@given(seed=seeds, name=noises, counts=st.lists(st.integers(0, 9), min_size=1, max_size=5))
def test_repeating_a_step_is_listing_it_that_often(seed, name, counts):
    R, t = motion(seed, len(counts))
    short = predict_drift_3d(R, t, NOISES[name], COV, translation_bias=BIAS, repeats=counts)
    if sum(counts) == 0:
        assert not short.rms.any()
        return
    listed = predict_drift_3d(
        np.repeat(R, counts, 0), np.repeat(t, counts, 0), NOISES[name], COV, translation_bias=BIAS
    )
    at = np.concatenate([[0], np.cumsum(counts)])
    for name in ("position", "distance", "bias", "cov"):
        expected = getattr(listed, name)[at]
        np.testing.assert_allclose(getattr(short, name), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@given(seed=seeds)
def test_no_noise_no_drift(seed):
    R, t = motion(seed, 30)
    for noise in (
        RotationNoise.isotropic(0.0),
        RotationNoise.brownian(0.0),
        RotationNoise.anisotropic(np.zeros((3, 3))),
    ):
        drift = predict_drift_3d(R, t, noise)
        assert not drift.bias.any()
        assert not drift.cov.any()
    flight = predict_flight_drift(t, rotation_var_per_m=0.0)
    assert not flight.rms.any()


@settings(max_examples=50)
@given(seed=seeds, std=st.sampled_from([1e-9, 1e-3, 0.1, 1.0, 3.0]), flat=st.booleans())
def test_covariances_are_symmetric_and_positive_semidefinite(seed, std, flat):
    R, t = motion(seed, 40)
    cov = std**2 * np.diag([1.0, 0.3, 0.0])
    noise = RotationNoise.anisotropic(cov) if flat else RotationNoise.isotropic(std)
    drift = predict_drift_3d(R, t, noise)
    np.testing.assert_allclose(drift.cov, np.swapaxes(drift.cov, 1, 2), rtol=0, atol=1e-14 * drift.cov.max())
    smallest = np.linalg.eigvalsh(drift.cov)[:, 0]
    # fourth-order variances are differences of second-order ones: rounding may turn them slightly negative
    assert (smallest >= -1e-13 * drift.rms**2).all()


def test_the_rms_depends_on_a_law_of_rotations_through_its_mean_only():
    """Of two rotations only R̃ R̃ᵀ = I enters |e|²: laws of equal E[R̃] give equal rms, though not equal covariance."""
    R, t = motion(3, 60)
    gaussian = RotationNoise.isotropic(0.8)
    brownian = RotationNoise.brownian((-np.log1p(-gaussian.decay[0])) ** 0.5)
    one, two = predict_drift_3d(R, t, gaussian), predict_drift_3d(R, t, brownian)
    np.testing.assert_allclose(one.rms, two.rms, rtol=1e-12)
    np.testing.assert_allclose(one.bias, two.bias, rtol=0, atol=1e-12)
    assert np.abs(one.cov - two.cov).max() > 1e-4


@settings(max_examples=50)
@given(seed=seeds, std=st.floats(0.001, 1.0), n=st.integers(1, 60))
def test_isotropic_rms_lies_between_the_bounds_of_its_additive_cost(seed, std, n):
    """Λ J <= E|e|² <= J, J = Σσ²|w|², σ² = -2 ln l1 (c = l1 in the planar bracket)."""
    R, t = motion(seed, n)
    noise = RotationNoise.brownian(std)
    drift = predict_drift_3d(R, t, noise)
    w = drift.position[-1] - drift.position[:-1]
    each = 2 * std**2
    J = each * (w**2).sum()
    assert np.exp(-n * each / 4) * J * (1 - 1e-12) <= drift.end.rms**2 <= J * (1 + 1e-12)


@settings(max_examples=50)
@given(seed=seeds, std=st.floats(0.001, 2.0), n=st.integers(1, 60))
def test_the_estimate_moves_at_least_as_far_as_theorem_1_says(seed, std, n):
    """E|p̂|² >= (1-c)/(1+c) Σ|t|² + Σ Tr P, the sharper fact behind the lower bound of Knuth and Barooah."""
    R, t = motion(seed, n)
    noise = RotationNoise.brownian(std)
    drift = predict_drift_3d(R, t, noise, COV)
    c = 1 - noise.decay[0]
    reached = drift.end.trace + ((drift.end.position + drift.end.bias) ** 2).sum()
    assert reached >= ((1 - c) / (1 + c) * (t**2).sum() + n * np.trace(COV)) * (1 - 1e-12)


# Brute force and published numbers


def kronecker_of_noise(ER, ERR):
    """E[N ⊗ N], N = [[R̃, 0], [0, 1]], 16x16."""
    N = np.full((4, 4, 4, 4), mp.mpf(0), dtype=object)  # N_ik,jl
    for i, j, k, l in np.ndindex(3, 3, 3, 3):
        N[i, k, j, l] = ERR(i, j, k, l)
    for i, j in np.ndindex(3, 3):
        N[i, 3, j, 3] = N[3, i, 3, j] = ER[i, j]
    N[3, 3, 3, 3] = mp.mpf(1)
    return N.reshape(16, 16)


def isotropic_tables(l1, l2):
    def same(a, b):
        return mp.mpf(a == b)

    def ERR(i, j, k, l):
        trace = same(i, k) * same(j, l) / 3
        straight, crossed = same(i, j) * same(k, l), same(i, l) * same(j, k)
        return trace + l1 * (straight - crossed) / 2 + l2 * ((straight + crossed) / 2 - trace)

    return l1 * mp.eye(3), ERR


def turning_tables(lost):
    """Rotation about z only: E cos θ = c, E cos 2θ = c⁴ (Gaussian), the planar model in space."""
    c, c4 = lost, lost**4
    cc, ss = (1 + c4) / 2, (1 - c4) / 2
    value = {(0, 0): c, (1, 1): c, (2, 2): mp.mpf(1)}
    pairs = {}
    for i, j, s in ((0, 0, 1), (1, 1, 1)):
        for k, l, u in ((0, 0, 1), (1, 1, 1)):
            pairs[i, j, k, l] = s * u * cc
    for i, j, s in ((0, 1, -1), (1, 0, 1)):
        for k, l, u in ((0, 1, -1), (1, 0, 1)):
            pairs[i, j, k, l] = s * u * ss

    def ERR(i, j, k, l):
        if (i, j) == (2, 2):
            return value.get((k, l), mp.mpf(0))
        if (k, l) == (2, 2):
            return value.get((i, j), mp.mpf(0))
        return pairs.get((i, j, k, l), mp.mpf(0))

    return mp.diag([c, c, 1]), ERR


def brute_force(R, t, ER, ERR, b, P):
    """E[e] and E[e eᵀ] at the end: the uncentred 16x16 recursion of E[H ⊗ H], backwards from its last column.

    One step is H = A N B with A = [[R, 0], [0, 1]], N as above, B = [[I, t + t̃], [0, 1]].
    """
    noise = kronecker_of_noise(ER, ERR)
    exact = np.vectorize(mp.mpf, otypes=[object])
    state, p = exact(np.eye(16)[15]), exact(np.zeros(3))
    spread = exact(np.zeros((4, 4)))
    spread[:3, :3] = P
    for Rk, tk in zip(R[::-1], t[::-1], strict=True):
        A, B = exact(np.eye(4)), exact(np.eye(4))
        A[:3, :3] = Rk
        B[:3, 3] = exact(tk) + exact(b)
        moved = np.kron(B, B)
        moved[:, 15] += spread.ravel()
        state = np.kron(A, A) @ (noise @ (moved @ state))
        p = exact(Rk) @ (tk + p)
    second = state.reshape(4, 4)
    mean = second[:3, 3] - p
    cross = np.outer(p, mean)
    return mean, second[:3, :3] - np.outer(p, p) - cross - cross.T


@pytest.mark.parametrize("kind", ["gaussian", "von Mises-Fisher", "about one axis"])
@pytest.mark.parametrize("std", [1e-12, 1e-8, 1e-3, 0.3, 2.5])
def test_moments_agree_with_the_16_by_16_kronecker_product_in_60_digits(kind, std):
    """For noise from 1e-12 rad to more than a full turn, relative to the size of the moments.

    The steps turn by multiples of 90 degrees, whose matrices floats represent exactly: else the reference, which is not
    centred, would take the matrices' roundings for noise.
    """
    rng = np.random.default_rng(5)
    n = 12
    R = np.eye(3)[rng.permuted(np.tile(np.arange(3), (n, 1)), axis=1)] * rng.choice([-1.0, 1.0], (n, 1, 3))
    R *= np.linalg.det(R).round()[:, None, None]
    t = rng.integers(-8, 9, (n, 3)) / 4
    b, P = (np.zeros(3), np.zeros((3, 3))) if std < 1e-3 else (BIAS, COV)
    with mp.workdps(60):
        s = mp.mpf(std)

        def lost(k):
            return 1 - (1 - k * k * s * s) * mp.exp(-k * k * s * s / 2)

        if kind == "gaussian":
            tables = isotropic_tables(1 - 2 * lost(1) / 3, 1 - 2 * (lost(1) + lost(2)) / 5)
            noise = RotationNoise.isotropic(std)
        elif kind == "von Mises-Fisher":
            kappa = 4 / s**2
            if kappa > 1e7:  # Bessel functions of huge argument: leading terms of Hankel's expansion do
                ratios = [
                    sum(
                        (-1) ** k
                        * mp.fprod(4 * v * v - (2 * i - 1) ** 2 for i in range(1, k + 1))
                        / (mp.factorial(k) * (8 * kappa) ** k)
                        for k in range(12)
                    )
                    for v in (1, 3, 5)
                ]
            else:
                ratios = [mp.besseli(v, kappa) for v in (1, 3, 5)]
            tables = isotropic_tables(ratios[1] / ratios[0], ratios[2] / ratios[0])
            noise = RotationNoise.von_mises_fisher(float(kappa))
        else:
            tables = turning_tables(mp.exp(-s * s / 2))
            noise = RotationNoise.anisotropic(np.diag([0.0, 0.0, std**2]))
        mean, square = brute_force(R, t, *tables, b, P)
    mean, square = mean.astype(float), square.astype(float)
    drift = predict_drift_3d(R, t, noise, P, translation_bias=b).end
    found = drift.cov + np.outer(drift.bias, drift.bias)
    np.testing.assert_allclose(drift.bias, mean, rtol=0, atol=1e-14 * np.abs(mean).max())
    np.testing.assert_allclose(found, square, rtol=0, atol=1e-14 * np.abs(square).max())


def test_published_helix():
    """1000 steps along a helix, Gaussian noise of 0.01 rad and 0.01 m."""
    noise = RotationNoise.isotropic(0.01)
    drift = predict_drift_3d([about_z(0.1)], [[0.1, 0.0, 0.02]], noise, 1e-4 * np.eye(3), repeats=1000).end
    np.testing.assert_allclose(drift.position, [-0.51282765578251, 0.11224809225675, 20.0], rtol=1e-12)
    np.testing.assert_allclose(drift.bias, [0.044264608997416, 0.084860460908766, -0.96844302288606], rtol=1e-11)
    np.testing.assert_allclose(drift.rms**2, 26.423679205902, rtol=1e-12)


def test_a_thousand_million_equal_steps_keep_their_digits():
    """Straight on: E|p̂|² = n + 2 Σ_{i<k} l1^(k-i) and E p̂ = Σ l1^k, summed in 50 digits."""
    n, std = 10**9, 1e-5
    with mp.workdps(50):
        x = mp.mpf(std) ** 2
        lost = 2 * (1 - (1 - x) * mp.exp(-x / 2)) / 3
        fade = -mp.expm1(n * mp.log1p(-lost))  # 1 - l1ⁿ
        bias = (1 - lost) * fade / lost - n
        spread = n + 2 * (1 - lost) / lost * (n - fade / lost)
        square = spread - 2 * n * bias - mp.mpf(n) ** 2
    for noise in (RotationNoise.isotropic(std), RotationNoise.anisotropic(std**2 * np.eye(3))):
        drift = predict_drift_3d([np.eye(3)], [[1.0, 0.0, 0.0]], noise, repeats=n).end
        np.testing.assert_allclose(drift.bias, [float(bias), 0, 0], rtol=1e-13, atol=1e-13 * abs(float(bias)))
        np.testing.assert_allclose(drift.rms**2, float(square), rtol=1e-13)


def test_each_step_may_have_its_own_noise():
    R, t = motion(2, 6)
    stds = np.array([0.1, 0.0, 0.3, 0.2, 0.05, 0.1])
    one = predict_drift_3d(
        R, t, RotationNoise.isotropic(stds), stds[:, None, None] * COV, translation_bias=stds[:, None] * BIAS
    )
    two = predict_drift_3d(
        R,
        t,
        RotationNoise.anisotropic(stds[:, None, None] ** 2 * np.eye(3)),
        stds[:, None, None] * COV,
        translation_bias=stds[:, None] * BIAS,
    )
    assert_same(one, two)
    once = predict_drift_3d(R[:1], t[:1], RotationNoise.isotropic(0.1), 0.1 * COV, translation_bias=0.1 * BIAS)
    np.testing.assert_allclose(one.cov[1], once.cov[1], rtol=1e-13)
    repeated = predict_drift_3d(
        R,
        t,
        RotationNoise.isotropic(stds),
        stds[:, None, None] * COV,
        translation_bias=stds[:, None] * BIAS,
        repeats=1,
    )
    assert_same(repeated, one)


# The planar model


@settings(max_examples=30)
@given(seed=seeds, std=st.sampled_from([1e-8, 0.01, 0.1, 1.0]))
def test_noise_about_the_vertical_on_a_level_path_is_the_planar_model(seed, std):
    rng = np.random.default_rng(seed)
    turns = rng.normal(size=25)
    heading = np.cumsum(turns)
    path = np.concatenate([[[0.0, 0.0]], np.cumsum(np.stack([np.cos(heading), np.sin(heading)], -1), axis=0)])
    planar = predict_drift(
        path,
        OdometryNoise.per_step(heading_std=std, distance_std=0.1 * std, lateral_std=0.05 * std, step_m=1.0),
    )
    space = predict_drift_3d(
        [about_z(turn) for turn in turns],
        [[1.0, 0.0, 0.0]] * 25,
        RotationNoise.anisotropic(np.diag([0.0, 0.0, std**2])),
        np.diag([0.01, 0.0025, 0.0]) * std**2,
    )
    np.testing.assert_allclose(space.bias[:, :2], planar.bias, rtol=0, atol=1e-12 * planar.bias_norm.max())
    # step lengths and headings of the path are rounded where those of the steps are not: 1e-16 over 25 steps
    np.testing.assert_allclose(space.cov[:, :2, :2], planar.cov, rtol=0, atol=1e-12 * planar.cov.max())
    np.testing.assert_allclose(space.rms, planar.rms, rtol=1e-12)
    assert not space.bias[:, 2].any()
    assert np.abs(space.cov[:, 2]).max() <= 1e-15 * planar.cov.max()


@settings(max_examples=30)
@given(seed=seeds, rate=st.sampled_from([1e-14, 1e-5, 0.01, 1.0]))
def test_a_flight_has_the_rms_of_a_drive_with_twice_the_heading_noise(seed, rate):
    """On a level path; the bias is the same too, since l1 = exp(-q s) is the c of heading variance 2q."""
    path = np.random.default_rng(seed).normal(size=(8, 2))
    level = np.column_stack([path, np.zeros(8)])
    planar = predict_drift(path, OdometryNoise(heading_var_per_m=2 * rate, distance_var_per_m=0.02 * rate))
    space = predict_flight_drift(level, rotation_var_per_m=rate, distance_var_per_m=0.02 * rate)
    np.testing.assert_allclose(space.rms, planar.rms, rtol=1e-11)
    np.testing.assert_allclose(space.bias[:, :2], planar.bias, rtol=0, atol=1e-12 * planar.bias_norm.max())
    np.testing.assert_allclose(space.distance, planar.distance, rtol=1e-14)


# Monte Carlo


def assert_within_four_standard_errors(errors, drift):
    """Mean and second moments at three points: 39 numbers, P(any beyond 4) below 0.3 %, and seeds are fixed."""
    for k in (1, errors.shape[1] // 2, -1):
        e, square = errors[:, k], drift.cov[k] + np.outer(drift.bias[k], drift.bias[k])
        pairs = e[:, :, None] * e[:, None, :]
        for drawn, exact in ((e, drift.bias[k]), (pairs, square), ((e**2).sum(-1), drift.rms[k] ** 2)):
            error = drawn.std(axis=0) / len(e) ** 0.5
            assert (np.abs(drawn.mean(axis=0) - exact) <= 4 * error).all()


@pytest.mark.parametrize("name", NOISES)
def test_monte_carlo_agrees(name):
    R, t = motion(8, 20)
    drift = predict_drift_3d(R, t, NOISES[name], COV, translation_bias=BIAS)
    errors = simulate_drift_3d(R, t, NOISES[name], COV, translation_bias=BIAS, runs=20_000, rng=4)
    assert_within_four_standard_errors(errors, drift)


def test_monte_carlo_agrees_when_every_step_differs():
    R, t = motion(9, 12)
    scale = np.linspace(0.2, 2.0, 12)
    noise = RotationNoise.anisotropic(scale[:, None, None] * TILTED)
    jitter = {"translation_cov": scale[:, None, None] * COV, "translation_bias": scale[:, None] * BIAS}
    errors = simulate_drift_3d(R, t, noise, **jitter, runs=20_000, rng=np.random.default_rng(1))
    assert_within_four_standard_errors(errors, predict_drift_3d(R, t, noise, **jitter))


def test_monte_carlo_of_a_flight_in_short_steps_agrees_with_continuous_noise():
    """200 steps of 0.05 m: each errs before it moves, which adds 0.75 % to E|e|², a third of a standard error."""
    path = [(0, 0, 0), (4, 0, 0), (4, 3, 0), (4, 3, 3)]
    steps = flight_steps(path, 0.05)
    noise = RotationNoise.brownian((0.02 * 0.05) ** 0.5)
    errors = simulate_drift_3d(*steps, noise, 0.001 * 0.05 * np.eye(3), runs=2000, rng=2)[:, -1]
    flight = predict_flight_drift(path, rotation_var_per_m=0.02, distance_var_per_m=0.001, lateral_var_per_m=0.001).end
    squares = (errors**2).sum(axis=-1)
    assert abs(squares.mean() - flight.rms**2) <= 4 * squares.std() / 2000**0.5
    assert (np.abs(errors.mean(axis=0) - flight.bias) <= 4 * errors.std(axis=0) / 2000**0.5).all()


# Flights


@settings(max_examples=30)
@given(seed=seeds, cut=st.floats(0.01, 0.99), rate=st.sampled_from([1e-16, 1e-3, 0.3]))
def test_cutting_a_flight_changes_nothing(seed, cut, rate):
    path = np.random.default_rng(seed).normal(size=(6, 3))
    rates = {"rotation_var_per_m": rate, "distance_var_per_m": 0.3 * rate, "lateral_var_per_m": 0.1 * rate}
    whole = predict_flight_drift(path, **rates)
    more = predict_flight_drift(np.insert(path, 3, (1 - cut) * path[2] + cut * path[3], axis=0), **rates)
    at = [0, 1, 2, 4, 5, 6]
    np.testing.assert_allclose(more.bias[at], whole.bias, rtol=0, atol=1e-13 * np.abs(whole.bias).max())
    np.testing.assert_allclose(more.cov[at], whole.cov, rtol=0, atol=1e-13 * np.abs(whole.cov).max())
    np.testing.assert_allclose(more.position[at], path, atol=1e-14)


def test_rates_may_differ_from_run_to_run():
    path = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 0, 0), (2, 5, 0)], dtype=float)
    drift = predict_flight_drift(path, rotation_var_per_m=[0.0, 0.1, 0.2, 0.0], distance_var_per_m=[0.01, 0, 0, 0.5])
    assert drift.rms[1] == pytest.approx(0.1)
    np.testing.assert_allclose(drift.cov[3], drift.cov[2])  # standing still
    perfect = predict_flight_drift(path, rotation_var_per_m=[0.0, 0.1, 0.2, 0.0], distance_var_per_m=[0.01, 0, 0, 0])
    extra = drift.end.trace - perfect.end.trace
    assert extra == pytest.approx(0.5 * 5)  # translation noise adds its variance whatever the attitude


def test_shapes_and_frozen_arrays():
    R, t = motion(1, 4)
    drift = predict_drift_3d(R, t, NOISES["gaussian"], COV)
    assert (drift.position.shape, drift.bias.shape, drift.cov.shape) == ((5, 3), (5, 3), (5, 3, 3))
    assert drift.rms.shape == drift.trace.shape == drift.bias_norm.shape == drift.largest_eigenvalue.shape == (5,)
    assert drift.end.rms == drift.rms[-1]
    np.testing.assert_allclose(drift.distance, np.concatenate([[0], np.cumsum(np.linalg.norm(t, axis=1))]))
    with pytest.raises(ValueError, match="read-only"):
        drift.bias[0, 0] = 1.0


def test_long_motions_are_flown_in_blocks_that_do_not_show():
    """More steps than one scan holds, against the same by powers; 1e4 roundings."""
    n = 10_000
    for name in ("gaussian", "anisotropic"):
        R, t = np.tile(about_z(0.01), (n, 1, 1)), np.tile([0.01, 0.0, 0.002], (n, 1))
        long = predict_drift_3d(R, t, NOISES[name], 1e-4 * COV)
        powers = predict_drift_3d(R[:1], t[:1], NOISES[name], 1e-4 * COV, repeats=n)
        np.testing.assert_allclose(long.end.position, powers.end.position, rtol=1e-10, atol=1e-11)
        np.testing.assert_allclose(long.end.cov, powers.end.cov, rtol=0, atol=1e-10 * long.end.trace)


# Bad input

GOOD = {"rotations": [np.eye(3)] * 3, "translations": np.ones((3, 3)), "rotation_noise": RotationNoise.isotropic(0.1)}


@pytest.mark.parametrize("repeats", [-1, 1.5, [1, 2], "twice", True])
def test_bad_repeats(repeats):
    with pytest.raises(ValueError, match="expected repeats to be an int >= 0 or 3 of them"):
        predict_drift_3d(**GOOD, repeats=repeats)


@pytest.mark.parametrize(
    ("path", "rates", "message"),
    [
        ([(0, 0, 0)], {}, "at least 2 waypoints, got 1"),
        ([(0, 0), (1, 0)], {}, r"shape \(n, 3\), got an array of shape \(2, 2\)"),
        ([(0, 0, 0), (1, 0, np.nan)], {}, r"waypoints finite, got nan at index \(1, 2\)"),
        ([(0, 0, 0), (1, 0, 0)], {"rotation_var_per_m": -1.0}, "rotation_var_per_m finite and >= 0, got -1.0"),
        ([(0, 0, 0), (1, 0, 0)], {"lateral_var_per_m": np.inf}, "lateral_var_per_m finite"),
        (
            [(0, 0, 0), (1, 0, 0)],
            {"distance_var_per_m": [1.0, 2.0]},
            "distance_var_per_m for all runs or one for each of 1",
        ),
        ([(0, 0, 0), (1, 0, 0)], {"distance_var_per_m": "some"}, "distance_var_per_m to be a number"),
    ],
)
def test_bad_flights_say_what_was_expected(path, rates, message):
    with pytest.raises(ValueError, match=message):
        predict_flight_drift(path, **({"rotation_var_per_m": 0.1} | rates))
