r"""The exact expected squared drift of a path, as a chain of maps that prepend motions to it.

Let a path end at the goal, and let ``N = E|e|²`` and ``b = -E[e]`` belong to what is still to be driven of it (plane =
complex numbers). Prepending a motion with error moments (d1, e1, N_A, a) that ends at lever w from the goal gives, by
the composition law of `driftplan.model.moments` with ``D = -2 Re d1`` (true rotations),

.. math:: b' = κ b + s, \qquad N' = N + K - 2 Re(\bar F b),

.. math:: κ = 1 + d_1, \quad s = -d_1 w - h e_1, \quad F = h(a + e_1) + (d_1 - 2 Re d_1) w, \quad
          K = N_A - 2 Re(d_1) |w|^2 + 2 Re(h a \bar w),

h being the true direction in which the motion sets out. N enters with factor one and nothing else of the future does:
(N, b) is all that a search needs to know of a path's end. Maps compose, so that a whole beginning of a path is one map
too, and its F says how much it gains from the future's bias. Nothing is approximated: whatever `predict_drift` prices,
steps, systematic errors and zones included, is priced here.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import Complexes, Floats, Ints
from driftplan.model.elements import run_moments, turn_moments
from driftplan.model.moments import Moments
from driftplan.model.noise import OdometryNoise
from driftplan.planning.roadmap.prices import Space


class Prepending(NamedTuple):
    """Maps (N, b) -> (N', b') of the module's docstring, over any leading axes."""

    kappa: Complexes
    shift: Complexes
    gain: Floats
    lever: Complexes

    def __call__(self, mean_square: Floats, b: Complexes) -> tuple[Floats, Complexes]:
        return mean_square + self.gain - 2 * (np.conj(self.lever) * b).real, self.kappa * b + self.shift

    def after(self, later: Prepending) -> Prepending:
        """This motion, then the ``later`` one, as one map."""
        return Prepending(
            self.kappa * later.kappa,
            self.kappa * later.shift + self.shift,
            self.gain + later.gain - 2 * (np.conj(self.lever) * later.shift).real,
            later.lever + np.conj(later.kappa) * self.lever,
        )

    def pick(self, which: Any) -> Prepending:
        """Some of the maps."""
        return Prepending(*(column[which] for column in self))

    @property
    def heading_var(self) -> Floats:
        """Variance that the heading gains, rad²."""
        return np.asarray(-2 * np.log(np.abs(self.kappa)))


def identity(count: int) -> Prepending:
    """Maps that change nothing."""
    return Prepending(np.ones(count, complex), np.zeros(count, complex), np.zeros(count), np.zeros(count, complex))


def run_maps(space: Space, noise: OdometryNoise, goal: Floats, a: Floats, b: Floats) -> Prepending:
    """Straight runs from ``a`` to ``b`` (n, 2), each stretch with the noise of the zone it is in."""
    if not space.zones:
        return _pieces(noise, goal, a, b)
    pieces = space.zone_pieces(a, b)
    step = (b - a)[pieces.segment]
    begin = a[pieces.segment] + pieces.start[:, None] * step
    end = np.where((pieces.end < 1)[:, None], a[pieces.segment] + pieces.end[:, None] * step, b[pieces.segment])
    every = identity(len(begin))
    for zone in np.unique(pieces.zone):
        here = np.flatnonzero(pieces.zone == zone)
        kind = noise if zone < 0 else space.zones[zone].noise
        _write(every, here, _pieces(kind, goal, begin[here], end[here]))
    count = np.bincount(pieces.segment, minlength=len(a))
    first = np.cumsum(count) - count
    whole = identity(len(a))
    for rank in reversed(range(int(count.max(initial=0)))):
        has = np.flatnonzero(count > rank)
        _write(whole, has, every.pick(first[has] + rank).after(whole.pick(has)))
    return whole


def turn_maps(
    space: Space, noise: OdometryNoise, goal: Floats, at: Floats, facing: Complexes, turn_rad: Floats, zone: Ints
) -> Prepending:
    """Turns on the spot at ``at`` (n, 2) from the directions ``facing`` (n,), before runs that begin in ``zone``."""
    whole = identity(len(at))
    for index in np.unique(zone):
        here = np.flatnonzero(zone == index)
        kind = noise if index < 0 else space.zones[index].noise
        shaken = np.zeros(len(here))
        if kind.distance_var_per_rad and not kind.heading_distance_corr:
            # Independent of the heading, it only adds up: no need for the moments of both.
            shaken = kind.distance_var_per_rad * np.abs(turn_rad[here])
            kind = replace(kind, distance_var_per_rad=0.0)
        turns = _map(turn_moments(turn_rad[here], kind), facing[here], _levers(goal, at[here]))
        _write(whole, here, turns._replace(gain=turns.gain + shaken))
    return whole


def turns_matter(noise: OdometryNoise, space: Space) -> bool:
    """Whether a turn on the spot adds any error, so that an edge's exact cost depends on the one before."""
    kinds = (noise, *(zone.noise for zone in space.zones))
    return any(k.heading_var_per_rad or k.distance_var_per_rad or k.heading_bias_per_rad for k in kinds)


def _pieces(noise: OdometryNoise, goal: Floats, a: Floats, b: Floats) -> Prepending:
    step = _levers(b, a)
    length = np.abs(step)
    direction: Complexes = np.asarray(
        np.where(length > 0, step, 1.0) / np.where(length > 0, length, 1.0), dtype=complex
    )
    return _map(run_moments(length, np.zeros(()), noise), direction, _levers(goal, b))


def _map(motion: Moments, h: Complexes, w: Complexes) -> Prepending:
    d1, e1, a = motion.d1, h * motion.e1, h * motion.a
    twice = 2 * d1.real
    parts = (
        1 + d1,
        -d1 * w - e1,
        motion.N - twice * np.abs(w) ** 2 + 2 * (a * np.conj(w)).real,
        a + e1 + (d1 - twice) * w,
    )
    kappa, shift, gain, lever = (np.broadcast_to(part, w.shape) for part in parts)
    return Prepending(kappa.astype(complex), shift.astype(complex), gain.real, lever.astype(complex))


def _write(maps: Prepending, where: Ints, values: Prepending) -> None:
    for column, value in zip(maps, values, strict=True):
        column[where] = value


def _levers(goal: Floats, at: Floats) -> Complexes:
    """The vectors from ``at`` to ``goal``."""
    return np.asarray((goal - at) @ np.array([1.0, 1j]), dtype=complex)
