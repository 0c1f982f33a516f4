"""Drives: where the drift of a given layout first breaks a limit, for many drives at once, with readings of any kind.

Exact moments are carried from reading to reading (`spans`) and every reading is applied to them. E|e|² is then judged
at all borders between, and inside the pieces where that leaves a doubt.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Bools, Floats, Ints
from driftplan.layouts.placement.hops import Limit, fits_between, sags
from driftplan.layouts.placement.spans import Spans
from driftplan.layouts.placement.tracks import Tracks
from driftplan.model.moments import Moments, compose
from driftplan.model.worst import ceiling, greatest_between

HOLDS = -1
_NO_LIMIT_M = 1e9
_AT_ONCE = 200_000  # borders: what more drives than that would take in memory


class Layouts(NamedTuple):
    """Which readings happen in each of several drives, each on one route.

    Attributes
    ----------
    route : (drives,)
    drive, event : (readings,) drive by drive, in driving order within each
    """

    route: Ints
    drive: Ints
    event: Ints

    def only(self, which: Bools) -> Layouts:
        """Some of the drives, renumbered."""
        number = np.cumsum(which) - 1
        mine = which[self.drive]
        return Layouts(self.route[which], number[self.drive[mine]], self.event[mine])

    def parts(self, slots: Ints) -> Iterator[Layouts]:
        """The drives in portions that fit in memory; ``slots`` as in `Tracks`."""
        size = np.cumsum(slots[self.route] + 1) // _AT_ONCE
        firsts = np.flatnonzero(np.diff(size, prepend=-1))
        for begin, end in zip(firsts.tolist(), [*firsts[1:].tolist(), len(self.route)], strict=True):
            here = slice(*np.searchsorted(self.drive, [begin, end]).tolist())
            yield Layouts(self.route[begin:end], self.drive[here] - begin, self.event[here])


def drives_of(tracks: Tracks, chosen: Bools, routes: Ints, redundancy: int = 1) -> Layouts:
    """Each of the routes with every set of at most ``redundancy`` - 1 of the chosen sites that it meets dead."""
    route: list[int] = []
    drive, event = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
    for r in routes.tolist():
        here = tracks.events_of(r)
        alive = np.flatnonzero(chosen[tracks.site[here]]) + here.start
        site = tracks.site[alive]
        for size in range(redundancy):
            for dead in combinations(np.unique(site).tolist(), size):
                left = alive[~np.isin(site, dead)] if size else alive
                event.append(left)
                drive.append(np.full(len(left), len(route)))
                route.append(r)
    return Layouts(np.array(route, dtype=np.intp), np.concatenate(drive), np.concatenate(event))


def worst_squares(spans: Spans, layouts: Layouts) -> Floats:
    """Greatest E|e|² anywhere on each drive, as `driftplan.model.worst.worst_rms` means it, m²."""
    found = [_worst_squares(spans, part) for part in layouts.parts(spans.tracks.slots)]
    return np.concatenate(found) if found else np.zeros(0)


def _worst_squares(spans: Spans, layouts: Layouts) -> Floats:
    worst = np.zeros(len(layouts.route))
    forgets = spans.forgets[layouts.route]
    if forgets.any():
        worst[forgets] = _worst_piece_by_piece(spans, layouts.only(forgets))
    if not forgets.all():
        rest = layouts.only(~forgets)
        hops = _hops_of(spans, rest)
        borders = _borders_of(spans, rest, hops)
        found = np.zeros(len(rest.route))
        np.maximum.at(found, borders.drive, borders.square)
        worst[~forgets] = _with_insides(spans, rest, hops, borders, found)
    return worst


def _with_insides(spans: Spans, layouts: Layouts, hops: _Hops, borders: _Borders, found: Floats) -> Floats:
    """The greatest E|e|² of each drive, given that of its borders."""
    tracks, (hop, drive, e, j, square) = spans.tracks, borders
    piece = np.maximum(j - 1 - layouts.route[drive], 0)  # that ends at border j
    begin = np.roll(square, 1)
    bend, fixed = (x[piece] * tracks.length[piece] ** 2 / 8 for x in (tracks.bend, tracks.bend_fixed))
    some = np.flatnonzero((e < j) & (ceiling(begin, square, bend, fixed) > found[drive]))
    if not len(some):
        return found
    begun = compose(hops.state[hop[some]], spans.between(e[some], j[some] - 1))
    piece = piece[some]
    return greatest_between(
        begun, tracks.length[piece], tracks.noise_of[piece], tracks.noises, square[some], drive[some], found
    )


def first_breach(spans: Spans, layouts: Layouts, limit: Limit) -> tuple[Ints, Bools]:
    """The first slot of each drive in which the limit breaks (`HOLDS`: none), and whether at the slot's start."""
    found = [_first_breach(spans, part, limit) for part in layouts.parts(spans.tracks.slots)]
    if not found:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=bool)
    slots, early = zip(*found, strict=True)
    return np.concatenate(slots), np.concatenate(early)


def _first_breach(spans: Spans, layouts: Layouts, limit: Limit) -> tuple[Ints, Bools]:
    breach = np.full(len(layouts.route), HOLDS)
    early = np.zeros(len(layouts.route), dtype=bool)
    forgets = spans.forgets[layouts.route]
    if not forgets.all():
        rest = layouts.only(~forgets)
        breach[~forgets], early[~forgets] = _judged(spans, rest, limit, _hops_of(spans, rest))
    if forgets.any():
        breach[forgets], early[forgets] = _piece_by_piece(spans, layouts.only(forgets), limit)
    return breach, early


class _Borders(NamedTuple):
    """Borders of hops: which hop and drive, hop's first border and own (both counted through), E|e|² there."""

    hop: Ints
    drive: Ints
    e: Ints
    j: Ints
    square: Floats


class _Hops(NamedTuple):
    """Stretches without a reading: drive, first and last border on its route, state on leaving the first."""

    drive: Ints
    begin: Ints
    end: Ints
    state: Moments


def _hops_of(spans: Spans, layouts: Layouts) -> _Hops:
    """All stretches of all drives, moments carried from reading to reading."""
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
        state, at = tracks.resets[event[upcoming[more]]].apply(state), to
    drive, begin, end = (np.concatenate([getattr(h, name) for h in hops]) for name in ("drive", "begin", "end"))
    state = Moments(*(np.concatenate(x) for x in zip(*(h.state.arrays() for h in hops), strict=True)))
    return _Hops(drive, begin, end, state)


def _borders_of(spans: Spans, layouts: Layouts, hops: _Hops) -> _Borders:
    count = hops.end - hops.begin + 1
    hop = np.repeat(np.arange(len(count)), count)
    drive = hops.drive[hop]
    e = spans.first[layouts.route[drive]] + hops.begin[hop]
    j = e + np.arange(len(hop)) - np.repeat(np.cumsum(count) - count, count)
    return _Borders(hop, drive, e, j, spans.squares(hops.state[hop], e, j))


def _judged(spans: Spans, layouts: Layouts, limit: Limit, hops: _Hops) -> tuple[Ints, Bools]:
    """The first slot that breaks, over all hops of each drive."""
    hop, drive, e, j, square = borders = _borders_of(spans, layouts, hops)
    route, state = layouts.route[drive], hops.state
    if limit.confidence is None:
        broken = square > limit.metres[route] ** 2
        broken[_in_doubt(spans, limit, state, borders, route)] = True
    else:
        broken, close = limit.judged(compose(state[hop], spans.between(e, j)), route)
        broken[_close_inside(spans, limit, state, borders, route, close, broken)] = True
    at_start = e == j
    slot = j - spans.first[route] - ~at_start
    breach, early = np.full(len(layouts.route), HOLDS), np.zeros(len(layouts.route), dtype=bool)
    bad = np.flatnonzero(broken)
    bad = bad[np.lexsort((~at_start[bad], -slot[bad]))]  # of several the first slot is written last
    breach[drive[bad]], early[drive[bad]] = slot[bad], at_start[bad]
    return breach, early


def _in_doubt(spans: Spans, limit: Limit, state: Moments, borders: _Borders, route: Ints) -> Ints:
    """Which borders the limit breaks on the way to, inside the piece, though not at its ends."""
    hop, _, e, j, square = borders
    tracks, target = spans.tracks, limit.metres[route] ** 2
    piece = np.maximum(j - 1 - route, 0)  # the piece that ends at border j: every route has one border more than pieces
    inner = e < j
    higher = np.maximum(np.where(inner, np.roll(square, 1), 0.0), square)
    sag = sags(tracks, limit)[piece]
    doubt = np.flatnonzero(inner & (higher <= target) & (higher > target - sag))
    if not len(doubt):
        return doubt
    begun = compose(state[hop[doubt]], spans.between(e[doubt], j[doubt] - 1))
    inside = compose(begun[np.arange(len(doubt))[:, None]], tracks.within(piece[doubt])).N.real
    return doubt[~fits_between(tracks, limit, inside, route[doubt], sag[doubt])]


def _close_inside(
    spans: Spans, limit: Limit, state: Moments, borders: _Borders, route: Ints, close: Bools, broken: Bools
) -> Ints:
    """Which borders a radius breaks the limit on the way to, inside the piece, though not at its ends."""
    hop, _, e, j, _ = borders
    some = np.flatnonzero((e < j) & (close | np.roll(close, 1)) & ~broken & ~np.roll(broken, 1))
    if not len(some):
        return some
    begun = compose(state[hop[some]], spans.between(e[some], j[some] - 1))
    return some[limit.broken_within(begun, route[some], spans.tracks, j[some] - 1 - route[some])]


class _Begun(NamedTuple):
    """Pieces as they begin: state, piece, drive, E|e|² at the end."""

    state: Moments
    piece: Ints
    drive: Ints
    end: Floats


def _worst_piece_by_piece(spans: Spans, layouts: Layouts) -> Floats:
    """`worst_squares` without spans."""
    tracks = spans.tracks
    begun: list[_Begun] = []
    _piece_by_piece(spans, layouts, Limit(np.full(tracks.routes, _NO_LIMIT_M)), begun)
    piece, drive, end = (np.concatenate([getattr(b, name) for b in begun]) for name in ("piece", "drive", "end"))
    state = Moments.concatenate([b.state for b in begun])
    found = np.zeros(len(layouts.route))
    np.maximum.at(found, drive, np.maximum(state.N.real, end))
    length = np.where(piece >= 0, tracks.length[piece], 0.0)
    return greatest_between(state, length, tracks.noise_of[piece], tracks.noises, end, drive, found)


def _piece_by_piece(
    spans: Spans, layouts: Layouts, limit: Limit, passed: list[_Begun] | None = None
) -> tuple[Ints, Bools]:
    """`first_breach` without spans, for routes on which they lose digits; ``passed`` takes the pieces driven."""
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
        at_start, near = limit.judged(state, route)
        begun, state = state, compose(state, tracks.pieces[piece])
        higher = np.maximum(begun.N.real, np.where(inside, state.N.real, 0.0))
        if passed is not None:  # at the end nothing is driven: a stretch of no length
            passed.append(_Begun(begun, np.where(inside, piece, -1), active, np.where(inside, state.N.real, 0.0)))
        beyond, close = limit.judged(state, route)
        at_end = inside & ~at_start & beyond
        doubt = np.flatnonzero(inside & ~at_start & ~at_end & (limit.metres[route] ** 2 - higher < sag[piece]))
        if len(doubt):
            between = compose(begun[doubt[:, None]], tracks.within(piece[doubt])).N.real
            at_end[doubt] = ~fits_between(tracks, limit, between, route[doubt], sag[piece[doubt]])
        doubt = np.flatnonzero(inside & ~at_start & ~at_end & (near | close))
        if len(doubt):
            at_end[doubt] = limit.broken_within(begun[doubt], route[doubt], tracks, piece[doubt])
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
        fixed = tracks.resets[event[first]].apply(Moments(*(x[at[first]] for x in arrays)))
        for array, value in zip(arrays, fixed.arrays(), strict=True):
            array[at[first]] = value
        rest = np.ones(len(at), dtype=bool)
        rest[first] = False
        at, event = at[rest], event[rest]
    u, p, d1, d2, D, e1, N, e2, a, b = arrays
    return Moments(u, p, d1, d2, D.real, e1, N.real, e2, a, b)
