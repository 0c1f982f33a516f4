"""place_beacons against greedy set cover, even spacing and a genetic search of ten times its time.

A warehouse of parallel aisles, routes from shelf to shelf along its aisles, candidates on a grid of its floor, limits
of 0.5 m (full fixes) and 0.8 m rms (tags). Every layout is judged by the oracle of place_beacons. With
DRIFTPLAN_BENCH_LARGE=1 in the environment the two largest sizes run too (an hour, in which the genetic search has two
minutes of each: ten times ten minutes would be too long).
"""

from __future__ import annotations

import os
import time
from itertools import pairwise

import numpy as np
import shapely

from driftplan.beacons.beacon import BeaconKind
from driftplan.layouts.place import place_beacons
from driftplan.layouts.placement.problem import LimitSearch, placement_problem
from driftplan.layouts.placement.requirements import DriftRequirements
from driftplan.layouts.scenario import Scenario, Sites, grid_sites
from driftplan.model.noise import OdometryNoise
from driftplan.planning.request import DriftLimit
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
KINDS = {
    "full": BeaconKind.landmark(1.5, 0.05, 0.02, line_of_sight=False),
    "rfid": BeaconKind.rfid(1.5, 0.1),
}
LIMITS_M = {"full": 0.5, "rfid": 0.8}
SIZES = ((10, 100, 0.6), (30, 500, 0.8), (60, 1250, 1.0))  # routes, candidates at least, scale of the warehouse
LARGE = ((150, 2500, 1.3), (500, 5000, 1.7))
AISLE_M, RACK_M = 3.0, 2.0
GENETIC_TIMES, GENETIC_MOST_S = 10, 120.0
COLUMNS = {"kind": 5, "routes": 7, "metres": 8, "sites": 7, "method": 16, "beacons": 9, "seconds": 9, " ": 40}


def warehouse(scale: float) -> tuple[World, list[float], list[float]]:
    """A hall of 60 x 40 m times the scale, the middles of its aisles (x) and of its cross-aisles (y)."""
    width, height = 60 * scale, 40 * scale
    cross = np.linspace(2, height - 2, int(2 * scale) + 2).tolist()
    racks, x = [], AISLE_M
    while x + RACK_M < width - 1:
        for low, high in pairwise(cross):
            racks.append(shapely.box(x, low + 1.5, x + RACK_M, high - 1.5))
        x += AISLE_M + RACK_M
    aisles = np.arange(AISLE_M / 2, width - 1, AISLE_M + RACK_M).tolist()
    return World.from_polygons(racks, bounds=(0, 0, width, height), robot_radius=0.4), aisles, cross


def shelf_routes(count: int, aisles: list[float], cross: list[float], rng: np.random.Generator) -> list[np.ndarray]:
    """Routes of three to five stops at shelves, from aisle to aisle through a near cross-aisle."""
    low, high = cross[0] + 2, cross[-1] - 2
    routes = []
    for _ in range(count):
        aisle = rng.choice(aisles)
        path = [(aisle, rng.uniform(low, high))]
        for _ in range(int(rng.integers(3, 6))):
            to, y = rng.choice(aisles), rng.uniform(low, high)
            if to != aisle:
                via = cross[int(np.argmin([abs(c - path[-1][1]) + abs(c - y) + rng.uniform(0, 3) for c in cross]))]
                path += [(aisle, via), (to, via)]
            path.append((to, y))
            aisle = to
        routes.append(np.array(path))
    return routes


def sites_of(world: World, least: int) -> np.ndarray:
    """The coarsest grid of at least so many sites."""
    spacing = 4.0
    while len(sites := grid_sites(world, spacing)) < least:
        spacing *= 0.98
    return sites


def greedy_cover(needs: DriftRequirements, sites: int) -> np.ndarray:
    """Textbook greedy set cover of the limit's rows, until the oracle accepts; nothing is taken back."""
    rows, chosen = list(needs.rows()), np.zeros(sites, dtype=bool)
    while True:
        open_rows = [row for row in rows if row.weights @ chosen[row.columns] < row.least]
        if not open_rows:
            found = needs.cuts(chosen)
            if not found:
                return chosen
            rows += found
            continue
        votes = np.bincount(np.concatenate([row.columns[row.weights > 0] for row in open_rows]), minlength=sites)
        votes[chosen] = 0
        chosen[np.argmax(votes)] = True


def even_spacing(needs: DriftRequirements, routes: list[np.ndarray], sites: np.ndarray) -> np.ndarray | None:
    """The site nearest to every x metres of every route, for the greatest x of a fine ladder that holds."""
    tree = shapely.STRtree(shapely.points(sites))
    for x in np.geomspace(40.0, 1.0, 60):
        chosen = np.zeros(len(sites), dtype=bool)
        for route in routes:
            line = shapely.LineString(route)
            stops = shapely.line_interpolate_point(line, np.arange(x, line.length, x))
            chosen[tree.nearest(stops)] = True
        if not needs.cuts(chosen):
            return chosen
    return None


def genetic(needs: DriftRequirements, start: np.ndarray, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """A genetic search over the sites that matter: 40 layouts, tournaments of 3, uniform crossover, mutations."""
    ends = time.perf_counter() + seconds
    useful = np.unique(np.concatenate([row.columns for row in needs.rows()]))

    def fitness(layout: np.ndarray) -> float:
        return float(layout.sum()) + 3.0 * len(needs.cuts(layout))

    def mutated(layout: np.ndarray) -> np.ndarray:
        child = layout.copy()
        if rng.random() < 0.7 and child.any():
            child[rng.choice(np.flatnonzero(child))] = False
        if rng.random() < 0.6:
            child[rng.choice(useful)] = True
        return child

    people = [start, *(mutated(start) for _ in range(39))]
    scores = [fitness(p) for p in people]
    while time.perf_counter() < ends:
        a, b = (min(rng.integers(0, 40, 3).tolist(), key=lambda i: scores[i]) for _ in range(2))
        child = mutated(np.where(rng.random(len(start)) < 0.5, people[a], people[b]))
        score, worst = fitness(child), int(np.argmax(scores))
        if score < scores[worst]:
            people[worst], scores[worst] = child, score
    return min((p for p in people if not needs.cuts(p)), key=lambda p: p.sum(), default=start)


def row(*cells: object) -> None:
    """One line of the table."""
    print("".join(f"{cell!s:>{width}}" for cell, width in zip(cells, COLUMNS.values(), strict=True)), flush=True)


def compare(count: int, least_sites: int, scale: float, kind: str, time_limit: float) -> None:
    world, aisles, cross = warehouse(scale)
    rng = np.random.default_rng(1)
    routes, sites = shelf_routes(count, aisles, cross, rng), sites_of(world, least_sites)
    limit = LIMITS_M[kind]
    length = sum(shapely.LineString(r).length for r in routes)
    case = (kind, count, f"{length:.0f}", len(sites))
    first: list[tuple[float, float]] = []
    begin, cpu = time.perf_counter(), time.process_time()
    layout = place_beacons(
        world,
        routes,
        NOISE,
        limit,
        Sites(KINDS[kind], sites),
        time_limit=time_limit,
        progress=lambda s, cost, _: first.append((s, cost)) if np.isfinite(cost) else None,
    )
    ours, cpu = time.perf_counter() - begin, time.process_time() - cpu
    if first:
        row(*case, "first layout", f"{first[0][1]:.0f}", f"{first[0][0]:.2f}", "")
    said = "proven" if layout.proven else f">= {layout.lower_bound:g}, gap {100 * layout.gap:.1f} %"
    row(*case, "place_beacons", len(layout.beacons), f"{ours:.2f}", f"{said}, {cpu:.1f} s of processor")
    problem = placement_problem(Scenario.of(world, routes, NOISE, DriftLimit()), Sites(KINDS[kind], sites))
    needs = LimitSearch.of(problem, limit, np.inf).requirements([limit] * count)
    begin = time.perf_counter()
    greedy = greedy_cover(needs, len(sites))
    row(*case, "greedy cover", greedy.sum(), f"{time.perf_counter() - begin:.2f}", "without making the tables")
    begin = time.perf_counter()
    even = even_spacing(needs, routes, sites)
    found = "none" if even is None else even.sum()
    row(*case, "even spacing", found, f"{time.perf_counter() - begin:.2f}", "without making the tables")
    seconds = min(GENETIC_TIMES * ours, GENETIC_MOST_S)
    bred = genetic(needs, greedy, seconds, np.random.default_rng(2))
    row(*case, "genetic search", bred.sum(), f"{seconds:.2f}", "from the greedy cover")


def main() -> None:
    large = os.environ.get("DRIFTPLAN_BENCH_LARGE") == "1"
    row(*COLUMNS)
    for kind in KINDS:
        for count, sites, scale in (*SIZES, *(LARGE if large else ())):
            compare(count, sites, scale, kind, 600.0 if count > 100 else 60.0)


if __name__ == "__main__":
    main()
