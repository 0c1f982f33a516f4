"""What is made of a world once, kept with it and shared by all queries: the triangles of its free space, over which
there is a first route in milliseconds; and a graph of corners, samples and free motions between them, which do not
depend on the goal, only prices do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Lock
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import shapely
from scipy.sparse import csgraph, csr_matrix
from scipy.spatial import cKDTree
from shapely.geometry import Polygon

from driftplan.arrays import Floats, Ints
from driftplan.model.noise import OdometryNoise
from driftplan.planning.roadmap.graph import FreeSamples, Roadmap, coarse_corners
from driftplan.planning.roadmap.prices import AdditiveCost
from driftplan.world.world import World

_THINNING_RADII = 0.1  # of the robot, by which a thinned outline may be off: few of the arcs round corners are left
_MESHES: WeakKeyDictionary[World, dict[tuple[int, float], Mesh]] = WeakKeyDictionary()
_MAKING = Lock()
_NEIGHBOURS = 10
_MOST_CORNERS, _FEWEST_SAMPLES, _MOST_SAMPLES = 6000, 300, 3000
_FEW_CORNERS = 200  # coarse ones, no more than these: then all, however fine
_MAX_DRAWS = 8  # times as many samples as are wanted
_ANCHORS = 5  # nearest nodes among which the side of a triangle looks for one in sight
_CHUNK = 512  # points joined at once: a matter of memory, and of how soon a clock is looked at again
_AT_ENDS = 160  # nearest nodes that start and goal are joined to


def channel_route(world: World, ends: Floats) -> Floats | None:
    """The shortest way (n, 2) from ``ends[0]`` to ``ends[1]`` over the middles of the inner sides of the triangles.

    It is far from the best of routes, but there is one wherever there is a route, however narrow. None only where
    round-off takes a triangle's side for an obstacle. The triangles are those within a thinned outline, which takes a
    third of the time, unless the way through them touches what was thinned away.

    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> path = channel_route(world, np.array([(2.0, 2.0), (8.0, 2.0)]))
    >>> bool(world.segments_free(path[:-1], path[1:]).all())
    True
    """
    part = int(world.free_part(ends[0]))
    for thinning_radii in (_THINNING_RADII, 0.0):
        path = mesh_of(world, part, thinning_radii).way(ends)
        if world.segments_free(path[:-1], path[1:]).all():
            return path
    return None


class Mesh(NamedTuple):
    """A polygon cut into triangles; sides that two of them share are numbered."""

    triangles: Any  # STRtree
    sides: Ints  # (t, 3) of each triangle; -1 on the outline
    middles: Floats  # (n, 2)
    distances: Any  # (n, n) sparse, between the middles of sides of one triangle

    @classmethod
    def of(cls, polygon: Polygon) -> Mesh:
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
        corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)
        x, y = (np.unique(corners[..., axis], return_inverse=True)[1].ravel() for axis in (0, 1))
        corner = np.unique(x * len(corners) * 4 + y, return_inverse=True)[1]  # each to its number
        ends = np.sort(corner.reshape(-1, 4)[:, [[0, 1], [1, 2], [2, 3]]])
        _, side, count = np.unique(ends @ [len(corner), 1], return_inverse=True, return_counts=True)
        number = np.where(count == 2, np.cumsum(count == 2) - 1, -1)
        sides = number[side.reshape(-1, 3)]
        middles = np.zeros((int((count == 2).sum()), 2))
        middles[sides[sides >= 0]] = ((corners[:, 1:] + corners[:, :-1]) / 2)[sides >= 0]
        a, b = sides.ravel(), np.roll(sides, -1, axis=1).ravel()
        a, b = a[(a >= 0) & (b >= 0)], b[(a >= 0) & (b >= 0)]
        distance = np.hypot(*(middles[a] - middles[b]).T)
        graph = csr_matrix((distance, (a, b)), shape=(len(middles), len(middles)))
        return cls(shapely.STRtree(triangles), sides, middles, graph)

    def way(self, ends: Floats) -> Floats:
        start, goal = self.triangles.nearest(shapely.points(ends))
        first, last = (self.sides[t][self.sides[t] >= 0] for t in (start, goal))
        if start == goal or not len(first) or not len(last):
            return ends
        search: Any = csgraph.dijkstra
        gone, came_from = search(self.distances, directed=False, indices=first, return_predecessors=True)
        leave = np.hypot(*(self.middles[first] - ends[0]).T)
        arrive = np.hypot(*(self.middles[last] - ends[1]).T)
        total = leave[:, None] + gone[:, last] + arrive
        k, to = np.unravel_index(int(total.argmin()), total.shape)
        way = [int(last[to])]
        while way[-1] != first[k]:
            way.append(int(came_from[k, way[-1]]))
        return np.concatenate([ends[:1], self.middles[way[::-1]], ends[1:]])


def mesh_of(world: World, part: int, thinning_radii: float = 0.0) -> Mesh:
    """The triangles of one of a world's free parts, its outline thinned out by so many radii of the robot if it bears
    that; made when they are first asked for."""
    known = _MESHES.setdefault(world, {})
    if (part, thinning_radii) not in known:
        whole = world.free_parts[part]
        thinned = shapely.simplify(whole, thinning_radii * world.robot_radius, preserve_topology=False)
        bears_it = isinstance(thinned, Polygon) and not thinned.is_empty and thinned.is_valid
        known[part, thinning_radii] = Mesh.of(thinned if thinning_radii and bears_it else whole)
    return known[part, thinning_radii]


class KeptGraph(NamedTuple):
    """Nodes (n, 2) and undirected edges (m, 2) that are free: at most 9000 nodes, and what the triangles add."""

    xy: Floats
    edges: Ints
    has_all_corners: bool  # however fine
    tree: Any

    @classmethod
    def of(cls, world: World, stop: Callable[[], bool] = lambda: False) -> KeptGraph | None:
        """The graph of a world.

        It is made when it is first asked for, once for all threads, and goes when the world does. It is the same
        whoever asks. None if ``stop``, asked every 50 ms, cuts its making short: whoever asks next goes on.
        """
        while not stop():
            with _MAKING:
                made = vars(world).get("_kept_graph")
                if isinstance(made, cls):
                    return made
                # at first; in a forked process, where no thread goes on; where Ctrl-C has ended it
                if made is None or made.gi_running or made.gi_frame is None:
                    made = _made(world)
                vars(world)["_kept_graph"] = next(made) or made
        return None

    def join(self, roadmap: Roadmap, limit: float) -> None:
        """Make the graph part of a roadmap, as far as paths that beat the cost ``limit`` can use it."""
        near = self.tree.query(roadmap.xy[:2], k=np.arange(1, 1 + min(_AT_ENDS, len(self.xy))))[1]
        space = roadmap.pricing.space
        inside = np.full(len(self.xy), True) if isinstance(space, World) else space.is_free(self.xy)
        roadmap.over(self.xy, inside, self.edges, near, limit)


def _made(world: World) -> Iterator[KeptGraph | None]:
    """Step by step; the last step gives the graph."""
    corners = coarse_corners(world)
    yield None
    if has_all_corners := len(corners) <= _FEW_CORNERS:
        corners = world.corners()
    if len(corners) > _MOST_CORNERS:
        corners = corners[np.sort(np.random.default_rng(0).permutation(len(corners))[:_MOST_CORNERS])]
    count = int(np.clip(len(corners), _FEWEST_SAMPLES, _MOST_SAMPLES))
    samples = FreeSamples(world, np.array([0.5, 0.5]), _MAX_DRAWS).next(count, lambda points: points)
    somewhere = np.array(world.free_parts[0].representative_point().coords[0])
    graph = Roadmap(AdditiveCost(world, somewhere, OdometryNoise(), "length"), somewhere)
    for points, are_corners in ((corners, True), (samples, False)):
        for first in range(0, len(points), _CHUNK):
            graph.add(points[first : first + _CHUNK], _NEIGHBOURS, np.inf, all_round=are_corners)
            yield None
    _add_passages(world, graph)
    yield KeptGraph(graph.xy, graph.edges, has_all_corners, cKDTree(graph.xy))


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
