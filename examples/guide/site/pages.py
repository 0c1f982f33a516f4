"""Run the code of the guide's pages, from top to bottom, and write what it printed into them.

    python examples/guide/site/pages.py first-hour.md ompl.md     # record again what these print; default: all

A page's blocks of `sh` and `python` share a folder, which holds what `driftplan examples` hands out, and its Python
blocks share their names; blocks inside HTML comments run too, unseen. A block of `text` right after one of these is
what that one printed on standard output. `driftplan studio` without --html would serve for ever: it is interrupted
after some seconds.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

GUIDE = Path(__file__).resolve().parents[1]
_BLOCK = re.compile(r"```(sh|python)\n(.*?)```\n(?:\n```text\n(.*?)```\n)?", re.DOTALL)
_COMMAND = """#!/bin/sh
case " $* " in
  " studio "*" --html "*) ;;
  " studio "*) timeout --signal=INT 8 {python} -m driftplan "$@" --no-browser; exit 0;;
esac
exec {python} -m driftplan "$@"
"""


@dataclass(frozen=True)
class Block:
    """A block of code, and what the page says it printed (None if it says nothing)."""

    language: str
    code: str
    printed: str | None


def blocks(page: Path) -> list[Block]:
    """The blocks of code of a page, in order."""
    return [Block(*found.groups()) for found in _BLOCK.finditer(page.read_text())]


class Reader:
    """Somebody who types what a page shows, in a folder with the examples.

    Parameters
    ----------
    folder : an empty folder: the home directory
    """

    def __init__(self, folder: Path) -> None:
        self.bin, self.at = folder / "bin", folder / "work"
        self.bin.mkdir()
        command = self.bin / "driftplan"
        command.write_text(_COMMAND.format(python=sys.executable))
        command.chmod(0o755)
        (self.bin / "python").symlink_to(sys.executable)
        self.names: dict[str, Any] = {"__name__": "__main__"}
        self._shell("driftplan examples work && cd work", folder)

    def run(self, block: Block) -> str:
        """What a block prints; CalledProcessError if a command fails."""
        if block.language == "sh":
            return self._shell(block.code, self.at)
        with contextlib.chdir(self.at), contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(compile(block.code, "<page>", "exec"), self.names)
        return printed.getvalue()

    def _shell(self, code: str, folder: Path) -> str:
        path = {"PATH": f"{self.bin}:{os.environ['PATH']}", "HOME": str(self.bin.parent), "COLUMNS": "120"}
        here = self.bin.parent / "here"
        done = subprocess.run(
            ["bash", "-euc", f"{code}\npwd > {here}"],
            cwd=folder,
            env={**os.environ, **path},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=600,
        )
        if done.returncode:
            raise RuntimeError(f"{code.strip()}\nended with exit code {done.returncode}:\n{done.stderr}")
        self.at = Path(here.read_text().strip())
        return done.stdout


def record(page: Path) -> None:
    """Write into a page what its code prints now."""
    with tempfile.TemporaryDirectory() as folder:
        reader = Reader(Path(folder))

        def again(found: re.Match[str]) -> str:
            printed = reader.run(Block(*found.groups()))
            if found[3] is None:
                return found[0]
            return f"```{found[1]}\n{found[2]}```\n\n```text\n{printed.rstrip()}\n```\n"

        page.write_text(_BLOCK.sub(again, page.read_text()))


if __name__ == "__main__":
    named = [GUIDE / name for name in sys.argv[1:]]
    for one in named or sorted(GUIDE.glob("*.md")):
        if any(block.printed is not None for block in blocks(one)):
            print(one.name)
            record(one)
