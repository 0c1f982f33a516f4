"""Theorems 1 to 3: bounds that hold, closed forms that equal the algebra and plain sums, and the printed formulas
refuted by Monte Carlo."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.literature import (
    MeanNoise,
    StepNoise,
    dead_reckoning,
    second_moment_lower_bound,
    step_moments,
    theorem_1,
    theorem_2,
    theorem_3,
)
from driftplan.model.moments import power

TURN = 2 * np.pi * 47 / 3020  # the circle of Section 4.3
CHORD = 0.064 * -1j * np.exp(-0.5j * TURN)


def as_vector(z: complex) -> tuple[float, float]:
    return z.real, z.imag


def section_4_noise(translation: complex, heading_mean: float = 0.0) -> StepNoise:
    """The noise stated for the simulations: Laplace rotation (scale 3.6e-3 rad) and direction, distance of any law."""
    return StepNoise.polar(
        translation_m=as_vector(translation),
        heading_std_rad=3.6e-3 * 2**0.5,
        heading_mean_rad=heading_mean,
        direction_std_rad=3.07e-2**0.5,
        distance_std_m=8.5467e-5**0.5,
    )


def random_noise(rng: np.random.Generator, *, dependent: bool = True) -> StepNoise:
    def some(scale):
        return rng.normal(0, scale, 2) * rng.integers(0, 2)

    return StepNoise.additive(
        heading_std_rad=10 ** rng.uniform(-3, 0.3),
        heading_mean_rad=float(rng.normal(0, 0.1) * rng.integers(0, 2)),
        heading_law=str(rng.choice(["gaussian", "laplace", "uniform"])),
        translation_bias_m=some(0.1),
        translation_cov_m2=np.eye(2) * 10 ** rng.uniform(-5, 0),
        gain_m_per_rad=some(0.5) if dependent else (0.0, 0.0),
    )


def random_motion(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    style = rng.integers(0, 4)
    turns = [rng.normal(0, 0.3, n), np.zeros(n), np.full(n, rng.normal(0, 0.5)), rng.choice([-np.pi / 2, 0, np.pi], n)]
    length, direction = rng.uniform(0, 1, n), rng.normal(0, 1, n) * rng.integers(0, 2)
    return turns[style], np.stack([length * np.cos(direction), length * np.sin(direction)], axis=-1)


# --- steps with errors of any law -------------------------------------------------------------------------------------

FIVE_TURNS = (0.3, -0.5, 0.8, 1.2, -0.4)
FIVE_MOVES = ((1.0, 0.1), (0.8, 0.0), (1.5, -0.2), (0.6, 0.0), (2.0, 0.3))
UNEVEN = {"translation_bias_m": (0.02, -0.01), "translation_cov_m2": [[0.03, 0.01], [0.01, 0.02]]}


def test_five_uneven_steps_have_the_reference_digits():
    """60-digit recursion that shares no code with the algebra."""
    noise = StepNoise.additive(heading_std_rad=0.1, heading_mean_rad=0.02, **UNEVEN)
    end = dead_reckoning(FIVE_TURNS, FIVE_MOVES, noise).moments[-1]
    expected = {
        "p": 2.96874775776408 + 3.52021315942238j,
        "d1": -0.0295625750948641 + 0.0973685208073058j,
        "d2": -0.0540739380130639 - 0.0149735972950766j,
        "e1": -0.24224718179559 + 0.0666523893266933j,
        "N": 0.88647439711742,
        "e2": 0.361705977606717 - 0.368705361726245j,
        "a": 0.0776869681356819 + 0.161992627421521j,
        "b": -0.0339117552920693 - 0.169399024233499j,
    }
    for name, value in expected.items():
        assert complex(getattr(end, name)) == pytest.approx(value, rel=1e-13), name


@pytest.mark.parametrize(
    ("law", "std", "mean_square"),
    [
        ("laplace", 0.08 * 2**0.5, 1.00369776084141),
        ("von_mises", 50**-0.5, 1.42995893892858),
        ("uniform", 0.2 / 3**0.5, 1.03784114474932),
    ],
)
def test_other_laws_of_the_rotation_error_have_the_reference_digits(law, std, mean_square):
    noise = StepNoise.additive(heading_std_rad=std, heading_law=law, **UNEVEN)
    assert float(dead_reckoning(FIVE_TURNS, FIVE_MOVES, noise).rms[-1] ** 2) == pytest.approx(mean_square, rel=1e-13)


@pytest.mark.parametrize("law", ["gaussian", "laplace", "uniform"])
def test_errors_that_depend_on_each_other_are_confirmed_by_simulation(law):
    rng = np.random.default_rng(3)
    runs, n, std = 60_000, 12, 0.25
    turns, moves = rng.normal(0, 0.4, n), rng.uniform(0.3, 1, n)
    gain, bias, spread = 0.3 + 0.2j, 0.05 - 0.02j, 0.1
    noise = StepNoise.additive(
        heading_std_rad=std,
        heading_mean_rad=0.05,
        heading_law=law,
        translation_bias_m=as_vector(bias),
        translation_cov_m2=spread**2 * np.eye(2),
        gain_m_per_rad=as_vector(gain),
    )
    draw = {
        "gaussian": lambda: rng.normal(0, std, runs),
        "laplace": lambda: rng.laplace(0, std / 2**0.5, runs),
        "uniform": lambda: rng.uniform(-std * 3**0.5, std * 3**0.5, runs),
    }[law]
    heading, position, true = np.zeros(runs), np.zeros(runs, complex), 0j
    for k in range(n):
        own = draw()
        heading += turns[k] + own + 0.05
        rest = spread * (rng.normal(size=runs) + 1j * rng.normal(size=runs))
        position += np.exp(1j * heading) * (moves[k] + bias + gain * own + rest)
        true += np.exp(1j * turns[: k + 1].sum()) * moves[k]
    e = position - true
    found = dead_reckoning(turns, np.stack([moves, 0 * moves], axis=-1), noise).moments[-1]
    for sample, value in (
        (e.real, found.e1.real),
        (e.imag, found.e1.imag),
        (np.abs(e) ** 2, found.N.real),
        ((e**2).real, found.e2.real),
        ((e**2).imag, found.e2.imag),
    ):
        assert abs(sample.mean() - value) < 4 * sample.std() / runs**0.5


# --- Theorem 1 --------------------------------------------------------------------------------------------------------


def within(bounds, bias: float, variance: float) -> None:
    # 1e-9: round-off where a bound is attained
    assert bounds.bias_lower_m * (1 - 1e-9) - 1e-9 <= bias <= bounds.bias_upper_m * (1 + 1e-9) + 1e-9
    assert variance <= bounds.variance_upper_m2 * (1 + 1e-9)


@settings(deadline=None, max_examples=120)
@given(seed=st.integers(0, 10**9))
def test_theorem_1_bounds_any_planar_motion(seed):
    rng = np.random.default_rng(seed)
    n, noise = int(rng.integers(1, 300)), random_noise(rng)
    turns, moves = random_motion(rng, n)
    found = dead_reckoning(turns, moves, noise)
    bounds = theorem_1(
        n,
        displacement_m=float(np.hypot(*found.xy[-1])),
        longest_step_m=float(np.hypot(*moves.T).max()),
        coherence=noise.coherence,
        translation_error_m=noise.S**0.5,
        translation_bias_m=abs(noise.translation_mean),
        rotated_bias_m=abs(noise.s1),
        translation_var_m2=noise.translation_var_m2,
    )
    within(bounds, float(found.bias_norm[-1]), float(found.trace[-1]))


def mean_rotation(std: float) -> float:
    """l₁ in E R̃ = l₁ I for a Gaussian rotation vector N(0, std² I): 1 - ⅔ (1 - (1 - std²) exp(-std²/2))."""
    return 1 - 2 / 3 * (1 - (1 - std**2) * np.exp(-(std**2) / 2))


def rotation_matrices(rng: np.random.Generator, n: int, std: float) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(rng.normal(0, std, (n, 3))).as_matrix()


def spatial_moments(turns, moves, M, b, var) -> tuple[np.ndarray, np.ndarray, float]:
    """True and mean position, and E|t̂|², from means of rotations alone: |t̂|² telescopes. Independent errors."""
    R, mean_R, true, mean, square = np.eye(3), np.eye(3), np.zeros(3), np.zeros(3), 0.0
    pending = np.zeros(3)  # Σ_{i<k} (product of mean rotations from i to k)ᵀ (r_i + b)
    for turn, r in zip(turns, moves, strict=True):
        R, mean_R = R @ turn, mean_R @ turn @ M
        true, mean = true + R @ r, mean + mean_R @ (r + b)
        pending = (turn @ M).T @ pending
        square += (r + b) @ (r + b) + var + 2 * pending @ (r + b)
        pending = pending + r + b
    return true, mean, square


@settings(deadline=None, max_examples=100)
@given(seed=st.integers(0, 10**9))
def test_theorem_1_bounds_any_motion_in_space(seed):
    rng = np.random.default_rng(seed)
    n, std = int(rng.integers(1, 60)), 10 ** rng.uniform(-2.5, 0)
    turns = rotation_matrices(rng, n, 0.3)
    moves, b, var = rng.normal(0, 1, (n, 3)), rng.normal(0, 0.1, 3) * rng.integers(0, 2), 10 ** rng.uniform(-4, 0)
    true, mean, square = spatial_moments(turns, moves, mean_rotation(std) * np.eye(3), b, var)
    bounds = theorem_1(
        n,
        displacement_m=float(np.linalg.norm(true)),
        longest_step_m=float(np.linalg.norm(moves, axis=1).max()),
        coherence=mean_rotation(std),
        translation_error_m=float(np.sqrt(var + b @ b)),
        translation_bias_m=float(np.linalg.norm(b)),
        translation_var_m2=var,
    )
    within(bounds, float(np.linalg.norm(mean - true)), float(square - mean @ mean))
    least = second_moment_lower_bound(
        steps=n,
        coherence=mean_rotation(std),
        shortest_step_m=float(np.linalg.norm(moves + b, axis=1).min()),
        translation_var_m2=var,
    )
    assert square >= least * (1 - 1e-12)


@settings(deadline=None, max_examples=120)
@given(seed=st.integers(0, 10**9))
def test_the_variance_cannot_stay_below_linear_growth_whatever_the_motion(seed):
    rng = np.random.default_rng(seed)
    n, noise = int(rng.integers(1, 200)), random_noise(rng, dependent=False)
    turns, moves = random_motion(rng, n)
    end = dead_reckoning(turns, moves, noise).moments[-1]
    square = float(abs(end.p) ** 2 + 2 * (np.conj(end.p) * end.e1).real + end.N.real)
    least = second_moment_lower_bound(
        steps=n,
        coherence=noise.coherence,
        shortest_step_m=float(np.abs(moves[:, 0] + 1j * moves[:, 1] + noise.translation_mean).min()),
        translation_var_m2=noise.translation_var_m2,
    )
    assert square >= least * (1 - 1e-9) - 1e-12


def test_turning_about_at_every_step_attains_the_lower_bound():
    noise = StepNoise.additive(heading_std_rad=0.5)
    end = power(step_moments(np.pi, (1.0, 0.0), noise), 20_000)
    square = float(abs(end.p) ** 2 + 2 * (np.conj(end.p) * end.e1).real + end.N.real)
    least = second_moment_lower_bound(steps=20_000, coherence=noise.coherence, shortest_step_m=1.0)
    assert 1 <= square / least < 1.001


def test_the_distance_travelled_is_not_immaterial_for_the_variance():
    around = step_moments(np.pi / 2, (1.0, 0.0), StepNoise.additive(heading_std_rad=0.05))
    variances = [float(p.N.real - abs(p.e1) ** 2) for p in (power(around, n) for n in (100, 1000, 10_000))]
    np.testing.assert_allclose(variances, [0.2356, 1.7093, 13.0006], atol=5e-5)
    in_place = power(step_moments(0.1, (0.0, 0.0), StepNoise.additive(heading_std_rad=0.05)), 10_000)
    assert in_place.N == 0


def test_without_rotation_noise_the_bounds_of_theorem_1_are_their_limits():
    args = {"displacement_m": 5.0, "longest_step_m": 0.1, "translation_error_m": 0.02}
    at, near = theorem_1(50, coherence=1.0, **args), theorem_1(50, coherence=1 - 1e-10, **args)
    assert at.variance_upper_m2 == pytest.approx(near.variance_upper_m2, rel=1e-7)
    assert at.bias_upper_m == pytest.approx(near.bias_upper_m, rel=1e-7)


# --- Theorem 2 --------------------------------------------------------------------------------------------------------

DEPENDENT = StepNoise.additive(
    heading_std_rad=0.2,
    heading_mean_rad=0.05,
    translation_bias_m=(0.04, -0.03),
    translation_cov_m2=0.01 * np.eye(2),
    gain_m_per_rad=(0.3, 0.2),
)
STEP = 0.8 + 0.3j


@settings(deadline=None, max_examples=100)
@given(seed=st.integers(0, 10**9))
def test_theorem_2_is_the_power_of_an_element(seed):
    rng = np.random.default_rng(seed)
    noise, n = random_noise(rng), int(10 ** rng.uniform(0, 5))
    turn, r = float(rng.normal() * rng.integers(0, 2)), rng.uniform(-1, 1, 2)
    found = theorem_2(n, r, noise, turn=turn)
    end = power(step_moments(turn, r, noise), n)
    variance = float(end.N.real - abs(end.e1) ** 2)
    np.testing.assert_allclose(found.bias_m, as_vector(complex(end.e1)), rtol=1e-9, atol=1e-9)
    # on long biased runs the variance is a small difference of E|e|² and the squared bias, by either way
    assert found.variance_m2 == pytest.approx(variance, rel=1e-9, abs=1e-11 * float(end.N.real))


@pytest.mark.parametrize("std", [1e-10, 1e-7, 1e-4, 0.1, 2.0])
@pytest.mark.parametrize("n", [1, 10, 1000, 10**6])
def test_theorem_2_keeps_its_digits_for_any_noise(std, n):
    noise = StepNoise.additive(heading_std_rad=std)
    found, end = theorem_2(n, (1.0, 0.0), noise), power(step_moments(0.0, (1.0, 0.0), noise), n)
    # matrix_power squares 20 times for 10⁶ steps: each squaring doubles a relative error of 10⁻¹⁶
    assert found.variance_m2 == pytest.approx(float(end.N.real - abs(end.e1) ** 2), rel=1e-10)
    assert found.bias_m[0] == pytest.approx(float(end.e1.real), rel=1e-10)


@pytest.mark.parametrize(
    ("n", "variance"),
    [(1, 0.0622126719), (2, 0.2179554209), (7, 4.1331229893), (50, 493.9878724563), (400, 4251.7016201292)],
)
def test_psi_and_omega_give_the_reference_digits(n, variance):
    found = theorem_2(n, as_vector(STEP), DEPENDENT)
    assert found.variance_m2 == pytest.approx(variance, abs=6e-11)
    assert found.psi_m2 * n + found.omega_m2 == pytest.approx(variance, abs=6e-11 + 1e-14 * variance)


def test_the_straight_line_of_section_4_has_the_reference_digits():
    noise = section_4_noise(0.064 * np.exp(0.25j * np.pi))
    r = 0.064 * np.array([1, 1]) / 2**0.5
    for n, bias, variance in (
        (10, 0.009720408564, 0.002123414086),
        (100, 0.1008783443, 0.05564758588),
        (1000, 1.374642809, 34.25484721),
        (10_000, 48.81531246, 31190.10037),
        (100_000, 2867.19838760125, 14468028.0239298),
    ):
        found = theorem_2(n, r, noise)
        assert np.hypot(*found.bias_m) == pytest.approx(bias, rel=1e-9)
        assert found.variance_m2 == pytest.approx(variance, rel=1e-9)


def test_the_printed_constants_of_section_4_have_the_reference_digits():
    loss = 1.2873e-5
    noise = MeanNoise.independent(
        rotation_mean=(1 - loss) * np.eye(2), translation_bias_m=(-0.6842e-3, -0.6842e-3), translation_var_m2=1.2479e-4
    )
    found = theorem_2(100_000, 0.064 * np.array([1, 1]) / 2**0.5, noise)
    assert np.hypot(*found.bias_m) == pytest.approx(2855.05600187873, rel=1e-10)  # 1 - loss is rounded at 10⁻¹¹ of loss
    assert found.variance_m2 == pytest.approx(14444868.2636609, rel=1e-10)


@pytest.mark.parametrize(
    ("n", "bias", "variance"),
    [(3020, 0.131883644167185, 0.693028760447725), (10**5, 0.509914548748469, 22.2982138501295)],
)
def test_the_circle_of_section_4_has_the_reference_digits_by_both_theorems(n, bias, variance):
    noise = section_4_noise(CHORD, 6.8e-5)
    for found in (
        theorem_2(n, as_vector(CHORD), noise, turn=TURN),
        theorem_3(n, [TURN] * 3020, as_vector(CHORD), noise),
    ):
        assert np.hypot(*found.bias_m) == pytest.approx(bias, rel=1e-9)
        assert found.variance_m2 == pytest.approx(variance, rel=1e-9)


def test_a_helix_is_the_sum_over_all_pairs_of_steps():
    rng = np.random.default_rng(8)
    turn = rotation_matrices(rng, 1, 0.3)[0]
    M = 0.97 * rotation_matrices(rng, 1, 0.02)[0]
    r, b, var = np.array([0.5, 0.1, 0.2]), np.array([0.01, -0.02, 0.03]), 0.02
    noise = MeanNoise.independent(rotation_mean=M, translation_bias_m=b, translation_var_m2=var)
    for n in (1, 2, 17, 200):
        true, mean, square = spatial_moments([turn] * n, [r] * n, M, b, var)
        found = theorem_2(n, r, noise, turn=turn)
        np.testing.assert_allclose(found.bias_m, mean - true, atol=1e-12)
        assert found.variance_m2 == pytest.approx(float(square - mean @ mean), rel=1e-11)
        assert found.psi_m2 * n + found.omega_m2 == pytest.approx(found.variance_m2, rel=1e-9)


def test_a_straight_line_in_space_is_confirmed_by_simulation():
    rng = np.random.default_rng(12)
    runs, n, std = 20_000, 25, 0.25
    r, b, spread = np.array([1.0, 0.0, 0.2]), np.array([0.02, 0.01, 0.0]), 0.1
    R, position = np.broadcast_to(np.eye(3), (runs, 3, 3)), np.zeros((runs, 3))
    for _ in range(n):
        R = R @ rotation_matrices(rng, runs, std)
        position = position + np.einsum("kij,kj->ki", R, r + b + spread * rng.normal(size=(runs, 3)))
    noise = MeanNoise.independent(
        rotation_mean=mean_rotation(std) * np.eye(3), translation_bias_m=b, translation_var_m2=3 * spread**2
    )
    found = theorem_2(n, r, noise)
    e = position - n * r
    assert (np.abs(e.mean(0) - found.bias_m) < 4 * e.std(0) / runs**0.5).all()
    squares = ((e - found.bias_m) ** 2).sum(-1)
    assert abs(squares.mean() - found.variance_m2) < 4 * squares.std() / runs**0.5


# --- the misprints ----------------------------------------------------------------------------------------------------


def theorem_2_with(misprints: set[int], n: int, noise: StepNoise, r: complex) -> float:
    """Tr Cov = ψ n + ω with the misprints 1 to 3 of Knuth & Barooah that are named. aᵀ f(x) b is Re(conj(a) f(x) b)."""
    x, b, rho = 1 + noise.d1, noise.translation_mean, noise.s1
    i = 1 / (1 - x)
    xn = x**n

    def form(a, f, c):
        return (np.conj(a) * f * c).real

    psi, omega = noise.S, -(abs(i * (1 - xn) * (x * r + rho)) ** 2)
    if 1 in misprints:  # E[fᵀf]
        psi += 2 * form(r, i * x, r)
        omega += form(r, i**2 * (1 - 4 * x + 2 * x**2 + 2 * x ** (n + 1)), r)
    else:
        psi += form(r, i * (1 + x), r)
        omega += form(r, i**2 * (-2 * x + 2 * x * xn), r)
    if 2 in misprints:  # E[fᵀg], its part with b and r
        omega += form(b, i * (1 - xn), r)
    else:
        psi += 2 * form(b, i, r)
        omega -= 2 * form(b, i**2 * x * (1 - xn), r)
    once = 1 if 3 in misprints else 2  # its part with r and ρ
    psi += form(2 * b + once * r, i, rho)
    omega -= form(2 * b + once * r, i**2 * (1 - xn), rho)
    return float(psi * n + omega)


@cache
def squared_errors(n: int = 7, runs: int = 400_000) -> np.ndarray:
    """|t̂ - E t̂|² of drives with the noise DEPENDENT."""
    rng = np.random.default_rng(5)
    heading, position = np.zeros(runs), np.zeros(runs, complex)
    for _ in range(n):
        own = rng.normal(0, 0.2, runs)
        heading += own + 0.05
        rest = 0.1 * (rng.normal(size=runs) + 1j * rng.normal(size=runs))
        position += np.exp(1j * heading) * (STEP + 0.04 - 0.03j + (0.3 + 0.2j) * own + rest)
    mean = n * STEP + complex(*theorem_2(n, as_vector(STEP), DEPENDENT).bias_m)
    assert abs(position.mean() - mean) < 4 * position.std() / runs**0.5
    return np.abs(position - mean) ** 2


def deviations(samples: np.ndarray, value: float) -> float:
    return float(abs(samples.mean() - value) / (samples.std() / len(samples) ** 0.5))


def test_theorem_2_corrected_is_confirmed_by_simulation():
    found = theorem_2(7, as_vector(STEP), DEPENDENT).variance_m2
    assert theorem_2_with(set(), 7, DEPENDENT, STEP) == pytest.approx(found, rel=1e-11)
    assert deviations(squared_errors(), found) < 4


@pytest.mark.parametrize("misprints", [{1}, {2}, {3}, {1, 2, 3}], ids=str)
def test_theorem_2_as_printed_is_refuted_by_simulation(misprints):
    assert deviations(squared_errors(), theorem_2_with(misprints, 7, DEPENDENT, STEP)) > 50


def test_the_printed_variance_is_negative_after_one_step():
    assert theorem_2_with({1, 2, 3}, 1, DEPENDENT, STEP) == pytest.approx(-186.98, abs=0.01)


def test_the_printed_variance_of_section_4_is_almost_three_times_too_large():
    r = 0.064 * np.exp(0.25j * np.pi)
    noise = section_4_noise(r)
    ratio = theorem_2_with({1, 2, 3}, 100_000, noise, r) / theorem_2(100_000, as_vector(r), noise).variance_m2
    assert 2.7 < ratio < 2.8


def hexagon() -> tuple[np.ndarray, list[complex], list[StepNoise]]:
    rng = np.random.default_rng(1)
    bias = 0.3 * (rng.normal(size=6) + 1j * rng.normal(size=6))
    noises = [
        StepNoise.additive(
            heading_std_rad=0.15,
            heading_mean_rad=0.03,
            translation_bias_m=as_vector(b),
            translation_cov_m2=0.01 * np.eye(2),
        )
        for b in bias
    ]
    return np.full(6, np.pi / 3), list(bias), noises


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 400))
def test_theorem_3_is_the_drive_step_by_step(seed, n):
    rng = np.random.default_rng(seed)
    p = int(rng.integers(1, 9))
    turns, moves = random_motion(rng, p)
    first = random_noise(rng)
    found = theorem_3(n, turns, moves, first)
    rounds = -(-n // p)
    steps = dead_reckoning(np.tile(turns, rounds), np.tile(moves, (rounds, 1)), first)
    np.testing.assert_allclose(found.bias_m, steps.bias[n], rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(found.cov_m2, steps.cov[n], rtol=1e-9, atol=1e-9 * (1 + float(steps.trace[n])))


@pytest.mark.parametrize("n", [6, 10, 23])
def test_theorem_3_corrected_is_confirmed_and_as_printed_refuted_by_simulation(n):
    turns, bias, noises = hexagon()
    found = theorem_3(n, turns, (1.0, 0.0), noises)
    rng, runs = np.random.default_rng(7), 200_000
    heading, position, true = np.zeros(runs), np.zeros(runs, complex), 0j
    for k in range(n):
        heading += np.pi / 3 + rng.normal(0.03, 0.15, runs)
        rest = 0.1 * (rng.normal(size=runs) + 1j * rng.normal(size=runs))
        position += np.exp(1j * heading) * (1 + bias[k % 6] + rest)
        true += np.exp(1j * np.pi / 3 * (k + 1))
    e = position - true
    for sample, value in ((e.real, found.bias_m[0]), (e.imag, found.bias_m[1])):
        assert deviations(sample, value) < 4
    squares = np.abs(e - complex(*found.bias_m)) ** 2
    assert deviations(squares, found.variance_m2) < 4

    def mean_position(shift):  # equation (19), ρ_{i+1+shift}
        x, corner = 1 + noises[0].d1, np.exp(1j * np.pi / 3)

        def w(j):
            return sum(x**i * corner ** (i + 1) * (x + noises[(i + shift) % 6].s1) for i in range(j))

        rounds, rest = divmod(n, 6)
        return (1 - x ** (6 * rounds)) / (1 - x**6) * w(6) + x ** (6 * rounds) * w(rest)

    assert mean_position(0) - true == pytest.approx(complex(*found.bias_m), abs=1e-12)
    printed = mean_position(-1) - true
    assert np.hypot(deviations(e.real, printed.real), deviations(e.imag, printed.imag)) > 50


def test_the_constants_of_section_4_follow_from_the_noise_that_is_stated():
    from scipy.special import ive

    noise = section_4_noise(0.064 * np.exp(0.25j * np.pi))
    assert 1 - noise.coherence == pytest.approx(1.29598320e-5, rel=1e-8)  # printed: 1.2873e-5
    assert noise.translation_var_m2 == pytest.approx(2.08377e-4, rel=1e-5)  # printed: 1.2479e-4
    assert noise.translation_var_m2 - 8.5467e-5 == pytest.approx(1.22910e-4, rel=1e-5)
    assert noise.translation_mean.real == pytest.approx(-0.6842e-3, rel=1e-4)  # as printed
    assert ive(3, 1e4) / ive(1, 1e4) == pytest.approx(
        0.99960006, abs=1e-8
    )  # ‖E R̃‖ of the quaternion law; printed: 0.9997


# --- bad input --------------------------------------------------------------------------------------------------------

PLAIN = StepNoise.additive(heading_std_rad=0.1)
BOUNDS = {"displacement_m": 1.0, "longest_step_m": 1.0, "coherence": 0.9, "translation_error_m": 0.1}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: StepNoise.additive(heading_std_rad=-1), "heading_std_rad >= 0"),
        (lambda: StepNoise.additive(heading_std_rad=0.1, heading_law="cauchy"), "expected heading_law one of"),
        (lambda: StepNoise.additive(heading_std_rad=0.1, translation_bias_m=(1, 2, 3)), r"of shape \(2,\), got \(3,\)"),
        (
            lambda: StepNoise.additive(heading_std_rad=0.1, translation_cov_m2=[[1, 2], [2, 1]]),
            "translation_cov_m2 symmetric and positive semi-definite",
        ),
        (lambda: StepNoise.additive(heading_std_rad=0.1, translation_cov_m2=np.eye(3)), "square matrix of dimension 2"),
        (
            lambda: StepNoise.additive(heading_std_rad=0.1, heading_law="von_mises", gain_m_per_rad=(1, 0)),
            "not available for heading_law='von_mises'",
        ),
        (
            lambda: StepNoise.polar(
                translation_m=(0, 0), heading_std_rad=0.1, direction_std_rad=0.1, distance_std_m=0.1
            ),
            "translation_m other than zero",
        ),
        (lambda: dead_reckoning([], (1.0, 0.0), PLAIN), r"turns_rad of shape \(n,\)"),
        (lambda: dead_reckoning([0.1, 0.2], [(1.0, 0.0)], PLAIN), r"translations_m of shape \(2,\) or \(2, 2\)"),
        (lambda: dead_reckoning([0.1, 0.2], (1.0, 0.0), [PLAIN]), "one StepNoise per step"),
        (lambda: dead_reckoning([0.1], (1.0, 0.0), "noise"), "expected a StepNoise or one per step, got str"),
        (lambda: step_moments([0.1], [[1.0, 0.0]] * 3, PLAIN), "one translation per turn"),
        (lambda: step_moments(0.1, (1.0, 0.0, 0.0), PLAIN), r"of shape \(\.\.\., 2\)"),
        (lambda: theorem_1(0, **BOUNDS), "steps a whole number >= 1, got 0"),
        (lambda: theorem_1(3, **(BOUNDS | {"coherence": 1.1})), r"coherence in \(0, 1\]"),
        (lambda: theorem_1(3, **(BOUNDS | {"longest_step_m": -1.0})), "longest_step_m >= 0"),
        (
            lambda: second_moment_lower_bound(steps=3, coherence=-0.1, shortest_step_m=1.0),
            r"coherence in \[0, 1\]",
        ),
        (lambda: theorem_2(2.5, (1.0, 0.0), PLAIN), "steps a whole number"),
        (lambda: theorem_2(2, (1.0, 0.0, 0.0), PLAIN), r"translation_m of shape \(2,\)"),
        (lambda: theorem_2(2, (1.0, 0.0), 0.1), "expected a StepNoise or MeanNoise, got float"),
        (lambda: theorem_2(2, (1.0, 0.0), PLAIN, turn=2 * np.eye(2)), "turn a rotation matrix"),
        (
            lambda: theorem_2(2, (1.0, 0.0), StepNoise.additive(heading_std_rad=0.0)),
            "the variance is then steps \\* translation_var_m2",
        ),
        (
            lambda: MeanNoise.independent(
                rotation_mean=2 * np.eye(3), translation_bias_m=(0, 0, 0), translation_var_m2=0
            ),
            "no longer than 1, got norm 2",
        ),
        (
            lambda: MeanNoise.independent(rotation_mean=np.eye(4), translation_bias_m=(0,) * 4, translation_var_m2=0),
            r"shape \(2, 2\) or \(3, 3\)",
        ),
        (
            lambda: theorem_3(9, [0.1, 0.2], (1.0, 0.0), [PLAIN, StepNoise.additive(heading_std_rad=0.2)]),
            "rotation errors of one mean",
        ),
        (lambda: theorem_3(9, [[0.1]], (1.0, 0.0), PLAIN), r"turns_rad of shape \(p,\)"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()
