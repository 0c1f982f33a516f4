"""A drive at knots of about equal true distance: what calibration works on.

True distance is the odometry's, corrected piece by piece by the truth's chords: jitter of the truth then does not
lengthen the way, and where a segment ends does not depend on the errors that are to be measured (a segment that ends
when the *odometry* has counted 10 m hides its distance error in its length, and one that counts a wrong turn for a
longer one gets less weight). Turns are the true heading's likewise; where that is not measured, the odometry's, put
right by the angle between its chords and the true ones. The angle turned either way is counted with a play as wide as
the heading's jitter, because absolute values of jitter add up.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Complexes, Floats
from driftplan.model.calibration.recordings import OdometryLog, Trajectory

_PLAY_TRUE = 5.0  # standard deviations of the true heading's jitter within which it may swing without having turned,
_PLAY_ODOMETRY = 10.0  # and of the odometry's, where the true one is not known: its errors wander
_KEEPS_COURSE = 0.8  # mean cosine of twice the angle between heading and travel, from which on they go together
_RULER_KNOTS = 4  # knots per piece on which the true distance is measured


class ResampledDrive(NamedTuple):
    """One uninterrupted part of a drive, at K knots of about equal spacing.

    Axes are exp(2jθ) of the direction θ in which the robot drives, integrated: along which axis errors of distance lie.
    A robot that turns on the spot counts a distance in all directions that it sweeps, not along the next chord.
    """

    driven: Floats  # (K,), true distance from the start of the drive, metres, increasing
    estimate: Complexes  # (K,), dead-reckoned position x + jy, metres, in the odometry's frame
    estimate_heading: Floats  # (K,), likewise, rad, not wrapped
    truth: Complexes  # (K,)
    truth_heading: Floats | None  # (K,)
    turns: Floats  # (K - 1,), true heading change between knots, signed, rad; without headings as far as positions tell
    angles: Floats  # (K - 1,), the angle truly turned in either direction, likewise
    travel_axes: Complexes  # (K - 1,), integrated over the metres between knots
    turn_axes: Complexes  # (K - 1,), and over the angles turned


class TrueMotion(NamedTuple):
    """True metres driven until every odometry sample; at ``times`` the true heading (rad, but for a constant), the
    angle turned in either direction until then, and the integrals of exp(2jθ) over metres and angles."""

    driven: Floats
    times: Floats
    heading: Floats
    turned: Floats
    travel_axes: Complexes
    turn_axes: Complexes


def true_motion(odometry: OdometryLog, truth: Trajectory, travelled: Floats, spacing_m: float) -> TrueMotion:
    """How the robot moved, for knots ``spacing_m`` apart; ``travelled``: the odometry's metres without standstill."""
    driven = _true_distance(odometry, truth, travelled, _RULER_KNOTS * spacing_m)
    if truth.heading is None:
        times, heading, play = _turning_by_chords(odometry, truth, driven, spacing_m)
    else:
        times, heading = truth.times, truth.heading
        jitter = robust_std(np.diff(heading - np.interp(times, odometry.times, odometry.headings))) / sqrt(2)
        play = _PLAY_TRUE * jitter
    turned = angle_turned(heading, play)
    sweep = np.diff(heading)
    axis = np.exp(1j * (heading[1:] + heading[:-1])) * np.sinc(sweep / np.pi)  # the mean of exp(2jθ) over the sweep
    integrals = (
        np.concatenate([[0.0], np.cumsum(axis * np.diff(along))])
        for along in (np.interp(times, odometry.times, driven), turned)
    )
    return TrueMotion(driven, times, heading, turned, *integrals)


def resample(
    odometry: OdometryLog, truth: Trajectory, motion: TrueMotion, begin_s: float, end_s: float, spacing_m: float
) -> ResampledDrive | None:
    """The drive from ``begin_s`` to ``end_s`` at knots; None if there are fewer than two. Knots are samples of the
    recording with the fewer of them: interpolated ones would have smaller errors."""
    sparser = max(odometry.times, truth.times, key=lambda times: float(np.median(np.diff(times))))
    candidates = sparser[(sparser >= begin_s) & (sparser <= end_s)]
    distances = np.interp(candidates, odometry.times, motion.driven)
    if candidates.size < 2 or distances[-1] <= distances[0]:
        return None
    wanted = np.arange(distances[0], distances[-1], spacing_m)
    chosen = np.unique(np.searchsorted(0.5 * (distances[1:] + distances[:-1]), wanted))
    chosen = chosen[np.concatenate([[True], np.diff(distances[chosen]) > 0])]
    if chosen.size < 2:
        return None
    at = candidates[chosen]
    return ResampledDrive(
        distances[chosen],
        np.interp(at, odometry.times, odometry.positions),
        np.interp(at, odometry.times, odometry.headings),
        np.interp(at, truth.times, truth.positions),
        None if truth.heading is None else np.interp(at, truth.times, truth.heading),
        np.diff(np.interp(at, motion.times, motion.heading)),
        np.diff(np.interp(at, motion.times, motion.turned)),
        np.diff(np.interp(at, motion.times, motion.travel_axes)),
        np.diff(np.interp(at, motion.times, motion.turn_axes)),
    )


def along_travel(parts: list[ResampledDrive]) -> list[ResampledDrive]:
    """The parts of one drive with axes as their chords show them: turned by the angle between heading and travel, where
    the robot keeps one; where it does not (a drone), errors of the distance lie along the chords."""
    if not parts:
        return parts
    chords = [np.diff(part.truth) for part in parts]
    axes = [chord**2 / np.maximum(np.abs(chord), 1e-12) for chord in chords]  # as long as the chords
    cosines = (np.sum(axis * np.conj(p.travel_axes) / np.diff(p.driven)) for axis, p in zip(axes, parts, strict=True))
    agreement = complex(sum(cosines)) / max(float(sum(np.abs(axis).sum() for axis in axes)), 1e-300)
    if abs(agreement) < _KEEPS_COURSE:
        return [
            part._replace(travel_axes=np.diff(part.driven) * axis / np.maximum(np.abs(axis), 1e-12))
            for part, axis in zip(parts, axes, strict=True)
        ]
    turn = agreement / abs(agreement)
    return [part._replace(travel_axes=part.travel_axes * turn, turn_axes=part.turn_axes * turn) for part in parts]


def laid_on_truth(part: ResampledDrive) -> tuple[Complexes, Complexes]:
    """True and estimated positions, the latter turned and moved to begin like the truth: an eighth tells how."""
    k = max(len(part.driven) // 8, 1)
    estimated, true = part.estimate - part.estimate[0], part.truth - part.truth[0]
    turn = np.vdot(estimated[: k + 1], true[: k + 1])
    return part.truth, part.truth[0] + estimated * (turn / abs(turn) if turn else 1.0)


def robust_std(values: Floats) -> float:
    """Standard deviation, by the median of the absolute values."""
    return 1.4826 * float(np.median(np.abs(values))) if values.size else 0.0


def _true_distance(odometry: OdometryLog, truth: Trajectory, travelled: Floats, ruler_m: float) -> Floats:
    """The odometry's arcs, each piece of about ``ruler_m`` scaled by the ratio of the true chord to the odometry's: at
    most a factor of two, and not where the chord is less than half the arc, so that its ratio says little."""
    pieces = max(int(travelled[-1] / ruler_m), 1)
    marks = np.unique(np.searchsorted(travelled, np.linspace(0, travelled[-1], pieces + 1)))
    times = odometry.times[marks]
    counted = np.abs(np.diff(odometry.positions[marks]))
    true = np.abs(np.diff(np.interp(times, truth.times, truth.positions)))
    arc = np.diff(travelled[marks])
    seen = (times[:-1] >= truth.times[0]) & (times[1:] <= truth.times[-1]) & (counted > 0.5 * arc)
    ratio = np.clip(np.divide(true, counted, out=np.ones_like(true), where=seen), 0.5, 2.0)
    return np.asarray(np.interp(travelled, travelled[marks], np.concatenate([[0.0], np.cumsum(arc * ratio)])))


def _turning_by_chords(
    odometry: OdometryLog, truth: Trajectory, driven: Floats, spacing_m: float
) -> tuple[Floats, Floats, float]:
    """Times, heading and its play: the odometry's heading, put right by the angle from its chords to the true ones."""
    marks = np.unique(np.searchsorted(driven, np.arange(driven[0], driven[-1], spacing_m)))
    seen = (odometry.times[marks] >= truth.times[0]) & (odometry.times[marks] <= truth.times[-1])
    marks = marks[seen] if seen.any() else marks[:1]
    half = _RULER_KNOTS // 2
    k = np.arange(len(marks))
    low, high = marks[np.maximum(k - half, 0)], marks[np.minimum(k + half, len(marks) - 1)]
    estimated = odometry.positions[high] - odometry.positions[low]
    at_low, at_high = (np.interp(odometry.times[at], truth.times, truth.positions) for at in (low, high))
    true = at_high - at_low
    telling = np.minimum(np.abs(estimated), np.abs(true)) > 0.5 * (driven[high] - driven[low])
    wrong, jitter = np.zeros(len(odometry.times)), 0.0
    if telling.any():
        angle = np.unwrap(np.angle(true[telling] * np.conj(estimated[telling])))
        wrong = np.interp(odometry.times, odometry.times[marks[telling]], angle)
        jitter = robust_std(np.diff(angle, n=2)) / sqrt(6)
    own = robust_std(np.diff(odometry.headings, n=2)) / sqrt(6)
    return odometry.times, odometry.headings + wrong, max(_PLAY_ODOMETRY * own, _PLAY_TRUE * jitter)


def angle_turned(headings: Floats, play_rad: float) -> Floats:
    """Sum of the heading's changes either way up to every sample, as a pointer dragged with a play shows them."""
    half = 0.5 * play_rad
    ends = np.append(np.flatnonzero(np.diff(np.sign(np.diff(headings)))) + 1, len(headings) - 1)
    pointers, totals = [float(headings[0])], [0.0]
    for heading in headings[ends].tolist():  # where it turns back: between them the pointer goes one way
        pull = max(heading - half - pointers[-1], 0.0) + min(heading + half - pointers[-1], 0.0)
        pointers.append(pointers[-1] + pull)
        totals.append(totals[-1] + abs(pull))
    run = np.searchsorted(ends, np.arange(len(headings)))
    pulled = np.maximum(np.abs(headings - np.array(pointers)[run]) - half, 0.0)
    return np.asarray(np.maximum.accumulate(np.array(totals)[run] + pulled))  # rounding does not turn it back
