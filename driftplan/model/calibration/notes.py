"""Plain sentences: what to know of drives, reference, fit and check before using the numbers. All of them are here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import degrees, hypot, sqrt

import numpy as np

from driftplan.arrays import Floats
from driftplan.model.calibration.matched_drive import MatchedDrive
from driftplan.model.calibration.quasi_likelihood import SYSTEMATIC, Solution
from driftplan.model.calibration.segment_check import LEVELS, SegmentCheck
from driftplan.model.calibration.segment_sets import SegmentSet
from driftplan.model.calibration.segments import TruthNoise
from driftplan.model.noise import OdometryNoise

_ODD_MOUNTING_RAD = 0.2  # a reference's heading turned by more is no matter of a millimetre
_CHANCE = 0.01  # that drives are said to differ when they do not
_CLEAR_SHIFT_ERRORS = 3.0  # standard errors by which the systematic errors of other drives are said to differ
_CLEAR_ERRORS = 3.0  # standard errors by which a check is said to fail,
_CLEAR_RATIO = 0.15  # and at least this share of the predicted rms


def mounting_notes(matches: Sequence[MatchedDrive]) -> list[str]:
    """Whether true headings are turned by more than a marker is mounted askew."""
    worst = max((m.heading_offset for m in matches), key=abs)
    if abs(worst) < _ODD_MOUNTING_RAD:
        return []
    return [
        f"The truth's headings are turned by {degrees(worst):.0f} deg against the direction in which the odometry "
        "drives, and were turned back: check axes and signs."
    ]


def reference_notes(segments: SegmentSet, truth: TruthNoise, check: SegmentCheck) -> list[str]:
    """Whether the reference is too coarse to see the odometry drift, or another drive's."""
    if all(row.measured_rms_m > row.length_m for row in check.lengths):
        return ["The errors are larger than the segments are long: are odometry and truth of the same drive?"]
    _, cov = segments.expected(segments.windows(OdometryNoise()), truth)
    white = float(np.trace(segments.by_bin(cov[:, segments.position, segments.position])[-1]))
    longest = check.lengths[-1]
    if white < 0.5 * longest.predicted_rms_m**2:
        return []
    return [
        f"Even over {longest.length_m:.3g} m most of the error does not grow with the distance (white, "
        f"{sqrt(truth.position_var):.2g} m): a better reference or longer segments would tell more about the odometry."
    ]


def drive_notes(segments: SegmentSet, solution: Solution, error: Floats) -> list[str]:
    """Whether systematic errors differ from drive to drive by more than the fit's standard errors explain."""
    from scipy.special import chdtri

    drives = np.unique(segments.drive_of)
    if drives.size < 2:
        return []
    systematic = [k for k, name in enumerate(solution.names) if name in SYSTEMATIC]
    own = []
    for drive in drives:
        mine = segments.drive_of == drive
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


def systematic_notes(
    noise: OdometryNoise, found: Mapping[str, tuple[float, float]], std_errors: Mapping[str, float]
) -> list[str]:
    """Which systematic errors, found with their standard errors, are clearly not those of the noise."""
    notes = []
    for name, (value, error) in found.items():
        expected, its_error = getattr(noise, name), std_errors.get(name, 0.0)
        if abs(value - expected) > _CLEAR_SHIFT_ERRORS * hypot(error, its_error):
            notes.append(
                f"The systematic errors differ: {name} seems to be {value:.2g} ± {error:.1g} on these drives, not "
                f"{expected:.2g}" + (f" ± {its_error:.1g}." if its_error else ".")
            )
    return notes


def judged(check: SegmentCheck, rms_errors_m: Floats | None = None) -> SegmentCheck:
    """The check with notes on what does not fit, judged at three standard errors: those of the predicted rms included,
    (lengths,), where it owes nothing to these segments."""
    found = (_growth_note(check, rms_errors_m), _shape_note(check))
    return replace(check, notes=(*check.notes, *(note for note in found if note)))


def _growth_note(check: SegmentCheck, rms_errors_m: Floats | None) -> str:
    """How the rms grows with length, measured over predicted."""
    rows = check.lengths
    ratio = np.array([row.measured_rms_m / row.predicted_rms_m for row in rows])
    error = np.hypot([row.measured_rms_error_m for row in rows], 0.0 if rms_errors_m is None else rms_errors_m)
    error = error / [row.predicted_rms_m for row in rows]
    if len(rows) < 2 or not (np.abs(ratio - 1) > np.maximum(_CLEAR_ERRORS * error, _CLEAR_RATIO)).any():
        return ""
    if ratio[-1] > ratio[0] * (1 + _CLEAR_RATIO):
        why = "errors grow faster with length than a random walk's: they are correlated over longer stretches"
    elif ratio[-1] < ratio[0] / (1 + _CLEAR_RATIO):
        why = (
            "errors grow slower with length than a random walk's: part of them does not add up (clock, antenna, "
            "turns undone by the next)"
        )
    else:
        why = "the errors are of another size than in the drives that were fitted"
    return (
        f"The random-walk model does not fit: measured over predicted rms is {ratio[0]:.2f} at {rows[0].length_m:.3g} "
        f"m and {ratio[-1]:.2f} at {rows[-1].length_m:.3g} m; {why}."
    )


def _shape_note(check: SegmentCheck) -> str:
    """Whether few segments hold most of the error, or too many fall outside."""
    rows = check.lengths
    share, error = (np.array([getattr(row, name) for row in rows]) for name in ("coverage", "coverage_error"))
    excess = (share - LEVELS) / error
    heavy = (excess[:, 0] > _CLEAR_ERRORS) & (np.array([row.mean_nees for row in rows]) > 0.7)
    if heavy.any():
        row = rows[int(np.argmax(heavy))]
        outside = 1 - row.coverage[2]
        tails = f" and {100 * outside:.0f} % outside the 95 % region" if outside > 1 - LEVELS[2] else ""
        narrow = " and too narrow for the rest" if tails else ""
        return (
            f"The errors are not Gaussian: {100 * row.coverage[0]:.0f} % lie inside the 50 % region{tails} at "
            f"{row.length_m:.3g} m. Most of the drift comes from a few places (slips?): the rms may hold, the regions "
            f"are too wide for most segments{narrow}."
        )
    if (excess[:, 2] < -_CLEAR_ERRORS).any():
        row = rows[int(np.argmin(excess[:, 2]))]
        return (
            f"The regions are too small: {100 * (1 - row.coverage[2]):.0f} % of the errors lie outside the 95 % region "
            f"at {row.length_m:.3g} m."
        )
    return ""
