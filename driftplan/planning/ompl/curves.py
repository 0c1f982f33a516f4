"""Shortest curves of bounded curvature between two poses, as lists of arcs: Dubins and Reeds-Shepp.

OMPL finds these curves too but does not say what they are made of, and an exact price needs every arc. Lengths are in
units of the turning radius; negative lengths are driven backwards.

Sources: A. Shkel and V. Lumelsky, Classification of the Dubins set, Robotics and Autonomous Systems 34 (2001), eqs.
(11)-(16); J. Reeds and L. Shepp, Optimal paths for a car that goes both forwards and backwards, Pacific Journal of
Mathematics 145 (1990), formulas 8.1-8.11.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import acos, asin, atan2, cos, hypot, pi, sin, sqrt, tau
from typing import Any

L, S, R = 1, 0, -1  # sense of the curvature
SAME_LENGTH = 1e-7  # turning radii: OMPL rounds angles to zero from about there
_ROUND = 1e-9  # rad, and squared lengths: this far below zero is zero
# As OMPL rounds Dubins curves: its states of a curve have headings and places in which rounding shows, and an arc that
# is a full turn less than this in one of the two is none in the other.
_FULL_TURN = tau - 5e-7  # rad: a turn from here on is none
_DUBINS_ROOT = -1e-7  # a squared length from here to zero is zero
_DUBINS_SAME = 1e-6  # turning radii and rad: poses as close as this are joined by a straight run


Arc = tuple[
    float, int
]  # length in turning radii, negative backwards; sense of the curvature, 1 left, 0 straight, -1 right
Curve = list[Arc]
DubinsWord = tuple[float, float, int, float, int, float, int]


def dubins_curves(
    dx: float, dy: float, yaw_start: float, yaw_end: float, of_length: float | None = None
) -> Iterator[Curve]:
    """The forward curves of at most unit curvature among which the shortest is: at most six.

    From start to end it is (``dx``, ``dy``), in turning radii; only curves ``of_length`` are given, within 1e-7.

    >>> min(dubins_curves(5.0, 0.0, 0.0, 0.0), key=curve_length)
    [(0.0, 1), (5.0, 0), (0.0, 1)]
    """
    for length, t, first, p, middle, q, last in dubins_words(dx, dy, yaw_start, yaw_end):
        if of_length is None or abs(length - of_length) < SAME_LENGTH:
            yield [(t, first), (p, middle), (q, last)]


def dubins_words(dx: float, dy: float, yaw_start: float, yaw_end: float) -> list[DubinsWord]:
    """The same curves, each as its length, then the length and the sense of every arc."""
    d, bearing = hypot(dx, dy), atan2(dy, dx)
    a, b = yaw_start - bearing, yaw_end - bearing  # the headings seen from the line that joins the ends
    if d < _DUBINS_SAME and abs(a % tau - b % tau) < _DUBINS_SAME:
        return [(d, 0.0, L, d, S, 0.0, L)]
    sa, ca, sb, cb = sin(a), cos(a), sin(b), cos(b)
    words: list[DubinsWord] = []
    # A word that begins with a right turn is the mirror image of one that begins with a left turn. No calls: a planner
    # asks for nothing as often.
    for turn in (L, R):
        x, y = d + sa - sb, cb - ca
        squared, theta = x * x + y * y, atan2(y, x)
        t, p, q = (theta - a) % tau, sqrt(squared), (b - theta) % tau  # left, straight, left
        t, q = t if t <= _FULL_TURN else 0.0, q if q <= _FULL_TURN else 0.0
        words.append((t + p + q, t, turn, p, S, q, turn))
        if squared <= 16 + 8 * _ROUND:
            p = tau - acos(max(1 - squared / 8, -1.0))  # left, right, left
            t = (theta - a + p / 2) % tau
            t = t if t <= _FULL_TURN else 0.0
            q = (b - a - t + p) % tau
            q = q if q <= _FULL_TURN else 0.0
            words.append((t + p + q, t, turn, p, -turn, q, turn))
        x, y = d + sa + sb, -ca - cb
        squared = x * x + y * y - 4
        if squared >= _DUBINS_ROOT:
            p = sqrt(max(squared, 0.0))  # left, straight, right
            theta = atan2(y, x) - atan2(-2, p)
            t, q = (theta - a) % tau, (theta - b) % tau
            t, q = t if t <= _FULL_TURN else 0.0, q if q <= _FULL_TURN else 0.0
            words.append((t + p + q, t, turn, p, S, q, -turn))
        a, b, sa, sb = -a, -b, -sa, -sb
    return words


def reeds_shepp_curves(
    dx: float,
    dy: float,
    yaw_start: float,
    yaw_end: float,
    of_length: float | None = None,
    first: tuple[int, int] | None = None,
) -> Iterator[Curve]:
    """The same, driven forwards and backwards: at most 48; or only those whose ``first`` arc is driven so (1 forwards,
    -1 backwards) and has that sense.

    >>> best = min(reeds_shepp_curves(-3.0, 0.0, 0.0, 0.0), key=curve_length)
    >>> [(round(abs(length), 3), sense) for length, sense in best], round(best[1][0], 3)
    ([(0.0, 1), (3.0, 0), (0.0, 1)], -3.0)
    """
    # Reeds and Shepp give one formula per kind of word; the others follow by driving it backwards, by mirroring it, by
    # both, and for some kinds by driving it from its end to its start.
    c, s = cos(yaw_start), sin(yaw_start)
    x, y, phi = c * dx + s * dy, c * dy - s * dx, yaw_end - yaw_start
    s, c = sin(phi), cos(phi)
    for formula, word, build, middles, fixed, gear, mirror in _BY_FIRST_ARC[first]:
        turned = gear * mirror
        found = formula(gear * x, mirror * y, turned * phi, turned * s, c)
        if found is not None:
            t, u, v = found
            if of_length is None or abs(abs(t) + middles * abs(u) + abs(v) + fixed - of_length) < SAME_LENGTH:
                yield [(gear * p, mirror * sense) for p, sense in zip(build(t, u, v), word, strict=True)]


def curve_length(curve: Curve) -> float:
    """Length driven, in turning radii."""
    return sum([abs(length) for length, _ in curve])


def pose_along(curve: Curve, distance: float) -> tuple[float, float, float]:
    """Position and heading after ``distance`` along a curve, seen from its start, in turning radii and rad.

    >>> [round(v, 3) for v in pose_along([(pi, L), (2.0, S)], pi + 1)]
    [-1.0, 2.0, 3.142]
    """
    x = y = yaw = 0.0
    for length, sense in curve:
        driven = min(abs(length), distance)
        x, y, yaw = after_arc(x, y, yaw, driven if length > 0 else -driven, sense)
        distance -= driven
    return x, y, yaw


def after_arc(x: float, y: float, yaw: float, length: float, curvature: float) -> tuple[float, float, float]:
    """The pose after an arc of signed ``length``."""
    if curvature == 0:
        return x + length * cos(yaw), y + length * sin(yaw), yaw
    turned = yaw + curvature * length
    return x + (sin(turned) - sin(yaw)) / curvature, y + (cos(yaw) - cos(turned)) / curvature, turned


def _root(squared: float) -> float | None:
    """Square root, zero for what is below zero by rounding only."""
    return sqrt(max(squared, 0.0)) if squared >= -_ROUND else None


# Each of Reeds and Shepp's formulas returns the free lengths t, u, v of its word, or None where it has no such curve;
# the end pose is (x, y, phi) seen from the start, s and c are the sine and cosine of phi. pi - (pi - angle) % tau is
# the angle in (-π, π].

_Word = tuple[float, float, float] | None
_Formula = Callable[[float, float, float, float, float], _Word]


def _rs_lsl(x: float, y: float, phi: float, s: float, c: float) -> _Word:  # 8.1
    x, y = x - s, y - 1 + c
    t = atan2(y, x)
    if t < -_ROUND:
        return None
    v = pi - (pi - phi + t) % tau
    return (t, hypot(x, y), v) if v >= -_ROUND else None


def _rs_lsr(x: float, y: float, phi: float, s: float, c: float) -> _Word:  # 8.2
    x, y = x + s, y - 1 - c
    u = _root(x * x + y * y - 4)
    if u is None:
        return None
    t = pi - (pi - atan2(y, x) - atan2(2, u)) % tau
    v = pi - (pi - t + phi) % tau
    return (t, u, v) if t >= -_ROUND and v >= -_ROUND else None


def _rs_lrl(x: float, y: float, phi: float, s: float, c: float) -> _Word:  # 8.3, 8.4
    x, y = x - s, y - 1 + c
    r = hypot(x, y)
    if r > 4 + _ROUND:
        return None
    u = -2 * asin(min(r / 4, 1.0))
    t = pi - (-atan2(y, x) - u / 2) % tau
    v = pi - (pi - phi + t - u) % tau
    return (t, u, v) if t >= -_ROUND else None


def _rs_lrlr_cusp_inside(x: float, y: float, phi: float, s: float, c: float) -> _Word:  # 8.7
    x, y = x + s, y - 1 - c
    cosine = (2 + hypot(x, y)) / 4
    if cosine > 1 + _ROUND:
        return None
    u = acos(min(cosine, 1.0))
    t, v = _outer_arcs(u, -u, x, y, phi)
    return (t, u, v) if t >= -_ROUND and v <= _ROUND else None


def _rs_lrlr_cusps_outside(x: float, y: float, phi: float, s: float, c: float) -> _Word:  # 8.8
    x, y = x + s, y - 1 - c
    cosine = (20 - x * x - y * y) / 16
    if not -_ROUND <= cosine <= 1 + _ROUND:
        return None
    u = -acos(min(max(cosine, 0.0), 1.0))
    t, v = _outer_arcs(u, u, x, y, phi)
    return (t, u, v) if t >= -_ROUND and v >= -_ROUND else None


def _outer_arcs(u: float, v: float, x: float, y: float, phi: float) -> tuple[float, float]:
    delta = pi - (pi - u + v) % tau
    a, b = sin(u) - sin(delta), cos(u) - cos(delta) - 1
    t = atan2(y * a - x * b, x * a + y * b)
    if 2 * (cos(delta) - cos(v) - cos(u)) + 3 < 0:
        t += pi
    t = pi - (pi - t) % tau
    return t, pi - (pi - t + u - v + phi) % tau


def _rs_lrsl(x: float, y: float, phi: float, s: float, c: float) -> _Word:  # 8.9
    x, y = x - s, y - 1 + c
    r = _root(x * x + y * y - 4)
    if r is None:
        return None
    t, u = pi - (pi - atan2(y, x) - atan2(r, -2)) % tau, 2 - r
    v = pi - (1.5 * pi - phi + t) % tau
    return (t, u, v) if t >= -_ROUND and u <= 0 and v <= _ROUND else None


def _rs_lrsr(x: float, y: float, phi: float, s: float, c: float) -> _Word:  # 8.10
    x, y = x + s, y - 1 - c
    t, u = atan2(x, -y), 2 - hypot(x, y)
    v = pi - (pi / 2 - t + phi) % tau
    return (t, u, v) if t >= -_ROUND and u <= 0 and v <= _ROUND else None


def _rs_lrslr(x: float, y: float, phi: float, s: float, c: float) -> _Word:  # 8.11
    x, y = x + s, y - 1 - c
    r = _root(x * x + y * y - 4)
    if r is None or r < 4:
        return None
    u = 4 - r
    t = pi - (pi - atan2((4 - u) * x - 2 * y, -2 * x + (u - 4) * y)) % tau
    v = pi - (pi - t + phi) % tau
    return (t, u, v) if t >= -_ROUND and v >= -_ROUND else None


def _from_the_end(formula: _Formula) -> _Formula:
    """The same word driven from its end to its start."""
    return lambda x, y, phi, s, c: formula(x * c + y * s, x * s - y * c, phi, s, c)


_QUARTER = pi / 2
_Build = Callable[[float, float, float], tuple[float, ...]]
_WORDS: tuple[tuple[int, _Formula, tuple[int, ...], _Build, int, float], ...] = (
    (1, _rs_lsl, (L, S, L), lambda t, u, v: (t, u, v), 1, 0),
    (1, _rs_lsr, (L, S, R), lambda t, u, v: (t, u, v), 1, 0),
    (1, _rs_lrl, (L, R, L), lambda t, u, v: (t, u, v), 1, 0),
    (0, _from_the_end(_rs_lrl), (L, R, L), lambda t, u, v: (v, u, t), 1, 0),
    (1, _rs_lrlr_cusp_inside, (L, R, L, R), lambda t, u, v: (t, u, -u, v), 2, 0),
    (1, _rs_lrlr_cusps_outside, (L, R, L, R), lambda t, u, v: (t, u, u, v), 2, 0),
    (1, _rs_lrsl, (L, R, S, L), lambda t, u, v: (t, -_QUARTER, u, v), 1, _QUARTER),
    (1, _rs_lrsr, (L, R, S, R), lambda t, u, v: (t, -_QUARTER, u, v), 1, _QUARTER),
    (-1, _from_the_end(_rs_lrsl), (L, S, R, L), lambda t, u, v: (v, u, -_QUARTER, t), 1, _QUARTER),
    (-1, _from_the_end(_rs_lrsr), (R, S, R, L), lambda t, u, v: (v, u, -_QUARTER, t), 1, _QUARTER),
    (1, _rs_lrslr, (L, R, S, L, R), lambda t, u, v: (t, -_QUARTER, u, -_QUARTER, v), 1, pi),
)  # sign of the first arc (0: either), formula, senses, arcs, of which how many are u long, and what others take


def _begun(way: int, sense: int) -> list[Any]:
    ways = [(word, gear, mirror) for word in _WORDS for mirror in (1, -1) for gear in (1, -1)]
    return [
        (*word[1:], gear, mirror)
        for word, gear, mirror in ways
        if way == 0 or (gear * word[0] in (0, way) and mirror * word[2][0] == sense)
    ]


_ARCS = ((1, L), (1, R), (-1, L), (-1, R))
_BY_FIRST_ARC: dict[tuple[int, int] | None, list[Any]] = {None: _begun(0, 0), **{arc: _begun(*arc) for arc in _ARCS}}
