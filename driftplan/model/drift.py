"""predict_drift: the drift of odometry along a path, in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Array, Floats, Ints, bounded, choice, finite, positive
from driftplan.model.drive import Driven, drive
from driftplan.model.elements import of_legs
from driftplan.model.filter_state import LINEAR_HEADING_STD_RAD
from driftplan.model.fusion import Beliefs, fuse, misused_from
from driftplan.model.moments import Moments, compose
from driftplan.model.noise import Noises, OdometryNoise, drives_to_average, noise_of_legs, spread_of
from driftplan.model.paths import Runs, read_path, same_place_within
from driftplan.model.point_drift import PointDrift
from driftplan.model.readings import Estimator, Fix, Readings


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Drift(PointDrift):
    """Drift at every waypoint of a path, (..., n) for paths (..., n, 2); made by `predict_drift`.

    At a waypoint with a fix the values are those after it. `at` goes anywhere between.

    >>> drift = predict_drift([(0, 0), (9, 0), (9, 16)], OdometryNoise(distance_var_per_m=0.01))
    >>> drift.rms, float(drift.at(4.0).rms), float(drift.length)
    (array([0. , 0.3, 0.5]), 0.2, 25.0)
    """

    runs: Runs
    noises: tuple[OdometryNoise, ...]
    leg_noises: Ints  # which of `noises` each leg of `runs` has
    _driven: Driven  # at every leg border
    _border_distance: Floats
    _beliefs: Beliefs | None = None  # of a robot with a filter
    _readings: Readings | None = None
    _drives: tuple[tuple[float, Drift], ...] = ()  # weights and drifts, where systematic errors differ between drives

    @property
    def end(self) -> PointDrift:
        """Drift at the end of the path, (...)."""
        return PointDrift(self.distance[..., -1], self.moments[..., -1])

    @property
    def length(self) -> Floats:
        """Length of the path, metres, (...)."""
        return self.distance[..., -1]

    def at(self, s: ArrayLike) -> PointDrift:
        """Drift after ``s`` metres, had the path ended there.

        Parameters
        ----------
        s : float or array, shape (k,), or (..., k) with the leading axes of a batch
            Distances in [0, length]. At a fix: just after it.

        Returns a drift () for one path and a float, else (..., k). Raises ValueError for distances off the path.
        """
        wanted = finite("s", s)
        if wanted.ndim > 1 and self.distance.ndim == 1:
            raise ValueError(f"expected distances of shape () or (k,) for one path, got {wanted.shape}")
        batch = self.distance.shape[:-1]
        where = np.broadcast_to(np.atleast_1d(wanted), (*batch, *(wanted.shape[-1:] or (1,))))
        found = self._inside(self._on_path(where, wanted))
        if wanted.ndim == 0:
            return PointDrift(found.distance[..., 0], found.moments[..., 0])
        return found

    def on_arrival(self, s: ArrayLike) -> PointDrift:
        """Drift on arrival at ``s`` metres along one path, (k,): before the readings there, where `at` is after them.

        At the start: after the fixes that say how uncertain it is.
        """
        wanted = finite("s", s)
        s = self._on_path(np.atleast_1d(wanted), wanted)
        on_start = s <= same_place_within(float(self.length))
        states = Moments.concatenate([self._driven.arriving[:1], self._inside(s, after=False).moments])
        return PointDrift(s, states[np.where(on_start, 0, np.arange(len(s)) + 1)])

    def departures(self) -> Moments:
        """Moments at the beginning of every leg's run, after turning on the spot, for one path."""
        if self._drives:
            return _averaged([(weight, one.departures()) for weight, one in self._drives])
        turns, begun = self.runs.turns, self._driven.leaving[:-1]
        if self._beliefs is None and not any(noise.turns_matter for noise in self.noises):
            return replace(begun, u=begun.u * np.exp(1j * turns))
        zero = np.zeros(turns.shape)
        return self._onward(np.arange(len(turns)), turns, zero, zero, self.leg_noises)

    def inside_legs(self, shares: Floats) -> Moments:
        """Moments at these shares (k,) of every leg's run, for one path, (legs, k)."""
        shares = np.clip(finite("shares", shares).reshape(-1), 0.0, 1.0)
        runs, last = self.runs, len(self.runs.lengths)
        border = np.repeat(np.arange(last)[:, None], len(shares), axis=1)
        driven, which = runs.lengths[:, None] * shares, self.leg_noises[border]
        return self._onward(border, runs.turns[border], driven, runs.curvatures[border], which)

    def simulated(self, distances_m: Floats, *, runs: int, rng: np.random.Generator | int = 0) -> Floats:
        """Errors of as many robots as ``runs`` at these ascending distances (k,) along one path, after the readings
        there, metres, (runs, k, 2): what `driftplan.simulate_drift` gives at places of which it is told."""
        from driftplan.model.simulation import simulate_drift

        distances_m = finite("distances_m", distances_m)
        if distances_m.ndim != 1 or (np.diff(distances_m) < 0).any():
            raise ValueError(f"expected distances_m (k,), ascending, got an array of shape {distances_m.shape}")
        cut, at, old = self.runs.cut(distances_m)
        noises = [self.noises[k] for k in np.repeat(self.leg_noises, np.diff(old)).tolist()]
        fixes = () if self._readings is None else self._readings.fixes()
        errors = simulate_drift(cut, noises, runs=runs, rng=rng, fixes=fixes, estimator=self.estimator)
        return errors[:, at]

    @property
    def estimator(self) -> Estimator:
        """What the robot does with its readings."""
        return "filter" if self.is_fused else "reset"

    @property
    def is_fused(self) -> bool:
        """Whether this is the drift of a robot with a filter."""
        return self._beliefs is not None

    @property
    def has_systematic(self) -> bool:
        """Whether known systematic errors or those of a spread act on it."""
        spread = self._beliefs is not None and bool(self._beliefs.spread.names)
        return spread or any(noise.is_systematic for noise in self.noises)

    def _onward(self, border: Ints, turns: Floats, lengths: Floats, curvatures: Floats, which: Ints) -> Moments:
        """Moments after driving on from borders: the one place where the engines differ."""
        if self._drives:
            driven = [(weight, one._onward(border, turns, lengths, curvatures, which)) for weight, one in self._drives]
            return _averaged(driven)
        begin = Moments(*(_picked(x, border) for x in self._driven.leaving.arrays()))
        if self._beliefs is not None:
            return self._beliefs.onward(begin, border, (turns, lengths, curvatures, which))
        return compose(begin, of_legs(turns, lengths, curvatures, which, self.noises))

    @property
    def beyond_linear(self) -> Floats:
        """Where along one path a filter's prediction is not to be trusted, metres driven, (k, 2): stretches on which
        the heading's standard deviation exceeds 0.15 rad, and all the way on from a range or bearing that moves the
        estimate in so uncertain a direction that the error of the correction exceeds 0.15 times the accuracy (a robot
        that hears one radio may take the wrong side of it). The filter itself goes wrong there. Without a filter none:
        resets are predicted without linearisation."""
        if self.distance.ndim != 1:
            raise ValueError(f"expected the drift of one path, got a batch of shape {self.distance.shape[:-1]}")
        if self._beliefs is None:
            return np.zeros((0, 2))
        limit, ends = LINEAR_HEADING_STD_RAD**2, self._border_distance
        begin = PointDrift(ends[:-1], self.departures()).heading_std ** 2
        end = np.maximum(PointDrift(ends[1:], self._driven.arriving[1:]).heading_std ** 2, begin)
        leg = np.flatnonzero(end > limit)
        share = np.clip((limit - begin[leg]) / np.maximum(end[leg] - begin[leg], 1e-300), 0.0, 1.0)
        stretches = np.stack([ends[leg] + share * self.runs.lengths[leg], ends[leg + 1]], axis=-1)
        sighted = None if self._readings is None else self._readings[~np.isnan(self._readings.anchor)]
        doubtful = np.inf if sighted is None else misused_from(sighted, self.on_arrival(sighted.s_m))
        kept = np.minimum(stretches[stretches[:, 0] < doubtful], doubtful)
        return kept if doubtful == np.inf else np.concatenate([kept, [[doubtful, float(self.length)]]])

    def profile(self, spacing_m: float | None = None) -> PointDrift:
        """Drift along one path for plotting: the leg borders, points every ``spacing_m`` metres (default: 200 in all)
        and both sides of every fix, in driving order, shape (k,)."""
        if self.distance.ndim != 1:
            raise ValueError(f"expected the drift of one path, got a batch of shape {self.distance.shape[:-1]}")
        length = float(self.length)
        spacing = positive("spacing_m", spacing_m) if spacing_m is not None else max(length, 1e-300) / 200
        bounded("points of a profile", length / spacing, 1e7, "use a larger spacing_m")
        between = np.arange(spacing, length, spacing)
        inner = self._inside(between)
        parts = [*self._driven, inner.moments]
        distance = np.concatenate([self._border_distance, self._border_distance, between])
        order = np.lexsort((np.repeat([0, 1, 2], [x.shape[-1] for x in parts]), distance))
        return PointDrift(distance[order], Moments.concatenate(parts)[order])

    def _on_path(self, s: Floats, wanted: Floats) -> Floats:
        length = self.length[..., None]
        if not ((s >= 0) & (s <= length * (1 + 1e-9))).all():
            raise ValueError(f"expected distances on the path, in [0, {self.length.min():.6g}] m, got {wanted}")
        return np.minimum(s, length)

    def _inside(self, s: Floats, *, after: bool = True) -> PointDrift:
        """Drift at distances (..., k) on the path: the last border before (``after`` the readings of a border that is
        there, or on arrival at it), and the leg from there, if it has begun."""
        borders, last = self._border_distance, self.runs.lengths.shape[-1]
        within = same_place_within(float(np.max(self.length, initial=0.0)))
        reached = s + within / 3 if after else s - within  # a fix lies where it was said to, rounding or not
        if borders.ndim == 1:
            border = np.searchsorted(borders, reached, side="right") - 1
        else:
            border = (borders[..., None, :] <= reached[..., :, None]).sum(axis=-1) - 1
        border = np.clip(border, 0, last)
        leg = np.minimum(border, last - 1)
        driven = np.clip(s - _picked(borders, border), 0.0, None)
        turns = np.where(driven > 0, _picked(self.runs.turns, leg), 0.0)
        curvatures, which = _picked(self.runs.curvatures, leg), _picked(self.leg_noises, leg)
        return PointDrift(s, self._onward(border, turns, driven, curvatures, which))


def _picked(x: Array, index: Ints) -> Array:
    """Of one path's borders or legs, or each of its own path's."""
    if x.ndim == 1:
        return x[index]
    return np.take_along_axis(x, index, axis=-1)


def predict_drift(
    path: Any,
    noise: Noises,
    *,
    start_heading: float | ArrayLike | None = None,
    fixes: Sequence[Fix] | Readings = (),
    estimator: Estimator = "reset",
) -> Drift:
    """How far odometry will have drifted at every point of a path: bias, covariance and rms, in closed form.

    The robot follows ``path`` exactly, starting from a known pose; its odometry errs as `OdometryNoise` says,
    independently on disjoint stretches. Exact first and second moments for any amount of noise, no linearisation (for
    a robot that resets). A path costs O(waypoints), whatever the number of odometry steps.

    Parameters
    ----------
    path : (n, 2) waypoints in metres, world frame, with turns on the spot between straight runs; (n, 3) with headings
        in rad, at which the robot turns to its course, drives and turns to the heading; (..., n, 2|3) batches; a list
        of arrays of different lengths; a list of `Run`; or `Runs` (for odometry logs `Runs.from_odometry`)
    noise : OdometryNoise or one per run
        A sequence gives each leg its own noise (floors of different kinds). Where systematic errors differ between
        drives, the result is the average over drives, whose three deviations are the same on all floors.
    start_heading : heading before the first turn, rad; by default the robot already faces its first run
    fixes : sequence of Fix, or Readings
        Absolute measurements on the way (one path only), ordered as `driftplan.model.readings` says. A fix at 0 sets
        the uncertainty of the start.
    estimator : {"reset", "filter"}
        What the robot does with a fix. ``reset``: it replaces what is measured; safe to assume of every robot.
        ``filter``: it is fused in an extended Kalman filter, so that a position fix also corrects heading and a further
        fix never hurts. Then the drift is the filter's covariance, linearised about the path: within a few per cent
        outside of `Drift.beyond_linear`. Known systematic errors shift the filter's mean, they are not corrected; those
        that differ between drives are further states, which it estimates as it goes.

    Raises ValueError for paths of fewer than 2 waypoints, wrong shapes, values that are not finite, fixes off the path;
    for ranges and bearings with ``reset``.

    Error-moment algebra: see `driftplan.model.moments` and `driftplan.model.elements`. The published double sums give
    the same numbers in O(n²), once their misprints are mended.

    >>> noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    >>> drift = predict_drift([(0, 0), (30, 0), (30, 10)], noise)
    >>> drift.rms.round(3)
    array([0.   , 0.531, 0.621])
    >>> drift.at(15.0).rms.round(3).item()
    0.195
    """
    choice("estimator", estimator, Estimator)
    runs = read_path(path, start_heading)
    noises, noise_of_leg = noise_of_legs(noise, runs.lengths.shape[-1], runs.legs_per_waypoint)
    if estimator == "reset" and any(one.varies_between_drives for one in noises):
        own, some = noise_of_leg[:: runs.legs_per_waypoint].tolist(), []
        for weight, z in drives_to_average(noises):
            on_drive = [one.on_drive(z) for one in noises]
            some.append((weight, predict_drift(runs, [on_drive[k] for k in own], fixes=fixes)))
        return _average_drift(some, noises)
    waypoints = np.arange(0, runs.lengths.shape[-1] + 1, runs.legs_per_waypoint)
    zero = np.zeros(np.shape(runs.start))
    start = Moments(np.exp(1j * runs.heading), runs.start, *([zero] * 8))
    readings, at, beliefs = None, None, None
    if len(fixes):
        readings = fixes if isinstance(fixes, Readings) else Readings.of(fixes)
        runs, at, borders = runs.cut(readings.s_m)
        waypoints, noise_of_leg = borders[waypoints], np.repeat(noise_of_leg, np.diff(borders))
    if estimator == "filter":
        driven, beliefs = fuse(runs, noise_of_leg, *spread_of(noises), start, readings, at)
    else:
        legs = of_legs(runs.turns, runs.lengths, runs.curvatures, noise_of_leg, noises)
        driven = drive(legs, start, readings, at)
    distance = np.concatenate([zero[..., None], np.cumsum(runs.lengths, axis=-1)], axis=-1)
    at_waypoints, moments = distance[..., waypoints], driven.leaving[..., waypoints]
    for array in (distance, at_waypoints, *(x for part in (moments, *driven) for x in part.arrays())):
        array.setflags(write=False)
    return Drift(at_waypoints, moments, runs, noises, noise_of_leg, driven, distance, beliefs, readings)


def _averaged(moments: Sequence[tuple[float, Moments]]) -> Moments:
    """Error moments are expectations: those over all drives are the average."""
    columns = zip(*(one.arrays() for _, one in moments), strict=True)
    weights = [weight for weight, _ in moments]
    return Moments(*(sum(w * x for w, x in zip(weights, column, strict=True)) for column in columns))


def _average_drift(drives: Sequence[tuple[float, Drift]], noises: tuple[OdometryNoise, ...]) -> Drift:
    driven = Driven(*(_averaged([(weight, one._driven[k]) for weight, one in drives]) for k in range(2)))
    moments = _averaged([(weight, one.moments) for weight, one in drives])
    return replace(drives[0][1], moments=moments, noises=noises, _driven=driven, _drives=tuple(drives))
