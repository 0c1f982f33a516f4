"""Recorded drives: what the odometry said, and where the robot truly was; simulate_log to try calibration on.

Frame: world, metres, x to the right, y up, headings counter-clockwise from +x in radians (REP-103). Odometry starts at
its own origin: only its increments mean something.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Bools, Complexes, Floats, bounded, finite, generator, not_negative, positive, whole
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Runs, read_path, wrap

_STANDING = 0.02  # of the usual speed and turn rate: slower is standing,
_STANDING_RAD = 0.01  # or turning by less in a second
_TURN_STEP_RAD = 0.05  # of a simulated turn on the spot
_GLITCH = 20.0  # times the usual speed or turn rate: faster is no motion


@dataclass(frozen=True, slots=True, eq=False)
class OdometryLog:
    """What odometry reported: increments between consecutive samples. Make one with a ``from_...`` constructor.

    Attributes
    ----------
    times : (n + 1,), seconds, increasing
    moves : (n,), displacement between samples, x (forward) + jy (left) as the robot stood at the first of them, metres
    turns : (n,), change of heading between samples, rad, positive to the left
    holds_velocity : whether increments were integrated from velocities: motion in a gap between samples is a guess
    repeated : samples whose time was not later than the one before: merged (increments) or left out
    glitches : (m,), when the steps began that `without_glitches` took out, s: what happened in them is unknown
    notes : what is to be said about the file that it was read from
    start : where the first pose was, x + jy in the odometry's own frame, metres: nothing depends on it

    >>> log = OdometryLog.from_increments(distances_m=[1.0, 1.0], turns_rad=[0.0, 0.5])
    >>> log.times, log.headings
    (array([0., 1., 2.]), array([0. , 0. , 0.5]))
    """

    times: Floats
    moves: Complexes
    turns: Floats
    holds_velocity: bool = False
    repeated: int = 0
    glitches: Floats = field(default_factory=lambda: np.zeros(0))
    notes: tuple[str, ...] = ()
    start: complex = 0j

    @classmethod
    def from_increments(
        cls, distances_m: ArrayLike, turns_rad: ArrayLike, times_s: ArrayLike | None = None
    ) -> OdometryLog:
        """Distance and turn per step; each step is taken for an arc.

        Parameters
        ----------
        distances_m, turns_rad : (n,), per step, metres (negative when driving backwards) and rad
        times_s : (n + 1,) or (n,), optional, times before the first and after every step, or only after every step (the
            first is then taken to last as long as the median one). Default: 0, 1, 2, ...

        Raises ValueError for wrong shapes and values that are not finite.

        >>> log = OdometryLog.from_increments([1.0, 1.0], [0.0, np.pi / 2], times_s=[1.0, 2.0])
        >>> log.times, log.travelled.round(3)
        (array([0., 1., 2.]), array([0. , 1. , 1.9]))
        """
        distances, turns = _series("distances_m", distances_m), _series("turns_rad", turns_rad)
        if distances.shape != turns.shape or distances.size < 1:
            raise ValueError(
                f"expected distances_m and turns_rad of one shape (n,), n >= 1, got {distances.shape} and {turns.shape}"
            )
        n = distances.size
        times = np.arange(n + 1.0) if times_s is None else _series("times_s", times_s)
        if times.size == n:
            step = float(np.median(np.diff(times))) if n > 1 else 1.0
            times = np.concatenate([[times[0] - max(step, 1e-9)], times])
        if times.size != n + 1:
            raise ValueError(f"expected times_s of shape ({n + 1},) or ({n},) for {n} steps, got {times.shape}")
        return _merged(times, distances * _chord(turns), turns)

    @classmethod
    def from_velocities(
        cls, times_s: ArrayLike, speeds_m_per_s: ArrayLike, turn_rates_rad_per_s: ArrayLike
    ) -> OdometryLog:
        """Forward speed and turn rate, each held until the next sample.

        Parameters
        ----------
        times_s, speeds_m_per_s, turn_rates_rad_per_s : array, shape (n,), n >= 2
            Seconds, m/s (negative backwards), rad/s (positive to the left).

        >>> OdometryLog.from_velocities([0.0, 2.0, 3.0], [0.5, 1.0, 9.0], [0.0, 0.0, 0.0]).moves.real
        array([1., 1.])
        """
        times = _series("times_s", times_s)
        speeds, rates = _series("speeds_m_per_s", speeds_m_per_s), _series("turn_rates_rad_per_s", turn_rates_rad_per_s)
        if not times.shape == speeds.shape == rates.shape or times.size < 2:
            raise ValueError(
                "expected times_s, speeds_m_per_s and turn_rates_rad_per_s of one shape (n,), n >= 2, got "
                f"{times.shape}, {speeds.shape} and {rates.shape}"
            )
        keep = _later(times)
        dt, speeds, rates = np.diff(times[keep]), speeds[keep][:-1], rates[keep][:-1]
        moves = speeds * dt * _chord(rates * dt)
        return cls(times[keep], moves, rates * dt, holds_velocity=True, repeated=int((~keep).sum()))

    @classmethod
    def from_poses(cls, poses: ArrayLike, times_s: ArrayLike | None = None) -> OdometryLog:
        """Poses of a dead reckoner or of a visual odometry, in any frame of its own.

        Parameters
        ----------
        poses : array, shape (n, 3), n >= 2: x, y (m), heading (rad)
        times_s : (n,), optional, default: 0, 1, 2, ...

        >>> OdometryLog.from_poses([(0, 0, np.pi / 2), (0, 2, np.pi / 2)]).moves.round(6)
        array([2.+0.j])
        """
        array = finite("poses", poses)
        if array.ndim != 2 or array.shape[1] != 3 or len(array) < 2:
            raise ValueError(f"expected poses of shape (n, 3): x, y, heading, with n >= 2, got {array.shape}")
        times = np.arange(float(len(array))) if times_s is None else _series("times_s", times_s)
        if times.size != len(array):
            raise ValueError(f"expected times_s of shape ({len(array)},), one per pose, got {times.shape}")
        keep = _later(times)
        x, y, heading = array[keep].T
        moves = np.diff(x + 1j * y) * np.exp(-1j * heading[:-1])
        turns = np.asarray(wrap(np.diff(heading)))
        return cls(times[keep], moves, turns, repeated=int((~keep).sum()), start=complex(x[0], y[0]))

    @property
    def headings(self) -> Floats:
        """Integrated heading at every sample, rad, not wrapped, (n + 1,); 0 at the first."""
        return np.concatenate([[0.0], np.cumsum(self.turns)])

    @property
    def positions(self) -> Complexes:
        """Dead-reckoned position at every sample, x + jy, metres, (n + 1,); 0 at the first."""
        return np.concatenate([[0.0], np.cumsum(self.moves * np.exp(1j * self.headings[:-1]))])

    @property
    def travelled(self) -> Floats:
        """Metres driven up to every sample according to the odometry, (n + 1,)."""
        return np.concatenate([[0.0], np.cumsum(np.abs(self.moves))])

    @property
    def standing(self) -> Bools:
        """In which steps the robot stood, (n,): nothing moved, or within a second hardly more than jitter does, 2 % of
        what is usual when it drives and turns (or 0.01 rad)."""
        half = max(0.5, float(np.median(np.diff(self.times))))
        at = 0.5 * (self.times[1:] + self.times[:-1])
        ends = np.clip(np.stack([at - half, at + half]), self.times[0], self.times[-1])
        moved = np.abs(np.diff(np.interp(ends, self.times, self.positions), axis=0)[0])
        turned = np.abs(np.diff(np.interp(ends, self.times, self.headings), axis=0)[0])
        slow = (moved < _STANDING * np.quantile(moved, 0.9)) & (
            turned < max(_STANDING * float(np.quantile(turned, 0.9)), _STANDING_RAD)
        )
        return np.asarray(slow | ((self.moves == 0) & (self.turns == 0)))

    def without_glitches(self) -> OdometryLog:
        """The log without steps 20 times as fast as all but one in 100: counters wrap, poses jump; slips are slower."""
        dt = np.diff(self.times)
        wild = np.zeros(len(dt), dtype=bool)
        for rate in (np.abs(self.moves) / dt, np.abs(self.turns) / dt):
            usual = float(np.quantile(rate, 0.99))
            wild |= (rate > _GLITCH * usual) & (usual > 0)
        if not wild.any():
            return self
        glitches = np.union1d(self.glitches, self.times[:-1][wild])
        moves, turns = np.where(wild, 0, self.moves), np.where(wild, 0.0, self.turns)
        return replace(self, moves=moves, turns=turns, glitches=glitches)

    def between(self, first_s: float, last_s: float) -> OdometryLog:
        """The part recorded from ``first_s`` to ``last_s`` seconds: whole steps only."""
        inside = np.flatnonzero((self.times >= first_s) & (self.times <= last_s))
        if inside.size < 2:
            raise ValueError(f"expected at least 2 samples between {first_s} and {last_s} s, got {inside.size}")
        first, last = int(inside[0]), int(inside[-1])
        within = (self.glitches >= self.times[first]) & (self.glitches < self.times[last])
        return replace(
            self,
            times=self.times[first : last + 1],
            moves=self.moves[first:last],
            turns=self.turns[first:last],
            glitches=self.glitches[within],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Where the robot truly was (a reference far better than the odometry), sampled at its own times.

    Attributes
    ----------
    times : (n,), seconds, on the odometry's clock up to a constant offset
    xy : (n, 2), metres, world frame
    heading : (n,) or None, rad; None when only positions were measured.
    repeated : samples left out because their time was not later than the one before
    notes : what is to be said about the file that it was read from

    Raises ValueError for wrong shapes, values that are not finite, fewer than 2 samples.

    >>> Trajectory([0.0, 1.0, 1.0], [(0, 0), (1, 0), (1, 0)]).repeated
    1
    """

    times: Floats
    xy: Floats
    heading: Floats | None = None
    repeated: int = 0
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        times, xy = _series("times", self.times), finite("xy", self.xy)
        if xy.shape != (times.size, 2) or times.size < 2:
            raise ValueError(
                f"expected xy of shape (n, 2) and times of shape (n,), n >= 2, got {xy.shape} and {times.shape}"
            )
        keep = _later(times)
        if self.heading is not None:
            heading = _series("heading", self.heading)
            if heading.shape != times.shape:
                raise ValueError(f"expected heading of shape {times.shape}, one per time, got {heading.shape}")
            object.__setattr__(self, "heading", np.unwrap(heading[keep]))
        object.__setattr__(self, "times", times[keep])
        object.__setattr__(self, "xy", xy[keep])
        object.__setattr__(self, "repeated", whole("repeated", self.repeated, least=0) + int((~keep).sum()))

    @property
    def positions(self) -> Complexes:
        """x + jy, (n,)."""
        return np.asarray(self.xy[:, 0] + 1j * self.xy[:, 1])

    def without_heading(self) -> Trajectory:
        """The positions alone."""
        return replace(self, heading=None)

    def between(self, first_s: float, last_s: float) -> Trajectory:
        """The samples from ``first_s`` to ``last_s`` seconds."""
        return self.chosen((self.times >= first_s) & (self.times <= last_s))

    def chosen(self, samples: Bools) -> Trajectory:
        """Some of the samples."""
        heading = None if self.heading is None else self.heading[samples]
        return replace(self, times=self.times[samples], xy=self.xy[samples], heading=heading)


def simulate_log(
    path: Any,
    noise: OdometryNoise,
    *,
    rng: np.random.Generator | int = 0,
    step_m: float = 0.1,
    speed_m_per_s: float = 1.0,
    truth_position_std_m: float = 0.0,
    truth_heading_std: float = 0.0,
    start_heading: float | ArrayLike | None = None,
) -> tuple[OdometryLog, Trajectory]:
    """Odometry and truth of one simulated drive along a path, to try calibration on. No formula of the moments is used.

    Parameters
    ----------
    path, start_heading : one path, as for `driftplan.model.drift.predict_drift`
    noise : of the continuous model, with Gaussian errors and no ``heading_distance_corr``
    rng : numpy.random.Generator or seed
    step_m : distance between samples, metres; turns on the spot are sampled every 0.05 rad
    speed_m_per_s : speed between samples; on the spot one radian takes as long as one metre
    truth_position_std_m, truth_heading_std : white errors of the recorded truth: metres per coordinate, rad

    >>> odometry, truth = simulate_log([(0, 0), (10, 0), (10, 5)], OdometryNoise(distance_scale_error=0.02))
    >>> odometry.travelled[-1].round(6).item(), truth.xy[-1].round(6).tolist()
    (15.3, [10.0, 5.0])
    """
    if noise.step_m is not None or noise.heading_distance_corr != 0:
        raise ValueError(f"expected a noise of the continuous model without heading_distance_corr, got {noise!r}")
    step_m, speed_m_per_s = positive("step_m", step_m), positive("speed_m_per_s", speed_m_per_s)
    not_negative("truth_position_std_m", truth_position_std_m), not_negative("truth_heading_std", truth_heading_std)
    rng = generator(rng)
    noise = noise.on_drive(rng.standard_normal(3).tolist()) if noise.varies_between_drives else noise
    runs = read_path(path, start_heading)
    if runs.lengths.ndim != 1:
        raise ValueError(f"expected one path, got a batch of shape {runs.lengths.shape[:-1]}: simulate one by one")
    bounded("samples", float(np.sum(runs.lengths)) / step_m, 1e8, "use a larger step_m")
    moved, turned = _steps(runs, step_m)
    n = len(moved)
    times = np.concatenate([[0.0], np.cumsum((moved + np.abs(turned) * (moved == 0)) / speed_m_per_s)])
    truth = OdometryLog.from_increments(moved, turned, times)

    angle = np.abs(turned)
    along = np.sqrt(noise.distance_var_per_m * moved + noise.distance_var_per_rad * angle) * rng.standard_normal(n)
    across = np.sqrt(noise.lateral_var_per_m * moved) * rng.standard_normal(n)
    heading_std = np.sqrt(noise.heading_var_per_m * moved + noise.heading_var_per_rad * angle)
    turns = (1 + noise.heading_bias_per_rad) * turned + noise.heading_bias_per_m * moved
    turns = turns + heading_std * rng.standard_normal(n)
    arcs = OdometryLog.from_increments((1 + noise.distance_scale_error) * moved, turns, times)
    moves = arcs.moves + (along + 1j * across) * np.exp(0.5j * turns)

    positions = complex(runs.start) + truth.positions * np.exp(1j * runs.heading)
    xy = np.stack([positions.real, positions.imag], axis=-1) + truth_position_std_m * rng.standard_normal((n + 1, 2))
    heading = truth.headings + float(runs.heading) + truth_heading_std * rng.standard_normal(n + 1)
    return OdometryLog(times, moves, turns), Trajectory(times, xy, heading)


def _steps(runs: Runs, step_m: float) -> tuple[Floats, Floats]:
    """Distance and turn of every sample: turns on the spot, then runs, in equal pieces."""
    moved, turned = [], []
    for turn, length, curvature in zip(runs.turns, runs.lengths, runs.curvatures, strict=True):
        spots = int(np.ceil(abs(turn) / _TURN_STEP_RAD - 1e-9))
        pieces = int(np.ceil(length / step_m - 1e-9))
        moved += [np.zeros(spots), np.full(pieces, length / max(pieces, 1))]
        turned += [np.full(spots, turn / max(spots, 1)), np.full(pieces, curvature * length / max(pieces, 1))]
    return np.concatenate(moved), np.concatenate(turned)


def _chord(turns: Floats) -> Complexes:
    """Displacement of an arc of length 1 that turns by ``turns``, in the frame of its start."""
    return np.asarray(np.sinc(turns / (2 * np.pi)) * np.exp(0.5j * turns))


def _merged(times: Floats, moves: Complexes, turns: Floats) -> OdometryLog:
    """Steps that end no later than they began are joined to the step before them: the motion they report is real, only
    their time is not. (Before any time has passed there is nothing to join to: such motion precedes the log.)"""
    log, keep = OdometryLog(times, moves, turns), _later(times)
    if keep.all():
        return log
    # the last sample of each group of repeated times holds all the motion reported up to that time
    last = np.append(np.flatnonzero(keep)[1:] - 1, len(times) - 1)
    headings, positions = log.headings[last], log.positions[last]
    moves = np.diff(positions) * np.exp(-1j * headings[:-1])
    return OdometryLog(times[keep], moves, np.diff(headings), repeated=int((~keep).sum()))


def _later(times: Floats) -> Bools:
    """Which samples are later than all before them: at least two."""
    later = np.concatenate([[True], times[1:] > np.maximum.accumulate(times)[:-1]])
    if later.sum() < 2:
        raise ValueError("expected at least 2 different times, got one")
    return later


def _series(name: str, values: object) -> Floats:
    array = finite(name, values)
    if array.ndim != 1:
        raise ValueError(f"expected {name} of shape (n,), got {array.shape}")
    return array
