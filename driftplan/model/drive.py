"""The engine: error moments along a path, from border to border, with the readings on the way.

A path is cut at its readings (`driftplan.model.paths.Runs.cut`); what lies between two borders is one element of the
monoid of `driftplan.model.moments`, and at a border the readings there act as `driftplan.model.readings` says. `drive`
carries one robot along a path, `drive_many` thousands at once, from reading to reading.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Ints
from driftplan.model.moments import Moments, compose, lever, scan
from driftplan.model.readings import Readings, Resets

_SHORT_HOP_LEGS = 16  # legs from reading to reading: up to here on average Python's numbers beat numpy's arrays


class Driven(NamedTuple):
    """Error moments along a path of m legs, world frame, each (m + 1,)."""

    arriving: Moments  # at every border, before the readings there
    leaving: Moments  # after them, before the turn of the next leg


def drive(legs: Moments, start: Moments, readings: Readings | None = None, at: Ints | None = None) -> Driven:
    """One robot along a path of ``legs`` (..., m), a batch of paths only without readings, from the true pose and
    errors ``start`` (...) before the first leg and its readings, with ``readings`` (k,) taken at the borders ``at``
    (k,), 0 … m in any order. Fixes at border 0 are the uncertainty of the start, on arrival there too."""
    if readings is None or at is None:
        states = scan(legs, start)
        return Driven(states, states)
    start, order = start_and_order(start, readings, at)
    due: dict[int, list[Resets]] = {}
    for border, reset in zip(at[order].tolist(), readings[order].resets().numbers(), strict=True):
        due.setdefault(border, []).append(reset)
    last = legs.shape[-1]
    return (_leg_by_leg if last <= _SHORT_HOP_LEGS * len(due) else _hop_by_hop)(legs, start, due)


def start_and_order(start: Moments, readings: Readings, at: Ints) -> tuple[Moments, Ints]:
    """The start with the errors that fixes at border 0 say it has, and the other readings in the order of driving.

    Fixes at the start replace what was known about it, whatever the estimator; ranges and bearings, which do not tell
    where it is by themselves, are read after them like any others.
    """
    of_start = (at == 0) & (readings.rank < 0) & np.isnan(readings.anchor)
    for k in np.flatnonzero(of_start).tolist():
        start = readings[k].resets().apply(start)
    order = np.lexsort((readings.rank, at))
    return start, order[~of_start[order]]


def _leg_by_leg(legs: Moments, start: Moments, due: dict[int, list[Resets]]) -> Driven:
    """With Python's numbers: where hops are short, numpy's calls would cost ten times as much."""
    (state,) = start.numbers()
    levers = zip(*(np.broadcast_to(x, legs.shape).tolist() for x in lever(legs)), strict=True)
    arriving, leaving = [], []
    for border, leg in enumerate([*zip(legs.numbers(), levers, strict=True), None]):
        arriving.append(state)
        for reset in due.get(border, ()):
            state = reset.apply(state)
        leaving.append(state)
        if leg is not None:
            state = compose(state, *leg)
    return Driven(Moments.stack(arriving), Moments.stack(leaving))


def _hop_by_hop(legs: Moments, start: Moments, due: dict[int, list[Resets]]) -> Driven:
    """With numpy's arrays, a scan from reading to reading."""
    state, last = start, legs.shape[-1]
    arriving, leaving = [start[None]], []
    for begin, end in pairwise([*sorted({0, *due, last}), last]):
        for reset in due.get(begin, ()):
            state = reset.apply(state)
        hop = scan(legs[begin:end], state)
        leaving.append(hop[:-1])
        arriving.append(hop[1:])
        state = hop[-1]
    return Driven(Moments.concatenate(arriving), Moments.concatenate([*leaving, state[None]]))


def drive_many(start: Moments, intervals: Moments, resets: Resets, count: Ints) -> Moments:
    """Many robots at once, each from reading to reading: their states after every reading, (readings,).

    ``start`` is (robots,), ``intervals`` and ``resets`` are (readings,), robot by robot in driving order: the way from
    the reading before, or from the start, to each reading, and what it does; each robot has so many, ``count``.
    """
    first, states, found = np.cumsum(count) - count, start, [np.zeros(0, dtype=np.intp)]
    parts = [start[:0]]
    robots = np.arange(len(count))
    for k in range(int(count.max(initial=0))):
        more = count[robots] > k
        robots, states = robots[more], states[more]
        reading = first[robots] + k
        states = resets[reading].apply(compose(states, intervals[reading]))
        parts.append(states)
        found.append(reading)
    return Moments.concatenate(parts)[np.argsort(np.concatenate(found))]
