"""One engine: predictions, itineraries and placement find the same drift, and one change changes all three."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan import Beacon, BeaconKind, Fix, InfeasibleError, OdometryNoise, Sites, place_beacons
from driftplan.beacons.readings import beacon_fixes, detection_chances, drift_with_beacons
from driftplan.layouts.placement.drives import drives_of, worst_squares
from driftplan.layouts.placement.fused_routes import fused_routes
from driftplan.layouts.placement.route_table import IntervalMoments, route_table
from driftplan.layouts.scenario import Scenario
from driftplan.model.drift import predict_drift
from driftplan.model.filter_state import Row
from driftplan.model.readings import Readings, Resets
from driftplan.model.worst import worst_rms
from driftplan.planning.request import DriftLimit, Reliance
from driftplan.planning.roadmap.beacon_graph import BeaconGraph
from driftplan.planning.roadmap.itinerary_check import ItineraryCheck
from driftplan.world.world import World

PLAIN = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
TURNING = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0, heading_deg_per_full_turn=10.0)
BIASED = OdometryNoise(heading_var_per_m=1e-4, heading_bias_per_m=0.01, heading_bias_per_rad=0.02)
KINDS = [
    BeaconKind.rfid(1.5, 0.1),
    BeaconKind.landmark(2.0, 0.05, 0.01, line_of_sight=False),
    BeaconKind.landmark(2.5, 0.4, 0.2, line_of_sight=False),
    BeaconKind.heading(2.0, 0.03),
    BeaconKind.rfid(2.0, 0.2, detection_probability=0.7),
]


def worst_of_each_engine(path, noise, beacons, start_fix=None):
    """The greatest rms by prediction, itinerary and placement, metres."""
    path, fixes = np.asarray(path, dtype=float), [] if start_fix is None else [start_fix]
    scenario = Scenario.of(None, path, noise, DriftLimit(), start_fix)
    table = route_table(scenario, scenario.readings(beacons), 0.1)
    everyone = drives_of(table, np.ones(len(beacons), dtype=bool), np.array([0]))
    return (
        worst_rms(drift_with_beacons(path, noise, beacons, fixes=fixes)),
        ItineraryCheck(None, noise, Reliance(beacons=tuple(beacons), start_fix=start_fix, min_capture=0.0))
        .verdict(path)
        .worst,
        float(np.sqrt(worst_squares(IntervalMoments(table), everyone)[0])),
    )


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**9), st.sampled_from([PLAIN, TURNING, BIASED]), st.booleans(), st.booleans())
def test_every_engine_finds_the_same_worst_drift(seed, noise, out_and_back, unsure_start):
    rng = np.random.default_rng(seed)
    path = np.round(rng.uniform(0, 12, (int(rng.integers(2, 6)), 2)), 1)
    path[-1, 0] += 13.0  # never back where it began at once
    if out_and_back:
        path = np.concatenate([path, path[-2::-1]])
    at = rng.integers(len(path), size=4)  # many right at a waypoint
    places = path[at] + np.where(rng.random((4, 1)) < 0.5, 0.0, np.round(rng.normal(0, 1, (4, 2)), 1))
    beacons = [Beacon(KINDS[rng.integers(len(KINDS))], *place) for place in places]
    start = Fix.full(0.0, position_std_m=0.3, heading_std=0.1) if unsure_start else None
    predicted, planned, placed = worst_of_each_engine(path, noise, beacons, start)
    assert planned == pytest.approx(predicted, rel=1e-12)
    assert placed == pytest.approx(predicted, rel=1e-8)
    fixes = [*([start] if start else []), *beacon_fixes(path, beacons)]
    assert worst_rms(predict_drift(path, noise, fixes=fixes)) == pytest.approx(predicted, rel=1e-12)


def test_one_change_of_what_a_reading_does_changes_every_engine(monkeypatch):
    path, tag = [(0, 0), (40, 0)], Beacon(KINDS[0], 20.0, 1.0)
    chance = detection_chances(path, PLAIN, [tag, Beacon(KINDS[0], 38.0, 1.0)])[-1].probability
    before = worst_of_each_engine(path, PLAIN, [tag])
    once = Resets.apply

    def coarser(self, state):
        after = once(self, state)
        return replace(after, N=after.N + 4.0 * (self.N > 0))

    monkeypatch.setattr(Resets, "apply", coarser)
    after = worst_of_each_engine(path, PLAIN, [tag])
    assert all(y > x + 0.5 for x, y in zip(before, after, strict=True))
    assert after == pytest.approx([after[0]] * 3, rel=1e-8)
    assert detection_chances(path, PLAIN, [tag, Beacon(KINDS[0], 38.0, 1.0)])[-1].probability < chance - 0.1


def test_one_change_of_what_a_filter_makes_of_a_reading_changes_every_engine(monkeypatch):
    path, kinds = np.array([(0.0, 0.0), (40.0, 0.0)]), [KINDS[0], BeaconKind.range_only(4.0, 0.1)]
    tags = [Beacon(kinds[0], 20.0, 1.0), Beacon(kinds[1], 30.0, 1.0)]
    world = World.from_polygons([], bounds=(-5, -5, 45, 5), robot_radius=0.1)

    def worst_of_each():
        scenario = Scenario.of(world, [path], PLAIN, DriftLimit(5.0), None, "filter")
        graph = BeaconGraph.of(path, np.array([(0, 1)]), PLAIN, tags, None, "filter")
        worst = graph.effects.driven(np.array([0]), graph.at_start(0, None)[None, :, None])[1]
        return (
            worst_rms(drift_with_beacons(path, PLAIN, tags, estimator="filter")),
            ItineraryCheck(None, PLAIN, Reliance(beacons=tuple(tags), min_capture=0.0, estimator="filter"))
            .verdict(path)
            .worst,
            fused_routes(scenario, scenario.readings(tags))[0].worst(frozenset({0, 1})),
            float(worst[0, 0] ** 0.5),
        )

    before, once = worst_of_each(), Readings.measured

    def coarser(self, positions):
        row = once(self, positions)
        return Row(row.coefficients, row.variance + 0.05)

    monkeypatch.setattr(Readings, "measured", coarser)
    after = worst_of_each()
    assert all(y > x * 1.02 for x, y in zip(before, after, strict=True))
    assert before == pytest.approx([before[0]] * 4, rel=1e-6)
    assert after == pytest.approx([after[0]] * 4, rel=1e-6)


@pytest.mark.parametrize("length", [10.0, 10.0000003, 9.99999995, 10.0000001, 10.0000007, 9.9999997])
def test_a_reading_where_a_dead_end_turns_is_taken_on_arrival_whatever_the_seventh_decimal(length):
    """In range at L - 1.94, L and L + 1.94 m: the middle reading falls on the turn."""
    path, sign = [(0, 0), (length, 0), (0, 0)], Beacon(KINDS[1], length, 0.5, id="A")
    found = worst_of_each_engine(path, TURNING, [sign])
    expected = worst_of_each_engine([(0, 0), (10, 0), (0, 0)], TURNING, [Beacon(KINDS[1], 10.0, 0.5)])
    assert found == pytest.approx([expected[0]] * 3, rel=1e-5)
    with pytest.raises(InfeasibleError):
        place_beacons(None, [path], TURNING, expected[0] - 1e-3, Sites(points=[sign]))
    layout = place_beacons(None, [path], TURNING, expected[0] + 1e-3, Sites(points=[sign]))
    assert layout.proven
    assert layout.worst_drift == pytest.approx(expected[0], rel=1e-5)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**9))
def test_placement_and_prediction_agree_on_dead_ends(seed):
    rng = np.random.default_rng(seed)
    length, angle, offset = rng.uniform(3, 15), rng.uniform(0, 2 * np.pi), rng.uniform(0.1, 1.4)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    path = np.array([(0, 0), (length, 0), (0, 0)]) @ turn
    beacon = Beacon(KINDS[1], *(np.array([length, offset]) @ turn))
    predicted, planned, placed = worst_of_each_engine(path, TURNING, [beacon])
    assert planned == pytest.approx(predicted, rel=1e-12)
    assert placed == pytest.approx(predicted, rel=1e-8)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10**9), st.floats(0, 2 * np.pi), st.floats(-5e6, 5e6))
def test_where_the_axes_lie_does_not_decide_how_a_robot_turns_about(seed, angle, shift):
    noise = OdometryNoise(distance_var_per_m=1e-3, heading_bias_per_rad=0.02, heading_bias_per_m=-0.003)
    out = np.round(np.random.default_rng(seed).uniform(0, 20, (3, 2)), 1)
    path = np.concatenate([out, out[-2::-1]])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    expected = worst_of_each_engine(path, noise, [])
    for moved in (path @ turn, path + np.array([shift, -shift]), path @ turn + shift):
        assert worst_of_each_engine(moved, noise, []) == pytest.approx(expected, rel=1e-5, abs=1e-7)
