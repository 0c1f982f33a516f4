"""The pool of cuts, the relaxation of them and the local search, against plain dense arrays."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, linprog, milp
from scipy.sparse import csr_array

from driftplan.layouts.placement import cover_bounds
from driftplan.layouts.placement.cover_bounds import LocalSearch, Relaxation, _interruptible, common_step
from driftplan.layouts.placement.cut_pool import Cut, CutPool


def cut_of(row, least, where=(0, 0)):
    columns = np.flatnonzero(row)
    return Cut(columns, np.asarray(row, dtype=float)[columns], float(least), where)


def rows(seed, m=12, n=8):
    """A matrix of small weights of both signs, and what the rows want."""
    rng = np.random.default_rng(seed)
    matrix = np.where(rng.random((m, n)) < 0.4, rng.choice([1, 1, 2, -1], (m, n)), 0)
    matrix[np.arange(m), rng.integers(0, n, m)] = 1
    return matrix, rng.integers(0, 3, m), rng


def pool_of(matrix, least):
    return CutPool(matrix.shape[1], [cut_of(row, want) for row, want in zip(matrix, least, strict=True)])


# The pool


@pytest.mark.parametrize("seed", range(6))
def test_a_pool_does_what_a_dense_matrix_does(seed):
    matrix, least, rng = rows(seed)
    pool = pool_of(matrix, least)
    everything, by_column, wants = pool.matrix
    keep = [i for i in range(12) if not any((matrix[i] == matrix[k]).all() and least[i] == least[k] for k in range(i))]
    matrix, least = matrix[keep], least[keep]
    np.testing.assert_array_equal(everything.toarray(), matrix)
    np.testing.assert_array_equal(by_column.toarray(), matrix)
    np.testing.assert_array_equal(wants, least)
    y = rng.random(8)
    np.testing.assert_allclose(pool.missing(y), least - matrix @ y)
    missing = rng.uniform(-1, 3, len(keep)) * (rng.random(len(keep)) < 0.7)
    gain = (np.minimum(matrix, np.maximum(missing, 0)[:, None]) * (missing > 1e-6)[:, None]).sum(axis=0)
    np.testing.assert_allclose(pool.gain(missing), gain)
    room = rng.integers(-1, 3, len(keep)).astype(float)
    np.testing.assert_array_equal(pool.forbids(room), ((matrix + room[:, None] < 0) & (matrix != 0)).any(axis=0))
    for site in range(8):
        np.testing.assert_array_equal(pool.column(site), matrix[:, site])
    for s in range(256):
        y = np.array([s >> i & 1 for i in range(8)], dtype=bool)
        assert pool.satisfied(y) == (matrix @ y >= least).all()


def test_rows_missed_and_exceeded_by_rounding_are_met():
    pool = CutPool(2, [cut_of([1, 1], 1)])
    assert pool.satisfied(np.array([1 - 5e-7, 0.0]))
    assert not pool.satisfied(np.array([1 - 2e-6, 0.0]))
    assert not pool.forbids(np.array([-1.0 - 5e-7])).any()
    assert pool.forbids(np.array([-1.0 - 2e-6])).all()
    pool.active[:] = False
    assert not pool.activate(np.array([1 - 5e-7, 0.0]))
    assert pool.activate(np.array([1 - 2e-6, 0.0]))
    assert pool.active.all()


@pytest.mark.parametrize(
    ("weights", "least", "hopeless"),
    [([1, 1], 3, True), ([1, 1], 2, False), ([2, -1], 2, False), ([2, -1], 2.5, True), ([-1, -1], -0.5, False)],
)
def test_a_cut_is_hopeless_when_its_positive_weights_are_not_enough(weights, least, hopeless):
    assert cut_of(weights, least).hopeless == hopeless
    assert not cut_of(weights, sum(max(w, 0) for w in weights) + 5e-7).hopeless


def test_the_same_columns_with_other_weights_or_another_least_are_another_cut():
    pool = CutPool(3, [cut_of([1, 1, 0], 1)])
    pool.add([cut_of([1, 2, 0], 1), cut_of([1, 1, 0], 2), cut_of([1, 1, 0], 1, (5, 5)), cut_of([1, 0, 1], 1)])
    assert len(pool.cuts) == len(pool.active) == 4
    assert pool.active.all()
    pool.add([cut_of([0, 1, 1], 1)], active=False)
    assert pool.active.tolist() == [True] * 4 + [False]
    active, least = pool.matrix[0][np.flatnonzero(pool.active)], pool.matrix[2][pool.active]
    np.testing.assert_array_equal(active.toarray(), [[1, 1, 0], [1, 2, 0], [1, 1, 0], [1, 0, 1]])
    np.testing.assert_array_equal(least, [1, 1, 2, 1])
    built = pool.matrix
    pool.add([cut_of([0, 1, 1], 1)])
    assert pool.matrix is built  # nothing new, nothing built anew


def joining(matrix, order, overlap, joined):
    """Which rows join in an order if each shares a column with at most so many that have joined."""
    load, found = np.zeros(matrix.shape[1], dtype=int), set(joined)
    for i in order:
        if not matrix[i].any() or load[matrix[i] != 0].max() <= overlap:
            found.add(i)
            load[matrix[i] != 0] += 1
    return found


def test_of_many_rows_short_ones_that_share_no_column_are_active_and_those_missed_most_join():
    rng = np.random.default_rng(0)
    matrix = (rng.random((600, 40)) < rng.choice([0.05, 0.1, 0.3], (600, 1))).astype(int)
    matrix[np.arange(600), rng.integers(0, 40, 600)] = 1
    matrix, least = np.unique(matrix, axis=0), None
    assert len(matrix) > 512
    least = rng.integers(1, 4, len(matrix))
    pool = pool_of(matrix, least)
    order = sorted(range(len(matrix)), key=lambda i: (matrix[i].sum(), i))
    begin = joining(matrix, order, 0, ())
    assert set(np.flatnonzero(pool.active).tolist()) == begin
    y = rng.random(40) * 0.3
    missing = least - matrix @ y
    order = sorted(
        (i for i in range(len(matrix)) if missing[i] > 1e-6 and i not in begin), key=lambda i: (-missing[i], i)
    )
    assert pool.activate(y)
    assert set(np.flatnonzero(pool.active).tolist()) == joining(matrix, order, 8, begin)
    few = pool_of(matrix[:512], least[:512])
    assert few.active.all()


# The relaxation


def relaxed(seed, step=0.0, fixed=(), m=14):
    rng = np.random.default_rng(seed)
    matrix = (rng.random((m, 9)) < 0.35).astype(int)
    matrix[np.arange(m), rng.integers(0, 9, m)] = 1
    cost = rng.uniform(1.0, 3.0, 9)
    caps = -np.ones((1, 9), dtype=int)
    mask = np.isin(np.arange(9), fixed)
    pools = pool_of(matrix, np.ones(m)), pool_of(caps, np.array([-7]))
    return Relaxation(cost, *pools, mask, step), np.concatenate([matrix, caps]), np.append(np.ones(m), -7.0)


@pytest.mark.parametrize("seed", range(4))
def test_the_optimum_is_that_of_the_dense_problem_in_whole_numbers_and_in_fractions(seed):
    found, matrix, least = relaxed(seed, fixed=[seed])
    low = found.fixed.astype(float)
    whole = milp(
        found.cost, integrality=np.ones(9), bounds=Bounds(low, 1), constraints=LinearConstraint(matrix, lb=least)
    )
    mine = found.optimum(np.inf, 9.0, whole=True)
    assert mine.solved
    assert mine.bound == pytest.approx(whole.fun)
    assert found.cost @ np.round(mine.y) == pytest.approx(whole.fun)
    assert not found.dearness.any()  # whole numbers have no reduced costs
    bounds = np.stack([low, np.ones(9)], axis=1)
    part = linprog(found.cost, A_ub=-matrix, b_ub=-least, bounds=bounds)
    mine = found.optimum(np.inf, 9.0, whole=False)
    assert mine.solved
    assert mine.bound == pytest.approx(part.fun)
    np.testing.assert_allclose(found.dearness, mine.bound + found.reduced)
    before = found.dearness.copy()
    for site in np.flatnonzero(~found.fixed).tolist():  # no layout with the site is cheaper
        bounds[site] = 1.0
        dear = linprog(found.cost, A_ub=-matrix, b_ub=-least, bounds=bounds)
        assert dear.status or before[site] <= dear.fun + 1e-7
        bounds[site] = low[site], 1.0
    found.dearness[:] = 100.0
    found.optimum(np.inf, 9.0, whole=False)
    np.testing.assert_array_equal(found.dearness, np.full(9, 100.0))  # what is known stays known


def test_what_nothing_satisfies_is_impossible_unless_sites_were_left_out():
    found, *_ = relaxed(0)
    found.rows.add([cut_of(np.ones(9), 8.0)])  # and at most seven
    assert found.optimum(50.0, 9.0, whole=True) == (None, 0.0, True, True)
    found.dearness[3] = 60.0
    assert found.optimum(50.0, 9.0, whole=True) == (None, 50.0, True, False)


@pytest.mark.parametrize("whole", [True, False])
def test_what_the_solver_could_not_finish_is_no_optimum(whole, monkeypatch):
    found, *_ = relaxed(0)
    limits, told = [], [None, -np.inf, 2.5]

    def unfinished(cost, rows_, least, low, high, time_limit, *, whole):
        limits.append(time_limit)
        return SimpleNamespace(status=1, x=np.full(9, 0.5), mip_dual_bound=told.pop(), fun=3.0)

    monkeypatch.setattr(cover_bounds, "_optimum", unfinished)
    for bound in (2.5 if whole else 0.0, 0.0, 0.0):
        y, mine, solved, impossible = found.optimum(np.inf, 7.0, whole=whole)
        assert (mine, solved, impossible) == (bound, False, False)
        np.testing.assert_array_equal(y, np.full(9, 0.5))
    assert limits == [7.0] * 3


@pytest.mark.parametrize(
    ("step", "best", "most"), [(1.0, 10.0, 9.5 + 1e-4), (0.0, 10.0, 10.0 + 1e-4), (2.0, 0.5, -0.5 + 1e-5)]
)
def test_sites_of_layouts_that_are_not_a_step_cheaper_are_not_worth_trying(step, best, most):
    found, *_ = relaxed(0, step, fixed=[4])
    found.dearness[:] = [most - 1e-7, most + 1e-7, most - 1.0, most + 1.0, most + 1.0, most, *[most + 2] * 3]
    assert np.flatnonzero(found.worth_trying(best)).tolist() in ([0, 2, 4, 5], [0, 2, 4])
    assert found.worth_trying(np.inf).all()


@pytest.mark.parametrize("size", [3, 0])
def test_the_sites_that_look_best_are_those_of_least_reduced_cost_and_all_that_are_there(size, monkeypatch):
    monkeypatch.setattr(cover_bounds, "_CORE_SITES", size)
    monkeypatch.setattr(cover_bounds, "_CORE_PER_ROW", 1)
    found, *_ = relaxed(0, fixed=[8])
    found.rows.active[:] = False
    found.rows.active[:2] = True
    found.reduced[:] = [5, 0.1, 3, 0.2, 0.3, 9, 9, 0.05, 9]
    found.dearness[7] = 40.0  # too dear for anything better
    y = np.zeros(9)
    y[5], y[6] = 0.5, 1e-9
    core = np.flatnonzero(found.core(y, 30.0)).tolist()
    assert core == ([1, 3, 4, 5, 8] if size else [1, 3, 5, 8])  # else as many as there are rows


def test_among_some_sites_the_best_is_found_with_what_is_kept():
    for seed in range(4):
        found, matrix, least = relaxed(seed, fixed=[0])
        sites, kept = np.arange(9) != 5, np.arange(9) == 7
        low, high = (found.fixed | kept).astype(float), (sites | kept).astype(float)
        limited = LinearConstraint(matrix, lb=least)
        whole = milp(found.cost, integrality=np.ones(9), bounds=Bounds(low, high), constraints=limited)
        y = found.among(sites, kept, 9.0)
        if whole.x is None:
            assert y is None
            continue
        assert y[[0, 7]].tolist() == [1.0, 1.0]
        assert y[5] == 0.0
        assert found.cost @ y == pytest.approx(whole.fun)
        np.testing.assert_array_equal(found.among(sites, y > 0.5, 9.0), y)  # nothing is open


def test_a_solver_that_fails_and_an_error_beside_the_main_thread_are_not_swallowed(monkeypatch):
    def fail():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        _interruptible(fail)
    assert _interruptible(lambda: 7) == 7
    monkeypatch.setattr(cover_bounds, "_interruptible", lambda work: SimpleNamespace(status=4, message="numbers"))
    found, *_ = relaxed(0)
    with pytest.raises(RuntimeError, match="could not solve the covering problem: numbers"):
        found.optimum(np.inf, 9.0, whole=True)


@pytest.mark.parametrize(
    ("cost", "step"),
    [([4, 6, 10], 2.0), ([3, 5], 1.0), ([0, 3, 6], 3.0), ([1.5, 3], 0.0), ([], 0.0), ([1e9, 2], 0.0), ([9e8], 9e8)],
)
def test_costs_have_a_step_in_common_when_they_are_whole_numbers(cost, step):
    assert common_step(np.array(cost, dtype=float)) == step


# The local search


class Watched(LocalSearch):
    """A local search in which after every move all that is kept up to date is counted anew."""

    adds, stuck, step = 0, False, 0

    def check(self):
        dense = self.rows.toarray()
        short = self.least - dense @ self.y
        np.testing.assert_allclose(self.short, short, atol=1e-9)
        np.testing.assert_array_equal(self.missed, short > 1e-6)
        assert self.paid == pytest.approx(self.cost @ self.y)
        after = short[:, None] + dense * np.where(self.y, 1, -1)
        worth = (self.heavy[:, None] * (np.maximum(short, 0)[:, None] - np.maximum(after, 0))).sum(axis=0)
        np.testing.assert_allclose(self.worth, worth, atol=1e-7)

    def _remove(self, step, tabu):
        assert tabu == (3 if self.missed.any() else 0)
        if step > self.step and self.step and self.missed.any():  # as many came as could, but twenty at most
            assert self.stuck or self.adds == 20
        assert step >= self.step
        self.adds, self.stuck, self.step = 0, False, step
        here = np.flatnonzero(self.y & self.free)
        rested = here[self.moved[here] < step - tabu] if tabu else here
        self.allowed = [rested if len(rested) else here]
        return super()._remove(step, tabu)

    def _add(self, step, under):
        dense = self.rows.toarray()
        cost = np.where(self.y, -self.cost, self.cost)  # of putting it in, or taking it out where that helps
        able = self.free & self.may_come & (self.paid + cost < under - 1e-6)
        helps = np.where(self.y, dense < 0, dense > 0) & able
        self.allowed = [np.flatnonzero(helps[r]) for r in np.flatnonzero(self.missed)]
        done = super()._add(step, under)
        self.adds, self.stuck = self.adds + 1, not done
        assert done or not all(len(some) for some in self.allowed)
        return done

    def _flip(self, column, step):
        worth, was = self.worth / self.cost, self.y.copy()
        tops = [[c for c in some if worth[c] >= worth[some].max() - 1e-9] for some in self.allowed if len(some)]
        # of most worth per cost, of those the one that has rested longest, of those the first
        assert column in [min(top, key=lambda c: (self.moved[c], c)) for top in tops]
        super()._flip(column, step)
        assert np.flatnonzero(self.y != was).tolist() == [column]
        assert self.moved[column] == step
        assert self.may_come[column] == self.y[column]
        shares = (self.rows.toarray()[self.rows.toarray()[:, column] != 0] != 0).any(axis=0)
        assert self.may_come[shares & (np.arange(len(was)) != column)].all()
        self.check()


@pytest.mark.parametrize("seed", range(5))
def test_a_local_search_keeps_count_and_always_makes_the_best_move(seed):
    rng = np.random.default_rng(seed)
    matrix = np.where(rng.random((18, 12)) < 0.3, rng.integers(1, 3, (18, 12)), 0).astype(float)
    matrix[np.arange(18), rng.integers(0, 12, 18)] = 1.0
    least = np.minimum(rng.integers(1, 3, 18), matrix.sum(axis=1))
    cost, free = rng.integers(1, 5, 12).astype(float), rng.random(12) < 0.9
    matrix = np.concatenate([matrix, -(rng.random((2, 12)) < 0.4).astype(float)])  # the last two are caps
    least = np.append(least, [-4.0, -12.0])
    start = milp(
        np.ones(12), integrality=np.ones(12), bounds=Bounds(~free, 1), constraints=LinearConstraint(matrix, lb=least)
    )
    search = Watched(cost, csr_array(matrix), least, free, seed)
    found = search.improve(start.x > 0.5, np.inf, patience=60)
    assert (matrix @ found >= least).all()
    assert found[~free].all()
    low = (~free).astype(float)
    whole = milp(cost, integrality=np.ones(12), bounds=Bounds(low, 1), constraints=LinearConstraint(matrix, lb=least))
    assert cost @ found <= 1.15 * whole.fun
    # what has been missed at the end of a step is heavier by one for every such step
    assert (search.heavy >= 1).all()
    assert (search.heavy == np.round(search.heavy)).all()
    assert search.heavy.max() > 1


def test_a_local_search_stops_at_the_goal_in_time_and_where_nothing_may_go(monkeypatch):
    matrix, start = csr_array(np.ones((1, 4))), np.ones(4, dtype=bool)

    def search(free=(True,) * 4):
        return LocalSearch(np.ones(4), matrix, np.ones(1), np.array(free), 0)

    assert search().improve(start, np.inf, goal=4.0).sum() == 4
    assert search().improve(start, np.inf, goal=1.0).sum() == 1
    assert search().improve(start, np.inf, patience=0).sum() == 4
    assert search((False,) * 4).improve(start, np.inf).sum() == 4
    assert start.all()
    looks = []

    def monotonic():
        looks.append(None)
        return 5.0 * len(looks)

    monkeypatch.setattr(cover_bounds, "time", SimpleNamespace(monotonic=monotonic))
    late = search()
    assert late.improve(start, 12.0, goal=0.0).sum() == 1
    assert len(looks) == 3
    assert late.heavy.tolist() == [3 * 64.0]  # missed in every step but the first and the last


def test_rows_that_stay_missed_grow_heavier_by_one_a_step():
    search = LocalSearch(np.array([1.0, 5.0]), csr_array(np.array([[1.0, 1.0]])), np.ones(1), np.ones(2, dtype=bool))
    search.improve(np.array([True, False]), np.inf, patience=4)
    assert search.heavy.tolist() == [5.0]  # one of cost 1 holds, and nothing cheaper does, four times


def test_a_column_is_taken_out_where_that_mends_a_cap_though_nothing_dearer_may_come():
    caps = csr_array(np.array([[-1.0, -1.0]]))
    search = LocalSearch(np.array([1.0, 2.0]), caps, -np.ones(1), np.ones(2, dtype=bool))
    search._begin(np.ones(2, dtype=bool))
    assert search._add(1, 2.5)
    assert search.y.tolist() == [False, True]  # what gives most per cost
    assert search.paid == 2.0


def test_nothing_comes_where_nothing_helps_and_any_row_that_is_missed_may_be_the_one_that_is_mended():
    half = LocalSearch(np.ones(1), csr_array(np.array([[0.5]])), np.ones(1), np.ones(1, dtype=bool))
    half._begin(np.ones(1, dtype=bool))
    assert not half._add(1, 9.0)
    came = set()
    for seed in range(20):
        apart = LocalSearch(np.ones(3), csr_array(np.eye(3)), np.ones(3), np.ones(3, dtype=bool), seed)
        apart._begin(np.zeros(3, dtype=bool))
        assert apart._add(1, 9.0)
        came |= set(np.flatnonzero(apart.y).tolist())
    assert came == {0, 1, 2}


def test_the_solver_works_beside_the_main_thread_for_as_long_as_it_may(monkeypatch):
    assert _interruptible(lambda: threading.current_thread().daemon)  # nothing waits for it at the end
    limits = []

    def stopped(*_, options, **__):
        limits.append(options["time_limit"])
        return SimpleNamespace(status=1, x=None, mip_dual_bound=None)

    monkeypatch.setattr("scipy.optimize.milp", stopped)
    found, *_ = relaxed(0)
    for seconds in (7.0, -1.0):
        assert found.optimum(np.inf, seconds, whole=True) == (None, 0.0, False, False)
    assert limits == [7.0, 0.05]
