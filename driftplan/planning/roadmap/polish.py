"""Polishing a path that a roadmap's nodes make zigzag: for the least price, or as short as can be.

`polished` takes shortcuts between waypoints, then makes small moves of the waypoints, as long as the additive price
falls. Moves are tried in bulk: many places for every second waypoint at once (every third when turns cost, so that no
two moves share a turn), from coarse to fine.

`shortened` pulls waypoints towards their neighbours' line. A path that must come within range of beacons cannot simply
be pulled taut, so every change is asked about.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from driftplan.arrays import Complexes, Floats, Ints
from driftplan.planning.roadmap.graph import Roadmap
from driftplan.planning.roadmap.prices import AdditiveCost, Space, length_of

_LEVELS = (8, 16, 32)  # legs the path is cut into, at least, from level to level
_SWEEPS = 8  # over all waypoints, per level
_SETTLED = 1e-5  # relative gain of a sweep below which the level is done
_MAX_WAYPOINTS = 48  # offered to the shortcut search, which tries all pairs
_NEEDLESS = 1e-7  # relative price at which a waypoint may go
_PULLING_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of the way to the neighbours' line
_PULLING_SWEEPS = 6
_PULLING_SETTLED = 1e-4  # least relative gain of a sweep that is worth another
_ANGLES = np.arange(8) * np.pi / 4
_RINGS = np.array([1.0, 0.3, 0.09, 0.027])  # radii of the moves tried, in units of the reach
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)
_MOVES = np.concatenate([np.zeros((1, 2)), (_RINGS[:, None, None] * _CIRCLE).reshape(-1, 2)])  # staying is the first


def polished(
    pricing: AdditiveCost,
    path: Floats,
    start_heading: float | None = None,
    stop: Callable[[], bool] = lambda: False,
    *,
    tell: Callable[[Floats], None] = lambda path: None,
) -> Floats:
    """A path (k, 2) between the same ends, free of collisions, from one (n, 2) that is free.

    It costs less, or at most 1e-7 of the price more, for the sake of fewer waypoints. ``stop`` is asked between sweeps;
    when it answers True the path reached so far is returned. ``tell`` is told of the path after every sweep.
    """
    path = _refined(AdditivePathCost(pricing, start_heading), shortcut(pricing, path, start_heading), stop, tell)
    return without_needless(pricing, path, start_heading)


def without_needless(pricing: AdditiveCost, path: Floats, start_heading: float | None = None) -> Floats:
    """The path without waypoints that it costs at most 1e-7 of its price to leave out."""
    cost = AdditivePathCost(pricing, start_heading)
    most = cost.price(path) * (1 + _NEEDLESS)
    # not cut short: else a longer search, which leaves out more waypoints, could be worse by a rounding error
    return _without_needless(path, pricing.space, lambda without: cost.price(without) <= most, lambda: False)


def _refined(cost: AdditivePathCost, path: Floats, stop: Callable[[], bool], tell: Callable[[Floats], None]) -> Floats:
    """The path with its waypoints moved, from coarse to fine, where that lowers its cost."""
    space = cost.pricing.space
    for legs in _LEVELS:
        path = _split(space, path, legs)
        price, around = cost.price(path), np.arange(1 - cost.stride, cost.stride)
        open_ = np.ones(len(path), dtype=bool)  # waypoints that have not been tried with neighbours where they are now
        for _ in range(_SWEEPS):
            if stop():
                return path
            before = price
            for first in range(1, 1 + cost.stride):
                moved = np.arange(first, len(path) - 1, cost.stride)
                moved = moved[open_[moved]]
                if not len(moved):
                    continue
                other = path.copy()
                other[moved] = _better_places(cost, space, path, moved)
                open_[moved] = False
                if (now := cost.price(other)) < price:
                    changed = moved[(other[moved] != path[moved]).any(axis=1)]
                    open_[np.clip(changed[:, None] + around, 0, len(path) - 1)] = True
                    path, price = other, now
            tell(path)
            if before - price < _SETTLED * before:
                break
    return path


@dataclass(frozen=True, eq=False)
class AdditivePathCost:
    """The additive cost of paths, and of paths with some waypoints elsewhere."""

    pricing: AdditiveCost
    start_heading: float | None = None

    @property
    def stride(self) -> int:
        """Waypoints this far apart can be moved at once."""
        return 3 if self.pricing.has_turns else 2

    def price(self, path: Floats) -> float:
        return self.pricing.path(path, self.start_heading)

    def prices(self, path: Floats, moved: Ints, tried: Floats) -> Floats:
        """With waypoint ``moved[k]`` at ``tried[k]``, up to a constant for each waypoint, (k,): of the two legs
        that change, and the turns before, at and after the waypoint."""
        pricing, left, right = self.pricing, path[moved - 1], path[moved + 1]
        there, onward = pricing.edges(left, tried), pricing.edges(tried, right)
        total = there.cost + onward.cost
        if not pricing.has_turns:
            return total
        to, away = bearing(left, tried), bearing(tried, right)
        came = arriving(path, moved, to, self.start_heading)
        total += pricing.turns(left, np.angle(to * np.conj(came)), there.zone_a)
        total += pricing.turns(tried, np.angle(away * np.conj(to)), onward.zone_a)
        inner = np.flatnonzero(moved + 2 < len(path))
        beyond = path[moved[inner] + 2]
        turn = np.angle(bearing(right[inner], beyond) * np.conj(away[inner]))
        total[inner] += pricing.turns(right[inner], turn, pricing.edges(right[inner], beyond).zone_a)
        return total


def shortcut(pricing: AdditiveCost, path: Floats, start_heading: float | None = None) -> Floats:
    """The cheapest path through some of the waypoints of ``path``, in whatever order."""
    if len(path) < 3:
        return path
    inner = path[1:-1]
    if len(inner) > _MAX_WAYPOINTS:
        inner = inner[np.linspace(0, len(inner) - 1, _MAX_WAYPOINTS).round().astype(int)]
    small = Roadmap(pricing, path[0], start_heading)
    small.add(inner, neighbours=len(inner) + 1, limit=np.inf)
    found = small.shortest()
    if len(found.nodes) and pricing.path(small.xy[found.nodes], start_heading) < pricing.path(path, start_heading):
        return np.asarray(small.xy[found.nodes])
    return path


def _split(space: Space, path: Floats, legs: int) -> Floats:
    """The same path with legs of at most 1/``legs`` of its length, whole where a part of one is not free by itself: by
    round-off, or because a checker looks at samples of a motion only."""
    step = np.diff(path, axis=0)
    length = np.linalg.norm(step, axis=1)
    parts = np.maximum(1, np.ceil(length * legs / length.sum() - 1e-9)).astype(int)
    cut, leg = _cut(path, step, parts)
    parts[np.unique(leg[~space.segments_free(cut[:-1], cut[1:])])] = 1
    return _cut(path, step, parts)[0]


def _cut(path: Floats, step: Floats, parts: Ints) -> tuple[Floats, Ints]:
    """Leg k of the path cut into ``parts[k]`` equal ones, and the old leg that each new one belongs to."""
    leg = np.repeat(np.arange(len(step)), parts)
    share = (np.arange(len(leg)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[leg]
    return np.concatenate([path[leg] + share[:, None] * step[leg], path[-1:]]), leg


def _better_places(cost: AdditivePathCost, space: Space, path: Floats, moved: Ints) -> Floats:
    """For each of the waypoints ``moved`` the best of the free places tried around it, or where it is."""
    here, left, right = path[moved], path[moved - 1], path[moved + 1]
    reach = 0.5 * np.minimum(np.linalg.norm(here - left, axis=1), np.linalg.norm(right - here, axis=1))
    places = here[:, None, :] + _MOVES * reach[:, None, None]
    count = len(_MOVES)
    tried, left, right = places.reshape(-1, 2), np.repeat(left, count, axis=0), np.repeat(right, count, axis=0)
    price = cost.prices(path, np.repeat(moved, count), tried)
    standing = np.repeat(price[::count], count)
    free = price < standing - 1e-12 * np.abs(standing)
    free[free] = space.segments_free(left[free], tried[free])
    free[free] = space.segments_free(tried[free], right[free])
    free[::count] = True
    best = np.where(free, price, np.inf).reshape(-1, count).argmin(axis=1)
    return np.asarray(places[np.arange(len(moved)), best])


def bearing(a: Floats, b: Floats) -> Complexes:
    """The vectors from ``a`` to ``b`` as complex numbers."""
    return np.asarray((b - a) @ np.array([1.0, 1j]))


def arriving(path: Floats, moved: Ints, to: Complexes, start_heading: float | None) -> Complexes:
    """Direction in which the robot reaches the waypoint before each of those ``moved``; from there it goes ``to``. At
    the start that is the start heading, or the way it goes when there is none."""
    before = bearing(path[np.maximum(moved - 2, 0)], path[moved - 1])
    facing = to if start_heading is None else np.exp(1j * start_heading)
    return np.where(moved == 1, facing, before)


# Shortening a path as long as something holds


def shortened(
    path: Floats, space: Space, holds: Callable[[Floats], bool], stop: Callable[[], bool] = lambda: False
) -> Floats:
    """A collision-free path (k, 2) between the same ends, no longer than ``path`` (n, 2), that ``holds`` like it;
    ``stop`` is asked before every trial."""
    path = _without_needless(path, space, holds, stop)
    for _ in range(_PULLING_SWEEPS):
        before = length_of(path)
        path = _pulled(path, space, holds, stop)
        path = _without_needless(path, space, holds, stop)
        if stop() or before - length_of(path) < _PULLING_SETTLED * before:
            break
    return path


def _without_needless(path: Floats, space: Space, holds: Callable[[Floats], bool], stop: Callable[[], bool]) -> Floats:
    tried: set[bytes] = set()
    free = space.segments_free(path[:-2], path[2:])
    while len(path) > 2:
        left, here, right = path[:-2], path[1:-1], path[2:]
        gain = _distance(left, here) + _distance(here, right) - _distance(left, right)
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
                free = np.delete(free, slice(k, k + len(path) - len(without)))
                new = np.arange(max(k - 2, 0), min(k + 2, len(free)))
                free[new] = space.segments_free(without[new], without[new + 2])
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
        places = here + np.array(_PULLING_SHARES)[:, None] * (target - here)
        free = space.segments_free(np.broadcast_to(left, places.shape), places)
        free &= space.segments_free(places, np.broadcast_to(right, places.shape))
        # to leave it out is tried elsewhere
        free &= (_distance(places, left) > 1e-6) & (_distance(places, right) > 1e-6)
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
