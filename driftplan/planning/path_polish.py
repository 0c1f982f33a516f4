"""Polishing a path: shortcuts between its waypoints, then small moves of the waypoints, as long as its price falls.

A roadmap's path zigzags between samples; the best path nearby bends smoothly towards the goal and hugs corners. Moves
are tried in bulk: many places for every second waypoint at once (every third when turns cost, so that no two moves
share a turn), from coarse to fine.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from driftplan.planning.roadmap_graph import Roadmap
from driftplan.planning.roadmap_pricing import Floats, Ints, Pricing

_LEVELS = (8, 16, 32)  # legs the path is cut into, at least, from level to level
_SWEEPS = 8  # over all waypoints, per level
_SETTLED = 1e-5  # relative gain of a sweep below which the level is done
_MOST_WAYPOINTS = 48  # offered to the shortcut search, which tries all pairs
_NEEDLESS = 1e-7  # relative price at which a waypoint may go
_ANGLES = np.arange(8) * np.pi / 4
_RINGS = np.array([1.0, 0.3, 0.09, 0.027])  # radii of the moves tried, in units of the reach
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)
_MOVES = np.concatenate([np.zeros((1, 2)), (_RINGS[:, None, None] * _CIRCLE).reshape(-1, 2)])  # staying is the first


def polished(
    pricing: Pricing,
    path: Floats,
    start_heading: float | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Floats:
    """A path (k, 2) between the same ends, free of collisions and at most as costly as ``path`` (n, 2), which is free.

    ``stop`` is asked between sweeps; when it answers True the path reached so far is returned.
    """
    path = shortcut(pricing, path, start_heading)
    for legs in _LEVELS:
        path = _split(path, legs)
        price = pricing.path(path, start_heading)
        for _ in range(_SWEEPS):
            if stop():
                return path
            path = _sweep(pricing, path, start_heading)
            before, price = price, pricing.path(path, start_heading)
            if before - price < _SETTLED * before:
                break
    return _without_needless(pricing, path, start_heading)


def shortcut(pricing: Pricing, path: Floats, start_heading: float | None = None) -> Floats:
    """The cheapest path through some of the waypoints of ``path``, in whatever order."""
    if len(path) < 3:
        return path
    inner = path[1:-1]
    if len(inner) > _MOST_WAYPOINTS:
        inner = inner[np.linspace(0, len(inner) - 1, _MOST_WAYPOINTS).round().astype(int)]
    small = Roadmap(pricing, path[0], start_heading)
    small.add(inner, neighbours=len(inner) + 1, limit=np.inf)
    found = small.shortest()
    if len(found.nodes) and pricing.path(small.xy[found.nodes], start_heading) < pricing.path(path, start_heading):
        return np.asarray(small.xy[found.nodes])
    return path


def _split(path: Floats, legs: int) -> Floats:
    """The same path with legs of at most 1/``legs`` of its length."""
    step = np.diff(path, axis=0)
    length = np.linalg.norm(step, axis=1)
    parts = np.maximum(1, np.ceil(length * legs / length.sum() - 1e-9)).astype(int)
    leg = np.repeat(np.arange(len(step)), parts)
    share = (np.arange(len(leg)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[leg]
    return np.concatenate([path[leg] + share[:, None] * step[leg], path[-1:]])


def _sweep(pricing: Pricing, path: Floats, start_heading: float | None) -> Floats:
    """One try to move every inner waypoint."""
    path = path.copy()
    stride = 3 if pricing.has_turns else 2
    for first in range(1, 1 + stride):
        moved = np.arange(first, len(path) - 1, stride)
        if len(moved):
            path[moved] = _better_places(pricing, path, moved, start_heading)
    return path


def _better_places(pricing: Pricing, path: Floats, moved: Ints, start_heading: float | None) -> Floats:
    """For each of the waypoints ``moved`` the best of the places tried around it, or where it is."""
    here, left, right = path[moved], path[moved - 1], path[moved + 1]
    reach = 0.5 * np.minimum(np.linalg.norm(here - left, axis=1), np.linalg.norm(right - here, axis=1))
    places = here[:, None, :] + _MOVES * reach[:, None, None]
    count = len(_MOVES)
    tried, left, right = places.reshape(-1, 2), np.repeat(left, count, axis=0), np.repeat(right, count, axis=0)
    there, onward = pricing.edges(left, tried), pricing.edges(tried, right)
    price = there.cost + onward.cost
    if pricing.has_turns:
        zones = np.stack([there.zone_a, onward.zone_a])
        price += _turn_prices(pricing, path, np.repeat(moved, count), tried, zones, start_heading)
    standing = np.repeat(price[::count], count)
    free = price < standing * (1 - 1e-12)
    free[free] = pricing.space.segments_free(left[free], tried[free])
    free[free] = pricing.space.segments_free(tried[free], right[free])
    free[::count] = True
    best = np.where(free, price, np.inf).reshape(-1, count).argmin(axis=1)
    return np.asarray(places[np.arange(len(moved)), best])


def _turn_prices(
    pricing: Pricing, path: Floats, moved: Ints, tried: Floats, zones: Ints, start_heading: float | None
) -> Floats:
    """Prices of the three turns that change when waypoint ``moved`` goes to ``tried``: before it, at it and after it.

    ``zones`` (2, n) are those in which the edges to and from ``tried`` begin.
    """
    left, right = path[moved - 1], path[moved + 1]
    arriving = _bearing(path[np.maximum(moved - 2, 0)], left)
    first = moved == 1  # the start: the turn there is from the start heading, if there is one
    there, onward = _bearing(left, tried), _bearing(tried, right)
    arriving = np.where(first, there if start_heading is None else np.exp(1j * (start_heading or 0.0)), arriving)
    total = pricing.turns(left, np.angle(there * np.conj(arriving)), zones[0])
    total += pricing.turns(tried, np.angle(onward * np.conj(there)), zones[1])
    inner = np.flatnonzero(moved + 2 < len(path))
    beyond = path[moved[inner] + 2]
    leaving_zone = pricing.edges(right[inner], beyond).zone_a
    turn = np.angle(_bearing(right[inner], beyond) * np.conj(onward[inner]))
    total[inner] += pricing.turns(right[inner], turn, leaving_zone)
    return total


def _without_needless(pricing: Pricing, path: Floats, start_heading: float | None) -> Floats:
    """The path without the waypoints that hardly matter to its price, dropped one by one."""
    price = pricing.path(path, start_heading)
    most = price * (1 + _NEEDLESS)
    k = 1
    while k < len(path) - 1:
        without = np.delete(path, k, axis=0)
        if pricing.path(without, start_heading) <= most and pricing.space.segments_free(path[k - 1], path[k + 1]):
            path = without
        else:
            k += 1
    return path


def _bearing(a: Floats, b: Floats) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    return np.asarray((b - a) @ np.array([1.0, 1j]))
