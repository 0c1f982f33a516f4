"""What Dask's workers hold and do; imported only with `distributed`, from the extra ``[cluster]``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from distributed import WorkerPlugin

from driftplan.layouts.study.inputs import CellTask
from driftplan.layouts.study.work import Row, Workshop

_SHOPS: dict[str, Workshop] = {}  # of this worker process, by study


class KeepShared(WorkerPlugin):  # type: ignore[misc]
    """Brings the shared inputs to a worker, once; the scheduler has it for those that come later."""

    def __init__(self, name: str, shared: Mapping[str, Any]) -> None:
        self.name, self._shared = name, shared

    def setup(self, worker: Any) -> None:
        _SHOPS[self.name] = Workshop(self._shared)

    def teardown(self, worker: Any) -> None:
        _SHOPS.pop(self.name, None)


def row_on_worker(name: str, task: CellTask) -> Row:
    """A cell's row, made on the worker that this runs on."""
    return _SHOPS[name].row(task)
