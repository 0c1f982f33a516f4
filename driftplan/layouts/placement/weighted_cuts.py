"""Cuts for fused routes that count how many sites a stretch needs: sets of one or two sites of it, many at once.

From the best state at the beginning of a stretch, a set of sites keeps the limit at its end or does not. Weights c with

    c_v = 1 for a site that does alone,   c_v + c_w >= 1 for two that do together,   c_v >= 1/3,

add up to 1 over every set that does: it has one such site, or two, or three of any. So every layout that holds keeps

    Σ c_v y_v >= 1.

Of these cuts the one is wanted that a fractional layout y violates most. With c = (1 + z)/3 that is the lightest
fractional vertex cover z of the pairs, in which every z is 0, ½ or 1 (Nemhauser and Trotter 1975): sites of which y has
much get 0 where their partners, which get 1, have less. Only sites of which y has some are tried, with all others; of
two that are untried nothing is known, and both keep at least ½. With k - 1 dead the survivors satisfy the cut, hence
all the dead add at least k - 1 times the least weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from driftplan.arrays import Bools, Floats, Ints
from driftplan.layouts.placement.cut_pool import EPS, Cut
from driftplan.layouts.placement.fused_routes import FusedRoute
from driftplan.model.filter_state import FilterState, Row

_ENDS = np.linspace(1.5, 4.0, 6)  # of a stretch, in lengths of the one that fails when nothing is read
_ROUNDING = 1e-6  # relative, of tr P: a set that all but holds counts as one that does
_SIX = 6.0  # which one, two and three divide
_MISSED = 1e-3  # of 1: what a cut is missed by to be worth making


@dataclass(eq=False)
class Stretches:
    """Stretches of a route that begin at one border, and what is known of the sites read on them."""

    first: int
    ends: Ints
    sites: Ints  # read before the last end
    orders: Ints  # (sites, most readings of one), their readings in order
    inside: Bools  # (sites, ends), whether read before an end
    alone: Bools  # (sites, ends), whether a site keeps the limit without another
    tried: Bools  # (sites,), whether every other has been tried
    pairs: Ints  # (pairs, 2), positions among the sites, of those that are known to keep it together at some end
    together: Bools  # (pairs, ends), whether they do, and neither alone

    def weights(self, e: int, y: Floats) -> Floats:
        """6 c at an end, (sites,), in favour of a cut that ``y`` violates."""
        share, pairs = y[self.sites], self.pairs[self.together[:, e]]
        cover = np.where(self.tried, 0, 1)  # 2 z
        heads, tails = np.concatenate([pairs, pairs[:, ::-1]]).T
        order = np.argsort(heads, kind="stable")
        partners = np.split(tails[order], np.searchsorted(heads[order], np.arange(1, len(share))))
        cover[heads] = 1
        for v in np.argsort(-share, kind="stable").tolist():
            mine, free = partners[v], self.tried[v] and cover[v] == 1
            if free and share[mine[cover[mine] == 1]].sum() < share[v]:
                cover[v], cover[mine] = 0, 2
        return np.asarray(np.where(self.alone[:, e], _SIX, 2.0 + cover) * self.inside[:, e])

    def untried(self, y: Floats) -> Ints:
        """Sites of which a fractional layout has some, and which may need more than one other."""
        return np.flatnonzero((y[self.sites] > EPS) & ~self.tried & ~self.alone[:, -1])

    def least(self, y: Floats) -> float:
        """What the left side of none of their cuts can be below, once all sites are tried."""
        return float((y[self.sites] @ np.where(self.alone, 1.0, self.inside / 3)).min())


class WeightedCuts:
    """Weighted cuts of route number ``r``; ``most`` is the limit on tr P, m²."""

    def __init__(self, r: int, route: FusedRoute, most: float, redundancy: int):
        self.r, self.route, self.most, self.redundancy = r, route, most * (1 + _ROUNDING), redundancy
        flat = [(border, reading) for border, here in enumerate(route.readings) for reading in here]
        self.border = np.array([border for border, _ in flat] + [0], dtype=np.intp)  # the last one: nothing is read
        self.site = np.array([reading.site for _, reading in flat] + [-1], dtype=np.intp)
        self.chance = np.array([1.0 if reading.chance is None else reading.chance for _, reading in flat] + [1.0])
        self.coefficients, self.variance = np.zeros((len(flat) + 1, 3, 3)), np.full((len(flat) + 1, 3), np.inf)
        for k, (_, reading) in enumerate(flat):
            for j, row in enumerate(reading.rows):
                self.coefficients[k, j], self.variance[k, j] = row.coefficients, row.variance

    def stretches(self, first: int, last: int) -> Stretches:
        """Those that begin at border ``first``, where the limit fails at ``last`` if nothing is read."""
        distance = self.route.distance
        farther = distance[first] + _ENDS * (distance[last] - distance[first])
        farther = np.clip(np.searchsorted(distance, farther), last, self.route.end)
        borders = np.arange(last, int(farther[-1]) + 1)
        sites, orders = self._orders(first, int(borders[-1]))
        holds = self._holds(first, borders, orders)
        fails = borders[np.argmin(holds, axis=1)[~holds[:, -1]]]  # the border at which a site alone is not enough
        where_they_fail = np.quantile(fails, (0.5, 1.0), method="lower") if len(fails) else fails
        ends = np.unique(np.concatenate([farther, where_they_fail]).astype(np.intp))
        alone, inside = holds[:, ends - last], self.border[orders[:, :1]] < ends
        tried, pairs = np.zeros(len(sites), dtype=bool), np.zeros((0, 2), dtype=np.intp)
        return Stretches(first, ends, sites, orders, inside, alone, tried, pairs, np.zeros((0, len(ends)), dtype=bool))

    def beyond(self, stretches: Stretches, y: Floats) -> list[Cut]:
        """The cuts that a fractional layout violates, once its sites have been tried with all others."""
        self._try_pairs(stretches, stretches.untried(y))
        found = []
        for e, end in enumerate(stretches.ends.tolist()):
            here = stretches.inside[:, e]
            columns, mine = stretches.sites[here], stretches.weights(e, y)[here]
            least = _SIX + (self.redundancy - 1) * float(mine.min(initial=_SIX))
            if mine @ y[columns] < least - _MISSED * _SIX:
                found.append(Cut(columns, mine, least, (self.r, end)))
        return found

    def _try_pairs(self, stretches: Stretches, some: Ints) -> None:
        """Try some sites with every other."""
        alone, orders = stretches.alone, stretches.orders
        able = np.flatnonzero(~alone[:, -1])
        v, w = np.repeat(some, len(able)), np.tile(able, len(some))
        fresh = (v != w) & ~stretches.tried[w] & ((v < w) | ~np.isin(w, some))
        v, w = v[fresh], w[fresh]
        pairs = self._holds(stretches.first, stretches.ends, np.sort(np.hstack([orders[v], orders[w]]), axis=1))
        able_at = ~alone & stretches.inside
        pairs &= able_at[v] & able_at[w]
        known = pairs.any(axis=1)
        stretches.pairs = np.concatenate([stretches.pairs, np.stack([v[known], w[known]], axis=1)])
        stretches.together = np.concatenate([stretches.together, pairs[known]])
        stretches.tried[some] = True

    def _orders(self, first: int, last: int) -> tuple[Ints, Ints]:
        """Sites read between two borders, and the readings of each in order, (sites, most of one), filled up."""
        low, high = np.searchsorted(self.border[:-1], (first, last))
        sites, which = np.unique(self.site[low:high], return_inverse=True)
        by_site = np.argsort(which, kind="stable")
        nth = np.arange(len(which)) - np.searchsorted(which[by_site], which[by_site])
        orders = np.full((len(sites), int(nth.max(initial=0)) + 1), len(self.border) - 1)
        orders[which[by_site], nth] = low + by_site
        return sites, orders

    def _holds(self, first: int, ends: Ints, orders: Ints) -> Bools:
        """Whether drives with these readings keep the limit at an end and at those before it, (drives, ends)."""
        route = self.route
        start, begin = (route.best[first - 1], first - 1) if first else (route.start, 0)
        nothing = len(self.border) - 1
        state = FilterState(tuple(np.full(len(orders), p) for p in start.P))
        here, trace = np.full(len(orders), begin), np.empty((len(orders), len(ends)))
        trace[:] = route.traces(start, begin, ends)
        for column in orders.T:
            some = np.flatnonzero(column != nothing)
            readings = column[some]
            stop = self.border[readings]
            arriving = route.driven(FilterState(tuple(p[some] for p in state.P)), here[some], stop)
            after = self._read(arriving, readings)
            for p, fresh in zip(state.P, after.P, strict=True):
                p[some] = fresh
            here[some] = stop
            column_of = FilterState(tuple(p[:, None] for p in after.P))
            traces = route.traces(column_of, stop[:, None], ends)
            trace[some] = np.where(ends > stop[:, None], traces, trace[some])
        return np.logical_and.accumulate(trace <= self.most, axis=1)

    def _read(self, state: FilterState, readings: Ints) -> FilterState:
        number = int((self.variance[readings] < np.inf).sum(axis=1).max(initial=0))
        rows = [Row(tuple(self.coefficients[readings, j].T), self.variance[readings, j]) for j in range(number)]
        chance = self.chance[readings]
        return state.read(rows, None if (chance == 1).all() else chance)
