"""A first route through a world, in milliseconds: from triangle to triangle of its free space."""

from __future__ import annotations

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import shapely
from scipy.sparse import csgraph, csr_matrix
from shapely.geometry import Polygon

from driftplan.arrays import Floats, Ints
from driftplan.world.world import World

_THINNING_RADII = 0.1  # of the robot, by which a thinned outline may be off: few of the arcs round corners are left
_MESHES: WeakKeyDictionary[World, dict[tuple[int, float], Mesh]] = WeakKeyDictionary()


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
