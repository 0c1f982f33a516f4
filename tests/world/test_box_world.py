"""BoxWorld against clipping, plane by plane, and against points along the way; and as OMPL asks it."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ompl import base as ob

from driftplan.model.noise import OdometryNoise
from driftplan.planning.ompl.collision import use_world
from driftplan.planning.ompl.objective import DriftObjective
from driftplan.world.box_world import BoxWorld
from driftplan.world.world import World

BOUNDS = ((0.0, 0.0, 0.0), (20.0, 15.0, 10.0))


def random_world(seed: int, radius: float = 0.4) -> BoxWorld:
    rng = np.random.default_rng(seed)
    low = rng.uniform(BOUNDS[0], BOUNDS[1], (12, 3))
    return BoxWorld(boxes=np.stack([low, low + rng.uniform(0, 3, (12, 3))], axis=1), bounds=BOUNDS, robot_radius=radius)


def clipped(world: BoxWorld, a, b) -> bool:
    """Whether a segment is free: what is left of it between the two planes of every axis, box by box."""
    r = world.robot_radius
    if not all(lo + r < p[k] < hi - r for p in (a, b) for k, (lo, hi) in enumerate(zip(*world.bounds, strict=True))):
        return False
    for low, high in world.boxes:
        first, last = 0.0, 1.0
        for k in range(3):
            way = b[k] - a[k]
            if way == 0:
                first = first if low[k] - r <= a[k] <= high[k] + r else 2.0
                continue
            enter, leave = sorted(((low[k] - r - a[k]) / way, (high[k] + r - a[k]) / way))
            first, last = max(first, enter), min(last, leave)
        if first <= last:
            return False
    return True


@pytest.mark.parametrize("seed", range(5))
def test_motions_are_free_where_nothing_is_left_of_them_between_a_boxs_planes(seed):
    world, rng = random_world(seed), np.random.default_rng(100 + seed)
    a, b = rng.uniform(*BOUNDS, (2, 400, 3))
    b[::4, rng.integers(3)] = a[::4, rng.integers(3)]
    b[1::4, :2] = a[1::4, :2]  # along an axis
    b[2::40] = a[2::40]  # points
    expected = [clipped(world, p, q) for p, q in zip(a, b, strict=True)]
    assert 0.1 < np.mean(expected) < 0.9
    assert world.segments_free(a, b).tolist() == expected
    assert world.segments_free(b, a).tolist() == expected
    assert [world.segment_free(*p, *q) for p, q in zip(a[:50], b[:50], strict=True)] == expected[:50]


def test_a_free_motion_keeps_the_ball_clear_of_every_box():
    world, rng = random_world(7), np.random.default_rng(8)
    a, b = rng.uniform(*BOUNDS, (2, 300, 3))
    free = world.segments_free(a, b)
    along = (a + np.linspace(0, 1, 400)[:, None, None] * (b - a))[:, free]
    nearest = np.clip(along[:, :, None], world.boxes[:, 0], world.boxes[:, 1])
    assert np.linalg.norm(along[:, :, None] - nearest, axis=-1).min() >= world.robot_radius
    assert world.is_free(along).all()


@given(st.permutations(range(3)), st.integers(0, 50))
def test_it_does_not_mind_which_axis_is_which(order, seed):
    world, rng = random_world(seed), np.random.default_rng(seed)
    order = list(order)
    other = BoxWorld(boxes=world.boxes[:, :, order], bounds=world.bounds[:, order], robot_radius=world.robot_radius)
    a, b = rng.uniform(*BOUNDS, (2, 20, 3))
    assert world.segments_free(a, b).tolist() == other.segments_free(a[:, order], b[:, order]).tolist()


def test_contact_is_a_collision_and_the_ball_stays_within_bounds():
    world = BoxWorld(boxes=[[(4, 4, 4), (6, 6, 6)]], bounds=[(0, 0, 0), (10, 10, 10)], robot_radius=0.5)
    assert world.is_free([[3.5, 5, 5], [3.499, 5, 5], [0.5, 5, 5], [0.501, 5, 5]]).tolist() == [False, True] * 2
    assert BoxWorld(boxes=np.zeros((0, 2, 3)), bounds=BOUNDS, robot_radius=0).point_free(1, 1, 1)


def test_meshes_are_taken_for_the_boxes_around_them():
    corners = np.array(list(itertools.product((1, 2), (3, 5), (0, 4))))
    ball = np.random.default_rng(0).normal(size=(200, 3)) + 9
    world = BoxWorld.around([corners, ball], bounds=BOUNDS, robot_radius=0.1)
    np.testing.assert_array_equal(world.boxes[0], [(1, 3, 0), (2, 5, 4)])
    np.testing.assert_array_equal(world.boxes[1], [ball.min(axis=0), ball.max(axis=0)])


@pytest.mark.parametrize("make", [lambda: ob.RealVectorStateSpace(3), ob.SE3StateSpace])
def test_ompl_is_told_what_the_world_says(make):
    space, world = make(), random_world(3)
    bounds = ob.RealVectorBounds(3)
    for axis in range(3):
        bounds.setLow(axis, BOUNDS[0][axis])
        bounds.setHigh(axis, BOUNDS[1][axis])
    space.setBounds(bounds)
    si = ob.SpaceInformation(space)
    use_world(si, world)
    si.setup()
    DriftObjective(si, OdometryNoise(heading_var_per_m=1e-3), (1.0, 1.0, 1.0), world)
    states = si.allocState(), si.allocState()
    said = []
    for ends in np.random.default_rng(4).uniform(*BOUNDS, (60, 2, 3)):
        for state, place in zip(states, ends.tolist(), strict=True):
            if hasattr(state, "setXYZ"):
                state.setXYZ(*place)
                state.rotation().setIdentity()
            else:
                state[0], state[1], state[2] = place
        said.append(si.checkMotion(*states))
        assert said[-1] == world.segments_free(*ends)
        assert si.isValid(states[0]) == world.is_free(ends[0])
    assert 0.1 < np.mean(said) < 0.9


def test_what_makes_no_sense_is_refused():
    for boxes, what in (
        ([[(1, 0, 0), (0, 1, 1)]], "a box from least to greatest"),
        ([(1, 0, 0)], r"boxes \(n, 2, 3\)"),
        ([[(1, 0, np.nan), (0, 1, 1)]], "boxes finite"),
    ):
        with pytest.raises(ValueError, match=f"expected {what}"):
            BoxWorld(boxes=boxes, bounds=BOUNDS, robot_radius=0.1)
    with pytest.raises(ValueError, match="bounds from least"):
        BoxWorld(boxes=np.zeros((0, 2, 3)), bounds=BOUNDS[::-1], robot_radius=0.1)
    plane, space = (ob.SpaceInformation(ob.RealVectorStateSpace(n)) for n in (2, 3))
    with pytest.raises(ValueError, match="expected a World in a space of the plane, got a BoxWorld"):
        use_world(plane, random_world(0))
    with pytest.raises(ValueError, match="floor plan"):
        use_world(space, World.from_polygons([], bounds=(0, 0, 1, 1), robot_radius=0.1))
