"""Studies: the file of rows as JSON lines and as SQLite; what a worker's memory and a cell's time grow with; what cells
that share their stations save."""

from __future__ import annotations

import json
import re
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from driftplan.layouts.study.run import appending, planned_study, read_rows
from driftplan.layouts.study.work import Workshop

ROWS = 10_000
BASE: dict[str, Any] = {
    "map": "warehouse",
    "noise": {"heading_deg": 2, "distance_m": 0.05},
    "trips": {"random": 6},
    "beacon": {"kind": "rfid", "range_m": 1.5, "position_std_m": 0.1},
    "sites": {"spacing_m": 2.0},
    "vary": {"limit_m": [0.9, 1.1, 1.3]},
}
GROWTH = {
    "3 routes": {"trips": {"random": 3}},
    "6 routes": {},
    "12 routes": {"trips": {"random": 12}},
    "48 routes": {"trips": {"random": 48}},
    "sites 4 m apart": {"sites": {"spacing_m": 4.0}},
    "sites 1 m apart": {"sites": {"spacing_m": 1.0}},
    "sites 0.5 m apart": {"sites": {"spacing_m": 0.5}},
}


def some_row(number: int) -> dict[str, Any]:
    """As long as those of the warehouse."""
    layout = [[f"S{number + k}", 0, 0.1 * k, 0.2 * k, None] for k in range(5)]
    drifts = {"worst_drift_m": 0.1 * number, "route_m": 200.0, "routes": 6, "beacons": 5, "cost": 5.0}
    return {"key": f"{number:032x}", "outcome": "done", **drifts, "layout": layout, "spent": {"seconds": 0.1}}


def json_lines(folder: Path) -> Callable[[], int]:
    with appending(folder / "rows.jsonl") as append:
        for k in range(ROWS):
            append(some_row(k))
    return lambda: len(read_rows(folder / "rows.jsonl"))


def sqlite(folder: Path) -> Callable[[], int]:
    """A commit per row, since a killed process may lose none; the log written ahead, without waiting for the disk."""
    with sqlite3.connect(folder / "rows.sqlite", isolation_level=None) as base:
        base.execute("pragma journal_mode=wal")
        base.execute("pragma synchronous=off")
        base.execute("create table rows (key text primary key, row text)")
        for k in range(ROWS):
            row = some_row(k)
            base.execute("insert or replace into rows values (?, ?)", (row["key"], json.dumps(row)))

    def read() -> int:
        with sqlite3.connect(folder / "rows.sqlite") as again:
            return len({key: json.loads(row) for key, row in again.execute("select key, row from rows")})

    return read


def rows_kept(way: Callable[[Path], Callable[[], int]]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder, begin = Path(name), time.process_time()
        read = way(folder)
        written = time.process_time() - begin
        begin = time.process_time()
        assert read() == ROWS
        size = sum(file.stat().st_size for file in folder.iterdir())
        print(f"{way.__name__:>12} {1e6 * written / ROWS:9.1f} {time.process_time() - begin:9.3f} {size / 1e6:9.1f}")


def grown(change: dict[str, Any]) -> str:
    """Of a process that does the cells twice: with stations shared, and each anew."""
    plan = planned_study({**BASE, **change})
    shop, begin = Workshop(plan.inputs.shared), time.process_time()
    shop.routes(plan.tasks[0])
    planned = time.process_time() - begin
    shop.row(plan.tasks[0])  # imports, and what the map is asked once
    seconds = []
    for shared in (True, False):
        begin = time.process_time()
        for task in plan.tasks:
            if not shared:
                shop._kept.clear()
            shop.row(task)
        seconds.append((time.process_time() - begin) / len(plan.tasks))
    peak = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())
    assert peak is not None
    number = len(next(iter(shop._kept.values())).beacons)
    return f"{number:6d} {seconds[0]:9.2f} {seconds[1]:9.2f} {planned:9.2f} {int(peak[1]) / 1000:8.0f}"


def main() -> None:
    if len(sys.argv) > 2:  # a process of its own, whose memory is its own
        return print(grown(json.loads(sys.argv[2])))
    print(f"{ROWS} rows: us a row written, s to read all, MB")
    rows_kept(json_lines)
    rows_kept(sqlite)
    for estimator in ("reset", "filter"):
        print(f"\n{estimator}: sites, processor s of a cell (stations shared; anew), of planning its routes, peak MB")
        for name, change in GROWTH.items():
            asked = json.dumps({**change, "estimator": estimator})
            command = [sys.executable, "-m", "tests.benchmarks.bench_study", "grow", asked]
            told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            print(f"{name:>18} {told.strip()}", flush=True)
    return None


if __name__ == "__main__":
    main()
