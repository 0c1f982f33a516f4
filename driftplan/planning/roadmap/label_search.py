r"""Label search: the shortest walk on which the drift stays under a limit, or the walk of least drift at its end.

A label is a way from the start to a node: its length and its error states (see
`driftplan.planning.roadmap.beacon_graph`), one for every scenario of dead beacons. Labels are grown in order of
length so far plus least length still to come. A walk may come back to a node, for instance from a beacon in a side
aisle: it comes back with another error.

*Dominance.* Label 1 makes label 2 at the same node superfluous when it is no longer and, whatever is driven and read
from there, ends with no more drift. A motion of displacement P until the next position reading adds to E|e|² what does
not depend on the label, and

    E|e|² + E|δ|² |P|² + 2 Re(E[e conj δ] conj P),

up to terms of the fourth order in the heading error gained on the way; a position reading keeps E|δ|² and wipes the
rest. So label 1 dominates when, with Δ = label 2 - label 1 in every scenario,

    ΔE|e|² >= 0,   ΔE|δ|² >= 0   and   ΔE|e|² + ΔE|δ|² r² - 2 |ΔE[e conj δ]| r >= 0 for every r <= R,

R being how far the most accurate robot can drive before it breaks the limit: farther no label gets without a reading.
Missed readings mix outcomes, which keeps the order. Where turning costs, label 1 is first turned to the heading of
label 2. ``slack_sq`` (m²) is granted in all of this; with zero no walk of the graph is better than the one found.
Systematic errors are not in these terms: with them dominance is a rule of thumb.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Floats
from driftplan.planning.roadmap.beacon_graph import A_IM, A_RE, BeaconGraph, D, Effects, N

_ASK_EVERY = 32  # labels expanded between two looks at the clock

Score = tuple[float, float, complex]  # E|e|², E|δ|², E[e conj δ]


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


def shortest_walk(
    task: LabelProblem, *, slack_sq: float = 0.0, stop: Callable[[], bool] = lambda: False, max_labels: int = 1_000_000
) -> Walk:
    """The shortest walk from start to goal that keeps the limit in every scenario."""
    return _LabelSearch(task, slack_sq, stop, max_labels).run(least_drift=False)


def least_drift_walk(
    task: LabelProblem, *, slack_sq: float = 0.0, stop: Callable[[], bool] = lambda: False, max_labels: int = 1_000_000
) -> Walk:
    """The walk no longer than ``task.longest`` that ends with the least rms drift and keeps the limit on the way."""
    return _LabelSearch(task, slack_sq, stop, max_labels).run(least_drift=True)


class ResetDominance:
    """Which label makes which superfluous, for a robot whose readings replace what they measure; see above.

    Another estimator has other label states, and another dominance.
    """

    def __init__(self, problem: LabelProblem, slack_sq: float) -> None:
        self.max_gap_m = problem.max_gap_m
        self.slack_N, self.slack_D = slack_sq, slack_sq / max(problem.max_gap_m, 1e-9) ** 2
        graph = problem.graph
        self.turn_rates = graph.worst_turn() if graph.turns_matter else (0.0, 0.0)

    def scores(self, states: Floats) -> list[list[Score]]:
        """What it looks at in every scenario of states (n, 9, scenarios)."""
        columns = (*(states[:, k].tolist() for k in (N, D)), (states[:, A_RE] + 1j * states[:, A_IM]).tolist())
        return [list(zip(*scenarios, strict=True)) for scenarios in zip(*columns, strict=True)]

    def __call__(self, better: Sequence[Score], worse: Sequence[Score], turn_rad: float) -> bool:
        """Whether a label that first turns by an angle drifts no more than another, whatever follows."""
        slack_N = self.slack_N - self.turn_rates[1] * turn_rad
        slack_D = self.slack_D - self.turn_rates[0] * turn_rad
        max_gap_m = self.max_gap_m
        for (N1, D1, a1), (N2, D2, a2) in zip(better, worse, strict=True):
            dN, dD = N2 - N1 + slack_N, D2 - D1 + slack_D
            if dN < 0 or dD < 0:
                return False
            lever = abs(a2 - a1)
            r = max_gap_m if lever >= max_gap_m * dD else lever / dD
            if dN + (dD * r - 2 * lever) * r < 0:
                return False
        return True


class _LabelSearch:
    def __init__(self, task: LabelProblem, slack_sq: float, stop: Callable[[], bool], max_labels: int) -> None:
        self.task, self.stop, self.max_labels = task, stop, max_labels
        graph = task.graph
        self.scenarios = len(task.states)
        self.dominates = ResetDominance(task, slack_sq)
        self.limit_sq = task.limit**2
        self.first = graph.first.tolist()
        self.row_first = graph.effects.first
        self.turning = graph.turns_matter
        self.slots = [_slots(effects, len(graph.tail)) for effects in task.dead]
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

    def run(self, least_drift: bool) -> Walk:
        task = self.task
        start = np.ascontiguousarray(task.states.T)
        best, end, finished, expanded = math.inf, -1, True, 0
        nearest, bound = (task.start, float(task.to_goal[task.start])), float(task.to_goal[task.start])
        if float(start[N].max()) <= self.limit_sq:
            self.add(task.start, 0.0, start, self.dominates.scores(start[None])[0], task.arriving, -1)
        while self.heap:
            f, label = heappop(self.heap)
            if self.dropped[label]:
                continue
            bound = max(bound, f)
            node = self.node[label]
            if task.to_goal[node] < nearest[1]:
                nearest = (node, float(task.to_goal[node]))
            if node == task.goal:
                worst = float(self.state[label][N].max())
                if worst < best:
                    best, end = worst, label
                if not least_drift:
                    break
            expanded += 1
            if expanded % _ASK_EVERY == 1 and (self.stop() or len(self.node) > self.max_labels):
                finished = False
                break
            self.expand(label)
        nodes = None if end < 0 else tuple(self.chain(end))
        return Walk(
            nodes=nodes,
            length=self.length[end] if end >= 0 else math.inf,
            end_drift=math.sqrt(max(best, 0.0)) if end >= 0 else math.inf,
            finished=finished,
            labels=len(self.node),
            bound=0.0 if least_drift else bound if self.heap or end >= 0 else math.inf,
            nearest=nearest,
        )

    def expand(self, label: int) -> None:
        task, node = self.task, self.node[label]
        lo, hi = self.first[node], self.first[node + 1]
        if lo == hi:
            return
        graph, x, facing = task.graph, self.state[label], self.facing[label]
        turns = graph.turns(node, facing) if self.turning and facing is not None else None
        begun = x if turns is None else turns @ x
        rows = slice(int(self.row_first[lo]), int(self.row_first[hi]))
        after = graph.effects.matrix[lo:hi] @ begun
        starts = self.row_first[lo:hi] - rows.start
        if turns is None:
            drifts = graph.effects.row[rows] @ x
        else:
            of_edge = np.repeat(np.arange(hi - lo), np.diff(self.row_first[lo : hi + 1]))
            drifts = np.einsum("kj,kjs->ks", graph.effects.row[rows], begun[of_edge])
        worst = np.maximum.reduceat(drifts, starts, axis=0)
        if turns is not None:
            worst = np.maximum(worst, begun[:, N])
        for s, (effects, slot) in enumerate(zip(task.dead, self.slots, strict=True), start=1):
            for k in np.flatnonzero(slot[lo:hi] >= 0).tolist():
                e = int(slot[lo + k])
                before = begun[:, s] if turns is None else begun[k, :, s]
                after[k, :, s] = effects.matrix[e] @ before
                worst[k, s] = (effects.row[effects.first[e] : effects.first[e + 1]] @ before).max()
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
        if not self.turning or facing is None or stands is None:
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

    def chain(self, label: int) -> list[int]:
        nodes = []
        while label >= 0:
            nodes.append(self.node[label])
            label = self.parent[label]
        return nodes[::-1]


def _slots(effects: Effects, edges: int) -> NDArray[np.intp]:
    slot = np.full(edges, -1, dtype=np.intp)
    slot[effects.edge] = np.arange(len(effects.edge))
    return slot
