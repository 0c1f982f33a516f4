"""Trajectories and paths from files: where a robot was, and where it is to go."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from driftplan.errors import TrajectoryError
from driftplan.model.calibration.recordings import Trajectory
from driftplan.world.log_tables import named, read_table
from driftplan.world.odometry_logs import read_truth

_PATH_COLUMNS = {"x": ("x_m",), "y": ("y_m",), "heading": ("heading_rad", "yaw", "yaw_rad", "theta")}


def read_trajectory(path: str | os.PathLike[str], *, rate_hz: float = 10.0) -> Trajectory:
    """Where a robot was: times, planar positions and, if the file has any, headings.

    Parameters
    ----------
    path :
        TUM (``time x y z qx qy qz qw``), KITTI (the 12 numbers of a pose matrix), or a table whose header names the
        columns (``time, x, y`` and ``heading`` in radians or ``qx, qy, qz, qw``); gzipped if it ends in ``.gz``.
        The plane is x-y. A KITTI camera looks along z with x to its right and drives in the x-z plane; its x becomes
        -y and its z becomes x, so that x is forward and y left of the first pose (REP-103).
    rate_hz : float
        Poses per second of a KITTI file, which has no times.

    Raises
    ------
    TrajectoryError
        If the file cannot be read: the message names it, and the line.

    Examples
    --------
    >>> import os, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "truth.csv")
    ...     _ = file.write_text("time,x,y,heading\\n0,0,0,0\\n1,2,0,0\\n2,2,2,1.57\\n")
    ...     read_trajectory(file).xy.tolist()
    [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0]]
    """
    return read_truth(path, rate_hz=rate_hz)


def read_path(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """Waypoints ``(n, 2)``, or poses ``(n, 3)`` with headings in radians, of a path to follow.

    Parameters
    ----------
    path :
        Text of one waypoint a line, ``x, y`` or ``x, y, heading``, with commas, semicolons or blanks between, and a
        header that names the columns or none. Lines that begin with ``#`` are comments. A unit in brackets, as in
        ``x [mm]`` or ``heading [deg]``, is converted.

    Raises
    ------
    TrajectoryError
        If the file cannot be read, has other columns or fewer than 2 waypoints: the message names it, and the line.

    Examples
    --------
    >>> import os, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "path.csv")
    ...     _ = file.write_text("x,y\\n0,0\\n5,0\\n5,3\\n")
    ...     read_path(file).tolist()
    [[0.0, 0.0], [5.0, 0.0], [5.0, 3.0]]
    """
    file = Path(path)
    if file.exists() and not file.is_file():  # a pipe would wait for ever
        raise TrajectoryError(f"{file}: expected a file of waypoints, got something else")
    table = read_table(file)
    width = table.values.shape[1]
    found = named(table, _PATH_COLUMNS)
    if not found and width in (2, 3) and (table.names is None or table.names_are_a_comment):
        found = dict(zip(_PATH_COLUMNS, table.values.T, strict=False))
    if not {"x", "y"} <= found.keys() or len(found) != width:
        called = f" called {', '.join(table.names)}" if table.names else ""
        raise TrajectoryError(f"{file}: expected the columns x, y and perhaps heading, got {width}{called}")
    return np.stack([found[name] for name in _PATH_COLUMNS if name in found], axis=-1)
