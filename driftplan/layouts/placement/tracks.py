"""Tracks: routes as rows of odometry pieces and readings of possible beacons, in plain arrays.

A route is cut at every place where something can happen: at its waypoints, where the noise changes, where a beacon of
any site would be read, and wherever a piece would be too long for the drift between its ends to be bounded sharply.
What is left are *borders* 0 … m and, between borders t and t + 1, *piece* t: a turn on the spot or a straight run.
*Slot* t is what happens from border t, once its readings are done, to the arrival at border t + 1; slot m is the end.

Between the ends of a run -(E|e|²)'' is at most bend sqrt(E|e|²) + bend_fixed (`driftplan.model.worst`), so on a run of
length h whose ends keep E|e|² <= limit² - (bend limit + bend_fixed) h²/8 it is at most limit² everywhere. `Tracks.sag`
is that margin. Pieces are so short that it is at most a ten-thousandth of the limit squared; where that leaves a doubt,
`Tracks.within` cuts the piece into a thousand parts, whose margin is a millionth of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Floats, Ints
from driftplan.beacons.beacon import Beacon, BeaconColumns, Readings, floor_of, readings_on
from driftplan.model.elements import run_moments, turn_moments
from driftplan.model.fixes import Fix, apply_fix
from driftplan.model.heading_laws import law_moments
from driftplan.model.moments import Moments
from driftplan.model.noise import Noises, OdometryNoise
from driftplan.model.paths import wrap
from driftplan.model.worst import bend_rates
from driftplan.world.world import World

PARTS = 1000  # of a piece on which there is doubt
RADIUS_PARTS = 16  # of a piece on which a radius comes close to the limit
_SAG_SHARE = 1e-4  # greatest margin, as a share of the limit squared
_SAME_PLACE_M = 1e-7  # a reading this near to a waypoint is at the waypoint


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """Routes and the readings of all sites on them. Sorted by route, border and, at one border, by accuracy.

    Attributes
    ----------
    first_piece : (routes + 1,) where each route's pieces begin; a route of m pieces has borders 0 … m
    pieces : Moments, shape (pieces,)
    bend, bend_fixed : (pieces,) -(E|e|²)'' is at most ``bend * sqrt(E|e|²) + bend_fixed`` on the piece
    length : (pieces,) metres
    noise_of : (pieces,) index into `noises`
    translation : (pieces,) E|e|² that a piece adds however good the heading is, m²
    distance : (pieces + routes,) metres driven at every border; route r's begin at ``first_piece[r] + r``
    start : Moments, shape (routes,): errors at the start, in the robot's own frame
    first_event : (routes + 1,) where each route's readings begin
    border, site : (events,) where a reading happens, and the site that gives it
    chance : (events,) that the reading succeeds
    trace : (events,) E|e|² of the position it gives, m²; NaN where it gives none
    heading_d1, heading_d2 : (events,) moments of the heading it gives; NaN where it gives none
    """

    first_piece: Ints
    pieces: Moments
    bend: Floats
    bend_fixed: Floats
    length: Floats
    noise_of: Ints
    noises: tuple[OdometryNoise, ...]
    translation: Floats
    distance: Floats
    start: Moments
    first_event: Ints
    border: Ints
    site: Ints
    chance: Floats
    trace: Floats
    heading_d1: Floats
    heading_d2: Floats

    @property
    def routes(self) -> int:
        return len(self.first_piece) - 1

    @property
    def slots(self) -> Ints:
        """Number of pieces of each route, hence its last border and slot, (routes,)."""
        return np.diff(self.first_piece)

    @property
    def route(self) -> Ints:
        """Route of every event, (events,)."""
        return np.repeat(np.arange(self.routes), np.diff(self.first_event))

    def events_of(self, route: int) -> slice:
        return slice(int(self.first_event[route]), int(self.first_event[route + 1]))

    def pieces_of(self, route: int) -> slice:
        return slice(int(self.first_piece[route]), int(self.first_piece[route + 1]))

    def distances_of(self, route: int) -> Floats:
        """Metres driven at the borders of a route, (m + 1,)."""
        begin = int(self.first_piece[route]) + route
        return self.distance[begin : begin + int(self.slots[route]) + 1]

    def sag(self, limit_m: Floats) -> Floats:
        """By how much E|e|² at the ends of each piece must stay under the limit squared, (pieces,), m².

        ``limit_m`` per route, (routes,).
        """
        limit = np.repeat(limit_m, self.slots)
        return np.asarray((self.bend * limit + self.bend_fixed) * self.length**2 / 8)

    def within(self, piece: Ints, parts: int = PARTS) -> Moments:
        """Elements from the beginning of runs to ``parts`` - 1 evenly spaced points inside, (k, parts - 1)."""
        lengths = self.length[piece, None] * (np.arange(1, parts) / parts)
        turn = np.zeros(lengths.shape)
        return _elements(turn, lengths, np.repeat(self.noise_of[piece], parts - 1).reshape(lengths.shape), self.noises)


def lay_tracks(
    paths: Sequence[Floats],
    noise: OdometryNoise,
    sites: Sequence[Beacon],
    world: World | None,
    *,
    start_fix: Fix | None,
    least_limit_m: float,
) -> Tracks:
    """Tracks of routes (n, 2) for all ``sites``; ``least_limit_m`` is the smallest limit they will be held to."""
    columns = BeaconColumns.of(sites)
    rows = [_Row(*floor_of(path, noise, world), readings_on(path, columns, world), least_limit_m) for path in paths]
    return _joined(rows, sites, start_fix)


class _Row:
    """One route, cut."""

    def __init__(
        self,
        path: Floats,
        noises: Noises,
        readings: Readings,
        least_limit_m: float,
    ) -> None:
        steps = np.diff(path, axis=0)
        moves = np.any(steps != 0, axis=1)
        of_leg = [noises] * len(steps) if isinstance(noises, OdometryNoise) else list(noises)
        self.noise_of_leg = [noise for noise, moved in zip(of_leg, moves.tolist(), strict=True) if moved]
        steps = steps[moves] if moves.any() else steps[:1]
        if not moves.any():
            self.noise_of_leg = of_leg[:1]
        length = np.hypot(steps[:, 0], steps[:, 1])
        course = np.arctan2(steps[:, 1], steps[:, 0])
        self.heading = float(course[0])
        turn = wrap(np.diff(course, prepend=course[0]))
        ends = np.concatenate([[0.0], np.cumsum(length)])

        s = readings.s_m
        nearest = np.clip(np.searchsorted(ends, s), 1, len(ends) - 1)
        nearest = np.where(s - ends[nearest - 1] < ends[nearest] - s, nearest - 1, nearest)
        s = np.where(np.abs(s - ends[nearest]) <= _SAME_PLACE_M, ends[nearest], s)
        borders = np.unique(np.concatenate([ends, s]))
        leg = np.clip(np.searchsorted(ends, borders[:-1], side="right") - 1, 0, len(length) - 1)
        count = self._pieces_needed(np.diff(borders), leg, least_limit_m)
        borders = np.concatenate([_spread(borders[:-1], borders[1:], count), borders[-1:]])
        leg = np.repeat(leg, count)

        turns_here = (turn[leg] != 0) & (borders[:-1] == ends[leg])
        before = np.concatenate([[0], np.cumsum(turns_here)])[: len(borders)]  # turn pieces before each border's own
        at = np.arange(len(borders)) + before
        pieces = len(leg) + int(turns_here.sum())
        self.turn, self.length = np.zeros(pieces), np.zeros(pieces)
        self.leg = np.zeros(pieces, dtype=np.intp)
        run = np.arange(len(leg)) + np.cumsum(turns_here)
        self.length[run], self.leg[run] = np.diff(borders), leg
        self.turn[at[:-1][turns_here]] = turn[leg[turns_here]]
        self.leg[at[:-1][turns_here]] = leg[turns_here]
        self.distance = np.concatenate([[0.0], np.cumsum(self.length)])

        border = at[np.searchsorted(borders, s)]
        order = np.lexsort((readings.beacon, readings.rank, border))
        self.border, self.site, self.chance = border[order], readings.beacon[order], readings.chance[order]

    def _pieces_needed(self, lengths: Floats, leg: Ints, limit_m: float) -> Ints:
        """Into how many pieces each stretch is cut, so that its sag is small."""
        bends = np.array([bend_rates(noise) for noise in self.noise_of_leg])[leg]
        rate = (bends[:, 0] * limit_m + bends[:, 1]) / 8
        allowed = _SAG_SHARE * limit_m**2
        return np.asarray(np.maximum(1, np.ceil(lengths * np.sqrt(rate / allowed))), dtype=np.intp)


def _joined(rows: list[_Row], sites: Sequence[Beacon], start_fix: Fix | None) -> Tracks:
    """All routes in one set of arrays."""
    noises = list(dict.fromkeys(noise for row in rows for noise in row.noise_of_leg))
    index = {noise: k for k, noise in enumerate(noises)}
    which = np.concatenate([np.array([index[n] for n in row.noise_of_leg])[row.leg] for row in rows])
    turn, length = (np.concatenate([getattr(row, name) for row in rows]) for name in ("turn", "length"))
    bends = np.array([bend_rates(noise) for noise in noises])[which]
    spreads = np.array([_translation(noise) for noise in noises])[which]
    site = np.concatenate([row.site for row in rows])
    stds = np.array([(b.kind.position_std_m, b.kind.heading_std) for b in sites], dtype=float).reshape(
        -1, 2
    )  # None: NaN
    law = law_moments("gaussian", stds[:, 1] ** 2)
    return Tracks(
        first_piece=np.concatenate([[0], np.cumsum([len(row.length) for row in rows])]).astype(np.intp),
        pieces=_elements(turn, length, which, noises),
        bend=bends[:, 0] * (length > 0),
        bend_fixed=bends[:, 1] * (length > 0),
        length=length,
        noise_of=which,
        noises=tuple(noises),
        translation=spreads[:, 0] * length + spreads[:, 1] * np.abs(turn),
        distance=np.concatenate([row.distance for row in rows]),
        start=_starts([row.heading for row in rows], start_fix),
        first_event=np.concatenate([[0], np.cumsum([len(row.site) for row in rows])]).astype(np.intp),
        border=np.concatenate([row.border for row in rows]),
        site=site,
        chance=np.concatenate([row.chance for row in rows]),
        trace=2 * stds[site, 0] ** 2,
        heading_d1=law.d1[site],
        heading_d2=law.d2[site],
    )


def _elements(turn: Floats, length: Floats, which: Ints, noises: Sequence[OdometryNoise]) -> Moments:
    """The element of every piece: pieces turn or run, never both."""
    parts: list[tuple[NDArray[np.bool_], Moments]] = []
    for k, noise in enumerate(noises):
        turns, runs = (which == k) & (turn != 0), (which == k) & (turn == 0)
        parts.append((turns, turn_moments(turn[turns], noise)))
        parts.append((runs, run_moments(length[runs], np.zeros(runs.sum()), noise)))
    arrays = []
    for field in zip(*(part.arrays() for _, part in parts), strict=True):
        out: NDArray[Any] = np.zeros(turn.shape, dtype=np.result_type(*field))
        for (here, _), values in zip(parts, field, strict=True):
            out[here] = values
        arrays.append(out)
    return Moments(*arrays)


def _starts(headings: list[float], start_fix: Fix | None) -> Moments:
    """Errors at the start: none, or those of a fix, turned into the robot's own frame."""
    zero = np.zeros(len(headings))
    u = np.exp(1j * np.array(headings))
    start = Moments(u, zero, *([zero] * 8))
    if start_fix is not None:
        start = apply_fix(start, start_fix)
    return start.rotated(np.conj(u))


def _translation(noise: OdometryNoise) -> tuple[float, float]:
    """Translation variance per metre and per radian that is independent of the heading."""
    if noise.heading_distance_corr:
        return 0.0, 0.0
    return noise.distance_var_per_m + noise.lateral_var_per_m, noise.distance_var_per_rad


def _spread(start: Floats, end: Floats, count: Ints) -> Floats:
    """Starts of ``count`` equal parts of every stretch."""
    part = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.asarray(np.repeat(start, count) + part * np.repeat((end - start) / count, count))
