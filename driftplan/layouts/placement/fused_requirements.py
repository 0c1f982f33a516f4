"""What a drift limit demands of a layout when the robot fuses its readings: an oracle for `covering`.

A filter's covariance never grows when a site is added, so acceptable layouts form an up-set: if the living sites M fail
somewhere, every layout needs sites outside M, and with any k - 1 dead still one, hence k of them. A cut is the stronger
the larger M is.

* Known beforehand: from every place of a route, in the best state that all sites can give there, the farthest stretch
  that holds when nothing is read; k sites must be read inside it.
* For a fractional layout: on longer stretches, how many sites it takes (`weighted_cuts`).
* For a layout that fails: of the sites read in the shortest stretch before the failure that fails even from the best
  state, as many are added one by one as leave it failing; the rest is the cut. Then one of the rest is added and the
  search goes on, so that a layout gives several cuts.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import combinations

import numpy as np

from driftplan.arrays import Bools, Floats
from driftplan.layouts.placement.cut_pool import EPS, Cut
from driftplan.layouts.placement.fused_routes import NEVER, FusedRoute
from driftplan.layouts.placement.weighted_cuts import Stretches, WeightedCuts
from driftplan.model.filter_state import FilterState

_CUTS_PER_ROUTE = 8  # at a time
_WEIGHTED_STRETCHES = 1000  # beginnings of stretches, on all routes together
_PAIRS_AT_ONCE = 1_000_000  # of sites, that are tried for one fractional layout
_MISSED = 1e-3  # of 1: what a cut is missed by to be worth making
_ROUNDING = 1e-9  # relative, of tr P


class FusedRequirements:
    """Oracle for `covering.cheapest_cover`: does a layout keep the limits, metres of rms, on every route, with any
    ``redundancy`` - 1 beacons dead?"""

    def __init__(self, routes: Sequence[FusedRoute], limits_m: Sequence[float], redundancy: int = 1, seed: int = 0):
        self.routes, self.redundancy = tuple(routes), redundancy
        self.limits_m = tuple(limits_m)
        self.most = [float(limit) ** 2 * (1 + _ROUNDING) for limit in limits_m]  # of tr P
        self.random = np.random.default_rng(seed)
        self.known: dict[tuple[int, frozenset[int]], int] = {}
        self.routes_meeting: dict[int, list[int]] = {}
        for r, route in enumerate(self.routes):
            for site in sorted(route.sites):
                self.routes_meeting.setdefault(site, []).append(r)

    def rows(self) -> list[Cut]:
        """Cuts that are known before any layout is judged."""
        found = []
        for r, route in enumerate(self.routes):
            stretches = route.unread(self.most[r])
            read = ((reading.site for here in route.readings[a:b] for reading in here) for a, b in stretches)
            sets = [frozenset(sites) for sites in read]
            bits = [sum(1 << site for site in sites) for sites in sets]
            for mine, sites, (_, last) in zip(bits, sets, stretches, strict=True):
                if not any(other != mine and other & mine == other for other in bits):
                    found.append(self._at_least(sites, (r, last)))
        return found

    @cached_property
    def _stretches(self) -> list[tuple[WeightedCuts, Stretches]]:
        found = []
        for r, route in enumerate(self.routes):
            known = route.unread(self.most[r])
            weighted = WeightedCuts(r, route, self.most[r], self.redundancy)
            for first, last in known[:: 1 + len(known) * len(self.routes) // _WEIGHTED_STRETCHES]:
                found.append((weighted, weighted.stretches(first, last)))
        return found

    def cuts_beyond(self, y: Floats) -> list[Cut]:
        """Cuts that a fractional layout violates: of failing sets, and weighted ones."""
        return self._weighted(y) or [cut for r in range(len(self.routes)) for cut in self._failing(r, y)]

    def _failing(self, r: int, y: Floats) -> list[Cut]:
        """A cut of the largest set that fails of the sites that ``y`` has most of, on a route, if ``y`` violates it."""
        route = self.routes[r]
        some = sorted((site for site in route.sites if y[site] > EPS), key=lambda site: -y[site])
        counts = range(len(some) + 1)  # the first so many of these fail, one more not
        number = bisect_left(counts, True, key=lambda n: self._breach(r, frozenset(some[:n])) == NEVER) - 1
        if number < 0:
            return []
        border = self._breach(r, frozenset(some[:number]))
        cut = self._at_least(self._outside(r, set(some[:number]), border), (r, border))
        return [cut] if y[cut.columns].sum() < cut.least - _MISSED else []

    def _weighted(self, y: Floats) -> list[Cut]:
        """Weighted cuts that ``y`` violates, from stretches where it has least, the worst of every route first."""
        sums = [stretches.least(y) for _, stretches in self._stretches]
        ranks = [0] * len(self.routes)
        order = []
        for k in np.argsort(sums, kind="stable").tolist():
            r = self._stretches[k][0].r
            order.append((ranks[r], sums[k], k))
            ranks[r] += 1
        work, found = 0, []
        for _, _, k in sorted(entry for entry in order if entry[1] < self.redundancy - _MISSED):
            weighted, stretches = self._stretches[k]
            work += len(stretches.sites) * len(stretches.untried(y))
            found += weighted.beyond(stretches, y)
            if work > _PAIRS_AT_ONCE and found:
                break
        return found

    def cuts(self, chosen: Bools, near: int | None = None) -> list[Cut]:
        """Cuts that ``chosen`` violates, none if it holds; ``near`` as in `covering`: then one will do."""
        everyone = set(np.flatnonzero(chosen).tolist())
        some = range(len(self.routes)) if near is None else self.routes_meeting.get(near, [])
        found: list[Cut] = []
        for r in some:
            for alive in self._survivors(r, everyone):
                border = self._breach(r, alive)
                if border != NEVER:
                    if near is not None:
                        return [self._at_least(self.routes[r].sites - alive, (r, border))]
                    found += self._repaired(r, set(alive), border)
                    break
        return found

    def driven_along(self, fixed: Bools) -> Bools:
        """A layout to start from: along every route, where the limit fails, the last site is added that helps there."""
        chosen = fixed.copy()
        for r, route in enumerate(self.routes):
            alive = set(np.flatnonzero(chosen).tolist()) & route.sites
            while (border := route.breach(alive, self.most[r])) != NEVER:
                last = {s: max(b for b in route.borders_of[s] if b < border) for s in self._outside(r, alive, border)}
                if not last:
                    break
                site = max(sorted(last), key=last.__getitem__)
                alive.add(site)
                chosen[site] = True
        return chosen

    def _survivors(self, r: int, everyone: set[int]) -> Iterator[frozenset[int]]:
        """Sites of a route that live, for every set that may be dead: as many as may, fewer fail only if these do."""
        here = self.routes[r].sites & everyone
        for dead in combinations(sorted(here), min(self.redundancy - 1, len(here))):
            yield frozenset(here.difference(dead))

    def _breach(self, r: int, alive: frozenset[int]) -> int:
        key = r, alive
        if key not in self.known:
            self.known[key] = self.routes[r].breach(alive, self.most[r])
        return self.known[key]

    def _repaired(self, r: int, alive: set[int], border: int) -> list[Cut]:
        """Cuts for a route that fails, while it is repaired by adding a site of each cut."""
        found: list[Cut] = []
        while border != NEVER and len(found) < _CUTS_PER_ROUTE:
            needed = self._outside(r, alive, border)
            found.append(self._at_least(needed, (r, border)))
            if not needed:
                break
            alive.add(sorted(needed)[int(self.random.integers(len(needed)))])
            border = self.routes[r].breach(alive, self.most[r])
        return found

    def _outside(self, r: int, alive: set[int], border: int) -> set[int]:
        """Sites outside a largest set, ``alive`` among it, that fails at a border."""
        route = self.routes[r]

        def fails(state: FilterState, first: int, living: set[int]) -> bool:
            return bool(route.arriving(state, first, border, living).trace > self.most[r])

        if fails(route.best[border - 1], border - 1, alive):
            return set()
        # the best state at low fails (-1: the start, with nothing else read), at the next border not
        low = bisect_left(range(border - 1), True, key=lambda k: not fails(route.best[k], k, alive)) - 1
        inside, outside = set(alive), set()
        state, here = (route.start, 0) if low < 0 else (route.best[low], low)
        for stop in range(low + 1, border):
            for site in {reading.site: None for reading in route.readings[stop]}:
                if site not in inside and site not in outside:
                    arriving = route.driven(state, here, stop) if stop > here else state
                    with_it = inside | {site}
                    if fails(route.read(arriving, stop, with_it), stop, with_it):
                        inside = with_it
                    else:
                        outside.add(site)
            if any(reading.site in inside for reading in route.readings[stop]):
                arriving = route.driven(state, here, stop) if stop > here else state
                state, here = route.read(arriving, stop, inside), stop
        return outside

    def _at_least(self, sites: set[int] | frozenset[int], where: tuple[int, int]) -> Cut:
        """At least as many of these as leave one whichever others are dead."""
        columns = np.array(sorted(sites), dtype=np.intp)
        return Cut(columns, np.ones(len(columns)), float(self.redundancy), where)
