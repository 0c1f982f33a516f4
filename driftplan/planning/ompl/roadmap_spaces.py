"""Where an OMPL SpaceInformation lets the robot drive, in the words in which the roadmap asks."""

from __future__ import annotations

from typing import Any

import numpy as np

from driftplan.arrays import Bools, Floats
from driftplan.errors import PlannerError
from driftplan.world.world import World
from driftplan.world.zones import Zone, ZonePieces


def box_of(space: Any) -> tuple[float, float, float, float]:
    """(xmin, ymin, xmax, ymax) of a state space, metres."""
    bounds = space.getBounds()
    (xmin, ymin), (xmax, ymax) = list(bounds.low)[:2], list(bounds.high)[:2]
    if not (xmin < xmax and ymin < ymax):
        raise PlannerError(f"expected a state space with bounds, got x {xmin}..{xmax}, y {ymin}..{ymax}")
    return xmin, ymin, xmax, ymax


class ClippedWorld:
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
