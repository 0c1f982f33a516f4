"""Paths as the robot drives them: turns on the spot and runs, read from whatever describes a path.

Frame: world, metres, x to the right, y up, headings counter-clockwise from +x in radians (REP-103).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftplan.arrays import Floats, Ints, finite, not_negative, number

SAME_PLACE_M = 1.5e-6  # distances along a path this near to each other are one place: passes are rounded to 1e-6
_LOST_SHARE = 1e-9  # of a path's length: how far off adding up its legs may put a place
_FARTHEST_M = 1e12  # beyond, lengths squared lose the digits of any noise
_HALF_TURN_WITHIN_RAD = 1e-6  # a turn this near to a half turn is one; rounded coordinates do not say to which side


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A turn on the spot by ``turn_rad`` followed by a run of ``length_m`` metres at constant curvature.

    Lengths are >= 0; turns and curvatures (1/m) are positive to the left.

    >>> Run(length_m=2.0, curvature_per_m=0.5)  # an arc of one radian
    Run(length_m=2.0, curvature_per_m=0.5, turn_rad=0.0)
    """

    length_m: float
    curvature_per_m: float = 0.0
    turn_rad: float = 0.0

    def __post_init__(self) -> None:
        not_negative("length_m", self.length_m)
        number("curvature_per_m", self.curvature_per_m)
        number("turn_rad", self.turn_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Paths as arrays: leg k turns on the spot by ``turns[k]``, then drives ``lengths[k]`` at ``curvatures[k]``.

    Attributes
    ----------
    start : (...), x + jy of the start, metres
    heading : (...), heading before the first turn, rad
    turns, lengths, curvatures : (..., m), rad, m, 1/m
    legs_per_waypoint : legs between two waypoints of the path that was read

    >>> Runs.from_odometry([1.0, 2.0], [0.0, 0.5]).turns
    array([0. , 0.5])
    """

    start: NDArray[np.complex128]
    heading: Floats
    turns: Floats
    lengths: Floats
    curvatures: Floats
    legs_per_waypoint: int = 1

    @classmethod
    def from_odometry(cls, distances_m: ArrayLike, turns_rad: ArrayLike) -> Runs:
        """A recorded or simulated odometry log: step k turns by ``turns_rad[k]``, then drives ``distances_m[k]``.

        Parameters
        ----------
        distances_m, turns_rad : (..., m), distances >= 0. The path starts at the origin with heading 0.

        >>> Runs.from_odometry([1.0, 1.0], [0.0, 1.5]).lengths
        array([1., 1.])
        """
        lengths, turns = finite("distances_m", distances_m).copy(), finite("turns_rad", turns_rad).copy()
        if lengths.shape != turns.shape or lengths.ndim < 1 or lengths.shape[-1] < 1:
            raise ValueError(
                f"expected distances_m, turns_rad of one shape (..., m), m >= 1, got {lengths.shape}, {turns.shape}"
            )
        if (lengths < 0).any():
            raise ValueError(f"expected distances_m >= 0, got {lengths.min()}")
        batch = lengths.shape[:-1]
        return cls(np.zeros(batch, complex), np.zeros(batch), turns, lengths, np.zeros(lengths.shape))

    def cut(self, distances_m: Floats) -> tuple[Runs, Ints, Ints]:
        """One path with extra leg borders at ``distances_m`` (shape (k,), on the path, in any order).

        Returns the cut path, the border at which each distance now lies (k,), and where the old borders went (m + 1,).
        Distances that are one place (`SAME_PLACE_M`) are one border. A distance on a border takes the first border
        there: what happens there happens on arrival, before the robot turns on the spot, whether that turn belongs to
        the next run, to a pose or to a run of no length.

        Raises ValueError for several paths at once, and distances off the path.
        """
        if self.lengths.ndim != 1:
            raise ValueError(
                f"expected one path with fixes, got a batch of shape {self.lengths.shape[:-1]}: take one by one"
            )
        ends = np.concatenate(([0.0], np.cumsum(self.lengths)))
        length = float(ends[-1])
        if np.max(distances_m, initial=0.0) > length + same_place_within(length):
            raise ValueError(
                f"expected fixes on the path, at 0 to {length:.6g} m, got one at s_m={distances_m.max():.6g}"
            )
        places, inner = _places(distances_m, ends)
        borders = np.concatenate([ends, inner])
        order = np.argsort(borders, kind="stable")
        is_old, borders = order < len(ends), borders[order]
        leg = np.cumsum(is_old)[:-1] - 1
        whole = is_old[:-1] & is_old[1:]
        lengths = np.where(whole, self.lengths[leg], np.diff(borders))
        turns = np.where(is_old[:-1], self.turns[leg], 0.0)
        runs = Runs(self.start, self.heading, turns, lengths, self.curvatures[leg])
        return runs, np.searchsorted(borders, places), np.flatnonzero(is_old)


def same_place_within(length_m: float) -> float:
    """How near two distances along a path are one place, metres: `SAME_PLACE_M`, or what adding up may lose."""
    return max(SAME_PLACE_M, _LOST_SHARE * length_m)


def _places(distances_m: Floats, ends: Floats) -> tuple[Floats, Floats]:
    """Distances on a path, those of one place made equal (a border's, else the first's), and places at no border."""
    within = same_place_within(float(ends[-1]))
    places = np.minimum(distances_m, ends[-1])
    after = np.clip(np.searchsorted(ends, places), 1, len(ends) - 1)
    before, after = ends[after - 1], ends[after]
    near = np.where(places - before < after - places, before, after)
    at_border = np.abs(places - near) <= within
    places = np.where(at_border, near, places)
    free = np.flatnonzero(~at_border)
    free = free[np.argsort(places[free], kind="stable")]
    ordered = places[free]
    apart = np.diff(ordered, prepend=-np.inf) > within
    inner = ordered[apart]
    places[free] = inner[np.cumsum(apart) - 1]
    return places, inner


def read_path(path: Any, start_heading: float | ArrayLike | None = None) -> Runs:
    """Runs of a path given as waypoints, poses, runs, or several of these.

    Parameters
    ----------
    path : (n, 2) waypoints joined by straight runs; (n, 3) poses x, y, heading: at each the robot turns to face the
        next waypoint, drives, and turns to the heading asked for; (..., n, 2|3) batches; a list of arrays of different
        lengths (shorter ones then stand still at their end, which costs nothing); a list of `Run`; `Runs`
    start_heading : float or array, optional
        Heading before the first turn, rad. Default: the heading of the first run; for `Run` lists and logs 0. Poses
        bring their own.

    Raises ValueError for fewer than 2 waypoints, wrong shapes, values that are not finite, negative lengths.
    """
    driven = path if isinstance(path, Runs) else None
    if isinstance(path, Sequence) and len(path) > 0 and all(isinstance(item, Run) for item in path):
        turns, lengths, curvatures = np.array(
            [(run.turn_rad, run.length_m, run.curvature_per_m) for run in path], dtype=float
        ).T.copy()
        driven = Runs(np.zeros((), complex), np.zeros(()), turns, lengths, curvatures)
    runs = _from_array(_as_array(path)) if driven is None else driven
    if start_heading is None:
        return runs
    heading = np.broadcast_to(finite("start_heading", start_heading), np.shape(runs.heading))
    if driven is not None:  # its turns are given
        return replace(runs, heading=heading)
    if runs.legs_per_waypoint == 2:
        raise ValueError("expected no start_heading with a path of poses, whose first heading it is: got both")
    turns = runs.turns.copy()
    turns[..., 0] = wrap(turns[..., 0] + runs.heading - heading)
    return replace(runs, heading=heading, turns=turns)


def wrap(angle_rad: Floats) -> Floats:
    """The same angles in (-π, π], where a half turn, exact or within a millionth, goes to the left: rounding, and with
    it where the world's axes lie, does not decide the sense of an about-face (but may leave it at π + 1e-6).

    >>> wrap(np.array([4.0])).round(3)
    array([-2.283])
    """
    left = np.pi + _HALF_TURN_WITHIN_RAD
    return np.asarray(left - np.mod(left - angle_rad, 2 * np.pi))


def _from_array(path: Floats) -> Runs:
    xy = path[..., 0] + 1j * path[..., 1]
    legs = np.diff(xy, axis=-1)
    lengths = np.abs(legs)
    poses = path.shape[-1] == 3
    course = _course(legs, path[..., 0, 2] if poses else None)
    if not poses:
        heading = course[..., 0]
        turns = np.diff(course, axis=-1, prepend=heading[..., None])
        return Runs(xy[..., 0], heading, wrap(turns), lengths, np.zeros(lengths.shape))
    headings = path[..., 2]
    face = np.where(lengths > 0, wrap(course - headings[..., :-1]), 0.0)
    settle = wrap(headings[..., 1:] - headings[..., :-1] - face)
    shape = (*lengths.shape[:-1], 2 * lengths.shape[-1])
    turns = np.stack([face, settle], axis=-1).reshape(shape)
    lengths = np.stack([lengths, np.zeros(lengths.shape)], axis=-1).reshape(shape)
    return Runs(xy[..., 0], headings[..., 0], turns, lengths, np.zeros(shape), legs_per_waypoint=2)


def _course(legs: NDArray[np.complex128], first: Floats | None) -> Floats:
    """Heading of every leg; a leg of no length keeps the heading before it (and before the first run, of that run)."""
    moves = legs != 0
    if moves.all():
        return np.angle(legs)
    index = np.where(moves, np.arange(legs.shape[-1]), -1)
    latest = np.maximum.accumulate(index, axis=-1)
    first_move = np.argmax(moves, axis=-1)[..., None]
    course = np.take_along_axis(np.angle(legs), np.where(latest < 0, first_move, latest), axis=-1)
    return course if first is None else np.where(latest < 0, np.asarray(first)[..., None], course)


def _as_array(path: Any) -> Floats:
    """Waypoints; of paths of different lengths the shorter ones stand still at their last."""
    try:
        shapes = {np.shape(p) for p in path} if isinstance(path, Sequence) else set()
    except ValueError:  # one of them is not an array at all: said where it is converted
        shapes = set()
    if len(shapes) < 2 or any(len(shape) != 2 for shape in shapes):
        return _waypoints(path)
    paths = [_waypoints(p) for p in path]
    if len({p.shape[1] for p in paths}) > 1:
        raise ValueError("expected all paths of a batch to be (n, 2), or all (n, 3), got both")
    longest = max(map(len, paths))
    return np.stack([np.concatenate([p, np.repeat(p[-1:], longest - len(p), axis=0)]) for p in paths])


def _waypoints(path: Any) -> Floats:
    array = finite("path", path)
    if array.ndim < 2 or array.shape[-1] not in (2, 3) or array.shape[-2] < 2:
        raise ValueError(
            "expected a path of at least 2 waypoints, shape (..., n, 2) in metres or (..., n, 3) with headings in rad, "
            f"got shape {array.shape}"
        )
    if (np.abs(array) > _FARTHEST_M).any():
        raise ValueError(f"expected waypoints within {_FARTHEST_M:g} m of the origin, got {np.abs(array).max():g}")
    return array
