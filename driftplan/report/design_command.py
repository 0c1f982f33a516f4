"""``driftplan design``: beacons and routes chosen together, for trips that are driven again and again."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.files import write_files
from driftplan.report import cli_output as output
from driftplan.report.cli_options import (
    add_noise_options,
    add_world_options,
    noise_as_json,
    noise_from,
    output_type,
    world_from,
)
from driftplan.report.itinerary_options import add_start_options, start_fix_from
from driftplan.report.place_command import add_kind_options, kind_from

if TYPE_CHECKING:
    from driftplan.layouts.co_design.design import CoDesign, Design


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Add the subcommand; `design` carries it out."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "design",
        help="beacons and routes chosen together for trips, at the least cost of both",
        description="Choose beacons and routes together: every trip gets a route on which the drift stays under the "
        "limit, and what beacons and driving cost together is least. Compared with shortest routes for which beacons "
        "are placed afterwards.",
    )
    parser.add_argument("map", metavar="MAP", help="map file, or the name of a map that comes along")
    parser.add_argument(
        "trips",
        metavar="TRIPS.csv",
        help="a line per trip: start_x,start_y,goal_x,goal_y and perhaps weight (how often it is driven), metres",
    )
    wanted = parser.add_argument_group("what is wanted")
    wanted.add_argument(
        "--max-drift", type=float, required=True, metavar="M", help="limit on the rms drift anywhere, metres"
    )
    wanted.add_argument(
        "--beacon-price", type=float, default=1.0, metavar="PRICE", help="of one beacon, in any unit (default: 1)"
    )
    wanted.add_argument(
        "--price-per-m",
        type=float,
        required=True,
        metavar="PRICE",
        help="of driving one metre once, in the same unit",
    )
    wanted.add_argument(
        "--redundancy", type=int, choices=(1, 2), default=1, help="2: hold with any one beacon dead (default: 1)"
    )
    wanted.add_argument(
        "--max-detour",
        type=float,
        default=1.5,
        metavar="TIMES",
        help="greatest length of a route, as a multiple of that of the shortest (default: 1.5)",
    )
    wanted.add_argument(
        "--min-capture",
        type=float,
        default=0.9,
        metavar="P",
        help="the limit holds without readings less sure than this (default: 0.9; 0: all in range count)",
    )
    add_start_options(wanted)
    wanted.add_argument("--time-limit", type=float, default=120.0, metavar="S", help="seconds to search (default: 120)")
    wanted.add_argument("--seed", type=int, default=0, metavar="N", help="seed of samples and restarts (default: 0)")
    add_kind_options(parser)
    sites = parser.add_argument_group("where beacons may go")
    sites.add_argument("--candidates", metavar="FILE.csv", help="sites x,y in metres, one per line; default: a grid")
    sites.add_argument("--spacing-m", type=float, metavar="M", help="spacing of the grid, metres (default: the range)")
    sites.add_argument("--existing", metavar="FILE.geojson", help="beacons that are there already")
    add_world_options(parser)
    add_noise_options(parser)
    files = parser.add_argument_group("files")
    for kind, said in (
        ("geojson", "write the beacons as GeoJSON points in metres; `driftplan plan --beacons` reads it back"),
        ("csv", "write the installers' table: id, place, nearest wall, routes, which failure hurts most"),
        ("png", "draw the design and the one it is compared with"),
    ):
        files.add_argument(f"--{kind}", type=output_type(kind), metavar="FILE", help=said)
    parser.add_argument("--json", action="store_true", help="print JSON, every key with its unit")
    return parser


def design(args: argparse.Namespace) -> None:
    """The design that the arguments ask for."""
    from driftplan.layouts.co_design.co_design import co_design
    from driftplan.layouts.co_design.trips import load_trips
    from driftplan.layouts.layout_files import layout_csv, layout_geojson, load_beacons
    from driftplan.layouts.scenario import DriftLimit
    from driftplan.layouts.sites import Sites
    from driftplan.report.plot_design import plot_design
    from driftplan.world.trajectories import read_path

    noise, world, trips = noise_from(args), world_from(args), load_trips(args.trips)
    _talk(f"choosing beacons and routes for {len(trips)} trips on {args.map}, at most {args.time_limit:g} s")
    found = co_design(
        world,
        trips,
        noise,
        DriftLimit(args.max_drift, redundancy=args.redundancy),
        Sites(
            replace(kind_from(args), cost=args.beacon_price),
            read_path(args.candidates)[:, :2] if args.candidates else None,
            spacing_m=args.spacing_m,
            existing=load_beacons(args.existing) if args.existing else (),
        ),
        price_per_m=args.price_per_m,
        min_capture=args.min_capture,
        max_detour=args.max_detour,
        start_fix=start_fix_from(args),
        time_limit=args.time_limit,
        seed=args.seed,
        progress=lambda seconds, cost: _talk(f"{seconds:.1f} s: a design of cost {cost:.6g}"),
    )
    files: dict[Path, bytes] = {}
    if args.csv:
        files[args.csv] = layout_csv(found.layout)
    if args.geojson:
        files[args.geojson] = layout_geojson(found.layout)
    if args.png:
        files[args.png] = output.figure_png(plot_design(world, found))
    write_files(files)
    if args.json:
        said = {
            "command": args.command,
            "map": args.map,
            "noise": noise_as_json(noise),
            "design": design_as_json(found),
        }
        print(output.json_text(said))
        return
    rows = [
        [
            str(k),
            f"{trip.weight:g}",
            f"{route.shortest_length:.2f}",
            f"{route.length:.2f}",
            f"{route.worst_drift:.3f}",
            " ".join(b.id for b in route.beacons),
        ]
        for k, (trip, route) in enumerate(zip(found.trips, found.routes, strict=True))
    ]
    print(output.table(("trip", "weight", "shortest m", "route m", "worst drift m", "beacons"), rows))
    print(f"\n{found}")
    if found.baseline is not None:
        share = found.gain / found.baseline.cost
        print(f"Gained: {found.gain:.2f} ({100 * share:.1f} %), after {found.tried} restarts.")


def design_as_json(found: CoDesign) -> dict[str, Any]:
    """All that was found, with the design it is compared with."""
    routes = [
        {
            "start": list(trip.start),
            "goal": list(trip.goal),
            "weight": trip.weight,
            "length_m": route.length,
            "shortest_length_m": route.shortest_length,
            "worst_drift_m": route.worst_drift,
            "worst_if_dead_m": route.worst_if_dead,
            "beacons": [b.id for b in route.beacons],
            "least_capture_probability": min((c.probability for c in route.captures), default=None),
            "waypoints": route.path.tolist(),
        }
        for trip, route in zip(found.trips, found.routes, strict=True)
    ]
    return {
        **_design(found),
        "routes": routes,
        "baseline": None if found.baseline is None else _design(found.baseline),
        "gain": found.gain if isfinite(found.gain) else None,
        "status": found.status.name.lower(),
        "rounds": found.rounds,
        "restarts": found.tried,
        "seconds": found.seconds,
    }


def _design(design: Design) -> dict[str, Any]:
    return {
        "cost": design.cost,
        "beacon_cost": design.beacon_cost,
        "driving_cost": design.driving_cost,
        "lengths_m": list(design.lengths),
        "beacons": [{"id": b.id, "kind": b.kind.name, "x_m": b.x, "y_m": b.y} for b in design.beacons],
    }


def _talk(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
