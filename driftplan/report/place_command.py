"""``driftplan place``: the fewest beacons that keep the drift of routes under a limit, and files for installers."""

from __future__ import annotations

import argparse
import sys
from math import isfinite, radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.files import write_files
from driftplan.report import cli_output as output
from driftplan.report.cli_options import add_noise_options, add_world_options, noise_as_json, noise_from, output_type
from driftplan.report.cli_options import world_from as world_of

if TYPE_CHECKING:
    from driftplan.arrays import Floats
    from driftplan.beacons.beacon import BeaconKind
    from driftplan.layouts.layout import Layout
    from driftplan.world.world import World

_TALK_EVERY_S = 1.0
_MOST_ROUTES = 50  # more are not listed on the screen; --json has them all
_MOST_NUMBERS = 6  # of routes that a beacon serves, on the screen


def add_parser(subparsers: Any) -> argparse.ArgumentParser:
    """Add the subcommand; `place` carries it out."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "place",
        help="the fewest beacons that keep the drift of routes under a limit",
        description="Place beacons so that the drift stays under a limit everywhere on every route: the fewest, or the "
        "cheapest, with a proof. With --max-beacons or --budget and no --max-drift: the least worst drift within them.",
    )
    parser.add_argument("map", metavar="MAP", help="map file, or the name of a map that comes along")
    parser.add_argument("paths", nargs="+", metavar="PATH.csv", help="routes: waypoints x,y in metres, one per line")
    wanted = parser.add_argument_group("what is wanted")
    wanted.add_argument("--max-drift", type=float, metavar="M", help="limit on the rms drift, metres")
    wanted.add_argument(
        "--confidence",
        type=float,
        metavar="P",
        help="the limit is on the radius that holds the estimate with this probability (0.75 to 1), instead of the rms",
    )
    wanted.add_argument(
        "--redundancy", type=int, default=1, metavar="K", help="hold with any K-1 beacons dead (default: 1)"
    )
    wanted.add_argument("--max-beacons", type=int, metavar="N", help="at most so many new beacons")
    wanted.add_argument("--budget", type=float, metavar="COST", help="new beacons cost at most this")
    wanted.add_argument(
        "--tradeoff",
        type=int,
        metavar="N",
        help="instead of one layout: the least worst drift for every number of beacons up to N",
    )
    wanted.add_argument("--time-limit", type=float, default=60.0, metavar="S", help="seconds to search (default: 60)")
    add_kind_options(parser)
    sites = parser.add_argument_group("where beacons may go")
    sites.add_argument(
        "--candidates",
        metavar="FILE",
        help="sites: x,y in metres, one per line (.csv), or beacons with their kinds (.geojson); default: a grid",
    )
    sites.add_argument(
        "--sites", choices=("grid", "walls", "routes"), help="sites to generate instead of --candidates (default: grid)"
    )
    sites.add_argument(
        "--spacing-m", type=float, metavar="M", help="spacing of generated sites, metres (default: the range)"
    )
    sites.add_argument(
        "--min-spacing-m", type=float, default=0.0, metavar="M", help="least distance between beacons, metres"
    )
    sites.add_argument("--existing", metavar="FILE.geojson", help="beacons that are there already")
    add_world_options(parser)
    add_noise_options(parser)
    files = parser.add_argument_group("files")
    for kind, said in (
        ("csv", "write the installers' table: id, place, nearest wall, routes, which failure hurts most"),
        ("geojson", "write the beacons as GeoJSON points in metres, to be read back with --existing"),
        ("png", "draw the layout on the map, drift against distance and what each failure does (or the trade-off)"),
    ):
        files.add_argument(f"--{kind}", type=output_type(kind), metavar="FILE", help=said)
    parser.add_argument("--json", action="store_true", help="print JSON, every key with its unit")
    return parser


def place(args: argparse.Namespace) -> None:
    """The layout, or the trade-off curve, that the arguments ask for."""
    from driftplan.layouts.layout_files import load_beacons
    from driftplan.layouts.place import beacon_tradeoff, place_beacons
    from driftplan.layouts.scenario import DriftLimit
    from driftplan.layouts.sites import Sites
    from driftplan.world.trajectories import read_path

    noise, world = noise_from(args), world_of(args)
    routes = [read_path(file)[:, :2] for file in args.paths]
    sites = Sites(
        **_points(args, world, routes),
        existing=load_beacons(args.existing) if args.existing else (),
        min_spacing_m=args.min_spacing_m,
    )
    limit = DriftLimit(args.max_drift, redundancy=args.redundancy, confidence=args.confidence)
    free = [bool(world.segments_free(route[:-1], route[1:]).all()) for route in routes]
    for file, is_free in zip(args.paths, free, strict=True):
        if not is_free:
            _talk(f"{file}: not free of collisions for a robot of radius {world.robot_radius:g} m; taken as it is")
    count = f"{len(routes)} route{'' if len(routes) == 1 else 's'}"
    _talk(f"placing beacons for {count} on {args.map}, at most {args.time_limit:g} s")
    if args.tradeoff is None:
        layout = place_beacons(
            world,
            routes,
            noise,
            limit,
            sites,
            max_beacons=args.max_beacons,
            budget=args.budget,
            time_limit=args.time_limit,
            progress=_Talker(),
        )
        _tell_layout(args, layout, free)
        return
    for name in ("max_drift", "max_beacons", "csv", "geojson"):
        if getattr(args, name) is not None:
            raise ValueError(f"expected --tradeoff or --{name.replace('_', '-')}, got both")
    curve = beacon_tradeoff(
        world,
        routes,
        noise,
        sites,
        max_beacons=args.tradeoff,
        budget=args.budget,
        redundancy=args.redundancy,
        confidence=args.confidence,
        time_limit=args.time_limit,
    )
    _tell_curve(args, curve)


def add_kind_options(parser: argparse.ArgumentParser) -> None:
    """What beacons may be placed; `kind_from` makes it."""
    kind = parser.add_argument_group("the beacons")
    kind.add_argument(
        "--kind",
        choices=("rfid", "landmark", "heading"),
        default="rfid",
        help="what they measure: position, position and heading, or heading (default: rfid)",
    )
    kind.add_argument("--range-m", type=float, default=1.5, metavar="M", help="range, metres (default: 1.5)")
    kind.add_argument(
        "--position-std-m",
        type=float,
        default=0.1,
        metavar="M",
        help="accuracy of a position per axis, metres (default: 0.1)",
    )
    kind.add_argument(
        "--heading-std-deg", type=float, default=1.0, metavar="DEG", help="accuracy of a heading, degrees (default: 1)"
    )
    kind.add_argument(
        "--detection-probability",
        type=float,
        default=1.0,
        metavar="P",
        help="probability that a pass is noticed (default: 1)",
    )
    kind.add_argument("--through-walls", action="store_true", help="landmarks are seen through walls")


def kind_from(args: argparse.Namespace) -> BeaconKind:
    """The kind of beacon that the options describe."""
    from driftplan.beacons.beacon import BeaconKind

    common: dict[str, Any] = {"detection_probability": args.detection_probability}
    if args.kind == "rfid":
        return BeaconKind.rfid(args.range_m, args.position_std_m, **common)
    heading_std = radians(args.heading_std_deg)
    if args.kind == "heading":
        return BeaconKind.heading(args.range_m, heading_std, **common)
    return BeaconKind.landmark(
        args.range_m, args.position_std_m, heading_std, line_of_sight=not args.through_walls, **common
    )


def _points(args: argparse.Namespace, world: World, routes: list[Floats]) -> dict[str, Any]:
    """What `Sites` is told about kinds and points."""
    from driftplan.layouts.layout_files import load_beacons
    from driftplan.layouts.site_grids import route_sites, wall_sites
    from driftplan.world.trajectories import read_path

    if args.candidates:
        if args.sites or args.spacing_m is not None:
            raise ValueError("expected --candidates, or --sites and --spacing-m to generate them, got both")
        if Path(args.candidates).suffix.lower() in (".geojson", ".json"):
            return {"points": load_beacons(args.candidates)}
        return {"points": read_path(args.candidates)[:, :2], "kind": kind_from(args)}
    spacing = args.range_m if args.spacing_m is None else args.spacing_m
    if args.sites == "walls":
        return {"points": wall_sites(world, spacing), "kind": kind_from(args)}
    if args.sites == "routes":
        return {"points": route_sites(routes, spacing), "kind": kind_from(args)}
    return {"spacing_m": spacing, "kind": kind_from(args)}


def _tell_layout(args: argparse.Namespace, layout: Layout, free: list[bool]) -> None:
    from driftplan.layouts.layout_files import installer_table, layout_csv, layout_geojson
    from driftplan.report.plot_beacons import layout_figure

    files: dict[Path, bytes] = {}
    if args.csv:
        files[args.csv] = layout_csv(layout)
    if args.geojson:
        files[args.geojson] = layout_geojson(layout)
    if args.png:
        files[args.png] = output.figure_png(layout_figure(layout))
    write_files(files)
    rows = installer_table(layout)
    routes = [
        {
            "file": file,
            "length_m": float(drift.length),
            "worst_drift_m": worst,
            "limit_m": limit,
            "collision_free": is_free,
        }
        for file, drift, worst, limit, is_free in zip(
            args.paths, layout.drifts, layout.worst_drifts, layout.max_drift, free, strict=True
        )
    ]
    if args.json:
        said = {
            "beacons": [row._asdict() for row in rows],
            "cost": layout.cost,
            "lower_bound": layout.lower_bound,
            "proven": layout.proven,
            "status": layout.status.name.lower(),
            "drift_bound_m": layout.drift_bound,
            "worst_drift_m": layout.worst_drift,
            "seconds": layout.seconds,
            "routes": routes,
        }
        _print_json(args, noise=noise_as_json(noise_from(args)), layout=said)
        return
    what = "drift" if args.confidence is None else f"{100 * args.confidence:g} % radius"
    if len(routes) <= _MOST_ROUTES:
        lines = [
            [str(r), route["file"], *(f"{route[key]:.{d}f}" for key, d in (("length_m", 2), ("worst_drift_m", 3)))]
            for r, route in enumerate(routes)
        ]
        print(output.table(("route", "file", "length m", f"worst {what} m"), lines), end="\n\n")
    shown = [
        [
            row.id,
            row.kind if row.new else f"{row.kind} (existing)",
            f"{row.x_m:.2f}",
            f"{row.y_m:.2f}",
            _metres(row.nearest_wall_m),
            _numbers(row.routes),
            _metres(row.worst_drift_if_dead_m, 3),
            "-" if row.worst_route_if_dead < 0 else str(row.worst_route_if_dead),
        ]
        for row in rows
    ]
    header = ("id", "kind", "x m", "y m", "nearest wall m", "routes served", f"{what} if dead m", "on route")
    if shown:
        print(output.table(header, shown), end="\n\n")
    new = len(layout.beacons)
    hurts = ""
    if rows and rows[0].routes:
        hurts = f"The failure that hurts most is that of {rows[0].id}: {rows[0].worst_drift_if_dead_m:.3g} m. "
    print(
        f"{new} new beacon{'' if new == 1 else 's'} of cost {layout.cost:g}; worst {what} {layout.worst_drift:.3g} m. "
        f"{hurts}{_proof(layout)}"
    )


def _numbers(routes: tuple[int, ...]) -> str:
    """Numbers of routes, the first few of many."""
    text = ", ".join(map(str, routes[:_MOST_NUMBERS]))
    return f"{text}, … ({len(routes)})" if len(routes) > _MOST_NUMBERS else text or "-"


def _proof(layout: Layout) -> str:
    if layout.drift_bound > 0:
        return f"{layout.status.value} No layout within the budget stays below {layout.drift_bound:.3g} m."
    return f"{layout.status.value} No layout costs less than {layout.lower_bound:g}."


def _tell_curve(args: argparse.Namespace, curve: tuple[Layout, ...]) -> None:
    from matplotlib.figure import Figure

    from driftplan.report.plot_beacons import plot_tradeoff

    if args.png:
        figure = Figure(figsize=(7.0, 4.5), layout="constrained", dpi=150)
        plot_tradeoff(curve, ax=figure.subplots())
        write_files({args.png: output.figure_png(figure)})
    if args.json:
        points = [
            {
                "beacons": len(x.beacons),
                "worst_drift_m": x.worst_drift,
                "drift_bound_m": x.drift_bound,
                "proven": x.proven,
                "ids": [b.id for b in x.beacons],
            }
            for x in curve
        ]
        _print_json(args, noise=noise_as_json(noise_from(args)), tradeoff=points)
        return
    rows = [
        [str(len(x.beacons)), f"{x.worst_drift:.3f}", f"{x.drift_bound:.3f}", "yes" if x.proven else "no"]
        for x in curve
    ]
    print(output.table(("beacons", "worst drift m", "not below m", "proven"), rows))


class _Talker:
    """Progress on stderr, not more often than a person can read."""

    def __init__(self) -> None:
        self.last = 0.0

    def __call__(self, seconds: float, cost: float, bound: float) -> None:
        if seconds - self.last >= _TALK_EVERY_S:
            self.last = seconds
            best = f"cost {cost:g}" if isfinite(cost) else "no layout yet"
            _talk(f"{seconds:.0f} s: {best}, at least {bound:g} needed")


def _metres(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if isfinite(value) else "-"


def _print_json(args: argparse.Namespace, **answer: Any) -> None:
    print(output.json_text({"command": args.command, **answer}))


def _talk(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
