"""The bias-reduced estimator: exact moments, when it pays and when not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.literature import (
    Correction,
    Crossovers,
    StepNoise,
    bias_reduced_cov,
    bias_reduction,
    corrected,
    crossovers,
    de_meaning,
    dead_reckoning,
    estimate_positions,
    step_moments,
)
from driftplan.model.moments import power

SECTION_6 = {
    "heading_std_rad": 0.0026**0.5,
    "heading_mean_rad": 0.0068,
    "translation_bias_m": (0.05, 0.02),
    "translation_cov_m2": 0.05 * np.eye(2),
}
TURN = 2 * np.pi * 47 / 3020


def random_drive(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    style = rng.integers(0, 4)
    turns = [rng.normal(0, 0.7, n), np.zeros(n), rng.choice([np.pi, 0, np.pi / 2], n), np.full(n, rng.normal())]
    return turns[style], np.stack([rng.uniform(0, 1, n), rng.normal(0, 0.2, n)], axis=-1)


def random_noise(rng: np.random.Generator, *, systematic: bool, dependent: bool = False) -> StepNoise:
    return StepNoise.additive(
        heading_std_rad=10 ** rng.uniform(-2, 0.1),
        heading_law=str(rng.choice(["gaussian", "laplace"])),
        heading_mean_rad=float(rng.normal(0, 0.1) * systematic),
        translation_bias_m=rng.normal(0, 0.1, 2) * systematic,
        translation_cov_m2=np.diag(rng.uniform(0, 0.1, 2)) * rng.integers(0, 2),
        gain_m_per_rad=rng.normal(0, 0.3, 2) * dependent,
    )


# --- exact moments ----------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 10**9))
def test_bias_reduction_leaves_no_bias_and_the_covariance_of_the_closed_sums(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 80))
    turns, moves = random_drive(rng, n)
    noise = random_noise(rng, systematic=True, dependent=bool(rng.integers(0, 2)))
    found = dead_reckoning(turns, moves, corrected(noise, bias_reduction(noise)))
    size = float(found.rms[-1])
    assert float(found.bias_norm[-1]) <= 1e-11 * (1 + size)
    cov = bias_reduced_cov(turns, moves, noise)
    np.testing.assert_allclose(cov, found.cov[-1], rtol=1e-9, atol=1e-10 * (1 + size**2))


def test_a_noise_per_step_has_its_own_correction_at_every_step():
    rng = np.random.default_rng(4)
    turns, moves = random_drive(rng, 12)
    noises = [random_noise(rng, systematic=True) for _ in range(12)]
    found = dead_reckoning(turns, moves, [corrected(one, bias_reduction(one)) for one in noises])
    np.testing.assert_allclose(bias_reduced_cov(turns, moves, noises), found.cov[-1], rtol=1e-11)


@pytest.mark.parametrize(
    ("turn", "raw_bias", "raw_variance", "reduced_variance"),
    [(0.0, 125.3573066, 5832.604745, 8025.899566), (0.1, 11.16983422, 107.6817183, 158.1942313)],
)
def test_section_6_noise_has_the_reference_digits(turn, raw_bias, raw_variance, reduced_variance):
    noise = StepNoise.additive(**SECTION_6)
    raw = power(step_moments(turn, (1.0, 0.0), noise), 200)
    assert abs(complex(raw.e1)) == pytest.approx(raw_bias, rel=1e-9)
    assert float(raw.N.real) - abs(complex(raw.e1)) ** 2 == pytest.approx(raw_variance, rel=1e-9)
    reduced = bias_reduced_cov([turn] * 200, (1.0, 0.0), noise)
    assert float(np.trace(reduced)) == pytest.approx(reduced_variance, rel=1e-9)


def test_de_meaning_alone_gains_more_than_bias_reduction():
    noise = StepNoise.additive(**SECTION_6)
    squares = {}
    for name, correction in (
        ("raw", Correction()),
        ("reduced", bias_reduction(noise)),
        ("de-meaned", de_meaning(noise)),
    ):
        squares[name] = float(power(step_moments(0.0, (1.0, 0.0), corrected(noise, correction)), 200).N.real)
    assert squares["raw"] == pytest.approx(21547, abs=0.1)
    assert squares["reduced"] == pytest.approx(8025.9, abs=0.1)
    assert squares["de-meaned"] == pytest.approx(6367.6, abs=0.1)


def test_no_correction_changes_nothing():
    noise = StepNoise.additive(**SECTION_6, gain_m_per_rad=(0.3, 0.2))
    same = corrected(noise, Correction())
    for name in StepNoise.__slots__:
        assert getattr(same, name) == pytest.approx(getattr(noise, name), rel=1e-14), name


def test_one_correction_after_another_is_one_correction():
    noise = StepNoise.additive(**SECTION_6, gain_m_per_rad=(0.3, 0.2))
    first, second = bias_reduction(noise), Correction(rotation=0.9 * np.exp(0.1j), translation_m=0.2 - 0.1j)
    both = Correction(
        rotation=first.rotation * second.rotation, translation_m=first.translation_m + second.translation_m
    )
    twice, once = corrected(corrected(noise, first), second), corrected(noise, both)
    for name in StepNoise.__slots__:
        assert getattr(twice, name) == pytest.approx(getattr(once, name), rel=1e-12), name


@pytest.mark.parametrize("gain", [0j, 0.3 + 0.2j])
@pytest.mark.parametrize("correct", [bias_reduction, de_meaning, lambda noise: Correction()])
def test_the_estimators_are_confirmed_by_simulation(correct, gain):
    rng, runs, n = np.random.default_rng(6), 25_000, 20
    turns, moves = rng.normal(0, 0.4, n), rng.uniform(0.3, 1, n)
    noise = StepNoise.additive(
        heading_std_rad=0.2,
        heading_mean_rad=0.05,
        translation_bias_m=(0.05, 0.02),
        translation_cov_m2=[[0.05, 0.01], [0.01, 0.03]],
        gain_m_per_rad=(gain.real, gain.imag),
    )
    own = rng.normal(0, 0.2, (runs, n))
    rest = rng.multivariate_normal([0.05, 0.02], [[0.05, 0.01], [0.01, 0.03]], (runs, n))
    rest += np.stack([gain.real * own, gain.imag * own], axis=-1)
    correction = correct(noise)
    measured = rest + np.stack([moves, 0 * moves], axis=-1)
    ends = estimate_positions(turns + own + 0.05, measured, correction)[:, -1]
    found = dead_reckoning(turns, np.stack([moves, 0 * moves], axis=-1), corrected(noise, correction))
    e = ends - found.xy[-1]
    assert (np.abs(e.mean(0) - found.bias[-1]) < 4 * e.std(0) / runs**0.5).all()
    e -= found.bias[-1]
    for i, j in ((0, 0), (1, 1), (0, 1)):
        product = e[:, i] * e[:, j]
        assert abs(product.mean() - found.cov[-1, i, j]) < 4 * product.std() / runs**0.5


def test_subtracting_the_plain_bias_from_dependent_errors_leaves_a_bias():
    noise = StepNoise.additive(heading_std_rad=0.2, translation_bias_m=(0.05, 0.0), gain_m_per_rad=(0.3, 0.2))
    full = bias_reduction(noise)
    plain = Correction(rotation=full.rotation, translation_m=noise.translation_mean)
    drive = ([0.0] * 30, (1.0, 0.0))
    assert float(dead_reckoning(*drive, corrected(noise, plain)).bias_norm[-1]) > 0.1
    assert float(dead_reckoning(*drive, corrected(noise, full)).bias_norm[-1]) < 1e-12


# --- when it pays -----------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=80)
@given(seed=st.integers(0, 10**9))
def test_without_systematic_errors_bias_reduction_never_pays(seed):
    rng = np.random.default_rng(seed)
    turns, moves = random_drive(rng, int(rng.integers(1, 80)))
    noise = random_noise(rng, systematic=False)
    raw, reduced = (
        dead_reckoning(turns, moves, noise),
        dead_reckoning(turns, moves, corrected(noise, bias_reduction(noise))),
    )
    assert (reduced.rms >= raw.rms * (1 - 1e-12)).all()  # round-off
    assert (reduced.trace >= raw.trace * (1 - 1e-9) - 1e-13).all()


@settings(deadline=None, max_examples=80)
@given(seed=st.integers(0, 10**9))
def test_de_meaning_is_never_worse_than_bias_reduction(seed):
    rng = np.random.default_rng(seed)
    turns, moves = random_drive(rng, int(rng.integers(1, 80)))
    noise = random_noise(rng, systematic=True)
    reduced, plain = (dead_reckoning(turns, moves, corrected(noise, f(noise))) for f in (bias_reduction, de_meaning))
    assert (plain.rms <= reduced.rms * (1 + 1e-10) + 1e-13).all()


@pytest.mark.parametrize(
    ("step_m", "variance_steps", "mean_square_steps"),
    [(0.1, 330, 821), (0.5, 100, 781), (1.0, 54, 776), (2.0, 28, 773), (5.0, 12, 771)],
)
def test_the_table_of_crossovers_for_the_noise_of_section_6(step_m, variance_steps, mean_square_steps):
    """The table was read off a grid of step numbers: ±0.5 %."""
    found = crossovers(0.0, (step_m, 0.0), StepNoise.additive(**SECTION_6))
    assert found.variance_steps == pytest.approx(variance_steps, rel=0.005)
    assert found.mean_square_steps == pytest.approx(mean_square_steps, rel=0.005)


@pytest.mark.parametrize(
    ("turn", "chord", "heading_mean", "expected"),
    [
        (0.0, 0.064 * np.exp(0.25j * np.pi), 0.0, Crossovers(variance_steps=1, mean_square_steps=1224)),
        (TURN, -0.064j * np.exp(-0.5j * TURN), 6.8e-5, Crossovers(variance_steps=1, mean_square_steps=688)),
    ],
    ids=["straight line of Section 4.2", "circle of Section 4.3"],
)
def test_crossovers_of_section_4(turn, chord, heading_mean, expected):
    move = (chord.real, chord.imag)
    noise = StepNoise.polar(
        translation_m=move,
        heading_std_rad=3.6e-3 * 2**0.5,
        heading_mean_rad=heading_mean,
        direction_std_rad=3.07e-2**0.5,
        distance_std_m=8.5467e-5**0.5,
    )
    assert crossovers(turn, move, noise) == expected


@pytest.mark.parametrize("turn", [0.0, 0.1, 0.5])
def test_crossovers_are_where_step_by_step_comparison_puts_them(turn):
    noise = StepNoise.additive(**SECTION_6)
    found = crossovers(turn, (1.0, 0.0), noise)
    steps = 2000
    raw, reduced = (
        dead_reckoning([turn] * steps, (1.0, 0.0), one) for one in (noise, corrected(noise, bias_reduction(noise)))
    )
    pays = np.flatnonzero(reduced.trace[1:] <= raw.trace[1:] + 1e-9 * raw.rms[1:] ** 2)
    assert found.variance_steps == (pays[-1] + 2 if len(pays) else 1)
    pays = np.flatnonzero(reduced.rms[1:] ** 2 <= raw.rms[1:] ** 2 * (1 + 1e-9))
    assert found.mean_square_steps == pays[-1] + 2


def test_small_noise_has_late_crossovers_found_without_trying_every_number():
    noise = StepNoise.additive(heading_std_rad=1e-4, heading_mean_rad=1e-6, translation_bias_m=(1e-3, 0.0))
    found = crossovers(0.0, (1.0, 0.0), noise).mean_square_steps
    assert found > 10**6

    def square(n, correction):
        return float(power(step_moments(0.0, (1.0, 0.0), corrected(noise, correction)), n).N.real)

    assert square(found, bias_reduction(noise)) > square(found, Correction())
    assert square(found - 1, bias_reduction(noise)) <= square(found - 1, Correction()) * (1 + 1e-9)


def test_without_rotation_noise_bias_reduction_always_pays():
    noise = StepNoise.additive(heading_std_rad=0.0, translation_bias_m=(0.1, 0.0), translation_cov_m2=0.01 * np.eye(2))
    assert crossovers(0.0, (1.0, 0.0), noise) == Crossovers(variance_steps=None, mean_square_steps=None)


def test_zero_mean_noise_alone_never_gains_from_bias_reduction():
    found = crossovers(0.0, (1.0, 0.0), StepNoise.additive(heading_std_rad=0.1))
    assert found.mean_square_steps <= 2  # after one step both errors are equal to first order and more


def test_straight_line_ratios_follow_from_one_number():
    """With y = n(1 - c) small steps: var_raw = 2(y - 1 + e⁻ʸ) - (1 - e⁻ʸ)², var_mod = ½(e²ʸ - 1 - 2y - 2y²), times
    |r|²/(1 - c)²; the ratios follow."""
    n = 10**6
    for y, ratio in ((0.1, 1.13), (0.5, 1.87), (1.0, 3.55), (2.0, 13.7)):
        noise = StepNoise.additive(heading_std_rad=(2 * y / n) ** 0.5)
        raw, reduced = (
            power(step_moments(0.0, (1.0, 0.0), one), n) for one in (noise, corrected(noise, bias_reduction(noise)))
        )
        unit = (n / y) ** 2
        variance = float(raw.N.real - abs(raw.e1) ** 2) / unit
        assert variance == pytest.approx(2 * (y - 1 + np.exp(-y)) - (1 - np.exp(-y)) ** 2, rel=1e-4)  # O(1/n)
        assert float(reduced.N.real) / unit == pytest.approx((np.exp(2 * y) - 1 - 2 * y - 2 * y**2) / 2, rel=1e-4)
        assert float(reduced.N.real) / unit / variance == pytest.approx(ratio, rel=0.005)


# --- bad input --------------------------------------------------------------------------------------------------------

PLAIN = StepNoise.additive(heading_std_rad=0.1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: bias_reduction(0.1), "expected a StepNoise, got float"),
        (lambda: bias_reduction(StepNoise(d1=-1, d2=1, D=2)), "other than zero"),
        (lambda: bias_reduced_cov([], (1.0, 0.0), PLAIN), r"turns_rad of shape \(n,\)"),
        (lambda: bias_reduced_cov([0.1, 0.1], [(1.0, 0.0)], PLAIN), r"of shape \(2,\) or \(2, 2\), got \(1, 2\)"),
        (lambda: bias_reduced_cov([0.1, 0.1], (1.0, 0.0), [PLAIN]), "one StepNoise per step"),
        (lambda: estimate_positions([0.1], [(1.0, np.inf)]), "measured_translations_m finite"),
        (lambda: estimate_positions([0.1, 0.2], [(1.0, 0.0)]), r"translations \(\.\.\., n, 2\)"),
        (lambda: crossovers(np.nan, (1.0, 0.0), PLAIN), "turn_rad finite"),
        (lambda: crossovers(0.0, (1.0,), PLAIN), r"translation_m of shape \(2,\)"),
        (lambda: crossovers(0.0, (1.0, 0.0), None), "expected a StepNoise, got NoneType"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()
