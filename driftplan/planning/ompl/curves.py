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

L, S, R = 1, 0, -1  # sense of the curvature
SAME_LENGTH = 1e-7  # turning radii: OMPL rounds angles to zero from about there
_ROUND = 1e-9  # rad, and squared lengths: this far below zero is zero
# As OMPL rounds Dubins curves: its states of a curve have headings and places in which rounding shows, and an arc that
# is a full turn less than this in one of the two is none in the other.
_DUBINS_FULL_TURN = tau - 5e-7  # rad: a turn from here on is none
_DUBINS_ROOT = -1e-7  # a squared length from here to zero is zero
_DUBINS_SAME = 1e-6  # turning radii and rad: poses as close as this are joined by a straight run


Arc = tuple[
    float, int
]  # length in turning radii, negative backwards; sense of the curvature, 1 left, 0 straight, -1 right
Curve = list[Arc]
_Lengths = tuple[float, float, float]


def dubins_curves(
    dx: float, dy: float, yaw_start: float, yaw_end: float, of_length: float | None = None
) -> Iterator[Curve]:
    """The forward curves of at most unit curvature among which the shortest is: at most six.

    From start to end it is (``dx``, ``dy``), in turning radii; only curves ``of_length`` are given, within 1e-7.

    >>> min(dubins_curves(5.0, 0.0, 0.0, 0.0), key=curve_length)
    [(0.0, 1), (5.0, 0), (0.0, 1)]
    """
    d, bearing = hypot(dx, dy), atan2(dy, dx)
    a, b = yaw_start - bearing, yaw_end - bearing
    if d < _DUBINS_SAME and abs(a % tau - b % tau) < _DUBINS_SAME:
        yield [(0.0, L), (d, S), (0.0, L)]
        return
    sa, ca, sb, cb = sin(a), cos(a), sin(b), cos(b)
    # A word that begins with a right turn is the mirror image of one that begins with a left turn.
    for word, middle, last in ((_lsl, S, L), (_lsr, S, R), (_lrl, R, L)):
        for mirror in (1, -1):
            lengths = word(d, mirror * a, mirror * b, mirror * sa, ca, mirror * sb, cb)
            if lengths is not None and _fits(lengths, of_length):
                t, p, q = lengths
                yield [(t, mirror), (p, mirror * middle), (q, mirror * last)]


def reeds_shepp_curves(
    dx: float, dy: float, yaw_start: float, yaw_end: float, of_length: float | None = None
) -> Iterator[Curve]:
    """The same, driven forwards and backwards: at most 48.

    >>> best = min(reeds_shepp_curves(-3.0, 0.0, 0.0, 0.0), key=curve_length)
    >>> [(round(abs(length), 3), sense) for length, sense in best], round(best[1][0], 3)
    ([(0.0, 1), (3.0, 0), (0.0, 1)], -3.0)
    """
    # Reeds and Shepp give one formula per kind of word; the others follow by driving it backwards, by mirroring it, by
    # both, and for some kinds by driving it from its end to its start.
    c, s = cos(yaw_start), sin(yaw_start)
    x, y, phi = c * dx + s * dy, c * dy - s * dx, yaw_end - yaw_start
    for formula, word, build in _WORDS:
        for gear, mirror in ((1, 1), (-1, 1), (1, -1), (-1, -1)):
            found = formula(gear * x, mirror * y, gear * mirror * phi)
            if found is not None:
                lengths = build(*found)
                if _fits(lengths, of_length):
                    yield [(gear * p, mirror * sense) for p, sense in zip(lengths, word, strict=True)]


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


def _fits(lengths: tuple[float, ...], of_length: float | None) -> bool:
    return of_length is None or abs(sum(map(abs, lengths)) - of_length) < SAME_LENGTH


def _root(squared: float, least: float = -_ROUND) -> float | None:
    """Square root, zero for what is below zero by rounding only."""
    return sqrt(max(squared, 0.0)) if squared >= least else None


def _full_turn(angle: float) -> float:
    """In [0, 2π), zero for what is zero but for rounding."""
    angle %= tau
    return 0.0 if angle > _DUBINS_FULL_TURN else angle


# The words of Dubins: first, middle and last length; a and b are the headings at start and end seen from the line that
# joins them, d long; then their sines and cosines.


def _lsl(d: float, a: float, b: float, sa: float, ca: float, sb: float, cb: float) -> _Lengths | None:
    x, y = d + sa - sb, cb - ca
    theta = atan2(y, x)
    return _full_turn(theta - a), hypot(x, y), _full_turn(b - theta)


def _lsr(d: float, a: float, b: float, sa: float, ca: float, sb: float, cb: float) -> _Lengths | None:
    x, y = d + sa + sb, -ca - cb
    p = _root(x * x + y * y - 4, _DUBINS_ROOT)
    if p is None:
        return None
    theta = atan2(y, x) - atan2(-2, p)
    return _full_turn(theta - a), p, _full_turn(theta - b)


def _lrl(d: float, a: float, b: float, sa: float, ca: float, sb: float, cb: float) -> _Lengths | None:
    x, y = d + sa - sb, cb - ca
    cosine = 1 - (x * x + y * y) / 8
    if cosine < -1 - _ROUND:
        return None
    p = tau - acos(max(cosine, -1.0))
    t = _full_turn(atan2(y, x) - a + p / 2)
    return t, p, _full_turn(b - a - t + p)


# Each of Reeds and Shepp's formulas returns the free lengths t, u, v of its word, or None where it has no such curve;
# the end pose is (x, y, phi) seen from the start.

_Word = _Lengths | None


def _half_turn(angle: float) -> float:
    """In (-π, π]."""
    return pi - (pi - angle) % tau


def _positive(angle: float) -> bool:
    return angle >= -_ROUND


def _rs_lsl(x: float, y: float, phi: float) -> _Word:  # 8.1
    x, y = x - sin(phi), y - 1 + cos(phi)
    t = atan2(y, x)
    v = _half_turn(phi - t)
    return (t, hypot(x, y), v) if _positive(t) and _positive(v) else None


def _rs_lsr(x: float, y: float, phi: float) -> _Word:  # 8.2
    x, y = x + sin(phi), y - 1 - cos(phi)
    u = _root(x * x + y * y - 4)
    if u is None:
        return None
    t = _half_turn(atan2(y, x) + atan2(2, u))
    v = _half_turn(t - phi)
    return (t, u, v) if _positive(t) and _positive(v) else None


def _rs_lrl(x: float, y: float, phi: float) -> _Word:  # 8.3, 8.4
    x, y = x - sin(phi), y - 1 + cos(phi)
    r = hypot(x, y)
    if r > 4 + _ROUND:
        return None
    u = -2 * asin(min(r / 4, 1.0))
    t = _half_turn(atan2(y, x) + u / 2 + pi)
    v = _half_turn(phi - t + u)
    return (t, u, v) if _positive(t) else None


def _rs_lrlr_cusp_inside(x: float, y: float, phi: float) -> _Word:  # 8.7
    x, y = x + sin(phi), y - 1 - cos(phi)
    cosine = (2 + hypot(x, y)) / 4
    if cosine > 1 + _ROUND:
        return None
    u = acos(min(cosine, 1.0))
    t, v = _outer_arcs(u, -u, x, y, phi)
    return (t, u, v) if _positive(t) and _positive(-v) else None


def _rs_lrlr_cusps_outside(x: float, y: float, phi: float) -> _Word:  # 8.8
    x, y = x + sin(phi), y - 1 - cos(phi)
    cosine = (20 - x * x - y * y) / 16
    if not -_ROUND <= cosine <= 1 + _ROUND:
        return None
    u = -acos(min(max(cosine, 0.0), 1.0))
    t, v = _outer_arcs(u, u, x, y, phi)
    return (t, u, v) if _positive(t) and _positive(v) else None


def _outer_arcs(u: float, v: float, x: float, y: float, phi: float) -> tuple[float, float]:
    delta = _half_turn(u - v)
    a, b = sin(u) - sin(delta), cos(u) - cos(delta) - 1
    t = atan2(y * a - x * b, x * a + y * b)
    if 2 * (cos(delta) - cos(v) - cos(u)) + 3 < 0:
        t += pi
    t = _half_turn(t)
    return t, _half_turn(t - u + v - phi)


def _rs_lrsl(x: float, y: float, phi: float) -> _Word:  # 8.9
    x, y = x - sin(phi), y - 1 + cos(phi)
    r = _root(x * x + y * y - 4)
    if r is None:
        return None
    t, u = _half_turn(atan2(y, x) + atan2(r, -2)), 2 - r
    v = _half_turn(phi - pi / 2 - t)
    return (t, u, v) if _positive(t) and u <= 0 and _positive(-v) else None


def _rs_lrsr(x: float, y: float, phi: float) -> _Word:  # 8.10
    x, y = x + sin(phi), y - 1 - cos(phi)
    t, u = atan2(x, -y), 2 - hypot(x, y)
    v = _half_turn(t + pi / 2 - phi)
    return (t, u, v) if _positive(t) and u <= 0 and _positive(-v) else None


def _rs_lrslr(x: float, y: float, phi: float) -> _Word:  # 8.11
    x, y = x + sin(phi), y - 1 - cos(phi)
    r = _root(x * x + y * y - 4)
    if r is None or r < 4:
        return None
    u = 4 - r
    t = _half_turn(atan2((4 - u) * x - 2 * y, -2 * x + (u - 4) * y))
    v = _half_turn(t - phi)
    return (t, u, v) if _positive(t) and _positive(v) else None


def _from_the_end(formula: Callable[[float, float, float], _Word]) -> Callable[[float, float, float], _Word]:
    """The same word driven from its end to its start."""
    return lambda x, y, phi: formula(x * cos(phi) + y * sin(phi), x * sin(phi) - y * cos(phi), phi)


_QUARTER = pi / 2
_WORDS: tuple[
    tuple[Callable[[float, float, float], _Word], tuple[int, ...], Callable[[float, float, float], tuple[float, ...]]],
    ...,
] = (
    (_rs_lsl, (L, S, L), lambda t, u, v: (t, u, v)),
    (_rs_lsr, (L, S, R), lambda t, u, v: (t, u, v)),
    (_rs_lrl, (L, R, L), lambda t, u, v: (t, u, v)),
    (_from_the_end(_rs_lrl), (L, R, L), lambda t, u, v: (v, u, t)),
    (_rs_lrlr_cusp_inside, (L, R, L, R), lambda t, u, v: (t, u, -u, v)),
    (_rs_lrlr_cusps_outside, (L, R, L, R), lambda t, u, v: (t, u, u, v)),
    (_rs_lrsl, (L, R, S, L), lambda t, u, v: (t, -_QUARTER, u, v)),
    (_rs_lrsr, (L, R, S, R), lambda t, u, v: (t, -_QUARTER, u, v)),
    (_from_the_end(_rs_lrsl), (L, S, R, L), lambda t, u, v: (v, u, -_QUARTER, t)),
    (_from_the_end(_rs_lrsr), (R, S, R, L), lambda t, u, v: (v, u, -_QUARTER, t)),
    (_rs_lrslr, (L, R, S, L, R), lambda t, u, v: (t, -_QUARTER, u, -_QUARTER, v)),
)
