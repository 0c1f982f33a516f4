"""Taut strings: what no route among the obstacles can beat, and the route that almost does not.

The additive cost of a route (`driftplan.planning.cost`) is ``q_h ∫|w|² ds + q_p length`` with the lever w to the goal.
Both integrals are lengths: the second in the plane, the first in the plane flattened by w -> w³/3, a cone of angle 6π
whose apex is the goal. The shortest route among polygons of a flat surface is a taut string: straight between corners
at which it bends round an obstacle. In the flattened plane the sides of obstacles are no longer straight; but if free
space is first made larger by a margin, and the sides are cut finely enough, the polygons of chords lie inside the
obstacles, and the shortest route around them is a lower bound for every route. With free space made smaller instead,
the string is a route.

Zones and turns: a bound holds with the least rates anywhere, and turns are left out.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import shapely

from driftplan.arrays import Bools, Complexes, Floats, Ints
from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import CostRates, bracket
from driftplan.world.world import World
from driftplan.world.zones import noises_on

# A corner of free space made larger by the margin is rounded by chords, at 0.92 margins from the corner; of these,
# thinning the outline out takes 0.45, and the chords of the flattened plane 0.3.
_CHORDS_PER_QUARTER = 2
_THINNING = 0.45
# A chord of the flattened plane sags by s²/4r, s long and r from the goal: 0.9 √(margin r) gives 0.3 margins.
_CHORD = 0.9
_SLACK_RAD = 1e-12  # what is nearer than that to an obstacle's corner is taken to miss it
_SLACK = 1e-9  # and what ends so short of an obstacle, as a share of the distance
_FIRST_MARGIN_RADII, _FIRST_MARGIN_SIZES = 1 / 6, 1e-4  # of the robot, and of the map
_MARGINS, _FINER = 4, 2.5  # margins tried at most, each so much finer than the one before
_WORTH = 0.8  # of the gap left by a margin: then the next one does not pay
_MOST_LOOKS = 3_000_000  # at corners, from others, for one string: about half a second
_LENGTHS = 2000  # of routes, at which the bound of the mean square is evaluated
_HEADING_STD_FACTOR = 2.0  # times that of the route found: where a bound must be restricted, it is for up to that
_OUTLINED_S = 1e-5  # per corner of free space, about, to make it larger or smaller by a margin, in one go
_FLAT, _CONE = 1, 3  # powers of the lever: distances in the plane, and in the plane flattened
_PARTS: WeakKeyDictionary[World, dict[tuple[int, float], Any]] = WeakKeyDictionary()
Left = Callable[[], float]  # seconds


class LeastRoute(NamedTuple):
    """What every route from a start to a goal is at least, each for itself; or what one route is."""

    squared_levers: float  # ∫|w|² ds, m³
    length: float  # m

    @classmethod
    def of_path(cls, path: Floats) -> LeastRoute:
        """Of a path (n, 2) to its last point."""
        w, step = path - path[-1], np.hypot(*np.diff(path, axis=0).T)
        mean_square = (w[1:] ** 2 + w[1:] * w[:-1] + w[:-1] ** 2).sum(axis=1) / 3
        return cls(float((mean_square * step).sum()), float(step.sum()))

    def cost(self, noises: Sequence[OdometryNoise]) -> float:
        """Additive cost, m², at the least rates of any of the noises, turns left out."""
        rates = [CostRates.of(noise) for noise in set(noises)]
        return min(r.heading for r in rates) * self.squared_levers + min(r.position for r in rates) * self.length

    def bound(self, noises: Sequence[OdometryNoise], heading_std: float) -> tuple[float, float]:
        """`mean_square` of all routes (m², infinity), or, where that is less by 1 %, of those that gain up to twice the
        heading error of the route found, ``heading_std`` (m², rad)."""
        heading_std *= _HEADING_STD_FACTOR
        everywhere, restricted = self.mean_square(noises), self.mean_square(noises, heading_std)
        return (everywhere, math.inf) if everywhere >= 0.99 * restricted else (restricted, heading_std)

    def mean_square(self, noises: Sequence[OdometryNoise], heading_std: float = math.inf) -> float:
        """No route that gains a heading error of at most ``heading_std`` rad has a smaller E|e|² at the goal, m².

        A route of length L that gains the heading variance H has ``E|e|² >= Λ(H) q_h ∫|w|² ds + q_p L``, and without
        noise of turns L is at least H over the greatest rate. Zero for noise that is not plain.
        """
        noises = list(set(noises))
        if not all(noise.is_plain for noise in noises):
            return 0.0
        rates = [CostRates.of(noise) for noise in noises]
        levers = min(rate.heading for rate in rates) * self.squared_levers
        position, most = min(rate.position for rate in rates), max(rate.heading for rate in rates)
        worst = levers * float(bracket(heading_std)) if math.isfinite(heading_std) else 0.0
        turning = any(noise.heading_var_per_rad for noise in noises)
        if turning or position == 0 or most == 0:
            return (levers if most == 0 and not turning else worst) + position * self.length
        farthest = self.length + levers / position  # from there on position noise alone is more than the first value
        length = np.linspace(self.length, farthest, _LENGTHS)
        at_least = levers * bracket(np.sqrt(most * length[1:])) + position * length[:-1]
        return max(min(float(at_least.min()), position * farthest), worst + position * self.length)


def least_route(
    world: World,
    start: Floats,
    goal: Floats,
    margin_m: float,
    known: Floats | None = None,
    *,
    only_length: bool = False,
    left_s: Left = lambda: math.inf,
    most_looks: float = math.inf,
) -> LeastRoute:
    """Lower bounds, among the obstacles, of a route's length and of its integral of the squared distance to the goal.

    Obstacles are made smaller by ``margin_m``: the smaller, the closer the bound and the longer it takes; what is
    thinner than two margins vanishes. Start and goal (2,), metres, are free and in one part of free space. Ways that
    are longer than a ``known`` route (n, 2) are not looked at. ``only_length`` leaves the other at zero. ``left_s`` is
    asked again and again: once no seconds are left, or after so many looks from one corner at another, what is proven
    by then is returned.

    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> least = least_route(world, np.array([2.0, 2.0]), np.array([8.0, 2.0]), 0.01)
    >>> round(least.length, 1)
    14.0
    """
    w = complex(*(start - goal))
    most = (math.inf, math.inf) if known is None else LeastRoute.of_path(known)
    if w == 0:
        return LeastRoute(0.0, 0.0)
    free, found = _free(world, start, margin_m, left_s), []
    if free is None:
        return LeastRoute(abs(w) ** 3 / 3, abs(w))
    for power, upper in zip((_CONE, _FLAT), most, strict=True):
        if only_length and power == _CONE:
            found.append(0.0)
            continue
        corners = _Corners.of(free, goal, power, margin_m).near(w, upper)
        found.append(min(corners.string(w, upper, left_s, most_looks)[0], upper))
    return LeastRoute(*found)


def tight_least_route(
    world: World, path: Floats, noise: OdometryNoise, gap: float = 0.01, *, left_s: Left = lambda: math.inf
) -> LeastRoute:
    """`least_route` with a margin made smaller until the path costs at most a share ``gap`` more, or while that pays.

    With zones, ``noise`` being outside of them, the bound's cost is that of the best of them everywhere, which may
    leave a gap that no margin closes.

    >>> world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    >>> noise = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3)
    >>> path = taut_route(world, np.array([2.0, 2.0]), np.array([8.0, 2.0]), 0.01)
    >>> least = tight_least_route(world, path, noise)
    >>> 0.98 < least.cost([noise]) / LeastRoute.of_path(path).cost([noise]) <= 1
    True
    """
    noises = noises_on(world, noise)
    margin = first_margin_m(world)
    straight = float(np.linalg.norm(path[-1] - path[0]))
    cost, best = LeastRoute.of_path(path).cost(noises), LeastRoute(straight**3 / 3, straight)
    only_length = min(CostRates.of(kind).heading for kind in noises) == 0
    for _ in range(_MARGINS):
        if left_s() <= 0:
            break
        open_before = cost - best.cost(noises)
        asked = {"only_length": only_length, "left_s": left_s, "most_looks": _MOST_LOOKS}
        least = least_route(world, path[0], path[-1], margin, path, **asked)  # type: ignore[arg-type]
        best = LeastRoute(*map(max, best, least))
        missing = cost - best.cost(noises)
        if missing <= gap * cost or missing > _WORTH * open_before:
            break
        margin /= _FINER
    return best


def first_margin_m(world: World) -> float:
    """A margin to begin with, metres."""
    size = math.hypot(world.bounds[2] - world.bounds[0], world.bounds[3] - world.bounds[1])
    return max(_FIRST_MARGIN_RADII * world.robot_radius, _FIRST_MARGIN_SIZES * size)


def taut_route(
    world: World,
    start: Floats,
    goal: Floats,
    margin_m: float,
    known: Floats | None = None,
    *,
    by_length: bool = False,
    left_s: Left = lambda: math.inf,
) -> Floats | None:
    """The route of least ∫|w|² ds, or the shortest, that keeps a margin from obstacles: waypoints (n, 2), or None.

    Parameters as in `least_route`. Where the margin closes a passage, the route goes round about; where start or goal
    are nearer to an obstacle, or the ``known`` route is better, there is none.
    """
    free, w = _free(world, start, -margin_m, left_s), complex(*(start - goal))
    power = _FLAT if by_length else _CONE
    if free is None or free.is_empty or w == 0:
        return None
    corners, upper = _Corners.of(free, goal, power, margin_m), math.inf
    if known is not None:
        upper = LeastRoute.of_path(known)[by_length]
        corners = corners.near(w, upper)
    at = corners.string(w, upper, left_s, _MOST_LOOKS)[1]
    if at is None:
        return None
    bends = [w, *corners.z[at].tolist(), 0j]
    legs = [_straight(a, b, power, 0.1 * margin_m) for a, b in pairwise(bends)]
    z = np.concatenate([*legs, [0j]])
    path = np.stack([z.real, z.imag], axis=-1) + goal
    path[0] = start
    return path if world.segments_free(path[:-1], path[1:]).all() else None


def _free(world: World, start: Floats, margin_m: float, left_s: Left) -> Any:
    """The part of free space that the start is in, a margin larger (or smaller), its outline thinned out; None if there
    is no time left, or if that has still to be made and would take longer."""
    part = int(world.free_part(start))
    known = _PARTS.setdefault(world, {})
    is_known = (part, margin_m) in known
    if left_s() <= (0.0 if is_known else _OUTLINED_S * shapely.get_num_coordinates(world.free_parts[part])):
        return None
    if not is_known:
        grown = shapely.buffer(world.free_parts[part], margin_m, quad_segs=_CHORDS_PER_QUARTER)
        known[part, margin_m] = shapely.orient_polygons(shapely.simplify(grown, _THINNING * abs(margin_m)))
    return known[part, margin_m]


class _Corners:
    """The corners of obstacles around a goal, which is the origin; in the plane of levers to the power ``power``."""

    def __init__(self, z: Complexes, before: Ints, after: Ints, power: int) -> None:
        self.z, self._power = z, power
        self._before, self._after = before, after  # itself where that side has been left out
        self._angle, self._reach = np.angle(z), np.abs(z) ** power / power
        ahead, back = self._turn(after, self._angle), self._turn(before, self._angle)
        bend = _cross(self._reach - self._at(before, back), self._at(after, ahead) - self._reach)
        self._bends = bend < 0  # free space is on the left of the outline: a string bends where that turns right

    @classmethod
    def of(cls, free: Any, goal: Floats, power: int, margin_m: float) -> _Corners:
        """The corners of free space, its sides cut so that their chords in the plane of that power are near them."""
        rings = [shapely.get_coordinates(ring)[:-1] for ring in shapely.get_rings(shapely.get_parts(free))]
        ring = np.repeat(np.arange(len(rings)), [len(r) for r in rings])
        z = (np.concatenate(rings) - goal) @ np.array([1, 1j])
        while power != _FLAT:
            ends = np.roll(z, -1)
            last = np.flatnonzero(np.diff(ring, append=-1))
            ends[last] = z[np.flatnonzero(np.diff(ring, prepend=-1))]
            step = ends - z
            along = np.clip(-(z * step.conj()).real / np.maximum(np.abs(step) ** 2, 1e-300), 0.0, 1.0)
            near = np.abs(z + along * step)
            cut = np.abs(step) > _CHORD * np.sqrt(margin_m * np.maximum(near, margin_m))
            if not cut.any():
                break
            ring, middle = np.repeat(ring, 1 + cut), z + 0.5 * step
            at = np.cumsum(1 + cut) - (1 + cut)
            finer = np.empty(len(ring), dtype=complex)
            finer[at], finer[at[cut] + 1] = z, middle[cut]
            z = finer
        first = np.flatnonzero(np.diff(ring, prepend=-1))
        after = np.arange(1, len(z) + 1)
        after[np.append(first[1:], len(ring)) - 1] = first
        return cls(z, np.argsort(after), after, power)

    def near(self, start: complex, upper: float) -> _Corners:
        """What of it the ways from a start to the goal that are no longer than ``upper`` may touch."""
        angle, reach = _polar(start, self._power)
        every = np.arange(len(self.z))
        turn = self._turn(every, angle)
        direct = np.abs(self._at(every, np.clip(turn, -np.pi, np.pi)) - reach)  # over the goal if not in sight
        way = direct + self._reach
        between = self._turn(self._after, self._angle)
        side = np.abs(self._at(self._after, between) - self._reach)
        kept = np.minimum(way, way[self._after]) <= upper * (1 + _SLACK) + side
        corners = np.flatnonzero(kept | kept[self._before])
        number = np.empty(len(self.z), dtype=np.intp)
        number[corners] = same = np.arange(len(corners))
        before = np.where(kept[self._before[corners]], number[self._before[corners]], same)
        after = np.where(kept[corners], number[self._after[corners]], same)
        return _Corners(self.z[corners], before, after, self._power)

    def string(self, start: complex, upper: float, left_s: Left, most_looks: float) -> tuple[float, list[int] | None]:
        """The shortest string from the start to the goal, and the corners it bends at; if none is below ``upper``, or
        none was found in time or with so many looks, a length that every string has, and None."""
        power, goal = self._power, len(self.z)
        to_goal = np.append(self._reach, 0.0)
        far = np.full(goal + 1, np.inf)
        came_from = np.full(goal + 1, -1)
        done = np.zeros(goal + 1, dtype=bool)
        queue, looks = [(abs(start) ** power / power, -1, 0.0)], 0
        while queue:
            bound, corner, gone = heapq.heappop(queue)
            looks += goal
            if bound >= upper * (1 + _SLACK) or looks > most_looks or left_s() <= 0:
                return bound, None
            if corner == goal:
                bends = [int(came_from[goal])]
                while bends[-1] >= 0:
                    bends.append(int(came_from[bends[-1]]))
                return bound, bends[-2::-1]
            if corner >= 0:
                if done[corner]:
                    continue
                done[corner] = True
            seen, distance = self._visible(corner, start, far - gone, upper - gone)
            better = ~done[seen] & (gone + distance < far[seen])
            seen, distance = seen[better], distance[better]
            far[seen], came_from[seen] = gone + distance, corner
            for k in seen.tolist():
                heapq.heappush(queue, (float(far[k] + to_goal[k]), k, float(far[k])))
        return upper, None

    def _visible(self, corner: int, start: complex, nearer_than: Floats, upper: float) -> tuple[Ints, Floats]:
        """Corners, or the goal (one after the last), to which a string may run from one corner or the start; and how
        far each is."""
        angle, reach = (self._angle[corner], self._reach[corner]) if corner >= 0 else _polar(start, self._power)
        turn = self._turn(np.arange(len(self.z)), angle)
        there = self._at(np.arange(len(self.z)), turn) - reach
        here = np.abs(turn) < np.pi if self._power != _FLAT else np.ones(len(turn), dtype=bool)
        distance = np.abs(there)
        wanted = here & self._bends & (distance < nearer_than[:-1]) & (distance + self._reach <= upper * (1 + _SLACK))
        before, after = self._before, self._after
        # A taut string touches at its corners: both sides that meet there lie on one side of it.
        slack = -_SLACK * distance
        left, right = _cross(there, there[after] - there), _cross(there, there[before] - there)
        through = here[after] & here[before] & (left * right < slack * (np.abs(left) + np.abs(right)))
        wanted &= ~through
        to = np.flatnonzero(wanted)
        to = to[to != corner]
        ends, to = np.append(there[to], -reach), np.append(to, len(self.z))
        if corner >= 0:
            a, b = there[after[corner]], there[before[corner]]
            taut = _cross(ends, a) * _cross(ends, b) >= -_SLACK * np.abs(ends) ** 2 * abs(a * b)
            ends, to = ends[taut], to[taut]
        solid = here & here[after] & (np.abs(turn - turn[after]) < np.pi)
        # what meets the outline there goes on behind it, or beside it
        past = np.where(through, -_SLACK_RAD, _SLACK_RAD)
        visible = ~_blocked(ends, there[solid], there[after][solid], past[solid], past[after][solid])
        return to[visible], np.abs(ends[visible])

    def _turn(self, corners: Ints, angle: Floats | float) -> Floats:
        """By how much corners are turned about the goal, in the plane of the power, seen from an angle."""
        return self._power * ((self._angle[corners] - angle + np.pi) % (2 * np.pi) - np.pi)

    def _at(self, corners: Ints, turn: Floats) -> Complexes:
        return np.asarray(self._reach[corners] * np.exp(1j * turn))


def _blocked(ends: Complexes, a: Complexes, b: Complexes, slack_a: Floats, slack_b: Floats) -> Bools:
    """Which straight lines from the origin to ``ends`` cross one of the sides from ``a`` to ``b``, by more than a slack
    (rad) from its ends."""
    order = np.argsort(np.angle(ends), kind="stable")
    angle = np.angle(ends)[order]
    round_twice = np.concatenate([angle, angle + 2 * np.pi])
    opening = np.angle(b * a.conj())
    ahead = opening >= 0
    first = np.where(ahead, np.angle(a), np.angle(b))
    low = np.searchsorted(round_twice, first + np.where(ahead, slack_a, slack_b))
    high = np.searchsorted(round_twice, first + np.abs(opening) - np.where(ahead, slack_b, slack_a))
    count = np.maximum(high - low, 0)
    side = np.repeat(np.arange(len(a)), count)
    step = np.arange(len(side)) - np.repeat(np.cumsum(count) - count, count)
    line = order[(np.repeat(low, count) + step) % len(order)]
    along, to = b[side] - a[side], ends[line]
    slant = _cross(to, along)
    share = _cross(a[side], along) / np.where(slant != 0, slant, np.inf)  # of the line, where it meets the side
    blocked = np.zeros(len(ends), dtype=bool)
    blocked[line[(share > _SLACK) & (share < 1 - _SLACK)]] = True
    return blocked


def _straight(a: complex, b: complex, power: int, sag_m: float) -> Complexes:
    """Points along the straight line of the plane of the power from ``a`` on, without the end ``b``."""
    if power == _FLAT or b == 0:
        return np.array([a])
    turn = np.angle(b * np.conj(a))
    count = int(np.ceil(abs(b - a) / (2 * np.sqrt(sag_m * max(min(abs(a), abs(b)), sag_m)))))
    ends = abs(a) ** power, abs(b) ** power * np.exp(1j * power * turn)
    line = ends[0] + (ends[1] - ends[0]) * np.arange(count) / count
    return np.asarray(np.abs(line) ** (1 / power) * np.exp(1j * (np.angle(line) / power + np.angle(a))))


def _polar(z: complex, power: int) -> tuple[float, float]:
    return float(np.angle(z)), abs(z) ** power / power


def _cross(a: Complexes, b: Complexes | complex) -> Floats:
    return np.asarray((np.conj(a) * b).imag)
