"""One drive in every kind of log, against a truth sampled at other times: the same noise is fitted to all of them."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from driftplan.model.calibration.fit import fit_noise
from driftplan.model.calibration.recordings import simulate_log
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Run
from driftplan.world.odometry_logs import read_odometry, read_truth

NOISE = OdometryNoise(heading_var_per_m=1e-3, distance_var_per_m=4e-4, distance_scale_error=0.02)
FITTED = ("distance_scale_error", "heading_var_per_m", "distance_var_per_m")
RATE_HZ = 10.0  # 0.1 m at 1 m/s


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(4)
    path = [Run(length_m=3.0, curvature_per_m=rng.uniform(-0.8, 0.8)) for _ in range(100)]
    return simulate_log(path, NOISE, rng=rng, truth_position_std_m=0.003)


def write(file: Path, rows, header=""):
    text = header + "".join(",".join(f"{v:.12g}" for v in row) + "\n" for row in rows)
    if file.suffix == ".gz":
        file.write_bytes(gzip.compress(text.encode()))
    else:
        file.write_text(text)
    return file


def tum_rows(times, positions, headings):
    zero = np.zeros(len(times))
    turns = Rotation.from_euler("z", headings[:, None]).as_quat()
    return np.column_stack([times, positions.real, positions.imag, zero, turns])


@pytest.fixture(scope="module")
def truth_file(drive, tmp_path_factory):
    """The truth 7.3 times a second, out of step with the odometry, as TUM."""
    _, truth = drive
    times = np.arange(truth.times[0] + 0.037, truth.times[-1], 1 / 7.3)
    heading = np.interp(times, truth.times, truth.heading)
    positions = np.interp(times, truth.times, truth.positions.real) + 1j * np.interp(
        times, truth.times, truth.positions.imag
    )
    return write(tmp_path_factory.mktemp("truth") / "truth.txt.gz", tum_rows(times, positions, heading))


OPTIONS = {"parameters": FITTED, "lengths_m": [2, 4, 8], "resamples": 100}


@pytest.fixture(scope="module")
def expected(drive, truth_file):
    return fit_noise(drive[0], read_truth(truth_file), **OPTIONS)


def log_file(kind, log, folder):
    """The odometry as one kind of log, and what else must be said to read it."""
    steps = np.column_stack([log.times[1:], np.abs(log.moves), log.turns])
    # an arc's length is longer than its chord
    steps[:, 1] /= np.sinc(log.turns / (2 * np.pi))
    if kind == "increments.csv":
        return write(folder / kind, steps, "time,distance,turn\n"), {}
    if kind == "nameless.txt.gz":
        return write(folder / kind, steps), {"kind": "increments"}
    if kind == "velocities.csv":
        rates = steps[:, 1:] / np.diff(log.times)[:, None]
        rows = np.column_stack([log.times, np.append(rates, rates[-1:], axis=0)])
        return write(folder / kind, rows, "t,v,omega\n"), {}
    if kind == "log.mat":
        savemat(folder / kind, {"DR": steps})
        return folder / kind, {"kind": "increments", "variable": "DR"}
    position, heading = log.positions, log.headings
    if kind == "tum.txt.gz":
        return write(folder / kind, tum_rows(log.times, position, heading)), {}
    if kind == "poses.csv":
        rows = np.column_stack([log.times, 1e3 * position.real, 1e3 * position.imag, np.degrees(heading)])
        return write(folder / kind, rows, "stamp,x [mm],y [mm],yaw [deg]\n"), {}
    c, s, zero, one = np.cos(heading), np.sin(heading), np.zeros(len(heading)), np.ones(len(heading))
    camera = [c, zero, -s, -position.imag, zero, one, zero, zero, s, zero, c, position.real]
    return write(folder / kind, np.column_stack(camera)), {"rate_hz": RATE_HZ}


@pytest.mark.parametrize(
    "kind", ["increments.csv", "nameless.txt.gz", "velocities.csv", "log.mat", "tum.txt.gz", "poses.csv", "kitti.txt"]
)
def test_every_kind_of_log_gives_the_same_noise(drive, truth_file, expected, tmp_path, kind):
    log, _ = drive
    truth = read_truth(truth_file)
    file, how = log_file(kind, log, tmp_path)
    found = fit_noise(read_odometry(file, **how), truth, **OPTIONS)
    assert found.counts.odometry_samples == expected.counts.odometry_samples
    assert found.counts.truth_samples != found.counts.odometry_samples
    for name in FITTED:
        # the simulated steps err sideways of their arcs by a hundredth of their length, which increments leave out
        assert getattr(found.noise, name) == pytest.approx(
            getattr(expected.noise, name), abs=0.3 * expected.std_errors[name]
        )
        low, high = expected.intervals[name]
        assert low - (high - low) / 2 < getattr(NOISE, name) < high + (high - low) / 2
