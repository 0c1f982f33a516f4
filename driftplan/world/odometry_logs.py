"""Odometry logs and true trajectories from files: TUM, KITTI, UTIAS MR.CLAM, CSV with named columns, MATLAB 5, and the
formats of `driftplan.world.log_formats`: ROS bags, CARMEN, g2o.

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
13      the same after a time or the number of the frame the same
======= ================================================ =========================================

SI units and rad, unless the header names a unit in brackets (`driftplan.world.log_tables.UNITS`); times since 1970 in
nanoseconds, microseconds or milliseconds are recognised by their size. ROS messages keep their field names, of which
the last words count (``pose.pose.position.x``); columns of text are skipped, and ``ros2 topic echo --csv``, which has
no header, is told by the number of its columns. The plane is x-y; KITTI's is that of its camera, driving along z with x
to the right, and its poses are ``1/rate_hz`` apart. What is not as it seems (degrees, other axes, w first) is refused
where another reading fits the way driven and this one does not; what was sorted, cut or left out is in the recording's
notes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from driftplan.arrays import Complexes, Floats, choice, positive
from driftplan.errors import TrajectoryError, naming
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.world.log_checks import in_order, misread, seconds
from driftplan.world.log_formats import read_recording
from driftplan.world.log_tables import Table, columns_of, name_and_unit, named

Kind = Literal["increments", "velocities", "poses"]

_ALIASES: Mapping[str, Sequence[str]] = {
    "time": ("t", "times", "timestamp", "stamp", "time_s", "secs", "seconds", "header_stamp", "rosbagtimestamp"),
    "sec": ("stamp_sec", "stamp_secs"),
    "nanosec": ("nsecs", "stamp_nanosec", "stamp_nsecs", "stamp_nsec"),
    "x": ("tx", "px", "pos_x", "position_x", "p_rs_r_x", "x_m", "translation_x", "pose_x"),
    "y": ("ty", "py", "pos_y", "position_y", "p_rs_r_y", "y_m", "translation_y", "pose_y"),
    "heading": ("yaw", "theta", "orientation", "heading_rad", "yaw_rad", "pose_theta"),
    "qx": ("q_x", "q_rs_x", "orientation_x", "rotation_x"),
    "qy": ("q_y", "q_rs_y", "orientation_y", "rotation_y"),
    "qz": ("q_z", "q_rs_z", "orientation_z", "rotation_z"),
    "qw": ("q_w", "q_rs_w", "orientation_w", "rotation_w"),
    "distance": ("ds", "dist", "delta_s", "distance_m"),
    "turn": ("dtheta", "delta_theta", "turn_rad", "dyaw"),
    "speed": ("v", "velocity", "forward_velocity", "linear_x", "speed_m_per_s"),
    "turn_rate": ("w", "omega", "angular_velocity", "angular_z", "yaw_rate", "turn_rate_rad_per_s"),
    "left_speed": ("v_left", "left_wheel_speed", "wheel_speed_left", "vl"),
    "right_speed": ("v_right", "right_wheel_speed", "wheel_speed_right", "vr"),
    "left_ticks": ("ticks_left", "left_encoder", "encoder_left"),
    "right_ticks": ("ticks_right", "right_encoder", "encoder_right"),
}
_WHEELS = {"speeds": ("left_speed", "right_speed"), "ticks": ("left_ticks", "right_ticks")}
_QUATERNION = ("qx", "qy", "qz", "qw")
_POSE = ("x", "y", "z", *_QUATERNION)
_NAMELESS: Mapping[int, Sequence[str]] = {3: ("time", "x", "y"), 4: ("time", "x", "y", "heading"), 8: ("time", *_POSE)}
_NAMELESS_STEPS: Mapping[str, Sequence[str]] = {
    "increments": ("time", "distance", "turn"),
    "velocities": ("time", "speed", "turn_rate"),
}
# `ros2 topic echo --csv`: columns in all and those of text, and what the first numbers are
_ROS2_ECHO: Mapping[tuple[int, tuple[int, ...]], Sequence[str]] = {
    (89, (2, 3)): ("sec", "nanosec", *_POSE),  # nav_msgs/Odometry
    (10, (2,)): ("sec", "nanosec", *_POSE),  # geometry_msgs/PoseStamped
    (11, (2, 3)): ("sec", "nanosec", *_POSE),  # geometry_msgs/TransformStamped
    (9, (2,)): ("sec", "nanosec", "speed", "vy", "vz", "wx", "wy", "turn_rate"),  # geometry_msgs/TwistStamped
}
_KITTI_COLUMNS = 12
_FLAT = 0.05  # of the extent along y, below which z is the height
_LEVEL = 0.9  # mean horizontal length of the body axis that heading is taken from


def read_odometry(
    path: str | os.PathLike[str],
    *,
    kind: Kind | None = None,
    columns: Sequence[str] | None = None,
    variable: str | None = None,
    rate_hz: float = 10.0,
    track_width_m: float | None = None,
    metres_per_tick: float | None = None,
) -> OdometryLog:
    """Odometry from a file.

    Parameters
    ----------
    path : see the module's table, `driftplan.world.log_tables.read_table` and `driftplan.world.log_formats`
    kind : {"increments", "velocities", "poses"}, optional
        What the log holds; needed where three nameless columns do not say.
    columns : names of the columns, in place of the file's: ``time``, ``distance``, ``turn``; ``speed``, ``turn_rate``;
        ``x``, ``y``, ``heading``; ``qx``, ``qy``, ``qz``, ``qw``; ``left_speed``, ``right_speed``; ``left_ticks``,
        ``right_ticks``; any other name is skipped. A unit may follow, as in ``time[ns]`` or ``heading[deg]``.
        Increments may lack ``time``.
    variable : name of the array in a MATLAB file, or topic of a ROS bag
    rate_hz : poses per second of a KITTI file
    track_width_m, metres_per_tick : distance between the wheels, for wheel speeds and ticks; what a tick is worth

    Raises TrajectoryError if the file cannot be read or does not say what its columns are: the message names file and
    line or column; ValueError if an argument is none of those above.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "wheels.csv"
    ...     _ = file.write_text("time [ms],speed,turn_rate [deg/s]\\n0,0.5,0\\n2000,0.5,90\\n3000,0,0\\n")
    ...     log = read_odometry(file)
    >>> log.times, log.turns.round(4)
    (array([0., 2., 3.]), array([0.    , 1.5708]))
    """
    if kind is not None:
        choice("kind", kind, Kind)
    file = Path(path)
    table = read_recording(file, "odometry", variable)
    if columns is None and table.names is None and table.values.shape[1] == 3:
        if kind is None or kind == "poses":
            raise TrajectoryError(
                f"{file}: three nameless columns can be increments (time, distance, turn) or velocities (time, speed, "
                "turn rate): say which by kind"
            )
        columns = _NAMELESS_STEPS[kind]
    with naming(file, TrajectoryError):
        found, notes = _recording(file, table, columns, rate_hz)
        _of_wheels(found, track_width_m, metres_per_tick)
        kind = kind or _kind_of(table, found)
        if kind == "poses":
            truth = _trajectory(found, ())
            if truth.heading is None:
                raise ValueError(f"expected poses with a heading (heading, or qx qy qz qw), got {sorted(found)}")
            log = OdometryLog.from_poses(np.column_stack([truth.xy, truth.heading]), truth.times)
        elif kind == "increments":
            distances, turns = _needed(found, "distance", "turn")
            log = OdometryLog.from_increments(distances, turns, found.get("time"))
        else:
            log = OdometryLog.from_velocities(*_needed(found, "time", "speed", "turn_rate"))
        return replace(log, notes=notes)


def read_truth(
    path: str | os.PathLike[str],
    *,
    columns: Sequence[str] | None = None,
    variable: str | None = None,
    rate_hz: float = 10.0,
) -> Trajectory:
    """Where a robot was: times, planar positions and, if the file has any, headings.

    Parameters and errors are those of `read_odometry`.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "truth.csv")
    ...     _ = file.write_text("time,x,y,heading\\n0,0,0,0\\n1,2,0,0\\n2,2,2,1.57\\n")
    ...     read_truth(file).xy.tolist()
    [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0]]
    """
    file = Path(path)
    with naming(file, TrajectoryError):
        return _trajectory(*_recording(file, read_recording(file, "truth", variable), columns, rate_hz))


def _recording(
    file: Path, table: Table, columns: Sequence[str] | None, rate_hz: float
) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """The columns that the caller, the file or their number name, in SI units and the order of their times; notes."""
    table = _with_names(table, columns, rate_hz)
    where, found = columns_of(table.names or (), _ALIASES), named(file, table, _ALIASES)
    notes = list(table.notes)
    if {"sec", "nanosec"} <= found.keys():
        found["time"] = found["sec"] + 1e-9 * found["nanosec"]
    elif "time" in found and not (table.units and table.units[where["time"]]):
        found["time"], said = seconds(found["time"])
        notes += [said] if said else []
    if "time" in found:
        order, more = in_order(found["time"])
        found = {name: values[order] for name, values in found.items()}
        notes += more
    _check_headings(found)
    return found, tuple(f"{file.name}: {note}" for note in notes)


def _with_names(table: Table, columns: Sequence[str] | None, rate_hz: float) -> Table:
    """The table with a name for every column; for KITTI's matrices, with columns that have names."""
    width = table.values.shape[1]
    if columns is not None:
        if len(columns) != width:
            raise ValueError(f"expected {len(columns)} columns, {' '.join(columns)}, got {width}")
        pairs = [name_and_unit(column) for column in columns]
        return table._replace(names=tuple(name for name, _ in pairs), units=tuple(unit for _, unit in pairs))
    if table.names is not None and columns_of(table.names, _ALIASES):
        return table
    if table.names is None and width in (_KITTI_COLUMNS, _KITTI_COLUMNS + 1):
        return _kitti(table, rate_hz)
    names = _ROS2_ECHO.get((width + len(table.text), table.text)) or _NAMELESS.get(width)
    if names is None:
        what = f"{width} columns" + (f" named {' '.join(table.names)}" if table.names else "")
        raise ValueError(f"{what} do not say what they are (known: 3, 4, 8 (TUM), 12 or 13 (KITTI)): name them")
    rest = tuple(f"unnamed_{k}" for k in range(width - len(names)))
    return table._replace(names=(*names, *rest), units=None)


def _of_wheels(found: dict[str, Floats], track_width_m: float | None, metres_per_tick: float | None) -> None:
    """Speed and turn rate of wheel speeds, distance and turn of wheel ticks."""
    which = [kind for kind, names in _WHEELS.items() if set(names) <= found.keys()]
    ticks = which == ["ticks"]
    if (track_width_m is None) != (not which) or (metres_per_tick is None) != (not ticks) or len(which) > 1:
        raise ValueError(
            "expected track_width_m with left_speed and right_speed, track_width_m and metres_per_tick with left_ticks "
            f"and right_ticks, and neither without; found {' '.join(found)}"
        )
    if track_width_m is None:
        return
    left, right = (found[name] for name in _WHEELS[which[0]])
    if metres_per_tick is not None:
        size = positive("metres_per_tick", metres_per_tick)
        left, right = (size * np.diff(count, prepend=count[0]) for count in (left, right))
    ahead, turn = ("distance", "turn") if ticks else ("speed", "turn_rate")
    found[ahead], found[turn] = 0.5 * (left + right), (right - left) / positive("track_width_m", track_width_m)


def _kind_of(table: Table, found: Mapping[str, Floats]) -> Kind:
    """What the columns' names say; poses and commands side by side say nothing, but in a ROS message."""
    says: dict[Kind, bool] = {
        "increments": {"distance", "turn"} <= found.keys(),
        "velocities": {"speed", "turn_rate"} <= found.keys(),
        "poses": {"x", "y"} <= found.keys() and bool(found.keys() & {"heading", *_QUATERNION}),
    }
    held = [kind for kind, holds in says.items() if holds]
    message = any("pose_pose" in name for name in table.names or ())
    if len(held) > 1 and not (message and "poses" in held):
        raise ValueError(f"holds {' and '.join(held)}: say by kind which of them the odometry is")
    return "poses" if not held or message else held[0]


def _trajectory(found: Mapping[str, Floats], notes: tuple[str, ...]) -> Trajectory:
    times, x, y = _needed(found, "time", "x", "y")
    return Trajectory(times, np.column_stack([x, y]), _heading(found), notes=notes)


def _check_headings(found: Mapping[str, Floats]) -> None:
    """Refuse poses whose headings belong to the way driven by another reading of the columns only."""
    if not {"x", "y"} <= found.keys() or (heading := _heading(found)) is None:
        return
    z = found["x"] + 1j * found["y"]
    readings: dict[str, tuple[Complexes, Floats | None]] = {
        "headings in degrees, heading[deg],": (z, np.radians(heading)),
        "clockwise headings": (z, -heading),
        "x and y the other way round, y to the right of x,": (1j * np.conj(z), heading),
        "headings from the y axis, clockwise,": (z, np.pi / 2 - heading),
    }
    if found.keys() >= set(_QUATERNION):
        w_last = [found[name] for name in _QUATERNION]
        readings["w first, qw qx qy qz,"] = (z, _heading(dict(zip(_QUATERNION, w_last[1:] + w_last[:1], strict=True))))
    if other := misread(z, heading, readings):
        raise ValueError(f"the headings do not follow the way driven; {other} would fit: name the columns")


def _needed(found: Mapping[str, Floats], *names: str) -> list[Floats]:
    if not set(names) <= found.keys():
        raise ValueError(f"expected columns {' '.join(names)}, found {' '.join(found) or 'none of them'}")
    return [found[name] for name in names]


def _heading(found: Mapping[str, Floats]) -> Floats | None:
    if "heading" in found:
        return found["heading"]
    parts = [found[name] for name in _QUATERNION if name in found]
    if not parts:
        return None
    if len(parts) < 4:
        raise ValueError(f"expected all of qx qy qz qw, found {len(parts)} of them")
    from scipy.spatial.transform import Rotation

    q = np.stack(parts)
    with np.errstate(over="ignore"):  # of numbers that are no parts of a unit
        norm = np.linalg.norm(q, axis=0)
    if (np.abs(norm - 1) > 0.05).any():
        worst = int(np.argmax(np.abs(norm - 1)))
        raise ValueError(f"expected unit quaternions, got one of length {norm[worst]:.4g} in row {worst + 1}")
    # the body axes in the world, x and y components
    axes = Rotation.from_quat(q.T).as_matrix()[:, :2].T
    level = np.hypot(axes[:, 0], axes[:, 1]).mean(axis=-1)
    # heading is the azimuth of the x axis, unless the robot carries it upright: then of the next one that is level
    axis = int(np.argmax(level > _LEVEL)) if (level > _LEVEL).any() else int(np.argmax(level))
    return np.asarray(np.unwrap(np.arctan2(axes[axis, 1], axes[axis, 0])))


def _kitti(table: Table, rate_hz: float) -> Table:
    """Times, x-y and heading: forward is the camera's z, left its -x."""
    if not rate_hz > 0:
        raise ValueError(f"expected rate_hz > 0, got {rate_hz!r}")
    rows = table.values
    times = np.arange(len(rows)) / rate_hz
    if rows.shape[1] > _KITTI_COLUMNS and not (np.diff(rows[:, 0]) == 1).all():
        times = rows[:, 0]
    pose = rows[:, -_KITTI_COLUMNS:].reshape(-1, 3, 4)
    right, down, ahead = np.ptp(pose[:, :, 3], axis=0)
    if ahead < _FLAT * down and right > 0:
        drive = f"a drive of {right:.3g} m along x and {down:.3g} m along y, {ahead:.3g} m along z"
        upwards = "that is a frame with z upwards, as a lidar's or a robot's; write time, x, y, heading instead"
        camera = "the frame of its camera (z ahead, x to the right)"
        raise ValueError(f"expected KITTI's matrices in {camera}, got {drive}: {upwards}")
    heading = np.unwrap(np.arctan2(-pose[:, 0, 2], pose[:, 2, 2]))
    values = np.stack([times, pose[:, 2, 3], -pose[:, 0, 3], heading], axis=-1)
    return table._replace(values=values, names=tuple(_NAMELESS[4]), units=None)
