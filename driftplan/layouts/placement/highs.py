"""HiGHS, through scipy, on covering problems; Ctrl-C is heard while it works."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from driftplan.arrays import Floats


def solve(
    cost: Floats, rows: Any, least: Floats, bounds: tuple[Floats, Floats], *, whole: bool, time_limit: float
) -> Any:
    """Minimise ``cost @ y`` with ``rows @ y >= least`` and y within ``bounds``, in 0/1 or fractional numbers.

    Parameters
    ----------
    cost : (n,)
    rows : sparse array (m, n)
    least : (m,)
    bounds : the least and the most of every column, (n,) each
    whole : bool
    time_limit : float, seconds

    Returns
    -------
    scipy's OptimizeResult, of status 0 (optimal), 1 (time limit) or 2 (infeasible); ``lower.marginals`` are the reduced
    costs of a fractional optimum
    """
    from scipy.optimize import Bounds, LinearConstraint, linprog, milp

    def in_whole_numbers() -> Any:
        return milp(
            cost,
            integrality=np.ones(len(cost), dtype=np.intp),
            bounds=Bounds(*bounds),
            constraints=LinearConstraint(rows, lb=least) if len(least) else (),
            options={"time_limit": time_limit, "mip_rel_gap": 0.0},
        )

    def in_fractions() -> Any:
        limited = {"A_ub": -rows, "b_ub": -least} if len(least) else {}
        return linprog(cost, bounds=np.stack(bounds, axis=1), options={"time_limit": time_limit}, **limited)

    found = _interruptible(in_whole_numbers if whole else in_fractions)
    if found.status not in (0, 1, 2):
        raise RuntimeError(f"HiGHS could not solve the covering problem: {found.message}")
    return found


def _interruptible(work: Callable[[], Any]) -> Any:
    """The result of ``work``, computed beside the main thread so that Ctrl-C is heard at once."""
    outcome: list[Any] = []

    def run() -> None:
        try:
            outcome.append((work(), None))
        except BaseException as err:
            outcome.append((None, err))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.1)
    result, err = outcome[0]
    if err is not None:
        raise err
    return result
