"""A fusing robot's state entry by entry, against the same with plain matrices: covariance, mean and constants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from driftplan.model.covariance import CovarianceMap, compose, identity, path_legs
from driftplan.model.filter_state import (
    HEADING_AXIS,
    FilterState,
    LegColumns,
    Row,
    bearing_row,
    heading_row,
    position_rows,
    range_row,
    states_along,
)
from driftplan.model.noise import OdometryNoise, SystematicSpread
from driftplan.model.paths import Run, read_path

NOISE = OdometryNoise(
    heading_var_per_m=1e-3,
    distance_var_per_m=2e-3,
    lateral_var_per_m=5e-4,
    heading_var_per_rad=2e-3,
    heading_distance_corr=0.4,
    heading_bias_per_m=0.01,
    heading_bias_per_rad=-0.02,
    distance_scale_error=0.03,
)
UNBIASED = replace(NOISE, heading_bias_per_m=0.0, heading_bias_per_rad=0.0, distance_scale_error=0.0)
CONSTANTS = SystematicSpread(heading_bias_per_m=0.02, distance_scale_error=0.05)
RUNS = [Run(length_m=4.0, curvature_per_m=0.3), Run(length_m=2.0, turn_rad=-1.0), Run(length_m=3.0, turn_rad=0.5)]
TOWARDS = np.array([3.0, -4.0])
READINGS = [
    position_rows(np.array([[0.04, 0.01], [0.01, 0.02]])),
    (heading_row(0.003), range_row(TOWARDS, 0.01)),
    (*position_rows(np.diag([0.05, 0.03])), bearing_row(TOWARDS, 0.002)),
]


def started(seed: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """A covariance and a mean."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size)) * 0.1
    return root @ root.T, rng.normal(size=size) * 0.1


def plainly_read(P, mean, rows):
    for row in rows:
        h = np.zeros(len(P))
        h[:3] = row.coefficients
        gain = P @ h / (h @ P @ h + row.variance)
        P, mean = P - np.outer(gain, h @ P), mean - gain * (h @ mean)
    return P, mean


def plainly_driven(P, mean, legs, k):
    return legs.A[k] @ P @ legs.A[k].T + legs.C[k], legs.A[k] @ mean + legs.shift[k]


def matches(state: FilterState, P, mean) -> None:
    np.testing.assert_allclose(state.matrix, P, rtol=1e-11, atol=1e-14)
    if mean is None:
        assert state.mean is None
    else:
        np.testing.assert_allclose(np.stack(state.mean, axis=-1), mean, rtol=1e-11, atol=1e-14)


def at_border(states: FilterState, k: int) -> FilterState:
    """One of the states along a path."""
    P, mean = ([x[..., k] for x in part] for part in (states.P, states.mean or ()))
    return FilterState(tuple(P), tuple(mean) if states.mean is not None else None)


@pytest.mark.parametrize("constants", [SystematicSpread(), CONSTANTS], ids=["pose", "constants"])
@pytest.mark.parametrize("noise", [NOISE, UNBIASED], ids=["biased", "unbiased"])
def test_states_along_a_path_are_those_of_plain_matrices(noise, constants):
    legs = path_legs(read_path(RUNS, 0.4), [noise], None, constants)
    P, mean = started(1, 3 + len(constants.names))
    state = FilterState.from_matrix(P, mean)
    columns = legs.columns()
    before, after = states_along(state, columns, {k + 1: [(rows, None)] for k, rows in enumerate(READINGS)})
    matches(at_border(before, 0), P, mean)
    matches(at_border(after, 0), P, mean)
    for k, rows in enumerate(READINGS):
        P, mean = plainly_driven(P, mean, legs, k)
        state = state.driven(columns[k])
        matches(state, P, mean)
        matches(at_border(before, k + 1), P, mean)
        assert state.trace == pytest.approx(P[0, 0] + P[1, 1], rel=1e-12)
        assert state.square == pytest.approx(P[0, 0] + P[1, 1] + mean[0] ** 2 + mean[1] ** 2, rel=1e-12)
        P, mean = plainly_read(P, mean, rows)
        state = state.read(rows)
        matches(state, P, mean)
        matches(at_border(after, k + 1), P, mean)


def test_a_bias_shifts_a_state_that_had_no_mean_and_without_one_there_is_none():
    for noise in (NOISE, UNBIASED):
        legs = path_legs(read_path(RUNS), [noise])
        P, none = np.zeros((3, 3)), np.zeros(3)
        driven = FilterState.at_start().driven(legs.columns()[0])
        P, mean = plainly_driven(P, none, legs, 0)
        matches(driven, P, mean if noise is NOISE else None)
        before, after = states_along(FilterState.at_start(), legs.columns(), {})
        matches(at_border(before, 1), P, mean if noise is NOISE else None)
        assert (after.mean is None) == (noise is UNBIASED)
    mixed = path_legs(read_path(RUNS), [NOISE, UNBIASED], np.array([1, 0, 1]))
    alone = [*path_legs(read_path(RUNS), [UNBIASED]).columns()[:1], *mixed.columns()[1:]]  # of which one has no shift
    matches(at_border(states_along(FilterState.at_start(), alone, {})[0], 2), *_two_driven(mixed))


def _two_driven(legs):
    return plainly_driven(*plainly_driven(np.zeros((3, 3)), np.zeros(3), legs, 0), legs, 1)


@pytest.mark.parametrize("chance", [0.0, 0.3, 1.0])
def test_a_reading_by_chance_leaves_the_mixture_of_read_and_missed(chance):
    P, mean = started(2, 3)
    rows = READINGS[1]
    read, moved = plainly_read(P, mean, rows)
    expected = chance * moved + (1 - chance) * mean
    second = chance * (read + np.outer(moved, moved)) + (1 - chance) * (P + np.outer(mean, mean))
    matches(FilterState.from_matrix(P, mean).read(rows, chance), second - np.outer(expected, expected), expected)
    matches(FilterState.from_matrix(P).read(rows, chance), chance * read + (1 - chance) * P, None)
    legs = path_legs(read_path(RUNS[:1]), [UNBIASED])
    _, after = states_along(FilterState.from_matrix(P, mean), legs.columns(), {0: [(rows, chance)]})
    matches(at_border(after, 0), second - np.outer(expected, expected), expected)


@pytest.mark.parametrize("biased", [True, False])
def test_many_drives_at_once_are_each_as_if_alone_with_means_and_chances_too(biased):
    """Of one path, starting with errors of their own; and of paths of their own."""
    begun = [started(seed, 3) for seed in range(4)]
    many = FilterState.from_matrix(
        np.stack([P for P, _ in begun]), np.stack([mean for _, mean in begun]) if biased else None
    )
    paths = np.random.default_rng(3).normal(size=(4, 4, 2)) * 4
    chances = np.array([0.0, 1.0, 0.4, 0.7])
    for of in (lambda k: read_path(paths[0]), lambda k: read_path(paths if k is None else paths[k])):
        noises = [NOISE if biased else UNBIASED]
        rows_at = {1: [(READINGS[0], None)], 2: [(READINGS[1], chances)], 3: [(READINGS[2], 0.5), (READINGS[0], None)]}
        together = states_along(many, path_legs(of(None), noises).columns(), rows_at)
        for k, (P, mean) in enumerate(begun):
            single = {
                b: [(rows, c[k] if isinstance(c, np.ndarray) else c) for rows, c in r] for b, r in rows_at.items()
            }
            start = FilterState.from_matrix(P, mean if biased else None)
            for states, alone in zip(
                together, states_along(start, path_legs(of(k), noises).columns(), single), strict=True
            ):
                np.testing.assert_allclose(states.matrix[k], alone.matrix, rtol=1e-10, atol=1e-14)
                if biased:
                    np.testing.assert_allclose(
                        np.stack(states.mean)[:, k], np.stack(alone.mean), rtol=1e-10, atol=1e-14
                    )
                else:
                    assert states.mean is None


def test_states_of_a_grid_of_drives_come_from_their_matrices():
    grid = [[started(2 * i + j, 5) for j in range(2)] for i in range(3)]
    P, mean = (np.array([[one[k] for one in row] for row in grid]) for k in (0, 1))
    matches(FilterState.from_matrix(P, mean), P, mean)
    matches(FilterState.from_matrix(P[0, 0], mean[0, 0]), P[0, 0], mean[0, 0])


def test_a_perfect_reading_in_an_element_counts_as_one_of_a_micrometre_or_microradian():
    row = bearing_row(TOWARDS, 0.0)
    h = np.array(row.coefficients)
    np.testing.assert_allclose(identity().read((row,)).J, np.outer(h, h) / (1e-12 * h @ h), rtol=1e-12)


def test_elements_of_a_grid_of_paths_are_each_as_if_alone():
    paths = np.random.default_rng(9).normal(size=(2, 4, 3, 2))
    begun = np.stack([[started(4 * i + j, 3)[0] for j in range(4)] for i in range(2)])
    whole = path_legs(read_path(paths), [UNBIASED])
    first, second = (CovarianceMap(*(x[..., k, :, :] for x in whole.maps.arrays())) for k in (0, 1))
    together = compose(first.read(READINGS[1]), second.read(READINGS[2]))
    ends = together(begun)
    for i, j in np.ndindex(2, 4):
        P, none = begun[i, j], np.zeros(3)
        for k in (0, 1):
            P = plainly_read(
                *plainly_driven(P, none, path_legs(read_path(paths[i, j]), [UNBIASED]), k), READINGS[k + 1]
            )[0]
        np.testing.assert_allclose(ends[i, j], P, rtol=1e-9, atol=1e-14)
        np.testing.assert_allclose(together[i].A[j], together.A[i, j], rtol=0)


def test_many_paths_may_begin_with_one_error():
    P, mean = started(6, 3)
    paths = np.random.default_rng(7).normal(size=(4, 3, 2))
    _, after = states_along(FilterState.from_matrix(P, mean), path_legs(read_path(paths), [UNBIASED]).columns(), {})
    for k, path in enumerate(paths):
        legs = path_legs(read_path(path), [UNBIASED])
        expected = plainly_driven(*plainly_driven(P, mean, legs, 0), legs, 1)
        np.testing.assert_allclose(np.stack(after.mean)[:, k, 2], expected[1], rtol=1e-12)
        np.testing.assert_allclose(after.matrix[k, 2], expected[0], rtol=1e-10)


def test_a_drive_may_be_one_and_its_readings_many():
    """What one robot would know with readings of different accuracy: entries become arrays on the way."""
    legs, variances = path_legs(read_path(RUNS[:2]), [UNBIASED]).columns(), np.array([0.01, 0.1, 0.0])
    rows = (Row((0.6, 0.8, -0.3), variances), Row(HEADING_AXIS, variances))
    _, after = states_along(FilterState.at_start(), legs, {1: [(rows, None)]})
    for k, variance in enumerate(variances.tolist()):
        alone = (Row((0.6, 0.8, -0.3), variance), Row(HEADING_AXIS, variance))
        _, one = states_along(FilterState.at_start(), legs, {1: [(alone, None)]})
        np.testing.assert_allclose(after.matrix[k], one.matrix, rtol=1e-11, atol=1e-16)


def test_a_start_knows_pose_and_constants_as_told():
    cov = started(4, 3)[0]
    state = FilterState.at_start(cov, [0.01, 0.02])
    assert state.size == 5
    expected = np.diag([0.0, 0.0, 0.0, 0.01, 0.02])
    expected[:3, :3] = cov
    np.testing.assert_allclose(state.matrix, expected, rtol=1e-15)
    assert all(isinstance(x, float) for x in state.P)
    assert (FilterState.at_start().matrix == 0).all()


def test_what_is_known_for_certain_is_not_read_again():
    """A second perfect reading of a direction finds rounding only there: it must not be taken for information."""
    state = FilterState.from_matrix(started(5, 3)[0]).read((range_row(TOWARDS, 0.0),))
    again = state.read((range_row(TOWARDS, 0.0), range_row(-TOWARDS, 1e-30)))
    np.testing.assert_allclose(again.matrix, state.matrix, atol=1e-15)
    sure = FilterState.from_matrix(1e-8 * np.eye(3)).read((range_row(TOWARDS, 0.0),))  # but little is not nothing
    away = np.append(TOWARDS / 5, 0.0)
    np.testing.assert_allclose(sure.matrix, 1e-8 * (np.eye(3) - np.outer(away, away)), atol=1e-20)
    many = FilterState(tuple(np.full(2, x) for x in state.P)).read((range_row(TOWARDS, 0.0),))
    np.testing.assert_allclose(many.matrix[1], state.matrix, atol=1e-15)


def test_rows_are_the_slopes_of_what_is_measured():
    """Against differences: where the robot truly is, and 1e-6 m or rad beside it."""
    anchor, pose = np.array([2.0, -1.0]), np.array([-1.0, 3.0, 0.7])

    def ranged(x):
        return np.hypot(*(anchor - x[:2]))

    def bearing(x):
        away = anchor - x[:2]
        return np.arctan2(away[1], away[0]) - x[2]

    for row, measured in ((range_row(anchor - pose[:2], 0.5), ranged), (bearing_row(anchor - pose[:2], 0.5), bearing)):
        steps = 1e-6 * np.eye(3)
        slopes = [(measured(pose + step) - measured(pose - step)) / 2e-6 for step in steps]
        np.testing.assert_allclose(row.vector(5), [*slopes, 0.0, 0.0], atol=1e-9)
        assert row.variance == 0.5
    cov = np.array([[0.3, 0.1], [0.1, 0.2]])
    information = sum(np.outer(row.coefficients[:2], row.coefficients[:2]) / row.variance for row in position_rows(cov))
    np.testing.assert_allclose(information, np.linalg.inv(cov), rtol=1e-12)
    many = position_rows(np.stack([np.diag([0.3, 0.2]), cov]))  # along x and y, and not, side by side
    for k, one in enumerate((np.diag([0.3, 0.2]), cov)):
        rows = [([np.broadcast_to(c, 2)[k] for c in row.coefficients[:2]], row.variance[k]) for row in many]
        np.testing.assert_allclose(sum(np.outer(h, h) / v for h, v in rows), np.linalg.inv(one), rtol=1e-12)
    assert Row((np.ones(4), 0.0, 2.0), 1.0).vector(4).tolist() == [[1.0, 0.0, 2.0, 0.0]] * 4


def test_a_leg_has_a_column_for_every_entry():
    legs = path_legs(read_path(RUNS), [NOISE], None, CONSTANTS)
    transition, gain, shift = legs.columns()[1]
    A, C = np.eye(5), np.zeros((5, 5))
    places = [(0, 2), (0, 3), (0, 4), (1, 2), (1, 3), (1, 4), (2, 3), (2, 4)]
    for (i, k), value in zip(places, transition, strict=True):
        A[i, k] = value
    C[np.triu_indices(5)] = gain
    np.testing.assert_array_equal(A, legs.A[1])
    np.testing.assert_array_equal(C, np.triu(legs.C[1]))
    np.testing.assert_array_equal(shift, legs.shift[1])
    assert isinstance(legs.columns()[0], LegColumns)
    grid = path_legs(read_path(np.random.default_rng(8).normal(size=(2, 3, 4, 2))), [NOISE])
    for k, leg in enumerate(grid.columns()):
        np.testing.assert_array_equal(leg.transition[1], grid.A[:, :, k, 1, 2])
        np.testing.assert_array_equal(leg.gain[1], grid.C[:, :, k, 0, 1])
        np.testing.assert_array_equal(leg.shift[1], grid.shift[:, :, k, 1])
