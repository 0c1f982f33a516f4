"""Route graphs of nav2's: read as they are, written back with what was added and nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import floyd_warshall

from driftplan import (
    Beacon,
    BeaconKind,
    MapError,
    NoPathError,
    OdometryNoise,
    RouteGraph,
    edge_metadata,
    graph_geojson,
    graph_lif,
    graph_routes,
    load_graph,
    predict_drift,
    read_path,
)
from driftplan.report.cli import main

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
GRAPHS = ("nav2_depot/depot_graph.geojson", "nav2_route/aws_graph.geojson")
NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-4, heading_var_per_rad=1e-2)
SQUARE = RouteGraph(
    (1, 2, 3, 4),
    np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]]),
    (11, 12, 13, 14),
    np.array([[0, 1], [1, 2], [0, 3], [3, 2]]),
)


@pytest.fixture(params=GRAPHS)
def real(request):
    if not (SHARED / request.param).exists():
        pytest.skip(f"needs {request.param} in shared/data, made by others and not shipped")
    return SHARED / request.param


def test_what_others_ship_is_read_and_written_back_to_the_byte(real):
    graph = load_graph(real)
    assert graph_geojson(graph) == real.read_bytes()
    held = json.loads(real.read_text())["features"]
    assert [f["properties"]["id"] for f in held] == [*graph.node_ids, *graph.edge_ids]
    nodes = {f["properties"]["id"]: f["geometry"]["coordinates"] for f in held if f["geometry"]["type"] == "Point"}
    for feature, route in zip(held[len(nodes) :], graph.routes(), strict=True):
        assert route.tolist() == [nodes[feature["properties"][end]] for end in ("startid", "endid")]


def test_only_the_added_keys_differ(real, tmp_path):
    graph = load_graph(real)
    told = edge_metadata(graph, NOISE)
    (tmp_path / "a.geojson").write_bytes(graph_geojson(graph, told))
    again = load_graph(tmp_path / "a.geojson")
    assert list(again.metadata) == told
    held = json.loads((tmp_path / "a.geojson").read_text())
    for feature in held["features"]:
        feature["properties"].pop("metadata", None)
    assert held == json.loads(real.read_text())
    lines = (tmp_path / "a.geojson").read_text().splitlines(), real.read_text().splitlines()
    assert [a for a, b in zip(*lines, strict=True) if a != b] == [a for a in lines[0] if '"metadata"' in a]
    assert graph_geojson(again, told) == (tmp_path / "a.geojson").read_bytes()


@given(seed=st.integers(0, 1000), added=st.booleans())
@settings(max_examples=20, deadline=None)
def test_a_graph_that_was_never_in_a_file_is_read_back(seed, added, tmp_path_factory):
    rng = np.random.default_rng(seed)
    nodes, edges = int(rng.integers(2, 8)), int(rng.integers(1, 12))
    metadata = tuple({"speed_limit": float(v)} if v < 0.5 else {} for v in rng.random(edges))
    graph = RouteGraph(
        tuple(rng.permutation(50)[:nodes].tolist()), rng.uniform(-9, 9, (nodes, 2)),
        tuple(rng.permutation(50)[:edges].tolist()), rng.integers(0, nodes, (edges, 2)), metadata,
    )  # fmt: skip
    file = tmp_path_factory.mktemp("graph") / "a.geojson"
    more = [{"penalty": float(k)} for k in range(edges)] if added else []
    file.write_bytes(graph_geojson(graph, more))
    again = load_graph(file)
    assert (again.node_ids, again.edge_ids) == (graph.node_ids, graph.edge_ids)
    assert again.xy.tolist() == graph.xy.tolist()
    assert again.edges.tolist() == graph.edges.tolist()
    assert again.metadata == (tuple(a | b for a, b in zip(metadata, more, strict=True)) if added else metadata)


def test_the_shortest_way_is_that_of_another_method(real):
    graph = load_graph(real)
    away = np.full((len(graph.xy),) * 2, np.inf)
    for (a, b), route in zip(graph.edges.tolist(), graph.routes(), strict=True):
        away[a, b] = np.hypot(*(route[1] - route[0]))
    expected = floyd_warshall(away)[0]
    for goal in range(1, len(graph.xy), 5):
        least, shortest = graph_routes(graph, graph.node_ids[0], graph.node_ids[goal], NOISE)
        assert float(shortest.drift.length) == pytest.approx(expected[goal])
        assert least.drift.end.rms <= shortest.drift.end.rms


def test_the_way_of_least_drift_is_the_best_of_all_where_headings_matter():
    long_first, _ = graph_routes(SQUARE, 1, 3, OdometryNoise(heading_var_per_m=1e-3))
    assert long_first.nodes == (1, 2, 3)
    ways = [predict_drift(SQUARE.xy[nodes], NOISE).end.rms for nodes in ([0, 1, 2], [0, 3, 2])]
    assert graph_routes(SQUARE, 1, 3, NOISE)[0].drift.end.rms == min(ways)
    with pytest.raises(NoPathError, match="from node 3 to another node 1"):
        graph_routes(SQUARE, 3, 1, NOISE)
    with pytest.raises(ValueError, match="expected the id of a node, 1 to 4, got 9"):
        graph_routes(SQUARE, 1, 9, NOISE)


def test_edges_after_a_beacon_are_told_the_drift_since():
    tag = Beacon(BeaconKind.landmark(1.0, 0.05, 0.01), 10.0, 0.5, id="T")
    told = edge_metadata(SQUARE, NOISE, [tag])
    assert [edge["nearest_beacon"] for edge in told] == ["T"] * 4
    assert ["drift_since_beacon_m" not in edge for edge in told] == [True, False, True, True]
    assert told[1]["penalty"] == told[1]["drift_since_beacon_m"] < told[1]["rms_m"] + 0.1
    assert told[0]["penalty"] == told[0]["rms_m"]


def nav2_metadata(held: dict) -> dict:
    """As GeoJsonGraphFileLoader of nav2_route takes it: every number is a float by its point, null is an error."""

    def value(found):
        if isinstance(found, dict):
            return nav2_metadata(found)
        if isinstance(found, list):
            return [value(inner) for inner in found]
        assert isinstance(found, (bool, int, float, str)), f"failed to convert {found}"
        return found

    return {name: value(found) for name, found in held.items()}


@given(seed=st.integers(0, 1000), whole=st.booleans(), seen=st.booleans())
@settings(max_examples=20, deadline=None)
def test_nav2_loads_what_is_written(seed, whole, seen):
    """What its loader asks for: nodes and edges with ids of their own, edges between known nodes; its PenaltyScorer
    asks for a float."""
    rng = np.random.default_rng(seed)
    graph = RouteGraph.of_routes([rng.integers(0, 9, (4, 2)).astype(float) for _ in range(3)])
    tags = [Beacon(BeaconKind.rfid(1.5, 0.05), *graph.xy[0], id="T")] if seen else []
    told = [{"penalty": 3, "shift": 2}] * len(graph.edges) if whole else edge_metadata(graph, NOISE, tags)
    features = json.loads(graph_geojson(graph, told))["features"]
    nodes = [f for f in features if f["geometry"]["type"] == "Point"]
    edges = [f for f in features if f["geometry"]["type"] in ("LineString", "MultiLineString")]
    assert nodes
    assert edges
    ids = [f["properties"]["id"] for f in (*nodes, *edges)]
    assert all(type(number) is int and 0 <= number < 2**32 for number in ids)
    assert len({*ids}) == len(ids)
    for edge in edges:
        held = edge["properties"]
        assert {held["startid"], held["endid"]} <= {f["properties"]["id"] for f in nodes}
        assert type(nav2_metadata(held["metadata"])["penalty"]) is float


def test_metadata_that_nav2_does_not_read_are_refused():
    with pytest.raises(ValueError, match=r"expected metadata that nav2 reads, .* got None in"):
        graph_geojson(SQUARE, [{"penalty": None}] * 4)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: f[0]["properties"].pop("id"), "feature 1: expected a Point with an id"),
        (lambda f: f[0]["properties"].update(id="1"), "feature 1: expected a Point with an id"),
        (lambda f: f[1]["properties"].update(id=1), "feature 2: the id 1 occurs twice"),
        (lambda f: f[5]["properties"].update(endid=9), "edge 12 leads to node 9, which is not there"),
        (lambda f: f[4]["properties"].update(metadata=[1]), "feature 5: expected metadata by their names"),
        (lambda f: f.__delitem__(slice(4, None)), "expected a graph of nodes and edges, got 4 nodes and no edges"),
        (lambda f: f[0]["geometry"].update(coordinates=[1e300, 0]), "feature 1: expected positions"),
        (lambda f: f.append(3), "feature 9: expected a Feature, got 3"),
    ],
)
def test_what_is_no_graph_is_refused_by_its_feature(tmp_path, change, said):
    held = json.loads(graph_geojson(SQUARE))
    change(held["features"])
    (tmp_path / "a.geojson").write_text(json.dumps(held))
    with pytest.raises(MapError, match=said):
        load_graph(tmp_path / "a.geojson")


def test_the_command_writes_penalties_and_finds_the_way(tmp_path, capsys):
    (tmp_path / "g.geojson").write_bytes(graph_geojson(SQUARE))
    words = ["graph", str(tmp_path / "g.geojson"), "--start-node", "1", "--goal-node", "3"]
    assert main([*words, "--geojson", str(tmp_path / "out.geojson"), "--csv", str(tmp_path / "way.csv"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    written = load_graph(tmp_path / "out.geojson").metadata
    assert [edge["penalty"] for edge in told["edges"]] == [edge["penalty"] for edge in written]
    assert told["routes"]["lowest drift"]["nodes"] == [1, 2, 3]
    assert (tmp_path / "way.csv").read_text().splitlines()[2:] == ["0.0,0.0", "10.0,0.0", "10.0,8.0"]
    assert main(words) == 0
    assert "lowest drift: 18.00 m by 1 2 3" in capsys.readouterr().out
    assert main(words[:4]) == 2


def test_a_plan_on_a_graph_is_between_the_nodes_nearest_to_its_ends(tmp_path, capsys):
    graph = RouteGraph.of_routes(
        [np.array([[2.0, 2.0], [30.0, 2.0], [30.0, 9.0]]), np.array([[30.0, 2.0], [50.0, 2.0]])]
    )
    assert sorted(map(tuple, graph.xy.tolist())) == [(2, 2), (30, 2), (30, 9), (50, 2)]
    (tmp_path / "a.lif").write_bytes(graph_lif(graph))
    words = ["plan", "warehouse", "--graph", str(tmp_path / "a.lif"), "--start", "2.3,2.4", "--goal", "30,8"]
    assert main([*words, "--csv", str(tmp_path / "way.csv"), "--json"]) == 0
    out, err = capsys.readouterr()
    assert "start is node 0 at (2, 2), 0.5 m away" in err
    assert [way["nodes"] for way in json.loads(out)["routes"].values()] == [["0", "1", "2"]] * 2
    assert read_path(tmp_path / "way.csv").tolist() == [[2, 2], [30, 2], [30, 9]]
    for more, said in (
        (["--planner", "bitstar"], "--planner would have no effect: a way on a --graph is found without"),
        (["--geojson", str(tmp_path / "g.geojson")], "`driftplan graph` writes the graph back"),
        (["--start", "50,2"], "no edges of the graph lead from node 3"),
    ):
        assert main([*words, *more]) in (2, 3)
        assert said in capsys.readouterr().err
