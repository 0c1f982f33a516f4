"""Do the columns of a log mean what they are taken for? Headings are held against the way driven."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from driftplan.arrays import Complexes, Floats

_CHORDS = 400  # of the way, at most, whose directions are compared
_SMOOTH_STEPS = 5.0  # a chord is so many usual steps long at least: jitter turns short ones
_AGREE = 0.9  # mean cosine of the angle between heading and way, its sense left aside, at which they belong together,
_DISAGREE = 0.5  # and below which they do not
_TURNED = 1.0  # rad that the way must turn to tell


def agreement(positions: Complexes, heading: Floats) -> float:
    """How well headings follow the way: 1 if they keep one angle to it, driving ahead or backwards, 0 if none."""
    steps = np.abs(np.diff(positions))
    along = np.concatenate([[0.0], np.cumsum(steps)])
    moving = steps[steps > 0]
    if moving.size < 3:
        return float("nan")
    spacing = max(along[-1] / _CHORDS, _SMOOTH_STEPS * float(np.median(moving)))
    marks = np.unique(np.searchsorted(along, np.arange(0, along[-1], spacing)))
    if len(marks) < 4:
        return float("nan")
    chord, middle = np.diff(positions[marks]), (marks[1:] + marks[:-1]) // 2
    straight = np.abs(chord) > 0.9 * np.diff(along[marks])
    if straight.sum() < 3:
        return float("nan")
    course = np.angle(chord[straight])
    if np.abs(np.diff(np.unwrap(2 * course)) / 2).sum() < _TURNED:
        return float("nan")
    return float(np.abs(np.mean(np.exp(2j * (course - heading[middle][straight])))))


def misread(positions: Complexes, heading: Floats, readings: Mapping[str, tuple[Complexes, Floats | None]]) -> str:
    """Which other reading of the columns, (positions, headings) by what it is called, fits where this one does not."""
    own = agreement(positions, heading)
    if not own < _DISAGREE:
        return ""
    fits = {name: agreement(at, angle) for name, (at, angle) in readings.items() if angle is not None}
    best = max(fits, key=lambda name: np.nan_to_num(fits[name]), default="")
    return best if best and fits[best] > _AGREE else ""
