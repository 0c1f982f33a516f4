"""Covariances of odometry messages, for nav_msgs/Odometry and robot_localization, from a noise."""

from __future__ import annotations

from math import degrees

import numpy as np

from driftplan.arrays import Floats, as_plane, not_negative, number, positive
from driftplan.model.drift import predict_drift
from driftplan.model.noise import OdometryNoise

_AXES = {"x": 0, "y": 1, "yaw": 5}  # of x, y, z, roll, pitch, yaw


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
    if noise.step_m is not None:
        raise ValueError("expected a noise of the continuous model, got noise per step (step_m)")
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
    return "\n".join(
        [
            f"# Odometry at {speed:g} m/s and {turning:g} rad/s, {rate:g} messages a second; x y z roll pitch yaw.",
            f"# To be corrected first: distances are measured {scale:.5g} times too long, turns {turned:.5g} times too",
            f"# far, and {bias:.4g} deg to the left per metre. Units: (m/s)^2, (rad/s)^2, and m^2, rad^2.",
            f"twist_covariance: {_row_by_row(twist)}",
            f"pose_covariance: {_row_by_row(pose)}  # after {length:g} m, straight on from a known pose",
            "",
        ]
    )


def _row_by_row(planar: Floats) -> list[float]:
    """36 numbers, of which those of x, y and yaw are given, (3, 3)."""
    full, own = np.zeros((6, 6)), list(_AXES.values())
    full[np.ix_(own, own)] = planar
    return [float(f"{value:.6g}") for value in full.ravel()]
