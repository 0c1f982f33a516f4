"""``driftplan design``: beacons and routes chosen together, for trips that are driven again and again."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from driftplan.report.commands import shared
from driftplan.report.commands.answer import Answer, Progress, talk
from driftplan.report.commands.option import Command, Group, Option, input_file, label
from driftplan.report.records import record, waypoints
from driftplan.tables import counted, numbers, table

if TYPE_CHECKING:
    from driftplan.layouts.co_design.design import CoDesign, Design


def run(args: argparse.Namespace) -> Answer:
    """The design that the arguments ask for."""
    from driftplan import DriftLimit, Sites, co_design, layout_csv, layout_geojson, load_beacons, read_path
    from driftplan.report.figures.layouts import plot_design

    noise, world = shared.noise_from(args), shared.world_from(args)
    trips = shared.trips_from(args, world)
    where, most = label(args.map), f"at most {args.time_limit:g} s"
    talk(f"choosing beacons and routes for {counted(len(trips), 'trip')} on {where}, {most}")
    limit = DriftLimit(args.max_drift, redundancy=args.redundancy, min_capture=args.min_capture)
    sites = Sites(
        shared.kind_from(args, cost=args.beacon_price),
        read_path(args.candidates)[:, :2] if args.candidates else None,
        spacing_m=args.spacing_m,
        existing=load_beacons(args.existing) if args.existing else (),
    )
    named = {name: getattr(args, name) for name in _AS_NAMED}
    named |= {"start_fix": shared.start_fix_from(args), "progress": _tell}
    found = co_design(world, trips, noise, limit, sites, **named)
    return Answer(
        payload=lambda: {"map": where, "noise": noise.given(), "design": design_as_json(found)},
        text=lambda: design_text(found),
        files={
            "csv": lambda: layout_csv(found.layout),
            "geojson": lambda: layout_geojson(found.layout),
            "picture": lambda: plot_design(world, found),
        },
    )


def _tell(seconds: float, cost: float) -> None:
    Progress.news = f"a design of cost {cost:.6g}"


def design_text(found: CoDesign) -> str:
    """The trips one by one, what they cost together, and what was gained."""
    rows = design_as_json(found)["routes"]
    named = {"trip": range(len(rows)), "weight": [f"{row['weight']:g}" for row in rows]}
    driven = {**numbers(rows, 2, "shortest_length_m", "length_m"), **numbers(rows, 3, "worst_drift_m")}
    trips = table({**named, **driven, "beacons": [" ".join(row["beacons"]) for row in rows]})
    gained = ""
    if found.baseline is not None:
        share = found.gain / found.baseline.cost
        gained = f"\nGained: {found.gain:.2f} ({100 * share:.1f} %), after {found.tried} restarts."
    return f"{trips}\n\n{found}{gained}\n{shared.note_of(found.layout)}".rstrip()


def design_as_json(found: CoDesign) -> dict[str, Any]:
    """All that was found, with the design it is compared with."""
    routes = []
    for row, route in zip(found.to_dicts(), found.routes, strict=True):
        least = min((capture.probability for capture in route.captures), default=None)
        told = {**record(route, "worst_guaranteed_m"), "least_capture_probability": least}
        routes.append({**row, **told, "waypoints": waypoints(route.path)})
    return {
        **_costs(found),
        "routes": routes,
        "baseline": None if found.baseline is None else _costs(found.baseline),
        **record(found, "gain", "status", "rounds", "seconds"),
        "estimator": found.layout.scenario.estimator,
        "note": found.layout.note,
        "restarts": found.tried,
    }


def _costs(design: Design) -> dict[str, Any]:
    return {
        **record(design, "cost", "beacon_cost", "driving_cost", "lengths_m"),
        "beacons": [{"id": b.id, "kind": b.kind.name, "x_m": b.x, "y_m": b.y} for b in design.beacons],
    }


_AS_NAMED = ("price_per_m", "max_detour", "estimator", "max_nodes", "rounds", "time_limit", "seed")
# fmt: off
_WANTED = Group("what is wanted", (
    Option("max_drift", "M", "limit on the rms drift anywhere, metres", how={"required": True}),
    Option("beacon_price", "PRICE", "of one beacon, in any unit", default=1.0),
    Option("price_per_m", "PRICE", "of driving one metre once, in the same unit", how={"required": True}),
    Option("redundancy", "", "2: hold with any one beacon dead", int, 1, (1, 2)),
    Option("max_detour", "TIMES", "greatest length of a route, as a multiple of that of the shortest", default=1.5),
    Option("min_capture", "P", "the limit holds without readings less sure than this probability (0: all in range "
           "count)", default=0.9),
    shared.ESTIMATOR,
    *shared.START_SPREAD,
    shared.SNAP,
    Option("max_nodes", "N", "nodes of every roadmap, about", int, 500),
    Option("rounds", "N", "passes over all neighbours of the best design, at most", int, 10),
    Option("time_limit", "S", "seconds to search", default=120.0),
    Option("seed", "N", "seed of samples and restarts", int, 0),
))
_SITES = Group("where beacons may go", (
    Option("candidates", "FILE.csv", "sites x,y in metres, one per line; default: a grid", input_file),
    Option("spacing_m", "M", "spacing of the grid, metres (default: the range)"),
    shared.EXISTING,
))
COMMAND = Command(
    summary="beacons and routes chosen together for trips, at the least cost of both",
    description="Choose beacons and routes together: every trip gets a route on which the drift stays under the "
    "limit, and what beacons and driving cost together is least. Compared with shortest routes for which beacons are "
    "placed afterwards.",
    run=run,
    arguments=(
        shared.MAP,
        Option("trips", "TRIPS.csv", "a line per trip: start_x,start_y,goal_x,goal_y and perhaps weight (how often it "
               "is driven), metres", input_file),
    ),
    groups=(_WANTED, shared.KIND, _SITES, shared.WORLD, *shared.NOISE),
    files={
        "geojson": "write the beacons as GeoJSON points in metres; `driftplan plan --beacons` reads it back",
        "csv": shared.LAYOUT_FILES["csv"],
        "picture": "draw the design and the one it is compared with",
    },
    idle=shared.KIND_IDLE,
    examples=("warehouse trips.csv --max-drift 0.6 --price-per-m 0.5 --beacon-price 100",
              "site.yaml trips.csv --max-drift 1 --price-per-m 1 --geojson tags.geojson --csv installers.csv"),
)
