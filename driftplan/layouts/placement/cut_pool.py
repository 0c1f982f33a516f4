"""Linear cuts over 0/1 columns, pooled as one sparse matrix that grows, and the few of them a relaxation needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import Bools, Floats, Ints

EPS = 1e-6  # activities of rows are compared with this much room
_ALL_AT_ONCE = 512  # rows: up to here it does not pay to be choosy
_OVERLAP = 8  # rows that join at one time share a column with at most this many others


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """Σ weights · y[columns] >= least. ``where`` is whatever tells the caller what the cut is about."""

    columns: Ints
    weights: Floats
    least: float
    where: tuple[int, int] = (-1, -1)

    @property
    def hopeless(self) -> bool:
        """Whether no layout at all satisfies it."""
        return float(np.maximum(self.weights, 0.0).sum()) < self.least - EPS


class Oracle(Protocol):
    """Judge of whole layouts."""

    def cuts(self, chosen: Bools, near: int | None = None) -> Sequence[Cut]:
        """Cuts that ``chosen`` violates and no acceptable layout does; none if it is acceptable.

        With ``near``, only what can have changed by adding or removing that site needs to be looked at.
        """
        ...


class CutPool:
    """Cuts, none twice. Some are active: those that the relaxation holds; the others only have to be satisfied too."""

    def __init__(self, columns: int, cuts: Sequence[Cut]):
        self.columns = columns
        self.cuts: list[Cut] = []
        self.active = np.zeros(0, dtype=bool)
        self._seen: set[tuple[bytes, bytes, float]] = set()
        self._built: tuple[Any, Any, Floats] | None = None
        self.add(cuts, active=False)
        self._begin()

    def add(self, cuts: Sequence[Cut], *, active: bool = True) -> None:
        """Take in cuts that are new."""
        for cut in cuts:
            key = cut.columns.tobytes(), cut.weights.tobytes(), cut.least
            if key not in self._seen:
                self._seen.add(key)
                self.cuts.append(cut)
        fresh = len(self.cuts) - len(self.active)
        self.active = np.concatenate([self.active, np.full(fresh, active)])
        self._built = None if fresh else self._built

    @property
    def matrix(self) -> tuple[Any, Any, Floats]:
        """All rows as CSR and as CSC, and their least activities."""
        from scipy.sparse import csr_array

        if self._built is None:
            sizes = [len(cut.columns) for cut in self.cuts]
            data = np.concatenate([np.zeros(0), *(cut.weights for cut in self.cuts)])
            index = np.concatenate([np.zeros(0, dtype=np.intp), *(cut.columns for cut in self.cuts)])
            starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)
            rows = csr_array((data, index, starts), (len(sizes), self.columns))
            least = np.array([cut.least for cut in self.cuts], dtype=float)
            self._built = (rows, rows.tocsc(), least)
        return self._built

    def missing(self, y: NDArray[Any]) -> Floats:
        """By how much every row is missed (negative: exceeded)."""
        rows, _, least = self.matrix
        return np.asarray(least - rows @ y, dtype=float)

    def satisfied(self, y: NDArray[Any]) -> bool:
        return bool((self.missing(y) <= EPS).all())

    def activate(self, y: NDArray[Any]) -> bool:
        """Let the rows that ``y`` misses most join, as long as they differ; False if it misses none."""
        missing = self.missing(y)
        missed = np.flatnonzero((missing > EPS) & ~self.active)
        self._join(missed[np.argsort(-missing[missed], kind="stable")], _OVERLAP)
        return bool(len(missed))

    def gain(self, missing: Floats) -> Floats:
        """How much of what rows miss each column would give: a row of weight w that misses m gets min(w, m)."""
        _, by_column, _ = self.matrix
        short = np.maximum(missing, 0.0)[by_column.indices]
        given = np.where(short > EPS, np.minimum(by_column.data, short), 0.0)
        return np.asarray(np.bincount(self._column_of(by_column), weights=given, minlength=self.columns), dtype=float)

    def column(self, site: int) -> Floats:
        """The weights of one column in all rows."""
        return np.asarray(self.matrix[1][:, [site]].toarray()[:, 0], dtype=float)

    def forbids(self, room: Floats) -> Bools:
        """Columns whose addition some row, of which ``room`` is left, does not allow."""
        _, by_column, _ = self.matrix
        over = by_column.data + room[by_column.indices] < -EPS
        forbidden = np.zeros(self.columns, dtype=bool)
        forbidden[self._column_of(by_column)[over]] = True
        return forbidden

    def _column_of(self, by_column: Any) -> Ints:
        """The column of every entry."""
        return np.repeat(np.arange(self.columns), np.diff(by_column.indptr))

    def _begin(self) -> None:
        """The rows a relaxation starts with: all if they are few, else short ones that share no column."""
        if len(self.cuts) <= _ALL_AT_ONCE:
            self.active[:] = True
            return
        rows, _, _ = self.matrix
        self._join(np.argsort(np.diff(rows.indptr), kind="stable"), 0)

    def _join(self, order: Ints, overlap: int) -> None:
        rows, _, _ = self.matrix
        load = np.zeros(self.columns, dtype=int)
        for i in order.tolist():
            columns = rows.indices[rows.indptr[i] : rows.indptr[i + 1]]
            if not len(columns) or load[columns].max() <= overlap:
                self.active[i] = True
                load[columns] += 1
