"""Options that several subcommands share, and the objects that they stand for."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from math import hypot, isfinite, radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.errors import DriftplanError, GoalError, StartError
from driftplan.report.commands.answer import talk
from driftplan.report.commands.option import Group, Idle, Option, geojson_file, input_file, point
from driftplan.tables import counted

if TYPE_CHECKING:
    from driftplan import BeaconKind, Drift, Fix, Layout, OdometryNoise, Trip, World

PLANNERS = ("roadmap", "rrtstar", "informed_rrtstar", "sorrtstar", "bitstar")  # here too, so that --help loads none
DEFAULT_PLANNER = "roadmap"

# fmt: off
MAP = Option("map", "MAP", "map file, or the name of a map that comes along; - is GeoJSON on standard input",
             geojson_file)
WORLD = Group("map and robot", (
    Option("robot_radius", "M", "radius of the robot, metres", default=0.3),
    Option("unknown_is_free", "", "take unknown cells of a ROS map for free (default: they are obstacles)"),
    Option("cell_size_m", "M", "cell size of a MovingAI map, metres (default: 1)"),
    Option("level", "NAME", "level of an Open-RMF building or IMDF venue that has several", str),
    Option("origin", "LON,LAT", "where x = y = 0 is, degrees, for GeoJSON and IMDF maps in degrees", point),
    Option("coarsen", "N", "take N x N cells of a large map for one, an obstacle if one of them is", int),
    Option("despeckle_m", "M", "drop groups of occupied cells no larger than this, metres"),
    Option("keepout", "FILE.yaml", "keepout mask of nav2's: what it marks is an obstacle too", str),
    Option("zones", "FILE", "floors with odometry of their own: .geojson, or a .yaml that says what the greys of a "
           "picture mean", str),
))
DEFAULT_SPREAD = {"heading_deg": 1.0, "distance_m": 0.05, "after_m": 10.0, "heading_deg_per_full_turn": 0.0}
_SPREADS = tuple(
    Option(name, unit, f"{help_text} (default: {DEFAULT_SPREAD[name]:g})")
    for name, unit, help_text in (
        ("heading_deg", "DEG", "standard deviation of the heading error after --after-m metres, degrees"),
        ("distance_m", "M", "standard deviation of the distance error after --after-m metres, metres"),
        ("after_m", "M", "length of the drives that --heading-deg and --distance-m are about, metres"),
        ("heading_deg_per_full_turn", "DEG", "standard deviation of the heading error after one full turn, degrees"),
    )
)
_RATES = (
    Option("heading_var_per_m", "RAD2/M", "heading variance per metre, rad^2/m"),
    Option("distance_var_per_m", "M2/M", "variance of the distance per metre, m^2/m"),
    Option("lateral_var_per_m", "M2/M", "variance across the direction of travel per metre, m^2/m"),
    Option("heading_var_per_rad", "RAD2/RAD", "heading variance per radian turned, rad^2/rad"),
    Option("distance_var_per_rad", "M2/RAD", "variance of the distance per radian turned, m^2/rad"),
    Option("heading_var_per_step", "RAD2", "heading variance per step, rad^2 (needs --step-m)"),
    Option("distance_var_per_step", "M2", "variance of the distance per step, m^2 (needs --step-m)"),
    Option("lateral_var_per_step", "M2", "variance across the direction of travel per step, m^2 (needs --step-m)"),
    Option("step_m", "M", "length of a step, metres (default: errors are continuous along the path)"),
)
_SYSTEMATIC = (
    Option("heading_bias_per_m", "RAD/M", "systematic heading error per metre, rad/m"),
    Option("heading_bias_per_rad", "RATIO", "systematic relative error of measured turns"),
    Option("distance_scale_error", "RATIO", "systematic relative error of measured distances"),
)
_KEPT = Option("noise", "FILE", "from a file, such as driftplan fit --yaml writes, or the preset of this name",
               input_file)
NOISE = (
    Group("odometry noise", (_KEPT,), "Or as spreads of straight drives (--heading-deg, --distance-m, --after-m, "
          "--heading-deg-per-full-turn), or as rates: see --help-noise. Without any of these: 1 degree and 0.05 m "
          "after 10 m of straight driving, and none for turns."),
    Group("odometry noise, as measured over straight drives (the default)", _SPREADS, folded=True),
    Group("odometry noise, as rates (instead of spreads; those that are not given are 0, like systematic errors)",
          (*_RATES, *_SYSTEMATIC), folded=True),
)
ESTIMATOR = Option("estimator", "", "what the robot does with a reading: it replaces what is measured, or it is fused "
                   "in a Kalman filter", str, "reset", ("reset", "filter"))
START_HEADING = Option("start_heading_deg", "DEG", "heading at the start, degrees from +x to the left; then the "
                       "first turn counts too (default: the robot already faces its first leg)")
START_SPREAD = (
    Option("start_position_std_m", "M", "uncertainty of the position at the start, per axis, metres (default: 0, it "
           "is known)"),
    Option("start_heading_std_deg", "DEG", "uncertainty of the heading at the start, degrees (default: 0, it is "
           "known)"),
)
SEARCH = (
    Option("planner", "NAME", ", ".join(PLANNERS), str, DEFAULT_PLANNER),
    Option("time_limit", "S", "planning time per route, seconds (default: until it is done, at most 5; none with "
           "--iterations)"),
    Option("iterations", "N", "end after N batches of the roadmap, or iterations of another planner: the same seed "
           "then gives the same route (default: the time decides)", int),
    Option("seed", "N", "seed of the planner's samples", int, 0),
)
_MEASURED = {
    "rfid": ("position_std_m",),
    "landmark": ("position_std_m", "heading_std_deg"),
    "heading": ("heading_std_deg",),
    "range_only": ("range_std_m",),
    "bearing": ("bearing_std_deg",),
}
_SEEN, _FAR = ("landmark", "bearing"), ("range_only", "bearing")
KIND = Group("the beacons", (
    Option("kind", "", "what they measure: rfid the position, landmark position and heading, heading that alone; "
           "range_only (UWB) the distance and bearing the direction to them, for a robot with --estimator filter", str,
           "rfid", tuple(_MEASURED)),
    Option("range_m", "M", "range, metres (default: 1.5; of range_only and bearing 10)"),
    Option("position_std_m", "M", "accuracy of a position per axis, metres", default=0.1),
    Option("heading_std_deg", "DEG", "accuracy of a heading, degrees", default=1.0),
    Option("range_std_m", "M", "accuracy of a distance, metres", default=0.1),
    Option("bearing_std_deg", "DEG", "accuracy of a direction, degrees", default=1.0),
    Option("std_per_m", "M/M", "what the accuracy of a position or distance worsens by per metre of distance",
           default=0.0),
    Option("view_angle_deg", "DEG", "they are seen from within so many degrees only, and face one of four ways",
           default=360.0),
    Option("sensor_view_deg", "DEG", "field of view, ahead, of the sensor that reads them, degrees", default=360.0),
    Option("detection_probability", "P", "probability that a pass is noticed", default=1.0),
    Option("through_walls", "", "landmarks and bearings are seen through walls"),
))


def _is_of(kind: str, args: argparse.Namespace) -> bool:
    return bool(args.kind == kind)


KIND_IDLE = (
    *(
        Idle(tuple({std for stds in _MEASURED.values() for std in stds} - set(measured)), partial(_is_of, kind),
             "that is not what beacons of this --kind measure")
        for kind, measured in _MEASURED.items()
    ),
    Idle(("std_per_m",), lambda args: args.kind in ("heading", "bearing"), "it is about positions and distances"),
    Idle(("through_walls",), lambda args: args.kind not in _SEEN, "only landmarks and bearings are seen"),
)
PATHS = Option("paths", "PATH.csv", "routes: waypoints x,y in metres, one per line; - is standard input", input_file,
               how={"nargs": "+"})
ENDS = tuple(Option(name, "X,Y", f"{name} of the route, metres", point) for name in ("start", "goal"))
SNAP = Option("snap", "", "move a start or goal in a wall or off the map to the nearest free point, and say so")
EXISTING = Option("existing", "FILE.geojson", "beacons that are there already", geojson_file)
ROUTE_FILES = {
    "csv": "write the waypoints x,y as CSV, metres; `driftplan predict` and `compare` read it back",
    "ros_path": "write a nav_msgs/Path as YAML, with a pose every 0.25 m",
    "poses": "write these poses as CSV, each with the covariance of the estimate there",
    "ros_poses": "write them as YAML, geometry_msgs/PoseWithCovarianceStamped each",
    "waypoints": "write the corners as YAML, the goal of nav2's FollowWaypoints",
}
TAG_SIZE = Option("tag_size_m", "M", "width of a tag, metres, for --tags", default=0.16)
LAYOUT_FILES = {
    "csv": "write the installers' table: id, place, nearest wall, routes, which failure hurts most",
    "table": "write the installers' table as a page of HTML",
    "pdf": "write the installers' sheet, one page A3: plan to scale, ids, places, nearest walls, directions",
    "geojson": "write the beacons as GeoJSON points in metres, to be read back with --existing",
    "tags": "write the beacons as tags.yaml of apriltag_ros, a bundle in the frame of the map",
    "fiducials": "write the beacons as map.txt of fiducial_slam",
    "transforms": "write a shell script that publishes the beacons as static transforms",
    "dxf": "write a DXF drawing for installers: walls, routes, beacons with ids, ranges and distances to walls",
    "lif": "write a layout in LIF for fleets: routes as nodes and edges, beacons as stations",
    "building": "write the Open-RMF building that MAP is, with the beacons as vertices",
}
# fmt: on


def noise_from(args: argparse.Namespace) -> OdometryNoise:
    """The noise that the options describe: spreads, rates, or a file or preset; systematic errors go with each."""
    from driftplan import PRESETS, OdometryNoise, load_noise

    spread, rates, systematic, kept = (_given(args, table) for table in (_SPREADS, _RATES, _SYSTEMATIC, (_KEPT,)))
    ways = [f"--{next(iter(way)).replace('_', '-')}" for way in (spread, rates, kept) if way]
    if len(ways) > 1:
        raise ValueError(f"expected the noise as spreads, as rates or from a file, got {' and '.join(ways)}")
    if rates.keys() == {"step_m"}:  # without a variance the odometry would silently be perfect
        raise ValueError("expected --step-m together with a variance, such as --heading-var-per-step, got it alone")
    if not kept:
        noise = OdometryNoise(**rates) if rates else OdometryNoise.from_std(**{**DEFAULT_SPREAD, **spread})
    elif args.noise in PRESETS:
        noise = PRESETS[args.noise].noise
    elif Path(args.noise).exists():
        noise = load_noise(args.noise)
    else:
        raise ValueError(f"expected --noise a noise file or a preset, one of {', '.join(PRESETS)}; got {args.noise!r}")
    return replace(noise, **systematic)


def world_from(args: argparse.Namespace) -> World:
    """The world of ``args.map``: a file, or the name of a map that comes with driftplan."""
    from driftplan import bundled_map, bundled_maps, load_world

    if args.map in bundled_maps():
        path = bundled_map(args.map)
    elif Path(args.map).suffix:
        path = Path(args.map)
    else:
        raise ValueError(f"expected a map file or one of {', '.join(bundled_maps())}, got {args.map!r}")
    world = load_world(path, **{option.name: getattr(args, option.name) for option in WORLD.options})
    for note in world.notes:
        talk(note)
    return world


def ends_from(args: argparse.Namespace, world: World) -> tuple[tuple[float, ...], tuple[float, float]]:
    """Start, with its heading where that is given, and goal, moved to the nearest free points with ``--snap``."""
    heading = start_heading_from(args)
    start = _end(args, world, "start", args.start, StartError)
    return start if heading is None else (*start, heading), _end(args, world, "goal", args.goal, GoalError)


def trips_from(args: argparse.Namespace, world: World) -> tuple[Trip, ...]:
    """The trips of a file, with ends moved to the nearest free points with ``--snap``."""
    from driftplan import load_trips

    trips = []
    for k, trip in enumerate(load_trips(args.trips)):
        start = _end(args, world, f"trip {k}: start", trip.start, StartError)
        trips.append(replace(trip, start=start, goal=_end(args, world, f"trip {k}: goal", trip.goal, GoalError)))
    return tuple(trips)


def _end(
    args: argparse.Namespace, world: World, name: str, point: tuple[float, float], error: type[DriftplanError]
) -> tuple[float, float]:
    import numpy as np

    from driftplan.planning.request import blocked_end, format_point

    if not (isfinite(point[0]) and isfinite(point[1])) or world.is_free(point):
        return point  # what is not finite is the planner's to refuse
    wrong, nearest = blocked_end(world, name, np.array(point))
    x, y = nearest.tolist()
    if args.snap:
        talk(f"{wrong}: moved {hypot(x - point[0], y - point[1]):.3g} m to {format_point(nearest)}")
        return x, y
    robot = f"a robot of radius {world.robot_radius:g} m"
    raise error(f"{wrong}; the nearest free point is {format_point(nearest)}: --snap takes that, for {robot}")


def layout_files(args: argparse.Namespace, layout: Layout) -> dict[str | Path, Callable[[], Any]]:
    """What `LAYOUT_FILES` names."""
    import driftplan
    from driftplan.report.figures.sheet import layout_pdf

    def building() -> bytes:
        if not args.map.lower().endswith(".building.yaml"):
            raise ValueError(f"--building writes the building of an Open-RMF map back, and MAP is {args.map}")
        return driftplan.layout_building(layout, args.map, level=args.level)

    of_layout = {"csv": driftplan.layout_csv, "table": driftplan.layout_html, "pdf": layout_pdf}
    of_layout |= {"geojson": driftplan.layout_geojson, "dxf": driftplan.layout_dxf, "lif": driftplan.layout_lif}
    of_beacons = {"fiducials": driftplan.fiducial_map, "transforms": driftplan.static_transforms}
    return {
        **{name: partial(write, layout) for name, write in of_layout.items()},
        **{name: partial(write, layout.everyone) for name, write in of_beacons.items()},
        "tags": lambda: driftplan.tags_yaml(layout.everyone, size_m=args.tag_size_m),
        "building": building,
    }


def route_files(drift: Drift) -> dict[str | Path, Callable[[], Any]]:
    """What `ROUTE_FILES` names."""
    from driftplan.report.records import path_csv
    from driftplan.world.route_files import poses_csv, poses_yaml, ros_path_yaml, waypoints_yaml

    written = {"csv": path_csv, "poses": poses_csv, "ros_poses": poses_yaml}
    written |= {"ros_path": ros_path_yaml, "waypoints": waypoints_yaml}
    return {name: partial(write, drift) for name, write in written.items()}


def start_heading_from(args: argparse.Namespace) -> float | None:
    """Radians, or None where the robot already faces its first leg."""
    return None if args.start_heading_deg is None else radians(args.start_heading_deg)


def start_fix_from(args: argparse.Namespace) -> Fix | None:
    """The uncertainty at the start that the options describe; None where it is known."""
    from driftplan import Fix

    position, heading = args.start_position_std_m, args.start_heading_std_deg
    if position is None and heading is None:
        return None
    return Fix.full(0.0, position_std_m=position or 0.0, heading_std=radians(heading or 0.0))


def kind_from(args: argparse.Namespace, **common: Any) -> BeaconKind:
    """The kind of beacon that the options describe."""
    from driftplan import BeaconKind

    stds = {name: getattr(args, name) for name in _MEASURED[args.kind]}
    for name in ("detection_probability", "std_per_m", "view_angle_deg", "sensor_view_deg"):
        common[name] = getattr(args, name)
    return BeaconKind(
        name=args.kind,
        range_m=(10.0 if args.kind in _FAR else 1.5) if args.range_m is None else args.range_m,
        line_of_sight=args.kind in _SEEN and not args.through_walls,
        **{name.removesuffix("_deg"): radians(std) if name.endswith("_deg") else std for name, std in stds.items()},
        **common,
    )


def note_of(layout: Layout) -> str:
    """What `Layout.note` says, in the words of the command line."""
    return layout.note.replace('estimator="filter"', "--estimator filter")


def search_effort(args: argparse.Namespace) -> str:
    """How long a search may take, in words, if that was said."""
    words = [] if args.time_limit is None else [f"at most {args.time_limit:g} s"]
    words += [] if args.iterations is None else [counted(args.iterations, "iteration")]
    return "".join(f", {part}" for part in words)


def _given(args: argparse.Namespace, options: Iterable[Option]) -> dict[str, Any]:
    return {option.name: getattr(args, option.name) for option in options if getattr(args, option.name) is not None}
