"""DXF drawings: walls in, worlds and layouts out, for which ezdxf itself finds no fault."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest
import shapely

from driftplan import (
    Beacon,
    BeaconKind,
    MapError,
    OdometryNoise,
    Sites,
    World,
    layout_dxf,
    load_world,
    place_beacons,
    save_world,
)
from driftplan.world.dxf_map import drawing_of
from driftplan.world.formats import Mark

ezdxf = pytest.importorskip("ezdxf")
ROOM = World.from_polygons([shapely.box(2, 1, 3, 4), shapely.box(6, 2, 7, 6)], bounds=(0, 0, 10, 6), robot_radius=0.25)


def read(content):
    return ezdxf.read(io.StringIO(content.decode()))


def test_walls_that_were_drawn_are_read_back(tmp_path):
    (tmp_path / "a.dxf").write_bytes(drawing_of(ROOM))
    world = load_world(tmp_path / "a.dxf", robot_radius=0.25)
    assert world.obstacles.equals(ROOM.obstacles.buffer(0.025, join_style="mitre", cap_style="square")) or (
        world.obstacles.symmetric_difference(ROOM.obstacles.buffer(0.025, join_style="mitre")).area < 1e-9
    )
    assert world.bounds == pytest.approx((2 - 0.525, 1 - 0.525, 7.525, 6.525))
    assert world.notes == ()


@pytest.mark.parametrize(("unit", "metres"), [(1, 0.0254), (2, 0.3048), (4, 0.001), (5, 0.01), (6, 1.0)])
def test_units_of_the_header_count(tmp_path, unit, metres):
    drawing = ezdxf.new("R2010", units=unit)
    drawing.modelspace().add_line((0, 0), (8 / metres, 0))
    drawing.modelspace().add_lwpolyline([(0, 2 / metres), (8 / metres, 2 / metres)])
    drawing.modelspace().add_text("office")
    drawing.saveas(tmp_path / "a.dxf")
    world = load_world(tmp_path / "a.dxf", robot_radius=0.1)
    assert world.bounds == pytest.approx((-0.525, -0.525, 8.525, 2.525))
    assert world.is_free([[4, 1], [4, 0]]).tolist() == [True, False]
    assert "passed over TEXT: only lines and polylines are walls" in world.notes[0]


def test_layers_that_are_off_are_no_walls(tmp_path):
    drawing = ezdxf.new("R2010", units=6)
    drawing.layers.add("FURNITURE").off()
    drawing.modelspace().add_line((0, 0), (8, 0))
    drawing.modelspace().add_line((4, 0), (4, 3), dxfattribs={"layer": "FURNITURE"})
    drawing.saveas(tmp_path / "a.dxf")
    assert load_world(tmp_path / "a.dxf", robot_radius=0.1).obstacles.bounds[3] < 0.1


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not a readable DXF drawing"),
        (b"hello", "not a readable DXF drawing"),
        (np.random.default_rng(0).bytes(3000), "not a readable DXF drawing"),
    ],
)
def test_what_is_no_drawing_is_refused(tmp_path, content, said):
    (tmp_path / "a.dxf").write_bytes(content)
    with pytest.raises(MapError, match=said):
        load_world(tmp_path / "a.dxf", robot_radius=0.1)


def test_drawings_without_units_or_walls_are_refused(tmp_path):
    for units, said in ((0, r"\$INSUNITS 0: set its units"), (6, "expected lines or polylines, got nothing")):
        ezdxf.new("R2010", units=units).saveas(tmp_path / "a.dxf")
        with pytest.raises(MapError, match=said):
            load_world(tmp_path / "a.dxf", robot_radius=0.1)
    with pytest.raises(ValueError, match=r"DXF maps are read only: save it as \.geojson"):
        save_world(ROOM, tmp_path / "b.dxf")


def test_marks_have_their_places_names_and_directions():
    mark = Mark("A1", 1.0, 2.0, 90.0)
    drawing = read(
        drawing_of(None, [np.array([[0.0, 0.0], [5.0, 0.0]])], [mark], [(1.0, 2.0, 1.5)], [((0.0, 2.0), (1.0, 2.0))])
    )
    assert drawing.audit().errors == []
    model = drawing.modelspace()
    (circle,), (line,), (text,) = (model.query(f'{kind}[layer=="BEACONS"]') for kind in ("CIRCLE", "LINE", "TEXT"))
    assert (circle.dxf.center.vec2, circle.dxf.radius) == ((1.0, 2.0), 1.5)
    assert line.dxf.end.vec2.isclose((1.0, 3.0))
    assert text.dxf.text == "A1 (1.00, 2.00)"


def test_a_layout_is_drawn_with_every_beacon():
    noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    tag = BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    old = Beacon(tag, 5.0, 0.5, id="old")
    layout = place_beacons(None, [[(0, 0), (30, 0)]], noise, 0.8, Sites(tag, spacing_m=2.0, existing=[old]))
    points = read(layout_dxf(layout)).modelspace().query("POINT")
    assert {tuple(p.dxf.location.vec2) for p in points} == {tuple(b.xy) for b in (old, *layout.beacons)}


def test_without_the_library_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    (tmp_path / "a.dxf").write_bytes(b"")
    with pytest.raises(ImportError, match=r"DXF drawings need ezdxf: pip install driftplan\[dxf\]"):
        load_world(tmp_path / "a.dxf", robot_radius=0.1)
