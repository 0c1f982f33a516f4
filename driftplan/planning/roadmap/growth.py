"""RoadmapSearch: a roadmap that grows in batches towards a goal, and the best path found so far.

Each batch adds nodes (ever more points of a low-discrepancy sequence, the graph kept with the world, all corners of the
inflated obstacles, and the waypoints of the best path so far), finds the cheapest path of the roadmap and polishes it.
What cannot beat the best path is dropped: a node whose obstacle-free geodesic bounds from the start and to the goal add
up to more than the best cost. Same seed, same batches, same path.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from driftplan.arrays import Floats, Ints
from driftplan.beacons.beacon import Beacon
from driftplan.model.noise import OdometryNoise
from driftplan.planning.roadmap.graph import FreeSamples, Roadmap, coarse_corners, places_in_range
from driftplan.planning.roadmap.kept_graph import KeptGraph, channel_route
from driftplan.planning.roadmap.polish import polished, without_needless
from driftplan.planning.roadmap.prices import AdditiveCost, PartOfWorld, Space, exact_drift
from driftplan.world.world import World

_FIRST_BATCH = 128  # samples; every later batch has twice as many, and all corners come with one of them
KEPT_BATCH = 1  # is the graph kept with the world, where there is one
_LARGEST_BATCH = 8192
_MOST_NODES = 40_000  # then a new roadmap is begun, so that memory stays bounded
_CHUNK = 192  # points joined to the roadmap before the clock is looked at again: 20 to 50 ms
_NEIGHBOURS = 14
_NEXT_TO_NOTHING = 2e-4  # of the cost, gained by a batch
_NO_DEARER = 1e-6  # relative
_MAX_DRAWS = 16  # times as many samples as a batch wants,
_MAX_DRAWS_IN_ELLIPSE = 64  # and as a roadmap of given size does
BATCHES_TO_FIND_ONE = 4  # are completed in any case while no path is known


class RoadmapSearch:
    """An anytime search: `grow` adds a batch of nodes and improves `path`."""

    def __init__(
        self, pricing: AdditiveCost, start: Floats, *, seed: int = 0, start_heading: float | None = None, batch: int = 0
    ) -> None:
        self.pricing = pricing
        self.start_heading = start_heading
        self.roadmap = Roadmap(pricing, start, start_heading)
        self.batches = batch  # the first of them may be left out
        self.idle_batches = 0  # the latest ones, that brought next to nothing
        self.path: Floats | None = None
        self.cost = math.inf  # of the path, exact
        self.additive_cost = math.inf
        self._least_additive = math.inf  # of any path found
        self._joined: Floats | None = None  # the latest path that is part of the roadmap
        self._polished: Floats | None = None  # the latest best path that nothing more can be done about
        self._free = FreeSamples(pricing.space, np.random.default_rng(seed).random(2), _MAX_DRAWS)
        self._corners_left: list[Floats] = []  # of those asked for
        self.has_all_corners = False
        space = pricing.space
        self._world = space.world if isinstance(space, PartOfWorld) else space if isinstance(space, World) else None
        self._search_s_per_edge = 0.0
        self._consider(self.roadmap.shortest().nodes, lambda: False)

    @property
    def is_optimal(self) -> bool:
        """Whether no path at all can have less additive cost than the best one found."""
        bound = float(self.pricing.lower_bound(self.roadmap.xy[0], self.roadmap.xy[1]))
        return self.path is not None and self._least_additive <= bound * (1 + 1e-9)

    @property
    def reserve_s(self) -> float:
        """Seconds, about, that it takes to search what has been added so far."""
        return self._search_s_per_edge * len(self.roadmap.edges)

    def grow(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Add a batch of nodes, search, polish. ``stop`` cuts it short; what has been added by then is searched only
        while there is no path: so a longer search comes by all that a shorter one does, in the same order."""
        if stop() and self.path is not None:
            return
        self.roadmap.prune(self._least_additive * (1 + 1e-9))
        if len(self.roadmap.xy) > _MOST_NODES:
            self.roadmap = Roadmap(self.pricing, self.roadmap.xy[0], self.start_heading)
            self.has_all_corners, self._corners_left, self._joined = False, [], None
        roadmap = self.roadmap
        is_whole = self._add(stop)
        if not is_whole and self.path is not None:
            return
        began, before = time.perf_counter(), self.cost
        found = roadmap.shortest(self._least_additive)
        if self.path is None and not len(found.nodes) and self._world is not None:
            way = channel_route(self._world, roadmap.xy[:2])
            if way is not None and self.pricing.space.is_free(way).all():
                roadmap.add(way[1:-1], _NEIGHBOURS, math.inf, chain=True)
                found = roadmap.shortest()
        self._search_s_per_edge = (time.perf_counter() - began) / max(len(roadmap.edges), 1)
        self._consider(found.nodes, stop)
        if is_whole:
            self.batches += 1
            self.idle_batches = 0 if self.cost < before * (1 - _NEXT_TO_NOTHING) else self.idle_batches + 1

    def _add(self, stop: Callable[[], bool]) -> bool:
        """Add the graph kept with the world, or corners and samples, and the best path; whether there was time."""
        if self.batches == KEPT_BATCH and self._world is not None:
            graph = KeptGraph.of(self._world, stop)
            if graph is not None:
                graph.join(self.roadmap, self._least_additive)
                self.has_all_corners, self._joined = graph.has_all_corners, None
                self._join()
            return graph is not None
        if self.batches > KEPT_BATCH and not self.has_all_corners:  # of which the coarse ones are in the kept graph
            self.has_all_corners, corners = True, self._informed(self.pricing.space.corners())
            self._corners_left = [corners[k : k + _CHUNK] for k in range(0, len(corners), _CHUNK)]
        while self._corners_left and not stop():
            self.roadmap.add(self._corners_left.pop(0), _NEIGHBOURS, self._least_additive, all_round=True)
        self._join()
        samples = self._free.next(min(_FIRST_BATCH << min(self.batches, 20), _LARGEST_BATCH), self._informed)
        done = 0
        while done < len(samples) and not stop():
            self.roadmap.add(samples[done : done + _CHUNK], _NEIGHBOURS, self._least_additive)
            done += _CHUNK
        return done >= len(samples) and not self._corners_left

    def consider(self, path: Floats, stop: Callable[[], bool] = lambda: False) -> None:
        """Take a collision-free path (n, 2) from start to goal, as it is or polished, if it is better than the best.

        Polishing lowers the additive cost, not always the exact one. Whatever a search that is cut short would be left
        with is considered by a longer one too: the path after every sweep.
        """
        path = path[np.append(True, (np.diff(path, axis=0) != 0).any(axis=1))]
        self.offer(path)
        if stop():
            return
        before, swept = self.cost, list[Floats]()
        better = polished(self.pricing, path, self.start_heading, stop, tell=swept.append)
        late = stop()
        for other in swept:
            self.offer(other, self.cost * (1 - _NO_DEARER))
        if late:
            return
        for found in swept:
            if self.path is found:  # it has waypoints that it does not need
                below = min(before, self.cost * (1 + _NO_DEARER))
                self.offer(without_needless(self.pricing, found, self.start_heading), below)
                self.offer(better, below)
                break
        else:
            self.offer(better)
        if self.path is better:
            self._polished = better

    def _consider(self, nodes: Ints, stop: Callable[[], bool]) -> None:
        path = self.roadmap.xy[nodes]
        if len(path) and not (self._polished is not None and np.array_equal(path, self._polished)):
            self.consider(path, stop)

    def offer(self, path: Floats, below: float | None = None) -> None:
        """Take a collision-free path as it is, if it is the best by exact cost, or its exact cost is ``below``."""
        additive = cost = self.pricing.path(path, self.start_heading)
        self._least_additive = min(self._least_additive, additive)
        if self.pricing.minimise == "drift":
            end = exact_drift(self.pricing.space, path, self.pricing.noise, self.start_heading).end
            cost = float(end.rms) ** 2
        if cost < (self.cost if below is None else below):
            self.path, self.cost, self.additive_cost = path, cost, additive

    def _join(self) -> None:
        """Make the best path part of the roadmap."""
        if self.path is not None and self.path is not self._joined and len(self.path) > 2:
            self.roadmap.add(self.path[1:-1], _NEIGHBOURS, math.inf, chain=True)
        self._joined = self.path

    def _informed(self, points: Floats) -> Floats:
        lower = self.pricing.lower_bound
        bound = lower(self.roadmap.xy[0], points) + lower(points, self.roadmap.xy[1])
        return np.asarray(points[bound < self._least_additive])


def roadmap_among_beacons(
    space: Space,
    world: World | None,
    ends: Floats,
    noise: OdometryNoise,
    beacons: Sequence[Beacon],
    *,
    max_nodes: int,
    known: Sequence[Floats],
    longest: float,
    seed: int,
) -> Roadmap:
    """A roadmap of about ``max_nodes`` nodes from ``ends[0]`` (node 0) to ``ends[1]`` (node 1), priced by length:
    waypoints of ``known`` paths (k, 2), corners, places within range of beacons, and even samples; for routes up to
    ``longest`` metres."""

    def useful(points: Floats) -> Floats:
        around = np.linalg.norm(points - ends[0], axis=-1) + np.linalg.norm(points - ends[1], axis=-1)
        return np.asarray(points[around <= longest])

    roadmap = Roadmap(AdditiveCost(space, ends[1], noise, "length"), ends[0])
    for path in known:
        roadmap.add(path[1:-1], _NEIGHBOURS, longest, chain=True)
    rng = np.random.default_rng(seed)
    corners = coarse_corners(space)
    if len(corners) > max_nodes // 3:
        corners = corners[np.sort(rng.permutation(len(corners))[: max_nodes // 3])]
    roadmap.add(useful(corners), _NEIGHBOURS, longest)
    places = places_in_range(space, world, beacons, max_places=max(max_nodes // 2, len(beacons)))
    roadmap.add(useful(places), _NEIGHBOURS, longest)
    wanted = max(max_nodes - len(roadmap.xy), max_nodes // 5)
    samples = FreeSamples(space, rng.random(2), _MAX_DRAWS_IN_ELLIPSE)
    roadmap.add(samples.next(wanted, useful), _NEIGHBOURS, longest)
    return roadmap
