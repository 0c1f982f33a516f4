"""DXF drawings: lines and polylines are walls; and drawings of worlds, routes and beacons for whoever installs them.

Units come from the header ($INSUNITS); closed polylines are solid, lines are 5 cm thick. Needs ``ezdxf``.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import cos, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from driftplan.arrays import Floats, finite
from driftplan.errors import MapError, naming
from driftplan.files import head, read_bytes
from driftplan.world.formats import Mark
from driftplan.world.world import World

_MAX_BYTES = 50_000_000
_MAX_LINES = 50_000
_WALL_M = 0.05
_MARGIN_M = 0.5  # of the map around what is drawn
_UNITS_M = {1: 0.0254, 2: 0.3048, 4: 1e-3, 5: 1e-2, 6: 1.0, 14: 0.1}
_METRES = 6
_APP = "DRIFTPLAN"  # whose data points carry


def read_dxf_map(path: Path, *, robot_radius: float) -> World:
    """World of the lines and polylines in a drawing's model space, on layers that are not off or frozen; everything
    else is passed over, and said."""
    drawing = _drawing(path)
    unit = _unit(path, drawing)
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
            corners = finite("corners", corners).reshape(-1, 2) * unit
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


def read_dxf_marks(path: Path) -> list[Mark]:
    """The points of the layer BEACONS, with their ids and directions if `drawing_of` drew them."""
    drawing = _drawing(path)
    unit, marks = _unit(path, drawing), list[Mark]()
    for point in drawing.modelspace().query('POINT[layer=="BEACONS"]'):
        tags = point.get_xdata(_APP) if point.has_xdata(_APP) else []
        said = {tag.code: tag.value for tag in tags}
        x, y = (point.dxf.location.vec2 * unit).round(9)
        marks.append(Mark(said.get(1000, str(len(marks))), x, y, said.get(1040)))
    return marks


def drawing_of(
    world: World | None,
    routes: Sequence[Floats] = (),
    marks: Sequence[Mark] = (),
    ranges: Iterable[tuple[float, float, float]] = (),
    distances: Iterable[tuple[Sequence[float], Sequence[float]]] = (),
) -> bytes:
    """A drawing in metres: layers WALLS, ROUTES, BEACONS with ids, circles (x, y, radius) for their ranges and lines
    for the ways they face, and DISTANCES with dimensions from one point to another."""
    drawing = _ezdxf().new("R2010", setup=["dimstyles"], units=_METRES)
    drawing.appids.add(_APP)
    drawing.header.custom_vars.append(_APP, head("map")[2:-1])
    for name, colour in (("WALLS", 7), ("ROUTES", 5), ("BEACONS", 1), ("DISTANCES", 3)):
        drawing.layers.add(name, color=colour)
    model = drawing.modelspace()
    for ring in shapely.get_rings(shapely.get_parts(world.obstacles)) if world is not None else ():
        model.add_lwpolyline(shapely.get_coordinates(ring)[:-1], close=True, dxfattribs={"layer": "WALLS"})
    for route in routes:
        model.add_lwpolyline(route.tolist(), dxfattribs={"layer": "ROUTES"})
    on_top = {"layer": "BEACONS"}
    for mark in marks:
        point = model.add_point((mark.x, mark.y), dxfattribs=on_top)
        facing = [] if mark.facing_deg is None else [(1040, mark.facing_deg)]
        point.set_xdata(_APP, [(1000, mark.name), *facing])
        text = f"{mark.name} ({mark.x:.2f}, {mark.y:.2f})"
        model.add_text(text, height=0.2, dxfattribs=on_top).set_placement((mark.x + 0.1, mark.y + 0.1))
        if mark.facing_deg is not None:
            ahead = radians(mark.facing_deg)
            model.add_line((mark.x, mark.y), (mark.x + cos(ahead), mark.y + sin(ahead)), dxfattribs=on_top)
    for x, y, range_m in ranges:
        model.add_circle((x, y), range_m, dxfattribs=on_top)
    for start, end in distances:
        dimension = model.add_aligned_dim(start, end, 0.0, "EZ_M_100_H25_CM", dxfattribs={"layer": "DISTANCES"})
        dimension.render()
    written = io.StringIO()
    drawing.write(written)
    return written.getvalue().encode()


def _corners(entity: Any) -> tuple[Any, bool]:
    if entity.dxftype() == "LINE":
        return [entity.dxf.start.vec2, entity.dxf.end.vec2], False
    if entity.dxftype() == "LWPOLYLINE":
        return np.array(entity.get_points("xy")), bool(entity.closed)
    return [vertex.dxf.location.vec2 for vertex in entity.vertices], bool(entity.is_closed)


def _unit(path: Path, drawing: Any) -> float:
    """Metres."""
    unit = drawing.header.get("$INSUNITS", 0)
    if unit not in _UNITS_M:
        raise MapError(
            f"{path}: expected a drawing in metres, cm, mm, dm, inches or feet, got $INSUNITS {unit}: set its units"
        )
    return _UNITS_M[unit]


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
        raise ImportError("DXF drawings need ezdxf: pip install driftplan[dxf]") from err
    return ezdxf
