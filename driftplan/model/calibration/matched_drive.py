"""Odometry beside truth: the two recordings associated by time, cleaned, cut where they cannot be followed, and brought
to common knots; and what lies between them for good: their clocks, and how the reference's heading is mounted."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import NamedTuple, TypedDict

import numpy as np

from driftplan.arrays import Array, Bools, Complexes, Floats, number
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.model.calibration.resampling import ResampledDrive, along_travel, resample, robust_std, true_motion

_MOST_OFFSET_S = 1.0
_OFFSETS = 20  # clock offsets tried to either side
_CLEARLY = 0.95  # an offset must reduce the disagreement of the recordings to this share
_CLEARLY_TURNED = 4.0  # standard errors that a heading offset must have,
_LEAST_RAD = 1e-6  # and more than rounding
# a truth sample is an outlier if it is farther from the last good one than the odometry's distance
_JUMP_SPREADS = 10.0
_JUMP_S = 0.25  # from so many seconds before to after, plus so many robust standard deviations of one step
_MOUNTING_KNOTS = 8  # from one to the next when the mounting of the reference is estimated
_MAX_OUTLIERS = 10  # so many in a row are no outliers: the truth has jumped, and the drive is cut there
_GAP_S = 2.0  # a gap in the truth, and
_GAP_INTERVALS = 5  # this many median intervals, whichever is longer


class MatchOptions(TypedDict, total=False):
    """What `match` can be told of two recordings; see there."""

    time_offset_s: float | None
    heading_offset: float | None
    max_gap_s: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchCounts:
    """What became of the recordings when they were matched. Counts and durations of several drives add up.

    Attributes
    ----------
    odometry_samples, truth_samples : int
    repeated_samples : with a time not later than the one before; left out (motion of odometry increments is kept)
    truth_outliers : truth samples farther from their neighbours than the robot can have moved; left out
    odometry_outliers : steps that no robot makes (`OdometryLog.without_glitches`); left out, and the drive cut there
    breaks : places where a gap, a jump of the truth or an outlier of the odometry cut a drive in two. The truth's gaps
        count where the robot moved, the odometry's where it reports velocities.
    outside_truth_s, standstill_s : seconds of odometry before the first or after the last truth sample; seconds in
        which the robot stood (`OdometryLog.standing`), whose jitter is no distance
    driven_m, used_m, turned_rad : distance by the odometry; true distance and angle turned either way on usable parts
    """

    odometry_samples: int = 0
    truth_samples: int = 0
    repeated_samples: int = 0
    truth_outliers: int = 0
    odometry_outliers: int = 0
    breaks: int = 0
    outside_truth_s: float = 0.0
    standstill_s: float = 0.0
    driven_m: float = 0.0
    used_m: float = 0.0
    turned_rad: float = 0.0

    def __add__(self, other: MatchCounts) -> MatchCounts:
        return MatchCounts(**{f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)})


class MatchedDrive(NamedTuple):
    """The uninterrupted parts of one drive, what was left out, and the offsets of clock (truth time minus odometry
    time, s) and heading (measured true one minus the robot's, rad), both undone in the parts."""

    resampled: tuple[ResampledDrive, ...]
    counts: MatchCounts
    time_offset_s: float
    heading_offset: float


def match(
    odometry: OdometryLog,
    truth: Trajectory,
    *,
    spacing_m: float,
    time_offset_s: float | None = None,
    heading_offset: float | None = None,
    max_gap_s: float | None = None,
) -> MatchedDrive:
    """Odometry and truth of one drive at common knots.

    Parameters
    ----------
    odometry, truth : of one drive, recorded at their own times
    spacing_m : distance between knots
    time_offset_s : time of the truth's clock minus the odometry's when both see the same event. By default it is
        estimated, up to 1 s: where the motions agree best, and 0 unless their difference is clearly smaller there.
    heading_offset : measured true heading minus the robot's, rad: how the marker is mounted. Default: estimated, or 0.
    max_gap_s : truth samples farther apart in time, between which the robot moved, cut the drive; so do gaps in
        odometry velocities. Default: 2 s or five median intervals, whichever is longer.

    Raises ValueError when the recordings do not overlap in time.
    """
    odometry = odometry.without_glitches()
    time_offset_s = _clock_offset(odometry, truth) if time_offset_s is None else number("time_offset_s", time_offset_s)
    clocked = replace(truth, times=truth.times - time_offset_s)
    good, jumps = _good_samples(odometry, clocked)
    cleaned = clocked.chosen(good)
    first, last = max(cleaned.times[0], odometry.times[0]), min(cleaned.times[-1], odometry.times[-1])
    if not last > first:
        raise ValueError(
            f"expected odometry and truth to overlap in time, got odometry from {odometry.times[0]:.3f} to "
            f"{odometry.times[-1]:.3f} s and truth from {cleaned.times[0]:.3f} to {cleaned.times[-1]:.3f} s"
        )
    standing = odometry.standing
    travelled = np.concatenate([[0.0], np.cumsum(np.where(standing, 0.0, np.abs(odometry.moves)))])
    wild = np.searchsorted(odometry.times, odometry.glitches)
    glitches = zip(odometry.times[wild].tolist(), odometry.times[wild + 1].tolist(), strict=True)
    gaps = [*jumps, *glitches, *_gaps(odometry, cleaned, travelled, max_gap_s, spacing_m)]
    pieces = _without(first, last, gaps)
    motion = true_motion(odometry, cleaned, travelled, spacing_m)
    found = (resample(odometry, cleaned, motion, begin, end, spacing_m) for begin, end in pieces)
    resampled = along_travel([part for part in found if part is not None])
    heading_offset = _mounting(resampled) if heading_offset is None else number("heading_offset", heading_offset)
    counts = MatchCounts(
        odometry_samples=len(odometry.times) + odometry.repeated,
        truth_samples=len(truth.times) + truth.repeated,
        repeated_samples=odometry.repeated + truth.repeated,
        truth_outliers=len(truth.times) - len(cleaned.times),
        odometry_outliers=len(odometry.glitches),
        breaks=len(pieces) - 1,
        outside_truth_s=float(max(first - odometry.times[0], 0.0) + max(odometry.times[-1] - last, 0.0)),
        standstill_s=float(np.diff(odometry.times)[standing].sum()),
        driven_m=float(odometry.travelled[-1]),
        used_m=float(sum(np.ptp(part.driven) for part in resampled)),
        turned_rad=float(sum(part.angles.sum() for part in resampled)),
    )
    turned_back = tuple(
        part if part.truth_heading is None else part._replace(truth_heading=part.truth_heading - heading_offset)
        for part in resampled
    )
    return MatchedDrive(turned_back, counts, float(time_offset_s), float(heading_offset))


def _mounting(resampled: list[ResampledDrive]) -> float:
    """By how much true headings as measured are turned against the robot's, rad.

    A marker or sensor that is mounted askew turns every measured heading by the same angle, and so all true
    displacements in the measured frame, long and short, whereas errors of odometry grow with length. The heading error
    gained over a short segment is seen from half of it, and undone. 0 unless four standard errors away.
    """
    products: list[Complexes] = [np.zeros(0, complex)]
    for part in resampled:
        if part.truth_heading is None:
            return 0.0
        at = np.arange(0, len(part.driven), _MOUNTING_KNOTS)
        estimate = np.diff(part.estimate[at]) * np.exp(-1j * part.estimate_heading[at[:-1]])
        true = np.diff(part.truth[at]) * np.exp(-1j * part.truth_heading[at[:-1]])
        gained = np.diff(part.estimate_heading[at] - part.truth_heading[at])
        products.append(np.conj(estimate * np.exp(-0.5j * gained)) * true)
    product = np.concatenate(products)
    mean = product.sum()
    if mean == 0:
        return 0.0
    angle = -float(np.angle(mean))
    error = float(np.sqrt(np.sum((product * np.exp(1j * angle)).imag ** 2)) / np.abs(mean))
    return angle if abs(angle) > max(_CLEARLY_TURNED * error, _LEAST_RAD) else 0.0


def _clock_offset(odometry: OdometryLog, truth: Trajectory) -> float:
    """Truth clock minus odometry clock, s: where turns (without headings: distances) over short windows agree best. 0
    unless their mean difference falls by a twentieth: a slow or steady drive says nothing about clocks."""
    window = max(0.5, 2 * float(np.median(np.diff(truth.times))), 2 * float(np.median(np.diff(odometry.times))))
    first = max(odometry.times[0], truth.times[0]) + _MOST_OFFSET_S
    last = min(odometry.times[-1], truth.times[-1]) - _MOST_OFFSET_S
    if last - first < 20 * window:
        return 0.0
    at = np.linspace(first, last, min(int((last - first) / (0.5 * window)), 4000))
    at = at[at + window <= last]
    recorded: tuple[Array, Array] = (odometry.positions, truth.positions)
    if truth.heading is not None:
        recorded = odometry.headings, truth.heading

    def gained(begin: Floats, times: Floats, values: Array) -> Floats:
        change = np.interp(begin + window, times, values) - np.interp(begin, times, values)
        return np.asarray(np.abs(change) if np.iscomplexobj(change) else change)

    reported = gained(at, odometry.times, recorded[0])

    def disagreement(offset: float) -> float:
        difference = reported - gained(at + offset, truth.times, recorded[1])
        return float(np.mean(np.abs(difference - np.median(difference))))

    unshifted = disagreement(0.0)
    best, step = 0.0, _MOST_OFFSET_S / _OFFSETS
    for _ in range(2):  # a coarse search, then a fine one around its best
        offsets = best + step * np.arange(-_OFFSETS, _OFFSETS + 1)
        values = [disagreement(float(offset)) for offset in offsets]
        best, least, step = float(offsets[int(np.argmin(values))]), min(values), step / _OFFSETS
    telling = least <= _CLEARLY * unshifted and unshifted >= 1e-9 * float(np.ptp(reported))
    return best if telling and abs(best) <= (1 - 1 / _OFFSETS) * _MOST_OFFSET_S else 0.0


def _good_samples(odometry: OdometryLog, truth: Trajectory) -> tuple[Bools, list[tuple[float, float]]]:
    """Which truth samples are no outliers, and from when to when the truth jumps for good."""
    times, positions, travelled = truth.times, truth.positions, odometry.travelled
    around = max(_JUMP_S, 2 * float(np.median(np.diff(odometry.times))))
    before, at, after = (np.interp(times + shift, odometry.times, travelled) for shift in (-around, 0.0, around))
    steps = np.abs(np.diff(positions))
    allowance = _JUMP_SPREADS * robust_std(steps - np.diff(at)) + 1e-6 * float(np.ptp(travelled))
    outside = (times < odometry.times[0]) | (times > odometry.times[-1])  # how far the robot moved there is unknown
    suspect = np.flatnonzero((steps > after[1:] - before[:-1] + allowance) & ~(outside[1:] | outside[:-1]))
    good = np.ones(len(times), dtype=bool)
    jumps: list[int] = []
    done = -1
    for k in suspect.tolist():
        if k < done:
            continue
        for far in range(k + 1, min(k + 1 + _MAX_OUTLIERS, len(times))):
            if abs(positions[far] - positions[k]) <= after[far] - before[k] + allowance:
                good[k + 1 : far] = False
                done = far
                break
        else:
            jumps.append(k)
            done = k + 1
    kept = np.flatnonzero(good)
    ends = [(kept[kept <= k][-1], kept[kept > k][0]) for k in jumps]
    return good, [(float(times[low]), float(times[high])) for low, high in ends]


def _gaps(
    odometry: OdometryLog, truth: Trajectory, travelled: Floats, max_gap_s: float | None, spacing_m: float
) -> list[tuple[float, float]]:
    """Intervals without a sample in which the robot moved on by a knot: of the truth, and of integrated velocities."""
    if max_gap_s is None:
        max_gap_s = max(_GAP_S, _GAP_INTERVALS * float(np.median(np.diff(truth.times))))
    limits = [(truth.times, max_gap_s)]
    if odometry.holds_velocity:
        limits.append((odometry.times, max(max_gap_s, _GAP_INTERVALS * float(np.median(np.diff(odometry.times))))))
    found: list[tuple[float, float]] = []
    for times, limit in limits:
        wide = np.flatnonzero(np.diff(times) > limit)
        moved = np.diff(np.interp(np.stack([times[wide], times[wide + 1]]), odometry.times, travelled), axis=0)[0]
        found += [(float(times[k]), float(times[k + 1])) for k in wide[moved > spacing_m]]
    return found


def _without(first: float, last: float, gaps: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The interval without the gaps."""
    pieces, begin = [], first
    for low, high in [*sorted(gaps), (last, last)]:
        if begin < min(low, last):
            pieces.append((begin, min(low, last)))
        begin = max(begin, high)
    return pieces
