"""Hops: for how long a limit holds after a reading, for many readings at once, piece by piece along their `Tracks`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Bools, Complexes, Floats, Ints
from driftplan.layouts.placement.tracks import PARTS, RADIUS_PARTS, Tracks
from driftplan.model.drift import PointDrift
from driftplan.model.moments import Moments, compose, identity

_CLOSE = 0.01  # share of 1 - confidence: a probability this near to the confidence may be below it between borders


@dataclass(frozen=True, slots=True, eq=False)
class Limit:
    """What must hold everywhere, per route: rms <= limit or, with a confidence, the radius at it <= limit."""

    metres: Floats  # (routes,)
    confidence: float | None = None  # at least 0.75

    def broken(self, state: Moments, route: Ints) -> Bools:
        """Which states of the given routes are beyond the limit."""
        return self.judged(state, route)[0]

    def judged(self, state: Moments, route: Ints) -> tuple[Bools, Bools]:
        """Which states are beyond the limit; and which are not, but by a radius so close to it that the points between
        must be looked at (rms has a bound between points instead, see `Tracks.sag`)."""
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

    def broken_within(self, begun: Moments, route: Ints, tracks: Tracks, piece: Ints) -> Bools:
        """Which radii are beyond the limit at points inside pieces that begin in the states ``begun``, (k,)."""
        inside = tracks.within(piece, RADIUS_PARTS)
        states = compose(begun[np.arange(len(piece))[:, None]], inside)
        routes = np.repeat(route, RADIUS_PARTS - 1)
        flat = Moments(*(np.broadcast_to(x, states.shape).ravel() for x in states.arrays()))
        return np.asarray(self.broken(flat, routes).reshape(states.shape).any(axis=1))


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
    sag, slots = sags(tracks, limit), tracks.slots

    def square(of: Sources) -> Floats:
        return np.asarray(of.state.N.real + spread) if blind else of.least_square(sofar)

    def judged(of: Sources, at: Moments, after: Floats) -> tuple[Bools, Bools]:
        beyond = np.asarray(after > limit.metres[of.route] ** 2)
        close = np.zeros(beyond.shape, dtype=bool)
        if limit.confidence is not None and not blind:
            known = np.flatnonzero((of.low == of.high) & ~beyond)
            beyond[known], close[known] = limit.judged(compose(of.state[known], at[known]), of.route[known])
        return beyond, close

    before = square(sources)
    beyond, close = judged(sources, sofar, before)
    while len(active):
        inside = slot < slots[sources.route]
        piece = np.where(inside, tracks.first_piece[sources.route] + slot, 0)
        going = ~beyond
        at_end = going & ~inside  # nothing is driven in the last slot
        last[active[at_end]] = slot[at_end]
        begun, sofar = sofar, compose(sofar, tracks.pieces[piece])
        spread = spread + tracks.translation[piece]
        after, was_close = square(sources), close
        beyond, close = judged(sources, sofar, after)
        going &= inside & ~beyond
        room = limit.metres[sources.route] ** 2 - np.maximum(before, after)
        doubt = np.flatnonzero(going & (room < sag[piece])) if not blind else np.zeros(0, dtype=np.intp)
        if len(doubt):
            some = doubt[:, None]
            between = sources[some].least_square(compose(begun[some], tracks.within(piece[doubt])))
            going[doubt] = fits_between(tracks, limit, between, sources.route[doubt], sag[piece[doubt]])
        doubt = np.flatnonzero(going & (was_close | close))
        if len(doubt):
            state = compose(sources.state[doubt], begun[doubt])
            going[doubt] = ~limit.broken_within(state, sources.route[doubt], tracks, piece[doubt])
        last[active[going]] = slot[going]
        going &= slot < stop
        slot, before = slot + 1, after
        if not going.all():
            active, sources, slot, sofar = active[going], sources[going], slot[going], sofar[going]
            spread, before, stop = spread[going], before[going], stop[going]
            beyond, close = beyond[going], close[going]
    return last


def sags(tracks: Tracks, limit: Limit) -> Floats:
    """The margin of every piece; a radius has none: `Limit.broken_within` looks inside instead."""
    return tracks.sag(limit.metres) if limit.confidence is None else np.zeros(len(tracks.length))


def fits_between(tracks: Tracks, limit: Limit, between: Floats, route: Ints, sag: Floats) -> Bools:
    """Whether E|e|² at the points of `Tracks.within`, (k, points), proves that the limit holds between them."""
    return np.asarray(between.max(axis=-1) <= limit.metres[route] ** 2 - sag / PARTS**2)
