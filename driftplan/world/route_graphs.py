"""Route graphs: nodes, directed edges and what is known of them, of nav2's route server and of fleets.

In nav2's GeoJSON coordinates are metres of the map's frame, whatever ``crs`` the file names (nav2's own tools write
EPSG:3857). An edge is straight from its start to its end node, as nav2 drives it, whatever its geometry says. A file is
written back as it was read but for the metadata that were added to edges: ids, order, spaces and digits stay.

LIF is the layout interchange format of VDMA (version 1.0.0, March 2024). What its JSON schema asks for is asked for
here (`lif.yaml`), and nothing else. One layout is one level, named by its layoutId. Edges are taken as straight and for
every type of vehicle; beacons are stations whose description begins with "beacon".
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from math import degrees, pi, radians, remainder
from pathlib import Path
from reprlib import repr as short
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, Ints, finite, point_of, points_of
from driftplan.errors import MapError, naming
from driftplan.files import VERSION, plain_numbers, read_bytes
from driftplan.world.building_map import building_lanes
from driftplan.world.formats import Format, Mark, format_of, own_options
from driftplan.world.geojson_map import read_features
from driftplan.world.plain_data import MAX_JSON_BYTES, Place, check, read_json, read_yaml

_SPACE = " \t\r\n"
_LINES = ("LineString", "MultiLineString")
_BEACON = "beacon"  # how descriptions of stations begin


@dataclass(frozen=True, eq=False)
class RouteGraph:
    """Nodes, and directed edges between them.

    Attributes
    ----------
    node_ids : of the nodes, in the order of the file: numbers, in LIF texts
    xy : (n, 2), where the nodes are, metres
    edge_ids : of the edges
    edges : (m, 2), for every edge its start and end as indices of nodes
    metadata : of every edge, by name
    notes : what a person might not expect of the file
    text : of the file that it was read from, if that is nav2's

    >>> RouteGraph.of_routes([np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 3.0]])]).edges.tolist()
    [[0, 1], [1, 2]]
    """

    node_ids: tuple[int, ...] | tuple[str, ...]
    xy: Floats
    edge_ids: tuple[int, ...] | tuple[str, ...]
    edges: Ints
    metadata: tuple[Mapping[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    text: str = field(default="", repr=False)

    @classmethod
    def of_routes(cls, routes: Sequence[Floats]) -> RouteGraph:
        """The corners of routes, and their legs."""
        if len(routes) == 0:
            raise ValueError("expected one route or more, got none")
        paths = [points_of("a route", route) for route in routes]
        legs = np.concatenate([np.stack([path[:-1], path[1:]], axis=-2).reshape(-1, 2, 2) for path in paths])
        xy, ends = np.unique(legs.reshape(-1, 2), axis=0, return_inverse=True)
        edges = np.unique(ends.reshape(-1, 2), axis=0)
        return cls.numbered(xy, edges)

    @classmethod
    def numbered(cls, xy: Floats, edges: Ints) -> RouteGraph:
        """Nodes (n, 2) and edges (m, 2) with ids from 0: those of nav2's edges must differ from those of its nodes."""
        xy, pairs = points_of("xy", xy), finite("edges", edges, "whole numbers (m, 2)")
        if xy.ndim != 2 or pairs.ndim != 2 or pairs.shape[1] != 2 or (pairs % 1).any():
            raise ValueError(f"expected xy (n, 2) and whole numbers edges (m, 2), got {xy.shape} and {pairs.shape}")
        count = len(xy)
        return cls(tuple(range(count)), xy, tuple(range(count, count + len(pairs))), pairs.astype(np.intp))

    def node(self, name: int | str) -> int:
        """The index of the node of this id."""
        known = [*map(str, self.node_ids)]
        if str(name) not in known:
            raise ValueError(f"expected the id of a node, {min(self.node_ids)} to {max(self.node_ids)}, got {name}")
        return known.index(str(name))

    def nearest(self, xy: ArrayLike) -> int:
        """The index of the node nearest to a point (2,)."""
        return int(np.hypot(*(self.xy - point_of("xy", xy)).T).argmin())

    def routes(self) -> list[Floats]:
        """Every edge as a path (2, 2), for `predict_drift` and `place_beacons`."""
        return list(self.xy[self.edges])


def load_graph(path: str | os.PathLike[str], *, level: str | None = None) -> RouteGraph:
    """The route graph of a file: GeoJSON of nav2's, LIF, or the lanes of an Open-RMF building (of a ``level``).

    Raises MapError if the file is missing, broken, or no route graph: the message names the feature.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "graph.geojson")
    ...     graph = RouteGraph((7, 8), np.array([[0.0, 0.0], [5.0, 0.0]]), (1,), np.array([[0, 1]]))
    ...     _ = file.write_bytes(graph_geojson(graph))
    ...     load_graph(file).routes()[0].tolist()
    [[0.0, 0.0], [5.0, 0.0]]
    """
    file = Path(path)
    form = format_of(file, FORMATS, "a route graph")
    options = own_options(file, form, FORMATS, {"level": level})
    with naming(file, MapError):
        graph: RouteGraph = form.read(file, **options)
    if not len(graph.edges):
        raise MapError(f"{file}: expected a graph of nodes and edges, got {len(graph.xy)} nodes and no edges")
    return graph


def _read_building(file: Path, level: str | None = None) -> RouteGraph:
    vertices, lanes = building_lanes(file, level)
    if not lanes:
        raise MapError(f"{file}: expected lanes, got none")
    return RouteGraph.numbered(vertices, np.array(lanes))


def _lif_layout(path: Path, level: str | None) -> dict[str, Any]:
    """A layout, which must be named where there are several."""
    held = read_json(path)
    check(held, read_yaml(Path(__file__).with_name("lif.yaml"), MapError), Place(str(path), MapError))
    version = held["metaInformation"]["lifVersion"]
    if version.split(".")[0] not in ("0", "1"):
        raise ValueError(f"expected lifVersion 1, got {short(version)}")
    layouts: dict[str, dict[str, Any]] = {layout["layoutId"]: layout for layout in held["layouts"]}
    if (level is None and len(layouts) != 1) or (level is not None and level not in layouts):
        raise ValueError(f"expected level to be one of {', '.join(layouts)}, got {level!r}")
    return layouts[next(iter(layouts)) if level is None else level]


def _read_lif(file: Path, level: str | None = None) -> RouteGraph:
    layout = _lif_layout(file, level)
    index = {node["nodeId"]: k for k, node in enumerate(layout["nodes"])}
    if len(index) < len(layout["nodes"]):
        raise ValueError("expected every nodeId once, got one twice")
    xy = finite("nodePosition", [[node["nodePosition"][axis] for axis in "xy"] for node in layout["nodes"]])
    ends = [(edge["startNodeId"], edge["endNodeId"]) for edge in layout["edges"]]
    inside = [edge for edge, pair in zip(layout["edges"], ends, strict=True) if index.keys() >= {*pair}]
    kinds = {kind["vehicleTypeId"] for edge in inside for kind in edge["vehicleTypeEdgeProperties"]}
    curved = sum(any(kind.get("trajectory") for kind in edge["vehicleTypeEdgeProperties"]) for edge in inside)
    said = {
        f"{len(ends) - len(inside)} edges lead to other layouts, or to no node: passed over": len(inside) < len(ends),
        f"{curved} edges have trajectories: taken as straight": curved > 0,
        f"edges of {len(kinds)} types of vehicles are taken together": len(kinds) > 1,
    }
    edges = np.array([(index[edge["startNodeId"]], index[edge["endNodeId"]]) for edge in inside], dtype=int)
    edge_ids, notes = tuple(edge["edgeId"] for edge in inside), (f"{file}: {note}" for note in said if said[note])
    return RouteGraph(tuple(index), xy.reshape(-1, 2), edge_ids, edges.reshape(-1, 2), notes=tuple(notes))


def lif_marks(file: Path, level: str | None = None) -> list[Mark]:
    """The stations of a layout in LIF that are beacons, as `graph_lif` writes them."""
    with naming(file, MapError):
        return [
            Mark(station["stationId"], at["x"], at["y"], degrees(at["theta"]) if "theta" in at else None)
            for station in _lif_layout(file, level).get("stations") or []
            if station.get("stationDescription", "").startswith(_BEACON) and (at := station.get("stationPosition"))
        ]


def _read_nav2(file: Path) -> RouteGraph:
    nodes: dict[int, tuple[float, float]] = {}
    edges: list[tuple[int, int, int]] = []  # id, from, to: ids may occur twice, as in nav2's own files
    metadata = []
    for where, _, held, kind, place in read_features(file, ("Point",), metres=True):
        is_node = kind == "Point"  # nav2 looks at no line, and its own files have broken ones
        ids = [held.get(name) for name in (("id",) if is_node else ("id", "startid", "endid"))]
        if (not is_node and kind not in _LINES) or not all(type(number) is int for number in ids):
            raise MapError(f"{where}: expected a Point with an id, or a LineString with id, startid and endid, numbers")
        if is_node and held["id"] in nodes:
            raise MapError(f"{where}: the id {held['id']} occurs twice")
        known = held.get("metadata") or {}
        if is_node:
            nodes[held["id"]] = (place.x, place.y)
        elif not isinstance(known, dict):
            raise MapError(f"{where}: expected metadata by their names, got {short(known)}")
        else:
            edges.append((held["id"], held["startid"], held["endid"]))
            metadata.append(known)
    index = {number: k for k, number in enumerate(nodes)}
    for number, *pair in edges:
        if lost := [end for end in pair if end not in index]:
            raise MapError(f"{file}: edge {number} leads to node {lost[0]}, which is not there")
    ends = np.array([[index[start], index[end]] for _, start, end in edges], dtype=int).reshape(-1, 2)
    with naming(file, MapError):
        text = read_bytes(file, MapError, max_bytes=MAX_JSON_BYTES).decode()
    edge_ids, xy = tuple(number for number, *_ in edges), np.array([*nodes.values()]).reshape(-1, 2)
    return RouteGraph(tuple(nodes), xy, edge_ids, ends, tuple(metadata), text=text)


def graph_lif(graph: RouteGraph, added: Sequence[Mapping[str, Any]] = (), marks: Sequence[Mark] = ()) -> bytes:
    """A graph as a layout in LIF, with metadata ``added`` to the descriptions of edges and beacons as stations.

    >>> graph = RouteGraph((7, 8), np.array([[0.0, 0.0], [5.0, 0.0]]), (1,), np.array([[0, 1]]))
    >>> graph_lif(graph).count(b'"edgeId"')
    1
    """
    _one_each(graph, added)
    vehicle = {"vehicleTypeId": "any"}
    names = [str(name) for name in graph.node_ids]
    edges: Sequence[Any] = graph.edge_ids
    if len({*edges}) < len(edges):  # nav2 allows that
        edges = range(len(edges))
    driven = vehicle | {"vehicleOrientation": 0.0, "orientationType": "TANGENTIAL", "rotationAllowed": True}
    layout: dict[str, Any] = {
        "layoutId": "map",
        "layoutVersion": "1",
        "nodes": [
            {"nodeId": name, "mapId": "map", "nodePosition": {"x": x, "y": y}, "vehicleTypeNodeProperties": [vehicle]}
            for name, (x, y) in zip(names, graph.xy.tolist(), strict=True)
        ],
        "edges": [
            {"edgeId": str(edge), "startNodeId": names[a], "endNodeId": names[b]}
            | ({"edgeDescription": ", ".join(f"{key} {value}" for key, value in added[k].items())} if added else {})
            | {"vehicleTypeEdgeProperties": [driven]}
            for k, (edge, (a, b)) in enumerate(zip(edges, graph.edges.tolist(), strict=True))
        ],
        "stations": [
            {
                "stationId": mark.name,
                "interactionNodeIds": [names[graph.nearest((mark.x, mark.y))]],
                "stationDescription": _BEACON,
                "stationPosition": {"x": mark.x, "y": mark.y}
                | ({} if mark.facing_deg is None else {"theta": remainder(radians(mark.facing_deg), 2 * pi)}),
            }
            for mark in marks
        ],
    }
    now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    about = {"projectIdentification": "driftplan", "creator": "driftplan", "exportTimestamp": now}
    held = {"metaInformation": about | {"lifVersion": "1.0.0"}, "layouts": [layout]}
    return (json.dumps(plain_numbers(held), indent=1) + "\n").encode()


def graph_geojson(graph: RouteGraph, added: Sequence[Mapping[str, Any]] = ()) -> bytes:
    """A graph as nav2's route server reads it, with metadata ``added`` to its edges, in their order.

    What a scorer of nav2 reads are metadata: ``penalty``, say, by its PenaltyScorer, always as a number with a point,
    since nav2 tells whole numbers apart. It reads no graph in which one is null: None is a ValueError.

    >>> graph = RouteGraph((7, 8), np.array([[0.0, 0.0], [5.0, 0.0]]), (1,), np.array([[0, 1]]))
    >>> b'"metadata": {"penalty": 2.5}' in graph_geojson(graph, [{"penalty": 2.5}])
    True
    """
    _one_each(graph, added)
    text = graph.text or _written(graph)
    parts, done = [], 0
    edge = iter(added)
    for start, end in _features(text) if added else ():
        held = json.loads(text[start:end])
        if not (more := dict(next(edge)) if "startid" in held else {}):
            continue
        inside = dict(_members(text, start))
        if "metadata" in inside:
            start, end = inside["metadata"]
            parts += [text[done:start], _metadata(held["metadata"], more)]
        else:
            end = len(text[: end - 1].rstrip(_SPACE))
            parts += [text[done:end], f', "metadata": {_metadata({}, more)}']
        done = end
    return "".join([*parts, text[done:]]).encode()


def _one_each(graph: RouteGraph, added: Sequence[Mapping[str, Any]]) -> None:
    if added and len(added) != len(graph.edges):
        raise ValueError(f"expected metadata for {len(graph.edges)} edges, got {len(added)}")


def _metadata(known: dict[str, Any] | None, added: dict[str, Any]) -> str:
    if None in added.values():
        raise ValueError(f"expected metadata that nav2 reads, numbers, texts and lists of them, got None in {added}")
    scored = {"penalty": float(added["penalty"])} if type(added.get("penalty")) is int else {}
    return json.dumps((known or {}) | added | scored, allow_nan=False)


def _written(graph: RouteGraph) -> str:
    """Ids that are texts become numbers: nav2 knows no others."""
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::3857"}}  # what nav2's own files say
    given = [all(type(number) is int for number in ids) for ids in (graph.node_ids, graph.edge_ids)]
    nodes: Sequence[Any] = graph.node_ids if given[0] else range(len(graph.node_ids))
    edges: Sequence[Any] = graph.edge_ids if given[1] else range(max(nodes) + 1, max(nodes) + 1 + len(graph.edges))
    features: list[dict[str, Any]] = [
        {"properties": {"id": number, "frame": "map"}, "geometry": {"type": "Point", "coordinates": xy}}
        for number, xy in zip(nodes, graph.xy.tolist(), strict=True)
    ]
    for k, (number, (a, b)) in enumerate(zip(edges, graph.edges.tolist(), strict=True)):
        held = {"id": number, "startid": nodes[a], "endid": nodes[b]}
        known = {"metadata": graph.metadata[k]} if graph.metadata and graph.metadata[k] else {}
        line = {"type": "LineString", "coordinates": graph.xy[[a, b]].tolist()}
        features.append({"properties": held | known, "geometry": line})
    lines = ",\n".join(json.dumps(plain_numbers({"type": "Feature", **feature})) for feature in features)
    top = {"type": "FeatureCollection", "name": "graph", "driftplan": {"version": VERSION, "frame": "map"}, "crs": crs}
    return f'{json.dumps(top)[:-1]}, "features": [\n{lines}\n]}}\n'


def _features(text: str) -> Iterator[tuple[int, int]]:
    """Where the properties of every feature stand."""
    start, _ = dict(_members(text, text.index("{")))["features"]
    at = _after(text, start + 1)
    while text[at] != "]":
        yield dict(_members(text, at))["properties"]
        at = _after(text, json.JSONDecoder().raw_decode(text, at)[1])
        at = _after(text, at + 1) if text[at] == "," else at


def _members(text: str, start: int) -> Iterator[tuple[str, tuple[int, int]]]:
    """Where the values of the object that starts here stand, by their names."""
    decode = json.JSONDecoder().raw_decode
    at = _after(text, start + 1)
    while text[at] != "}":
        name, at = decode(text, at)
        begin = _after(text, _after(text, at) + 1)
        _, end = decode(text, begin)
        yield name, (begin, end)
        at = _after(text, end)
        at = _after(text, at + 1) if text[at] == "," else at


def _after(text: str, at: int) -> int:
    """The next place that is no space."""
    while text[at] in _SPACE:
        at += 1
    return at


FORMATS = (
    Format("Open-RMF", (".building.yaml",), _read_building, options=("level",)),
    Format("LIF", (".lif", ".lif.json"), _read_lif, options=("level",)),
    Format("nav2", (".geojson", ".json"), _read_nav2),
)
