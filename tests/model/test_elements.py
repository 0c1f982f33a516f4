"""Runs and turns against arithmetic with many digits, against their own subdivision, and against Monte Carlo."""

from __future__ import annotations

from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model.elements import run_moments, turn_moments
from driftplan.model.heading_laws import law_moments
from driftplan.model.moments import Moments, compose, power
from driftplan.model.noise import OdometryNoise

NAMES = ("u", "p", "d1", "d2", "D", "e1", "N", "e2", "a", "b")


def exact_run(length, curvature, q, qd, ql):
    """Closed form of the moments of a run in exponentials, which needs many digits: E p̂, E|p̂|², E p̂² and their like,
    with the noise-free parts subtracted at the end."""
    L, k, q, qd, ql = (mp.mpf(x) for x in (length, curvature, q, qd, ql))
    j = mp.mpc(0, 1)

    def phi(z):
        return mp.mpf(1) if z == 0 else mp.expm1(z) / z

    u, p = mp.exp(j * k * L), L * phi(j * k * L)
    l1, l2, m1, m2 = j * k - q / 2, 2 * j * k - 2 * q, mp.exp(-q * L / 2), mp.exp(-2 * q * L)
    P1 = L * phi(l1 * L)
    PP = 2 * mp.re((mp.exp(l1 * L) - 1 - l1 * L) / l1**2) + (qd + ql) * L
    P2 = 2 / l1 * (mp.exp(l1 * L) * L * phi((l2 - l1) * L) - L * phi(l2 * L)) + (qd - ql) * L * phi(l2 * L)
    A, B = m1 * L * phi((j * k + q / 2) * L), m1 * L * phi((j * k - 3 * q / 2) * L)
    d1 = m1 - 1
    return {
        "u": u,
        "p": p,
        "d1": d1,
        "d2": m2 - 2 * m1 + 1,
        "D": -2 * d1,
        "e1": P1 - p,
        "N": PP - 2 * mp.re(mp.conj(p) * P1) + abs(p) ** 2,
        "e2": P2 - 2 * p * P1 + p * p,
        "a": A - P1 - p * d1,
        "b": B - P1 - p * d1,
    }


def worst_relative_error(X: Moments, exact) -> float:
    """Greatest error; d2, e2 and b may cross zero and are held against what Cauchy and Schwarz allow them."""
    scale = {name: abs(exact[name]) for name in NAMES}
    scale["d2"], scale["e2"], scale["b"] = exact["D"], exact["N"], mp.sqrt(exact["D"] * exact["N"])
    return max(float(abs(mp.mpmathify(complex(getattr(X, name))) - exact[name]) / scale[name]) for name in NAMES)


@pytest.mark.parametrize("curvature", [0.0, 1e-9, 0.02, -3.0])
@pytest.mark.parametrize("heading_std", [1e-12, 1e-9, 1e-6, 1e-3, 0.03, 0.3, 1.0, 3.0, 10.0])
def test_runs_are_exact_from_1e_minus_12_to_10_rad(heading_std, curvature):
    mp.mp.dps = 150  # the closed form loses up to 100 digits
    length, qd, ql = 7.0, 1e-3, 2e-4
    q = heading_std**2 / length
    noise = OdometryNoise(heading_var_per_m=q, distance_var_per_m=qd * q, lateral_var_per_m=ql * q)
    X = run_moments(np.array(length), np.array(curvature), noise)
    exact = exact_run(length, curvature, q, noise.distance_var_per_m, noise.lateral_var_per_m)
    # 5e-14: nine doublings of an element accurate to 1e-16
    assert worst_relative_error(X, exact) < 5e-14


def test_published_digits_of_three_runs():
    """80-digit values for (L, κ, q_h, q_d) = (100, 0, 1e-4, 1e-3), (100, 0.02, 1e-4, 1e-3), (10, 0.5, 0.05, 0.01)."""
    rates = [(100, 0, 1e-4, 1e-3), (100, 0.02, 1e-4, 1e-3), (10, 0.5, 0.05, 0.01)]
    e1 = [-0.249583853646267, -0.0502819210579319 - 0.217313523859481j, 0.505665421900528 + 0.196100862964727j]
    N = [33.3709165799355, 27.3177045565098, 4.52258260563543]
    e2 = [-32.881820900693, 20.3017368171595 - 14.3742347547112j, -1.13860783247583 - 0.260597957992188j]
    for k, (length, curvature, q, qd) in enumerate(rates):
        X = run_moments(np.array(float(length)), curvature, OdometryNoise(heading_var_per_m=q, distance_var_per_m=qd))
        np.testing.assert_allclose([X.e1, X.N, X.e2], [e1[k], N[k], e2[k]], rtol=2e-14)


continuous = st.builds(
    OdometryNoise,
    heading_var_per_m=st.sampled_from([0.0, 1e-6, 0.01, 0.5]),
    distance_var_per_m=st.sampled_from([0.0, 0.01]),
    lateral_var_per_m=st.sampled_from([0.0, 0.003]),
    heading_var_per_rad=st.sampled_from([0.0, 0.02]),
    distance_var_per_rad=st.sampled_from([0.0, 0.01]),
    heading_distance_corr=st.sampled_from([0.0, -0.7]),
    heading_bias_per_m=st.sampled_from([0.0, 0.05]),
    heading_bias_per_rad=st.sampled_from([0.0, -0.02]),
    distance_scale_error=st.sampled_from([0.0, 0.1]),
)


@settings(max_examples=40)
@given(noise=continuous, length=st.floats(0.1, 20), curvature=st.sampled_from([0.0, 0.3]), cut=st.floats(0.01, 0.99))
def test_cutting_a_run_changes_nothing(noise, length, curvature, cut):
    whole = run_moments(np.array(length), curvature, noise)
    halves = compose(
        run_moments(np.array(length * cut), curvature, noise),
        run_moments(np.array(length * (1 - cut)), curvature, noise),
    )
    for name in NAMES:  # rounding only, on the scale of a run of this length
        np.testing.assert_allclose(getattr(halves, name), getattr(whole, name), rtol=1e-11, atol=1e-13 * length**2)


@settings(max_examples=40)
@given(noise=continuous, turn=st.floats(-3, 3), cut=st.floats(0.01, 0.99))
def test_cutting_a_turn_changes_nothing(noise, turn, cut):
    whole = turn_moments(np.array(turn), noise)
    halves = compose(turn_moments(np.array(turn * cut), noise), turn_moments(np.array(turn * (1 - cut)), noise))
    for name in NAMES:
        np.testing.assert_allclose(getattr(halves, name), getattr(whole, name), rtol=1e-11, atol=1e-13)


@settings(max_examples=40)
@given(noise=continuous)
def test_a_standing_robot_does_not_drift(noise):
    for X in (run_moments(np.array(0.0), 0.2, noise), turn_moments(np.array(0.0), noise)):
        assert all(getattr(X, name) == 0 for name in NAMES[1:])
        assert X.u == 1


def test_a_run_counts_whole_steps():
    noise = OdometryNoise.per_step(heading_std=0.1, distance_std=0.0, step_m=1.0)
    lengths = np.array([0.0, 0.2, 1.0, 1.0 + 1e-10, 2.5, 1000.0])
    heading_var = -2 * np.log1p(run_moments(lengths, 0.0, noise).d1)
    np.testing.assert_allclose(heading_var, 0.01 * np.array([0, 1, 1, 1, 3, 1000]), rtol=1e-9)


def test_steps_tend_to_the_continuous_run():
    # one-sided steps: E|e|² is (1 + 3/2n + 1/2n²) times the limit, to first order in the noise
    limit = run_moments(np.array(10.0), 0.0, OdometryNoise(heading_var_per_m=1e-8)).N
    for n in (10, 100, 1000):
        noise = OdometryNoise(heading_var_per_m=1e-8, step_m=10.0 / n)
        ratio = run_moments(np.array(10.0), 0.0, noise).N / limit
        assert ratio == pytest.approx(1 + 3 / (2 * n) + 1 / (2 * n * n), rel=1e-6)


def test_an_arc_in_steps_ends_where_the_arc_ends():
    noise = OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=0.3)
    X, Y = (run_moments(np.array(4.0), 0.7, n) for n in (noise, OdometryNoise()))
    np.testing.assert_allclose([X.u, X.p], [Y.u, Y.p], rtol=1e-12)


@pytest.mark.parametrize("law", ["gaussian", "laplace", "uniform", "von_mises"])
@pytest.mark.parametrize("variance", [1e-24, 1e-12, 1e-6, 1e-3, 0.00199, 0.00201, 0.005, 0.02, 0.0999, 0.3, 4.0, 60.0])
def test_heading_laws_against_fifty_digits(law, variance):
    mp.mp.dps = 60
    v = mp.mpf(variance)

    def phi(k):
        if law == "gaussian":
            return mp.exp(-k * k * v / 2)
        if law == "laplace":
            return 1 / (1 + k * k * v / 2)
        if law == "uniform":
            w = k * mp.sqrt(3 * v)
            return mp.sin(w) / w
        if v < mp.mpf("1e-6"):  # the quotient of Bessel functions overflows: asymptotic series of A = I1/I0 in v
            A = 1 - v / 2 - v**2 / 8 - v**3 / 8 - 25 * v**4 / 128
            return A if k == 1 else 1 - 2 * A * v
        return mp.besseli(k, 1 / v) / mp.besseli(0, 1 / v)

    law_says = law_moments(law, np.array(variance))
    d1 = phi(1) - 1
    assert float(law_says.d1) == pytest.approx(float(d1), rel=3e-15)
    assert float(law_says.d2) == pytest.approx(float(phi(2) - 1 - 2 * d1), rel=3e-13, abs=1e-15 * float(-2 * d1))
    if law == "von_mises":
        return
    slope = {k: mp.diff(phi, k) for k in (1, 2)}  # E[θ exp(jkθ)] = -j φ'(k), E[θ² exp(jkθ)] = -φ''(k)
    scale = min(variance, 1.0)
    assert float(law_says.theta_r) == pytest.approx(float(-slope[1]), rel=1e-12, abs=1e-15 * scale)
    assert float(law_says.theta_r2) == pytest.approx(float(-slope[2]), rel=1e-12, abs=1e-15 * scale)
    assert float(law_says.theta2_r2) == pytest.approx(float(-mp.diff(phi, 2, 2)), rel=1e-12, abs=1e-15 * scale)


@pytest.mark.parametrize("share", [0.8, -0.5])
def test_a_distance_error_that_goes_with_the_headings_is_a_multiple_of_it(share):
    """On a straight run ∫ exp(jθ) dτ of the part τ = slope·θ is slope (exp(jθ) - 1)/j = -j slope δ, by the chain rule;
    what is left of the distance error is independent."""
    q, qd, length = 0.03, 0.02, np.array([0.1, 4.0, 30.0])
    slope = share * np.sqrt(qd / q)
    noise = OdometryNoise(heading_var_per_m=q, distance_var_per_m=qd * (1 - share**2), lateral_var_per_m=0.004)
    X = run_moments(length, 0.0, noise)
    found = run_moments(length, 0.0, replace(noise, distance_var_per_m=qd, heading_distance_corr=share))
    expected = {
        "d1": X.d1,
        "d2": X.d2,
        "D": X.D,
        "e1": X.e1 - 1j * slope * X.d1,
        "N": X.N + slope**2 * X.D + 2 * np.real(1j * slope * X.a),
        "e2": X.e2 - slope**2 * X.d2 - 2j * slope * X.b,
        "a": X.a - 1j * slope * X.D,
        "b": X.b - 1j * slope * X.d2,
    }
    for name, value in expected.items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=1e-12, err_msg=name)


EVERY_STEP = OdometryNoise.per_step(heading_std=0.3, distance_std=0.2, lateral_std=0.1, step_m=1.5)
SLANTED = replace(
    EVERY_STEP,
    heading_var_per_m=0.02,
    distance_var_per_m=0.03,
    lateral_var_per_m=0.005,
    heading_var_per_rad=0.04,
    distance_var_per_rad=0.02,
    heading_distance_corr=-0.6,
    heading_bias_per_m=0.1,
    heading_bias_per_rad=-0.05,
    distance_scale_error=0.15,
)


def averaged_step(u, p, facing, theta, heading_std, along, across):
    """Moments of û = u r and p̂ = r (p + τ·facing), r = exp(jθ), by quadrature: θ of mean ``theta``; the error τ along
    the way has the mean ``along[0]``, rises by ``along[1]`` per radian of θ's own error and has the variance
    ``along[2]`` beside that; across it has the variance ``across``."""
    x, weight = np.polynomial.hermite_e.hermegauss(60)
    few, of_few = np.polynomial.hermite_e.hermegauss(4)
    own, rest, side = np.meshgrid(x * heading_std, few * np.sqrt(along[2]), few * np.sqrt(across), indexing="ij")
    w = weight[:, None, None] * of_few[:, None] * of_few / (2 * np.pi) ** 1.5
    r = np.exp(1j * (theta + own))
    d, e = r - 1, r * (p + (along[0] + along[1] * own + rest + 1j * side) * facing) - p
    means = [np.sum(w * value) for value in (d, d * d, abs(d) ** 2, e, abs(e) ** 2, e * e, e * np.conj(d), e * d)]
    return Moments(u, p, *means)


@pytest.mark.parametrize("noise", [EVERY_STEP, SLANTED])
@pytest.mark.parametrize("curvature", [0.0, 0.8, -1.1])
def test_one_step_is_the_average_over_its_errors(noise, curvature):
    length, bend = 1.5, abs(curvature)
    u = np.exp(1j * curvature * length)
    p = (u - 1) / (1j * curvature) if curvature else length
    heading_var = 0.3**2 + (noise.heading_var_per_m + noise.heading_var_per_rad * bend) * length
    distance_var = 0.2**2 + (noise.distance_var_per_m + noise.distance_var_per_rad * bend) * length
    share = noise.heading_distance_corr
    along = noise.distance_scale_error * length, share * np.sqrt(distance_var / heading_var)
    expected = averaged_step(
        u,
        p,
        p / abs(p),
        (noise.heading_bias_per_m + noise.heading_bias_per_rad * curvature) * length,
        np.sqrt(heading_var),
        (*along, distance_var * (1 - share**2)),
        0.1**2 + noise.lateral_var_per_m * length,
    )
    found = run_moments(np.array(length), np.array(curvature), noise)
    for name in NAMES:
        assert complex(getattr(found, name)) == pytest.approx(complex(getattr(expected, name)), abs=1e-13), name


@pytest.mark.parametrize("turn", [0.0, 1.3, -2.0])
@pytest.mark.parametrize("share", [0.0, -0.6])
def test_a_turn_in_steps_is_the_average_over_its_errors(turn, share):
    noise = replace(SLANTED, heading_distance_corr=share)
    heading_var, distance_var = 0.04 * abs(turn), 0.02 * abs(turn)
    slope = share * np.sqrt(0.5)
    u = np.exp(1j * turn)
    expected = averaged_step(
        u, 0.0, u, -0.05 * turn, np.sqrt(heading_var), (0.0, slope, distance_var * (1 - share**2)), 0.0
    )
    found = turn_moments(np.array(turn), noise)
    for name in NAMES:
        assert complex(getattr(found, name)) == pytest.approx(complex(getattr(expected, name)), abs=1e-13), name


def test_a_billion_steps_are_one_power():
    noise = OdometryNoise.per_step(heading_std=1e-6, distance_std=1e-3, step_m=1.0)
    X = run_moments(np.array(1e9), 0.0, noise)
    # σ_H² = 1e-12 * 1e9: the straight-run closed form at x = 1e-3, steps being negligible against the run
    x = 1e-3
    expected = 1e18 * (x / 3 - x**2 / 16 + x**3 / 120) + 1e-6 * 1e9
    assert float(X.N) == pytest.approx(expected, rel=1e-8)
    assert power(run_moments(np.array(1.0), 0.0, noise), 10**9).N == X.N


def test_a_dense_log_is_its_pieces():
    noise = OdometryNoise(
        heading_var_per_m=1e-3, distance_var_per_m=1e-3, heading_bias_per_m=0.1, heading_distance_corr=0.3
    )
    rng = np.random.default_rng(0)
    lengths, curvatures = rng.uniform(0, 2, 20_000), rng.normal(0, 0.3, 20_000)
    together = run_moments(lengths, curvatures, noise)
    for k in (0, 8191, 8192, 19_999):  # either side of a block's border
        alone = run_moments(lengths[k : k + 1], curvatures[k : k + 1], noise)
        for name in NAMES:
            np.testing.assert_allclose(getattr(together, name)[k], getattr(alone, name)[0], rtol=1e-13, atol=1e-18)


@pytest.mark.parametrize("curvature", [0.0, 0.3])
@pytest.mark.parametrize("bias", [0.01, 2.0])
def test_what_errs_to_the_right_mirrors_what_errs_to_the_left(curvature, bias):
    noise = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3, heading_bias_per_m=bias)
    left = run_moments(np.array(20.0), np.array(curvature), noise)
    right = run_moments(np.array(20.0), np.array(-curvature), replace(noise, heading_bias_per_m=-bias))
    for one, other in zip(left.arrays(), right.arrays(), strict=True):
        np.testing.assert_allclose(one, np.conj(other), rtol=1e-12)
