"""Route tables: routes as rows of segments of odometry and readings of possible beacons, in plain arrays.

A route is cut at every place where something can happen: at its waypoints, where the noise changes, where a beacon of
any site would be read, and wherever a segment would be too long for the drift between its ends to be bounded sharply.
What is left are *breakpoints* 0 … m and, between breakpoints t and t + 1, *segment* t: a turn on the spot or a straight
run. *Slot* t is what happens from breakpoint t, once its readings are done, to the arrival at breakpoint t + 1; slot m
is the end. An *interval* is the way from one reading to another.

Segments are so short that what E|e|² may rise above its chord between their ends (`driftplan.model.worst`) is at most
a ten-thousandth of the limit squared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from driftplan.arrays import Floats, Ints, bounded
from driftplan.beacons.readings import floor_of
from driftplan.layouts.scenario import Scenario
from driftplan.model.elements import of_legs
from driftplan.model.heading_laws import law_moments
from driftplan.model.moments import Moments
from driftplan.model.noise import Noises, OdometryNoise, noise_of_legs
from driftplan.model.paths import read_path
from driftplan.model.readings import Fix, Readings, Resets
from driftplan.model.worst import bend_rates

_MAX_SEGMENTS = 1e7
_SAG_SHARE = 1e-4  # greatest margin, as a share of the limit squared


@dataclass(frozen=True, slots=True, eq=False)
class RouteTable:
    """Routes and the readings of all sites on them. Sorted by route, breakpoint and, at one breakpoint, by accuracy."""

    first_segment: Ints  # (routes + 1,) where each route's segments begin; m segments have breakpoints 0 … m
    segments: Moments  # (segments,)
    bend: Floats  # (segments,) -(E|e|²)'' is at most ``bend * sqrt(E|e|²) + bend_fixed`` on the segment
    bend_fixed: Floats  # (segments,)
    length: Floats  # (segments,) metres
    noise_of: Ints  # (segments,) index into `noises`
    noises: tuple[OdometryNoise, ...]
    translation: Floats  # (segments,) E|e|² that a segment adds however good the heading is, m²
    distance: Floats  # (segments + routes,) metres driven at breakpoints; route r's begin at first_segment[r] + r
    start: Moments  # (routes,) errors at the start, in the robot's own frame
    first_reading: Ints  # (routes + 1,) where each route's readings begin
    breakpoint: Ints  # (events,) where a reading happens
    readings: Readings  # (events,) what is read, and what it makes of the errors; a source is a site
    resets: Resets
    heading_d1: Floats  # (events,) moments of the heading a reading gives; NaN where it gives none
    heading_d2: Floats

    @property
    def routes(self) -> int:
        return len(self.first_segment) - 1

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
        """Number of segments of each route, hence its last breakpoint and slot, (routes,)."""
        return np.diff(self.first_segment)

    @property
    def route(self) -> Ints:
        """Route of every event, (events,)."""
        return np.repeat(np.arange(self.routes), np.diff(self.first_reading))

    def readings_of(self, route: int) -> slice:
        return slice(int(self.first_reading[route]), int(self.first_reading[route + 1]))

    def segments_of(self, route: int) -> slice:
        return slice(int(self.first_segment[route]), int(self.first_segment[route + 1]))

    def distances_of(self, route: int) -> Floats:
        """Metres driven at the breakpoints of a route, (m + 1,)."""
        begin = int(self.first_segment[route]) + route
        return self.distance[begin : begin + int(self.slots[route]) + 1]

    def sags(self, segment: Ints) -> tuple[Floats, Floats]:
        """``bend`` and ``fixed`` of segments as `driftplan.model.worst.ceiling` takes them."""
        square = self.length[segment] ** 2 / 8
        return self.bend[segment] * square, self.bend_fixed[segment] * square

    def within(self, segment: Ints, parts: int) -> Moments:
        """Elements from the beginning of runs to ``parts`` - 1 evenly spaced points inside, (k, parts - 1)."""
        lengths = self.length[segment, None] * (np.arange(1, parts) / parts)
        turn = np.zeros(lengths.shape)
        return of_legs(turn, lengths, turn, self.noise_of[segment, None], self.noises)


def route_table(scenario: Scenario, readings: Sequence[Readings], least_limit_m: float = np.inf) -> RouteTable:
    """The routes of a scenario with the readings on each (`Scenario.readings`), for limits of at least so many m."""
    floors = (floor_of(path, scenario.noise, scenario.world) for path in scenario.routes)
    rows = [SegmentedRoute(*floor, here, least_limit_m) for floor, here in zip(floors, readings, strict=True)]
    return _joined(rows, scenario.start_fix)


class SegmentedRoute:
    """One route, cut; its readings sorted by breakpoint and, at one breakpoint, by accuracy."""

    def __init__(self, path: Floats, noise: Noises, readings: Readings, least_limit_m: float = np.inf) -> None:
        runs = read_path(path)
        self.heading = float(runs.heading)
        self.noises, which = noise_of_legs(noise, len(runs.lengths), 1)
        runs, at, old = runs.cut(readings.s_m)
        which = np.repeat(which, np.diff(old))
        count = self._pieces_needed(runs.lengths, which, least_limit_m)
        turns = runs.turns != 0
        first = np.concatenate([[0], np.cumsum(turns + count)])  # of a leg's segments: its turn, the parts of its run
        self.turn, self.length = np.zeros(first[-1]), np.repeat(runs.lengths / count, turns + count)
        self.turn[first[:-1][turns]] = runs.turns[turns]
        self.length[first[:-1][turns]] = 0.0
        self.noise_of = np.repeat(which, turns + count)
        self.distance = np.concatenate([[0.0], np.cumsum(self.length)])
        breakpoint = first[at]
        order = np.lexsort((readings.source, readings.rank, breakpoint))
        self.breakpoint, self.readings = breakpoint[order], readings[order]

    def _pieces_needed(self, lengths: Floats, which: Ints, limit_m: float) -> Ints:
        """Into how many segments each run is cut, so that its sag is small."""
        bends = np.array([bend_rates(noise) for noise in self.noises])[which]
        share = (bends[:, 0] / limit_m + bends[:, 1] / limit_m**2) / 8  # of the limit squared, per metre squared
        pieces = np.maximum(1, np.ceil(lengths * np.sqrt(share / _SAG_SHARE)))
        bounded("segments of a route", float(pieces.sum()), _MAX_SEGMENTS, f"raise max_drift, here {limit_m:g} m")
        return np.asarray(pieces, dtype=np.intp)


def _joined(rows: list[SegmentedRoute], start_fix: Fix | None) -> RouteTable:
    """All routes in one set of arrays."""
    noises = list(dict.fromkeys(noise for row in rows for noise in row.noises))
    which = np.concatenate([np.array([noises.index(n) for n in row.noises])[row.noise_of] for row in rows])
    turn, length = (np.concatenate([getattr(row, name) for row in rows]) for name in ("turn", "length"))
    bends = np.array([bend_rates(noise) for noise in noises])[which]
    rates = ([noise.distance_var_per_m + noise.lateral_var_per_m, noise.distance_var_per_rad] for noise in noises)
    free = [not noise.heading_distance_corr for noise in noises]  # of the heading
    spreads = (np.array(list(rates)) * np.array(free)[:, None])[which]
    readings = sum((row.readings for row in rows), Readings.of([]))
    law, zero = law_moments("gaussian", readings.heading_var), np.zeros(len(rows))
    u = np.exp(1j * np.array([row.heading for row in rows]))
    start = Moments(u, zero, *([zero] * 8))  # no errors, or those of a fix, turned into the robot's own frame
    if start_fix is not None:
        start = Readings.of([start_fix]).resets()[0].apply(start)
    return RouteTable(
        first_segment=np.concatenate([[0], np.cumsum([len(row.length) for row in rows])]).astype(np.intp),
        segments=of_legs(turn, length, np.zeros(len(turn)), which, noises),
        bend=bends[:, 0] * (length > 0),
        bend_fixed=bends[:, 1] * (length > 0),
        length=length,
        noise_of=which,
        noises=tuple(noises),
        translation=spreads[:, 0] * length + spreads[:, 1] * np.abs(turn),
        distance=np.concatenate([row.distance for row in rows]),
        start=start.rotated(np.conj(u)),
        first_reading=np.concatenate([[0], np.cumsum([len(row.breakpoint) for row in rows])]).astype(np.intp),
        breakpoint=np.concatenate([row.breakpoint for row in rows]),
        readings=readings,
        resets=readings.resets(),
        heading_d1=law.d1,
        heading_d2=law.d2,
    )
