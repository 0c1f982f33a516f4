"""LIF: what is written keeps the schema and comes back; what is not in the schema is named."""

from __future__ import annotations

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan import Beacon, BeaconKind, MapError, RouteGraph, graph_geojson, graph_lif, load_beacons, load_graph
from driftplan.beacons.beacon_files import marks_of
from driftplan.world.formats import Mark


def objects(required: dict, **optional: dict) -> dict:
    return {"type": "object", "required": [*required], "properties": required | optional}


TEXT, NUMBER = {"type": "string"}, {"type": "number"}
ANGLE = NUMBER | {"minimum": -np.pi, "maximum": np.pi}
PLACE = {"x": NUMBER, "y": NUMBER}
TYPED = {"type": "array", "minItems": 1, "items": objects({"vehicleTypeId": TEXT})}
SCHEMA = objects(  # of LIF 1.0.0, as far as driftplan writes it, from its table of fields
    {
        "metaInformation": objects(
            {"projectIdentification": TEXT, "creator": TEXT, "lifVersion": TEXT | {"pattern": r"^1\.\d+\.\d+$"},
             "exportTimestamp": TEXT | {"pattern": r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d+Z$"}}
        ),
        "layouts": {"type": "array", "items": objects({
            "layoutId": TEXT, "layoutVersion": TEXT,
            "nodes": {"type": "array", "items": objects(
                {"nodeId": TEXT, "nodePosition": objects(PLACE), "vehicleTypeNodeProperties": TYPED}, mapId=TEXT)},
            "edges": {"type": "array", "items": objects(
                {"edgeId": TEXT, "startNodeId": TEXT, "endNodeId": TEXT,
                 "vehicleTypeEdgeProperties": TYPED | {"items": objects(
                     {"vehicleTypeId": TEXT, "rotationAllowed": {"type": "boolean"}},
                     vehicleOrientation=NUMBER, orientationType={"enum": ["GLOBAL", "TANGENTIAL"]})}},
                edgeDescription=TEXT)},
            "stations": {"type": "array", "items": objects(
                {"stationId": TEXT, "interactionNodeIds": {"type": "array", "items": TEXT}},
                stationDescription=TEXT, stationPosition=objects(PLACE, theta=ANGLE))},
        })},
    }
)  # fmt: skip
XY = np.array([[0.0, 0.0], [9.600000000000001, 0.0], [9.6, 8.0]])
GRAPH = RouteGraph((3, 5, 9), XY, (1, 1), np.array([[0, 1], [1, 2]]))  # nav2 lets ids of edges occur twice
places = st.floats(-1e4, 1e4, allow_nan=False)
marks = st.builds(Mark, st.text(min_size=1), places, places, st.none() | st.floats(-720, 720))


def written(tmp_path, content, name="a.lif"):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    return tmp_path / name


def test_what_is_written_keeps_the_schema_and_comes_back(tmp_path):
    told = [{"penalty": 0.5}, {"penalty": 1.0}]
    content = graph_lif(GRAPH, told, [Mark("A7", 1.0, 2.0, -270.0), Mark("B", 9.0, 7.0)])
    held = json.loads(content)
    jsonschema.validate(held, SCHEMA)
    assert b"9.600000000000001" not in content
    assert [edge["edgeDescription"] for edge in held["layouts"][0]["edges"]] == ["penalty 0.5", "penalty 1.0"]
    assert [s["interactionNodeIds"] for s in held["layouts"][0]["stations"]] == [["3"], ["9"]]
    again = load_graph(written(tmp_path, content))
    assert (again.node_ids, again.edge_ids, again.notes) == (("3", "5", "9"), ("0", "1"), ())
    np.testing.assert_allclose(again.xy, XY, rtol=1e-15)
    assert again.edges.tolist() == GRAPH.edges.tolist()
    assert again.node("5") == again.node(5) == 1


def test_texts_become_numbers_for_nav2(tmp_path):
    graph = load_graph(written(tmp_path, graph_lif(GRAPH)))
    (tmp_path / "a.geojson").write_bytes(graph_geojson(graph))
    again = load_graph(tmp_path / "a.geojson")
    assert (again.node_ids, again.routes()[1].tolist()) == ((0, 1, 2), [[9.6, 0.0], [9.6, 8.0]])


@settings(max_examples=10, deadline=None)
@given(st.lists(marks, min_size=1, max_size=6, unique_by=lambda mark: mark.name))
def test_beacons_come_back(tmp_path_factory, some):
    content = graph_lif(GRAPH, marks=some)
    jsonschema.validate(json.loads(content), SCHEMA)
    kind = BeaconKind.landmark(range_m=3.0, position_std_m=0.1, heading_std=0.01)
    kind = replace(kind, view_angle_deg=90.0)
    facing = [mark._replace(facing_deg=mark.facing_deg or 0.0) for mark in some]
    file = written(tmp_path_factory.mktemp("lif"), graph_lif(GRAPH, marks=facing))
    for mark, beacon in zip(facing, load_beacons(file, kind), strict=True):
        assert (beacon.id, beacon.x, beacon.y) == (mark.name, pytest.approx(mark.x), pytest.approx(mark.y))
        assert np.cos(np.radians(beacon.facing_deg - mark.facing_deg)) == pytest.approx(1)


def test_what_is_left_out_is_said(tmp_path):
    held = json.loads(graph_lif(GRAPH))
    edges = held["layouts"][0]["edges"]
    edges[0]["vehicleTypeEdgeProperties"] += [{"vehicleTypeId": "other", "trajectory": {"controlPoints": []}}]
    edges[1]["endNodeId"] = "of another layout"
    notes = load_graph(written(tmp_path, held)).notes
    assert [note.partition(": ")[2] for note in notes] == [
        "1 edges lead to other layouts, or to no node: passed over",
        "1 edges have trajectories: taken as straight",
        "edges of 2 types of vehicles are taken together",
    ]


def change(held, path, value):
    *before, last = path
    for key in before:
        held = held[key]
    if value is None:
        del held[last]
    else:
        held[last] = value


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("layouts",), None, "layouts of a file in LIF"),
        (("metaInformation", "creator"), None, "metaInformation: expected the key creator"),
        (("metaInformation", "lifVersion"), "2.0.0", "expected lifVersion 1, got '2.0.0'"),
        (("layouts", 0, "nodes"), {}, r"layouts\.0\.nodes: expected a list"),
        (
            ("layouts", 0, "nodes", 1, "nodePosition", "x"),
            "far",
            r"layouts\.0\.nodes\.1\.nodePosition\.x: expected a number",
        ),
        (("layouts", 0, "nodes", 1, "nodePosition", "x"), 1e300, r"nodePosition no greater than"),
        (("layouts", 0, "nodes", 1, "nodeId"), "3", "expected every nodeId once"),
        (
            ("layouts", 0, "nodes", 1),
            3,
            r"layouts\.0\.nodes\.1: expected keys and values \(a node with nodeId\), got 3",
        ),
        (("layouts", 0, "edges"), [], "3 nodes and no edges"),
        (("layouts",), [], "expected level to be one of"),
    ],
)
def test_what_is_not_in_the_schema_is_named(tmp_path, path, value, said):
    held = json.loads(graph_lif(GRAPH))
    change(held, path, value)
    with pytest.raises(MapError, match=rf"a\.lif: {said}" if said[0] == "e" else said):
        load_graph(written(tmp_path, held))


def test_a_layout_is_chosen_by_its_id(tmp_path):
    held = json.loads(graph_lif(GRAPH))
    held["layouts"] += [held["layouts"][0] | {"layoutId": "upstairs", "edges": held["layouts"][0]["edges"][:1]}]
    assert len(load_graph(written(tmp_path, held), level="upstairs").edges) == 1
    with pytest.raises(MapError, match="expected level to be one of map, upstairs, got None"):
        load_graph(written(tmp_path, held))


def test_stations_that_are_no_beacons_are_none(tmp_path):
    held = json.loads(graph_lif(GRAPH, marks=marks_of([Beacon(BeaconKind.rfid(1.5, 0.1), 1, 2, id="A")])))
    held["layouts"][0]["stations"][0]["stationDescription"] = "charger"
    with pytest.raises(MapError, match="expected tags with places, got none"):
        load_beacons(written(tmp_path, held), BeaconKind.rfid(1.5, 0.1))
