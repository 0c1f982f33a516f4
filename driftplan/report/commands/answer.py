"""What a subcommand answers with, and how it is handed over: files whole or not at all, then JSON or words."""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.files import write_files
from driftplan.report.records import json_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Everything is computed before anything is printed or written; each part is made if it is asked for.

    Attributes
    ----------
    payload : callable
        What ``--json`` prints: a dict. Keys carry their unit; lengths are metres, angles radians.
    text : callable
        The same for people, who get degrees.
    files : mapping of option or path to callable
        What is written there, bytes or a figure: for the options that name a file, and for paths in any case.
    """

    payload: Callable[[], dict[str, Any]]
    text: Callable[[], str]
    files: Mapping[str | Path, Callable[[], bytes | Figure]] = field(default_factory=dict)


def deliver(args: argparse.Namespace, answer: Answer) -> None:
    """Write the files that were asked for, print the answer, say what was written."""
    files = {}
    for name, content in answer.files.items():
        path = name if isinstance(name, Path) else getattr(args, name)
        if path is not None:
            made = content()
            files[path] = made if isinstance(made, bytes) else figure_png(made)
    write_files(files)
    print(json_text({"command": args.command, **answer.payload()}) if args.json else answer.text())
    if files:
        talk(f"wrote {', '.join(map(str, files))}")


def talk(text: str) -> None:
    """A line on stderr: what is being done, apart from the answer."""
    print(text, file=sys.stderr, flush=True)


def figure_png(figure: Figure) -> bytes:
    """A figure as PNG, by matplotlib's Agg renderer."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", bbox_inches="tight", pad_inches=0.12)
    return picture.getvalue()
