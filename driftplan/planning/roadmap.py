"""RoadmapPlanner: the roadmap search as an OMPL planner, for SimpleSetup, planner allocators and OMPL's Benchmark."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from math import atan2, inf
from typing import Any, NamedTuple, Protocol

import numpy as np
from ompl import base as ob
from ompl import geometric as og

from driftplan.errors import PlannerError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.exact_roadmap import Bound
from driftplan.planning.objective import DriftObjective
from driftplan.planning.roadmap_graph import Roadmap
from driftplan.planning.roadmap_growth import RoadmapSearch
from driftplan.planning.roadmap_pricing import Bools, Floats, Ints, Minimise, Pricing, Space
from driftplan.planning.spaces import SpaceKind, space_kind
from driftplan.world.world import World, Zone, ZonePieces

_SAME_PLACE = 1e-9  # m: how far the problem's goal may be from the one that the objective weighs drift by


class RoadmapPlanner(ob.Planner):
    """Plans straight runs and turns on the spot over a growing roadmap: near the optimum long before trees are.

    An anytime planner: it adds batches of nodes until the termination condition says stop, the objective is satisfied,
    or nothing better can be left. Calling ``solve`` again goes on; ``clear`` starts afresh, with the same samples for
    the same seed. Of the paths found it returns the one of least exact drift.

    Parameters
    ----------
    si : ompl.base.SpaceInformation
        Over RealVectorStateSpace(2), or SE2StateSpace together with a ``world``: then turns on the spot at the start,
        at waypoints and at the goal are states of their own, and turn noise counts from the start's heading.
    objective : DriftObjective or ompl.base.PathLengthOptimizationObjective, optional
        Default: that of the problem.
    world : World, optional
        Collisions are then tested in bulk, and corners are known; the validity checkers of ``si`` are not asked.
        Without it every motion is put to ``si.checkMotion``. An objective with zones needs its world here.
    seed : int
        Of the samples.
    exact : bool
        After the roadmap has been grown, search it for the least exact drift; see `plan_on_roadmap`. The roadmap is
        then kept small and the search may go on after the last batch until the termination condition says stop.
    name : str
        As OMPL and its benchmarks show it.

    Raises
    ------
    PlannerError
        For state spaces of other motions, and objectives that are neither of the two.

    Examples
    --------
    >>> from driftplan.planning.collision import use_world
    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> space = ob.RealVectorStateSpace(2)
    >>> space.setBounds(0, 10)
    >>> setup = og.SimpleSetup(space)
    >>> si = setup.getSpaceInformation()
    >>> use_world(si, world)
    >>> start, goal = si.allocState(), si.allocState()
    >>> start[0], start[1], goal[0], goal[1] = 2.0, 2.0, 8.0, 2.0
    >>> setup.setStartAndGoalStates(start, goal)
    >>> objective = DriftObjective(si, OdometryNoise(heading_var_per_m=1e-4), (8.0, 2.0))
    >>> setup.setOptimizationObjective(objective)
    >>> planner = RoadmapPlanner(si, objective, world)
    >>> setup.setPlanner(planner)
    >>> from ompl import util as ou
    >>> ou.setLogLevel(ou.LOG_NONE)
    >>> bool(setup.solve(0.2)), setup.getSolutionPath().check()
    (True, True)
    >>> nodes, edges = planner.roadmap()
    >>> nodes[:2].tolist(), edges.shape[1]
    ([[2.0, 2.0], [8.0, 2.0]], 2)
    """

    def __init__(
        self,
        si: Any,
        objective: Any = None,
        world: World | None = None,
        *,
        seed: int = 0,
        exact: bool = False,
        name: str = "Roadmap",
    ) -> None:
        super().__init__(si, name)
        kind = space_kind(si.getStateSpace())
        if kind is not SpaceKind.PLANE and not (kind is SpaceKind.POSE and world is not None):
            said = f"{type(si.getStateSpace()).__name__} {'without' if world is None else 'with'} a world"
            raise PlannerError(
                "expected RealVectorStateSpace(2), or SE2StateSpace with a world, since the roadmap drives straight "
                f"and turns on the spot; got {said}"
            )
        self._has_headings = kind is SpaceKind.POSE
        self._world = world
        self._target = None if objective is None else _target(objective)
        self._seed = int(seed)
        self._exact = bool(exact)
        self._queries: list[_Query] = []
        self._bound: Bound | None = None

    def clear(self) -> None:
        """Forget the roadmap; OMPL may call this twice."""
        super().clear()
        self._queries, self._bound = [], None

    def roadmap(self) -> tuple[Floats, Ints]:
        """Nodes (n, 2) in metres and edges (m, 2) of the roadmap so far; node 0 is the start, node 1 the goal.

        With several starts, the roadmap of the one whose path is best. (OMPL's own ``getPlannerData`` stays empty: the
        binding does not allow a planner in Python to fill it.)
        """
        if not self._queries:
            return np.zeros((0, 2)), np.zeros((0, 2), dtype=np.int64)
        roadmap = self._best().search.roadmap
        return roadmap.xy, roadmap.edges

    def bound(self) -> tuple[float, float]:
        """A proven lower bound over the paths of the roadmap, and the heading standard deviation up to which it holds.

        See ``bound`` and ``bound_heading_std`` of `driftplan.planning.roadmap_search.RoadmapResult`. Zero without a
        path.
        """
        if not self._queries or self._best().search.path is None:
            return 0.0, inf
        if self._bound is None:
            self._bound, _ = self._best().search.finish(lambda: True)
        return self._bound.mean_square, self._bound.heading_std

    def solve(self, ptc: Any) -> Any:
        """OMPL's entry: plan until ``ptc``, a termination condition or a number of seconds, says stop."""
        if not callable(ptc):
            ptc = ob.timedPlannerTerminationCondition(float(ptc))
        self.checkValidity()
        problem = self.getProblemDefinition()
        objective = problem.getOptimizationObjective()
        if not self._queries:
            starts, goals = self._ends()
            if not starts or not goals:
                wrong = ob.PlannerStatus.INVALID_START if not starts else ob.PlannerStatus.INVALID_GOAL
                return ob.PlannerStatus(wrong)
            target = self._target or _target(objective)
            self._queries = [self._query(target, start, goal) for goal in goals for start in starts]
        self._bound = None
        while not ptc():
            growing = [query.search for query in self._queries if not query.search.is_done]
            if not growing or objective.isSatisfied(ob.Cost(self._best().search.additive_cost)):
                break
            for search in growing:
                search.grow(ptc)
        best = self._best()
        if best.search.path is None:
            return ob.PlannerStatus(ob.PlannerStatus.TIMEOUT)
        if best.search.exact and not ptc():
            self._bound, _ = best.search.finish(ptc)
        problem.clearSolutionPaths()  # OMPL would rank this one among earlier ones by length
        problem.addSolutionPath(self._as_ompl_path(best), False, 0.0, self.getName())
        return ob.PlannerStatus(True, False)

    def _best(self) -> _Query:
        return min(self._queries, key=lambda query: query.search.cost)

    def _ends(self) -> tuple[list[Any], list[Any]]:
        """Coordinates of the valid starts and goals: x, y and, where there are headings, yaw."""
        inputs = self.getPlannerInputStates()
        inputs.restart()
        starts, goals = [], []
        while inputs.haveMoreStartStates() and (state := inputs.nextStart()) is not None:
            starts.append(self._read(state))
        while inputs.haveMoreGoalStates() and (state := inputs.nextGoal()) is not None:
            goals.append(self._read(state))
        return starts, goals

    def _read(self, state: Any) -> tuple[float, ...]:
        if self._has_headings:
            return state.getX(), state.getY(), state.getYaw()
        return state[0], state[1]

    def _query(self, target: _Target, start: tuple[float, ...], goal: tuple[float, ...]) -> _Query:
        place = np.array(goal[:2])
        if target.goal is not None and np.abs(place - target.goal).max() > _SAME_PLACE:
            raise PlannerError(
                f"expected the problem's goal where the objective weighs drift, at {target.goal}, got {goal[:2]}: make "
                "the DriftObjective for that goal"
            )
        si = self.getSpaceInformation()
        zones = target.zones(self._world)
        box = _box(si.getStateSpace())
        space: Space = _Asked(si, box) if self._world is None else _Boxed(self._world, box, zones)
        heading = start[2] if self._has_headings else None
        search = self._search(Pricing(space, place, target.noise, target.minimise), np.array(start[:2]), heading)
        return _Query(search, goal[2] if self._has_headings else 0.0)

    def _search(self, pricing: Pricing, start: Floats, start_heading: float | None) -> Growing:
        """What looks for paths from one start to one goal; planners that know more have another."""
        return RoadmapSearch(pricing, start, seed=self._seed, start_heading=start_heading, exact=self._exact)

    def _as_ompl_path(self, query: _Query) -> Any:
        si = self.getSpaceInformation()
        path, state = og.PathGeometric(si), si.allocState()
        xy = query.search.path
        assert xy is not None
        if not self._has_headings:
            for state[0], state[1] in xy.tolist():
                path.append(state)
            return path
        for x, y, yaw in _poses(xy, query.search.start_heading or 0.0, query.goal_yaw):
            state.setXY(x, y)
            state.setYaw(yaw)
            path.append(state)
        return path


class Growing(Protocol):
    """An anytime search for a path from one start to one goal: `RoadmapSearch`, or one that knows of more."""

    @property
    def start_heading(self) -> float | None: ...
    @property
    def exact(self) -> bool: ...
    @property
    def roadmap(self) -> Roadmap: ...
    @property
    def path(self) -> Floats | None: ...
    @property
    def cost(self) -> float: ...
    @property
    def additive_cost(self) -> float: ...
    @property
    def is_done(self) -> bool: ...
    def grow(self, stop: Callable[[], bool], /) -> None: ...
    def finish(self, stop: Callable[[], bool], /) -> tuple[Bound, bool]: ...


class _Query(NamedTuple):
    """From one start to one goal."""

    search: Growing
    goal_yaw: float  # rad; where there are no headings it means nothing


class _Target(NamedTuple):
    """What an OMPL objective asks for, without the objective."""

    minimise: Minimise
    noise: OdometryNoise
    goal: tuple[float, ...] | None  # where drift is weighed, metres
    zone_noises: tuple[OdometryNoise, ...]

    def zones(self, world: World | None) -> tuple[Zone, ...]:
        """The world's zones as far as the objective prices them."""
        if not self.zone_noises:
            return ()
        if world is None or len(world.zones) != len(self.zone_noises):
            raise PlannerError(
                f"expected the world whose {len(self.zone_noises)} zones the objective prices, got {world!r}: give the "
                "planner the same world as the objective"
            )
        return tuple(replace(zone, noise=noise) for zone, noise in zip(world.zones, self.zone_noises, strict=True))


def _target(objective: Any) -> _Target:
    if isinstance(objective, DriftObjective):
        weight = objective.length_weight
        noises = [_with_length(noise, weight) for noise in (objective.noise, *objective.zone_noises)]
        return _Target("drift", noises[0], tuple(objective.goal), tuple(noises[1:]))
    if isinstance(objective, ob.PathLengthOptimizationObjective):
        return _Target("length", OdometryNoise(), None, ())
    raise PlannerError(
        "expected a DriftObjective or PathLengthOptimizationObjective, which the roadmap can price in bulk, got "
        f"{type(objective).__name__}"
    )


def _with_length(noise: OdometryNoise, weight: float) -> OdometryNoise:
    """Noise whose mean square drift is that of ``noise`` plus ``weight`` m² per metre driven."""
    if weight == 0:
        return noise
    if noise.heading_distance_corr != 0 or noise.is_systematic:
        raise PlannerError(
            "expected length_weight=0 with correlated or systematic errors: their drift and length do not add up"
        )
    return replace(noise, distance_var_per_m=noise.distance_var_per_m + weight)


def _box(space: Any) -> tuple[float, float, float, float]:
    """(xmin, ymin, xmax, ymax) of a state space, metres."""
    bounds = space.getBounds()
    (xmin, ymin), (xmax, ymax) = list(bounds.low)[:2], list(bounds.high)[:2]
    if not (xmin < xmax and ymin < ymax):
        raise PlannerError(f"expected a state space with bounds, got x {xmin}..{xmax}, y {ymin}..{ymax}")
    return xmin, ymin, xmax, ymax


class _Boxed:
    """A world within the bounds of a state space."""

    def __init__(self, world: World, box: tuple[float, float, float, float], zones: tuple[Zone, ...]) -> None:
        low, high = np.maximum(box[:2], world.bounds[:2]), np.minimum(box[2:], world.bounds[2:])
        self.bounds: tuple[float, float, float, float] = (*low.tolist(), *high.tolist())
        self.zones = zones
        self.robot_radius = world.robot_radius
        self._world, self._low, self._high = world, low, high

    def is_free(self, xy: Floats, /) -> Bools:
        return np.asarray(((xy >= self._low) & (xy <= self._high)).all(axis=-1) & self._world.is_free(xy))

    def segments_free(self, a: Floats, b: Floats, /) -> Bools:
        return self._world.segments_free(a, b)  # their ends are in the box, which is convex

    def corners(self, tolerance_m: float | None = None, /) -> Floats:
        corners = self._world.corners(tolerance_m)
        return corners[self.is_free(corners)]

    def zone_pieces(self, a: Floats, b: Floats, /) -> ZonePieces:
        return self._world.zone_pieces(a, b)


class _Asked:
    """Whatever the checkers of a SpaceInformation over R^2 say, state by state and motion by motion."""

    zones: tuple[Zone, ...] = ()

    def __init__(self, si: Any, box: tuple[float, float, float, float]) -> None:
        self.bounds = box
        self._si = si
        self._states = si.allocState(), si.allocState()

    def is_free(self, xy: Floats, /) -> Bools:
        valid, (state, _) = self._si.isValid, self._states
        free = []
        for state[0], state[1] in xy.reshape(-1, 2).tolist():
            free.append(valid(state))
        return np.array(free, dtype=bool).reshape(xy.shape[:-1])

    def segments_free(self, a: Floats, b: Floats, /) -> Bools:
        valid, (begin, end) = self._si.checkMotion, self._states
        free = []
        ends = zip(a.reshape(-1, 2).tolist(), b.reshape(-1, 2).tolist(), strict=True)
        for (begin[0], begin[1]), (end[0], end[1]) in ends:
            # Both ways round: OMPL's own validator takes the first state for valid, and rounds differently backwards.
            free.append(valid(begin, end) and valid(end, begin))
        return np.array(free, dtype=bool).reshape(a.shape[:-1])

    def corners(self, tolerance_m: float | None = None, /) -> Floats:
        """None are known."""
        return np.zeros((0, 2))

    def zone_pieces(self, a: Floats, b: Floats, /) -> ZonePieces:
        """Every motion whole: there are no zones."""
        n = len(a)
        return ZonePieces(np.arange(n), np.zeros(n), np.ones(n), np.full(n, -1))


def _poses(xy: Floats, start_yaw: float, goal_yaw: float) -> Iterator[tuple[float, float, float]]:
    """Poses along a path, turns on the spot as two poses at one place."""
    yaw = start_yaw
    yield *xy[0].tolist(), yaw
    for (x0, y0), (x1, y1) in pairwise(xy.tolist()):
        course = atan2(y1 - y0, x1 - x0)
        if course != yaw:
            yield x0, y0, course
        yield x1, y1, course
        yaw = course
    if goal_yaw != yaw:
        yield *xy[-1].tolist(), goal_yaw
