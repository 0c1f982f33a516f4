"""ROS map_server maps: a YAML file and the picture it names.

Formats and formulas: ROS 2 nav2_map_server (map_io.cpp) and the map_server page of the ROS wiki. A pixel gives the
probability p that its cell is occupied; p > occupied_thresh is occupied, p < free_thresh is free, what lies between is
unknown. That is map_server's rule for 'trinary'. Its 'scale' and 'raw' publish p as a percentage and leave the decision
to the reader; driftplan decides by the same thresholds.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from reprlib import repr as short
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from driftplan.errors import MapError, naming
from driftplan.world.cell_pictures import CellPicture, number, read_header, read_pixels
from driftplan.world.cells import cells_of_outline, outline_of_cells
from driftplan.world.world import World

_MODES = ("trinary", "scale", "raw")
_FREE, _UNKNOWN, _OCCUPIED = 0, 1, 2
_ROWS_AT_ONCE = 256  # of a picture, to bound the memory


@dataclass(frozen=True)
class _Header:
    picture: CellPicture
    negate: bool
    occupied_thresh: float
    free_thresh: float
    mode: str


def read_ros_map(path: Path, *, robot_radius: float, unknown_is_free: bool) -> World:
    """World of a YAML map and its picture; unknown cells are obstacles unless told otherwise."""
    header = _read_header(path)
    picture, states = header.picture, _read_states(header, path)
    occupied = states == _OCCUPIED if unknown_is_free else states != _FREE
    with naming(picture.image, MapError):
        obstacles, bounds = outline_of_cells(occupied, cell_size_m=picture.resolution, origin=picture.origin)
    return World(obstacles=obstacles, bounds=bounds, robot_radius=robot_radius)


def ros_map_files(world: World, path: Path, *, cell_size_m: float) -> dict[Path, bytes]:
    """Contents of the files to write: the picture first, then the YAML that names it."""
    occupied = cells_of_outline(world.obstacles, world.bounds, cell_size_m)
    picture = path.with_suffix(".pgm")
    pixels = np.where(occupied[::-1], 0, 254).astype(np.uint8)  # the greys that map_saver writes
    content = BytesIO()
    content.write(b"P5\n%d %d\n255\n" % (pixels.shape[1], pixels.shape[0]))
    content.write(pixels.tobytes())
    text = (
        f"image: {picture.name}\nmode: trinary\nresolution: {cell_size_m!r}\n"
        f"origin: [{world.bounds[0]!r}, {world.bounds[1]!r}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    return {picture: content.getvalue(), path: text.encode()}


def _read_header(path: Path) -> _Header:
    picture, said = read_header(path, ("negate", "occupied_thresh", "free_thresh"), ("mode",))
    occupied, free = (number(path, key, said[key]) for key in ("occupied_thresh", "free_thresh"))
    if not 0 <= free < occupied <= 1:
        raise MapError(f"{path}: expected 0 <= free_thresh < occupied_thresh <= 1, got {free!r} and {occupied!r}")
    if not (isinstance(said["negate"], (bool, int)) and said["negate"] in (0, 1)):
        raise MapError(f"{path}: expected negate to be 0 or 1, got {short(said['negate'])}")
    mode = said.get("mode", "trinary")
    if mode not in _MODES:
        raise MapError(f"{path}: expected mode to be one of {', '.join(_MODES)}, got {short(mode)}")
    return _Header(picture, bool(said["negate"]), occupied, free, mode)


def _read_states(header: _Header, path: Path) -> NDArray[np.uint8]:
    """Free, unknown or occupied for every cell, row 0 at the bottom."""
    pixels = read_pixels(header.picture.image, path, colour=True)
    states = np.empty(pixels.shape[:2], dtype=np.uint8)
    for top in range(0, len(pixels), _ROWS_AT_ONCE):
        states[top : top + _ROWS_AT_ONCE] = _states(pixels[top : top + _ROWS_AT_ONCE], header)
    return states[::-1]


def _states(pixels: NDArray[Any], header: _Header) -> NDArray[np.uint8]:
    """Free, unknown or occupied for pixels (rows, columns) of grey or (rows, columns, 3 or 4) of colour."""
    if pixels.dtype == np.uint8:
        light = pixels.astype(float)
    else:  # 16 bits of grey
        light = pixels / 257.0
    opaque: Any = True
    if light.ndim == 3:
        channels = light.shape[2]
        opaque = light[..., 3] == 255 if channels == 4 else True
        # map_server averages transparency in with the colours, but for 'scale'; nav2 also leaves it out for 'raw'.
        light = light.mean(axis=2) if header.mode == "trinary" else light[..., :3].mean(axis=2)
    if header.mode == "raw":  # the pixel is the percentage, whatever negate says; above 100 is unknown
        percent = np.rint(light)
        p, known = percent / 100.0, percent <= 100
    else:
        p = (light if header.negate else 255 - light) / 255.0
        known = opaque if header.mode == "scale" else np.True_
    states = np.full(p.shape, _UNKNOWN, dtype=np.uint8)
    states[known & (p > header.occupied_thresh)] = _OCCUPIED
    states[known & (p < header.free_thresh)] = _FREE
    return cast("NDArray[np.uint8]", states)
