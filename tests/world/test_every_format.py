"""Every format of the guide's table has an example, which is read as the table says."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas
import pytest

import driftplan as d
from driftplan.beacons import beacon_files
from driftplan.files import VERSION, head
from driftplan.report.cli import main
from driftplan.world import mapfiles, route_files, route_graphs, zone_files

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
TABLE = [
    [cell.strip() for cell in line.strip("|\n").split("|")]
    for line in (EXAMPLES / "guide/formats.md").read_text().splitlines()
    if line.startswith("|")
][2:]
KIND = d.BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
READERS = {
    "load_world": lambda file: d.load_world(file, robot_radius=0.3, **OPTIONS.get(file.name, {})),
    "load_zones": d.load_zones,
    "load_graph": d.load_graph,
    "load_beacons": lambda file: d.load_beacons(file, KIND),
    "read_path": d.read_path,
    "load_noise": d.load_noise,
    "read_odometry": d.read_odometry,
    "read_truth": d.read_truth,
}
OPTIONS = {"hall.imdf": {"origin": (11.5, 48.1)}, "hall.map": {"cell_size_m": 0.2}}
OF_ONE_KIND = {"hall.building.yaml": "load_beacons", "poses.csv": "read_path"}  # an example of the others in its row


def names(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row[0])
def test_every_format_has_an_example_that_is_read_as_the_table_says(row):
    if ".dxf" in row[1]:
        pytest.importorskip("ezdxf")
    for example in names(row[1]):
        file = (EXAMPLES / "data/formats" / example).resolve()
        assert file.stat().st_size > 0
        for reader in {name.partition("(")[0] for name in names(row[2])}:
            if file.suffix == ".pgm" or OF_ONE_KIND.get(example) == reader:
                continue
            assert READERS[reader](file) is not None
    for writer in names(row[3]):
        assert "driftplan " in writer or hasattr(d, writer) or hasattr(beacon_files, writer)


NO_PLACE = {"hall.map", "map.txt", "hall.pgm", "speed.pgm"}  # for a version or a frame, in these formats
OF_OTHERS = {"hall.building.yaml", "hall.imdf", "speed.yaml", "layout.building.yaml"}  # not written, or only added to


@pytest.mark.parametrize("file", sorted((EXAMPLES / "data/formats").iterdir()), ids=lambda file: file.name)
def test_every_file_says_its_version_and_its_frame(file):
    text = file.read_bytes().decode("latin-1")
    if file.name in NO_PLACE | OF_OTHERS:
        assert "driftplan file" not in text
        return
    if file.suffix == ".csv" and file.name != "poses.csv":
        rows = pandas.read_csv(file)
        assert ({*rows["frame"]}, {*rows["version"]}) == ({"map"}, {VERSION})
    elif file.suffix == ".lif":
        assert ('"lifVersion": "1.0.0"' in text, '"mapId": "map"' in text) == (True, True)
    elif file.suffix == ".geojson":
        assert (held := json.loads(text)["driftplan"])["version"] == VERSION
        assert held["frame"] == "map"
    else:
        frame = "of the robot" if file.name == "noise.yaml" else "map"
        assert f"driftplan file version {VERSION}, frame {frame}, metres" in text


def test_the_page_writes_the_same_version_and_frame():
    text = Path(d.__file__).with_name("page").joinpath("files.js").read_text()
    assert head("of the robot").strip() in text
    assert f'"driftplan": {{"version": {VERSION}, "frame": "map"}}' in text


def test_other_tools_pass_over_the_head_of_a_table(tmp_path):
    table = pandas.read_csv(EXAMPLES / "data/formats/poses.csv", comment="#")
    assert table.shape[1] == 9
    assert np.isfinite(table.to_numpy(dtype=float)).all()
    assert main(["plan", "warehouse", "--start", "3,3", "--goal", "20,3", "--iterations", "1",
                 "--csv", str(tmp_path / "way.csv")]) == 0  # fmt: skip
    way = pandas.read_csv(tmp_path / "way.csv", comment="#")
    assert d.read_path(tmp_path / "way.csv").tolist() == way[["x_m", "y_m"]].to_numpy().tolist()


def test_the_hall_is_the_same_in_every_format_of_maps():
    folder = EXAMPLES / "data/formats"
    places = np.random.default_rng(0).uniform((0, 0), (8, 6), (300, 2))
    drawn = d.load_world(folder / "hall.geojson", robot_radius=0.3)
    for name in ("hall.yaml", "hall.map"):
        world = READERS["load_world"](folder / name)
        assert world.bounds == pytest.approx((0, 0, 8, 6))
        assert (world.is_free(places) == drawn.is_free(places)).mean() > 0.99
    assert READERS["load_world"](folder / "hall.imdf").bounds == pytest.approx((0, 0, 8, 6), abs=2e-3)


def test_every_format_of_the_registries_is_in_the_table():
    suffixes = {s for cell in (row[1] for row in TABLE) for name in names(cell) for s in Path(name).suffixes}
    for registry in (mapfiles, zone_files, route_files, route_graphs, beacon_files):
        for form in registry.FORMATS:
            assert any(s.endswith(Path(f"a{suffix}").suffix) for suffix in form.suffixes for s in suffixes), form.name


def test_beacons_of_the_examples_are_the_same_in_every_file():
    expected = [(4.1, 2.8), (8.0, 3.0)]
    for name in ("tags.geojson", "tags.yaml", "map.txt", "layout.lif", "layout.building.yaml"):
        found = d.load_beacons(EXAMPLES / "data/formats" / name, KIND)
        np.testing.assert_allclose([b.xy for b in found[:2]], expected, atol=1e-6)


def test_the_command_writes_everything_for_installers_and_fleets(tmp_path, capsys):
    pytest.importorskip("ezdxf")
    hall, route = EXAMPLES / "data/formats/hall.building.yaml", tmp_path / "route.csv"
    route.write_text("x,y\n1,-5\n7,-5\n")
    files = {"pdf": "a.pdf", "table": "a.html", "lif": "a.lif", "dxf": "a.dxf", "building": "a.building.yaml"}
    words = [word for option, name in files.items() for word in (f"--{option}", str(tmp_path / name))]
    assert (
        main(["place", str(hall), str(route), "--max-drift", "0.3", "--heading-deg", "10", "--spacing-m", "1", *words])
        == 0
    )
    assert "routes served" in capsys.readouterr().out
    found = [d.load_beacons(tmp_path / name, KIND) for name in ("a.lif", "a.dxf", "a.building.yaml")]
    assert len(found[0]) > 0
    for others in found[1:]:
        np.testing.assert_allclose([b.xy for b in others], [b.xy for b in found[0]], atol=1e-6)
    assert main(["place", "warehouse", str(EXAMPLES / "data/route.csv"), "--max-drift", "0.9", *words[-2:]]) == 2
    assert "--building writes the building of an Open-RMF map back, and MAP is warehouse" in capsys.readouterr().err
