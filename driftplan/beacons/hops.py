"""Hops: for how long a limit holds after a reading, and where a given layout first breaks it.

Everything runs over many readings, or many routes, at once, piece by piece along their `Tracks`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftplan.beacons.tracks import PARTS, Tracks
from driftplan.model.drift import PointDrift
from driftplan.model.moments import Moments, compose, identity
from driftplan.model.paths import Floats

Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]
Complexes = NDArray[np.complex128]

HOLDS = -1


@dataclass(frozen=True, slots=True, eq=False)
class Limit:
    """What must hold everywhere, per route: rms <= limit or, with a confidence, the radius at it <= limit."""

    metres: Floats  # (routes,)
    confidence: float | None = None  # at least 0.75

    def broken(self, state: Moments, route: Ints) -> Bools:
        """Which states of the given routes are beyond the limit."""
        limit = self.metres[route]
        beyond = np.asarray(state.N.real > limit**2)
        if self.confidence is None:
            return beyond
        # Sure without integrals: a Gaussian's radius is at least its rms from 75 % on, and at most rms/sqrt(1 - c).
        unsure = ~beyond & (state.N.real > (1 - self.confidence) * limit**2)
        if unsure.any():
            within = PointDrift(limit[unsure], state[unsure]).probability_within(limit[unsure])
            beyond[unsure] = within < self.confidence
        return beyond


@dataclass(frozen=True, slots=True, eq=False)
class Sources:
    """Places where a position error is fresh.

    Attributes
    ----------
    route, border : (n,)
    state : Moments (n,), in the robot's frame: just after the reading
    low, high : (n,) least and greatest real and imaginary part that d1 of the heading may have there; where they are
        equal the heading's moments are those of ``state``
    """

    route: Ints
    border: Ints
    state: Moments
    low: Complexes
    high: Complexes

    def __getitem__(self, index: NDArray[Any]) -> Sources:
        return Sources(self.route[index], self.border[index], self.state[index], self.low[index], self.high[index])

    def least_square(self, sofar: Moments) -> Floats:
        """Least E|e|² that the box of headings allows after ``sofar``: exact where the box is a point."""
        gain = np.conj(sofar.p) * sofar.e1 + sofar.N  # E[e conj q] - E|q|², q the way as the estimate has it
        gain = gain - (np.abs(sofar.p) ** 2 + 2 * (np.conj(sofar.p) * sofar.e1).real + sofar.N)
        turned = np.minimum(self.low.real * gain.real, self.high.real * gain.real)
        turned = turned + np.minimum(self.low.imag * gain.imag, self.high.imag * gain.imag)
        return np.asarray(self.state.N.real + sofar.N.real + 2 * turned)


def reach(tracks: Tracks, sources: Sources, limit: Limit, stop: Ints, *, blind: bool = False) -> Ints:
    """The last slot until which the limit holds without a break when ``sources`` give the last position reading.

    Slots after ``stop``, (n,), are not looked at.

    Exact where the heading's box is a point, by the limit's own score; elsewhere an upper bound, from the rms with the
    best heading of the box. ``blind`` is an upper bound for routes on which headings may be fixed on the way: only the
    reading and translation noise count.

    Returns
    -------
    array (n,)
        ``border - 1`` where the reading itself is beyond the limit.
    """
    last = sources.border - 1
    active = np.arange(len(last))
    slot, sofar = sources.border.copy(), identity((len(last),))
    spread = np.zeros(len(last))  # translation noise so far
    sag, slots = _sag(tracks, limit), tracks.slots

    def square(of: Sources) -> Floats:
        return np.asarray(of.state.N.real + spread) if blind else of.least_square(sofar)

    def broken(of: Sources, after: Floats) -> Bools:
        beyond = np.asarray(after > limit.metres[of.route] ** 2)
        if limit.confidence is not None and not blind:
            known = np.flatnonzero((of.low == of.high) & ~beyond)
            beyond[known] = limit.broken(compose(of.state[known], sofar[known]), of.route[known])
        return beyond

    before = square(sources)
    while len(active):
        inside = slot < slots[sources.route]
        piece = np.where(inside, tracks.first_piece[sources.route] + slot, 0)
        going = ~broken(sources, before)
        at_end = going & ~inside  # nothing is driven in the last slot
        last[active[at_end]] = slot[at_end]
        begun, sofar = sofar, compose(sofar, tracks.pieces[piece])
        spread = spread + tracks.translation[piece]
        after = square(sources)
        going &= inside & ~broken(sources, after)
        room = limit.metres[sources.route] ** 2 - np.maximum(before, after)
        doubt = np.flatnonzero(going & (room < sag[piece])) if not blind else np.zeros(0, dtype=np.intp)
        if len(doubt):
            some = doubt[:, None]
            between = sources[some].least_square(compose(begun[some], tracks.within(piece[doubt])))
            going[doubt] = _fits_between(tracks, limit, between, sources.route[doubt], sag[piece[doubt]])
        last[active[going]] = slot[going]
        going &= slot < stop
        slot, before = slot + 1, after
        if not going.all():
            active, sources, slot, sofar = active[going], sources[going], slot[going], sofar[going]
            spread, before, stop = spread[going], before[going], stop[going]
    return last


def _sag(tracks: Tracks, limit: Limit) -> Floats:
    """The margin of every piece; a radius has none: it is judged at the borders only."""
    return tracks.sag(limit.metres) if limit.confidence is None else np.zeros(len(tracks.length))


def _fits_between(tracks: Tracks, limit: Limit, between: Floats, route: Ints, sag: Floats) -> Bools:
    """Whether E|e|² at the points of `Tracks.within`, (k, points), proves that the limit holds between them."""
    return np.asarray(between.max(axis=-1) <= limit.metres[route] ** 2 - sag / PARTS**2)


class Layouts(NamedTuple):
    """Which readings happen in each of several drives, each on one route.

    Attributes
    ----------
    route : (drives,)
    drive, event : (readings,) in driving order within each drive
    """

    route: Ints
    drive: Ints
    event: Ints


def first_breach(tracks: Tracks, layouts: Layouts, limit: Limit) -> tuple[Ints, Bools]:
    """The first slot of each drive in which the limit breaks, `HOLDS` if none, and whether it does at the slot's start.

    Exact for all kinds of readings: moments are carried along the route and every reading is applied to them.
    """
    breach = np.full(len(layouts.route), HOLDS)
    early = np.zeros(len(layouts.route), dtype=bool)
    order = np.argsort(tracks.border[layouts.event], kind="stable")
    due_at, drive, event = tracks.border[layouts.event][order], layouts.drive[order], layouts.event[order]
    sag = _sag(tracks, limit)
    active, route = np.arange(len(layouts.route)), layouts.route
    position = np.arange(len(layouts.route))  # of every drive among the active ones; -1: done
    state, slots = tracks.start[route], tracks.slots
    t = 0
    while len(active):
        here = slice(*np.searchsorted(due_at, [t, t + 1]).tolist())
        state = _read(tracks, state, position[drive[here]], event[here])
        inside = t < slots[route]
        piece = np.where(inside, tracks.first_piece[route] + t, 0)
        at_start = limit.broken(state, route)
        begun, state = state, compose(state, tracks.pieces[piece])
        at_end = inside & ~at_start & limit.broken(state, route)
        room = limit.metres[route] ** 2 - np.maximum(begun.N.real, state.N.real)
        doubt = np.flatnonzero(inside & ~at_start & ~at_end & (room < sag[piece]))
        if len(doubt):
            between = compose(begun[doubt[:, None]], tracks.within(piece[doubt])).N.real
            at_end[doubt] = ~_fits_between(tracks, limit, between, route[doubt], sag[piece[doubt]])
        breach[active[at_start | at_end]] = t
        early[active[at_start]] = True
        going = inside & ~at_start & ~at_end
        if not going.all():
            position[active[~going]] = -1
            active, route, state = active[going], route[going], state[going]
            position[active] = np.arange(len(active))
        t += 1
    return breach, early


def _read(tracks: Tracks, state: Moments, at: Ints, event: Ints) -> Moments:
    """States after readings: ``event[k]`` happens to state ``at[k]`` (-1: to none), in this order."""
    some = at >= 0
    at, event = at[some], event[some]
    if not len(at):
        return state
    arrays = [np.array(x, dtype=complex) for x in state.arrays()]
    while len(at):
        _, first = np.unique(at, return_index=True)  # one reading per state at a time
        fixed = _fixed(tracks, Moments(*(x[at[first]] for x in arrays)), event[first])
        for array, value in zip(arrays, fixed.arrays(), strict=True):
            array[at[first]] = value
        rest = np.ones(len(at), dtype=bool)
        rest[first] = False
        at, event = at[rest], event[rest]
    u, p, d1, d2, D, e1, N, e2, a, b = arrays
    return Moments(u, p, d1, d2, D.real, e1, N.real, e2, a, b)


def _fixed(tracks: Tracks, before: Moments, event: Ints) -> Moments:
    """`driftplan.model.fixes.apply_fix` for many states, each with its own reading."""
    trace, d1_new, d2_new = tracks.trace[event], tracks.heading_d1[event], tracks.heading_d2[event]
    turned, placed = ~np.isnan(d1_new), ~np.isnan(trace)
    d1 = np.where(turned, d1_new, before.d1)
    d2 = np.where(turned, d2_new, before.d2)
    D = np.where(turned, -2 * d1_new, before.D)
    e1 = np.where(placed, 0.0, before.e1)
    N, e2 = np.where(placed, trace, before.N), np.where(placed, 0.0, before.e2)
    after = (d1, d2, D, e1, N, e2, e1 * np.conj(d1), e1 * d1)
    chance = tracks.chance[event]
    mixed = ((1 - chance) * x + chance * y for x, y in zip(before.arrays()[2:], after, strict=True))
    return Moments(before.u, before.p, *mixed)
