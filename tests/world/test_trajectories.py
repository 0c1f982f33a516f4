"""Trajectories and paths: real recordings keep their length and heading, and a broken path file is named by line."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from driftplan.errors import TrajectoryError
from driftplan.world.route_files import read_path, read_trajectory

DATA = Path(__file__).resolve().parents[2] / "../shared/data"


def real(name: str) -> Path:
    if not (DATA / name).exists():
        pytest.skip(f"needs {name} in shared/data, made by others and not shipped")
    return DATA / name


@pytest.mark.parametrize(
    "text",
    [
        "x,y\n0,1\n2,3.5\n4,5\n",
        "0,1\n2,3.5\n4,5\n",
        "# a comment\n0 1\n\n2\t3.5\n4 5\n",
        "y;x\n1;0\n3.5;2\n5;4\n",
        "x [mm], y [cm]\n0,100\n2000,350\n4000,500\n",
        "\ufeffx,y\r\n0,1\r\n2,3.5\r\n4,5\r\n",
    ],
    ids=["header", "bare", "blanks", "swapped", "units", "windows"],
)
def test_a_path_is_read_whatever_its_layout(tmp_path, text):
    file = tmp_path / "path.csv"
    file.write_bytes(text.encode())
    assert read_path(file).tolist() == [[0, 1], [2, 3.5], [4, 5]]
    (tmp_path / "path.csv.gz").write_bytes(gzip.compress(text.encode()))
    assert read_path(tmp_path / "path.csv.gz").tolist() == [[0, 1], [2, 3.5], [4, 5]]


@pytest.mark.parametrize(
    "text", ["0,1,1.5\n2,3,-1.5\n", "x,y,heading\n0,1,1.5\n2,3,-1.5\n", "theta,x,y\n1.5,0,1\n-1.5,2,3\n"]
)
def test_poses_have_their_heading_last(tmp_path, text):
    file = tmp_path / "path.csv"
    file.write_text(text)
    assert read_path(file).tolist() == [[0, 1, 1.5], [2, 3, -1.5]]


def test_headings_in_degrees_are_converted(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("x,y,heading [deg]\n0,1,90\n2,3,-180\n")
    assert read_path(file)[:, 2] == pytest.approx([np.pi / 2, -np.pi])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"path\.csv: expected lines of numbers, found none"),
        ("x,y\n0,0\n", r"path\.csv: expected at least 2 rows of numbers, got 1"),
        ("x,y\n0,0\n1,one\n", r"path\.csv, line 3: expected numbers, got '1 one'"),
        ("x,y\n0,0\n1,2,3\n", r"path\.csv, line 3: expected 2 columns, got 3"),
        ("0,0\n1,nan\n", "line 2: expected finite numbers"),
        ("0,0\n1,inf\n", "line 2: expected finite numbers"),
        ("0\n1\n", "expected the columns x, y and perhaps heading, got 1"),
        ("0,0,0,0,0\n1,1,1,1,1\n", "expected the columns x, y and perhaps heading, got 5"),
        ("x,y,speed\n0,0,1\n1,1,1\n", "expected the columns x, y and perhaps heading, got 3 called x, y, speed"),
        ("lon,lat\n0,0\n1,1\n", "got 2 called lon, lat"),
        ("x,y,heading_deg\n0,0,1\n1,1,1\n", "got 3 called x, y, heading_deg"),
        ("\0\1\2", "expected text, found binary data"),
    ],
    ids=range(12),
)
def test_a_bad_path_is_named_by_file_and_line(tmp_path, text, message):
    file = tmp_path / "path.csv"
    file.write_text(text)
    with pytest.raises(TrajectoryError, match=message):
        read_path(file)


def test_headings_that_only_make_sense_in_degrees_are_refused(tmp_path):
    file = tmp_path / "square.csv"
    file.write_text("x,y,yaw\n0,0,0\n10,0,90\n10,10,180\n0,10,270\n0,0,0\n")
    with pytest.raises(TrajectoryError, match=r"if they are degrees, not if they are radians: .* heading \[deg\]"):
        read_path(file)
    file.write_text("x,y,yaw [deg]\n0,0,0\n10,0,90\n10,10,180\n0,10,270\n0,0,0\n")
    assert read_path(file)[3, 2] == pytest.approx(1.5 * np.pi)
    file.write_text("x,y,yaw [rad]\n0,0,0\n10,0,90\n10,10,180\n0,10,270\n0,0,0\n")
    assert read_path(file)[3, 2] == 270


def test_decimal_commas_are_refused(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("1,5;2\n3,5;2\n")
    with pytest.raises(TrajectoryError, match="line 1: comma and semicolon in one line can be read in two ways"):
        read_path(file)


def test_the_kitti_drive_is_as_long_as_known_and_faces_forward():
    drive = read_trajectory(real("kitti_00/KITTI_00_gt.txt.gz"))
    steps = np.diff(drive.xy, axis=0)
    length = np.hypot(*steps.T)
    # 3.72 km is the sequence's published length in space; in the plane a little less.
    assert 3690 < length.sum() < 3725
    assert len(drive.times) == 4541
    assert drive.times[-1] == pytest.approx(454.0)
    # A car drives where it looks: forward is x of the first pose, and every step goes along the heading.
    assert drive.xy[10] == pytest.approx([8.6, 0.5], abs=0.5)
    driving = length > 0.3
    along = steps[driving] / length[driving, None]
    heading = 0.5 * (drive.heading[1:] + drive.heading[:-1])[driving]
    cosine = along[:, 0] * np.cos(heading) + along[:, 1] * np.sin(heading)
    assert np.median(cosine) > 0.999


def test_the_flight_and_its_estimates_have_the_same_length():
    truth = read_trajectory(real("euroc_v1_02/stamped_groundtruth.txt.gz"))
    assert truth.xy[0] == pytest.approx([0.515356, 1.996773])
    for k in range(2):
        estimate = read_trajectory(real(f"euroc_v1_02/stamped_traj_estimate{k}.txt.gz"))
        during = truth.between(estimate.times[0], estimate.times[-1])
        lengths = [np.hypot(*np.diff(_every_half_second(t), axis=0).T).sum() for t in (during, estimate)]
        assert lengths[1] == pytest.approx(lengths[0], rel=0.02)  # the estimate drifts by less than 2 %
        assert during.heading is not None
        assert estimate.heading is not None
        turned = np.interp(estimate.times, during.times, during.heading) - estimate.heading
        assert np.std(turned) < 0.1  # the same heading but for the unknown yaw of its origin


def _every_half_second(trajectory) -> np.ndarray:
    """Coarse, because the noise of 200 Hz adds length."""
    at = np.arange(trajectory.times[0], trajectory.times[-1], 0.5)
    return np.stack([np.interp(at, trajectory.times, trajectory.xy[:, k]) for k in (0, 1)], axis=-1)
