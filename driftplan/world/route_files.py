"""Routes in files: waypoints, recorded drives, and ``nav_msgs/Path``, poses with covariances and waypoint lists of ROS.

A route is a polyline; the robot turns on the spot where two legs meet. Poses that are written are at most so far apart
and look along their leg; frames are right-handed with z upwards, quaternions have x, y, z, w by their names.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from driftplan.arrays import Complexes, Floats, as_plane, bounded, positive
from driftplan.errors import TrajectoryError, naming
from driftplan.files import head
from driftplan.model.drift import Drift
from driftplan.world.formats import Format
from driftplan.world.log_formats import Role, is_bag, read_recording
from driftplan.world.log_tables import Table, named, read_table
from driftplan.world.odometry_logs import read_odometry, read_truth
from driftplan.world.plain_data import read_yaml

_STRAIGHT_WITHIN_M = 0.02  # what a recorded way swings less is jitter
_PATH_COLUMNS = {"x": ("x_m",), "y": ("y_m",), "heading": ("heading_rad", "yaw", "yaw_rad", "theta")}
_MAX_BYTES = 20_000_000
_MAX_POSES = 1e6
_PLACES = 6  # micrometres, microradians

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
    for form in FORMATS:
        if file.name.lower().endswith(form.suffixes):
            return np.asarray(form.read(file))
    try:
        return _waypoints(file, read_table(file, variable))
    except TrajectoryError:
        if (driven := _driven(file, variable)) is None:
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
        fits = "the headings point along the path if they are degrees, not if they are radians"
        raise TrajectoryError(f"{file}: {fits}: call the column heading [deg], or heading [rad]")
    return np.stack([found[name] for name in _PATH_COLUMNS if name in found], axis=-1)


def _fits_in_degrees(waypoints: Complexes, heading: Floats) -> bool:
    """Whether headings beyond a full turn follow the legs before or after them better in degrees than in radians."""
    course = np.angle(np.diff(waypoints))

    def follows(angles: Floats) -> float:
        return max(float(np.mean(np.cos(course - angles[:-1]))), float(np.mean(np.cos(course - angles[1:]))))

    beyond = float(np.abs(heading).max()) > 2 * np.pi + 0.1
    return beyond and follows(np.radians(heading)) > max(0.9, follows(heading) + 0.1)


def poses_along(path: Floats, spacing_m: float) -> tuple[Floats, Floats]:
    """Poses (k, 3) of a path (n, 2), at most ``spacing_m`` apart, and the distance driven at each.

    >>> poses_along(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5]]), 0.5)[0].round(2).tolist()
    [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0, 0.0, 1.57], [1.0, 0.5, 1.57]]
    """
    step = np.diff(path, axis=0)
    length = np.hypot(*step.T)
    path, step, length = path[[True, *(length > 0)]], step[length > 0], length[length > 0]
    if not len(length):
        raise ValueError("expected a route that leads somewhere, got one of length 0")
    bounded("poses", float(length.sum()) / positive("spacing_m", spacing_m), _MAX_POSES, "use a larger spacing_m")
    count = np.maximum(np.ceil(length / spacing_m - 1e-9), 1).astype(int)
    leg = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(leg)) - np.repeat(np.cumsum(count) - count, count)) / count[leg]
    xy = np.concatenate([path[leg] + share[:, None] * step[leg], path[-1:]])
    heading = np.arctan2(step[:, 1], step[:, 0])
    driven = np.append((np.cumsum(length) - length)[leg] + share * length[leg], length.sum())
    return np.column_stack([xy, np.append(heading[leg], heading[-1])]), driven


def ros_path_yaml(drift: Drift, *, spacing_m: float = 0.25, frame: str = "map") -> bytes:
    """The route as a ``nav_msgs/Path``, such as ``ros2 topic pub`` takes it; `read_path` reads it back.

    >>> from driftplan import OdometryNoise, predict_drift
    >>> drift = predict_drift([(0, 0), (3, 0), (3, 1)], OdometryNoise(heading_var_per_m=1e-4))
    >>> ros_path_yaml(drift).count(b"orientation")
    17
    """
    poses, _ = poses_along(drift.xy, spacing_m)
    return _stamped(poses, frame, above=f"header: {{frame_id: {frame}}}\n")


def waypoints_yaml(drift: Drift, *, frame: str = "map") -> bytes:
    """The corners of the route as the goal of nav2's ``FollowWaypoints``; `read_path` reads it back.

    >>> from driftplan import OdometryNoise, predict_drift
    >>> drift = predict_drift([(0, 0), (3, 0), (3, 1)], OdometryNoise(heading_var_per_m=1e-4))
    >>> waypoints_yaml(drift).count(b"orientation")
    3
    """
    poses, _ = poses_along(drift.xy, float(drift.length))
    return _stamped(poses, frame)


def poses_csv(drift: Drift, *, spacing_m: float = 0.25, frame: str = "map") -> bytes:
    """Poses along the route with the covariance of the estimate there, as ``geometry_msgs/PoseWithCovariance`` needs
    it (its mean is off by the bias), after a comment with their frame: ``pandas.read_csv(file, comment="#")``.

    >>> from driftplan import OdometryNoise, predict_drift
    >>> drift = predict_drift([(0, 0), (3, 0), (3, 1)], OdometryNoise(heading_var_per_m=1e-4))
    >>> poses_csv(drift, spacing_m=1.0).decode().splitlines()[2]
    '0,0,0,0,1,0,0,0,0'
    """
    poses, driven = poses_along(drift.xy, spacing_m)
    at, half = drift.at(np.minimum(driven, float(drift.length))), poses[:, 2] / 2
    columns = dict(zip(("x_m", "y_m", "heading_rad"), poses.T, strict=True)) | {"qz": np.sin(half), "qw": np.cos(half)}
    columns |= {"cov_xx_m2": at.cov[:, 0, 0], "cov_xy_m2": at.cov[:, 0, 1], "cov_yy_m2": at.cov[:, 1, 1]}
    columns["heading_var_rad2"] = at.heading_std**2
    rows = np.column_stack(list(columns.values())).tolist()
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    return "\n".join([head(frame) + ",".join(columns), *lines, ""]).encode()


def poses_yaml(drift: Drift, *, spacing_m: float = 0.25, frame: str = "map") -> bytes:
    """The same as messages ``geometry_msgs/PoseWithCovarianceStamped``, which a ``nav_msgs/Path`` has no room for;
    `read_path` reads the poses back. Of the covariances those of x, y and of the yaw are known.

    >>> from driftplan import OdometryNoise, predict_drift
    >>> drift = predict_drift([(0, 0), (3, 0), (3, 1)], OdometryNoise(heading_var_per_m=1e-4))
    >>> poses_yaml(drift, spacing_m=1.0).count(b"covariance")
    5
    """
    poses, driven = poses_along(drift.xy, spacing_m)
    at = drift.at(np.minimum(driven, float(drift.length)))
    covariance = np.zeros((len(poses), 6, 6))
    covariance[:, :2, :2] = at.cov
    covariance[:, 5, 5] = at.heading_std**2
    rows = covariance.reshape(-1, 36).tolist()  # with a point, without which YAML 1.1 takes 1e-05 for a text
    told = [f"[{', '.join(f'{value:.8e}' if value else '0.0' for value in row)}]" for row in rows]
    return _stamped(poses, frame, told)


def read_ros_path(file: Path) -> Floats:
    """Poses (n, 3) of a ``nav_msgs/Path`` or of waypoints, as written above or echoed by ROS."""
    held = read_yaml(file, TrajectoryError, max_bytes=_MAX_BYTES)
    listed = held.get("poses") if isinstance(held, dict) else None
    if not isinstance(listed, list) or len(listed) < 2:
        raise TrajectoryError(f"{file}: expected 2 or more poses of a nav_msgs/Path, under the name poses, got none")
    poses = np.empty((len(listed), 3))
    for k, stamped in enumerate(listed):
        with naming(f"{file}, pose {k + 1}", TrajectoryError):
            try:
                pose = stamped.get("pose", stamped)
                pose = pose.get("pose", pose)  # with a covariance
                x, y = (float(pose["position"][name]) for name in "xy")
                q = np.array([float(pose["orientation"].get(name, 0.0)) for name in "xyzw"])
            except (AttributeError, KeyError, TypeError):
                raise ValueError("expected position x, y and orientation x, y, z, w") from None
            if not np.abs(q).max() <= 2 or abs(np.linalg.norm(q) - 1) > 0.01 or np.hypot(q[0], q[1]) > 0.05:
                raise ValueError(f"expected a unit quaternion about z, got {q.tolist()}")
            poses[k] = x, y, 2 * np.arctan2(q[2], q[3])
    if len(wrong := poses[~np.isfinite(poses).all(axis=1)]):
        raise TrajectoryError(f"{file}: expected finite poses, got {wrong[0].tolist()}")
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses


def _stamped(poses: Floats, frame: str, covariances: Sequence[str] = (), above: str = "") -> bytes:
    lines = []
    for k, (x, y, heading) in enumerate(poses.tolist()):
        position = f"{{x: {_number(x)}, y: {_number(y)}, z: 0.0}}"
        turned = f"{{x: 0.0, y: 0.0, z: {_number(np.sin(heading / 2))}, w: {_number(np.cos(heading / 2))}}}"
        pose = f"{{position: {position}, orientation: {turned}}}"
        pose = f"{{pose: {pose}, covariance: {covariances[k]}}}" if covariances else pose
        lines.append(f"- header: {{frame_id: {frame}}}\n  pose: {pose}")
    return "\n".join([f"{head(frame)}{above}poses:", *lines, ""]).encode()


def _number(value: Any) -> float:
    return round(float(value), _PLACES) + 0.0  # no minus before a zero


# by the ends of their names; all others are told by what is in them: tables of waypoints, and recordings
FORMATS = (Format("nav_msgs/Path", (".yaml", ".yml"), read_ros_path),)
