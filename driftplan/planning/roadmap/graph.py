"""A roadmap: points of free space joined by straight collision-free motions, grown in batches and searched in bulk.

Nodes 0 and 1 are start and goal. New nodes are joined to their nearest neighbours, edges that no improving path can
use are dropped before they are checked for collisions, and all of it is done by numpy, scipy and shapely on arrays.

Nodes lie at corners of the inflated obstacles, at even samples of free space and at places within range of beacons.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csgraph, csr_matrix
from scipy.spatial import cKDTree

from driftplan.arrays import Bools, Floats, Ints
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import BeaconColumns
from driftplan.planning.roadmap.prices import AdditiveCost, Space
from driftplan.world.world import World

START, GOAL = 0, 1
_LOOK_ROUND = 160  # nearest nodes of a corner among which it looks for the nearest in every direction
_SECTORS, _PER_SECTOR = 8, 3
# Additive recurrence by the inverse powers of the plastic number g, g³ = g + 1: evenly spread however many are drawn.
# (M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018.)
_STEP = 1.32471795724474602596 ** -np.array([1.0, 2.0])
_DIRECTIONS = 8  # in which a place within range is looked for
_DEPTHS = (0.35, 0.7)  # in units of the range


class Shortest(NamedTuple):
    """The cheapest path of a roadmap: its cost, infinite when there is none, and its nodes."""

    cost: float
    nodes: Ints


class Transitions(NamedTuple):
    """Directed edges of a roadmap and the turns between them."""

    tail: Ints  # (d,)
    head: Ints  # (d,)
    edge: Ints  # (d,) which undirected edge it is
    cost: Floats  # (d,)
    zone: Ints  # (d,) in which the edge leaves its tail
    before: Ints  # (t,) directed edges
    after: Ints  # (t,) that can follow each other
    turn_rad: Floats  # (t,) angle between them
    turn_cost: Floats  # (t,)


class Roadmap:
    """Nodes (n, 2) and undirected edges (m, 2) towards the goal of an `AdditiveCost`."""

    def __init__(self, pricing: AdditiveCost, start: Floats, start_heading: float | None = None) -> None:
        self.pricing = pricing
        self.start_heading = start_heading
        self.xy = np.stack([start, pricing.goal])
        self.edges = np.zeros((0, 2), dtype=np.int64)
        self.prices = pricing.edges(self.xy[:0], self.xy[:0])
        self.from_start, self.to_goal = self._bounds(self.xy)
        self._connect(np.array([[START, GOAL]]), math.inf)

    def add(
        self,
        points: Floats,
        neighbours: int,
        limit: float,
        *,
        chain: bool = False,
        all_round: bool = False,
        also: Ints | None = None,
    ) -> None:
        """Add free ``points`` (k, 2), each with edges to its nearest nodes.

        With ``chain`` they are the waypoints of a path between start and goal, which is added too. With ``all_round``
        they are corners: they crowd together, so each is also joined to the nearest ones in every direction. Edges
        between the pairs of nodes ``also`` (p, 2), old or new, are added where they are free.

        ``limit`` is the cost that paths through the new edges must be able to beat.
        """
        first, count = len(self.xy), len(points)
        if not count and also is None:
            return
        self.xy = np.concatenate([self.xy, points])
        from_start, to_goal = self._bounds(points)
        self.from_start, self.to_goal = np.append(self.from_start, from_start), np.append(self.to_goal, to_goal)
        k = min(neighbours + 1, len(self.xy))
        tree = cKDTree(self.xy)
        _, near = tree.query(points, k=k)
        pairs = [np.stack([np.repeat(np.arange(first, first + count), k), near.ravel()], axis=1)]
        if chain:
            along = np.concatenate([[START], np.arange(first, first + count), [GOAL]])
            pairs.append(np.stack([along[:-1], along[1:]], axis=1))
        if all_round:
            _, far = tree.query(points, k=min(_LOOK_ROUND, len(self.xy)))
            pairs.append(_nearest_all_round(self.xy, np.arange(first, first + count), np.asarray(far)))
        if also is not None:
            also, key = np.sort(also, axis=1), np.array([len(self.xy), 1])
            pairs.append(also[~np.isin(also @ key, self.edges @ key)])
        self._connect(np.concatenate(pairs), limit)

    def over(self, xy: Floats, inside: Bools, edges: Ints, near: Ints, limit: float) -> None:
        """Take the nodes and free edges of another graph, those ``inside`` that paths that cost less than ``limit`` can
        use, and edges from start and goal to the nodes ``near`` them, (2, k)."""
        from_start, to_goal = self._bounds(xy)
        keep = inside & (from_start + to_goal < limit)
        number, ends = len(self.xy) + np.cumsum(keep) - 1, np.repeat([START, GOAL], near.shape[1])
        edges, at_ends = number[edges[keep[edges].all(axis=1)]], keep[near.ravel()]
        self.xy = np.concatenate([self.xy, xy[keep]])
        self.from_start = np.append(self.from_start, from_start[keep])
        self.to_goal = np.append(self.to_goal, to_goal[keep])
        self.edges = np.concatenate([self.edges, edges])
        self.prices = self.prices.joined(self.pricing.edges(self.xy[edges[:, 0]], self.xy[edges[:, 1]]))
        self._connect(np.stack([ends, number[near.ravel()]], axis=1)[at_ends], limit)

    def prune(self, limit: float) -> None:
        """Drop the nodes and edges that no path cheaper than ``limit`` can use."""
        keep = self.from_start + self.to_goal < limit
        keep[:2] = True
        number = np.cumsum(keep) - 1
        useful = keep[self.edges].all(axis=1) & self._promising(self.edges, self.prices.cost, limit)
        self.edges, self.prices = number[self.edges[useful]], self.prices.pick(useful)
        self.xy, self.from_start, self.to_goal = self.xy[keep], self.from_start[keep], self.to_goal[keep]

    def shortest(self, limit: float = math.inf) -> Shortest:
        """The cheapest path from start to goal, turns on the spot included; none if it costs more than ``limit``."""
        if not len(self.edges):
            return Shortest(math.inf, np.zeros(0, dtype=np.int64))
        if self.pricing.has_turns:
            return self._shortest_with_turns(limit)
        distance, before = self.distances(self.prices.cost + self._tie_break(), START)
        if not math.isfinite(distance[GOAL]):
            return Shortest(math.inf, np.zeros(0, dtype=np.int64))
        return self._priced(_traced(before, GOAL))

    def distances(self, weight: Floats, node: int) -> tuple[Floats, NDArray[np.int32]]:
        """Least sum of the edges' ``weight`` from ``node`` to every node, and each one's predecessor on the way."""
        return _dijkstra(weight, self.edges[:, 0], self.edges[:, 1], len(self.xy), node, directed=False)

    def transitions(self, limit: float = math.inf) -> Transitions:
        """Every pair of edges that can be driven one after the other, there and straight back excluded.

        Edges that no path cheaper than ``limit`` uses, turns left out, are left out.
        """
        m = len(self.edges)
        cost = self.prices.cost
        arc = np.arange(2 * m)
        tail, head = self.edges.T.ravel(), self.edges[:, ::-1].T.ravel()
        if math.isfinite(limit):
            from_start, _ = self.distances(cost, START)
            to_goal, _ = self.distances(cost, GOAL)
            arc = np.flatnonzero(from_start[tail] + np.tile(cost, 2) + to_goal[head] <= limit * (1 + 1e-9))
        tail, head, edge = tail[arc], head[arc], arc % m
        zone = np.concatenate([self.prices.zone_a, self.prices.zone_b])[arc]
        order = np.argsort(tail, kind="stable")
        degree = np.bincount(tail, minlength=len(self.xy))
        first = np.cumsum(degree) - degree
        choices = degree[head]
        before = np.repeat(np.arange(len(arc)), choices)
        rank = np.arange(len(before)) - np.repeat(np.cumsum(choices) - choices, choices)
        after = order[first[head[before]] + rank]
        keep = edge[after] != edge[before]
        before, after = before[keep], after[keep]
        step = (self.xy[head] - self.xy[tail]) @ np.array([1.0, 1j])
        turn = np.angle(step[after] * np.conj(step[before]))
        turn_cost = self.pricing.turns(self.xy[tail[after]], turn, zone[after])
        return Transitions(tail, head, edge, cost[edge], zone, before, after, turn, turn_cost)

    def first_turns(self, moves: Transitions) -> tuple[Ints, Floats, Floats]:
        """The directed edges that leave the start, the turn (rad) before each from the start heading, and its cost."""
        leaving = np.flatnonzero(moves.tail == START)
        if self.start_heading is None:
            return leaving, np.zeros(len(leaving)), np.zeros(len(leaving))
        step = (self.xy[moves.head[leaving]] - self.xy[START]) @ np.array([1.0, 1j])
        turn = np.angle(step * np.exp(-1j * self.start_heading))
        return leaving, turn, self.pricing.turns(self.xy[moves.tail[leaving]], turn, moves.zone[leaving])

    def _shortest_with_turns(self, limit: float) -> Shortest:
        """Dijkstra over directed edges: node e of this graph is 'edge e has been driven', the last is the start."""
        if limit == math.inf:  # no path is cheaper than the cheapest without turns, and turns may be many
            distance, before = self.distances(self.prices.cost + self._tie_break(), START)
            if not math.isfinite(distance[GOAL]):
                return Shortest(math.inf, np.zeros(0, dtype=np.int64))
            limit = self._priced(_traced(before, GOAL)).cost * (1 + 1e-9)
        moves = self.transitions(limit)
        leaving, _, turn_cost = self.first_turns(moves)
        source = len(moves.tail)
        row = np.append(moves.before, np.full(len(leaving), source))
        column = np.append(moves.after, leaving)
        weight = (moves.cost + self._tie_break()[moves.edge])[column] + np.append(moves.turn_cost, turn_cost)
        distance, before = _dijkstra(weight, row, column, source + 1, source, directed=True)
        arriving = np.flatnonzero(moves.head == GOAL)
        if not len(arriving) or not math.isfinite(distance[arriving].min()):
            return Shortest(math.inf, np.zeros(0, dtype=np.int64))
        driven = _traced(before, int(arriving[np.argmin(distance[arriving])]))[1:]
        return self._priced(np.append(moves.tail[driven], GOAL))

    def _priced(self, nodes: Ints) -> Shortest:
        return Shortest(self.pricing.path(self.xy[nodes], self.start_heading), nodes)

    def _connect(self, pairs: NDArray[np.int64], limit: float) -> None:
        pairs = np.unique(np.sort(pairs, axis=1), axis=0)
        a, b = self.xy[pairs[:, 0]], self.xy[pairs[:, 1]]
        apart = (a != b).any(axis=1)
        pairs, a, b = pairs[apart], a[apart], b[apart]
        prices = self.pricing.edges(a, b)
        cheap = self._promising(pairs, prices.cost, limit)
        free = np.zeros(len(pairs), dtype=bool)
        free[cheap] = self.pricing.space.segments_free(a[cheap], b[cheap])
        self.edges = np.concatenate([self.edges, pairs[free]])
        self.prices = self.prices.joined(prices.pick(free))

    def _promising(self, pairs: NDArray[np.int64], cost: Floats, limit: float) -> NDArray[np.bool_]:
        """Whether a path through the edge, driven the better way round, could be cheaper than ``limit``."""
        i, j = pairs[:, 0], pairs[:, 1]
        around = np.minimum(self.from_start[i] + self.to_goal[j], self.from_start[j] + self.to_goal[i])
        return np.asarray(around + cost <= limit)

    def _bounds(self, points: Floats) -> tuple[Floats, Floats]:
        lower = self.pricing.lower_bound
        return lower(self.xy[START], points), lower(points, self.xy[GOAL])

    def _tie_break(self) -> Floats:
        """A price too small to matter: where driving costs nothing, the shorter way is taken."""
        length = np.linalg.norm(self.xy[self.edges[:, 0]] - self.xy[self.edges[:, 1]], axis=1)
        scale = float(self.prices.cost.max(initial=0.0)) or 1.0
        return np.asarray(length * (1e-12 * scale / max(float(length.max(initial=0.0)), 1e-300)))


def _nearest_all_round(xy: Floats, nodes: Ints, near: Ints) -> Ints:
    """Pairs of each node and the nearest few in each of eight directions, of its neighbours ``near`` by distance."""
    away = (xy[near] - xy[nodes, None]) @ np.array([1.0, 1j])
    sector = np.round(np.angle(away) * (_SECTORS / (2 * np.pi))).astype(np.int64) % _SECTORS
    sector[away == 0] = -1
    pairs = []
    for direction in range(_SECTORS):
        inside = sector == direction
        row, column = np.nonzero(inside & (np.cumsum(inside, axis=1) <= _PER_SECTOR))
        pairs.append(np.stack([nodes[row], near[row, column]], axis=1))
    return np.concatenate(pairs)


def _dijkstra(
    weight: Floats, row: Ints, column: Ints, size: int, source: int, *, directed: bool
) -> tuple[Floats, NDArray[np.int32]]:
    """Distance of every node from ``source``, and the node before it on the way (negative where there is none)."""
    search: Any = csgraph.dijkstra
    graph = csr_matrix((weight, (row, column)), shape=(size, size))
    distance, before = search(graph, directed=directed, indices=source, return_predecessors=True)
    return distance, before


def _traced(before: NDArray[np.int32], end: int) -> Ints:
    """The chain of predecessors that leads to ``end``, in driving order."""
    chain = [end]
    while (previous := int(before[chain[-1]])) >= 0:
        chain.append(previous)
    return np.array(chain[::-1], dtype=np.int64)


def coarse_corners(space: Space) -> Floats:
    """Corners of a space, (n, 2), those that crowd together left out."""
    xmin, ymin, xmax, ymax = space.bounds
    radius = getattr(space, "robot_radius", 0.0)
    return space.corners(max(radius / 4, 4e-4 * math.hypot(xmax - xmin, ymax - ymin)))


class FreeSamples:
    """A low-discrepancy sequence of points over a space, of which the free and useful ones are taken.

    It begins at ``first`` (2,) of the unit square. At most ``max_draws`` times as many points are drawn as are wanted:
    the useful region may be tiny.
    """

    def __init__(self, space: Space, first: Floats, max_draws: int) -> None:
        self._space, self._first, self._max_draws = space, first, max_draws
        self._drawn = 0

    def next(self, count: int, useful: Callable[[Floats], Floats]) -> Floats:
        """Up to ``count`` free points of those that ``useful`` keeps, the next ones of the sequence."""
        xmin, ymin, xmax, ymax = self._space.bounds
        found: list[Floats] = [np.zeros((0, 2))]
        wanted = count
        for _ in range(self._max_draws):
            unit = (self._first + _STEP * np.arange(self._drawn, self._drawn + count)[:, None]) % 1.0
            self._drawn += count
            points = useful(unit * (xmax - xmin, ymax - ymin) + (xmin, ymin))
            points = points[self._space.is_free(points)][:wanted]
            found.append(points)
            wanted -= len(points)
            if wanted <= 0:
                break
        return np.concatenate(found)


def places_in_range(space: Space, world: World | None, beacons: Sequence[Beacon], max_places: int) -> Floats:
    """Free points within range of each beacon, and in its sight where that matters: the nearest, then others spread
    around it; about ``max_places`` in all, (n, 2)."""
    if not beacons:
        return np.zeros((0, 2))
    columns = BeaconColumns.of(beacons)
    per = int(np.clip(max_places // len(beacons), 1, _DIRECTIONS))
    angle = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    offsets = np.concatenate([np.zeros((1, 2)), *(depth * circle for depth in _DEPTHS)])
    places = columns.xy[:, None, :] + columns.range_m[:, None, None] * offsets
    good = space.is_free(places)
    if world is not None:
        asked = good & columns.must_see[:, None]
        good[asked] = world.line_of_sight(places[asked], columns.xy[np.nonzero(asked)[0]])
    # the nearest first, then one direction after the other with big steps
    spread = (3 * np.arange(_DIRECTIONS)) % _DIRECTIONS
    order = np.concatenate([[0], *(1 + _DIRECTIONS * ring + spread for ring in range(len(_DEPTHS)))])
    rank = np.cumsum(good[:, order], axis=1)
    chosen = good[:, order] & (rank <= per)
    return np.asarray(places[:, order][chosen])
