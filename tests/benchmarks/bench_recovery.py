"""What intervals and verdicts of fit_noise promise, counted: 200 simulated drives of each kind of path.

How often the 95 % interval of every rate holds the true one, and how often drives that obey the model are said to slip
(5 % is stated) or to be no random walk (1 % is stated). A quarter of an hour.
"""

from __future__ import annotations

import numpy as np

from driftplan.model.calibration.fit import PARAMETERS
from driftplan.model.calibration.noise_check import CLEAR_CHANCE, HEAVY_TAILS_CHANCE
from driftplan.model.calibration.recordings import simulate_log
from tests.model.test_calibration import EVERY_RATE, PATHS, false_alarms, share_held

REPETITIONS = 200


def main() -> None:
    chance = np.sqrt(0.95 * 0.05 / REPETITIONS)
    print(f"share of {REPETITIONS} drives whose 95 % interval holds the true rate; by chance 0.95 ± {chance:.3f}")
    print(f"{'rate':24}" + "".join(f"{path:>10}" for path in PATHS), flush=True)
    shares = {}
    for path, made in PATHS.items():
        drives = (simulate_log(made(k), EVERY_RATE, rng=k, truth_position_std_m=0.002) for k in range(REPETITIONS))
        shares[path] = share_held(drives, EVERY_RATE, PARAMETERS)
    for name in PARAMETERS:
        print(f"{name:24}" + "".join(f"{shares[path].get(name, np.nan):10.3f}" for path in PATHS), flush=True)
    found = false_alarms(range(REPETITIONS // 2))  # each drive with and without true headings
    for (words, count), stated in zip(found.items(), (HEAVY_TAILS_CHANCE, CLEAR_CHANCE), strict=True):
        print(f"said of drives that obey the model: {words!r} {count / REPETITIONS:.3f}, stated {stated:g}")


if __name__ == "__main__":
    main()
