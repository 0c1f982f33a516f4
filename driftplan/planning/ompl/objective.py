"""DriftObjective: predicted drift as OMPL's planners see it, a motion cost and an admissible heuristic in closed form.

OMPL adds the costs of motions up, and the expected squared error is not a sum; what is summed here is the additive cost
of `driftplan.planning.cost`, which bounds it from above and ranks paths almost as it does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import isfinite
from typing import Any

from ompl import base as ob

from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import CostRates
from driftplan.planning.ompl.motion_prices import heuristic_of, motion_cost_of
from driftplan.planning.ompl.spaces import goal_position, space_kind
from driftplan.planning.ompl.zone_lookup import ZoneLookup
from driftplan.world.world import World


class DriftObjective(ob.OptimizationObjective):
    """Cost in m²: the additive upper bound of the expected squared position error at the goal.

    For every planner of OMPL that minimises a cost: RRTstar, InformedRRTstar, SORRTstar, BITstar. (PRM and PRMstar
    wait for ever for an objective in Python; FMT, BFMT and AORRTC do not minimise it: see `PLANNERS` and `REFUSED`
    of `driftplan.planning.ompl.solve`.) Works in R^2, SE(2), Dubins, Reeds-Shepp, R^3 and SE(3) spaces. Motions are
    priced exactly, arc by arc where they are curves; noise per radian turned is priced wherever states have
    headings (in R^2 turns lie between motions, where OMPL has no price for them; `driftplan.plan_route` with
    ``planner="roadmap"`` has). See `driftplan.planning.cost` for what the additive cost leaves out, and
    `predict_ompl_path` for the exact drift of the path found.

    Parameters
    ----------
    si : ompl.base.SpaceInformation
        Only its state space is looked at; it is not kept.
    noise : OdometryNoise
        In R^3 and SE(3) isotropic: ``heading_var_per_m`` is the variance of each component of the attitude error,
        ``lateral_var_per_m`` that in each of two directions.
    goal : (x, y), (x, y, z), State, GoalState or GoalStates
        The place where accuracy is wanted, metres: drift is weighed by the distance to it. Several goal states must
        share it and differ in heading only. A path may also end elsewhere, where the problem's goal is a region or has
        a threshold; the cost then bounds the squared error of the place, seen from the robot when it has arrived.
    world : World, optional
        Its zones have noise of their own (plane only). Motions, arcs included, are cut exactly where the zone changes.
    length_weight : float
        m² per metre, >= 0, added to the cost: prefers shorter ways among similar ones.

    Attributes
    ----------
    motionCost, motionCostHeuristic : callables (State, State) -> ompl.base.Cost
        Cost of a motion; a lower bound of the cost of any way between two states, consistent and exact to the goal in
        free space. They are attributes rather than methods so that OMPL's calls reach them without detour; they hold
        numbers only.

    Raises
    ------
    ValueError
        For a space that cannot be priced, several goal positions or a goal region, a weight that is not >= 0, and zones
        in three dimensions.

    Examples
    --------
    >>> space = ob.RealVectorStateSpace(2)
    >>> space.setBounds(0, 10)
    >>> si = ob.SpaceInformation(space)
    >>> objective = DriftObjective(si, OdometryNoise(heading_var_per_m=1e-3), goal=(10.0, 0.0))
    >>> a, b = si.allocState(), si.allocState()
    >>> a[0], a[1], b[0], b[1] = 0.0, 0.0, 10.0, 0.0
    >>> round(objective.motionCost(a, b).value(), 6)
    0.333333
    """

    motionCost: Callable[[Any, Any], Any]
    motionCostHeuristic: Callable[[Any, Any], Any]

    def __init__(
        self, si: Any, noise: OdometryNoise, goal: Any, world: World | None = None, *, length_weight: float = 0.0
    ) -> None:
        super().__init__(si)
        space = si.getStateSpace()
        kind = space_kind(space)
        if not isinstance(noise, OdometryNoise):
            raise ValueError(f"expected an OdometryNoise, got {noise!r}")
        if not (isfinite(length_weight) and length_weight >= 0):
            raise ValueError(f"expected length_weight >= 0 m²/m, got {length_weight!r}")
        zones = () if world is None else world.zones
        if zones and kind.dimensions == 3:
            raise ValueError("expected a world without zones in three dimensions: zones are polygons of the floor")
        self.goal = goal_position(goal, kind)
        self.noise = noise
        self.length_weight = float(length_weight)
        self.zone_noises = tuple(zone.noise for zone in zones)

        elsewhere, *inside = (
            _with_length(CostRates.of(n, kind.dimensions), length_weight) for n in (noise, *self.zone_noises)
        )
        lookup = ZoneLookup(zones, inside, elsewhere) if zones else None
        # A subclass that prices motions in its own way keeps its methods.
        if type(self).motionCost is ob.OptimizationObjective.motionCost:
            self.motionCost = motion_cost_of(space, kind, self.goal, elsewhere, lookup)
        if type(self).motionCostHeuristic is ob.OptimizationObjective.motionCostHeuristic:
            least = CostRates(
                *(min(getattr(r, name) for r in (elsewhere, *inside)) for name in ("heading", "position"))
            )
            self.motionCostHeuristic = heuristic_of(space, kind, self.goal, least)

    def stateCost(self, state: Any) -> Any:
        """Zero: standing still costs nothing."""
        return ob.Cost(0.0)

    def set_error_threshold(self, rms_m: float) -> None:
        """Let planners stop as soon as they have a path whose rms error at the goal is surely below ``rms_m`` metres.

        Raises
        ------
        ValueError
            If the cost does not bound the error: with systematic errors, correlated noise, noise per step, or a
            ``length_weight``.
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


def _with_length(rates: CostRates, length_weight: float) -> CostRates:
    return replace(rates, position=rates.position + float(length_weight))
