"""``driftplan predict``: drift along given paths."""

from __future__ import annotations

import argparse
from typing import Any

from driftplan.report.commands import shared
from driftplan.report.commands.answer import Answer
from driftplan.report.commands.option import Command, Group, Option, geojson_file, input_file, label, metres


def run(args: argparse.Namespace) -> Answer:
    """Drift at every waypoint, or at the distances asked for."""
    from driftplan import drift_with_beacons, load_beacons, predict_drift, read_path
    from driftplan.report.figures.routes import plot_comparison
    from driftplan.report.records import beyond_linear_text, drift_table

    noise, heading = shared.noise_from(args), shared.start_heading_from(args)
    given: dict[str, Any] = {"start_heading": heading, "estimator": args.estimator}
    paths = [read_path(file, variable=args.variable) for file in args.paths]
    if args.beacons:
        beacons = load_beacons(args.beacons)
        drifts = [drift_with_beacons(path, noise, beacons, **given) for path in paths]
    else:
        drifts = [predict_drift(path, noise, **given) for path in paths]
    files = [label(file) for file in args.paths]
    points = [drift.at(args.at) if args.at else drift for drift in drifts]
    shown = list(zip(files, drifts, points, strict=True))
    asked = {"most": len(args.at)} if args.at else {}

    def payload() -> dict[str, Any]:
        told = [
            {"file": file, "length_m": float(drift.length), "points": at.to_dicts()}
            | {"beyond_linear_m": drift.beyond_linear.tolist()}
            for file, drift, at in shown
        ]
        return {"noise": noise.given(), "estimator": args.estimator, "paths": told}

    return Answer(
        payload=payload,
        text=lambda: "\n\n".join(
            f"{file}: {float(drift.length):.2f} m\n{drift_table(at, **asked)}{beyond_linear_text(drift)}"
            for file, drift, at in shown
        ),
        files={"picture": lambda: plot_comparison(None, dict(zip(files, drifts, strict=True)))},
    )


# fmt: off
COMMAND = Command(
    summary="drift along given paths",
    description="Predict the drift of odometry along paths, at every waypoint or at chosen distances.",
    run=run,
    arguments=(
        Option("paths", "PATH.csv", "waypoints x,y or poses x,y,heading: metres, radians, one per line; or recorded "
               "drives, as `driftplan fit` reads them; - is standard input", input_file, how={"nargs": "+"}),
    ),
    groups=(
        Group("", (
            Option("variable", "NAME", "ROS topic with the drives of bags, or MATLAB variable, where there are several",
                   str),
            Option("at", "S", "only after S metres; several: S,S,... (default: every waypoint)", metres),
            shared.START_HEADING,
            Option("beacons", "FILE.geojson", "beacons that are read on the way", geojson_file),
            shared.ESTIMATOR,
        )),
        *shared.NOISE,
    ),
    files={"picture": "draw the paths, their error ellipses and their drift against distance"},
    examples=("path.csv --heading-deg 2 --after-m 10", "- --noise noise.yaml --at 10,20,50 --json < path.csv"),
)
