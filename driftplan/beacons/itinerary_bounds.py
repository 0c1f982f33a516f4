"""What no route can do better, beacons or not, obstacles or not: proven lower bounds for itineraries.

Position noise of variance q_p per metre adds up whatever is done about the heading. Where no heading is ever fixed,
``E|e|² >= q_p L + Λ(σ_H) J`` after a route of length L, with J >= q_h d³/3 for ends a distance d apart (see
`driftplan.planning.cost`). After the last position reading, of standard deviation σ per axis at a distance d, it is at
least 2σ² + q_p d. All of that needs white noise without correlations; otherwise the bounds are those of geometry.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from driftplan.beacons.beacon import Beacon
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Floats
from driftplan.planning.cost import CostRates, bracket
from driftplan.world.world import World


def least_length(
    world: World, ends: Floats, noise: OdometryNoise, beacons: Sequence[Beacon], max_drift: float | None
) -> float:
    """No route that keeps ``max_drift`` is shorter, metres; infinite where none can keep it."""
    straight = float(np.linalg.norm(ends[1] - ends[0]))
    if max_drift is None or _least_unaided(world, noise, beacons, straight, max_drift**2) <= max_drift**2:
        return straight
    around = (
        _beyond(ends[0], beacon) + _beyond(ends[1], beacon)
        for beacon in beacons
        if beacon.kind.position_std_m is not None
    )
    return max(straight, min(around, default=math.inf))


def least_end_drift(world: World, ends: Floats, noise: OdometryNoise, beacons: Sequence[Beacon], found: float) -> float:
    """No route arrives with a smaller rms drift, metres, given that one arrives with ``found``."""
    straight = float(np.linalg.norm(ends[1] - ends[0]))
    least = _least_unaided(world, noise, beacons, straight, found**2)
    position = _position_rate(world, noise)
    for beacon in beacons:
        if beacon.kind.position_std_m is not None:
            least = min(least, 2 * beacon.kind.position_std_m**2 + position * _beyond(ends[1], beacon))
    return min(math.sqrt(least), found)


def _least_unaided(
    world: World, noise: OdometryNoise, beacons: Sequence[Beacon], straight: float, square: float
) -> float:
    """E|e|² of every route that reads no position and stays below ``square`` is at least this, in m²."""
    position = _position_rate(world, noise)
    least = position * straight
    kinds = _kinds(world, noise)
    plain = all(k.heading_var_per_rad == 0 and not k.is_systematic and k.heading_distance_corr == 0 for k in kinds)
    heading_fixed = any(b.kind.position_std_m is None for b in beacons)
    if plain and position > 0 and not heading_fixed:
        rates = [CostRates.of(kind) for kind in kinds]
        heading_std = math.sqrt(max(rate.heading for rate in rates) * square / position)
        least += float(bracket(heading_std)) * min(rate.heading for rate in rates) * straight**3 / 3
    return least


def _position_rate(world: World, noise: OdometryNoise) -> float:
    """Least variance of the position per metre, m²/m, that no heading error can compensate."""
    kinds = _kinds(world, noise)
    if any(k.heading_distance_corr != 0 or k.is_systematic for k in kinds):
        return 0.0
    return min(CostRates.of(kind).position for kind in kinds)


def _kinds(world: World, noise: OdometryNoise) -> tuple[OdometryNoise, ...]:
    return (noise, *(zone.noise for zone in world.zones))


def _beyond(point: Floats, beacon: Beacon) -> float:
    """Distance from a point to the range of a beacon."""
    return max(0.0, math.hypot(point[0] - beacon.x, point[1] - beacon.y) - beacon.kind.range_m)
