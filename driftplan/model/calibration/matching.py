"""Odometry beside truth: the two recordings associated by time, cleaned, and cut into stretches of equal steps.

A `Stretch` is what calibration works on: knots at about equal true distances along the drive, with the dead-reckoned
and the true pose at each. True distance is the odometry's, corrected piece by piece by the truth's chords: jitter of
the truth then does not lengthen the way, and where a segment ends does not depend on the errors that are to be measured
(a segment that ends when the *odometry* has counted 10 m hides its distance error in its length, and one that counts a
wrong turn for a longer one gets less weight). Turns are the true heading's likewise; where that is not measured, the
odometry's, put right by the angle between its chords and the true ones. The angle turned either way is counted with a
play as wide as the heading's jitter, because absolute values of jitter add up.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Complexes, Floats
from driftplan.model.calibration import reference_offsets
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.model.calibration.reference_offsets import clock_offset, interpolated

_JUMP_SPREADS = (
    10.0  # a truth sample is an outlier if it is farther from the last good one than the odometry's distance
)
_JUMP_S = 0.25  # from so many seconds before to after, plus so many robust standard deviations of one step
_PLAY_TRUE = 5.0  # standard deviations of the true heading's jitter within which it may swing without having turned,
_PLAY_SAID = 10.0  # and of the odometry's, where the true one is not known: its errors wander
_MOUNTING_KNOTS = 8  # from one to the next when the mounting of the reference is estimated
_RULER_KNOTS = 4  # knots per piece on which the true distance is measured
_SKIP = 10  # so many outliers in a row are no outliers: the truth has jumped, and the drive is cut there


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchCounts:
    """What became of the recordings when they were matched. Counts and durations of several drives add up.

    Attributes
    ----------
    odometry_samples, truth_samples : int
    repeated_samples : int
        With a time not later than the one before; left out (motion of odometry increments is kept).
    truth_outliers : int
        Truth samples farther from their neighbours than the robot can have moved; left out.
    odometry_outliers : int
        Steps of the odometry that no robot makes (`OdometryLog.without_glitches`); left out, and the drive cut there.
    breaks : int
        Places where a gap, a jump of the truth or an outlier of the odometry cut a drive in two. The truth's gaps count
        where the robot moved, the odometry's where it reports velocities.
    outside_truth_s, standstill_s : float
        Seconds of odometry before the first or after the last truth sample; seconds in which the robot stood
        (`OdometryLog.standing`), whose jitter is no distance.
    driven_m, used_m, turned_rad : float
        Distance by the odometry; true distance on usable stretches, and angle turned there (absolute values added up).
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


class Stretch(NamedTuple):
    """One uninterrupted part of a drive, at K knots of about equal spacing.

    Attributes
    ----------
    driven : array, shape (K,)
        True distance from the start of the drive, metres, increasing.
    estimate, estimate_heading : arrays, shape (K,)
        Dead-reckoned position x + jy (m) and heading (rad, not wrapped), in the odometry's frame.
    truth : complex array, shape (K,)
    truth_heading : array, shape (K,), or None
    turns, angles : arrays, shape (K - 1,)
        True heading change between knots, signed, and the angle truly turned in either direction, rad. Without true
        headings: as far as positions tell.
    """

    driven: Floats
    estimate: Complexes
    estimate_heading: Floats
    truth: Complexes
    truth_heading: Floats | None
    turns: Floats
    angles: Floats


class Match(NamedTuple):
    """Stretches of one drive, what was left out, and the offsets of clock (truth time minus odometry time, s) and
    heading (measured true one minus the robot's, rad), both undone in the stretches."""

    stretches: tuple[Stretch, ...]
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
) -> Match:
    """Odometry and truth of one drive at common knots.

    Parameters
    ----------
    odometry, truth :
        Of one drive, recorded at their own times.
    spacing_m : float
        Distance between knots.
    time_offset_s : float, optional
        Time of the truth's clock minus the odometry's when both see the same event. By default it is estimated, up to
        1 s: the offset at which the motions agree best, and 0 unless that makes their difference clearly smaller.
    heading_offset : float, optional
        Measured true heading minus the robot's, rad: how the marker or sensor is mounted. By default it is estimated,
        and 0 unless clearly another.
    max_gap_s : float, optional
        Truth samples farther apart in time, between which the robot moved, cut the drive; so do gaps in odometry
        velocities. Default: 2 s or five median intervals, whichever is longer.

    Returns
    -------
    Match

    Raises
    ------
    ValueError
        When the recordings do not overlap in time, or the robot did not move.
    """
    odometry = odometry.without_glitches()
    if time_offset_s is None:
        time_offset_s = clock_offset(odometry, truth)
    times = truth.times - time_offset_s  # on the odometry's clock
    good, cuts = _good_samples(odometry, truth, times)
    times, positions = times[good], truth.positions[good]
    headings = None if truth.heading is None else truth.heading[good]

    standing = odometry.standing
    travelled = np.concatenate([[0.0], np.cumsum(np.where(standing, 0.0, np.abs(odometry.moves)))])
    first, last = max(times[0], odometry.times[0]), min(times[-1], odometry.times[-1])
    if not last > first:
        raise ValueError(
            f"expected odometry and truth to overlap in time, got odometry from {odometry.times[0]:.3f} to "
            f"{odometry.times[-1]:.3f} s and truth from {times[0]:.3f} to {times[-1]:.3f} s"
        )
    if max_gap_s is None:
        max_gap_s = max(2.0, 5 * float(np.median(np.diff(times))))
    gaps = _moving_gaps(times, odometry, travelled, max_gap_s, spacing_m)
    if odometry.holds_velocity:
        gaps += _moving_gaps(
            odometry.times,
            odometry,
            travelled,
            max(max_gap_s, 5 * float(np.median(np.diff(odometry.times)))),
            spacing_m,
        )
    gaps += [(times[k], times[k + 1]) for k in cuts]
    k = np.searchsorted(odometry.times, odometry.glitches)
    gaps += list(zip(odometry.times[k].tolist(), odometry.times[k + 1].tolist(), strict=True))
    pieces = _without(first, last, gaps)

    stretches = []
    driven = _true_distance(odometry, travelled, times, positions, _RULER_KNOTS * spacing_m)
    if headings is None:
        turning = _turning_of_course(odometry, driven, times, positions, spacing_m)
    else:
        turning = _measured_turning(odometry, times, headings)
    for begin, end in pieces:
        stretch = _stretch(odometry, driven, turning, begin, end, times, positions, headings, spacing_m)
        if stretch is not None:
            stretches.append(stretch)
    if heading_offset is None:
        heading_offset = _mounting(stretches)
    if heading_offset != 0:
        stretches = [_turned_by(s, -heading_offset) for s in stretches]
    counts = MatchCounts(
        odometry_samples=len(odometry.times) + odometry.repeated,
        truth_samples=len(truth.times) + truth.repeated,
        repeated_samples=odometry.repeated + truth.repeated,
        truth_outliers=len(truth.times) - len(times),
        odometry_outliers=len(odometry.glitches),
        breaks=len(pieces) - 1,
        outside_truth_s=float(max(first - odometry.times[0], 0.0) + max(odometry.times[-1] - last, 0.0)),
        standstill_s=float(np.diff(odometry.times)[standing].sum()),
        driven_m=float(odometry.travelled[-1]),
        used_m=float(sum(np.ptp(s.driven) for s in stretches)),
        turned_rad=float(sum(s.angles.sum() for s in stretches)),
    )
    return Match(tuple(stretches), counts, float(time_offset_s), float(heading_offset))


def _mounting(stretches: list[Stretch]) -> float:
    """By how much true headings as measured are turned against the robot's."""
    said, was, gained = [], [], []
    for stretch in stretches:
        if stretch.truth_heading is None:
            return 0.0
        at = np.arange(0, len(stretch.driven), _MOUNTING_KNOTS)
        said.append(np.diff(stretch.estimate[at]) * np.exp(-1j * stretch.estimate_heading[at[:-1]]))
        was.append(np.diff(stretch.truth[at]) * np.exp(-1j * stretch.truth_heading[at[:-1]]))
        gained.append(np.diff(stretch.estimate_heading[at] - stretch.truth_heading[at]))
    if not stretches:
        return 0.0
    return reference_offsets.heading_offset(np.concatenate(said), np.concatenate(gained), np.concatenate(was))


def _turned_by(stretch: Stretch, angle: float) -> Stretch:
    headings = stretch.truth_heading
    return stretch if headings is None else stretch._replace(truth_heading=headings + angle)


def _true_distance(
    odometry: OdometryLog, travelled: Floats, times: Floats, positions: Complexes, ruler_m: float
) -> Floats:
    """True metres driven up to every odometry sample: the odometry's arcs, each piece of about ``ruler_m`` scaled by
    the ratio of the true chord to the odometry's."""
    pieces = max(int(travelled[-1] / ruler_m), 1)
    marks = np.unique(np.searchsorted(travelled, np.linspace(0, travelled[-1], pieces + 1)))
    said = np.abs(np.diff(odometry.positions[marks]))
    was = np.abs(np.diff(interpolated(odometry.times[marks], times, positions)))
    arc = np.diff(travelled[marks])
    seen = (odometry.times[marks[:-1]] >= times[0]) & (odometry.times[marks[1:]] <= times[-1])
    true_arc = np.where(seen, arc * _ratio(was, said, arc), arc)
    return np.asarray(np.interp(travelled, travelled[marks], np.concatenate([[0.0], np.cumsum(true_arc)])))


def _stretch(
    odometry: OdometryLog,
    driven: Floats,
    turning: _Turning,
    begin: float,
    end: float,
    times: Floats,
    positions: Complexes,
    headings: Floats | None,
    spacing_m: float,
) -> Stretch | None:
    """Knots are samples of the recording with the fewer of them: interpolated ones would have smaller errors."""
    sparser = times if np.median(np.diff(times)) > np.median(np.diff(odometry.times)) else odometry.times
    candidates = sparser[(sparser >= begin) & (sparser <= end)]
    if candidates.size < 2:
        return None
    distances = np.interp(candidates, odometry.times, driven)
    wanted = np.arange(distances[0], distances[-1], spacing_m)
    nearest = np.searchsorted(0.5 * (distances[1:] + distances[:-1]), wanted)
    at = candidates[np.unique(nearest)]
    distances = np.interp(at, odometry.times, driven)
    apart = np.concatenate([[True], np.diff(distances) > 0])
    at, distances = at[apart], distances[apart]
    if at.size < 2:
        return None
    return Stretch(
        distances,
        interpolated(at, odometry.times, odometry.positions),
        np.interp(at, odometry.times, odometry.headings),
        interpolated(at, times, positions),
        None if headings is None else np.interp(at, times, headings),
        np.diff(np.interp(at, turning.times, turning.heading)),
        np.diff(np.interp(at, turning.times, turning.turned)),
    )


class _Turning(NamedTuple):
    """The true heading (rad, but for a constant), and the angle turned in either direction until then, at times."""

    times: Floats
    heading: Floats
    turned: Floats


def _measured_turning(odometry: OdometryLog, times: Floats, headings: Floats) -> _Turning:
    jitter = _spread(np.diff(headings - np.interp(times, odometry.times, odometry.headings))) / sqrt(2)
    return _Turning(times, headings, _turned(headings, _PLAY_TRUE * jitter))


def _turning_of_course(
    odometry: OdometryLog, driven: Floats, times: Floats, positions: Complexes, spacing_m: float
) -> _Turning:
    """The odometry's heading and what is wrong with it: the angle from its chords to the true ones, whatever way the
    robot drives along them."""
    marks = np.unique(np.searchsorted(driven, np.arange(driven[0], driven[-1], spacing_m)))
    seen = (odometry.times[marks] >= times[0]) & (odometry.times[marks] <= times[-1])
    marks = marks[seen] if seen.any() else marks[:1]
    half = _RULER_KNOTS // 2
    k = np.arange(len(marks))
    low, high = marks[np.maximum(k - half, 0)], marks[np.minimum(k + half, len(marks) - 1)]
    said = odometry.positions[high] - odometry.positions[low]
    was = interpolated(odometry.times[high], times, positions) - interpolated(odometry.times[low], times, positions)
    telling = np.minimum(np.abs(said), np.abs(was)) > 0.5 * (driven[high] - driven[low])
    if not telling.any():
        wrong, jitter = np.zeros(len(odometry.times)), 0.0
    else:
        angle = np.unwrap(np.angle(was[telling] * np.conj(said[telling])))
        wrong = np.interp(odometry.times, odometry.times[marks[telling]], angle)
        jitter = _spread(np.diff(angle, n=2)) / sqrt(6)
    heading = odometry.headings + wrong
    own = _spread(np.diff(odometry.headings, n=2)) / sqrt(6)
    return _Turning(odometry.times, heading, _turned(heading, max(_PLAY_SAID * own, _PLAY_TRUE * jitter)))


def _turned(headings: Floats, play_rad: float) -> Floats:
    """Sum of the heading's changes either way up to every sample, as a pointer dragged with a play shows them."""
    half = 0.5 * play_rad
    pointer, total = float(headings[0]), 0.0
    turned = np.empty(len(headings))
    for k, heading in enumerate(headings.tolist()):
        pull = max(heading - half - pointer, 0.0) + min(heading + half - pointer, 0.0)
        pointer += pull
        total += abs(pull)
        turned[k] = total
    return turned


def _spread(values: Floats) -> float:
    """Standard deviation, by the median of the absolute values."""
    return 1.4826 * float(np.median(np.abs(values))) if values.size else 0.0


def _ratio(was: Floats, said: Floats, counted: Floats) -> Floats:
    """By how much to correct what the odometry counted on a piece, a sum of absolute values: true over said net change,
    at most a factor of two, and 1 where the net change is less than half the count, so that its ratio says little."""
    telling = np.abs(said) > 0.5 * counted
    ratio = np.where(telling, np.abs(was) / np.where(telling, np.abs(said), 1.0), 1.0)
    return np.asarray(np.clip(ratio, 0.5, 2.0))


def _good_samples(odometry: OdometryLog, truth: Trajectory, times: Floats) -> tuple[NDArray[np.intp], list[int]]:
    """Truth samples that are no outliers, and after which of them the truth jumps for good."""
    positions = truth.positions
    travelled = odometry.travelled
    around = max(_JUMP_S, 2 * float(np.median(np.diff(odometry.times))))
    before, at, after = (np.interp(times + shift, odometry.times, travelled) for shift in (-around, 0.0, around))
    steps = np.abs(np.diff(positions))
    spread = _spread(steps - np.diff(at))
    allowance = _JUMP_SPREADS * spread + 1e-6 * float(np.ptp(travelled))
    outside = (times < odometry.times[0]) | (times > odometry.times[-1])  # how far the robot moved there is unknown
    suspect = np.flatnonzero((steps > after[1:] - before[:-1] + allowance) & ~(outside[1:] | outside[:-1]))
    keep = np.ones(len(times), dtype=bool)
    jumps: list[int] = []
    done = -1
    for k in suspect.tolist():
        if k < done:
            continue
        for far in range(k + 1, min(k + 1 + _SKIP, len(times))):
            if abs(positions[far] - positions[k]) <= after[far] - before[k] + allowance:
                keep[k + 1 : far] = False
                done = far
                break
        else:
            jumps.append(k)
            done = k + 1
    good = np.flatnonzero(keep)
    return good, np.searchsorted(good, jumps).tolist()


def _moving_gaps(
    times: Floats, odometry: OdometryLog, travelled: Floats, max_gap_s: float, spacing_m: float
) -> list[tuple[float, float]]:
    """Intervals longer than ``max_gap_s`` in which the robot moved more than a knot's spacing."""
    wide = np.flatnonzero(np.diff(times) > max_gap_s)
    moved = np.diff(np.interp(np.stack([times[wide], times[wide + 1]]), odometry.times, travelled), axis=0)[0]
    return [(float(times[k]), float(times[k + 1])) for k in wide[moved > spacing_m]]


def _without(first: float, last: float, gaps: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The interval without the gaps."""
    pieces, begin = [], first
    for low, high in sorted(gaps):
        if high <= begin:
            continue
        if low >= last:
            break
        if low > begin:
            pieces.append((begin, low))
        begin = max(begin, high)
    if begin < last:
        pieces.append((begin, last))
    return pieces
