"""``driftplan maps``: the maps that come along."""

from __future__ import annotations

import argparse
from typing import Any

from driftplan.report.commands.answer import Answer
from driftplan.report.commands.option import Command
from driftplan.tables import table


def run(args: argparse.Namespace) -> Answer:
    """Names, sizes and files."""
    from driftplan import bundled_map, bundled_maps, load_world

    rows: list[dict[str, Any]] = []
    for name in bundled_maps():
        world, file = load_world(bundled_map(name), robot_radius=0.0), str(bundled_map(name))
        xmin, ymin, xmax, ymax = world.bounds
        held = {"obstacles": len(world.obstacles.geoms), "zones": len(world.zones), "file": file}
        rows.append({"name": name, "width_m": xmax - xmin, "height_m": ymax - ymin, **held})

    def text() -> str:
        columns = {key.replace("_m", " m").replace("name", "map"): [row[key] for row in rows] for key in rows[0]}
        return table({key: [f"{v:g}" if isinstance(v, float) else v for v in cells] for key, cells in columns.items()})

    return Answer(payload=lambda: {"maps": rows}, text=text)


COMMAND = Command(
    summary="the maps that come along",
    description="List the maps that come along, and their sizes in metres.",
    run=run,
    examples=("", "--json"),
)
