"""The first route, over the triangles of free space: free, from end to end, wherever there is a way."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.planning.roadmap import kept_graph
from driftplan.planning.roadmap.kept_graph import channel_route, mesh_of
from driftplan.planning.roadmap.prices import length_of
from driftplan.world.world import World


def box(x0, y0, x1, y1):
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def slit(width, radius=0.3):
    """Two rooms and a wall 2 m thick, with a passage of that width for the robot's centre."""
    half = radius + width / 2
    walls = [box(9, -1, 11, 5 - half), box(9, 5 + half, 11, 11)]
    return World.from_polygons(walls, bounds=(0, 0, 20, 10), robot_radius=radius)


coordinate = st.floats(0.5, 11.5)


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(st.floats(0, 9), st.floats(0, 9), st.floats(0.2, 3), st.floats(0.2, 3)), max_size=8),
    st.tuples(coordinate, coordinate),
    st.tuples(coordinate, coordinate),
)
def test_a_way_is_free_and_leads_from_start_to_goal_wherever_there_is_one(boxes, start, goal):
    walls = [box(x, y, x + w, y + h) for x, y, w, h in boxes]
    world, ends = World.from_polygons(walls, bounds=(0, 0, 12, 12), robot_radius=0.25), np.array([start, goal])
    if not world.is_free(ends).all() or np.ptp(world.free_part(ends)):
        return
    path = channel_route(world, ends)
    if path is None:  # round-off only: then an end or a passage is at a wall
        assert shapely.distance(shapely.points(ends), shapely.boundary(world.free_parts[0])).min() < 1e-3
        return
    np.testing.assert_array_equal(path[[0, -1]], ends)
    assert world.segments_free(path[:-1], path[1:]).all()
    assert length_of(path) >= np.linalg.norm(ends[1] - ends[0]) * (1 - 1e-12)


@pytest.mark.parametrize("width", [1.0, 0.1, 0.01])
def test_a_passage_may_be_as_narrow_as_a_centimetre(width):
    world, ends = slit(width), np.array([(2.0, 8.0), (18.0, 2.0)])
    path = channel_route(world, ends)
    assert world.segments_free(path[:-1], path[1:]).all()
    inside = path[(path[:, 0] > 9) & (path[:, 0] < 11)]
    assert (np.abs(inside[:, 1] - 5) <= width / 2 + 1e-9).all()


def test_within_one_triangle_the_way_is_straight():
    ends = np.array([(2.0, 8.0), (2.1, 8.0)])
    world = World.from_polygons([], bounds=(0, 0, 20, 10), robot_radius=0.3)
    np.testing.assert_array_equal(channel_route(world, ends), ends)


def test_arcs_round_corners_are_thinned_out_first():
    world = slit(0.1)
    assert len(mesh_of(world, 0, kept_graph._THINNING_RADII).sides) < 0.5 * len(mesh_of(world, 0).sides)


@pytest.mark.parametrize("radii", [1.0, 3.0, 100.0])
def test_where_thinning_closes_or_opens_too_much_all_triangles_are_looked_at(monkeypatch, radii):
    monkeypatch.setattr(kept_graph, "_THINNING_RADII", radii)
    world, ends = slit(0.01), np.array([(2.0, 8.0), (18.0, 2.0)])
    path = channel_route(world, ends)
    assert world.segments_free(path[:-1], path[1:]).all()
