"""What a drift limit demands of a layout when the robot fuses its readings: an oracle for `covering`.

A filter's covariance never grows when a site is added, so acceptable layouts form an up-set: if the living sites M fail
somewhere, every layout needs sites outside M, and with any k - 1 dead still one, hence k of them. A cut is the stronger
the larger M is.

* Known beforehand: from every place of a route, in the best state that all sites can give there, the farthest stretch
  that holds when nothing is read; k sites must be read inside it.
* Weighted: on a longer stretch, from the best state at its beginning, some sites S keep the limit alone and the others
  T do not. Whatever keeps it holds one of S or two of T: 2 Σ_S y + Σ_T y >= 2, and k + 1 on the right if k - 1 may be
  dead.
* For a layout that fails: of the sites read in the shortest stretch before the failure that fails even from the best
  state, as many are added one by one as leave it failing; the rest is the cut. Then one of the rest is added and the
  search goes on, so that a layout gives several cuts.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from driftplan.arrays import Bools
from driftplan.layouts.placement.cut_pool import Cut
from driftplan.layouts.placement.fused_routes import NEVER, FusedRoute
from driftplan.model.filter_state import FilterState

_CUTS_PER_ROUTE = 8  # at a time
_WEIGHTED_STRETCHES = 600  # on all routes together, for which every site is tried alone
_ROUNDING = 1e-9  # relative, of tr P


class FusedRequirements:
    """Oracle for `covering.cheapest_cover`: does a layout keep the limits of fused routes?

    Parameters
    ----------
    routes : sequence of FusedRoute
    limits_m : on the rms, one per route
    redundancy : 1: all beacons live; k: any k - 1 of them may be dead
    seed : int
    """

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
            sets = [self._read_between(route, first, last) for first, last in stretches]
            bits = [sum(1 << site for site in sites) for sites in sets]
            for mine, sites, (_, last) in zip(bits, sets, stretches, strict=True):
                if not any(other != mine and other & mine == other for other in bits):
                    found.append(self._at_least(sites, (r, last)))
            found += self._weighted(r, stretches[:: 1 + len(stretches) * len(self.routes) // _WEIGHTED_STRETCHES])
        return found

    def _weighted(self, r: int, stretches: Sequence[tuple[int, int]]) -> list[Cut]:
        """Cuts for stretches, begun as these and longer, on which hardly any site keeps the limit alone."""
        route, found = self.routes[r], []
        for first, last in stretches:
            until = {}
            for site in self._read_between(route, first, last):
                if first:
                    until[site] = route.breach_from(route.best[first - 1], first - 1, {site}, self.most[r])
                else:
                    until[site] = route.breach({site}, self.most[r])
            ends = sorted({border for border in until.values() if border != NEVER})
            for end in {ends[len(ends) // 2], ends[-1]} if ends else ():
                here = np.array(sorted(self._read_between(route, first, end)), dtype=np.intp)
                alone = np.array([until.get(site, last) > end or until.get(site) == NEVER for site in here.tolist()])
                found.append(Cut(here, 1.0 + alone, self.redundancy + 1.0, (r, end)))
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

    def holds(self, chosen: Bools) -> bool:
        """Whether the layout keeps the limits."""
        return not self.cuts(chosen)

    def excess(self, chosen: Bools) -> float:
        """The greatest drift over its limit, on any route, with the beacons dead that may be."""
        everyone, worst = set(np.flatnonzero(chosen).tolist()), 0.0
        for r, route in enumerate(self.routes):
            drift = max(route.worst(alive) for alive in self._survivors(r, everyone))
            worst = max(worst, drift / self.limits_m[r])
        return worst

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
        for stop in range(max(low + 1, 0), border):
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

    def _read_between(self, route: FusedRoute, first: int, last: int) -> frozenset[int]:
        return frozenset(reading.site for here in route.readings[first:last] for reading in here)

    def _at_least(self, sites: set[int] | frozenset[int], where: tuple[int, int]) -> Cut:
        """At least as many of these as leave one whichever others are dead."""
        columns = np.array(sorted(sites), dtype=np.intp)
        return Cut(columns, np.ones(len(columns)), float(self.redundancy), where)
