"""driftplan design: its answer, its files, its figure, its words; and trips from files."""

import argparse
import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from driftplan.beacons.beacon import BeaconKind
from driftplan.errors import InfeasibleError, TrajectoryError
from driftplan.layouts.co_design.co_design import co_design
from driftplan.layouts.co_design.trips import Trip, load_trips
from driftplan.layouts.layout_files import load_beacons
from driftplan.layouts.sites import Sites
from driftplan.model.noise import OdometryNoise
from driftplan.report.design_command import add_parser, design
from driftplan.report.plot_design import plot_design
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
KIND = ("--kind", "landmark", "--range-m", 2, "--position-std-m", 0.05, "--beacon-price", 100, "--spacing-m", 4)
NOISE = ("--heading-deg", 3, "--distance-m", 0.05)


@pytest.fixture
def run(tmp_path, capsys):
    """Runs the subcommand on a small map with two trips; returns stdout and stderr."""
    (tmp_path / "map.geojson").write_text(json.dumps(MAP))
    (tmp_path / "trips.csv").write_text(TRIPS)
    files = [str(tmp_path / name) for name in ("map.geojson", "trips.csv")]

    def run(*words):
        parser = argparse.ArgumentParser()
        add_parser(parser.add_subparsers(dest="command"))
        words = (
            "--max-drift",
            1.2,
            "--price-per-m",
            1,
            "--robot-radius",
            0.5,
            "--time-limit",
            600,
            *KIND,
            *NOISE,
            *words,
        )
        args = parser.parse_args(["design", *files, *(str(w) for w in words)])
        design(args)
        return capsys.readouterr()

    run.folder = tmp_path
    return run


def test_what_is_gained_is_on_stdout_and_talk_on_stderr(run):
    said = run()
    trips, *_ = said.out.split("\n\n")
    assert [line.split()[0] for line in trips.splitlines()] == ["trip", "0", "1"]
    assert "shortest routes, then beacons" in said.out
    assert "Gained: " in said.out
    assert "choosing beacons and routes for 2 trips" in said.err


def test_json_says_the_same_as_the_files(run):
    names = ("beacons.geojson", "beacons.csv", "design.png")
    files = [run.folder / name for name in names]
    said = json.loads(run("--json", "--geojson", files[0], "--csv", files[1], "--png", files[2]).out)["design"]
    beacons = load_beacons(files[0])
    assert [b.id for b in beacons] == [b["id"] for b in said["beacons"]]
    assert all(b.kind.cost == 100 for b in beacons)
    assert said["cost"] == pytest.approx(said["beacon_cost"] + said["driving_cost"])
    assert said["gain"] == pytest.approx(said["baseline"]["cost"] - said["cost"])
    assert said["driving_cost"] == pytest.approx(sum(r["weight"] * r["length_m"] for r in said["routes"]))
    assert all(r["worst_drift_m"] <= 1.2 * (1 + 1e-6) for r in said["routes"])
    assert files[1].read_text().count("\n") == 1 + len(beacons)
    assert files[2].read_bytes().startswith(b"\x89PNG")


def test_an_uncertain_start_costs_beacons(run):
    known, unsure = (
        json.loads(run("--json", *words).out)["design"]
        for words in ((), ("--start-position-std-m", 0.3, "--start-heading-std-deg", 7))
    )
    assert unsure["beacon_cost"] > known["beacon_cost"]


def test_what_cannot_be_done_is_said_and_nothing_written(run):
    file = run.folder / "beacons.geojson"
    with pytest.raises(InfeasibleError, match="trip 0: "):
        run("--max-drift", 0.06, "--geojson", file)
    assert not file.exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,2,3\n", "line 1: expected start_x, .* got 3 columns"),
        ("x,y,goal_x,goal_y\n1,2,3,4\n", "line 1: expected the columns start_x, .* got x, y"),
        ("start_x,start_y,goal_x,goal_y,goal_y\n1,2,3,4,5\n", "line 1: expected the columns"),
        ("start_x,start_y,goal_x,goal_y,weight\n1,2,3,4,0\n", "line 2: expected weight > 0"),
        ("start_x,start_y,goal_x,goal_y,weight\n1,2,3,4\n", "line 2: expected start_x, .* got 4 columns"),
        ("1,2,3,4\n\n1,2,three,4\n", "line 3: could not convert"),
        ("1,2,3,nan\n", "line 1: .*finite"),
        ("# nothing yet\n", "at least one trip"),
    ],
)
def test_trips_that_make_no_sense_are_refused_by_file_and_line(tmp_path, text, said):
    file = tmp_path / "trips.csv"
    file.write_text(text)
    with pytest.raises(TrajectoryError, match=said):
        load_trips(file)
    with pytest.raises(TrajectoryError):
        load_trips(tmp_path / "none.csv")
    with pytest.raises(TrajectoryError, match="something else"):
        load_trips(tmp_path)


def test_trips_are_read_with_and_without_header_in_any_order(tmp_path):
    file = tmp_path / "trips.csv"
    file.write_text("# from the floor manager\n1 2 3 4\n5 6 7 8\n")
    assert load_trips(file) == (Trip((1, 2), (3, 4)), Trip((5, 6), (7, 8)))
    file.write_text("weight;goal_x;goal_y;start_x;start_y\n9;3;4;1;2\n")
    assert load_trips(file) == (Trip((1, 2), (3, 4), 9),)


def test_the_figure_shows_both_designs():
    world = World.from_polygons([SHELF], bounds=(0, 0, 40, 12), robot_radius=0.5)
    noise = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.05, after_m=10.0)
    sign = BeaconKind.landmark(range_m=2.0, position_std_m=0.05, heading_std=0.01, cost=100.0)
    trips = [((2, 2), (38, 2)), ((2, 10), (38, 10))]
    sites = Sites(sign, spacing_m=4.0)
    asked = {"price_per_m": 1.0, "max_nodes": 120, "time_limit": 600.0}
    found = co_design(world, trips, noise, 1.2, sites, **asked)
    figure = plot_design(world, found)
    before, after = figure.axes
    assert "then beacons" in before.get_title()
    for ax, shown in ((before, found.baseline), (after, found)):
        drawn = [line.get_xydata() for line in ax.lines]
        assert all(any(np.array_equal(path, xy) for xy in drawn) for path in shown.paths)
        assert f"{len(shown.beacons)} beacon" in ax.get_title()
    figure.canvas.draw()
    alone = co_design(world, trips[:1], noise, 1.2, sites, **asked, rounds=0)
    assert plot_design(world, alone, figure=Figure()).axes
