"""capture: does a robot that drifted as predicted still come within range of the beacon it counts on?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon, beacon_fixes, floor_of, passes, waypoints_of
from driftplan.model.drift import PointDrift, predict_drift
from driftplan.model.fixes import Fix
from driftplan.model.noise import OdometryNoise
from driftplan.world.world import World

_QUANTILES = 128  # per principal axis of the error
_REACH = 4.0  # how many rms errors beside its pass a robot may be and still be looked for


class Capture(NamedTuple):
    """One pass and the probability that it happens."""

    beacon: Beacon
    enter_m: float  # of the path as planned
    leave_m: float
    probability: float


def capture(
    path: Any,
    noise: OdometryNoise,
    beacons: Sequence[Beacon],
    world: World | None = None,
    *,
    fixes: Sequence[Fix] = (),
) -> list[Capture]:
    """For every pass of a path, the probability that the robot really comes within range.

    The robot steers by its estimate, so where it believes itself on the path it is off by the drift e, as predicted on
    arrival with the fixes before the pass. Near the pass its true path is the planned one moved by -e; it is captured
    if that comes within range. The error is taken for Gaussian with the exact mean and covariance (quantiles on a grid:
    good to 0.01). Whether the tag, once in range, is read at all is `BeaconKind.detection_probability`; walls are not
    considered again. Earlier passes count as in `drift_with_beacons`, captured or not.

    Parameters
    ----------
    path, noise, beacons, world, fixes :
        As for `driftplan.beacons.beacon.drift_with_beacons`.

    Returns
    -------
    list of Capture, in driving order

    Examples
    --------
    >>> from driftplan.beacons.beacon import BeaconKind
    >>> noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    >>> tag = BeaconKind.rfid(range_m=1.0, position_std_m=0.1)
    >>> found = capture([(0, 0), (60, 0)], noise, [Beacon(tag, x=10.0, y=0.5), Beacon(tag, x=55.0, y=0.5)])
    >>> [round(c.probability, 2) for c in found]
    [0.97, 0.22]
    """
    xy = waypoints_of(path)
    readings = [*fixes, *beacon_fixes(xy, beacons, world)]
    floor, noises = floor_of(xy, noise, world)
    meetings = sorted(
        ((*interval, beacon) for beacon in beacons for interval in passes(xy, beacon, world).tolist()),
        key=lambda meeting: meeting[:2],
    )
    found = []
    for enter, leave, beacon in meetings:
        arrival = predict_drift(floor, noises, fixes=[fix for fix in readings if fix.s_m < enter]).at(enter)
        window = beacon.kind.range_m + _REACH * float(arrival.rms)
        near = _stretch(xy, enter - window, leave + window)
        distance = shapely.distance(near, shapely.points(beacon.xy + _possible_errors(arrival)))
        found.append(Capture(beacon, enter, leave, float(np.mean(distance <= beacon.kind.range_m + 1e-9))))
    return found


def _possible_errors(arrival: PointDrift) -> Floats:
    """Errors of equal probability, (k, 2)."""
    from scipy.special import ndtri

    variance, axes = np.linalg.eigh(arrival.cov)
    z = ndtri((np.arange(_QUANTILES) + 0.5) / _QUANTILES)
    grid = np.stack(np.meshgrid(z, z), axis=-1).reshape(-1, 2) * np.sqrt(np.maximum(variance, 0.0))
    return np.asarray(arrival.bias + grid @ axes.T)


def _stretch(path: Floats, start: float, end: float) -> Any:
    """The part of the path between two distances, as far as there is one."""
    line = shapely.LineString(path)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    start, end = max(start, 0.0), min(end, float(s[-1]))
    ends = shapely.get_coordinates(shapely.line_interpolate_point(line, [start, end]))
    return shapely.LineString(np.concatenate([ends[:1], path[(s > start) & (s < end)], ends[1:]]))
