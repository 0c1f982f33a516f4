"""Rows of a recording in the order of their times: sorted where they are only disordered, cut where the clock was set
back, and without single bad stamps."""

from __future__ import annotations

import numpy as np

from driftplan.arrays import Bools, Floats, Ints
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

    Raises
    ------
    ValueError : where times fall so often that they are none, or too many rows would be dropped

    Examples
    --------
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
        raise ValueError(
            f"times fall in {int((np.diff(times) < 0).sum())} of {len(times)} rows: is the first column no time (three "
            "nameless columns are time, x, y)? Name the columns"
        )
    if len(parts) > 1:
        used = max(parts[1:], key=len)
        used = parts[0] if 2 * len(parts[0]) >= len(used) else used
        back = times[parts[0][-1]] - times[parts[1][0]]
        notes.append(
            f"the clock is set back by {back:.3g} s in row {parts[1][0] + 1}: the log is cut there, and rows "
            f"{used[0] + 1} to {used[-1] + 1} of {len(times)} are used"
        )
        kept = used
    disordered = int((np.diff(times[kept]) < 0).sum())
    if disordered > _SAID_SHARE * len(kept):
        notes.append(f"{disordered} rows were not in the order of their times, and were sorted")
    return kept[np.argsort(times[kept], kind="stable")], notes


def _bad_stamps(times: Floats) -> Bools:
    """Single times far from both neighbours, which are in order without them."""
    bad = np.zeros(len(times), dtype=bool)
    if len(times) < 3:
        return bad
    step = _BAD_STAMP_STEPS * float(np.median(np.abs(np.diff(times))))
    before, at, after = times[:-2], times[1:-1], times[2:]
    bad[1:-1] = (
        (before <= after) & (after - before < step) & (np.minimum(np.abs(at - before), np.abs(at - after)) > step)
    )
    return bad


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
