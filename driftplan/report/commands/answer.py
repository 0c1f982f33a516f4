"""What a subcommand answers with, and how it is handed over: files whole or not at all, then JSON or words."""

from __future__ import annotations

import argparse
import io
import sys
import threading
import time
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
    """Everything is computed before anything is printed or written; each part is made if it is asked for."""

    payload: Callable[[], dict[str, Any]]  # what ``--json`` prints: keys carry their unit, m and radians
    text: Callable[[], str]  # the same for people, who get degrees
    # per option that names a file, if it is given, and per path in any case, what is written there
    files: Mapping[str | Path, Callable[[], bytes | Figure]] = field(default_factory=dict)
    failed: bool = False  # what was asked is answered with no: exit code 1


STDOUT = Path("-")
_CLEAR_LINE = "\r\x1b[K"
_QUIET_S, _TELL_EVERY_S = 2.0, 0.5


def deliver(args: argparse.Namespace, answer: Answer) -> None:
    """Write the files that were asked for, print the answer, say what was written.

    A file called - goes to standard output, and the answer for people then to standard error.
    """
    files: dict[Path, bytes] = {}
    for name, content in answer.files.items():
        path = name if isinstance(name, Path) else getattr(args, name)
        if path is not None:
            if path in files:
                raise ValueError(f"expected every file under a name of its own, got {path} twice")
            if path == STDOUT and args.json:
                raise ValueError("expected --json or a file on standard output, got both")
            made = content()
            files[path] = made if isinstance(made, bytes) else figure_bytes(made, path.suffix[1:].lower() or "png")
    on_stdout = files.pop(STDOUT, None)
    write_files(files)
    text = json_text({"command": args.command, **answer.payload()}) if args.json else answer.text()
    if on_stdout is not None:
        sys.stdout.buffer.write(on_stdout)
        talk(text)
    elif text:
        print(text)
    for path in files:
        talk(f"wrote {path}")


def talk(text: str) -> None:
    """A line on stderr: what is being done, apart from the answer."""
    print(f"{_CLEAR_LINE if sys.stderr.isatty() else ''}{text}", file=sys.stderr, flush=True)


class Progress:
    """Says on a terminal, after two seconds, for how long something has been going on and how far it has come.

    Nothing is said where stderr is a file or a pipe.
    """

    news = ""  # of what is going on, whoever started it

    def __init__(self) -> None:
        Progress.news = ""
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._tell, daemon=True)

    def __enter__(self) -> Progress:
        if sys.stderr.isatty():
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        if self._thread.is_alive():
            self._thread.join()
            print(_CLEAR_LINE, end="", file=sys.stderr, flush=True)

    def _tell(self) -> None:
        since, pause = time.monotonic(), _QUIET_S
        while not self._done.wait(pause):
            pause, news = _TELL_EVERY_S, f": {Progress.news}" if Progress.news else ""
            print(f"{_CLEAR_LINE}{time.monotonic() - since:.0f} s{news}", end="", file=sys.stderr, flush=True)


def figure_bytes(figure: Figure, form: str = "png") -> bytes:
    """A figure as PNG, SVG or PDF, the same bytes for the same figure; without pyplot."""
    from matplotlib import rc_context

    picture = io.BytesIO()
    when: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(form, {})
    with rc_context({"svg.hashsalt": "driftplan"}):
        figure.savefig(picture, format=form, bbox_inches="tight", pad_inches=0.12, metadata=when)
    return picture.getvalue()
