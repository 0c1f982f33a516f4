"""What lies between a reference and an odometry for good: their clocks, and how the one's heading is mounted."""

from __future__ import annotations

import numpy as np

from driftplan.arrays import Complexes, Floats
from driftplan.model.calibration.recordings import OdometryLog, Trajectory

_OFFSETS = 20  # clock offsets tried to either side
_CLEARLY = 0.95  # an offset must reduce the disagreement of the recordings to this share
_CLEARLY_TURNED = 4.0  # standard errors that a heading offset must have,
_LEAST_RAD = 1e-6  # and more than rounding


def clock_offset(odometry: OdometryLog, truth: Trajectory, reach_s: float = 1.0) -> float:
    """Truth clock minus odometry clock, s, up to ``reach_s``: where turns (without headings: distances) over short
    windows agree best.

    0 unless their mean difference falls by a twentieth: a slow or steady drive says nothing about clocks.
    """
    window = max(0.5, 2 * float(np.median(np.diff(truth.times))), 2 * float(np.median(np.diff(odometry.times))))
    first = max(odometry.times[0], truth.times[0]) + reach_s
    last = min(odometry.times[-1], truth.times[-1]) - reach_s
    if last - first < 20 * window:
        return 0.0
    at = np.linspace(first, last, min(int((last - first) / (0.5 * window)), 4000))
    at = at[at + window <= last]
    turning, counted, true = False, odometry.positions, truth.positions
    if truth.heading is not None:
        turning, counted, true = True, odometry.headings.astype(complex), truth.heading.astype(complex)

    def gained(begin: Floats, times: Floats, values: Complexes) -> Floats:
        change = interpolated(begin + window, times, values) - interpolated(begin, times, values)
        return np.asarray(change.real if turning else np.abs(change))

    said: Floats = gained(at, odometry.times, counted)

    def disagreement(offset: float) -> float:
        difference = said - gained(at + offset, truth.times, true)
        return float(np.mean(np.abs(difference - np.median(difference))))

    unshifted = disagreement(0.0)
    best, step = 0.0, reach_s / _OFFSETS
    for _ in range(2):  # a coarse search, then a fine one around its best
        offsets = best + step * np.arange(-_OFFSETS, _OFFSETS + 1)
        values = [disagreement(float(offset)) for offset in offsets]
        best, least, step = float(offsets[int(np.argmin(values))]), min(values), step / _OFFSETS
    if (
        least > _CLEARLY * unshifted
        or unshifted < 1e-9 * float(np.ptp(said))
        or abs(best) > (1 - 1 / _OFFSETS) * reach_s
    ):
        return 0.0
    return best


def heading_offset(estimate: Complexes, gained: Floats, truth: Complexes) -> float:
    """True heading as measured minus the robot's, rad, from short segments of a drive that lie side by side.

    A marker or sensor that is mounted askew turns every measured heading by the same angle, and so all true
    displacements in the measured frame, long and short, whereas errors of odometry grow with length. 0 unless four
    standard errors away.

    Parameters
    ----------
    estimate, truth : (n,), displacement over each segment by the odometry and by the reference, in the heading of
        either at its start
    gained : (n,), heading error gained over the segment: seen from half of it, its effect on the displacement is undone
    """
    product = np.conj(estimate * np.exp(-0.5j * gained)) * truth
    mean = product.sum()
    if mean == 0:
        return 0.0
    angle = -float(np.angle(mean))
    error = float(np.sqrt(np.sum((product * np.exp(1j * angle)).imag ** 2)) / np.abs(mean))
    return angle if abs(angle) > max(_CLEARLY_TURNED * error, _LEAST_RAD) else 0.0


def interpolated(at: Floats, times: Floats, positions: Complexes) -> Complexes:
    return np.asarray(np.interp(at, times, positions.real) + 1j * np.interp(at, times, positions.imag))
