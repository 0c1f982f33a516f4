"""plan_on_roadmap: the path of least drift (or length) between two points of a world, by an anytime roadmap search."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from driftplan.arrays import Floats, Ints
from driftplan.errors import NoPathError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.request import format_point
from driftplan.planning.roadmap.growth import BATCHES_TO_FIND_ONE, RoadmapSearch
from driftplan.planning.roadmap.prices import AdditiveCost, Score
from driftplan.planning.status import Status
from driftplan.world.world import World


@dataclass(frozen=True, eq=False, kw_only=True)
class RoadmapResult:
    """The best path found, and the roadmap it was found on.

    Attributes
    ----------
    path : (k, 2) array
        Waypoints in metres, start and goal included.
    cost : what was minimised: the exact expected squared drift at the goal, ``predict_drift(...).end.rms ** 2`` in m²
        (zones and turns included), or the length in m
    additive_cost : the additive cost that the search ranks by, m² (or the length again)
    bound : proven: no path of the roadmap ``nodes``, ``edges`` costs less, nor does ``path``. For "drift" this covers
        the paths whose heading error at the goal has a standard deviation of up to ``bound_heading_std``. It says
        nothing about paths that leave the roadmap. Zero where nothing is known: noise that the additive cost cannot
        price (steps, systematic or correlated errors).
    bound_heading_std : rad: twice that of ``path``, or infinite where the bound covers all paths of the roadmap
    nodes, edges : (n, 2) and (m, 2) arrays
        The roadmap at the end: points in metres, and pairs of node numbers. Node 0 is the start, node 1 the goal.
    status : Status
    batches : how many were completed
    """

    path: Floats
    cost: float
    additive_cost: float
    bound: float
    bound_heading_std: float
    nodes: Floats
    edges: Ints
    status: Status
    batches: int


def plan_on_roadmap(
    world: World,
    ends: Floats,
    noise: OdometryNoise,
    *,
    minimise: Score = "drift",
    time_limit: float = 1.0,
    batches: int | None = None,
    seed: int = 0,
    start_heading: float | None = None,
    known: Sequence[Floats] = (),
) -> RoadmapResult:
    """The path on which the robot arrives with the least drift, or the shortest one.

    Parameters
    ----------
    ends : (2, 2)
        Start and goal, metres: free, apart, and in the same part of the free space.
    time_limit : seconds; while no path is known, four batches are completed in any case
    batches : stop after so many batches: with the same seed the answer is then the same on every machine fast enough
    start_heading : heading at the start in rad, counter-clockwise from +x; without it the robot already faces its first
        run
    known : sequence of (n, 2) arrays
        Collision-free paths from start to goal: the search begins with them and its path is never worse.

    Raises
    ------
    NoPathError
        If no path was found in time.

    Examples
    --------
    >>> import numpy as np
    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> ends = np.array([(2.0, 2.0), (8.0, 2.0)])
    >>> found = plan_on_roadmap(world, ends, OdometryNoise(heading_var_per_m=1e-4), batches=2)
    >>> bool(world.segments_free(found.path[:-1], found.path[1:]).all()), round(found.cost**0.5, 2)
    (True, 0.19)
    """
    began = time.perf_counter()
    cost = AdditiveCost(world, ends[1], noise, minimise)
    search = RoadmapSearch(cost, ends[0], seed=seed, start_heading=start_heading)

    def late() -> bool:
        enough = search.path is not None or search.batches >= BATCHES_TO_FIND_ONE
        return enough and time.perf_counter() - began > time_limit - search.reserve_s

    for path in known:
        search.consider(path, late)
    while not (late() or search.batches == batches or search.is_optimal):
        search.grow(late)
    if search.path is None:
        raise NoPathError(
            f"no path found from {format_point(ends[0])} to {format_point(ends[1])} within {time_limit:g} s and "
            f"{search.batches} batches, though free space connects them: allow more time"
        )
    bound = search.finish()
    done = Status.BATCHES_DONE if search.batches == batches else Status.TIME_LIMIT
    return RoadmapResult(
        path=search.path,
        cost=search.cost,
        additive_cost=search.additive_cost,
        bound=bound.mean_square,
        bound_heading_std=bound.heading_std,
        nodes=search.roadmap.xy,
        edges=search.roadmap.edges,
        status=Status.OPTIMAL if search.is_optimal else done,
        batches=search.batches,
    )
