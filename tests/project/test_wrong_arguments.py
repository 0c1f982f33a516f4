"""Arguments that are none: a TypeError or ValueError that says what was expected, at once and in little memory."""

from __future__ import annotations

import inspect
import pickle

import numpy as np
import pytest

import driftplan as d
from driftplan.arrays import finite, number, positive

NOISE = d.OdometryNoise(heading_var_per_m=1e-4)
WORLD = d.World.from_polygons([[(4, 4), (5, 4), (5, 5)]], bounds=(0, 0, 9, 9), robot_radius=0.1)
TAG = d.BeaconKind.rfid(1.5, 0.1)
PATH = [(0, 0), (5, 0)]
ENDS = ((1, 1), (2, 2))
LAYOUT = d.place_beacons(WORLD, [[(1, 1), (8, 1)]], NOISE, 0.2, d.Sites(TAG, spacing_m=1.0))
WRONG_OBJECTS = {
    "world": lambda: d.plan_route("office", *ENDS, NOISE),
    "noise": lambda: d.plan_route(WORLD, *ENDS, "noise.yaml"),
    "beacons": lambda: d.plan_route(WORLD, *ENDS, NOISE, beacons="tags.geojson"),
    "beacons to be Beacon objects, got 3": lambda: d.plan_route(WORLD, *ENDS, NOISE, beacons=[3]),
    "world to be": lambda: d.pareto_routes("office", *ENDS, NOISE, ()),
    "world to be a World": lambda: d.place_beacons("office", [PATH], NOISE, 1.0, TAG),
    "noise to be an OdometryNoise": lambda: d.place_beacons(WORLD, [PATH], 3, 1.0, TAG),
    "noise to be": lambda: d.drift_with_beacons(PATH, 3, ()),
    "beacon to be": lambda: d.beacon_passes(PATH, "A1"),
    "layout to be": lambda: d.layout_csv("layout"),
    "world to be a World, got 3": lambda: d.save_world(3, "a.yaml"),
    "world to be a World, got 'office'": lambda: d.plot_world("office"),
    "route to be a Route or a Drift, got": lambda: d.plot_route(PATH),
    "curve to be": lambda: d.plot_tradeoff([3]),
    "a fix to be": lambda: d.predict_drift(PATH, NOISE, fixes=[3]),
    "obstacles to be": lambda: d.World(obstacles="walls", bounds=(0, 0, 1, 1), robot_radius=1),
    "name to be a str": lambda: d.BeaconKind(name=[5], range_m=1, position_std_m=1),
    "si to be a SpaceInformation, got 3": lambda: d.use_world(3, WORLD),
    "si to be a SpaceInformation, got None": lambda: d.DriftObjective(None, NOISE, (1, 1)),
    "path to be a PathGeometric or a PathControl": lambda: d.predict_ompl_path(PATH, 3, NOISE),
    "path to be a PathGeometric": lambda: d.polish_ompl_path(PATH, 3, WORLD),
    "noise to be an OdometryNoise, got 'n": lambda: d.ros_covariances("n", rate_hz=1, speed_m_per_s=1),
    "graph to be a RouteGraph": lambda: d.graph_geojson([1]),
    "graph to be a RouteGraph, got None": lambda: d.graph_lif(None),
    "routes to be Route objects or Drift objects, got .*5": lambda: d.plot_comparison(None, {"a": PATH}),
    "line_of_sight": lambda: d.BeaconKind.rfid(1.5, 0.1, line_of_sight="no"),
    "until to be called without arguments, got 3": lambda: d.plan_route(WORLD, *ENDS, NOISE, until=3),
    "progress to be called with seconds, the cost": lambda: d.place_beacons(
        WORLD, [PATH], NOISE, 1.0, TAG, progress=np.zeros((3, 2))
    ),
    "progress to be called with seconds and cost, got .*": lambda: d.co_design(
        WORLD, [ENDS], NOISE, 1.0, TAG, price_per_m=1.0, progress=np.zeros((3, 2))
    ),
    "progress to be called with the number": lambda: d.plan_routes(WORLD, [ENDS], NOISE, progress=[]),
    "progress to be called with cells": lambda: d.run_study({}, progress="x"),
}
WRONG_VALUES = {
    "time_limit no greater than": lambda: d.beacon_tradeoff(WORLD, [PATH], NOISE, TAG, time_limit=10**200),
    "drives to simulate": lambda: d.collision_chance(d.predict_drift(PATH, NOISE), WORLD, runs=10**200),
    "repeats to be": lambda: d.predict_drift_3d(
        [np.eye(3)], [(1, 0, 0)], d.RotationNoise.isotropic(0.1), repeats=[((1, 1), (1, 1), 1)]
    ),
    "routes to be": lambda: d.place_beacons(WORLD, np.ma.masked, NOISE, 1.0, TAG),
    "heading_offset": lambda: d.fit_noise(*d.simulate_log(PATH, NOISE), heading_offset=np.inf),
    "time_offset_s": lambda: d.fit_noise(*d.simulate_log(PATH, NOISE), time_offset_s=np.nan),
    "samples, got": lambda: d.simulate_log(PATH, NOISE, step_m=1e-50),
    "bounds to be": lambda: d.BoxWorld.around([], bounds=[((1, 1), (1, 1), 1)], robot_radius=1.0),
    "confidence from 0.01": lambda: d.fit_noise(None, None, confidence=1e-320),
    "start to be .*x, y, heading.*inhomogeneous": lambda: d.plan_route(WORLD, [((1, 1), (1, 1), 1)], (8, 8), NOISE),
    "rng a seed": lambda: d.predict_drift(PATH, NOISE).simulated([1.0], runs=2, rng=[(0, 0), (1, "a")]),
    "path": lambda: d.place_beacons(WORLD, np.array([1j]), NOISE, 1.0, TAG),
    "a mesh": lambda: d.BoxWorld.around([((1, 1), (1, 1), 1)], bounds=np.eye(3)[:2], robot_radius=1.0),
    "a mesh of vertices": lambda: d.BoxWorld.around([(1, 1, 1)], bounds=np.eye(3)[:2], robot_radius=1.0),
    "checks to be SegmentCheck objects, got 1": lambda: d.plot_coverage({"a": 1}),
    "minimise one of": lambda: d.plan_route(WORLD, *ENDS, NOISE, minimise=np.array(["drift", "length"])),
    "heading_law one of": lambda: d.OdometryNoise(heading_law=np.zeros(2)),
    "estimator one of .*, got 3": lambda: d.predict_drift(PATH, NOISE, estimator=3),
    "seed a whole number .*, got array": lambda: d.collision_chance(
        d.predict_drift(PATH, NOISE), WORLD, seed=np.eye(2)
    ),
    "spacing_m to be a number": lambda: d.predict_drift(PATH, NOISE).profile("wide"),
    "x to be a number": lambda: WORLD.point_free("x", 1.0),
    "x0, y0": lambda: WORLD.segment_free(1.0, None, 2.0, 2.0),
    "ground to be a Polygon": lambda: d.World.within({}, [], robot_radius=0.1),
    "obstacles to be an iterable": lambda: d.World.from_polygons(3, bounds=(0, 0, 1, 1), robot_radius=0.1),
    "bounds": lambda: d.World.from_polygons([], bounds="box", robot_radius=0.1),
    "deviations": lambda: NOISE.on_drive("far"),
    "position_std_m to be a number, got '1'": lambda: d.BeaconKind.rfid(1.5, "1"),
    "resamples a whole number": lambda: d.fit_noise(None, None, resamples="many"),
    "pairs one of": lambda: d.relative_errors(PATH, PATH, pairs=[1]),
    "seed a whole number": lambda: d.fit_noise(None, None, seed=-1),
    "path to be .*complex": lambda: d.predict_drift([(0j, 0), (1j, 0)], NOISE),
    "goal to be .*complex": lambda: d.plan_route(WORLD, (1, 1), (2 + 0j, 2), NOISE),
    "path to be .*masked": lambda: d.predict_drift(np.ma.masked_less([(0, 0), (-1, 1)], 0), NOISE),
    "distances_m": lambda: d.predict_drift(PATH, NOISE).simulated(None, runs=10),
    "edges finite": lambda: d.RouteGraph.numbered([(0, 0), (1, 1)], None),
    "edges to be whole numbers .*inhomogeneous": lambda: d.RouteGraph.numbered([(0, 0), (1, 1)], [[1, 2], [3]]),
    "xy .* whole numbers edges": lambda: d.RouteGraph.numbered([(0, 0), (1, 1)], [[0, 0.5]]),
    "world to be a World": lambda: d.plan_route(WORLD, *ENDS, NOISE, iterations=1).collision_probability("hall"),
    "routes of 1": lambda: d.plot_sawtooth(LAYOUT, routes=[1]),
}
TOO_MANY = {
    "sites of a grid": lambda: d.grid_sites(WORLD, 0.001),
    "sites along": lambda: d.wall_sites(WORLD, 1e-7),
    "sites along a line": lambda: d.route_sites([PATH], 1e-7),
    "readings on one pass": lambda: d.BeaconKind.rfid(1.5, 0.1, reading_spacing_m=1e-7),
    "points of a profile": lambda: d.predict_drift(PATH, NOISE).profile(1e-9),
    "substeps": lambda: d.simulate_drift(PATH, NOISE, substep_m=1e-9),
    "errors to simulate ": lambda: d.simulate_drift(PATH, NOISE, runs=10**400),
    "errors to simulate": lambda: d.simulate_drift(PATH, NOISE, runs=10**12),
}
TOO_GREAT = {
    "substep_m": lambda: d.simulate_drift(PATH, NOISE, substep_m=float("inf")),
    "position_std_m": lambda: d.BeaconKind.rfid(1.5, 1e160),
    "path": lambda: d.predict_drift([(0, 0), (1e200, 0)], NOISE),
    "path to be": lambda: d.predict_drift([(0, 0), (10**400, 0)], NOISE),
    "start of a trip to be": lambda: d.Trip((10**400, 0), (1, 1)),
    "parameter to be": lambda: d.RotationNoise("gaussian", "x"),
    "anchor": lambda: d.Fix.range(1.0, anchor=(1, "x"), range_std_m=0.1),
    "length_m": lambda: NOISE.heading_std_after("far"),
}


@pytest.mark.parametrize("said", WRONG_OBJECTS)
def test_an_object_of_another_kind_is_named(said):
    with pytest.raises(TypeError, match=f"expected .*{said.replace('|', '.')}"):
        WRONG_OBJECTS[said]()


@pytest.mark.parametrize("said", WRONG_VALUES)
def test_a_value_of_another_kind_is_told_what_it_should_be(said):
    with pytest.raises(ValueError, match=f"expected .*{said}"):
        WRONG_VALUES[said]()


def test_public_names_are_what_they_look_like():
    for name in d.__all__:
        value = getattr(d, name)
        if callable(value):
            assert value.__name__ in (name, "read_truth")  # which has two names
            assert pickle.loads(pickle.dumps(value)) is value
    assert list(inspect.signature(d.plan_route).parameters)[:4] == ["world", "start", "goal", "noise"]
    assert d.plan_route.__doc__


def test_a_keyword_of_a_constructor_is_answered_with_the_nearest():
    with pytest.raises(d.KeywordError, match=r"OdometryNoise.from_std\(\) .* 'heading_dg': did you mean heading_deg\?"):
        d.OdometryNoise.from_std(heading_dg=1.0, distance_m=0.05, after_m=10.0)
    with pytest.raises(d.KeywordError, match=r"did you mean noise=OdometryNoise\(heading_var_per_m=…\)"):
        d.plan_route(WORLD, *ENDS, heading_var_per_m=1)


@pytest.mark.parametrize("said", TOO_MANY)
def test_counts_that_follow_from_an_argument_are_bounded_before_anything_is_made(said):
    with pytest.raises(ValueError, match=f"expected at most .* {said.strip()}.*, got .*: use "):
        TOO_MANY[said]()


@pytest.mark.parametrize("said", TOO_GREAT)
def test_numbers_that_would_overflow_are_refused(said):
    with pytest.raises(ValueError, match=f"expected {said}"):
        TOO_GREAT[said]()


@pytest.mark.parametrize("value", [10**400, 1e14, float("nan"), True, "3", None, [1.0], 1e-320, -0.0])
def test_what_is_no_positive_number_is_refused(value):
    with pytest.raises(ValueError, match="expected length"):
        positive("length", value)


@pytest.mark.parametrize("value", [1e-40, 1, 1e13])
def test_numbers_of_any_use_are_taken(value):
    assert number("length", value) == positive("length", value) == finite("length", value) == value
