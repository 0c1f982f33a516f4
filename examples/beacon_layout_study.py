"""A beacon layout study: how many RFID tags keep twenty routes through a hall under a limit, and what more would buy.

Without arguments it runs with six routes on the warehouse that comes along. It was made for the depot of navigation2
(the map ``depot.yaml`` of nav2_bringup, which is not shipped here):

    python examples/beacon_layout_study.py path/to/depot.yaml --folder depot-study
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from matplotlib.figure import Figure

from driftplan import (
    BeaconKind,
    DriftLimit,
    InfeasibleError,
    OdometryNoise,
    Sites,
    World,
    beacon_tradeoff,
    bundled_map,
    layout_figure,
    load_world,
    place_beacons,
    plan_route,
    plot_tradeoff,
)

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
TAG = BeaconKind.rfid(range_m=1.0, position_std_m=0.1)  # read from a metre, tells the position to 0.1 m
LIMITS_M = (1.0, 0.7, 0.5, 0.4)
STOPS = 4  # per route


def routes_between_random_stops(world: World, number: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Shortest routes from stop to stop; the stops are anywhere in the largest part of the free space."""
    hall = max(getattr(world.free, "geoms", [world.free]), key=lambda part: part.area)
    routes: list[np.ndarray] = []
    while len(routes) < number:
        stops: list[np.ndarray] = []
        while len(stops) < STOPS:
            point = rng.uniform(hall.bounds[:2], hall.bounds[2:])
            if shapely.contains_xy(hall, *point):
                stops.append(point)
        legs = [
            plan_route(world, a, b, NOISE, minimise="length", time_limit=0.2).path[:, :2] for a, b in pairwise(stops)
        ]
        routes.append(np.concatenate([legs[0], *(leg[1:] for leg in legs[1:])]))
    return routes


def main() -> None:
    """Print what each limit takes and what twelve tags can do; draw it if a folder is given."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("map", nargs="?", help="map file (default: the warehouse that comes along)")
    parser.add_argument("--routes", type=int, help="how many (default: 20; on the warehouse 6)")
    parser.add_argument("--seed", type=int, default=0, help="of the stops (default: 0)")
    parser.add_argument("--folder", type=Path, help="where figures go (default: none are drawn)")
    args = parser.parse_args()
    world = load_world(args.map or bundled_map("warehouse"), robot_radius=0.25)
    number = args.routes or (20 if args.map else 6)
    routes = routes_between_random_stops(world, number, np.random.default_rng(args.seed))
    length = sum(shapely.LineString(route).length for route in routes)
    print(f"{args.map or 'the bundled warehouse'}: {len(routes)} routes, {length:.0f} m in all")

    sites = Sites(TAG, spacing_m=1.0)
    layouts = {}
    print(f"\n{'limit on rms':>12} {'tags':>5} {'proven':>7} {'worst rms':>10}   {'with any one dead: tags':>23}")
    for limit in LIMITS_M:
        try:
            layout = place_beacons(world, routes, NOISE, limit, sites)
        except InfeasibleError as err:
            print(f"{limit:10.2f} m  {err}")
            continue
        try:
            sturdy = place_beacons(world, routes, NOISE, DriftLimit(limit, redundancy=2), sites)
            spare = f"{len(sturdy.beacons):18d} ({'proven' if sturdy.proven else f'>= {sturdy.lower_bound:g}'})"
        except InfeasibleError:
            spare = "cannot be done"
        layouts[limit] = layout
        proven = "yes" if layout.proven else "no"
        print(f"{limit:10.2f} m {len(layout.beacons):5d} {proven:>7} {layout.worst_drift:8.3f} m   {spare}")

    curve = beacon_tradeoff(world, routes, NOISE, sites, max_beacons=12, drift_tolerance=0.02, time_limit=20.0)
    print(f"\n{'tags':>4} {'least worst rms':>16}")
    for point in curve:
        print(f"{len(point.beacons):4d} {point.worst_drift:14.2f} m")

    if args.folder is not None:
        args.folder.mkdir(parents=True, exist_ok=True)
        for limit, layout in layouts.items():
            layout_figure(layout).savefig(args.folder / f"tags-for-{limit:g}-m.png")
        figure = Figure(figsize=(7.0, 4.5), layout="constrained", dpi=150)
        plot_tradeoff(curve, ax=figure.subplots())
        figure.savefig(args.folder / "tradeoff.png")
        print(f"\nfigures are in {args.folder}")


if __name__ == "__main__":
    main()
