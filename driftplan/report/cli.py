"""The driftplan command: parses, calls the library, prints.

Results go to stdout, talk and progress to stderr. Exit codes: 0 done, 1 selftest failed, 2 bad input, 3 no route or
infeasible, 130 interrupted. Heavy modules are imported by the subcommand that needs them, so that ``--help`` is quick.
"""

from __future__ import annotations

import io
import os
import re
import signal
import sys
from collections.abc import Sequence
from importlib.metadata import version
from threading import Timer
from types import FrameType
from typing import Any

from driftplan.errors import DriftplanError, InfeasibleError, MapError, NoPathError, StudyError, TrajectoryError
from driftplan.report.commands import COMMANDS
from driftplan.report.commands.answer import Progress, deliver
from driftplan.report.commands.option import STANDARD_INPUT, Command, Parser, UsageError
from driftplan.report.records import json_text

DONE, FAILED, BAD_INPUT, NO_ROUTE, INTERRUPTED = 0, 1, 2, 3, 130
_ALSO_CALLED = {  # what the library calls the values of options
    "start_heading": "--start-heading-deg",
    "heading_std": "--heading-std-deg",
    "bearing_std": "--bearing-std-deg",
    "heading_offset": "--heading-offset-deg",
    "start_fix": "--start-position-std-m",
    "points": "--candidates",
    "kind": "--odometry-kind",
}
_AGAIN_S = 0.05  # longer than a callback takes
CLOSED_PIPE = 141  # what a shell reports of a program that wrote into a closed pipe


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command with these arguments (default: those of the process) and return its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    name = next((word for word in words if word in COMMANDS), "")
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, _interrupt)
        sys.unraisablehook = _interrupt_again
    try:
        _check_streams()
        args = build_parser().parse_args(words)
        command = COMMANDS[args.command]
        command.check(args, {word.partition("=")[0][2:].replace("-", "_") for word in words if word.startswith("--")})
        with Progress():
            answer = command.run(args)
        deliver(args, answer)
        sys.stdout.flush()
        return FAILED if answer.failed else DONE
    except BrokenPipeError:  # such as `driftplan maps | head -1`
        _drop_stdout()
        return CLOSED_PIPE
    except KeyboardInterrupt as err:
        return _failed(words, name, err, "interrupted; no file was left half written", INTERRUPTED)
    except (UsageError, MapError, TrajectoryError, StudyError, OSError) as err:  # in its own words
        _drop_stdout()
        return _failed(words, name, err, str(err), BAD_INPUT)
    except (DriftplanError, ValueError, ImportError) as err:
        code = NO_ROUTE if isinstance(err, (NoPathError, InfeasibleError)) else BAD_INPUT
        return _failed(words, name, err, in_options(str(err), COMMANDS[name]), code)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Ctrl-C, but not in the middle of an import: extension modules take it for a failure of theirs, at length."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return _send_again()
        frame = frame.f_back
    raise KeyboardInterrupt


def _interrupt_again(lost: Any) -> None:
    """Ctrl-C in the middle of a callback that loses exceptions comes again when that is over."""
    if lost.exc_type is KeyboardInterrupt:
        _send_again()
    else:
        sys.__unraisablehook__(lost)


def _send_again() -> None:
    Timer(_AGAIN_S, os.kill, (os.getpid(), signal.SIGINT)).start()


def _check_streams() -> None:
    """What was closed (``2>&-``) leads nowhere, so that no file gets its number; without stdout there is no answer."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) < 3:
        pass
    os.close(descriptor)
    if sys.stderr is None:
        sys.stderr = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
    if sys.stdout is None:
        sys.stdout = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
        raise UsageError("driftplan: standard output is closed: expected somewhere to print to, such as > /dev/null")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # ± is \\xb1 where the terminal knows ASCII only
            stream.reconfigure(errors="backslashreplace")


def _drop_stdout() -> None:
    """What is left in the buffer must not fail again at exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def in_options(message: str, command: Command) -> str:
    """A message of the library in the words of the command line: ``max_drift`` is ``--max-drift``.

    >>> in_options("expected max_drift > 0, got -1", COMMANDS["place"])
    'expected --max-drift > 0, got -1'
    """
    flags = {option.name: option.flag for option in command.options}
    flags |= {name: flag for name, flag in _ALSO_CALLED.items() if flag in flags.values()}
    for name, flag in sorted(flags.items(), key=lambda item: -len(item[0])):
        before = r"(?<![\w\-.'/])" if "_" in name else r"(?:(?<=expected )|(?<=\bor ))"
        message = re.sub(rf"\b{name}=(['\"])(\w+)\1", rf"{flag} \2", message)
        message = re.sub(rf"{before}{name}\b(?![.\w(])", flag, message)
    return message


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
    for name, command in COMMANDS.items():
        command.add_to(subparsers, name)
    return parser


def _failed(words: Sequence[str], name: str, error: BaseException, message: str, code: int) -> int:
    """One line on stderr that says what is wrong; with --json also an object on stdout."""
    message = re.sub(rf"\S*/{STANDARD_INPUT}(\.geojson)?", STANDARD_INPUT, " ".join(message.split()))
    if "--json" in words:
        print(json_text({"command": name, "error": {"kind": type(error).__name__, "message": message, "code": code}}))
    print(message if isinstance(error, UsageError) else f"driftplan {name}: {message}", file=sys.stderr)
    return code
