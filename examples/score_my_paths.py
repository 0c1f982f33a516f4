"""No planning: score paths you already have, all at once, and see which loses the robot least."""

from __future__ import annotations

import numpy as np

from driftplan import OdometryNoise, predict_drift

PATHS = {
    "straight through": [(0, 0), (30, 10)],
    "long leg first": [(0, 0), (30, 0), (30, 10)],
    "short leg first": [(0, 0), (0, 10), (30, 10)],
    "by the window": [(0, 0), (10, 12), (25, 12), (30, 10)],
}


def main() -> None:
    """Print the paths, best first."""
    noise = OdometryNoise.from_std(heading_deg=2.0, distance_m=0.05, after_m=10.0, heading_deg_per_full_turn=3.0)
    drift = predict_drift([np.array(path) for path in PATHS.values()], noise)  # paths of different lengths: one call
    radius = drift.end.radius(0.95)
    names = list(PATHS)
    print(f"{'path':18} {'length':>8} {'rms':>7} {'95 % within':>12}")
    for k in np.argsort(drift.end.rms):
        print(f"{names[k]:18} {drift.length[k]:6.1f} m {drift.end.rms[k]:5.2f} m {radius[k]:10.2f} m")


if __name__ == "__main__":
    main()
