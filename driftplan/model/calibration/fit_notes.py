"""Plain sentences about a fit: what to know of the drives and of their reference before using its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees, sqrt

import numpy as np

from driftplan.arrays import Floats
from driftplan.model.calibration.matching import Match
from driftplan.model.calibration.quasi_likelihood import SYSTEMATIC, Solution
from driftplan.model.calibration.segment_check import SegmentCheck
from driftplan.model.calibration.segment_ladder import Ladder
from driftplan.model.calibration.segments import TruthNoise
from driftplan.model.noise import OdometryNoise

_ODD_MOUNTING_RAD = 0.2  # a reference's heading turned by more is no matter of a millimetre
_CHANCE = 0.01  # that drives are said to differ when they do not


def mounting_notes(matches: Sequence[Match]) -> list[str]:
    """Whether true headings are turned by more than a marker is mounted askew."""
    worst = max((m.heading_offset for m in matches), key=abs)
    if abs(worst) < _ODD_MOUNTING_RAD:
        return []
    return [
        f"The truth's headings are turned by {degrees(worst):.0f} deg against the direction in which the odometry "
        "drives, and were turned back: check axes and signs."
    ]


def reference_notes(ladder: Ladder, truth: TruthNoise, check: SegmentCheck) -> list[str]:
    """Whether the reference is too coarse to see the odometry drift, or another drive's."""
    if all(row.measured_rms_m > row.length_m for row in check.lengths):
        return ["The errors are larger than the segments are long: are odometry and truth of the same drive?"]
    _, cov = ladder.expected(ladder.windows(OdometryNoise()), truth)
    white = float(np.trace(ladder.by_rung(cov[:, ladder.position, ladder.position])[-1]))
    longest = check.lengths[-1]
    if white < 0.5 * longest.predicted_rms_m**2:
        return []
    return [
        f"Even over {longest.length_m:.3g} m most of the error does not grow with the distance (white, "
        f"{sqrt(truth.position_var):.2g} m): a better reference or longer segments would tell more about the odometry."
    ]


def drive_notes(ladder: Ladder, solution: Solution, error: Floats) -> list[str]:
    """Whether systematic errors differ from drive to drive by more than the fit's standard errors explain."""
    from scipy.special import chdtri

    drives = np.unique(ladder.drive)
    if drives.size < 2:
        return []
    systematic = [k for k, name in enumerate(solution.names) if name in SYSTEMATIC]
    own = []
    for drive in drives:
        mine = ladder.drive == drive
        information = solution.information[mine].sum(axis=0)[np.ix_(systematic, systematic)]
        own.append(np.linalg.solve(information, solution.score[mine].sum(axis=0)[systematic]))
    notes = []
    for k, values in zip(systematic, np.transpose(own), strict=True):
        spread = float(np.std(values, ddof=1))
        chance = float(error[k]) * sqrt(drives.size)  # standard error of one drive's value
        if spread**2 * (drives.size - 1) > chance**2 * float(chdtri(drives.size - 1, _CHANCE)):
            notes.append(
                f"The drives differ: {solution.names[k]} varies by {spread:.2g} (standard deviation) from one to the "
                "next, more than chance explains. Another drive or robot may be as far off as that from the fitted "
                f"{solution.theta[k]:.2g}."
            )
    return notes
