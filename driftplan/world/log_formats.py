"""Recordings that are no tables, as tables with named columns: ROS bags, CARMEN logs, g2o graphs. A format is a
function in `FORMATS` and what tells it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from pathlib import Path
from typing import Any, Literal

import numpy as np

from driftplan.arrays import Floats, finite
from driftplan.errors import TrajectoryError, naming
from driftplan.files import read_lines
from driftplan.world.log_tables import Table, read_table

Role = Literal["odometry", "truth"]

_POSITION, _QUATERNION = ("x", "y", "z"), ("x", "y", "z", "w")
_PLACED = (*(f"pose_pose_position_{c}" for c in _POSITION), *(f"pose_pose_orientation_{c}" for c in _QUATERNION))
_MOVING = ("twist_twist_linear_x", "twist_twist_angular_z")
# message type without its package's middle: where its pose (or transform) is, and where its twist
_MESSAGES: dict[str, tuple[str, str]] = {
    "nav_msgs/Odometry": ("pose.pose", "twist.twist"),
    "geometry_msgs/PoseStamped": ("pose", ""),
    "geometry_msgs/PoseWithCovarianceStamped": ("pose.pose", ""),
    "geometry_msgs/TransformStamped": ("transform", ""),
    "geometry_msgs/TwistStamped": ("", "twist"),
    "geometry_msgs/TwistWithCovarianceStamped": ("", "twist.twist"),
    "tf2_msgs/TFMessage": ("transform", ""),
}


def read_recording(file: Path, role: Role, variable: str | None) -> Table:
    """The numbers of a recording in whatever format; the ``role`` counts where a format holds both.

    The ``variable`` is a MATLAB file's array, or a ROS bag's topic, for transforms with the two frames, as in
    ``/tf odom>base_link``. Raises TrajectoryError if the file cannot be read: the message names it, and what in it.
    """
    if is_bag(file):
        return _bag(file, variable)
    name = file.name.lower().removesuffix(".gz")
    for suffixes, words, read in FORMATS:
        if name.endswith(suffixes) and file.is_file():
            lines = read_lines(file, TrajectoryError)
            if any(line.startswith(words) for line in lines):
                with naming(file, TrajectoryError):
                    return read(lines, role)
    return read_table(file, variable, recording=True)


def is_bag(file: Path) -> bool:
    """Whether a file or folder is a recording of ROS, by its name."""
    name = file.name.lower().removesuffix(".gz")
    return name.endswith((".bag", ".db3", ".mcap")) or (file / "metadata.yaml").is_file()


def _carmen(lines: Sequence[str], role: Role) -> Table:
    """ODOM x y theta tv rv accel time host time; FLASER n ranges x y theta odom_x odom_y odom_theta time host time."""
    odometry = _rows("ODOM", 4, ((f[7], *f[1:4]) for f in _fields(lines, "ODOM")))
    tails = (f[2 + int(f[1]) :] for f in _fields(lines, "FLASER"))
    laser = _rows("FLASER", 7, ((f[6], *f[:6]) for f in tails))
    if role == "odometry":
        return _table(odometry if len(odometry) else laser[:, [0, 4, 5, 6]])
    if not len(laser) or np.allclose(laser[:, 1:4], laser[:, 4:7]):
        raise ValueError("expected corrected poses in the FLASER lines, as a .clf file has them, found the odometry's")
    return _table(laser[:, :4])


def _g2o(lines: Sequence[str], role: Role) -> Table:
    """Truth are the vertices, one a second, as they were optimised; odometry are the edges from each to the next."""
    if any(line.startswith(("VERTEX_SE3", "EDGE_SE3")) for line in lines):
        raise ValueError("expected a graph in the plane, VERTEX_SE2 and EDGE_SE2, found one in space")
    if role == "truth":
        return _table(_rows("VERTEX_SE2", 4, (f[1:5] for f in _fields(lines, "VERTEX_SE2"))))
    edges = _rows("EDGE_SE2", 5, (f[1:6] for f in _fields(lines, "EDGE_SE2") if int(f[2]) == int(f[1]) + 1))
    edges = edges[np.unique(edges[:, 0], return_index=True)[1]]
    gap = np.flatnonzero(np.diff(edges[:, 0]) != 1)
    if not len(edges) or len(gap):
        where = f"none from {edges[gap[0], 0] + 1:.0f}" if len(gap) else "none"
        raise ValueError(f"expected an EDGE_SE2 from every vertex to the next, found {where}")
    heading = np.concatenate([[0.0], np.cumsum(edges[:, 4])])
    place = np.concatenate([[0j], np.cumsum((edges[:, 2] + 1j * edges[:, 3]) * np.exp(1j * heading[:-1]))])
    return _table(np.column_stack([edges[0, 0] + np.arange(len(place)), place.real, place.imag, heading]))


def _table(values: Floats, names: Sequence[str] = ("x", "y", "heading")) -> Table:
    return Table(values, ("time", *names), lines=np.arange(1, len(values) + 1))


def _fields(lines: Iterable[str], word: str) -> list[list[str]]:
    return [fields for fields in map(str.split, lines) if fields and fields[0] == word]


def _rows(word: str, width: int, rows: Iterable[Sequence[str]]) -> Floats:
    try:
        found = np.array([[float(cell) for cell in row] for row in rows]).reshape(-1, width)
    except (ValueError, IndexError) as err:
        raise ValueError(f"expected {width} numbers in every {word} line: {err}") from None
    return finite(f"the {word} lines", found)


def _bag(file: Path, variable: str | None) -> Table:
    try:
        from rosbags.highlevel import AnyReader
    except ImportError as err:
        raise TrajectoryError(f"{file}: ROS bags are read through rosbags: pip install 'driftplan[ros]'") from err
    topic, _, frames = (variable or "").partition(" ")
    try:
        with AnyReader([file]) as reader:
            kinds = {c.topic: c.msgtype.replace("/msg/", "/") for c in reader.connections}
            known = {name: kind for name, kind in kinds.items() if kind in _MESSAGES}
            if topic not in known and (topic or len(known) != 1):
                listed = ", ".join(f"{name} ({kind})" for name, kind in sorted(known.items())) or "none with a pose"
                raise TrajectoryError(f"{file}: say which topic to read; it holds {listed}")
            topic = topic or next(iter(known))
            wanted = [c for c in reader.connections if c.topic == topic]
            messages = (reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections=wanted))
            return _of_messages(messages, known[topic], frames, f"{file}: topic {topic}")
    except TrajectoryError:
        raise
    except Exception as err:  # whatever a broken file leads the library into
        raise TrajectoryError(f"{file}: not a readable ROS bag ({type(err).__name__}: {err})") from err


def _of_messages(messages: Iterable[Any], kind: str, frames: str, where: str) -> Table:
    pose, twist = _MESSAGES[kind]
    rows: dict[str, list[list[float]]] = {}
    for message in messages:
        for one in getattr(message, "transforms", [message]):
            between = f"{one.header.frame_id}>{one.child_frame_id}" if kind.endswith("TFMessage") else ""
            row = [one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec]
            if pose:
                placed = reduce(getattr, pose.split("."), one)
                position, turned = ("translation", "rotation") if pose == "transform" else ("position", "orientation")
                row += [getattr(getattr(placed, position), c) for c in _POSITION]
                row += [getattr(getattr(placed, turned), c) for c in _QUATERNION]
            if twist:
                moving = reduce(getattr, twist.split("."), one)
                row += [moving.linear.x, moving.angular.z]
            rows.setdefault(between, []).append(row)
    if not rows:
        raise TrajectoryError(f"{where} holds no message")
    if frames not in rows and (frames or len(rows) != 1):
        raise TrajectoryError(f"{where}: say which frames to read, after a blank; it holds {', '.join(sorted(rows))}")
    return _table(np.array(rows[frames or next(iter(rows))]), (*(_PLACED if pose else ()), *(_MOVING if twist else ())))


# endings of the name, words of which one begins a line, reader
FORMATS: tuple[tuple[tuple[str, ...], tuple[str, ...], Callable[[Sequence[str], Role], Table]], ...] = (
    ((".log", ".clf"), ("ODOM ", "FLASER "), _carmen),
    ((".g2o",), ("VERTEX_", "EDGE_"), _g2o),
)
