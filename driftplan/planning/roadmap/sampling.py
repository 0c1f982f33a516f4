"""Where nodes may lie: corners of the inflated obstacles, even samples of free space, and places within range."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import BeaconColumns
from driftplan.planning.roadmap.prices import Space
from driftplan.world.world import World

# Additive recurrence by the inverse powers of the plastic number g, g³ = g + 1: evenly spread however many are drawn.
# (M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018.)
_STEP = 1.32471795724474602596 ** -np.array([1.0, 2.0])
_DIRECTIONS = 8  # in which a place within range is looked for
_DEPTHS = (0.35, 0.7)  # in units of the range


def coarse_corners(space: Space) -> Floats:
    """Corners of a space, (n, 2), those that crowd together left out."""
    xmin, ymin, xmax, ymax = space.bounds
    radius = getattr(space, "robot_radius", 0.0)
    return space.corners(max(radius / 4, 4e-4 * math.hypot(xmax - xmin, ymax - ymin)))


class FreeSamples:
    """A low-discrepancy sequence of points over a space, of which the free and useful ones are taken.

    It begins at ``first`` (2,) of the unit square. At most ``max_draws`` times as many points are drawn as are wanted:
    the useful region may be tiny.
    """

    def __init__(self, space: Space, first: Floats, max_draws: int) -> None:
        self._space, self._first, self._max_draws = space, first, max_draws
        self._drawn = 0

    def next(self, count: int, useful: Callable[[Floats], Floats]) -> Floats:
        """Up to ``count`` free points of those that ``useful`` keeps, the next ones of the sequence."""
        xmin, ymin, xmax, ymax = self._space.bounds
        found: list[Floats] = [np.zeros((0, 2))]
        wanted = count
        for _ in range(self._max_draws):
            unit = (self._first + _STEP * np.arange(self._drawn, self._drawn + count)[:, None]) % 1.0
            self._drawn += count
            points = useful(unit * (xmax - xmin, ymax - ymin) + (xmin, ymin))
            points = points[self._space.is_free(points)][:wanted]
            found.append(points)
            wanted -= len(points)
            if wanted <= 0:
                break
        return np.concatenate(found)


def places_in_range(space: Space, world: World | None, beacons: Sequence[Beacon], max_places: int) -> Floats:
    """Free points within range of each beacon, and in its sight where that matters: the nearest, then others spread
    around it; about ``max_places`` in all, (n, 2)."""
    if not beacons:
        return np.zeros((0, 2))
    columns = BeaconColumns.of(beacons)
    per = int(np.clip(max_places // len(beacons), 1, _DIRECTIONS))
    angle = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    offsets = np.concatenate([np.zeros((1, 2)), *(depth * circle for depth in _DEPTHS)])
    places = columns.xy[:, None, :] + columns.range_m[:, None, None] * offsets
    good = space.is_free(places)
    if world is not None:
        asked = good & columns.must_see[:, None]
        good[asked] = world.line_of_sight(places[asked], columns.xy[np.nonzero(asked)[0]])
    # the nearest first, then one direction after the other with big steps
    spread = (3 * np.arange(_DIRECTIONS)) % _DIRECTIONS
    order = np.concatenate([[0], *(1 + _DIRECTIONS * ring + spread for ring in range(len(_DEPTHS)))])
    rank = np.cumsum(good[:, order], axis=1)
    chosen = good[:, order] & (rank <= per)
    return np.asarray(places[:, order][chosen])
