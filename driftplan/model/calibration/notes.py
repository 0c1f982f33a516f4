"""Plain sentences: what to know of drives, reference and fit before using the numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import degrees, sqrt

import numpy as np

from driftplan.model.calibration.matched_drive import MatchedDrive
from driftplan.model.calibration.noise_check import SegmentCheck
from driftplan.model.calibration.quasi_likelihood import SYSTEMATIC, Solution, drive_deviations, limits
from driftplan.model.calibration.recordings import OdometryLog, Trajectory
from driftplan.model.calibration.segment_sets import SegmentSet
from driftplan.model.calibration.segments import TruthNoise
from driftplan.model.noise import OdometryNoise

_ODD_MOUNTING_RAD = 0.2  # a reference's heading turned by more is no matter of a millimetre
_CHANCE = 0.01  # that drives are said to differ when they do not
_UNITS = {1000: "millimetres or metres", 3.6: "km/h or m/s", 3.28: "feet or metres", 57.3: "degrees or radians"}


def data_notes(
    drives: Sequence[tuple[OdometryLog, Trajectory]],
    matches: Sequence[MatchedDrive],
    segments: SegmentSet,
    truth: TruthNoise,
    check: SegmentCheck,
) -> Iterator[str]:
    """What is odd about the truth: whether it begins at the origin and the odometry does not, so that they may be
    swapped; is turned by more than a marker is mounted askew; or is too coarse to see the odometry drift."""
    if all(log.start != 0 and true.positions[0] == 0 for log, true in drives):
        yield "The truth begins at (0, 0), the odometry elsewhere: are the two swapped?"
    turned = max((m.heading_offset for m in matches), key=abs)
    if abs(turned) >= _ODD_MOUNTING_RAD:
        yield (
            f"The truth's headings are turned by {degrees(turned):.0f} deg against the direction in which the odometry "
            "drives, and were turned back: check axes and signs."
        )
    _, cov = segments.expected(segments.windows(OdometryNoise()), truth)
    white = float(np.trace(segments.by_bin(cov[:, segments.position, segments.position])[-1]))
    longest = check.lengths[-1]
    if white >= 0.5 * longest.predicted_rms_m**2:
        yield (
            f"Even over {longest.length_m:.3g} m most of the error does not grow with the distance (white, "
            f"{sqrt(truth.position_var):.2g} m): a better reference or longer segments would tell more about the "
            "odometry."
        )


def fault_notes(segments: SegmentSet, solution: Solution, check: SegmentCheck) -> Iterator[str]:
    """Why the numbers of a fit are not to be used."""
    if all(row.measured_rms_m > row.length_m for row in check.lengths):
        yield "The errors are larger than the segments are long: are odometry and truth of the same drive?"
    ratio = segments.counted_over_true
    if not 0.5 < ratio < 2:
        units = (f"{unit}?" for size, unit in _UNITS.items() if min(abs(ratio / size - 1), abs(ratio * size - 1)) < 0.1)
        yield f"The odometry counts {ratio:.3g} times the true distance: {next(units, 'check its units.')}"
    least, most = limits(segments, solution.names)
    least = np.where(solution.bounded, -np.inf, least)  # variances may be 0
    for k in np.flatnonzero((solution.theta <= least + 1e-6) | (solution.theta >= most * (1 - 1e-6))).tolist():
        yield (
            f"{solution.names[k]} sits on its bound of {solution.theta[k]:.3g}: check units and signs of the odometry, "
            "and that the truth is of the same drive."
        )
    if not solution.converged:
        longest = segments.bins[-1].length_m
        yield (
            f"The fit did not converge: its last step still moved {solution.slowest}. Fit fewer parameters (without "
            f"this one), give other lengths_m (the longest is {longest:.3g} m), or record more or longer drives."
        )


def drive_notes(segments: SegmentSet, solution: Solution, std_errors: Mapping[str, float]) -> Iterator[str]:
    """Whether systematic errors differ from drive to drive by more than the fit's standard errors explain."""
    from scipy.special import chdtri

    own, names = drive_deviations(segments, solution), [name for name in solution.names if name in SYSTEMATIC]
    drives = len(own)
    if drives < 2:
        return
    spread = own.std(axis=0, ddof=1)
    limit = sqrt(drives * float(chdtri(drives - 1, _CHANCE)) / (drives - 1))  # in the standard errors of all drives
    for name, value in zip(names, spread.tolist(), strict=True):
        if value > limit * std_errors[name]:
            yield (
                f"The drives differ: {name} varies by {value:.2g} (standard deviation) from one to the next, more than "
                "chance explains. Another drive or robot may be as far off as that from the fitted "
                f"{solution.theta[solution.names.index(name)]:.2g}."
            )
