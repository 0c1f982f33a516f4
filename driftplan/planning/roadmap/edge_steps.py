"""What happens along the edges of a roadmap among beacons: runs in one zone, readings, and where they are.

Within an edge beacons are read where the range is entered and left and at most `reading_spacing_m` apart between, if
they are in sight there. On a path of several edges a pass is longer, and its readings are spaced over all of it: at a
node within range there mostly is none. A reading more does a robot that resets little good, but to a filter it is
worth as much as any. So a reading at a node, or on an edge that ends at one, has a `share`: how many of the readings
that a pass through the middle of the range has between its ends fall to the metres driven since the last. Where the
path ends it is read. A pass that is noticed with a probability below one is noticed here where the range is left. These
are small differences from `driftplan.beacons.readings`, whose model decides about every finished path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely

from driftplan.arrays import Bools, Complexes, Floats, Ints
from driftplan.beacons.passes import chords_in_discs
from driftplan.beacons.readings import BeaconColumns
from driftplan.world.world import World

NO_SITE = -1
SIZE = 9  # of an error state, but for a filter that estimates constants; of s scenarios of dead beacons (9, s)
_LEAST_M = 1e-6  # a range touched on less than this is a graze, read once


class Steps(NamedTuple):
    """A run, then a reading or nothing; sorted by edge and place."""

    edge: Ints
    first: Ints  # (edges + 1,) where the steps of each edge begin
    direction: Complexes  # (k,) of the run: a unit complex number
    length: Floats  # metres
    which: Ints  # the noise of the run: 0 that of the world, z + 1 that of zone z
    place: Complexes  # where it ends, x + jy in metres
    site: Ints  # whose reading ends it, or `NO_SITE`
    chance: Floats
    share: Floats  # of a reading

    def of_edges(self, edges: Ints) -> tuple[Ints, Ints]:
        """First step and number of steps of some edges."""
        return self.first[edges], self.first[edges + 1] - self.first[edges]


def spans(first: Ints, count: Ints) -> Ints:
    """Indices of so many things in a row from each first one."""
    return np.asarray(np.arange(int(count.sum())) + np.repeat(first - (np.cumsum(count) - count), count))


def edge_steps(
    a: Floats, direction: Complexes, length: Floats, last: Bools, beacons: BeaconColumns, world: World | None
) -> Steps:
    """Steps of edges that begin at ``a`` (m, 2); paths end with ``last`` ones."""
    along = np.stack([direction.real, direction.imag], axis=-1)
    edge, site, s, share = _edge_readings(a, along, length, last, beacons, world)
    zone_edge, zone_end, zone = _zone_borders(a, along, length, world)
    rank = np.concatenate([beacons.rank[site], np.full(len(zone_edge), -1)])
    chance = np.concatenate([beacons.detection_probability[site], np.ones(len(zone_edge))])
    kind = np.concatenate([np.full(len(s), -2), zone])
    edge, s = np.concatenate([edge, zone_edge]), np.concatenate([s, zone_end])
    site = np.concatenate([site, np.full(len(zone_edge), NO_SITE)]).astype(np.intp)
    order = np.lexsort((rank, s, edge))
    edge, site, s, chance, kind = edge[order], site[order], s[order], chance[order], kind[order]
    before = np.where(np.diff(edge, prepend=-1) > 0, 0.0, np.concatenate([[0.0], s[:-1]]))
    # the zone of a step is that of the next zone border, its own included
    following = np.where(kind > -2, np.arange(len(kind)), len(kind))
    following = np.minimum.accumulate(following[::-1])[::-1]
    return Steps(
        edge,
        np.searchsorted(edge, np.arange(len(length) + 1)),
        direction[edge],
        np.maximum(s - before, 0.0),
        kind[np.minimum(following, len(kind) - 1)] + 1,
        a[edge] @ np.array([1.0, 1j]) + s * direction[edge],
        site,
        chance,
        np.concatenate([share, np.ones(len(zone_edge))])[order],
    )


def _zone_borders(a: Floats, along: Floats, length: Floats, world: World | None) -> tuple[Ints, Floats, Ints]:
    """Edge, distance and zone of every stretch of one zone; the last one of an edge ends where it does."""
    if world is None or not world.zones:
        return np.arange(len(length)), length, np.full(len(length), -1, dtype=np.intp)
    pieces = world.zone_pieces(a, a + length[:, None] * along)
    end = np.where(pieces.end >= 1, length[pieces.segment], pieces.end * length[pieces.segment])
    return pieces.segment.astype(np.intp), end, pieces.zone.astype(np.intp)


def _edge_readings(
    a: Floats, along: Floats, length: Floats, last: Bools, beacons: BeaconColumns, world: World | None
) -> tuple[Ints, Ints, Floats, Floats]:
    """Edge, beacon, distance and share of every reading; none where an edge begins, for that was read before."""
    if not len(beacons.xy):
        none = np.zeros(0, dtype=np.intp)
        return none, none, np.zeros(0), np.zeros(0)
    b, farthest = a + length[:, None] * along, float(beacons.range_m.max())
    low, high = np.minimum(a, b) - farthest, np.maximum(a, b) + farthest
    boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    edge, site = shapely.STRtree(shapely.points(beacons.xy)).query(boxes)
    order = np.lexsort((site, edge))
    edge, site = edge[order], site[order]
    start, end, within = chords_in_discs(beacons.xy[site] - a[edge], along[edge], length[edge], beacons.range_m[site])
    edge, site, start, end = edge[within], site[within], start[within], end[within]
    sure = beacons.detection_probability[site] == 1
    parts = np.ceil((end - start) / beacons.reading_spacing_m[site] - 1e-6)
    count = np.where(sure & (end - start > _LEAST_M), np.maximum(parts, 1) + 1, 1).astype(np.intp)
    begun, cut = start < _LEAST_M, (end > length[edge] - _LEAST_M) & ~last[edge]  # with the pass going on
    diameter = 2 * beacons.range_m[site]
    per_m = (np.ceil(diameter / beacons.reading_spacing_m[site] - 1e-6) - 1) / diameter
    part_share = np.minimum((end - start) / np.maximum(parts, 1) * per_m, 1.0)
    k = np.repeat(np.arange(len(edge)), count)
    index = spans(np.zeros(len(count), dtype=np.intp), count)
    back = (count[k] - 1 - index) / np.maximum(count[k] - 1, 1)  # the only reading is the one on leaving
    s = end[k] - back * (end - start)[k]
    partly = sure[k] & np.where(back == 0, cut[k], (begun | cut)[k] & (back < 1))
    share = np.where(partly, part_share[k], 1.0)
    edge, site, sure = edge[k], site[k], sure[k]
    keep = (s > _LEAST_M) & (sure | (s < length[edge] - _LEAST_M))
    places = a[edge] + s[:, None] * along[edge]
    if world is not None:
        asked = np.flatnonzero(keep & beacons.must_see[site])
        keep[asked] = world.line_of_sight(places[asked], beacons.xy[site[asked]])
    keep &= beacons.views.at(site, places - beacons.xy[site], np.arctan2(along[edge, 1], along[edge, 0]))
    return edge[keep], site[keep], s[keep], share[keep]
