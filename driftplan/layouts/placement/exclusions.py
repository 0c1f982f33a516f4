"""Sets of sites that cannot hold a slot of a route by themselves, as large as possible: from them cuts are made.

If no subset of a set W keeps the limit in a slot, every acceptable layout has sites outside W. How to be sure of it:

* Sure readings, some of which fix position and heading and some only the position (`pair_exclusions`): what happens in
  the slot depends on the last position reading and on the last reading that fixed the heading before it. W must hold no
  pair that is good enough, nor a full reading that is.
* Readings that may fail (`chance_exclusion`, `order_exclusion`): E|e|² is an average over which reading came last.
  Whatever the order, it is at least E[min of v_s over the sites s that are read], v_s the least E|e|² in the slot after
  a reading of s; and with the readings e_1, e_2, … in driving order, no subset of W has less than

      F_0 = V_start,    F_t = min(F_{t-1}, chance_t V_t + (1 - chance_t) F_{t-1}).

All values are compared with the limit squared and a margin for rounding, on the side on which cuts stay valid.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Bools, Floats, Ints


class Pairs(NamedTuple):
    """What can hold a slot on a route of sure readings."""

    site: Ints  # (n,) sites read before the slot
    turns: Bools  # (n,) whether they fix the heading
    alone: Bools  # (n,) whether the site's last reading holds it by itself, or with the heading known at the start
    together: Bools  # (n, n) whether the heading of row's last reading and the position of column's, later, hold it


def pair_exclusions(pairs: Pairs, within: Bools) -> Iterator[Bools]:
    """Largest sets W that contain ``within`` (n,) and cannot hold the slot; none if ``within`` can.

    Grown twice: sites that fix headings come in last, and first.
    """
    if (pairs.alone & within).any() or pairs.together[np.ix_(within, within)].any():
        return
    turns = pairs.turns
    for first in (~turns, turns):  # pairs are of one site of each sort: sites of one sort never hinder each other
        W = within.copy()
        for sort in (first, ~first):
            held = pairs.together[W].any(axis=0) | pairs.together[:, W].any(axis=1)
            W = W | (sort & ~pairs.alone & ~held)
        yield W


class Chances(NamedTuple):
    """Readings before a slot on a route on which readings may fail, in driving order."""

    start: float  # least E|e|² in the slot if nothing is read
    site: Ints  # (readings,) whose reading
    chance: Floats  # (readings,) its chance
    square: Floats  # (readings,) the least E|e|² in the slot if it is the last
    bar: float  # what E|e|² must not exceed


def chance_exclusion(chances: Chances, within: Sequence[int]) -> tuple[set[int], int]:
    """A set W, ``within`` included, and how many sites outside it are needed at least (0: W may do).

    By the bound that holds in whatever order sites are read.
    """
    site, of = np.unique(chances.site, return_inverse=True)
    least = np.full(len(site), np.inf)
    np.minimum.at(least, of, chances.square)
    missed = np.ones(len(site))
    np.multiply.at(missed, of, 1 - chances.chance)
    order = np.lexsort((site, -least))  # the least helpful first
    site, least, missed = site[order], least[order], missed[order]
    free = ~np.isin(site, list(within)) & (least <= chances.bar)

    def needed(some_free: Bools, at_most: int) -> int:
        """Fewest of the free sites with which all others may do, at_most + 1 if they are not enough."""
        value = np.full(at_most + 1, chances.start)
        for least_square, miss, costs in zip(least.tolist(), missed.tolist(), some_free.tolist(), strict=True):
            if costs:
                value[1:] = np.minimum(value[1:], (1 - miss) * least_square + miss * value[:-1])
            else:
                value = np.minimum(value, (1 - miss) * least_square + miss * value)
        enough = np.flatnonzero(value <= chances.bar)
        return int(enough[0]) if len(enough) else at_most + 1

    need = needed(free, 8)
    if need == 0:
        return set(), 0
    places = np.flatnonzero(free)

    def lowers_need(number: int) -> bool:
        """Whether it does when so many of the least helpful free sites join W."""
        fewer = free.copy()
        fewer[places[:number]] = False
        return needed(fewer, need) < need

    free[places[: bisect_left(range(1, len(places) + 1), True, key=lowers_need)]] = False
    return set(site[~free].tolist()), need


def order_exclusion(chances: Chances, within: Sequence[int]) -> set[int] | None:
    """A set W around ``within`` that cannot hold the slot in the order in which it is read; None if ``within`` can."""
    best: dict[int, float] = {}
    readings = list(zip(chances.site.tolist(), chances.chance.tolist(), chances.square.tolist(), strict=True))
    for site, _, square in readings:
        best[site] = min(square, best.get(site, np.inf))

    def least(W: set[int]) -> float:
        value = chances.start
        for site, chance, square in readings:
            if site in W:
                value = min(value, chance * square + (1 - chance) * value)
        return value

    W = set(within)
    if least(W) <= chances.bar:
        return None
    others = sorted((site for site in best if site not in W), key=lambda site: (-best[site], site))
    counts = range(1, len(others) + 1)
    return W.union(others[: bisect_left(counts, True, key=lambda n: least(W.union(others[:n])) <= chances.bar)])
