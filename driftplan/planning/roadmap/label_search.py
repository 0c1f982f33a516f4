r"""Label search: the shortest walk on which the drift stays under a limit, or the walk of least drift at its end.

A label is a way from the start to a node: its length and its error states (see
`driftplan.planning.roadmap.reset_edges` and ``fused_edges``), one for every scenario of dead beacons. Labels are
expanded in order of length so far plus least length still to come, the more at once the more there are: numpy's calls
then cost next to nothing per label. A walk may come back to a node, for instance from a beacon in
a side aisle: it comes back with another error.

*Dominance.* Label 1 makes label 2 at the same node superfluous when it is no longer and, whatever is driven and read
from there, ends with no more drift: what that takes depends on the estimator (see there). Where turning costs, label 1
is first turned to the heading of label 2. ``slack_sq`` (m²) is granted in all of this, and to a filter a ``share`` of
E|e|²; with zero no walk of the graph is better than the one found.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Any

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Floats, Ints
from driftplan.planning.roadmap.beacon_graph import BeaconGraph, Effects
from driftplan.planning.roadmap.edge_steps import spans

_ASK_EVERY = 32  # labels expanded between two looks at the clock
_MOST_AT_ONCE = 8  # labels expanded at once, but no more than a share of those expanded before
_SHARE = 48
_ROOM = 1024  # labels, to begin with
_NONE = np.zeros(0, dtype=np.intp)
_Labels = dict[str, NDArray[Any]]  # columns of one length


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
    worst_drift: float  # greatest rms on its way, likewise
    finished: bool  # whether the search came to its own end
    labels: int
    bound: float  # no walk of the graph is shorter (for the least drift: 0)
    nearest: tuple[int, float]  # (node, metres) of the label nearest to the goal, to explain a failure


def best_walk(
    task: LabelProblem,
    *,
    by_end: bool = False,
    slack_sq: float = 0.0,
    share: float = 0.0,
    stop: Callable[[], bool] = lambda: False,
    max_labels: int = 1_000_000,
) -> Walk:
    """The shortest walk from start to goal that keeps the limit in every scenario; or, ``by_end``, the one no longer
    than ``task.longest`` that ends with the least rms drift."""
    return _LabelSearch(task, (slack_sq, share), stop, max_labels).run(by_end)


class _LabelSearch:
    def __init__(
        self, task: LabelProblem, slack: tuple[float, float], stop: Callable[[], bool], max_labels: int
    ) -> None:
        self.task, self.stop, self.max_labels = task, stop, max_labels
        graph = task.graph
        self.square = graph.errors.square
        self.dominates = graph.errors.dominance(task.max_gap_m, *slack, graph.worst_turn())
        self.turning = graph.turns_matter
        states = task.states.T[None]
        like = {"node": int, "parent": int, "length": float, "worst": float, "facing": complex, "dropped": bool}
        # worst: greatest E|e|² on the way, m²; facing 0: any
        self.labels: _Labels = {name: np.zeros(_ROOM, dtype=kind) for name, kind in like.items()}
        self.labels["state"] = np.zeros((_ROOM, *states.shape[1:]))
        self.labels["score"] = np.zeros((_ROOM, *self.dominates.scores(states).shape[1:]))
        self.labels |= {f"key {k}": np.zeros(_ROOM) for k in range(len(self.dominates.keys))}  # apart: they come first
        self.count = 0
        self.at: dict[int, Ints] = {}  # labels that are kept, by node
        self.heap: list[tuple[float, int]] = []

    def run(self, by_end: bool) -> Walk:
        task = self.task
        best, end, finished, expanded, looked = math.inf, -1, True, 0, -1
        nearest, bound = (task.start, float(task.to_goal[task.start])), float(task.to_goal[task.start])
        start = self.columns(1)
        start["node"][:], start["parent"][:], start["state"][:] = task.start, -1, task.states.T
        start["facing"][:] = (self.turning and task.arriving) or 0.0
        start["worst"][:] = max(float(self.square(start["state"]).max()), 0.0)
        if start["worst"][0] <= task.limit**2:
            self.offer(start)
        while batch := self.next_batch(1 + min(expanded // _SHARE, _MOST_AT_ONCE)):
            bound = max(bound, batch[0][0])
            for _, label in batch:
                node = int(self.labels["node"][label])
                if task.to_goal[node] < nearest[1]:
                    nearest = (node, float(task.to_goal[node]))
                if node == task.goal:
                    worst = float(self.square(self.labels["state"][label]).max())
                    if worst < best:
                        best, end = worst, label
            if end >= 0 and not by_end:
                break
            if expanded // _ASK_EVERY > looked:
                looked = expanded // _ASK_EVERY
                if self.stop() or self.count > self.max_labels:
                    finished = False
                    break
            expanded += len(batch)
            self.expand(np.array([label for _, label in batch]))
        nodes, label = list[int](), end
        while label >= 0:
            nodes.append(int(self.labels["node"][label]))
            label = int(self.labels["parent"][label])
        return Walk(
            nodes=tuple(nodes[::-1]) or None,
            length=float(self.labels["length"][end]) if end >= 0 else math.inf,
            end_drift=math.sqrt(max(best, 0.0)) if end >= 0 else math.inf,
            worst_drift=math.sqrt(self.labels["worst"][end]) if end >= 0 else math.inf,
            finished=finished,
            labels=self.count,
            bound=0.0 if by_end else bound if self.heap or end >= 0 or not finished else math.inf,
            nearest=nearest,
        )

    def next_batch(self, most: int) -> list[tuple[float, int]]:
        """The next labels to expand. One at the goal comes alone: until then a shorter walk may turn up."""
        batch: list[tuple[float, int]] = []
        while self.heap and len(batch) < most:
            label = self.heap[0][1]
            if not self.labels["dropped"][label]:
                at_goal = self.labels["node"][label] == self.task.goal
                if at_goal and batch:
                    break
                batch.append(self.heap[0])
                most = 1 if at_goal else most
            heappop(self.heap)
        return batch

    def expand(self, labels: Ints) -> None:
        task, graph, old = self.task, self.task.graph, self.labels
        first = graph.first[old["node"][labels]]
        count = graph.first[old["node"][labels] + 1] - first
        edge, of = spans(first, count), np.repeat(labels, count)
        length = old["length"][of] + graph.length[edge]
        fits = length + task.to_goal[graph.head[edge]] <= task.longest
        edge, of, length = edge[fits], of[fits], length[fits]
        if not len(edge):
            return
        begun = old["state"][of]
        turning = old["facing"][of] != 0
        for label in np.unique(of[turning]).tolist():
            node, mine = int(old["node"][label]), of == label
            turned = graph.turned(node, complex(old["facing"][label]), old["state"][label])
            begun[mine] = turned[edge[mine] - graph.first[node]]
        after, worst = graph.effects.driven(edge, begun)
        worst = np.where(turning[:, None], np.maximum(worst, self.square(begun)), worst)
        for s, effects in enumerate(task.dead, start=1):
            other = np.flatnonzero(np.isin(edge, effects.edge))
            if len(other):
                one, most = effects.driven(np.searchsorted(effects.edge, edge[other]), begun[other, :, s : s + 1])
                after[other, :, s], worst[other, s] = one[..., 0], most[:, 0]
        so_far = np.maximum(worst.max(axis=1), old["worst"][of])
        keeps = np.flatnonzero(so_far <= task.limit**2)
        keeps = keeps[np.lexsort((length[keeps], graph.head[edge[keeps]]))]
        new = self.columns(len(keeps))
        new["node"][:], new["parent"][:], new["length"][:] = graph.head[edge[keeps]], of[keeps], length[keeps]
        new["facing"][:] = graph.direction[edge[keeps]] if self.turning else 0.0
        new["state"][:], new["worst"][:] = after[keeps], so_far[keeps]
        self.offer(new)

    def columns(self, count: int) -> _Labels:
        """Room for so many new labels."""
        while self.count + count > len(self.labels["node"]):
            self.labels = {name: np.concatenate([x, np.zeros_like(x)]) for name, x in self.labels.items()}
        return {name: x[self.count : self.count + count] for name, x in self.labels.items()}

    def offer(self, new: _Labels) -> None:
        """Keep those of the new labels, ordered by node and length, that no other dominates; drop what they dominate.

        All pairs of a new label and another at its node are compared at once.
        """
        if not len(new["node"]):
            return
        new["score"][:], new["dropped"][:] = self.dominates.scores(new["state"]), False
        for k, key in enumerate(self.dominates.keys):
            new[f"key {k}"][:] = new["score"][:, 0, key]
        base, labels, dropped = self.count, self.labels, self.labels["dropped"]
        nodes, first, size = np.unique(new["node"], return_index=True, return_counts=True)
        group = np.repeat(np.arange(len(nodes)), size)
        shorter = np.arange(len(group)) - first[group]  # of the new ones at the node
        here = [self.at.get(node, _NONE) for node in nodes.tolist()]
        olds, count = np.concatenate(here), np.array([len(some) for some in here])
        other = olds[spans((np.cumsum(count) - count)[group], count[group])]
        mine = base + np.repeat(np.arange(len(group)), count[group])
        ahead = labels["length"][other] - labels["length"][mine]
        better = np.concatenate([other[ahead <= 0], base + spans(first[group], shorter)])
        worse = np.concatenate([mine[ahead <= 0], base + np.repeat(np.arange(len(group)), shorter)])
        dropped[worse[self.beats(better, worse)]] = True
        behind = (ahead >= 0) & ~dropped[mine]
        dropped[other[behind][self.beats(mine[behind], other[behind])]] = True
        kept = ~new["dropped"]
        ends = base + np.cumsum(np.bincount(group, kept, len(nodes)).astype(int))
        for node, some, end in zip(nodes.tolist(), here, ends.tolist(), strict=True):
            self.at[node] = np.concatenate([some[~dropped[some]], np.arange(self.count, end)])
            self.count = end
        for column in labels.values():
            column[base : self.count] = column[base : base + len(kept)][kept]
        least = labels["length"][base : self.count] + self.task.to_goal[labels["node"][base : self.count]]
        for label, f in enumerate(least.tolist(), start=base):
            heappush(self.heap, (f, label))

    def beats(self, better: Ints, worse: Ints) -> Ints:
        """Of which pairs (k,) the one label dominates the other, turned to the heading of the other: their numbers."""
        labels, rule, pairs = self.labels, self.dominates, np.arange(len(better))
        for k, slack in enumerate(rule.key_slacks):  # most pairs fail by one number
            key = labels[f"key {k}"]
            fits = key[better] <= (1 + rule.share) * key[worse] + slack
            pairs, better, worse = pairs[fits], better[fits], worse[fits]
        turn = np.zeros(len(better))
        if self.turning:
            stands, faces = labels["facing"][better], labels["facing"][worse]
            turn = np.abs(np.angle(stands * faces.conj()))
        return pairs[rule(labels["score"][better], labels["score"][worse], turn)]
