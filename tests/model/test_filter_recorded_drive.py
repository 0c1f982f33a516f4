"""A Kalman filter on a mower's recorded odometry and its ranges to four surveyed beacons, against what is predicted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from driftplan import PRESETS, Runs
from driftplan.model.covariance import path_legs
from driftplan.model.filter_state import FilterState, range_row, states_along

PLAZA = Path(__file__).resolve().parents[2] / "../shared/data/plaza1/Plaza1_.mat"
NOISE = PRESETS["mower_wheels_and_gyro"].noise  # fitted to this mower
HEADING_STD = 0.03  # rad, of the heading at the start: that of the recording is its gyro's own


class Mower:
    """The recording: odometry, truth, and ranges in the order of time, which is not that of the file."""

    def __init__(self):
        from scipy.io import loadmat

        recorded = loadmat(PLAZA)
        self.odometry, self.truth = recorded["DR"], recorded["GT"]
        heard = recorded["TD"][np.argsort(recorded["TD"][:, 0])]
        sites = {int(name): (x, y) for name, x, y in recorded["TL"]}
        self.heard_at, self.heard_from = heard[:, 0], np.array([sites[int(name)] for name in heard[:, 2]])
        distance = np.hypot(*(self.at(self.heard_at)[:, :2] - self.heard_from).T)
        early = slice(len(heard) // 2)
        self.ranges = heard[:, 3] / (heard[early, 3] @ distance[early] / (distance[early] @ distance[early]))
        self.range_std_m = float((self.ranges - distance)[early].std())  # half a metre, white

    def at(self, t):
        """True x, y, heading at times t, (..., 3)."""
        columns = (self.truth[:, 1], self.truth[:, 2], np.unwrap(self.truth[:, 3]))
        return np.stack([np.interp(t, self.truth[:, 0], c) for c in columns], axis=-1)

    def half(self, second):
        """Steps of one half of the drive."""
        middle = len(self.odometry) // 2
        return self.odometry[middle:] if second else self.odometry[:middle]

    def start(self, steps):
        """True x, y, heading before the first step."""
        return self.at(self.truth[np.searchsorted(self.truth[:, 0], steps[0, 0]) - 1, 0])

    def readings(self, steps, every):
        """Every so many ranges heard during these steps, and the step before which each is taken."""
        if not every:
            return []
        during = np.flatnonzero((self.heard_at > steps[0, 0]) & (self.heard_at <= steps[-1, 0]))[::every]
        return list(zip(np.searchsorted(steps[:, 0], self.heard_at[during]).tolist(), during.tolist(), strict=True))

    def filtered(self, steps, every):
        """Errors of a filter written with plain matrices, on what was recorded, (steps, 2)."""
        x, P = self.start(steps), np.diag([0.0, 0.0, HEADING_STD**2])
        due = dict(self.readings(steps, every))
        errors = []
        for k, (t, distance, turn) in enumerate(steps.tolist()):
            if k in due:
                off = x[:2] - self.heard_from[due[k]]
                rho = np.hypot(*off)
                H = np.array([*off / rho, 0.0])
                K = P @ H / (H @ P @ H + self.range_std_m**2)
                x, P = x + K * (self.ranges[due[k]] - rho), P - np.outer(K, H @ P)
            heading = x[2] + turn
            c, s = np.cos(heading), np.sin(heading)
            F, G = np.eye(3), np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            F[:2, 2] = -distance * s, distance * c
            Q = np.diag(
                [
                    NOISE.distance_var_per_m * distance + NOISE.distance_var_per_rad * abs(turn),
                    NOISE.lateral_var_per_m * distance,
                    NOISE.heading_var_per_m * distance + NOISE.heading_var_per_rad * abs(turn),
                ]
            )
            x = np.array([x[0] + distance * c, x[1] + distance * s, heading])
            P = F @ P @ F.T + G @ Q @ G.T
            errors.append(x[:2] - self.at(t)[:2])
        return np.array(errors)

    def predicted(self, steps, every):
        """E|e|² along the drive as driftplan has it, from the true geometry, (steps,)."""
        runs = Runs(np.zeros((), complex), self.start(steps)[2], steps[:, 2], steps[:, 1], np.zeros(len(steps)))
        where = self.at(self.heard_at)[:, :2]
        rows = {
            k: [((range_row(self.heard_from[n] - where[n], self.range_std_m**2),), None)]
            for k, n in self.readings(steps, every)
        }
        start = FilterState.at_start(np.diag([0.0, 0.0, HEADING_STD**2]))
        return states_along(start, path_legs(runs, [NOISE]).columns(), rows)[1].square[1:]


@pytest.fixture(scope="module")
def mower():
    if not PLAZA.is_file():
        pytest.skip("the recorded drives are not here")
    return Mower()


@pytest.mark.slow
@pytest.mark.parametrize("second", [False, True], ids=["first half", "second half"])
def test_a_mowers_filter_errs_as_predicted_with_and_without_ranges(mower, second):
    steps = mower.half(second)
    ratios, measured = {}, {}
    for every in (0, 40, 8):
        measured[every] = np.sqrt((mower.filtered(steps, every) ** 2).sum(axis=1).mean())
        ratios[every] = measured[every] / np.sqrt(mower.predicted(steps, every).mean())
    # one drive of 930 m; the errors of dead reckoning are one sample of a random walk, with a range every 10 m or 2 m
    # they forget quickly. Measured over predicted, first and second half: .55 .82, .85 .83, 1.10 .85
    assert 0.5 < ratios[0] < 1.5
    assert 0.75 < ratios[40] < 1.25
    assert 0.75 < ratios[8] < 1.25
    assert measured[8] < measured[40] < measured[0]
