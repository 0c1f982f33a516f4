"""Noise in files: as YAML, which scenarios, scripts and people read, and as the covariances of ROS's messages."""

from __future__ import annotations

import os
from dataclasses import fields
from math import degrees
from pathlib import Path
from reprlib import repr as short
from typing import Any

import numpy as np

from driftplan.arrays import Floats, as_plane, not_negative, number, positive
from driftplan.errors import TrajectoryError, naming
from driftplan.files import head, write_files
from driftplan.model.calibration.fit import NoiseFit
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise, check_continuous
from driftplan.world.plain_data import read_yaml

_KEYS = tuple(f.name for f in fields(OdometryNoise))


def save_noise(path: str | os.PathLike[str], noise: OdometryNoise | NoiseFit) -> None:
    """Write a noise, or a fitted one with its intervals as comments, under the names of `OdometryNoise`.

    >>> import tempfile
    >>> noise = OdometryNoise(heading_var_per_m=1e-4, distance_scale_error=-0.01)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_noise(Path(folder) / "noise.yaml", noise)
    ...     load_noise(Path(folder) / "noise.yaml") == noise
    True
    """
    write_files({Path(path): noise_yaml(noise)})


def noise_yaml(noise: OdometryNoise | NoiseFit) -> bytes:
    """What `save_noise` writes."""
    lines = [f"{head('of the robot')}# Noise of an odometry for driftplan, in SI units and radians."]
    if isinstance(noise, NoiseFit):
        counts = noise.counts
        lines += [
            f"# Fitted to {counts.used_m:.1f} m of drives ({counts.turned_rad:.1f} rad turned); brackets:",
            f"# {100 * noise.confidence:g} % intervals.",
            *(f"# {note}" for note in noise.notes),
        ]
        for name, (low, high) in noise.intervals.items():
            lines.append(f"{name}: {_yaml(getattr(noise.noise, name))}  # [{low:.3g}, {high:.3g}]")
        lines += [f"{name}: {_yaml(value)}  # from drive to drive" for name, value in noise.between_drives.items()]
    else:
        lines += [f"{name}: {_yaml(value)}" for name, value in noise.given().items()] or ["{}"]
    return ("\n".join(lines) + "\n").encode()


def load_noise(path: str | os.PathLike[str]) -> OdometryNoise:
    """Read a noise from YAML: keys are the names of `OdometryNoise`, what is missing has its default.

    Raises TrajectoryError if the file is missing or broken, has unknown keys or values out of range: the message names
    file and key.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "noise.yaml").write_text("heading_var_per_m: 1e-4\\n")
    ...     load_noise(Path(folder, "noise.yaml"))
    OdometryNoise(heading_var_per_m=0.0001)
    """
    file = Path(path)
    content = read_yaml(file, TrajectoryError, max_bytes=1 << 20)
    if not isinstance(content, dict):
        such = "such as heading_var_per_m: 1.0e-4"
        raise TrajectoryError(f"{file}: expected keys of OdometryNoise, {such}, got {short(content)}")
    if unknown := [key for key in content if key not in _KEYS]:
        raise TrajectoryError(f"{file}: unknown key {short(unknown[0])}; expected keys of {', '.join(_KEYS)}")
    with naming(file, TrajectoryError):
        return OdometryNoise(**content)


def _yaml(value: Any) -> str:
    """A scalar that YAML reads back as the same value: floats always have a point, or YAML 1.1 takes 1e-4 for text."""
    if not isinstance(value, float):
        return str(value)
    text = repr(float(np.float64(value)))
    return text if "." in text else text.replace("e", ".0e")


_PLANAR = [0, 1, 5]  # x, y and yaw, of x, y, z, roll, pitch, yaw


def ros_covariances(
    noise: OdometryNoise,
    *,
    rate_hz: float,
    speed_m_per_s: float,
    turn_rate_rad_per_s: float = 0.0,
    driven_m: float = 10.0,
) -> str:
    """The covariances that a driver should put into its odometry messages, as YAML.

    The twist's are those of the mean speed and turn rate between two messages; the pose's those after a straight drive
    from a known pose (averaged over drives, if systematic errors differ between them). Matrices of x, y, z, roll,
    pitch, yaw, row by row, in the robot's frame (x forward); what planar odometry does not tell is 0, and must not be
    fused. Known systematic errors are no covariance: they are to be corrected, as the comments say.

    Parameters
    ----------
    noise : of the continuous model (no ``step_m``)
    rate_hz : messages per second
    speed_m_per_s, turn_rate_rad_per_s : of the robot; the variance of its twist grows with both
    driven_m : length of the drive, metres

    Raises ValueError for a noise per step, and for values out of range.

    >>> noise = OdometryNoise(heading_var_per_m=1e-4, distance_var_per_m=4e-4)
    >>> print(ros_covariances(noise, rate_hz=10.0, speed_m_per_s=0.5).splitlines()[3][:40])
    twist_covariance: [0.002, 0.0, 0.0, 0.0,
    """
    check_continuous([noise])
    rate, speed = positive("rate_hz", rate_hz), not_negative("speed_m_per_s", speed_m_per_s)
    turning, length = abs(number("turn_rate_rad_per_s", turn_rate_rad_per_s)), positive("driven_m", driven_m)
    twist = np.zeros((3, 3))
    twist[0, 0] = (noise.distance_var_per_m * speed + noise.distance_var_per_rad * turning) * rate
    twist[1, 1] = noise.lateral_var_per_m * speed * rate
    twist[2, 2] = (noise.heading_var_per_m * speed + noise.heading_var_per_rad * turning) * rate
    end = predict_drift([(0.0, 0.0), (length, 0.0)], noise.corrected()).end
    moments, pose = end.moments, np.zeros((3, 3))
    pose[:2, :2] = end.cov
    pose[:2, 2] = pose[2, :2] = as_plane((moments.b - moments.a) / 2j - moments.e1 * np.imag(moments.d1))
    pose[2, 2] = float(end.heading_std) ** 2
    scale, turned = 1 + noise.distance_scale_error, 1 + noise.heading_bias_per_rad
    bias = degrees(noise.heading_bias_per_m)
    return (
        f"# Odometry at {speed:g} m/s and {turning:g} rad/s, {rate:g} messages a second; x y z roll pitch yaw.\n"
        f"# To be corrected first: distances are measured {scale:.5g} times too long, turns {turned:.5g} times too\n"
        f"# far, and {bias:.4g} deg to the left per metre. Units: (m/s)^2, (rad/s)^2, and m^2, rad^2.\n"
        f"twist_covariance: {_row_by_row(twist)}\n"
        f"pose_covariance: {_row_by_row(pose)}  # after {length:g} m, straight on from a known pose\n"
    )


def _row_by_row(planar: Floats) -> list[float]:
    """36 numbers, of which those of x, y and yaw are given, (3, 3)."""
    full = np.zeros((6, 6))
    full[np.ix_(_PLANAR, _PLANAR)] = planar
    return [float(f"{value:.6g}") for value in full.ravel()]
