"""Pictures of cells: a small YAML file, the picture it names, and where on the floor the picture lies.

What ROS maps and rasters of zones have in common. Both may come from anybody, so sizes are checked before anything is
read, and a name must not lead out of the map's folder.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from reprlib import repr as short
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from driftplan.errors import MapError
from driftplan.world.cells import MAX_CELLS
from driftplan.world.plain_yaml import read_plain_yaml

_MAX_YAML_BYTES = 8192
_PLACED = ("image", "resolution", "origin")


@dataclass(frozen=True)
class CellPicture:
    """Where the picture is, metres per pixel, and the pose (x, y, yaw) of its lower left corner."""

    image: Path
    resolution: float
    origin: tuple[float, float, float]


def read_header(
    path: Path, required: Sequence[str], optional: Sequence[str] = ()
) -> tuple[CellPicture, dict[Any, Any]]:
    """The picture that a YAML file names, and the values of all its keys."""
    said = read_plain_yaml(path, MapError, max_bytes=_MAX_YAML_BYTES)
    required = (*_PLACED, *required)
    if not isinstance(said, dict):
        raise MapError(f"{path}: expected the keys {', '.join(required)}, got {short(said)}")
    for key in required:
        if key not in said:
            raise MapError(f"{path}: the key {key!r} is missing")
    for key in said:
        if key not in (*required, *optional):
            raise MapError(f"{path}: unknown key {short(key)}; known are {', '.join((*required, *optional))}")
    resolution = number(path, "resolution", said["resolution"])
    if resolution <= 0:
        raise MapError(f"{path}: expected resolution > 0 m per cell, got {resolution!r}")
    origin = said["origin"]
    if not (isinstance(origin, list) and len(origin) == 3):
        raise MapError(f"{path}: expected origin to be [x, y, yaw], got {short(origin)}")
    x, y, yaw = (number(path, "origin", value) for value in origin)
    return CellPicture(_picture_beside(path, said["image"]), resolution, (x, y, yaw)), said


def read_pixels(image: Path, named_by: Path, *, colour: bool) -> NDArray[Any]:
    """Pixels of a picture, row 0 at the top: (rows, columns) of grey, with ``colour`` also (rows, columns, 3 or 4)."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # our own limit is lower
            picture: Image.Image = Image.open(image, formats=("PPM", "PNG", "BMP"))
        with picture:
            width, height = picture.size
            if not 0 < width * height <= MAX_CELLS:
                raise MapError(f"{image}: expected at most {MAX_CELLS} pixels, got {width} x {height}")
            if not colour and picture.mode not in ("1", "L", "I", "I;16"):
                raise MapError(f"{image}: expected a picture of greys, got one of mode {picture.mode}")
            picture.load()
            if picture.mode in ("P", "PA", "LA") or (colour and "transparency" in picture.info):
                picture = picture.convert("RGBA")
            elif picture.mode == "1":
                picture = picture.convert("L")
            return np.asarray(picture)
    except MapError:
        raise
    except Image.DecompressionBombError as err:
        raise MapError(f"{image}: expected at most {MAX_CELLS} pixels, got far more") from err
    except Exception as err:  # decoders raise nearly anything on broken files
        raise MapError(
            f"{image}: not a readable PGM, PNG or BMP picture (image of {named_by}): {str(err)[:200]}"
        ) from err


def number(path: Path, key: str, value: Any) -> float:
    """A finite number of moderate size."""
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
