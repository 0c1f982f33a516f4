"""Options that several driftplan subcommands share, and the objects they stand for.

Heavy modules are imported where an object is made, so that ``--help`` is quick. The library checks the values: what is
wrong with them is said in one place.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from driftplan.model.noise import OdometryNoise
    from driftplan.world.world import World

PLANNERS = ("roadmap", "rrtstar", "informed_rrtstar", "sorrtstar", "bitstar")  # here too, so that --help loads none
DEFAULT_PLANNER = "roadmap"
DEFAULT_SPREAD = {"heading_deg": 1.0, "distance_m": 0.05, "after_m": 10.0, "heading_deg_per_full_turn": 0.0}
_SPREAD_HELP = {
    "heading_deg": ("DEG", "standard deviation of the heading error after --after-m metres, degrees"),
    "distance_m": ("M", "standard deviation of the distance error after --after-m metres, metres"),
    "after_m": ("M", "length of the drives that --heading-deg and --distance-m are about, metres"),
    "heading_deg_per_full_turn": ("DEG", "standard deviation of the heading error after one full turn, degrees"),
}
_RATE_HELP = {
    "heading_var_per_m": ("RAD2/M", "heading variance per metre, rad^2/m"),
    "distance_var_per_m": ("M2/M", "variance of the distance per metre, m^2/m"),
    "lateral_var_per_m": ("M2/M", "variance across the direction of travel per metre, m^2/m"),
    "heading_var_per_rad": ("RAD2/RAD", "heading variance per radian turned, rad^2/rad"),
    "distance_var_per_rad": ("M2/RAD", "variance of the distance per radian turned, m^2/rad"),
    "heading_var_per_step": ("RAD2", "heading variance per step, rad^2 (needs --step-m)"),
    "distance_var_per_step": ("M2", "variance of the distance per step, m^2 (needs --step-m)"),
    "lateral_var_per_step": ("M2", "variance across the direction of travel per step, m^2 (needs --step-m)"),
    "step_m": ("M", "length of a step, metres (default: errors are continuous along the path)"),
}
_SYSTEMATIC_HELP = {
    "heading_bias_per_m": ("RAD/M", "systematic heading error per metre, rad/m"),
    "heading_bias_per_rad": ("RATIO", "systematic relative error of measured turns"),
    "distance_scale_error": ("RATIO", "systematic relative error of measured distances"),
}


def add_noise_options(parser: argparse.ArgumentParser) -> None:
    """Noise as spreads of repeated drives, as rates, from a file or a preset; systematic errors go with all of them."""
    spreads = parser.add_argument_group("odometry noise, as measured over straight drives (the default)")
    for name, (unit, said) in _SPREAD_HELP.items():
        spreads.add_argument(
            _option(name), type=float, metavar=unit, help=f"{said} (default: {DEFAULT_SPREAD[name]:g})"
        )
    rates = parser.add_argument_group(
        "odometry noise, as rates (instead of the above; rates that are not given are 0, like the systematic errors)"
    )
    for name, (unit, said) in {**_RATE_HELP, **_SYSTEMATIC_HELP}.items():
        rates.add_argument(_option(name), type=float, metavar=unit, help=said)
    rates.add_argument(
        "--noise",
        metavar="FILE",
        help="all of it from a file, such as driftplan fit --yaml writes, or from the preset of this name",
    )


def noise_from(args: argparse.Namespace) -> OdometryNoise:
    """The noise that the options describe."""
    from driftplan.model.noise import OdometryNoise

    spread, rates, systematic = (_given(args, names) for names in (_SPREAD_HELP, _RATE_HELP, _SYSTEMATIC_HELP))
    kept = {"noise": args.noise} if args.noise is not None else {}
    ways = [_option(next(iter(way))) for way in (spread, rates, kept) if way]
    if len(ways) > 1:
        raise ValueError(f"expected the noise as spreads, as rates or from a file, got {' and '.join(ways)}")
    if rates.keys() == {"step_m"}:  # without a variance the odometry would silently be perfect
        raise ValueError("expected --step-m together with a variance, such as --heading-var-per-step, got it alone")
    if kept:
        noise = _noise_called(args.noise)
    else:
        noise = OdometryNoise(**rates) if rates else OdometryNoise.from_std(**{**DEFAULT_SPREAD, **spread})
    return replace(noise, **systematic)


def _noise_called(name: str) -> OdometryNoise:
    """The noise of a file, or the preset of that name."""
    from driftplan.model.presets import PRESETS
    from driftplan.world.noise_files import load_noise

    if name in PRESETS:
        return PRESETS[name].noise
    if not Path(name).exists():
        raise ValueError(f"expected --noise a noise file or a preset, one of {', '.join(PRESETS)}; got {name!r}")
    return load_noise(name)


def noise_as_json(noise: OdometryNoise) -> dict[str, Any]:
    """The rates of a noise that are not the default, by the names of `OdometryNoise`."""
    return {f.name: getattr(noise, f.name) for f in fields(noise) if getattr(noise, f.name) != f.default}


def add_world_options(parser: argparse.ArgumentParser) -> None:
    """How a map becomes a world."""
    group = parser.add_argument_group("map and robot")
    group.add_argument(
        "--robot-radius", type=float, default=0.3, metavar="M", help="radius of the robot, metres (default: 0.3)"
    )
    group.add_argument(
        "--unknown-is-free",
        action="store_true",
        help="take unknown cells of a ROS map for free (default: they are obstacles)",
    )
    group.add_argument(
        "--cell-size-m", type=float, metavar="M", help="cell size of a MovingAI map, metres (default: 1)"
    )
    group.add_argument(
        "--zones",
        metavar="FILE",
        help="floors with odometry of their own: .geojson, or a .yaml that says what the greys of a picture mean",
    )


def add_planning_options(
    parser: argparse.ArgumentParser, *, ends: str | None = None, many_planners: bool = False
) -> None:
    """Where to go and how to look for a route; ``ends`` is "required", "optional" or None (known already)."""
    group = parser.add_argument_group("planning")
    for name in ("start", "goal") if ends else ():
        group.add_argument(
            f"--{name}", type=point, required=ends == "required", metavar="X,Y", help=f"{name} of the route, metres"
        )
    if ends == "required":
        group.add_argument(
            "--minimise",
            choices=("drift", "length", "worst_drift"),
            default="drift",
            help="rms drift at the goal, length, or the greatest rms drift anywhere on the way (default: drift)",
        )
        group.add_argument(
            "--max-detour",
            type=float,
            metavar="TIMES",
            help="greatest length, as a multiple of that of the shortest route (default: any)",
        )
    if ends:
        add_heading_option(group)
    several: dict[str, Any] = {"action": "append"} if many_planners else {"default": DEFAULT_PLANNER}
    again = ", may be given several times" if many_planners else ""
    group.add_argument(
        "--planner", metavar="NAME", help=f"{', '.join(PLANNERS)}{again} (default: {DEFAULT_PLANNER})", **several
    )
    group.add_argument(
        "--time-limit",
        type=float,
        metavar="S",
        help="planning time per route, seconds (default: 1; 5 with beacons or a limit; none with --iterations)",
    )
    group.add_argument(
        "--iterations",
        type=int,
        metavar="N",
        help="end after N batches of the roadmap, or iterations of another planner: the same seed then gives the same "
        "route (default: the time decides)",
    )
    group.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the planner's samples (default: 0)")


def search_effort(args: argparse.Namespace) -> str:
    """How long a search may take, in words, if that was said."""
    said = [] if args.time_limit is None else [f"at most {args.time_limit:g} s"]
    said += [] if args.iterations is None else [f"{args.iterations} iterations"]
    return "".join(f", {part}" for part in said)


def add_heading_option(parser: argparse._ActionsContainer) -> None:
    """Where the robot faces before its first turn."""
    parser.add_argument(
        "--start-heading-deg",
        type=float,
        metavar="DEG",
        help="heading at the start, degrees from +x to the left; then the first turn counts too (default: the robot "
        "already faces its first leg)",
    )


def add_output_options(parser: argparse.ArgumentParser, *kinds: str) -> None:
    """Files to write besides the answer on stdout."""
    said = {
        "csv": "write the waypoints x,y as CSV, metres; `driftplan predict` and `compare` read it back",
        "geojson": "write the route and the drift along it as a GeoJSON LineString, coordinates in metres",
        "png": "draw the map, the routes, their error ellipses and their drift against distance",
    }
    group = parser.add_argument_group("files")
    for kind in kinds:
        group.add_argument(f"--{kind}", type=output_type(kind), metavar="FILE", help=said[kind])


def output_type(kind: str) -> Callable[[str], Path]:
    """The type of an argument that names a file of this kind to write."""
    return png_file if kind == "png" else output_file


def png_file(text: str) -> Path:
    """An argument that names a picture to write; nothing but PNG is written."""
    path = output_file(text)
    if path.suffix.lower() != ".png":
        raise argparse.ArgumentTypeError(f"expected a file called .png, got {text!r}")
    return path


def output_file(text: str) -> Path:
    """An argument that names a file to write: said to be wrong before the work, not after it."""
    path = Path(text)
    if path.is_dir() or not path.parent.is_dir():
        wrong = "it is a folder" if path.is_dir() else f"there is no folder {path.parent}"
        raise argparse.ArgumentTypeError(f"cannot write {text!r}: {wrong}")
    return path


def world_from(args: argparse.Namespace) -> World:
    """The world of ``args.map``: a file, or the name of a map that comes with driftplan."""
    from driftplan.world.mapfiles import bundled_map, bundled_maps, load_world

    if args.map in bundled_maps():
        path = bundled_map(args.map)
    elif Path(args.map).suffix:
        path = Path(args.map)
    else:
        raise ValueError(f"expected a map file or one of {', '.join(bundled_maps())}, got {args.map!r}")
    return load_world(
        path,
        robot_radius=args.robot_radius,
        unknown_is_free=args.unknown_is_free,
        cell_size_m=args.cell_size_m,
        zones=args.zones,
    )


def point(text: str) -> tuple[float, float]:
    """An argument X,Y in metres.

    Examples
    --------
    >>> point("-3,4.5")
    (-3.0, 4.5)
    """
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected X,Y in metres, such as 3,-4.5, got {text!r}") from None
    return x, y


def distances(text: str) -> list[float]:
    """An argument S or S,S,... in metres.

    Examples
    --------
    >>> distances("10,20.5")
    [10.0, 20.5]
    """
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected distances S,S,... in metres, got {text!r}") from None


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")


def _given(args: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    return {name: getattr(args, name) for name in names if getattr(args, name) is not None}
