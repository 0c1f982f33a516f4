"""A local search for cheaper 0/1 vectors that satisfy linear rows: the incumbents of `covering`.

Rows are Σ w_i y_i >= least, of any sign. From a vector that satisfies them the search takes columns out until some rows
are missed, and then exchanges columns one by one under the best cost so far: out goes the one that is missed least, in
comes, for one of the missed rows, the one that mends most per cost. Rows that stay missed grow heavier, so that the
search does not go in circles (row weighting: Gao, Weise and Li 2015, "An efficient local search heuristic with row
weighting for the unicost set covering problem"; here with costs and general rows).
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from driftplan.arrays import Bools, Floats, Ints
from driftplan.layouts.placement.cut_pool import EPS

_LOOK_AT_CLOCK = 64  # steps between looks at the clock
_ADDED_AT_ONCE = 20  # columns that come, at most, for those that went
_TABU = 3  # steps for which a column that has just come stays


class LocalSearch:
    """Costs (n,), sparse rows (m, n) and their least activities (m,), and which columns are free to change, (n,)."""

    def __init__(self, cost: Floats, rows: Any, least: Floats, free: Bools, seed: int = 0):
        self.cost, self.least, self.free = cost, least, free
        self.price = np.maximum(cost, 1e-9)
        self.random = np.random.default_rng(seed)
        by_column = rows.tocsc()
        self.rows, self.column, self.weight = rows, rows.indices, rows.data
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
        entries = (np.arange(*self.rows.indptr[r : r + 2]) for r in rows.tolist())
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
        entries = slice(self.rows.indptr[row], self.rows.indptr[row + 1])
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
