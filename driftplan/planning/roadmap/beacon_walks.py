"""BeaconWalks: one pair of ends, one set of beacons, and walks between them that the exact model agrees with.

A roadmap (`driftplan.planning.roadmap.growth`) is turned into a graph whose edges carry what driving and reading do to
the drift (`driftplan.planning.roadmap.beacon_graph`); label searches (`driftplan.planning.roadmap.label_search`) look
for the best walk, whose path is then put to the exact model (`driftplan.planning.roadmap.itinerary_check`). Where that
disagrees with the graph, the search is asked again, for a little more.

All work is counted in labels and trials, not in seconds: the same seed gives the same path unless `stop` interfered.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.errors import NoPathError
from driftplan.model.noise import OdometryNoise
from driftplan.planning.bounds import max_distance_within
from driftplan.planning.cost import CostRates
from driftplan.planning.request import Objective, Reliance, format_point
from driftplan.planning.roadmap.beacon_graph import BeaconGraph
from driftplan.planning.roadmap.graph import GOAL, START, Roadmap
from driftplan.planning.roadmap.growth import BATCHES_TO_FIND_ONE, RoadmapSearch, roadmap_among_beacons
from driftplan.planning.roadmap.itinerary_check import ALL_ALIVE, ItineraryCheck
from driftplan.planning.roadmap.label_search import LabelProblem, Walk, best_walk
from driftplan.planning.roadmap.prices import AdditiveCost, Score, Space, length_of
from driftplan.world.world import World
from driftplan.world.zones import noises_on

WORST_TOLERANCE = 0.02  # of the least worst drift, and of end drifts that dead beacons change
ROUNDING = 1e-9
FINE = 0.015  # slack of labels as a share of the limit squared, for a good path
MAX_LABELS = 100_000  # of one search
_LIMIT_STEP = 0.97  # of the limit that the graph is held to, when the exact model finds it broken
_MARGIN_GROWTH = 1.4  # the margin within ranges, when beacons would be missed
_NEARLY = 1.1  # times the limit that is asked for, a graph may be held to in looking for routes that keep it
_MARGIN_STEP = 0.03  # of the widest range
_MAX_ATTEMPTS = 12
_BATCHES = 2  # of the roadmap for the shortest path


class BeaconWalks:
    """Paths from ``ends[0]`` to ``ends[1]`` that count on beacons.

    Parameters
    ----------
    space : where the robot may drive
    world : what blocks sight, and zones; None: nothing does and there are none
    stop : asked often; once it says True every question ends with the best answer so far and `timed_out` is set
    stop_shortening : the same for shortening what was found; default: ``stop``
    shortest : the shortest path, where it is known from another search
    known : other collision-free paths between the ends, to be considered

    Attributes
    ----------
    shortest : the shortest path found, drift or not
    labels, latest, max_labels : kept by all searches; slack and labels of the latest; how many one may keep
    timed_out : whether ``stop`` cut anything short
    exhausted : whether a search gave up at its greatest number of labels, so that finding nothing proves nothing
    nearest : (place, metres), how near to the goal any label came
    """

    def __init__(
        self,
        space: Space,
        world: World | None,
        ends: Floats,
        noise: OdometryNoise,
        reliance: Reliance,
        *,
        max_nodes: int = 1000,
        seed: int = 0,
        stop: Callable[[], bool] = lambda: False,
        stop_shortening: Callable[[], bool] | None = None,
        shortest: Floats | None = None,
        known: Sequence[Floats] = (),
    ) -> None:
        self.space, self.world, self.ends, self.noise, self.reliance = space, world, ends, noise, reliance
        self.beacons, self.max_nodes, self.seed = reliance.beacons, max_nodes, seed
        self.stop, self.stop_shortening = stop, stop_shortening or stop
        self.check = ItineraryCheck(world, noise, reliance)
        self.labels, self.latest, self.max_labels = 0, (FINE, 0), MAX_LABELS
        self.timed_out = self.exhausted = False
        self.known = tuple(known)
        self.shortest = self._grown("length") if shortest is None else shortest
        self.nearest: tuple[Floats, float] = (ends[0], length_of(self.shortest))
        self._roadmaps: dict[float, tuple[Roadmap, Floats]] = {}  # by the greatest length; lengths to the goal
        self._graphs: dict[tuple[float, float], BeaconGraph] = {}  # by that and the margin
        self._worst: dict[bytes, float] = {}  # of paths
        self._rough: dict[float, Floats] = {}  # by the greatest length
        self._steadiest: dict[float, Floats] = {}
        self._steady_and_short: dict[float, Floats] = {}

    def max_length(self, minimise: Objective) -> float:
        """The greatest length that the detour allows, metres."""
        return self.reliance.detour(minimise) * length_of(self.shortest) * (1 + ROUNDING)

    @cached_property
    def unaided(self) -> Floats:
        """A path of low drift at its end for a robot that reads no beacon."""
        return self._grown("drift")

    @property
    def noises(self) -> tuple[OdometryNoise, ...]:
        """The noise, and that of every zone."""
        return noises_on(self.world, self.noise)

    @property
    def roadmap(self) -> Roadmap | None:
        """The latest roadmap; None while the shortest path answered everything."""
        return list(self._roadmaps.values())[-1][0] if self._roadmaps else None

    def late(self) -> bool:
        """Whether it is time to stop."""
        self.timed_out = self.timed_out or self.stop()
        return self.timed_out

    def graph(self, margin: float, longest: float = math.inf) -> BeaconGraph:
        """A roadmap with the readings of beacons whose ranges are ``margin`` smaller, as far as they have that."""
        roadmap, key = self._roadmap_within(longest)[0], (self._span(longest), margin)
        if key not in self._graphs:
            nearer = [with_smaller_range(beacon, margin) for beacon in self.beacons]
            self._graphs[key] = self.graph_of(roadmap, nearer)
        return self._graphs[key]

    def graph_of(self, roadmap: Roadmap, beacons: Sequence[Beacon]) -> BeaconGraph:
        """A graph of the robot's estimator."""
        return BeaconGraph.of(roadmap.xy, roadmap.edges, self.noise, beacons, self.world, self.reliance.estimator)

    def walk(
        self,
        graph: BeaconGraph,
        limit: float,
        longest: float,
        *,
        slack: float = FINE,
        max_labels: int = MAX_LABELS,
        dead: Sequence[int] = (),
        by_end: bool = False,
    ) -> Walk:
        """The best walk of a graph, with each of the ``dead`` beacons dead as well."""
        fix, heading = self.reliance.start_fix, self.reliance.start_heading
        problem = LabelProblem(
            graph=graph,
            start=START,
            goal=GOAL,
            states=np.stack([graph.at_start(START, fix, gone) for gone in (ALL_ALIVE, *dead)]),
            dead=tuple(graph.without(site) for site in dead),
            to_goal=self._roadmap_within(longest)[1],
            limit=limit,
            longest=longest,
            max_gap_m=self._max_gap_m(limit),
            arriving=None if heading is None else complex(math.cos(heading), math.sin(heading)),
        )
        slack_sq = slack * min(limit, self.worst(self.shortest)) ** 2
        granted = {"slack_sq": slack_sq, "share": slack}
        found = best_walk(problem, by_end=by_end, **granted, stop=self.late, max_labels=max_labels)
        self.labels, self.latest = self.labels + found.labels, (slack, found.labels)
        if limit <= _NEARLY * self.reliance.max_drift:  # searches with looser limits say nothing about this one
            self.exhausted |= not found.finished
            self.nearest = min(self.nearest, (graph.xy[found.nearest[0]], found.nearest[1]), key=lambda x: x[1])
        return found

    def worst(self, path: Floats) -> float:
        """Greatest rms drift on the way, metres, in the worst case of dead beacons."""
        key = path.tobytes()
        if key not in self._worst:
            self._worst[key] = self.check.verdict(path).worst
        return self._worst[key]

    def best_walk(
        self,
        limit: float,
        longest: float,
        *,
        slack: float,
        max_labels: int,
        by_end: bool = False,
        arrival: float | None = None,
        margin: float | None = None,
        held: float | None = None,
    ) -> Floats | None:
        """The best walk that the exact model agrees with.

        Ranges are taken to be ``margin`` smaller to begin with: by default so much that robots who arrive with a drift
        of ``arrival`` (by default the limit) are captured. The graph is ``held`` to the limit or a looser one to
        begin with.
        """
        held, dead = limit if held is None else held, list[int]()
        margin = self._margin(arrival or limit) if margin is None else margin
        best: tuple[float, Floats] | None = None
        for _ in range(_MAX_ATTEMPTS):
            graph = self.graph(margin, longest)
            found = self.walk(graph, held, longest, slack=slack, max_labels=max_labels, dead=dead, by_end=by_end)
            if found.nodes is None:
                break
            path = _without_repeats(graph.xy[list(found.nodes)])
            verdict = self.check.verdict(path, limit, by_end=by_end)
            keeps = verdict.worst <= limit
            if keeps and (best is None or (by_end and verdict.end < best[0])):
                best = (verdict.end, path)
            if verdict.dead != ALL_ALIVE and verdict.dead not in dead:
                if keeps and not (by_end and verdict.end > found.end_drift * (1 + WORST_TOLERANCE)):
                    break
                dead.append(verdict.dead)  # the next walk has to do without it as well
            elif keeps:
                break
            elif self._lost_to_capture(path, limit):
                margin = max(_MARGIN_GROWTH * margin, self._margin(limit))
            else:
                held = min(_LIMIT_STEP * held, found.worst_drift * (1 - ROUNDING))  # between the two it is found again
            if self.late():
                break
        return None if best is None else best[1]

    def _lost_to_capture(self, path: Floats, limit: float) -> bool:
        """Whether the limit would hold if no beacon were missed for lack of ``min_capture``."""
        if self.check.reliance.min_capture == 0:
            return False
        return self.check.relying(min_capture=0.0).verdict(path, limit).worst <= limit

    def _margin(self, limit: float) -> float:
        """How far inside a range a robot that may drift by ``limit`` should pass, so as to be captured."""
        least = self.check.reliance.min_capture
        if least == 0 or not self.beacons:
            return 0.0
        drift = min(limit, self.worst(self.shortest), 0.5 * self._widest)
        margin = float(max(ndtri(least), 0.0)) * drift / math.sqrt(2)
        step = _MARGIN_STEP * self._widest  # so that similar limits share a graph
        return math.ceil(margin / step) * step

    @property
    def _widest(self) -> float:
        """Greatest range of any beacon, metres; infinite without beacons."""
        return max((beacon.kind.range_m for beacon in self.beacons), default=math.inf)

    def _max_gap_m(self, limit: float) -> float:
        """How far from its last fix a robot can get before it breaks the limit, at most the map's diagonal, metres."""
        xmin, ymin, xmax, ymax = self.space.bounds
        rates = [CostRates.of(kind) for kind in self.noises]
        heading, position = min(r.heading for r in rates), min(r.position for r in rates)
        return max_distance_within(limit**2, heading, position, math.hypot(xmax - xmin, ymax - ymin))

    def _span(self, longest: float) -> float:
        """The greatest length for which the roadmap was made that serves ``longest``."""
        return min((span for span in self._roadmaps if span >= longest), default=longest)

    def _roadmap_within(self, longest: float) -> tuple[Roadmap, Floats]:
        """A roadmap for paths up to a length, and the length from every node to the goal."""
        span = self._span(longest)
        if span not in self._roadmaps:
            roadmap = roadmap_among_beacons(
                self.space,
                self.world,
                self.ends,
                self.noise,
                self.beacons,
                max_nodes=self.max_nodes,
                known=(self.shortest, *self.known),
                longest=longest,
                seed=self.seed,
            )
            self._roadmaps[span] = roadmap, roadmap.distances(roadmap.prices.cost, GOAL)[0]
        return self._roadmaps[span]

    def _grown(self, score: Score) -> Floats:
        """The best path of a roadmap of a few batches for a robot that reads nothing."""
        pricing = AdditiveCost(self.space, self.ends[1], self.noise, score)
        search = RoadmapSearch(pricing, self.ends[0], seed=self.seed, start_heading=self.reliance.start_heading)
        while search.batches < (_BATCHES if search.path is not None else BATCHES_TO_FIND_ONE):
            if search.is_optimal or (search.path is not None and self.late()):
                break
            search.grow(lambda: search.path is not None and self.late())
        if search.path is None:
            raise NoPathError(
                f"no path found from {format_point(self.ends[0])} to {format_point(self.ends[1])} within "
                f"{search.batches} batches of samples: the way may be too narrow for them; a smaller robot_radius "
                "would tell"
            )
        return search.path


def with_smaller_range(beacon: Beacon, margin: float) -> Beacon:
    """The beacon with a smaller range, at least a fifth of what it was."""
    kind = beacon.kind
    return replace(beacon, kind=replace(kind, range_m=max(kind.range_m - margin, 0.2 * kind.range_m)))


def _without_repeats(path: Floats) -> Floats:
    keep = np.concatenate([[True], (np.diff(path, axis=0) != 0).any(axis=1)])
    return path[keep] if keep.sum() > 1 else path[[0, -1]]
