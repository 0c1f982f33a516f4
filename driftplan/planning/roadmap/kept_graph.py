"""The graph of a world, kept with it and shared by all queries: corners, samples and free motions between them do not
depend on the goal, only prices do."""

from __future__ import annotations

import math
from threading import Lock
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from scipy.spatial import cKDTree

from driftplan.arrays import Floats, Ints
from driftplan.model.noise import OdometryNoise
from driftplan.planning.roadmap.channel import channel_route, mesh_of
from driftplan.planning.roadmap.graph import Roadmap
from driftplan.planning.roadmap.polish import polished
from driftplan.planning.roadmap.prices import AdditiveCost
from driftplan.planning.roadmap.sampling import FreeSamples
from driftplan.world.world import World

_NEIGHBOURS = 10
_MOST_CORNERS, _FEWEST_SAMPLES, _MOST_SAMPLES = 6000, 300, 3000
_MAX_DRAWS = 8  # times as many samples as are wanted
_COARSE_RADII, _COARSE_SIZES = 1 / 4, 4e-4  # of the robot, and of the map: how coarse the corners are
_ANCHORS = 5  # nearest nodes among which the side of a triangle looks for one in sight
_CHUNK = 512  # points joined at once: a matter of memory
_AT_ENDS = 160  # nearest nodes that start and goal are joined to


class KeptGraph(NamedTuple):
    """Nodes (n, 2) and undirected edges (m, 2) that are free."""

    xy: Floats
    edges: Ints
    tree: Any

    @classmethod
    def of(cls, world: World) -> KeptGraph:
        """The graph of a world; made when it is first asked for, once for all threads."""
        with _MAKING:
            if world not in _GRAPHS:
                _GRAPHS[world] = cls._made(world)
            return _GRAPHS[world]

    @classmethod
    def _made(cls, world: World) -> KeptGraph:
        xmin, ymin, xmax, ymax = world.bounds
        size = math.hypot(xmax - xmin, ymax - ymin)
        corners = world.corners(max(_COARSE_RADII * world.robot_radius, _COARSE_SIZES * size))
        if len(corners) > _MOST_CORNERS:
            corners = corners[np.sort(np.random.default_rng(0).permutation(len(corners))[:_MOST_CORNERS])]
        count = int(np.clip(len(corners), _FEWEST_SAMPLES, _MOST_SAMPLES))
        samples = FreeSamples(world, np.array([0.5, 0.5]), _MAX_DRAWS).next(count, lambda points: points)
        graph = Roadmap(AdditiveCost(world, samples[0], OdometryNoise(), "length"), samples[-1])
        for points, are_corners in ((corners, True), (samples[1:-1], False)):
            for first in range(0, len(points), _CHUNK):
                graph.add(points[first : first + _CHUNK], _NEIGHBOURS, np.inf, all_round=are_corners)
        _add_passages(world, graph)
        return cls(graph.xy, graph.edges, cKDTree(graph.xy))

    def path(self, pricing: AdditiveCost, start: Floats, start_heading: float | None = None) -> Floats | None:
        """The cheapest path (k, 2) of the graph from a place to a pricing's goal, polished. Where the graph has none,
        the way over the triangles of free space joins in; None where that has none either."""
        roadmap = Roadmap(pricing, start, start_heading)
        near = self.tree.query(roadmap.xy, k=min(_AT_ENDS, len(self.xy)))[1]
        roadmap.over(self.xy, self.edges, near)
        found = roadmap.shortest()
        if not len(found.nodes) and isinstance(pricing.space, World):
            way = channel_route(pricing.space, np.stack([start, pricing.goal]))
            if way is not None:
                roadmap.add(way[1:-1], _NEIGHBOURS, np.inf, chain=True)
                found = roadmap.shortest()
        return polished(pricing, roadmap.xy[found.nodes], start_heading) if len(found.nodes) else None


def _add_passages(world: World, graph: Roadmap) -> None:
    """Make the graph lead from every triangle of free space to the next: by way of its nodes where these are near
    enough, else with the middles of the sides of triangles as nodes of their own."""
    meshes = [mesh_of(world, part) for part in np.unique(world.free_part(graph.xy)).tolist()]
    first = np.cumsum([0, *(len(mesh.middles) for mesh in meshes)])
    u, v = np.concatenate([k + mesh.distances.nonzero() for k, mesh in zip(first[:-1], meshes, strict=True)], axis=1)
    middles = np.concatenate([mesh.middles for mesh in meshes])
    if not len(middles):
        return
    near = cKDTree(graph.xy).query(middles, k=min(_ANCHORS, len(graph.xy)))[1]
    free = world.segments_free(middles[:, None], graph.xy[near])
    anchor = np.where(free.any(axis=1), near[np.arange(len(near)), free.argmax(axis=1)], -1)
    short = (anchor[u] >= 0) & (anchor[v] >= 0)
    short[short] = world.segments_free(graph.xy[anchor[u[short]]], graph.xy[anchor[v[short]]])
    kept = np.unique(np.concatenate([u[~short], v[~short]]))
    number = np.zeros(len(middles), dtype=np.int64)
    number[kept] = len(graph.xy) + np.arange(len(kept))
    anchored = kept[anchor[kept] >= 0]
    pairs = (
        (anchor[u[short]], anchor[v[short]]),
        (number[u[~short]], number[v[~short]]),
        (number[anchored], anchor[anchored]),
    )
    graph.add(middles[kept], _NEIGHBOURS, np.inf, also=np.concatenate([np.stack(pair, axis=1) for pair in pairs]))


_GRAPHS: WeakKeyDictionary[World, KeptGraph] = WeakKeyDictionary()
_MAKING = Lock()
