"""The master problem of `covering` with the rows known so far, in whole numbers or fractions, and what it tells.

Every optimum is a lower bound. The reduced costs of a fractional one tell more: a layout with a site of reduced cost r
costs at least the optimum plus r. Sites that no layout cheaper than the best can have are left out from then on.
"""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import Bools, Floats
from driftplan.layouts.placement.cut_pool import EPS, CutPool
from driftplan.layouts.placement.highs import solve

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
    """The master problem; ``rows`` and ``caps`` are pools that may grow.

    Attributes
    ----------
    dearness : (n,), no layout with a site costs less than this
    reduced : (n,), reduced costs in the latest fractional optimum
    """

    def __init__(self, cost: Floats, rows: CutPool, caps: CutPool, fixed: Bools, step: float):
        self.cost, self.rows, self.caps, self.fixed, self.step = cost, rows, caps, fixed, step
        self.dearness, self.reduced = np.zeros(len(cost)), np.zeros(len(cost))

    def optimum(self, best_cost: float, time_limit: float, *, whole: bool) -> Solution:
        """With the active rows: nothing that would cost more than ``best_cost`` is looked for."""
        most = self.worth_trying(best_cost)
        found = self._solved(most, time_limit, whole)
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

    def among(self, sites: Bools, time_limit: float) -> Floats | None:
        """The best layout found of these sites only: no relaxation, hence no bound."""
        found = self._solved(sites, time_limit, whole=True)
        return None if found.x is None else np.asarray(found.x, dtype=float)

    def _solved(self, most: Bools, time_limit: float, whole: bool) -> Any:
        from scipy.sparse import vstack

        rows, least = self.rows.active_rows
        caps, _, cap_least = self.caps.matrix
        return solve(
            self.cost,
            vstack([rows, caps], format="csr"),
            np.concatenate([least, cap_least]),
            (self.fixed.astype(float), most.astype(float)),
            whole=whole,
            time_limit=max(0.05, time_limit),
        )

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
