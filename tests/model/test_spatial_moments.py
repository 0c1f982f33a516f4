"""Laws of the two spatial algebras, and that they agree where both apply."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model.spatial.drift import power
from driftplan.model.spatial.isotropic import IsotropicMoments
from driftplan.model.spatial.moments import SpatialMoments, scan, spread
from driftplan.model.spatial.rotations import RotationNoise

ALGEBRAS = [SpatialMoments, IsotropicMoments]
BIAS = np.array([0.02, -0.01, 0.03])
COV = np.array([[0.03, 0.01, 0.0], [0.01, 0.02, 0.005], [0.0, 0.005, 0.01]])
seeds = st.integers(0, 10**6)
algebras = st.sampled_from(ALGEBRAS)


def arbitrary(algebra, rng):
    """Any numbers will do: composition is associative as an identity of polynomials."""
    p = rng.normal(size=3)
    if algebra is SpatialMoments:
        X = rng.normal(size=(9, 10))
        X[6:, :6] = 0  # the one structural zero: v does not see the square
        return SpatialMoments(p, X)
    Q = rng.normal(size=(3, 3))
    return IsotropicMoments(p, *rng.normal(size=(2,)), *rng.normal(size=(3, 3)), Q + Q.T)


def rotation(rng, std=1.0):
    return RotationNoise.isotropic(std).sample(rng, 1)[0]


def steps(algebra, rng, n, noise=None, turn=1.0):
    S = RotationNoise.isotropic(turn).sample(rng, n)
    noise = noise if noise is not None else RotationNoise.isotropic(0.2)
    return spread(algebra.of_step(noise, BIAS, COV).rotated(S).moved(rng.normal(size=(n, 3))), n)


def assert_same(A, B, rtol, least=1e-300):
    """Equal to rounding of the largest entry of each array, or of ``least``."""
    for name, a, b in zip(A._fields, A, B, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=rtol * max(np.abs(b).max(), least), err_msg=name)


@given(seed=seeds, algebra=algebras)
def test_composition_is_associative(seed, algebra):
    rng = np.random.default_rng(seed)
    A, B, C = (arbitrary(algebra, rng) for _ in range(3))
    assert_same(A.append(B).append(C), A.append(B.append(C)), rtol=1e-12)  # rounding, with some cancellation


@given(seed=seeds, algebra=algebras)
def test_a_motion_of_no_length_and_no_noise_is_neutral(seed, algebra):
    X = arbitrary(algebra, np.random.default_rng(seed))
    identity = algebra(*(np.zeros_like(x) for x in X))
    assert_same(identity.append(X), X, rtol=1e-15)
    assert_same(X.append(identity), X, rtol=1e-15)


@given(seed=seeds, algebra=algebras)
def test_rotating_the_world_commutes_with_composition(seed, algebra):
    rng = np.random.default_rng(seed)
    A, B = (arbitrary(algebra, rng) for _ in range(2))
    S = rotation(rng)
    assert_same(A.append(B).rotated(S), A.rotated(S).append(B.rotated(S)), rtol=1e-13)


@given(seed=seeds, algebra=algebras)
def test_moving_is_appending_a_motion_without_noise(seed, algebra):
    rng = np.random.default_rng(seed)
    A, z = arbitrary(algebra, rng), rng.normal(size=3)
    pure = algebra(z, *(np.zeros_like(x) for x in A[1:]))
    assert_same(A.moved(z), A.append(pure), rtol=1e-14)


@settings(max_examples=30)
@given(seed=seeds, algebra=algebras, n=st.integers(1, 70))
def test_prefixes_are_the_motions_one_after_the_other(seed, algebra, n):
    pieces = steps(algebra, np.random.default_rng(seed), n)
    found = pieces.prefixes()
    total = algebra(*(x[0] for x in pieces))
    for k in range(n):
        if k:
            total = total.append(algebra(*(x[k] for x in pieces)))
        assert_same(algebra(*(x[k] for x in found)), total, rtol=1e-12)


@settings(max_examples=30)
@given(seed=seeds, algebra=algebras, counts=st.lists(st.integers(0, 40), min_size=1, max_size=4))
def test_powers_are_repeated_compositions(seed, algebra, counts):
    rng = np.random.default_rng(seed)
    n = len(counts)
    R = RotationNoise.isotropic(1.0).sample(rng, n)
    pieces = algebra.of_step(RotationNoise.isotropic(0.2), BIAS, COV).rotated(R).moved(rng.normal(size=(n, 3)))
    pieces = spread(pieces, n)
    gained, found = power(R, pieces, np.array(counts))
    for k, count in enumerate(counts):
        piece, turned = algebra(*(x[k] for x in pieces)), np.eye(3)
        total = algebra(*(np.zeros_like(x) for x in piece))
        for _ in range(count):
            total, turned = total.append(piece.rotated(turned)), turned @ R[k]
        assert_same(algebra(*(x[k] for x in found)), total, rtol=1e-12)
        np.testing.assert_allclose(gained[k], turned, atol=1e-13)


@pytest.mark.parametrize("std", [1e-10, 0.1, 1.0, 3.0])
def test_both_algebras_say_the_same_of_isotropic_noise(std):
    noise = RotationNoise.isotropic(std)
    one, two = (steps(algebra, np.random.default_rng(1), 40, noise).prefixes() for algebra in ALGEBRAS)
    assert isinstance(one, SpatialMoments)
    assert isinstance(two, IsotropicMoments)
    for a, b in ((one.p, two.p), (one.bias, two.bias), (one.square, two.square)):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-13 * np.abs(b).max())
    np.testing.assert_allclose(
        one.X[..., 6:, 6:9], -two.lost1[:, None, None] * np.eye(3), rtol=0, atol=1e-13 * np.abs(two.lost1).max()
    )


@given(values=st.lists(st.floats(-5, 5), min_size=1, max_size=200))
def test_scan_gives_all_prefixes(values):
    (sums,) = scan(lambda A, B: [A[0] + B[0]], [np.array(values)])
    np.testing.assert_allclose(sums, np.cumsum(values), rtol=0, atol=1e-12)  # order of summation


def straight(x, length=2.0, along=0.0, across=0.0):
    run = np.array([length, 0.0, 0.0])
    return IsotropicMoments.of_straight_runs(run, np.array(x / length), np.array(along), np.array(across))


@pytest.mark.parametrize("x", [1e-20, 1e-8, 0.01, 0.69, 0.6999999, 0.7000001, 1.4, 5.0, 60.0])
@pytest.mark.parametrize(("along", "across"), [(0.0, 0.0), (0.3, 0.0), (0.1, 0.4)])
def test_cutting_a_continuous_run_in_two_changes_nothing(x, along, across):
    """Crosses the switch between series and closed form at x = 0.7 as well."""
    half = straight(x / 2, 1.0, along, across)
    assert_same(half.append(half), straight(x, 2.0, along, across), rtol=1e-13, least=min(x, 1.0))


def test_a_continuous_run_is_the_limit_of_ever_shorter_steps():
    """Steps err before they move: an error of first order in the step, which two step lengths remove."""
    exact = straight(0.8, 2.0, 0.03, 0.01)
    answers = []
    for n in (500, 1000):
        noise = RotationNoise.brownian((0.8 / n) ** 0.5)
        step = IsotropicMoments.of_step(noise, np.zeros(3), np.diag([0.03, 0.01, 0.01]) * 2.0 / n)
        _, limit = power(
            np.eye(3)[None], spread(step.moved(np.array([2.0 / n, 0.0, 0.0])), 1), np.array([n], dtype=np.int64)
        )
        answers.append(limit)
    for name, coarse, fine, limit in zip(exact._fields, *answers, exact, strict=True):
        # what remains is of the order of (0.8/1000)² times a small constant
        np.testing.assert_allclose(2 * fine[0] - coarse[0], limit, rtol=0, atol=2e-6, err_msg=name)
