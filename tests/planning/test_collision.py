"""OMPL's collision checks give the world's answers, along straight motions and along curves."""

import numpy as np
import pytest
import shapely
from ompl import base as ob

from driftplan.planning.ompl.collision import use_world
from driftplan.world.world import World

WORLD = World.from_polygons(
    [[(4, 0), (6, 0), (6, 7), (4, 7)], [(1, 8), (2.5, 8.2), (1.7, 9)], [(8, 4), (8.3, 4), (8.3, 4.3)]],
    bounds=(0, 0, 10, 10),
    robot_radius=0.4,
)
TURNING_RADIUS = 0.9


def plane():
    return ob.RealVectorStateSpace(2)


SPACES = {
    "plane": plane,
    "se2": ob.SE2StateSpace,
    "dubins": lambda: ob.DubinsStateSpace(TURNING_RADIUS),
    "reeds_shepp": lambda: ob.ReedsSheppStateSpace(TURNING_RADIUS),
}


def information(name):
    space = SPACES[name]()
    bounds = ob.RealVectorBounds(2)
    bounds.setLow(0)
    bounds.setHigh(10)
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    use_world(si, WORLD)
    si.setup()
    return si


def placed(si, name, x, y, yaw):
    state = si.allocState()
    if name == "plane":
        state[0], state[1] = x, y
    else:
        state.setXY(x, y)
        state.setYaw(yaw)
    return state


def pairs(count, spread):
    rng = np.random.default_rng(3)
    a = rng.uniform(0, 10, (count, 2))
    return a, np.clip(a + rng.normal(0, spread, (count, 2)), -1, 11), rng.uniform(-np.pi, np.pi, (count, 2))


@pytest.mark.parametrize("name", ["plane", "se2"])
def test_straight_motions_get_the_answer_of_the_world(name):
    si = information(name)
    a, b, yaw = pairs(400, 3.0)
    expected = WORLD.segments_free(a, b)
    assert 50 < expected.sum() < 350
    states = [(placed(si, name, *p, t0), placed(si, name, *q, t1)) for p, q, (t0, t1) in zip(a, b, yaw, strict=True)]
    assert [si.checkMotion(s, t) for s, t in states] == expected.tolist()
    assert [si.getStateValidityChecker().isValid(s) for s, _ in states] == WORLD.is_free(a).tolist()


@pytest.mark.parametrize("name", ["dubins", "reeds_shepp"])
def test_curved_motions_are_accepted_only_where_every_point_of_them_is_free(name):
    si = information(name)
    space = si.getStateSpace()
    between = si.allocState()
    a, b, yaw = pairs(300, 1.2)
    accepted = 0
    for p, q, (t0, t1) in zip(a, b, yaw, strict=True):
        s, t = placed(si, name, *p, t0), placed(si, name, *q, t1)
        points = []
        for share in np.linspace(0, 1, 400):
            space.interpolate(s, t, float(share), between)
            points.append((between.getX(), between.getY()))
        if si.checkMotion(s, t):
            accepted += 1
            assert WORLD.is_free(points).all()
        else:
            curve = shapely.LineString(points)
            edge = shapely.box(*WORLD.bounds).exterior
            near = min(shapely.distance(curve, WORLD.obstacles), shapely.distance(curve, edge))
            outside = not shapely.box(*WORLD.bounds).contains(curve)
            # The world's own inflation takes up to 3 % more than the radius, the tangents 0.4 % of the turning radius.
            assert outside or near <= 1.03 * WORLD.robot_radius + 0.004 * TURNING_RADIUS + 1e-3
    assert 20 < accepted < 280


def test_a_world_is_a_floor_plan():
    with pytest.raises(ValueError, match=r"got World.*a floor plan"):
        use_world(ob.SpaceInformation(ob.RealVectorStateSpace(3)), WORLD)
    with pytest.raises(ValueError, match=r"state space of known motions.*TrochoidStateSpace"):
        use_world(ob.SpaceInformation(ob.TrochoidStateSpace(1.0, 0.1, 0.2)), WORLD)


@pytest.mark.parametrize("side", ["outside", "inside"])
@pytest.mark.parametrize(("gap", "free"), [(-0.001, False), (0.02, True)])
def test_a_curve_that_grazes_a_wall_by_a_millimetre_is_refused(side, gap, free):
    """A left turn of radius 2 m about (0, 2), farthest right at (2, 2), in the middle between two joints of chords."""
    radius, robot = 2.0, 0.1
    grown = robot * 1.0028  # the world's inflation, whose flat sides are that far from the wall
    wall = (
        shapely.box(radius + grown + gap, 1, radius + 1, 3)
        if side == "outside"
        else shapely.box(0.5, 1.999, radius - grown - gap, 2.001)
    )
    world = World.from_polygons([wall], bounds=(-5, -5, 5, 9), robot_radius=robot)
    space = ob.DubinsStateSpace(radius)
    si = ob.SpaceInformation(space)
    use_world(si, world)
    first, last = np.radians([-4.9, 184.9])  # 19 chords, the middle of the tenth of which is meant
    a, b = (placed(si, "dubins", radius * np.sin(h), radius - radius * np.cos(h), h) for h in (first, last))
    between = si.allocState()
    space.interpolate(a, b, 0.5, between)
    assert (between.getX(), between.getY()) == pytest.approx((radius, radius))
    assert si.checkMotion(a, b) == free
    assert si.isValid(between) == free
