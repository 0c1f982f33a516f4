"""Where a path passes through the ranges of many beacons: intervals of driven distance, by plain geometry.

Beacons are points with a range; a path is a polyline driven from its first waypoint to its last. A pass is a longest
stretch of the path within the range and, for beacons that must be seen, in line of sight. Ranges are closed discs: a
path that touches one in a single point passes it, on a stretch of no length. Distances are rounded to a micrometre,
so that beacons met at the same place are met at the same distance.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from driftplan.arrays import Bools, Floats, Ints
from driftplan.model.paths import wrap
from driftplan.world.world import World

DISTANCE_DECIMALS = 6  # distances along a path are rounded to this many decimals of a metre
_TOUCH = 1e-9  # m: a path this far outside a range counts as touching it
_ANGLE = 1e-12  # rad: directions this near to each other are one
_PLANE = np.array([1.0, 1j])  # vectors @ this: complex numbers
_FLAT = 1e-9  # m: a beacon this near to the line of a leg is on it


class Passes(NamedTuple):
    """Passes of one path, ordered by beacon, then by distance; arrays of one length."""

    beacon: Ints  # index of the beacon
    enter: Floats  # metres driven when it comes into range (and sight)
    leave: Floats  # metres driven when it goes out


class _Chords(NamedTuple):
    """Parts of single legs within range: beacon, leg, and from where to where on the leg, metres."""

    beacon: Ints
    leg: Ints
    start: Floats
    end: Floats

    def some(self, which: NDArray[Any]) -> _Chords:
        return _Chords(*(x[which] for x in self))


class Views(NamedTuple):
    """From where beacons are seen, and by what sensor; arrays of one length, rad. Half a turn: from everywhere."""

    facing: Floats  # the direction a beacon looks to, world frame
    half_angle: Floats  # to either side of it a beacon is seen
    sensor_half_angle: Floats  # to either side of straight ahead the robot's sensor sees

    def at(self, beacon: Ints, away: Floats, heading: Floats) -> Bools:
        """Whether beacons (k,) are seen by a robot that is ``away`` (k, 2) from them, facing ``heading`` (k,)."""
        bearing = np.arctan2(away[:, 1], away[:, 0])
        there = (away == 0).all(axis=1)
        seen = np.abs(wrap(bearing - self.facing[beacon])) <= self.half_angle[beacon] + _ANGLE
        ahead = np.abs(wrap(bearing + np.pi - heading)) <= self.sensor_half_angle[beacon] + _ANGLE
        return np.asarray(there | (seen & ahead))


def passes_of(
    path: Floats, xy: Floats, range_m: Floats, must_see: Bools, world: World | None, views: Views | None = None
) -> Passes:
    """All passes of a path (n, 2) through the ranges ``range_m`` (m,) of beacons at ``xy`` (m, 2), metres.

    Parameters
    ----------
    must_see : (m,), whether a beacon works in line of sight only
    world : its obstacles block sight; None: nothing does.
    views : default: beacons are seen from everywhere, and so does the robot see

    >>> path, xy = np.array([[0, 0], [10, 0], [10, 5]]), np.array([[9.0, 0.0]])
    >>> found = passes_of(path, xy, np.array([2.0]), np.array([False]), None)
    >>> found.enter.tolist(), found.leave.tolist()
    ([7.0], [11.732051])
    """
    steps = np.diff(path, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    begins = np.concatenate([[0.0], np.cumsum(lengths)])
    along = steps / np.where(lengths > 0, lengths, 1.0)[:, None]
    start, end, inside = chords_in_discs(xy[:, None, :] - path[None, :-1, :], along, lengths, range_m[:, None])
    beacon, leg = np.nonzero(inside)
    chords = _Chords(beacon, leg, start[beacon, leg], end[beacon, leg])
    if views is not None:
        chords = _in_cone(chords, path, along, xy, views.facing[chords.beacon], views.half_angle[chords.beacon])
        half_angle = views.sensor_half_angle[chords.beacon]
        moving = (half_angle >= np.pi) | (lengths[chords.leg] > 0)  # standing still looks nowhere new
        chords, half_angle = chords.some(moving), half_angle[moving]
        behind = np.arctan2(-steps[chords.leg, 1], -steps[chords.leg, 0])
        chords = _in_cone(chords, path, along, xy, behind, half_angle)
    if world is not None and must_see.any():
        chords = _in_sight(chords, path, along, xy, must_see, world)
    return _merged(chords.beacon, begins[chords.leg] + chords.start, begins[chords.leg] + chords.end, begins[-1])


def chords_in_discs(offset: Floats, along: Floats, lengths: Floats, radius: Floats) -> tuple[Floats, Floats, Bools]:
    """Where straight legs are within closed discs, (...): from and to so many metres from where the leg begins, and
    whether there is such a part; a touch is one. ``offset`` (..., 2) leads from there to a disc's centre; ``along``
    (..., 2) are unit vectors, of legs of no length zero; ``lengths`` and ``radius`` are in metres."""
    foot = (offset * along).sum(axis=-1)  # where on the leg's line the centre is abeam
    off_line = np.where(lengths > 0, np.abs(_cross(offset, along)), np.hypot(offset[..., 0], offset[..., 1]))
    half = np.sqrt(np.maximum(radius**2 - off_line**2, 0.0))
    start, end, inside = _proper(np.maximum(foot - half, 0.0), np.minimum(foot + half, lengths))
    return start, end, inside & (off_line <= radius + _TOUCH)


def _proper(start: Floats, end: Floats) -> tuple[Floats, Floats, Bools]:
    """Intervals, of which some end before they begin by rounding only: then a touch; and which there are."""
    middle, touch = 0.5 * (start + end), start > end
    return np.where(touch, middle, start), np.where(touch, middle, end), start <= end + _TOUCH


def _in_cone(chords: _Chords, path: Floats, along: Floats, xy: Floats, axis: Floats, half_angle: Floats) -> _Chords:
    """The parts of chords within ``half_angle`` of the direction ``axis`` (k,) from their beacons.

    A cone narrower than half a turn is where two half-planes meet, a wider one all that is in either of them.
    """
    everywhere = half_angle >= np.pi
    driving, origin = along[chords.leg] @ _PLANE, (path[chords.leg] - xy[chords.beacon]) @ _PLANE
    intervals = []
    for side in (1.0, -1.0):
        edge = np.exp(1j * (axis + side * half_angle))
        inside, rate = -side * (np.conj(edge) * origin).imag, -side * (np.conj(edge) * driving).imag
        with np.errstate(divide="ignore", invalid="ignore"):
            border = np.where(np.abs(rate) > _ANGLE, -inside / rate, np.where(inside >= -_FLAT, -np.inf, np.inf))
        ahead = rate >= -_ANGLE
        start = np.where(ahead, np.maximum(border, chords.start), chords.start)
        end = np.where(ahead, chords.end, np.minimum(border, chords.end))
        intervals.append((np.where(everywhere, chords.start, start), np.where(everywhere, chords.end, end)))
    (start, end), (other_start, other_end) = intervals
    wide = (half_angle > np.pi / 2) & ~everywhere
    apart = wide & (np.maximum(start, other_start) > np.minimum(end, other_end))
    joined = wide & ~apart
    first = np.where(joined, np.minimum(start, other_start), np.where(apart, start, np.maximum(start, other_start)))
    last = np.where(joined, np.maximum(end, other_end), np.where(apart, end, np.minimum(end, other_end)))
    first, last = np.concatenate([first, other_start[apart]]), np.concatenate([last, other_end[apart]])
    first, last, kept = _proper(first, last)
    beacon, on_leg = (np.concatenate([x, x[apart]]) for x in (chords.beacon, chords.leg))
    return _Chords(beacon, on_leg, first, last).some(kept)


def _merged(beacon: Ints, enter: Floats, leave: Floats, length: float) -> Passes:
    """Stretches that continue each other, joined; distances rounded, and kept on the path."""
    order = np.lexsort((enter, beacon))
    beacon, enter, leave = beacon[order], enter[order], leave[order]
    if len(beacon):
        new = np.concatenate([[True], (beacon[1:] != beacon[:-1]) | (enter[1:] > leave[:-1] + 2 * _TOUCH)])
        first = np.flatnonzero(new)
        beacon, enter, leave = beacon[first], enter[first], np.maximum.reduceat(leave, first)
    snapped = (np.round(s, DISTANCE_DECIMALS) for s in (enter, leave))
    enter, leave = (np.where(s >= length - 10.0**-DISTANCE_DECIMALS, length, s) for s in snapped)
    return Passes(beacon, enter, leave)


def _in_sight(chords: _Chords, path: Floats, along: Floats, xy: Floats, must_see: Bools, world: World) -> _Chords:
    """The parts of chords from which the beacon is seen."""
    eye, unit, origin = xy[chords.beacon], along[chords.leg], path[chords.leg]
    a, b = origin + chords.start[:, None] * unit, origin + chords.end[:, None] * unit
    asked = must_see[chords.beacon]
    point = chords.end - chords.start < _FLAT
    between = shapely.convex_hull(shapely.multipoints(np.stack([eye, a, b], axis=-2)))  # a triangle or a line
    blocked = asked & ~point & shapely.intersects(world.opaque.prepared, between)
    keep = ~blocked
    keep[asked & point] = world.line_of_sight(a[asked & point], eye[asked & point])
    walls = shapely.get_parts(world.opaque.area)
    tree = shapely.STRtree(walls)
    seen: list[tuple[int, float, float]] = []
    for k in np.flatnonzero(blocked).tolist():
        hiding = shapely.get_parts(shapely.intersection(walls[tree.query(between[k])], between[k]))
        corners = [shapely.get_coordinates(part) for part in hiding if not part.is_empty]
        start, length = float(chords.start[k]), float(chords.end[k] - chords.start[k])
        shadow = _shadow_on_line if abs(_cross(unit[k], eye[k] - a[k])) < _FLAT else _shadow
        shadows = [shadow(eye[k], a[k], b[k], length, part) for part in corners]
        seen += [(k, start + x, start + y) for x, y in _gaps(shadows, length)]
    which, first, last = np.array(seen, dtype=float).reshape(-1, 3).T
    parts = chords.some(which.astype(np.intp))._replace(start=first, end=last)
    return _Chords(*(np.concatenate([x, y]) for x, y in zip(chords.some(keep), parts, strict=True)))


def _shadow(eye: Floats, a: Floats, b: Floats, length: float, corners: Floats) -> tuple[float, float]:
    """The interval of the chord from a to b, metres from a, that a connected obstacle hides from ``eye``."""
    ray = corners - eye
    ray = ray[np.hypot(ray[:, 0], ray[:, 1]) > 0]
    t = -_cross(a - eye, ray) / _cross(b - a, ray)
    return float(t.min()) * length, float(t.max()) * length


def _shadow_on_line(eye: Floats, a: Floats, b: Floats, length: float, corners: Floats) -> tuple[float, float]:
    """The same when the beacon is on the chord's line: all that is behind the obstacle."""
    beacon, wall = ((points - a) @ (b - a) / length for points in (eye, corners))
    if wall.min() >= beacon:
        return float(wall.min()), np.inf
    if wall.max() <= beacon:
        return -np.inf, float(wall.max())
    return -np.inf, np.inf


def _gaps(shadows: list[tuple[float, float]], length: float) -> list[tuple[float, float]]:
    """What the shadows leave of [0, length]."""
    gaps, reached = [], 0.0
    for start, end in sorted(shadows):
        gaps.append((reached, min(start, length)))
        reached = max(reached, end)
    gaps.append((reached, length))
    return [(x, y) for x, y in gaps if y - x > 10.0**-DISTANCE_DECIMALS]


def _cross(v: Floats, w: Floats) -> Floats:
    return np.asarray(v[..., 0] * w[..., 1] - v[..., 1] * w[..., 0])
