"""Make what `driftplan examples` hands out, and in ``formats/`` a tiny example of every format that is read or written,
always the same bytes but for drawings and pages: ``python examples/data/make_data.py [FOLDER]``.

The robot is invented: it drives rounds in the bundled warehouse, its wheels err as `NOISE` says, and once in the first
drive they spin for half a metre. Lengths are metres, angles radians, times seconds.
"""

from __future__ import annotations

import json
import re
import sys
import zipfile
from collections.abc import Iterable
from dataclasses import replace
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = list[tuple[float, float]]

ROUTE: Points = [(8, 2.5), (8, 23.8), (44, 23.8)]
OTHER: Points = [(8, 2.5), (21.5, 2.5), (21.5, 13.4), (44, 13.4)]
TRIPS = [((3, 3), (56, 36), 1), ((3, 36), (56, 3), 3), ((3, 20), (55.5, 20), 2), ((51, 33), (23.5, 18.7), 4)]
# variances of heading and distance per metre, and per radian turned
NOISE = {"heading_var_per_m": 3e-5, "heading_var_per_rad": 2e-4, "distance_var_per_m": 2.5e-4}
SPEED_M_PER_S, TURN_RAD_PER_S, RATE_HZ = 0.8, 0.8, 4.0
SLIP_M = 0.5


def poses(waypoints: Points, rounds: int) -> NDArray[np.float64]:
    """True (t, x, y, heading), of a robot that drives straight, turns on the spot, and goes there and back."""
    there_and_back = (waypoints + waypoints[-2::-1]) if rounds > 1 else waypoints
    points = [complex(*p) for p in there_and_back]
    points += rounds // 2 * points[1:] if rounds > 3 else []
    rows: list[tuple[float, complex, float]] = []
    time, heading = 0.0, float(np.angle(points[1] - points[0]))
    for here, there in pairwise(points):
        turn = float(np.angle((there - here) * np.exp(-1j * heading)))
        for share in np.arange(0, 1, TURN_RAD_PER_S / RATE_HZ / max(abs(turn), 1e-9)) if turn else ():
            rows.append((time, here, heading + share * turn))
            time += 1 / RATE_HZ
        heading += turn
        for share in np.arange(0, 1, SPEED_M_PER_S / RATE_HZ / abs(there - here)):
            rows.append((time, here + share * (there - here), heading))
            time += 1 / RATE_HZ
    rows.append((time, points[-1], heading))
    return np.array([(t, p.real, p.imag, h) for t, p, h in rows])


def odometry(truth: NDArray[np.float64], rng: np.random.Generator, slip_after_m: float = np.inf) -> NDArray[np.float64]:
    """(t, x, y, heading) that wheels would tell of the drive, from (0, 0, 0)."""
    places = truth[:, 1] + 1j * truth[:, 2]
    steps, turns = np.abs(np.diff(places)), np.diff(truth[:, 3])
    directions = np.where(steps > 0, np.angle(np.diff(places) * np.exp(-1j * truth[:-1, 3])), 0.0)
    heading_var = NOISE["heading_var_per_m"] * steps + NOISE["heading_var_per_rad"] * np.abs(turns)
    measured = steps + rng.normal(size=len(steps)) * np.sqrt(NOISE["distance_var_per_m"] * steps)
    slips = np.searchsorted(np.cumsum(steps), slip_after_m)
    if slips < len(measured):
        measured[slips] += SLIP_M
    headings = np.concatenate([[0.0], np.cumsum(turns + rng.normal(size=len(turns)) * np.sqrt(heading_var))])
    motion = measured * np.exp(1j * (headings[:-1] + directions))
    way = np.concatenate([[0j], np.cumsum(motion)])
    return np.column_stack([truth[:, 0], way.real, way.imag, headings])


def text(header: str, rows: Iterable[Iterable[float]], decimals: int) -> str:
    """CSV."""
    return "\n".join(
        [header, *(",".join(f"{v:.{decimals}f}".rstrip("0").rstrip(".") for v in row) for row in rows), ""]
    )


def files() -> dict[str, str]:
    """Every file by its name."""
    rng = np.random.default_rng(2024)
    made = {
        "route.csv": text("x,y", ROUTE, 1),
        "other.csv": text("x,y", OTHER, 1),
        "trips.csv": text("start_x,start_y,goal_x,goal_y,weight", [(*a, *b, w) for a, b, w in TRIPS], 1),
    }
    for drive, (waypoints, slip_after_m) in enumerate([(ROUTE, 150.0), (OTHER, np.inf)], start=1):
        truth = poses(waypoints, 6)
        made[f"drive{drive}_truth.csv"] = text("time,x,y,heading", truth, 4)
        made[f"drive{drive}_odometry.csv"] = text("time,x,y,heading", odometry(truth, rng, slip_after_m), 4)
    return made


BUILDING = """\
coordinate_system: reference_image
name: hall
levels:
  L1:
    vertices: [[0, 0, 0, ""], [80, 0, 0, ""], [80, 60, 0, ""], [0, 60, 0, ""], [40, 0, 0, ""], [40, 30, 0, ""],
      [10, 50, 0, dock], [70, 50, 0, shelf]]
    measurements: [[0, 1, {distance: [3, 8.0]}]]
    walls: [[4, 5, {}]]
    floors: [{parameters: {}, vertices: [0, 1, 2, 3]}]
    lanes: [[6, 7, {bidirectional: [4, true]}]]
"""
HERE = (11.5, 48.1)  # of the hall: longitude, latitude
DEGREES = 1 / np.array([74481.0, 111192.3])  # of a metre there, east and north
FIXED = "2024-01-01T00:00:00.000Z"  # instead of the time of writing


def formats() -> dict[str, bytes]:
    """A hall of 8 x 6 m with a wall, a graph, a route and two tags, in every format that driftplan reads or writes."""
    import tempfile

    import driftplan as d
    from driftplan.beacons.beacon_files import beacons_geojson

    wet = d.Zone([(5, 0), (8, 0), (8, 2), (5, 2)], d.OdometryNoise(heading_var_per_m=1e-3))
    hall = d.World.from_polygons([[(4, 3), (4.2, 3), (4.2, 6), (4, 6)]], bounds=(0, 0, 8, 6), robot_radius=0.3)
    noise = d.OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0)
    route = np.array([(1.0, 1.0), (7.0, 1.0), (7.0, 5.0)])
    tags = [d.Beacon(d.BeaconKind.rfid(1.5, 0.1), *xy, id=f"T{k}") for k, xy in enumerate([(4.1, 2.8), (8.0, 3.0)])]
    layout = d.place_beacons(
        hall, [route], noise, 9.0, d.Sites(d.BeaconKind.rfid(1.5, 0.1), spacing_m=1.0, existing=tags)
    )
    drift = d.predict_drift(route, noise)
    graph = d.RouteGraph.of_routes([route, route[::-1]])
    made = {
        "hall.building.yaml": BUILDING.encode(),
        "hall.imdf": venue(),
        "graph.geojson": d.graph_geojson(graph, d.edge_metadata(graph, noise, tags)),
        "path.yaml": d.ros_path_yaml(drift, spacing_m=2.0),
        "poses.yaml": d.poses_yaml(drift, spacing_m=2.0),
        "poses.csv": d.poses_csv(drift, spacing_m=2.0),
        "waypoints.yaml": d.waypoints_yaml(drift),
        "tags.geojson": beacons_geojson(tags),
        "tags.yaml": d.tags_yaml(tags, size_m=0.16),
        "map.txt": d.fiducial_map(tags),
        "transforms.sh": d.static_transforms(tags),
        "layout.csv": d.layout_csv(layout),
        "layout.html": d.layout_html(layout),
        "layout.pdf": d.layout_pdf(layout),
        "layout.dxf": d.layout_dxf(layout),
        "layout.lif": d.layout_lif(layout),
    }
    made["layout.lif"] = re.sub(rb'(?<="exportTimestamp": ")[^"]*', FIXED.encode(), made["layout.lif"])
    with tempfile.TemporaryDirectory() as folder:
        d.save_world(hall, Path(folder, "hall.yaml"), cell_size_m=0.2)
        d.save_world(hall, Path(folder, "hall.map"), cell_size_m=0.2)
        d.save_world(replace(hall, zones=(wet,)), Path(folder, "hall.geojson"))
        d.save_noise(Path(folder, "noise.yaml"), noise)
        Path(folder, "a.building.yaml").write_text(BUILDING)
        made["layout.building.yaml"] = d.layout_building(layout, Path(folder, "a.building.yaml"))
        Path(folder, "a.building.yaml").unlink()
        made |= {file.name: file.read_bytes() for file in Path(folder).iterdir()}
    speed = np.full((30, 40), 254, dtype=np.uint8)
    speed[20:, 25:] = 100  # from the top: the wet corner
    made["speed.pgm"] = b"P5\n40 30\n255\n" + speed.tobytes()
    mask = "image: speed.pgm\nmode: scale\nresolution: 0.2\norigin: [0, 0, 0]\n"
    mask += "negate: 0\noccupied_thresh: 1.0\nfree_thresh: 0.0\n"
    made["speed.yaml"] = f"{mask}zones:\n  100: {{heading_var_per_m: 1.0e-3}}\n".encode()
    return made


def venue() -> bytes:
    """The hall in IMDF: two rooms, and a door below the wall."""
    corners: dict[str, list[tuple[float, ...]]] = {"level": [(0, 0, 8, 6)], "unit": [(0, 0, 4, 6), (4.2, 0, 8, 6)]}
    content = BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for part in ("level", "unit", "opening"):
            ring = [[(a, b), (c, b), (c, e), (a, e), (a, b)] for a, b, c, e in corners.get(part, [])]
            shapes: list[tuple[str, Any]] = [("Polygon", [corner]) for corner in ring]
            shapes = shapes or [("LineString", [[(4.1, 0.5), (4.1, 2.5)]])]
            features = []
            for k, (kind, rings) in enumerate(shapes):
                degrees = [(np.array(ring) * DEGREES + HERE).round(9).tolist() for ring in rings]
                held = {"ordinal": 0} if part == "level" else {"level_id": "level-0", "category": "room"}
                shape = {"type": kind, "coordinates": degrees if kind == "Polygon" else degrees[0]}
                features.append({"type": "Feature", "id": f"{part}-{k}", "feature_type": part, "properties": held,
                                 "geometry": shape})  # fmt: skip
            collection = {"type": "FeatureCollection", "name": part, "features": features}
            archive.writestr(zipfile.ZipInfo(f"{part}.geojson"), json.dumps(collection))
    return content.getvalue()


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else __file__).resolve()
    folder = folder if folder.is_dir() else folder.parent
    for name, content in files().items():
        (folder / name).write_text(content)
        print(folder / name)
    (folder / "formats").mkdir(exist_ok=True)
    for name, packed in formats().items():
        (folder / "formats" / name).write_bytes(packed)
        print(folder / "formats" / name)
