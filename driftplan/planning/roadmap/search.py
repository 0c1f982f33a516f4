"""plan_on_roadmap: the path of least drift (or length) between two points of a world, by an anytime roadmap search."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, Ints
from driftplan.errors import GoalError, NoPathError, StartError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.roadmap.growth import RoadmapSearch
from driftplan.planning.roadmap.prices import Minimise, Pricing
from driftplan.world.world import World

_BATCHES_TO_FIND_ONE = 4  # are completed in any case while no path is known


class Status(Enum):
    """Why the search ended."""

    OPTIMAL = "Optimal: the straight run costs as little as any path can."
    BATCHES_DONE = "All batches done: the best path of the roadmap so far."
    ITERATIONS_DONE = "All iterations done: the best path so far."
    TIME_LIMIT = "Time limit reached: the best path so far."


@dataclass(frozen=True, eq=False, kw_only=True)
class RoadmapResult:
    """The best path found, and the roadmap it was found on.

    Attributes
    ----------
    path : (k, 2) array
        Waypoints in metres, start and goal included.
    cost : float
        What was minimised: the exact expected squared drift at the goal, ``predict_drift(...).end.rms ** 2`` in m²
        (zones and turns included), or the length in m.
    additive_cost : float
        The additive cost that the search ranks by, m² (or the length again).
    bound : float
        Proven: no path of the roadmap ``nodes``, ``edges`` costs less, nor does ``path``. For "drift" this covers the
        paths whose heading error at the goal has a standard deviation of up to ``bound_heading_std``. It says nothing
        about paths that leave the roadmap. Zero where nothing is known: noise that the additive cost cannot price
        (steps, systematic or correlated errors).
    bound_heading_std : float
        rad: twice that of ``path``, or infinite where the bound covers all paths of the roadmap.
    nodes, edges : (n, 2) and (m, 2) arrays
        The roadmap at the end: points in metres, and pairs of node numbers. Node 0 is the start, node 1 the goal.
    status : Status
    batches : int
        How many were completed.
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
    start: ArrayLike,
    goal: ArrayLike,
    noise: OdometryNoise,
    *,
    minimise: Minimise = "drift",
    time_limit: float = 1.0,
    batches: int | None = None,
    seed: int = 0,
    start_heading: float | None = None,
    candidates: Sequence[Floats] = (),
) -> RoadmapResult:
    """The path on which the robot arrives with the least drift, or the shortest one.

    Parameters
    ----------
    world : World
    start, goal : (2,) array_like
        Metres.
    noise : OdometryNoise
        Outside the zones of the world.
    minimise : {"drift", "length"}
    time_limit : float
        Seconds; while no path is known, four batches are completed in any case.
    batches : int, optional
        Stop after so many batches: with the same seed the answer is then the same on every machine fast enough.
    seed : int
        Of the sequence of samples.
    start_heading : float, optional
        Heading at the start in rad, counter-clockwise from +x; without it the robot already faces its first run.
    candidates : sequence of (n, 2) arrays
        Collision-free paths from start to goal that are known: the search begins with them and its path is never worse.

    Returns
    -------
    RoadmapResult

    Raises
    ------
    ValueError
        For arguments of the wrong kind or not finite.
    StartError, GoalError
        If start or goal is not free.
    NoPathError
        If start and goal are in different parts of the free space, or no path was found in time.

    Examples
    --------
    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> found = plan_on_roadmap(world, (2, 2), (8, 2), OdometryNoise(heading_var_per_m=1e-4), batches=2)
    >>> bool(world.segments_free(found.path[:-1], found.path[1:]).all()), round(found.cost**0.5, 2)
    (True, 0.19)
    """
    began = time.perf_counter()
    ends = checked_ends(world, start, goal, noise, minimise, time_limit, batches, start_heading)
    pricing = Pricing(world, ends[1], noise, minimise)
    if (ends[0] == ends[1]).all():
        return RoadmapResult(
            path=ends,
            cost=0.0,
            additive_cost=0.0,
            bound=0.0,
            bound_heading_std=math.inf,
            nodes=ends,
            edges=np.zeros((0, 2), dtype=np.int64),
            status=Status.OPTIMAL,
            batches=0,
        )
    search = RoadmapSearch(pricing, ends[0], seed=seed, start_heading=start_heading)

    def after(seconds: float) -> bool:
        enough = search.path is not None or search.batches >= _BATCHES_TO_FIND_ONE
        return enough and time.perf_counter() - began > seconds

    def grown() -> bool:
        return after(time_limit - search.reserve_s)

    for path in candidates:
        search.consider(path, grown)
    while not (grown() or search.batches == batches or search.is_optimal):
        search.grow(grown)
        if search.path is None:
            check_connected(world, ends)
    if search.path is None:
        raise NoPathError(
            f"no path found from {said(ends[0])} to {said(ends[1])} within {time_limit:g} s and {search.batches} "
            "batches, though free space connects them: allow more time"
        )
    bound = search.finish()
    if search.is_optimal:
        status = Status.OPTIMAL
    else:
        status = Status.BATCHES_DONE if search.batches == batches else Status.TIME_LIMIT
    return RoadmapResult(
        path=search.path,
        cost=search.cost,
        additive_cost=search.additive_cost,
        bound=bound.mean_square,
        bound_heading_std=bound.heading_std,
        nodes=search.roadmap.xy,
        edges=search.roadmap.edges,
        status=status,
        batches=search.batches,
    )


def check_connected(world: World, ends: Floats) -> None:
    start_part, goal_part = world.free_part(ends)
    if start_part != goal_part:
        part = world.free_parts[start_part]
        xmin, ymin, xmax, ymax = part.bounds
        raise NoPathError(
            f"no path from {said(ends[0])} to {said(ends[1])}: a robot of radius {world.robot_radius:g} m that "
            f"starts there reaches only {part.area:.4g} m², x {xmin:.2f}..{xmax:.2f}, y {ymin:.2f}..{ymax:.2f} m"
        )


def checked_ends(
    world: World,
    start: ArrayLike,
    goal: ArrayLike,
    noise: OdometryNoise,
    minimise: str,
    time_limit: float,
    batches: int | None,
    start_heading: float | None,
) -> Floats:
    """Start and goal, (2, 2), after every argument has been looked at."""
    if not isinstance(noise, OdometryNoise):
        raise ValueError(f"expected an OdometryNoise, got {noise!r}")
    if minimise not in ("drift", "length"):
        raise ValueError(f"expected minimise 'drift' or 'length', got {minimise!r}")
    if isinstance(time_limit, bool) or not (
        isinstance(time_limit, (int, float, np.floating)) and 0 < time_limit < math.inf
    ):
        raise ValueError(f"expected time_limit > 0 s and finite, got {time_limit!r}")
    if batches is not None and not (isinstance(batches, int) and batches >= 1):
        raise ValueError(f"expected batches >= 1 or None, got {batches!r}")
    if start_heading is not None and not math.isfinite(start_heading):
        raise ValueError(f"expected start_heading finite, in rad, got {start_heading!r}")
    points = []
    for name, value, error in (("start", start, StartError), ("goal", goal, GoalError)):
        point = np.asarray(value, dtype=float)
        if point.shape != (2,) or not np.isfinite(point).all():
            raise ValueError(f"expected {name} (x, y) in metres, finite, got {value!r}")
        if not world.is_free(point):
            nearest = _nearest_sayable(world, point)
            raise error(f"{name} {said(point)} is not free; the nearest free point is {said(nearest)}")
        points.append(point)
    return np.stack(points)


def said(point: Floats) -> str:
    """A point in metres, to the millimetre."""
    x, y = (f"{round(float(c), 3) + 0.0:.3f}".rstrip("0").rstrip(".") for c in point)
    return f"({x}, {y})"


def _nearest_sayable(world: World, point: Floats) -> Floats:
    """The nearest free point, or one a little farther in that is still free when written to the millimetre."""
    nearest = world.nearest_free(point)
    way = nearest - point
    inward = way / max(float(np.linalg.norm(way)), 1e-12)
    for step in (0.0, 0.001, 0.002, 0.005, 0.02, 0.1):
        rounded = np.round(nearest + step * inward, 3)
        if world.is_free(rounded):
            return rounded
    return nearest
