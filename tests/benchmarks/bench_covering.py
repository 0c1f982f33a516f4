"""The covering core on OR-Library's set covers: cost found, bound and time, beside the best known.

Reads the files from the folder ``../shared/data/orlib`` or the one that DRIFTPLAN_ORLIB names; 60 s each at most.
"""

from __future__ import annotations

import gzip
import os
import time
from pathlib import Path

import numpy as np

from driftplan.layouts.placement.covering import cheapest_cover
from driftplan.layouts.placement.cut_pool import Cut

FOLDER = Path(os.environ.get("DRIFTPLAN_ORLIB", Path(__file__).parents[3] / "shared" / "data" / "orlib"))
BEST_KNOWN = {
    "scp41": 429,
    "scp51": 253,
    "scp61": 138,
    "scpa1": 253,
    "scpe1": 5,
    "scpe2": 5,
    "scpclr10": 25,
    "scpnrg1": 176,
    "sts45": 30,
    "rail507": 174,
}
LIMIT_S = 60.0


class Rows:
    """An oracle for a plain set cover, all of whose rows are told at once."""

    def __init__(self, rows: list[np.ndarray]):
        self.cuts_of_rows = [Cut(row, np.ones(len(row)), 1.0) for row in rows]

    def cuts(self, chosen: np.ndarray, near: int | None = None) -> list[Cut]:
        """The rows that are not covered."""
        return [cut for cut in self.cuts_of_rows if not chosen[cut.columns].any()]


def read(name: str) -> tuple[np.ndarray, list[np.ndarray]]:
    """Costs, and the columns that cover each row, counted from 0."""
    with gzip.open(FOLDER / f"{name}.txt.gz", "rt") as file:
        numbers = np.array(file.read().split(), dtype=int)
    if name.startswith("sts"):
        return np.ones(numbers[0]), list(numbers[2:].reshape(-1, 3) - 1)
    rows, columns = numbers[:2].tolist()
    if name.startswith("rail"):
        return _by_column(numbers[2:], rows, columns)
    cost, rest = numbers[2 : 2 + columns].astype(float), numbers[2 + columns :]
    found = []
    while len(rest):
        found.append(np.sort(rest[1 : 1 + rest[0]] - 1))
        rest = rest[1 + rest[0] :]
    return cost, found


def _by_column(numbers: np.ndarray, rows: int, columns: int) -> tuple[np.ndarray, list[np.ndarray]]:
    cost, covers, at = np.zeros(columns), [[] for _ in range(rows)], 0
    for column in range(columns):
        cost[column], count = numbers[at : at + 2].tolist()
        for row in numbers[at + 2 : at + 2 + count].tolist():
            covers[row - 1].append(column)
        at += 2 + count
    return cost, [np.array(row) for row in covers]


def main() -> None:
    """Print the table."""
    print(f"{'instance':>10} {'rows':>5} {'columns':>8} {'best known':>11} {'found':>6} {'bound':>7} {'seconds':>8}")
    for name, best in BEST_KNOWN.items():
        if not (FOLDER / f"{name}.txt.gz").exists():
            print(f"{name:>10} is not in {FOLDER}")
            continue
        cost, rows = read(name)
        oracle, begin = Rows(rows), time.perf_counter()
        found = cheapest_cover(cost, oracle, demands=oracle.cuts_of_rows, time_limit=LIMIT_S)
        took = time.perf_counter() - begin
        print(
            f"{name:>10} {len(rows):5d} {len(cost):8d} {best:11d} {found.cost:6g} {found.lower_bound:7g} {took:8.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
