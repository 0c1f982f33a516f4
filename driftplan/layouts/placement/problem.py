"""A placement problem as the covering core wants it: sites, costs, demands and caps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from driftplan.arrays import Bools, Floats, Ints, not_negative, whole
from driftplan.beacons.beacon import Beacon
from driftplan.layouts.placement.cut_pool import Cut
from driftplan.layouts.scenario import Scenario
from driftplan.layouts.sites import SiteGroup, Sites


@dataclass(frozen=True, kw_only=True, eq=False)
class PlacementProblem:
    """Sites (new ones, then existing beacons), what they cost, and which combinations are allowed."""

    scenario: Scenario
    sites: tuple[Beacon, ...]
    cost: Floats  # (sites,), 0 for existing ones
    fixed: Bools  # (sites,) which exist
    demands: tuple[Cut, ...]  # as `covering.cheapest_cover` takes them
    caps: tuple[Cut, ...]  # likewise
    rules: tuple[str, ...]  # what the caps are, for messages

    def chosen(self, which: Bools) -> tuple[Beacon, ...]:
        """The new beacons of a layout."""
        return tuple(self.sites[i] for i in np.flatnonzero(which & ~self.fixed))

    @property
    def existing(self) -> tuple[Beacon, ...]:
        return tuple(self.sites[i] for i in np.flatnonzero(self.fixed))


def placement_problem(
    scenario: Scenario, sites: Sites, *, max_beacons: int | None = None, budget: float | None = None
) -> PlacementProblem:
    """The problem that the arguments of `driftplan.layouts.place.place_beacons` describe."""
    listed = sites.listed(scenario.world, scenario.routes)
    number = len(listed.new)
    everyone, new = (*listed.new, *listed.existing), np.arange(number)
    demands, caps, rules = _groups(sites.groups, listed.members)
    if max_beacons is not None:
        caps.append(Cut(new, -np.ones(number), -float(whole("max_beacons", max_beacons, least=0))))
        rules.append(f"max_beacons={max_beacons}")
    if budget is not None:
        caps.append(Cut(new, -listed.costs, -not_negative("budget", budget)))
        rules.append(f"budget={budget:g}")
    if sites.min_spacing_m > 0:
        caps += _too_close(everyone, number, sites.min_spacing_m)
        rules.append(f"min_spacing_m={sites.min_spacing_m:g}")
    return PlacementProblem(
        scenario=scenario,
        sites=everyone,
        cost=np.concatenate([listed.costs, np.zeros(len(listed.existing))]),
        fixed=np.arange(len(everyone)) >= number,
        demands=tuple(demands),
        caps=tuple(caps),
        rules=tuple(rules),
    )


def _groups(groups: Sequence[SiteGroup], members: Sequence[Ints]) -> tuple[list[Cut], list[Cut], list[str]]:
    """Demands and caps of groups, and what they are."""
    demands, caps, rules = [], [], []
    for number, (group, columns) in enumerate(zip(groups, members, strict=True)):
        least = whole(f"group {number}: at_least", group.at_least, least=0)
        if least > 0:
            demands.append(Cut(columns, np.ones(len(columns)), float(least), (-2, number)))
        if group.at_most is not None:
            most = whole(f"group {number}: at_most", group.at_most, least=least)
            caps.append(Cut(columns, -np.ones(len(columns)), -float(most)))
            rules.append(f"group {number}: at_most={most}")
    return demands, caps, rules


def _too_close(sites: Sequence[Beacon], new: int, spacing_m: float) -> list[Cut]:
    """Caps that keep new sites apart from each other and from existing ones, as few as greedy cliques make them."""
    from scipy.spatial import cKDTree

    xy = np.array([[b.x, b.y] for b in sites])
    pairs = cKDTree(xy).query_pairs(spacing_m * (1 - 1e-9), output_type="ndarray")
    neighbours: dict[int, set[int]] = {}
    caps = []
    for i, j in pairs.tolist():
        if i < new <= j:
            caps.append(Cut(np.array([i]), -np.ones(1), 0.0))
        elif j < new:
            neighbours.setdefault(i, set()).add(j)
            neighbours.setdefault(j, set()).add(i)
    open_pairs = {i: {j for j in near if j > i} for i, near in neighbours.items()}
    for i in sorted(open_pairs):
        while open_pairs[i]:
            clique = [i, min(open_pairs[i])]
            for j in sorted(open_pairs[i]):
                if j not in clique and all(j in neighbours[c] for c in clique):
                    clique.append(j)
            for a in clique:
                open_pairs[a] -= set(clique)
            columns = np.array(sorted(clique), dtype=np.intp)
            caps.append(Cut(columns, -np.ones(len(columns)), -1.0))
    return caps
