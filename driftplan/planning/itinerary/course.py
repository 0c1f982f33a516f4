"""The greatest drift along one path with many readings, fast enough to be asked thousands of times.

The same moments as `driftplan.model.drift.predict_drift` finds, for the same fixes. That takes a numpy scan per hop; on
a path with dozens of readings it is quicker to make all pieces at once, to join them one after the other with Python's
numbers, and to look between the borders in bulk.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon, Readings
from driftplan.model.drift import PointDrift
from driftplan.model.elements import run_moments, turn_moments
from driftplan.model.fixes import Fix, apply_fix
from driftplan.model.heading_laws import law_moments
from driftplan.model.moments import Moments, compose, identity
from driftplan.model.noise import OdometryNoise

_SAG = 1e-7  # relative: what the drift may rise above its checked places
_MOST_PLACES = 20_000


class Course(NamedTuple):
    """Drift along a path.

    Attributes
    ----------
    worst, end : float
        Greatest rms anywhere, and rms at the end, metres.
    s_m : (k,) borders between pieces
    arriving : Moments (k,)
        At the borders, world frame, before the readings there.
    """

    worst: float
    end: float
    s_m: Floats
    arriving: Moments

    def arrival(self, s_m: Floats) -> PointDrift:
        """Drift on arrival at borders."""
        border = np.clip(np.searchsorted(self.s_m, s_m - 1e-9), 0, len(self.s_m) - 1)
        return PointDrift(self.s_m[border], self.arriving[border])


class ReadingLaws:
    """What readings of each beacon do, in Python's numbers."""

    def __init__(self, beacons: Sequence[Beacon]) -> None:
        self.known: list[tuple[float | None, tuple[float, float] | None]] = []
        for beacon in beacons:
            position, heading = beacon.kind.position_std_m, beacon.kind.heading_std
            law = None
            if heading is not None:
                moments = law_moments("gaussian", np.asarray(heading**2))
                law = (float(moments.d1), float(moments.d2))
            self.known.append((None if position is None else 2 * position**2, law))

    def read(self, state: Moments, site: int, chance: float) -> Moments:
        """The state after a reading, see `driftplan.model.fixes.apply_fix`."""
        trace, law = self.known[site]
        d1, d2, D, e1, N, e2 = state.d1, state.d2, state.D, state.e1, state.N, state.e2
        if law is not None:
            d1, d2, D = law[0], law[1], -2 * law[0]  # type: ignore[assignment]
        if trace is not None:
            e1, N, e2 = 0.0, trace, 0.0  # type: ignore[assignment]
        a, b = e1 * d1.conjugate(), e1 * d1
        if chance == 1:
            return Moments(state.u, state.p, d1, d2, D, e1, N, e2, a, b)
        old = (state.d1, state.d2, state.D, state.e1, state.N, state.e2, state.a, state.b)
        mixed = ((1 - chance) * x + chance * y for x, y in zip(old, (d1, d2, D, e1, N, e2, a, b), strict=True))
        return Moments(state.u, state.p, *mixed)


def follow(
    path: Floats,
    noises: Sequence[OdometryNoise],
    readings: Readings,
    laws: ReadingLaws,
    initial: Fix | None,
    start_heading: float | None,
) -> Course:
    """The drift along a path (n, 2) without repeated points, each leg with its noise.

    Readings are taken in the order of their place and rank.
    """
    step = np.diff(path, axis=0) @ np.array([1.0, 1j])
    length = np.abs(step)
    course = step / length
    ends = np.concatenate([[0.0], np.cumsum(length)])
    order = np.lexsort((readings.rank, readings.s_m))
    at = np.minimum(readings.s_m[order], ends[-1])
    near = np.clip(np.searchsorted(ends, at), 1, len(ends) - 1)
    near = np.where(at - ends[near - 1] < ends[near] - at, near - 1, near)
    at = np.where(np.abs(at - ends[near]) < 1e-9, ends[near], at)
    borders = np.unique(np.concatenate([ends, at]))
    leg = np.clip(np.searchsorted(ends, borders[:-1], side="right") - 1, 0, len(length) - 1)
    kinds = list(dict.fromkeys(noises))
    kind = np.array([kinds.index(noise) for noise in noises])[leg]
    driven = np.diff(borders)
    runs = _in_world(_runs(driven, kind, kinds), course[leg])
    turns = _turns(course, ends, borders[:-1], leg, kind, kinds, start_heading)

    start = identity() if initial is None else apply_fix(identity(), initial)
    state = _scalar(start)
    due: dict[int, list[tuple[int, float]]] = {}
    columns = (np.searchsorted(borders, at), readings.beacon[order], readings.chance[order])
    for border, site, chance in zip(*(x.tolist() for x in columns), strict=True):
        due.setdefault(border, []).append((site, chance))
    pieces = [Moments(*numbers) for numbers in zip(*(x.tolist() for x in runs.arrays()), strict=True)]
    arriving, leaving = [state], []
    for k, piece in enumerate(pieces):
        for site, chance in due.get(k, ()):
            state = laws.read(state, site, chance)
        if k in turns:
            state = compose(state, turns[k])
        leaving.append(state)
        state = compose(state, piece)
        arriving.append(state)
    for site, chance in due.get(len(pieces), ()):
        state = laws.read(state, site, chance)

    begun = _stacked(leaving)
    before = _stacked(arriving)
    end = float(state.N)
    greatest = max(float(before.N[1:].max()), float(begun.N.max()), end)  # at the start: after the readings there
    inside = _inside(begun, driven, course[leg], kind, kinds, math.sqrt(max(greatest, 0.0)))
    worst = math.sqrt(max(greatest, inside, 0.0))
    u = np.concatenate([course[leg], course[-1:]])
    before = Moments(u, *before.arrays()[1:])
    return Course(worst, math.sqrt(max(end, 0.0)), borders, before)


def _runs(length: Floats, kind: NDArray[Any], kinds: Sequence[OdometryNoise]) -> Moments:
    if len(kinds) == 1:
        return run_moments(length, np.zeros(len(length)), kinds[0])
    arrays = [np.zeros(len(length), complex) for _ in range(10)]
    for k, noise in enumerate(kinds):
        here = np.flatnonzero(kind == k)
        part = run_moments(length[here], np.zeros(len(here)), noise)
        for array, values in zip(arrays, part.arrays(), strict=True):
            array[here] = values
    u, p, d1, d2, D, e1, N, e2, a, b = arrays
    return Moments(u, p, d1, d2, D.real, e1, N.real, e2, a, b)


def _in_world(pieces: Moments, direction: NDArray[Any]) -> Moments:
    """Pieces that begin in a direction as motions of a frame that never turns."""
    turned = pieces.rotated(direction)
    return Moments(np.ones(pieces.shape), *turned.arrays()[1:])


def _turns(
    course: NDArray[Any],
    ends: Floats,
    begins: Floats,
    leg: NDArray[Any],
    kind: NDArray[Any],
    kinds: Sequence[OdometryNoise],
    start_heading: float | None,
) -> dict[int, Moments]:
    """The turn before each piece that begins a leg; those without noise are left out."""
    if not any(k.heading_var_per_rad or k.distance_var_per_rad or k.heading_bias_per_rad for k in kinds):
        return {}
    facing = course[:1] if start_heading is None else np.exp(1j * np.array([start_heading]))
    facing = np.concatenate([facing, course[:-1]])
    angle = np.angle(course * np.conj(facing))
    found = {}
    for k in np.flatnonzero(begins == ends[leg]).tolist():
        j = int(leg[k])
        if angle[j] != 0:
            turn = turn_moments(angle[j : j + 1], kinds[int(kind[k])])
            found[k] = _scalar(_in_world(turn, facing[j : j + 1])[0])
    return found


def _inside(
    begun: Moments,
    length: Floats,
    direction: NDArray[Any],
    kind: NDArray[Any],
    kinds: Sequence[OdometryNoise],
    worst: float,
) -> float:
    """Greatest E|e|² inside the pieces, looked for so closely that `_SAG` is all that is missed.

    By the differential equation of E|e|² in `driftplan.layouts.placement.tracks` it rises above the ends of a run of
    length h by at most ``|μ| h² rms / 4``.
    """
    rate = np.array([abs(complex(k.heading_var_per_m / 2, k.heading_bias_per_m)) for k in kinds])[kind]
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = np.ceil(length * np.sqrt(rate / (4 * _SAG * worst)))
    parts = np.where(np.isfinite(parts), parts, 1.0)
    parts = np.clip(parts, 1, max(_MOST_PLACES // len(length), 2)).astype(np.intp)
    piece = np.repeat(np.arange(len(length)), parts - 1)
    if not len(piece):
        return 0.0
    share = (np.arange(len(piece)) - np.repeat(np.cumsum(parts - 1) - (parts - 1), parts - 1) + 1) / parts[piece]
    runs = _in_world(_runs(length[piece] * share, kind[piece], kinds), direction[piece])
    return float(compose(begun[piece], runs).N.real.max())


def _scalar(moments: Moments) -> Moments:
    """Moments of one piece as Python's numbers."""
    return Moments(*(np.asarray(x).item() for x in moments.arrays()))


def _stacked(states: Sequence[Moments]) -> Moments:
    rows = [(s.u, s.p, s.d1, s.d2, s.D, s.e1, s.N, s.e2, s.a, s.b) for s in states]
    u, p, d1, d2, D, e1, N, e2, a, b = (np.array(column) for column in zip(*rows, strict=True))
    return Moments(u, p, d1, d2, D.real, e1, N.real, e2, a, b)
