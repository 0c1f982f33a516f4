"""Tables, JSON and files: what scripts read must be what the library computed, and whole."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from driftplan.files import write_files
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise
from driftplan.report.records import drift_geojson, drift_table, json_text, path_csv
from driftplan.world.route_files import read_path

NOISE = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.1, after_m=10.0)
DRIFT = predict_drift([(0, 0), (10, 0), (10, -7.5)], NOISE)


def test_csv_keeps_every_digit(tmp_path):
    drift = predict_drift(np.random.default_rng(0).normal(size=(5, 2)), NOISE)
    (tmp_path / "path.csv").write_bytes(path_csv(drift))
    np.testing.assert_array_equal(read_path(tmp_path / "path.csv"), drift.xy)


def test_json_objects_are_the_drift_at_each_point():
    points = DRIFT.to_dicts()
    assert [p["radius95_m"] for p in points] == DRIFT.radius(0.95).tolist()
    assert [p["heading_std_rad"] for p in points] == DRIFT.heading_std.tolist()
    assert [[p["bias_x_m"], p["bias_y_m"]] for p in points] == DRIFT.bias.tolist()
    assert all(name.rsplit("_", 1)[1] in ("m", "m2", "rad") for name in points[0])


def test_what_is_not_finite_becomes_null():
    lost = predict_drift(
        [(0, 0), (1e6, 0)], NOISE
    )  # heading error of thousands of rad: its circular deviation is infinite
    assert math.isinf(lost.end.heading_std)
    text = json_text({"points": lost.to_dicts(), "nan": math.nan})
    assert json.loads(text)["points"][1]["heading_std_rad"] is None
    assert json.loads(text)["nan"] is None


def test_the_table_shows_degrees_and_lines_its_columns_up():
    lines = drift_table(DRIFT).splitlines()
    header = "distance m  x m  y m  rms m  bias m  95 % radius m  heading std deg"
    assert lines[0].split() == header.split()
    assert len({len(line) for line in lines}) == 1
    assert float(lines[-1].split()[3]) == pytest.approx(DRIFT.end.rms, rel=1e-3)
    assert float(lines[-1].split()[-1]) == pytest.approx(np.degrees(DRIFT.end.heading_std), rel=1e-2)


def test_the_table_of_a_long_path_shows_some_rows_and_says_of_how_many():
    drift = predict_drift([(0.5 * k, 0) for k in range(65)], NOISE)
    _, *rows, last = drift_table(drift).splitlines()
    assert [float(row.split()[0]) for row in (rows[0], rows[-1])] == [0.0, 32.0]
    assert len(rows) == 15
    assert last == "50 more points are not shown: --json has them all"
    assert len(drift_table(drift, most=65).splitlines()) == 66
    assert len(drift_table(drift.at([1.0, 2.0])).splitlines()) == 3


def test_a_geojson_route_is_a_line_in_metres_with_its_drift():
    collection = json.loads(drift_geojson(DRIFT, {"planner": "none"}))
    (feature,) = collection["features"]
    assert feature["geometry"] == {"type": "LineString", "coordinates": DRIFT.xy.tolist()}
    assert feature["properties"]["rms_m"] == DRIFT.rms.tolist()
    assert feature["properties"]["planner"] == "none"


def test_files_are_written_all_or_none(tmp_path):
    good, bad = tmp_path / "a.csv", tmp_path / "missing" / "b.csv"
    good.write_bytes(b"old")
    with pytest.raises(FileNotFoundError):
        write_files({good: b"new", bad: b"new"})
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]
    assert good.read_bytes() == b"old"
    write_files({good: b"new"})
    assert good.read_bytes() == b"new"
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]
