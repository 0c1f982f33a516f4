"""Polishing a path by its exact expected squared drift, where headings go so wrong that the additive cost misleads."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from driftplan.arrays import Complexes, Floats, Ints
from driftplan.model.noise import OdometryNoise
from driftplan.planning.roadmap.exact_cost import Prepending, run_maps, turn_maps, turns_matter
from driftplan.planning.roadmap.polish import arriving, bearing
from driftplan.planning.roadmap.prices import Space


@dataclass(frozen=True, eq=False)
class ExactJudge:
    """Judges by E|e|² at the goal: a moved waypoint changes two runs and three turns, the rest is two maps.

    Moves of several waypoints at once influence each other a little; `refined` makes sure that the path gets better.
    """

    space: Space
    noise: OdometryNoise
    goal: Floats
    start_heading: float | None = None

    @property
    def stride(self) -> int:
        return 3

    def price(self, path: Floats) -> float:
        mean_square, bias = 0.0, 0j
        for leg in reversed(_rows(self._legs(path))):
            mean_square, bias = _prepended(leg, mean_square, bias)
        return mean_square

    def prices(self, path: Floats, moved: Ints, tried: Floats) -> Floats:
        left, right = path[moved - 1], path[moved + 1]
        (gains, levers), (all_squares, all_biases) = self._beginnings(path), self._ends(path)
        to, away = bearing(left, tried), bearing(tried, right)
        mean_square, bias = all_squares[moved + 1], all_biases[moved + 1]
        if self._turns_matter:
            beyond = path[np.minimum(moved + 2, len(path) - 1)]
            onward = bearing(right, beyond)
            onward = np.where(moved + 2 < len(path), onward, away)  # no turn at the goal
            mean_square, bias = self._turns(right, away, onward, beyond)(mean_square, bias)
        mean_square, bias = self._runs(tried, right)(mean_square, bias)
        if self._turns_matter:
            mean_square, bias = self._turns(tried, to, away, right)(mean_square, bias)
        mean_square, bias = self._runs(left, tried)(mean_square, bias)
        if self._turns_matter:
            facing = arriving(path, moved, to, self.start_heading)
            mean_square, bias = self._turns(left, facing, to, tried)(mean_square, bias)
        return np.asarray(gains[moved - 1] + mean_square - 2 * (np.conj(levers[moved - 1]) * bias).real)

    def _beginnings(self, path: Floats) -> tuple[Floats, Complexes]:
        """(K, F) of what is driven before each waypoint, on arrival there."""
        gains, levers = [0.0], [0j]
        for kappa, shift, gain, lever in _rows(self._legs(path)):
            gains.append(gains[-1] + gain - 2 * (levers[-1].conjugate() * shift).real)
            levers.append(lever + kappa.conjugate() * levers[-1])
        return np.array(gains), np.array(levers)

    def _ends(self, path: Floats) -> tuple[Floats, Complexes]:
        """(N, b) of what is driven from each waypoint on, the turn there left out."""
        legs, runs = _rows(self._legs(path)), _rows(self._runs(path[:-1], path[1:]))
        squares, biases = [0.0], [0j]
        state = 0.0, 0j
        for leg, run in zip(reversed(legs), reversed(runs), strict=True):
            mean_square, bias = _prepended(run, *state)
            squares.append(mean_square)
            biases.append(bias)
            state = _prepended(leg, *state)
        return np.array(squares[::-1]), np.array(biases[::-1])

    def _legs(self, path: Floats) -> Prepending:
        """Turn and run of every leg."""
        runs = self._runs(path[:-1], path[1:])
        if not self._turns_matter:
            return runs
        step = bearing(path[:-1], path[1:])
        first = step[:1] if self.start_heading is None else np.exp(1j * np.array([self.start_heading]))
        return self._turns(path[:-1], np.concatenate([first, step[:-1]]), step, path[1:]).after(runs)

    def _runs(self, a: Floats, b: Floats) -> Prepending:
        return run_maps(self.space, self.noise, self.goal, a, b)

    def _turns(self, at: Floats, facing: Complexes, to: Complexes, following: Floats) -> Prepending:
        """Turns at ``at`` from one direction to another, before a run to ``following``."""
        if self.space.zones:
            pieces = self.space.zone_pieces(at, following)
            zone = pieces.zone[np.searchsorted(pieces.segment, np.arange(len(at)))]
        else:
            zone = np.full(len(at), -1, dtype=np.int64)
        length = np.abs(facing)
        direction = np.asarray(np.where(length > 0, facing, 1.0) / np.where(length > 0, length, 1.0), dtype=complex)
        turn = np.angle(to * np.conj(facing))
        return turn_maps(self.space, self.noise, self.goal, at, direction, turn, zone)

    @cached_property
    def _turns_matter(self) -> bool:
        return turns_matter(self.noise, self.space)


Row = tuple[complex, complex, float, complex]


def _rows(maps: Prepending) -> list[Row]:
    """Each map as numbers of Python, which are faster one by one than arrays."""
    return list(zip(*(column.tolist() for column in maps), strict=True))


def _prepended(motion: Row, mean_square: float, bias: complex) -> tuple[float, complex]:
    kappa, shift, gain, lever = motion
    return mean_square + gain - 2 * (lever.conjugate() * bias).real, kappa * bias + shift
