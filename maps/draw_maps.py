"""Draw the maps that come with driftplan, always the same bytes: ``python maps/draw_maps.py [FOLDER]``.

Both buildings are invented. Lengths are metres, x to the right, y up; rectangles are (xmin, ymin, xmax, ymax).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

Rectangle = tuple[float, float, float, float]

CELL_M = 0.1  # of the warehouse's grid


def warehouse() -> tuple[float, float, list[Rectangle]]:
    """Width, depth and obstacles: docks in the west, racks in the middle, packing and an office in the east."""
    width, depth = 60.0, 40.0
    things = [
        (0.0, 0.0, width, 0.3),
        (0.0, depth - 0.3, width, depth),
        (0.0, 0.0, 0.3, depth),
        (width - 0.3, 0.0, width, depth),
    ]
    # Back-to-back racks, 2.4 m deep, with aisles of 2.8 m; a cross-aisle of 3 m through the southern half. One more row
    # stands against the north wall.
    for row in range(6):
        south = 4.4 + 5.2 * row
        ends = ((11.0, 20.0), (23.0, 47.0)) if row < 3 else ((11.0, 47.0),)
        things += [(west, south, east, south + 2.4) for west, east in ends]
    things += [(11.0, 38.5, 27.5, depth), (30.5, 38.5, 45.0, depth)]
    # Guards at the ends of the racks, and pillars of the roof in the cross-aisles and the dock.
    for row in range(6):
        middle = 4.4 + 5.2 * row + 1.2
        things += [(10.6, middle - 0.2, 10.8, middle + 0.2), (47.2, middle - 0.2, 47.4, middle + 0.2)]
    things += [(x - 0.3, y - 0.3, x + 0.3, y + 0.3) for x in (9.8, 29.5, 49.5) for y in (8.2, 18.6, 29.0)]
    # Docks: four gates with levellers along the west wall, pallets staged before them.
    for gate in range(4):
        south = 7.0 + 7.5 * gate
        things += [(0.3, south, 2.2, south + 0.3), (0.3, south + 3.0, 2.2, south + 3.3)]
        things += [(4.2, south + 0.2, 5.4, south + 1.2), (4.2, south + 1.8, 5.4, south + 2.8)]
    # Packing lines that leave one gap each, and tables.
    things += [(47.6, 12.0, 48.4, 26.5), (52.0, 4.5, 52.8, 17.0), (52.0, 19.0, 52.8, 27.0), (56.2, 12.0, 57.0, 28.0)]
    things += [(54.0, 7.0 + 3.0 * table, 55.0, 8.6 + 3.0 * table) for table in range(6)]
    # An office of 10 x 7 m in the north-east corner, with a door to the south and one to the west.
    things += [(49.5, 32.0, 49.7, 34.6), (49.5, 36.0, 49.7, depth), (49.5, 32.0, 55.0, 32.2), (56.4, 32.0, width, 32.2)]
    # Chargers in the south-east corner.
    things += [(57.8, 2.0 + 1.6 * charger, 59.7, 2.6 + 1.6 * charger) for charger in range(4)]
    return width, depth, things


def office() -> dict[str, Any]:
    """Rooms around a ring of corridors as GeoJSON; the southern corridor has a deep carpet."""
    width, depth = 40.0, 24.0
    # The north-east corner is a courtyard.
    boundary = [(0, 0), (width, 0), (width, 18), (33, 18), (33, depth), (0, depth), (0, 0)]
    walls = [
        (0.0, 0.0, width, 0.3),
        (0.0, 0.0, 0.3, depth),
        (0.0, depth - 0.3, 33.0, depth),
        (width - 0.3, 0.0, width, 18.0),
    ]
    walls += [(33.0, 17.7, width, 18.0), (32.7, 17.7, 33.0, depth)]
    # South rooms, y 0 to 6, and north rooms, y 18 to 24: a wall along the corridor with one door each.
    south, north = (0.0, 7.0, 13.0, 19.0, 26.0, 33.0, 40.0), (0.0, 6.0, 12.0, 20.0, 26.0, 33.0)
    walls += _with_doors(y=5.9, edges=south, doors=(5.0, 8.2, 17.0, 20.4, 31.0, 34.4))
    walls += _with_doors(y=18.0, edges=north, doors=(1.2, 10.0, 15.5, 21.2, 28.0))
    walls += [(x - 0.1, 0.0, x + 0.1, 6.1) for x in south[1:-1]] + [
        (x - 0.1, 18.0, x + 0.1, depth) for x in north[1:-1]
    ]
    # The core, two blocks of rooms with a passage between them.
    for west, east, door in ((3.0, 18.0, 5.0), (20.4, 36.6, 33.0)):
        walls += [(west, 8.6, west + 0.2, 15.6), (east - 0.2, 8.6, east, 15.6)]
        walls += _with_doors(y=8.6, edges=(west, east), doors=(door,)) + _with_doors(
            y=15.4, edges=(west, east), doors=(door,)
        )
        middle = 0.5 * (west + east)
        walls += [(middle - 0.1, 8.6, middle + 0.1, 11.2), (middle - 0.1, 12.4, middle + 0.1, 15.6)]
    desks = [(x, y, x + 1.6, y + 0.8) for x in (1.6, 9.0, 15.0, 22.0, 28.0, 35.5) for y in (1.4, 3.4)]
    desks += [(x, 21.0, x + 1.6, 21.8) for x in (2.4, 8.0, 14.0, 17.0, 22.4, 28.6)]
    desks += [(7.5, 10.6, 9.1, 13.4), (13.0, 11.4, 15.4, 12.6), (23.0, 10.4, 25.4, 11.4), (31.0, 12.4, 34.0, 13.4)]
    pillars = [(11.3, 6.4, 11.7, 6.8), (27.8, 6.4, 28.2, 6.8), (11.3, 17.2, 11.7, 17.6), (27.8, 17.2, 28.2, 17.6)]
    carpet = {"kind": "zone", "name": "deep carpet", "heading_var_per_m": 2e-3, "distance_var_per_m": 2e-3}
    features = [_feature(boundary, {"kind": "boundary"})]
    features += [_feature(_corners(wall), {"kind": "obstacle", "name": "wall"}) for wall in walls]
    features += [_feature(_corners(desk), {"kind": "obstacle", "name": "desk"}) for desk in desks]
    features += [_feature(_corners(pillar), {"kind": "obstacle", "name": "pillar"}) for pillar in pillars]
    features += [_feature(_corners((7.0, 6.1, 33.0, 8.6)), carpet)]
    return {"type": "FeatureCollection", "features": features}


def draw(folder: Path) -> None:
    """Write ``warehouse.pgm``, ``warehouse.yaml`` and ``office.geojson``."""
    width, depth, things = warehouse()
    columns, rows = round(width / CELL_M), round(depth / CELL_M)
    pixels = np.full((rows, columns), 254, dtype=np.uint8)
    for thing in things:
        left, bottom, right, top = (round(value / CELL_M) for value in thing)
        pixels[rows - top : rows - bottom, left:right] = 0
    (folder / "warehouse.pgm").write_bytes(b"P5\n%d %d\n255\n" % (columns, rows) + pixels.tobytes())
    (folder / "warehouse.yaml").write_text(
        f"image: warehouse.pgm\nmode: trinary\nresolution: {CELL_M}\norigin: [0.0, 0.0, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    plan = office()
    features = ",\n".join(json.dumps(feature) for feature in plan["features"])
    (folder / "office.geojson").write_text(f'{{"type": "FeatureCollection", "features": [\n{features}\n]}}\n')


def _with_doors(*, y: float, edges: tuple[float, ...], doors: tuple[float, ...]) -> list[Rectangle]:
    """A wall along y from the first to the last edge, with doors of 1.1 m that start at the given places."""
    starts = (edges[0], *(door + 1.1 for door in doors))
    return [(start, y, end, y + 0.2) for start, end in zip(starts, (*doors, edges[-1]), strict=True)]


def _corners(rectangle: Rectangle) -> list[tuple[float, float]]:
    xmin, ymin, xmax, ymax = rectangle
    return [(xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax), (xmin, ymin)]


def _feature(ring: list[tuple[float, float]], properties: dict[str, Any]) -> dict[str, Any]:
    rounded = [[round(x, 3), round(y, 3)] for x, y in ring]
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [rounded]}}


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent)
