"""plan_route with and without beacons, and the trade-off between length and drift."""

import re
from dataclasses import replace

import numpy as np
import pytest

from driftplan import pareto_routes, plan_route
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.readings import drift_with_beacons
from driftplan.errors import KeywordError, PlannerError
from driftplan.model.noise import OdometryNoise
from driftplan.model.worst import worst_rms
from driftplan.planning.comparison import compare_routes, knee, non_dominated
from driftplan.planning.request import DriftLimit, Planner
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)
SIGN = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
HALL = World.from_polygons([], bounds=(0, 0, 60, 40), robot_radius=0.5)
START, GOAL = (3.0, 10.0), (57.0, 10.0)
SIGNS = [Beacon(SIGN, 18, 18), Beacon(SIGN, 30, 19), Beacon(SIGN, 42, 18)]


def test_what_matters_with_beacons_only_is_accepted_without():
    """A loop over sets of beacons asks for the same each time, with none of them too."""
    asked = {"max_drift": DriftLimit(redundancy=2, min_capture=0.5), "planner": Planner(max_nodes=80), "iterations": 1}
    for beacons in ([], SIGNS):
        assert plan_route(HALL, START, GOAL, NOISE, beacons=beacons, minimise="length", **asked).length == 54.0


def test_routes_among_beacons_take_no_other_planner_but_paths_to_begin_with():
    with pytest.raises(PlannerError, match="planner='roadmap'"):
        plan_route(HALL, START, GOAL, NOISE, beacons=SIGNS, planner="rrtstar")
    by_all = [START, (18.0, 17.0), (30.0, 18.0), (42.0, 17.0), GOAL]
    asked = {"beacons": SIGNS, "minimise": "drift", "time_limit": 600.0}
    told = plan_route(HALL, START, GOAL, NOISE, planner=Planner(max_nodes=40, initial_paths=[by_all]), **asked)
    alone = plan_route(HALL, START, GOAL, NOISE, planner=Planner(max_nodes=10, initial_paths=[by_all]), **asked)
    least = drift_with_beacons(by_all, NOISE, SIGNS, HALL).end.rms
    assert max(told.rms, alone.rms) <= least * (1 + 1e-9)


def test_an_unknown_keyword_is_answered_with_the_one_that_was_meant():
    with pytest.raises(ValueError, match="did you mean time_limit"):
        plan_route(HALL, START, GOAL, NOISE, timelimit=1)
    for keyword, said in (
        ("redundancy", "max_drift=DriftLimit(redundancy=…)"),
        ("max_nodes", "planner=Planner(max_nodes=…)"),
        ("start_heading", "start=(x, y, heading)"),
    ):
        with pytest.raises(KeywordError, match=re.escape(f"did you mean {said}?")):
            plan_route(HALL, START, GOAL, NOISE, **{keyword: 1})
    with pytest.raises(ValueError, match="did you mean max_routes"):
        pareto_routes(HALL, START, GOAL, NOISE, beacons=SIGNS, max_route=3)


def test_the_trade_off_is_a_trade_off():
    found = pareto_routes(
        HALL, START, GOAL, NOISE, beacons=SIGNS, max_routes=4, planner=Planner(max_nodes=60), time_limit=600.0
    )
    scores = np.array([(route.length, route.worst_drift, route.rms) for route in found])
    assert 2 <= len(found) <= 4
    assert (np.diff(scores[:, 0]) > 0).all()
    assert found[0].length == pytest.approx(54.0)
    for k, mine in enumerate(scores):  # nothing is beaten in everything
        assert not any((other <= mine).all() for j, other in enumerate(scores) if j != k)
    steadiest = scores[:, 1].argmin()
    alike = np.abs(np.log(scores[:, None] / scores)).max(axis=2)
    for k in range(len(found)):  # only the steadiest may be like another
        assert all(alike[k, j] >= 0.02 for j in range(k) if k != steadiest)
    assert 0 <= knee(found) < len(found)


def test_the_trade_off_of_a_robot_with_a_filter_is_scored_by_its_filter():
    found = pareto_routes(
        HALL,
        START,
        GOAL,
        NOISE,
        beacons=SIGNS,
        max_routes=3,
        planner=Planner(max_nodes=30),
        estimator="filter",
        time_limit=600.0,
    )
    scores = np.array([(route.length, route.worst_drift, route.rms) for route in found])
    assert (np.diff(scores[:, 0]) > 0).all()
    assert not any((x <= y).all() for i, x in enumerate(scores) for j, y in enumerate(scores) if i != j)
    for route in found:
        assert route.drift.is_fused
        drift = drift_with_beacons(route, NOISE, route.beacons, HALL, estimator="filter")
        assert route.rms == pytest.approx(float(drift.end.rms), rel=1e-9)


def test_non_dominated_is_that_of_the_definition_and_keeps_one_of_equals():
    class Scored:
        def __init__(self, length, worst, end):
            self.length, self.worst_guaranteed, self.rms = length, worst, end

    rng = np.random.default_rng(4)
    numbers = rng.integers(0, 5, (40, 3))
    kept = {(r.length, r.worst_guaranteed, r.rms) for r in non_dominated([Scored(*row) for row in numbers.tolist()])}
    rows = {tuple(row) for row in numbers.tolist()}
    best = {r for r in rows if not any(o != r and all(x <= y for x, y in zip(o, r, strict=True)) for o in rows)}
    assert kept == best
    assert len(non_dominated([Scored(1, 2, 3), Scored(1, 2, 3)])) == 1


def test_the_knee_is_where_little_length_buys_much():
    class Scored:
        def __init__(self, length, worst):
            self.length, self.worst_guaranteed = length, worst

    assert knee([Scored(10, 8.0), Scored(10.5, 2.0), Scored(14, 1.0)]) == 1
    rng = np.random.default_rng(2)
    for _ in range(50):
        length, worst = np.sort(rng.uniform(10, 20, 6)), np.sort(rng.uniform(1, 5, 6))[::-1]
        x, y = np.log(length), np.log(worst)
        a, b = np.array([x[0], y[0]]), np.array([x[-1], y[-1]])  # the shortest and the steadiest
        scale = np.abs(b - a)
        along = (b - a) / scale
        offset = (np.stack([x, y], axis=1) - a) / scale
        below = (along[1] * offset[:, 0] - along[0] * offset[:, 1]) / np.hypot(*along)  # distance from their line
        assert knee([Scored(*row) for row in zip(length, worst, strict=True)]) == below.argmax()
    assert knee([Scored(10, 2.0), Scored(11, 2.0)]) == 0
    with pytest.raises(ValueError, match="at least one route"):
        knee([])


@pytest.mark.parametrize(("change", "said"), [({"max_routes": 2}, "max_routes"), ({"difference": 1.0}, "difference")])
def test_settings_of_the_trade_off_that_make_no_sense_are_refused(change, said):
    with pytest.raises(ValueError, match=said):
        pareto_routes(HALL, START, GOAL, NOISE, beacons=SIGNS, **change)


# Robots with a filter


RADIO = BeaconKind.range_only(range_m=15.0, range_std_m=0.1)
RADIOS = [Beacon(RADIO, 15, 25), Beacon(RADIO, 45, 25)]
FUSING = {"estimator": "filter", "planner": Planner(max_nodes=20), "time_limit": 600.0}


def test_ranges_are_for_robots_with_a_filter():
    with pytest.raises(ValueError, match=r"cannot use it: expected estimator='filter' for beacons of kind range_only"):
        plan_route(HALL, START, GOAL, NOISE, beacons=RADIOS)
    with pytest.raises(ValueError, match="expected estimator one of"):
        plan_route(HALL, START, GOAL, NOISE, beacons=SIGNS, estimator="kalman")


@pytest.mark.slow
@pytest.mark.parametrize("minimise", ["length", "drift", "worst_drift"])
def test_the_drift_of_a_route_for_a_robot_with_a_filter_is_that_of_its_filter(minimise):
    route = plan_route(HALL, START, GOAL, NOISE, beacons=RADIOS, minimise=minimise, max_drift=2.0, **FUSING)
    drift = drift_with_beacons(route, NOISE, RADIOS, HALL, estimator="filter")
    assert route.drift.is_fused
    assert route.rms <= drift.end.rms * 1.2  # passes that are probably missed do not count
    assert route.worst_drift <= 2.0
    assert route.bound <= {"length": route.length, "drift": route.rms, "worst_drift": route.worst_drift}[minimise]


@pytest.mark.slow
def test_the_least_worst_drift_of_a_robot_with_a_filter_is_found_again_as_a_limit():
    asked = {"beacons": RADIOS, **FUSING}
    steady = plan_route(HALL, START, GOAL, NOISE, minimise="worst_drift", **asked)
    limit = steady.worst_drift * (1 + 1e-9)
    again = plan_route(HALL, START, GOAL, NOISE, minimise="length", max_drift=limit, **asked)
    assert again.worst_drift <= limit


def test_with_any_one_radio_dead_the_limit_of_a_robot_with_a_filter_still_holds():
    radios = [*RADIOS, Beacon(RADIO, 30, 0.5)]
    limit = DriftLimit(2.2, redundancy=2, min_capture=0.0)
    route = plan_route(HALL, START, GOAL, NOISE, beacons=radios, minimise="length", max_drift=limit, **FUSING)
    for k in range(len(radios)):
        alive = radios[:k] + radios[k + 1 :]
        assert drift_with_beacons(route, NOISE, alive, HALL, estimator="filter").profile(0.5).rms.max() <= 2.2 + 1e-9


@pytest.mark.slow
def test_constants_that_differ_between_drives_are_on_the_labels_of_a_filter():
    """A bias is learned where beacons come in a row: the route for a robot with one goes by more of them."""
    tags = [
        Beacon(BeaconKind.rfid(range_m=2.0, position_std_m=0.1), x, y) for x in (10, 20, 30, 40, 50) for y in (5, 12)
    ]
    asked = {"beacons": tags, "estimator": "filter", "minimise": "worst_drift", "time_limit": 600.0}
    noise = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
    varying = replace(noise, heading_bias_std_per_m=5e-3)
    alike, found = (
        plan_route(HALL, (2, 5), (58, 5), n, planner=Planner(max_nodes=40), **asked) for n in (noise, varying)
    )
    drift = drift_with_beacons(found, varying, tags, HALL, estimator="filter")
    assert found.rms == pytest.approx(float(drift.end.rms), rel=1e-9)
    assert found.worst_drift == pytest.approx(worst_rms(drift), rel=1e-9)
    assert found.worst_drift < worst_rms(drift_with_beacons(alike, varying, tags, HALL, estimator="filter"))


def test_a_table_of_routes_says_which_robot_they_are_for():
    fused, resets = (
        plan_route(
            HALL,
            START,
            GOAL,
            NOISE,
            beacons=SIGNS,
            minimise="length",
            planner=Planner(max_nodes=40),
            estimator=estimator,
        )
        for estimator in ("filter", "reset")
    )
    table = compare_routes([fused, resets])
    assert [row["estimator"] for row in table.rows] == ["filter", "reset"]
    assert "estimator" in str(table)
    assert "estimator" not in str(compare_routes([resets]))
