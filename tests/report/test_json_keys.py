"""What ``--json`` prints has one spelling everywhere: every length, angle and time carries its unit in its key."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from driftplan import Beacon, BeaconKind
from driftplan.beacons.beacon_files import beacons_geojson
from driftplan.report.commands import COMMANDS

SAMPLES = Path(__file__).resolve().parents[2] / "examples/data"
ROOM = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"kind": kind},
            "geometry": {"type": "Polygon", "coordinates": [[[*c] for c in (*ring, ring[0])]]},
        }
        for kind, ring in (
            ("boundary", [(0, 0), (20, 0), (20, 12), (0, 12)]),
            ("obstacle", [(8, 4), (12, 4), (12, 8), (8, 8)]),
        )
    ],
}
STUDY = {
    "routes": [[[0, 0], [30, 0]]],
    "noise": {"heading_deg": 2, "distance_m": 0.05},
    "beacon": {"kind": "landmark", "range_m": 2.0, "position_std_m": 0.05, "heading_std_deg": 0.5},
    "vary": {"limit_m": [0.01, 0.7]},
}
GRAPH = SAMPLES / "formats/graph.geojson"
MARKER = ("--kind", "landmark", "--range-m", 3, "--spacing-m", 4)
ENDS = ("--start", "2,2", "--goal", "18,10")
RUNS = {
    "predict": ("path.csv",),
    "plan": ("room.geojson", *ENDS, "--iterations", 1),
    "plan --beacons": ("room.geojson", *ENDS, "--beacons", "tags.geojson", "--max-drift", 2, "--minimise", "length"),
    "plan --trips": ("room.geojson", "--trips", "trips.csv", "--time-limit", 5),
    "plan --graph": (SAMPLES / "formats/hall.geojson", "--graph", GRAPH, "--start", "1,1", "--goal", "9,5"),
    "compare": ("room.geojson", "path.csv", *ENDS, "--iterations", 1),
    "place": ("room.geojson", "path.csv", "--max-drift", 0.5, *MARKER, "--geojson", "placed.geojson"),
    "place --tradeoff": ("room.geojson", "path.csv", "--tradeoff", 2, *MARKER),
    "design": ("room.geojson", "trips.csv", "--max-drift", 1, "--price-per-m", 1, "--time-limit", 2, *MARKER),
    "fit": (SAMPLES / "drive1_odometry.csv", SAMPLES / "drive1_truth.csv"),
    "graph": (GRAPH, "--beacons", "tags.geojson"),
    "study check": ("check", "study.yaml"),
    "study run": ("run", "study.yaml"),
    "maps": (),
    "examples": ("samples",),
    "completion": ("bash",),
}
ELSEWHERE = {  # what has no rows of its own
    *("studio", "demo"),  # the one serves a page until it is ended, the other has rows of compare and place
    "selftest",  # says in words what its numbers are
}
UNIT = re.compile(r"_(m|m2|s|rad|rad2|deg|percent)$|_per_(m|rad|step)$|^seconds$")
NO_UNIT = {
    *("beacons", "breaks", "cell", "cells", "done", "failed", "infeasible", "missing", "obstacles", "out of time"),
    *("odometry_outliers", "odometry_samples", "repeated_samples", "restarts", "rounds", "segments", "truth_outliers"),
    *("truth_samples", "zones", "independent"),  # they are counted
    *("beacon_cost", "cost", "driving_cost", "gain", "lower_bound", "penalty", "weight"),  # in the user's currency
    *("confidence", "coverage", "coverage_error", "mean_nees", "distance_scale_error", "distance_scale_std"),  # ratios
    *("measured_heading_rms", "predicted_heading_rms", "probability"),  # the first two of a sine
    *("id", "nodes", "start", "goal", "reasons", "routes", "worst_route"),  # names: of nodes, cells and routes
    *("x", "low", "middle", "high"),  # of the answers of a study, which say what they are along and of
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("json")
    (folder / "room.geojson").write_text(json.dumps(ROOM))
    (folder / "study.yaml").write_text(json.dumps(STUDY))
    tag = BeaconKind.landmark(range_m=3.0, position_std_m=0.1, heading_std=0.02)
    (folder / "tags.geojson").write_bytes(beacons_geojson([Beacon(tag, 6.0, 3.0), Beacon(tag, 17.0, 6.0)]))
    (folder / "path.csv").write_text("2,2\n18,2\n18,10\n")
    (folder / "trips.csv").write_text("start_x,start_y,goal_x,goal_y\n2,2,18,2\n2,10,18,10\n")
    return folder


def numbers_by_key(value, key=""):
    """Every key under which there is a number, or a list of them."""
    if isinstance(value, dict):
        return {k for name, item in value.items() for k in numbers_by_key(item, name)}
    if isinstance(value, list):
        return {k for item in value for k in numbers_by_key(item, key)}
    return {key} if isinstance(value, (int, float)) and not isinstance(value, bool) else set()


@pytest.mark.parametrize("name", RUNS)
def test_every_number_says_its_unit(name, folder, run, monkeypatch):
    monkeypatch.chdir(folder)
    answer = run(name.split()[0], *RUNS[name], "--json")
    assert answer.code == 0, answer.err
    assert {key for key in numbers_by_key(json.loads(answer.out)) if not UNIT.search(key)} <= NO_UNIT


def test_every_subcommand_is_looked_at():
    assert {name.split()[0] for name in RUNS} | ELSEWHERE == set(COMMANDS)
