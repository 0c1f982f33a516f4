"""``driftplan graph``: drift on a route graph of nav2's, and penalties for its route server."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from driftplan.report.commands import shared
from driftplan.report.commands.answer import Answer, talk
from driftplan.report.commands.option import Command, Group, Idle, Option, geojson_file
from driftplan.report.records import drift_table
from driftplan.tables import digits, table

if TYPE_CHECKING:
    from driftplan import Beacon, OdometryNoise, RouteGraph, World

_MAX_EDGES = 20  # listed on the screen, those of most drift first; --json has them all


def run(args: argparse.Namespace) -> Answer:
    """What every edge adds, and the way of least drift between two nodes."""
    from driftplan import edge_metadata, graph_geojson, graph_lif, load_beacons, load_graph, load_world
    from driftplan.beacons.beacon_files import marks_of

    noise, graph = shared.noise_from(args), load_graph(args.graph, level=args.level)
    for note in graph.notes:
        talk(note)
    world = None if args.map is None else load_world(args.map, robot_radius=0.0)
    beacons = load_beacons(args.beacons) if args.beacons else ()
    if (args.start_node is None) != (args.goal_node is None):
        raise ValueError("expected both --start-node and --goal-node, or neither, got one of them")
    added = edge_metadata(graph, noise, beacons, world)
    ids = [(graph.node_ids[a], graph.node_ids[b]) for a, b in graph.edges.tolist()]
    edges = [
        {"id": number, "start": start, "goal": goal, **told}
        for number, (start, goal), told in zip(graph.edge_ids, ids, added, strict=True)
    ]
    ends = args.start_node, args.goal_node
    ways = None if args.start_node is None else ways_on_graph(graph, ends, noise, beacons, world)

    def payload() -> dict[str, Any]:
        routes = ways.payload() if ways else {"routes": {}}
        return {"noise": noise.given(), "edges": edges, **routes}

    def text() -> str:
        shown = sorted(edges, key=lambda edge: -edge["penalty"])[:_MAX_EDGES]
        columns: dict[str, Any] = {key: [edge[key] for edge in shown] for key in ("id", "start", "goal")}
        for key in ("rms_m", "drift_since_beacon_m", "nearest_beacon_m"):
            if any(key in edge for edge in edges):
                columns[key.replace("_", " ")] = digits([edge.get(key, float("nan")) for edge in shown])[0]
        parts = [f"{len(edges)} edges, those that add most first", table(columns)]
        return "\n".join([*parts, *(["", ways.text()] if ways else [])])

    def drawn(name: str) -> Any:
        if not ways:
            raise ValueError("expected --start-node and --goal-node to draw or write the way between them, got neither")
        return ways.files[name]()

    files: dict[str | Path, Any] = {name: partial(drawn, name) for name in (*shared.ROUTE_FILES, "picture")}
    files["geojson"] = lambda: graph_geojson(graph, added)
    files["lif"] = lambda: graph_lif(graph, added, marks_of(beacons))
    return Answer(payload=payload, text=text, files=files)


def ways_on_graph(
    graph: RouteGraph,
    ends: tuple[int | str, int | str],
    noise: OdometryNoise,
    beacons: Sequence[Beacon],
    world: World | None,
) -> Answer:
    """The way of least drift between two nodes and the shortest one: what is said of them, and their files."""
    from driftplan import graph_routes
    from driftplan.report.figures.routes import plot_comparison

    ways = dict(zip(("lowest drift", "shortest"), graph_routes(graph, *ends, noise, beacons, world), strict=True))

    def text() -> str:
        return "\n\n".join(
            f"{name}: {float(way.drift.length):.2f} m by {' '.join(map(str, way.nodes))}\n{drift_table(way.drift)}"
            for name, way in ways.items()
        )

    def payload() -> dict[str, Any]:
        return {"routes": {n: {"nodes": way.nodes, "waypoints": way.drift.to_dicts()} for n, way in ways.items()}}

    files = shared.route_files(ways["lowest drift"].drift)
    files["picture"] = lambda: plot_comparison(world, {name: way.drift for name, way in ways.items()})
    return Answer(payload=payload, text=text, files=files)


# fmt: off
COMMAND = Command(
    summary="drift on a route graph of nav2's, and penalties for its route server",
    description="Predict what every edge of a route graph adds to the drift, and find the way between two nodes on "
    "which the drift at the goal is least. Written back as GeoJSON every edge has metadata: penalty, which nav2's "
    "PenaltyScorer reads, and what it is made of.",
    run=run,
    arguments=(Option("graph", "GRAPH", "nodes and edges in metres: nav2's GeoJSON, .lif or .building.yaml", str),),
    groups=(
        Group("", (
            Option("start_node", "ID", "id of the node to start from", str),
            Option("goal_node", "ID", "id of the node to reach", str),
            Option("beacons", "FILE.geojson", "beacons that are read on the way", geojson_file),
            Option("level", "NAME", "layout or level of a graph that has several", str),
            Option("map", "MAP", "map file, whose walls block beacons and which is drawn", geojson_file),
        )),
        *shared.NOISE,
    ),
    files={
        "geojson": "write the graph as GeoJSON of nav2's with metadata on every edge",
        "lif": "write the graph as a layout in LIF, the metadata in the descriptions of edges, beacons as stations",
        **shared.ROUTE_FILES,
        "picture": "draw both ways, their error ellipses and their drift against distance",
    },
    idle=(Idle(("map",), lambda args: not args.beacons and args.picture is None, "there are no --beacons to see"),),
    examples=("graph.geojson --beacons tags.geojson --geojson graph-with-penalties.geojson",
              "graph.geojson --start-node 0 --goal-node 12 --picture way.png --json"),
)
