"""The engine on its own: one robot and many, and what a reading at the very start does."""

from __future__ import annotations

import numpy as np
import pytest

from driftplan.model import drive as engine
from driftplan.model.drive import drive, drive_many, start_and_order
from driftplan.model.elements import run_moments
from driftplan.model.moments import Moments, compose, identity
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix, Readings

NOISE = OdometryNoise(heading_var_per_m=1e-2, distance_var_per_m=1e-2, heading_bias_per_m=0.02)
KINDS = [
    Fix.position(0.0, position_std_m=0.3),
    Fix.heading(0.0, heading_std=0.05),
    Fix.full(0.0, position_std_m=0.1, heading_std=0.1, detection_probability=0.6),
]


def runs(lengths):
    return run_moments(np.asarray(lengths, dtype=float), 0.1, NOISE)


def same(X, Y):
    for name, x, y in zip(Moments.__slots__, X.arrays(), Y.arrays(), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-13, err_msg=name)


def by_hand(legs, start, readings, at):
    """Leg after leg, and at every border its readings, one by one in the order given."""
    arriving, leaving = [start], []
    for border in range(legs.shape[0] + 1):
        state = arriving[-1]
        for k in np.flatnonzero(np.asarray(at) == border).tolist():
            state = readings.resets()[k].apply(state)
        leaving.append(state)
        if border < legs.shape[0]:
            arriving.append(compose(state, legs[border]))
    return Moments.stack(arriving), Moments.stack(leaving)


@pytest.mark.parametrize("kept", [0, 16])
@pytest.mark.parametrize("at", [[1, 1, 4], [2, 5, 5], [3, 3, 3]])
def test_a_drive_is_leg_after_leg_and_reading_after_reading(at, kept, monkeypatch):
    monkeypatch.setattr(engine, "_SHORT_HOP_LEGS", kept)  # with numpy's arrays, and with Python's numbers
    legs, readings, at = runs([2.0, 3.0, 1.0, 0.5, 4.0]), Readings.of(KINDS), np.array(at)
    driven = drive(legs, identity(), readings, at)
    for found, expected in zip(driven, by_hand(legs, identity(), readings, at), strict=True):
        same(found, expected)


def test_without_readings_it_is_leg_after_leg_whatever_borders_are_named():
    legs = runs([2.0, 3.0, 1.0])
    expected = by_hand(legs, identity(), Readings.of([]), [])
    for given in ((None, None), (None, np.array([1])), (Readings.of(KINDS[:1]), None)):
        for found, state in zip(drive(legs, identity(), *given), expected, strict=True):
            same(found, state)


def test_robots_driven_together_arrive_as_each_alone():
    counts = np.array([2, 0, 3, 1])
    ways, resets = runs([2.0, 3.0, 1.0, 0.5, 4.0, 2.5]), Readings.of([*KINDS, *KINDS]).resets()
    starts = compose(identity((4,)), runs([0.0, 1.0, 2.0, 3.0]))
    together = drive_many(starts, ways, resets, counts)
    assert together.shape == (6,)
    k = 0
    for robot, count in enumerate(counts.tolist()):
        state = starts[robot]
        for _ in range(count):
            state = resets[k].apply(compose(state, ways[k]))
            same(together[k], state)
            k += 1


def test_robots_that_read_nothing_have_no_states():
    nothing = drive_many(identity((3,)), runs([]), Readings.of([]).resets(), np.zeros(3, dtype=int))
    assert nothing.shape == (0,)


def test_at_the_start_a_fix_says_where_it_is_and_a_beacon_is_read():
    fixes = Readings.of(KINDS[:2])  # of rank -1; a beacon's first rank is 0
    beacons = Readings(
        *(np.zeros(2, dtype=int) if name == "rank" else getattr(fixes, name) for name in Readings.__slots__)
    )
    both, at = beacons + fixes, np.array([0, 1, 0, 1])
    start, order = start_and_order(identity(), both, at)
    same(start, fixes.resets()[0].apply(identity()))
    assert order.tolist() == [0, 3, 1]  # at one place by rank


def test_at_the_start_a_range_is_read_like_any_other():
    ranged = Readings.of([Fix.range(0.0, anchor=(3.0, 4.0), range_std_m=0.1), KINDS[0]])
    start, order = start_and_order(identity(), ranged, np.zeros(2, dtype=int))
    assert order.tolist() == [0]
    assert float(start.N) == pytest.approx(2 * 0.3**2)
