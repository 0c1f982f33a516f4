"""plan_route: what a route must be, on worlds with known answers and on real maps; and what is refused."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from itertools import combinations, count
from pathlib import Path

import numpy as np
import pytest
import shapely
from ompl import base as ob
from ompl import control as oc
from ompl import geometric as og

from driftplan.errors import GoalError, NoPathError, PlannerError, StartError
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.simulation import simulate_drift
from driftplan.planning.comparison import compare_routes
from driftplan.planning.ompl.solve import PLANNERS, REFUSED
from driftplan.planning.request import Planner
from driftplan.planning.routes import plan_route
from driftplan.planning.status import Status
from driftplan.world.mapfiles import load_world
from driftplan.world.world import World
from driftplan.world.zones import Zone

DATA = Path(__file__).resolve().parents[3] / "shared/data"
NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
ALL_PLANNERS = ("roadmap", *PLANNERS)
WALL = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)


def assert_safe(world, route, start, goal):
    """From start to goal, the robot's disc touching no wall: shapely's distance to the walls as drawn is the judge."""
    np.testing.assert_allclose(route.path[[0, -1]], [start, goal])
    line = shapely.LineString(route.path)
    assert shapely.distance(line, world.obstacles) >= world.robot_radius - 1e-9
    xmin, ymin, xmax, ymax = world.bounds
    assert shapely.box(xmin, ymin, xmax, ymax).contains(line)


@pytest.mark.parametrize("planner", ALL_PLANNERS)
def test_every_planner_finds_a_safe_route_no_worse_than_its_shortest(planner):
    start, goal = (2.0, 2.0), (8.0, 2.0)
    iterations = {"roadmap": 3, "bitstar": 5000}.get(planner, 1200)
    shortest = plan_route(WALL, start, goal, NOISE, minimise="length", planner=planner, iterations=iterations)
    route = plan_route(WALL, start, goal, NOISE, planner=planner, iterations=iterations)
    for found in (shortest, route):
        assert_safe(WALL, found, start, goal)
        assert found.planner == planner
        assert found.length == pytest.approx(float(predict_drift(found.path, NOISE).length))
    assert route.rms <= shortest.rms
    assert shortest.length <= route.length + 1e-9
    # tangents √(2² + 5² - ½²), arcs of 73.5° about the wall's two upper corners, 2 m along its top
    assert shortest.length == pytest.approx(2 * 28.75**0.5 + 2 * 0.5 * np.radians(73.53) + 2, rel=0.01)
    assert 0 < route.bound <= route.rms
    assert 0 < shortest.bound <= shortest.length
    assert route.rms == pytest.approx(float(predict_drift(route.path, NOISE).end.rms), rel=1e-12)


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3))])
@pytest.mark.parametrize(
    ("planner", "iterations"),
    [
        ("roadmap", 1),
        ("roadmap", 3),
        ("rrtstar", 400),
        ("informed_rrtstar", 400),
        ("sorrtstar", 400),
        ("bitstar", 4000),
    ],
)
def test_with_so_many_iterations_a_seed_gives_one_route_no_worse_than_the_shortest_of_that_seed(
    planner, iterations, seed
):
    def plan(minimise="drift"):
        return plan_route(
            WALL, (2, 2), (8, 2), NOISE, minimise=minimise, planner=planner, iterations=iterations, seed=seed
        )

    one, again, shortest = plan(), plan(), plan("length")
    np.testing.assert_array_equal(one.path, again.path)
    assert (one.rms, one.bound, one.status) == (again.rms, again.bound, again.status)
    assert one.status in (Status.BATCHES_DONE, Status.ITERATIONS_DONE)
    assert one.rms <= shortest.rms
    assert one.rms <= one.shortest.rms
    assert one.shortest.length <= min(shortest.length, one.length)
    assert shortest.shortest is None


@pytest.mark.slow
def test_the_same_route_comes_out_of_another_process():
    code = """
from driftplan.planning.routes import plan_route
from driftplan.model.noise import OdometryNoise
from driftplan.world.world import World
world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
for planner, iterations in (("roadmap", 2), ("bitstar", 3000)):
    print(plan_route(world, (2, 2), (8, 2), noise, planner=planner, iterations=iterations, seed=5).path.tobytes().hex())
"""
    one, other = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True).stdout
        for _ in range(2)
    )
    assert one == other
    assert len(one) > 100


def manhattan(streets=6, block=9.0, width=1.0):
    """A town of square blocks: all monotone staircases through it are equally long."""
    side = block + width
    blocks = [
        shapely.box(width + i * side, width + j * side, (i + 1) * side, (j + 1) * side)
        for i in range(streets)
        for j in range(streets // 2)
    ]
    size = streets * side + width, streets // 2 * side + width
    return World.from_polygons(blocks, bounds=(0, 0, *size), robot_radius=0.45), size


def test_in_a_town_of_equal_ways_the_one_of_least_drift_is_found():
    """Of the 84 staircases of one length the best drives along the longer of the two distances left, whichever that is:
    E|e|² = q∫|w|² to first order, and so the lever w shrinks soonest. The long leg first is not quite the best."""
    world, (width, height) = manhattan()
    start, goal = (0.5, 0.5), (width - 0.5, height - 0.5)
    noise = OdometryNoise(heading_var_per_m=1e-7)
    rms = {}
    for rising in combinations(range(9), 3):  # which of nine blocks are driven upwards
        steps = np.array([(0, 10) if k in rising else (10, 0) for k in range(9)])
        path = np.concatenate([[start], start + np.cumsum(steps, axis=0)])
        rms[rising] = float(predict_drift(path, noise).end.rms)
    best, long_leg_first, short_leg_first = min(rms.values()), rms[6, 7, 8], rms[0, 1, 2]
    assert best < 0.98 * long_leg_first
    assert long_leg_first < 0.9 * short_leg_first
    route = plan_route(world, start, goal, noise, iterations=3)
    assert_safe(world, route, start, goal)
    # streets are 10 cm wider than the robot, which lets a route be that much better than the straight legs
    assert 0.99 * best < route.rms < 1.001 * best


def test_the_long_leg_first_saves_at_most_eighteen_percent():
    """Of two L-shaped routes of equal length the better has √((a³/3 + b²a + b³/3)/(b³/3 + a²b + a³/3)) times the rms;
    the least of it over the ratio of the legs is 0.82."""
    ratio = np.linspace(1, 6, 2001)
    long_first = ratio**3 / 3 + ratio + 1 / 3
    short_first = ratio**3 / 3 + ratio**2 + 1 / 3
    saved = 1 - np.sqrt(long_first / short_first)
    assert saved.max() == pytest.approx(0.18, abs=0.005)
    best = ratio[saved.argmax()]
    noise = OdometryNoise(heading_var_per_m=1e-9)
    one, other = (
        predict_drift(p, noise).end.rms for p in ([(0, 0), (best, 0), (best, 1)], [(0, 0), (0, 1), (best, 1)])
    )
    assert 1 - one / other == pytest.approx(saved.max(), rel=1e-5)


@pytest.mark.parametrize(
    ("width", "height", "planner"),
    [*((30.0, 15.0, planner) for planner in ALL_PLANNERS), (15.0, 30.0, "roadmap"), (40.0, 12.0, "roadmap")],
)
def test_round_a_block_the_long_leg_is_driven_first(width, height, planner):
    """One block and two ways of equal length round it. The one that begins with the long leg has as much less rms as
    the closed form says, and the planners take it."""
    block = shapely.box(1, 1, width - 1, height - 1)
    world = World.from_polygons([block], bounds=(0, 0, width, height), robot_radius=0.25)
    start, goal = (0.5, 0.5), (width - 0.5, height - 0.5)
    corners = [(goal[0], start[1]), (start[0], goal[1])]
    long_corner, short_corner = corners if width > height else corners[::-1]
    noise = OdometryNoise(heading_var_per_m=1e-7)
    long_first, short_first = (
        float(predict_drift([start, corner, goal], noise).end.rms) for corner in (long_corner, short_corner)
    )
    a, b = max(width, height) - 1, min(width, height) - 1
    ratio = ((a**3 / 3 + b**2 * a + b**3 / 3) / (b**3 / 3 + a**2 * b + a**3 / 3)) ** 0.5
    assert long_first / short_first == pytest.approx(ratio, rel=1e-5)
    assert ratio < 0.86

    iterations = {"roadmap": 2, "bitstar": 8000}.get(planner, 2000)
    route = plan_route(world, start, goal, noise, planner=planner, iterations=iterations)
    assert_safe(world, route, start, goal)
    assert shapely.distance(shapely.LineString(route.path), shapely.Point(long_corner)) < 1
    # The street is 0.5 m wider than the robot, which lets a route cut the corner.
    assert 0.98 * long_first < route.rms < long_first


REAL = {
    "depot": ("nav2_depot/depot.yaml", 0.3, (3.0, 3.0), (27.0, 12.0)),
    "berlin": ("movingai/Berlin_1_256.map", 0.4, (5.5, 5.5), (250.5, 250.5)),
}


def real(name):
    file, radius, start, goal = REAL[name]
    if not (DATA / file).exists():
        pytest.skip(f"no {file} beside the checkout")
    return load_world(DATA / file, robot_radius=radius), start, goal


@pytest.mark.parametrize("name", ["depot", pytest.param("berlin", marks=pytest.mark.slow)])
@pytest.mark.parametrize("planner", ["roadmap", pytest.param("bitstar", marks=pytest.mark.slow)])
def test_real_maps_are_crossed_safely_and_as_predicted(name, planner):
    world, start, goal = real(name)
    noise = OdometryNoise.from_std(heading_deg=0.3, distance_m=0.05, after_m=10.0)
    iterations = 4 if planner == "roadmap" else 60_000
    shortest = plan_route(world, start, goal, noise, minimise="length", planner=planner, iterations=iterations)
    route = plan_route(world, start, goal, noise, planner=planner, iterations=iterations)
    for found in (shortest, route):
        assert_safe(world, found, start, goal)
    assert route.rms <= shortest.rms
    errors = simulate_drift(route.path, noise, runs=4000, rng=0)[:, -1]
    square = (errors**2).sum(axis=1)
    assert abs(square.mean() - route.rms**2) < 4 * square.std() / len(square) ** 0.5


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_maps_with_twenty_thousand_drives(name):
    world, start, goal = real(name)
    route = plan_route(world, start, goal, NOISE, iterations=5)
    assert_safe(world, route, start, goal)
    assert route.rms <= route.shortest.rms
    errors = simulate_drift(route.path, NOISE, runs=20_000, rng=1)[:, -1]
    square = (errors**2).sum(axis=1)
    assert abs(square.mean() - route.rms**2) < 4 * square.std() / len(square) ** 0.5


@pytest.mark.slow
def test_a_detour_is_bounded():
    """Bad floor on the direct way: free to choose, the robot goes round it; told not to, it keeps within the limit."""
    mud = Zone(shapely.box(3, 1, 7, 9), OdometryNoise(heading_var_per_m=0.05))
    world = World.from_polygons([], bounds=(0, 0, 10, 20), robot_radius=0.1, zones=[mud])
    start, goal = (1.0, 3.0), (9.0, 3.0)
    noise = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=1e-5)
    free = plan_route(world, start, goal, noise, iterations=3)
    bounded = plan_route(world, start, goal, noise, iterations=2, max_detour=1.1)
    shortest = plan_route(world, start, goal, noise, minimise="length", iterations=2)
    assert shortest.length == pytest.approx(8.0)
    assert free.length > 1.1 * 8.0
    assert bounded.length <= 1.1 * 8.0 * (1 + 1e-6)
    assert free.rms < bounded.rms <= shortest.rms


def test_a_bound_says_what_it_covers():
    noise = OdometryNoise(heading_var_per_m=0.05, distance_var_per_m=1e-4)  # 0.8 rad of heading error at the goal
    route = plan_route(WALL, (2, 2), (8, 2), noise, iterations=1)
    assert route.bound_covers == f"routes with headings off by at most {2 * route.drift.end.heading_std:.2g} rad"
    assert 0.7 * route.rms < route.bound <= route.rms
    for planner, asked in (("roadmap", 1), ("bitstar", 4000)):
        route = plan_route(WALL, (2, 2), (8, 2), NOISE, planner=planner, iterations=asked)
        assert route.bound_covers == "all routes"
        assert 0.98 * route.rms < route.bound <= route.rms


def test_the_start_heading_is_paid_for():
    noise = OdometryNoise(heading_var_per_rad=1e-3, heading_var_per_m=1e-5)
    world = World.from_polygons([], bounds=(0, 0, 10, 10), robot_radius=0.1)
    facing, away = (plan_route(world, (1, 5, h), (9, 5), noise, iterations=1).rms for h in (0.0, np.pi))
    assert facing < away


def test_routes_side_by_side():
    routes = [plan_route(WALL, (2, 2), (8, 2), NOISE, minimise=m, iterations=2) for m in ("length", "drift")]
    table = compare_routes(routes, names=["short", "sure"])
    row = table.to_dicts()[1]
    assert row["rms_m"] == routes[1].rms
    assert row["length_m"] == routes[1].length
    assert row["radius95_m"] == float(routes[1].drift.end.radius(0.95))
    assert [line.split()[0] for line in str(table).splitlines()] == ["route", "short", "sure"]
    with pytest.raises(ValueError, match="a name for each of 2 routes, got 1"):
        compare_routes(routes, names=["one"])
    with pytest.raises(ValueError, match="at least one Route"):
        compare_routes([])


ROOMS = World.from_polygons([[(4.9, 0), (5.1, 0), (5.1, 10), (4.9, 10)]], bounds=(0, 0, 10, 10), robot_radius=0.3)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (
            {"start": (5, 5)},
            StartError,
            r"start \(5, 5\) is not free; the nearest free point is \(\d\.\d{1,3}, 5\)",
        ),
        ({"goal": (5, 5)}, GoalError, r"goal \(5, 5\) is not free; the nearest free point is"),
        (
            {"start": (-5, 5)},
            StartError,
            r"off the map, which spans x 0 to 10 and y 0 to 10 m; the nearest free",
        ),
        ({"start": (float("nan"), 2)}, ValueError, "start"),
        ({"goal": (1, 2, 3)}, ValueError, "goal"),
        ({"minimise": "time"}, ValueError, "minimise one of"),
        ({"max_detour": 0.5}, ValueError, "max_detour >= 1, got 0.5"),
        ({"time_limit": 0.0}, ValueError, "time_limit > 0"),
        ({"seed": -1}, ValueError, "seed a whole number >= 0"),
        ({"seed": 10**23}, ValueError, "seed a whole number >= 0 and < 2147483648"),
        ({"time_limit": float("inf")}, ValueError, "time_limit finite, got inf"),
        ({"minimise": "length", "max_detour": 1.2}, ValueError, "no max_detour with minimise='length'"),
        ({"noise": 0.1}, ValueError, "expected noise to be an OdometryNoise"),
        ({"planner": Planner(initial_paths=[[(2, 2), (3, 3)]])}, ValueError, "initial_paths from"),
        ({"planner": Planner(initial_paths=[[(2, 2), (8, 2)]])}, ValueError, "collides between"),
        (
            {"planner": Planner(initial_paths=[[(2, 2)]])},
            ValueError,
            "initial_paths: expected a path .n, 2. of at least 2 waypoints",
        ),
    ],
)
def test_bad_input_is_refused(arguments, error, message):
    call = {"world": WALL, "start": (2, 2), "goal": (8, 2), "noise": NOISE, **arguments}
    with pytest.raises(error, match=message):
        plan_route(**call)


@pytest.mark.parametrize("planner", ["roadmap", "bitstar"])
def test_who_is_there_already_stays(planner):
    route = plan_route(WALL, (2, 2), (2, 2), NOISE, planner=planner)
    assert route.length == route.rms == route.bound == 0


def test_a_planner_that_finds_nothing_in_time_leaves_what_else_is_known():
    way = [(2, 2), (3, 8), (7, 8), (8, 2)]
    for minimise in ("length", "drift"):
        route = plan_route(
            WALL,
            (2, 2),
            (8, 2),
            NOISE,
            minimise=minimise,
            planner=Planner("rrtstar", initial_paths=[way]),
            time_limit=1e-4,
        )
        assert_safe(WALL, route, (2, 2), (8, 2))
    with pytest.raises(NoPathError, match=r"rrtstar found no path from .* though free space connects them"):
        plan_route(WALL, (2, 2), (8, 2), NOISE, planner="rrtstar", time_limit=1e-4)


@pytest.mark.parametrize("point", [(5.0, 5.0), (4.2, 3.3333), (3.6, 6.9), (-5.0, 5.0), (0.2, 0.2)])
def test_the_nearest_free_point_can_be_used_as_it_is_written(point):
    with pytest.raises(StartError) as caught:
        plan_route(WALL, point, (8, 2), NOISE)
    x, y = str(caught.value).rsplit("(", 1)[1].rstrip(")").split(",")
    assert WALL.is_free((float(x), float(y)))


def test_where_no_route_leads_the_message_says_how_far_one_can_go():
    with pytest.raises(NoPathError, match=r"reaches only 4\d\.\d+ m², x 0\.30\.\.4\.60"):
        plan_route(ROOMS, (2, 2), (8, 2), NOISE)


@pytest.mark.parametrize(
    ("planner", "reason"),
    [
        ("PRMstar", "a thread that waits for ever"),
        ("PRM*", "a thread that waits for ever"),
        ("prm", "a thread that waits for ever"),
        ("RRT", "never asks what a path costs"),
        ("RRTConnect", "never asks what a path costs"),
        ("rrt_connect", "never asks what a path costs"),
        ("KPIECE1", "never asks what a path costs"),
        ("fmt", "metric of its nearest-neighbour search"),
        ("BFMT", "metric of its nearest-neighbour search"),
        ("AORRTC", "minimises length whatever"),
        ("SST", "cannot create it"),
        ("AIT*", "does not have it"),
        ("LazyPRM", "does not have it"),
    ],
)
def test_planners_that_cannot_minimise_drift_are_refused_with_the_reason(planner, reason):
    with pytest.raises(PlannerError, match=rf"cannot minimise drift: .*{reason}.*choose one of roadmap, rrtstar"):
        plan_route(WALL, (2, 2), (8, 2), NOISE, planner=planner)


def test_every_planner_that_ompl_has_is_taken_or_refused_by_name():
    for module in (og, oc):
        names = [
            n
            for n in dir(module)
            if isinstance(getattr(module, n), type) and issubclass(getattr(module, n), ob.Planner)
        ]
        assert len(names) > 5
        for name in names:
            taken = name.lower() in {planner.replace("_", "") for planner in PLANNERS}
            assert taken is not (name.lower() in REFUSED), name
    # and what is said not to be there is not
    absent = [name for name, reason in REFUSED.items() if "does not have it" in reason]
    assert not {name.lower() for module in (og, oc) for name in dir(module)} & set(absent)


def test_unknown_planners_are_refused():
    with pytest.raises(PlannerError, match="unknown planner 'dijkstra': choose one of roadmap"):
        plan_route(WALL, (2, 2), (8, 2), NOISE, planner="dijkstra")


@pytest.mark.slow
def test_planning_is_silent_and_leaks_nothing():
    """OMPL logs in C++ and nanobind reports leaks at exit: only a process of its own shows either."""
    code = f"""
from driftplan.planning.routes import plan_route
from driftplan.model.noise import OdometryNoise
from driftplan.world.world import World
world = World.from_polygons([[(4, 0), (6, 0), (6, 7), (4, 7)]], bounds=(0, 0, 10, 10), robot_radius=0.5)
noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
routes = [plan_route(world, (2, 2), (8, 2), noise, planner=p, time_limit=2) for p in {ALL_PLANNERS!r}]
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert (done.stdout, done.stderr) == ("", "")


def test_a_route_says_in_a_line_what_it_is():
    route = plan_route(WALL, (2, 2), (8, 2), NOISE, iterations=2)
    assert repr(route).startswith(
        f"Route({route.length:.2f} m, rms {route.rms:.4g} m at the goal, least drift of roadmap"
    )
    assert len(repr(route)) < 150


def test_a_planner_that_finds_nothing_in_time_is_not_asked_again(monkeypatch):
    """No path at all is not a path that is too long."""
    from driftplan.planning.ompl import solve

    asked = []
    monkeypatch.setattr(solve, "solve", lambda *args, **kwargs: asked.append(kwargs["stop"]))
    world = World.from_polygons([], bounds=(0, 0, 10, 10), robot_radius=0.5)
    with pytest.raises(NoPathError):
        plan_route(world, (2, 2), (8, 2), OdometryNoise(heading_var_per_m=1e-4), planner="rrtstar", time_limit=0.5)
    assert len(asked) == 2  # for the shortest path, and for that of least drift


@pytest.mark.parametrize("planner", ALL_PLANNERS)
def test_when_the_time_is_over_nothing_long_is_begun(monkeypatch, planner):
    """By a clock on which ten seconds go by between any two looks, of a limit of five."""
    from driftplan.planning import request, taut_strings

    columns = [[(x, y), (x + 2, y), (x + 2, y + 2), (x, y + 2)] for x in range(4, 96, 5) for y in range(4, 96, 5)]
    world = World.from_polygons(columns, bounds=(0, 0, 100, 100), robot_radius=0.5)
    plan_route(world, (1, 1), (99, 98), NOISE, iterations=1)  # what is done once for a world
    ticks = count(0.0, 10.0)
    monkeypatch.setattr(request.time, "monotonic", lambda: next(ticks))
    monkeypatch.setattr(taut_strings._Corners, "of", None)  # the strings of a goal take long
    asked = []
    monkeypatch.setattr(World, "segments_free", lambda *args, free=World.segments_free: asked.append(1) or free(*args))
    with suppress(NoPathError):  # OMPL's planners have no path at once
        assert len(plan_route(world, (1, 1), (99, 98), NOISE, planner=planner, time_limit=5.0).path) > 2
    assert len(asked) < 30
