"""``driftplan predict``: drift along given paths."""

from __future__ import annotations

import argparse

from driftplan.report.commands import shared
from driftplan.report.commands.answer import Answer
from driftplan.report.commands.option import Command, Group, Option, metres


def run(args: argparse.Namespace) -> Answer:
    """Drift at every waypoint, or at the distances asked for."""
    from driftplan import predict_drift, read_path
    from driftplan.report.figures.comparison import plot_comparison
    from driftplan.report.records import drift_as_json, drift_table

    noise, heading = shared.noise_from(args), shared.start_heading_from(args)
    drifts = [predict_drift(read_path(file), noise, start_heading=heading) for file in args.paths]
    shown = [
        (file, float(drift.length), drift.at(args.at) if args.at else drift)
        for file, drift in zip(args.paths, drifts, strict=True)
    ]
    return Answer(
        payload=lambda: {
            "noise": shared.noise_as_json(noise),
            "paths": [
                {"file": file, "length_m": length, "points": drift_as_json(points)} for file, length, points in shown
            ],
        },
        text=lambda: "\n\n".join(f"{file}: {length:.2f} m\n{drift_table(points)}" for file, length, points in shown),
        files={"png": lambda: plot_comparison(None, dict(zip(args.paths, drifts, strict=True)))},
    )


# fmt: off
COMMAND = Command(
    name="predict",
    summary="drift along given paths",
    description="Predict the drift of odometry along paths, at every waypoint or at chosen distances.",
    run=run,
    arguments=(
        Option("paths", "PATH.csv", "waypoints x,y or poses x,y,heading: metres, radians, one per line", str,
               how={"nargs": "+"}),
    ),
    groups=(
        Group("", (
            Option("at", "S", "only after S metres; several: S,S,... (default: every waypoint)", metres),
            shared.START_HEADING,
        )),
        *shared.NOISE,
    ),
    files={"png": "draw the paths, their error ellipses and their drift against distance"},
)
