"""The graph of a world, kept with it and shared by all queries: corners, samples and free motions between them do not
depend on the goal, only prices do."""

from __future__ import annotations

from threading import Lock
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from scipy.spatial import cKDTree

from driftplan.arrays import Floats, Ints
from driftplan.model.noise import OdometryNoise
from driftplan.planning.roadmap.channel import channel_route
from driftplan.planning.roadmap.graph import Roadmap
from driftplan.planning.roadmap.polish import polished
from driftplan.planning.roadmap.prices import AdditiveCost
from driftplan.planning.roadmap.sampling import FreeSamples, coarse_corners
from driftplan.world.world import World

_NEIGHBOURS = 10
_MOST_CORNERS, _FEWEST_SAMPLES, _MOST_SAMPLES = 6000, 300, 3000
_MAX_DRAWS = 8  # times as many samples as are wanted
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
        corners = coarse_corners(world)
        if len(corners) > _MOST_CORNERS:
            corners = corners[np.sort(np.random.default_rng(0).permutation(len(corners))[:_MOST_CORNERS])]
        count = int(np.clip(len(corners), _FEWEST_SAMPLES, _MOST_SAMPLES))
        samples = FreeSamples(world, np.array([0.5, 0.5]), _MAX_DRAWS).next(count, lambda points: points)
        graph = Roadmap(AdditiveCost(world, samples[0], OdometryNoise(), "length"), samples[-1])
        for points, are_corners in ((corners, True), (samples[1:-1], False)):
            for first in range(0, len(points), _CHUNK):
                graph.add(points[first : first + _CHUNK], _NEIGHBOURS, np.inf, all_round=are_corners)
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


_GRAPHS: WeakKeyDictionary[World, KeptGraph] = WeakKeyDictionary()
_MAKING = Lock()
