"""driftplan design: its answer, its files, its figure, its words; and trips from files."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from driftplan.beacons.beacon import BeaconKind
from driftplan.beacons.beacon_files import load_beacons
from driftplan.errors import TrajectoryError
from driftplan.layouts.co_design.co_design import co_design
from driftplan.layouts.co_design.design import Trip, load_trips
from driftplan.layouts.scenario import Sites
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Fix
from driftplan.planning.request import DriftLimit
from driftplan.report.figures.layouts import plot_design
from driftplan.world.world import World

SHELF = [(8, 4), (32, 4), (32, 8), (8, 8)]
MAP = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"kind": kind},
            "geometry": {"type": "Polygon", "coordinates": [[list(c) for c in (*ring, ring[0])]]},
        }
        for kind, ring in (("boundary", [(0, 0), (40, 0), (40, 12), (0, 12)]), ("obstacle", SHELF))
    ],
}
TRIPS = "start_x,start_y,goal_x,goal_y,weight\n2,2,38,2,1\n2,10,38,10,2\n"
WORLD = World.from_polygons([SHELF], bounds=(0, 0, 40, 12), robot_radius=0.5)
KIND = ("--kind", "landmark", "--range-m", 2, "--position-std-m", 0.05, "--beacon-price", 100, "--spacing-m", 4)
NOISE = ("--heading-deg", 3, "--distance-m", 0.05)


FAST = ("--robot-radius", 0.5, "--time-limit", 600, *KIND, *NOISE)


@pytest.fixture(scope="module")
def found():
    """The design that the command's arguments of these tests ask for, on the same map."""
    noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    sign = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=math.radians(1.0), cost=100.0)
    trips = [Trip((2, 2), (38, 2)), Trip((2, 10), (38, 10), 2.0)]
    return co_design(WORLD, trips, noise, 1.2, Sites(sign, spacing_m=4.0), price_per_m=1.0, rounds=0, max_nodes=100)


@pytest.fixture
def design(found, tmp_path, run, monkeypatch):
    """Runs the subcommand on a small map with two trips, searching nothing: asked for are ``design.asked``."""
    (tmp_path / "map.geojson").write_text(json.dumps(MAP))
    (tmp_path / "trips.csv").write_text(TRIPS)
    files = [tmp_path / name for name in ("map.geojson", "trips.csv")]
    asked = []
    monkeypatch.setattr("driftplan.co_design", lambda *values, **options: asked.append((values, options)) or found)

    def design(*words):
        return run("design", *files, "--max-drift", 1.2, "--price-per-m", 1, *FAST, *words)

    design.asked = asked
    return design


def test_what_is_gained_is_on_stdout_and_talk_on_stderr(design):
    printed = design()
    trips, *_ = printed.out.split("\n\n")
    assert [line.split()[0] for line in trips.splitlines()] == ["trip", "0", "1"]
    assert "shortest routes, then beacons" in printed.out
    assert "Gained: " in printed.out
    assert "choosing beacons and routes for 2 trips" in printed.err


def test_json_says_the_same_as_the_files(design, found, tmp_path):
    files = [tmp_path / name for name in ("beacons.geojson", "beacons.csv", "design.png")]
    printed = design("--json", "--geojson", files[0], "--csv", files[1], "--png", files[2])
    answer = json.loads(printed.out)["design"]
    beacons = load_beacons(files[0])
    assert [b.id for b in beacons] == [b["id"] for b in answer["beacons"]]
    assert [(b.x, b.y) for b in beacons] == [(b["x_m"], b["y_m"]) for b in answer["beacons"]]
    assert all(b.kind.cost == 100 for b in beacons)
    assert answer["cost"] == pytest.approx(answer["beacon_cost"] + answer["driving_cost"])
    assert answer["gain"] == pytest.approx(answer["baseline"]["cost"] - answer["cost"])
    assert answer["driving_cost"] == pytest.approx(sum(r["weight"] * r["length_m"] for r in answer["routes"]))
    assert all(r["worst_drift_m"] <= 1.2 * (1 + 1e-6) for r in answer["routes"])
    assert files[1].read_text().count("\n") == 1 + len(beacons)
    assert files[2].read_bytes().startswith(b"\x89PNG")


def test_the_options_reach_the_search(design):
    code, _, err = design(
        "--start-position-std-m",
        0.3,
        "--start-heading-std-deg",
        7,
        "--redundancy",
        2,
        "--max-detour",
        1.3,
        "--seed",
        4,
        "--estimator",
        "filter",
    )
    assert code == 0, err
    ((world, trips, noise, limit, sites), options) = design.asked[0]
    assert (world.bounds, world.robot_radius, limit) == (
        WORLD.bounds,
        0.5,
        DriftLimit(1.2, redundancy=2, min_capture=0.9),
    )
    assert trips == (Trip((2, 2), (38, 2)), Trip((2, 10), (38, 10), 2.0))
    assert noise == OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    assert sites.kind == (BeaconKind.landmark(2.0, 0.05, math.radians(1.0), cost=100.0),)
    assert (sites.points, sites.spacing_m, sites.existing) == (None, 4.0, ())
    assert repr(options["start_fix"]) == repr(Fix.full(0.0, position_std_m=0.3, heading_std=math.radians(7)))
    asked = {
        "max_detour": 1.3,
        "seed": 4,
        "price_per_m": 1.0,
        "time_limit": 600.0,
        "estimator": "filter",
    }
    assert {name: options[name] for name in asked} == asked


@pytest.mark.slow
def test_a_design_is_found_from_files_to_files(tmp_path, run):
    (tmp_path / "map.geojson").write_text(json.dumps(MAP))
    (tmp_path / "trips.csv").write_text(TRIPS)
    asked = ("--max-drift", 1.2, "--price-per-m", 1, *FAST, "--json")
    code, out, err = run("design", tmp_path / "map.geojson", tmp_path / "trips.csv", *asked)
    assert code == 0, err
    assert json.loads(out)["design"]["gain"] >= 0


def test_what_cannot_be_done_is_said_and_nothing_written(refused, tmp_path):
    (tmp_path / "map.geojson").write_text(json.dumps(MAP))
    (tmp_path / "trips.csv").write_text(TRIPS)
    file = tmp_path / "beacons.geojson"
    asked = ("--max-drift", 0.06, "--price-per-m", 1, *FAST, "--geojson", file)
    refused("design", tmp_path / "map.geojson", tmp_path / "trips.csv", *asked, match="trip 0: ", code=3)
    assert not file.exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,2,3\n", "line 1: expected the columns start_x, .* got 3 columns"),
        ("x,y,goal_x,goal_y\n1,2,3,4\n", "line 2: expected the columns start_x, .* got x, y"),
        ("start_x,start_y,goal_x,goal_y,goal_y\n1,2,3,4,5\n", "line 2: expected the columns"),
        ("start_x,start_y,goal_x,goal_y,weight\n1,2,3,4,0\n", "line 2: expected weight > 0"),
        ("start_x,start_y,goal_x,goal_y,weight\n1,2,3,4\n", "expected a header of 4 names, got 'start_x,.*weight"),
        ("1,2,3,4\n\n1,2,three,4\n", "line 3: expected numbers, got '1 2 three 4"),
        ("1,2,3,nan\n", "line 1: .*finite"),
        ("# nothing yet\n", "found none"),
    ],
)
def test_trips_that_make_no_sense_are_refused_by_file_and_line(tmp_path, text, said):
    file = tmp_path / "trips.csv"
    file.write_text(text)
    with pytest.raises(TrajectoryError, match=said):
        load_trips(file)
    with pytest.raises(TrajectoryError):
        load_trips(tmp_path / "none.csv")
    with pytest.raises(TrajectoryError, match="Is a directory"):
        load_trips(tmp_path)


def test_trips_are_read_with_and_without_header_in_any_order(tmp_path):
    file = tmp_path / "trips.csv"
    file.write_text("# from the floor manager\n1 2 3 4\n5 6 7 8\n")
    assert load_trips(file) == (Trip((1, 2), (3, 4)), Trip((5, 6), (7, 8)))
    file.write_bytes(b"\xef\xbb\xbfstart_x,start_y,goal_x,goal_y\n1,1,5,5\n")  # as spreadsheets write it
    assert load_trips(file) == (Trip((1, 1), (5, 5)),)
    file.write_text("weight;goal_x;goal_y;start_x;start_y\n9;3;4;1;2\n")
    assert load_trips(file) == (Trip((1, 2), (3, 4), 9),)


def test_the_figure_shows_both_designs(found):
    figure = plot_design(WORLD, found)
    before, after = figure.axes
    assert "then beacons" in before.get_title()
    for ax, shown in ((before, found.baseline), (after, found)):
        drawn = [line.get_xydata() for line in ax.lines]
        assert all(any(np.array_equal(path, xy) for xy in drawn) for path in shown.paths)
        assert f"{len(shown.beacons)} beacon" in ax.get_title()
    figure.canvas.draw()
    assert plot_design(WORLD, replace(found, baseline=None), figure=Figure()).axes
