"""Figures of itineraries: what is drawn is what was found."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.planning.comparison import knee, pareto_routes
from driftplan.planning.request import Planner
from driftplan.planning.routes import plan_route
from driftplan.report.figures.maps import plot_beacons
from driftplan.report.figures.routes import plot_itinerary, plot_pareto
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)
SIGN = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
HALL = World.from_polygons([[(25, 0), (27, 0), (27, 8), (25, 8)]], bounds=(0, 0, 60, 40), robot_radius=0.5)
BEACONS = [Beacon(SIGN, 18, 17), Beacon(SIGN, 30, 18), Beacon(SIGN, 42, 17), Beacon(SIGN, 5, 35)]
ENDS = ((3.0, 10.0), (57.0, 10.0))


@pytest.fixture(scope="module")
def itinerary():
    asked = {"beacons": BEACONS, "max_drift": 2.0, "planner": Planner(max_nodes=100), "time_limit": 600.0}
    return plan_route(HALL, *ENDS, NOISE, minimise="length", **asked)


def test_beacons_counted_on_look_different_from_the_others():
    ax = Figure().subplots()
    drawn = plot_beacons(BEACONS, ax=ax, used=BEACONS[:3])
    others, used = drawn.marks
    assert [len(line.get_xdata()) for line in (used, others)] == [3, 1]
    assert used.get_marker() != others.get_marker()
    assert [disc.center for disc in drawn.ranges] == [(b.x, b.y) for b in (BEACONS[3], *BEACONS[:3])]
    assert [disc.get_facecolor()[3] > 0 for disc in drawn.ranges] == [False, True, True, True]


def test_the_figure_of_an_itinerary_shows_route_beacons_and_limit(itinerary):
    figure = plot_itinerary(HALL, itinerary, BEACONS)
    on_map, on_drift = figure.axes
    discs = [patch for patch in on_map.patches if isinstance(patch, Circle) and patch.get_facecolor()[3] > 0]
    assert len(discs) == len(itinerary.beacons)
    assert any(np.array_equal(line.get_ydata(), [2.0, 2.0]) for line in on_drift.lines)
    top = max(line.get_ydata().max() for line in on_drift.lines if len(line.get_ydata()) > 2)
    assert top == pytest.approx(itinerary.worst_drift, rel=1e-3)
    assert any("limit 2 m" in text.get_text() for text in figure.legends[0].get_texts())
    figure.canvas.draw()


def test_the_figure_of_a_trade_off_marks_the_knee():
    routes = pareto_routes(
        HALL, *ENDS, NOISE, beacons=BEACONS, max_routes=3, planner=Planner(max_nodes=100), time_limit=600.0
    )
    figure = plot_pareto(HALL, routes)
    on_map, on_curve = figure.axes
    paths = [line.get_xydata() for line in on_map.lines]
    assert all(any(np.array_equal(route.path, path) for path in paths) for route in routes)
    (mark,) = (line for line in on_curve.lines if line.get_label() == "knee")
    best = routes[knee(routes)]
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == (best.length, best.worst_drift)
    figure.canvas.draw()


def test_the_title_of_a_trade_off_compares_with_the_shortest_route(itinerary):
    """A route that ends with the least drift may be the longest and have the greatest drift on its way."""
    rows = ((54.0, 1.3), (58.0, 0.8), (60.0, 1.5))
    paths = [np.array([(3.0, 10.0), (3.0 + length, 10.0)]) for length, _ in rows]
    drifts = [predict_drift(path, NOISE) for path in paths]
    routes = [
        replace(itinerary, path=path, drift=drift, worst_drift=worst, captures=(), beacons=())
        for path, drift, (_, worst) in zip(paths, drifts, rows, strict=True)
    ]
    title = plot_pareto(HALL, routes).axes[0].get_title()
    assert title == "4 m farther than the shortest: worst drift 0.8 m instead of 1.3 m"
