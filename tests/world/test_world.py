"""World: a disc never touches what it may not, one test decides, and zones and corners keep their promises."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan.errors import ArgumentError
from driftplan.model.noise import OdometryNoise
from driftplan.world import inflation
from driftplan.world.mapfiles import load_world
from driftplan.world.world import World
from driftplan.world.zones import Zone

DATA = Path(__file__).resolve().parents[2] / "../shared/data"
WET = OdometryNoise(heading_var_per_m=1e-3)
CARPET = OdometryNoise(heading_var_per_m=2e-3)

seeds = st.integers(0, 2**32 - 1)
some = settings(max_examples=40, deadline=None)
few = settings(max_examples=12, deadline=None)  # where every example fills a table for the scalar tests


@pytest.fixture(autouse=True, scope="module")
def asked_often():
    """Both ways to answer one question at a time are gone, with and without the table of cells."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(inflation, "_FIRST_ASKED", 50)
        yield


def random_world(seed: int, *, zones: int = 0) -> tuple[World, np.random.Generator]:
    """Up to nine polygons, boxes and spikes in a map of 1, 20 or 300 m, somewhere; the radius from tiny to wide."""
    rng = np.random.default_rng(seed)
    size = rng.choice([1.0, 20.0, 300.0])
    corner = rng.choice([0.0, -7.3, 5e4]) * np.array([1.0, -1.0])
    obstacles = []
    for _ in range(rng.integers(1, 10)):
        at = rng.uniform(0, size, 2)
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 8)))
        star = at + rng.uniform(0.02, 0.25, (len(angles), 1)) * size * np.stack(
            [np.cos(angles), np.sin(angles)], axis=-1
        )
        box = shapely.get_coordinates(shapely.box(*at, *(at + rng.uniform(0.01, 0.3, 2) * size)))
        polygon = shapely.Polygon(corner + (box if rng.random() < 0.5 else star))
        if polygon.is_valid and polygon.area > 1e-6 * size**2:
            obstacles.append(polygon)
    patches = [
        Zone(shapely.box(*low, *(low + rng.uniform(0.1, 0.6, 2) * size)), CARPET)
        for low in corner + rng.uniform(0, 0.8 * size, (zones, 2))
    ]
    bounds = (*corner, *(corner + size))
    radius = size * rng.choice([0.0, 0.001, 0.02, 0.06])
    return World.from_polygons(obstacles, bounds=bounds, robot_radius=radius, zones=patches), rng


def random_points(world: World, rng: np.random.Generator, n: int) -> np.ndarray:
    low, high = np.array(world.bounds[:2]), np.array(world.bounds[2:])
    return rng.uniform(low - 0.05 * (high - low), high + 0.05 * (high - low), (n, 2))


def random_segments(world: World, rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """From short to right across the map."""
    a = random_points(world, rng, n)
    reach = (world.bounds[2] - world.bounds[0]) * rng.choice([0.01, 0.05, 0.4], (n, 1))
    return a, a + reach * rng.normal(size=(n, 2))


def distance_to_edge(world: World, xy: np.ndarray) -> np.ndarray:
    xmin, ymin, xmax, ymax = world.bounds
    return np.min([xy[..., 0] - xmin, xy[..., 1] - ymin, xmax - xy[..., 0], ymax - xy[..., 1]], axis=0)


# Laws of driving


@some
@given(seed=seeds)
def test_what_is_accepted_keeps_the_radius_and_what_keeps_a_little_more_is_accepted(seed):
    world, rng = random_world(seed)
    a, b = random_segments(world, rng, 300)
    accepted = world.segments_free(a, b)
    to_wall = [shapely.LineString([p, q]).distance(world.obstacles) for p, q in zip(a, b, strict=True)]
    to_wall = np.nan_to_num(to_wall, nan=np.inf)  # no obstacle at all
    gap = np.minimum(to_wall, np.minimum(distance_to_edge(world, a), distance_to_edge(world, b)))
    assert (gap[accepted] >= world.robot_radius - 1e-9).all()
    assert accepted[(gap > 1.03 * world.robot_radius) & (gap > 0)].all()


@some
@given(seed=seeds)
def test_the_whole_outline_of_the_free_area_keeps_the_radius(seed):
    world, _ = random_world(seed)
    # The middle of a chord that replaces an arc comes nearest.
    chords = [shapely.get_coordinates(ring) for ring in shapely.get_rings(shapely.get_parts(world.free))]
    middles = np.concatenate([0.5 * (ring[1:] + ring[:-1]) for ring in chords] or [np.zeros((0, 2))])
    to_wall = np.nan_to_num(shapely.distance(world.obstacles, shapely.points(middles)), nan=np.inf)
    assert (np.minimum(to_wall, distance_to_edge(world, middles)) >= world.robot_radius - 1e-9).all()


@few
@given(seed=seeds)
def test_the_answer_for_many_segments_is_that_for_each_one_alone(seed):
    world, rng = random_world(seed)
    a, b = random_segments(world, rng, 200)
    together = world.segments_free(a, b)
    assert together.tolist() == [bool(world.segments_free(p, q)) for p, q in zip(a, b, strict=True)]
    assert together.tolist() == [world.segment_free(*p, *q) for p, q in zip(a.tolist(), b.tolist(), strict=True)]
    assert together.tolist() == world.segments_free(b, a).tolist()
    # A slow oracle: the whole motion lies in the free area. Its boundary is not free, but no random segment is on it.
    area = shapely.Polygon(world.free) if isinstance(world.free, shapely.Polygon) else shapely.MultiPolygon(world.free)
    assert together.tolist() == [area.contains(shapely.LineString([p, q])) for p, q in zip(a, b, strict=True)]


@few
@given(seed=seeds)
def test_a_point_is_free_exactly_when_standing_there_is(seed):
    world, rng = random_world(seed)
    xy = np.concatenate([random_points(world, rng, 200), shapely.get_coordinates(world.free)[:50]])
    free = world.is_free(xy)
    assert free.tolist() == world.segments_free(xy, xy).tolist()
    assert free.tolist() == [world.point_free(*p) for p in xy.tolist()]
    assert free.tolist() == [world.segment_free(*p, *p) for p in xy.tolist()]


@some
@given(seed=seeds)
def test_moving_the_map_moves_the_answers(seed):
    world, rng = random_world(seed)
    a, b = random_segments(world, rng, 100)
    xmin, ymin, xmax, ymax = world.bounds
    turned = World.from_polygons(  # a quarter turn: exact in floating point
        [shapely.transform(part, lambda xy: xy[:, ::-1] * [-1, 1]) for part in world.obstacles.geoms],
        bounds=(-ymax, xmin, -ymin, xmax),
        robot_radius=world.robot_radius,
    )
    turn = np.array([-1, 1])
    assert (world.segments_free(a, b) == turned.segments_free(a[:, ::-1] * turn, b[:, ::-1] * turn)).all()


def test_the_table_of_cells_is_made_for_those_who_ask_often():
    world = World.from_polygons([[(4, 0), (6, 0), (6, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    for _ in range(inflation._FIRST_ASKED):
        assert world.point_free(2.0, 2.0)
    assert "_reach" not in vars(world._inflation)
    assert world.segment_free(2.0, 2.0, 2.0, 8.0)
    assert "_reach" in vars(world._inflation)


def test_shapes_broadcast():
    world = World.from_polygons([[(4, 0), (6, 0), (6, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    assert world.segments_free(np.ones((3, 1, 2)), np.full((1, 4, 2), 2.0)).shape == (3, 4)
    assert world.segments_free(np.zeros((0, 2)), np.zeros((0, 2))).shape == (0,)
    assert world.is_free([1.0, 1.0]).shape == ()
    assert world.line_of_sight([1.0, 1.0], np.ones((5, 2))).shape == (5,)


def test_the_robot_must_not_touch_the_edge_of_the_map():
    world = World.from_polygons([], bounds=(0, 0, 10, 10), robot_radius=1.0)
    assert world.is_free([[1.0, 5.0], [1.000001, 5.0], [9.0, 9.0], [-3.0, 5.0]]).tolist() == [False, True, False, False]
    assert world.segment_free(1.5, 1.5, 8.5, 8.5)
    assert not world.segment_free(1.5, 1.5, 9.5, 8.5)
    assert not world.segment_free(1.5, 1.5, float("nan"), 8.5)


def test_a_map_without_room_has_no_free_place():
    world = World.from_polygons([], bounds=(0, 0, 1, 10), robot_radius=0.5)
    assert world.free.is_empty
    assert world.free_parts == ()
    assert not world.is_free([0.5, 5.0])
    assert not world.segment_free(0.5, 4.0, 0.5, 5.0)
    with pytest.raises(ValueError, match=r"no place of this map is free for a robot of radius 0\.5 m"):
        world.nearest_free([0.5, 5.0])


@few
@given(seed=seeds)
def test_the_nearest_free_point_is_free_and_nearest(seed):
    world, rng = random_world(seed)
    others = random_points(world, rng, 2000)
    others = others[world.is_free(others)]
    if not len(others):
        return
    for here in random_points(world, rng, 5):
        nearest = world.nearest_free(here)
        assert world.is_free(nearest)
        assert np.hypot(*(nearest - here)) <= np.hypot(*(others - here).T).min() + 1e-5
        if world.is_free(here):
            assert (nearest == here).all()


@some
@given(seed=seeds)
def test_no_free_segment_leads_from_one_part_to_another(seed):
    world, rng = random_world(seed)
    a, b = random_segments(world, rng, 300)
    part_a, part_b = world.free_part(a), world.free_part(b)
    assert ((part_a >= 0) == world.is_free(a)).all()
    assert (part_a == part_b)[world.segments_free(a, b)].all()
    # shares of the map by area, within 6 standard errors of 300 points: hypothesis draws new worlds every time
    xmin, ymin, xmax, ymax = world.bounds
    share = sum(part.area for part in world.free_parts) / (1.1**2 * (xmax - xmin) * (ymax - ymin))
    assert abs((part_a >= 0).mean() - share) < 6 * np.sqrt(0.25 / 300)


def test_parts_come_largest_first():
    wall = [(4, 0), (6, 0), (6, 10), (4, 10)]
    world = World.from_polygons([wall], bounds=(0, 0, 12, 10), robot_radius=0.5)
    assert [part.bounds[0] > 6 for part in world.free_parts] == [True, False]
    assert world.free_part([[9, 5], [2, 5], [5, 5], [-1, 5]]).tolist() == [0, 1, -1, -1]


# Corners


@some
@given(seed=seeds)
def test_corners_are_free(seed):
    world, _ = random_world(seed)
    corners = world.corners()
    assert world.is_free(corners).all()
    assert (shapely.distance(world.obstacles, shapely.points(corners)) >= world.robot_radius).all() or not len(corners)


def test_the_way_round_a_pillar_leads_over_its_corners():
    pillar = [(4, 4), (6, 4), (6, 6), (4, 6)]
    world = World.from_polygons([pillar], bounds=(0, 0, 10, 10), robot_radius=0.5)
    # From west to east, tangent to the disc-grown pillar: two straights of 4 and 3 m, two quarter circles of 0.5 m.
    start, goal = (0.6, 6.5), (9.4, 6.5)
    corners = world.corners()
    upper = corners[(corners[:, 1] > 6.4)]
    upper = upper[np.argsort(upper[:, 0])]
    around = np.concatenate([[start], upper, [goal]])
    assert world.segments_free(around[:-1], around[1:]).all()
    length = np.hypot(*np.diff(around, axis=0).T).sum()
    assert 8.8 < length < 8.8 * 1.005


def test_a_diagonal_wall_of_cells_has_corners_at_its_ends_only():
    stairs = [shapely.box(i, i, i + 3, i + 3) for i in range(40)]
    world = World.from_polygons(stairs, bounds=(-10, -10, 60, 60), robot_radius=0.4)
    corners = world.corners()
    along = corners.sum(axis=1) / 2
    assert ((along < 5) | (along > 38)).all()
    assert len(corners) < 30


# Seeing


def test_walls_block_the_view_but_can_be_seen():
    world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
    eye = [1.0, 3.0]
    seen = {
        "wall near": (4.0, 3.0),
        "wall far": (6.0, 3.0),
        "behind": (9.0, 3.0),
        "over": (4.0, 9.0),
        "along": (4.0, 7.0),
    }
    assert world.line_of_sight(eye, list(seen.values())).tolist() == [True, False, False, True, True]
    assert world.line_of_sight([4.0, 0.0], [4.0, 7.0])  # grazing the whole wall
    assert not world.line_of_sight([5.0, 0.0], [5.0, 7.0])  # through it


@some
@given(seed=seeds)
def test_sight_agrees_with_how_far_the_ray_runs_inside_walls(seed):
    world, rng = random_world(seed)
    a, b = random_segments(world, rng, 200)
    inside = np.nan_to_num(shapely.intersection(shapely.linestrings(np.stack([a, b], axis=1)), world.obstacles)).astype(
        object
    )
    length = shapely.length(inside)
    seen = world.line_of_sight(a, b)
    assert (length[seen] < 1e-2 * (world.bounds[2] - world.bounds[0])).all()  # a grazed corner, if anything
    assert seen[length == 0].all()
    assert (seen == world.line_of_sight(b, a)).all()


# Zones


@some
@given(seed=seeds)
def test_pieces_cover_every_segment_once_and_lie_in_one_zone_each(seed):
    world, rng = random_world(seed, zones=3)
    a, b = random_segments(world, rng, 60)
    b[:3] = a[:3]  # no length
    pieces = world.zone_pieces(a, b)
    assert pieces.segment.tolist() == sorted(pieces.segment)
    assert set(pieces.segment) == set(range(60))
    for i in range(60):
        mine = pieces.segment == i
        start, end = pieces.start[mine], pieces.end[mine]
        assert start[0] == 0
        assert end[-1] == 1
        assert (start[1:] == end[:-1]).all()
        assert (np.diff(pieces.zone[mine]) != 0).all()
        at = start + rng.uniform(1e-6, 1 - 1e-6, (20, 1)) * (end - start)
        here = a[i] + at[..., None] * (b[i] - a[i])
        assert (world.zone_at(here) == pieces.zone[mine]).mean() > 0.99  # a point may round across an edge


@some
@given(seed=seeds)
def test_zones_of_few_sides_are_cut_where_those_of_many_are(seed):
    world, rng = random_world(seed, zones=3)
    a, b = random_segments(world, rng, 60)
    found = []
    for sides in (10**9, 0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("driftplan.world.zones._FEW_SIDES", sides)
            found.append(world.zone_pieces(a, b))
    few, many = found
    assert few.segment.tolist() == many.segment.tolist()
    assert few.zone.tolist() == many.zone.tolist()
    np.testing.assert_allclose([few.start, few.end], [many.start, many.end], atol=1e-9)


@some
@given(seed=seeds)
def test_cutting_a_path_at_zones_does_not_change_it(seed):
    world, rng = random_world(seed, zones=3)
    path = random_points(world, rng, 8)
    cut, zone = world.cut_at_zones(path)
    assert len(zone) == len(cut) - 1
    assert {tuple(p) for p in path} <= {tuple(p) for p in cut}
    length, cut_length = (np.hypot(*np.diff(p, axis=0).T).sum() for p in (path, cut))
    assert cut_length == pytest.approx(length, rel=1e-9)  # round-off of a few cuts, far from the origin


@pytest.mark.parametrize("seed", range(8))
def test_segments_along_a_side_and_on_into_a_zone_of_many_sides_are_cut_at_its_end(seed):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 48))
    corners = np.column_stack([np.cos(angle), np.sin(angle)]) * rng.uniform(1, 4, (48, 1)) + 5
    world = World.from_polygons([], bounds=(0, 0, 10, 10), robot_radius=0.1, zones=[Zone(corners, WET)])
    side = np.roll(corners, -1, axis=0) - corners
    a, b = np.concatenate([corners, corners]), np.concatenate([corners + 1.5 * side, corners - 0.5 * side])
    pieces = world.zone_pieces(a, b)
    for share in (0.05, 0.35, 0.5, 0.7, 0.95):
        here = (1 - share) * pieces.start + share * pieces.end
        points = a[pieces.segment] + here[:, None] * (b - a)[pieces.segment]
        off = shapely.distance(world.zones[0].polygon.boundary, shapely.points(points)) > 1e-9
        assert (world.zone_at(points) == pieces.zone)[off].all()


def test_the_later_zone_holds_where_two_overlap():
    zones = [Zone(shapely.box(0, 0, 4, 4), WET), Zone(shapely.box(2, 0, 6, 4), CARPET)]
    world = World.from_polygons([], bounds=(-1, -1, 9, 9), robot_radius=0.1, zones=zones)
    assert world.zone_at([[1, 1], [3, 1], [5, 1], [8, 1]]).tolist() == [0, 1, 1, -1]
    base = OdometryNoise(heading_var_per_m=1e-4)
    assert [world.noise_at((x, 1), base) for x in (1, 3, 8)] == [WET, CARPET, base]
    pieces = world.zone_pieces([[-1, 1]], [[9, 1]])
    assert pieces.zone.tolist() == [-1, 0, 1, -1]
    assert pieces.start.tolist() == pytest.approx([0, 0.1, 0.3, 0.7])


# Values


def test_a_pickled_world_gives_the_same_answers_and_carries_no_caches():
    world, rng = random_world(3, zones=2)
    a, b = random_segments(world, rng, 50)
    answers = world.segments_free(a, b)
    world.segment_free(*a[0], *b[0])
    copy = pickle.loads(pickle.dumps(world))
    assert set(vars(copy)) == {"obstacles", "bounds", "robot_radius", "zones", "notes"}
    assert (copy.segments_free(a, b) == answers).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"robot_radius": -0.1}, "robot_radius >= 0, got -0.1"),
        ({"robot_radius": float("nan")}, "robot_radius finite, got nan"),
        ({"bounds": (0, 0, 0, 5)}, "bounds .*not empty"),
        ({"bounds": (0, 0, float("inf"), 5)}, "bounds .*finite"),
        ({"obstacles": [[(0, 0), (1, 1)]]}, "obstacle 0 to have 3 or more corners"),
        ({"obstacles": [[(0, 0), (2, 2), (2, 0), (0, 2)]]}, "obstacle 0 to be a valid polygon, got Self-intersection"),
        ({"obstacles": [[(0, 0), (2, 2), (float("nan"), 0)]]}, "obstacle 0 finite"),
        ({"obstacles": [shapely.Polygon()]}, "obstacle 0 to be finite and not empty"),
        ({"zones": [shapely.box(0, 0, 1, 1)]}, "a zone to be a Zone, got <POLYGON"),
    ],
)
def test_bad_worlds_are_refused(change, message):
    good = {"obstacles": [], "bounds": (0, 0, 5, 5), "robot_radius": 0.1, "zones": []}
    with pytest.raises(ValueError, match=message):
        World.from_polygons(
            (good | change)["obstacles"], **{k: v for k, v in (good | change).items() if k != "obstacles"}
        )


def test_bad_arguments_are_refused():
    world = World.from_polygons([], bounds=(0, 0, 5, 5), robot_radius=0.1)
    with pytest.raises(ValueError, match=r"a to be points \(..., 2\) in metres, got an array of shape \(3,\)"):
        world.segments_free([1, 2, 3], [1, 2])
    with pytest.raises(ValueError, match="b finite, got nan"):
        world.segments_free([1, 2], [1, np.nan])
    with pytest.raises(ValueError, match="xy to be an array of points"):
        world.is_free("here")
    with pytest.raises(ValueError, match="xy to be one point"):
        world.nearest_free([[1, 2], [3, 4]])
    with pytest.raises(ValueError, match="2 or more waypoints"):
        world.cut_at_zones([[1, 2]])
    with pytest.raises(ValueError, match=r"segments \(n, 2\)"):
        world.zone_pieces([1, 2], [3, 4])
    with pytest.raises(ValueError, match="tolerance_m > 0, got 0"):
        world.corners(0)
    with pytest.raises(ArgumentError, match=r"noise to be an OdometryNoise, got 0\.1"):
        Zone(shapely.box(0, 0, 1, 1), 0.1)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("tiny", [5e-324, 1e-308, 1e-160])
def test_legs_of_next_to_no_length_are_cut_like_others(tiny):
    wet = Zone([(2, -1), (4, -1), (4, 1), (2, 1)], OdometryNoise(heading_var_per_m=1e-3))
    world = World.from_polygons([], bounds=(-1, -1, 9, 9), robot_radius=0.1, zones=[wet])
    path, zone = world.cut_at_zones([[0, 0], [tiny, 0], [3, 0]])
    assert path.tolist() == [[0, 0], [tiny, 0], [2, 0], [3, 0]]
    assert zone.tolist() == [-1, -1, 0]


# Real maps


def real(name: str, radius: float) -> World:
    if not (DATA / name).exists():
        pytest.skip(f"needs {name} in shared/data, made by others and not shipped")
    return load_world(DATA / name, robot_radius=radius)


def test_the_depot_can_be_crossed():
    world = real("nav2_depot/depot.yaml", 0.3)
    assert world.bounds == pytest.approx((0, 0, 604 * 0.05, 307 * 0.05))
    assert world.is_free([[3, 3], [27, 12]]).all()
    assert world.free_part([[3, 3], [27, 12]]).tolist() == [0, 0]
    rng = np.random.default_rng(0)
    a, b = random_segments(world, rng, 3000)
    accepted = world.segments_free(a, b)
    assert 200 < accepted.sum() < 2800
    assert accepted.tolist() == [world.segment_free(*p, *q) for p, q in zip(a.tolist(), b.tolist(), strict=True)]
    gap = shapely.distance(world.obstacles, shapely.linestrings(np.stack([a, b], axis=1)[accepted]))
    assert gap.min() >= 0.3 - 1e-9
    assert 300 < len(world.corners()) < 1000


def test_the_streets_of_berlin_hang_together():
    world = real("movingai/Berlin_1_256.map", 0.4)
    assert world.bounds == (0, 0, 256, 256)
    cells = (DATA / "movingai/Berlin_1_256.map").read_text().splitlines()[4:]
    occupied = sum(row.count("@") + row.count("T") for row in cells)
    assert world.obstacles.area == pytest.approx(occupied, rel=1e-12)
    assert world.free_parts[0].area > 0.95 * world.free.area
    assert len(world.corners()) < len(shapely.get_coordinates(world.obstacles))
