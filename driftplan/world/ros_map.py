"""ROS map_server maps: a YAML file and the picture it names.

Formats and formulas: ROS 2 nav2_map_server (map_io.cpp) and the map_server page of the ROS wiki. A pixel's grey, the
mean of its colours, gives the probability p that its cell is occupied; p >= occupied_thresh is occupied, p <=
free_thresh is free, what lies between is unknown, and so is what is not opaque. That is map_server's rule for
'trinary'. Its 'scale' and 'raw' publish p as a whole percentage and leave the decision to the reader; driftplan decides
by the same thresholds. Keys that it does not know map_server passes over, and so does driftplan.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path, PureWindowsPath
from reprlib import repr as short
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from driftplan.arrays import number
from driftplan.errors import MapError, naming
from driftplan.files import head, read_bytes
from driftplan.world.cells import MAX_CELLS, cells_of_outline, fewer_cells, outline_of_cells, refuse_too_many
from driftplan.world.plain_data import read_yaml
from driftplan.world.world import World

_MAX_YAML_BYTES = 8192
_MIN_RESOLUTION_M = 1e-6
_PLACED = ("image", "resolution", "origin")


class CellPicture(NamedTuple):
    """A YAML file and its picture."""

    image: Path  # where the picture is
    resolution: float  # metres per pixel
    origin: tuple[float, float, float]  # the pose (x, y, yaw) of its lower left corner
    values: dict[Any, Any]  # of all keys of the YAML file
    notes: tuple[str, ...] = ()  # what a person might not expect


def read_header(path: Path, required: Sequence[str], allowed: Sequence[str] | None = None) -> CellPicture:
    """What a YAML file says about its picture.

    Both may come from anybody: sizes are checked before anything is read, and a name must not lead out of the folder.

    Other keys than those ``required`` and ``allowed`` are refused. With none ``allowed`` it is lenient, as map_server
    is: they are passed over, and a picture that is not where it was is looked for beside the file.
    """
    values = read_yaml(path, MapError, max_bytes=_MAX_YAML_BYTES)
    required = (*_PLACED, *required)
    if not isinstance(values, dict):
        raise MapError(f"{path}: expected the keys {', '.join(required)}, got {short(values)}")
    if missing := [key for key in required if key not in values]:
        raise MapError(f"{path}: the key {missing[0]!r} is missing")
    known = (*required, *(values if allowed is None else allowed))
    if unknown := [key for key in values if key not in known]:
        raise MapError(f"{path}: unknown key {short(unknown[0])}; known are {', '.join(known)}")
    origin = values["origin"]
    if not (isinstance(origin, list) and len(origin) == 3):
        raise MapError(f"{path}: expected origin to be [x, y, yaw], got {short(origin)}")
    with naming(path, MapError):
        resolution = number("resolution", values["resolution"])
        if resolution < _MIN_RESOLUTION_M:
            raise ValueError(f"expected resolution > 0 m per cell, {_MIN_RESOLUTION_M:g} at least, got {resolution!r}")
        x, y, yaw = (number("origin", value) for value in origin)
        image, notes = _picture_beside(path, values["image"], lenient=allowed is None)
    return CellPicture(image, resolution, (x, y, yaw), values, notes)


def read_pixels(image: Path, named_by: Path, *, colour: bool, coarsen: int | None = None) -> NDArray[Any]:
    """Pixels of a picture, row 0 at the top: (rows, columns) of grey, with ``colour`` also (rows, columns, 3 or 4).
    There may be more of them if they are to be coarsened."""
    content = read_bytes(image, MapError)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # our own limit is lower
            picture = Image.open(BytesIO(content), formats=("PPM", "PNG", "BMP"))
        with picture:
            with naming(image, MapError):
                refuse_too_many(*picture.size, coarsen)
            if not colour and picture.mode not in ("1", "L", "I", "I;16"):
                raise MapError(f"{image}: expected a picture of greys, got one of mode {picture.mode}")
            picture.load()
            clear = picture.mode in ("PA", "LA") or (colour and "transparency" in picture.info)
            mode = "RGBA" if clear else {"P": "RGB", "1": "L"}.get(picture.mode)
            return np.asarray(picture.convert(mode) if mode else picture)
    except MapError:
        raise
    except Image.DecompressionBombError as err:
        raise MapError(f"{image}: expected at most {MAX_CELLS} pixels, got far more") from err
    except Exception as err:  # decoders raise nearly anything on broken files
        what = f"not a readable PGM, PNG or BMP picture (image of {named_by})"
        raise MapError(f"{image}: {what}: {str(err)[:200]}") from err


def _picture_beside(path: Path, name: Any, *, lenient: bool) -> tuple[Path, tuple[str, ...]]:
    """The picture that a map names, if it is a file in the map's folder or below; and what is to be said about it."""
    if not isinstance(name, str) or not name:
        raise ValueError(f"expected image to be a file name, got {short(name)}")
    try:
        picture = (path.parent / name).resolve()
        # Two folders, because installed maps are often links into a source folder.
        inside = any(picture.is_relative_to(folder) for folder in (path.parent.resolve(), path.resolve().parent))
        if inside and picture.is_file():
            return picture, ()
        elsewhere = PureWindowsPath(name)  # which knows either kind of slash
        beside = path.parent / elsewhere.name
        stale = lenient and not inside and elsewhere.root and beside.is_file()
        if stale and beside.resolve().parent == path.parent.resolve():
            return beside, (f"{path}: image {short(name)} is not here; {beside.name} beside the map is taken",)
    except (ValueError, OSError) as err:
        raise ValueError(f"expected image to be a file name, got {short(name)}") from err
    wrong = "is not a file" if inside else "lies outside the map's folder; put it beside the map"
    raise ValueError(f"image {short(name)} {wrong}")


RULE_KEYS = ("negate", "occupied_thresh", "free_thresh", "mode", "map_type")  # that say what pixels are
_MODES = ("trinary", "scale", "raw")
_FREE, _UNKNOWN, _OCCUPIED = 0, 1, 2
_SAVED_UNKNOWN = 205
_ROWS_AT_ONCE = 256  # of a picture, to bound the memory


class _Rule(NamedTuple):
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
        grey = f"{path}: grey {_SAVED_UNKNOWN}, which savers of maps write for unknown, is free by its free_thresh of"
        kept = f"{'mode: trinary with ' * (rule.mode == 'scale')}free_thresh: 0.196 keeps it unknown"
        notes += (f"{grey} {rule.free_thresh:g}, as map_server has it; {kept}",)
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
    content = b"P5\n%d %d\n255\n" % pixels.shape[::-1] + pixels.tobytes()
    text = (
        f"{head('map')}image: {picture.name}\nmode: trinary\nresolution: {cell_size_m!r}\n"
        f"origin: [{world.bounds[0]!r}, {world.bounds[1]!r}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    return {picture: content, path: text.encode()}


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
    known: Any = light[..., 3] == 255 if light.shape[2:] == (4,) else True
    if light.ndim == 3:
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
