"""Laws of the algebra, on arbitrary tuples as well as on moments that real noise produces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.model.elements import run_moments, turn_moments
from driftplan.model.moments import Moments, compose, doubled, identity, power, scan
from driftplan.model.noise import OdometryNoise


def arbitrary(rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Moments:
    """Any ten numbers with |u| = 1: the algebra is a polynomial identity and need not come from a distribution."""

    def z():
        return rng.normal(size=shape) + 1j * rng.normal(size=shape)

    return Moments(
        np.exp(1j * rng.normal(size=shape)),
        z(),
        z(),
        z(),
        rng.normal(size=shape),
        z(),
        rng.normal(size=shape),
        z(),
        z(),
        z(),
    )


def realistic(rng: np.random.Generator, n: int, heading_std: float = 0.1) -> Moments:
    noise = OdometryNoise(
        heading_var_per_m=heading_std**2,
        distance_var_per_m=0.01,
        lateral_var_per_m=0.002,
        heading_var_per_rad=heading_std**2,
        heading_bias_per_m=0.02,
        distance_scale_error=0.03,
        heading_distance_corr=0.4,
    )
    runs = run_moments(rng.uniform(0, 2, n), rng.normal(0, 0.3, n) * rng.integers(0, 2, n), noise)
    return compose(turn_moments(rng.normal(0, 1, n), noise), runs)


def assert_same(X: Moments, Y: Moments, rtol: float, scale: float | None = None) -> None:
    for name, x, y in zip(Moments.__slots__, X.arrays(), Y.arrays(), strict=True):
        size = np.max(np.abs(y)) if scale is None else scale
        np.testing.assert_allclose(x, y, rtol=rtol, atol=rtol * size, err_msg=name)


@given(seed=st.integers(0, 10**6))
def test_composition_is_associative(seed):
    rng = np.random.default_rng(seed)
    A, B, C = (arbitrary(rng) for _ in range(3))
    left, right = compose(compose(A, B), C), compose(A, compose(B, C))
    size = max(float(np.abs(x).max()) for x in left.arrays())
    assert_same(left, right, rtol=1e-12, scale=max(size, 100.0))  # rounding of sums of products up to size


@given(seed=st.integers(0, 10**6))
def test_the_identity_is_neutral(seed):
    X = arbitrary(np.random.default_rng(seed))
    assert_same(compose(identity(), X), X, rtol=1e-15)
    assert_same(compose(X, identity()), X, rtol=1e-15)


@given(seed=st.integers(0, 10**6), angle=st.floats(-3, 3))
def test_rotating_is_composing_with_an_error_free_turn(seed, angle):
    X = arbitrary(np.random.default_rng(seed))
    u = np.exp(1j * angle)
    turn = Moments(u, *([np.zeros(())] * 9))
    assert_same(X.rotated(u), compose(turn, X), rtol=1e-14)


@given(seed=st.integers(0, 10**6), count=st.integers(0, 40))
def test_power_is_repeated_composition(seed, count):
    X = realistic(np.random.default_rng(seed), 1)[0]
    by_hand = identity()
    for _ in range(count):
        by_hand = compose(by_hand, X)
    # rounding of the sum of all steps: a drive that comes back to its start keeps no more digits than that
    assert_same(power(X, count), by_hand, rtol=1e-12, scale=max(1.0, count * float(np.abs(X.p))) ** 2)


def test_power_takes_a_count_for_each_piece():
    X = realistic(np.random.default_rng(0), 5)
    assert power(identity(), np.ones(20)).shape == (20,)
    counts = np.array([0, 1, 2, 7, 100])
    together = power(X, counts)
    for k, count in enumerate(counts):
        assert_same(together[k], power(X[k], int(count)), rtol=1e-13)


def test_powers_of_many_pieces_at_once_are_those_of_each():
    # more than are composed one by one in Python's numbers; odd, even and no counts side by side, and all odd
    X = realistic(np.random.default_rng(6), 24)
    for counts in (np.arange(24), np.arange(24) * 2, np.arange(24) * 2 + 1, np.array(60), np.array(7)):
        together = power(X, counts)
        for k, count in enumerate(np.broadcast_to(counts, 24)):
            assert_same(together[k], power(X[k], int(count)), rtol=1e-12, scale=1e3)


def test_doubling_touches_only_what_it_is_told_to():
    X = realistic(np.random.default_rng(1), 4)
    times = np.array([0, 1, 3, 0])
    assert_same(doubled(X, times), power(X, 2**times), rtol=1e-13)


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), n=st.integers(0, 60), heading_std=st.sampled_from([1e-9, 1e-3, 0.3, 2.0]))
def test_scan_is_one_composition_after_the_other(seed, n, heading_std):
    rng = np.random.default_rng(seed)
    pieces, start = realistic(rng, n, heading_std), realistic(rng, 1)[0]
    states = scan(pieces, start)
    assert states.shape == (n + 1,)
    state = start
    for k in range(n):
        state = compose(state, pieces[k])
    assert_same(states[n], state, rtol=1e-11)
    assert_same(states[0], start, rtol=0)


def test_scan_survives_the_loss_of_all_coherence():
    # 200 steps of 2 to 30 rad of heading noise: E[r²] falls by up to exp(-1800) a step, far below the least float
    rng = np.random.default_rng(3)
    noise = [OdometryNoise(heading_var_per_step=v, step_m=1.0) for v in (4.0, 900.0)]
    elements = [run_moments(rng.uniform(0.5, 1.0, 100), 0.0, n) for n in noise]
    pieces = Moments(*(np.concatenate(x) for x in zip(*(e.arrays() for e in elements), strict=True)))
    states = scan(pieces, identity())
    state = identity()
    for k in range(200):
        state = compose(state, pieces[k])
    assert_same(states[200], state, rtol=1e-12)
    # headings are then uniform: every step adds its own length squared to E|p̂|²
    assert np.isfinite(states.N).all()


def test_pieces_go_into_numbers_and_back_and_fields_of_any_shape_into_arrays_of_one():
    X = arbitrary(np.random.default_rng(7), (5,))
    assert_same(Moments.stack(X.numbers()), X, rtol=0)
    assert Moments.stack(X.numbers()).D.dtype == float
    mixed = Moments(1.0, 0.0, *X.arrays()[2:])
    assert [x.shape for x in mixed.arrays()] == [(5,)] * 10
    assert_same(mixed[3], Moments(1.0, 0.0, *X[3].arrays()[2:]), rtol=0)


def test_scan_works_on_batches():
    rng = np.random.default_rng(4)
    pieces = realistic(rng, 60)
    batch = Moments(*(x.reshape(3, 20) for x in pieces.arrays()))
    states = scan(batch, identity((3,)))
    assert_same(states, scan(batch, identity()), rtol=1e-15)  # from one start
    for k in range(3):
        assert_same(states[k], scan(pieces[20 * k : 20 * (k + 1)], identity()), rtol=1e-14)


def test_a_batch_is_cut_where_any_of_it_loses_its_coherence():
    wild, calm = OdometryNoise(heading_var_per_step=30.0, step_m=1.0), OdometryNoise(heading_var_per_m=1e-4)
    rows = [run_moments(np.ones(100), 0.0, noise) for noise in (calm, wild, calm)]
    states = scan(Moments(*(np.stack(x) for x in zip(*(row.arrays() for row in rows), strict=True))), identity((3,)))
    for k, row in enumerate(rows):
        state = identity()
        for i in range(100):
            state = compose(state, row[i])
        assert_same(states[k, 100], state, rtol=1e-11)


@pytest.mark.parametrize("n", [10**4])
def test_a_long_scan_keeps_its_digits(n):
    # against pairwise composition, whose rounding grows with log n only
    pieces = realistic(np.random.default_rng(5), n, heading_std=1e-3)
    tree = pieces
    while tree.shape[0] > 1:
        even = tree.shape[0] // 2 * 2
        rest = tree[even:]
        tree = compose(tree[0:even:2], tree[1:even:2])
        tree = Moments(*(np.concatenate(x) for x in zip(tree.arrays(), rest.arrays(), strict=True)))
    assert_same(scan(pieces, identity())[n], tree[0], rtol=1e-11)
