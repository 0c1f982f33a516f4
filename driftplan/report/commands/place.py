"""``driftplan place``: the fewest beacons that keep the drift of routes under a limit, and files for installers."""

from __future__ import annotations

import argparse
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.report.commands import shared
from driftplan.report.commands.answer import Answer, Progress, talk
from driftplan.report.commands.option import Command, Group, Idle, Option, input_file, label
from driftplan.report.records import record
from driftplan.tables import counted, decimals, numbers, table, yes_no

if TYPE_CHECKING:
    from driftplan import Layout, OdometryNoise, World
    from driftplan.arrays import Floats

_MAX_ROUTES = 50  # more are not listed on the screen; --json has them all


def run(args: argparse.Namespace) -> Answer:
    """The layout, or the trade-off curve, that the arguments ask for."""
    from driftplan import DriftLimit, Sites, beacon_tradeoff, load_beacons, place_beacons, read_path

    noise, world = shared.noise_from(args), shared.world_from(args)
    routes = [read_path(file)[:, :2] for file in args.paths]
    sites = Sites(
        **_points(args, world, routes),
        existing=load_beacons(args.existing, shared.kind_from(args)) if args.existing else (),
        min_spacing_m=args.min_spacing_m,
    )
    limit = DriftLimit(args.max_drift, redundancy=args.redundancy, confidence=args.confidence)
    free = [bool(world.segments_free(route[:-1], route[1:]).all()) for route in routes]
    for file, is_free in zip(args.paths, free, strict=True):
        if not is_free:
            talk(f"{file}: not free of collisions for a robot of radius {world.robot_radius:g} m; taken as it is")
    talk(f"placing beacons for {counted(len(routes), 'route')} on {label(args.map)}, at most {args.time_limit:g} s")
    effort = {"budget": args.budget, "time_limit": args.time_limit, "estimator": args.estimator}
    if args.tradeoff is None:
        asked = {"max_beacons": args.max_beacons, "progress": _tell, **effort}
        return _layout_answer(args, noise, place_beacons(world, routes, noise, limit, sites, **asked), free)
    for name in ("max_drift", "max_beacons", *shared.LAYOUT_FILES):
        if getattr(args, name) is not None:
            raise ValueError(f"expected --tradeoff or --{name.replace('_', '-')}, got both")
    asked = {"max_beacons": args.tradeoff, "redundancy": args.redundancy, "confidence": args.confidence, **effort}
    return _tradeoff_answer(noise, beacon_tradeoff(world, routes, noise, sites, **asked))


def _points(args: argparse.Namespace, world: World, routes: list[Floats]) -> dict[str, Any]:
    """What `Sites` is told about kinds and points."""
    from driftplan import load_beacons, read_path, route_sites, wall_sites

    if args.candidates and (args.sites or args.spacing_m is not None):
        raise ValueError("expected --candidates, or --sites and --spacing-m to generate them, got both")
    if _with_kinds(args):
        return {"points": load_beacons(args.candidates)}
    kind = shared.kind_from(args)
    if args.candidates:
        return {"points": read_path(args.candidates)[:, :2], "kind": kind}
    spacing = kind.range_m if args.spacing_m is None else args.spacing_m
    if args.sites == "walls":
        return {"points": wall_sites(world, spacing), "kind": kind}
    if args.sites == "routes":
        return {"points": route_sites(routes, spacing), "kind": kind}
    return {"spacing_m": spacing, "kind": kind}


def _with_kinds(args: argparse.Namespace) -> bool:
    """Whether the candidates are beacons, with kinds of their own."""
    return bool(args.candidates) and Path(args.candidates).suffix.lower() in (".geojson", ".json")


def _layout_answer(args: argparse.Namespace, noise: OdometryNoise, layout: Layout, free: list[bool]) -> Answer:
    from driftplan import installer_table
    from driftplan.report.figures.layouts import layout_figure

    def payload() -> dict[str, Any]:
        keys = ("file", "length_m", "worst_drift_m", "limit_m", "collision_free")
        lengths_m = [float(drift.length) for drift in layout.drifts]
        columns = (map(label, args.paths), lengths_m, layout.worst_drifts, layout.max_drift, free)
        routes = [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]
        found = {
            "beacons": installer_table(layout),
            "estimator": layout.scenario.estimator,
            "note": layout.note,
            **record(layout, "cost", "lower_bound", "proven", "status", "drift_bound_m", "worst_drift_m", "seconds"),
            "routes": routes,
        }
        return {"noise": noise.given(), "layout": found}

    files = {**shared.layout_files(args, layout), "picture": lambda: layout_figure(layout)}
    return Answer(payload=payload, text=lambda: _layout_text(args, layout), files=files)


def _layout_text(args: argparse.Namespace, layout: Layout) -> str:
    from driftplan import installer_table
    from driftplan.layouts.layout_files import installer_columns

    what = "drift" if args.confidence is None else f"{100 * args.confidence:g} % radius"
    rows, parts = installer_table(layout), []
    if len(args.paths) <= _MAX_ROUTES:
        columns: dict[str, Any] = {"route": range(len(args.paths)), "file": map(label, args.paths)}
        columns["length m"] = decimals([float(drift.length) for drift in layout.drifts], 2)
        parts.append(table(columns | {f"worst {what} m": decimals(layout.worst_drifts, 3)}))
    if rows:
        parts.append(table(installer_columns(rows, what)))
    told = f"{counted(len(layout.beacons), 'new beacon')} of cost {layout.cost:g}; worst {what} "
    told += f"{layout.worst_drift:.3g} m. "
    if rows and rows[0].routes:
        told += f"The failure that hurts most is that of {rows[0].id}: {rows[0].worst_drift_if_dead_m:.3g} m. "
    proof = f"No layout costs less than {layout.lower_bound:g}."
    if layout.drift_bound > 0:
        proof = f"No layout within the budget stays below {layout.drift_bound:.3g} m."
    return "\n\n".join([*parts, f"{told}{layout.status.value} {proof} {shared.note_of(layout)}".rstrip()])


def _tradeoff_answer(noise: OdometryNoise, curve: tuple[Layout, ...]) -> Answer:
    from driftplan.report.figures.layouts import tradeoff_figure

    drifts = [record(layout, "worst_drift_m", "drift_bound_m", "proven") for layout in curve]
    ids = [[beacon.id for beacon in layout.beacons] for layout in curve]
    points = [{"beacons": len(some), **drift, "ids": some} for drift, some in zip(drifts, ids, strict=True)]

    def text() -> str:
        drifts = numbers(points, 3, "worst_drift_m", "drift_bound_m")
        proven = yes_no(point["proven"] for point in points)
        return table({"beacons": [point["beacons"] for point in points], **drifts, "proven": proven})

    return Answer(
        payload=lambda: {"noise": noise.given(), "tradeoff": points},
        text=text,
        files={"picture": lambda: tradeoff_figure(curve)},
    )


def _tell(seconds: float, cost: float, bound: float) -> None:
    best = f"cost {cost:g}" if isfinite(cost) else "no layout yet"
    Progress.news = f"{best}, at least {bound:g} needed"


# fmt: off
_WANTED = Group("what is wanted", (
    Option("max_drift", "M", "limit on the rms drift, metres"),
    Option("confidence", "P", "the limit is on the radius that holds the estimate with this probability (0.75 to "
           "1), instead of the rms"),
    Option("redundancy", "K", "hold with any K-1 beacons dead", int, 1),
    shared.ESTIMATOR,
    Option("max_beacons", "N", "at most so many new beacons", int),
    Option("budget", "COST", "new beacons cost at most this"),
    Option("tradeoff", "N", "instead of one layout: the least worst drift for every number of beacons up to N", int),
    Option("time_limit", "S", "seconds to search", default=60.0),
))
_SITES = Group("where beacons may go", (
    Option("candidates", "FILE", "sites: x,y in metres, one per line (.csv), or beacons with their kinds "
           "(.geojson); default: a grid", input_file),
    Option("sites", "", "sites to generate instead of --candidates (default: grid)", str,
           choices=("grid", "walls", "routes")),
    Option("spacing_m", "M", "spacing of generated sites, metres (default: the range)"),
    Option("min_spacing_m", "M", "least distance between beacons, metres", default=0.0),
    shared.EXISTING,
    shared.TAG_SIZE,
))
COMMAND = Command(
    summary="the fewest beacons that keep the drift of routes under a limit",
    description="Place beacons so that the drift stays under a limit everywhere on every route: the fewest, or the "
    "cheapest, with a proof. With --max-beacons or --budget and no --max-drift: the least worst drift within them.",
    run=run,
    arguments=(shared.MAP, shared.PATHS),
    groups=(_WANTED, shared.KIND, _SITES, shared.WORLD, *shared.NOISE),
    files={
        **shared.LAYOUT_FILES,
        "picture": "draw the layout on the map, drift against distance and what each failure does (or the trade-off)",
    },
    idle=(
        *shared.KIND_IDLE,
        Idle(("tag_size_m",), lambda args: args.tags is None, "no --tags are written"),
        Idle(tuple(option.name for option in shared.KIND.options), _with_kinds,
             "the beacons of --candidates have kinds of their own"),
    ),
    examples=("warehouse route.csv --max-drift 0.6 --geojson tags.geojson --picture tags.svg",
              "warehouse route.csv --kind landmark --range-m 4 --tradeoff 6"),
)
