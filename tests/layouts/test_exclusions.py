"""Sets that cannot hold a slot: none of their subsets does, and they cannot be larger, by looking at all subsets."""

from itertools import combinations

import numpy as np
import pytest

from driftplan.layouts.placement.exclusions import Chances, Pairs, chance_exclusion, order_exclusion, pair_exclusions


def subsets(some, size=None):
    sizes = range(len(some) + 1) if size is None else [size]
    return [set(c) for k in sizes for c in combinations(some, k)]


@pytest.mark.parametrize("seed", range(12))
def test_excluded_pairs_hold_nothing_and_any_site_more_would(seed):
    rng = np.random.default_rng(seed)
    n = 7
    turns = rng.random(n) < 0.5
    alone = rng.random(n) < 0.2
    together = np.outer(turns, ~turns) & (rng.random((n, n)) < 0.4)
    pairs = Pairs(np.arange(n) * 3, turns, alone, together)

    def holds(W):
        return bool(alone[list(W)].any() or any(together[a, b] for a in W for b in W))

    for within in [set(), *subsets(range(n), 1), *subsets(range(n), 2)]:
        mask = np.isin(np.arange(n), list(within))
        found = [set(np.flatnonzero(W).tolist()) for W in pair_exclusions(pairs, mask)]
        if holds(within):
            assert not found
            continue
        assert len(found) == 2
        for W in found:
            assert within <= W
            assert not holds(W)
            assert all(holds(W | {site}) for site in set(range(n)) - W)
        for W, sort in zip(found, (~turns, turns), strict=True):  # all of one sort first, as far as they may
            assert {k for k in np.flatnonzero(sort).tolist() if not holds(within | {k})} <= W
        assert mask.sum() == len(within)


def chances_of(seed, readings=7, sites=5, chances=(0.5, 0.8, 0.9, 1.0)):
    rng = np.random.default_rng(seed)
    site = rng.integers(0, sites, readings) * 2
    chance = rng.choice(chances, readings)
    return Chances(4.0, site, chance, rng.uniform(0.2, 3.0, readings), float(rng.uniform(0.4, 2.0)))


def average_of_the_best(chances, S):
    """E|e|² where of the sites that are read the best counts, however often and in whatever order."""
    value, left = 0.0, 1.0
    best = {s: chances.square[chances.site == s].min() for s in S}
    for s in sorted(S, key=best.__getitem__):
        missed = np.prod(1 - chances.chance[chances.site == s])
        value, left = value + left * (1 - missed) * best[s], left * missed
    return value + left * chances.start


@pytest.mark.parametrize("seed", range(40))
def test_so_many_sites_outside_are_needed_whatever_the_order(seed):
    chances = chances_of(seed) if seed < 15 else chances_of(seed, 8, 6, (0.3, 0.4, 0.6))  # then it takes several
    everyone = sorted(set(chances.site.tolist()))
    best = {s: chances.square[chances.site == s].min() for s in everyone}

    def needed(W):
        """How many sites outside it takes with the best of W; 9 if all do not suffice."""
        outside = [s for s in everyone if s not in W]
        able = [
            k
            for k in range(len(outside) + 1)
            if any(
                average_of_the_best(chances, inner | set(c)) <= chances.bar
                for c in combinations(outside, k)
                for inner in subsets(W)
            )
        ]
        return able[0] if able else 9

    for within in [set(), {everyone[0]}, set(everyone[:2])]:
        W, need = chance_exclusion(chances, sorted(within))
        never = within | {s for s in everyone if best[s] > chances.bar}
        if needed(never) == 0:
            assert (W, need) == (set(), 0)
            continue
        assert never <= W
        assert need == needed(never) == needed(W)
        joining = sorted(set(everyone) - never, key=lambda s: (-best[s], s))  # the least helpful first
        assert W - never == set(joining[: len(W - never)])
        if set(everyone) - W:
            assert needed(W | {joining[len(W - never)]}) < need


@pytest.mark.parametrize("seed", range(25))
def test_a_set_read_in_order_cannot_hold_the_slot_whichever_of_its_readings_count(seed):
    chances = chances_of(100 + seed)
    readings = list(zip(chances.site.tolist(), chances.chance.tolist(), chances.square.tolist(), strict=True))
    best = {s: chances.square[chances.site == s].min() for s in set(chances.site.tolist())}

    def least(W):
        mine = [x for x in readings if x[0] in W]
        values = []
        for some in subsets(range(len(mine))):
            value = chances.start
            for k in sorted(some):
                value = mine[k][1] * mine[k][2] + (1 - mine[k][1]) * value
            values.append(value)
        return min(values)

    for within in [set(), *subsets(sorted(best), 1)]:
        W = order_exclusion(chances, sorted(within))
        if least(within) <= chances.bar:
            assert W is None
            continue
        assert within <= W
        assert least(W) > chances.bar
        joining = sorted(set(best) - within, key=lambda s: (-best[s], s))
        assert W - within == set(joining[: len(W - within)])
        if set(best) - W:
            assert least(W | {joining[len(W - within)]}) <= chances.bar
