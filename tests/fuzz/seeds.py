"""Good files of every format that is read, from which the fuzzer makes broken ones."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

import driftplan as d
from driftplan.world.route_files import read_path


class Seed(NamedTuple):
    """A file, those that lie beside it, and what reads it."""

    name: str
    content: bytes
    read: Callable[[str], Any]
    beside: Mapping[str, bytes] = MappingProxyType({})


def _example(name: str) -> bytes:
    return (Path(__file__).resolve().parents[2] / "examples/data/formats" / name).read_bytes()


_TAG = d.BeaconKind.rfid(range_m=1.5, position_std_m=0.1)


def _world(file: str) -> d.World:
    return d.load_world(file, robot_radius=0.1)


def _geojson(*features: tuple[str, Any, dict[str, Any]], **more: Any) -> bytes:
    made = [
        {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}
        for kind, coordinates, properties in features
    ]
    return json.dumps({"type": "FeatureCollection", "features": made, **more}).encode()


def _square(x: float, y: float, size: float) -> list[list[list[float]]]:
    return [[[x, y], [x + size, y], [x + size, y + size], [x, y + size], [x, y]]]


def _png(cells: Any) -> bytes:
    out = BytesIO()
    Image.fromarray(cells).save(out, "PNG")
    return out.getvalue()


_CELLS = np.full((6, 8), 254, dtype=np.uint8)
_CELLS[2:4, 3:6], _CELLS[0, 0] = 0, 205
_PGM = b"P5\n8 6\n255\n" + _CELLS.tobytes()
_PLAIN_PGM = b"P2\n# drawn\n8 6\n255\n" + b"\n".join(b" ".join(b"%d" % v for v in row) for row in _CELLS)
_ROS = b"image: %s\nresolution: 0.5\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
_ZONES = b"image: m.png\nresolution: 0.5\norigin: [0, 0, 0]\nzones: {0: {step_m: 1}, 205: {lateral_var_per_m: 1}}\n"
_S = np.arange(40) * 0.25
_XY = [(t, 1.5 * np.cos(t / 3), 1.5 * np.sin(t / 3), t / 3 + 1.57) for t in _S]
_POSES = "".join(f"{t:.2f},{x:.4f},{y:.4f},{h:.4f}\n" for t, x, y, h in _XY).encode()
_TUM = "".join(
    f"{t:.2f} {x:.4f} {y:.4f} 0 0 0 {np.sin(h / 2):.5f} {np.cos(h / 2):.5f}\n" for t, x, y, h in _XY
).encode()
_KITTI = "".join(
    f"{np.cos(h):.5f} 0 {-np.sin(h):.5f} {-y:.4f} 0 1 0 0 {np.sin(h):.5f} 0 {np.cos(h):.5f} {x:.4f}\n"
    for _, x, y, h in _XY
).encode()
_G2O = (
    "".join(f"VERTEX_SE2 {k} {x:.4f} {y:.4f} {h:.4f}\n" for k, (_, x, y, h) in enumerate(_XY)).encode()
    + "".join(f"EDGE_SE2 {k} {k + 1} 0.1 0 0.08 1 0 0 1 0 1\n" for k in range(39)).encode()
)
_CARMEN = "".join(f"ODOM {x:.3f} {y:.3f} {h:.3f} 0.1 0.2 0 {t:.2f} host {t:.2f}\n" for t, x, y, h in _XY).encode()
_SPEEDS = b"time [s],speed [km/h],turn_rate [deg/s]\n" + b"".join(
    b"%.2f,3.6,%d\n" % (t, k % 7) for k, t in enumerate(_S)
)
_ECHO = b"field.header.stamp,field.twist.twist.linear.x,field.twist.twist.angular.z\n" + b"".join(
    b"%d,0.5,0.1\n" % (1_600_000_000_000_000_000 + k * 10**8) for k in range(30)
)
_NODE = {"frame": "map"}
_GRAPH = _geojson(
    ("Point", [0.0, 0.0], {"id": 0, **_NODE}),
    ("Point", [4.0, 0.0], {"id": 1, **_NODE}),
    ("Point", [4.0, 3.0], {"id": 2, **_NODE}),
    ("MultiLineString", [[[0.0, 0.0], [4.0, 0.0]]], {"id": 3, "startid": 0, "endid": 1}),
    ("MultiLineString", [[[4.0, 0.0], [4.0, 3.0]]], {"id": 4, "startid": 1, "endid": 2, "overridable": False}),
)
_MAP = _geojson(
    ("Polygon", _square(0, 0, 9), {"kind": "boundary"}),
    ("Polygon", _square(3, 3, 2), {"kind": "obstacle"}),
    ("Polygon", _square(6, 6, 2), {"kind": "zone", "heading_var_per_m": 1e-3}),
)
_TAGS = _geojson(
    ("Point", [1.0, 2.0], {"id": "A1", "kind": "tag", "range_m": 1.5, "position_std_m": 0.1, "heading_std": 0.05}),
    ("Point", [3.0, 2.0], {"range_m": 4.0, "bearing_std": 0.1, "line_of_sight": True, "facing_deg": 90.0}),
)
_NOISE = b"# fitted\nheading_var_per_m: 1.0e-4\ndistance_var_per_m: 2.0e-4\ndistance_scale_error: -0.01\n"
_STEPS = b"heading_var_per_step: 1.0e-4\ndistance_var_per_step: 2.0e-4\nstep_m: 0.5\n"

SEEDS = (
    Seed("m.yaml", _ROS % b"m.pgm", _world, {"m.pgm": _PGM}),
    Seed("p.yaml", (_ROS % b"m.png") + b"mode: scale\n", _world, {"m.png": _png(np.dstack([_CELLS] * 4))}),
    Seed("m.map", b"type octile\nheight 4\nwidth 5\nmap\n.....\n.@@T.\n.G.S.\n.....\n", _world),
    Seed("m.geojson", _MAP, _world),
    Seed("m.pgm", _PGM, lambda f: _world(f.replace(".pgm", ".yaml")), {"m.yaml": _ROS % b"m.pgm"}),
    Seed("t.pgm", _PLAIN_PGM, lambda f: _world(f.replace(".pgm", ".yaml")), {"t.yaml": _ROS % b"t.pgm"}),
    Seed("m.png", _png(_CELLS), lambda f: _world(f.replace(".png", ".yaml")), {"m.yaml": _ROS % b"m.png"}),
    Seed("degrees.geojson", _MAP, lambda f: d.load_world(f, robot_radius=0.0, origin=(5.0, 5.0))),
    Seed("hall.building.yaml", _example("hall.building.yaml"), _world),
    Seed("lanes.building.yaml", _example("hall.building.yaml"), d.load_graph),
    Seed("tags.building.yaml", _example("layout.building.yaml"), lambda f: d.load_beacons(f, _TAG)),
    Seed("hall.imdf", _example("hall.imdf"), lambda f: d.load_world(f, robot_radius=0.1, origin=(11.5, 48.1))),
    Seed("graph.lif", _example("layout.lif"), d.load_graph),
    Seed("tags.lif", _example("layout.lif"), lambda f: d.load_beacons(f, _TAG)),
    Seed("tags.yaml", _example("tags.yaml"), lambda f: d.load_beacons(f, _TAG)),
    Seed("map.txt", _example("map.txt"), lambda f: d.load_beacons(f, _TAG)),
    Seed("path.yaml", _example("waypoints.yaml"), read_path),
    Seed("zones.geojson", _MAP, d.load_zones),
    Seed("zones.yaml", _ZONES, d.load_zones, {"m.png": _png(_CELLS)}),
    Seed("noise.yaml", _NOISE, d.load_noise),
    Seed("steps.yaml", _STEPS, d.load_noise),
    Seed("tags.geojson", _TAGS, d.load_beacons),
    Seed("graph.geojson", _GRAPH, d.load_graph),
    Seed("route.csv", b"x [m],y [m],heading [deg]\n0,0,0\n5,0,90\n5,4,180\n", read_path),
    Seed("route.txt", b"# way\n0 0\n5.5 0\n5.5 4\n", read_path),
    Seed("route.csv.gz", gzip.compress(b"x;y\n0;0\n5;0\n5;4\n", mtime=0), read_path),
    Seed("trips.csv", b"start_x,start_y,goal_x,goal_y,weight\n2,5,58,5,20\n1,1,2,2,1\n", d.load_trips),
    Seed("poses.csv", b"time,x,y,heading\n" + _POSES, d.read_trajectory),
    Seed("odometry.csv", b"time,x,y,heading\n" + _POSES, d.read_odometry),
    Seed("truth.csv", b"time,x,y,heading\n" + _POSES, d.read_truth),
    Seed("truth.tum", _TUM, d.read_truth),
    Seed("truth.txt", _KITTI, d.read_truth),
    Seed("graph.g2o", _G2O, d.read_odometry),
    Seed("drive.log", _CARMEN, d.read_odometry),
    Seed("speeds.csv", _SPEEDS, d.read_odometry),
    Seed("echo.csv", _ECHO, d.read_odometry),
)
