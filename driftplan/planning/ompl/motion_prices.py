"""Prices of single OMPL motions as functions of two states, written for callbacks: plain floats, no arrays.

Each function returned holds numbers, an OMPL space at most, and reads its states at once: OMPL reuses their memory.
The formulas are those of `driftplan.planning.cost`, which explains them and does the same in bulk.
"""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, cos, hypot, pi, remainder, sin, sqrt, tau
from typing import Any

from ompl import base as ob

from driftplan.planning.cost import CostRates
from driftplan.planning.ompl.curves import after_arc
from driftplan.planning.ompl.spaces import CurveFinder, SpaceKind, position_reader
from driftplan.planning.ompl.zone_lookup import ZoneLookup

Price = Callable[[Any, Any], Any]
Point = tuple[float, ...]

_ROUND_DOWN = 1 - 1e-14  # a heuristic equals the cost on straight runs at the goal; rounding must not lift it above


def motion_cost_of(
    space: Any, kind: SpaceKind, goal: Point, rates: CostRates, zones: ZoneLookup[CostRates] | None
) -> Price:
    """The cost of an OMPL motion between two states of ``space``, m²."""
    if kind.is_curved:
        return _curve(CurveFinder(space), goal, rates, zones)
    if zones is not None:
        return _zoned(kind, goal, zones)
    if kind.dimensions == 3:
        return _space(kind, goal, rates)
    return (_plane if kind is SpaceKind.PLANE else _pose)(goal, rates)


def following(goal: Callable[[], Point], prices: Callable[[Point], tuple[Price, Price]]) -> tuple[Price, Price]:
    """Prices that are made anew whenever the goal is at another place than when the last one was asked for."""
    at = goal()
    cost, bound = prices(at)

    def motion(a: Any, b: Any) -> Any:
        if goal() != at:
            renew()
        return cost(a, b)

    def heuristic(a: Any, b: Any) -> Any:
        if goal() != at:
            renew()
        return bound(a, b)

    def renew() -> None:
        nonlocal at, cost, bound
        at = goal()
        cost, bound = prices(at)

    return motion, heuristic


# Straight motions


def _plane(goal: Point, rates: CostRates) -> Price:
    # With s = w0 + w1, d = w0 - w1: (|w0|² + w0·w1 + |w1|²)/3 = (3|s|² + |d|²)/12, which takes the fewest operations.
    # Closure variables are looked up faster than attributes and globals.
    Cost, root = ob.Cost, sqrt
    gx, gy = 2 * goal[0], 2 * goal[1]
    by_sum, by_step, q = rates.heading / 4, rates.heading / 12, rates.position

    def motion(a: Any, b: Any) -> Any:
        x0 = a[0]
        y0 = a[1]
        x1 = b[0]
        y1 = b[1]
        u = gx - x0 - x1
        v = gy - y0 - y1
        dx = x0 - x1
        dy = y0 - y1
        d = dx * dx + dy * dy
        return Cost((by_sum * (u * u + v * v) + by_step * d + q) * root(d))

    return motion


def _pose(goal: Point, rates: CostRates) -> Price:
    Cost, root, full_turn, rest = ob.Cost, sqrt, tau, remainder
    gx, gy = 2 * goal[0], 2 * goal[1]
    by_sum, by_step, q = rates.heading / 4, rates.heading / 12, rates.position
    turn_by_sum, turn_by_step, turn_q = rates.turn_heading / 4, rates.turn_heading / 12, rates.turn_position
    turns_cost = not rates.turn_heading == rates.turn_position == 0

    def motion(a: Any, b: Any) -> Any:
        x0 = a.getX()
        y0 = a.getY()
        x1 = b.getX()
        y1 = b.getY()
        u = gx - x0 - x1
        v = gy - y0 - y1
        dx = x0 - x1
        dy = y0 - y1
        d = dx * dx + dy * dy
        s = u * u + v * v
        cost = (by_sum * s + by_step * d + q) * root(d)
        if turns_cost:
            cost += (turn_by_sum * s + turn_by_step * d + turn_q) * abs(rest(b.getYaw() - a.getYaw(), full_turn))
        return Cost(cost)

    return motion


def _zoned(kind: SpaceKind, goal: Point, zones: ZoneLookup[CostRates]) -> Price:
    Cost, read, has_yaw = ob.Cost, position_reader(kind), kind is SpaceKind.POSE

    def motion(a: Any, b: Any) -> Any:
        (x0, y0), (x1, y1) = read(a), read(b)
        turn = abs(remainder(b.getYaw() - a.getYaw(), tau)) if has_yaw else 0.0
        wx, wy, dx, dy = goal[0] - x0, goal[1] - y0, x0 - x1, y0 - y1
        length, ww, wd, dd = hypot(dx, dy), wx * wx + wy * wy, wx * dx + wy * dy, dx * dx + dy * dy
        total = 0.0
        for begin, end, r in zones.pieces(x0, y0, x1, y1):
            # the mean of |w + s d|² for s from begin to end
            mean_square = ww + (begin + end) * wd + (begin * begin + begin * end + end * end) / 3 * dd
            by_heading = (r.heading * length + r.turn_heading * turn) * max(mean_square, 0.0)
            total += (end - begin) * (by_heading + r.position * length + r.turn_position * turn)
        return Cost(total)

    return motion


def _space(kind: SpaceKind, goal: Point, rates: CostRates) -> Price:
    Cost, root, read = ob.Cost, sqrt, position_reader(kind)
    gx, gy, gz = (2 * g for g in goal)
    by_sum, by_step, q = rates.heading / 4, rates.heading / 12, rates.position
    turn_by_sum, turn_by_step, turn_q = rates.turn_heading / 4, rates.turn_heading / 12, rates.turn_position
    turns = kind is SpaceKind.FLIGHT and not rates.turn_heading == rates.turn_position == 0

    def motion(a: Any, b: Any) -> Any:
        x0, y0, z0 = read(a)
        x1, y1, z1 = read(b)
        u, v, w = gx - x0 - x1, gy - y0 - y1, gz - z0 - z1
        dx, dy, dz = x0 - x1, y0 - y1, z0 - z1
        d = dx * dx + dy * dy + dz * dz
        s = u * u + v * v + w * w
        cost = (by_sum * s + by_step * d + q) * root(d)
        if turns:
            cost += (turn_by_sum * s + turn_by_step * d + turn_q) * attitude_step(a.rotation(), b.rotation())
        return Cost(cost)

    return motion


def attitude_step(p: Any, q: Any) -> float:
    """Angle in [0, π] between two attitudes (OMPL's SO(3) states), exact for small ones too."""
    px, py, pz, pw, qx, qy, qz, qw = p.x, p.y, p.z, p.w, q.x, q.y, q.z, q.w
    apart = hypot(px - qx, py - qy, pz - qz, pw - qw)
    opposite = hypot(px + qx, py + qy, pz + qz, pw + qw)
    return 4 * atan2(min(apart, opposite), max(apart, opposite))


# Curves


def _curve(finder: CurveFinder, goal: Point, rates: CostRates, zones: ZoneLookup[CostRates] | None) -> Price:
    Cost = ob.Cost
    radius = finder.turning_radius
    if zones is not None:
        return _zoned_curve(finder, goal, zones)

    gx, gy = goal
    q, p = rates.heading, rates.position
    arc_q, arc_p = q + rates.turn_heading / radius, p + rates.turn_position / radius

    def motion(a: Any, b: Any) -> Any:
        yaw = a.getYaw()
        wx, wy, c, s = gx - a.getX(), gy - a.getY(), cos(yaw), sin(yaw)
        total = 0.0
        for turns, sense in finder(a, b):
            if turns == 0.0:
                continue
            length = turns * radius
            if sense == 0:
                x, y = wx - length * c, wy - length * s
                squares = wx * wx + wx * x + x * x + wy * wy + wy * y + y * y
                total += (q * squares / 3 + p) * abs(length)
                wx, wy = x, y
                continue
            turn, r = turns * sense, sense * radius
            yaw += turn
            c1, s1 = cos(yaw), sin(yaw)
            if -0.1 < turn < 0.1:
                total += _arc(rates, wx, wy, c, s, length, 1 / r)
            else:  # the same, with the sines that are at hand
                along, across, lag = wx * c + wy * s, wx * s - wy * c, turn - (s1 * c - c1 * s)
                swung = (1 - c * c1 - s * s1) * along - lag * (across + r)
                total += arc_q * abs(length * (wx * wx + wy * wy) - 2 * r * r * swung) + arc_p * abs(length)
            wx, wy = wx - r * (s1 - s), wy - r * (c - c1)
            c, s = c1, s1
        return Cost(total)

    return motion


def _zoned_curve(finder: CurveFinder, goal: Point, zones: ZoneLookup[CostRates]) -> Price:
    Cost = ob.Cost
    gx, gy = goal
    radius = finder.turning_radius

    def motion(a: Any, b: Any) -> Any:
        x, y, yaw = a.getX(), a.getY(), a.getYaw()
        total = 0.0
        for length, sense in finder(a, b):
            length *= radius
            curvature = sense / radius
            for px, py, heading, part, there in zones.arc_pieces(x, y, yaw, length, curvature):
                total += _arc(there, gx - px, gy - py, cos(heading), sin(heading), part, curvature)
            x, y, yaw = after_arc(x, y, yaw, length, curvature)
        return Cost(total)

    return motion


def _arc(rates: CostRates, wx: float, wy: float, c: float, s: float, length: float, curvature: float) -> float:
    """Cost of an arc of signed length that begins at lever w = (wx, wy) in direction u = (c, s).

    With x = curvature * length, ``∫|w|² = L|w|² - 2L²(A w·u - xB w×u) + 2L³B``, A = (1 - cos x)/x², B = (x - sin x)/x³.
    """
    t = curvature * length
    if abs(t) < 0.1:
        t2 = t * t
        swing = 0.5 - t2 / 24 * (1 - t2 / 30 * (1 - t2 / 56))  # (1 - cos t)/t²
        bend = (1 - t2 / 20 * (1 - t2 / 42 * (1 - t2 / 72))) / 6  # (t - sin t)/t³
    else:
        swing = (1 - cos(t)) / (t * t)
        bend = (t - sin(t)) / (t * t * t)
    along, across = wx * c + wy * s, wx * s - wy * c
    squares = abs(length) * (
        wx * wx + wy * wy - 2 * length * (swing * along - t * bend * across) + 2 * length * length * bend
    )
    bent = abs(curvature)
    by_heading = (rates.heading + rates.turn_heading * bent) * max(squares, 0.0)
    return by_heading + (rates.position + rates.turn_position * bent) * abs(length)


# Lower bounds


def heuristic_of(space: Any, kind: SpaceKind, goal: Point, rates: CostRates) -> Price:
    """A lower bound, m², of the cost of any way between two states; ``rates`` are the least of the whole map."""
    Cost, read = ob.Cost, position_reader(kind)
    gx, gy, gz = (*goal, 0.0)[:3]
    q_h, q_p = rates.heading * _ROUND_DOWN, rates.position * _ROUND_DOWN
    # OMPL's distance is the length driven, and a metric; not so where Dubins curves may be driven either way.
    is_metric = kind is SpaceKind.REEDS_SHEPP or (kind is SpaceKind.DUBINS and not space.hasSymmetricDistance())
    driven = space.distance if is_metric else None

    def bound(a: Any, b: Any) -> Any:
        x0, y0, z0 = (*read(a), 0.0)[:3]
        x1, y1, z1 = (*read(b), 0.0)[:3]
        dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
        ax, ay, az, bx, by, bz = gx - x0, gy - y0, gz - z0, gx - x1, gy - y1, gz - z1
        cross = hypot(dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax)
        growth = dx * (ax + bx) + dy * (ay + by) + dz * (az + bz)
        metric = _cone_distance(hypot(ax, ay, az), hypot(bx, by, bz), growth, cross, ax * bx + ay * by + az * bz)
        return Cost(q_h * metric + q_p * (hypot(dx, dy, dz) if driven is None else driven(a, b)))

    return bound


def _cone_distance(r0: float, r1: float, growth: float, cross: float, dot: float) -> float:
    """See `driftplan.planning.cost.geodesic_cost`; ``growth`` is r0² - r1², formed without cancellation."""
    if r0 == 0.0 or r1 == 0.0:
        return (r0**3 + r1**3) / 3
    angle = atan2(cross, dot)
    if angle >= pi / 3:
        return (r0**3 + r1**3) / 3
    radial = growth / (r0 + r1) * (r0 * r0 + r0 * r1 + r1 * r1)
    rr = r0 * r1
    return hypot(radial, 2 * rr * sqrt(rr) * sin(1.5 * angle)) / 3
