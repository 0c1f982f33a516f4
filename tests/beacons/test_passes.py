"""Passes part by part: chords, views, sight and what joins them, by plain geometry or point by point."""

from itertools import pairwise

import numpy as np
import pytest

from driftplan.beacons import passes
from driftplan.beacons.passes import Views, chords_in_discs, passes_of
from driftplan.world.world import World

BOX = (-20, -20, 20, 20)


def views(facing_deg=0.0, half_deg=180.0, sensor_half_deg=180.0, n=1):
    return Views(*(np.full(n, np.radians(x)) for x in (facing_deg, half_deg, sensor_half_deg)))


def of_one(path, xy, range_m=4.0, *, must_see=False, world=None, seen_from=None):
    """Passes of one beacon, as pairs."""
    path, xy = np.array(path, dtype=float), np.array([xy], dtype=float)
    found = passes_of(path, xy, np.array([range_m]), np.array([must_see]), world, seen_from)
    assert (found.beacon == 0).all()
    return list(zip(found.enter.tolist(), found.leave.tolist(), strict=True))


def walls(*polygons):
    return World.from_polygons([list(p) for p in polygons], bounds=BOX, robot_radius=0.1)


# Discs


@pytest.mark.parametrize("seed", range(5))
def test_a_chord_is_where_a_leg_is_no_farther_than_the_radius(seed):
    rng = np.random.default_rng(seed)
    offset, lengths, radius = rng.normal(0, 2, (60, 2)), rng.uniform(0.1, 4, 60), rng.uniform(0.2, 3, 60)
    angle = rng.uniform(-np.pi, np.pi, 60)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    start, end, inside = chords_in_discs(offset, along, lengths, radius)
    for k in range(60):
        s = np.linspace(0, lengths[k], 400)
        near = np.hypot(*(offset[k] - s[:, None] * along[k]).T) <= radius[k]
        assert not near.any() or inside[k]
        if inside[k]:
            between = (start[k] <= s) & (s <= end[k])
            assert (near == between)[np.abs(s - start[k]) > 1e-6].mean() > 0.99
            for x, border in ((start[k], 0.0), (end[k], lengths[k])):
                distance = np.hypot(*(offset[k] - x * along[k]))
                assert x == border or distance == pytest.approx(radius[k], rel=1e-9)
    assert 10 < inside.sum() < 50


@pytest.mark.parametrize(("radius", "inside"), [(5.1, True), (5.0 - 5e-10, True), (5.0 - 2e-9, False), (4.0, False)])
def test_where_a_leg_has_no_length_its_distance_counts_and_a_touch_is_one(radius, inside):
    leg = np.array([[3.0, 4.0]]), np.zeros((1, 2)), np.zeros(1)
    start, end, found = chords_in_discs(*leg, np.array([radius]))
    assert (start[0], end[0], found[0]) == (0.0, 0.0, inside)
    standing = [(1, 1), (1, 1), (1, 1)]
    assert of_one(standing, (4, 5), radius) == [(0.0, 0.0)] * inside
    grazing = of_one([(0, 0), (9, 0)], (3.0, 5.0), radius)
    assert (len(grazing) == 1) == inside
    assert radius > 5.0 or grazing == [(3.0, 3.0)] * inside


def test_intervals_that_end_before_they_begin_by_rounding_are_a_touch():
    start, end = np.array([1.0, 2.0, 3.0, 4.0]), np.array([2.0, 2.0, 3.0 - 5e-10, 4.0 - 2e-9])
    first, last, kept = passes._proper(start, end)
    assert kept.tolist() == [True, True, True, False]
    np.testing.assert_allclose(first[:3], [1.0, 2.0, 3.0 - 2.5e-10], rtol=0, atol=1e-13)
    np.testing.assert_allclose(last[:3], [2.0, 2.0, 3.0 - 2.5e-10], rtol=0, atol=1e-13)


# Views


def test_a_robot_that_stands_looks_nowhere_new():
    ahead = views(sensor_half_deg=60.0)
    assert of_one([(0, 0), (0, 0)], (1, 0)) == [(0.0, 0.0)]
    assert of_one([(0, 0), (0, 0)], (1, 0), seen_from=ahead) == []
    assert of_one([(0, 0), (0, 0)], (1, 0), seen_from=views(180.0, 50.0)) == [(0.0, 0.0)]
    assert of_one([(0, 0), (0, 0)], (1, 0), seen_from=views(0.0, 50.0)) == []
    assert of_one([(0, 0), (0, 0.25), (0, 0.25), (0, 0.5)], (1, 3.5), seen_from=ahead) == [(0.0, 0.5)]
    assert of_one([(0, 0), (0, 0.25), (0, 0.25), (0, 0.5)], (2.5, 0.5), seen_from=ahead) == []


@pytest.mark.parametrize(("shift", "seen"), [(0.0, True), (-1e-6, True), (1e-6, False)])
def test_along_the_border_of_a_view_it_is_seen(shift, seen):
    quarter = views(0.0, 45.0)
    for turn in np.exp(1j * np.radians([0.0, 90.0, 213.0])):
        out = np.array([1 + (1 + shift) * 1j, 4 + (4 + shift) * 1j]) * turn
        facing = views(float(np.degrees(np.angle(turn))), 45.0)
        for path in (out, out[::-1]):
            found = of_one(np.stack([path.real, path.imag], axis=-1), (0.0, 0.0), 9.0, seen_from=facing)
            assert found == ([(0.0, pytest.approx(abs(out[1] - out[0])))] if seen else [])
    assert of_one([(1, -4), (1, 4)], (0, 0), 9.0, seen_from=quarter) == [(pytest.approx(3.0), pytest.approx(5.0))]


@pytest.mark.parametrize("half_deg", [20.0, 89.0, 90.0, 91.0, 135.0, 179.0, 180.0])
def test_a_view_is_a_cone_and_what_is_wider_than_half_a_turn_leaves_a_cone_out(half_deg):
    facing = views(30.0, half_deg)
    for y in (-2.0, 1.0):
        s = np.linspace(0, 16, 1601)[1:-1]
        bearing = np.degrees(np.arctan2(y, s - 8.0)) - 30.0
        seen = np.abs((bearing + 180) % 360 - 180) <= half_deg
        found = of_one([(-8, y), (8, y)], (0.0, 0.0), 9.0, seen_from=facing)
        reach = np.sqrt(81.0 - y * y)
        inside = np.any([(a - 1e-9 <= s) & (s <= b + 1e-9) for a, b in found] or [np.zeros(len(s), bool)], axis=0)
        seen &= np.abs(s - 8.0) <= reach
        clear = ~np.any([np.abs(s - x) < 0.02 for pair in found for x in pair] or [np.zeros(len(s), bool)], axis=0)
        assert (inside == seen)[clear].all()
        assert len(found) <= 2


# Several beacons


def test_passes_of_many_beacons_are_those_of_each_in_order():
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(0, 3, (7, 2)), axis=0)
    path[3] = path[2]
    n = 30
    xy, range_m, must_see = rng.normal(0, 4, (n, 2)) + path[3], rng.uniform(0.5, 5, n), rng.random(n) < 0.5
    seen_from = Views(rng.uniform(-7, 7, n), rng.uniform(0.3, np.pi, n), rng.uniform(0.3, 4.0, n))
    world = World.from_polygons(
        [p + np.array([(0.0, 0.0), (0.6, 0.1), (0.2, 0.7)]) for p in rng.normal(0, 3, (8, 2)) + path[3]],
        bounds=(-90, -90, 90, 90),
        robot_radius=0.1,
    )
    found = passes_of(path, xy, range_m, must_see, world, seen_from)
    alone = [
        passes_of(path, xy[[k]], range_m[[k]], must_see[[k]], world, Views(*(x[[k]] for x in seen_from)))
        for k in range(n)
    ]
    assert found.beacon.tolist() == [k for k in range(n) for _ in alone[k].enter]
    np.testing.assert_array_equal(found.enter, np.concatenate([x.enter for x in alone]))
    np.testing.assert_array_equal(found.leave, np.concatenate([x.leave for x in alone]))
    blind = passes_of(path, xy, range_m, np.zeros(n, bool), world, seen_from)
    hidden = [k for k in range(n) if found.leave[found.beacon == k].sum() != blind.leave[blind.beacon == k].sum()]
    assert hidden
    assert must_see[hidden].all()


def test_stretches_that_touch_or_overlap_are_joined_of_one_beacon_only():
    beacon = np.array([1, 0, 0, 0, 0, 1])
    enter = np.array([3.0, 5.0, 1.0, 2.0, 4.0 + 1.5e-9, 1.0])
    leave = np.array([4.0, 6.0, 2.0, 4.0, 4.5, 3.0 - 2.5e-9])
    found = passes._merged(beacon, enter, leave, 6.0000004)
    assert found.beacon.tolist() == [0, 0, 1, 1]
    assert found.enter.tolist() == [1.0, 5.0, 1.0, 3.0]
    assert found.leave.tolist() == [4.5, 6.0000004, 3.0, 4.0]  # the end of the path is the end of the path
    none = np.zeros(0)
    assert len(passes._merged(none.astype(int), none, none, 5.0).enter) == 0


# Sight


@pytest.mark.parametrize("seed", range(4))
def test_a_shadow_is_between_the_outermost_rays_through_an_obstacle(seed):
    rng = np.random.default_rng(seed)
    eye, a, b = np.array([0.3, 5.0]), np.array([-4.0, -1.0]), np.array([6.0, 0.5])
    corners = np.stack([rng.uniform(-1, 2, 5), rng.uniform(1.5, 3, 5)], axis=-1)
    corners = np.concatenate([corners, [eye, [0.3, 4.0], [1.0, 3.0]]])  # what touches the eye is in no direction
    length = float(np.hypot(*(b - a)))
    t = [np.linalg.solve(np.stack([b - a, eye - c], axis=-1), eye - a)[0] for c in corners if (c != eye).any()]
    low, high = passes._shadow(eye, a, b, length, corners)
    assert (low, high) == (pytest.approx(min(t) * length), pytest.approx(max(t) * length))


@pytest.mark.parametrize(
    ("wall", "hidden"),
    [
        ((5.0, 6.0), (5.0, np.inf)),
        ((1.0, 2.0), (-np.inf, 2.0)),
        ((3.1, 4.0), (3.1, np.inf)),
        ((2.0, 2.9), (-np.inf, 2.9)),
        ((2.0, 4.0), (-np.inf, np.inf)),
    ],
)
def test_on_the_line_of_the_chord_all_behind_an_obstacle_is_hidden(wall, hidden):
    along = np.array([0.6, 0.8])
    a = np.array([2.0, -1.0])
    corners = np.stack([a + x * along for x in wall])
    found = passes._shadow_on_line(a + 3.0 * along, a, a + 8.0 * along, 8.0, corners)
    assert found == (pytest.approx(hidden[0]), pytest.approx(hidden[1]))


@pytest.mark.parametrize(
    ("shadows", "gaps"),
    [
        ([], [(0.0, 9.0)]),
        ([(2.0, 3.0)], [(0.0, 2.0), (3.0, 9.0)]),
        ([(5.0, 6.0), (2.0, 4.0), (2.5, 3.0)], [(0.0, 2.0), (4.0, 5.0), (6.0, 9.0)]),
        ([(-np.inf, 1.0), (8.0, np.inf)], [(1.0, 8.0)]),
        ([(-2.0, -1.0), (10.0, 12.0)], [(0.0, 9.0)]),
        ([(0.0, 4.0), (4.0 + 5e-7, 9.0)], []),
        ([(0.0, 4.0), (4.0 + 2e-6, 9.0)], [(4.0, 4.0 + 2e-6)]),
        ([(-np.inf, np.inf)], []),
    ],
)
def test_what_shadows_leave_is_seen(shadows, gaps):
    assert passes._gaps(shadows, 9.0) == gaps


def test_a_graze_is_seen_unless_something_is_in_the_way():
    path, beacon = [(-7, 0), (7, 0)], (1.0, 4.0)
    assert of_one(path, beacon, must_see=True, world=walls([(4, 1), (5, 1), (5, 3), (4, 3)])) == [(8.0, 8.0)]
    wall = walls([(0, 1), (2, 1), (2, 3), (0, 3)])
    assert of_one(path, beacon, must_see=True, world=wall) == []
    assert of_one(path, beacon, must_see=False, world=wall) == [(8.0, 8.0)]
    assert of_one([(1, 0), (1, 0)], beacon, must_see=True, world=wall) == []


@pytest.mark.parametrize("turn_deg", [0.0, 37.0, 90.0, 180.0])
def test_on_a_straight_path_towards_and_past_a_beacon_walls_hide_what_is_behind_them(turn_deg):
    turn = np.exp(1j * np.radians(turn_deg))

    def turned(points):
        z = np.array([complex(*p) for p in points]) * turn
        return np.stack([z.real, z.imag], axis=-1)

    def wall(x0, x1):
        return turned([(x0, -1.0), (x1, -1.0), (x1, 1.0), (x0, 1.0)])

    for x0, x1, seen in ((3.0, 4.0, (-6.0, 3.0)), (-4.0, -3.0, (-3.0, 6.0))):
        world = walls(wall(x0, x1))
        beacon = tuple(turned([(0.0, 0.0)])[0])
        ((enter, leave),) = of_one(turned([(-8, 0), (8, 0)]), beacon, 6.0, must_see=True, world=world)
        assert (enter - 8.0, leave - 8.0) == (pytest.approx(seen[0], abs=3e-6), pytest.approx(seen[1], abs=3e-6))
    both = of_one(turned([(-8, 0), (8, 0)]), beacon, 6.0, must_see=True, world=walls(wall(3, 4), wall(-4, -3)))
    assert [x - 8.0 for pair in both for x in pair] == pytest.approx([-3.0, 3.0], abs=3e-6)


@pytest.mark.parametrize("seed", range(3))
def test_among_many_walls_a_beacon_is_seen_where_the_straight_line_to_it_is_free(seed):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(-6, 6, (9, 2))
    world = walls(*([tuple(p + d) for d in ([0, 0], [0.7, 0], [0.7, 0.7], [0, 0.7])] for p in corner))
    path = np.array([(-7.5, -3.0), (0.5, 7.0), (7.5, -2.0), (-7.0, -1.0)])
    beacon = rng.uniform(-2, 2, 2)
    found = of_one(path, beacon, 5.0, must_see=True, world=world)
    steps = np.diff(path, axis=0)
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*steps.T))])
    s = rng.uniform(0, driven[-1], 500)
    places = np.stack([np.interp(s, driven, path[:, k]) for k in (0, 1)], axis=-1)
    seen = (np.hypot(*(places - beacon).T) <= 5.0) & world.line_of_sight(places, np.broadcast_to(beacon, (500, 2)))
    inside = np.any([(a <= s) & (s <= b) for a, b in found] or [np.zeros(500, bool)], axis=0)
    clear = ~np.any([np.abs(s - x) < 1e-3 for pair in found for x in pair] or [np.zeros(500, bool)], axis=0)
    assert (inside == seen)[clear].all()
    assert all(b <= c for (_, b), (c, _) in pairwise(found))
