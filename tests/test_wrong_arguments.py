"""Arguments that are none: a TypeError or ValueError that says what was expected, at once and in little memory."""

from __future__ import annotations

import pytest

import driftplan as d
from driftplan.arrays import finite, number, positive

NOISE = d.OdometryNoise(heading_var_per_m=1e-4)
WORLD = d.World.from_polygons([[(4, 4), (5, 4), (5, 5)]], bounds=(0, 0, 9, 9), robot_radius=0.1)
TAG = d.BeaconKind.rfid(1.5, 0.1)
PATH = [(0, 0), (5, 0)]
ENDS = ((1, 1), (2, 2))
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
    "route to be a Drift or Route, got": lambda: d.plot_route(PATH),
    "curve to be": lambda: d.plot_tradeoff([3]),
    "a fix to be": lambda: d.predict_drift(PATH, NOISE, fixes=[3]),
    "obstacles to be": lambda: d.World(obstacles="walls", bounds=(0, 0, 1, 1), robot_radius=1),
    "name of a kind": lambda: d.BeaconKind(name=[5], range_m=1, position_std_m=1),
    "si to be a SpaceInformation, got 3": lambda: d.use_world(3, WORLD),
    "si to be a SpaceInformation, got None": lambda: d.DriftObjective(None, NOISE, (1, 1)),
    "path to be a PathControl or PathGeometric": lambda: d.predict_ompl_path(PATH, 3, NOISE),
    "path to be a PathGeometric": lambda: d.polish_ompl_path(PATH, 3, WORLD),
    "noise to be an OdometryNoise, got 'n": lambda: d.ros_covariances("n", rate_hz=1, speed_m_per_s=1),
    "graph to be a RouteGraph": lambda: d.graph_geojson([1]),
    "graph to be a RouteGraph, got None": lambda: d.graph_lif(None),
    "route to be a Drift or Route, got .*5": lambda: d.plot_comparison(None, {"a": PATH}),
    "line_of_sight": lambda: d.BeaconKind.rfid(1.5, 0.1, line_of_sight="no"),
}
TOO_MANY = {
    "sites of a grid": lambda: d.grid_sites(WORLD, 0.001),
    "sites along": lambda: d.wall_sites(WORLD, 1e-7),
    "sites along a line": lambda: d.route_sites([PATH], 1e-7),
    "readings on one pass": lambda: d.BeaconKind.rfid(1.5, 0.1, reading_spacing_m=1e-7),
    "points of a profile": lambda: d.predict_drift(PATH, NOISE).profile(1e-9),
    "substeps": lambda: d.simulate_drift(PATH, NOISE, substep_m=1e-9),
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


@pytest.mark.parametrize("said", TOO_MANY)
def test_counts_that_follow_from_an_argument_are_bounded_before_anything_is_made(said):
    with pytest.raises(ValueError, match=f"expected at most .* {said}.*, got .*: use "):
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
