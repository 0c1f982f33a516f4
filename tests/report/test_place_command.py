"""driftplan place: its answer, its files, its words."""

import json
import re
from math import radians

import pytest

from driftplan.beacons.beacon import BeaconKind
from driftplan.beacons.beacon_files import load_beacons
from driftplan.report.cli import build_parser
from driftplan.report.commands.shared import kind_from

MAP = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"kind": "boundary"},
            "geometry": {"type": "Polygon", "coordinates": [[[0, 0], [40, 0], [40, 10], [0, 10], [0, 0]]]},
        },
        {
            "type": "Feature",
            "properties": {"kind": "obstacle"},
            "geometry": {"type": "Polygon", "coordinates": [[[5, 3], [35, 3], [35, 7], [5, 7], [5, 3]]]},
        },
    ],
}


@pytest.fixture
def files(tmp_path):
    """A small map with two routes."""
    (tmp_path / "map.geojson").write_text(json.dumps(MAP))
    (tmp_path / "a.csv").write_text("x,y\n1,1.5\n39,1.5\n39,8.5\n")
    (tmp_path / "b.csv").write_text("x,y\n39,8.5\n1,8.5\n")
    return [tmp_path / name for name in ("map.geojson", "a.csv", "b.csv")]


@pytest.fixture
def place(files, run):
    """Runs the subcommand; gives what it printed, and the exit code."""
    return lambda *words: run("place", *files, *words)


def test_a_table_and_a_sentence_on_stdout_and_talk_on_stderr(place):
    said = place("--max-drift", 0.5)
    routes, beacons, words = said.out.strip().split("\n\n")
    assert [line.split()[0] for line in routes.splitlines()] == ["route", "0", "1"]
    assert "routes served" in beacons.splitlines()[0]
    first = beacons.splitlines()[1].split()[0]
    assert f"The failure that hurts most is that of {first}" in words
    assert "Proven optimal." in said.out
    assert "placing beacons for 2 routes" in said.err
    assert "placing" not in said.out


def test_with_a_confidence_it_is_the_radius_that_is_told(place):
    said = place("--max-drift", 1.0, "--confidence", 0.9, "--kind", "landmark", "--spacing-m", 3).out
    assert "worst 90 % radius m" in said
    assert "90 % radius if dead m" in said
    assert "drift" not in said


def test_json_says_the_same_as_the_files(place, tmp_path):
    csv, geojson, png = (tmp_path / f"layout.{kind}" for kind in ("csv", "geojson", "png"))
    said = json.loads(
        place("--max-drift", 0.5, "--kind", "landmark", "--json", "--csv", csv, "--geojson", geojson, "--png", png).out
    )
    layout = said["layout"]
    assert said["command"] == "place"
    assert layout["proven"] is True
    assert layout["cost"] == layout["lower_bound"] == len(layout["beacons"])
    assert all(route["worst_drift_m"] <= route["limit_m"] == 0.5 for route in layout["routes"])
    beacons = load_beacons(geojson)
    assert {b.id for b in beacons} == {b["id"] for b in layout["beacons"]}
    assert {b.kind.name for b in beacons} == {"landmark"}
    assert csv.read_text().count("\n") == 1 + len(beacons)
    assert png.read_bytes().startswith(b"\x89PNG")


def test_a_layout_can_be_extended_by_a_stricter_limit(place, tmp_path):
    first = tmp_path / "first.geojson"
    place("--max-drift", 0.8, "--geojson", first)
    more = json.loads(place("--max-drift", 0.5, "--existing", first, "--spacing-m", 2, "--json").out)["layout"]
    assert sum(not b["new"] for b in more["beacons"]) == len(load_beacons(first))
    assert more["cost"] == sum(b["new"] for b in more["beacons"]) > 0


def test_the_trade_off_is_a_table_json_and_a_picture(place, tmp_path):
    png = tmp_path / "curve.png"
    table = place("--tradeoff", 2, "--spacing-m", 3, "--png", png).out
    assert table.splitlines()[0].split()[0] == "beacons"
    assert png.read_bytes().startswith(b"\x89PNG")
    curve = json.loads(place("--tradeoff", 2, "--spacing-m", 3, "--json").out)["tradeoff"]
    drifts = [point["worst_drift_m"] for point in curve]
    assert drifts == sorted(drifts, reverse=True)
    assert len(table.splitlines()) == 1 + len(curve)


def test_a_number_of_beacons_without_a_limit_asks_for_the_least_drift(place):
    said = json.loads(place("--max-beacons", 2, "--spacing-m", 3, "--json").out)["layout"]
    assert len(said["beacons"]) <= 2
    assert 0 < said["drift_bound_m"] <= said["worst_drift_m"]


@pytest.mark.parametrize("sites", ["walls", "routes"])
def test_sites_may_be_on_walls_or_routes(place, sites):
    said = json.loads(place("--max-drift", 0.5, "--sites", sites, "--range-m", 2, "--json").out)["layout"]
    distance = [b["nearest_wall_m"] for b in said["beacons"]]
    assert all((d < 1e-9) == (sites == "walls") for d in distance)


def test_candidates_may_be_points_or_beacons_with_kinds_of_their_own(place, tmp_path):
    points, beacons = tmp_path / "points.csv", tmp_path / "beacons.geojson"
    points.write_text("x,y\n" + "".join(f"{x},{y}\n" for x in range(2, 40, 3) for y in (1.5, 8.5)))
    place(
        "--max-drift", 0.6, "--candidates", points, "--kind", "landmark", "--heading-std-deg", 0.5, "--geojson", beacons
    )
    chosen = load_beacons(beacons)
    assert all((b.x - 2) % 3 == 0 for b in chosen)
    again = json.loads(place("--max-drift", 0.6, "--candidates", beacons, "--json").out)["layout"]
    assert {b["id"] for b in again["beacons"]} == {b.id for b in chosen}


def test_what_cannot_be_done_has_an_exit_code_of_its_own(refused, files):
    refused("place", *files, "--max-drift", 0.12, "--range-m", 0.6, match="route 0, from", code=3)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "--max-drift, or --max-beacons or --budget for"),
        (("--max-drift", -1), "expected --max-drift finite and > 0"),
        (("--max-drift", 1, "--tradeoff", 3), "expected --tradeoff or --max-drift, got both"),
        (("--tradeoff", 3, "--tags", "-"), "expected --tradeoff or --tags, got both"),
        (("--tag-size-m", 1, "--max-drift", 1), "--tag-size-m would have no effect: no --tags are written"),
        (("--max-drift", 1, "--candidates", "x.csv", "--sites", "walls"), "expected --candidates, or --sites"),
        (("--max-drift", 1, "--range-m", 0), "expected --range-m > 0"),
    ],
)
def test_bad_input_is_refused(refused, files, words, said):
    refused("place", *files, *words, match=said)


def test_a_robot_that_fuses_needs_fewer_and_both_answers_say_what_it_has(place):
    words, counts = ("--max-drift", 0.5, "--heading-deg", 3, "--distance-m", 0.05, "--after-m", 10), []
    for estimator in ("reset", "filter"):
        layout = json.loads(place(*words, "--estimator", estimator, "--json").out)["layout"]
        assert layout["estimator"] == estimator
        assert ("fuses its readings would drift at most" in layout["note"]) == (estimator == "reset")
        counts.append(len(layout["beacons"]))
    assert counts[1] < counts[0]


def test_radios_are_for_robots_with_a_filter(place, refused, files):
    words = ("--max-drift", 0.5, "--kind", "range_only", "--std-per-m", 0.01, "--spacing-m", 5)
    refused("place", *files, *words, match="expected --estimator filter")
    layout = json.loads(place(*words, "--estimator", "filter", "--json").out)["layout"]
    assert layout["proven"] is True
    assert {beacon["kind"] for beacon in layout["beacons"]} == {"range_only"}


def test_tags_that_are_seen_from_the_front_only_say_which_way_they_face(place, tmp_path):
    geojson = tmp_path / "tags.geojson"
    said = place(
        "--max-drift", 0.6, "--kind", "landmark", "--view-angle-deg", 120, "--spacing-m", 3, "--geojson", geojson
    )
    assert re.search(r"faces \d+°", said.out)
    assert all(b.kind.view_angle_deg == 120 and b.facing_deg % 90 == 0 for b in load_beacons(geojson))
    assert "faces" not in place("--max-drift", 0.8).out


def test_the_kind_is_the_one_that_the_library_makes():
    for words, kind in (
        ((), BeaconKind.rfid(1.5, 0.1)),
        (("--kind", "landmark", "--through-walls"), BeaconKind.landmark(1.5, 0.1, radians(1), line_of_sight=False)),
        (("--kind", "heading", "--range-m", "2"), BeaconKind.heading(2, radians(1))),
        (("--kind", "range_only", "--std-per-m", "0.01"), BeaconKind.range_only(10, 0.1, std_per_m=0.01)),
        (("--kind", "bearing", "--sensor-view-deg", "90"), BeaconKind.bearing(10, radians(1), sensor_view_deg=90)),
    ):
        assert kind_from(build_parser().parse_args(["place", "M", "P", *words])) == kind


def test_the_layout_is_written_for_detectors_and_installers(place, tmp_path):
    pytest.importorskip("ezdxf")
    names = {"tags": "tags.yaml", "fiducials": "map.txt", "transforms": "tags.sh", "dxf": "tags.dxf"}
    names["geojson"] = "t.geojson"
    words = [word for name, file in names.items() for word in (f"--{name}", tmp_path / file)]
    code, _, err = place("--max-drift", 0.5, *words)
    assert code == 0, err
    exact = load_beacons(tmp_path / "t.geojson")
    for name in ("tags.yaml", "map.txt"):
        again = load_beacons(tmp_path / name, exact[0].kind)
        assert [beacon.xy.round(6).tolist() for beacon in again] == [beacon.xy.round(6).tolist() for beacon in exact]
    assert (tmp_path / "tags.sh").read_text().count("static_transform_publisher") == len(exact)
    assert (tmp_path / "tags.dxf").read_bytes().startswith(b"  0\nSECTION")
