"""``driftplan demo``: routes through the maps that come along, and the fewest tags for rounds through the warehouse."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.report.commands import demo_beacons, shared
from driftplan.report.commands.answer import Answer, talk
from driftplan.report.commands.compare import both, compared, rows_of
from driftplan.report.commands.option import Command, Group, Option

if TYPE_CHECKING:
    from collections.abc import Callable

    from driftplan.model.readings import Estimator

RADIUS_M = 0.3
ITERATIONS = 4  # near the optimum of both maps; counted, so that a slow machine shows no worse ones
ESTIMATORS: dict[Estimator, str] = {
    "reset": "A robot whose readings replace its errors",
    "filter": "A robot that fuses its readings in a filter",
}
TRIPS = {"warehouse": ((51.0, 33.0), (23.5, 18.7)), "office": ((36.0, 12.0), (6.0, 5.0))}


def run(args: argparse.Namespace) -> Answer:
    """Lowest-drift against shortest routes, then tags."""
    from driftplan import bundled_map, load_world
    from driftplan.report.figures.comparison import plot_comparison
    from driftplan.report.figures.layouts import layouts_figure

    noise = shared.noise_from(args)
    args.start_heading_deg = None
    if args.planner == shared.DEFAULT_PLANNER and args.time_limit is None and args.iterations is None:
        args.iterations = ITERATIONS
    folder = Path(args.folder)
    folder.mkdir(parents=True, exist_ok=True)
    worlds = {name: load_world(bundled_map(name), robot_radius=RADIUS_M) for name in TRIPS}
    found = {}
    for name, trip in TRIPS.items():
        talk(f"planning on {name} with {args.planner}{shared.search_effort(args)}")
        found[name] = both(worlds[name], *trip, noise, args, args.planner)
    talk("placing RFID tags in warehouse")
    tags = {robot: demo_beacons.demo_layout(worlds["warehouse"], noise, robot) for robot in ESTIMATORS}
    layouts = {ESTIMATORS[robot]: layout for robot, layout in tags.items() if not isinstance(layout, str)}
    pictures: dict[str | Path, Callable[[], Any]] = {
        folder / f"{name}.png": partial(plot_comparison, worlds[name], routes) for name, routes in found.items()
    }
    if layouts:
        pictures[folder / "warehouse-tags.png"] = partial(layouts_figure, layouts)

    def text() -> str:
        tables = [f"{name}\n{compared(routes, worlds[name])}\n" for name, routes in found.items()]
        told = [f"{ESTIMATORS[robot]}: {demo_beacons.sentence(layout)}" for robot, layout in tags.items()]
        return "\n".join([*tables, *told])

    return Answer(
        payload=lambda: {
            "noise": shared.noise_as_json(noise),
            "maps": {name: rows_of(routes, worlds[name]) for name, routes in found.items()},
            "tags": {robot: demo_beacons.as_json(layout) for robot, layout in tags.items()},
            "files": [str(path) for path in pictures],
        },
        text=text,
        files=pictures,
    )


# fmt: off
COMMAND = Command(
    name="demo",
    summary="lowest-drift against shortest routes on the maps that come along, and RFID tags: tables and pictures",
    description="Plan the lowest-drift and the shortest route on the maps that come along, compare and draw them; "
    "then place the fewest RFID tags that keep five rounds through the warehouse under 0.8 m of drift, for a robot "
    "without a filter and for one with. Without "
    "--time-limit and --iterations the roadmap ends after 4 batches, on a fast machine or a slow one.",
    run=run,
    groups=(
        Group("", (Option("folder", "DIR", "where the pictures go; made if there is none", str, "driftplan-demo"),)),
        Group("planning", shared.SEARCH),
        *shared.NOISE,
    ),
    examples=("", "--folder pictures --heading-deg 2"),
)
