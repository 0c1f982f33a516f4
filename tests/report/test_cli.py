"""The driftplan command, as a script and a person at a terminal meet it."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import shapely

from driftplan import (
    PRESETS,
    Beacon,
    BeaconKind,
    OdometryNoise,
    World,
    Zone,
    compare_routes,
    plan_route,
    predict_drift,
    save_noise,
)
from driftplan.beacons.beacon_files import beacons_geojson
from driftplan.planning.ompl.solve import PLANNERS as OMPL_PLANNERS
from driftplan.planning.roadmap.prices import exact_drift
from driftplan.planning.routes import ROADMAP
from driftplan.report.cli import build_parser
from driftplan.report.commands import COMMANDS
from driftplan.report.commands.shared import DEFAULT_PLANNER, PLANNERS
from driftplan.world.mapfiles import bundled_maps, load_world, save_world

DEFAULT_NOISE = OdometryNoise.from_std(heading_deg=1.0, distance_m=0.05, after_m=10.0)
QUICK = ["--iterations", "1"]  # of the roadmap: the same route however loaded the machine is


@pytest.fixture
def path_file(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("x,y\n-3,4\n7,4\n7,-2.5\n")
    return file


PATH = [(-3, 4), (7, 4), (7, -2.5)]


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    """10 x 8 m from (-5, -4), a wall with a gap at its upper end; the lower right corner is walled off."""
    walls = [shapely.box(-0.2, -4, 0.2, 2.5), shapely.box(3, -4, 3.2, -1), shapely.box(3, -1.2, 5, -1)]
    file = tmp_path_factory.mktemp("map") / "room.geojson"
    save_world(World.from_polygons(walls, bounds=(-5, -4, 5, 4), robot_radius=0.3), file)
    return file


# predict


def test_predict_prints_the_drift_at_every_waypoint(run, path_file):
    code, out, err = run("predict", path_file)
    drift = predict_drift(PATH, DEFAULT_NOISE)
    lines = out.splitlines()
    assert (code, err) == (0, "")
    assert lines[0] == f"{path_file}: 16.50 m"
    assert [float(line.split()[3]) for line in lines[2:]] == pytest.approx(drift.rms, abs=1e-3)
    assert [float(line.split()[1]) for line in lines[2:]] == [-3, 7, 7]


def test_predicted_json_is_what_the_library_says(run, path_file):
    code, out, _ = run("predict", path_file, path_file, "--heading-deg", 3, "--after-m", 5, "--json")
    noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=5.0)
    drift = predict_drift(PATH, noise)
    said = json.loads(out)
    assert code == 0
    assert said["command"] == "predict"
    assert OdometryNoise(**said["noise"]) == noise
    assert len(said["paths"]) == 2
    for path in said["paths"]:
        assert (path["file"], path["length_m"]) == (str(path_file), 16.5)
        points = path["points"]
        assert [p["rms_m"] for p in points] == drift.rms.tolist()
        assert [[p["bias_x_m"], p["bias_y_m"]] for p in points] == drift.bias.tolist()
        assert [[p["cov_xx_m2"], p["cov_xy_m2"], p["cov_yy_m2"]] for p in points] == [
            [c[0, 0], c[0, 1], c[1, 1]] for c in drift.cov
        ]
        assert [p["radius95_m"] for p in points] == drift.radius(0.95).tolist()
        assert [p["heading_std_rad"] for p in points] == drift.heading_std.tolist()


def test_predict_at_chosen_distances(run, path_file):
    _, out, _ = run("predict", path_file, "--at", "5,12.5", "--json")
    points = json.loads(out)["paths"][0]["points"]
    expected = predict_drift(PATH, DEFAULT_NOISE).at([5.0, 12.5])
    assert [p["distance_m"] for p in points] == [5.0, 12.5]
    assert [p["rms_m"] for p in points] == expected.rms.tolist()


def test_the_start_heading_is_given_in_degrees(run, path_file):
    turning = OdometryNoise(heading_var_per_rad=0.01)
    _, out, _ = run("predict", path_file, "--heading-var-per-rad", 0.01, "--start-heading-deg", -90, "--json")
    expected = predict_drift(PATH, turning, start_heading=-np.pi / 2)
    assert json.loads(out)["paths"][0]["points"][-1]["rms_m"] == pytest.approx(float(expected.end.rms), rel=1e-12)


def test_predict_for_a_robot_that_fuses_what_it_reads(run, path_file, tmp_path):
    beacons = tmp_path / "tags.geojson"
    tag = BeaconKind.range_only(range_m=50.0, range_std_m=0.1)
    beacons.write_bytes(beacons_geojson([Beacon(tag, x=3.0, y=7.0)]))
    words = ("predict", path_file, "--heading-deg", 1, "--distance-m", 0.05, "--after-m", 10)
    alone, fused = (
        json.loads(run(*words, "--json", *more).out) for more in ((), ("--beacons", beacons, "--estimator", "filter"))
    )
    assert fused["estimator"] == "filter"
    assert fused["paths"][0]["points"][-1]["rms_m"] < 0.9 * alone["paths"][0]["points"][-1]["rms_m"]
    assert fused["paths"][0]["beyond_linear_m"] == []
    refused = run(*words, "--beacons", beacons)
    assert refused.code == 2
    assert "filter" in refused.err
    lost = run("predict", path_file, "--heading-deg", 20, "--distance-m", 0, "--after-m", 1, "--estimator", "filter")
    assert "0.15 rad" in lost.out


def test_predict_draws_a_picture(run, path_file, tmp_path):
    code, _, _ = run("predict", path_file, "--png", tmp_path / "drift.png")
    assert code == 0
    assert (tmp_path / "drift.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["drift.png", "path.csv"]


# noise


@pytest.mark.parametrize(
    ("options", "noise"),
    [
        ([], DEFAULT_NOISE),
        (["--heading-deg", 2], OdometryNoise.from_std(heading_deg=2, distance_m=0.05, after_m=10)),
        (
            ["--heading-deg-per-full-turn", 5],
            OdometryNoise.from_std(heading_deg=1, distance_m=0.05, after_m=10, heading_deg_per_full_turn=5),
        ),
        (["--heading-var-per-m", "1e-4"], OdometryNoise(heading_var_per_m=1e-4)),
        (
            ["--heading-var-per-step", 0.01, "--step-m", 2, "--lateral-var-per-step", 0.1],
            OdometryNoise(heading_var_per_step=0.01, step_m=2.0, lateral_var_per_step=0.1),
        ),
        (
            ["--distance-var-per-m", 0.01, "--heading-bias-per-m", "-1e-3", "--distance-scale-error", "-.02"],
            OdometryNoise(distance_var_per_m=0.01, heading_bias_per_m=-1e-3, distance_scale_error=-0.02),
        ),
    ],
)
def test_noise_options_say_what_the_library_says(run, path_file, options, noise):
    code, out, _ = run("predict", path_file, "--json", *options)
    assert code == 0
    assert OdometryNoise(**json.loads(out)["noise"]) == noise


def test_systematic_errors_go_with_spreads(run, path_file):
    _, out, _ = run("predict", path_file, "--json", "--heading-deg", 0.5, "--heading-bias-per-rad", 0.1)
    said = json.loads(out)["noise"]
    assert (said["heading_bias_per_rad"], said["distance_var_per_m"]) == (0.1, DEFAULT_NOISE.distance_var_per_m)


def test_a_map_of_any_format_takes_zones_from_a_file(run, tmp_path):
    """Bad floor on the straight way: without it the route is straight, with it the route goes round."""
    save_world(World.from_polygons([], bounds=(0, 0, 30, 20), robot_radius=0.3), tmp_path / "hall.yaml")
    bad = Zone(shapely.box(5, 7, 25, 13), OdometryNoise(heading_var_per_m=0.1))
    save_world(World.from_polygons([], bounds=(0, 0, 30, 20), robot_radius=0.3, zones=[bad]), tmp_path / "z.geojson")
    asked = ("plan", tmp_path / "hall.yaml", "--start", "2,10", "--goal", "28,10", "--json", *QUICK)
    lengths = [
        json.loads(run(*asked, *zones)[1])["route"]["length_m"] for zones in ((), ("--zones", tmp_path / "z.geojson"))
    ]
    assert lengths[0] == pytest.approx(26.0)
    assert lengths[1] > 26.5


def test_noise_comes_from_a_file_or_a_preset(run, path_file, tmp_path):
    fitted = OdometryNoise(heading_var_per_m=2e-4, distance_scale_error=0.01)
    save_noise(tmp_path / "noise.yaml", fitted)
    for name, noise in ((tmp_path / "noise.yaml", fitted), ("textbook_steps", PRESETS["textbook_steps"].noise)):
        _, out, _ = run("predict", path_file, "--json", "--noise", name)
        assert OdometryNoise(**json.loads(out)["noise"]) == noise
    _, out, _ = run("predict", path_file, "--json", "--noise", tmp_path / "noise.yaml", "--distance-scale-error", 0.5)
    assert OdometryNoise(**json.loads(out)["noise"]) == replace(fitted, distance_scale_error=0.5)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (["--heading-deg", 1, "--distance-var-per-m", 0.1], "got --heading-deg and --distance-var-per-m$"),
        (["--noise", "textbook_steps", "--after-m", 5], "got --after-m and --noise$"),
        (["--noise", "nowhere.yaml"], "a noise file or a preset, one of .*textbook_steps; got 'nowhere.yaml'"),
    ],
)
def test_noise_is_said_in_one_way(refused, path_file, options, match):
    refused("predict", path_file, *options, match=match)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (["--heading-deg", "nan"], "expected --heading-deg finite, got nan"),
        (["--heading-deg", "-1"], "expected --heading-deg >= 0, got -1"),
        (["--after-m", "0"], "expected --after-m > 0, got 0"),
        (["--heading-var-per-m", "-1e-4"], "expected --heading-var-per-m >= 0, got -0.0001"),
        (["--distance-var-per-m", "inf"], "expected --distance-var-per-m finite, got inf"),
        (["--heading-var-per-step", "0.1"], "needs --step-m"),
        (["--heading-var-per-m", "little"], "argument --heading-var-per-m: invalid float value: 'little'"),
        (["--headng-deg", "1"], "unrecognized arguments: --headng-deg; did you mean --heading-deg"),
        (["--heading", "1"], "unrecognized arguments: --heading"),
    ],
)
def test_bad_noise_is_refused_in_one_line(refused, path_file, options, match):
    refused("predict", path_file, *options, match=match)


# paths that are none


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ("x,y\n1,2\n", "2"),
        ("x,y\n1,2\n3,nan\n", "path.csv.*(3|finite|nan)"),
        ("x,y\n1,2\n3,inf\n", "path.csv.*(3|finite|inf)"),
        ("x,y\n1,2\n3\n", "path.csv.*3"),
        ("x,y\n1,2\nthree,4\n", "path.csv.*(3|three)"),
        ("", "path.csv"),
        ("\x00\x01\x02\xff", "path.csv"),
    ],
)
def test_bad_paths_are_refused_in_one_line(refused, tmp_path, map_file, content, match):
    file = tmp_path / "path.csv"
    file.write_bytes(content.encode("latin-1"))
    refused("predict", file, match=match)
    refused("compare", map_file, file, match=match)


def test_what_cannot_be_predicted_is_refused(refused, path_file, tmp_path):
    refused("predict", tmp_path / "nowhere.csv", match=r"nowhere\.csv")
    refused("predict", tmp_path, match=str(tmp_path))
    refused("predict", path_file, "--at", "17", match=r"expected distances on the path, in \[0, 16.5\]")
    refused("predict", path_file, "--at", "-1", match="expected distances on the path")
    refused("predict", path_file, "--at", "5,x", match="argument --at: expected M,M,... in metres, got '5,x'")
    refused("predict", path_file, "--start-heading-deg", "nan", match="--start-heading-deg")
    refused("predict", match="the following arguments are required: PATH.csv")


def test_a_file_that_cannot_be_written_is_said_before_the_work(refused, path_file, tmp_path):
    refused(
        "predict",
        path_file,
        "--png",
        tmp_path / "no" / "a.png",
        match=r"argument --picture/--png: cannot write .*there is no folder",
    )
    refused("predict", path_file, "--png", tmp_path, match="it is a folder")


def test_nothing_is_written_when_something_is_wrong(refused, path_file, tmp_path):
    refused("predict", path_file, "--at", "17", "--png", tmp_path / "a.png", match="on the path")
    assert [p.name for p in tmp_path.iterdir()] == ["path.csv"]


# plan


def test_plan_finds_a_free_route_and_says_how_lost_the_robot_will_be(run, map_file):
    code, out, err = run("plan", map_file, "--start", "-3,-3", "--goal", "2,-3", *QUICK, "--json")
    said = json.loads(out)
    route = said["route"]
    path = np.array([(p["x_m"], p["y_m"]) for p in route["waypoints"]])
    world = load_world(map_file, robot_radius=0.3)
    drift = predict_drift(path, OdometryNoise(**said["noise"]))
    assert code == 0
    assert str(map_file) in err
    np.testing.assert_allclose(path[[0, -1]], [(-3, -3), (2, -3)])
    assert world.segments_free(path[:-1], path[1:]).all()
    assert route["length_m"] == pytest.approx(float(drift.length), rel=1e-12)
    assert [p["rms_m"] for p in route["waypoints"]] == pytest.approx(drift.rms.tolist(), rel=1e-9)
    assert route["rms_m"] == pytest.approx(float(drift.end.rms), rel=1e-9)
    assert 0 < route["bound_rms_m"] <= route["rms_m"]
    assert (route["planner"], route["minimise"], route["collision_free"]) == ("roadmap", "drift", True)


def test_plan_prints_a_summary_and_the_waypoints(run, map_file):
    _, out, _ = run("plan", map_file, "--start", "-3,-3", "--goal", "2,-3", *QUICK)
    lines = out.splitlines()
    assert lines[0].split()[:2] == ["route", "length"]
    assert lines[1].startswith("lowest drift")
    assert lines[2].startswith("shortest")
    assert lines[3].startswith(("Gained: ", "Nothing is gained"))
    assert re.match(r"roadmap: .*\. Proven for all routes: none has less than 0\.\d+ m of rms", lines[4])
    assert lines[7].split()[:3] == ["0.00", "-3.00", "-3.00"]
    shown = [line for line in lines if "more points are not shown" not in line]
    assert shown[-1].split()[1:3] == ["2.00", "-3.00"]


def test_plan_minimises_length_when_told(run, map_file):
    _, out, _ = run("plan", map_file, "--start=-3,-3", "--goal=2,-3", *QUICK, "--minimise", "length", "--json")
    route = json.loads(out)["route"]
    # around the two upper corners of the wall, 0.3 m away: 2 tangents and 2 arcs; inflation may add 3 % of the radius
    corner = np.hypot(2.8, 5.5)
    tangent = np.sqrt(corner**2 - 0.3**2)
    assert route["minimise"] == "length"
    assert tangent + 0.4 < route["length_m"] < 2 * corner + 2.0
    assert 0.99 * route["length_m"] <= route["bound_length_m"] <= route["length_m"]
    assert route["bound_covers"] == "all routes"


def test_the_options_of_planning_reach_the_planner(run, map_file, monkeypatch):
    asked = {}

    def spy(world, start, goal, noise, **options):
        asked.update(options, world=world, start=start, goal=goal, noise=noise)
        return plan_route(world, start, goal, noise, **options)

    monkeypatch.setattr("driftplan.plan_route", spy)
    options = ["--seed", 7, "--time-limit", 9, "--iterations", 4, "--max-detour", 1.2]
    options += ["--start-heading-deg", 90, "--robot-radius", 0.4]
    code, _, _ = run("plan", map_file, "--start", "-3,-3", "--goal", "-2,3", "--heading-deg", 2, *options)
    assert code == 0
    assert (asked["start"], asked["goal"]) == ((-3, -3, pytest.approx(np.pi / 2)), (-2, 3))
    assert asked["world"].robot_radius == 0.4
    assert asked["noise"] == OdometryNoise.from_std(heading_deg=2, distance_m=0.05, after_m=10)
    assert {k: asked[k] for k in ("seed", "time_limit", "iterations", "max_detour", "planner", "minimise")} == {
        "seed": 7,
        "time_limit": 9,
        "iterations": 4,
        "max_detour": 1.2,
        "planner": "roadmap",
        "minimise": "drift",
    }


def test_a_planned_route_can_be_predicted_from_its_csv(run, map_file, tmp_path):
    file = tmp_path / "route.csv"
    _, planned, _ = run("plan", map_file, "--start", "-3,-3", "--goal", "2,-3", *QUICK, "--csv", file, "--json")
    _, predicted, _ = run("predict", file, "--json")
    at_end = json.loads(predicted)["paths"][0]["points"][-1]
    assert at_end["rms_m"] == pytest.approx(json.loads(planned)["route"]["rms_m"], rel=1e-12)


def test_plan_writes_geojson_and_a_picture(run, map_file, tmp_path):
    files = [tmp_path / "route.geojson", tmp_path / "route.png"]
    code, out, _ = run(
        "plan",
        map_file,
        "--start",
        "-3,-3",
        "--goal",
        "2,-3",
        *QUICK,
        "--geojson",
        files[0],
        "--png",
        files[1],
        "--json",
    )
    (feature,) = json.loads(files[0].read_text())["features"]
    waypoints = json.loads(out)["route"]["waypoints"]
    assert code == 0
    expected = [
        [p["x_m"], p["y_m"]] for p in waypoints
    ]  # in the file as people write them: 2.0, not 2.0000000000000004
    np.testing.assert_allclose(feature["geometry"]["coordinates"], expected, rtol=1e-14)
    np.testing.assert_allclose(feature["properties"]["rms_m"], [p["rms_m"] for p in waypoints], rtol=1e-14)
    assert feature["properties"]["planner"] == "roadmap"
    assert files[1].read_bytes().startswith(b"\x89PNG")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["route.geojson", "route.png"]


def test_maps_that_come_along_go_by_name(run):
    code, out, _ = run("plan", "office", "--start", "2,17", "--goal", "32,16.5", *QUICK, "--json")
    assert code == 0
    assert json.loads(out)["route"]["length_m"] >= 30


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (["--start", "0,0", "--goal", "2,-3"], r"start \(0, 0\) is not free.*nearest free point is \(-?0\.5"),
        (["--start", "-3,-3", "--goal", "0,0"], r"goal \(0, 0\) is not free.*nearest free point"),
        (
            ["--start", "-9,0", "--goal", "2,-3"],
            r"start \(-9, 0\) is off the map, which spans x -5 to 5 and y -4 to 4 m; .* free point is \(-4\.(69|7)",
        ),
        (["--start", "nan,0", "--goal", "2,-3"], "start.*(finite|NaN|nan)"),
        (
            ["--start", "1,2,3", "--goal", "2,-3"],
            "argument --start: expected X,Y in metres, .*got '1,2,3'",
        ),
        (["--start", "-3,-3"], "expected both --start and --goal, or --trips"),
        (["--start", "-3,-3", "--goal", "2,-3", "--robot-radius", "-1"], "--robot-radius"),
        (["--start", "-3,-3", "--goal", "2,-3", "--robot-radius", "9"], "free"),
        (["--start", "-3,-3", "--goal", "2,-3", "--time-limit", "0"], "--time-limit"),
        (["--start", "-3,-3", "--goal", "2,-3", "--time-limit", "nan"], "--time-limit"),
        (["--start", "-3,-3", "--goal", "2,-3", "--iterations", "0"], "--iterations a whole number >= 1, got 0"),
        (["--start", "-3,-3", "--goal", "2,-3", "--seed", "-1"], "expected --seed"),
        (["--start", "-3,-3", "--goal", "2,-3", "--max-detour", "0.5"], "--max-detour"),
        (["--start", "-3,-3", "--goal", "2,-3", "--planner", "prm"], "planner 'prm' cannot minimise drift: .*roadmap"),
        (["--start", "-3,-3", "--goal", "2,-3", "--planner", "best"], "unknown planner 'best'.*roadmap"),
        (["--start", "-3,-3", "--goal", "2,-3", "--minimise", "fun"], "invalid choice: 'fun'"),
        (["--start", "-3,-3", "--goal", "2,-3", "--unknown-is-free"], "--unknown-is-free is for ROS files"),
        (["--start", "-3,-3", "--goal", "2,-3", "--cell-size-m", "2"], "--cell-size-m is for MovingAI files"),
    ],
)
def test_what_cannot_be_planned_is_refused_in_one_line(refused, map_file, options, match):
    refused("plan", map_file, *options, match=match)


def test_no_route_has_an_exit_code_of_its_own(refused, map_file):
    refused("plan", map_file, "--start", "-3,-3", "--goal", "4,-3", *QUICK, match="no|reach", code=3)
    refused("compare", map_file, "--start", "-3,-3", "--goal", "4,-3", *QUICK, match="no|reach", code=3)


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("gone.yaml", None, r"gone\.yaml"),
        ("map.txt", b"hello", r"map\.txt: expected a map called"),
        ("noise.yaml", bytes(range(256)), r"noise\.yaml"),
        ("tag.yaml", b"image: !!python/object/apply:os.system ['true']\n", r"tag\.yaml"),
        ("away.yaml", b"image: ../../../etc/passwd\nresolution: 0.05\norigin: [0, 0, 0]\n", r"away\.yaml"),
        ("huge.map", b"type octile\nheight 99999999\nwidth 99999999\nmap\n", r"huge\.map"),
        ("cut.map", b"type octile\nheight 3\nwidth 3\nmap\n...\n..", r"cut\.map"),
        ("cut.geojson", b'{"type": "FeatureCollection", "features": [', r"cut\.geojson, line 1"),
        ("empty.geojson", b"", r"empty\.geojson"),
    ],
)
def test_broken_maps_are_refused_in_one_line(refused, tmp_path, name, content, match):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    refused("plan", tmp_path / name, "--start", "1,1", "--goal", "2,2", match=match)


# compare


def test_compare_puts_given_paths_and_planned_routes_side_by_side(run, map_file, tmp_path):
    free, through = tmp_path / "free.csv", tmp_path / "through.csv"
    free.write_text("x,y\n-3,-3\n-3,3.3\n2,3.3\n2,-3\n")
    through.write_text("x,y\n-3,-3\n2,-3\n")
    ends = ["--start", "-3,-3", "--goal", "2,-3"]
    code, out, _ = run(
        "compare", map_file, free, through, *ends, "--time-limit", "0.5", "--planner", "roadmap",
        "--planner", "bitstar", "--json",
    )  # fmt: skip
    rows = {row["name"]: row for row in json.loads(out)["routes"]}
    assert code == 0
    assert list(rows) == [
        str(free),
        str(through),
        "lowest drift (roadmap)",
        "shortest (roadmap)",
        "lowest drift (bitstar)",
        "shortest (bitstar)",
    ]
    assert [rows[str(f)]["collision_free"] for f in (free, through)] == [True, False]
    drift = predict_drift([(-3, -3), (-3, 3.3), (2, 3.3), (2, -3)], DEFAULT_NOISE)
    assert rows[str(free)]["rms_m"] == pytest.approx(float(drift.end.rms), rel=1e-12)
    assert rows[str(free)]["length_m"] == pytest.approx(17.6)
    for planner in ("roadmap", "bitstar"):
        lowest, shortest = rows[f"lowest drift ({planner})"], rows[f"shortest ({planner})"]
        assert lowest["rms_m"] <= shortest["rms_m"] * (1 + 1e-12)
        assert lowest["planner"] == planner
    assert rows["lowest drift (roadmap)"]["rms_m"] <= rows[str(free)]["rms_m"]


def test_rows_are_called_and_valued_as_in_compare_routes(run, map_file):
    _, out, _ = run("compare", map_file, "--start", "-3,-3", "--goal", "2,-3", *QUICK, "--json")
    row = json.loads(out)["routes"][0]
    world = load_world(map_file, robot_radius=0.3)
    (expected,) = compare_routes([plan_route(world, (-3, -3), (2, -3), DEFAULT_NOISE, time_limit=0.2)]).to_dicts()
    assert expected.keys() <= row.keys()


def test_the_table_says_how_far_above_the_least_a_route_is(run, map_file, tmp_path):
    (tmp_path / "long.csv").write_text("x,y\n-3,-3\n-3,3.3\n2,3.3\n2,-3\n")
    (tmp_path / "wall.csv").write_text("x,y\n-3,-3\n2,-3\n")
    files = [tmp_path / "long.csv", tmp_path / "wall.csv"]
    _, out, _ = run("compare", map_file, *files, "--start", "-3,-3", "--goal", "2,-3", *QUICK)
    rows = [line.split() for line in out.splitlines()[1:]]
    assert [row[-1] for row in rows] == ["yes", "no", "yes", "yes"]
    assert [row[-2] for row in rows] == ["-", "-", "roadmap", "roadmap"]
    assert float(rows[0][-3]) > 0
    assert rows[2][-3] == "+0.0"


def test_paths_are_scored_with_the_noise_of_the_zones_they_cross(run, tmp_path):
    wet = Zone(shapely.box(2, 0, 6, 4), DEFAULT_NOISE.scaled(10.0))
    world = World.from_polygons([], bounds=(0, 0, 10, 4), robot_radius=0.3, zones=[wet])
    save_world(world, tmp_path / "wet.geojson")
    (tmp_path / "path.csv").write_text("x,y\n1,1\n9,1\n")
    _, out, _ = run("compare", tmp_path / "wet.geojson", tmp_path / "path.csv", "--json")
    expected = exact_drift(world, np.array([(1.0, 1.0), (9.0, 1.0)]), DEFAULT_NOISE)
    row = json.loads(out)["routes"][0]
    assert row["rms_m"] == pytest.approx(float(expected.end.rms), rel=1e-12)
    assert row["rms_m"] > 3 * predict_drift([(1, 1), (9, 1)], DEFAULT_NOISE).end.rms


def test_compare_draws_all_routes(run, map_file, path_file, tmp_path, monkeypatch):
    drawn = []
    from driftplan.report.figures import routes as figures

    real = figures.plot_comparison
    monkeypatch.setattr(
        figures, "plot_comparison", lambda world, routes: drawn.append(list(routes)) or real(world, routes)
    )
    ends = ["--start", "-3,-3", "--goal", "2,-3"]
    code, _, _ = run("compare", map_file, path_file, *ends, *QUICK, "--png", tmp_path / "all.png")
    assert code == 0
    assert drawn == [[str(path_file), "lowest drift (roadmap)", "shortest (roadmap)"]]
    assert (tmp_path / "all.png").read_bytes().startswith(b"\x89PNG")


def test_compare_wants_something_to_compare(refused, map_file):
    refused("compare", map_file, match="expected something to compare")
    refused("compare", map_file, "--start", "1,1", match="expected both --start and --goal")


# maps and demo


def test_maps_lists_the_maps_that_come_along_with_their_sizes(run):
    code, out, _ = run("maps", "--json")
    found = {row["name"]: row for row in json.loads(out)["maps"]}
    assert code == 0
    assert set(found) == set(bundled_maps())
    assert (found["warehouse"]["width_m"], found["warehouse"]["height_m"]) == pytest.approx((60, 40))
    _, out, _ = run("maps")
    assert [line.split()[0] for line in out.splitlines()] == ["map", *bundled_maps()]


@pytest.mark.slow
def test_the_demo_shows_less_drift_than_the_shortest_routes_and_draws_them(run, tmp_path):
    code, out, _ = run("demo", "--folder", tmp_path / "demo", "--form", "svg", "--json")
    said = json.loads(out)
    assert code == 0
    assert [row["name"] for row in said["maps"]["warehouse"]] == ["lowest drift", "shortest"]
    for lowest, shortest in said["maps"].values():
        assert lowest["rms_m"] < 0.9 * shortest["rms_m"]  # trips on which it pays: 20 and 80 % less
    assert sorted(said["files"]) == sorted(str(p) for p in (tmp_path / "demo").iterdir())
    assert all((tmp_path / "demo" / f"{name}.svg").stat().st_size > 20_000 for name in said["maps"])
    for tags in said["tags"].values():
        assert tags["proven"] is True
        assert len(tags["beacons"]) == tags["lower_bound"] > 0
        assert 0.5 * tags["limit_m"] < tags["worst_drift_m"] <= tags["limit_m"]
    assert said["tags"]["filter"]["lower_bound"] < said["tags"]["reset"]["lower_bound"]
    assert (tmp_path / "demo" / "warehouse-tags.svg").stat().st_size > 20_000


# the command as a whole


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_says_what_it_is_in_which_unit_and_its_default(command):
    parser = next(a for a in build_parser()._actions if a.dest == "command").choices[command]
    for action in parser._actions:
        assert action.help, action.dest
        if action.type is float:
            assert re.search(
                r"metre|second|degree|rad|m\^2|ratio|relative|multiple|cost|any unit|confidence|probability|share",
                action.help,
            ), action.option_strings
        if action.default not in (None, False, [], "==SUPPRESS=="):
            assert str(action.default).rstrip("0").rstrip(".") in action.help, action.option_strings


def test_the_version_is_that_of_the_package(run):
    from importlib.metadata import version

    assert run("--version")[:2] == (0, f"driftplan {version('driftplan')}\n")


def test_pictures_have_a_form_and_maps_are_files_or_come_along(refused, map_file, path_file, tmp_path):
    refused(
        "predict", path_file, "--png", tmp_path / "drift.gif", match=r"--png: expected a file called .png, .*got .*gif"
    )
    ends = ("--start", "1,1", "--goal", "2,2")
    refused("plan", "warehose", *ends, match="a map file or one of office, warehouse, got 'warehose'")


def test_routes_through_walls_are_not_given_beacons_without_a_word(run, map_file, tmp_path):
    (tmp_path / "wall.csv").write_text("x,y\n-3,-3\n2,-3\n")
    code, out, err = run("place", map_file, tmp_path / "wall.csv", "--max-drift", 1, "--json")
    assert code == 0
    assert "wall.csv: not free of collisions for a robot of radius 0.3 m" in err
    assert "for 1 route on" in err
    assert [route["collision_free"] for route in json.loads(out)["layout"]["routes"]] == [False]


def test_the_planners_named_in_the_help_are_those_there_are():
    assert set(PLANNERS) == {ROADMAP, *OMPL_PLANNERS}
    assert DEFAULT_PLANNER == ROADMAP


def test_the_help_is_plain_ascii_and_exits_with_zero(run):
    for command in ([], *([c] for c in COMMANDS)):
        code, out, err = run(*command, "--help")
        assert (code, err) == (0, "")
        assert out.isascii()


def test_a_command_is_needed(refused):
    refused(match="required: COMMAND")
    refused("fly", match="invalid choice: 'fly'")


def test_beacons_are_placed_and_then_used(run, map_file, tmp_path):
    path, tags = tmp_path / "route.csv", tmp_path / "tags.geojson"
    noise = ("--heading-deg", "4", "--after-m", "10")
    run("plan", map_file, "--start=-3,-3", "--goal=2,-3", *QUICK, *noise, "--csv", str(path))
    code, out, _ = run(
        "place",
        map_file,
        str(path),
        *noise,
        "--max-drift",
        "0.35",
        "--geojson",
        str(tags),
        "--json",
        "--time-limit",
        "20",
    )
    assert code == 0
    placed = json.loads(out)
    assert tags.exists()
    code, out, err = run(
        "plan", map_file, "--start=-3,-3", "--goal=2,-3", *noise, "--time-limit", "1",
        "--beacons", str(tags), "--max-drift", "0.6", "--minimise", "length", "--json",
    )  # fmt: skip
    assert code == 0, err
    route = json.loads(out)["route"]
    assert route["worst_drift_m"] <= 0.6
    assert placed["command"] == "place"
    assert run("plan", map_file, "--start=-3,-3", "--goal=2,-3", *noise, "--max-drift", "0.01")[0] == 3


def test_the_length_of_a_step_alone_is_no_noise(run, tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("0,0\n30,0\n")
    code, out, err = run("predict", file, "--step-m", 1)
    assert (code, out) == (2, "")
    assert "expected --step-m together with a variance" in err
