"""The subcommands of driftplan: each calls the library, writes its files, then prints.

Nothing is printed before everything is computed, so stdout holds a whole answer or nothing.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.files import write_files
from driftplan.model.drift import Drift, PointDrift, predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.report import cli_output as output
from driftplan.report.cli_options import DEFAULT_PLANNER, noise_as_json, noise_from, search_effort, world_from
from driftplan.report.itinerary_options import itinerary_as_json, itinerary_text, planned_route

if TYPE_CHECKING:
    from driftplan.planning.routes import Route
    from driftplan.world.world import World

DEMO_RADIUS_M = 0.3
DEMO_ITERATIONS = 4  # near the optimum of both maps; counted, so that a slow machine shows no worse ones
DEMO_TRIPS = {"warehouse": ((51.0, 33.0), (23.5, 18.7)), "office": ((36.0, 12.0), (6.0, 5.0))}
_NAMES = {"drift": "lowest drift", "length": "shortest", "worst_drift": "least worst drift"}


def predict(args: argparse.Namespace) -> None:
    """Drift along given paths."""
    from driftplan.world.trajectories import read_path

    noise = noise_from(args)
    drifts = [predict_drift(read_path(file), noise, start_heading=_heading(args)) for file in args.paths]
    shown: list[PointDrift] = [drift.at(args.at) if args.at else drift for drift in drifts]
    if args.png:
        write_files({args.png: _picture(None, dict(zip(args.paths, drifts, strict=True)))})
    lengths = [float(drift.length) for drift in drifts]
    if args.json:
        paths = [
            {"file": file, "length_m": length, "points": output.drift_as_json(points)}
            for file, length, points in zip(args.paths, lengths, shown, strict=True)
        ]
        _print_json(args, noise=noise_as_json(noise), paths=paths)
        return
    tables = (
        f"{file}: {length:.2f} m\n{output.drift_table(points)}"
        for file, length, points in zip(args.paths, lengths, shown, strict=True)
    )
    print("\n\n".join(tables))


def maps(args: argparse.Namespace) -> None:
    """The maps that come along."""
    from driftplan.world.mapfiles import bundled_map, bundled_maps, load_world

    rows: list[dict[str, Any]] = []
    for name in bundled_maps():
        world = load_world(bundled_map(name), robot_radius=0.0)
        xmin, ymin, xmax, ymax = world.bounds
        size = {"width_m": xmax - xmin, "height_m": ymax - ymin, "obstacles": len(world.obstacles.geoms)}
        rows.append({"name": name, **size, "zones": len(world.zones), "file": str(bundled_map(name))})
    if args.json:
        _print_json(args, maps=rows)
        return
    header = ("map", "width m", "height m", "obstacles", "zones", "file")
    print(output.table(header, [[f"{v:g}" if isinstance(v, float) else str(v) for v in row.values()] for row in rows]))


def plan(args: argparse.Namespace) -> None:
    """One route."""
    noise, world = noise_from(args), world_from(args)
    _talk(f"planning on {args.map} with {args.planner}{search_effort(args)}")
    route = planned_route(args, world, noise, start_heading=_heading(args))
    name = _NAMES[route.minimise]
    summary = _planned(name, route)
    if _among_beacons(route):
        summary |= itinerary_as_json(route)
    files = {}
    if args.csv:
        files[args.csv] = output.path_csv(route.drift)
    if args.geojson:
        files[args.geojson] = output.drift_geojson(route.drift, {"noise": noise_as_json(noise), **summary})
    if args.png:
        files[args.png] = _itinerary_picture(world, route) if _among_beacons(route) else _picture(world, {name: route})
    write_files(files)
    if args.json:
        waypoints = output.drift_as_json(route.drift)
        _print_json(args, map=args.map, noise=noise_as_json(noise), route={**summary, "waypoints": waypoints})
        return
    print(output.routes_table([summary]))
    which = "path of its roadmap" if route.bound_covers == "roadmap" else "route"
    print(f"{route.planner}: {route.status.value} No {which} has less than {_bound(route)}.\n")
    if _among_beacons(route):
        print(f"{itinerary_text(route)}\n")
    print(output.drift_table(route.drift))


def compare(args: argparse.Namespace) -> None:
    """Given paths and planned routes."""
    from driftplan.planning.roadmap.prices import exact_drift
    from driftplan.world.trajectories import read_path

    if (args.start is None) != (args.goal is None):
        raise ValueError("expected both --start and --goal, or neither, got one of them")
    if args.start is None and not args.paths:
        raise ValueError("expected something to compare: PATH.csv files, or --start and --goal")
    noise, world, heading = noise_from(args), world_from(args), _heading(args)
    drawn: dict[str, Any] = {}
    rows = []
    for file in args.paths:
        path = read_path(file)
        if path.shape[1] == 3:
            raise ValueError(
                f"{file}: expected waypoints x,y to compare on a map, got headings too: leave the column out"
            )
        drawn[file] = exact_drift(world, path, noise, heading)
        rows.append(_scored(file, drawn[file], bool(world.segments_free(path[:-1], path[1:]).all())))
    for planner in (args.planner or [DEFAULT_PLANNER]) if args.start else ():
        for route in _both(world, args.start, args.goal, noise, args, planner, heading):
            name = f"{_NAMES[route.minimise]} ({planner})"
            drawn[name] = route
            rows.append(_planned(name, route))
    if args.png:
        write_files({args.png: _picture(world, drawn)})
    if args.json:
        _print_json(args, map=args.map, noise=noise_as_json(noise), routes=rows)
        return
    print(output.routes_table(rows))


def demo(args: argparse.Namespace) -> None:
    """Lowest-drift against shortest routes on the maps that come along, then tags for rounds through the warehouse."""
    from driftplan.report import demo_beacons
    from driftplan.report.plot_beacons import layout_figure
    from driftplan.world.mapfiles import bundled_map, load_world

    noise = noise_from(args)
    if args.planner == DEFAULT_PLANNER and args.time_limit is None and args.iterations is None:
        args.iterations = DEMO_ITERATIONS
    folder = Path(args.folder)
    folder.mkdir(parents=True, exist_ok=True)
    found, pictures = {}, {}
    for name, (start, goal) in DEMO_TRIPS.items():
        world = load_world(bundled_map(name), robot_radius=DEMO_RADIUS_M)
        _talk(f"planning on {name}")
        both = {_NAMES[r.minimise]: r for r in _both(world, start, goal, noise, args, args.planner, None)}
        found[name] = [_planned(label, route) for label, route in both.items()]
        pictures[folder / f"{name}.png"] = _picture(world, both)
    _talk("placing RFID tags in warehouse")
    layout = demo_beacons.demo_layout(load_world(bundled_map("warehouse"), robot_radius=DEMO_RADIUS_M), noise)
    if not isinstance(layout, str):
        pictures[folder / "warehouse-tags.png"] = output.figure_png(layout_figure(layout))
    write_files(pictures)
    if args.json:
        files = [str(path) for path in pictures]
        tags = {"none": layout} if isinstance(layout, str) else demo_beacons.as_json(layout)
        _print_json(args, noise=noise_as_json(noise), maps=found, tags=tags, files=files)
        return
    for name, rows in found.items():
        print(f"{name}\n{output.routes_table(rows)}\n")
    print(f"warehouse: {layout if isinstance(layout, str) else demo_beacons.sentence(layout)}")
    _talk(f"wrote {', '.join(map(str, pictures))}")


def _both(
    world: World,
    start: tuple[float, float],
    goal: tuple[float, float],
    noise: OdometryNoise,
    args: argparse.Namespace,
    planner: str,
    start_heading: float | None,
) -> tuple[Route, Route]:
    """The lowest-drift route and the shortest one that the same planner finds, each given the other to beat."""
    from driftplan.planning.routes import plan_route

    same: dict[str, Any] = {
        "planner": planner,
        "time_limit": args.time_limit,
        "iterations": args.iterations,
        "seed": args.seed,
        "start_heading": start_heading,
    }
    _talk(f"planning with {planner}{search_effort(args)}")
    lowest = plan_route(world, start, goal, noise, minimise="drift", **same)
    shortest = plan_route(world, start, goal, noise, minimise="length", initial_paths=[lowest.path], **same)
    if shortest.rms < lowest.rms:  # found late: the table must not contradict itself
        lowest = plan_route(world, start, goal, noise, minimise="drift", initial_paths=[shortest.path], **same)
    return lowest, shortest


def _scored(name: str, drift: Drift, is_free: bool) -> dict[str, Any]:
    """A route in one row: its drift at the end, by the names of `compare_routes` and then some."""
    at_end = {key: float(value) for key, value in output.drift_columns(drift.end).items()}
    del at_end["distance_m"], at_end["x_m"], at_end["y_m"]
    length, bias = float(drift.length), float(drift.end.bias_norm)
    return {"name": name, "collision_free": is_free, "length_m": length, "bias_m": bias, **at_end}


def _planned(name: str, route: Route) -> dict[str, Any]:
    bound = "bound_length_m" if route.minimise == "length" else "bound_rms_m"
    search = {
        "planner": route.planner,
        "minimise": route.minimise,
        "status": route.status.name.lower(),
        bound: route.bound,
        "bound_covers": route.bound_covers,
    }
    return {**_scored(name, route.drift, True), **search}


def _bound(route: Route) -> str:
    what = {"drift": "rms", "length": "length", "worst_drift": "worst rms"}[route.minimise]
    return f"{route.bound:#.4g} m of {what}"


def _heading(args: argparse.Namespace) -> float | None:
    return None if args.start_heading_deg is None else radians(args.start_heading_deg)


def _picture(world: World | None, routes: Mapping[str, Any]) -> bytes:
    from driftplan.report.plotting import plot_comparison

    return output.figure_png(plot_comparison(world, routes))


def _print_json(args: argparse.Namespace, **answer: Any) -> None:
    print(output.json_text({"command": args.command, **answer}))


def _itinerary_picture(world: World, route: Route) -> bytes:
    from driftplan.report.plot_itinerary import plot_itinerary

    return output.figure_png(plot_itinerary(world, route))


def _talk(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _among_beacons(route: Route) -> bool:
    """Whether it was looked for among beacons or within a limit."""
    return bool(route.captures) or route.max_drift is not None or route.minimise == "worst_drift"
