"""plan_on_roadmap: the path of least drift (or length) between two points of a world, by an anytime roadmap search.

Each batch adds nodes (ever more points of a low-discrepancy sequence, the corners of the inflated obstacles, and the
waypoints of the best path so far), finds the cheapest path of the roadmap and polishes it. What cannot beat the
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
from driftplan.planning.cost import bracket
from driftplan.planning.exact_cost import turns_matter
from driftplan.planning.exact_polish import ExactJudge
from driftplan.planning.exact_roadmap import GAP, TIMES, Bound, bracketed, exactly_best, is_plain
from driftplan.planning.path_polish import polished, refined
from driftplan.planning.roadmap_graph import Roadmap
from driftplan.planning.roadmap_pricing import Floats, Ints, Minimise, Pricing, exact_drift
from driftplan.world.world import World

_FIRST_BATCH = 128  # samples; every later batch has twice as many, and the next two have corners too
_LARGEST_BATCH = 8192
_MOST_NODES = 40_000  # then a new roadmap is begun
_CHUNK = 1024  # samples joined to the roadmap before the clock is looked at again
_FEW_CORNERS = 200  # no more than these: then all of them at once
_NEIGHBOURS = 14
_BATCHES_TO_FIND_ONE = 4  # are completed, whatever the time, while no path is known
_EXACT_SHARE = 0.4  # of the time goes into the roadmap that is then searched exactly
_EXACT_NODES = 1500  # as many nodes as that search can deal with,
_EXACT_NODES_TURNING = 600  # and when it must look at every pair of edges
_EXACT_ROUNDS = 2  # a better path is polished, joined to the roadmap, and the search repeated
_LOOSEST = 3.0  # times the least additive cost is looked at for paths of less exact cost
# Additive recurrence by the inverse powers of the plastic number g, g³ = g + 1: evenly spread however many are drawn.
# (M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018.)
_STEP = 1.32471795724474602596 ** -np.array([1.0, 2.0])
_DRAWS = 16  # times as many points are drawn, at most, as a batch wants: the informed region may be tiny


class Status(Enum):
    """Why the search ended."""

    OPTIMAL = "Optimal: the straight run costs as little as any path can."
    ROADMAP_OPTIMAL = "Proven: no path of the roadmap is better by more than 0.1 % (see `bound`)."
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
    bound : float
        Proven: no path of the roadmap ``nodes``, ``edges`` costs less, nor does ``path``. For "drift" this covers the
        paths whose heading error at the goal has a standard deviation of up to ``bound_heading_std``. It says nothing
        about paths that leave the roadmap. Zero where nothing is known: noise that the additive cost cannot price
        (steps, systematic or correlated errors) without ``exact``.
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


class RoadmapSearch:
    """An anytime search: `grow` adds a batch of nodes and improves `path`, `finish` says what is proven about it.

    With ``exact`` the roadmap keeps what may be better by the exact cost though it is worse by the additive one, and
    `finish` searches it for the least exact cost.
    """

    def __init__(
        self,
        pricing: Pricing,
        start: Floats,
        *,
        seed: int = 0,
        start_heading: float | None = None,
        exact: bool = False,
    ) -> None:
        self.pricing = pricing
        self.start_heading = start_heading
        self.exact = exact and pricing.minimise == "drift"
        self.roadmap = Roadmap(pricing, start, start_heading)
        self.batches = 0
        self.path: Floats | None = None
        self.cost = math.inf  # of the path, exact
        self.additive_cost = math.inf
        self.heading_std = math.inf  # at its end
        self._least_additive = math.inf  # of any path found
        self._joined: Floats | None = None  # the latest path that is part of the roadmap
        self._first_sample = np.random.default_rng(seed).random(2)
        self._drawn = 0
        self._has_all_corners = False
        self._consider(self.roadmap.shortest().nodes, lambda: False)

    @property
    def is_optimal(self) -> bool:
        """Whether no path at all can have less additive cost than the best one found."""
        bound = float(self.pricing.lower_bound(self.roadmap.xy[0], self.roadmap.xy[1]))
        return self.path is not None and self._least_additive <= bound * (1 + 1e-9)

    @property
    def is_done(self) -> bool:
        """Whether there is no point in growing the roadmap: the best path is optimal, or it is for an exact search and
        as large as that can deal with."""
        return self._room <= 0 if self.exact else self.is_optimal

    @property
    def _room(self) -> int:
        """How many samples may be added at once."""
        if not self.exact:
            return _LARGEST_BATCH
        most = _EXACT_NODES_TURNING if turns_matter(self.pricing.noise, self.pricing.space) else _EXACT_NODES
        return most - len(self.roadmap.xy)

    @property
    def limit(self) -> float:
        """Additive cost that a path must stay below to be of use."""
        if not self.exact or self.path is None:
            return self._least_additive
        most_var = (TIMES * self.heading_std) ** 2
        if not is_plain(self.pricing.noise, self.pricing.space) or not math.isfinite(most_var):
            return _LOOSEST * self._least_additive
        return min(self.cost / max(float(bracket(most_var**0.5)), 1e-9), _LOOSEST * self._least_additive)

    def grow(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Add a batch of nodes, search, polish. ``stop`` ends it early; the path never gets worse."""
        if len(self.roadmap.xy) > _MOST_NODES:
            self._renew()
        roadmap = self.roadmap
        if self.batches > 0 and not self._has_all_corners:
            roadmap.add(self._corners(), _NEIGHBOURS, self.limit, all_round=True)
        self._join()
        if stop():
            return
        samples = self._samples(min(_FIRST_BATCH << min(self.batches, 20), self._room))
        for first in range(0, len(samples), _CHUNK):
            roadmap.add(samples[first : first + _CHUNK], _NEIGHBOURS, self.limit)
            if stop():
                break
        else:
            self._consider(roadmap.shortest(self._least_additive).nodes, stop)
            roadmap.prune(self.limit * (1 + 1e-9))
            self.batches += 1

    def finish(self, stop: Callable[[], bool] = lambda: False) -> tuple[Bound, bool]:
        """The bound on paths of the roadmap, the best path included, and whether that path is proven to be as good as
        the best of them. With ``exact``, first the search for a better one, until ``stop`` says so."""
        noise, roadmap = self.pricing.noise, self.roadmap
        assert self.path is not None, "there is nothing to finish without a path"
        self._joined = None  # it may have been pruned since
        self._join()
        if self.pricing.minimise == "length":
            return Bound(min(roadmap.shortest().cost, self.cost), math.inf), False
        if not self.exact:
            bound = bracketed(roadmap, noise, self.heading_std, self._least_additive)
            return bound._replace(mean_square=min(bound.mean_square, self.cost)), False
        judge = ExactJudge(self.pricing.space, noise, self.pricing.goal, self.start_heading)
        for _ in range(_EXACT_ROUNDS):
            self._offer(refined(judge, self.pricing.space, self.path, stop))
            self._join()
            found, bound, finished = exactly_best(
                roadmap, noise, self.cost, self.heading_std, stop, self._least_additive
            )
            if found is None or not self._offer(found) or stop():
                break
        bound = bound._replace(mean_square=min(bound.mean_square, self.cost))
        return bound, finished and bound.mean_square >= self.cost * (1 - 1.5 * GAP)

    def _consider(self, nodes: Ints, stop: Callable[[], bool]) -> None:
        """Offer the path over ``nodes``, as it is and polished."""
        if len(nodes):
            raw = self.roadmap.xy[nodes]
            self._offer(raw)
            self._offer(polished(self.pricing, raw, self.start_heading, stop))

    def _offer(self, path: Floats) -> bool:
        """Take the path if it is the best by exact cost; whether it was."""
        additive = cost = self.pricing.path(path, self.start_heading)
        self._least_additive = min(self._least_additive, additive)
        heading_std = 0.0
        if self.pricing.minimise == "drift":
            end = exact_drift(self.pricing.space, path, self.pricing.noise, self.start_heading).end
            cost, heading_std = float(end.rms) ** 2, float(end.heading_std)
        if not cost < self.cost:
            return False
        self.path, self.cost, self.additive_cost, self.heading_std = path, cost, additive, heading_std
        return True

    def _renew(self) -> None:
        """Start a new roadmap with the corners and the best path, so that memory stays bounded."""
        self.roadmap = Roadmap(self.pricing, self.roadmap.xy[0], self.start_heading)
        self.roadmap.add(self._corners(), _NEIGHBOURS, self.limit, all_round=True)
        self._joined = None

    def _join(self) -> None:
        """Make the best path part of the roadmap."""
        if self.path is not None and self.path is not self._joined and len(self.path) > 2:
            self.roadmap.add(self.path[1:-1], _NEIGHBOURS, math.inf, chain=True)
        self._joined = self.path

    def _corners(self) -> Floats:
        """Corners that may improve the path: the coarse ones first, where there are many; then all."""
        space = self.pricing.space
        if self.batches <= 1:
            xmin, ymin, xmax, ymax = space.bounds
            radius = getattr(space, "robot_radius", 0.0)
            corners = space.corners(max(radius / 4, 1e-3 * math.hypot(xmax - xmin, ymax - ymin)))
            if len(corners) > _FEW_CORNERS:
                return self._informed(corners)
        self._has_all_corners = True
        return self._informed(space.corners())

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
    exact: bool = False,
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
    exact : bool
        Search the roadmap for the least exact drift rather than the least additive cost, which is an upper bound. Worth
        while when headings at the goal are off by more than half a radian, or for a sharp ``bound``. The roadmap is
        then kept small.
    time_limit : float
        Seconds; the first batch is completed in any case, and four while no path is known.
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
            bound=0.0,
            bound_heading_std=math.inf,
            nodes=ends,
            edges=np.zeros((0, 2), dtype=np.int64),
            status=Status.OPTIMAL,
            batches=0,
        )
    search = RoadmapSearch(pricing, ends[0], seed=seed, start_heading=start_heading, exact=exact)
    share = _EXACT_SHARE if search.exact else 1.0

    def after(seconds: float) -> bool:
        enough = search.batches >= (1 if search.path is not None else _BATCHES_TO_FIND_ONE)
        return enough and time.perf_counter() - began > seconds

    def grown() -> bool:
        return after(share * time_limit)

    while not (grown() or search.batches == batches or search.is_done):
        search.grow(grown)
        if search.path is None:
            check_connected(world, ends)
    if search.path is None:
        raise NoPathError(
            f"no path found from {said(ends[0])} to {said(ends[1])} within {time_limit:g} s and {search.batches} "
            "batches, though free space connects them: allow more time"
        )
    bound, proven = search.finish(lambda: after(time_limit))
    if search.is_optimal and not search.exact:
        status = Status.OPTIMAL
    elif proven:
        status = Status.ROADMAP_OPTIMAL
    else:
        status = Status.TIME_LIMIT if after(time_limit) else Status.BATCHES_DONE
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
