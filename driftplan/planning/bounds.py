"""What no route can do better, beacons or not, obstacles or not: proven lower bounds.

After its last position reading, of standard deviation σ per axis, a
robot that drives L metres and ends a distance d away from there has

    E|e|² >= 2σ² + q_p L + Λ(σ_H) q_h d³/3

(`driftplan.planning.cost`): position noise adds up whatever is done about the heading, and the heading part holds while
no beacon fixes headings alone. So position readings cannot be farther apart than a limit lets them, and a route that
keeps it is at least as long as the shortest chain of ranges from start to goal whose gaps are within reach: a
refuelling problem, solved by Dijkstra's method. Errors that are correlated can cancel, and then only geometry is left;
the heading part needs plain noise. Zones count with the best of them everywhere. A reading that is not certain is taken
for perfect. (`driftplan.planning.taut_strings` bounds what robots do that read nothing, among obstacles.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import csgraph, csr_matrix

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import CostRates, bracket

_HALVINGS = 40


def least_length(
    ends: Floats, noises: Sequence[OdometryNoise], beacons: Sequence[Beacon], max_drift: float | None
) -> float:
    """No route that keeps ``max_drift`` (metres, or None) is shorter, metres; infinite where none can keep it.

    ``noises`` are those that occur, of zones too; ``ends`` (2, 2) are start and goal, metres.

    >>> noise = OdometryNoise(distance_var_per_m=0.1)
    >>> least_length(np.array([(0, 0), (50, 0)]), [noise], [], 1.0), least_length(np.eye(2), [noise], [], 1.0)
    (inf, 1.4142135623730951)
    """
    straight = float(np.linalg.norm(ends[1] - ends[0]))
    if max_drift is None:
        return straight
    return max(straight, _BeaconChain(ends, noises, beacons, max_drift**2).length(max_drift**2))


def least_end_drift(ends: Floats, noises: Sequence[OdometryNoise], beacons: Sequence[Beacon], found: float) -> float:
    """No route arrives with a smaller rms drift, metres, given that one arrives with ``found``."""
    return min(math.sqrt(float(_BeaconChain(ends, noises, beacons, found**2).at_goal.min())), found)


def least_worst_drift(ends: Floats, noises: Sequence[OdometryNoise], beacons: Sequence[Beacon], found: float) -> float:
    """No route keeps its drift below this everywhere, metres, given that one keeps it below ``found``."""
    chain = _BeaconChain(ends, noises, beacons, found**2)
    low, high = float(chain.at_goal.min()), found**2
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if math.isfinite(chain.length(middle)) else (middle, high)
    return math.sqrt(min(low, found**2))


def max_distance_within(limit_sq: float, heading: float, position: float, most: float) -> float:
    """Greatest d <= ``most`` with ``position`` d + ``heading`` d³/3 <= ``most_sq``, metres."""
    if position * most + heading * most**3 / 3 <= limit_sq:
        return most
    low, high = 0.0, most
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if position * middle + heading * middle**3 / 3 <= limit_sq else (low, middle)
    return high


def _dead_reckoning_rates(
    noises: Sequence[OdometryNoise], beacons: Sequence[Beacon], found_sq: float
) -> tuple[float, float]:
    """Least E|e|² of driving straight for d metres without a position reading is ``position`` d + ``heading`` d³/3.

    ``found_sq`` (m²) is an E|e|² that some route has: those that have more are of no interest.
    """
    rates = [CostRates.of(noise) for noise in noises]
    uncorrelated = all(noise.heading_distance_corr == 0 for noise in noises)
    position = min(rate.position for rate in rates) if uncorrelated else 0.0
    sure = all(b.kind.position_std_m is not None and b.kind.detection_probability == 1 for b in beacons)
    plain = all(noise.is_plain and not noise.heading_var_per_rad for noise in noises)
    if not (plain and sure and position > 0 and math.isfinite(found_sq)):
        return 0.0, position
    # no longer than this before position noise alone has used the limit up
    heading_std = math.sqrt(max(rate.heading for rate in rates) * found_sq / position)
    return float(bracket(heading_std)) * min(rate.heading for rate in rates), position


class _BeaconChain:
    """Start, the ranges of beacons that give positions, and goal, with the gaps between them."""

    def __init__(
        self, ends: Floats, noises: Sequence[OdometryNoise], beacons: Sequence[Beacon], found_sq: float
    ) -> None:
        stations = [b for b in beacons if b.kind.position_std_m is not None]
        xy = np.array([ends[0], *(b.xy for b in stations), ends[1]])
        radius = np.array([0.0, *(b.kind.range_m for b in stations), 0.0])
        apart = np.hypot(*np.moveaxis(xy[:, None] - xy, -1, 0))
        self.gap = np.maximum(apart - radius[:, None] - radius, 0.0)
        heading, position = _dead_reckoning_rates(noises, beacons, found_sq)
        sure = [(b.kind.position_std_m or 0.0) if b.kind.detection_probability == 1 else 0.0 for b in stations]
        after = np.array([0.0, *(2 * std**2 for std in sure)])  # least E|e|² on leaving each, the start known exactly
        self.arrival: Floats = after[:, None] + position * self.gap[:-1] + heading * self.gap[:-1] ** 3 / 3
        self.at_goal: Floats = self.arrival[:, -1]

    def length(self, limit_sq: float) -> float:
        """Of the shortest chain in which every gap keeps E|e|² within ``limit_sq``; infinite if there is none."""
        usable = np.zeros(self.gap.shape, dtype=bool)
        usable[:-1] = self.arrival <= limit_sq
        row, column = np.nonzero(usable)
        # explicit weights a little above zero: ranges that touch are joined, which a zero would not say
        weight = np.maximum(self.gap[row, column], 1e-300)
        search: Any = csgraph.dijkstra
        graph = csr_matrix((weight, (row, column)), shape=usable.shape)
        return float(search(graph, indices=0)[-1])
