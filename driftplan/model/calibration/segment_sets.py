"""Recorded drives turned into errors of segments of several lengths: what calibration fits and checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, Ints
from driftplan.model.calibration.matched_drive import MatchedDrive, MatchOptions, match
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.model.calibration.resampling import ResampledDrive
from driftplan.model.calibration.segments import Observations, TruthNoise, WindowMoments, expect, observe, windows_of
from driftplan.model.noise import OdometryNoise

_STRIDES = 4  # segments of a length begin every 1/4 of it
_KNOTS = 8  # pieces of the shortest segment, or of its half where segments are aligned by their first half
_LENGTHS = 5  # default lengths, each half the next
_LONGEST_SHARE = 16  # the longest default segment fits so many times in all drives together,
_LONGEST_IN_ONE = 4  # and so many times in the shortest drive
_MIN_KNOTS = 4  # samples in the shortest default segment, or in its half
_MAX_EXTENTS = 4.0  # the longest default segment, in diagonals of the area driven in: beyond, a room tells no more
_NO_ERROR = 1e-9  # of the longest segment, or rad: less is no error at all
_MOST_COUNTED = 1e4  # times the true distance, or as small a part of it: no unit is so far off
_FLOOR = 1e-6  # of the mean square of the observations of a length


class LengthBin(NamedTuple):
    """Segments of one length: ``steps`` knots in each part, ``length_m`` in all, by resampled drive."""

    steps: int
    length_m: float
    observed: tuple[tuple[int, Observations], ...]  # index of the resampled drive, its observations


@dataclass(frozen=True, slots=True, eq=False)
class SegmentSet:
    """Observed segments of several lengths."""

    resampled: tuple[ResampledDrive, ...]
    bins: tuple[LengthBin, ...]  # shortest segments first
    values: Floats  # (n, 3) observations, see `driftplan.model.calibration.segments`; bin by bin
    bin_of: Ints  # (n,) which length each belongs to
    drive_of: Ints  # (n,) which drive
    place_m: Floats  # (n,) where each segment begins, all drives laid end to end
    weight: Floats  # (n,) adding up to the number of longest segments that fit side by side, in every bin
    total_m: float  # length of all drives

    @property
    def has_heading(self) -> bool:
        """Whether the truth's headings are used."""
        return self.resampled[0].truth_heading is not None

    @property
    def position(self) -> slice:
        """Which of the observed values are the position error at a segment's end."""
        return slice(0, 2) if self.has_heading else slice(1, 3)

    def windows(self, noise: OdometryNoise) -> dict[int, WindowMoments]:
        """Moments of all segments under a noise, by resampled drive."""
        needed: dict[int, list[int]] = {}
        for length in self.bins:
            for i, _ in length.observed:
                needed.setdefault(i, []).append(length.steps)
        return {i: windows_of(self.resampled[i], noise, steps) for i, steps in needed.items()}

    def expected(self, found: dict[int, WindowMoments], truth: TruthNoise) -> tuple[Floats, Floats]:
        """Mean (n, 3) and covariance (n, 3, 3) of the observations, from what `windows` found."""
        parts = [
            expect(self.resampled[i], seen, found[i], length.steps, truth)
            for length in self.bins
            for i, seen in length.observed
        ]
        return np.concatenate([mean for mean, _ in parts]), np.concatenate([cov for _, cov in parts])

    @property
    def turned_per_longest(self) -> float:
        """Angle turned on the length of the longest segments, rad: heading changes (without headings: changes of
        course) over the shortest ones, so that jitter adds little."""
        steps = self.bins[0].steps
        courses = (
            np.unwrap(np.angle(np.diff(part.truth[::steps])))
            if part.truth_heading is None
            else part.truth_heading[::steps]
            for part in self.resampled
        )
        turned = sum(float(np.abs(np.diff(course)).sum()) for course in courses)
        return turned / self.total_m * self.bins[-1].length_m

    @property
    def counted_over_true(self) -> float:
        """Length of the odometry's chords over that of the true ones, over the shortest segments."""
        steps = self.bins[0].steps
        ways = ((part.estimate[::steps], part.truth[::steps]) for part in self.resampled)
        counted, true = np.sum([[np.abs(np.diff(way)).sum() for way in both] for both in ways], axis=0).tolist()
        return float(counted / max(true, 1e-300))

    def by_bin(self, values: Floats) -> Floats:
        """Averages of values (n, ...) over the segments of every length, (bins, ...)."""
        return np.stack([values[self.bin_of == k].mean(axis=0) for k in range(len(self.bins))])

    def floor(self) -> Floats:
        """Least covariance of the observations of every length, (bins, 3, 3): none is taken for exact."""
        return np.asarray((_FLOOR * self.by_bin(self.values**2) + 1e-24)[:, :, None] * np.eye(3))


def drives_of(estimates: Any, truths: Any) -> list[tuple[OdometryLog, Trajectory]]:
    """The drives meant by recordings or arrays, one or several."""
    several = (_listed(estimates, OdometryLog), _listed(truths, Trajectory))
    if len(several[0]) != len(several[1]) or not several[0]:
        raise ValueError(f"expected one truth per estimate, got {len(several[0])} and {len(several[1])}")
    return [_drive(estimate, truth) for estimate, truth in zip(*several, strict=True)]


def segment_set(
    drives: list[tuple[OdometryLog, Trajectory]],
    *,
    lengths_m: ArrayLike | None = None,
    use_heading: bool | None = None,
    **options: Unpack[MatchOptions],
) -> tuple[SegmentSet, list[MatchedDrive]]:
    """The drives matched, and their segments; parameters as for `driftplan.model.calibration.fit.fit_noise`."""
    drives = _with_or_without_heading([(odometry.without_glitches(), truth) for odometry, truth in drives], use_heading)
    parts = 1 if drives[0][1].heading is not None else 2
    # between samples of the sparsest recording, metres
    sampled = max(float(log.travelled[-1]) / min(len(log.times), len(truth.times)) for log, truth in drives)
    default = lengths_m is None
    lengths = (
        _lengths(drives, parts * _MIN_KNOTS * sampled) if default else np.unique(np.asarray(lengths_m, dtype=float))
    )
    if lengths.size == 0 or not (np.isfinite(lengths).all() and lengths[0] > 0):
        raise ValueError(f"expected lengths_m > 0, got {lengths_m!r}")
    spacing = max(float(lengths[0]) / (_KNOTS * parts), sampled)
    matched = [match(odometry, truth, spacing_m=spacing, **options) for odometry, truth in drives]
    segments = _collect([m.resampled for m in matched], lengths, spacing, parts)
    if segments is None:
        raise ValueError(_why_none(matched, float(lengths[0])))
    if (np.abs(segments.values).max(axis=0) <= _NO_ERROR * np.array([lengths[-1], lengths[-1], 1.0])).all():
        raise ValueError("expected odometry that drifts, got no error at all: are odometry and truth the same file?")
    ratio = segments.counted_over_true
    if not 1 / _MOST_COUNTED < ratio < _MOST_COUNTED:
        raise ValueError(
            f"expected odometry and truth of one drive, got odometry that counts {ratio:.3g} times the true distance: "
            "check units and columns of both"
        )
    return segments, matched


def _why_none(matched: list[MatchedDrive], shortest_m: float) -> str:
    """Why no drive holds a segment of the shortest length."""
    longest = max((float(np.ptp(part.driven)) for m in matched for part in m.resampled), default=0.0)
    if longest < shortest_m:
        driven = max(m.counts.driven_m for m in matched)
        return (
            f"expected uninterrupted drives longer than a segment of {shortest_m:.3g} m, got drives of at most "
            f"{driven:.3g} m, without a gap or jump of at most {longest:.3g} m"
        )
    return (
        f"expected the first half of a segment of {shortest_m:.3g} m to lead somewhere, since a truth without headings "
        "aligns it by its chord, got a robot that comes back on itself before: give shorter lengths_m, or true headings"
    )


def _with_or_without_heading(
    drives: list[tuple[OdometryLog, Trajectory]], use_heading: bool | None
) -> list[tuple[OdometryLog, Trajectory]]:
    with_heading = [truth.heading is not None for _, truth in drives]
    if use_heading and not all(with_heading):
        raise ValueError("expected headings in every truth with use_heading=True, got positions only")
    if use_heading is None:
        use_heading = all(with_heading) and not any(truth_repeats(odometry, truth) for odometry, truth in drives)
    return drives if use_heading else [(odometry, truth.without_heading()) for odometry, truth in drives]


def truth_repeats(odometry: OdometryLog, truth: Trajectory) -> bool:
    """Whether the truth's headings are nothing but the odometry's turns added up: no measurement of their own."""
    inside = (truth.times >= odometry.times[0]) & (truth.times <= odometry.times[-1])
    if truth.heading is None or inside.sum() < 3 or np.abs(odometry.turns).sum() == 0:
        return False
    integrated = np.interp(truth.times[inside], odometry.times, odometry.headings)
    return bool(np.median(np.abs(np.diff(truth.heading[inside] - integrated))) < 1e-9)


def _collect(
    drives: Sequence[Sequence[ResampledDrive]], lengths: Floats, spacing: float, parts: int
) -> SegmentSet | None:
    """Segments of these lengths, in ``parts`` of equal length each, in several drives; None if no drive has any."""
    resampled = tuple(part for drive in drives for part in drive)
    drive_of = [k for k, drive in enumerate(drives) for _ in drive]
    begins = np.concatenate([[0.0], np.cumsum([float(np.ptp(part.driven)) for part in resampled])])
    bins: list[LengthBin] = []
    rows: list[tuple[Floats, Ints, Ints, Floats]] = []
    for length in lengths.tolist():
        steps = max(1, round(length / (parts * spacing)))
        observed = []
        for i, part in enumerate(resampled):
            seen = observe(part, steps, max(1, parts * steps // _STRIDES))
            if seen.starts.size:
                observed.append((i, seen))
                bin_of, drive = (np.full(seen.starts.size, k) for k in (len(bins), drive_of[i]))
                rows.append((seen.values, bin_of, drive, begins[i] + part.driven[seen.starts] - part.driven[0]))
        if observed:
            bins.append(LengthBin(steps, parts * steps * spacing, tuple(observed)))
    if not bins:
        return None
    values, bin_of, drive, place = (np.concatenate(column) for column in zip(*rows, strict=True))
    total = float(begins[-1])
    weight = (total / bins[-1].length_m) / np.bincount(bin_of)[bin_of]
    return SegmentSet(resampled, tuple(bins), values, bin_of, drive, place, weight, total)


def _lengths(drives: list[tuple[OdometryLog, Trajectory]], least: float) -> Floats:
    """Default lengths, metres, increasing: not below ``least``, but at least one."""
    driven = [float(odometry.travelled[-1]) for odometry, _ in drives]
    if min(driven) <= 0:
        raise ValueError("expected drives in which the robot moves, got one without any distance")
    extent = max(float(np.hypot(*np.ptp(truth.xy, axis=0))) for _, truth in drives)
    longest = min(sum(driven) / _LONGEST_SHARE, min(driven) / _LONGEST_IN_ONE, _MAX_EXTENTS * max(extent, least))
    lengths = longest / 2.0 ** np.arange(_LENGTHS)[::-1]
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
