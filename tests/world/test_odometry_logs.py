"""Odometry logs and truths from files: every layout gives the same drive, and broken files are refused by name."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from driftplan.errors import TrajectoryError
from driftplan.model.calibration.fit import fit_noise
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.world.log_tables import read_table
from driftplan.world.odometry_logs import read_odometry, read_truth

DATA = Path(__file__).resolve().parents[2] / "../shared/data"

TIMES = np.arange(6) * 0.5
HEADINGS = np.array([0.3, 0.4, 0.9, 0.9, 0.2, -0.5])
XY = np.array([[0.0, 0.0], [0.5, 0.1], [0.8, 0.6], [0.8, 0.6], [1.5, 0.9], [2.5, 0.5]])
POSES = np.column_stack([XY, HEADINGS])
REFERENCE = OdometryLog.from_poses(POSES, TIMES)


def write(path, rows, header="", separator=" "):
    text = header + "".join(separator.join(f"{v:.17g}" for v in row) + "\n" for row in np.asarray(rows))
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


def tum(tilt=None):
    turn = Rotation.from_euler("z", HEADINGS[:, None])
    turn = turn if tilt is None else turn * tilt
    return np.column_stack([TIMES, XY, np.full(6, 0.7), turn.as_quat()])


def assert_same_drive(log, tolerance=1e-12):
    np.testing.assert_allclose(log.times, TIMES, rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.abs(log.moves), np.abs(REFERENCE.moves), rtol=0, atol=tolerance)
    np.testing.assert_allclose(log.turns, REFERENCE.turns, rtol=0, atol=tolerance)


def kitti_rows():
    """Camera poses: x right, y down, z forward; planar x is forward (z), planar y is left (-x)."""
    c, s = np.cos(HEADINGS), np.sin(HEADINGS)
    zero, one = np.zeros(6), np.ones(6)
    return np.column_stack([c, zero, -s, -XY[:, 1], zero, one, zero, zero, s, zero, c, XY[:, 0]])


@pytest.mark.parametrize(
    ("name", "rows", "header", "separator"),
    [
        ("poses.txt", np.column_stack([TIMES, POSES]), "", " "),
        ("poses.csv", np.column_stack([TIMES, POSES]), "time,x,y,heading\n", ","),
        (
            "poses.tsv",
            np.column_stack([TIMES, POSES]),
            "# recorded in the hall\n# Time [s]\tx [m]\ty [m]\torientation [rad]\n",
            "\t",
        ),
        (
            "millimetres.csv",
            np.column_stack([TIMES * 1e9, XY * 1e3, np.degrees(HEADINGS)]),
            "t [ns];x [mm];y [mm];yaw [deg]\n",
            ";",
        ),
        ("swapped.csv", np.column_stack([POSES[:, ::-1], TIMES]), "theta, y, x, stamp\n", ", "),
        ("tum.txt.gz", tum(), "# timestamp tx ty tz qx qy qz qw\n", " "),
        ("tum_plain.txt", tum(), "", " "),
    ],
    ids=lambda value: value if isinstance(value, str) and "." in value else "",
)
def test_every_layout_of_poses_is_the_same_drive(tmp_path, name, rows, header, separator):
    file = write(tmp_path / name, rows, header, separator)
    assert_same_drive(read_odometry(file))
    truth = read_truth(file)
    np.testing.assert_allclose(truth.xy, XY, atol=1e-12)
    np.testing.assert_allclose(truth.heading, np.unwrap(HEADINGS), atol=1e-12)


def test_kitti_poses_are_read_in_the_plane_the_car_drives_in(tmp_path):
    file = write(tmp_path / "00.txt", kitti_rows())
    assert_same_drive(read_odometry(file, rate_hz=2.0))
    truth = read_truth(file, rate_hz=2.0)
    np.testing.assert_allclose(truth.xy, XY, atol=1e-12)
    np.testing.assert_allclose(truth.heading, np.unwrap(HEADINGS), atol=1e-12)


@pytest.mark.parametrize("mounting", [(0, 0, 0), (0, -90, 0), (90, 0, 0), (180, 0, 0), (0, 40, 0)])
def test_headings_do_not_depend_on_how_the_sensor_is_mounted(tmp_path, mounting):
    tilt = Rotation.from_euler("xyz", mounting, degrees=True)
    log = read_odometry(write(tmp_path / "imu.txt", tum(tilt)))
    np.testing.assert_allclose(np.abs(log.turns), np.abs(REFERENCE.turns), atol=1e-12)
    np.testing.assert_allclose(np.abs(log.moves), np.abs(REFERENCE.moves), atol=1e-12)


def test_increments_and_velocities_of_one_drive_agree(tmp_path):
    dt, speed, rate = np.array([0.5, 0.25, 1.0]), np.array([1.0, 2.0, 0.5]), np.array([0.2, -0.4, 0.0])
    times = np.concatenate([[10.0], 10 + np.cumsum(dt)])
    velocities = write(
        tmp_path / "v.dat.gz",
        np.column_stack([times, np.append(speed, 9.0), np.append(rate, 9.0)]),
        "# UTIAS\n# Time [s]    forward velocity [m/s]    angular velocity[rad/s]\n",
        " \t ",
    )
    nameless = write(tmp_path / "v.txt", np.column_stack([times, np.append(speed, 9.0), np.append(rate, 9.0)]))
    increments = write(tmp_path / "i.csv", np.column_stack([times[1:], speed * dt, rate * dt]), "t,ds,dtheta\n", ",")
    logs = [
        read_odometry(velocities),
        read_odometry(nameless, kind="velocities"),
        read_odometry(increments),
    ]
    for log in logs:
        np.testing.assert_allclose(log.moves, logs[0].moves, rtol=1e-12)
        np.testing.assert_allclose(log.turns, rate * dt, rtol=1e-12)
        np.testing.assert_allclose(log.times[1:], times[1:])
    assert [log.holds_velocity for log in logs] == [True, True, False]


def test_columns_can_be_named_by_the_caller(tmp_path):
    rows = np.column_stack([np.full(6, 7.0), XY[:, 1], XY[:, 0], HEADINGS, TIMES])
    file = write(tmp_path / "odd.txt", rows)
    assert_same_drive(read_odometry(file, columns=("id", "y", "x", "heading", "time")))
    with pytest.raises(TrajectoryError, match=r"5 columns do not say what they are"):
        read_odometry(file)
    with pytest.raises(TrajectoryError, match=r"expected 2 columns, time x, got 5"):
        read_truth(file, columns=("time", "x"))


def test_a_matlab_file_is_read_by_variable(tmp_path):
    file = tmp_path / "log.mat"
    savemat(
        file,
        {
            "DR": np.column_stack([TIMES, np.ones(6), np.full(6, 0.1)]),
            "GT": np.column_stack([TIMES, POSES]),
            "note": "hello",
        },
    )
    log = read_odometry(file, kind="increments", variable="DR")
    assert log.turns.tolist() == pytest.approx([0.1] * 6)
    assert len(log.times) == 7  # six steps have seven ends
    assert read_truth(file, variable="GT").heading is not None
    with pytest.raises(TrajectoryError, match=r"expected a variable 'XX', found .*DR 6x3"):
        read_odometry(file, variable="XX")
    with pytest.raises(TrajectoryError, match="say which variable"):
        read_truth(file)
    with pytest.raises(TrajectoryError, match=r"expected variable 'note' to be a matrix of numbers, got char"):
        read_truth(file, variable="note")


BROKEN = {
    "empty.txt": (b"", "expected lines of numbers, found none"),
    "comments.txt": (b"# nothing\n# here\n", "expected lines of numbers, found none"),
    "header.csv": (b"time,x,y\n", "found none after the header"),
    "one_row.txt": (b"0 1 2\n", "at least 2 rows"),
    "ragged.txt": (b"0 1 2\n1 2 3\n2 3\n", r"line 3: expected 3 columns, got 2"),
    "word.txt": (b"# t x y\n0 1 2\n1 two 3\n", r"line 3: expected numbers, got '1 two 3'"),
    "nan.txt": (b"0 1 2\n1 nan 3\n", r"line 2: expected finite numbers"),
    "short_header.csv": (b"time,x\n0,1,2\n1,2,3\n", "expected a header of 3 names"),
    "unknown.csv": (b"a,b,c,d,e\n0,1,2,3,4\n1,2,3,4,5\n", "5 columns named a b c d e do not say what they are"),
    "no_y.csv": (b"time,x,heading\n0,1,2\n1,2,3\n", "expected columns time x y, found time x heading"),
    "binary.txt": (bytes(range(256)), "found binary data"),
    "binary2.txt": (b"0 1 2\n" * 2000 + b"\xff\xfe", "found binary data"),
    "broken.txt.gz": (gzip.compress(b"0 1 2\n1 2 3\n")[:-9], "broken gzip"),
    "plain.txt.gz": (b"0 1 2\n1 2 3\n", "broken gzip"),
    "broken.mat": (b"MATLAB 5.0 MAT-file" + bytes(200), "not a readable MATLAB file|holds nothing"),
    "quaternion.txt": (
        b"0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 3\n",
        "expected unit quaternions, got one of length 3 in row 2",
    ),
    "same_time.txt": (b"0 1 2\n0 1 2\n", "at least 2 different times"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_refused_by_name_and_line(tmp_path, name):
    content, message = BROKEN[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(TrajectoryError, match=message) as caught:
        read_truth(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)


def test_a_missing_file_is_a_trajectory_error(tmp_path):
    with pytest.raises(TrajectoryError, match="No such file"):
        read_truth(tmp_path / "nowhere.txt")


def test_three_nameless_columns_of_odometry_need_a_kind(tmp_path):
    file = write(tmp_path / "log.txt", np.column_stack([TIMES, XY]))
    with pytest.raises(TrajectoryError, match="three nameless columns"):
        read_odometry(file)
    with pytest.raises(TrajectoryError, match="expected poses with a heading"):
        read_odometry(write(tmp_path / "xy.csv", np.column_stack([TIMES, XY]), "t,x,y\n", ","))
    with pytest.raises(ValueError, match="expected kind one of"):
        read_odometry(file, kind="wheels")
    with pytest.raises(ValueError, match="expected rate_hz > 0"):
        read_truth(write(tmp_path / "kitti.txt", kitti_rows()), rate_hz=0)


@given(content=st.binary(max_size=200))
@settings(deadline=None)
def test_whatever_the_bytes_the_answer_is_a_table_or_a_trajectory_error(content, tmp_path_factory):
    file = tmp_path_factory.mktemp("noise") / "noise.txt"
    file.write_bytes(content)
    try:
        table = read_table(file)
    except TrajectoryError:
        return
    assert np.isfinite(table.values).all()


def test_recordings_of_the_wrong_shape_are_refused():
    with pytest.raises(ValueError, match=r"expected distances_m and turns_rad of one shape"):
        OdometryLog.from_increments([1.0, 2.0], [0.0])
    with pytest.raises(ValueError, match=r"expected turns_rad finite, got nan at index \(1,\)"):
        OdometryLog.from_increments([1.0, 2.0], [0.0, np.nan])
    with pytest.raises(ValueError, match=r"expected times_s of shape \(3,\) or \(2,\)"):
        OdometryLog.from_increments([1.0, 2.0], [0.0, 0.0], [0.0])
    with pytest.raises(ValueError, match=r"expected poses of shape \(n, 3\)"):
        OdometryLog.from_poses([(0, 0), (1, 1)])
    with pytest.raises(ValueError, match=r"of one shape \(n,\), n >= 2"):
        OdometryLog.from_velocities([0.0], [1.0], [0.0])
    with pytest.raises(ValueError, match=r"expected heading of shape \(2,\)"):
        Trajectory([0.0, 1.0], [(0, 0), (1, 0)], [0.0])


def test_increments_with_one_time_are_joined_and_their_motion_kept():
    log = OdometryLog.from_increments([1.0, 1.0, 2.0], [0.0, np.pi, 0.0], [0.0, 1.0, 1.0, 2.0])
    assert (log.repeated, log.times.tolist()) == (1, [0.0, 1.0, 2.0])
    whole = OdometryLog.from_increments([1.0, 1.0, 2.0], [0.0, np.pi, 0.0])
    np.testing.assert_allclose(log.positions[-1], whole.positions[-1], atol=1e-12)
    np.testing.assert_allclose(log.headings[-1], whole.headings[-1])


def test_a_part_of_a_log_drives_as_the_whole_did_there():
    part = REFERENCE.between(0.5, 2.0)
    assert part.times.tolist() == [0.5, 1.0, 1.5, 2.0]
    np.testing.assert_array_equal(part.moves, REFERENCE.moves[1:4])
    with pytest.raises(ValueError, match="at least 2 samples"):
        REFERENCE.between(0.6, 0.9)


@pytest.mark.skipif(not DATA.is_dir(), reason="the recorded drives are not here")
def test_the_recorded_drives_are_read_whole():
    plaza = read_odometry(DATA / "plaza1/Plaza1_.mat", kind="increments", variable="DR")
    truth = read_truth(DATA / "plaza1/Plaza1_.mat", variable="GT")
    assert (len(plaza.moves), len(truth.times)) == (9657, 9658)
    assert plaza.travelled[-1] == pytest.approx(1861.3, abs=0.5)
    create = read_odometry(DATA / "mrclam7/Robot1_Odometry.dat.gz")
    assert create.holds_velocity
    assert create.travelled[-1] == pytest.approx(55.31, abs=0.01)
    flight = read_odometry(DATA / "euroc_v1_02/stamped_traj_estimate0.txt.gz")
    seen = read_truth(DATA / "euroc_v1_02/stamped_groundtruth.txt.gz")
    said = np.interp([1403715550.0, 1403715600.0], flight.times, flight.headings)
    was = np.interp([1403715550.0, 1403715600.0], seen.times, seen.heading)
    assert np.diff(said) == pytest.approx(np.diff(was), abs=0.05)  # the body's x axis points up: headings still agree
    car = read_truth(DATA / "kitti_00/KITTI_00_gt.txt.gz")
    assert np.hypot(*np.diff(car.xy, axis=0).T).sum() == pytest.approx(3722.3, abs=0.1)
    course = np.unwrap(np.angle(np.diff(car.positions)))
    assert np.abs(np.angle(np.exp(1j * (course - car.heading[:-1])))).mean() < 0.05  # the car drives where it faces


def driven(rows=300, seed=0):
    """Times, positions and headings of a drive that winds, at 10 Hz, with errors of its own."""
    rng = np.random.default_rng(seed)
    turn = 0.08 * np.sin(np.arange(rows - 1) / 9) + 0.02 + 1e-3 * rng.standard_normal(rows - 1)
    heading = 0.4 + np.concatenate([[0.0], np.cumsum(turn)])
    z = np.concatenate([[0.0], np.cumsum(0.06 * np.exp(1j * (heading[:-1] + turn / 2)))])
    return 1.7e9 + 0.1 * np.arange(rows), np.column_stack([z.real, z.imag]), heading


def test_times_since_1970_are_recognised_by_their_size_and_it_is_said(tmp_path):
    times, xy, heading = driven()
    for power, word in ((9, "nanoseconds"), (6, "microseconds"), (3, "milliseconds")):
        rows = [f"{round(t * 10**power)},{x},{y},{h}" for t, (x, y), h in zip(times, xy, heading, strict=True)]
        (tmp_path / "log.csv").write_text("\n".join(["timestamp,x,y,heading", *rows]))
        log = read_odometry(tmp_path / "log.csv")
        np.testing.assert_allclose(log.times, times, atol=1e-5)
        assert word in log.notes[0]
    named = read_odometry(tmp_path / "log.csv", columns=("time[ms]", "x[mm]", "y[mm]", "heading[deg]"))
    np.testing.assert_allclose(np.abs(named.moves), 1e-3 * np.abs(np.diff(xy[:, 0] + 1j * xy[:, 1])), atol=1e-12)
    assert named.notes == ()


@pytest.mark.parametrize(
    ("header", "scale"), [("speed [km/h]", 3.6), ("speed [mm/s]", 1e3), ("speed[ft/s]", 1 / 0.3048), ("speed", 1.0)]
)
def test_units_in_brackets_are_known_or_refused_with_those_that_are(tmp_path, header, scale):
    rows = [f"{k},{scale * 0.5},0.1" for k in range(5)]
    (tmp_path / "v.csv").write_text("\n".join([f"time,{header},turn_rate [rad/s]", *rows]))
    assert read_odometry(tmp_path / "v.csv").travelled[-1] == pytest.approx(2.0, rel=1e-3)
    (tmp_path / "v.csv").write_text("\n".join(["time,speed [furlongs],turn_rate", *rows]))
    with pytest.raises(TrajectoryError, match=r"unknown unit \[furlongs\] of column 'speed'; known: .*km/h"):
        read_odometry(tmp_path / "v.csv")


def test_poses_and_commands_side_by_side_need_a_kind_but_for_a_ros_message(tmp_path):
    times, xy, heading = driven()
    rows = np.column_stack([times, xy, heading, np.full(len(times), 0.6), np.zeros(len(times))])
    file = write(tmp_path / "both.csv", rows, "time,x,y,theta,v,w\n", ",")
    with pytest.raises(TrajectoryError, match="holds velocities and poses: say by kind"):
        read_odometry(file)
    np.testing.assert_allclose(np.diff(heading), read_odometry(file, kind="poses").turns, atol=1e-9)
    assert read_odometry(file, kind="velocities").holds_velocity


def ros_rows():
    times, xy, heading = driven()
    pose = np.column_stack([xy, 0 * heading, 0 * heading, 0 * heading, np.sin(heading / 2), np.cos(heading / 2)])
    return times, pose, heading


def test_ros_messages_are_read_by_their_field_names_from_whatever_wrote_them(tmp_path):
    times, pose, heading = ros_rows()
    stamps = [round(1e9 * t) for t in times]
    fields = [f"position.{a}" for a in "xyz"] + [f"orientation.{a}" for a in "xyzw"]
    echo = ",".join(
        ["%time", "field.header.frame_id", *(f"field.pose.pose.{f}" for f in fields), "field.twist.twist.linear.x"]
    )
    juggler = ",".join(
        ["__time", *(f"/odom/pose/pose/{f.replace('.', '/')}" for f in fields), "/odom/twist/twist/linear/x"]
    )
    split = ",".join(["header.stamp.sec", "header.stamp.nanosec", "child_frame_id", *(f"pose.{f}" for f in fields)])
    ends = [",".join(map(str, row)) for row in pose]
    covariance = ",".join(["0.1"] * 36)
    texts = {
        "echo.csv": [echo, *(f"{s},odom,{e},0.6" for s, e in zip(stamps, ends, strict=True))],
        "juggler.csv": [juggler, *(f"{t},{e},0.6" for t, e in zip(times, ends, strict=True))],
        "split.csv": [split, *(f"{s // 10**9},{s % 10**9},base,{e}" for s, e in zip(stamps, ends, strict=True))],
        "ros2.csv": [
            f"{s // 10**9},{s % 10**9},odom,base,{e},{covariance},0.6,0,0,0,0,0.1,{covariance}"
            for s, e in zip(stamps, ends, strict=True)
        ],
    }
    for name, lines in texts.items():
        (tmp_path / name).write_text("\n".join(lines))
        log = read_odometry(tmp_path / name)
        np.testing.assert_allclose(log.times, times, atol=1e-5)
        np.testing.assert_allclose(log.turns, np.diff(heading), atol=1e-9)
        np.testing.assert_allclose(read_truth(tmp_path / name).xy, pose[:, :2], atol=1e-12)


def test_rows_out_of_order_are_sorted_bad_stamps_dropped_and_restarts_cut(tmp_path):
    times, xy, heading = driven()
    rows = np.column_stack([times - 1.7e9, xy, heading])
    shuffled = rows[np.argsort(np.arange(len(rows)) + np.random.default_rng(0).uniform(0, 4, len(rows)))]
    log = read_odometry(write(tmp_path / "shuffled.txt", shuffled))
    np.testing.assert_allclose(log.turns, np.diff(heading), atol=1e-12)
    assert "were not in the order of their times, and were sorted" in log.notes[0]
    bad = rows.copy()
    bad[[40, 90, 91 + 50], 0] = [0.0, 1e4, 3.0]
    log = read_odometry(write(tmp_path / "bad.txt", bad))
    assert len(log.times) == len(rows) - 3
    assert log.positions[-1] == pytest.approx((xy[-1] - xy[0]) @ [1, 1j] * np.exp(-1j * heading[0]), abs=1e-9)
    restarted = rows.copy()
    restarted[180:, 0] -= 15.0
    log = read_odometry(write(tmp_path / "restarted.txt", restarted))
    assert log.times.tolist() == rows[:180, 0].tolist()
    assert "the clock is set back by 14.9 s in row 181: the log is cut there, and rows 1 to 180 of 300" in log.notes[0]
    with pytest.raises(TrajectoryError, match=r"times fall in \d+ of 300 rows: is the first column no time"):
        read_truth(
            write(tmp_path / "no_time.txt", np.column_stack([5 * np.sin(np.arange(300) / 40), xy[:, 0], heading]))
        )


def test_rows_with_missing_numbers_are_left_out_and_said_or_refused(tmp_path):
    times, xy, heading = driven()
    rows = zip(times, xy, heading, strict=True)
    lines = ["time,x,y,heading,battery", *(f"{t},{x},{y},{h}," for t, (x, y), h in rows)]
    lines[5:10] = [f"{t},,,," for t in times[4:9]]
    (tmp_path / "gaps.csv").write_text("\n".join(lines))
    truth = read_truth(tmp_path / "gaps.csv")
    assert len(truth.times) == len(times) - 5
    assert "5 of 300 rows, the first in line 6, miss a number" in truth.notes[0]
    lines[5:105] = [f"{t},,,nan," for t in times[4:104]]
    (tmp_path / "gaps.csv").write_text("\n".join(lines))
    with pytest.raises(TrajectoryError, match="expected columns time x y"):
        read_truth(tmp_path / "gaps.csv")


def test_headings_that_do_not_follow_the_way_are_refused_if_another_reading_does(tmp_path):
    times, xy, heading = driven()
    for name, rows, words in (
        ("deg.txt", np.column_stack([times, xy, np.degrees(heading)]), "headings in degrees"),
        ("cw.txt", np.column_stack([times, xy, -heading]), "clockwise headings"),
        ("yx.txt", np.column_stack([times, xy[:, ::-1], heading]), "x and y the other way round|from the y axis"),
    ):
        with pytest.raises(TrajectoryError, match=f"do not follow the way driven; ({words}).* would fit"):
            read_truth(write(tmp_path / name, rows))
    w_first = np.column_stack([times, xy, 0 * times, np.cos(heading / 2), 0 * times, 0 * times, np.sin(heading / 2)])
    with pytest.raises(TrajectoryError, match="w first, qw qx qy qz, would fit: name the columns"):
        read_truth(write(tmp_path / "w.txt", w_first))
    named = read_truth(tmp_path / "w.txt", columns=["time", "x", "y", "z", "qw", "qx", "qy", "qz"])
    np.testing.assert_allclose(named.heading, heading, atol=1e-9)
    drone = np.column_stack([times, xy, 3 * np.sin(times)])  # looks about, whatever the way
    np.testing.assert_allclose(read_truth(write(tmp_path / "drone.txt", drone)).heading, drone[:, 3], atol=1e-9)


def test_a_kitti_file_that_moves_in_x_and_y_is_no_cameras(tmp_path):
    _, xy, heading = driven()
    c, s, zero, one = np.cos(heading), np.sin(heading), 0 * heading, 1 + 0 * heading
    lidar = np.column_stack([c, -s, zero, xy[:, 0], s, c, zero, xy[:, 1], zero, zero, one, zero])
    with pytest.raises(TrajectoryError, match="a frame with z upwards, as a lidar's or a robot's"):
        read_odometry(write(tmp_path / "lidar.txt", lidar))
    numbered = np.column_stack([np.arange(6), kitti_rows()])
    assert_same_drive(read_odometry(write(tmp_path / "numbered.txt", numbered), rate_hz=2.0))
    timed = np.column_stack([3 * TIMES, kitti_rows()])
    np.testing.assert_allclose(read_truth(write(tmp_path / "timed.txt", timed)).times, 3 * TIMES)


CASES = DATA.parent / "cases" / "logs"
SAME_DRIVE = {  # files that hold the drive of odometry.csv or truth.csv, and what is said of them
    "kitti_camera_frame.txt": "",
    "odometry.csv": "",
    "odometry_clock_back.csv": "the clock is set back by .* s in row .*: the log is cut there",
    "odometry_degrees.csv": "",
    "ros_echo.csv": "are taken for nanoseconds since 1970",
    "truth.csv": "",
    "truth_ns.csv": "are taken for nanoseconds since 1970",
    "velocities.csv": "",
    "velocities_kmh.csv": "",
    "velocities_ns.csv": "are taken for nanoseconds since 1970",
    "velocities_out_of_order.csv": "rows were not in the order of their times, and were sorted",
}
REFUSED = {
    "kitti_lidar_frame.txt": "a frame with z upwards, as a lidar's or a robot's; write time, x, y, heading",
    "pose_and_command.csv": "holds velocities and poses: say by kind which of them the odometry is",
    "truth_wxyz.txt": "the headings do not follow the way driven; w first, qw qx qy qz, would fit",
    "truth_x_y_yaw.txt": "times fall in 1544 of 2401 rows: is the first column no time",
}
needs_cases = pytest.mark.skipif(not CASES.is_dir(), reason="the cases are not here")


@needs_cases
@pytest.mark.parametrize("name", SAME_DRIVE)
def test_logs_that_people_have_hold_the_same_drive(name):
    truth = name.startswith(("truth", "kitti"))
    log = (read_truth if truth else read_odometry)(CASES / name)
    whole = read_truth(CASES / "truth.csv") if truth else read_odometry(CASES / "odometry.csv")
    np.testing.assert_allclose(log.positions, whole.positions[: len(log.times)], atol=0.05)
    assert len(log.notes) == bool(SAME_DRIVE[name])
    assert re.search(SAME_DRIVE[name], "".join(log.notes))


@needs_cases
@pytest.mark.parametrize("name", REFUSED)
def test_logs_that_can_be_read_in_two_ways_are_refused_with_the_cause(name):
    with pytest.raises(TrajectoryError, match=REFUSED[name]):
        (read_truth if name.startswith("truth") else read_odometry)(CASES / name)


@needs_cases
def test_every_log_that_people_have_is_tried():
    assert {file.name for file in CASES.iterdir()} == {*SAME_DRIVE, *REFUSED}


@needs_cases
def test_odometry_as_its_own_truth_and_the_two_swapped_are_noticed():
    odometry, truth = CASES / "odometry.csv", CASES / "truth.csv"
    with pytest.raises(ValueError, match="got no error at all: are odometry and truth the same file"):
        fit_noise(read_odometry(odometry), read_truth(odometry))
    swapped = fit_noise(read_odometry(truth), read_truth(odometry), resamples=100)
    assert "The truth begins at (0, 0), the odometry elsewhere: are the two swapped?" in swapped.notes
