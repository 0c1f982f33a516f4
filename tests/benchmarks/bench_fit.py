"""Logs of a million rows; fit_noise: time against the length of the log, and how well simulated noise is recovered."""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from driftplan.model.calibration.fit import PARAMETERS, fit_noise
from driftplan.model.calibration.recordings import simulate_log
from driftplan.model.calibration.segment_sets import segment_set
from driftplan.model.calibration.segments import TruthNoise
from driftplan.model.noise import OdometryNoise
from driftplan.model.paths import Run
from driftplan.world.odometry_logs import read_odometry, read_truth

NOISE = OdometryNoise(
    heading_var_per_m=1e-3,
    heading_var_per_rad=2e-3,
    distance_var_per_m=4e-4,
    heading_bias_per_m=2e-3,
    heading_bias_per_rad=0.02,
    distance_scale_error=0.01,
)
FITTED = tuple(name for name in PARAMETERS if getattr(NOISE, name) != 0)


def recorded(length_m: float, seed: int):
    """A drive of arcs and turns."""
    rng = np.random.default_rng(seed)
    path = [
        Run(length_m=rng.uniform(1, 3), curvature_per_m=rng.uniform(-0.8, 0.8), turn_rad=rng.choice([0, 0, 1.5]))
        for _ in range(int(length_m / 2))
    ]
    return simulate_log(path, NOISE, rng=rng, truth_position_std_m=0.004)


def million_rows() -> None:
    """Read odometry and truth of a million rows, four columns each, and fit them."""
    rows = 1_000_000
    rng = np.random.default_rng(0)
    times = 0.01 * np.arange(rows)
    turned = 4e-3 * np.sin(times / 50)
    with TemporaryDirectory() as folder:
        files = []
        for name, size in (("truth", 0.0), ("odometry", 1.0)):
            heading = np.cumsum(turned + size * 7e-4 * rng.standard_normal(rows))
            place = np.cumsum((0.005 + size * 7e-4 * rng.standard_normal(rows)) * np.exp(1j * heading))
            files.append(Path(folder, f"{name}.csv"))
            columns = np.column_stack([times, place.real, place.imag, heading])
            np.savetxt(files[-1], columns, "%.5f", ",", header="time,x,y,heading", comments="")
        begin = time.process_time()
        truth, log = read_truth(files[0]), read_odometry(files[1])
        read = time.process_time()
        fit_noise(log, truth)
        print(f"two logs of {rows} rows: read in {read - begin:.1f} s, fitted in {time.process_time() - read:.1f} s\n")


def main() -> None:
    million_rows()
    print("samples   drive m   segments   all rates s   six rates s   one evaluation ms")
    for length in (200.0, 1000.0, 5000.0):
        drive = recorded(length, 0)
        segments, _ = segment_set([drive])
        begin = time.perf_counter()
        for _ in range(5):
            segments.expected(segments.windows(NOISE), TruthNoise(1e-5, 0.0))
        evaluation = (time.perf_counter() - begin) / 5
        seconds = []
        for parameters in (PARAMETERS, FITTED):
            begin = time.perf_counter()
            fit_noise(*drive, parameters=parameters)
            seconds.append(time.perf_counter() - begin)
        print(
            f"{len(drive[0].times):7d} {length:9.0f} {len(segments.values):10d} {seconds[0]:13.2f} {seconds[1]:13.2f} "
            f"{1e3 * evaluation:19.1f}"
        )

    repetitions = 40
    found = np.empty((repetitions, len(FITTED)))
    held = np.zeros(len(FITTED))
    for seed in range(repetitions):
        fit = fit_noise(*recorded(600.0, seed), parameters=FITTED, lengths_m=[1, 2, 4, 8], time_offset_s=0.0)
        found[seed] = [getattr(fit.noise, name) for name in FITTED]
        held += [low <= getattr(NOISE, name) <= high for name, (low, high) in fit.intervals.items()]
    print(f"\n{repetitions} simulated drives of 600 m; a 95 % interval misses by more than chance below 0.86")
    print(f"{'rate':22} {'true':>9} {'mean':>9} {'spread':>9} {'held by 95 % intervals':>23}")
    for k, name in enumerate(FITTED):
        mean, spread = found[:, k].mean(), found[:, k].std(ddof=1)
        print(f"{name:22} {getattr(NOISE, name):9.2g} {mean:9.3g} {spread:9.2g} {held[k] / repetitions:23.3f}")


if __name__ == "__main__":
    main()
