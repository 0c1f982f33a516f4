"""``driftplan studio``: a page on which beacons are dragged and the drift answers."""

from __future__ import annotations

import argparse
import webbrowser
from pathlib import Path

from driftplan.report.commands import shared
from driftplan.report.commands.answer import Answer, Progress, talk
from driftplan.report.commands.option import Command, Group, Idle, Option, geojson_file, label, output_file


def run(args: argparse.Namespace) -> Answer:
    """Serve the page until Ctrl-C, or write it."""
    from driftplan import load_beacons, read_path
    from driftplan.page.scene import page, scene_of
    from driftplan.report.studio import Answers, StudioServer

    world = shared.world_from(args)
    scene = scene_of(
        world,
        [read_path(file)[:, :2] for file in args.paths],
        shared.noise_from(args),
        beacons=load_beacons(args.beacons) if args.beacons else (),
        limits=[args.max_drift] * len(args.paths),
        names=[Path(label(file)).name for file in args.paths],
        estimator=args.estimator,
        start_fix=shared.start_fix_from(args),
        title=Path(label(args.map)).name,
    )
    if args.html is not None:
        return Answer(payload=lambda: {"html": str(args.html)}, text=lambda: "", files={"html": lambda: page(scene)})
    if not 0 <= args.port < 1 << 16:
        raise ValueError(f"expected port from 0 to 65535, got {args.port}")
    building = (Path(args.map), args.level) if args.map.lower().endswith(".building.yaml") else None
    answers = Answers(world=world, time_limit=args.time_limit, save=args.save, building=building)
    with StudioServer(scene, answers, args.port) as server:
        talk(f"{server.url}\nthe studio is open; Ctrl-C closes it")
        Progress.news = "the studio is open"
        if not args.no_browser:
            webbrowser.open(server.url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            talk("closed")
    return Answer(payload=lambda: {"url": server.url}, text=lambda: "")


# fmt: off
COMMAND = Command(
    summary="drag beacons on the map in a browser, and see the drift",
    description="Open a page with the map, the routes, the beacons and the drift along every route, at which every "
    "change answers at once. It is served to this machine only, and needs no network.",
    run=run,
    arguments=(shared.MAP, shared.PATHS),
    groups=(
        Group("", (
            Option("beacons", "FILE.geojson", "beacons to begin with", geojson_file),
            Option("max_drift", "M", "limit on the rms drift of every route, metres"),
            shared.ESTIMATOR,
            *shared.START_SPREAD,
            Option("save", "FILE.geojson", "where the page's button Save writes the beacons (default: there is none)",
                   output_file),
            Option("time_limit", "S", "seconds to search for the fewest beacons", default=60.0),
            Option("port", "N", "of the server (default: one that is free)", int, 0),
            Option("no_browser", "", "do not open a browser, only say the address"),
        )),
        shared.WORLD,
        *shared.NOISE,
    ),
    files={"html": "write the page, which then works without Python, instead of serving it"},
    idle=(Idle(("save", "port", "no_browser", "time_limit"), lambda args: args.html is not None,
               "with --html the page is written, not served"),),
    examples=("warehouse route.csv --max-drift 0.6 --save tags.geojson",
              "site.yaml a.csv b.csv --beacons tags.geojson --noise noise.yaml --html layout.html"),
)
