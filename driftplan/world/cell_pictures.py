"""Pictures of cells: a small YAML file, the picture it names, and where on the floor the picture lies.

What ROS maps and rasters of zones have in common. Both may come from anybody, so sizes are checked before anything is
read, and a name must not lead out of the map's folder.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path, PureWindowsPath
from reprlib import repr as short
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from driftplan.arrays import number
from driftplan.errors import MapError, naming
from driftplan.files import read_bytes
from driftplan.world.cells import MAX_CELLS, refuse_too_many
from driftplan.world.plain_data import read_yaml

_MAX_YAML_BYTES = 8192
_MIN_RESOLUTION_M = 1e-6
_PLACED = ("image", "resolution", "origin")


@dataclass(frozen=True)
class CellPicture:
    """A YAML file and its picture.

    Attributes
    ----------
    image : where the picture is
    resolution : metres per pixel
    origin : the pose (x, y, yaw) of its lower left corner
    values : of all keys of the YAML file
    notes : what a person might not expect
    """

    image: Path
    resolution: float
    origin: tuple[float, float, float]
    values: dict[Any, Any]
    notes: tuple[str, ...] = ()


def read_header(path: Path, required: Sequence[str], allowed: Sequence[str] | None = None) -> CellPicture:
    """What a YAML file says about its picture.

    Other keys than those ``required`` and ``allowed`` are refused. With none ``allowed`` it is lenient, as map_server
    is: they are passed over, and a picture that is not where it was is looked for beside the file.
    """
    values = read_yaml(path, MapError, max_bytes=_MAX_YAML_BYTES)
    required = (*_PLACED, *required)
    if not isinstance(values, dict):
        raise MapError(f"{path}: expected the keys {', '.join(required)}, got {short(values)}")
    for key in required:
        if key not in values:
            raise MapError(f"{path}: the key {key!r} is missing")
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
            picture: Image.Image = Image.open(BytesIO(content), formats=("PPM", "PNG", "BMP"))
        with picture:
            with naming(image, MapError):
                refuse_too_many(*picture.size, coarsen)
            if not colour and picture.mode not in ("1", "L", "I", "I;16"):
                raise MapError(f"{image}: expected a picture of greys, got one of mode {picture.mode}")
            picture.load()
            if picture.mode in ("PA", "LA") or (colour and "transparency" in picture.info):
                picture = picture.convert("RGBA")
            elif picture.mode == "P":
                picture = picture.convert("RGB")
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
