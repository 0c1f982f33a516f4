"""What results look like in a notebook: HTML that parses, with the numbers that matter in it."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

import driftplan
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


RESULTS = ["CoDesign", "Comparison", "Drift", "Layout", "NoiseFit", "Route", "SpatialDrift", "StudyResult"]


@pytest.mark.parametrize("name", RESULTS)
def test_every_result_has_a_table_for_pandas_and_one_for_people(name):
    result = getattr(driftplan, name)
    assert {"to_pandas", "to_dicts", "_repr_html_"} <= set(dir(result))
    assert not getattr(result, "__abstractmethods__", ())


def test_a_drift_goes_to_pandas_with_one_call():
    drift = predict_drift(PATH, NOISE)
    table = drift.to_pandas()
    assert table["rms_m"].tolist() == drift.rms.tolist()
    assert table[["x_m", "y_m"]].to_numpy().tolist() == drift.xy.tolist()
    assert drift.end.to_pandas()["cov_xy_m2"].tolist() == [float(drift.end.cov[0, 1])]


def test_of_a_batch_every_row_says_of_which_path_it_is():
    table = predict_drift([PATH, PATH[::-1]], NOISE).to_pandas()
    assert table["path"].tolist() == [0, 0, 0, 1, 1, 1]
    assert table.loc[table["path"] == 1, "x_m"].tolist() == [30, 30, 0]


def test_a_drift_in_space_goes_to_pandas_and_prints_short():
    steps = driftplan.flight_steps([(0, 0, 0), (3, 0, 4)], step_m=1.0)
    drift = driftplan.predict_drift_3d(*steps, driftplan.RotationNoise.isotropic(0.01))
    table = drift.to_pandas()
    assert table["z_m"].tolist() == drift.position[:, 2].tolist()
    assert table["cov_xz_m2"].tolist() == drift.cov[:, 0, 2].tolist()
    assert f"{drift.rms[-1]:.3f}" in parsed(drift)
    assert len(str(drift)) < 80


def test_a_fit_goes_to_pandas_with_one_call():
    fit = driftplan.fit_noise(*driftplan.simulate_log(5 * [(0, 0), (5, 0), (5, 5), (0, 5)], NOISE, rng=1))
    table = fit.to_pandas().set_index("rate")
    assert (table["low"] <= table["fitted"]).all()
    assert table.loc["heading_var_per_m", "fitted"] == fit.noise.heading_var_per_m
    assert fit.check.to_pandas()["length_m"].tolist() == [row.length_m for row in fit.check.lengths]
