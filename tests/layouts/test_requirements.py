"""What a limit demands: the oracle agrees with brute force on every layout, and every cut it returns is valid."""

import numpy as np
import pytest

from driftplan.layouts.placement.problem import LimitSearch, placement_problem
from driftplan.layouts.scenario import Scenario, Sites
from driftplan.planning.request import DriftLimit

NAMES = ["tags", "perfect", "coarse", "two full", "mixed", "with compass", "unsure", "everything"]


def satisfied(cut, chosen):
    return cut.weights @ chosen[cut.columns] >= cut.least - 1e-9


def check_all_layouts(instance):
    limit = DriftLimit(redundancy=instance.redundancy)
    problem = placement_problem(Scenario.of(None, instance.paths, instance.noise, limit), Sites(points=instance.sites))
    search = LimitSearch.of(problem, instance.limit, np.inf)
    requirements = search.requirements([instance.limit] * len(instance.paths))
    layouts = [
        np.array([s >> i & 1 for i in range(len(instance.sites))], dtype=bool) for s in range(2 ** len(instance.sites))
    ]
    acceptable = [instance.acceptable(s) for s in range(len(layouts))]
    cuts = requirements.rows()
    for s, chosen in enumerate(layouts):
        found = requirements.cuts(chosen)
        assert (not found) == acceptable[s], f"layout {instance.members(s)}"
        assert not any(satisfied(cut, chosen) for cut in found), f"layout {instance.members(s)} meets its own cut"
        cuts += found
    for cut in cuts:
        wrong = [s for s in range(len(layouts)) if acceptable[s] and not satisfied(cut, layouts[s])]
        assert not wrong, f"{cut} excludes the acceptable layout {instance.members(wrong[0])}"


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(3))
def test_every_layout_is_judged_as_by_brute_force_and_no_cut_excludes_an_acceptable_one(
    name, seed, make_instance, kinds_named
):
    check_all_layouts(make_instance(seed, kinds_named[name], sites=(4, 6)))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(100, 130))
def test_every_layout_is_judged_as_by_brute_force_on_many_instances(name, seed, make_instance, kinds_named):
    check_all_layouts(make_instance(seed, kinds_named[name]))


@pytest.mark.parametrize("name", ["tags", "mixed", "with compass", "unsure"])
def test_looking_near_a_site_finds_what_looking_everywhere_finds(name, make_instance, kinds_named):
    instance = make_instance(11, kinds_named[name], sites=(4, 4))
    problem = placement_problem(
        Scenario.of(None, instance.paths, instance.noise, DriftLimit()), Sites(points=instance.sites)
    )
    search = LimitSearch.of(problem, instance.limit, np.inf)
    requirements = search.requirements([instance.limit] * len(instance.paths))
    n = len(instance.sites)
    for s in range(2**n):
        chosen = np.array([s >> i & 1 for i in range(n)], dtype=bool)
        if requirements.cuts(chosen):
            continue
        for site in range(n):
            changed = chosen.copy()
            changed[site] = ~changed[site]
            assert bool(requirements.cuts(changed)) == bool(requirements.cuts(changed, near=site))
