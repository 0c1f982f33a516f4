"""ItinerarySearch: one pair of ends, one set of beacons, any number of questions about the best path between them.

The shared roadmap (`driftplan.planning.itinerary.nodes`) is turned into a graph whose edges carry what driving and
reading do to the drift (`driftplan.planning.itinerary.beacon_roadmap`); label searches
(`driftplan.planning.itinerary.labels`) look for the best walk, whose path is then put to the exact model
(`driftplan.planning.itinerary.check`). Where that disagrees with the graph, the search is asked again, for a little
more.

All work is counted in labels and trials, not in seconds: the same seed gives the same path unless `stop` interfered.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.errors import NoPathError
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.planning.bounds import least_worst_drift, max_distance_within
from driftplan.planning.cost import CostRates
from driftplan.planning.itinerary.beacon_roadmap import BeaconRoadmap
from driftplan.planning.itinerary.check import ALL_ALIVE, ItineraryCheck
from driftplan.planning.itinerary.labels import LabelTask, Walk, least_drift_walk, shortest_walk
from driftplan.planning.itinerary.nodes import itinerary_roadmap
from driftplan.planning.itinerary.shortening import shortened
from driftplan.planning.roadmap.graph import GOAL, START, Roadmap
from driftplan.planning.roadmap.growth import RoadmapSearch
from driftplan.planning.roadmap.prices import Pricing, Space
from driftplan.planning.roadmap.search import said
from driftplan.world.world import World

WORST_TOLERANCE = 0.02  # of the least worst drift, and of end drifts that dead beacons change
ROUNDING = 1e-9
_COARSE, _MEDIUM, _FINE = (
    0.15,
    0.05,
    0.015,
)  # slack of labels as a share of the limit squared: for a path soon, then for a good one
_LABELS = 100_000  # of one search at most,
_LABELS_OF_BISECTION = 8_000  # of one that need only find any path,
_LABELS_BY_END = 6_000  # and of one for the least drift at the end, which seldom comes to an end of its own
_SHRINK = 0.97  # of the limit that the graph is held to, when the exact model finds it broken
_WIDEN = 1.4  # the margin within ranges, when beacons would be missed
_SPARE = 1.2  # of the limit, for a graph that may be too strict
_MARGIN_STEP = 0.03  # of the widest range
_ATTEMPTS = 12
_BISECTIONS = 8
_STEP_DOWN = 0.93  # of the least limit kept so far, a finer search tries until it finds no way to keep it
_LOOSER = (1.05, 1.5, 3.0, math.inf)  # than the least limit on the way, when the least end drift is sought
_TRIALS = 400  # of shorter paths
_BATCHES, _BATCHES_TO_FIND_ONE = 2, 4  # of the roadmap for the shortest path


class ItinerarySearch:
    """Paths from ``ends[0]`` to ``ends[1]`` that count on beacons.

    Parameters
    ----------
    space : Space
        Where the robot may drive.
    world : World or None
        What blocks sight, and zones; None: nothing does and there are none.
    redundancy, min_capture, initial, start_heading :
        As for `driftplan.planning.itinerary.itinerary.plan_itinerary`.
    nodes : int
        Of the roadmap, about.
    stop : callable
        Asked often; once it says True every question ends with the best answer so far and `timed_out` is set.
    stop_shortening : callable, optional
        The same for shortening what was found; default: ``stop``.
    shortest : (n, 2) array, optional
        The shortest path, where it is known from another search.

    Attributes
    ----------
    shortest : (n, 2) array
        The shortest path found, drift or not.
    labels, most_labels : int
        How many have been kept by all searches, and how many one search may keep.
    timed_out : bool
        Whether ``stop`` cut anything short.
    exhausted : bool
        Whether a search gave up at its greatest number of labels, so that finding nothing proves nothing.
    nearest : (place, metres)
        How near to the goal any label came.
    """

    def __init__(
        self,
        space: Space,
        world: World | None,
        ends: Floats,
        noise: OdometryNoise,
        beacons: tuple[Beacon, ...],
        *,
        redundancy: int = 1,
        min_capture: float = 0.9,
        initial: Fix | None = None,
        start_heading: float | None = None,
        nodes: int = 1000,
        seed: int = 0,
        stop: Callable[[], bool] = lambda: False,
        stop_shortening: Callable[[], bool] | None = None,
        shortest: Floats | None = None,
    ) -> None:
        self.space, self.world, self.ends, self.noise, self.beacons = space, world, ends, noise, beacons
        self.nodes, self.seed = nodes, seed
        self.stop, self.stop_shortening = stop, stop_shortening or stop
        self.check = ItineraryCheck(world, noise, beacons, initial, start_heading, redundancy, min_capture)
        self.labels, self.most_labels = 0, _LABELS
        self.timed_out = self.exhausted = False
        self.shortest = self._shortest() if shortest is None else shortest
        self.nearest: tuple[Floats, float] = (ends[0], length_of(self.shortest))
        self._roadmap: tuple[float, Roadmap] | None = None
        self._graphs: dict[float, BeaconRoadmap] = {}

    @property
    def kinds(self) -> tuple[OdometryNoise, ...]:
        """The noise, and that of every zone."""
        return (self.noise, *(zone.noise for zone in (() if self.world is None else self.world.zones)))

    @property
    def roadmap(self) -> Roadmap | None:
        """The latest roadmap; None while the shortest path answered everything."""
        return None if self._roadmap is None else self._roadmap[1]

    def late(self) -> bool:
        """Whether it is time to stop."""
        self.timed_out = self.timed_out or self.stop()
        return self.timed_out

    # Questions; a path or None

    def shortest_within(self, limit: float, longest: float) -> Floats | None:
        """The shortest path on which the drift never exceeds ``limit``."""
        if self._is_good(self.shortest, limit, longest):
            return self.shortest
        found = self._search(limit, longest, slack=_COARSE, most_labels=self.most_labels)
        within, arrival = longest, limit
        if found is not None:  # beacons need not be passed closer by than the drift of such a path asks for
            within, arrival = min(longest, length_of(found)), self.check.verdict(found).worst
        finer = self._search(limit, within, slack=_FINE, most_labels=self.most_labels, arrival=arrival)
        found = found if finer is None else finer
        if found is None:  # ranges with a margin make the graph's drift a little greater than the exact one
            found = self._search(limit, longest, slack=_FINE, most_labels=self.most_labels, held=_SPARE * limit)
        return None if found is None else self.shorter(found, limit)

    def any_within(self, limit: float, longest: float, slack: float) -> Floats | None:
        """A path on which the drift never exceeds ``limit``: the first found."""
        if self._is_good(self.shortest, limit, longest):
            return self.shortest
        most = min(self.most_labels, _LABELS_OF_BISECTION)
        return self._search(limit, longest, slack=slack, most_labels=most)

    def _is_good(self, path: Floats, limit: float, longest: float) -> bool:
        return length_of(path) <= longest and self.check.verdict(path, limit).worst <= limit

    def least_end_drift(self, limit: float, longest: float) -> Floats | None:
        """The path with the least rms at its end that keeps the limit on the way.

        Whatever arrives with little drift has mostly had little on the way, and tight limits make searches short: so
        the search is asked with ever looser limits, from the least that can be kept on.
        """
        tightest = self.least_worst_drift(limit, longest, shorten=False)
        if tightest is None:
            return None
        least = self.check.verdict(tightest).worst
        candidates = [tightest]
        if self._is_good(self.shortest, limit, longest):
            candidates.append(self.shortest)
        for looseness in _LOOSER:
            if self.late():
                break
            most = min(self.most_labels, _LABELS_BY_END)
            found = self._search(min(limit, looseness * least), longest, slack=_FINE, most_labels=most, by_end=True)
            candidates += [] if found is None else [found]
            if looseness * least >= limit:
                break
        path = min(candidates, key=self._end_drift)
        return self.shorter(path, limit, self._end_drift(path))

    def least_worst_drift(self, limit: float, longest: float, *, shorten: bool = True) -> Floats | None:
        """The path with the least greatest drift on the way, by bisection over the limit; the shortest of those."""
        best = self.any_within(limit, longest, _COARSE)
        best = self.any_within(limit, longest, _FINE) if best is None else best
        if best is None:
            return None
        high = self.check.verdict(best).worst
        least = least_worst_drift(self.ends, self.kinds, self.beacons, high)
        for slack, step, tolerance in ((_COARSE, 0.5, 0.05), (_MEDIUM, _STEP_DOWN, WORST_TOLERANCE)):
            low, missed = least, False
            for _ in range(_BISECTIONS):
                if high - low <= tolerance * high or self.late():
                    break
                middle = max(0.5 * (low + high), step * high) if not missed else 0.5 * (low + high)
                if low < self._widest < middle:  # who drifts farther than that finds no beacon
                    middle = self._widest
                found = self.any_within(middle, longest, slack)
                if found is None:
                    low, missed = middle, True
                else:
                    best, high = found, self.check.verdict(found).worst
        if not shorten:
            return best
        kept = high * (1 + ROUNDING)
        shortest = self.shortest_within(kept, min(longest, length_of(best)))
        return self.shorter(best, kept) if shortest is None else shortest

    def shorter(self, path: Floats, limit: float, most_at_end: float = math.inf) -> Floats:
        """The path as short as it gets while it keeps the limit and arrives with no more drift."""
        margin = 0.5 * self._margin(limit)
        nearer = tuple(_nearer(beacon, margin) for beacon in self.beacons)
        cautious = replace(self.check, beacons=nearer, min_capture=0.0)  # passes well within range are captured
        for check in (cautious, self.check):
            trial = self._shorter_while(check, path, limit, most_at_end)
            path = trial if trial is path or self.check.verdict(trial, limit).worst <= limit else path
        return path

    def _shorter_while(self, check: ItineraryCheck, path: Floats, limit: float, most_at_end: float) -> Floats:
        """The path, as short as it gets while one check agrees."""
        trials = 0

        def holds(trial: Floats) -> bool:
            nonlocal trials
            trials += 1
            verdict = check.verdict(trial, limit)
            return verdict.worst <= limit and verdict.end <= most_at_end * (1 + ROUNDING)

        def stop() -> bool:
            self.timed_out = self.timed_out or self.stop_shortening()
            return trials > _TRIALS or self.stop_shortening()

        return path if stop() or not holds(path) else shortened(path, self.space, holds, stop)

    # The search

    def graph(self, margin: float, longest: float = math.inf) -> BeaconRoadmap:
        """The roadmap with the readings of beacons whose ranges are ``margin`` smaller, as far as they have that."""
        if self._roadmap is None or self._roadmap[0] < longest:
            roadmap = itinerary_roadmap(
                self.space,
                self.world,
                self.ends,
                self.noise,
                self.beacons,
                nodes=self.nodes,
                known=self.shortest,
                longest=longest,
                seed=self.seed,
            )
            self._roadmap, self._graphs = (longest, roadmap), {}
        roadmap = self._roadmap[1]
        if margin not in self._graphs:
            nearer = [_nearer(beacon, margin) for beacon in self.beacons]
            self._graphs[margin] = BeaconRoadmap.of(roadmap.xy, roadmap.edges, self.noise, nearer, self.world)
        return self._graphs[margin]

    def walk(
        self,
        graph: BeaconRoadmap,
        limit: float,
        longest: float,
        *,
        slack: float = _FINE,
        most_labels: int = _LABELS,
        dead: Sequence[int] = (),
        by_end: bool = False,
    ) -> Walk:
        """The best walk of a graph, with each of the ``dead`` beacons dead as well."""
        assert self._roadmap is not None
        initial, heading = self.check.initial, self.check.start_heading
        to_goal, _ = self._roadmap[1].distances(self._roadmap[1].prices.cost, GOAL)
        scale = limit if math.isfinite(limit) else self.check.verdict(self.shortest).worst
        task = LabelTask(
            graph=graph,
            start=START,
            goal=GOAL,
            states=np.stack([graph.at_start(START, initial, gone) for gone in (ALL_ALIVE, *dead)]),
            dead=tuple(graph.without(site) for site in dead),
            to_goal=to_goal,
            limit=limit,
            longest=longest,
            reach=self._reach(limit),
            arriving=None if heading is None else complex(math.cos(heading), math.sin(heading)),
        )
        find = least_drift_walk if by_end else shortest_walk
        found = find(task, slack_sq=slack * scale**2, stop=self.late, most_labels=most_labels)
        self.labels += found.labels
        self.exhausted |= not found.finished
        self.nearest = min(self.nearest, (graph.xy[found.nearest[0]], found.nearest[1]), key=lambda x: x[1])
        return found

    def _search(
        self,
        limit: float,
        longest: float,
        *,
        slack: float,
        most_labels: int,
        by_end: bool = False,
        arrival: float | None = None,
        held: float | None = None,
    ) -> Floats | None:
        """The best walk that the exact model agrees with.

        Robots are taken to arrive at beacons with a drift of ``arrival`` and the graph is held to ``held`` to begin
        with; both are the limit by default.
        """
        held, margin, dead = held or limit, self._margin(arrival or limit), list[int]()
        best: tuple[float, Floats] | None = None
        for _ in range(_ATTEMPTS):
            graph = self.graph(margin, longest)
            found = self.walk(graph, held, longest, slack=slack, most_labels=most_labels, dead=dead, by_end=by_end)
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
                margin *= _WIDEN
            else:
                held *= _SHRINK
            if self.late():
                break
        return None if best is None else best[1]

    def _end_drift(self, path: Floats) -> float:
        return self.check.verdict(path, by_end=True).end

    def _lost_to_capture(self, path: Floats, limit: float) -> bool:
        """Whether the limit would hold if no beacon were missed for lack of `min_capture`."""
        return self.check.min_capture > 0 and replace(self.check, min_capture=0.0).verdict(path, limit).worst <= limit

    def _margin(self, limit: float) -> float:
        """How far inside a range a robot that may drift by ``limit`` should pass, so as to be captured."""
        if self.check.min_capture == 0 or not self.beacons:
            return 0.0
        from scipy.special import ndtri

        drift = min(limit, self.check.verdict(self.shortest).worst, 0.5 * self._widest)
        margin = float(max(ndtri(self.check.min_capture), 0.0)) * drift / math.sqrt(2)
        step = _MARGIN_STEP * self._widest  # so that similar limits share a graph
        return math.ceil(margin / step) * step

    @property
    def _widest(self) -> float:
        """Greatest range of any beacon, metres; infinite without beacons."""
        return max((beacon.kind.range_m for beacon in self.beacons), default=math.inf)

    def _reach(self, limit: float) -> float:
        """How far from its last fix a robot can get before it breaks the limit, at most the map's diagonal, metres."""
        xmin, ymin, xmax, ymax = self.space.bounds
        rates = [CostRates.of(kind) for kind in self.kinds]
        heading, position = min(r.heading for r in rates), min(r.position for r in rates)
        return max_distance_within(limit**2, heading, position, math.hypot(xmax - xmin, ymax - ymin))

    def _shortest(self) -> Floats:
        pricing = Pricing(self.space, self.ends[1], self.noise, "length")
        search = RoadmapSearch(pricing, self.ends[0], seed=self.seed)
        while search.batches < (_BATCHES if search.path is not None else _BATCHES_TO_FIND_ONE):
            if search.is_optimal or (search.path is not None and self.late()):
                break
            search.grow(lambda: search.path is not None and self.late())
        if search.path is None:
            raise NoPathError(
                f"no path found from {said(self.ends[0])} to {said(self.ends[1])} within {search.batches} batches of "
                "samples: the way may be too narrow for them; a smaller robot_radius would tell"
            )
        return search.path


def length_of(path: Floats) -> float:
    """Metres."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _nearer(beacon: Beacon, margin: float) -> Beacon:
    """The beacon with a smaller range, at least a fifth of what it was."""
    if margin == 0:
        return beacon
    kind = beacon.kind
    return replace(beacon, kind=replace(kind, range_m=max(kind.range_m - margin, 0.2 * kind.range_m)))


def _without_repeats(path: Floats) -> Floats:
    keep = np.concatenate([[True], (np.diff(path, axis=0) != 0).any(axis=1)])
    return path[keep] if keep.sum() > 1 else path[[0, -1]]
