"""Laws of the spatial algebra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model.spatial.drift import power
from driftplan.model.spatial.moments import SpatialMoments, scan
from driftplan.model.spatial.rotations import RotationNoise

BIAS = np.array([0.02, -0.01, 0.03])
COV = np.array([[0.03, 0.01, 0.0], [0.01, 0.02, 0.005], [0.0, 0.005, 0.01]])
seeds = st.integers(0, 10**6)


def arbitrary(rng):
    """Any numbers will do: composition is associative as an identity of polynomials."""
    return SpatialMoments(*(rng.normal(size=(*shape, 1)) for shape in ((3,), (3, 3), (5, 5), (6, 3), (3,), (6,))))


def round_ones(rng):
    """The same for noise that prefers no direction, and with the matrices written out."""
    p, _, _, C, e, Q = arbitrary(rng)
    M, W = rng.normal(size=(2, 1, 1, 1))
    short = SpatialMoments(p, M, W, C, e, Q)
    return short, short._replace(M=M * np.eye(3)[..., None], W=W * np.eye(5)[..., None])


def rotation(rng, std=1.0):
    return RotationNoise.isotropic(std).sample(rng, 1)[0][..., None]


def steps(rng, n):
    S = np.moveaxis(RotationNoise.isotropic(1.0).sample(rng, n), 0, -1)
    law = RotationNoise.isotropic(0.2) if rng.random() < 0.5 else RotationNoise.anisotropic(COV)
    return SpatialMoments.of_step(law, BIAS, COV).rotated(S).moved(rng.normal(size=(3, n)))


def assert_same(A, B, rtol, least=1e-300):
    """Equal to rounding of the largest entry of each array, or of ``least``."""
    for name, a, b in zip(A._fields, A, B, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=rtol * max(np.abs(b).max(), least), err_msg=name)


@given(seed=seeds)
def test_composition_is_associative(seed):
    rng = np.random.default_rng(seed)
    A, B, C = (arbitrary(rng) for _ in range(3))
    assert_same(A.append(B).append(C), A.append(B.append(C)), rtol=1e-12)  # rounding, with some cancellation


@given(seed=seeds)
def test_multiples_of_the_identity_may_be_kept_as_one_number(seed):
    rng = np.random.default_rng(seed)
    (A, full_A), (B, full_B) = round_ones(rng), round_ones(rng)
    S = rotation(rng)
    found, full = (X.append(Y).rotated(S) for X, Y in ((A, B), (full_A, full_B)))
    assert_same(found._replace(M=full.M, W=full.W), full, rtol=1e-12)
    np.testing.assert_allclose(found.M * np.eye(3)[..., None], full.M, atol=1e-13 * np.abs(full.M).max())
    np.testing.assert_allclose(found.W * np.eye(5)[..., None], full.W, atol=1e-13 * np.abs(full.W).max())


@given(seed=seeds)
def test_a_motion_of_no_length_and_no_noise_is_neutral(seed):
    X = arbitrary(np.random.default_rng(seed))
    identity = SpatialMoments(*(np.zeros_like(x) for x in X))
    assert_same(identity.append(X), X, rtol=1e-15)
    assert_same(X.append(identity), X, rtol=1e-15)


@given(seed=seeds)
def test_rotating_the_world_commutes_with_composition(seed):
    rng = np.random.default_rng(seed)
    A, B = (arbitrary(rng) for _ in range(2))
    S = rotation(rng)
    assert_same(A.append(B).rotated(S), A.rotated(S).append(B.rotated(S)), rtol=1e-13)


@given(seed=seeds)
def test_moving_is_appending_a_motion_without_noise(seed):
    rng = np.random.default_rng(seed)
    A, z = arbitrary(rng), rng.normal(size=(3, 1))
    pure = SpatialMoments(z, *(np.zeros_like(x) for x in A[1:]))
    assert_same(A.moved(z), A.append(pure), rtol=1e-14)


@settings(max_examples=30)
@given(seed=seeds, n=st.integers(1, 70))
def test_prefixes_are_the_motions_one_after_the_other(seed, n):
    pieces = steps(np.random.default_rng(seed), n).spread(n)
    found, total = pieces.prefixes(), pieces.part([0])
    for k in range(n):
        if k:
            total = total.append(pieces.part([k]))
        assert_same(found.part([k]), total, rtol=1e-12)


@settings(max_examples=30)
@given(seed=seeds, counts=st.lists(st.integers(0, 40), min_size=1, max_size=4))
def test_powers_are_repeated_compositions(seed, counts):
    rng = np.random.default_rng(seed)
    n = len(counts)
    R, pieces = np.moveaxis(RotationNoise.isotropic(1.0).sample(rng, n), 0, -1), steps(rng, n).spread(n)
    gained, found = power(R, pieces, np.array(counts))
    for k, count in enumerate(counts):
        piece, turned = pieces.part([k]), np.eye(3)
        total = SpatialMoments(*(np.zeros_like(x) for x in piece))
        for _ in range(count):
            total, turned = total.append(piece.rotated(turned[..., None])), turned @ R[..., k]
        assert_same(found.part([k]), total, rtol=1e-12)
        np.testing.assert_allclose(gained[..., k], turned, atol=1e-13)


@given(values=st.lists(st.floats(-5, 5), min_size=1, max_size=200))
def test_scan_gives_all_prefixes(values):
    (sums,) = scan(lambda A, B: [A[0] + B[0]], [np.array(values)])
    np.testing.assert_allclose(sums, np.cumsum(values), rtol=0, atol=1e-12)  # order of summation


def straight(x, length=2.0, along=0.0, across=0.0):
    run = np.array([[length], [0.0], [0.0]])
    return SpatialMoments.of_straight_runs(run, np.array([x / length]), np.array([along]), np.array([across]))


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
        step = SpatialMoments.of_step(noise, np.zeros(3), np.diag([0.03, 0.01, 0.01]) * 2.0 / n)
        piece = step.moved(np.array([[2.0 / n], [0.0], [0.0]]))
        _, limit = power(np.eye(3)[..., None], piece, np.array([n], dtype=np.int64))
        answers.append(limit)
    for name, coarse, fine, limit in zip(exact._fields, *answers, exact, strict=True):
        # what remains is of the order of (0.8/1000)² times a small constant
        np.testing.assert_allclose(2 * fine - coarse, limit, rtol=0, atol=2e-6, err_msg=name)
