"""co_design: beacons and routes chosen together, so that what both cost is least.

Given the routes, `driftplan.layouts.placement.place` finds the cheapest beacons; given the beacons,
`driftplan.planning.itinerary.search` finds the shortest routes that keep the limit. Alternating the two never makes
anything dearer, but from the shortest routes it does not move at all: no route gets shorter, and with these routes no
layout gets cheaper. So the search restarts from neighbours of the best design, and goes on alternating from there:

* some beacons are missing: one of them, two that one trip meets, or all those that one trip meets or that it alone
  needs; trips that relied on them look for routes among the rest, at most so much longer as that may pay;
* a trip takes its shortest route again;
* a trip rides on another's route: it looks for a route among all sites that the other one passes.

It ends where no neighbour leads to anything cheaper, at a local optimum. The first design, shortest routes and then
beacons, is what it is compared with.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, positive, whole
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.errors import InfeasibleError
from driftplan.layouts.co_design.design import CoDesign, Design, DesignStatus
from driftplan.layouts.co_design.problem import DesignProblem, sites_of
from driftplan.layouts.co_design.trips import Trip, trips_of
from driftplan.layouts.layout import Layout
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.planning.itinerary.itinerary import DEFAULT_DETOUR, answer, check_options
from driftplan.planning.itinerary.search import ROUNDING, length_of
from driftplan.world.world import World

_WORTH = 1e-6  # least relative gain that counts
_HOPE = 2.0  # detours may cost so many times what the missing beacons cost: placing again may save more of them
_PLACE_SHARE = 0.25  # of the time limit, for one placement at most


def co_design(
    world: World,
    trips: Sequence[Trip | tuple[ArrayLike, ArrayLike] | tuple[ArrayLike, ArrayLike, float]],
    noise: OdometryNoise,
    max_drift: float,
    *,
    kind: BeaconKind | Sequence[BeaconKind],
    price_per_m: float,
    candidates: ArrayLike | None = None,
    spacing_m: float | None = None,
    existing: Sequence[Beacon] = (),
    forbidden: Sequence[Any] = (),
    redundancy: int = 1,
    max_detour: float = DEFAULT_DETOUR,
    start_fix: Fix | None = None,
    nodes: int = 500,
    rounds: int = 10,
    time_limit: float = 120.0,
    seed: int = 0,
    progress: Callable[[float, float], None] | None = None,
) -> CoDesign:
    """The beacons and, for every trip, the route that keeps the drift under a limit, at the least cost of both.

    Minimised is the cost of new beacons (`BeaconKind.cost` each) plus ``price_per_m`` times the metres driven, every
    trip as often as its weight says. Alternates placing given routes and routing given beacons, with restarts from
    designs that lack some beacons, until none of them leads to anything cheaper. Never dearer than 'shortest routes,
    then place' (`CoDesign.baseline`). A local optimum, not a proven one.

    Readings count wherever a route is within range, as in `place_beacons`; with what probability a robot that has
    drifted comes within range is in ``routes[k].captures``.

    Parameters
    ----------
    world : World
        Its walls block sight, its zones override ``noise``.
    trips : sequence of Trip, or of (start, goal) or (start, goal, weight)
    noise : OdometryNoise
        Of the continuous kind (no ``step_m``).
    max_drift : float
        Greatest rms drift, in metres, anywhere on any route.
    kind : BeaconKind or several
        What may be placed; its ``cost`` is the price of one.
    price_per_m : float
        Of driving one metre once, in the unit of the beacons' cost, > 0.
    candidates : (n, 2) points, metres
        Default: a grid over the free space, ``spacing_m`` apart (default: the smallest range).
    existing : sequence of Beacon
        Already there, for nothing.
    forbidden : sequence of polygons (shapely, or corners)
        No beacons inside.
    redundancy : int
        2: the limit holds with any one beacon dead. 1: all are alive.
    max_detour : float
        No route is longer than this multiple of the shortest, >= 1.
    start_fix : Fix at 0
        Uncertainty at the start of every trip; default: the start is known.
    nodes : int
        Of every roadmap, about.
    rounds : int
        Passes over all neighbours, at most; 0: only the baseline, with its routes as short as its beacons allow.
    time_limit : float
        Seconds; it only stops the search, and ``status`` then says so. The baseline is found in any case.
    seed : int
        Same seed, same design, unless the time limit was reached.
    progress : callable
        Called with seconds and cost when a cheaper design is found.

    Returns
    -------
    CoDesign

    Raises
    ------
    InfeasibleError
        If a trip cannot be driven within the limit, wherever the beacons are: the message names it, and says why.
    StartError, GoalError, NoPathError
        As `driftplan.plan_route`, naming the trip.
    ValueError
        For input that makes no sense.

    Examples
    --------
    Two trips along parallel aisles share one aisle, and its beacon, when driving is cheap:

    >>> shelf = [(8, 4), (32, 4), (32, 8), (8, 8)]
    >>> world = World.from_polygons([shelf], bounds=(0, 0, 40, 12), robot_radius=0.5)
    >>> noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    >>> sign = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01, cost=100.0)
    >>> trips = [((2, 2), (38, 2)), ((2, 10), (38, 10))]
    >>> found = co_design(world, trips, noise, 1.2, kind=sign, price_per_m=1.0, spacing_m=4.0, nodes=120)
    >>> len(found.baseline.beacons), len(found.beacons), found.gain > 50
    (2, 1, True)
    """
    began = time.monotonic()
    if not isinstance(world, World):
        raise ValueError(f"expected a World, got {world!r}")
    problem = DesignProblem(
        world=world,
        trips=trips_of(trips),
        noise=noise,
        limit=positive("max_drift", max_drift),
        price_per_m=positive("price_per_m", price_per_m),
        existing=tuple(existing),
        redundancy=redundancy,
        start_fix=start_fix,
        nodes=nodes,
        seed=seed,
        deadline=began + positive("time_limit", time_limit),
        place_s=max(_PLACE_SHARE * time_limit, 1.0),
    )
    check_options(
        minimise="length",
        beacons=existing,
        max_drift=max_drift,
        max_detour=max_detour,
        redundancy=redundancy,
        initial=start_fix,
        nodes=nodes,
        seed=seed,
        noises=(noise, *(zone.noise for zone in world.zones)),
    )
    whole("rounds", rounds, least=0)
    problem.sites = sites_of(world, kind, candidates, spacing_m, forbidden, {b.id for b in existing})
    problem.shortest = [problem.shortest_path(k) for k in range(len(problem.trips))]
    problem.longest = [max_detour * length_of(path) * (1 + ROUNDING) for path in problem.shortest]
    search = _Search(problem, began, progress)
    status, done = search.run(rounds)
    return search.result(status, done, time.monotonic() - began)


class _State(NamedTuple):
    """Routes and the beacons that hold the limit on them."""

    paths: tuple[Floats, ...]
    layout: Layout
    cost: float


class _Search:
    """Alternation with restarts; the best design so far."""

    def __init__(self, problem: DesignProblem, began: float, progress: Callable[[float, float], None] | None) -> None:
        self.problem, self.began, self.progress = problem, began, progress
        self.baseline: Design | None = None
        self.best: _State | None = None
        self.history: list[float] = []
        self.tried = 0
        self._begun: set[bytes] = set()  # routes that have been started from

    def run(self, rounds: int) -> tuple[DesignStatus, int]:
        self._start()
        done = 0
        while done < rounds:
            done += 1
            gained = self._pass()
            if self.problem.cut_short:
                return DesignStatus.TIME_LIMIT, done
            if not gained:
                return DesignStatus.LOCAL_OPTIMUM, done
        return DesignStatus.TIME_LIMIT if self.problem.cut_short else DesignStatus.ROUNDS_DONE, done

    def result(self, status: DesignStatus, rounds: int, seconds: float) -> CoDesign:
        problem, best = self.problem, self.best
        assert best is not None
        everyone = (*problem.existing, *best.layout.beacons)
        routes = [
            answer(problem.search(k, everyone), path, "length", problem.limit, 0.0) for k, path in enumerate(best.paths)
        ]
        return CoDesign(
            layout=best.layout,
            paths=best.paths,
            beacon_cost=best.layout.cost,
            driving_cost=problem.driving(best.paths),
            trips=problem.trips,
            routes=tuple(routes),
            baseline=self.baseline,
            status=status,
            rounds=rounds,
            tried=self.tried,
            history=tuple(self.history),
            seconds=seconds,
        )

    def _start(self) -> None:
        """Shortest routes, then beacons; where none hold the limit on those, routes among beacons at all sites."""
        problem = self.problem
        shortest = tuple(problem.shortest)
        try:
            layout = problem.place(shortest)
        except InfeasibleError as err:
            on_shortest = str(err)
        else:
            driving = problem.driving(shortest)
            self.baseline = Design(layout=layout, paths=shortest, beacon_cost=layout.cost, driving_cost=driving)
            self._offer(_State(shortest, layout, layout.cost + driving))
            return
        everywhere = (*problem.existing, *problem.sites)
        paths = []
        for k in range(len(shortest)):
            path = problem.route(k, everywhere, math.inf)
            if path is None and problem.cut_short:
                raise InfeasibleError(
                    f"no layout keeps the limit on the shortest routes ({on_shortest}), and no other routes were found "
                    "in time: raise time_limit, or begin with a higher max_drift"
                )
            if path is None:
                raise InfeasibleError(
                    f"{problem.name(k)}: no route no longer than {problem.longest[k]:.4g} m keeps the drift under "
                    f"{problem.limit:g} m, even with beacons at all {len(problem.sites)} candidates; on the shortest "
                    f"routes: {on_shortest}"
                )
            paths.append(path)
        self._alternate(tuple(paths))
        if self.best is None:
            raise InfeasibleError(f"no layout keeps the limit on the routes found; on the shortest: {on_shortest}")

    def _pass(self) -> bool:
        """Restart from every neighbour of the best design; whether one led to a cheaper design."""
        state = self.best
        assert state is not None
        for paths in self._neighbours(state):
            if self.problem.late():
                break
            self.tried += 1
            if paths is not None and (key := b"".join(path.tobytes() for path in paths)) not in self._begun:
                self._begun.add(key)
                self._alternate(paths)
        assert self.best is not None
        return self.best.cost < state.cost * (1 - _WORTH)

    def _neighbours(self, state: _State) -> Iterator[tuple[Floats, ...] | None]:
        """Routes to start from; None where a trip has none that could pay."""
        for missing in self._dispensable(state):
            yield self._without(state, missing)
        problem = self.problem
        for k, shortest in enumerate(problem.shortest):
            bases = [state.paths]
            if length_of(state.paths[k]) > length_of(shortest) * (1 + _WORTH):
                bases.append((*state.paths[:k], shortest, *state.paths[k + 1 :]))
                yield bases[-1]
            for base in bases:
                for rider in range(len(base)):
                    if rider != k:
                        yield self._riding(state, base, rider, k)

    def _dispensable(self, state: _State) -> list[frozenset[Beacon]]:
        """Beacons that might be done without, the sets that save most first; of equals in the seed's order."""
        task, beacons = state.layout.task, state.layout.beacons
        users = {b: {r for r in range(len(task.routes)) if b in task.met([b], r)} for b in beacons}
        sets = {frozenset([b]) for b in beacons}
        for trip in range(len(task.routes)):
            on_it = [b for b in beacons if trip in users[b]]
            sets |= {frozenset(on_it), frozenset(b for b in on_it if users[b] == {trip})}
            sets |= {frozenset(pair) for pair in combinations(on_it, 2)}
        order = {b: k for k, b in enumerate(beacons)}
        listed = sorted((s for s in sets if s), key=lambda s: sorted(order[b] for b in s))
        rng = np.random.default_rng(self.problem.seed)
        shuffled = [listed[k] for k in rng.permutation(len(listed)).tolist()]
        return sorted(shuffled, key=lambda s: -sum(b.kind.cost for b in s))

    def _without(self, state: _State, missing: frozenset[Beacon]) -> tuple[Floats, ...] | None:
        """Routes without the missing beacons."""
        problem = self.problem
        left = [b for b in (*problem.existing, *state.layout.beacons) if b not in missing]
        hope = _HOPE * sum(b.kind.cost for b in missing)
        paths = list(state.paths)
        for k, path in enumerate(paths):
            search = problem.search(k, left)
            if search.check.verdict(path, problem.limit).worst <= problem.limit:
                continue
            most = length_of(path) + hope / problem.price(k)
            found = search.shortest_within(problem.limit, min(most, problem.longest[k]))
            if found is None:
                return None
            hope -= problem.price(k) * max(length_of(found) - length_of(path), 0.0)
            paths[k] = found
        return tuple(paths)

    def _riding(self, state: _State, paths: Sequence[Floats], rider: int, host: int) -> tuple[Floats, ...] | None:
        """Routes in which one trip uses what is, or could be, on the route of another."""
        problem = self.problem
        saved = sum(b.kind.cost for b in state.layout.task.met(state.layout.beacons, rider))
        if saved == 0:
            return None
        offered = problem.met([paths[host]])
        most = length_of(paths[rider]) + _HOPE * saved / problem.price(rider)
        found = problem.route(rider, (*problem.existing, *offered), most)
        if found is None or np.array_equal(found, paths[rider]):
            return None
        return (*paths[:rider], found, *paths[rider + 1 :])

    def _alternate(self, paths: tuple[Floats, ...]) -> None:
        """Place, route, place, … from these routes on, as long as it gets cheaper."""
        problem = self.problem
        cost = math.inf
        while not problem.late() or self.best is None:
            try:
                layout = problem.place(paths)
            except InfeasibleError:  # beacons that routes read before may be no candidates now
                return
            state = _State(paths, layout, problem.cost(paths, layout))
            self._offer(state)
            if state.cost >= cost * (1 - _WORTH):
                return
            cost = state.cost
            everyone = (*problem.existing, *layout.beacons)
            shorter = []
            for k, path in enumerate(paths):
                found = None
                if length_of(path) > length_of(problem.shortest[k]) * (1 + _WORTH):
                    found = problem.route(k, everyone, length_of(path))
                shorter.append(path if found is None or length_of(found) >= length_of(path) else found)
            if all(new is old for new, old in zip(shorter, paths, strict=True)):
                return
            paths = tuple(shorter)

    def _offer(self, state: _State) -> None:
        if self.best is not None and state.cost >= self.best.cost * (1 - _WORTH):
            return
        self.best = state
        self.history.append(state.cost)
        if self.progress is not None:
            self.progress(time.monotonic() - self.began, state.cost)
