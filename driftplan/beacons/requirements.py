"""What a drift limit demands of a layout: rows and cuts for `covering`, each valid for every layout that holds.

A slot (see `tracks`) is judged by its *last reading*, the last position reading at or before it. Where every reading is
sure to succeed, the drift in slot j after the last reading e grows from a fresh position error, so j holds only if j is
within the reach of e (`hops.reach`). With R_j the sites whose own last reading before j reaches j, and k the redundancy
(the limit must survive any k - 1 dead beacons), the following hold for every acceptable layout y:

* cover row: Σ_{R_j} y >= k unless j is within reach of the start, or else the members of R_j in y could all be dead;
* hop cut: if the last reading before j is e, of site i, and e does not reach j, then k y_i <= Σ y over those members of
  R_j that are read between e and j. A later reading is not always better (a coarse one may replace a good estimate),
  which is also why adding a site to an acceptable layout may spoil it.

On a route whose readings all fix position and heading, or all fix only the position, the state after a reading does not
depend on the readings before it, the reach is exact and these rows say everything. Otherwise (mixed kinds) the reach is
an upper bound over all headings that the earlier readings may have left. A layout that meets the rows and fails the
exact model (`hops.first_breach`) is then excluded by a

* no-good cut: Σ_{A} y + Σ_{K} (1 - y) >= 1, K the living sites whose readings the state in j depends on, A the absent
  sites whose readings would change it.

Where readings may fail, E|e|² in slot j is an average over which reading came last: with the readings e_1, e_2, … of a
set W in driving order and V_e the least E|e|² in j if e is the last that succeeds, no subset of W has less than

    F_0 = V_start,   F_t = min(F_{t-1}, chance_t V_t + (1 - chance_t) F_{t-1}).

While that is beyond the limit, at least k sites outside W are needed; W is made as large as possible.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from driftplan.beacons.covering import Cut
from driftplan.beacons.hops import HOLDS, Layouts, Limit, Sources, first_breach, reach, squares_after
from driftplan.beacons.tracks import Tracks
from driftplan.model.moments import Moments
from driftplan.model.paths import Floats

Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]

_START = -1  # stands for "no reading yet" where readings are numbered


class DriftRequirements:
    """Oracle for `covering.cheapest_cover`: does a layout keep the drift under a limit on every route?

    Parameters
    ----------
    tracks : Tracks
    sites : int
    limit : Limit
    redundancy : int
        1: all beacons live; k: any k - 1 of them may be dead.
    """

    def __init__(self, tracks: Tracks, sites: int, limit: Limit, redundancy: int = 1):
        self.tracks, self.sites, self.limit, self.redundancy = tracks, sites, limit, redundancy
        self.route = tracks.route
        self.places, self.turns = ~np.isnan(tracks.trace), ~np.isnan(tracks.heading_d1)
        self.sure = _every(tracks, tracks.chance == 1)
        self.blind = ~_every(tracks, self.places)
        one_kind = _every(tracks, self.turns) | _every(tracks, ~self.turns)
        self.independent = self.sure & ~self.blind & one_kind  # the state after a reading is known
        self.sources = _sources(tracks, self.places, self.turns)
        self.start = Sources(
            np.arange(tracks.routes),
            np.zeros(tracks.routes, dtype=np.intp),
            tracks.start,
            np.asarray(tracks.start.d1, dtype=complex),
            np.asarray(tracks.start.d1, dtype=complex),
        )
        self.reach_of_start = self._reach(self.start, tracks.slots)
        self.reach_of = np.where(self.places, self._reach(self.sources, self._before_next_own()), HOLDS)
        self._squares: dict[int, Floats] = {}
        met = np.unique(tracks.site * np.intp(max(tracks.routes, 1)) + self.route)
        self._routes_meeting = np.split(
            met % max(tracks.routes, 1), np.searchsorted(met // max(tracks.routes, 1), np.arange(1, sites))
        )

    def _reach(self, sources: Sources, stop: Ints) -> Ints:
        out = np.empty(len(sources.route), dtype=np.intp)
        for blind in (False, True):
            some = self.blind[sources.route] == blind
            out[some] = reach(self.tracks, sources[some], self.limit, stop[some], blind=blind)
        return out

    def _before_next_own(self) -> Ints:
        """The last slot before each reading's site is read again: from there on this is not its last reading."""
        tracks, events = self.tracks, np.arange(len(self.tracks.border))
        order = np.lexsort((events, tracks.site, self.route))
        site, route, border = tracks.site[order], self.route[order], tracks.border[order]
        again = (site[1:] == site[:-1]) & (route[1:] == route[:-1])
        stop = tracks.slots[route]
        stop[:-1][again] = border[1:][again] - 1
        out = np.empty(len(events), dtype=np.intp)
        out[order] = stop
        return out

    # Rows known beforehand

    def rows(self) -> list[Cut]:
        """Cover rows of all slots, without those that another one implies, for routes whose readings are sure."""
        return [row for r in np.flatnonzero(self.sure).tolist() for row in self._rows_of(r)]

    def _rows_of(self, route: int) -> Iterator[Cut]:
        """R_j shrinks while j moves on, until a new site comes in: only there it can be smallest."""
        sites, first, last = self._spans(route)
        slots = int(self.tracks.slots[route]) + 1
        comes = np.bincount(first, minlength=slots + 1)
        goes = np.bincount(last + 1, minlength=slots + 1)
        ends = np.flatnonzero(np.append(comes[1:slots], 1) > 0)
        ends = ends[ends > self.reach_of_start[route]]
        gone = np.cumsum(goes)[ends]
        for j in ends[np.diff(gone, prepend=-1) > 0].tolist():
            inside = (first <= j) & (j <= last)
            yield self._at_least(np.unique(sites[inside]), route, j)

    def _spans(self, route: int) -> tuple[Ints, Ints, Ints]:
        """Stretches of slots [first, last] that a site can hold by its own last reading: site, first, last."""
        here = self.tracks.events_of(route)
        events = np.arange(here.start, here.stop)[self.places[here]]
        site, border = self.tracks.site[events], self.tracks.border[events]
        order = np.lexsort((events, site))
        site, border, until = site[order], border[order], self.reach_of[events[order]]
        after = np.append(border[1:], 0)
        same = np.append(site[1:] == site[:-1], False)
        until = np.where(same, np.minimum(until, after - 1), until)
        good = until >= border
        site, first, last = site[good], border[good], until[good]
        joins = (site[1:] == site[:-1]) & (first[1:] == last[:-1] + 1)
        begins = np.flatnonzero(np.concatenate([[True], ~joins])[: len(site)])
        ends = np.append(begins[1:], len(site)) - 1
        return site[begins], first[begins], last[ends] if len(site) else last

    def _at_least(self, sites: Ints, route: int, slot: int) -> Cut:
        return Cut(sites, np.ones(len(sites)), float(self.redundancy), (route, slot))

    # The oracle

    def cuts(self, chosen: Bools, near: int | None = None) -> list[Cut]:
        """Cuts that ``chosen`` violates (see the module's docstring), none if it holds; ``near`` as in `covering`."""
        routes = np.arange(self.tracks.routes) if near is None else self._routes_meeting[near]
        layouts = self._drives(chosen, routes)
        simple = self.independent[layouts.route]
        found = [self._sure_cut(chosen, *breach) for breach in self._breached_hops(layouts, simple)]
        if not simple.all():
            others = np.flatnonzero(~simple)
            position = np.full(len(simple), -1)
            position[others] = np.arange(len(others))
            mine = position[layouts.drive] >= 0
            rest = Layouts(layouts.route[others], position[layouts.drive[mine]], layouts.event[mine])
            slots, early = first_breach(self.tracks, rest, self.limit)
            for k in np.flatnonzero(slots != HOLDS).tolist():
                alive = rest.event[rest.drive == k]
                found.append(self._cut(chosen, int(rest.route[k]), int(slots[k]), bool(early[k]), alive))
        return found

    def holds(self, chosen: Bools) -> bool:
        """Whether the layout keeps the limit."""
        return not self.cuts(chosen)

    def _drives(self, chosen: Bools, routes: Ints) -> Layouts:
        """Every route with every set of at most k - 1 of its beacons dead."""
        drive_route: list[int] = []
        drive, event = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
        for r in routes.tolist():
            here = self.tracks.events_of(r)
            alive = np.flatnonzero(chosen[self.tracks.site[here]]) + here.start
            site = self.tracks.site[alive]
            for size in range(self.redundancy):
                for dead in combinations(np.unique(site).tolist(), size):
                    left = alive[~np.isin(site, dead)] if size else alive
                    event.append(left)
                    drive.append(np.full(len(left), len(drive_route)))
                    drive_route.append(r)
        return Layouts(np.array(drive_route, dtype=np.intp), np.concatenate(drive), np.concatenate(event))

    def _breached_hops(self, layouts: Layouts, simple: Bools) -> Iterator[tuple[int, int, int]]:
        """Hops beyond reach, on routes of independent readings: route, first slot that breaks, last reading."""
        mine = simple[layouts.drive]
        drives = np.flatnonzero(simple)
        event = np.concatenate([np.full(len(drives), _START), layouts.event[mine]])
        drive = np.concatenate([drives, layouts.drive[mine]])
        border = np.where(event == _START, 0, self.tracks.border[event]) if len(self.tracks.border) else 0 * event
        order = np.lexsort((event, border, drive))
        event, drive, border = event[order], drive[order], border[order]
        latest = np.append((drive[1:] != drive[:-1]) | (border[1:] != border[:-1]), True)[: len(drive)]
        event, drive, border = event[latest], drive[latest], border[latest]
        route = layouts.route[drive]
        until = self.reach_of_start[route]
        until[event != _START] = self.reach_of[event[event != _START]]
        final = np.append(drive[1:] != drive[:-1], True)[: len(drive)]
        needed = np.where(final, self.tracks.slots[route], np.append(border[1:], 0)[: len(border)] - 1)
        for k in np.flatnonzero(until < needed).tolist():
            yield int(route[k]), int(until[k]) + 1, int(event[k])

    def _cut(self, chosen: Bools, route: int, slot: int, early: bool, alive: Ints) -> Cut:
        """The cut for a drive with the readings ``alive`` that breaks the limit in ``slot``, of any kinds."""
        before = alive[self.tracks.border[alive] <= slot]
        if not self.sure[route]:
            return self._unsure_cut(route, slot, early, before) or self._no_good(chosen, route, slot, before)
        placing = before[self.places[before]]
        latest = int(placing[-1]) if len(placing) else _START
        until = self.reach_of_start[route] if latest == _START else self.reach_of[latest]
        if until < slot:
            return self._sure_cut(chosen, route, slot, latest)
        return self._no_good(chosen, route, slot, before)

    def _sure_cut(self, chosen: Bools, route: int, slot: int, latest: int) -> Cut:
        """The cover row of the slot if it is violated, else the hop cut of the last reading."""
        events = self._events_before(route, slot)
        site = self.tracks.site[events]
        _, back = np.unique(site[::-1], return_index=True)
        last = events[len(events) - 1 - back]
        able = last[self.reach_of[last] >= slot]
        sites = self.tracks.site[able]
        if self.reach_of_start[route] < slot and chosen[sites].sum() < self.redundancy:
            return self._at_least(np.sort(sites), route, slot)
        after = np.sort(self.tracks.site[able[able > latest]])
        own = self.tracks.site[latest]
        weights = np.append(np.ones(len(after)), -float(self.redundancy))
        return Cut(np.append(after, own), weights, 0.0, (route, slot))

    def _events_before(self, route: int, slot: int) -> Ints:
        """Position readings of all sites at or before a slot."""
        here = self.tracks.events_of(route)
        stop = here.start + int(np.searchsorted(self.tracks.border[here], slot, side="right"))
        events = np.arange(here.start, stop)
        return events[self.places[events]]

    def _unsure_cut(self, route: int, slot: int, early: bool, alive: Ints) -> Cut | None:
        """At least k sites outside a set none of whose subsets holds the slot; None if the living sites could."""
        events = self._events_before(route, slot)
        border = slot if early else min(slot + 1, int(self.tracks.slots[route]))
        squares = self._squares_of(route)[:, border]
        here = self.tracks.events_of(route)
        site, chance = self.tracks.site[events].tolist(), self.tracks.chance[events].tolist()
        value = squares[1 + events - here.start].tolist()
        bar = float(self.limit.metres[route]) ** 2

        def least(within: set[int]) -> float:
            f = float(squares[0])
            for i, p, v in zip(site, chance, value, strict=True):
                if i in within:
                    f = min(f, p * v + (1 - p) * f)
            return f

        within = set(self.tracks.site[alive].tolist())
        if least(within) <= bar:
            return None
        best: dict[int, float] = {}
        for i, v in zip(site, value, strict=True):
            best[i] = min(v, best.get(i, np.inf))
        for i in sorted(best, key=lambda i: (-best[i], i)):
            if i not in within and least(within | {i}) > bar:
                within.add(i)
        return self._at_least(np.array(sorted(set(site) - within), dtype=np.intp), route, slot)

    def _no_good(self, chosen: Bools, route: int, slot: int, alive: Ints) -> Cut:
        """Something that the state in the slot depends on must change."""
        tracks, here = self.tracks, self.tracks.events_of(route)
        certain = tracks.chance[alive] == 1
        placing = alive[certain & self.places[alive]]
        placed = int(placing[-1]) if len(placing) else _START
        turning = alive[certain & self.turns[alive] & (alive <= placed)]
        turned = int(turning[-1]) if len(turning) else _START
        stop = here.start + int(np.searchsorted(tracks.border[here], slot, side="right"))
        events = np.arange(here.start, stop)
        matters = np.where(self.turns[events], events >= turned, events >= placed)
        living = np.isin(events, alive)
        keep = np.unique(tracks.site[events[matters & living]])
        absent = np.unique(tracks.site[events[matters & ~chosen[tracks.site[events]]]])
        columns = np.concatenate([absent, keep])
        weights = np.concatenate([np.ones(len(absent)), -np.ones(len(keep))])
        return Cut(columns, weights, 1.0 - len(keep), (route, slot))

    # For messages

    def able(self, route: int) -> Ints:
        """How many sites can hold each slot of a route by their own last reading, (slots,)."""
        _, first, last = self._spans(route)
        slots = int(self.tracks.slots[route]) + 1
        change = np.bincount(first, minlength=slots + 1) - np.bincount(last + 1, minlength=slots + 1)
        return np.asarray(np.cumsum(change)[:slots], dtype=np.intp)

    def least_squares(self, route: int, border: int) -> tuple[Ints, Floats, float]:
        """Sites read at or before a border, the least E|e|² there after the last reading of each, and after none."""
        here = self.tracks.events_of(route)
        events = self._events_before(route, border)
        site = self.tracks.site[events]
        found, back = np.unique(site[::-1], return_index=True)
        last = events[len(events) - 1 - back]
        squares = self._squares_of(route)[:, border]
        return found, squares[1 + last - here.start], float(squares[0])

    def _squares_of(self, route: int) -> Floats:
        """Least E|e|² at every border (columns) after the start (row 0) and after each reading of a route."""
        if route not in self._squares:
            here = self.tracks.events_of(route)
            events = np.arange(here.start, here.stop)
            blind = bool(self.blind[route])
            rows = np.full((1 + len(events), int(self.tracks.slots[route]) + 1), np.nan)
            rows[0] = squares_after(self.tracks, route, self.start[np.array([route])], blind=blind)
            some = np.flatnonzero(self.places[here])
            rows[1 + some] = squares_after(self.tracks, route, self.sources[events[some]], blind=blind)
            self._squares[route] = rows
        return self._squares[route]


def _every(tracks: Tracks, what: Bools) -> Bools:
    """Per route: whether ``what`` is true of all its readings."""
    fails: Ints = np.bincount(tracks.route[~what], minlength=tracks.routes)
    return np.asarray(fails == 0)


def _sources(tracks: Tracks, places: Bools, turns: Bools) -> Sources:
    """The state after every reading, had it come last and succeeded, and the headings it may find."""
    n = len(tracks.border)
    low, high = np.zeros(n, dtype=complex), np.zeros(n, dtype=complex)
    d2 = np.where(turns, tracks.heading_d2, 0.0).astype(complex)
    for r in range(tracks.routes):
        here, pieces = tracks.events_of(r), tracks.pieces[np.arange(*tracks.pieces_of(r).indices(len(tracks.length)))]
        kept = np.concatenate([[1.0], np.cumprod(1 + pieces.d1)])[tracks.border[here]]  # E r of the way here
        begun = 1 + tracks.start.d1[r]
        left = np.where(
            turns[here], (1 + tracks.heading_d1[here]) / kept, begun
        )  # E r when set here, as if at the start
        re = np.stack(
            [
                np.minimum.accumulate(np.minimum(left.real, begun.real)),
                np.maximum.accumulate(np.maximum(left.real, begun.real)),
            ]
        )
        im = np.stack(
            [
                np.minimum.accumulate(np.minimum(left.imag, begun.imag)),
                np.maximum.accumulate(np.maximum(left.imag, begun.imag)),
            ]
        )
        corners = kept * (re[:, None] + 1j * im[None, :]).reshape(4, -1) - 1
        low[here] = corners.real.min(axis=0) + 1j * corners.imag.min(axis=0)
        high[here] = corners.real.max(axis=0) + 1j * corners.imag.max(axis=0)
        twice = np.concatenate([[1.0], np.cumprod(1 + 2 * pieces.d1 + pieces.d2)])[tracks.border[here]]
        begun_twice = 1 + 2 * tracks.start.d1[r] + tracks.start.d2[r]
        alone = twice * begun_twice - 2 * (kept * begun - 1) - 1
        d2[here] = np.where(turns[here], d2[here], alone)
    low[turns] = high[turns] = tracks.heading_d1[turns]
    zero = np.zeros(n)
    state = Moments(
        np.ones(n), zero, low, d2, -2 * low.real, zero, np.where(places, tracks.trace, 0.0), zero, zero, zero
    )
    return Sources(tracks.route, tracks.border, state, low, high)
