"""Cheapest covers by implicit hitting sets: the combinatorial core of beacon placement, on plain arrays.

It knows sites (columns with a cost), demands on them and an oracle; it knows no geometry and no drift. With y the 0/1
vector of chosen sites it solves

    (1)  min  Σ cost_i y_i
    (2)  Σ w_i y_i >= least         for every demand given, and every cut the oracle may ever return
    (3)  Σ w_i y_i >= least         for every cap (w <= 0: conflicts, budgets, "at most k of these")
    (4)  y_i = 1                    for fixed sites

The oracle is asked about whole layouts: it returns no cut if the layout is acceptable, else cuts of form (2) that the
layout violates and that *every acceptable layout satisfies*. The master problem (1)-(4) with the cuts found so far is a
relaxation, so its optimum (HiGHS, through scipy) is a lower bound, and when its optimal layout passes the oracle that
is the optimum. Nothing else is assumed: acceptable layouts need not stay acceptable when a site is added.

In the meantime every rejected layout is completed greedily to an acceptable one, so that there is an answer early; the
linear relaxation tells which few sites are worth choosing among, a local search (`cover_bounds`) and HiGHS look among
them for something cheaper, and sites too dear for any layout better than the best are left out of the master.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, inf

import numpy as np

from driftplan.arrays import Bools, Floats, Ints
from driftplan.layouts.placement.cover_bounds import LP_ROOM, LocalSearch, Relaxation, Solution, common_step
from driftplan.layouts.placement.cut_pool import EPS, Cut, CutPool, Oracle
from driftplan.planning.status import Status

_LONGEST_S = 600.0  # of a search, as far as it is divided into parts
_PATIENCE = 6  # rounds of the linear relaxation that may pass without raising its bound by a thousandth; of cuts half
_LOCAL_STEPS = 10000  # of a local search without success, or
_LOCAL_STEPS_PER_SITE = 30  # if that is less
_SEPARATION_SHARE = 0.5  # of the time, for cuts that a fractional layout violates
_ROUNDING_SHARE = 0.05  # of the time left, for layouts made from one fractional layout on the way
_REOPENED = 5  # sites that are chosen anew at a time
_FAR = 1.1  # times the bound: from there on a local search pays before the master is asked
_FAR_SHARE = 0.25  # of the time left, for that, and for reopening, as long as they bring something
_LOCAL_SHARE = 0.1  # of the time left, for one local search
_MASTER_SHARE = 0.1  # of the time left, for the master before anything cheaper is tried


@dataclass(frozen=True, slots=True, eq=False)
class Cover:
    """Result of `cheapest_cover`."""

    status: Status
    chosen: Bools | None
    cost: float  # inf without a layout
    lower_bound: float
    hopeless: Cut | None  # when infeasible: a cut that nothing satisfies, if it is a single one
    rounds: int
    cuts: int


Progress = Callable[[float, float, float], None]  # seconds, cost so far, lower bound
Separator = Callable[[Floats], Sequence[Cut]]  # cuts that no acceptable layout violates but a fractional one may


def cheapest_cover(
    cost: Floats,
    oracle: Oracle,
    *,
    demands: Sequence[Cut] = (),
    caps: Sequence[Cut] = (),
    fixed: Bools | None = None,
    hint: Bools | None = None,
    separate: Separator | None = None,
    stop_at_first: bool = False,
    time_limit: float = inf,
    progress: Progress = lambda *_: None,
) -> Cover:
    """The cheapest acceptable layout; see the module's docstring.

    Parameters
    ----------
    cost : array (n,), > 0 (fixed sites may cost 0)
    fixed : bool array (n,), sites that are there anyway
    hint : bool array (n,), a layout to start from
    separate : gives cuts that every acceptable layout satisfies and a fractional y, (n,), perhaps not
    stop_at_first : stop at the first acceptable layout (`Status.GOOD_ENOUGH`) instead of looking for the cheapest
    time_limit : seconds
    progress : called with seconds, cost of the best layout and lower bound whenever one of them changes

    Examples
    --------
    Three sites, of which the oracle wants two neighbours:

    >>> class Neighbours:
    ...     def cuts(self, chosen, near=None):
    ...         ok = (chosen[:-1] & chosen[1:]).any()
    ...         return [] if ok else [Cut(np.flatnonzero(~chosen), np.ones((~chosen).sum()), 1.0)]
    >>> found = cheapest_cover(np.array([3.0, 1.0, 2.0]), Neighbours())
    >>> found.chosen.tolist(), found.cost, found.status.name
    ([False, True, True], 3.0, 'OPTIMAL')
    """
    cost = np.asarray(cost, dtype=float)
    fixed = np.zeros(len(cost), dtype=bool) if fixed is None else np.asarray(fixed, dtype=bool)
    rows, limits = CutPool(len(cost), demands), CutPool(len(cost), caps)
    search = _CoverSearch(cost, oracle, rows, limits, fixed, separate, time_limit, progress)
    return search.run(hint, stop_at_first)


class _CoverSearch:
    best: Bools | None = None
    best_cost, bound, rounds, refused = inf, 0.0, 0, False  # whether the oracle has refused a layout
    core: Bools | None = None  # sites that look best: where the master is too hard they are looked at closely, once

    def __init__(
        self, cost: Floats, oracle: Oracle, rows: CutPool, caps: CutPool, fixed: Bools, separate: Separator | None,
        time_limit: float, progress: Progress,
    ):  # fmt: skip
        self.cost, self.oracle, self.separate, self.progress = cost, oracle, separate, progress
        self.n, self.fixed, self.rows, self.caps = len(cost), fixed, rows, caps
        self.began = time.monotonic()
        self.deadline, self.step = self.began + time_limit, common_step(cost)
        self.hopeless = next((cut for cut in self.rows.cuts if cut.hopeless), None)
        self.impossible = self.hopeless is not None  # perhaps as a whole, with no single cut to blame
        self.relaxation = Relaxation(self.cost, self.rows, self.caps, self.fixed, self.step)

    # The loop

    def run(self, hint: Bools | None, stop_at_first: bool) -> Cover:
        if self.impossible:
            return self._result(Status.INFEASIBLE)
        if not stop_at_first:
            self._raise_bound(self._relaxed(whole=False).bound - LP_ROOM)  # one bound, however little time there is
        self._complete(self.fixed if hint is None else hint | self.fixed)
        if hint is not None and self.best is None:
            self._complete(self.fixed)
        if not (self._closed() or self.impossible or (stop_at_first and self.best is not None)):
            self._tighten()
        cost = inf
        while self.core is not None and not self._closed() and cost > self.best_cost > _FAR * self.bound:
            cost = self.best_cost
            self._improve_locally(self.core, _FAR_SHARE)
            self._reopen(_FAR_SHARE)
        while not self.impossible and not self._closed():
            if stop_at_first and self.best is not None:
                return self._result(Status.GOOD_ENOUGH)
            if time.monotonic() >= self.deadline:
                return self._result(Status.TIME_LIMIT)
            if not self._round() and self.core is not None:
                core, self.core = self.core, None
                self._improve_locally(core)
                if 2 * np.count_nonzero(core) < self.n and not self._closed():
                    self._confine(core, 0.6)
                    self._improve_locally(core)
        if self.best is None:
            return self._result(Status.INFEASIBLE)
        if self.impossible:
            raise RuntimeError("the cuts exclude a layout that the oracle accepts: a bug in the oracle")
        self._settle()
        return self._result(Status.OPTIMAL)

    def _tighten(self) -> None:
        """The linear relaxation with as many rows as it takes, and layouts made from its solution."""
        best, stale, fruitless, tried, y = 0.0, 0, 0, 0.0, None
        until = time.monotonic() + _SEPARATION_SHARE * self._left()
        while time.monotonic() < self.deadline:
            y, bound, solved, _ = self._relaxed(whole=False)
            if y is None or not solved:
                break
            self._raise_bound(bound - LP_ROOM * max(1.0, abs(bound)))
            best, stale = (bound, 0) if bound > best * 1.001 else (best, stale + 1)
            fruitless = fruitless if stale else 0
            if stale < _PATIENCE and self.rows.activate(y):
                continue
            if self.bound > tried:
                tried = self.bound
                self._round_up(y, _ROUNDING_SHARE)
            fruitless += 1
            if self._closed() or fruitless > _PATIENCE // 2 or time.monotonic() > until or not self._separated(y):
                break
            stale = 0
        if y is None or self.impossible:
            return
        self._round_up(y, _LOCAL_SHARE if self.refused else 0.25)
        self.core = self.relaxation.core(y, self.best_cost)

    def _round_up(self, y: Floats, share: float) -> None:
        """Layouts made from a fractional one, in a share of the time left."""
        if not self._closed():
            self._complete(self.fixed | (y > 0.999), lean=y)
        if not self._closed():
            self._confine(self.fixed | (y > EPS), share)

    def _separated(self, y: Floats) -> bool:
        """Take in cuts that a fractional solution violates, if there are any."""
        known = -1
        while self.separate is not None and len(self.rows.cuts) > known:  # cuts known already bring nothing
            known = len(self.rows.cuts)
            self.rows.add(self.separate(y), active=False)
            if self.rows.activate(y):
                return True
        return False

    def _improve_locally(self, sites: Bools, share: float = _LOCAL_SHARE) -> None:
        """Cheaper layouts of these sites and those of the best, by local search in a share of the time left.

        What the oracle refuses is mended and searched on. Once it has refused one, no more than a step below the best
        is asked for at a time: such layouts soon lack but little, and their cuts are those that bind."""
        from scipy.sparse import csr_array, vstack

        fruitless, start, until = 0, self.best, time.monotonic() + share * self._left()
        while start is not None and self.best is not None and not self._closed() and time.monotonic() < until:
            if fruitless == (_PATIENCE if self.refused else 1):
                return
            some, seed = np.flatnonzero(sites | self.best | start), len(self.rows.cuts) + fruitless
            rows = csr_array(vstack([self.rows.matrix[0], self.caps.matrix[0]], format="csr")[:, some])
            least = np.concatenate([self.rows.matrix[2], self.caps.matrix[2]])
            search = LocalSearch(self.cost[some], rows, least, ~self.fixed[some], seed)
            goal = max(self.bound, self.best_cost - self.step) if self.refused else self.bound
            patience, found = min(_LOCAL_STEPS, _LOCAL_STEPS_PER_SITE * len(some)), np.zeros(self.n, dtype=bool)
            found[some] = search.improve(start[some], until, goal=goal, patience=patience)
            if float(self.cost @ found) > self.best_cost - EPS:
                start, fruitless = self.best, fruitless + 1
            elif self._judge(found):
                start = found if self._cover_rows(found, None) and self.caps.satisfied(found) else self.best
            else:
                self._accept(found)
                start, fruitless = self.best, 0

    def _confine(self, sites: Bools, share: float, kept: Bools | None = None) -> bool:
        """A layout of these sites only, few enough for the master to choose well, in a share of the time left, and of
        those that are ``kept``; whether it is the cheapest so far."""
        sites, kept = sites if self.best is None else sites | self.best, self.fixed if kept is None else kept
        until, chosen = time.monotonic() + share * self._left(), None
        while time.monotonic() < until and not self.impossible:
            y = self.relaxation.among(sites, kept, min(self.deadline, until) - time.monotonic())
            if y is None or self.cost @ (y > 0.5) > self.best_cost - EPS:
                return False
            chosen = y > 0.5
            if not self.rows.activate(chosen) and not self._judge(chosen):
                self._accept(chosen)
                return True
        if chosen is not None and not self._closed():
            self._complete(chosen)
        return False

    def _reopen(self, share: float) -> None:
        """Cheaper layouts that keep all but a few sites of the best, in a share of the time left: local branching
        (Fischetti and Lodi 2003). The few are those that help most in the rows of one of them."""
        random, until, fruitless = np.random.default_rng(self.rounds), time.monotonic() + share * self._left(), 0
        order: Ints = np.zeros(0, dtype=np.intp)
        while self.best is not None and not self._closed() and time.monotonic() < until:
            mine = np.flatnonzero(self.best & ~self.fixed)
            if fruitless == len(mine):
                return
            order = order if fruitless else random.permutation(mine)
            by_column = self.rows.matrix[1]
            shared = (by_column[:, mine].T @ by_column[:, [order[fruitless]]]).toarray()[:, 0]
            kept = self.best.copy()
            kept[mine[np.argsort(-shared, kind="stable")[:_REOPENED]]] = False
            fruitless = 0 if self._confine(np.ones(self.n, dtype=bool), 1.0, kept) else fruitless + 1

    def _round(self) -> bool:
        """Solve the master and ask what is wrong with its layout; False if it took too long."""
        self.rounds += 1
        patient = inf if self.core is None else time.monotonic() + _MASTER_SHARE * self._left()
        y, bound, solved, _ = self._relaxed(whole=True, until=patient)
        self._raise_bound(bound)
        if y is None:
            return solved
        chosen = y > 0.5
        if not self.rows.activate(chosen) and not self._judge(chosen):
            self._accept(chosen)
            self._raise_bound(float(self.cost @ chosen) if solved else 0.0)
        elif not self._closed():
            self._complete(chosen)
        return solved

    def _left(self) -> float:
        """Seconds that are left, no more than are worth dividing up."""
        return min(self.deadline - time.monotonic(), _LONGEST_S)

    def _result(self, status: Status) -> Cover:
        bound = self.best_cost if status is Status.OPTIMAL else min(self.bound, self.best_cost)
        return Cover(status, self.best, self.best_cost, bound, self.hopeless, self.rounds, len(self.rows.cuts))

    def _closed(self) -> bool:
        return self.best is not None and self.best_cost <= self.bound + 1e-9 * max(1.0, self.best_cost)

    def _raise_bound(self, bound: float) -> None:
        if self.step > 0:
            bound = self.step * ceil((bound - EPS) / self.step)
        if bound > self.bound:
            self.bound = bound
            self._report()

    def _accept(self, chosen: Bools) -> None:
        value = float(self.cost @ chosen)
        if value < self.best_cost - 1e-12:
            self.best, self.best_cost = chosen.copy(), value
            self._report()

    def _report(self) -> None:
        self.progress(time.monotonic() - self.began, self.best_cost, min(self.bound, self.best_cost))

    def _judge(self, chosen: Bools) -> Sequence[Cut]:
        """The oracle's cuts, remembered."""
        cuts = self.oracle.cuts(chosen)
        self.rows.add(cuts)
        self.refused = self.refused or bool(cuts)
        self.hopeless = self.hopeless or next((cut for cut in cuts if cut.hopeless), None)
        self.impossible = self.impossible or self.hopeless is not None
        return cuts

    def _relaxed(self, *, whole: bool, until: float = inf) -> Solution:
        """The optimum of (1)-(4) with the active rows."""
        found = self.relaxation.optimum(self.best_cost, min(self.deadline, until) - time.monotonic(), whole=whole)
        self.impossible = self.impossible or found.impossible
        return found

    # Upper bounds

    def _complete(self, start: Bools, lean: Floats | None = None) -> None:
        """Add sites to ``start`` until the oracle accepts, then drop what is not needed.

        Sites that a fractional solution ``lean`` has more of are preferred.
        """
        chosen = start.copy()
        if not self.caps.satisfied(chosen) and not self.caps.satisfied(chosen := self.fixed.copy()):
            return
        until = self.deadline if self.best is None else time.monotonic() + _LOCAL_SHARE * self._left()
        for _ in range(4 * self.n + 100):
            if not self._cover_rows(chosen, lean):
                return
            cuts = self._judge(chosen)
            if not cuts:
                break
            if time.monotonic() > until or self.impossible:
                return
        else:
            return
        self._accept(chosen)
        if time.monotonic() < self.deadline:
            self._accept(self._pruned(chosen))

    def _cover_rows(self, chosen: Bools, lean: Floats | None) -> bool:
        """Greedy set cover of the known rows; False if it gets stuck."""
        price = np.maximum(self.cost, 1e-12) if lean is None else np.maximum(self.cost, 1e-12) * (1.01 - lean)
        missing, room = self.rows.missing(chosen), -self.caps.missing(chosen)
        while (missing > EPS).any():
            worth = self.rows.gain(missing) / price
            worth[chosen | self.caps.forbids(room)] = 0.0
            site = int(np.argmax(worth))
            if worth[site] <= 0:
                return False
            chosen[site] = True
            missing -= self.rows.column(site)
            room += self.caps.column(site)  # weights <= 0
        return True

    def _pruned(self, chosen: Bools) -> Bools:
        """Without the sites that are not needed: the dearest are tried first, then the last in the list."""
        chosen = chosen.copy()
        mine = np.flatnonzero(chosen & ~self.fixed)
        for site in sorted(mine.tolist(), key=lambda i: (-self.cost[i], -i)):
            chosen[site] = False
            if not self.rows.satisfied(chosen) or self.oracle.cuts(chosen, near=site):
                chosen[site] = True
            if time.monotonic() > self.deadline:
                break
        return chosen

    def _settle(self) -> None:
        """The tie-break: exchange sites one by one for equally dear ones listed earlier, while that is accepted."""
        assert self.best is not None
        chosen, moved = self.best.copy(), True
        while moved and time.monotonic() < self.deadline:
            moved = False
            for site in np.flatnonzero(chosen & ~self.fixed).tolist():
                for other in self._stand_ins(chosen, site):
                    trial = chosen.copy()
                    trial[site], trial[other] = False, True
                    fits = self.rows.satisfied(trial) and self.caps.satisfied(trial)
                    if fits and not any(self.oracle.cuts(trial, near=moved_site) for moved_site in (site, other)):
                        chosen, moved = trial, True
                        break
                    if time.monotonic() > self.deadline:
                        break
        self.best = chosen

    def _stand_ins(self, chosen: Bools, site: int) -> list[int]:
        """Sites listed before ``site``, equally dear, that meet every row which needs it."""
        without = chosen.copy()
        without[site] = False
        missing = self.rows.missing(without)
        short = np.flatnonzero(missing > EPS)
        fit = (np.arange(self.n) < site) & ~chosen & (self.cost == self.cost[site])
        columns = np.flatnonzero(fit)
        given = self.rows.matrix[0][short].tocsc()[:, columns].toarray()
        return [int(i) for i in columns[(given >= missing[short, None] - EPS).all(axis=0)]]
