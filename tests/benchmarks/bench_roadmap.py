"""Cost against time on nine maps: the roadmap planner, OMPL's planners with DriftObjective and with the same cost
written naively, PRM*'s roadmap priced afterwards, and a fast-marching solution; against what no route can beat.

All of them minimise the additive cost with the same noise and the same collision tests. Time is processor time of this
process, so that other load counts little. The limit is the least cost that any of them found; how far that may be above
the least there is, is proven: by taut strings among obstacles (`driftplan.planning.taut_strings`) whose margin is made
smaller until it is 0.2 %, or the time is over. scikit-fmm comes with `pip install driftplan[bench]`, which compiles it.

How many times faster the roadmap is depends on how far one wants to go: its first path is often within 0.01 % of the
limit, which trees approach slowly. So two ratios are given: to 1 % of the limit, and to the cost that the roadmap has
when it is first within 1 %.

    python -m tests.benchmarks roadmap
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import ceil, hypot, inf, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou
from scipy.sparse import csgraph, csr_matrix

from driftplan.model.noise import OdometryNoise
from driftplan.planning.cost import CostRates, edge_cost
from driftplan.planning.ompl.collision import use_world
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.roadmap.growth import RoadmapSearch
from driftplan.planning.roadmap.prices import AdditiveCost
from driftplan.planning.taut_strings import first_margin_m, least_route
from driftplan.world.world import World
from tests.benchmarks import bench_trips
from tests.benchmarks.bench_time_limits import maps

NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
SECONDS = float(os.environ.get("BENCH_SECONDS", "3"))  # processor seconds for each planner on each map
PLOT = Path("build/benchmarks/roadmap.png")
WITHIN = (0.05, 0.01, 0.003)
CELLS = 1_500_000  # of the fast-marching grid
ENOUGH, PROOF_S = 0.002, 90.0  # of the limit, unproven; and processor seconds to look for the proof

Points = NDArray[np.float64]
Trace = list[tuple[float, float]]  # processor seconds, least cost so far in m²


@dataclass(frozen=True)
class Query:
    name: str
    world: World
    start: tuple[float, float]
    goal: tuple[float, float]


def queries() -> Iterator[Query]:
    """The bundled maps, public ones where they are at hand, aisles, scattered boxes, and 5000 x 5000 cells."""
    columns = [[(x, y), (x + 2, y), (x + 2, y + 14), (x, y + 14)] for x in range(4, 76, 5) for y in (3, 20, 37)]
    aisles = World.from_polygons(columns, bounds=(0, 0, 80, 54), robot_radius=0.3)
    rng = np.random.default_rng(3)
    boxes = [shapely.box(x, y, x + w, y + h) for x, y, w, h in rng.uniform((2, 2, 1, 1), (72, 46, 6, 6), (40, 4))]
    scattered = World.from_polygons(boxes, bounds=(0, 0, 80, 54), robot_radius=0.3)
    made = ("aisles", aisles), ("boxes", scattered), ("5000 x 5000", bench_trips.load())
    for name, world in (*maps(), *made):
        xmin, ymin, xmax, ymax = world.free_parts[0].bounds
        ends = [
            shapely.shortest_line(world.free_parts[0].buffer(-0.05), shapely.Point(corner)).coords[0]
            for corner in ((xmin, ymin), (xmax, ymax))
        ]
        # Without zones: fast marching and the objectives below are given one noise.
        yield Query(name, replace(world, zones=()), *ends)


# The limit, and fast marching


def unproven(query: Query, path: Points, cost: float) -> float:
    """By what share a cost may be above the least; ``path`` is one that is known."""
    margin_m, gap = first_margin_m(query.world), 1.0
    began, ends = time.process_time(), (np.array(query.start), np.array(query.goal))

    def left_s() -> float:
        return PROOF_S - (time.process_time() - began)

    while gap > ENOUGH and left_s() > 0:
        least = least_route(query.world, *ends, margin_m, path, left_s=left_s)
        gap, margin_m = min(gap, 1 - least.cost([NOISE]) / cost), margin_m / 2
    return gap


def fast_marching(query: Query) -> tuple[float, float]:
    """The cost that it gives, and the seconds it takes."""
    try:
        import skfmm
    except ImportError:
        return inf, inf
    began = time.process_time()
    xy, free, h = grid(query.world, CELLS)
    rates = CostRates.of(NOISE)
    squared = ((xy - query.goal) ** 2).sum(axis=-1)
    speed = 1.0 / (rates.heading * squared + rates.position)
    front = np.ones(free.shape)
    goal, start = (nearest(xy, free, end) for end in (query.goal, query.start))
    front[goal] = -1.0
    taken = skfmm.travel_time(np.ma.MaskedArray(front, ~free), speed, dx=h, order=2)
    return float(taken[start]), time.process_time() - began


def grid(world: World, cells: int) -> tuple[Points, NDArray[np.bool_], float]:
    xmin, ymin, xmax, ymax = world.bounds
    h = sqrt((xmax - xmin) * (ymax - ymin) / cells)
    x, y = np.arange(xmin + h / 2, xmax, h), np.arange(ymin + h / 2, ymax, h)
    xy = np.stack(np.meshgrid(x, y), axis=-1)
    return xy, np.asarray(world.is_free(xy)), h


def nearest(xy: Points, free: NDArray[np.bool_], point: tuple[float, float]) -> tuple[int, int]:
    distance = np.where(free, np.linalg.norm(xy - point, axis=-1), inf)
    row, column = np.unravel_index(int(distance.argmin()), free.shape)
    return int(row), int(column)


# The planners


BEST: list[Points] = []  # the roadmap's latest path


def roadmap(query: Query) -> Trace:
    pricing = AdditiveCost(query.world, np.array(query.goal), NOISE)
    began = time.process_time()
    search = RoadmapSearch(pricing, np.array(query.start))
    trace: Trace = []
    while time.process_time() - began < SECONDS and not search.is_optimal:
        search.grow(lambda: time.process_time() - began >= SECONDS)
        if search.path is not None:
            trace.append((time.process_time() - began, search.additive_cost))
    assert search.path is not None
    BEST[:] = [search.path]
    return trace or [(time.process_time() - began, search.additive_cost)]


class Naive(ob.OptimizationObjective):
    """The cost as one writes it first: a sum over states interpolated every ten centimetres."""

    def __init__(self, si: Any, goal: tuple[float, float]) -> None:
        super().__init__(si)
        self.space, self.goal, self.rates = si.getStateSpace(), goal, CostRates.of(NOISE)
        self.scratch = self.space.allocState()

    def stateCost(self, state: Any) -> Any:
        return ob.Cost(self.rates.heading * hypot(state[0] - self.goal[0], state[1] - self.goal[1]) ** 2)

    def motionCost(self, a: Any, b: Any) -> Any:
        length = self.space.distance(a, b)
        steps = max(1, ceil(length / 0.1))
        total = 0.0
        for k in range(steps):
            self.space.interpolate(a, b, (k + 0.5) / steps, self.scratch)
            total += (self.stateCost(self.scratch).value() + self.rates.position) * length / steps
        return ob.Cost(total)


def problem(query: Query, make: Callable[[Any], Any]) -> tuple[Any, Any]:
    """SpaceInformation and problem over R^2."""
    ou.RNG.setSeed(1)
    space = ob.RealVectorStateSpace(2)
    bounds = ob.RealVectorBounds(2)
    for axis in (0, 1):
        bounds.setLow(axis, query.world.bounds[axis])
        bounds.setHigh(axis, query.world.bounds[axis + 2])
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    use_world(si, query.world)
    si.setup()
    a, b = si.allocState(), si.allocState()
    (a[0], a[1]), (b[0], b[1]) = query.start, query.goal
    definition = ob.ProblemDefinition(si)
    definition.setStartAndGoalStates(a, b)
    definition.setOptimizationObjective(make(si))
    return si, definition


def tree(planner_type: Any, make: Callable[[Any, Query], Any]) -> Callable[[Query], Trace]:
    """An anytime planner of OMPL, its best cost looked at in every iteration."""

    def run(query: Query) -> Trace:
        si, definition = problem(query, lambda si: make(si, query))
        planner = planner_type(si)
        planner.setProblemDefinition(definition)
        planner.setup()
        trace: Trace = []
        began = time.process_time()

        def stop() -> bool:
            now, cost = time.process_time() - began, planner.bestCost().value()
            if np.isfinite(cost) and (not trace or cost < trace[-1][1]):
                trace.append((now, cost))
            return now > SECONDS

        planner.solve(ob.PlannerTerminationCondition(stop))
        return trace

    return run


def prm_star(query: Query) -> Trace:
    """PRM* minimises length; its roadmap is pulled out and priced in bulk, after ever longer runs."""
    si, definition = problem(query, ob.PathLengthOptimizationObjective)
    planner = og.PRMstar(si)
    planner.setProblemDefinition(definition)
    planner.setup()
    trace: Trace = []
    began = time.process_time()
    share = 0.125
    while (spent := time.process_time() - began) < SECONDS:
        planner.solve(ob.timedPlannerTerminationCondition(min(share, SECONDS - spent)))
        share *= 2
        data = ob.PlannerData(si)
        planner.getPlannerData(data)
        n = data.numVertices()
        xy = np.array([(q[0], q[1]) for q in (data.getVertex(i).getState() for i in range(n))])
        following = [list(data.getEdges(i)) for i in range(n)]
        row = np.repeat(np.arange(n), [len(k) for k in following])
        column = np.concatenate([np.asarray(k, dtype=int) for k in following])
        if not len(row):
            continue
        graph = csr_matrix((edge_cost(xy[row], xy[column], query.goal, NOISE), (row, column)), shape=(n, n))
        start, goal = (int(np.linalg.norm(xy - end, axis=1).argmin()) for end in (query.start, query.goal))
        cost = float(csgraph.dijkstra(graph, directed=False, indices=start)[goal])
        if np.isfinite(cost):
            trace.append((time.process_time() - began, min(cost, trace[-1][1] if trace else inf)))
    return trace


def drift_objective(si: Any, query: Query) -> Any:
    return DriftObjective(si, NOISE, query.goal)


def naive_objective(si: Any, query: Query) -> Any:
    return Naive(si, query.goal)


PLANNERS: dict[str, Callable[[Query], Trace]] = {
    "roadmap": roadmap,
    "RRT*": tree(og.RRTstar, drift_objective),
    "Informed RRT*": tree(og.InformedRRTstar, drift_objective),
    "BIT*": tree(og.BITstar, drift_objective),
    "RRT*, naive cost": tree(og.RRTstar, naive_objective),
    "PRM*, priced after": prm_star,
}


def time_to(trace: Trace, cost: float) -> float:
    return next((seconds for seconds, reached in trace if reached <= cost), inf)


def main() -> None:
    ou.setLogLevel(ou.LOG_NONE)
    drawn = []
    for query in queries():
        query.world.segments_free(query.start, query.goal)  # inflate: every planner finds the world ready
        traces = {name: plan(query) for name, plan in PLANNERS.items()}
        least = min(trace[-1][1] for trace in traces.values() if trace)
        marched, seconds = fast_marching(query)
        open_ = max(unproven(query, BEST[0], least), 0.0)
        print(
            f"\n{query.name}: {least:.5g} m², {open_:.2%} of it unproven; fast marching {marched / least - 1:+.2%} in "
            f"{seconds:.1f} s"
        )
        print(f"{'planner':20}" + "".join(f"{f'to {part:.1%}':>10}" for part in WITHIN) + f"{'at the end':>14}")
        for name, trace in traces.items():
            times = [time_to(trace, least * (1 + part)) for part in WITHIN]
            said = "".join(f"{f'{t:.2f} s' if t < inf else '-':>10}" for t in times)
            end = f"{trace[-1][1] / least - 1:+.2%}" if trace else "no path"
            print(f"{name:20}{said}{end:>14}", flush=True)
        print(f"{'':20}faster than the best of the others: {ratios(traces, least * 1.01)}")
        drawn.append((query.name, least, traces))
    plot(drawn)


def ratios(traces: dict[str, Trace], enough: float) -> str:
    ours, reached = next(((t, cost) for t, cost in traces["roadmap"] if cost <= enough), (inf, 0.0))
    if ours == inf:
        return "not at all"
    said = []
    for what, cost in (("to 1 %", enough), ("to the cost it then has (within 0.01 %)", reached * 1.0001)):
        others = min(time_to(trace, cost) for name, trace in traces.items() if name != "roadmap")
        said.append(f"{what} {f'{others / ours:.1f}x' if others < inf else f'more than {SECONDS / ours:.0f}x'}")
    return ", ".join(said)


# So that they can be told apart in grey.
STYLES = {
    "roadmap": {"color": "black", "linewidth": 2.5},
    "RRT*": {"color": "tab:orange", "linestyle": "-"},
    "Informed RRT*": {"color": "tab:green", "linestyle": "--"},
    "BIT*": {"color": "tab:red", "linestyle": "-."},
    "RRT*, naive cost": {"color": "tab:purple", "linestyle": ":"},
    "PRM*, priced after": {"color": "tab:brown", "linestyle": (0, (6, 1, 1, 1, 1, 1))},
}


def plot(drawn: list[tuple[str, float, dict[str, Trace]]]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = ceil((len(drawn) + 1) / 4)
    columns = ceil((len(drawn) + 1) / rows)
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(3.4 * columns, 3.0 * rows),
        layout="constrained",
        squeeze=False,
        sharex=True,
        sharey=True,
    )
    panels = list(axes.flat)
    for ax, (name, least, traces) in zip(panels, drawn, strict=False):
        for planner, trace in traces.items():
            if trace:
                last = max(SECONDS, trace[-1][0])
                seconds, costs = np.array([*trace, (last, trace[-1][1])]).T
                ax.step(seconds, 100 * np.maximum(costs / least - 1, 1e-4), where="post", **STYLES[planner])
        ax.set(xlim=(0.005, 1.2 * SECONDS), ylim=(0.008, 60), xscale="log", yscale="log", title=name)
        ax.set_yticks([0.01, 0.1, 1, 10], ["≤ 0.01", "0.1", "1", "10"])
        ax.grid(alpha=0.3)
        ax.tick_params(labelbottom=True, labelleft=True)
        ax.set(xlabel="processor time, s", ylabel="cost above the limit, %")
    for ax in panels[len(drawn) :]:
        ax.set_axis_off()
    panels[len(drawn)].legend(
        handles=[plt.Line2D([], [], label=planner, **style) for planner, style in STYLES.items()], loc="center"
    )
    PLOT.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(PLOT, dpi=110)
    print(f"\ncost against time: {PLOT}")


if __name__ == "__main__":
    main()
