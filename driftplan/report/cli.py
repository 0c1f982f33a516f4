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
from importlib.metadata import version
from typing import Any, NoReturn

from driftplan.errors import DriftplanError, InfeasibleError, NoPathError
from driftplan.report.commands import COMMANDS
from driftplan.report.commands.answer import deliver

DONE, BAD_INPUT, NO_ROUTE, INTERRUPTED = 0, 2, 3, 130
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
        deliver(args, COMMANDS[args.command].run(args))
        sys.stdout.flush()
    except BrokenPipeError:  # such as `driftplan maps | head -1`; what is left in the buffer must not fail at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return CLOSED_PIPE
    except KeyboardInterrupt:
        return _failed(args, "interrupted; no file was left half written", INTERRUPTED)
    except (NoPathError, InfeasibleError) as err:
        return _failed(args, err, NO_ROUTE)
    except (DriftplanError, ValueError, OSError) as err:
        return _failed(args, err, BAD_INPUT)
    return DONE


def build_parser() -> Parser:
    """The parser of the whole command."""
    parser = Parser(
        prog="driftplan",
        description="How lost odometry gets along a path, the route on which it gets lost least, and the fewest "
        "beacons to bound it. Lengths are metres; a map is a file (.yaml of ROS map_server, .map of MovingAI, "
        ".geojson) or the name of one that comes along.",
        epilog="Exit codes: 0 done, 2 bad input, 3 no route or infeasible, 130 interrupted.",
    )
    parser.add_argument("--version", action="version", version=f"driftplan {version('driftplan')}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in COMMANDS.values():
        command.add_to(subparsers)
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


def _failed(args: argparse.Namespace, why: object, code: int) -> int:
    print(f"driftplan {args.command}: {' '.join(str(why).split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
