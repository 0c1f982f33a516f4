"""A cell's work: from a task and what it shares with others to a row, in this process or in one that does only that.
Every worker keeps the routes it has planned."""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Mapping
from itertools import pairwise
from mmap import ACCESS_READ, mmap
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any

import numpy as np
import shapely

from driftplan.arrays import Floats
from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import beacon_fixes, floor_of
from driftplan.errors import DriftplanError, InfeasibleError
from driftplan.layouts.place import place_at
from driftplan.layouts.placement.problem import Stations
from driftplan.layouts.scenario import Scenario, Sites, route_sites, wall_sites
from driftplan.layouts.study.inputs import CellTask, SitesAsked, Trips, start_fix
from driftplan.model.noise import OdometryNoise
from driftplan.model.simulation import simulate_drift
from driftplan.planning.graph_routes import graph_routes
from driftplan.planning.many_routes import plan_routes
from driftplan.planning.request import DriftLimit
from driftplan.planning.status import Status
from driftplan.world.world import World

Row = dict[str, Any]
Routes = tuple[Floats, ...]
DONE, INFEASIBLE, OUT_OF_TIME, FAILED = "done", "infeasible", "out of time", "failed"
_MOST_ROUTES, _MOST_STATIONS = 64, 8  # sets of routes that a worker keeps; of stations on these


class Workshop:
    """What a worker has: the shared inputs, and the routes that it has planned among them, for any of its threads."""

    def __init__(self, shared: Mapping[str, Any]) -> None:
        self.shared, self._planning = shared, Lock()
        self._routes: dict[tuple[Any, ...], Routes] = {}
        self._kept: dict[tuple[Any, ...], Stations] = {}

    def row(self, task: CellTask) -> Row:
        """What came out for a cell: whatever goes wrong in it is said in its row."""
        began, cpu = time.monotonic(), time.process_time()
        try:
            found = self._answer(task)
        except InfeasibleError as err:
            late = time.monotonic() - began > 0.7 * task.plain["time_limit_s"]  # nor proven that there is none
            found = {"outcome": OUT_OF_TIME if late else INFEASIBLE, "why": str(err)}
        except Exception as err:
            kind = "" if isinstance(err, (DriftplanError, ValueError)) else f"{type(err).__name__}: "
            found = {"outcome": FAILED, "why": f"{kind}{err}"}
        spent = {"seconds": time.monotonic() - began, "processor_s": time.process_time() - cpu}
        return {"key": task.key, **found, "spent": {name: round(s, 3) for name, s in spent.items()}}

    def _answer(self, task: CellTask) -> Row:
        asked, plain = self.shared[task.sites], task.plain
        routes, world, noise = self.routes(task), self.shared[task.world], self.shared[task.noise]
        limit = DriftLimit(plain["limit_m"], plain["redundancy"], plain["confidence"])
        scenario = Scenario.of(world, routes, noise, limit, start_fix(plain["start"]), plain["estimator"])
        began, beacons, found = time.monotonic(), asked.existing, {}
        if asked.kinds or asked.points is not None:
            layout = place_at(
                self._stations(task, scenario), scenario, limit, began=began,
                max_beacons=plain["max_beacons"], budget=plain["budget"], time_limit=plain["time_limit_s"],
            )  # fmt: skip
            beacons, worst, kinds = layout.everyone, layout.worst_drifts, asked.all_kinds
            found = {
                "beacons": len(layout.beacons),
                **{name: getattr(layout, name) for name in ("cost", "lower_bound", "proven")},
                "ended_by_time": layout.status is Status.TIME_LIMIT,
                "drift_bound_m": layout.drift_bound,
                "layout": [[b.id, kinds.index(b.kind), b.x, b.y, b.facing_deg] for b in layout.beacons],
            }
        else:
            worst = tuple(scenario.worst(scenario.drift(r, beacons)) for r in range(len(routes)))
        if plain["simulated_drives"]:
            found |= _simulated(scenario, beacons, plain["simulated_drives"], plain["seed"])
        length = sum(float(np.hypot(*np.diff(route, axis=0).T).sum()) for route in routes)
        drift = {"worst_drift_m": max(worst), "worst_route": int(np.argmax(worst))}
        return {"outcome": DONE, **drift, "routes": len(routes), "route_m": length, **found}

    def _stations(self, task: CellTask, scenario: Scenario) -> Stations:
        """The sites of a cell on its routes, the same for all cells that have both."""
        key = *routes_key(self.shared, task), task.sites
        with self._planning:
            if key not in self._kept:
                sites = sites_for(self.shared[task.sites], scenario.world, scenario.routes)
                _keep(self._kept, _MOST_STATIONS, key, Stations(scenario, sites))
            return self._kept[key]

    def routes(self, task: CellTask) -> Routes:
        """The routes of a cell, planned once for all cells that drive the same ones."""
        trips: Trips = self.shared[task.trips]
        if trips.routes:
            return trips.routes
        plain, key = task.plain, routes_key(self.shared, task)
        with self._planning:
            if key not in self._routes:
                planned = _planned(self.shared[task.world], trips, self.shared[task.noise], plain)
                _keep(self._routes, _MOST_ROUTES, key, planned)
            return self._routes[key]


def _keep(kept: dict[Any, Any], most: int, key: Any, value: Any) -> None:
    """One more, in the place of the oldest where there are so many."""
    if len(kept) >= most:
        kept.pop(next(iter(kept)))
    kept[key] = value


def routes_key(shared: Mapping[str, Any], task: CellTask) -> tuple[Any, ...]:
    """The same for cells on the same routes."""
    trips, plain = shared[task.trips], task.plain
    decides = task.noise if trips.graph is not None or plain["minimise"] != "length" else ""
    return task.world, task.trips, plain["minimise"], decides, plain["seed"] if trips.random else 0


def sites_for(asked: SitesAsked, world: World | None, routes: Routes) -> Sites:
    """Where beacons may go for these routes."""
    common: dict[str, Any] = {name: getattr(asked, name) for name in ("existing", "min_spacing_m", "forbidden")}
    points = asked.points
    if points is None and (asked.along == "grid" or (asked.along == "routes" and world is None)):
        return Sites(asked.kinds, spacing_m=asked.spacing_m, **common)
    if points is None:
        spacing = asked.spacing_m or min(kind.range_m for kind in asked.kinds)
        if asked.along == "walls" and world is None:
            raise ValueError("expected a map for sites along walls, got none")
        points = wall_sites(world, spacing) if world and asked.along == "walls" else route_sites(routes, spacing)
    return Sites(asked.kinds, points, **common)


def _planned(world: World | None, trips: Trips, noise: OdometryNoise, plain: dict[str, Any]) -> Routes:
    if trips.graph is not None:
        chosen = 1 if plain["minimise"] == "length" else 0
        ways = [graph_routes(trips.graph, a, b, noise, world=world)[chosen] for a, b in trips.ends]
        return tuple(way.drift.xy for way in ways)
    if world is None:
        raise ValueError("expected a map to plan routes on, got none")
    ends, each = list(trips.ends), 1
    if trips.random:
        each = trips.stops - 1
        rng = np.random.default_rng(plain["seed"])
        for _ in range(trips.random):
            ends += pairwise(_places(world, trips.stops, rng))
    legs = [route.path[:, :2] for route in plan_routes(world, ends, noise, minimise=plain["minimise"], workers=1)]
    groups = [legs[k : k + each] for k in range(0, len(legs), each)]
    return tuple(np.concatenate([group[0], *(leg[1:] for leg in group[1:])]) for group in groups)


def _places(world: World, count: int, rng: np.random.Generator) -> list[Floats]:
    """Places by chance, anywhere in the largest part of the free space."""
    if not world.free_parts:
        raise ValueError(f"no place of this map is free for a robot of radius {world.robot_radius:g} m")
    hall, places = world.free_parts[0], list[Floats]()
    while len(places) < count:
        point = rng.uniform(hall.bounds[:2], hall.bounds[2:])
        if shapely.contains_xy(hall, *point) and world.is_free(point):
            places.append(point)
    return places


def _simulated(scenario: Scenario, beacons: tuple[Beacon, ...], drives: int, seed: int) -> Row:
    """Predicted and observed rms at the end of the route where they differ most, and by how many standard errors the
    mean squares differ, of the worst route and of all together."""
    zs, rms = [], []
    fixes = [scenario.start_fix] if scenario.start_fix else []
    for r, route in enumerate(scenario.routes):
        path, noise = floor_of(route, scenario.noise, scenario.world)
        all_fixes = [*fixes, *beacon_fixes(route, beacons, scenario.world)]
        rng = np.random.default_rng([seed, r])
        errors = simulate_drift(path, noise, runs=drives, rng=rng, fixes=all_fixes, estimator=scenario.estimator)
        square = (errors[:, -1] ** 2).sum(axis=1)
        predicted = float(scenario.drift(r, beacons).end.rms)
        gap = float(square.mean()) - predicted**2
        zs.append(gap / max(float(square.std(ddof=1)) / drives**0.5, 1e-300) if abs(gap) > 1e-18 else 0.0)
        rms.append((predicted, float(square.mean()) ** 0.5))
    worst = int(np.argmax(np.abs(zs)))
    return {
        "predicted_rms_m": rms[worst][0],
        "observed_rms_m": rms[worst][1],
        "z": zs[worst],
        "z_of_all": float(sum(zs) / len(zs) ** 0.5),
        "z_route": worst,
        "ends": [[*pair, z] for pair, z in zip(rms, zs, strict=True)],
    }


def work_until_closed(descriptor: int, shared: int) -> None:
    """Read the shared inputs from a file, and tasks from a pipe until its other end is closed; write rows into it."""
    link, inbox = Connection(descriptor), SimpleQueue[Any]()

    def listen() -> None:
        """Take what comes; when the other end is gone so is the reason to go on, in the middle of a cell too."""
        while True:
            try:
                inbox.put(link.recv())
            except (EOFError, OSError):
                os._exit(0)

    Thread(target=listen, daemon=True).start()
    with mmap(shared, 0, access=ACCESS_READ) as content:
        workshop = Workshop(pickle.loads(content))
    while True:
        link.send(workshop.row(inbox.get()))
