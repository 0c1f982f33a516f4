"""Draw every figure of driftplan into examples/guide/gallery, and write the page that shows them.

python examples/guide/site/gallery.py
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure

from driftplan import (
    BeaconKind,
    DriftLimit,
    OdometryNoise,
    Planner,
    Trip,
    beacon_tradeoff,
    bundled_map,
    co_design,
    fit_noise,
    layout_figure,
    load_world,
    pareto_routes,
    place_beacons,
    plan_route,
    plot_comparison,
    plot_drift,
    plot_fit,
    plot_route,
    plot_world,
    predict_drift,
    read_odometry,
    read_path,
    read_truth,
)
from driftplan.report.commands.answer import figure_bytes
from driftplan.report.figures.layouts import layouts_figure, plot_design, tradeoff_figure
from driftplan.report.figures.routes import plot_itinerary, plot_pareto
from driftplan.report.figures.style import ROUTE_STYLES

GUIDE = Path(__file__).resolve().parents[1]
DATA = GUIDE.parent / "data"


class Picture(NamedTuple):
    """A figure, its file's name, what it answers, and how to have it."""

    name: str
    question: str
    how: str
    figure: Figure


def on_axes(width: float = 7.0, height: float = 4.5) -> Figure:
    """An empty figure for what is drawn on Axes."""
    return Figure(figsize=(width, height), layout="constrained", dpi=110)


def pictures() -> Iterator[Picture]:
    """All of them; two minutes."""
    noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    tag = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    warehouse = load_world(bundled_map("warehouse"), robot_radius=0.4)
    office = load_world(bundled_map("office"), robot_radius=0.3)
    routes = [read_path(DATA / f"{name}.csv")[:, :2] for name in ("route", "other")]

    figure = on_axes(9, 5)
    plot_world(office, ax=(ax := figure.subplots()))
    plot_route(predict_drift([(38, 12), (38, 16.8), (5.6, 16.8), (5.6, 5)], noise), ax=ax, label="a path")
    ax.set_title("The office, a zone of carpet, and a path with its error ellipses", fontsize=10)
    ax.legend(loc="upper right", fontsize=8)
    yield Picture(
        "route", "Where will the estimate be along this path?", "plot_world(world); plot_route(drift)", figure
    )

    figure = on_axes()
    ax = figure.subplots()
    corners = {"long leg first": (30, 0), "short leg first": (0, 10)}
    for (label, corner), own in zip(corners.items(), ROUTE_STYLES, strict=False):
        plot_drift(predict_drift([(0, 0), corner, (30, 10)], noise), ax=ax, label=label, radius_at=0.95, **own)
    ax.set_title("The long leg first: less drift at the end", fontsize=10)
    ax.legend(fontsize=8)
    yield Picture("drift", "How does the drift grow?", "plot_drift(drift, radius_at=0.95)", figure)

    route = plan_route(warehouse, (51, 33), (23.5, 18.7), noise, iterations=4)
    both = {"lowest drift": route, "shortest": route.shortest}
    yield Picture(
        "comparison",
        "Which route drifts least, and how much less?",
        "driftplan plan warehouse --start 51,33 --goal 23.5,18.7 --picture comparison.png",
        plot_comparison(warehouse, both),
    )

    ends = [(3, 3), (3, 20), (3, 36)], [(56, 36), (55.5, 20), (56, 3)]
    many = [plan_route(warehouse, a, b, noise, iterations=2) for a in ends[0] for b in ends[1]]
    named = {f"trip {k}": one for k, one in enumerate(many)}
    shown = plot_comparison(warehouse, named)
    yield Picture("many", "Which of many routes are bad?", "plot_comparison(world, routes)", shown)

    layout = place_beacons(warehouse, routes, noise, 0.6, tag, time_limit=30)
    yield Picture(
        "layout",
        "Where must tags be, how near is the limit, and which failure hurts?",
        "driftplan place warehouse route.csv other.csv --max-drift 0.6 --picture layout.png",
        layout_figure(layout),
    )
    fused = place_beacons(warehouse, routes, noise, 0.6, tag, estimator="filter", time_limit=30)
    yield Picture(
        "layouts",
        "What does a filter save?",
        "layouts_figure({'reset': layout, 'filter': fused})",
        layouts_figure({"readings replace": layout, "readings are fused": fused}),
    )
    yield Picture(
        "tradeoff",
        "What does one more tag buy?",
        "driftplan place warehouse route.csv --estimator filter --tradeoff 5 --picture tradeoff.png",
        tradeoff_figure(
            beacon_tradeoff(warehouse, routes, noise, tag, max_beacons=5, estimator="filter", time_limit=30)
        ),
    )
    asked = {"beacons": layout.beacons, "planner": Planner(max_nodes=200), "time_limit": 60}
    limit = DriftLimit(0.6, min_capture=0.0)
    way = plan_route(warehouse, (8, 2.5), (44, 13.4), noise, minimise="length", max_drift=limit, **asked)
    yield Picture(
        "itinerary",
        "Which tags does a route count on?",
        "driftplan plan warehouse --start 8,2.5 --goal 44,13.4 --beacons tags.geojson --max-drift 0.6 --minimise length"
        " --picture way.png",
        plot_itinerary(warehouse, way, layout.beacons),
    )
    front = pareto_routes(
        warehouse, (8, 36), (30, 13.4), noise, limit=DriftLimit(min_capture=0.0), max_routes=4, **asked
    )
    shown = plot_pareto(warehouse, front)
    yield Picture("pareto", "What does a detour buy?", "plot_pareto(world, pareto_routes(...))", shown)

    trips = [
        Trip((3, 3), (56, 36), 1),
        Trip((3, 36), (56, 3), 3),
        Trip((3, 20), (55.5, 20), 2),
        Trip((51, 33), (23.5, 18.7), 4),
    ]
    marker = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01, cost=100.0)
    world = load_world(bundled_map("warehouse"), robot_radius=0.3)
    less_sure = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)
    asked = {"price_per_m": 1.0, "max_nodes": 150, "rounds": 1, "time_limit": 300}
    found = co_design(world, trips, less_sure, DriftLimit(0.6, min_capture=0.0), marker, **asked)
    yield Picture(
        "design",
        "Routes and tags chosen together: which, and for how much?",
        "plot_design(world, co_design(world, trips, noise, limit, marker, price_per_m=1))",
        plot_design(world, found),
    )
    drives = ("drive1", "drive2")
    fit = fit_noise(
        [read_odometry(DATA / f"{one}_odometry.csv") for one in drives],
        [read_truth(DATA / f"{one}_truth.csv") for one in drives],
    )
    yield Picture(
        "fit",
        "Is the fitted noise to be trusted?",
        "driftplan fit drive1_odometry.csv drive1_truth.csv drive2_odometry.csv drive2_truth.csv --picture fit.png",
        plot_fit(fit),
    )


def main() -> None:
    """Write the pictures and the page."""
    folder = GUIDE / "gallery"
    folder.mkdir(exist_ok=True)
    head = (GUIDE / "gallery.md").read_text().split("\n## ")[0].rstrip()
    parts = [head]
    for name, question, how, figure in pictures():
        figure.set_dpi(90)
        (folder / f"{name}.png").write_bytes(figure_bytes(figure))
        parts.append(f"## {question}\n\n![{question}](gallery/{name}.png)\n\n`{how}`")
        print(name, file=sys.stderr)
    (GUIDE / "gallery.md").write_text("\n\n".join(parts) + "\n")


if __name__ == "__main__":
    main()
