"""The options of `driftplan plan` about beacons: what is asked is what is planned, and all of it is said."""

import json
import math

import pytest

from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.beacon_files import beacons_geojson
from driftplan.model.noise import OdometryNoise
from driftplan.report.cli import build_parser
from driftplan.report.commands.plan import itinerary_as_json, itinerary_text, planned_route
from driftplan.world.world import World

NOISE = OdometryNoise.from_std(heading_deg=3.0, distance_m=0.1, after_m=10.0)
SIGN = BeaconKind.landmark(range_m=3.0, position_std_m=0.05, heading_std=0.01)
HALL = World.from_polygons([], bounds=(0, 0, 60, 40), robot_radius=0.5)
BEACONS = [Beacon(SIGN, 18, 17, id="A"), Beacon(SIGN, 30, 18, id="B"), Beacon(SIGN, 42, 17, id="C")]


def asked(*words):
    return build_parser().parse_args(["plan", "hall", "--start", "3,10", "--goal", "57,10", *words])


def test_beacons_from_a_file_hold_the_limit_that_is_asked_for(tmp_path):
    file = tmp_path / "layout.geojson"
    file.write_bytes(beacons_geojson(BEACONS))
    words = ("--beacons", str(file), "--max-drift", "1.8", "--minimise", "length", "--time-limit", "600")
    route = planned_route(asked(*words), HALL, NOISE)
    assert route.worst_drift <= route.max_drift == 1.8
    said = json.loads(json.dumps(itinerary_as_json(route)))
    assert said["worst_drift_m"] == route.worst_drift
    assert {row["beacon"] for row in said["passes"] if row["counted_on"]} == {b.id for b in route.beacons}
    text = itinerary_text(route)
    assert "(limit 1.8 m)" in text
    assert all(f"\n{b.id} " in text for b in route.beacons)


def test_what_matters_with_beacons_only_is_accepted_without():
    assert not planned_route(asked("--time-limit", "0.2", "--redundancy", "2"), HALL, NOISE).captures


def test_a_start_that_is_not_known_well_is_said_in_metres_and_degrees(tmp_path):
    file = tmp_path / "layout.geojson"
    file.write_bytes(beacons_geojson(BEACONS))
    words = ("--beacons", str(file), "--minimise", "length", "--time-limit", "600")
    known = planned_route(asked(*words), HALL, NOISE)
    unsure = planned_route(asked(*words, "--start-position-std-m", "0.3", "--start-heading-std-deg", "2"), HALL, NOISE)
    assert float(known.drift.rms[0]) == 0
    assert float(unsure.drift.rms[0]) == pytest.approx(0.3 * 2**0.5)
    assert float(unsure.drift.at(0.0).heading_std) == pytest.approx(math.radians(2), rel=1e-3)
    alone = planned_route(asked("--start-position-std-m", "0.3", "--time-limit", "0.2"), HALL, NOISE)
    assert float(alone.drift.rms[0]) == pytest.approx(0.3 * 2**0.5)


def test_many_trips_are_planned_in_one_go(run, refused, tmp_path):
    trips = tmp_path / "trips.csv"
    trips.write_text("start_x,start_y,goal_x,goal_y\n2,3,30,16\n30,16,2,3\n")
    code, out, err = run("plan", "office", "--trips", trips, "--minimise", "length", "--json")
    assert code == 0, err
    rows = json.loads(out)["routes"]
    assert [[*row["waypoints"][0].values()] for row in rows] == [[2, 3], [30, 16]]
    assert rows[0]["length_m"] == pytest.approx(rows[1]["length_m"], rel=0.01)
    assert all(row["collision_free"] for row in rows)
    refused(
        "plan", "office", "--trips", trips, "--csv", tmp_path / "x.csv", match="--csv would have no effect: .*--trips"
    )
    refused("plan", "office", "--trips", trips, "--start", "1,1", match="--start would have no effect: .*--trips")
    trips.write_text("2,3,30,16\n2,3,999,999\n")
    refused(
        "plan",
        "office",
        "--trips",
        trips,
        match=r"trip 1: goal \(999, 999\) is off the map, which spans x 0 to 40 and y",
    )
    code, out, err = run("plan", "office", "--trips", trips, "--minimise", "length", "--snap", "--json")
    assert code == 0, err
    assert "trip 1: goal (999, 999) is off the map, which spans x 0 to 40 and y 0 to 24 m: moved" in err
    assert json.loads(out)["routes"][1]["waypoints"][-1]["x_m"] < 40
