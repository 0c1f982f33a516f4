"""Trajectories and paths from files: where a robot was, and where it is to go."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from driftplan.arrays import Complexes, Floats, as_plane
from driftplan.errors import TrajectoryError
from driftplan.world.log_formats import Role, is_bag, read_recording
from driftplan.world.log_tables import Table, named, read_table
from driftplan.world.odometry_logs import read_odometry, read_truth
from driftplan.world.route_files import read_ros_path

_STRAIGHT_WITHIN_M = 0.02  # what a recorded way swings less is jitter
_PATH_COLUMNS = {"x": ("x_m",), "y": ("y_m",), "heading": ("heading_rad", "yaw", "yaw_rad", "theta")}


read_trajectory = read_truth  # a trajectory is what the truth of a calibration is


def read_path(path: str | os.PathLike[str], *, variable: str | None = None) -> Floats:
    """Waypoints ``(n, 2)``, or poses ``(n, 3)`` with headings in radians, of a path to follow.

    Parameters
    ----------
    path : text of one waypoint a line, ``x, y`` or ``x, y, heading``, with commas, semicolons or blanks between, and a
        header that names the columns or none. Lines that begin with ``#`` are comments. A unit in brackets, as in
        ``x [mm]`` or ``heading [deg]``, is converted. Or a recorded drive, in any of the formats of `read_trajectory`
        and `driftplan.read_odometry`: its way, straight where it is within 2 cm of it. Or a ``nav_msgs/Path`` as
        YAML.
    variable : topic of a ROS bag, or name of the array in a MATLAB file, where there are several

    Raises TrajectoryError if the file cannot be read, has other columns or fewer than 2 waypoints: the message names
    it, and the line.

    >>> import os, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "path.csv")
    ...     _ = file.write_text("x,y\\n0,0\\n5,0\\n5,3\\n")
    ...     read_path(file).tolist()
    [[0.0, 0.0], [5.0, 0.0], [5.0, 3.0]]
    """
    file = Path(path)
    if file.suffix.lower() in (".yaml", ".yml"):
        return read_ros_path(file)
    try:
        return _waypoints(file, read_table(file, variable))
    except TrajectoryError:
        driven = _driven(file, variable)
        if driven is None:
            raise
        return driven


def _driven(file: Path, variable: str | None) -> Floats | None:
    """Corners of the way of a recorded drive; None if it is none: few nameless columns are a path gone wrong."""
    from shapely import LineString

    roles: tuple[Role, ...] = ("truth", "odometry")
    for role in roles:
        try:
            table = read_recording(file, role, variable)
            if table.names is None and table.values.shape[1] <= len(_PATH_COLUMNS):
                return None
            read = read_truth if role == "truth" else read_odometry
            way = as_plane(read(file, variable=variable).positions)
        except TrajectoryError:
            if is_bag(file):  # nothing else than a bag, so that this is what is wrong
                raise
            continue
        return np.asarray(LineString(way).simplify(_STRAIGHT_WITHIN_M, preserve_topology=False).coords)
    return None


def _waypoints(file: Path, table: Table) -> Floats:
    """The columns of a path."""
    width = table.values.shape[1]
    found = named(file, table, _PATH_COLUMNS)
    if not found and width in (2, 3) and (table.names is None or table.names_are_a_comment):
        found = dict(zip(_PATH_COLUMNS, table.values.T, strict=False))
    if not {"x", "y"} <= found.keys() or len(found) != width:
        called = f" called {', '.join(table.names)}" if table.names else ""
        raise TrajectoryError(f"{file}: expected the columns x, y and perhaps heading, got {width}{called}")
    in_rad = any(unit in ("rad", "radians") for unit in table.units or ())
    if "heading" in found and not in_rad and _fits_in_degrees(found["x"] + 1j * found["y"], found["heading"]):
        raise TrajectoryError(
            f"{file}: the headings point along the path if they are degrees, not if they are radians: call the column "
            "heading [deg], or heading [rad]"
        )
    return np.stack([found[name] for name in _PATH_COLUMNS if name in found], axis=-1)


def _fits_in_degrees(waypoints: Complexes, heading: Floats) -> bool:
    """Whether headings beyond a full turn follow the legs before or after them better in degrees than in radians."""
    course = np.angle(np.diff(waypoints))

    def follows(angles: Floats) -> float:
        return max(float(np.mean(np.cos(course - angles[:-1]))), float(np.mean(np.cos(course - angles[1:]))))

    beyond = float(np.abs(heading).max()) > 2 * np.pi + 0.1
    return beyond and follows(np.radians(heading)) > max(0.9, follows(heading) + 0.1)
