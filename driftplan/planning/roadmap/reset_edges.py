"""The errors of a robot that resets, on the edges of a roadmap, and which of its labels make which superfluous.

E|e|² at the end of a motion depends on what came before only through the error state

    x = (E|e|², E|δ|², E δ, E e, E[e conj δ], 1)        (real and imaginary parts: nine numbers, world frame),

and driving a straight run, reading a beacon and missing it with some probability all act on x by matrices. (The other
second moments, E e² and E δ², never flow back into E|e|².) So an edge is one matrix, whatever is read on it, and the
drift at every place where it could be greatest - before and after every reading, and at the end - is one row each.

*Dominance.* A motion of displacement P until the next position reading adds to E|e|² what does not depend on the
label, and

    E|e|² + E|δ|² |P|² + 2 Re(E[e conj δ] conj P),

up to terms of the fourth order in the heading error gained on the way; a position reading keeps E|δ|² and wipes the
rest. So label 1 dominates when, with Δ = label 2 - label 1 in every scenario,

    ΔE|e|² >= 0,   ΔE|δ|² >= 0   and   ΔE|e|² + ΔE|δ|² r² - 2 |ΔE[e conj δ]| r >= 0 for every r <= R,

R being how far the most accurate robot can drive before it breaks the limit: farther no label gets without a reading.
Missed readings mix outcomes, which keeps the order. Systematic errors are not in these terms: with them dominance is a
rule of thumb.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from driftplan.arrays import Bools, Complexes, Floats, Ints
from driftplan.beacons.beacon import Beacon
from driftplan.model.elements import run_moments, turn_moments
from driftplan.model.moments import Moments, compose
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix, Readings, start_errors
from driftplan.planning.roadmap.edge_steps import NO_SITE, SIZE, Steps, spans

_AT_ONCE = 1024  # pieces or edges, whose arrays stay in the cache
N, D, D1_RE, D1_IM, E1_RE, E1_IM, A_RE, A_IM, ONE = range(SIZE)


class ResetEffects(NamedTuple):
    """What edges do to the error state."""

    edge: Ints  # (m,) which edges, sorted
    matrix: Floats  # (m, 9, 9) state at the end = matrix @ state at the beginning
    row: Floats  # (k, 9) row @ state = E|e|² somewhere on the edge
    first: Ints  # (m + 1,) where the rows of each edge begin

    def driven(self, which: Ints, begun: Floats) -> tuple[Floats, Floats]:
        """The states (k, 9, s) after the edges ``edge[which]`` (k,), each begun in s scenarios (k, 9, s), and the
        greatest E|e|² on the way, m², (k, s)."""
        count = self.first[which + 1] - self.first[which]
        of_edge = np.repeat(np.arange(len(which)), count)
        drifts = np.einsum("kj,kjs->ks", self.row[spans(self.first[which], count)], begun[of_edge])
        worst = np.maximum.reduceat(drifts, np.cumsum(count) - count, axis=0)
        return self.matrix[which] @ begun, worst


class ResetEdges:
    """The errors of a robot whose readings replace what they measure, on the edges of one graph."""

    turns_matter = False  # more than the noise says

    def __init__(self, steps: Steps, noises: Sequence[OdometryNoise], beacons: Sequence[Beacon]) -> None:
        self.steps, self.readings = steps, _readings(beacons)
        self.run = np.empty((len(steps.edge), SIZE, SIZE))
        for index in np.unique(steps.which).tolist():
            here = np.flatnonzero(steps.which == index)
            moments = run_moments(steps.length[here], np.zeros(len(here)), noises[index])
            for k in range(0, len(here), _AT_ONCE):
                some = here[k : k + _AT_ONCE]
                self.run[some] = _matrices(moments[k : k + _AT_ONCE], steps.direction[some])

    def at_start(self, initial: Fix | None) -> Floats:
        """The state (9,) of a robot that knows where it is, exactly or as a fix says."""
        return state_of(start_errors(initial))

    def read(self, state: Floats, site: int, place: complex) -> Floats:
        """The state (9,) after reading a beacon at a place."""
        return np.asarray(self.readings[site] @ state)

    def square(self, states: Floats) -> Floats:
        """E|e|², m², of states (..., 9, s)."""
        return states[..., N, :]

    def turns(self, turn_rad: Floats, arriving: complex, noise: OdometryNoise) -> Floats:
        """What turns on the spot (k,) from a direction do, for `turned`."""
        return _matrices(turn_moments(turn_rad, noise), np.full(len(turn_rad), arriving))

    def turned(self, state: Floats, turns: Floats) -> Floats:
        """States (k, 9, s) after each turn from a state (9, s)."""
        return np.asarray(turns @ state)

    def dominance(
        self, max_gap_m: float, slack_sq: float, share: float, turn_rates: tuple[float, float]
    ) -> ResetDominance:
        """The rule for labels: none gets farther than ``max_gap_m`` without a reading; one dominates though its E|e|²
        is worse by ``slack_sq`` m², or if a filter by a ``share``; a radian turned adds at most so much heading (rad²)
        and position variance (m²)."""
        return ResetDominance(max_gap_m, slack_sq, turn_rates)

    def effects(self, edges: Ints, dead: int = NO_SITE) -> ResetEffects:
        """Of edges, with one beacon dead: products along them, one step of many of them at a time."""
        steps, gain = self.steps, self.readings - np.eye(SIZE)
        gain[dead] = 0.0
        begin, count = steps.of_edges(edges)
        first = np.concatenate([[0], np.cumsum(2 * count)])
        matrix = np.broadcast_to(np.eye(SIZE), (len(edges), SIZE, SIZE)).copy()
        row = np.empty((int(first[-1]), SIZE))
        for few in np.split(np.arange(len(edges)), range(_AT_ONCE, len(edges), _AT_ONCE)):
            for k in range(int(count[few].max(initial=0))):
                here = few[count[few] > k]
                step = begin[here] + k
                driven = self.run[step] @ matrix[here]
                row[first[here] + 2 * k] = driven[:, N]
                met = np.flatnonzero(steps.site[step] != NO_SITE)
                chance = steps.chance[step[met], None, None]
                driven[met] += chance * (gain[steps.site[step[met]]] @ driven[met])
                row[first[here] + 2 * k + 1] = driven[:, N]
                matrix[here] = driven
        return ResetEffects(edges, matrix, row, first)


class ResetDominance:
    """Which label makes which superfluous; see above. A score is E|e|², E|δ|², E[e conj δ], (4,)."""

    keys = (0, 1)  # in a score; of a label that dominates they exceed the other's by a share and a slack at most
    share = 0.0

    def __init__(self, max_gap_m: float, slack_sq: float, turn_rates: tuple[float, float]) -> None:
        self.max_gap_m, self.turn_rates = max_gap_m, turn_rates
        self.key_slacks = self.slack_N, self.slack_D = slack_sq, slack_sq / max(max_gap_m, 1e-9) ** 2

    def scores(self, states: Floats) -> Floats:
        """What it looks at, (n, scenarios, 4), of states (n, 9, scenarios)."""
        return np.swapaxes(states[:, [N, D, A_RE, A_IM]], 1, 2)

    def __call__(self, better: Floats, worse: Floats, turn_rad: Floats) -> Bools:
        """Which labels (k,) that first turn by an angle drift no more than others, whatever follows; scores
        (k, scenarios, 4)."""
        gain, far = np.moveaxis(worse - better, -1, 0), self.max_gap_m
        dN = gain[0] + self.slack_N - self.turn_rates[1] * turn_rad[:, None]
        dD = gain[1] + self.slack_D - self.turn_rates[0] * turn_rad[:, None]
        lever = np.hypot(gain[2], gain[3])
        r = np.where(lever >= far * dD, far, lever / np.maximum(dD, 1e-300))
        return np.asarray(((dN >= 0) & (dD >= 0) & (dN + (dD * r - 2 * lever) * r >= 0)).all(axis=1))


def state_of(moments: Moments) -> Floats:
    """The error state of error moments in the world frame, shape (..., 9)."""
    d1, e1, a = (np.asarray(x, dtype=complex) for x in (moments.d1, moments.e1, moments.a))
    columns = (moments.N, moments.D, d1.real, d1.imag, e1.real, e1.imag, a.real, a.imag, np.ones(np.shape(moments.N)))
    return np.stack([np.broadcast_to(np.real(c), np.shape(moments.N)) for c in columns], axis=-1)


def fix_matrix(fix: Fix) -> Floats:
    """What a fix does to the error state, (9, 9)."""
    return np.asarray(_linear(Readings.of([fix]).resets().apply)[0])


def _matrices(pieces: Moments, direction: Complexes) -> Floats:
    """What pieces that begin in a direction do to the error state in the world frame, (n, 9, 9)."""
    turned = pieces.rotated(direction)
    return _linear(lambda state: compose(state, turned))


def _linear(act: Callable[[Moments], Moments]) -> Floats:
    """The matrices (n, 9, 9) of actions on error moments that are affine in the error state, from what they do to a
    basis."""
    basis = np.eye(SIZE)[..., None]
    d1, e1, a = (basis[k] + 1j * basis[k + 1] for k in (D1_RE, E1_RE, A_RE))
    zero = np.zeros((SIZE, 1))
    state = Moments(zero + 1, zero, d1, zero, basis[D], e1, basis[N], zero, a, zero)
    matrix = np.moveaxis(state_of(act(state)), 0, -1)
    matrix[..., :ONE] -= matrix[..., ONE:]  # what is constant belongs to the last column
    matrix[..., ONE, :] = np.eye(SIZE)[ONE]
    return matrix


def _readings(beacons: Sequence[Beacon]) -> Floats:
    """What a reading of each beacon does, (k, 9, 9), and last the identity for 'no beacon'."""
    known: dict[object, Floats] = {}
    for beacon in beacons:
        kind = beacon.kind
        if kind not in known:
            farthest_m = kind.std_per_m * kind.range_m  # on the safe side; finished routes are checked
            cov = None if kind.position_std_m is None else (kind.position_std_m + farthest_m) ** 2 * np.eye(2)
            known[kind] = fix_matrix(Fix(s_m=0.0, position_cov=cov, heading_std=kind.heading_std))
    return np.stack([*(known[beacon.kind] for beacon in beacons), np.eye(SIZE)])
