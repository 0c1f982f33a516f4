"""Where cells are done: in this process, in processes of this machine, on a Dask cluster. Each takes the shared inputs
and tasks, and gives every task back with its row, in any order; rows do not depend on which, nor on the order."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from multiprocessing.connection import Pipe, wait
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

from driftplan.errors import DriftplanError
from driftplan.layouts.study.inputs import CellTask, digest
from driftplan.layouts.study.work import FAILED, Row, Workshop, routes_key, work_until_closed

Done = Iterator[tuple[CellTask, Row]]
_PATIENCE, _GRACE_S = 2.0, 60.0  # times a cell's limit, and then so many seconds, before its worker is ended
_TRIES = 3  # of a cell, each in another process
_WAITING = 3  # tasks per thread of a cluster that are on their way


def here(shared: Mapping[str, Any], tasks: Iterable[CellTask]) -> Done:
    """One after the other in this process."""
    workshop = Workshop(shared)
    for task in tasks:
        yield task, workshop.row(task)


def in_processes(shared: Mapping[str, Any], tasks: Sequence[CellTask], count: int) -> Done:
    """In so many processes of this machine.

    A process that dies takes the cell that it was at with it: that is tried again, after the others, and once it has
    cost three it is a row that says so. One that does not end long after its cell's time limit is ended.
    """
    deal, left, deaths = Deal(shared, tasks), len(tasks), Counter[str]()
    workers: list[Child] = []
    with kept_shared(shared) as file:
        try:
            while left:
                while len(workers) < min(count, left):
                    workers.append(Child(file))
                for worker in workers:
                    if worker.task is None and (task := deal.next(worker)) is not None:
                        worker.begin(task)
                ready = wait([worker.link for worker in workers], timeout=1.0)
                for worker in list(workers):
                    task = worker.task
                    if worker.link not in ready and (task is None or time.monotonic() < worker.until):
                        continue
                    row = worker.answer()
                    if worker.status is not None:
                        workers.remove(worker)
                    if task is None:
                        continue
                    if row is None and deaths[task.key] < _TRIES - 1:
                        deaths[task.key] += 1
                        deal.again(task)
                        continue
                    left -= 1
                    said = f"{_TRIES} workers died over it, the last with status {worker.status}"
                    yield task, row or lost(task, said)
        finally:
            for worker in workers:
                worker.end()


class Deal:
    """Tasks for workers, each of which goes on with those on the routes that it has planned. When all routes are taken
    it helps with those that most is left of."""

    def __init__(self, shared: Mapping[str, Any], tasks: Iterable[CellTask]) -> None:
        sets: dict[tuple[Any, ...], list[CellTask]] = {}
        for task in tasks:
            sets.setdefault(routes_key(shared, task), []).append(task)
        self._untouched = [those[::-1] for those in sets.values()][::-1]
        self._of: dict[Any, list[CellTask]] = {}

    def next(self, worker: Hashable) -> CellTask | None:
        """What a worker is to do; None where nothing is left."""
        mine = self._of.get(worker)
        if not mine:
            mine = self._untouched.pop() if self._untouched else max(self._of.values(), key=len, default=[])
            self._of[worker] = mine
        return mine.pop() if mine else None

    def again(self, task: CellTask) -> None:
        """A task that has to be done again, after the others."""
        self._untouched.insert(0, [task])


def kept_shared(shared: Mapping[str, Any]) -> IO[bytes]:
    """A file without a name that has the shared inputs, for children to read, however many and whenever they begin."""
    file = TemporaryFile()  # noqa: SIM115
    pickle.dump(dict(shared), file, protocol=pickle.HIGHEST_PROTOCOL)
    file.flush()
    return file


class Child:
    """A process that does one task at a time. It ends when this one does, however that ends."""

    def __init__(self, shared: IO[bytes]) -> None:
        self.link, theirs = Pipe()
        self.task: CellTask | None = None  # what it is at
        self.status: int | None = None  # how the process ended, once it has
        self.until, descriptors = 0.0, (theirs.fileno(), shared.fileno())
        paths = [str(Path(__file__).parents[3]), *filter(None, [os.environ.get("PYTHONPATH")])]
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        self._process = subprocess.Popen(
            [sys.executable, "-c", f"from {work_until_closed.__module__} import *; work_until_closed{descriptors}"],
            pass_fds=descriptors,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            process_group=0,  # Ctrl-C is for this process, which ends its workers
            env={**os.environ, **one_thread, "PYTHONPATH": os.pathsep.join(paths)},
        )
        theirs.close()

    def begin(self, task: CellTask) -> None:
        self.task, self.until = task, time.monotonic() + _PATIENCE * task.plain["time_limit_s"] + _GRACE_S
        with suppress(OSError):  # it is dead, which the answer says
            self.link.send(task)

    def answer(self) -> Row | None:
        """The row of the task, waited for; None if the process is dead. Where that is late it is ended."""
        task, self.task = self.task, None
        try:
            if self.link.poll(max(self.until - time.monotonic(), 0.0)):
                row: Row = self.link.recv()
                return row
        except (OSError, EOFError):
            self.end()
            return None
        self.end()
        return None if task is None else lost(task, "its worker was ended long after the time limit")

    def end(self) -> None:
        self._process.kill()
        self.status = self._process.wait()
        self.link.close()


def lost(task: CellTask, why: str) -> Row:
    return {"key": task.key, "outcome": FAILED, "why": f"the cell was given up: {why}", "spent": {}}


def on_cluster(client: Any, shared: Mapping[str, Any], tasks: Iterable[CellTask]) -> Done:
    """On a cluster. The shared inputs go to every worker once, those that join later too; a task is half a kilobyte.
    A worker has a child for each of its threads, so that a cell that does not end, or kills, costs that only.

    A worker that dies costs the cells it was at, which the cluster gives to others; only a cell over which several
    died is a row that says so. A DriftplanError if the scheduler goes away, or a worker has another driftplan.
    """
    from distributed import CancelledError, as_completed

    from driftplan.layouts.study.cluster import KeepShared, row_on_worker

    name = f"driftplan-{digest(sorted(shared))}"
    client.register_plugin(KeepShared(name, shared))
    deal, under_way = Deal(shared, tasks), as_completed(loop=client.loop)
    of: dict[str, tuple[CellTask, str]] = {}  # the worker that it is meant for

    def send() -> None:
        """As many as the workers there are now will soon need; if others are free these take them."""
        waiting = Counter(worker for _, worker in of.values())
        for worker, threads in (client.nthreads() or {"": 1}).items():
            where = {"workers": [worker], "allow_other_workers": True} if worker else {}
            for _ in range(_WAITING * threads - waiting[worker]):
                if (task := deal.next(worker)) is not None:
                    options = {"key": f"{name}-{task.key}", "pure": False, "retries": _TRIES - 1, **where}
                    future = client.submit(row_on_worker, name, task, **options)
                    of[future.key] = task, worker
                    under_way.add(future)

    try:
        send()
        for future in under_way:
            task, _ = of.pop(future.key)
            if future.status == "cancelled":
                raise CancelledError(future.key)
            error = future.exception()
            yield task, future.result() if error is None else lost(task, f"{type(error).__name__}: {error}")
            send()
        client.unregister_worker_plugin(name)
    except (CancelledError, OSError, TimeoutError) as err:
        gone = f"the Dask scheduler went away ({type(err).__name__})"
        raise DriftplanError(f"{gone}: what is done is kept, and the next run goes on") from err
