"""plan_on_roadmap: the path of least drift (or length) between two points of a world, by an anytime roadmap search.

Each batch adds nodes (first the corners of the inflated obstacles, then ever more points of a low-discrepancy sequence,
and the waypoints of the best path so far), finds the cheapest path of the roadmap and polishes it. What cannot beat the
best path is dropped: a node whose obstacle-free geodesic bounds from the start and to the goal add up to more than the
best cost. Same seed, same batches, same path.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from driftplan.errors import GoalError, NoPathError, StartError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.path_polish import polished
from driftplan.planning.roadmap_graph import Roadmap
from driftplan.planning.roadmap_pricing import Floats, Ints, Minimise, Pricing, exact_drift
from driftplan.world.world import World

_FIRST_BATCH = 256  # samples; every later batch doubles the number drawn so far
_LARGEST_BATCH = 8192
_CHUNK = 1024  # samples joined to the roadmap before the clock is looked at again
_NEIGHBOURS = 14
# Additive recurrence by the inverse powers of the plastic number g, g³ = g + 1: evenly spread however many are drawn.
# (M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018.)
_STEP = 1.32471795724474602596 ** -np.array([1.0, 2.0])
_DRAWS = 16  # times as many points are drawn, at most, as a batch wants: the informed region may be tiny


class Status(Enum):
    """Why the search ended."""

    OPTIMAL = "Optimal: the straight run costs as little as any path can."
    BATCHES_DONE = "All batches done: the best path of the roadmap so far."
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
    nodes, edges : (n, 2) and (m, 2) arrays
        The roadmap at the end: points in metres, and pairs of node numbers. Node 0 is the start, node 1 the goal.
    status : Status
    batches : int
        How many were completed.
    """

    path: Floats
    cost: float
    additive_cost: float
    nodes: Floats
    edges: Ints
    status: Status
    batches: int


class RoadmapSearch:
    """An anytime search: `grow` adds a batch of nodes and improves `path`."""

    def __init__(self, pricing: Pricing, start: Floats, *, seed: int = 0, start_heading: float | None = None) -> None:
        self.pricing = pricing
        self.start_heading = start_heading
        self.roadmap = Roadmap(pricing, start, start_heading)
        self.batches = 0
        self.path: Floats | None = None
        self.cost = math.inf  # of the path, exact
        self.limit = math.inf  # least additive cost of any path found
        self._first_sample = np.random.default_rng(seed).random(2)
        self._drawn = 0
        self._consider(self.roadmap.shortest().nodes, lambda: False)

    @property
    def is_optimal(self) -> bool:
        """Whether no path at all can cost less than the best one found."""
        bound = float(self.pricing.lower_bound(self.roadmap.xy[0], self.roadmap.xy[1]))
        return self.path is not None and self.limit <= bound * (1 + 1e-9)

    def grow(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Add a batch of nodes, search, polish. ``stop`` ends it early; the path never gets worse."""
        roadmap = self.roadmap
        if self.batches == 0:
            roadmap.add(self._corners(coarse=True), _NEIGHBOURS, self.limit)
        elif self.batches == 2:
            roadmap.add(self._corners(coarse=False), _NEIGHBOURS, self.limit)
        if self.path is not None and len(self.path) > 2:
            roadmap.add(self.path[1:-1], _NEIGHBOURS, self.limit, chain=True)
        if stop():
            return
        samples = self._samples(min(max(self._drawn, _FIRST_BATCH), _LARGEST_BATCH))
        for first in range(0, len(samples), _CHUNK):
            roadmap.add(samples[first : first + _CHUNK], _NEIGHBOURS, self.limit)
            if stop():
                break
        else:
            self._consider(roadmap.shortest().nodes, stop)
            roadmap.prune(self.limit * (1 + 1e-9))
            self.batches += 1

    def _consider(self, nodes: Ints, stop: Callable[[], bool]) -> None:
        """Polish the path over ``nodes``; of all paths the one of least exact cost is kept."""
        if not len(nodes):
            return
        raw = self.roadmap.xy[nodes]
        for path in (raw, polished(self.pricing, raw, self.start_heading, stop)):
            additive = self.pricing.path(path, self.start_heading)
            self.limit = min(self.limit, additive)
            cost = self._exact(path, additive)
            if cost < self.cost:
                self.path, self.cost = path, cost

    def _exact(self, path: Floats, additive: float) -> float:
        if self.pricing.minimise == "length":
            return additive
        return float(exact_drift(self.pricing.space, path, self.pricing.noise, self.start_heading).end.rms) ** 2

    def _corners(self, coarse: bool) -> Floats:
        space = self.pricing.space
        if not coarse:
            return self._informed(space.corners())
        xmin, ymin, xmax, ymax = space.bounds
        radius = getattr(space, "robot_radius", 0.0)
        return self._informed(space.corners(max(radius / 4, 1e-3 * math.hypot(xmax - xmin, ymax - ymin))))

    def _samples(self, count: int) -> Floats:
        """Up to ``count`` free points that may improve the path, the next ones of the sequence."""
        xmin, ymin, xmax, ymax = self.pricing.space.bounds
        found: list[Floats] = []
        wanted = count
        for _ in range(_DRAWS):
            unit = (self._first_sample + _STEP * np.arange(self._drawn, self._drawn + count)[:, None]) % 1.0
            points = unit * (xmax - xmin, ymax - ymin) + (xmin, ymin)
            self._drawn += count
            points = self._informed(points)
            points = points[self.pricing.space.is_free(points)][:wanted]
            found.append(points)
            wanted -= len(points)
            if wanted <= 0:
                break
        return np.concatenate(found)

    def _informed(self, points: Floats) -> Floats:
        lower = self.pricing.lower_bound
        bound = lower(self.roadmap.xy[0], points) + lower(points, self.roadmap.xy[1])
        return np.asarray(points[bound < self.limit])


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
        Seconds; the first batch is completed in any case.
    batches : int, optional
        Stop after so many batches: with the same seed the answer is then the same on every machine fast enough.
    seed : int
        Of the sequence of samples.
    start_heading : float, optional
        Heading at the start in rad, counter-clockwise from +x; without it the robot already faces its first run.

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
            nodes=ends,
            edges=np.zeros((0, 2), dtype=np.int64),
            status=Status.OPTIMAL,
            batches=0,
        )
    search = RoadmapSearch(pricing, ends[0], seed=seed, start_heading=start_heading)

    def late() -> bool:
        return search.batches > 0 and time.perf_counter() - began > time_limit

    while not (late() or search.is_optimal or search.batches == batches):
        search.grow(late)
        if search.path is None:
            check_connected(world, ends)
    status = Status.OPTIMAL if search.is_optimal else Status.TIME_LIMIT if late() else Status.BATCHES_DONE
    if search.path is None:
        raise NoPathError(
            f"no path found from {said(ends[0])} to {said(ends[1])} within {time_limit:g} s and {search.batches} "
            "batches, though free space connects them: allow more time"
        )
    return RoadmapResult(
        path=search.path,
        cost=search.cost,
        additive_cost=pricing.path(search.path, start_heading),
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
    if not (isinstance(time_limit, (int, float)) and time_limit > 0):
        raise ValueError(f"expected time_limit > 0 s, got {time_limit!r}")
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
            nearest = world.nearest_free(point)
            raise error(f"{name} {said(point)} is not free; the nearest free point is {said(nearest)}")
        points.append(point)
    return np.stack(points)


def said(point: Floats) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g})"
