"""Drives: where the drift of a given layout first breaks a limit, for many drives at once, with readings of any kind.

Exact moments are carried from reading to reading (`spans`) and every reading is applied to them. E|e|² is then judged
at all borders between, and inside the pieces where that leaves a doubt.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftplan.beacons.hops import Limit, fits_between, sags
from driftplan.beacons.spans import Spans
from driftplan.beacons.tracks import Tracks
from driftplan.model.moments import Moments, compose

Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]

HOLDS = -1


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

    def only(self, which: Bools) -> Layouts:
        """Some of the drives, renumbered."""
        number = np.cumsum(which) - 1
        mine = which[self.drive]
        return Layouts(self.route[which], number[self.drive[mine]], self.event[mine])


def first_breach(spans: Spans, layouts: Layouts, limit: Limit) -> tuple[Ints, Bools]:
    """The first slot of each drive in which the limit breaks (`HOLDS`: none), and whether at the slot's start."""
    breach = np.full(len(layouts.route), HOLDS)
    early = np.zeros(len(layouts.route), dtype=bool)
    forgets = spans.forgets[layouts.route]
    for some, find in ((~forgets, _from_reading_to_reading), (forgets, _piece_by_piece)):
        if some.any():
            breach[some], early[some] = find(spans, layouts.only(some), limit)
    return breach, early


class _Hops(NamedTuple):
    """Stretches without a reading: drive, first and last border on its route, state on leaving the first."""

    drive: Ints
    begin: Ints
    end: Ints
    state: Moments


def _from_reading_to_reading(spans: Spans, layouts: Layouts, limit: Limit) -> tuple[Ints, Bools]:
    tracks, drives = spans.tracks, np.arange(len(layouts.route))
    count = np.bincount(layouts.drive, minlength=len(drives))
    begins = np.cumsum(count) - count
    order = np.argsort(layouts.drive, kind="stable")
    event = layouts.event[order]
    at, base = np.zeros(len(drives), dtype=np.intp), spans.first[layouts.route]
    state = tracks.start[layouts.route]
    hops: list[_Hops] = []
    for k in range(int(count.max(initial=0)) + 1):
        more = k < count[drives]
        upcoming = np.where(more, begins[drives] + k, 0)
        to = tracks.slots[layouts.route[drives]]
        to[more] = tracks.border[event[upcoming[more]]]
        ahead = (to > at) | ~more  # two readings at one place are no hop
        hops.append(_Hops(drives[ahead], at[ahead], to[ahead], state[ahead]))
        drives, at, to, state = drives[more], at[more], to[more], state[more]
        if not len(drives):
            break
        state = compose(state, spans.between(base[drives] + at, base[drives] + to))
        state, at = _fixed(tracks, state, event[upcoming[more]]), to
    return _judged(spans, layouts, limit, hops)


def _judged(spans: Spans, layouts: Layouts, limit: Limit, hops: list[_Hops]) -> tuple[Ints, Bools]:
    """The first slot that breaks, over all hops of each drive."""
    drive, begin, end = (np.concatenate([getattr(h, name) for h in hops]) for name in ("drive", "begin", "end"))
    state = Moments(*(np.concatenate(x) for x in zip(*(h.state.arrays() for h in hops), strict=True)))
    borders = end - begin + 1
    hop = np.repeat(np.arange(len(drive)), borders)
    border = begin[hop] + np.arange(len(hop)) - np.repeat(np.cumsum(borders) - borders, borders)
    route = layouts.route[drive]
    base = spans.first[route]
    e, j = (base + begin)[hop], base[hop] + border
    square = spans.squares(state[hop], e, j)
    if limit.confidence is None:
        broken = square > limit.metres[route[hop]] ** 2
        unsure = _in_doubt(spans, limit, state, hop, e, j, square, route[hop])
        broken[unsure] = True
    else:
        broken = limit.broken(compose(state[hop], spans.between(e, j)), route[hop])
    at_start = border == begin[hop]
    slot = np.where(at_start, border, border - 1)
    breach, early = np.full(len(layouts.route), HOLDS), np.zeros(len(layouts.route), dtype=bool)
    bad = np.flatnonzero(broken)[::-1]
    bad = bad[np.lexsort((~at_start[bad], -slot[bad]))]  # of several the first slot is written last
    breach[drive[hop[bad]]] = slot[bad]
    early[drive[hop[bad]]] = at_start[bad]
    return breach, early


def _in_doubt(
    spans: Spans, limit: Limit, state: Moments, hop: Ints, e: Ints, j: Ints, square: NDArray[np.float64], route: Ints
) -> Ints:
    """Positions in ``hop`` of borders on the way to which the limit breaks inside the piece, though not at its ends."""
    tracks = spans.tracks
    target = limit.metres[route] ** 2
    piece = np.maximum(j - 1 - route, 0)  # the piece that ends at border j: every route has one border more than pieces
    inner = e < j
    before = np.where(inner, np.roll(square, 1), 0.0)
    sag = sags(tracks, limit)[piece]
    doubt = np.flatnonzero(inner & (np.maximum(before, square) <= target) & (np.maximum(before, square) > target - sag))
    if not len(doubt):
        return doubt
    begun = compose(state[hop[doubt]], spans.between(e[doubt], j[doubt] - 1))
    inside = compose(begun[np.arange(len(doubt))[:, None]], tracks.within(piece[doubt])).N.real
    return doubt[~fits_between(tracks, limit, inside, route[doubt], sag[doubt])]


def _piece_by_piece(spans: Spans, layouts: Layouts, limit: Limit) -> tuple[Ints, Bools]:
    """The same without spans, for routes on which they lose digits."""
    tracks = spans.tracks
    breach = np.full(len(layouts.route), HOLDS)
    early = np.zeros(len(layouts.route), dtype=bool)
    order = np.argsort(tracks.border[layouts.event], kind="stable")
    due_at, drive, event = tracks.border[layouts.event][order], layouts.drive[order], layouts.event[order]
    sag = sags(tracks, limit)
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
            at_end[doubt] = ~fits_between(tracks, limit, between, route[doubt], sag[piece[doubt]])
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
