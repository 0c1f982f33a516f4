"""The covering core against brute force, with oracles that accept arbitrary families of layouts."""

import signal
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

from driftplan.layouts.placement.cover_bounds import LocalSearch, Relaxation
from driftplan.layouts.placement.covering import _CoverSearch, cheapest_cover
from driftplan.layouts.placement.cut_pool import Cut, CutPool
from driftplan.planning.status import Status


def bits(s, n):
    return np.array([s >> i & 1 for i in range(n)], dtype=bool)


class Family:
    """Accepts the listed layouts only; its cut forbids exactly the layout asked about."""

    def __init__(self, accepted, n):
        self.accepted, self.n, self.asked = set(accepted), n, 0

    def cuts(self, chosen, near=None):
        self.asked += 1
        if sum(1 << i for i in np.flatnonzero(chosen).tolist()) in self.accepted:
            return []
        return [Cut(np.arange(self.n), np.where(chosen, -1.0, 1.0), 1.0 - chosen.sum())]


@st.composite
def families(draw):
    n = draw(st.integers(1, 5))
    cost = np.array(draw(st.lists(st.sampled_from([1.0, 2.0, 2.5]), min_size=n, max_size=n)))
    accepted = draw(st.sets(st.integers(0, 2**n - 1), max_size=6))
    return n, cost, accepted


@settings(deadline=None, max_examples=15)
@given(families())
def test_the_cheapest_accepted_layout_is_found_though_accepted_layouts_form_no_pattern(case):
    n, cost, accepted = case
    found = cheapest_cover(cost, Family(accepted, n))
    best = min((cost @ bits(s, n) for s in accepted), default=np.inf)
    assert found.cost == pytest.approx(best)
    assert found.status is (Status.OPTIMAL if accepted else Status.INFEASIBLE)
    assert found.lower_bound == pytest.approx(best if accepted else found.lower_bound)


@settings(deadline=None, max_examples=15)
@given(families(), st.integers(0, 31), st.integers(0, 4), st.integers(0, 3))
def test_caps_demands_and_fixed_sites_are_kept(case, fixed, most, least):
    n, cost, accepted = case
    fixed = bits(fixed, n) if fixed % 3 == 0 else np.zeros(n, dtype=bool)
    cap = Cut(np.arange(n), -np.ones(n), -float(most))
    demand = Cut(np.arange(0, n, 2), np.ones(len(range(0, n, 2))), float(least))
    found = cheapest_cover(cost, Family(accepted, n), demands=[demand], caps=[cap], fixed=fixed)
    allowed = [
        bits(s, n)
        for s in accepted
        if bits(s, n).sum() <= most and bits(s, n)[::2].sum() >= least and bits(s, n)[fixed].all()
    ]
    assert found.cost == pytest.approx(min((cost @ y for y in allowed), default=np.inf))
    assert (found.chosen is None) == (not allowed)


class Rows:
    """Accepts what meets all rows, and says only the first that is missed."""

    def __init__(self, matrix, least):
        self.matrix, self.least = matrix, least

    def cuts(self, chosen, near=None):
        missed = np.flatnonzero(self.matrix @ chosen < self.least)
        return [self.row(i) for i in missed[:1].tolist()]

    def row(self, i):
        columns = np.flatnonzero(self.matrix[i])
        return Cut(columns, self.matrix[i, columns].astype(float), float(self.least[i]), (0, i))


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("told", ["at once", "one by one"])
def test_set_multicover_matches_brute_force(seed, told):
    rng = np.random.default_rng(seed)
    matrix = (rng.random((12, 9)) < 0.35).astype(int)
    least = np.minimum(rng.integers(1, 3, 12), matrix.sum(axis=1))
    cost = rng.integers(1, 5, 9).astype(float)
    oracle = Rows(matrix, least)
    demands = [oracle.row(i) for i in range(12)] if told == "at once" else []
    found = cheapest_cover(cost, oracle, demands=demands)
    best = min(cost @ bits(s, 9) for s in range(512) if (matrix @ bits(s, 9) >= least).all())
    assert (found.cost, found.lower_bound, found.status) == (best, best, Status.OPTIMAL)


def test_of_equally_dear_sites_the_one_listed_first_is_taken():
    class AnyOfTheLastThree:
        def cuts(self, chosen, near=None):
            return [] if chosen[2:].any() else [Cut(np.array([2, 3, 4]), np.ones(3), 1.0)]

    found = cheapest_cover(np.ones(5), AnyOfTheLastThree(), hint=bits(0b10000, 5))
    assert np.flatnonzero(found.chosen).tolist() == [2]


def test_a_cut_that_nothing_satisfies_is_handed_back():
    cut = Cut(np.array([0, 1]), np.ones(2), 3.0, (7, 4))
    found = cheapest_cover(np.ones(4), Family({15}, 4), demands=[cut])
    assert found.status is Status.INFEASIBLE
    assert found.hopeless is cut


def hard_cover(seed=0, rows=500, columns=300):
    """A random set cover that takes HiGHS far longer than any test."""
    matrix = (np.random.default_rng(seed).random((rows, columns)) < 0.03).astype(int)
    matrix = matrix[matrix.any(axis=1)]
    oracle = Rows(matrix, np.ones(len(matrix)))
    return oracle, [oracle.row(i) for i in range(len(matrix))]


def test_where_the_master_is_too_hard_the_best_of_a_local_search_comes_back_with_a_bound_below_it():
    oracle, demands = hard_cover()
    told = []
    found = cheapest_cover(
        np.ones(300), oracle, demands=demands, time_limit=4.0, progress=lambda *news: told.append(news)
    )
    assert found.status is Status.TIME_LIMIT
    assert oracle.cuts(found.chosen) == []
    assert 0 < found.lower_bound < found.cost == found.chosen.sum() <= 60  # which the master alone does not find
    costs, bounds = [cost for _, cost, _ in told], [bound for *_, bound in told]
    assert costs == sorted(costs, reverse=True)
    assert bounds == sorted(bounds)
    assert (costs[-1], bounds[-1]) == (found.cost, found.lower_bound)


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs a timer signal")
def test_ctrl_c_is_heard_while_the_solver_runs():
    others, heard = set(threading.enumerate()), []

    def interrupt(*_):
        working = [thread for thread in threading.enumerate() if thread not in others]
        heard.append(working)
        if len(heard) > 2 and working and heard[-3] == working:  # the same solver has been at it for a while
            raise KeyboardInterrupt

    oracle, demands = hard_cover()
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2, 0.2)
        with pytest.raises(KeyboardInterrupt):  # in the midst of its work, not when it comes back
            cheapest_cover(np.ones(300), oracle, demands=demands, time_limit=6.0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_stopping_at_the_first_layout_is_said():
    found = cheapest_cover(np.array([5.0, 1.0]), Family({1, 2}, 2), hint=bits(1, 2), stop_at_first=True)
    assert found.status is Status.GOOD_ENOUGH
    assert found.cost == 5.0


def stretches(seed, rows=900, columns=120):
    """Rows that each want one of a few neighbouring columns: many more than a relaxation needs."""
    rng = np.random.default_rng(seed)
    begin = rng.integers(0, columns - 12, rows)
    matrix = np.zeros((rows, columns), dtype=int)
    for i, b in enumerate(begin.tolist()):
        matrix[i, b : b + int(rng.integers(4, 12))] = 1
    return Rows(matrix, np.ones(rows)), rng.integers(1, 4, columns).astype(float)


@pytest.mark.parametrize("seed", range(3))
def test_with_many_rows_only_some_are_used_and_the_optimum_is_that_of_all(seed):
    oracle, cost = stretches(seed)
    demands = [oracle.row(i) for i in range(len(oracle.least))]
    found = cheapest_cover(cost, oracle, demands=demands)
    whole = milp(
        cost, integrality=np.ones(len(cost)), bounds=Bounds(0, 1), constraints=LinearConstraint(oracle.matrix, lb=1.0)
    )
    assert found.cost == found.lower_bound == pytest.approx(whole.fun)
    assert oracle.cuts(found.chosen) == []


def test_a_pool_starts_with_disjoint_rows_and_lets_missed_ones_join():
    oracle, _ = stretches(0)
    pool = CutPool(oracle.matrix.shape[1], [oracle.row(i) for i in range(len(oracle.least))])
    rows = pool.matrix[0].toarray()
    assert (rows[pool.active].sum(axis=0) <= 1).all()
    before = pool.active.sum()
    y = np.zeros(oracle.matrix.shape[1])
    assert pool.activate(y)
    assert pool.active.sum() > before
    pool.active[:] = True
    assert not pool.activate(y)
    assert pool.satisfied(np.ones(len(y)))


def test_a_pool_knows_no_cut_twice():
    cut, same = (Cut(np.array([0, 2]), np.ones(2), 1.0) for _ in range(2))
    pool = CutPool(3, [cut])
    pool.add([same, Cut(np.array([1]), np.ones(1), 1.0)])
    assert len(pool.cuts) == len(pool.active) == 2
    np.testing.assert_array_equal(pool.missing(np.array([1.0, 0.0, 0.0])), [0.0, 1.0])
    np.testing.assert_array_equal(pool.gain(np.array([1.0, 1.0])), [1.0, 1.0, 1.0])


@pytest.mark.parametrize("seed", range(6))
def test_a_local_search_only_ever_returns_what_satisfies_all_rows_and_costs_no_more(seed):
    rng = np.random.default_rng(seed)
    matrix = np.where(rng.random((40, 25)) < 0.2, rng.integers(1, 3, (40, 25)), 0).astype(float)
    matrix = np.concatenate([matrix, -(rng.random((3, 25)) < 0.3).astype(float)])  # the last rows are caps
    least = np.concatenate([np.minimum(rng.integers(1, 4, 40), matrix[:40].sum(axis=1)), -0.8 * 25 * np.ones(3)])
    cost, free = rng.integers(1, 5, 25).astype(float), rng.random(25) < 0.9
    start = np.ones(25, dtype=bool)
    found = LocalSearch(cost, csr_array(matrix), least, free, seed).improve(start, np.inf, patience=300)
    assert (matrix @ found >= least).all()
    assert found[~free].all()
    whole = milp(
        cost,
        integrality=np.ones(25),
        bounds=Bounds(~free, 1),
        constraints=LinearConstraint(matrix, lb=least),
    )
    assert whole.fun <= cost @ found <= 1.1 * whole.fun


@pytest.mark.parametrize("seed", range(3))
def test_choosing_a_few_sites_anew_at_a_time_leads_to_the_optimum_of_short_rows(seed):
    oracle, cost = stretches(seed)
    demands = [oracle.row(i) for i in range(len(oracle.least))]
    fixed = np.zeros(len(cost), dtype=bool)
    fixed[0] = True
    rows, caps = CutPool(len(cost), demands), CutPool(len(cost), [])
    search = _CoverSearch(cost, oracle, rows, caps, fixed, None, 60.0, lambda *_: None)
    search._complete(fixed)
    search._reopen(1.0)
    assert search.best[0]
    assert oracle.cuts(search.best) == []
    whole = milp(
        cost,
        integrality=np.ones(len(cost)),
        bounds=Bounds(fixed, 1),
        constraints=LinearConstraint(oracle.matrix, lb=1.0),
    )
    assert whole.fun <= search.best_cost <= 1.02 * whole.fun


def test_a_site_too_dear_for_anything_better_is_left_out_and_the_optimum_stays():
    oracle, cost = stretches(1, rows=60, columns=40)
    rows, caps = CutPool(40, [oracle.row(i) for i in range(60)]), CutPool(40, [])
    relaxation = Relaxation(cost, rows, caps, np.zeros(40, dtype=bool), step=1.0)
    free = relaxation.optimum(np.inf, 10.0, whole=True).bound
    relaxation.optimum(np.inf, 10.0, whole=False)
    assert relaxation.worth_trying(np.inf).all()
    assert not relaxation.worth_trying(free + 1).all()
    assert relaxation.optimum(free + 1, 10.0, whole=True).bound == pytest.approx(free)
    assert relaxation.optimum(free, 10.0, whole=True).bound >= free - 1e-6  # that nothing is cheaper
