"""What Dask's workers hold and do; imported only with `distributed`, from the extra ``[cluster]``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from distributed import WorkerPlugin

from driftplan.errors import DriftplanError
from driftplan.layouts.study.executors import Child, kept_shared
from driftplan.layouts.study.inputs import CellTask, sources_digest
from driftplan.layouts.study.work import Row

_KEPT: dict[str, KeepShared] = {}  # of this worker process, by study


class KeepShared(WorkerPlugin):  # type: ignore[misc]
    """Brings the shared inputs to a worker, once, and keeps the children that do the cells there; the scheduler has it
    for workers that come later."""

    def __init__(self, name: str, shared: Mapping[str, Any]) -> None:
        self.name, self._shared, self._sources = name, dict(shared), sources_digest()
        self._idle: list[Child] = []

    def setup(self, worker: Any) -> None:
        if sources_digest() != self._sources:
            what = "another driftplan than this process: install the same"
            raise DriftplanError(f"the worker {worker.address} has {what}")
        for other in _KEPT.values():  # whoever ran that may have been killed
            other.end()
        _KEPT[self.name], self._file = self, kept_shared(self._shared)

    def teardown(self, worker: Any) -> None:
        if _KEPT.pop(self.name, None):
            self.end()
            self._file.close()

    def end(self) -> None:
        """End the children that are at nothing."""
        while self._idle:
            self._idle.pop().end()

    def row(self, task: CellTask) -> Row:
        try:
            child = self._idle.pop()
        except IndexError:
            child = Child(self._file)
        child.begin(task)
        row = child.answer()
        if child.status is None:
            self._idle.append(child)
        if row is None:
            raise ChildProcessError(f"the process died over it, with status {child.status}")
        if _KEPT.get(self.name) is not self:
            self.end()
        return row


def row_on_worker(name: str, task: CellTask) -> Row:
    """A cell's row, made on the worker that this runs on."""
    return _KEPT[name].row(task)
