"""Nodes for routes that visit beacons: corners, places within range, waypoints of a known path, and even samples."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import BeaconColumns
from driftplan.model.noise import OdometryNoise
from driftplan.planning.roadmap.graph import Roadmap
from driftplan.planning.roadmap.prices import Pricing, Space
from driftplan.world.world import World

_NEIGHBOURS = 14
_DIRECTIONS = 8  # in which a place within range is looked for
_DEPTHS = (0.35, 0.7)  # in units of the range
_STEP = 1.32471795724474602596 ** -np.array([1.0, 2.0])  # additive recurrence of the plastic number
_DRAWS = 64


def itinerary_roadmap(
    space: Space,
    world: World | None,
    ends: Floats,
    noise: OdometryNoise,
    beacons: Sequence[Beacon],
    *,
    nodes: int,
    known: Floats,
    longest: float,
    seed: int,
) -> Roadmap:
    """A roadmap of about ``nodes`` nodes from ``ends[0]`` (node 0) to ``ends[1]`` (node 1), priced by length.

    Parameters
    ----------
    known : (k, 2) a path whose waypoints become nodes
    longest : longer routes are of no interest, metres
    """
    roadmap = Roadmap(Pricing(space, ends[1], noise, "length"), ends[0])
    roadmap.add(known[1:-1], _NEIGHBOURS, longest, chain=True)
    xmin, ymin, xmax, ymax = space.bounds
    radius = getattr(space, "robot_radius", 0.0)
    corners = space.corners(max(radius / 4, 1e-3 * math.hypot(xmax - xmin, ymax - ymin)))
    rng = np.random.default_rng(seed)
    if len(corners) > nodes // 3:
        corners = corners[np.sort(rng.permutation(len(corners))[: nodes // 3])]
    roadmap.add(_useful(corners, ends, longest), _NEIGHBOURS, longest)
    stations = places_in_range(space, world, beacons, most=max(nodes // 2, len(beacons)))
    roadmap.add(_useful(stations, ends, longest), _NEIGHBOURS, longest)
    wanted = max(nodes - len(roadmap.xy), nodes // 5)
    roadmap.add(_samples(space, ends, longest, wanted, rng.random(2)), _NEIGHBOURS, longest)
    return roadmap


def places_in_range(space: Space, world: World | None, beacons: Sequence[Beacon], most: int) -> Floats:
    """Free points within range of each beacon, and in its sight where that matters: the nearest, then others spread
    around it; about ``most`` in all, (n, 2)."""
    if not beacons:
        return np.zeros((0, 2))
    columns = BeaconColumns.of(beacons)
    per = int(np.clip(most // len(beacons), 1, _DIRECTIONS))
    angle = np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    offsets = np.concatenate([np.zeros((1, 2)), *(depth * circle for depth in _DEPTHS)])
    places = columns.xy[:, None, :] + columns.range_m[:, None, None] * offsets
    good = space.is_free(places)
    if world is not None:
        asked = good & columns.must_see[:, None]
        good[asked] = world.line_of_sight(places[asked], columns.xy[np.nonzero(asked)[0]])
    # the nearest first, then one direction after the other with big steps
    spread = (3 * np.arange(_DIRECTIONS)) % _DIRECTIONS
    order = np.concatenate([[0], *(1 + _DIRECTIONS * ring + spread for ring in range(len(_DEPTHS)))])
    rank = np.cumsum(good[:, order], axis=1)
    chosen = good[:, order] & (rank <= per)
    return np.asarray(places[:, order][chosen])


def _samples(space: Space, ends: Floats, longest: float, count: int, first: Floats) -> Floats:
    xmin, ymin, xmax, ymax = space.bounds
    found: list[Floats] = [np.zeros((0, 2))]
    wanted = count
    for draw in range(_DRAWS):
        unit = (first + _STEP * np.arange(draw * count, (draw + 1) * count)[:, None]) % 1.0
        points = _useful(unit * (xmax - xmin, ymax - ymin) + (xmin, ymin), ends, longest)
        found.append(points[space.is_free(points)][:wanted])
        wanted -= len(found[-1])
        if wanted <= 0:
            break
    return np.concatenate(found)


def _useful(points: Floats, ends: Floats, longest: float) -> Floats:
    """Those that a route no longer than ``longest`` can pass."""
    around = np.linalg.norm(points - ends[0], axis=-1) + np.linalg.norm(points - ends[1], axis=-1)
    return np.asarray(points[around <= longest])
