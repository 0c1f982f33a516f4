"""What results look like in a notebook: HTML that parses, with the numbers that matter in it."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from driftplan import Drift, OdometryNoise, Route, World, plan_route, predict_drift

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
PATH = [(0, 0), (30, 0), (30, 10)]


@pytest.fixture(scope="module")
def world() -> World:
    return World.from_polygons([[(8, 3), (12, 3), (12, 17), (8, 17)]], bounds=(0, 0, 20, 20), robot_radius=0.4)


def parsed(thing: Drift | Route | World) -> str:
    root = ElementTree.fromstring(f"<div>{thing._repr_html_()}</div>")
    return " ".join(root.itertext())


def test_a_drift_is_a_table_with_its_numbers():
    drift = predict_drift(PATH, NOISE)
    assert f"{float(drift.end.rms):.3f}" in parsed(drift)
    assert parsed(drift.end)  # one place
    assert "shape" in parsed(predict_drift([PATH, PATH], NOISE))


def test_a_long_drift_is_thinned():
    drift = predict_drift([(0.1 * k, 0.0) for k in range(2001)], NOISE)
    assert 20 <= drift._repr_html_().count("<tr>") <= 60


def test_a_world_is_a_picture_with_its_words(world):
    shown = world._repr_html_()
    assert "robot_radius=0.4" in parsed(world)
    assert "<path" in shown


def test_a_route_stands_beside_the_shortest(world):
    route = plan_route(world, (2, 10), (18, 10), NOISE, iterations=2)
    assert f"{route.length:.2f}" in parsed(route)
    assert parsed(route.shortest)
