r"""Label search for the path of least exact E|e|² over a graph, with a proven lower bound.

The exact cost is not additive, but a path's end enters it only through (N, b), see `driftplan.planning.exact_cost`. So
labels (N, b) are grown backwards from the goal, best bound first. With A the part still to come, ``E = N + K_A - 2
Re(conj(F_A) b)``, and three facts about every A keep their number small:

1. *A lower bound.* With plain white noise, the heading variance of A at most 2T and J(A) >= d its additive cost,
   ``K_A - 2 Re(conj(F_A) b) >= max(0, sqrt(Λd) - sqrt(P)|b|)² - P|b|²``, where Λ is the bracket of
   `driftplan.planning.cost.bracket` and ``P = T/(2 + T)``. (P is the value of the linear-quadratic problem
   ``min ∫2|w|² - 2 Re(conj(w) b)``, ``b' = w - b`` over time T: Riccati ``P' = (1 - P)²/2``.) With any other noise
   P = 1 and Λ = 0: by the law of total variance E is at least the variance N - |b|² of the end.
2. *A bound of F.* For the same reason ``|F_A|² <= P K_A``, so that A, if it is to beat the best path, has
   ``|F_A| <= sqrt(P) (sqrt(P)|b| + sqrt(P|b|² + best - N))``; with plain noise also ``|F_A| <= (1 - exp(-T)) max |w|``,
   F being an average of levers.
3. *Dominance.* Hence label i makes label j at the same place superfluous when ``N_i + 2 max|F| |b_i - b_j| <= N_j``.
   A little slack is granted, more of it the nearer to the start, in all ``gap`` times the best cost, and each label
   remembers how much it stands in for.

A path that turns in circles near the goal can be better than any that does not (it forgets a heading that is more
wrong than none). To rule that out, labels remember which of the ``memory`` nodes they have visited, never visit one
twice, and are only dominated by labels that visited a subset.

What is proven: no path of the graph that (i) visits start and goal once and no memory node twice, and (ii) gains at
most the heading variance that ``heading_room`` allows, costs less than ``bound``. All simple paths satisfy (i).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from math import inf, sqrt

import numpy as np

from driftplan.planning.cost import bracket
from driftplan.planning.exact_cost import Prepending
from driftplan.planning.roadmap_pricing import Floats, Ints

_HUGE = 1e300  # in place of infinity, which times zero is not a number
_SAFETY = 1 - 1e-9  # additive costs are sums of round-off and tie-breaks


@dataclass(frozen=True, eq=False, kw_only=True)
class SearchGraph:
    """The graph as seen from the goal: arc k leads from state ``begin[k]`` to ``end[k]`` by prepending ``maps[k]``.

    Attributes
    ----------
    begin, end : (m,) arrays
        States; a search runs from ``source`` (the goal) to ``target`` (the start).
    maps : Prepending, (m,)
    node : (n,) array
        What a state's visit means to the memory: states of one node are one place. Negative: nothing.
    to_come : (n,) array
        Least additive cost of what lies between the start and the state; infinite where nothing leads there.
    heading_room : (n,) array
        Greatest heading variance (rad²) that lies between the start and the state; infinite for no limit, or when the
        noise is not plain white noise.
    farthest : float
        Greatest distance of a node from the goal, metres.
    """

    begin: Ints
    end: Ints
    maps: Prepending
    node: Ints
    to_come: Floats
    heading_room: Floats
    source: int
    target: int
    farthest: float


@dataclass(frozen=True, eq=False, kw_only=True)
class ExactPath:
    """What `least_exact_cost` found.

    Attributes
    ----------
    cost : float
        E|e|² of the best path, m²; ``upper`` when none was better.
    states : (k,) array or None
        Its states from target to source; None when none was better than ``upper``.
    bound : float
        No path costs less; see the module's account of which paths that covers.
    finished : bool
        Whether the search ended by itself, so that ``bound`` is at most ``gap`` below the best.
    labels : int
        How many were kept.
    """

    cost: float
    states: Ints | None
    bound: float
    finished: bool
    labels: int


def least_exact_cost(
    graph: SearchGraph,
    *,
    upper: float = inf,
    gap: float = 1e-3,
    memory: Ints | None = None,
    stop: Callable[[], bool] = lambda: False,
    most_labels: int = 2_000_000,
) -> ExactPath:
    """The path of least E|e|² from ``graph.target`` to ``graph.source``.

    Parameters
    ----------
    graph : SearchGraph
    upper : float
        Cost of a path that is already known, m²; what cannot beat it is not looked at.
    gap : float
        How far, relative to the best cost, ``bound`` may stay below it when the search ends by itself.
    memory : (k,) array, optional
        Nodes that no path may visit twice; default: all, which makes paths simple and the search long.
    stop : callable
        Asked now and then; True ends the search, with the bound reached so far.
    most_labels : int
        Ends the search likewise.
    """
    return _Search(graph, upper, gap, memory).run(stop, most_labels)


class _Search:
    def __init__(self, graph: SearchGraph, upper: float, gap: float, memory: Ints | None) -> None:
        self.graph = graph
        self.best = upper
        self.gap = gap
        self.arcs = _Arcs(graph, memory)
        room = np.maximum(graph.heading_room, 0.0)
        limited = np.isfinite(room)
        T = np.where(limited, room, 0.0) / 2
        P = np.where(limited, T / (2 + T), 1.0)
        weight = np.where(limited, bracket(np.where(limited, room, 0.0) ** 0.5), 0.0)
        reachable = np.isfinite(graph.to_come)
        to_come = np.where(reachable, graph.to_come, 0.0) * _SAFETY
        self.root_p: list[float] = np.sqrt(P).tolist()
        self.root_d: list[float] = np.sqrt(weight * to_come).tolist()
        self.most_f: list[float] = np.where(limited, -np.expm1(-T) * graph.farthest, _HUGE).tolist()
        whole = to_come[graph.source]
        self.progress = np.clip(1 - to_come / whole, 0, 1).tolist() if whole > 0 else [0.0] * len(to_come)
        # One entry per label.
        self.N: list[float] = [0.0]
        self.b: list[complex] = [0j]
        self.visited: list[int] = [0]
        self.slack: list[float] = [0.0]
        self.state: list[int] = [graph.source]
        self.parent: list[int] = [-1]
        self.dropped: list[bool] = [False]
        self.at: dict[int, list[int]] = {}
        self.floor = inf  # least bound of anything that was not followed up

    def run(self, stop: Callable[[], bool], most_labels: int) -> ExactPath:
        heap: list[tuple[float, int, int]] = [(0.0, 0, 0)]
        order = count(1)
        end, finished = -1, True
        target = self.graph.target
        while heap:
            f, _, label = heappop(heap)
            if self.dropped[label]:
                continue
            if f >= self.best * (1 - self.gap):
                self.floor = min(self.floor, f)
                break
            if stop() or len(self.N) > most_labels:
                self.floor = min(self.floor, f)
                finished = False
                break
            N, b, visited, slack = self.N[label], self.b[label], self.visited[label], self.slack[label]
            for state, kappa, shift, gain, lever_re, lever_im, bit in self.arcs.of(self.state[label]):
                if visited & bit:
                    continue
                new_N = N + gain - 2 * (lever_re * b.real + lever_im * b.imag)
                new_b = kappa * b + shift
                if state == target:
                    self.floor = min(self.floor, new_N - slack)
                    if new_N < self.best:
                        self.best, end = new_N, label
                    continue
                bound = max(f, self.bound(state, new_N - slack, abs(new_b)))
                if bound >= self.best * (1 - self.gap):
                    self.floor = min(self.floor, bound)
                elif self.keeps(state, new_N, new_b, visited | bit, slack, label):
                    heappush(heap, (bound, next(order), len(self.N) - 1))
        states = None if end < 0 else np.array([target, *self.chain(end)])
        return ExactPath(
            cost=self.best, states=states, bound=min(self.best, self.floor), finished=finished, labels=len(self.N)
        )

    def bound(self, state: int, N: float, b: float) -> float:
        """Fact 1: what any path through a label costs at least."""
        pull = self.root_p[state] * b
        rise = self.root_d[state] - pull
        return N - pull * pull + (rise * rise if rise > 0 else 0.0)

    def keeps(self, state: int, N: float, b: complex, visited: int, slack: float, parent: int) -> bool:
        """Fact 3: keep the label unless another stands in for it; drop those that it stands in for."""
        reach = self.reach(state, N - slack, abs(b))
        allowed = max(slack, self.gap * self.best * self.progress[state]) if self.best < inf else slack
        here = self.at.setdefault(state, [])
        for other in here:
            if self.visited[other] & ~visited:
                continue
            if N - slack - self.N[other] + self.slack[other] >= reach * abs(b - self.b[other]):
                return False
        for other in here:
            if visited & ~self.visited[other]:
                continue
            lead = self.N[other] - self.slack[other]
            distance = abs(b - self.b[other])
            if lead - N + allowed >= self.reach(state, lead, abs(self.b[other])) * distance:
                self.dropped[other] = True
        here[:] = [other for other in here if not self.dropped[other]]
        here.append(len(self.N))
        self.N.append(N)
        self.b.append(b)
        self.visited.append(visited)
        self.slack.append(allowed)
        self.state.append(state)
        self.parent.append(parent)
        self.dropped.append(False)
        return True

    def reach(self, state: int, N: float, b: float) -> float:
        """Fact 2: twice the greatest |F| of what may come before a label, if it is to beat the best path."""
        longest = self.most_f[state]
        if self.best < inf:
            root_p = self.root_p[state]
            pull = root_p * b
            longest = min(longest, root_p * (pull + sqrt(max(pull * pull + self.best - N, 0.0))))
        return 2 * longest

    def chain(self, label: int) -> list[int]:
        """The states from a label to the source."""
        states = []
        while label >= 0:
            states.append(self.state[label])
            label = self.parent[label]
        return states


class _Arcs:
    """The arcs out of each state as tuples of Python's numbers, which are faster one by one than arrays."""

    def __init__(self, graph: SearchGraph, memory: Ints | None) -> None:
        order = np.argsort(graph.begin, kind="stable")
        order = order[np.isfinite(graph.to_come[graph.end[order]])]
        self.first = np.searchsorted(graph.begin[order], np.arange(len(graph.node) + 1))
        remembered = np.unique(graph.node[graph.node >= 0]) if memory is None else np.unique(memory)
        bits = {int(node): 1 << k for k, node in enumerate(remembered)}
        self.bit = [bits.get(int(node), 0) for node in graph.node]
        self.end = graph.end[order]
        self.maps = graph.maps.pick(order)
        self.known: dict[int, list[tuple[int, complex, complex, float, float, float, int]]] = {}

    def of(self, state: int) -> list[tuple[int, complex, complex, float, float, float, int]]:
        if state not in self.known:
            here = slice(self.first[state], self.first[state + 1])
            maps, ends = self.maps.pick(here), self.end[here].tolist()
            columns = (maps.kappa, maps.shift, maps.gain, maps.lever.real, maps.lever.imag)
            bits = [self.bit[end] for end in ends]
            self.known[state] = list(zip(ends, *(column.tolist() for column in columns), bits, strict=True))
        return self.known[state]
