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

import numpy as np

from driftplan.arrays import Floats, Ints
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import BeaconColumns, floor_of, readings_on
from driftplan.model.elements import of_legs
from driftplan.model.heading_laws import law_moments
from driftplan.model.moments import Moments
from driftplan.model.noise import Noises, OdometryNoise, noise_of_legs
from driftplan.model.paths import read_path
from driftplan.model.readings import Fix, Readings, Resets
from driftplan.model.worst import bend_rates
from driftplan.world.world import World

PARTS = 1000  # of a piece on which there is doubt
RADIUS_PARTS = 16  # of a piece on which a radius comes close to the limit
_SAG_SHARE = 1e-4  # greatest margin, as a share of the limit squared


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
    border : (events,) where a reading happens
    readings, resets : (events,) what is read, and what it makes of the errors; a reading's source is its site
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
    readings: Readings
    resets: Resets
    heading_d1: Floats
    heading_d2: Floats

    @property
    def routes(self) -> int:
        return len(self.first_piece) - 1

    @property
    def site(self) -> Ints:
        """The site that gives each reading, (events,)."""
        return self.readings.source

    @property
    def chance(self) -> Floats:
        """That each reading succeeds, (events,)."""
        return self.readings.chance

    @property
    def trace(self) -> Floats:
        """E|e|² of the position each reading gives, (events,), m²; NaN where it gives none."""
        return self.readings.square

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
        return of_legs(turn, lengths, turn, self.noise_of[piece, None], self.noises)


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
    return _joined(rows, start_fix)


class _Row:
    """One route, cut."""

    def __init__(self, path: Floats, noise: Noises, readings: Readings, least_limit_m: float) -> None:
        runs = read_path(path)
        self.heading = float(runs.heading)
        self.noises, which = noise_of_legs(noise, len(runs.lengths), 1)
        runs, at, old = runs.cut(readings.s_m)
        which = np.repeat(which, np.diff(old))
        count = self._pieces_needed(runs.lengths, which, least_limit_m)
        turns = runs.turns != 0
        first = np.concatenate([[0], np.cumsum(turns + count)])  # of a leg's pieces: its turn, the parts of its run
        self.turn, self.length = np.zeros(first[-1]), np.repeat(runs.lengths / count, turns + count)
        self.turn[first[:-1][turns]] = runs.turns[turns]
        self.length[first[:-1][turns]] = 0.0
        self.noise_of = np.repeat(which, turns + count)
        self.distance = np.concatenate([[0.0], np.cumsum(self.length)])
        border = first[at]
        order = np.lexsort((readings.source, readings.rank, border))
        self.border, self.readings = border[order], readings[order]

    def _pieces_needed(self, lengths: Floats, which: Ints, limit_m: float) -> Ints:
        """Into how many pieces each run is cut, so that its sag is small."""
        bends = np.array([bend_rates(noise) for noise in self.noises])[which]
        rate = (bends[:, 0] * limit_m + bends[:, 1]) / 8
        allowed = _SAG_SHARE * limit_m**2
        return np.asarray(np.maximum(1, np.ceil(lengths * np.sqrt(rate / allowed))), dtype=np.intp)


def _joined(rows: list[_Row], start_fix: Fix | None) -> Tracks:
    """All routes in one set of arrays."""
    noises = list(dict.fromkeys(noise for row in rows for noise in row.noises))
    which = np.concatenate([np.array([noises.index(n) for n in row.noises])[row.noise_of] for row in rows])
    turn, length = (np.concatenate([getattr(row, name) for row in rows]) for name in ("turn", "length"))
    bends = np.array([bend_rates(noise) for noise in noises])[which]
    spreads = np.array([_translation(noise) for noise in noises])[which]
    readings = sum((row.readings for row in rows), Readings.of([]))
    law = law_moments("gaussian", readings.heading_var)
    return Tracks(
        first_piece=np.concatenate([[0], np.cumsum([len(row.length) for row in rows])]).astype(np.intp),
        pieces=of_legs(turn, length, np.zeros(len(turn)), which, noises),
        bend=bends[:, 0] * (length > 0),
        bend_fixed=bends[:, 1] * (length > 0),
        length=length,
        noise_of=which,
        noises=tuple(noises),
        translation=spreads[:, 0] * length + spreads[:, 1] * np.abs(turn),
        distance=np.concatenate([row.distance for row in rows]),
        start=_starts([row.heading for row in rows], start_fix),
        first_event=np.concatenate([[0], np.cumsum([len(row.border) for row in rows])]).astype(np.intp),
        border=np.concatenate([row.border for row in rows]),
        readings=readings,
        resets=readings.resets(),
        heading_d1=law.d1,
        heading_d2=law.d2,
    )


def _starts(headings: list[float], start_fix: Fix | None) -> Moments:
    """Errors at the start: none, or those of a fix, turned into the robot's own frame."""
    zero = np.zeros(len(headings))
    u = np.exp(1j * np.array(headings))
    start = Moments(u, zero, *([zero] * 8))
    if start_fix is not None:
        start = Readings.of([start_fix]).resets()[0].apply(start)
    return start.rotated(np.conj(u))


def _translation(noise: OdometryNoise) -> tuple[float, float]:
    """Translation variance per metre and per radian that is independent of the heading."""
    if noise.heading_distance_corr:
        return 0.0, 0.0
    return noise.distance_var_per_m + noise.lateral_var_per_m, noise.distance_var_per_rad
