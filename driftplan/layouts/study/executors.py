"""Where cells are done: in this process, in processes of this machine, on a Dask cluster. Each takes the shared inputs
and tasks, and gives every task back with its row, in any order; rows do not depend on which, nor on the order."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import islice
from multiprocessing.connection import Pipe, wait
from pathlib import Path
from typing import Any

from driftplan.errors import DriftplanError
from driftplan.layouts.study.inputs import CellTask, digest
from driftplan.layouts.study.work import FAILED, Row, Workshop, row_of

Done = Iterator[tuple[CellTask, Row]]
_PATIENCE, _GRACE_S = 2.0, 60.0  # times a cell's limit, and then so many seconds, before its worker is ended
_TRIES = 3  # of a cell, each in another process
_WAITING = 3  # tasks per thread of a cluster that are on their way


def here(shared: Mapping[str, Any], tasks: Iterable[CellTask]) -> Done:
    """One after the other in this process."""
    workshop = Workshop(shared)
    for task in tasks:
        yield task, workshop.row(task)


# Processes


def in_processes(shared: Mapping[str, Any], tasks: Iterable[CellTask], count: int) -> Done:
    """In so many processes of this machine.

    A process that dies takes the cell that it was at with it: that is tried again, after the others, and once it has
    cost three it is a row that says so. One that does not end long after its cell's time limit is ended.
    """
    todo = [(task, 1) for task in tasks][::-1]
    workers: list[_Worker] = []
    try:
        while todo or any(worker.task for worker in workers):
            while todo and len(workers) < count:
                workers.append(_Worker(shared))
            for worker in workers:
                if todo and worker.task is None:
                    worker.begin(*todo.pop())
            ready = wait([worker.link for worker in workers], timeout=1.0)
            for worker in list(workers):
                task, late = worker.task, worker.late
                if worker.link not in ready and not late:
                    continue
                row = None if late else worker.answer()
                if row is None:
                    worker.end()
                    workers.remove(worker)
                if task is None:
                    continue
                if row is not None:
                    yield task, row
                elif late:
                    yield task, _lost(task, "its worker was ended long after the time limit")
                elif worker.attempt < _TRIES:
                    todo.insert(0, (task, worker.attempt + 1))
                else:
                    yield task, _lost(task, f"{_TRIES} workers died over it, the last with status {worker.status}")
    finally:
        for worker in workers:
            worker.end()


class _Worker:
    """A process that does one task at a time. It ends when this one does, however that ends."""

    def __init__(self, shared: Mapping[str, Any]) -> None:
        self.link, theirs = Pipe()
        self.task: CellTask | None = None
        self.attempt, self._until, self.status = 0, 0.0, 0
        paths = [str(Path(__file__).parents[3]), *filter(None, [os.environ.get("PYTHONPATH")])]
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "driftplan.layouts.study.worker", str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            process_group=0,  # Ctrl-C is for this process, which ends its workers
            env={**os.environ, **one_thread, "PYTHONPATH": os.pathsep.join(paths)},
        )
        theirs.close()
        self._send(dict(shared))

    def _send(self, thing: Any) -> None:
        with suppress(OSError):  # it is dead, which the next answer says
            self.link.send(thing)

    def begin(self, task: CellTask, attempt: int) -> None:
        self.task, self.attempt = task, attempt
        self._until = time.monotonic() + _PATIENCE * task.plain["time_limit_s"] + _GRACE_S
        self._send(task)

    @property
    def late(self) -> bool:
        return self.task is not None and time.monotonic() > self._until

    def answer(self) -> Row | None:
        """The row of the task; None if the process is dead."""
        self.task = None
        try:
            row: Row = self.link.recv()
        except (OSError, EOFError):
            return None
        return row

    def end(self) -> None:
        self._process.kill()
        self.status = self._process.wait()
        self.link.close()


def _lost(task: CellTask, why: str) -> Row:
    return row_of(task, {"outcome": FAILED, "why": f"the cell was given up: {why}"}, {})


# Dask


def on_cluster(client: Any, shared: Mapping[str, Any], tasks: Iterable[CellTask]) -> Done:
    """On a cluster. The shared inputs go to every worker once, those that join later too; a task is half a kilobyte.

    A worker that dies costs the cells it was at, which the cluster gives to others; only a cell over which several
    died is a row that says so.

    Raises
    ------
    DriftplanError : if the scheduler goes away
    """
    from distributed import CancelledError, as_completed

    from driftplan.layouts.study.cluster import KeepShared, row_on_worker

    name = f"driftplan-{digest(sorted(shared))}"
    client.register_plugin(KeepShared(name, dict(shared)))
    todo, of, under_way = iter(tasks), dict[str, CellTask](), as_completed(loop=client.loop)

    def send() -> None:
        """As many as the workers there are now will soon need."""
        room = _WAITING * max(sum(client.nthreads().values()), 1) - len(of)
        for task in islice(todo, max(room, 0)):
            future = client.submit(row_on_worker, name, task, key=f"{name}-{task.key}", pure=False)
            of[future.key] = task
            under_way.add(future)

    try:
        send()
        for future in under_way:
            task = of.pop(future.key)
            if future.status == "cancelled":
                raise CancelledError(future.key)
            error = future.exception()
            yield task, future.result() if error is None else _lost(task, f"{type(error).__name__}: {error}")
            send()
        client.unregister_worker_plugin(name)
    except (CancelledError, OSError, TimeoutError) as err:
        raise DriftplanError(
            f"the Dask scheduler went away ({type(err).__name__}): what is done is kept, and the next run goes on"
        ) from err
