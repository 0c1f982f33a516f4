"""Shortening a path as long as something holds: needless waypoints go, the others move towards their neighbours' line.

What a roadmap finds zigzags between its nodes. A path that must come within range of beacons cannot simply be pulled
taut, so every change is asked about.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from driftplan.arrays import Floats
from driftplan.planning.roadmap.prices import Space

_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of the way to the neighbours' line
_SWEEPS = 6
_WORTH = 1e-4  # least relative gain of a sweep that is worth another


def shortened(
    path: Floats, space: Space, holds: Callable[[Floats], bool], stop: Callable[[], bool] = lambda: False
) -> Floats:
    """A collision-free path (k, 2) between the same ends, no longer than ``path`` (n, 2), that ``holds`` like it.

    Parameters
    ----------
    holds : callable
        Asked about one path at a time; true of ``path``.
    stop : callable
        Asked before every trial; True ends it with what was reached.
    """
    path = _without_needless(path, space, holds, stop)
    for _ in range(_SWEEPS):
        before = _length(path)
        path = _pulled(path, space, holds, stop)
        path = _without_needless(path, space, holds, stop)
        if stop() or before - _length(path) < _WORTH * before:
            break
    return path


def _without_needless(path: Floats, space: Space, holds: Callable[[Floats], bool], stop: Callable[[], bool]) -> Floats:
    tried: set[bytes] = set()
    while len(path) > 2:
        left, here, right = path[:-2], path[1:-1], path[2:]
        gain = _distance(left, here) + _distance(here, right) - _distance(left, right)
        free = space.segments_free(left, right)
        for k in np.argsort(-gain, kind="stable").tolist():
            if stop():
                return path
            key = path[k : k + 3].tobytes()
            if not free[k] or key in tried:
                continue
            without = np.delete(path, k + 1, axis=0)
            if _distance(left[k], right[k]) < 1e-9:  # there and back again: what is left of it is one place
                without = np.delete(without, k + 1 if k + 2 < len(without) else k, axis=0)
            if len(without) > 1 and holds(without):
                path = without
                break
            tried.add(key)
        else:
            return path
    return path


def _pulled(path: Floats, space: Space, holds: Callable[[Floats], bool], stop: Callable[[], bool]) -> Floats:
    path = path.copy()
    for k in range(1, len(path) - 1):
        left, here, right = path[k - 1], path[k], path[k + 1]
        along = right - left
        share = float(np.clip((here - left) @ along / max(float(along @ along), 1e-300), 0.0, 1.0))
        target = left + share * along
        if _distance(here, target) < 1e-6:
            continue
        places = here + np.array(_SHARES)[:, None] * (target - here)
        free = space.segments_free(np.broadcast_to(left, places.shape), places)
        free &= space.segments_free(places, np.broadcast_to(right, places.shape))
        free &= (_distance(places, left) > 1e-6) & (
            _distance(places, right) > 1e-6
        )  # to leave it out is tried elsewhere
        for place in places[free]:
            if stop():
                return path
            moved = path.copy()
            moved[k] = place
            if holds(moved):
                path = moved
                break
    return path


def _distance(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.linalg.norm(b - a, axis=-1))


def _length(path: Floats) -> float:
    return float(_distance(path[:-1], path[1:]).sum())
