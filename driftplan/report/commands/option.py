"""What a subcommand is: a table of its options, and a function that answers. The parser is built from the table.

Nothing heavy is imported here or at the top of a subcommand's file, so that ``--help`` is quick. The library checks
the values: what is wrong with them is said in one place.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from driftplan.report.commands.answer import Answer


class Option(NamedTuple):
    """One option: ``max_drift`` is called ``--max-drift``, and its value is ``args.max_drift``.

    Attributes
    ----------
    name : str
    unit : str
        What stands for the value in the help; "" makes a switch that takes none.
    help : str
        The default is added, unless this says what happens without.
    type : callable
        Makes a value of a word.
    default : object
    choices : tuple of str
    how : mapping
        Anything else that `argparse` is to know: ``required``, ``nargs``, ``action``.
    """

    name: str
    unit: str
    help: str
    type: Callable[[str], Any] = float
    default: Any = None
    choices: tuple[Any, ...] = ()
    how: Mapping[str, Any] = {}

    @property
    def flag(self) -> str:
        return "--" + self.name.replace("_", "-")

    def add_to(self, parser: argparse._ActionsContainer, *, positional: bool = False) -> None:
        """Tell argparse."""
        known = self.default is not None and "default" not in self.help
        said = self.help + (f" (default: {_shown(self.default)})" if known else "")
        if positional:
            parser.add_argument(self.name, metavar=self.unit, help=said, **self.how)
        elif not self.unit and not self.choices:
            parser.add_argument(self.flag, action="store_true", help=said)
        else:
            value: dict[str, Any] = {"choices": self.choices} if self.choices else {"metavar": self.unit}
            value |= {"type": self.type, "default": self.default, "help": said, **self.how}
            parser.add_argument(self.flag, **value)


class Group(NamedTuple):
    """Options under a heading of the help."""

    title: str
    options: tuple[Option, ...]


@dataclass(frozen=True, kw_only=True)
class Command:
    """A subcommand.

    Attributes
    ----------
    name, summary, description : str
    run : callable
        From parsed arguments to the answer.
    arguments : tuple of Option
        Those that are given by their place.
    groups : tuple of Group
    files : mapping of option to what is written there
        ``csv``, ``geojson``, ``png``, ``yaml``: each names a file.
    """

    name: str
    summary: str
    description: str
    run: Callable[[argparse.Namespace], Answer]
    arguments: tuple[Option, ...] = ()
    groups: tuple[Group, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)

    def add_to(self, subparsers: argparse._SubParsersAction[Any]) -> None:
        """Add the subcommand's parser."""
        parser = subparsers.add_parser(self.name, help=self.summary, description=self.description)
        for argument in self.arguments:
            argument.add_to(parser, positional=True)
        files = tuple(
            Option(kind, "FILE", said, picture_file if kind == "png" else output_file)
            for kind, said in self.files.items()
        )
        for group in (*self.groups, *([Group("files", files)] if files else ())):
            section = parser.add_argument_group(group.title) if group.title else parser
            for option in group.options:
                option.add_to(section)
        parser.add_argument("--json", action="store_true", help="print JSON, every key with its unit")


# Types of values


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


def metres(text: str) -> list[float]:
    """An argument M or M,M,... in metres.

    Examples
    --------
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


def output_file(text: str) -> Path:
    """An argument that names a file to write: said to be wrong before the work, not after it."""
    path = Path(text)
    if path.is_dir() or not path.parent.is_dir():
        wrong = "it is a folder" if path.is_dir() else f"there is no folder {path.parent}"
        raise argparse.ArgumentTypeError(f"cannot write {text!r}: {wrong}")
    return path


def picture_file(text: str) -> Path:
    """An argument that names a picture to write; nothing but PNG is written."""
    path = output_file(text)
    if path.suffix.lower() != ".png":
        raise argparse.ArgumentTypeError(f"expected a file called .png, got {text!r}")
    return path


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
