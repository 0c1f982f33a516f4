"""What a robot reads of the beacons along its path, what that does to its drift, and whether it gets to read them.

The model of a pass. Along a stretch within range the beacon is read where the stretch begins, where it ends and in
between at most `BeaconKind.reading_spacing_m` apart; on a stretch of no length (a graze) once. Every reading is a fix
whose error is fresh (the range and the reader's geometry are part of its standard deviation). A robot with a filter
fuses it (`driftplan.model.filter_state`). For a robot that resets, the default, it *replaces* the measured part of the
robot's error; nothing is averaged. Hence

* within range the drift is that of the fix, grown over the odometry since the last reading; it grows on from where the
  path leaves the range;
* the latest reading wins where ranges overlap, and where several beacons are read at the same place the more accurate;
* a further beacon can make matters worse: a coarse reading replaces a good estimate.

A pass is noticed with probability p = `detection_probability`: each of its n readings succeeds with 1 - (1 - p)^(1/n),
independently, so that the whole pass is missed with probability 1 - p.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from functools import cache
from math import inf
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import Bools, Floats, Ints
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.passes import Passes, Views, passes_of
from driftplan.model.drift import Drift, predict_drift
from driftplan.model.noise import Noises, OdometryNoise
from driftplan.model.point_drift import PointDrift
from driftplan.model.readings import Estimator, Fix, Readings
from driftplan.world.world import World

_POINT_M = 1e-6  # a pass shorter than this is one reading
_PLANE = np.array([1.0, 1j])  # vectors @ this: complex numbers
_ERRORS = 512  # of equal probability, over which the chance of a pass is averaged
_WINDOW_RMS = 4.0  # how many rms errors beside its pass a robot may be and still be looked for


def beacon_passes(path: Any, beacon: Beacon, world: World | None = None) -> Floats:
    """Where a path is within range of a beacon (and in its sight): metres driven on entering and on leaving.

    Parameters
    ----------
    path : (n, 2) waypoints in metres, or anything with such a ``path``
    world : its walls block beacons that work in line of sight; without it nothing does

    Returns
    -------
    array, shape (k, 2)
        One row per pass, in driving order; a graze is a row of two equal numbers.

    >>> tag = BeaconKind.rfid(range_m=1.0, position_std_m=0.1)
    >>> beacon_passes([(0, 0), (10, 0), (0, 0)], Beacon(tag, x=4.0, y=1.0)).tolist()
    [[4.0, 4.0], [16.0, 16.0]]
    """
    found = BeaconColumns.of([beacon]).passes(waypoints_of(path), world)
    return np.stack([found.enter, found.leave], axis=-1)


def beacon_fixes(path: Any, beacons: Sequence[Beacon], world: World | None = None) -> list[Fix]:
    """The readings of ``beacons`` along a path as fixes of the drift model, in driving order.

    >>> tag = BeaconKind.rfid(range_m=1.0, position_std_m=0.1)
    >>> [fix.s_m for fix in beacon_fixes([(0, 0), (10, 0)], [Beacon(tag, x=4.0, y=0.0)])]
    [3.0, 5.0]
    """
    return readings_on(waypoints_of(path), BeaconColumns.of(beacons), world).fixes()


def drift_with_beacons(
    path: Any,
    noise: OdometryNoise,
    beacons: Sequence[Beacon],
    world: World | None = None,
    *,
    fixes: Sequence[Fix] = (),
    estimator: Estimator = "reset",
    start_heading: float | None = None,
) -> Drift:
    """Drift along a path of a robot that reads ``beacons`` on its way; exact under the model of this module.

    Parameters
    ----------
    path : (n, 2) waypoints in metres, or anything with such a ``path``
    world : its walls block sight and its zones have their own noise; the result then has a waypoint at every zone
        border
    fixes : further fixes, such as one at 0 for an uncertain start. At one place they come before the beacons'.
    estimator, start_heading : as for `predict_drift`: what the robot does with a reading, and where it faces
        before its first turn

    >>> noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    >>> tag = BeaconKind.rfid(range_m=1.0, position_std_m=0.1)
    >>> drift = drift_with_beacons([(0, 0), (30, 0), (30, 10)], noise, [Beacon(tag, x=30.0, y=0.0)])
    >>> drift.rms.round(3)  # at the corner the tag is in range, read a metre before
    array([0.   , 0.145, 0.326])
    """
    xy = waypoints_of(path)
    readings = Readings.of(fixes) + readings_on(xy, BeaconColumns.of(beacons), world)
    xy, noises = floor_of(xy, noise, world)
    return predict_drift(xy, noises, fixes=readings, estimator=estimator, start_heading=start_heading)


def waypoints_of(path: Any, where: str = "") -> Floats:
    """The waypoints (n, 2) of a route (its ``path``) or of a plain array, checked; ``where`` begins what is said."""
    raw = getattr(path, "path", path)
    try:
        if np.iscomplexobj(raw):
            raise TypeError("complex numbers are none")
        xy = np.asarray(raw, dtype=float)
    except (TypeError, ValueError, OverflowError) as err:
        raise ValueError(f"{where}expected a path of numbers (n, 2), got {type(raw).__name__}: {err}") from None
    if xy.ndim != 2 or xy.shape[1] != 2 or len(xy) < 2:
        wanted = "a path (n, 2) of at least 2 waypoints in metres"
        raise ValueError(f"{where}expected {wanted}, got an array of shape {xy.shape}")
    if not np.isfinite(xy).all():
        bad = xy[~np.isfinite(xy).all(axis=1)][0].tolist()
        raise ValueError(f"{where}expected a path of finite coordinates, got {bad}")
    return xy


def floor_of(path: Floats, noise: OdometryNoise, world: World | None) -> tuple[Floats, Noises]:
    """The path with a waypoint at every zone border, and the noise of every leg (one noise when there are no zones)."""
    if world is None or not world.zones:
        return path, noise
    path, zone = world.cut_at_zones(path)
    return path, [noise if z < 0 else world.zones[z].noise for z in zone.tolist()]


class BeaconColumns(NamedTuple):
    """Beacons as arrays of one length."""

    xy: Floats
    range_m: Floats
    must_see: Bools
    reading_spacing_m: Floats
    detection_probability: Floats
    position_std_m: Floats  # NaN where the position is not measured
    heading_std: Floats  # NaN where the heading is not measured
    rank: Ints  # of readings at one place the one with the highest rank, the most accurate, comes last
    range_std_m: Floats  # NaN where the distance is not measured
    bearing_std: Floats  # NaN where the direction is not measured
    std_per_m: Floats
    views: Views

    @classmethod
    def of(cls, beacons: Sequence[Beacon]) -> BeaconColumns:
        """The columns of beacons."""
        measures = [f.name for f in fields(BeaconKind) if f.name != "name"]
        column = {name: np.array([getattr(b.kind, name) for b in beacons], dtype=float) for name in measures}
        accuracy = np.stack([-np.nan_to_num(column[name], nan=inf) for name in ("position_std_m", "heading_std")])
        facing = np.array([b.facing_deg or 0.0 for b in beacons], dtype=float)
        views = (np.radians(column.pop(name)) / 2 for name in ("view_angle_deg", "sensor_view_deg"))
        return cls(
            xy=np.array([[b.x, b.y] for b in beacons], dtype=float).reshape(-1, 2),
            must_see=column["line_of_sight"].astype(bool),
            rank=np.unique(accuracy, axis=1, return_inverse=True)[1].ravel(),
            views=Views(np.radians(facing), *views),
            **{name: x for name, x in column.items() if name in cls._fields},
        )

    def passes(self, path: Floats, world: World | None) -> Passes:
        """Where a path (n, 2) passes them."""
        return passes_of(path, self.xy, self.range_m, self.must_see, world, self.views)

    def readings_of_passes(self, path: Floats, passes: Passes) -> tuple[Readings, Ints]:
        """The readings of passes of a path (n, 2), and the pass of each."""
        length = passes.leave - passes.enter
        parts = np.maximum(np.ceil(length / self.reading_spacing_m[passes.beacon] - 1e-6), 1)
        count = np.where(length < _POINT_M, 1, parts + 1).astype(np.intp)
        k = np.repeat(np.arange(len(count)), count)
        step = np.arange(len(k)) - np.repeat(np.cumsum(count) - count, count)
        beacon = passes.beacon[k]
        s_m = passes.enter[k] + length[k] * step / np.maximum(count[k] - 1, 1)
        steps = np.diff(path, axis=0)
        driven = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
        distance = np.hypot(*(np.interp(s_m, driven, path[:, axis]) - self.xy[beacon, axis] for axis in (0, 1)))
        chance = 1 - (1 - self.detection_probability[beacon]) ** (1 / count[k])
        return readings_from(self, beacon, distance, s_m, chance), k


def readings_on(path: Floats, beacons: BeaconColumns, world: World | None) -> Readings:
    """All readings along a path (n, 2), by beacon, in driving order; ``source`` is the beacon."""
    return beacons.readings_of_passes(path, beacons.passes(path, world))[0]


def readings_from(beacons: BeaconColumns, beacon: Ints, distance: Floats, s_m: Floats, chance: Floats) -> Readings:
    """Readings (k,) of beacons from a distance, metres, taken at ``s_m`` along some path."""
    looser = beacons.std_per_m[beacon] * distance
    ranging = ~np.isnan(beacons.range_std_m[beacon]) | ~np.isnan(beacons.bearing_std[beacon])
    return Readings(
        s_m=s_m,
        square=2 * (beacons.position_std_m[beacon] + looser) ** 2,
        skew=np.zeros(len(beacon), dtype=complex),
        heading_var=beacons.heading_std[beacon] ** 2,
        chance=chance,
        rank=beacons.rank[beacon],
        source=beacon,
        anchor=np.where(ranging, beacons.xy[beacon] @ _PLANE, np.nan),
        range_var=(beacons.range_std_m[beacon] + looser) ** 2,
        bearing_var=beacons.bearing_std[beacon] ** 2,
    )


class DetectionChance(NamedTuple):
    """One pass of a beacon and the probability that it happens.

    >>> tag, noise = Beacon(BeaconKind.rfid(range_m=1.0, position_std_m=0.1), 5.0, 0.0), OdometryNoise()
    >>> [chance] = detection_chances([(0, 0), (10, 0)], noise, [tag])
    >>> chance.beacon is tag, chance.enter_m, chance.leave_m, chance.probability
    (True, 4.0, 6.0, 1.0)
    """

    beacon: Beacon
    enter_m: float  # of the path as planned
    leave_m: float
    probability: float


def detection_chances(
    path: Any,
    noise: OdometryNoise,
    beacons: Sequence[Beacon],
    world: World | None = None,
    *,
    fixes: Sequence[Fix] = (),
    estimator: Estimator = "reset",
) -> list[DetectionChance]:
    """For every pass of a path, in driving order, the probability that the robot really comes within range.

    The robot steers by its estimate, so where it believes itself on the path it is off by the drift e, as predicted on
    arrival with the fixes before the pass. Near the pass its true path is the planned one moved by -e; the pass happens
    if that comes within range. "Near" is within four rms errors of the range, and at most half-way to the next pass of
    the same beacon. The error is taken for Gaussian with the exact mean and covariance (an average over 512 errors of
    equal probability: good to 0.01). Whether the tag, once in range, is read at all is
    `BeaconKind.detection_probability`; walls are not considered again. Earlier passes count as in
    `drift_with_beacons`, whether they happen or not.

    Parameters
    ----------
    path, noise, beacons, world, fixes, estimator : as for `drift_with_beacons`

    >>> noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    >>> tag = BeaconKind.rfid(range_m=1.0, position_std_m=0.1)
    >>> tags = [Beacon(tag, x=10.0, y=0.5), Beacon(tag, x=55.0, y=0.5)]
    >>> [round(c.probability, 2) for c in detection_chances([(0, 0), (60, 0)], noise, tags)]
    [0.97, 0.21]
    """
    xy, columns = waypoints_of(path), BeaconColumns.of(beacons)
    passes = columns.passes(xy, world)
    drift = drift_with_beacons(xy, noise, beacons, world, fixes=fixes, estimator=estimator)
    return chances_listed(beacons, passes, chances_of_passes(xy, passes, columns, drift.on_arrival(passes.enter)))


def chances_listed(beacons: Sequence[Beacon], passes: Passes, probability: Floats) -> list[DetectionChance]:
    """Passes and their probabilities in driving order."""
    order = np.lexsort((passes.beacon, passes.leave, passes.enter))
    rows = zip(*(x[order].tolist() for x in (passes.beacon, passes.enter, passes.leave, probability)), strict=True)
    return [DetectionChance(beacons[i], enter, leave, p) for i, enter, leave, p in rows]


def chances_of_passes(path: Floats, passes: Passes, beacons: BeaconColumns, arrival: PointDrift) -> Floats:
    """`detection_chances` of the passes (k,) of a path (n, 2), given the drift on arrival at each."""
    if not len(passes.beacon):
        return np.zeros(0)
    start, end = _near(passes, beacons.range_m[passes.beacon] + _WINDOW_RMS * arrival.rms)
    steps = np.diff(path, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    begins = np.cumsum(lengths) - lengths
    k, leg = np.nonzero((begins < end[:, None]) & (begins + lengths > start[:, None]))
    along = np.exp(1j * np.angle(steps @ _PLANE))[leg]  # of a waypoint repeated any direction
    low, high = np.maximum(start[k] - begins[leg], 0.0), np.minimum(end[k] - begins[leg], lengths[leg])
    # the beacons beside the path as planned
    places = gaussian_points(beacons.xy[passes.beacon] + arrival.bias, arrival.cov, _ERRORS) @ _PLANE
    offset = (places[k] - (path[leg] @ _PLANE)[:, None]) * np.conj(along)[:, None]  # along and across the leg
    beyond = offset.real - np.clip(offset.real, low[:, None], high[:, None])
    square = np.minimum.reduceat(beyond**2 + offset.imag**2, np.searchsorted(k, np.arange(len(start))), axis=0)
    return np.asarray(np.mean(square <= (beacons.range_m[passes.beacon, None] + 1e-9) ** 2, axis=1))


def _near(passes: Passes, window: Floats) -> tuple[Floats, Floats]:
    """The stretch of a path on which each pass would happen, ``window`` metres to either side of it as planned."""
    start, end = passes.enter - window, passes.leave + window  # passes come ordered by beacon, then by distance
    same = np.flatnonzero(passes.beacon[1:] == passes.beacon[:-1])
    middle = (passes.leave[same] + passes.enter[same + 1]) / 2
    end[same], start[same + 1] = np.minimum(end[same], middle), np.maximum(start[same + 1], middle)
    return start, end


def gaussian_points(mean: Floats, cov: Floats, count: int) -> Floats:
    """Points of equal probability of Gaussians with means (n, d) and covariances (n, d, d), (n, count, d)."""
    variance, axes = np.linalg.eigh(cov)
    spread = axes * np.sqrt(np.maximum(variance, 0.0))[:, None, :]
    return np.asarray(mean[:, None] + _standard_points(count, mean.shape[1]) @ np.swapaxes(spread, 1, 2))


@cache
def _standard_points(count: int, dimensions: int) -> Floats:
    """The same of the standard normal distribution: a lattice of Roberts's sequence, whose steps are the powers of 1/x,
    x the real root of x^(dimensions + 1) = x + 1."""
    from scipy.special import ndtri

    x = 1.0
    for _ in range(60):  # a contraction
        x = (1 + x) ** (1 / (dimensions + 1))
    return np.asarray(ndtri((0.5 + np.arange(1, count + 1)[:, None] / x ** np.arange(1, dimensions + 1)) % 1))
