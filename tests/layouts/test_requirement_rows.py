"""What a limit demands, part by part: against plain loops over readings, and against drives with few sites alive."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from driftplan.beacons.beacon import Beacon
from driftplan.layouts.placement.drives import Limit, ReadingSets, _driven, drives_of
from driftplan.layouts.placement.requirements import DriftRequirements
from driftplan.layouts.placement.route_table import IntervalMoments, route_table
from driftplan.layouts.scenario import Scenario
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.planning.request import DriftLimit

NAMES = ["tags", "perfect", "coarse", "two full", "mixed", "with compass", "unsure", "everything"]
START = Fix.full(0.0, position_std_m=0.05, heading_std=0.02)


class Case:
    """Requirements of a small instance, with a limit among the drifts of its sites one by one."""

    def __init__(self, instance, share=0.4, redundancy=1, start_fix=START):
        scenario = Scenario.of(None, instance.paths, instance.noise, DriftLimit(), start_fix)
        self.n, self.redundancy = len(instance.sites), redundancy
        self.table = route_table(scenario, scenario.readings(instance.sites), 1.0)
        self.intervals = IntervalMoments(self.table)
        worst = [self.squares(r, [i])[1].max() for r in range(self.table.routes) for i in range(self.n)]
        self.limit = float(np.sqrt(np.quantile(worst, share))) * 1.003
        limits = Limit(np.full(self.table.routes, self.limit))
        self.needs = DriftRequirements(self.table, self.n, limits, redundancy)

    def readings(self, route, sites):
        here = self.table.readings_of(route)
        return [e for e in range(here.start, here.stop) if self.table.site[e] in sites]

    def squares(self, route, sites):
        """E|e|² at every breakpoint of a drive with these sites alive, on arrival and when all is read."""
        readings = np.array(self.readings(route, sites), dtype=np.intp)
        driven = _driven(self.intervals, ReadingSets(np.array([route]), np.zeros(len(readings), np.intp), readings))
        breakpoint = driven.j - self.intervals.first[route]
        arriving, leaving = np.full((2, int(self.table.slots[route]) + 1), np.nan)
        leaving[breakpoint] = driven.square  # the last of several at one breakpoint
        arriving[breakpoint[::-1]] = driven.square[::-1]
        return arriving, leaving

    def state(self, route, readings):
        """The state when the last of these readings is taken, and nothing else is read."""
        readings = np.array(readings, dtype=np.intp)
        driven = _driven(self.intervals, ReadingSets(np.array([route]), np.zeros(len(readings), np.intp), readings))
        return driven.state[driven.interval[-1:]][0]

    def last(self, route, site, slot):
        """The last position reading of a site at or before a slot, or None."""
        before = [e for e in self.readings(route, [site]) if self.table.breakpoint[e] <= slot]
        before = [e for e in before if not np.isnan(self.table.readings.square[e])]
        return before[-1] if before else None

    def holders(self, route, slot):
        """Sites whose own last reading holds the limit from there to the end of the slot, when nothing else is read."""
        found = set()
        for site in range(self.n):
            if (e := self.last(route, site, slot)) is not None:
                arriving, leaving = self.squares(route, [site])
                first, end = int(self.table.breakpoint[e]), min(slot + 1, len(arriving) - 1)
                found |= {site} if max(leaving[first], *arriving[first + 1 : end + 1], 0.0) <= self.limit**2 else set()
        return found

    def started(self, route, slot):
        """Whether the limit holds to the end of a slot when nothing is read at all."""
        arriving, leaving = self.squares(route, [])
        return max(leaving[0], *arriving[1 : slot + 2], 0.0) <= self.limit**2


@pytest.fixture
def case(make_instance, kinds_named):
    return lambda name, seed, **options: Case(make_instance(seed, kinds_named[name], sites=(4, 6)), **options)


def some_slots(case, route):
    """Some slots of a route, those among them before which something is read."""
    at = case.table.breakpoint[case.table.readings_of(route)]
    last = int(case.table.slots[route])
    return sorted({0, last, *(at[::3]).tolist(), *np.maximum(at[::3] - 1, 0).tolist(), *range(1, last, 1 + last // 6)})


@pytest.mark.parametrize(
    ("name", "sure", "blind", "independent"),
    [
        ("tags", True, False, True),
        ("two full", True, False, True),
        ("mixed", True, False, False),
        ("with compass", True, True, False),
        ("unsure", False, False, False),
    ],
)
def test_routes_are_told_apart_by_what_is_read_on_them(name, sure, blind, independent, make_instance, kinds_named):
    instance = make_instance(3, kinds_named[name], sites=(6, 7))
    sort = ([k.detection_probability == 1, k.position_std_m is None, k.heading_std is None] for k in kinds_named[name])
    assert np.array(list(sort)).any(axis=0)[1] == blind
    along = np.array([(0.0, 0.0), (30.0, 0.0)])  # and once more, far away
    sites = [type(instance.sites[0])(kind, 5.0 * k + 3.0, 0.5, f"s{k}") for k, kind in enumerate(kinds_named[name])]
    instance.paths, instance.sites = [along, along + 50.0], sites
    needs = Case(instance).needs
    assert needs.sure.tolist() == [sure, True]  # on the other nothing is read
    assert needs.blind.tolist() == [blind, False]
    assert needs.independent.tolist() == [independent, True]
    assert [r.tolist() for r in needs._routes_meeting] == [[0]] * len(sites)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [0, 5])
def test_a_reading_is_its_sites_last_until_the_site_is_read_again(name, seed, case):
    its = case(name, seed)
    stop, table = its.needs._before_next_own(), its.table
    for route in range(table.routes):
        for site in range(its.n):
            mine = its.readings(route, [site])
            until = [*(table.breakpoint[mine[1:]] - 1), table.slots[route]]
            np.testing.assert_array_equal(stop[mine], until[len(until) - len(mine) - 1 + bool(mine) :][: len(mine)])
    assert [r.tolist() for r in its.needs._routes_meeting] == [
        [r for r in range(table.routes) if its.readings(r, [site])] for site in range(its.n)
    ]


@pytest.mark.parametrize("name", ["tags", "coarse", "two full"])
@pytest.mark.parametrize("seed", range(4))
def test_known_rows_ask_for_exactly_the_sites_that_hold_a_slot_and_imply_it_for_every_slot(name, seed, case):
    its = case(name, seed, redundancy=1 + seed % 2)
    rows = its.needs.rows()
    for route in range(its.table.routes):
        mine = {cut.where[1]: cut for cut in rows if cut.where[0] == route}
        for slot, cut in mine.items():
            assert cut.least == its.redundancy
            assert set(cut.columns.tolist()) == its.holders(route, slot)
            assert not its.started(route, slot)
        able = its.needs.able(route)
        assert len(able) == its.table.slots[route] + 1
        asked = [set(cut.columns.tolist()) for cut in mine.values()]
        for slot in some_slots(its, route):
            holders = its.holders(route, slot)
            assert able[slot] == len(holders)
            if not its.started(route, slot):
                assert any(columns <= holders for columns in asked)
        _, *stretches = its.needs._stretches(route)
        slots = its.needs._narrow_slots(route, *stretches)
        for slot in slots:  # where the start holds the slot nothing is asked
            its.needs.last_slot_of_start[route] = slot
            fewer = its.needs._narrow_slots(route, *stretches)
            assert min(fewer, default=slot + 1) > slot
            assert {j for j in slots if j > slot} <= set(fewer)
        met = {int(s) for s in its.table.site[its.table.readings_of(route)]}
        assert len(mine) <= 2 * len(its.readings(route, met)) + 1  # where a site comes in, at most


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [0, 5])
def test_stretches_are_the_longest_runs_of_slots_that_a_site_holds(name, seed, case):
    its = case(name, seed, share=0.2)
    for route in range(its.table.routes):
        found = list(zip(*(x.tolist() for x in its.needs._stretches(route)), strict=True))
        runs = []
        for site in range(its.n):
            mine = [e for e in its.readings(route, [site]) if its.needs.places[e]]
            spans = [range(int(its.table.breakpoint[e]), int(its.needs.last_slot_of[e]) + 1) for e in mine]
            slots = sorted({j for span in spans for j in span})
            begins = [j for j in slots if j - 1 not in slots]
            ends = [j for j in slots if j + 1 not in slots]
            runs += [(site, first, last) for first, last in zip(begins, ends, strict=True)]
        assert found == runs


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [1, 7])
def test_hops_beyond_reach_are_those_found_one_by_one(name, seed, case):
    its = case(name, seed, redundancy=2)
    needs, table = its.needs, its.table
    simple = np.ones(table.routes, dtype=bool)
    for chosen in np.random.default_rng(seed).random((6, its.n)) < 0.5:
        sets = drives_of(table, chosen, np.arange(table.routes), 2)
        expected = []
        for drive, route in enumerate(sets.route.tolist()):
            alive = sets.reading[sets.drive == drive].tolist()
            last_at = {0: -1} | {int(table.breakpoint[e]): e for e in alive}  # the last of those at one place
            places = sorted(last_at)
            for k, place in enumerate(places):
                e = last_at[place]
                until = int(needs.last_slot_of_start[route] if e < 0 else needs.last_slot_of[e])
                if until < (places[k + 1] - 1 if k + 1 < len(places) else table.slots[route]):
                    expected.append((route, until + 1, e))
        assert sorted(needs._breached_intervals(sets, simple[sets.route])) == sorted(expected)


@pytest.mark.parametrize("name", ["tags", "coarse", "two full"])
@pytest.mark.parametrize("seed", range(3))
def test_a_cut_asks_for_holders_of_the_slot_or_for_those_read_after_what_does_not_reach_it(name, seed, case):
    its = case(name, seed, redundancy=1 + seed % 2)
    for bits in range(1, 2**its.n, 3):
        chosen = np.array([bits >> i & 1 for i in range(its.n)], dtype=bool)
        for cut in its.needs.cuts(chosen):
            (route, slot), holders = cut.where, its.holders(*cut.where)
            if (cut.weights > 0).all() and cut.least > 0:
                assert set(cut.columns.tolist()) == holders
                assert cut.least == its.redundancy > chosen[list(holders)].sum()
                continue
            own = int(cut.columns[-1])
            after = {i for i in holders if its.last(route, i, slot) > its.last(route, own, slot)}
            assert own not in holders
            assert set(cut.columns[:-1].tolist()) == after
            assert cut.weights.tolist() == [1.0] * len(after) + [-float(its.redundancy)]
            assert cut.least == 0.0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("seed", "bias"), [(2, 0.0), (4, 0.0), (2, 0.3)])
def test_the_least_drift_after_a_last_reading_is_that_of_the_best_heading_read_before(
    name, seed, bias, make_instance, kinds_named
):
    instance = make_instance(seed, kinds_named[name], sites=(4, 6))
    instance.noise = replace(instance.noise, heading_bias_per_m=bias)  # rad/m: soon it drives about the other way
    its = Case(instance)
    needs, table = its.needs, its.table
    for route in range(table.routes):
        for slot in some_slots(its, route)[::2]:
            site, least, at_start = needs.least_squares(route, slot)
            end = min(slot + 1, int(table.slots[route]))
            side = int(end == slot)  # nothing is driven in the last slot
            expected = [i for i in range(its.n) if its.last(route, i, slot) is not None]
            assert sorted(site.tolist()) == expected
            if not needs.blind[route]:
                assert at_start == pytest.approx(its.squares(route, [])[side][end])
            for i, value in zip(site.tolist(), least.tolist(), strict=True):
                alone = its.squares(route, [i])[side][end]
                own = its.last(route, i, slot)
                if not needs.sure[route]:
                    continue
                if needs.turns[own] and not needs.blind[route]:
                    assert value == pytest.approx(alone)
                    continue
                later = [a for a in range(its.n) if (e := its.last(route, a, slot)) is not None and e > own]
                drifts = [its.squares(route, {i, a})[side][end] for a in range(its.n) if a not in later]
                assert value <= min(drifts) * (1 + 1e-9)
                if not (bias or needs.blind[route] or needs.turns[its.readings(route, later)].any()):
                    assert value == pytest.approx(min(drifts))


@pytest.mark.parametrize("name", ["tags", "two full", "mixed", "with compass", "unsure"])
@pytest.mark.parametrize("bias", [0.0, 0.02])
def test_the_heading_after_a_reading_lies_between_those_of_the_readings_before(name, bias, make_instance, kinds_named):
    instance = make_instance(2, kinds_named[name], sites=(4, 6))
    instance.noise = replace(instance.noise, heading_bias_per_m=bias)
    its = Case(instance, start_fix=Fix.full(0.0, position_std_m=0.05, heading_std=0.4))
    fresh, turns, table = its.needs.fresh, its.needs.turns, its.table
    for route in range(table.routes):
        here = table.readings_of(route)
        for e in range(here.start, here.stop):
            if table.readings.chance[e] < 1:
                continue
            before = [a for a in range(here.start, e) if turns[a] and table.readings.chance[a] == 1]
            states = [its.state(route, [e])] + [its.state(route, [a, e]) for a in before] * (not turns[e])
            if its.needs.places[e]:
                assert fresh.state.N[e].real == pytest.approx(states[0].N.real)
            d1 = np.array([state.d1 for state in states])
            for part in (np.real, np.imag):
                low, high = part(d1).min(), part(d1).max()
                assert part(fresh.low[e]) <= low + 1e-12
                assert high - 1e-12 <= part(fresh.high[e])
                if len(states) == 1 or (not bias and its.needs.sure[route]):
                    assert (part(fresh.low[e]), part(fresh.high[e])) == (pytest.approx(low), pytest.approx(high))
            if len(states) == 1 and its.needs.sure[route]:
                for name_ in ("d1", "d2", "D"):
                    assert getattr(fresh.state, name_)[e] == pytest.approx(getattr(states[0], name_))


@pytest.mark.parametrize("share", [0.3, 0.6])
@pytest.mark.parametrize("seed", range(5))
def test_pairs_that_hold_a_slot_are_those_that_hold_it_when_driven(seed, share, case):
    its = case("mixed", seed, share=share)
    needs, table = its.needs, its.table
    for route in range(table.routes):
        if needs.blind[route] or not needs.sure[route]:
            continue
        for slot in some_slots(its, route):

            def square(sites, route=route, slot=slot):
                arriving, leaving = its.squares(route, sites)
                return max([leaving[slot], *arriving[slot + 1 : slot + 2]])

            pairs = needs._pairs(route, slot)
            last = [its.last(route, int(i), slot) for i in pairs.site]
            assert last == sorted(last)
            values = []
            for b, site in enumerate(pairs.site.tolist()):
                in_reach = needs.last_slot_of[last[b]] >= slot
                assert pairs.turns[b] == needs.turns[last[b]]
                if pairs.turns[b] or not in_reach:
                    assert pairs.alone[b] == in_reach
                else:
                    values.append(("alone", b, square([site])))
                for a, other in enumerate(pairs.site.tolist()):
                    able = a < b and pairs.turns[a] and not pairs.turns[b] and in_reach
                    assert not pairs.together[a, b] or able
                    between = [e for e in its.readings(route, [site, other]) if needs.turns[e] and e > last[a]]
                    if able and not between:
                        values.append(("together", (a, b), square([site, other])))
            held = {name: getattr(pairs, name).copy() for name in ("alone", "together")}
            for name, which, value in values:
                assert held[name][which] == (value <= its.limit**2)
            for name, which, value in values[:: 1 + len(values) // 3]:  # just held, and just not
                for share_of, holds in ((1 + 1e-6, True), (1 - 1e-6, False)):
                    needs.limit = Limit(np.full(table.routes, np.sqrt(value * share_of)))
                    assert getattr(needs._pairs(route, slot), name)[which] == holds
            needs.limit = Limit(np.full(table.routes, its.limit))


@pytest.mark.parametrize("name", ["mixed", "with compass", "unsure", "everything"])
@pytest.mark.parametrize("seed", [0, 3])
def test_a_no_good_cut_names_the_sites_on_which_the_drift_in_the_slot_depends(name, seed, case):
    its = case(name, seed)
    needs, table = its.needs, its.table
    for chosen in np.random.default_rng(seed).random((3, its.n)) < 0.5:
        for route in range(table.routes):
            met = {int(s) for s in table.site[table.readings_of(route)]}
            alive = np.array(its.readings(route, np.flatnonzero(chosen).tolist()), dtype=np.intp)
            for slot in some_slots(its, route)[1::2]:
                before = alive[table.breakpoint[alive] <= slot]
                cut = needs._no_good(chosen, route, slot, before)
                assert chosen[cut.columns] @ cut.weights == cut.least - 1
                assert (cut.weights == np.where(chosen[cut.columns], -1, 1)).all()
                now = its.squares(route, np.flatnonzero(chosen).tolist())[1][slot]
                for site in met:
                    other = chosen.copy()
                    other[site] = not other[site]
                    then = its.squares(route, np.flatnonzero(other).tolist())[1][slot]
                    if site not in cut.columns:
                        assert then == pytest.approx(now, rel=1e-9, abs=1e-15)
                # the last sure position, the last sure heading before that, and whatever is or might be read since
                sure = [e for e in before.tolist() if table.readings.chance[e] == 1]
                placed = max([e for e in sure if needs.places[e]], default=-1)
                turned = max([e for e in sure if needs.turns[e] and e <= placed], default=-1)
                since = [e for e in its.readings(route, met) if table.breakpoint[e] <= slot]
                since = [e for e in since if e >= (turned if needs.turns[e] else placed)]
                matter = {int(table.site[e]) for e in since if e in before or not chosen[table.site[e]]}
                assert set(cut.columns.tolist()) == matter


@pytest.mark.parametrize("name", ["tags", "two full", "mixed"])
def test_what_is_beyond_reach_of_the_last_sure_reading_whatever_the_heading_gives_the_cut_of_that_reading(name, case):
    hops = 0
    for seed in range(4):
        its = case(name, seed, share=0.3)
        needs, table = its.needs, its.table
        for chosen in np.random.default_rng(seed).random((4, its.n)) < 0.6:
            for route in range(table.routes):
                alive = np.array(its.readings(route, np.flatnonzero(chosen).tolist()), dtype=np.intp)
                for slot in some_slots(its, route):
                    placing = [e for e in alive.tolist() if table.breakpoint[e] <= slot and needs.places[e]]
                    until = needs.last_slot_of[placing[-1]] if placing else needs.last_slot_of_start[route]
                    if needs.sure[route] and until < slot:
                        (cut,) = needs._cuts_of(chosen, route, slot, False, alive)
                        expected = needs._sure_cut(chosen, route, slot, placing[-1] if placing else -1)
                        assert cut.columns.tolist() == expected.columns.tolist()
                        assert cut.weights.tolist() == expected.weights.tolist()
                        hops += bool((cut.weights < 0).any())
    assert hops


@pytest.mark.parametrize("name", ["mixed", "with compass", "unsure", "everything"])
@pytest.mark.parametrize("seed", [1, 2, 6])
def test_cuts_of_a_slot_are_met_by_all_layouts_that_hold_to_its_end_and_missed_by_the_one_that_fails(name, seed, case):
    its = case(name, seed, share=0.5)
    needs, table = its.needs, its.table
    layouts = np.array([[s >> i & 1 for i in range(its.n)] for s in range(2**its.n)], dtype=bool)
    for route in range(table.routes):
        squares = [its.squares(route, np.flatnonzero(chosen).tolist()) for chosen in layouts]
        reach = [until for e in its.readings(route, range(its.n)) if (until := int(needs.last_slot_of[e])) >= 0]
        slots = sorted({slot for until in reach for slot in (until, until + 1) if slot <= table.slots[route]})
        for slot in slots[:: 1 + len(slots) // 8]:
            early = np.array([leaving[slot] > its.limit**2 for _, leaving in squares])
            late = np.array([arriving[slot + 1 : slot + 2].max(initial=0.0) > its.limit**2 for arriving, _ in squares])
            worst = [max(*leaving[: slot + 1], *arriving[1 : slot + 2], 0.0) for arriving, leaving in squares]
            good = layouts[np.array(worst) <= its.limit**2 * (1 - 1e-9)]
            for k in np.flatnonzero(early | late)[::3].tolist():
                alive = np.array(its.readings(route, np.flatnonzero(layouts[k]).tolist()), dtype=np.intp)
                found = needs._cuts_of(layouts[k], route, slot, bool(early[k]), alive)
                for cut in found:
                    assert cut.where == (route, slot)
                    if not needs.sure[route]:  # a set that fails for good, if there is one, where the limit breaks
                        at = slot + (not early[k])
                        within = {int(table.site[e]) for e in alive if table.breakpoint[e] <= slot and needs.places[e]}
                        able = needs._chance_cuts(route, slot, at, sorted(within))
                        assert (cut.weights > 0).all() or not able
                    assert layouts[k][cut.columns] @ cut.weights < cut.least
                    assert (good[:, cut.columns] @ cut.weights >= cut.least - 1e-9).all()


@pytest.mark.parametrize("name", ["mixed", "unsure", "everything"])
@pytest.mark.parametrize("seed", range(6))
def test_sets_that_cannot_hold_a_slot_are_looked_for_beforehand(name, seed, case):
    lost = Fix.full(0.0, position_std_m=0.05, heading_std=0.5)  # so that positions alone are little use
    its = case(name, seed, share=0.3, start_fix=lost if name == "mixed" else START)
    needs = its.needs
    rows = [cut for cut in needs.rows() if not needs.independent[cut.where[0]] and not needs.blind[cut.where[0]]]
    for cut in rows:
        route, slot = cut.where
        met = {int(s) for s in its.table.site[its.table.readings_of(route)]}
        outside = [s for s in met if s not in cut.columns]
        if not needs.sure[route]:  # judged at the end of the slot
            (same,) = needs._chance_cuts(route, slot, min(slot + 1, int(its.table.slots[route])), [])
            assert (cut.columns.tolist(), cut.least) == (same.columns.tolist(), same.least)
        need = int(cut.least) - its.redundancy + 1
        some = [c for k in range(need) for c in combinations(cut.columns.tolist(), k)]
        for few in some[:8]:  # with fewer of them than that the slot fails, or one before it
            arriving, leaving = its.squares(route, {*outside, *few})
            before = slice(0 if needs.sure[route] else slot, None)
            everything = [*leaving[: slot + 1][before], *arriving[1 : slot + 2][before]]
            assert max(everything) > its.limit**2 * (1 - 1e-9)
    hard = [r for r in range(its.table.routes) if not needs.independent[r] and not needs.blind[r]]
    for route in hard:
        slots = int(its.table.slots[route])
        narrow = needs._narrow_slots(route, *needs._stretches(route)[1:])
        if not its.started(route, slots) and narrow:
            assert [cut for cut in rows if cut.where[0] == route]


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_where_a_position_needs_a_heading_with_it_rows_ask_for_one_of_the_two_beforehand(share, kinds_named):
    tag, _, sign = kinds_named["mixed"]
    places = [(4.0 + 4.5 * k, 0.7 * (-1) ** k) for k in range(12)][::-1]
    sites = [Beacon(sign if k % 4 == 2 else tag, *xy, f"s{k}") for k, xy in enumerate(places)]
    noise = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3)
    start = Fix.full(0.0, position_std_m=0.05, heading_std=0.1)
    its = Case(SimpleNamespace(paths=[np.array([(0.0, 0.0), (60.0, 0.0)])], sites=sites, noise=noise), share, 1, start)
    rows = [(cut.where, cut.columns.tolist()) for cut in its.needs.rows()]
    others = 0
    for slot in its.needs._narrow_slots(0, *its.needs._stretches(0)[1:]):
        for cut in its.needs._pair_cuts(0, slot, np.zeros(0, dtype=np.intp)):
            assert (cut.where, cut.columns.tolist()) in rows
            last = its.needs._last_readings(0, slot)
            others += cut.columns.tolist() != sorted(
                its.table.site[last[its.needs.last_slot_of[last] >= slot]].tolist()
            )
    assert others
