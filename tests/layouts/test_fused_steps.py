"""What a fusing robot's requirements are made of, part by part: against drives from border to border, leg by leg."""

from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.layouts.placement import fused_requirements
from driftplan.layouts.placement.fused_requirements import FusedRequirements
from driftplan.layouts.placement.fused_routes import NEVER, fused_routes
from driftplan.layouts.placement.weighted_cuts import Stretches, WeightedCuts
from driftplan.layouts.scenario import Scenario
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.planning.request import DriftLimit

CASES = [("tags", 0), ("mixed", 1), ("with compass", 2), ("unsure", 3), ("everything", 4), ("ranges", 5), ("lights", 6)]
ROOM = 1e-6  # relative, of tr P: what weighted cuts leave to rounding


class Case:
    """A small instance, with a limit on every route somewhere between what all sites can do and what none does."""

    def __init__(self, instance, share, redundancy):
        start = Fix.full(0.0, position_std_m=0.05, heading_std=0.02)
        scenario = Scenario.of(None, instance.paths, instance.noise, DriftLimit(), start, "filter")
        self.routes = fused_routes(scenario, scenario.readings(instance.sites))
        self.n, self.redundancy = len(instance.sites), redundancy
        least, worst = ([route.worst(alive(route)) for route in self.routes] for alive in (lambda r: r.sites, nobody))
        self.limits = [a + share * (b - a) + 1e-3 for a, b in zip(least, worst, strict=True)]
        self.most = [limit**2 * (1 + 1e-9) for limit in self.limits]
        self.needs = FusedRequirements(self.routes, self.limits, redundancy)

    def layouts(self):
        return [frozenset(np.flatnonzero([s >> i & 1 for i in range(self.n)]).tolist()) for s in range(2**self.n)]


def nobody(route):
    return frozenset()


def drive(route, alive, *, state=None, first=-1):
    """tr P on arrival at every border, and the states when all is read there, from the start (-1) or from a state when
    all is read at a border."""
    legs = list(route.legs.columns())
    state = route.start if state is None else state
    arriving, after = {}, {}
    for border in range(max(first, 0), len(route.readings)):
        if border > max(first, 0):
            state = state.driven(legs[border - 1])
            arriving[border] = float(state.trace)
        if border > first:
            for reading in route.readings[border]:
                state = state.read(reading.rows, reading.chance) if reading.site in alive else state
        after[border] = state
    return arriving, after


def best_at(route, border):
    return None if border < 0 else drive(route, route.sites)[1][border]


@pytest.fixture
def case(one_of_them):
    return lambda name, seed, share=0.3, redundancy=1: Case(one_of_them(name, 700 + seed), share, redundancy)


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_a_route_driven_in_hops_is_the_route_driven_leg_by_leg(name, seed, case):
    its = case(name, seed)
    for route, most in zip(its.routes, its.most, strict=True):
        found = {
            site: [b for b, here in enumerate(route.readings) if site in {x.site for x in here}]
            for site in range(its.n)
        }
        assert route.borders_of == {site: borders for site, borders in found.items() if borders}
        _, best = drive(route, route.sites)
        np.testing.assert_allclose([s.P for s in route.best], [s.P for s in best.values()], rtol=1e-7, atol=1e-12)
        for alive in its.layouts()[:: max(1, 2**its.n // 9)]:
            arriving, after = drive(route, alive)
            assert route.worst(alive) == pytest.approx(np.sqrt(max([*arriving.values(), 0.0])), rel=1e-7)
            over = [border for border, trace in arriving.items() if trace > most]
            assert route.breach(alive, most) == (over[0] if over else NEVER)
            middle = route.end // 2
            later, _ = drive(route, alive, state=after[middle], first=middle)
            for end in {middle + 1, route.end} - {middle}:
                if middle < end <= route.end:
                    assert route.arriving(after[middle], middle, end, alive).trace == pytest.approx(
                        later[end], rel=1e-7
                    )
        alone, _ = drive(route, set())
        ends = np.arange(1, route.end + 1)
        np.testing.assert_allclose(route.traces(route.start, 0, ends), [alone[b] for b in ends], rtol=1e-7, atol=1e-12)
        assert route.first_over(route.start, 0, alone[route.end] * 2 + 1.0) == NEVER
        for limit in (most, max(alone.values()) * (1 - 1e-6)):
            over = [border for border, trace in alone.items() if trace > limit]
            assert route.first_over(route.start, 0, limit) == (over[0] if over else NEVER)
            if over and over[0] > 1:
                assert route.first_over(route.start, 0, limit, over[0] - 1) == NEVER
                assert route.first_over(route.start, 0, limit, over[0]) == over[0]


def unread(route, most):
    """Borders (first, last): read nothing at first … last - 1, and even from the best state it fails at last."""
    until = []
    for first in range(route.end + 1):
        arriving, _ = drive(route, nobody(route), state=best_at(route, first - 1), first=first - 1)
        over = [border for border, trace in arriving.items() if trace > most]
        until.append(over[0] if over else NEVER)
    later = [*until[1:], NEVER]
    return [(k, last) for k, last in enumerate(until) if last not in (NEVER, later[k])]


@pytest.mark.parametrize(("name", "seed"), CASES)
@pytest.mark.parametrize("redundancy", [1, 2])
def test_known_rows_are_the_smallest_sets_of_sites_on_stretches_that_fail_when_nothing_is_read(
    name, seed, redundancy, case
):
    its = case(name, seed, redundancy=redundancy)
    rows = its.needs.rows()
    for r, route in enumerate(its.routes):
        stretches = unread(route, its.most[r])
        assert route.unread(its.most[r]) == stretches
        read = {last: {x.site for b in range(first, last) for x in route.readings[b]} for first, last in stretches}
        mine = [cut for cut in rows if cut.where[0] == r]
        for cut in mine:
            assert set(cut.columns.tolist()) == read[cut.where[1]]
            assert (cut.weights == 1).all()
            assert cut.least == redundancy
            assert not any(sites < read[cut.where[1]] for sites in read.values())
        assert all(any(set(cut.columns.tolist()) <= sites for cut in mine) for sites in read.values())


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_sites_that_may_be_dead_are_all_sets_of_so_many(name, seed, case):
    its = case(name, seed, redundancy=3)
    everyone = set(range(its.n)) - {1}
    for r, route in enumerate(its.routes):
        here = route.sites & everyone
        survivors = [here - set(dead) for dead in combinations(here, min(2, len(here)))]
        assert sorted(map(sorted, its.needs._survivors(r, everyone))) == sorted(map(sorted, survivors))
    for site in range(its.n):
        assert its.needs.routes_meeting.get(site, []) == [
            r for r, route in enumerate(its.routes) if site in route.sites
        ]


def outside(route, most, alive, border):
    """The sites that, added in the order in which they are read, would let the shortest stretch that fails hold."""

    def fails(low, living):
        return drive(route, living, state=best_at(route, low), first=low)[0][border] > most

    if fails(border - 1, alive):
        return set()
    low = max([low for low in range(border - 1) if fails(low, alive)], default=-1)
    inside, found = set(alive), set()
    for stop in range(low + 1, border):
        for reading in route.readings[stop]:
            if reading.site not in inside | found:
                (inside if fails(low, inside | {reading.site}) else found).add(reading.site)
    return found


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_what_has_to_be_added_is_all_but_the_largest_set_that_fails(name, seed, case):
    its = case(name, seed)
    for r, route in enumerate(its.routes):
        for alive in its.layouts()[:: max(1, 2**its.n // 8)]:
            border = route.breach(alive, its.most[r])
            if border != NEVER:
                assert its.needs._outside(r, set(alive), border) == outside(route, its.most[r], alive, border)


@pytest.mark.parametrize("seed", range(8))
def test_it_is_so_wherever_and_however_often_sites_are_read(seed):
    rng = np.random.default_rng(seed)
    noise = OdometryNoise(heading_var_per_m=1e-2, distance_var_per_m=1e-2)
    kinds = [BeaconKind.rfid(2.0, 0.1), BeaconKind.rfid(2.0, 0.3), BeaconKind.landmark(2.0, 0.2, 0.1)]
    sites = [Beacon(kinds[k % 3], 2.0 * k, 0.5, f"s{k}") for k in range(7)]
    start = Fix.full(0.0, position_std_m=0.5, heading_std=0.15)
    scenario = Scenario.of(None, [(0, 0), (14, 0)], noise, DriftLimit(), start, "filter")
    (route,) = fused_routes(scenario, scenario.readings(sites))
    read = [reading for here in route.readings for reading in here]
    shuffled = (rng.choice(len(read), rng.integers(0, 4)).tolist() for _ in range(12))
    here = [tuple(read[k] for k in some) for some in shuffled]
    route = replace(route, readings=(*here, *[()] * (len(route.readings) - 12)))
    tried = 0
    for limit in np.quantile(list(drive(route, route.sites)[0].values()), (0.6, 0.8, 0.95)) * 1.3:
        needs = FusedRequirements([route], [np.sqrt(limit)])
        for alive in (frozenset(c) for k in range(3) for c in combinations(range(7), k)):
            border = route.breach(alive, limit)
            if border != NEVER:
                tried += 1
                assert needs._outside(0, set(alive), border) == outside(route, limit, alive, border)
    assert tried


def test_of_many_beginnings_of_stretches_only_some_are_looked_at(case, monkeypatch):
    monkeypatch.setattr(fused_requirements, "_WEIGHTED_STRETCHES", 4)
    its = case("tags", 0, share=0.05)
    known = [len(route.unread(most)) for route, most in zip(its.routes, its.most, strict=True)]
    assert max(known) > 4
    number = [sum(weighted.r == r for weighted, _ in its.needs._stretches) for r in range(len(its.routes))]
    assert number == [-(-n // (1 + n * len(its.routes) // 4)) for n in known]


@pytest.mark.parametrize(("name", "seed"), CASES)
@pytest.mark.parametrize("redundancy", [1, 2])
def test_a_route_that_fails_is_repaired_site_by_site_and_gives_a_cut_for_each(name, seed, redundancy, case):
    its = case(name, seed, redundancy=redundancy)
    for alive in its.layouts()[:: max(1, 2**its.n // 4)]:
        chosen = np.isin(np.arange(its.n), list(alive))
        cuts = its.needs.cuts(chosen)
        for r, route in enumerate(its.routes):
            mine = [cut for cut in cuts if cut.where[0] == r]
            survivors = [s for s in its.needs._survivors(r, set(alive)) if route.breach(s, its.most[r]) != NEVER]
            assert bool(mine) == bool(survivors)
            assert len(mine) <= 8
            if not mine:
                continue
            dead, borders = survivors[0], [cut.where[1] for cut in mine]
            assert borders == sorted(borders)
            assert borders[0] == route.breach(dead, its.most[r])
            assert set(mine[0].columns.tolist()) == outside(route, its.most[r], dead, borders[0])
            for cut, after in pairwise(mine):  # a site that has been added is asked for no more
                assert set(cut.columns.tolist()) - set(after.columns.tolist())
            holding = [s for s in its.layouts() if route.breach(s, its.most[r]) == NEVER]
            if len(mine) < 8 and mine[-1].columns.size:
                assert holding
        for site in range(its.n):
            here = its.needs.routes_meeting.get(site, [])
            near = its.needs.cuts(chosen, near=site)
            assert len(near) == (1 if any(cut.where[0] in here for cut in cuts) else 0)
            for cut in near:
                assert cut.where[0] in here
                assert chosen[cut.columns] @ cut.weights < cut.least
                survivors = (its.routes[cut.where[0]].sites - s for s in its.needs._survivors(cut.where[0], set(alive)))
                assert set(cut.columns.tolist()) in survivors


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_the_layout_to_start_from_adds_the_last_site_that_helps_wherever_a_route_fails(name, seed, case):
    its = case(name, seed)
    fixed = np.arange(its.n) == 1
    chosen = fixed.copy()
    for r, route in enumerate(its.routes):
        while (border := route.breach(frozenset(np.flatnonzero(chosen)), its.most[r])) != NEVER:
            able = outside(route, its.most[r], route.sites & set(np.flatnonzero(chosen).tolist()), border)
            last = [(max(b for b in route.borders_of[s] if b < border), -s) for s in able]
            if not last:
                break
            chosen[-max(last)[1]] = True
    np.testing.assert_array_equal(its.needs.driven_along(fixed), chosen)
    assert fixed.sum() == 1


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_the_sites_a_fractional_layout_has_most_of_give_the_cut_of_the_largest_set_of_them_that_fails(name, seed, case):
    its = case(name, seed, share=0.2)
    for y in np.random.default_rng(seed).uniform(0.0, 0.6, (4, its.n)):
        y[y < 0.1] = 0.0
        for r, route in enumerate(its.routes):
            order = sorted((site for site in route.sites if y[site] > 0), key=lambda site: -y[site])
            fails = [k for k in range(len(order) + 1) if route.breach(frozenset(order[:k]), its.most[r]) != NEVER]
            found = its.needs._failing(r, y)
            if not fails:
                assert not found
                continue
            largest = set(order[: fails[-1]])
            border = route.breach(largest, its.most[r])
            needed = outside(route, its.most[r], largest, border)
            if needed and y[list(needed)].sum() > 0:
                assert not its.needs._failing(r, y / y[list(needed)].sum())  # what is met is not asked for
            if y[list(needed)].sum() >= 1 - 1e-3:
                assert not found
            else:
                assert [(set(cut.columns.tolist()), cut.least, cut.where) for cut in found] == [
                    (needed, 1.0, (r, border))
                ]


class Plain:
    """Stretches that begin at a border and fail at ``last`` when nothing is read, drive by drive."""

    def __init__(self, route, most, first, last):
        self.route, self.most, self.first, self.last = route, most * (1 + ROOM), first, last
        self.known = {}

    def until(self, living, among=None):
        """The first border from ``last`` on at which the limit fails (of those ``among``); beyond the end if none."""
        if living not in self.known:
            state = best_at(self.route, self.first - 1)
            arriving, _ = drive(self.route, living, state=state, first=self.first - 1)
            self.known[living] = [b for b, trace in arriving.items() if b >= self.last and trace > self.most]
        return min([b for b in self.known[living] if among is None or b in among], default=self.route.end + 1)

    def read(self, end):
        return sorted({x.site for b in range(self.first, end) for x in self.route.readings[b]})

    def ends(self):
        at = self.route.distance
        farther = [at[self.first] + k * (at[self.last] - at[self.first]) for k in (1.5, 2.0, 2.5, 3.0, 3.5, 4.0)]
        farther = [next((b for b in range(len(at)) if at[b] >= s), self.route.end) for s in farther]
        farther = [max(b, self.last) for b in farther]
        fails = sorted(b for s in self.read(farther[-1]) if (b := self.until(frozenset({s}))) <= farther[-1])
        return sorted({*farther, *([fails[(len(fails) - 1) // 2], fails[-1]] if fails else [])})

    def fewest(self, site, end):
        """The least size of a set with a site that holds until an end, of which none can be spared; 3: or more."""
        if self.until(frozenset({site})) > end:
            return 1
        ends = self.ends()  # pairs are judged there only
        others = [w for w in self.read(ends[-1]) if w != site and self.until(frozenset({w})) <= end]
        return 2 if any(self.until(frozenset({site, w}), ends) > end for w in others) else 3


def stretches_of(its, r):
    """Some stretches of a route, the plain ones beside them."""
    route, most = its.routes[r], its.most[r]
    weighted = WeightedCuts(r, route, most, its.redundancy)
    known = route.unread(most)
    for first, last in known[:: max(1, len(known) // 3)]:
        yield weighted, weighted.stretches(first, last), Plain(route, most, first, last)


@pytest.mark.parametrize(("name", "seed"), CASES)
@pytest.mark.parametrize("share", [0.1, 0.4])
def test_stretches_know_which_sites_hold_them_alone(name, seed, share, case):
    its = case(name, seed, share=share)
    y = np.random.default_rng(seed).uniform(0, 1, its.n) * (np.arange(its.n) != 2)
    for r in range(len(its.routes)):
        for _, stretches, plain in stretches_of(its, r):
            ends = plain.ends()
            assert stretches.ends.tolist() == ends
            assert stretches.sites.tolist() == plain.read(ends[-1])
            for v, site in enumerate(stretches.sites.tolist()):
                inside = [site in plain.read(end) for end in ends]
                alone = [plain.until(frozenset({site})) > end for end in ends]
                assert stretches.inside[v].tolist() == inside
                assert stretches.alone[v].tolist() == alone
                weights = [6.0 * a if b else 3.0 * a for a, b in zip(inside, alone, strict=True)]
                assert [stretches.weights(e, y)[v] for e in range(len(ends))] == weights
            assert stretches.untried(y).tolist() == [
                v
                for v, site in enumerate(stretches.sites)
                if y[site] > 0 and plain.until(frozenset({site})) <= ends[-1]
            ]
            sums = [
                sum(y[s] * (1.0 if plain.until(frozenset({s})) > end else 1 / 3) for s in plain.read(end))
                for end in ends
            ]
            assert stretches.least(y) == pytest.approx(min(sums))


@pytest.mark.parametrize(("name", "seed"), CASES)
@pytest.mark.parametrize(("share", "redundancy"), [(0.1, 1), (0.25, 2)])
def test_every_set_that_holds_weighs_one_in_a_weighted_cut_and_the_layout_asked_about_less(
    name, seed, share, redundancy, case
):
    its = case(name, seed, share=share, redundancy=redundancy)
    rng = np.random.default_rng(seed)
    for r in range(len(its.routes)):
        for weighted, stretches, plain in stretches_of(its, r):
            ends, tried = plain.ends(), set()
            for y in (rng.uniform(0, 0.5, its.n) * (rng.random(its.n) < 0.5), rng.uniform(0, 0.4, its.n)):
                found = {cut.where: cut for cut in weighted.beyond(stretches, y)}
                tried |= {s for s in range(its.n) if y[s] > 1e-6}
                for e, end in enumerate(ends):
                    sites = plain.read(end)
                    weight = dict(zip(stretches.sites.tolist(), stretches.weights(e, y).tolist(), strict=True))
                    for s in sites:
                        alone = plain.until(frozenset({s})) > end
                        assert weight[s] == 6.0 if alone else weight[s] in (2.0, 3.0, 4.0)
                    for s, w in combinations(sites, 2):  # of any three 2 each is enough
                        assert weight[s] + weight[w] >= 6.0 or plain.until(frozenset({s, w}), ends) <= end
                    fewest = {
                        s: 6.0 / (plain.fewest(s, end) if s in tried else min(plain.fewest(s, end), 2)) for s in sites
                    }
                    assert sum(y[s] * weight[s] for s in sites) <= sum(y[s] * fewest[s] for s in sites) + 1e-12
                    least = 6.0 + (redundancy - 1) * min((weight[s] for s in sites), default=6.0)
                    assert ((r, end) in found) == (sum(y[s] * weight[s] for s in sites) < least - 6e-3)
                    if (r, end) in found:
                        assert found[r, end].columns.tolist() == sites
                        assert found[r, end].weights.tolist() == [weight[s] for s in sites]
                        assert found[r, end].least == least
                    if have := sum(y[s] * weight[s] for s in sites):  # a thousandth of 1 is not worth a cut
                        for missed in (3e-3, 9e-3):
                            scaled = y * (least - missed) / have
                            again = {cut.where for cut in weighted.beyond(replace(stretches), scaled)}
                            assert ((r, end) in again) == (missed > 6e-3)


def test_a_site_weighs_less_where_its_partners_are_chosen_less():
    """Three sites, of which the middle one does together with either of the others."""
    one = np.ones((3, 1), dtype=bool)
    pairs = np.array([(0, 1), (1, 2)])
    both = Stretches(0, np.array([9]), np.arange(3), np.zeros((3, 1), int), one, ~one, one[:, 0], pairs, one[:2])
    assert both.weights(0, np.array([0.3, 0.2, 0.3])).tolist() == [2.0, 4.0, 2.0]
    assert both.weights(0, np.array([0.1, 0.6, 0.1])).tolist() == [4.0, 2.0, 4.0]
    assert both.weights(0, np.array([0.1, 0.0, 0.1])).tolist() == [2.0, 4.0, 2.0]
    assert both.weights(0, np.zeros(3)).tolist() == [3.0, 3.0, 3.0]
    four, pairs = np.ones((4, 1), dtype=bool), np.array([(0, 1), (1, 2), (2, 3)])
    row = Stretches(0, np.array([9]), np.arange(4), np.zeros((4, 1), int), four, ~four, four[:, 0], pairs, four[:3])
    assert row.weights(0, np.array([0.3, 0.2, 0.25, 0.1])).tolist() == [
        2.0,
        4.0,
        2.0,
        4.0,
    ]
    untried = replace(both, tried=np.array([True, False, True]))
    assert untried.weights(0, np.array([0.0, 0.5, 0.0])).tolist() == [3.0, 3.0, 3.0]
    assert untried.weights(0, np.array([0.2, 0.1, 0.2])).tolist() == [2.0, 4.0, 2.0]


def plain(cuts):
    return [(cut.where, cut.columns.tolist(), cut.weights.tolist(), cut.least) for cut in cuts]


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_a_fractional_layout_gets_the_weighted_cuts_of_the_worst_stretch_of_every_route_first(
    name, seed, case, monkeypatch
):
    its = case(name, seed, share=0.15)
    for y in (np.full(its.n, 0.3), np.random.default_rng(seed).uniform(0, 0.5, its.n), np.ones(its.n)):
        ranked = []
        for r, route in enumerate(its.routes):
            weighted = WeightedCuts(r, route, its.most[r], 1)
            mine = [weighted.stretches(first, last) for first, last in route.unread(its.most[r])]
            mine.sort(key=lambda stretches: stretches.least(y))
            ranked += [(rank, x.least(y), r, weighted, x) for rank, x in enumerate(mine) if x.least(y) < 1 - 1e-3]
        ranked.sort(key=lambda entry: entry[:3])
        expected, least, work = [], None, 0
        for *_, weighted, stretches in ranked:
            work += len(stretches.sites) * len(stretches.untried(y))
            expected += plain(weighted.beyond(stretches, y))
            least = len(expected) if least is None and work and expected else least
        needs = FusedRequirements(its.routes, its.limits)
        found = plain(needs._weighted(y))
        assert found == expected
        failing = [cut for r in range(len(its.routes)) for cut in needs._failing(r, y)]
        assert plain(needs.cuts_beyond(y)) == (found or plain(failing))
        monkeypatch.setattr(
            fused_requirements, "_PAIRS_AT_ONCE", 0
        )  # stop when pairs were tried and something is found
        few = plain(FusedRequirements(its.routes, its.limits)._weighted(y))
        monkeypatch.undo()
        assert few == expected[:least]


@pytest.mark.parametrize("most", [1, 2, 3])
def test_a_route_gives_no_more_cuts_than_so_many_at_a_time(most, case, monkeypatch):
    monkeypatch.setattr(fused_requirements, "_CUTS_PER_ROUTE", most)
    its = case("tags", 0, share=0.02)
    number = [0] * len(its.routes)
    for cut in its.needs.cuts(np.zeros(its.n, dtype=bool)):
        number[cut.where[0]] += 1
    assert max(number) == most


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_a_limit_that_is_just_met_is_met(name, seed, case):
    its = case(name, seed)
    for alive in its.layouts()[:: max(1, 2**its.n // 5)]:
        chosen = np.isin(np.arange(its.n), list(alive))
        limits = [route.worst(alive) + 1e-12 for route in its.routes]
        assert not FusedRequirements(its.routes, limits).cuts(chosen)
    assert WeightedCuts(0, its.routes[0], 4.0, 1).most >= 4.0
