"""A roadmap on which every directed edge knows what driving it does to a robot's drift, beacons on the way included.

E|e|² at the end of a motion depends on what came before only through the error state

    x = (E|e|², E|δ|², E δ, E e, E[e conj δ], 1)        (real and imaginary parts: nine numbers, world frame),

and driving a straight run, reading a beacon and missing it with some probability all act on x by matrices. (The other
second moments, E e² and E δ², never flow back into E|e|².) So an edge is one matrix, whatever is read on it, and the
drift at every place where it could be greatest - before and after every reading, and at the end - is one row each.

Within an edge beacons are read where the range is entered and left and at most `reading_spacing_m` apart between, if
they are in sight there. On a path of several edges a pass is longer, and its readings are spaced over all of it; and a
pass that is noticed with a probability below one is noticed here where the range is left. These are small differences
from `driftplan.beacons.beacon`, whose model decides about every finished path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import shapely

from driftplan.arrays import Complexes, Floats, Ints
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import BeaconColumns
from driftplan.model.elements import run_moments, turn_moments
from driftplan.model.moments import Moments
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix, Readings, start_errors
from driftplan.world.world import World

SIZE = 9  # of the error state
N, D, D1_RE, D1_IM, E1_RE, E1_IM, A_RE, A_IM, ONE = range(SIZE)
_LEAST_M = 1e-6  # a range touched on less than this is a graze, read once


class Effects(NamedTuple):
    """What edges do to the error state."""

    edge: Ints  # (m,) which edges; sorted
    matrix: Floats  # (m, 9, 9) state at the end = matrix @ state at the beginning
    row: Floats  # (k, 9) row @ state = E|e|² somewhere on the edge
    first: Ints  # (m + 1,) where the rows of each edge begin


class _Steps(NamedTuple):
    """What happens along directed edges, sorted by edge and place: a run, then a reading or nothing."""

    edge: Ints
    run: Floats  # (k, 9, 9)
    site: Ints  # whose reading ends the run; -1: none
    chance: Floats


@dataclass(frozen=True, eq=False)
class BeaconGraph:
    """Nodes (n, 2) and directed edges sorted by where they leave, with their `Effects`."""

    xy: Floats
    first: Ints  # (n + 1,) where the edges out of each node begin
    tail: Ints  # (m,)
    head: Ints  # (m,)
    direction: Complexes  # (m,) unit complex numbers
    length: Floats  # (m,) metres
    effects: Effects  # with all beacons alive
    noise: OdometryNoise
    beacons: tuple[Beacon, ...]
    world: World | None
    _steps: _Steps = field(repr=False)
    _first_step: Ints = field(repr=False)
    _turns: dict[complex, dict[int, Floats]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, xy: Floats, edges: Ints, noise: OdometryNoise, beacons: Sequence[Beacon], world: World | None
    ) -> BeaconGraph:
        """The roadmap over nodes ``xy`` (n, 2) and undirected ``edges`` (m, 2)."""
        tail = np.concatenate([edges[:, 0], edges[:, 1]]).astype(np.intp)
        head = np.concatenate([edges[:, 1], edges[:, 0]]).astype(np.intp)
        order = np.lexsort((head, tail))
        tail, head = tail[order], head[order]
        vector = (xy[head] - xy[tail]) @ np.array([1.0, 1j])
        length = np.abs(vector)
        steps = _steps(xy[tail], vector / length, length, noise, beacons, world)
        every = np.arange(len(tail))
        first_step = np.searchsorted(steps.edge, np.arange(len(tail) + 1))
        return cls(
            xy=xy,
            first=np.searchsorted(tail, np.arange(len(xy) + 1)),
            tail=tail,
            head=head,
            direction=vector / length,
            length=length,
            effects=_effects(steps, first_step, every, _readings(beacons)),
            noise=noise,
            beacons=tuple(beacons),
            world=world,
            _steps=steps,
            _first_step=first_step,
        )

    def without(self, site: int) -> Effects:
        """Effects of the edges on which a beacon is read, were it dead; with as many rows as when it is alive."""
        touched = np.unique(self._steps.edge[self._steps.site == site])
        readings = _readings(self.beacons)
        readings[site] = np.eye(SIZE)
        return _effects(self._steps, self._first_step, touched, readings)

    def at_start(self, node: int, initial: Fix | None, dead: int = -1) -> Floats:
        """The error state (9,) of a robot that begins at a node: known exactly or as ``initial`` says, after reading
        what is in range and always noticed."""
        x = state_of(start_errors(initial))
        columns = BeaconColumns.of(self.beacons)
        here = np.broadcast_to(self.xy[node], columns.xy.shape)
        inside = np.hypot(*(columns.xy - here).T) <= columns.range_m
        inside &= columns.detection_probability == 1
        if self.world is not None:
            asked = inside & columns.must_see
            inside[asked] = self.world.line_of_sight(here[asked], columns.xy[asked])
        inside &= columns.views.sensor_half_angle >= np.pi  # whoever stands does not know yet where it will look
        inside &= columns.views.at(np.arange(len(inside)), here - columns.xy, np.zeros(len(inside)))
        readings = _readings(self.beacons)
        for site in sorted(np.flatnonzero(inside).tolist(), key=lambda i: int(columns.rank[i])):
            if site != dead:
                x = readings[site] @ x
        return x

    @property
    def turns_matter(self) -> bool:
        return any(noise.turns_matter for noise in self._noises)

    @property
    def _noises(self) -> list[OdometryNoise]:
        return [self.noise, *(zone.noise for zone in (self.world.zones if self.world is not None else ()))]

    def worst_turn(self) -> tuple[float, float]:
        """Heading and position variance per radian turned, at most."""
        return (
            max(noise.heading_var_per_rad for noise in self._noises),
            max(noise.distance_var_per_rad for noise in self._noises),
        )

    def turns(self, node: int, arriving: complex) -> Floats:
        """What turning from a direction to each edge out of a node does to the error state, (k, 9, 9)."""
        known = self._turns.setdefault(arriving, {})
        if node not in known:
            out = slice(int(self.first[node]), int(self.first[node + 1]))
            away = self.direction[out]
            turn = np.angle(away * np.conj(arriving))
            result = np.empty((len(away), SIZE, SIZE))
            zone = self._zone_after(node, away)
            for index in np.unique(zone).tolist():
                kind = self._noises[index + 1]
                here = np.flatnonzero(zone == index)
                result[here] = _matrices(turn_moments(turn[here], kind), np.full(len(here), arriving))
            known[node] = result
        return known[node]

    def _zone_after(self, node: int, away: Complexes) -> Ints:
        """Zone just after the node on each edge out of it; -1 for none."""
        if self.world is None or not self.world.zones:
            return np.full(len(away), -1, dtype=np.intp)
        points = self.xy[node] + 1e-6 * np.stack([away.real, away.imag], axis=-1)
        return np.asarray(self.world.zone_at(points), dtype=np.intp)


def state_of(moments: Moments) -> Floats:
    """The error state of error moments in the world frame, shape (..., 9)."""
    d1, e1, a = (np.asarray(x, dtype=complex) for x in (moments.d1, moments.e1, moments.a))
    columns = (moments.N, moments.D, d1.real, d1.imag, e1.real, e1.imag, a.real, a.imag, np.ones(np.shape(moments.N)))
    return np.stack([np.broadcast_to(np.real(c), np.shape(moments.N)) for c in columns], axis=-1)


def fix_matrix(fix: Fix) -> Floats:
    """What a fix does to the error state, (9, 9)."""
    return _linear(Readings.of([fix]).resets()[0].apply, ())


def _matrices(pieces: Moments, direction: Complexes) -> Floats:
    """What pieces that begin in a direction do to the error state in the world frame, (n, 9, 9): the terms of
    `driftplan.model.moments.compose` that flow into it, sorted by what they multiply."""
    turned = pieces.rotated(direction)
    p, d1, e1, a = (np.asarray(x, dtype=complex) for x in (turned.p, turned.d1, turned.e1, turned.a))
    lever = p + e1
    epsilon = np.conj(p) * e1 + turned.N
    kappa = p * np.conj(d1) + a
    matrix = np.zeros((*pieces.shape, SIZE, SIZE))
    matrix[..., N, N] = matrix[..., ONE, ONE] = 1
    matrix[..., N, D] = (np.conj(p) * lever).real + epsilon.real
    for column, factor in ((D1_RE, epsilon), (E1_RE, e1), (A_RE, lever)):
        matrix[..., N, column], matrix[..., N, column + 1] = 2 * factor.real, 2 * factor.imag
    matrix[..., N, ONE] = turned.N.real
    matrix[..., D, D] = 1 + 2 * d1.real + turned.D.real
    gain = np.conj(d1) + turned.D
    matrix[..., D, D1_RE], matrix[..., D, D1_IM], matrix[..., D, ONE] = 2 * gain.real, -2 * gain.imag, turned.D.real
    for row, column, factor in (
        (D1_RE, D1_RE, 1 + d1),
        (E1_RE, E1_RE, np.ones(pieces.shape)),
        (E1_RE, D1_RE, lever),
        (A_RE, A_RE, 1 + np.conj(d1)),
        (A_RE, E1_RE, np.conj(d1)),
        (A_RE, D1_RE, kappa),
    ):
        matrix[..., row, column] += factor.real
        matrix[..., row, column + 1] -= factor.imag
        matrix[..., row + 1, column] += factor.imag
        matrix[..., row + 1, column + 1] += factor.real
    mirrored = e1 + a  # multiplies conj(E δ)
    matrix[..., A_RE, D1_RE] += mirrored.real
    matrix[..., A_RE, D1_IM] += mirrored.imag
    matrix[..., A_IM, D1_RE] += mirrored.imag
    matrix[..., A_IM, D1_IM] -= mirrored.real
    for row, column, value in ((A_RE, D, lever + kappa), (D1_RE, ONE, d1), (E1_RE, ONE, e1), (A_RE, ONE, a)):
        matrix[..., row, column] += value.real
        matrix[..., row + 1, column] += value.imag
    return matrix


def _linear(act: Callable[[Moments], Moments], shape: tuple[int, ...]) -> Floats:
    """The matrix of an action on error moments that is linear in the error state, from what it does to a basis."""
    zero = np.zeros(shape)
    columns = []
    for k in range(SIZE):
        x = np.zeros(SIZE)
        x[k] = 1.0
        d1, e1, a = complex(x[D1_RE], x[D1_IM]), complex(x[E1_RE], x[E1_IM]), complex(x[A_RE], x[A_IM])
        state = Moments(zero + 1, zero, zero + d1, zero, zero + x[D], zero + e1, zero + x[N], zero, zero + a, zero)
        columns.append(state_of(act(state)))
    matrix = np.stack(columns, axis=-1)
    matrix[..., :ONE] -= matrix[..., ONE:]  # an action is affine: its constant part belongs to the last column
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


def _effects(steps: _Steps, first_step: Ints, edges: Ints, readings: Floats) -> Effects:
    """Products along edges, one step of all of them at a time."""
    begin = first_step[edges]
    count = first_step[edges + 1] - begin
    first = np.concatenate([[0], np.cumsum(2 * count)])
    matrix = np.broadcast_to(np.eye(SIZE), (len(edges), SIZE, SIZE)).copy()
    row = np.empty((int(first[-1]), SIZE))
    for k in range(int(count.max(initial=0))):
        here = np.flatnonzero(count > k)
        step = begin[here] + k
        driven = steps.run[step] @ matrix[here]
        chance = steps.chance[step, None, None]
        read = driven + chance * ((readings[steps.site[step]] - np.eye(SIZE)) @ driven)
        row[first[here] + 2 * k], row[first[here] + 2 * k + 1] = driven[:, N], read[:, N]
        matrix[here] = read
    return Effects(edges, matrix, row, first)


def _steps(
    a: Floats,
    direction: Complexes,
    length: Floats,
    noise: OdometryNoise,
    beacons: Sequence[Beacon],
    world: World | None,
) -> _Steps:
    """Steps of edges that begin at ``a`` (m, 2)."""
    along = np.stack([direction.real, direction.imag], axis=-1)
    columns = BeaconColumns.of(beacons)
    edge, site, s, chance = _edge_readings(a, along, length, columns, world)
    rank = columns.rank[site] if len(beacons) else np.zeros(0, dtype=np.intp)
    zone_edge, zone_end, zone = _zone_borders(a, along, length, world)
    edge = np.concatenate([edge, zone_edge])
    site = np.concatenate([site, np.full(len(zone_edge), -1)]).astype(np.intp)
    s = np.concatenate([s, zone_end])
    chance = np.concatenate([chance, np.ones(len(zone_edge))])
    rank = np.concatenate([rank, np.full(len(zone_edge), -1)])
    kind = np.concatenate([np.full(len(s) - len(zone), -2), zone])
    order = np.lexsort((rank, s, edge))
    edge, site, s, chance, kind = edge[order], site[order], s[order], chance[order], kind[order]
    new = np.concatenate([[True], edge[1:] != edge[:-1]]) if len(edge) else np.zeros(0, dtype=bool)
    before = np.where(new, 0.0, np.concatenate([[0.0], s[:-1]])) if len(edge) else s
    # the zone of a step is that of the next zone border, its own included
    following = np.where(kind > -2, np.arange(len(kind)), len(kind))
    following = np.minimum.accumulate(following[::-1])[::-1]
    zone_of = kind[np.minimum(following, len(kind) - 1)]
    kinds = [noise, *(z.noise for z in (world.zones if world is not None else ()))]
    run = np.empty((len(edge), SIZE, SIZE))
    driven = np.maximum(s - before, 0.0)
    for index in np.unique(zone_of).tolist():
        here = np.flatnonzero(zone_of == index)
        moments = run_moments(driven[here], np.zeros(len(here)), kinds[index + 1])
        run[here] = _matrices(moments, direction[edge[here]])
    return _Steps(edge, run, site, chance)


def _zone_borders(a: Floats, along: Floats, length: Floats, world: World | None) -> tuple[Ints, Floats, Ints]:
    """Edge, distance and zone of every stretch of one zone; the last one of an edge ends where it does."""
    if world is None or not world.zones:
        return np.arange(len(length)), length, np.full(len(length), -1, dtype=np.intp)
    pieces = world.zone_pieces(a, a + length[:, None] * along)
    end = np.where(pieces.end >= 1, length[pieces.segment], pieces.end * length[pieces.segment])
    return pieces.segment.astype(np.intp), end, pieces.zone.astype(np.intp)


def _edge_readings(
    a: Floats, along: Floats, length: Floats, beacons: BeaconColumns, world: World | None
) -> tuple[Ints, Ints, Floats, Floats]:
    """Edge, beacon, distance and chance of every reading; none where an edge begins, for that was read before."""
    if not len(beacons.xy):
        none = np.zeros(0, dtype=np.intp)
        return none, none, np.zeros(0), np.zeros(0)
    reach = float(beacons.range_m.max())
    low, high = np.minimum(a, a + length[:, None] * along) - reach, np.maximum(a, a + length[:, None] * along) + reach
    boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    edge, site = shapely.STRtree(shapely.points(beacons.xy)).query(boxes)
    order = np.lexsort((site, edge))
    edge, site = edge[order], site[order]
    offset, range_m = beacons.xy[site] - a[edge], beacons.range_m[site]
    foot = np.einsum("nk,nk->n", offset, along[edge])
    aside = offset[:, 0] * along[edge, 1] - offset[:, 1] * along[edge, 0]
    half = np.sqrt(np.maximum(range_m**2 - aside**2, 0.0))
    start, end = np.maximum(foot - half, 0.0), np.minimum(foot + half, length[edge])
    within = (np.abs(aside) <= range_m) & (start <= end)
    edge, site, start, end = edge[within], site[within], start[within], end[within]
    sure = beacons.detection_probability[site] == 1
    parts = np.ceil((end - start) / beacons.reading_spacing_m[site] - 1e-6)
    count = np.where(sure & (end - start > _LEAST_M), np.maximum(parts, 1) + 1, 1).astype(np.intp)
    k = np.repeat(np.arange(len(edge)), count)
    index = np.arange(len(k)) - np.repeat(np.cumsum(count) - count, count)
    back = (count[k] - 1 - index) / np.maximum(count[k] - 1, 1)  # the only reading is the one on leaving
    s = end[k] - back * (end - start)[k]
    edge, site, sure = edge[k], site[k], sure[k]
    keep = (s > _LEAST_M) & (sure | (s < length[edge] - _LEAST_M))
    if world is not None:
        asked = np.flatnonzero(keep & beacons.must_see[site])
        places = a[edge[asked]] + s[asked, None] * along[edge[asked]]
        keep[asked] = world.line_of_sight(places, beacons.xy[site[asked]])
    away = a[edge] + s[:, None] * along[edge] - beacons.xy[site]
    keep &= beacons.views.at(site, away, np.arctan2(along[edge, 1], along[edge, 0]))
    edge, site, s = edge[keep], site[keep], s[keep]
    return edge, site, s, beacons.detection_probability[site]
