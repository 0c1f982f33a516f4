"""``driftplan examples``: inputs to start from."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from driftplan.report.commands.answer import Answer
from driftplan.report.commands.option import Command, Option

_WHAT = {
    "route.csv": "a route through the warehouse: predict, place",
    "other.csv": "another: predict, place",
    "trips.csv": "four trips and how often they are driven: design",
    "study.yaml": "how many tags for which robot, at which accuracy: study",
    "drive1_odometry.csv": "a recorded drive (simulated, with one slip): fit",
    "drive1_truth.csv": "where that drive really went: fit",
    "drive2_odometry.csv": "another drive of the same robot: fit",
    "drive2_truth.csv": "where it really went: fit",
    "warehouse.yaml": "a map of ROS map_server: plan, compare, place, design",
    "warehouse.pgm": "its picture",
    "office.geojson": "a map with a zone of carpet: plan, compare, place, design",
}


def run(args: argparse.Namespace) -> Answer:
    """Copies of the files that come along."""
    from driftplan import bundled_map

    folder = Path(args.folder)
    present = [name for name in _WHAT if (folder / name).exists()]
    if present:
        raise ValueError(f"expected a folder without {present[0]}, which would be overwritten, got {folder}")
    folder.mkdir(parents=True, exist_ok=True)
    package, maps = Path(__file__).parents[2], bundled_map("office").parent
    kept = {"study.yaml": package / "layouts/study/sample.yaml"}
    files: dict[str | Path, Callable[[], bytes]] = {
        folder / name: kept.get(name, (package / "samples" if name.endswith(".csv") else maps) / name).read_bytes
        for name in _WHAT
    }
    width = max(map(len, _WHAT))
    return Answer(
        payload=lambda: {"files": [{"file": str(folder / name), "what": what} for name, what in _WHAT.items()]},
        text=lambda: "\n".join(f"{name:{width}}  {what}" for name, what in _WHAT.items()),
        files=files,
    )


COMMAND = Command(
    summary="copy a map, routes, trips and two recorded drives into a folder, to try the other commands on",
    description="Copy ready inputs for the other commands into a folder: a map, routes, trips, and two drives of an "
    "invented robot with the truth beside its odometry. Nothing that is there already is overwritten.",
    run=run,
    arguments=(Option("folder", "DIR", "the folder, made if it is not there", str),),
    examples=("first-hour", "first-hour --json"),
)
