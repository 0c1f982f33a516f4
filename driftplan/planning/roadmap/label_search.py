r"""Label search: the shortest walk on which the drift stays under a limit, or the walk of least drift at its end.

A label is a way from the start to a node: its length and its error states (see
`driftplan.planning.roadmap.reset_edges` and ``fused_edges``), one for every scenario of dead beacons. Labels are grown
in order of length so far plus least length still to come. A walk may come back to a node, for instance from a beacon in
a side aisle: it comes back with another error.

*Dominance.* Label 1 makes label 2 at the same node superfluous when it is no longer and, whatever is driven and read
from there, ends with no more drift: what that takes depends on the estimator (see there). Where turning costs, label 1
is first turned to the heading of label 2. ``slack_sq`` (m²) is granted in all of this; with zero no walk of the graph
is better than the one found.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np

from driftplan.arrays import Floats, Ints
from driftplan.planning.roadmap.beacon_graph import BeaconGraph, Effects
from driftplan.planning.roadmap.edge_steps import Score

_ASK_EVERY = 32  # labels expanded between two looks at the clock


@dataclass(frozen=True, eq=False, kw_only=True)
class LabelProblem:
    """What to search for."""

    graph: BeaconGraph
    start: int
    goal: int
    states: Floats  # (scenarios, 9) error states at the start
    dead: tuple[Effects, ...] = ()  # one per scenario after the first: what edges do when a beacon is dead
    to_goal: Floats  # (n,) least length from every node to the goal, metres
    limit: float  # greatest rms drift anywhere, metres, or infinity
    longest: float  # greatest length, metres
    max_gap_m: float  # R above, metres
    arriving: complex | None = None  # direction in which the robot stands at the start, None for any


@dataclass(frozen=True, eq=False, kw_only=True)
class Walk:
    """Outcome of a search."""

    nodes: tuple[int, ...] | None  # None when none was found
    length: float
    end_drift: float  # rms at its end, metres, in the worst scenario
    finished: bool  # whether the search came to its own end
    labels: int
    bound: float  # no walk of the graph is shorter (for the least drift: 0)
    nearest: tuple[int, float]  # (node, metres) of the label nearest to the goal, to explain a failure


def best_walk(
    task: LabelProblem,
    *,
    by_end: bool = False,
    slack_sq: float = 0.0,
    stop: Callable[[], bool] = lambda: False,
    max_labels: int = 1_000_000,
) -> Walk:
    """The shortest walk from start to goal that keeps the limit in every scenario; or, ``by_end``, the one no longer
    than ``task.longest`` that ends with the least rms drift."""
    return _LabelSearch(task, slack_sq, stop, max_labels).run(by_end)


class _LabelSearch:
    def __init__(self, task: LabelProblem, slack_sq: float, stop: Callable[[], bool], max_labels: int) -> None:
        self.task, self.stop, self.max_labels = task, stop, max_labels
        graph = task.graph
        self.scenarios = len(task.states)
        self.square = graph.errors.square
        self.dominates = graph.errors.dominance(task.max_gap_m, slack_sq, graph.worst_turn())
        self.limit_sq = task.limit**2
        self.first = graph.first.tolist()
        self.turning = graph.turns_matter
        self.of_edge = [_rows_of_edges(effects, len(graph.tail)) for effects in task.dead]
        # one entry per label
        self.node: list[int] = []
        self.length: list[float] = []
        self.state: list[Floats] = []  # (9, scenarios)
        self.score: list[list[Score]] = []
        self.facing: list[complex | None] = []
        self.parent: list[int] = []
        self.dropped: list[bool] = []
        self.at: dict[int, list[int]] = {}
        self.heap: list[tuple[float, int]] = []

    def run(self, by_end: bool) -> Walk:
        task = self.task
        start = np.ascontiguousarray(task.states.T)
        best, end, finished, expanded = math.inf, -1, True, 0
        nearest, bound = (task.start, float(task.to_goal[task.start])), float(task.to_goal[task.start])
        if float(self.square(start).max()) <= self.limit_sq:
            facing = task.arriving if self.turning else None
            self.add(task.start, 0.0, start, self.dominates.scores(start[None])[0], facing, -1)
        while self.heap:
            f, label = heappop(self.heap)
            if self.dropped[label]:
                continue
            bound = max(bound, f)
            node = self.node[label]
            if task.to_goal[node] < nearest[1]:
                nearest = (node, float(task.to_goal[node]))
            if node == task.goal:
                worst = float(self.square(self.state[label]).max())
                if worst < best:
                    best, end = worst, label
                if not by_end:
                    break
            expanded += 1
            if expanded % _ASK_EVERY == 1 and (self.stop() or len(self.node) > self.max_labels):
                finished = False
                break
            self.expand(label)
        nodes, label = list[int](), end
        while label >= 0:
            nodes.append(self.node[label])
            label = self.parent[label]
        return Walk(
            nodes=tuple(nodes[::-1]) or None,
            length=self.length[end] if end >= 0 else math.inf,
            end_drift=math.sqrt(max(best, 0.0)) if end >= 0 else math.inf,
            finished=finished,
            labels=len(self.node),
            bound=0.0 if by_end else bound if self.heap or end >= 0 else math.inf,
            nearest=nearest,
        )

    def expand(self, label: int) -> None:
        task, node = self.task, self.node[label]
        lo, hi = self.first[node], self.first[node + 1]
        if lo == hi:
            return
        graph, x, facing = task.graph, self.state[label], self.facing[label]
        begun = x if facing is None else graph.turned(node, facing, x)
        after, worst = graph.effects.driven(slice(lo, hi), begun)
        if facing is not None:
            worst = np.maximum(worst, self.square(begun))
        for s, (effects, row) in enumerate(zip(task.dead, self.of_edge, strict=True), start=1):
            for k in np.flatnonzero(row[lo:hi] >= 0).tolist():
                e = int(row[lo + k])
                before = begun[..., s : s + 1] if begun.ndim == 2 else begun[k : k + 1, :, s : s + 1]
                one, most = effects.driven(slice(e, e + 1), before)
                after[k, :, s], worst[k, s] = one[0, :, 0], most[0, 0]
        length = self.length[label] + graph.length[lo:hi]
        heads = graph.head[lo:hi]
        fits = np.flatnonzero((worst.max(axis=1) <= self.limit_sq) & (length + task.to_goal[heads] <= task.longest))
        scores = self.dominates.scores(after[fits])
        for i, (k, to, driven) in enumerate(
            zip(fits.tolist(), heads[fits].tolist(), length[fits].tolist(), strict=True)
        ):
            facing = complex(graph.direction[lo + k]) if self.turning else None
            self.offer(to, driven, after[k], scores[i], facing, label)

    def offer(
        self, node: int, length: float, state: Floats, score: list[Score], facing: complex | None, parent: int
    ) -> None:
        """Keep the new label unless another dominates it; drop those that it dominates."""
        here = self.at.get(node, [])
        for place, other in enumerate(here):
            if self.length[other] <= length and self.dominates(self.score[other], score, self.turn(other, facing)):
                here.insert(0, here.pop(place))  # it is likely to dominate the next one too
                return
        dropped = False
        for other in here:
            if length <= self.length[other] and self.dominates(score, self.score[other], self.turn(other, facing)):
                self.dropped[other] = dropped = True
        if dropped:
            self.at[node] = [other for other in here if not self.dropped[other]]
        self.add(node, length, state, score, facing, parent)

    def turn(self, other: int, facing: complex | None) -> float:
        """Angle between the heading of a label and another."""
        stands = self.facing[other]
        if facing is None or stands is None:
            return 0.0
        return abs(math.atan2((facing * stands.conjugate()).imag, (facing * stands.conjugate()).real))

    def add(
        self, node: int, length: float, state: Floats, score: list[Score], facing: complex | None, parent: int
    ) -> None:
        label = len(self.node)
        self.node.append(node)
        self.length.append(length)
        self.state.append(state)
        self.score.append(score)
        self.facing.append(facing)
        self.parent.append(parent)
        self.dropped.append(False)
        self.at.setdefault(node, []).append(label)
        heappush(self.heap, (length + float(self.task.to_goal[node]), label))


def _rows_of_edges(effects: Effects, edges: int) -> Ints:
    """Which row of the effects each edge has; -1 where a death changes nothing."""
    row = np.full(edges, -1, dtype=np.intp)
    row[effects.edge] = np.arange(len(effects.edge))
    return row
