"""Rotation noise: closed forms against high precision, quadrature and the laws' own samples."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from driftplan.model.spatial.rotations import RotationNoise

COV = np.array([[0.05, 0.02, 0.0], [0.02, 0.04, 0.01], [0.0, 0.01, 0.09]])
STDS = [1e-12, 1e-8, 1e-4, 0.03, 0.3, 0.4999, 0.5001, 1.0, 3.0, 10.0]
LAWS = {
    "gaussian": RotationNoise.isotropic(0.3),
    "wide gaussian": RotationNoise.isotropic(2.0),
    "brownian": RotationNoise.brownian(0.3),
    "wide brownian": RotationNoise.brownian(1.2),
    "von Mises-Fisher": RotationNoise.von_mises_fisher(20.0),
    "wide von Mises-Fisher": RotationNoise.von_mises_fisher(0.3),
    "anisotropic": RotationNoise.anisotropic(COV),
    "about one axis": RotationNoise.anisotropic(np.diag([0.0, 0.0, 0.09])),
}


def exact_decay(law, parameter):
    """1 - l1 and 1 - l2 with 80 digits, from the characters 1 + 2 cos φ and 1 + 2 cos φ + 2 cos 2φ."""
    with mp.workdps(80):
        x = mp.mpf(parameter)
        if law == "brownian":
            return 1 - mp.exp(-x * x), 1 - mp.exp(-3 * x * x)
        if law == "gaussian":

            def lost(k):
                return 1 - (1 - k * k * x * x) * mp.exp(-k * k * x * x / 2)

            return 2 * lost(1) / 3, 2 * (lost(1) + lost(2)) / 5
        bessel = {order: mp.besseli(order, x) for order in (1, 3, 5)}
        return 1 - bessel[3] / bessel[1], 1 - bessel[5] / bessel[1]


@pytest.mark.parametrize(
    ("law", "build", "parameters"),
    [
        ("gaussian", RotationNoise.isotropic, STDS),
        ("brownian", RotationNoise.brownian, STDS),
        ("von_mises_fisher", RotationNoise.von_mises_fisher, [1e-9, 0.01, 1.0, 20.0, 99.9, 100.1, 1e4, 1e9]),
    ],
)
def test_isotropic_laws_keep_their_digits_for_all_sizes_of_noise(law, build, parameters):
    for parameter in parameters:
        expected = [float(x) for x in exact_decay(law, parameter)]
        np.testing.assert_allclose(build(parameter).decay, expected, rtol=2e-15)  # a few roundings


def test_published_numbers():
    """1 - l1 and 1 - l2 of Gaussian noise of 0.3 rad and of vMF noise with kappa 20 and 1e4."""
    cases = {
        RotationNoise.isotropic(0.3): (0.0866948610212527, 0.238187742491466),
        RotationNoise.von_mises_fisher(1e4): (3.99940001500184e-4, 1.19934019647172e-3),
        RotationNoise.von_mises_fisher(20): (0.185197549716577, 0.45781635511572),
    }
    for noise, expected in cases.items():
        np.testing.assert_allclose(noise.decay, expected, rtol=1e-13)  # the numbers come from double precision


@pytest.mark.parametrize("name", LAWS)
def test_moments_are_those_of_the_samples(name):
    noise, count = LAWS[name], 60_000
    offset = noise.sample(np.random.default_rng(3), count) - np.eye(3)
    pairs = np.einsum("nij,nkl->nijkl", offset, offset)
    for drawn, exact in ((offset, noise.mean_offset), (pairs, noise.square_offset)):
        error = drawn.std(axis=0) / count**0.5
        # four standard errors, and 1e-15 for entries that do not vary; 90 entries: P(any beyond) below 0.6 %
        assert (np.abs(drawn.mean(axis=0) - exact) <= 4 * error + 1e-15).all()


@pytest.mark.parametrize("name", LAWS)
def test_samples_are_rotations(name):
    R = LAWS[name].sample(np.random.default_rng(0), 100)
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)
    assert (np.linalg.det(R) > 0).all()


@given(std=st.sampled_from([1e-12, 1e-6, 0.01, 0.3, 1.0, 2.0, 3.1]))
def test_quadrature_agrees_with_the_closed_form_where_both_apply(std):
    round_one, general = RotationNoise.isotropic(std), RotationNoise.anisotropic(std**2 * np.eye(3))
    for exact, numeric in (
        (round_one.mean_offset, general.mean_offset),
        (round_one.square_offset, general.square_offset),
    ):
        scale = np.abs(exact).max()
        np.testing.assert_allclose(numeric, exact, atol=3e-14 * scale)  # sums of up to 3e4 rounded terms


@pytest.mark.parametrize("std", [1e-12, 1e-8, 0.1, 1.0])
def test_noise_about_one_axis_is_planar_heading_noise(std):
    noise = RotationNoise.anisotropic(np.diag([0.0, 0.0, std**2]))
    lost, lost2 = -np.expm1(-(std**2) / 2), -np.expm1(-2 * std**2)  # 1 - E cos, 1 - E cos 2θ
    np.testing.assert_allclose(noise.mean_offset, np.diag([-lost, -lost, 0.0]), rtol=1e-14)
    square = noise.square_offset
    np.testing.assert_allclose(square[0, 1, 0, 1], lost2 / 2, rtol=1e-14)  # E sin²θ
    np.testing.assert_allclose(square[0, 1, 1, 0], -lost2 / 2, rtol=1e-14)
    # E (1 - cos θ)², of fourth order: 2 lost - lost2/2 cancels, hence the 4th order law for tiny noise
    expected = 2 * lost - lost2 / 2 if std >= 0.1 else 0.75 * std**4
    np.testing.assert_allclose(square[0, 0, 1, 1], expected, rtol=1e-12)
    assert not square[2].any()
    assert not square[:, :, 2].any()


@given(seed=st.integers(0, 10**6))
def test_turning_the_axes_turns_the_moments(seed):
    rng = np.random.default_rng(seed)
    A = RotationNoise.isotropic(1.0).sample(rng, 1)[0]
    noise, turned = RotationNoise.anisotropic(COV), RotationNoise.anisotropic(A @ COV @ A.T)
    np.testing.assert_allclose(turned.mean_offset, A @ noise.mean_offset @ A.T, atol=1e-14)
    square = np.einsum("ia,jb,kc,ld,abcd->ijkl", A, A, A, A, noise.square_offset, optimize=True)
    np.testing.assert_allclose(turned.square_offset, square, atol=1e-14)


def test_tiny_anisotropic_noise_has_its_first_order_moments():
    cov = 1e-24 * COV
    noise = RotationNoise.anisotropic(cov)
    np.testing.assert_allclose(noise.mean_offset, 0.5 * (cov - np.trace(cov) * np.eye(3)), atol=1e-15 * 1e-24)
    cross = np.cross(np.eye(3), np.eye(3)[:, None])  # cross[a] = matrix of v -> v x e_a, up to sign
    np.testing.assert_allclose(
        noise.square_offset, np.einsum("aij,bkl,ab->ijkl", cross, cross, cov), atol=1e-15 * 1e-24
    )


def test_one_noise_per_step_is_many_noises():
    covs = np.array([COV, 0.1 * COV, np.zeros((3, 3))])
    many = RotationNoise.anisotropic(covs)
    for k in range(3):
        one = RotationNoise.anisotropic(covs[k])
        np.testing.assert_allclose(many.square_offset[k], one.square_offset, atol=1e-16)
        np.testing.assert_array_equal(many.of_steps(k).parameter, one.parameter)
    assert RotationNoise.isotropic([0.1, 0.2]).sample(np.random.default_rng(0), 5).shape == (5, 2, 3, 3)


def test_same_seed_same_samples():
    for noise in LAWS.values():
        one, two = (noise.sample(np.random.default_rng(7), 3) for _ in range(2))
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize(
    ("build", "value", "message"),
    [
        (RotationNoise.isotropic, -0.1, "std_rad to be a standard deviation >= 0, in rad, got -0.1"),
        (RotationNoise.isotropic, float("nan"), "std_rad"),
        (RotationNoise.isotropic, "wide", "std_rad"),
        (RotationNoise.isotropic, [[0.1]], "one per step, got an array of shape"),
        (RotationNoise.brownian, float("inf"), "std_rad"),
        (RotationNoise.von_mises_fisher, 0.0, "kappa > 0, got 0.0"),
        (RotationNoise.von_mises_fisher, -3.0, "kappa to be a concentration > 0"),
        (RotationNoise.anisotropic, [1.0, 2.0, 3.0], r"cov_rad2 of shape \(3, 3\)"),
        (RotationNoise.anisotropic, np.full((3, 3), np.nan), "cov_rad2 finite"),
        (RotationNoise.anisotropic, [[1, 1, 0], [0, 1, 0], [0, 0, 1]], "cov_rad2 symmetric"),
        (RotationNoise.anisotropic, np.diag([1.0, 1.0, -0.1]), "without negative eigenvalues, got -0.1"),
        (RotationNoise.anisotropic, np.diag([100.0, 0.0, 0.0]), "at most π rad, got 10 rad"),
    ],
)
def test_bad_parameters_say_what_was_expected(build, value, message):
    with pytest.raises(ValueError, match=message):
        build(value)


def test_anisotropic_noise_has_no_decay():
    with pytest.raises(ValueError, match="expected an isotropic law"):
        _ = RotationNoise.anisotropic(COV).decay


def test_the_parameter_is_a_private_copy():
    cov = COV.copy()
    noise = RotationNoise.anisotropic(cov)
    cov[:] = 0
    np.testing.assert_array_equal(noise.parameter, COV)
    with pytest.raises(ValueError, match="read-only"):
        noise.parameter[0, 0] = 1.0
