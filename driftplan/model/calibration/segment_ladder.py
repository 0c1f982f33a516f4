"""Recorded drives turned into errors of segments of several lengths: what calibration fits and checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftplan.arrays import Floats
from driftplan.model.calibration.matching import Match, Stretch, match
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.model.calibration.segments import Observations, TruthNoise, Windows, expect, observe, windows_of
from driftplan.model.noise import OdometryNoise

_STRIDES = 4  # segments of a length begin every 1/4 of it
_KNOTS = 8  # pieces of the shortest segment, or of its half where segments are aligned by their first half
_RUNGS = 5  # default lengths, each half the next
_LONGEST_SHARE = 16  # the longest default segment fits so many times in all drives together,
_LONGEST_IN_ONE = 4  # and so many times in the shortest drive
_LEAST_KNOTS = 4  # samples in the shortest default segment, or in its half
_FLOOR = 1e-6  # of the mean square of the observations of a length


class Rung(NamedTuple):
    """Segments of one length: ``steps`` knots in each part, ``length_m`` in all, by stretch."""

    steps: int
    length_m: float
    sets: tuple[tuple[int, Observations], ...]  # index of the stretch, its observations


@dataclass(frozen=True, slots=True, eq=False)
class Ladder:
    """Observed segments of several lengths.

    Attributes
    ----------
    stretches : tuple of Stretch
    rungs : tuple of Rung
        Shortest segments first.
    values : array, shape (n, 3)
        Observations, see `driftplan.model.calibration.segments`; rung by rung.
    rung, drive : arrays of int, shape (n,)
        Which length and which drive each belongs to.
    place_m : array, shape (n,)
        Where each segment begins, all drives laid end to end.
    weight : array, shape (n,)
        Adding up to the number of longest segments that fit side by side, on every rung.
    total_m : float
        Length of all drives.
    """

    stretches: tuple[Stretch, ...]
    rungs: tuple[Rung, ...]
    values: Floats
    rung: NDArray[np.intp]
    drive: NDArray[np.intp]
    place_m: Floats
    weight: Floats
    total_m: float

    @property
    def has_heading(self) -> bool:
        """Whether the truth's headings are used."""
        return self.stretches[0].truth_heading is not None

    @property
    def position(self) -> slice:
        """Which of the observed values are the position error at a segment's end."""
        return slice(0, 2) if self.has_heading else slice(1, 3)

    def windows(self, noise: OdometryNoise) -> dict[int, Windows]:
        """Moments of all segments under a noise, by stretch."""
        needed: dict[int, list[int]] = {}
        for rung in self.rungs:
            for i, _ in rung.sets:
                needed.setdefault(i, []).append(rung.steps)
        return {i: windows_of(self.stretches[i], noise, steps) for i, steps in needed.items()}

    def expected(self, found: dict[int, Windows], truth: TruthNoise) -> tuple[Floats, Floats]:
        """Mean (n, 3) and covariance (n, 3, 3) of the observations, from what `windows` found."""
        parts = [
            expect(self.stretches[i], seen, found[i], rung.steps, truth) for rung in self.rungs for i, seen in rung.sets
        ]
        return np.concatenate([mean for mean, _ in parts]), np.concatenate([cov for _, cov in parts])

    @property
    def turned_per_longest(self) -> float:
        """Angle turned on the length of the longest segments, rad: heading changes (without headings: changes of
        course) over the shortest ones, so that jitter adds little."""
        rung, turned = self.rungs[0], 0.0
        for stretch in self.stretches:
            if stretch.truth_heading is not None:
                turned += float(np.abs(np.diff(stretch.truth_heading[:: rung.steps])).sum())
            else:
                chords = np.diff(stretch.truth[:: rung.steps])
                turned += float(np.abs(np.angle(chords[1:] * np.conj(chords[:-1]))).sum())
        return turned / self.total_m * self.rungs[-1].length_m

    def by_rung(self, values: Floats) -> Floats:
        """Averages of values (n, ...) over the segments of every length, (rungs, ...)."""
        return np.stack([values[self.rung == k].mean(axis=0) for k in range(len(self.rungs))])

    def floor(self) -> Floats:
        """Least covariance of the observations of every rung, (rungs, 3, 3): none is taken for exact."""
        return np.asarray((_FLOOR * self.by_rung(self.values**2) + 1e-24)[:, :, None] * np.eye(3))


def drives_of(estimates: Any, truths: Any) -> list[tuple[OdometryLog, Trajectory]]:
    """The drives meant by recordings or arrays, one or several."""
    several = (_listed(estimates, OdometryLog), _listed(truths, Trajectory))
    if len(several[0]) != len(several[1]) or not several[0]:
        raise ValueError(f"expected one truth per estimate, got {len(several[0])} and {len(several[1])}")
    return [_drive(estimate, truth) for estimate, truth in zip(*several, strict=True)]


def ladder_of(
    drives: list[tuple[OdometryLog, Trajectory]],
    *,
    lengths_m: ArrayLike | None = None,
    use_heading: bool | None = None,
    time_offset_s: float | None = None,
    heading_offset: float | None = None,
    max_gap_s: float | None = None,
) -> tuple[Ladder, list[Match]]:
    """The drives matched, and their segments.

    Parameters are those of `driftplan.model.calibration.fit.fit_noise`.
    """
    drives = [(odometry.without_glitches(), truth) for odometry, truth in drives]
    with_heading = [truth.heading is not None for _, truth in drives]
    if use_heading and not all(with_heading):
        raise ValueError("expected headings in every truth with use_heading=True, got positions only")
    if use_heading is None:
        use_heading = all(with_heading) and not any(truth_repeats(odometry, truth) for odometry, truth in drives)
    if not use_heading:
        drives = [(odometry, truth.without_heading()) for odometry, truth in drives]
    parts = 1 if use_heading else 2
    sampled = _sampled_every(drives)
    lengths = (
        _lengths(drives, parts * _LEAST_KNOTS * sampled)
        if lengths_m is None
        else np.unique(np.atleast_1d(np.asarray(lengths_m, dtype=float)))
    )
    if lengths.size == 0 or not (np.isfinite(lengths).all() and lengths[0] > 0):
        raise ValueError(f"expected lengths_m > 0, got {lengths_m!r}")
    spacing = max(float(lengths[0]) / (_KNOTS * parts), sampled)
    matches = [
        match(
            odometry,
            truth,
            spacing_m=spacing,
            time_offset_s=time_offset_s,
            heading_offset=heading_offset,
            max_gap_s=max_gap_s,
        )
        for odometry, truth in drives
    ]
    ladder = _climb([m.stretches for m in matches], lengths, spacing, parts)
    if ladder is None:
        longest = max(m.counts.driven_m for m in matches)
        raise ValueError(
            f"expected uninterrupted drives longer than a segment of {lengths[0]:.3g} m, got drives of at most "
            f"{longest:.3g} m"
        )
    return ladder, matches


def truth_repeats(odometry: OdometryLog, truth: Trajectory) -> bool:
    """Whether the truth's headings are nothing but the odometry's turns added up: no measurement of their own."""
    if truth.heading is None:
        return False
    inside = (truth.times >= odometry.times[0]) & (truth.times <= odometry.times[-1])
    if inside.sum() < 3 or np.abs(odometry.turns).sum() == 0:
        return False
    integrated = np.interp(truth.times[inside], odometry.times, odometry.headings)
    return bool(np.median(np.abs(np.diff(truth.heading[inside] - integrated))) < 1e-9)


def _climb(drives: Sequence[Sequence[Stretch]], lengths: Floats, spacing: float, parts: int) -> Ladder | None:
    """Segments of these lengths, in ``parts`` of equal length each, in several drives; None if no drive has any."""
    flat = [(k, stretch) for k, drive in enumerate(drives) for stretch in drive]
    sizes = [float(np.ptp(stretch.driven)) for _, stretch in flat]
    offsets = np.concatenate([[0.0], np.cumsum(sizes)])
    rungs: list[Rung] = []
    values, rung_of, drive_of, place = [], [], [], []
    for length in lengths.tolist():
        steps = max(1, round(length / (parts * spacing)))
        sets = []
        for i, (k, stretch) in enumerate(flat):
            if len(stretch.truth) <= parts * steps:
                continue
            seen = observe(stretch, steps, max(1, parts * steps // _STRIDES))
            if seen.starts.size == 0:
                continue
            sets.append((i, seen))
            values.append(seen.values)
            rung_of.append(np.full(seen.starts.size, len(rungs)))
            drive_of.append(np.full(seen.starts.size, k))
            place.append(offsets[i] + stretch.driven[seen.starts] - stretch.driven[0])
        if sets:
            rungs.append(Rung(steps, parts * steps * spacing, tuple(sets)))
    if not rungs:
        return None
    where = np.concatenate(rung_of)
    total = float(offsets[-1])
    return Ladder(
        tuple(stretch for _, stretch in flat),
        tuple(rungs),
        np.concatenate(values),
        where,
        np.concatenate(drive_of),
        np.concatenate(place),
        (total / rungs[-1].length_m) / np.bincount(where)[where],
        total,
    )


def _sampled_every(drives: list[tuple[OdometryLog, Trajectory]]) -> float:
    """Mean distance between samples of the sparsest recording, metres."""
    return max(float(odometry.travelled[-1]) / min(len(odometry.times), len(truth.times)) for odometry, truth in drives)


def _lengths(drives: list[tuple[OdometryLog, Trajectory]], least: float) -> Floats:
    """Default lengths, metres, increasing: not below ``least``, but at least one."""
    driven = [float(odometry.travelled[-1]) for odometry, _ in drives]
    if min(driven) <= 0:
        raise ValueError("expected drives in which the robot moves, got one without any distance")
    longest = min(sum(driven) / _LONGEST_SHARE, min(driven) / _LONGEST_IN_ONE)
    lengths = longest / 2.0 ** np.arange(_RUNGS)[::-1]
    enough = lengths >= least
    return np.asarray(lengths[enough] if enough.any() else lengths[-1:])


def _listed(recordings: Any, kind: type) -> list[Any]:
    if isinstance(recordings, kind) or (isinstance(recordings, np.ndarray) and recordings.ndim == 2):
        return [recordings]
    if not isinstance(recordings, Sequence) or isinstance(recordings, str):
        raise ValueError(f"expected {kind.__name__}, an array or a sequence of these, got {type(recordings).__name__}")
    if recordings and not isinstance(recordings[0], kind) and np.ndim(recordings[0]) == 1:
        return [recordings]  # the rows of one array
    return list(recordings)


def _drive(estimate: Any, truth: Any) -> tuple[OdometryLog, Trajectory]:
    log = estimate if isinstance(estimate, OdometryLog) else OdometryLog.from_poses(estimate)
    if isinstance(truth, Trajectory):
        return log, truth
    array = np.asarray(truth, dtype=float)
    if array.ndim != 2 or array.shape[1] not in (2, 3) or len(array) != len(log.times):
        raise ValueError(
            f"expected a Trajectory, or an array of shape ({len(log.times)}, 2 or 3), a row for every estimate, got "
            f"{array.shape}"
        )
    return log, Trajectory(log.times, array[:, :2], array[:, 2] if array.shape[1] == 3 else None)
