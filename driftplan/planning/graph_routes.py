"""Drift on a route graph: the way on which it is least at the goal, and what to tell a route server of every edge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import drift_with_beacons
from driftplan.errors import NoPathError
from driftplan.model.drift import Drift, predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import edge_cost, turn_cost
from driftplan.world.route_graphs import RouteGraph
from driftplan.world.world import World


@dataclass(frozen=True, eq=False)
class GraphRoute:
    """A way on a route graph.

    Attributes
    ----------
    nodes : their ids, from start to goal
    drift : along the way

    >>> corridor = RouteGraph.of_routes([np.array([[0.0, 0.0], [9.0, 0.0]])])
    >>> least, shortest = graph_routes(corridor, 0, 1, OdometryNoise(distance_var_per_m=0.01))
    >>> shortest.nodes, float(shortest.drift.end.rms)
    ((0, 1), 0.3)
    """

    nodes: tuple[int | str, ...]
    drift: Drift


def graph_routes(
    graph: RouteGraph,
    start: int | str,
    goal: int | str,
    noise: OdometryNoise,
    beacons: Sequence[Beacon] = (),
    world: World | None = None,
) -> tuple[GraphRoute, GraphRoute]:
    """The way of least rms drift at the goal on a route graph, and the shortest one.

    Without beacons the first is that of least additive cost (`driftplan.planning.cost`), turns at nodes included,
    unless the shortest drifts less. Beacons that are read on the way count in the drift of both.

    Parameters
    ----------
    start, goal : ids of nodes
    world : its walls block beacons that work in line of sight

    Raises
    ------
    NoPathError : if no edges lead from start to goal

    >>> xy = np.array([[0.0, 0.0], [10, 0], [10, 8], [0, 8]])
    >>> graph = RouteGraph((1, 2, 3, 4), xy, (5, 6, 7, 8), np.array([[0, 1], [1, 2], [0, 3], [3, 2]]))
    >>> [route.nodes for route in graph_routes(graph, 1, 3, OdometryNoise(heading_var_per_m=1e-3))]
    [(1, 2, 3), (1, 2, 3)]
    """
    ends = graph.node(start), graph.node(goal)
    a, b = graph.xy[graph.edges].transpose(1, 0, 2)
    length = np.hypot(*(b - a).T)
    ways = [_way(graph, *ends, edge_cost(a, b, graph.xy[ends[1]], noise), noise), _way(graph, *ends, length, None)]
    found = [
        GraphRoute(tuple(graph.node_ids[k] for k in way), drift_with_beacons(graph.xy[way], noise, beacons, world))
        for way in ways
    ]
    return min(found, key=lambda route: float(route.drift.end.rms)), found[1]


def _way(graph: RouteGraph, start: int, goal: int, cost: Floats, turning: OdometryNoise | None) -> list[int]:
    """Nodes of the cheapest way, found from edge to edge since turns between them cost too."""
    tail, head = graph.edges.T
    count = len(tail)
    before, after = np.nonzero(head[:, None] == tail)
    weight = cost[after]
    if turning is not None:
        course = np.angle((graph.xy[head] - graph.xy[tail]) @ [1, 1j])
        turn = (course[after] - course[before] + np.pi) % (2 * np.pi) - np.pi
        weight = weight + turn_cost(graph.xy[head[before]], turn, graph.xy[goal], turning)
    first = np.flatnonzero(tail == start)
    rows, columns = np.concatenate([before, np.full(len(first), count)]), np.concatenate([after, first])
    weights = np.maximum(np.concatenate([weight, cost[first]]), 1e-300)  # a zero would be no edge
    network = csr_array((weights, (rows, columns)), shape=(count + 1, count + 1))
    total, previous = dijkstra(network, indices=count, return_predecessors=True)
    last = np.flatnonzero((head == goal) & np.isfinite(total[:count]))
    if start == goal or not len(last):
        ids = graph.node_ids
        raise NoPathError(f"no edges of the graph lead from node {ids[start]} to another node {ids[goal]}")
    edge, nodes = int(last[np.argmin(total[last])]), [goal]
    while edge != count:
        nodes.append(int(tail[edge]))
        edge = int(previous[edge])
    return nodes[::-1]


def edge_metadata(
    graph: RouteGraph, noise: OdometryNoise, beacons: Sequence[Beacon] = (), world: World | None = None
) -> list[dict[str, Any]]:
    """What a route server may be told of every edge, in their order, for `graph_geojson`.

    ``rms_m``: the drift gained on the edge alone. With beacons also ``nearest_beacon`` to its end and
    ``nearest_beacon_m``, and ``drift_since_beacon_m``: at its end, on the shortest way over it from a node where a
    beacon is in range; left out where none leads there, since nav2 reads no null. ``penalty`` is that drift, or else
    ``rms_m``: nav2's PenaltyScorer adds it to the cost of the edge.

    >>> graph = RouteGraph((7, 8), np.array([[0.0, 0.0], [5.0, 0.0]]), (1,), np.array([[0, 1]]))
    >>> edge_metadata(graph, OdometryNoise(heading_var_per_m=1e-3))
    [{'penalty': 0.204029, 'rms_m': 0.204029}]
    """
    routes = graph.routes()
    rms = [round(float(predict_drift(route, noise).end.rms), 6) for route in routes]
    if not beacons:
        return [{"penalty": value, "rms_m": value} for value in rms]
    tail, head = graph.edges.T
    length = np.maximum(np.hypot(*(graph.xy[head] - graph.xy[tail]).T), 1e-300)
    network = csr_array((length, (tail, head)), shape=(len(graph.xy),) * 2)
    places = np.array([beacon.xy for beacon in beacons])
    away = np.hypot(*(graph.xy[:, None] - places).transpose(2, 0, 1))
    known = np.flatnonzero((away <= [beacon.kind.range_m for beacon in beacons]).any(axis=1))
    reached, previous, _ = dijkstra(network, indices=known, min_only=True, return_predecessors=True)
    found = []
    for k, (start, end) in enumerate(graph.edges.tolist()):
        since = {}
        if np.isfinite(reached[start]):
            way = [end, start]
            while previous[way[-1]] >= 0:
                way.append(int(previous[way[-1]]))
            drift = drift_with_beacons(graph.xy[way[::-1]], noise, beacons, world)
            since = {"drift_since_beacon_m": round(float(drift.end.rms), 6)}
        nearest = beacons[int(np.argmin(away[end]))]
        told = {"nearest_beacon": nearest.id, "nearest_beacon_m": round(hypot(*(nearest.xy - graph.xy[end])), 6)}
        found.append({"penalty": since.get("drift_since_beacon_m", rms[k]), "rms_m": rms[k], **since, **told})
    return found
