"""A good path by the exact cost, quickly and without proof: from the goal back, the best end of a path for every state.

Ends of paths are compared by their own ``N = E|e|²`` alone, and each state keeps one (see
`exact_cost`: what comes before an end would also look at its bias b). Where headings are lost, so
that the additive cost misleads, this still sees what is lost: N cannot exceed what a heading at random would give.
"""

from __future__ import annotations

from heapq import heappop, heappush
from math import inf

import numpy as np

from driftplan.arrays import Ints
from driftplan.planning.roadmap.exact_search import SearchGraph


def greedily_best(graph: SearchGraph) -> Ints | None:
    """States of a path from ``graph.source`` to ``graph.target`` that visits none twice; None where none leads there.

    Dijkstra's search on N, which needs N to grow as motions are prepended. It nearly always does; where it does not,
    a path may be missed.
    """
    order = np.argsort(graph.end, kind="stable")
    first = np.searchsorted(graph.end[order], np.arange(len(graph.node) + 1)).tolist()
    begin = graph.begin[order].tolist()
    kappa, shift, gain, lever = (column[order].tolist() for column in graph.maps)
    onward = [-1] * len(graph.node)
    settled = [False] * len(graph.node)
    least = [inf] * len(graph.node)
    least[graph.target] = 0.0
    heap: list[tuple[float, int, complex]] = [(0.0, graph.target, 0j)]
    while heap:
        mean_square, state, bias = heappop(heap)
        if settled[state]:
            continue
        settled[state] = True
        if state == graph.source:
            path = [state]
            while path[-1] != graph.target:
                path.append(onward[path[-1]])
            return np.array(path)
        for arc in range(first[state], first[state + 1]):
            before = begin[arc]
            if settled[before]:
                continue
            longer = mean_square + gain[arc] - 2 * (lever[arc].conjugate() * bias).real
            if longer < least[before]:
                least[before], onward[before] = longer, state
                heappush(heap, (longer, before, kappa[arc] * bias + shift[arc]))
    return None
