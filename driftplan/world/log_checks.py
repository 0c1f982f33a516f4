"""Is a recording what it is taken for? Rows in the order of their times: sorted where they are only disordered, cut
where the clock was set back, and without single bad stamps; and headings held against the way driven."""

from __future__ import annotations

from collections.abc import Mapping
from math import nan

import numpy as np

from driftplan.arrays import Bools, Complexes, Floats, Ints
from driftplan.world.log_tables import MAX_DROPPED_SHARE

_SAID_SHARE = 0.01
_BAD_STAMP_STEPS = 10.0  # a single stamp so many usual steps away from its neighbours is a bad one
_RESTART_ROWS = 50  # times that fall and stay behind for as many rows were set back
_MAX_RESTARTS = 5  # in one file: more are no restarts
_EPOCHS = ((1e17, 1e-9, "nanoseconds"), (1e14, 1e-6, "microseconds"), (1e11, 1e-3, "milliseconds"))


def seconds(times: Floats) -> tuple[Floats, str]:
    """Times without a unit in seconds, and what is to be said about it: since 1970, no second is above 1e11."""
    size = float(np.median(np.abs(times)))
    for least, unit, name in _EPOCHS:
        if size > least:
            return times * unit, f"times like {times[0]:.0f} are taken for {name} since 1970"
    return times, ""


def in_order(times: Floats) -> tuple[Ints, list[str]]:
    """Which rows to use, in which order, and what is to be said about it.

    Raises ValueError where times fall so often that they are none, or too many rows would be dropped.

    >>> in_order(np.array([0.0, 2.0, 1.0, 3.0]))[0].tolist()
    [0, 2, 1, 3]
    """
    kept = np.arange(len(times))
    if (np.diff(times) >= 0).all():
        return kept, []
    kept = kept[~_bad_stamps(times)]
    notes = []
    dropped = 1 - len(kept) / len(times)
    if dropped > MAX_DROPPED_SHARE:
        raise ValueError(f"{100 * dropped:.0f} % of the rows have times far off their neighbours': is this the time?")
    if dropped > _SAID_SHARE:
        notes.append(f"{100 * dropped:.1f} % of the rows have times far off their neighbours', and were left out")
    parts = np.split(kept, _restarts(times[kept]))
    if len(parts) > _MAX_RESTARTS + 1:
        falls = f"times fall in {int((np.diff(times) < 0).sum())} of {len(times)} rows"
        what = "is the first column no time (three nameless columns are time, x, y)? Name the columns"
        raise ValueError(f"{falls}: {what}")
    if len(parts) > 1:
        longest = max(parts[1:], key=len)
        kept = parts[0] if 2 * len(parts[0]) >= len(longest) else longest
        back = f"set back by {times[parts[0][-1]] - times[parts[1][0]]:.3g} s in row {parts[1][0] + 1}"
        used = f"rows {kept[0] + 1} to {kept[-1] + 1} of {len(times)}"
        notes.append(f"the clock is {back}: the log is cut there, and {used} are used")
    disordered = int((np.diff(times[kept]) < 0).sum())
    if disordered > _SAID_SHARE * len(kept):
        notes.append(f"{disordered} rows were not in the order of their times, and were sorted")
    return kept[np.argsort(times[kept], kind="stable")], notes


def _bad_stamps(times: Floats) -> Bools:
    """Single times far from both neighbours, which are in order without them."""
    step = _BAD_STAMP_STEPS * float(np.median(np.abs(np.diff(times))))
    before, at, after = times[:-2], times[1:-1], times[2:]
    far = np.minimum(np.abs(at - before), np.abs(at - after)) > step
    return np.pad((before <= after) & (after - before < step) & far, 1)[: len(times)]


def _restarts(times: Floats) -> Ints:
    """Rows before which the clock was set back for good."""
    highest = np.maximum.accumulate(times)
    found: list[int] = []
    begin = 0
    for k in (np.flatnonzero(np.diff(times) < 0) + 1).tolist():
        until = min(k + _RESTART_ROWS, len(times) - 1)
        top = highest[k - 1] if begin == 0 else times[begin:k].max()
        if k > begin and (times[k : until + 1] < top).all() and until - k >= min(_RESTART_ROWS, 3):
            found.append(k)
            begin = k
            if len(found) > _MAX_RESTARTS:
                break
    return np.array(found, dtype=int)


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
        return nan
    spacing = max(along[-1] / _CHORDS, _SMOOTH_STEPS * float(np.median(moving)))
    marks = np.unique(np.searchsorted(along, np.arange(0, along[-1], spacing)))
    if len(marks) < 4:
        return nan
    chord, middle = np.diff(positions[marks]), (marks[1:] + marks[:-1]) // 2
    straight = np.abs(chord) > 0.9 * np.diff(along[marks])
    course = np.angle(chord[straight])
    if len(course) < 3 or np.abs(np.diff(np.unwrap(2 * course)) / 2).sum() < _TURNED:
        return nan
    return float(np.abs(np.mean(np.exp(2j * (course - heading[middle][straight])))))


def misread(positions: Complexes, heading: Floats, readings: Mapping[str, tuple[Complexes, Floats | None]]) -> str:
    """Which other reading of the columns, (positions, headings) by what it is called, fits where this one does not."""
    own = agreement(positions, heading)
    if not own < _DISAGREE:
        return ""
    fits = {name: agreement(at, angle) for name, (at, angle) in readings.items() if angle is not None}
    best = max(fits, key=lambda name: np.nan_to_num(fits[name]), default="")
    return best if best and fits[best] > _AGREE else ""
