"""MovingAI grid maps (`.map`), as in the benchmarks of N. Sturtevant (IEEE T-CIAIG 4(2), 2012).

Four lines of header (type, height, width, map), then one character per cell, the first row at the top. '.' and 'G' are
ground and 'S' is swamp: passable. '@' and 'O' are out of bounds, 'T' trees and 'W' water, which nothing enters from the
ground: not passable. (Format: movingai.com/benchmarks/formats.html)
"""

from __future__ import annotations

import re
from pathlib import Path
from reprlib import repr as short

import numpy as np

from driftplan.arrays import positive
from driftplan.errors import MapError, naming
from driftplan.files import read_bytes
from driftplan.world.cells import MAX_COARSENED, cells_of_outline, fewer_cells, outline_of_cells, refuse_too_many
from driftplan.world.world import World

_SIZE = rb"\s+0*([1-9]\d{0,8})"
_HEADER = {"type octile": rb"type\s+(?:octile|tile)", "height N": rb"height" + _SIZE, "width N": rb"width" + _SIZE}
_HEADER["map"] = rb"map"
_PASSABLE = b".GS"
_BLOCKED = b"@OTW"
_MAX_BYTES = MAX_COARSENED + (1 << 20)


def read_movingai_map(
    path: Path,
    *,
    robot_radius: float,
    cell_size_m: float = 1.0,
    coarsen: int | None = None,
    despeckle_m: float | None = None,
) -> World:
    """World of a `.map` file, its lower left corner at the origin."""
    size = positive("cell_size_m", cell_size_m)
    lines = read_bytes(path, MapError, max_bytes=_MAX_BYTES).rstrip().replace(b"\r", b"").split(b"\n")
    height, width = _read_header(path, lines[:4], coarsen)
    rows = lines[4:]
    if len(rows) != height:
        raise MapError(f"{path}: expected {height} rows of cells after the header, got {len(rows)}")
    for number, row in enumerate(rows, start=5):
        if len(row) != width:
            raise MapError(f"{path}, line {number}: expected {width} cells, got {len(row)}")
    cells = np.frombuffer(b"".join(rows), dtype=np.uint8).reshape(height, width)
    known = np.isin(cells, np.frombuffer(_PASSABLE + _BLOCKED, dtype=np.uint8))
    if not known.all():
        row, column = np.argwhere(~known)[0]
        where, wanted = f"line {row + 5}, column {column + 1}", (_PASSABLE + _BLOCKED).decode()
        raise MapError(f"{path}, {where}: expected one of {wanted}, got {bytes([cells[row, column]])!r}")
    passable = np.isin(cells, np.frombuffer(_PASSABLE, dtype=np.uint8))
    occupied, size, said = fewer_cells(~passable[::-1], size, coarsen=coarsen, despeckle_m=despeckle_m)
    notes = tuple(f"{path}: {note}" for note in said)
    with naming(path, MapError):
        obstacles, bounds = outline_of_cells(occupied, cell_size_m=size, origin=(0.0, 0.0, 0.0))
    return World(obstacles=obstacles, bounds=bounds, robot_radius=robot_radius, notes=notes)


def movingai_map_files(world: World, path: Path, *, cell_size_m: float) -> dict[Path, bytes]:
    """Contents of the file to write."""
    if world.bounds[:2] != (0.0, 0.0):
        raise ValueError(f"a .map file has no origin: expected bounds that start at (0, 0), got {world.bounds}")
    occupied = cells_of_outline(world.obstacles, world.bounds, cell_size_m)[::-1]
    rows = [row.tobytes() for row in np.where(occupied, np.uint8(ord("@")), np.uint8(ord(".")))]
    header = b"type octile\nheight %d\nwidth %d\nmap\n" % occupied.shape
    return {path: header + b"\n".join(rows) + b"\n"}


def _read_header(path: Path, lines: list[bytes], coarsen: int | None) -> tuple[int, int]:
    """Height and width."""
    sizes = list[int]()
    for number, ((wanted, pattern), line) in enumerate(zip(_HEADER.items(), lines + 4 * [b""], strict=False), start=1):
        if not (found := re.fullmatch(pattern, line.strip())):
            raise MapError(f"{path}, line {number}: expected {wanted!r}, got {short(line) if line else 'nothing'}")
        sizes += map(int, found.groups())
    height, width = sizes
    with naming(path, MapError):
        refuse_too_many(width, height, coarsen)
    return height, width
