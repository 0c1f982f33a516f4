"""RoadmapPlanner: the roadmap search as an OMPL planner, for SimpleSetup, planner allocators and OMPL's Benchmark."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from math import atan2, inf
from typing import Any, NamedTuple

import numpy as np
from ompl import base as ob
from ompl import geometric as og

from driftplan.arrays import Floats, Ints, choice, whole
from driftplan.beacons.beacon import Beacon
from driftplan.errors import PlannerError
from driftplan.model.noise import OdometryNoise, check_continuous
from driftplan.model.readings import Estimator, Fix
from driftplan.planning.ompl.roadmap_problem import OmplCheckedSpace, Target, box_of, target_of
from driftplan.planning.ompl.spaces import SpaceKind, space_kind
from driftplan.planning.request import DriftLimit, Objective, Reliance
from driftplan.planning.roadmap.beacon_growth import BeaconRouteGrowth
from driftplan.planning.roadmap.growth import RoadmapSearch
from driftplan.planning.roadmap.prices import AdditiveCost, PartOfWorld, Space, exact_drift
from driftplan.planning.routes import Route
from driftplan.planning.taut_strings import LeastRoute, tight_least_route
from driftplan.world.world import World
from driftplan.world.zones import noises_on

# A start or goal: x, y, metres, and its heading, rad; None where there are none, or any will do.
_Pose = tuple[float, float, float | None]
_SAME_PLACE = 1e-9  # m: how far the problem's goal may be from the one that the objective weighs drift by


class RoadmapPlanner(ob.Planner):
    """Plans straight runs and turns on the spot over a growing roadmap: near the optimum long before trees are.

    An anytime planner: it adds batches of nodes until the termination condition says stop, the objective is
    satisfied, or nothing better can be left. A condition of one's own is asked every 20 to 50 ms while the roadmap
    grows, and before and after every search of it. Calling ``solve`` again goes on, unless the problem is another;
    ``clear`` starts afresh, with the same samples for the same seed. Of the paths found it returns the one of least
    exact drift.

    With beacons, a ``max_drift`` or ``minimise`` the routes are those of `driftplan.plan_route` among beacons: every
    batch is a route on a roadmap of twice as many nodes, and the best one of all is the solution. What is minimised is
    the exact rms drift at the goal under a `DriftObjective`, the length under a path length objective, unless
    ``minimise`` says otherwise. Where no route of the roadmap keeps the limit, ``solve`` reports a timeout and
    `why_not` says what stands in the way.

    Parameters
    ----------
    si : ompl.base.SpaceInformation
        Over RealVectorStateSpace(2), or SE2StateSpace together with a ``world``: then turns on the spot at the start,
        at waypoints and at the goal are states of their own, and turn noise counts from the start's heading.
    objective : DriftObjective, PathLengthOptimizationObjective or a MultiOptimizationObjective of these, optional
        Default: that of the problem. Where the problem has several goals at different places, a DriftObjective made
        for any one of them does: each goal is planned for with drift weighed by the distance to itself, and the path
        of least exact drift is returned. Where the problem's goal is a region, the path leads to the place that the
        DriftObjective was made for, which must be in it.
    world : collisions are then tested in bulk, and corners are known; the validity checkers of ``si`` are not asked.
        Without it every motion is put to ``si.checkMotion``. An objective with zones needs its world here.
    beacons, max_drift, max_detour, start_fix, estimator : as for `driftplan.plan_route`. Without a ``world`` nothing
        blocks the sight of beacons.
    minimise : {"length", "drift", "worst_drift"}, optional
    noise : needed with beacons and a path length objective, which has none
    max_nodes : of the largest roadmap among beacons, about
    seed : of the samples
    name : as OMPL and its benchmarks show it

    Raises
    ------
    PlannerError
        For state spaces of other motions, objectives of other kinds, and goals of a problem that are not where the
        objective weighs drift; with beacons for objectives that weigh length.
    ValueError : for options that make no sense

    >>> from driftplan import Beacon, BeaconKind, DriftObjective, OdometryNoise
    >>> from driftplan.planning.ompl.collision import use_world
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
    >>> enough = ob.PlannerTerminationCondition(lambda: len(planner.roadmap()[0]) > 100)
    >>> bool(setup.solve(enough)), setup.getSolutionPath().check()
    (True, True)
    >>> sign = BeaconKind.landmark(range_m=1.0, position_std_m=0.05, heading_std=0.01)
    >>> planner = RoadmapPlanner(si, objective, world, beacons=[Beacon(sign, 5, 8)], max_drift=0.5, max_nodes=100)
    >>> setup.clear()
    >>> setup.setPlanner(planner)
    >>> bool(setup.solve(20.0)), len(planner.route().beacons), planner.route().worst_drift <= 0.5
    (True, 1, True)
    """

    def __init__(
        self,
        si: ob.SpaceInformation,
        objective: ob.OptimizationObjective | None = None,
        world: World | None = None,
        *,
        beacons: Sequence[Beacon] = (),
        max_drift: float | DriftLimit | None = None,
        minimise: Objective | None = None,
        max_detour: float | None = None,
        start_fix: Fix | None = None,
        estimator: Estimator = "reset",
        noise: OdometryNoise | None = None,
        max_nodes: int = 2000,
        seed: int = 0,
        name: str = "Roadmap",
    ) -> None:
        super().__init__(si, name)
        kind = space_kind(si.getStateSpace())
        if kind is not SpaceKind.PLANE and not (kind is SpaceKind.POSE and world is not None):
            got = f"{type(si.getStateSpace()).__name__} {'without' if world is None else 'with'} a world"
            raise PlannerError(
                "expected RealVectorStateSpace(2), or SE2StateSpace with a world, since the roadmap drives straight "
                f"and turns on the spot; got {got}"
            )
        self._has_headings = kind is SpaceKind.POSE
        self._world = world
        self._target = None if objective is None else target_of(objective)
        self._seed = whole("seed", seed, least=0)
        if minimise is not None:
            choice("minimise", minimise, Objective)
        self._minimise, self._noise = minimise, noise
        self._max_nodes = whole("max_nodes", max_nodes, least=10)
        self._length_weight: float = getattr(objective, "length_weight", 0.0)
        reliance = self._reliance = Reliance.of(beacons, max_drift, max_detour, start_fix, estimator)
        self._counts_on_beacons = bool(beacons) or reliance.max_drift < inf or minimise is not None
        self._queries: list[_Query] = []
        self._asked: tuple[Target, list[_Pose], list[_Pose]] | None = None  # that the queries are for
        self._scale = 1.0

    def clear(self) -> None:
        """Forget the roadmap, but for the graph kept with the world; OMPL may call this twice."""
        super().clear()
        self._queries, self._asked = [], None

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
        """A proven lower bound of what is minimised (m², or m), and the heading error up to which it holds (rad).

        As `Route.bound`: over all paths among the obstacles of the world, without a world in an empty plane. Zero
        without a path, and where nothing is known: of noise that the additive cost cannot price.
        """
        search = self._best().search if self._queries else None
        if search is None or search.path is None:
            return 0.0, inf
        if isinstance(search, BeaconRouteGrowth):
            return search.bound, inf
        pricing, path = search.pricing, search.path
        straight = float(np.linalg.norm(path[-1] - path[0]))
        least, world = LeastRoute(straight**3 / 3, straight), self._world_as_priced(pricing.space)
        if world is not None:
            least = tight_least_route(world, path, pricing.noise)
        if pricing.minimise == "length":
            return least.length, inf
        end = exact_drift(pricing.space, path, pricing.noise, search.start_heading).end
        mean_square, heading_std = least.bound(pricing.noises, float(end.heading_std))
        return min(mean_square, search.cost), heading_std

    def bestCost(self) -> Any:
        """The objective's cost of the best path so far, as ompl.base.Cost; infinite before there is one."""
        return ob.Cost(self._scale * self._best().search.additive_cost if self._queries else inf)

    def route(self) -> Route | None:
        """The best route so far; None before there is one, and for plans without beacons and limits."""
        search = self._best().search if self._queries else None
        return search.route if isinstance(search, BeaconRouteGrowth) else None

    def why_not(self) -> str | None:
        """Why no route keeps the limit, in a sentence; None if one does, or nothing has been planned yet."""
        search = self._best().search if self._queries else None
        return search.why_not() if isinstance(search, BeaconRouteGrowth) else None

    def solve(self, ptc: Any) -> Any:
        """OMPL's entry: plan until ``ptc``, a termination condition or a number of seconds, says stop."""
        if not callable(ptc):
            ptc = ob.timedPlannerTerminationCondition(float(ptc))
        self.checkValidity()
        problem = self.getProblemDefinition()
        objective = problem.getOptimizationObjective()
        target = self._target or target_of(objective)
        if objective is not None and target_of(objective) != target:
            raise PlannerError(
                "expected the planner's objective to be that of the problem, got another one: give it to "
                "setOptimizationObjective too, or to the planner none"
            )
        asked = target, *self._ends(target)
        if asked != self._asked:  # at first, and when there is another problem, cleared or not
            self._queries, self._asked = [], None
            _, starts, goals = asked
            if not starts or not goals:
                wrong = ob.PlannerStatus.INVALID_START if not starts else ob.PlannerStatus.INVALID_GOAL
                return ob.PlannerStatus(wrong)
            self._scale = target.scale
            self._queries = [self._query(target, start, goal) for goal in goals for start in starts]
            self._asked = asked
        while not ptc():
            growing = [query.search for query in self._queries if not query.search.is_optimal]
            if not growing or (objective is not None and objective.isSatisfied(self.bestCost())):
                break
            for search in growing:
                search.grow(ptc)
        best = self._best()
        if best.search.path is None:
            return ob.PlannerStatus(ob.PlannerStatus.TIMEOUT)
        problem.clearSolutionPaths()  # OMPL would rank this one among earlier ones by length
        problem.addSolutionPath(self._as_ompl_path(best), False, 0.0, self.getName())
        return ob.PlannerStatus(True, False)

    def _best(self) -> _Query:
        return min(self._queries, key=lambda query: query.search.cost)

    def _ends(self, target: Target) -> tuple[list[_Pose], list[_Pose]]:
        """The valid starts and goals."""
        inputs = self.getPlannerInputStates()
        inputs.restart()
        starts, goals = [], []
        while inputs.haveMoreStartStates() and (state := inputs.nextStart()) is not None:
            starts.append(self._read(state))
        goal = self.getProblemDefinition().getGoal()
        if not isinstance(goal, (ob.GoalState, ob.GoalStates)):
            return starts, self._within(goal, target)
        while inputs.haveMoreGoalStates() and (state := inputs.nextGoal()) is not None:
            goals.append(self._read(state))
        if goals and target.goal is not None:
            places = [goal[:2] for goal in goals]
            if all(np.abs(np.subtract(place, target.goal)).max() > _SAME_PLACE for place in places):
                raise PlannerError(
                    f"expected the problem's goal where the objective weighs drift, at {target.goal}, got "
                    f"{places[0] if len(places) == 1 else places}: make the DriftObjective for that goal"
                )
        return starts, goals

    def _within(self, region: Any, target: Target) -> list[_Pose]:
        """The place in a goal region that the objective was made for, if that is valid."""
        si = self.getSpaceInformation()
        if target.goal is None:
            raise PlannerError(
                f"expected goal states for the shortest path, got a {type(region).__name__}: the roadmap needs to know "
                "where it is to lead; a DriftObjective made for a place says so"
            )
        state = si.allocState()
        if self._has_headings:
            state.setXY(*target.goal)
            state.setYaw(0.0)
        else:
            state[0], state[1] = target.goal
        if not region.isSatisfied(state):
            raise PlannerError(
                f"expected a goal region around the place where the objective weighs drift, {target.goal}, which is "
                "not in it: make the DriftObjective for a place in the region"
            )
        x, y = target.goal
        return [(x, y, None)] if si.isValid(state) else []

    def _read(self, state: Any) -> _Pose:
        if self._has_headings:
            return state.getX(), state.getY(), state.getYaw()
        return state[0], state[1], None

    def _query(self, target: Target, start: _Pose, goal: _Pose) -> _Query:
        si = self.getSpaceInformation()
        zones = target.zones(self._world)
        box = box_of(si.getStateSpace())
        space: Space = OmplCheckedSpace(si, box) if self._world is None else PartOfWorld(self._world, box, zones)
        pricing = AdditiveCost(space, np.array(goal[:2]), target.noise, target.minimise)
        return _Query(self._search(pricing, np.array(start[:2]), start[2]), goal[2])

    def _search(
        self, pricing: AdditiveCost, start: Floats, start_heading: float | None
    ) -> RoadmapSearch | BeaconRouteGrowth:
        """What looks for paths from one start to one goal."""
        if not self._counts_on_beacons:
            return RoadmapSearch(pricing, start, seed=self._seed, start_heading=start_heading)
        by_length = pricing.minimise == "length"
        if by_length and self._noise is None:
            raise ValueError("expected noise=... together with a path length objective, which knows of none")
        if not by_length and self._noise is not None:
            raise ValueError("expected noise only with a path length objective: a DriftObjective has its own")
        weight = getattr(self.getProblemDefinition().getOptimizationObjective(), "length_weight", 0.0)
        if self._length_weight > 0 or weight > 0:
            raise PlannerError(
                "expected length_weight=0 with beacons or max_drift: max_detour is what keeps their routes short"
            )
        noise = self._noise if self._noise is not None else pricing.noise
        world = self._world if by_length else self._world_as_priced(pricing.space)
        check_continuous(noises_on(world, noise))
        return BeaconRouteGrowth(
            pricing,
            world,
            noise,
            start,
            self._minimise or ("length" if by_length else "drift"),
            replace(self._reliance, start_heading=start_heading),
            max_nodes=self._max_nodes,
            seed=self._seed,
        )

    def _world_as_priced(self, space: Space) -> World | None:
        """The world with the zones of a space: as far as the objective prices them."""
        if self._world is None or self._world.zones == space.zones:
            return self._world
        return replace(self._world, zones=space.zones)

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


class _Query(NamedTuple):
    """From one start to one goal."""

    search: RoadmapSearch | BeaconRouteGrowth
    goal_yaw: float | None  # rad; any where it is None


def _poses(xy: Floats, start_yaw: float, goal_yaw: float | None) -> Iterator[tuple[float, float, float]]:
    """Poses along a path, turns on the spot as two poses at one place."""
    yaw = start_yaw
    yield *xy[0].tolist(), yaw
    for (x0, y0), (x1, y1) in pairwise(xy.tolist()):
        course = atan2(y1 - y0, x1 - x0)
        if course != yaw:
            yield x0, y0, course
        yield x1, y1, course
        yaw = course
    if goal_yaw is not None and goal_yaw != yaw:
        yield *xy[-1].tolist(), goal_yaw
