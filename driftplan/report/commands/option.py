"""What a subcommand is: a table of its options, and a function that answers. The parser is built from the table.

Nothing heavy is imported here or at the top of a subcommand's file, so that ``--help`` is quick. The library checks
the values: what is wrong with them is said in one place.
"""

from __future__ import annotations

import argparse
import atexit
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

if TYPE_CHECKING:
    from driftplan.report.commands.answer import Answer


class UsageError(Exception):
    """The arguments make no command."""


class Option(NamedTuple):
    """One option: ``max_drift`` is called ``--max-drift``, and its value is ``args.max_drift``."""

    name: str
    unit: str  # what stands for the value in the help; "" makes a switch that takes none
    help: str  # the default is added, unless this says what happens without
    type: Callable[[str], Any] = float  # makes a value of a word
    default: Any = None
    choices: tuple[Any, ...] = ()
    how: Mapping[str, Any] = {}  # anything else that `argparse` is to know: ``required``, ``nargs``, ``action``
    also: str = ""  # another name for it

    @property
    def flag(self) -> str:
        return "--" + self.name.replace("_", "-")

    def add_to(self, parser: argparse._ActionsContainer, *, positional: bool = False) -> None:
        """Tell argparse."""
        shown = f"{self.default:g}" if isinstance(self.default, float) else str(self.default)
        known = self.default is not None and "default" not in self.help
        help_text = self.help + (f" (default: {shown})" if known else "")
        if positional:
            parser.add_argument(self.name, metavar=self.unit, type=self.type, help=help_text, **self.how)
        elif not self.unit and not self.choices:
            parser.add_argument(self.flag, action="store_true", help=help_text)
        else:
            value: dict[str, Any] = {"choices": self.choices} if self.choices else {"metavar": self.unit}
            value |= {"type": self.type, "default": self.default, "help": help_text, **self.how}
            parser.add_argument(*filter(None, (self.flag, self.also)), **value)


class Group(NamedTuple):
    """Options under a heading of the help; ``folded`` ones are shown by ``--help-noise`` only."""

    title: str
    options: tuple[Option, ...]
    note: str = ""
    folded: bool = False


class Idle(NamedTuple):
    """Options that would be without effect: giving one is refused rather than ignored."""

    names: tuple[str, ...]
    when: Callable[[argparse.Namespace], bool]
    why: str


@dataclass(frozen=True, kw_only=True)
class Command:
    """A subcommand, called like its file."""

    summary: str
    description: str
    run: Callable[[argparse.Namespace], Answer]  # from parsed arguments to the answer
    arguments: tuple[Option, ...] = ()  # those that are given by their place
    groups: tuple[Group, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)  # per option, what is written: csv, geojson, …
    idle: tuple[Idle, ...] = ()
    examples: tuple[str, ...] = ()  # for the help, without ``driftplan NAME``

    @property
    def options(self) -> tuple[Option, ...]:
        """Everything but the files and the arguments by place."""
        return tuple(option for group in self.groups for option in group.options)

    def add_to(self, subparsers: argparse._SubParsersAction[Any], name: str) -> None:
        """Add the subcommand's parser."""
        examples = "".join(f"\n  driftplan {name} {words}" for words in self.examples)
        words = [f"{option.unit} ..." if option.how.get("nargs") == "+" else option.unit for option in self.arguments]
        words += [f"{option.flag} {option.unit}" for option in self.options if option.how.get("required")]
        about: dict[str, Any] = {"help": self.summary, "description": self.description}
        about |= {"usage": " ".join(["%(prog)s", *words, "[options]"]), "epilog": f"Examples:{examples}"}
        parser = subparsers.add_parser(name, **about)
        for argument in self.arguments:
            argument.add_to(parser, positional=True)
        files = tuple(
            PICTURE._replace(help=f"{help_text}: PNG, SVG or PDF, as its name says")
            if kind == "picture"
            else Option(kind, "FILE", f"{help_text}; - is standard output", output_file)
            for kind, help_text in self.files.items()
        )
        for group in (*self.groups, *([Group("files", files)] if files else ())):
            section = parser.add_argument_group(group.title, group.note or None) if group.title else parser
            if group.folded:
                parser.folded += (group.title,)
            for option in group.options:
                option.add_to(section)
        if parser.folded:
            parser.add_argument("--help-noise", action=HelpNoise, nargs=0, help="list the options of odometry noise")
        parser.add_argument("--json", action="store_true", help="print JSON, every key with its unit; errors too")

    def check(self, args: argparse.Namespace, given: set[str]) -> None:
        """Refuse options that would be without effect."""
        for names, when, why in self.idle:
            for option in self.options:
                if option.name in names and option.name in given and when(args):
                    raise ValueError(f"{option.flag} would have no effect: {why}")


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong, and takes no abbreviations: a script's must not change their meaning one day."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(allow_abbrev=False, formatter_class=_HelpFormatter, **kwargs)
        self.folded: tuple[str, ...] = ()
        self._negative_number_matcher = re.compile(r"-\.?\d")  # -3,4 is a value too, not an option

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{self.prog}: {message} (see {self.prog} --help)")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            known = list(map(str, action.choices))
            near = get_close_matches(str(value), known, 1)
            hint = f"did you mean {near[0]}?" if near else f"expected one of {', '.join(known)}"
            raise argparse.ArgumentError(action, f"invalid choice: {value!r}; {hint}")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        flags = self._option_string_actions
        for word in args if self._subparsers is None else ():  # before anything is missed that was only misspelt
            if re.match(r"--[a-z]", word) and word.partition("=")[0] not in flags:
                near = get_close_matches(word.partition("=")[0], flags, 1)
                self.error(f"unrecognized arguments: {word}" + (f"; did you mean {near[0]}?" if near else ""))
        known, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {unknown[0]}")
        return known, unknown

    def format_help(self, *, folded: bool = False) -> str:
        """The help: what is folded away, or all the rest."""
        shown = self._action_groups
        self._action_groups = [group for group in shown if (group.title in self.folded) == folded]
        try:
            return super().format_help()
        finally:
            self._action_groups = shown


class HelpNoise(argparse.Action):
    """Prints what the help folds away."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: Any = None) -> None:
        print(parser.format_help(folded=True), end="")
        parser.exit()


class _HelpFormatter(argparse.HelpFormatter):
    """Examples keep their lines."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if text.startswith("Examples:") else super()._fill_text(text, width, indent)


# Types of values


def point(text: str) -> tuple[float, float]:
    """An argument X,Y in metres.

    >>> point("-3,4.5")
    (-3.0, 4.5)
    """
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected X,Y in metres, such as 3,-4.5, got {text!r}") from None
    return x, y


def metres(text: str) -> list[float]:
    """An argument M or M,M,... in metres.

    >>> metres("10,20.5")
    [10.0, 20.5]
    """
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected M,M,... in metres, got {text!r}") from None


def names(text: str) -> list[str]:
    """An argument NAME,NAME,..."""
    return [name.strip() for name in text.split(",")]


def input_file(text: str, suffix: str = "") -> str:
    """An argument that names a file to read; - is standard input, kept in a file until the command ends."""
    if text != "-":
        return text
    folder = tempfile.mkdtemp(prefix="driftplan-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    file = Path(folder) / f"{STANDARD_INPUT}{suffix}"
    with file.open("wb") as copy:
        shutil.copyfileobj(sys.stdin.buffer, copy)
    return str(file)


def geojson_file(text: str) -> str:
    """An argument that names a map or beacons to read; standard input is taken for GeoJSON."""
    return input_file(text, ".geojson")


def label(file: str) -> str:
    """What a file to read is called when people are told about it."""
    return STANDARD_INPUT if Path(file).stem == STANDARD_INPUT else file


def output_file(text: str) -> Path:
    """An argument that names a file to write: said to be wrong before the work, not after it. - is standard output."""
    path = Path(text)
    if path.is_dir() or not path.parent.is_dir():
        wrong = "it is a folder" if path.is_dir() else f"there is no folder {path.parent}"
        raise argparse.ArgumentTypeError(f"cannot write {text!r}: {wrong}")
    return path


def picture_file(text: str) -> Path:
    """An argument that names a picture to write; what goes to standard output is a PNG."""
    path = output_file(text)
    if text != "-" and path.suffix.lower() not in PICTURES:
        raise argparse.ArgumentTypeError(f"expected a file called {', '.join(PICTURES)}, got {text!r}")
    return path


STANDARD_INPUT = "standard input"
PICTURES = (".png", ".svg", ".pdf")
PICTURE = Option("picture", "FILE", "", picture_file, also="--png")
