"""The chance that a robot which steers by its drifting estimate touches a wall."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr
from shapely import LineString

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.readings import drift_with_beacons
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix, Readings
from driftplan.model.simulation import simulate_drift
from driftplan.planning.collision_chance import collision_chance
from driftplan.planning.comparison import compare_routes
from driftplan.planning.routes import plan_route
from driftplan.report.cli import main
from driftplan.report.figures.routes import plot_collisions
from driftplan.world.world import World

HALL = World.from_polygons([[(12, 0), (16, 0), (16, 11), (12, 11)]], bounds=(0, 0, 40, 20), robot_radius=0.3)
WIDE = replace(HALL, robot_radius=1.0)
NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.1, after_m=10.0)
PATH = [(3, 3), (3, 12.5), (25, 12.5), (36, 4)]
TAGS = [Beacon(BeaconKind.landmark(range_m=4, position_std_m=0.1, heading_std=0.02), x, 14.0) for x in (8.0, 20.0)]
RADIOS = [Beacon(BeaconKind.range_only(range_m=9, range_std_m=0.1), x, 16.0) for x in (6.0, 24.0)]


def beside_a_wall(clearance: float) -> World:
    """A wall ends ``clearance`` beside the x axis."""
    return World.from_polygons([], bounds=(-50, -clearance - 1, 80, 90), robot_radius=1.0)


@given(st.floats(0.2, 2.0), st.floats(0.02, 0.2))
@settings(max_examples=3)
def test_a_lateral_random_walk_touches_a_wall_twice_as_often_as_it_ends_behind_it(clearance, var_per_m):
    """The reflection principle; between the 200 places looked at a walk comes a little farther than at them."""
    drift = predict_drift([(0, 0), (20, 0)], OdometryNoise(lateral_var_per_m=var_per_m))
    chance = collision_chance(drift, beside_a_wall(clearance), runs=1000)
    beyond = ndtr(-clearance / np.sqrt(20 * var_per_m))
    assert chance.at[-1] == pytest.approx(beyond, abs=0.01)
    assert chance.probability == pytest.approx(2 * beyond, abs=0.01 + 0.14 * beyond + 3 * np.sqrt(beyond / 1000))
    assert chance.low < chance.probability < chance.high or beyond < 1e-3
    assert chance.bound >= min(2 * beyond, 1) * 0.95


@pytest.mark.parametrize("estimator", ["reset", "filter"])
@pytest.mark.parametrize("beacons", [[], TAGS, RADIOS], ids=["none", "landmarks", "radios"])
def test_the_chance_is_that_of_drives_simulated_one_by_one(beacons, estimator):
    """Each drive's polygon of true places, against the obstacles grown by the robot."""
    if beacons is RADIOS and estimator == "reset":
        pytest.skip("ranges need a filter")
    drift = drift_with_beacons(PATH, NOISE, beacons, HALL, estimator=estimator)
    chance = collision_chance(drift, HALL, runs=600, seed=3)
    errors = drift.simulated(chance.distance, runs=400, rng=8)
    free = HALL.free
    touched = np.mean([not free.contains(LineString(chance.xy - drive)) for drive in errors])
    assert abs(touched - chance.probability) < 4 * np.sqrt(0.25 / 600 + 0.25 / 400)
    assert chance.low <= chance.probability <= chance.high <= 1
    assert chance.bound >= chance.low
    assert chance.by[-1] == chance.probability
    assert (np.diff(chance.by) >= 0).all()
    share = [np.mean(~HALL.is_free(chance.xy[k] - errors[:, k])) for k in (60, 120, 199)]
    assert chance.at[[60, 120, 199]] == pytest.approx(share, abs=0.08)


@pytest.mark.parametrize("estimator", ["reset", "filter"])
def test_steering_back_at_a_reading_counts(estimator):
    """A thin pole stands 1 m beside where a tag is read: whoever is off beyond it runs into it on the way back."""
    pole = World.from_polygons(
        [[(20, 0.99), (20.02, 0.99), (20.02, 1.01), (20, 1.01)]], bounds=(-9, -20, 50, 20), robot_radius=0.05
    )
    noise, fix = OdometryNoise(lateral_var_per_m=0.05), Fix.position(20.01, position_std_m=0.01)
    drift = predict_drift([(0, 0), (30, 0)], noise, fixes=[fix], estimator=estimator)
    beyond = ndtr(-1.0 / np.sqrt(20 * 0.05))
    chance = collision_chance(drift, pole, runs=3000)
    assert chance.probability == pytest.approx(beyond, abs=0.04)
    assert chance.low <= chance.bound < 1.6 * beyond


def test_the_bound_is_near_where_errors_of_heading_make_the_drift():
    drift = predict_drift(PATH, OdometryNoise.from_std(heading_deg=4.0, distance_m=0.001, after_m=10.0))
    chance = collision_chance(drift, HALL, runs=4000)
    assert 0.02 < chance.probability < 0.5
    assert chance.low < chance.bound < 1.6 * chance.high


def test_drives_that_are_simulated_have_the_errors_and_readings_of_the_drift():
    """At its own places, in any number, and from a start that is not known."""
    start = Fix(s_m=0.0, position_cov=np.array([[0.04, 0.01], [0.01, 0.02]]), heading_std=0.1)
    for estimator in ("reset", "filter"):
        drift = drift_with_beacons(PATH, NOISE, TAGS, fixes=[start], estimator=estimator)
        places = np.linspace(0.0, float(drift.length), 7)
        errors = drift.simulated(places, runs=2000, rng=1)
        rms = np.sqrt((errors**2).sum(axis=2).mean(axis=0))
        assert rms == pytest.approx(drift.at(places).rms, rel=0.08)


def test_fixes_come_back_from_readings():
    cov = np.array([[0.04, 0.01], [0.01, 0.02]])
    fixes = [
        Fix(s_m=0.0, position_cov=cov),
        Fix.range(2.0, anchor=(1.0, 2.0), range_std_m=0.1, detection_probability=0.4),
        Fix.bearing(3.0, anchor=(1.0, 2.0), bearing_std=0.2),
        Fix.full(4.0, position_std_m=0.3, heading_std=0.02),
    ]
    back = Readings.of(fixes[::-1]).fixes()
    assert np.allclose(back[0].position_cov, cov)
    for one, other in zip(fixes, back, strict=True):
        for name in ("s_m", "heading_std", "range_std_m", "bearing_std", "detection_probability"):
            assert getattr(one, name) == pytest.approx(getattr(other, name))


def test_whole_steps_of_odometry_stay_whole():
    """In the step model a stretch counts its steps from where it begins: places between add none."""
    noise = OdometryNoise(heading_var_per_step=1e-3, distance_var_per_step=1e-3, step_m=1.0)
    drift = predict_drift([(3, 3), (3, 12.5), (36, 12.5)], noise)
    chance = collision_chance(drift, HALL, runs=3000)
    errors = simulate_drift(drift.xy, noise, runs=3000, rng=5)
    ours = drift.simulated(chance.distance, runs=3000, rng=6)[:, -1]
    assert (ours**2).sum(axis=1).mean() == pytest.approx((errors[:, -1] ** 2).sum(axis=1).mean(), rel=0.12)
    assert (np.diff(chance.distance) >= 1.0 - 1e-9).sum() >= len(chance.distance) - 3


def test_no_drift_touches_nothing_and_a_path_through_a_wall_always_does():
    sure = predict_drift(PATH, OdometryNoise(distance_var_per_m=1e-12))
    safe = collision_chance(sure, HALL, runs=50)
    assert (safe.probability, safe.low, safe.bound) == (0.0, 0.0, 0.0)
    assert safe.high == pytest.approx(0.071, abs=0.001)  # 1 - 0.025^(1/50)
    through = collision_chance(predict_drift([(3, 3), (36, 3)], NOISE), HALL, runs=50)
    assert through.probability == through.bound == through.by[-1] == 1.0
    assert "CollisionChance(1, 95 % in [0.929, 1], at most 1" in repr(through)


def test_tags_and_margins_make_collisions_less_likely():
    route = plan_route(WIDE, (3, 3), (36, 4), NOISE, iterations=2)
    alone = route.collision_probability(HALL, runs=2000)
    grazing = plan_route(HALL, (3, 3), (36, 4), NOISE, iterations=2).collision_probability(HALL, runs=200)
    tagged = collision_chance(drift_with_beacons(route.path, NOISE, TAGS, HALL), HALL, runs=2000)
    assert tagged.high < alone.low
    assert alone.high < grazing.low
    table = compare_routes([route, drift_with_beacons(route.path, NOISE, TAGS, HALL)], collisions=HALL)
    rows = table.to_dicts()
    assert rows[0]["collision_low"] < alone.high  # two samples of one chance
    assert alone.low < rows[0]["collision_high"]
    assert rows[1]["collision_bound"] < rows[0]["collision_low"] < rows[0]["collision_bound"]
    assert "touches a wall %" in str(table)
    assert "touches a wall %" not in str(compare_routes([route]))


def test_questions_that_make_no_sense_are_refused():
    drift = predict_drift(PATH, NOISE)
    with pytest.raises(ValueError, match="one path"):
        collision_chance(predict_drift(np.zeros((2, 3, 2)), NOISE), HALL)
    with pytest.raises(ValueError, match="runs"):
        collision_chance(drift, HALL, runs=0)
    with pytest.raises(ValueError, match="spacing_m"):
        collision_chance(drift, HALL, spacing_m=0.0)
    with pytest.raises(ValueError, match="use a larger spacing_m"):
        collision_chance(drift, HALL, spacing_m=1e-6)


def test_the_figure_shows_where_and_how_often():
    drift = predict_drift(PATH, NOISE)
    chance = collision_chance(drift, HALL, runs=100)
    on_map, on_curve, _ = plot_collisions(HALL, chance).axes
    assert on_map.get_title().startswith(f"{100 * chance.probability:.3g} % of 100 drives touch a wall")
    by, at = on_curve.get_lines()
    assert by.get_ydata()[-1] == chance.probability
    assert np.array_equal(at.get_ydata(), chance.at)
    (line,) = on_map.collections
    assert line.get_array().max() == chance.at.max()


def test_the_command_line_says_it_of_planned_and_given_paths(tmp_path, capsys):
    given = tmp_path / "given.csv"
    given.write_text("x,y\n51,33\n48,36\n30,36\n")
    asked = ["--robot-radius", "0.6", "--collisions", "0.3", "--json"]
    assert main(["compare", "warehouse", str(given), *asked]) == 0
    (row,) = json.loads(capsys.readouterr().out)["routes"]
    assert row["collision_low"] <= row["collision_probability"] <= row["collision_high"]
    picture = tmp_path / "where.png"
    ends = ["--start", "51,33", "--goal", "40,36", "--time-limit", "0.5", "--picture", str(picture)]
    assert main(["plan", "warehouse", *asked, *ends]) == 0
    route = json.loads(capsys.readouterr().out)["route"]
    assert 0 <= route["collision_probability"] <= 1 >= route["collision_bound"]
    assert picture.stat().st_size > 10_000
