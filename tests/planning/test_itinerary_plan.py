"""plan_route with and without beacons, and the trade-off between length and drift."""

import numpy as np
import pytest

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.errors import PlannerError
from driftplan.model.noise import OdometryNoise
from driftplan.planning import routes
from driftplan.planning.itinerary.itinerary import Itinerary
from driftplan.planning.pareto import knee, non_dominated, pareto_routes
from driftplan.planning.plan import plan_route
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)
SIGN = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
HALL = World.from_polygons([], bounds=(0, 0, 60, 40), robot_radius=0.5)
START, GOAL = (3.0, 10.0), (57.0, 10.0)
SIGNS = [Beacon(SIGN, 18, 18), Beacon(SIGN, 30, 19), Beacon(SIGN, 42, 18)]


def test_without_beacons_and_limit_it_is_the_plain_planner():
    ours = plan_route(HALL, START, GOAL, NOISE, time_limit=0.2)
    theirs = routes.plan_route(HALL, START, GOAL, NOISE, time_limit=0.2)
    assert not isinstance(ours, Itinerary)
    np.testing.assert_allclose(ours.path, theirs.path)


@pytest.mark.parametrize("asked", [{"beacons": SIGNS}, {"max_drift": 9.0}, {"minimise": "worst_drift"}])
def test_with_beacons_or_a_limit_or_the_worst_drift_it_is_an_itinerary(asked):
    found = plan_route(HALL, START, GOAL, NOISE, **{"minimise": "length", **asked}, nodes=80, time_limit=600.0)
    assert isinstance(found, Itinerary)


def test_itineraries_take_neither_other_planners_nor_candidates():
    with pytest.raises(PlannerError, match="planner='roadmap'"):
        plan_route(HALL, START, GOAL, NOISE, beacons=SIGNS, planner="rrtstar")
    with pytest.raises(ValueError, match="no candidates"):
        plan_route(HALL, START, GOAL, NOISE, beacons=SIGNS, candidates=[[START, GOAL]])
    with pytest.raises(ValueError, match="expected beacons or max_drift together with"):
        plan_route(HALL, START, GOAL, NOISE, redundancy=2)


def test_the_trade_off_is_a_trade_off():
    found = pareto_routes(HALL, START, GOAL, NOISE, beacons=SIGNS, most=4, nodes=150, time_limit=600.0)
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


def test_non_dominated_is_that_of_the_definition_and_keeps_one_of_equals():
    class Scored:
        def __init__(self, length, worst, end):
            self.length, self.worst_if_dead, self.rms = length, worst, end

    rng = np.random.default_rng(4)
    numbers = rng.integers(0, 5, (40, 3))
    kept = {(r.length, r.worst_if_dead, r.rms) for r in non_dominated([Scored(*row) for row in numbers.tolist()])}
    rows = {tuple(row) for row in numbers.tolist()}
    best = {r for r in rows if not any(o != r and all(x <= y for x, y in zip(o, r, strict=True)) for o in rows)}
    assert kept == best
    assert len(non_dominated([Scored(1, 2, 3), Scored(1, 2, 3)])) == 1


def test_the_knee_is_where_little_length_buys_much():
    class Scored:
        def __init__(self, length, worst):
            self.length, self.worst_if_dead = length, worst

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


@pytest.mark.parametrize(("change", "said"), [({"most": 2}, "most"), ({"difference": 1.0}, "difference")])
def test_settings_of_the_trade_off_that_make_no_sense_are_refused(change, said):
    with pytest.raises(ValueError, match=said):
        pareto_routes(HALL, START, GOAL, NOISE, beacons=SIGNS, **change)
