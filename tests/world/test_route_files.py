"""Routes as ROS has them: what is written says the same as the route, and is read back."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from driftplan import (
    OdometryNoise,
    TrajectoryError,
    poses_csv,
    poses_yaml,
    predict_drift,
    read_path,
    ros_path_yaml,
    waypoints_yaml,
)
from driftplan.report.cli import main
from driftplan.world.route_files import poses_along


def _held(text):
    """As any loader has it; with libyaml, which takes a fifth of the time."""
    return yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))


NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=1e-4)
places = st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=2, max_size=8, unique=True)
far_apart = places.filter(lambda path: (np.hypot(*np.diff(path, axis=0).T) > 0.01).all())


@given(path=far_apart, spacing=st.floats(0.1, 9.0))
@settings(max_examples=30, deadline=None)
def test_poses_are_on_the_route_no_farther_apart_than_asked_and_look_ahead(path, spacing):
    path = np.array(path)
    poses, driven = poses_along(path, spacing)
    step = np.diff(poses[:, :2], axis=0)
    length = np.hypot(*step.T)
    assert length.max() <= spacing * (1 + 1e-6)
    assert length.sum() == pytest.approx(np.hypot(*np.diff(path, axis=0).T).sum())
    np.testing.assert_allclose(np.append(0, np.cumsum(length)), driven, atol=1e-9 * (1 + driven[-1]))
    ahead = np.exp(1j * poses[:-1, 2])
    np.testing.assert_allclose(step @ [1, 1j], length * ahead, atol=1e-9)
    assert all(np.hypot(*(poses[:, :2] - corner).T).min() < 1e-9 for corner in path)


@pytest.mark.slow
@given(path=far_apart)
@settings(max_examples=20, deadline=None)
def test_what_is_written_is_yaml_and_read_back(path, tmp_path_factory):
    file = tmp_path_factory.mktemp("path") / "path.yaml"
    drift = predict_drift(path, NOISE)
    for content, expected in (
        (ros_path_yaml(drift, spacing_m=1.0), poses_along(np.array(path), 1.0)[0]),
        (waypoints_yaml(drift), poses_along(np.array(path), 1e3)[0]),
    ):
        file.write_bytes(content)
        held = _held(content)
        assert {pose["header"]["frame_id"] for pose in held["poses"]} == {"map"}
        again = read_path(file)
        np.testing.assert_allclose(again[:, :2], expected[:, :2], atol=1e-6)
        np.testing.assert_allclose(np.exp(1j * again[:, 2]), np.exp(1j * expected[:, 2]), atol=1e-5)
    assert len(again) == len(path)


@given(path=far_apart)
@settings(max_examples=6, deadline=None)
def test_poses_with_covariances_are_messages_and_read_back(path, tmp_path_factory):
    file = tmp_path_factory.mktemp("path") / "poses.yaml"
    drift = predict_drift(path, NOISE)
    file.write_bytes(poses_yaml(drift, spacing_m=5.0))
    poses, driven = poses_along(np.array(path), 5.0)
    np.testing.assert_allclose(read_path(file)[:, :2], poses[:, :2], atol=1e-6)
    held = [pose["pose"]["covariance"] for pose in _held(file.read_text())["poses"]]
    assert {type(value) for row in held for value in row} == {float}
    cov = np.array(held).reshape(-1, 6, 6)
    at = drift.at(np.minimum(driven, float(drift.length)))
    np.testing.assert_allclose(cov[:, :2, :2], at.cov, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(cov[:, 5, 5], at.heading_std**2, rtol=1e-6, atol=1e-12)


def test_every_pose_has_the_covariance_of_the_prediction_there():
    drift = predict_drift([(0, 0), (4, 0), (4, 2)], NOISE)
    _, names, *rows = poses_csv(drift, spacing_m=1.0).decode().splitlines()
    table = dict(zip(names.split(","), np.array([row.split(",") for row in rows], dtype=float).T, strict=True))
    at = drift.at(np.arange(7.0))
    np.testing.assert_allclose(table["cov_xx_m2"], at.cov[:, 0, 0], atol=1e-9)
    np.testing.assert_allclose(table["cov_xy_m2"], at.cov[:, 0, 1], atol=1e-9)
    np.testing.assert_allclose(table["heading_var_rad2"], at.heading_std**2, atol=1e-9)
    np.testing.assert_allclose(2 * np.arctan2(table["qz"], table["qw"]), table["heading_rad"], atol=1e-8)


def test_the_drift_of_what_was_written_is_that_of_the_route(tmp_path, capsys):
    drift = predict_drift([(0, 0), (4, 0), (4, 2)], NOISE)
    (tmp_path / "path.yaml").write_bytes(ros_path_yaml(drift))
    assert predict_drift(read_path(tmp_path / "path.yaml"), NOISE).end.rms == pytest.approx(drift.end.rms, rel=1e-5)
    assert main(["predict", str(tmp_path / "path.yaml")]) == 0
    assert "6.00 m" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("poses: []", "expected 2 or more poses"),
        ("x: 1", "expected 2 or more poses"),
        ("poses: [1, 2]", "pose 1: expected position x, y"),
        ("poses: [{pose: {position: {x: 1}}}, 2]", "pose 1: expected position x, y"),
        ("poses: [{pose: {position: {x: 1, y: 2}, orientation: {w: 2}}}, 2]", "pose 1: expected a unit quaternion"),
        ("poses: [{pose: {position: {x: 1, y: 2}, orientation: {w: 1e200}}}, 2]", "pose 1: expected a unit quaternion"),
        ("poses: [{pose: {position: {x: .nan, y: 2}, orientation: {w: 1}}}, "
         "{pose: {position: {x: 1, y: 2}, orientation: {w: 1}}}]", "expected finite poses"),
    ],
)  # fmt: skip
def test_what_is_no_path_is_refused(tmp_path, text, said):
    (tmp_path / "path.yaml").write_text(text)
    with pytest.raises(TrajectoryError, match=said):
        read_path(tmp_path / "path.yaml")
