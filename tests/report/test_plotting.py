"""Figures: what is drawn where, artists compared with numbers."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest
import shapely
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.report.figures.maps import error_ellipse, plot_route, plot_world
from driftplan.report.figures.routes import plot_comparison, plot_drift
from driftplan.report.figures.style import ROUTE_STYLES
from driftplan.world.world import World
from driftplan.world.zones import Zone

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.1, after_m=10.0)
PATH = [(3, 3), (3, 19), (37, 19), (37, 27)]
RACKS = [[(x, y), (x + 1.2, y), (x + 1.2, y + 9), (x, y + 9)] for x in (8, 18, 28) for y in (5, 21)]


@pytest.fixture
def ax():
    return Figure().subplots()


@pytest.fixture
def world():
    wet = Zone([(10, 15), (20, 15), (20, 20), (10, 20)], NOISE.scaled(3.0))
    return World.from_polygons(RACKS, bounds=(0, 0, 40, 30), robot_radius=0.3, zones=[wet])


# The map


def test_a_map_is_drawn_in_metres_to_scale_and_fills_the_view(ax, world):
    plot_world(world, ax=ax)
    assert (*ax.get_xlim(), *ax.get_ylim()) == (0, 40, 0, 30)
    assert ax.get_aspect() == 1.0
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (m)", "y (m)")


def test_obstacles_and_zones_are_drawn_where_they_are(ax, world):
    drawn = plot_world(world, ax=ax)
    assert drawn.obstacles in ax.patches
    inside, outside = [(8.5, 7), (28.5, 25)], [(5, 5), (15, 17)]
    assert drawn.obstacles.get_path().contains_points(inside).all()
    assert not drawn.obstacles.get_path().contains_points(outside).any()
    assert drawn.zones[0].get_path().contains_point((15, 17))
    assert drawn.zones[0].get_hatch()


def test_the_inside_of_a_ring_of_walls_stays_white(ax):
    room = shapely.box(1, 1, 9, 9).difference(shapely.box(2, 2, 8, 8))
    drawn = plot_world(World.from_polygons([room], bounds=(0, 0, 10, 10), robot_radius=0.1), ax=ax)
    figure = ax.figure
    ax.set_axis_off()
    ax.set_position([0, 0, 1, 1])
    figure.set_size_inches(1, 1)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    grey = np.asarray(canvas.buffer_rgba())[..., 0]
    assert grey[50, 50] == 255  # the one question that only pixels answer: which way holes are filled
    assert grey[50, 15] < 255
    assert drawn.zones == []


def test_a_map_without_obstacles_can_be_drawn_and_styled(ax):
    empty = World.from_polygons([], bounds=(0, 0, 4, 3), robot_radius=0.5)
    assert plot_world(empty, ax=ax).obstacles is None
    walls = World.from_polygons([shapely.box(1, 1, 2, 2)], bounds=(0, 0, 4, 3), robot_radius=0.5)
    assert plot_world(walls, ax=ax, facecolor="red").obstacles.get_facecolor() == (1, 0, 0, 1)


# Routes


def test_ellipses_stand_at_truth_plus_bias_and_have_the_size_of_the_covariance(ax):
    noisy = NOISE.scaled(5.0)  # the bias is 5 m at the end, so that forgetting it shows
    drift = predict_drift(PATH, noisy)
    drawn = plot_route(drift, ax=ax, spacing_m=10.0, magnify=1.0)
    expected = drift.at([10.0, 20.0, 30.0, 40.0, 50.0, 58.0])
    assert np.linalg.norm(expected.bias[-1]) > 1
    np.testing.assert_allclose([e.center for e in drawn.ellipses], expected.xy + expected.bias, atol=1e-9)
    factor = np.sqrt(-2 * np.log(0.05))
    for ellipse, cov in zip(drawn.ellipses, expected.cov, strict=True):
        turn = np.radians(ellipse.angle)
        axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        shape = axes @ np.diag(np.square([ellipse.width / 2, ellipse.height / 2])) @ axes.T
        np.testing.assert_allclose(shape, factor**2 * cov, rtol=1e-9, atol=1e-9)


def test_magnified_ellipses_magnify_the_bias_too_and_say_so(ax):
    drift = predict_drift(PATH, NOISE)
    drawn = plot_route(drift, ax=ax, spacing_m=10.0, magnify=5.0)
    at = drift.at(10.0)
    np.testing.assert_allclose(drawn.ellipses[0].center, at.xy + 5 * at.bias, atol=1e-9)
    np.testing.assert_allclose(drawn.ellipses[0].width, 5 * error_ellipse(at.cov)[0])
    assert drawn.ellipses[0].get_label() == "95 % error ellipse every 10 m, drawn 5 × its size"
    assert [e.get_label() for e in drawn.ellipses[1:]] == ["_nolegend_"] * 5


def test_a_route_goes_through_its_waypoints_from_start_to_goal(ax):
    drawn = plot_route(predict_drift(PATH, NOISE), ax=ax, label="mine", color="green")
    line = shapely.LineString(drawn.line.get_xydata())
    np.testing.assert_allclose(line.length, 58.0)
    assert shapely.hausdorff_distance(line, shapely.LineString(PATH)) < 1e-9
    np.testing.assert_allclose(drawn.start.get_xydata(), [PATH[0]])
    np.testing.assert_allclose(drawn.goal.get_xydata(), [PATH[-1]])
    assert (drawn.line.get_label(), drawn.line.get_color()) == ("mine", "green")


def test_the_marks_on_the_map_and_on_the_curve_are_the_same_places(ax):
    drift = predict_drift(PATH, NOISE)
    on_map = plot_route(drift, ax=ax, spacing_m=10.0).line
    (on_curve,) = plot_drift(drift, ax=Figure().subplots(), spacing_m=10.0)
    expected = drift.at([10.0, 20.0, 30.0, 40.0, 50.0, 58.0])
    np.testing.assert_allclose(on_map.get_xydata()[on_map.get_markevery()], expected.xy, atol=1e-9)
    marks = on_curve.get_xydata()[on_curve.get_markevery()]
    np.testing.assert_allclose(marks, np.column_stack([expected.distance, expected.rms]), atol=1e-9)


def test_all_curves_are_in_view_from_zero_up(ax):
    low, high = predict_drift(PATH, NOISE), predict_drift([*PATH, (3, 27)], NOISE.scaled(4.0))
    known = predict_drift(PATH, NOISE, fixes=[Fix.full(0.0, position_std_m=1.0, heading_std=0.01)])
    for drift in (low, high, known):
        plot_drift(drift, ax=ax)
    assert (ax.get_xlim()[0], ax.get_ylim()[0]) == (0, 0)
    assert high.length <= ax.get_xlim()[1] < 1.1 * high.length
    assert high.rms.max() <= ax.get_ylim()[1] < 1.1 * high.rms.max()


def test_a_fix_shows_as_a_saw_tooth(ax):
    drift = predict_drift(PATH, NOISE, fixes=[Fix.full(20.0, position_std_m=0.01, heading_std=0.01)])
    (line,) = plot_drift(drift, ax=ax)
    s, rms = line.get_xydata().T
    there = rms[np.isclose(s, 20.0)]
    assert there.max() > 5 * there.min()
    assert there.min() == pytest.approx(0.01 * np.sqrt(2))


def test_the_radius_is_drawn_when_asked_for(ax):
    drift = predict_drift(PATH, NOISE)
    _, radius = plot_drift(drift, ax=ax, radius_at=0.95)
    s, r = radius.get_xydata()[-1]
    assert (s, r) == (pytest.approx(58.0), pytest.approx(float(drift.end.radius(0.95))))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("distance driven (m)", "drift (m)")


def test_a_path_that_goes_nowhere_and_one_without_noise_can_be_drawn(world):
    plot_comparison(None, {"still": predict_drift([(1, 1), (1, 1)], NOISE)}).draw_without_rendering()
    plot_comparison(world, {"sure": predict_drift(PATH, OdometryNoise())}).draw_without_rendering()


# The whole picture


def two_routes():
    return {
        "lowest drift": predict_drift(PATH, NOISE),
        "shortest": predict_drift([(3, 3), (16, 15), (30, 19), (37, 27)], NOISE),
    }


def test_a_comparison_shows_both_routes_on_the_map_and_their_drift_beside_it(world):
    routes = two_routes()
    figure = plot_comparison(world, routes)
    on_map, on_drift = figure.axes
    assert (*on_map.get_xlim(), *on_map.get_ylim()) == (0, 40, 0, 30)
    ends = [line.get_xydata()[-1] for line in on_drift.lines]
    np.testing.assert_allclose(ends, [(r.length, r.end.rms) for r in routes.values()])
    said = [text.get_text() for text in figure.legends[0].get_texts()]
    assert said[0] == f"lowest drift: 58.0 m, rms {routes['lowest drift'].end.rms:.2f} m at the end"
    assert said[2:4] == ["start", "goal"]
    assert said[4].startswith("95 % error ellipse every 10 m")
    assert said[5:] == ["obstacle", "zone with odometry of its own"]


@pytest.mark.parametrize("bounds", [(0, 0, 40, 30), (0, 0, 40, 8), (0, 0, 10, 40), (-1000, -1000, 3000, 1000)])
def test_nothing_in_the_picture_overlaps(bounds):
    walls = [shapely.box(bounds[0], bounds[1], bounds[2], bounds[1] + 0.5)]
    map_ = World.from_polygons(walls, bounds=bounds, robot_radius=0.3)
    path = [(x * bounds[2], y * bounds[3]) for x, y in ((0.1, 0.1), (0.1, 0.8), (0.9, 0.8))]
    figure = plot_comparison(
        map_, {"a route with a rather long name": predict_drift(path, NOISE), "b": predict_drift(path, NOISE)}
    )
    figure.draw_without_rendering()
    boxes = [ax.get_tightbbox() for ax in figure.axes] + [figure.legends[0].get_window_extent()]
    for i, one in enumerate(boxes):
        assert one.xmin >= -1
        assert one.ymin >= -1
        assert one.xmax <= figure.bbox.xmax + 1
        assert one.ymax <= figure.bbox.ymax + 1
        for other in boxes[i + 1 :]:
            assert min(one.xmax, other.xmax) - max(one.xmin, other.xmin) <= 1 or (
                min(one.ymax, other.ymax) - max(one.ymin, other.ymin) <= 1
            )


def test_routes_can_be_told_apart_without_colour():
    drift = predict_drift(PATH, NOISE)
    figure = plot_comparison(None, {str(i): drift for i in range(len(ROUTE_STYLES))})
    looks = {
        (line.get_linestyle(), line._dash_pattern[1] and tuple(line._dash_pattern[1])) for line in figure.axes[1].lines
    }
    markers = {line.get_marker() for line in figure.axes[1].lines}
    assert len(looks) == len(markers) == len(ROUTE_STYLES)


def test_ellipses_of_all_routes_have_one_scale(world):
    figure = plot_comparison(world, two_routes())
    labels = {p.get_label() for p in figure.axes[0].patches if isinstance(p, Ellipse)} - {"_nolegend_"}
    assert len(labels) == 1


def test_a_figure_handed_in_is_used(world):
    mine = Figure(figsize=(4, 3))
    assert plot_comparison(world, two_routes(), figure=mine) is mine
    assert tuple(mine.get_size_inches()) == (4, 3)


def test_drawing_changes_no_setting_and_needs_no_pyplot(world):
    before = dict(mpl.rcParams)
    plot_comparison(world, two_routes())
    assert dict(mpl.rcParams) == before


def test_without_axes_the_current_ones_are_drawn_on(world):
    from matplotlib import pyplot

    with mpl.rc_context({"backend": "agg"}):
        figure, mine = pyplot.subplots()
        try:
            plot_world(world)
            plot_route(predict_drift(PATH, NOISE))
            assert len(mine.lines) == 3
            plot_drift(predict_drift(PATH, NOISE))
            assert len(mine.lines) == 4
        finally:
            pyplot.close(figure)


def test_bad_arguments_are_refused(ax, world):
    drift = predict_drift(PATH, NOISE)
    with pytest.raises(ValueError, match=r"expected a confidence in \(0, 1\), got 1.5"):
        plot_route(drift, ax=ax, confidence=1.5)
    with pytest.raises(ValueError, match="expected spacing_m > 0, got 0"):
        plot_route(drift, ax=ax, spacing_m=0)
    with pytest.raises(ValueError, match="expected magnify > 0, got -1"):
        plot_route(drift, ax=ax, magnify=-1)
    with pytest.raises(ValueError, match="expected at least one route"):
        plot_comparison(world, {})


def test_the_title_says_what_was_found(world):
    routes = two_routes()
    low, high = sorted(float(drift.end.rms) for drift in routes.values())
    least = min(routes, key=lambda label: routes[label].end.rms)
    assert (
        plot_comparison(world, routes).axes[0].get_title().startswith(f"{least}: {100 * (1 - low / high):.0f} % less")
    )
    (name, drift), _ = routes.items()
    assert plot_comparison(world, {name: drift}).axes[0].get_title().startswith("lowest drift: rms drift of ")
    assert "about the same" in plot_comparison(world, {"a": drift, "b": drift}).axes[0].get_title()


def test_of_many_routes_the_worst_are_named_and_the_others_counted():
    drifts = {f"r{k}": predict_drift(PATH, NOISE.scaled(k + 1.0)) for k in range(9)}
    figure = plot_comparison(None, drifts)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert [label.partition(":")[0] for label in labels[:5]] == ["r4", "r5", "r6", "r7", "r8"]
    assert labels[5].startswith("4 more, rms ")
    assert len(figure.axes[1].lines) == 9


def test_an_arrow_says_which_way_a_route_is_driven(ax):
    plot_route(predict_drift([(0, 0), (10, 0), (10, -20)], NOISE), ax=ax)
    (arrow,) = ax.texts
    assert arrow.xyann[0] == pytest.approx(10.0)
    assert arrow.xy[1] < arrow.xyann[1] < 0
