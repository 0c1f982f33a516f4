"""Options of ``driftplan plan`` that are about beacons and limits, and the route they ask for."""

from __future__ import annotations

import argparse
from math import radians
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from driftplan.model.noise import OdometryNoise
    from driftplan.model.readings import Fix
    from driftplan.planning.itinerary.itinerary import Itinerary
    from driftplan.planning.routes import Route
    from driftplan.world.world import World


def add_itinerary_options(parser: argparse.ArgumentParser) -> None:
    """Beacons to use, and the limit to keep; the objective, the detour and the rest are `add_planning_options`'s."""
    group = parser.add_argument_group("beacons on the way")
    group.add_argument(
        "--beacons",
        metavar="FILE",
        help="beacons to use, as GeoJSON (written by `driftplan place --geojson`); "
        "routes are then at most 1.5 times as long as the shortest, unless --max-detour or --minimise length says "
        "otherwise",
    )
    group.add_argument(
        "--max-drift", type=float, metavar="M", help="greatest rms drift anywhere on the way, metres (default: any)"
    )
    group.add_argument(
        "--redundancy",
        type=int,
        choices=(1, 2),
        help="2: the limit holds with any one beacon dead (default: 1, all are alive)",
    )
    group.add_argument(
        "--min-capture",
        type=float,
        metavar="P",
        help="passes of beacons that the drifting robot makes with less than this probability (a ratio) do not count "
        "(default: 0.9)",
    )
    add_start_options(group)


def add_start_options(parser: argparse._ActionsContainer) -> None:
    """How well the start is known; `start_fix_from` makes a fix of it."""
    parser.add_argument(
        "--start-position-std-m",
        type=float,
        metavar="M",
        help="uncertainty of the position at the start, per axis, metres (default: 0, it is known)",
    )
    parser.add_argument(
        "--start-heading-std-deg",
        type=float,
        metavar="DEG",
        help="uncertainty of the heading at the start, degrees (default: 0, it is known)",
    )


def start_fix_from(args: argparse.Namespace) -> Fix | None:
    """The uncertainty at the start that the options describe; None where it is known."""
    from driftplan.model.readings import Fix

    if args.start_position_std_m is None and args.start_heading_std_deg is None:
        return None
    position, heading = args.start_position_std_m or 0.0, args.start_heading_std_deg or 0.0
    return Fix.full(0.0, position_std_m=position, heading_std=radians(heading))


def planned_route(
    args: argparse.Namespace, world: World, noise: OdometryNoise, *, start_heading: float | None = None
) -> Route:
    """The route that the options ask for: an `Itinerary` when beacons or a limit are among them."""
    from driftplan.layouts.layout_files import load_beacons
    from driftplan.planning.plan import plan_route

    beacons = load_beacons(args.beacons) if args.beacons else ()
    options: dict[str, Any] = {
        name: value
        for name, value in (
            ("redundancy", args.redundancy),
            ("min_capture", args.min_capture),
            ("initial", start_fix_from(args)),
        )
        if value is not None
    }
    return plan_route(
        world,
        args.start,
        args.goal,
        noise,
        beacons=beacons,
        minimise=args.minimise,
        max_drift=args.max_drift,
        max_detour=args.max_detour,
        planner=args.planner,
        start_heading=start_heading,
        time_limit=args.time_limit,
        iterations=args.iterations,
        seed=args.seed,
        **options,
    )


def itinerary_as_json(route: Itinerary) -> dict[str, Any]:
    """What an itinerary says beyond a route."""
    return {
        "max_drift_m": route.max_drift,
        "worst_drift_m": route.worst_drift,
        "worst_if_dead_m": route.worst_if_dead,
        "shortest_length_m": route.shortest_length,
        "passes": [
            {
                "beacon": capture.beacon.id,
                "x": capture.beacon.x,
                "y": capture.beacon.y,
                "kind": capture.beacon.kind.name,
                "enter_m": capture.enter_m,
                "leave_m": capture.leave_m,
                "probability": capture.probability,
                "counted_on": any(capture.beacon is beacon for beacon in route.beacons),
            }
            for capture in route.captures
        ],
    }


def itinerary_text(route: Itinerary) -> str:
    """The same for people: the worst drift, what it is held against, and a line per pass."""
    from driftplan.report.cli_output import table

    limit = "" if route.max_drift is None else f" (limit {route.max_drift:g} m)"
    lines = [f"worst drift on the way: {route.worst_drift:.3f} m{limit}"]
    if route.worst_if_dead > route.worst_drift:
        lines.append(f"with any one beacon dead: {route.worst_if_dead:.3f} m")
    lines.append(f"length: {route.length:.2f} m; the shortest route has {route.shortest_length:.2f} m")
    if route.captures:
        rows = [
            [
                row["beacon"] or f"({row['x']:g}, {row['y']:g})",
                row["kind"],
                f"{row['enter_m']:.2f}",
                f"{row['leave_m']:.2f}",
                f"{row['probability']:.2f}",
                "yes" if row["counted_on"] else "no",
            ]
            for row in itinerary_as_json(route)["passes"]
        ]
        lines += ["", table(("beacon", "kind", "enter m", "leave m", "captured", "counted on"), rows)]
    return "\n".join(lines)
