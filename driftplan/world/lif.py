"""LIF, the layout interchange format of VDMA (version 1.0.0, March 2024): nodes, edges and stations of a fleet's track.

What its JSON schema asks for is asked for here (`lif.yaml`), and nothing else. One layout is one level, named by its
layoutId. Edges are taken as straight and for every type of vehicle; beacons are stations whose description begins with
"beacon".
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from math import degrees, pi, radians, remainder
from pathlib import Path
from reprlib import repr as short
from typing import Any, NamedTuple

import numpy as np

from driftplan.arrays import Floats, Ints, finite
from driftplan.errors import MapError, naming
from driftplan.files import plain_numbers
from driftplan.world.formats import Mark
from driftplan.world.plain_data import read_json, read_yaml
from driftplan.world.schema import Place, check

_BEACON = "beacon"


class LifLayout(NamedTuple):
    """One layout of a file."""

    nodes: tuple[str, ...]
    xy: Floats  # (n, 2), metres
    edges: tuple[str, ...]
    ends: Ints  # (m, 2), indices of nodes
    beacons: tuple[Mark, ...]
    notes: tuple[str, ...]


def read_lif(path: Path, level: str | None = None) -> LifLayout:
    """A layout, which must be named where there are several."""
    held = read_json(path)
    with naming(path, MapError):
        check(held, read_yaml(Path(__file__).with_suffix(".yaml"), MapError), Place(str(path), MapError))
        version = held["metaInformation"]["lifVersion"]
        if version.split(".")[0] not in ("0", "1"):
            raise ValueError(f"expected lifVersion 1, got {short(version)}")
        layouts = {layout["layoutId"]: layout for layout in held["layouts"]}
        if (level is None and len(layouts) != 1) or (level is not None and level not in layouts):
            raise ValueError(f"expected level to be one of {', '.join(layouts)}, got {level!r}")
        return _layout(path, layouts[next(iter(layouts)) if level is None else level])


def _layout(path: Path, layout: dict[str, Any]) -> LifLayout:
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
    beacons = [
        Mark(station["stationId"], at["x"], at["y"], degrees(at["theta"]) if "theta" in at else None)
        for station in layout.get("stations") or []
        if station.get("stationDescription", "").startswith(_BEACON) and (at := station.get("stationPosition"))
    ]
    return LifLayout(
        tuple(index),
        xy.reshape(-1, 2),
        tuple(edge["edgeId"] for edge in inside),
        np.array([(index[edge["startNodeId"]], index[edge["endNodeId"]]) for edge in inside], dtype=int).reshape(-1, 2),
        tuple(beacons),
        tuple(f"{path}: {note}" for note, holds in said.items() if holds),
    )


def lif_bytes(
    xy: Floats,
    ends: Ints,
    nodes: Sequence[Any],
    edges: Sequence[Any],
    told: Sequence[Mapping[str, Any]],
    marks: Sequence[Mark],
) -> bytes:
    """A file with one layout. What is ``told`` of edges are their descriptions; stations know their nearest node."""
    vehicle = {"vehicleTypeId": "any"}
    names = [str(name) for name in nodes]
    if len({*edges}) < len(edges):  # nav2 allows that
        edges = range(len(edges))
    driven = vehicle | {"vehicleOrientation": 0.0, "orientationType": "TANGENTIAL", "rotationAllowed": True}
    layout: dict[str, Any] = {
        "layoutId": "map",
        "layoutVersion": "1",
        "nodes": [
            {"nodeId": name, "mapId": "map", "nodePosition": {"x": x, "y": y}, "vehicleTypeNodeProperties": [vehicle]}
            for name, (x, y) in zip(names, xy.tolist(), strict=True)
        ],
        "edges": [
            {"edgeId": str(edge), "startNodeId": names[a], "endNodeId": names[b]}
            | ({"edgeDescription": ", ".join(f"{key} {value}" for key, value in told[k].items())} if told else {})
            | {"vehicleTypeEdgeProperties": [driven]}
            for k, (edge, (a, b)) in enumerate(zip(edges, ends.tolist(), strict=True))
        ],
        "stations": [
            {
                "stationId": mark.name,
                "interactionNodeIds": [names[int(np.hypot(*(xy - (mark.x, mark.y)).T).argmin())]],
                "stationDescription": _BEACON,
                "stationPosition": {"x": mark.x, "y": mark.y}
                | ({} if mark.facing_deg is None else {"theta": remainder(radians(mark.facing_deg), 2 * pi)}),
            }
            for mark in marks
        ],
    }
    now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    about = {
        "projectIdentification": "driftplan",
        "creator": "driftplan",
        "exportTimestamp": now,
        "lifVersion": "1.0.0",
    }
    return (json.dumps(plain_numbers({"metaInformation": about, "layouts": [layout]}), indent=1) + "\n").encode()
