"""Where a limit first breaks: on drives with given layouts, and after readings, for many of either at once.

Drives: exact moments are carried from reading to reading (`driftplan.model.drive.drive_many`, over `IntervalMoments`).
E|e|² is then judged at all breakpoints between, and inside the segments where that leaves a doubt. Fresh fixes: for how
long the limit holds after a reading, from segment to segment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Bools, Complexes, Floats, Ints
from driftplan.beacons.beacon import Beacon
from driftplan.layouts.placement.fused_routes import fused_routes
from driftplan.layouts.placement.route_table import IntervalMoments, RouteTable, route_table
from driftplan.layouts.scenario import Scenario
from driftplan.model.drive import drive_many
from driftplan.model.moments import Moments, compose, identity
from driftplan.model.point_drift import PointDrift
from driftplan.model.worst import ceiling, exceeds_between, greatest_between

_RADIUS_PARTS = 16  # of a segment on which a radius comes close to the limit
_CLOSE = 0.01  # share of 1 - confidence: a probability this near to the confidence may be below it between breakpoints
KEPT = -1
Failure = tuple[int, tuple[int, ...]]  # a route, and the beacons that are dead, by position
_BREAKPOINTS_AT_ONCE = 200_000  # what more drives than that would take in memory


@dataclass(frozen=True, slots=True, eq=False)
class Limit:
    """What must hold everywhere, per route: rms <= limit or, with a confidence, the radius at it <= limit."""

    metres: Floats  # (routes,)
    confidence: float | None = None  # at least 0.75

    def judged(self, state: Moments, route: Ints) -> tuple[Bools, Bools]:
        """Which states are beyond the limit; and which are not, but by a radius so close to it that the points between
        must be looked at (rms has a bound between points instead)."""
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

    def broken_inside(self, begun: Moments, end: Floats, route: Ints, table: RouteTable, segment: Ints) -> Bools:
        """Which limits are broken inside segments that begin in the states ``begun``, (k,), and end with E|e|² of
        ``end``, though not at their ends; for radii at points of them."""
        if self.confidence is None:
            which, square = table.noise_of[segment], self.metres[route] ** 2
            return exceeds_between(begun, table.length[segment], which, table.noises, end, square)
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

    def __getitem__(self, some: NDArray[Any]) -> FreshFixes:
        return FreshFixes(self.route[some], self.breakpoint[some], self.state[some], self.low[some], self.high[some])

    def least_square(self, sofar: Moments) -> Floats:
        """Least E|e|² that the box of headings allows after ``sofar``: exact where the box is a point."""
        gain = np.conj(sofar.p) * sofar.e1 + sofar.N  # E[e conj q] - E|q|², q the way as the estimate has it
        gain = gain - (np.abs(sofar.p) ** 2 + 2 * (np.conj(sofar.p) * sofar.e1).real + sofar.N)
        turned = np.minimum(self.low.real * gain.real, self.high.real * gain.real)
        turned = turned + np.minimum(self.low.imag * gain.imag, self.high.imag * gain.imag)
        return np.asarray(self.state.N.real + sofar.N.real + 2 * turned)


def last_slots(table: RouteTable, fresh: FreshFixes, limit: Limit, stop: Ints, *, blind: bool = False) -> Ints:
    """The last slot, (n,), until which the limit holds without a break when fixes give the last position reading:
    ``breakpoint - 1`` where the reading itself is beyond it. Slots after ``stop``, (n,), are not looked at.

    Exact where the heading's box is a point, by the limit's own score; elsewhere an upper bound, from the rms with the
    best heading of the box at breakpoints. ``blind`` is an upper bound for routes on which headings may be fixed on
    the way: only the reading and translation noise count.
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
            state = compose(fresh.state[doubt], begun[doubt])
            going[doubt] = ~limit.broken_inside(state, after[doubt], fresh.route[doubt], table, segment[doubt])
        last[active[going]] = slot[going]
        going &= slot < stop
        slot, before = slot + 1, after
        if not going.all():
            active, fresh, slot, sofar = active[going], fresh[going], slot[going], sofar[going]
            spread, before, stop, known = spread[going], before[going], stop[going], known[going]
            beyond, close = beyond[going], close[going]
    return last


class ReadingSets(NamedTuple):
    """Which readings happen in each of several drives, each on one route."""

    route: Ints  # (drives,)
    drive: Ints  # (readings,), drive by drive
    reading: Ints  # (readings,), in driving order within each drive

    def only(self, which: Bools) -> ReadingSets:
        """Some of the drives, renumbered."""
        number = np.cumsum(which) - 1
        mine = which[self.drive]
        return ReadingSets(self.route[which], number[self.drive[mine]], self.reading[mine])

    def parts(self, slots: Ints) -> Iterator[ReadingSets]:
        """The drives in portions that fit in memory; ``slots`` as in `RouteTable`."""
        size = np.cumsum(slots[self.route] + 1) // _BREAKPOINTS_AT_ONCE
        firsts = np.flatnonzero(np.diff(size, prepend=-1))
        for begin, end in zip(firsts.tolist(), [*firsts[1:].tolist(), len(self.route)], strict=True):
            here = slice(*np.searchsorted(self.drive, [begin, end]).tolist())
            yield ReadingSets(self.route[begin:end], self.drive[here] - begin, self.reading[here])


def drives_of(table: RouteTable, chosen: Bools, routes: Ints, redundancy: int = 1) -> ReadingSets:
    """Each of the routes with every set of at most ``redundancy`` - 1 of the chosen sites that it meets dead."""
    route: list[int] = []
    drive, reading = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
    for r in routes.tolist():
        here = table.readings_of(r)
        alive = np.flatnonzero(chosen[table.site[here]]) + here.start
        site = table.site[alive]
        for size in range(redundancy):
            for dead in combinations(np.unique(site).tolist(), size):
                left = alive[~np.isin(site, dead)] if size else alive
                reading.append(left)
                drive.append(np.full(len(left), len(route)))
                route.append(r)
    return ReadingSets(np.array(route, dtype=np.intp), np.concatenate(drive), np.concatenate(reading))


def worst_squares(intervals: IntervalMoments, sets: ReadingSets) -> Floats:
    """Greatest E|e|² anywhere on each drive, as `driftplan.model.worst.worst_rms` means it, m²."""
    parts = sets.parts(intervals.table.slots)
    return np.concatenate([np.zeros(0), *(_worst_squares(intervals, part) for part in parts)])


def _worst_squares(intervals: IntervalMoments, sets: ReadingSets) -> Floats:
    table, driven = intervals.table, _driven(intervals, sets)
    found = np.zeros(len(sets.route))
    np.maximum.at(found, driven.drive, driven.square)
    begin = np.roll(driven.square, 1)
    higher = ceiling(begin, driven.square, *table.sags(driven.segment)) > found[driven.drive]
    some = np.flatnonzero((driven.e < driven.j) & higher)
    if not len(some):
        return found
    begun, segment, drive = driven.begun(intervals, some), driven.segment[some], driven.drive[some]
    stretches = table.length[segment], table.noise_of[segment], table.noises, driven.square[some]
    return greatest_between(begun, *stretches, drive, found)


def first_breach(intervals: IntervalMoments, sets: ReadingSets, limit: Limit) -> tuple[Ints, Bools]:
    """The first slot of each drive in which the limit breaks (`KEPT`: none), and whether at the slot's start."""
    found = [_first_breach(intervals, part, limit) for part in sets.parts(intervals.table.slots)]
    nothing = np.zeros(0, dtype=np.intp), np.zeros(0, dtype=bool)
    slots, early = zip(nothing, *found, strict=True)
    return np.concatenate(slots), np.concatenate(early)


class _Driven(NamedTuple):
    """Drives at all breakpoints of all their intervals, one after the other."""

    drive: Ints
    e: Ints  # first breakpoint of the interval, counted through
    j: Ints  # own breakpoint, counted through
    segment: Ints  # that ends there
    interval: Ints
    state: Moments  # at the beginning of each interval
    square: Floats  # E|e|²

    def begun(self, intervals: IntervalMoments, some: Ints) -> Moments:
        """States at the beginning of the segments that end at some of the breakpoints."""
        return compose(self.state[self.interval[some]], intervals.between(self.e[some], self.j[some] - 1))


def _driven(intervals: IntervalMoments, sets: ReadingSets) -> _Driven:
    table, n = intervals.table, len(sets.route)
    count = np.bincount(sets.drive, minlength=n)
    to = table.breakpoint[sets.reading]
    after_another = np.diff(sets.drive, prepend=-1) == 0
    at = np.where(after_another, np.concatenate([[0], to[:-1]])[: len(to)], 0)
    base = intervals.first[sets.route]
    ways = intervals.between(base[sets.drive] + at, base[sets.drive] + to)
    start = table.start[sets.route]
    after = drive_many(start, ways, table.resets[sets.reading], count)

    begins = np.zeros(len(to) + n, dtype=np.intp)  # an interval from the start of each drive, and from every reading
    own = np.arange(len(to)) + sets.drive + 1
    begins[own] = to
    drive = np.repeat(np.arange(n), count + 1)
    last = np.append(drive[1:] != drive[:-1], True)[: len(drive)]
    ends = np.where(last, table.slots[sets.route[drive]], np.append(begins[1:], 0)[: len(begins)])
    source = np.zeros(len(begins), dtype=np.intp)
    source[np.cumsum(count + 1) - (count + 1)], source[own] = np.arange(n), n + np.arange(len(to))
    kept = np.flatnonzero((ends > begins) | last)  # two readings at one place are no interval

    breakpoints = ends[kept] - begins[kept] + 1
    interval = np.repeat(np.arange(len(kept)), breakpoints)
    drive, state = drive[kept][interval], Moments.concatenate([start, after])[source[kept]]
    e = base[drive] + begins[kept][interval]
    j = e + np.arange(len(interval)) - np.repeat(np.cumsum(breakpoints) - breakpoints, breakpoints)
    segment = np.maximum(j - 1 - sets.route[drive], 0)  # every route has one breakpoint more than segments
    return _Driven(drive, e, j, segment, interval, state, intervals.squares(state[interval], e, j))


def _first_breach(intervals: IntervalMoments, sets: ReadingSets, limit: Limit) -> tuple[Ints, Bools]:
    table, driven = intervals.table, _driven(intervals, sets)
    drive, e, j, square = driven.drive, driven.e, driven.j, driven.square
    route = sets.route[drive]
    if limit.confidence is None:
        target = limit.metres[route] ** 2
        broken = square > target
        doubt = ceiling(np.roll(square, 1), square, *table.sags(driven.segment)) > target
    else:
        broken, close = limit.judged(compose(driven.state[driven.interval], intervals.between(e, j)), route)
        doubt = close | np.roll(close, 1)
    some = np.flatnonzero((e < j) & doubt & ~broken & ~np.roll(broken, 1))
    if len(some):
        begun = driven.begun(intervals, some)
        broken[some] = limit.broken_inside(begun, square[some], route[some], table, driven.segment[some])
    at_start = e == j
    slot = j - intervals.first[route] - ~at_start
    breach, early = np.full(len(sets.route), KEPT), np.zeros(len(sets.route), dtype=bool)
    bad = np.flatnonzero(broken)
    bad = bad[np.lexsort((~at_start[bad], -slot[bad]))]  # of several the first slot is written last
    breach[drive[bad]], early[drive[bad]] = slot[bad], at_start[bad]
    return breach, early


def failures(scenario: Scenario, beacons: Sequence[Beacon]) -> list[Failure]:
    """Every route with every set of at most redundancy - 1 dead beacons of those it comes within range of."""
    routes = range(len(scenario.routes))
    numbers = range(scenario.redundancy)
    in_range = [scenario.beacons_in_range(r, beacons) if scenario.redundancy > 1 else () for r in routes]
    return [(r, dead) for r in routes for number in numbers for dead in combinations(in_range[r], number)]


def worst_drifts(scenario: Scenario, beacons: Sequence[Beacon], cases: Sequence[Failure]) -> Floats:
    """Greatest score anywhere in each case, metres."""
    if scenario.confidence is not None or scenario.drives_differ or not cases:
        alive = [(r, [b for k, b in enumerate(beacons) if k not in dead]) for r, dead in cases]
        return np.array([scenario.worst(scenario.drift(r, living)) for r, living in alive])
    if scenario.estimator == "filter":
        routes, everyone = fused_routes(scenario, scenario.readings(beacons)), frozenset(range(len(beacons)))
        return np.array([routes[r].worst(everyone.difference(dead)) for r, dead in cases])
    table = route_table(scenario, scenario.readings(beacons))
    readings = [np.arange(len(table.site))[table.readings_of(r)] for r, _ in cases]
    readings = [e[~np.isin(table.site[e], dead)] for e, (_, dead) in zip(readings, cases, strict=True)]
    drive = np.repeat(np.arange(len(cases)), [len(e) for e in readings])
    drives = ReadingSets(np.array([r for r, _ in cases]), drive, np.concatenate(readings).astype(np.intp))
    return np.sqrt(worst_squares(IntervalMoments(table), drives))


def worst_of_failures(scenario: Scenario, beacons: Sequence[Beacon]) -> Floats:
    """Greatest score on every route with the worst set of at most redundancy - 1 dead beacons, metres, (routes,)."""
    cases, worst = failures(scenario, beacons), np.zeros(len(scenario.routes))
    np.maximum.at(worst, [r for r, _ in cases], worst_drifts(scenario, beacons, cases))
    return worst
