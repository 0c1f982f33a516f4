"""Bounds on the cost of `covering`: from below by its master problem, from above by a local search for cheaper layouts.

The master problem has the rows known so far, in whole numbers or fractions, and is solved by HiGHS. Every optimum is a
lower bound. The reduced costs of a fractional one tell more: a layout with a site of reduced cost r costs at least the
optimum plus r. Sites that no layout cheaper than the best can have are left out from then on.

The local search looks at 0/1 vectors y that satisfy rows Σ w_i y_i >= least, of any sign. From one it takes columns out
until some rows are missed, and then exchanges columns one by one under the best cost so far: out goes the one that is
missed least, in comes, for one of the missed rows, the one that mends most per cost. Rows that stay missed grow
heavier, so that the search does not go in circles (row weighting: Gao, Weise and Li 2015, "An efficient local search
heuristic with row weighting for the unicost set covering problem"; here with costs and general rows).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from math import inf
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import Bools, Floats, Ints
from driftplan.layouts.placement.cut_pool import EPS, CutPool

LP_ROOM = 1e-5  # relative: a fractional optimum is that uncertain
_CORE_SITES = 1000  # sites that look best, those of least reduced cost, or
_CORE_PER_ROW = 5  # so many per row, if that is more
_LOOK_AT_CLOCK = 64  # steps between looks at the clock
_ADDED_AT_ONCE = 20  # columns that come, at most, for those that went
_TABU = 3  # steps for which a column that has just come stays


class Solution(NamedTuple):
    """What a relaxation says: a vector, if it has one, a lower bound, and whether it is optimal or there is none."""

    y: Floats | None
    bound: float
    solved: bool
    impossible: bool = False


class Relaxation:
    """The master problem; ``rows`` and ``caps`` are pools that may grow."""

    def __init__(self, cost: Floats, rows: CutPool, caps: CutPool, fixed: Bools, step: float):
        self.cost, self.rows, self.caps, self.fixed, self.step = cost, rows, caps, fixed, step
        self.dearness = np.zeros(len(cost))  # no layout with a site costs less than this
        self.reduced = np.zeros(len(cost))  # reduced costs in the latest fractional optimum

    def optimum(self, best_cost: float, time_limit: float, *, whole: bool) -> Solution:
        """With the active rows: nothing that would cost more than ``best_cost`` is looked for."""
        most = self.worth_trying(best_cost)
        bounds = self.fixed.astype(float), most.astype(float)
        found = _optimum(self.cost, *self._rows, *bounds, time_limit, whole=whole)
        y = None if found.x is None else np.asarray(found.x, dtype=float)
        if found.status == 2:
            nothing_cheaper = not most.all()
            return Solution(None, best_cost if nothing_cheaper else 0.0, True, impossible=not nothing_cheaper)
        bound = found.mip_dual_bound if whole else found.fun if found.status == 0 else None
        if bound is None or not np.isfinite(bound):
            return Solution(y, 0.0, False)
        if not whole:
            self.reduced = np.asarray(found.lower.marginals, dtype=float)
            self.dearness = np.maximum(self.dearness, bound + self.reduced)
        return Solution(y, float(bound), found.status == 0)

    def among(self, sites: Bools, kept: Bools, time_limit: float) -> Floats | None:
        """The best layout found with all sites that are ``kept`` and some of ``sites``: no relaxation, no bound."""
        kept = self.fixed | kept
        rows, least = self._rows
        free, least = np.flatnonzero(sites & ~kept), least - rows @ kept
        rows = rows[:, free]
        open_rows = np.flatnonzero(least - rows.minimum(0).sum(axis=1) > EPS)
        y = kept.astype(float)
        if len(open_rows):
            few = rows[open_rows], least[open_rows]
            found = _optimum(self.cost[free], *few, np.zeros(len(free)), np.ones(len(free)), time_limit, whole=True)
            if found.x is None:
                return None
            y[free] = found.x
        return y

    @property
    def _rows(self) -> tuple[Any, Floats]:
        """The active rows and the caps."""
        from scipy.sparse import vstack

        (rows, _, least), (caps, _, cap_least) = self.rows.matrix, self.caps.matrix
        active = np.flatnonzero(self.rows.active)
        return vstack([rows[active], caps], format="csr"), np.concatenate([least[active], cap_least])

    def worth_trying(self, best_cost: float) -> Bools:
        """The sites that a layout cheaper than the best may have."""
        if best_cost == inf:
            return np.ones(len(self.cost), dtype=bool)
        most = best_cost - 0.5 * self.step + LP_ROOM * max(1.0, best_cost)
        return np.asarray((self.dearness <= most) | self.fixed)

    def core(self, y: Floats, best_cost: float) -> Bools:
        """The sites that look best in the fractional optimum ``y``."""
        size = max(_CORE_SITES, _CORE_PER_ROW * int(self.rows.active.sum()))
        core = self.fixed | (y > EPS)
        core[np.argsort(np.where(self.worth_trying(best_cost), self.reduced, inf), kind="stable")[:size]] = True
        return np.asarray(core)


def _optimum(cost: Floats, rows: Any, least: Floats, low: Floats, high: Floats, limit_s: float, *, whole: bool) -> Any:
    """scipy's result, of status 0 (optimal), 1 (time limit) or 2 (infeasible)."""
    from scipy.optimize import Bounds, LinearConstraint, linprog, milp

    options: dict[str, Any] = {"time_limit": max(0.05, limit_s)}
    rows.indices, rows.indptr = rows.indices.astype(np.int32), rows.indptr.astype(np.int32)  # scipy 1.13's milp

    def solved() -> Any:
        if whole:
            limited = {"constraints": LinearConstraint(rows, lb=least)} if len(least) else {}
            options["mip_rel_gap"] = 0.0
            return milp(cost, integrality=np.ones(len(cost)), bounds=Bounds(low, high), options=options, **limited)
        limited = {"A_ub": -rows, "b_ub": -least} if len(least) else {}
        return linprog(cost, bounds=np.stack([low, high], axis=1), options=options, **limited)

    found = _interruptible(solved)
    if found.status not in (0, 1, 2):
        raise RuntimeError(f"HiGHS could not solve the covering problem: {found.message}")
    return found


def _interruptible(work: Callable[[], Any]) -> Any:
    """The result of ``work``, computed beside the main thread so that Ctrl-C is heard at once."""
    outcome: Future[Any] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as err:
            outcome.set_exception(err)

    threading.Thread(target=run, daemon=True).start()
    while not outcome.done():
        wait([outcome], timeout=0.1)
    return outcome.result()


def common_step(cost: Floats) -> float:
    """The greatest step of which all costs are multiples, if they are whole numbers; else 0."""
    whole = np.round(cost)
    if not (len(cost) and np.array_equal(whole, cost) and cost.max() < 1e9):
        return 0.0
    return float(np.gcd.reduce(whole.astype(np.int64)))


class LocalSearch:
    """Costs (n,), sparse rows (m, n) and their least activities (m,), and which columns are free to change, (n,)."""

    def __init__(self, cost: Floats, rows: Any, least: Floats, free: Bools, seed: int = 0):
        self.cost, self.least, self.free = cost, least, free
        self.price = np.maximum(cost, 1e-9)
        self.random = np.random.default_rng(seed)
        by_column = rows.tocsc()
        self.rows, self.column, self.weight, self.starts = rows, rows.indices, rows.data, rows.indptr.tolist()
        self.row = np.repeat(np.arange(len(least)), np.diff(rows.indptr))
        self.rows_of = np.split(by_column.indices, by_column.indptr[1:-1])
        self.given_by = np.split(by_column.data, by_column.indptr[1:-1])
        self.touched_by: dict[int, Ints] = {}  # column: the entries of all its rows

    def improve(self, start: Bools, deadline: float, goal: float = 0.0, patience: int = 10**9) -> Bools:
        """The cheapest vector found by ``deadline`` (of `time.monotonic`), in ``patience`` steps without success, or
        as soon as its cost is ``goal`` or less; ``start`` itself if none is cheaper."""
        self._begin(start)
        best, best_cost, stale, step = start.copy(), float(self.cost @ start), 0, 0
        while stale < patience and best_cost > goal + EPS:
            step, stale = step + 1, stale + 1
            if step % _LOOK_AT_CLOCK == 0 and time.monotonic() > deadline:
                break
            while not self.missed.any():
                if self.paid < best_cost - EPS:
                    best, best_cost, stale = self.y.copy(), self.paid, 0
                if not self._remove(step, tabu=0):
                    return best
            self._remove(step, tabu=_TABU)
            for _ in range(_ADDED_AT_ONCE):
                if not (self.missed.any() and self._add(step, best_cost)):
                    break
            heavier = np.flatnonzero(self.missed)
            self.heavy[heavier] += 1.0
            self._recount(self._entries_of(heavier))
        return best

    def _begin(self, start: Bools) -> None:
        self.y = start.copy()
        self.paid = float(self.cost @ start)
        self.heavy = np.ones(len(self.least))
        self.short = self.least - self.rows @ start.astype(float)
        self.missed = self.short > EPS
        self.moved = np.zeros(len(start), dtype=np.intp)  # the step in which a column last moved
        self.may_come = np.ones(len(start), dtype=bool)  # something about its rows has changed since it went
        self.part = np.zeros(len(self.column))  # of the worth of its column, for every entry of the rows
        self.worth = np.zeros(len(start))  # by how much less, in all, rows are missed once a column has flipped
        self._recount(np.arange(len(self.column)))

    def _recount(self, entries: Ints) -> None:
        """Let the worth of columns follow what has changed in some entries of the rows."""
        column, row, weight = self.column[entries], self.row[entries], self.weight[entries]
        short = self.short[row]
        after = np.where(self.y[column], short + weight, short - weight)
        part = self.heavy[row] * (np.maximum(short, 0.0) - np.maximum(after, 0.0))
        np.add.at(self.worth, column, part - self.part[entries])
        self.part[entries] = part

    def _entries_of(self, rows: Ints) -> Ints:
        entries = (np.arange(self.starts[r], self.starts[r + 1]) for r in rows.tolist())
        return np.concatenate([np.zeros(0, dtype=np.intp), *entries])

    def _flip(self, column: int, step: int) -> None:
        rows, change = self.rows_of[column], -1.0 if self.y[column] else 1.0
        if column not in self.touched_by:
            self.touched_by[column] = self._entries_of(rows)
        entries = self.touched_by[column]
        self.y[column] = change > 0
        self.short[rows] -= change * self.given_by[column]
        self.missed[rows] = self.short[rows] > EPS
        self._recount(entries)
        self.paid += change * float(self.cost[column])
        self.moved[column] = step
        self.may_come[self.column[entries]] = True
        self.may_come[column] = change > 0

    def _remove(self, step: int, tabu: int) -> bool:
        """Take out the column that is missed least for what it costs; False if none may go."""
        here = np.flatnonzero(self.y & self.free)
        rested = here[self.moved[here] < step - tabu] if tabu else here
        here = rested if len(rested) else here
        if not len(here):
            return False
        self._flip(int(self._best(here)), step)
        return True

    def _add(self, step: int, under: float) -> bool:
        """Put in the best column for one of the missed rows, if it stays cheaper than ``under``."""
        missed = np.flatnonzero(self.missed)
        row = missed[int(self.random.random() * len(missed))]
        entries = slice(self.starts[row], self.starts[row + 1])
        columns, weights = self.column[entries], self.weight[entries]
        helps = np.where(self.y[columns], weights < 0, weights > 0) & self.free[columns] & self.may_come[columns]
        change = np.where(self.y[columns], -self.cost[columns], self.cost[columns])
        able = columns[helps & (self.paid + change < under - EPS)]
        if not len(able):
            return False
        self._flip(int(self._best(able)), step)
        return True

    def _best(self, columns: Ints) -> int:
        """Of some columns the one of most worth per cost; of equals the one that has not moved for longest."""
        worth = self.worth[columns] / self.price[columns]
        top = columns[worth >= worth.max() - 1e-9]
        return int(top[np.argmin(self.moved[top])])
