"""Dubins and Reeds-Shepp curves: laws of the lists of arcs, and OMPL's own curves as the oracle."""

from math import cos, hypot, pi, remainder, sin, tau

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from ompl import base as ob

from driftplan.planning.ompl.curves import curve_length, dubins_curves, pose_along, reeds_shepp_curves
from driftplan.planning.ompl.spaces import CurveFinder

FAMILIES = {"dubins": dubins_curves, "reeds_shepp": reeds_shepp_curves}
RADIUS = 1.7
SPACES = {
    "dubins": lambda: ob.DubinsStateSpace(RADIUS),
    "symmetric_dubins": lambda: ob.DubinsStateSpace(RADIUS, True),
    "reeds_shepp": lambda: ob.ReedsSheppStateSpace(RADIUS),
}

offset = st.floats(-6, 6)
angle = st.floats(-pi, pi)


@pytest.mark.parametrize("family", FAMILIES)
@given(offset, offset, angle, angle)
def test_every_curve_ends_at_its_end_pose(family, dx, dy, yaw_start, yaw_end):
    for curve in FAMILIES[family](dx, dy, yaw_start, yaw_end):
        x, y, yaw = pose_along(curve, curve_length(curve))
        c, s = cos(yaw_start), sin(yaw_start)
        # Words whose arcs nearly vanish are kept down to -1e-9 of an angle or of a squared length, hence 1e-4.
        assert hypot(c * x - s * y - dx, s * x + c * y - dy) < 1e-4
        assert abs(remainder(yaw + yaw_start - yaw_end, tau)) < 1e-4


@given(offset, offset, angle, angle)
def test_dubins_curves_only_go_forwards(dx, dy, yaw_start, yaw_end):
    curves = list(dubins_curves(dx, dy, yaw_start, yaw_end))
    assert curves
    assert all(length >= 0 for curve in curves for length, _ in curve)


@example(1.0, 0.0, 0.0, -3e-7)
@given(offset, offset, angle, angle)
def test_being_allowed_to_reverse_never_makes_the_way_longer(dx, dy, yaw_start, yaw_end):
    forwards = min(map(curve_length, dubins_curves(dx, dy, yaw_start, yaw_end)))
    both = min(map(curve_length, reeds_shepp_curves(dx, dy, yaw_start, yaw_end)))
    assume(not 0 < hypot(dx, dy) < 1e-6)  # where OMPL's Dubins curves are straight whatever the headings
    # Dubins curves leave out arcs of 5e-7 rad, as OMPL's do.
    assert hypot(dx, dy) - 1e-7 <= both <= forwards + 2e-6


def set_pose(state, x, y, yaw):
    state.setXY(x, y)
    state.setYaw(yaw)


def poses(seed, count, scale):
    """Random pairs of poses; every fourth on a lattice, where several curves are equally short."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        xy, yaws = rng.normal(0, scale, 4), rng.uniform(-pi, pi, 2)
        if k % 4 == 0:
            xy, yaws = np.round(xy), np.round(yaws * 2 / pi) * pi / 2
        yield *xy.tolist(), *yaws.tolist()


@pytest.mark.parametrize("scale", [0.5, 3.0, 15.0])
@pytest.mark.parametrize("name", SPACES)
def test_the_curve_priced_is_the_curve_that_ompl_drives(name, scale):
    space = SPACES[name]()
    finder = CurveFinder(space)
    assert finder.turning_radius == pytest.approx(RADIUS, rel=1e-12)
    a, b, between = space.allocState(), space.allocState(), space.allocState()
    for x0, y0, x1, y1, yaw0, yaw1 in poses(7, 300, scale):
        set_pose(a, x0, y0, yaw0)
        set_pose(b, x1, y1, yaw1)
        curve = finder(a, b)
        # OMPL takes angles below 1e-6 or so for zero, which shows in where the curve is by up to 1e-5 turning radii.
        assert curve_length(curve) * RADIUS == pytest.approx(space.distance(a, b), abs=1e-5)
        for share in (0.13, 0.5, 0.81):
            space.interpolate(a, b, share, between)
            x, y, yaw = pose_along(curve, share * curve_length(curve))
            assert x0 + RADIUS * (cos(yaw0) * x - sin(yaw0) * y) == pytest.approx(between.getX(), abs=2e-5)
            assert y0 + RADIUS * (sin(yaw0) * x + cos(yaw0) * y) == pytest.approx(between.getY(), abs=2e-5)
            assert abs(remainder(yaw0 + yaw - between.getYaw(), tau)) < 2e-5


@pytest.mark.parametrize(("x", "y", "yaw"), [(-5.0, 0.0, -pi), (5.0, 0.0, pi), (-5.0, -2.0, pi / 2)])
def test_of_curves_that_are_equally_long_and_begin_alike_it_is_the_one_that_ompl_drives(x, y, yaw):
    space = ob.ReedsSheppStateSpace(1.3)
    a, b, there = space.allocState(), space.allocState(), space.allocState()
    set_pose(a, 0.0, 0.0, 0.0), set_pose(b, x, y, yaw)
    curve, length = CurveFinder(space)(a, b), space.distance(a, b)
    for share in np.linspace(0.05, 0.95, 19).tolist():
        space.interpolate(a, b, share, there)
        px, py, _ = pose_along(curve, share * length / 1.3)
        assert hypot(1.3 * px - there.getX(), 1.3 * py - there.getY()) < 1e-6


def test_staying_is_no_curve():
    space = ob.DubinsStateSpace(1.0)
    a = space.allocState()
    set_pose(a, 1.0, 2.0, 0.5)
    assert CurveFinder(space)(a, a) == []


def test_an_arc_in_which_a_heading_is_a_rounding_error_off_is_no_circle():
    """A left arc of 1.63 m on a radius of 1.3 m, its end rounded as OMPL's own states are."""
    space = ob.DubinsStateSpace(1.3)
    a, b = space.allocState(), space.allocState()
    x, y, yaw, turn = 1.11, 1.41, -1.84, 1.63 / 1.3
    set_pose(a, x, y, yaw)
    for off in (-3e-8, -1e-10, 0.0, 1e-10, 3e-8):
        end = yaw + turn + off
        set_pose(b, x + 1.3 * (sin(yaw + turn) - sin(yaw)), y - 1.3 * (cos(yaw + turn) - cos(yaw)), end)
        assert curve_length(CurveFinder(space)(a, b)) * 1.3 == pytest.approx(space.distance(a, b), abs=1e-6)
        assert space.distance(a, b) == pytest.approx(1.63, abs=1e-6)
