"""What a drift limit demands of a layout: rows and cuts for `covering`, each valid for every layout that holds.

A slot (see `route_table`) is judged by its *last reading*, the last position reading at or before it. Where every
reading is sure to succeed, the drift in slot j after the last reading e grows from a fresh position error, so j holds
only if j is within the reach of e (`drives.last_slots`). With R_j the sites whose own last reading before j
reaches j, and k the redundancy (the limit must survive any k - 1 dead beacons), the following hold for every
acceptable layout y:

* cover row: Σ_{R_j} y >= k unless j is within reach of the start, or else the members of R_j in y could all be dead;
* hop cut: if the last reading before j is e, of site i, and e does not reach j, then k y_i <= Σ y over those members of
  R_j that are read between e and j. A later reading is not always better (a coarse one may replace a good estimate),
  which is also why adding a site to an acceptable layout may spoil it.

On a route whose readings are sure and all fix position and heading, or all only the position, the state after a reading
does not depend on the readings before it, the reach is exact and these rows say everything. On other routes the reach
is an upper bound over all headings that the earlier readings may have left, and rows and cuts of two more kinds help:

* at least so many sites outside a set that cannot hold the slot (`exclusions`);
* no-good cut, when a layout meets all that and still fails the exact model (`drives.first_breach`): something that the
  state in the slot depends on must change, Σ_{A} y + Σ_{K} (1 - y) >= 1, K the living sites whose readings it depends
  on, A the absent sites whose readings would change it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from driftplan.arrays import Bools, Floats, Ints
from driftplan.layouts.placement.cut_pool import Cut
from driftplan.layouts.placement.drives import KEPT, FreshFixes, Limit, ReadingSets, drives_of, first_breach, last_slots
from driftplan.layouts.placement.exclusions import Chances, Pairs, chance_exclusion, order_exclusion, pair_exclusions
from driftplan.layouts.placement.route_table import IntervalMoments, RouteTable
from driftplan.model.moments import Moments

_ROUNDING = 1e-8  # relative, of E|e|² from sums along a whole route
_SLOTS_BEFOREHAND = 20  # per route, in which sets that cannot hold are looked for before any layout is judged
_START = -1  # stands for "no reading yet" where readings are numbered


class DriftRequirements:
    """Oracle for `covering.cheapest_cover`: does a layout keep the drift under a limit on every route, with any
    ``redundancy`` - 1 beacons dead?"""

    def __init__(self, table: RouteTable, sites: int, limit: Limit, redundancy: int = 1):
        self.table, self.sites, self.limit, self.redundancy = table, sites, limit, redundancy
        self.route = table.route
        self.places, self.turns = ~np.isnan(table.readings.square), ~np.isnan(table.heading_d1)
        self.sure = _every(table, table.readings.chance == 1)
        self.blind = ~_every(table, self.places)
        one_kind = _every(table, self.turns) | _every(table, ~self.turns)
        self.independent = self.sure & ~self.blind & one_kind  # the state after a reading is known
        self.fresh = _sources(table, self.places, self.turns)
        start, zero = np.asarray(table.start.d1, dtype=complex), np.zeros(table.routes, dtype=np.intp)
        self.start = FreshFixes(np.arange(table.routes), zero, table.start, start, start)
        self.last_slot_of_start = self._last_slots(self.start, table.slots)
        again = self._before_next_own()
        until = np.minimum(self._last_slots(self.fresh, again), again)
        self.last_slot_of = np.where(self.places, until, KEPT)
        self.intervals = IntervalMoments(table)
        met = np.unique(np.stack([table.site, self.route]), axis=1)
        self._routes_meeting = np.split(met[1], np.searchsorted(met[0], np.arange(1, sites)))

    def _last_slots(self, fresh: FreshFixes, stop: Ints) -> Ints:
        out = np.empty(len(fresh.route), dtype=np.intp)
        for blind in (False, True):
            some = self.blind[fresh.route] == blind
            out[some] = last_slots(self.table, fresh[some], self.limit, stop[some], blind=blind)
        return out

    def _before_next_own(self) -> Ints:
        """The last slot before each reading's site is read again: from there on this is not its last reading."""
        table, readings = self.table, np.arange(len(self.table.breakpoint))
        order = np.lexsort((readings, table.site, self.route))
        site, route, breakpoint = table.site[order], self.route[order], table.breakpoint[order]
        again = (site[1:] == site[:-1]) & (route[1:] == route[:-1])
        stop = table.slots[route]
        stop[:-1][again] = breakpoint[1:][again] - 1
        out = np.empty(len(readings), dtype=np.intp)
        out[order] = stop
        return out

    def rows(self) -> list[Cut]:
        """Demands that are known before any layout is judged, without those that another one implies."""
        found: list[Cut] = []
        for route in range(self.table.routes):
            site, first, last = self._stretches(route)
            slots = self._narrow_slots(route, first, last)
            if self.sure[route]:
                for j in slots:
                    able = np.unique(site[(first <= j) & (j <= last)])
                    found.append(self._at_least(able, route, j))
            if self.independent[route] or self.blind[route]:
                continue
            for j in slots[:: max(1, len(slots) // _SLOTS_BEFOREHAND)]:
                if self.sure[route]:
                    found += self._pair_cuts(route, j, np.zeros(0, dtype=np.intp))
                else:
                    found += self._chance_cuts(route, j, min(j + 1, int(self.table.slots[route])), [])
        return found

    def _narrow_slots(self, route: int, first: Ints, last: Ints) -> list[int]:
        """Slots in which fewest sites can hold: R_j shrinks while j moves on, until a new site comes in."""
        slots = int(self.table.slots[route]) + 1
        comes = np.bincount(first, minlength=slots + 1)
        goes = np.bincount(last + 1, minlength=slots + 1)
        ends = np.flatnonzero(np.append(comes[1:slots], 1) > 0)
        ends = ends[ends > self.last_slot_of_start[route]]
        gone = np.cumsum(goes)[ends]
        return [int(j) for j in ends[np.diff(gone, prepend=-1) > 0]]

    def _stretches(self, route: int) -> tuple[Ints, Ints, Ints]:
        """Stretches of slots [first, last] that a site can hold by its own last reading: site, first, last."""
        here = self.table.readings_of(route)
        readings = np.arange(here.start, here.stop)[self.places[here]]
        site, breakpoint = self.table.site[readings], self.table.breakpoint[readings]
        order = np.lexsort((readings, site))
        site, breakpoint, until = site[order], breakpoint[order], self.last_slot_of[readings[order]]
        good = until >= breakpoint
        site, first, last = site[good], breakpoint[good], until[good]
        joins = (site[1:] == site[:-1]) & (first[1:] == last[:-1] + 1)
        begins = np.flatnonzero(np.concatenate([[True], ~joins])[: len(site)])
        ends = np.append(begins[1:], len(site)) - 1
        return site[begins], first[begins], last[ends] if len(site) else last

    def _at_least(self, sites: Ints, route: int, slot: int, count: int = 1) -> Cut:
        """At least ``count`` living sites of these, whichever others are dead."""
        return Cut(sites, np.ones(len(sites)), float(count + self.redundancy - 1), (route, slot))

    def cuts(self, chosen: Bools, near: int | None = None) -> list[Cut]:
        """Cuts that ``chosen`` violates (see the module's docstring), none if it holds; ``near`` as in `covering`."""
        routes = np.arange(self.table.routes) if near is None else self._routes_meeting[near]
        sets = drives_of(self.table, chosen, routes, self.redundancy)
        simple = self.independent[sets.route]
        found = [self._sure_cut(chosen, *breach) for breach in self._breached_intervals(sets, simple)]
        if not simple.all():
            rest = sets.only(~simple)
            slots, early = first_breach(self.intervals, rest, self.limit)
            for k in np.flatnonzero(slots != KEPT).tolist():
                alive = rest.reading[rest.drive == k]
                found += self._cuts_of(chosen, int(rest.route[k]), int(slots[k]), bool(early[k]), alive)
        return found

    def _breached_intervals(self, sets: ReadingSets, simple: Bools) -> Iterator[tuple[int, int, int]]:
        """Hops beyond reach, on routes of independent readings: route, first slot that breaks, last reading."""
        mine = simple[sets.drive]
        drives = np.flatnonzero(simple)
        reading = np.concatenate([np.full(len(drives), _START), sets.reading[mine]])
        drive = np.concatenate([drives, sets.drive[mine]])
        breakpoint, until = np.zeros(len(reading), dtype=np.intp), self.last_slot_of_start[sets.route[drive]]
        read = reading != _START
        breakpoint[read], until[read] = self.table.breakpoint[reading[read]], self.last_slot_of[reading[read]]
        order = np.lexsort((reading, breakpoint, drive))
        latest = [np.diff(x[order], append=-1) != 0 for x in (drive, breakpoint)]  # of those at one place
        order = order[latest[0] | latest[1]]
        reading, drive, breakpoint, until = reading[order], drive[order], breakpoint[order], until[order]
        route, final = sets.route[drive], np.diff(drive, append=-1) != 0
        needed = np.where(final, self.table.slots[route], np.append(breakpoint[1:], 0)[: len(breakpoint)] - 1)
        for k in np.flatnonzero(until < needed).tolist():
            yield int(route[k]), int(until[k]) + 1, int(reading[k])

    def _cuts_of(self, chosen: Bools, route: int, slot: int, early: bool, alive: Ints) -> list[Cut]:
        """Cuts for a drive with the readings ``alive`` that breaks the limit in ``slot``, of any kinds."""
        before = alive[self.table.breakpoint[alive] <= slot]
        placing = before[self.places[before]]
        found: list[Cut] = []
        if self.sure[route]:
            latest = int(placing[-1]) if len(placing) else _START
            until = self.last_slot_of_start[route] if latest == _START else self.last_slot_of[latest]
            if until < slot:
                return [self._sure_cut(chosen, route, slot, latest)]
            if not self.blind[route]:
                found = self._pair_cuts(route, slot, np.unique(self.table.site[placing]))
        else:
            breakpoint = slot if early else slot + 1
            found = self._chance_cuts(route, slot, breakpoint, np.unique(self.table.site[placing]).tolist())
        return found or [self._no_good(chosen, route, slot, before)]

    def _sure_cut(self, chosen: Bools, route: int, slot: int, latest: int) -> Cut:
        """The cover row of the slot if it is violated, else the hop cut of the last reading."""
        last = self._last_readings(route, slot)
        able = last[self.last_slot_of[last] >= slot]
        sites = self.table.site[able]
        if self.last_slot_of_start[route] < slot and chosen[sites].sum() < self.redundancy:
            return self._at_least(np.sort(sites), route, slot)
        after = np.sort(self.table.site[able[able > latest]])
        own = self.table.site[latest]
        weights = np.append(np.ones(len(after)), -float(self.redundancy))
        return Cut(np.append(after, own), weights, 0.0, (route, slot))

    def _last_readings(self, route: int, slot: int) -> Ints:
        """The last position reading of every site at or before a slot, in driving order."""
        readings = self._readings_before(route, slot)
        _, back = np.unique(self.table.site[readings][::-1], return_index=True)
        return np.sort(readings[len(readings) - 1 - back])

    def _readings_before(self, route: int, slot: int) -> Ints:
        """Position readings of all sites at or before a slot."""
        here = self.table.readings_of(route)
        stop = here.start + int(np.searchsorted(self.table.breakpoint[here], slot, side="right"))
        readings = np.arange(here.start, stop)
        return readings[self.places[readings]]

    def _pair_cuts(self, route: int, slot: int, within: Ints) -> list[Cut]:
        """Cuts from sets around ``within`` in which no heading and position together hold the slot."""
        if self.last_slot_of_start[route] >= slot:
            return []
        pairs = self._pairs(route, slot)
        exclusions = pair_exclusions(pairs, np.isin(pairs.site, within))
        return [self._at_least(np.sort(pairs.site[~W]), route, slot) for W in exclusions]

    def _pairs(self, route: int, slot: int) -> Pairs:
        """Which last readings, and which two of them, hold a slot."""
        last = self._last_readings(route, slot)
        turns = self.turns[last]
        bar = self._bar(route)
        kept = self.intervals.c[self.intervals.first[route] + self.table.breakpoint[last]]
        left = np.where(turns, (1 + self.table.heading_d1[last]) / kept, 0.0)  # E r, as if set at the start
        begun = 1 + self.table.start.d1[route]
        in_reach = self.last_slot_of[last] >= slot
        alone, together = in_reach.copy(), np.outer(turns, in_reach & ~turns) & np.less.outer(last, last)
        for breakpoint in {slot, min(slot + 1, int(self.table.slots[route]))}:
            base, lever = (x[self.table.breakpoint[last]] for x in self.intervals.to(route, breakpoint))
            base = base + self.table.readings.square[last]
            lever = lever * kept
            alone &= turns | (base - 2 * (begun * lever).real <= bar)
            together &= base - 2 * np.multiply.outer(left, lever).real <= bar
        return Pairs(self.table.site[last], turns, alone, together)

    def _chance_cuts(self, route: int, slot: int, breakpoint: int, within: list[int]) -> list[Cut]:
        """At least so many sites outside a set that cannot hold the slot, judged at one breakpoint; none if it may."""
        readings = self._readings_before(route, slot)
        at_start, squares = self._least_squares(route, breakpoint, readings)
        site, chance = self.table.site[readings], self.table.readings.chance[readings]
        chances = Chances(at_start, site, chance, squares, self._bar(route))
        everyone = set(site.tolist())
        W, need = chance_exclusion(chances, within)
        if need == 0:
            found = order_exclusion(chances, within)
            if found is None:
                return []
            W, need = found, 1
        return [self._at_least(np.array(sorted(everyone - W), dtype=np.intp), route, slot, need)]

    def _no_good(self, chosen: Bools, route: int, slot: int, alive: Ints) -> Cut:
        """Something that the state in the slot depends on must change."""
        table, here = self.table, self.table.readings_of(route)
        certain = table.readings.chance[alive] == 1
        placing = alive[certain & self.places[alive]]
        placed = int(placing[-1]) if len(placing) else _START
        turning = alive[certain & self.turns[alive] & (alive <= placed)]
        turned = int(turning[-1]) if len(turning) else _START
        stop = here.start + int(np.searchsorted(table.breakpoint[here], slot, side="right"))
        readings = np.arange(here.start, stop)
        matters = np.where(self.turns[readings], readings >= turned, readings >= placed)
        living = np.isin(readings, alive)
        keep = np.unique(table.site[readings[matters & living]])
        absent = np.unique(table.site[readings[matters & ~chosen[table.site[readings]]]])
        columns = np.concatenate([absent, keep])
        weights = np.concatenate([np.ones(len(absent)), -np.ones(len(keep))])
        return Cut(columns, weights, 1.0 - len(keep), (route, slot))

    def able(self, route: int) -> Ints:
        """How many sites can hold each slot of a route by their own last reading, (slots,)."""
        _, first, last = self._stretches(route)
        slots = int(self.table.slots[route]) + 1
        change = np.bincount(first, minlength=slots + 1) - np.bincount(last + 1, minlength=slots + 1)
        return np.asarray(np.cumsum(change)[:slots], dtype=np.intp)

    def least_squares(self, route: int, slot: int) -> tuple[Ints, Floats, float]:
        """Sites read at or before a slot, the least E|e|² at its end after the last reading of each, and after none."""
        last = self._last_readings(route, slot)
        breakpoint = min(slot + 1, int(self.table.slots[route]))
        at_start, squares = self._least_squares(route, breakpoint, last)
        return self.table.site[last], squares, at_start

    def _least_squares(self, route: int, breakpoint: int, readings: Ints) -> tuple[float, Floats]:
        """Least E|e|² at a breakpoint after nothing but the start, and after each of the readings, had it come last."""
        table, breakpoints = self.table, self.table.breakpoint[readings]
        if self.blind[route]:
            along = self.intervals.translation[self.intervals.first[route] + np.arange(breakpoint + 1)]
            noise = along[breakpoint] - along
            return float(table.start.N[route].real + noise[0]), table.readings.square[readings] + noise[breakpoints]
        base, lever = self.intervals.to(route, breakpoint)
        turned = (1 + table.start.d1[route]) * lever[0]
        at_start = float(table.start.N[route].real + base[0] - 2 * np.real(turned))
        lever = lever[breakpoints]
        low, high = 1 + self.fresh.low[readings], 1 + self.fresh.high[readings]
        most = np.maximum(low.real * lever.real, high.real * lever.real)
        most = most + np.maximum(-low.imag * lever.imag, -high.imag * lever.imag)
        return at_start, table.readings.square[readings] + base[breakpoints] - 2 * most

    def _bar(self, route: int) -> float:
        """The limit squared, and a little more: rounding must not exclude a layout that just holds."""
        return float(self.limit.metres[route]) ** 2 * (1 + _ROUNDING)


def _every(table: RouteTable, what: Bools) -> Bools:
    """Per route: whether ``what`` is true of all its readings."""
    fails: Ints = np.bincount(table.route[~what], minlength=table.routes)
    return np.asarray(fails == 0)


def _sources(table: RouteTable, places: Bools, turns: Bools) -> FreshFixes:
    """The state after every reading, had it come last and succeeded, and the headings it may find."""
    n = len(table.breakpoint)
    low, high = np.zeros(n, dtype=complex), np.zeros(n, dtype=complex)
    d2 = np.where(turns, table.heading_d2, 0.0).astype(complex)
    for r in range(table.routes):
        here, segments = table.readings_of(r), table.segments[table.segments_of(r)]
        kept = np.concatenate([[1.0], np.cumprod(1 + segments.d1)])[table.breakpoint[here]]  # E r of the way here
        begun = 1 + table.start.d1[r]
        left = np.where(turns[here], (1 + table.heading_d1[here]) / kept, begun)  # E r when set here, as at the start
        re, im = (
            np.stack([most.accumulate(most(part, first)) for most in (np.minimum, np.maximum)])
            for part, first in ((left.real, begun.real), (left.imag, begun.imag))
        )
        corners = kept * (re[:, None] + 1j * im).reshape(4, -1) - 1
        low[here] = corners.real.min(axis=0) + 1j * corners.imag.min(axis=0)
        high[here] = corners.real.max(axis=0) + 1j * corners.imag.max(axis=0)
        twice = np.concatenate([[1.0], np.cumprod(1 + 2 * segments.d1 + segments.d2)])[table.breakpoint[here]]
        begun_twice = 1 + 2 * table.start.d1[r] + table.start.d2[r]
        alone = twice * begun_twice - 2 * (kept * begun - 1) - 1
        d2[here] = np.where(turns[here], d2[here], alone)
    low[turns] = high[turns] = table.heading_d1[turns]
    zero = np.zeros(n)
    trace = np.where(places, table.readings.square, 0.0)
    state = Moments(np.ones(n), zero, low, d2, -2 * low.real, zero, trace, zero, zero, zero)
    return FreshFixes(table.route, table.breakpoint, state, low, high)
