"""Figures of beacon layouts: artists compared with numbers."""

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.layouts.place import beacon_tradeoff, place_beacons
from driftplan.layouts.scenario import Sites
from driftplan.model.noise import OdometryNoise
from driftplan.planning.request import DriftLimit
from driftplan.report.commands.answer import figure_bytes
from driftplan.report.figures.layouts import (
    layout_figure,
    layouts_figure,
    plot_importance,
    plot_layout,
    plot_sawtooth,
    plot_tradeoff,
    route_segments,
)
from driftplan.report.figures.maps import plot_beacons
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
SIGN = BeaconKind.landmark(2.0, 0.05, 0.01, line_of_sight=False)
WORLD = World.from_polygons([[(5, 3), (35, 3), (35, 7), (5, 7)]], bounds=(0, 0, 40, 10), robot_radius=0.4)
ROUTES = [np.array([(1, 1.5), (39, 1.5), (39, 8.5)]), np.array([(39, 8.5), (1, 8.5)]), np.array([(1, 2.0), (1, 8.0)])]
OLD = Beacon(BeaconKind.rfid(1.5, 0.1), 20.0, 1.5, "old")


@pytest.fixture(scope="module")
def layout():
    return place_beacons(WORLD, ROUTES, NOISE, 0.8, Sites(SIGN, spacing_m=2.0, existing=[OLD]))


@pytest.fixture
def ax():
    return Figure().subplots()


def test_ranges_and_beacons_are_drawn_where_they_are(layout, ax):
    drawn = plot_layout(layout, ax=ax)
    everyone = (*layout.existing, *layout.beacons)
    assert [tuple(circle.center) for circle in drawn.ranges] == [(b.x, b.y) for b in everyone]
    assert [circle.radius for circle in drawn.ranges] == [b.kind.range_m for b in everyone]
    np.testing.assert_array_equal(drawn.beacons[1].get_xydata(), [b.xy for b in layout.beacons])
    starts = {text.get_text(): text.xy for text in ax.texts if text.get_text().startswith("route")}
    assert {text.get_text() for text in ax.texts} - {""} == {b.id for b in everyone} | set(starts)
    assert [tuple(starts[f"route {r}"]) for r in range(len(ROUTES))] == [tuple(route[0]) for route in ROUTES]


def test_a_beacon_that_faces_somewhere_has_a_sector(ax):
    kind = BeaconKind(name="tag", range_m=2.0, position_std_m=0.1, view_angle_deg=120)
    sector, disc = plot_beacons([Beacon(kind, 1.0, 2.0, facing_deg=90), OLD], ax=ax).ranges
    assert (tuple(sector.center), sector.r, sector.theta1, sector.theta2) == ((1.0, 2.0), 2.0, 30.0, 150.0)
    assert disc.radius == OLD.kind.range_m


def test_layouts_side_by_side_have_the_same_scale_of_drift(layout):
    figure = layouts_figure({"as it is": layout, "again": layout})
    first, _, *curves = figure.axes[:4]
    assert first.get_title() == f"as it is: {len(layout.beacons)} beacons (proven fewest)"
    assert curves[0].get_ylim() == curves[1].get_ylim()
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["route 0", "route 1", "route 2", "limit 0.8 m", "existing beacon", "new beacon"]


def test_routes_are_coloured_by_their_drift_up_to_the_limit(layout, ax):
    drawn = plot_layout(layout, ax=ax)
    assert drawn.routes.get_clim() == (0.0, 0.8)
    values = np.asarray(drawn.routes.get_array())
    assert values.max() == pytest.approx(layout.worst_drift, rel=1e-6)
    assert (np.diff(values) >= 0).all()  # the worst is drawn last, on top
    segments, drift = route_segments(layout)
    length = np.hypot(*(segments[:, 1] - segments[:, 0]).T).sum()
    assert length == pytest.approx(sum(float(d.length) for d in layout.drifts))
    assert sorted(drift) == pytest.approx(sorted(values))


def test_the_sawtooth_is_the_drift_and_shows_the_limit(layout, ax):
    lines = plot_sawtooth(layout, routes=[1, 0], ax=ax)
    assert [line.get_label() for line in lines] == ["route 1", "route 0"]
    s, drift = lines[1].get_data()
    assert drift.max() == pytest.approx(layout.worst_drifts[0], rel=1e-6)
    assert (np.diff(drift)[np.diff(s) == 0] != 0).any()  # a reading: two values at one place
    assert any(line.get_label() == "limit 0.8 m" and set(line.get_ydata()) == {0.8} for line in ax.lines)


def test_by_default_the_routes_nearest_to_their_limits_have_a_style_and_the_others_are_grey(layout, ax):
    many = place_beacons(None, [ROUTES[0] + (0, k) for k in range(7)], NOISE, 0.8, Sites(SIGN, spacing_m=4.0))
    lines = plot_sawtooth(many, ax=ax)
    assert len(lines) == 5
    worst = sorted(range(7), key=lambda r: -many.worst_drifts[r])[:5]
    assert {line.get_label() for line in lines} == {f"route {r}" for r in worst}
    assert sum(to_rgba(line.get_color()) == to_rgba("0.6") for line in ax.lines) == 2


def test_the_trade_off_steps_down_through_its_points(ax):
    curve = beacon_tradeoff(None, ROUTES[0], NOISE, Sites(SIGN, spacing_m=4.0), max_beacons=3)
    line = plot_tradeoff(curve, ax=ax)
    x, y = line.get_data()
    assert list(zip(x, y, strict=True)) == [(c.worst_drift, len(c.beacons)) for c in reversed(curve)]
    with pytest.raises(ValueError, match="at least one layout, got none"):
        plot_tradeoff([], ax=ax)


def test_importance_bars_are_what_each_failure_does_worst_first(layout, ax):
    bars = plot_importance(layout, ax=ax)
    said = sorted((x for x in layout.importance if x.routes), key=lambda x: -x.worst_single_failure)
    assert [bar.get_width() for bar in bars] == [x.worst_single_failure for x in said]
    assert [label.get_text() for label in ax.get_yticklabels()] == [x.beacon.id for x in said]


def test_the_whole_figure_draws_with_and_without_a_map_and_with_nothing_placed(layout):
    bare = place_beacons(None, ROUTES[2], NOISE, 5.0, SIGN)
    assert len(bare.beacons) == 0
    for one in (layout, bare):
        assert figure_bytes(layout_figure(one)).startswith(b"\x89PNG")


def test_a_radius_is_labelled_as_one(ax):
    layout = place_beacons(None, ROUTES[2], NOISE, DriftLimit(5.0, confidence=0.95), SIGN)
    plot_sawtooth(layout, ax=ax)
    assert ax.get_ylabel() == "95 % radius (m)"
