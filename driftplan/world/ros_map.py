"""ROS map_server maps: a YAML file and the picture it names.

Formats and formulas: ROS 2 nav2_map_server (map_io.cpp) and the map_server page of the ROS wiki. A pixel gives the
probability p that its cell is occupied; p > occupied_thresh is occupied, p < free_thresh is free, what lies between is
unknown. That is map_server's rule for 'trinary'. Its 'scale' and 'raw' publish p as a percentage and leave the decision
to the reader; driftplan decides by the same thresholds.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from io import BytesIO
from math import isfinite
from pathlib import Path
from reprlib import repr as short
from typing import Any, cast

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from driftplan.errors import MapError
from driftplan.world.cells import MAX_CELLS, cells_of_outline, outline_of_cells
from driftplan.world.world import World

_MODES = ("trinary", "scale", "raw")
_REQUIRED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
_MAX_YAML_BYTES = 8192
_FREE, _UNKNOWN, _OCCUPIED = 0, 1, 2
_ROWS_AT_ONCE = 256  # of a picture, to bound the memory


@dataclass(frozen=True)
class _Header:
    image: Path
    resolution: float
    origin: tuple[float, float, float]
    negate: bool
    occupied_thresh: float
    free_thresh: float
    mode: str


def read_ros_map(path: Path, *, robot_radius: float, unknown_is_free: bool) -> World:
    """World of a YAML map and its picture; unknown cells are obstacles unless told otherwise."""
    header = _read_header(path)
    states = _read_states(header, path)
    occupied = states == _OCCUPIED if unknown_is_free else states != _FREE
    try:
        obstacles, bounds = outline_of_cells(occupied, cell_size_m=header.resolution, origin=header.origin)
    except ValueError as err:
        raise MapError(f"{header.image}: {err}") from err
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


class _PlainLoader(yaml.SafeLoader):
    """The safe loader without aliases: a few hundred bytes of them can stand for more than memory holds."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "aliases have no place in a map's header", event.start_mark)
        return super().compose_node(parent, index)


def _read_header(path: Path) -> _Header:
    with path.open("rb") as file:
        text = file.read(_MAX_YAML_BYTES + 1)
    if len(text) > _MAX_YAML_BYTES:
        raise MapError(f"{path}: expected a map's YAML of at most {_MAX_YAML_BYTES} bytes, got more")
    try:
        said = yaml.load(text, _PlainLoader)
    except yaml.MarkedYAMLError as err:
        line = err.problem_mark.line + 1 if err.problem_mark else "?"
        raise MapError(f"{path}, line {line}: not plain YAML: {err.problem}") from err
    except (yaml.YAMLError, ValueError, RecursionError) as err:
        raise MapError(f"{path}: not plain YAML: {str(err)[:200]}") from err
    if not isinstance(said, dict):
        raise MapError(f"{path}: expected the keys {', '.join(_REQUIRED)}, got {short(said)}")
    for key in _REQUIRED:
        if key not in said:
            raise MapError(f"{path}: the key {key!r} is missing")
    for key in said:
        if key not in (*_REQUIRED, "mode"):
            raise MapError(f"{path}: unknown key {short(key)}; known are {', '.join(_REQUIRED)} and mode")
    resolution = _number(path, "resolution", said["resolution"])
    if resolution <= 0:
        raise MapError(f"{path}: expected resolution > 0 m per cell, got {resolution!r}")
    origin = said["origin"]
    if not (isinstance(origin, list) and len(origin) == 3):
        raise MapError(f"{path}: expected origin to be [x, y, yaw], got {short(origin)}")
    x, y, yaw = (_number(path, "origin", value) for value in origin)
    occupied, free = (_number(path, key, said[key]) for key in ("occupied_thresh", "free_thresh"))
    if not 0 <= free < occupied <= 1:
        raise MapError(f"{path}: expected 0 <= free_thresh < occupied_thresh <= 1, got {free!r} and {occupied!r}")
    if not (isinstance(said["negate"], (bool, int)) and said["negate"] in (0, 1)):
        raise MapError(f"{path}: expected negate to be 0 or 1, got {short(said['negate'])}")
    mode = said.get("mode", "trinary")
    if mode not in _MODES:
        raise MapError(f"{path}: expected mode to be one of {', '.join(_MODES)}, got {short(mode)}")
    image = _picture_beside(path, said["image"])
    return _Header(image, resolution, (x, y, yaw), bool(said["negate"]), occupied, free, mode)


def _number(path: Path, key: str, value: Any) -> float:
    try:
        # YAML 1.1 takes 5e-2 for a word; map_server takes it for a number.
        number = float(value) if isinstance(value, (int, float, str)) and not isinstance(value, bool) else float("nan")
    except (ValueError, OverflowError):
        number = float("nan")
    if not (isfinite(number) and abs(number) < 1e9):
        raise MapError(f"{path}: expected {key} to be a finite number, got {short(value)}")
    return number


def _picture_beside(path: Path, name: Any) -> Path:
    """The picture that a map names, if it is a file in the map's folder or below."""
    if not isinstance(name, str) or not name:
        raise MapError(f"{path}: expected image to be a file name, got {short(name)}")
    try:
        picture = (path.parent / name).resolve()
        # Two folders, because installed maps are often links into a source folder.
        inside = any(picture.is_relative_to(folder) for folder in (path.parent.resolve(), path.resolve().parent))
        exists = picture.is_file()
    except (ValueError, OSError) as err:
        raise MapError(f"{path}: expected image to be a file name, got {short(name)}") from err
    if not inside:
        raise MapError(f"{path}: image {short(name)} lies outside the map's folder; put it beside the map")
    if not exists:
        raise MapError(f"{path}: image {short(name)} is not a file")
    return picture


def _read_states(header: _Header, path: Path) -> NDArray[np.uint8]:
    """Free, unknown or occupied for every cell, row 0 at the bottom."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # our own limit is lower
            picture: Image.Image = Image.open(header.image, formats=("PPM", "PNG", "BMP"))
        with picture:
            width, height = picture.size
            if not 0 < width * height <= MAX_CELLS:
                raise MapError(f"{header.image}: expected at most {MAX_CELLS} pixels, got {width} x {height}")
            picture.load()
            if picture.mode in ("P", "PA", "LA") or "transparency" in picture.info:
                picture = picture.convert("RGBA")
            elif picture.mode == "1":
                picture = picture.convert("L")
            pixels = np.asarray(picture)
    except MapError:
        raise
    except Image.DecompressionBombError as err:
        raise MapError(f"{header.image}: expected at most {MAX_CELLS} pixels, got far more") from err
    except Exception as err:  # decoders raise nearly anything on broken files
        raise MapError(
            f"{header.image}: not a readable PGM, PNG or BMP picture (image of {path}): {str(err)[:200]}"
        ) from err
    states = np.empty((height, width), dtype=np.uint8)
    for top in range(0, height, _ROWS_AT_ONCE):
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
