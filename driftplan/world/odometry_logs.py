"""Odometry logs and true trajectories from files: TUM, KITTI, UTIAS MR.CLAM, CSV with named columns, MATLAB 5.

What the columns mean is taken from their names where the file has any, else from their number:

======= ================================================ =========================================
columns as truth or poses                                as odometry
======= ================================================ =========================================
3       time, x, y                                       say ``kind``: time, distance, turn
                                                         ("increments") or time, forward speed,
                                                         turn rate ("velocities")
4       time, x, y, heading                              the same
8       TUM: time, x, y, z, qx, qy, qz, qw               the same
12      KITTI: 3x4 pose matrix row by row, no time       the same
======= ================================================ =========================================

SI units and rad, unless the header names a unit in brackets. The plane is x-y; KITTI's is that of its camera, driving
along z with x to the right, and its poses are ``1/rate_hz`` apart.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from driftplan.arrays import Floats
from driftplan.errors import TrajectoryError
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.world.log_tables import Table, named, read_table

Kind = Literal["increments", "velocities", "poses"]

_ALIASES: Mapping[str, Sequence[str]] = {
    "time": ("t", "times", "timestamp", "stamp", "time_s", "secs", "seconds"),
    "x": ("tx", "px", "pos_x", "position_x", "p_rs_r_x", "x_m"),
    "y": ("ty", "py", "pos_y", "position_y", "p_rs_r_y", "y_m"),
    "heading": ("yaw", "theta", "orientation", "heading_rad", "yaw_rad"),
    "qx": ("q_x", "q_rs_x", "orientation_x"),
    "qy": ("q_y", "q_rs_y", "orientation_y"),
    "qz": ("q_z", "q_rs_z", "orientation_z"),
    "qw": ("q_w", "q_rs_w", "orientation_w"),
    "distance": ("ds", "dist", "delta_s", "distance_m"),
    "turn": ("dtheta", "delta_theta", "turn_rad", "dyaw"),
    "speed": ("v", "velocity", "forward_velocity", "linear_x", "speed_m_per_s"),
    "turn_rate": ("w", "omega", "angular_velocity", "angular_z", "yaw_rate", "turn_rate_rad_per_s"),
}
_NAMELESS = {
    "increments": ("time", "distance", "turn"),
    "velocities": ("time", "speed", "turn_rate"),
    3: ("time", "x", "y"),
    4: ("time", "x", "y", "heading"),
    8: ("time", "x", "y", "z", "qx", "qy", "qz", "qw"),
}
_KITTI_COLUMNS = 12
_LEVEL = 0.9  # mean horizontal length of the body axis that heading is taken from


def read_odometry(
    path: str | os.PathLike[str],
    *,
    kind: Kind | None = None,
    columns: Sequence[str] | None = None,
    variable: str | None = None,
    rate_hz: float = 10.0,
) -> OdometryLog:
    """Odometry from a file.

    Parameters
    ----------
    path :
        See the module's table, and `driftplan.world.log_tables.read_table` for the containers.
    kind : {"increments", "velocities", "poses"}, optional
        What the log holds; needed where three nameless columns do not say.
    columns : sequence of str, optional
        Names of the columns, in place of the file's: ``time``, ``distance``, ``turn``; ``speed``, ``turn_rate``; ``x``,
        ``y``, ``heading``; ``qx``, ``qy``, ``qz``, ``qw``; any other name is skipped. Increments may lack ``time``.
    variable : str, optional
        Name of the array in a MATLAB file.
    rate_hz : float
        Poses per second of a KITTI file.

    Raises
    ------
    TrajectoryError
        If the file cannot be read or does not say what its columns are: the message names file and line or column.
    ValueError
        If an argument is none of those above.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "wheels.csv"
    ...     _ = file.write_text("time [ms],speed,turn_rate [deg/s]\\n0,0.5,0\\n2000,0.5,90\\n3000,0,0\\n")
    ...     log = read_odometry(file)
    >>> log.times, log.turns.round(4)
    (array([0., 2., 3.]), array([0.    , 1.5708]))
    """
    if kind is not None and kind not in get_args(Kind):
        raise ValueError(f"expected kind one of {get_args(Kind)}, got {kind!r}")
    file = Path(path)
    table = read_table(file, variable)
    if columns is None and table.names is None and kind in _NAMELESS and table.values.shape[1] == 3:
        columns = _NAMELESS[kind]
    if kind in (None, "poses") and _is_kitti(table, columns):
        times, xy, heading = _kitti(table, rate_hz)
        return OdometryLog.from_poses(np.column_stack([xy, heading]), times)
    if columns is None and table.names is None and table.values.shape[1] == 3:
        raise TrajectoryError(
            f"{file}: three nameless columns can be increments (time, distance, turn) or velocities (time, speed, turn "
            "rate): say which by kind"
        )
    found = _columns(file, table, columns)
    try:
        if kind == "increments" or (kind is None and {"distance", "turn"} <= found.keys()):
            _need(file, found, "distance", "turn")
            return OdometryLog.from_increments(found["distance"], found["turn"], found.get("time"))
        if kind == "velocities" or (kind is None and {"speed", "turn_rate"} <= found.keys()):
            _need(file, found, "time", "speed", "turn_rate")
            return OdometryLog.from_velocities(found["time"], found["speed"], found["turn_rate"])
        _need(file, found, "time", "x", "y")
        pose_heading = _heading(file, found)
        if pose_heading is None:
            raise TrajectoryError(
                f"{file}: expected poses with a heading (heading, or qx qy qz qw), got {sorted(found)}"
            )
        return OdometryLog.from_poses(np.column_stack([found["x"], found["y"], pose_heading]), found["time"])
    except TrajectoryError:
        raise
    except ValueError as err:
        raise TrajectoryError(f"{file}: {err}") from err


def read_truth(
    path: str | os.PathLike[str],
    *,
    columns: Sequence[str] | None = None,
    variable: str | None = None,
    rate_hz: float = 10.0,
) -> Trajectory:
    """Timed true positions, with headings if the file has any.

    Parameters and errors are those of `read_odometry`.
    """
    file = Path(path)
    table = read_table(file, variable)
    if _is_kitti(table, columns):
        times, xy, heading = _kitti(table, rate_hz)
        return Trajectory(times, xy, heading)
    found = _columns(file, table, columns)
    _need(file, found, "time", "x", "y")
    try:
        return Trajectory(found["time"], np.column_stack([found["x"], found["y"]]), _heading(file, found))
    except TrajectoryError:
        raise
    except ValueError as err:
        raise TrajectoryError(f"{file}: {err}") from err


def _columns(file: Path, table: Table, columns: Sequence[str] | None) -> dict[str, Floats]:
    width = table.values.shape[1]
    if columns is not None:
        if len(columns) != width:
            raise TrajectoryError(f"{file}: expected {len(columns)} columns, {' '.join(columns)}, got {width}")
        return named(table._replace(names=tuple(columns)), _ALIASES)
    if table.names is not None:
        found = named(table, _ALIASES)
        if found:
            return found
    if width not in _NAMELESS:
        known = "3, 4, 8 (TUM) or 12 (KITTI)"
        names = f" named {' '.join(table.names)}" if table.names else ""
        raise TrajectoryError(f"{file}: {width} columns{names} do not say what they are (known: {known}): name them")
    return named(table._replace(names=_NAMELESS[width]), _ALIASES)


def _need(file: Path, found: Mapping[str, Floats], *names: str) -> None:
    missing = [name for name in names if name not in found]
    if missing:
        raise TrajectoryError(f"{file}: expected columns {' '.join(names)}, found {' '.join(found) or 'none of them'}")


def _heading(file: Path, found: Mapping[str, Floats]) -> Floats | None:
    if "heading" in found:
        return found["heading"]
    parts = [found[name] for name in ("qx", "qy", "qz", "qw") if name in found]
    if not parts:
        return None
    if len(parts) < 4:
        raise TrajectoryError(f"{file}: expected all of qx qy qz qw, found {len(parts)} of them")
    q = np.stack(parts)
    norm = np.linalg.norm(q, axis=0)
    if (np.abs(norm - 1) > 0.05).any():
        worst = int(np.argmax(np.abs(norm - 1)))
        raise TrajectoryError(
            f"{file}: expected unit quaternions, got one of length {norm[worst]:.4g} in row {worst + 1}"
        )
    x, y, z, w = q / norm
    # the body axes in the world, x and y components
    axes = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + z * w)],
            [2 * (x * y - z * w), 1 - 2 * (x * x + z * z)],
            [2 * (x * z + y * w), 2 * (y * z - x * w)],
        ]
    )
    level = np.hypot(axes[:, 0], axes[:, 1]).mean(axis=-1)
    # heading is the azimuth of the x axis, unless the robot carries it upright: then of the next one that is level
    axis = int(np.argmax(level > _LEVEL)) if (level > _LEVEL).any() else int(np.argmax(level))
    return np.asarray(np.unwrap(np.arctan2(axes[axis, 1], axes[axis, 0])))


def _is_kitti(table: Table, columns: Sequence[str] | None) -> bool:
    return columns is None and table.names is None and table.values.shape[1] == _KITTI_COLUMNS


def _kitti(table: Table, rate_hz: float) -> tuple[Floats, Floats, Floats]:
    """Times, x-y and heading: forward is the camera's z, left its -x."""
    if not rate_hz > 0:
        raise ValueError(f"expected rate_hz > 0, got {rate_hz!r}")
    pose = table.values.reshape(-1, 3, 4)
    xy = np.stack([pose[:, 2, 3], -pose[:, 0, 3]], axis=-1)
    heading = np.unwrap(np.arctan2(-pose[:, 0, 2], pose[:, 2, 2]))
    return np.arange(len(pose)) / rate_hz, xy, heading
