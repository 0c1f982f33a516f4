"""``driftplan compare``: given paths and planned routes on a map, side by side."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from driftplan.report.commands import shared
from driftplan.report.commands.answer import Answer, talk
from driftplan.report.commands.option import Command, Group, Idle, Option, input_file, label
from driftplan.report.records import record

if TYPE_CHECKING:
    from driftplan import Comparison, Drift, OdometryNoise, Route, World

NAMES = {"drift": "lowest drift", "length": "shortest", "worst_drift": "least worst drift"}


def run(args: argparse.Namespace) -> Answer:
    """Given paths, and of every planner the lowest-drift and the shortest route."""
    from driftplan.report.figures.routes import plot_comparison

    if (args.start is None) != (args.goal is None):
        raise ValueError("expected both --start and --goal, or neither, got one of them")
    if args.start is None and not args.paths:
        raise ValueError("expected something to compare: PATH.csv files, or --start and --goal")
    noise, world = shared.noise_from(args), shared.world_from(args)
    routes: dict[str, Route | Drift] = {label(file): _given(world, file, noise, args) for file in args.paths}
    for planner in (args.planner or [shared.DEFAULT_PLANNER]) if args.start else ():
        talk(f"planning with {planner}{shared.search_effort(args)}")
        for name, route in both(world, *shared.ends_from(args, world), noise, args, planner).items():
            routes[f"{name} ({planner})"] = route
    about, robot = {"map": label(args.map), "noise": noise.given()}, robot_in(args, world)
    return Answer(
        payload=lambda: about | {"routes": rows_of(routes, world, robot)},
        text=lambda: str(compared(routes, world, robot)),
        files={"picture": lambda: plot_comparison(world, routes)},
    )


def both(
    world: World, start: Any, goal: Any, noise: OdometryNoise, args: argparse.Namespace, planner: str
) -> dict[str, Route]:
    """The lowest-drift route and the shortest one that the same search came by, by name."""
    from driftplan import plan_route

    effort = {"time_limit": args.time_limit, "iterations": args.iterations, "seed": args.seed}
    lowest = plan_route(world, start, goal, noise, planner=planner, **effort)
    assert lowest.shortest is not None
    return {NAMES["drift"]: lowest, NAMES["length"]: lowest.shortest}


def robot_in(args: argparse.Namespace, world: World) -> World | None:
    """The same world for a robot of the radius that ``--collisions`` says, if it does."""
    return None if args.collisions is None else replace(world, robot_radius=args.collisions)


def compared(routes: Mapping[str, Route | Drift], world: World, collisions: World | None = None) -> Comparison:
    """The `Comparison` of routes by name."""
    from driftplan import compare_routes

    return compare_routes(list(routes.values()), list(routes), world=world, collisions=collisions)


def rows_of(routes: Mapping[str, Route | Drift], world: World, collisions: World | None = None) -> list[dict[str, Any]]:
    """Routes by the names of `compare_routes`, with all there is to say about their ends and how they were found."""
    from driftplan import Route

    rows = compared(routes, world, collisions).to_dicts()
    for row, route in zip(rows, routes.values(), strict=True):
        (end,) = (route.drift if isinstance(route, Route) else route).end.to_dicts()
        row |= {key: value for key, value in end.items() if key not in ("distance_m", "x_m", "y_m")}
        if isinstance(route, Route):
            row |= record(route, "minimise", "status", "bound_covers")
            row["bound_length_m" if route.minimise == "length" else "bound_rms_m"] = route.bound
    return rows


def _given(world: World, file: str, noise: OdometryNoise, args: argparse.Namespace) -> Drift:
    from driftplan import read_path
    from driftplan.planning.roadmap.prices import exact_drift

    path = read_path(file)
    if path.shape[1] == 3:
        raise ValueError(f"{file}: expected waypoints x,y to compare on a map, got headings too: leave the column out")
    return exact_drift(world, path, noise, shared.start_heading_from(args))


# fmt: off
_SEVERAL = f"{shared.SEARCH[0].help}, may be given several times (default: {shared.DEFAULT_PLANNER})"
_PLANNERS = shared.SEARCH[0]._replace(help=_SEVERAL, default=None, how={"action": "append"})
COLLISIONS = Option("collisions", "M", "how likely a robot of this radius, metres, that steers by its estimate touches "
                    "a wall; give --robot-radius a margin above it")
COMMAND = Command(
    summary="given paths and planned routes on a map, side by side",
    description="Compare paths on a map. With --start and --goal, the lowest-drift route of every --planner and the "
    "shortest route join in.",
    run=run,
    arguments=(
        shared.MAP,
        Option("paths", "PATH.csv", "waypoints x,y in metres, one per line; - is standard input", input_file,
               how={"nargs": "*"}),
    ),
    groups=(
        Group("planning", (*shared.ENDS, shared.SNAP, shared.START_HEADING, _PLANNERS, *shared.SEARCH[1:], COLLISIONS)),
        shared.WORLD,
        *shared.NOISE,
    ),
    files={"picture": "draw the map, the routes, their error ellipses and their drift against distance"},
    idle=(Idle(("planner", "time_limit", "iterations", "seed", "snap"), lambda args: args.start is None,
               "nothing is planned without --start and --goal"),),
    examples=("warehouse --start 51,33 --goal 23.5,18.7 --picture routes.png",
              "site.yaml mine.csv theirs.csv --noise noise.yaml --json"),
)
