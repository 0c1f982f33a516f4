"""``driftplan plan``: the lowest-drift route between two points of a map, among beacons or not."""

from __future__ import annotations

import argparse
from dataclasses import replace
from math import hypot
from typing import TYPE_CHECKING, Any

from driftplan.report.commands import shared
from driftplan.report.commands.answer import Answer, Progress, talk
from driftplan.report.commands.compare import COLLISIONS, NAMES, compared, robot_in, rows_of
from driftplan.report.commands.option import Command, Group, Idle, Option, geojson_file, input_file, label
from driftplan.report.records import record, waypoints
from driftplan.tables import counted, numbers, table, yes_no

_NOTHING = 0.005  # shares that are not worth a word
_ONE_ROUTE = "it is about one route, not --trips"

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from driftplan import OdometryNoise, Route, World


def run(args: argparse.Namespace) -> Answer:
    """One route, or those of many trips."""
    if args.trips:
        return _many(args)
    if args.start is None or args.goal is None:
        raise ValueError("expected both --start and --goal, or --trips")
    if args.graph:
        return _on_graph(args)
    from driftplan.report.figures.routes import plot_collisions, plot_comparison, plot_itinerary
    from driftplan.report.records import beyond_linear_text, drift_geojson, drift_table

    noise, world = shared.noise_from(args), shared.world_from(args)
    talk(f"planning on {label(args.map)} with {args.planner}{shared.search_effort(args)}")
    route = planned_route(args, world, noise)
    among_beacons = route if route.is_among_beacons else None
    routes = {NAMES[route.minimise]: route} | ({NAMES["length"]: route.shortest} if route.shortest else {})
    robot = robot_in(args, world)

    def summary() -> dict[str, Any]:
        row, *shortest = rows_of(routes, world, robot)
        itinerary = itinerary_as_json(among_beacons) if among_beacons else {}
        return row | {"shortest": shortest[0] if shortest else None} | itinerary

    def text() -> str:
        words = [str(compared(routes, world, robot)), *gained_in_words(route), bound_in_words(route)]
        words += ["", itinerary_text(among_beacons)] if among_beacons else []
        return "\n".join([*words, "", drift_table(route.drift)]) + beyond_linear_text(route.drift)

    def picture() -> Figure:
        if robot is not None:
            return plot_collisions(world, route.collision_probability(robot))
        return plot_itinerary(world, among_beacons) if among_beacons else plot_comparison(world, routes)

    def payload() -> dict[str, Any]:
        along = {"waypoints": route.drift.to_dicts(), "beyond_linear_m": route.drift.beyond_linear.tolist()}
        return {**_about(args, noise), "route": {**summary(), **along}}

    files = shared.route_files(route.drift) | {"picture": picture}
    files["geojson"] = lambda: drift_geojson(route.drift, {"noise": noise.given(), **summary()})
    return Answer(payload=payload, text=text, files=files)


def _on_graph(args: argparse.Namespace) -> Answer:
    """The ways between the nodes of a route graph that are nearest to the ends."""
    from driftplan import load_beacons, load_graph
    from driftplan.report.commands.graph import ways_on_graph

    if args.geojson is not None:
        raise ValueError("--geojson would have no effect with --graph: `driftplan graph` writes the graph back")
    noise, world, graph = shared.noise_from(args), shared.world_from(args), load_graph(args.graph)
    beacons = load_beacons(args.beacons) if args.beacons else ()
    ends = graph.node_ids[graph.nearest(args.start)], graph.node_ids[graph.nearest(args.goal)]
    for name, end, node in zip(("start", "goal"), (args.start, args.goal), ends, strict=True):
        x, y = graph.xy[graph.node(node)].tolist()
        talk(f"{name} is node {node} at ({x:g}, {y:g}), {hypot(x - end[0], y - end[1]):.3g} m away")
    ways = ways_on_graph(graph, ends, noise, beacons, world)
    about = {"map": label(args.map), "graph": args.graph, "noise": noise.given()}
    return replace(ways, payload=lambda: {**about, **ways.payload()})


def _many(args: argparse.Namespace) -> Answer:
    from driftplan import plan_routes

    for option in COMMAND.files:
        if getattr(args, option) is not None:
            raise ValueError(f"--{option} would have no effect: {_ONE_ROUTE}")
    noise, world = shared.noise_from(args), shared.world_from(args)
    trips = shared.trips_from(args, world)
    talk(f"planning {counted(len(trips), 'trip')} on {label(args.map)}{shared.search_effort(args)}")

    def done(count: int, of: int) -> None:
        Progress.news = f"{count} of {of} trips"

    asked = _asked(args) | {"time_limit": args.time_limit, "seed": args.seed, "progress": done}
    found = plan_routes(world, [(trip.start, trip.goal) for trip in trips], noise, **asked)
    routes = {trip.name or f"trip {k}": route for k, (trip, route) in enumerate(zip(trips, found, strict=True))}

    def payload() -> dict[str, Any]:
        rows = zip(rows_of(routes, world), found, strict=True)
        return _about(args, noise) | {"routes": [row | {"waypoints": waypoints(route.path)} for row, route in rows]}

    def text() -> str:
        return table({k: v for k, v in compared(routes, world).columns().items() if k != "above least %"})

    return Answer(payload=payload, text=text)


def _about(args: argparse.Namespace, noise: OdometryNoise) -> dict[str, Any]:
    return {"map": label(args.map), "noise": noise.given(), "estimator": args.estimator}


def planned_route(args: argparse.Namespace, world: World, noise: OdometryNoise) -> Route:
    """The route that the options ask for: among beacons if there are any."""
    from driftplan import plan_route

    effort = {name: getattr(args, name) for name in ("planner", "time_limit", "iterations", "seed")}
    return plan_route(world, *shared.ends_from(args, world), noise, **effort | _asked(args))


def _asked(args: argparse.Namespace) -> dict[str, Any]:
    """What is asked of a route, by the names of `plan_route`."""
    from driftplan import DriftLimit, load_beacons

    asked = {name: getattr(args, name) for name in ("minimise", "estimator", "max_detour")}
    asked |= {"beacons": load_beacons(args.beacons) if args.beacons else None, "start_fix": shared.start_fix_from(args)}
    asked["max_drift"] = DriftLimit(args.max_drift, redundancy=args.redundancy or 1, min_capture=args.min_capture)
    return {name: value for name, value in asked.items() if value is not None}


def gained_in_words(route: Route) -> list[str]:
    """What the route has over the shortest one, and what it costs."""
    other = route.shortest
    if other is None or not other.rms > 0:
        return []
    less, longer = 1 - route.rms / other.rms, route.length / other.length - 1
    if less < _NOTHING:
        return ["Nothing is gained here by a detour: the shortest route drifts no more than the best one found."]
    return [
        f"Gained: {100 * less:.1f} % less drift at the goal than on the shortest route ({route.rms:.3g} m instead of "
        f"{other.rms:.3g} m), by driving {100 * longer:.1f} % farther."
    ]


def bound_in_words(route: Route) -> str:
    """Why the search ended, and how much better another route could be, as far as that is known."""
    what, value = {
        "drift": ("rms drift at the goal", route.rms),
        "length": ("length", route.length),
        "worst_drift": ("worst rms drift", route.worst_drift),
    }[route.minimise]
    ended = f"{route.planner}: {route.status.value}"
    if not route.bound > _NOTHING * value:
        return f"{ended} How much better another route could be is not known."
    return f"{ended} Proven for {route.bound_covers}: none has less than {route.bound:#.4g} m of {what}."


def itinerary_as_json(route: Route) -> dict[str, Any]:
    """What an itinerary says beyond a route."""
    passes = []
    for capture in route.captures:
        beacon = capture.beacon
        row = {"beacon": beacon.id, **record(beacon, "x_m", "y_m"), "kind": beacon.kind.name}
        row |= record(capture, "enter_m", "leave_m", "probability")
        passes.append(row | {"counted_on": any(beacon is other for other in route.beacons)})
    told = record(route, "max_drift_m", "worst_drift_m", "worst_guaranteed_m", "shortest_length_m")
    return told | {"passes": passes}


def itinerary_text(route: Route) -> str:
    """The same for people: the worst drift, what it is held against, and a line per pass."""
    limit = "" if route.max_drift is None else f" (limit {route.max_drift:g} m)"
    lines = [f"worst drift on the way: {route.worst_drift:.3f} m{limit}"]
    if route.worst_guaranteed > route.worst_drift:
        lines.append(f"with any one beacon dead: {route.worst_guaranteed:.3f} m")
    lines.append(f"length: {route.length:.2f} m; the shortest route has {route.shortest_length:.2f} m")
    if passes := itinerary_as_json(route)["passes"]:
        names = [row["beacon"] or f"({row['x_m']:g}, {row['y_m']:g})" for row in passes]
        columns = {"beacon": names, "kind": [row["kind"] for row in passes]}
        columns |= numbers(passes, 2, "enter_m", "leave_m", "probability")
        lines += ["", table(columns | {"counted on": yes_no(row["counted_on"] for row in passes)})]
    return "\n".join(lines)


# fmt: off
_TRIPS = Option("trips", "FILE", "many routes instead, in parallel on one graph of the map: start_x, start_y, goal_x, "
                "goal_y per line, metres, as for `driftplan design`", input_file)
_GRAPH = Option("graph", "FILE", "on the edges of a route graph (nav2's GeoJSON, .lif, .building.yaml), from the node "
                "nearest to the start to that nearest to the goal", str)
_GOALS = (
    Option("minimise", "", "rms drift at the goal, length, or the greatest rms drift anywhere on the way", str,
           "drift", ("drift", "length", "worst_drift")),
    Option("max_detour", "TIMES", "greatest length, as a multiple of that of the shortest route (default: any)"),
)
_BEACONS = Group("beacons on the way", (
    Option("beacons", "FILE", "beacons to use, as GeoJSON (written by `driftplan place --geojson`); routes are then "
           "at most 1.5 times as long as the shortest, unless --max-detour or --minimise length says otherwise",
           geojson_file),
    shared.ESTIMATOR,
    Option("max_drift", "M", "greatest rms drift anywhere on the way, metres (default: any)"),
    Option("redundancy", "", "2: the limit holds with any one beacon dead (default: 1, all are alive)", int,
           choices=(1, 2)),
    Option("min_capture", "P", "passes of beacons that the drifting robot makes with less than this probability (a "
           "ratio) do not count (default: 0.9)"),
    *shared.START_SPREAD,
))
COMMAND = Command(
    summary="the lowest-drift route between two points of a map",
    description="Plan the route from start to goal on which odometry gets lost least.",
    run=run,
    arguments=(shared.MAP,),
    groups=(
        Group("planning", (*shared.ENDS, _TRIPS, _GRAPH, shared.SNAP, *_GOALS, shared.START_HEADING, *shared.SEARCH,
                           COLLISIONS)),
        shared.WORLD,
        _BEACONS,
        *shared.NOISE,
    ),
    files={
        **shared.ROUTE_FILES,
        "geojson": "write the route and the drift along it as a GeoJSON LineString, coordinates in metres",
        "picture": "draw the map, the route, its error ellipses and its drift against distance, or with --collisions "
        "where it may touch walls",
    },
    idle=(
        Idle(("start", "goal", "start_heading_deg", "planner", "iterations", "collisions"),
             lambda args: bool(args.trips), _ONE_ROUTE),
        Idle(("trips", "snap", "minimise", "max_detour", "start_heading_deg", "planner", "time_limit", "iterations",
              "seed", "collisions", "estimator", "max_drift", "redundancy", "min_capture", "start_position_std_m",
              "start_heading_std_deg"), lambda args: bool(args.graph), "a way on a --graph is found without"),
        Idle(("redundancy", "min_capture", "estimator"), lambda args: not args.beacons,
             "there are no --beacons on the way"),
    ),
    examples=("warehouse --start 51,33 --goal 23.5,18.7 --picture route.png",
              "site.yaml --start 2,3 --goal 40,12 --noise noise.yaml --beacons tags.geojson --max-drift 0.5"),
)
