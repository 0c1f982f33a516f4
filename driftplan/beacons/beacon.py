"""Beacons: things in the world that give a robot an absolute fix while it is in range, and what that does to its drift.

The model of a pass. Along a stretch within range the beacon is read where the stretch begins, where it ends and in
between at most `BeaconKind.reading_spacing_m` apart; on a stretch of no length (a graze) once. Every reading is a fix
whose error is fresh (the range and the reader's geometry are part of its standard deviation), and it *replaces* the
measured part of the robot's error; nothing is averaged. Hence

* within range the drift is that of the fix, grown over the odometry since the last reading; it grows on from where the
  path leaves the range;
* the latest reading wins where ranges overlap, and where several beacons are read at the same place the more accurate;
* a further beacon can make matters worse: a coarse reading replaces a good estimate.

A pass is noticed with probability p = `detection_probability`: each of its n readings succeeds with 1 - (1 - p)^(1/n),
independently, so that the whole pass is missed with probability 1 - p.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Floats, not_negative, number, positive
from driftplan.beacons.passes import passes_of
from driftplan.model.drift import Drift, predict_drift
from driftplan.model.fixes import Fix
from driftplan.model.noise import Noises, OdometryNoise
from driftplan.world.world import World

_POINT_M = 1e-6  # a pass shorter than this is one reading


@dataclass(frozen=True, slots=True, kw_only=True)
class BeaconKind:
    """What a beacon measures, how well, and from how far. Made by `rfid`, `landmark`, `heading`, or in full.

    Parameters
    ----------
    name : str
    range_m : float
        Metres, > 0: a closed disc around the beacon.
    position_std_m : float or None
        Standard deviation of a measured position per axis, metres; None: position is not measured.
    heading_std : float or None
        Standard deviation of a measured heading, rad; None: heading is not measured.
    detection_probability : float
        Probability in (0, 1] that a pass is noticed.
    line_of_sight : bool
        Whether walls block it (when a world is given).
    reading_spacing_m : float
        Readings on a long pass are at most this far apart, metres.
    cost : float
        What one costs, in any unit, > 0.

    Raises
    ------
    ValueError
        For values that are not finite, out of range, or a kind that measures nothing.
    """

    name: str
    range_m: float
    position_std_m: float | None = None
    heading_std: float | None = None
    detection_probability: float = 1.0
    line_of_sight: bool = False
    reading_spacing_m: float = 3.0
    cost: float = 1.0

    def __post_init__(self) -> None:
        for name in ("range_m", "reading_spacing_m", "cost", "detection_probability"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        for name in ("position_std_m", "heading_std"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, not_negative(name, getattr(self, name)))
        if self.position_std_m is None and self.heading_std is None:
            raise ValueError("expected a kind of beacon with position_std_m, heading_std or both, got neither")
        if self.detection_probability > 1:
            raise ValueError(f"expected detection_probability in (0, 1], got {self.detection_probability!r}")

    @classmethod
    def rfid(
        cls,
        range_m: float,
        position_std_m: float,
        *,
        detection_probability: float = 1.0,
        reading_spacing_m: float = 3.0,
        cost: float = 1.0,
    ) -> BeaconKind:
        """A tag that tells the position and leaves the heading error as it is; walls do not block it.

        Examples
        --------
        >>> BeaconKind.rfid(range_m=1.5, position_std_m=0.1).heading_std is None
        True
        """
        return cls(
            name="rfid",
            range_m=range_m,
            position_std_m=position_std_m,
            detection_probability=detection_probability,
            reading_spacing_m=reading_spacing_m,
            cost=cost,
        )

    @classmethod
    def landmark(
        cls,
        range_m: float,
        position_std_m: float,
        heading_std: float,
        *,
        detection_probability: float = 1.0,
        line_of_sight: bool = True,
        reading_spacing_m: float = 3.0,
        cost: float = 1.0,
    ) -> BeaconKind:
        """A full fix, position and heading (rad): an AprilTag, a reflector set, a docking station."""
        return cls(
            name="landmark",
            range_m=range_m,
            position_std_m=position_std_m,
            heading_std=heading_std,
            detection_probability=detection_probability,
            line_of_sight=line_of_sight,
            reading_spacing_m=reading_spacing_m,
            cost=cost,
        )

    @classmethod
    def heading(
        cls,
        range_m: float,
        heading_std: float,
        *,
        detection_probability: float = 1.0,
        line_of_sight: bool = False,
        reading_spacing_m: float = 3.0,
        cost: float = 1.0,
    ) -> BeaconKind:
        """A heading reference (rad) that leaves the position error: a wall of known direction, a light strip."""
        return cls(
            name="heading",
            range_m=range_m,
            heading_std=heading_std,
            detection_probability=detection_probability,
            line_of_sight=line_of_sight,
            reading_spacing_m=reading_spacing_m,
            cost=cost,
        )


@dataclass(frozen=True, slots=True)
class Beacon:
    """A beacon at x, y (metres, world frame). Beacons without an ``id`` are numbered where an id is needed.

    Examples
    --------
    >>> Beacon(BeaconKind.rfid(range_m=1.5, position_std_m=0.1), x=3.0, y=4.0, id="A7").id
    'A7'
    """

    kind: BeaconKind
    x: float
    y: float
    id: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.kind, BeaconKind):
            raise ValueError(f"expected kind to be a BeaconKind, got {self.kind!r}")
        for name in ("x", "y"):
            object.__setattr__(self, name, number(name, getattr(self, name)))

    @property
    def xy(self) -> Floats:
        """Metres, (2,)."""
        return np.array([self.x, self.y])


def passes(path: Any, beacon: Beacon, world: World | None = None) -> Floats:
    """Where a path is within range of a beacon (and in its sight): metres driven on entering and on leaving.

    Parameters
    ----------
    path : (n, 2) waypoints in metres, or anything with such a ``path``
    beacon : Beacon
    world : World, optional
        Its walls block beacons that work in line of sight; without it nothing does.

    Returns
    -------
    array, shape (k, 2)
        One row per pass, in driving order; a graze is a row of two equal numbers.

    Examples
    --------
    >>> tag = BeaconKind.rfid(range_m=1.0, position_std_m=0.1)
    >>> passes([(0, 0), (10, 0), (0, 0)], Beacon(tag, x=4.0, y=1.0)).tolist()
    [[4.0, 4.0], [16.0, 16.0]]
    """
    columns = BeaconColumns.of([beacon])
    found = passes_of(waypoints_of(path), columns.xy, columns.range_m, columns.must_see, world)
    return np.stack([found.enter, found.leave], axis=-1)


def beacon_fixes(path: Any, beacons: Sequence[Beacon], world: World | None = None) -> list[Fix]:
    """The readings of ``beacons`` along a path as fixes of the drift model, in driving order.

    Examples
    --------
    >>> tag = BeaconKind.rfid(range_m=1.0, position_std_m=0.1)
    >>> [fix.s_m for fix in beacon_fixes([(0, 0), (10, 0)], [Beacon(tag, x=4.0, y=0.0)])]
    [3.0, 5.0]
    """
    if not beacons:
        return []
    found = readings_on(waypoints_of(path), BeaconColumns.of(beacons), world)
    order = np.lexsort((found.rank, found.s_m))
    fixes = []
    for i, s, chance in zip(*(x[order].tolist() for x in (found.beacon, found.s_m, found.chance)), strict=True):
        kind = beacons[i].kind
        position_cov = None if kind.position_std_m is None else kind.position_std_m**2 * np.eye(2)
        fixes.append(Fix(s_m=s, position_cov=position_cov, heading_std=kind.heading_std, detection_probability=chance))
    return fixes


def drift_with_beacons(
    path: Any,
    noise: OdometryNoise,
    beacons: Sequence[Beacon],
    world: World | None = None,
    *,
    fixes: Sequence[Fix] = (),
) -> Drift:
    """Drift along a path of a robot that reads ``beacons`` on its way; exact under the model of this module.

    Parameters
    ----------
    path : (n, 2) waypoints in metres, or anything with such a ``path``
    noise : OdometryNoise
    beacons : sequence of Beacon
    world : World, optional
        Its walls block sight and its zones have their own noise; the result then has a waypoint at every zone border.
    fixes : sequence of Fix
        Further fixes, such as one at 0 for an uncertain start. At the same place they come before the beacons'.

    Returns
    -------
    Drift

    Examples
    --------
    >>> noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    >>> tag = BeaconKind.rfid(range_m=1.0, position_std_m=0.1)
    >>> drift = drift_with_beacons([(0, 0), (30, 0), (30, 10)], noise, [Beacon(tag, x=30.0, y=0.0)])
    >>> drift.rms.round(3)  # at the corner the tag is in range, read a metre before
    array([0.   , 0.145, 0.326])
    """
    xy = waypoints_of(path)
    readings = [*fixes, *beacon_fixes(xy, beacons, world)]
    xy, noises = floor_of(xy, noise, world)
    return predict_drift(xy, noises, fixes=readings)


def waypoints_of(path: Any) -> Floats:
    """The waypoints (n, 2) of a route (its ``path``) or of a plain array, checked."""
    raw = getattr(path, "path", path)
    try:
        xy = np.asarray(raw, dtype=float)
    except (TypeError, ValueError) as err:
        raise ValueError(f"expected a path of numbers (n, 2), got {type(raw).__name__}: {err}") from None
    if xy.ndim != 2 or xy.shape[1] != 2 or len(xy) < 2:
        raise ValueError(f"expected a path (n, 2) of at least 2 waypoints in metres, got an array of shape {xy.shape}")
    if not np.isfinite(xy).all():
        raise ValueError(f"expected a path of finite coordinates, got {xy[~np.isfinite(xy).all(axis=1)][0].tolist()}")
    return xy


def floor_of(path: Floats, noise: OdometryNoise, world: World | None) -> tuple[Floats, Noises]:
    """The path with a waypoint at every zone border, and the noise of every leg (one noise when there are no zones)."""
    if world is None or not world.zones:
        return path, noise
    path, zone = world.cut_at_zones(path)
    return path, [noise if z < 0 else world.zones[z].noise for z in zone.tolist()]


class Readings(NamedTuple):
    """Readings along one path, arrays of one length."""

    beacon: NDArray[np.intp]
    s_m: Floats
    chance: Floats  # that it succeeds
    rank: NDArray[np.intp]  # of simultaneous readings the one with the highest rank, the most accurate, comes last


class BeaconColumns(NamedTuple):
    """Beacons as arrays of one length."""

    xy: Floats
    range_m: Floats
    must_see: NDArray[np.bool_]
    reading_spacing_m: Floats
    detection_probability: Floats
    rank: NDArray[np.intp]

    @classmethod
    def of(cls, beacons: Sequence[Beacon]) -> BeaconColumns:
        """The columns of beacons; other things are refused."""
        for beacon in beacons:
            if not isinstance(beacon, Beacon):
                raise ValueError(f"expected beacons to be Beacon objects, got {beacon!r}")
        kinds = [b.kind for b in beacons]
        accuracy = [
            tuple(-inf if std is None else -std for std in (kind.position_std_m, kind.heading_std)) for kind in kinds
        ]
        rank = {key: k for k, key in enumerate(sorted(set(accuracy)))}
        return cls(
            np.array([[b.x, b.y] for b in beacons], dtype=float).reshape(-1, 2),
            np.array([kind.range_m for kind in kinds], dtype=float),
            np.array([kind.line_of_sight for kind in kinds], dtype=bool),
            np.array([kind.reading_spacing_m for kind in kinds], dtype=float),
            np.array([kind.detection_probability for kind in kinds], dtype=float),
            np.array([rank[key] for key in accuracy], dtype=np.intp),
        )


def readings_on(path: Floats, beacons: BeaconColumns, world: World | None) -> Readings:
    """All readings along a path (n, 2), by beacon, in driving order."""
    found = passes_of(path, beacons.xy, beacons.range_m, beacons.must_see, world)
    length = found.leave - found.enter
    parts = np.maximum(np.ceil(length / beacons.reading_spacing_m[found.beacon] - 1e-6), 1)
    count = np.where(length < _POINT_M, 1, parts + 1).astype(np.intp)
    k = np.repeat(np.arange(len(count)), count)
    step = np.arange(len(k)) - np.repeat(np.cumsum(count) - count, count)
    beacon = found.beacon[k]
    missed = (1 - beacons.detection_probability[beacon]) ** (1 / count[k])
    s_m = found.enter[k] + length[k] * step / np.maximum(count[k] - 1, 1)
    return Readings(beacon, s_m, 1 - missed, beacons.rank[beacon])
