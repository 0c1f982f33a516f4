"""The master problem of `covering` with the rows known so far, in whole numbers or fractions, solved by HiGHS.

Every optimum is a lower bound. The reduced costs of a fractional one tell more: a layout with a site of reduced cost r
costs at least the optimum plus r. Sites that no layout cheaper than the best can have are left out from then on.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from math import inf
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import Bools, Floats
from driftplan.layouts.placement.cut_pool import EPS, CutPool

LP_ROOM = 1e-5  # relative: a fractional optimum is that uncertain
_CORE_SITES = 1000  # sites that look best, those of least reduced cost, or
_CORE_PER_ROW = 5  # so many per row, if that is more


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

        rows, least = self.rows.active_rows
        caps, _, cap_least = self.caps.matrix
        return vstack([rows, caps], format="csr"), np.concatenate([least, cap_least])

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
