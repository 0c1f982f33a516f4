"""An OMPL problem in the words of the roadmap: what its objective wants, and where its checkers let the robot drive."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from ompl import base as ob

from driftplan.arrays import Bools, Floats
from driftplan.errors import PlannerError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.roadmap.prices import Score
from driftplan.world.world import World
from driftplan.world.zones import Zone, ZonePieces


class Target(NamedTuple):
    """What an OMPL objective asks for, without the objective."""

    minimise: Score
    noise: OdometryNoise
    goal: tuple[float, ...] | None  # where drift is weighed, metres; None: where the path ends
    zone_noises: tuple[OdometryNoise, ...]
    scale: float = 1.0  # what the objective's cost is in times of the additive cost

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


def target_of(objective: Any) -> Target:
    drift, times, length_weight = _parts(objective)
    if drift is None:
        return Target("length", OdometryNoise(), None, (), length_weight)
    weight = drift.length_weight + length_weight / times
    noises = [_with_length(noise, weight) for noise in (drift.noise, *drift.zone_noises)]
    return Target("drift", noises[0], None if drift.is_following else drift.goal, tuple(noises[1:]), times)


def _parts(objective: Any) -> tuple[DriftObjective | None, float, float]:
    """The drift in an objective, its weight, and the weight of the length."""
    if isinstance(objective, DriftObjective):
        if type(objective).motionCost is not DriftObjective.motionCost:
            raise PlannerError(
                f"expected a DriftObjective that prices motions as it was made to, got {type(objective).__name__} "
                "with a motionCost of its own, which the roadmap cannot do in bulk"
            )
        return objective, 1.0, 0.0
    if isinstance(objective, ob.PathLengthOptimizationObjective):
        return None, 0.0, 1.0
    if isinstance(objective, ob.MultiOptimizationObjective):
        drift, times, length = None, 0.0, 0.0
        for k in range(objective.getObjectiveCount()):
            part, share = objective.getObjective(k), float(objective.getObjectiveWeight(k))
            if isinstance(part, DriftObjective) and drift is None and share > 0:
                drift, times = _parts(part)[0], share
            elif isinstance(part, ob.PathLengthOptimizationObjective) and share > 0:
                length += share
            else:
                raise PlannerError(
                    "expected a MultiOptimizationObjective of one DriftObjective and path lengths, weights above 0, "
                    f"got {type(part).__name__} with weight {share:g} in it"
                )
        if drift is None and length == 0:
            raise PlannerError("expected a MultiOptimizationObjective with something in it, got an empty one")
        return drift, times, length
    raise PlannerError(
        "expected a DriftObjective, a PathLengthOptimizationObjective or a MultiOptimizationObjective of these, which "
        f"the roadmap can price in bulk, got {type(objective).__name__}"
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


def box_of(space: Any) -> tuple[float, float, float, float]:
    """(xmin, ymin, xmax, ymax) of a state space, metres."""
    bounds = space.getBounds()
    (xmin, ymin), (xmax, ymax) = list(bounds.low)[:2], list(bounds.high)[:2]
    if not (xmin < xmax and ymin < ymax):
        raise PlannerError(f"expected a state space with bounds, got x {xmin}..{xmax}, y {ymin}..{ymax}")
    return xmin, ymin, xmax, ymax


class OmplCheckedSpace:
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
