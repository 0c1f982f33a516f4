"""The results of a study: a line of JSON per cell, appended as cells are done. A line that was being written when the
process was killed is the last, has no end, and is cut off by who opens the file next."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from driftplan.errors import StudyError
from driftplan.layouts.study.work import Row


def read_rows(path: Path) -> dict[str, Row]:
    """The last row of every key; none without a file.

    Raises
    ------
    StudyError : if a line but the last is no row: it names the line
    """
    if not path.exists():
        return {}
    rows: dict[str, Row] = {}
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):  # being written, or cut off
                break
            try:
                row = json.loads(line)
                rows[row["key"]] = row
            except (ValueError, KeyError, TypeError):
                raise StudyError(
                    f"{path}, line {number}: expected a row of a study's results, got {line[:60]!r}"
                ) from None
    return rows


class Appender:
    """An open file of results."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def append(self, row: Row) -> None:
        """A row, in one write: once this returns, killing the process does not lose it."""
        line = json.dumps(row, allow_nan=False, separators=(",", ":")).encode() + b"\n"
        if os.write(self._descriptor, line) != len(line):
            raise OSError("a row could not be written whole: is the disk full?")


@contextmanager
def appending(path: Path | None) -> Iterator[Appender | None]:
    """The file, for one process at a time.

    Raises
    ------
    StudyError : if another process is adding to it
    """
    if path is None:
        yield None
        return
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise StudyError(f"{path}: another run is adding to these results: wait for it or end it") from None
        content_end = os.fstat(descriptor).st_size
        tail = b""
        while content_end and not tail.endswith(b"\n"):
            start = max(content_end - (1 << 16), 0)
            tail = os.pread(descriptor, content_end - start, start)
            cut = tail.rfind(b"\n") + 1
            content_end, tail = start + cut, tail[:cut]
        os.ftruncate(descriptor, content_end)
        yield Appender(descriptor)
    finally:
        os.close(descriptor)
