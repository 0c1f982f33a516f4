"""What DriftObjective costs: per motion against an empty Python override, and as growth of the tree of RRT*.

Every figure is a ratio of two timings of the same process, taken in turns; the best of many repetitions counts, since
whatever else the machine does only adds to them.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from driftplan.model.noise import OdometryNoise
from driftplan.planning.ompl.collision import use_world
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.planning.ompl.zone_lookup import ZoneLookup
from driftplan.world.mapfiles import bundled_map, load_world
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0, heading_deg_per_full_turn=2.0)
MOTIONS = 1000
REPETITIONS = 60


class Empty(ob.OptimizationObjective):
    """The least that a Python objective can do."""

    def stateCost(self, state: Any) -> Any:
        return ob.Cost(0.0)

    def motionCost(self, a: Any, b: Any) -> Any:
        return ob.Cost(1.0)


def spaces() -> dict[str, Any]:
    return {
        "R^2": ob.RealVectorStateSpace(2),
        "SE(2)": ob.SE2StateSpace(),
        "Dubins": ob.DubinsStateSpace(1.0),
        "Reeds-Shepp": ob.ReedsSheppStateSpace(1.0),
        "R^3": ob.RealVectorStateSpace(3),
        "SE(3)": ob.SE3StateSpace(),
    }


def random_path(si: Any, spatial: bool) -> Any:
    """States at random in a square (or cube) of 100 m: every motion crosses most of the map."""
    ou.RNG.setSeed(1)
    space = si.getStateSpace()
    bounds = ob.RealVectorBounds(3 if spatial else 2)
    bounds.setLow(-50.0)
    bounds.setHigh(50.0)
    space.setBounds(bounds)
    path, state, sampler = og.PathGeometric(si), si.allocState(), si.allocStateSampler()
    for _ in range(MOTIONS + 1):
        sampler.sampleUniform(state)
        path.append(state)
    return path


def per_motion(path: Any, objectives: dict[str, Any]) -> dict[str, float]:
    """Microseconds that OMPL needs to price a motion."""
    best = dict.fromkeys(objectives, float("inf"))
    for _ in range(REPETITIONS):
        for name, objective in objectives.items():
            began = time.process_time()
            path.cost(objective)
            best[name] = min(best[name], time.process_time() - began)
    return {name: 1e6 * seconds / MOTIONS for name, seconds in best.items()}


def callbacks() -> None:
    print(f"cost of one motion, {MOTIONS} random motions, best of {REPETITIONS}")
    print(f"{'space':12} {'C++ length':>10} {'empty':>8} {'drift':>8} {'drift/empty':>12}")
    for name, space in spaces().items():
        si = ob.SpaceInformation(space)
        spatial = name in ("R^3", "SE(3)")
        path = random_path(si, spatial)
        took = per_motion(
            path,
            {
                "length": ob.PathLengthOptimizationObjective(si),
                "empty": Empty(si),
                "drift": DriftObjective(si, NOISE, (40.0, 10.0, 5.0) if spatial else (40.0, 10.0)),
            },
        )
        print(
            f"{name:12} {took['length']:8.3f}us {took['empty']:6.3f}us {took['drift']:6.3f}us "
            f"{took['drift'] / took['empty']:11.2f}x"
        )
    si = ob.SpaceInformation(ob.RealVectorStateSpace(2))
    path = random_path(si, spatial=False)
    zone = Zone(shapely.box(-20, -20, 10, 30), NOISE.scaled(3.0))
    world = World.from_polygons([], bounds=(-50, -50, 50, 50), robot_radius=0.3, zones=[zone])
    took = per_motion(path, {"empty": Empty(si), "zones": DriftObjective(si, NOISE, (40.0, 10.0), world)})
    ratio = took["zones"] / took["empty"]
    print(f"{'R^2, 1 zone':12} {'':>10} {took['empty']:6.3f}us {took['zones']:6.3f}us {ratio:11.2f}x")


def many_zones() -> None:
    """What further zones cost: motions of given lengths, and of lengths in proportion to the zones, which cut them as
    often, among squares of floor."""
    si = ob.SpaceInformation(ob.RealVectorStateSpace(2))
    objectives, lookups, widths = {}, {}, {}
    for count in (10, 1000):
        side = int(np.ceil(np.sqrt(count)))
        widths[count] = width = 100 / side
        corners = [(width * (k // side) - 50, width * (k % side) - 50) for k in range(count)]
        zones = [Zone(shapely.box(x, y, x + 0.7 * width, y + 0.7 * width), NOISE.scaled(3.0)) for x, y in corners]
        world = World.from_polygons([], bounds=(-50, -50, 50, 50), robot_radius=0.3, zones=zones)
        objectives[count] = DriftObjective(si, NOISE, (40.0, 10.0), world)
        lookups[count] = ZoneLookup(zones, range(count), -1)
    motions = (("1 m", 1.0, 1.0), ("5 m", 5.0, 5.0), ("across", np.inf, np.inf))
    shares = ((f"{share:g} zones long", share * widths[10], share * widths[1000]) for share in (0.3, 1.0, 3.0))
    for name, *steps in (*motions, *shares):
        took, pieces = {}, {}
        for (count, objective), step_m in zip(objectives.items(), steps, strict=True):
            rng = np.random.default_rng(1)
            path, state, where = og.PathGeometric(si), si.allocState(), [np.zeros(2)]
            for _ in range(MOTIONS + 1):
                move = rng.uniform(-50, 50, 2) - where[-1]
                where.append(where[-1] + move * min(1.0, step_m / np.hypot(*move)))
                state[0], state[1] = where[-1].tolist()
                path.append(state)
            took[count] = per_motion(path, {"drift": objective})["drift"]
            cut = [lookups[count].pieces(*a, *b) for a, b in pairwise(np.array(where[1:]).tolist())]
            pieces[count] = sum(map(len, cut)) / MOTIONS
        print(
            f"R^2, motions {name}: 10 zones {took[10]:.2f}us ({pieces[10]:.1f} pieces), "
            f"1000 zones {took[1000]:.2f}us ({pieces[1000]:.1f}), {took[1000] / took[10]:.2f}x"
        )


def growth(
    make_space: Callable[[], Any], world: World, start: tuple[float, ...], goal: tuple[float, ...], seconds: float
) -> dict[str, int]:
    """Iterations of RRT* in so many seconds of processor time, by objective, with the same validator."""
    objectives: dict[str, Callable[[Any], Any]] = {
        "C++ length": ob.PathLengthOptimizationObjective,
        "empty": Empty,
        "drift": lambda si: DriftObjective(si, NOISE, goal[:2]),
    }
    best = dict.fromkeys(objectives, 0)
    for seed in (1, 2, 3):
        for name, make in objectives.items():
            ou.RNG.setSeed(seed)
            space = make_space()
            bounds = ob.RealVectorBounds(2)
            for axis in (0, 1):
                bounds.setLow(axis, world.bounds[axis])
                bounds.setHigh(axis, world.bounds[axis + 2])
            space.setBounds(bounds)
            si = ob.SpaceInformation(space)
            use_world(si, world)
            si.setup()
            a, b = si.allocState(), si.allocState()
            for state, (x, y, yaw) in ((a, start), (b, goal)):
                if hasattr(state, "setXY"):
                    state.setXY(x, y)
                    state.setYaw(yaw)
                else:
                    state[0], state[1] = x, y
            pdef = ob.ProblemDefinition(si)
            pdef.setStartAndGoalStates(a, b)
            pdef.setOptimizationObjective(make(si))
            planner = og.RRTstar(si)
            planner.setProblemDefinition(pdef)
            planner.setup()
            end = time.process_time() + seconds
            planner.solve(ob.PlannerTerminationCondition(lambda end=end: time.process_time() > end))
            best[name] = max(best[name], planner.numIterations())
    return best


def trees() -> None:
    world = load_world(bundled_map("warehouse"), robot_radius=0.3)
    xmin, ymin, xmax, ymax = world.bounds
    start, goal = (
        (*world.nearest_free(np.array([x, y])).tolist(), 0.0) for x, y in ((xmin + 2, ymin + 2), (xmax - 2, ymax - 2))
    )
    print("iterations of RRT* in the warehouse, same validator, best of 3, of those with the C++ length")
    print(f"{'space':12} {'seconds':>7} {'C++ length':>11} {'empty':>16} {'drift':>16}")
    planar = {name: space for name, space in spaces().items() if not name.endswith(("^3", "(3)"))}
    for name in planar:
        for seconds in (1.0, 4.0):
            grown = growth(lambda name=name: spaces()[name], world, start, goal, seconds)
            length = grown["C++ length"]
            row = " ".join(f"{grown[kind]:8d} ({grown[kind] / length:5.2f})" for kind in ("empty", "drift"))
            print(f"{name:12} {seconds:7g} {length:11d} {row}")


def main() -> None:
    level = ou.getLogLevel()
    ou.setLogLevel(ou.LOG_NONE)
    try:
        callbacks()
        many_zones()
        trees()
    finally:
        ou.setLogLevel(level)


if __name__ == "__main__":
    main()
