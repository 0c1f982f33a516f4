"""run_study: the cells of a study that are not done yet, done anywhere; and the table of all of them.

Its results are a file with a line of JSON per cell, appended as cells are done. A line that was being written when the
process was killed is the last, has no end, and is cut off by who opens the file next.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, Literal

from driftplan.arrays import listener, whole
from driftplan.beacons.beacon import Beacon
from driftplan.errors import StudyError
from driftplan.layouts.study.executors import Done, here, in_processes, on_cluster
from driftplan.layouts.study.inputs import CellTask, Inputs
from driftplan.layouts.study.study import Cell, Study
from driftplan.layouts.study.work import DONE, FAILED, OUT_OF_TIME, Row, Workshop
from driftplan.tables import Tabular

Progress = Callable[[int, int, float], None]  # cells done, of how many, seconds left
_NOT_IN_TABLE = ("key", "spent", "layout", "ends")


@dataclass(frozen=True, eq=False)
class StudyResult(Tabular):
    """A study and what is known of its cells.

    Attributes
    ----------
    study : what was asked
    cells, tasks : all of them, in the order of the study
    rows : by key of a task, as far as they are done
    inputs : what the study names

    >>> study = {"routes": [[[0, 0], [60, 0]]], "noise": {"heading_deg": 2}, "vary": {"seed": [1, 2]}}
    >>> len(run_study(study).cells)
    2
    """

    study: Study
    cells: tuple[Cell, ...]
    tasks: tuple[CellTask, ...]
    rows: Mapping[str, Row]
    inputs: Inputs

    @property
    def missing(self) -> int:
        """Cells that are not done yet."""
        return sum(task.key not in self.rows for task in self.tasks)

    def to_dicts(self) -> list[dict[str, Any]]:
        """One row per cell that is done: what was varied, and what came out. It is the same whoever did the cells in
        whatever order, but for those with ``ended_by_time`` or the outcome "out of time"."""
        return [
            {"cell": cell.number, **cell.varied, **{key: row[key] for key in row if key not in _NOT_IN_TABLE}}
            for cell, task in zip(self.cells, self.tasks, strict=True)
            if (row := self.rows.get(task.key)) is not None
        ]  # fmt: skip

    def columns(self) -> dict[str, list[object]]:
        rows = self.to_dicts()
        return {key: [row.get(key, "") for row in rows] for key in dict.fromkeys(key for row in rows for key in row)}

    def words(self) -> str:
        return f"{self.study.title}: {len(self.cells)} cells, {self.missing} of them not done yet"

    def beacons(self, cell: int) -> tuple[Beacon, ...]:
        """The beacons of a cell that is done: those that were there, and those that were placed."""
        task = self.tasks[cell]
        asked, row = self.inputs.shared[task.sites], self.rows.get(task.key, {})
        if row.get("outcome") != DONE:
            raise ValueError(f"expected a cell that is done, got cell {cell}: {row.get('why', 'it is missing')}")
        placed = (Beacon(asked.all_kinds[k], x, y, id=i, facing_deg=f) for i, k, x, y, f in row.get("layout", ()))
        return (*asked.existing, *placed)

    @cached_property
    def workshop(self) -> Workshop:
        """Makes the routes of a cell again, to show them."""
        return Workshop(self.inputs.shared)


def run_study(
    study: str | os.PathLike[str] | Mapping[str, Any] | Study,
    executor: Literal["processes"] | Any | None = None,
    *,
    workers: int | None = None,
    results: str | os.PathLike[str] | None = None,
    retry: bool = False,
    progress: Progress | None = None,
) -> StudyResult:
    """Do the cells of a study that are not done yet.

    Parameters
    ----------
    study : a file, or a mapping with the keys of one (`driftplan study init` writes a commented one)
    executor : None: this process; "processes": all cores; or a ``distributed.Client`` of a Dask cluster
    workers : how many processes (default: one per core); 1 or more means "processes"
    results : the file that rows are appended to; default: the study's name with ``.results.jsonl``, beside it. A study
        that is a mapping has none unless it is named.
    retry : do failed cells again, and those that ran out of time
    progress : called after every cell with the cells done, their number, and the seconds that the rest may take

    Returns
    -------
    StudyResult
        ``table()`` has a row per cell. Rows are the same to the last bit wherever and in whatever order cells are done,
        as long as no search is ended by its time limit; a row says if it was.

    Raises
    ------
    StudyError : for a study that makes no sense, results that are no results, or another run of it
    DriftplanError : if the cluster goes away; what was done is kept

    >>> tag = {"kind": "landmark", "range_m": 2.0, "position_std_m": 0.05, "heading_std_deg": 0.5}
    >>> study = {"routes": [[[0, 0], [60, 0]]], "noise": {"heading_deg": 2, "distance_m": 0.05}, "beacon": tag,
    ...          "vary": {"limit_m": [0.6, 1.5]}}
    >>> [row["beacons"] for row in run_study(study).to_dicts()]
    [2, 1]
    """
    told = listener("progress", progress, "with cells done, their number, and seconds left")
    asked = planned_study(study, results)
    path = results_file(asked.study, results)
    with appending(path) as append:
        rows = read_rows(path)
        again = (FAILED, OUT_OF_TIME) if retry else ()
        todo = {t.key: t for t in asked.tasks if t.key not in rows or rows[t.key]["outcome"] in again}
        done = _executed(executor, workers, asked.inputs.shared, list(todo.values()))
        began = time.monotonic()
        for count, (task, row) in enumerate(done, start=1):
            append(row)
            rows[task.key] = row
            left = (time.monotonic() - began) / count * (len(todo) - count)
            told(len(asked.tasks) - len(todo) + count, len(asked.tasks), left)
    return StudyResult(asked.study, asked.cells, asked.tasks, rows, asked.inputs)


def planned_study(
    study: str | os.PathLike[str] | Mapping[str, Any] | Study, results: str | os.PathLike[str] | None = None
) -> StudyResult:
    """A study with the rows that there are, and nothing done."""
    asked = Study.of(study)
    inputs = Inputs(asked)
    cells = tuple(asked.cells())
    rows = read_rows(results_file(asked, results))
    return StudyResult(asked, cells, tuple(map(inputs.task, cells)), rows, inputs)


def results_file(study: Study, results: str | os.PathLike[str] | None) -> Path | None:
    """Where the rows of a study are."""
    if results is not None:
        return Path(results)
    return study.path.with_suffix(".results.jsonl") if study.path else None


def _executed(executor: Any, workers: int | None, shared: Mapping[str, Any], tasks: list[CellTask]) -> Done:
    if not tasks:
        return iter(())
    if hasattr(executor, "submit") and hasattr(executor, "register_plugin"):
        if workers is not None:
            raise ValueError("expected workers only for processes of this machine, got a Dask client too")
        return on_cluster(executor, shared, tasks)
    if executor not in (None, "processes"):
        raise ValueError(f'expected executor None, "processes" or a distributed.Client, got {executor!r}')
    if executor is None and workers is None:
        return here(shared, tasks)
    count = os.cpu_count() or 1 if workers is None else whole("workers", workers, least=1)
    return in_processes(shared, tasks, min(count, len(tasks)))


def read_rows(path: Path | None) -> dict[str, Row]:
    """The last row of every key, none without a file; a StudyError names a line but the last that is no row."""
    rows: dict[str, Row] = {}
    if path is None or not path.exists():
        return rows
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):  # being written, or cut off
                break
            try:
                row = json.loads(line)
                rows[row["key"]] = row
            except (ValueError, KeyError, TypeError):
                where = f"{path}, line {number}"
                raise StudyError(f"{where}: expected a row of a study's results, got {line[:60]!r}") from None
    return rows


@contextmanager
def appending(path: Path | None) -> Iterator[Callable[[Row], None]]:
    """What appends rows to a file, if there is one; a StudyError if another process is adding to it."""
    if path is None:
        yield lambda row: None
        return
    with path.open("a+b", buffering=0) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise StudyError(f"{path}: another run is adding to these results: wait for it or end it") from None
        if file.seek(0, os.SEEK_END):
            with mmap(file.fileno(), 0, access=ACCESS_READ) as content:
                whole_lines = content.rfind(b"\n") + 1
            file.truncate(whole_lines)

        def append(row: Row) -> None:
            """In one write: once this returns, killing the process does not lose it."""
            line = json.dumps(row, allow_nan=False, separators=(",", ":")).encode() + b"\n"
            if file.write(line) != len(line):
                raise OSError("a row could not be written whole: is the disk full?")

        yield append
