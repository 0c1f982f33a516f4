"""plan_itinerary: routes that use beacons so that the drift never exceeds a limit, or is least.

A shared roadmap (`driftplan.beacons.itinerary_roadmap`) with places within range of every beacon is turned into a graph
whose edges carry what driving and reading do to the drift (`driftplan.beacons.beacon_roadmap`); a label search
(`driftplan.beacons.labels`) finds the shortest walk that keeps the limit. The walk is shortened as long as the limit
holds, and what is returned has been checked by the exact model (`driftplan.beacons.itinerary_check`): everywhere on the
way, with every beacon dead that may be, and without beacons that the robot would probably miss. Where the exact model
disagrees with the graph, the search is asked again, for a little more.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from driftplan.beacons.beacon import Beacon, BeaconColumns
from driftplan.beacons.beacon_roadmap import BeaconRoadmap
from driftplan.beacons.capture import Capture
from driftplan.beacons.itinerary_bounds import least_end_drift, least_length
from driftplan.beacons.itinerary_check import ALL_ALIVE, ItineraryCheck, Verdict
from driftplan.beacons.itinerary_reasons import why_infeasible
from driftplan.beacons.itinerary_roadmap import itinerary_roadmap
from driftplan.beacons.labels import LabelTask, Walk, least_drift_walk, shortest_walk
from driftplan.beacons.shortening import shortened
from driftplan.errors import InfeasibleError
from driftplan.model.fixes import Fix
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Floats
from driftplan.planning.cost import CostRates
from driftplan.planning.roadmap_graph import GOAL, START, Roadmap
from driftplan.planning.roadmap_search import Status, check_connected, checked_ends, plan_on_roadmap
from driftplan.planning.routes import Route
from driftplan.world.world import World

Objective = Literal["length", "drift", "worst_drift"]

DEFAULT_DETOUR = 1.5
_TOLERANCE = 0.015  # of labels, as a share of the limit squared
_SHRINK = 0.97  # of the limit that the graph is held to, when the exact model finds it broken
_ATTEMPTS = 12
_BISECTIONS = 8
_WORST_TOLERANCE = 0.01
_ROUNDING = 1e-9
_LOOSER = (1.05, 1.5, 3.0, math.inf)  # than the least limit on the way, when the least end drift is sought
_SHORTENING_SHARE = 0.3  # of the time limit


@dataclass(frozen=True, eq=False, kw_only=True)
class Itinerary(Route):
    """A route that counts on beacons; `drift` has their readings in it.

    Attributes
    ----------
    minimise : {"length", "drift", "worst_drift"}
    bound : float
        Proven lower bound, over all routes, of what was minimised, metres. It takes no notice of obstacles.
    beacons : tuple of Beacon
        Those it counts on, in the order of their first reading.
    captures : tuple of Capture
        Every pass of a beacon and the probability that it happens.
    max_drift : float or None
        The limit asked for.
    worst_drift : float
        Greatest rms drift anywhere on the way, metres, all beacons alive.
    worst_if_dead : float
        The same, and with any one beacon dead where ``redundancy`` was 2.
    shortest_length : float
        Of the shortest route found, drift or not, metres.
    labels : int
        How many the search kept.
    seconds : float
    """

    minimise: Objective  # type: ignore[assignment]  # more than a Route can minimise
    beacons: tuple[Beacon, ...]
    captures: tuple[Capture, ...]
    max_drift: float | None
    worst_drift: float
    worst_if_dead: float
    shortest_length: float
    labels: int
    seconds: float


def plan_itinerary(
    world: World,
    start: ArrayLike,
    goal: ArrayLike,
    noise: OdometryNoise,
    *,
    beacons: Sequence[Beacon],
    max_drift: float | None = None,
    minimise: Objective = "length",
    max_detour: float | None = None,
    redundancy: int = 1,
    min_capture: float = 0.9,
    initial: Fix | None = None,
    start_heading: float | None = None,
    nodes: int = 1000,
    time_limit: float = 5.0,
    seed: int = 0,
) -> Itinerary:
    """A route on which beacons keep the drift in check.

    Parameters
    ----------
    world : World
        Its walls block sight, its zones override ``noise``.
    start, goal : (2,)
        Metres, world frame.
    noise : OdometryNoise
        Of the continuous kind (no ``step_m``).
    beacons : sequence of Beacon
        May be empty: then the limit must hold without any.
    max_drift : float, optional
        Greatest rms drift, in metres, anywhere on the way.
    minimise : {"length", "drift", "worst_drift"}
        Length, rms drift at the goal, or the greatest rms drift on the way (to within 1 %).
    max_detour : float, optional
        Greatest length as a multiple of the shortest route's, >= 1. Default: none for "length", else 1.5.
    redundancy : int
        2: all of it also holds with any one beacon dead, and what is minimised is the worst of those cases. 1: all are
        alive.
    min_capture : float in [0, 1)
        A beacon that the drifting robot would come within range of less surely than this on one of its passes
        (`driftplan.beacons.capture`) is not counted on.
    initial : Fix, optional
        Uncertainty at the start; default: the start is known.
    start_heading : float, optional
        Heading at the start, rad: then the first turn counts too.
    nodes : int
        Of the roadmap, about.
    time_limit : float
        Seconds.
    seed : int
        Same seed, same route, unless the time limit was reached.

    Returns
    -------
    Itinerary

    Raises
    ------
    InfeasibleError
        If no route of the roadmap keeps the limit (or none was found in time): the message says how near it gets, and
        why.
    StartError, GoalError, NoPathError
        As `driftplan.plan_route`.
    ValueError
        For input that makes no sense.

    Examples
    --------
    >>> from driftplan.beacons.beacon import BeaconKind
    >>> world = World.from_polygons([], bounds=(0, 0, 60, 30), robot_radius=0.5)
    >>> noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    >>> sign = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
    >>> found = plan_itinerary(world, (2, 5), (58, 5), noise, beacons=[Beacon(sign, 30, 11)], max_drift=1.8, nodes=200)
    >>> len(found.beacons), 56 < found.length < 62, found.worst_drift <= 1.8
    (1, True, True)
    """
    began = time.monotonic()
    ends = checked_ends(world, start, goal, noise, "length", time_limit, None, start_heading)
    _check(noise, world, beacons, max_drift, minimise, max_detour, redundancy, min_capture, initial, nodes, seed)
    if (ends[0] == ends[1]).all():
        raise ValueError(f"expected start and goal apart, got {ends[0].tolist()} for both")
    check_connected(world, ends)
    search = ItinerarySearch(
        world,
        ends,
        noise,
        tuple(beacons),
        redundancy=redundancy,
        min_capture=min_capture,
        initial=initial,
        start_heading=start_heading,
        nodes=nodes,
        seed=seed,
        deadline=began + time_limit,
        shortening=_SHORTENING_SHARE * time_limit,
    )
    longest = math.inf
    if max_detour is not None or minimise != "length":
        longest = (max_detour or DEFAULT_DETOUR) * _length(search.shortest) * (1 + _ROUNDING)
    limit = math.inf if max_drift is None else float(max_drift)
    if minimise == "length":
        path = search.shortest_within(limit, longest)
    elif minimise == "drift":
        path = search.least_end_drift(limit, longest)
    else:
        path = search.least_worst_drift(limit, longest)
    if path is None:
        raise InfeasibleError(why_infeasible(search, limit, longest))
    return search.itinerary(path, minimise, max_drift)


class ItinerarySearch:
    """One pair of ends, one set of beacons, one clock; any number of questions."""

    def __init__(
        self,
        world: World,
        ends: Floats,
        noise: OdometryNoise,
        beacons: tuple[Beacon, ...],
        *,
        redundancy: int,
        min_capture: float,
        initial: Fix | None,
        start_heading: float | None,
        nodes: int,
        seed: int,
        deadline: float,
        shortening: float,
    ) -> None:
        self.world, self.ends, self.noise, self.beacons = world, ends, noise, beacons
        self.nodes, self.seed = nodes, seed
        self.began, self.deadline, self.shortening = time.monotonic(), deadline, shortening
        self.check = ItineraryCheck(world, noise, beacons, initial, start_heading, redundancy, min_capture)
        self.shortest = self._shortest()
        self.labels = 0
        self.finished = True
        self.nearest: tuple[Floats, float] = (ends[0], _length(self.shortest))
        self._roadmap: tuple[float, Roadmap] | None = None
        self._graphs: dict[float, BeaconRoadmap] = {}

    def late(self) -> bool:
        return time.monotonic() > self.deadline

    # Questions; a path or None

    def shortest_within(self, limit: float, longest: float, *, shorten: bool = True) -> Floats | None:
        """The shortest path on which the drift never exceeds ``limit``."""
        if _length(self.shortest) <= longest and self.check.verdict(self.shortest, limit).worst <= limit:
            return self.shortest
        found = self._search(limit, longest, by_end=False)
        return self._shortened(found, limit, math.inf) if found is not None and shorten else found

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
        if _length(self.shortest) <= longest and self.check.verdict(self.shortest, limit).worst <= limit:
            candidates.append(self.shortest)
        overall = self.deadline
        for looseness in _LOOSER:
            self.deadline = time.monotonic() + 0.5 * (overall - time.monotonic())
            found = self._search(min(limit, looseness * least), longest, by_end=True)
            candidates += [] if found is None else [found]
            if looseness * least >= limit:
                break
        self.deadline = overall
        path = min(candidates, key=self._end_drift)
        return self._shortened(path, limit, self._end_drift(path))

    def _end_drift(self, path: Floats) -> float:
        return self.check.verdict(path, by_end=True).end

    def least_worst_drift(self, limit: float, longest: float, *, shorten: bool = True) -> Floats | None:
        """The path with the least greatest drift on the way, by bisection over the limit."""
        best = self.shortest_within(limit, longest, shorten=False)
        if best is None:
            return None
        high, low = self.check.verdict(best).worst, 0.0
        for _ in range(_BISECTIONS):
            if high - low <= _WORST_TOLERANCE * high:
                break
            if self.late():
                self.finished = False
                break
            middle = min(0.5 * (low + high), max(self._widest, 1.01 * low))  # who drifts farther than that finds none
            found = self.shortest_within(middle, longest, shorten=False)
            if found is None:
                low = middle
            else:
                best, high = found, self.check.verdict(found).worst
        return self._shortened(best, high * (1 + _ROUNDING), math.inf) if shorten else best

    # The search

    def graph(self, margin: float, longest: float = math.inf) -> BeaconRoadmap:
        """The roadmap with the readings of beacons whose ranges are ``margin`` smaller, as far as they have that."""
        if self._roadmap is None or self._roadmap[0] < longest:
            roadmap = itinerary_roadmap(
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
        found = find(task, slack_sq=_TOLERANCE * scale**2, stop=self.late)
        self.labels += found.labels
        self.finished &= found.finished
        self.nearest = min(self.nearest, (graph.xy[found.nearest[0]], found.nearest[1]), key=lambda x: x[1])
        return found

    def _search(self, limit: float, longest: float, *, by_end: bool) -> Floats | None:
        """The best walk that the exact model agrees with."""
        held, margin, dead = limit, self._margin(limit), list[int]()
        best: tuple[float, Floats] | None = None
        for _ in range(_ATTEMPTS):
            graph = self.graph(margin, longest)
            found = self.walk(graph, held, longest, dead=dead, by_end=by_end)
            if found.nodes is None:
                break
            path = _without_repeats(graph.xy[list(found.nodes)])
            verdict = self.check.verdict(path, limit, by_end=by_end)
            keeps = verdict.worst <= limit
            if keeps and (best is None or (by_end and verdict.end < best[0])):
                best = (verdict.end, path)
            if verdict.dead != ALL_ALIVE and verdict.dead not in dead:
                if keeps and not (by_end and verdict.end > found.end_drift * (1 + _WORST_TOLERANCE)):
                    break
                dead.append(verdict.dead)  # the next walk has to do without it as well
            elif keeps:
                break
            elif self._lost_to_capture(path, limit):
                margin *= 1.4
            else:
                held *= _SHRINK
            if self.late():
                self.finished = False
                break
        return None if best is None else best[1]

    def _lost_to_capture(self, path: Floats, limit: float) -> bool:
        """Whether the limit would hold if no beacon were missed for lack of `min_capture`."""
        return self.check.min_capture > 0 and replace(self.check, min_capture=0.0).verdict(path, limit).worst <= limit

    def _margin(self, limit: float) -> float:
        """How far inside a range a robot that may drift by ``limit`` should pass, so as to be captured."""
        if self.check.min_capture == 0 or not self.beacons:
            return 0.0
        from scipy.special import ndtri

        drift = min(limit, self.check.verdict(self.shortest).worst, 0.5 * self._widest)
        return float(max(ndtri(self.check.min_capture), 0.0)) * drift / math.sqrt(2)

    @property
    def _widest(self) -> float:
        """Greatest range of any beacon, metres; infinite without beacons."""
        return max((beacon.kind.range_m for beacon in self.beacons), default=math.inf)

    def _reach(self, limit: float) -> float:
        """How far a robot without any error can drive before it breaks the limit, at most the map's diagonal."""
        xmin, ymin, xmax, ymax = self.world.bounds
        diagonal = math.hypot(xmax - xmin, ymax - ymin)
        rates = [CostRates.of(k) for k in (self.noise, *(zone.noise for zone in self.world.zones))]
        heading, position = min(r.heading for r in rates), min(r.position for r in rates)
        low, high = 0.0, diagonal
        if heading * high**3 / 3 + position * high <= limit**2:
            return diagonal
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if heading * middle**3 / 3 + position * middle <= limit**2 else (low, middle)
        return high

    def _shortened(self, path: Floats, limit: float, most_at_end: float) -> Floats:
        """The path as short as it gets while it keeps the limit and arrives with no more drift."""
        margin = 0.5 * self._margin(limit)
        nearer = tuple(_nearer(beacon, margin) for beacon in self.beacons)
        cautious = replace(self.check, beacons=nearer, min_capture=0.0)  # passes well within range are captured
        for check in (cautious, self.check):

            def holds(trial: Floats, check: ItineraryCheck = check) -> bool:
                verdict = check.verdict(trial, limit)
                return verdict.worst <= limit and verdict.end <= most_at_end * (1 + _ROUNDING)

            def stop(deadline: float = time.monotonic() + self.shortening / 2) -> bool:
                return time.monotonic() > deadline

            if holds(path):
                shorter = shortened(path, self.world, holds, stop)
                path = shorter if holds(shorter, self.check) else path
        return path

    def _shortest(self) -> Floats:
        left = max(0.3 * (self.deadline - time.monotonic()), 0.05)
        found = plan_on_roadmap(
            self.world,
            self.ends[0],
            self.ends[1],
            self.noise,
            minimise="length",
            time_limit=left,
            batches=2,
            seed=self.seed,
        )
        return found.path

    def itinerary(self, path: Floats, minimise: Objective, max_drift: float | None) -> Itinerary:
        """The answer, from the exact model."""
        drift = self.check.drift(path)
        verdict = self.check.verdict(path)
        if minimise == "length":
            bound = least_length(self.world, self.ends, self.noise, self.beacons, max_drift)
        else:
            bound = least_end_drift(self.world, self.ends, self.noise, self.beacons, verdict.end)
        alive = replace(self.check, redundancy=1).verdict(path)
        status = Status.TIME_LIMIT if not self.finished else Status.BATCHES_DONE
        if minimise == "length" and float(drift.length) <= bound * (1 + _ROUNDING):
            status = Status.OPTIMAL
        return Itinerary(
            path=path,
            drift=drift,
            planner="roadmap",
            minimise=minimise,
            status=status,
            bound=min(bound, _scored(minimise, drift.length, verdict)),
            bound_covers="all routes",
            beacons=tuple(self.beacons[i] for i in self.check.met(path)),
            captures=tuple(self.check.captures(path)),
            max_drift=max_drift,
            worst_drift=alive.worst,
            worst_if_dead=verdict.worst,
            shortest_length=_length(self.shortest),
            labels=self.labels,
            seconds=time.monotonic() - self.began,
        )


def _scored(minimise: Objective, length: Any, verdict: Verdict) -> float:
    return {"length": float(length), "drift": verdict.end, "worst_drift": verdict.worst}[minimise]


def _nearer(beacon: Beacon, margin: float) -> Beacon:
    """The beacon with a smaller range, at least a fifth of what it was."""
    if margin == 0:
        return beacon
    kind = beacon.kind
    return replace(beacon, kind=replace(kind, range_m=max(kind.range_m - margin, 0.2 * kind.range_m)))


def _length(path: Floats) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _without_repeats(path: Floats) -> Floats:
    keep = np.concatenate([[True], (np.diff(path, axis=0) != 0).any(axis=1)])
    return path[keep] if keep.sum() > 1 else path[[0, -1]]


def _check(
    noise: OdometryNoise,
    world: World,
    beacons: Sequence[Beacon],
    max_drift: float | None,
    minimise: str,
    max_detour: float | None,
    redundancy: int,
    min_capture: float,
    initial: Fix | None,
    nodes: int,
    seed: int,
) -> None:
    if minimise not in get_args(Objective):
        raise ValueError(f"expected minimise one of {get_args(Objective)}, got {minimise!r}")
    if any(kind.step_m is not None for kind in (noise, *(zone.noise for zone in world.zones))):
        raise ValueError(
            "expected noise of the continuous kind, got noise per step (step_m), which depends on how a path is cut"
        )
    BeaconColumns.of(beacons)
    if max_drift is not None and not (math.isfinite(max_drift) and max_drift > 0):
        raise ValueError(f"expected max_drift finite and > 0 m, got {max_drift!r}")
    if max_detour is not None and not (math.isfinite(max_detour) and max_detour >= 1):
        raise ValueError(f"expected max_detour >= 1, got {max_detour!r}")
    if redundancy not in (1, 2):
        raise ValueError(f"expected redundancy 1 (all beacons live) or 2 (any one may be dead), got {redundancy!r}")
    if not 0 <= min_capture < 1:
        raise ValueError(f"expected min_capture in [0, 1), got {min_capture!r}")
    if initial is not None and not (isinstance(initial, Fix) and initial.s_m == 0):
        raise ValueError(f"expected initial a Fix at s_m=0, got {initial!r}")
    for name, value, least in (("nodes", nodes, 10), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise ValueError(f"expected {name} a whole number >= {least}, got {value!r}")
