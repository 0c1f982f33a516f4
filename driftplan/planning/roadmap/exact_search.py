r"""Label search for the path of least exact E|e|² over a graph, with a proven lower bound.

The exact cost is not additive, but the beginning A of a path enters it only through (K, F), see
`exact_cost`: with the rest B, ``E = K_A + N_B - 2 Re(conj(F_A) b_B)``. So labels (K, F) are grown
from the start, best bound first. (Growing them from the goal works as well, but most of the cost arises far from the
goal, and there the bounds below should be sharp.) Three facts about every rest B keep the labels few:

1. *A lower bound.* With plain white noise, a heading variance of B of at most 2T and its additive cost J(B) >= d,
   ``N_B - 2 Re(conj(F) b_B) >= max(0, sqrt(Λd) - sqrt(P)|F|)² - P|F|²``, where Λ is the bracket of
   `driftplan.planning.cost.bracket` and ``P = T/(2 + T)``. (P is the value of the linear-quadratic problem
   ``min ∫2|w|² - 2 Re(conj(w) F)``, ``F' = w - F`` over time T: Riccati ``P' = (1 - P)²/2``.) With any other noise
   P = 1 and Λ = 0, since ``N_B >= |b_B|²``: a mean square is no less than the square of the mean.
2. *A bound of b.* For the same reason ``|b_B|² <= P N_B``, so that B, if it is to beat the best path, has
   ``|b_B| <= sqrt(P) (sqrt(P)|F| + sqrt(P|F|² + best - K))``; with plain noise also ``|b_B| <= (1 - exp(-T)) max |w|``,
   b being an average of levers.
3. *Dominance.* Hence label i makes label j at the same place superfluous when ``K_i + 2 max|b| |F_i - F_j| <= K_j``.
   A little slack is granted, more of it the nearer to the goal, in all ``gap`` times the best cost, and each label
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

from driftplan.arrays import Floats, Ints
from driftplan.planning.cost import bracket
from driftplan.planning.roadmap.exact_cost import Prepending

MOST_LABELS = 2_000_000  # a label takes a few hundred bytes
_COMPARED = 64  # labels at one place that later ones are compared with; the others are only extended
_HUGE = 1e300  # in place of infinity, which times zero is not a number
_SAFETY = 1 - 1e-9  # additive costs are sums of round-off and tie-breaks


@dataclass(frozen=True, eq=False, kw_only=True)
class SearchGraph:
    """A graph whose arc k leads from state ``begin[k]`` to ``end[k]`` by driving ``maps[k]``.

    Attributes
    ----------
    begin, end : (m,) arrays
        States; a search runs from ``source`` (the start) to ``target`` (the goal).
    maps : Prepending, (m,)
    node : (n,) array
        What a state's visit means to the memory: states of one node are one place. Negative: nothing.
    to_go : (n,) array
        Least additive cost between the state and the goal; infinite where nothing leads there.
    heading_room : (n,) array
        Greatest heading variance (rad²) gained between the state and the goal; infinite for no limit, or when the
        noise is not plain white noise.
    farthest : float
        Greatest distance of a node from the goal, metres.
    """

    begin: Ints
    end: Ints
    maps: Prepending
    node: Ints
    to_go: Floats
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
        Its states from source to target; None when none was better than ``upper``.
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
    most_labels: int = MOST_LABELS,
) -> ExactPath:
    """The path of least E|e|² from ``graph.source`` to ``graph.target``.

    Parameters
    ----------
    graph : SearchGraph
    upper : float
        Cost of a path that is already known, m²; what cannot beat it is not looked at.
    gap : float
        How far ``bound`` may stay below the best cost when the search ends by itself, relative to ``upper``.
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
        to_go = np.where(np.isfinite(graph.to_go), graph.to_go, 0.0) * _SAFETY
        self.root_p: list[float] = np.sqrt(P).tolist()
        self.root_d: list[float] = np.sqrt(weight * to_go).tolist()
        self.most_b: list[float] = np.where(limited, -np.expm1(-T) * graph.farthest, _HUGE).tolist()
        whole = to_go[graph.source]
        self.progress = np.clip(1 - to_go / whole, 0, 1).tolist() if whole > 0 else [0.0] * len(to_go)
        # One entry per label.
        self.K: list[float] = [0.0]
        self.F: list[complex] = [0j]
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
            if stop() or len(self.K) > most_labels:
                self.floor = min(self.floor, f)
                finished = False
                break
            K, F, visited, slack = self.K[label], self.F[label], self.visited[label], self.slack[label]
            for state, kappa_conj, shift_re, shift_im, gain, lever, bit in self.arcs.of(self.state[label]):
                if visited & bit:
                    continue
                new_K = K + gain - 2 * (F.real * shift_re + F.imag * shift_im)
                if state == target:
                    self.floor = min(self.floor, new_K - slack)
                    if new_K < self.best:
                        self.best, end = new_K, label
                    continue
                new_F = lever + kappa_conj * F
                bound = max(f, self.bound(state, new_K - slack, abs(new_F)))
                if bound >= self.best * (1 - self.gap):
                    self.floor = min(self.floor, bound)
                elif self.keeps(state, new_K, new_F, visited | bit, slack, label):
                    heappush(heap, (bound, next(order), len(self.K) - 1))
        states = None if end < 0 else np.array([*self.chain(end), target])
        return ExactPath(
            cost=self.best, states=states, bound=min(self.best, self.floor), finished=finished, labels=len(self.K)
        )

    def bound(self, state: int, K: float, F: float) -> float:
        """Fact 1: what any path through a label costs at least."""
        pull = self.root_p[state] * F
        rise = self.root_d[state] - pull
        return K - pull * pull + (rise * rise if rise > 0 else 0.0)

    def reach(self, state: int, K: float, F: float) -> float:
        """Fact 2: twice the greatest |b| of what may follow a label, if it is to beat the best path."""
        longest = self.most_b[state]
        if self.best < inf:
            root_p = self.root_p[state]
            pull = root_p * F
            longest = min(longest, root_p * (pull + sqrt(max(pull * pull + self.best - K, 0.0))))
        return 2 * longest

    def keeps(self, state: int, K: float, F: complex, visited: int, slack: float, parent: int) -> bool:
        """Fact 3: keep the label unless another stands in for it; drop those that it stands in for."""
        reach = self.reach(state, K - slack, abs(F))
        allowed = max(slack, self.gap * self.best * self.progress[state]) if self.best < inf else slack
        here = self.at.setdefault(state, [])
        for other in here:
            if self.visited[other] & ~visited:
                continue
            if K - slack - self.K[other] + self.slack[other] >= reach * abs(F - self.F[other]):
                return False
        for other in here:
            if visited & ~self.visited[other]:
                continue
            lead = self.K[other] - self.slack[other]
            distance = abs(F - self.F[other])
            if lead - K + allowed >= self.reach(state, lead, abs(self.F[other])) * distance:
                self.dropped[other] = True
        here[:] = [other for other in here if not self.dropped[other]]
        if len(here) < _COMPARED:
            here.append(len(self.K))
        self.K.append(K)
        self.F.append(F)
        self.visited.append(visited)
        self.slack.append(allowed)
        self.state.append(state)
        self.parent.append(parent)
        self.dropped.append(False)
        return True

    def chain(self, label: int) -> list[int]:
        """The states from the source to a label."""
        states = []
        while label >= 0:
            states.append(self.state[label])
            label = self.parent[label]
        return states[::-1]


class _Arcs:
    """The arcs out of each state as tuples of Python's numbers, which are faster one by one than arrays."""

    def __init__(self, graph: SearchGraph, memory: Ints | None) -> None:
        order = np.argsort(graph.begin, kind="stable")
        order = order[np.isfinite(graph.to_go[graph.end[order]])]
        self.first = np.searchsorted(graph.begin[order], np.arange(len(graph.node) + 1))
        remembered = np.unique(graph.node[graph.node >= 0]) if memory is None else np.unique(memory)
        bits = {int(node): 1 << k for k, node in enumerate(remembered)}
        self.bit = [bits.get(int(node), 0) for node in graph.node]
        self.end = graph.end[order]
        self.maps = graph.maps.pick(order)
        self.known: dict[int, list[tuple[int, complex, float, float, float, complex, int]]] = {}

    def of(self, state: int) -> list[tuple[int, complex, float, float, float, complex, int]]:
        """End state, conjugate of kappa, shift, gain, lever and memory bit of every arc out of ``state``."""
        if state not in self.known:
            here = slice(self.first[state], self.first[state + 1])
            maps, ends = self.maps.pick(here), self.end[here].tolist()
            columns = (np.conj(maps.kappa), maps.shift.real, maps.shift.imag, maps.gain, maps.lever)
            bits = [self.bit[end] for end in ends]
            self.known[state] = list(zip(ends, *(column.tolist() for column in columns), bits, strict=True))
        return self.known[state]
