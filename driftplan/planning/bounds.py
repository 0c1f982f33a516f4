"""What no route can do better: proven lower bounds.

*Of all routes*, beacons or not, obstacles or not. After its last position reading, of standard deviation σ per axis, a
robot that drives L metres and ends a distance d away from there has

    E|e|² >= 2σ² + q_p L + Λ(σ_H) q_h d³/3

(`driftplan.planning.cost`): position noise adds up whatever is done about the heading, and the heading part holds while
no beacon fixes headings alone. So position readings cannot be farther apart than a limit lets them, and a route that
keeps it is at least as long as the shortest chain of ranges from start to goal whose gaps are within reach: a
refuelling problem, solved by Dijkstra's method. Errors that are correlated can cancel, and then only geometry is left;
the heading part needs plain noise. Zones count with the best of them everywhere. A reading that is not certain is taken
for perfect.

*Of the paths of a roadmap*, by the least additive cost on it and the bracket that the heading error leaves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csgraph, csr_matrix

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import CostRates, bracket
from driftplan.planning.roadmap.graph import GOAL, START, Roadmap

_HALVINGS = 40
_HEADING_STD_FACTOR = 2.0  # times the heading standard deviation of the path found: bounds are for paths of up to that
_HEADING_VARIANCES = 4000  # at which the additive bound is evaluated


class DeadReckoningBound:
    """Least E|e|² of driving straight for d metres without a position reading: ``position`` d + ``heading`` d³/3.

    ``found_sq`` (m²) is an E|e|² that some route has: those that have more are of no interest.
    """

    def __init__(self, noises: Sequence[OdometryNoise], beacons: Sequence[Beacon], found_sq: float) -> None:
        rates = [CostRates.of(noise) for noise in noises]
        uncorrelated = all(noise.heading_distance_corr == 0 for noise in noises)
        self.position = min(rate.position for rate in rates) if uncorrelated else 0.0
        self.heading = 0.0
        sure = all(b.kind.position_std_m is not None and b.kind.detection_probability == 1 for b in beacons)
        plain = all(noise.is_plain and not noise.heading_var_per_rad for noise in noises)
        if plain and sure and self.position > 0 and math.isfinite(found_sq):
            # no longer than this before position noise alone has used the limit up
            heading_std = math.sqrt(max(rate.heading for rate in rates) * found_sq / self.position)
            self.heading = float(bracket(heading_std)) * min(rate.heading for rate in rates)

    def square(self, d: Floats) -> Floats:
        return np.asarray(self.position * d + self.heading * d**3 / 3)


def least_length(
    ends: Floats, noises: Sequence[OdometryNoise], beacons: Sequence[Beacon], max_drift: float | None
) -> float:
    """No route that keeps ``max_drift`` is shorter, metres; infinite where none can keep it.

    Parameters
    ----------
    ends : (2, 2) start and goal, metres
    noises : noises that occur, of zones too
    beacons : all there are
    max_drift : metres, or None

    Examples
    --------
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
        unaided = DeadReckoningBound(noises, beacons, found_sq)
        sure = [(b.kind.position_std_m or 0.0) if b.kind.detection_probability == 1 else 0.0 for b in stations]
        after = np.array([0.0, *(2 * std**2 for std in sure)])  # least E|e|² on leaving each, the start known exactly
        self.arrival: Floats = after[:, None] + unaided.square(self.gap[:-1])
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


class Bound(NamedTuple):
    """No path of a roadmap that gains a heading standard deviation of at most ``heading_std`` rad costs less."""

    mean_square: float  # m²
    heading_std: float  # rad; infinite where it holds for all paths


def additive_bound(roadmap: Roadmap, least_var: float, most_var: float, known: float = math.inf) -> float:
    """A lower bound of E|e|² (m²) over all paths of the roadmap whose heading variance H is in a range (rad²).

    Such a path has ``E|e|² >= Λ(H) J_h + J_p`` with its heading and position cost. With the least J and J_h on the
    roadmap, and the least position cost r per heading variance of any of its edges and a turn, that is at least
    ``max(Λ(H) min J, Λ(H) min J_h + r H)``, whose least value over H is returned. Zero where the noise is not plain.
    ``known`` is the additive cost of some path: no need to look at dearer ones for min J.
    """
    if not _is_plain(roadmap):
        return 0.0
    return _additive_bound(roadmap, min(roadmap.shortest(known).cost, known), least_var, most_var)


def _additive_bound(roadmap: Roadmap, least: float, least_var: float, most_var: float) -> float:
    """`additive_bound` for plain noise, the least additive cost on the roadmap being known."""
    prices = roadmap.prices
    if not least < math.inf:
        return math.inf
    heading_cost = roadmap.distances(np.maximum(prices.cost - prices.position, 0.0), START)[0][GOAL]
    low = max(least_var, roadmap.distances(prices.heading_var, START)[0][GOAL])
    gained = prices.heading_var + np.pi * roadmap.pricing.worst_turn
    rate = float(np.min(prices.position / np.where(gained > 0, gained, 1e-300)))
    high = min(most_var, max(low, least / rate) if rate > 0 else math.inf)  # beyond, r H alone is enough
    if high == math.inf:
        return 0.0
    if high <= low:
        return least * float(bracket(high**0.5))
    grid = np.geomspace(max(low, 1e-9 * high), high, _HEADING_VARIANCES)
    grid[0] = low
    weight = bracket(np.sqrt(grid[1:]))  # Λ falls and r H rises: both at their least in every interval
    return float(np.maximum(weight * least, weight * heading_cost + rate * grid[:-1]).min())


def bracketed(roadmap: Roadmap, heading_std: float, known: float = math.inf) -> Bound:
    """What the additive cost proves: for all paths, or for those with up to twice the ``heading_std`` of one found."""
    most = (_HEADING_STD_FACTOR * heading_std) ** 2
    if not _is_plain(roadmap):
        return Bound(0.0, math.inf)
    least = min(roadmap.shortest(known).cost, known)
    return _beyond(roadmap, least, most, _additive_bound(roadmap, least, 0.0, most))


def _beyond(roadmap: Roadmap, least: float, most_var: float, bound: float) -> Bound:
    """A bound for paths of heading variance up to ``most_var``; for all of them where the others cannot be better."""
    everywhere = most_var == math.inf or _additive_bound(roadmap, least, most_var, math.inf) >= bound
    return Bound(bound, math.inf if everywhere else most_var**0.5)


def _is_plain(roadmap: Roadmap) -> bool:
    return all(noise.is_plain for noise in roadmap.pricing.noises)
