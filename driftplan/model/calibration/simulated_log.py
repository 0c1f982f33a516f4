"""simulate_log: the recording of one simulated drive, to try calibration on and to test it with.

Like `simulation` it knows no formula of the moments.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from driftplan.arrays import Floats, bounded, generator, not_negative, positive
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Runs, read_path

_TURN_STEP_RAD = 0.05  # of a turn on the spot


def simulate_log(
    path: Any,
    noise: OdometryNoise,
    *,
    rng: np.random.Generator | int = 0,
    step_m: float = 0.1,
    speed_m_per_s: float = 1.0,
    truth_position_std_m: float = 0.0,
    truth_heading_std: float = 0.0,
    start_heading: float | ArrayLike | None = None,
) -> tuple[OdometryLog, Trajectory]:
    """Odometry and truth of one simulated drive along a path.

    Parameters
    ----------
    path, start_heading : one path, as for `driftplan.model.drift.predict_drift`
    noise : of the continuous model, with Gaussian errors and no ``heading_distance_corr``
    rng : numpy.random.Generator or seed
    step_m : distance between samples, metres; turns on the spot are sampled every 0.05 rad
    speed_m_per_s : speed between samples; on the spot one radian takes as long as one metre
    truth_position_std_m, truth_heading_std : white errors of the recorded truth: metres per coordinate, rad

    >>> odometry, truth = simulate_log([(0, 0), (10, 0), (10, 5)], OdometryNoise(distance_scale_error=0.02))
    >>> odometry.travelled[-1].round(6).item(), truth.xy[-1].round(6).tolist()
    (15.3, [10.0, 5.0])
    """
    if noise.step_m is not None or noise.heading_distance_corr != 0:
        raise ValueError(f"expected a noise of the continuous model without heading_distance_corr, got {noise!r}")
    step_m, speed_m_per_s = positive("step_m", step_m), positive("speed_m_per_s", speed_m_per_s)
    not_negative("truth_position_std_m", truth_position_std_m), not_negative("truth_heading_std", truth_heading_std)
    rng = generator(rng)
    noise = noise.on_drive(rng.standard_normal(3).tolist()) if noise.varies_between_drives else noise
    runs = read_path(path, start_heading)
    if runs.lengths.ndim != 1:
        raise ValueError(f"expected one path, got a batch of shape {runs.lengths.shape[:-1]}: simulate one by one")
    bounded("samples", float(np.sum(runs.lengths)) / step_m, 1e8, "use a larger step_m")
    moved, turned = _steps(runs, step_m)
    n = len(moved)
    times = np.concatenate([[0.0], np.cumsum((moved + np.abs(turned) * (moved == 0)) / speed_m_per_s)])
    truth = OdometryLog.from_increments(moved, turned, times)

    angle = np.abs(turned)
    along = np.sqrt(noise.distance_var_per_m * moved + noise.distance_var_per_rad * angle) * rng.standard_normal(n)
    across = np.sqrt(noise.lateral_var_per_m * moved) * rng.standard_normal(n)
    heading_std = np.sqrt(noise.heading_var_per_m * moved + noise.heading_var_per_rad * angle)
    turns = (1 + noise.heading_bias_per_rad) * turned + noise.heading_bias_per_m * moved
    turns = turns + heading_std * rng.standard_normal(n)
    arcs = OdometryLog.from_increments((1 + noise.distance_scale_error) * moved, turns, times)
    moves = arcs.moves + (along + 1j * across) * np.exp(0.5j * turns)

    positions = complex(runs.start) + truth.positions * np.exp(1j * runs.heading)
    xy = np.stack([positions.real, positions.imag], axis=-1) + truth_position_std_m * rng.standard_normal((n + 1, 2))
    heading = truth.headings + float(runs.heading) + truth_heading_std * rng.standard_normal(n + 1)
    return OdometryLog(times, moves, turns), Trajectory(times, xy, heading)


def _steps(runs: Runs, step_m: float) -> tuple[Floats, Floats]:
    """Distance and turn of every sample: turns on the spot, then runs, in equal pieces."""
    moved, turned = [], []
    for turn, length, curvature in zip(runs.turns, runs.lengths, runs.curvatures, strict=True):
        spots = int(np.ceil(abs(turn) / _TURN_STEP_RAD - 1e-9))
        pieces = int(np.ceil(length / step_m - 1e-9))
        moved += [np.zeros(spots), np.full(pieces, length / max(pieces, 1))]
        turned += [np.full(spots, turn / max(spots, 1)), np.full(pieces, curvature * length / max(pieces, 1))]
    return np.concatenate(moved), np.concatenate(turned)
