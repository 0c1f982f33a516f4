"""``driftplan demo``: routes through the maps that come along, and the fewest tags for rounds through the warehouse."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.errors import InfeasibleError
from driftplan.report.commands import shared
from driftplan.report.commands.answer import Answer, talk
from driftplan.report.commands.compare import both, compared, rows_of
from driftplan.report.commands.option import Command, Group, Option
from driftplan.report.records import record
from driftplan.tables import counted

if TYPE_CHECKING:
    from collections.abc import Callable

    from driftplan import Layout, OdometryNoise, World
    from driftplan.model.readings import Estimator

RADIUS_M = 0.3
ITERATIONS = 4  # near the optimum of both maps; counted, so that a slow machine shows no worse ones
ESTIMATORS: dict[Estimator, str] = {
    "reset": "A robot whose readings replace its errors",
    "filter": "A robot that fuses its readings in a filter",
}
TRIPS = {"warehouse": ((51.0, 33.0), (23.5, 18.7)), "office": ((36.0, 12.0), (6.0, 5.0))}
ROUNDS = (  # waypoints in metres: from the docks and gates into the aisles, some of them there and back
    ((2.5, 38), (2.5, 36), (8, 34), (8, 13.4), (46, 13.4), (8, 13.4), (8, 3)),
    ((3, 3), (8, 8), (8, 23.8), (46, 23.8), (8, 23.8), (8, 36)),
    ((46, 37), (10, 36), (8, 34), (8, 19), (8, 3), (58, 3)),
    ((50.8, 30), (50.8, 11), (48, 9), (22, 9), (21.5, 13.4), (21.5, 18), (23.5, 18.7)),
    ((57.5, 29.5), (50.5, 30.2), (47.5, 29.8), (8, 29.8), (8, 19.4), (46, 19.4)),
)
LIMIT_M = 0.8
_TIME_LIMIT_S = 60.0  # it takes a few


def run(args: argparse.Namespace) -> Answer:
    """Lowest-drift against shortest routes, then tags."""
    from driftplan import bundled_map, load_world
    from driftplan.report.figures.layouts import layouts_figure
    from driftplan.report.figures.routes import plot_comparison

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
    tags = {robot: demo_layout(worlds["warehouse"], noise, robot) for robot in ESTIMATORS}
    layouts = {ESTIMATORS[robot]: layout for robot, layout in tags.items() if not isinstance(layout, str)}
    pictures: dict[str | Path, Callable[[], Any]] = {}
    for name, routes in found.items():
        pictures[folder / f"{name}.{args.form}"] = partial(plot_comparison, worlds[name], routes)
    if layouts:
        pictures[folder / f"warehouse-tags.{args.form}"] = partial(layouts_figure, layouts)

    def text() -> str:
        tables = [f"{name}\n{compared(routes, worlds[name])}\n" for name, routes in found.items()]
        told = [f"{ESTIMATORS[robot]}: {sentence(layout)}" for robot, layout in tags.items()]
        return "\n".join([*tables, *told])

    return Answer(
        payload=lambda: {
            "noise": noise.given(),
            "maps": {name: rows_of(routes, worlds[name]) for name, routes in found.items()},
            "tags": {robot: as_json(layout) for robot, layout in tags.items()},
            "files": [str(path) for path in pictures],
        },
        text=text,
        files=pictures,
    )


def demo_layout(world: World, noise: OdometryNoise, estimator: Estimator = "reset") -> Layout | str:
    """The fewest tags that keep every round under `LIMIT_M`, or in words why there are none."""
    from driftplan import BeaconKind, Sites, place_beacons

    if noise.step_m is not None:
        return "no beacons are placed: that takes noise per metre, not per step"
    tag = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    try:
        asked: dict[str, Any] = {"estimator": estimator, "time_limit": _TIME_LIMIT_S}
        return place_beacons(world, ROUNDS, noise, LIMIT_M, Sites(tag, spacing_m=1.5), **asked)
    except InfeasibleError as err:
        return f"no tags keep the drift of all rounds under {LIMIT_M:g} m with this odometry: {err}"


def sentence(layout: Layout | str) -> str:
    """What was found, in a line."""
    if isinstance(layout, str):
        return layout
    bare = max(layout.scenario.worst(layout.scenario.drift(r, ())) for r in range(len(layout.drifts)))
    keep = "keeps" if len(layout.beacons) == 1 else "keep"
    kept = f"{counted(len(layout.beacons), 'RFID tag')} {keep} the drift of {len(ROUNDS)} rounds under {LIMIT_M:g} m"
    proof = "no fewer will do" if layout.proven else f"at least {layout.lower_bound:g} are needed"
    return f"{kept} everywhere ({proof}); without tags it reaches {bare:.2f} m"


def as_json(layout: Layout | str) -> dict[str, Any]:
    """The layout by the names of ``driftplan place --json``."""
    if isinstance(layout, str):
        return {"none": layout}
    beacons = [record(beacon, "id", "x_m", "y_m") for beacon in layout.beacons]
    return {"beacons": beacons, "limit_m": LIMIT_M, **record(layout, "lower_bound", "proven", "worst_drift_m")}


# fmt: off
COMMAND = Command(
    summary="lowest-drift against shortest routes on the maps that come along, and RFID tags: tables and pictures",
    description="Plan the lowest-drift and the shortest route on the maps that come along, compare and draw them; "
    "then place the fewest RFID tags that keep five rounds through the warehouse under 0.8 m of drift, for a robot "
    "without a filter and for one with. Without --time-limit and --iterations the roadmap ends after 4 batches, on a "
    "fast machine or a slow one.",
    run=run,
    groups=(
        Group("", (
            Option("folder", "DIR", "where the pictures go; made if there is none", str, "driftplan-demo"),
            Option("form", "FORM", "of the pictures", str, "png", choices=("png", "svg", "pdf")),
        )),
        Group("planning", shared.SEARCH),
        *shared.NOISE,
    ),
    examples=("", "--folder pictures --heading-deg 2"),
)
