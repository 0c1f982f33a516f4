"""Fresh fixes: for how long a limit holds after a reading, for many readings at once, along their `RouteTable`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Bools, Complexes, Floats, Ints
from driftplan.layouts.placement.route_table import RouteTable
from driftplan.model.moments import Moments, compose, identity
from driftplan.model.point_drift import PointDrift
from driftplan.model.worst import ceiling, exceeds_between

_RADIUS_PARTS = 16  # of a segment on which a radius comes close to the limit
_CLOSE = 0.01  # share of 1 - confidence: a probability this near to the confidence may be below it between breakpoints


@dataclass(frozen=True, slots=True, eq=False)
class Limit:
    """What must hold everywhere, per route: rms <= limit or, with a confidence, the radius at it <= limit."""

    metres: Floats  # (routes,)
    confidence: float | None = None  # at least 0.75

    def judged(self, state: Moments, route: Ints) -> tuple[Bools, Bools]:
        """Which states are beyond the limit; and which are not, but by a radius so close to it that the points between
        must be looked at (rms has a bound between points instead, see `broken_between`)."""
        limit = self.metres[route]
        beyond = np.asarray(state.N.real > limit**2)
        close = np.zeros(beyond.shape, dtype=bool)
        if self.confidence is None:
            return beyond, close
        # Sure without integrals: a Gaussian's radius is at least its rms from 75 % on, and at most rms/sqrt(1 - c).
        unsure = ~beyond & (state.N.real > (1 - self.confidence) * limit**2)
        if unsure.any():
            within = PointDrift(limit[unsure], state[unsure]).probability_within(limit[unsure])
            beyond[unsure] = within < self.confidence
            close[unsure] = within < self.confidence + _CLOSE * (1 - self.confidence)
        return beyond, close & ~beyond

    def broken_between(self, begun: Moments, end: Floats, route: Ints, table: RouteTable, segment: Ints) -> Bools:
        """Which limits of the rms are broken inside segments that begin in the states ``begun`` and end with E|e|² of
        ``end``, though not at their ends."""
        which, square = table.noise_of[segment], self.metres[route] ** 2
        return exceeds_between(begun, table.length[segment], which, table.noises, end, square)

    def broken_within(self, begun: Moments, route: Ints, table: RouteTable, segment: Ints) -> Bools:
        """Which radii are beyond the limit at points inside segments that begin in the states ``begun``, (k,)."""
        inside = table.within(segment, _RADIUS_PARTS)
        states = compose(begun[np.arange(len(segment))[:, None]], inside)
        routes = np.repeat(route, _RADIUS_PARTS - 1)
        flat = Moments(*(np.broadcast_to(x, states.shape).ravel() for x in states.arrays()))
        return np.asarray(self.judged(flat, routes)[0].reshape(states.shape).any(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class FreshFixes:
    """Places, (n,), where a position error is fresh."""

    route: Ints
    breakpoint: Ints
    state: Moments  # just after the reading, in the robot's frame
    low: Complexes  # least real and imaginary part that d1 of the heading may have there
    high: Complexes  # greatest; where equal to the least the heading's moments are those of ``state``

    def __getitem__(self, index: NDArray[Any]) -> FreshFixes:
        return FreshFixes(
            self.route[index], self.breakpoint[index], self.state[index], self.low[index], self.high[index]
        )

    def least_square(self, sofar: Moments) -> Floats:
        """Least E|e|² that the box of headings allows after ``sofar``: exact where the box is a point."""
        gain = np.conj(sofar.p) * sofar.e1 + sofar.N  # E[e conj q] - E|q|², q the way as the estimate has it
        gain = gain - (np.abs(sofar.p) ** 2 + 2 * (np.conj(sofar.p) * sofar.e1).real + sofar.N)
        turned = np.minimum(self.low.real * gain.real, self.high.real * gain.real)
        turned = turned + np.minimum(self.low.imag * gain.imag, self.high.imag * gain.imag)
        return np.asarray(self.state.N.real + sofar.N.real + 2 * turned)


def last_slots(table: RouteTable, fresh: FreshFixes, limit: Limit, stop: Ints, *, blind: bool = False) -> Ints:
    """The last slot until which the limit holds without a break when fixes give the last position reading.

    Slots after ``stop``, (n,), are not looked at.

    Exact where the heading's box is a point, by the limit's own score; elsewhere an upper bound, from the rms with the
    best heading of the box at breakpoints. ``blind`` is an upper bound for routes on which headings may be fixed on
    the way: only the reading and translation noise count.

    Returns
    -------
    array (n,)
        ``breakpoint - 1`` where the reading itself is beyond the limit.
    """
    last = fresh.breakpoint - 1
    active = np.arange(len(last))
    slot, sofar = fresh.breakpoint.copy(), identity((len(last),))
    spread = np.zeros(len(last))  # translation noise so far
    known = (fresh.low == fresh.high) & (not blind)
    radius = limit.confidence is not None

    def square(of: FreshFixes) -> Floats:
        return np.asarray(of.state.N.real + spread) if blind else of.least_square(sofar)

    def judged(of: FreshFixes, at: Moments, after: Floats) -> tuple[Bools, Bools]:
        beyond = np.asarray(after > limit.metres[of.route] ** 2)
        close = np.zeros(beyond.shape, dtype=bool)
        some = np.flatnonzero(known & ~beyond) if radius else active[:0]
        if len(some):
            beyond[some], close[some] = limit.judged(compose(of.state[some], at[some]), of.route[some])
        return beyond, close

    before = square(fresh)
    beyond, close = judged(fresh, sofar, before)
    while len(active):
        inside = slot < table.slots[fresh.route]
        segment = np.where(inside, table.first_segment[fresh.route] + slot, 0)
        going = ~beyond
        at_end = going & ~inside  # nothing is driven in the last slot
        last[active[at_end]] = slot[at_end]
        begun, sofar = sofar, compose(sofar, table.segments[segment])
        spread = spread + table.translation[segment]
        after, was_close = square(fresh), close
        beyond, close = judged(fresh, sofar, after)
        going &= inside & ~beyond
        if radius:
            doubt = np.flatnonzero(going & (was_close | close))
        else:
            higher = ceiling(before, after, *table.sags(segment)) > limit.metres[fresh.route] ** 2
            doubt = np.flatnonzero(going & known & higher)
        if len(doubt):
            state, route = compose(fresh.state[doubt], begun[doubt]), fresh.route[doubt]
            if radius:
                going[doubt] = ~limit.broken_within(state, route, table, segment[doubt])
            else:
                going[doubt] = ~limit.broken_between(state, after[doubt], route, table, segment[doubt])
        last[active[going]] = slot[going]
        going &= slot < stop
        slot, before = slot + 1, after
        if not going.all():
            active, fresh, slot, sofar = active[going], fresh[going], slot[going], sofar[going]
            spread, before, stop, known = spread[going], before[going], stop[going], known[going]
            beyond, close = beyond[going], close[going]
    return last
