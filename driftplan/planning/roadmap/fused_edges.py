"""The errors of a robot that fuses its readings, on the edges of a roadmap, and which of its labels make which
superfluous.

The error state is the covariance P of position, heading and the unknown constants of the odometry, those that differ
between drives (`driftplan.model.covariance`): nine numbers, or up to 36. A stretch of
an edge, readings that are certain included, is one element P ↦ A (I + P J)⁻¹ P Aᵀ + C. A reading that may be missed
is none: an edge is cut there into parts, and the bound of `FilterState.read` taken. Between readings tr P is convex in
the distance, and a reading never adds to it: it is greatest on arrival at a reading, or at the end.

*Dominance.* Driving, turning and reading, missed or not, are monotone: P₁ ⪯ P₂ (P₂ - P₁ positive semidefinite, the
Loewner order) stays so whatever follows, and then tr P₁ <= tr P₂. So label 1 dominates when it is no longer and
P₁ ⪯ (1 + ε) P₂ + S in every scenario. S is the slack s that is granted: s/2 for either axis of the position and s/R²
for the heading, R being how far the most accurate robot can drive before it breaks the limit; ε is a share that is
granted. Then tr P₁ <= (1 + ε) tr P₂ + 2s whatever follows: (1 + ε) P₂ becomes at most 1 + ε times what P₂ becomes, and
S no more than driving alone makes of it. Where an unknown constant acts on turns, a label dominates those that face as
it does. Of systematic errors that are known labels know nothing: with them the exact model may disagree with what was
found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from driftplan.arrays import Bools, Complexes, Floats, Ints
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import BeaconColumns, readings_from
from driftplan.model.covariance import CovarianceMap, compose, identity, legs
from driftplan.model.filter_state import FilterState, Row, upper_triangle
from driftplan.model.fusion import belief_at_start
from driftplan.model.noise import OdometryNoise, spread_of
from driftplan.model.readings import Fix, Readings
from driftplan.planning.roadmap.edge_steps import NO_SITE, Steps, spans

_NEVER = 1e30  # rad²/rad: whoever has to turn does not dominate
_ROUNDING = 1e-12  # of the diagonal: what is semidefinite but for rounding


@dataclass(frozen=True, eq=False)
class FusedEffects:
    """What edges do to covariances: parts that end with a reading that may be missed, the last one with the edge."""

    edge: Ints  # (m,) which edges; sorted
    first_part: Ints  # (m + 1,) where the parts of each begin
    first_map: Ints  # (parts + 1,) where the maps of each part begin
    maps: CovarianceMap  # from where a part begins to where tr P may be greatest; the last one of a part to its end
    missable: tuple[Row, ...]  # what may be read where a part ends: columns (parts, 1)
    chance: Floats  # (parts,)

    def driven(self, which: Ints, begun: Floats) -> tuple[Floats, Floats]:
        """As of `ResetEffects`."""
        first, count = self.first_part[which], self.first_part[which + 1] - self.first_part[which]
        P = np.swapaxes(begun, 1, 2).reshape(len(which), -1, *self.maps.A.shape[1:])
        after, worst = np.empty(P.shape), np.zeros(P.shape[:2])
        here = np.arange(len(which))
        for k in range(int(count.max(initial=0))):
            part = first[here] + k
            begin, size = self.first_map[part], self.first_map[part + 1] - self.first_map[part]
            maps = self.maps[spans(begin, size), None]
            found = maps(np.repeat(P, size, axis=0))
            trace, last = found[..., 0, 0] + found[..., 1, 1], np.cumsum(size) - 1
            worst[here] = np.maximum(worst[here], np.maximum.reduceat(trace, last + 1 - size, axis=0))
            after[here], onward = found[last], count[here] > k + 1
            here, part = here[onward], part[onward]
            P = self._read(found[last[onward]], part) if len(here) else P[:0]
        return _columns(after), worst

    def _read(self, P: Floats, part: Ints) -> Floats:
        rows = [Row(tuple(c[part] for c in row.coefficients), row.variance[part]) for row in self.missable]
        return FilterState.from_matrix(P).read(rows, self.chance[part, None]).matrix


class FusedEdges:
    """The errors of a robot with a filter; an `EdgeErrors`."""

    def __init__(self, steps: Steps, noises: Sequence[OdometryNoise], beacons: Sequence[Beacon]) -> None:
        self.steps, self.columns = steps, BeaconColumns.of(beacons)
        zero = np.zeros(len(steps.edge))
        self.noises, self.spread = spread_of(noises)
        self.size = 3 + len(self.spread.names)
        self.turns_matter = "heading_bias_per_rad" in self.spread.names
        self.run = legs(np.angle(steps.direction), zero, steps.length, zero, self.noises, steps.which, self.spread).maps
        self.coefficients, self.variance = self._columns_of_rows(steps)

    def _columns_of_rows(self, steps: Steps) -> tuple[Floats, Floats]:
        """What each step measures, (k, rows, 3), and its variance, (k, rows): infinite for what it does not."""
        reads = np.flatnonzero(steps.site != NO_SITE)
        h, variance = self._readings(steps.site[reads], steps.place[reads]).measured(steps.place[reads])
        some = np.isfinite(variance).any(axis=0)
        every = np.zeros((len(steps.edge), some.sum(), 3)), np.full((len(steps.edge), some.sum()), np.inf)
        share = np.maximum(steps.share[reads, None], 1e-300)  # less than a whole reading: with more variance
        every[0][reads], every[1][reads] = np.stack(h, axis=-1)[:, some], variance[:, some] / share
        return every

    def _readings(self, site: Ints, place: Complexes) -> Readings:
        """Readings of beacons at places (k,), as if certain."""
        distance = np.abs(place - self.columns.xy[site] @ np.array([1.0, 1j]))
        return readings_from(self.columns, site, distance, np.zeros(len(site)), np.ones(len(site)))

    def at_start(self, initial: Fix | None) -> Floats:
        return belief_at_start(initial, self.spread).matrix.ravel()

    def read(self, state: Floats, site: int, place: complex) -> Floats:
        at = np.array([place])
        rows, _ = self._readings(np.array([site]), at).rows(at)[0]
        return FilterState.from_matrix(state.reshape(self.size, self.size)).read(rows).matrix.ravel()

    def square(self, states: Floats) -> Floats:
        return np.asarray(states[..., 0, :] + states[..., self.size + 1, :])

    def turns(self, turn_rad: Floats, arriving: complex, noise: OdometryNoise) -> Floats:
        zero, (random, *_) = np.zeros(len(turn_rad)), spread_of([noise])[0]
        turned = legs(np.full(len(turn_rad), np.angle(arriving)), turn_rad, zero, zero, [random], None, self.spread)
        return np.stack([turned.A, turned.C], axis=1)

    def turned(self, state: Floats, turns: Floats) -> Floats:
        A, C, P = turns[:, None, 0], turns[:, None, 1], state.T.reshape(-1, self.size, self.size)
        return _columns(A @ P @ np.swapaxes(A, -1, -2) + C)

    def dominance(
        self, max_gap_m: float, slack_sq: float, share: float, turn_rates: tuple[float, float]
    ) -> LoewnerDominance:
        rates = (_NEVER if self.turns_matter else turn_rates[0], turn_rates[1])
        return LoewnerDominance(max_gap_m, slack_sq, share, rates, self.size)

    def effects(self, edges: Ints, dead: int = NO_SITE) -> FusedEffects:
        steps = self.steps
        reads = (steps.site != NO_SITE) & (steps.site != dead)
        cut = reads & (steps.chance < 1)
        begin, count = steps.of_edges(edges)
        ends_reading = reads[begin + count - 1]  # then a map more, of what it leaves
        first = np.concatenate([[0], np.cumsum(count + ends_reading)])
        maps, now = _nothing(int(first[-1]), self.size), _nothing(len(edges), self.size)
        step_of = np.zeros(first[-1], dtype=np.intp)
        for k in range(int(count.max(initial=0))):
            here = np.flatnonzero(count > k)
            step = begin[here] + k
            driven = compose(now[here], self.run[step])
            _put(maps, first[here] + k, driven)
            step_of[first[here] + k] = step
            _put(now, here, driven.read(self._rows_of(step, reads[step] & ~cut[step])))
            _put(now, here[cut[step]], _nothing(int(cut[step].sum()), self.size))
        _put(maps, first[1:][ends_reading] - 1, now[ends_reading])
        ends_part = cut[step_of]
        ends_part[first[1:][ends_reading] - 1] = False
        first_map = np.union1d(first, np.flatnonzero(ends_part) + 1)
        last = first_map[1:] - 1
        return FusedEffects(
            edges,
            np.searchsorted(first_map, first),
            first_map,
            maps,
            self._rows_of(step_of[last], ends_part[last], 1),
            steps.chance[step_of[last]],
        )

    def _rows_of(self, step: Ints, which: Bools, axes: int = 0) -> tuple[Row, ...]:
        """The readings that end steps, as columns with so many further axes; those of ``which`` only."""
        shape = (len(step), *(1,) * axes)
        variance = np.where(which[:, None], self.variance[step], np.inf)
        return tuple(
            Row(tuple(c.reshape(shape) for c in self.coefficients[step, i].T), variance[:, i].reshape(shape))
            for i in range(variance.shape[1])
        )


class LoewnerDominance:
    """Which label makes which superfluous; see above. A score is P, but for ``size`` 3 its upper triangle."""

    def __init__(
        self, max_gap_m: float, slack_sq: float, share: float, turn_rates: tuple[float, float], size: int = 3
    ) -> None:
        self.turn_rates, self.share = turn_rates, share + _ROUNDING
        self.slack = slack_sq / 2, slack_sq / max(max_gap_m, 1e-9) ** 2
        self.key_slacks = self.slack[1], self.slack[0], self.slack[0]
        self.pairs = upper_triangle(size)
        self.diagonal = [k for k, (i, j) in enumerate(self.pairs) if i == j]
        self.keys = self.diagonal[2], self.diagonal[0], self.diagonal[1]

    def scores(self, states: Floats) -> Floats:
        """What it looks at, (n, scenarios, 6), of states (n, 9, scenarios); or as many as the states have."""
        size = len(self.diagonal)
        return np.swapaxes(states[:, [size * i + j for i, j in self.pairs]], 1, 2)

    def __call__(self, better: Floats, worse: Floats, turn_rad: Floats) -> Bools:
        """No pivot of Gauss's elimination is negative. The noise of a turn counts in all directions."""
        axis = self.slack[0] - self.turn_rates[1] * turn_rad[:, None]
        heading = self.slack[1] - self.turn_rates[0] * turn_rad[:, None]
        gap = (1 + self.share - _ROUNDING) * worse - better
        gap[..., self.diagonal] += _ROUNDING * worse[..., self.diagonal]
        for k, slack in zip(self.keys, (heading, axis, axis), strict=True):
            gap[..., k] += slack
        holds = np.asarray((gap[..., self.diagonal] >= 0).all(axis=(1, 2)))
        left = {pair: gap[holds, :, k] for k, pair in enumerate(self.pairs)}
        fits = np.ones(left[0, 0].shape, dtype=bool)
        for k in range(len(self.diagonal)):
            pivot = left[k, k]
            fits &= pivot >= 0
            for i, j in self.pairs:
                if i > k:
                    fits &= (pivot > 0) | (left[k, i] == 0)
                    left[i, j] = left[i, j] - left[k, i] * left[k, j] / np.where(pivot > 0, pivot, 1.0)
        holds[holds] = fits.all(axis=1)
        return holds


def _columns(P: Floats) -> Floats:
    """Error states (n, d², scenarios) of covariances (n, scenarios, d, d)."""
    return np.swapaxes(P.reshape(*P.shape[:2], -1), 1, 2)


def _nothing(count: int, size: int) -> CovarianceMap:
    """Stretches in which nothing happens yet."""
    return CovarianceMap(*(x.copy() for x in identity((count,), size).arrays()))


def _put(maps: CovarianceMap, index: Ints | Bools, some: CovarianceMap) -> None:
    for all_, part in zip(maps.arrays(), some.arrays(), strict=True):
        all_[index] = part
