"""The driftplan command: parses, calls the library, prints.

Results go to stdout, talk and progress to stderr. Exit codes: 0 done, 2 bad input, 3 no route or infeasible,
130 interrupted. Heavy modules are imported by the subcommand that needs them, so that ``--help`` is quick.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version
from typing import Any, NoReturn

from driftplan.errors import DriftplanError, InfeasibleError, NoPathError
from driftplan.report import design_command, fit_command, place_command
from driftplan.report.cli_options import (
    add_heading_option,
    add_noise_options,
    add_output_options,
    add_planning_options,
    add_world_options,
    distances,
)
from driftplan.report.itinerary_options import add_itinerary_options

DONE, BAD_INPUT, NO_ROUTE, INTERRUPTED = 0, 2, 3, 130
_MODULES = {
    "place": "place_command",
    "design": "design_command",
    "fit": "fit_command",
}  # of the subcommands that fill one; the others are in cli_commands
CLOSED_PIPE = 141  # what a shell reports of a program that wrote into a closed pipe


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong, and takes no abbreviations: a script's must not change their meaning one day."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(allow_abbrev=False, **kwargs)

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command with these arguments (default: those of the process) and return its exit code."""
    args = build_parser().parse_args(_negative_numbers_joined(sys.argv[1:] if argv is None else argv))
    try:
        module = import_module(f"driftplan.report.{_MODULES.get(args.command, 'cli_commands')}")
        getattr(module, args.command)(args)
        sys.stdout.flush()
    except BrokenPipeError:  # such as `driftplan maps | head -1`; what is left in the buffer must not fail at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return CLOSED_PIPE
    except KeyboardInterrupt:
        return _say(args, "interrupted; no file was left half written", INTERRUPTED)
    except (NoPathError, InfeasibleError) as err:
        return _say(args, err, NO_ROUTE)
    except (DriftplanError, ValueError, OSError) as err:
        return _say(args, err, BAD_INPUT)
    return DONE


def build_parser() -> Parser:
    """The parser of the whole command; a subcommand is carried out by the function of its name."""
    parser = Parser(
        prog="driftplan",
        description="How lost odometry gets along a path, the route on which it gets lost least, and the fewest "
        "beacons to bound it. Lengths are metres; a map is a file (.yaml of ROS map_server, .map of MovingAI, "
        ".geojson) or the name of one that comes along.",
        epilog="Exit codes: 0 done, 2 bad input, 3 no route or infeasible, 130 interrupted.",
    )
    parser.add_argument("--version", action="version", version=f"driftplan {version('driftplan')}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = subparsers.add_parser(
        "demo",
        help="lowest-drift against shortest routes on the maps that come along, and RFID tags: tables and pictures",
        description="Plan the lowest-drift and the shortest route on the maps that come along, compare and draw them; "
        "then place the fewest RFID tags that keep five rounds through the warehouse under 0.8 m of drift. Without "
        "--time-limit and --iterations the roadmap ends after 4 batches, on a fast machine or a slow one.",
    )
    demo.add_argument(
        "--folder",
        default="driftplan-demo",
        metavar="DIR",
        help="where the pictures go; made if there is none (default: driftplan-demo)",
    )
    add_planning_options(demo)

    predict = subparsers.add_parser(
        "predict",
        help="drift along given paths",
        description="Predict the drift of odometry along paths, at every waypoint or at chosen distances.",
    )
    predict.add_argument(
        "paths", nargs="+", metavar="PATH.csv", help="waypoints x,y or poses x,y,heading: metres, radians, one per line"
    )
    predict.add_argument(
        "--at", type=distances, metavar="S", help="only after S metres; several: S,S,... (default: every waypoint)"
    )
    add_heading_option(predict)
    add_output_options(predict, "png")

    plan = subparsers.add_parser(
        "plan",
        help="the lowest-drift route between two points of a map",
        description="Plan the route from start to goal on which odometry gets lost least.",
    )
    plan.add_argument("map", metavar="MAP", help="map file, or the name of a map that comes along")
    add_planning_options(plan, ends="required")
    add_world_options(plan)
    add_output_options(plan, "csv", "geojson", "png")
    add_itinerary_options(plan)

    compare = subparsers.add_parser(
        "compare",
        help="given paths and planned routes on a map, side by side",
        description="Compare paths on a map. With --start and --goal, the lowest-drift route of every --planner and "
        "the shortest route join in.",
    )
    compare.add_argument("map", metavar="MAP", help="map file, or the name of a map that comes along")
    compare.add_argument("paths", nargs="*", metavar="PATH.csv", help="waypoints x,y in metres, one per line")
    add_planning_options(compare, ends="optional", many_planners=True)
    add_world_options(compare)
    add_output_options(compare, "png")

    place_command.add_parser(subparsers)
    design_command.add_parser(subparsers)
    fit_command.add_parser(subparsers)

    maps = subparsers.add_parser(
        "maps", help="the maps that come along", description="List the maps that come along, and their sizes in metres."
    )

    for subparser in (demo, predict, plan, compare, maps):
        subparser.add_argument("--json", action="store_true", help="print JSON, every key with its unit")
        if subparser is not maps:
            add_noise_options(subparser)
    return parser


def _negative_numbers_joined(argv: Sequence[str]) -> list[str]:
    """``--start -3,4`` as ``--start=-3,4``: argparse would take what begins with a minus for an option."""
    joined: list[str] = []
    for word in argv:
        if re.match(r"-\.?\d", word) and joined and re.fullmatch(r"--[a-z][a-z0-9-]*", joined[-1]):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _say(args: argparse.Namespace, what: object, code: int) -> int:
    print(f"driftplan {args.command}: {' '.join(str(what).split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
