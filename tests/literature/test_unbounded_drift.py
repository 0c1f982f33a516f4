"""Propositions 1 and 2: against the algebra, a brute-force sum over characteristic functions, published digits, and
Monte Carlo; and every misprint of the paper, written out as printed, against the same Monte Carlo."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import cos, cosh, exp, sin, sinh

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.literature import Table, proposition_1, proposition_2
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Run, Runs

TOY = {"distances_m": [1.0, 1.2, 0.8], "turns_rad": [0.3, -0.2, 0.5], "heading_std_rad": 0.1, "distance_std_m": 0.1}


def random_path(seed: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.5, 1.5, n), rng.normal(0, 0.5, n)


# --- the algebra ------------------------------------------------------------------------------------------------------


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 60), heading=st.floats(-8, 0.5), distance=st.floats(-4, 0))
def test_proposition_1_is_what_the_algebra_predicts(seed, n, heading, distance):
    d, turns = random_path(seed, n)
    noise = {"heading_std": 10**heading, "distance_std": 10**distance}
    found = proposition_1(d, turns, heading_std_rad=noise["heading_std"], distance_std_m=noise["distance_std"])
    expected = predict_drift(Runs.from_odometry(d, turns), OdometryNoise.per_step(**noise, step_m=2.0)).end
    size = float(expected.rms)
    np.testing.assert_allclose(found.bias, expected.bias, rtol=1e-10, atol=1e-12 * size)  # round-off of n <= 60 steps
    np.testing.assert_allclose(found.cov, expected.cov, rtol=1e-10, atol=1e-12 * size**2)
    assert float(found.rms) == pytest.approx(size, rel=1e-10)


def test_runs_of_one_step_with_a_turn_before_each_are_the_papers_path():
    runs = [Run(length_m=d, turn_rad=t) for d, t in zip(TOY["distances_m"], TOY["turns_rad"], strict=True)]
    drift = predict_drift(runs, OdometryNoise.per_step(heading_std=0.1, distance_std=0.1, step_m=1.2)).end
    np.testing.assert_allclose(drift.bias, [-0.0264754260412627, -0.00939108908860077], rtol=1e-13)
    np.testing.assert_allclose(np.diag(drift.cov), [0.0389694730344741, 0.119952998509868], rtol=1e-13)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10**6), by=st.floats(-3, 3))
def test_turning_the_first_step_turns_the_answers(seed, by):
    d, turns = random_path(seed, 12)
    turned = turns.copy()
    turned[0] += by
    R = np.array([[cos(by), -sin(by)], [sin(by), cos(by)]])
    noise = {"heading_std_rad": 0.2, "distance_std_m": 0.3}
    before, after = proposition_2(d, turns, **noise), proposition_2(d, turned, **noise)
    np.testing.assert_allclose(after.bias, R @ before.bias, atol=1e-12)
    np.testing.assert_allclose(after.total_cov, R @ before.total_cov @ R.T, atol=1e-11)
    np.testing.assert_allclose(after.average_true_cov, R @ before.average_true_cov @ R.T, atol=1e-11)


def test_no_noise_no_drift():
    d, turns = random_path(0, 5)
    for found in (proposition_1, proposition_2):
        answer = found(d, turns, heading_std_rad=0.0, distance_std_m=0.0)
        assert not answer.bias.any()
        assert not any(getattr(answer.table, entry).any() for entry in "ABCDEF")


def test_a_batch_is_its_paths_one_by_one():
    paths = [random_path(seed, 20) for seed in range(6)]
    d, turns = (np.reshape(x, (2, 3, 20)) for x in zip(*paths, strict=True))
    batch = proposition_2(d, turns, heading_std_rad=0.1, distance_std_m=0.1)
    assert batch.total_cov.shape == (2, 3, 2, 2)
    for k, path in enumerate(paths):
        one = proposition_2(*path, heading_std_rad=0.1, distance_std_m=0.1)
        np.testing.assert_allclose(batch.total_cov.reshape(6, 2, 2)[k], one.total_cov, rtol=1e-12)
        np.testing.assert_allclose(batch.table.E.reshape(6)[k], one.table.E, rtol=1e-12)


@pytest.mark.parametrize("heading_std", [1e-9, 1e-4, 0.1, 1.0, 4.0])
def test_tables_and_propositions_agree_at_every_size_of_noise(heading_std):
    d, turns = random_path(3, 500)
    one = proposition_1(d, turns, heading_std_rad=heading_std, distance_std_m=0.05)
    t = one.table  # paper x is our y
    np.testing.assert_allclose(np.diag(one.cov) + one.bias**2, [t.D + t.E + t.F, t.A + t.B + t.C], rtol=1e-11)
    two = proposition_2(d, turns, heading_std_rad=heading_std, distance_std_m=0.05)
    t = two.table
    np.testing.assert_allclose(np.diag(two.total_cov) + two.bias**2, [t.D + t.E + t.F, t.A + t.B + t.C], rtol=1e-11)


# --- published digits and an independent sum --------------------------------------------------------------------------


def test_the_toy_path_has_the_reference_digits():
    """60-digit double sums."""
    one, two = proposition_1(**TOY), proposition_2(**TOY)
    entries = [0.0498253218218006, 0.0656753001126303, 0.00454056912970667]
    entries += [0.00786291590331061, 0.00634807444493649, 0.0254594308702933]
    np.testing.assert_allclose([getattr(one.table, name) for name in "ABCDEF"], entries, rtol=2e-14)
    np.testing.assert_allclose(two.bias, [-0.0261870968900501, -0.00927175264530452], rtol=1e-13)
    t = two.table
    np.testing.assert_allclose([t.A + t.B + t.C, t.D + t.E + t.F], [0.11883116457625, 0.0410424544077993], rtol=1e-13)
    np.testing.assert_allclose(np.diag(two.total_cov), [0.0403566903642704, 0.118745199179134], rtol=1e-13)
    np.testing.assert_allclose(np.diag(two.average_true_cov), [0.0403519829993703, 0.118731996358935], rtol=1e-13)
    assert float(two.total_cov[0, 1]) == pytest.approx(-0.0276790165342565, rel=1e-13)
    assert float(two.average_true_cov[0, 1]) == pytest.approx(-0.027675462049022, rel=1e-13)


def characteristic_sums(d, turns, s, sd):
    """Moments of e given measurements, term by term: E exp(j v·ξ) = exp(-s²|v|²/2) for the 2n independent errors ξ.

    e is a sum of terms (d_k x or noise) · exp(j v·ξ): three for every step. Shares nothing with the code but the model.
    """
    n = len(d)
    z = d * np.exp(1j * np.cumsum(turns))
    turned = np.tril(np.ones((n, n)))
    past, none = -turned, np.zeros((n, n))
    # vectors over (fresh errors, errors of the measured path), weights, and how the weights vary with distance errors
    vectors = np.concatenate([np.hstack([turned, past]), np.hstack([none, past]), np.hstack([turned, past])])
    weights = np.concatenate([z, -z, 0 * z])
    phase = np.tile(z / d, 3)
    in_length = np.concatenate([np.eye(n), -np.eye(n), np.zeros((n, n))])  # coefficients of the path's distance errors
    in_fresh = np.concatenate([np.zeros((2 * n, n)), np.eye(n)])
    varying = sd**2 * (in_length @ in_length.T + in_fresh @ in_fresh.T)

    def second(vectors, weights, varying, phase):
        plus = np.exp(-0.5 * s**2 * ((vectors[:, None] + vectors[None]) ** 2).sum(-1))
        minus = np.exp(-0.5 * s**2 * ((vectors[:, None] - vectors[None]) ** 2).sum(-1))
        hermitian = np.outer(weights, weights.conj()) + varying * np.outer(phase, phase.conj())
        return (hermitian * minus).sum().real, (
            (np.outer(weights, weights) + varying * np.outer(phase, phase)) * plus
        ).sum()

    mean = (weights * np.exp(-0.5 * s**2 * (vectors**2).sum(-1))).sum()
    loss = np.exp(-0.5 * s**2 * np.arange(1, n + 1)) - 1
    of_bias = second(np.hstack([none, past]), z * loss, sd**2 * np.diag(loss**2), z / d)
    return mean, second(vectors, weights, varying, phase), of_bias


def as_matrix(N, e2):
    return np.array([[N + e2.real, e2.imag], [e2.imag, N - e2.real]]) / 2


@pytest.mark.parametrize(("s", "sd", "n"), [(0.1, 0.1, 3), (0.3, 0.4, 9), (1.2, 0.0, 7), (0.02, 0.7, 25)])
def test_proposition_2_is_the_sum_over_all_pairs_of_terms(s, sd, n):
    d, turns = random_path(n, n)
    mean, (N, e2), (mu_N, mu_e2) = characteristic_sums(d, turns, s, sd)
    found = proposition_2(d, turns, heading_std_rad=s, distance_std_m=sd)
    m = np.array([mean.real, mean.imag])
    np.testing.assert_allclose(found.bias, m, rtol=1e-10)
    np.testing.assert_allclose(found.total_cov, as_matrix(N, e2) - np.outer(m, m), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found.average_true_cov, as_matrix(N - mu_N, e2 - mu_e2), rtol=1e-10, atol=1e-12)


def test_one_step_has_the_average_true_moments_of_lerro_and_bar_shalom():
    """D. Lerro, Y. Bar-Shalom 1993: mean and covariance of a debiased polar measurement."""
    r, t, sr, st_ = 3.0, 0.7, 0.2, 0.3
    found = proposition_2([r], [t], heading_std_rad=st_, distance_std_m=sr)
    v, c, s = st_**2, cos(t) ** 2, sin(t) ** 2

    def along(c, s):
        by_range = c * (cosh(2 * v) - cosh(v)) + s * (sinh(2 * v) - sinh(v))
        by_noise = c * (2 * cosh(2 * v) - cosh(v)) + s * (2 * sinh(2 * v) - sinh(v))
        return exp(-2 * v) * (r**2 * by_range + sr**2 * by_noise)

    across = sin(t) * cos(t) * exp(-4 * v) * (sr**2 + (r**2 + sr**2) * (1 - exp(v)))
    expected = np.array([[along(c, s), across], [across, along(s, c)]])
    np.testing.assert_allclose(found.average_true_cov, expected, rtol=1e-12)
    np.testing.assert_allclose(found.bias, r * np.array([cos(t), sin(t)]) * (exp(-v) - exp(-v / 2)), rtol=1e-12)
    # misprint 6: the total is something else
    assert float(found.average_true_cov[0, 0]) == pytest.approx(0.360926, abs=5e-7)
    assert float(found.total_cov[0, 0]) == pytest.approx(0.361604, abs=5e-7)


# --- Monte Carlo, and the misprints -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drives:
    """Samples of every entry of the tables and of the error itself, paper coordinates as y + jx."""

    entries: dict[str, np.ndarray]
    error: np.ndarray
    true_bias: np.ndarray  # E[e | true path]; only for unknown paths
    path_error: np.ndarray  # measured end - true end


STEPS, HEADING, DISTANCE = 9, 0.2, 0.6
PATH = random_path(2, STEPS)


@cache
def drives(unknown_path: bool, runs: int = 400_000) -> Drives:
    rng = np.random.default_rng(20 + unknown_path)
    d, turns = PATH
    T, eta = np.zeros(runs), np.zeros(runs)
    single_x, single_y, square_x, square_y = (np.zeros(runs) for _ in range(4))
    noise_x, noise_y = np.zeros(runs), np.zeros(runs)
    mu, true_end = np.zeros(runs, complex), np.zeros(runs, complex)
    for k in range(STEPS):
        T += turns[k] - unknown_path * rng.normal(0, HEADING, runs)
        length = d[k] - unknown_path * rng.normal(0, DISTANCE, runs)
        eta += rng.normal(0, HEADING, runs)
        from_distance = rng.normal(0, DISTANCE, runs)
        x = length * (np.sin(T + eta) - np.sin(T))
        y = length * (np.cos(T + eta) - np.cos(T))
        single_x += x
        single_y += y
        square_x += x**2
        square_y += y**2
        noise_x += from_distance * np.sin(T + eta)
        noise_y += from_distance * np.cos(T + eta)
        step = length * np.exp(1j * T)
        mu += step * np.expm1(-0.5 * (k + 1) * HEADING**2)
        true_end += step
    entries = {"A": square_x, "B": single_x**2 - square_x, "C": noise_x**2}
    entries |= {"D": square_y, "E": single_y**2 - square_y, "F": noise_y**2}
    error = single_y + noise_y + 1j * (single_x + noise_x)
    return Drives(entries, error, mu, (d * np.exp(1j * np.cumsum(turns))).sum() - true_end)


def z_score(samples: np.ndarray, value: float) -> float:
    return float((samples.mean() - value) / (samples.std() / np.sqrt(len(samples))))


def printed_table_1() -> Table:
    """Table I as printed: A with a wrong sign, C and F without δ_d²."""
    d, turns = PATH
    i = np.arange(1, STEPS + 1)
    T, h, g = np.cumsum(turns), np.exp(-0.5 * i * HEADING**2), np.exp(-2 * i * HEADING**2)
    sn, cs = np.sin(T), np.cos(T)
    p, q = np.triu_indices(STEPS, 1)
    k = np.exp(-0.5 * (q - p) * HEADING**2)
    alpha = -h[p] + 0.5 * (1 + g[p]) * k + 1 - h[p] * k
    beta = 0.5 * (1 - g[p]) * k

    def pairs(own, other):
        delta = T[q] - T[p]
        bracket = own[p] ** 2 * np.cos(delta) * alpha + other[p] ** 2 * np.cos(delta) * beta
        side = 1 if own is sn else -1
        return 2 * np.sum(d[p] * d[q] * (bracket + side * own[p] * other[p] * np.sin(delta) * (alpha - beta)))

    return Table(
        A=np.sum(d**2 * (sn**2 * (0.5 * g + 1.5 - 2 * h) + 0.5 * cs**2 * (g + 1))),
        B=pairs(sn, cs),
        C=np.sum(0.5 * sn**2 * (1 + g) + 0.5 * cs**2 * (1 - g)),
        D=np.sum(d**2 * (cs**2 * (0.5 * g + 1.5 - 2 * h) + 0.5 * sn**2 * (1 - g))),
        E=pairs(cs, sn),
        F=np.sum(0.5 * cs**2 * (1 + g) + 0.5 * sn**2 * (1 - g)),
    )


@pytest.mark.parametrize("entry", "ABCDEF")
def test_table_1_is_confirmed_by_simulation(entry):
    found = proposition_1(*PATH, heading_std_rad=HEADING, distance_std_m=DISTANCE)
    assert abs(z_score(drives(False).entries[entry], getattr(found.table, entry))) < 4


@pytest.mark.parametrize("entry", "ACF")
def test_the_misprinted_entries_of_table_1_are_refuted_by_simulation(entry):
    assert abs(z_score(drives(False).entries[entry], getattr(printed_table_1(), entry))) > 50


@pytest.mark.parametrize("entry", "BDE")
def test_the_other_entries_of_table_1_are_right_as_printed(entry):
    found = proposition_1(*PATH, heading_std_rad=HEADING, distance_std_m=DISTANCE)
    assert float(getattr(printed_table_1(), entry)) == pytest.approx(float(getattr(found.table, entry)), rel=1e-12)


def table_2_single_entries(*misprints: str) -> dict[str, float]:
    """A1, C1, D1, F1 of Table II with the misprints named: sign, half, path_noise, factor."""
    d, turns = PATH
    i = np.arange(1, STEPS + 1)
    T, h, g = np.cumsum(turns), np.exp(-0.5 * i * HEADING**2), np.exp(-2 * i * HEADING**2)
    S = 0.5 * (1 - g * np.cos(2 * T))
    K = 1 - S
    moved = d**2 + (0 if "path_noise" in misprints else DISTANCE**2)
    factor = 1 if "factor" in misprints else DISTANCE**2
    forward, sideways = 0.5 * g + 1.5 - 2 * h, 1 - g
    return {
        "A": np.sum(moved * (S * forward + 0.5 * K * (1 + g if "sign" in misprints else 1 - g))),
        "D": np.sum(
            moved * (S * sideways + 0.5 * K * forward if "half" in misprints else 0.5 * S * sideways + K * forward)
        ),
        "C": factor * np.sum(0.5 * (1 + g) * S + 0.5 * (1 - g) * K),
        "F": factor * np.sum(0.5 * (1 + g) * K + 0.5 * (1 - g) * S),
    }


@pytest.mark.parametrize("entry", "ABCDEF")
def test_table_2_is_confirmed_by_simulation(entry):
    found = proposition_2(*PATH, heading_std_rad=HEADING, distance_std_m=DISTANCE)
    assert abs(z_score(drives(True).entries[entry], getattr(found.table, entry))) < 4


@pytest.mark.parametrize("entry", "ACDF")
def test_the_single_sums_of_table_2_are_the_corrected_ones(entry):
    found = proposition_2(*PATH, heading_std_rad=HEADING, distance_std_m=DISTANCE)
    assert float(getattr(found.table, entry)) == pytest.approx(table_2_single_entries()[entry], rel=1e-12)


@pytest.mark.parametrize(
    ("misprint", "entries"), [("sign", "A"), ("half", "D"), ("path_noise", "AD"), ("factor", "CF")]
)
def test_each_misprint_of_table_2_is_refuted_by_simulation(misprint, entries):
    for entry in entries:
        assert abs(z_score(drives(True).entries[entry], table_2_single_entries(misprint)[entry])) > 50


def test_proposition_2_is_confirmed_by_simulation():
    found = proposition_2(*PATH, heading_std_rad=HEADING, distance_std_m=DISTANCE)
    sample = drives(True)
    e, mu = sample.error, sample.true_bias
    assert abs(z_score(e.real, found.bias[0])) < 4
    assert abs(z_score(e.imag, found.bias[1])) < 4
    assert abs(z_score(sample.path_error.real, found.measured_path_bias[0])) < 4
    assert abs(z_score(sample.path_error.imag, found.measured_path_bias[1])) < 4
    centred = e - complex(*found.bias)
    for total, average, f in (
        (found.total_cov[0, 0], found.average_true_cov[0, 0], lambda z: z.real**2),
        (found.total_cov[1, 1], found.average_true_cov[1, 1], lambda z: z.imag**2),
        (found.total_cov[0, 1], found.average_true_cov[0, 1], lambda z: z.real * z.imag),
    ):
        assert abs(z_score(f(centred), total)) < 4
        assert abs(z_score(f(e) - f(mu), average)) < 4


def test_equation_6_and_proposition_2_differ_by_the_spread_of_the_bias():
    """Misprint 6: were they the same, the bias would not depend on the true path."""
    found = proposition_2(*PATH, heading_std_rad=HEADING, distance_std_m=DISTANCE)
    spread = np.abs(drives(True).true_bias - complex(*found.bias)) ** 2
    assert abs(z_score(spread, float(np.trace(found.total_cov - found.average_true_cov)))) < 4
    assert abs(z_score(spread, 0.0)) > 50


def test_the_sine_belongs_inside_the_sum():
    """Misprint 7: a product of sums is not even the position of a noise-free L."""
    d, T = np.array([1.0, 1.0]), np.array([0.0, np.pi / 2])
    assert d.sum() * np.sin(T).sum() != pytest.approx((d * np.sin(T)).sum())


def test_the_mean_of_proposition_2_has_the_opposite_sign_of_the_error_already_made():
    d, turns = random_path(5, 10)
    found = proposition_2(d, turns, heading_std_rad=1e-4, distance_std_m=0.1)
    np.testing.assert_allclose(found.bias, -found.measured_path_bias, rtol=1e-6)  # equal to first order in 10 · 10⁻⁸


def test_a_detour_cancels_the_bias_while_the_error_grows():
    """Misprint 8: the norm of the bias is no cost to rank paths by."""
    noise = OdometryNoise(heading_var_per_m=1e-3)
    straight = predict_drift([(0, 0), (10, 0)], noise).end
    detour = predict_drift([(0, 0), (10 + 50**0.5, 0), (10, 0)], noise).end
    assert float(straight.bias_norm) == pytest.approx(0.02496, abs=5e-6)
    assert float(detour.bias_norm) == pytest.approx(0.00017, abs=5e-6)
    assert float(straight.rms) == pytest.approx(0.577, abs=5e-4)
    assert float(detour.rms) == pytest.approx(0.754, abs=5e-4)


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("proposition", [proposition_1, proposition_2])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"distances_m": []}, "one shape"),
        ({"turns_rad": [0.1]}, "one shape"),
        ({"distances_m": [1.0, np.nan, 1.0]}, r"distances_m finite, got nan at index \(1,\)"),
        ({"turns_rad": "abc"}, "turns_rad to be numbers"),
        ({"heading_std_rad": -0.1}, "heading_std_rad >= 0"),
        ({"distance_std_m": np.inf}, "distance_std_m finite"),
        ({"distance_std_m": None}, "distance_std_m to be a number"),
    ],
)
def test_bad_input_is_named(proposition, change, message):
    with pytest.raises(ValueError, match=message):
        proposition(**(TOY | change))
