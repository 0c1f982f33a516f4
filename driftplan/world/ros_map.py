"""ROS map_server maps: a YAML file and the picture it names.

Formats and formulas: ROS 2 nav2_map_server (map_io.cpp) and the map_server page of the ROS wiki. A pixel's grey, the
mean of its colours, gives the probability p that its cell is occupied; p >= occupied_thresh is occupied, p <=
free_thresh is free, what lies between is unknown, and so is what is not opaque. That is map_server's rule for
'trinary'. Its 'scale' and 'raw' publish p as a whole percentage and leave the decision to the reader; driftplan decides
by the same thresholds. Keys that it does not know map_server passes over, and so does driftplan.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from reprlib import repr as short
from typing import Any

import numpy as np
from numpy.typing import NDArray

from driftplan.arrays import number
from driftplan.errors import MapError, naming
from driftplan.files import head
from driftplan.world.cell_pictures import read_header, read_pixels
from driftplan.world.cells import cells_of_outline, fewer_cells, outline_of_cells
from driftplan.world.world import World

RULE_KEYS = ("negate", "occupied_thresh", "free_thresh", "mode", "map_type")  # that say what pixels are
_MODES = ("trinary", "scale", "raw")
_FREE, _UNKNOWN, _OCCUPIED = 0, 1, 2
_SAVED_UNKNOWN = 205
_ROWS_AT_ONCE = 256  # of a picture, to bound the memory


@dataclass(frozen=True)
class _Rule:
    """What pixels mean."""

    negate: bool
    occupied_thresh: float
    free_thresh: float
    mode: str


def read_ros_map(
    path: Path,
    *,
    robot_radius: float,
    unknown_is_free: bool = False,
    coarsen: int | None = None,
    despeckle_m: float | None = None,
) -> World:
    """World of a YAML map and its picture; unknown cells are obstacles unless told otherwise."""
    picture = read_header(path, RULE_KEYS[:3])
    rule = _rule(path, picture.values)
    pixels = read_pixels(picture.image, path, colour=True, coarsen=coarsen)
    states = np.empty(pixels.shape[:2], dtype=np.uint8)
    for top in range(0, len(pixels), _ROWS_AT_ONCE):
        states[top : top + _ROWS_AT_ONCE] = _states(pixels[top : top + _ROWS_AT_ONCE], rule)
    notes = picture.notes
    unknown_grey = states[pixels == _SAVED_UNKNOWN] if pixels.dtype == np.uint8 and pixels.ndim == 2 else states[:0]
    if rule.mode != "raw" and (unknown_grey == _FREE).any():
        notes += (
            f"{path}: grey {_SAVED_UNKNOWN}, which savers of maps write for unknown, is free by its free_thresh of "
            f"{rule.free_thresh:g}, as map_server has it; {'mode: trinary with ' * (rule.mode == 'scale')}free_thresh: "
            "0.196 keeps it unknown",
        )
    occupied = (states == _OCCUPIED if unknown_is_free else states != _FREE)[::-1]  # row 0 at the bottom
    occupied, size, said = fewer_cells(occupied, picture.resolution, coarsen=coarsen, despeckle_m=despeckle_m)
    with naming(picture.image, MapError):
        obstacles, bounds = outline_of_cells(occupied, cell_size_m=size, origin=picture.origin)
    notes += tuple(f"{path}: {note}" for note in said)
    return World(obstacles=obstacles, bounds=bounds, robot_radius=robot_radius, notes=notes)


def ros_map_files(world: World, path: Path, *, cell_size_m: float) -> dict[Path, bytes]:
    """Contents of the files to write: the picture first, then the YAML that names it."""
    occupied = cells_of_outline(world.obstacles, world.bounds, cell_size_m)
    picture = path.with_suffix(".pgm")
    pixels = np.where(occupied[::-1], 0, 254).astype(np.uint8)  # the greys that map_saver writes
    content = BytesIO()
    content.write(b"P5\n%d %d\n255\n" % (pixels.shape[1], pixels.shape[0]))
    content.write(pixels.tobytes())
    text = (
        f"{head('map')}image: {picture.name}\nmode: trinary\nresolution: {cell_size_m!r}\n"
        f"origin: [{world.bounds[0]!r}, {world.bounds[1]!r}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    return {picture: content.getvalue(), path: text.encode()}


def _rule(path: Path, values: dict[Any, Any]) -> _Rule:
    with naming(path, MapError):
        occupied, free = (number(key, values[key]) for key in ("occupied_thresh", "free_thresh"))
    if not 0 <= free < occupied <= 1:
        raise MapError(f"{path}: expected 0 <= free_thresh < occupied_thresh <= 1, got {free!r} and {occupied!r}")
    if not (isinstance(values["negate"], (bool, int)) and values["negate"] in (0, 1)):
        raise MapError(f"{path}: expected negate to be 0 or 1, got {short(values['negate'])}")
    mode = str(values.get("mode", "trinary")).lower()
    if mode not in _MODES:
        raise MapError(f"{path}: expected mode to be one of {', '.join(_MODES)}, got {short(values['mode'])}")
    return _Rule(bool(values["negate"]), occupied, free, mode)


def _states(pixels: NDArray[Any], rule: _Rule) -> NDArray[np.uint8]:
    """Free, unknown or occupied for pixels (rows, columns) of grey or (rows, columns, 3 or 4) of colour."""
    light = pixels if pixels.dtype == np.uint8 else pixels / 257.0  # 16 bits of grey
    known: Any = True
    if light.ndim == 3:
        known = light[..., 3] == 255 if light.shape[2] == 4 else True
        light = light[..., :3].mean(axis=2)
    if rule.mode == "raw":  # the pixel is the percentage, whatever negate says; above 100 is unknown
        p, known = np.rint(light) / 100.0, known & (np.rint(light) <= 100)
    else:
        p = (light if rule.negate else 255.0 - light) / 255.0
        if rule.mode == "scale":  # published in whole percent of the way between the thresholds, from 0 (free) to 100
            span = rule.occupied_thresh - rule.free_thresh
            p = rule.free_thresh + np.rint(100 * (p - rule.free_thresh) / span) / 100 * span
    states = np.full(p.shape, _UNKNOWN, dtype=np.uint8)
    states[known & (p >= rule.occupied_thresh)] = _OCCUPIED
    states[known & (p <= rule.free_thresh)] = _FREE
    return states
