"""DriftObjective: predicted drift as OMPL's planners see it, a motion cost and an admissible heuristic in closed form.

OMPL adds the costs of motions up, and the expected squared error is not a sum; what is summed here is the additive cost
of `driftplan.planning.cost`, which bounds it from above and ranks paths almost as it does.
"""

from __future__ import annotations

import atexit
from dataclasses import replace
from functools import partial
from math import isfinite
from typing import Any
from weakref import WeakSet

from ompl import base as ob

from driftplan.arrays import instance
from driftplan.errors import PlannerError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import CostRates
from driftplan.planning.ompl.motion_prices import Point, Price, following, heuristic_of, motion_cost_of
from driftplan.planning.ompl.spaces import check_world_of, followed_goal, goal_points, goal_position, space_kind
from driftplan.planning.ompl.zone_lookup import ZoneLookup
from driftplan.world.box_world import BoxWorld
from driftplan.world.world import World

_SAME_PLACE_M = 1e-6
# A problem and the objective that follows it hold each other, out of sight of Python's collector; nanobind says so when
# the program ends.
_FOLLOWING: WeakSet[DriftObjective] = WeakSet()


@atexit.register
def _let_go() -> None:
    for objective in list(_FOLLOWING):
        objective.__dict__.clear()


class DriftObjective(ob.OptimizationObjective):
    """Cost in m²: the additive upper bound of the expected squared position error at the goal.

    For every planner of OMPL that minimises a cost: RRTstar, InformedRRTstar, SORRTstar, BITstar. (PRM and PRMstar
    wait for ever for an objective in Python; FMT, BFMT and AORRTC do not minimise it: see `PLANNERS` and `REFUSED`
    of `driftplan.planning.ompl.solve`.) Works in R^2, SE(2), Dubins, Reeds-Shepp, R^3 and SE(3) spaces. Motions are
    priced exactly, arc by arc where they are curves; noise per radian turned is priced wherever states have
    headings (in R^2 turns lie between motions, where OMPL has no price for them; `driftplan.plan_route` with
    ``planner="roadmap"`` has). See `driftplan.planning.cost` for what the additive cost leaves out, and
    `predict_ompl_path` for the exact drift of the path found. OMPL's ``simplifySolution()`` shortens paths whatever the
    objective says, and can more than double the cost where a floor is bad: use `polish_ompl_path`.

    Parameters
    ----------
    si : ompl.base.SpaceInformation; only its state space is looked at; it is not kept
    noise : in R^3 and SE(3) isotropic: ``heading_var_per_m`` is the variance of each component of the attitude error,
        ``lateral_var_per_m`` that in each of two directions
    goal : ProblemDefinition, SimpleSetup, GoalState, GoalStates, State, (x, y) or (x, y, z)
        The place where accuracy is wanted, metres: drift is weighed by the distance to it. A problem's goal, or one in
        OMPL's form, is followed: a planner that is cleared and given another goal weighs drift there. (A problem whose
        own objective follows it is kept until the program ends.) A place or a state stays: then `check_goal` says
        whether a problem's goal is another. Several goal states must share a place and differ in heading only. A path
        may also end elsewhere, where the problem's goal is a region or has a threshold; the cost then bounds the
        squared error of the place, seen from the robot when it has arrived.
    world : its zones have noise of their own (plane only). Motions, arcs included, are cut exactly where the zone
        changes.
    length_weight : m² per metre, >= 0, added to the cost: prefers shorter ways among similar ones

    Attributes
    ----------
    is_following : whether that is where the problem's goal is, or OMPL's goal that was given

    Raises
    ------
    ValueError : for a space that cannot be priced, several goal positions or a goal region, a weight that is not >= 0,
        and a world in three dimensions, which would be a floor plan there

    >>> space = ob.RealVectorStateSpace(2)
    >>> space.setBounds(0, 10)
    >>> si = ob.SpaceInformation(space)
    >>> objective = DriftObjective(si, OdometryNoise(heading_var_per_m=1e-3), goal=(10.0, 0.0))
    >>> a, b = si.allocState(), si.allocState()
    >>> a[0], a[1], b[0], b[1] = 0.0, 0.0, 10.0, 0.0
    >>> round(objective.motionCost(a, b).value(), 6)
    0.333333
    """

    def __init__(
        self,
        si: ob.SpaceInformation,
        noise: OdometryNoise,
        goal: Any,
        world: World | BoxWorld | None = None,
        *,
        length_weight: float = 0.0,
    ) -> None:
        super().__init__(si)
        space = si.getStateSpace()
        kind = space_kind(space)
        instance("noise", noise, OdometryNoise)
        if not (isfinite(length_weight) and length_weight >= 0):
            raise ValueError(f"expected length_weight >= 0 m²/m, got {length_weight!r}")
        check_world_of(world, kind)
        zones = world.zones if isinstance(world, World) else ()
        self._kind = kind
        follow = followed_goal(goal, kind)
        self.is_following = follow is not None
        self._goal = follow or partial(tuple, goal_position(goal, kind))
        self.noise = noise
        self.length_weight = float(length_weight)
        self.zone_noises = tuple(zone.noise for zone in zones)

        rates = [CostRates.of(n, kind.dimensions) for n in (noise, *self.zone_noises)]
        elsewhere, *inside = (replace(r, position=r.position + self.length_weight) for r in rates)
        lookup = ZoneLookup(zones, inside, elsewhere) if zones else None
        least = CostRates(*(min(getattr(r, name) for r in (elsewhere, *inside)) for name in ("heading", "position")))

        def prices(place: Point) -> tuple[Price, Price]:
            return motion_cost_of(space, kind, place, elsewhere, lookup), heuristic_of(space, kind, place, least)

        self._motion_cost, self._heuristic = prices(self.goal) if follow is None else following(follow, prices)
        if follow is not None:
            _FOLLOWING.add(self)
        # As attributes OMPL's calls reach them without detour. A subclass that prices in its own way keeps its methods.
        if type(self).motionCost is DriftObjective.motionCost:
            self.motionCost = self._motion_cost  # type: ignore[method-assign, assignment]
        if type(self).motionCostHeuristic is DriftObjective.motionCostHeuristic:
            self.motionCostHeuristic = self._heuristic  # type: ignore[method-assign, assignment]

    @property
    def goal(self) -> Point:
        """Where drift is weighed, metres."""
        return self._goal()

    def motionCost(self, a: Any, b: Any) -> Any:
        """Cost of the motion from state ``a`` to state ``b``, as ompl.base.Cost."""
        return self._motion_cost(a, b)

    def motionCostHeuristic(self, a: Any, b: Any) -> Any:
        """A lower bound of the cost of any way between two states, consistent and exact to the goal in free space."""
        return self._heuristic(a, b)

    def isSymmetric(self) -> bool:
        """Whether the way back always costs the same: not along curves, where OMPL need not drive back the way it came
        if several are equally short."""
        return not self._kind.is_curved

    def check_goal(self, goal: Any) -> None:
        """Raise `PlannerError` unless an OMPL goal is where this objective weighs drift.

        OMPL does not tell an objective which problem it is used for: made for a place, it goes on weighing drift there
        when its planner is cleared and given another goal. Make it for the problem, or ask here; `RoadmapPlanner` does.

        Parameters
        ----------
        goal : State, GoalState or GoalStates; one of the states must be at the place, to a micrometre

        >>> space = ob.RealVectorStateSpace(2)
        >>> si = ob.SpaceInformation(space)
        >>> objective = DriftObjective(si, OdometryNoise(heading_var_per_m=1e-3), goal=(10.0, 0.0))
        >>> state = si.allocState()
        >>> state[0], state[1] = 3.0, 0.0
        >>> objective.check_goal(state)
        Traceback (most recent call last):
        driftplan.errors.PlannerError: expected the problem's goal where the objective weighs drift, at (10.0, 0.0), \
got [(3.0, 0.0)]: make the DriftObjective for that goal
        """
        there = goal_points(goal, self._kind)
        if all(max(abs(p - q) for p, q in zip(point, self.goal, strict=True)) > _SAME_PLACE_M for point in there):
            raise PlannerError(
                f"expected the problem's goal where the objective weighs drift, at {self.goal}, got {there}: make the "
                "DriftObjective for that goal"
            )

    def stateCost(self, state: Any) -> Any:
        """Zero: standing still costs nothing."""
        return ob.Cost(0.0)

    def set_error_threshold(self, rms_m: float) -> None:
        """Let planners stop as soon as they have a path whose rms error at the goal is surely below ``rms_m`` metres.

        Raises
        ------
        ValueError : if the cost does not bound the error: with systematic errors, correlated noise, noise per step, or
            a ``length_weight``
        """
        if not (isfinite(rms_m) and rms_m > 0):
            raise ValueError(f"expected a threshold > 0 m, got {rms_m!r}")
        if self.length_weight > 0:
            raise ValueError("expected length_weight=0 with an error threshold: the cost would not be an error")
        for noise in (self.noise, *self.zone_noises):
            if noise.is_systematic or noise.heading_distance_corr != 0 or noise.step_m is not None:
                raise ValueError(
                    "expected white noise without systematic errors, correlation or step_m with an error threshold: "
                    "the additive cost does not bound the error otherwise, and a planner could stop too early"
                )
        self.setCostThreshold(ob.Cost(float(rms_m) ** 2))
