"""DXF drawings: lines and polylines are walls; and drawings of worlds, routes and beacons for whoever installs them.

Units come from the header ($INSUNITS); closed polylines are solid, lines are 5 cm thick. Needs ``ezdxf``.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from math import cos, radians, sin
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from driftplan.arrays import Floats, finite
from driftplan.errors import MapError, naming
from driftplan.files import read_bytes
from driftplan.world.world import World

_MAX_BYTES = 50_000_000
_MAX_LINES = 50_000
_WALL_M = 0.05
_MARGIN_M = 0.5  # of the map around what is drawn
_UNITS_M = {1: 0.0254, 2: 0.3048, 4: 1e-3, 5: 1e-2, 6: 1.0, 14: 0.1}
_METRES = 6


class Mark(NamedTuple):
    """A thing to install: where, which way it faces (degrees), how far it is read."""

    name: str
    x: float
    y: float
    facing_deg: float | None
    range_m: float


def read_dxf_map(path: Path, *, robot_radius: float) -> World:
    """World of the lines and polylines in a drawing's model space, on layers that are not off or frozen; everything
    else is passed over, and said."""
    drawing = _drawing(path)
    unit = drawing.header.get("$INSUNITS", 0)
    if unit not in _UNITS_M:
        raise MapError(
            f"{path}: expected a drawing in metres, cm, mm, dm, inches or feet, got $INSUNITS {unit}: set its units"
        )
    hidden = {layer.dxf.name for layer in drawing.layers if layer.is_off() or layer.is_frozen()}
    walls: list[Any] = []
    passed: set[str] = set()
    with naming(path, MapError):
        for entity in drawing.modelspace():
            if entity.dxf.layer in hidden:
                continue
            if entity.dxftype() not in ("LINE", "LWPOLYLINE", "POLYLINE"):
                passed.add(entity.dxftype())
                continue
            corners, closed = _corners(entity)
            corners = finite("corners", corners).reshape(-1, 2) * _UNITS_M[unit]
            solid = closed and len(corners) > 2
            line = shapely.LineString([*corners, *corners[:1]] if closed else corners)
            wall = shapely.buffer(line, _WALL_M / 2, cap_style="square", join_style="mitre")
            walls.append(shapely.union(wall, shapely.make_valid(shapely.Polygon(corners))) if solid else wall)
            if len(walls) > _MAX_LINES:
                raise ValueError(f"expected at most {_MAX_LINES} lines, got more")
        if not walls:
            raise ValueError(f"expected lines or polylines, got {', '.join(sorted(passed)) or 'nothing'}")
        xmin, ymin, xmax, ymax = shapely.total_bounds(walls).tolist()
        bounds = (xmin - _MARGIN_M, ymin - _MARGIN_M, xmax + _MARGIN_M, ymax + _MARGIN_M)
        note = f"{path}: passed over {', '.join(sorted(passed))}: only lines and polylines are walls"
        world = World.from_polygons(walls, bounds=bounds, robot_radius=robot_radius)
        return replace(world, notes=(note,) if passed else ())


def drawing_of(world: World | None, routes: Sequence[Floats] = (), marks: Sequence[Mark] = ()) -> bytes:
    """A drawing in metres: layers WALLS, ROUTES, and BEACONS with ids and ranges, and a line for the way they face."""
    drawing = _ezdxf().new("R2010", setup=False, units=_METRES)
    for name, colour in (("WALLS", 7), ("ROUTES", 5), ("BEACONS", 1)):
        drawing.layers.add(name, color=colour)
    model = drawing.modelspace()
    for ring in shapely.get_rings(shapely.get_parts(world.obstacles)) if world is not None else ():
        model.add_lwpolyline(shapely.get_coordinates(ring)[:-1], close=True, dxfattribs={"layer": "WALLS"})
    for route in routes:
        model.add_lwpolyline(route.tolist(), dxfattribs={"layer": "ROUTES"})
    on_top = {"layer": "BEACONS"}
    for mark in marks:
        model.add_point((mark.x, mark.y), dxfattribs=on_top)
        model.add_circle((mark.x, mark.y), mark.range_m, dxfattribs=on_top)
        text = f"{mark.name} ({mark.x:.2f}, {mark.y:.2f})"
        model.add_text(text, height=0.2, dxfattribs=on_top).set_placement((mark.x + 0.1, mark.y + 0.1))
        if mark.facing_deg is not None:
            ahead = radians(mark.facing_deg)
            model.add_line((mark.x, mark.y), (mark.x + cos(ahead), mark.y + sin(ahead)), dxfattribs=on_top)
    written = io.StringIO()
    drawing.write(written)
    return written.getvalue().encode()


def _corners(entity: Any) -> tuple[Any, bool]:
    if entity.dxftype() == "LINE":
        return [entity.dxf.start.vec2, entity.dxf.end.vec2], False
    if entity.dxftype() == "LWPOLYLINE":
        return np.array(entity.get_points("xy")), bool(entity.closed)
    return [vertex.dxf.location.vec2 for vertex in entity.vertices], bool(entity.is_closed)


def _drawing(path: Path) -> Any:
    library = _ezdxf()
    content = read_bytes(path, MapError, max_bytes=_MAX_BYTES)
    try:
        return library.read(io.StringIO(content.decode("utf-8-sig", errors="surrogateescape")))
    except Exception as err:  # whatever a broken drawing leads the library into
        raise MapError(f"{path}: not a readable DXF drawing ({type(err).__name__}: {str(err)[:200]})") from err


def _ezdxf() -> Any:
    try:
        import ezdxf
    except ImportError as err:
        raise ImportError("DXF drawings need ezdxf: pip install ezdxf") from err
    return ezdxf
