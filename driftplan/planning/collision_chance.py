"""collision_chance: how likely a robot that steers by its drifting estimate touches a wall on its way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
import shapely
from scipy.special import betaincinv

from driftplan.arrays import Array, Bools, Floats, Ints, bounded, positive, whole
from driftplan.beacons.readings import gaussian_points
from driftplan.model.drift import Drift
from driftplan.model.point_drift import PointDrift
from driftplan.world.world import World

_CONFIDENCE = 0.95  # of the interval
_PLACES = 200  # along a path, beside its borders, unless told otherwise
_POINTS = 1024  # of a distribution
_WIDER = 1.5  # times as wide as the errors are spread the points at which they are looked at
_PAIRS_AT_ONCE = 256  # of consecutive places, each with so many points
_ERRORS_AT_ONCE = 400_000  # of simulated drives, held in memory


@dataclass(frozen=True, eq=False, kw_only=True)
class CollisionChance:
    """How likely a robot that steers by its estimate touches a wall.

    It believes itself on its path, so it is where the path is, less the error of its estimate (to first order in the
    drift; what it reads makes it steer back, not stop). Beacons are read as along the path as planned.

    Attributes
    ----------
    runs : simulated drives
    probability : share of simulated drives that touch a wall anywhere on the way
    low, high : interval that holds what endless many drives would give, with 95 % (Clopper and Pearson, Biometrika 26,
        1934)
    bound : upper bound of it, without simulation: how often the robot is expected to run into a wall, if walls did not
        stop it (Markov's inequality), from the predicted errors at pairs of consecutive places, taken for Gaussian.
        Close where errors of heading make the drift; where errors of distance do, it says the less, the more places
        are looked at
    xy, distance : (k, 2) and (k,), the places: metres, world frame, and along the path
    at : (k,) chance of being in a wall at each, on arrival, by the predicted errors, taken for Gaussian (good to 0.01)
    by : (k,) share of simulated drives that have touched one by then

    >>> from driftplan import OdometryNoise, predict_drift
    >>> aisle = World.from_polygons([], bounds=(0, 0, 20, 2), robot_radius=0.4)
    >>> drift = predict_drift([(1, 1), (19, 1)], OdometryNoise(heading_var_per_m=1e-4))
    >>> chance = collision_chance(drift, aisle, runs=200)
    >>> chance.low < chance.probability < chance.high < 0.5, len(chance.at) == len(chance.xy)
    (True, True)
    """

    runs: int
    probability: float
    low: float
    high: float
    bound: float
    xy: Floats
    distance: Floats
    at: Floats
    by: Floats

    def __repr__(self) -> str:
        return (
            f"CollisionChance({self.probability:.3g}, 95 % in [{self.low:.3g}, {self.high:.3g}], at most "
            f"{self.bound:.3g}; at one place at most {self.at.max():.3g}, {self.distance[self.at.argmax()]:.4g} m on)"
        )


def collision_chance(
    drift: Drift, world: World, *, runs: int = 1000, spacing_m: float | None = None, seed: int = 0
) -> CollisionChance:
    """How likely the robot whose drift that is touches a wall of a world.

    Parameters
    ----------
    drift : along one path, with whatever is read on the way, as `driftplan.predict_drift`,
        `driftplan.drift_with_beacons` and routes give it
    world : its obstacles and bounds; the robot is its disc of ``robot_radius``
    runs : simulated drives
    spacing_m : between the places looked at, metres, beside the waypoints; default: a 200th of the path
    seed : of the simulation

    Raises ValueError for several paths at once, runs < 1 and a spacing <= 0.

    >>> from driftplan import OdometryNoise, predict_drift
    >>> world = World.from_polygons([[(0, 2), (30, 2), (30, 3), (0, 3)]], bounds=(0, -9, 30, 3), robot_radius=0.5)
    >>> drift = predict_drift([(1, 1), (25, 1)], OdometryNoise(lateral_var_per_m=0.01))  # the wall is 0.5 m away
    >>> chance = collision_chance(drift, world)  # of a random walk of 0.49 m in the end: 2 P(it ends beyond) = 0.308
    >>> 0.25 < chance.low < 0.308 < chance.high < 0.36, 0.14 < float(chance.at[-1]) < 0.17, chance.bound > 0.308
    (True, True, True)
    """
    bounded("drives to simulate", whole("runs", runs, least=1), 1e8, "use fewer runs")
    whole("seed", seed, least=0)
    if drift.distance.ndim != 1:
        raise ValueError(f"expected the drift of one path, got a batch of shape {drift.distance.shape[:-1]}")
    distance = _places(drift, None if spacing_m is None else positive("spacing_m", spacing_m))
    arriving, leaving = drift.on_arrival(distance), drift.at(distance)
    walls = _Walls(world, arriving.xy)
    touched = np.concatenate(list(_drives(drift, distance, walls, runs, np.random.default_rng(seed))))
    count, tail = int(touched[:, -1].sum()), (1 - _CONFIDENCE) / 2
    at = walls.inside(np.arange(len(distance)), _gaussian(arriving.bias, arriving.cov)) @ _weights(2)
    return CollisionChance(
        runs=runs,
        probability=count / runs,
        low=float(betaincinv(count, runs - count + 1, tail)) if count > 0 else 0.0,
        high=float(betaincinv(count + 1, runs - count, 1 - tail)) if count < runs else 1.0,
        bound=min(float(at[0]) + _entries(walls, arriving, leaving, drift.is_fused), 1.0),
        xy=arriving.xy,
        distance=distance,
        at=at,
        by=touched.mean(axis=0),
    )


class _Walls:
    """What stands around the places of a path."""

    def __init__(self, world: World, xy: Floats) -> None:
        self.world, self.xy = world, xy
        outline = shapely.boundary(world.free)
        shapely.prepare(outline)
        ways = shapely.linestrings(np.stack([xy, np.concatenate([xy[1:], xy[-1:]])], axis=1))
        self.clearance = shapely.distance(outline, ways) * (1 - 1e-9)  # of every place and the way on
        self.clearance[~world.is_free(xy)] = 0.0

    def inside(self, place: Ints, errors: Floats) -> Bools:
        """Whether robots off by ``errors`` (n, robots, 2) at places (n,) are in a wall, (n, robots)."""
        inside: Bools = np.hypot(errors[..., 0], errors[..., 1]) >= self.clearance[place][:, None]
        inside[inside] = ~self.world.is_free((self.xy[place][:, None] - errors)[inside])
        return inside

    def enter(self, place: Ints, before: Floats, onward: Ints, after: Floats) -> Bools:
        """Whether robots off by ``before`` (n, robots, 2) at places (n,) are in no wall there but run into one on the
        way to where they are off by ``after``, at the places ``onward``, the same or the next ones; (n, robots)."""
        off = np.maximum(np.hypot(before[..., 0], before[..., 1]), np.hypot(after[..., 0], after[..., 1]))
        enter: Bools = off >= self.clearance[place][:, None]
        a, b = self.xy[place][:, None] - before, self.xy[onward][:, None] - after
        enter[enter] = self.world.is_free(a[enter])
        enter[enter] = ~self.world.segments_free(a[enter], b[enter])
        return enter


def _places(drift: Drift, spacing_m: float | None) -> Floats:
    """Every border of legs, and places between; where odometry counts steps at whole ones, so that none is added."""
    lengths = drift.runs.lengths
    wanted = max(float(drift.length), 1e-300) / _PLACES if spacing_m is None else spacing_m
    begins = np.cumsum(lengths) - lengths
    apart = np.array([noise.step_m or 0.0 for noise in drift.noises])[drift.leg_noises]
    steps = np.ceil(wanted / np.where(apart > 0, apart, wanted) - 1e-9)
    apart = np.where(apart > 0, steps * apart, wanted)
    parts = np.maximum(np.ceil(lengths / apart - 1e-9), 1)
    bounded("places looked at", float(parts.sum()), 1e5, "use a larger spacing_m")
    leg = np.repeat(np.arange(len(lengths)), parts.astype(int))
    step = np.arange(len(leg)) - np.repeat(np.cumsum(parts) - parts, parts.astype(int))
    return np.unique(np.append(begins[leg] + np.minimum(step * apart[leg], lengths[leg]), float(drift.length)))


def _drives(drift: Drift, distance: Floats, walls: _Walls, runs: int, rng: np.random.Generator) -> Iterator[Bools]:
    """Of simulated drives, whether each has touched a wall by each place, (some, k)."""
    place = np.arange(len(distance))
    some = max(_ERRORS_AT_ONCE // len(distance), 1)
    for count in [some] * (runs // some) + [runs % some] * (runs % some > 0):
        errors = np.swapaxes(drift.simulated(distance, runs=count, rng=rng), 0, 1)
        entered = walls.enter(place[:-1], errors[:-1], place[1:], errors[1:])
        yield np.logical_or.accumulate(np.concatenate([walls.inside(place[:1], errors[:1]), entered])).T


def _entries(walls: _Walls, arriving: PointDrift, leaving: PointDrift, fused: bool) -> float:
    """How often, on average, a wall is run into from where there was none: on the way from place to place, and where
    readings make the robot steer back."""
    place = np.arange(len(arriving.distance))
    A, B = leaving.moments[:-1], arriving.moments[1:]
    move = B.p - A.p  # e_B = e_A + δ_A move + what is new
    driven = _covariance(A.N + A.a * move.conj(), A.e2 + A.b * move, A.e1, A.e1 + A.d1 * move)
    onward = (place[:-1], leaving.bias[:-1]), (place[1:], arriving.bias[1:])
    total = _entered(walls, *onward, (leaving.cov[:-1], driven, arriving.cov[1:]))
    read = place[~np.isclose(arriving.cov, leaving.cov, rtol=1e-9, atol=0.0).all(axis=(1, 2))]
    before, after = arriving.cov[read], leaving.cov[read]
    across = after if fused else np.zeros(after.shape)  # after a filter's reading the error does not go with the step
    return total + _entered(walls, (read, arriving.bias[read]), (read, leaving.bias[read]), (before, across, after))


def _entered(
    walls: _Walls, begin: tuple[Ints, Floats], end: tuple[Ints, Floats], cov: tuple[Floats, Floats, Floats]
) -> float:
    """The sum over pairs of places (n,) of the chance to be free at the one and run into a wall by the other. With each
    place comes the mean error (n, 2) there; ``cov`` has the covariances (n, 2, 2) of the first error, across and of the
    second."""
    upper = np.concatenate([cov[0], cov[1]], axis=2)
    joint = np.concatenate([upper, np.concatenate([np.swapaxes(cov[1], 1, 2), cov[2]], axis=2)], axis=1)
    mean, total = np.concatenate([begin[1], end[1]], axis=1), 0.0
    for some in np.array_split(np.arange(len(mean)), len(mean) // _PAIRS_AT_ONCE + 1):
        errors = _gaussian(mean[some], joint[some])
        entered = walls.enter(begin[0][some], errors[..., :2], end[0][some], errors[..., 2:])
        total += float((entered @ _weights(4)).sum())
    return total


def _gaussian(mean: Floats, cov: Floats) -> Floats:
    """Points of Gaussians, (n, points, d), spread wider so that rare errors are among them; each counts `_weights`."""
    return gaussian_points(mean, _WIDER**2 * cov, _POINTS)


@cache
def _weights(dimensions: int) -> Floats:
    """What each of the wider points counts, (points,): the ratio of the densities."""
    (z,) = gaussian_points(np.zeros((1, dimensions)), np.eye(dimensions)[None], _POINTS)
    weights = np.exp(-(_WIDER**2 - 1) / 2 * (z**2).sum(axis=1))
    return np.asarray(weights / weights.sum())


def _covariance(conjugate: Array, plain: Array, mean_a: Array, mean_b: Array) -> Floats:
    """E[(a - E a) (b - E b)ᵀ] of vectors, (..., 2, 2), from E[a conj(b)], E[a b], E a and E b as complex numbers."""
    c, r = conjugate - mean_a * np.conj(mean_b), plain - mean_a * mean_b
    rows = [[(r + c).real, (r - c).imag], [(r + c).imag, (c - r).real]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2) / 2
