"""Every step of the covering search by a law or a plain second way to do it, by a clock that the test holds."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, linprog, milp

from driftplan.layouts.placement import covering
from driftplan.layouts.placement.cover_bounds import Solution
from driftplan.layouts.placement.covering import _CoverSearch, cheapest_cover
from driftplan.layouts.placement.cut_pool import Cut, CutPool
from driftplan.planning.status import Status


class Clock:
    """Stands for the module `time`; goes on by ``tick`` whenever it is looked at."""

    def __init__(self):
        self.now, self.tick = 1000.0, 0.0

    def monotonic(self):
        self.now += self.tick
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(covering, "time", clock)
    return clock


def cuts_of(matrix, least):
    """A cut for every row of a matrix."""
    return [
        Cut(np.flatnonzero(row), row[np.flatnonzero(row)].astype(float), float(want), (0, i))
        for i, (row, want) in enumerate(zip(matrix, least, strict=True))
    ]


class Rows:
    """Accepts what meets all rows, and says the first that is missed; keeps what it was asked."""

    def __init__(self, matrix, least):
        self.matrix, self.least, self.all, self.asked = matrix, least, cuts_of(matrix, least), []

    def cuts(self, chosen, near=None):
        self.asked.append(chosen.copy())
        return [self.all[i] for i in np.flatnonzero(self.matrix @ chosen < self.least)[:1].tolist()]

    def accepts(self, chosen):
        return bool((self.matrix @ chosen >= self.least).all())


def random_rows(seed, rows=14, n=9, most=3):
    rng = np.random.default_rng(seed)
    matrix = np.where(rng.random((rows, n)) < 0.4, rng.integers(1, 3, (rows, n)), 0)
    matrix[np.arange(rows), rng.integers(0, n, rows)] = 1
    return Rows(matrix, np.minimum(rng.integers(1, most + 1, rows), matrix.sum(axis=1))), rng


def neighbours(seed, rows=60, n=40):
    """Rows that each want one of a few neighbouring sites: a matrix whose linear relaxation is whole by itself."""
    rng = np.random.default_rng(seed)
    matrix = np.zeros((rows, n), dtype=int)
    for row, first in zip(matrix, rng.integers(0, n - 6, rows).tolist(), strict=True):
        row[first : first + int(rng.integers(2, 6))] = 1
    return Rows(matrix, np.ones(rows)), rng.integers(1, 5, n) / 2.0 + 0.25


def odd_ring(n, cost=None):
    """One of every two neighbours on a ring of an odd number: fractions of a half are cheaper than any layout."""
    matrix = np.eye(n, dtype=int) + np.roll(np.eye(n, dtype=int), 1, axis=1)
    return Rows(matrix, np.ones(n)), np.ones(n) if cost is None else cost


def search_of(cost, oracle, *, known=None, caps=(), fixed=(), separate=None, limit=100.0, progress=lambda *_: None):
    """A search that knows the rows ``known`` (all: None) of its oracle."""
    mask = np.zeros(len(cost), dtype=bool)
    mask[list(fixed)] = True
    rows = CutPool(len(cost), oracle.all if known is None else [oracle.all[i] for i in known])
    return _CoverSearch(cost, oracle, rows, CutPool(len(cost), caps), mask, separate, limit, progress)


def those(n, *sites):
    return np.isin(np.arange(n), sites)


def least_cost(matrix, least, cost, low=0.0):
    rows = LinearConstraint(matrix, lb=least)
    return milp(cost, integrality=np.ones(len(cost)), bounds=Bounds(low, 1), constraints=rows).fun


def at_most(n, sites, k):
    return Cut(np.array(sites), -np.ones(len(sites)), -float(k))


# Bounds and what is told


def test_bounds_only_rise_to_what_costs_can_be_and_every_news_is_told(clock):
    oracle, _ = odd_ring(5)
    told = []
    search = search_of(np.full(5, 2.0), oracle, progress=lambda *news: told.append(news))
    clock.now += 7.0
    for bound, known in ((3.1, 4.0), (4.0 + 1e-7, 4.0), (4.0, 4.0), (1.0, 4.0), (4.1, 6.0)):
        search._raise_bound(bound)
        assert search.bound == known
    assert told == [(7.0, np.inf, 4.0), (7.0, np.inf, 6.0)]
    search = search_of(np.array([0.5, 0.3, 1.0, 1.0, 1.0]), oracle)
    search._raise_bound(0.71)
    assert search.bound == 0.71


def test_no_bound_above_the_best_cost_is_told_or_handed_back(clock):
    oracle, cost = odd_ring(5)
    told = []
    search = search_of(cost, oracle, progress=lambda *news: told.append(news))
    search._accept(those(5, 0, 2, 4))
    search._raise_bound(9.0)
    assert told == [(0.0, 3.0, 0.0), (0.0, 3.0, 3.0)]
    assert search._result(Status.TIME_LIMIT).lower_bound == 3.0
    search.bound = 1.0
    assert search._result(Status.TIME_LIMIT).lower_bound == 1.0
    assert search._result(Status.OPTIMAL).lower_bound == 3.0


@pytest.mark.parametrize(
    ("cost", "bound", "closed"),
    [
        *((3.0, 3.0, True), (3.0, 3.0 - 1e-6, False), (1e9, 1e9 - 0.5, True), (1e9, 1e9 - 5.0, False)),
        *((1e-3, 1e-3 - 2e-12, True), (1e-3, 1e-3 - 1e-7, False), (3.0, 4.0, True), (3.0, 0.0, False)),
    ],
)
def test_bound_and_cost_meet_but_for_rounding(cost, bound, closed):
    oracle, ring = odd_ring(5)
    search = search_of(ring, oracle)
    search.bound = bound
    assert not search._closed()  # nothing is closed before there is a layout
    search.best, search.best_cost = those(5, 0), cost
    assert search._closed() == closed


def test_only_a_cheaper_layout_is_taken_and_it_is_a_copy():
    oracle, cost = odd_ring(5)
    search, mine = search_of(cost, oracle), those(5, 0, 1, 2, 3)
    search._accept(mine)
    mine[:] = True
    for worse in (those(5, 0, 1, 2, 4), those(5, 0, 1, 2, 3, 4)):
        search._accept(worse)
        np.testing.assert_array_equal(search.best, those(5, 0, 1, 2, 3))
    search._accept(those(5, 0, 2, 4))
    assert search.best_cost == 3.0


def test_bounds_told_on_the_way_are_never_above_the_least_cost():
    for seed in range(4):
        oracle, cost = neighbours(seed)
        told = []
        found = cheapest_cover(cost, oracle, demands=oracle.all, progress=lambda *news, told=told: told.append(news))
        assert found.cost == pytest.approx(least_cost(oracle.matrix, oracle.least, cost))
        assert all(bound <= found.cost + 1e-9 for _, _, bound in told)
        assert all(now <= then for (_, _, now), (_, _, then) in pairwise(told))


# Layouts made greedily


def greedy(oracle, caps, cost, fixed, lean):
    """The same by plain arrays: the sites in the order in which they come, and whether all rows are met."""
    price, chosen, order = cost if lean is None else cost * (1.01 - lean), fixed.copy(), []
    matrix, least = oracle.matrix, oracle.least
    while (matrix @ chosen < least).any():
        missing = np.maximum(least - matrix @ chosen, 0)
        worth = np.minimum(matrix, missing[:, None]).sum(axis=0) / price
        for i in range(len(cost)):
            more = chosen | those(len(cost), i)
            if chosen[i] or any(cut.weights @ more[cut.columns] < cut.least for cut in caps):
                worth[i] = 0.0
        if worth.max() <= 0:
            return order, False
        order.append(int(worth.argmax()))
        chosen[order[-1]] = True
    return order, True


@pytest.mark.parametrize("seed", range(12))
def test_rows_are_covered_by_the_site_of_most_gain_per_price_that_the_caps_allow(seed):
    oracle, rng = random_rows(seed)
    cost, n = rng.uniform(0.1, 5.0, 9) * 10.0 ** -(seed % 3), 9
    caps = [at_most(n, range(n), 4 + seed % 5), at_most(n, [0, 1, 2], 2)]
    fixed = those(n, seed % n)
    for lean in (None, rng.random(n)):
        chosen = fixed.copy()
        order, done = greedy(oracle, caps, cost, fixed, lean)
        assert search_of(cost, oracle, caps=caps)._cover_rows(chosen, lean) == done
        np.testing.assert_array_equal(chosen, fixed | those(n, *order))


def test_a_layout_is_made_of_the_start_or_of_the_fixed_sites_where_the_start_breaks_a_cap(clock):
    oracle, cost = odd_ring(5)
    search = search_of(cost, oracle, caps=[at_most(5, [0, 1], 1)], fixed=[3])
    search._complete(those(5, 0, 1, 3))
    assert search.best_cost == 3.0
    assert search.best[3]
    assert search.best[:2].sum() == 1
    search = search_of(cost, oracle, caps=[at_most(5, [3], 0)], fixed=[3])
    search._complete(those(5, 0, 3))
    assert search.best is None
    assert oracle.asked[-1][3]  # of the search before: nothing was asked about what breaks a cap


def test_a_layout_is_made_and_pruned_though_the_oracle_tells_rows_one_by_one():
    for seed in range(6):
        oracle, rng = random_rows(seed)
        search = search_of(rng.integers(1, 4, 9).astype(float), oracle, known=[])
        search._complete(np.zeros(9, dtype=bool))
        assert oracle.accepts(search.best)
        for site in np.flatnonzero(search.best).tolist():
            assert not oracle.accepts(search.best & ~those(9, site))


def test_when_time_is_over_a_first_layout_is_given_up_and_an_accepted_one_is_not_pruned(clock):
    oracle, cost = odd_ring(5)
    search = search_of(cost, oracle, known=[], limit=10.0)
    clock.now += 10.5
    search._complete(np.zeros(5, dtype=bool))
    assert search.best is None
    assert len(oracle.asked) == 1
    search._complete(np.ones(5, dtype=bool))
    assert search.best_cost == 5.0


def test_a_further_layout_gets_a_share_of_the_time_left(clock):
    oracle, cost = odd_ring(5)
    search = search_of(cost, oracle, known=[], limit=100.0)
    search._accept(np.ones(5, dtype=bool))
    clock.tick = 3.0
    search._complete(np.zeros(5, dtype=bool))
    assert search.best_cost == 5.0  # of 100 s it has ten, of which three are over at the first look, and so on
    assert 2 <= len(oracle.asked) <= 4
    clock.tick = 1.0
    search._complete(np.zeros(5, dtype=bool))
    assert search.best_cost == 3.0


def test_the_dearest_go_first_and_then_the_last_and_fixed_ones_stay():
    oracle = Rows(np.ones((1, 6), dtype=int), np.array([2]))
    search = search_of(np.array([1.0, 2.0, 1.0, 1.0, 3.0, 0.5]), oracle, fixed=[4])
    np.testing.assert_array_equal(search._pruned(np.ones(6, dtype=bool)), those(6, 4, 5))
    search = search_of(np.ones(6), oracle)
    start = those(6, 1, 2, 3, 5)
    np.testing.assert_array_equal(search._pruned(start), those(6, 1, 2))
    assert start.sum() == 4  # what is pruned is a copy


def test_pruning_stops_when_time_is_over_with_a_layout_that_is_accepted(clock):
    oracle = Rows(np.ones((1, 6), dtype=int), np.array([2]))
    search = search_of(np.ones(6), oracle, limit=10.0)
    clock.now += 11.0
    np.testing.assert_array_equal(search._pruned(np.ones(6, dtype=bool)), those(6, 0, 1, 2, 3, 4))


# Ties


@pytest.mark.parametrize("seed", range(8))
def test_stand_ins_are_the_equally_dear_sites_before_that_do_instead(seed):
    oracle, rng = random_rows(seed)
    cost = rng.integers(1, 3, 9).astype(float)
    search = search_of(cost, oracle)
    search._complete(np.zeros(9, dtype=bool))
    for chosen in (search.best, np.ones(9, dtype=bool) & ~those(9, 0, 3, 5)):
        if not oracle.accepts(chosen):
            continue
        for site in np.flatnonzero(chosen).tolist():
            others = [i for i in range(site) if not chosen[i] and cost[i] == cost[site]]
            do = [i for i in others if oracle.accepts((chosen & ~those(9, site)) | those(9, i))]
            assert search._stand_ins(chosen, site) == do


@pytest.mark.parametrize("seed", range(10))
def test_no_equally_dear_site_listed_earlier_could_stand_in_for_one_of_the_cheapest_layout(seed):
    oracle, rng = random_rows(seed, rows=8)
    n, cost, cap = 9, rng.integers(1, 3, 9).astype(float), at_most(9, [0, 1, 2], 1 + seed % 2)
    fixed = [int(rng.integers(n))]
    demands = oracle.all[:4]
    found = cheapest_cover(cost, oracle, demands=demands, caps=[cap], fixed=those(n, *fixed))
    if found.chosen is None:
        return
    assert found.chosen[fixed].all()
    for site in np.flatnonzero(found.chosen & ~those(n, *fixed)).tolist():
        for other in range(site):
            trial = (found.chosen & ~those(n, site)) | those(n, other)
            same = not found.chosen[other] and cost[other] == cost[site]
            assert not (same and oracle.accepts(trial) and cap.weights @ trial[cap.columns] >= cap.least)


def test_ties_are_left_as_they_are_when_time_is_over(clock):
    oracle = Rows(np.ones((1, 6), dtype=int), np.array([2]))
    search = search_of(np.ones(6), oracle, limit=10.0)
    search.best = those(6, 4, 5)
    clock.now += 11.0
    search._settle()
    np.testing.assert_array_equal(search.best, those(6, 4, 5))
    assert not oracle.asked
    clock.now -= 2.5
    clock.tick = 1.0  # one look before the time is over, one behind

    class Stubborn(Rows):
        def cuts(self, chosen, near=None):
            self.asked.append(chosen)
            return [self.all[0]]

    search.oracle = Stubborn(oracle.matrix, oracle.least)
    search._settle()
    assert len(search.oracle.asked) == 2  # one other site for each of the two, where four would be worth asking about


# The master


def test_the_master_alone_finds_the_optimum_and_its_bound(monkeypatch):
    monkeypatch.setattr(_CoverSearch, "_complete", lambda *_, **__: None)
    monkeypatch.setattr(_CoverSearch, "_confine", lambda *_, **__: False)
    for seed in range(4):
        oracle, rng = random_rows(seed)
        cost = rng.uniform(1.0, 2.0, 9)
        found = cheapest_cover(cost, oracle)
        best = least_cost(oracle.matrix, oracle.least, cost)
        assert (found.cost, found.lower_bound) == pytest.approx((best, best))
        assert found.status is Status.OPTIMAL
        assert found.rounds > 1


def test_the_master_has_all_the_time_or_a_share_while_there_is_something_else_to_try(clock):
    oracle, cost = odd_ring(5)
    search, limits = search_of(cost, oracle, limit=100.0), []

    def optimum(best_cost, seconds, *, whole):
        limits.append((seconds, whole))
        return Solution(None, 2.5, False)

    search.relaxation.optimum = optimum
    assert not search._round()
    search.core = np.ones(5, dtype=bool)
    search._round()
    assert limits == [(100.0, True), (pytest.approx(10.0), True)]
    assert search.rounds == 2
    assert search.bound == 3.0
    assert search._left() == 100.0
    assert search_of(cost, oracle, limit=1e9)._left() == 600.0


@pytest.mark.parametrize("solved", [True, False])
def test_a_layout_of_the_master_that_is_accepted_is_a_bound_only_if_nothing_can_be_cheaper(solved):
    oracle, cost = odd_ring(5, np.array([1.0, 0.4, 1.0, 0.4, 1.0]))
    search = search_of(cost, oracle)
    search.relaxation.optimum = lambda *_, whole: Solution(those(5, 1, 3, 4).astype(float), 0.9, solved)
    assert search._round() == solved
    assert search.best_cost == pytest.approx(1.8)
    assert search.bound == pytest.approx(1.8 if solved else 0.9)


def test_a_layout_of_the_master_that_is_rejected_is_completed():
    oracle, cost = odd_ring(5)
    search = search_of(cost, oracle, known=[])
    search.relaxation.optimum = lambda *_, whole: Solution(those(5, 0).astype(float), 1.0, True)
    assert search._round()
    assert search.best_cost == 3.0
    assert search.bound == 1.0
    assert search.best[0]


def test_what_no_layout_meets_is_impossible_and_the_cut_to_blame_is_the_first():
    oracle = Rows(np.array([[1, 1, 0], [0, 1, 1]]), np.array([3, 4]))
    search = search_of(np.ones(3), oracle, known=[])
    assert search._judge(np.zeros(3, dtype=bool))
    first = search.hopeless
    assert search.impossible
    assert first is oracle.all[0]
    oracle.matrix, oracle.least = oracle.matrix[1:], oracle.least[1:]
    oracle.all = oracle.all[1:]
    search._judge(np.zeros(3, dtype=bool))
    assert search.hopeless is first
    together = Rows(np.array([[1, 1, 0], [0, 0, 1]]), np.array([1, 1]))
    found = cheapest_cover(np.ones(3), together, demands=together.all, caps=[at_most(3, [0, 1, 2], 1)])
    assert found.status is Status.INFEASIBLE
    assert found.hopeless is None


def test_where_the_linear_relaxation_is_whole_no_master_is_needed():
    for seed in range(4):
        oracle, cost = neighbours(seed)
        cost = np.ceil(cost)
        found = cheapest_cover(cost, oracle, demands=oracle.all)
        assert found.rounds == 0
        assert found.lower_bound == found.cost == pytest.approx(least_cost(oracle.matrix, oracle.least, cost))


def test_cuts_that_only_fractions_violate_close_the_gap_without_the_master():
    n = 9
    oracle, _ = odd_ring(n)
    cost = 100.0 + np.arange(n)
    asked = []

    def separate(y):
        asked.append(y)
        return [Cut(np.arange(n), np.ones(n), 5.0)]  # of an odd ring of nine, five

    plain = cheapest_cover(cost, oracle, demands=oracle.all)
    found = cheapest_cover(cost, oracle, demands=oracle.all, separate=separate)
    assert plain.rounds > 0
    assert found.rounds == 0
    assert found.cost == plain.cost == pytest.approx(least_cost(oracle.matrix, oracle.least, cost))
    assert all((y >= -1e-9).all() and (oracle.matrix @ y >= 1 - 1e-6).all() for y in asked)


def test_the_linear_relaxation_meets_every_row_and_its_bound_is_that_of_linprog(monkeypatch):
    monkeypatch.setattr(_CoverSearch, "_confine", lambda *_, **__: False)
    for seed in range(3):
        oracle, rng = random_rows(seed, rows=700, n=30)  # more than the relaxation begins with
        cost = rng.uniform(1.0, 3.0, 30)
        search = search_of(cost, oracle)
        search._tighten()
        exact = linprog(cost, A_ub=-oracle.matrix, b_ub=-oracle.least, bounds=(0, 1)).fun
        assert exact * (1 - 2e-5) <= search.bound <= exact
        assert search.core is not None
        assert oracle.accepts(search.best)


def test_separation_goes_on_only_while_it_brings_cuts_that_are_violated():
    oracle, cost = odd_ring(5)
    search = search_of(cost, oracle)
    half = np.full(5, 0.5)
    assert not search._separated(half)  # nothing separates
    fresh = [Cut(np.array([0, 1, 2]), np.ones(3), 1.0), Cut(np.array([0, 2, 4]), np.ones(3), 1.0)]
    told = iter([[fresh[0]], [fresh[1]], [fresh[1]], []])
    search.separate = lambda y: next(told)
    assert not search._separated(half)  # two that are not violated, then nothing new
    assert next(told) == []
    search.separate = lambda y: [Cut(np.arange(5), np.ones(5), 3.0)]
    assert search._separated(half)
    assert not search._separated(half)  # active by now


def test_layouts_are_made_of_what_a_fractional_one_has_whole_and_of_all_it_has_any_of(monkeypatch):
    oracle, cost = odd_ring(6)
    search, asked = search_of(cost, oracle, fixed=[5]), []
    monkeypatch.setattr(search, "_complete", lambda start, lean: asked.append((start.tolist(), lean.tolist())))
    monkeypatch.setattr(search, "_confine", lambda sites, share: asked.append((sites.tolist(), share)))
    y = np.array([1.0, 0.9995, 0.99, 2e-6, 1e-7, 0.0])
    search._round_up(y, 0.3)
    whole, some = those(6, 0, 1, 5).tolist(), those(6, 0, 1, 2, 3, 5).tolist()
    assert asked == [(whole, y.tolist()), (some, 0.3)]
    search.best, search.best_cost = those(6, 0), 0.0
    search._round_up(y, 0.3)
    assert len(asked) == 2  # nothing is cheaper


# Looking closely at a few sites


def test_among_some_sites_the_cheapest_layout_is_found_and_nothing_else_is_used():
    for seed in range(6):
        oracle, rng = random_rows(seed, most=2)
        cost = rng.uniform(1.0, 2.0, 9)
        sites = np.ones(9, dtype=bool) & ~those(9, seed, (seed + 4) % 9)
        search = search_of(cost, oracle, known=range(4), fixed=[(seed + 1) % 9])
        first = search._confine(sites, 1.0)
        if not oracle.accepts(sites):
            assert not first
            continue
        assert first
        low = search.fixed.astype(float)
        most = np.where(sites | search.fixed, 1.0, 0.0)
        whole = milp(
            cost,
            integrality=np.ones(9),
            bounds=Bounds(low, most),
            constraints=LinearConstraint(oracle.matrix, lb=oracle.least),
        )
        assert search.best_cost == pytest.approx(whole.fun)
        assert not (search.best & ~(sites | search.fixed)).any()
        assert not search._confine(sites, 1.0)  # nothing cheaper


def test_the_best_and_what_is_kept_are_among_the_sites_looked_at():
    oracle, cost = odd_ring(5)
    search = search_of(cost, oracle)
    search._accept(those(5, 0, 1, 2, 3))
    assert search._confine(those(5, 4), 1.0, those(5, 1))
    assert search.best_cost == 3.0
    assert search.best[1]


def test_a_closer_look_takes_its_share_of_the_time_and_what_it_has_is_completed(clock):
    oracle, cost = odd_ring(5)
    search, limits = search_of(cost, oracle, known=[0], limit=100.0), []
    among = search.relaxation.among

    def look(sites, kept, seconds):
        limits.append(seconds)
        clock.now += 30.0
        return among(sites, kept, 10.0)

    search.relaxation.among = look
    assert not search._confine(np.ones(5, dtype=bool), 0.2)
    assert limits == [20.0]
    assert search.best_cost == 3.0
    clock.now += 100.0
    assert not search._confine(np.ones(5, dtype=bool), 0.2)
    assert limits == [20.0]


class Scripted:
    """Stands for `LocalSearch`: gives what the test says, and keeps what it was asked."""

    def __init__(self, *found):
        self.found, self.calls = list(found), []

    def __call__(self, cost, rows, least, free, seed=0):
        self.made = cost, rows.toarray(), least, free
        return self

    def improve(self, start, deadline, goal=0.0, patience=0):
        self.calls.append((start.copy(), deadline, goal, patience))
        return self.found.pop(0) if self.found else start


def test_a_local_search_has_the_rows_the_caps_the_best_and_a_share_of_the_time(clock, monkeypatch):
    oracle, cost = odd_ring(5)
    search = search_of(cost, oracle, caps=[at_most(5, [0, 1, 2], 3)], fixed=[0], limit=100.0)
    search._accept(those(5, 0, 1, 2, 3))
    search.bound = 2.0
    monkeypatch.setattr(covering, "LocalSearch", scripted := Scripted())
    search._improve_locally(those(5, 0, 3, 4))
    costs, rows, least, free = scripted.made
    np.testing.assert_array_equal(costs, np.ones(5))
    np.testing.assert_array_equal(rows, [*oracle.matrix, [-1, -1, -1, 0, 0]])
    np.testing.assert_array_equal(least, [1, 1, 1, 1, 1, -3])
    np.testing.assert_array_equal(free, ~those(5, 0))
    ((start, *rest),) = scripted.calls  # what finds nothing is not asked twice
    np.testing.assert_array_equal(start, those(5, 0, 1, 2, 3))
    assert rest == [clock.now + 10.0, 2.0, 150]


def test_a_local_search_goes_on_from_what_is_refused_and_asks_for_little_less(clock, monkeypatch):
    n = 7
    oracle, cost = odd_ring(n)
    everything = np.ones(n, dtype=bool)
    search = search_of(cost, oracle, known=range(n - 1))
    search._accept(everything)
    found = [those(n, 0, 1, 2, 3, 4, 5), those(n, 1, 3, 5), those(n, 0, 2, 4, 6)]  # the second misses a row not known
    monkeypatch.setattr(covering, "LocalSearch", scripted := Scripted(*found))
    search.bound = 2.0
    search._improve_locally(everything)
    assert search.best_cost == 4.0
    assert len(search.rows.cuts) == n
    starts, _, goals, _ = zip(*scripted.calls, strict=True)
    assert goals[:4] == (2.0, 2.0, 5.0, 3.0)
    np.testing.assert_array_equal(starts[1], found[0])
    assert (starts[2] >= found[1]).all()
    assert search.rows.satisfied(starts[2])  # it is mended
    assert starts[2].sum() == 4
    np.testing.assert_array_equal(starts[3], found[2])
    assert len(scripted.calls) == 3 + covering._PATIENCE
    search.bound = 4.0
    search._improve_locally(everything)  # no more where bound and cost meet
    search.bound = 0.0
    clock.now += 200.0
    search._improve_locally(everything)  # or time is over
    assert len(scripted.calls) == 3 + covering._PATIENCE


@pytest.mark.parametrize("caps", [(), [at_most(7, range(7), 3)]])
def test_what_cannot_be_mended_is_given_up_for_the_best(caps, clock, monkeypatch):
    oracle, cost = odd_ring(7)
    search = search_of(cost, oracle, known=range(6), caps=caps)
    search._accept(those(7, 0, 2, 4, 6))
    monkeypatch.setattr(covering, "LocalSearch", scripted := Scripted(those(7, 1, 3, 5)))
    search._improve_locally(np.ones(7, dtype=bool))
    assert (scripted.calls[1][0] == search.best).all() == bool(caps)


# The order of the steps


class Told(_CoverSearch):
    """A search whose steps do what the test says, by name, and are noted with what they were given."""

    def follow(self, **effects):
        self.notes, self.effects = [], effects
        for name in ("_complete", "_tighten", "_improve_locally", "_reopen", "_confine", "_round", "_settle"):
            setattr(self, name, lambda *given, name=name, **_: self._note(name, given))
        return self

    def _note(self, name, given):
        self.notes.append((name, *(tuple(np.flatnonzero(x)) if isinstance(x, np.ndarray) else x for x in given)))
        return self.effects[name](*given) if name in self.effects else None

    def names(self):
        return [name for name, *_ in self.notes]


def told(n=10, fixed=(), limit=100.0, **effects):
    """A search over ``n`` sites of cost 1; fractions prove a bound of 2."""
    oracle, cost = odd_ring(n)
    mask = np.zeros(n, dtype=bool)
    mask[list(fixed)] = True
    search = Told(cost, oracle, CutPool(n, []), CutPool(n, []), mask, None, limit, lambda *_: None)
    search.relaxation.optimum = lambda *_, whole: Solution(None, 2.0, True)
    return search.follow(**effects)


def accepting(search, cost):
    search.best, search.best_cost = those(search.n, *range(int(cost))), cost


def test_a_hint_is_completed_and_the_fixed_sites_only_where_that_fails():
    search = told(fixed=[7], _complete=lambda start: accepting(search, 2.0))
    assert search.run(those(10, 1, 2), False).cost == 2.0
    assert search.notes == [("_complete", (1, 2, 7)), ("_settle",)]
    search = told(fixed=[7], _complete=lambda start: start[1] or accepting(search, 2.0))
    search.run(those(10, 1, 2), False)
    assert search.notes == [("_complete", (1, 2, 7)), ("_complete", (7,)), ("_settle",)]
    search = told(fixed=[7], _complete=lambda start: None, _tighten=lambda: accepting(search, 2.0))
    search.run(None, False)
    assert search.notes == [("_complete", (7,)), ("_tighten",), ("_settle",)]


def test_who_wants_any_layout_waits_for_no_bound():
    search = told(_complete=lambda start: accepting(search, 5.0))
    search.relaxation.optimum = None  # not asked
    assert search.run(None, True).status is Status.GOOD_ENOUGH
    assert search.names() == ["_complete"]
    search = told(_round=lambda: accepting(search, 5.0))
    assert search.run(None, True).status is Status.GOOD_ENOUGH
    assert search.names() == ["_complete", "_tighten", "_round"]
    search = told(_round=lambda: accepting(search, 5.0) or search._raise_bound(5.0))
    assert search.run(None, False).status is Status.OPTIMAL
    assert search.names() == ["_complete", "_tighten", "_round", "_settle"]


@pytest.mark.parametrize(
    ("cost", "core", "looks"), [(5.0, (1, 2), True), (2.1, (1, 2), False), (5.0, None, False), (2.0, (1, 2), False)]
)
def test_sites_that_look_best_are_looked_at_closely_at_once_where_the_cost_is_far_above_the_bound(cost, core, looks):
    def tighten():
        accepting(search, cost)
        search.core = None if core is None else those(10, *core)

    search = told(_tighten=tighten, _round=lambda: search._raise_bound(cost) or True)
    assert search.run(None, False).cost == cost
    closely = [("_improve_locally", (1, 2), 0.25), ("_reopen", 0.25)]
    assert search.notes[2:-1] == closely * looks + [("_round",)] * (cost > 2.0)


def test_they_are_looked_at_again_as_long_as_that_brings_something():
    def tighten():
        accepting(search, 9.0)
        search.core = those(10, 1, 2)

    search = told(
        _tighten=tighten,
        _reopen=lambda _: accepting(search, max(search.best_cost - 1.0, 7.0)),
        _round=lambda: search._raise_bound(7.0) or True,
    )
    assert search.run(None, False).cost == 7.0
    assert search.names()[2:-1] == ["_improve_locally", "_reopen"] * 3 + ["_round"]


@pytest.mark.parametrize("size", [4, 5, 6, None])
@pytest.mark.parametrize("solved", [True, False])
def test_where_the_master_takes_too_long_sites_that_look_best_are_looked_at_once(size, solved):
    core = None if size is None else tuple(range(size))

    def tighten():
        accepting(search, 2.1)
        search.core = None if core is None else those(10, *core)

    def master():
        search._raise_bound(3.0 if search.names().count("_round") == 2 else 2.0)
        return solved

    search = told(_tighten=tighten, _round=master)
    assert search.run(None, False).status is Status.OPTIMAL
    improve, confine = [("_improve_locally", core)], [("_confine", core, 0.6)]
    closely = [] if solved or core is None else improve + (confine + improve) * (size == 4)
    assert search.notes[2:-1] == [("_round",), *closely, ("_round",)]
    search = told(_tighten=tighten, _round=lambda: solved, _improve_locally=lambda _: search._raise_bound(3.0))
    if core is not None and not solved:
        search.run(None, False)
        assert search.notes[2:-1] == [("_round",), *improve]  # closed by then


def test_when_time_is_over_the_best_so_far_is_handed_back_without_a_further_step(clock):
    search = told(limit=5.0, _complete=lambda start: accepting(search, 4.0))
    clock.now += 5.0
    found = search.run(None, False)
    assert (found.status, found.cost, found.lower_bound) == (Status.TIME_LIMIT, 4.0, 2.0)
    assert search.names() == ["_complete", "_tighten"]


def test_what_is_impossible_ends_the_search():
    def judge():
        search.impossible = True

    search = told(_round=judge)
    assert search.run(None, False).status is Status.INFEASIBLE
    search = told(_complete=lambda start: judge())
    assert search.run(None, False).status is Status.INFEASIBLE
    assert search.names() == ["_complete"]
    search = told(_complete=lambda start: accepting(search, 4.0), _round=judge)
    with pytest.raises(RuntimeError, match="a bug in the oracle"):
        search.run(None, False)


class Fractions(_CoverSearch):
    """A search whose linear relaxations, rows and separation are what the test says."""

    def follow(self, bounds, *, join=False, separated=False, solved=True):
        self.left, self.solved_, self.rounded, self.asked = list(bounds), solved, [], 0
        self.rows.activate = lambda y: join
        self.relaxation.core = lambda y, best_cost: y > 0
        self._separated = lambda y: separated
        self._round_up = lambda y, share: self.rounded.append(share)
        return self

    def _relaxed(self, *, whole, until=np.inf):
        self.asked += 1
        assert not whole
        assert self.asked <= 30, "for ever"
        bound = self.left.pop(0) if len(self.left) > 1 else self.left[0]
        return Solution(None if bound is None else np.full(3, 0.5), bound or 0.0, self.solved_)


def fractions(bounds, limit=100.0, **told):
    cost = np.array([1.5, 1.3, 1.1])
    oracle = Rows(np.ones((1, 3), dtype=int), np.ones(1))
    none = np.zeros(3, dtype=bool)
    search = Fractions(cost, oracle, CutPool(3, []), CutPool(3, []), none, None, limit, lambda *_: None)
    return search.follow(bounds, **told)


@pytest.mark.parametrize(
    ("bounds", "options", "asked", "rounded"),
    [
        ([1.0, 1.0005], {"join": True}, 7, 1),  # six rounds that raise it by less than a thousandth
        ([1.0 * 1.01**k for k in range(20)], {"join": True, "separated": False}, 26, 1),
        ([1.0], {"separated": True}, 4, 1),  # three rounds of cuts in vain
        ([1.0 * 1.01**k for k in range(9)], {"separated": True}, 12, 9),
        ([1.0], {}, 1, 1),
    ],
)
def test_the_linear_relaxation_is_given_up_after_so_many_rounds_that_bring_nothing(bounds, options, asked, rounded):
    search = fractions(bounds, **options)
    search._tighten()
    assert search.asked == asked
    assert search.rounded == [0.05] * rounded + [0.25]
    np.testing.assert_array_equal(search.core, [True, True, True])


def test_an_oracle_that_refuses_leaves_less_time_for_layouts_of_what_the_fractions_have():
    search = fractions([1.0])
    search.refused = True
    search._tighten()
    assert search.rounded == [0.05, 0.1]


@pytest.mark.parametrize("bound", [1e6, 0.1])
def test_a_fractional_bound_is_taken_with_room_for_its_rounding(bound):
    search = fractions([bound])
    search._tighten()
    assert search.bound == pytest.approx(bound - 1e-5 * max(1.0, bound), rel=1e-12)


def test_without_a_fractional_solution_or_without_time_nothing_is_made_of_it(clock):
    for search in (fractions([None]), fractions([1.0], limit=0.0)):
        search._tighten()
        assert not search.rounded
        assert search.core is None
    search = fractions([1.0], solved=False)
    search._tighten()
    assert (search.asked, search.bound) == (1, 0.0)
    assert search.rounded == [0.25]
    search = fractions([1.0], separated=True)
    clock.tick = 10.0  # half of the time is over at the sixth look
    search._tighten()
    assert search.asked == 2
    search = fractions([1.0])
    search.impossible = True
    search._tighten()
    assert search.rounded == [0.05]


def test_ties_are_looked_at_again_after_every_exchange():
    """One exchange makes another possible, of a site that has had its turn."""

    class Few(Rows):
        def cuts(self, chosen, near=None):
            good = any((chosen == those(4, *pair)).all() for pair in ((2, 3), (1, 2), (0, 1)))
            return [] if good else [Cut(np.arange(4), np.ones(4), 1.0)]

    search = search_of(np.ones(4), Few(np.zeros((0, 4), dtype=int), np.zeros(0)))
    search.best = those(4, 2, 3)
    search._settle()
    np.testing.assert_array_equal(search.best, those(4, 0, 1))


def test_separation_asks_though_few_cuts_are_known():
    oracle, cost = odd_ring(5)
    for known in ([], [0]):
        search = search_of(cost, oracle, known=known, separate=lambda y: [Cut(np.arange(5), np.ones(5), 3.0)])
        assert search._separated(np.full(5, 0.5))


def test_sites_are_chosen_anew_around_each_site_of_the_best_until_none_brings_anything(clock):
    n = 15
    oracle, cost = odd_ring(n)
    search, freed = search_of(cost, oracle, fixed=[0], limit=100.0), []
    better = [those(n, 0, *range(1, n, 2), 2), those(n, 0, *range(1, n, 2))]
    search._accept(those(n, *range(n - 1)))

    def confine(sites, share, kept):
        assert sites.all()
        assert share == 1.0
        assert kept[0]
        freed.append(frozenset(np.flatnonzero(search.best & ~kept).tolist()))
        if better and len(freed) in (3, 5):
            search._accept(better.pop(0))
            return True
        return False

    search._confine = confine
    search._reopen(0.5)
    mine = set(np.flatnonzero(search.best).tolist()) - {0}
    assert not better
    assert len(freed) == 5 + len(mine)  # once more around each since it last became cheaper
    assert all(len(some) == 5 for some in freed)
    assert set().union(*freed[5:]) == mine
    assert len(set(freed[5:])) > 1
    shared = (oracle.matrix.T @ oracle.matrix)[1:-1, 1:-1]  # of the sites there first, 1 … n - 2
    around = [frozenset((np.argsort(-row, kind="stable")[:5] + 1).tolist()) for row in shared]
    assert all(some in around for some in freed[:3])
    clock.now += 200.0
    search._reopen(0.5)
    assert len(freed) == 5 + len(mine)
    clock.now -= 200.0
    clock.tick = 10.0
    search._reopen(0.5)
    assert 1 <= len(freed) - 5 - len(mine) <= 4  # in half of the time
