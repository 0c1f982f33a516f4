"""Recordings in formats that are no tables say the same as the poses they were written from."""

from __future__ import annotations

import builtins
import gzip

import numpy as np
import pytest

from driftplan.errors import TrajectoryError
from driftplan.model.calibration.recordings import simulate_log
from driftplan.model.noise import OdometryNoise
from driftplan.world.odometry_logs import read_odometry, read_truth
from driftplan.world.route_files import read_path

NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-3, distance_scale_error=0.02)
LOG, TRUTH = simulate_log([(0, 0), (6, 0), (6, 3), (1, 3)], NOISE, rng=1, step_m=0.25)
ODOMETRY = np.column_stack([LOG.times, LOG.positions.real, LOG.positions.imag, LOG.headings])
TRUE = np.column_stack([TRUTH.times, TRUTH.xy, TRUTH.heading])


def assert_recorded(odometry, truth=None):
    np.testing.assert_allclose(odometry.moves, LOG.moves, atol=1e-6)
    np.testing.assert_allclose(odometry.turns, LOG.turns, atol=1e-6)
    if truth is not None:
        np.testing.assert_allclose(truth.xy, TRUTH.xy, atol=1e-6)
        np.testing.assert_allclose(truth.heading, TRUTH.heading, atol=1e-6)


def carmen(corrected=TRUE, odom=True):
    lines = ["# message_name [message contents] ipc_timestamp ipc_hostname logger_timestamp", "PARAM robot_length 0.5"]
    for (time, x, y, heading), (_, cx, cy, ch) in zip(ODOMETRY, corrected, strict=True):
        said = f"{x:.8f} {y:.8f} {heading:.8f}"
        if odom:
            lines.append(f"ODOM {said} 0.5 0.0 0.0 {time:.4f} robot {time:.4f}")
        lines.append(f"FLASER 3 1.0 2.0 3.0 {cx:.8f} {cy:.8f} {ch:.8f} {said} {time:.4f} robot {time:.4f}")
    return "\n".join(lines)


@pytest.mark.parametrize("odom", [True, False])
def test_carmen_logs_hold_odometry_and_corrected_poses(tmp_path, odom):
    file = tmp_path / "hall.clf.gz"
    file.write_bytes(gzip.compress(carmen(odom=odom).encode()))
    truth = read_truth(file)
    assert_recorded(read_odometry(file), truth)
    np.testing.assert_allclose(truth.times, LOG.times, atol=1e-4)


def test_a_carmen_log_that_nobody_corrected_is_no_truth(tmp_path):
    file = tmp_path / "hall.log"
    file.write_text(carmen(corrected=ODOMETRY))
    assert_recorded(read_odometry(file))
    with pytest.raises(TrajectoryError, match=r"hall\.log: expected corrected poses in the FLASER lines"):
        read_truth(file)


def test_a_table_may_be_called_log(tmp_path):
    file = tmp_path / "wheels.log"
    np.savetxt(file, ODOMETRY, header="time x y heading")
    assert_recorded(read_odometry(file))


def g2o(skip=-1):
    lines = [f"VERTEX_SE2 {k} {x:.8f} {y:.8f} {h:.8f}" for k, (_, x, y, h) in enumerate(TRUE)]
    for k, (move, turn) in enumerate(zip(LOG.moves, LOG.turns, strict=True)):
        if k != skip:
            lines.append(f"EDGE_SE2 {k} {k + 1} {move.real:.8f} {move.imag:.8f} {turn:.8f} 500 0 0 500 0 5000")
    lines.append("EDGE_SE2 20 3 0.1 0.2 0.3 500 0 0 500 0 5000")  # a loop that was closed
    return "\n".join(lines)


def test_g2o_edges_are_odometry_and_vertices_the_truth(tmp_path):
    file = tmp_path / "graph.g2o"
    file.write_text(g2o())
    assert_recorded(read_odometry(file), read_truth(file))
    file.write_text(g2o(skip=7))
    with pytest.raises(TrajectoryError, match="expected an EDGE_SE2 from every vertex to the next, found none from 7"):
        read_odometry(file)
    file.write_text("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n")
    with pytest.raises(TrajectoryError, match="expected a graph in the plane"):
        read_truth(file)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.log", "ODOM 1 2\nODOM 1 2\n", "expected 4 numbers in every ODOM line"),
        ("a.clf", "FLASER 2 1.5 1.5 0 0 0\n", "expected 7 numbers in every FLASER line"),
        ("a.clf", "FLASER many 1 2 3\n", "expected 7 numbers in every FLASER line"),
        ("a.clf", "FLASER 999999999999 1 2 3\n", "expected 7 numbers in every FLASER line"),
        ("a.g2o", "EDGE_SE2 0 1 0.5 0\nEDGE_SE2 1 2 0.5 0\n", "expected 5 numbers in every EDGE_SE2 line"),
        ("a.g2o", "EDGE_SE2 x y z\n", "expected 5 numbers in every EDGE_SE2 line"),
        ("a.g2o", "VERTEX_SE2 0 0 0 0\n", "expected an EDGE_SE2 from every vertex to the next, found none"),
    ],
)
def test_broken_lines_are_named(tmp_path, name, text, said):
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(TrajectoryError, match=rf"{name}: {said}"):
        read_odometry(file)


WIDTH, TICK = 0.4, 0.002


@pytest.fixture
def wheels():
    """Way of the left and the right wheel up to every sample, of a robot that never slides."""
    turns, ways = LOG.turns, np.abs(LOG.moves)
    return [np.concatenate([[0.0], np.cumsum(ways + side * turns * WIDTH / 2)]) for side in (-1, 1)]


def test_wheel_ticks_are_distances_and_turns(tmp_path, wheels):
    file = tmp_path / "ticks.csv"
    ticks = [np.round(way / TICK) for way in wheels]
    np.savetxt(file, np.column_stack([LOG.times, *ticks]), "%.6f", ",", header="t,left_ticks,right_ticks", comments="")
    found = read_odometry(file, track_width_m=WIDTH, metres_per_tick=TICK)
    np.testing.assert_allclose(found.headings[-1], LOG.headings[-1], atol=2 * TICK / WIDTH)
    np.testing.assert_allclose(found.travelled[-1], np.abs(LOG.moves).sum(), rtol=0.01)


def test_wheel_speeds_are_speeds_and_turn_rates(tmp_path, wheels):
    file = tmp_path / "speeds.csv"
    speeds = [np.append(np.diff(way) / np.diff(LOG.times), 0.0) for way in wheels]
    np.savetxt(file, np.column_stack([LOG.times, *speeds]), "%.9f", ",", header="t,v_left,v_right", comments="")
    found = read_odometry(file, track_width_m=WIDTH)
    np.testing.assert_allclose(found.turns, LOG.turns, atol=1e-6)
    for given in ({}, {"track_width_m": WIDTH, "metres_per_tick": TICK}):
        with pytest.raises(TrajectoryError, match="expected track_width_m with left_speed and right_speed"):
            read_odometry(file, **given)


def test_a_track_width_without_wheels_is_not_ignored(tmp_path):
    file = tmp_path / "poses.csv"
    np.savetxt(file, ODOMETRY, delimiter=",", header="t,x,y,heading", comments="")
    with pytest.raises(TrajectoryError, match="neither without; found time x y heading"):
        read_odometry(file, track_width_m=0.4)


# ROS bags


def stamped(store, time, frame="odom"):
    Time, Header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    stamp = Time(sec=int(time), nanosec=round(1e9 * (time - int(time))))
    extra = {"seq": 0} if "seq" in Header.__dataclass_fields__ else {}
    return Header(stamp=stamp, frame_id=frame, **extra)


def messages(store, rows, kind):
    types = {name.rsplit("/", 1)[1]: store.types[name] for name in store.types if name.startswith("geometry_msgs/")}
    for time, x, y, heading in rows:
        turned = types["Quaternion"](x=0.0, y=0.0, z=np.sin(heading / 2), w=np.cos(heading / 2))
        if kind == "tf2_msgs/msg/TFMessage":
            moved = types["Transform"](translation=types["Vector3"](x=x, y=y, z=0.0), rotation=turned)
            frames = (("odom", "base_link"), ("base_link", "laser"))
            one = [
                types["TransformStamped"](header=stamped(store, time, up), child_frame_id=down, transform=moved)
                for up, down in frames
            ]
            yield time, store.types[kind](transforms=one)
            continue
        pose = types["Pose"](position=types["Point"](x=x, y=y, z=0.0), orientation=turned)
        if kind == "geometry_msgs/msg/PoseStamped":
            yield time, store.types[kind](header=stamped(store, time, "map"), pose=pose)
            continue
        none = types["Vector3"](x=0.0, y=0.0, z=0.0)
        twist = types["TwistWithCovariance"](twist=types["Twist"](linear=none, angular=none), covariance=np.zeros(36))
        posed = types["PoseWithCovariance"](pose=pose, covariance=np.zeros(36))
        header = stamped(store, time)
        yield time, store.types[kind](header=header, child_frame_id="base_link", pose=posed, twist=twist)


def written(folder, ros):
    """A bag with odometry, a motion-capture pose and transforms."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    bag = folder / ("drive.bag" if ros == 1 else "drive")
    plugin = StoragePlugin.MCAP if ros == "mcap" else StoragePlugin.SQLITE3
    topics = {
        "/odom": ("nav_msgs/msg/Odometry", ODOMETRY),
        "/mocap": ("geometry_msgs/msg/PoseStamped", TRUE),
        "/tf": ("tf2_msgs/msg/TFMessage", ODOMETRY),
    }
    if ros == 1:  # whose types the library ships without tf2
        del topics["/tf"]
    with Writer1(bag) if ros == 1 else Writer2(bag, version=9, storage_plugin=plugin) as writer:
        for topic, (kind, rows) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            for time, message in messages(store, rows, kind):
                raw = store.serialize_ros1(message, kind) if ros == 1 else store.serialize_cdr(message, kind)
                writer.write(connection, int(1e9 * time), bytes(raw))
    return bag


@pytest.mark.parametrize("ros", [1, "sqlite3", "mcap"])
def test_bags_are_read_by_topic(tmp_path, ros):
    pytest.importorskip("rosbags")
    bag = written(tmp_path, ros)
    assert_recorded(read_odometry(bag, variable="/odom"), read_truth(bag, variable="/mocap"))
    with pytest.raises(TrajectoryError, match=r"say which topic .* holds /mocap \(geometry_msgs/PoseStamped\), /odom"):
        read_odometry(bag)
    assert np.abs(read_path(bag, variable="/odom")[-1] - [LOG.positions[-1].real, LOG.positions[-1].imag]).max() < 0.05
    with pytest.raises(TrajectoryError, match="say which topic to read"):
        read_path(bag)
    if ros == 1:
        return
    assert_recorded(read_odometry(bag, variable="/tf odom>base_link"))
    with pytest.raises(TrajectoryError, match="say which frames to read, after a blank; it holds base_link>laser"):
        read_odometry(bag, variable="/tf")


def test_a_file_that_is_no_bag_and_a_missing_library_are_said(tmp_path, monkeypatch):
    pytest.importorskip("rosbags")
    file = tmp_path / "broken.bag"
    file.write_text("not a bag at all")
    with pytest.raises(TrajectoryError, match=r"broken\.bag: not a readable ROS bag"):
        read_odometry(file)
    imported = builtins.__import__

    def without(name, *args, **kwargs):
        if name.startswith("rosbags"):
            raise ImportError(name)
        return imported(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(TrajectoryError, match=r"ROS bags are read through rosbags: pip install 'driftplan\[ros\]'"):
        read_odometry(file)


# Recorded drives as paths


def test_a_recorded_drive_is_a_path(tmp_path):
    file = tmp_path / "truth.csv"
    np.savetxt(file, TRUE, delimiter=",", header="time,x,y,heading", comments="")
    assert read_path(file).round(6).tolist() == [[0, 0], [6, 0], [6, 3], [1, 3]]
    clf = tmp_path / "hall.clf"
    clf.write_text(carmen())
    assert read_path(clf).round(6).tolist() == [[0, 0], [6, 0], [6, 3], [1, 3]]
    steps = np.column_stack([LOG.times[1:], np.abs(LOG.moves), LOG.turns])
    np.savetxt(file, steps, delimiter=",", header="time,distance,turn", comments="")
    assert np.abs(read_path(file)[-1] - [LOG.positions[-1].real, LOG.positions[-1].imag]).max() < 0.05


def test_few_nameless_columns_are_no_recording(tmp_path):
    file = tmp_path / "path.txt"
    file.write_text("0,0,0\n10,0,90\n10,10,180\n0,10,270\n")
    with pytest.raises(TrajectoryError, match="if they are degrees, not if they are radians"):
        read_path(file)
